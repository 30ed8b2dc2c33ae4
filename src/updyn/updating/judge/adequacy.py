"""Tests of the residual of a fit against noise, by channel and frequency band."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import eigvals_banded
from scipy.special import gammainc, ndtr

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.updating.judge.settings import LIST_LENGTHS, RESIDUAL_TEST, SENSOR_NOISE
from updyn.updating.problem.noise.size import size_p_value

__all__ = [
    "OUTCOMES",
    "Adequacy",
    "Misfit",
    "NoisySensor",
    "Suspect",
    "add_noisy_sensors",
    "add_suspects",
    "adjust_p_values",
    "assess_residual",
    "can_be_sensor_noise",
    "clip_outliers",
    "divide_into_bands",
    "has_unequal_noise",
    "serial_correlation_p_values",
]


#: Weights of the autocorrelations at lags 1, 2 and 3 (Bartlett's triangle), for serial correlation
#: over a few lines.
_LAGS = np.array([0.75, 0.5, 0.25])


def clip_outliers(values: ComplexArray) -> ComplexArray:
    """Return values clipped to three times their typical size along axis 0; NaN is missing."""
    # The typical size is the median magnitude, which is 1.18 standard deviations of each part of a
    # Gaussian value.
    size = np.abs(values)
    is_missing = np.isnan(size)
    order = np.sort(np.where(is_missing, np.inf, size), axis=0)
    count = (~is_missing).sum(axis=0)
    middle = np.take_along_axis(order, np.maximum((count[None] - 1) // 2, 0), axis=0)
    std = np.where(np.isfinite(middle), middle, 0.0) / np.sqrt(2.0 * np.log(2.0))
    limit = RESIDUAL_TEST.clip_stds * std
    with np.errstate(invalid="ignore"):
        return np.asarray(
            values * np.where(size > limit, limit / np.where(size > 0, size, 1.0), 1.0)
        )


def serial_correlation_p_values(values: ComplexArray) -> RealArray:
    """Return one-sided p-values of serial correlation by column, shape (n,); NaN is missing."""
    # The statistic is r = e^H T e / e^H e with the Toeplitz matrix T of the weights 3/4, 1/2, 1/4.
    # P(r > r0) by the saddlepoint approximation of Lugannani and Rice in the form of
    # Barndorff-Nielsen (Butler, Saddlepoint Approximations, 2007, sections 1.2 and 3.1).
    # One-sided, because a window may cause negative correlation between neighbouring lines.
    out = np.ones(values.shape[1])
    is_measured = np.isfinite(values)
    for mask, columns in _group_by_pattern(is_measured):
        if mask.sum() < RESIDUAL_TEST.least_values:
            continue
        e = values[np.ix_(mask, columns)]
        power = np.sum(np.abs(e) ** 2, axis=0)
        is_nonzero = power > 0
        if not is_nonzero.any():
            continue
        diagonals = _toeplitz_diagonals(np.flatnonzero(mask))
        r = _quadratic_form(diagonals, e[:, is_nonzero]) / power[is_nonzero]
        out[columns[is_nonzero]] = _tail_probability(
            *_toeplitz_eigenvalues(diagonals, gaps=not _has_no_gaps(mask)), r
        )
    return out


def _group_by_pattern(
    is_measured: BoolArray,
) -> Iterator[tuple[BoolArray, IndexArray]]:
    """Yield each pattern of present values, shape (m,), with the indices of its columns."""
    if is_measured.all():
        yield np.ones(len(is_measured), dtype=np.bool_), np.arange(is_measured.shape[1])
        return
    patterns, pattern_of_column = np.unique(is_measured, axis=1, return_inverse=True)
    for i in range(patterns.shape[1]):
        yield patterns[:, i], np.flatnonzero(pattern_of_column.ravel() == i)


def _has_no_gaps(mask: BoolArray) -> bool:
    at = np.flatnonzero(mask)
    return bool(at[-1] - at[0] + 1 == len(at))


def _toeplitz_diagonals(at: IndexArray) -> RealArray:
    """Return the lower diagonals of T, shape (4, m): row d holds T[i + d, i] at i, padded by 0."""
    weights = np.concatenate([[0.0], _LAGS, [0.0]])
    out = np.zeros((len(_LAGS) + 1, len(at)))
    for d in range(1, min(len(_LAGS) + 1, len(at))):
        out[d, :-d] = weights[np.minimum(at[d:] - at[:-d], len(_LAGS) + 1)]
    return out


def _quadratic_form(diagonals: RealArray, e: ComplexArray) -> RealArray:
    """Return e^H T e for each column of e, shape (m, n)."""
    out = np.zeros(e.shape[1])
    for d in range(1, min(len(diagonals), len(e))):
        out += 2.0 * np.sum(diagonals[d, :-d, None] * (e[d:].conj() * e[:-d]).real, axis=0)
    return out


def _toeplitz_eigenvalues(diagonals: RealArray, *, gaps: bool) -> tuple[RealArray, RealArray]:
    """Return the eigenvalues of T in ascending order, and their multiplicities."""
    # Those of a long Toeplitz matrix are distributed like its symbol, 2 sum of t_d cos(d theta),
    # at equal steps of theta (Szegő; Gray, Toeplitz and Circulant Matrices, 2006, theorem 4.1).
    m = diagonals.shape[1]
    longest = RESIDUAL_TEST.exact_eigenvalue_lines
    if m <= longest or gaps:
        values = np.asarray(eigvals_banded(diagonals[: min(len(diagonals), m)], lower=True))
        return values, np.ones(m)
    theta = np.pi * (np.arange(longest) + 0.5) / longest
    symbol = sum(2.0 * t * np.cos((d + 1) * theta) for d, t in enumerate(_LAGS))
    return np.sort(symbol), np.full(longest, m / longest)


def _tail_probability(eigenvalues: RealArray, multiplicities: RealArray, r: RealArray) -> RealArray:
    """Return P(sum_j (eigenvalue_j - r) E_j > 0) for each r, with unit exponentials E_j."""
    edge = 1e-9 * (eigenvalues[-1] - eigenvalues[0])
    inside = np.clip(r, eigenvalues[0] + edge, eigenvalues[-1] - edge)
    a = eigenvalues[None, :] - inside[:, None]
    s = _find_saddlepoint(a, multiplicities)
    scaled = 1.0 - s[:, None] * a
    K, K2 = -np.log(scaled) @ multiplicities, (a / scaled) ** 2 @ multiplicities
    w = np.sign(s) * np.sqrt(np.maximum(-2.0 * K, 0.0))
    v = s * np.sqrt(K2)
    near = np.abs(w) < 1e-3
    safe = np.where(near, 1.0, w)
    star = safe + np.log(np.where(near, 1.0, v) / safe) / safe
    skew = 2.0 * (a**3 @ multiplicities) / (a**2 @ multiplicities) ** 1.5
    middle = -w - np.where(near, skew, 0.0) / 6.0
    return np.asarray(np.clip(ndtr(np.where(near, middle, -star)), 1e-300, 1.0))


def _find_saddlepoint(a: RealArray, multiplicities: RealArray) -> RealArray:
    """Return the root s of K'(s) = sum_j a_j / (1 - s a_j) in each row of a, ascending."""
    # K' rises from -inf to inf between the poles: Newton steps, and bisection where one leaves the
    # interval.
    low, high = 1.0 / a[:, 0], 1.0 / a[:, -1]
    rounding = 32.0 * np.finfo(np.float64).eps
    smallest = np.minimum(-low, high)
    s = 0.5 * (low + high)
    for _ in range(80):
        term = a / (1.0 - s[:, None] * a)
        slope, curvature = term @ multiplicities, term**2 @ multiplicities
        high, low = np.where(slope > 0, s, high), np.where(slope > 0, low, s)
        after = s - slope / curvature
        after = np.where((after > low) & (after < high), after, 0.5 * (low + high))
        step, s = np.abs(after - s), after
        if (step <= rounding * np.maximum(np.abs(s), smallest)).all():
            break
    return s


def adjust_p_values(p: RealArray) -> RealArray:
    """Return p-values adjusted for multiple tests."""
    # At most a share q of the adjusted p-values below q are false alarms (Benjamini & Hochberg, J.
    # R. Stat. Soc. B 57 (1995) 289).
    order = np.argsort(p, axis=None)
    n = len(order)
    # p n / rank, made monotone from the largest p-value down.
    ascending = p.ravel()[order] * (n / np.arange(1, n + 1))
    out = np.empty(n)
    out[order] = np.minimum(np.minimum.accumulate(ascending[::-1])[::-1], 1.0)
    return out.reshape(p.shape)


def divide_into_bands(level: RealArray) -> list[slice]:
    """Divide the lines into contiguous bands at the minima of the model's mean ln |H|.

    `level` must not depend on the data, so that the significance level of the tests is kept.
    """
    n, least, most = len(level), RESIDUAL_TEST.least_band_lines, RESIDUAL_TEST.most_bands
    inner = level[1:-1]
    peaks = 1 + np.flatnonzero((inner > level[:-2]) & (inner >= level[2:]))
    edges = [0]
    for a, b in pairwise(peaks.tolist()):
        edges.append(a + int(np.argmin(level[a : b + 1])))
    edges.append(n)
    while len(edges) > 2:
        sizes = np.diff(edges)
        small = int(np.argmin(sizes))
        if sizes[small] >= least and len(sizes) <= most:
            break
        sides = [i for i in (small, small + 1) if 0 < i < len(edges) - 1]
        del edges[max(sides, key=lambda i: level[edges[i]])]
    longest = max(3 * least, -(-n // 4))
    while len(edges) <= most and max(np.diff(edges)) > longest:
        at = int(np.argmax(np.diff(edges)))
        first, last = edges[at] + least, edges[at + 1] - least
        edges.insert(at + 1, first + int(np.argmin(level[first : last + 1])))
    return [slice(a, b) for a, b in pairwise(edges)]


OUTCOMES = ("noise", "structure", "excess", "exact", "untested")


@dataclass(frozen=True, slots=True)
class Misfit:
    """A channel and band (`low` to `high` in Hz) in which the model does not explain the data.

    `near` is the frequency of the largest misfit in Hz; `misfit` is the rms over the standard
    deviation of the noise; `correlation_length` is in lines (1 for noise); p-values are adjusted
    for the number of tests; `kind` is "structure" (serially correlated) or "excess" (only larger).
    """

    response: str
    reference: str
    low: float
    high: float
    near: float
    misfit: float
    correlation_length: float
    chi_square_p: float
    whiteness_p: float
    kind: str


@dataclass(frozen=True, slots=True)
class Suspect:
    """A model error that would explain the residual.

    `explains` is the share of the residual beyond the noise that a short fit with this quantity as
    an additional unknown removes; `change` is of the logarithm of a factor, or of a loss factor;
    `energy` is the share in the error in the constitutive relations. If not `confirmed` (large
    models), no fit was made, and `explains` and `change` are first-order estimates.
    """

    group: str
    quantity: str
    explains: float
    change: float
    energy: float
    confirmed: bool = False

    @property
    def name(self) -> str:
        """Name of the unknown, ``group.quantity``."""
        return f"{self.group}.{self.quantity}"


@dataclass(frozen=True, slots=True)
class NoisySensor:
    """A sensor whose rms misfit is `times` the lower median over the sensors."""

    response: str
    times: float


@dataclass(frozen=True, slots=True, eq=False)
class Adequacy:
    """Result of the tests of a residual against noise.

    Attributes
    ----------
    outcome : str
        One of `OUTCOMES`: ``"noise"``, no deviation found; ``"structure"``, serially correlated, or
        explained by a model error; ``"excess"``, only larger than the noise; ``"exact"``, zero
        within rounding; ``"untested"``, too few values.
    verdict : str
        The outcome in one or two sentences.
    absolute : bool
        Whether the size of the noise is known independently of the residual.
    chi_square : float
        Reduced chi-square of the residual; near 1 by construction if not `absolute`.
    p_value : float
        Smallest adjusted p-value; a deviation was found if it is at most `level`.
    level : float
        Largest accepted share of false alarms among fits to pure noise.
    responses, references : tuple of str
        Labels of the channels.
    bands : ndarray of float, shape (n_b, 2)
        First and last line of each band, in Hz.
    misfit, correlation_length : ndarray of float, shape (n_i, n_j, n_b)
        Rms misfit over noise, and correlation length in lines; NaN without data.
    chi_square_p, whiteness_p : ndarray of float, shape (n_i, n_j, n_b)
        Adjusted p-values; 1 if not tested.
    worst : tuple of Misfit
        Channels and bands with a significant misfit, the largest first.
    explained_by : tuple of Suspect
        Model errors that would explain the residual, the best first.
    noisy : tuple of NoisySensor
        The noisiest first. Given for ``"excess"`` if the noise of each sensor by itself explains
        the residual, and for ``"noise"`` if the noise was estimated sensor by sensor.
    lone : tuple of float
        Frequencies in Hz of isolated lines that hold most of the excess misfit.
    """

    outcome: str
    verdict: str
    absolute: bool
    chi_square: float
    p_value: float
    level: float
    responses: tuple[str, ...]
    references: tuple[str, ...]
    bands: RealArray
    misfit: RealArray
    correlation_length: RealArray
    chi_square_p: RealArray
    whiteness_p: RealArray
    worst: tuple[Misfit, ...] = ()
    explained_by: tuple[Suspect, ...] = ()
    noisy: tuple[NoisySensor, ...] = ()
    lone: tuple[float, ...] = ()

    @property
    def adequate(self) -> bool:
        """Whether the residual is consistent with noise."""
        return self.outcome in ("noise", "exact")


def assess_residual(
    whitened: ComplexArray,
    H: ComplexArray,
    freq: RealArray,
    responses: Sequence[str],
    references: Sequence[str],
    *,
    n_unknowns: int,
    absolute: bool,
    averages: int | None = None,
    level: float | None = None,
    relative: float = 1.0,
    whitened_H: ComplexArray | None = None,
) -> Adequacy:
    """Test a residual in standard deviations, shape (n_f, n_i, n_j), against noise.

    NaN marks values that were not fitted. Size: sums of squares by channel and band against the
    chi-square distribution, or against F if the noise is an estimate from `averages`. Serial
    correlation: `serial_correlation_p_values`. Channels, bands and all data are tested too,
    combined by Stouffer (1949); each family is adjusted (Benjamini & Hochberg, 1995) at its share
    of `level`. The reduction of the residual by the fit is counted for all values together, so the
    tests are conservative.
    """
    level = RESIDUAL_TEST.alarm_level if level is None else level
    is_measured = np.isfinite(whitened)
    n_values = int(is_measured.sum())
    names = tuple(map(str, responses)), tuple(map(str, references))
    band_slices = divide_into_bands(_mean_log_magnitude(H))
    first = np.array([band.start for band in band_slices])
    last = np.append(first[1:], len(freq)) - 1
    edges = np.column_stack([freq[first], freq[last]])
    shape = (*whitened.shape[1:], len(band_slices))
    square, count = np.zeros(shape), np.zeros(shape)
    lengths, serial_p_values = np.full(shape, np.nan), np.ones(shape)
    for k, band in enumerate(band_slices):
        part = whitened[band]
        square[..., k] = np.nansum(np.abs(part) ** 2, axis=0)
        count[..., k] = 2.0 * is_measured[band].sum(axis=0)
        flat = clip_outliers(part.reshape(len(part), -1))
        serial_p_values[..., k] = serial_correlation_p_values(flat).reshape(shape[:2])
        lengths[..., k] = _estimate_correlation_length(flat).reshape(shape[:2])
    freedom = 2 * n_values - n_unknowns
    chi_square = float(square.sum() / freedom) if freedom > 0 else np.nan
    with np.errstate(invalid="ignore"):
        size = np.sqrt(square / count)
    ones = np.ones(shape)
    found = Adequacy(
        "untested", "", absolute, chi_square, 1.0, level, *names, edges, size, lengths, ones, ones
    )
    if relative <= RESIDUAL_TEST.exact_misfit:
        return replace(
            found,
            outcome="exact",
            verdict="The model reproduces the data exactly; no test is possible.",
        )
    if freedom <= 0 or n_values < 2:
        text = "There are too few measured numbers to test whether the residual is noise."
        return replace(found, verdict=text)
    size_test = _SizeTest(float(square.sum()), float(count.sum()), n_unknowns, absolute, averages)
    unadjusted_serial_p = serial_p_values
    (
        (size_p_values, serial_p_values),
        (p_size, p_serial),
        (contributing_size_p, contributing_serial_p),
    ) = _test_families(square, count, serial_p_values, size_test)
    p_value, contributing_p = min(p_size, p_serial), contributing_size_p
    outcome = "noise"
    if p_serial <= level:
        outcome, contributing_p = "structure", contributing_serial_p
    elif p_value <= level:
        outcome = "excess"
        if whitened_H is not None and can_be_sensor_noise(H, whitened_H, whitened, freq):
            found = replace(
                found,
                noisy=_explain_by_sensor_noise(
                    found, square, count, unadjusted_serial_p, n_unknowns
                ),
            )
    found = replace(
        found,
        outcome=outcome,
        p_value=p_value,
        chi_square_p=size_p_values,
        whiteness_p=serial_p_values,
    )
    if p_value <= level:
        worst = _find_worst_misfits(found, contributing_p, whitened, freq, band_slices)
        found = replace(found, worst=worst, lone=_find_isolated_lines(whitened, freq))
    return replace(
        found, verdict=_describe_outcome(found) + _describe_overstated_noise(found, freedom)
    )


def _describe_overstated_noise(found: Adequacy, freedom: int) -> str:
    """Return the sentence on known noise that is larger than the residual; empty if consistent."""
    # The probability of a chi-square as small, with the degrees of freedom divided by the
    # correlation length of the residual, must be at most the level of the tests.
    if not found.absolute or found.chi_square >= RESIDUAL_TEST.overstated_chi_square:
        return ""
    lengths = found.correlation_length[np.isfinite(found.correlation_length)]
    half = 0.5 * freedom / (max(1.0, float(np.median(lengths))) if lengths.size else 1.0)
    if gammainc(half, half * found.chi_square) > found.level:
        return ""
    size = "far" if found.chi_square == 0.0 else f"{found.chi_square**-0.5:.3g} times"
    return (
        f" The stated or measured noise is {size} larger than the residual; standard deviations"
        " based on it are too large by the same factor."
    )


def can_be_sensor_noise(
    H: ComplexArray, whitened_H: ComplexArray, whitened: ComplexArray, freq: RealArray
) -> bool:
    """Return whether the residual of the sensors can be noise rather than a sensor error."""
    # Serial correlation cannot show this if lines are so far apart that the response is not
    # smooth. A wrong gain, phase or delay leaves a residual proportional to H and f H at any line
    # spacing, so the regression on both must explain no more than in noise (F test).
    level = RESIDUAL_TEST.alarm_level / H.shape[1]
    for i in range(H.shape[1]):
        is_measured = np.isfinite(whitened[:, i])
        e, h = (np.where(is_measured, values[:, i], 0.0) for values in (whitened, whitened_H))
        if not is_measured.any():
            continue
        if np.abs(e).sum() > SENSOR_NOISE.most_misfit * np.abs(h).sum():
            return False
        smoothness = serial_correlation_p_values(clip_outliers(H[:, i])).min()
        if smoothness > SENSOR_NOISE.smooth_p_value:
            return False
        A = np.stack([h.ravel(), (freq[:, None] / freq[-1] * h).ravel()], axis=1)
        residual = e.ravel() - A @ np.linalg.lstsq(A, e.ravel())[0]
        residual_square, number = (
            float(np.sum(np.abs(residual) ** 2)),
            2.0 * np.count_nonzero(is_measured),
        )
        explained_square, count = (
            np.array([np.sum(np.abs(e) ** 2) - residual_square]),
            np.array([4.0]),
        )
        if (
            _SizeTest(residual_square + explained_square[0], number, 0, False, None).p_values(
                explained_square, count
            )[0]
            < level
        ):
            return False
    return True


def has_unequal_noise(found: Adequacy) -> bool:
    """Return whether the residual differs from noise, and its size differs much between sensors."""
    if found.adequate or found.outcome == "untested":
        return False
    with np.errstate(invalid="ignore"):
        square = np.nansum(found.misfit**2, axis=(1, 2)) / np.isfinite(found.misfit).sum(
            axis=(1, 2)
        )
    std = np.sqrt(square[np.isfinite(square)])
    return len(std) > 1 and bool(std.max() >= SENSOR_NOISE.noisy_ratio * _lower_median(std))


def add_noisy_sensors(found: Adequacy, std: RealArray) -> Adequacy:
    """Return the assessment with noisy sensors, from their standard deviations in one unit."""
    noisy = _find_noisy_sensors(std, found.responses)
    return replace(found, noisy=noisy, verdict=_describe_outcome(replace(found, noisy=noisy)))


def add_suspects(found: Adequacy, suspects: Sequence[Suspect]) -> Adequacy:
    """Return the assessment with suspected model errors, the best first, named in its verdict."""
    # A residual explained by a model error is classed as structure, even without serial
    # correlation.
    if not suspects or found.adequate:
        return found
    found = replace(found, outcome="structure", explained_by=tuple(suspects), noisy=())
    return replace(found, verdict=f"{_describe_outcome(found)} {_describe_suspects(suspects)}")


def _describe_suspects(suspects: Sequence[Suspect]) -> str:
    """Return the sentence that names the best explanations of a residual."""
    best = suspects[0]
    similar = [s for s in suspects if s.explains >= 0.8 * best.explains][: LIST_LENGTHS.named_items]
    names = " or ".join(map(_describe_suspect, similar))
    share = f"{100.0 * best.explains:.0f} %"
    if not best.confirmed:
        return (
            "To first order, not confirmed by a fit, an error in"
            f" {names} would explain {share} of it."
        )
    if best.explains < RESIDUAL_TEST.explained_share:
        return f"No single quantity explains it: an error in {names} would explain most, {share}."
    return f"An error in {names} would explain {share} of it."


_QUANTITY = {
    "stiffness": "stiffness",
    "mass": "mass",
    "viscous": "viscous damping",
    "loss_factor": "loss factor",
}
_SENSOR = {"calibration": "sensor", "force_calibration": "force sensor"}


def _describe_suspect(s: Suspect) -> str:
    if s.quantity in _SENSOR:
        amount = "much" if s.change > 0 else "little"
        return f"the {_SENSOR[s.quantity]} {s.group} (reads {_describe_error_size(s)}too {amount})"
    level = "low" if s.change > 0 else "high"
    return f"the {_QUANTITY[s.quantity]} of {s.group} ({_describe_error_size(s)}too {level})"


def _describe_error_size(s: Suspect) -> str:
    """Return the size of a suspected error as text; empty if only its sign is known."""
    if not s.confirmed:
        return ""
    if s.quantity == "loss_factor":
        return f"{abs(s.change):.2g} "
    if abs(s.change) > np.log(2.0):
        return f"{np.exp(abs(s.change)):.2g} times "
    # The model's value is the true one times exp(-change); the sensor's reading is the true one
    # times exp(change).
    way = s.change if s.quantity in _SENSOR else -s.change
    return f"{100.0 * abs(np.expm1(way)):.2g} % "


def _mean_log_magnitude(H: ComplexArray) -> RealArray:
    size = np.abs(H)
    return np.asarray(np.log(np.maximum(size, np.finfo(float).tiny)).mean(axis=(1, 2)))


@dataclass(frozen=True, slots=True)
class _SizeTest:
    """Reference for tests of sums of squares: total, number of real values, unknowns, noise."""

    square: float
    count: float
    n_unknowns: int
    absolute: bool
    averages: int | None

    def p_values(self, square: RealArray, count: RealArray) -> RealArray:
        """Return the p-values of sums of squares over `count` real numbers each."""
        from scipy.special import fdtrc

        if self.absolute:
            freedom = np.maximum(np.where(count >= self.count, count - self.n_unknowns, count), 1.0)
            p = size_p_value(square, count, freedom, self.averages)
        else:
            rest, other = self.square - square, self.count - count - self.n_unknowns
            usable = (other >= 1.0) & (rest > 0.0) & (count > 0.0)
            other = np.where(usable, other, 1.0)
            ratio = (square / np.maximum(count, 1.0)) / np.where(usable, rest / other, 1.0)
            p = np.where(usable, fdtrc(np.maximum(count, 1.0), other, ratio), 1.0)
        return np.asarray(np.clip(np.where(count > 0, p, 1.0), 1e-300, 1.0))


def _test_families(
    square: RealArray, count: RealArray, white: RealArray, size: _SizeTest
) -> tuple[RealArray, RealArray, RealArray]:
    """Test each channel in each band, channels, bands, and all data together.

    Returns adjusted p-values of size and of serial correlation, shape (2, n_i, n_j, n_b); the
    smallest of all families, shape (2,); and the unadjusted p-values that contribute to it, inf
    elsewhere.
    """
    shape = square.shape
    n_bands = shape[2]
    square, count = square.reshape(-1, n_bands), count.reshape(-1, n_bands)
    white = white.reshape(-1, n_bands)
    axes: list[int | None] = []
    if len(white) > 1 and n_bands > 1:
        axes = [1, 0]
    if white.size > 1:
        axes.append(None)
    share = 1.0 + len(axes)
    unadjusted = np.stack([size.p_values(square, count), white])
    places = np.minimum(share * adjust_p_values(unadjusted), 1.0)
    least, contributing_p = places.min(axis=(1, 2)), unadjusted.copy()
    for axis in axes:
        parts = (np.asarray(values.sum(axis=axis)) for values in (square, count))
        sums = size.p_values(*parts)
        pair = np.minimum(
            share * adjust_p_values(np.stack([sums, _combine_p_values(white, axis)])), 1.0
        )
        for kind, p in enumerate(pair):
            if p.min() < least[kind]:
                least[kind] = p.min()
                is_contributing = np.zeros(p.shape, dtype=np.bool_)
                is_contributing.flat[np.argmin(p)] = True
                if axis == 1:
                    is_contributing = is_contributing[:, None]
                contributing_p[kind] = np.where(is_contributing, unadjusted[kind], np.inf)
    return places.reshape(2, *shape), least, contributing_p.reshape(2, *shape)


def _explain_by_sensor_noise(
    found: Adequacy,
    square: RealArray,
    count: RealArray,
    serial_p_values: RealArray,
    n_unknowns: int,
) -> tuple[NoisySensor, ...]:
    """Return the noisy sensors; none if the residual deviates from noise in other ways too."""
    sums, numbers = square.sum(axis=(1, 2)), count.sum(axis=(1, 2))
    has_residual = sums > 0.0
    if has_residual.sum() < 2:
        return ()
    std = np.sqrt(sums / np.maximum(numbers, 1.0))
    equalised = square / np.where(has_residual, std, 1.0)[:, None, None] ** 2
    size = _SizeTest(float(equalised.sum()), float(count.sum()), n_unknowns, False, None)
    _, least, _ = _test_families(equalised, count, serial_p_values, size)
    if least.min() <= found.level:
        return ()
    return _find_noisy_sensors(np.where(has_residual, std, np.nan), found.responses)


def _find_noisy_sensors(std: RealArray, responses: Sequence[str]) -> tuple[NoisySensor, ...]:
    """Return the sensors with more noise than most, the noisiest first; NaN marks unknown noise."""
    ratio = std / _lower_median(std[np.isfinite(std)])
    noisy = np.flatnonzero(ratio >= SENSOR_NOISE.noisy_ratio)
    order = noisy[np.argsort(-ratio[noisy], kind="stable")]
    return tuple(NoisySensor(responses[i], float(ratio[i])) for i in order)


def _lower_median(std: RealArray) -> float:
    """Return the lower median of the standard deviations of sensors."""
    return float(np.quantile(std, 0.5, method="lower"))


def _combine_p_values(p: RealArray, axis: int | None) -> RealArray:
    """Combine independent p-values by Stouffer's method; values of 1 were not tested."""
    from scipy.special import ndtr, ndtri

    is_tested = p < 1.0
    score = np.where(is_tested, -ndtri(np.where(is_tested, p, 0.5)), 0.0)
    number = is_tested.sum(axis=axis)
    combined_score = score.sum(axis=axis) / np.sqrt(np.maximum(number, 1))
    return np.asarray(np.where(number > 0, ndtr(-combined_score), 1.0))


def _estimate_correlation_length(values: ComplexArray) -> RealArray:
    """Return the correlation length of each column in lines, 1 + 2 sum of autocorrelations."""
    n = len(values)
    power = np.nansum(np.abs(values) ** 2, axis=0)
    length, is_correlated = np.ones(values.shape[1]), power > 0
    for lag in range(1, n // 2):
        product = values[lag:] * values[:-lag].conj()
        pairs = np.maximum(np.isfinite(product).sum(axis=0), 1)
        rho = np.nansum(product.real, axis=0) / np.where(is_correlated, power, 1.0)
        is_correlated &= rho * n / pairs >= 2.0 / np.sqrt(2.0 * pairs)
        if not is_correlated.any():
            break
        length[is_correlated] += 2.0 * rho[is_correlated]
    return np.where(power > 0, length, np.nan)


def _find_worst_misfits(
    found: Adequacy,
    contributing_p: RealArray,
    whitened: ComplexArray,
    freq: RealArray,
    band_slices: list[slice],
) -> tuple[Misfit, ...]:
    """Return the significant misfits, or the one of the smallest p-value if none is significant."""
    at = np.argwhere(np.minimum(found.chi_square_p, found.whiteness_p) <= found.level)
    if not len(at):
        at = np.argwhere(contributing_p == contributing_p.min())[:1]
    strength = found.misfit * np.sqrt(
        np.where(found.whiteness_p <= found.level, found.correlation_length, 1.0)
    )
    order = np.argsort(-strength[tuple(at.T)], kind="stable")[: LIST_LENGTHS.listed_misfits]
    return tuple(
        _describe_misfit(found, whitened, freq, band_slices, *map(int, index))
        for index in at[order]
    )


def _find_isolated_lines(whitened: ComplexArray, freq: RealArray) -> tuple[float, ...]:
    """Return the frequencies of isolated lines with most of the excess misfit; empty if many."""
    # A mode that the model lacks also affects the neighbouring lines.
    is_measured = np.isfinite(whitened)
    number = np.maximum(is_measured.sum(axis=(1, 2)), 1)
    power = np.where(is_measured, np.abs(whitened) ** 2, 0.0).sum(axis=(1, 2)) / number
    padded = np.pad(power, 1)
    median = np.median(power)
    usual = np.maximum(np.maximum(padded[:-2], padded[2:]), median)
    is_isolated = power > SENSOR_NOISE.isolated_ratio * usual
    excess = np.maximum(power - median, 0.0)
    if (
        is_isolated.sum() > SENSOR_NOISE.most_isolated_share * len(freq)
        or excess[is_isolated].sum() <= 0.5 * excess.sum()
    ):
        return ()
    return tuple(freq[is_isolated].tolist())


def _describe_misfit(
    found: Adequacy,
    whitened: ComplexArray,
    freq: RealArray,
    band_slices: list[slice],
    i: int,
    j: int,
    k: int,
) -> Misfit:
    band = band_slices[k]
    square = np.nan_to_num(np.abs(whitened[band, i, j]) ** 2)
    smooth = np.convolve(square, np.ones(min(3, len(square))), mode="same")
    first = max(int(np.argmax(smooth)) - 1, 0)
    near = first + int(np.argmax(square[first : first + 3]))
    return Misfit(
        found.responses[i],
        found.references[j],
        float(found.bands[k, 0]),
        float(found.bands[k, 1]),
        float(freq[band][near]),
        float(found.misfit[i, j, k]),
        float(found.correlation_length[i, j, k]),
        float(found.chi_square_p[i, j, k]),
        float(found.whiteness_p[i, j, k]),
        "structure" if found.whiteness_p[i, j, k] <= found.level else "excess",
    )


def _describe_outcome(found: Adequacy) -> str:
    if found.outcome == "noise":
        known = "" if found.absolute else ", whose size was estimated from it"
        if found.noisy:
            known += f", sensor by sensor: {_describe_noisy_sensors(found.noisy)}"
        return f"The residual cannot be distinguished from noise{known}."
    first = found.worst[0]
    where = f"channel {first.response} / {first.reference} near {first.near:.4g} Hz"
    unit = "the noise" if found.absolute else "the typical misfit"
    size = f"misfit {first.misfit:.2g} times {unit}"
    number = int(np.sum(np.minimum(found.chi_square_p, found.whiteness_p) <= found.level))
    if number == 0:
        how = "larger than the noise"
        if found.outcome == "structure":
            how = "serially correlated"
        return (
            f"The residual is {how} over many channels or bands, although none is significant by"
            f" itself; it is largest in {where}.{_describe_isolated_lines(found.lone)}"
        )
    if found.noisy:
        noisy = _describe_noisy_sensors(found.noisy)
        return f"The residual is noise of different size at the sensors: {noisy}."
    start = "More noise than expected, or outliers, in"
    if found.outcome == "structure":
        start = "The model cannot explain"
    over = "not serially correlated"
    if first.kind == "structure":
        over = f"serially correlated over {first.correlation_length:.0f} lines"
    more = ""
    if number == 2:
        more = "; and 1 more channel or band"
    elif number > 2:
        more = f"; and {number - 1} more channels or bands"
    return f"{start} {where}: {size}, {over}{more}.{_describe_isolated_lines(found.lone)}"


def _describe_isolated_lines(lone: Sequence[float]) -> str:
    """Return the sentence on isolated lines; empty without any."""
    if not lone:
        return ""
    frequencies = ", ".join(f"{f:.5g}" for f in lone[: LIST_LENGTHS.named_items])
    n_more = len(lone) - LIST_LENGTHS.named_items
    if n_more > 0:
        frequencies += f" and {n_more} more"
    which = "the isolated line" if len(lone) == 1 else "the isolated lines"
    return f" Most of it is in {which} at {frequencies} Hz."


def _describe_noisy_sensors(noisy: Sequence[NoisySensor]) -> str:
    """Return the text on the noisy sensors and their noise relative to most sensors."""
    phrases = [f"{one.times:.2g} times that of most sensors at {one.response}" for one in noisy]
    text = ", ".join(phrases[: LIST_LENGTHS.named_items])
    n_more = len(phrases) - LIST_LENGTHS.named_items
    if n_more > 0:
        text += f", and larger at {n_more} more"
    return text
