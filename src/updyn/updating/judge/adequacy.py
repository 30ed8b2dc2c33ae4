"""Is what a fit leaves noise, or is it structure that the model cannot follow? Tests by channel and band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.updating.judge.whiteness import adjusted, bands, clipped, serial_p

__all__ = ["OUTCOMES", "Adequacy", "Misfit", "Suspect", "assess", "blamed"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

OUTCOMES = ("noise", "structure", "excess", "exact", "untested")
#: Share of fits to pure noise of which something is said all the same.
LEVEL = 0.02
#: A misfit, as a share of the rms of the data, below which no test could see anything.
_EXACT = 1e-7
#: Real numbers over which the size of noise that was told from averages has errors of its own.
_SHARED = 32.0
#: Places that are listed, and groups that are named.
_LISTED, _NAMED = 12, 3


@dataclass(frozen=True, slots=True)
class Misfit:
    """A place that the model does not explain.

    Attributes
    ----------
    response, reference : str
        The channel.
    low, high : float
        The band, in Hz.
    near : float
        Where in it the misfit is largest, in Hz.
    misfit : float
        Root mean square misfit over the noise of its values.
    alike : float
        Over how many lines it is alike: 1 for noise.
    chi_square_p, whiteness_p : float
        How likely noise is to be as large, and as much alike from line to line; adjusted for the
        number of tests.
    kind : {"structure", "excess"}
        Alike from line to line, or only too large.
    """

    response: str
    reference: str
    low: float
    high: float
    near: float
    misfit: float
    alike: float
    chi_square_p: float
    whiteness_p: float
    kind: str


@dataclass(frozen=True, slots=True)
class Suspect:
    """An error of the model that would explain what is left.

    Attributes
    ----------
    group, quantity : str
        Whose, and of what: ``"stiffness"``, ``"mass"``, ``"viscous"`` or ``"loss_factor"`` of a
        group; ``"calibration"`` or ``"force_calibration"`` of a sensor.
    explains : float
        Share of what is left beyond the noise that this one change would take away, by a step of
        first order, all unknowns of the fit adapting to it. Errors that the channels cannot tell
        apart have nearly the same share.
    change : float
        That step, which would cure it: of the logarithm of a factor, or of a loss factor. Its sign
        can be trusted more than its size.
    energy : float
        Share of the energy of the error in the constitutive relations that lies in this matrix, at
        the worst places.
    """

    group: str
    quantity: str
    explains: float
    change: float
    energy: float

    @property
    def name(self) -> str:
        """``group.quantity``."""
        return f"{self.group}.{self.quantity}"


@dataclass(frozen=True, slots=True, eq=False)
class Adequacy:
    """Whether the residual of a fit is noise.

    Attributes
    ----------
    outcome : str
        One of `OUTCOMES`: ``"noise"``, nothing found; ``"structure"``, alike from line to line, or
        explained by an error of the model; ``"excess"``, only larger than the noise; ``"exact"``,
        nothing left; ``"untested"``, too few values.
    verdict : str
        The same in a sentence or two.
    absolute : bool
        Whether the size of the noise is known from elsewhere. Where it was estimated from the
        residual itself, the size of a misfit is told against the rest of the data; likeness from
        line to line needs no size.
    chi_square : float
        Squared misfit over that of the noise, per degree of freedom; near 1 by construction where
        not `absolute`.
    p_value : float
        Of the most telling test, adjusted for the number of tests: below `level` something was
        found.
    level : float
        Share of fits to pure noise of which something is said all the same, at most.
    responses, references : tuple of str
        Labels.
    bands : ndarray of float, shape (n_b, 2)
        First and last line of each, in Hz.
    misfit, alike : ndarray of float, shape (n_i, n_j, n_b)
        By channel and band: rms misfit over noise, and over how many lines it is alike. NaN where
        there are no data.
    chi_square_p, whiteness_p : ndarray of float, shape (n_i, n_j, n_b)
        Adjusted p-values; 1 where nothing was tested.
    worst : tuple of Misfit
        Places that stand out, the worst first; empty where nothing was found.
    explained_by : tuple of Suspect
        What would explain it, the best first; empty where nothing was found, or nothing explains
        it.
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
    alike: _Real
    chi_square_p: _Real
    whiteness_p: _Real
    worst: tuple[Misfit, ...] = ()
    explained_by: tuple[Suspect, ...] = ()

    @property
    def adequate(self) -> bool:
        """Whether nothing speaks against the model."""
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
) -> Adequacy:
    """Test a residual against noise.

    Parameters
    ----------
    whitened : ndarray of complex, shape (n_f, n_i, n_j)
        Measured minus computed, over the standard deviation of its real and of its imaginary part;
        NaN for what was not fitted.
    H : ndarray of complex, shape (n_f, n_i, n_j)
        The model's, which tells where its resonances are.
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    responses, references : sequence of str
        Labels.
    n_unknowns : int
        Fitted to these data.
    absolute : bool
        Whether the size of the noise is known from elsewhere, and not from this residual.
    averages : int, optional
        How many averages the size of the noise was told from, line by line; None: it is known as
        such.
    level : float
        Share of fits to pure noise of which something may be said all the same.
    relative : float
        The rms misfit over the rms of the data, to tell rounding from a residual.

    Returns
    -------
    Adequacy

    Notes
    -----
    Size: the sum of squares of a channel in a band against chi-square with two degrees of freedom a
    value, or against F where the size of the noise is an estimate too: from n averages, with n - 1
    as many degrees of freedom, but no more than sixteen lines have (smoothing makes the errors of
    the size alike over more); where it was taken from this residual, by the ratio to all other
    values. The unknowns make the residual smaller than the noise, which is counted for all values
    together, not place by place: the tests err on the side of silence. Likeness:
    `updyn.updating.judge.whiteness.serial_p`. Channels over all bands, bands over all channels and all
    data together are tested as well, with the p-values of likeness joined by Stouffer's sum of
    normal scores (1949). Each of these families is adjusted by Benjamini & Hochberg (1995) at its
    share of `level`.
    """
    there = np.isfinite(whitened)
    n_values = int(there.sum())
    names = tuple(map(str, responses)), tuple(map(str, references))
    cut = bands(_mean_level(H))
    edges = np.array([[freq[b.start], freq[b.stop - 1]] for b in cut])
    shape = (*whitened.shape[1:], len(cut))
    square, count = np.zeros(shape), np.zeros(shape)
    alike, white = np.full(shape, np.nan), np.ones(shape)
    for k, band in enumerate(cut):
        part = whitened[band]
        square[..., k] = np.nansum(np.abs(part) ** 2, axis=0)
        count[..., k] = 2.0 * there[band].sum(axis=0)
        flat = clipped(part.reshape(len(part), -1))
        white[..., k] = serial_p(flat).reshape(shape[:2])
        alike[..., k] = _length(flat).reshape(shape[:2])
    freedom = 2 * n_values - n_unknowns
    chi_square = float(square.sum() / freedom) if freedom > 0 else np.nan
    with np.errstate(invalid="ignore"):
        size = np.sqrt(square / count)
    one = np.ones(shape)
    found = Adequacy(
        "untested", "", absolute, chi_square, 1.0, level, *names, edges, size, alike, one, one
    )
    if relative <= _EXACT:
        return replace(
            found,
            outcome="exact",
            verdict="The model answers the data exactly; nothing is left to test.",
        )
    if freedom <= 0 or n_values < 2:
        text = "There are too few measured numbers to tell whether what is left is noise."
        return replace(found, verdict=text)
    against = _Size(float(square.sum()), float(count.sum()), n_unknowns, absolute, averages)
    large, white, families = _tested(square, count, white, against)
    found = replace(found, chi_square_p=large, whiteness_p=white)
    worst = _worst(found, whitened, freq, cut)
    by_likeness = min([float(white.min()), *(p for p, of_likeness in families if of_likeness)])
    p_value = min([by_likeness, float(large.min()), *(p for p, _ in families)])
    outcome = "structure" if by_likeness <= level else "excess" if p_value <= level else "noise"
    found = replace(
        found, outcome=outcome, p_value=p_value, worst=worst if p_value <= level else ()
    )
    return replace(found, verdict=_words(found))


def blamed(found: Adequacy, suspects: Sequence[Suspect]) -> Adequacy:
    """Return the assessment with what would explain it, said in its verdict.

    What an error of the model explains is structure, though the lines may lie too far apart for it
    to look alike.

    Parameters
    ----------
    found : Adequacy
        From `assess`.
    suspects : sequence of Suspect
        The best first.
    """
    if not suspects or found.adequate:
        return found
    found = replace(found, outcome="structure", explained_by=tuple(suspects))
    telling = [s for s in suspects if s.explains >= 0.8 * suspects[0].explains][:_NAMED]
    names = " or ".join(_suspected(s) for s in telling)
    text = f"An error in {names} would explain {100.0 * suspects[0].explains:.0f} % of it."
    return replace(found, verdict=f"{_words(found)} {text}")


_QUANTITY = {
    "stiffness": "stiffness",
    "mass": "mass",
    "viscous": "viscous damping",
    "loss_factor": "loss factor",
}
_SENSOR = {"calibration": "sensor", "force_calibration": "force sensor"}


def _suspected(s: Suspect) -> str:
    if s.quantity in _SENSOR:
        return (
            f"the {_SENSOR[s.quantity]} {s.group} (reads too"
            f" {'much' if s.change > 0 else 'little'})"
        )
    return f"the {_QUANTITY[s.quantity]} of {s.group} (too {'low' if s.change > 0 else 'high'})"


def _mean_level(H: _Complex) -> _Real:
    size = np.abs(H)
    return np.asarray(np.log(np.maximum(size, np.finfo(float).tiny)).mean(axis=(1, 2)))


@dataclass(frozen=True, slots=True)
class _Size:
    """What a sum of squares is compared with: the sum over all values, their number (two each), unknowns, noise."""

    square: float
    count: float
    n_unknowns: int
    absolute: bool
    averages: int | None

    def p(self, square: _Real, count: _Real) -> _Real:
        """Return how likely noise makes sums of squares over `count` real numbers as large."""
        from scipy.special import chdtrc, fdtrc

        if self.absolute:
            freedom = np.maximum(np.where(count >= self.count, count - self.n_unknowns, count), 1.0)
            if self.averages is None:
                p = chdtrc(freedom, square)
            else:
                p = fdtrc(
                    freedom,
                    np.clip(count, 1.0, _SHARED) * max(self.averages - 1, 1),
                    square / freedom,
                )
        else:
            rest, other = self.square - square, self.count - count - self.n_unknowns
            usable = (other >= 1.0) & (rest > 0.0) & (count > 0.0)
            other = np.where(usable, other, 1.0)
            ratio = (square / np.maximum(count, 1.0)) / np.where(usable, rest / other, 1.0)
            p = np.where(usable, fdtrc(np.maximum(count, 1.0), other, ratio), 1.0)
        return np.asarray(np.clip(np.where(count > 0, p, 1.0), 1e-300, 1.0))


def _tested(
    square: _Real, count: _Real, white: _Real, size: _Size
) -> tuple[_Real, _Real, list[tuple[float, bool]]]:
    """Return adjusted p-values of size and likeness by channel and band, and the least of each further family."""
    shape = square.shape
    square, count, white = (a.reshape(-1, shape[2]) for a in (square, count, white))
    cells, n_bands = white.shape
    axes: list[int | None] = [
        axis for axis, several in ((1, cells > 1), (0, n_bands > 1)) if several
    ]
    axes = axes[: 2 if min(cells, n_bands) > 1 else 0] + ([None] if cells * n_bands > 1 else [])
    share = 1.0 + len(axes)
    large, alike = np.minimum(share * adjusted(np.stack([size.p(square, count), white])), 1.0)
    families = []
    for axis in axes:
        sums = size.p(np.atleast_1d(square.sum(axis=axis)), np.atleast_1d(count.sum(axis=axis)))
        pair = np.minimum(
            share * adjusted(np.stack([sums, np.atleast_1d(_joined(white, axis))])), 1.0
        )
        families += [(float(pair[0].min()), False), (float(pair[1].min()), True)]
    return large.reshape(shape), alike.reshape(shape), families


def _joined(p: _Real, axis: int | None) -> _Real:
    """Join independent p-values by the sum of their normal scores; those of 1 were not tested."""
    from scipy.special import ndtr, ndtri

    tested = p < 1.0
    score = np.where(tested, -ndtri(np.where(tested, p, 0.5)), 0.0)
    number = tested.sum(axis=axis)
    out = ndtr(-score.sum(axis=axis) / np.sqrt(np.maximum(number, 1)))
    return np.asarray(np.where(number > 0, out, 1.0))


def _length(values: _Complex) -> _Real:
    """Return over how many lines each column is alike: 1 + 2 times the sum of its leading autocorrelations."""
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
    found: Adequacy, whitened: _Complex, freq: _Real, cut: list[slice]
) -> tuple[Misfit, ...]:
    """Return the places that stand out; where none does by itself, the most telling."""
    least = np.minimum(found.chi_square_p, found.whiteness_p)
    at = np.argwhere(least <= found.level)
    if not len(at):
        at = np.argwhere(least == least.min())[:1]
    strength = found.misfit * np.sqrt(np.where(found.whiteness_p <= found.level, found.alike, 1.0))
    order = np.argsort(-strength[tuple(at.T)], kind="stable")[:_LISTED]
    return tuple(_place(found, whitened, freq, cut, *map(int, index)) for index in at[order])


def _place(
    found: Adequacy, whitened: _Complex, freq: _Real, cut: list[slice], i: int, j: int, k: int
) -> Misfit:
    band = cut[k]
    square = np.nan_to_num(np.abs(whitened[band, i, j]) ** 2)
    smooth = np.convolve(square, np.ones(min(3, len(square))), mode="same")
    return Misfit(
        found.responses[i],
        found.references[j],
        float(found.bands[k, 0]),
        float(found.bands[k, 1]),
        float(freq[band][int(np.argmax(smooth))]),
        float(found.misfit[i, j, k]),
        float(found.alike[i, j, k]),
        float(found.chi_square_p[i, j, k]),
        float(found.whiteness_p[i, j, k]),
        "structure" if found.whiteness_p[i, j, k] <= found.level else "excess",
    )


def _words(found: Adequacy) -> str:
    if found.outcome == "noise":
        known = "" if found.absolute else ", whose size was taken from it"
        return f"What is left cannot be told from noise{known}."
    first = found.worst[0]
    where = f"channel {first.response} (force {first.reference}) near {first.near:.4g} Hz"
    size = (
        f"misfit {first.misfit:.2g} times {'the noise' if found.absolute else 'the typical misfit'}"
    )
    number = int(np.sum(np.minimum(found.chi_square_p, found.whiteness_p) <= found.level))
    if number == 0:
        how = "alike from line to line" if found.outcome == "structure" else "larger than the noise"
        return f"What is left is {how} over many channels, though none stands out; most in {where}."
    over = (
        f"alike over {first.alike:.0f} lines"
        if first.kind == "structure"
        else "not alike from line to line"
    )
    start = (
        "The model cannot explain"
        if found.outcome == "structure"
        else "More noise than expected, or outliers, in"
    )
    more = f"; and {number - 1} more place{'s' if number > 2 else ''}" if number > 1 else ""
    return f"{start} {where}: {size}, {over}{more}."
