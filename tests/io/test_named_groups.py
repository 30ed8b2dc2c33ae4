"""Matrices by part as people store them: struct arrays, structs of matrices, dof_ref, one triangle."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import updyn
from io_samples import assert_same_model
from matlab73 import write_matlab73
from updyn.errors import FormatError
from updyn.model import Group, Model

K1 = np.array([[2.0, -1.0], [-1.0, 1.0]])
K2 = np.array([[0.0, 0.0], [0.0, 3.0]])
M1 = np.diag([0.5, 0.25])
DOFS = ["1:X", "2:X"]
EXPECTED = Model.from_groups({"shaft": Group(K1, M1, 0.02), "mount": Group(K2)}, DOFS)
EMPTY = np.empty((0, 0))


def save_5(path, variables):
    """Write version 5, a list of dicts as a struct array."""
    stored = {}
    for name, value in variables.items():
        if isinstance(value, list) and isinstance(value[0], dict):
            stored[name] = np.empty((1, len(value)), dtype=[(key, object) for key in value[0]])
            for i, part in enumerate(value):
                stored[name][0, i] = tuple(part.values())
        else:
            stored[name] = (
                np.array(value, dtype=object)[:, None] if isinstance(value, list) else value
            )
    scipy.io.savemat(path, stored, oned_as="column")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.mat"


@pytest.fixture(params=[save_5, write_matlab73], ids=["v5", "v7.3"])
def save(request):
    return request.param


def test_a_struct_array(path, save):
    """groups(1).name = 'shaft'; fields that one of them does not need are empty there."""
    parts = [
        {"name": "shaft", "K": sp.csc_array(K1), "M": M1, "loss_factor": 0.02},
        {"name": "mount", "K": K2, "M": np.zeros((2, 2)), "loss_factor": 0.0},
    ]
    save(path, {"dofs": DOFS, "groups": parts})
    model = updyn.read_model(path)
    assert list(model.groups) == ["shaft", "mount"]
    np.testing.assert_array_equal(model.group("shaft").stiffness.toarray(), K1)
    np.testing.assert_array_equal(model.group("mount").stiffness.toarray(), K2)
    assert model.group("shaft").loss_factor == 0.02


def test_empty_fields_of_a_struct_array(path):
    parts = [
        {"name": "shaft", "K": K1, "M": M1, "loss_factor": 0.02},
        {"name": "mount", "K": K2, "M": EMPTY, "loss_factor": EMPTY},
    ]
    save_5(path, {"dofs": DOFS, "groups": parts})
    assert_same_model(updyn.read_model(path), EXPECTED)


def test_a_struct_of_matrices(path, save):
    """K.shaft, K.mount, M.shaft."""
    save(
        path,
        {
            "dofs": DOFS,
            "K": {"shaft": K1, "mount": K2},
            "M": {"shaft": M1},
            "loss_factor": {"shaft": 0.02},
        },
    )
    assert_same_model(updyn.read_model(path), EXPECTED)


def test_in_a_struct_of_its_own(path, save):
    save(
        path,
        {
            "model": {
                "dofs": np.array([[1.0, 1.0], [2.0, 1.0]]),
                "K": {"shaft": K1, "mount": K2},
                "M": {"shaft": M1},
                "loss_factor": {"shaft": 0.02},
            }
        },
    )
    assert_same_model(updyn.read_model(path), EXPECTED)


def test_dof_ref_counts_from_0(tmp_path):
    """As ansys-mapdl-reader returns it: node, and 0 for X."""
    np.savez(tmp_path / "mk.npz", K=K1, M=M1, dof_ref=np.array([[1, 0], [2, 5]], dtype=np.int32))
    assert updyn.read_model(tmp_path / "mk.npz").dofs.labels == ["1:X", "2:RZ"]


@pytest.mark.parametrize("side", ["upper", "lower"])
def test_one_triangle_is_refused(tmp_path, side):
    np.savez(
        tmp_path / "mk.npz",
        K=np.triu(K1) if side == "upper" else np.tril(K1),
        M=M1,
        dofs=np.array(DOFS),
    )
    with pytest.raises(
        FormatError, match=f"stiffness: holds only the {side} triangle of.*completes it"
    ):
        updyn.read_model(tmp_path / "mk.npz")


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"K": {"a": K1}, "M": M1}, "K is a struct with a matrix for each part, but M is not"),
        ({"K": {"a": K1}, "groups": {"a": {"K": K1}}}, "K is a struct .* but groups is not"),
        (
            {"K": {"a": K1}, "loss_factor": 0.1},
            "loss_factor is 0.1 for several parts; expected a struct",
        ),
        ({"K": {"a": K1}, "loss_factor": {"b": 0.1}}, "loss_factor: no part 'b' in K"),
        ({"groups": [{"K": K1}, {"K": K2}]}, r"groups\(1\) has no field 'name'; it has K"),
        ({"groups": [{"name": "a", "K": K1}, {"name": "a", "K": K2}]}, "group 'a' occurs twice"),
        (
            {"groups": [{"name": "a", "kk": K1}, {"name": "b", "kk": K2}]},
            "group 'a': unknown name 'kk'",
        ),
        ({"groups": ["a", "b"]}, "groups: expected one struct per group"),
        (
            {"K": K1, "dof_ref": np.array([[1.0, 0.0], [2.0, 0.0]])},
            "holds both 'dofs' and 'dof_ref'",
        ),
        (
            {"shafts": [{"K": K1}, {"K": K2}]},
            "shafts: struct array of shape|no attribute MATLAB_class",
        ),
    ],
)
def test_what_is_refused(path, save, variables, said):
    save(path, {"dofs": DOFS, **variables})
    with pytest.raises(FormatError, match=said):
        updyn.read_model(path)


def test_dof_ref_out_of_range(tmp_path):
    np.savez(tmp_path / "mk.npz", K=K1, M=M1, dof_ref=np.array([[1, 1], [2, 6]]))
    with pytest.raises(
        FormatError, match=r"dof_ref: .* expected \(N, 2\): node, and direction 0..5"
    ):
        updyn.read_model(tmp_path / "mk.npz")
