"""`Forward`: how the FRF of a part and its derivatives are computed.

A linear model has one FRF, whatever the force. That of a model with nonlinear elements belongs to
the force amplitude of the data: `PeriodicForward` solves the harmonic balance, `EquivalentForward`
replaces each element by its describing function at a given amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from updyn import sensitivity
from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import State
from updyn.dynamics.fields import FieldSolver, split_into_blocks
from updyn.dynamics.periodic.at_lines import LineBalance, LineEvaluation
from updyn.dynamics.periodic.balance import make_fourier
from updyn.dynamics.periodic.fourier import Fourier
from updyn.dynamics.periodic.settings import LINE_BALANCE
from updyn.errors import DataError, SolverError
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.over_lines import describe_first_harmonic
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.sensitivity import Unknowns
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.settings import LEVELS

if TYPE_CHECKING:
    from updyn.updating.problem.problem import FRFPart

__all__ = [
    "LINEAR",
    "ElementReceptances",
    "EquivalentForward",
    "Forward",
    "LinearForward",
    "LocalElements",
    "PeriodicForward",
    "choose_forward",
]

#: H (n_f, n_i, n_j) in m/N, and dH (n_p, n_f, n_i, n_j) by the optimiser's coordinates.
Receptances = tuple[ComplexArray, ComplexArray | None]


class Forward(Protocol):
    """Receptances of a part between its responses and references, without their signs."""

    @property
    def is_linear(self) -> bool:
        """Whether the receptances are those of the part's solver."""

    @property
    def is_whole(self) -> bool:
        """Whether all lines are evaluated at once."""

    @property
    def dofs(self) -> IndexArray:
        """DOFs of the model whose motion and forces are needed in addition to the channels."""

    def solved_lines(self, freq: RealArray) -> RealArray:
        """Return the frequencies in Hz at which the linear model is solved for some lines."""

    def key(self, frf: FRF) -> list[object]:
        """Return the part of a cache key that tells evaluations of one model apart."""

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines.

        Their derivatives are multiplied by `rate`, shape (n_f,).
        """


@dataclass(frozen=True, slots=True)
class LinearForward:
    """The receptances of a linear model."""

    is_linear: ClassVar[bool] = True
    is_whole: ClassVar[bool] = False

    @property
    def dofs(self) -> IndexArray:
        """No further DOFs."""
        return np.zeros(0, dtype=np.intp)

    def solved_lines(self, freq: RealArray) -> RealArray:
        """Return the lines."""
        return freq

    def key(self, frf: FRF) -> list[object]:
        """Return nothing: the solver and the unknowns define the receptances."""
        return []

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines."""
        return sensitivity.receptance(
            part.solver,
            part.unknowns,
            part.values(x),
            part.frf.freq[lines],
            part.rows,
            part.columns,
            derivatives=derivatives,
            lines=part.frf.freq,
            weights=part.coordinates.slope(x)[:, None] * rate,
        )


LINEAR = LinearForward()


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
        n = len(self.elements)
        if len(part.rows) < n:
            return None
        H = ElementReceptances.of(self, part, x, np.ones(1), derivatives=False).H[:, 0]
        motion, level = self._motion(part), _level(part.frf)[:, None, None]
        T = _solve_least_squares(H[:, n:, :n], level * H[:, n:, n:] - motion)
        return np.abs(level * H[:, :n, n:] - H[:, :n, :n] @ T)

    @staticmethod
    def _motion(part: FRFPart) -> ComplexArray:
        """Return the measured displacements in m, without the signs of sensors, (n_f, n_i, n_j)."""
        frf = part.frf
        rate = (frf.s**frf.power)[:, None, None]
        return np.asarray(frf.values * part.sign / rate * _level(frf)[:, None, None])


def _solve_least_squares(A: ComplexArray, B: ComplexArray) -> ComplexArray:
    """Return the least-squares solutions of stacked systems A X = B, of least length."""
    U, size, Vh = np.linalg.svd(A, full_matrices=False)
    least = max(A.shape[-2:]) * np.finfo(float).eps * size[..., :1]
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > least)
    along = np.conj(U).swapaxes(-1, -2) @ B
    return np.asarray(np.conj(Vh).swapaxes(-1, -2) @ (inverse[..., None] * along))


def choose_forward(model: Model, frf: FRF, parameters: ParameterSet) -> Forward:
    """Return the forward problem of a model at the level of some data.

    Data that state no level are those of vanishing amplitude.
    """
    if not model.nonlinear:
        return LINEAR
    if frf.quantity == TRANSMISSIBILITY:
        raise DataError(
            "a model with nonlinear elements responds differently at each level, which a"
            " transmissibility does not state; supply FRFs of motion over force"
        )
    if frf.decay:
        raise DataError("level: expected no exponential window in the data of a sine test")
    if frf.is_random:
        raise DataError(
            "excitation: the data are of a random force; a model with nonlinear elements is"
            " compared with FRFs of a sine. Expected tests with a sine, or a linear model",
            key=("excitation",),
        )
    local = LocalElements.find(model, parameters)
    if frf.level is None:
        return EquivalentForward.at_rest(local, frf)
    return PeriodicForward(local)


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
        H, dH = _receptances(local, part.solver, part.unknowns, values, freq, channels, derivatives)
        shape = len(part.frf.freq), len(moving)
        H = H.reshape(*shape, *H.shape[1:])
        if dH is not None:
            dH = dH.reshape(len(dH), *shape, *dH.shape[2:])
        if len(moving) < len(k):
            H0, dH0 = _static(local, part, values, derivatives)
            mean = np.broadcast_to(H0, (shape[0], 1, *H.shape[2:]))
            H = np.concatenate([mean, H], axis=1)
            if dH is not None and dH0 is not None:
                still = np.broadcast_to(dH0[:, None], (len(dH), shape[0], 1, *H.shape[2:]))
                dH = np.concatenate([still, dH], axis=2)
        return cls(H, dH)


def _receptances(
    local: LocalElements,
    solver: FieldSolver,
    unknowns: Unknowns,
    values: RealArray,
    freq: RealArray,
    channels: tuple[IndexArray, IndexArray],
    derivatives: bool,
) -> tuple[ComplexArray, ComplexArray | None]:
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
            lines=freq,
        )
        found.append(_to_deformations(local.weights, H, n))
        if dH is not None:
            slopes.append(_to_deformations(local.weights, dH, n))
    return np.concatenate(found), np.concatenate(slopes, axis=1) if slopes else None


def _to_deformations(W: RealArray, H: ComplexArray, n: int) -> ComplexArray:
    """Return receptances (..., n_e + n_i, n_e + n_j) from those of the first n moved DOFs."""
    rows = np.concatenate([W.T @ H[..., :n, :], H[..., n:, :]], axis=-2)
    return np.concatenate([rows[..., :n] @ W, rows[..., n:]], axis=-1)


def _static(
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
    return _receptances(local, solver, still, values, np.zeros(1), channels, derivatives)


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentForward:
    """The receptances with each element replaced by its describing function.

    `amplitudes` are those of the deformations at the lines `freq`, (n, n_e, n_j) in m (rad);
    between them, they are interpolated.
    """

    local: LocalElements
    freq: RealArray
    amplitudes: RealArray

    is_linear: ClassVar[bool] = False
    is_whole: ClassVar[bool] = True

    @classmethod
    def at_rest(cls, local: LocalElements, frf: FRF) -> EquivalentForward:
        """Return the receptances at vanishing amplitude."""
        shape = 1, len(local.elements), len(frf.references)
        return cls(local, frf.freq[:1], np.full(shape, LEVELS.vanishing_amplitude))

    @property
    def dofs(self) -> IndexArray:
        """DOFs of the elements."""
        return self.local.dofs

    def solved_lines(self, freq: RealArray) -> RealArray:
        """Return the lines."""
        return freq

    def key(self, frf: FRF) -> list[object]:
        """Return the amplitudes."""
        return ["equivalent", self.freq, self.amplitudes]

    def _interpolate(self, freq: RealArray) -> RealArray:
        flat = self.amplitudes.reshape(len(self.freq), -1).T
        out = np.stack([np.interp(freq, self.freq, row) for row in flat], axis=1)
        return out.reshape(len(freq), *self.amplitudes.shape[1:])

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines."""
        k = np.ones(1)
        found = ElementReceptances.of(self.local, part, x, k, derivatives=derivatives)
        n, elements = len(self.local.elements), self.local.at(part.values(x))
        omega = 2.0 * np.pi * part.frf.freq
        amplitudes = self._interpolate(part.frf.freq)
        H, dH = found.H[:, 0], None if found.dH is None else found.dH[:, :, 0]
        out, slopes = [], []
        for j in range(len(part.columns)):
            N, dN = _describe(elements, amplitudes[:, :, j], omega)
            J = np.eye(n) + H[:, :n, :n] * N[:, None, :]
            Q = np.linalg.solve(J, H[:, :n, n + j, None])[:, :, 0]
            F = N * Q
            out.append(H[:, n:, n + j] - np.einsum("fie,fe->fi", H[:, n:, :n], F))
            if dH is None:
                continue
            direct = dH[:, :, :, n + j] - np.einsum("pfoe,fe->pfo", dH[..., :n], F)
            by_element = [
                -H[:, :, e] * (dN[e][:, column] * Q[:, e])[:, None]
                for e, column in self.local.places
            ]
            right = _place_by_owner(direct, by_element, self.local.owners)
            dQ = np.linalg.solve(J, right[:, :, :n].transpose(1, 2, 0)).transpose(2, 0, 1)
            moved = np.einsum("fie,pfe->pfi", H[:, n:, :n], N * dQ)
            slopes.append(right[:, :, n:] - moved)
        return _stack(part, x, lines, rate, out, slopes)


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicForward:
    """The first harmonic of the periodic response at the level of the data.

    At a line with several solutions, the stable one nearest to the measured values is used.
    """

    local: LocalElements

    is_linear: ClassVar[bool] = False
    is_whole: ClassVar[bool] = True

    @property
    def dofs(self) -> IndexArray:
        """DOFs of the elements."""
        return self.local.dofs

    @property
    def fourier(self) -> Fourier:
        """Transforms of the harmonics: odd ones if all elements are odd."""
        return make_fourier(
            is_free=self.local.are_odd,
            harmonics=LINE_BALANCE.harmonics,
            samples=LINE_BALANCE.samples,
        )

    def solved_lines(self, freq: RealArray) -> RealArray:
        """Return the harmonics of the lines."""
        return np.unique(np.outer(self.fourier.harmonics, freq))

    def key(self, frf: FRF) -> list[object]:
        """Return the level."""
        return ["periodic", _level(frf)]

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines."""
        found = self._linear(part, x, derivatives=derivatives)
        n = len(self.local.elements)
        out, slopes = [], []
        for j in range(len(part.columns)):
            balance, now = self._solve(part, x, found, j)
            out.append(balance.respond(now, np.arange(len(balance.omega))))
            if found.dH is not None:
                inputs = [*range(n), n + j]
                direct, by_element = balance.derive(now, found.dH[..., inputs], self.local.places)
                slopes.append(_place_by_owner(direct, list(by_element), self.local.owners))
        return _stack(part, x, lines, rate, out, slopes)

    def amplitudes(self, part: FRFPart, x: RealArray) -> RealArray:
        """Return the amplitudes of the deformations at all lines, (n_f, n_e, n_j) in m (rad)."""
        found, first = self._linear(part, x, derivatives=False), self.fourier.first
        out = []
        for j in range(len(part.columns)):
            balance, now = self._solve(part, x, found, j)
            coordinates = now.x.reshape(-1, now.x.shape[2])
            Q = balance.fourier.to_complex(coordinates)[:, first]
            out.append(np.abs(Q).reshape(now.x.shape[:2]))
        return np.stack(out, axis=2)

    def _linear(self, part: FRFPart, x: RealArray, *, derivatives: bool) -> ElementReceptances:
        k = self.fourier.harmonics.astype(np.float64)
        return ElementReceptances.of(self.local, part, x, k, derivatives=derivatives)

    def _solve(
        self, part: FRFPart, x: RealArray, found: ElementReceptances, j: int
    ) -> tuple[LineBalance, LineEvaluation]:
        """Return the balance with one force and its solution at each line."""
        n = len(self.local.elements)
        elements = self.local.at(part.values(x))
        omega, level = 2.0 * np.pi * part.frf.freq, _level(part.frf)
        balance = LineBalance(
            elements, self.fourier, omega, level, found.H[..., [*range(n), n + j]]
        )
        lines = np.arange(len(omega))
        x = np.zeros((len(omega), n, balance.fourier.size))
        best = np.full(len(omega), np.inf)

        def compare(candidate: RealArray, at: IndexArray) -> None:
            if not len(at):
                return
            now = balance.evaluate(candidate, at)
            distance = _distances(part, balance.respond(now, at), j, at)
            distance = np.where(balance.is_stable(now), distance, distance + LEVELS.unstable)
            nearer = distance < best[at]
            x[at[nearer]], best[at[nearer]] = candidate[nearer], distance[nearer]

        for candidate, is_solved in balance.find_all():
            compare(candidate[is_solved], lines[is_solved])
        if not np.isfinite(best).all():
            missing = part.frf.freq[int(np.argmin(np.isfinite(best)))]
            raise SolverError(f"no periodic response was found at {missing:g} Hz")
        tried: set[tuple[int, int, float]] = set()
        for _ in range(LINE_BALANCE.jump_passes):
            before, jumps = best.sum(), balance.jumps(x)
            for at, source in ((jumps + 1, jumps), (jumps, jumps + 1)):
                # A solution leads to the same one at the next line again.
                moves = list(zip(at.tolist(), source.tolist(), best[source].tolist(), strict=True))
                is_new = np.array([move not in tried for move in moves], dtype=np.bool_)
                is_new &= best[at] > LEVELS.far
                tried.update(moves)
                at, source = at[is_new], source[is_new]
                candidate, is_solved = balance.move(x[source], source, at)
                compare(candidate[is_solved], at[is_solved])
            if best.sum() == before:
                break
        return balance, balance.evaluate(x, lines)


def _level(frf: FRF) -> RealArray:
    """Return the force amplitude of each line; DataError if the data do not state it."""
    if frf.level is None:
        raise DataError(
            "a model with nonlinear elements responds differently at each force amplitude; state"
            " the level of the data",
            key=("level",),
        )
    return frf.level


def _distances(part: FRFPart, H: ComplexArray, j: int, at: IndexArray) -> RealArray:
    """Return the relative distance of responses (k, n_i) from those measured at lines, (k,)."""
    frf = part.frf
    H = H * part.sign[:, j] * (frf.s[at] ** frf.power)[:, None]
    measured = frf.values[at, :, j]
    size = np.abs(H) ** 2 + np.abs(measured) ** 2
    share = np.abs(H - measured) ** 2 / np.maximum(size, np.finfo(np.float64).tiny)
    return np.asarray(share.mean(axis=1))


def _describe(
    elements: Sequence[NonlinearElement], amplitudes: RealArray, omega: RealArray
) -> tuple[ComplexArray, list[ComplexArray]]:
    """Return describing functions over the deformation, (n_f, n_e), and their derivatives."""
    samples = LINE_BALANCE.samples
    found = [
        describe_first_harmonic(element, amplitudes[:, e], omega, samples)
        for e, element in enumerate(elements)
    ]
    return np.stack([value for value, _ in found], axis=1), [slopes for _, slopes in found]


def _place_by_owner(
    direct: ComplexArray, by_element: Sequence[ComplexArray], owners: IndexArray
) -> ComplexArray:
    """Return derivatives by all unknowns from those by linear ones and by element parameters."""
    out = direct.copy()
    for owner, part in zip(owners.tolist(), by_element, strict=True):
        out[owner] += part
    return out


def _stack(
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
