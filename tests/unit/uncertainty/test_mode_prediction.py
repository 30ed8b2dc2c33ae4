"""Modes of the updated structure with standard deviations: closed forms, draws, close modes, tiers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import updyn
from uncertain_cases import noisy, springs
from updyn.errors import DofError, OptionError
from updyn.uncertainty.mode_prediction import exclude_span

LINES = np.linspace(1.0, 14.0, 60)
LABELS = [f"{i}:X" for i in range(1, 7)]


def row(n: int = 6, *, one: bool = False) -> updyn.Model:
    """Masses in a row between walls, the springs in three groups, or in one."""
    pairs = [(i, i + 1 if i < n else 0, 900.0) for i in range(n + 1)]
    third = len(pairs) if one else len(pairs) // 3 + 1
    names = ("left", "middle", "right")
    groups = {
        name: updyn.Group(springs(*pairs[k * third : (k + 1) * third], n=n), loss_factor=0.02)
        for k, name in enumerate(names)
        if pairs[k * third : (k + 1) * third]
    }
    groups["masses"] = updyn.Group(mass=np.eye(n))
    return updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, n + 1)])


def fit(model: updyn.Model, *, sensors: tuple[str, ...] = ("1:X", "3:X"), **unknowns: object):
    frf = noisy(updyn.response(model, LINES, sensors, ["1:X"]), 0, 0.02)
    parameters = updyn.parameters(model, **(unknowns or {"stiffness": "all"}))
    return updyn.update(model, frf, parameters, noise={"relative": 0.02}, starts=0)


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    return fit(row(), stiffness="all", loss_factor=["left"])


def drawn_values(result: updyn.UpdateResult, n: int) -> Iterator[dict[str, float]]:
    names = result.parameters.names
    here = np.array([result.values[name] for name in names])
    for values in np.random.default_rng(1).multivariate_normal(here, result.covariance, n):
        yield dict(zip(names, values.tolist(), strict=True))


def solve(model: updyn.Model, values: dict[str, float], n: int) -> tuple[np.ndarray, ...]:
    """Frequencies, loss factors and shapes of unit modal mass, by a dense solution."""
    K, D, M = np.zeros((3, model.n_dofs, model.n_dofs))
    for name, group in model.groups.items():
        if group.mass is not None:
            M += group.mass.toarray()
        if group.stiffness is not None:
            own = values.get(f"{name}.stiffness", 1.0) * group.stiffness.toarray()
            K += own
            D += values.get(f"{name}.loss_factor", group.loss_factor) * own
    square, shapes = scipy.linalg.eigh(K, M, subset_by_index=[0, n - 1])
    loss = np.einsum("in,ij,jn->n", shapes, D, shapes) / square
    return np.sqrt(square) / (2.0 * np.pi), loss, shapes


def at_length(shapes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Shapes multiples of which are nearest to others."""
    return shapes * np.sum(shapes * target, axis=0) / np.sum(shapes**2, axis=0)


def test_one_factor_on_all_stiffness_changes_the_frequencies_by_half_of_it() -> None:
    result = fit(row(one=True), stiffness=["left"])
    modes = updyn.predict_modes(result)
    share = result.std["left.stiffness"] / result.values["left.stiffness"]
    np.testing.assert_allclose(modes.std_frequency, 0.5 * share * modes.frequency, rtol=1e-9)
    np.testing.assert_allclose(modes.std_shapes, 0.0, atol=1e-9)
    np.testing.assert_allclose(modes.std_loss_factor, 0.0, atol=1e-9)
    np.testing.assert_allclose(modes.loss_factor, 0.02, rtol=1e-9)


def test_modes_are_those_of_the_updated_model_at_any_dof(result) -> None:
    modes = updyn.predict_modes(result, 6)
    whole = updyn.modes(result.model, 6)
    np.testing.assert_allclose(modes.frequency, whole.frequency, rtol=1e-9)
    np.testing.assert_allclose(modes.loss_factor, whole.loss_factor, rtol=1e-8)
    np.testing.assert_allclose(np.abs(modes.shapes), np.abs(whole.shapes), atol=1e-8)
    assert modes.dofs.labels == LABELS
    assert modes.scaled.all()
    some = updyn.predict_modes(result, 2, dofs=["5:-X", "2:X"])
    np.testing.assert_allclose(some.shapes, modes.shapes[[4, 1], :2] * [[-1.0], [1.0]])
    assert len(updyn.predict_modes(result)) == np.sum(whole.frequency <= LINES[-1])


def test_deviations_are_those_of_modes_solved_at_draws(result) -> None:
    modes = updyn.predict_modes(result, 6)
    drawn = [solve(result.start, values, 6) for values in drawn_values(result, 2000)]
    frequency, loss = (np.array([one[i] for one in drawn]) for i in (0, 1))
    shapes = np.array([at_length(one[2], modes.shapes.real) for one in drawn])
    np.testing.assert_allclose(modes.std_frequency, frequency.std(axis=0), rtol=0.08)
    np.testing.assert_allclose(modes.std_loss_factor, loss.std(axis=0), rtol=0.08)
    level = shapes.std(axis=0).max()
    np.testing.assert_allclose(modes.std_shapes, shapes.std(axis=0), rtol=0.08, atol=0.02 * level)


def test_draws_replace_the_covariance_of_the_update(result) -> None:
    draws = updyn.bootstrap(result, 12)
    wide = replace(draws, chains=draws.mean["left.stiffness"] + 3.0 * (draws.chains - 1.0))
    narrow, found = updyn.predict_modes(draws, 2), updyn.predict_modes(wide, 2)
    np.testing.assert_allclose(found.std_frequency, 3.0 * narrow.std_frequency, rtol=1e-9)
    np.testing.assert_allclose(
        narrow.std_frequency, updyn.predict_modes(result, 2).std_frequency, rtol=0.8
    )
    with pytest.raises(OptionError, match=r"draws\.of\(result\)"):
        updyn.predict_modes(replace(draws, result=None))


def test_sparse_and_reduced_tiers_give_the_same() -> None:
    model = row(165)
    result = fit(model, sensors=("1:X", "70:X", "130:X"))
    sparse, reduced = (updyn.predict_modes(result, 4, tier=tier) for tier in ("sparse", "reduced"))
    np.testing.assert_allclose(reduced.frequency, sparse.frequency, rtol=1e-8)
    np.testing.assert_allclose(reduced.std_frequency, sparse.std_frequency, rtol=1e-4)
    level = sparse.std_shapes.max()
    np.testing.assert_allclose(reduced.std_shapes, sparse.std_shapes, atol=0.01 * level)
    drawn = [solve(model, values, 4)[2] for values in drawn_values(result, 200)]
    spread = np.std([at_length(one, sparse.shapes.real) for one in drawn], axis=0)
    np.testing.assert_allclose(sparse.std_shapes, spread, rtol=0.25, atol=0.05 * level)


def two_planes(split: float) -> updyn.Model:
    """Three masses that move in X and Y, with nearly the same stiffness in both directions."""
    chain = springs((0, 1, 900.0), (1, 2, 900.0), (2, 3, 900.0), n=3)
    foot = springs((0, 1, 900.0), n=3)
    slant, other = (
        np.kron(np.array([[0.5, side], [side, 0.5]]), springs((0, 3, 0.5), n=3))
        for side in (0.5, -0.5)
    )
    groups = {
        "foot x": updyn.Group(np.kron(np.diag([1.0, 0.0]), foot), loss_factor=0.02),
        "foot y": updyn.Group(np.kron(np.diag([0.0, 1.0 + split]), foot), loss_factor=0.02),
        "rest": updyn.Group(np.kron(np.eye(2), chain - foot), np.eye(6), loss_factor=0.02),
        "slant": updyn.Group(slant),
        "other": updyn.Group(other),
    }
    return updyn.Model.from_groups(groups, [f"{i}:{d}" for d in "XY" for i in (1, 2, 3)])


def test_shapes_of_close_modes_exclude_their_rotation_in_the_common_span() -> None:
    """The two modes of a frequency turn by radians; their span hardly changes."""
    model = two_planes(1e-3)
    sensors, forces = ("1:X", "3:X", "2:Y"), ("1:X", "1:Y")
    frf = noisy(updyn.response(model, LINES[:40], sensors, forces), 0, 0.02)
    unknowns = updyn.parameters(model, stiffness=["foot x", "foot y", "slant"])
    result = updyn.update(model, frf, unknowns, noise={"relative": 0.02}, starts=0)
    modes = updyn.predict_modes(result, 2)
    assert modes.frequency[1] / modes.frequency[0] < 1.006
    changes = []
    for values in drawn_values(result, 1500):
        drawn = solve(model, values, 2)[2]
        basis, target = np.linalg.qr(drawn)[0], modes.shapes.real
        # The nearest shapes within the span of the draw: tan instead of sin is of second order.
        nearest = basis @ (basis.T @ target)
        changes.append(nearest - target)
    spread = np.std(changes, axis=0)
    np.testing.assert_allclose(modes.std_shapes, spread, rtol=0.1, atol=0.03 * spread.max())
    assert modes.std_shapes.max() < 0.05 * np.abs(modes.shapes).max()


def test_modes_of_one_frequency_that_the_unknowns_couple_have_no_deviation(result) -> None:
    """The springs at 45 degrees are equal: no basis of the two planes suits both unknowns."""
    model = two_planes(0.0)
    unknowns = updyn.parameters(model, stiffness=["foot x", "slant"])
    at = dict.fromkeys(unknowns.names, 1.0)
    exact = replace(result, start=model, parameters=unknowns, values=at, covariance=np.eye(2))
    modes = updyn.predict_modes(exact, 2)
    assert modes.frequency[1] == pytest.approx(modes.frequency[0], rel=1e-9)
    assert np.isnan(modes.std_frequency).all()
    assert modes.std_shapes is None
    alone = replace(exact, parameters=unknowns[:1], covariance=np.eye(1))
    assert np.isfinite(updyn.predict_modes(alone, 2).std_frequency).all()


def test_undetermined_combinations_leave_out_what_they_change() -> None:
    """Two springs in series at the ground: their sum of compliances is determined, neither is."""
    groups = {
        "lower": updyn.Group(springs((0, 1, 900.0), n=3)),
        "upper": updyn.Group(springs((1, 2, 900.0), n=3)),
        "rest": updyn.Group(springs((2, 3, 500.0), n=3), np.diag([0.0, 1.0, 1.0]), loss_factor=0.1),
    }
    model = updyn.Model.from_groups(groups, LABELS[:3])
    frf = noisy(updyn.response(model, LINES[:30], ["2:X", "3:X"], ["3:X"]), 0, 0.02)
    unknowns = updyn.parameters(model, stiffness="all")
    result = updyn.update(model, frf, unknowns, noise={"relative": 0.02}, starts=0)
    assert not np.isfinite(result.covariance).all()
    modes = updyn.predict_modes(result, 2)
    assert (modes.std_frequency < 0.02 * modes.frequency).all()
    assert modes.std_shapes is None
    seen = updyn.predict_modes(result, 2, dofs=["2:X", "3:X"])
    assert (seen.std_shapes < 0.05).all()


def test_the_highest_measured_mode_is_included(result) -> None:
    """Its frequency in the updated model may be a little higher; modes 3 and 4 are far apart."""
    own = updyn.predict_modes(result, 3)
    for share, number in ((1.0 / 1.005, 3), (1.0 / 1.01, 2)):
        measured = updyn.ModeSet(own.frequency * share)
        assert len(updyn.predict_modes(replace(result, data=measured))) == number


def test_update_to_modes_and_joint_update(result, tmp_path: Path) -> None:
    model = row()
    measured = updyn.predict_modes(result, 3, dofs=["1:X", "3:X"])
    unknowns = updyn.parameters(model, stiffness=["left", "right"])
    to_modes = updyn.update(model, measured, unknowns, method="modal")
    assert len(updyn.predict_modes(to_modes)) == 3
    tests = [updyn.Test(model, result.frf, "a"), updyn.Test(model, measured, "b")]
    both = updyn.update_jointly(tests, unknowns)
    modes = updyn.predict_modes(both, 2, test="b")
    updyn.write_modes(modes, tmp_path / "modes.unv")
    again = updyn.read_modes(tmp_path / "modes.unv")
    np.testing.assert_allclose(again.shapes, modes.shapes, rtol=1e-4, atol=1e-5)


def test_invalid_input_is_named(result) -> None:
    with pytest.raises(OptionError, match="expected a number of modes from 1 up"):
        updyn.predict_modes(result, 0)
    with pytest.raises(OptionError, match="expected at most 6 modes"):
        updyn.predict_modes(result, 7)
    with pytest.raises(DofError, match="9:X"):
        updyn.predict_modes(result, 2, dofs=["9:X"])
    low = replace(result, data=result.frf.select(lines=LINES[:2]))
    with pytest.raises(OptionError, match=r"no elastic mode up to 1\.22766 Hz"):
        updyn.predict_modes(low)


def test_the_span_is_excluded_exactly() -> None:
    rng = np.random.default_rng(0)
    span, derivatives = rng.normal(size=(7, 2)), rng.normal(size=(7, 3))
    across = exclude_span(derivatives, span)
    np.testing.assert_allclose(span.T @ across, 0.0, atol=1e-12)
    np.testing.assert_allclose(exclude_span(across, span), across, atol=1e-12)
