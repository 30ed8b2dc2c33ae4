"""`Structure`: what a plant is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.kept_basis import KeptBasis
from updyn.errors import OptionError
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["Structure"]


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A model, compiled, and where its reduced models begin.

    Attributes
    ----------
    model : Model
        The structure.
    system : AffineSystem
        The same, compiled: its start is the state of the structure.
    source : Model
        What the system was compiled from.
    kept_basis : KeptBasis or None
        Where its reduced models begin.
    """

    model: Model
    system: AffineSystem
    source: Model
    kept_basis: KeptBasis | None = None

    @classmethod
    def of(cls, given: object) -> Structure:
        """Return the structure of what a plant is asked of.

        Of an update it is the start at the estimate: the matrices with which the update was solved,
        so that its basis serves.

        Parameters
        ----------
        given : Model or UpdateResult
            The structure.

        Raises
        ------
        OptionError
            If it is neither, or the result of several tests.
        """
        if isinstance(given, Model):
            return cls(given, AffineSystem.compile(given), given)
        if isinstance(given, JointResult):
            names = ", ".join(repr(n) for n in given.results)
            raise OptionError(
                f"plant: the update has several tests ({names}), each with its own model; pass the"
                " result of the one whose boundary conditions are those of the plant, such as"
                f" result[{next(iter(given.results))!r}]"
            )
        if not isinstance(given, UpdateResult):
            raise OptionError(
                f"plant: expected a model or the result of an update, found {type(given).__name__}"
            )
        system, unknowns = AffineSystem.compile(given.start), given.parameters
        values = np.array([given.values[name] for name in unknowns.names])
        # No model has a loss factor below zero, which a plain iteration may end with.
        values = np.where(unknowns.is_factor, values, np.maximum(values, 0.0))
        estimate = Unknowns.find(system, unknowns).state(system, values)
        system = replace(system, start=estimate)
        return cls(given.model, system, given.start, given.kept_basis)
