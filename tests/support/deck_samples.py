"""Input decks of the keyword family for tests: a cantilever bar of three materials, in bricks."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

needs_ccx = pytest.mark.needs("ccx")

MODULI = (2.1e11, 7.0e10, 1.1e11)
DENSITIES = (7850.0, 2700.0, 8900.0)
NAMES = ("Steel", "alu", "BRONZE")
STEP = ("*STEP", "*FREQUENCY", "10", "*END STEP")


def material(name: str, modulus: str, density: str, *more: str) -> list[str]:
    return [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{modulus}, 0.3", "*DENSITY", density, *more]


def bar(
    per_part: int = 2,
    unit: tuple[float, float, float] = (1.0, 1.0, 1.0),
    step: tuple[str, ...] = STEP,
) -> str:
    """Return a deck: 0.3 x 0.04 x 0.03 m along X, fixed at X = 0; `unit`: what m, Pa and kg/m3 are in its units."""
    metre, pascal, density = unit
    n = 3 * per_part
    number = {
        (i, j, k): 1 + k + 2 * (j + 3 * i) for i in range(n + 1) for j in range(3) for k in range(2)
    }
    lines = ["*HEADING", "Bar of three materials", "** a comment", "*NODE, NSET=Nall"]
    lines += [
        f"{at}, {0.3 * i / n * metre:.9g}, {0.02 * j * metre:.9g}, {0.03 * k * metre:.9g}"
        for (i, j, k), at in number.items()
    ]
    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 0, 1),
        (1, 1, 1),
        (0, 1, 1),
    ]
    element = 0
    for part in range(3):
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET=Part{part + 1}")
        for i in range(part * per_part, (part + 1) * per_part):
            for j in range(2):
                element += 1
                nodes = [number[i + a, j + b, c] for a, b, c in corners]
                lines.append(f"{element}, " + ", ".join(map(str, nodes)))
    for name, E, rho in zip(NAMES, MODULI, DENSITIES, strict=True):
        lines += material(name, f"{E * pascal:.10g}", f"{rho * density:.10g}")
    lines += [f"*Solid section, Elset=PART{i + 1}, Material={name}" for i, name in enumerate(NAMES)]
    lines += ["*NSET, NSET=Fixed, GENERATE", "1, 6, 1", "*BOUNDARY", "Fixed, 1, 3", *step]
    return "\n".join(lines) + "\n"


def own_frequencies(deck: Path) -> np.ndarray:
    """Run a deck with a *FREQUENCY step by the program itself; natural frequencies in Hz, as it prints them."""
    subprocess.run(
        ["ccx", deck.stem], cwd=deck.parent, check=True, capture_output=True, timeout=120
    )
    text = (
        deck.with_suffix(".dat").read_text(encoding="ascii").split("P A R T I C I P A T I O N")[0]
    )
    rows = re.findall(r"^ +\d+ +(\S+) +(\S+) +(\S+) +(\S+)$", text, re.MULTILINE)
    return np.array([float(row[2]) for row in rows])
