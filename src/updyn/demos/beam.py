"""A free-free steel beam, struck at six points and measured by seven accelerometers (Ladisk; see ``data/README.md``).

Two jobs: the whole beam with its pads and accelerometers, then, from there, the beam in segments.
Two accelerometers are held out of both.

What the model takes for granted was not measured. The source gives neither drawing nor positions:
length, section and stations were inferred from these FRFs (natural frequencies, mode shapes,
level), the pads and the mass of the accelerometers are assumed. E = 200 GPa and the density are
handbook values of steel.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from updyn.updating.result import UpdateResult

__all__ = [
    "BAND",
    "HAMMER",
    "HELD_OUT",
    "SENSORS",
    "STATIONS",
    "epilogue",
    "next_job",
    "segments_job",
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
    from updyn.demos.beam_remains import comparison, remains

    return f"{_SOURCE}\n\n{comparison(results)}\n\n{remains(results[-1])}"
