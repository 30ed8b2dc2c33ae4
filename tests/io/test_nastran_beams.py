"""CBEAM as CBAR: frequencies of Simcenter Nastran, inertia about the axis, refused beams."""

from __future__ import annotations

import math

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, UpdynWarning
from updyn.io.nastran.bdf import read_model, write_properties

needs_mystran = pytest.mark.needs("mystran")

#: Natural frequencies in Hz of Simcenter Nastran 2019.1 for `rod_of_bars`: the deck beam_modes.dat
#: of pyNastran (models/beam_modes), a cantilever of nine CBAR and a CBEAM with a mass at its tip.
SIMCENTER = [456.6603, 456.6603, 2674.588, 2674.588, 3554.923]
SIMCENTER += [4507.487, 6626.104, 6626.104, 11111.59, 11111.59]


def rod_of_bars(beams: tuple[int, ...] = (10,), sections: str = "") -> str:
    """Return the deck in in, lbf, lbf s2/in: round bars of radius 1, length 10."""
    lines = ["SPC = 1", "BEGIN BULK"]
    lines += [f"GRID,{n + 1},,{n}.,0.,0." for n in range(11)]
    for n in range(1, 11):
        kind, pid = ("CBEAM", 3) if n in beams else ("CBAR", 1)
        lines.append(f"{kind},{n},{pid},{n},{n + 1},0.,1.,0.")
    sections = sections or "PBARL,1,2,,ROD\n,1.,0.\nPBEAML,3,2,,ROD\n,1.,0."
    lines += [sections, "CONM2,21,11,,.00259", ",.00259,,.00259,,,.00259"]
    lines += ["MAT1,2,3.+7,1.1628+7,.29,7.4851-4", "SPC1,1,123456,1", "ENDDATA"]
    return "\n".join(lines) + "\n"


def constant(*, tail: str = "", station: str = "YES,1.") -> str:
    """Return a PBEAM of radius 1 with K1 = K2 = 0.9, with an equal end B."""
    A, I, J = math.pi, math.pi / 4, math.pi / 2
    first = f"PBEAM,3,2,{A:.9f},{I:.9f},{I:.9f},,{J:.9f}\n,1.,0.,-1.,0.\n"
    return f"PBARL,1,2,,ROD\n,1.,0.\n{first},{station}\n,1.,0.,-1.,0.\n,.9,.9{tail}"


@needs_mystran
@pytest.mark.parametrize("sections", ["", constant()])
def test_frequencies_are_those_of_simcenter_nastran(deck, sections):
    model = read_model(deck(rod_of_bars(sections=sections)), unit="in")
    np.testing.assert_allclose(updyn.modes(model, 10).frequency, SIMCENTER, rtol=5e-7)


@needs_mystran
def test_inertia_about_an_inclined_axis(deck):
    axis = np.array([2.0, 3.0, 6.0]) / 7.0
    text = "SPC=1\nBEGIN BULK\nGRID,1,,0.,0.,0.\nGRID,2,,4.,6.,12.\nSPC1,1,123456,1\n"
    text += "CBEAM,1,3,1,2,0.,0.,1.\nPBEAM,3,2,5.,7.,11.,2.,13.\nMAT1,2,7.+10,,.3,3000.\n"
    model = read_model(deck(text))
    assert model.dofs.labels == ["2:X", "2:Y", "2:Z", "2:RX", "2:RY", "2:RZ"]
    M = model.mass.toarray()
    np.testing.assert_allclose(M[:3, :3], 3000.0 * 5.0 * 14.0 / 2 * np.eye(3), rtol=1e-9)
    inertia = 3000.0 * (7.0 + 11.0) * 14.0 / 2
    np.testing.assert_allclose(M[3:, 3:], inertia * np.outer(axis, axis), rtol=1e-6, atol=1e-3)
    G = 7e10 / 2.6
    torque = model.stiffness.toarray()[3:, 3:] @ axis
    assert axis @ torque == pytest.approx(G * 13.0 / 14.0, rel=1e-6)


@needs_mystran
def test_updated_beams_are_written_as_beams(deck, tmp_path):
    path = deck(rod_of_bars(tuple(range(1, 11)), "PBEAML,3,2,,ROD\n,1.,.001"))
    changes = {"PBEAML 3": {"stiffness": 1.3, "mass": 1.2}}
    expected = read_model(path, unit="in").scaled(changes)
    write_properties(changes, path, tmp_path / "new.inc")
    text = path.read_text().replace("PBEAML,3,2,,ROD\n,1.,.001", "INCLUDE 'new.inc'")
    model = read_model(deck(text.replace("MAT1,2,3.+7,1.1628+7,.29,7.4851-4\n", "")), unit="in")
    for what in ("stiffness", "mass"):
        a, b = (getattr(one, what).toarray() for one in (model, expected))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * abs(b).max())


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("10,11,0.,1.,0.", "10,11,0.,1.,0.,,\n,,,0.,.1,0.", "its ends have offsets"),
        ("10,11,0.,1.,0.", "10,11,0.,1.,0.,,\n,45", "it has pin flags"),
        ("10,11,0.,1.,0.", "10,11,0.,1.,0.,BOO", "field 9 .OFFT or BIT. is 'BOO'"),
        ("PBEAML,3,2,,ROD\n,1.,0.", constant(station="YES,1.,9."), "not constant .A."),
        ("PBEAML,3,2,,ROD\n,1.,0.", constant(station="YES,.5,,.1"), "not constant .I1."),
        ("PBEAML,3,2,,ROD\n,1.,0.", constant(tail=",,,,,.3"), "CW.A. is 0.3"),
        ("PBEAML,3,2,,ROD\n,1.,0.", constant(tail=",\n,,,,,.2"), "N1.A. is 0.2"),
        ("PBEAML,3,2,,ROD\n,1.,0.", "PBEAML,3,2,,ROD\n,1.,0.,YES,1.,2.,0.", "is not constant"),
        ("PBEAML,3,2,,ROD\n,1.,0.", "PBEAML,3,2,,L\n,1.,2.,.1,.1", "section 'L' is not one of"),
    ],
)
def test_beams_that_are_not_bars_are_refused(deck, old, new, why):
    text = rod_of_bars()
    assert old in text
    new = new.replace("PBARL,1,2,,ROD\n,1.,0.\n", "")
    with pytest.raises(FormatError, match=f"{why}.* not equal to a CBAR.*PARAM,EXTOUT,DMIGPCH"):
        read_model(deck(text.replace(old, new)), unit="in", executable="/bin/true")


@needs_mystran
@pytest.mark.parametrize(("excess", "is_constant"), [(4e-4, True), (6e-4, False)])
def test_sections_that_differ_by_rounding_are_constant(deck, excess, is_constant):
    text = rod_of_bars(sections=constant(station=f"YES,1.,{math.pi * (1 + excess):.9f}"))
    if is_constant:
        assert read_model(deck(text), unit="in").n_dofs == 60
    else:
        with pytest.raises(FormatError, match=r"its section is not constant \(A\)"):
            read_model(deck(text), unit="in")


@needs_mystran
def test_coupled_masses_that_mystran_does_not_have_are_noted(deck):
    text = rod_of_bars().replace("BEGIN BULK", "BEGIN BULK\nPARAM,COUPMASS,1")
    with pytest.warns(UpdynWarning, match="MYSTRAN lumps those of CBAR, CBEAM; for coupled ones"):
        read_model(deck(text), unit="in")
