"""Folders of results: kills at every step of a switch, foreign files, two processes at once."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from killed import contents, killed_at, outcome, write_set
from updyn.errors import FormatError, InputError
from updyn.outputs.lock import LOCK, InUseError, lock_folder
from updyn.outputs.manifest import (
    MANIFEST,
    Manifest,
    file_digest,
    find_obstacles,
    is_inside,
    is_output,
)
from updyn.outputs.switch import recover, replace_files

OLD = {"model.h5": "old", "result.json": "old", "plant.mat": "old", "tip held/run.nc": "old"}
NEW = {"model.h5": "new", "result.json": "new", "report.html": "new", "as is/run.nc": "new"}
FOREIGN = {"notes.txt": "mine", "tip held/notes.txt": "mine"}

posix = pytest.mark.skipif(os.name == "nt", reason="needs fork and flock")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with results of a run, and files of a user."""
    out = tmp_path / "out"
    write_set(out, OLD)
    for name, text in FOREIGN.items():
        (out / name).write_text(text, encoding="utf-8")
    return out


# -- a switch --------------------------------------------------------------------------------------
def test_a_set_replaces_the_one_before_and_nothing_else(folder: Path) -> None:
    write_set(folder, NEW)
    assert contents(folder) == {**NEW, **FOREIGN}
    assert set(Manifest.read(folder).entries) == set(NEW)
    assert [p.name for p in folder.iterdir() if p.name.startswith(".")] == []


def test_a_block_that_raises_leaves_the_old_set(folder: Path) -> None:
    def fail() -> None:
        with replace_files(folder, "run", tuple(NEW)) as new:
            (new / "model.h5").write_text("new")
            raise ZeroDivisionError

    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}
    with pytest.raises(ZeroDivisionError):
        fail()
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()} == before


@posix
def test_a_kill_at_any_step_leaves_the_old_or_the_new_set(folder: Path, tmp_path: Path) -> None:
    """Two sets change places until a switch ends before the call at which it would be killed."""
    found, number, sets = set(), 0, [OLD, NEW]
    while killed_at(number, lambda: write_set(folder, sets[1])):
        recover(folder)
        now = contents(folder)
        assert now in ({**sets[0], **FOREIGN}, {**sets[1], **FOREIGN}), f"killed at call {number}"
        assert list(folder.glob(".*ished-*")) == []
        found.add("new" if now == {**sets[1], **FOREIGN} else "old")
        if now == {**sets[1], **FOREIGN}:
            sets.reverse()
        number += 1
    assert found == {"old", "new"}
    assert number > 30


@posix
@pytest.mark.parametrize("seed", range(12))
def test_kills_at_random(seed: int, tmp_path: Path) -> None:
    assert outcome(seed, tmp_path) in ("old", "new")


@posix
def test_the_new_set_is_on_disk_before_it_counts(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: set[int] = set()
    fsync, rename = os.fsync, os.rename
    checked = []

    def check(source: Path, target: Path) -> None:
        if Path(target).name.startswith(".finished-"):
            files = [Path(source), *Path(source).rglob("*")]
            assert {p.stat().st_ino for p in files} <= synced
            checked.append(len(files))
        rename(source, target)

    monkeypatch.setattr(os, "fsync", lambda n: (synced.add(os.fstat(n).st_ino), fsync(n)))
    monkeypatch.setattr(os, "rename", check)
    write_set(folder, NEW)
    assert checked == [len(NEW) + 4]  # manifest, plan, and the folders


@posix
def test_a_file_that_came_up_after_a_kill_is_kept(folder: Path) -> None:
    for number in range(100):
        assert killed_at(number, lambda: write_set(folder, NEW))
        if list(folder.glob(".finished-*")) and not (folder / "report.html").exists():
            break
        recover(folder)
        write_set(folder, OLD)
    (folder / "report.html").write_text("mine")
    with pytest.raises(
        InputError, match=r"'report.html' has been changed .* new results are in .*finished-"
    ):
        recover(folder)
    assert (folder / "report.html").read_text() == "mine"
    (folder / "report.html").unlink()
    recover(folder)
    assert contents(folder) == {**NEW, **FOREIGN}


def test_a_file_that_comes_up_while_a_run_goes_on_is_kept(folder: Path) -> None:
    def late() -> None:
        with replace_files(folder, "run", tuple(NEW)) as new:
            (new / "report.html").write_text("new")
            (folder / "report.html").write_text("mine")

    with pytest.raises(InputError, match=r"'report.html' was not written by updyn; the results"):
        late()
    assert contents(folder).items() >= {**OLD, **FOREIGN, "report.html": "mine"}.items()
    (aside,) = folder.glob("results-*")
    assert contents(aside) == {"report.html": "new"}
    assert find_obstacles(aside, ["report.html"]) == {}


def test_a_plan_from_elsewhere_reaches_no_file_outside(tmp_path: Path) -> None:
    out, precious = tmp_path / "out", tmp_path / "precious"
    hostile = out / ".finished-0123456789abcdef"
    hostile.mkdir(parents=True)
    precious.write_text("mine")
    digest = "0" * 64
    for plan in (
        {"moved": {}, "removed": {"../precious": digest}},
        {"moved": {str(precious): [None, digest]}, "removed": {}},
        {"moved": {"a/../../precious": [None, digest]}, "removed": {}},
        {"moved": [], "removed": {}},
        [],
    ):
        (hostile / ".updyn.switch").write_text(json.dumps(plan))
        with pytest.raises(FormatError, match="is not a plan of a switch"):
            recover(out)
    assert precious.read_text() == "mine"


def interrupted(folder: Path, moved: dict[str, str], removed: list[str]) -> Path:
    """A switch as a kill leaves it, made by hand: new content by name, and names that go."""
    waiting = folder / ".finished-0123456789abcdef"
    waiting.mkdir(parents=True)
    pairs = {}
    for name, text in moved.items():
        (waiting / name).parent.mkdir(parents=True, exist_ok=True)
        (waiting / name).write_text(text, encoding="utf-8")
        target = folder / name
        pairs[name] = [
            file_digest(target) if target.is_file() else None,
            file_digest(waiting / name),
        ]
    digests = {name: file_digest(folder / name) for name in removed}
    plan = json.dumps({"moved": pairs, "removed": digests})
    (waiting / ".updyn.switch").write_text(plan, encoding="utf-8")
    return waiting


def test_a_forged_switch_removes_and_replaces_no_file_of_a_user(folder: Path) -> None:
    """The digests are right; no command writes these names."""
    removed = ["notes.txt", "tip held/notes.txt", "model.h5"]
    interrupted(folder, {"run.nc": "new"}, removed)
    recover(folder)
    assert contents(folder) == {
        **{name: text for name, text in OLD.items() if name != "model.h5"},
        **FOREIGN,
        "run.nc": "new",
    }
    waiting = interrupted(folder, {"notes.txt": "forged"}, [])
    with pytest.raises(InputError, match=r"'notes.txt' .* move the file"):
        recover(folder)
    assert (folder / "notes.txt").read_text() == "mine"
    assert (waiting / "notes.txt").read_text() == "forged"


@pytest.mark.parametrize(
    "name", [".updyn.lock", "run.journal", ".unfinished-0123456789abcdef/b", "a/.updyn.switch"]
)
def test_a_forged_switch_reaches_no_reserved_name(folder: Path, name: str) -> None:
    interrupted(folder, {name: "forged"}, [])
    with pytest.raises(FormatError, match="is not a plan of a switch"):
        recover(folder)
    assert not (folder / name).exists()


@posix
def test_links_in_a_forged_set_lead_nowhere(folder: Path, tmp_path: Path) -> None:
    private = tmp_path / "private"
    private.mkdir()
    (private / "run.nc").write_text("mine")
    waiting = folder / ".finished-0123456789abcdef"
    for kind in ("finished", "unfinished"):
        forged = folder / f".{kind}-0123456789abcdef"
        forged.mkdir()
        (forged / "tip held").symlink_to(private)
        plan = {
            "moved": {"tip held/run.nc": [None, file_digest(private / "run.nc")]},
            "removed": {},
        }
        (forged / ".updyn.switch").write_text(json.dumps(plan))
        if kind == "finished":
            with pytest.raises(FormatError, match="is not a plan of a switch"):
                recover(folder)
            (waiting / "tip held").unlink()
            (waiting / ".updyn.switch").unlink()
            waiting.rmdir()
        else:
            recover(folder)
            assert not forged.exists()
        assert (private / "run.nc").read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("model.h5", True),
        ("tip held/run.nc", True),
        ("a/b/run.nc", False),
        (".hidden/run.nc", False),
        ("../run.nc", False),
        ("/run.nc", False),
        ("notes.txt", False),
        ("manifest.json", False),
        ("run.journal", False),
        (".updyn.lock", False),
        ("", False),
    ],
)
def test_names_that_commands_write(name: str, is_one: bool) -> None:
    assert is_output(name) == is_one


@pytest.mark.parametrize("name", ["..", "a/../b", "/a", "C:/a", "C:a", "a\\b", "", ".", "a\0"])
def test_names_outside_a_folder(name: str) -> None:
    assert not is_inside(name)


# -- whose a file is -------------------------------------------------------------------------------
def test_what_may_not_be_replaced_is_named_with_the_reason(folder: Path, tmp_path: Path) -> None:
    (folder / "model.h5").write_text("mine")
    (folder / "plant.mat").unlink()
    (folder / "plant.mat").symlink_to(tmp_path / "elsewhere")
    (folder / "result.json").unlink()
    (folder / "result.json").mkdir()
    (folder / "report.html").write_text("mine")
    (folder / "as is").write_text("mine")
    assert find_obstacles(folder, [*OLD, *NEW]) == {
        "model.h5": "has been changed since updyn wrote it",
        "plant.mat": "is a link",
        "result.json": "is a folder",
        "report.html": "was not written by updyn",
        "as is/run.nc": "'as is' is not a folder",
    }


def test_a_folder_that_is_copied_or_moved_is_known_again(folder: Path, tmp_path: Path) -> None:
    folder.rename(tmp_path / "moved")
    assert find_obstacles(tmp_path / "moved", OLD) == {}


def test_a_stale_file_that_a_user_has_changed_stays(folder: Path) -> None:
    (folder / "plant.mat").write_text("mine")
    write_set(folder, NEW)
    assert contents(folder) == {**NEW, **FOREIGN, "plant.mat": "mine"}
    assert find_obstacles(folder, ["plant.mat"]) == {"plant.mat": "was not written by updyn"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 100_000,
        '{"format": "updyn manifest", "schema": 2}',
        '{"format": "updyn manifest", "schema": 1, "files": {"../a": {}}}',
        '{"format": "updyn manifest", "schema": 1, "files": {"a": {"sha256": 1}}}',
        '{"format": "updyn manifest", "schema": 1, "files": {"a": {"sha256": "1"}}}',
    ],
)
def test_a_manifest_of_something_else_is_refused(folder: Path, text: str) -> None:
    (folder / MANIFEST).write_text(text)
    with pytest.raises(FormatError, match="is not a manifest of the files that updyn wrote"):
        find_obstacles(folder, OLD)


# -- two processes ---------------------------------------------------------------------------------
@posix
def test_a_second_process_is_refused_and_named_the_first(folder: Path) -> None:
    with (
        lock_folder(folder),
        pytest.raises(InUseError, match=rf"written to by updyn process {os.getpid()} on .*, since"),
        lock_folder(folder),
    ):
        pass
    assert not (folder / LOCK).exists()


@posix
def test_the_lock_of_a_dead_process_locks_nothing(folder: Path) -> None:
    (folder / LOCK).write_text("updyn process 1 on here, since 2020-01-01 00:00:00\n")
    with lock_folder(folder):
        assert f"process {os.getpid()} " in (folder / LOCK).read_text()
    assert not (folder / LOCK).exists()


def test_a_lock_file_of_a_user_stays(folder: Path) -> None:
    (folder / LOCK).write_text("mine")
    with pytest.raises(FormatError, match="is not the lock"), lock_folder(folder):
        pass
    assert (folder / LOCK).read_text() == "mine"


@posix
def test_what_a_live_process_is_writing_is_left_alone(folder: Path) -> None:
    with lock_folder(folder), replace_files(folder, "run", ("a.json",)) as new:
        (new / "a.json").write_text("new")
        recover(folder)
        assert (new / "a.json").read_text() == "new"
    assert contents(folder)["a.json"] == "new"
