"""What killed processes leave of files, and who removes it: with processes that are really killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import io_samples
import updyn
from updyn.cli import main
from updyn.io import leftovers
from updyn.io.atomic import atomic_path, write_bytes

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="only there names say whose they are"
)

#: Writes half of a file, says so, and waits to be killed.
_HALF = """
import sys, time
from pathlib import Path
from updyn.io.atomic import atomic_path
with atomic_path(Path(sys.argv[1])) as temporary:
    temporary.write_bytes(b"half")
    print("ready", flush=True)
    time.sleep(60)
"""
#: Converts, and waits to be killed once the file is written beside its place.
_CONVERT = """
import sys, time
from updyn.cli import commands, main, new_file
check = new_file.check_free
def wait(files, **options):
    check(files, **options)
    print("ready", flush=True)
    time.sleep(60)
new_file.check_free = wait  # not that of the command, which is called first
main(["convert", *sys.argv[1:]])
"""


def started(code: str, *arguments: Path) -> subprocess.Popen[str]:
    """Start a process that has come as far as it says "ready"."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def killed(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert process.stdout is not None
    process.stdout.close()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_a_killed_process_left_goes_at_the_next_write_of_the_same_file(tmp_path):
    path = tmp_path / "frf.npz"
    for _ in range(2):
        process = started(_HALF, path)
        killed(process)
    # The second one has removed what the first one left.
    (left,) = names(tmp_path)
    assert left.startswith(".frf-")
    write_bytes(tmp_path / "other.npz", b"")
    write_bytes(tmp_path / "frf.csv", b"")
    assert left in names(tmp_path)
    write_bytes(path, b"whole")
    assert names(tmp_path) == ["frf.csv", "frf.npz", "other.npz"]
    assert path.read_bytes() == b"whole"


def test_the_file_of_a_process_that_is_alive_stays(tmp_path):
    path = tmp_path / "frf.npz"
    process = started(_HALF, path)
    try:
        write_bytes(path, b"whole")
        assert len(names(tmp_path)) == 2
    finally:
        killed(process)
    with atomic_path(path), atomic_path(path) as inner:  # of this process, too
        inner.write_bytes(b"both")
        assert len(names(tmp_path)) == 3
    assert names(tmp_path) == ["frf.npz"]


def test_a_process_that_has_ended_and_was_not_waited_for_is_gone(tmp_path):
    path = tmp_path / "frf.npz"
    process = started(_HALF, path)
    process.send_signal(signal.SIGKILL)
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    write_bytes(path, b"whole")
    assert names(tmp_path) == ["frf.npz"]
    killed(process)


def test_convert(tmp_path, capsys):
    source, target = tmp_path / "in.npz", tmp_path / "out.csv"
    updyn.write_frf(io_samples.frf(), source)
    killed(started(_CONVERT, source, target))
    assert [name for name in names(tmp_path) if name.startswith(".unfinished-out-")]
    assert main(["convert", str(source), str(tmp_path / "third.csv")]) == 0
    assert len(names(tmp_path)) == 3  # with what was left
    assert main(["convert", str(source), str(target)]) == 0
    assert names(tmp_path) == ["in.npz", "out.csv", "third.csv"]
    capsys.readouterr()


def test_what_is_not_certain_stays(tmp_path, monkeypatch):
    """Of another machine or start, of a process number that is in use, of users and earlier versions."""
    path = tmp_path / "frf.npz"
    own = leftovers.new_name(path, suffix=".npz")
    where, number, start, token = own.removeprefix(".frf-").removesuffix(".npz").split("-")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    other = f"{int(where[0], 16) ^ 1:x}{where[1:]}"
    kept = [
        f".frf-{other}-{ended.pid:x}-{start}-{token}.npz",
        f".frf-{where}-{number}-{start}-{token}.npz",
        f".frf-{where}-1-{start}-{token}.npz".replace(start, f"{leftovers._process_state(1)[1]:x}"),
        f".frf-{where}-{ended.pid:x}-{start}-{token}.csv",
        f".frf-{where}-{ended.pid:x}-{start}.npz",
        ".frf-0123456789ab.npz",
        "frf-mine.npz",
    ]
    gone = [
        f".frf-{where}-{ended.pid:x}-{start}-{token}.npz",
        f".frf-{where}-{number}-{int(start, 16) + 1:x}-{token}.npz",  # the number in use again
    ]
    for name in (*kept, *gone):
        (tmp_path / name).write_bytes(b"x")
    monkeypatch.setattr(leftovers, "_machine_digest", lambda: None)
    write_bytes(path, b"whole")
    assert names(tmp_path) == sorted([*kept, *gone, "frf.npz"])
    monkeypatch.undo()
    write_bytes(path, b"whole")
    assert names(tmp_path) == sorted([*kept, "frf.npz"])
    assert leftovers.new_name(path) != leftovers.new_name(path)


def test_a_link_is_removed_not_what_it_shows(tmp_path):
    path = tmp_path / "frf.npz"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("x")
    name = leftovers.new_name(path, suffix=".npz").replace(f"-{os.getpid():x}-", f"-{ended.pid:x}-")
    (tmp_path / name).symlink_to(tmp_path / "mine")
    write_bytes(path, b"whole")
    assert names(tmp_path) == ["frf.npz", "mine"]
    assert (tmp_path / "mine" / "notes").read_text() == "x"
