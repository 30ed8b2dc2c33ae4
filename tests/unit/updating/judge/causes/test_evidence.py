"""What is left once the unknowns have adapted, against a factorisation of all columns."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.judge.causes.evidence import Evidence, spread_of, stacked
from updyn.updating.judge.causes.moved import Moved
from updyn.updating.problem.problem import Part


def test_a_sensor_elsewhere_exchanges_its_rows(chain12, chain12_true):
    frf = updyn.response(chain12_true, np.linspace(0.6, 22.0, 20), ["2:X", "7:X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    part = Part.build(chain12, frf, unknowns)
    evidence = Evidence(part, part.coordinates.home)
    moved = Moved(("7:X", "8:X")).undo(evidence)
    there = part.with_data(moved)
    blocks = [there.block(evidence.x, lines) for lines in there.partition()]
    H, dH = np.concatenate([b.H for b in blocks]), np.concatenate([b.dH for b in blocks], axis=1)
    changes = np.stack([stacked(evidence.weight * d / H) for d in dH], axis=1) / evidence.unit
    Q = np.linalg.qr(np.vstack([changes, np.diag(1.0 / spread_of(part))]))[0]
    b = np.random.default_rng(0).standard_normal(len(Q))
    assert evidence.left(moved, b) == pytest.approx(b - Q @ (Q.T @ b), abs=1e-9)
