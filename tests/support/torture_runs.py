"""Tortures of `updyn run` in a folder that holds results: signals, full disks, two runs at once.

Whatever happens, the folder then holds the old results or the new ones, as a whole, and the files
of its user; the process has ended as it should, without a traceback.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import updyn
from torture import EQUAL, OTHER, Outcome, Torture
from updyn.cli import main
from updyn.demos import chain
from updyn.outputs.lock import LOCK
from updyn.outputs.manifest import MANIFEST, Manifest, file_digest
from updyn.outputs.switch import recover

JOB = """\
[model]
file = "chain.h5"
[test]
file = "test.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[[parameter]]
groups = "part*"
quantity = "mass"
[[parameter]]
groups = "part*"
quantity = "loss_factor"
[output]
report = false
"""
#: What a run leaves beside its results: to go on from, and what a killed process could not remove.
_LEFT = ("run.journal", LOCK)
_FOREIGN = {"notes.txt": "mine", "plant.mat": "mine, too"}
#: Exit codes of a run that went through.
_DONE = 0
_REFUSED = 2
#: What a signal makes of it.
_ENDED = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}


def tortures() -> list[Torture]:
    """Return them."""
    trials: dict[str, Callable[[int, Path], Outcome]] = {
        number.name: functools.partial(_signalled, number) for number in _ENDED
    }
    trials |= {"full disks": _on_a_full_disk, "two at once": _two_at_once}
    return [Torture("run of a job", kind, trial, longest=60.0) for kind, trial in trials.items()]


@dataclass(frozen=True, slots=True)
class _Case:
    """A folder with a job and its results, to be copied for each trial.

    Parameters
    ----------
    folder : Path
        Holds ``job.toml`` and the results in ``job``.
    run : str
        Id of the run that wrote them.
    largest : int
        Size of the largest of them in bytes.
    seconds : float
        How long a run takes as a process.
    """

    folder: Path
    run: str
    largest: int
    seconds: float


@functools.cache
def _case() -> _Case:
    keep = tempfile.TemporaryDirectory()
    _KEPT.append(keep)
    folder = Path(keep.name)
    updyn.write_model(chain.build(), folder / "chain.h5")
    labels, lines = ["2:X", "5:X", "8:X", "12:X"], np.linspace(0.5, 25.0, 60)
    frf = updyn.response(chain.build().scaled(chain.TRUTH), lines, labels, ["12:X"], "accelerance")
    updyn.write_frf(frf, folder / "test.npz")
    (folder / "job.toml").write_text(JOB, encoding="utf-8")
    out = folder / "job"
    out.mkdir()
    for name, text in _FOREIGN.items():
        (out / name).write_text(text, encoding="utf-8")
    with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
        code = main(["run", str(folder / "job.toml")])
    assert code == _DONE, f"the run of the case ended with {code}"
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as other:
        code, _, said = _ended(_started(folder, Path(other)))
    assert code == _DONE, said
    entries = Manifest.read(out).entries
    (run,) = {entry.run for entry in entries.values()}
    largest = max((out / name).stat().st_size for name in entries)
    return _Case(folder, run, largest, time.monotonic() - begun)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []


def _started(
    folder: Path, out: Path, before: Callable[[], None] | None = None
) -> subprocess.Popen[str]:
    """Start a run whose results go to a folder."""

    def prepare() -> None:
        # A shell's background jobs, and so their children, are born deaf to Ctrl-C.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if before is not None:
            before()

    return subprocess.Popen(
        [sys.executable, "-m", "updyn", "run", str(folder / "job.toml"), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        preexec_fn=prepare,
    )


def _ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Return exit code and what it said on both streams."""
    out, err = process.communicate()
    return process.returncode, out, err


def _signalled(number: signal.Signals, seed: int, folder: Path) -> Outcome:
    """Send a signal at a moment of the run, from its first import to after its end."""
    chance, case = random.Random(seed), _case()
    with tempfile.TemporaryDirectory(dir=folder) as copied:
        out = _copy(case, Path(copied))
        process = _started(case.folder, out)
        time.sleep(chance.uniform(0.0, 1.1 * case.seconds))
        process.send_signal(number)
        code, _, said = _ended(process)
        if number == signal.SIGKILL:
            recover(out)
        wrong = _wrong(case, out, said)
        if not wrong and number != signal.SIGKILL:
            wrong = _unswept(out)
        # Before Python has begun, a signal does what it always does.
        if not wrong and code not in (_DONE, _ENDED[number], -number):
            wrong = f"ended with {code}: {said[-200:]}"
    return Outcome(OTHER, wrong, failed=True) if wrong else Outcome(EQUAL)


def _on_a_full_disk(seed: int, folder: Path) -> Outcome:
    """Let no file grow beyond a size."""
    chance, case = random.Random(seed), _case()
    size = chance.randint(0, case.largest)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    with tempfile.TemporaryDirectory(dir=folder) as copied:
        out = _copy(case, Path(copied))
        code, _, said = _ended(_started(case.folder, out, limit))
        wrong = _wrong(case, out, said) or _unswept(out)
        errors = [line for line in said.splitlines() if line.startswith("error:")]
        if not wrong and (code, len(errors)) not in ((_DONE, 0), (_REFUSED, 1)):
            wrong = f"{size} bytes: ended with {code}: {said[-200:]}"
        if not wrong and code == _REFUSED and "cannot be written" not in errors[0]:
            wrong = f"{size} bytes: {errors[0]}"
    return Outcome(OTHER, wrong, failed=True) if wrong else Outcome(EQUAL)


def _two_at_once(seed: int, folder: Path) -> Outcome:
    """Start two runs, one somewhat after the other: one may be refused, by name."""
    chance, case = random.Random(seed), _case()
    with tempfile.TemporaryDirectory(dir=folder) as copied:
        out = _copy(case, Path(copied))
        first = _started(case.folder, out)
        time.sleep(chance.uniform(0.0, 0.5 * case.seconds))
        second = _started(case.folder, out)
        ends = [_ended(process) for process in (first, second)]
        said = "".join(end[2] for end in ends)
        wrong = _wrong(case, out, said) or _unswept(out)
        codes = sorted(end[0] for end in ends)
        if not wrong and codes not in ([_DONE, _DONE], [_DONE, _REFUSED]):
            wrong = f"ended with {codes}: {said[-300:]}"
        if not wrong and _REFUSED in codes and "is being written to by updyn process" not in said:
            wrong = f"refused without the reason: {said[-300:]}"
        if not wrong and _run_of(out) == case.run:
            wrong = "the old results are still there"
    return Outcome(OTHER, wrong, failed=True) if wrong else Outcome(EQUAL)


def _copy(case: _Case, folder: Path) -> Path:
    out = folder / "job"
    shutil.copytree(case.folder / "job", out)
    return out


def _run_of(out: Path) -> str:
    return ", ".join(sorted({entry.run for entry in Manifest.read(out).entries.values()}))


def _wrong(case: _Case, out: Path, said: str) -> str:
    """Return what is wrong with a folder after a run, and with what the run said; empty if nothing."""
    frames = [line for line in said.splitlines() if line.lstrip().startswith('File "')]
    # A signal that comes while Python itself starts meets no code of the package.
    if frames and not all('"<frozen ' in frame for frame in frames):
        return f"a traceback: {said[-300:]}"
    entries = Manifest.read(out).entries
    if len({entry.run for entry in entries.values()}) != 1:
        return f"results of more than one run, or none: {sorted(entries)}"
    for name, entry in entries.items():
        if not (out / name).is_file() or file_digest(out / name) != entry.sha256:
            return f"{name} is not what the manifest says"
    for name, text in _FOREIGN.items():
        if not (out / name).is_file() or (out / name).read_text(encoding="utf-8") != text:
            return f"{name} of the user is lost"
    allowed = {MANIFEST, *_LEFT, *_FOREIGN, *entries}
    strange = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()} - allowed
    if not all(name.startswith(".") for name in strange):
        return f"left behind: {sorted(strange)}"
    if _run_of(out) != case.run:
        status = json.loads((out / "result.json").read_text(encoding="utf-8"))["status"]
        if updyn.read_result(out / "run.nc").status != status:
            return "run.nc and result.json differ"
    return ""


def _unswept(out: Path) -> str:
    """Return what a process that was not killed has left of its work; empty if nothing."""
    left = sorted(path.name for path in out.iterdir() if path.name.startswith("."))
    return f"left behind: {left}" if left else ""
