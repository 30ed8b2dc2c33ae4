"""What docs/formats.md says of Ansys and OpenSees, against the readers."""

from __future__ import annotations

import inspect
import re

import pytest

from places import ROOT
from updyn.io.ansys import emat as ansys_emat
from updyn.io.ansys import full as ansys_full
from updyn.io.ansys import properties as ansys
from updyn.io.opensees import from_opensees

TEXT = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")


def section(name: str) -> str:
    return TEXT.split(f'<a id="{name}"></a>')[1].split("\n<a id=")[0]


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("ansys_full", ansys_full.read_model),
        ("ansys_emat", ansys_emat.read_model),
        ("opensees", from_opensees),
    ],
)
def test_every_option_is_named(name, function):
    options = [
        p.name for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY
    ]
    assert [o for o in options if f"`{o}`" not in section(name)] == []


def test_only_options_are_named():
    said = re.findall(
        r"`(\w+)`", "\n".join(re.findall(r"^\| (.*?) \|", section("ansys_emat"), re.MULTILINE)[1:])
    )
    parameters = inspect.signature(ansys_emat.read_model).parameters.values()
    assert said == [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


def test_elements_with_real_constants_are_named():
    assert re.findall(r"(?:COMBI|MASS)\w+", section("ansys")) == list(ansys._NAMES.values())
    assert all(label in section("ansys") for label in ansys._MODULI)


def test_calls_that_are_shown_are_python():
    for name in ("ansys", "ansys_full", "ansys_emat", "opensees"):
        for code in re.findall(r"```python\n(.*?)```", section(name), re.DOTALL):
            compile(code, name, "exec")
