"""Files of a user in a folder of results: named and refused before any work, and never touched."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import updyn
from updyn.cli import main
from updyn.job import check_out, load_job
from updyn.outputs.lock import lock_folder
from updyn.outputs.manifest import Entry, Manifest, file_digest

JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[uncertainty]
kind = "profile"
[plant]
inputs = "2:X"
outputs = "12:X"
band = [0.6, 22.0]
[output]
report = true
"""


@pytest.fixture
def job(chain_folder: Path) -> Path:
    path = chain_folder / "job.toml"
    path.write_text(JOB, encoding="utf-8")
    return path


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fit, comparison or plant is begun."""

    def begun(*_: object, **__: object) -> None:
        pytest.fail("the work was begun")

    for name in ("job.run.update", "job.comparison.compare", "control.job.plant_job.make_plant"):
        monkeypatch.setattr(f"updyn.{name}", begun)


WRITTEN = {
    "run": (
        *("plant.mat", "plant.json", "plant.h", "plant.html", "control.json", "uncertainty.nc"),
        *("report.html", "model.h5", "run.nc", "job.toml", "result.json"),
    ),
    "compare": ("compare.html", "compare.json"),
    "plant": ("plant.mat", "plant.json", "plant.h", "plant.html", "control.json"),
}


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("verb", WRITTEN)
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_each_is_named_and_stays(
    verb: str, kind: str, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = job.parent / "out"
    for name in WRITTEN[verb]:
        out.mkdir()
        if kind == "file":
            (out / name).write_text("mine")
        elif kind == "folder":
            (out / name).mkdir()
        else:
            (out / name).symlink_to(job.parent / "nowhere")
        assert main([verb, str(job), "--out", str(out)]) == 2
        err = capsys.readouterr().err
        assert f"{str(out / name)!r} " in err
        assert "choose another --out" in err
        assert [p.name for p in out.iterdir()] == [name]
        assert kind != "file" or (out / name).read_text() == "mine"
        (out / name).rmdir() if kind == "folder" else (out / name).unlink()
        out.rmdir()


@pytest.mark.usefixtures("no_work")
def test_results_without_a_manifest_are_a_users(
    job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As versions before the first left them; all are named at once."""
    out = job.parent / "job"
    out.mkdir()
    for name in WRITTEN["run"]:
        (out / name).write_text("mine")
    assert main(["check", str(job)]) == 2
    assert main(["run", str(job)]) == 2
    err = capsys.readouterr().err
    assert all(f"{str(out / name)!r} was not written by updyn" in err for name in WRITTEN["run"])
    assert {p.name for p in out.iterdir()} == set(WRITTEN["run"])


def test_a_result_that_was_edited_is_kept_until_it_is_moved(
    job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = '[method]\nname = "output-error"\nmax_iterations = 1\n[output]\nreport = false\n'
    job.write_text(JOB.split("[uncertainty]")[0] + short, encoding="utf-8")
    assert main(["run", str(job)]) == 3
    out, loaded = job.parent / "job", load_job(job)
    assert check_out(loaded) == out  # may be replaced
    with (out / "result.json").open("a", encoding="utf-8") as file:
        file.write("\n")
    capsys.readouterr()
    assert main(["run", str(job)]) == 2
    said = f"{str(out / 'result.json')!r} has been changed since updyn wrote it"
    assert said in capsys.readouterr().err
    (out / "result.json").rename(out / "mine.json")
    assert check_out(loaded) == out
    out.rename(job.parent / "moved")
    assert check_out(loaded, job.parent / "moved") == job.parent / "moved"


SHORT = '[method]\nname = "output-error"\nmax_iterations = 1\n[output]\nreport = false\n'


def forge(folder: Path, *names: str, command: str = "run") -> None:
    """List files of a folder as if a command had written them."""
    entries = dict(Manifest.read(folder).entries)
    for name in names:
        entries[name] = Entry(file_digest(folder / name), "0" * 16, command)
    Manifest(entries).write(folder)


def test_a_forged_manifest_costs_no_file_of_a_user(
    job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names that no command writes stay; names that one writes go, as those of an earlier run."""
    job.write_text(JOB.split("[uncertainty]")[0] + SHORT, encoding="utf-8")
    out = job.parent / "out"
    for name in ("thesis.docx", "data/frf.uff", ".profile", "plant.html", "left/run.nc"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(name)
    mine = ("thesis.docx", "data/frf.uff", ".profile")
    forge(out, *mine, "plant.html", "left/run.nc")
    assert main(["run", str(job), "--out", str(out)]) == 3
    assert "other names: '.profile', 'data/frf.uff', 'thesis.docx'; " in capsys.readouterr().err
    assert [(out / name).read_text() for name in mine] == list(mine)
    assert not (out / "plant.html").exists()
    assert not (out / "left").exists()


def test_a_forged_manifest_costs_no_job_file_of_a_user(
    job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``job.toml`` is a name that users give their own files, too."""
    job.write_text(JOB.split("[uncertainty]")[0] + SHORT, encoding="utf-8")
    other = job.with_name("other.toml")
    other.write_text(job.read_text(encoding="utf-8"), encoding="utf-8")
    forge(job.parent, "job.toml")
    before = job.read_bytes()
    assert main(["run", str(other), "--out", str(job.parent)]) == 2
    assert f"{str(job)!r} was not written by a run" in capsys.readouterr().err
    assert job.read_bytes() == before


@pytest.mark.parametrize("key", ["model", "test"])
def test_a_run_removes_no_input_of_its_own_job(
    key: str, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The model of an earlier run of two tests starts a run of one test, in the same folder."""
    text = JOB.split("[uncertainty]")[0] + SHORT
    out = job.parent / "out"
    (out / "first").mkdir(parents=True)
    name, inner = {
        "model": ("chain.h5", "first/model.h5"),
        "test": ("chain.npz", "first/run.nc"),
    }[key]
    (out / inner).write_bytes((job.parent / name).read_bytes())
    forge(out, inner)
    more = '\nformat = "npz"' if key == "test" else ""
    job.write_text(text.replace(f'"{name}"', f'"out/{inner}"{more}'), encoding="utf-8")
    assert main(["run", str(job), "--out", str(out)]) == 3, capsys.readouterr().err
    assert (out / inner).read_bytes() == (job.parent / name).read_bytes()


@pytest.mark.skipif(os.name == "nt", reason="needs flock")
@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("verb", ["run", "compare", "plant"])
def test_a_folder_that_another_process_writes_to(
    verb: str, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = job.parent / "out"
    out.mkdir()
    with lock_folder(out):
        assert main([verb, str(job), "--out", str(out)]) == 2
    assert f"{str(out)!r} is being written to by updyn process" in capsys.readouterr().err
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("name", ["manifest.json", "run.journal", ".updyn.lock", ".updyn.switch"])
def test_names_that_the_folder_needs_itself(
    name: str, job: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = JOB.split("[uncertainty]")[0] + f'[output]\nproperties = "{name}"\n'
    job.write_text(text, encoding="utf-8")
    assert main(["check", str(job)]) == 2
    assert "expected a file name that no other output has" in capsys.readouterr().err


def test_a_name_that_no_file_can_have(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = 300 * "p" + ".h5"
    text = JOB.split("[uncertainty]")[0] + f'[output]\nproperties = "{name}"\n'
    job.write_text(text, encoding="utf-8")
    assert main(["check", str(job)]) == 2
    line = len(text.splitlines())
    assert f"job.toml:{line}: output.properties = {name!r}: " in capsys.readouterr().err


# -- other commands --------------------------------------------------------------------------------
def test_inputs_of_a_demo_that_were_edited_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("updyn.cli.commands._run_job", lambda *_: pytest.fail("the work was begun"))
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    (inputs / "job.toml").write_text("mine")
    assert main(["demo", "chain", "--out", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert f"{str(inputs / 'job.toml')!r} was not written by updyn" in err
    assert [p.name for p in inputs.iterdir()] == ["job.toml"]
    assert (inputs / "job.toml").read_text() == "mine"


def test_convert_asks_before_it_writes_over_a_file_beside_its_target(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = str(chain_folder / "chain.h5"), str(chain_folder / "new.toml")
    words = ["convert", source, target, "--to", "mtx"]
    assert main(words) == 0
    made = {p.name for p in chain_folder.iterdir() if p.name.startswith("new")}
    assert len(made) > 2
    (chain_folder / "new.toml").unlink()
    beside = sorted(made - {"new.toml"})[0]
    (chain_folder / beside).write_text("mine")
    before = sorted(chain_folder.iterdir())
    assert main(words) == 2
    assert f"{chain_folder / beside}: exists already; --force" in capsys.readouterr().err
    assert (chain_folder / beside).read_text() == "mine"
    assert sorted(chain_folder.iterdir()) == before
    assert main([*words, "--force"]) == 0
    assert updyn.read_model(target).n_dofs == 12
