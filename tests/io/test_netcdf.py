"""FRFs as netCDF-4: exact round trip, plain xarray, other kinds of HDF5 files refused by name."""

import h5py
import numpy as np
import pytest
import xarray as xr

import updyn
from io_samples import assert_same_frf, frf, model
from updyn.errors import FormatError, OptionError, UpdynError


@pytest.mark.parametrize("name", ["case.nc", "case.h5"])
@pytest.mark.parametrize("with_geometry", [True, False])
def test_round_trip_is_exact(tmp_path, name, with_geometry):
    data = frf(with_geometry=with_geometry)
    updyn.write_frf(data, tmp_path / name)
    assert_same_frf(updyn.read_frf(tmp_path / name), data)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_the_file_opens_in_plain_xarray(tmp_path):
    data = frf()
    updyn.write_frf(data, tmp_path / "case.nc")
    with xr.open_dataset(tmp_path / "case.nc") as found:
        np.testing.assert_array_equal(found["frf"].values, data.values)
        assert found["frf"].dims == ("freq", "response", "reference")
        assert found["response"].values.tolist() == data.responses.labels
        assert found.attrs["updyn_kind"] == "frf"
        assert found["freq"].attrs["units"] == "Hz"


def foreign(path, drop=(), **changes):
    data = frf(with_geometry=False)
    parts = {
        "frf_real": (("freq", "response", "reference"), data.values.real),
        "frf_imag": (("freq", "response", "reference"), data.values.imag),
    } | changes
    coords = {
        "freq": data.freq,
        "response": data.responses.labels,
        "reference": data.references.labels,
    }
    out = xr.Dataset(parts, coords).drop_vars(list(drop))
    out.to_netcdf(path, engine="h5netcdf")
    return data


def test_real_and_imaginary_parts_of_another_program(tmp_path):
    data = foreign(tmp_path / "case.nc")
    found = updyn.read_frf(tmp_path / "case.nc", quantity="mobility")
    np.testing.assert_array_equal(found.values, data.values)
    assert found.responses == data.responses


@pytest.mark.parametrize(
    ("changes", "drop", "options", "message"),
    [
        ({}, (), {}, "does not say what it measured"),
        (
            {},
            ("frf_imag",),
            {"quantity": "mobility"},
            "expected 'frf', or both 'frf_real' and 'frf_imag'",
        ),
        ({}, ("response",), {"quantity": "mobility"}, "no variable 'response'"),
        (
            {"frf_imag": (("freq",), np.zeros(5))},
            (),
            {"quantity": "mobility"},
            "differ in their dimensions",
        ),
        (
            {"xyz": (("node", "axis"), np.zeros((2, 3)))},
            (),
            {"quantity": "mobility"},
            "'xyz' without 'node'",
        ),
        (
            {"xyz": (("node",), np.zeros(2)), "node": (("node",), [1, 2])},
            (),
            {"quantity": "mobility"},
            "not a readable",
        ),
    ],
)
def test_what_is_missing_is_named(tmp_path, changes, drop, options, message):
    foreign(tmp_path / "case.nc", drop, **changes)
    with pytest.raises(FormatError, match=message) as caught:
        updyn.read_frf(tmp_path / "case.nc", **options)
    assert "case.nc" in str(caught.value)


def test_a_model_file_is_refused_by_name(tmp_path):
    updyn.write_model(model(), tmp_path / "case.h5")
    with pytest.raises(FormatError, match=r"read it with updyn\.read_model"):
        updyn.read_frf(tmp_path / "case.h5")
    updyn.write_frf(frf(), tmp_path / "frf.nc")
    with pytest.raises(FormatError, match=r"read it with updyn\.read_frf"):
        updyn.read_model(tmp_path / "frf.nc")


def test_an_hdf5_file_of_something_else(tmp_path):
    with h5py.File(tmp_path / "case.h5", "w") as file:
        file["picture"] = np.zeros(3)
    with pytest.raises(FormatError, match=r"no variable 'frf' .*it holds: picture"):
        updyn.read_frf(tmp_path / "case.h5")


def test_average_does_not_apply(tmp_path):
    updyn.write_frf(frf(), tmp_path / "case.nc")
    with pytest.raises(OptionError, match="expected 'raise'"):
        updyn.read_frf(tmp_path / "case.nc", duplicates="average")


def test_a_file_cut_short_or_changed_raises_nothing_else(tmp_path):
    path = tmp_path / "case.nc"
    data = frf()
    updyn.write_frf(data, path)
    good = path.read_bytes()
    end = good.rindex(b"updyn-sha256 ")
    for at in np.random.default_rng(5).integers(8, end, 40):
        path.write_bytes(good[:at])
        with pytest.raises(UpdynError):
            updyn.read_frf(path)
        changed = bytearray(good)
        changed[at] ^= 0xFF
        path.write_bytes(changed)
        with pytest.raises(UpdynError, match="differs from the content written"):
            updyn.read_frf(path)
    path.write_bytes(good[:end])  # all but the digest
    assert_same_frf(updyn.read_frf(path), data)
