"""docs/backlash.md: its example runs, and its statements about the drive hold."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from pages import ROOT, blocks, run_python
from updyn.demos import DEMOS, loose_train
from updyn.dynamics.response import response

PAGE = ROOT / "docs" / "backlash.md"


def test_the_example_runs() -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, "docs/backlash.md", namespace)
    mesh = namespace["mesh"]
    assert (mesh.gap, mesh.stiffness) == (1e-4, 1.74e6)
    assert namespace["twist"] > 2.0 * mesh.half
    cycle = namespace["cycle"]
    assert cycle.stable
    assert not cycle.doubt
    assert "backlash" in DEMOS


@pytest.mark.parametrize(("torque", "least", "most"), [(60.0, 0.0, 0.0), (300.0, 0.4, 0.6)])
def test_the_share_of_lines_with_contact(torque: float, least: float, most: float) -> None:
    true = loose_train.true_model()
    weights = true.nonlinear["mesh"].weights
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = response(
            true, loose_train.lines()[::4], list(weights), [loose_train.MOTOR], level=torque
        )
    twist = np.abs(found.harmonics[:, 1, :, 0] @ list(weights.values()))
    assert least <= np.mean(twist > true.nonlinear["mesh"].element.half) <= most
