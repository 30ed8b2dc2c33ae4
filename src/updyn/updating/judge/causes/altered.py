"""A part whose model is altered: an added element between DOFs, or added damping of groups."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.excitation import DrivenSolver
from updyn.dynamics.fields import FieldSolver
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.updating.problem.problem import FRFPart, LineBlock

__all__ = [
    "Alteration",
    "AlteredPart",
    "SystemAlteration",
    "compute_log_ratio",
    "divide_logs",
    "replace_channels",
    "replace_system",
]


_Part = TypeVar("_Part", bound=FRFPart)


class Alteration(ABC):
    """A change of a model of a given size, such as an added element."""

    __slots__ = ()

    @property
    def cache_key(self) -> str:
        """Key that distinguishes it from all others."""
        return repr(self)

    @abstractmethod
    def block(self, part: FRFPart, x: RealArray, lines: slice, *, derivatives: bool) -> LineBlock:
        """Return the altered model and the data of a part at a block of lines."""


class SystemAlteration(Alteration):
    """A change of the matrices or coefficients of a model."""

    __slots__ = ()

    @abstractmethod
    def alter_part(self, part: FRFPart) -> FRFPart:
        """Return a part with the altered model."""

    def block(self, part: FRFPart, x: RealArray, lines: slice, *, derivatives: bool) -> LineBlock:
        """Return the altered model and the data of a part at a block of lines."""
        return self.alter_part(part).block(x, lines, derivatives=derivatives)


@dataclass(frozen=True, slots=True, eq=False)
class AlteredPart(FRFPart):
    """A part with an altered model; all other results follow from its blocks of lines."""

    alteration: Alteration | None = None

    @classmethod
    def of(cls, part: FRFPart, alteration: Alteration) -> AlteredPart:
        """Return a part with an altered model; an earlier alteration is replaced."""
        return _copy_as(cls, part, alteration)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (self.unaltered_part, self.alteration)

    @property
    def unaltered_part(self) -> FRFPart:
        """The part with the unaltered model."""
        return _copy_as(FRFPart, self)

    def block(self, x: RealArray, lines: slice, *, derivatives: bool = True) -> LineBlock:
        """Return the altered model and the data at a block of lines."""
        assert self.alteration is not None
        return self.alteration.block(self.unaltered_part, x, lines, derivatives=derivatives)

    def key(self, kind: str, x: RealArray, *about: object) -> list[object]:
        """Return the cache key of an evaluation at x, including the alteration."""
        assert self.alteration is not None
        # Not super(): with slots, the dataclass decorator creates a new class that super() does not
        # know.
        return [*FRFPart.key(self, kind, x, *about), self.alteration.cache_key]


def compute_log_ratio(part: FRFPart, alteration: Alteration, x: RealArray) -> ComplexArray:
    """Return ln H of the altered model over H, shape (n_f, n_i, n_j); 0 where either is 0."""
    return divide_logs(AlteredPart.of(part, alteration).responses(x), part.responses(x))


def divide_logs(a: ComplexArray, b: ComplexArray) -> ComplexArray:
    """Return ln(a / b), 0 where either is zero."""
    usable = (a != 0.0) & (b != 0.0)
    return np.asarray(np.log(np.where(usable, a, 1.0) / np.where(usable, b, 1.0)))


def replace_channels(
    part: FRFPart, responses: Sequence[str], references: Sequence[str], quantity: str
) -> FRFPart:
    """Return a part with other channels, whose values are 1."""
    frf = part.frf
    values = np.ones((part.n_lines, len(responses), len(references)))
    more: dict[str, Any] = {"decay": frf.decay}
    if quantity == TRANSMISSIBILITY:
        more |= {"base": frf.base, "force": frf.force}
    return part.with_data(FRF(frf.freq, values, responses, references, quantity, **more))


def replace_system(part: FRFPart, system: AffineSystem) -> FieldSolver:
    """Return the solver of a part for another system of the same pattern."""
    solver: Any = part.solver
    if isinstance(solver, DrivenSolver):
        return replace(solver, inner=replace(cast("Any", solver.inner), system=system))
    found: FieldSolver = replace(solver, system=system)
    return found


def _copy_as(kind: Callable[..., _Part], part: FRFPart, *further: Alteration) -> _Part:
    """Return a part of another type with the same fields, and further ones."""
    return kind(
        part.solver,
        part.unknowns,
        part.coordinates,
        part.frf,
        part.rows,
        part.columns,
        part.sign,
        part.session,
        part.name,
        part.as_read,
        part.variants,
        part.forward,
        *further,
    )


def _rebuild(part: FRFPart, alteration: Alteration) -> AlteredPart:
    return AlteredPart.of(part, alteration)
