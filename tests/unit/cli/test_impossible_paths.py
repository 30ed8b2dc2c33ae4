"""Paths that no file can have, in every key of a job that names one: one message, no traceback."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain
from updyn.job import check_out, load_job

MODEL = '[model]\nfile = "chain.h5"\n'
TEST = '[test]\nfile = "chain.npz"\n'
UNKNOWN = '[[parameter]]\ngroups = "all"\nquantity = "stiffness"\n'
#: The job, and the line on which its path is.
JOBS = {
    "model.file": (f"[model]\nfile = PATH\n{TEST}{UNKNOWN}", 2),
    "test.file": (f"{MODEL}[test]\nfile = PATH\n{UNKNOWN}", 4),
    "test.modes": (f"{MODEL}{TEST}modes = PATH\n{UNKNOWN}", 5),
    "test.repeats": (f"{MODEL}{TEST}repeats = [PATH]\n{UNKNOWN}", 5),
    "match.geometry": (f"{MODEL}{TEST}{UNKNOWN}[match]\ngeometry = PATH\n", 9),
}
COMMANDS = ("check", "run", "correlate", "compare", "plan", "plant")
#: Commands that do not read what a key names.
UNREAD = {
    ("plan", "test.file"),
    ("plan", "test.modes"),
    ("plan", "test.repeats"),
    ("plan", "match.geometry"),
}


@pytest.fixture
def folder(chain_folder: Path) -> Path:
    (chain_folder / "loop.h5").symlink_to("loop.h5")
    (chain_folder / "first.h5").symlink_to("second.h5")
    (chain_folder / "second.h5").symlink_to("first.h5")
    return chain_folder


@pytest.mark.skipif(os.name != "posix", reason="links need privileges elsewhere")
@pytest.mark.parametrize(
    "path", ["a\\u0000b.h5", "loop.h5", "first.h5", "loop.h5/inner.h5", "x" * 300]
)
@pytest.mark.parametrize("key", JOBS)
def test_a_path_that_no_file_can_have_is_refused_by_every_command(
    key: str, path: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, line = JOBS[key]
    job = folder / "job.toml"
    job.write_text(text.replace("PATH", f'"{path}"'), encoding="utf-8")
    before = sorted(folder.rglob("*"))
    for command in COMMANDS:
        if (command, key) in UNREAD:
            continue
        code = main([command, str(job)])
        err = capsys.readouterr().err
        assert code == 2, (command, err)
        if command not in ("plan", "plant"):
            assert err.startswith(f"error: {job}:{line}: {key} = "), (command, err)
        assert "no such file" in err or command in ("plan", "plant")
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_name_of_an_output_that_no_file_can_have(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = folder / "job.toml"
    table = '[output]\nproperties = "a\\u0000b.csv"\n'
    job.write_text(f"{MODEL}{TEST}{UNKNOWN}{table}", encoding="utf-8")
    assert main([command, str(job)]) == 2
    assert "properties" in (err := capsys.readouterr().err) or "no file can have that name" in err


def test_a_folder_of_results_that_cannot_be(folder: Path) -> None:
    (folder / "job.toml").write_text(f"{MODEL}{TEST}{UNKNOWN}", encoding="utf-8")
    with pytest.raises(updyn.UpdynError, match="no folder can have that name"):
        check_out(load_job(folder / "job.toml"), "a\0b")


@pytest.mark.skipif(os.name != "posix", reason="links need privileges elsewhere")
@pytest.mark.parametrize(
    "words",
    [
        ["info", "loop.h5"],
        ["convert", "loop.h5", "out.npz"],
        ["convert", "loop.h5", "chain.h5", "--force"],
        ["convert", "chain.h5", "loop.h5"],
        ["new", "loop.h5", "chain.npz"],
        ["new", "chain.h5", "loop.h5"],
        ["new", "chain.h5", "chain.npz", "--out", "loop.h5"],
        ["new", "chain.h5", "chain.npz", "--out", "loop.h5/job.toml"],
        ["run", "loop.h5"],
        ["check", "loop.h5"],
        ["run", "job.toml", "--out", "loop.h5"],
        ["run", "job.toml", "--out", "loop.h5/out"],
        ["check", "job.toml", "--out", "loop.h5"],
        ["compare", "job.toml", "--truth", "loop.h5"],
        ["demo", "chain", "--out", "loop.h5"],
        ["demo", "chain", "--out", "loop.h5/out"],
        ["frf", "loop.h5"],
        ["modes", "loop.h5"],
        ["modes", "job.toml", "--out", "loop.h5"],
        ["plan", "loop.h5"],
        ["plant", "loop.h5"],
        ["plant", "job.toml", "--run", "loop.h5"],
    ],
)
def test_links_to_themselves_on_the_command_line(
    words: list[str],
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    plant = '[plant]\ninputs = "2:X"\noutputs = "12:X"\nband = [0.6, 15.0]\n'
    Path("job.toml").write_text(f"{MODEL}{TEST}{UNKNOWN}{plant}", encoding="utf-8")
    before = sorted(folder.rglob("*"))
    assert main(words) == 2
    assert capsys.readouterr().err.count("error:") == 1
    assert sorted(folder.rglob("*")) == before


def test_readers_and_writers_refuse_a_null_character(folder: Path) -> None:
    model, frf = chain.build(), chain.measure()
    for read in (updyn.read_model, updyn.read_frf, updyn.read_result, updyn.read_modes):
        with pytest.raises(updyn.UpdynError):
            read(str(folder / "a\0b.h5"))
    with pytest.raises(updyn.UpdynError):
        updyn.write_model(model, folder / "a\0b.h5")
    with pytest.raises(updyn.UpdynError):
        updyn.write_frf(frf, folder / "a\0b.npz")
    result = updyn.update(model, frf, updyn.parameters(model, stiffness="all"), max_iterations=1)
    for write, name in (
        (updyn.write_result, "a\0b.nc"),
        (updyn.write_report, "a\0b.html"),
    ):
        with pytest.raises(updyn.UpdynError):
            write(result, folder / name)
    with pytest.raises(updyn.UpdynError):
        updyn.update(
            model,
            frf,
            updyn.parameters(model, stiffness="all"),
            max_iterations=1,
            checkpoint=folder / "a\0b",
        )
