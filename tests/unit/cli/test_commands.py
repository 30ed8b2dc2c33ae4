"""The commands, in this process: exit codes, what is written, what is said."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn import cli
from updyn.cli import main
from updyn.correlation.figures import FIGURE_NAMES
from updyn.demos import DEMOS, chain
from updyn.errors import UpdynWarning
from updyn.outputs.manifest import Manifest

JOB = """\
title = "Chain"
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[[parameter]]
groups = ["all"]
quantity = "loss_factor"
start = 0.02
[[parameter]]
groups = "part?"
quantity = "mass"
bounds = [0.5, 2.0]
[method]
lines = "d-optimal:30"
validation = ["7:X"]
[output]
report = false
"""
OPEN = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
band = [4.1, 4.5]
responses = ["12:X"]
references = ["12:X"]
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
name = "output-error"
noise = { relative = 0.01 }
[output]
report = false
"""


def write(folder: Path, text: str, name: str = "job.toml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


# -- run ---------------------------------------------------------------------------------------------------
def test_run_recovers_the_truth_and_says_0(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, JOB)
    assert main(["run", str(job), "--verbose"]) == 0

    out, err = capsys.readouterr()
    folder = chain_folder / "job"
    written = {"result.json", "run.nc", "model.h5", "job.toml"}
    assert {p.name for p in folder.iterdir()} == {*written, "manifest.json"}
    assert set(Manifest.read(folder).entries) == written
    assert out.startswith("Chain: converged after ")
    for part in ("resembles", "converged", "determined", "validated", "plausible"):
        assert f"\n  {part:<10}  yes        " in out
    assert "The fit converged and" not in out  # the four parts say it
    assert str(folder / "result.json") in out
    assert re.match(r"stage \d of 5, .*\d:\d\d elapsed\n", err)  # stderr is no terminal here

    found = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert found["status"] == "converged"
    assert len(found["parameters"]) == 12
    for p in found["parameters"]:
        assert p["value"] == pytest.approx(chain.TRUTH[p["group"]][p["quantity"]], abs=5 * p["std"])
        assert p["value"] == pytest.approx(chain.TRUTH[p["group"]][p["quantity"]], rel=0.03)
    assert (
        found["parameters"][2] | {"start": 0.02, "quantity": "loss_factor"}
        == found["parameters"][2]
    )
    assert set(found["correlation"]["validation"]) == {"before", "after"}

    result = updyn.read_result(folder / "run.nc")
    assert len(result.lines) == 30
    assert result.validation_responses == ("7:X",)
    model = updyn.read_model(folder / "model.h5")
    part = model.groups["part3"]
    assert part.loss_factor == result.values["part3.loss_factor"]
    np.testing.assert_allclose(
        part.stiffness.toarray(),
        chain.build().groups["part3"].stiffness.toarray() * result.values["part3.stiffness"],
    )


def test_the_resolved_job_runs_again_with_the_same_result(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    write(chain_folder, JOB, "my.run.toml")
    monkeypatch.chdir(chain_folder)
    assert main(["run", "my.run.toml", "--out", "deep/er"]) == 0
    text = (chain_folder / "deep/er/job.toml").read_text(encoding="utf-8")
    assert str(chain_folder) not in text
    assert 'file = "../../chain.h5"' in text
    assert "max_iterations = " in text

    moved = tmp_path_factory.mktemp("elsewhere") / "all"  # the whole tree may move
    chain_folder.rename(moved)
    monkeypatch.chdir(moved.parent)
    assert main(["run", "all/deep/er/job.toml"]) == 0
    first, again = (
        json.loads((moved / p / "result.json").read_text(encoding="utf-8"))
        for p in ("deep/er", "deep/er/job")
    )
    assert first["parameters"] == again["parameters"]
    assert first["title"] == again["title"] == "Chain"
    assert (moved / "deep/er/job/job.toml").read_text(encoding="utf-8").splitlines()[2:5] == [
        "",
        "[model]",
        'file = "../../../chain.h5"',
    ]


def test_not_all_determined_says_3_and_writes(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, OPEN)
    assert main(["run", str(job), "--verbose"]) == 3
    found = json.loads((chain_folder / "job" / "result.json").read_text(encoding="utf-8"))
    assert found["status"] == "not-identifiable"
    assert found["identifiability"]["rank"] < found["identifiability"]["n_parameters"] == 4
    out = capsys.readouterr().out
    assert "  determined  no         The data determine 2 of 4 unknowns." in out
    assert found["message"].partition("unknowns: ")[2] in out
    assert f"What to do next: {found['remedy']}" in out


def test_too_few_iterations_say_3(chain_folder: Path) -> None:
    job = write(
        chain_folder, JOB.replace("[method]", "[method]\nname = 'output-error'\nmax_iterations = 1")
    )
    assert main(["run", str(job)]) == 3
    assert (
        json.loads((chain_folder / "job" / "result.json").read_text(encoding="utf-8"))["status"]
        == "max-iterations"
    )


def test_a_finished_run_replaces_what_an_earlier_one_wrote(chain_folder: Path) -> None:
    out = chain_folder / "out"
    job = write(chain_folder, OPEN.replace("report = false", "report = true"))
    assert main(["run", str(job), "--out", str(out)]) == 3
    assert "<html" in (out / "report.html").read_text(encoding="utf-8")[:200]
    (out / "notes.txt").write_text("mine")
    write(chain_folder, JOB)
    assert main(["run", str(job), "--out", str(out)]) == 0
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["status"] == "converged"
    assert {p.name for p in out.iterdir()} == {
        "result.json",
        "run.nc",
        "model.h5",
        "job.toml",
        "manifest.json",
        "notes.txt",
    }


def test_bad_input_leaves_an_earlier_run_as_it_was(chain_folder: Path) -> None:
    job = write(chain_folder, OPEN)
    assert main(["run", str(job)]) == 3
    before = {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in (chain_folder / "job").iterdir()}
    write(chain_folder, OPEN.replace("band", "bnad"))
    assert main(["run", str(job)]) == 2
    write(
        chain_folder, OPEN.replace("noise = { relative = 0.01 }", 'lines = "d-optimal:99"')
    )  # found by the update itself
    assert main(["run", str(job)]) == 2
    assert {
        p: (p.read_bytes(), p.stat().st_mtime_ns) for p in (chain_folder / "job").iterdir()
    } == before


def test_a_run_never_writes_over_its_inputs(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (chain_folder / "chain.h5").rename(chain_folder / "model.h5")
    job = write(chain_folder, OPEN.replace("chain.h5", "model.h5"), "start.toml")
    before = (chain_folder / "model.h5").read_bytes()
    assert main(["run", str(job), "--out", str(chain_folder)]) == 2
    assert "would overwrite its model" in capsys.readouterr().err
    job.rename(chain_folder / "job.toml")
    assert (
        main(["run", str(chain_folder / "job.toml"), "--out", str(chain_folder / "x" / "..")]) == 2
    )
    assert "would overwrite its job file" in capsys.readouterr().err
    assert (chain_folder / "model.h5").read_bytes() == before


def test_a_run_never_writes_over_its_geometry(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that an earlier run wrote, whose model has a geometry, is an input like any other."""
    job = write(chain_folder, OPEN)
    assert main(["run", str(job)]) == 3
    text = OPEN + '[match]\nby = "coordinates"\ngeometry = "job/model.h5"\n'
    again = write(chain_folder, text, "again.toml")
    capsys.readouterr()
    assert main(["run", str(again), "--out", str(chain_folder / "job")]) == 2
    assert "would overwrite its geometry" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="names of files are text elsewhere")
@pytest.mark.parametrize("command", ["run", "check", "correlate"])
def test_a_job_whose_name_is_not_utf8_is_refused_before_any_work(
    chain_folder: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, OPEN, "j\udcff.toml")
    before = sorted(chain_folder.iterdir())
    assert main([command, str(job)]) == 2
    assert "the name is not UTF-8" in capsys.readouterr().err
    assert sorted(chain_folder.iterdir()) == before


@pytest.mark.skipif(os.name != "posix", reason="names of files are text elsewhere")
def test_results_elsewhere_of_a_folder_whose_name_is_not_utf8_are_refused(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The job of the run would have to name it."""
    inner = chain_folder / "d\udcff"
    inner.mkdir()
    for name in ("chain.h5", "chain.npz"):
        (chain_folder / name).rename(inner / name)
    job = write(inner, OPEN)
    assert main(["run", str(job), "--out", str(chain_folder / "out")]) == 2
    assert "the name is not UTF-8" in capsys.readouterr().err
    assert not (chain_folder / "out").exists()
    assert main(["run", str(job)]) == 3


def test_an_output_folder_that_is_a_file(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, OPEN)
    assert main(["run", str(job), "--out", str(chain_folder / "chain.npz")]) == 2
    assert "is a file; choose another with --out" in capsys.readouterr().err
    assert main(["run", str(job), "--out", str(chain_folder / "chain.npz" / "deeper")]) == 2
    assert (chain_folder / "chain.npz").is_file()


@pytest.mark.skipif(os.name != "posix", reason="links need a privilege elsewhere")
@pytest.mark.parametrize(
    ("link", "arguments", "fragment"),
    [
        ("out", ["--out", "out"], "is a link that leads to no folder"),
        ("out/report.html", ["--out", "out"], "is a link"),
        ("job/model.h5", [], "is a link"),
        ("chain.h5", [], "model.file = 'chain.h5': no such file"),
    ],
)
def test_a_link_to_itself_is_one_message(
    link: str,
    arguments: list[str],
    fragment: str,
    chain_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(chain_folder)
    job = write(chain_folder, OPEN).name
    path = chain_folder / link
    path.unlink(missing_ok=True)
    path.parent.mkdir(exist_ok=True)
    path.symlink_to(path)
    assert main(["run", job, *arguments]) == 2
    assert fragment in " ".join(capsys.readouterr().err.split())
    assert path.is_symlink()


# -- check, correlate --------------------------------------------------------------------------------------
def test_check_says_what_can_be_known(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, JOB)
    assert main(["check", str(job), "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "part4.loss_factor  " in out
    assert "\nmodel: 12 DOFs, 4 groups: part1, part2, part3, part4\n" in out
    assert "5 responses, 2 references; all are DOFs of the model\n" in out
    assert "\nfit: d-optimal:30 of 60 lines, 4 of 5 responses; held out: 7:X\n" in out
    assert "The data determine 12 of 12 unknowns" in out
    assert not (chain_folder / "job").exists()
    assert not (chain_folder / "job-check").exists()  # report = false


def test_check_and_correlate_write_the_page_of_the_start(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, JOB.replace("report = false", "report = true"))
    for command in ("check", "correlate"):
        for _ in range(2):  # again: its own page may be replaced
            assert main([command, str(job)]) == 0
        page = chain_folder / f"job-{command}" / f"{command}.html"
        assert f"Before the fit, as a page: {page}\n" in capsys.readouterr().out
        text = page.read_text(encoding="utf-8")
        assert "All unknowns can be determined" in text
        assert "<h1>Chain</h1>" in text
    assert not (chain_folder / "job").exists()
    assert main(["check", str(job), "--out", str(chain_folder / "seen")]) == 0
    assert {p.name for p in (chain_folder / "seen").iterdir()} == {"check.html", "manifest.json"}
    (chain_folder / "seen" / "check.html").write_text("mine", encoding="utf-8")
    assert main(["check", str(job), "--out", str(chain_folder / "seen")]) == 2
    assert "files that it did not write" in capsys.readouterr().err


def test_check_says_3_where_the_data_leave_something_open(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(write(chain_folder, OPEN))]) == 3
    out = capsys.readouterr().out
    assert "of 4 unknowns" in out
    assert "undetermined combination 1: " in out
    assert ".stiffness" in out.split("undetermined combination 1: ")[1]


@pytest.mark.parametrize("command", ["check", "run"])
def test_data_of_zeros_are_refused(
    command: str, chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(chain_folder, OPEN)
    frf = updyn.read_frf(chain_folder / "chain.npz")
    updyn.write_frf(replace(frf, values=0.0 * frf.values), chain_folder / "chain.npz")
    assert main([command, str(job)]) == 2
    silent = capsys.readouterr().err
    assert silent.endswith("all values to be fitted are zero: nothing was measured\n")


def test_correlate_agrees_with_the_library(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["correlate", str(write(chain_folder, JOB)), "--verbose"]) == 0
    out = capsys.readouterr().out
    start = chain.build().scaled({f"part{i}": {"loss_factor": 0.02} for i in (1, 2, 3, 4)})
    measured = chain.measure()
    found = updyn.correlate(start, measured)
    of_fit = measured.select(responses=[x for x in measured.responses.labels if x != "7:X"])
    for name, expected in updyn.correlate(start, of_fit).figures().items():
        (row,) = (x for x in out.splitlines() if x.startswith(f"{FIGURE_NAMES[name]}  "))
        assert float(row.split()[-1]) == pytest.approx(expected, rel=5e-3)
    rows = [x for x in out.splitlines() if x.startswith("10:X ")]
    assert len(set(rows)) == 1  # of the details and of the outcome
    (row, _) = rows
    values = [float(cell) for cell in row.split()[1:]]
    assert values == pytest.approx(list(found.by_response()["10:X"].values()), rel=5e-3)
    modes = updyn.correlate(start, updyn.identify_modes(measured))
    assert modes.table() in out


# -- convert, info -----------------------------------------------------------------------------------------
def test_convert_a_measurement(chain_folder: Path) -> None:
    source, target = chain_folder / "chain.npz", chain_folder / "out.mat"
    assert main(["convert", str(source), str(target)]) == 0
    np.testing.assert_array_equal(updyn.read_frf(target).values, updyn.read_frf(source).values)


def test_convert_a_model(chain_folder: Path) -> None:
    source, target = chain_folder / "chain.h5", chain_folder / "out.npz"
    assert main(["convert", str(source), str(target)]) == 0
    np.testing.assert_array_equal(
        updyn.read_model(target).stiffness.toarray(), chain.build().stiffness.toarray()
    )


def test_convert_does_not_write_over(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = chain_folder / "chain.h5", chain_folder / "out.npz"
    target.write_bytes(b"mine")
    assert main(["convert", str(source), str(target)]) == 2
    assert "exists already; --force writes over it" in capsys.readouterr().err
    assert target.read_bytes() == b"mine"
    assert main(["convert", str(source), str(source), "--force"]) == 2
    assert "is the file to read" in capsys.readouterr().err
    assert main(["convert", str(source), str(target), "--force"]) == 0
    assert updyn.read_model(target).n_dofs == 12


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["chain.h5", "out.csv"], "that can write_model"),
        (["chain.npz", "out.xyz"], "error: out.xyz: neither content nor suffix '.xyz'"),
        (["chain.hh", "out.npz"], "no such file; did you mean 'chain.h5'"),
        (["chain.npz", "out.mat", "--quantity", "receptance"], "contradicts the file"),
        (["chain.npz", "out.mat", "--from", "np"], "did you mean 'npz'?"),
        (["chain.npz", "nowhere/out.mat"], "does not exist"),
        (["noise.bin", "out.mat"], "neither content nor suffix"),
    ],
)
def test_convert_refuses(
    arguments: list[str],
    fragment: str,
    chain_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(chain_folder)
    Path("noise.bin").write_bytes(bytes(range(256)))
    before = sorted(Path().rglob("*"))
    assert main(["convert", *arguments]) == 2
    err = capsys.readouterr().err
    assert fragment in err
    assert err.count("error:") == 1
    assert sorted(Path().rglob("*")) == before


def test_info_of_each_kind(chain_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(chain_folder / "chain.h5")]) == 0
    out = capsys.readouterr().out
    assert "12 DOFs, 4 groups" in out
    row = next(line for line in out.splitlines() if line.startswith("part1")).split()
    assert row == ["part1", "3", "3", "kg", "2.6e+04", "0.03", "-"]  # k2 + k3 is the largest entry
    assert out.splitlines()[-1].startswith("Natural frequencies (Hz): ")
    first = float(out.splitlines()[-1].removeprefix("Natural frequencies (Hz): ").split(",")[0])
    K, M = chain.build().stiffness.toarray(), chain.build().mass.toarray()
    assert first == pytest.approx(
        np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).min()) / (2 * np.pi), rel=1e-4
    )

    assert main(["info", str(chain_folder / "chain.npz")]) == 0
    out = capsys.readouterr().out
    assert "FRF: accelerance, 60 lines from 0.634882 to 22.6954 Hz" in out
    assert "2 references: 2:X, 12:X" in out

    (chain_folder / "nodes.csv").write_text("node,x,y,z\n1,0,0,0\n2,1.5,0,-2\n")
    assert main(["info", str(chain_folder / "nodes.csv")]) == 0
    assert (
        "2 nodes, 0 lines to draw, in m: X 0 to 1.5, Y 0 to 0, Z -2 to 0" in capsys.readouterr().out
    )

    assert main(["info", str(write(chain_folder, JOB))]) == 2
    assert (
        "looks like a job file (it has 'model'), not a model: updyn check job.toml"
        in capsys.readouterr().err
    )


# -- demo --------------------------------------------------------------------------------------------------
def test_demo_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(DEMOS)
    assert next(iter(DEMOS)) == "beam"


def test_demo_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "chain"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= 20
    assert out.startswith("All 12 unknowns are within ")
    assert out.endswith(f"\nResults in demo/chain: {Path('demo/chain/report.html')}\n")
    folder = tmp_path / "demo" / "chain"
    assert {p.name for p in folder.iterdir()} == {
        "demo.txt", "inputs", "job.toml", "manifest.json", "model.h5", "report.html", "result.json",
        "run.nc",
    }  # fmt: skip
    text = (folder / "demo.txt").read_text(encoding="utf-8")
    assert text.startswith("Against the values that made the data:\n")
    errors = [float(line.split()[-1]) for line in text.splitlines()[2:14]]
    assert len(errors) == 12
    assert max(map(abs, errors)) < 4
    assert f"within {max(map(abs, errors)):.1f} standard deviations" in out
    assert main(["check", str(folder / "job.toml")]) == 0


def test_demo_of_no_such_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "chian"]) == 2
    assert "demo 'chian': did you mean 'chain'?" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


# -- usage -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["rum", "job.toml"], 'Unknown command "rum". Did you mean "run"?'),
        (["server", "job.toml"], 'Unknown command "server"'),
        (["run"], "JOB requires an argument"),
        (["run", "a.toml", "b.toml"], "b.toml"),
        (["run", "a.toml", "--outt", "x"], "Did you mean --out?"),
        (["run", "a.toml", "--out"], "--out requires an argument"),
        (["run", "a.toml"], "a.toml: no such file"),
        (["run", "."], "is a folder; expected a job file"),
        (["info", "a.h5"], "a.h5: no such file"),
        (["convert", "a.h5"], "OUT requires an argument"),
    ],
)
def test_bad_usage_says_2_in_one_message(
    arguments: list[str],
    fragment: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert fragment in err
    assert err.count("error:") == 1
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_errors_of_the_system_say_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied", "job.toml")

    monkeypatch.setattr("updyn.job.load_job", refuse)
    assert main(["run", "job.toml"]) == 2
    assert capsys.readouterr().err == "error: job.toml: Permission denied\n"


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == updyn.__version__
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for command in ("run", "check", "demo", "convert", "info", "correlate"):
        assert f" {command} " in out
    assert main(["convert", "--help"]) == 0
    assert "--scalar-direction" in capsys.readouterr().out


def test_the_list_of_commands_says_what_each_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for name in cli.COMMANDS:
        assert re.search(rf"(?m)^  {name} +[A-Z].+\.$", out)
    for words in ([], ["-h"]):
        assert main(words) == 0
        assert capsys.readouterr().out == out
    assert main(["--help", "plan"]) == 0
    assert "--resume" in capsys.readouterr().out


def test_the_list_of_commands_loads_no_library() -> None:
    code = "import sys; from updyn.cli import main; main([]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert "updyn" in loaded
    assert not loaded & {"numpy", "scipy", "rich", "cyclopts", "pydantic"}


def test_wrong_usage_leads_to_the_help_of_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run"]) == 2
    assert capsys.readouterr().err.endswith("\nTry: updyn run --help\n")
    assert main(["rn", "job.toml"]) == 2
    err = capsys.readouterr().err
    assert 'Did you mean "run"?' in err
    assert err.endswith("\nTry: updyn --help\n")


@pytest.mark.parametrize("command", list(cli.COMMANDS))
def test_every_option_is_described(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    options = re.findall(r"(?m)^│ +(--[a-z-]+)(?: --[a-z-]+)?(?: [A-Z]+)?( +\S.*|) *│$", out)
    assert options
    assert [name for name, text in options if not text.strip()] == []
    assert "--no-list" not in out


def test_warnings_are_notes_shown_once(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from updyn.job import prepare as real

    def prepare(job: object) -> object:
        for _ in range(3):
            warnings.warn("group 'a': stiffness is indefinite", UpdynWarning, stacklevel=2)
        return real(job)  # type: ignore[arg-type]

    monkeypatch.setattr("updyn.job.prepare", prepare)
    assert main(["check", str(write(chain_folder, JOB))]) == 0
    assert capsys.readouterr().err == "note: group 'a': stiffness is indefinite\n"


def test_a_reader_that_goes_away_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def broken(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("sys.stdout.write", broken)
    monkeypatch.setattr("os.dup2", lambda *a: calls.append(a))
    cli.terminal.print_text("text")
    assert len(calls) == 1


def test_a_band_held_out_and_modes_that_cannot_be_identified_are_said_plainly(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write(
        chain_folder,
        OPEN.replace("[4.1, 4.5]", "[3.6, 4.6]").replace(
            "[method]", "[method]\nvalidation = [4.2, 4.5]"
        ),
    )
    assert main(["correlate", str(job)]) == 0
    out = capsys.readouterr().out
    assert "; held out: 4.2 to 4.5 Hz\n" in out
    assert "Modes: not known. No modes could be identified from the FRFs: " in out
    assert "modes: " not in out
