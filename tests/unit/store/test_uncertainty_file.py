"""Draws and profiles come back from their file as they went; what is not one is refused by name."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, OptionError
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Interval, Profile, Profiles


def draws(kind: str = "sampling") -> Draws:
    rng = np.random.default_rng(0)
    return Draws(
        kind, ("a.stiffness", "b.loss_factor"), rng.uniform(0.5, 1.0, (3, 4, 2)), np.array([0.7, 0.02]),
        np.array([0.1, np.inf]), np.array([0.01, 0.0]), np.array([100.0, 1.0]), np.array([True, False]),
        {"r_hat": np.array([1.0, np.nan])}, {"not solved": 2}, False, "Not converged: µ.", {"n": 4, "error": np.inf},
    )  # fmt: skip


def profiles() -> Profiles:
    one = Profile(
        "a.stiffness", 0.7, np.array([0.5, 0.7, 0.9]), np.array([2.0, 0.0, 3.0]), np.arange(6.0).reshape(3, 2),
        (Interval(0.5, 0.6, 0.65, 0.1), Interval(0.69, 0.7, 0.8, 0.0)), "level", "bound",
    )  # fmt: skip
    other = Profile(
        "b.loss_factor", 0.0, np.array([0.0, 0.1]), np.array([0.0, 4.0]), np.ones((2, 2)),
        (Interval(0.0, 0.0, 0.05, 0.0),), "zero", "level",
    )  # fmt: skip
    return Profiles((one, other), 0.95, 1.92, ("c.mass",), {"a.stiffness": 0.6})


def test_draws_come_back(tmp_path: Path) -> None:
    written = draws()
    updyn.write_uncertainty(written, tmp_path / "u.nc")
    read = updyn.read_uncertainty(tmp_path / "u.nc")
    assert isinstance(read, Draws)
    for name in ("kind", "names", "failed", "converged", "message", "options"):
        assert getattr(read, name) == getattr(written, name)
    for name in ("chains", "estimate", "std", "lower", "upper", "is_factor"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_array_equal(read.diagnostics["r_hat"], [1.0, np.nan])
    assert read.summary() == written.summary()


def test_profiles_come_back(tmp_path: Path) -> None:
    written = profiles()
    updyn.write_uncertainty(written, tmp_path / "u.nc")
    read = updyn.read_uncertainty(tmp_path / "u.nc")
    assert isinstance(read, Profiles)
    assert (read.level, read.threshold, read.missing, read.better) == (
        0.95,
        1.92,
        ("c.mass",),
        {"a.stiffness": 0.6},
    )
    for name, one in written.items():
        assert (read[name].intervals, read[name].note, read[name].estimate) == (
            one.intervals,
            one.note,
            one.estimate,
        )
        for what in ("values", "drop", "others"):
            np.testing.assert_array_equal(getattr(read[name], what), getattr(one, what))
    assert read.summary() == written.summary()


def test_what_is_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="expected draws or profiles, found dict"):
        updyn.write_uncertainty({}, tmp_path / "u.nc")
    assert not (tmp_path / "u.nc").exists()
    updyn.write_uncertainty(draws(), tmp_path / "u.nc")
    with pytest.raises(FormatError, match=r"did you mean 'u\.nc'"):
        updyn.read_uncertainty(tmp_path / "un.nc")
    with pytest.raises(FormatError, match="read_uncertainty"):
        updyn.read_result(tmp_path / "u.nc")
    frf = updyn.FRF([1.0], [[[1.0 + 0j]]], ["1:X"], ["1:X"], "receptance")
    updyn.write_frf(frf, tmp_path / "f.nc")
    with pytest.raises(FormatError, match="read_frf"):
        updyn.read_uncertainty(tmp_path / "f.nc")
    with h5py.File(tmp_path / "u.nc", "r+") as file:
        del file["std"]
    with pytest.raises(FormatError, match="no variable 'std'"):
        updyn.read_uncertainty(tmp_path / "u.nc")
    (tmp_path / "u.nc").write_bytes(b"not a file")
    with pytest.raises(FormatError):
        updyn.read_uncertainty(tmp_path / "u.nc")
