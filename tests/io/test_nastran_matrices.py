"""Models of OUTPUT4 and DMIG matrices: round trips, order of DOFs from a deck, units, and files that do not fit."""

import numpy as np
import pytest

import updyn
from io_samples import model
from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.nastran.dmig import write_dmig
from updyn.io.nastran.op4 import read_op4, write_op4

SPRING = np.array([[1.0, -1.0], [-1.0, 1.0]])
DECK = """BEGIN BULK
GRID,7,,1.,0.,0.
GRID,3,,0.,0.,0.
SPOINT,5
CBAR,1,1,3,7,0.,1.,0.
PBAR,1,1,1.,1.,1.
MAT1,1,1.,,.3
ENDDATA
"""
TOML = (
    'deck = "wing.bdf"\n\n[[group]]\nname = "a"\nstiffness = "a.op4:KGG"\nmass ='
    ' "a.op4:MGG"\nloss_factor = 0.02\n'
)


@pytest.mark.parametrize("with_geometry", [True, False])
@pytest.mark.parametrize("name", ["case.op4", "case.toml"])
def test_round_trip_of_op4_is_exact(tmp_path, with_geometry, name):
    given = model(with_geometry)
    updyn.write_model(given, tmp_path / name, format="op4")
    for written in ("case.op4", "case.toml"):
        found = updyn.read_model(tmp_path / written)
        assert (found.dofs, found.title, list(found.groups)) == (
            given.dofs,
            given.title,
            list(given.groups),
        )
        assert (found.geometry is None) == (given.geometry is None)
        for group, other in zip(given.groups.values(), found.groups.values(), strict=True):
            assert group.loss_factor == other.loss_factor
            for one, two in (
                (getattr(g, w) for g in (group, other)) for w in ("stiffness", "mass", "viscous")
            ):
                assert (one is None) == (two is None)
                assert one is None or (one != two).nnz == 0


@pytest.mark.parametrize("suffix", [".pch", ".dmig"])
def test_round_trip_of_dmig(tmp_path, suffix):
    given = model(True)
    updyn.write_model(given, tmp_path / f"case{suffix}")
    found = updyn.read_model(tmp_path / f"case{suffix}")
    assert found.dofs == given.dofs
    assert list(found.groups) == list(given.groups)
    for name, group in given.groups.items():
        assert found.groups[name].loss_factor == group.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            one, two = getattr(group, what), getattr(found.groups[name], what)
            assert (one is None) == (two is None)
            if one is not None:
                np.testing.assert_allclose(two.toarray(), one.toarray(), rtol=1e-10)
    np.testing.assert_array_equal(found.geometry.xyz, given.geometry.xyz)


def g_set():
    """Stiffness and mass of a bar in its own axis and a scalar point, in the order 3 (six), 5 (one), 7 (six)."""
    K, M = np.zeros((13, 13)), np.zeros((13, 13))
    along = [0, 7]
    K[np.ix_(along, along)] = 2e3 * SPRING
    K[6, 6] = 5.0
    K[12, 12] = 4e3  # about Z of grid 7
    M[0, 0] = M[7, 7] = 0.25
    return K, M


@pytest.fixture
def folder(tmp_path):
    K, M = g_set()
    (tmp_path / "wing.bdf").write_text(DECK)
    (tmp_path / "m.toml").write_text(TOML)
    write_op4({"KGG": K, "MGG": M}, tmp_path / "a.op4")
    return tmp_path


def test_order_of_the_g_set_from_the_deck(folder):
    with pytest.warns(
        UpdynWarning, match=r"9 of 13 DOFs have no entry in any matrix .* the first is 3:Y"
    ):
        found = updyn.read_model(folder / "m.toml")
    assert found.dofs.labels == ["3:X", "5:X", "7:X", "7:RZ"]
    np.testing.assert_array_equal(
        found.stiffness.toarray(),
        [[2e3, 0, -2e3, 0], [0, 5, 0, 0], [-2e3, 0, 2e3, 0], [0, 0, 0, 4e3]],
    )
    np.testing.assert_array_equal(found.mass.diagonal(), [0.25, 0, 0.25, 0])
    assert found.groups["a"].loss_factor == 0.02
    np.testing.assert_array_equal(found.geometry.position([7]), [[1.0, 0, 0]])
    assert found.geometry.lines.tolist() == [[3, 7]]


def test_units(folder):
    (folder / "m.toml").write_text('unit = "mm"\n' + TOML)
    with pytest.warns(UpdynWarning, match="no entry"):
        found = updyn.read_model(folder / "m.toml")
    # N/mm and t become N/m and kg, 1000 of them; N mm becomes N m.
    np.testing.assert_allclose(found.stiffness.diagonal(), [2e6, 5e3, 2e6, 4.0], rtol=1e-14)
    np.testing.assert_allclose(found.mass.diagonal(), [250.0, 0, 250.0, 0], rtol=1e-14)
    np.testing.assert_array_equal(found.geometry.position([7]), [[1e-3, 0, 0]])


def test_op4_and_dmig_in_one_model(folder):
    write_dmig({"KAAX": 10.0 * SPRING}, DofSet(["3:X", "7:Y"]), folder / "b.pch")
    (folder / "m.toml").write_text(TOML + '[[group]]\nname = "b"\nstiffness = "b.pch"\n')
    with pytest.warns(UpdynWarning, match="8 of 13"):
        found = updyn.read_model(folder / "m.toml")
    assert found.dofs.labels == ["3:X", "5:X", "7:X", "7:Y", "7:RZ"]
    at = [0, 3]
    np.testing.assert_array_equal(
        found.groups["b"].stiffness.toarray()[np.ix_(at, at)], 10.0 * SPRING
    )


def test_dmig_alone_brings_its_labels(tmp_path):
    write_dmig({"KAAX": SPRING, "MAAX": np.eye(2)}, DofSet(["3:X", "7:Y"]), tmp_path / "b.pch")
    (tmp_path / "b.toml").write_text(
        '[[group]]\nname = "b"\nstiffness = "b.pch:KAAX"\nmass = "b.pch:maax"\n'
    )
    assert updyn.read_model(tmp_path / "b.pch").dofs.labels == ["3:X", "7:Y"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('deck = "wing.bdf"', "", r"m.toml: OUTPUT4 matrices have no labels: add dofs ="),
        (
            'deck = "wing.bdf"',
            'dofs = ["3:X", "7:X"]',
            r"m.toml:5: matrix KGG is 13 x 13, but there are 2 DOFs",
        ),
        ("a.op4:KGG", "a.op4:KGH", r"a.op4: no matrix 'KGH'; did you mean 'KGG'"),
        ("a.op4:KGG", "a.op4", r"a.op4: holds 2 matrices \(KGG, MGG\); select one"),
        (
            "a.op4:KGG",
            "b.op4:KGG",
            r"m.toml:5: stiffness: no such file 'b.op4'; did you mean 'a.op4'",
        ),
        (
            "a.op4:KGG",
            "wing.bdf",
            r"m.toml:5: stiffness: 'wing.bdf' mixed with OUTPUT4, OUTPUT2 or DMIG files; expected one of",
        ),
        (
            "loss_factor",
            "loss",
            r"m.toml:7: unknown key 'loss' in \[group\]; valid: .*'loss_factor'",
        ),
        ("deck", "dek", r"m.toml:1: unknown key 'dek'; did you mean 'deck'"),
        ("0.02", "-0.02", r"m.toml:4: group 'a': loss factor -0.02"),
        (
            "loss_factor = 0.02",
            '[[group]]\nname = "a"\nmass = "a.op4:MGG"',
            r"m.toml:8: group name 'a' occurs twice",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.*no entry in any matrix")
def test_faults(folder, old, new, message):
    assert old in TOML
    (folder / "m.toml").write_text(TOML.replace(old, new, 1))
    with pytest.raises(FormatError, match=message):
        updyn.read_model(folder / "m.toml")


def test_matrices_alone(folder):
    with pytest.raises(
        FormatError,
        match=r'\(KGG, MGG\) are not a model: write \'a.toml\'.*stiffness = "a.op4:KGG"',
    ):
        updyn.read_model(folder / "a.op4")
    with pytest.raises(FormatError, match=r"suffix '.mtx'; expected .op4, or .toml"):
        updyn.write_model(model(), folder / "x.mtx", format="op4")
    updyn.write_model(model(), folder / "y.op4")
    assert [m.name for m in read_op4(folder / "y.op4")][:2] == ["K1", "M1"]
