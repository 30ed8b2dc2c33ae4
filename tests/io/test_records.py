"""Time records of universal files, WAV, MATLAB, HDF5, netCDF and tables: values, units, and what is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import pyuff
import scipy.io
from scipy.io import wavfile

import matlab73
import uff_samples as uff
import updyn
from updyn.errors import FormatError, OptionError, UpdynError, UpdynWarning

RNG = np.random.default_rng(6)
#: Three records of two channels, values that six digits hold.
VALUES = RNG.integers(-1000, 1000, (3, 2, 8)) / 100.0
STEP = 0.25


def put(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def check(found, channels, units, values=VALUES, step=STEP) -> None:
    assert found["channel"].values.tolist() == channels
    assert found["unit"].values.tolist() == units
    np.testing.assert_array_equal(found.values, values)
    assert found["time"].values == pytest.approx(step * np.arange(values.shape[2]), rel=1e-12)


# -- universal files ----------------------------------------------------------------------------------
TIME = {"kind": 1, "start": 0.0, "step": STEP}
NO_LABELS = ("NONE", "NONE", "NONE")
FORCE = {"types": (17, 13, 0), "units": NO_LABELS}
MOTION = {"types": (17, 12, 0), "units": NO_LABELS}


def responses(make=uff.ascii58, order=((0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)), **more):
    parts = []
    for record, channel in order:
        at, kind = ((7, -3), FORCE) if channel == 0 else ((4, 3), MOTION)
        parts.append(make(VALUES[record, channel], at, (7, 3), **TIME | kind | more))
    return parts


@pytest.mark.parametrize("make", [uff.ascii58, uff.binary58])
def test_time_responses_of_a_universal_file(tmp_path, make):
    for order in (
        ((0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)),
        ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)),
    ):
        path = put(tmp_path / "a.uff", b"".join(responses(make, order)))
        check(updyn.read_records(path), ["7:-Z force", "4:Z"], ["N", "m/s^2"])


def test_a_universal_file_of_pyuff(tmp_path):
    path = tmp_path / "a.uff"
    file = pyuff.UFF(str(path))
    for record in VALUES:
        for (node, direction, kind, unit), y in zip(
            ((1, 3, 13, "lbf"), (2, -1, 12, "g")), record, strict=True
        ):
            one = {
                "type": 58,
                "binary": 0,
                "func_type": 1,
                "rsp_node": node,
                "rsp_dir": direction,
                "ref_node": 1,
                "ref_dir": 3,
                "data": y,
                "x": STEP * np.arange(8),
                "id1": "hit",
                "abscissa_spec_data_type": 17,
                "abscissa_axis_units_lab": "s",
                "ordinate_spec_data_type": kind,
                "ordinate_axis_units_lab": unit,
                "orddenom_spec_data_type": 0,
            }
            file.write_sets([one], mode="add")
    found = updyn.read_records(path)
    check(found, ["1:Z force", "2:-X"], ["lbf", "g"])
    with pytest.raises(FormatError, match="unit 'g' given, the records say 'lbf'"):
        updyn.read_records(path, units={"1:Z force": "g"})
    scaled = updyn.read_records(path, units={"1:Z force": "kN"}, factors={"1:Z force": -2.0})
    assert scaled["unit"].values.tolist() == ["kN", "g"]
    np.testing.assert_array_equal(scaled.values[:, 0], -2.0 * VALUES[:, 0])


def test_units_of_dataset_164_without_labels(tmp_path):
    """Numbers over their factors are SI: in mm and mN, 1000 each."""
    path = put(tmp_path / "a.uff", uff.units(5, 1000.0, 1000.0) + b"".join(responses()))
    found = updyn.read_records(path)
    assert found["unit"].values.tolist() == ["N", "m/s^2"]
    assert found.values == pytest.approx(VALUES / 1000.0, rel=1e-15)


def test_other_functions_are_left_out_and_counted(tmp_path):
    frf = uff.ascii58(np.ones(4) + 0j)
    path = put(tmp_path / "a.uff", frf + b"".join(responses()))
    with pytest.warns(UpdynWarning, match="ignored: 1 frequency response function"):
        assert updyn.read_records(path).shape == (3, 2, 8)
    with pytest.raises(FormatError, match=r"holds no time response .*; it holds 1 frequency resp"):
        updyn.read_records(put(tmp_path / "b.uff", frf))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:-1], "channel '7:-Z force' occurs 3 times, '4:Z' 2"),
        (
            lambda p: [*p[:-1], uff.ascii58(VALUES[2, 1] + 0j, (4, 3), **TIME | MOTION)],
            "a complex time response",
        ),
        (
            lambda p: [*p[:-1], uff.ascii58(VALUES[2, 1, :7], (4, 3), **TIME | MOTION)],
            "a time response of 7 samples, but 8 on line 2",
        ),
        (
            lambda p: [*p[:-1], uff.ascii58(VALUES[2, 1], (4, 3), **TIME | MOTION | {"start": 1})],
            "from 1 s in steps of 0.25 s, but on line 2 from 0 s",
        ),
        (
            lambda p: [
                *p[:-1],
                uff.ascii58(VALUES[2, 1], (4, 3), **TIME | MOTION | {"types": (18, 12, 0)}),
            ],
            "the abscissa is frequency in ''; expected time in s",
        ),
        (
            lambda p: [
                *p[:-1],
                uff.ascii58(VALUES[2, 1], (4, 3), **TIME | MOTION | {"units": ("ms", "g", "")}),
            ],
            "from 0 s in steps of 0.00025 s, but on line 2 from 0 s in steps of 0.25 s",
        ),
        (
            lambda p: [
                *p[:-1],
                uff.ascii58(VALUES[2, 1], (4, 3), **TIME | MOTION | {"units": ("s", "g", "")}),
            ],
            "channel '4:Z': records in 'g' and 'm/s\\^2'",
        ),
        (
            lambda p: [
                *p[:-1],
                uff.ascii58(
                    VALUES[2, 1],
                    (4, 3),
                    x=STEP * np.arange(8) ** 1.1,
                    **{"kind": 1} | MOTION,
                ),
            ],
            "not evenly spaced",
        ),
        (lambda p: [*p[:-1], p[-1][:-20]], "has no closing"),
    ],
)
def test_universal_files_that_are_not_sound(tmp_path, change, message):
    path = put(tmp_path / "a.uff", b"".join(change(responses())))
    with pytest.raises(FormatError, match=message):
        updyn.read_records(path)


# -- WAV ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("dtype", "scale", "rest"),
    [
        (np.int16, 2**15, 0),
        (np.int32, 2**31, 0),
        (np.uint8, 2**7, 128),
        (np.float32, 1, 0),
        (np.float64, 1, 0),
    ],
)
def test_wav(tmp_path, dtype, scale, rest):
    shares = RNG.integers(-100, 100, (50, 2)) / 128.0
    wavfile.write(tmp_path / "a.wav", 2048, (shares * scale + rest).astype(dtype))
    found = updyn.read_records(tmp_path / "a.wav")
    check(found, ["1", "2"], ["", ""], shares.T[None], 1.0 / 2048)
    found = updyn.read_records(
        tmp_path / "a.wav",
        channels=["hammer", "3:Z"],
        units={"hammer": "N", "3:Z": "g"},
        factors={"hammer": 250.0},
    )
    check(found, ["hammer", "3:Z"], ["N", "g"], (shares * [250.0, 1.0]).T[None], 1.0 / 2048)


def test_wav_of_24_bits(tmp_path):
    whole = np.array([0, 1, -1, 2**23 - 1, -(2**23)])
    data = b"".join(struct.pack("<i", v)[:3] for v in whole.tolist()) + b"\0"
    head = struct.pack("<HHIIHH", 1, 1, 1000, 3000, 3, 24)
    body = b"WAVEfmt " + struct.pack("<I", 16) + head + b"data" + struct.pack("<I", 15) + data
    path = put(tmp_path / "a.wav", b"RIFF" + struct.pack("<I", len(body)) + body)
    found = updyn.read_records(path)
    np.testing.assert_array_equal(found.values[0, 0], whole / 2**23)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda raw: raw[:-4], "truncated or damaged: it declares 244 bytes, found 240"),
        (lambda raw: raw + b"\0\0", "followed by other data: it declares 244 bytes, found 246"),
        (lambda raw: raw[:30], "truncated or damaged"),
        (lambda raw: raw.replace(b"data", b"dat_"), "no chunk b'data'"),
        (lambda raw: raw[:40] + struct.pack("<I", 10**6) + raw[44:], "declares 1000000 bytes, 200"),
        (lambda raw: raw[:20] + struct.pack("<H", 2) + raw[22:], "samples of format 0x2"),
        (lambda raw: raw[:22] + struct.pack("<H", 3) + raw[24:], "3 channels of 16 bits in blocks"),
        (
            lambda raw: raw[:32] + bytes(4) + raw[36:],  # no bits, no bytes a sample
            "2 channels of 0 bits in blocks of 0 bytes contradict",
        ),
        (lambda raw: raw[:24] + struct.pack("<I", 0) + raw[28:], "not a readable WAV file"),
        (lambda raw: raw[:24] + bytes(8) + raw[32:], "0 samples per second"),
        (lambda raw: raw[:8] + b"AVI " + raw[12:], "does not start with RIFF or RIFX of kind WAVE"),
    ],
)
def test_wav_that_is_not_sound(tmp_path, change, message):
    wavfile.write(tmp_path / "a.wav", 2048, np.zeros((50, 2), np.int16))
    path = put(tmp_path / "b.wav", change((tmp_path / "a.wav").read_bytes()))
    with pytest.raises(FormatError, match=message):
        updyn.read_records(path)


def test_names_for_channels_that_a_wav_has_not(tmp_path):
    wavfile.write(tmp_path / "a.wav", 2048, np.zeros((50, 2), np.int16))
    with pytest.raises(OptionError, match="3 names for 2 channels"):
        updyn.read_records(tmp_path / "a.wav", channels=["a", "b", "c"])


# -- MATLAB and HDF5 -----------------------------------------------------------------------------------
def mat(folder: Path, **variables) -> Path:
    scipy.io.savemat(folder / "a.mat", variables)
    return folder / "a.mat"


def h5(folder: Path, **variables) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        for name, value in variables.items():
            if isinstance(value, dict):
                for inner, array in value.items():
                    file[f"{name}/{inner}"] = array
            else:
                file[name] = value
    return folder / "a.h5"


TIMES = STEP * np.arange(8)


@pytest.mark.parametrize("write", [mat, h5])
def test_arrays_by_channel(tmp_path, write):
    f, a = VALUES[:, 0].T, VALUES[:, 1].T
    path = write(tmp_path, f=f, run={"a": a}, t=TIMES, fs=4.0)
    wanted = {"values": {"hammer": "f", "1:Z": "run.a"}, "order": ["time", "record"]}
    found = updyn.read_records(path, **wanted, time="t", units={"hammer": "N"})
    check(found, ["hammer", "1:Z"], ["N", ""])
    for rate in (4, 4.0, "fs"):
        check(updyn.read_records(path, **wanted, rate=rate), ["hammer", "1:Z"], ["", ""])


@pytest.mark.parametrize("write", [mat, h5])
@pytest.mark.parametrize(
    "order",
    [("record", "channel", "time"), ("time", "record", "channel"), ("channel", "time", "record")],
)
def test_one_array_of_all_channels(tmp_path, write, order):
    axes = [("record", "channel", "time").index(axis) for axis in order]
    path = write(tmp_path, data=VALUES.transpose(axes))
    found = updyn.read_records(
        path, values="data", channels=["a", "b"], order=list(order), rate=4.0
    )
    check(found, ["a", "b"], ["", ""])


@pytest.mark.parametrize("write", [mat, h5])
def test_single_rows_and_columns_are_times(tmp_path, write):
    path = write(tmp_path, a=VALUES[0, 0], b=VALUES[0, 1][:, None], t=TIMES[None])
    found = updyn.read_records(path, values=["a", "b"], time="t")
    check(found, ["a", "b"], ["", ""], VALUES[:1])


def test_version_7_3(tmp_path):
    path = tmp_path / "a.mat"
    matlab73.write_matlab73(path, {"f": VALUES[0, 0][:, None], "s": {"a": VALUES[0, 1][:, None]}})
    found = updyn.read_records(path, values={"f": "f", "1:Z": "s.a"}, rate=4.0)
    check(found, ["f", "1:Z"], ["", ""], VALUES[:1])


@pytest.mark.parametrize("write", [mat, h5])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"select the arrays of records .* holds .*'f' \(float64|holds no variable 'records'"),
        ({"values": ["g"], "rate": 1.0}, "no array 'g'; "),
        ({"values": ["t"]}, "expected either time, the array of times in s, or rate"),
        ({"values": ["t"], "rate": 1.0, "time": "t"}, "expected either time"),
        ({"values": ["f"], "rate": 1.0}, r"'f' has shape \(8, 3\): give its axes"),
        ({"values": ["f"], "rate": 1.0, "order": ["time", "hit"]}, "found 'hit'"),
        ({"values": ["f"], "rate": 1.0, "order": ["record"]}, "expected the axis time"),
        ({"values": ["f"], "rate": 1.0, "order": ["time"]}, "expected 1 axes: time"),
        ({"values": ["f"], "rate": 0.0, "order": ["time", "record"]}, "rate 0.0: expected samples"),
        ({"values": ["f"], "rate": "t", "order": ["time", "record"]}, "expected one number"),
        ({"values": ["f"], "time": "u", "order": ["time", "record"]}, "'u': 5 times for 8 samples"),
        ({"values": ["f"], "time": "v", "order": ["time", "record"]}, "v: times .* even steps"),
        ({"values": ["u", "v"], "rate": 1.0}, "'v' holds 1 records of 8 samples, 'u' 1 records of"),
        ({"values": ["c"], "rate": 1.0}, "c: found complex numbers"),
        ({"values": "f", "rate": 1.0}, r"name them with channels"),
        (
            {"values": "f", "rate": 1.0, "channels": ["a"], "order": ["time", "channel"]},
            "1 channels, but 3 in 'f'",
        ),
        ({"values": ["t"], "rate": 1.0, "channels": ["a"]}, "values give the array of each"),
        ({"values": ["t"], "rate": 1.0, "units": {"x": "N"}}, "no channel 'x'"),
        ({"values": ["n"], "rate": 1.0}, "sample 2 is nan"),
    ],
)
def test_arrays_that_are_not_what_is_said(tmp_path, write, options, message):
    path = write(
        tmp_path,
        f=VALUES[:, 0].T,
        t=TIMES,
        u=TIMES[:5],
        v=TIMES**2,
        c=TIMES * 1j,
        n=np.array([0.0, np.nan, 1.0]),
    )
    with pytest.raises(UpdynError, match=message):
        updyn.read_records(path, **options)


def test_an_attribute_called_name_says_nothing_of_a_dataset(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["force"] = VALUES[0, 0]
        file["force"].attrs["NAME"] = "hammer"
    found = updyn.read_records(tmp_path / "a.h5", values={"force": "force"}, rate=1.0 / STEP)
    check(found, ["force"], [""], VALUES[:1, :1])


@pytest.mark.parametrize("name", ["a.nc", "a.h5"])
def test_what_xarray_wrote_of_records(tmp_path, name):
    given = updyn.read_records(put(tmp_path / "a.uff", b"".join(responses())))
    given.transpose("time", "record", "channel").to_netcdf(tmp_path / name, engine="h5netcdf")
    check(updyn.read_records(tmp_path / name), ["7:-Z force", "4:Z"], ["N", "m/s^2"])
    raw = (tmp_path / name).read_bytes()
    with pytest.raises(FormatError):
        updyn.read_records(put(tmp_path / f"cut{name}", raw[: len(raw) // 2]))


# -- tables --------------------------------------------------------------------------------------------
TABLE = """\
# hammer test
time,hammer [N],3:-Z [g],note
0.0,1.5,-0.25,1
0.5,2.5,0.5,2
# in between
1.0,3.5,0.75,3
"""


def test_a_table(tmp_path):
    for text in (
        TABLE,
        TABLE.replace(",", ";"),
        TABLE.replace(",", "\t"),
        TABLE.replace("\n", "\r\n"),
    ):
        found = updyn.read_records(put(tmp_path / "a.csv", text))
        check(
            found,
            ["hammer", "3:-Z", "note"],
            ["N", "g", ""],
            np.array([[[1.5, 2.5, 3.5], [-0.25, 0.5, 0.75], [1.0, 2.0, 3.0]]]),
            0.5,
        )


def test_a_table_of_several_records(tmp_path):
    text = TABLE.replace("note", "record").replace(",2\n", ",1\n").replace(",3\n", ",1\n")
    rows = "0.0,4.5,1.5,7\n0.5,5.5,2.5,7\n1.0,6.5,3.5,7\n"
    found = updyn.read_records(put(tmp_path / "a.csv", text + rows))
    assert found.shape == (2, 2, 3)
    assert found.values[1].tolist() == [[4.5, 5.5, 6.5], [1.5, 2.5, 3.5]]


def test_a_table_with_a_rate(tmp_path):
    text = "a,b\n1.0,2.0\n3.0,4.0\n"
    found = updyn.read_records(put(tmp_path / "a.csv", text), rate=4.0)
    check(found, ["a", "b"], ["", ""], np.array([[[1.0, 3.0], [2.0, 4.0]]]))
    named = updyn.read_records(put(tmp_path / "b.csv", TABLE.replace("time", "t/s")), time="t/s")
    assert named.shape == (1, 3, 3)


@pytest.mark.parametrize("name", ["elapsed_ms", "Time - ms", "time in ms", "ms"])
def test_a_unit_at_the_end_of_the_name_of_times(tmp_path, name):
    path = put(tmp_path / "a.csv", f"{name},a\n0,1.0\n500,3.0\n1000,2.0\n")
    check(updyn.read_records(path, time=name), ["a"], [""], np.array([[[1.0, 3.0, 2.0]]]), 0.5)


@pytest.mark.parametrize(
    ("old", "new", "options", "message"),
    [
        ("2.5,0.5,2", "2.5,0.5", {}, ":4: found '0.5,2.5,0.5'; expected 4 numbers"),
        ("2.5,0.5,2", "2.5,,0.5,2", {}, ":4: found '0.5,2.5,,0.5,2'; expected 4 numbers"),
        ("2.5,0.5,2", "2.5 0.5,2", {}, ":4: found '0.5,2.5 0.5,2'; expected 4 numbers"),
        ("0.5,2.5", ",0.5,2.5", {}, ":4: found ',0.5,2.5,0.5,2'; expected 4 numbers"),
        ("2.5,0.5,2", "2.5,0.5,2,3", {}, ":4: found .*; expected 4 numbers"),
        ("2.5", "2.5x", {}, ":4: found '0.5,2.5x,0.5,2'"),
        ("2.5", "nan", {}, ":4: found '0.5,nan,0.5,2'"),
        (",3\n", ",3", {}, "the last line"),
        ("0.5,2.5", "0.6,2.5", {}, "time: times .* even steps"),
        ("time,", "tine,", {}, ":2: no column 'time' of times; did you mean 'tine'"),
        ("time,", "time,", {"rate": 3.0}, "rate and a column 'time' of times"),
        ("time,", "time,", {"time": "tim"}, "no column 'tim' of times; did you mean 'time'"),
        ("note", "hammer", {}, ":2: header: column 'hammer' occurs twice"),
        ("note", "", {}, ":2: header: column 4 is ''"),
        ("note", "record", {}, "time: times of the records"),
        ("note\n", "record\n", {"time": "note"}, "no column 'note' of times"),
        ("time,hammer [N],3:-Z [g],note", "x", {"rate": -1.0}, "|".join(("found", "rate -1.0"))),
    ],
)
def test_tables_that_are_not_sound(tmp_path, old, new, options, message):
    assert old in TABLE
    path = put(tmp_path / "a.csv", TABLE.replace(old, new, 1))
    with pytest.raises(UpdynError, match=message):
        updyn.read_records(path, **options)
