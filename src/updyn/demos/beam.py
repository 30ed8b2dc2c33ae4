"""A free-free steel beam, struck at six points and measured by seven accelerometers (Ladisk).

Two jobs: the whole beam, then the beam in segments, started from the first result. The source
(``data/README.md``) gives neither drawing nor positions: length, section and stations were inferred
from these FRFs; the pads and the mass of the accelerometers are assumed.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.correlation import Correlation, correlate
from updyn.dynamics.modes import modes
from updyn.text_table import text_table

if TYPE_CHECKING:
    from updyn.frf import FRF
    from updyn.updating.result import UpdateResult

__all__ = [
    "BAND",
    "HAMMER",
    "HELD_OUT",
    "SENSORS",
    "STATIONS",
    "comparison",
    "describe_residual",
    "epilogue",
    "find_torsion",
    "fit_one_mode",
    "headline",
    "next_job",
    "reciprocity",
    "segments_job",
    "sensor_levels",
    "write_inputs",
]

LENGTH = 0.565  # m
E = 200e9  # Pa
RHO = 7850.0  # kg/m3
LOSS_FACTOR = 0.002
#: Another handbook value for the same steels, for comparison.
OTHER_E = 210e9

#: Position over length by node number: 101 to 107 accelerometers, 201 to 206 hammer points; the
#: third hammer point is at 103.
_PLACES = {
    101: 0.086,
    102: 0.250,
    103: 0.418,
    104: 0.582,
    105: 0.750,
    106: 0.918,
    107: 0.334,
    201: 0.088,
    202: 0.246,
    204: 0.580,
    205: 0.745,
    206: 0.915,
}
#: Position in m by node number.
STATIONS = {node: round(LENGTH * place, 5) for node, place in _PLACES.items()}
SENSORS = ("101:Z", "102:Z", "103:Z", "104:Z", "105:Z", "106:Z", "107:Z")
HAMMER = ("201:Z", "202:Z", "103:Z", "204:Z", "205:Z", "206:Z")
HELD_OUT = ("103:Z", "107:Z")
#: Sensors with a hammer point at the same station: a few millimetres apart, the third at the same
#: node.
_PAIRED_SENSORS = SENSORS[:6]
_PAIRS = tuple(zip(_PAIRED_SENSORS, HAMMER, strict=True))

BAND = (100.0, 4500.0)  # Hz
_BANDS = ((BAND[0], 300.0), (300.0, 1000.0), (1000.0, 2200.0), (2200.0, BAND[1]))
_EVERY = 20  # neighbouring lines have the same information
#: Positions of the foam blocks in m: about a twentieth of the length from each end, from the
#: photograph of the source.
PADS = (0.028, 0.537)
_PADS = {"stiffness": 2e4, "loss_factor": 0.1}  # N/m each
_ACCELEROMETER = 0.004  # kg each

_SOURCE = "Measurement: Ladisk, sample data of sdypy-EMA 0.27.3, MIT licence (inputs/README.md)."
_JOB = """\
# The measurement is Ladisk's (see README.md beside this file). Dimensions and positions are
# inferred from it, not measured; E and the density are handbook values. Everything is scored over
# all lines of the band.
title = "{title}"

[model]
kind = "beam"
title = "Free-free steel beam on two soft pads"
length = {length}
E = {E:.10g}
rho = {rho:.10g}
width = 0.050
height = 0.0105
nu = 0.3
loss_factor = {loss_factor:.8g}
n_elements = 60

[model.stations]
{stations}
{parts}
[test]
file = "ladisk_beam.uff"
band = [{low}, {high}]

{unknowns}
[method]
name = "maximum-likelihood"
validation = {held}  # seen by no fit, but seen while the form of the model was chosen
{options}lines = [
{lines}
]
"""
_PART = """
[[model.{kind}]]
{keys}
"""
_UNKNOWN = """\
[[parameter]]
groups = "{groups}"
quantity = "{quantity}"
bounds = [{lower}, {upper}]
"""


# -- jobs
def write_inputs(folder: Path) -> Path:
    """Write measurement, licence and job file; return the path of the job file."""
    data = resources.files("updyn.demos").joinpath("data")
    for name in ("ladisk_beam.uff", "README.md"):
        with resources.as_file(data.joinpath(name)) as source:
            shutil.copyfile(source, folder / name)
    unknowns = [
        _unknown("beam", "stiffness", 0.7, 1.4),
        _unknown("beam", "mass", 0.7, 1.4, 0.05),  # the density is that of steel
        _unknown("beam", "loss_factor", 1e-4, 0.05, 0.005),
        *_unknown_supports(),
    ]
    text = _job(folder, title="Steel beam, whole", start={}, unknowns=unknowns)
    return _write_job(folder / "job.toml", text)


def _unknown_supports() -> list[str]:
    """Return the unknowns of pads and accelerometers, which need priors with these data."""
    return [
        _unknown("pads", "stiffness", 0.1, 10.0, 0.5),
        _unknown("pads", "loss_factor", 0.0, 2.0, 0.2),
        _unknown("accelerometers", "mass", 0.05, 5.0, 0.5),
    ]


def next_job(results: Sequence[UpdateResult], folder: Path) -> Path | None:
    """Write the job of the segments after the run of the whole beam, started from its results."""
    if len(results) > 1:
        return None
    return segments_job(results[0].values, folder)


def segments_job(values: Mapping[str, float], folder: Path, number: int = 4) -> Path:
    """Write the job with segment properties as unknowns, started from `values` of the first run."""
    edges = np.linspace(0.0, LENGTH, number + 1).round(6).tolist()
    segments = []
    for i, (start, end) in enumerate(pairwise(edges), 1):
        segments.append({"name": f"segment {i}", "start": start, "end": end})
    text = _job(
        folder,
        title=f"Steel beam, {number} segments",
        start=values,
        unknowns=[
            # One rolled bar: segments differ by per cents. Its steel has one loss factor; without
            # the narrow prior, the effect of the supports on mode 1 would appear as segments
            # without damping next to segments with double damping.
            _unknown("segment *", "stiffness", 0.7, 1.4, 0.03),
            _unknown("segment *", "mass", 0.7, 1.4, 0.03),
            _unknown("segment *", "loss_factor", 1e-4, 0.05, 3e-4),
            *_unknown_supports(),
        ],
        segments=segments,
        options="starts = 0  # it starts from the fit of the whole beam\n",
    )
    return _write_job(folder / "segments.toml", text)


def _job(
    folder: Path,
    title: str,
    start: Mapping[str, float],
    unknowns: Sequence[str],
    segments: Sequence[Mapping[str, object]] = (),
    options: str = "",
) -> str:
    """Return the text of a job; `start` holds start values, if any."""
    pads = {
        "stiffness": _PADS["stiffness"] * start.get("pads.stiffness", 1.0),
        "loss_factor": start.get("pads.loss_factor", _PADS["loss_factor"]),
    }
    mass = _ACCELEROMETER * start.get("accelerometers.mass", 1.0)
    parts = [_part("segments", segment) for segment in segments]
    for x in PADS:
        parts.append(_part("supports", {"name": "pads", "x": x, **pads}))
    for sensor in SENSORS:
        x = STATIONS[int(sensor[:3])]
        parts.append(_part("masses", {"name": "accelerometers", "x": x, "mass": mass}))
    stations = [f"{node} = {x}" for node, x in sorted(STATIONS.items())]
    return _JOB.format(
        title=title,
        length=LENGTH,
        E=E * start.get("beam.stiffness", 1.0),
        rho=RHO * start.get("beam.mass", 1.0),
        loss_factor=start.get("beam.loss_factor", LOSS_FACTOR),
        stations="\n".join(stations),
        parts="".join(parts),
        low=BAND[0],
        high=BAND[1],
        unknowns="\n".join(unknowns),
        held=str(list(HELD_OUT)).replace("'", '"'),
        options=options,
        lines=_lines(folder),
    )


def _lines(folder: Path) -> str:
    """Return the fitted frequency lines in Hz, ten per row."""
    from updyn.io import read_frf

    freq = read_frf(folder / "ladisk_beam.uff").select(band=BAND).freq[::_EVERY]
    texts = [f"{f:.6f}" for f in freq]
    rows = []
    for first in range(0, len(texts), 10):
        rows.append("    " + ", ".join(texts[first : first + 10]) + ",")
    return "\n".join(rows)


def _part(kind: str, keys: Mapping[str, object]) -> str:
    rows = []
    for key, value in keys.items():
        text = f'"{value}"' if isinstance(value, str) else f"{value:.8g}"
        rows.append(f"{key} = {text}")
    return _PART.format(kind=kind, keys="\n".join(rows))


def _unknown(
    groups: str, quantity: str, lower: float, upper: float, prior_std: float | None = None
) -> str:
    text = _UNKNOWN.format(groups=groups, quantity=quantity, lower=lower, upper=upper)
    if prior_std is not None:
        text += f"prior_std = {prior_std}\n"
    return text


def _write_job(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


# -- results
def headline(results: Sequence[UpdateResult]) -> str:
    """Return source and level differences of the start and of every run."""
    first = results[0].correlation
    rows = [_levels(f"start, E = {E / 1e9:g} GPa", first, "before")]
    rows += [_levels(result.title, result.correlation, "after") for result in results]
    table = text_table(("level difference, median (dB)", "fitted", "held out"), rows)
    return f"{_SOURCE}\n{table}"


def _levels(name: str, figures: Mapping[str, Any], when: str) -> list[str]:
    both = figures[when], figures["validation"][when]
    return [name, *(f"{one['db_error_median']:.3f}" for one in both)]


def epilogue(results: Sequence[UpdateResult], folder: Path) -> str:
    """Compare start, whole beam and segments; explain the remaining residual."""
    return f"{_SOURCE}\n\n{comparison(results)}\n\n{describe_residual(results[-1])}"


def comparison(results: Sequence[UpdateResult]) -> str:
    """Return a table of the start and of every run, for fitted and held-out sensors."""
    first = results[0]
    held = ", ".join(first.validation_responses)
    before = first.correlation
    lines = [
        f"Over all {len(first.frf.freq)} lines from {BAND[0]:g} to {BAND[1]:g} Hz, medians"
        f" ({len(first.lines)} lines were fitted; held out: {held}):",
        f"{'':<24} {'fitted sensors':>20}   {'held-out sensors':>20}",
        f"{'':<24} {'|dB|':>10} {'FRAC':>9}   {'|dB|':>10} {'FRAC':>9}",
        _row(f"start, E = {E / 1e9:g} GPa", before["before"], before["validation"]["before"]),
    ]
    for result in results:
        after = result.correlation
        lines.append(_row(result.title, after["after"], after["validation"]["after"]))
    return "\n".join(lines) + "\n\n" + _start(first)


def _row(name: str, fitted: Mapping[str, float], held_out: Mapping[str, float]) -> str:
    cells = []
    for figures in (fitted, held_out):
        cells.append(f"{figures['db_error_median']:>10.3f} {figures['frac_median']:>9.3f}")
    return f"{name:<24} {'   '.join(cells)}"


def _start(result: UpdateResult) -> str:
    """Return text on the start, which would agree much better with another handbook value of E."""
    other = result.start.scaled({"beam": {"stiffness": OTHER_E / E}})
    figures = correlate(other, result.frf.select(responses=result.fitted_responses)).figures()
    return (
        f"The start has the dimensions inferred from these FRFs and a handbook E of {E / 1e9:g}"
        " GPa. Its FRAC is near 0 because resonances as sharp as these miss each other when"
        f" frequencies are off by per cents: with {OTHER_E / 1e9:g} GPa, a handbook value too, the"
        f" start would read {figures['db_error_median']:.2f} dB and {figures['frac_median']:.2f}."
        " Judge the result by its final error, not by the improvement. (A fit weights every"
        " value by its noise, at resonances and antiresonances; medians may rise or fall.)"
    )


def describe_residual(result: UpdateResult) -> str:
    """Return text on the residual of the last model and its causes."""
    computed = correlate(result.model, result.frf)
    measured = computed.measured
    levels = sensor_levels(measured, computed.computed)
    level_text = ", ".join(f"{sensor} {level:+.2f}" for sensor, level in levels.items())
    twisted, mac = find_torsion(computed, LENGTH)
    swapped, unexplained = reciprocity(measured, computed.computed)
    frequency = next(f for f in modes(result.model, 4).frequency if f > BAND[0])
    _, measured_loss, _ = fit_one_mode(measured, frequency)
    _, model_loss, _ = fit_one_mode(computed.computed, frequency)
    items = [
        f"By band: {_errors_by_band(computed)}.",
        f"A mode at {twisted:.0f} Hz is missing from the model, and the shapes agree least around"
        f" it (CSAC {computed.csac.min():.2f}). At the sensors it moves much as the first torsion"
        f" of a free bar would (MAC {mac:.2f}), struck and measured off the axis; a beam that bends"
        " in one plane has no torsion.",
        "Swapping hammer and sensor between stations changes the measurement by"
        f" {swapped:.1%} (median). The two are up to {_largest_offset():.1f} mm apart there;"
        f" {unexplained:.1%} is more than the model can put down to that: torsion, calibration,"
        " repeatability.",
        "The level of each sensor differs from that of the model (calibration, or position), which"
        f" is not an unknown: {level_text} dB.",
        f"Mode 1 has a measured loss factor of {measured_loss:.2%}; that of the model is"
        f" {model_loss:.2%}. The foam under the ends does not dissipate like two springs with one"
        " loss factor. Loss factors that differ between segments approximate this; they are not"
        " properties of the steel.",
        "Length, section and positions were inferred, and the form of the model chosen, with sight"
        " of all sensors, the held-out ones included, and so was the number of segments"
        " (benchmarks/beam.py has others). Segments that differ by a few per cent may as well be"
        " positions that are off by millimetres. Suspension modes, below 60 Hz, are not modelled.",
    ]
    head = f"What remains of '{result.title}', and why:"
    return "\n- ".join([head, *items])


def _errors_by_band(computed: Correlation) -> str:
    texts = []
    for low, high in _BANDS:
        inside = (computed.freq >= low) & (computed.freq < high)
        median = np.median(computed.db_error[inside])
        texts.append(f"{median:.2f} dB in {low:g}-{high:g} Hz")
    return ", ".join(texts)


def _largest_offset() -> float:
    """Return the largest distance between sensor and hammer point of a station in mm."""
    offsets = []
    for sensor, hammer in _PAIRS:
        offsets.append(abs(STATIONS[int(sensor[:3])] - STATIONS[int(hammer[:3])]))
    return 1e3 * max(offsets)


def reciprocity(measured: FRF, computed: FRF) -> tuple[float, float]:
    """Return the median deviation of H_ij / H_ji from 1, and from the value of the model."""

    def ratio(frf: FRF) -> ComplexArray:
        H = frf.select(responses=_PAIRED_SENSORS, references=HAMMER).values
        i, j = np.triu_indices(len(HAMMER), 1)
        return np.asarray(H[:, i, j] / H[:, j, i])

    found = ratio(measured)
    expected = ratio(computed)
    return float(np.median(np.abs(found - 1.0))), float(np.median(np.abs(found / expected - 1.0)))


def sensor_levels(measured: FRF, computed: FRF) -> dict[str, float]:
    """Return the level of each sensor relative to the model in dB, as the median over lines."""
    ratio = np.abs(measured.values) / np.abs(computed.values)
    level = np.median(20.0 * np.log10(ratio), axis=0).mean(axis=1)
    return dict(zip(measured.responses.labels, level.tolist(), strict=True))


def find_torsion(computed: Correlation, length: float) -> tuple[float, float]:
    """Return natural frequency in Hz and MAC of the residual's mode near the line of least CSAC."""
    # The MAC compares its shape with cos(pi x / length), the first torsion mode of a free bar.
    measured = computed.measured
    rest = replace(measured, values=measured.values - computed.computed.values)
    frequency, _, residues = fit_one_mode(rest, float(computed.freq[computed.csac.argmin()]))
    shape = np.linalg.svd(residues)[0][:, 0]
    twist = np.cos(np.pi * np.array([STATIONS[d.node] for d in measured.responses]) / length)
    return frequency, float(np.abs(shape @ twist) ** 2 / (twist @ twist))


def fit_one_mode(frf: FRF, near: float) -> tuple[float, float, ComplexArray]:
    """Return frequency in Hz, loss factor and residues of the mode within 5 % of a frequency."""
    # The least-squares model of receptance is a pole and a constant; the residues have an
    # arbitrary factor.
    from scipy.optimize import least_squares

    part = frf.select(band=(0.95 * near, 1.05 * near))
    square = (part.freq / near) ** 2
    Y = part.values.reshape(len(square), -1)

    def amplitudes(pole: RealArray) -> tuple[NumberArray, NumberArray]:
        ratio, loss = pole
        shapes = square[:, None] * np.column_stack(
            [1.0 / (ratio * (1.0 + 1j * loss) - square), np.ones(len(square))]
        )
        found = np.linalg.lstsq(shapes, Y, rcond=None)[0]
        return found, Y - shapes @ found

    def misfit(pole: RealArray) -> RealArray:
        r = amplitudes(pole)[1].ravel()
        return np.concatenate([r.real, r.imag])

    pole = least_squares(misfit, [1.0, 0.01], x_scale=[0.01, 0.01]).x
    shapes, _ = amplitudes(pole)
    residues = shapes[0].reshape(part.values.shape[1:])
    return near * float(np.sqrt(pole[0])), float(pole[1]), residues
