"""Passivity of collocated channels: Hamiltonian test, and least squares that preserve it.

A force and the motion of its port absorb power at every frequency: Re Y >= 0 of the mobility Y =
s^(1-p) G, where p = 0, 1, 2 for displacement, velocity, acceleration. That is -Im G, Re G or Im G
>= 0. These change sign at the imaginary zeros of G(s) -+ G(-s), eigenvalues of a Hamiltonian pencil
(S. Boyd, V. Balakrishnan & P. Kabamba, Math. Control Signals Systems 2 (1989) 207-219; S.
Grivet-Talocia, IEEE Trans. Circuits Syst. I 51 (2004) 1755-1769).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.settings import PASSIVITY, RATIONAL_FIT

__all__ = [
    "active_part",
    "collocated_channels",
    "constrained_least_squares",
    "passive_channels",
    "violations",
]


def collocated_channels(
    outputs: tuple[Port, ...], inputs: tuple[Port, ...]
) -> list[tuple[int, int]]:
    """Return indices (output, input) of the pairs with the same port and sense."""
    out = []
    for i, output in enumerate(outputs):
        for j, given in enumerate(inputs):
            if _is_collocated(output, given):
                out.append((i, j))
    return out


def _is_collocated(a: Port, b: Port) -> bool:
    one = {label: weight for label, weight in _unsigned_weights(a).items() if weight}
    other = {label: weight for label, weight in _unsigned_weights(b).items() if weight}
    if one.keys() != other.keys():
        return False
    ratios = [one[label] / other[label] for label in one]
    return min(ratios) > 0 and max(ratios) - min(ratios) <= 1e-12 * max(ratios)


def _unsigned_weights(port: Port) -> dict[str, float]:
    """Return the weights by label without sign."""
    out = {}
    for label, weight in port.weights.items():
        node, _, direction = label.rpartition(":")
        sign = -1.0 if direction.startswith("-") else 1.0
        out[f"{node}:{direction.lstrip('+-')}"] = sign * weight
    return out


def active_part(values: NumberArray, power: int) -> RealArray:
    """Return Re Y over a positive factor: -Im G, Re G or Im G for displacement to acceleration."""
    if power == 1:
        return np.asarray(values.real)
    return np.asarray(values.imag if power == 2 else -values.imag)


def passive_channels(plant: Plant, powers: IndexArray) -> dict[tuple[int, int], bool]:
    """Return whether each collocated channel of a continuous plant is passive."""
    out = {}
    for i, j in collocated_channels(plant.output_ports, plant.input_ports):
        matrices = plant.A, plant.B[:, [j]], plant.C[[i]], plant.D[[i]][:, [j]]
        out[i, j] = not len(violations(matrices, int(powers[i])))
    return out


def violations(
    matrices: tuple[RealArray, RealArray, RealArray, RealArray], power: int
) -> RealArray:
    """Return one frequency in rad/s of each interval in which a channel generates power."""
    A, B, C, D = matrices
    crossings = _crossings(A, B, C, D, -1.0 if power != 1 else 1.0)
    size = np.abs(np.linalg.eigvals(A))
    size = size[size > 1e-9 * size.max(initial=1e-300)]
    if not len(size):
        size = np.ones(1)
    ends = np.array([1e-3 * size.min(), 1e3 * size.max()])
    inner = crossings[(crossings > ends[0]) & (crossings < ends[1])]
    edges = np.concatenate([ends[:1], inner, ends[1:]])
    found = []
    for low, high in pairwise(edges):
        lines = np.geomspace(low, high, 23)[1:-1]
        G = _response(A, B, C, D, lines)
        share = active_part(G, power) / np.maximum(np.abs(G), 1e-300)
        worst = int(np.argmin(share))
        if share[worst] < -PASSIVITY.least_violation:
            found.append(lines[worst])
    return np.array(found)


def _response(
    A: RealArray, B: RealArray, C: RealArray, D: RealArray, omega: RealArray
) -> ComplexArray:
    shift = 1j * omega[:, None, None] * np.eye(len(A)) - A
    solved = np.linalg.solve(shift, np.broadcast_to(B, (len(omega), *B.shape)))
    return np.asarray((C @ solved + D)[:, 0, 0])


def _crossings(A: RealArray, B: RealArray, C: RealArray, D: RealArray, sign: float) -> RealArray:
    """Return omega > 0 at which G(s) + sign G(-s) has a zero near the imaginary axis."""
    n = len(A)
    if n == 0:
        return np.zeros(0)
    unit = max(float(np.abs(np.linalg.eigvals(A)).max()), 1e-300)
    even, transform = scipy.linalg.matrix_balance(A / unit)
    b, c = np.linalg.solve(transform, B) / unit, C @ transform
    b, c = b / max(np.abs(b).max(), 1e-300), c / max(np.abs(c).max(), 1e-300)
    gain = max(np.abs(np.linalg.solve(transform, B)).max() / unit, 1e-300)
    gain *= max(np.abs(C @ transform).max(), 1e-300)
    pencil = np.zeros((2 * n + 1, 2 * n + 1))
    # G(-s) = C (-s I - A)^-1 B + D = -C (s I + A)^-1 B + D
    pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = even, -even
    pencil[:n, 2 * n :], pencil[n : 2 * n, 2 * n :] = b, b
    pencil[2 * n :, :n], pencil[2 * n :, n : 2 * n] = c, -sign * c
    pencil[2 * n, 2 * n] = (1.0 + sign) * D[0, 0] / gain
    mass = np.eye(2 * n + 1)
    mass[2 * n, 2 * n] = 0.0
    above, below = scipy.linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = above / below
    zeros = zeros[np.isfinite(zeros)]
    near = (np.abs(zeros.real) <= PASSIVITY.axis_distance * np.abs(zeros)) & (zeros.imag > 0)
    return np.asarray(np.sort(zeros.imag[near]) * unit)


def constrained_least_squares(
    A: RealArray, b: RealArray, G: RealArray, h: RealArray
) -> RealArray | None:
    """Return x that minimises |A x - b| with G x >= h; None if infeasible."""
    # Least distance programming by non-negative least squares (C. L. Lawson & R. J. Hanson,
    # Solving Least Squares Problems (1974), chapter 23).
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    U, sigma, Vt = np.linalg.svd(A / scale, full_matrices=False)
    kept = sigma > RATIONAL_FIT.singular_share * sigma[0]
    back = (Vt[kept].T / sigma[kept]) / scale[:, None]  # x = back (z + U^T b)
    projected = U[:, kept].T @ b
    rows = G @ back
    size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    bound = (h - rows @ projected) / size
    if (bound <= 0.0).all():
        return np.asarray(back @ projected)
    unit = max(float(np.linalg.norm(projected)), float(bound.max()))
    E = np.vstack([(rows / size[:, None]).T, bound / unit])
    f = np.zeros(len(E))
    f[-1] = 1.0
    u, residual = nnls(E, f, maxiter=30 * E.shape[1])
    if residual <= 1e-12:
        return None
    r = E @ u - f
    return np.asarray(back @ (projected - unit * r[:-1] / r[-1]))
