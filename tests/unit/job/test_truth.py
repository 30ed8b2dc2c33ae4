"""True values from files: flat names, tables by group, and what is no truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError
from updyn.job.comparison import read_truth
from updyn.updating.problem.parameters import ParameterSet

WANTED = {"part 1.stiffness": 0.8, "part 1.loss_factor": 0.02, "skin.thickness": 1.1}


@pytest.fixture(scope="module")
def unknowns() -> ParameterSet:
    groups = {
        name: updyn.Group(np.eye(2), np.eye(2), loss_factor=0.01) for name in ("part 1", "skin")
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    plain = updyn.parameters(model, stiffness=["part 1"], mass=["part 1"], loss_factor=["part 1"])
    return plain + updyn.link(model, "skin.thickness", {"skin.stiffness": 3, "skin.mass": 1})


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "flat.toml",
            '"part 1.stiffness" = 0.8\n"part 1.loss_factor" = 0.02\n"skin.thickness" = 1.1\n',
        ),
        (
            "tables.toml",
            '["part 1"]\nstiffness = 0.8\nloss_factor = 0.02\n[skin]\nthickness = 1.1\n',
        ),
        (
            "flat.json",
            '{"part 1.stiffness": 0.8, "part 1.loss_factor": 0.02, "skin.thickness": 1.1}',
        ),
        (
            "nested.JSON",
            '{"part 1": {"stiffness": 0.8, "loss_factor": 0.02}, "skin.thickness": 1.1}',
        ),
    ],
)
def test_ways_to_write_it(tmp_path: Path, unknowns: ParameterSet, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert read_truth(tmp_path / name, unknowns) == WANTED


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "a.toml",
            '"part 1.stifness" = 0.8\n',
            "'part 1.stifness' is not an unknown of the job; did you mean",
        ),
        (
            "a.toml",
            '["part 1"]\nstiffness = true',
            "'part 1.stiffness': expected a finite number, found True",
        ),
        ("a.toml", '["part 1"]\nstiffness = nan', "expected a finite number, found nan"),
        ("a.toml", '["part 1"]\nstiffness = [1.0]', r"expected a finite number, found \[1.0\]"),
        (
            "a.toml",
            '"part 1.stiffness" = 0.8\n["part 1"]\nstiffness = 0.9\n',
            "'part 1.stiffness' occurs twice",
        ),
        ("a.toml", "stiffness 0.8", "not TOML"),
        ("a.toml", "", "contains no true value"),
        ("a.json", "[1, 2]", "expected names with values, found a list"),
        ("a.json", '{"part 1.stiffness": Infinity}', "expected a finite number, found inf"),
        ("a.json", '{"part 1.stiffness": 1%s}' % ("0" * 400), "expected a finite number, found 10"),
        ("a.json", '{"part 1": {"stiffness": 1, "stiffness": 2}}', "'stiffness' occurs twice"),
        ("a.json", "{" * 3, "not JSON"),
    ],
)
def test_what_is_no_truth(
    tmp_path: Path, unknowns: ParameterSet, name: str, text: str, message: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=message) as raised:
        read_truth(tmp_path / name, unknowns)
    assert str(raised.value).startswith(f"{tmp_path / name}:")


def test_no_such_file(tmp_path: Path, unknowns: ParameterSet) -> None:
    with pytest.raises(FormatError, match="cannot be read: No such file"):
        read_truth(tmp_path / "gone.toml", unknowns)
    (tmp_path / "latin.toml").write_bytes(b'"part 1.stiffness" = 0.8 # \xe9')
    with pytest.raises(FormatError, match="not UTF-8 text"):
        read_truth(tmp_path / "latin.toml", unknowns)
