"""Models of a few hundred DOFs for reduced models, and their true error."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

import updyn
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.reduction import Reduction


def springs(i: np.ndarray, j: np.ndarray, n: int) -> sp.csr_array:
    """1e6 N/m between the DOFs i and j."""
    ends = sp.csr_array(
        (np.r_[np.ones(len(i)), -np.ones(len(j))], (np.tile(np.arange(len(i)), 2), np.r_[i, j])),
        shape=(len(i), n),
    )
    return sp.csr_array(1e6 * ends.T @ ends)


def plate(
    m: int = 22, *, held: bool = True, local: float = 0.0, damper: float = 0.0
) -> updyn.Model:
    """A grid of m x m masses on springs, in four quarters with 1, 2, 3 and 4 % of loss."""
    n = m * m
    node = np.arange(n).reshape(m, m)
    quarter = np.add.outer(2 * (np.arange(m) >= m // 2), np.arange(m) >= m // 2).ravel()
    i = np.r_[node[:-1].ravel(), node[:, :-1].ravel()]
    j = np.r_[node[1:].ravel(), node[:, 1:].ravel()]
    groups = {}
    for q in range(4):
        own = (quarter[i] == q) & (quarter[j] == q)
        loss = local if local and q == 3 else 0.01 * (q + 1)
        mass = sp.diags_array((quarter == q) * (1.0 + 0.1 * q))
        groups[f"quarter {q + 1}"] = updyn.Group(springs(i[own], j[own], n), mass, loss_factor=loss)
    seam = quarter[i] != quarter[j]
    groups["seams"] = updyn.Group(springs(i[seam], j[seam], n), loss_factor=0.015)
    if held:
        groups["ground"] = updyn.Group(
            sp.diags_array(np.where(np.arange(n) < m, 1e6, 0.0)), loss_factor=0.01
        )
    if damper:
        at = np.array([n - 1, n // 2])
        groups["dampers"] = updyn.Group(
            viscous=sp.csr_array((np.full(2, damper), (at, at)), shape=(n, n))
        )
    return updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in range(n)])


def true_error(system: AffineSystem, state: State, reduction: Reduction, freq: np.ndarray) -> float:
    exact, fast = LineSolver.choose(system, "sparse"), reduction.solver()
    c = system.coefficients(state, 2 * np.pi * freq)
    H = exact.at(exact.solve(c, reduction.columns, freq), reduction.rows)
    R = fast.at(fast.solve(c, reduction.columns, freq), reduction.rows)
    return float((np.abs(H - R).max(axis=(0, 2)) / np.abs(H).max(axis=(0, 2))).max())


def moved(system: AffineSystem, size: float, seed: int = 1) -> State:
    rng = np.random.default_rng(seed)
    factor = system.start.factor * np.exp(size * rng.standard_normal(len(system.terms)))
    return State(
        factor,
        system.start.loss * np.exp(size * rng.standard_normal(len(system.terms))),
        system.start.rate,
    )
