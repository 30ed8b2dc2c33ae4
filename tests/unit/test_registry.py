"""Registries: entries by name, imported when they are first used."""

from __future__ import annotations

import sys
from importlib import metadata

import pytest

from updyn.errors import OptionError
from updyn.registry import Registry, load_object


def shapes(**more: object) -> Registry[object]:
    return Registry("shape", "updyn.test-shapes", {"circle": 1.0, **more})


def test_an_entry_is_imported_when_it_is_used(monkeypatch):
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    found = shapes(hue="colorsys:rgb_to_hls")
    assert list(found) == ["circle", "hue"]
    assert "colorsys" not in sys.modules
    assert found["hue"] is load_object("colorsys:rgb_to_hls")


def test_registered_entries_come_last_and_once():
    found = shapes()
    found.register("square", 2.0)
    found.register("square", 2.0)
    assert dict(found) == {"circle": 1.0, "square": 2.0}
    with pytest.raises(OptionError, match="shape 'square' is registered already"):
        found.register("square", 3.0)


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(OptionError, match=r"shape 'cirle': .*'circle'"):
        shapes().find("cirle")
    with pytest.raises(KeyError):
        shapes()["cirle"]


def test_entry_points_of_other_packages(monkeypatch):
    point = metadata.EntryPoint("hue", "colorsys:rgb_to_hls", "updyn.test-shapes")
    mine = metadata.EntryPoint("circle", "colorsys:rgb_to_hsv", "updyn.test-shapes")
    asked = []

    def entry_points(*, group: str) -> list[metadata.EntryPoint]:
        asked.append(group)
        return [point, mine]

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    found = shapes()
    assert found["circle"] == 1.0  # a built-in entry keeps its name, and nothing is searched for it
    assert asked == []
    assert found.find("hue") is load_object("colorsys:rgb_to_hls")
    assert len(found) == 2
    assert asked == ["updyn.test-shapes"]
