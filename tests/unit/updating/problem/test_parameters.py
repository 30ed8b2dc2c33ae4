"""The unknowns: choosing, bounds, priors, starts, application."""

from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest

from updyn.errors import ModelError, ParameterError
from updyn.model import Group, Model
from updyn.updating.problem.parameters import DEFAULT_BOUNDS, Parameter, ParameterSet, parameters


def raises(text: str, kind: type[Exception] = ParameterError):
    return pytest.raises(kind, match=re.escape(text))


@pytest.fixture
def model() -> Model:
    eye = np.eye(1)
    return Model.from_groups(
        {
            "gear1": Group(eye, eye, loss_factor=0.02),
            "gear2": Group(eye, eye),
            "spring": Group(eye, loss_factor=7.0),
            "mass": Group(mass=eye),
            "damper": Group(viscous=eye),
        },
        ["1:X"],
    )


# -- one unknown -------------------------------------------------------------------------------------------
def test_a_parameter():
    p = Parameter("shaft", "stiffness", 1, 0.5, 2, prior_std=0.3)
    assert (p.name, p.is_factor) == ("shaft.stiffness", True)
    assert (p.start, p.lower, p.upper, p.prior_std) == (1.0, 0.5, 2.0, 0.3)
    assert type(p.start) is float
    assert not Parameter("shaft", "loss_factor", 0, 0, 1).is_factor


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("a", "mas", 1, 0.5, 2), "no quantity 'mas'; did you mean 'mass'?"),
        (
            ("a", "mass", 1, 2, 0.5),
            "unknown 'a.mass': bounds (2, 0.5); expected the lower one first",
        ),
        (("a", "mass", 1, 1, 1), "unknown 'a.mass': bounds (1, 1); expected the lower one first"),
        (
            ("a", "mass", 1, 0.5, np.inf),
            "unknown 'a.mass': upper: expected a finite number, found inf",
        ),
        (
            ("a", "mass", np.nan, 0.5, 2),
            "unknown 'a.mass': start: expected a finite number, found nan",
        ),
        (
            ("a", "mass", "1", 0.5, 2),
            "unknown 'a.mass': start: expected a finite number, found '1'",
        ),
        (
            ("a", "mass", 1, True, 2),
            "unknown 'a.mass': lower: expected a finite number, found True",
        ),
        (("a", "mass", 3, 0.5, 2), "unknown 'a.mass' starts at 3, outside its bounds (0.5, 2)"),
        (("a", "mass", 1, 0, 2), "unknown 'a.mass' is a factor: its lower bound 0 must be above 0"),
        (
            ("a", "viscous", 1, -1, 2),
            "unknown 'a.viscous' is a factor: its lower bound -1 must be above 0",
        ),
        (
            ("a", "loss_factor", 0, -0.1, 2),
            "a loss factor below 0 feeds energy in; lower bound -0.1",
        ),
        (("a", "mass", 1, 0.5, 2, 0), "unknown 'a.mass': prior_std 0; expected a number above 0"),
        (("a", "mass", 1, 0.5, 2, -1), "unknown 'a.mass': prior_std -1; expected a number above 0"),
        (
            ("a", "mass", 1, 0.5, 2, "x"),
            "unknown 'a.mass': prior_std: expected a finite number, found 'x'",
        ),
    ],
)
def test_a_parameter_is_checked(arguments, text):
    with raises(text):
        Parameter(*arguments)


# -- choosing ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("chosen", "names"),
    [
        ({"stiffness": "gear1"}, ["gear1.stiffness"]),
        ({"stiffness": ["gear2", "gear1"]}, ["gear1.stiffness", "gear2.stiffness"]),
        ({"stiffness": "gear*"}, ["gear1.stiffness", "gear2.stiffness"]),
        (
            {"stiffness": ["gear?", "spring", "gear1"]},
            ["gear1.stiffness", "gear2.stiffness", "spring.stiffness"],
        ),
        ({"stiffness": "all"}, ["gear1.stiffness", "gear2.stiffness", "spring.stiffness"]),
        ({"mass": "all"}, ["gear1.mass", "gear2.mass", "mass.mass"]),
        ({"viscous": "all"}, ["damper.viscous"]),
        ({"loss_factor": "s*"}, ["spring.loss_factor"]),
        (
            {"mass": "*"},
            ["gear1.mass", "gear2.mass", "mass.mass"],
        ),  # a glob leaves out what has no mass
        (
            {"loss_factor": "gear1", "stiffness": "gear*", "mass": "gear1"},
            ["gear1.mass", "gear1.stiffness", "gear1.loss_factor", "gear2.stiffness"],
        ),
    ],
)
def test_what_is_chosen(model, chosen, names):
    assert parameters(model, **chosen).names == names


def test_starts_and_default_bounds(model):
    got = parameters(
        model,
        stiffness="gear1",
        mass="gear1",
        loss_factor=["gear1", "gear2", "spring"],
        viscous="damper",
    )
    assert got.names[:3] == ["gear1.mass", "gear1.stiffness", "gear1.loss_factor"]
    assert got.start.tolist() == [1.0, 1.0, 0.02, 0.0, 7.0, 1.0]
    assert got.lower.tolist() == [0.01, 0.01, 0.0, 0.0, 0.0, 0.001]
    assert got.upper.tolist() == [
        100.0,
        100.0,
        10.0,
        10.0,
        14.0,
        1000.0,
    ]  # 14: twice the start of 7
    assert got.is_factor.tolist() == [True, True, False, False, False, True]
    assert [p.prior_std for p in got] == [None] * 6
    assert DEFAULT_BOUNDS["loss_factor"] == (0.0, 10.0)


@pytest.mark.parametrize(
    ("chosen", "text"),
    [
        ({}, "there is nothing to update: no unknown is chosen"),
        ({"stiffness": []}, "there is nothing to update: no unknown is chosen"),
        ({"stiffness": "gaer1"}, "stiffness: no group 'gaer1'; did you mean 'gear1'"),
        ({"stiffness": "GEAR1"}, "stiffness: no group 'GEAR1'; did you mean 'gear1'?"),
        (
            {"stiffness": "z*"},
            "stiffness: no group 'z*'; valid: 'gear1', 'gear2', 'spring', 'mass', 'damper'",
        ),
        (
            {"mass": ["gear1", "spring"]},
            "mass: group 'spring' has no mass; valid: 'gear1', 'gear2', 'mass'",
        ),
        ({"mass": "spri*"}, "mass: group 'spring' has no mass"),
        (
            {"loss_factor": "mass"},
            "loss_factor: group 'mass' has no stiffness; valid: 'gear1', 'gear2', 'spring'",
        ),
        ({"viscous": "gear*"}, "viscous: group 'gear1' has no viscous; valid: 'damper'"),
        ({"stiffness": 5}, "stiffness: expected group names, globs or 'all', found 5"),
        ({"stiffness": [5]}, "stiffness: expected a group name or a glob, found 5"),
    ],
)
def test_choices_are_checked(model, chosen, text):
    with raises(text):
        parameters(model, **chosen)


def test_all_of_nothing():
    with raises("no group of the model has viscous"):
        parameters(Model.from_groups({"a": Group(np.eye(1))}, ["1:X"]), viscous="all")


# -- bounds and priors -------------------------------------------------------------------------------------
def test_the_most_special_bounds_win(model):
    got = parameters(
        model,
        stiffness="all",
        mass="gear1",
        bounds={
            "stiffness": (0.5, 2),
            "gear*": (0.6, 3),
            "*1.*": (0.65, 3.5),
            "gear2.stiffness": [0.7, 4],
        },
    )
    assert {p.name: (p.lower, p.upper) for p in got} == {
        "gear1.mass": (0.6, 3.0),  # the first glob that fits
        "gear1.stiffness": (0.6, 3.0),  # a glob before the quantity
        "gear2.stiffness": (0.7, 4.0),  # the unknown before all
        "spring.stiffness": (0.5, 2.0),  # the quantity
    }


def test_priors_go_by_the_same_keys(model):
    got = parameters(
        model, stiffness="gear*", mass="gear1", prior_std={"stiffness": 0.3, "gear2.stiffness": 0.1}
    )
    assert [(p.name, p.prior_std) for p in got] == [
        ("gear1.mass", None),
        ("gear1.stiffness", 0.3),
        ("gear2.stiffness", 0.1),
    ]


@pytest.mark.parametrize(
    ("bounds", "start"), [((0.1, 0.5), 0.1), ((0.0, 0.01), 0.01), ((0.01, 0.03), 0.02)]
)
def test_a_loss_factor_starts_within_the_bounds_given(model, bounds, start):
    got = parameters(model, loss_factor="gear1", bounds={"loss_factor": bounds})
    assert got[0] == Parameter("gear1", "loss_factor", start, *map(float, bounds))


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (
            {"bounds": {"stiffnes": (0.5, 2)}},
            "bounds: 'stiffnes' is neither a quantity nor an unknown that is chosen",
        ),
        (
            {"bounds": {"mass": (0.5, 2)}},
            "bounds: 'mass' is neither a quantity nor an unknown that is chosen",
        ),
        ({"bounds": {"spring.stiffness": (0.5, 2)}}, "bounds: 'spring.stiffness' is neither"),
        ({"bounds": {5: (0.5, 2)}}, "bounds: 5 is neither"),
        ({"prior_std": {"gear9*": 0.1}}, "prior_std: 'gear9*' is neither"),
        (
            {"bounds": (0.5, 2)},
            "bounds: expected a mapping by quantity, unknown or glob, found (0.5, 2)",
        ),
        (
            {"prior_std": 0.3},
            "prior_std: expected a mapping by quantity, unknown or glob, found 0.3",
        ),
        (
            {"bounds": {"stiffness": 2}},
            "bounds of 'gear1.stiffness': expected (lower, upper), found 2",
        ),
        (
            {"bounds": {"stiffness": (1, 2, 3)}},
            "bounds of 'gear1.stiffness': expected (lower, upper), found (1, 2, 3)",
        ),
        (
            {"bounds": {"stiffness": "12"}},
            "bounds of 'gear1.stiffness': expected (lower, upper), found '12'",
        ),
        (
            {"bounds": {"stiffness": ("a", 3)}},
            "bounds of 'gear1.stiffness': expected a finite number, found 'a'",
        ),
        ({"bounds": {"stiffness": (2, 0.5)}}, "unknown 'gear1.stiffness': bounds (2, 0.5)"),
        (
            {"bounds": {"stiffness": (2, 3)}},
            "unknown 'gear1.stiffness' starts at 1, outside its bounds (2, 3)",
        ),
        (
            {"bounds": {"gear*": (0, 3)}},
            "unknown 'gear1.stiffness' is a factor: its lower bound 0 must be above 0",
        ),
        (
            {"prior_std": {"stiffness": 0}},
            "unknown 'gear1.stiffness': prior_std 0; expected a number above 0",
        ),
    ],
)
def test_bounds_and_priors_are_checked(model, more, text):
    with raises(text):
        parameters(model, stiffness="gear*", **more)


def test_an_unfitting_key_names_the_nearest(model):
    with raises("did you mean 'gear2.stiffness' or 'gear1.stiffness'"):
        parameters(model, stiffness="gear*", bounds={"gear.stiffness": (0.5, 2)})


# -- a set -------------------------------------------------------------------------------------------------
def test_a_set_is_a_sequence(model):
    got = parameters(model, stiffness="all")
    assert len(got) == 3
    assert got[0].name == "gear1.stiffness"
    assert got[-1].name == "spring.stiffness"
    assert got[1:].names == ["gear2.stiffness", "spring.stiffness"]
    assert [p.name for p in got] == got.names
    assert (got[:1] + got[2:]).names == ["gear1.stiffness", "spring.stiffness"]
    assert got == parameters(model, stiffness="all")
    assert pickle.loads(pickle.dumps(got)) == got  # noqa: S301


def test_an_unknown_stands_once(model):
    got = parameters(model, stiffness="all")
    with raises("unknown 'gear1.stiffness' occurs twice"):
        got + got[:1]
    with raises("there is nothing to update"):
        got[3:]


def test_a_set_cannot_be_changed():
    items = [Parameter("a", "mass", 1, 0.5, 2)]
    got = ParameterSet(items)
    items.append(Parameter("b", "mass", 1, 0.5, 2))
    assert len(got) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        got.items = ()
    with pytest.raises(dataclasses.FrozenInstanceError):
        got[0].start = 2.0


def test_with_start(model):
    got = parameters(model, stiffness="gear*", mass="gear1", bounds={"mass": (0.5, 2)})
    assert got.with_start([1.5, 2, 3]).start.tolist() == [1.5, 2.0, 3.0]
    assert got.with_start({"gear2.stiffness": 4}).start.tolist() == [1.0, 1.0, 4.0]
    moved = got.with_start([1.5, 2, 3])
    assert (moved.lower.tolist(), moved.upper.tolist()) == (got.lower.tolist(), got.upper.tolist())
    assert got.start.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([1.0], "start values: expected 2, found shape (1,)"),
        ([[1.0, 1.0]], "start values: expected 2, found shape (1, 2)"),
        (["a", "b"], "start values: expected 2 numbers"),
        ({"gear1.stifness": 1.0}, "no unknown 'gear1.stifness'; did you mean 'gear1.stiffness'"),
        (
            {"gear1.stiffness": 1e9},
            "unknown 'gear1.stiffness' starts at 1e+09, outside its bounds (0.01, 100)",
        ),
        (
            {"gear1.stiffness": "1"},
            "unknown 'gear1.stiffness': start: expected a finite number, found '1'",
        ),
        ([np.nan, 1.0], "unknown 'gear1.stiffness': start: expected a finite number, found nan"),
    ],
)
def test_with_start_is_checked(model, values, text):
    with raises(text):
        parameters(model, stiffness="gear*").with_start(values)


def test_apply(model):
    got = parameters(model, stiffness="gear*", loss_factor="gear1", mass="mass", viscous="damper")
    assert got.names == [
        "gear1.stiffness",
        "gear1.loss_factor",
        "gear2.stiffness",
        "mass.mass",
        "damper.viscous",
    ]
    changed = got.apply(model, [2.0, 0.5, 3.0, 5.0, 7.0])
    assert changed.stiffness.toarray().tolist() == [[2.0 + 3.0 + 1.0]]
    assert changed.structural.toarray().tolist() == [[0.5 * 2.0 + 7.0 * 1.0]]
    assert changed.mass.toarray().tolist() == [[1.0 + 1.0 + 5.0]]
    assert changed.viscous.toarray().tolist() == [[7.0]]
    assert model.stiffness.toarray().tolist() == [[3.0]]
    with raises("values: expected 5, found shape (4,)"):
        got.apply(model, [1.0] * 4)
    with raises("stiffness nan is not finite", ModelError):
        got.apply(model, [np.nan, 0.5, 3.0, 5.0, 7.0])


def test_many_unknowns():
    """Ten thousand: names are looked up, not searched."""
    items = tuple(Parameter(f"g{i}", "mass", 1.0, 0.5, 2.0) for i in range(10_000))
    got = ParameterSet(items).with_start({p.name: 1.5 for p in items})
    assert got.start.tolist() == [1.5] * 10_000
