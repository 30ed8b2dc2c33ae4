"""Decks assembled without MYSTRAN: by hand, against MYSTRAN, and a real deck against MSC Nastran."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import updyn
from nastran_decks import mystran, plate
from updyn.errors import FormatError, UpdynWarning
from updyn.io.nastran.assembly import is_simple
from updyn.io.nastran.bdf import read_model
from updyn.io.nastran.deck import read_deck

#: Folder of the deck AIRMOD_MODAL.DAT of DLR (github.com/cossan-working-group/BayesianModelUpdating)
#: and of msc_frequencies.csv, its natural frequencies by MSC Nastran in Hz.
AIRMOD = Path(os.environ.get("UPDYN_AIRMOD", "no-folder"))

BRICKS = """TITLE = a bar of bricks
SPC = 2
BEGIN BULK
PARAM,COUPMASS,1
PARAM,MAXRATIO,1E+6
PARAM,POST,-1
PARAM,G,.01
CORD2C,5,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
GRDSET,,,,,,,456
SPCADD,2,1
PSOLID,1,1,0
MAT1,1,7.+10,,.3,2700.,,,.02
"""


def bricks(n: int, *, length: float = 1.0, width: float = 0.05, height: float = 0.02) -> str:
    """Return a cantilever of n by 1 by 1 hexahedra, with grids in cylindrical systems at its tip."""
    text = BRICKS
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    for i in range(n + 1):
        for k, (y, z) in enumerate(corners):
            system = 5 if i == n else ""
            where = f"{length * i / n:.6f},{width * y:.6f},{height * z:.6f}"
            text += f"GRID,{10 * i + k + 1},,{where},{system}\n"
    for i in range(n):
        nodes = [*(10 * i + k for k in (1, 2, 3, 4)), *(10 * i + 10 + k for k in (1, 2, 3, 4))]
        text += f"CHEXA,{i + 1},1,{','.join(map(str, nodes[:6]))}\n,{nodes[6]},{nodes[7]}\n"
    return text + "SPC1,1,123,1,THRU,4\nENDDATA\n"


def test_cantilever_of_bricks(deck):
    path = deck(bricks(40))
    assert is_simple(read_deck(path))
    model = read_model(path, timeout=0.001)
    area, stiffness = 0.05 * 0.02, 7e10 * 0.05 * 0.02**3 / 12
    exact = np.array([1.8751, 4.6941]) ** 2 / (2 * np.pi) * np.sqrt(stiffness / (2700.0 * area))
    found = updyn.modes(model, 3).frequency
    np.testing.assert_allclose(found[[0, 2]], exact, rtol=0.015)
    assert model.groups["PSOLID 1"].loss_factor == pytest.approx(0.03)
    assert (model.title, len(model.dofs)) == ("a bar of bricks", 480)


def test_units_and_lumped_mass(deck):
    model = read_model(deck(bricks(4)))
    scaled = bricks(4, length=1000.0, width=50.0, height=20.0)
    scaled = scaled.replace("7.+10,,.3,2700.", "7.+4,,.3,2.7-9")
    other = read_model(deck(scaled), unit="mm")
    np.testing.assert_allclose(
        other.stiffness.toarray(), model.stiffness.toarray(), rtol=1e-6, atol=10
    )
    np.testing.assert_allclose(other.mass.toarray(), model.mass.toarray(), rtol=1e-6, atol=1e-9)
    lumped = read_model(deck(bricks(4).replace("COUPMASS,1", "WTMASS,2.")))
    M = lumped.mass.toarray()
    np.testing.assert_array_equal(M, np.diag(M.diagonal()))
    assert M.trace() / 3 == pytest.approx(2 * 2.7 * 0.875, rel=1e-12)  # without the clamped corners


def test_free_bricks_have_six_rigid_body_modes(deck):
    text = bricks(3).replace("SPC = 2", "SPC = 0")
    model = read_model(deck(text))
    values = np.linalg.eigvalsh(model.stiffness.toarray())
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-8 * values[-1]


POINTS = """SPC = 1
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,.5,0.,3
GRID,3,,0.,1.,2.
GRID,4,,3.,1.,1.,,456
SPOINT,9
CORD2R,3,,0.,0.,0.,0.,1.,1.
,1.,0.,0.
CROD,1,1,1,2
CROD,2,1,2,3
CONROD,3,3,4,2,2.-4,1.-8,,.5
PROD,1,1,1.-4,2.-8,,.3
MAT1,1,2.+11,8.+10,,7850.
MAT1,2,7.+10,,.3,2700.,,,.01
CELAS1,11,4,2,3,3,1
PELAS,4,700.,.05
CELAS2,12,300.,1,1
CELAS2,13,200.,1,2,9
CELAS2,14,500.,4,3
CELAS2,15,80.,1,4,3,5
CELAS2,16,90.,2,6
CELAS2,17,95.,2,5
CELAS2,18,95.,3,6
CMASS2,21,.7,9
CMASS1,22,5,4,3,2,1
PMASS,5,.4
CMASS2,23,.2,,,1,5
CONM2,31,2,,1.5,.1,.2,-.3
,.02,.001,.03,.002,.003,.04
CONM2,32,4,0,.5
SPC1,1,4,3
SPC,1,4,2,0.
PARAM,WTMASS,2.
PARAM,K6ROT,100.
"""


@pytest.mark.needs("mystran")
@pytest.mark.kernels
def test_springs_masses_and_rods_are_those_of_mystran(deck):
    # MYSTRAN has no scalar masses between two grids, places those of grids in component 1, and
    # turns and shifts products of inertia with the wrong sign: by hand below.
    text = POINTS.replace("CMASS1,22,5,4,3,2,1", "CMASS1,22,5,4,1")
    text = text.replace("CMASS2,23,.2,,,1,5", "CMASS2,23,.2,,,1,1")
    text = text.replace(",.001,.03,.002,.003,.04", ",,.03,,,.03")
    path = deck(text.replace("1.5,.1,.2,-.3", "1.5"))
    with pytest.warns(UpdynWarning, match="degrees of freedom without stiffness"):
        found = read_model(path)
    expected = read_model(path, executable=mystran())
    assert found.dofs.labels == expected.dofs.labels
    assert list(found.groups) == list(expected.groups)
    for name, group in expected.groups.items():
        ours = found.groups[name]
        assert ours.loss_factor == group.loss_factor
        for what in ("stiffness", "mass"):
            A, B = getattr(ours, what), getattr(group, what)
            assert (A is None) == (B is None), (name, what)
            if A is not None:
                np.testing.assert_allclose(
                    A.toarray(), B.toarray(), atol=1e-6 * abs(B).max(), err_msg=f"{name} {what}"
                )


@pytest.mark.needs("mystran")
@pytest.mark.kernels
@pytest.mark.parametrize("kind", ["CPENTA", "CHEXA"])
def test_solids_of_mystran(deck, kind):
    # Wedges are equal; hexahedra have the same mass, but MYSTRAN gives them no internal functions.
    corners = [(0, 0, 0), (1, 0.1, 0), (1.1, 0.9, 0.1), (0, 1, 0)]
    corners = corners[: 3 if kind == "CPENTA" else 4]
    corners = [*corners, *((x, y, z + 1.2) for x, y, z in corners)]
    text = "BEGIN BULK\nPARAM,COUPMASS,1\nPSOLID,1,1\nMAT1,1,7.+10,,.3,2700.\n"
    for number, (x, y, z) in enumerate(corners, 1):
        text += f"GRID,{number},,{float(x)},{float(y)},{float(z)}\n"
    names = [str(number) for number in range(1, len(corners) + 1)]
    text += f"{kind},1,1,{','.join(names[:6])}\n"
    text += f",{','.join(names[6:])}\n" if names[6:] else ""
    with pytest.warns(UpdynWarning, match="degrees of freedom without stiffness"):
        found = read_model(deck(text))
    full = deck(text.replace("PSOLID,1,1", "PSOLID,1,1,,2,,1"))
    expected = read_model(full, executable=mystran())
    assert found.dofs == expected.dofs
    whats = ("stiffness", "mass") if kind == "CPENTA" else ("mass",)
    for what in whats:
        A, B = getattr(found, what).toarray(), getattr(expected, what).toarray()
        np.testing.assert_allclose(A, B, atol=1e-12 * abs(B).max())


def test_masses_by_hand(deck):
    with pytest.warns(UpdynWarning, match="degrees of freedom without stiffness"):
        model = read_model(deck(POINTS))
    both = model.groups["PMASS 5"].mass.toarray()
    at = model.dofs.match(["4:Z", "2:X"]).index
    np.testing.assert_allclose(both[np.ix_(at, at)], [[0.8, -0.8], [-0.8, 0.8]], rtol=1e-15)
    assert np.count_nonzero(both) == 4
    turning = model.groups["CMASS2 23"].mass
    (row,) = model.dofs.match(["1:RY"]).index
    assert (turning[row, row], turning.nnz) == (0.4, 1)
    # Kinetic energy of rigid motions with the velocities of grid 2 in the basic system.
    grid = model.dofs.match([f"2:{axis}" for axis in ("X", "Y", "Z", "RX", "RY", "RZ")]).index
    M = model.groups["CONM2 31"].mass[grid][:, grid].toarray()
    z = np.array([0.0, 1.0, 1.0]) / np.sqrt(2)
    y = np.cross(z, [1.0, 0.0, 0.0])
    axes = np.array([[1.0, 0.0, 0.0], y, z])
    inertia = np.array([[0.02, -0.001, -0.002], [-0.001, 0.03, -0.003], [-0.002, -0.003, 0.04]])
    for seed in range(3):
        v, spin = np.random.default_rng(seed).normal(size=(2, 3))
        moved = v + np.cross(spin, [0.1, 0.2, -0.3])
        energy = 2.0 * (1.5 * moved @ moved + spin @ inertia @ spin)
        local = np.concatenate([axes @ v, axes @ spin])
        assert local @ M @ local == pytest.approx(energy, rel=1e-12)


def test_coupled_mass_of_a_rod(deck):
    text = "BEGIN BULK\nPARAM,COUPMASS,1\nGRID,1,,0.,0.,0.,,23456\nGRID,2,,2.,0.,0.,,3456\n"
    text += "CROD,1,1,1,2\nPROD,1,1,.01\nMAT1,1,2.+11,,.3,1200.\nCELAS2,2,1.+4,2,2\n"
    model = read_model(deck(text))
    assert model.dofs.labels == ["1:X", "2:X", "2:Y"]
    M = np.array([[10.0, 2.0, 0.0], [2.0, 10.0, 0.0], [0.0, 0.0, 12.0]])
    np.testing.assert_allclose(model.mass.toarray(), M, rtol=1e-12, atol=1e-12)


def test_degrees_of_freedom_without_stiffness_are_fixed_with_a_note(deck):
    # An inclined rod has stiffness along itself only: one translation of each end is kept.
    text = "BEGIN BULK\nGRID,1,,0.,0.,0.\nGRID,2,,1.,3.,0.\nCROD,1,1,1,2\nPROD,1,1,.01\n"
    text += "MAT1,1,2.+11,,.3,1200.\n"
    message = r"10 degrees of freedom .* 4 of them translations: 1:X, 1:Z, 2:X, ...; with mass: 1:X"
    with pytest.warns(UpdynWarning, match=message):
        model = read_model(deck(text))
    assert model.dofs.labels == ["1:Y", "2:Y"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("PSOLID,1,1,0", "PSOLID,1,1,0,2"),
        ("PSOLID,1,1,0", "PSOLID,1,1,0,,,FULL"),
        ("MAT1,1,7.+10,,.3", "MAT1,1,7.+10,2.+10,.3"),
        ("PARAM,POST,-1", "PARAM,AUTOSPC,NO"),
        ("PARAM,POST,-1", "PARAM,EPZERO,1.-6"),
        ("SPCADD,2,1", "SPCADD,2,1\nRBE2,90,1,123456,2"),
        ("SPCADD,2,1", "SPCADD,2,1\nCONM2,90,1,5,1."),
        ("SPCADD,2,1", "SPCADD,2,1\nCBUSH,90,91,1\nPBUSH,91,K,1."),
    ],
)
def test_decks_that_need_mystran(deck, old, new):
    text = bricks(2)
    assert old in text
    assert not is_simple(read_deck(deck(text.replace(old, new, 1))))
    assert not is_simple(read_deck(deck(plate())))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("CELAS2,12,300.,1,1", "CELAS2,12,300.,1,7", "component 7 .field 5.; expected 1 to 6"),
        ("CMASS2,21,.7,9", "CMASS2,21,.7,9,2", "component 2 .* expected 0 or 1 at a scalar point"),
        ("CMASS2,21,.7,9", "CMASS2,21,.7", "CMASS2 21: no grid; expected one or two"),
        ("CONM2,32,4", "CONM2,32,9", "CONM2 32: 9 is a scalar point; expected a grid"),
        ("CROD,1,1,1,2", "CROD,1,1,1,1", "CROD 1: its grids coincide"),
        ("SPC1,1,4,3", "SPC1,1,7,3", "components '7' of grid 3; expected digits"),
        ("SPC1,1,4,3", "SPC1,3,4,3\nSPCADD,1,7", "SPCADD 1: no SPC or SPC1 card of set 7"),
    ],
)
def test_faults(deck, old, new, message):
    assert old in POINTS
    with pytest.raises(FormatError, match=message):
        read_model(deck(POINTS.replace(old, new, 1)))


def test_a_brick_that_is_inside_out(deck):
    text = bricks(1).replace("CHEXA,1,1,1,2,3,4,11,12\n,13,14", "CHEXA,1,1,11,12,13,14,1,2\n,3,4")
    with pytest.raises(FormatError, match=r"CHEXA 1 is turned inside out"):
        read_model(deck(text))


@pytest.mark.skipif(not AIRMOD.is_dir(), reason="UPDYN_AIRMOD names no folder")
def test_airmod_has_the_frequencies_of_msc_nastran():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        model = read_model(AIRMOD / "AIRMOD_MODAL.DAT", spc=2, massless=["PROD 16", "PROD 17"])
    expected = np.loadtxt(AIRMOD / "msc_frequencies.csv")
    found = updyn.modes(model, len(expected)).frequency
    # The first one is zero; the MSC figure is rounding.
    np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-3)
