"""docs/structures.md: its blocks run, and its tables name the fields that there are."""

from __future__ import annotations

import dataclasses
import importlib
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meshes import MSH
from pages import ROOT, blocks, run_python
from updyn.elements import structure as package
from updyn.elements.structure import structure_from_table

PAGE = ROOT / "docs" / "structures.md"


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("table.msh").write_text(MSH, encoding="utf-8")
    namespace: dict[str, Any] = {"__name__": "page"}
    run = [
        run_python(block, PAGE.name, namespace)
        for block in blocks(PAGE)
        if block.language == "python"
    ]
    assert len(run) == 2


def test_the_job_of_the_page_builds() -> None:
    (block,) = [b for b in blocks(PAGE) if b.language == "toml"]
    model = structure_from_table(tomllib.loads(block.text)["model"])
    assert list(model.groups) == ["root", "end", "tip"]


@pytest.mark.parametrize("name", ["Beam", "Truss", "Shell", "Solid", "Spring", "PointMass"])
def test_every_field_is_named(name: str) -> None:
    (row,) = re.findall(
        rf"^\| `{name}` \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(re.findall(r"`(\w+)`", row)) == {
        f.name for f in dataclasses.fields(getattr(package, name))
    }


def test_exact_and_own_frequencies_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frame and plates; `benchmarks/elements.py` prints the whole table."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    elements = importlib.import_module("elements")
    text = PAGE.read_text(encoding="utf-8")
    table = text.split("<!-- elements -->")[1].split("<!-- end of elements -->")[0]
    rows = [line.split("|")[3:5] for line in table.strip().splitlines()[2:]]
    shown = [(float(exact), float(own)) for exact, own in rows]
    structures = [case() for case in elements.CASES[:3]]
    found = [
        (exact, own)
        for one in structures
        for exact, own in zip(
            one.exact, elements.own_frequencies(one.own, len(one.exact)), strict=True
        )
    ]
    assert len(found) == 20
    np.testing.assert_allclose(found, shown[:20], atol=6e-4)


def test_exact_frequencies_are_those_of_the_literature(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leissa, J. Sound Vib. 31 (1973) 257: a free square plate, upper bounds.

    A cube has a mode of Lame (Lecons sur la theorie mathematique de l'elasticite, 1852).
    """
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    elements = importlib.import_module("elements")
    a, h, E, rho, nu = 1.0, 0.001, elements.E, elements.RHO, elements.NU
    unit = np.sqrt(E * h**2 / (12 * (1 - nu**2) * rho)) / (2 * np.pi * a**2)
    monkeypatch.setattr(elements, "ELASTIC", 0.1)
    plate = elements.exact_thin_plate((a, a), h, 4) / unit
    ratio = plate / [13.489, 19.789, 24.432, 35.024]
    assert (ratio < 1.0).all()
    assert ratio == pytest.approx(np.ones(4), rel=0.01)
    lame = np.sqrt(elements.G / rho) / (np.sqrt(2.0) * a)
    cube = elements.exact_block((a, a, a), 20, terms=(6, 6, 6))
    assert np.abs(cube / lame - 1.0).min() < 1e-4
