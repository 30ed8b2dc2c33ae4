"""The gallery of the manual, whose figures are drawn by every build."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Common code of all figures: the demo chain of twelve masses, updated to its measurement.
SETUP = """\
import tempfile
from pathlib import Path

import numpy as np
import updyn
from updyn import plots
from updyn.demos import find_demo

with tempfile.TemporaryDirectory() as folder:
    find_demo("chain").write_inputs(Path(folder))
    model = updyn.read_model(Path(folder) / "chain.h5")
    test = updyn.read_frf(Path(folder) / "chain.uff")
unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
result = updyn.update(model, test, unknowns, validation=["7:X"])
modes = updyn.identify_modes(test)


def computed(model):
    lines = np.linspace(test.freq[0], test.freq[-1], 1200)
    return updyn.response(model, lines, test.responses, test.references, test.quantity)
"""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with its title, its code, and the page that describes it."""

    name: str
    title: str
    code: str
    page: str


PICTURES = (
    Picture(
        "overlay",
        "Measured, before and after",
        'plots.overlay(test["12:X", "12:X"], computed(model), computed(result.model))',
        "plots.md",
    ),
    Picture(
        "parameters",
        "Changes of the unknowns, with 95 % intervals",
        "plots.parameters(result)",
        "uncertainty.md",
    ),
    Picture(
        "identifiability",
        "Identifiability",
        "plots.identifiability(result)",
        "verdict.md",
    ),
    Picture(
        "frac-before",
        "FRAC of every channel, before",
        "plots.frac(updyn.correlate(model, test))",
        "method.md",
    ),
    Picture(
        "stabilisation",
        "Modes from the measurement",
        "plots.stabilisation(modes, test)",
        "modes.md",
    ),
    Picture(
        "synthesis",
        "FRF synthesised from the modes",
        "plots.synthesis(modes, test)",
        "modes.md",
    ),
    Picture(
        "mac-before",
        "Modes of model and test, before",
        "plots.mac(updyn.correlate(model, modes))",
        "modes.md",
    ),
    Picture(
        "plant",
        "A plant for control design",
        'plots.plant(updyn.plant(result, ["12:X"], ["12:X"], band=(0.5, 12), quantity="mobility"))',
        "plant.md",
    ),
)


def write(folder: Path) -> None:
    """Draw the figures and write their page.

    Parameters
    ----------
    folder : Path
        Below docs/site/.
    """
    there = folder / "gallery"
    there.mkdir(parents=True, exist_ok=True)
    names: dict[str, Any] = {}
    exec(SETUP, names)
    for picture in PICTURES:
        figure = eval(picture.code, names)
        figure.savefig(there / f"{picture.name}.png", dpi=110)
    (folder / "gallery.md").write_text(page(), encoding="utf-8")


def page() -> str:
    """Return the page, in MyST."""
    lines = [
        "# Gallery",
        "",
        "Each figure is drawn by the line below it when the manual is built; the common code is at",
        "the end. The notebooks have more figures and check their numbers:",
        "[gear train](../../notebooks/gear-train.md),",
        "[noise and data](../../notebooks/noise-and-data.md) and",
        "[look](../../notebooks/look.md), the last with the viewer in three dimensions.",
    ]
    for picture in PICTURES:
        lines += ["", f"## {picture.title}", ""]
        lines += [f"![{picture.title}](gallery/{picture.name}.png)", ""]
        lines += [
            "```python",
            picture.code,
            "```",
            "",
            f"See [{picture.page}](../../{picture.page}).",
        ]
    lines += ["", "## Common code", "", "```python", SETUP.rstrip(), "```"]
    return "\n".join(lines) + "\n"
