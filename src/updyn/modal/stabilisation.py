"""The stabilisation diagram: poles of fits of increasing order, and stable poles.

Poles of the structure appear at nearly the same place in every fit of sufficient order, poles of
noise do not (H. Van der Auweraer & B. Peeters, Sound and Vibration 38 (1) (2004) 28-33). A long
band is fitted in parts, because the necessary order increases with the number of modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.modal.lscf import fit_orders
from updyn.modal.settings import CHANNEL_FIT, STABILISATION

__all__ = ["Diagram", "find_stable_poles"]


@dataclass(frozen=True, slots=True, eq=False)
class Diagram:
    """Poles of fits of increasing order; arrays of shape (n,), frequencies in Hz, damping ratios.

    `stable`: the previous order has the pole at nearly the same place.
    """

    order: NDArray[np.int_]
    frequency: RealArray
    damping: RealArray
    stable: BoolArray


def find_stable_poles(freq: RealArray, Y: ComplexArray) -> tuple[ComplexArray, Diagram]:
    """Return the stable poles s in rad/s, by ascending frequency, and the diagram."""
    found: list[ComplexArray] = []
    rows: list[tuple[int, complex, bool]] = []
    for first, last, low, high in _split_band(freq):
        fits = _fit_part(freq[first:last], Y[first:last])
        lines = 2.0 * np.pi * float(np.median(np.diff(freq[first:last])))
        least = STABILISATION.line_distance * lines
        chains, stable = _find_chains([poles for _, poles in fits], least)
        within_part = [chain for chain in chains if low <= abs(chain) / (2.0 * np.pi) < high]
        found.append(np.array(within_part, dtype=np.complex128))
        for (order, poles), marks in zip(fits, stable, strict=True):
            inside = (np.abs(poles) >= 2 * np.pi * low) & (np.abs(poles) < 2 * np.pi * high)
            rows += [
                (order, complex(p), bool(m))
                for p, m in zip(poles[inside], marks[inside], strict=True)
            ]
    poles = np.concatenate(found)
    size = np.array([abs(p) for _, p, _ in rows])
    diagram = Diagram(
        np.array([order for order, _, _ in rows], dtype=np.int_),
        size / (2.0 * np.pi),
        np.array([-p.real for _, p, _ in rows]) / np.maximum(size, CHANNEL_FIT.smallest_divisor),
        np.array([mark for _, _, mark in rows], dtype=np.bool_),
    )
    return poles[np.argsort(np.abs(poles), kind="stable")], diagram


def _split_band(freq: RealArray) -> list[tuple[int, int, float, float]]:
    """Return parts of the band: first and last line, and limits of the part in frequency."""
    n = len(freq)
    count = max(1, round(n / STABILISATION.part_lines))
    edges = np.linspace(0, n, count + 1).astype(int)
    half = -(-n // (2 * count))
    out = []
    for k in range(count):
        low = freq[edges[k]] if k else 0.0
        high = freq[edges[k + 1]] if k < count - 1 else np.inf
        first, last = max(0, edges[k] - half), min(n, edges[k + 1] + half)
        out.append((first, last, float(low), float(high)))
    return out


def _fit_part(freq: RealArray, Y: ComplexArray) -> list[tuple[int, ComplexArray]]:
    """Return orders and poles of the fits of one part."""
    Y = _combine_columns(Y)
    largest = max(2, min(STABILISATION.largest_order, len(freq) // STABILISATION.lines_per_order))
    orders = list(range(2, largest + 1, STABILISATION.order_step))
    omega = 2.0 * np.pi * freq
    fits = []
    for order, poles in zip(orders, fit_orders(omega, Y, orders), strict=True):
        size = np.abs(poles)
        light = -poles.real < STABILISATION.largest_damping_ratio * size
        inside = (size <= omega[-1]) & (size >= omega[0]) & light
        fits.append((order, poles[inside]))
    return fits


def _combine_columns(Y: ComplexArray) -> ComplexArray:
    """Return the functions with the smaller side as columns, or its strongest combinations."""
    if Y.shape[2] > Y.shape[1]:
        Y = Y.transpose(0, 2, 1)
    if Y.shape[2] <= STABILISATION.most_columns:
        return Y
    rows = Y.reshape(-1, Y.shape[2])
    gram = (rows.conj().T @ rows).real
    strongest = np.linalg.eigh(gram)[1][:, ::-1][:, : STABILISATION.most_columns]
    return np.asarray(Y @ strongest)


def _find_chains(fits: list[ComplexArray], least: float) -> tuple[list[complex], list[BoolArray]]:
    """Return the poles that are stable up to the last order, and flags for each order."""
    stable: list[BoolArray] = []
    length = np.zeros(0, dtype=int)
    before: ComplexArray = np.zeros(0, dtype=np.complex128)
    for poles in fits:
        longer, marks = np.ones(len(poles), dtype=int), np.zeros(len(poles), dtype=bool)
        for i, j in _pair_nearest(poles, before, least):
            longer[i], marks[i] = length[j] + 1, True
        before, length = poles, longer
        stable.append(marks)
    long = before[length >= STABILISATION.stable_orders]
    return [complex(p) for p in long], stable


def _pair_nearest(poles: ComplexArray, before: ComplexArray, least: float) -> list[tuple[int, int]]:
    """Return pairs of nearly equal poles, one to one, nearest first."""
    if not len(poles) or not len(before):
        return []
    distance = np.abs(poles[:, None] - before)
    reach = np.maximum(STABILISATION.damping_distance * -before.real, least)
    share = distance / reach
    pairs: list[tuple[int, int]] = []
    for flat in np.argsort(share, axis=None, kind="stable"):
        i, j = np.unravel_index(flat, share.shape)
        if share[i, j] > 1.0:
            break
        if all(i != h and j != t for h, t in pairs):
            pairs.append((int(i), int(j)))
    return pairs
