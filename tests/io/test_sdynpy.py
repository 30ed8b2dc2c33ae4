"""Systems of SDynPy, written here by the field names of its ``System.save`` (the program is not installed).

Two files of SDynPy 0.23.0 itself were read and gave its own ``frequency_response`` to rounding when
this was written."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, UpdynWarning

pytestmark = pytest.mark.kernels

COORDINATE = [("node", "uint64"), ("direction", "int8")]
K = np.array([[3.0, -1, 0, 0], [-1, 2, -1, 0], [0, -1, 2, -1], [0, 0, -1, 1]]) * 1e4
M = np.diag([2.0, 1.0, 3.0, 1.5])


def saved(path, **changes):
    """Write what ``System.save`` writes."""
    fields = {
        "mass": M,
        "stiffness": K,
        "damping": 0.001 * K,
        "transformation": np.eye(4),
        "coordinate": np.array([(101, 1), (102, 2), (103, -3), (104, 4)], dtype=COORDINATE),
        "enforce_symmetry": np.array(True),
    }
    fields.update(changes)
    np.savez(path, **{n: v for n, v in fields.items() if v is not None})
    return path


def receptance(model, responses, references, freq):
    return updyn.response(model, freq, responses, references).values


def direct(freq, rows, columns, T=None):
    """Receptances of the coordinates by dense solves: T Z^-1 T^T (SDynPy, System.frequency_response)."""
    T = np.eye(4) if T is None else T
    out = []
    for f in freq:
        w = 2 * np.pi * f
        out.append(
            (T @ np.linalg.solve(K * (1 + 0.001j * w) - w**2 * M, T.T))[np.ix_(rows, columns)]
        )
    return np.array(out)


def test_a_system(tmp_path):
    model = updyn.read_model(saved(tmp_path / "system.npz"))
    assert model.dofs.labels == ["101:X", "102:Y", "103:Z", "104:RX"]
    assert list(model.groups) == ["model"]
    freq = np.arange(1.0, 40.0)
    # The third coordinate points the other way: 103:-Z is what SDynPy calls its row.
    ours = receptance(model, ["101:X", "102:Y", "103:-Z", "104:RX"], ["103:-Z", "101:X"], freq)
    np.testing.assert_allclose(ours, direct(freq, range(4), [2, 0]), rtol=1e-12)
    assert receptance(model, ["101:X"], ["103:Z"], freq)[0, 0, 0] == pytest.approx(
        -ours[0, 0, 0], rel=1e-12
    )


def test_without_damping(tmp_path):
    model = updyn.read_model(saved(tmp_path / "system.npz", damping=np.zeros((4, 4))))
    assert model.group("model").viscous is None


def test_states_in_another_order_and_sense(tmp_path):
    T = np.zeros((4, 4))
    T[[0, 1, 2, 3], [2, 0, 3, 1]] = [1, -1, 1, 1]
    model = updyn.read_model(saved(tmp_path / "system.npz", transformation=T))
    freq = np.arange(1.0, 40.0)
    ours = receptance(model, ["101:X", "102:Y", "103:-Z", "104:RX"], ["103:-Z"], freq)
    np.testing.assert_allclose(ours, direct(freq, range(4), [2], T), rtol=1e-12)


def test_a_reduction_that_keeps_coordinates(tmp_path):
    """Guyan's: three states are coordinates, the fourth coordinate follows from them and is left out, said so."""
    T = np.vstack([np.eye(3), -np.linalg.solve(K[3:, 3:] * 2.0, K[3:, :3])])
    file = saved(
        tmp_path / "guyan.npz",
        stiffness=K[:3, :3],
        mass=M[:3, :3],
        damping=np.zeros((3, 3)),
        transformation=T,
    )
    with pytest.warns(
        UpdynWarning,
        match=r"1 coordinates that are combinations of the 3 states are ignored; .* 104:RX",
    ):
        model = updyn.read_model(file)
    assert model.dofs.labels == ["101:X", "102:Y", "103:Z"]
    np.testing.assert_array_equal(
        model.stiffness.toarray(), K[:3, :3] * np.outer([1, 1, -1], [1, 1, -1])
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"transformation": np.linalg.qr(K)[0]},
            "state 1 of 4 is not a coordinate but part of several",
        ),
        ({"mass": None}, "no 'mass'; expected mass, stiffness"),
        ({"mass": M[:3, :3]}, r"mass of shape \(3, 3\), expected \(4, 4\)"),
        ({"transformation": np.eye(3)}, r"transformation of shape \(3, 3\), expected \(4, 4\)"),
        ({"transformation": None, "damping": None}, "no 'damping'"),
        ({"stiffness": K + np.triu(K, 1)}, "stiffness: is not symmetric|stiffness"),
        ({"stiffnes": K}, "unknown name 'stiffnes'; did you mean 'stiffness'"),
        (
            {"coordinate": np.array([(1, 0)] * 4, dtype=COORDINATE)},
            "node 1 has direction 0; expected 1..6",
        ),
        ({"coordinate": np.array([(1, 2)] * 4, dtype=COORDINATE)}, "DOF 1:Y occurs twice"),
        ({"coordinate": np.arange(4)}, "expected one row of pairs of node and direction"),
        ({"stiffness": K * (1 + 0.1j)}, "stiffness: found complex numbers"),
    ],
)
def test_malformed(tmp_path, changes, said):
    with pytest.raises(FormatError, match=said):
        updyn.read_model(saved(tmp_path / "bad.npz", **changes))
