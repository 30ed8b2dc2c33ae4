"""`Remedy`: one step that the user can take, with the lines to paste."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

__all__ = ["IN_JOB", "IN_PYTHON", "Remedy", "join_remedies"]

IN_JOB, IN_PYTHON = "at the end of the job", "in Python"


@dataclass(frozen=True, slots=True)
class Remedy:
    """Advice, lines to paste, the place for them, and a remark; its text is one paragraph.

    Advice and remark are sentences. Advice that introduces lines ends with a colon. Lines are those
    of a job, of Python or of a terminal; without lines, place and remark are empty.
    """

    advice: str
    lines: tuple[str, ...] = ()
    place: str = ""
    remark: str = ""

    @classmethod
    def setting(cls, advice: str, table: str, key: str, value: object, remark: str = "") -> Self:
        """Return advice with a setting of a table of the job."""
        return cls(advice, (_assign(key, value),), f"under [{table}] of the job", remark)

    @classmethod
    def table(
        cls, advice: str, header: str, settings: Mapping[str, object], remark: str = ""
    ) -> Self:
        """Return advice with a new table of the job; `header` has its brackets."""
        lines = (header, *(_assign(key, value) for key, value in settings.items()))
        return cls(advice, lines, IN_JOB, remark)

    @classmethod
    def repair(cls, advice: str, repair_text: str, remark: str = "") -> Self:
        """Return advice with the setting of the job that corrects a fault of the data."""
        return cls.setting(advice, "test", "repair", [repair_text], remark)

    def __str__(self) -> str:
        code = self._quote_lines()
        return " ".join(filter(None, [self.advice, code, self.remark]))

    def _quote_lines(self) -> str:
        """Return lines and place as the end of a sentence; statements of Python as they are."""
        if not self.lines:
            return ""
        if self.place == IN_PYTHON:
            return "; ".join(self.lines)
        header, *settings = self.lines
        if not settings:
            return f"{header} {self.place}."
        *others, last = settings
        listed = f"{', '.join(others)} and {last}" if others else last
        return f"{header} with {listed} {self.place}."


def join_remedies(*groups: Iterable[Remedy]) -> tuple[Remedy, ...]:
    """Return remedies in order, without duplicates."""
    return tuple(dict.fromkeys(one for group in groups for one in group))


def _assign(key: str, value: object) -> str:
    # A text, a number or a list of them as JSON is valid TOML.
    return f"{key} = {json.dumps(value, ensure_ascii=False)}"
