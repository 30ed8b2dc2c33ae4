"""LabVIEW measurement files: a real one of five hits, other layouts, and what is refused."""

from __future__ import annotations

import lzma

import numpy as np
import pytest

import updyn
from places import DATA
from updyn.errors import FormatError, UpdynWarning

FORCE, MOTION = "Force (Trigger)", "Acceleration (Trigger)"


@pytest.fixture(scope="module")
def impact(tmp_path_factory):
    """Five hits, sample data of pyFRF 1.1.4."""
    path = tmp_path_factory.mktemp("lvm") / "impact.lvm"
    path.write_bytes(lzma.decompress((DATA / "cases" / "impact.lvm.xz").read_bytes()))
    return updyn.read_records(path)


def test_a_real_file_of_five_hits(impact):
    assert impact.dims == ("record", "channel", "time")
    assert impact.shape == (5, 2, 51200)
    assert impact["channel"].values.tolist() == [FORCE, MOTION]
    assert impact["unit"].values.tolist() == ["Newtons", "m/s^2"]
    # As the file says it: 1.953125E-5 s.
    assert impact["time"].values[1] == pytest.approx(1.953125e-5, rel=1e-12)
    assert impact.values[0, :, 0].tolist() == [-0.158373, 0.059175]
    assert impact.values[0, :, -1].tolist() != impact.values[1, :, 0].tolist()
    assert impact.values[0, 0].max() == 2000.067121


def test_the_overloaded_hit_is_named_and_spoils_the_coherence(impact):
    found = updyn.check_records(impact, FORCE, band=(100.0, 4500.0))
    assert [(one.kind, one.record) for one in found] == [("clipped", 1), ("double-hit", 3)]
    assert "3 samples in a row at 2000.07" in found[0].statement
    assert "22.8 ms after it" in found[1].statement

    def coherence(reject):
        frf = updyn.estimate_frf(
            impact,
            {FORCE: "1:Z"},
            responses={MOTION: "2:Z"},
            reject=reject,
            band=(100.0, 5000.0),
        )
        assert frf.quantity == "accelerance"
        return np.median(frf.coherence)

    assert coherence({}) == pytest.approx(0.43, abs=0.005)
    assert coherence({1: "clipped"}) == pytest.approx(0.995, abs=0.001)


HEAD = """LabVIEW Measurement
Separator\t{name}
Decimal_Separator\t{decimal}
X_Columns\t{x}
***End_of_Header***

"""
SEGMENT = """Channels|2
Samples|3|3
Y_Unit_Label|N|g
X_Dimension|Time|Time
Delta_X|0.25|0.25
***End_of_Header***||
X_Value|force|top|Comment
{rows}
"""


def written(name="Tab", decimal=".", x="No", segments=1):
    rows = {
        "No": "|1.5|-2.0E-1\n|0.0|3.0\n|2.5|4.0",
        "One": "0.0|1.5|-2.0E-1\n0.25|0.0|3.0\n0.5|2.5|4.0",
        "Multi": "0.0|1.5|0.0|-2.0E-1\n0.25|0.0|0.25|3.0\n0.5|2.5|0.5|4.0",
    }[x]
    text = SEGMENT.format(rows=rows).replace(".", decimal)
    separator = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}[name]
    head = HEAD.format(name=name, decimal=decimal, x=x)
    return head + "".join(text.replace("|", separator) for _ in range(segments))


def read(tmp_path, text):
    path = tmp_path / "a.lvm"
    path.write_bytes(text.encode())
    return updyn.read_records(path)


@pytest.mark.parametrize("segments", [1, 3])
@pytest.mark.parametrize("x", ["No", "One", "Multi"])
@pytest.mark.parametrize(
    ("name", "decimal"), [("Tab", "."), ("Tab", ","), ("Semicolon", ","), ("Comma", ".")]
)
def test_every_layout_holds_the_same_numbers(tmp_path, name, decimal, x, segments):
    text = written(name, decimal, x, segments)
    for whole in (text, text.replace("\n", "\r\n")):
        found = read(tmp_path, whole)
        assert found.shape == (segments, 2, 3)
        assert found.values[-1].tolist() == [[1.5, 0.0, 2.5], [-0.2, 3.0, 4.0]]
        assert found["unit"].values.tolist() == ["N", "g"]
        assert found["time"].values.tolist() == [0.0, 0.25, 0.5]


def test_tags_of_a_head_stand_in_any_order(tmp_path):
    """As the specification has them: each is unique, and none has to be the first."""
    text = written(segments=3)
    tags = "Channels\t2\nSamples\t3\t3\n"
    for new in (
        "Test_Name\tbeam\nNotes\tsoft tip\n" + tags,
        "Samples\t3\t3\nChannels\t2\n",
        "\nUUT_S/N\t17\n" + tags + "Date\t2024/05/06\t2024/05/06\n",
    ):
        found = read(tmp_path, text.replace(tags, new))
        assert found.shape == (3, 2, 3)
        assert found.values[2].tolist() == [[1.5, 0.0, 2.5], [-0.2, 3.0, 4.0]]


@pytest.mark.parametrize("x", ["No", "One", "Multi"])
def test_comments_are_no_numbers(tmp_path, x):
    text = written(x=x, decimal=",")
    comment = text.replace("-2,0E-1\n", "-2,0E-1\tfirst hit, 3.5 N\n")
    assert comment != text
    assert read(tmp_path, comment).values.tolist() == read(tmp_path, text).values.tolist()


def test_special_blocks_are_left_out_and_lines_counted_all_the_same(tmp_path):
    block = "***Start_Special***\nDevice 7\tsome\nmore\n***End_Special***\n"
    text = written(segments=2)
    special = text.replace("Channels\t2\n", block + "Channels\t2\n")
    assert read(tmp_path, special).values.tolist() == read(tmp_path, text).values.tolist()
    with pytest.raises(FormatError, match=r":20: found '2.5 x'; expected 2 numbers"):
        read(tmp_path, special.replace("2.5\t4.0", "2.5\tx", 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("LabVIEW Measurement\n", "LabVIEW Measuremenz\n", "neither content nor suffix|no head"),
        ("Samples\t3\t3", "Samples\t4\t4", ":7: Samples is 4, found 3 rows"),
        ("Samples\t3\t3", "Samples\t3\t4", ":7: channels of one record with different Samples"),
        ("Samples\t3\t3", "Samples\t3", ":7: Samples of this record: expected 2 values, found 1"),
        ("Samples\t3\t3", "Samples\t3.5\t3", "'3.5' is not a whole number"),
        ("\t2.5\t4.0", "\t2.5\tx", ":16: found '2.5 x'; expected 2 numbers"),
        ("\t2.5\t4.0", "\t2.5\t", ":16: found '2.5'; expected 2 numbers"),
        ("\t2.5\t4.0", "\t2,5\t4.0", ":16: found '2,5 4.0'; expected 2 numbers"),
        ("\t2.5\t4.0\n", "\t2.5\t4.0", ":16: the last line does not end|last line"),
        ("force\ttop", "force", "1 names for 2 channels"),
        ("Time\tTime", "Frequency\tFrequency", "X_Dimension 'Frequency': not a time record"),
        ("X_Columns\tNo", "X_Columns\tNone", "X_Columns 'None'; "),
        (
            "X_Columns\tNo",
            "X_Columns No",
            ":4: found 'X_Columns No'; expected a name and its value",
        ),
        ("X_Columns\tNo", "Separator\tTab", ":4: Separator occurs twice"),
        ("Delta_X\t0.25\t0.25", "Samples\t3\t3", ":11: Samples occurs twice"),
        ("Separator\tTab", "Separator\tTabb", "Separator 'Tabb'; "),
        ("Delta_X\t0.25\t0.25", "Delta_X\t-1\t-1", "time between samples is -1.0 s"),
        ("Channels\t2\n", "", "without the line Channels|Channels of this record"),
    ],
)
def test_what_is_damaged_is_refused_with_its_line(tmp_path, old, new, message):
    text = written()
    assert old in text
    with pytest.raises(FormatError, match=message):
        read(tmp_path, text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Delta_X\t", "X_Unit_Label\tms\tms\nDelta_X\t", ":7: X_Unit_Label 'ms'; expected s"),
        ("Delta_X\t", "X_Unit_Label\tHz\tHz\nDelta_X\t", ":7: X_Unit_Label 'Hz': a spectrum"),
        ("Delta_X\t", "X0\t0.0\t0.1\nDelta_X\t", r":7: channels .* start at 0 to 0.1 \(X0\)"),
        ("Delta_X\t", "Y_Scale\t2\t2\nDelta_X\t", ":11: tag 'Y_Scale' is not known and may"),
        ("Delta_X\t", "Gain factor\t2\t2\nDelta_X\t", ":11: tag 'Gain factor' is not known"),
        ("N\tg", "dB\tdB", ":7: Y_Unit_Label 'dB': a spectrum, not a time record"),
        ("N\tg", "V^2/Hz\tV", r":7: Y_Unit_Label 'V\^2/Hz': a spectrum, not a time record"),
        ("force\ttop", "force\ttop (FFT - (RMS))", r":13: channel 'top .*': by its name a spectrum"),
        ("0.25\t0.25", "1.0\t1.0", ":15: a time of 0.25; expected 1 by Delta_X"),
        ("0.25\t0.25", "0.000250\t0.000250", ":15: a time of 0.25; expected 0.00025 by Delta_X"),
        ("Channels\t2", "Channels\t0", "Samples of this record: expected 0 values"),
        ("Channels\t2", "Channels\t999999999999", "expected 999999999999 values, found 2"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("x", ["One", "Multi"])
def test_what_would_be_read_wrongly_is_refused(tmp_path, old, new, message, x):
    text = written(x=x)
    assert old in text
    with pytest.raises(FormatError, match=message):
        read(tmp_path, text.replace(old, new, 1))


def test_a_step_of_one_second_is_questioned(tmp_path):
    with pytest.warns(UpdynWarning, match=":7: Delta_X is 1 s, which LabVIEW also writes for data"):
        found = read(tmp_path, written().replace("0.25\t0.25", "1.0\t1.0"))
    assert found["time"].values.tolist() == [0.0, 1.0, 2.0]


def test_text_in_windows_1252(tmp_path):
    text = written().replace("N\tg", "N\tm/s²").replace("top", "Türblatt")
    path = tmp_path / "a.lvm"
    path.write_bytes(text.encode("cp1252"))
    found = updyn.read_records(path)
    assert found["unit"].values.tolist() == ["N", "m/s²"]
    assert found["channel"].values.tolist() == ["force", "Türblatt"]


@pytest.mark.parametrize("x", ["No", "One", "Multi"])
def test_channels_without_samples_are_left_out(tmp_path, x):
    """As LabVIEW fills up its rows; the tags with a column of times each are those of lvm_read."""
    text = written(x=x).replace("Channels\t2", "Channels\t4").replace("g\n", "\tg\t\n")
    text = text.replace("3\t3\n", "3\t0\t3\t0\n").replace("Time\n", "Time\tTime\tTime\n")
    text = text.replace("0.25\t0.25\n", "0.25\t1.0\t0.25\t1.0\n", 1)
    text = text.replace("force\ttop", "force\tUntitled\ttop\tUntitled 1")
    head, _, rows = text.partition("Comment\n")
    lines = []
    for row in rows.splitlines():
        cells = row.split("\t")
        middle = len(cells) - (2 if x == "Multi" else 1)
        gap = ["", ""] if x == "Multi" else [""]
        lines.append("\t".join([*cells[:middle], *gap, *cells[middle:], *gap]))
    text = head + "Comment\n" + "\n".join(lines) + "\n"
    message = "channels without samples are ignored: 'Untitled', 'Untitled 1'"
    with pytest.warns(UpdynWarning, match=message):
        found = read(tmp_path, text)
    assert found["channel"].values.tolist() == ["force", "top"]
    assert found["unit"].values.tolist() == ["N", "g"]
    assert found.values.tolist() == [[[1.5, 0.0, 2.5], [-0.2, 3.0, 4.0]]]
    wrong = text.replace("\t3.0", "7.0\t3.0" if x != "Multi" else "\t3.0\t\t7.0")
    with pytest.raises(FormatError, match=":15: a value of channel 'Untitled"):
        read(tmp_path, wrong)


def test_blank_tags_of_columns_of_times(tmp_path):
    """As LabVIEW writes them: the head of multi_time_column.lvm, sample data of lvm_read 1.21."""
    text = written(x="Multi", segments=2)
    for tag in ("3", "Time", "0.25"):
        text = text.replace(f"\t{tag}\t{tag}\n", f"\t{tag}\t\t{tag}\t\n")
    text = text.replace("N\tg", "N\t\tg\t").replace("force\ttop", "force\tX_Value\ttop")
    found = read(tmp_path, text)
    assert found.values[1].tolist() == [[1.5, 0.0, 2.5], [-0.2, 3.0, 4.0]]
    assert found["unit"].values.tolist() == ["N", "g"]


def test_times_tell_a_step_that_is_rounded(tmp_path):
    """3 kHz for 1 s: by Delta_X, 0.000333, the last sample would be 3 samples too early."""
    rows = [f"{k / 3000:.6f}\t{k}\t1" for k in range(3000)]
    text = appended("One", rows).replace("Samples\t3\t3", "Samples\t3000\t3000")
    found = read(tmp_path, text.replace("0.25\t0.25", "0.000333\t0.000333"))
    assert found["time"].values[-1] == pytest.approx(2999 / 3000, rel=1e-6)


def test_records_that_differ_are_refused(tmp_path):
    text = written(segments=2)
    at = text.rindex("Y_Unit_Label\tN\tg")
    with pytest.raises(
        FormatError, match=r":17: this record has units \('N', 'm/s\^2'\), the first one"
    ):
        read(
            tmp_path, text[:at] + "Y_Unit_Label\tN\tm/s^2" + text[at + len("Y_Unit_Label\tN\tg") :]
        )


def test_points_where_commas_are_announced_are_refused(tmp_path):
    text = written(decimal=",").replace("2,5\t4,0", "2.5\t4,0")
    with pytest.raises(FormatError, match=":16: a point in numbers with the decimal sign ','"):
        read(tmp_path, text)


def test_a_head_without_records_is_refused(tmp_path):
    with pytest.raises(FormatError, match="a header without records"):
        read(tmp_path, written(segments=0))


# -- one head for several packets ---------------------------------------------------------------
def test_a_record_without_samples_is_refused(tmp_path):
    text = written().replace("Samples\t3\t3", "Samples\t0\t0")
    text = text[: text.index("X_Value")] + text[text.index("X_Value") :].partition("\n")[0] + "\n"
    with pytest.raises(FormatError, match=r":7: Samples is 0, found 0 rows"):
        read(tmp_path, text)


def appended(x: str, rows: list[str], headings: str = "No") -> str:
    head = HEAD.format(name="Tab", decimal=".", x=x)
    head = head.replace("X_Columns", f"Multi_Headings\t{headings}\nX_Columns")
    return head + SEGMENT.format(rows="\n".join(rows)).replace("|", "\t")


def rows_of(starts: list[float], x: str, step: float = 0.25) -> list[str]:
    """Packets of three rows whose times start there."""
    out = []
    for packet, start in enumerate(starts):
        for k in range(3):
            time = f"{start + step * k:.6f}"
            one, two = 10.0 * packet + k, -0.5 * k
            cells = {"No": ["", one, two], "One": [time, one, two], "Multi": [time, one, time, two]}
            out.append("\t".join(map(str, cells[x])))
    return out


@pytest.mark.parametrize("x", ["No", "One", "Multi"])
def test_appended_packets_are_records(tmp_path, x):
    """As LabVIEW writes them with one head only: their times begin anew, or are not there."""
    found = read(tmp_path, appended(x, rows_of([0.0, 0.0, 0.0], x)))
    assert found.shape == (3, 2, 3)
    assert found.values[2].tolist() == [[20.0, 21.0, 22.0], [0.0, -0.5, -1.0]]
    assert found["time"].values.tolist() == [0.0, 0.25, 0.5]


@pytest.mark.parametrize("x", ["One", "Multi"])
def test_packets_with_a_pause_between_them_are_records(tmp_path, x):
    found = read(tmp_path, appended(x, rows_of([5.0, 5.75, 6.75], x)))
    assert found.shape == (3, 2, 3)


@pytest.mark.parametrize("x", ["One", "Multi"])
@pytest.mark.parametrize("lost", [0, 2])
def test_packets_whose_times_run_on_are_one_record(tmp_path, x, lost):
    """Times are rounded in the file; the last packet may be shorter."""
    step = 1.953125e-5
    rows = rows_of([0.5 + 3 * step * k for k in range(4)], x, step)
    text = appended(x, rows[: len(rows) - lost]).replace("0.25", str(step))
    found = read(tmp_path, text)
    assert found.shape == (1, 2, 12 - lost)
    assert found.values[0, 0, :7].tolist() == [0.0, 1.0, 2.0, 10.0, 11.0, 12.0, 20.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            appended("No", rows_of([0.0, 0.0], "No")[:-1]),
            r":8: 5 rows are not packets of 3 \(Samples\)",
        ),
        (
            appended("One", rows_of([0.0, 0.0], "One")[:-1]),
            r":8: 5 rows are not packets of 3 \(Samples\), and their times are not continuous",
        ),
        (
            appended("One", rows_of([0.0, 0.0], "One")).replace("0.500000\t12", "0.9\t12"),
            r":20: a time of 0.9; expected 0.5 by Delta_X",
        ),
        (
            appended("Multi", rows_of([0.0, 0.0], "Multi")).replace(
                "0.250000\t-0.5", "0.45\t-0.5", 1
            ),
            r":16: times of 0.25 to 0.45 in one row",
        ),
        (
            appended("One", rows_of([0.0, 0.0], "One"), "Yes"),
            r":8: Samples is 3, found 6 rows; .*Multi_Headings",
        ),
        (appended("One", rows_of([0.0], "One"), "no idea"), "Multi_Headings 'no idea'; valid"),
    ],
)
def test_packets_that_are_refused(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read(tmp_path, text)


def test_one_packet_under_the_only_head(tmp_path):
    found = read(tmp_path, appended("One", rows_of([0.0], "One")))
    assert found.shape == (1, 2, 3)
