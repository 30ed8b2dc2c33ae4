"""`Coordinates`: the optimiser's coordinates of the unknowns, their bounds and priors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.settings import SEARCH_DATA

__all__ = ["Coordinates"]


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """The optimiser's coordinates x: logarithms of factors, equivalent loss factors for damping.

    Parameters of nonlinear elements are logarithms of their magnitude, or shares of their scale if
    they may be 0.

    Those of Rayleigh coefficients are alpha / `omega` and `omega` beta, at one `omega` (rad/s) in
    all tests of a run, so that all x are of order one. `box` has narrower bounds in x; x moves only
    along the columns of `within`; priors are relative to residuals of the standard deviation `unit`
    (None: estimated), about `centre` (None: the start).
    """

    parameters: ParameterSet
    box: tuple[RealArray, RealArray] | None = None
    within: RealArray | None = None
    unit: float | None = None
    omega: float = 1.0
    centre: RealArray | None = None
    _log: BoolArray = field(init=False, repr=False)
    _sign: RealArray = field(init=False, repr=False)
    _unit: RealArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        units = {"mass_damping": self.omega, "stiffness_damping": 1.0 / self.omega}
        scales = [
            p.scale if p.of_element else units.get(p.value_of or "", 1.0) for p in self.parameters
        ]
        object.__setattr__(self, "_log", self.parameters.is_log)
        object.__setattr__(self, "_sign", np.where(self.parameters.upper > 0.0, 1.0, -1.0))
        object.__setattr__(self, "_unit", np.array(scales))

    def to_x(self, values: RealArray) -> RealArray:
        """Return x for the unknowns' values, both shape (n,)."""
        size = np.where(self._log, self._sign * values, 1.0)
        return np.where(self._log, np.log(size), values / self._unit)

    def to_values(self, x: RealArray) -> RealArray:
        """Return the unknowns' values for x, both shape (n,) or (..., n)."""
        size = np.exp(np.where(self._log, x, 0.0))
        return np.where(self._log, self._sign * size, x * self._unit)

    def slope(self, x: RealArray) -> RealArray:
        """Return d values / d x, shape (n,)."""
        return np.where(self._log, self.to_values(x), self._unit)

    @property
    def bounds(self) -> tuple[RealArray, RealArray]:
        """Bounds in x, each shape (n,)."""
        return self._clip_to_box(*self._limits)

    @property
    def _limits(self) -> tuple[RealArray, RealArray]:
        """Bounds of the unknowns in x; the magnitude of a negative unknown falls with it."""
        lower, upper = self.to_x(self.parameters.lower), self.to_x(self.parameters.upper)
        return np.minimum(lower, upper), np.maximum(lower, upper)

    @property
    def relaxed_lower(self) -> RealArray:
        """Lower bounds in x that allow negative damping during a search, shape (n,)."""
        # The true loss factor of a lightly damped part is close to its bound at zero; a search
        # that cannot cross this bound may stop there.
        lower, upper = self._limits
        relaxed = np.minimum(lower, SEARCH_DATA.least_loss_factor)
        return self._clip_to_box(np.where(self.parameters.is_damping, relaxed, lower), upper)[0]

    def _clip_to_box(self, lower: RealArray, upper: RealArray) -> tuple[RealArray, RealArray]:
        if self.box is None:
            return lower, upper
        # A box outside the bounds is reduced to their nearest point.
        low, high = np.clip(self.box[0], lower, upper), np.clip(self.box[1], lower, upper)
        return low, high

    @property
    def prior(self) -> tuple[RealArray, RealArray]:
        """Centre and inverse standard deviation (0: none) of the priors in x, each shape (n,)."""
        weight = [0.0 if p.prior_std is None else 1.0 / p.prior_std for p in self.parameters]
        centre = self.start if self.centre is None else self.centre
        return centre, np.array(weight) * np.where(self._log, 1.0, self._unit)

    @property
    def start(self) -> RealArray:
        """Start of the unknowns in x, shape (n,)."""
        return self.to_x(self.parameters.start)

    def with_coordinate(self, x: RealArray, i: int, value: float) -> RealArray:
        """Return x with coordinate `i` at `value`, clipped to the bounds."""
        changed = x.copy()
        changed[i] = value
        return np.clip(changed, *self.bounds)

    def with_start(self, x: RealArray) -> Coordinates:
        """Return a copy with the start of the unknowns at x and the same priors."""
        parameters = self.parameters
        start = np.clip(self.to_values(x), parameters.lower, parameters.upper)
        return replace(self, parameters=parameters.with_start(start), centre=self.prior[0])
