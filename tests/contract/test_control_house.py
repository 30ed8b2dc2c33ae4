"""`updyn.control` stands on top of the other rooms: they find it by registries only, and load it when it is asked for."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rooms
from updyn.demos import find_demo

CONTROL = "updyn.control"
#: Modules that register parts of it by a text "module:attribute" or a dotted module.
REGISTRIES = {
    "updyn.cli",
    "updyn.cli.reading",
    "updyn.demos",
    "updyn.job.job_table",
    "updyn.plots",
    "updyn.report.section",
    "updyn.web.tasks",
}


def outside() -> list[tuple[str, Path]]:
    """All modules that are no part of it; the package itself offers its public names, loaded when used."""
    return [
        (name, path)
        for path in rooms.files()
        if rooms.room_of(name := rooms.module_of(path)) not in (None, "control")
    ]


def test_no_other_room_imports_it():
    found = []
    for name, path in outside():
        for line, target, what in rooms.imports_of(path):
            if target.startswith(CONTROL) or (target == "updyn" and what == "control"):
                found.append(f"{name}:{line}")
    assert found == []


def test_it_is_named_in_registries_only():
    named = set()
    for name, path in outside():
        source = path.read_text(encoding="utf-8")
        if f"{CONTROL}." not in source:
            continue
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Constant) and str(node.value).startswith(f"{CONTROL}."):
                named.add(name)
    assert named == REGISTRIES


JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = ["part1", "part2"]
quantity = "stiffness"
[method]
starts = 0
"""
PLANT = """[plant]
inputs = ["12:X"]
outputs = ["12:X"]
files = ["plant.json"]
"""
RUN = """
import sys
from updyn.cli import main
assert main({arguments!r}) in (0, 3)
print(*sorted(m for m in sys.modules if m.startswith("updyn.control")), file=sys.stderr)
"""


def loaded(*arguments: str) -> list[str]:
    """Return the modules of control that a command has loaded."""
    done = subprocess.run(
        [sys.executable, "-c", RUN.format(arguments=list(arguments))],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()[-1].split()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("chain")
    find_demo("chain").write_inputs(made)
    (made / "plain.toml").write_text(JOB, encoding="utf-8")
    (made / "control.toml").write_text(JOB + PLANT, encoding="utf-8")
    return made


def test_a_job_without_plant_runs_and_reports_without_it(folder):
    assert loaded("run", str(folder / "plain.toml")) == []
    assert (folder / "plain" / "report.html").is_file()


@pytest.mark.parametrize(
    "arguments", [("demo", "--list"), ("info", "chain.h5"), ("check", "plain.toml")]
)
def test_other_commands_do_without_it(folder, arguments):
    command, *files = arguments
    paths = [f if f.startswith("-") else str(folder / f) for f in files]
    assert loaded(command, *paths) == []


def test_a_job_with_plant_loads_it(folder):
    found = loaded("check", str(folder / "control.toml"))
    assert "updyn.control.job.job_tables" in found
    assert not [name for name in found if name.startswith("updyn.control.report")]
