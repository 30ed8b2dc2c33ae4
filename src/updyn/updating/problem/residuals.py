"""Residuals between model and measurement, and their reduction by block of lines.

Blocks are stacked by QR factors, so the Jacobian of all lines is never stored and the normal
equations are never formed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError, SolverError
from updyn.frf import FRF, QUANTITIES
from updyn.linalg.threads import use_one_thread
from updyn.registry import Registry
from updyn.settings import ROUNDING
from updyn.updating.problem.local import Local, join_locals, qr_triangle, reduce_blocks
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.session import Record
from updyn.updating.problem.settings import SEARCH_DATA

__all__ = [
    "RESIDUALS",
    "EquationError",
    "LineResidual",
    "LogError",
    "OutputError",
    "OutputErrorSet",
    "Residual",
    "ResidualSet",
    "add_prior",
    "is_cached",
    "make_log_error",
    "noise_weights",
    "reduce_cached",
    "reduce_residual",
]


class Residual(Protocol):
    """Interface of a residual: its local least-squares problem at x, and its name."""

    @property
    def name(self) -> str:
        """Name in the report."""

    def local(self, problem: Problem, x: RealArray) -> Local | None:
        """Return the reduced problem at x, or None if the model cannot be solved."""


class LineResidual(ABC):
    """Base class of the residuals that are evaluated by block of lines, in any process.

    A subclass defines `name` and `block`. Override `on` if the residual holds arrays over the
    lines, `of_data` if its weights depend on the data, and `partition` if it needs more memory than
    model and data.

    Attributes
    ----------
    name : str
        Name in the report.
    reference : str
        Publication of the residual.
    needs_exact : str
        Reason why it cannot be evaluated with a reduced model; empty if it can.
    calibrates : bool
        Whether it supports calibration factors, that is, compares the data with `FRFPart.block`,
        which applies them.
    """

    __slots__ = ()

    name: str

    reference: ClassVar[str] = ""
    needs_exact: ClassVar[str] = ""
    calibrates: ClassVar[bool] = False

    @classmethod
    def of_data(cls, part: FRFPart) -> Self:
        """Return the residual for the data of a test, with equal weights.

        Parameters
        ----------
        part : FRFPart
            Model, data and unknowns of the test.

        Returns
        -------
        LineResidual
        """
        return cls()

    @property
    def cache_key(self) -> object:
        """Bytes, text or array that distinguishes residuals of one class in a cache."""
        return ""

    def local(self, problem: Problem, x: RealArray) -> Local | None:
        """Return the reduced problem at x, or None if the model cannot be solved.

        Parameters
        ----------
        problem : Problem
            Model, data and unknowns.
        x : ndarray of float, shape (n,)
            Point in the optimiser's coordinates.

        Returns
        -------
        Local or None
        """
        return _reduce_all(self, problem, x)

    def of(self, part: int) -> Self:
        """Return the residual of one of several tests.

        Parameters
        ----------
        part : int
            Number of the test.

        Returns
        -------
        LineResidual
        """
        return self

    def on(self, part: FRFPart, lines: slice) -> Self:
        """Return the residual restricted to a block of lines.

        Parameters
        ----------
        part : FRFPart
            Model, data and unknowns of the test.
        lines : slice
            The block.

        Returns
        -------
        LineResidual
        """
        return self

    def partition(self, part: FRFPart) -> list[slice]:
        """Return the blocks of lines.

        Parameters
        ----------
        part : FRFPart
            Model, data and unknowns of the test.

        Returns
        -------
        list of slice
        """
        return part.partition()

    @abstractmethod
    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return the residual and its derivatives at a block of lines.

        Parameters
        ----------
        part : FRFPart
            Model, data and unknowns of the test.
        x : ndarray of float, shape (n,)
            Point in the optimiser's coordinates.
        lines : slice
            The block.

        Returns
        -------
        r : ndarray of complex, shape (n_f, ...)
            The residual.
        J : ndarray of complex, shape (n, n_f, ...)
            Its derivatives by x.
        """


def noise_weights(values: ComplexArray, variance: RealArray, frf: FRF) -> RealArray:
    """Return weights of measured values from 0 (noise) to 1 (no noise), shape (n_f, n_i, n_j)."""
    # sqrt(S / (S + 100 E|dH|^2)) with S = |H_X|^2 - 9 E|dH|^2: a value below the noise has no
    # phase, and noise exceeds three standard deviations once in 8,000 values; a small response of
    # the model there would give the largest logarithms of all. 0 for rounding error.
    size = np.abs(values)
    excess = np.maximum(size**2 - SEARCH_DATA.subtracted_variances * variance, 0.0)
    scaled = variance / SEARCH_DATA.halving_noise**2
    weight = np.sqrt(excess / (excess + scaled + np.finfo(float).tiny))
    share = size / level_by_unit(frf)
    least = ROUNDING.receptance_share * share.max(axis=(1, 2), keepdims=True)
    return np.where(share > least, weight, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LogError(LineResidual):
    """r = w ln(H_A / H_X): difference of log magnitude and phase; w (1 by default) from the noise.

    Nearly the maximum-likelihood residual for constant relative noise; converges from far away.
    Exact zeros in model or data have no logarithm and have the weight 0.
    """

    weight: RealArray | None = None
    name: str = "log"

    @classmethod
    def of_noisy_data(cls, part: FRFPart) -> LogError:
        """Return the log error of data with variance, weighted by `noise_weights`."""
        assert part.frf.variance is not None
        return cls(noise_weights(part.frf.values, part.frf.variance, part.frf))

    @property
    def cache_key(self) -> object:
        """The weights."""
        return "" if self.weight is None else self.weight

    def on(self, part: FRFPart, lines: slice) -> Self:
        """Return the residual with the weights of a block of lines."""
        return self if self.weight is None else replace(self, weight=self.weight[lines])

    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return the residual and its derivatives; `weight` is of the same block of lines."""
        block = part.block(x, lines)
        assert block.dH is not None
        usable = (block.measured != 0) & (block.H != 0)
        weight = np.where(usable, 1.0 if self.weight is None else self.weight, 0.0)
        H = np.where(usable, block.H, 1.0)
        ratio = H / np.where(usable, block.measured, 1.0)
        r = np.empty(ratio.shape, dtype=np.complex128)
        # Real and imaginary part separately: a quarter of the time of numpy's complex logarithm.
        r.real, r.imag = np.log(np.abs(ratio)), np.angle(ratio)
        r *= weight
        J = block.dH
        J *= weight / H
        return r, J


@dataclass(frozen=True, slots=True, eq=False)
class OutputError(LineResidual):
    """r = (H_A - H_X) / sigma; `weight` is 1 / sigma of the real and of the imaginary part."""

    weight: RealArray
    name: str = "output-error"

    @classmethod
    def of_data(cls, part: FRFPart) -> Self:
        """Return the residual with equal weight for all values of one unit."""
        return cls(np.broadcast_to(1.0 / level_by_unit(part.frf), part.frf.values.shape))

    @property
    def cache_key(self) -> RealArray:
        """The weights."""
        return self.weight

    def on(self, part: FRFPart, lines: slice) -> Self:
        """Return the residual with the weights of a block of lines."""
        return replace(self, weight=self.weight[lines])

    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return the residual and its derivatives; `weight` is of the same block of lines."""
        block = part.block(x, lines)
        assert block.dH is not None
        return self.weight * (block.H - block.measured), block.dH * self.weight


E = TypeVar("E", bound=LineResidual)


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSet(Generic[E]):
    """Residuals of each test that measured FRFs, by block of lines, and of each with modes."""

    errors: tuple[E, ...]
    modal: tuple[ModalError, ...] = ()

    @property
    def name(self) -> str:
        """Name in the report."""
        return self.errors[0].name if self.errors else ModalError.name

    def local(self, problem: Problem, x: RealArray) -> Local | None:
        """Return the reduced problem at x, or None if the model cannot be solved."""
        return _reduce_all(self, problem, x)

    def of(self, part: int) -> E:
        """Return the residual of one of the tests that measured FRFs."""
        return self.errors[part]

    @property
    def without_modes(self) -> Self:
        """The residuals of FRFs only."""
        return replace(self, modal=())


class OutputErrorSet(ResidualSet[OutputError]):
    """Output errors of several tests, each with its weights."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class EquationError(LineResidual):
    """r = Z_red h_X - e_j, the condensed equation error of Bao, Wang & Cheng (2010, eq. 10).

    Every reference must also be measured as a response, so that its unit force acts on a retained
    DOF. Measurement noise biases the estimate, because H_X enters both sides of the equation. If
    translations and rotations were measured, forces and moments are scaled by the levels of the
    data (`_unit_weights`); otherwise the residual is that of the paper.
    """

    name: str = "equation-error"

    def local(self, problem: Problem, x: RealArray) -> Local | None:
        """Return the reduced problem at x, or None if the model cannot be solved."""
        for part in problem.parts:
            self.check(part)
        return _reduce_all(self, problem, x)

    @staticmethod
    def check(part: FRFPart) -> None:
        """Raise if the data lack a drive point, or hold no receptance at 0 Hz."""
        is_driven = _drive_points(part).any(axis=0)
        if not is_driven.all():
            missing = part.frf.references[int(np.flatnonzero(~is_driven)[0])]
            raise DataError(
                f"equation error: reference {missing} is not among the responses; the force has to"
                " stand on a retained DOF. Measure the drive point, or use another method"
            )
        quantity = part.frf.quantity
        if QUANTITIES[quantity] and part.frf.freq[0] == 0.0:
            raise DataError(
                f"equation error: the 0 Hz line of {quantity} holds no receptance; leave it out"
            )

    def blocks(self, part: FRFPart, x: RealArray) -> Iterator[tuple[ComplexArray, ComplexArray]]:
        """Yield Z_red h_X - e_j, (n_f, n, m), and its derivatives by x, by block of lines."""
        self.check(part)
        return part.map_lines(_evaluate_block, [(self, x, lines) for lines in self.partition(part)])

    def partition(self, part: FRFPart) -> list[slice]:
        """Return the blocks of lines."""
        return part.partition(2 * len(part.rows))

    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return the residual and its derivatives at a block of lines."""
        freq, slope = part.frf.freq[lines], part.coordinates.slope(x)
        unit = _drive_points(part)
        weight = _unit_weights(part, unit)
        factor = part.sign / (part.frf.s[lines] ** QUANTITIES[part.frf.quantity])[:, None, None]
        product, derivative = sensitivity.condensed_product(
            part.solver,
            part.unknowns,
            part.values(x),
            freq,
            part.rows,
            part.frf.values[lines] * factor,
        )
        assert derivative is not None
        return weight * (product - unit), derivative * (slope[:, None, None, None] * weight)


def _drive_points(part: FRFPart) -> RealArray:
    """Return the unit forces on the retained DOFs, shape (n_i, n_j)."""
    return np.asarray(part.rows[:, None] == part.columns[None, :], dtype=np.float64)


def _unit_weights(part: FRFPart, unit: RealArray) -> RealArray:
    """Return the weights of the equation error, shape (n, m); all 1 for data of one unit."""
    # The residual at a rotation is a moment per force. Multiplied by the level of the motion there
    # and divided by that at the force, it is a ratio of work and independent of the unit of
    # length.
    level = level_by_unit(part.frf)[0]
    return np.asarray(level / (unit * level).sum(axis=0))


def make_log_error(problem: Problem) -> ResidualSet[LogError]:
    """Return the log error of data with variance, weighted by `noise_weights`."""
    # Errors of frequencies are used as logarithms; errors of shapes and damping are weighted less
    # in the ratio of their assumed noise.
    errors = tuple(map(LogError.of_noisy_data, problem.parts))
    return ResidualSet(
        errors, tuple(ModalError(part.noise.in_units_of_frequency()) for part in problem.modal)
    )


def add_prior(local: Local, problem: Problem, x: RealArray) -> Local:
    """Return the local problem with the priors added as residuals (x - x_0) / std."""
    centre, weight = problem.coordinates.prior
    if not weight.any():
        return local
    residual = weight * (x - centre)
    return join_locals(
        [local, Local(0.5 * float(residual @ residual), np.diag(weight), residual)], problem.n
    )


def reduce_cached(residual: LineResidual, part: FRFPart, x: RealArray) -> Local:
    """Return the reduced problem at x, from the cache if possible."""

    def compute() -> Record:
        local = reduce_residual(residual, part, x, part.n)
        return np.array(local.cost), local.R, local.q

    cost, R, q = part.recall(_cache_kind(residual), x, compute, residual.cache_key)
    return Local(float(cost), R, q)


def reduce_residual(residual: LineResidual, part: FRFPart, x: RealArray, n: int) -> Local:
    """Return the reduced problem at x for a residual with n derivatives.

    Responses of the model that are known afterwards are stored in the cache.
    """
    items = [(residual.on(part, lines), x, lines) for lines in residual.partition(part)]
    responses: list[ComplexArray | None] = []

    def reduced() -> Iterator[RealArray]:
        for triangle, H in part.map_lines(_reduce_block, items):
            responses.append(H)
            yield triangle

    local = reduce_blocks(reduced(), n)
    part.remember_responses(x, responses)
    if not (np.isfinite(local.cost) and np.isfinite(local.R).all()):
        raise SolverError(f"{residual.name}: the model's answer is not finite")
    return local


def is_cached(residual: LineResidual | ResidualSet[Any], problem: Problem, x: RealArray) -> bool:
    """Return whether the reduced problem at x is cached."""
    keys = []
    for i, part in enumerate(problem.parts):
        residual_of_part = residual.of(i)
        keys.append(part.key(_cache_kind(residual_of_part), x, residual_of_part.cache_key))
    modal = (
        zip(problem.modal, residual.modal, strict=True) if isinstance(residual, ResidualSet) else ()
    )
    return all(problem.session.has(key) for key in keys) and all(
        part.is_cached(error.kind, x) for part, error in modal
    )


def _cache_kind(residual: LineResidual) -> str:
    return type(residual).__name__


def _reduce_all(
    residual: LineResidual | ResidualSet[Any], problem: Problem, x: RealArray
) -> Local | None:
    try:
        found = [reduce_cached(residual.of(i), part, x) for i, part in enumerate(problem.parts)]
        if isinstance(residual, ResidualSet):
            for modal, error in zip(problem.modal, residual.modal, strict=True):
                found.append(error.local(modal, x))
    except SolverError:
        return None
    return join_locals(found, problem.n)


def _evaluate_block(
    part: FRFPart, item: tuple[LineResidual, RealArray, slice]
) -> tuple[ComplexArray, ComplexArray]:
    residual, x, lines = item
    return residual.block(part, x, lines)


@use_one_thread
def _reduce_block(
    part: FRFPart, item: tuple[LineResidual, RealArray, slice]
) -> tuple[RealArray, ComplexArray | None]:
    """Return the triangle of a block of lines, and the model's responses if they are known."""
    r, J = _evaluate_block(part, item)
    # The order of the rows has no effect (eq. 12); this one is that of the memory.
    return qr_triangle(_as_real(J, len(J)), _as_real(r, 1)[0]), part.known_responses(*item[1:])


def _as_real(values: ComplexArray, n: int) -> RealArray:
    """Return complex values as n real rows, with real and imaginary parts alternating."""
    flat = np.ascontiguousarray(values, dtype=np.complex128).reshape(n, values.size // n)
    return flat.view(np.float64)


#: Residuals by name. A registered residual without a method of the same name is minimised by
#: ``method="NAME"`` (`updyn.updating.fit.methods`).
RESIDUALS: Registry[type[LineResidual]] = Registry(
    "residual",
    "updyn.residuals",
    {"log": LogError, "output-error": OutputError, "equation-error": EquationError},
)
