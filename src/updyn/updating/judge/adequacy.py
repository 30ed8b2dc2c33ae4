"""Tests of the residual of a fit against noise, by channel and frequency band."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvals_banded
from scipy.special import gammainc, ndtr

from updyn.updating.problem.noise.size import size_p

__all__ = [
    "EXPLAINED",
    "OUTCOMES",
    "Adequacy",
    "Misfit",
    "Noisy",
    "Suspect",
    "adjusted",
    "assess",
    "bands",
    "blamed",
    "clipped",
    "may_be_noisy",
    "scatters_unequally",
    "serial_p",
    "with_own_noise",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Weights of the autocorrelations at lags 1, 2 and 3 (Bartlett's triangle), for serial correlation
#: over a few lines.
_LAGS = np.array([0.75, 0.5, 0.25])
#: Least number of values for a test of serial correlation.
_FEWEST = 5
#: Limit in standard deviations to which values are clipped before correlations are computed; 1 % of
#: Gaussian values exceed it.
_CUT = 3.0
#: Number of lines above which eigenvalues are approximated by the symbol of the Toeplitz matrix,
#: and number of points at which the symbol is evaluated.
_LONG = 512
#: Least share of the residual for one quantity to explain it; two errors of equal size explain half
#: each.
EXPLAINED = 0.5
#: Reduced chi-square below which stated noise is reported as too large. It corresponds to a factor
#: of 2 in the standard deviation; smaller errors are usual in stated noise.
_OVERSTATED = 0.25
#: Least number of lines in a band.
_LEAST = 8
#: Largest number of bands.
_MOST = 24


def clipped(values: _Complex) -> _Complex:
    """Return values clipped to three times their typical size, to limit the effect of outliers.

    The values along the first axis have equal variance; NaN marks missing values. The typical size
    is the median magnitude, which is 1.18 standard deviations of each part of a Gaussian value.
    """
    size = np.abs(values)
    missing = np.isnan(size)
    order = np.sort(np.where(missing, np.inf, size), axis=0)
    count = (~missing).sum(axis=0)
    middle = np.take_along_axis(order, np.maximum((count[None] - 1) // 2, 0), axis=0)
    limit = _CUT * np.where(np.isfinite(middle), middle, 0.0) / np.sqrt(2.0 * np.log(2.0))
    with np.errstate(invalid="ignore"):
        return np.asarray(
            values * np.where(size > limit, limit / np.where(size > 0, size, 1.0), 1.0)
        )


def serial_p(values: _Complex) -> _Real:
    """Return one-sided p-values of serial correlation against independent noise, shape (n,).

    Parameters
    ----------
    values : ndarray of complex, shape (m, n)
        Columns of circular values at neighbouring lines, of equal variance within a column; NaN
        marks missing values. The p-value of a column with too few values is 1.

    Notes
    -----
    The statistic is r = e^H T e / e^H e. T is a Toeplitz matrix with 0 on the diagonal and 3/4,
    1/2, 1/4 on the next three diagonals, so r is a weighted sum of autocorrelations and does not
    depend on the scale of the noise. For Gaussian noise, P(r > r0) is the probability that a sum of
    exponential variables with the eigenvalues of T - r0 as weights is positive. Its tail is
    computed by the saddlepoint approximation of Lugannani and Rice in the form of
    Barndorff-Nielsen, accurate to 1 % even far out (Butler, Saddlepoint Approximations, 2007,
    sections 1.2 and 3.1). The test is one-sided because a window may cause negative correlation
    between neighbouring lines.
    """
    out = np.ones(values.shape[1])
    there = np.isfinite(values)
    for mask, columns in _by_pattern(there):
        if mask.sum() < _FEWEST:
            continue
        e = values[np.ix_(mask, columns)]
        power = np.sum(np.abs(e) ** 2, axis=0)
        full = power > 0
        if not full.any():
            continue
        diagonals = _diagonals(np.flatnonzero(mask))
        r = _form(diagonals, e[:, full]) / power[full]
        out[columns[full]] = _tail(*_eigenvalues(diagonals, gaps=not _consecutive(mask)), r)
    return out


def _by_pattern(
    there: NDArray[np.bool_],
) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.intp]]]:
    """Yield each pattern of present values, shape (m,), with the indices of its columns."""
    patterns, of = np.unique(there, axis=1, return_inverse=True)
    for i in range(patterns.shape[1]):
        yield patterns[:, i], np.flatnonzero(of.ravel() == i)


def _consecutive(mask: NDArray[np.bool_]) -> bool:
    at = np.flatnonzero(mask)
    return bool(at[-1] - at[0] + 1 == len(at))


def _diagonals(at: NDArray[np.intp]) -> _Real:
    """Return the lower diagonals of T, shape (4, m): row d holds T[i + d, i] at i, padded by 0."""
    weights = np.concatenate([[0.0], _LAGS, [0.0]])
    out = np.zeros((len(_LAGS) + 1, len(at)))
    for d in range(1, min(len(_LAGS) + 1, len(at))):
        out[d, :-d] = weights[np.minimum(at[d:] - at[:-d], len(_LAGS) + 1)]
    return out


def _form(diagonals: _Real, e: _Complex) -> _Real:
    """Return e^H T e for each column of e, shape (m, n)."""
    out = np.zeros(e.shape[1])
    for d in range(1, min(len(diagonals), len(e))):
        out += 2.0 * np.sum(diagonals[d, :-d, None] * (e[d:].conj() * e[:-d]).real, axis=0)
    return out


def _eigenvalues(diagonals: _Real, *, gaps: bool) -> tuple[_Real, _Real]:
    """Return the eigenvalues of T in ascending order, and their multiplicities.

    The eigenvalues of a long Toeplitz matrix are distributed like the values of its symbol, 2 sum
    of t_d cos(d theta), at equal steps of theta (Szegő's theorem; Gray, Toeplitz and Circulant
    Matrices, 2006, theorem 4.1).
    """
    m = diagonals.shape[1]
    if m <= _LONG or gaps:
        values = np.asarray(eigvals_banded(diagonals[: min(len(diagonals), m)], lower=True))
        return values, np.ones(m)
    theta = np.pi * (np.arange(_LONG) + 0.5) / _LONG
    symbol = sum(2.0 * t * np.cos((d + 1) * theta) for d, t in enumerate(_LAGS))
    return np.sort(symbol), np.full(_LONG, m / _LONG)


def _tail(eigenvalues: _Real, often: _Real, r: _Real) -> _Real:
    """Return P(sum_j (eigenvalue_j - r) E_j > 0) for independent unit exponentials E_j, for each r.

    `often` holds the multiplicities of the eigenvalues.
    """
    edge = 1e-9 * (eigenvalues[-1] - eigenvalues[0])
    inside = np.clip(r, eigenvalues[0] + edge, eigenvalues[-1] - edge)
    a = eigenvalues[None, :] - inside[:, None]
    low, high = 1.0 / a[:, 0], 1.0 / a[:, -1]
    for _ in range(80):  # K' rises from -inf to inf between the poles
        s = 0.5 * (low + high)
        rising = (a / (1.0 - s[:, None] * a)) @ often > 0
        high, low = np.where(rising, s, high), np.where(rising, low, s)
    s = 0.5 * (low + high)
    share = 1.0 - s[:, None] * a
    K, K2 = -np.log(share) @ often, (a / share) ** 2 @ often
    w = np.sign(s) * np.sqrt(np.maximum(-2.0 * K, 0.0))
    v = s * np.sqrt(K2)
    near = np.abs(w) < 1e-3
    safe = np.where(near, 1.0, w)
    star = safe + np.log(np.where(near, 1.0, v) / safe) / safe
    skew = 2.0 * (a**3 @ often) / (a**2 @ often) ** 1.5
    middle = -w - np.where(near, skew, 0.0) / 6.0
    return np.asarray(np.clip(ndtr(np.where(near, middle, -star)), 1e-300, 1.0))


def adjusted(p: _Real) -> _Real:
    """Return p-values adjusted for multiple tests, of the same shape.

    Among the adjusted p-values below q, the expected share of false alarms is at most q. For pure
    noise, the probability of any alarm is at most q (Benjamini & Hochberg, J. R. Stat. Soc. B 57
    (1995) 289).
    """
    order = np.argsort(p, axis=None)
    n = len(order)
    # p n / rank, made monotone from the largest p-value down.
    ascending = p.ravel()[order] * (n / np.arange(1, n + 1))
    out = np.empty(n)
    out[order] = np.minimum(np.minimum.accumulate(ascending[::-1])[::-1], 1.0)
    return out.reshape(p.shape)


def bands(level: _Real) -> list[slice]:
    """Divide the lines into contiguous bands, one for each resonance of the model.

    `level`, shape (n_f,), is the mean logarithm of the model's |H| at the lines; it does not depend
    on the data, so the significance level of the tests is kept. Bands are divided at the minima
    between peaks. A band of fewer than eight lines is merged with the neighbour on the side of the
    higher minimum. A band of more than a quarter of all lines is divided at its lowest level.
    """
    n = len(level)
    inner = level[1:-1]
    peaks = 1 + np.flatnonzero((inner > level[:-2]) & (inner >= level[2:]))
    edges = [0]
    for a, b in pairwise(peaks.tolist()):
        edges.append(a + int(np.argmin(level[a : b + 1])))
    edges.append(n)
    while len(edges) > 2:
        sizes = np.diff(edges)
        small = int(np.argmin(sizes))
        if sizes[small] >= _LEAST and len(sizes) <= _MOST:
            break
        sides = [i for i in (small, small + 1) if 0 < i < len(edges) - 1]
        del edges[max(sides, key=lambda i: level[edges[i]])]
    longest = max(3 * _LEAST, -(-n // 4))
    while len(edges) <= _MOST and max(np.diff(edges)) > longest:
        at = int(np.argmax(np.diff(edges)))
        first, last = edges[at] + _LEAST, edges[at + 1] - _LEAST
        edges.insert(at + 1, first + int(np.argmin(level[first : last + 1])))
    return [slice(a, b) for a, b in pairwise(edges)]


OUTCOMES = ("noise", "structure", "excess", "exact", "untested")
#: Largest accepted share of false alarms among fits to pure noise.
LEVEL = 0.02
#: Misfit, relative to the rms of the data, below which the fit is exact and no test is made.
_EXACT = 1e-7
#: Largest number of listed misfits.
_LISTED = 12
#: Largest number of groups or sensors named in a sentence.
_NAMED = 3
#: A sensor is noisy if its noise exceeds the median of the sensors by the first factor; its misfit
#: relative to its response may not exceed the second value.
_NOISY, _MISSED = 1.5, 0.3
#: Least ratio of the squared misfit of an isolated line to its neighbours and to the median line;
#: largest share of isolated lines.
_ALONE, _FEW_LINES = 9.0, 0.05
#: Largest p-value of serial correlation of a response that is smooth along the lines.
_SMOOTH = 1e-3


@dataclass(frozen=True, slots=True)
class Misfit:
    """A channel and band in which the model does not explain the data.

    Attributes
    ----------
    response, reference : str
        The channel.
    low, high : float
        Limits of the band in Hz.
    near : float
        Frequency of the largest misfit in the band, in Hz.
    misfit : float
        Rms misfit divided by the standard deviation of the noise.
    correlation_length : float
        Correlation length in lines; 1 for noise.
    chi_square_p, whiteness_p : float
        p-values of the size and of the serial correlation under the hypothesis of noise, adjusted
        for the number of tests.
    kind : {"structure", "excess"}
        Serially correlated, or only larger than the noise.
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

    Attributes
    ----------
    group, quantity : str
        The quantity in error: ``"stiffness"``, ``"mass"``, ``"viscous"`` or ``"loss_factor"`` of a
        group; ``"calibration"`` or ``"force_calibration"`` of a sensor.
    explains : float
        Share of the residual beyond the noise that was removed by a short fit with this quantity as
        an additional unknown. Errors that the channels cannot distinguish have nearly the same
        share.
    change : float
        Change found by that fit, of the logarithm of a factor or of a loss factor.
    energy : float
        Share of this matrix in the energy of the error in the constitutive relations, at the lines
        with the largest misfit.
    confirmed : bool
        Whether such a fit was made. It is omitted for large models: `explains` and `change` are
        then first-order estimates, and the sign of a change is more reliable than its size.
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
class Noisy:
    """A sensor with more noise than most sensors.

    Attributes
    ----------
    response : str
        The sensor.
    times : float
        Its rms misfit divided by the lower median over the sensors.
    """

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
        Whether the size of the noise is known independently of the residual. If it was estimated
        from the residual, the size of a misfit is compared with the rest of the data. The test of
        serial correlation does not use the size.
    chi_square : float
        Reduced chi-square of the residual; near 1 by construction if not `absolute`.
    p_value : float
        Smallest p-value, adjusted for the number of tests; a deviation from noise was found if it
        is at most `level`.
    level : float
        Significance level: largest accepted share of false alarms among fits to pure noise.
    responses, references : tuple of str
        Labels of the channels.
    bands : ndarray of float, shape (n_b, 2)
        First and last line of each band, in Hz.
    misfit, correlation_length : ndarray of float, shape (n_i, n_j, n_b)
        By channel and band: rms misfit over noise, and correlation length in lines. NaN without
        data.
    chi_square_p, whiteness_p : ndarray of float, shape (n_i, n_j, n_b)
        Adjusted p-values; 1 if not tested.
    worst : tuple of Misfit
        Channels and bands with a significant misfit, the largest first; empty without any.
    explained_by : tuple of Suspect
        Model errors that would explain the residual, the best first; empty without any.
    noisy : tuple of Noisy
        Sensors with more noise than most, the noisiest first. Given for ``"excess"`` if the noise
        of each sensor by itself explains the residual, and for ``"noise"`` if the noise was
        estimated for each sensor because the sensors differ.
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
    bands: _Real
    misfit: _Real
    correlation_length: _Real
    chi_square_p: _Real
    whiteness_p: _Real
    worst: tuple[Misfit, ...] = ()
    explained_by: tuple[Suspect, ...] = ()
    noisy: tuple[Noisy, ...] = ()
    lone: tuple[float, ...] = ()

    @property
    def adequate(self) -> bool:
        """Whether the residual is consistent with noise."""
        return self.outcome in ("noise", "exact")


def assess(
    whitened: _Complex,
    H: _Complex,
    freq: _Real,
    responses: Sequence[str],
    references: Sequence[str],
    *,
    n_unknowns: int,
    absolute: bool,
    averages: int | None = None,
    level: float = LEVEL,
    relative: float = 1.0,
    course: _Complex | None = None,
) -> Adequacy:
    """Test a residual against noise.

    Parameters
    ----------
    whitened : ndarray of complex, shape (n_f, n_i, n_j)
        Measured minus computed FRF, divided by the standard deviation of the real (and of the
        imaginary) part; NaN for values that were not fitted.
    H : ndarray of complex, shape (n_f, n_i, n_j)
        FRF of the model, whose resonances determine the bands.
    freq : ndarray of float, shape (n_f,)
        Frequency lines in Hz.
    responses, references : sequence of str
        Labels.
    n_unknowns : int
        Number of unknowns fitted to these data.
    absolute : bool
        Whether the size of the noise is known independently of this residual.
    averages : int, optional
        Number of averages from which the noise was estimated at each line; None if it is known
        exactly.
    level : float
        Largest accepted share of false alarms among fits to pure noise.
    relative : float
        Rms misfit over the rms of the data, which distinguishes a residual from rounding.
    course : ndarray of complex, shape (n_f, n_i, n_j), optional
        H divided by the standard deviations. Without it, no sensor is reported as noisy.

    Returns
    -------
    Adequacy

    Notes
    -----
    Size: the sum of squares of a channel in a band is tested against the chi-square distribution
    with two degrees of freedom per value, or against the F distribution if the size of the noise is
    an estimate. An estimate from n averages has n - 1 times as many degrees of freedom, limited to
    those of sixteen lines, because smoothing correlates the errors of the estimate. An estimate
    from this residual is tested by the ratio to all other values. The fit reduces the residual
    below the noise; this is counted for all values together and not by band, so the tests are
    conservative. Serial correlation: `serial_p`. Channels over all bands, bands over all channels,
    and all data together are tested too; their p-values of correlation are combined by Stouffer's
    sum of normal scores (1949). Each of these families is adjusted by the method of Benjamini &
    Hochberg (1995) at its share of `level`.
    """
    there = np.isfinite(whitened)
    n_values = int(there.sum())
    names = tuple(map(str, responses)), tuple(map(str, references))
    cut = bands(_mean_level(H))
    first = np.array([band.start for band in cut])
    last = np.append(first[1:], len(freq)) - 1
    edges = np.column_stack([freq[first], freq[last]])
    shape = (*whitened.shape[1:], len(cut))
    square, count = np.zeros(shape), np.zeros(shape)
    lengths, white = np.full(shape, np.nan), np.ones(shape)
    for k, band in enumerate(cut):
        part = whitened[band]
        square[..., k] = np.nansum(np.abs(part) ** 2, axis=0)
        count[..., k] = 2.0 * there[band].sum(axis=0)
        flat = clipped(part.reshape(len(part), -1))
        white[..., k] = serial_p(flat).reshape(shape[:2])
        lengths[..., k] = _length(flat).reshape(shape[:2])
    freedom = 2 * n_values - n_unknowns
    chi_square = float(square.sum() / freedom) if freedom > 0 else np.nan
    with np.errstate(invalid="ignore"):
        size = np.sqrt(square / count)
    one = np.ones(shape)
    found = Adequacy(
        "untested", "", absolute, chi_square, 1.0, level, *names, edges, size, lengths, one, one
    )
    if relative <= _EXACT:
        return replace(
            found,
            outcome="exact",
            verdict="The model answers the data exactly; nothing is left to test.",
        )
    if freedom <= 0 or n_values < 2:
        text = "There are too few measured numbers to test whether the residual is noise."
        return replace(found, verdict=text)
    against = _Size(float(square.sum()), float(count.sum()), n_unknowns, absolute, averages)
    alone = white
    (large, white), (p_size, p_serial), (telling_size, telling_serial) = _tested(
        square, count, white, against
    )
    p_value, telling = min(p_size, p_serial), telling_size
    outcome = "noise"
    if p_serial <= level:
        outcome, telling = "structure", telling_serial
    elif p_value <= level:
        outcome = "excess"
        if course is not None and may_be_noisy(H, course, whitened, freq):
            found = replace(found, noisy=_noisy(found, square, count, alone, n_unknowns))
    found = replace(found, outcome=outcome, p_value=p_value, chi_square_p=large, whiteness_p=white)
    if p_value <= level:
        worst = _worst(found, telling, whitened, freq, cut)
        found = replace(found, worst=worst, lone=_lone(whitened, freq))
    return replace(found, verdict=_words(found) + _overstated(found, freedom))


def _overstated(found: Adequacy, freedom: int) -> str:
    """Return the sentence on known noise that is larger than the residual; empty if consistent.

    A small chi-square of few values may be due to chance. The probability of one as small, with the
    degrees of freedom divided by the correlation length of the residual, must be at most the level
    of the tests.
    """
    if not found.absolute or found.chi_square >= _OVERSTATED:
        return ""
    lengths = found.correlation_length[np.isfinite(found.correlation_length)]
    half = 0.5 * freedom / (max(1.0, float(np.median(lengths))) if lengths.size else 1.0)
    if gammainc(half, half * found.chi_square) > found.level:
        return ""
    size = "far" if found.chi_square == 0.0 else f"{found.chi_square**-0.5:.3g} times"
    return (
        f" The noise that was stated or measured is {size} larger than what the residual shows;"
        " standard deviations that rest on it are as much too large."
    )


def may_be_noisy(H: _Complex, course: _Complex, whitened: _Complex, freq: _Real) -> bool:
    """Return whether the residual of the sensors can be noise rather than a sensor error.

    If the lines are so far apart that the response is not smooth along them, serial correlation
    cannot distinguish noise from sensor errors. The same holds if the misfit exceeds about a third
    of the response. A wrong gain, phase or delay leaves a residual proportional to H and f H at any
    line spacing, so the part found by regression must be as small as in noise (F test). The
    arguments are those of `assess`.
    """
    level = LEVEL / H.shape[1]
    for i in range(H.shape[1]):
        seen = np.isfinite(whitened[:, i])
        e, h = (np.where(seen, values[:, i], 0.0) for values in (whitened, course))
        if not seen.any():
            continue
        if (
            np.abs(e).sum() > _MISSED * np.abs(h).sum()
            or serial_p(clipped(H[:, i])).min() > _SMOOTH
        ):
            return False
        A = np.stack([h.ravel(), (freq[:, None] / freq[-1] * h).ravel()], axis=1)
        left = e.ravel() - A @ np.linalg.lstsq(A, e.ravel())[0]
        rest, number = float(np.sum(np.abs(left) ** 2)), 2.0 * np.count_nonzero(seen)
        gained, count = np.array([np.sum(np.abs(e) ** 2) - rest]), np.array([4.0])
        if _Size(rest + gained[0], number, 0, False, None).p(gained, count)[0] < level:
            return False
    return True


def scatters_unequally(found: Adequacy) -> bool:
    """Return whether the residual differs from noise, and its size differs much between sensors."""
    if found.adequate or found.outcome == "untested":
        return False
    with np.errstate(invalid="ignore"):
        square = np.nansum(found.misfit**2, axis=(1, 2)) / np.isfinite(found.misfit).sum(
            axis=(1, 2)
        )
    own = np.sqrt(square[np.isfinite(square)])
    return len(own) > 1 and bool(own.max() >= _NOISY * _usual(own))


def with_own_noise(found: Adequacy, std: _Real) -> Adequacy:
    """Return the assessment with noisy sensors, for noise estimated sensor by sensor.

    `std`, shape (n_i,), holds the standard deviations of the sensors in one unit.
    """
    noisy = _louder_than_most(std, found.responses)
    return replace(found, noisy=noisy, verdict=_words(replace(found, noisy=noisy)))


def blamed(found: Adequacy, suspects: Sequence[Suspect]) -> Adequacy:
    """Return the assessment with suspected model errors, the best first, named in its verdict.

    A residual explained by a model error is classed as structure, even if the lines are too far
    apart for serial correlation.
    """
    if not suspects or found.adequate:
        return found
    found = replace(found, outcome="structure", explained_by=tuple(suspects), noisy=())
    return replace(found, verdict=f"{_words(found)} {_explanation(suspects)}")


def _explanation(suspects: Sequence[Suspect]) -> str:
    """Return the sentence that names the best explanations of a residual."""
    best = suspects[0]
    telling = [s for s in suspects if s.explains >= 0.8 * best.explains][:_NAMED]
    named = " or ".join(map(_suspected, telling))
    share = f"{100.0 * best.explains:.0f} %"
    if not best.confirmed:
        return (
            "By an estimate of first order, which no fit has confirmed, an error in"
            f" {named} would explain {share} of it."
        )
    if best.explains < EXPLAINED:
        return f"No single quantity explains it: the most, {share}, an error in {named} would."
    return f"An error in {named} would explain {share} of it."


_QUANTITY = {
    "stiffness": "stiffness",
    "mass": "mass",
    "viscous": "viscous damping",
    "loss_factor": "loss factor",
}
_SENSOR = {"calibration": "sensor", "force_calibration": "force sensor"}


def _suspected(s: Suspect) -> str:
    if s.quantity in _SENSOR:
        amount = "much" if s.change > 0 else "little"
        return f"the {_SENSOR[s.quantity]} {s.group} (reads {_by_how_much(s)}too {amount})"
    level = "low" if s.change > 0 else "high"
    return f"the {_QUANTITY[s.quantity]} of {s.group} ({_by_how_much(s)}too {level})"


def _by_how_much(s: Suspect) -> str:
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


def _mean_level(H: _Complex) -> _Real:
    size = np.abs(H)
    return np.asarray(np.log(np.maximum(size, np.finfo(float).tiny)).mean(axis=(1, 2)))


@dataclass(frozen=True, slots=True)
class _Size:
    """Reference for tests of sums of squares: total, number of real values, unknowns, noise."""

    square: float
    count: float
    n_unknowns: int
    absolute: bool
    averages: int | None

    def p(self, square: _Real, count: _Real) -> _Real:
        """Return the p-values of sums of squares over `count` real numbers each."""
        from scipy.special import fdtrc

        if self.absolute:
            freedom = np.maximum(np.where(count >= self.count, count - self.n_unknowns, count), 1.0)
            p = size_p(square, count, freedom, self.averages)
        else:
            rest, other = self.square - square, self.count - count - self.n_unknowns
            usable = (other >= 1.0) & (rest > 0.0) & (count > 0.0)
            other = np.where(usable, other, 1.0)
            ratio = (square / np.maximum(count, 1.0)) / np.where(usable, rest / other, 1.0)
            p = np.where(usable, fdtrc(np.maximum(count, 1.0), other, ratio), 1.0)
        return np.asarray(np.clip(np.where(count > 0, p, 1.0), 1e-300, 1.0))


def _tested(square: _Real, count: _Real, white: _Real, size: _Size) -> tuple[_Real, _Real, _Real]:
    """Test each channel in each band, channels, bands, and all data together.

    Parameters
    ----------
    square, count, white : ndarray of float, shape (n_i, n_j, n_b)
        Sum of squares, number of real values and p-value of serial correlation, by channel and
        band.
    size : _Size
        Reference for the sums of squares.

    Returns
    -------
    places : ndarray of float, shape (2, n_i, n_j, n_b)
        Adjusted p-values; index 0 of the first axis is the size, index 1 the serial correlation,
        here and below.
    least : ndarray of float, shape (2,)
        Smallest adjusted p-value of all families.
    telling : ndarray of float, shape (2, n_i, n_j, n_b)
        Unadjusted p-values of the channels and bands that contribute to the smallest one; inf
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
    alone = np.stack([size.p(square, count), white])
    places = np.minimum(share * adjusted(alone), 1.0)
    least, telling = places.min(axis=(1, 2)), alone.copy()
    for axis in axes:
        parts = (np.asarray(values.sum(axis=axis)) for values in (square, count))
        sums = size.p(*parts)
        pair = np.minimum(share * adjusted(np.stack([sums, _combined(white, axis)])), 1.0)
        for kind, p in enumerate(pair):
            if p.min() < least[kind]:
                least[kind] = p.min()
                made_of = np.zeros(p.shape, dtype=np.bool_)
                made_of.flat[np.argmin(p)] = True
                if axis == 1:
                    made_of = made_of[:, None]
                telling[kind] = np.where(made_of, alone[kind], np.inf)
    return places.reshape(2, *shape), least, telling.reshape(2, *shape)


def _noisy(
    found: Adequacy, square: _Real, count: _Real, white: _Real, n_unknowns: int
) -> tuple[Noisy, ...]:
    """Return the noisy sensors; none if the residual deviates from noise in other ways too.

    The test is repeated with the residual of each sensor divided by its own rms value.
    """
    sums, numbers = square.sum(axis=(1, 2)), count.sum(axis=(1, 2))
    there = sums > 0.0
    if there.sum() < 2:
        return ()
    own = np.sqrt(sums / np.maximum(numbers, 1.0))
    levelled = square / np.where(there, own, 1.0)[:, None, None] ** 2
    size = _Size(float(levelled.sum()), float(count.sum()), n_unknowns, False, None)
    _, least, _ = _tested(levelled, count, white, size)
    if least.min() <= found.level:
        return ()
    return _louder_than_most(np.where(there, own, np.nan), found.responses)


def _louder_than_most(std: _Real, responses: Sequence[str]) -> tuple[Noisy, ...]:
    """Return the sensors with more noise than most, the noisiest first; NaN marks unknown noise."""
    times = std / _usual(std[np.isfinite(std)])
    loud = np.flatnonzero(times >= _NOISY)
    order = loud[np.argsort(-times[loud], kind="stable")]
    return tuple(Noisy(responses[i], float(times[i])) for i in order)


def _usual(std: _Real) -> float:
    """Return the lower median of the standard deviations of sensors."""
    return float(np.quantile(std, 0.5, method="lower"))


def _combined(p: _Real, axis: int | None) -> _Real:
    """Combine independent p-values by Stouffer's method; values of 1 were not tested."""
    from scipy.special import ndtr, ndtri

    tested = p < 1.0
    score = np.where(tested, -ndtri(np.where(tested, p, 0.5)), 0.0)
    number = tested.sum(axis=axis)
    whole = score.sum(axis=axis) / np.sqrt(np.maximum(number, 1))
    return np.asarray(np.where(number > 0, ndtr(-whole), 1.0))


def _length(values: _Complex) -> _Real:
    """Return the correlation length of each column in lines, 1 + 2 sum of autocorrelations."""
    n = len(values)
    power = np.nansum(np.abs(values) ** 2, axis=0)
    out, going = np.ones(values.shape[1]), power > 0
    for lag in range(1, n // 2):
        product = values[lag:] * values[:-lag].conj()
        pairs = np.maximum(np.isfinite(product).sum(axis=0), 1)
        rho = np.nansum(product.real, axis=0) / np.where(going, power, 1.0)
        going &= rho * n / pairs >= 2.0 / np.sqrt(2.0 * pairs)
        if not going.any():
            break
        out[going] += 2.0 * rho[going]
    return np.where(power > 0, out, np.nan)


def _worst(
    found: Adequacy, telling: _Real, whitened: _Complex, freq: _Real, cut: list[slice]
) -> tuple[Misfit, ...]:
    """Return the significant misfits, or the one of the smallest p-value if none is significant."""
    at = np.argwhere(np.minimum(found.chi_square_p, found.whiteness_p) <= found.level)
    if not len(at):
        at = np.argwhere(telling == telling.min())[:1]
    strength = found.misfit * np.sqrt(
        np.where(found.whiteness_p <= found.level, found.correlation_length, 1.0)
    )
    order = np.argsort(-strength[tuple(at.T)], kind="stable")[:_LISTED]
    return tuple(_place(found, whitened, freq, cut, *map(int, index)) for index in at[order])


def _lone(whitened: _Complex, freq: _Real) -> tuple[float, ...]:
    """Return the frequencies of isolated lines with most of the excess misfit; empty if many.

    A mode that the model lacks also affects the neighbouring lines.
    """
    seen = np.isfinite(whitened)
    number = np.maximum(seen.sum(axis=(1, 2)), 1)
    power = np.where(seen, np.abs(whitened) ** 2, 0.0).sum(axis=(1, 2)) / number
    beside = np.pad(power, 1)
    usual = np.median(power)
    out = power > _ALONE * np.maximum(np.maximum(beside[:-2], beside[2:]), usual)
    excess = np.maximum(power - usual, 0.0)
    if out.sum() > _FEW_LINES * len(freq) or excess[out].sum() <= 0.5 * excess.sum():
        return ()
    return tuple(freq[out].tolist())


def _place(
    found: Adequacy, whitened: _Complex, freq: _Real, cut: list[slice], i: int, j: int, k: int
) -> Misfit:
    band = cut[k]
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


def _words(found: Adequacy) -> str:
    if found.outcome == "noise":
        known = "" if found.absolute else ", whose size was taken from it"
        if found.noisy:
            known += f", sensor by sensor: {_louder(found.noisy)}"
        return f"The residual cannot be distinguished from noise{known}."
    first = found.worst[0]
    where = f"channel {first.response} (force {first.reference}) near {first.near:.4g} Hz"
    unit = "the noise" if found.absolute else "the typical misfit"
    size = f"misfit {first.misfit:.2g} times {unit}"
    number = int(np.sum(np.minimum(found.chi_square_p, found.whiteness_p) <= found.level))
    if number == 0:
        how = "larger than the noise"
        if found.outcome == "structure":
            how = "serially correlated"
        return (
            f"The residual is {how} over many channels or bands, though no place stands out by"
            f" itself; most in {where}.{_standing_alone(found.lone)}"
        )
    if found.noisy:
        return f"The residual is noise, but not of one size: {_louder(found.noisy)}."
    start = "More noise than expected, or outliers, in"
    if found.outcome == "structure":
        start = "The model cannot explain"
    over = "not serially correlated"
    if first.kind == "structure":
        over = f"serially correlated over {first.correlation_length:.0f} lines"
    more = ""
    if number == 2:
        more = "; and 1 more place"
    elif number > 2:
        more = f"; and {number - 1} more places"
    return f"{start} {where}: {size}, {over}{more}.{_standing_alone(found.lone)}"


def _standing_alone(lone: Sequence[float]) -> str:
    """Return the sentence on isolated lines; empty without any."""
    if not lone:
        return ""
    shown = ", ".join(f"{f:.5g}" for f in lone[:_NAMED])
    if len(lone) > _NAMED:
        shown += f" and {len(lone) - _NAMED} more"
    which = "the line at" if len(lone) == 1 else "the lines at"
    return f" Most of it is in {which} {shown} Hz alone, and not beside."


def _louder(noisy: Sequence[Noisy]) -> str:
    """Return the text on the noisy sensors and their noise relative to most sensors."""
    named = [f"{one.times:.2g} times that of most sensors at {one.response}" for one in noisy]
    text = ", ".join(named[:_NAMED])
    if len(named) > _NAMED:
        text += f", and larger at {len(named) - _NAMED} more"
    return text
