"""`responses=` and `references=` mean the same for every format: which to read, in the order given, with a sense."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from io_samples import assert_same_frf, frf
from updyn.errors import FormatError, OptionError

SUFFIXES = ("uff", "nc", "npz", "mat", "csv")


def stored(tmp_path, suffix):
    """Responses 1:X, 2:-Y, 3:RZ by references 7:RZ, 1:-X, without what one of the formats cannot hold."""
    data = replace(frf(with_geometry=False), variance=None, averages=None, source="")
    path = tmp_path / f"case.{suffix}"
    updyn.write_frf(data, path)
    return path, data


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_part_in_the_order_and_with_the_senses_given(tmp_path, suffix):
    path, data = stored(tmp_path, suffix)
    found = updyn.read_frf(path, responses=["3:-RZ", "1:X"], references=["1:X"])
    assert (found.responses.labels, found.references.labels) == (["3:-RZ", "1:X"], ["1:X"])
    # 3:-RZ over 1:X: both senses turned, the signs cancel; 1:X over 1:X: one.
    np.testing.assert_array_equal(found.values[:, 0, 0], data.values[:, 2, 1])
    np.testing.assert_array_equal(found.values[:, 1, 0], -data.values[:, 0, 1])
    np.testing.assert_array_equal(found.coherence, data.coherence[:, [2, 0], 1:])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_side_alone(tmp_path, suffix):
    path, data = stored(tmp_path, suffix)
    found = updyn.read_frf(path, references=iter([updyn.Dof.parse("7:RZ")]))
    assert_same_frf(replace(found, source=""), data.select(references=["7:RZ"]))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"responses": ["1:X", "2:Z"]}, "responses: response 2:Z is not among the 3 DOFs"),
        ({"references": ["2:Y"]}, "references: reference 2:Y is not among the 2 DOFs"),
        ({"responses": []}, "responses: an empty list; omit it to read all"),
        ({"responses": ["1:X", "1:-X"]}, "responses: DOF 1:X occurs twice"),
        ({"references": ["7:rz9"]}, "references: DOF '7:rz9'"),
    ],
)
def test_what_is_not_there_is_refused(tmp_path, suffix, options, message):
    path, _ = stored(tmp_path, suffix)
    with pytest.raises(FormatError, match=message) as caught:
        updyn.read_frf(path, **options)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_labels_name_a_bare_array_and_a_part_of_it_is_chosen_by_them(tmp_path, suffix):
    import scipy.io

    values = np.arange(12.0).reshape(3, 2, 2) + 1j
    arrays = {"freq": [1.0, 2.0, 3.0], "H": values, "quantity": "mobility"}
    path = tmp_path / f"case.{suffix}"
    if suffix == "npz":
        np.savez(path, **arrays)
    else:
        scipy.io.savemat(path, arrays)
    labels = {"response_labels": ["4:X", "5:-Y"], "reference_labels": ["4:X", "9:Z"]}
    found = updyn.read_frf(path, **labels, responses=["5:Y"], references=["9:Z", "4:X"])
    np.testing.assert_array_equal(found.values[:, 0], -values[:, 1, ::-1])
    with pytest.raises(
        FormatError, match=r"given when reading: response_labels=\.\.\., reference_labels="
    ):
        updyn.read_frf(path, responses=["5:Y"])


@pytest.mark.parametrize(
    ("suffix", "message"),
    [
        ("uff", "has no option 'response_labels'; did you mean 'responses'"),
        ("nc", "response_labels is only used with variables"),
        ("csv", "has no option 'response_labels'; did you mean 'responses'"),
    ],
)
def test_files_that_name_their_dofs_take_no_labels(tmp_path, suffix, message):
    path, _ = stored(tmp_path, suffix)
    with pytest.raises(OptionError, match=message):
        updyn.read_frf(path, response_labels=["1:X", "2:Y", "3:RZ"])
