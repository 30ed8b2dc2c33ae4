"""`ResponseTarget`: the response that a plant approximates; `select_fewest`: its fewest modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.control.antiresonances import fill_antiresonances, resolve_antiresonances
from updyn.control.offsets import mirror_offsets
from updyn.control.ports import Port, port_matrix
from updyn.control.settings import PLANT_TARGET, POLES
from updyn.control.space import Conversion
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.response import response
from updyn.frf import QUANTITIES
from updyn.model import Model

__all__ = [
    "CandidateSelection",
    "ResponseTarget",
    "judge_selection",
    "receptance_function",
    "select_fewest",
    "target_lines",
]


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTarget:
    """The response of the model at a set of lines in Hz, and the references of its errors.

    `values`, shape (n_f, n_y, n_u), are those of the whole model or of a reduced one certified to
    1e-8. `level`, (n_y, n_u), is the peak of each channel, at least `floor`: the rounding of a
    channel without coupling. `broad` is the same on evenly spaced lines, as in a measurement: lower
    for a very sharp resonance. `lift`, (n_f, n_y, 1), multiplies the response for the detection of
    resonances: with motion below the band it converts to accelerations, in which that motion does
    not hide resonances. `reference`, (n_f, n_y, n_u), is |H|, at an antiresonance that one
    half-power width away. `measure`, ``"relative"`` or ``"peak"``, is the error measure of the
    tolerance.
    """

    freq: RealArray
    values: ComplexArray
    level: RealArray
    broad: RealArray
    lift: RealArray
    floor: RealArray
    reference: RealArray
    measure: str = "relative"

    @classmethod
    def of(
        cls,
        receptance: Callable[[RealArray], ComplexArray],
        quantities: tuple[str, ...],
        freq: RealArray,
        *,
        slow: bool,
        potential: Callable[[RealArray], RealArray],
        measure: str = "relative",
        reduced: bool = False,
    ) -> ResponseTarget:
        """Return the target of a receptance, a function of lines in Hz.

        `potential` is the possible magnitude of each channel from the responses at its two ports.
        `slow` tells whether rigid-body motion or a mode below the band exists, `reduced` whether
        the receptance is that of a reduced model.
        """
        power = np.array([QUANTITIES[q] for q in quantities])

        def answer(lines: RealArray) -> ComplexArray:
            rate = (2j * np.pi * lines[:, None]) ** power
            return np.asarray(receptance(lines) * rate[:, :, None])

        freq, values = resolve_antiresonances(answer, freq, answer(freq))
        resolution = PLANT_TARGET.uncoupled_share * potential(freq)
        if reduced:
            rate = np.abs(2j * np.pi * freq[:, None]) ** power
            size = np.abs(values) / rate[:, :, None]
            largest = size.max(axis=(1, 2), keepdims=True)
            error = PLANT_TARGET.reduced_error * largest * rate[:, :, None]
            resolution = np.maximum(resolution, error)
        return cls.at(freq, values, quantities, resolution, slow=slow, measure=measure)

    @classmethod
    def at(
        cls,
        freq: RealArray,
        values: ComplexArray,
        quantities: tuple[str, ...],
        resolution: RealArray,
        *,
        slow: bool,
        measure: str = "relative",
    ) -> ResponseTarget:
        """Return the target of given values; `resolution` is rounding, a floor of the peaks."""
        power = np.array([QUANTITIES[q] for q in quantities])
        size = np.abs(values)
        level = size.max(axis=0)
        even = _spread_lines(float(freq[0]), float(freq[-1]))
        broad = size[
            np.unique(np.searchsorted(freq, np.concatenate(even)).clip(max=len(freq) - 1))
        ].max(axis=0)
        lift = ((2.0 * np.pi * freq)[:, None] ** ((2 - power) * slow))[:, :, None]
        floor = resolution.max(axis=0)
        floor = np.where(floor > 0, floor, 1.0)
        reference = np.maximum(fill_antiresonances(freq, values), resolution)
        reference = np.where(reference > 0, reference, 1.0)
        return cls(
            freq,
            values,
            np.maximum(level, floor),
            np.maximum(broad, floor),
            lift,
            floor,
            reference,
            measure,
        )

    @property
    def slow(self) -> bool:
        """Whether rigid-body motion or a mode below the band exists."""
        return bool((self.lift != 1.0).any())

    def error(self, G: ComplexArray) -> float:
        """Return the largest error of a response G, as a share of the peak of its channel."""
        return float((np.abs(G - self.values) / self.level).max())

    def relative_error(self, G: ComplexArray) -> float:
        """Return the largest error of a response G, as a share of `reference` at each line."""
        return float((np.abs(G - self.values) / self.reference).max())

    def limits(self, tolerance: float) -> RealArray:
        """Return the limits of the errors of `all_errors` for a tolerance, shape (5,)."""
        if self.measure == "relative":
            return np.array([tolerance, np.inf, np.inf, np.inf, np.inf])
        return np.array([np.inf, *[tolerance] * 4])

    def worst(self, G: ComplexArray) -> float:
        """Return the largest error as a share of the `broad` peak or of a larger response."""
        # A very sharp resonance thus does not hide errors elsewhere.
        return float((np.abs(G - self.values) / np.maximum(self.broad, np.abs(self.values))).max())

    def all_errors(self, G: ComplexArray) -> RealArray:
        """Return all errors of a response G, shape (5,).

        The errors that a plant states, `relative_error`, `error` and `peak_error`; and two that the
        latter two may hide: `worst`, and `peak_error` of the response times `lift`.
        """
        return np.array(
            [
                self.relative_error(G),
                self.error(G),
                self.peak_error(G),
                self.worst(G),
                self.peak_error(G, strict=True),
            ]
        )

    def peak_error(self, G: ComplexArray, *, strict: bool = False) -> float:
        """Return the largest relative error of the height of a resonance; 0 without one."""
        # Only resonances above a tenth of the highest of their channel count. The highest values
        # between adjacent minima are compared, so a slight shift has no effect.
        magnitude, size = self._magnitude(self.values, strict), self._magnitude(G, strict)
        worst = 0.0
        for i, j in np.ndindex(*self.level.shape):
            for first, last in self.resonances(i, j, strict=strict):
                height = magnitude[first:last, i, j].max()
                worst = max(worst, abs(size[first:last, i, j].max() / height - 1.0))
        return float(worst)

    def _magnitude(self, H: ComplexArray, strict: bool) -> RealArray:
        return np.abs(H) * self.lift if strict else np.abs(H)

    def resonances(self, output: int, input: int, *, strict: bool = False) -> list[tuple[int, int]]:
        """Return the resonances of a channel, as ranges of lines from minimum to minimum."""
        if self.level[output, input] <= self.floor[output, input]:
            return []
        magnitude = self._magnitude(self.values, strict)[:, output, input]
        rises = np.diff(magnitude) > 0
        tops = np.flatnonzero(rises[:-1] & ~rises[1:]) + 1
        lows = np.concatenate(
            [[0], np.flatnonzero(~rises[:-1] & rises[1:]) + 1, [len(magnitude) - 1]]
        )
        out = []
        tops = tops[magnitude[tops] >= PLANT_TARGET.counted_height * magnitude.max()]
        for top in tops:
            out.append((int(lows[lows < top][-1]), int(lows[lows > top][0]) + 1))
        return out


def receptance_function(
    model: Model,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    solver: ReducedSolver | None,
    tier: str | None,
    backend: str | None,
) -> Callable[[RealArray], ComplexArray]:
    """Return the receptance of a model between ports as a function of lines in Hz."""
    columns, into = port_matrix(inputs, model, "input")
    rows, out = port_matrix(outputs, model, "output")

    def receptance(lines: RealArray) -> ComplexArray:
        if solver is not None and tier is None:
            coefficients = solver.system.coefficients(solver.system.start, 2.0 * np.pi * lines)
            found = solver.at(solver.solve(coefficients, columns, lines), rows).transpose(1, 0, 2)
        else:
            at = model.dofs[rows], model.dofs[columns]
            found = response(model, lines, *at, tier=tier, backend=backend).values
        return np.asarray(out @ found @ into.T)

    return receptance


def target_lines(poles: ComplexArray, band: tuple[float, float]) -> RealArray:
    """Return ascending lines in Hz that resolve every resonance of a band, both ends included."""
    # Poles (rad/s) of the damped structure: strong damping in one part moves the sharp resonances
    # of the others by more than their width.
    low, high = band
    # The response at an undamped resonance is infinite.
    poles = poles[np.abs(poles.real) > POLES.undamped_ratio * np.abs(poles)]
    width = np.abs(poles.real)
    offsets = mirror_offsets(PLANT_TARGET.line_offsets)
    around = ((np.abs(poles.imag)[:, None] + width[:, None] * offsets) / (2.0 * np.pi)).ravel()
    around = around[(around > low) & (around < high)]
    lines = np.concatenate([*_spread_lines(low, high), around, [low, high]])
    lines = np.unique(np.clip(lines, low, high))
    keep = np.concatenate([[True], np.diff(lines) > 1e-12 * high])
    return np.asarray(lines[keep])


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSelection:
    """A selection of the candidates of a conversion, with its errors and their limits.

    `errors` are those of `ResponseTarget.all_errors`; a limit is inf without a tolerance.
    """

    conversion: Conversion
    mask: BoolArray
    errors: RealArray
    limits: RealArray

    @property
    def holds(self) -> bool:
        """Whether all errors are within their limits."""
        return bool((self.errors <= self.limits).all())

    @property
    def error(self) -> float:
        """The largest of the stated errors that have a tolerance."""
        stated = self.errors[:3]
        return float(stated[np.isfinite(self.limits[:3])].max())


def _spread_lines(low: float, high: float) -> tuple[RealArray, RealArray]:
    """Return lines with even spacing and with even ratios."""
    n = PLANT_TARGET.spread_lines
    return np.linspace(low, high, n), np.geomspace(max(low, 1e-4 * high), high, n)


def select_fewest(
    conversion: Conversion, target: ResponseTarget, tolerance: float, *, lenient: bool = False
) -> CandidateSelection:
    """Return the fewest candidates that meet a tolerance; those below the band are always kept.

    With `lenient`, the tolerance applies only to the errors that a plant states; the others may be
    those of all candidates. If all candidates together do not meet it, all are returned.
    """
    # Candidates are ranked by the largest change without each one, as a share of the peak of its
    # channel or line by line: modal cost (after R. E. Skelton & P. C. Hughes, J. Dynamic Systems,
    # Measurement, and Control 102 (1980) 151-158, with the largest change instead of the mean
    # square).
    level = np.broadcast_to(target.broad, target.reference.shape)
    if target.measure == "relative":
        level = target.reference
    costs = conversion.costs(target.freq, level)
    # A servo closes its loop through slow motion, so no tolerance permits its omission.
    always = conversion.always_kept | (conversion.frequency < target.freq[0])
    costs = np.where(always, np.inf, costs)
    order = np.argsort(-costs, kind="stable")
    limits = target.limits(tolerance)
    whole = judge_selection(conversion, target, np.ones(len(order), dtype=np.bool_), limits)
    if lenient:
        limits[3:] = np.maximum(limits[3:], PLANT_TARGET.lenient_factor * whole.errors[3:])
    if not whole.holds:
        return whole
    low, high, best = int(always.sum()), len(order), whole
    while low < high:
        middle = (low + high) // 2
        tried = judge_selection(conversion, target, _first_mask(order, middle), limits)
        if tried.holds:
            high, best = middle, tried
        else:
            low = middle + 1
    for i in order[:high][::-1]:
        if always[i]:
            continue
        mask = best.mask.copy()
        mask[i] = False
        tried = judge_selection(conversion, target, mask, limits)
        if tried.holds:
            best = tried
    return best


def _first_mask(order: IndexArray, count: int) -> BoolArray:
    mask = np.zeros(len(order), dtype=np.bool_)
    mask[order[:count]] = True
    return mask


def judge_selection(
    conversion: Conversion,
    target: ResponseTarget,
    mask: BoolArray,
    limits: RealArray,
) -> CandidateSelection:
    """Return a selection of candidates with its errors."""
    return CandidateSelection(
        conversion, mask, target.all_errors(conversion.response(mask, target.freq)), limits
    )
