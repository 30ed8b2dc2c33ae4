"""Checked arguments of `plan`: noise, bands, lines, draws of the start."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.errors import OptionError, ParameterError, key_path, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.group import is_number
from updyn.model import Model
from updyn.planning.settings import PLANNING
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.lines import find_unknowns
from updyn.updating.problem.noise import ASSUMED, Stated, choose_noise
from updyn.updating.problem.parameters import ParameterSet

__all__ = [
    "Band",
    "StartDraws",
    "check_quantity",
    "check_unknowns",
    "find_bands",
    "find_lines",
    "find_noise",
    "find_wanted",
]


Band = tuple[float, float]


def check_unknowns(unknowns: ParameterSet, model: Model) -> None:
    """Raise ParameterError for a calibration factor, or a parameter that the model lacks."""
    for p in unknowns:
        if p.is_channel:
            raise ParameterError(
                f"plan: {p.name!r} is a calibration factor of a sensor, and the sensors are not"
                " selected yet; remove it",
                key=("parameters",),
            )
        for drive in p.acts_on:
            group = model.groups.get(drive.group)
            if group is None or not group.has(drive.quantity):
                raise ParameterError(
                    f"plan: unknown {p.name!r}: the model has no group {drive.group!r} with"
                    f" {drive.quantity}; {suggest(drive.group, model.groups)}",
                    key=("parameters",),
                )


def check_quantity(quantity: str) -> None:
    """Raise OptionError for an unknown measured quantity."""
    if quantity not in QUANTITIES:
        raise OptionError(
            f"quantity {quantity!r}: {suggest(str(quantity), QUANTITIES)}", key=("quantity",)
        )


def find_wanted(interest: str | Iterable[str] | None, unknowns: ParameterSet) -> tuple[int, ...]:
    """Return the indices of the parameters of interest, by names and globs."""
    if interest is None:
        return tuple(range(len(unknowns)))
    patterns = [interest] if isinstance(interest, str) else list(interest)
    if not patterns:
        raise OptionError("interest: no unknown is named; omit it for all", key=("interest",))
    with key_path("interest"):
        return tuple(find_unknowns("interest", patterns, unknowns.names))


def find_noise(given: Mapping[str, float] | None) -> Stated:
    """Return the expected noise, by default of ordinary size; raises OptionError if invalid."""
    if given is None:
        return Stated(**ASSUMED)
    if not isinstance(given, Mapping) or not given or set(given) - set(ASSUMED):
        raise OptionError(
            f"noise: expected a mapping with relative and/or floor, found {given!r}", key=("noise",)
        )
    any_data = FRF([1.0], np.ones((1, 1, 1)), ["1:X"], ["1:X"], "receptance")
    made = choose_noise(given, any_data)
    assert isinstance(made, Stated)
    return made


def find_bands(given: Band | Sequence[Band]) -> list[Band]:
    """Return the bands to select from, in Hz; raises OptionError if invalid."""
    try:
        table = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim == 1:
        table = table[None]
    is_table = table.ndim == 2 and len(table) > 0 and table.shape[1] == 2
    if not is_table or not np.isfinite(table).all():
        raise OptionError(
            f"band = {given!r}: expected (low, high) in Hz, or several such pairs to choose from",
            key=("band",),
        )
    for low, high in table.tolist():
        if not 0.0 <= low < high:
            raise OptionError(
                f"band {low:g} to {high:g} Hz: expected 0 <= low < high",
                key=("band",),
            )
    return [(low, high) for low, high in table.tolist()]


def find_lines(given: int | ArrayLike, band: Band) -> RealArray:
    """Return ascending lines in Hz: a number of evenly spaced ones, or those given in the band."""
    low, high = band
    if isinstance(given, int | np.integer) and not isinstance(given, bool):
        if not 2 <= given <= PLANNING.most_lines:
            raise OptionError(
                f"lines = {given}: expected 2 to {PLANNING.most_lines:,} lines", key=("lines",)
            )
        return np.linspace(low, high, int(given))
    try:
        freq = np.unique(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        freq = np.empty(0)
    if not freq.size or not np.isfinite(freq).all() or freq[0] < 0.0:
        raise OptionError(
            f"lines = {given!r}: expected a number of lines, or lines in Hz of 0 or more",
            key=("lines",),
        )
    inside = freq[(freq >= low) & (freq <= high)]
    if not inside.size:
        raise OptionError(
            f"lines: none of them lies in the band {low:g} to {high:g} Hz; they run from"
            f" {freq[0]:g} to {freq[-1]:g} Hz",
            key=("lines",),
        )
    return inside


@dataclass(frozen=True, slots=True)
class StartDraws:
    """Draws of the start of the parameters; `OptionError` if a number is invalid.

    `robust` is the number of draws, `off` the standard deviation of the logarithm of each
    parameter.
    """

    robust: int
    off: float
    seed: int

    def __post_init__(self) -> None:
        for name in ("robust", "seed"):
            value = getattr(self, name)
            is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not is_whole or value < 0:
                raise OptionError(
                    f"{name} = {value!r}: expected a whole number of at least 0", key=(name,)
                )
        if self.robust > PLANNING.most_starts:
            raise OptionError(
                f"robust = {self.robust}: expected at most {PLANNING.most_starts:,} starts, as the"
                " plan is computed at each",
                key=("robust",),
            )
        if not is_number(self.off) or not 0.0 < self.off <= 1.0:
            raise OptionError(
                f"off = {self.off!r}: expected a share above 0 and up to 1, such as 0.2",
                key=("off",),
            )

    def points(self, coordinates: Coordinates) -> list[RealArray]:
        """Return the start of the parameters and the draws within the bounds, each shape (n,)."""
        home, rng = coordinates.start, np.random.default_rng(self.seed)
        is_factor = ~coordinates.parameters.is_damping
        out = [home]
        for _ in range(self.robust):
            step = self.off * rng.standard_normal(len(home))
            x = np.where(is_factor, home + step, home * np.exp(step))
            out.append(np.clip(x, *coordinates.bounds))
        return out
