"""A servo and the figures of its drive for other programs, as parts of ``control.json``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from updyn.control.job.nonlinear import Nonlinear
from updyn.control.servo.drive_figures import DriveFigures
from updyn.control.servo.record import Loop, Servo, StepResponse, WindResponse
from updyn.store.values import plain

__all__ = ["drive_record", "nonlinear_record", "servo_record"]

_STEP = ("of", "size", "input", "input_unit", "output", "output_unit", "final", "rise_time", "overshoot",
         "settling_time", "peak", "peak_time")  # fmt: skip
_WIND = (
    "input",
    "input_unit",
    "output",
    "output_unit",
    "rms",
    "peak",
    "mean",
    "rms_expected",
    "facts",
)


def servo_record(servo: Servo) -> dict[str, Any]:
    """Return a servo as a dict that `json.dumps` writes without inf or nan.

    Parameters
    ----------
    servo : Servo
        From `updyn.servo`.

    Returns
    -------
    dict
        ``stable``, of every loop and member of a family; ``controller``; the names of the ports;
        ``bandwidth`` in Hz; ``poles`` of the closed loop (``re``, ``im`` in rad/s);
        ``velocity_loop`` and ``position_loop``: ``margins`` as
        `updyn.control.servo.margins.Margins` has them, and ``worst`` over the family; ``step``,
        ``disturbance_step`` and ``wind``: figures, without the series; ``notes``.
    """
    return {
        "stable": servo.stable,
        "controller": plain(asdict(servo.controller)),
        "torque": servo.torque,
        "velocity": servo.velocity,
        "position": servo.position,
        "disturbance": servo.disturbance,
        "pointing": servo.pointing,
        "inertia": plain(servo.plant.get("inertia")),
        "bandwidth": plain(servo.bandwidth),
        "poles": [{"re": float(p.real), "im": float(p.imag)} for p in servo.poles],
        "velocity_loop": _loop(servo.velocity_loop),
        "position_loop": None if servo.position_loop is None else _loop(servo.position_loop),
        "step": _figures(servo.step, _STEP),
        "disturbance_step": _figures(servo.disturbance_step, _STEP),
        "wind": _figures(servo.wind, _WIND),
        "notes": list(servo.notes),
    }


def _loop(loop: Loop) -> dict[str, Any]:
    return {
        "margins": plain(asdict(loop.margins)),
        "bandwidth": plain(loop.bandwidth),
        "worst": {name: plain(asdict(spread)) for name, spread in loop.worst.items()},
        "unstable_members": list(loop.unstable_members),
    }


def _figures(
    found: StepResponse | WindResponse | None, names: tuple[str, ...]
) -> dict[str, Any] | None:
    return None if found is None else {name: plain(getattr(found, name)) for name in names}


def drive_record(drive: DriveFigures) -> dict[str, Any]:
    """Return the figures of a drive as a dict that `json.dumps` writes without inf or nan.

    Parameters
    ----------
    drive : DriveFigures
        From `updyn.drive_figures`.

    Returns
    -------
    dict
        What `updyn.control.servo.drive_figures.DriveFigures` holds, by the same names.
    """
    out = plain(asdict(drive))
    assert isinstance(out, dict)
    if drive.bandwidth is not None:
        out["bandwidth"]["rule"] = drive.bandwidth.rule
    return out


def nonlinear_record(found: Nonlinear) -> dict[str, Any]:
    """Return a loop with backlash or friction as a dict that `json.dumps` writes without inf or nan.

    Parameters
    ----------
    found : Nonlinear
        What the job gave.

    Returns
    -------
    dict
        ``kind``, ``where``, ``law`` (its numbers); ``linear_stable``; ``cycles``, one dict each
        with what `updyn.control.nonlinear.balance.LimitCycle` holds but the describing function;
        ``simulation``, None where there is none: ``verdict``, ``amplitude``, ``frequency`` and so
        on; ``begun``, ``disputed`` and ``note``.
    """
    ended = found.simulation
    names = ("verdict", "amplitude", "peak", "frequency", "periods", "unit")
    cycle = ("amplitude", "frequency", "stable", "loeb", "third", "unit", "doubt")
    return {
        "kind": found.kind,
        "where": found.where,
        "law": plain(asdict(found.law)),
        "linear_stable": bool(found.cycles.linear_stable),
        "cycles": [{name: plain(getattr(c, name)) for name in cycle} for c in found.cycles],
        "simulation": (
            None if ended is None else {name: plain(getattr(ended, name)) for name in names}
        ),
        "begun": found.begun,
        "disputed": found.disputed,
        "note": found.note,
    }
