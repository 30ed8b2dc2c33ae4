"""FRFs from time records: H1, H2 and Hv, with coherence and variance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import get_window

from updyn.dofs import Dof
from updyn.errors import DataError, DofError, OptionError, suggest
from updyn.frf import FRF
from updyn.modal.continuation import continued
from updyn.signals.records import Records, records_of
from updyn.signals.units import unit
from updyn.signals.windows import ImpactWindow

if TYPE_CHECKING:
    import xarray

__all__ = ["ESTIMATORS", "estimate_frf"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]
#: A force below this share of its largest line says nothing of the response.
_NOTHING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Averaged spectra of a force and of responses.

    Attributes
    ----------
    ff : ndarray of float, shape (n_f,)
        Of the force, E F conj(F).
    xx : ndarray of float, shape (n_f, n_i)
        Of the responses.
    xf : ndarray of complex, shape (n_f, n_i)
        E X conj(F).
    averages : float
        Independent segments that they come from.
    """

    ff: _Real
    xx: _Real
    xf: _Complex
    averages: float

    @property
    def coherence(self) -> _Real:
        """Ordinary coherence, |S_xf|^2 / (S_xx S_ff); zero where nothing was measured."""
        power = self.xx * self.ff[:, None]
        found = np.abs(self.xf) ** 2 / np.where(power > 0.0, power, np.inf)
        return np.minimum(found, 1.0)  # of rounding


def _h1(spectra: Spectra) -> _Complex:
    """Noise on the response: least squares of the response on the force."""
    return np.asarray(spectra.xf / spectra.ff[:, None])


def _h2(spectra: Spectra) -> _Complex:
    """Noise on the force: least squares of the force on the response (Mitchell, 1982)."""
    across = spectra.xf.conj()
    return np.asarray(spectra.xx / np.where(across != 0.0, across, np.inf))


def _hv(spectra: Spectra) -> _Complex:
    """Noise on both, in proportion to their levels: the geometric mean of H1 and H2.

    That is total least squares of force and response, each over its level: Rocklin, Crowley and
    Vold (1985).
    """
    size = np.sqrt(spectra.xx / spectra.ff[:, None])
    return np.asarray(size * np.exp(1j * np.angle(spectra.xf)))


ESTIMATORS = {"H1": _h1, "H2": _h2, "Hv": _hv}


def estimate_frf(
    records: xarray.DataArray | Records,
    excitation: str | Mapping[str, str],
    *,
    responses: Iterable[str] | Mapping[str, str] | None = None,
    estimator: str = "H1",
    window: str | ImpactWindow | None = None,
    segment: float | None = None,
    overlap: float = 0.5,
    reject: Mapping[int, str] | None = None,
    band: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> FRF:
    """Estimate FRFs from records of one force and its responses.

    Parameters
    ----------
    records : xarray.DataArray
        Of `read_records`: dimensions ``record``, ``channel``, ``time`` (s).
    excitation : str or mapping of str to str
        The channel of the force; with the DOF at which it acts, ``{"Force": "3:-Z"}``, where the
        name of the channel is no DOF label itself.
    responses : iterable of str, or mapping of str to str, optional
        Channels of the responses, with their DOFs where their names are no DOF labels; by default
        all but the force.
    estimator : {"H1", "H2", "Hv"}
        H1 for noise on the responses, H2 for noise on the force, Hv for both.
    window : str or ImpactWindow, optional
        Name of a window of `scipy.signal.get_window`, or those for hits. By default none on whole
        records, "hann" on segments of them.
    segment : float, optional
        Length in s of the segments that each record is cut into, for a lasting force; the mean is
        taken off each (Welch, 1967). By default each record is one segment, a hit, and the median,
        which the hit does not move, is taken off.
    overlap : float
        Share of a segment that the next one repeats, from 0 to below 1.
    reject : mapping of int to str, optional
        Records to leave out, counted from 1, and why: ``{1: "clipped"}``. The reasons are kept in
        `FRF.source`.
    band : (float, float), optional
        Lowest and highest line in Hz; by default all but 0 Hz, of which the offset was taken off.
    units : mapping of str to str, optional
        Units of channels where the records do not say; a contradiction is an error.

    Returns
    -------
    FRF
        In SI units, with coherence, number of averages and, of two averages at least, variance:
        |H|^2 (1 - gamma^2) / (gamma^2 (n - 1)), of H1 the variance of least squares (Bendat and
        Piersol, Random Data, 4th ed. 2010, eq. 9.90, for n segments less the one unknown).

    Raises
    ------
    DataError
        If a channel is missing or has no unit that is known, responses are of several quantities,
        no record is left, or the force is zero at a line.
    OptionError
        If an option has a value that it cannot have.
    """
    if estimator not in ESTIMATORS:
        raise OptionError(f"estimator {estimator!r}; {suggest(estimator, ESTIMATORS)}")
    if not 0.0 <= overlap < 1.0:
        raise OptionError(f"overlap {overlap}; expected 0 to below 1")
    given = records_of(records)
    force, at_force = _one(_labelled([excitation] if isinstance(excitation, str) else excitation))
    row = given.index(force)
    others = [name for name in given.channels if name != force]
    labels = _labelled(others if responses is None else responses)
    kept = _without(given, reject or {})
    quantity, scales = _scales(given, force, labels, units or {})
    rows = [row, *(given.index(name) for name in labels)]
    values = kept[:, rows] * scales[:, None]
    pieces, decay, shape = _pieces(values, given.step, window, segment, overlap)
    spectra = _averaged(pieces, shape, overlap if segment is not None else 0.0)
    freq = np.fft.rfftfreq(pieces.shape[2], given.step)
    chosen = freq > 0.0
    if band is not None:
        chosen &= (freq >= band[0]) & (freq <= band[1])
    if not chosen.any():
        raise DataError(f"band {band}: no line in it; lines go to {freq[-1]:g} Hz")
    spectra = Spectra(spectra.ff[chosen], spectra.xx[chosen], spectra.xf[chosen], spectra.averages)
    silent = spectra.ff <= _NOTHING**2 * spectra.ff.max()
    if silent.any():
        raise DataError(
            f"channel {force!r}: no force at {freq[chosen][silent][0]:g} Hz; narrow the band"
        )
    H, coherence = ESTIMATORS[estimator](spectra), spectra.coherence
    averages = max(1, int(spectra.averages))
    frf = FRF(
        freq[chosen],
        H[:, :, None],
        list(labels.values()),
        [at_force],
        quantity,
        coherence=coherence[:, :, None],
        variance=_variance(H, coherence, spectra.averages)[:, :, None] if averages > 1 else None,
        averages=averages,
        source=_source(given, reject or {}),
    )
    return continued(frf, decay) if decay else frf


def _labelled(channels: Iterable[str] | Mapping[str, str]) -> dict[str, str]:
    """Return the DOF labels of channels."""
    named = dict(channels) if isinstance(channels, Mapping) else {name: name for name in channels}
    for name, label in named.items():
        try:
            Dof.parse(label)
        except DofError as error:
            hint = ""
            if name == label:
                hint = f"; name its DOF: {{{name!r}: '1:Z'}}"
            raise DataError(f"channel {name!r}: {error}{hint}") from error
    if not named:
        raise DataError("no channel of a response")
    return named


def _one(named: Mapping[str, str]) -> tuple[str, str]:
    """Return the only channel of a force and its label."""
    if len(named) != 1:
        raise DataError(f"{len(named)} channels of a force; expected one")
    return next(iter(named.items()))


def _without(records: Records, reject: Mapping[int, str]) -> _Real:
    """Return the records that are not rejected."""
    n = len(records.values)
    for number in reject:
        if number not in range(1, n + 1):
            raise DataError(f"reject: no record {number!r}; there are {n}, counted from 1")
    kept = [i for i in range(n) if i + 1 not in reject]
    if not kept:
        raise DataError(f"reject: all {n} records")
    return records.values[kept]


def _scales(
    records: Records, force: str, labels: Mapping[str, str], units: Mapping[str, str]
) -> tuple[str, _Real]:
    """Return the quantity of the FRF, and what makes SI units of the force and the responses."""
    for name in units:
        records.index(name)

    def of(channel: str) -> Any:
        said, told = records.units[records.index(channel)], units.get(channel)
        if told is not None and said and unit(said, channel) != unit(told, channel):
            raise DataError(f"channel {channel!r}: unit {told!r} given, the records say {said!r}")
        return unit(told or said, channel)

    loading = of(force)
    if loading.kind != "force":
        raise DataError(f"channel {force!r} of the force has a unit of motion")
    found = {name: of(name) for name in labels}
    kinds = {one.kind: name for name, one in found.items()}
    if "force" in kinds:
        raise DataError(f"channel {kinds['force']!r} of a response has a unit of force")
    if len(kinds) > 1:
        said = " and ".join(f"{name!r} of {kind}" for kind, name in kinds.items())
        raise DataError(f"responses of several quantities ({said}); estimate them one by one")
    return next(iter(kinds)), np.array([loading.factor, *(one.factor for one in found.values())])


def _pieces(
    values: _Real,
    step: float,
    window: str | ImpactWindow | None,
    segment: float | None,
    overlap: float,
) -> tuple[_Real, float, _Real]:
    """Return windowed segments, shape (n, channels, samples), their decay and the window."""
    n_samples = values.shape[2]
    if segment is None:
        values = values - np.median(values, axis=2, keepdims=True)
        if isinstance(window, ImpactWindow):
            decay = window.decay(n_samples * step)
            values = values.copy()
            for record in values:
                record[0] *= window.on_force(record[0], step)
            falling = np.exp(-decay * step * np.arange(n_samples))
            return values * falling, decay if window.remove_damping else 0.0, falling
        shape = np.ones(n_samples) if window is None else get_window(window, n_samples)
        return values * shape, 0.0, shape
    if isinstance(window, ImpactWindow):
        raise OptionError("windows for hits take whole records; leave segment out")
    size = round(segment / step)
    if not 2 <= size <= n_samples:
        raise OptionError(
            f"segment {segment} s; expected {2 * step:g} to {n_samples * step:g} s, a record"
        )
    shape = get_window(window or "hann", size)
    every = max(1, size - int(overlap * size))
    cut = np.lib.stride_tricks.sliding_window_view(values, size, axis=2)[:, :, ::every]
    cut = np.moveaxis(cut, 2, 1).reshape(-1, values.shape[1], size)
    return (cut - cut.mean(axis=2, keepdims=True)) * shape, 0.0, shape


def _averaged(pieces: _Real, shape: _Real, overlap: float) -> Spectra:
    """Return the spectra, the force being the first channel."""
    F = np.fft.rfft(pieces, axis=2).transpose(0, 2, 1)
    force, motion = F[:, :, 0], F[:, :, 1:]
    return Spectra(
        np.mean(np.abs(force) ** 2, axis=0),
        np.mean(np.abs(motion) ** 2, axis=0),
        np.mean(motion * force.conj()[:, :, None], axis=0),
        _independent(len(pieces), shape, overlap),
    )


def _independent(n: int, shape: _Real, overlap: float) -> float:
    """Return the number of independent segments: Welch (1967), below equation 12."""
    size = len(shape)
    every = max(1, size - int(overlap * size))
    out = 1.0
    for lag in range(1, n):
        common = size - lag * every
        if common <= 0:
            break
        share = (shape[:common] @ shape[-common:]) / (shape @ shape)
        out += 2.0 * (1.0 - lag / n) * float(share) ** 2
    return n / out


def _variance(H: _Complex, coherence: _Real, averages: float) -> _Real:
    """Return E|dH|^2."""
    least = np.maximum(coherence, np.finfo(float).eps)
    return np.asarray(np.abs(H) ** 2 * (1.0 - coherence) / (least * max(averages - 1.0, 1.0)))


def _source(records: Records, reject: Mapping[int, str]) -> str:
    left = ", ".join(f"record {number} left out: {why}" for number, why in sorted(reject.items()))
    return "; ".join(filter(None, (records.source, left)))
