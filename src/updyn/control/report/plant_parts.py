"""The sections of the report on control, with their figures."""

from __future__ import annotations

from updyn.control.job.plant_result import Planted
from updyn.control.report.nonlinear import nonlinear_figures
from updyn.control.report.plant_figures import plant_figures
from updyn.control.report.plant_sections import plant_section
from updyn.control.report.servo_figures import servo_figures
from updyn.control.report.servo_sections import servo_section
from updyn.report.plots import Figure

__all__ = ["plant_parts"]


def plant_parts(planted: Planted) -> tuple[list[tuple[str, str, str]], dict[str, Figure]]:
    """Return the sections, as `page_text` takes them, and their figures.

    Parameters
    ----------
    planted : Planted
        What was made.
    """
    figures = plant_figures(planted)
    if planted.servo is not None:
        plant = planted.plant
        assert plant is not None
        figures |= nonlinear_figures(planted.nonlinear)
        figures |= servo_figures(planted.servo, plant)
    made = [
        ("plant", "Plant", plant_section(planted, figures)),
        ("servo", "Servo", servo_section(planted, figures)),
    ]
    return [(anchor, name, text) for anchor, name, text in made if text], figures
