"""`updyn compare`: the table, both files, exit codes, what is refused and what is left then."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import updyn
from cause_search import no_cause_search
from updyn.cli import main
from updyn.cli.progress import ProgressDisplay
from updyn.demos import gear_train
from updyn.demos.gear_train import true_model
from updyn.updating.fit.methods import METHODS

METHODS_HERE = "log,equation-error,reduced-frf,rfm"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gear")
    gear_train.write_inputs(folder)
    return folder


@pytest.fixture(scope="module")
def ran(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, str]:
    """The paper's comparison figure: the command of docs/compare.md, on fewer methods."""
    folder = tmp_path_factory.mktemp("out") / "deep" / "compared"
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("updyn.cli.commands.print_outcome", lambda *texts, **_: said.extend(texts))
        job, truth = inputs / "compare_stiffness.toml", inputs / "compare_stiffness_truth.toml"
        words = ["compare", str(job), "--truth", str(truth), "--fewest", "--out", str(folder)]
        with no_cause_search():
            code = main([*words, "--methods", METHODS_HERE])
    return folder, code, "\n".join(said)


def rows_of(said: str) -> dict[str, str]:
    lines = said.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("method "))
    end = lines.index("", start)
    return {line.split()[0]: line for line in lines[start + 1 : end]}


def test_both_files_and_the_table(ran: tuple[Path, int, str]) -> None:
    folder, code, said = ran
    assert code == 0
    assert {p.name for p in folder.iterdir()} == {
        "compare.html",
        "compare.json",
        "manifest.json",
    }
    assert f"Comparison in {folder}: {folder / 'compare.html'}" in said
    rows = rows_of(said)
    assert list(rows) == METHODS_HERE.split(",")
    assert "does not apply" in rows["rfm"]
    assert "rfm does not apply: rfm needs the motion of all 7 DOFs of the model" in said


def test_a_method_that_fails_says_why_on_screen_page_and_record(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", str(inputs / "compare.toml"), "--out", str(tmp_path)]
    assert main([*words, "--methods", "reduced-frf,frf-sensitivity", "--verbose"]) == 3
    said = capsys.readouterr().out
    record = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    causes = (
        "3 of 7 DOFs were not measured, and the transformation",
        "misfit decreases only along",
    )
    for row, cause in zip(record["rows"], causes, strict=True):
        assert row["status"] == "failed"
        assert "would become negative (from " in row["message"]
        assert cause in row["message"]
        assert f"{row['method']} failed: {row['message']}" in said
        assert row["message"] in page


def test_the_record(ran: tuple[Path, int, str]) -> None:
    found = json.loads((ran[0] / "compare.json").read_text(encoding="utf-8"))
    rows = {row["method"]: row for row in found["rows"]}
    assert found["title"] == "Gear train, every method, masses known"
    assert len(found["unknowns"]) == len(found["truth"]) == 12
    paper, reduced = rows["equation-error"], rows["reduced-frf"]
    assert paper["status"] == "converged"
    assert paper["error_max"] < 1e-6
    assert paper["values"]["unit 2.stiffness"] == pytest.approx(1 / 0.3)
    assert paper["values"]["unit 3.loss_factor"] == pytest.approx(0.6)
    assert paper["fewest"]["count"] == 2
    assert paper["n_unknowns"] == 12
    assert paper["seconds"] > 0
    # The paper's criticism: with independently reduced matrices the FRF is further off than before.
    before, after = (
        reduced["correlation"]["fitted"][when]["db_error_median"] for when in ("before", "after")
    )
    assert after > 2 * before > 4
    assert reduced["error_max"] is None or reduced["error_max"] > 1
    assert reduced["fewest"]["count"] is None
    assert rows["rfm"]["seconds"] is None
    assert rows["rfm"]["left"] == found["unknowns"]


def test_the_page_has_the_papers_figure(ran: tuple[Path, int, str]) -> None:
    text = (ran[0] / "compare.html").read_text(encoding="utf-8")
    figures = json.loads(re.search(r'id="updyn-figures">(.*?)</script>', text)[1])
    assert [t["name"] for t in figures["pair"]["data"]] == [
        "measured",
        "before",
        "after, equation-error",
        "after, reduced-frf",
    ]
    assert "https://" not in text.replace("https://plotly", "").split("<script>")[0]


def test_options_of_the_job_go_to_its_method_and_the_folder_is_beside_it(inputs: Path) -> None:
    """The published job: plain iteration, five steps; its data leave one combination open."""
    assert main(["compare", str(inputs / "job.toml"), "--methods", "equation-error, log"]) == 0
    found = json.loads((inputs / "job-compare" / "compare.json").read_text(encoding="utf-8"))
    paper, log = found["rows"]
    assert paper["iterations"] <= 5
    assert (paper["status"], log["status"]) == ("not-identifiable", "not-identifiable")
    assert found["truth"] is None
    assert paper["error_max"] is None
    assert paper["fewest"] is None


def test_several_tests(inputs: Path, tmp_path: Path) -> None:
    job = (
        (inputs / "compare_stiffness.toml")
        .read_text(encoding="utf-8")
        .replace('"known', f'"{inputs}/known')
    )
    one = (
        f'[[test]]\nname = "one"\nfile = "{inputs}/compare_stiffness.uff"\nresponses = ["1:RZ",'
        ' "2:RZ"]\n'
    )
    two = one.replace("one", "two").replace('"1:RZ", "2:RZ"', '"3:RZ", "4:RZ"')
    (tmp_path / "two.toml").write_text(
        job.replace('[test]\nfile = "compare_stiffness.uff"\n', one + two), "utf-8"
    )
    assert main(["compare", str(tmp_path / "two.toml"), "--methods", "log,maximum-likelihood"]) == 0
    found = json.loads((tmp_path / "two-compare" / "compare.json").read_text(encoding="utf-8"))
    assert [row["n_lines"] for row in found["rows"]] == [60, 60]
    assert found["rows"][0]["values"]["unit 2.loss_factor"] == pytest.approx(0.4)
    assert "2 tests" in (tmp_path / "two-compare" / "compare.html").read_text(encoding="utf-8")


def test_measured_modes_go_to_the_methods_that_take_them(inputs: Path, tmp_path: Path) -> None:
    frf = updyn.response(
        true_model(), np.linspace(0.8, 143.0, 600), [f"{i}:RZ" for i in (1, 2, 3, 4)], ["2:RZ"]
    )
    updyn.write_modes(updyn.identify_modes(frf), inputs / "modes.uff")
    text = (inputs / "compare_stiffness.toml").read_text(encoding="utf-8")
    file = 'file = "compare_stiffness.uff"\n'
    (inputs / "modes.toml").write_text(
        text.replace(file, f'{file}modes = "modes.uff"\n'), encoding="utf-8"
    )
    words = ["compare", str(inputs / "modes.toml"), "--methods", "equation-error,modal", "--fewest"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    paper, modal = found["rows"]
    assert paper["status"] == "converged"
    assert modal["left"] == [f"unit {e}.loss_factor" for e in range(1, 7)]
    assert modal["lines_solved"] < paper["lines_solved"]  # it identifies nothing from FRFs
    assert "does not depend on the lines" in modal["fewest"]["note"]


def test_no_method_with_an_answer_says_3(inputs: Path, tmp_path: Path) -> None:
    words = [
        "compare",
        str(inputs / "compare.toml"),
        "--methods",
        "reduced-frf,rfm",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 3
    assert (tmp_path / "out" / "compare.html").exists()


def test_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(METHODS)
    assert next(line for line in lines if line.startswith("equation-error")).endswith(
        "Bao, Wang & Cheng 2010"
    )


# -- refusals --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "equation-eror"], "did you mean 'equation-error'"),
        (["--methods", ""], "expected at least one"),
        (["--methods", "log,log"], "occurs twice"),
        (["--truth", "gone.toml"], "gone.toml: the true values cannot be read: No such file"),
        (
            ["--truth", "wrong.toml"],
            "wrong.toml: 'unit 1.stifness' is not an unknown of the job; did you mean",
        ),
        (["--truth", "text.toml"], "'unit 1.stiffness': expected a finite number, found 'much'"),
        (["--truth", "broken.json"], "broken.json: not JSON"),
        (["--truth", "empty.toml"], "contains no true value"),
        (["--tolerance", "0"], "expected a number above 0"),
        (["--chosen", "randomly"], "valid: 'd-optimal', 'even'"),
        (["--workers", "0"], "expected a number of processes"),
        (["--fewset"], "--fewset"),
    ],
)
def test_bad_input_is_one_message_and_writes_nothing(
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.toml").write_text('["unit 1"]\nstifness = 1.0\n', encoding="utf-8")
    (tmp_path / "text.toml").write_text('["unit 1"]\nstiffness = "much"\n', encoding="utf-8")
    (tmp_path / "broken.json").write_text("{", encoding="utf-8")
    (tmp_path / "empty.toml").write_text("", encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    assert main(["compare", str(inputs / "compare.toml"), "--out", "new/folder", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    said = " ".join(err.split())
    assert message in said
    assert said.count("error:") == 1
    assert "compare.toml:" not in said  # nothing is wrong with the job
    assert "Traceback" not in err
    assert sorted(tmp_path.iterdir()) == before


def test_a_job_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare"]) == 2
    assert "which job?" in capsys.readouterr().err


def test_a_folder_that_cannot_be(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    assert main(["compare", str(inputs / "compare.toml"), "--out", str(tmp_path / "file")]) == 2
    assert "is a file; choose another with --out" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


# -- stopping --------------------------------------------------------------------------------------------------
def test_stopped_by_the_user_says_130_and_keeps_the_rows_so_far(
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stop_in_the_second(
        self: ProgressDisplay, progress: updyn.updating.fit.monitor.Progress
    ) -> bool:
        return progress.stage.startswith("output-error")

    monkeypatch.setattr(ProgressDisplay, "__call__", stop_in_the_second)
    words = [
        "compare",
        str(inputs / "compare.toml"),
        "--methods",
        "equation-error,output-error,log",
    ]
    assert main([*words, "--out", str(tmp_path)]) == 130
    found = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    assert found["stopped"] is True
    assert [(row["method"], row["status"]) for row in found["rows"]] == [
        ("equation-error", "converged"),
        ("output-error", "stopped"),
    ]
    assert found["not_run"] == ["log"]
    assert "Stopped; not run: log." in capsys.readouterr().out
    assert "The user stopped the comparison" in (tmp_path / "compare.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to send")
def test_ctrl_c(inputs: Path, tmp_path: Path) -> None:
    words = ["compare", str(inputs / "compare.toml"), "--fewest", "--methods", METHODS_HERE]
    words += ["--out", str(tmp_path / "out")]
    with subprocess.Popen(
        [sys.executable, "-m", "updyn", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("stage "):
                os.kill(process.pid, signal.SIGINT)
                break
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Stopping after this step" in err
    found = json.loads((tmp_path / "out" / "compare.json").read_text(encoding="utf-8"))
    assert found["stopped"] is True
    assert [row["method"] for row in found["rows"]] + found["not_run"] == METHODS_HERE.split(",")
