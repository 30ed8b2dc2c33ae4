"""Modes that an update moved away from the test."""

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.dynamics.modes import Modes
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.modal_table import ModalRow, ModalTable, ModeEntry
from updyn.updating.judge.trust import Trust
from updyn.updating.judge.worsened import _compare_row, find_worsened_modes, judge_modes

SHAPES = np.array([[1.0, 1.0, 1.0], [2.0, 0.5, -1.0], [3.0, -1.5, 0.5]])
MEASURED = np.array([10.0, 30.0, 60.0])
DOFS = updyn.DofSet(["1:X", "2:X", "3:X"])


def modes(off, shapes=SHAPES):
    """Modes whose frequencies are off by some percent."""
    return Modes(MEASURED * (1.0 + np.array(off) / 100.0), np.full(3, 0.02), shapes, DOFS)


def table(start, updated, shapes=SHAPES):
    return ModalTable(modes([0.0, 0.0, 0.0]), modes(start), modes(updated, shapes))


def verdict(plausible=True):
    yes = Claim(True, "Yes.")
    return Trust(yes, yes, yes, Claim(plausible, "Half of the values are close."))


@pytest.mark.parametrize(
    ("start", "updated", "worse"),
    [
        ([2.0, -1.0, 0.5], [5.0, 0.2, 0.1], [10.0]),
        ([2.0, -1.0, 0.5], [-5.0, 0.2, -4.0], [10.0, 60.0]),
        ([2.0, -1.0, 0.5], [1.9, -0.9, 0.4], []),
        # Below 1 %, and by less than a tenth, nothing is said.
        ([0.1, 0.1, 0.1], [0.9, 0.1, 0.1], []),
        ([4.0, 0.1, 0.1], [4.3, 0.1, 0.1], []),
        ([4.0, 0.1, 0.1], [4.5, 0.1, 0.1], [10.0]),
    ],
)
def test_a_frequency_that_is_farther_off_than_at_the_start_is_named(start, updated, worse):
    assert [one.frequency for one in find_worsened_modes(table(start, updated))] == worse


def test_a_shape_that_agrees_less_is_named():
    turned = SHAPES.copy()
    turned[:, 1] += 0.5 * SHAPES[:, 2]
    (found,) = find_worsened_modes(table([0.0] * 3, [0.0] * 3, turned))
    assert found.statement.startswith("the MAC of the mode at 30 Hz fell from 1.00 to 0.")


@pytest.mark.parametrize(("off", "holds"), [(5.0, False), (2.9, True)])
def test_more_than_three_percent_is_not_plausible(off, holds):
    found = judge_modes(verdict(), [table([2.0, 0.0, 0.0], [off, 0.0, 0.0])])
    assert found.plausible.holds is holds
    assert (
        f"the error of the natural frequency 10 Hz rose from 2 % to {off:.2g} %"
        in found.plausible.why
    )


def test_where_held_out_data_speak_against_an_answer_the_mode_is_named_beside_that():
    unpredicted = dataclasses.replace(verdict(), validated=Claim(False, "Not predicted."))
    found = judge_modes(unpredicted, [table([2.0, 0.0, 0.0], [5.0, 0.0, 0.0])])
    assert found.plausible.holds is True
    assert "the error of the natural frequency 10 Hz rose from 2 % to 5 %" in found.plausible.why


def test_an_answer_that_is_not_plausible_stays_so():
    bad = verdict(plausible=False)
    assert judge_modes(bad, [table([2.0, 0.0, 0.0], [5.0, 0.0, 0.0])]) is bad
    assert judge_modes(verdict(), []) == verdict()


def test_the_frequency_of_a_poor_pair_is_not_judged():
    """A pair of a MAC below 0.8 may be one by chance."""
    turned = SHAPES.copy()
    turned[:, 0] += SHAPES[:, 1]
    found = find_worsened_modes(table([2.0, 0.0, 0.0], [5.0, 0.0, 0.0], turned))
    assert all("MAC" in one.statement for one in found)


@pytest.mark.parametrize(
    ("first", "last", "is_named"),
    [(0.8, 0.76, False), (0.8, 0.74, True), (1.0, 0.91, False), (1.0, 0.89, True)],
)
def test_a_mac_is_named_from_a_loss_of_a_twentieth_to_below_nine_tenths(first, last, is_named):
    test = ModeEntry(0, 10.0, 0.02)
    start, updated = (ModeEntry(0, 10.0, 0.02, 0.0, mac) for mac in (first, last))
    assert bool(_compare_row(ModalRow(test, start, updated))) is is_named
