"""Two hundred thousand lines of one mass on a spring: sums over lines, with next to nothing for BLAS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.model import Group, Model


def test_many_lines():
    """H = 1 / (k (1 + i eta) - omega^2 m); the deviation falls with the root of the number."""
    start = Model.from_groups({"p1": Group([[1e4]], [[1.0]], 0.02)}, ["1:X"])
    lines = np.linspace(1.0, 40.0, 200_000)
    clean = updyn.response(start.scaled({"p1": {"stiffness": 1.3}}), lines, ["1:X"], ["1:X"])
    omega2 = (2.0 * np.pi * lines) ** 2
    assert np.abs(clean.values[:, 0, 0] * (1.3e4 * (1.0 + 0.02j) - omega2) - 1.0).max() < 1e-12
    draw = np.random.default_rng(6).standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
    noisy = replace(clean, values=clean.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1])))
    unknowns = updyn.parameters(start, stiffness="all")
    found = updyn.update(start, noisy, unknowns, noise={"relative": 0.01})
    assert found.ok
    # d log H / d log k = -k (1 + i eta) H, and so much of each line's information.
    share = np.abs(1.3e4 * (1.0 + 0.02j) * clean.values) ** 2
    std = 1.3 * 0.01 / np.sqrt(2.0 * share.sum())
    assert found.std["p1.stiffness"] == pytest.approx(std, rel=1e-2)
    assert found.values["p1.stiffness"] == pytest.approx(1.3, abs=4.0 * std)
