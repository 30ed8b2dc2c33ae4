"""What the source never does."""

from __future__ import annotations

import ast

import pytest

import rooms
from rooms import dotted

PICKLES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal"}


def forbidden(source: str, module: str) -> list[str]:
    tree, out = ast.parse(source), []
    for node in ast.walk(tree):
        where = f"{module}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Attribute) and dotted(node).endswith(
            ("linalg.inv", "linalg.pinv", "np.matrix")
        ):
            out.append(f"{where} {dotted(node)}")
        if isinstance(node, ast.ImportFrom):
            if (node.module or "").endswith("linalg") and {a.name for a in node.names} & {
                "inv",
                "pinv",
            }:
                out.append(f"{where} imports inv")
            if (node.module or "").split(".")[0] in PICKLES:
                out.append(f"{where} pickle")
            if any(a.name == "*" for a in node.names):
                out.append(f"{where} star import")
        if isinstance(node, ast.Import) and any(
            a.name.split(".")[0] in PICKLES for a in node.names
        ):
            out.append(f"{where} pickle")
        if (
            isinstance(node, ast.keyword)
            and node.arg == "allow_pickle"
            and ast.unparse(node.value) != "False"
        ):
            out.append(f"{where} allow_pickle")
        if isinstance(node, ast.ExceptHandler):
            kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            if any(k is None or dotted(k) == "BaseException" for k in kinds):
                out.append(f"{where} bare except")
        raised = node.exc if isinstance(node, ast.Raise) else None
        raised = raised.func if isinstance(raised, ast.Call) else raised
        if raised is not None and dotted(raised) == "NotImplementedError":
            out.append(f"{where} NotImplementedError")
        if isinstance(node, ast.Call) and dotted(node.func) == "print" and module != "updyn.cli":
            out.append(f"{where} print")
        called = dotted(node.func) if isinstance(node, ast.Call) else ""
        if called == "sys.exit" and module in ("updyn.cli", "updyn.__main__"):
            continue
        if called in ("eval", "exec", "sys.exit", "exit", "quit"):
            out.append(f"{where} {called}")
    for number, line in enumerate(source.split("\n"), 1):
        if any(word in line for word in ("TODO", "FIXME", "XXX")):
            out.append(f"{module}:{number} unfinished")
        if any(word in line for word in ("/work/", "/farm", "/opt/", "/tmp/", "/home/")):
            out.append(f"{module}:{number} a path of one machine")
    return out


def test_forbidden_patterns():
    found = []
    for path in rooms.files():
        found += forbidden(path.read_text(encoding="utf-8"), rooms.module_of(path))
    assert found == []


@pytest.mark.parametrize(
    ("source", "wrong"),
    [
        ("import numpy as np\nnp.linalg.inv(a)", 1),
        ("from scipy.linalg import inv", 1),
        ("import scipy.sparse.linalg as sl\nx = sl.spsolve(a, b)", 0),
        ("import pickle", 1),
        ("from pickle import loads", 1),
        ("np.load(f, allow_pickle=True)", 1),
        ("np.load(f, allow_pickle=False)", 0),
        ("np.load(f, allow_pickle=flag)", 1),
        ("try:\n    f()\nexcept:\n    pass", 1),
        ("try:\n    f()\nexcept (ValueError, BaseException):\n    pass", 1),
        ("try:\n    f()\nexcept ValueError:\n    pass", 0),
        ("raise NotImplementedError", 1),
        ("raise NotImplementedError('x')", 1),
        ("return_value = NotImplemented", 0),
        ("try:\n    f()\nexcept NotImplementedError:\n    pass", 0),
        ("print('x')", 1),
        ("'print(x)'", 0),
        ("# TODO: later", 1),
        ("from x import *", 1),
        ("path = '/tmp/a'", 1),
        ("import sys\nsys.exit(2)", 1),
    ],
)
def test_the_check_itself(source, wrong):
    assert len(forbidden(source, "updyn.some")) == wrong


@pytest.mark.parametrize("source", ["print('x')", "import sys\nsys.exit(2)"])
def test_the_command_line_may_print_and_exit(source):
    assert forbidden(source, "updyn.cli") == []
