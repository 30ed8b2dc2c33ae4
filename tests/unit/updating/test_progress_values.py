"""What a callback is shown of the unknowns while they are fitted."""

from __future__ import annotations

import updyn
from updyn.demos import chain


def test_a_callback_is_shown_the_unknowns_of_the_latest_step():
    shown = []
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="part*", bounds={"stiffness": (0.3, 3.0)})
    result = updyn.update(model, frf, unknowns, starts=0, callback=shown.append)
    by_step = {step.number: step.values for step in result.history}
    seen = [progress for progress in shown if progress.values]
    assert seen
    assert all(dict(progress.values) == dict(by_step[progress.iteration]) for progress in seen)
    assert set(seen[-1].values) == set(unknowns.names)
