"""The process in which files are read for the pages: whatever happens there is an answer or one message."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import desk_work
from updyn.errors import InputError
from updyn.web.desk import Desk

ENDED = "ended without an answer"


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path, seconds=60.0)
    yield made
    made.close()


def test_answers_errors_and_ends_one_after_the_other(
    desk: Desk, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """One process for all that does not end it; a new one after that."""
    first, total = desk.ask(desk_work.add, 1.5, 2)
    assert total == 3.5
    assert first != os.getpid()
    assert [desk.ask(desk_work.count) for _ in range(3)] == [1, 2, 3]
    with pytest.raises(InputError) as caught:
        desk.ask(desk_work.refuse, "a file.x")
    assert str(caught.value) == "a file.x:7: line of nonsense"
    assert desk.ask(desk_work.warn) == "warned"
    assert desk.ask(desk_work.add, 0, 0)[0] == first
    assert capfd.readouterr() == ("", "")

    # Confined to the folder; this process is not.
    outside = tmp_path.parent / "outside.txt"
    (tmp_path / "link").symlink_to(outside)
    assert desk.ask(desk_work.check, tmp_path / "x" / "y.txt") == "inside"
    for path in (outside, tmp_path / ".." / "outside.txt", tmp_path / "link"):
        with pytest.raises(InputError, match="is outside the folder of the project"):
            desk.ask(desk_work.check, path)
    assert desk_work.check(outside) == "inside"

    os.kill(first, signal.SIGINT)  # Ctrl-C in the terminal
    assert desk.ask(desk_work.add, 0, 0)[0] == first

    with pytest.raises(InputError, match=ENDED):
        desk.ask(desk_work.leave, 0)
    second = desk.ask(desk_work.add, 0, 0)[0]
    assert second != first
    assert desk.ask(desk_work.count) == 1

    os.kill(second, signal.SIGKILL)  # between two calls
    desk._process.join(30)
    assert desk.ask(desk_work.count) == 1
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("function", [desk_work.fail, desk_work.unsendable])
def test_an_error_that_nobody_expected_is_a_message_too(desk: Desk, function: object) -> None:
    with pytest.raises(InputError, match=ENDED):
        desk.ask(function)  # type: ignore[arg-type]


def test_a_call_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    desk = Desk(tmp_path, seconds=60.0)
    number, _ = desk.ask(desk_work.add, 0, 0)
    desk._seconds = 0.3
    began = time.monotonic()
    with pytest.raises(InputError, match=r"took longer than 0\.3 s and was ended"):
        desk.ask(desk_work.sleep, 60.0)
    assert time.monotonic() - began < 30
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)
    desk.close()


def test_end_does_not_wait_for_a_call_under_way(desk: Desk, tmp_path: Path) -> None:
    said: list[str] = []

    def ask() -> None:
        try:
            desk.ask(desk_work.sleep_beside, tmp_path / "begun", 300.0)
        except InputError as error:
            said.append(str(error))

    thread = threading.Thread(target=ask)
    thread.start()
    until = time.monotonic() + 60
    while not (tmp_path / "begun").exists() and time.monotonic() < until:
        time.sleep(0.02)
    began = time.monotonic()
    desk.end()
    thread.join(60)
    assert time.monotonic() - began < 60
    assert not thread.is_alive()
    assert len(said) == 1
    assert ENDED in said[0]
    assert desk.ask(desk_work.count) == 1


def test_closing_twice_and_before_the_first_call(tmp_path: Path) -> None:
    desk = Desk(tmp_path, seconds=1.0)
    for act in (desk.close, desk.end, desk.close):
        act()


@pytest.mark.skipif(sys.platform != "linux", reason="no limit of memory")
def test_too_much_memory_is_a_message_and_the_process_goes_on(tmp_path: Path) -> None:
    desk = Desk(tmp_path, seconds=60.0, memory=3 * 2**30)
    assert desk.ask(desk_work.allocate, 2**20) == 1.0
    number, _ = desk.ask(desk_work.add, 0, 0)
    with pytest.raises(InputError, match="not enough memory for this"):
        desk.ask(desk_work.allocate, 4 * 2**30)
    assert desk.ask(desk_work.add, 1, 1) == (number, 2)
    desk.close()
