"""Every public function and class is documented, argument by argument (numpydoc).

Public names are those of docs/public-names.txt, with their public methods. Other names without a
leading underscore serve the library itself: they need a docstring, and if it lists arguments, these
have to be the right ones."""

from __future__ import annotations

import ast
import contextlib
import importlib
import re
from pathlib import Path

import pytest

import rooms

PUBLIC_NAMES = Path(__file__).parents[2] / "docs/public-names.txt"
HEADINGS = (
    "Parameters",
    "Attributes",
    "Returns",
    "Yields",
    "Raises",
    "Warns",
    "Notes",
    "References",
    "See Also",
)
HEADINGS += ("Examples", "Warnings", "Other Parameters")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def sections(doc: str) -> dict[str, list[str]]:
    """Split a docstring (already dedented) at its underlined headings."""
    lines = doc.split("\n")
    out: dict[str, list[str]] = {"": []}
    at = ""
    i = 0
    while i < len(lines):
        if (
            lines[i].strip() in HEADINGS
            and i + 1 < len(lines)
            and re.fullmatch(r"-{3,}", lines[i + 1].strip())
        ):
            at = lines[i].strip()
            out[at] = []
            i += 2
        else:
            out[at].append(lines[i])
            i += 1
    return out


def entries(body: list[str]) -> list[str]:
    """Return the names of a Parameters or Attributes section; ``a, b : type`` names two, ``*args`` is args."""
    names = []
    for line in body:
        if line and not line[0].isspace():
            names += [n.strip().lstrip("*") for n in line.split(" : ")[0].split(",")]
    return names


def arguments(node: Function, method: bool) -> list[str]:
    a = node.args
    plain = [x.arg for x in (*a.posonlyargs, *a.args)]
    static = any(isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list)
    if method and not static:
        plain = plain[1:]
    return plain + [x.arg for x in (a.vararg, *a.kwonlyargs, a.kwarg) if x]


def is_property(node: Function) -> bool:
    return any(
        ast.unparse(d).split(".")[-1] in ("property", "cached_property")
        for d in node.decorator_list
    )


def is_overload(node: Function) -> bool:
    return any(ast.unparse(d).split(".")[-1] == "overload" for d in node.decorator_list)


def class_arguments(node: ast.ClassDef) -> list[str]:
    """Return what a class is made with: the arguments of ``__init__``, or the fields of a dataclass."""
    for item in node.body:
        if isinstance(item, Function) and item.name == "__init__" and not is_overload(item):
            return arguments(item, method=True)
    if any("dataclass" in ast.unparse(d) for d in node.decorator_list) or "NamedTuple" in map(
        ast.unparse, node.bases
    ):
        return [
            item.target.id
            for item in node.body
            if isinstance(item, ast.AnnAssign)
            and isinstance(item.target, ast.Name)
            and not item.target.id.startswith("_")
            and "ClassVar" not in ast.unparse(item.annotation)
            and not (item.value is not None and "init=False" in ast.unparse(item.value))
        ]
    return []


def returns_something(node: Function) -> bool:
    return node.returns is not None and ast.unparse(node.returns) not in (
        "None",
        "Never",
        "NoReturn",
    )


def check_function(node: Function, name: str, *, method: bool, public: bool) -> list[str]:
    doc = ast.get_docstring(node)
    if not doc:
        return [f"{name}: no docstring"]
    if is_property(node):
        return []
    parts = sections(doc)
    if not public and "Parameters" not in parts:
        return []
    said, taken = entries(parts.get("Parameters", [])), arguments(node, method)
    out = [] if said == taken else [f"{name}: documents {said}, takes {taken}"]
    if public and taken and returns_something(node) and not {"Returns", "Yields"} & parts.keys():
        out.append(f"{name}: has no Returns section")
    return out


def check_module(source: str, module: str, public: set[str] | None = None) -> list[str]:
    """Return what is wrong; `public` None takes every name for public."""
    tree = ast.parse(source)
    out = [] if ast.get_docstring(tree) else [f"{module}: no docstring"]
    for node in tree.body:
        if not isinstance(node, Function | ast.ClassDef) or node.name.startswith("_"):
            continue
        name, is_public = f"{module}.{node.name}", public is None or node.name in public
        if isinstance(node, ast.ClassDef):
            out += check_class(node, name, public=is_public)
        elif not is_overload(node):
            out += check_function(node, name, method=False, public=is_public)
    return out


def check_class(node: ast.ClassDef, name: str, *, public: bool) -> list[str]:
    doc = ast.get_docstring(node)
    if not doc:
        return [f"{name}: no docstring"]
    parts = sections(doc)
    said = entries(parts.get("Parameters", []) or parts.get("Attributes", []))
    taken = class_arguments(node)
    out = []
    if (public or "Parameters" in parts) and said != taken and not is_protocol(node):
        out.append(f"{name}: documents {said}, takes {taken}")
    for item in node.body:
        if isinstance(item, Function) and not item.name.startswith("_") and not is_overload(item):
            out += check_function(item, f"{name}.{item.name}", method=True, public=public)
    return out


def front_doors() -> dict[str, set[str]]:
    """Return the public names by the module that defines them."""
    out: dict[str, set[str]] = {}
    for line in PUBLIC_NAMES.read_text(encoding="utf-8").splitlines():
        door, _, name = line.rpartition(".")
        if door.count(".") > 1:  # parts of a room implement protocols, which are documented once
            continue
        with contextlib.suppress(ImportError, AttributeError):  # a test of its own reports them
            thing = getattr(importlib.import_module(door), name)
            out.setdefault(getattr(thing, "__module__", None) or "", set()).add(name)
    return out


def is_protocol(node: ast.ClassDef) -> bool:
    return any("Protocol" in ast.unparse(base) for base in node.bases)


DOORS = front_doors()


def test_public_things_are_documented():
    found = []
    for path in rooms.files():
        module = rooms.module_of(path)
        found += check_module(path.read_text(encoding="utf-8"), module, DOORS.get(module, set()))
    assert found == []


def test_the_front_doors_are_found():
    assert "Group" in DOORS["updyn.group"]
    assert "Model" in DOORS["updyn.model"]
    assert "parameters" in DOORS["updyn.updating.problem.parameters"]


GOOD = '''
"""Module."""
from dataclasses import dataclass

def f(a, b, *rest, c=1, **more) -> int:
    """Do.

    Parameters
    ----------
    a, b : int
        Two.
    *rest : int
        Others.
    c : int
        One.
    **more
        Anything.

    Returns
    -------
    int
        A number.
    """

@dataclass
class D:
    """Hold.

    Attributes
    ----------
    x : int
        One.
    """

    x: int

    @property
    def twice(self) -> int:
        """Twice."""
'''


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("", "", []),
        (
            "a, b : int",
            "a : int",
            ["m.f: documents ['a', 'rest', 'c', 'more'], takes ['a', 'b', 'rest', 'c', 'more']"],
        ),
        ("a, b : int", "b, a : int", ["m.f: documents ['b', 'a', 'rest', 'c', 'more']"]),
        (
            "    Returns\n    -------\n    int\n        A number.\n",
            "",
            ["m.f: has no Returns section"],
        ),
        ("    x : int\n        One.\n", "", ["m.D: documents [], takes ['x']"]),
        ('        """Twice."""\n', "        return 2\n", ["m.D.twice: no docstring"]),
        ('"""Module."""\n', "", ["m: no docstring"]),
        (
            "def f(a, b",
            "def f(a, z",
            ["m.f: documents ['a', 'b', 'rest', 'c', 'more'], takes ['a', 'z',"],
        ),
    ],
)
def test_the_check_itself(old, new, found):
    got = check_module(GOOD.lstrip().replace(old, new, 1) if old else GOOD.lstrip(), "m")
    assert len(got) == len(found)
    for said, start in zip(got, found, strict=True):
        assert said.startswith(start)


def test_fields_of_a_named_tuple_are_looked_at():
    source = "'M.'\nclass P(NamedTuple):\n    'Pair.'\n    x: int\n"
    assert check_module(source, "m") == ["m.P: documents [], takes ['x']"]


def test_what_is_not_public_may_be_brief_but_not_wrong():
    source = "'M.'\ndef g(x):\n    'Short.'\ndef h(y):\n    pass\n"
    assert check_module(source, "m", set()) == ["m.h: no docstring"]
    assert check_module(source, "m", {"g"}) == [
        "m.g: documents [], takes ['x']",
        "m.h: no docstring",
    ]
    wrong = GOOD.lstrip().replace("c : int", "d : int", 1)
    assert len(check_module(wrong, "m", set())) == 1
