"""Settings: each number that decides an outcome is a field with a unit, a meaning and a reason."""

from __future__ import annotations

import re
from collections import Counter

from setting_fields import EXEMPT, list_classes, list_settings, read_attributes

_COMMENT = re.compile(rf"^\[[^\]]+\] \S.+?\. ({'|'.join(('Why', *EXEMPT))}): \S.+\.$", re.DOTALL)


def test_settings_are_frozen() -> None:
    assert all(cls.__dataclass_params__.frozen for cls in list_classes())  # type: ignore[attr-defined]


def test_settings_have_unit_meaning_and_reason() -> None:
    wrong = [s for s in list_settings() if not _COMMENT.match(s.comment)]
    assert not wrong, (
        "expected '#: [unit] Meaning. Why: reason (source).' (or Effort: ...) above each field\n"
        + ("\n".join(f"{s.place}: {s.name}: {s.comment!r}" for s in wrong))
    )


def test_every_setting_is_read() -> None:
    unread = [s for s in list_settings() if (s.instance, s.field) not in read_attributes()]
    assert not unread, "\n".join(f"{s.place}: nothing reads {s.name}" for s in unread)


def test_names_are_used_once() -> None:
    instances = Counter((s.instance, s.module) for s in list_settings())
    names = Counter(name for name, _ in instances)
    assert not {name for name, times in names.items() if times > 1}
