"""Modes as netCDF-4: exact round trip with standard deviations, damaged files refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import updyn
from io_samples import frf
from updyn.cli import main
from updyn.errors import FormatError


def modes() -> updyn.ModeSet:
    rng = np.random.default_rng(0)
    return updyn.ModeSet(
        [31.0, 12.0],
        rng.normal(size=(3, 2)) + 1j * rng.normal(size=(3, 2)),
        ["1:Z", "2:-X", "7:RY"],
        [0.02, np.nan],
        [True, False],
        [0.9, 0.8],
        "a test",
        std_frequency=[0.1, 0.2],
        std_loss_factor=[0.001, np.nan],
        std_shapes=rng.uniform(size=(3, 2)),
        cov_frequency=[[0.01, 0.005], [0.005, 0.04]],
    )


@pytest.mark.parametrize("name", ["modes.nc", "modes.h5"])
def test_round_trip_is_exact(tmp_path: Path, name: str) -> None:
    updyn.write_modes(modes(), tmp_path / name)
    again = updyn.read_modes(tmp_path / name)
    assert again.digest == modes().digest
    assert again.source == "a test"
    assert again.dofs == modes().dofs
    np.testing.assert_array_equal(again.std_shapes, modes().std_shapes)
    np.testing.assert_array_equal(again.cov_frequency, modes().cov_frequency)


def test_frequencies_alone(tmp_path: Path) -> None:
    updyn.write_modes(updyn.ModeSet([12.0, 31.0]), tmp_path / "modes.nc")
    again = updyn.read_modes(tmp_path / "modes.nc")
    assert again.frequency.tolist() == [12.0, 31.0]
    assert not again.has_shapes
    assert again.std_shapes is None


def test_files_of_other_content_are_refused(tmp_path: Path) -> None:
    updyn.write_modes(modes(), tmp_path / "modes.nc")
    with pytest.raises(FormatError, match=r"read it with updyn\.read_modes"):
        updyn.read_frf(tmp_path / "modes.nc")
    updyn.write_frf(frf(), tmp_path / "frf.nc")
    with pytest.raises(FormatError, match=r"read it with updyn\.read_frf"):
        updyn.read_modes(tmp_path / "frf.nc")
    xr.Dataset({"a": 1.0}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(FormatError, match="updyn_kind"):
        updyn.read_modes(tmp_path / "other.nc")
    part = modes().to_xarray().drop_vars("shapes").assign_attrs(updyn_kind="modes", updyn_format=1)
    part.to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
    with pytest.raises(FormatError, match="no variable 'shapes'"):
        updyn.read_modes(tmp_path / "part.nc")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"frequency": ("mode", [1.0, -2.0])}, "frequency -2 Hz"),
        ({"shapes": ("mode", [1.0, 2.0])}, "expected shapes of"),
        ({"scaled": ("mode", ["a", "b"])}, "scaled"),
        ({"std_frequency": ("mode", ["a", "b"])}, "std_frequency"),
    ],
)
def test_damaged_values_are_named(tmp_path: Path, changed: dict[str, object], message: str) -> None:
    data = modes().to_xarray().drop_vars(["cov_frequency", *changed]).assign(changed)
    data = data.assign_attrs(updyn_kind="modes", updyn_format=1)
    data.to_netcdf(tmp_path / "modes.nc", engine="h5netcdf")
    with pytest.raises(FormatError, match=message):
        updyn.read_modes(tmp_path / "modes.nc")


def test_the_command_line_describes_them(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    updyn.write_modes(modes(), tmp_path / "modes.nc")
    assert main(["info", str(tmp_path / "modes.nc")]) == 0
    assert "Modes: 2 from 12 to 31 Hz" in capsys.readouterr().out
