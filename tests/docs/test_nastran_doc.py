"""What docs/formats.md says of Nastran, against the readers."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from places import ROOT
from updyn.errors import UpdynWarning
from updyn.io import read_model
from updyn.io.nastran import bdf
from updyn.io.nastran.op4 import write_op4

PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")


def section(name: str) -> str:
    return PAGE.split(f'<a id="{name}"></a>')[1].split("\n<a id=")[0]


@pytest.mark.parametrize("reader", [bdf.read_model, bdf.read_geometry])
def test_options_are_named(reader: object) -> None:
    options = [
        p.name for p in inspect.signature(reader).parameters.values() if p.kind is p.KEYWORD_ONLY
    ]  # type: ignore[arg-type]
    assert options
    assert all(f"`{name}`" in section("nastran") for name in options)


def test_the_toml_file_is_read(tmp_path: Path) -> None:
    found = re.search(r"```toml\n(.*?)```", section("op4"), re.DOTALL)
    assert found is not None
    (tmp_path / "case.toml").write_text(found[1])
    (tmp_path / "wing.bdf").write_text("GRID,1,,0.,0.,0.\nGRID,2,,1000.,0.,0.\n")
    K = np.zeros((12, 12))
    K[0, 0] = K[6, 6] = 4.0
    K[0, 6] = K[6, 0] = -4.0
    write_op4(
        {"KGG": K, "MGG": np.diag([1e-3, *[0.0] * 5, 2e-3, *[0.0] * 5])}, tmp_path / "skin.op4"
    )
    with pytest.warns(UpdynWarning, match="10 of 12 DOFs"):
        model = read_model(tmp_path / "case.toml")
    assert model.dofs.labels == ["1:X", "2:X"]
    np.testing.assert_allclose(model.stiffness.toarray(), [[4e3, -4e3], [-4e3, 4e3]])
    np.testing.assert_allclose(model.mass.diagonal(), [1.0, 2.0])
    assert model.groups["skin"].loss_factor == 0.02
    assert model.geometry is not None
    np.testing.assert_allclose(model.geometry.position([2]), [[1.0, 0, 0]])
