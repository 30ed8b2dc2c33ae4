"""docs/methods.md, section `modal`: its figures are computed here."""

from __future__ import annotations

import re
from statistics import median
from typing import Any

import numpy as np
import pytest

import updyn
from pages import ROOT
from updyn.model import Model

#: Biased methods leave a residual on purpose, whose causes other tests seek.
pytestmark = pytest.mark.usefixtures("no_causes")

TEXT = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
SENSORS = [f"{i}:X" for i in (2, 5, 7, 10, 12)]


def test_figures_of_the_chain(
    chain12: Model, chain12_true: Model, chain12_case: dict[str, Any], add_noise: Any
) -> None:
    true = chain12_case["true_factors"]
    start = chain12.scaled({"part1": {"mass": true["mass"][0]}})
    clean = updyn.response(
        chain12_true, np.linspace(0.5, 23.0, 160), SENSORS, ["2:X", "12:X"], "accelerance"
    )

    def worst(name: str, noise: float, seed: int) -> float:
        damped = {"loss_factor": "all"} if name == "maximum-likelihood" else {}
        unknowns = updyn.parameters(
            start, stiffness="all", mass=["part2", "part3", "part4"], **damped
        )
        data = add_noise(clean, np.random.default_rng(seed), noise) if noise else clean
        result = updyn.update(start, data, unknowns, method=name)
        assert result.status == "converged"
        factors = [p for p in unknowns if p.is_factor]
        return max(
            abs(result.values[p.name] - true[p.quantity][int(p.group[-1]) - 1]) for p in factors
        )

    rows = re.findall(
        r"^\| `([\w-]+)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$",
        TEXT.split("one mass held |")[1],
        re.MULTILINE,
    )
    assert [row[0] for row in rows[:2]] == ["modal", "maximum-likelihood"]
    for name, *said in rows[:2]:
        for noise, figure in zip((0.0, 0.01, 0.05), said, strict=True):
            found = median(worst(name, noise, seed) for seed in range(3 if noise else 1))
            if figure.strip().startswith("<"):
                assert found < float(figure.strip()[2:])
            else:
                assert found == pytest.approx(float(figure), rel=0.15), (name, noise)
