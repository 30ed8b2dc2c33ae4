"""The forces of elements at several places, of any kind, from the responses.

Elements on the deformations u exert the forces -z F on a structure that a force F excites. With
the receptances of the linear model between responses (r), deformations (q) and force (f),

    H = H_rf - H_rq z,    u / F = H_qf - H_qq z,

so that the z of each line, level and force follow from the responses by linear least squares,
whatever the kinds of the elements (Noel & Kerschen, Mech. Syst. Signal Process. 83 (2017) 2,
section 4). The residual ranks the places. Linear unknowns are fitted together with all z by
variable projection (Kaufman, BIT 15 (1975) 49). The describing function of element e is z_e F / u_e
at the amplitude |u_e|.

Elements of the model to which a candidate is added keep their places. Their forces are estimated,
too, with those of the fitted model as priors: its errors do not move the candidate then.
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

__all__ = ["ExpectedForces", "MeasuredElement", "PlaceFit", "PlaceProblem", "linear_local"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredElement:
    """Force and deformation of an element of any kind.

    `stiffness`, the describing function, `std`, its standard deviation, and `amplitude`, that of
    the deformation in m, have the shape (n_l, n_f, n_j); `drive` is |H_qq| (n_f,) in m/N.
    """

    stiffness: ComplexArray
    std: RealArray
    amplitude: RealArray
    drive: RealArray

    @classmethod
    def of(
        cls,
        z: ComplexArray,
        std: RealArray,
        moved: ComplexArray,
        drive: ComplexArray,
        levels: RealArray,
    ) -> MeasuredElement:
        """Return the element with a force z and a deformation `moved` over F.

        A deformation whose noise is large is replaced by that without the force of the element.
        """
        H = drive[:, None]
        unloaded = moved + H * z
        is_noisy = np.abs(H) * std > LOCATION.noisy_amplitude * np.abs(moved)
        u = np.where(is_noisy, unloaded, moved)
        u = np.where(np.abs(u) > 0.0, u, np.finfo(np.float64).tiny)
        with np.errstate(over="ignore"):
            error = std * np.abs(unloaded) / np.abs(u) ** 2
        return cls(np.asarray(z / u), error, np.abs(u) * levels[:, :, None], np.abs(drive))


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedForces:
    """Forces z of the elements of a model, and their standard deviations, (n_l, n_f, n_j, n_b)."""

    z: ComplexArray
    std: RealArray

    @property
    def weights(self) -> RealArray:
        """Square roots of 2 / E|dz|^2."""
        return np.asarray(np.sqrt(2.0) / self.std)


@dataclass(frozen=True, slots=True, eq=False)
class PlaceFit:
    """An element of any kind at one place, in addition to those of the model.

    `x` (n,) are the linear unknowns and `cost` half the weighted sum of squares. `others` are the
    elements of the model.
    """

    problem: PlaceProblem
    x: RealArray
    cost: float
    element: MeasuredElement
    others: tuple[MeasuredElement, ...] = ()

    @property
    def name(self) -> str:
        """Name of the place."""
        return self.problem.name


@dataclass(frozen=True, slots=True, eq=False)
class PlaceProblem:
    """The data with an element of any kind at one place.

    `local` are the elements of the model, whose forces are expected, and, last, one at the place.
    """

    name: str
    local: LocalElements
    data: LevelData
    expected: ExpectedForces | None = None

    def fit(self, x: RealArray) -> PlaceFit | None:
        """Return the fit of the linear unknowns from x; None if the element has no effect."""
        if not len(x):
            return self.at(x)
        if self._project(x) is None:
            return None
        settings = make_descent(LOCATION.place_steps)
        bounds = self.data.part.coordinates.bounds
        return self.at(settings.minimise(self._project, x, *bounds).x)

    def at(self, x: RealArray) -> PlaceFit | None:
        """Return the forces at linear unknowns x; None if the element has no effect."""
        data, n = self.data, len(self.local.elements)
        try:
            H, _, forces, r = self._evaluate(x, derivatives=False)
        except SolverError:
            return None
        if not forces.effect[..., -1].any():
            return None
        centre, weight = data.part.coordinates.prior
        squares = np.sum(np.abs(forces.project(r)) ** 2) + np.sum((weight * (x - centre)) ** 2)
        found = _describe(H[:, :n], forces.solve(r), forces.deviations, data.levels)
        return PlaceFit(self, x, 0.5 * float(squares), found[-1], found[:-1])

    def square_residual(self, x: RealArray) -> RealArray:
        """Return squared residuals with the best forces at x, (n_l, n_f, n_i, n_j) in m2/N2.

        Each is divided by the share of its variance that remains next to free forces.
        """
        data, n_i = self.data, self.data.receptances.shape[2]
        _, _, forces, r = self._evaluate(x, derivatives=False)
        share = 1.0 - np.sum(np.abs(forces.U[..., :n_i, :]) ** 2, axis=-1)
        # Free forces fit a channel with a small share almost exactly, whatever its noise.
        found = np.abs(forces.project(r)[..., :n_i]) ** 2 / np.maximum(share, 1.0 / n_i)
        weights = data.weights.transpose(0, 1, 3, 2)
        safe = np.where(weights > 0.0, weights, 1.0)
        return np.asarray((found / safe**2).transpose(0, 1, 3, 2))

    def _project(self, x: RealArray) -> Local | None:
        """Return the least-squares problem in the linear unknowns, with the best forces."""
        data, n = self.data, len(self.local.elements)
        try:
            _, dH, forces, r = self._evaluate(x, derivatives=True)
        except SolverError:
            return None
        z = forces.solve(r)
        columns = []
        for one in [] if dH is None else dH:
            moved = one[:, n:, n:].transpose(0, 2, 1)
            moved = moved - np.einsum("fie,lfje->lfji", one[:, n:, :n], z)
            moved *= data.weights.transpose(0, 1, 3, 2)
            rest = np.zeros((*moved.shape[:3], r.shape[-1] - moved.shape[-1]))
            columns.append(forces.project(np.concatenate([moved, rest], axis=-1)))
        return _reduce(data, forces.project(r), columns, x)

    def _evaluate(
        self, x: RealArray, *, derivatives: bool
    ) -> tuple[ComplexArray, ComplexArray | None, _Forces, ComplexArray]:
        """Return H, dH, the problem of the forces, and the residual without forces."""
        n = len(self.local.elements)
        H, dH = _receptances(self.local, self.data, x, derivatives=derivatives)
        forces = _Forces.of(_weight(self.data, self.expected, H[:, n:, :n]))
        return H, dH, forces, _residual(self.data, self.expected, H, n)


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


@dataclass(frozen=True, slots=True, eq=False)
class _Forces:
    """Least squares for the forces z (n_l, n_f, n_j, n_e) from residuals (n_l, n_f, n_j, n_i).

    `effect` (n_l, n_f, n_j, n_i, n_e) is that of z, weighted; U, s and Vh are its singular vectors
    and values.
    """

    effect: ComplexArray
    U: ComplexArray
    s: RealArray
    Vh: ComplexArray

    @classmethod
    def of(cls, effect: ComplexArray) -> _Forces:
        """Return the problem."""
        U, s, Vh = np.linalg.svd(effect, full_matrices=False)
        is_none = s <= LOCATION.least_effect * s[..., :1]
        return cls(effect, np.where(is_none[..., None, :], 0.0, U), s, Vh)

    @property
    def deviations(self) -> ComplexArray:
        """Columns whose squares sum to the covariance of z in units of the weighted residual."""
        tiny = np.sqrt(np.finfo(np.float64).tiny)
        return np.asarray(
            np.conj(self.Vh.swapaxes(-1, -2)) / np.maximum(self.s, tiny)[..., None, :]
        )

    def solve(self, r: ComplexArray) -> ComplexArray:
        """Return the z with which the effect is nearest to residuals."""
        along = np.einsum("...ik,...i->...k", self.U.conj(), r)
        return np.asarray(np.einsum("...ek,...k->...e", self.deviations, along))

    def project(self, r: ComplexArray) -> ComplexArray:
        """Return the part of residuals (..., n_l, n_f, n_j, n_i) that no z explains."""
        along = np.einsum("lfjik,...lfji->...lfjk", self.U.conj(), r)
        return np.asarray(r - np.einsum("lfjik,...lfjk->...lfji", self.U, along))


def _weight(data: LevelData, expected: ExpectedForces | None, H: ComplexArray) -> ComplexArray:
    """Return the weighted effect of forces, (n_l, n_f, n_j, n_i, n_e), from H (n_f, n_i, n_e).

    Expected forces are further data after the responses.
    """
    weights = data.weights.transpose(0, 1, 3, 2)
    effect = np.asarray(weights[..., None] * H[None, :, None])
    if expected is None:
        return effect
    n = expected.z.shape[-1]
    rows = np.zeros((*effect.shape[:3], n, n + 1), dtype=np.complex128)
    rows[..., range(n), range(n)] = expected.weights
    return np.concatenate([effect, rows], axis=-2)


def _residual(
    data: LevelData, expected: ExpectedForces | None, H: ComplexArray, n: int
) -> ComplexArray:
    """Return the weighted residual without forces of elements, (n_l, n_f, n_j, n_i)."""
    r = (data.weights * (H[:, n:, n:] - data.receptances)).transpose(0, 1, 3, 2)
    if expected is None:
        return np.asarray(r)
    return np.concatenate([r, expected.weights * expected.z], axis=-1)


def _describe(
    H: ComplexArray, z: ComplexArray, deviations: ComplexArray, levels: RealArray
) -> tuple[MeasuredElement, ...]:
    """Return the elements with receptances H (n_f, n_e, n_e + n_j) and forces z."""
    n = z.shape[-1]
    moved = H[:, :, n:].transpose(0, 2, 1) - np.einsum("fek,lfjk->lfje", H[:, :, :n], z)
    std = np.sqrt(2.0) * np.linalg.norm(deviations, axis=-1)
    return tuple(
        MeasuredElement.of(z[..., e], std[..., e], moved[..., e], H[:, e, e], levels)
        for e in range(n)
    )


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
