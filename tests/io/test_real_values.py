"""Real-valued FRFs in arrays: refused, as they may be magnitudes or decibels, unless it is stated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import xarray as xr
from numpy.typing import NDArray

import updyn
from updyn.errors import FormatError, OptionError
from updyn.io import matlab, npz

FREQ = np.array([10.0, 11.0, 12.0])
#: Receptance of 100 N/m and 1 kg without damping at a resonance of 1.6 Hz: all of them negative.
UNDAMPED = (1.0 / (100.0 - (2 * np.pi * FREQ) ** 2))[:, None, None]
LEVELS = np.array([-40.0, 3.0, -21.0])[:, None, None]  # dB
LABELS = {"responses": ["1:X"], "references": ["1:X"], "quantity": "receptance"}


def write_npz(path: Path, values: NDArray[np.generic]) -> Path:
    np.savez(path.with_suffix(".npz"), freq=FREQ, H=values, **LABELS)
    return path.with_suffix(".npz")


def write_mat(path: Path, values: NDArray[np.generic]) -> Path:
    labels = {name: np.array([text], dtype=object) for name, (text,) in list(LABELS.items())[:2]}
    scipy.io.savemat(
        path.with_suffix(".mat"), {"freq": FREQ, "H": values, "quantity": "receptance", **labels}
    )
    return path.with_suffix(".mat")


def write_nc(path: Path, values: NDArray[np.generic]) -> Path:
    coords = {"freq": FREQ, "response": ["1:X"], "reference": ["1:X"]}
    data = xr.Dataset({"frf": (tuple(coords), values)}, coords, {"quantity": "receptance"})
    data.to_netcdf(path.with_suffix(".nc"), engine="h5netcdf")
    return path.with_suffix(".nc")


Write = Callable[[Path, NDArray[np.generic]], Path]
WRITERS = [write_npz, write_mat, write_nc]


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("values", [UNDAMPED, np.abs(UNDAMPED), LEVELS, LEVELS.astype("i4")])
def test_real_numbers_are_refused(
    tmp_path: Path, write: Write, values: NDArray[np.generic]
) -> None:
    path = write(tmp_path / "a", values)
    with pytest.raises(FormatError, match=r"(H|frf): holds real numbers, .*real_valued=True"):
        updyn.read_frf(path)


@pytest.mark.parametrize("write", WRITERS)
def test_they_are_read_where_the_phase_is_stated(tmp_path: Path, write: Write) -> None:
    found = updyn.read_frf(write(tmp_path / "a", UNDAMPED), real_valued=True)
    np.testing.assert_array_equal(found.values, UNDAMPED)


@pytest.mark.parametrize("write", WRITERS)
def test_the_statement_is_checked(tmp_path: Path, write: Write) -> None:
    path = write(tmp_path / "a", UNDAMPED + 0j)  # MATLAB drops an imaginary part of zeros
    np.testing.assert_array_equal(updyn.read_frf(path).values, UNDAMPED)
    np.testing.assert_array_equal(updyn.read_frf(path, real_valued=True).values, UNDAMPED)
    path = write(tmp_path / "b", UNDAMPED + 1j)
    with pytest.raises(FormatError, match=r"imaginary part, which contradicts real_valued=True"):
        updyn.read_frf(path, real_valued=True)
    with pytest.raises(OptionError, match=r"real_valued 'yes': expected True or False"):
        updyn.read_frf(path, real_valued="yes")


def test_two_real_variables_are_complex(tmp_path: Path) -> None:
    coords = {"freq": FREQ, "response": ["1:X"], "reference": ["1:X"]}
    parts = {"frf_real": (tuple(coords), UNDAMPED), "frf_imag": (tuple(coords), 0.0 * UNDAMPED)}
    data = xr.Dataset(parts, coords, {"quantity": "receptance"})
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    np.testing.assert_array_equal(updyn.read_frf(tmp_path / "a.nc").values, UNDAMPED)


def test_an_frf_in_memory_may_be_real() -> None:
    frf = updyn.FRF(FREQ, UNDAMPED, ["1:X"], ["1:X"], "receptance")
    np.testing.assert_array_equal(updyn.FRF.from_xarray(frf.to_xarray()).values, UNDAMPED)


@pytest.mark.parametrize("module", [npz, matlab])
def test_what_is_written_of_an_undamped_model_is_read(tmp_path: Path, module: object) -> None:
    frf = updyn.FRF(FREQ, UNDAMPED, ["1:X"], ["1:X"], "receptance")
    path = tmp_path / ("a.npz" if module is npz else "a.mat")
    updyn.write_frf(frf, path)
    np.testing.assert_array_equal(updyn.read_frf(path).values, UNDAMPED)
