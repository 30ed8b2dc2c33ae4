"""Damaged Nastran files: whatever is wrong with them, what is raised is an error of ours."""

import contextlib
import random
import struct
import warnings

import numpy as np
import pytest

from nastran_decks import plate
from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynError, UpdynWarning
from updyn.io.nastran import mystran
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
            deck.select_set(what, None)
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


def test_terms_of_mystran_outside_of_the_matrix_are_refused(tmp_path):
    def file(*terms):
        raw = struct.pack("<6i", 4, 3, 4, 4, len(terms), 4)
        raw += b"".join(struct.pack("<3idi", 16, i, j, value, 16) for i, j, value in terms)
        (tmp_path / "run.L1L").write_bytes(raw)
        return tmp_path / "run.L1L"

    user = tmp_path / "wing.bdf"
    found = mystran._symmetric(file((1, 1, 2.0), (1, 2, -1.0), (2, 2, 3.0)), 2, user)
    assert found.toarray().tolist() == [[2.0, -1.0], [-1.0, 3.0]]
    for term in ((0, 1, 2.0), (1, 3, 2.0), (-(2**31), 1, 2.0)):
        with pytest.raises(FormatError, match=r"wing\.bdf: .*\.L1L has a term outside of 2 x 2"):
            mystran._symmetric(file(term), 2, user)
    with pytest.raises(FormatError, match=r"\.L1L has a term that is not finite"):
        mystran._symmetric(file((1, 1, np.nan)), 2, user)


@pytest.mark.parametrize("length", [-1000, 10**6])
def test_a_table_of_mystran_that_is_not_there_is_refused(tmp_path, length):
    (tmp_path / "run.L1C").write_bytes(struct.pack("<i", length) + b"TDOFI" + bytes(100))
    with pytest.raises(FormatError, match=r"wing\.bdf: .*holds no table TDOFI"):
        mystran._dofs(tmp_path / "run.L1C", tmp_path / "wing.bdf")
