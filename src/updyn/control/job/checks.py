"""Checks of ``[plant]`` and ``[servo]`` before a run, against the text, the model and the data."""

from __future__ import annotations

from collections.abc import Sequence

from updyn.arrays import RealArray
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.control.ports import port_matrix
from updyn.errors import JobError, key_path, suggest
from updyn.job.schema import Job
from updyn.model import Model

__all__ = [
    "band_of_plant",
    "beyond_the_data",
    "check_control",
    "check_control_tables",
    "check_servo_table",
    "part_of_plant",
]


#: Keys of ``[servo]`` that name a port of the plant, and its side.
_PORTS = {
    "torque": "input",
    "disturbance": "input",
    "velocity": "output",
    "position": "output",
    "pointing": "output",
}


def check_control_tables(job: Job) -> None:
    """Check ``[plant]`` of a job against the text, with all its tests."""
    table = job.table(PlantTable)
    if table is None:
        return
    for key in ("inputs", "outputs"):
        names = [port.name for port in getattr(table, f"{key[:-1]}_ports")]
        for number, name in enumerate(names):
            if name in names[:number]:
                text = f"plant: two {key} are named {name!r}; give one of them another name"
                raise JobError(
                    text,
                    key=("plant", key, number),
                )
    if len(table.quantities) != len(table.outputs):
        text = (
            f"plant.quantity: {len(table.quantities)} given; expected one, or one for each of the"
            " outputs, "
        )
        raise JobError(
            f"{text}{len(table.outputs)}",
            key=("plant", "quantity"),
        )
    if table.band is not None and not 0 <= table.band[0] < table.band[1]:
        text = (
            f"plant.band = {list(table.band)}: expected two frequencies in Hz, the lower one first"
        )
        raise JobError(
            text,
            key=("plant", "band"),
        )
    if table.test is not None:
        names = [part.test.name for part in job.parts]
        if len(names) == 1 and table.test != names[0]:
            raise JobError(
                "plant.test chooses one of several tests; this job has one",
                key=("plant", "test"),
            )
        if table.test not in names:
            raise JobError(
                f"plant.test = {table.test!r}: {suggest(table.test, names)}",
                key=("plant", "test"),
            )


def part_of_plant(job: Job) -> int:
    """Return the index of the test whose configuration the plant has; by default the first."""
    table = job.table(PlantTable)
    if table is None or table.test is None:
        return 0
    return [part.test.name for part in job.parts].index(table.test)


def band_of_plant(job: Job, freq: RealArray) -> tuple[float, float]:
    """Return the band of the plant in Hz: as stated, or that of the data of the test."""
    table = job.table(PlantTable)
    assert table is not None
    if table.band is not None:
        return table.band
    above = freq[freq > 0]
    return float(above[0]), float(above[-1])


def beyond_the_data(band: tuple[float, float], freq: RealArray) -> str:
    """Return a note if a band extends beyond the data, else an empty text."""
    low, high = float(freq[0]), float(freq[-1])
    if band[0] >= low * (1 - 1e-9) and band[1] <= high * (1 + 1e-9):
        return ""
    return (
        f"The band of the plant, {band[0]:.4g} to {band[1]:.4g} Hz, extends beyond the data,"
        f" {low:.4g} to {high:.4g} Hz: the model was not compared with measurements outside them."
    )


def check_control(job: Job, models: Sequence[Model], data: Sequence[RealArray]) -> None:
    """Check ``[plant]`` and ``[servo]`` against models and data frequencies of the tests."""
    table = job.table(PlantTable)
    if table is None:
        return
    servo = job.table(ServoTable)
    number = part_of_plant(job)
    for key in ("inputs", "outputs"):
        for at, port in enumerate(getattr(table, f"{key[:-1]}_ports")):
            with key_path("plant", key, at):
                port_matrix((port,), models[number], key[:-1])
    if servo is not None:
        _check_servo_on(servo, models[number])
    high = band_of_plant(job, data[number])[1]
    if table.sampling is not None and high > 0.5 / table.sampling.dt:
        half = 0.5 / table.sampling.dt
        text = (
            f"plant.sampling: half the rate is {half:g} Hz, below the end of the plant's band,"
            f" {high:.4g} Hz"
        )
        raise JobError(
            text,
            key=("plant", "sampling"),
        )


def _check_servo_on(servo: ServoTable, model: Model) -> None:
    """Check that the DOFs and groups of ``[servo]`` are in the model."""
    for key in ("motor", "load"):
        label = getattr(servo, key)
        if label is not None:
            with key_path("servo", key):
                model.dofs.match([label], key)
    for at, each in enumerate(servo.nonlinear):
        with key_path("servo", "nonlinear", at, "at"):
            model.dofs.match([each.at], "DOF")
        if each.mesh is not None:
            with key_path("servo", "nonlinear", at, "mesh"):
                model.group(each.mesh)


# -- [servo] --------------------------------------------------------------------------------------
def check_servo_table(job: Job) -> None:
    """Check ``[servo]`` against the text of the job and the names of the plant's ports."""
    servo = job.table(ServoTable)
    plant = job.table(PlantTable)
    if servo is None:
        return
    if plant is None:
        raise JobError("[servo] without [plant]; add one with inputs and outputs", key=("servo",))
    ports = {
        "input": [p.name for p in plant.input_ports],
        "output": [p.name for p in plant.output_ports],
    }
    for key, what in _PORTS.items():
        name = getattr(servo, key)
        if name is not None and name not in ports[what]:
            text = (
                f"servo.{key} = {name!r}: the plant has no {what} with that name;"
                f" {suggest(name, ports[what])}"
            )
            raise JobError(
                text,
                key=("servo", key),
            )
    if (servo.motor is None) != (servo.load is None):
        raise JobError(
            "servo: expected motor and load, for the figures of the drive; one is missing",
            key=("servo",),
        )
    if servo.ratio is not None and servo.motor is None:
        raise JobError(
            "servo.ratio is checked with motor and load; they are missing",
            key=("servo", "ratio"),
        )
    if servo.wind is not None and servo.disturbance is None:
        raise JobError(
            "servo.wind without disturbance; name the input at which it acts",
            key=("servo", "wind"),
        )
    if servo.wind is not None:
        with key_path("servo", "wind"):
            servo.wind.wind()
    if servo.controller is None:
        keys = ("torque", "velocity", "position", "disturbance", "nonlinear")
        useless = [key for key in keys if getattr(servo, key)][:1]
        if useless or servo.motor is None:
            text = (
                "servo: expected [servo.controller] with kp or crossover, or motor and load for the"
                " drive's figures"
            )
            raise JobError(text, key=("servo", *useless))
        return
    if servo.velocity is None:
        raise JobError(
            "servo: missing key 'velocity', the output of the velocity loop", key=("servo",)
        )
    if servo.torque is None and len(ports["input"]) > 1:
        names = ", ".join(map(repr, ports["input"]))
        raise JobError(f"servo: missing key 'torque': expected one of {names}", key=("servo",))
    for number, table in enumerate(servo.controller.notch):
        with key_path("servo", "controller", "notch", number):
            table.notch()
    with key_path("servo", "controller"):
        servo.controller.check()
    for number, each in enumerate(servo.nonlinear):
        with key_path("servo", "nonlinear", number):
            each.check()
