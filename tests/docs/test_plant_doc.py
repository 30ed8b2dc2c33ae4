"""The page on plants runs as it stands, and says the truth about what it prints."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from typing import Any

import pytest

from pages import ROOT, blocks, run_python
from updyn.control.job.tables import PlantTable

PAGE = ROOT / "docs/plant.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    pytest.importorskip("control")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("plant"))
        namespace: dict[str, Any] = {"__name__": "page"}
        ran = 0
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, "docs/plant.md", namespace)
                ran += 1
        assert ran == 11
        yield namespace


def test_the_plant_is_what_the_page_says(page: dict[str, Any]) -> None:
    plant = page["plant"]
    assert f"print(plant)  # {plant!r}" in PAGE.read_text(encoding="utf-8")
    H = (
        page["updyn"]
        .response(page["result"].model, [5.0, 11.0, 30.0], ["1:RZ"], ["1:RZ"], "mobility")
        .values
    )
    G = plant.response([5.0, 11.0, 30.0]).values[:, :1]
    assert (
        abs(G - H).max()
        < 0.012
        * abs(
            page["updyn"]
            .response(
                page["result"].model,
                page["np"].linspace(2.0, 60.0, 2000),
                ["1:RZ"],
                ["1:RZ"],
                "mobility",
            )
            .values
        ).max()
    )


def test_the_orders_are_what_the_page_says(page: dict[str, Any]) -> None:
    assert f"print(orders)  # {page['orders']}" in PAGE.read_text(encoding="utf-8")


def test_a_mode_at_a_fraction_of_the_single_frequency_is_far_too_high(page: dict[str, Any]) -> None:
    by_name = {
        c.name: c
        for c in page["updyn"].conversions(page["result"], ["1:RZ"], ["3:RZ"], (2.0, 60.0))
    }
    assert by_name["single-frequency"].peak_error > 0.3 > 10 * by_name["modal"].error


def test_the_family_is_as_the_page_says(page: dict[str, Any]) -> None:
    assert len(page["family"]) == 10
    assert (page["lowest"] < page["highest"]).all()
    assert page["family"].error < 0.02
    assert len(page["poles"]) == page["servo_plant"].n_states


def test_the_causal_error_is_below_that_of_the_plant(page: dict[str, Any]) -> None:
    plant = page["plant"]
    assert 0.0 < plant.facts["causal error"] < plant.relative_error


def test_the_job_is_read() -> None:
    (block,) = [b for b in blocks(PAGE) if b.language == "toml"]
    table = PlantTable.model_validate(tomllib.loads(block.text)["plant"])
    assert [p.name for p in table.input_ports] == ["drive", "wind"]
    assert table.family == 20


def test_the_random_controllers_are_those_of_the_benchmark() -> None:
    own = PAGE.read_text(encoding="utf-8").splitlines()
    readme = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8").splitlines()
    rows = {line.split("|")[2].strip(): line for line in own if line.startswith(("| 2 %", "| 1 %"))}
    assert len(rows) == 3
    there = [line for line in readme if line.startswith(("| peak, ", "| relative, "))]
    for states, row in rows.items():
        (other,) = [line for line in there if line.split("|")[2].strip() == states]
        cells = [c.strip() for c in other.strip("|").split("|")]
        _, _, *figures, within = [c.strip() for c in row.strip("|").split("|")]
        assert [f.removesuffix(" %") for f in figures] == cells[3:6]
        beyond = int(cells[6].split()[0])
        assert within == ("all" if not beyond else f"{20 - beyond} of 20")


def test_the_table_is_that_of_the_benchmark() -> None:
    own = PAGE.read_text(encoding="utf-8")
    readme = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
    rows = [
        line
        for line in own.splitlines()
        if line.startswith(("| chain, ", "| gear train, ", "| antenna, "))
    ]
    assert len(rows) == 5
    for row in rows:
        name, *cells = [c.strip() for c in row.strip("|").split("|")]
        (there,) = [
            line for line in readme.splitlines() if line.startswith(f"| {name} |") and " / " in line
        ]
        assert cells == [c.split("(")[0].strip() for c in there.strip("|").split("|")[1:]], name
