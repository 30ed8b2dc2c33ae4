"""Which settings no test notices when they are doubled or halved.

Settings are the fields of the frozen objects in the modules named `settings`: thresholds,
tolerances, counts. A recording runs the tests once and keeps which settings each test reads, and
its processor time. Then each setting is doubled and halved in a fork of the collected tests, which
runs those that read it until one fails. Tests that read few settings and are quick come first.

- noticed: a test fails that passes without the change, the process crashes, or it takes over 20 s
  and ten times as long as before.
- open: no test fails. With 0 tests, no test reads the setting, other than on import.
- stated: the comment of the setting states why no test has to notice: its reason begins with
  ``Effort:``, ``Drawing:``, ``Default:`` or ``Rounding:`` in place of ``Why:``. It is not changed.

Whole numbers are halved downwards; 1 is not halved, and 0 not changed. All numbers of a tuple are
scaled together. A test that reads a setting in another process only does not count.

    python benchmarks/thresholds.py [--settings "updating.fit.*" ...] [--tests tests/unit ...]
        [--reads build/reads.jsonl] [--record] [--budget 15] [--out build/changes.jsonl] [--print]

`--record` adds tests to the file of reads that are not there. `--budget`: seconds of tests for each
change. `--out` keeps each change as a line; changes that are there are made again only if they were
not noticed and the budget is larger. `--again`: also if it is not. `--print` makes no changes.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import importlib
import json
import os
import pkgutil
import resource
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pytest

import updyn

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from setting_fields import Setting, list_classes, list_settings  # noqa: E402

FACTORS = (2.0, 0.5)
#: Ratio of times from which a change is noticed by its cost; least limit in seconds.
SLOWER, LEAST_LIMIT = 10.0, 20.0
TESTS = ("tests/unit", "tests/property", "tests/analytic", "tests/io")


@dataclass
class Reads:
    """Which settings each passing test reads, and its seconds."""

    seconds: dict[str, float] = field(default_factory=dict)
    settings: dict[str, frozenset[str]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Reads:
        """Read a file of reads; tests that failed are left out."""
        reads = cls()
        for line in _read_lines(path):
            if line["passed"]:
                reads.seconds[line["test"]] = line["seconds"]
                reads.settings[line["test"]] = frozenset(line["settings"])
        return reads

    def choose_tests(self, key: str, budget: float) -> list[str]:
        """Return tests that read a setting, within seconds.

        Tests come in the order of their seconds times the number of settings that they read: the
        order with the least time until the first failure, if each test notices one of its settings.
        """
        reading = [test for test, read in self.settings.items() if key in read]
        reading.sort(key=lambda test: (0.01 + self.seconds[test]) * len(self.settings[test]))
        chosen: list[str] = []
        spent = 0.0
        for test in reading:
            if chosen and spent + self.seconds[test] > budget:
                continue
            chosen.append(test)
            spent += self.seconds[test]
        return chosen


class Recorder:
    """A plugin of pytest that writes which settings are read during each test."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known = {line["test"] for line in _read_lines(path)}
        self._current: set[str] = set()
        self._failed: set[str] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out tests that the file has; read all modules before the first test."""
        items[:] = [item for item in items if item.nodeid not in self._known]
        _import_all()
        for cls in list_classes():
            _watch(cls, self._current)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Write the settings that a test and its fixtures read."""
        self._current.clear()
        started = _processor_seconds()
        result = yield
        line = {
            "test": item.nodeid,
            "passed": item.nodeid not in self._failed,
            "seconds": round(_processor_seconds() - started, 4),
            "settings": sorted(self._current),
        }
        _append(self._path, line)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note tests that do not pass."""
        if report.outcome != "passed":
            self._failed.add(report.nodeid)


@dataclass(frozen=True)
class Change:
    """A changed setting, the tests that may run within the budget, and the first that fails.

    `noticed_by` is empty if none fails, and ``"time"`` or ``"crash"`` if the process does not end
    by itself.
    """

    setting: str
    factor: float
    value: Any
    tests: int
    budget: float
    noticed_by: str


class Changer:
    """A plugin of pytest that changes settings in place of running the collected tests."""

    def __init__(
        self, settings: list[Setting], reads: Reads, budget: float, out: Path, *, again: bool
    ) -> None:
        self.settings, self.reads, self.budget, self.out = settings, reads, budget, out
        self.made = load_changes(out)
        self._again = again
        self._items: dict[str, pytest.Item] = {}
        self._passing: dict[str, bool] = {}

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Change each setting, and write who notices."""
        _import_all()
        self._items = {item.nodeid: item for item in session.items}
        for setting in self.settings:
            if setting.is_exempt:
                continue
            first = ""
            for factor in FACTORS:
                change = self._change(setting, factor, first)
                if change is not None:
                    first = change.noticed_by
        return True

    def _change(self, setting: Setting, factor: float, first: str) -> Change | None:
        """Return how tests see a scaled setting; None if it is not made."""
        value = getattr(setting.object, setting.field)
        other = scale(value, factor)
        made = self.made.get((setting.name, factor))
        if other == value or (made is not None and not self._is_due(made)):
            return made
        tests = self.reads.choose_tests(key_of(setting), self.budget)
        tests = [test for test in tests if test in self._items]
        if first in tests:
            tests = [first, *(test for test in tests if test != first)]
        noticed_by = self._find_failure(setting, other, tests)
        change = Change(setting.name, factor, other, len(tests), self.budget, noticed_by)
        _append(self.out, asdict(change))
        print(f"{change.setting} x {factor:g}: {noticed_by or 'not noticed'}", file=sys.stderr)
        return change

    def _is_due(self, made: Change) -> bool:
        """Return whether a change is to be made again."""
        return not made.noticed_by and (self._again or made.budget < self.budget)

    def _find_failure(self, setting: Setting, value: Any, tests: list[str]) -> str:
        """Return the first test that fails with another value, and passes without."""
        left = list(tests)
        while left:
            seconds = sum(self.reads.seconds[test] for test in left)
            failed = _fork(setting, value, [self._items[test] for test in left], seconds)
            if failed not in left or self._passes(setting, failed):
                return failed
            left.remove(failed)
        return ""

    def _passes(self, setting: Setting, test: str) -> bool:
        """Return whether a test passes on its own, with the settings as they are."""
        if test not in self._passing:
            value = getattr(setting.object, setting.field)
            seconds = self.reads.seconds[test]
            self._passing[test] = not _fork(setting, value, [self._items[test]], seconds)
        return self._passing[test]


class FirstFailure:
    """A plugin of pytest that keeps the first test that fails."""

    def __init__(self) -> None:
        self.test = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the name of the first test that fails."""
        if report.failed and not self.test:
            self.test = report.nodeid


def _fork(setting: Setting, value: Any, items: list[pytest.Item], seconds: float) -> str:
    """Return the first test that fails with a value, in another process."""
    with tempfile.NamedTemporaryFile("r", suffix=".txt") as answer:
        Path(answer.name).write_text("crash")
        child = os.fork()
        if child == 0:
            try:
                _limit_time(max(LEAST_LIMIT, SLOWER * seconds))
                vars(setting.object)[setting.field] = value
                Path(answer.name).write_text(_run_until_failure(items))
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        if os.WIFSIGNALED(status):
            ends = (signal.SIGXCPU, signal.SIGALRM)
            return "time" if os.WTERMSIG(status) in ends else "crash"
        return answer.read()


def _limit_time(seconds: float) -> None:
    """End this process after so many seconds of its processor, or ten times as many of a clock."""
    os.setpgid(0, 0)
    used = int(sum(os.times()[:2]))
    resource.setrlimit(resource.RLIMIT_CPU, (used + int(seconds) + 1, resource.RLIM_INFINITY))
    signal.alarm(10 * int(seconds))


def _run_until_failure(items: list[pytest.Item]) -> str:
    """Return the name of the first test that fails; empty if all pass."""
    silent = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silent, stream)
    failure = FirstFailure()
    items[0].config.pluginmanager.register(failure)
    for item, following in zip(items, [*items[1:], None], strict=True):
        item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
        if failure.test:
            break
    return failure.test


def _watch(cls: type, read: set[str]) -> None:
    """Record each read of a field of a settings class."""
    plain = cls.__getattribute__

    def record(self: Any, name: str) -> Any:
        if not name.startswith("__"):
            read.add(f"{cls.__module__}:{cls.__name__}.{name}")
        return plain(self, name)  # type: ignore[call-arg]

    cls.__getattribute__ = record  # type: ignore[method-assign]


def _import_all() -> None:
    """Import all modules, so that no test reads a setting because it imports one first."""
    for module in pkgutil.walk_packages(updyn.__path__, "updyn."):
        if not module.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(module.name)


def _processor_seconds() -> float:
    """Return the processor time of this process and of its ended children."""
    return sum(os.times()[:4])


def _append(path: Path, line: dict[str, Any]) -> None:
    """Append a line of JSON to a file."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def _read_lines(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a file; none if there is no file."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def load_changes(path: Path) -> dict[tuple[str, float], Change]:
    """Return the last change of each setting and factor."""
    return {(line["setting"], line["factor"]): Change(**line) for line in _read_lines(path)}


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


def print_open(settings: list[Setting], changes: list[Change]) -> None:
    """Print the settings that no test notices, and those with a stated reason."""
    comments = {setting.name: setting.comment for setting in settings}
    print("\n| open | times | tests | comment |\n|---|---|---|---|")
    for c in changes:
        if not c.noticed_by:
            print(f"| {c.setting} | {c.factor:g} | {c.tests} | {comments[c.setting]} |")
    print("\n| stated | comment |\n|---|---|")
    for setting in settings:
        if setting.is_exempt:
            print(f"| {setting.name} | {setting.comment} |")


def print_counts(settings: list[Setting], changes: list[Change]) -> None:
    """Print the numbers of settings and changes by package."""
    package = {setting.name: setting.package for setting in settings}
    counts: dict[str, Counter[str]] = {name: Counter() for name in sorted(set(package.values()))}
    for setting in settings:
        counts[setting.package].update(
            ["settings", "stated"] if setting.is_exempt else ["settings"]
        )
    for c in changes:
        counts[package[c.setting]].update(["changes", "noticed" if c.noticed_by else "open"])
    columns = ("settings", "stated", "changes", "noticed", "open")
    print("\n| package | " + " | ".join(columns) + " |\n|" + "---|" * (1 + len(columns)))
    total = sum(counts.values(), Counter())
    for name, row in [*counts.items(), ("all", total)]:
        print(f"| {name} | " + " | ".join(str(row[column]) for column in columns) + " |")


def parse_options() -> argparse.Namespace:
    """Return the options of the command line."""
    build = ROOT / "build"
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--settings", nargs="+", default=["*"], metavar="GLOB")
    parser.add_argument("--tests", nargs="+", default=[str(ROOT / test) for test in TESTS])
    parser.add_argument("--reads", type=Path, default=build / "reads.jsonl")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--budget", type=float, default=15.0)
    parser.add_argument("--out", type=Path, default=build / "changes.jsonl")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--print", action="store_true")
    return parser.parse_args()


def run_pytest(tests: list[str], plugin: object) -> None:
    """Run pytest on quick tests with a plugin."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["-q", "-s", "--no-header", "-m", "not long", "--rootdir", str(ROOT)]
        plugins = [part for name in ("cacheprovider", "xdist") for part in ("-p", f"no:{name}")]
        pytest.main([*options, *plugins, "--basetemp", f"{folder}/tests", *tests], [plugin])


def main() -> None:
    """Record, change, print."""
    options = parse_options()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    settings = [
        setting
        for setting in list_settings()
        if any(fnmatch.fnmatch(setting.name, glob) for glob in options.settings)
    ]
    if options.record:
        run_pytest(options.tests, Recorder(options.reads))
        return
    if not options.print:
        reads = Reads.load(options.reads)
        changer = Changer(settings, reads, options.budget, options.out, again=options.again)
        run_pytest(options.tests, changer)
    changed = {setting.name for setting in settings if not setting.is_exempt}
    changes = [c for c in load_changes(options.out).values() if c.setting in changed]
    print_open(settings, changes)
    print_counts(settings, changes)


if __name__ == "__main__":
    main()
