"""`[accept]` of a job: page, exit codes of run and correlate, and what it refuses, with lines."""

from __future__ import annotations

from pathlib import Path

import pytest

import updyn
from updyn.cli import main
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import load_job, run_job
from updyn.job.acceptance import AcceptTable

JOB = """[model]
file = "chain.h5"
[test]
modes = "modes.unv"
[[parameter]]
groups = ["part1", "part2"]
quantity = "stiffness"
[method]
name = "modal"
[output]
report = {report}
{table}"""
PASSING = "[accept]\nfrequency = 0.05\nmac = 0.9\n"
FAILING = "[accept]\nfrequency = 1e-6\n"


@pytest.fixture
def job(tmp_path: Path):
    find_demo("chain").write_inputs(tmp_path)
    found = updyn.modes(updyn.read_model(tmp_path / "chain.h5"), 3)
    sensors = ["2:X", "5:X", "7:X", "10:X", "12:X"]
    modes = updyn.ModeSet(found.frequency * [1.01, 0.99, 1.0], found.at(sensors), sensors)
    updyn.write_modes(modes, tmp_path / "modes.unv")

    def make(table: str, report: str = "false") -> Path:
        path = tmp_path / "job.toml"
        path.write_text(JOB.format(table=table, report=report))
        return path

    return make


def test_a_run_writes_the_page_and_the_section(job, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run_job(load_job(job(PASSING, "true")), out)
    assert done.passes
    page = (out / "acceptance.html").read_text(encoding="utf-8")
    assert "Acceptance by own limits: pass; all of 9 requirements pass." in page
    assert "http" not in page.replace("http-equiv", "")
    assert 'id="acceptance"' in (out / "report.html").read_text(encoding="utf-8")
    # A run without the table removes its page.
    run_job(load_job(job("")), out)
    assert not (out / "acceptance.html").exists()


@pytest.mark.parametrize(("table", "code"), [(PASSING, 0), (FAILING, 3)], ids=["pass", "fail"])
def test_exit_codes(job, table: str, code: int, tmp_path: Path, capsys) -> None:
    outcome = {0: "pass", 3: "fail"}[code]
    assert main(["run", str(job(table)), "--out", str(tmp_path / "out")]) == code
    assert f"Acceptance by own limits: {outcome};" in capsys.readouterr().out
    assert (tmp_path / "out" / "acceptance.html").is_file()


@pytest.mark.parametrize(("limit", "code"), [(0.05, 0), (0.005, 3)])
def test_correlate_applies_the_limits_to_the_start(job, limit: float, code: int, capsys) -> None:
    # The start differs from the measured frequencies by 1 %.
    assert main(["correlate", str(job(f"[accept]\nfrequency = {limit}\n"))]) == code
    assert "Acceptance by own limits" in capsys.readouterr().out


def test_modes_that_cannot_be_compared_are_not_decidable(job) -> None:
    text = "[accept]\nfrequency = 0.05\nband = [500.0, 600.0]\n"
    done = run_job(load_job(job(text)))
    found = done.further["accept"]
    assert found.outcome == "not decidable"
    assert "the selection contains no mode" in found.requirements[0].note
    assert not done.passes


def test_limits_replace_those_of_the_standard(job) -> None:
    loaded = load_job(job('[accept]\nstandard = "NASA-STD-5002"\nfrequency = 0.02\n'))
    limits = loaded.table(AcceptTable).limits
    assert (limits.name, limits.frequency, limits.cross) == ("NASA-STD-5002", 0.02, 0.9)
    assert limits.changed == ("frequency",)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[accept]\n", ":12: no limits; expected standard"),
        ('[accept]\nstandard = "NASA-5002"\n', ":13: standard 'NASA-5002': did you mean 'NASA-STD"),
        ("[accept]\nfrequency = 5.0\n", ":13: .*frequency"),
        ("[accept]\nmac_major = 0.9\n", ":13: mac_major: expected effective_mass too"),
        (
            '[accept]\nmac = 0.9\ndirections = "W"\n',
            ":14: directions 'W': expected some of X, Y and Z",
        ),
        ('[accept]\nmac = 0.9\ntest = "left"\n', ":14: the job has one test only"),
    ],
)
def test_bad_tables_are_refused(job, table: str, message: str) -> None:
    with pytest.raises(JobError, match=message):
        load_job(job(table))
