"""FRFs from time records: H1, H2, Hv and LRM, with coherence and variance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads scipy.signal on use; its import is slow

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dofs import Dof
from updyn.errors import DataError, DofError, OptionError, key_path, suggest
from updyn.frf import FRF, check_band
from updyn.modal.continuation import remove_decay
from updyn.signals.estimators import ESTIMATORS
from updyn.signals.quality.pulse import time_of_energy
from updyn.signals.records import Records, as_records
from updyn.signals.settings import FRF_ESTIMATE
from updyn.signals.spectra import Spectra
from updyn.signals.windows import ImpactWindow
from updyn.units import Unit, merge_units, parse_unit

if TYPE_CHECKING:
    import xarray

__all__ = ["FRFEstimate", "estimate_frf", "frf_estimate"]


@dataclass(frozen=True, slots=True, eq=False)
class FRFEstimate:
    """FRFs from records, with their coherences and spectra.

    Attributes
    ----------
    frf : FRF
        The estimate over all records used.
    ordinary : ndarray of float, shape (n_f, n_responses, n_references), or None
        Ordinary coherence of each response with each force. All three are None for LRM and
        H1-LRM, which average no spectra.
    multiple : ndarray of float, shape (n_f, n_responses), or None
        Coherence of each response with all forces together: 1 less the share of the response that
        no force explains.
    partial : ndarray of float, shape (n_f, n_responses, n_references), or None
        Coherence of each response with each force, after removal of the other forces from both.
    records : tuple of int
        Numbers of the records used, from 1.
    spectra : ndarray of float, shape (n, 1 + n_references)
        All frequencies of the records above 0 Hz, and the one-sided power spectral density of each
        force in N^2/Hz ((N m)^2/Hz). For a continuous force; with one, it is `FRF.spectrum`.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> found = updyn.frf_estimate(records, "1:X", band=(1.0, 40.0))
    >>> found.records
    (1, 2, 3)
    """

    frf: FRF
    ordinary: RealArray | None
    multiple: RealArray | None
    partial: RealArray | None
    records: tuple[int, ...]
    spectra: RealArray
    _spectra: Spectra
    _setting: _Setting

    def of_record(self, number: int) -> FRF:
        """Return the FRFs of one record.

        Parameters
        ----------
        number : int
            One of `records`.

        Returns
        -------
        FRF
            On the same lines. If the record is a single segment, without coherence, and with
            variance only for LRM and H1-LRM. `updyn.average` gives the mean of several, with the
            variance from their scatter.

        Raises
        ------
        DataError
            If the record was not used, or has fewer segments than forces.
        """
        if number not in self.records:
            kept = ", ".join(map(str, self.records))
            raise DataError(f"record {number!r} was not used; expected one of {kept}")
        at, each = self.records.index(number), self._setting.segments
        is_local = ESTIMATORS[self._setting.estimator].is_local
        if each < len(self.frf.references) and not is_local:
            raise DataError(
                f"record {number}: {each} segment for {len(self.frf.references)} forces; FRFs of"
                " a single record require as many segments as forces"
            )
        part = self._spectra.part(slice(at * each, (at + 1) * each), self._setting.independent)
        source = f"record {number} of {self.frf.source}" if self.frf.source else f"record {number}"
        return self._setting.frf(part, source)


@dataclass(frozen=True, slots=True, eq=False)
class _Setting:
    """Parameters of the conversion of spectra to FRFs; `freq` in Hz.

    `forces` and `responses` are labels by channel. `decay` (1/s) is that of an exponential window
    whose damping is removed. Of the `segments` of each record, `independent` are independent.
    """

    freq: RealArray
    forces: dict[str, str]
    responses: dict[str, str]
    quantity: str
    estimator: str
    decay: float
    segments: int
    independent: float

    def frf(self, spectra: Spectra, source: str) -> FRF:
        found = ESTIMATORS[self.estimator].estimate(spectra, self.freq, tuple(self.forces))
        frf = FRF(
            self.freq,
            found.values,
            list(self.responses.values()),
            list(self.forces.values()),
            self.quantity,
            coherence=found.coherence,
            variance=found.variance,
            averages=max(1, int(spectra.averages)),
            source=source,
            decay=self.decay,
        )
        return remove_decay(frf)


def estimate_frf(
    records: xarray.DataArray | Records,
    excitation: str | Iterable[str] | Mapping[str, str],
    *,
    responses: Iterable[str] | Mapping[str, str] | None = None,
    estimator: str = "H1",
    window: str | ImpactWindow | None = None,
    segment: float | None = None,
    overlap: float | None = None,
    reject: Mapping[int, str] | None = None,
    band: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> FRF:
    """Estimate FRFs from records of forces and their responses.

    Parameters
    ----------
    records : xarray.DataArray
        Of `read_records`: dimensions ``record``, ``channel``, ``time`` (s).
    excitation : str, iterable of str, or mapping of str to str
        Channel of the force, or those of several simultaneous forces; with the DOFs of the forces,
        ``{"Force": "3:-Z"}``, if the names of channels are not DOF labels.
    responses : iterable of str, or mapping of str to str, optional
        Channels of the responses, with their DOFs if their names are not DOF labels; by default all
        but the forces.
    estimator : {"H1", "H2", "Hv", "LRM", "H1-LRM"}
        H1 for noise on the responses, H2 for noise on the forces, Hv for both. LRM, the local
        rational method, is for noise on the responses and a continuous force that varies from line
        to line: it estimates leakage together with the FRFs, also from a single record, and its
        errors are correlated over neighbouring lines. H1-LRM is H1 of records from which LRM has
        removed the transients: its errors are larger and independent, as an update assumes.
    window : str or ImpactWindow, optional
        Name of a window of `scipy.signal.get_window`, or the windows for hits. By default none for
        whole records, "hann" for segments. Not for LRM and H1-LRM.
    segment : float, optional
        Length in s of the segments of each record, for a continuous force; the mean of each is
        removed (Welch, 1967). By default each record is one segment, a hit, and its median, which
        the hit does not affect, is removed. LRM is most accurate for whole records.
    overlap : float, optional
        Share of a segment that the next one repeats, from 0 to below 1; by default a half. Not for
        LRM and H1-LRM.
    reject : mapping of int to str, optional
        Records to omit, counted from 1, with the reason: ``{1: "clipped"}``. `FRF.source` states
        the reasons.
    band : (float, float), optional
        Lowest and highest line in Hz; by default all except 0 Hz, as the offset is removed.
    units : mapping of str to str, optional
        Units of channels for which the records have none; a contradiction is an error.

    Returns
    -------
    FRF
        In SI units, with the number of averages. LRM and H1-LRM give the variance from the residual
        of local models, and no coherence. The others give, for more averages than forces, coherence
        and variance: |H|^2 (1 - gamma^2) / (gamma^2 (n - n_r)) for n averages and n_r forces; for
        H1 that of least squares (Bendat and Piersol, Random Data, 4th ed. 2010, eq. 9.90, for n
        segments less the unknowns). The coherence is the ordinary one, for several forces the
        partial one.

    Raises
    ------
    DataError
        If a channel is missing or has no known unit, responses are of several quantities, no record
        remains, a force is zero at a line, or forces are linearly dependent; for LRM also if the
        force is a pulse, or there are too few lines.
    OptionError
        If an option is invalid, or does not apply to the estimator.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> frf = updyn.estimate_frf(records, "1:X", band=(1.0, 40.0))
    >>> frf.quantity, round(float(abs(frf.values[0, 0, 0])), 6)  # 1 / mass
    ('accelerance', 0.5)
    """
    return frf_estimate(
        records,
        excitation,
        responses=responses,
        estimator=estimator,
        window=window,
        segment=segment,
        overlap=overlap,
        reject=reject,
        band=band,
        units=units,
    ).frf


def frf_estimate(
    records: xarray.DataArray | Records,
    excitation: str | Iterable[str] | Mapping[str, str],
    *,
    responses: Iterable[str] | Mapping[str, str] | None = None,
    estimator: str = "H1",
    window: str | ImpactWindow | None = None,
    segment: float | None = None,
    overlap: float | None = None,
    reject: Mapping[int, str] | None = None,
    band: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> FRFEstimate:
    """Return FRFs from records, with all coherences and the FRFs of each record.

    Parameters
    ----------
    records, excitation, responses, estimator, window, segment, overlap, reject, band, units
        As for `estimate_frf`.

    Returns
    -------
    FRFEstimate
        The FRFs, their ordinary, multiple and partial coherence, and with `of_record` those of each
        record.

    Raises
    ------
    DataError, OptionError
        As `estimate_frf`.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> updyn.frf_estimate(records, "1:X", band=(1.0, 40.0)).frf.averages
    3
    """
    if estimator not in ESTIMATORS:
        raise OptionError(
            f"estimator {estimator!r}; {suggest(estimator, ESTIMATORS)}", key=("estimator",)
        )
    is_local = ESTIMATORS[estimator].is_local
    if is_local:
        _check_unwindowed(estimator, window, overlap)
        window, overlap = "boxcar", 0.0
    overlap = 0.5 if overlap is None else overlap
    if not 0.0 <= overlap < 1.0:
        raise OptionError(f"overlap {overlap}; expected 0 to below 1", key=("overlap",))
    given = as_records(records)
    named = [excitation] if isinstance(excitation, str) else excitation
    forces, force_rows = _channels(given, named, "excitation")
    others = [name for name in given.channels if name not in forces]
    labels, response_rows = _channels(
        given, others if responses is None else responses, "responses"
    )
    rows = force_rows + response_rows
    kept = _find_kept_records(given, reject or {})
    quantity, scales = _scales(given, forces, labels, units or {})
    values = given.values[np.array(kept) - 1][:, rows] * scales[:, None]
    if is_local:
        _check_no_pulses(values[:, : len(forces)], given.step, tuple(forces), estimator)
    pieces, decay, shape = _window_segments(
        values, len(forces), given.step, window, segment, overlap
    )
    shared = overlap if segment is not None else 0.0
    freq = np.asarray(np.fft.rfftfreq(pieces.shape[2], given.step), dtype=np.float64)
    chosen = _band_mask(freq, band)
    F = np.fft.rfft(pieces, axis=2).transpose(0, 2, 1)
    n = len(forces)
    density = _find_density(F[:, :, :n], pieces.shape[2], given.step, shape)
    densities = np.column_stack([freq, density])[1:]
    F = F[:, chosen]
    spectra = Spectra.of(F[:, :, :n], F[:, :, n:], _count_independent(len(pieces), shape, shared))
    each = len(pieces) // len(kept)
    setting = _Setting(
        freq[chosen],
        forces,
        labels,
        quantity,
        estimator,
        decay,
        each,
        _count_independent(each, shape, shared),
    )
    frf = setting.frf(spectra, _source(given, reject or {}))
    if is_local:
        return FRFEstimate(frf, None, None, None, kept, densities, spectra, setting)
    found = (spectra.ordinary, spectra.multiple, spectra.partial)
    return FRFEstimate(frf, *found, kept, densities, spectra, setting)


def _find_density(F: ComplexArray, n: int, step: float, window: RealArray) -> RealArray:
    """Return the one-sided densities of transforms of n samples, (n_f, n_r) (Welch, 1967)."""
    density = 2.0 * step * np.mean(np.abs(F) ** 2, axis=0) / np.sum(window**2)
    if n % 2 == 0:
        density[-1] *= 0.5  # half the sampling rate occurs once
    return np.asarray(density)


def _check_unwindowed(
    estimator: str, window: str | ImpactWindow | None, overlap: float | None
) -> None:
    """Raise OptionError for a window or an overlap with an estimator that permits none."""
    for key, value in (("window", window), ("overlap", overlap)):
        if value is not None:
            raise OptionError(
                f"{key} {value!r}: estimator {estimator} uses records without windows, and"
                f" segments without overlap; omit {key}",
                key=(key,),
            )


def _check_no_pulses(
    forces: RealArray, step: float, names: tuple[str, ...], estimator: str
) -> None:
    """Raise DataError for forces that are pulses, with spectra as smooth as those of transients."""
    duration = forces.shape[2] * step
    for name, force in zip(names, np.swapaxes(forces, 0, 1), strict=True):
        lasts = float(np.median(time_of_energy(force))) * step
        if lasts < FRF_ESTIMATE.pulse_share * duration:
            raise DataError(
                f"channel {name!r}: the force is a pulse of {lasts:.2g} s in records of"
                f" {duration:.3g} s; {estimator} cannot separate its response from a transient."
                " Use estimator H1, with ImpactWindow if the response is cut off",
                key=("estimator",),
            )


def _channels(
    records: Records, given: Iterable[str] | Mapping[str, str], key: str
) -> tuple[dict[str, str], list[int]]:
    """Return the DOF labels of channels, and their indices in the records."""
    named = dict(given) if isinstance(given, Mapping) else {name: name for name in given}
    if not named:
        raise DataError(f"{key}: no channel", key=(key,))
    rows = []
    for name, label in named.items():
        with key_path(key, name):
            rows.append(records.index(name))
            _check_label(name, label)
    return named, rows


def _check_label(name: str, label: str) -> None:
    """Raise DataError for a channel whose label is not that of a DOF."""
    try:
        Dof.parse(label)
    except DofError as error:
        hint = ""
        if name == label:
            hint = f"; name its DOF: {{{name!r}: '1:Z'}}"
        raise DataError(f"channel {name!r}: {error}{hint}") from error


def _find_kept_records(records: Records, reject: Mapping[int, str]) -> tuple[int, ...]:
    n = len(records.values)
    for number in reject:
        if number not in range(1, n + 1):
            raise DataError(
                f"reject: no record {number!r}; there are {n}, counted from 1", key=("reject",)
            )
    kept = tuple(number for number in range(1, n + 1) if number not in reject)
    if not kept:
        raise DataError(f"reject: all {n} records", key=("reject",))
    return kept


def _scales(
    records: Records,
    forces: Mapping[str, str],
    labels: Mapping[str, str],
    units: Mapping[str, str],
) -> tuple[str, RealArray]:
    """Return the quantity of the FRF, and the factors from channel units to SI units."""

    def of(channel: str) -> Unit:
        stored_unit = records.units[records.index(channel)]
        with key_path("units", channel):
            given_unit = units.get(channel)
            return parse_unit(
                stored_unit
                if given_unit is None
                else merge_units(given_unit, stored_unit, channel),
                channel,
            )

    for name in units:
        with key_path("units", name):
            records.index(name)
    loads = {name: of(name) for name in forces}
    for name, load in loads.items():
        if load.kind != "force":
            raise DataError(
                f"channel {name!r} of the force has a unit of motion", key=("excitation", name)
            )
    found = {name: of(name) for name in labels}
    kinds = {one.kind: name for name, one in found.items()}
    if "force" in kinds:
        raise DataError(
            f"channel {kinds['force']!r} of a response has a unit of force",
            key=("responses", kinds["force"]),
        )
    if len(kinds) > 1:
        found_kinds = " and ".join(f"{name!r} of {kind}" for kind, name in kinds.items())
        raise DataError(
            f"responses of several quantities ({found_kinds}); estimate them one by one",
            key=("responses",),
        )
    for name, label in forces.items():
        _check_angular(name, label, loads[name], "excitation")
    for name, label in labels.items():
        _check_angular(name, label, found[name], "responses")
    factors = [one.factor for one in (*loads.values(), *found.values())]
    return next(iter(kinds)), np.array(factors)


def _check_angular(name: str, label: str, unit: Unit, key: str) -> None:
    """Raise DataError for a unit of a translation at a rotation, or vice versa."""
    if unit.angular != Dof.parse(label).direction.startswith("R"):
        what = "an angle or a moment" if unit.angular else "a translation or a force"
        raise DataError(f"channel {name!r} at {label}: its unit is that of {what}", key=(key, name))


def _band_mask(freq: RealArray, band: tuple[float, float] | None) -> BoolArray:
    """Return a mask of the lines in the band, without 0 Hz."""
    chosen = freq > 0.0
    if band is not None:
        with key_path("band"):
            low, high = check_band(band)
        chosen &= (freq >= low) & (freq <= high)
    if not chosen.any():
        raise DataError(f"band {band}: no line in it; lines go to {freq[-1]:g} Hz", key=("band",))
    return chosen


def _window_segments(
    values: RealArray,
    n_forces: int,
    step: float,
    window: str | ImpactWindow | None,
    segment: float | None,
    overlap: float,
) -> tuple[RealArray, float, RealArray]:
    """Return windowed segments, shape (n, channels, samples), their decay and the window."""
    n_samples = values.shape[2]
    if segment is None:
        values = values - np.median(values, axis=2, keepdims=True)
        if isinstance(window, ImpactWindow):
            return _window_hits(values, n_forces, step, window)
        shape = np.ones(n_samples) if window is None else _window(window, n_samples)
        return values * shape, 0.0, shape
    if isinstance(window, ImpactWindow):
        raise OptionError("windows for hits need whole records; omit segment", key=("window",))
    size = round(segment / step)
    if not 2 <= size <= n_samples:
        raise OptionError(
            f"segment {segment} s; expected {2 * step:g} to {n_samples * step:g} s, a record",
            key=("segment",),
        )
    shape = _window(window or "hann", size)
    every = max(1, size - int(overlap * size))
    cut = np.lib.stride_tricks.sliding_window_view(values, size, axis=2)[:, :, ::every]
    cut = np.moveaxis(cut, 2, 1).reshape(-1, values.shape[1], size)
    return (cut - cut.mean(axis=2, keepdims=True)) * shape, 0.0, shape


def _window_hits(
    values: RealArray, n_forces: int, step: float, window: ImpactWindow
) -> tuple[RealArray, float, RealArray]:
    """Return records of hits with their windows applied, as `_window_segments`."""
    n_samples = values.shape[2]
    decay = window.decay(n_samples * step)
    values = values.copy()
    for record in values:
        for force in record[:n_forces]:
            force *= window.on_force(force, step)
    falling = np.exp(-decay * step * np.arange(n_samples))
    return values * falling, decay if window.remove_damping else 0.0, falling


def _window(name: str, size: int) -> RealArray:
    try:
        return np.asarray(scipy.signal.get_window(name, size), dtype=np.float64)
    except ValueError as error:
        raise OptionError(
            f"window {name!r}: {error}; expected one of scipy.signal.get_window without"
            " parameters, such as 'hann' or 'flattop'",
            key=("window",),
        ) from error


def _count_independent(n: int, shape: RealArray, overlap: float) -> float:
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


def _source(records: Records, reject: Mapping[int, str]) -> str:
    omitted = ", ".join(f"record {number} omitted: {why}" for number, why in sorted(reject.items()))
    return "; ".join(filter(None, (records.source, omitted)))
