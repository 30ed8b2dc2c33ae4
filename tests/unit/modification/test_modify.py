"""`updyn.modify`: values by the changed model, intervals by draws of the unknowns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.updating.judge.alternatives import Alternative


@pytest.fixture(scope="module")
def result():
    model = chain.build()
    unknowns = updyn.parameters(model, stiffness="all", mass=["part1", "part2"], loss_factor="all")
    return updyn.update(model, chain.measure(), unknowns, starts=0)


def add_ballast(model):
    return model.with_element("ballast", ["12:X"], mass=0.5)


@pytest.fixture(scope="module")
def found(result):
    return updyn.modify(result, add_ballast, 5)


def draw_models(result, n, seed=0):
    """Updated models at draws from the covariance."""
    rng = np.random.default_rng(seed)
    estimate = [result.values[p.name] for p in result.parameters]
    for x in rng.multivariate_normal(estimate, result.covariance, n):
        yield result.parameters.apply(result.start, np.maximum(x, 0.0))


def test_frequencies_are_those_of_both_models(result, found):
    before = updyn.modes(result.model, 5).frequency
    after = updyn.modes(add_ballast(result.model), 5).frequency
    assert [mode.before for mode in found.modes] == pytest.approx(before)
    assert [mode.after for mode in found.modes] == pytest.approx(after)
    assert all(mode.change < 0.0 for mode in found.modes)


def test_standard_deviations_are_those_of_draws(result, found):
    drawn = np.array(
        [
            (updyn.modes(m, 5).frequency, updyn.modes(add_ballast(m), 5).frequency)
            for m in draw_models(result, 400)
        ]
    )
    before, after = drawn.std(axis=0, ddof=1)
    change = np.diff(drawn, axis=1)[:, 0].std(axis=0, ddof=1)
    close = {"rel": 0.15}  # of 400 draws: 3.5 % is the standard deviation
    assert [mode.std_before for mode in found.modes] == pytest.approx(before, **close)
    assert [mode.std_after for mode in found.modes] == pytest.approx(after, **close)
    assert [mode.std_change for mode in found.modes] == pytest.approx(change, **close)


def test_frfs_and_their_deviation_are_those_of_draws(result, found):
    freq, ends = [1.0, 4.0, 9.0], (["12:X", "5:X"], ["1:X"])
    one = found.frf(freq, *ends, quantity="accelerance")

    def solve(model):
        return updyn.response(model, freq, *ends, quantity="accelerance").values

    np.testing.assert_allclose(one.before.values, solve(result.model), rtol=1e-9)
    np.testing.assert_allclose(one.after.values, solve(add_ballast(result.model)), rtol=1e-9)
    drawn = np.array(
        [
            20.0 * np.log10(np.abs(solve(add_ballast(m)) / solve(m)))
            for m in draw_models(result, 400)
        ]
    )
    np.testing.assert_allclose(one.std_db, drawn.std(axis=0, ddof=1), rtol=0.15)
    low, high = one.interval()
    inside = (drawn > low) & (drawn < high)
    assert 0.92 < inside.mean() < 0.98


def test_a_group_is_scaled_from_its_updated_value(result):
    found = updyn.modify(result, lambda m: m.scaled({"part3": {"stiffness": 1.5}}), 3)
    expected = result.model.scaled({"part3": {"stiffness": 1.5}})
    assert [mode.after for mode in found.modes] == pytest.approx(updyn.modes(expected, 3).frequency)


def test_a_stated_loss_factor_replaces_the_unknown(result):
    found = updyn.modify(result, lambda m: m.scaled({"part1": {"loss_factor": 0.2}}), 3)
    assert found.after.groups["part1"].loss_factor == 0.2
    freq, ends = [2.0, 5.0], (["12:X"], ["1:X"])
    expected = updyn.response(found.after, freq, *ends).values
    one = found.frf(freq, *ends, quantity="receptance")
    np.testing.assert_allclose(one.after.values, expected, rtol=1e-9)
    same = updyn.modify(result, lambda m: m, 3)
    assert same.modes[0].std_change < 1e-9 * same.modes[0].std_before


def test_an_undetermined_combination_gives_no_interval():
    model = chain.build()
    twice = updyn.parameters(model, stiffness=["part1"]) + updyn.link(
        model, "part1.copy", ["part1.stiffness"]
    )
    modes = updyn.modes(model, 3)
    data = updyn.ModeSet(modes.frequency, std_frequency=1e-3 * modes.frequency)
    found = updyn.modify(updyn.update(model, data, twice, starts=0), add_ballast, 2)
    assert np.isnan(found.modes[0].std_change)
    assert "not determined" in found.summary()


def test_modes_that_change_their_order_are_followed():
    """Two uncoupled masses: the first overtakes the second."""
    groups = {
        "low": updyn.Group(np.diag([1e3, 0.0]), np.diag([1.0, 0.0])),
        "high": updyn.Group(np.diag([0.0, 4e3]), np.diag([0.0, 1.0])),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    modes = updyn.modes(model, 2)
    data = updyn.ModeSet(modes.frequency, std_frequency=1e-3 * modes.frequency)
    result = updyn.update(model, data, updyn.parameters(model, stiffness="all"), starts=0)
    found = updyn.modify(result, lambda m: m.scaled({"low": {"stiffness": 9.0}}), 2)
    low, high = np.sqrt([1e3, 4e3]) / (2.0 * np.pi)
    assert [mode.after for mode in found.modes] == pytest.approx([3.0 * low, high], rel=1e-4)
    assert [mode.similarity for mode in found.modes] == pytest.approx([1.0, 1.0])
    # The frequency is proportional to the square root of the stiffness, before and after.
    first = found.modes[0]
    # Nothing couples the masses.
    assert np.isnan(found.frf([1.0], ["2:X"], ["1:X"]).change_db).all()
    assert first.std_change == pytest.approx(2.0 * first.std_before, rel=1e-6)
    assert first.interval(0.6827) == pytest.approx(
        (first.change - first.std_change, first.change + first.std_change), rel=1e-4
    )


@pytest.fixture(scope="module")
def mirrored():
    """Five masses between two walls, measured amid: the springs to the walls may be exchanged."""
    outer, inner = np.zeros((2, 5, 5)), np.zeros((5, 5))
    outer[0, 0, 0] = outer[1, 4, 4] = 3e4
    for i in range(4):
        inner[i : i + 2, i : i + 2] += 4e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "left": updyn.Group(outer[0], loss_factor=0.02),
        "row": updyn.Group(inner, np.eye(5), loss_factor=0.02),
        "right": updyn.Group(outer[1], loss_factor=0.02),
    }
    start = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(5)])
    true = start.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    frf = updyn.response(true, np.linspace(5.0, 70.0, 60), ["3:X"], ["3:X"])
    noise = np.random.default_rng(0).standard_normal((2, *frf.values.shape)) * 0.007
    frf = dataclasses.replace(frf, values=frf.values * (1.0 + noise[0] + 1j * noise[1]))
    unknowns = updyn.parameters(start, stiffness=["left", "right"])
    result = updyn.update(start, frf, unknowns, noise={"relative": 0.01})
    assert len(result.alternatives) == 1
    return result


def modify_at(result, label):
    with pytest.warns(updyn.UpdynWarning, match="others has the effect by each"):
        return updyn.modify(result, lambda m: m.with_element("mass", [label], mass=0.5), 4)


def test_the_effect_by_another_answer_is_that_of_the_mirrored_change(mirrored):
    left, right = modify_at(mirrored, "1:X"), modify_at(mirrored, "5:X")
    (other,) = left.others
    for name in ("change", "std_change", "std_after"):
        by_other = [getattr(mode, name) for mode in other.modes]
        expected = [getattr(mode, name) for mode in right.modes]
        assert by_other == pytest.approx(expected, rel=1e-3)
    assert other.modes[0].change != pytest.approx(left.modes[0].change, rel=1e-2)
    one, two = other.frf([20.0], ["2:X"], ["3:X"]), right.frf([20.0], ["4:X"], ["3:X"])
    assert one.change_db[0, 0, 0] == pytest.approx(two.change_db[0, 0, 0], rel=1e-3)
    assert "By answer 2, which fits as well:" in left.summary()
    assert left.summary().endswith(other.summary())
    assert left._repr_html_().count("<table") == 2


def test_errors_of_the_model_widen_the_effect_by_another_answer(mirrored):
    wide = dataclasses.replace(mirrored, covariance=4.0 * mirrored.covariance)
    (other,), (expected,) = modify_at(wide, "1:X").others, modify_at(mirrored, "1:X").others
    assert other.modes[0].std_change == pytest.approx(2.0 * expected.modes[0].std_change, rel=1e-6)


def test_other_answers_of_modes_are_stated(result):
    modes = updyn.modes(result.model, 3)
    data = updyn.ModeSet(modes.frequency, std_frequency=1e-3 * modes.frequency)
    unknowns = updyn.parameters(result.start, stiffness="part1")
    found = updyn.update(result.start, data, unknowns, starts=0)
    other = Alternative({"part1.stiffness": 2.0}, 1.0)
    found = dataclasses.replace(found, alternatives=(other,))
    with pytest.warns(updyn.UpdynWarning, match="1 other answer that .* only this is given"):
        assert updyn.modify(found, add_ballast, 1).others == ()


def test_intervals_are_those_of_student_if_the_noise_is_estimated_from_few_numbers(result):
    few = dataclasses.replace(result, noise={**result.noise, "degrees_of_freedom": 4})
    found = updyn.modify(few, add_ballast, 1)
    mode, frf = found.modes[0], found.frf([5.0], ["12:X"], ["1:X"])
    quantile = 2.7764451  # of 4 degrees of freedom, as tabulated
    assert mode.interval()[1] == pytest.approx(mode.change + quantile * mode.std_change, rel=1e-6)
    assert frf.interval()[1] == pytest.approx(frf.change_db + quantile * frf.std_db, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: None, "expected a function that returns a Model, found None"),
        (lambda m: updyn.Model.from_groups({"a": updyn.Group([[1.0]])}, ["1:X"]), "1 DOFs"),
        (
            lambda m: m.with_element("x", ["1:X"], mass=float(m.groups["part1"].mass.sum())),
            "depends on the values of the unknowns",
        ),
    ],
)
def test_errors(result, change, message):
    with pytest.raises(updyn.UpdynError, match=message):
        updyn.modify(result, change)
