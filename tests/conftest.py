"""What all tests share: the Hypothesis profile and the cases of `data/cases`."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from hypothesis import HealthCheck, settings

import programs
import slow
import updyn
from cause_search import no_cause_search
from places import DATA
from updyn.errors import UpdynWarning
from updyn.foreign import box, plain
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.problem.parameters import ParameterSet

CASES = DATA / "cases"

# Workers of pytest-xdist state a width of 80 columns, in which printed tables and texts are wrapped.
os.environ.pop("COLUMNS", None)

# Derandomised: the same examples on every machine. No deadline: tests are not timed.
settings.register_profile(
    "updyn",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("updyn")


#: Folders whose tests fit, and print or compare what they find.
_ROUNDED = {"cli", "comparison", "docs", "recovery", "report"}
#: All methods on the gear train take minutes, other tests compare methods under every kernel;
#: rounding is nothing beside the scatter of many draws, or to signals, files, refusals and places.
_ONCE = {
    "test_bad_jobs.py",
    "test_compare_doc.py",
    "test_engine.py",
    "test_howto_doc.py",
    "test_process.py",
    "test_sensor_statistics.py",
    "test_statistics.py",
    "test_uncertainty_doc.py",
}
#: Folders of `tests` whose tests depend on Python itself: files, processes, text, imports.
_OF_PYTHON = ("contract", "io", "unit/cli", "unit/web")
#: Places whose tests check the causes of residuals; elsewhere, fits do not search for them.
_OF_CAUSES = (
    "contract",
    "docs",
    "hostile",
    "recovery",
    "unit/cli/test_faulty_data.py",
    "unit/updating",
)
#: Folders within these whose tests do not.
_WITHOUT_CAUSES = ("unit/updating/fit", "unit/updating/problem")


def _drawn(item: pytest.Item) -> bool:
    """Whether a browser is looked at, which draws what it is given."""
    return any("browser" in mark.args for mark in item.iter_markers("needs"))


def pytest_configure(config: pytest.Config) -> None:
    """Keep the order of the files, for which xdist takes the number of their tests."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    marks = {path: _marks(path) for path in {item.path for item in items}}
    for item in items:
        of_file = marks[item.path]
        if "kernels" in of_file and not _drawn(item):
            item.add_marker("kernels")
        if "python" in of_file:
            item.add_marker("python")
        for mark in slow.find_marks(item.path, item.nodeid):
            item.add_marker(mark)
    if hasattr(config, "workerinput"):  # a worker: a long file that begins last would run alone
        slow.sort_longest_first(items)


def _marks(path: Path) -> set[str]:
    """Return the marks that the place of a file gives to its tests."""
    parts, found = set(path.relative_to(DATA.parent).parts), set()
    if parts & _ROUNDED and not parts & _ONCE:
        found.add("kernels")
    if _is_within(path, _OF_PYTHON):
        found.add("python")
    return found


def _is_within(path: Path, places: Sequence[str]) -> bool:
    """Whether a file is one of some files and folders of `tests`, or in one."""
    file = path.relative_to(DATA.parent)
    return any(file.is_relative_to(place) for place in places)


def pytest_runtest_setup(item: pytest.Item) -> None:
    programs.skip_without_programs(item)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    lines = programs.not_run(terminalreporter.stats.get("skipped", []))
    if lines:
        terminalreporter.section("not run, as a program is missing")
        for line in lines:
            terminalreporter.write_line(line)


@pytest.fixture(autouse=True, scope="session")
def write_without_waiting_for_the_disk() -> Iterator[None]:
    """Files are not forced onto the disk: a run does it 25 times, for some milliseconds each.

    No test cuts the power; tests of the calls put their own function in this place.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda number: None)
        yield


@pytest.fixture(autouse=True)
def read_foreign_files_here(request: pytest.FixtureRequest) -> Iterator[None]:
    """Files of other programs are read in this process: a child takes half a second for each.

    The functions and the encoding are those of the child process; `hostile` has tests of that. Not
    by the fixture `monkeypatch`, which would then outlive `tmp_path` in every test.
    """
    if "hostile" in request.path.parts:
        yield
        return

    def load(
        function: str, path: Any, *arguments: Any, what: str, reader: str, extra_files: Any = ()
    ) -> Any:
        found = box.load_in_process(function, path, *arguments, what=what)
        return plain.decode(memoryview(b"".join(plain.encode(found))))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box, "load", load)
        yield


@pytest.fixture(autouse=True, scope="module")
def causes_where_they_are_checked(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fits search for the causes of their residual, which takes seconds, where tests check these."""
    if _is_within(request.path, _OF_CAUSES) and not _is_within(request.path, _WITHOUT_CAUSES):
        yield
        return
    with no_cause_search():
        yield


@pytest.fixture
def no_causes() -> Iterator[None]:
    """Fits of the test do not search for the causes of their residual."""
    with no_cause_search():
        yield


def load_case(name: str) -> dict[str, Any]:
    return json.loads((CASES / f"{name}.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def gear_train_case() -> dict[str, Any]:
    return load_case("gear_train")


@pytest.fixture(scope="session")
def gear_train_reference() -> dict[str, Any]:
    return load_case("gear_train_reference")


@pytest.fixture(scope="session")
def chain12_case() -> dict[str, Any]:
    return load_case("chain12")


@pytest.fixture(scope="session")
def gear_train_groups(gear_train_case: dict[str, Any]) -> dict[str, Group]:
    """The six groups of the paper's gear train at their true values, on seven DOFs (SI units)."""
    case, groups = gear_train_case, {}
    for number, (pair, mass, stiffness, loss) in enumerate(
        zip(
            case["pairs_of_dofs_1_based"],
            case["mass_units"],
            case["stiffness_units_1e6"],
            case["loss_factor"],
            strict=True,
        ),
        1,
    ):
        at = np.ix_(np.array(pair) - 1, np.array(pair) - 1)
        M, K = np.zeros((7, 7)), np.zeros((7, 7))
        M[at] = mass
        K[at] = np.array(stiffness) * 1e6
        groups[f"unit {number}"] = Group(K, M, loss_factor=loss)
    return groups


@pytest.fixture(scope="session")
def gear_train(gear_train_groups: dict[str, Group]) -> Model:
    """The paper's gear train at its true values; the warning about its second group has a test of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        return Model.from_groups(gear_train_groups, [f"{i}:RZ" for i in range(1, 8)])


@pytest.fixture(scope="session")
def chain12(chain12_case: dict[str, Any]) -> Model:
    """The 12-DOF chain at its start: groups of three springs and masses, loss factors as started."""
    groups = {}
    for number, members in enumerate(chain12_case["groups"], 1):
        K, M = np.zeros((12, 12)), np.zeros((12, 12))
        for i in members:
            k = chain12_case["stiffness"][i - 1]
            M[i - 1, i - 1] += chain12_case["mass"][i - 1]
            K[i - 1, i - 1] += k
            if i > 1:
                K[i - 2, i - 2] += k
                K[i - 1, i - 2] -= k
                K[i - 2, i - 1] -= k
        groups[f"part{number}"] = Group(
            K, M, loss_factor=chain12_case["start"]["loss_factor"][number - 1]
        )
    return Model.from_groups(groups, [f"{i}:X" for i in range(1, 13)])


@pytest.fixture(scope="session")
def chain12_true(chain12: Model, chain12_case: dict[str, Any]) -> Model:
    """The 12-DOF chain at its true values."""
    true = chain12_case["true_factors"]
    return chain12.scaled({f"part{g + 1}": {q: true[q][g] for q in true} for g in range(4)})


@pytest.fixture(scope="session")
def chain12_frf(chain12_true: Model, chain12_case: dict[str, Any]) -> FRF:
    """Receptances of the true chain without noise: 5 x 5, 60 lines, linear from 0.3 f1 to 1.05 f6."""
    K, M = chain12_true.stiffness.toarray(), chain12_true.mass.toarray()
    f = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    lines = np.linspace(0.3 * f[0], 1.05 * f[5], 60)
    at = [f"{i}:X" for i in chain12_case["measured_dofs_1_based"]]
    return updyn.response(
        chain12_true, lines, at, [f"{i}:X" for i in chain12_case["references_1_based"]]
    )


@pytest.fixture(scope="session")
def chain12_task(
    chain12: Model, chain12_true: Model, chain12_frf: FRF
) -> tuple[Model, FRF, ParameterSet, Any]:
    """The chain's start, two columns of its FRF without noise, all its unknowns, and their true values."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    truth = []
    for p in unknowns:
        true, start = chain12_true.group(p.group), chain12.group(p.group)
        damping = p.quantity == "loss_factor"
        sums = [
            abs(getattr(g, "stiffness" if damping else p.quantity)).sum() for g in (true, start)
        ]
        truth.append(true.loss_factor if damping else sums[0] / sums[1])
    return chain12, chain12_frf.select(references=["2:X", "12:X"]), unknowns, np.array(truth)


@pytest.fixture(scope="session")
def make_chain() -> Callable[[int], Model]:
    """A chain of any length fixed at one end, every mass with its spring a group, stiffer and heavier along it."""

    def chain(n: int) -> Model:
        groups = {}
        for e in range(n):
            K, M = np.zeros((n, n)), np.zeros((n, n))
            at = [e] if e == 0 else [e - 1, e]
            K[np.ix_(at, at)] = (
                3e4 * (1 + 0.2 * e) * (np.ones((1, 1)) if e == 0 else np.array([[1, -1], [-1, 1]]))
            )
            M[e, e] = 1.0 + 0.3 * e
            groups[f"part{e + 1}"] = Group(K, M, 0.02)
        return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])

    return chain


@pytest.fixture(scope="session")
def add_noise() -> Callable[..., FRF]:
    """Circular complex Gaussian noise: E|dH|^2 = (relative |H|)^2 + (floor rms)^2, or a given variance."""

    def noisy(
        frf: FRF, rng: np.random.Generator, relative: float = 0.0, floor: float = 0.0, **kwargs: Any
    ) -> FRF:
        H = frf.values
        unit = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
        std = np.hypot(relative * np.abs(H), floor * np.sqrt(np.mean(np.abs(H) ** 2)))
        return FRF(frf.freq, H + std * unit, frf.responses, frf.references, frf.quantity, **kwargs)

    return noisy


@pytest.fixture(scope="session")
def mixed_model() -> Callable[[float], Model]:
    """Make a model of translations beside rotations; the argument is the unit of length in metres."""

    def make(length: float) -> Model:
        rng, n = np.random.default_rng(8), 8
        T = np.diag(
            np.where(np.arange(n) % 2 == 0, length, 1.0)
        )  # displacements change, rotations do not
        groups = {}
        for name, own in (("a", np.arange(5)), ("b", np.arange(3, 8))):
            K, M, at = np.zeros((n, n)), np.zeros((n, n)), np.ix_(own, own)
            A, B = rng.standard_normal((2, 5, 5))
            K[at], M[at] = 1e4 * (A @ A.T + np.eye(5)), 0.05 * B @ B.T + np.eye(5)
            groups[name] = Group(T @ (K + K.T) @ T, T @ (M + M.T) @ T, loss_factor=0.03)
        return Model.from_groups(
            groups, [f"{i // 2 + 1}:{'Y' if i % 2 == 0 else 'RZ'}" for i in range(n)]
        )

    return make
