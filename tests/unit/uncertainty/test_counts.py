"""Counts that no machine can work off are refused at once, with the largest that is accepted."""

from __future__ import annotations

import pytest

import updyn
from uncertain_cases import without_loss
from updyn.demos import chain
from updyn.errors import OptionError


@pytest.fixture(scope="module")
def fit() -> updyn.UpdateResult:
    return without_loss(seed=1, relative=0.01)


@pytest.mark.parametrize(
    ("function", "options", "message"),
    [
        (updyn.bootstrap, {"n": 10**12}, "n = 1000000000000: expected at most 1,000,000 refits"),
        (updyn.bootstrap, {"n": 1}, "n = 1: expected a number of refits from 2 up"),
        (updyn.sample, {"n": 10**12}, "n = 1000000000000: expected at most 1,000,000 effective"),
        (updyn.sample, {"n": 2.5}, "n = 2.5: expected a number of effective draws from 1 up"),
        (updyn.sample, {"max_evaluations": 10**12}, "at most 10,000,000 evaluations"),
        (updyn.sample, {"starts": 10**9}, "starts = 1000000000: expected at most 10,000 starts"),
        (updyn.sample, {"starts": -2}, "starts = -2: expected a number of starts from 0 up"),
        (updyn.profile, {"starts": 10**9}, "starts = 1000000000: expected at most 10,000 starts"),
        (updyn.profile, {"starts": True}, "starts = True: expected a number of starts"),
    ],
)
def test_counts_of_uncertainty(fit, function, options, message) -> None:
    with pytest.raises(OptionError, match=message) as caught:
        function(fit, **options)
    assert caught.value.key == tuple(options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robust": 10**12}, "robust = 1000000000000: expected at most 1,000 starts"),
        ({"lines": 10**12}, "lines = 1000000000000: expected 2 to 100,000 lines"),
        ({"lines": 1}, "lines = 1: expected 2 to 100,000 lines"),
    ],
)
def test_counts_of_a_plan(options, message) -> None:
    model = chain.build()
    unknowns = updyn.parameters(model, stiffness="all")
    with pytest.raises(OptionError, match=message) as caught:
        updyn.plan(model, unknowns, "all", 2, 1, (0.5, 12.0), **options)
    assert caught.value.key == tuple(options)


def test_starts_of_a_search() -> None:
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all")
    with pytest.raises(OptionError, match="option starts = 1000000000000: expected at most 10,000"):
        updyn.update(model, frf, unknowns, starts=10**12)


def test_members_of_a_family(fit) -> None:
    with pytest.raises(OptionError, match="n = 1000000000000; expected at most 10,000 members"):
        updyn.plant_family(fit, ["1:X"], ["1:X"], (1.0, 2.0), n=10**12)
