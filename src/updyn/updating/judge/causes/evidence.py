"""Model and data at one point of the unknowns, with derivatives of the model."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, DofSet
from updyn.dynamics.affine import State
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.element import Receptances
from updyn.updating.judge.causes.misfit import log_misfit
from updyn.updating.judge.causes.places import mistaken, mistaken_forces
from updyn.updating.judge.causes.rates import rate_slopes, rates_not_sought
from updyn.updating.problem.parameters import Parameter
from updyn.updating.problem.problem import Part
from updyn.updating.problem.session import Record

__all__ = [
    "FEWEST",
    "SMALLEST",
    "Evidence",
    "Held",
    "held_of",
    "labels_of",
    "loosened",
    "plain_labels",
    "spread_of",
    "stacked",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Log misfit (rms) below which a fit is perfect, with or without a fault.
SMALLEST = 1e-3
#: Smallest number of lines with a usable value.
FEWEST = 8
#: Standard deviation of the unknowns about their start: of ln(factor), equal to a factor of 1.5,
#: and of a loss factor.
_FACTOR, _LOSS = 0.4, 0.2
#: Relative step in frequency for finite differences.
_STEP = 1e-5
#: Frequency that replaces 0 Hz, as a share of the lowest other line.
_BESIDE_REST = 1e-3
#: Relative cutoff of the singular values of the changes by the unknowns, in units of their spread.
_ALIKE = 1e-6
#: Largest entry of the normal equations, in which the prior is 1; above it, rounding hides the
#: prior, as for an undamped resonance on a line, e.g. of an unsupported part.
_STEEP = 1e12
#: Loss factor of soft supports, such as foam and rubber cords.
_SOFT_LOSS = 0.05


def plain_labels(dofs: DofSet) -> list[str]:
    """Return the labels of DOFs without signs."""
    pairs = zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True)
    return [f"{node}:{DIRECTIONS[axis]}" for node, axis in pairs]


def labels_of(frf: FRF) -> list[str]:
    """Return the labels of the responses without signs."""
    return plain_labels(frf.responses)


def spread_of(part: Part) -> _Real:
    """Return the standard deviations of the unknowns about their start, as x, shape (n,)."""
    usual = np.where(part.coordinates.parameters.is_factor, _FACTOR, _LOSS)
    given = [p.prior_std for p in part.coordinates.parameters]
    return np.array([u if g is None else g for u, g in zip(usual, given, strict=True)])


@dataclass(frozen=True, slots=True)
class Held(Parameter):
    """A quantity of the model that is not an unknown of the update but may be slightly wrong."""


def held_of(part: Part) -> NDArray[np.bool_]:
    """Return which of the unknowns are held stiffnesses and masses, shape (n,)."""
    own = part.coordinates.parameters
    return np.array([isinstance(p, Held) and p.quantity in ("stiffness", "mass") for p in own])


def loosened(part: Part, x: _Real, group: str, log_factor: float) -> State:
    """Return the model at x with exp(log_factor) times the stiffness of a group."""
    state, terms = part.state(x), part.solver.system.terms
    own = [term.group == group and term.quantity == "stiffness" for term in terms]
    return replace(state, factor=np.where(own, np.exp(log_factor), 1.0) * state.factor)


@dataclass(frozen=True, slots=True, eq=False)
class _Answers:
    """Responses of the model: channels; H, (n_f, n_i, n_j); d ln H / d x, (n, n_f, n_i, n_j)."""

    labels: list[str]
    references: list[str]
    H: _Complex
    slopes: _Complex

    def places(self, frf: FRF) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the indices of the responses and the references of data."""
        rows = [self.labels.index(label) for label in labels_of(frf)]
        columns = [self.references.index(label) for label in plain_labels(frf.references)]
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Model and data at one point.

    Parameters
    ----------
    part : Part
        Model and data of one test, on few lines; the data contain the known variance of their
        noise.
    x : ndarray of float, shape (n,)
        The point.
    """

    part: Part
    x: _Real
    _kept: dict[tuple[str, float], _Complex] = field(default_factory=dict, init=False, repr=False)

    @property
    def frf(self) -> FRF:
        """The data."""
        return self.part.frf

    def _answers(self, labels: list[str], references: list[str]) -> _Answers:
        """Return the model's H and its slopes at responses and references."""
        part = self.part
        shape = (part.n_lines, len(labels), len(references))
        blank = FRF(
            part.frf.freq,
            np.ones(shape),
            labels,
            references,
            part.frf.quantity,
            decay=part.frf.decay,
        )
        there = part.with_data(blank)

        def compute() -> Record:
            found = list(there.each(_block, [(self.x, lines) for lines in there.partition()]))
            return tuple(
                np.concatenate(one, axis=i) for i, one in enumerate(zip(*found, strict=True))
            )

        H, dH = there.recall("derivatives", self.x, compute)
        return _Answers(labels, references, H, np.asarray(dH / np.where(H == 0, 1.0, H)))

    @cached_property
    def _measured(self) -> _Answers:
        return self._answers(labels_of(self.frf), plain_labels(self.frf.references))

    @cached_property
    def _elsewhere(self) -> _Answers:
        """The model's H at the measured responses and at places where these may be instead."""
        further = list(dict.fromkeys(str(place) for _, place in mistaken(self.part)))
        own = self._measured
        more = self._answers(further, own.references)
        return _Answers(
            own.labels + more.labels,
            own.references,
            np.concatenate([own.H, more.H], axis=1),
            np.concatenate([own.slopes, more.slopes], axis=2),
        )

    @cached_property
    def _forced_elsewhere(self) -> _Answers:
        """The model's H for the references and for places at which these may act instead."""
        further = list(dict.fromkeys(str(place) for _, place in mistaken_forces(self.part)))
        own = self._measured
        more = self._answers(own.labels, further)
        return _Answers(
            own.labels,
            own.references + more.references,
            np.concatenate([own.H, more.H], axis=2),
            np.concatenate([own.slopes, more.slopes], axis=3),
        )

    def answer(self, frf: FRF) -> _Complex:
        """Return the model's H at the channels of data, shape (n_f, n_i, n_j)."""
        return self._own if self._has_channels_of(frf) else self._answer(frf)

    @cached_property
    def _own(self) -> _Complex:
        """The model's H at the channels of its data."""
        return self._answer(self.frf)

    def _answer(self, frf: FRF) -> _Complex:
        known = self._answers_for(frf)
        rows, columns = known.places(frf)
        sign = frf.responses.signs[:, None].astype(float) * frf.references.signs
        return np.asarray(known.H[:, rows][:, :, columns] * sign)

    def slopes(self, frf: FRF) -> _Complex:
        """Return d H / d x at the channels of data, shape (n, n_f, n_i, n_j)."""
        known = self._answers_for(frf)
        rows, columns = known.places(frf)
        return np.asarray(known.slopes[:, :, rows][:, :, :, columns] * self.answer(frf))

    def _has_channels_of(self, frf: FRF) -> bool:
        return frf.responses == self.frf.responses and frf.references == self.frf.references

    def _answers_for(self, frf: FRF) -> _Answers:
        """Return the responses of the model that contain the channels of data."""
        known = self._measured
        if not set(labels_of(frf)) <= set(known.labels):
            known = self._elsewhere
        elif not set(plain_labels(frf.references)) <= set(known.references):
            known = self._forced_elsewhere
        return known

    @cached_property
    def by_frequency(self) -> _Complex:
        """Slope d ln H / d f of the model, in 1/Hz, shape (n_f, n_i, n_j)."""
        moving = self.frf.freq[self.frf.freq > 0.0]
        # A line of 0 Hz is moved slightly, because a mobility is zero there and has no logarithm.
        freq = np.maximum(self.frf.freq, _BESIDE_REST * moving.min(initial=1.0))
        low, high = (
            self.part.with_data(replace(self.frf, freq=freq * factor)).responses(self.x)
            for factor in (1.0 - _STEP, 1.0 + _STEP)
        )
        return np.asarray(_log_ratio(high, low) / (2.0 * _STEP * freq)[:, None, None])

    def damped(self, rate: float) -> _Complex:
        """Return the model's ln H(i omega + rate) / H(i omega), shape (n_f, n_i, n_j)."""
        windowed = replace(self.frf, decay=self.frf.decay + rate)
        return self._compared("damped", rate, windowed)

    def stretched(self, log_factor: float) -> _Complex:
        """Return the model's ln A(exp(log_factor) f) / A(f), shape (n_f, n_i, n_j).

        A is the accelerance. The ratio is also that of a model with exp(-2 log_factor) times all
        stiffnesses to the model itself.
        """
        elsewhere = replace(self.frf, freq=self.frf.freq * np.exp(log_factor))
        power = QUANTITIES["accelerance"] - QUANTITIES[self.frf.quantity]
        return self._compared("stretched", log_factor, elsewhere) + power * log_factor

    def _compared(self, kind: str, value: float, there: FRF) -> _Complex:
        """Return the model's ln H on other lines over H, from the cache if known."""
        known = self._kept.get((kind, value))
        if known is None:
            H = self.part.with_data(there).responses(self.x)
            known = self._kept[kind, value] = _log_ratio(H, self.answer(self.frf))
        return known

    def lifted(self, frequency: float) -> _Complex:
        """Return the model's ln H on a suspension over H, shape (n_f, n_i, n_j); `frequency` in Hz.

        K + (2 pi frequency)^2 (1 + i eta) M replaces K, with eta the loss factor of soft supports.
        """
        part, state = self.part, self.part.state(self.x)
        mass = np.array([term.quantity == "mass" for term in part.solver.system.terms])
        square = (2.0 * np.pi * frequency) ** 2 * (1.0 + 1j * _SOFT_LOSS)
        lift = np.where(mass, state.factor * square, 0.0)

        def compute() -> Record:
            return (_log_ratio(_receptance(part, state, lift), _receptance(part, state)),)

        (ratio,) = part.recall("lifted", self.x, compute, np.array(frequency))
        return ratio

    def loosened(self, group: str, log_factor: float) -> _Complex:
        """Return the model's ln H with exp(log_factor) times a group's stiffness over H."""
        part, state = self.part, self.part.state(self.x)
        looser = loosened(part, self.x, group, log_factor)

        def compute() -> Record:
            return (_log_ratio(_receptance(part, looser), _receptance(part, state)),)

        (ratio,) = part.recall("loosened " + group, self.x, compute, np.array(log_factor))
        return ratio

    @cached_property
    def apparent(self) -> _Complex:
        """Drive-point receptance of the model at each response times omega^2, shape (n_f, n_i)."""
        part, n = self.part, len(self.frf.responses)
        shape = (part.n_lines, n, n)
        own = labels_of(self.frf)
        decay = self.frf.decay
        square = FRF(self.frf.freq, np.ones(shape), own, own, "accelerance", decay=decay)
        H = part.with_data(square).responses(self.x)
        return np.asarray(-np.diagonal(H, axis1=1, axis2=2))

    @cached_property
    def receptances(self) -> Receptances:
        """Receptances of the model between all measured DOFs."""
        return Receptances.of(self.part, self.x)

    @property
    def by_unknown(self) -> _Complex:
        """Slopes d ln H / d x of the model, shape (n, n_f, n_i, n_j)."""
        return self._measured.slopes

    @cached_property
    def by_rate(self) -> dict[str, _Complex]:
        """Slopes d ln H / d c for the Rayleigh coefficients c that are not unknowns, by name."""
        return rate_slopes(self.part, self.x, rates_not_sought(self.part))

    @cached_property
    def spread(self) -> _Real:
        """Standard deviations of the unknowns about their start, as x, shape (n,)."""
        return spread_of(self.part)

    @cached_property
    def home(self) -> _Real:
        """Difference of the start of the unknowns from x, in units of their spread, shape (n,)."""
        return np.asarray((self.part.coordinates.home - self.x) / self.spread)

    @cached_property
    def weight(self) -> _Real:
        """Weight of each value, from 0 to 1, shape (n_f, n_i, n_j)."""
        return log_misfit(self.answer(self.frf), self.frf)[1]

    @cached_property
    def silent(self) -> frozenset[str]:
        """Labels of the responses that are noise, in data and model, at nearly all lines.

        A fault of these changes only the level to which other channels are compared.
        """
        clear = (self.weight > 0.0).any(axis=2).sum(axis=0)
        labels = labels_of(self.frf)
        return frozenset(one for one, n in zip(labels, clear, strict=True) if n < FEWEST)

    def misfit(self, frf: FRF) -> _Real:
        """Return the misfit of data on the same lines, real parts above imaginary parts."""
        return stacked(log_misfit(self.answer(frf), frf)[0])

    @cached_property
    def unit(self) -> float:
        """Root mean square of the misfit of the data."""
        e = self.misfit(self.frf)
        return float(np.sqrt(2.0 * e @ e / e.size)) + SMALLEST

    def left(self, frf: FRF, b: _Real) -> _Real:
        """Return the residual after all unknowns have adapted, to first order.

        `frf` has the same lines; its sensors or forces may be at other places. `b`, shape (2 m +
        n,) or (2 m + n, k), is a change of the misfit in units of `unit`, above one of the unknowns
        in units of their spread.
        """
        if self._has_channels_of(frf):
            Q = self._span
            return np.asarray(b - Q @ (Q.T @ b))
        # Few rows differ: exchange their part of the normal equations.
        moved = _differ(self.frf.responses, frf.responses)[:, None]
        moved = moved | _differ(self.frf.references, frf.references)
        there = np.broadcast_to(moved, self.frf.values.shape)
        rows = np.flatnonzero(np.concatenate([there.ravel(), there.ravel()]))
        A = self._columns
        known, (i, j) = self._answers_for(frf), np.nonzero(moved)
        at = known.places(frf)
        slopes = known.slopes[:, :, at[0][i], at[1][j]]
        weight = self.weight[:, moved]
        new = np.stack([stacked(weight * one) for one in slopes], axis=1) / self.unit
        old = A[rows]
        curved = self._normal - old.T @ old + new.T @ new
        spread = self.spread  # in these units the matrix is 1 plus the part of the data
        scaled = spread[:, None] * curved * spread
        if scaled.max() > _STEEP:
            exchanged = A.copy()
            exchanged[rows] = new
            return _outside(exchanged, b)
        pull = spread * (A.T @ b + (new - old).T @ b[rows])
        step = spread * scipy.linalg.solve(scaled, pull, assume_a="pos")
        adapted = A @ step
        adapted[rows] = new @ step
        return np.asarray(b - adapted)

    @cached_property
    def changes(self) -> _Real:
        """Changes of the misfit by the unknowns, to first order, shape (2 m, n)."""
        slopes = self._measured.slopes
        return np.stack([stacked(self.weight * one) for one in slopes], axis=1)

    def imitating(self, change: _Complex) -> _Real:
        """Return the point at which the unknowns imitate a change of ln H, shape (n,).

        `change` has shape (n_f, n_i, n_j); the point is of first order and within the bounds.
        """
        wanted = stacked(self.weight * change)
        step = np.linalg.lstsq(self.changes * self.spread, wanted, rcond=_ALIKE)[0]
        return np.asarray(np.clip(self.x + self.spread * step, *self.part.coordinates.bounds))

    @cached_property
    def normal(self) -> _Real:
        """Inner products of `changes`, shape (n, n)."""
        return np.asarray(self.changes.T @ self.changes)

    @cached_property
    def _columns(self) -> _Real:
        """Changes of the misfit by the unknowns, above their prior, shape (2 m + n, n)."""
        return np.vstack([self.changes / self.unit, np.diag(1.0 / self.spread)])

    @cached_property
    def _span(self) -> _Real:
        # The prior on every unknown makes the columns independent.
        return np.linalg.qr(self._columns)[0]

    @cached_property
    def _normal(self) -> _Real:
        return np.asarray(self._columns.T @ self._columns)


def _differ(own: DofSet, other: DofSet) -> NDArray[np.bool_]:
    """Return which DOFs of two sets of the same length differ, shape (n,)."""
    return np.asarray(
        (own.nodes != other.nodes) | (own.axes != other.axes) | (own.signs != other.signs)
    )


def _outside(A: _Real, b: _Real) -> _Real:
    """Return the component of b orthogonal to the columns of A, which are independent."""
    Q = np.linalg.qr(A)[0]
    return np.asarray(b - Q @ (Q.T @ b))


def _block(part: Part, item: tuple[_Real, slice]) -> tuple[_Complex, _Complex]:
    """Return H and its derivatives at a block of lines."""
    block = part.block(*item)
    assert block.dH is not None
    return block.H, block.dH


def _receptance(part: Part, state: State, lift: _Complex | None = None) -> _Complex:
    """Return the receptance of the channels in a state of the model, shape (n_f, n_i, n_j).

    `lift`, shape (n_terms,), is added to the coefficients of the terms.
    """
    freq = part.frf.freq
    columns, place = np.unique(part.columns, return_inverse=True)
    c = part.solver.system.coefficients(state, 2.0 * np.pi * freq)
    if lift is not None:
        c = c + lift[:, None]
    U = part.solver.solve(c, columns, freq)[:, :, place.ravel()]
    return np.asarray(part.solver.at(U, part.rows).transpose(1, 0, 2))


def _log_ratio(a: _Complex, b: _Complex) -> _Complex:
    """Return ln(a / b), 0 where either is zero."""
    usable = (a != 0) & (b != 0)
    return np.asarray(np.log(np.where(usable, a, 1.0) / np.where(usable, b, 1.0)))


def stacked(values: _Complex) -> _Real:
    """Return real parts above imaginary parts, shape (2 m,)."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])
