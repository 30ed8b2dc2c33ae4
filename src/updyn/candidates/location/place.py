"""The force of an element at one place, of any kind, from the responses.

An element on the deformation u exerts the force -z F on a structure that a force F excites. With
the receptances of the linear model between responses (r), deformation (q) and force (f),

    H = H_rf - H_rq z,    u / F = H_qf - H_qq z,

so that z of each line, level and force follows from the responses by linear least squares, whatever
the kind of the element (Noel & Kerschen, Mech. Syst. Signal Process. 83 (2017) 2, section 4). The
residual ranks the places. Linear unknowns are fitted together with all z by variable projection
(Kaufman, BIT 15 (1975) 49). The describing function of the element is z F / u at the amplitude |u|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.candidates.location.descent import make_descent
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.settings import LOCATION
from updyn.errors import SolverError
from updyn.updating.problem.local import Local, reduce_blocks
from updyn.updating.problem.local_elements import ElementReceptances, LocalElements

__all__ = ["PlaceFit", "fit_place", "linear_local"]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceFit:
    """Force and deformation of an element of any kind at one place.

    `x` (n,) are the linear unknowns and `cost` half the weighted sum of squares. `stiffness`, the
    describing function, `std`, its standard deviation, and `amplitude`, that of the deformation in
    m, have the shape (n_l, n_f, n_j); `drive` is |H_qq| (n_f,) in m/N.
    """

    name: str
    x: RealArray
    cost: float
    stiffness: ComplexArray
    std: RealArray
    amplitude: RealArray
    drive: RealArray


def fit_place(name: str, local: LocalElements, data: LevelData, x: RealArray) -> PlaceFit | None:
    """Return the fit of one place from linear unknowns x; None if it has no effect."""
    bounds = data.part.coordinates.bounds

    def evaluate(x: RealArray) -> Local | None:
        try:
            return _project(data, _receptances(local, data, x, derivatives=True), x)
        except SolverError:
            return None

    cost = None
    if len(x):
        if evaluate(x) is None:
            return None
        settings = make_descent(LOCATION.place_steps)
        outcome = settings.minimise(evaluate, x, *bounds)
        x, cost = outcome.x, outcome.local.cost
    H, _ = _receptances(local, data, x, derivatives=False)
    a, r = _weighted(data, H)
    if not a.any():
        return None
    size = _squares(a)
    z = _best_force(a, size, r)
    if cost is None:
        cost = 0.5 * float(np.sum(np.abs(r - a * z[:, :, None]) ** 2))
    Hqf, Hqq = H[:, 0, 1:], H[:, 0, :1]
    moved = Hqf - Hqq * z
    tiny = np.finfo(np.float64).tiny
    moved = np.where(np.abs(moved) > 0.0, moved, tiny)
    std = np.abs(Hqf) / np.abs(moved) ** 2 * np.sqrt(2.0 / size)
    amplitude = np.abs(moved) * data.levels[:, :, None]
    return PlaceFit(name, x, cost, z / moved, std, amplitude, np.abs(Hqq[:, 0]))


def linear_local(data: LevelData, x: RealArray) -> Local | None:
    """Return the least-squares problem of the linear model without an element at x."""
    none = LocalElements((), np.zeros(0, dtype=np.intp), np.zeros((0, 0)), *_NO_UNKNOWNS)
    try:
        H, dH = _receptances(none, data, x, derivatives=len(x) > 0)
    except SolverError:
        return None
    r = data.weights * (H - data.receptances)
    columns = [] if dH is None else [data.weights * one for one in dH]
    return _reduce(data, r, columns, x)


_NO_UNKNOWNS = (np.zeros(0, dtype=np.intp), (), ())


def _receptances(
    local: LocalElements, data: LevelData, x: RealArray, *, derivatives: bool
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return H (n_f, n_e + n_i, n_e + n_j) and dH (n, ...) by the coordinates x."""
    part = data.part
    found = ElementReceptances.of(local, part, x, np.ones(1), derivatives=derivatives)
    dH = None
    if found.dH is not None:
        dH = found.dH[:, :, 0] * part.coordinates.slope(x)[:, None, None, None]
    return found.H[:, 0], dH


def _weighted(data: LevelData, H: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the weighted effect of z and the residual without it, (n_l, n_f, n_i, n_j) each."""
    a = data.weights * H[:, 1:, :1]
    return np.asarray(a), np.asarray(data.weights * (H[:, 1:, 1:] - data.receptances))


def _squares(a: ComplexArray) -> RealArray:
    """Return the sum of squares over the responses, (n_l, n_f, n_j), above 0."""
    return np.maximum(np.sum(np.abs(a) ** 2, axis=2), np.finfo(np.float64).tiny)


def _best_force(a: ComplexArray, size: RealArray, values: ComplexArray) -> ComplexArray:
    """Return the z with which `a` z is nearest to values, (n_l, n_f, n_j)."""
    return np.asarray(np.einsum("lfij,lfij->lfj", a.conj(), values) / size)


def _project(
    data: LevelData, found: tuple[ComplexArray, ComplexArray | None], x: RealArray
) -> Local:
    """Return the least-squares problem in the linear unknowns, with the best z."""
    H, dH = found
    a, r = _weighted(data, H)
    size = _squares(a)

    def project(values: ComplexArray) -> ComplexArray:
        return np.asarray(values - a * _best_force(a, size, values)[:, :, None])

    z = _best_force(a, size, r)[:, :, None]
    columns = [
        project(data.weights * (one[:, 1:, 1:] - one[:, 1:, :1] * z))
        for one in ([] if dH is None else dH)
    ]
    return _reduce(data, project(r), columns, x)


def _reduce(
    data: LevelData, r: ComplexArray, columns: Sequence[ComplexArray], x: RealArray
) -> Local:
    """Return the least-squares problem of residuals and priors."""
    coordinates = data.part.coordinates
    stacked = np.stack([*columns, r]).reshape(len(columns) + 1, -1)
    block = np.concatenate([stacked.real, stacked.imag], axis=1).T
    centre, weight = coordinates.prior
    prior = np.column_stack([np.diag(weight), weight * (x - centre)])
    return reduce_blocks([block, prior[weight > 0.0]], len(columns))
