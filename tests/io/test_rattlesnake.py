"""FRFs and time records of Rattlesnake (netCDF-4), in the layout that its source code writes (release of January 2025)."""

from __future__ import annotations

from pathlib import Path

import h5netcdf
import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, OptionError

RNG = np.random.default_rng(5)
VALUES = RNG.integers(-1000, 1000, (3, 12)) / 64.0
TABLE = {
    "node_number": ["101", "101", "7"],
    "node_direction": ["Z-", "-Z", "RX+"],
    "comment": ["", "drive point", ""],
    "sensitivity": ["22.4", "100", "10"],
    "unit": ["N", "g", "rad/s^2"],
    "channel_type": ["Force", "Acceleration", ""],
}
H = RNG.standard_normal((3, 2)) + 1j * RNG.standard_normal((3, 2))
COHERENCE = RNG.uniform(0.5, 1.0, (3, 2))
NAMES = ["101:-Z force", "101:-Z", "7:RX"]


def write(path, streams=(VALUES,), table=TABLE, frame=None, **attributes) -> Path:
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"response_channels": len(table["unit"]), "num_environments": 1}
        file.attrs["sample_rate"] = np.int64(4)
        file.attrs["hardware"] = np.int64(1)
        names = file.create_variable("environment_names", ("num_environments",), h5netcdf_text())
        names[0] = "Modal"
        for number, values in enumerate(streams):
            end = f"_{number}" if number else ""
            file.dimensions[f"time_samples{end}"] = None
            file.resize_dimension(f"time_samples{end}", values.shape[1])
            dimensions = ("response_channels", f"time_samples{end}")
            stream = file.create_variable(f"time_data{end}", dimensions, "f8")
            stream[:] = values
        for name, texts in table.items():
            column = file.create_variable(
                f"/channels/{name}", ("response_channels",), h5netcdf_text()
            )
            for at, text in enumerate(texts):
                column[at] = text
        modal = file.create_group("Modal")
        modal.attrs["samples_per_frame"] = np.int64(frame or 512)
        if frame is not None:
            modal.dimensions = {"fft_lines": 3, "response_channels": 2, "reference_channels": 1}
            for side, indices in (("reference", [0]), ("response", [1, 2])):
                name = f"{side}_channel_indices"
                modal.create_variable(name, (f"{side}_channels",), data=np.array(indices, "i4"))
            for name, values in (
                ("frf_data_real", H.real[..., None]),
                ("frf_data_imag", H.imag[..., None]),
                ("coherence", COHERENCE),
            ):
                names = ("fft_lines", "response_channels", "reference_channels")
                modal.create_variable(name, names[: values.ndim], data=values)
            stated = {
                "averaging_type": "Linear",
                "num_averages": np.int64(3),
                "overlap": 0.0,
                "frf_window": "rectangle",
                "exponential_window_value_at_frame_end": 0.05,
            }
            for name, value in (stated | attributes).items():
                modal.attrs[name] = value
    return path


def h5netcdf_text():
    import h5py

    return h5py.string_dtype()


def check(found, values, names=NAMES, units=("N", "g", "rad/s^2")) -> None:
    assert found["channel"].values.tolist() == list(names)
    assert found["unit"].values.tolist() == list(units)
    np.testing.assert_array_equal(found.values, values)
    np.testing.assert_allclose(found["time"].values, 0.25 * np.arange(found.shape[2]), rtol=1e-12)


def test_a_stream_is_a_record_with_dofs_as_names(tmp_path):
    check(updyn.read_records(write(tmp_path / "a.nc4")), [VALUES])
    check(
        updyn.read_records(tmp_path / "a.nc4", channels=["7:RX"]),
        [VALUES[2:]],
        NAMES[2:],
        ["rad/s^2"],
    )


def test_frames_of_a_modal_test_are_records(tmp_path):
    found = updyn.read_records(write(tmp_path / "a.nc4", frame=4))
    check(found, VALUES.reshape(3, 3, 4).transpose(1, 0, 2))
    with pytest.raises(FormatError, match="12 samples in frames of 5"):
        updyn.read_records(write(tmp_path / "b.nc4", frame=5))


def test_several_streams_are_named(tmp_path):
    path = write(tmp_path / "a.nc4", streams=(VALUES, VALUES[:, :6], 2 * VALUES))
    with pytest.raises(OptionError, match=r"3 groups of channels: 'time_data' \(101:-Z force,"):
        updyn.read_records(path)
    check(updyn.read_records(path, group="time_data_1"), [VALUES[:, :6]])
    check(updyn.read_records(path, group=["time_data", "time_data_2"]), [VALUES, 2 * VALUES])


def test_channels_without_a_dof_keep_their_texts(tmp_path):
    table = TABLE | {
        "node_number": ["", "wing", "wing"],
        "node_direction": ["", "S", "S"],
        "comment": ["hammer", "", ""],
    }
    names = ["hammer", "wing S (channel 2)", "wing S (channel 3)"]
    check(updyn.read_records(write(tmp_path / "a.nc4", table=table)), [VALUES], names)


def test_a_table_of_another_length_is_refused(tmp_path):
    short = {name: texts[:2] for name, texts in TABLE.items()}
    path = write(tmp_path / "a.nc4")
    with h5netcdf.File(path, "r+") as file:
        file.attrs["sample_rate"] = -1.0
    with pytest.raises(FormatError, match=r"sample_rate -1.*above 0"):
        updyn.read_records(path)
    path = write(tmp_path / "b.nc4", streams=(VALUES[:2],), table=short)
    check(updyn.read_records(path), [VALUES[:2]], NAMES[:2], ["N", "g"])


def test_group_is_only_for_these_files(tmp_path):
    records = updyn.read_records(write(tmp_path / "a.nc4"))
    records.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with pytest.raises(OptionError, match="group: only for files of Rattlesnake"):
        updyn.read_records(tmp_path / "b.nc", group="x")
    options = {"values": ["time_data"], "rate": 4.0, "group": "time_data"}
    with pytest.raises(OptionError, match="group: only for files of Rattlesnake"):
        updyn.read_records(tmp_path / "a.nc4", **options)


# -- FRFs of a modal test ------------------------------------------------------------------------------
LINEAR = {name: [*texts[:2], texts[1]] for name, texts in TABLE.items()} | {
    "node_number": ["101", "101", "7"]
}


def test_frfs_of_a_modal_test(tmp_path):
    """In SI: the responses are in g, the force in N; frequencies are multiples of 4 / 4 Hz."""
    found = updyn.read_frf(write(tmp_path / "a.nc4", table=LINEAR, frame=4))
    np.testing.assert_allclose(found.freq, [0.0, 1.0, 2.0], rtol=1e-14)
    assert (found.responses.labels, found.references.labels) == (["101:-Z", "7:-Z"], ["101:-Z"])
    np.testing.assert_allclose(found.values[:, :, 0], 9.80665 * H, rtol=1e-14)
    np.testing.assert_array_equal(found.coherence[:, :, 0], COHERENCE)
    assert (found.quantity, found.averages, found.decay) == ("accelerance", 3, 0.0)


def test_averages_of_a_stopped_test_are_its_frames(tmp_path):
    path = write(tmp_path / "a.nc4", (VALUES[:, :8],), LINEAR, frame=4, num_averages=np.int64(10))
    assert updyn.read_frf(path).averages == 2
    path = write(tmp_path / "b.nc4", (VALUES[:, :0],), LINEAR, frame=4)
    with pytest.raises(FormatError, match="no accepted frame"):
        updyn.read_frf(path)


def test_the_decay_of_an_exponential_window(tmp_path):
    """The window ends a frame of 1 s at 0.05; with overlap, averages are not independent."""
    path = write(tmp_path / "a.nc4", table=LINEAR, frame=4, frf_window="exponential", overlap=0.5)
    found = updyn.read_frf(path)
    assert found.decay == pytest.approx(np.log(20.0), rel=1e-14)
    assert found.averages is None


def test_labels_of_channels_without_a_dof(tmp_path):
    table = LINEAR | {"node_number": ["tip", "tip", "7"]}
    path = write(tmp_path / "a.nc4", table=table, frame=4)
    with pytest.raises(FormatError, match=r"channels tip -Z, 7:-Z: .* state response_labels"):
        updyn.read_frf(path)
    labels = {"response_labels": ["3:Z", "7:-Z"], "reference_labels": ["3:-Z"]}
    found = updyn.read_frf(path, **labels)
    assert (found.responses.labels, found.references.labels) == tuple(labels.values())


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        (LINEAR | {"unit": ["V", "g", "g"]}, {}, r"over '101:-Z' in 'V'; expected a motion over a"),
        (LINEAR | {"unit": ["N", "g", "mm/s"]}, {}, "accelerance of 101:-Z; mobility of 7:-Z"),
        (LINEAR, {"quantity": "mobility"}, "'mobility' contradicts .* those of accelerance"),
        (LINEAR | {"node_direction": ["Z-", "-Z", "RX"]}, {}, "motion at 7:RX cannot be in 'g/N'"),
    ],
)
def test_frfs_that_are_refused(tmp_path, table, options, message):
    path = write(tmp_path / "a.nc4", table=table, frame=4)
    with pytest.raises(FormatError, match=message):
        updyn.read_frf(path, **options)


def test_a_stream_holds_no_frfs(tmp_path):
    with pytest.raises(FormatError, match="holds no variable 'frf'"):
        updyn.read_frf(write(tmp_path / "a.nc4"))
