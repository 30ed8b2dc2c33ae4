"""A short torture of the readers: a few mutants and cuts of every format; `make torture` has more of them."""

from __future__ import annotations

import numpy as np
import pytest

import mutants
import torture
import torture_ends
from mutants import bytes_mutant, text_mutant
from torture import CRASH, EQUAL, EXCEPTION, HANG, MEMORY, OTHER
from torture_programs import SAMPLES
from torture_readers import BOXED
from updyn.foreign import processes

MUTANTS = 12
CUTS = 25
#: What libraries read, each time in a process of its own, takes longer.
OWN = [name for name in SAMPLES if name not in BOXED]
SHARE = 3  # of the trials of others


@pytest.mark.parametrize("name", SAMPLES)
def test_no_mutant_and_no_cut_is_read_wrongly_or_ends_a_reader(name, tmp_path):
    """In this process, as nothing is expected to end it."""
    if name in BOXED and not processes._CAN_FORK:
        pytest.skip("half a second for each file")
    tortures = torture.tortures()
    for kind, most in (("mutants", MUTANTS), ("cuts", CUTS)):
        one = tortures[f"{name}: {kind}"]
        for seed in one.seeds(most // SHARE if name in BOXED else most):
            outcome = one.trial(seed, tmp_path)
            assert not outcome.failed, f"{kind}, seed {seed}: {outcome}"


def test_the_last_characters_of_every_text_are_cut_off_one_by_one(tmp_path):
    tortures = torture.tortures()
    for name in OWN:
        if SAMPLES[name]().is_text:
            one = tortures[f"{name}: cuts"]
            for seed in range(one.size() - 6, one.size()):
                outcome = one.trial(seed, tmp_path)
                assert not outcome.failed, f"{name}, cut at {seed}: {outcome}"


def test_mutants_come_from_their_seed_alone():
    raw = b"".join(b"%d, 2.5e3, word %d\n" % (i, i) for i in range(40))
    for mutant in (text_mutant, bytes_mutant):
        found = [mutant(raw, np.random.default_rng(seed)) for seed in range(60)]
        assert found == [mutant(raw, np.random.default_rng(seed)) for seed in range(60)]
        assert len(set(found)) > 50


def test_parts_of_parts_many_times_do_not_fill_the_memory():
    for seed in range(10):
        random = np.random.default_rng(seed)
        raw = bytes(2**16)
        for _ in range(4):
            raw = mutants._part_many_times(raw, random)
        assert len(raw) <= mutants.LARGEST


def test_every_end_of_a_trial_is_counted_and_the_next_one_goes_on(monkeypatch):
    monkeypatch.setenv("TORTURES", "torture_ends")
    (one,) = torture_ends.tortures()
    found = dict(torture.run(one, range(7)))
    words = [found[seed].word for seed in range(7)]
    assert words == [EQUAL, CRASH, EXCEPTION, HANG, MEMORY, OTHER, EQUAL]
    assert [found[seed].failed for seed in range(7)] == [False, *[True] * 5, False]
    assert "KeyError" in found[2].detail
    assert "Aborted" in found[1].detail
