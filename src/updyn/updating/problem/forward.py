"""`Forward`: how the FRF of a part and its derivatives are computed.

A linear model has one FRF, whatever the force. That of a model with nonlinear elements belongs to
the force of the data, a sine (`PeriodicForward`) or a random force (`RandomForward`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.errors import DataError
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.model import Model
from updyn.updating.problem.local_elements import LocalElements, Receptances
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.periodic_forward import EquivalentForward, PeriodicForward
from updyn.updating.problem.random_forward import RandomForward

if TYPE_CHECKING:
    from updyn.updating.problem.problem import FRFPart

__all__ = ["LINEAR", "Forward", "LinearForward", "choose_forward"]


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

    def solved_lines(self, frf: FRF) -> RealArray:
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

    def solved_lines(self, frf: FRF) -> RealArray:
        """Return the lines."""
        return frf.freq

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
        raise DataError("level: expected no exponential window in data of a stated force")
    local = LocalElements.find(model, parameters)
    if frf.level is None:
        return EquivalentForward.at_rest(local, frf)
    return RandomForward(local) if frf.is_random else PeriodicForward(local)
