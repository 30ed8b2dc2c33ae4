"""`write_plant_page`: the plant of a job as a self-contained HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.control.job.plant_result import PlantResult
from updyn.report.page import assemble
from updyn.report.section import PageContent
from updyn.report.templates import render_template, write_page

__all__ = ["write_plant_page"]


def write_plant_page(result: PlantResult, path: str | PathLike[str]) -> Path:
    """Write a plant as a self-contained HTML page, atomically; return its path."""
    return write_page(render(result), path)


def render(result: PlantResult) -> str:
    """Return the page as text."""
    badge, kind = "Not updated", "warn"
    if not result.holds_tolerance:
        badge, kind = "Tolerance not met", "bad"
    elif result.updated:
        badge, kind = "Updated", "good"
    head = render_template("updyn.control.report/head.html", result=result, badge=badge, kind=kind)
    content = PageContent(further={"plant": result})
    return assemble(content, head, f"{result.title}: plant", __version__)
