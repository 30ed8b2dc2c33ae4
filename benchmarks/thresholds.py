"""Which settings no test notices when they are doubled or halved.

Settings are the fields of the frozen objects in the modules named `settings`: thresholds,
tolerances, counts. A recording runs the tests once and keeps which settings each test reads. Then
each setting is doubled and halved in a separate process that runs the tests that read it, the
quickest first, until one fails.

- noticed: a test fails, the process crashes, or the tests take over a minute and ten times as long
  as before.
- not noticed: none of the tests fails; the table gives unit, meaning and reason. With 0 tests, no
  test reads the setting, other than on import.

Whole numbers are halved downwards; 1 is not halved, and 0 not changed. All numbers of a tuple are
scaled together. A test that reads a setting in another process only does not count.

    python benchmarks/thresholds.py [--settings "updating.fit.*"] [--tests tests/unit/updating ...]
        [--reads build/reads.json] [--record] [--budget 60] [--out changes.jsonl]

`--record` records again, though the file of reads exists. `--budget`: seconds of tests, as they
were when recorded, for each change. `--out` keeps each change as a line of JSON; changes that are
there are not made again.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from setting_fields import Setting, list_classes, list_settings  # noqa: E402

FACTORS = (2.0, 0.5)
#: Ratio of times from which a change is noticed by its cost; least limit in seconds.
SLOWER, LEAST_LIMIT = 10.0, 60.0
_QUIET = ["-q", "-x", "--no-header", "-p", "no:cacheprovider", "--rootdir", str(ROOT)]


@dataclass
class Reads:
    """Which settings each passing test reads, and its seconds."""

    seconds: dict[str, float] = field(default_factory=dict)
    settings: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Reads:
        """Read a file of reads."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))

    def save(self, path: Path) -> None:
        """Write the file of reads."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    def choose_tests(self, key: str, budget: float) -> list[str]:
        """Return the quickest tests that read a setting, within seconds."""
        reading = [test for test, read in self.settings.items() if key in read]
        tests = sorted(reading, key=lambda test: self.seconds[test])
        chosen: list[str] = []
        spent = 0.0
        for test in tests:
            spent += self.seconds[test]
            if chosen and spent > budget:
                break
            chosen.append(test)
        return chosen


class Recorder:
    """A plugin of pytest that records which settings are read during each test."""

    def __init__(self) -> None:
        self.reads = Reads()
        self._current: set[str] = set()
        self._failed: set[str] = set()
        for cls in list_classes():
            _watch(cls, self._current)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Keep what is read while a test runs, with its fixtures."""
        self._current.clear()
        started = time.perf_counter()
        result = yield
        if item.nodeid not in self._failed:
            self.reads.seconds[item.nodeid] = time.perf_counter() - started
            self.reads.settings[item.nodeid] = sorted(self._current)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Leave out tests that do not pass."""
        if report.outcome != "passed":
            self._failed.add(report.nodeid)


class FirstFailure:
    """A plugin of pytest that keeps the first test that fails."""

    def __init__(self) -> None:
        self.test = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the name of the first test that fails."""
        if report.failed and not self.test:
            self.test = report.nodeid


@dataclass(frozen=True)
class Change:
    """A changed setting, the number of tests that may run, and the first that fails.

    `noticed_by` is empty if none fails, and ``"time"`` or ``"crash"`` if the process does not end
    by itself.
    """

    setting: str
    factor: float
    value: Any
    tests: int
    noticed_by: str


def _watch(cls: type, read: set[str]) -> None:
    """Record each read of a field of a settings class."""
    plain = cls.__getattribute__

    def record(self: Any, name: str) -> Any:
        if not name.startswith("__"):
            read.add(f"{cls.__module__}:{cls.__name__}.{name}")
        return plain(self, name)  # type: ignore[call-arg]

    cls.__getattribute__ = record  # type: ignore[method-assign]


def key_of(setting: Setting) -> str:
    """Return the name under which reads of a setting are recorded."""
    return f"{setting.module}:{type(setting.object).__name__}.{setting.field}"


def scale(value: Any, factor: float) -> Any:
    """Return a value times a factor; the value itself if it cannot be scaled."""
    if isinstance(value, tuple):
        return tuple(scale(part, factor) for part in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if isinstance(value, int):
        return int(value * factor) if value * factor >= 1 else value
    return value * factor


def record(tests: list[str], path: Path) -> None:
    """Run tests and write which settings each reads."""
    recorder = Recorder()
    pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", *tests], plugins=[recorder])
    recorder.reads.save(path)


def _first_failure(setting: Setting, value: Any, tests: list[str]) -> str:
    """Return the first test that fails with another value, in this process."""
    with Path(os.devnull).open("w") as silent:
        os.dup2(silent.fileno(), 1)
        os.dup2(silent.fileno(), 2)
    vars(setting.object)[setting.field] = value
    failure = FirstFailure()
    code = pytest.main([*_QUIET, *(str(ROOT / test) for test in tests)], plugins=[failure])
    return failure.test or ("" if code == 0 else f"exit {code}")


def run_changed(setting: Setting, value: Any, tests: list[str], limit: float) -> str:
    """Return the first test that fails with another value, in another process."""
    with tempfile.NamedTemporaryFile("r", suffix=".txt") as answer:
        Path(answer.name).write_text("crash")
        child = os.fork()
        if child == 0:
            signal.alarm(int(limit))
            try:
                Path(answer.name).write_text(_first_failure(setting, value, tests))
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            return "time" if os.WTERMSIG(status) == signal.SIGALRM else "crash"
        return answer.read()


def change(setting: Setting, factor: float, reads: Reads, budget: float) -> Change | None:
    """Return how tests see a scaled setting; None if it cannot be scaled."""
    value = getattr(setting.object, setting.field)
    other = scale(value, factor)
    if other == value:
        return None
    tests = reads.choose_tests(key_of(setting), budget)
    if not tests:
        return Change(setting.name, factor, other, 0, "")
    limit = max(LEAST_LIMIT, SLOWER * sum(reads.seconds[test] for test in tests))
    noticed_by = run_changed(setting, other, tests, limit)
    return Change(setting.name, factor, other, len(tests), noticed_by)


def print_table(settings: list[Setting], changes: list[Change]) -> None:
    """Print the settings that no test notices, and the sum."""
    unnoticed = [c for c in changes if not c.noticed_by]
    by_name = {setting.name: setting for setting in settings}
    print("\n| setting | times | tests | meaning |\n|---|---|---|---|")
    for c in unnoticed:
        print(f"| {c.setting} | {c.factor:g} | {c.tests} | {by_name[c.setting].comment} |")
    noticed, names = len(changes) - len(unnoticed), {c.setting for c in unnoticed}
    print(f"\n{len(settings)} settings, {len(changes)} changes: {noticed} noticed,")
    print(f"{len(unnoticed)} not, of {len(names)} settings")


def main() -> None:
    """Record, change, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--settings", default="*", metavar="GLOB")
    parser.add_argument("--tests", nargs="+", default=[str(ROOT / "tests")])
    parser.add_argument("--reads", type=Path, default=ROOT / "build" / "reads.json")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.record or not options.reads.exists():
        # In another process, as modules that tests import stay as they are in this one.
        child = os.fork()
        if child == 0:
            record(options.tests, options.reads)
            os._exit(0)
        os.waitpid(child, 0)
    reads = Reads.load(options.reads)
    settings = [s for s in list_settings() if fnmatch.fnmatch(s.name, options.settings)]
    changes = list(_make_changes(settings, reads, options.budget, options.out))
    print_table(settings, changes)


def _make_changes(
    settings: list[Setting], reads: Reads, budget: float, out: Path | None
) -> Iterator[Change]:
    """Yield all changes; those that the file has are not made again."""
    made = {}
    if out is not None and out.exists():
        lines = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
        made = {(line["setting"], line["factor"]): Change(**line) for line in lines}
    for setting in settings:
        for factor in FACTORS:
            if (setting.name, factor) in made:
                yield made[setting.name, factor]
                continue
            changed = change(setting, factor, reads, budget)
            if changed is None:
                continue
            answer = changed.noticed_by or "not noticed"
            print(f"{changed.setting} x {factor:g}: {answer}", flush=True)
            if out is not None:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(changed)) + "\n")
            yield changed


if __name__ == "__main__":
    main()
