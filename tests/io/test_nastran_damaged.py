"""Damaged Nastran files: whatever is wrong with them, what is raised is an error of ours."""

import contextlib
import random
import warnings

import numpy as np
import pytest

from nastran_decks import plate
from updyn.dofs import DofSet
from updyn.errors import UpdynError, UpdynWarning
from updyn.io.nastran.bdf import read_geometry, write_properties
from updyn.io.nastran.deck import read_deck
from updyn.io.nastran.dmig import read_dmig, write_dmig
from updyn.io.nastran.op4 import read_op4, write_op4

A = np.diag([1.0, 2.0, 0.0, 4.0]) + 0.5
TOUCHES = b"0123456789 ,.-+*$\n'"


def read_whole_deck(path):
    read_geometry(path)
    deck = read_deck(path)
    for what in ("SPC", "MPC"):
        with contextlib.suppress(UpdynError):
            deck.selected(what, None)
    changes = {name: {"stiffness": 1.1} for name in deck.groups}
    write_properties(changes, path, path.with_suffix(".out"))


def op4(path, text, layout):
    write_op4({"K": A}, path, text=text, layout=layout)


SEEDS = {
    **{
        f"{layout}-{'text' if text else 'binary'}": (
            read_op4,
            lambda p, t=text, y=layout: op4(p, t, y),
        )
        for layout in ("dense", "strings", "bigmat")
        for text in (True, False)
    },
    "dmig": (read_dmig, lambda p: write_dmig({"K": A}, DofSet(["1:X", "2:Y", "3:Z", "4:RX"]), p)),
    "deck": (read_whole_deck, lambda p: p.write_text(plate())),
}


def damaged(raw, chance):
    out = bytearray(raw)
    for _ in range(chance.randint(1, 4)):
        at, kind = chance.randrange(len(out)), chance.random()
        if kind < 0.5:
            out[at] = chance.choice([chance.randrange(256), *TOUCHES])
        elif kind < 0.75:
            del out[at : at + chance.randint(1, 20)]
        else:
            out[at:at] = bytes(chance.choice(TOUCHES) for _ in range(chance.randint(1, 9)))
    return bytes(out)


@pytest.mark.parametrize("seed", SEEDS)
def test_only_our_errors(tmp_path, seed):
    read, write = SEEDS[seed]
    path = tmp_path / "x"
    write(path)
    good, chance, refused = path.read_bytes(), random.Random(seed), 0
    for _ in range(200):
        path.write_bytes(damaged(good, chance))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)
            try:
                read(path)
            except UpdynError:
                refused += 1
    assert refused > 20
