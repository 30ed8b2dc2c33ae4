"""``[servo]`` of a job: the controller on its plant, and the figures of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from updyn.control.build import plant as build
from updyn.control.family import PlantFamily
from updyn.control.job.tables import NonlinearTable, ServoTable
from updyn.control.nonlinear.balance import LimitCycle, LimitCycles, limit_cycles
from updyn.control.nonlinear.elements import CoulombFriction, Nonlinearity
from updyn.control.nonlinear.opened import opened
from updyn.control.nonlinear.simulate import Simulation, simulate
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.drive import DriveFigures, drive_figures
from updyn.control.servo.record import Servo
from updyn.control.servo.servo import servo
from updyn.errors import UpdynError, key_path
from updyn.job.schema import Job
from updyn.model import Model

__all__ = [
    "Nonlinear",
    "drive_of",
    "nonlinear_of",
    "servo_of",
]


def drive_of(job: Job, model: Model, band: tuple[float, float]) -> DriveFigures | None:
    """Return the figures of the drive; None where the job names no motor and load.

    Parameters
    ----------
    job : Job
        The job.
    model : Model
        The structure.
    band : (float, float)
        Of the plant, in Hz.

    Raises
    ------
    JobError
        If they cannot be had, with the line.
    """
    wish = job.table(ServoTable)
    if wish is None or wish.motor is None or wish.load is None:
        return None

    with key_path("servo"):
        return drive_figures(model, wish.motor, wish.load, ratio=wish.ratio, band=band)


def servo_of(job: Job, plant: Plant | PlantFamily) -> Servo | None:
    """Return the servo on a plant, or on its family; None where the job has no controller.

    Parameters
    ----------
    job : Job
        The job.
    plant : Plant or PlantFamily
        Continuous.

    Raises
    ------
    JobError
        If the controller cannot be put on it, with the line.
    """
    wish = job.table(ServoTable)
    if wish is None or wish.controller is None:
        return None

    nominal = plant.nominal if isinstance(plant, PlantFamily) else plant
    torque = nominal.inputs[0] if wish.torque is None else wish.torque
    assert wish.velocity is not None
    with key_path("servo", "controller"):
        controller = wish.controller.controller(nominal, torque, wish.velocity, wish.position)
    with key_path("servo"):
        return servo(
            plant,
            controller,
            torque=torque,
            velocity=wish.velocity,
            position=wish.position,
            disturbance=wish.disturbance,
            pointing=wish.pointing,
            step=wish.step,
            disturbance_step=wish.disturbance_step,
            wind=None if wish.wind is None else wish.wind.wind(),
            duration=wish.duration,
        )


#: Periods of a cycle, and of the bandwidth, that are simulated where the job does not say how long;
#: how far outside of the cycle it begins; steps in a period of the band's upper end, and in all
#: where the job does not say how long.
_PERIODS, _SETTLING, _OUTSIDE = 40, 6, 1.2
_STEPS, _MOST = 40, 300_000


@dataclass(frozen=True, slots=True, eq=False)
class Nonlinear:
    """A loop with one nonlinearity.

    Attributes
    ----------
    kind : {"backlash", "friction"}
        What acts.
    where : str
        In words.
    law : Backlash or CoulombFriction
        Its numbers.
    cycles : LimitCycles
        What harmonic balance predicts.
    simulation : Simulation or None
        The loop in time.
    begun : str
        From where it was simulated, in a sentence.
    note : str
        Why there is no simulation; empty where there is one.
    """

    kind: str
    where: str
    law: Nonlinearity
    cycles: LimitCycles
    simulation: Simulation | None
    begun: str
    note: str = ""

    @property
    def disputed(self) -> str:
        """What to know where prediction and simulation disagree, in a sentence; empty where they do not."""
        if self.simulation is None:
            return ""
        predicted, found = (
            any(c.stable for c in self.cycles),
            self.simulation.verdict == "limit cycle",
        )
        if predicted and self.simulation.verdict in ("decays", "at rest"):
            return (
                "The simulation does not confirm the stable limit cycle that is predicted: trust"
                " the simulation."
            )
        return (
            "The simulation ends in a limit cycle that is not predicted."
            if found and not predicted
            else ""
        )

    def summary(self) -> str:
        """Return prediction and simulation as text."""
        parts = [f"{self.kind.capitalize()} {self.where}", self.cycles.summary()]
        if self.simulation is not None:
            parts.append(f"In time, {self.begun}: {self.simulation.summary()}")
        return "\n".join([*parts, *(text for text in (self.disputed, self.note) if text)])


def nonlinear_of(job: Job, model: Model, plant: Plant, servo: Servo) -> tuple[Nonlinear, ...]:
    """Return what each ``[[servo.nonlinear]]`` of a job asks for.

    Parameters
    ----------
    job : Job
        The job.
    model : Model
        The structure.
    plant : Plant
        Its plant.
    servo : Servo
        The loop.

    Raises
    ------
    JobError
        If a mesh cannot be opened, a plant with it not be made, or a number not be used, with the
        line.
    """
    servo_table = job.table(ServoTable)
    tables = () if servo_table is None else servo_table.nonlinear
    return tuple(
        _one(job, number, table, model, plant, servo) for number, table in enumerate(tables)
    )


def _one(
    job: Job, number: int, table: NonlinearTable, model: Model, plant: Plant, servo: Servo
) -> Nonlinear:

    place = ("servo", "nonlinear", number)
    loop: dict[str, Any] = {
        "torque": servo.torque,
        "velocity": servo.velocity,
        "position": servo.position,
    }
    name = _unused(table.kind, plant)
    with key_path(*place):
        if table.kind == "friction":
            assert table.level is not None
            law: Nonlinearity = CoulombFriction(table.level, table.breakaway)
            with_it = _plant(job, model, plant, servo, Port.at(table.at, name), "mobility")
            cycles = limit_cycles(with_it, servo.controller, law, name, **loop)
            where = f"at {table.at}"
        else:
            assert table.mesh is not None
            assert table.gap is not None
            gap = opened(model, table.mesh, table.at, name=name)
            with_it = _plant(job, gap.model, plant, servo, gap.port, "receptance")
            frequency = table.frequency or servo.velocity_loop.margins.crossover or plant.band[1]
            law = gap.backlash(table.gap, frequency=frequency)
            cycles = limit_cycles(with_it, servo.controller, law, name, **loop)
            found = _largest(cycles)
            if table.frequency is None and found is not None and gap.group.loss_factor:
                # The damper that stands for the loss factor belongs to the frequency of the cycle
                # itself.
                frequency = found.frequency
                law = gap.backlash(table.gap, frequency=frequency)
                cycles = limit_cycles(with_it, servo.controller, law, name, **loop)
            lossy = (
                f"; its loss factor as a damper at {frequency:.4g} Hz"
                if gap.group.loss_factor
                else ""
            )
            where = (
                f"in {table.mesh!r}, {table.gap:g} {'rad' if gap.port.rotation else 'm'} at"
                f" {table.at}{lossy}"
            )
    simulation, begun, note = _in_time(table, with_it, servo, law, cycles, name, loop)
    return Nonlinear(table.kind, where, law, cycles, simulation, begun, note)


def _unused(name: str, plant: Plant) -> str:
    while name in (*plant.inputs, *plant.outputs):
        name += "'"
    return name


def _plant(job: Job, model: Model, plant: Plant, servo: Servo, port: Any, quantity: str) -> Plant:
    """Return the plant of the loop with one more pair of ports."""
    read = [name for name in dict.fromkeys((servo.velocity, servo.position)) if name is not None]
    at = [plant.outputs.index(name) for name in read]
    return build(
        model,
        [plant.input_ports[plant.inputs.index(servo.torque)], port],
        [*(plant.output_ports[i] for i in at), port],
        plant.band,
        plant.tolerance,
        quantity=[*(plant.quantities[i] for i in at), quantity],
        backend=job.method.backend,
    )


def _largest(cycles: LimitCycles) -> LimitCycle | None:
    """Return the stable cycle of the largest amplitude, of those that are not in doubt first; None without one."""
    return max(
        (c for c in cycles if c.stable), key=lambda c: (not c.doubt, c.amplitude), default=None
    )


def _in_time(
    table: NonlinearTable,
    plant: Plant,
    servo: Servo,
    law: Nonlinearity,
    cycles: LimitCycles,
    name: str,
    loop: dict[str, Any],
) -> tuple[Simulation | None, str, str]:
    """Return the loop in time, from where it began, and why it is not there."""
    found = _largest(cycles)
    if found is None and not cycles.linear_stable:
        return (
            None,
            "",
            (
                "It is not simulated: the loop is unstable without it, and no stable limit cycle is"
                " predicted."
            ),
        )
    how: dict[str, Any]
    if found is not None:
        how = {"start": found, "scale": _OUTSIDE}
        begun = f"from {_OUTSIDE:g} times the stable cycle at {found.frequency:.4g} Hz"
        lasting = _PERIODS / found.frequency
    else:
        how = {"constant": {"reference": servo.step.size if servo.step is not None else 1.0}}
        begun = "after a step of the reference"
        outer = servo.loops[-1].margins.crossover
        lasting = _SETTLING / min(servo.bandwidth or plant.band[1], outer or plant.band[1])
    # Each step is exact; only a contact that begins and ends within one would be missed.
    step = 1.0 / (_STEPS * plant.band[1])
    duration = table.duration or min(lasting, _MOST * step)
    try:
        return (
            simulate(plant, servo.controller, law, duration, name, step=step, **how, **loop),
            begun,
            "",
        )
    except UpdynError as error:
        return None, "", f"It is not simulated: {error}"
