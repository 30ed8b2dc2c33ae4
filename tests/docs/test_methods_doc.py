"""docs/methods.md: the figures of its tables are computed here; each method has its section."""

from __future__ import annotations

import re
from statistics import median

import numpy as np
import pytest

import updyn
from pages import ROOT
from updyn.demos.gear_train import starting_model, true_model, true_values
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.methods import METHODS, options_of

#: Biased methods leave a residual on purpose, whose causes other tests seek.
pytestmark = pytest.mark.usefixtures("no_causes")

TEXT = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
CLASSICAL = ("rfm", "complex-rfm", "frf-sensitivity", "reduced-frf")
#: As the tables are made: plain iterations that would not arrive are helped by their own options.
OPTIONS: dict[str, dict[str, object]] = {
    "frf-sensitivity": {"halving": True},
    "reduced-frf": {"separate": False},
}


def section(name: str) -> str:
    found = re.search(rf"^## `{name}`$(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    assert found is not None, name
    return " ".join(found[1].split())


def table(heading: str) -> dict[str, list[str]]:
    """Return the rows of the table whose first column is called so, by the method in it."""
    (found,) = re.findall(
        rf"^\| {re.escape(heading)} \|.*\n\|[-|]+\n((?:\|.*\n)+)", TEXT, re.MULTILINE
    )
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in found.splitlines()]
    return {re.sub(r"[`,].*", "", row[0].lstrip("`")): row[1:] for row in rows}


def worst(
    start: Model, true: Model, data: FRF, name: str, **options: object
) -> tuple[float, float]:
    """Return the largest error of a factor, and the largest over its standard deviation."""
    cannot = METHODS.find(name).cannot
    wanted = {q: "all" for q in ("stiffness", "mass", "loss_factor") if q not in cannot}
    chosen = updyn.parameters(start, **wanted)
    result = updyn.update(start, data, chosen, method=name, **options)
    error = np.array([
        result.values[p.name] - (
            true.group(p.group).loss_factor if p.quantity == "loss_factor"
            else abs(getattr(true.group(p.group), p.quantity)).sum()
            / abs(getattr(start.group(p.group), p.quantity)).sum()
        )
        for p in chosen
    ])  # fmt: skip
    own = np.abs(error) / np.array([result.std[p.name] for p in chosen])
    return float(np.abs(error[chosen.is_factor]).max()), float(own.max())


def everywhere(true: Model, frf: FRF) -> FRF:
    return updyn.response(
        true, frf.freq[::2], [f"{i}:X" for i in range(1, 13)], ["2:X", "5:X", "12:X"]
    )


@pytest.fixture(scope="module")
def starts(chain12: Model, chain12_true: Model) -> dict[str, Model]:
    right = chain12.scaled(
        {g: {"loss_factor": chain12_true.group(g).loss_factor} for g in chain12.groups}
    )
    return {"rfm": right} | dict.fromkeys((*CLASSICAL[1:], "maximum-likelihood"), chain12)


@pytest.mark.parametrize("name", CLASSICAL)
def test_each_has_a_section_with_its_options_and_its_source(name: str) -> None:
    text = section(name)
    for option in options_of(name):
        assert option in ("max_iterations", "tolerance", "solver") or f"`{option}" in text, option
    author = METHODS.find(name).reference.split(",")[0].split(";")[0].split(" ")[0]
    assert author in text


def test_methods_of_the_overview_exist() -> None:
    assert set(table("method")) <= set(METHODS)
    assert set(table("method")) >= set(CLASSICAL)


def test_figures_with_every_degree_of_freedom_measured(
    chain12_true: Model, chain12_frf: FRF, starts: dict[str, Model], add_noise
) -> None:
    clean = updyn.response(
        chain12_true,
        chain12_frf.freq[::2],
        [f"{i}:X" for i in range(1, 13)],
        ["2:X", "5:X", "12:X"],
    )
    rows = table("12 of 12 measured")
    assert set(rows) == set(starts)
    for name, (exact, noisy, own) in rows.items():
        options = OPTIONS.get(name, {})
        assert worst(starts[name], chain12_true, clean, name, **options)[0] < float(
            exact.removeprefix("< ")
        )
        found = [
            worst(
                starts[name],
                chain12_true,
                add_noise(clean, np.random.default_rng(s), 0.01),
                name,
                **options,
            )
            for s in range(3)
        ]
        assert f"{float(f'{median(f[0] for f in found):.1g}'):g}" == noisy, name
        assert f"{float(f'{median(f[1] for f in found):.1g}'):g}" == own, name


def test_figures_with_five_of_twelve_measured(
    chain12_true: Model, chain12_frf: FRF, starts: dict[str, Model]
) -> None:
    rows = table("5 of 12 measured, no noise")
    for name, (said,) in rows.items():
        options = OPTIONS.get(name, {}) | ({"expand": True} if "rfm" in name else {})
        error = worst(starts[name], chain12_true, chain12_frf, name, **options)[0]
        assert error < float(said[2:]) if said.startswith("< ") else f"{error:.2g}" == said, (
            name,
            error,
        )


def test_wrong_loss_factors_go_into_the_unknowns_of_rfm(
    chain12: Model, chain12_true: Model, chain12_frf: FRF
) -> None:
    assert {g.loss_factor for g in chain12.groups.values()} == {0.03}
    assert {g.loss_factor for g in chain12_true.groups.values()} == {0.02, 0.03, 0.04, 0.05}
    error, _ = worst(chain12, chain12_true, everywhere(chain12_true, chain12_frf), "rfm")
    assert f"up to {100 * error:.1g} % on the chain" in section("rfm")


def test_steps_on_the_gear_train() -> None:
    for reading in (0, 1):
        start, true = starting_model(reading), true_model()
        unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
        eight = np.array([5, 10, 20, 30, 50, 75, 100, 150]) / (2 * np.pi)
        data = updyn.response(true, eight, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
        found = updyn.update(start, data, unknowns, method="complex-rfm", expand=True)
        assert found.status == "converged"
        # Steps from the sixth on are rounding: their number depends on the processor.
        assert 6 <= found.iterations <= 12
        assert found.values == pytest.approx(true_values(reading), rel=1e-6, abs=1e-6)
    assert "all 18 in about eight steps" in section("complex-rfm")
