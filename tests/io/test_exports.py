"""Exports of other test systems by value: synthetic copies of the layouts in docs/formats.md, with other numbers."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

import updyn
from updyn.cli import main
from updyn.errors import FormatError, OptionError

FREQ = np.array([0.5, 1.0, 1.5, 2.0])
A = np.array([1 + 2j, -0.5 + 0.25j, 3e-3 - 4e-3j, 0.125 - 7j])
B = np.array([2 - 1j, 0.125 + 8j, -1.5 - 2e-5j, 3.5 + 1j])
COH = np.array([0.5, 0.75, 1.0, 0.875])
STEP = 0.25
RNG = np.random.default_rng(9)
HAMMER, MOTION = RNG.integers(-1000, 1000, (2, 8)) / 64.0
LABELS = {"response": "3:Z", "reference": "1:Z"}


def check_frf(found, responses, values, unit=1.0) -> None:
    np.testing.assert_allclose(found.freq, FREQ, rtol=1e-12)
    assert (found.responses.labels, found.references.labels) == (responses, ["1:Z"])
    np.testing.assert_allclose(found.values[:, :, 0], unit * np.transpose(values), rtol=1e-12)


def check_records(found, channels=("hammer", "3:Z"), units=("N", "g")) -> None:
    assert found["channel"].values.tolist() == list(channels)
    assert found["unit"].values.tolist() == list(units)
    np.testing.assert_array_equal(found.values, [[HAMMER, MOTION]])
    np.testing.assert_allclose(found["time"].values, STEP * np.arange(8), rtol=1e-12)


# -- FRFs by a mapping -----------------------------------------------------------------------------
def pulse_text(values, unit="m/s^2/N", kind="Complex") -> str:
    """PULSE LabShop 20: names and values, rows of number, frequency, real and imaginary part, tags."""
    head = [
        "Header Size:\t 15\t ",
        "Pulse Version:\t 80\t ",
        "Decimal Symbol:\t.\t ",
        f"Data Type:\t{kind}\t ",
        "Z-Axis size:\t1\t ",
        "X-Axis type:\tLinear\t ",
        f"X-Axis size:\t{len(FREQ)}\t ",
        "X-Axis unit:\tHz\t ",
        "X-Axis first value:\t 5.0000000000e-001\t ",
        "\t \t ",
        f"AmplitudeUnit:\t{unit}\t ",
        "Function:\tFrequency Response H1\t ",
        "Signal:\tSignal 2\t ",
        "\t \t ",
        "Title:\tFrequency Response H1(Signal 2,Signal 1) - Input\t ",
        "Z-index:\t \t1",
        "Date:\t \t2026/3/4",
        "Time:\t \t05:06:07:250",
        "Relative time:\t \t 0.00000e+000",
        "Z-axis:\t \t 0.0000000000e+000",
    ]
    rows = []
    for number, (f, z) in enumerate(zip(FREQ, values, strict=True), 1):
        parts = [z.real, z.imag] if kind == "Complex" else [z.real]
        rows.append(f"{number}\t {f:.10e}\t " + "\t ".join(f"{part:.15e}" for part in parts))
    tags = ["TagsBegin:\t \t ", "OverLoad:\t \tFalse", "AverageNumber: []\t \t 1.00000e+001"]
    return "\n".join([*head, *rows, *tags, "TagsEnd:\t \t "]) + "\n"


POINT = {"response": "{node}:{axis}", "reference": "1:Z", "real": 3, "imaginary": 4}


def test_pulse_text_of_one_file_per_point(tmp_path):
    for node, values in ((3, A), (5, B)):
        (tmp_path / f"H1_{node}Z.txt").write_text(pulse_text(values))
    columns = {"frequency": 2, "channels": [POINT]}
    found = updyn.read_frf(tmp_path / "H1_{node}{axis}.txt", columns=columns)
    check_frf(found, ["3:Z", "5:Z"], [A, B])
    assert found.quantity == "accelerance"


def test_pulse_text_of_real_values_in_another_unit(tmp_path):
    (tmp_path / "a.txt").write_text(pulse_text(A, "V", "Real"))
    channel = {**LABELS, "real": "real [V]"}
    columns = {"frequency": "frequency [Hz]", "channels": [channel]}
    given = {"quantity": "mobility", "real_valued": True}
    with pytest.raises(FormatError, match="'V'"):
        updyn.read_frf(tmp_path / "a.txt", columns=columns, **given)
    found = updyn.read_frf(tmp_path / "a.txt", columns={**columns, "unit": "m/s/N"}, **given)
    check_frf(found, ["3:Z"], [A.real])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "X-Axis size:\t4",
            "X-Axis size:\t5",
            r"25: truncated .* states 5 rows of 4 columns; no row 5",
        ),
        ("X-Axis size:\t4", "X-Axis size:\t?", r"X-Axis size '\?'; expected a whole number"),
        ("\n3\t", "\n4\t", "23: truncated .* no row 3"),
        ("Complex", "Octave", "Data Type 'Octave'; expected Real or Complex"),
        ("Z-Axis size:\t1", "Z-Axis size:\t2", "several functions along the Z axis"),
    ],
)
def test_damaged_pulse_texts(tmp_path, old, new, message):
    text = pulse_text(A)
    assert old in text
    (tmp_path / "a.txt").write_text(text.replace(old, new))
    columns = {"frequency": 2, "channels": [{**LABELS, "real": 3, "imaginary": 4}]}
    with pytest.raises(FormatError, match=message):
        updyn.read_frf(tmp_path / "a.txt", columns=columns)


def quickdaq_text(unit="m/s^2/N") -> str:
    head = [
        "QuickDAQ,2.5",
        "Measurement Type,FRF,,Coherence",
        "Channel Name,Ain 1,,Ain 1",
        "X Axis Units,Hz,,Hz",
        f"Y Axis Units,{unit},,",
        "Frequency,Magnitude,Phase,Magnitude",
    ]
    columns = (FREQ, np.abs(A), np.angle(A, deg=True), COH)
    rows = [",".join(f"{x:.15e}" for x in row) for row in zip(*columns, strict=True)]
    return "\n".join([*head, *rows]) + "\n"


def test_quickdaq_text(tmp_path, capsys):
    channel = {
        **LABELS,
        "magnitude": "FRF Magnitude",
        "phase_deg": "FRF Phase",
        "coherence": "Coherence Magnitude",
    }
    columns = {"frequency": "Frequency", "channels": [channel]}
    (tmp_path / "a.csv").write_text(quickdaq_text())
    found = updyn.read_frf(tmp_path / "a.csv", columns=columns)
    check_frf(found, ["3:Z"], [A])
    np.testing.assert_array_equal(found.coherence[:, 0, 0], COH)
    assert found.quantity == "accelerance"
    (tmp_path / "b.csv").write_text(quickdaq_text("(mm/s)/N"))
    found = updyn.read_frf(tmp_path / "b.csv", columns=columns)
    check_frf(found, ["3:Z"], [A], 1e-3)
    (tmp_path / "c.csv").write_text(quickdaq_text("m/s^2/V"))
    with pytest.raises(FormatError, match="'m/s\\^2/V', which is not a known motion per force"):
        updyn.read_frf(tmp_path / "c.csv", columns=columns, quantity="accelerance")
    assert main(["info", str(tmp_path / "a.csv")]) == 2
    proposed = (
        'magnitude = "FRF Magnitude", phase_deg = "FRF Phase", coherence = "Coherence Magnitude"'
    )
    assert proposed in capsys.readouterr().err


def test_signalcalc_text(tmp_path, capsys):
    head = [
        "Data written for Project 1, Test 2, Run 3",
        "",
        "\tH1,2\t\tH1,3\t",
        "Frequency\tReal\tImag\tReal\tImag",
        "",
        "",
        "Units:",
        "Hz\tm/s2/N\t\tm/s2/N\t",
        "",
    ]
    rows = [
        f"{f:.6e}\t{a.real:.15e}\t{a.imag:.15e}\t{b.real:.15e}\t{b.imag:.15e}"
        for f, a, b in zip(FREQ, A, B, strict=True)
    ]
    (tmp_path / "H.txt").write_text("\n".join([*head, *rows]) + "\n")
    columns = {
        "frequency": "Frequency",
        "channels": [
            {**LABELS, "real": "H1,2 Real", "imaginary": "H1,2 Imag"},
            {**LABELS, "response": "5:Z", "real": "H1,3 Real", "imaginary": "H1,3 Imag"},
        ],
    }
    found = updyn.read_frf(tmp_path / "H.txt", columns=columns)
    check_frf(found, ["3:Z", "5:Z"], [A, B])
    assert found.quantity == "accelerance"
    assert main(["info", str(tmp_path / "H.txt")]) == 2
    assert 'real = "H1,3 Real", imaginary = "H1,3 Imag"' in capsys.readouterr().err


def shdf(kind: str, unit: str, axis, data) -> dict:
    """The struct of an export of ArtemiS."""
    names = np.zeros(len(data), dtype=[("szName", object), ("szUnit", object)])
    for at, name in enumerate(("hammer", "3:Z")[: len(data)]):
        names[at] = (name, ("N", "g")[at])
    return {
        "nNbrOfChn": float(len(data)),
        "Absc": {"szAbbrev": kind, "szUnit": unit, "nNbrOfSamples": float(len(axis))},
        "Absc1Data": axis,
        "Data": np.array(data),
        "Chn": names,
    }


def test_artemis_arrays(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"shdf": shdf("f", "Hz", FREQ, [A, B])})
    found = updyn.read_frf(
        tmp_path / "a.mat",
        quantity="accelerance",
        variables={"freq": "shdf.Absc1Data", "H": "shdf.Data"},
        order=["response", "freq"],
        response_labels=["3:Z", "5:Z"],
        reference_labels=["1:Z"],
    )
    check_frf(found, ["3:Z", "5:Z"], [A, B])
    axis = STEP * np.arange(8)
    scipy.io.savemat(tmp_path / "b.mat", {"shdf": shdf("t", "s", axis, [HAMMER, MOTION])})
    found = updyn.read_records(
        tmp_path / "b.mat",
        values="shdf.Data",
        channels=["hammer", "3:Z"],
        order=["channel", "time"],
        time="shdf.Absc1Data",
        units={"hammer": "N", "3:Z": "g"},
    )
    check_records(found)


# -- time records ----------------------------------------------------------------------------------
def test_dewesoft_arrays(tmp_path):
    axis = STEP * np.arange(8)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["hammer"] = np.column_stack([axis, HAMMER])
        file["AI 2"] = np.column_stack([axis, MOTION])
    given = {"units": {"hammer": "N", "3:Z": "g"}}
    found = updyn.read_records(
        tmp_path / "a.h5",
        values={"hammer": "hammer(:,2)", "3:Z": "AI 2(:,2)"},
        time="hammer(:,1)",
        **given,
    )
    check_records(found)
    with pytest.raises(FormatError, match=r"hammer\(:,3\): 'hammer' has shape \(8, 2\); expected a table with column 3"):  # fmt: skip
        updyn.read_records(tmp_path / "a.h5", values={"a": "hammer(:,3)"}, rate=4.0)
    with pytest.raises(FormatError, match="no array 'hamer'; did you mean 'hammer'"):
        updyn.read_records(tmp_path / "a.h5", values={"a": "hamer(:,2)"}, rate=4.0)
    arrays = {
        "Sample_rate": 4.0,
        "Data1_hammer": HAMMER,
        "Data1_time_hammer": axis,
        "Data1_AI_2": MOTION,
    }
    scipy.io.savemat(tmp_path / "a.mat", arrays)
    values = {"hammer": "Data1_hammer", "3:Z": "Data1_AI_2"}
    for clock in ({"time": "Data1_time_hammer"}, {"rate": "Sample_rate"}):
        check_records(updyn.read_records(tmp_path / "a.mat", values=values, **clock, **given))


def bk_variables(**changes) -> dict:
    """The MATLAB export of PULSE and BK Connect."""
    variables = {
        "File_Header": {
            "NumberOfChannels": "2",
            "SampleFrequency": "4.000000",
            "NumberOfSamplesPerChannel": "8",
            "Date": "04-Mar-2026",
            "Comment": "",
        }
    }
    named = (("hammer", "N", HAMMER), ("3:Z", "g", MOTION))
    for number, (name, unit, values) in enumerate(named, 1):
        variables[f"Channel_{number}_Header"] = {"SignalName": name, "Unit": unit}
        variables[f"Channel_{number}_Data"] = values
    return variables | changes


def test_the_matlab_export_of_pulse(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, bk_variables())
    check_records(updyn.read_records(path))
    found = updyn.read_records(path, channels=["3:Z"])
    assert found["channel"].values.tolist() == ["3:Z"]
    named = updyn.read_records(path, values={"f": "Channel_1_Data"}, rate=4.0, units={"f": "N"})
    np.testing.assert_array_equal(named.values, [[HAMMER]])
    with pytest.raises(OptionError, match="rate without values"):
        updyn.read_records(path, rate=4.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"Channel_2_Data": MOTION[:7]}, "Channel_2_Data has 7 samples; expected 8"),
        ({"Channel_2_Header": {"SignalName": "3:Z"}}, "Channel_2_Header: no field 'Unit'"),
        ({"File_Header": {"NumberOfChannels": "3", "SampleFrequency": "4", "NumberOfSamplesPerChannel": "8"}}, "no variable 'Channel_3_Header'"),
        ({"File_Header": {"NumberOfChannels": "2", "SampleFrequency": "x", "NumberOfSamplesPerChannel": "8"}}, "File_Header: SampleFrequency: 'x' is not a number"),
        ({"File_Header": {"NumberOfChannels": "2", "SampleFrequency": "-4", "NumberOfSamplesPerChannel": "8"}}, "File_Header: SampleFrequency is '-4'; expected a number above 0"),
    ],
)  # fmt: skip
def test_damaged_matlab_exports_of_pulse(tmp_path: Path, changes, message):
    scipy.io.savemat(tmp_path / "a.mat", bk_variables(**changes))
    with pytest.raises(FormatError, match=message):
        updyn.read_records(tmp_path / "a.mat")
