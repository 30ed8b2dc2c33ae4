"""`CompiledStructure`: the compiled model of a plant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.kept_basis import KeptBasis
from updyn.errors import OptionError
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["CompiledStructure"]


@dataclass(frozen=True, slots=True, eq=False)
class CompiledStructure:
    """A compiled model, whose start is the state of the structure; compiled from `source`."""

    model: Model
    system: AffineSystem
    source: Model
    kept_basis: KeptBasis | None = None

    @classmethod
    def of(cls, given: object) -> CompiledStructure:
        """Return the structure of a model or of an update result."""
        # For an update it is the start model at the estimate, with the matrices of the update, so
        # its basis applies.
        if isinstance(given, Model):
            return cls(given, AffineSystem.compile(given), given)
        if isinstance(given, JointResult):
            names = ", ".join(repr(n) for n in given.results)
            raise OptionError(
                f"plant: the update has several tests ({names}), each with its model; pass the"
                " result of the test with the boundary conditions of the plant, such as"
                f" result[{next(iter(given.results))!r}]"
            )
        if not isinstance(given, UpdateResult):
            raise OptionError(
                f"plant: expected a model or the result of an update, found {type(given).__name__}"
            )
        system, unknowns = AffineSystem.compile(given.start), given.parameters
        values = np.array([given.values[name] for name in unknowns.names])
        # No model has a negative loss factor, which an iteration without bounds may reach.
        values = np.where(unknowns.is_damping, np.maximum(values, 0.0), values)
        estimate = Unknowns.find(system, unknowns).state(system, values)
        system = replace(system, start=estimate)
        return cls(given.model, system, given.start, given.kept_basis)
