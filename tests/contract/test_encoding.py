"""Text is read and written as UTF-8, or as a format demands, whatever the locale."""

from __future__ import annotations

import ast

import pytest

import rooms

#: Functions that open, read or write a file, as text unless stated otherwise.
OPENERS = ("open", "read_text", "write_text", "NamedTemporaryFile")


def without_encoding(source: str) -> list[int]:
    """Lines that open, read or write a text file and state no encoding."""
    found = []
    if not any(f"{name}(" in source for name in OPENERS):
        return found
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = getattr(function, "attr", getattr(function, "id", ""))
        # Descriptors, and the members of a zip archive, are bytes.
        of = getattr(getattr(function, "value", None), "id", "")
        if name not in OPENERS:
            continue
        if of in ("os", "archive"):
            continue
        stated = {k.arg for k in node.keywords}
        texts = [a.value for a in node.args if isinstance(a, ast.Constant)]
        texts += [k.value.value for k in node.keywords if isinstance(k.value, ast.Constant)]
        binary = any(isinstance(t, str) and "b" in t and set(t) <= set("rwaxb+") for t in texts)
        if "encoding" not in stated and not binary and None not in stated:
            found.append(node.lineno)
    return found


def test_every_text_file_states_its_encoding() -> None:
    found = []
    for path in rooms.files():
        lines = without_encoding(path.read_text(encoding="utf-8"))
        found += [f"{rooms.module_of(path)}:{line}" for line in lines]
    assert found == []


@pytest.mark.parametrize(
    ("source", "wrong"),
    [
        ("path.open()", 1),
        ("path.open('w')", 1),
        ("open(path, mode='w', newline='')", 1),
        ("path.read_text()", 1),
        ("path.write_text(text, newline='')", 1),
        ("path.open('rb')", 0),
        ("open(path, mode='wb')", 0),
        ("path.read_text(encoding='utf-8')", 0),
        ("os.open(path, os.O_RDONLY)", 0),
        ("archive.open(member)", 0),
    ],
)
def test_calls_without_encoding_are_found(source: str, wrong: int) -> None:
    assert len(without_encoding(source)) == wrong
