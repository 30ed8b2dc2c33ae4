"""Time records of TDMS and MDF files, whose channels are in groups of one sampling rate each."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

import updyn
from updyn.cli import main
from updyn.errors import FormatError, InputError, OptionError, UpdynWarning

RNG = np.random.default_rng(7)
FORCE, MOTION = RNG.integers(-1000, 1000, (2, 3, 8)) / 128.0
STEP = 0.25
START = np.datetime64("2026-03-04T05:06:07.250000")


def tdms_channel(group: str, name: str, values, unit: str = "", **properties) -> ChannelObject:
    timing = {"wf_increment": STEP, "wf_start_offset": 0.0, "wf_start_time": START}
    stated = timing | ({"unit_string": unit} if unit else {}) | properties
    return ChannelObject(group, name, values, {k: v for k, v in stated.items() if v is not None})


def write_tdms(path: Path, *segments) -> Path:
    with TdmsWriter(path) as writer:
        for segment in segments:
            writer.write_segment(segment)
    return path


def hit(record: int, group: str = "", **properties) -> list[ChannelObject]:
    group = group or f"hit {record + 1}"
    return [
        tdms_channel(group, "hammer", FORCE[record], "N", **properties),
        tdms_channel(group, "3:-Z", MOTION[record], "g", **properties),
    ]


def check(found, values, channels=("hammer", "3:-Z"), units=("N", "g"), step=STEP) -> None:
    assert found["channel"].values.tolist() == list(channels)
    assert found["unit"].values.tolist() == list(units)
    np.testing.assert_array_equal(found.values, values)
    assert found["time"].values == pytest.approx(step * np.arange(found.shape[2]), rel=1e-12)


# -- TDMS ------------------------------------------------------------------------------------------
def test_a_tdms_file_of_one_group(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", [RootObject({"author": "x"}), *hit(0, "data")])
    found = updyn.read_records(path)
    check(found, [[FORCE[0], MOTION[0]]])
    assert found.attrs["source"] == "a.tdms, started 2026-03-04T05:06:07.250000"


def test_samples_of_a_tdms_channel_in_several_segments(tmp_path):
    halves = [
        [
            tdms_channel("data", "hammer", FORCE[0, part], "N"),
            tdms_channel("data", "3:-Z", MOTION[0, part], "g"),
        ]
        for part in (slice(4), slice(4, 8))
    ]
    check(updyn.read_records(write_tdms(tmp_path / "a.tdms", *halves)), [[FORCE[0], MOTION[0]]])


def test_scaled_integers_of_a_tdms_file(tmp_path):
    scale = {
        "NI_Number_Of_Scales": np.uint32(1),
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.5,
        "NI_Scale[0]_Linear_Y_Intercept": 10.0,
        "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
    }
    raw = np.arange(8, dtype=np.int16)
    path = write_tdms(tmp_path / "a.tdms", [tdms_channel("g", "a", raw, **scale)])
    check(updyn.read_records(path), [[10.0 + 0.5 * raw]], ["a"], [""])


def test_groups_of_a_tdms_file_are_named_or_read_as_records(tmp_path):
    slow = tdms_channel("slow", "temperature", np.arange(3.0), "degC", wf_increment=1.0)
    path = write_tdms(tmp_path / "a.tdms", [*hit(0), *hit(1), slow])
    with pytest.raises(OptionError) as caught:
        updyn.read_records(path)
    assert str(caught.value) == (
        f"{path}: 3 groups of channels: 'hit 1' (hammer, 3:-Z; 8 samples, 4 a second), 'hit 2'"
        " (hammer, 3:-Z; 8 samples, 4 a second), 'slow' (temperature; 3 samples, 1 a second);"
        " select one with group = 'hit 1', or several of the same channels, as records, with"
        " group = ['hit 1', 'hit 2']"
    )
    assert caught.value.key == ("group",)
    check(updyn.read_records(path, group="hit 2"), [[FORCE[1], MOTION[1]]])
    both = updyn.read_records(path, group=["hit 2", "hit 1"])
    check(both, [[FORCE[1], MOTION[1]], [FORCE[0], MOTION[0]]])
    with pytest.raises(FormatError, match="group 'hit 3'; did you mean 'hit"):
        updyn.read_records(path, group="hit 3")
    with pytest.raises(FormatError, match=r"slow.* has channels .*'temperature'"):
        updyn.read_records(path, group=["hit 1", "slow"])


def test_several_rates_in_a_group_are_not_resampled(tmp_path):
    fast = tdms_channel("data", "sound", np.arange(16.0), "Pa", wf_increment=STEP / 2)
    path = write_tdms(tmp_path / "a.tdms", [*hit(0, "data"), fast])
    with pytest.raises(FormatError) as caught:
        updyn.read_records(path)
    assert str(caught.value) == (
        f"{path}: group 'data' has channels of several rates, lengths or starts: hammer, 3:-Z (8"
        " samples, 4 a second, from 2026-03-04T05:06:07.250000), sound (16 samples, 8 a second, from"
        " 2026-03-04T05:06:07.250000); records are not resampled; select channels that agree with"
        " channels = ['hammer', '3:-Z']"
    )
    check(updyn.read_records(path, channels=["3:-Z"]), [[MOTION[0]]], ["3:-Z"], ["g"])
    with pytest.raises(FormatError, match="'data': no channel 'hamer'; did you mean 'hammer'"):
        updyn.read_records(path, channels=["hamer"])


@pytest.mark.parametrize(
    "other", [{"wf_start_offset": 0.125}, {"wf_start_time": START + np.timedelta64(1, "ms")}]
)
def test_channels_that_start_at_different_times_are_refused(tmp_path, other):
    late = tdms_channel("data", "late", FORCE[1], "N", **other)
    path = write_tdms(tmp_path / "a.tdms", [*hit(0, "data"), late])
    with pytest.raises(FormatError, match=r"several rates, lengths or starts: .* late \(8 samples"):
        updyn.read_records(path)


def test_tdms_channels_without_a_step(tmp_path):
    bare = {"wf_increment": None, "wf_start_offset": None, "wf_start_time": None}
    times = tdms_channel("data", "Time", 1000.0 * STEP * np.arange(8), "ms", **bare)
    path = write_tdms(tmp_path / "a.tdms", [times, *hit(0, "data", **bare)])
    with pytest.raises(OptionError, match=r"no sampling rate; .*time = 'Time'.* or rate"):
        updyn.read_records(path)
    check(updyn.read_records(path, time="Time"), [[FORCE[0], MOTION[0]]])
    minutes = tdms_channel("data", "Time (min)", STEP / 60.0 * np.arange(8), **bare)
    named = write_tdms(tmp_path / "b.tdms", [minutes, *hit(0, "data", **bare)])
    check(updyn.read_records(named, time="Time (min)"), [[FORCE[0], MOTION[0]]])
    check(updyn.read_records(path, rate=4.0, channels=["hammer", "3:-Z"]), [[FORCE[0], MOTION[0]]])
    with pytest.raises(OptionError, match="time and rate; expected one"):
        updyn.read_records(path, rate=4.0, time="Time")
    with pytest.raises(OptionError, match="rate 0: expected samples per second"):
        updyn.read_records(path, rate=0)
    stated = write_tdms(tmp_path / "b.tdms", hit(0))
    with pytest.raises(OptionError, match="rate: the file states 4 samples per second"):
        updyn.read_records(stated, rate=8.0)


def test_times_of_day_of_a_tdms_file(tmp_path):
    bare = {"wf_increment": None, "wf_start_offset": None, "wf_start_time": None}
    days = START + (1000 * STEP * np.arange(8)).astype("timedelta64[ms]")
    path = write_tdms(
        tmp_path / "a.tdms", [tdms_channel("data", "Log ms", days, **bare), *hit(0, "data", **bare)]
    )
    check(updyn.read_records(path, time="Log ms"), [[FORCE[0], MOTION[0]]])


def test_many_groups_are_listed_in_part(tmp_path):
    groups = [part for number in range(20) for part in hit(0, f"hit {number:02}")]
    path = write_tdms(tmp_path / "a.tdms", groups)
    with pytest.raises(
        OptionError, match=r"20 groups of channels: .*'hit 11' \(.*\), \.\.\.; select"
    ):
        updyn.read_records(path)


def test_a_step_in_another_unit_and_spectra(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", hit(0, wf_increment=250.0, wf_xunit_string="ms"))
    check(updyn.read_records(path), [[FORCE[0], MOTION[0]]])
    path = write_tdms(tmp_path / "b.tdms", hit(0, wf_xunit_string="Hz"))
    named = write_tdms(tmp_path / "c.tdms", hit(0, wf_xname="Frequency"))
    with pytest.raises(FormatError, match="'hammer': abscissa in 'Hz'; expected time"):
        updyn.read_records(named)
    with pytest.raises(FormatError, match="'hammer': abscissa in 'Hz'; expected time"):
        updyn.read_records(path)


def test_a_step_of_one_second_is_the_default_of_labview(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", hit(0, wf_increment=1.0))
    with pytest.warns(UpdynWarning, match="also writes .* without a sampling rate"):
        updyn.read_records(path)


def test_channels_that_are_no_records_are_left_out_by_name(tmp_path):
    path = write_tdms(
        tmp_path / "a.tdms",
        [
            GroupObject("empty"),
            *hit(0, "data"),
            ChannelObject("data", "remark", ["x", "y"]),
            ChannelObject("data", "none", np.array([])),
        ],
    )
    with pytest.warns(
        UpdynWarning, match="without samples or numbers are ignored: 'remark', 'none'"
    ):
        check(updyn.read_records(path), [[FORCE[0], MOTION[0]]])
    with pytest.raises(FormatError, match="channel 'remark': expected numbers"):
        updyn.read_records(path, channels=["hammer", "remark"])


def test_an_index_file_beside_a_tdms_file_is_not_read(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", hit(0))
    (tmp_path / "a.tdms_index").write_bytes(b"TDSh, and nothing that follows from it")
    check(updyn.read_records(path), [[FORCE[0], MOTION[0]]])


def test_cut_tdms_files_are_refused(tmp_path):
    raw = write_tdms(tmp_path / "a.tdms", hit(0, "data")).read_bytes()
    path = tmp_path / "b.tdms"
    for size in range(1, len(raw), 7):
        path.write_bytes(raw[:size])
        with pytest.raises(FormatError):
            updyn.read_records(path)
    path.write_bytes(raw + raw[:40])
    with pytest.raises(FormatError, match=r"truncated or damaged: segment 2 .* declares"):
        updyn.read_records(path)
    path.write_bytes(raw[:12] + struct.pack("<Q", 2**64 - 1) + raw[20:])
    with pytest.raises(FormatError, match=r"segment 1 .* was not completed"):
        updyn.read_records(path)


# -- MDF -------------------------------------------------------------------------------------------
def write_mdf(path: Path, *groups: tuple[str, list[Signal]], version="4.10", **options) -> Path:
    with MDF(version=version) as mdf:
        for name, signals in groups:
            mdf.append(signals, acq_name=name)
        mdf.save(path, overwrite=True, **options)
    return path


TIMES = STEP * np.arange(8)


def signals(record: int = 0, times=TIMES) -> list[Signal]:
    return [
        Signal(FORCE[record], times, name="hammer", unit="N"),
        Signal(MOTION[record], times, name="3:-Z", unit="g"),
    ]


@pytest.mark.parametrize("options", [{}, {"compression": 2}])
def test_an_mdf_file_of_one_group(tmp_path, options):
    path = write_mdf(
        tmp_path / "a.mf4", ("fast", signals(times=5.0 + STEP * np.arange(8))), **options
    )
    found = updyn.read_records(path)
    check(found, [[FORCE[0], MOTION[0]]])
    assert found.attrs["source"].startswith("a.mf4, started 20")


def test_rasters_of_an_mdf_file_are_named_and_not_resampled(tmp_path):
    slow = [Signal(np.arange(3), 4 * STEP * np.arange(3), name="speed", unit="m/s", conversion={"a": 0.5, "b": 1.0})]  # fmt: skip
    path = write_mdf(tmp_path / "a.mf4", ("fast", signals()), ("", slow), ("fast", signals(1)))
    with pytest.raises(OptionError) as caught:
        updyn.read_records(path)
    assert str(caught.value).startswith(
        f"{path}: 3 groups of channels: 'fast (group 1)' (hammer, 3:-Z; 8 samples, 4 a second),"
        " 'group 2' (speed; 3 samples, 1 a second), 'fast (group 3)' (hammer"
    )
    check(updyn.read_records(path, group="group 2"), [[[1.0, 1.5, 2.0]]], ["speed"], ["m/s"], 1.0)
    both = updyn.read_records(path, group=["fast (group 1)", "fast (group 3)"])
    check(both, [[FORCE[0], MOTION[0]], [FORCE[1], MOTION[1]]])


def test_the_unit_of_the_conversion_of_an_mdf_channel(tmp_path):
    raw = Signal(np.arange(8, dtype="i2"), TIMES, name="a", conversion={"a": 0.5, "b": 1.0})
    path = tmp_path / "a.mf4"
    with MDF(version="4.10") as mdf:
        mdf.append([raw], acq_name="g")
        mdf.groups[0].channels[1].conversion.unit = "g"
        mdf.save(path)
    check(updyn.read_records(path), [[1.0 + 0.5 * np.arange(8)]], ["a"], ["g"])


def test_channels_of_one_name_get_their_numbers(tmp_path):
    twice = [Signal(row, TIMES, name="a", unit="N") for row in (FORCE[0], MOTION[0])]
    path = write_mdf(tmp_path / "a.mf4", ("g", twice))
    names = ["a (channel 1)", "a (channel 2)"]
    check(updyn.read_records(path), [[FORCE[0], MOTION[0]]], names, ["N", "N"])
    check(updyn.read_records(path, channels=names[:1]), [[FORCE[0]]], names[:1], ["N"])


def test_times_of_an_mdf_file_in_another_unit_are_refused(tmp_path):
    path = tmp_path / "a.mf4"
    with MDF(version="4.10") as mdf:
        mdf.append(signals(), acq_name="g")
        mdf.groups[0].channels[0].unit = "ms"
        mdf.save(path)
    with pytest.raises(FormatError, match=r"abscissa in 'ms \(.*expected time, in MDF files in s"):
        updyn.read_records(path)


def test_jittered_times_and_invalid_samples_of_an_mdf_file_are_refused(tmp_path):
    times = STEP * np.arange(8) + 0.01 * RNG.random(8)
    path = write_mdf(tmp_path / "a.mf4", ("bus", signals(times=times)))
    with pytest.raises(FormatError, match=r"group 'bus': times of the records: 0\.2.* even steps"):
        updyn.read_records(path)
    marked = Signal(FORCE[0], STEP * np.arange(8), name="a", invalidation_bits=np.arange(8) == 3)
    path = write_mdf(tmp_path / "b.mf4", ("g", [marked]))
    with pytest.raises(FormatError, match="sample 4 is nan"):
        updyn.read_records(path)


def test_texts_of_an_mdf_file_are_left_out_by_name(tmp_path):
    text = Signal(np.array([b"x"] * 8), STEP * np.arange(8), name="remark", encoding="utf-8")
    path = write_mdf(tmp_path / "a.mf4", ("g", [*signals(), text]))
    with pytest.warns(UpdynWarning, match="without samples or numbers are ignored: 'remark'"):
        check(updyn.read_records(path), [[FORCE[0], MOTION[0]]])


def test_mdf_files_that_are_not_read(tmp_path):
    path = write_mdf(tmp_path / "a.mdf", ("g", signals()), version="3.30")
    with pytest.raises(FormatError, match=r"MDF of version '3\.30'; expected version 4"):
        updyn.read_records(path)
    raw = write_mdf(tmp_path / "a.mf4", ("g", signals())).read_bytes()
    (tmp_path / "b.mf4").write_bytes(b"UnFinMF " + raw[8:])
    with pytest.raises(FormatError, match="was not finalised by its recorder"):
        updyn.read_records(tmp_path / "b.mf4")


# -- both ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("library", "reader"), [("nptdms", "tdms"), ("asammdf", "mdf")])
def test_a_missing_library_is_named(tmp_path, monkeypatch, library, reader):
    tdms = write_tdms(tmp_path / "a.tdms", hit(0))
    mdf = write_mdf(tmp_path / "a.mf4", ("g", signals()))
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"updyn.foreign.{reader}", raising=False)
    with pytest.raises(InputError, match=r"pip install 'updyn\[records\]'"):
        updyn.read_records(tdms if reader == "tdms" else mdf)


def test_the_command_line_describes_and_uses_them(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_tdms(tmp_path / "one.tdms", hit(0))
    assert main(["info", "one.tdms"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Time records: 1, of 8 samples in 2 s (4 a second)\nchannel  unit")
    assert "Source: one.tdms, started 2026-03-04T05:06:07.250000" in out
    write_tdms(tmp_path / "a.tdms", [*hit(0), *hit(1), *hit(2)])
    assert main(["info", "a.tdms"]) == 2
    assert "3 groups of channels: 'hit 1' (hammer" in capsys.readouterr().err
    (tmp_path / "job.toml").write_text(
        '[records]\nfile = "a.tdms"\nreader = { group = ["hit 1", "hit 2", "hit 3"] }\n'
        'excitation = { hammer = "1:Z" }\noutput = "frf.nc"\n'
    )
    assert main(["frf", "job.toml"]) == 0
    assert "a.tdms: 3 records of 2 channels, 8 samples in 2 s" in capsys.readouterr().out
    assert updyn.read_frf(tmp_path / "frf.nc").responses.labels == ["3:-Z"]
