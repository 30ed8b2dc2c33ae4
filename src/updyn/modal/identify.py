"""`identify_modes`: natural frequencies, loss factors and mode shapes from measured FRFs.

Stable poles of matrix fractions (`stabilisation`, `lscf`) are candidates; for few lines without
noise, all poles are fitted at once (`vector_fitting`). Tiles of the band are searched (`tiles`,
`search`, `envelope`), and poles are refined to maximum likelihood (`fit_all_windows`, `refine`).
Poles of one mode are merged if it differs between runs (`runs`) or leans (`leaning`, `backbone`).
Picks of the user are added (`picks`); shapes follow from the residues (`sides`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import ComplexArray
from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF
from updyn.linalg.threads import use_one_thread
from updyn.modal.axis import Axis
from updyn.modal.continuation import remove_decay
from updyn.modal.fits import Mode
from updyn.modal.measured import Measured
from updyn.modal.mode_set import ModeSet
from updyn.modal.picks import add_picks, check_picks, start_pole_at
from updyn.modal.refine import Errors, LineWindow
from updyn.modal.runs import extract_modes, is_split_off
from updyn.modal.search import Visibility
from updyn.modal.settings import MODE_WINDOW, NOISE_FREE_DATA, PHYSICAL_MODE, VECTOR_FITTING
from updyn.modal.settle import collect_poles, fit_all_windows
from updyn.modal.sides import Sides
from updyn.modal.stabilisation import Diagram, find_stable_poles
from updyn.modal.tiles import search_band
from updyn.modal.unexplained import describe_unexplained, find_unexplained
from updyn.modal.vector_fitting import RationalBasis, RationalFit, fit, fit_increasing_orders

__all__ = ["DAMPING", "identify_modes", "identify_with_picks"]


DAMPING = ("structural", "viscous")


@use_one_thread
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
        The measurement. Modes without motion at any sensor cannot be found.
    band : (float, float), optional
        Band in Hz; modes outside it are included in the fit, but not returned. None: all lines.
    damping : {"structural", "viscous"}
        Form of the modes: residue / (omega_r^2 (1 + i eta_r) - omega^2), or conjugate poles in i
        omega. For light damping, the difference is of the order of its square.
    poles : sequence of float
        Frequencies in Hz of additional modes, accepted without a test: of stable poles of the
        diagram, of peaks without a mode, or others. They are refined together with the others.

    Returns
    -------
    ModeSet
        Modes at the responses, and at references that are not among them, scaled to unit modal mass
        if a drive point was measured. It includes standard deviations of frequencies and loss
        factors; ``quality``, the share of the residual of all other modes within the half-power
        band (at least three lines) that the mode explains; the stabilisation diagram;
        ``unexplained``, the frequencies of significant peaks without a mode; and ``lean``, the
        shift of the frequency with the motion. The frequency of a leaning mode is that of small
        motion; its standard deviation includes the shift.

    Raises
    ------
    DataError
        If there are too few lines, no mode is found, or one of `poles` is not a frequency of the
        band, merges with a mode, or moves away during the refinement.
    OptionError
        If an option has no valid value.

    Notes
    -----
    The identification is deterministic. The damping of an exponential window that the data state
    (`FRF.decay`) is removed first. Loss factors are those of the selected form; for viscous
    damping, they are twice the damping ratio. A line at 0 Hz carries no information on modes and is
    not used.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> modes = updyn.identify_modes(chain.measure())
    >>> modes.frequency[:2].round(1)
    array([2.1, 6.4])
    """
    if damping not in DAMPING:
        raise OptionError(f"damping {damping!r}: {suggest(str(damping), DAMPING)}")
    return identify_with_picks(frf, band, damping, poles)[0]


def identify_with_picks(
    frf: FRF,
    band: tuple[float, float] | None,
    damping: str,
    poles: Sequence[float],
) -> tuple[ModeSet, list[int]]:
    """Return the modes, as `identify_modes`, and for each its position in `poles`, else -1."""
    picks = check_picks(poles)
    frf = remove_decay(frf.select(band=band))
    measured = Measured.of(frf, mirrored=damping == "viscous")
    if len(measured.x) <= NOISE_FREE_DATA.most_lines:
        modes = _identify_noise_free(measured)
        if modes:
            if picks:
                raise DataError("modes: data without noise on few lines have no diagram of poles")
            return _make_mode_set(frf, measured, modes, None)
    candidates, diagram = find_stable_poles(measured.freq, measured.cube)
    found = search_band(measured, measured.axis.poles(candidates))
    fits = fit_all_windows(measured, found, np.full(len(found), -1))
    modes = extract_modes(measured, fits)
    if picks:
        begin = [start_pole_at(measured, diagram, collect_poles(fits), f) for f in picks]
        shown = [mode.pole for mode in _select_modes(measured, modes)]
        fits = add_picks(measured, fits, np.array(begin), np.array(shown, dtype=np.complex128))
        modes = extract_modes(measured, fits)
    return _make_mode_set(frf, measured, _refine_exact_modes(measured, modes), diagram)


def _refine_exact_modes(measured: Measured, modes: list[Mode]) -> list[Mode]:
    """Return the modes of noise-free data to rounding accuracy."""
    # Only the polynomial for modes outside the window limits the accuracy of such data; vector
    # fitting from the known poles also finds poles outside the band.
    if not modes or min(mode.quality for mode in modes) < 1.0 - NOISE_FREE_DATA.unexplained_share:
        return modes
    begin = np.array([mode.pole for mode in modes])
    most = len(measured.x) // MODE_WINDOW.lines_per_mode
    most = min(len(begin) + NOISE_FREE_DATA.outside_poles, most)
    whole = _fit_exactly(measured, begin, most) if len(begin) <= most else None
    if whole is None:
        return modes
    nearest = [int(np.argmin(np.abs(whole.poles - pole))) for pole in begin]
    if len(set(nearest)) < len(nearest):
        return modes
    none, visibility = Errors.none(whole.residues.shape[1]), modes[0].visibility
    found = zip(whole.poles, whole.residues, strict=True)
    exact = [
        Mode(complex(p), np.zeros(2), residues, none, 1.0, visibility) for p, residues in found
    ]
    return [
        replace(
            exact[r],
            quality=mode.quality,
            visibility=mode.visibility,
            everywhere=mode.everywhere,
            added=mode.added,
        )
        for mode, r in zip(modes, nearest, strict=True)
    ]


def _identify_noise_free(measured: Measured) -> list[Mode]:
    """Return the modes of few lines without noise; none for noisy data, or without modes."""
    # Few lines may be too far apart for a search part by part, but determine all poles together.
    axis, most = measured.axis, len(measured.x) // MODE_WINDOW.lines_per_mode
    first = min(VECTOR_FITTING.first_poles, most)
    f = np.linspace(measured.freq[0], measured.freq[-1], first + 2)[1:-1]
    whole = _fit_exactly(measured, axis.pole(f, VECTOR_FITTING.new_loss_factor), most)
    if whole is None:
        return []
    Y = measured.cube.reshape(len(measured.x), -1).T
    window = LineWindow(axis.basis, measured.x, Y, whole.poles[:0])
    everything = np.full(len(Y), np.inf)
    modes = []
    for r in np.flatnonzero(measured.is_inside(whole.poles)):
        pole, residues = complex(whole.poles[r]), whole.residues[r]
        at = window.near(pole)
        sure = np.zeros(2), residues, Errors.none(len(residues)), 1.0
        modes.append(Mode(pole, *sure, Visibility.of(window, pole, residues, at, everything)))
    return sorted(modes, key=lambda mode: abs(mode.pole))


def _fit_exactly(measured: Measured, begin: ComplexArray, most: int) -> RationalFit | None:
    """Return an exact rational fit of the data by vector fitting, or None."""
    # Most noisy data are excluded by a subset of the lines, at lower cost.
    Y = measured.cube.reshape(len(measured.x), -1)
    combinations = np.linalg.svd(Y, full_matrices=False)[2].conj().T
    few = np.asarray(Y @ combinations[:, : NOISE_FREE_DATA.strongest_functions])
    basis = RationalBasis(2, measured.axis.mirrored)
    poles: ComplexArray | None = None
    coarse = max(1, len(few) // (NOISE_FREE_DATA.test_lines_per_pole * most))
    for step in sorted({coarse, 1}, reverse=True):
        poles = _find_exact_poles(basis, measured.x[::step], few[::step], begin, most)
        if poles is None:
            return None
    assert poles is not None
    return fit(basis, measured.x, Y, poles)


def _find_exact_poles(
    basis: RationalBasis, x: ComplexArray, few: ComplexArray, begin: ComplexArray, most: int
) -> ComplexArray | None:
    """Return the poles of an exact fit; None if no fit is exact."""
    fits = list(fit_increasing_orders(basis, x, few, begin, most))
    least = min(fitted.cost for fitted in fits)
    if least > NOISE_FREE_DATA.exact_squares * float(np.sum(np.abs(few) ** 2)):
        return None
    # Further poles only fit rounding errors.
    largest = NOISE_FREE_DATA.cost_margin * least
    return next(fitted for fitted in fits if fitted.cost <= largest).poles


def _make_mode_set(
    frf: FRF, measured: Measured, modes: list[Mode], diagram: Diagram | None
) -> tuple[ModeSet, list[int]]:
    """Return the visible modes with their shapes, and the pick of each, else -1."""
    axis, sides = measured.axis, Sides.of(frf)
    columns, poles = [], []
    for mode in _select_modes(measured, modes):
        poles.append(mode.pole)
        residues = mode.residues.reshape(measured.level.shape)
        pole = np.array([mode.pole])
        # A residue is scaled by the pole of its run; for a roving sensor, another pole would
        # distort the shape.
        factor = axis.modal(mode.poles, np.ones(len(mode.poles), dtype=np.complex128))
        factor = factor.reshape(measured.level.shape) * measured.level
        figures = (
            float(axis.frequency(pole)[0]),
            float(axis.loss(pole)[0]),
            float(axis.std_frequency(pole, mode.std[:, None])[0]),
            float(axis.std_loss(pole, mode.std[:, None])[0]),
            mode.quality,
            _compute_lean(axis, mode),
            mode.added,
        )
        product, common = residues * factor, mode.errors.common.reshape(-1, *factor.shape)
        noise = mode.errors.noise.reshape(factor.shape) * np.abs(factor) ** 2
        deviations = sides.deviations(product, noise, common * factor)
        of_mode = sides.shapes(product)[: 1 if mode.single else None]
        columns += [(shape, deviations, *figures) for shape in of_mode]
    unexplained = find_unexplained(measured, np.array(poles, dtype=np.complex128))
    if not columns:
        text = (
            f"modes: found none between {frf.freq[0]:g} and {frf.freq[-1]:g} Hz that explains"
            " more than noise"
        )
        raise DataError("; ".join(filter(None, (text, describe_unexplained(unexplained)))))
    shapes, std_shapes, frequency, loss, std_frequency, std_loss, quality, lean, added = zip(
        *columns, strict=True
    )
    found = ModeSet(
        frequency,
        np.array(shapes).T,
        sides.dofs,
        loss,
        sides.is_scaled,
        quality,
        frf.source,
        std_frequency=std_frequency,
        std_loss_factor=std_loss,
        std_shapes=np.array(std_shapes).T,
        diagram=diagram,
        unexplained=unexplained,
        lean=lean,
    )
    return found, [added[k] for k in np.argsort(frequency, kind="stable")]


def _compute_lean(axis: Axis, mode: Mode) -> float:
    """Return the shift of the frequency in Hz with the motion; nan if it is insignificant."""
    # If damping changes more than stiffness, the peak is flat and does not lean.
    if not mode.shift:
        return np.nan
    ends = np.array([mode.pole, mode.pole + mode.shift])
    small, large = axis.frequency(ends)
    narrow, wide = 0.5 * axis.frequency(ends) * axis.loss(ends)
    return float(large - small) if abs(large - small) >= abs(wide - narrow) else np.nan


def _select_modes(measured: Measured, modes: list[Mode]) -> list[Mode]:
    shape, mirrored = measured.level.shape, measured.axis.mirrored
    physical = [mode for mode in modes if mode.added >= 0 or _is_physical(measured, mode)]
    return [
        mode
        for mode in physical
        if mode.added >= 0 or not is_split_off(mode, physical, shape, mirrored)
    ]


def _is_physical(measured: Measured, mode: Mode) -> bool:
    """Return whether a mode is physical, not an artefact of real data."""
    sizes = np.linalg.svd(mode.residues.reshape(measured.level.shape), compute_uv=False)
    if mode.visibility.everywhere:
        shaped = len(sizes) < 3 or sizes[2] < PHYSICAL_MODE.further_shape_share * sizes[0]
    else:  # a mode of a light part, with a single shape
        single = len(sizes) < 2 or sizes[1] < PHYSICAL_MODE.local_shape_share * sizes[0]
        shaped = mode.visibility.somewhere and single
    explains = not mode.visibility.cancelled and mode.quality >= PHYSICAL_MODE.least_explained_share
    return bool(explains and shaped and mode.everywhere)
