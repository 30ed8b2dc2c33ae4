"""A chain of eight masses in plain NumPy, and a test of one whose masses stand in another order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import updyn

N = 8
LABELS = [f"{i}:Z" for i in range(1, N + 1)]
#: An order of the masses in which neighbours are far apart.
TURNED = [4, 1, 7, 0, 2, 6, 5, 3]


def springs() -> NDArray[np.float64]:
    """Return the stiffness of a chain held at both ends, in two halves."""
    parts = np.zeros((2, N, N))
    for i in range(N + 1):
        v = np.zeros(N)
        if i < N:
            v[i] = 1.0
        if i > 0:
            v[i - 1] -= 1.0
        parts[i % 2] += 2e4 * np.outer(v, v)
    return parts


def model(factors: Sequence[float] = (1.0, 1.0)) -> updyn.Model:
    groups = {
        name: updyn.Group(stiffness=K * factor, loss_factor=0.02)
        for name, K, factor in zip("ab", springs(), factors, strict=True)
    }
    groups["mass"] = updyn.Group(mass=np.eye(N))
    return updyn.Model.from_groups(groups, LABELS)


def measured(order: Sequence[int] = range(N)) -> updyn.FRF:
    """Return accelerances of the chain, its masses in some order, with 1 % noise."""
    K = springs().sum(axis=0)[np.ix_(order, order)]
    lines = np.linspace(3.0, 50.0, 100)
    H = []
    for f in lines:
        w2 = (2 * np.pi * f) ** 2
        Z = K * (1 + 0.02j) - w2 * np.eye(N)
        H.append(-w2 * np.linalg.solve(Z, np.eye(N)[:, [0, 3]]))
    H = np.array(H)
    rng = np.random.default_rng(0)
    z = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    return updyn.FRF(lines, H * (1 + 0.01 * z), LABELS, ["1:Z", "4:Z"], "accelerance")
