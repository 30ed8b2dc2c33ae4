"""Lines of keys: by hand for each construct, and by property for nested documents."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
import tomlkit
from hypothesis import given
from hypothesis import strategies as st

from updyn.job.toml_lines import line_of, read_toml, toml_lines

DOCUMENT = (
    r'''# [comment] key = 1
title = "a ] # [b] = 3"
a.b."c.d" = [1, # x ]
  2, [3,
  "]"], {q = 1, r = [1,2]}]
long = """
[notatable]
x = "y" ""q"""""
raw = '''
    + "'''\n[no]\n''''"
    + r"""
escaped = "a\"b = {"  # "
[model]
file = 'c:\x'
when = 1979-05-27 07:32:00
[match.table]
"5:+Z" = "6:Z"
[[parameter]]
groups = ["a",
  "b"]
[[parameter]]
bounds = [
  0.3,
  3.0,
]
[parameter.sub]
z=1
[[parameter.deep]]
y=2
[[parameter.deep]]
y=3
[ "x" . y ]
"""
)
LINES = {
    ("title",): 2, ("a",): 3, ("a", "b", "c.d"): 3, ("a", "b", "c.d", 0): 3, ("a", "b", "c.d", 1): 4,
    ("a", "b", "c.d", 2, 1): 5, ("a", "b", "c.d", 3, "r", 1): 5, ("long",): 6, ("raw",): 9, ("escaped",): 12,
    ("model",): 13, ("model", "file"): 14, ("model", "when"): 15, ("match",): 16, ("match", "table", "5:+Z"): 17,
    ("parameter",): 18, ("parameter", 0, "groups", 1): 20, ("parameter", 1): 21, ("parameter", 1, "bounds"): 22,
    ("parameter", 1, "bounds", 1): 24, ("parameter", 1, "sub", "z"): 27, ("parameter", 1, "deep", 0, "y"): 29,
    ("parameter", 1, "deep", 1): 30, ("parameter", 1, "deep", 1, "y"): 31, ("x", "y"): 32,
}  # fmt: skip


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_of_every_construct(end: str) -> None:
    document, lines = read_toml(DOCUMENT.replace("\n", end))
    assert document["parameter"][1]["deep"][1] == {"y": 3}
    assert {place: lines.get(place) for place in LINES} == LINES
    assert ("notatable",) not in lines
    assert ("no",) not in lines


def places(value: Any, at: tuple[str | int, ...] = ()) -> list[tuple[tuple[str | int, ...], Any]]:
    """All places of a document with what stands there."""
    inside = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    found = [(at, value)] if at else []
    return found + [p for key, item in inside for p in places(item, (*at, key))]


_counter = itertools.count(10**6)
leaves = st.builds(
    lambda text: f"{text}#{next(_counter)}", st.text("ab[]{}=,.#'\"\\ \n", max_size=8)
)
keys = st.text("abc.# ]\"'", max_size=4)
documents = st.dictionaries(
    keys,
    st.recursive(
        leaves,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3),
        max_leaves=12,
    ),
    max_size=4,
)


@given(documents, st.booleans())
def test_every_place_of_a_document_has_the_line_it_stands_on(
    document: dict[str, Any], multiline: bool
) -> None:
    written = tomlkit.document()
    for key, value in document.items():
        item = tomlkit.item(value)
        if multiline and isinstance(item, tomlkit.items.Array):
            item.multiline(True)
        written.add(
            (
                tomlkit.key(key)
                if key.isalpha()
                else tomlkit.items.SingleKey(key, tomlkit.items.KeyType.Basic)
            ),
            item,
        )
    text = tomlkit.dumps(written)
    read, lines = read_toml(text)
    rows = text.split("\n")
    for place, value in places(read):
        assert place in lines
        if isinstance(value, str):
            number = value.rpartition("#")[2]
            assert number in rows[lines[place] - 1]


def test_a_place_that_the_text_does_not_have_gets_the_nearest_around_it() -> None:
    lines = toml_lines("[model]\nfile = 'a'\n[test]\nband = [1,\n 2]\n")
    assert line_of(("test", "band", 1), lines) == 5
    assert line_of(("test", "band", 7, "deeper"), lines) == 4
    assert line_of(("test", "file"), lines) == 3
    assert line_of(("output",), lines) is None
