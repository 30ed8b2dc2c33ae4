"""Tuning of the controller of a job: its gains and corner frequencies, and the loop with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit import TOMLDocument

from updyn.control.files.plant_file import PLANT_FORMATS, read_plant
from updyn.control.job.tables import PLANT_FILES, ServoTable
from updyn.control.plant import Plant
from updyn.control.report.servo import first_margins, most_critical, servo_figures
from updyn.control.servo.servo import servo
from updyn.control.servo.verdict import ServoVerdict, judge_servo
from updyn.errors import JobError, key_path
from updyn.group import is_number
from updyn.job import load_job
from updyn.report.plots import Figure
from updyn.web.edits import Edit
from updyn.web.form import written_table

__all__ = [
    "Gain",
    "GainPath",
    "TunedLoop",
    "find_plant_file",
    "list_gains",
    "set_gains",
    "tune_loop",
]

#: Place of a number in ``[servo.controller]``.
GainPath = tuple[str | int, ...]
#: Units of the keys of ``[servo.controller]`` and of its notches that can be tuned.
_UNITS = {
    "kp": "",
    "ti": "s",
    "kv": "1/s",
    "crossover": "Hz",
    "ti_ratio": "",
    "kv_ratio": "",
    "low_pass": "Hz",
}
_NOTCH_UNITS = {"frequency": "Hz", "width": "Hz", "zero_damping": "", "pole_damping": ""}


@dataclass(frozen=True, slots=True)
class Gain:
    """A number of the controller of a job: its place, its name for a page, its unit."""

    path: GainPath
    label: str
    unit: str
    value: float


@dataclass(frozen=True, slots=True)
class TunedLoop:
    """A servo on the nominal plant: verdict, table of margins, Bode diagram and step response."""

    verdict: ServoVerdict
    rows: tuple[tuple[str, str], ...]
    figures: tuple[Figure, ...]


def list_gains(text: str) -> list[Gain]:
    """Return the positive numbers of the controller in the text of a job that can be tuned."""
    controller = written_table(text, "servo").get("controller")
    if not isinstance(controller, dict):
        return []
    found = [Gain((key,), key, unit, controller.get(key, 0.0)) for key, unit in _UNITS.items()]
    written = controller.get("notch")
    notches = written if isinstance(written, list) else []
    for number, notch in enumerate(notches):
        if isinstance(notch, dict):
            name = f"notch {number + 1}" if len(notches) > 1 else "notch"
            for key, unit in _NOTCH_UNITS.items():
                label = f"{name}, {key.replace('_', ' ')}"
                found.append(Gain(("notch", number, key), label, unit, notch.get(key, 0.0)))
    return [gain for gain in found if is_number(gain.value) and gain.value > 0]


def set_gains(values: Mapping[GainPath, float]) -> Edit:
    """Return the edit that sets numbers of the controller, with four digits."""

    def edit(document: TOMLDocument) -> None:
        for path, value in values.items():
            place: Any = document["servo"]
            for key in ("controller", *path[:-1]):
                place = place[key]
            place[path[-1]] = float(f"{value:.4g}")

    return edit


def find_plant_file(text: str, folder: Path) -> Path | None:
    """Return the first readable file of the plant of a job in a folder; None without one."""
    names = written_table(text, "plant").get("files", PLANT_FILES)
    readable = {s for f in PLANT_FORMATS if "read_plant" in f.can for s in f.suffixes}
    for name in [names] if isinstance(names, str) else names:
        file = folder / str(name)
        if file.suffix.lower() in readable and file.is_file():
            return file
    return None


def tune_loop(path: Path, text: str, file: Path, values: Mapping[GainPath, float]) -> TunedLoop:
    """Return the loop of a job on the plant in a file, with other numbers of the controller."""
    document = tomlkit.parse(text)
    set_gains(values)(document)
    job = load_job(path, text=tomlkit.dumps(document))
    table = job.table(ServoTable)
    if table is None or table.controller is None or table.velocity is None:
        raise JobError("the job has no [servo.controller]", path)
    plant = _read_plant(file, file.stat().st_mtime_ns)
    torque, velocity, position = table.torque or plant.inputs[0], table.velocity, table.position
    with key_path("servo", "controller"):
        controller = table.controller.controller(plant, torque, velocity, position)
    with key_path("servo"):
        found = servo(
            plant,
            controller,
            torque=torque,
            velocity=velocity,
            position=position,
            step=table.step,
            disturbance_step=None,
            duration=table.duration,
        )
    figures = servo_figures(found, plant)
    names = (f"bode-{most_critical(found).name}", "step")
    rows = [
        (f"{loop}: {title}", value)
        for loop, cells in first_margins(found)[1]
        for title, value, *_ in cells
    ]
    shown = tuple(figures[name] for name in names if name in figures)
    return TunedLoop(judge_servo(found), tuple(rows), shown)


@lru_cache(maxsize=2)
def _read_plant(file: Path, _modified: int) -> Plant:
    return read_plant(file)
