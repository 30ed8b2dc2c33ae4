"""`.npz`: both conventions of a model, FRFs, and what is refused."""

import numpy as np
import pytest
import scipy.sparse as sp

from io_samples import assert_same_frf, assert_same_model, frf, model
from updyn.errors import FormatError, OptionError
from updyn.io.npz import read_frf, read_model, write_frf, write_model
from updyn.model import Group, Model

K = np.array([[2.0, -1.0], [-1.0, 1.0]])
M = np.diag([0.5, 0.25])
LABELS = np.array(["1:X", "2:X"])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.npz"


@pytest.mark.parametrize("with_geometry", [True, False])
def test_model_round_trip_is_exact(path, with_geometry):
    write_model(model(with_geometry), path)
    assert_same_model(read_model(path), model(with_geometry))


@pytest.mark.parametrize("n_references", [1, 2])
def test_frf_round_trip_is_exact(path, n_references):
    write_frf(frf(n_references), path)
    assert_same_frf(read_frf(path), frf(n_references))


def test_plain_matrices_are_one_group_called_model(path):
    np.savez(path, K=K, M=M, C=0.1 * M, loss_factor=0.02, dofs=LABELS)
    expected = Model.from_groups({"model": Group(K, M, 0.02, 0.1 * M)}, ["1:X", "2:X"])
    assert_same_model(read_model(path), expected)


@pytest.mark.parametrize("dtype", [">f8", ">f4", ">i4", "<i2", "c16", ">c8"])
@pytest.mark.parametrize("is_sparse", [False, True])
def test_matrices_of_any_type_and_byte_order(path, dtype, is_sparse):
    stored = {"model.K": K.astype(dtype), "model.M": np.eye(2, dtype=bool)}
    if is_sparse:
        for name, array in list(stored.items()):
            csr = sp.csr_array(array.astype(array.dtype.newbyteorder("=")))
            parts = {"data": csr.data, "indices": csr.indices, "indptr": csr.indptr}
            del stored[name]
            stored |= {f"{name}.{part}": values for part, values in parts.items()}
        stored["model.K.data"] = stored["model.K.data"].astype(dtype)
        stored["model.K.indptr"] = stored["model.K.indptr"].astype(">i4")
    np.savez(path, dofs=LABELS, **stored)
    found = read_model(path)
    np.testing.assert_array_equal(found.stiffness.toarray(), K)
    np.testing.assert_array_equal(found.mass.toarray(), np.eye(2))


def test_frfs_in_the_other_byte_order(path):
    arrays = frf_arrays()
    arrays["H"] = arrays["H"].astype(">c16")
    arrays["freq"] = np.array(arrays["freq"], ">f8")
    np.savez(path, **arrays)
    np.testing.assert_array_equal(read_frf(path).values, frf_arrays()["H"])


def test_dofs_as_a_table_of_node_and_direction(path):
    np.savez(path, K=K, M=M, dofs=np.array([[12, 3], [-4, 6]]))
    assert read_model(path).dofs.labels == ["12:Z", "-4:RZ"]


def test_dense_groups_keep_the_order_of_the_list_of_names(path):
    arrays = {"b.K": K, "a.M": M, "a.K": 2 * K, "b.loss_factor": 0.5, "dofs": LABELS}
    np.savez(path, groups=np.array(["a", "b"]), **arrays)
    expected = Model.from_groups(
        {"a": Group(2 * K, M), "b": Group(K, loss_factor=0.5)}, ["1:X", "2:X"]
    )
    assert_same_model(read_model(path), expected)


def frf_arrays(**changes):
    values = np.arange(12.0).reshape(3, 2, 2) + 1j
    arrays = {
        "freq": [1.0, 2.0, 3.0],
        "H": values,
        "responses": ["1:X", "2:X"],
        "references": ["1:X", "2:X"],
    }
    arrays |= {"quantity": "receptance"} | changes
    return {name: np.asarray(a) for name, a in arrays.items() if a is not None}


def test_values_is_another_name_of_H_and_options_complete_a_file(path):
    arrays = frf_arrays(quantity=None, responses=None, references=None)
    np.savez(path, values=arrays.pop("H"), **arrays)
    found = read_frf(
        path, quantity="mobility", response_labels=["4:X", "5:-Y"], reference_labels=["4:X", "9:Z"]
    )
    assert (found.quantity, found.responses.labels) == ("mobility", ["4:X", "5:-Y"])
    np.testing.assert_array_equal(found.values, np.arange(12.0).reshape(3, 2, 2) + 1j)


def test_order_of_axes_is_taken_as_told(path):
    truth = frf_arrays()["H"][:, :, :1]
    np.savez(path, **frf_arrays(H=truth.transpose(2, 1, 0), references=["1:X"]))
    with pytest.raises(
        FormatError, match=r"found shape \(1, 2, 3\).*order=\('reference', 'response', 'freq'\)"
    ):
        read_frf(path)
    found = read_frf(path, order=("reference", "response", "freq"))
    np.testing.assert_array_equal(found.values, truth)


def test_order_of_axes_is_not_guessed_from_lengths(path):
    np.savez(path, **frf_arrays(H=np.ones((2, 2, 3)) * 1j))
    with pytest.raises(FormatError, match="more than one order of its axes would fit"):
        read_frf(path)
    with pytest.raises(
        FormatError, match=r"found shape \(2, 2, 3\), expected .* in the order \('freq', "
    ):
        read_frf(path, order=("freq", "reference", "response"))


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        (
            {},
            {"quantity": "mobility"},
            "quantity 'mobility' contradicts the file, which states 'receptance'",
        ),
        (
            {},
            {"response_labels": ["2:X", "1:X"]},
            "responses: the argument .* contradicts the file",
        ),
        (
            {"references": None},
            {},
            r"no 'references': .*; can also be given when reading: reference_labels=\.\.\.$",
        ),
        ({"quantity": None}, {}, "no 'quantity': found H, freq, references, responses"),
        (
            {"freq": None, "frequency": [1.0, 2, 3]},
            {},
            "unknown name 'frequency'; did you mean 'freq'",
        ),
        ({"freq": None}, {}, "no 'freq'"),
        ({"values": np.ones(3)}, {}, "both 'H' and 'values'"),
        ({"H": None}, {}, "no 'H' .*found: freq, quantity"),
        ({"H": np.abs(np.ones((3, 2, 2)))}, {}, "may be magnitudes or decibels"),
        ({"H": np.full((3, 2, 2), np.nan * 1j)}, {}, "is not finite"),
        ({"H": np.array(["a"])}, {}, "H: found 1 texts; expected numbers"),
        ({"responses": ["1:X", "1:-X"]}, {}, "responses: DOF 1:X occurs twice"),
        ({"responses": ["1:X", "2:q"]}, {}, "responses: DOF '2:q'"),
        ({"responses": [1, 2]}, {}, "responses: found numbers of shape"),
        ({"references": [[1, 1], [2, 7]]}, {}, "references: row 2 has direction 7; expected 1..6"),
        ({"coherence": np.full((3, 2, 2), 1.5)}, {}, "coherence at 1 Hz"),
        ({"averages": 2.5}, {}, "averages: 2.5; expected a whole number"),
        ({"xyz": np.zeros((1, 3))}, {}, "holds 'xyz' but no 'nodes'"),
        ({"quantity": "impedance"}, {}, "force over a motion"),
    ],
)
def test_frf_that_cannot_be_used(path, changes, options, message):
    np.savez(path, **frf_arrays(**changes))
    with pytest.raises(FormatError, match=message) as caught:
        read_frf(path, **options)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"duplicates": "first"}, "expected 'raise'"), ({"order": ("f", "i", "o")}, "order=")],
)
def test_options_are_checked(path, options, message):
    np.savez(path, **frf_arrays())
    with pytest.raises(OptionError, match=message):
        read_frf(path, **options)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"K": K, "M": M}, "no 'dofs': the 2 DOFs need labels.*found: K, M"),
        ({"dofs": LABELS}, "no matrix: expected K, M or C"),
        (
            {"K": K, "dofs": LABELS, "lossfactor": 0.1},
            "unknown name 'lossfactor'; did you mean 'loss_factor'",
        ),
        ({"K": K, "a.K": K, "dofs": LABELS}, "both 'groups' and 'K'"),
        ({"a.k": K, "dofs": LABELS}, "group 'a': unknown name 'k'; did you mean 'K'"),
        (
            {"a.K": K, "dofs": LABELS, "groups": np.array(["a", "b"])},
            "contains 'b', which has no array",
        ),
        ({"a.K": K, "dofs": LABELS, "groups": np.array(["a", "a"])}, "'a' occurs twice"),
        ({"a.K": K, "b.K": K, "dofs": LABELS, "groups": np.array(["a"])}, "lacks 'b'"),
        (
            {"a.K.data": np.ones(1), "a.K.indices": np.zeros(1, int), "dofs": LABELS},
            r"no 'a.K.indptr'",
        ),
        ({"K": K * 1j, "dofs": LABELS}, "complex numbers; damping goes into"),
        ({"K": K[:1], "dofs": LABELS}, "expected a square matrix"),
        ({"K": K, "dofs": LABELS[:1]}, "has 2 DOFs, the model has 1 labels"),
        ({"K": K, "M": np.eye(3), "dofs": LABELS}, "differ in size"),
        ({"K": K, "dofs": np.array(["1:X", "2:-X"])}, "the DOFs of a model are positive"),
        ({"K": K, "loss_factor": [0.1, 0.2], "dofs": LABELS}, "loss_factor: found shape"),
        ({"freq": np.ones(1), "H": K, "updyn_kind": "frf"}, "read it with updyn.read_frf"),
        ({"freq": np.ones(1), "H": K}, "read it with updyn.read_frf"),
    ],
)
def test_model_that_cannot_be_used(path, arrays, message):
    np.savez(path, **arrays)
    with pytest.raises(FormatError, match=message) as caught:
        read_model(path)
    assert str(path) in str(caught.value)


def test_one_sparse_matrix_of_scipy_is_not_a_model(path):
    sp.save_npz(path, sp.csr_array(K))
    with pytest.raises(FormatError, match=r"one sparse matrix written by scipy.sparse.save_npz"):
        read_model(path)
