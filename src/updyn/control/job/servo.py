"""``[servo]`` of a job: the controller on its plant, and the figures of the drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

from updyn.control.job.servo_tables import ServoTable
from updyn.errors import key_path
from updyn.job.schema import Job
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.control.family import PlantFamily
    from updyn.control.plant import Plant
    from updyn.control.servo.drive_figures import DriveFigures
    from updyn.control.servo.record import Servo

__all__ = ["drive_of", "servo_of"]


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
    from updyn.control.servo.drive import drive_figures

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
    from updyn.control.family import PlantFamily
    from updyn.control.servo.servo import servo

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
