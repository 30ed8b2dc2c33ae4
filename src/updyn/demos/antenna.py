"""A 4 m antenna with two drives, rotors locked and free: simulated data with noise.

One factor represents a gearbox with its shafts, because its stages act in series, far below their
own modes. Mesh and gearbox of the elevation drive share one factor: no sensor can reach the pinion.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import RealArray
from updyn.demos.antenna_model import AZIMUTH, ELEVATION, SKIN, STEEL, antenna, lock_rotors
from updyn.dynamics.modes import modes
from updyn.dynamics.response import response
from updyn.frf import FRF
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.updating.result import JointResult

__all__ = [
    "HAMMER",
    "MOTORS",
    "SENSORS",
    "TRUTH",
    "epilogue",
    "headline",
    "measure",
    "true_values",
    "write_inputs",
]

#: Sensor DOFs by place.
SENSORS: Mapping[str, tuple[str, ...]] = {
    "rim, top": ("451:X", "451:Z"),
    "rim, bottom": ("463:X", "463:Z"),
    "rim, left and right": ("457:X", "457:Y", "469:X", "469:Y"),
    "hub": ("4:X", "4:Y", "4:Z"),
    "feed": ("5:X", "5:Y", "5:Z"),
    "yoke, tops of the arms": ("108:X", "108:Y", "108:Z", "118:X", "118:Z"),
    "turntable": ("3:X", "3:Y"),
    "pedestal, top": ("2:X", "2:Y"),
    "counterweights": ("213:X", "213:Z", "223:X"),
    "azimuth pinion": (f"{AZIMUTH['pinion']}:RZ",),
}
#: Hammer points: the rim at its top and its side, and the top of an arm of the yoke.
HAMMER = ("451:X", "457:X", "108:Y")
#: Encoders (responses) and torques (references) of both motors; only with free rotors.
MOTORS = (f"{AZIMUTH['motor']}:RZ", f"{ELEVATION['motor']}:RZ")

_GEARBOX = ("input shaft", "stage 1", "stage 2", "pinion shaft")
_DRIVE = (*_GEARBOX, "mesh")
_TRUSS = ("truss chords", "truss webs", "truss hoops")
_THICKER = 1.15

#: True values: factors on stiffness, mass and viscous damping, and loss factors.
TRUTH: dict[str, dict[str, float]] = {
    "foundation": {"stiffness": 0.75, "loss_factor": 0.06},
    "azimuth bearing": {"stiffness": 1.3, "loss_factor": 0.05},
    "elevation bearings": {"stiffness": 0.7},
    "yoke": {"stiffness": 0.92, "loss_factor": 0.015},
    "counterweight": {"mass": 1.06},
    **{f"azimuth {part}": {"stiffness": 0.8, "loss_factor": 0.045} for part in _GEARBOX},
    "azimuth mesh": {"stiffness": 1.3, "loss_factor": 0.045},
    **{f"elevation {part}": {"stiffness": 0.72, "loss_factor": 0.02} for part in _DRIVE},
    "azimuth motor": {"mass": 1.1},
    "elevation motor": {"mass": 0.93},
    "azimuth drag": {"viscous": 1.6},
    "elevation drag": {"viscous": 0.7},
    **{name: {"stiffness": 0.93, "loss_factor": 0.016} for name in _TRUSS},
    "reflector": {"stiffness": _THICKER, "mass": _THICKER},
    "reflector bending": {"stiffness": _THICKER**3},
}

BAND = (4.0, 62.0)  # Hz
_LINES = 233  # every 0.25 Hz
_AVERAGES = 5
_NOISE = {"relative": 0.03, "floor": 0.002}
_SEED = 4

_JOB = """\
title = "Antenna of 4 m, rotors locked and free"

[model]
file = "model.h5"

[[test]]
name = "rotors locked"
file = "locked.uff"
averages = {averages}
grounded = {motors}

[[test]]
name = "rotors free"
file = "free.uff"
averages = {averages}

{unknowns}
[method]
name = "maximum-likelihood"
lines = "d-optimal:24"
starts = 1  # the drawings are near enough: tries from elsewhere end where the first one does
validation = ["463:Z"]
"""


def _unknown_per_group(groups: Sequence[str], quantity: str, low: float, high: float) -> str:
    return (
        f"[[parameter]]\ngroups = {_toml_array(groups)}\n"
        f'quantity = "{quantity}"\nbounds = [{low}, {high}]\n'
    )


def _linked_unknown(
    name: str, drives: Mapping[str, float], low: float, high: float, more: str = ""
) -> str:
    """Return the text of an unknown that drives several quantities, each with a power."""
    table = ", ".join(f'"{drive}" = {power:g}' for drive, power in drives.items())
    return (
        f'[[parameter]]\nname = "{name}"\ndrives = {{ {table} }}\nbounds = [{low}, {high}]\n{more}'
    )


def _toml_array(texts: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{text}"' for text in texts) + "]"


def _parts(axis: str, names: Sequence[str], quantity: str) -> dict[str, float]:
    """Return the quantities of parts of a drive, each with the power 1."""
    return dict.fromkeys([f"{axis} {name}.{quantity}" for name in names], 1.0)


def _unknowns() -> str:
    thickness = {"reflector.stiffness": 1, "reflector bending.stiffness": 3, "reflector.mass": 1}
    modulus = f'nominal = {STEEL["E"]:g}\nunit = "Pa"\n'
    skin = f'nominal = {SKIN:g}\nunit = "m"\n'
    springs = ["foundation", "azimuth bearing", "elevation bearings", "yoke", "azimuth mesh"]
    gearbox = _parts("azimuth", _GEARBOX, "stiffness")
    elevation = _parts("elevation", _DRIVE, "stiffness")
    azimuth_loss = _parts("azimuth", _DRIVE, "loss_factor")
    elevation_loss = _parts("elevation", _DRIVE, "loss_factor")
    unknowns = [
        _unknown_per_group(springs, "stiffness", 0.3, 3),
        _linked_unknown("azimuth gearbox.stiffness", gearbox, 0.3, 3.0),
        _linked_unknown("elevation drive.stiffness", elevation, 0.3, 3.0),
        _unknown_per_group(["foundation", "azimuth bearing", "yoke"], "loss_factor", 0.0, 0.3),
        _linked_unknown("azimuth drive.loss", azimuth_loss, 0.0, 0.2),
        _linked_unknown("elevation drive.loss", elevation_loss, 0.0, 0.2),
        _unknown_per_group(["azimuth motor", "elevation motor", "counterweight"], "mass", 0.5, 2.0),
        _unknown_per_group(["azimuth drag", "elevation drag"], "viscous", 0.05, 20.0),
        _linked_unknown("truss.E", {"truss *.stiffness": 1}, 0.5, 2.0, modulus),
        _linked_unknown("truss.loss", {"truss *.loss_factor": 1}, 0.0, 0.2),
        _linked_unknown("reflector.thickness", thickness, 0.5, 2.0, skin),
    ]
    return "\n".join(unknowns)


def measure(model: Model, seed: int, *, torques: bool, n_lines: int = _LINES) -> FRF:
    """Return the simulated measurement of a model, with noise of a seed.

    With `torques`, the rotors are free and the motor torques are references.
    """
    # The variance of H is estimated as |H|^2 (1 - gamma^2) / (gamma^2 (n - 1)) (Bendat & Piersol,
    # Random Data, 2010).
    sensors = list(itertools.chain.from_iterable(SENSORS.values()))
    forces = list(HAMMER)
    if torques:
        sensors += MOTORS
        forces += MOTORS
    exact = response(model, np.linspace(*BAND, n_lines), sensors, forces, quantity="accelerance")
    H = exact.values
    rms = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    variance = (_NOISE["relative"] * np.abs(H)) ** 2 + (_NOISE["floor"] * rms) ** 2
    draw = np.random.default_rng(seed).normal(size=(2, *H.shape)) / np.sqrt(2.0)
    values = H + np.sqrt(variance) * (draw[0] + 1j * draw[1])
    # The unexplained power has n - 1 degrees of freedom: n averages less the one fitted number.
    unexplained = variance * np.random.default_rng((seed, 1)).gamma(_AVERAGES - 1, size=H.shape)
    power = np.abs(values) ** 2
    coherence: RealArray = power / (power + unexplained)
    return FRF(
        exact.freq,
        values,
        sensors,
        forces,
        "accelerance",
        coherence=coherence,
        source="synthetic, 3 % noise",
    )


def write_inputs(folder: Path, n_lines: int = _LINES) -> Path:
    """Write model, two measurements and job file; return the path of the job file."""
    from updyn.io import write_frf, write_model

    model = antenna()
    true = model.scaled(TRUTH)
    write_model(model, folder / "model.h5")
    write_frf(
        measure(lock_rotors(true), _SEED, torques=False, n_lines=n_lines), folder / "locked.uff"
    )
    write_frf(measure(true, _SEED + 1, torques=True, n_lines=n_lines), folder / "free.uff")
    job = folder / "job.toml"
    text = _JOB.format(averages=_AVERAGES, motors=_toml_array(MOTORS), unknowns=_unknowns())
    job.write_text(text, encoding="utf-8")
    return job


# -- results
def true_values(parameters: Sequence[Any]) -> dict[str, float]:
    """Return the true value of each unknown."""
    out = {}
    for p in parameters:
        first = p.acts_on[0]
        out[p.name] = TRUTH[first.group][first.quantity] ** (1.0 / first.power)
    return out


def headline(results: Sequence[JointResult]) -> str:
    """Return the largest deviation from the true values, in standard deviations."""
    result = results[-1]
    true = true_values(result.parameters)
    off = [abs((result.values[name] - true[name]) / result.std[name]) for name in true]
    return (
        f"All {len(off)} unknowns are within {max(off):.1f} standard deviations of the values that"
        " made the data."
    )


def epilogue(results: Sequence[JointResult], folder: Path) -> str:
    """Compare unknowns and first frequencies of both tests with the true values."""
    result = results[-1]
    true = true_values(result.parameters)
    lines = [
        "Against the values that made the data:",
        f"{'unknown':<28} {'true':>6} {'found':>10} {'std':>8} {'error / std':>12}",
    ]
    for p in result.parameters:
        value, std = result.values[p.name], result.std[p.name]
        off = (value - true[p.name]) / std
        lines.append(f"{p.name:<28} {true[p.name]:>6g} {value:>10.5g} {std:>8.2g} {off:>+12.1f}")
    return "\n\n".join(["\n".join(lines), _frequencies(result)])


def _frequencies(result: JointResult) -> str:
    """Return a table of the first natural frequencies of both tests."""
    lines = ["First frequencies in Hz:", f"{'':<26}{'drawings':>10}{'updated':>10}{'true':>10}"]
    largest = max(one.model.n_dofs for one in result.results.values())
    for name, one in result.results.items():
        is_free = one.model.n_dofs == largest
        rigid = len(MOTORS) if is_free else 0  # both axes rotate freely
        columns = []
        for model in (one.start, one.model, one.start.scaled(TRUTH)):
            columns.append(modes(model, rigid + 4).frequency[rigid:])
        for number, row in enumerate(np.transpose(columns), 1):
            cells = "".join(f"{f:>10.3f}" for f in row)
            lines.append(f"{name + f', {number}':<26}{cells}")
    return "\n".join(lines)
