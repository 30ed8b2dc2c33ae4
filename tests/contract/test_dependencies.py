"""What has to be installed is what the source imports: nothing is missing, nothing superfluous."""

from __future__ import annotations

import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import rooms

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
NEEDED = {Requirement(r).name: Requirement(r) for r in PROJECT["dependencies"]}
EXTRAS = {Requirement(r).name for part in PROJECT["optional-dependencies"].values() for r in part}
#: What a distribution is called where its name is not that of its package.
DISTRIBUTIONS = {
    "ansys": "ansys-mapdl-reader",
    "arviz_stats": "arviz-stats",
    "cuda": "cuda-bindings",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "nptdms": "npTDMS",
    "nvmath": "nvmath-python",
    "skfem": "scikit-fem",
}


def imported() -> set[str]:
    out = set()
    for path in rooms.files():
        source = path.read_text(encoding="utf-8")
        out |= {target.split(".")[0] for _, target, _ in rooms.imports_of(path) if target}
        out |= set(
            re.findall(r'engine="(\w+)"', source)
        )  # how xarray is told which library reads the file
    out = {name for name in out if name != "updyn" and name not in sys.stdlib_module_names}
    return {DISTRIBUTIONS.get(name, name) for name in out}


def test_what_is_imported_is_what_is_installed():
    optional = {name for name in imported() - set(NEEDED) if name in EXTRAS}
    assert imported() - optional == set(NEEDED)


def test_what_only_the_tests_use_is_not_imported():
    only_tests = {Requirement(r).name for r in PROJECT["optional-dependencies"]["test"]}
    assert imported() & only_tests == set()


@pytest.mark.parametrize("name", NEEDED)
def test_each_has_a_lowest_version_that_the_one_installed_meets(name):
    assert [s.operator for s in NEEDED[name].specifier] == [">="]
    assert NEEDED[name].specifier.contains(metadata.version(name), prereleases=True)


def test_the_imports_are_seen():
    assert {"numpy", "scipy", "xarray", "h5netcdf"} <= imported()
