"""No circle of imports between modules, those in function bodies counted."""

from __future__ import annotations

import graphlib

import pytest

import rooms


def test_no_module_imports_itself_by_way_of_others():
    graph = {name: rooms.modules_imported(path) - {name} for name, path in rooms.modules().items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_no_function_imports_a_module_of_its_own_room():
    """Such an import hides a circle, or saves nothing."""
    found = []
    for name, path in rooms.modules().items():
        if name == "updyn":
            continue
        for line, target in rooms.inner_imports(path.read_text(encoding="utf-8")):
            if target.split(".")[1] == name.split(".")[1]:
                found.append(f"{name}:{line} imports {target}")
    assert found == []
