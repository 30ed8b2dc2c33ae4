"""What commands print in the end: few lines that fit the terminal, the verdict first, the path last."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from overriding import override
from report_case import realistic
from updyn.cli import brief, main
from updyn.cli.brief import cut_lines
from updyn.cli.layout import fit_text
from updyn.cli.outcome import describe_outcome, list_largest_changes
from updyn.cli.sections import FinishedRun, describe_results
from updyn.cli.settings import LAYOUT
from updyn.cli.terminal import output_width, print_note
from updyn.comparison import Comparison, Row
from updyn.demos import chain
from updyn.text_table import display_width
from updyn.updating.judge.claim import PARTS, Claim
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.trust import Trust
from updyn.updating.result import UpdateResult

WIDTHS = [60, 80, 120]
CLOSING = ["Results in out: out/report.html"]


@pytest.fixture(scope="module")
def result() -> UpdateResult:
    claims = {name: Claim(True, "It holds.") for name in PARTS}
    claims["determined"] = Claim(
        False, "The data determine 6 of 7 unknowns.", further="More is known."
    )
    return replace(realistic(), trust=Trust(**claims))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    job = chain.write_inputs(folder)
    text = job.read_text(encoding="utf-8")
    plan = "[plan]\nn_sensors = 3\nband = [1.0, 30.0]\nlines = 40\nrobust = 0\n"
    plant = '[plant]\ninputs = ["12:X"]\noutputs = ["12:X", "5:X"]\nband = [1.0, 20.0]\n'
    (folder / "plan.toml").write_text(f"{text}\n{plan}", encoding="utf-8")
    (folder / "plant.toml").write_text(f"{text}\n{plant}", encoding="utf-8")
    return folder


# -- run -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("width", [*WIDTHS, None])
def test_an_outcome_has_twenty_lines_at_most_and_its_parts_in_order(
    result: UpdateResult, width: int | None
) -> None:
    text = describe_outcome(result, CLOSING, width)
    lines = (text if width is None else fit_text(text, width)).splitlines()
    assert len(lines) <= 20
    assert max(map(display_width, lines)) <= (width or 1000)
    starts = (
        f"{result.title}: ",
        "  resembles ",
        "unknown ",
        "What to do next",
        "Results in out: ",
    )
    places = [next(n for n, x in enumerate(lines) if x.startswith(start)) for start in starts]
    assert places == sorted(places)
    assert places[0] == 0
    assert lines[-1] == CLOSING[0]


@pytest.mark.parametrize("width", WIDTHS)
def test_long_verdicts_leave_fewer_rows(result: UpdateResult, width: int) -> None:
    """Of five parts of which none holds, each with a long first sentence; and wide characters."""
    why = "Most of the residual peaks of 軸受の剛性 differ from those of the test by several bands."
    more = "A second sentence is not printed."
    claims = {name: Claim(False, why, further=more) for name in PARTS}
    hard = replace(result, trust=Trust(**claims), title="Prüfstand 軸受")
    text = fit_text(describe_outcome(hard, CLOSING, width), width)
    lines = text.splitlines()
    assert max(map(display_width, lines)) <= width
    assert len(lines) <= 20
    assert "second sentence" not in text
    assert 1 <= " ".join(text.split()).count(why) <= 5
    assert re.search(r"(?m)^bay \d+\.\S+ .* %", text)  # a change is always there


def test_the_number_of_lines_is_a_setting(
    result: UpdateResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = describe_outcome(result, CLOSING, None)
    assert full.count("\nbay ") == LAYOUT.outcome_rows == 5
    override(monkeypatch, LAYOUT, outcome_lines=len(full.splitlines()) - 2)
    assert describe_outcome(result, CLOSING, None).count("\nbay ") == 3


def test_the_largest_changes_come_first_and_those_that_are_certain(result: UpdateResult) -> None:
    chosen = list_largest_changes(result, 5)
    intervals = result.intervals()
    sizes = []
    for p in result.parameters:
        low, high = intervals.get(p.name, (-math.inf, math.inf))
        certain = not low <= p.start <= high
        sizes.append((certain, abs(math.log(result.values[p.name] / p.start)), p.name))
    assert [p.name for p in chosen] == [name for *_, name in sorted(sizes, reverse=True)[:5]]
    text = describe_outcome(result, CLOSING, None)
    rows = [line for line in text.splitlines() if line.startswith("bay ")]
    assert [re.split(r"  +", row)[0] for row in rows] == [p.name for p in chosen]
    assert f"... and {len(result.parameters) - 5} that changed less (--verbose)" in text


def test_rows_hold_the_values_and_the_reasons_of_doubt(result: UpdateResult) -> None:
    text = describe_outcome(result, CLOSING, None)
    shown = {re.split(r"  +", row)[0]: row for row in text.splitlines() if row.startswith("bay ")}
    for p in list_largest_changes(result, 5):
        value = result.values[p.name]
        cells = re.split(r"  +", shown[p.name])
        assert float(cells[2]) == pytest.approx(value, rel=1e-3)
        assert float(cells[3].removesuffix(" %")) == pytest.approx(
            100 * (value / p.start - 1), rel=5e-3
        )
        low, high = result.intervals().get(p.name, (math.nan, math.nan))
        if math.isnan(low):
            assert "not determined by the data" in shown[p.name]
        else:
            found = [float(end) for end in cells[4].split(" to ")]
            assert found == pytest.approx([low, high], rel=1e-3)
        assert ("lower bound" in shown[p.name]) == (result.at_bound.get(p.name) == "lower")
    assert "lower bound" in text


def test_the_level_before_and_after_is_that_of_the_result(result: UpdateResult) -> None:
    (line,) = (x for x in describe_outcome(result, CLOSING, None).splitlines() if "(dB)" in x)
    found = [float(x) for x in re.findall(r"([\d.]+) (?:at the start|updated)", line)]
    expected = [result.correlation[when]["db_error_median"] for when in ("before", "after")]
    held = result.correlation.get("validation")
    if held:
        expected += [held[when]["db_error_median"] for when in ("before", "after")]
    assert found == pytest.approx(expected, rel=5e-3)


# -- commands --------------------------------------------------------------------------------------
COMMANDS = {
    "check": (["check", "job.toml"], "Before the fit, as a page: "),
    "correlate": (["correlate", "job.toml"], "Before the fit, as a page: "),
    "modes": (["modes", "job.toml"], "Modes in "),
    "compare": (["compare", "job.toml", "--methods", "log,rfm"], "Comparison in "),
    "plan": (["plan", "plan.toml"], "Plan in "),
    "plant": (["plant", "plant.toml", "--out", "planted"], "Plant in "),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_an_outcome_fits_the_terminal_and_ends_with_the_page(
    command: str, inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(inputs)
    words, last = COMMANDS[command]
    for width in WIDTHS:
        monkeypatch.setenv("COLUMNS", str(width))
        assert main(words) == 0
        out = capsys.readouterr().out
        lines = out.splitlines()
        assert max(map(display_width, lines)) <= width, out
        assert len(lines) <= 25 + 5 * (width == 60), out
        (place,) = (n for n, line in enumerate(lines) if line.startswith(last))
        assert len(lines) - place <= 2, out


@pytest.mark.parametrize("command", COMMANDS)
def test_verbose_prints_more_before_the_outcome_and_fits_too(
    command: str, inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(inputs)
    words, _ = COMMANDS[command]
    monkeypatch.setenv("COLUMNS", "80")
    assert main(words) == 0
    short = capsys.readouterr().out
    assert main([*words, "--verbose"]) == 0
    full = capsys.readouterr().out
    seconds = re.compile(r" [\d.]+(?= |$)")  # of a comparison
    if command == "compare":
        assert full.splitlines()[-2:] == short.splitlines()[-2:]
    else:
        assert seconds.sub("", full).endswith(seconds.sub("", short))
    assert len(full.splitlines()) > len(short.splitlines()) + 3
    assert max(map(display_width, full.splitlines())) <= 80


def test_a_pipe_is_not_laid_out_for_a_width(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A program that reads it gets whole rows and sentences."""
    monkeypatch.chdir(inputs)
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["modes", "job.toml"]) == 0
    (header,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("mode "))
    assert header.split("  ")[-1] == "quality"
    assert "scale" in header


def test_a_narrow_terminal_leaves_out_columns_of_modes_in_order(
    inputs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(inputs)
    headers = {}
    for width in (120, 80, 60, 40):
        monkeypatch.setenv("COLUMNS", str(width))
        assert main(["modes", "job.toml"]) == 0
        (header,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("mode "))
        headers[width] = re.split(r"  +", header)
    assert headers[120][-3:] == ["scale", "phase collinearity", "quality"]
    assert headers[80] == [x for x in headers[120] if x != "scale"]
    assert headers[60] == ["mode", "frequency (Hz)", "std", "loss factor", "std"]
    assert headers[40] == ["mode", "frequency (Hz)", "loss factor"]


@pytest.mark.parametrize(("n", "kept"), [(6, 6), (7, 5), (20, 5)])
def test_lines_are_cut_if_more_than_one_is_hidden(n: int, kept: int) -> None:
    found = cut_lines("\n".join(map(str, range(n))), 5).splitlines()
    assert found[:kept] == list(map(str, range(kept)))
    assert found[kept:] == ([] if n == kept else [f"... and {n - 5} more lines (--verbose)"])


def test_tables_of_modes_have_fifteen_rows() -> None:
    from updyn.cli.describe import describe_modes
    from updyn.modal import ModeSet

    assert LAYOUT.table_rows == 15
    for n in (15, 16):
        modes = ModeSet(np.arange(1.0, n + 1.0), np.ones((1, n)), ["1:X"])
        text = describe_modes(modes, LAYOUT.table_rows)
        assert len(re.findall(r"(?m)^\d+ ", text.split("mode  ")[1])) == 15
        assert ("... and 1 more (--verbose)" in text) is (n == 16)


def test_a_check_prints_two_undetermined_combinations_and_the_advice() -> None:
    names = [f"part{k}.mass" for k in range(4)]
    directions = [{name: 1.0} for name in names]
    found = Identifiability(0, 4, math.inf, (0.0,) * 4, directions, [], math.inf, "Add a sensor.")
    lines = brief._brief_identifiability(found).splitlines()
    assert lines[0].startswith("The data determine 0 of 4 unknowns")
    assert [line.split(":")[0].strip() for line in lines[1:3]] == [
        "undetermined combination 1",
        "undetermined combination 2",
    ]
    assert lines[3:] == ["... and 2 more lines (--verbose)", "Add a sensor."]


def test_the_width_of_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of COLUMNS, at least 40; without it and without a terminal it is not limited."""
    for stated, width in (("100", 100), ("40", 40), ("39", 40), ("0", None), ("wide", None)):
        monkeypatch.setenv("COLUMNS", stated)
        assert output_width() == width
    monkeypatch.delenv("COLUMNS")
    assert output_width() is None


def test_reasons_are_of_parts_that_were_asked(result: UpdateResult) -> None:
    claims = {name: Claim(True, "It holds.") for name in PARTS}
    claims["validated"] = Claim(None, "No data were held out.", asked=False)
    claims["plausible"] = Claim(None, "The residual is not noise.", further="It is large.")
    text = describe_outcome(replace(result, trust=Trust(**claims)), CLOSING, None)
    assert (
        "validated not asked, plausible not known\n  plausible: The residual is not noise.\n"
        in text
    )
    assert "held out.\n" not in text


def test_further_results_are_named_with_their_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a table, its first line and at most three notes."""
    text = "Plant from 1 to 30 Hz\nroute: rational\n" + "".join(f"note: {k}\n" for k in range(4))
    tables = {
        "plant": SimpleNamespace(summary=lambda _: text),
        "shapes": SimpleNamespace(summary=str),
    }
    monkeypatch.setattr("updyn.job.job_table.JOB_TABLES", tables)
    run = SimpleNamespace(
        further={"plant": 1, "shapes": ""},
        folder=Path("out"),
        stopped=False,
        result=SimpleNamespace(status="converged", trust=None),
    )
    job = SimpleNamespace(output=SimpleNamespace(report=True))
    found = describe_results(FinishedRun(job, run))  # type: ignore[arg-type]
    notes = ["note: 0", "note: 1", "note: 2"]
    place = f"Results in out: {Path('out/report.html')}"
    assert found == ["Plant from 1 to 30 Hz", *notes, place]


@pytest.mark.parametrize(("level", "shown"), [(2e-4, "0.0002"), (9e-5, "<0.0001")])
def test_the_level_of_an_exact_fit_is_a_limit(
    result: UpdateResult, level: float, shown: str
) -> None:
    after = {**result.correlation["after"], "db_error_median": level}
    exact = replace(result, correlation={**result.correlation, "after": after})
    assert f"at the start, {shown} updated" in describe_outcome(exact, CLOSING, None)


def test_a_comparison_names_the_method_with_the_smallest_misfit() -> None:
    def row(method: str, level: float, status: str = "converged") -> Row:
        figures = {"after": {"db_error_median": level, "frac_median": 0.9}}
        return Row(method, "", status, "", fitted=figures)

    rows = (row("log", 0.5), row("modal", 0.25), row("rfm", 0.0, "failed"))
    unknowns = realistic().parameters
    found = Comparison(rows, (), unknowns)
    assert brief._name_best(found) == ["Smallest misfit to the data of the fit: modal, 0.25 dB"]
    assert brief._name_best(Comparison((), (), unknowns)) == []


def test_a_note_on_a_terminal_is_broken_at_blanks() -> None:
    out = io.StringIO()
    console = Console(file=out, width=44, force_terminal=True, no_color=True)
    print_note("note: a group has a stiffness that is indefinite, as of rounding", None, console)
    lines = out.getvalue().splitlines()
    assert lines == ["note: a group has a stiffness that is", "indefinite, as of rounding"]
