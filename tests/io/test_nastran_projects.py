"""Decks as projects have them: cards without effect on the matrices, superelements, old marks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, UpdynWarning
from updyn.io.nastran.deck import read_deck

SPRING = """GRID,1,,0.,0.,0.,,23456
GRID,2,,1.,0.,0.,,123456
CELAS2,1,100.,1,1
CMASS2,2,2.,1,1
"""


@pytest.fixture
def deck(tmp_path):
    def make(text: str, case: str = "") -> Path:
        path = tmp_path / "wing.bdf"
        path.write_text(f"{case}BEGIN BULK\n{SPRING}{text}\nENDDATA\n")
        return path

    return make


def test_neutral_cards_are_named_once_by_purpose(deck):
    cards = "DESVAR,1,T1,1.,.5,2.\nDVPREL1,1,PSHELL,1,T\n,1,1.\nDESVAR,2,T2,1.,.5,2.\nNLPARM,1\n"
    cards += "MDLPRM,HDF5,1\nPLOTEL,9,1,2\nAERO,0,1.,1.,1.\nEIGRL,1,,,3\nFORCE,1,1,,1.,1.,0.,0."
    expected = (
        r"wing.bdf: passed over, because they change neither stiffness nor mass: optimisation:"
        r" DESVAR \(2\), DVPREL1 \(1\); output: PLOTEL \(1\); nonlinear analysis: NLPARM \(1\);"
        r" aeroelasticity: AERO \(1\); parameters: MDLPRM \(1\)$"
    )
    with pytest.warns(UpdynWarning, match=expected) as notes:
        model = updyn.read_model(deck(cards))
    assert len(notes) == 1
    assert model.stiffness.toarray().tolist() == [[100.0]]


def test_eigenvalue_and_load_cards_are_not_noted(deck):
    model = updyn.read_model(deck("EIGRL,1,,,3\nFORCE,1,1,,1.,1.,0.,0.\nTABDMP1,3\n,0.,.01,ENDT"))
    assert model.n_dofs == 1


def test_equations_have_no_fields(deck):
    text = "DEQATN  5       F(A,B,C,D,E,F,G,H,I,J)=A+B+C+D+\n        E+F+G+H+\n+       I+J\nCMASS2,3,1.,1,1"
    with pytest.warns(UpdynWarning, match=r"optimisation: DEQATN \(1\)"):
        model = updyn.read_model(deck(text))
    np.testing.assert_allclose(model.mass.toarray(), [[3.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("MDLPRM,HDF5,1,OFFDEF,LROFF", "MDLPRM: parameter 'OFFDEF' .field 4. may change"),
        ("SELOC,1,1,2,3", "card SELOC belongs to superelements, .*PARAM,EXTOUT,DMIGPCH in bulk"),
        ("CSUPER,1,1,1,2", r"EXTSEOUT\(STIFFNESS,MASS,DMIGPCH\) in case control"),
        ("BEGIN SUPER=1", "wing.bdf:6: 'BEGIN SUPER=1': superelements are not assembled; let"),
        ("BEGIN BULK SUPER=1", "superelements are not assembled; let Nastran punch"),
        ("CWELD,1,1", "card CWELD is not known and may change .*; let Nastran punch the matrices"),
        ("CBUSH2,1,1", "card CBUSH2 is not known and may change .*; did you mean 'CBUSH'"),
    ],
)
def test_cards_that_cannot_be_assembled(deck, text, message):
    with pytest.raises(FormatError, match=message):
        read_deck(deck(text))


def test_marks_agree_in_their_last_characters(deck):
    lines = f"{'CONM2   3       2               7.':<72}CORD1\n{'+ORD1   1.':<72}\n"
    (card,) = read_deck(deck(lines)).cards_named("CONM2")
    assert (card.real(3), card.real(8)) == (7.0, 1.0)


def test_rayleigh_damping_of_the_deck(deck):
    model = updyn.read_model(deck("PARAM,ALPHA1,.3\nPARAM,ALPHA2,.004\nPARAM,OUGCORD,GLOBAL"))
    spring, mass = model.group("CELAS2 1"), model.group("CMASS2 2")
    assert (spring.stiffness_damping, spring.mass_damping) == (0.004, 0.0)
    assert (mass.stiffness_damping, mass.mass_damping) == (0.0, 0.3)
    np.testing.assert_allclose(model.viscous.toarray(), [[0.3 * 2.0 + 0.004 * 100.0]])
