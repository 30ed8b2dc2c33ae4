"""Every malformed file raises an error of updyn that names the file and says what is wrong; never anything else."""

import sys

import numpy as np
import pytest

import uff_samples as uff
import updyn
from places import DATA
from updyn.errors import UpdynError, UpdynWarning

BAD = DATA / "bad"
sys.path.insert(0, str(BAD))

from make_bad_frf import files  # noqa: E402

#: A part of the message, with the line (":11: ...") where the file has one to name.
EXPECTED = {
    "abs_negative.csv": "H(1:Z/1:Z) abs is -1; expected 0 or above",
    "abscissa_decreases.uff": (
        ":2: dataset 58: the abscissa does not increase from point 2 (3) to 3 (2)"
    ),
    "abscissa_increment_zero.uff": ":9: record 7: abscissa starts at 1 with steps of 0",
    "abscissa_negative.uff": "the first line is -1 Hz; expected 0 or above",
    "abscissa_repeats.uff": "does not increase from point 2 (2) to 3 (2)",
    "abscissa_rpm.uff": (
        ":10: record 8: the abscissa is rotational speed in 'rpm'; expected frequency in Hz"
    ),
    "abscissa_time.uff": ":10: record 8: the abscissa is time in 's'; expected frequency in Hz",
    "abscissa_unit_unknown.uff": (
        ":10: record 8: the abscissa is frequency in 'order'; expected frequency in Hz"
    ),
    "averages_garbled.csv": "averages: 'many'; expected a whole number",
    "binary_cut_in_header.uff": "58b: the file ends within the dataset, before its data",
    "binary_cut_short.uff": "truncated: record 7 requires 64 bytes of data, 31 remain",
    "binary_head_missing.uff": (
        ":2: 58b: expected byte order, floating-point format, lines of text and bytes"
    ),
    "binary_rubbish.uff": ":1: expected '    -1', the start of a dataset",
    "binary_through_text_mode.uff": (
        "a wrong count of points or bytes, or a file changed by a text-mode transfer"
    ),
    "blank.uff": (
        "holds no frequency response function (dataset 58, function type 4); it holds nothing"
    ),
    "both_senses.csv": ":2: header: DOF 1:Z occurs twice",
    "byte_count_wrong.uff": (
        ":2: 58b: the first line declares 56 bytes of data, but the file has 64, as required by record 7"
    ),
    "byte_order_of_data_wrong.uff": (
        ":2: 58b: magnitudes from 9.49e-322 to 3.24e+292 in the byte order stated in the first line"
        ", and from 1e-06 to 3e+04 in the other"
    ),
    "byte_order_wrong.uff": "byte order 7; expected 1 (little-endian) or 2 (big-endian)",
    "cell_empty.csv": ":4: column 2: '' is not a number",
    "cell_missing.csv": ":4: 2 cell(s); expected 3",
    "cell_nan.csv": ":4: column 3: 'nan' is not a number",
    "cell_text.csv": ":4: column 3: 'four' is not a number",
    "coherence_above_1.csv": (
        "coherence at 10 Hz, response 1:Z, reference 1:Z is 1.5; expected 0 to 1"
    ),
    "coherence_above_1.uff": (
        ":18: coherence at response 1:Z, reference 1:Z is 1.2; expected 0 to 1"
    ),
    "coherence_complex.uff": ":18: coherence at response 1:Z, reference 1:Z has an imaginary part",
    "coherence_partial.csv": ":2: header: H(1:Z/1:Z) has no column 'coh', others have",
    "column_dof.csv": ":2: header: column 'H(1:W/1:Z) im': DOF '1:W': expected node:direction",
    "column_im_missing.csv": (
        ":2: header: H(1:Z/1:Z) has re; expected re and im, or abs and phase_deg"
    ),
    "column_kind.csv": "column 'H(1:Z/1:Z) imag' is of kind 'imag'; did you mean 'im'?",
    "column_kinds_mixed.csv": "H(1:Z/1:Z) has re and phase_deg; expected",
    "column_name.csv": "column 'H11 im'; expected a name such as 'H(3:Z/1:X) re'",
    "column_twice.csv": "column 'H(1:Z/1:Z) re' occurs twice",
    "columns_none.csv": ":2: header: no column after 'freq_Hz'",
    "comments_only.csv": "no header: expected a line that starts with 'freq_Hz'",
    "decimal_comma.csv": ":4: column 2: '3,5' is not a number: a decimal comma",
    "decimal_comma_in_comma_table.csv": ":4: 6 cell(s); expected 3; decimals have a point",
    "delimiter_missing.uff": ":17: expected '    -1', the start of a dataset, found '58'",
    "delimiter_superfluous.uff": ":18: expected the number of a dataset, found '-1'",
    "direction_0.uff": ":8: record 6: response direction 0 (scalar) at node 17 defines no direction",
    "direction_9.uff": ":8: record 6: response direction 9; expected -6 to 6",
    "direction_garbled.uff": (
        ":8: record 6, response direction: expected a whole number in columns 52 to 55"
    ),
    "duplicate_pair.uff": (
        ":18: frequency response function at response 4:-X, reference 1:Z occurs twice: also on"
    ),
    "empty.csv": "the file is empty",
    "empty.uff": "the file is empty",
    "first_column.csv": ":2: header: the first column is 'frequency'; expected 'freq_Hz'",
    "floating_format_vax.uff": "floating-point format 1; expected 2 (IEEE 754)",
    "force_over_motion.uff": ":11: quantity 'apparent mass' is a force over a motion",
    "header_cut_short.uff": ":2: dataset 58: 7 line(s); expected 11 of text before the data",
    "inf_abscissa.uff": "the abscissa of point 4 is not finite",
    "latin1.csv": "not a text in UTF-8 (invalid start byte at byte 4)",
    "latin1_title_cut.uff": "dataset 58, started on line 1, has no closing '    -1'",
    "lines_decrease.csv": ":4: 5 Hz does not exceed 10 Hz; lines must increase",
    "lines_differ.uff": (
        ":18: frequency response function at response 2:Z, reference 1:Z has 4 lines from 1 to"
        " 1.75 Hz"
    ),
    "lines_differ_in_number.uff": (
        "has 3 lines from 1 to 2 Hz, the first FRF has 4 from 1 to 2.5 Hz"
    ),
    "magnitude_only.uff": ":2: holds real ordinates, which may be magnitudes or decibels",
    "matrix_incomplete.uff": "1 of 4 pairs of response / reference are missing: 2:Z / 2:Z",
    "motion_over_motion.uff": ":11: records 9 and 10 state acceleration over acceleration",
    "nan_binary.uff": "the ordinate of point 3 is not finite",
    "nan_text.uff": "data: expected a number, found 'NaN'",
    "no_functions.uff": "it holds a geometry of 3 nodes (see updyn.io.read_geometry)",
    "no_lines.csv": "holds a header but no line of numbers",
    "no_quantity.csv": "expected a line '# quantity: accelerance'",
    "node_garbled.uff": (
        ":8: record 6, response node: expected a whole number in columns 42 to 51, found '7x77'"
    ),
    "node_not_in_geometry.uff": (
        ":14: record 6: response 3:X: geometry: node 3 has no position; nearest: 2, 1, 30"
    ),
    "node_position_garbled.uff": ":3: dataset 15, position: expected a number, found '5.x0000E-01'",
    "node_twice.uff": ":4: node 1 is defined twice: also on line 3",
    "not_closed.uff": "dataset 58, started on line 1, has no closing '    -1'; the file is truncated",
    "number_garbled.uff": ":14: data: expected a number, found '7.0O000E+00'",
    "number_missing.uff": ":2: expected the number of a dataset, found 'abc'",
    "oblique.uff": (
        ":25: record 6: response 2:X is oblique: its displacement system turns it to (0.8, 0.6, 0)"
    ),
    "ordinate_type_wrong.uff": ":9: record 7: ordinate data type 7; expected 2 or 4 (real), 5 or 6",
    "other_functions.uff": "it holds 1 time response",
    "pair_missing.csv": "header: H(1:Z/3:Z) has no column; expected re and im",
    "points_absurd_binary.uff": "record 7 requires 15999999984 bytes of data, 71 remain",
    "points_none.uff": ":9: record 7: 0 points; expected at least 1",
    "points_too_few.uff": "record 7 (points, type, spacing) requires 6 numbers, found 8",
    "points_too_few_binary.uff": (
        "found 64 bytes of data; record 7 (points, type, spacing) requires 48"
    ),
    "points_too_many.uff": "record 7 (points, type, spacing) requires 10 numbers, found 8",
    "quantity_inverse.csv": "quantity 'apparent mass' is a force over a motion",
    "quantity_misspelt.csv": "quantity 'acelerance': did you mean 'accelerance'",
    "quantity_mixed.uff": (
        "accelerance (dataset 58 on line 2) and mobility (line 18); expected one quantity"
    ),
    "quantity_twice.csv": "quantity is stated twice: accelerance and mobility",
    "quantity_unknown.uff": ":11: records 9 and 10 do not define the measured quantity",
    "spacing_wrong.uff": ":9: record 7: abscissa spacing 3; expected 0 (uneven) or 1 (even)",
    "strain_over_force.uff": "records 9 and 10 state strain over excitation force",
    "system_not_defined.uff": (
        ":4: node 2, displacement: coordinate system 5 is not defined in this file"
    ),
    "system_not_orthogonal.uff": ":5: system 5: its axes are not three orthogonal unit vectors",
    "text.uff": (
        ":1: expected '    -1', the start of a dataset, found 'Measured on a Monday, see the"
        " logbook.'"
    ),
    "text_cut_short.uff": "record 7 (points, type, spacing) requires 8 numbers, found 4",
    "text_lines_wrong.uff": "12 lines of text before the data; expected 11",
    "trace_line_to_nowhere.uff": ":7: dataset 82: node 4 of the trace line has no position",
    "unit_contradicts_164.uff": (
        ":17: record 9: unit 'm/s^2' contradicts dataset 164 on line 3, where the unit of acceleration"
        " is 0.001 in SI; set scale="
    ),
    "unit_of_another_kind.uff": (
        ":11: record 9: 'N' is a unit of force; expected a unit of acceleration; set scale="
    ),
    "unit_unknown.uff": ":11: record 9: unit 'EU' of the acceleration is not known; valid: 'm/s^2'",
    "units_change.uff": ":9: dataset 164 contradicts the one on line 3",
    "units_contradict.uff": (
        ":3: dataset 164: units code 1 requires factors 1 (length) and 1 (force)"
    ),
}


def test_the_files_are_those_of_the_script_and_each_is_expected():
    stored = {p.name: p.read_bytes() for p in (BAD / "frf").iterdir()}
    made = files()
    assert set(stored) == set(made) == set(EXPECTED)
    assert [name for name in made if stored[name] != made[name]] == []


@pytest.mark.parametrize("name", EXPECTED)
def test_the_message_says_what_is_wrong_and_where(name):
    path = BAD / "frf" / name
    with pytest.raises(UpdynError) as caught:
        updyn.read_frf(path)
    assert str(caught.value).startswith(f"{path}:")
    assert EXPECTED[name] in str(caught.value)


# -- what happens to a good file on its way ---------------------------------------------------------------------
Y = np.array([1.5 - 2j, -0.25 + 1e-3j, 3e4 + 7j, -1e-6 - 1j / 3])
PARTS = [
    uff.units(1, 1.0, 1.0),
    uff.systems2420((5, 0, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], (0, 0, 0))),
    uff.nodes2411((1, 0, 0, 0, 0, 0), (2, 0, 5, 1, 0, 0)),
    uff.trace82(1, 2),
    uff.ascii58(Y),
    uff.ascii58(np.array([1, 0.5, 0.25, 1.0]), kind=6, types=(18, 0, 0)),
    uff.binary58(Y, (2, 1)),
    uff.binary58(np.array([1, 0.5, 0.25, 1.0]), (2, 1), kind=6, types=(18, 0, 0)),
]
GOOD = b"".join(PARTS)
BOUNDARIES = {sum(map(len, PARTS[:k])) for k in range(len(PARTS))}


def test_the_good_file_is_good(tmp_path):
    (tmp_path / "case.uff").write_bytes(GOOD)
    assert updyn.read_frf(tmp_path / "case.uff").coherence.shape == (4, 2, 1)


@pytest.mark.parametrize("at", sorted({len(GOOD) * k // 51 for k in range(1, 51)} - BOUNDARIES))
def test_a_file_cut_anywhere_is_refused(tmp_path, at):
    path = tmp_path / "case.uff"
    path.write_bytes(GOOD[:at])
    with pytest.raises(UpdynError):
        updyn.read_frf(path)


@pytest.mark.filterwarnings("ignore::updyn.errors.UpdynWarning")
@pytest.mark.parametrize("seed", range(8))
def test_changed_bytes_raise_nothing_else(tmp_path, seed):
    path, rng = tmp_path / "case.uff", np.random.default_rng(seed)
    refused = 0
    for _ in range(60):
        data = bytearray(GOOD)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            kind = rng.integers(3)
            if kind == 0:
                data[at % len(data)] = rng.integers(256)
            elif kind == 1:
                del data[at : at + int(rng.integers(1, 30))]
            else:
                data[at:at] = bytes(rng.integers(32, 127, 3).tolist())
        path.write_bytes(bytes(data))
        try:
            updyn.read_frf(path)
        except UpdynError as error:
            refused += 1
            assert str(path) in str(error)  # noqa: PT017
    assert refused > 20


def test_left_out_functions_do_not_hide_an_error(tmp_path):
    path = tmp_path / "case.uff"
    path.write_bytes(uff.ascii58(Y.real, kind=2) + uff.ascii58(Y, types=(18, 0, 0)))
    with (
        pytest.warns(UpdynWarning, match="1 auto spectrum"),
        pytest.raises(UpdynError, match="give quantity="),
    ):
        updyn.read_frf(path)
