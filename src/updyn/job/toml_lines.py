"""Line number of each key in a TOML text, which `tomllib` does not keep.

The scanner reads a text that `tomllib` has accepted, so it checks nothing.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping

from updyn.io.toml_text import parse_toml

__all__ = ["Place", "line_of", "read_toml", "toml_lines"]

#: Place in the parsed document: keys and positions in arrays, from the root.
Place = tuple[str | int, ...]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SCALAR = re.compile(r"[^,\]}\n#]*")
_BLANKS = re.compile(r"[ \t]*")
_FILLER = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BASIC = re.compile(r'"(?:[^"\\\n]|\\.)*"')
_LITERAL = re.compile(r"'[^'\n]*'")
_LONG_BASIC = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}(?!")', re.DOTALL)
_LONG_LITERAL = re.compile(r"'''.*?'{3,5}(?!')", re.DOTALL)


def read_toml(text: str) -> tuple[dict[str, object], dict[Place, int]]:
    """Parse a TOML text; return the document and the line of every table, key and array item."""
    document = parse_toml(text)
    return document, toml_lines(text)


def toml_lines(text: str) -> dict[Place, int]:
    """Return the line (from 1) of every table, key and array item of a valid TOML text."""
    # A table that is opened more than once, or by a dotted key, has its first line.
    return _Scanner(text.replace("\r\n", "\n")).run()


def line_of(place: Place, lines: Mapping[Place, int]) -> int | None:
    """Return the line of `place`, else of its nearest parent in the text; None without either."""
    for depth in range(len(place), 0, -1):
        if place[:depth] in lines:
            return lines[place[:depth]]
    return None


class _Scanner:
    """Scanner that passes once over the text; `at` is the current position."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Place, int] = {}
        self.count: dict[Place, int] = {}  # number of items so far of each array of tables

    def run(self) -> dict[Place, int]:
        table: Place = ()
        self.skip(_FILLER)
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self.read_header()
            else:
                self.read_pair(table)
            self.skip(_FILLER)
        return self.lines

    def read_header(self) -> Place:
        line, is_array = self.current_line(), self.text.startswith("[[", self.at)
        self.at += 2 if is_array else 1
        keys = self.read_keys()
        self.at += 2 if is_array else 1
        place: Place = ()
        for key in keys[:-1]:
            place = self.last_item(self.mark((*place, key), line))
        place = self.mark((*place, keys[-1]), line)
        if not is_array:
            return place
        number = self.count.get(place, 0)
        self.count[place] = number + 1
        return self.mark((*place, number), line)

    def last_item(self, place: Place) -> Place:
        """Return the last item if `place` is an array of tables, to which a header refers."""
        return (*place, self.count[place] - 1) if place in self.count else place

    def read_pair(self, table: Place) -> None:
        line, place = self.current_line(), table
        for key in self.read_keys():
            place = self.mark((*place, key), line)
        self.at += 1  # =
        self.skip(_BLANKS)
        self.read_value(place)

    def read_value(self, place: Place) -> None:
        start = self.text[self.at]
        if start == "[":
            self.read_array(place)
        elif start == "{":
            self.read_inline_table(place)
        elif start in "\"'":
            self.read_string()
        else:
            self.skip(_SCALAR)

    def read_array(self, place: Place) -> None:
        self.at += 1
        self.skip(_FILLER)
        number = 0
        while self.text[self.at] != "]":
            self.read_value(self.mark((*place, number), self.current_line()))
            self.skip_comma()
            number += 1
        self.at += 1

    def read_inline_table(self, place: Place) -> None:
        self.at += 1
        self.skip(_FILLER)
        while self.text[self.at] != "}":
            self.read_pair(place)
            self.skip_comma()
        self.at += 1

    def skip_comma(self) -> None:
        self.skip(_FILLER)
        if self.text[self.at] == ",":
            self.at += 1
            self.skip(_FILLER)

    def read_keys(self) -> list[str]:
        """Read a key, dotted or not, and the blanks after it."""
        out = []
        while True:
            self.skip(_BLANKS)
            out.append(self.read_string() if self.text[self.at] in "\"'" else self.skip(_BARE))
            self.skip(_BLANKS)
            if self.text[self.at] != ".":
                return out
            self.at += 1

    def read_string(self) -> str:
        """Read a string of any of the four kinds and return its value."""
        long = self.text.startswith(('"""', "'''"), self.at)
        basic = self.text[self.at] == '"'
        pattern = (
            (_LONG_BASIC if basic else _LONG_LITERAL) if long else (_BASIC if basic else _LITERAL)
        )
        raw = self.skip(pattern)
        # A long string is never a key, so its value is not needed.
        return "" if long else str(tomllib.loads(f"x={raw}")["x"])

    def skip(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self.text, self.at)
        assert found is not None  # the text is valid TOML
        self.at = found.end()
        return found[0]

    def current_line(self) -> int:
        return self.text.count("\n", 0, self.at) + 1

    def mark(self, place: Place, line: int) -> Place:
        self.lines.setdefault(place, line)
        return place
