"""A job file as it is edited: its text, undo and saving, byte by byte."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from updyn.errors import FormatError, InputError, JobError
from updyn.web.document import JobDocument

TEXT = """\
# of the antenna
title = "A"   # kept

[test]        # the measurement
file = "t.uff"
band = [5.0, 400.0] # Hz

[model]
file = "m.h5"
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "job.toml"
    found.write_bytes(TEXT.encode())
    return found


def set_band(document: object) -> None:
    document["test"]["band"] = [1.0, 2.0]  # type: ignore[index]


def test_an_edit_changes_its_key_and_nothing_else(path: Path) -> None:
    job = JobDocument(path)
    job.edit("band", set_band)
    assert job.text == TEXT.replace("[5.0, 400.0]", "[1.0, 2.0]")
    assert job.is_changed
    assert path.read_text() == TEXT
    job.save()
    assert not job.is_changed
    assert path.read_text() == TEXT.replace("[5.0, 400.0]", "[1.0, 2.0]")
    assert [found.name for found in path.parent.iterdir()] == ["job.toml"]


def test_undo_and_redo(path: Path) -> None:
    job = JobDocument(path)
    assert (job.last_edit, job.next_edit, job.version) == ("", "", 0)
    job.undo()
    job.redo()
    assert (job.text, job.version) == (TEXT, 0)
    job.replace("one", "1 = 1\n")
    job.replace("two", "2 = 2\n")
    job.undo()
    assert (job.text, job.last_edit, job.next_edit) == ("1 = 1\n", "one", "two")
    job.undo()
    assert (job.text, job.last_edit, job.next_edit) == (TEXT, "", "one")
    assert not job.is_changed
    job.redo()
    job.redo()
    assert (job.text, job.last_edit, job.next_edit) == ("2 = 2\n", "two", "")
    job.undo()
    job.replace("three", "3 = 3\n")
    assert (job.last_edit, job.next_edit) == ("three", "")
    job.redo()
    assert job.text == "3 = 3\n"


def test_what_is_typed_without_a_pause_is_one_edit(path, monkeypatch) -> None:
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    job = JobDocument(path)
    for text in ("a", "ab", "abc"):
        job.type(text)
        now += 0.5
    job.undo()
    assert (job.text, job.last_edit) == (TEXT, "")
    job.type("d")  # what was undone is gone, and this is another edit
    assert job.next_edit == ""
    job.type("de")
    now += 5.0
    job.type("def")
    job.undo()
    assert (job.text, job.last_edit) == ("de", "typing")
    job.type("de")  # the editor says again what it was given
    job.type("deg")
    job.undo()
    assert job.text == "de"
    job.save()
    job.type("dem")
    job.undo()
    assert (job.text, job.is_changed) == ("de", False), "undo leads back to what was saved"


def test_the_version_changes_with_the_text_and_only_with_it(path: Path) -> None:
    job = JobDocument(path)
    job.replace("nothing", TEXT)
    job.edit("nothing", lambda _document: None)
    assert (job.version, job.last_edit) == (0, "")
    seen = {job.version}
    for act in (lambda: job.replace("a", "a = 1\n"), job.undo, job.redo):
        act()
        seen.add(job.version)
    assert len(seen) == 4


def test_an_edit_that_fails_changes_nothing(path: Path) -> None:
    job = JobDocument(path)

    def bad(document: object) -> None:
        set_band(document)
        raise InputError("no")

    with pytest.raises(InputError, match="no"):
        job.edit("bad", bad)
    assert (job.text, job.version, job.last_edit) == (TEXT, 0, "")


def test_as_many_edits_can_be_taken_back_as_it_says(path: Path) -> None:
    job = JobDocument(path)
    for number in range(250):
        job.replace(str(number), f"n = {number}\n")
    for _ in range(300):
        job.undo()
    assert job.text == "n = 49\n"


@pytest.mark.parametrize(
    "text", ["[test\n", "a = 1\na = 2\n", "a =\n", "x", "a = 1979-13-40\n", "a = " + "[" * 5000]
)
def test_an_edit_of_what_is_not_toml_says_so(path: Path, text: str) -> None:
    job = JobDocument(path)
    job.replace("typed", text)
    with pytest.raises(JobError, match=r"job\.toml: not TOML: .*; correct the text first"):
        job.edit("band", set_band)
    assert job.text == text
    job.save()  # unfinished work may be saved
    assert path.read_text() == text


def test_what_another_program_has_written_is_not_lost(path: Path) -> None:
    job = JobDocument(path)
    job.edit("band", set_band)
    path.write_text("# by another program\n")
    with pytest.raises(
        InputError, match=r"another program has changed this file.*save under another name"
    ):
        job.save()
    assert path.read_text() == "# by another program\n"
    assert job.is_changed
    job.save_as(path.with_name("second.toml"))
    assert path.with_name("second.toml").read_text() == job.text
    assert (job.path.name, job.is_changed) == ("second.toml", False)
    assert path.read_text() == "# by another program\n"


def test_a_file_that_was_removed_is_written_again(path: Path) -> None:
    job = JobDocument(path)
    job.edit("band", set_band)
    path.unlink()
    job.save()
    assert path.read_text() == job.text


def test_a_folder_in_place_of_the_file_is_one_message(path: Path) -> None:
    job = JobDocument(path)
    job.edit("band", set_band)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match=r"job\.toml"):
        job.save()
    assert job.is_changed


def test_save_as_writes_over_nothing(path: Path) -> None:
    job = JobDocument(path)
    job.edit("band", set_band)
    other = path.with_name("other.toml")
    other.write_text("mine")
    link = path.with_name("link.toml")
    link.symlink_to(path.with_name("nowhere.toml"))
    for taken in (other, link, path):
        with pytest.raises(InputError, match="exists already; choose another name"):
            job.save_as(taken)
    assert other.read_text() == "mine"
    assert path.read_text() == TEXT
    assert (job.path, job.is_changed) == (path, True)


def test_save_as_into_a_folder_that_is_not_there_keeps_the_job(path: Path) -> None:
    job = JobDocument(path)
    with pytest.raises(FormatError, match="does not exist"):
        job.save_as(path.parent / "none" / "job.toml")
    assert job.path == path


def test_a_byte_order_mark_is_no_part_of_the_text(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    job = JobDocument(path)
    assert job.text == TEXT
    job.edit("band", set_band)
    job.save()
    assert path.read_bytes() == job.text.encode()


def test_line_ends_stay(path: Path) -> None:
    path.write_bytes(TEXT.replace("\n", "\r\n").encode())
    job = JobDocument(path)
    job.edit("band", set_band)
    job.save()
    assert (
        path.read_bytes()
        == TEXT.replace("[5.0, 400.0]", "[1.0, 2.0]").replace("\n", "\r\n").encode()
    )


def test_not_utf8(path: Path) -> None:
    path.write_bytes(b'title = "gr\xf6\xdfe"\n')
    with pytest.raises(JobError) as caught:
        JobDocument(path)
    assert str(caught.value) == "job.toml: is not UTF-8; TOML is"


def test_no_such_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"none\.toml: cannot be read: No such file"):
        JobDocument(tmp_path / "none.toml")
    with pytest.raises(JobError, match="cannot be read: Is a directory"):
        JobDocument(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads everything")
def test_a_file_that_may_not_be_read(path: Path) -> None:
    path.chmod(0)
    with pytest.raises(JobError, match="cannot be read: Permission denied"):
        JobDocument(path)


def test_a_text_that_utf8_does_not_hold_is_one_message(path: Path) -> None:
    job = JobDocument(path)
    job.replace("typed", "# half of a pair: \ud800\n")
    with pytest.raises(InputError, match="cannot be written as UTF-8"):
        job.save()
    assert path.read_text() == TEXT


def test_a_full_disk_leaves_the_old_file(path: Path) -> None:
    """No file may grow beyond a size: as in `hostile`, this is how a full disk looks to Python."""
    resource = pytest.importorskip("resource")
    job = JobDocument(path)
    job.replace("long", TEXT + "# more\n" * 1000)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (0, 10, 4000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            with pytest.raises(FormatError) as caught:
                job.save()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert str(caught.value) == f"{path}: cannot be written: {os.strerror(errno.EFBIG)}"
        assert path.read_text() == TEXT
        assert [found.name for found in path.parent.iterdir()] == ["job.toml"]
        assert job.is_changed
    job.save()
    assert path.read_text() == job.text
