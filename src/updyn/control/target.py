"""`Target`: the response that a plant approximates; `fewest`: the modes that it keeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.control.antiresonances import raised, resolved
from updyn.control.ports import Port, port_matrix
from updyn.control.space import Conversion
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.response import response
from updyn.frf import QUANTITIES
from updyn.model import Model

__all__ = [
    "Kept",
    "Target",
    "answered",
    "fewest",
    "judged",
    "target_lines",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

_BETWEEN = 200
#: Lines around each resonance, in half-power widths.
_AROUND = np.array([-4.0, -2.0, -1.0, -0.6, -0.3, -0.1, 0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0])
#: A resonance counts down to this share of the highest one of its channel.
_COUNTS = 0.1
#: A channel below this share of what its two ports have each is one without coupling.
_UNCOUPLED = 1e-7
#: Error of a reduced model, as a share of the largest receptance of a line, over what it resolves.
_RESOLVED = 1e-6
#: A pole nearer to the axis than this share of its size is one without damping.
_UNDAMPED = 1e-9
#: Where a route cannot hold the tolerance beside a sharp peak, it has to come so near to what all
#: its modes reach.
_SHORT = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The response of the model at some lines.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_y, n_u)
        Output over input: of the whole model, or of a reduced one proved to 1e-8 where there is
        one.
    level : ndarray of float, shape (n_y, n_u)
        Peak of each channel, or `floor` where it is no more than that.
    broad : ndarray of float, shape (n_y, n_u)
        The same on evenly spaced lines, as a measurement would have it: lower where a resonance is
        very sharp.
    lift : ndarray of float, shape (n_f, n_y, 1)
        Factor by which resonances are told: with rigid-body motion or a mode below the band that to
        the accelerations, in which what is low in frequency does not hide the rest.
    floor : ndarray of float, shape (n_y, n_u)
        What is left of a channel without coupling: rounding, far below what its two ports have
        each.
    reference : ndarray of float, shape (n_f, n_y, n_u)
        Of what a relative error is a share, line by line: |H|, at an antiresonance that one
        half-power width beside it; not below what rounding leaves.
    measure : {"relative", "peak"}
        For which errors a tolerance holds.
    """

    freq: _Real
    values: _Complex
    level: _Real
    broad: _Real
    lift: _Real
    floor: _Real
    reference: _Real
    measure: str = "relative"

    @classmethod
    def of(
        cls,
        receptance: Callable[[_Real], _Complex],
        quantities: tuple[str, ...],
        freq: _Real,
        *,
        slow: bool,
        potential: Callable[[_Real], _Real],
        measure: str = "relative",
        reduced: bool = False,
    ) -> Target:
        """Compute it.

        Parameters
        ----------
        receptance : callable
            Returns that between the ports at lines in Hz, shape (n_f, n_y, n_u).
        quantities : tuple of str
            Of each output.
        freq : ndarray of float, shape (n_f,)
            Lines in Hz.
        slow : bool
            Whether there is rigid-body motion, or a mode below the band.
        potential : callable
            Returns how large each channel might be by what its two ports have each, at lines in Hz,
            shape (n_f, n_y, n_u).
        measure : {"relative", "peak"}
            For which errors a tolerance holds.
        reduced : bool
            Whether the receptance is that of a reduced model.
        """
        power = np.array([QUANTITIES[q] for q in quantities])

        def answer(lines: _Real) -> _Complex:
            rate = (2j * np.pi * lines[:, None]) ** power
            return np.asarray(receptance(lines) * rate[:, :, None])

        freq, values = resolved(answer, freq, answer(freq))
        resolution = _UNCOUPLED * potential(freq)
        if reduced:
            rate = np.abs(2j * np.pi * freq[:, None]) ** power
            size = np.abs(values) / rate[:, :, None]
            largest = size.max(axis=(1, 2), keepdims=True)
            resolution = np.maximum(resolution, _RESOLVED * largest * rate[:, :, None])
        return cls.at(freq, values, quantities, resolution, slow=slow, measure=measure)

    @classmethod
    def at(
        cls,
        freq: _Real,
        values: _Complex,
        quantities: tuple[str, ...],
        resolution: _Real,
        *,
        slow: bool,
        measure: str = "relative",
    ) -> Target:
        """Return the target with some values.

        Parameters
        ----------
        freq : ndarray of float, shape (n_f,)
            Lines in Hz.
        values : ndarray of complex, shape (n_f, n_y, n_u)
            The response.
        quantities : tuple of str
            Of each output.
        resolution : ndarray of float, shape (n_f, n_y, n_u)
            What is left of a channel without coupling.
        slow, measure
            As for `of`.
        """
        power = np.array([QUANTITIES[q] for q in quantities])
        size = np.abs(values)
        level = size.max(axis=0)
        even = (
            np.linspace(freq[0], freq[-1], _BETWEEN),
            np.geomspace(max(freq[0], 1e-4 * freq[-1]), freq[-1], _BETWEEN),
        )
        broad = size[
            np.unique(np.searchsorted(freq, np.concatenate(even)).clip(max=len(freq) - 1))
        ].max(axis=0)
        lift = ((2.0 * np.pi * freq)[:, None] ** ((2 - power) * slow))[:, :, None]
        floor = resolution.max(axis=0)
        floor = np.where(floor > 0, floor, 1.0)
        reference = np.maximum(raised(freq, values), resolution)
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
        """Whether there is rigid-body motion, or a mode below the band."""
        return bool((self.lift != 1.0).any())

    def error(self, G: _Complex) -> float:
        """Return the largest error of a channel as a share of its peak.

        Parameters
        ----------
        G : ndarray of complex, shape (n_f, n_y, n_u)
            An answer at the same lines.
        """
        return float((np.abs(G - self.values) / self.level).max())

    def relative_error(self, G: _Complex) -> float:
        """Return the largest error of a channel as a share of its own size at each line.

        At an antiresonance as a share of the level one half-power width beside it.

        Parameters
        ----------
        G : ndarray of complex, shape (n_f, n_y, n_u)
            An answer at the same lines.
        """
        return float((np.abs(G - self.values) / self.reference).max())

    def limits(self, tolerance: float) -> _Real:
        """Return what a tolerance allows of the errors of `judged`, shape (5,)."""
        if self.measure == "relative":
            return np.array([tolerance, np.inf, np.inf, np.inf, np.inf])
        return np.array([np.inf, *[tolerance] * 4])

    def worst(self, G: _Complex) -> float:
        """Return the largest error as a share of the channel's `broad` peak or a larger response.

        One very sharp resonance does not excuse what is wrong elsewhere.

        Parameters
        ----------
        G : ndarray of complex, shape (n_f, n_y, n_u)
            An answer at the same lines.
        """
        return float((np.abs(G - self.values) / np.maximum(self.broad, np.abs(self.values))).max())

    def judged(self, G: _Complex) -> _Real:
        """Return all errors of an answer, shape (5,).

        Those that a plant states, `relative_error`, `error` and `peak_error`; and what the last two
        may hide: `worst`, and `peak_error` where slow motion hides no resonance.

        Parameters
        ----------
        G : ndarray of complex, shape (n_f, n_y, n_u)
            An answer at the same lines.
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

    def peak_error(self, G: _Complex, *, strict: bool = False) -> float:
        """Return the largest relative error of the height of a resonance; 0 without one.

        Resonances from a tenth of the highest of their channel count. Heights are compared between
        the minima beside a resonance, so that a slight shift does not.

        Parameters
        ----------
        G : ndarray of complex, shape (n_f, n_y, n_u)
            An answer at the same lines.
        strict : bool
            Whether resonances and their heights are those of the response times `lift`, or of the
            response itself.
        """
        own, size = self._seen(self.values, strict), self._seen(G, strict)
        worst = 0.0
        for i, j in np.ndindex(*self.level.shape):
            for first, last in self.resonances(i, j, strict=strict):
                height = own[first:last, i, j].max()
                worst = max(worst, abs(size[first:last, i, j].max() / height - 1.0))
        return float(worst)

    def _seen(self, H: _Complex, strict: bool) -> _Real:
        return np.abs(H) * self.lift if strict else np.abs(H)

    def resonances(self, output: int, input: int, *, strict: bool = False) -> list[tuple[int, int]]:
        """Return the resonances of a channel, as ranges of lines from minimum to minimum."""
        if self.level[output, input] <= self.floor[output, input]:
            return []
        seen = self._seen(self.values, strict)[:, output, input]
        rises = np.diff(seen) > 0
        tops = np.flatnonzero(rises[:-1] & ~rises[1:]) + 1
        lows = np.concatenate([[0], np.flatnonzero(~rises[:-1] & rises[1:]) + 1, [len(seen) - 1]])
        out = []
        for top in tops[seen[tops] >= _COUNTS * seen.max()] if len(tops) else []:
            out.append((int(lows[lows < top][-1]), int(lows[lows > top][0]) + 1))
        return out


def answered(
    model: Model,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    solver: ReducedSolver | None,
    tier: str | None,
    backend: str | None,
) -> Callable[[_Real], _Complex]:
    """Return what computes the receptance of a model between ports, at lines in Hz.

    Parameters
    ----------
    model : Model
        The structure.
    inputs, outputs : tuple of Port
        Where it is driven and read.
    solver : ReducedSolver or None
        A proved reduced model, which answers where no tier is forced.
    tier, backend : str, optional
        As for `updyn.response`.
    """
    columns, into = port_matrix(inputs, model, "input")
    rows, out = port_matrix(outputs, model, "output")

    def receptance(lines: _Real) -> _Complex:
        if solver is not None and tier is None:
            coefficients = solver.system.coefficients(solver.system.start, 2.0 * np.pi * lines)
            found = solver.at(solver.solve(coefficients, columns, lines), rows).transpose(1, 0, 2)
        else:
            at = model.dofs[rows], model.dofs[columns]
            found = response(model, lines, *at, tier=tier, backend=backend).values
        return np.asarray(out @ found @ into.T)

    return receptance


def target_lines(poles: _Complex, band: tuple[float, float]) -> _Real:
    """Return lines that resolve every resonance of a band.

    Parameters
    ----------
    poles : ndarray of complex, shape (n,)
        Of the structure, in rad/s. Undamped ones are not enough: strong damping in one part moves
        the sharp resonances of the others by more than their width.
    band : (float, float)
        Lowest and highest line in Hz.

    Returns
    -------
    ndarray of float, shape (n_f,)
        In Hz, ascending, both ends included.
    """
    low, high = band
    poles = poles[
        np.abs(poles.real) > _UNDAMPED * np.abs(poles)
    ]  # at an undamped resonance there is no answer
    width = np.abs(poles.real)
    around = ((np.abs(poles.imag)[:, None] + width[:, None] * _AROUND) / (2.0 * np.pi)).ravel()
    around = around[(around > low) & (around < high)]
    spread = np.geomspace(max(low, 1e-4 * high), high, _BETWEEN)
    lines = np.concatenate([np.linspace(low, high, _BETWEEN), spread, around, [low, high]])
    lines = np.unique(np.clip(lines, low, high))
    keep = np.concatenate([[True], np.diff(lines) > 1e-12 * high])
    return np.asarray(lines[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A choice of candidates and how well it answers.

    Attributes
    ----------
    conversion : Conversion
        What was chosen from.
    mask : ndarray of bool, shape (n,)
        Which are kept.
    errors : ndarray of float, shape (5,)
        Against the model, see `Target.judged`.
    limits : ndarray of float, shape (5,)
        What was asked of them; inf of those for which the tolerance does not hold.
    """

    conversion: Conversion
    mask: NDArray[np.bool_]
    errors: NDArray[np.float64]
    limits: NDArray[np.float64]

    @property
    def holds(self) -> bool:
        """Whether nothing is beyond its limit."""
        return bool((self.errors <= self.limits).all())

    @property
    def error(self) -> float:
        """The larger of the errors that a plant states and for which the tolerance holds."""
        stated = self.errors[:3]
        return float(stated[np.isfinite(self.limits[:3])].max())


def fewest(
    conversion: Conversion, target: Target, tolerance: float, *, lenient: bool = False
) -> Kept:
    """Find the fewest candidates that hold a tolerance; those below the band are always kept.

    Modal cost: candidates are ranked by the largest change that leaving each one out makes, as a
    share of the peak of its channel, or line by line (after R. E. Skelton & P. C. Hughes, J.
    Dynamic Systems, Measurement, and Control 102 (1980) 151-158, in the largest instead of the mean
    square). Double integrators are always kept and need no Gramian. The number comes by bisection,
    and single ones are then left out as long as the tolerance holds.

    Parameters
    ----------
    conversion : Conversion
        The candidates.
    target : Target
        What to answer like.
    tolerance : float
        On the errors that `Target.measure` names.
    lenient : bool
        False: all of `Target.judged` has to be within the tolerance. True: what a plant states, and
        of the rest what all candidates together reach.

    Returns
    -------
    Kept
        All candidates, where not even these hold the tolerance; see `Kept.holds`.
    """
    level = np.broadcast_to(target.broad, target.reference.shape)
    if target.measure == "relative":
        level = target.reference
    costs = conversion.costs(target.freq, level)
    # A servo closes its loop through what is slow: it is not for a tolerance to leave that out.
    always = conversion.always | (conversion.frequency < target.freq[0])
    costs = np.where(always, np.inf, costs)
    order = np.argsort(-costs, kind="stable")
    limits = target.limits(tolerance)
    whole = judged(conversion, target, np.ones(len(order), dtype=np.bool_), limits)
    if lenient:
        limits[3:] = np.maximum(limits[3:], _SHORT * whole.errors[3:])
    if not whole.holds:
        return whole
    low, high, best = int(always.sum()), len(order), whole
    while low < high:
        middle = (low + high) // 2
        tried = judged(conversion, target, _first(order, middle), limits)
        if tried.holds:
            high, best = middle, tried
        else:
            low = middle + 1
    for i in order[:high][::-1]:
        if always[i]:
            continue
        mask = best.mask.copy()
        mask[i] = False
        tried = judged(conversion, target, mask, limits)
        if tried.holds:
            best = tried
    return best


def _first(order: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(len(order), dtype=np.bool_)
    mask[order[:count]] = True
    return mask


def judged(
    conversion: Conversion, target: Target, mask: NDArray[np.bool_], limits: NDArray[np.float64]
) -> Kept:
    """Return a choice of candidates with its errors.

    Parameters
    ----------
    conversion : Conversion
        The candidates.
    target : Target
        What to answer like.
    mask : ndarray of bool, shape (n,)
        Which are kept.
    limits : ndarray of float, shape (5,)
        Of the errors, as `Target.limits`.
    """
    return Kept(conversion, mask, target.judged(conversion.response(mask, target.freq)), limits)
