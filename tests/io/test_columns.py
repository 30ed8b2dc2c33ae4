"""FRFs in tables of any layout, by columns that the user selects."""

import json

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain
from updyn.errors import FormatError, OptionError
from updyn.job import load_job
from updyn.job.prepare import read_measurement

LINES = np.array([1.0, 2.5, 4.0])
A = np.array([1 + 2j, -0.5 + 0.25j, 3e-3 - 4e-3j])
B = np.array([2 - 1j, 0.125 + 8j, -1.5 - 2e-5j])
G = 9.80665
PAIRS = [("3:Z", "1:-Z", A), ("5:X", "1:-Z", B)]


def put(tmp_path, rows, name="case.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_text("\n".join(rows) + "\n", encoding=encoding)
    return path


def lines_of(separator, *columns):
    """Return a row of text for each line."""
    columns = [c if isinstance(c[0], str) else [repr(float(x)) for x in c] for c in columns]
    return [separator.join(row) for row in zip(*columns, strict=True)]


def channels(*parts):
    """Return the channels, of the parts of each."""
    return [
        {"response": i, "reference": j, **part}
        for (i, j, _), part in zip(PAIRS, parts, strict=False)
    ]


def check(frf, quantity="mobility", coherence=None):
    """Check an FRF by value."""
    assert frf.quantity == quantity
    assert frf.references.labels == ["1:-Z"]
    assert frf.responses.labels == [i for i, _, _ in PAIRS][: len(frf.responses)]
    np.testing.assert_allclose(frf.freq, LINES, rtol=1e-14)
    for k, (_, _, values) in enumerate(PAIRS[: len(frf.responses)]):
        np.testing.assert_allclose(frf.values[:, k, 0], values, rtol=1e-13)
    if coherence is not None:
        assert frf.coherence is not None
        np.testing.assert_array_equal(frf.coherence[:, 0, 0], coherence)


def texts(values, sign="i"):
    return [f"{z.real!r}{z.imag:+.17g}{sign}" for z in values.tolist()]


def db(values):
    return 20.0 * np.log10(np.abs(values))


def deg(values):
    return np.angle(values, deg=True)


COH = [0.5, 0.75, 1.0]
RE_IM = channels({"real": 2, "imaginary": 3})
#: Layouts by name: lines, file, columns, quantity of the file.
LAYOUTS = {
    "names below a preamble": (
        [
            "Analyser 3.1",
            "Date, 12/05/2024",
            "",
            "Freq (Hz),Real,Imag,Coherence,Flag",
            *lines_of(",", LINES, A.real, A.imag, COH, ["ok", "", "low"]),
        ],
        "a.csv",
        {
            "frequency": "Freq (Hz)",
            "channels": channels({"real": "Real", "imaginary": "Imag", "coherence": "Coherence"}),
        },
    ),
    "blanks without a header": (
        lines_of("  ", LINES, A.real, A.imag, B.real, B.imag),
        "a.dat",
        {
            "frequency": 1,
            "channels": channels({"real": 2, "imaginary": 3}, {"real": 4, "imaginary": 5}),
        },
    ),
    "a header of numpy": (
        ["# f re im", *lines_of(" ", LINES, A.real, A.imag)],
        "a.txt",
        {"frequency": "f", "channels": channels({"real": "re", "imaginary": "im"})},
    ),
    "decimal commas, a line of units": (
        [
            "Frequenz;Betrag;Phase",
            "kHz;dB;°",
            *(x.replace(".", ",") for x in lines_of(";", LINES / 1e3, db(A), deg(A))),
        ],
        "a.txt",
        {
            "frequency": "Frequenz",
            "channels": channels({"magnitude_dB": "Betrag", "phase_deg": "Phase"}),
        },
    ),
    "magnitude and phase in radians": (
        ["omega [rad/s],|H|,arg", *lines_of(",", LINES * 2 * np.pi, np.abs(A), np.angle(A))],
        "a.csv",
        {
            "frequency": "omega [rad/s]",
            "channels": channels({"magnitude": 2, "phase_rad": 3}),
        },
    ),
    "complex numbers of MATLAB": (
        ["% f\tH1\tH2", *lines_of("\t", LINES, texts(A), texts(B))],
        "a.asc",
        {"frequency": 1, "channels": channels({"complex": "H1"}, {"complex": "H2"})},
    ),
    "complex numbers of Python": (
        lines_of(",", [f"({z})" for z in texts(A, "j")], LINES),
        "a.csv",
        {"frequency": 2, "channels": channels({"complex": 1})},
    ),
    "a unit in the header": (
        ["rpm,re [mm/s/N],im [mm/s/N]", *lines_of(",", LINES * 60, A.real * 1e3, A.imag * 1e3)],
        "a.csv",
        {"frequency": "rpm", "frequency_unit": "rpm", "channels": RE_IM},
    ),
    "decibels and degrees to a stated unit": (
        ["f,dB,deg", *lines_of(",", LINES, db(A / 0.0254), deg(A))],
        "a.csv",
        {
            "frequency": "f",
            "unit": "ips/N",
            "channels": channels({"magnitude_dB": 2, "phase_deg": 3}),
        },
    ),
    "quoted names and separators at the end": (
        [
            "sep=;",
            '"Freq";"Re; 3:Z";Im 3:Z',
            *(f"{x};" for x in lines_of(";", LINES, A.real, A.imag)),
        ],
        "a.csv",
        {"frequency": "Freq", "channels": channels({"real": "Re; 3:Z", "imaginary": "Im 3:Z"})},
    ),
    "revolutions per minute": (
        ["rpm,Re,Im,", *lines_of(",", LINES * 60.0, A.real, A.imag)],
        "a.csv",
        {"frequency": "rpm", "channels": RE_IM},
    ),
    "decimal commas next to dates, two rows of names": (
        [
            "Datum;f;Re;Im",
            ";Hz;;",
            *(f"12.05.2024;{x.replace('.', ',')}" for x in lines_of(";", LINES, A.real, A.imag)),
        ],
        "a.csv",
        {"frequency": "f", "channels": channels({"real": "Re", "imaginary": "Im"})},
    ),
    "a header of numbers": (
        ["f,1,2", *lines_of(",", LINES, A.real, A.imag)],
        "a.csv",
        {"frequency": "f", "channels": channels({"real": "1", "imaginary": "2"})},
    ),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_by_value(tmp_path, name):
    rows, file, columns = LAYOUTS[name]
    frf = updyn.read_frf(put(tmp_path, rows, file), quantity="mobility", columns=columns)
    check(frf, coherence=COH if "coherence" in columns["channels"][0] else None)


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def job_of(tmp_path, file, columns):
    path = tmp_path / "job.toml"
    path.write_text(
        f'[model]\nfile = "none.h5"\n[test]\nfile = "{file}"\nquantity = "mobility"\n'
        f"columns = {toml(columns)}\n"
        '[[parameter]]\ngroups = "*"\nquantity = "mass"\n',
        encoding="utf-8",
    )
    return load_job(path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_by_a_job(tmp_path, name):
    rows, file, columns = LAYOUTS[name]
    put(tmp_path, rows, file)
    check(read_measurement(job_of(tmp_path, file, columns)))


def test_windows_text_and_a_unit_of_gravity(tmp_path):
    rows = ["f [Hz];Übertragung Re;Übertragung Im", *lines_of(";", LINES, A.real / G, A.imag / G)]
    path = put(tmp_path, rows, encoding="cp1252")
    columns = {"frequency": "f [Hz]", "channels": [{**RE_IM[0], "unit": "g/N"}]}
    check(updyn.read_frf(path, columns=columns), "accelerance")


def test_comments_of_the_format_are_read(tmp_path):
    rows = [
        "# quantity: mobility",
        "# averages: 7",
        "f,re,im",
        *lines_of(",", LINES, A.real, A.imag),
    ]
    frf = updyn.read_frf(put(tmp_path, rows), columns={"frequency": "f", "channels": RE_IM})
    check(frf)
    assert frf.averages == 7


def test_selection_and_signs(tmp_path):
    rows, file, columns = LAYOUTS["blanks without a header"]
    path = put(tmp_path, rows, file)
    frf = updyn.read_frf(path, quantity="mobility", columns=columns, responses=["5:-X"])
    np.testing.assert_array_equal(frf.values[:, 0, 0], -B)


F3 = ["f,re,im"]
GOOD = lines_of(",", LINES, A.real, A.imag)
BY_NAME = {"frequency": "f", "channels": channels({"real": "re", "imaginary": "im"})}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([*F3, GOOD[0], "2.5,1", GOOD[2]], r"csv:3: 2 cell\(s\); expected 3"),
        ([*F3, GOOD[0], "2.5,1,2,3", GOOD[2]], r"csv:3: 4 cell\(s\); expected 3"),
        ([*F3, "0.5,1", *GOOD], r"csv:2: '0.5,1' has 2 numbers in 2 cell\(s\); expected 3 cells"),
        ([*F3, "0.5x,1.5,2", *GOOD], r"csv:2: '0.5x,1.5,2' has 2 numbers"),
        ([*F3, GOOD[0], "2.5,abc,2", GOOD[2]], "csv:3: column 're': 'abc' is not a number"),
        ([*F3, GOOD[0], "2.5,1 000,2", GOOD[2]], "csv:3: column 're': '1 000' is not a number"),
        ([*F3, GOOD[0], "2.5,,2", GOOD[2]], "csv:3: column 're': '' is not a number"),
        ([*F3, "0,nan,0", *GOOD], "csv:2: column 're': 'nan' is not a number"),
        ([*F3, GOOD[0], "2.5,1,inf", GOOD[2]], "csv:3: column 'im': 'inf' is not a number"),
        ([*F3, GOOD[0], "2.5,1,1e999", GOOD[2]], "csv:3: column 'im': '1e999' is not a number"),
        ([*F3, GOOD[0], GOOD[0], *GOOD[1:]], "csv:3: 1 Hz does not exceed 1 Hz"),
        ([*F3, *GOOD[::-1]], "csv:3: 2.5 Hz does not exceed 4 Hz"),
        ([*F3, "-1,0,0", *GOOD], "-1 Hz"),
        ([*F3, *GOOD, "end of data"], r"csv:5: 1 cell\(s\); expected 3"),
        ([*F3, "hello", "world"], "no table"),
        (
            ["f;re;im", "1,234;2,345;3,456", "2,345;2,345;3,456"],
            "csv:2: column 'f': '1,234' is not a number; a comma may separate thousands here",
        ),
        (["Freq,re,im", *GOOD], r"no column 'f'; .*'Freq'.* columns: 1 'Freq' \(1\), 2 're' \(1\)"),
        (["freq,Re,im", *GOOD], "no column 'f'"),
        (GOOD, "no column 'f'; the table has no header; state numbers of columns"),
        (["f,re,re", *GOOD], "'re' occurs 2 times; state its number: 2 or 3"),
        (["# scale: 2", *F3, *GOOD], "'scale' would change the numbers .* state frequency_unit"),
        (["Y unit: g/N", *F3, *GOOD], "'y unit' would change the numbers"),
        (["Unit;g/N", *F3, *GOOD], "'unit' would change the numbers"),
    ],
)
def test_hostile_tables(tmp_path, rows, message):
    path = put(tmp_path, rows)
    with pytest.raises(FormatError, match=message):
        updyn.read_frf(path, quantity="mobility", columns=BY_NAME)


@pytest.mark.parametrize(
    ("header", "part", "message"),
    [
        ("f,Mag (dB),Phase (deg)", {"magnitude": 2, "phase_deg": 3}, "expected magnitude_dB"),
        ("f,FRF Mag dB,Phase", {"magnitude": 2, "phase_deg": 3}, "expected magnitude_dB"),
        ("f,Mag_dB,Phase", {"magnitude": 2, "phase_deg": 3}, "expected magnitude_dB"),
        ("f,Mag,Phase (deg)", {"magnitude": 2, "phase_rad": 3}, "expected phase_deg"),
        ("f,Mag,Phase [rad]", {"magnitude": 2, "phase_deg": 3}, "expected phase_rad"),
        ("f,Mag (dB) 3:Z,Phase", {"magnitude": 2, "phase_deg": 3}, "expected magnitude_dB"),
        ("f,Mag,Phase [turns]", {"magnitude": 2, "phase_deg": 3}, "expected a phase in deg or rad"),
        ("f,Mag,Phase (mrad)", {"magnitude": 2, "phase_rad": 3}, "expected a phase in deg or rad"),
        (
            "f,re [m/s^2],im",
            {"real": 2, "imaginary": 3},
            "not a known motion per force; state unit",
        ),
        ("f,re [m/V],im", {"real": 2, "imaginary": 3}, "not a known motion per force; state unit"),
        ("f,re [V],im", {"real": 2, "imaginary": 3}, "in 'V', which is not a known motion per f"),
        ("f,re [g/N],im [m/N]", {"real": 2, "imaginary": 3}, "parts in 'g/N' and 'm/N'"),
        ("f,re [g/N],im [g/N]", {"real": 2, "imaginary": 3, "unit": "m/N"}, "contradicts the file"),
        ("f,re [m/N],im [m/N]", {"real": 2, "imaginary": 3}, "quantity 'mobility' contradicts"),
        ("f,re [rad/N],im [rad/N]", {"real": 2, "imaginary": 3}, "cannot be in 'rad/N'"),
        ("f,re,im", {"real": 2}, "real numbers, which may be magnitudes"),
        ("f,re,im", {"real": 2, "imaginary": 9}, "no column 9; the table has 3"),
        ("f,re,im", {"real": 2, "imaginary": 0}, "no column 0; the table has 3"),
    ],
)
def test_contradictions_with_the_file(tmp_path, header, part, message):
    path = put(tmp_path, [header, *GOOD])
    with pytest.raises(FormatError, match=message):
        updyn.read_frf(
            path, quantity="mobility", columns={"frequency": 1, "channels": channels(part)}
        )


ONE = RE_IM[0]


@pytest.mark.parametrize(
    ("columns", "message", "key"),
    [
        ({}, "columns = {}: expected a table", ("columns",)),
        ({"frequency": 1}, "missing key 'channels'", ("columns",)),
        ({"channels": RE_IM}, "missing key 'frequency'", ("columns",)),
        ({"freq": 1, "channels": RE_IM}, "no key 'freq'; did you mean 'frequency'", ("columns",)),
        (
            {"frequency": 1, "channels": []},
            "expected an array of channels",
            ("columns", "channels"),
        ),
        (
            {"frequency": 1, "channels": [{**ONE, "imag": 3}]},
            r"channels\[1\]: no key 'imag'; did you mean 'imaginary'",
            ("columns", "channels", 0),
        ),
        (
            {"frequency": 1, "channels": [{"response": "3:Z", "real": 2, "imaginary": 3}]},
            r"channels\[1\]: missing key 'reference'",
            ("columns", "channels", 0),
        ),
        (
            {"frequency": 1, "channels": [{**ONE, "magnitude": 2}]},
            r"found real \+ imaginary \+ magnitude; expected one of complex, real",
            ("columns", "channels", 0),
        ),
        (
            {"frequency": 1, "channels": [{**ONE, "real": 3}]},
            "real and imaginary are the same: 3",
            ("columns", "channels", 0),
        ),
        (
            {"frequency": 1, "channels": [{**ONE, "response": "?"}]},
            r"channels\[1\].response: ",
            ("columns", "channels", 0, "response"),
        ),
        (
            {"frequency": 1, "channels": [ONE, ONE]},
            r"channels\[2\]: H\(3:Z/1:-Z\) occurs twice",
            ("columns", "channels", 1),
        ),
        (
            {"frequency": 1, "channels": [ONE, {**ONE, "response": "4:Z", "reference": "2:Z"}]},
            r"no channel for H\(3:Z/2:Z\)",
            ("columns", "channels"),
        ),
        (
            {"frequency": 1, "channels": [ONE, {**ONE, "response": "4:Z", "coherence": 2}]},
            "some channels have a coherence",
            ("columns", "channels"),
        ),
        (
            {"frequency": 1, "channels": [{**ONE, "real": 2.0}]},
            "real = 2.0: expected the name or the number",
            ("columns", "channels", 0, "real"),
        ),
        (
            {"frequency": 1, "frequency_unit": "furlong", "channels": RE_IM},
            "frequency_unit = 'furlong'",
            ("columns", "frequency_unit"),
        ),
    ],
)
def test_mappings_that_are_not_valid(tmp_path, columns, message, key):
    path = put(tmp_path, [*F3, *GOOD])
    with pytest.raises(OptionError, match=message) as caught:
        updyn.read_frf(path, quantity="mobility", columns=columns)
    assert caught.value.key == key


@pytest.mark.parametrize(
    "name",
    ["Re mm/s/N", "Re_mm/s/N", "Re (mm/s/N) 3:Z", "Re (mm/s/N) [3:Z/1:Z]", "Re mm/s/N (3:Z/1:Z)"],
)
def test_units_anywhere_in_the_names(tmp_path, name):
    other = name.replace("Re", "Im")
    path = put(tmp_path, [f"f;{name};{other}", *lines_of(";", LINES, A.real * 1e3, A.imag * 1e3)])
    columns = {"frequency": 1, "channels": RE_IM}
    check(updyn.read_frf(path, quantity="mobility", columns=columns))


@pytest.mark.parametrize(
    ("name", "title"), [(1, "Omega"), ("Omega", "Omega"), (1, "Angular frequency")]
)
def test_the_unit_of_an_angular_frequency_has_to_be_stated(tmp_path, name, title):
    path = put(tmp_path, [f"{title},re,im", *lines_of(",", LINES * 2 * np.pi, A.real, A.imag)])
    columns = {"frequency": name, "channels": RE_IM}
    with pytest.raises(OptionError, match="may be in rad/s or in Hz; state frequency_unit"):
        updyn.read_frf(path, quantity="mobility", columns=columns)
    columns["frequency_unit"] = "rad/s"
    check(updyn.read_frf(path, quantity="mobility", columns=columns))


def test_the_quantity_has_to_be_stated(tmp_path):
    path = put(tmp_path, [*F3, *GOOD])
    with pytest.raises(FormatError, match="states no quantity; state quantity"):
        updyn.read_frf(path, columns=BY_NAME)


PROPOSALS = {
    "Freq (Hz),Real 3:Z/1:Z,Imag 3:Z/1:Z,Coh 3:Z/1:Z": (
        'frequency = "Freq (Hz)"',
        'response = "3:Z", reference = "1:Z", real = "Real 3:Z/1:Z", imaginary = "Imag 3:Z/1:Z",'
        ' coherence = "Coh 3:Z/1:Z"',
    ),
    "f,Mag [dB],Phase (rad),other": (
        'frequency = "f"',
        'response = "?", reference = "?", magnitude_dB = "Mag [dB]", phase_rad = "Phase (rad)"',
    ),
    "Hz,abs,phase_deg,coherence": (
        'frequency = "Hz"',
        'magnitude = "abs", phase_deg = "phase_deg", coherence = "coherence"',
    ),
    "freq_Hz,H11_re,H11_im,x": ('frequency = "freq_Hz"', 'real = "H11_re", imaginary = "H11_im"'),
    "node 1,node 2,a,b": (),
    "s,a,b,c": ("frequency = 1", 'response = "?", reference = "?", real = 2, imaginary = 3'),
}


@pytest.mark.parametrize("header", PROPOSALS)
def test_a_table_that_is_refused_shows_its_columns_and_a_proposal(tmp_path, header):
    path = put(tmp_path, [header, *lines_of(",", LINES, A.real, A.imag, COH)])
    with pytest.raises(FormatError) as caught:
        updyn.read_frf(path, quantity="mobility")
    expected = PROPOSALS[header]
    assert ("columns = {" in str(caught.value)) == bool(expected)
    for text in expected:
        assert text in str(caught.value)
    if expected:
        assert f"1 {header.split(',')[0]!r} (1), 2 " in str(caught.value)


@pytest.mark.parametrize("name", ["a.dat", "a.asc", "a"])
def test_a_table_of_an_unknown_suffix_gets_a_proposal(tmp_path, name):
    path = put(tmp_path, ["f [Hz] Re Im", *lines_of(" ", LINES, A.real, A.imag)], name)
    with pytest.raises(FormatError, match="for a table in text state columns"):
        updyn.read_frf(path)
    path = put(tmp_path, ["f  Re  Im", *lines_of(" ", LINES, A.real, A.imag)], name)
    with pytest.raises(FormatError, match=r'columns = { frequency = "f"'):
        updyn.read_frf(path)


@pytest.mark.parametrize("name", ["none.dat", "none.csv"])
def test_a_missing_file(tmp_path, name):
    for columns in (None, BY_NAME):
        with pytest.raises(FormatError, match="no such file"):
            updyn.read_frf(tmp_path / name, columns=columns)


def test_the_proposal_can_be_pasted_into_a_job(tmp_path):
    rows = ["f;3:Z/1:-Z re;3:Z/1:-Z im;5:X/1:-Z re;5:X/1:-Z im"]
    put(tmp_path, [*rows, *lines_of(";", LINES, A.real, A.imag, B.real, B.imag)], "a.txt")
    with pytest.raises(FormatError) as caught:
        updyn.read_frf(tmp_path / "a.txt")
    proposal = "columns" + str(caught.value).split("\ncolumns", 1)[1]
    path = tmp_path / "job.toml"
    path.write_text(
        f'[model]\nfile = "none.h5"\n[test]\nfile = "a.txt"\nquantity = "mobility"\n{proposal}\n'
        '[[parameter]]\ngroups = "*"\nquantity = "mass"\n'
    )
    check(read_measurement(load_job(path)))


def test_the_command_line_from_a_refused_table_to_the_check_of_a_job(tmp_path, capsys):
    """The figures of agreement are those with the universal file of the demo."""
    job = chain.write_inputs(tmp_path)
    frf = updyn.read_frf(tmp_path / "chain.uff")
    names, columns = ["Freq (Hz)"], [frf.freq]
    for j, reference in enumerate(frf.references):
        for i, response in enumerate(frf.responses):
            names += [f"{response}/{reference} Mag (dB)", f"{response}/{reference} Phase (deg)"]
            columns += [db(frf.values[:, i, j]), deg(frf.values[:, i, j])]
    put(tmp_path, ["Test 4", ";".join(names), *lines_of(";", *columns)], "chain.txt")
    assert main(["check", str(job)]) == 0
    expected = capsys.readouterr().out
    assert main(["info", str(tmp_path / "chain.txt")]) == 2
    proposal = "columns" + capsys.readouterr().err.split("\ncolumns", 1)[1]
    text = job.read_text().replace(
        'file = "chain.uff"', f'file = "chain.txt"\nquantity = "accelerance"\n{proposal}'
    )
    job.write_text(text)
    assert main(["check", str(job)]) == 0
    assert capsys.readouterr().out == expected
    job.write_text(text.replace("2:X/12:X Mag", "2:X/12:X Mug"))
    assert main(["check", str(job)]) == 2
    error = capsys.readouterr().err
    assert "chain.txt: no column '2:X/12:X Mug (dB)'; did you mean '2:X/12:X Mag (dB)'" in error
    assert f"{job}:" in error


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({"first_row": 2}, [4 + 5j, 6 + 7j]),
        ({"first_row": 2, "separator": ","}, [4 + 5j, 6 + 7j]),
        ({}, [2 + 3j, 4 + 5j, 6 + 7j]),
    ],
)
def test_separator_and_first_row_are_stated_for_names_that_are_numbers(tmp_path, stated, expected):
    path = put(tmp_path, ["0,2,3", "1,4,5", "2,6,7"])
    channel = {"response": "1:X", "reference": "1:X", "real": 2, "imaginary": 3}
    mapping = {"frequency": 1, **stated, "channels": [channel]}
    frf = updyn.read_frf(path, quantity="mobility", columns=mapping)
    np.testing.assert_array_equal(frf.values[:, 0, 0], expected)


@pytest.mark.parametrize(
    ("stated", "key", "message"),
    [
        ({"separator": "tab"}, "separator", "expected ';', a tab, ',' or a blank"),
        ({"separator": ";"}, "separator", "no table by columns.separator"),
        ({"first_row": 0}, "first_row", "expected the number of a line"),
        ({"first_row": True}, "first_row", "expected the number of a line"),
        ({"first_row": 3}, "first_row", "no table by columns.first_row"),
        ({"first_row": 4}, "first_row", "no table by columns.first_row"),
    ],
)
def test_a_wrong_separator_or_first_row_is_refused(tmp_path, stated, key, message):
    rows = ["0,2,3", "1,4,5", "2,6,7"]
    if stated == {"first_row": 4}:
        rows += ["end", "3,8,9", "4,8,9"]
    path = put(tmp_path, rows)
    channel = {"response": "1:X", "reference": "1:X", "real": 2, "imaginary": 3}
    with pytest.raises((FormatError, OptionError), match=message) as caught:
        updyn.read_frf(path, columns={"frequency": 1, **stated, "channels": [channel]})
    assert caught.value.key == ("columns", key)
