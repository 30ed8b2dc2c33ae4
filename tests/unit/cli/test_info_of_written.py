"""`updyn info` of every file that the commands write: what it is, or where to look."""

from __future__ import annotations

from pathlib import Path

import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain

JOB = """\
title = "Chain"
[model]
file = "../chain.h5"
[test]
file = "../chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
starts = 0
[uncertainty]
kind = "profile"
[plant]
inputs = "2:X"
outputs = "12:X"
band = [0.6, 15.0]
[plan]
n_sensors = 2
band = [0.5, 15.0]
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the results of all commands, in folders of their names."""
    folder = tmp_path_factory.mktemp("written")
    updyn.write_model(chain.build(), folder / "chain.h5")
    updyn.write_frf(chain.measure(), folder / "chain.npz")
    inputs = folder / "inputs"
    inputs.mkdir()
    job = inputs / "job.toml"
    job.write_text(JOB, encoding="utf-8")
    for command in ("run", "check", "correlate", "modes", "plan"):
        assert main([command, str(job), "--out", str(folder / command)]) in (0, 3)
    words = ["--methods", "log,output-error", "--out", str(folder / "compare")]
    assert main(["compare", str(job), *words]) in (0, 3)
    return folder


def info(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    capsys.readouterr()
    code = main(["info", str(path)])
    out, err = capsys.readouterr()
    assert (out == "") == (code == 2)
    assert err.count("error:") == (code == 2)
    return code, out + err


def test_every_file_has_an_answer(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [path for path in sorted(written.rglob("*")) if path.is_file()]
    assert len(paths) > 25
    for path in paths:
        code, text = info(path, capsys)
        assert code == (2 if path.name == "job.toml" else 0), text
        assert "could not be read" not in text, path


@pytest.mark.parametrize(
    ("name", "fragments"),
    [
        ("run/result.json", ["Result of an update", "'Chain': not-credible (maximum-likelihood)"]),
        ("run/manifest.json", ["Files that updyn wrote", "result.json", "unchanged"]),
        ("run/control.json", ["Plant for control design, 'Chain'", "0.6 to 15 Hz", "order"]),
        ("run/report.html", ["Page of updyn", "Chain", "browser"]),
        ("run/plant.h", ["C99 header of a plant", "plant.json"]),
        ("run/uncertainty.nc", ["part1.stiffness"]),
        ("check/check.html", ["Page of updyn"]),
        ("compare/compare.json", ["Comparison of methods", "log", "output-error", "converged"]),
        ("plan/plan.json", ["Test plan", "responses", "part1.stiffness"]),
        ("inputs/job.toml", ["looks like a job file", "updyn check"]),
    ],
)
def test_what_is_in_a_file(
    name: str, fragments: list[str], written: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, text = info(written / name, capsys)
    for fragment in fragments:
        assert fragment in text


def test_values_are_those_of_the_result(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = updyn.read_result(written / "run" / "run.nc")
    _, text = info(written / "run" / "result.json", capsys)
    for name, value in result.values.items():
        (row,) = (line.split() for line in text.splitlines() if line.startswith(name))
        assert float(row[2]) == pytest.approx(value, rel=1e-5)
        assert float(row[3]) == pytest.approx(result.std[name], rel=1e-2)
    assert "run.nc" in text


def test_a_file_that_was_changed_or_is_gone_is_told_by_the_manifest(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("manifest.json", "result.json", "report.html"):
        (tmp_path / name).write_bytes((written / "run" / name).read_bytes())
    with (tmp_path / "report.html").open("a", encoding="utf-8") as file:
        file.write(" ")
    _, text = info(tmp_path / "manifest.json", capsys)
    rows = {line.split()[0]: line for line in text.splitlines()[1:]}
    assert rows["result.json"].endswith("unchanged")
    assert rows["report.html"].endswith("changed since")
    assert rows["run.nc"].endswith("missing")


def test_the_journal_of_a_run_is_named(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all")
    journal = tmp_path / "run.journal"
    updyn.update(model, frf, unknowns, starts=0, max_iterations=1, checkpoint=journal)
    code, text = info(journal, capsys)
    assert code == 0
    assert "updyn run JOB.toml --resume" in text


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", '{"a": 1, "b": 2}', "none of the files that updyn writes; its keys: 'a', 'b'"),
        ("a.json", "[1, 2]", "found a list; expected the items of a plant"),
        ("a.json", '{"status": ', "JSON"),
        ("a.html", "<!DOCTYPE html><html><title>News</title>", "a page of another program"),
        ("a.h", "#define A 1\n", "neither content nor suffix '.h' is of a known format of"),
        ("result.json", '{"status": 1, "parameters": 2, "method": 3}', "result.json"),
        (
            "result.json",
            '{"status": "x", "parameters": [{"name": 3}], "method": "y"}',
            "parameters",
        ),
        ("manifest.json", '{"format": "updyn manifest", "schema": 1, "files": 3}', "files"),
        ("compare.json", '{"rows": 5, "unknowns": [], "stopped": false}', "rows"),
    ],
)
def test_other_files_of_these_kinds_are_refused(
    name: str, content: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    code, text = info(path, capsys)
    assert code == 2
    assert message in text
    assert len(text.splitlines()) == 1


# -- arguments in the wrong order -------------------------------------------------------------------
def test_new_with_swapped_arguments_says_so(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(chain_folder)
    updyn.write_frf(chain.measure(), "chain.unv")
    for test in ("chain.npz", "chain.unv"):
        assert main(["new", test, "chain.h5"]) == 2
        err = capsys.readouterr().err
        assert err == (
            f"error: {test} is a measurement and chain.h5 a model: swap the two:"
            f" updyn new chain.h5 {test}\n"
        )
    updyn.write_frf(chain.measure(), "my test.npz")
    assert main(["new", "my test.npz", "chain.h5", "--quantity", "accelerance"]) == 2
    assert "swap the two: updyn new chain.h5 'my test.npz'" in capsys.readouterr().err
    assert not Path("job.toml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["chain.npz", "chain.npz"], "chain.npz is a measurement; expected a model first"),
        (["chain.h5", "chain.h5"], "chain.h5 is a model; expected a measurement second"),
        (["job.toml", "chain.npz"], "looks like a job file"),
        (["chain.h5", "job.toml"], "job.toml is a job; expected a measurement second"),
    ],
)
def test_new_names_what_was_given(
    words: list[str],
    message: str,
    chain_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(chain_folder)
    Path("job.toml").write_text('[model]\nfile = "chain.h5"\n', encoding="utf-8")
    assert main(["new", *words, "--out", "new.toml"]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("error:") == 1
    assert not Path("new.toml").exists()


@pytest.mark.parametrize("name", ["chain.h5", "result.json"])
def test_a_file_that_is_no_job_is_told_by_its_suffix(
    name: str, chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (chain_folder / "result.json").write_text("{}", encoding="utf-8")
    for command in ("check", "run", "correlate"):
        assert main([command, str(chain_folder / name)]) == 2
        err = capsys.readouterr().err
        assert f"expected a job file (TOML), and updyn info {name} prints what" in err
