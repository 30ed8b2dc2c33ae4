"""Tables in text: units in headers and comments, decimal commas, times of few digits."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, OptionError

G = 9.80665


def put(tmp_path, text, name="case.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


# -- FRFs: units ------------------------------------------------------------------------------------
FRF = "{head}freq_Hz,H(3:Z/1:X) re,H(3:Z/1:X) im,H(3:Z/1:X) coh,H(3:Z/1:X) var\n10,3,4,0.9,0.5\n"


@pytest.mark.parametrize("line", ["# unit: g/N", "# Units = g/N", "# unit: m/s^2/N"])
def test_a_comment_states_the_unit_of_the_values(tmp_path, line):
    found = updyn.read_frf(put(tmp_path, FRF.format(head=line + "\n")))
    factor = G if "g/N" in line else 1.0
    assert found.quantity == "accelerance"
    assert found.values[0, 0, 0] == pytest.approx((3 + 4j) * factor, rel=1e-15)
    assert found.variance[0, 0, 0] == pytest.approx(0.5 * factor**2, rel=1e-15)
    assert found.coherence[0, 0, 0] == 0.9


def test_units_of_columns(tmp_path):
    """Each column may have its own unit, in either brackets; 2.5 mm/kN are 2.5e-6 m/N."""
    text = (
        "freq [kHz];H(3:Z/1:X) re [mm/kN];H(3:Z/1:X) im (um/N);H(4:Z/1:X) abs[m/N];"
        "H(4:Z/1:X) phase_deg [deg];H(3:Z/1:X) coh [-];H(4:Z/1:X) coh\n0.25;2.5;3;2;90;0.5;1\n"
    )
    found = updyn.read_frf(put(tmp_path, text))
    assert (found.quantity, found.freq.tolist()) == ("receptance", [250.0])
    assert found.values[0, 0, 0] == pytest.approx(2.5e-6 + 3e-6j, rel=1e-14)
    assert found.values[0, 1, 0] == pytest.approx(2j, abs=1e-15)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("freq_Hz", 1.0), ("freq_kHz", 1e3), ("Frequency (Hz)", 1.0), ("f/kHz", 1e3),
     ("f [rad/s]", 0.5 / np.pi), ('"freq_mHz"', 1e-3)],
)  # fmt: skip
def test_units_of_the_frequency(tmp_path, name, factor):
    text = "# quantity: mobility\n" + FRF.format(head="").replace("freq_Hz", name)
    assert updyn.read_frf(put(tmp_path, text)).freq[0] == pytest.approx(10 * factor, rel=1e-15)


VALID = "# quantity: accelerance\n" + FRF.format(head="")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# q", "# unit: g\n# q", ":1: unit 'g'; expected a motion per force, such as 'g/N'"),
        ("# q", "# unit: dB\n# q", "unit 'dB'; expected .* decibels are a magnitude without phase"),
        ("# q", "# unit: mm/N\n# q", "'accelerance' contradicts the unit 'mm/N' of rec"),
        ("# q", "# unit: g/N\n# units: m/s^2/N\n# q", "unit is stated twice: g/N and m/s\\^2/N"),
        ("# q", "# Scale factor: 2\n# q", ":1: comment .*'scale factor' would change the numbers"),
        ("# q", "# f in Hz, freq unit: kHz\n# q", ":1: .*'freq unit' would change the numbers"),
        ("# q", "# offset = 3\n# q", ":1: .*'offset' would change the numbers"),
        ("# q", "# avarages: 12\n# q", ":1: .*unknown name 'avarages'; did you mean 'averages'"),
        (") re", ") re [g]", ":2: header: column 'H.* re .g.': unit 'g'; expected a motion per"),
        (") re", ") re [mm/N]", "'mm/N' of a receptance; the others are of an? accelerance|quantity"),
        (") coh", ") coh [g/N]", "unit 'g/N'; expected none: a coherence"),
        (") var", ") var [g/N]", "unit 'g/N'; expected the squared unit of the values"),
        ("freq_Hz", "freq_ms", "the first column is 'freq_ms'; expected 'freq_Hz'"),
        ("freq_Hz", "freq", "the first column is 'freq'; expected 'freq_Hz'"),
    ],
)  # fmt: skip
def test_units_that_are_refused(tmp_path, old, new, message):
    with pytest.raises(FormatError, match=message):
        updyn.read_frf(put(tmp_path, VALID.replace(old, new, 1)))


def test_a_phase_in_other_units_is_refused(tmp_path):
    text = "# quantity: mobility\nfreq_Hz,H(1:X/1:X) abs,H(1:X/1:X) phase_deg [rad]\n1,2,3\n"
    with pytest.raises(FormatError, match="unit 'rad'; expected deg"):
        updyn.read_frf(put(tmp_path, text))


def test_the_unit_of_a_comment_and_of_a_column_must_agree(tmp_path):
    text = VALID.replace(") re", ") re [g/N]")
    with pytest.raises(
        FormatError, match="'g/N' contradicts the comment, which states 'm/s\\^2/N'"
    ):
        updyn.read_frf(put(tmp_path, "# unit: m/s^2/N\n" + text))
    text = "freq_Hz,H(1:X/1:X) re [m/s/N],H(1:X/1:X) im [m/s/N]\n1,2,3\n"
    with pytest.raises(
        FormatError, match="'m/s/N' contradicts the comment, which states 'm/s\\^2/N'"
    ):
        updyn.read_frf(put(tmp_path, "# unit: m/s^2/N\n" + text))


def test_units_of_rotations(tmp_path):
    text = FRF.format(head="").replace("3:Z", "3:RZ")
    with pytest.raises(FormatError, match="the motion at 3:RZ cannot be in 'g/N'; state units in"):
        updyn.read_frf(put(tmp_path, "# unit: g/N\n" + text))
    found = updyn.read_frf(put(tmp_path, "# unit: deg/kN\n" + text))
    assert found.values[0, 0, 0] == pytest.approx((3 + 4j) * np.pi / 180e3, rel=1e-14)


def test_other_comments_are_free(tmp_path):
    head = (
        "# lab: 7\n# hammer sensitivity: 2.2 mV/N\n# source: bench, unit: 3\n# delay: 5\n# 1:10\n"
    )
    assert updyn.read_frf(put(tmp_path, head + VALID)).source == "bench, unit: 3"


# -- FRFs: real values ------------------------------------------------------------------------------
def test_real_values_have_to_be_stated(tmp_path):
    path = put(tmp_path, "# quantity: receptance\nfreq_Hz,H(1:X/1:X) re\n1,2\n3,-4\n")
    with pytest.raises(FormatError, match=r"has re; expected re and im.*real_valued=True"):
        updyn.read_frf(path)
    found = updyn.read_frf(path, real_valued=True)
    np.testing.assert_array_equal(found.values[:, 0, 0], [2.0, -4.0])
    path = put(tmp_path, "# quantity: receptance\nfreq_Hz,H(1:X/1:X) abs\n1,2\n3,4\n")
    with pytest.raises(FormatError, match="has abs; expected"):
        updyn.read_frf(path, real_valued=True)
    with pytest.raises(FormatError, match="imaginary part, which contradicts real_valued=True"):
        updyn.read_frf(put(tmp_path, VALID), real_valued=True)
    path = put(tmp_path, VALID.replace("10,3,4", "10,3,0"))
    assert updyn.read_frf(path, real_valued=True).values[0, 0, 0] == 3.0


# -- decimal commas, quotes, minus signs --------------------------------------------------------------
@pytest.mark.parametrize("separator", [";", "\t"])
def test_frfs_with_decimal_commas(tmp_path, separator):
    text = (
        "# quantity: mobility\nfreq_Hz;H(3:Z,1:X) re;H(3:Z,1:X) im\n10;1,5;-2\n20,5;-1,25e-3;4,5\n"
    )
    found = updyn.read_frf(put(tmp_path, text.replace(";", separator)))
    assert found.freq.tolist() == [10.0, 20.5]
    assert found.values[:, 0, 0].tolist() == [1.5 - 2j, -1.25e-3 + 4.5j]


RECORD = "time;hammer [N];3:Z [m/s²]\n0,000;1,5;-0,25\n0,125;2,5;0,5\n0,250;3,5;0,75\n"
VALUES = [[[1.5, 2.5, 3.5], [-0.25, 0.5, 0.75]]]


def same(found, step=0.125, units=("N", "m/s²")):
    assert found.values.tolist() == VALUES
    assert found["channel"].values.tolist() == ["hammer", "3:Z"]
    assert found["unit"].values.tolist() == list(units)
    assert found["time"].values == pytest.approx(step * np.arange(3), rel=1e-14)


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_records_with_decimal_commas(tmp_path, separator, encoding):
    """As Excel writes them in German."""
    path = put(tmp_path, RECORD.replace(";", separator).replace("\n", "\r\n"), encoding=encoding)
    same(updyn.read_records(path))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0;1,500\n1;2,500\n", "found '0;1,500'"),  # 1.5 or 1500
        ("0;1,5\n1.5;2\n", "found '0;1,5'"),
        ("0;1,234,567\n0,5;2\n", "found '0;1[.,]234[.,]567'"),
    ],
)
def test_commas_that_may_separate_thousands_are_refused(tmp_path, rows, message):
    with pytest.raises(FormatError, match=message):
        updyn.read_records(put(tmp_path, "time;hammer [N]\n" + rows))


def test_utf_16_is_refused(tmp_path):
    for name in ("utf-16", "utf-16-le"):
        path = put(tmp_path, RECORD, encoding=name)
        with pytest.raises(FormatError, match="not a text in UTF-8"):
            updyn.read_records(path)
        with pytest.raises(FormatError):
            updyn.read_frf(path)


def test_quoted_cells_and_typographic_minus_signs(tmp_path):
    text = RECORD.replace(",", ".").replace(";", '";"').replace("\n", '"\n"')[:-1]
    same(updyn.read_records(put(tmp_path, '"' + text)))
    same(updyn.read_records(put(tmp_path, RECORD.replace("-", "\u2212"))))
    text = VALID.replace("10,3,4", '"10","\u22123",4')
    assert updyn.read_frf(put(tmp_path, text)).values[0, 0, 0] == -3 + 4j
    with pytest.raises(FormatError, match="found '0,\"1,5\"'"):
        updyn.read_records(put(tmp_path, 'time,a\n0,"1,5"\n1,2\n'))


# -- records: units -----------------------------------------------------------------------------------
POINTS = RECORD.replace(",", ".").replace(";", ",")


@pytest.mark.parametrize(
    ("name", "step"),
    [("time", 0.125), ("Time (s)", 0.125), ("time [ms]", 1.25e-4), ("time (ms)", 1.25e-4),
     ("t/ms", 1.25e-4), ("TIME_us", 1.25e-7), ("t [s]", 0.125), ('"Zeit [ms]"', 1.25e-4),
     ("time [min]", 7.5), ("time []", 0.125)],
)  # fmt: skip
def test_units_of_times(tmp_path, name, step):
    same(updyn.read_records(put(tmp_path, POINTS.replace("time", name))), step)


def test_the_unit_of_a_named_column_of_times(tmp_path):
    for name, given in (("clock [ms]", "clock"), ("clock [ms]", "clock [ms]"), ("t/ms", "t/ms")):
        path = put(tmp_path, POINTS.replace("time", name))
        same(updyn.read_records(path, time=given), 1.25e-4)


def test_units_in_round_brackets_and_in_a_line_of_their_own(tmp_path):
    text = POINTS.replace("[", "(").replace("]", ")")
    same(updyn.read_records(put(tmp_path, text)))
    text = POINTS.replace("time,hammer [N],3:Z [m/s²]", "time,hammer,3:Z\n ms,[N],(m/s²)")
    same(updyn.read_records(put(tmp_path, text)), 1.25e-4)
    names = POINTS.replace("hammer [N]", "Force (Trigger)").replace("3:Z [m/s²]", "a (mV)")
    found = updyn.read_records(put(tmp_path, names))
    assert found["channel"].values.tolist() == ["Force (Trigger)", "a (mV)"]
    assert found["unit"].values.tolist() == ["", ""]


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (POINTS.replace("time", "time [samples]"), {}, ":1: .*unit 'samples'; .*'s'"),
        (POINTS.replace("time", "time [mV]"), {}, ":1: .* unit 'mV'"),
        (POINTS.replace("time", "a [ms]").replace("hammer [N]", "b [s]"), {}, "'a' and 'b'"),
        (POINTS.replace("time", "t/ms"), {"rate": 8.0}, "rate and a column 't/ms' of times"),
        ("# unit: g\n" + POINTS, {}, ":1: .*'unit' would change .*in the header"),
        ("# time_unit: ms\n" + POINTS, {}, ":1: .*'time unit' would change the numbers"),
        (POINTS.replace("\n", "\ns,N,V\n", 1), {}, ":2: found 's,N,V'; expected 3 numbers"),
        (POINTS.replace("\n", "\ns,N,g\n", 1), {}, ":2: .*unit 'g', in the header 'm/s²'"),
        ("time [s],a\nms,g\n0,1\n1,2\n", {}, ":2: .*unit 'ms', in the header 's'"),
        ("t/ms,a\n0,1\n1,2\n3,4\n", {}, "0.001 to 0.002 s apart"),
    ],
)
def test_units_of_records_that_are_refused(tmp_path, text, options, message):
    with pytest.raises((FormatError, OptionError), match=message):
        updyn.read_records(put(tmp_path, text), **options)


# -- records: times of few digits ---------------------------------------------------------------------
@pytest.mark.parametrize(
    "form", ["{:.6f}", "{:g}", "{:.7g}", "{:.6e}", "{!r}"], ids=["fixed", "g", "7g", "e", "repr"]
)
@pytest.mark.parametrize("start", [0.0, 0.4117])
def test_times_at_3_khz_as_they_are_printed(tmp_path, form, start):
    times = start + np.arange(3000) / 3000
    printed = [form.format(round(t, 6) if form == "{!r}" else t) for t in times.tolist()]
    text = "time,a\n" + "".join(f"{t},1\n" for t in printed)
    found = updyn.read_records(put(tmp_path, text))
    assert found["time"].values[1] == pytest.approx(1 / 3000, rel=1e-5)


@pytest.mark.parametrize(
    "times",
    [
        ["0.000", "0.010", "0.022", "0.030"],  # by more than a rounding
        ["0.0000", "0.0100", "0.0210", "0.0300"],  # by ten roundings
        ["0.00", "0.01", "0.01", "0.02"],  # twice the same
        ["0.0", "0.3", "0.7", "1.0"],  # rounded to a third of the step
    ],
)
def test_times_that_are_not_even(tmp_path, times):
    path = put(tmp_path, "time,a\n" + "".join(f"{t},1\n" for t in times))
    with pytest.raises(FormatError, match="expected ascending times in even steps"):
        updyn.read_records(path)


def test_records_that_start_at_different_times(tmp_path):
    rows = [
        f"{start + k / 3000:.6f},{number},1\n"
        for number, start in ((1, 0.0), (2, 5.12345678))
        for k in range(500)
    ]
    found = updyn.read_records(put(tmp_path, "time,record,a\n" + "".join(rows)))
    assert found.shape == (2, 1, 500)


# -- many columns -------------------------------------------------------------------------------------
def test_tables_of_20000_columns_take_seconds(tmp_path):
    pairs = [f"{i + 1}:Z/1:X" for i in range(10_000)]
    names = ",".join(f"H({pair}) {kind}" for pair in pairs for kind in ("re", "im"))
    row = ",".join(["1.5"] * 20_000)
    frf = put(tmp_path, f"# quantity: mobility\nfreq_Hz,{names}\n1,{row}\n2,{row}\n", "f.csv")
    head = ",".join(f"c{i}" for i in range(20_000))
    records = put(tmp_path, f"time,{head}\n0,{row}\n1,{row}\n", "r.csv")
    begin = time.perf_counter()
    assert updyn.read_frf(frf).values.shape == (2, 10_000, 1)
    assert updyn.read_records(records).shape == (1, 20_000, 2)
    assert time.perf_counter() - begin < 30.0


def test_pairs_that_are_missing_are_told_before_memory_is_asked_for(tmp_path):
    n = 10_000
    names = ",".join(f"H({i}:Z/{i}:X) {kind}" for i in range(1, n + 1) for kind in ("re", "im"))
    row = ",".join(["1.5"] * 2 * n)
    path = put(tmp_path, f"# quantity: mobility\nfreq_Hz,{names}\n" + f"1,{row}\n")
    with pytest.raises(FormatError, match=re.escape("H(1:Z/2:X) has no column")):
        updyn.read_frf(path)


# -- tables of nodes ----------------------------------------------------------------------------------
def test_a_unit_in_a_comment_of_a_table_of_nodes_is_refused(tmp_path):
    path = put(tmp_path, "# unit: mm\nnode,x,y,z\n1,0,0,250\n")
    with pytest.raises(FormatError, match=r":1: .*'unit' would change the numbers .*when reading"):
        updyn.read_geometry(path)
