"""Tortures: many small trials of one kind, each from a seed, in processes that may die; counted by outcome.

A `Torture` is a name and a function from a seed (and a folder to work in) to an `Outcome`. The
modules named in `MODULES` list them in ``tortures()``; a further kind of trial is a function in one
of them. Trials run one after another in a child process with a limit on memory; one that crashes,
hangs or asks for too much ends its process alone, is counted, and the next trial gets another
process.

``python tests/support/torture.py NAME`` is such a child: it takes seeds from its standard input.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import select
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

#: Where tortures are listed, by ``tortures()``; the environment may name others.
MODULES = (
    "torture_readers",
    "torture_programs",
    "torture_native",
    "torture_switch",
    "torture_runs",
)
_OTHERS = "TORTURES"

EQUAL = "equal"
LESS = "less"
OTHER = "other"
REFUSED = "refused"
EXCEPTION = "exception"
CRASH = "crash"
HANG = "hang"
MEMORY = "memory"
#: In the order of the table. A changed number is a failure only of trials that say so.
WORDS = (EQUAL, LESS, OTHER, REFUSED, EXCEPTION, CRASH, HANG, MEMORY)

LONGEST = 10.0  # seconds of a trial
LARGEST = 2 * 2**30  # bytes that a trial may add to what its process has
_START = 120.0  # seconds until a process is ready for its first trial


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a trial.

    Parameters
    ----------
    word : str
        One of `WORDS`.
    detail : str
        The message, or where an exception came from.
    failed : bool
        Whether this must not be.
    """

    word: str
    detail: str = ""
    failed: bool = False


@dataclass(frozen=True, slots=True)
class Torture:
    """Trials of one kind.

    Parameters
    ----------
    name : str
        A row of the table, ``"uff, text"``.
    kind : str
        What is done to it: ``"mutants"``, ``"cuts"``; a column of the table.
    trial : callable
        Takes a seed and a folder that all trials share, and returns the outcome. What it raises is
        counted as `EXCEPTION`.
    size : callable, optional
        Returns how many seeds there are, where it is not any number of them.
    longest : float
        Seconds after which a trial hangs.
    """

    name: str
    kind: str
    trial: Callable[[int, Path], Outcome]
    size: Callable[[], int] | None = None
    longest: float = LONGEST

    @property
    def key(self) -> str:
        """Name and kind."""
        return f"{self.name}: {self.kind}"

    def seeds(self, most: int) -> Sequence[int]:
        """Return at most that many seeds, spread evenly where their number is limited."""
        size = most if self.size is None else self.size()
        if size <= most:
            return range(size)
        return sorted({i * size // most for i in range(most)} | {size - 1})


def tortures() -> dict[str, Torture]:
    """Return all tortures by key."""
    found = {}
    for module in os.environ.get(_OTHERS, "").split() or MODULES:
        for one in importlib.import_module(module).tortures():
            found[one.key] = one
    return found


# -- the parent -----------------------------------------------------------------------------------
def run(torture: Torture, seeds: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
    """Run trials in child processes; yield seed and outcome of each.

    Parameters
    ----------
    torture : Torture
        One of `tortures`, which the child looks up by its key.
    seeds : iterable of int
        One for each trial.
    """
    left = list(seeds)
    with tempfile.TemporaryDirectory() as folder:
        while left:
            count = 0
            for outcome in _one_process(torture, left, Path(folder)):
                yield left[count], outcome
                count += 1
            if not count:
                yield left[0], Outcome(CRASH, "the process did not begin", failed=True)
                count = 1
            left = left[count:]


def _one_process(torture: Torture, seeds: Sequence[int], folder: Path) -> Iterator[Outcome]:
    """Run trials until one ends its process."""
    said = (folder / "stderr").open("w+b")
    child = subprocess.Popen(
        [sys.executable, __file__, torture.key],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=said,
        env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONFAULTHANDLER": "1"},
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        child.stdin.write(" ".join(map(str, seeds)).encode())
        child.stdin.close()
        _line(child.stdout.fileno(), _START)  # it has imported what it needs
        limit = 2 * torture.longest  # the first trial may import more
        for _ in seeds:
            line = _line(child.stdout.fileno(), limit)
            limit = torture.longest
            if line is None:
                yield Outcome(HANG, f"more than {torture.longest:g} s", failed=True)
                return
            if not line:
                code = child.wait()
                said.seek(0)
                words = said.read().decode("utf-8", "replace").strip().splitlines()
                why = " / ".join(words[:3])[:300]
                yield Outcome(CRASH, f"ended with {code}: {why}", failed=True)
                return
            yield Outcome(**json.loads(line))
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
        said.close()


_PENDING: dict[int, bytes] = {}


def _line(descriptor: int, limit: float) -> bytes | None:
    """Return the next line, empty at the end; None if there is none in time."""
    held = _PENDING.pop(descriptor, b"")
    until = time.monotonic() + limit
    while b"\n" not in held:
        wait = until - time.monotonic()
        if wait <= 0 or not select.select([descriptor], [], [], wait)[0]:
            return None
        read = os.read(descriptor, 65536)
        if not read:
            return b""
        held += read
    line, rest = held.split(b"\n", 1)
    if rest:
        _PENDING[descriptor] = rest
    return line


# -- the table ------------------------------------------------------------------------------------
def table(results: dict[tuple[str, str], Counter[str]]) -> str:
    """Return counts of outcomes by name and kind as a Markdown table."""
    always = (EXCEPTION, CRASH, HANG, MEMORY)
    used = [w for w in WORDS if w in always or any(counts[w] for counts in results.values())]
    rows = [["reader", "trials of", "trials", *used], ["---", "---", *["--:"] * (len(used) + 1)]]
    for (name, kind), counts in results.items():
        cells = [str(counts[word]) for word in used]
        rows.append([name, kind, str(sum(counts.values())), *cells])
    whole = sum(results.values(), Counter[str]())
    rows.append(["all", "", str(sum(whole.values())), *(str(whole[word]) for word in used)])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


# -- the child ------------------------------------------------------------------------------------
def _child(key: str) -> None:
    """Run the trials whose seeds stand on standard input; say each outcome in a line."""
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what a library prints is not for the parent
    torture = tortures()[key]
    seeds = list(map(int, sys.stdin.read().split()))
    _limit_memory()
    out.write(b"\n")
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            outcome = _limited(torture, seed, Path(folder))
            out.write(json.dumps(asdict(outcome)).encode() + b"\n")


def _limited(torture: Torture, seed: int, folder: Path) -> Outcome:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        outcome = torture.trial(seed, folder)
    except MemoryError:
        return Outcome(MEMORY, _origin(), failed=True)
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        return Outcome(EXCEPTION, f"{type(error).__name__}: {str(error)[:200]} {_origin()}", True)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if grown > LARGEST:
        return Outcome(MEMORY, f"{grown / 2**30:.1f} GiB", failed=True)
    return outcome


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + LARGEST + 2**30  # libraries are imported later, too
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _origin() -> str:
    """Return where the exception under way was raised, as far as that is in updyn."""
    frames = traceback.extract_tb(sys.exc_info()[2])
    own = [frame for frame in frames if "updyn" in frame.filename] or frames
    last = own[-1]
    return f"({Path(last.filename).name}:{last.lineno} {last.name})"


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    _child(sys.argv[1])
