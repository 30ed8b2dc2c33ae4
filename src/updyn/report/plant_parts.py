"""The sections of the report on control, with their figures."""

from __future__ import annotations

from updyn.job.planted import Planted
from updyn.report.plant_figures import plant_figures
from updyn.report.plots import Figure
from updyn.report.sections_plant import plant_section

__all__ = ["plant_parts"]


def plant_parts(planted: Planted) -> tuple[list[tuple[str, str, str]], dict[str, Figure]]:
    """Return the sections, as `page_text` takes them, and their figures.

    Parameters
    ----------
    planted : Planted
        What was made.
    """
    figures = plant_figures(planted)
    return [("plant", "Plant", plant_section(planted, figures))], figures
