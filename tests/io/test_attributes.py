"""Attributes of netCDF variables and HDF5 datasets: packed numbers, missing values, units.

The truth of packed numbers is what xarray decodes (the CF conventions), and the numbers written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

import updyn
from updyn.errors import DataError, FormatError, OptionError, UpdynError

pytestmark = pytest.mark.filterwarnings("ignore:saving variable .* without any _FillValue")

FREQ = np.array([10.0, 11.0, 12.0])
VALUES = np.arange(6.0).reshape(3, 2, 1) + 1j
DIMS = ("freq", "response", "reference")


def dataset(**more: Any) -> xr.Dataset:
    """Return FRFs in two real variables."""
    parts = {"frf_real": (DIMS, VALUES.real.copy()), "frf_imag": (DIMS, VALUES.imag.copy())}
    coords = {"freq": FREQ, "response": ["1:X", "2:X"], "reference": ["1:X"]}
    return xr.Dataset(parts | more, coords, {"quantity": "accelerance"})


def put(data: Any, path: Path, **encoding: dict[str, Any]) -> Path:
    data.to_netcdf(path, engine="h5netcdf", encoding=encoding)
    return path


# -- packed numbers ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "packing",
    [
        {"dtype": "i2", "scale_factor": 0.001, "add_offset": 1.0, "_FillValue": -32768},
        {"dtype": "i4", "scale_factor": 0.5},
        {"dtype": "u1", "add_offset": -1.0},
        {"dtype": "i1", "_Unsigned": "true", "scale_factor": 1.0, "_FillValue": -1},
        {"dtype": "f4", "scale_factor": 2.0, "_FillValue": np.float32(1e20)},
    ],
)
def test_packed_values_are_those_that_xarray_decodes(
    tmp_path: Path, packing: dict[str, Any]
) -> None:
    path = put(dataset(), tmp_path / "a.nc", frf_real=packing)
    with xr.open_dataset(path, engine="h5netcdf") as decoded:
        expected = decoded["frf_real"].values
    found = updyn.read_frf(path).values
    np.testing.assert_allclose(found.real, expected, rtol=1e-7)
    np.testing.assert_allclose(found, VALUES, atol=1e-3)


@pytest.mark.parametrize("name", ["freq", "coherence", "variance", "xyz", "node"])
def test_every_variable_is_decoded(tmp_path: Path, name: str) -> None:
    data = dataset(
        coherence=(DIMS, np.full((3, 2, 1), 0.5)),
        variance=(DIMS, np.full((3, 2, 1), 4.0)),
        node=("node", np.array([1.0, 2.0])),
        xyz=(("node", "axis"), np.arange(6.0).reshape(2, 3)),
    )
    packing = {name: {"dtype": "i2", "scale_factor": 0.25, "add_offset": -2.0}}
    found = updyn.read_frf(put(data, tmp_path / "a.nc", **packing))
    np.testing.assert_array_equal(found.freq, FREQ)
    assert found.coherence is not None
    assert (found.coherence == 0.5).all()
    assert found.variance is not None
    assert (found.variance == 4.0).all()
    assert found.geometry is not None
    np.testing.assert_array_equal(found.geometry.nodes, [1, 2])
    np.testing.assert_array_equal(found.geometry.xyz, np.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize("name", ["_FillValue", "missing_value", "valid_max", "valid_range"])
def test_missing_values_are_not_numbers(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.nc"
    put(dataset(), path, frf_real={"dtype": "i2", "_FillValue": None})
    with h5py.File(path, "r+") as file:
        stated = {"valid_max": 4, "valid_range": [0, 4]}.get(name, 5)
        file["frf_real"].attrs[name] = np.asarray(stated, "i2")
    with pytest.raises(FormatError, match=r"12 Hz, response 2:X, reference 1:X is not finite"):
        updyn.read_frf(path)


@pytest.mark.parametrize("stated", ["0.001", [0.5, 2.0], np.nan])
def test_a_scale_that_is_no_number_is_refused(tmp_path: Path, stated: Any) -> None:
    path = put(dataset(), tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file["frf_imag"].attrs["scale_factor"] = stated
    with pytest.raises(FormatError, match=r"a\.nc: frf_imag: attribute 'scale_factor'"):
        updyn.read_frf(path)


# -- units of FRFs ----------------------------------------------------------------------------------
def test_units_in_si_are_accepted(tmp_path: Path) -> None:
    data = dataset(
        coherence=(DIMS, np.full((3, 2, 1), 0.5), {"units": "1"}),
        variance=(DIMS, np.full((3, 2, 1), 4.0), {"units": "(m/s^2/N)^2"}),
        node=("node", np.array([1, 2])),
        xyz=(("node", "axis"), np.arange(6.0).reshape(2, 3), {"units": "metres"}),
    )
    for part in ("frf_real", "frf_imag"):
        data[part].attrs["units"] = "(m/s²)/N"
    data["freq"].attrs["units"] = "hertz"
    del data.attrs["quantity"]  # the unit says it
    found = updyn.read_frf(put(data, tmp_path / "a.nc"))
    assert found.quantity == "accelerance"
    np.testing.assert_array_equal(found.values, VALUES)


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({"frf": "g/N"}, r"frf is in 'g/N'; expected 'm/s\^2/N': multiply it by 9\.80665"),
        ({"frf": "m/s^2/kN"}, r"multiply it by 0\.001"),
        ({"frf": "mm/N"}, r"'mm/N', a unit of receptance; expected 'm/s\^2/N'"),
        ({"frf": "dB"}, r"frf is in 'dB'; expected 'm/s\^2/N'"),
        ({"frf_real": "m/s^2/N"}, "'frf_real' and 'frf_imag' differ in their units"),
        ({"freq": "kHz"}, r"freq is in 'kHz'; expected 'Hz': multiply it by 1000"),
        ({"freq": "rad/s"}, r"freq is in 'rad/s'; expected 'Hz': multiply it by 0\.159155"),
        ({"freq": "ms"}, r"freq is in 'ms'; expected 'Hz'"),
        ({"coherence": "%"}, r"coherence is in '%'; expected '1'"),
        ({"variance": "(g/N)^2"}, r"variance is in '\(g/N\)\^2'; expected '\(m/s\^2/N\)\^2'"),
        ({"variance": "m/s^2/N"}, r"variance is in 'm/s\^2/N'"),
        ({"xyz": "mm"}, r"xyz is in 'mm'; expected 'm': multiply it by 0\.001"),
    ],
)
def test_other_units_are_refused(tmp_path: Path, units: dict[str, str], message: str) -> None:
    data = dataset(
        coherence=(DIMS, np.full((3, 2, 1), 0.5)),
        variance=(DIMS, np.full((3, 2, 1), 4.0)),
        node=("node", np.array([1, 2])),
        xyz=(("node", "axis"), np.arange(6.0).reshape(2, 3)),
    )
    for name, unit in units.items():
        for part in ("frf_real", "frf_imag") if name == "frf" else (name,):
            data[part].attrs["units"] = unit
    path = put(data, tmp_path / "a.nc")
    with pytest.raises(FormatError, match=rf"a\.nc: .*{message}"):
        updyn.read_frf(path)


def test_units_of_a_dataset_in_memory() -> None:
    data = updyn.FRF(FREQ, VALUES, ["1:X", "2:X"], ["1:X"], "accelerance").to_xarray()
    data["frf"].attrs["units"] = "g/N"
    with pytest.raises(DataError, match="frf is in 'g/N'"):
        updyn.FRF.from_xarray(data)


# -- records ----------------------------------------------------------------------------------------
SIGNALS = np.arange(8.0).reshape(1, 2, 4)
STEP = 1e-3


def records(times: Any, **attributes: str) -> xr.DataArray:
    coords = {"channel": ["h", "a"], "unit": ("channel", ["N", "g"]), "time": times}
    out = xr.DataArray(SIGNALS, coords, ("record", "channel", "time"), "records")
    out["time"].attrs.update(attributes)
    return out


TIMES = {
    "seconds": records(np.arange(4) * STEP),
    "ms": records(np.arange(4.0), units="ms"),
    "integers of us": records(np.arange(4) * 1000, units="us"),
    "since": records(np.arange(4.0), units="milliseconds since 2020-01-01"),
    "integers since": records(
        1_700_000_000_000_000_000 + np.arange(4) * 1_000_000, units="nanoseconds since 1970-01-01"
    ),
    "timedelta64": records((np.arange(4) * 1_000_000).astype("timedelta64[ns]")),
    "datetime64": records(
        np.datetime64("2020-01-01") + (np.arange(4) * 1_000_000).astype("timedelta64[ns]")
    ),
}


@pytest.mark.parametrize("given", TIMES.values(), ids=TIMES)
def test_times_are_read_in_their_unit(tmp_path: Path, given: xr.DataArray) -> None:
    path = tmp_path / "r.nc"
    encoded = given.copy()
    if encoded["time"].dtype.kind != "M" and "since" in encoded["time"].attrs.get("units", ""):
        encoded.to_netcdf(path, engine="h5netcdf")  # numbers: written as they are
    else:
        put(encoded, path)
    found = updyn.read_records(path)
    np.testing.assert_allclose(found["time"].values, np.arange(4) * STEP, rtol=1e-12)
    np.testing.assert_array_equal(found.values, SIGNALS)
    assert found["unit"].values.tolist() == ["N", "g"]


@pytest.mark.parametrize("name", ["timedelta64", "datetime64", "ms"])
def test_times_of_an_array_in_memory(name: str) -> None:
    from updyn.signals.records import Records

    found = Records.from_xarray(TIMES[name])
    assert found.step == pytest.approx(STEP, rel=1e-12)


def test_packed_records(tmp_path: Path) -> None:
    packing = {"dtype": "i2", "scale_factor": 0.01, "add_offset": 3.0, "_FillValue": -32768}
    found = updyn.read_records(put(TIMES["seconds"], tmp_path / "r.nc", records=packing))
    np.testing.assert_allclose(found.values, SIGNALS, atol=1e-12)


@pytest.mark.parametrize("label", ["kHz", "samples", "months since 2020-01-01", "g"])
def test_an_unknown_unit_of_time_is_refused(tmp_path: Path, label: str) -> None:
    path = put(TIMES["seconds"], tmp_path / "r.nc")
    with h5py.File(path, "r+") as file:
        file["time"].attrs["units"] = label
    with pytest.raises(FormatError, match=rf"r\.nc: time: unit '{label}'.*valid: 's'|did you mean"):
        updyn.read_records(path)


def test_one_unit_of_all_channels(tmp_path: Path) -> None:
    given = TIMES["seconds"].drop_vars("unit")
    given.attrs["units"] = "g"
    found = updyn.read_records(put(given, tmp_path / "r.nc"))
    assert found["unit"].values.tolist() == ["g", "g"]
    given = TIMES["seconds"].copy()
    given.attrs["units"] = "g"
    with pytest.raises(FormatError, match="channel 'h': unit 'N', but the records are in 'g'"):
        updyn.read_records(put(given, tmp_path / "s.nc"))


# -- datasets of HDF5 -------------------------------------------------------------------------------
def h5(path: Path, **stated: dict[str, Any]) -> Path:
    """Write two channels, times and a rate; attributes by name of the dataset."""
    with h5py.File(path, "w") as file:
        file["f"] = SIGNALS[0, 0]
        file["run/a"] = SIGNALS[0, 1]
        file["t"] = np.arange(4) * STEP
        file["fs"] = 1 / STEP
        for name, attributes in stated.items():
            place = file["run/a"] if name == "a" else file[name]
            place.attrs.update(attributes)
    return path


WANTED: dict[str, Any] = {"values": {"hammer": "f", "1:Z": "run.a"}}


def test_units_of_datasets(tmp_path: Path) -> None:
    path = h5(tmp_path / "a.h5", f={"units": "kN"}, a={"Unit": np.bytes_(b"g")}, t={"units": "s"})
    found = updyn.read_records(path, **WANTED, time="t")
    assert found["unit"].values.tolist() == ["kN", "g"]
    with pytest.raises(FormatError, match="unit 'N' given, the records say 'kN'"):
        updyn.read_records(path, **WANTED, time="t", units={"hammer": "N"})


@pytest.mark.parametrize(
    ("stated", "choice", "step"),
    [
        ({"t": {"units": "ms"}}, {"time": "t"}, STEP / 1000),
        ({"t": {"units": np.array(["ms"], dtype=object)}}, {"time": "t"}, STEP / 1000),
        ({"t": {"units": "us", "scale_factor": 1e6}}, {"time": "t"}, STEP),
        ({"fs": {"units": "kHz"}}, {"rate": "fs"}, STEP / 1000),
        ({"fs": {"units": "Hz"}}, {"rate": "fs"}, STEP),
    ],
)
def test_units_of_times_and_of_the_rate(
    tmp_path: Path, stated: Any, choice: dict[str, Any], step: float
) -> None:
    found = updyn.read_records(h5(tmp_path / "a.h5", **stated), **WANTED, **choice)
    np.testing.assert_allclose(found["time"].values, np.arange(4) * step, rtol=1e-12)


def test_packed_datasets(tmp_path: Path) -> None:
    path = h5(tmp_path / "a.h5", a={"scale_factor": 0.5, "add_offset": 1.0})
    found = updyn.read_records(path, **WANTED, time="t")
    np.testing.assert_array_equal(found.values[0, 1], 0.5 * SIGNALS[0, 1] + 1.0)


@pytest.mark.parametrize(
    ("stated", "choice", "message"),
    [
        ({"t": {"units": "kHz"}}, {"time": "t"}, "t: unit 'kHz'"),
        ({"fs": {"units": "ms"}}, {"rate": "fs"}, "fs: unit 'ms'"),
        ({"f": {"units": 3}}, {"time": "t"}, "f: attribute 'units' is 3; expected a text"),
        ({"f": {"units": "N", "unit": "kN"}}, {"time": "t"}, "f: attributes 'unit' and 'units'"),
        ({"a": {"_FillValue": 5.0}}, {"time": "t"}, "channel '1:Z', sample 2 is nan"),
    ],
)
def test_attributes_that_are_not_understood_are_refused(
    tmp_path: Path, stated: Any, choice: dict[str, Any], message: str
) -> None:
    path = h5(tmp_path / "a.h5", **stated)
    with pytest.raises(UpdynError, match=message):
        updyn.read_records(path, **WANTED, **choice)


def test_a_model_file_with_packed_or_foreign_numbers_is_refused(tmp_path: Path) -> None:
    from updyn.demos import chain

    path = tmp_path / "model.h5"
    for name, value, message in (
        ("scale_factor", 2.0, r"attribute 'scale_factor'"),
        ("units", "N/mm", r"attribute 'units' is 'N/mm'; expected SI"),
    ):
        updyn.write_model(chain.build(), path)
        with h5py.File(path, "r+") as file:
            file["groups/0000/stiffness/data"].attrs[name] = value
        with pytest.raises(FormatError, match=rf"/groups/0000/stiffness/data: .*{message}"):
            updyn.read_model(path)
    updyn.write_model(chain.build(), path)
    with h5py.File(path, "r+") as file:
        file["groups/0000/stiffness/data"].attrs["units"] = "N/m"
    assert updyn.read_model(path).n_dofs == 12


def test_options_of_records_are_not_for_a_file_of_xarray(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="rate without values"):
        updyn.read_records(put(TIMES["seconds"], tmp_path / "r.nc"), rate=3.0)
