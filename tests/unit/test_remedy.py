"""Remedies: their lines are valid TOML or Python, and their text is one paragraph."""

from __future__ import annotations

import tomllib

from updyn.remedy import IN_PYTHON, Remedy, join_remedies
from updyn.updating.judge.causes.catalogue import read_fault


def test_the_setting_of_a_fault_is_toml():
    remedy = read_fault("swapped:7:X,2:X").remedy
    (line,) = remedy.lines
    assert tomllib.loads(line) == {"repair": ["swapped:7:X,2:X"]}
    assert remedy.place == "under [test] of the job"
    assert str(remedy) == (
        'Check this. If it is confirmed, write: repair = ["swapped:7:X,2:X"] under [test] of the'
        " job."
    )


def test_a_remark_comes_after_the_lines():
    remedy = read_fault("mains=50").remedy
    assert tomllib.loads(remedy.lines[0]) == {"repair": ["mains=50"]}
    assert str(remedy).endswith("of the job. Before the next test, check cables and grounding.")


def test_a_table_with_quotes_and_nested_arrays_is_toml():
    settings = {
        "groups": ['PBAR "2"', "Nabe ü"],
        "loss_factor": 0.021,
        "loss_table": [[5.0, 50.0], [1.0, 2.5]],
    }
    remedy = Remedy.table("Add it:", "[[damping]]", settings)
    assert tomllib.loads("\n".join(remedy.lines)) == {"damping": [settings]}
    assert str(Remedy.table("Free it:", "[[parameter]]", {"groups": ["a"], "n": 2})) == (
        'Free it: [[parameter]] with groups = ["a"] and n = 2 at the end of the job.'
    )


def test_statements_of_python_end_the_text():
    remedy = Remedy("Add it:", ("x = 1", "y = x + 1"), IN_PYTHON)
    assert str(remedy) == "Add it: x = 1; y = x + 1"


def test_advice_alone_is_its_text():
    assert str(Remedy("Check the units.")) == "Check the units."
    assert str(Remedy("Check the units.", remark="Then run.")) == "Check the units. Then run."


def test_remedies_are_joined_once_each():
    first, second = Remedy("Do this."), Remedy("Do that.")
    assert join_remedies([first], [], [second, first]) == (first, second)
