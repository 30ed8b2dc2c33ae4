"""The modal table of a run: in the result of each test, and as text."""

from __future__ import annotations

import dataclasses

import updyn
from report_case import realistic
from updyn.job.modes import modal_texts, with_modes
from updyn.updating.result import JointResult


def test_a_run_has_the_modes_of_its_test():
    result = with_modes(realistic())
    assert len(result.modes.test) == 12
    (text,) = modal_texts(result)
    assert text == result.modes.text()


def test_each_of_several_tests_has_its_own():
    one = realistic()
    shapes = updyn.modes(one.model, 2).at(["1:Z", "4:Z"])
    given = updyn.ModeSet(updyn.modes(one.model, 2).frequency, shapes, ["1:Z", "4:Z"])
    second = dataclasses.replace(one, options={"modes": {"b": given}})
    joint = with_modes(JointResult({"b": second, "c": second}))
    assert len(joint["b"].modes.test) == 2
    assert len(joint["c"].modes.test) == 12  # none was given: identified from its FRFs
    first, other = modal_texts(joint)
    assert first.startswith("b: Modes")
    assert other.startswith("c: Modes")


def test_without_a_look_there_is_nothing_to_say():
    assert modal_texts(realistic()) == []
