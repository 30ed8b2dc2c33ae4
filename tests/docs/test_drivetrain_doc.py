"""docs/drivetrain.md: its blocks run and agree, and its keys are those of the parts."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from pages import ROOT, blocks, run_python, save_toml
from updyn.elements.drivetrain import PARTS, drivetrain_from_table
from updyn.job import load_job
from updyn.model import Model

PAGE = ROOT / "docs" / "drivetrain.md"
TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """Run all Python blocks; what they print is under `printed`."""
    names: dict[str, Any] = {"__name__": "page"}
    with contextlib.redirect_stdout(io.StringIO()) as out:
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, PAGE.name, names)
    return {**names, "printed": out.getvalue()}


def same(one: Model, two: Model) -> None:
    assert one.dofs == two.dofs
    assert set(one.groups) == set(two.groups)
    for name, group in one.groups.items():
        other = two.groups[name]
        assert group.loss_factor == other.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            a, b = getattr(group, what), getattr(other, what)
            assert (a is None) == (b is None)
            assert a is None or np.array_equal(a.toarray(), b.toarray())


def test_the_job_declares_the_train_of_the_python_block(
    page: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (block,) = (b for b in blocks(PAGE) if b.language == "toml")
    path = save_toml(block)
    assert path is not None
    path.write_text(
        block.text
        + '[test]\nfile = "t.npz"\n[[parameter]]\ngroups = "all"\nquantity = "stiffness"\n',
        encoding="utf-8",
    )
    same(drivetrain_from_table(load_job(path).model.keys), page["model"])


def test_the_table_is_what_is_printed(page: dict[str, Any]) -> None:
    (shown,) = (b for b in blocks(PAGE) if b.language == "text")
    assert page["printed"] == shown.text


def test_the_drive_on_the_bracket(page: dict[str, Any]) -> None:
    whole = page["whole"]
    assert isinstance(whole, Model)
    assert whole.dofs.labels[:3] == ["50:RX", "50:RY", "50:RZ"]
    assert not {"1:RZ", "9:RZ"} & set(whole.dofs.labels)
    assert len(updyn.modes(whole, 3).frequency) == 3


def test_the_keys_are_those_of_the_parts() -> None:
    rows = re.findall(
        r"^\| `\[\[model\.(\w+)\]\]` \| `(\w+)` \| (.*) \| (.*) \|$", TEXT, re.MULTILINE
    )
    assert {table: kind for table, kind, _, _ in rows} == {k: v.__name__ for k, v in PARTS.items()}
    for table, _, required, optional in rows:
        fields = {f.name: f.default for f in dataclasses.fields(PARTS[table])}
        assert re.findall(r"`(\w+)`", required) == [
            k for k, d in fields.items() if d is dataclasses.MISSING
        ], table
        shown = dict(re.findall(r"`(\w+)(?:=([^`]*))?`", optional))
        expected = {k: _toml(d) for k, d in fields.items() if d is not dataclasses.MISSING}
        assert shown == expected, table


def _toml(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)
