"""``[servo]`` of a job: loop, figures of the drive, backlash and friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from updyn.control.build import plant as build
from updyn.control.family import PlantFamily
from updyn.control.job.settings import CYCLE_SIMULATION
from updyn.control.job.tables import NonlinearTable, ServoTable
from updyn.control.nonlinear.balance import LimitCycle, LimitCycles, limit_cycles
from updyn.control.nonlinear.nonlinearity import Nonlinearity
from updyn.control.nonlinear.opened import opened
from updyn.control.nonlinear.settings import LOOP_SIMULATION
from updyn.control.nonlinear.simulate import Simulation, simulate
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.drive import DriveFigures, drive_figures
from updyn.control.servo.record import Servo
from updyn.control.servo.servo import servo
from updyn.errors import UpdynError, key_path
from updyn.job.schema import Job
from updyn.model import Model
from updyn.nonlinear.friction import CoulombFriction

__all__ = [
    "Nonlinear",
    "job_drive",
    "job_nonlinear",
    "job_servo",
]


def job_drive(job: Job, model: Model, band: tuple[float, float]) -> DriveFigures | None:
    """Return the figures of the drive; None if the job names no motor and load."""
    table = job.table(ServoTable)
    if table is None or table.motor is None or table.load is None:
        return None
    with key_path("servo"):
        return drive_figures(model, table.motor, table.load, ratio=table.ratio, band=band)


def job_servo(job: Job, plant: Plant | PlantFamily, sampled: Plant | None = None) -> Servo | None:
    """Return the servo on a plant or its family; None if the job has no controller."""
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
    """Limit cycles by harmonic balance, and simulation, of a loop with backlash or friction.

    `kind` is ``"backlash"`` or ``"friction"``, with the parameters `law`. `where`, its place, and
    `begun`, the initial state, are in words; `note` is the reason for a missing simulation.
    """

    kind: str
    where: str
    law: Nonlinearity
    cycles: LimitCycles
    simulation: Simulation | None
    begun: str
    note: str = ""

    @property
    def disagreement(self) -> str:
        """A sentence if prediction and simulation disagree; else empty."""
        if self.simulation is None:
            return ""
        predicted = any(c.stable for c in self.cycles)
        verdict = self.simulation.verdict
        if predicted and verdict in ("decays", "at rest"):
            return (
                "The simulation does not confirm the predicted stable limit cycle: trust"
                " the simulation."
            )
        if verdict == "limit cycle" and not predicted:
            return "The simulation ends in a limit cycle that was not predicted."
        return ""

    def summary(self) -> str:
        """Return prediction and simulation as text."""
        parts = [f"{self.kind.capitalize()} {self.where}", self.cycles.summary()]
        if self.simulation is not None:
            parts.append(f"In time, {self.begun}: {self.simulation.summary()}")
        return "\n".join(filter(None, [*parts, self.disagreement, self.note]))


def job_nonlinear(job: Job, model: Model, plant: Plant, servo: Servo) -> tuple[Nonlinear, ...]:
    """Return limit cycles and simulation for each ``[[servo.nonlinear]]`` of a job."""
    servo_table = job.table(ServoTable)
    out = []
    if servo_table is None:
        return ()
    for number, table in enumerate(servo_table.nonlinear):
        with key_path("servo", "nonlinear", number):
            out.append(_judge_nonlinear(job, table, model, plant, servo))
    return tuple(out)


def _judge_nonlinear(
    job: Job, table: NonlinearTable, model: Model, plant: Plant, servo: Servo
) -> Nonlinear:
    loop: dict[str, Any] = {
        "torque": servo.torque,
        "velocity": servo.velocity,
        "position": servo.position,
    }
    name = _unused_name(table.kind, plant)
    if table.kind == "friction":
        assert table.level is not None
        law: Nonlinearity = CoulombFriction(table.level, table.breakaway)
        extended = _extend_plant(job, model, plant, servo, Port.at(table.at, name), "mobility")
        cycles = limit_cycles(extended, servo.controller, law, name, **loop)
        where = f"at {table.at}"
    else:
        assert table.mesh is not None
        assert table.gap is not None
        gap = opened(model, table.mesh, table.at, name=name)
        extended = _extend_plant(job, gap.model, plant, servo, gap.port, "receptance")
        frequency = table.frequency or servo.velocity_loop.margins.crossover or plant.band[1]
        law = gap.backlash(table.gap, frequency=frequency)
        cycles = limit_cycles(extended, servo.controller, law, name, **loop)
        found = _largest_stable_cycle(cycles)
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
    simulation, begun, note = _simulate(table, extended, servo, law, cycles, name, loop)
    return Nonlinear(table.kind, where, law, cycles, simulation, begun, note)


def _unused_name(name: str, plant: Plant) -> str:
    while name in (*plant.inputs, *plant.outputs):
        name += "'"
    return name


def _extend_plant(
    job: Job, model: Model, plant: Plant, servo: Servo, port: Port, quantity: str
) -> Plant:
    """Return the plant of the loop with an additional input and output at the nonlinearity."""
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
        error="peak",  # modes of the structure itself: a contact must not cause a jump of its twist
        backend=job.method.backend,
    )


def _largest_stable_cycle(cycles: LimitCycles) -> LimitCycle | None:
    """Return the stable cycle with the largest amplitude; a doubtful one only without others."""
    stable = [c for c in cycles if c.stable]
    return max(stable, key=lambda c: (not c.doubt, c.amplitude), default=None)


def _simulate(
    table: NonlinearTable,
    plant: Plant,
    servo: Servo,
    law: Nonlinearity,
    cycles: LimitCycles,
    name: str,
    loop: dict[str, Any],
) -> tuple[Simulation | None, str, str]:
    """Return the simulation, its initial state in words, and a note if it is missing."""
    found = _largest_stable_cycle(cycles)
    if found is None and not cycles.linear_stable:
        note = "Not simulated: the linear loop is unstable, and no stable limit cycle is predicted."
        return None, "", note
    how: dict[str, Any]
    if found is not None:
        how = {"start": found, "scale": CYCLE_SIMULATION.start_factor}
        begun = (
            f"from {CYCLE_SIMULATION.start_factor:g} times the stable cycle at"
            f" {found.frequency:.4g} Hz"
        )
        lasting = CYCLE_SIMULATION.cycle_periods / found.frequency
    else:
        size = 1.0
        if servo.step is not None:
            size = servo.step.size
        how = {"constant": {"reference": size}}
        begun = "after a step of the reference"
        outer = servo.loops[-1].margins.crossover
        lasting = CYCLE_SIMULATION.settling_periods / min(
            servo.bandwidth or plant.band[1], outer or plant.band[1]
        )
    # Each step is exact; only a contact that begins and ends within one step is missed.
    step = 1.0 / (LOOP_SIMULATION.steps_per_period * plant.band[1])
    duration = table.duration or min(lasting, CYCLE_SIMULATION.most_steps * step)
    try:
        done = simulate(plant, servo.controller, law, duration, name, step=step, **how, **loop)
    except UpdynError as error:
        return None, "", f"Not simulated: {error}"
    return done, begun, ""
