"""The antenna demo with the plant of its azimuth axis and a servo on it.

Model, measurements and update are those of `updyn.demos.antenna`. The controller is designed from
the drawings: a crossover of 7 Hz from the inertia, and a notch at the resonance of torque to motor
speed, 9.55 Hz, as narrow as the drawings permit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from updyn.control.build import plant
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.controller import Controller, Notch
from updyn.control.servo.margins import Margins
from updyn.control.servo.record import Servo
from updyn.control.servo.servo import servo
from updyn.demos import antenna
from updyn.demos.antenna import headline
from updyn.demos.antenna_model import AZIMUTH, NODES
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.updating.result import JointResult

__all__ = [
    "BAND",
    "CONTROLLER",
    "FIGURES",
    "azimuth_plant",
    "azimuth_servo",
    "epilogue",
    "headline",
    "job_tables",
    "margins_table",
    "write_inputs",
]

MOTOR, TURNTABLE, HUB = f"{AZIMUTH['motor']}:RZ", f"{NODES['turntable']}:RZ", f"{NODES['hub']}:RZ"
RATIO = -800.0  # the ring turns the other way
BAND = (0.5, 62.0)  # Hz
INPUTS = (Port.geared(MOTOR, RATIO, "torque"), Port.at(HUB, "wind"))
OUTPUTS = (Port.geared(MOTOR, RATIO, "speed"), Port.at(TURNTABLE, "azimuth"), Port.at(HUB, "dish"))
QUANTITIES = ("mobility", "receptance", "receptance")

CONTROLLER = Controller(
    kp=1.05e5,  # N m s/rad at the load
    ti=0.136,
    kv=5.5,
    notches=(Notch.of_width(9.55, width=1.9, depth=0.05),),
    low_pass=60.0,
    dead_time=0.0025,
)

#: Figures of each loop in a table of margins: name, unit, attribute of `Margins`.
FIGURES = (
    ("crossover", "Hz", "crossover"),
    ("phase margin", "deg", "phase_margin"),
    ("gain margin", "dB", "gain_margin_db"),
    ("modulus margin", "", "modulus_margin"),
)


def write_inputs(folder: Path) -> Path:
    """Write model, measurements and a job with ``[plant]`` and ``[servo]``; return its path."""
    job = antenna.write_inputs(folder)
    text = job.read_text(encoding="utf-8")
    job.write_text(f"{text}\n{job_tables()}", encoding="utf-8")
    return job


def epilogue(results: Sequence[JointResult], folder: Path) -> str:
    """Return a comparison with the true values: parameters, frequencies, margins of the servo."""
    one = results[-1].results["rotors free"]
    models = {"drawings": one.start, "updated": one.model, "true": one.start.scaled(antenna.TRUTH)}
    heading = "Azimuth servo, its controller set from the drawings:"
    return f"{antenna.epilogue(results, folder)}\n\n{heading}\n{margins_table(models)}"


def azimuth_plant(model: Model) -> Plant:
    """Return the plant of the azimuth axis of the antenna with free rotors.

    Inputs: motor torque, referred to the load, and wind torque at the hub, in N m. Outputs: motor
    speed, referred to the load, in rad/s, and the angles of turntable and hub in rad.
    """
    return plant(model, INPUTS, OUTPUTS, BAND, quantity=QUANTITIES, error="peak")


def azimuth_servo(azimuth: Plant, controller: Controller = CONTROLLER) -> Servo:
    """Return the servo of a plant of `azimuth_plant`, without time responses."""
    return servo(
        azimuth,
        controller,
        torque="torque",
        velocity="speed",
        position="azimuth",
        disturbance="wind",
        pointing="dish",
        step=None,
        disturbance_step=None,
    )


def margins_table(models: Mapping[str, Model]) -> str:
    """Return the margins of the controller on several models, by the heading of their column."""
    found = {name: azimuth_servo(azimuth_plant(model)) for name, model in models.items()}
    lines = [f"{'':<34}" + "".join(f"{name:>10}" for name in found)]
    for at, loop in enumerate(("velocity", "position")):
        for what, unit, attribute in FIGURES:
            label = f"{loop} loop, {what}{f' in {unit}' if unit else ''}"
            lines.append(
                f"{label:<34}"
                + "".join(_cell(s.loops[at].margins, attribute) for s in found.values())
            )
    return "\n".join(lines)


def _cell(margins: Margins, attribute: str) -> str:
    value = getattr(margins, attribute)
    return f"{'unstable' if not margins.stable else '-' if value is None else f'{value:.3f}':>10}"


def job_tables() -> str:
    """Return the tables of a job for this plant and controller."""
    (notch,) = CONTROLLER.notches
    inputs = (
        f'{{ name = "torque", dof = "{MOTOR}", ratio = {RATIO:g} }}',
        f'{{ name = "wind", dof = "{HUB}" }}',
    )
    return f"""\
[plant]  # the azimuth axis; torque and speed of the motor are counted at the load
inputs = [{", ".join(inputs)}]
quantity = ["{'", "'.join(QUANTITIES)}"]
band = [{BAND[0]:g}, {BAND[1]:g}]
test = "rotors free"
family = 5
error = "peak"

[[plant.outputs]]
name = "speed"
dof = "{MOTOR}"
ratio = {RATIO:g}

[[plant.outputs]]
name = "azimuth"  # encoder on the turntable
dof = "{TURNTABLE}"

[[plant.outputs]]
name = "dish"
dof = "{HUB}"

[servo]
torque = "torque"
velocity = "speed"
position = "azimuth"
disturbance = "wind"
pointing = "dish"
motor = "{MOTOR}"
load = "{TURNTABLE}"
ratio = {RATIO:g}

[servo.wind]
mean_speed = 12.0
coefficient = 3.0  # N m per (m/s)^2
roughness = 0.01

[servo.controller]  # set from the drawings
kp = {CONTROLLER.kp:g}
ti = {CONTROLLER.ti:g}
kv = {CONTROLLER.kv:g}
low_pass = {CONTROLLER.low_pass:g}
dead_time = {CONTROLLER.dead_time:g}

[[servo.controller.notch]]
frequency = {notch.frequency:g}
width = {notch.width:g}
depth = {notch.depth:g}
"""
