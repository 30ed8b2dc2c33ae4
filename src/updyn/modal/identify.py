"""`identify_modes`: natural frequencies, loss factors and mode shapes from measured FRFs.

1. Poles are looked for with matrix fractions of increasing order, in overlapping parts of the band;
   those that stay from order to order are candidates (`stabilisation`, `lscf`). Few lines without
   noise determine all poles at once (`vector_fitting`).
2. Window by window, candidates are taken one after the other while they explain more than chance
   would (`search`), and refined to maximum likelihood with standard deviations (`refine`).
3. Close poles may be one mode whose frequency varies from run to run, as where a sensor moves with
   its mass. They are merged where a pole for each run fits better than several for all (`runs`).
4. Poles of the diagram that the user has picked are added and refined with the others (`added`).
5. Shapes follow from the residues (`sides`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.group import is_number
from updyn.linalg.threads import alone
from updyn.modal.axis import Axis
from updyn.modal.continuation import continued
from updyn.modal.mode_set import ModeSet
from updyn.modal.refine import Errors, Noise, Weights, Window, moved, reweighted, solved
from updyn.modal.runs import Mode, Weighted, is_split_off, modes_of
from updyn.modal.search import LEAST, SEEN, chance, searched, seen
from updyn.modal.sides import Sides
from updyn.modal.stabilisation import Diagram, stabilised
from updyn.modal.vector_fitting import Basis, Fitted, fit, growing

__all__ = ["DAMPING", "identified", "identify_modes"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

DAMPING = ("structural", "viscous")

#: Modes of a window, and how many half-power bandwidths and lines it reaches beyond them.
_TOGETHER, _BEYOND, _LINES = 6, 4.0, 20
#: Loss factors above this are no modes.
_HEAVY = 0.5
#: A residue has at most two shapes: its third singular value is below this share of the first.
_SHAPES = 0.3
#: Fits with the noise of all windows, each with the poles of the one before.
_SWEEPS = 2
#: Trial poles on an even grid: steps in half-power bandwidths, most of them.
_GRID, _TRIALS = 0.5, 200
#: Fewest lines, and lines that each mode of a window needs at least.
_FEWEST, _LINES_A_MODE = 4, 4
#: Lines of a window for each pole beside it.
_LINES_A_POLE = 5
#: Most modes of a window for each candidate.
_MORE = 2
#: What modes of data without noise leave unexplained at most, and an exact fit of them; the poles
#: outside the band that may be needed for it, and combinations of the functions.
_NEARLY, _EXACT, _OUTSIDE, _STRONGEST = 1e-4, 1e-18, 16, 12
#: Up to this many lines are tried as data without noise, from so many poles of this loss factor.
_RATIONAL, _FIRST, _LOSS = 160, 4, 0.01
#: The fewest poles are taken of exact fits that leave at most this many times the least.
_AS_GOOD = 1e3
#: Up to this many channels have weights of their own on each line.
_OWN = 4096
#: A pole is that of the diagram which is at its frequency up to this share.
_NEAR = 1e-5
#: Poles nearer than this share of a half-power bandwidth are one; one of the diagram is the same as
#: one of the fits up to this share.
_MERGED, _SAME = 0.1, 0.5
#: Negative damping up to this is rounding.
_ROUNDING = 1e-9


@alone
def identify_modes(
    frf: FRF,
    *,
    band: tuple[float, float] | None = None,
    damping: str = "structural",
    poles: Sequence[float] = (),
) -> ModeSet:
    """Identify the modes within the band of a measurement.

    Parameters
    ----------
    frf : FRF
        The measurement. Modes that have no sensor where they move cannot be found.
    band : (float, float), optional
        In Hz; modes outside of it are allowed for but not returned. None: all lines.
    damping : {"structural", "viscous"}
        The form of the modes: residue / (omega_r^2 (1 + i eta_r) - omega^2), or conjugate poles in
        i omega. For light damping the difference is of the order of its square.
    poles : sequence of float
        Frequencies in Hz of stable poles of the diagram that are modes, too, whatever they are
        worth. They are refined together with the others.

    Returns
    -------
    ModeSet
        At the responses, and at references that are not among them. Scaled to unit modal mass where
        a drive point was measured. With standard deviations of frequencies and loss factors; with
        ``quality``, the share of what the other modes leave unexplained within the half-power band
        (at least three lines) that the mode explains; with the stabilisation diagram.

    Raises
    ------
    DataError
        If there are too few lines, no mode is found, or one of `poles` is no frequency above 0, is
        not in the diagram, or merges with a mode or leaves its place as it is refined.
    OptionError
        If an option has no valid value.

    Notes
    -----
    Deterministic. The damping of a window that the data state (`FRF.decay`) is taken out first.
    Loss factors are those of the form chosen; twice the damping ratio where it is viscous. A line
    at 0 Hz says nothing of modes and is not used.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> modes = updyn.identify_modes(chain.measure())
    >>> modes.frequency[:2].round(1)
    array([2.1, 6.4])
    """
    if damping not in DAMPING:
        raise OptionError(f"damping {damping!r}: {suggest(str(damping), DAMPING)}")
    return identified(frf, band, damping, poles)[0]


def identified(
    frf: FRF,
    band: tuple[float, float] | None,
    damping: str,
    poles: Sequence[float],
) -> tuple[ModeSet, list[int]]:
    """Return the modes, as `identify_modes`, and which of `poles` each of them is: -1 for none.

    Parameters
    ----------
    frf, band, damping, poles
        As for `identify_modes`.
    """
    picked = _picked(poles)
    frf = continued(frf.select(band=band))
    measured = _Measured.of(frf, mirrored=damping == "viscous")
    if len(measured.x) <= _RATIONAL:
        modes = _of_rational_data(measured)
        if modes:
            if picked:
                raise DataError("modes: data without noise on few lines have no diagram of poles")
            return _mode_set(frf, measured, modes, None)
    candidates, diagram = stabilised(measured.freq, measured.cube)
    found = _found(measured, measured.axis.poles(candidates))
    fits = _settled(measured, found, np.full(len(found), -1))
    modes = [mode for fit in fits for mode in modes_of(fit, measured.runs)]
    if picked:
        begin = measured.axis.poles(np.array([_in(diagram, f) for f in picked]))
        shown = [mode.pole for mode in _shown(measured, modes)]
        fits = _added(measured, fits, begin, np.array(shown, dtype=np.complex128))
        modes = [mode for fit in fits for mode in modes_of(fit, measured.runs)]
    return _mode_set(frf, measured, _exact(measured, modes), diagram)


def _picked(poles: Sequence[float]) -> list[float]:
    """Return the frequencies of poles that the user has picked, in Hz."""
    for frequency in poles:
        if not is_number(frequency) or not 0.0 < frequency < np.inf:
            raise DataError(f"poles: expected frequencies in Hz above 0, found {frequency!r}")
    return [float(frequency) for frequency in poles]


def _in(diagram: Diagram, frequency: float) -> complex:
    """Return the stable pole of a diagram at a frequency, in rad/s."""
    stable = np.flatnonzero(diagram.stable)
    off = np.abs(diagram.frequency[stable] / frequency - 1.0)
    if off.min(initial=np.inf) > _NEAR:
        nearest = "; it has none"
        if len(stable):
            at = float(diagram.frequency[stable[int(np.argmin(off))]])
            nearest = f"; the nearest is at {at:.6g} Hz"
        raise DataError(f"modes: no stable pole of the diagram is at {frequency:.6g} Hz{nearest}")
    # Of poles at the same place the one of the largest order.
    alike = stable[off <= off.min() + _NEAR]
    best = alike[np.argmax(diagram.order[alike])]
    size, ratio = 2.0 * np.pi * diagram.frequency[best], diagram.damping[best]
    return complex(-size * ratio, size * np.sqrt(1.0 - ratio**2))


def _added(
    measured: _Measured, fits: list[Weighted], begin: _Complex, shown: _Complex
) -> list[Weighted]:
    """Return the fits with further poles that are modes whatever they are worth.

    Parameters
    ----------
    measured : _Measured
        The data.
    fits : list of Weighted
        Without them.
    begin : ndarray of complex, shape (m,)
        The further poles.
    shown : ndarray of complex
        Those poles of the fits that are modes.
    """
    axis, poles = measured.axis, _poles(fits)
    added = np.full(len(poles), -1)
    for number, pole in enumerate(begin):
        at = float(axis.frequency(np.array([pole]))[0])
        of = shown[_same(measured, shown, pole)]
        if len(of):
            raise DataError(
                f"modes: the pole at {at:.6g} Hz is that of the mode at"
                f" {axis.frequency(of)[0]:.6g} Hz, which is found without it"
            )
        # One that the fits have already, but that is too weak to be a mode by itself.
        hidden = _same(measured, poles, pole) & ~np.isin(poles, shown) & (added < 0)
        if hidden.any():
            added[int(np.argmax(hidden))] = number
        else:
            poles, added = np.append(poles, pole), np.append(added, number)
    order = np.argsort(axis.frequency(poles), kind="stable")
    fits = _settled(measured, poles[order], added[order])
    after, chosen = _poles(fits), np.concatenate([fit.added for fit in fits])
    for number, pole in enumerate(begin):
        own = chosen == number
        _check_added(measured, complex(pole), complex(after[own][0]), shown, after[~own])
    return fits


def _same(measured: _Measured, poles: _Complex, pole: complex) -> NDArray[np.bool_]:
    """Return which poles of the fits are one of the diagram."""
    width = np.abs(poles.real if measured.axis.mirrored else poles.imag)
    return np.asarray(np.abs(poles - pole) < _SAME * width)


def _check_added(
    measured: _Measured, first: complex, last: complex, modes: _Complex, others: _Complex
) -> None:
    """Refuse a pole that was added where the fit has moved it to a mode, or away.

    Parameters
    ----------
    measured : _Measured
        The data.
    first, last : complex
        The pole before and after.
    modes : ndarray of complex
        The modes without it.
    others : ndarray of complex
        The other poles with it.
    """
    begin, end = (float(measured.axis.frequency(np.array([p]))[0]) for p in (first, last))
    width = float(np.nanmax(measured.bandwidth(np.array([first, last]))))
    reach = max(width, float(np.median(np.diff(measured.freq))))
    name = f"modes: the pole at {begin:.6g} Hz, refined,"
    at, there = measured.axis.frequency(modes), measured.axis.frequency(others)
    own = measured.bandwidth(others)
    for mode in at[np.abs(at - end) < reach]:
        if not (np.abs(there - mode) < reach).any():
            raise DataError(f"{name} takes the place of the mode at {mode:.6g} Hz")
    near = np.abs(others - last) < _MERGED * own / np.maximum(there, 1e-300) * np.abs(others)
    if near.any():
        raise DataError(f"{name} merges with the mode at {there[near][0]:.6g} Hz")
    if not measured.inside(np.array([last]))[0]:
        raise DataError(f"{name} leaves the band or has no damping that a mode can have")
    if abs(end - begin) > reach:
        raise DataError(f"{name} leaves its place and moves to {end:.6g} Hz")


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Accelerances, scaled so that peaks of equal damping count alike."""

    axis: Axis
    freq: _Real  # shape (n_f,)
    x: _Complex  # shape (n_f,)
    cube: _Complex  # shape (n_f, n_i, n_j)
    level: _Real  # shape (n_i, n_j): what the functions were divided by

    @classmethod
    def of(cls, frf: FRF, *, mirrored: bool) -> _Measured:
        moving = frf.freq > 0.0
        freq = frf.freq[moving]
        if len(freq) < _FEWEST:
            raise DataError(
                f"modes: {len(freq)} {'line is' if len(freq) == 1 else 'lines are'} too few to"
                " identify a mode; expected at least"
                f" {_FEWEST}, better 30"
            )
        omega = 2.0 * np.pi * freq
        values = (
            frf.values[moving] * ((1j * omega) ** (2 - QUANTITIES[frf.quantity]))[:, None, None]
        )
        if not np.abs(values).any():
            raise DataError("modes: all values are zero")
        kind = 2 * (frf.responses.axes >= 3)[:, None] + (frf.references.axes >= 3)[None, :]
        level = np.ones(kind.shape)
        for k in np.unique(kind):
            rms = float(np.sqrt(np.mean(np.abs(values[:, kind == k]) ** 2)))
            if rms > 0:
                level[kind == k] = rms
        axis = Axis(mirrored, float(omega[-1]))
        cube = np.asarray(values / level, dtype=np.complex128)
        return cls(axis, freq, axis.at(freq), cube, level)

    @property
    def runs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Number of the response and of the reference of each channel."""
        rows, columns = np.indices(self.level.shape)
        return rows.reshape(-1), columns.reshape(-1)

    def window(
        self, own: _Complex, others: _Complex, residues: _Complex | None = None
    ) -> tuple[slice, Window]:
        """Return the lines of some poles, and the window with those of the others that are near.

        Where residues of the others are known, shape (m, p), the parts of those that are far are
        taken out.
        """
        f, bandwidth = self.axis.frequency(own), self.bandwidth(own)
        first, last = np.searchsorted(
            self.freq, [np.min(f - _BEYOND * bandwidth), np.max(f + _BEYOND * bandwidth)]
        )
        few = max(0, _LINES + 4 * len(own) - (last - first)) // 2
        first, last = max(0, first - few - 1), min(len(self.freq), last + few + 1)
        lines = slice(int(first), int(last))
        reach = self.freq[last - 1] - self.freq[first]
        there = self.axis.frequency(others)
        beyond = np.maximum(self.freq[first] - there, there - self.freq[last - 1])
        order = np.argsort(beyond, kind="stable")[: (last - first) // _LINES_A_POLE]
        near = order[beyond[order] < reach]
        Y = self.cube[lines].reshape(last - first, -1).T
        if residues is None:
            return lines, Window(self.axis.basis, self.x[lines], Y, others[near])
        far = np.delete(np.arange(len(others)), near)
        apart = self._part(self.x[lines], others[far], residues[far]).T
        return lines, Window(self.axis.basis, self.x[lines], Y - apart, others[near], apart)

    def _part(self, x: _Complex, poles: _Complex, residues: _Complex) -> _Complex:
        """Return the part of some modes in the functions, shape (n, p)."""
        part = (1.0 / (x[:, None] - poles)) @ residues
        if self.axis.mirrored:
            part = part + (1.0 / (x[:, None] - poles.conj())) @ residues.conj()
        return np.asarray(part)

    def bandwidth(self, poles: _Complex) -> _Real:
        """Return the widths of half power in Hz."""
        return np.asarray(self.axis.frequency(poles) * np.clip(self.axis.loss(poles), 0.0, _HEAVY))

    def inside(self, poles: _Complex) -> NDArray[np.bool_]:
        """Return which poles may be modes of the band."""
        frequency, loss = self.axis.frequency(poles), self.axis.loss(poles)
        within = (frequency >= self.freq[0]) & (frequency <= self.freq[-1])
        return np.asarray(within & (loss > -_ROUNDING) & (loss < _HEAVY))


def _groups(frequency: _Real, bandwidth: _Real) -> list[slice]:
    """Return neighbours that are fitted together: those whose lines overlap, of many a few."""
    groups, first = [], 0
    reach = np.maximum.accumulate(frequency + _BEYOND * bandwidth)
    apart = frequency[1:] - _BEYOND * bandwidth[1:] - reach[:-1]
    while first < len(frequency):
        ahead = apart[first : first + _TOGETHER]
        if (ahead > 0.0).any():
            last = first + 1 + int(np.argmax(ahead > 0.0))
        elif len(ahead) < _TOGETHER:
            last = len(frequency)
        else:
            half = _TOGETHER // 2
            last = first + 1 + half + int(np.argmax(np.diff(frequency[first + half :])[:half]))
        groups.append(slice(first, last))
        first = last
    return groups


def _found(measured: _Measured, candidates: _Complex) -> _Complex:
    """Return the poles that are modes, by ascending frequency."""
    axis = measured.axis
    candidates = candidates[measured.inside(candidates)]
    candidates = candidates[np.argsort(axis.frequency(candidates), kind="stable")]
    f = axis.frequency(candidates)
    found = np.zeros(0, dtype=np.complex128)
    low = 0.0
    for group in _groups(f, measured.bandwidth(candidates)):
        high = 0.5 * (f[group.stop - 1] + f[group.stop]) if group.stop < len(f) else np.inf
        own, after = candidates[group], candidates[group.stop :]
        lines, window = measured.window(own, np.concatenate([found, after]))
        trials = np.concatenate([own, _grid(measured, lines, own, low, high)])
        most = min(_MORE * len(own) + 2, max(1, (lines.stop - lines.start) // _LINES_A_MODE))
        poles = searched(window, trials, most).poles
        at = axis.frequency(poles)
        kept = measured.inside(poles) & (at >= low) & (at < high)
        found = np.concatenate([found, poles[kept]])
        low = high
    return found[np.argsort(axis.frequency(found), kind="stable")]


def _grid(measured: _Measured, lines: slice, own: _Complex, low: float, high: float) -> _Complex:
    """Return trial poles all over some lines."""
    f, axis = measured.freq[lines], measured.axis
    f = f[(f >= low) & (f < high)]
    if not len(f):
        return own[:0]
    loss = float(np.median(axis.loss(own)))
    steps = (f[-1] - f[0]) / max(_GRID * loss * f[0], f[-1] * 1e-9)
    at = np.linspace(f[0], f[-1], int(np.clip(steps, 2, _TRIALS)))
    return axis.pole(at, max(loss, 1e-6))


def _poles(fits: list[Weighted]) -> _Complex:
    """Return the poles of all fits."""
    none = np.zeros(0, dtype=np.complex128)
    return np.concatenate([none, *(fit.solved.poles for fit in fits)])


def _settled(measured: _Measured, poles: _Complex, added: NDArray[np.intp]) -> list[Weighted]:
    """Return the fits of all windows with the noise that all of them leave.

    Parameters
    ----------
    measured : _Measured
        The data.
    poles : ndarray of complex, shape (k,)
        To begin with, by ascending frequency.
    added : ndarray of int, shape (k,)
        Of poles that stay, whatever they are worth, a number, of others -1.
    """
    noise: Noise | None = None
    residues: _Complex | None = None
    fits: list[Weighted] = []
    for _ in range(1 + _SWEEPS):
        fits = []
        for group in _groups(measured.axis.frequency(poles), measured.bandwidth(poles)):
            others = None if residues is None else np.delete(residues, group, axis=0)
            _, window = measured.window(poles[group], np.delete(poles, group), others)
            fits.append(_pruned(measured, window, poles[group], added[group], noise))
        fits = [fit for fit in fits if len(fit.solved.poles)]
        if not fits:
            break
        poles, residues = _poles(fits), np.concatenate([fit.solved.residues for fit in fits])
        added = np.concatenate([fit.added for fit in fits])
        order = np.argsort(measured.axis.frequency(poles), kind="stable")
        poles, residues, added = poles[order], residues[order], added[order]
        squares, sizes = ([getattr(f.solved, name) for f in fits] for name in ("squares", "size"))
        noise = Noise.of(np.hstack(squares), np.hstack(sizes))
        if not measured.inside(poles[added >= 0]).all():
            break
    return fits


def _pruned(
    measured: _Measured,
    window: Window,
    poles: _Complex,
    added: NDArray[np.intp],
    noise: Noise | None,
) -> Weighted:
    """Return the fit of a window without the poles that are no modes."""
    least = chance(window)
    weights = Weights.of(np.abs(window.Y) ** 2)
    if noise is not None:
        size = solved(window, poles, weights).size
        deviation = noise.deviation(size)
        weights = Weights(np.ones((1, 1)), deviation)
        if len(deviation) > _OWN:
            weights = Weights.near(deviation)
    while True:
        if noise is None:
            fitted, weights = reweighted(window, poles, weights)
        else:
            fitted = moved(window, poles, weights)
        worth = np.where(measured.inside(fitted.poles), 2.0 * fitted.worth, 0.0)
        worth[added >= 0] = np.inf
        if not len(poles) or worth.min() > least:
            return Weighted(window, fitted, weights, added)
        last = int(np.argmin(worth))
        poles, added = np.delete(fitted.poles, last), np.delete(added, last)


def _exact(measured: _Measured, modes: list[Mode]) -> list[Mode]:
    """Return the modes of data without noise to the last digits.

    There the polynomial for what lies outside is all that keeps the fits from being exact; poles
    outside the band can be found as well, by vector fitting from the poles that are known.
    """
    if not modes or min(mode.quality for mode in modes) < 1.0 - _NEARLY:
        return modes
    begin = np.array([mode.pole for mode in modes])
    whole = _rational(measured, begin, len(begin) + _OUTSIDE)
    if whole is None:
        return modes
    nearest = [int(np.argmin(np.abs(whole.poles - pole))) for pole in begin]
    if len(set(nearest)) < len(nearest):
        return modes
    none = Errors.none(whole.residues.shape[1])
    found = zip(whole.poles, whole.residues, strict=True)
    exact = [Mode(complex(p), np.zeros(2), residues, none, 1.0, 1.0) for p, residues in found]
    return [
        replace(
            exact[r],
            quality=mode.quality,
            seen=mode.seen,
            everywhere=mode.everywhere,
            added=mode.added,
        )
        for mode, r in zip(modes, nearest, strict=True)
    ]


def _of_rational_data(measured: _Measured) -> list[Mode]:
    """Return the modes of few lines without noise; none where there is noise, or no mode.

    Few lines may be too far apart for poles to be looked for part by part, but without noise they
    determine all poles together.
    """
    axis, most = measured.axis, len(measured.x) // _LINES_A_MODE
    f = np.linspace(measured.freq[0], measured.freq[-1], min(_FIRST, most) + 2)[1:-1]
    whole = _rational(measured, axis.pole(f, _LOSS), most)
    if whole is None:
        return []
    Y = measured.cube.reshape(len(measured.x), -1).T
    window = Window(axis.basis, measured.x, Y, whole.poles[:0])
    modes = []
    for r in np.flatnonzero(measured.inside(whole.poles)):
        pole, residues = complex(whole.poles[r]), whole.residues[r]
        at = window.near(pole)
        sure = np.zeros(2), residues, Errors.none(len(residues)), 1.0
        modes.append(Mode(pole, *sure, seen(window, pole, residues, at)))
    return sorted(modes, key=lambda mode: abs(mode.pole))


def _rational(measured: _Measured, begin: _Complex, most: int) -> Fitted | None:
    """Return the rational functions that the data are, by vector fitting; None where not exact."""
    Y = measured.cube.reshape(len(measured.x), -1)
    strongest = np.linalg.svd(Y, full_matrices=False)[2][:_STRONGEST].conj().T
    few = np.asarray(Y @ strongest)
    basis = Basis(2, measured.axis.mirrored)
    fits = list(growing(basis, measured.x, few, begin, most))
    least = min(fitted.cost for fitted in fits)
    if least > _EXACT * float(np.sum(np.abs(few) ** 2)):
        return None
    # More poles than there are fit the last digits, which are rounding, only.
    first = next(fitted for fitted in fits if fitted.cost <= _AS_GOOD * least)
    return fit(basis, measured.x, Y, first.poles)


def _mode_set(
    frf: FRF, measured: _Measured, modes: list[Mode], diagram: Diagram | None
) -> tuple[ModeSet, list[int]]:
    """Return the modes that are seen, with their shapes, and which were added."""
    axis, sides = measured.axis, Sides.of(frf)
    columns = []
    for mode in _shown(measured, modes):
        residues = mode.residues.reshape(measured.level.shape)
        pole = np.array([mode.pole])
        # A residue goes with the pole of its run: where a sensor roves, another changes the shape.
        factor = axis.modal(mode.poles, np.ones(len(mode.poles), dtype=np.complex128))
        factor = factor.reshape(measured.level.shape) * measured.level
        figures = (
            float(axis.frequency(pole)[0]),
            float(axis.loss(pole)[0]),
            float(axis.std_frequency(pole, mode.std[:, None])[0]),
            float(axis.std_loss(pole, mode.std[:, None])[0]),
            mode.quality,
            mode.added,
        )
        product, common = residues * factor, mode.errors.common.reshape(-1, *factor.shape)
        noise = mode.errors.noise.reshape(factor.shape) * np.abs(factor) ** 2
        deviations = sides.deviations(product, noise, common * factor)
        columns += [(shape, deviations, *figures) for shape in sides.shapes(product)]
    if not columns:
        raise DataError(
            f"modes: none is found between {frf.freq[0]:g} and {frf.freq[-1]:g} Hz that explains"
            " more than noise would"
        )
    shapes, std_shapes, frequency, loss, std_frequency, std_loss, quality, added = zip(
        *columns, strict=True
    )
    found = ModeSet(
        frequency,
        np.array(shapes).T,
        sides.dofs,
        loss,
        sides.scaled,
        quality,
        frf.source,
        std_frequency=std_frequency,
        std_loss_factor=std_loss,
        std_shapes=np.array(std_shapes).T,
        diagram=diagram,
    )
    return found, [added[k] for k in np.argsort(frequency, kind="stable")]


def _shown(measured: _Measured, modes: list[Mode]) -> list[Mode]:
    """Return the modes that are physical, and those added."""
    shape, mirrored = measured.level.shape, measured.axis.mirrored
    physical = [mode for mode in modes if mode.added >= 0 or _physical(measured, mode)]
    return [
        mode
        for mode in physical
        if mode.added >= 0 or not is_split_off(mode, physical, shape, mirrored)
    ]


def _physical(measured: _Measured, mode: Mode) -> bool:
    """Return whether a mode is more than what keeps real data from being modes and noise."""
    sizes = np.linalg.svd(mode.residues.reshape(measured.level.shape), compute_uv=False)
    shaped = len(sizes) < 3 or sizes[2] < _SHAPES * sizes[0]
    told = SEEN <= mode.seen <= 1.0 / SEEN and mode.quality >= LEAST
    return bool(told and shaped and mode.everywhere)
