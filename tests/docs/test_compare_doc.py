"""docs/compare.md: its tables and columns are those of its commands, its example runs."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

from cause_search import no_cause_search
from pages import ROOT, blocks, run_python
from updyn.cli import main
from updyn.comparison import Comparison
from updyn.comparison.table import COLUMNS
from updyn.updating.fit.methods import METHODS

PAGE = ROOT / "docs" / "compare.md"
TEXT = PAGE.read_text(encoding="utf-8")


def tool() -> Any:
    spec = importlib.util.spec_from_file_location(
        "make_compare_doc", ROOT / "tools" / "make_compare_doc.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKE = tool()


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Comparison]:
    with no_cause_search():  # it changes no figure of the tables
        return {
            name: MAKE.compared(tmp_path_factory.mktemp(name), name, methods_of(name))
            for name in MAKE.JOBS
        }


def methods_of(name: str) -> list[str]:
    """All methods but the one that the page states not to settle in 2000 iterations."""
    endless = [] if name == "compare_full" else ["force-residual"]
    assert all(
        row[3:5] == ["not settled"] * 2 for row in shown(name) if row[0].strip("`") in endless
    )
    return [method for method in METHODS if method not in endless]


def shown(name: str) -> list[list[str]]:
    table = TEXT.split(f"<!-- {name} -->\n")[1].split(f"<!-- end of {name} -->")[0]
    return rows(table)


def rows(table: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip().strip("|").split("|")] for line in table.splitlines()
    ]


def alike(a: str, b: str) -> bool:
    """Whether two cells agree, numbers within a tenth: last digits depend on the machine."""
    try:
        return float(a) == pytest.approx(float(b), rel=0.1)
    except ValueError:
        return a == b


@pytest.mark.parametrize("name", ["compare", "compare_stiffness", "compare_full"])
def test_results_come_out_of_the_command(both: dict[str, Comparison], name: str) -> None:
    """Else: python tools/make_compare_doc.py."""
    there, here = shown(name), rows(MAKE.results_table(both[name]))
    assert [row[0] for row in there[2:]] == [f"`{method}`" for method in METHODS]
    on_page = {row[0]: row for row in there}
    for row in here:
        assert all(map(alike, on_page[row[0]], row)), f"the page has {on_page[row[0]]}, not {row}"


def test_the_methods_are_those_that_there_are(both: dict[str, Comparison]) -> None:
    """Else: python tools/make_compare_doc.py."""
    assert shown("methods") == rows(MAKE.methods_table(both["compare_full"]))


def test_what_is_said_of_the_gear_train(both: dict[str, Comparison]) -> None:
    all_of_it, stiffness, full = both.values()
    assert full["complex-rfm"].error_max < 1e-6
    assert full["reduced-frf"].error_max < 1e-6
    assert full["rfm"].status == "failed"
    assert full["rfm"].fixed == tuple(f"unit {e}.loss_factor" for e in range(1, 7))
    assert all_of_it["equation-error"].fewest.count == 5
    assert all(row.fewest.count is None or row.fewest.count >= 5 for row in all_of_it if row.fewest)
    assert all_of_it["reduced-frf"].status == "failed"
    reduced = stiffness["reduced-frf"]
    assert reduced.fitted["after"]["db_error_median"] > reduced.fitted["before"]["db_error_median"]
    assert reduced.fewest.count is None
    assert len(all_of_it.parameters) == 18
    assert len(stiffness.parameters) == 12


def test_the_commands_are_written_into_the_jobs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from updyn.demos import gear_train

    gear_train.write_inputs(tmp_path)
    for name in MAKE.JOBS:
        first = (tmp_path / f"{name}.toml").read_text(encoding="utf-8").splitlines()[0]
        words = first.removeprefix("# ").split()
        on_page = [
            line for b in blocks(PAGE) if b.language == "console" for line in b.text.splitlines()
        ]
        there = [f"gear/inputs/{word}" if word.endswith(".toml") else word for word in words]
        assert " ".join(there) in on_page
    monkeypatch.chdir(tmp_path)
    assert main([*words[1:], "--methods", "log", "--chosen", "even", "--tolerance", "0.01"]) == 0
    assert (tmp_path / "compare_full-compare" / "compare.html").exists()


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = (b for b in blocks(PAGE) if b.language == "python")
    with no_cause_search():
        run_python(block, PAGE.name, {"__name__": "page"})
    assert "equation-error" in capsys.readouterr().out


def test_columns_are_explained() -> None:
    table = TEXT.split("| column | is |")[1].split("\n\n")[0]
    named = [
        name.strip() for line in table.splitlines()[2:] for name in line.split("|")[1].split(",")
    ]
    headings = [heading for key, heading, _ in COLUMNS if key not in ("method", "limits")]
    assert named == headings


def test_options_are_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    main(["compare", "--help"])
    out = capsys.readouterr().out
    for option in set(re.findall(r"--[a-z]+", TEXT)) - {"--"}:
        assert option in out, option
