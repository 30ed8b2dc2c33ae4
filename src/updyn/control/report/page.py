"""`write_plant_page`: the plant of a job as a self-contained HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.control.job.messages import describe_plant_size
from updyn.control.job.plant_result import PlantResult
from updyn.control.report.plant import (
    bode_name,
    channel_name,
    channels,
    judge_plant,
    plant_figures,
)
from updyn.control.report.servo import first_margins, most_critical, servo_figures
from updyn.control.servo.verdict import judge_servo
from updyn.report.page import assemble
from updyn.report.section import PageContent
from updyn.report.templates import render_template, write_page

__all__ = ["write_plant_page"]


#: Parts of the first screen that a plant may lack.
_EMPTY: dict[str, object] = {
    "margins": None,
    "size": "",
    "shown": "",
    "heading": "",
    "caption": "",
    "figures": {},
}


def write_plant_page(result: PlantResult, path: str | PathLike[str]) -> Path:
    """Write a plant as a self-contained HTML page, atomically; return its path."""
    return write_page(render(result), path)


def render(result: PlantResult) -> str:
    """Return the page as text."""
    content = PageContent(further={"plant": result})
    parts = {**_EMPTY, **_first_screen(result)}
    head = render_template("updyn.control.report/head.html", result=result, **parts)
    return assemble(content, head, f"{result.title}: plant", __version__)


def _first_screen(result: PlantResult) -> dict[str, object]:
    """Return the variables of the first screen: the verdict and a Bode diagram."""
    state = [] if result.updated else [result.source]
    plant = result.plant
    verdict = judge_plant(result)
    shown = {"kind": verdict.kind, "text": verdict.text}
    if plant is None:
        return {**shown, "reasons": [result.message, *state]}
    size = describe_plant_size(result)
    if result.servo is not None:
        loop = most_critical(result.servo)
        return {
            **shown,
            "reasons": [*judge_servo(result.servo).reasons, *state],
            "margins": first_margins(result.servo),
            "size": size,
            "shown": f"bode-{loop.name}",
            "heading": f"Bode diagram of the {loop.name} loop",
            "figures": servo_figures(result.servo, plant),
        }
    i, j = max(channels(result), key=lambda at: result.channel_errors(result.measure)[at])
    return {
        **shown,
        "reasons": state,
        "size": size,
        "shown": bode_name(i, j),
        "heading": channel_name(plant, i, j),
        "caption": "The channel with the largest error.",
        "figures": plant_figures(result),
    }
