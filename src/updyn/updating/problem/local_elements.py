"""`LocalElements`: nonlinear elements of a part, and their receptances to the channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from updyn import sensitivity
from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import State
from updyn.dynamics.fields import FieldSolver, split_into_blocks
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.sensitivity import Unknowns
from updyn.updating.problem.parameters import ParameterSet

if TYPE_CHECKING:
    from updyn.updating.problem.problem import FRFPart

__all__ = [
    "ElementForward",
    "ElementReceptances",
    "LocalElements",
    "Receptances",
    "add_element_slopes",
    "find_receptances",
    "find_static_receptances",
    "require_level",
    "stack_references",
]


@dataclass(frozen=True, slots=True, eq=False)
class LocalElements:
    """Nonlinear elements of a model, and the unknowns that are their parameters.

    `dofs` (n_d,) are the moved DOFs of the model, `weights` (n_d, n_e) those of the deformations.
    Unknown `owners[i]` is the parameter `names[i]`, at `places[i]` (element, position).
    """

    elements: tuple[NonlinearElement, ...]
    dofs: IndexArray
    weights: RealArray
    owners: IndexArray
    names: tuple[str, ...]
    places: tuple[tuple[int, int], ...]

    @classmethod
    def find(cls, model: Model, parameters: ParameterSet) -> LocalElements:
        """Return the elements of a model."""
        W = np.stack([local.column(model.dofs) for local in model.nonlinear.values()], axis=1)
        dofs = np.flatnonzero(W.any(axis=1))
        elements = tuple(local.element for local in model.nonlinear.values())
        owners, names, places = [], [], []
        for i, p in enumerate(parameters):
            if p.of_element and p.group in model.nonlinear:
                e = list(model.nonlinear).index(p.group)
                owners.append(i)
                names.append(p.quantity)
                places.append((e, list(list_parameters(elements[e])).index(p.quantity)))
        owner = np.array(owners, dtype=np.intp)
        return cls(elements, dofs, W[dofs], owner, tuple(names), tuple(places))

    @property
    def are_odd(self) -> bool:
        """Whether the forces of all elements change their sign with the motion."""
        return all(element.is_odd for element in self.elements)

    def at(self, values: RealArray) -> list[NonlinearElement]:
        """Return the elements at values of the unknowns, shape (n,)."""
        changes: list[dict[str, float]] = [{} for _ in self.elements]
        for owner, name, (e, _) in zip(self.owners, self.names, self.places, strict=True):
            changes[e][name] = float(values[owner])
        return [change_parameters(*pair) for pair in zip(self.elements, changes, strict=True)]

    def measured(self, part: FRFPart) -> tuple[RealArray, BoolArray]:
        """Return the measured amplitudes of the deformations, (n_f, n_e, n_j), and which are known.

        A deformation is measured if all its DOFs are responses.
        """
        motion = self._motion(part)
        place = {int(dof): i for i, dof in enumerate(part.rows)}
        at = np.array([place.get(int(dof), -1) for dof in self.dofs])
        known = ~((self.weights != 0.0) & (at < 0)[:, None]).any(axis=0)
        return np.abs(np.einsum("de,fdj->fej", self.weights, motion[:, at])), known

    def reconstructed(self, part: FRFPart, x: RealArray) -> RealArray | None:
        """Return the amplitudes of the deformations from the measured motion and the linear model.

        The forces of the elements follow from the responses by least squares; None if there are
        fewer responses than elements.
        """
        if len(part.rows) < len(self.elements):
            return None
        H = ElementReceptances.of(self, part, x, np.ones(1), derivatives=False).H[:, 0]
        return np.abs(self.estimate(part, H))

    def estimate(self, part: FRFPart, H: ComplexArray) -> ComplexArray:
        """Return the deformations (n_f, n_e, n_j) from the measured motion and the receptances."""
        n = len(self.elements)
        motion, level = self._motion(part), require_level(part.frf)[:, None, None]
        T = _solve_least_squares(H[:, n:, :n], level * H[:, n:, n:] - motion)
        return np.asarray(level * H[:, :n, n:] - H[:, :n, :n] @ T)

    @staticmethod
    def _motion(part: FRFPart) -> ComplexArray:
        """Return the measured displacements in m, without the signs of sensors, (n_f, n_i, n_j)."""
        frf = part.frf
        rate = (frf.s**frf.power)[:, None, None]
        return np.asarray(frf.values * part.sign / rate * require_level(frf)[:, None, None])


@dataclass(frozen=True, slots=True, eq=False)
class ElementForward:
    """Base of the forward problems of models with nonlinear elements."""

    local: LocalElements

    is_linear: ClassVar[bool] = False
    is_whole: ClassVar[bool] = True

    @property
    def dofs(self) -> IndexArray:
        """DOFs of the elements."""
        return self.local.dofs

    def solved_lines(self, frf: FRF) -> RealArray:
        """Return the lines."""
        return frf.freq


def _solve_least_squares(A: ComplexArray, B: ComplexArray) -> ComplexArray:
    """Return the least-squares solutions of stacked systems A X = B, of least length."""
    U, size, Vh = np.linalg.svd(A, full_matrices=False)
    least = max(A.shape[-2:]) * np.finfo(float).eps * size[..., :1]
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > least)
    along = np.conj(U).swapaxes(-1, -2) @ B
    return np.asarray(np.conj(Vh).swapaxes(-1, -2) @ (inverse[..., None] * along))


@dataclass(frozen=True, slots=True, eq=False)
class ElementReceptances:
    """Receptances of the linear model at harmonics: deformations and responses, over forces.

    `H`, (n_f, n_h, n_e + n_i, n_e + n_j), and `dH`, (n_p, ...), per unit of each unknown.
    """

    H: ComplexArray
    dH: ComplexArray | None  # noqa: N815

    @classmethod
    def of(
        cls, local: LocalElements, part: FRFPart, x: RealArray, k: RealArray, *, derivatives: bool
    ) -> ElementReceptances:
        """Return the receptances at harmonics k of all lines; 0 is the mean."""
        values, moving = part.values(x), k[k > 0]
        freq = (part.frf.freq[:, None] * moving).ravel()
        channels = part.rows, part.columns
        H, dH = find_receptances(
            local, part.solver, part.unknowns, values, freq, channels, derivatives
        )
        shape = len(part.frf.freq), len(moving)
        H = H.reshape(*shape, *H.shape[1:])
        if dH is not None:
            dH = dH.reshape(len(dH), *shape, *dH.shape[2:])
        if len(moving) < len(k):
            H0, dH0 = find_static_receptances(local, part, values, derivatives)
            mean = np.broadcast_to(H0, (shape[0], 1, *H.shape[2:]))
            H = np.concatenate([mean, H], axis=1)
            if dH is not None and dH0 is not None:
                still = np.broadcast_to(dH0[:, None], (len(dH), shape[0], 1, *H.shape[2:]))
                dH = np.concatenate([still, dH], axis=2)
        return cls(H, dH)


def find_receptances(
    local: LocalElements,
    solver: FieldSolver,
    unknowns: Unknowns,
    values: RealArray,
    freq: RealArray,
    channels: tuple[IndexArray, IndexArray],
    derivatives: bool,
    lines: RealArray | None = None,
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return receptances of deformations and channels, and their derivatives by unknowns.

    Their shapes are (n_f, n_e + n_i, n_e + n_j) and (n_p, ...). The way of solving depends on
    `lines` in Hz, by default those of `freq`.
    """
    rows, columns = (np.concatenate([local.dofs, dofs]) for dofs in channels)
    n = len(local.dofs)
    found, slopes = [], []
    size = solver.block_size(len(rows) + len(columns))
    for block in split_into_blocks(len(freq), size):
        H, dH = sensitivity.receptance(
            solver,
            unknowns,
            values,
            freq[block],
            rows,
            columns,
            derivatives=derivatives,
            lines=freq if lines is None else lines,
        )
        found.append(_to_deformations(local.weights, H, n))
        if dH is not None:
            slopes.append(_to_deformations(local.weights, dH, n))
    return np.concatenate(found), np.concatenate(slopes, axis=1) if slopes else None


def _to_deformations(W: RealArray, H: ComplexArray, n: int) -> ComplexArray:
    """Return receptances (..., n_e + n_i, n_e + n_j) from those of the first n moved DOFs."""
    rows = np.concatenate([W.T @ H[..., :n, :], H[..., n:, :]], axis=-2)
    return np.concatenate([rows[..., :n] @ W, rows[..., n:]], axis=-1)


def find_static_receptances(
    local: LocalElements, part: FRFPart, values: RealArray, derivatives: bool
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return the receptances at 0 Hz: structural damping acts on motion only."""
    solver, unknowns = part.solver, part.unknowns
    start = solver.system.start
    real = replace(solver.system, start=State(start.factor, np.zeros_like(start.loss), start.rate))
    kept = unknowns.scales
    still = replace(
        unknowns,
        owner=unknowns.owner[kept],
        at=unknowns.at[kept],
        number=unknowns.number[kept],
        power=unknowns.power[kept],
    )
    solver = replace(solver, system=real)  # type: ignore[type-var]
    channels = part.rows, part.columns
    return find_receptances(local, solver, still, values, np.zeros(1), channels, derivatives)


def require_level(frf: FRF) -> RealArray:
    """Return the force amplitude of each line; DataError if the data do not state it."""
    if frf.level is None:
        raise DataError(
            "a model with nonlinear elements responds differently at each force amplitude; state"
            " the level of the data",
            key=("level",),
        )
    return frf.level


def add_element_slopes(
    direct: ComplexArray, by_element: Sequence[ComplexArray], owners: IndexArray
) -> ComplexArray:
    """Return derivatives by all unknowns from those by linear ones and by element parameters."""
    out = direct.copy()
    for owner, part in zip(owners.tolist(), by_element, strict=True):
        out[owner] += part
    return out


#: H (n_f, n_i, n_j) in m/N, and dH (n_p, n_f, n_i, n_j) by the optimiser's coordinates.
Receptances = tuple[ComplexArray, ComplexArray | None]


def stack_references(
    part: FRFPart,
    x: RealArray,
    lines: slice,
    rate: ComplexArray,
    out: Sequence[ComplexArray],
    slopes: Sequence[ComplexArray],
) -> Receptances:
    """Return the receptances of all references at a block of lines."""
    H = np.stack(out, axis=2)[lines]
    if not slopes:
        return H, None
    dH = np.stack(slopes, axis=3)[:, lines]
    weights = part.coordinates.slope(x)[:, None] * rate
    return H, dH * weights[:, :, None, None]
