"""``control.json``: the plant result for other programs, in strict JSON (null for inf and nan)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from updyn import __version__
from updyn.control.job.plant_result import PlantResult
from updyn.control.job.servo import Nonlinear
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.drive import DriveFigures
from updyn.control.servo.record import Loop, SampledLoops, Servo
from updyn.control.servo.verdict import judge_servo
from updyn.store.values import plain

__all__ = [
    "control_record",
    "drive_record",
    "nonlinear_record",
    "servo_record",
    "write_control_record",
]
_STEP = (
    "of",
    "size",
    "input",
    "input_unit",
    "output",
    "output_unit",
    "final",
    "rise_time",
    "overshoot",
    "settling_time",
    "peak",
    "peak_time",
)
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


def control_record(result: PlantResult) -> dict[str, object]:
    """Return a plant result as a dict without inf or nan, for `json.dumps`."""
    return {
        "title": result.title,
        "updated": result.updated,
        "source": result.source,
        "band": plain(result.band),
        "tolerance": plain(result.tolerance),
        "tolerance_of": result.measure,
        "met": result.holds_tolerance,
        "message": result.message,
        "plant": None if result.plant is None else _plant(result, result.plant),
        "conversions": [plain(asdict(c)) for c in result.conversions],
        "sampled": None if result.sampled is None else _sampled_record(result.sampled),
        "family": _family(result),
        "servo": None if result.servo is None else servo_record(result.servo),
        "nonlinear": [nonlinear_record(found) for found in result.nonlinear],
        "drive": None if result.drive is None else drive_record(result.drive),
        "notes": list(result.notes),
        "versions": {"updyn": __version__},
    }


def write_control_record(result: PlantResult, path: str | Path) -> None:
    """Write `control_record` to a file, usually ``control.json``, atomically."""
    from updyn.io.atomic import write_json

    write_json(control_record(result), path)


def _plant(result: PlantResult, plant: Plant) -> dict[str, object]:
    outputs = []
    for port, quantity in zip(plant.output_ports, plant.quantities, strict=True):
        outputs.append({**_port(port, port.motion_unit(quantity)), "quantity": quantity})
    channels = []
    relative = result.channel_errors("relative")
    for (i, j), error in np.ndenumerate(result.channel_errors()):
        names = {"output": plant.outputs[i], "input": plant.inputs[j]}
        channel_errors = {"error": plain(error), "relative_error": plain(relative[i, j])}
        channels.append({**names, **channel_errors})
    return {
        "relative_error": plain(plant.relative_error),
        "error": plain(plant.error),
        "peak_error": plain(plant.peak_error),
        "route": plant.route,
        "order": plant.n_states,
        "rigid": plant.rigid,
        "inputs": [_port(p, p.force_unit) for p in plant.input_ports],
        "outputs": outputs,
        "modes_hz": plain(plant.modes),
        "poles": _poles(plant),
        "channels": channels,
        "zeros": [plain(asdict(zero)) for zero in plant.zero_shift],
        "facts": plain(dict(plant.facts)),
    }


def _poles(plant: Plant) -> list[object]:
    """Return the poles with frequency and damping ratio, ascending."""
    out = []
    for pole in plant.poles[np.lexsort((-plant.poles.imag, np.abs(plant.poles)))]:
        size = abs(pole)
        damping = -pole.real / size if size > 0 else np.nan
        figures = {"frequency_hz": size / (2.0 * np.pi), "damping_ratio": damping}
        out.append(plain({"re": pole.real, "im": pole.imag, **figures}))
    return out


def _port(port: Port, unit: str) -> dict[str, object]:
    return {"name": port.name, "unit": unit, "weights": plain(dict(port.weights))}


def _sampled_record(plant: Plant) -> dict[str, object]:
    return {
        "dt": plant.dt,
        "delay": plant.delay,
        "order": plant.n_states,
        "zeros": [plain(asdict(zero)) for zero in plant.zero_shift],
        "facts": plain(dict(plant.facts)),
    }


def _family(result: PlantResult) -> dict[str, object] | None:
    if result.family is None:
        return None
    return {
        "members": len(result.family),
        "error": plain(result.family.error),
        "unknowns": list(result.family.names),
        "facts": plain(dict(result.family.facts)),
        "weights": _weights(result),
    }


def _weights(result: PlantResult) -> list[dict[str, object]]:
    out = []
    for found in result.weights.values():
        ((weight,),) = found.weights
        roots = {"zeros": _complex(weight.zeros), "poles": _complex(weight.poles)}
        figures = _figures(weight, ("largest", "mean", "peak", "peak_at", "note"))
        names = {"output": found.outputs[0], "input": found.inputs[0], "kind": found.kind}
        out.append({**names, "order": weight.order, "gain": plain(weight.gain), **roots, **figures})
    return out


def servo_record(servo: Servo) -> dict[str, object]:
    """Return a servo as a dict without inf or nan, for `json.dumps`."""
    loops = {loop.name: _loop(loop) for loop in servo.loops}
    return {
        "stable": servo.stable,
        "verdict": judge_servo(servo).text,
        "doubts": list(servo.doubts),
        "controller": plain(asdict(servo.controller)),
        "torque": servo.torque,
        "velocity": servo.velocity,
        "position": servo.position,
        "disturbance": servo.disturbance,
        "pointing": servo.pointing,
        "inertia": plain(servo.plant.get("inertia")),
        "bandwidth": plain(servo.bandwidth),
        "poles": _complex(servo.poles),
        "velocity_loop": loops["velocity"],
        "position_loop": loops.get("position"),
        "torque_loop": None if servo.torque_loop is None else _loop(servo.torque_loop),
        "sampled": None if servo.sampled is None else _sampled_loops(servo.sampled),
        "robust": [{**plain(asdict(m)), "meaning": m.meaning} for m in servo.robust],
        "step": _figures_or_none(servo.step, _STEP),
        "disturbance_step": _figures_or_none(servo.disturbance_step, _STEP),
        "wind": _figures_or_none(servo.wind, _WIND),
        "notes": list(servo.notes),
    }


def _sampled_loops(sampled: SampledLoops) -> dict[str, object]:
    loops = {f"{loop.name}_loop": _loop(loop) for loop in sampled.loops}
    return {
        "dt": sampled.dt,
        "delay": sampled.delay,
        **{name: loops.get(name) for name in ("velocity_loop", "position_loop", "torque_loop")},
        "poles": _complex(sampled.poles),
        "notes": list(sampled.notes),
    }


def _loop(loop: Loop) -> dict[str, object]:
    return {
        "margins": plain(asdict(loop.margins)),
        "bandwidth": plain(loop.bandwidth),
        "modulus_range": plain(loop.modulus_range),
        "worst": {name: plain(asdict(spread)) for name, spread in loop.worst.items()},
        "unstable_members": list(loop.unstable_members),
    }


def _figures(found: object, names: tuple[str, ...]) -> dict[str, object]:
    return {name: plain(getattr(found, name)) for name in names}


def _figures_or_none(found: object, names: tuple[str, ...]) -> dict[str, object] | None:
    """Return some attributes of an object, or None for None."""
    if found is None:
        return None
    return _figures(found, names)


def _complex(values: Any) -> list[dict[str, float]]:
    return [{"re": float(z.real), "im": float(z.imag)} for z in values]


def drive_record(drive: DriveFigures) -> dict[str, object]:
    """Return the fields of `DriveFigures` as a dict without inf or nan, for `json.dumps`."""
    out = plain(asdict(drive))
    assert isinstance(out, dict)
    if drive.bandwidth is not None:
        out["bandwidth"]["rule"] = drive.bandwidth.rule
    return out


def nonlinear_record(found: Nonlinear) -> dict[str, object]:
    """Return a loop with backlash or friction as a dict without inf or nan, for `json.dumps`."""
    names = ("verdict", "amplitude", "peak", "frequency", "periods", "unit")
    cycle = ("amplitude", "frequency", "stable", "loeb", "third", "unit", "doubt")
    return {
        "kind": found.kind,
        "where": found.where,
        "law": plain(asdict(found.law)),
        "linear_stable": bool(found.cycles.linear_stable),
        "cycles": [_figures(c, cycle) for c in found.cycles],
        "simulation": _figures_or_none(found.simulation, names),
        "begun": found.begun,
        "disputed": found.disagreement,
        "note": found.note,
    }
