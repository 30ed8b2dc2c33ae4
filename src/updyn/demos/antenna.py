"""A 4 m antenna with its two drives, tested with its rotors locked and free; data made from a hidden truth, with noise.

The model is generated (`updyn.demos.antenna_model`). The hidden truth makes the data and is
compared with at the end; the update sees neither. Where there is no unknown the truth is as the
drawings have it.

What is not among the unknowns, and why (checked by freeing it, at the truth):

- The stages of a gearbox act in series, far below their own modes: 20 of 21 unknowns would be
  determined. One factor stands for a gearbox with its shafts.
- The elevation pinion cannot be reached by a sensor. Mesh and gearbox, in series too, would be
  known to 7 and 4 % only, their sum to 0.03 %: one factor for all. On the azimuth drive a sensor on
  the pinion tells them apart.
- Chords, webs and hoops of the truss could be told apart, but are of one steel: one modulus.
- Pedestal, torque tube, hub and feed legs are as drawn and weighed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from updyn.demos.antenna_model import AZIMUTH, ELEVATION, SKIN, STEEL, antenna, locked
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
    "measure",
    "true_values",
    "write_inputs",
]

#: Where the sensors are: DOFs by place, as a survey would choose them.
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
#: Struck: the rim at its top and its side, the top of an arm of the yoke.
HAMMER = ("451:X", "457:X", "108:Y")
#: Encoders, and torques as reference, of both motors; only where the rotors are free.
MOTORS = (f"{AZIMUTH['motor']}:RZ", f"{ELEVATION['motor']}:RZ")

_GEARBOX = ("input shaft", "stage 1", "stage 2", "pinion shaft")
_DRIVE = (*_GEARBOX, "mesh")
_SPRINGS = ("foundation", "azimuth bearing", "elevation bearings", "yoke", "azimuth mesh")
_THICKER = 1.15

#: What made the data: factors on stiffness, mass and viscous damping, and loss factors.
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
    **{
        f"truss {part}": {"stiffness": 0.93, "loss_factor": 0.016}
        for part in ("chords", "webs", "hoops")
    },
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


def _plain(groups: Sequence[str], quantity: str, low: float, high: float) -> str:
    listed = ", ".join(f'"{g}"' for g in groups)
    return (
        f'[[parameter]]\ngroups = [{listed}]\nquantity = "{quantity}"\nbounds = [{low}, {high}]\n'
    )


def _linked(name: str, drives: Mapping[str, float], low: float, high: float, more: str = "") -> str:
    table = ", ".join(f'"{drive}" = {power:g}' for drive, power in drives.items())
    return (
        f'[[parameter]]\nname = "{name}"\ndrives = {{ {table} }}\nbounds = [{low}, {high}]\n{more}'
    )


def _unknowns() -> str:
    def ones(axis: str, parts: Sequence[str], quantity: str) -> dict[str, float]:
        return {f"{axis} {part}.{quantity}": 1.0 for part in parts}

    return "\n".join(
        [
            _plain(
                ["foundation", "azimuth bearing", "elevation bearings", "yoke", "azimuth mesh"],
                "stiffness",
                0.3,
                3,
            ),
            _linked("azimuth gearbox.stiffness", ones("azimuth", _GEARBOX, "stiffness"), 0.3, 3.0),
            _linked("elevation drive.stiffness", ones("elevation", _DRIVE, "stiffness"), 0.3, 3.0),
            _plain(["foundation", "azimuth bearing", "yoke"], "loss_factor", 0.0, 0.3),
            _linked("azimuth drive.loss", ones("azimuth", _DRIVE, "loss_factor"), 0.0, 0.2),
            _linked("elevation drive.loss", ones("elevation", _DRIVE, "loss_factor"), 0.0, 0.2),
            _plain(["azimuth motor", "elevation motor", "counterweight"], "mass", 0.5, 2.0),
            _plain(["azimuth drag", "elevation drag"], "viscous", 0.05, 20.0),
            _linked(
                "truss.E",
                {"truss *.stiffness": 1},
                0.5,
                2.0,
                f'nominal = {STEEL["E"]:g}\nunit = "Pa"\n',
            ),
            _linked("truss.loss", {"truss *.loss_factor": 1}, 0.0, 0.2),
            _linked(
                "reflector.thickness",
                {"reflector.stiffness": 1, "reflector bending.stiffness": 3, "reflector.mass": 1},
                0.5,
                2.0,
                f'nominal = {SKIN:g}\nunit = "m"\n',
            ),
        ]
    )


def measure(model: Model, seed: int, *, torques: bool, n_lines: int = _LINES) -> FRF:
    """Return what sensors and analyser would give on a model.

    Parameters
    ----------
    model : Model
        In the configuration of the test.
    seed : int
        Of the noise.
    torques : bool
        Whether the rotors are free, so that the encoders move and torques of the motors are
        references too.
    n_lines : int
        Lines, evenly over `BAND`.

    Returns
    -------
    FRF
        Accelerances with noise, and the coherence of n averages that goes with it, from which
        E|dH|^2 is estimated as
        |H|^2 (1 - gamma^2) / (gamma^2 (n - 1)) (Bendat & Piersol, Random Data, 2010).
    """
    sensors = [label for labels in SENSORS.values() for label in labels] + (
        list(MOTORS) if torques else []
    )
    forces = [*HAMMER, *(MOTORS if torques else ())]
    exact = response(model, np.linspace(*BAND, n_lines), sensors, forces, quantity="accelerance")
    H = exact.values
    rms = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    variance = (_NOISE["relative"] * np.abs(H)) ** 2 + (_NOISE["floor"] * rms) ** 2
    draw = np.random.default_rng(seed).normal(size=(2, *H.shape)) / np.sqrt(2.0)
    values = H + np.sqrt(variance) * (draw[0] + 1j * draw[1])
    # What the spectra leave unexplained belongs to these very values: n averages less the one
    # number that was fitted.
    unexplained = variance * np.random.default_rng((seed, 1)).gamma(_AVERAGES - 1, size=H.shape)
    coherence: NDArray[np.float64] = np.abs(values) ** 2 / (np.abs(values) ** 2 + unexplained)
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
    write_frf(measure(locked(true), _SEED, torques=False, n_lines=n_lines), folder / "locked.uff")
    write_frf(measure(true, _SEED + 1, torques=True, n_lines=n_lines), folder / "free.uff")
    motors = "[" + ", ".join(f'"{m}"' for m in MOTORS) + "]"
    job = folder / "job.toml"
    text = _JOB.format(averages=_AVERAGES, motors=motors, unknowns=_unknowns())
    job.write_text(text, encoding="utf-8")
    return job


# -- what it comes to --------------------------------------------------------------------------------------
def true_values(parameters: Sequence[Any]) -> dict[str, float]:
    """Return the true value of each unknown."""
    out = {}
    for p in parameters:
        first = p.acts_on[0]
        out[p.name] = TRUTH[first.group][first.quantity] ** (1.0 / first.power)
    return out


def epilogue(results: Sequence[JointResult], folder: Path) -> str:
    """Compare with the values that made the data: by unknown, and first frequencies of both tests."""
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
    lines = ["First frequencies in Hz:", f"{'':<26}{'drawings':>10}{'updated':>10}{'true':>10}"]
    for name, one in result.results.items():
        free = one.model.n_dofs == max(r.model.n_dofs for r in result.results.values())
        skip = len(MOTORS) if free else 0  # both axes turn freely
        three = [
            modes(m, skip + 4).frequency[skip:]
            for m in (one.start, one.model, one.start.scaled(TRUTH))
        ]
        lines += [
            f"{name + f', {number}':<26}" + "".join(f"{f:>10.3f}" for f in row)
            for number, row in enumerate(zip(*three, strict=True), 1)
        ]
    return "\n".join(lines)
