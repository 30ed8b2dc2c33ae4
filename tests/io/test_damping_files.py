"""Damping in files: every format carries it, or says that it cannot."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import updyn
from updyn.cli.describe import describe_model
from updyn.errors import FormatError
from updyn.io.changes import check_changes
from updyn.io.damping import refuse_damping

pytestmark = pytest.mark.kernels

TABLE = ([1.0, 10.0, 100.0], [0.5, 1.0, 4.0])
DAMPING = {
    "loss_factor": 0.02,
    "mass_damping": 1.5,
    "stiffness_damping": 1 / 3 * 1e-4,
    "loss_table": TABLE,
}


def model(**damping):
    K, M = 4e4 * np.array([[2.0, -1.0], [-1.0, 1.0]]), np.diag([1.0, 2.0])
    groups = {"one": updyn.Group(K, M, **damping), "two": updyn.Group(mass=0.1 * M)}
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def as_told(group):
    out = {k: v for k, v in group.damping.items() if k != "loss_table"}
    table = group.loss_table
    return (
        out
        if table is None
        else out | {"loss_table": (table.freq.tolist(), table.relative.tolist())}
    )


@pytest.mark.parametrize("name", ["m.h5", "m.npz", "m.mat", "m.toml", "m.op4", "m.pch"])
@pytest.mark.parametrize(
    "left", [(), ("loss_table",), ("mass_damping", "loss_table"), ("stiffness_damping",)]
)
def test_what_is_written_comes_back(tmp_path, name, left):
    damping = {k: v for k, v in DAMPING.items() if k not in left}
    updyn.write_model(model(**damping), tmp_path / name)
    found = updyn.read_model(tmp_path / name)
    assert as_told(found.groups["one"]) == damping
    assert as_told(found.groups["two"]) == {"loss_factor": 0.0}


def test_abaqus_gets_matrices_and_refuses_tables(tmp_path):
    with pytest.raises(
        FormatError, match="group 'one' has loss_table, which this format cannot hold"
    ):
        updyn.write_model(model(**DAMPING), tmp_path / "m.inp")
    with_matrices = model(loss_factor=0.02, mass_damping=1.5, stiffness_damping=1e-4)
    with pytest.warns(
        updyn.UpdynWarning, match="Rayleigh damping of 'one' is written as viscous matrices"
    ):
        updyn.write_model(with_matrices, tmp_path / "m.inp")
    found = updyn.read_model(tmp_path / "m.inp")
    assert found.viscous.toarray() == pytest.approx(with_matrices.viscous.toarray(), rel=1e-12)


def test_an_older_reader_is_told_by_the_version(tmp_path):
    """A model of before is written as before; one with the new damping is not to be misread."""
    for name, damping, version in (
        ("old", {"loss_factor": 0.1}, 1),
        ("new", {"mass_damping": 0.1}, 2),
    ):
        updyn.write_model(model(**damping), tmp_path / f"{name}.h5")
        with h5py.File(tmp_path / f"{name}.h5") as file:
            assert file.attrs["updyn_format"] == version


def test_one_group_alone_in_an_archive(tmp_path):
    np.savez(
        tmp_path / "m.npz",
        K=np.eye(2),
        M=np.eye(2),
        dofs=["1:X", "2:X"],
        mass_damping=2.0,
        loss_table=np.array(TABLE),
    )
    found = updyn.read_model(tmp_path / "m.npz").groups["model"]
    assert (found.mass_damping, found.loss_table.relative.tolist()) == (2.0, TABLE[1])


def test_a_matrix_for_each_part_and_its_damping(tmp_path):
    from scipy.io import savemat

    parts = {"a": np.eye(2), "b": np.eye(2)}
    items = {"K": parts, "M": parts, "dofs": np.array(["1:X", "2:X"], dtype=object)}
    savemat(
        tmp_path / "m.mat",
        {**items, "mass_damping": {"b": 2.0}, "loss_table": {"a": np.array(TABLE)}},
    )
    found = updyn.read_model(tmp_path / "m.mat").groups
    assert (found["a"].mass_damping, found["b"].mass_damping) == (0.0, 2.0)
    assert found["a"].loss_table.freq.tolist() == TABLE[0]
    savemat(tmp_path / "bad.mat", {**items, "mass_damping": 2.0})
    with pytest.raises(FormatError, match="mass_damping is 2 for several parts"):
        updyn.read_model(tmp_path / "bad.mat")


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (
            "mass_damping = -1.0",
            r"m.toml:5: group 'one': mass_damping -1.0: expected a finite number of at least 0",
        ),
        ("loss_table = 3", r"m.toml:5: group 'one': loss_table: expected two rows"),
        (
            "mass_dampin = 1.0",
            r"m.toml:5: unknown key 'mass_dampin' in \[group\]; did you mean 'mass_damping'",
        ),
    ],
)
def test_faults_have_their_line(tmp_path, line, text):
    updyn.write_model(model(), tmp_path / "m.toml")
    source = f"""dofs = "m_dofs.csv"
[[group]]
name = "one"
stiffness = "m_01_K.mtx"
{line}
mass = "m_01_M.mtx"
"""
    (tmp_path / "m.toml").write_text(source)
    with pytest.raises(FormatError, match=text):
        updyn.read_model(tmp_path / "m.toml")


def test_what_a_format_cannot_hold_is_named(tmp_path):
    refuse_damping(model(loss_factor=0.1), tmp_path / "x", "loss_factor")
    with pytest.raises(FormatError, match="group 'one' has stiffness_damping"):
        refuse_damping(model(stiffness_damping=0.1), tmp_path / "x", "loss_factor")


def test_a_deck_has_no_place_for_rayleigh_coefficients():
    with pytest.raises(FormatError, match=r"wing\.bdf: group 'PBAR 1': no quantity 'mass_damping'"):
        check_changes({"PBAR 1": {"mass_damping": 1.0}}, Path("wing.bdf"))


def test_the_description_says_all_damping():
    told = describe_model(model(**DAMPING))
    assert (
        "one: loss factor 0.02 by a table from 1 to 100 Hz, mass damping 1.5 1/s, stiffness damping"
        in told
    )
    assert "two:" not in told
