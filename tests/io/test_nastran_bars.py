"""Bars of Nastran decks with exchanged section axes."""

import pickle

import numpy as np
import pytest

import updyn
from updyn.errors import ModelError
from updyn.io.nastran.bars import exchanged_bar, fields_to_exchange
from updyn.io.nastran.deck import read_deck
from updyn.variants import build_variants

DECK = (
    "SPC = 1\nBEGIN BULK\n"
    + "".join(f"GRID,{i},,{0.1 * i:.2f},0.,{0.02 * i:.2f}\n" for i in range(1, 8))
    + "".join(f"CBAR,{i},{1 + i // 4},{i},{i + 1},0.,0.,1.\n" for i in range(1, 7))
    + "PBAR,1,1,1.-4,%s,3.-9\n,,,,,,,,\n,%s\nPBARL,2,1,,BAR\n,%s\nMAT1,1,2.1+11,,.3,7850.\n"
    "SPC1,1,123456,1\n"
)
RIGHT = "1.-9,4.-9", ".8,.9", ".01,.02"
WRONG = "4.-9,1.-9", ".9,.8", ".02,.01"


@pytest.fixture
def deck(tmp_path):
    def write(numbers, name="arm.bdf"):
        path = tmp_path / name
        path.write_text(DECK % numbers, encoding="ascii")
        return path

    return write


def test_fields_of_a_bar_are_exchanged(deck):
    pbar, pbarl = (read_deck(deck(RIGHT)).group(name) for name in ("PBAR 1", "PBARL 2"))
    turned = exchanged_bar(pbar)
    assert turned.reals([2, 3, 4, 5, 16, 17]) == [1e-4, 4e-9, 1e-9, 3e-9, 0.9, 0.8]
    assert exchanged_bar(pbarl).reals([8, 9]) == [0.02, 0.01]
    assert fields_to_exchange(pbar) == "I1 and I2 (fields 5 and 6) of PBAR 1 (arm.bdf, line 16)"


def test_a_square_bar_and_one_with_a_product_of_inertia_stay(deck):
    square = read_deck(deck(("1.-9,1.-9", "", ".01,.01")))
    oblique = read_deck(deck(("1.-9,2.-9", ",,1.-10", ".01,.01")))
    assert exchanged_bar(square.group("PBAR 1")) is None
    assert exchanged_bar(square.group("PBARL 2")) is None
    assert exchanged_bar(oblique.group("PBAR 1")) is None


@pytest.mark.kernels
@pytest.mark.needs("mystran")
def test_a_variant_is_the_model_of_the_deck_with_exchanged_fields(deck):
    model, right = updyn.read_model(deck(WRONG)), updyn.read_model(deck(RIGHT, "right.bdf"))
    *each, both = build_variants(pickle.loads(pickle.dumps(model)))  # noqa: S301
    assert [one.groups for one in each] == [("PBAR 1",), ("PBARL 2",)]
    assert both.remedy == (
        "Exchange I1 and I2 (fields 5 and 6) of PBAR 1 (arm.bdf, line 16); DIM1 and DIM2 of"
        " PBARL 2 (arm.bdf, line 19). Or turn the orientation of each by 90 degrees."
    )
    turned = both.model()
    for name, group in right.groups.items():
        for what in ("stiffness", "mass"):
            own, expected = getattr(turned.group(name), what), getattr(group, what)
            scale = abs(expected).max()
            np.testing.assert_allclose(own.toarray(), expected.toarray(), atol=1e-12 * scale)
    deck(RIGHT)
    with pytest.raises(ModelError, match=r"arm\.bdf has changed since the model was read"):
        both.model()
