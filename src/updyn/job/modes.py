"""The modal table of a run: looked for once after the update, and as text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from updyn.updating.modes import modal_table
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["modal_texts", "with_modes"]


def with_modes(result: UpdateResult | JointResult) -> UpdateResult | JointResult:
    """Return a result with the modal table of each test."""
    if isinstance(result, UpdateResult):
        return replace(result, modes=modal_table(result))
    given = result.first.options.get("modes")
    by_test = given if isinstance(given, Mapping) else {}
    found = {}
    for name, one in result.results.items():
        found[name] = replace(one, modes=modal_table(one, by_test.get(name)))
    return replace(result, results=found)


def modal_texts(result: UpdateResult | JointResult) -> list[str]:
    """Return the modal table of each test as text, those of several tests under their names."""
    texts = []
    for name, one in result.results.items():
        if one.modes is not None:
            head = f"{name}: " if name else ""
            texts.append(head + one.modes.text())
    return texts
