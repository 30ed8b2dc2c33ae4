"""Places and kinds of several nonlinear elements, against simulated truths."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError

NOISE = {"relative": 0.01}
AT = ["1:X", "2:X", "3:X"]
FREQ = np.linspace(4.0, 32.0, 30)
PLACES = {"joint": ["1:X", "2:X"], "end": ["3:X"], "ground": ["1:X"]}
KINDS = ["cubic-spring", "quadratic-damper"]
SPRING, DAMPER = updyn.CubicSpring(5e7), updyn.QuadraticDamper(20.0)


def three_masses() -> updyn.Model:
    K = 1e4 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    groups = {"k": updyn.Group(K, loss_factor=0.03), "m": updyn.Group(mass=np.eye(3))}
    return updyn.Model.from_groups(groups, AT)


MODEL = three_masses()


BOTH = {"a": (SPRING, PLACES["joint"]), "b": (DAMPER, PLACES["end"])}


@cache
def measure(names="", excitation="sine"):
    """Noisy FRFs of the masses with some of the elements at two levels."""
    rng, tests = np.random.default_rng(0), []
    elements = {name: BOTH[name] for name in names}
    for level in (1.0, 4.0):
        frf = updyn.response(MODEL, FREQ, AT, ["3:X"]).with_level(level)
        if elements:
            true = MODEL.with_elements(elements)
            how = {"level": level, "excitation": excitation}
            frf = updyn.response(true, FREQ, AT, ["3:X"], **how).frf
        draw = rng.standard_normal((2, *frf.values.shape)) / np.sqrt(2.0)
        tests.append(replace(frf, values=frf.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]))))
    return tests


def test_two_elements_are_found_with_their_parameters():
    found = updyn.locate_nonlinearities(MODEL, measure("ab"), PLACES, KINDS, noise=NOISE)
    named = {(one.place, one.kind): one for one in found}
    assert set(named) == {("joint", "cubic-spring"), ("end", "quadratic-damper")}
    assert found.is_adequate
    assert found.residual == pytest.approx(1.0, abs=0.1)
    assert found.linear_residual > 5.0
    for one, true in zip(sorted(found, key=lambda x: x.kind), (SPRING, DAMPER), strict=True):
        error = one.element.coefficient - true.coefficient
        assert abs(error) < 4.0 * one.std["coefficient"] < 0.2 * true.coefficient
        assert one.log_odds > 100.0
        assert one.model.nonlinear[one.name].element == one.element
    assert set(found.model.nonlinear) == {one.name for one in found}
    assert found.further is not None
    assert not found.further.is_likely


def test_noise_that_is_not_stated_is_estimated_anew_with_each_element():
    found = updyn.locate_nonlinearities(MODEL, measure("ab"), PLACES, KINDS)
    named = {(one.place, one.kind) for one in found}
    assert named == {("joint", "cubic-spring"), ("end", "quadratic-damper")}
    assert found.residual == pytest.approx(1.0, abs=0.1)


def test_two_elements_are_found_in_random_tests():
    tests = measure("ab", "random")
    found = updyn.locate_nonlinearities(MODEL, tests, PLACES, KINDS, noise=NOISE, most=2)
    assert {(one.place, one.kind) for one in found} == {
        ("joint", "cubic-spring"), ("end", "quadratic-damper"),
    }  # fmt: skip
    assert found.is_adequate


def test_a_second_element_is_not_reported_for_one():
    found = updyn.locate_nonlinearities(MODEL, measure("a"), PLACES, KINDS, noise=NOISE)
    assert [(one.place, one.kind) for one in found] == [("joint", "cubic-spring")]


def test_a_linear_structure_has_none():
    found = updyn.locate_nonlinearities(MODEL, measure(), PLACES, KINDS, noise=NOISE)
    assert not len(found)
    assert found.statement.startswith("No nonlinear element is needed")
    assert found.residual == found.linear_residual == pytest.approx(1.0, abs=0.1)


def test_a_known_element_is_kept_and_its_unknowns_are_fitted():
    """The spring is known to exist, with a coefficient off by a factor of two."""
    known = MODEL.with_elements({"a": (updyn.CubicSpring(1e8), PLACES["joint"])})
    unknowns = updyn.parameters(known, nonlinear="all")
    location = updyn.locate_nonlinearity(
        known, measure("ab"), PLACES, KINDS, unknowns=unknowns, noise=NOISE
    )
    assert (location.best.place, location.best.kind) == ("end", "quadratic-damper")
    assert location.best.values["a.coefficient"] == pytest.approx(5e7, rel=0.05)
    assert location.best.element.coefficient == pytest.approx(20.0, rel=0.02)
    assert location.is_adequate


def test_a_known_element_without_unknowns_is_used_as_it_is():
    known = MODEL.with_elements({"a": BOTH["a"]})
    location = updyn.locate_nonlinearity(known, measure("ab"), PLACES, KINDS, noise=NOISE)
    assert (location.best.place, location.best.kind) == ("end", "quadratic-damper")
    assert location.best.n_unknowns == 1
    assert location.best.model.nonlinear["a"].element == SPRING
    alone = measure("a")
    assert not updyn.locate_nonlinearity(known, alone, PLACES, KINDS, noise=NOISE).is_likely


def test_linear_unknowns_are_fitted_with_all_elements():
    wrong = MODEL.scaled({"k": {"stiffness": 1.2}})
    unknowns = updyn.parameters(wrong, stiffness="k", loss_factor="k")
    found = updyn.locate_nonlinearities(
        wrong, measure("ab"), PLACES, KINDS, unknowns=unknowns, noise=NOISE, most=2
    )
    assert {one.place for one in found} == {"joint", "end"}
    assert found.further is None
    assert found.values["k.stiffness"] == pytest.approx(1.0 / 1.2, rel=0.01)
    assert set(found.values) == {"k.stiffness", "k.loss_factor"}


def test_results_are_tables_and_records():
    found = updyn.locate_nonlinearities(MODEL, measure("a"), PLACES, KINDS, noise=NOISE, most=1)
    assert list(found.to_pandas()["place"]) == ["joint"]
    record = found.to_dict()
    assert record["found"][0]["parameters"]["coefficient"] == found[0].element.coefficient
    assert record["found"][0]["search"]["likely"] is True
    assert "cubic-spring at joint: coefficient" in found.summary()
    assert repr(found) == "LocatedNonlinearities(cubic-spring at joint)"


@pytest.mark.parametrize("most", [0, 1.5, True])
def test_an_invalid_number_of_elements_is_refused(most):
    with pytest.raises(OptionError, match="most: expected a whole number of at least 1"):
        updyn.locate_nonlinearities(MODEL, measure(), PLACES, noise=NOISE, most=most)
