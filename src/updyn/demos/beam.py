"""A free-free steel beam, struck at six points and measured by seven accelerometers (Ladisk, ``data/README.md``).

Two jobs: the whole beam with its pads and accelerometers, then, from there, the beam in segments.
Two accelerometers are held out of both.

What the model takes for granted was not measured. The source gives neither drawing nor positions:
length, section and stations were inferred from these FRFs (natural frequencies, mode shapes,
level), the pads and the mass of the accelerometers are assumed. E = 200 GPa and the density are
handbook values of steel.

Every figure of the text at the end of the demo is computed from the runs.
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
from numpy.typing import NDArray

from updyn.correlation import Correlation, correlate
from updyn.dynamics.modes import modes

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
    "epilogue",
    "levels_of",
    "next_job",
    "one_mode",
    "reciprocity",
    "remains",
    "segments_job",
    "torsion",
    "write_inputs",
]

LENGTH = 0.565  # m
E, RHO = 200e9, 7850.0
LOSS_FACTOR = 0.002
#: Another handbook value, for comparison: many tables give it for the same steels.
OTHER_E = 210e9

_AT = {101: 0.086, 102: 0.250, 103: 0.418, 104: 0.582, 105: 0.750, 106: 0.918, 107: 0.334}
_AT |= {201: 0.088, 202: 0.246, 204: 0.580, 205: 0.745, 206: 0.915}
#: Position in m by node number: 101 to 107 accelerometers, 201 to 206 hammer points; the third of
#: these is at 103.
STATIONS = {node: round(LENGTH * x, 5) for node, x in _AT.items()}
SENSORS = tuple(f"{node}:Z" for node in range(101, 108))
HAMMER = ("201:Z", "202:Z", "103:Z", "204:Z", "205:Z", "206:Z")
HELD_OUT = ("103:Z", "107:Z")

BAND = (100.0, 4500.0)  # Hz
_EVERY = 20  # lines: neighbours say the same
#: Where the foam blocks stand, in m: about a twentieth of the length from each end, by the
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


# -- the whole beam ----------------------------------------------------------------------------------------
def write_inputs(folder: Path) -> Path:
    """Write measurement, licence and job file; return the path of the job file."""
    data = resources.files("updyn.demos").joinpath("data")
    for name in ("ladisk_beam.uff", "README.md"):
        with resources.as_file(data.joinpath(name)) as source:
            shutil.copyfile(source, folder / name)
    text = _job(
        folder,
        title="Steel beam, whole",
        start={},
        unknowns=[
            _unknown("beam", "stiffness", 0.7, 1.4),
            _unknown("beam", "mass", 0.7, 1.4),
            _unknown("beam", "loss_factor", 1e-4, 0.05),
            *_around(),
        ],
    )
    return _written(folder / "job.toml", text)


def _around() -> list[str]:
    """Return the unknowns of what stands around the beam."""
    return [
        _unknown("pads", "stiffness", 0.1, 10.0),
        _unknown("pads", "loss_factor", 0.0, 2.0),
        _unknown("accelerometers", "mass", 0.05, 5.0),
    ]


# -- its segments ------------------------------------------------------------------------------------------
def next_job(results: Sequence[UpdateResult], folder: Path) -> Path | None:
    """After the whole beam, write the job of its segments, started from what the first run found."""
    return segments_job(results[0].values, folder) if len(results) == 1 else None


def segments_job(values: Mapping[str, float], folder: Path, number: int = 4) -> Path:
    """Write the job that frees stiffness, mass and loss factor of each segment.

    Parameters
    ----------
    values : mapping of str to float
        Estimates of the first run; they become the start.
    folder : Path
        Where its inputs are.
    number : int
        Equal lengths to divide the beam into.

    Returns
    -------
    Path
        The job file.
    """
    edges = np.linspace(0.0, LENGTH, number + 1).round(6)
    segments = [
        {"name": f"segment {i + 1}", "start": float(a), "end": float(b)}
        for i, (a, b) in enumerate(pairwise(edges))
    ]
    text = _job(
        folder,
        title=f"Steel beam, {number} segments",
        start=values,
        unknowns=[
            # One bar was rolled: segments differ by per cents. Its steel has one loss factor;
            # without the narrow prior, what the supports do to mode 1 appears as segments without
            # any damping beside segments with double.
            _unknown("segment *", "stiffness", 0.7, 1.4, 0.03),
            _unknown("segment *", "mass", 0.7, 1.4, 0.03),
            _unknown("segment *", "loss_factor", 1e-4, 0.05, 3e-4),
            *_around(),
        ],
        segments=segments,
        options="starts = 0  # it starts from the fit of the whole beam\n",
    )
    return _written(folder / "segments.toml", text)


# -- job files ---------------------------------------------------------------------------------------------
def _job(
    folder: Path,
    title: str,
    start: Mapping[str, float],
    unknowns: Sequence[str],
    segments: Sequence[Mapping[str, Any]] = (),
    options: str = "",
) -> str:
    """Return the text of a job; `start` holds estimates to start from, none of them where it is empty."""
    from updyn.io import read_frf

    factor = {
        k: start.get(k, 1.0)
        for k in ("beam.stiffness", "beam.mass", "pads.stiffness", "accelerometers.mass")
    }
    pads = {
        "stiffness": _PADS["stiffness"] * factor["pads.stiffness"],
        "loss_factor": start.get("pads.loss_factor", _PADS["loss_factor"]),
    }
    parts = [_part("segments", s) for s in segments]
    parts += [_part("supports", {"name": "pads", "x": x, **pads}) for x in PADS]
    mass = _ACCELEROMETER * factor["accelerometers.mass"]
    parts += [
        _part("masses", {"name": "accelerometers", "x": STATIONS[n], "mass": mass})
        for n in sorted(STATIONS)
        if n < 200
    ]
    lines = read_frf(folder / "ladisk_beam.uff").select(band=BAND).freq[::_EVERY]
    texts = [f"{f:.6f}" for f in lines]
    return _JOB.format(
        title=title,
        length=LENGTH,
        E=E * factor["beam.stiffness"],
        rho=RHO * factor["beam.mass"],
        loss_factor=start.get("beam.loss_factor", LOSS_FACTOR),
        stations="\n".join(f"{n} = {STATIONS[n]}" for n in sorted(STATIONS)),
        parts="".join(parts),
        low=BAND[0],
        high=BAND[1],
        unknowns="\n".join(unknowns),
        held=str(list(HELD_OUT)).replace("'", '"'),
        options=options,
        lines="\n".join(
            "    " + ", ".join(texts[i : i + 10]) + "," for i in range(0, len(texts), 10)
        ),
    )


def _part(kind: str, keys: Mapping[str, Any]) -> str:
    rows = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v:.8g}" for k, v in keys.items()]
    return _PART.format(kind=kind, keys="\n".join(rows))


def _unknown(
    groups: str, quantity: str, lower: float, upper: float, prior_std: float | None = None
) -> str:
    text = _UNKNOWN.format(groups=groups, quantity=quantity, lower=lower, upper=upper)
    return text if prior_std is None else text + f"prior_std = {prior_std}\n"


def _written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


# -- what it comes to --------------------------------------------------------------------------------------
def epilogue(results: Sequence[UpdateResult], folder: Path) -> str:
    """Compare start, whole beam and segments; say what remains and why."""
    return f"{_SOURCE}\n\n{comparison(results)}\n\n{remains(results[-1])}"


#: Sensor and hammer point of the same station: some millimetres apart, the third at one node.
_PAIRS = tuple(zip(SENSORS[:6], HAMMER, strict=True))
_BANDS = ((BAND[0], 300.0), (300.0, 1000.0), (1000.0, 2200.0), (2200.0, BAND[1]))


def comparison(results: Sequence[UpdateResult]) -> str:
    """Return a table of the start and of every run: fitted and held-out sensors, over all lines of the band."""
    first = results[0]
    rows = [
        (
            f"start, E = {E / 1e9:g} GPa",
            first.correlation["before"],
            first.correlation["validation"]["before"],
        )
    ]
    rows += [
        (r.title, r.correlation["after"], r.correlation["validation"]["after"]) for r in results
    ]
    held = ", ".join(first.validation_responses)
    lines = [
        (
            f"Over all {len(first.frf.freq)} lines from {BAND[0]:g} to {BAND[1]:g} Hz, medians "
            f"({len(first.lines)} lines were fitted; held out: {held}):"
        ),
        f"{'':<24} {'fitted sensors':>20}   {'held-out sensors':>20}",
        f"{'':<24} {'|dB|':>10} {'FRAC':>9}   {'|dB|':>10} {'FRAC':>9}",
    ]
    for name, fitted, other in rows:
        cells = [f"{x['db_error_median']:>10.3f} {x['frac_median']:>9.3f}" for x in (fitted, other)]
        lines.append(f"{name:<24} {'   '.join(cells)}")
    return "\n".join(lines) + "\n\n" + _start(first)


def _start(result: UpdateResult) -> str:
    """Say what the start is worth: with another handbook value of E it would look much better."""
    other = result.start.scaled({"beam": {"stiffness": OTHER_E / E}})
    figures = correlate(other, result.frf.select(responses=result.fitted_responses)).figures()
    return (
        f"The start has the dimensions inferred from these FRFs and a handbook E of {E / 1e9:g}"
        " GPa. Its FRAC is near 0 because resonances as sharp as these miss each other when"
        f" frequencies are off by per cents: with {OTHER_E / 1e9:g} GPa, a handbook value too, the"
        f" start would read {figures['db_error_median']:.2f} dB and {figures['frac_median']:.2f}."
        " Judge by what is reached, not by how far it came. (A fit weighs every value by its"
        " noise, resonances and antiresonances alike; medians may go either way.)"
    )


def remains(result: UpdateResult) -> str:
    """Say what of the measurement the last model does not explain, and why."""
    computed = correlate(result.model, result.frf)
    error = computed.db_error
    levels = ", ".join(
        f"{np.median(error[(computed.freq >= a) & (computed.freq < b)]):.2f} dB in {a:g}-{b:g} Hz"
        for a, b in _BANDS
    )
    apart = 1e3 * max(abs(STATIONS[int(s[:3])] - STATIONS[int(h[:3])]) for s, h in _PAIRS)
    twisted, mac = torsion(computed, LENGTH)
    swapped, unexplained = reciprocity(computed.measured, computed.computed)
    frequency = next(f for f in modes(result.model, 4).frequency if f > BAND[0])
    found, ours = (one_mode(frf, frequency)[1] for frf in (computed.measured, computed.computed))
    return "\n".join(
        [
            f"What remains of '{result.title}', and why:",
            f"- By band: {levels}.",
            (
                f"- A mode at {twisted:.0f} Hz is missing from the model, and the shapes agree"
                f" least around it (CSAC {computed.csac.min():.2f}). At the sensors it moves much"
                f" as the first torsion of a free bar would (MAC {mac:.2f}), struck and measured"
                " off the axis; a beam that bends in one plane has no torsion."
            ),
            (
                "- Swapping hammer and sensor between stations changes the measurement by"
                f" {swapped:.1%} (median). The two are up to {apart:.1f} mm apart there;"
                f" {unexplained:.1%} is more than the model can put down to that: torsion,"
                " calibration, repeatability."
            ),
            (
                "- Each sensor lies off the model by a level of its own (calibration, or position),"
                " which is no unknown: "
                f"{', '.join(f'{k} {v:+.2f}' for k, v in levels_of(computed.measured, computed.computed).items())} dB."
            ),
            (
                f"- Mode 1 is measured with a loss factor of {found:.2%}; the model gives it"
                f" {ours:.2%}. The foam under the ends dissipates otherwise than two springs with"
                " one loss factor. Loss factors that differ between segments are the nearest that"
                " the model has to it: read them as that, not as a finding about the steel."
            ),
            (
                "- Length, section and positions were inferred, and the form of the model chosen,"
                " with sight of all sensors, the held-out ones included, and so was the number of"
                " segments (benchmarks/beam.py has others). Segments that differ by a few per cent"
                " may as well be positions that are off by millimetres. Suspension modes, below 60"
                " Hz, are not modelled."
            ),
        ]
    )


def reciprocity(measured: FRF, computed: FRF) -> tuple[float, float]:
    """Return how far H_ij / H_ji is from 1 over pairs of stations, and how far from that of the model: medians."""

    def ratio(frf: FRF) -> NDArray[np.complex128]:
        H = frf.select(responses=[s for s, _ in _PAIRS], references=[h for _, h in _PAIRS]).values
        i, j = np.triu_indices(len(_PAIRS), 1)
        return np.asarray(H[:, i, j] / H[:, j, i])

    found, expected = ratio(measured), ratio(computed)
    return float(np.median(np.abs(found - 1.0))), float(np.median(np.abs(found / expected - 1.0)))


def levels_of(measured: FRF, computed: FRF) -> dict[str, float]:
    """Return the level of each sensor against the model, in dB: median over lines, mean over hammer points."""
    level = np.median(
        20.0 * np.log10(np.abs(measured.values) / np.abs(computed.values)), axis=0
    ).mean(axis=1)
    return dict(zip(measured.responses.labels, level.tolist(), strict=True))


def torsion(computed: Correlation, length: float) -> tuple[float, float]:
    """Find the mode around the line where shapes agree least, in what the model does not explain.

    Parameters
    ----------
    computed : Correlation
        Model against measurement.
    length : float
        Of the beam, in m.

    Returns
    -------
    frequency : float
        Its natural frequency in Hz.
    mac : float
        Of its shape with cos(pi x / length), the first torsion mode of a free bar.
    """
    measured = computed.measured
    rest = replace(measured, values=measured.values - computed.computed.values)
    frequency, _, residues = one_mode(rest, float(computed.freq[computed.csac.argmin()]))
    shape = np.linalg.svd(residues)[0][:, 0]
    twist = np.cos(np.pi * np.array([STATIONS[d.node] for d in measured.responses]) / length)
    return frequency, float(np.abs(shape @ twist) ** 2 / (twist @ twist))


def one_mode(frf: FRF, near: float) -> tuple[float, float, NDArray[np.complex128]]:
    """Fit one mode to all channels at once: a pole and a constant in receptance, least squares in accelerance.

    Parameters
    ----------
    frf : FRF
        Accelerances.
    near : float
        About where it is, in Hz; lines to 5 % on each side are used.

    Returns
    -------
    frequency, loss_factor : float
        In Hz, and dimensionless.
    residues : ndarray of complex, shape (n_responses, n_references)
        Up to a factor.
    """
    from scipy.optimize import least_squares

    part = frf.select(band=(0.95 * near, 1.05 * near))
    square = (part.freq / near) ** 2
    Y = part.values.reshape(len(square), -1)

    def amplitudes(pole: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        ratio, loss = pole
        shapes = square[:, None] * np.column_stack(
            [1.0 / (ratio * (1.0 + 1j * loss) - square), np.ones(len(square))]
        )
        found = np.linalg.lstsq(shapes, Y, rcond=None)[0]
        return found, Y - shapes @ found

    def misfit(pole: NDArray[np.float64]) -> NDArray[np.float64]:
        r = amplitudes(pole)[1].ravel()
        return np.concatenate([r.real, r.imag])

    pole = least_squares(misfit, [1.0, 0.01], x_scale=[0.01, 0.01]).x
    residues = amplitudes(pole)[0][0].reshape(part.values.shape[1:])
    return near * float(np.sqrt(pole[0])), float(pole[1]), residues
