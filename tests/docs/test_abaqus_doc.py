"""What docs/formats.md says of Abaqus, against the reader."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np

from places import ROOT
from updyn.io import read_model
from updyn.io.abaqus.model import read_model as read_abaqus

PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
SECTION = PAGE.split('<a id="abaqus"></a>')[1].split("\n<a id=")[0]


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", SECTION, re.DOTALL)
    assert found is not None
    return found[1]


def save(folder: Path, name: str) -> None:
    for letters, value in (("STIF", "4.0e3"), ("MASS", "2.5e-3")):
        (folder / name.format(letters)).write_text(f"3,2, 3,2, {value}\n")


def test_options_are_named() -> None:
    options = [
        p.name
        for p in inspect.signature(read_abaqus).parameters.values()
        if p.kind is p.KEYWORD_ONLY
    ]
    said = re.search(r"Options of reading: (.*)\n", SECTION)
    assert said is not None
    assert re.findall(r"`(\w+)`", said[1]) == options


def test_the_step_is_read(tmp_path: Path) -> None:
    (tmp_path / "job.inp").write_text("*NODE\n3, 1., 2., 3.\n" + block("text"))
    save(tmp_path, "job_{}1.mtx")
    model = read_model(tmp_path / "job.inp")
    assert (list(model.groups), model.dofs.labels) == (["wing"], ["3:Y"])


def test_the_toml_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(block("toml"))
    (tmp_path / "wing.inp").write_text("*NODE\n3, 1000., 2., 3.\n")
    save(tmp_path, "spar_{}2.mtx")
    model = read_model(tmp_path / "case.toml")
    assert model.groups["spar"].loss_factor == 0.02
    np.testing.assert_allclose(model.groups["spar"].stiffness.toarray(), [[4e6]])  # N/mm
    np.testing.assert_allclose(model.groups["spar"].mass.toarray(), [[2.5]])  # t
    assert model.geometry is not None
    np.testing.assert_allclose(model.geometry.xyz, [[1.0, 2e-3, 3e-3]])
