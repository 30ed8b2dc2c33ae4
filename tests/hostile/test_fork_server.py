"""The fork server of the child processes that read files: it spares their start, and no reading reaches the next one."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from overriding import override
from places import SUPPORT
from updyn.errors import FormatError
from updyn.foreign import box, processes
from updyn.foreign.settings import READING

pytestmark = pytest.mark.skipif(not processes._CAN_FORK, reason="no fork here")


@pytest.fixture(autouse=True)
def _no_server_left() -> Iterator[None]:
    processes._end_all()
    yield
    processes._end_all()


def load(function: str, *arguments: Any) -> Any:
    return box.load(
        f"foreign_loaders:{function}", __file__, *arguments, what="picture", reader="libx"
    )


def server() -> int:
    """Return the number of the process that forks."""
    found: int = load("processes")[1]
    return found


def is_running(pid: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except FileNotFoundError:
        return False


def wait_for_end(pid: int) -> None:
    until = time.monotonic() + 10.0
    while is_running(pid):
        assert time.monotonic() < until, "still running"
        time.sleep(0.01)


def test_every_reading_has_a_process_of_its_own_from_one_server():
    (first, one), (second, other) = load("processes"), load("processes")
    assert first != second
    assert one == other
    assert os.getpid() not in (first, one)
    assert not is_running(first)


def test_nothing_that_a_reading_leaves_behind_reaches_the_next_one():
    assert load("remember", "a") == ["a"]
    assert load("remember", "b") == ["b"]


@pytest.mark.parametrize("function", ["crash", "stop"])
def test_after_a_reader_that_failed_the_next_one_is_sound(function):
    one = server()
    with pytest.raises(FormatError):
        load(function)
    assert load("remember", "a") == ["a"]
    assert server() == one


def test_a_reader_that_ran_over_its_time_ends_with_its_server(monkeypatch):
    one = server()
    with monkeypatch.context() as patch:
        override(patch, READING, seconds=0.3)
        with pytest.raises(FormatError, match="ran over"):
            load("hang")
    assert not is_running(one)
    assert server() != one


def test_limits_of_a_reader_are_not_those_of_the_next_one():
    for _ in range(2):
        with pytest.raises(FormatError, match=r"needed over 1,0.. MB"):
            load("allocate", 10**9)
    assert load("allocate", 10**7) == 10**7


def test_a_process_starts_as_a_new_one_would(tmp_path, monkeypatch):
    """What has changed since the server started holds for the next reading."""
    load("talk")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("UPDYN_TEST", "here")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    assert load("inherited") == [str(tmp_path), "here", str(tmp_path)]


def test_a_server_that_was_killed_is_replaced():
    one = server()
    os.kill(one, signal.SIGKILL)
    assert load("talk") == "the answer"
    assert server() != one


def test_threads_read_at_the_same_time():
    names = list(map(str, range(24)))
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda name: load("remember", name), names)) == [[n] for n in names]


def test_a_fork_of_this_process_has_servers_of_its_own():
    one = server()
    received, sent = os.pipe()
    pid = os.fork()
    if not pid:
        os.write(sent, json.dumps(server()).encode())
        processes._end_all()
        os._exit(0)
    os.waitpid(pid, 0)
    assert json.loads(os.read(received, 100)) not in (one, os.getpid())
    os.close(received)
    os.close(sent)
    assert server() == one


@pytest.mark.parametrize("end", ["pass", "os._exit(0)", "os.kill(os.getpid(), 9)"])
def test_a_server_ends_with_its_parent(end):
    code = f"""
import os, sys
sys.path.insert(0, {str(SUPPORT)!r})
from updyn.foreign import box
one = box.load("foreign_loaders:processes", {__file__!r}, what="picture", reader="libx")[1]
print(one, flush=True)
{end}
"""
    said = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert not said.stderr
    wait_for_end(int(said.stdout))


def test_a_server_ends_where_nothing_is_asked_for_long():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        code = (
            "from updyn.foreign import child; from updyn.foreign.settings import READING;"
            " vars(READING)['idle_seconds'] = 0.1; child.serve()"
        )
        ended = subprocess.run([sys.executable, "-c", code], stdin=theirs, timeout=60, check=False)
    assert ended.returncode == 0
