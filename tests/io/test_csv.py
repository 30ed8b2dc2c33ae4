"""FRFs as a table in text: round trip, the forms that are read, and what is refused (see also `test_bad_frf.py`)."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from io_samples import assert_same_frf, frf
from updyn.errors import DataError, FormatError, OptionError, UpdynWarning

HEAD = "# quantity: accelerance\nfreq_Hz,H(3:Z/1:-X) re,H(3:Z/1:-X) im\n"


def put(tmp_path, text, name="case.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("n_references", [1, 2])
def test_round_trip_is_exact(tmp_path, n_references):
    path = tmp_path / "case.csv"
    data = replace(frf(n_references, with_geometry=False), source="bench\n  run 3, Prüfstand")
    updyn.write_frf(data, path)
    assert_same_frf(updyn.read_frf(path), data)
    assert list(tmp_path.iterdir()) == [path]


def test_line_ends_of_windows_are_no_part_of_the_source(tmp_path):
    path = tmp_path / "case.csv"
    data = replace(frf(1, with_geometry=False), source="bench\nrun 3")
    updyn.write_frf(data, path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert_same_frf(updyn.read_frf(path), data)


@pytest.mark.parametrize("said", ["1_5", "nan", "2,5", "1.5 1/s"])
def test_a_decay_that_is_no_number_is_refused(tmp_path, said):
    path = put(tmp_path, f"# decay: {said}\n" + HEAD + "10,1.5,-2\n")
    with pytest.raises(FormatError, match=f"decay: '{said}'; expected a number in 1/s"):
        updyn.read_frf(path)


def test_geometry_is_left_out_with_a_warning(tmp_path):
    path = tmp_path / "case.csv"
    with pytest.warns(UpdynWarning, match="cannot hold the geometry"):
        updyn.write_frf(frf(), path)
    assert updyn.read_frf(path).geometry is None


def test_a_table_written_by_hand(tmp_path):
    path = put(tmp_path, HEAD + "10,1.5,-2\n\n20.5,0,1e-3\n")
    found = updyn.read_frf(path)
    assert (found.quantity, found.responses.labels, found.references.labels) == (
        "accelerance",
        ["3:Z"],
        ["1:-X"],
    )
    np.testing.assert_array_equal(found.freq, [10.0, 20.5])
    np.testing.assert_array_equal(found.values[:, 0, 0], [1.5 - 2j, 1e-3j])


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_separators_and_commas_in_names(tmp_path, separator):
    name = '"H(3:Z,1:X) abs"' if separator == "," else "H(3:Z,1:X) abs"
    cells = ["freq_Hz", "H(3:Z,1:X) phase_deg", name, "H(3:Z,1:X) coh"]
    path = put(
        tmp_path,
        separator.join(cells) + "\r\n" + separator.join(["1", "90", "2", "0.5"]) + "\r\n",
        "case.txt",
    )
    found = updyn.read_frf(path, quantity="mobility")
    np.testing.assert_allclose(found.values[0, 0, 0], 2j, atol=1e-15)
    assert found.coherence[0, 0, 0] == 0.5


def test_a_matrix_in_any_order_of_columns(tmp_path):
    pairs = ["2:X/5:Y", "1:X/5:Y", "1:X/6:Y", "2:X/6:Y"]
    names = [f"H({p}) {what}" for what in ("im", "re") for p in pairs]
    path = put(
        tmp_path, "# quantity: receptance\nfreq_Hz," + ",".join(names) + "\n1,1,2,3,4,5,6,7,8\n"
    )
    found = updyn.read_frf(path)
    assert (found.responses.labels, found.references.labels) == (["2:X", "1:X"], ["5:Y", "6:Y"])
    np.testing.assert_array_equal(found.values[0], [[5 + 1j, 8 + 4j], [6 + 2j, 7 + 3j]])


def test_quantity_given_and_said_must_agree(tmp_path):
    path = put(tmp_path, HEAD + "10,1,2\n")
    assert updyn.read_frf(path, quantity="accelerance").quantity == "accelerance"
    with pytest.raises(
        FormatError, match="'mobility' contradicts the file, which states 'accelerance'"
    ):
        updyn.read_frf(path, quantity="mobility")


def test_a_quantity_that_is_none_is_not_said_to_contradict_the_file(tmp_path):
    path = put(tmp_path, HEAD + "10,1,2\n")
    expected = r"case\.csv: quantity 'acceleration': did you mean 'accelerance'\?"
    with pytest.raises(FormatError, match=expected) as caught:
        updyn.read_frf(path, quantity="acceleration")
    assert caught.value.key == ("quantity",)
    with pytest.raises(DataError, match=r"^quantity 'acceleration': did you mean 'accelerance'"):
        updyn.FRF.from_xarray(updyn.read_frf(path).to_xarray(), quantity="acceleration")


def test_average_does_not_apply(tmp_path):
    with pytest.raises(OptionError, match="expected 'raise'"):
        updyn.read_frf(put(tmp_path, HEAD + "10,1,2\n"), duplicates="average")


def test_geometry_as_a_table(tmp_path):
    path = put(tmp_path, "node,x,y,z\n7,0,0.5,-1\n")
    found = updyn.io.read_geometry(path)
    assert found.nodes.tolist() == [7]
    np.testing.assert_array_equal(found.xyz, [[0.0, 0.5, -1.0]])
