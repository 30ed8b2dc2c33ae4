"""`modify_servo`: changes of the margins of a servo by a modification, with intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import RealArray
from updyn.control.family import plant_families
from updyn.control.ports import Port
from updyn.control.servo.controller import Controller
from updyn.control.servo.loops import Wiring
from updyn.control.servo.margins import FIGURES, Margins
from updyn.control.servo.record import Servo
from updyn.control.servo.servo import LOOPS, margins_of_loops, servo
from updyn.dofs import Dof
from updyn.engines import Engine
from updyn.errors import OptionError, suggest
from updyn.modification.modify import Modification
from updyn.notebook import card, table
from updyn.text_table import format_count, text_table
from updyn.uncertainty.counts import check_level

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["MarginChange", "ServoChange", "modify_servo"]

_HEADINGS = ("loop", "figure", "before", "after", "change", "95 % interval", "unit")
#: Figures of `Margins` that are compared in dB.
_IN_DB = ("gain_margin", "gain_reduction")


def modify_servo(
    modification: Modification,
    controller: Controller,
    inputs: Iterable[str | Dof | Port] | str | Dof | Port,
    outputs: Iterable[str | Dof | Port] | str | Dof | Port,
    band: Sequence[float],
    tolerance: float = 0.02,
    *,
    torque: str,
    velocity: str,
    position: str | None = None,
    quantity: str | Sequence[str] = "receptance",
    route: str = "auto",
    error: str = "relative",
    tier: str | None = None,
    backend: str | None = None,
    n: int = 100,
    seed: int = 0,
    engine: int | Client | Engine | None = None,
) -> ServoChange:
    """Predict the change of the margins of a servo by a change of its structure.

    Parameters
    ----------
    modification : Modification
        The change, by `updyn.modify`. For other answers of the update, one of its `others`.
    controller : Controller
        The same before and after the change.
    inputs, outputs, band, tolerance
        As for `updyn.plant_family`. Changes below the error of the plants are not resolved: give a
        smaller tolerance for these.
    torque, velocity, position : str
        As for `updyn.servo`.
    quantity, route, error, tier, backend
        As for `updyn.plant_family`.
    n : int
        Number of draws of the unknowns; 39 or more give intervals of 95 %.
    seed : int
        Seed of the draws.
    engine
        As for `updyn.plant_family`.

    Returns
    -------
    ServoChange

    Raises
    ------
    OptionError, ModelError, SolverError, DofError
        As `updyn.plant_family` and `updyn.servo`.

    Notes
    -----
    Plants are made at the estimate and at draws of the unknowns from their covariance, before and
    after the change at the same values, so that their common uncertainty cancels. Intervals are
    quantiles of the drawn changes and need no linearisation: margins have kinks where another
    crossing becomes the critical one. Errors of the model are not covered.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> found = updyn.modify(result, lambda m: m.with_element("ballast", ["12:X"], mass=0.5), 1)
    >>> change = updyn.modify_servo(
    ...     found,
    ...     updyn.Controller(kp=1.0, low_pass=20.0),
    ...     ["1:X"],
    ...     ["1:X"],
    ...     (0.5, 6.0),
    ...     torque="1:X",
    ...     velocity="1:X",
    ...     n=3,
    ... )
    >>> change
    ServoChange(3 draws)
    """
    families = plant_families(
        modification.updates,
        inputs,
        outputs,
        band,
        tolerance,
        route=route,
        n=n,
        seed=seed,
        engine=engine,
        options={"quantity": quantity, "error": error, "tier": tier, "backend": backend},
    )
    servos, drawn = [], []
    for family in families:
        servos.append(
            servo(
                family.nominal,
                controller,
                torque=torque,
                velocity=velocity,
                position=position,
                step=None,
                disturbance_step=None,
            )
        )
        wiring = Wiring.of(family.nominal, controller, torque, velocity, position, None, None)
        drawn.append(margins_of_loops(family.members, controller, wiring))
    before, after = servos
    margins = []
    for loop in LOOPS:
        here, there = getattr(before, f"{loop}_loop"), getattr(after, f"{loop}_loop")
        if here is None or there is None:
            continue
        members = [[one[loop] for one in each] for each in drawn]
        margins += [
            _compare(loop, figure, (here.margins, there.margins), members) for figure in FIGURES
        ]
    return ServoChange(before, after, tuple(margins))


@dataclass(frozen=True, slots=True, eq=False)
class MarginChange:
    """Change of one figure of a loop.

    Attributes
    ----------
    loop : {"velocity", "position", "torque"}
        As `Loop.name`.
    figure : str
        Name in `Margins`; a gain is in dB here.
    unit : str
        Unit of all values: dB, deg, s, Hz or none.
    before, after : float or None
        Value before and after the change; None if the loop is unstable or has no such value.
    draws : ndarray of float, shape (n, 2)
        Values before and after at draws of the unknowns; nan instead of None.
    """

    loop: str
    figure: str
    unit: str
    before: float | None
    after: float | None
    draws: RealArray

    @property
    def change(self) -> float:
        """Difference of both values; nan if one is missing or unlimited."""
        values = [np.nan if value is None else value for value in (self.before, self.after)]
        with np.errstate(invalid="ignore"):
            return float(np.diff(np.where(np.isfinite(values), values, np.nan))[0])

    @property
    def std_change(self) -> float:
        """Standard deviation of the difference over the draws; nan if one of them has none."""
        changes = self._changes()
        return float(np.std(changes, ddof=1)) if len(changes) > 1 else np.nan

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the interval of the difference, by quantiles of the draws.

        Parameters
        ----------
        level : float
            Probability that the interval covers the true difference.

        Returns
        -------
        (float, float)
            nan if the figure is missing or unlimited at the estimate or at a draw.

        Raises
        ------
        OptionError
            If there are too few draws for the level.
        """
        tail, least = 0.5 - 0.5 * check_level(level), _least_draws(level)
        if len(self.draws) < least:
            raise OptionError(
                f"level = {level:g}: {format_count(len(self.draws), 'draw')}; expected at least"
                f" {least}"
            )
        changes = self._changes()
        if np.isnan(self.change) or np.isnan(changes).any():
            return np.nan, np.nan
        # Ranks k / (n + 1): a further draw lies within with the probability of the level.
        low, high = np.quantile(changes, [tail, 1.0 - tail], method="weibull")
        return float(low), float(high)

    def _changes(self) -> RealArray:
        finite = np.where(np.isfinite(self.draws), self.draws, np.nan)
        return np.asarray(finite[:, 1] - finite[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class ServoChange:
    """Change of the margins of a servo by a change of its structure.

    Attributes
    ----------
    before, after : Servo
        The servo on the plants of the updated and the changed model.
    margins : tuple of MarginChange
        Every figure of every loop.
    """

    before: Servo
    after: Servo
    margins: tuple[MarginChange, ...]

    @property
    def n(self) -> int:
        """Number of draws."""
        return len(self.margins[0].draws)

    @property
    def unstable(self) -> tuple[int, int]:
        """Number of draws at which a loop is unstable, before and after the change."""
        lost = np.zeros((self.n, 2), dtype=np.bool_)
        for one in self.margins:
            if one.figure == "modulus_margin":
                lost |= np.isnan(one.draws)
        before, after = lost.sum(axis=0).tolist()
        return before, after

    def margin(self, figure: str, loop: str | None = None) -> MarginChange:
        """Return the change of one figure.

        Parameters
        ----------
        figure : str
            ``"gain_margin"``, ``"phase_margin"``, ``"modulus_margin"``, ``"delay_margin"``,
            ``"gain_reduction"`` or ``"crossover"``.
        loop : {"velocity", "position", "torque"}, optional
            By default the position loop, or the velocity loop without one.

        Returns
        -------
        MarginChange

        Raises
        ------
        OptionError
            If the servo has no such loop or figure.
        """
        loops = list(dict.fromkeys(one.loop for one in self.margins))
        if loop is None:
            loop = "position" if "position" in loops else "velocity"
        if loop not in loops:
            raise OptionError(f"no loop {loop!r}; {suggest(loop, loops)}")
        if figure not in FIGURES:
            raise OptionError(f"no figure {figure!r}; {suggest(figure, FIGURES)}")
        return next(m for m in self.margins if (m.loop, m.figure) == (loop, figure))

    def summary(self) -> str:
        """Return the changes as text, with 95 % intervals.

        Returns
        -------
        str
        """
        return f"{text_table(_HEADINGS, self._rows(), left=(0, 1))}\n\n{self._statement()}"

    def _statement(self) -> str:
        before, after = self.unstable
        return (
            f"Of {format_count(self.n, 'draw')} of the unknowns, {before} are unstable before the"
            f" change and {after} after it."
        )

    def _rows(self) -> list[list[str]]:
        rows = []
        for one in self.margins:
            span = "too few draws"
            if self.n >= _least_draws(0.95):
                low, high = one.interval()
                span = f"{low:+.4g} to {high:+.4g}" if np.isfinite(low) else "none"
            change = f"{one.change:+.4g}" if np.isfinite(one.change) else "none"
            values = _format(one.before), _format(one.after), change, span
            rows.append([one.loop, one.figure.replace("_", " "), *values, one.unit])
        return rows

    def _repr_html_(self) -> str:
        return card(self._statement(), {}, table(_HEADINGS, self._rows(), left=(0, 1)))

    def __repr__(self) -> str:
        return f"ServoChange({format_count(self.n, 'draw')})"


def _compare(
    loop: str, figure: str, ends: Sequence[Margins], members: Sequence[Sequence[Margins]]
) -> MarginChange:
    """Return the change of one figure from its values at the estimate and at draws."""
    before, after = (_value(margins, figure) for margins in ends)
    drawn = [[_value(margins, figure) for margins in each] for each in members]
    columns = np.array(drawn, dtype=np.float64).T  # None becomes nan
    unit = "dB" if figure in _IN_DB else FIGURES[figure]
    return MarginChange(loop, figure, unit, before, after, columns)


def _least_draws(level: float) -> int:
    """Return the smallest number of draws whose extremes enclose a share `level`."""
    return round(2.0 / (1.0 - level)) - 1


def _value(margins: Margins, figure: str) -> float | None:
    """Return a figure of a loop, gains in dB."""
    value: float | None = getattr(margins, f"{figure}_db" if figure in _IN_DB else figure)
    return value


def _format(value: float | None) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" if np.isfinite(value) else "unlimited"
