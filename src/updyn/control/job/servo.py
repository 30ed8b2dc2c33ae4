"""``[servo]`` of a job: loop, figures of the drive, backlash and friction."""

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
#: Periods of a limit cycle that are simulated where the job states no duration.
_PERIODS = 40
#: The same without a limit cycle, in periods of the bandwidth.
_SETTLING = 6
#: Amplitude at which a simulation begins, over that of the limit cycle.
_OUTSIDE = 1.2
#: Steps in a period of the band's upper end.
_STEPS = 40
#: Largest number of steps where the job states no duration.
_MOST = 300_000


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
        If they cannot be computed, with the line.
    """
    table = job.table(ServoTable)
    if table is None or table.motor is None or table.load is None:
        return None
    with key_path("servo"):
        return drive_figures(model, table.motor, table.load, ratio=table.ratio, band=band)


def servo_of(job: Job, plant: Plant | PlantFamily, sampled: Plant | None = None) -> Servo | None:
    """Return the servo on a plant, or on its family; None where the job has no controller.

    Parameters
    ----------
    job : Job
        The job.
    plant : Plant or PlantFamily
        Continuous.
    sampled : Plant, optional
        The nominal one, sampled with its delay.

    Raises
    ------
    JobError
        If the controller does not fit the plant, with the line.
    """
    table = job.table(ServoTable)
    if table is None or table.controller is None:
        return None
    nominal = plant.nominal if isinstance(plant, PlantFamily) else plant
    torque = table.torque or nominal.inputs[0]
    assert table.velocity is not None
    with key_path("servo", "controller"):
        controller = table.controller.controller(nominal, torque, table.velocity, table.position)
    with key_path("servo"):
        return servo(
            plant,
            controller,
            torque=torque,
            velocity=table.velocity,
            position=table.position,
            disturbance=table.disturbance,
            pointing=table.pointing,
            step=table.step,
            disturbance_step=table.disturbance_step,
            wind=None if table.wind is None else table.wind.wind(),
            duration=table.duration,
            sampled=sampled,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Nonlinear:
    """A loop with one nonlinearity.

    Attributes
    ----------
    kind : {"backlash", "friction"}
        The kind of nonlinearity.
    where : str
        Its place, in words.
    law : Backlash or CoulombFriction
        Its parameters.
    cycles : LimitCycles
        Limit cycles by harmonic balance.
    simulation : Simulation or None
        The simulated loop.
    begun : str
        Initial state of the simulation, in words.
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
        """A sentence where prediction and simulation disagree; empty where they agree."""
        if self.simulation is None:
            return ""
        predicted = any(c.stable for c in self.cycles)
        verdict = self.simulation.verdict
        if predicted and verdict in ("decays", "at rest"):
            return (
                "The simulation does not confirm the stable limit cycle that is predicted: trust"
                " the simulation."
            )
        if verdict == "limit cycle" and not predicted:
            return "The simulation ends in a limit cycle that is not predicted."
        return ""

    def summary(self) -> str:
        """Return prediction and simulation as text."""
        parts = [f"{self.kind.capitalize()} {self.where}", self.cycles.summary()]
        if self.simulation is not None:
            parts.append(f"In time, {self.begun}: {self.simulation.summary()}")
        return "\n".join(filter(None, [*parts, self.disputed, self.note]))


def nonlinear_of(job: Job, model: Model, plant: Plant, servo: Servo) -> tuple[Nonlinear, ...]:
    """Return limit cycles and simulation for each ``[[servo.nonlinear]]`` of a job.

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
        If a mesh cannot be opened, no plant holds the tolerance with it, or a number is out of its
        range, with the line.
    """
    servo_table = job.table(ServoTable)
    out = []
    if servo_table is None:
        return ()
    for number, table in enumerate(servo_table.nonlinear):
        with key_path("servo", "nonlinear", number):
            out.append(_one(job, table, model, plant, servo))
    return tuple(out)


def _one(job: Job, table: NonlinearTable, model: Model, plant: Plant, servo: Servo) -> Nonlinear:
    loop: dict[str, Any] = {
        "torque": servo.torque,
        "velocity": servo.velocity,
        "position": servo.position,
    }
    name = _unused(table.kind, plant)
    if table.kind == "friction":
        assert table.level is not None
        law: Nonlinearity = CoulombFriction(table.level, table.breakaway)
        extended = _extended(job, model, plant, servo, Port.at(table.at, name), "mobility")
        cycles = limit_cycles(extended, servo.controller, law, name, **loop)
        where = f"at {table.at}"
    else:
        assert table.mesh is not None
        assert table.gap is not None
        gap = opened(model, table.mesh, table.at, name=name)
        extended = _extended(job, gap.model, plant, servo, gap.port, "receptance")
        frequency = table.frequency or servo.velocity_loop.margins.crossover or plant.band[1]
        law = gap.backlash(table.gap, frequency=frequency)
        cycles = limit_cycles(extended, servo.controller, law, name, **loop)
        found = _largest(cycles)
        lossy = bool(gap.group.loss_factor)
        if table.frequency is None and found is not None and lossy:
            # The damper equivalent to the loss factor depends on the frequency of the cycle.
            frequency = found.frequency
            law = gap.backlash(table.gap, frequency=frequency)
            cycles = limit_cycles(extended, servo.controller, law, name, **loop)
        unit = "rad" if gap.port.rotation else "m"
        where = f"in {table.mesh!r}, {table.gap:g} {unit} at {table.at}"
        if lossy:
            where += f"; its loss factor as a damper at {frequency:.4g} Hz"
    simulation, begun, note = _in_time(table, extended, servo, law, cycles, name, loop)
    return Nonlinear(table.kind, where, law, cycles, simulation, begun, note)


def _unused(name: str, plant: Plant) -> str:
    while name in (*plant.inputs, *plant.outputs):
        name += "'"
    return name


def _extended(
    job: Job, model: Model, plant: Plant, servo: Servo, port: Port, quantity: str
) -> Plant:
    """Return the plant of the loop with an input and output where the nonlinearity acts."""
    outputs, quantities = [], []
    for name in dict.fromkeys((servo.velocity, servo.position)):
        if name is not None:
            at = plant.outputs.index(name)
            outputs.append(plant.output_ports[at])
            quantities.append(plant.quantities[at])
    return build(
        model,
        [plant.input_ports[plant.inputs.index(servo.torque)], port],
        [*outputs, port],
        plant.band,
        plant.tolerance,
        quantity=[*quantities, quantity],
        error="peak",  # of the structure's own modes: a contact must not meet a jump of its twist
        backend=job.method.backend,
    )


def _largest(cycles: LimitCycles) -> LimitCycle | None:
    """Return the stable cycle of the largest amplitude; one in doubt only if there is no other."""
    stable = [c for c in cycles if c.stable]
    return max(stable, key=lambda c: (not c.doubt, c.amplitude), default=None)


def _in_time(
    table: NonlinearTable,
    plant: Plant,
    servo: Servo,
    law: Nonlinearity,
    cycles: LimitCycles,
    name: str,
    loop: dict[str, Any],
) -> tuple[Simulation | None, str, str]:
    """Return the simulation, its initial state in words, and a note where there is none."""
    found = _largest(cycles)
    if found is None and not cycles.linear_stable:
        note = (
            "It is not simulated: the loop is unstable without it, and no stable limit cycle is"
            " predicted."
        )
        return None, "", note
    how: dict[str, Any]
    if found is not None:
        how = {"start": found, "scale": _OUTSIDE}
        begun = f"from {_OUTSIDE:g} times the stable cycle at {found.frequency:.4g} Hz"
        lasting = _PERIODS / found.frequency
    else:
        size = 1.0
        if servo.step is not None:
            size = servo.step.size
        how = {"constant": {"reference": size}}
        begun = "after a step of the reference"
        outer = servo.loops[-1].margins.crossover
        lasting = _SETTLING / min(servo.bandwidth or plant.band[1], outer or plant.band[1])
    # Each step is exact; only a contact that begins and ends within one step would be missed.
    step = 1.0 / (_STEPS * plant.band[1])
    duration = table.duration or min(lasting, _MOST * step)
    try:
        done = simulate(plant, servo.controller, law, duration, name, step=step, **how, **loop)
    except UpdynError as error:
        return None, "", f"It is not simulated: {error}"
    return done, begun, ""
