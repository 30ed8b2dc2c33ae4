"""What reaches the terminal: any encoding, no control characters, readers that go away, signals."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.cli.terminal import printable

posix = pytest.mark.skipif(os.name == "nt", reason="signals and file names of POSIX")
ESCAPE = "\x1bc\x07\x9b31m\r\u202e|"  # clears a terminal, rings, colours, overwrites, turns round


def updyn_process(*words: object, **environment: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "updyn", *map(os.fspath, words)],  # type: ignore[call-overload]
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
    )


def model_with(folder: Path, *names: str) -> Path:
    groups = {name: updyn.Group(stiffness=np.eye(2), mass=np.eye(2)) for name in names}
    path = folder / "model.h5"
    updyn.write_model(updyn.Model.from_groups(groups, dofs=["1:X", "2:X"]), path)
    return path


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain\n\tä ²", "plain\n\tä ²"),
        ("\x1b[2J", r"\x1b[2J"),
        ("a\rb\0\x7f\x9b", r"a\x0db\x00\x7f\x9b"),
        ("\u202eabc\u2066", r"\u202eabc\u2066"),
    ],
)
def test_control_characters_are_escaped(text: str, shown: str) -> None:
    assert printable(text) == shown.replace(r"\x0d", r"\r")


def test_names_of_a_file_do_not_reach_the_terminal_raw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = model_with(tmp_path, f"part{ESCAPE}", "other")
    assert main(["info", str(path)]) == 0
    assert main(["info", str(tmp_path / f"absent{ESCAPE}")]) == 2
    job = tmp_path / "job.toml"
    job.write_text(
        '[model]\nfile = "model.h5"\n[test]\nfile = "x.npz"\n[[parameter]]\n'
        'groups = "a\\u001bc"\nquantity = "q\\u001bc"\n',
        encoding="utf-8",
    )
    assert main(["check", str(job)]) == 2
    out, err = capsys.readouterr()
    assert r"part\x1bc" in out
    assert r"absent\x1bc" in err
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", out + err)


@posix
@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}]
)
def test_a_terminal_of_another_encoding(tmp_path: Path, environment: dict[str, str]) -> None:
    path = model_with(tmp_path, "Fuß ²")
    process = updyn_process("info", path, **{"PYTHONCOERCECLOCALE": "0", **environment})
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, b"")
    assert rb"Fu\xdf \xb2" in out


@posix
def test_a_name_that_is_not_utf8(tmp_path: Path) -> None:
    process = updyn_process("info", os.fsencode(tmp_path) + b"/f\xff.h5")
    _, err = process.communicate(timeout=120)
    assert process.returncode == 2
    assert b"no such file" in err
    assert b"Traceback" not in err


@posix
@pytest.mark.parametrize("words", [["info"], ["--help"]])
def test_a_reader_that_goes_away(tmp_path: Path, words: list[str]) -> None:
    path = model_with(tmp_path, "part")
    process = updyn_process(*words, *([path] if words == ["info"] else []))
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    with process.stderr:
        err = process.stderr.read()
    assert process.wait(timeout=120) in (0, 1)
    assert b"Traceback" not in err
    assert b"Exception ignored" not in err


@posix
def test_streams_that_are_closed_from_the_start(tmp_path: Path) -> None:
    path = model_with(tmp_path, "part")
    command = f'"{sys.executable}" -m updyn info "{path}" >&- 2>&-'
    assert subprocess.run(command, shell=True, check=False, timeout=120).returncode == 0


BUSY = """
import hashlib, sys
from updyn import cli
from updyn.cli import commands, progress, terminal

def info(*_, **__):
    {body}

commands.info = info
info.__annotations__ = {{}}
cli.COMMANDS.register("busy", info)
print("ready", flush=True)
sys.exit(cli.main(["busy"]))
"""
LONG = 'hashlib.pbkdf2_hmac("sha256", b"a", b"b", 2_000_000_000)'  # many minutes without Python
IN_ORDER = """with progress.show_progress(terminal.stderr()) as display:
        while not display.stopping:
            pass
    return terminal.STOPPED"""


@posix
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize(
    ("body", "said"), [(LONG, b"Leaving at once."), (IN_ORDER, b"Stopping after this step")]
)
def test_signals(number: signal.Signals, code: int, body: str, said: bytes) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY.format(body=body)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    try:
        process.wait(1.0)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert said in err
    assert b"Traceback" not in err
