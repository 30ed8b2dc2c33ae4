"""docs/development.md: its rooms, its way of a job and its names are those of the source."""

from __future__ import annotations

import importlib
import re
from typing import Any

from pages import ROOT, blocks
from rooms import ORDER, SRC, files, module_of
from updyn.registry import Registry

PAGE = ROOT / "docs" / "development.md"
TEXT = PAGE.read_text(encoding="utf-8")


def found(name: str) -> Any:
    """Import a module, or an attribute of one, by its dotted name."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        return getattr(importlib.import_module(module), attribute)


def section(heading: str) -> str:
    return TEXT.split(f"\n## {heading}\n")[1].split("\n## ")[0]


def extensions() -> list[list[str]]:
    """Return the rows of the table of extensions: kind, registry, entry points, class."""
    table = section("Extensions").split("|---|---|---|---|\n")[1].split("\n\n")[0]
    return [[cell.strip(" `") for cell in row.strip("|").split("|")] for row in table.splitlines()]


def test_the_picture_has_the_rooms_in_their_order() -> None:
    picture = next(block for block in blocks(PAGE) if block.language == "text")
    rows = re.findall(r"^   (\w+(?:, \w+)*)  ", picture.text, re.MULTILINE)
    drawn = [set(row.split(", ")) for row in rows if row != "room"]
    there = {path.relative_to(SRC).parts[0].removesuffix(".py") for path in files()}
    order = [there & set(level) for level in reversed(ORDER)]
    assert drawn == [level for level in order if level]


def test_a_job_takes_at_most_twelve_places_which_exist() -> None:
    steps = re.findall(r"^\d+\. `([\w.]+)`:", section("From a job to its results"), re.MULTILINE)
    modules = {module_of(path) for path in files()}
    assert 8 <= len(steps) <= 12
    assert set(steps) <= modules


def test_names_of_the_package_exist() -> None:
    names = set(re.findall(r"`(updyn(?:\.\w+)+)`", TEXT))
    groups = {row[2] for row in extensions()}
    assert len(names) > 30
    for name in names - groups:
        assert found(name) is not None, name


def test_names_in_capitals_and_classes_are_defined_somewhere() -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in files())
    names = set(re.findall(r"`([A-Z]\w+)`", TEXT)) - {"NAME", "ORDER", "TEXT"}
    assert names
    for name in names:
        assert re.search(rf"^(?:class )?{name}\b", source, re.MULTILINE), name


def test_functions_of_the_steps_are_defined() -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in files())
    for line in section("From a job to its results").splitlines():
        for name in re.findall(r"`([a-z]\w+)`", line):
            assert re.search(rf"^def {name}\(", source, re.MULTILINE), name


def test_paths_exist() -> None:
    paths = re.findall(r"`((?:tests|tools|src|\.ci)/[\w/.]+)`", TEXT)
    assert len(paths) > 5
    for path in paths:
        assert (ROOT / path).exists(), path


def test_every_registry_is_in_the_table_with_its_entry_points() -> None:
    named = {}
    for _, registry, group, made in extensions():
        assert isinstance(found(registry), Registry), registry
        assert found(registry).group == group
        if made != "a function":
            assert isinstance(found(made), type), made
        named[group] = registry
    source = "\n".join(path.read_text(encoding="utf-8") for path in files())
    used = re.findall(r'(?:Registry|_Methods)\(\s*"[\w ]+",\s*"(updyn\.\w+)"', source)
    assert set(used) == set(named)


def test_commands_of_make_exist() -> None:
    made = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([\w-]+)", TEXT):
        assert re.search(rf"^{target}:", made, re.MULTILINE), target
