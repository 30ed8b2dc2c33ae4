"""Settings: each number that decides an outcome is a field with a unit, a meaning and a reason."""

from __future__ import annotations

import dataclasses
import re

import pytest

from setting_fields import Setting, list_classes, list_settings

_COMMENT = re.compile(r"^\[[^\]]+\] \S.+?\. Why: \S.+\.$", re.DOTALL)


@pytest.mark.parametrize("cls", list_classes(), ids=lambda cls: cls.__qualname__)
def test_settings_are_frozen(cls: type) -> None:
    assert dataclasses.is_dataclass(cls)
    assert cls.__dataclass_params__.frozen  # type: ignore[attr-defined]


@pytest.mark.parametrize("setting", list_settings(), ids=lambda setting: setting.name)
def test_a_setting_has_unit_meaning_and_reason(setting: Setting) -> None:
    assert _COMMENT.match(setting.comment), (
        f"{setting.place}: the comment of {setting.name} is {setting.comment!r}, "
        "expected '#: [unit] Meaning. Why: reason (source).' above the field"
    )


@pytest.mark.parametrize("setting", list_settings(), ids=lambda setting: setting.name)
def test_a_setting_is_used(setting: Setting) -> None:
    assert setting.uses, f"{setting.place}: nothing reads {setting.name}"
