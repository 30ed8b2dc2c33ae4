"""Another value for a setting during a test."""

from __future__ import annotations

from typing import Any

import pytest


def override(monkeypatch: pytest.MonkeyPatch, settings: Any, **values: Any) -> None:
    """Give fields of a frozen settings object other values until the test ends."""
    for name, value in values.items():
        monkeypatch.setitem(_require_field(settings, name), name, value)


def _require_field(settings: Any, name: str) -> dict[str, Any]:
    """Return the values of a settings object, which has a field of this name."""
    fields = vars(settings)
    assert name in fields, f"{type(settings).__name__} has no field {name!r}, but {sorted(fields)}"
    return fields
