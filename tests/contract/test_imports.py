"""A light import, and imports in one direction."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import rooms
import updyn

HEAVY = [
    "h5py",
    "xarray",
    "pandas",
    "pydantic",
    "cyclopts",
    "rich",
    "tomlkit",
    "pyuff",
    "plotly",
    "matplotlib",
]
HEAVY += ["jinja2", "joblib", "dask", "distributed", "mkl"]

#: What a script that reads no file needs; each is loaded with the package before the weight is
#: looked at.
CORE = [
    "FRF",
    "Dof",
    "DofSet",
    "Geometry",
    "Group",
    "Model",
    "UpdateResult",
    "parameters",
    "response",
    "modes",
]
CORE += ["condense", "correlate", "update"]


def fresh(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    "code", ["import updyn", *(f"import updyn; updyn.{name}" for name in CORE)]
)
def test_nothing_heavy_is_loaded(code):
    loaded = fresh(f"{code}\nimport sys\nprint(*{{m.split('.')[0] for m in sys.modules}})").split()
    assert [m for m in HEAVY if m in loaded] == []


def test_the_core_loads_numpy_and_scipy_and_nothing_else_from_outside():
    code = "import updyn; updyn.Model; updyn.FRF; updyn.parameters"
    loaded = set(
        fresh(f"import sys\n{code}\nprint(*{{m.split('.')[0] for m in sys.modules}})").split()
    )
    bare = set(
        fresh(
            "import sys\nimport scipy.sparse\nprint(*{m.split('.')[0] for m in sys.modules})"
        ).split()
    )
    assert {"numpy", "scipy"} <= loaded
    extra = (
        {m for m in loaded - bare if not m.startswith("_")}
        - set(sys.stdlib_module_names)
        - {"updyn", "lazy_loader"}
    )
    assert extra == set()


def test_the_readers_load_no_identification_of_modes():
    assert fresh("import sys\nimport updyn.io\nprint('updyn.modal' in sys.modules)") == "False"


def test_the_commands_load_neither_optimiser_nor_update():
    loaded = fresh("import sys\nimport updyn.cli.commands\nprint(*sys.modules)").split()
    unwanted = {"scipy.optimize", "updyn.modal", "updyn.updating.problem", "updyn.store.result"}
    unwanted |= {"scipy.spatial"}
    assert not unwanted & set(loaded)


def test_job_tables_load_no_part_of_scipy_that_they_may_not_need():
    code = "import sys\nimport updyn.job\nimport updyn.control.job.job_tables\nprint(*sys.modules)"
    unwanted = {"scipy.stats", "scipy.interpolate", "scipy.ndimage"}
    assert not unwanted & set(fresh(code).split())


def test_a_page_loads_no_rooms_of_other_pages():
    loaded = fresh("import sys\nfrom updyn.report import write_start\nprint(*sys.modules)").split()
    others = {"acceptance", "candidates", "comparison", "planning", "population"}
    assert not {f"updyn.{room}" for room in others} & set(loaded)


def seconds(code: str) -> float:
    """Least time of one statement in five fresh interpreters: noise of the machine only adds."""
    timed = f"import time\nt = time.perf_counter()\n{code}\nprint(time.perf_counter() - t)"
    return min(float(fresh(timed)) for _ in range(5))


@pytest.mark.parametrize(
    "code", ["import updyn", "import updyn; updyn.Model; updyn.FRF; updyn.parameters"]
)
def test_the_import_takes_less_than_three_times_that_of_scipy_sparse(code):
    ratio = seconds(code) / seconds("import scipy.sparse")
    if ratio >= 3.0:  # a burst of other work: once more before it is believed
        ratio = min(ratio, seconds(code) / seconds("import scipy.sparse"))
    assert ratio < 3.0


# -- direction ---------------------------------------------------------------------------------------------
def test_every_module_has_a_room():
    strays = {
        room
        for p in rooms.files()
        if (room := rooms.room_of(rooms.module_of(p))) not in {None, *rooms.LEVEL}
    }
    assert strays == set()


def wrong_imports(source: str, module: str, is_package: bool) -> list[str]:
    own = rooms.room_of(module)
    if own is None:  # the package itself offers names of all rooms, loaded when used
        return []
    found = []
    for line, other in rooms.used_rooms(source, module, is_package):
        if other == own:
            continue
        if other not in rooms.LEVEL:
            found.append(
                f"{module}:{line} imports the package itself; import from the module that defines"
                " the name"
            )
        elif rooms.LEVEL[other] > rooms.LEVEL[own]:
            found.append(
                f"{module}:{line} imports {other!r}, which stands later in the order than {own!r}"
            )
        elif rooms.LEVEL[other] == rooms.LEVEL[own]:
            found.append(f"{module}:{line} imports its sibling {other!r}")
    return found


def test_imports_go_one_way():
    found = []
    for path in rooms.files():
        source = path.read_text(encoding="utf-8")
        found += wrong_imports(source, rooms.module_of(path), path.name == "__init__.py")
    assert found == []


@pytest.mark.parametrize(
    ("module", "source", "wrong"),
    [
        ("updyn.model", "from updyn.dofs import Dof", 0),
        ("updyn.dofs", "from updyn.model import Model", 1),
        ("updyn.dofs", "def f():\n    import updyn.model", 1),
        ("updyn.dofs", "from updyn import model", 1),
        ("updyn.dofs", "from . import model", 1),
        ("updyn.dofs", "from .model import Model", 1),
        ("updyn.dofs", "from updyn import Model", 1),
        ("updyn.dofs", "import updyn", 1),
        ("updyn.dofs", "import importlib\nimportlib.import_module('updyn.model')", 1),
        (
            "updyn.dofs",
            (
                "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from updyn.model import"
                " Model"
            ),
            0,
        ),
        ("updyn.io.csv", "from updyn import __version__", 0),
        (
            "updyn.io.csv",
            "from updyn.io.formats import load\nfrom . import npz\nfrom ..frf import FRF",
            0,
        ),
        ("updyn.io.csv", "from ..cli import main", 1),
        ("updyn.cli", "from updyn.web import serve", 1),
        ("updyn.web", "from updyn.job import run", 0),
        ("updyn.geometry", "from updyn import __main__", 1),
        (
            "updyn.updating.update",
            "from updyn.dynamics.response import response\nimport dask.distributed",
            0,
        ),
    ],
)
def test_the_check_itself(module, source, wrong):
    assert len(wrong_imports(source, module, is_package=False)) == wrong


# -- names -------------------------------------------------------------------------------------------------
def test_public_names_resolve():
    for name in updyn.__all__:
        assert getattr(updyn, name) is not None
        assert name in dir(updyn)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Modle"):
        updyn.Modle  # noqa: B018


def test_all_names_of_a_module_resolve():
    missing = []
    for path in rooms.files():
        if path.name == "__main__.py":
            continue
        module = importlib.import_module(rooms.module_of(path))
        names = getattr(module, "__all__", [])
        missing += [f"{module.__name__}.{name}" for name in names if not hasattr(module, name)]
    assert missing == []
