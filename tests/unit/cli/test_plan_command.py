"""`updyn plan`: the table, both files, a job without its test, and what is refused with its line."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest

import updyn
from command_line import updyn_process
from pages_read import Page
from updyn.cli import main
from updyn.demos import chain

MODEL = """\
title = "Chain, before the test"

[model]
file = "chain.h5"

[[parameter]]
groups = "part*"
quantity = "stiffness"

[[parameter]]
groups = "part*"
quantity = "loss_factor"
"""
PLAN = """\
[plan]
n_sensors = 3
band = [1.0, 40.0]
candidates = ["?:X", "11:X"]
lines = 60
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    chain.write_inputs(folder)
    return folder


def job(inputs: Path, text: str) -> Path:
    path = inputs / "plan.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_both_files_and_the_table(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "plan"
    assert main(["plan", str(job(inputs, MODEL + PLAN)), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {"plan.html", "plan.json", "manifest.json"}
    record = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    model = chain.build()
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    labels = [f"{i}:X" for i in (*range(1, 10), 11)]
    expected = updyn.plan(model, unknowns, labels, 3, 1, (1.0, 40.0), lines=60)
    assert record["title"] == "Chain, before the test"
    assert record["responses"] == list(expected.responses)
    assert record["references"] == list(expected.references)
    assert record["gain"] == pytest.approx(list(expected.gain))
    stds = {row["name"]: row["std"] for row in record["parameters"]}
    assert stds == pytest.approx(dict(expected.std))
    assert record["rivals"][0]["criterion"] == "a-optimal"
    assert len(record["lines"]) == 60
    assert ", ".join(expected.responses) in said
    assert f"{'plan.html'}" in said


def test_the_page_shows_the_layout(inputs: Path, tmp_path: Path) -> None:
    text = MODEL + PLAN.replace("lines = 60", "lines = 30\nrobust = 2")
    assert main(["plan", str(job(inputs, text)), "--out", str(tmp_path)]) == 0
    page = (tmp_path / "plan.html").read_text(encoding="utf-8")
    record = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert Page(page).open == []
    figures = json.loads(re.search(r'id="updyn-figures">(.*?)</script>', page)[1])
    bars = figures["sensors"]["data"][0]
    gains = [*record["gain"][1:], *(row["gain"] for row in record["further"])]
    assert bars["x"] == pytest.approx([100 * gain for gain in gains])
    assert figures["sensors"]["layout"]["yaxis"]["ticktext"][:2] == record["responses"][1:]
    for said in (*record["responses"], "part3.stiffness", "2 draws", "Kammer", "Other criteria"):
        assert said in page


def test_a_job_with_its_test_is_planned_for_its_configuration(inputs: Path, tmp_path: Path) -> None:
    test = '[test]\nfile = "chain.uff"\nmasses = { "6:X" = 5.0 }\n'
    for name, text in (("without", MODEL + PLAN), ("with", MODEL + PLAN + test)):
        assert main(["plan", str(job(inputs, text)), "--out", str(tmp_path / name)]) == 0
    with_mass, without = (
        json.loads((tmp_path / name / "plan.json").read_text(encoding="utf-8"))
        for name in ("with", "without")
    )
    assert with_mass["radius"] != without["radius"]


def test_a_job_that_was_planned_runs(inputs: Path, tmp_path: Path) -> None:
    """`[plan]` stays in the job when `[test]` comes."""
    text = MODEL + PLAN + '[test]\nfile = "chain.uff"\n[output]\nreport = false\n'
    path = job(inputs, text)
    assert main(["run", str(path), "--out", str(tmp_path)]) in (0, 3)
    again = (tmp_path / "job.toml").read_text(encoding="utf-8")
    assert "n_sensors = 3" in again


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (MODEL, None, "missing table [plan]"),
        (MODEL + PLAN.replace("n_sensors = 3\n", ""), 13, "missing key 'n_sensors' in [plan]"),
        (MODEL + PLAN.replace("n_sensors", "sensors"), 14, "did you mean 'n_sensors'"),
        (MODEL + PLAN.replace("= 3", "= 0"), 14, "expected a number of at least 1"),
        (MODEL + PLAN.replace("= 3", "= 11"), 14, "found 10 candidates; name more"),
        (MODEL + PLAN.replace("[1.0, 40.0]", "[40.0, 1.0]"), 15, "expected 0 <= low < high"),
        (MODEL + PLAN.replace("[1.0, 40.0]", '"all"'), 15, "expected two frequencies in Hz"),
        (MODEL + PLAN.replace('"11:X"', '"13:X"'), 16, "candidate 13:X is not among the 12 DOFs"),
        (MODEL + PLAN.replace('"11:X"', '"2?:X"'), 16, "no DOF of the model matches '2?:X'"),
        (MODEL + PLAN.replace("60", "1"), 17, "expected a number of lines of at least 2"),
        (MODEL + PLAN + 'criterion = "kammer"\n', 18, "'kammer'"),
        (MODEL + PLAN + 'interest = ["part9.*"]\n', 18, "no unknown 'part9.*'"),
        (MODEL + PLAN + "noise = { relativ = 0.1 }\n", 18, "relative and/or floor"),
        (MODEL.replace("part*", "parts"), 7, "no group 'parts'"),
        (MODEL + "[selection]\nn = 2\n" + PLAN, 13, "[selection] needs measured data"),
        (
            MODEL + '[[calibration]]\nresponses = "all"\n' + PLAN,
            13,
            "[[calibration]] needs measured data",
        ),
    ],
)
def test_bad_input_is_one_message_with_its_line(
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    text: str,
    line: int | None,
    message: str,
) -> None:
    if "[plan]" not in text and line is not None:
        text += PLAN
    path = job(inputs, text)
    assert main(["plan", str(path), "--out", str(tmp_path / "new")]) == 2
    out, err = capsys.readouterr()
    said = " ".join(err.split())
    assert message in said
    if line is not None:
        assert f"plan.toml:{line}:" in said.replace(" ", "")
    assert out == ""
    assert "Traceback" not in err
    assert not (tmp_path / "new").exists()


def test_other_commands_need_the_test(inputs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(job(inputs, MODEL + PLAN))]) == 2
    assert "missing key 'test'" in " ".join(capsys.readouterr().err.split())


def test_files_of_a_user_are_kept(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.json").write_text("mine", encoding="utf-8")
    assert main(["plan", str(job(inputs, MODEL + PLAN)), "--out", str(tmp_path)]) == 2
    assert "files that it did not write" in " ".join(capsys.readouterr().err.split())
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]


# -- stopped and resumed ---------------------------------------------------------------------------
@pytest.fixture
def long_plan(inputs: Path) -> Path:
    """A job whose starts take some tenths of a second each."""
    text = PLAN.replace("lines = 60", "lines = 3000\nrobust = 30").replace("11:X", "1?:X")
    path = inputs / "long.toml"
    path.write_text(MODEL + text, encoding="utf-8")
    return path


def begun(path: Path, out: Path) -> subprocess.Popen[str]:
    """A process whose journal has grown twice."""
    process = updyn_process("plan", str(path), "--out", str(out))
    sizes: set[int] = set()  # of the journal, which each start makes longer
    for _ in range(6000):
        with suppress(FileNotFoundError):
            sizes.add((out / "plan.journal").stat().st_size)
        if len(sizes - {0}) > 2:
            break
        assert process.poll() is None
        time.sleep(0.01)
    return process


def resumed_and_fresh(path: Path, out: Path, *more: str) -> list[dict[str, object]]:
    records = []
    for name, options in (("stopped", ["--resume", *more]), ("fresh", [])):
        assert main(["plan", str(path), "--out", str(out / name), *options]) == 0
        assert not (out / name / "plan.journal").exists()
        records.append(json.loads((out / name / "plan.json").read_text(encoding="utf-8")))
    return records


@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a child is another thing on Windows")
def test_ctrl_c_is_answered_and_the_plan_goes_on_from_there(
    long_plan: Path, tmp_path: Path
) -> None:
    process = begun(long_plan, tmp_path / "stopped")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "Stopping after these lines; updyn plan --resume goes on from there." in err
    assert "To continue: updyn plan JOB.toml --resume" in out
    assert [p.name for p in (tmp_path / "stopped").iterdir()] == ["plan.journal"]
    resumed, fresh = resumed_and_fresh(long_plan, tmp_path, "--workers", "2")
    assert resumed == fresh


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL on Windows")
def test_a_killed_plan_is_resumed(long_plan: Path, tmp_path: Path) -> None:
    process = begun(long_plan, tmp_path / "stopped")
    process.kill()
    process.communicate(timeout=20)
    resumed, fresh = resumed_and_fresh(long_plan, tmp_path)
    assert resumed == fresh


def test_a_plan_with_nothing_to_resume_begins_anew(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", str(job(inputs, MODEL + PLAN)), "--out", str(tmp_path), "--resume"]) == 0
    assert "nothing to resume" in " ".join(capsys.readouterr().err.split())


def test_another_plan_is_not_resumed(
    long_plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    process = begun(long_plan, tmp_path)
    process.kill()
    process.communicate(timeout=20)
    text = long_plan.read_text(encoding="utf-8").replace("n_sensors = 3", "n_sensors = 4")
    long_plan.write_text(text, encoding="utf-8")
    assert main(["plan", str(long_plan), "--out", str(tmp_path), "--resume"]) == 2
    assert "the options differ (n_sensors)" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "plan.journal").exists()
