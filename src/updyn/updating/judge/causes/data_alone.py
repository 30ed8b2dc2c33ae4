"""What the data of a test show to be wrong with them, whatever the model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from updyn.errors import SolverError, UpdynError
from updyn.frf import FRF
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.shown import Shown, ShownFault
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Part

__all__ = [
    "finding_of",
    "findings_in",
    "set_aside",
    "shown_by",
    "still_shown",
    "unexpected",
    "with_variance",
]


def with_variance(frf: FRF, noise: NoiseModel) -> FRF:
    """Return data that carry their variance, as far as it is known before a fit."""
    return replace(frf, variance=noise.beforehand(frf))


def findings_in(part: Part, noise: NoiseModel) -> list[Finding]:
    """Return the faults that the data of a test show by themselves, the likeliest first."""
    seen = unexpected(shown_by(with_variance(part.frf, noise)), part)
    return [finding_of(one, part.name) for one in seen]


def unexpected(seen: Sequence[Shown], part: Part) -> list[Shown]:
    """Return what sound data would not show as well, by the model of a part, if it can be asked."""
    found = []
    for one in seen:
        with suppress(SolverError):
            if not one.fault.is_expected(part):
                found.append(one)
    return found


def shown_by(frf: FRF) -> list[Shown]:
    """Return the faults that data with their variance show by themselves, the likeliest first.

    Those that another one of them is known to look like are left out. Data that are zero throughout
    show nothing.
    """
    if not frf.values.any():
        return []
    found: list[Shown] = []
    for kind in CAUSES:
        cause = CAUSES[kind]
        if issubclass(cause, ShownFault):
            found += cause.shown(frf)
    blurred = {kind for one in found for kind in one.fault.blurs}
    clear = [one for one in found if one.fault.kind not in blurred]
    return sorted(clear, key=lambda one: -one.log_odds)


def still_shown(
    seen: Sequence[Shown], frf: FRF, findings: Sequence[Finding], thinned: tuple[FRF, FRF]
) -> list[Shown]:
    """Return what is still to be stated beside other findings: a symptom of these is not.

    Parameters
    ----------
    seen : sequence of Shown
        What the data showed.
    frf : FRF
        These data.
    findings : sequence of Finding
        What model and data showed together.
    thinned : (FRF, FRF)
        Some lines of the data, as they are and freed of the findings by the model: of those that no
        change of the data undoes.
    """
    repaired = frf
    for finding in findings:
        if finding.written:
            with suppress(UpdynError):  # a repair that leaves too little
                repaired = finding.repair(repaired)
    after = {one.fault.kind for one in shown_by(repaired)}
    before, freed = ({one.fault.kind for one in shown_by(data)} for data in thinned)
    gone = before - freed
    symptoms = [one for one in seen if one.fault.symptom]
    explained = [one for one in symptoms if one.fault.kind not in after or one.fault.kind in gone]
    return [one for one in seen if one not in explained]


def set_aside(seen: Sequence[Shown], frf: FRF) -> FRF:
    """Return the data in which the values of symptoms do not count; themselves where all do."""
    for one in seen:
        frf = one.fault.set_aside(frf)
    return frf


def finding_of(one: Shown, test: str) -> Finding:
    """Return the finding that tells of a fault."""
    fault = one.fault
    return Finding(
        fault.kind,
        fault.channels,
        fault.value,
        float(np.exp(min(one.log_odds, 700.0))),
        one.share,
        fault.statement(),
        fault.remedy,
        fault.written,
        test=test,
    )
