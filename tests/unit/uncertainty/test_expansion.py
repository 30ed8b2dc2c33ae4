"""Measured shapes expanded to the whole mesh: exact cases, O'Callahan's formula, derivatives, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.elements.beam import Segment, beam
from updyn.errors import DataError, OptionError
from updyn.uncertainty.combination import Combination, choose_columns, combine, order_by_distance

SENSORS = [f"{i}:Z" for i in (1, 3, 5, 8, 10, 13, 15, 17, 19, 21)]
ELSEWHERE = [f"{i}:Z" for i in range(1, 22) if f"{i}:Z" not in SENSORS]


def free_beam() -> updyn.Model:
    """A beam without supports in three segments."""
    ends = (0.0, 0.3, 0.6, 1.0)
    segments = [Segment(name, *ends[k : k + 2]) for k, name in enumerate("abc")]
    return beam(
        length=1.0, E=7e10, rho=2700.0, width=0.03, height=0.01, n_elements=20, segments=segments
    )


def with_mass(model: updyn.Model, node: int, mass: float = 0.04) -> updyn.Model:
    M = np.zeros((model.n_dofs, model.n_dofs))
    at = model.dofs.labels.index(f"{node}:Z")
    M[at, at] = mass
    return updyn.Model.from_groups(dict(model.groups) | {"mass": updyn.Group(mass=M)}, model.dofs)


def measure(model: updyn.Model, seed: int, noise: float = 0.02, n: int = 6) -> updyn.ModeSet:
    """Elastic modes at the sensors, with noise as a share of the rms of each shape."""
    found = updyn.modes(model, n + 2).select(np.arange(2, n + 2))
    shapes, rng = found.at(SENSORS), np.random.default_rng(seed)
    std = noise * np.sqrt(np.mean(shapes**2, axis=0)) * np.ones(shapes.shape)
    return updyn.ModeSet(
        found.frequency * (1.0 + 1e-3 * rng.standard_normal(n)),
        shapes + std * rng.standard_normal(shapes.shape),
        SENSORS,
        scaled=True,
        std_frequency=1e-3 * found.frequency,
        std_shapes=std if noise else None,
    )


def fit(modes: updyn.ModeSet) -> updyn.UpdateResult:
    model = free_beam()
    return updyn.update(model, modes, updyn.parameters(model, stiffness="all"), method="modal")


@pytest.fixture(scope="module")
def truth() -> updyn.Model:
    return free_beam().scaled({"a": {"stiffness": 1.2}, "c": {"stiffness": 0.9}})


@pytest.fixture(scope="module")
def result(truth) -> updyn.UpdateResult:
    return fit(measure(truth, 0))


def errors(expansion: updyn.uncertainty.expansion.Expansion, truth: updyn.Model) -> np.ndarray:
    """Errors of the expanded shapes, of the length of the true ones at all DOFs in Z."""
    n, labels = len(expansion.modes), [f"{i}:Z" for i in range(1, 22)]
    found = expansion.modes.shapes.real
    exact = updyn.modes(truth, n + 2).at(labels)[:, 2:]
    return found * np.sum(exact * found, axis=0) / np.sum(found**2, axis=0) - exact


def test_shapes_of_the_model_itself_are_expanded_exactly(result) -> None:
    own = updyn.predict_modes(result, 4)
    rows = [own.dofs.labels.index(label) for label in SENSORS]
    at_sensors = updyn.ModeSet(own.frequency, own.shapes[rows], SENSORS, scaled=True)
    for method in ("local", "serep"):
        found = updyn.expand_modes(result, at_sensors, method=method)
        signs = np.sign(np.sum(found.modes.shapes.real * own.shapes.real, axis=0))
        np.testing.assert_allclose(found.modes.shapes, own.shapes * signs, rtol=1e-7, atol=1e-8)
        assert (found.error < 1e-8).all()
        assert found.modes.scaled.all()
    some = updyn.expand_modes(result, at_sensors, dofs=["7:-Z"])
    np.testing.assert_allclose(some.modes.shapes[0], -own.shapes[12] * signs, rtol=1e-7)


def test_serep_is_the_formula_of_its_authors(result) -> None:
    measured = result.data
    found = updyn.expand_modes(result, method="serep")
    model = updyn.modes(result.model, len(measured) + 2)
    phi = model.shapes[:, 2:]
    T = phi @ np.linalg.pinv(model.at(SENSORS)[:, 2:])
    np.testing.assert_allclose(found.modes.shapes, T @ measured.real_shapes, rtol=1e-6, atol=1e-8)
    assert found.combined == ((0, 1, 2, 3, 4, 5),) * 6


def test_noise_alone_is_averaged_by_few_modes(truth) -> None:
    """True values lie in the bands; combinations of all modes follow the noise."""
    inside, rms = [], {"local": [], "serep": []}
    for seed in range(6):
        result = fit(measure(truth, seed))
        for method, found in rms.items():
            expansion = updyn.expand_modes(
                result, method=method, dofs=[f"{i}:Z" for i in range(1, 22)]
            )
            error = errors(expansion, truth)
            found.append(np.mean(error**2))
            if method == "local":
                inside.append(np.abs(error) < 1.96 * expansion.modes.std_shapes)
                assert expansion.error.mean() == pytest.approx(0.02, rel=0.3)
    assert 0.9 <= np.mean(inside) <= 1.0
    assert np.sum(rms["local"]) < 0.4 * np.sum(rms["serep"])


def test_a_mass_that_the_model_lacks_moves_rigid_body_modes_into_the_shapes() -> None:
    inside, local, serep = [], [], []
    for seed, node in enumerate((2, 6, 11, 20)):
        true = with_mass(free_beam(), node)
        result = fit(measure(true, seed))
        labels = [f"{i}:Z" for i in range(1, 22)]
        found = updyn.expand_modes(result, dofs=labels)
        local.append(np.mean(errors(found, true) ** 2))
        serep.append(
            np.mean(errors(updyn.expand_modes(result, method="serep", dofs=labels), true) ** 2)
        )
        inside.append(np.abs(errors(found, true)) < 1.96 * found.modes.std_shapes)
        assert found.model_error.max() > 0.02
        assert any(-1 in one for one in found.combined)
    assert "rigid" in found.summary()
    assert 0.9 <= np.mean(inside) <= 1.0
    assert np.sum(local) < np.sum(serep)


def test_the_derivatives_include_those_of_the_combination(result) -> None:
    """Against central differences of a weighted fit with the modes at other values."""
    found = updyn.expand_modes(result).modes
    quiet = replace(result, covariance=1e-12 * result.covariance)
    std = updyn.expand_modes(quiet).modes.std_shapes
    names, model = result.parameters.names, result.start
    here = np.array([result.values[name] for name in names])
    by_value = np.sqrt(np.maximum(found.std_shapes**2 - std**2, 0.0))[:, 0]
    measured, rows = result.data, [found.dofs.labels.index(label) for label in SENSORS]
    psi, noise = measured.real_shapes[:, 0], measured.std_shapes[:, 0] ** 2
    excess = combine(
        updyn.modes(result.model, 3).at(SENSORS)[:, 2:], psi, noise, np.zeros(1, int)
    ).excess

    def expand(values: np.ndarray) -> np.ndarray:
        shape = updyn.modes(result.parameters.apply(model, values), 3).shapes[:, 2]
        weight = 1.0 / (noise + excess)
        return shape * (shape[rows] * weight @ psi) / (shape[rows] ** 2 @ weight)

    assert updyn.expand_modes(result).combined[0] == (0,)
    changes = []
    for column in np.linalg.cholesky(result.covariance).T:
        step = 0.01 * column
        slope = (expand(here + step) - expand(here - step)) / 0.02
        shape = expand(here)
        changes.append(slope - shape * (shape @ slope) / (shape @ shape))
    expected = np.sqrt(np.sum(np.square(changes), axis=0))
    np.testing.assert_allclose(by_value, expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_close_modes_are_combined_together() -> None:
    A = np.linalg.qr(np.random.default_rng(0).standard_normal((9, 4)))[0]
    near = order_by_distance(np.array([10.0, 20.0, 20.05, 31.0]), 1)
    assert [one.tolist() for one in near] == [[1, 2], [0], [3]]
    shape = 0.8 * A[:, 1] - 0.6 * A[:, 2]
    assert choose_columns(A, shape, near).tolist() == [1, 2]
    assert choose_columns(A, shape + 0.3 * A[:, 0], near).tolist() == [0, 1, 2]
    # Modes that the sensors cannot distinguish from the others are not combined.
    twice = np.column_stack([A[:, 1], A[:, 1:]])
    assert choose_columns(twice, shape + 0.3 * A[:, 3], near).tolist() == [1, 2]


def ratio_of_errors(A: np.ndarray, shape: np.ndarray) -> float:
    both, one = (combine(A, shape, np.zeros(len(A)), np.arange(n)).error for n in (2, 1))
    return both / one


def test_limits_of_the_choice_of_modes() -> None:
    """A second mode has to lower the error by a fifth, be distinct, and leave three sensors."""
    A = np.linalg.qr(np.random.default_rng(1).standard_normal((12, 3)))[0]
    near = [np.array([0]), np.array([1])]
    for size, n_chosen in ((0.6, 2), (0.55, 1)):
        shape = A @ [1.0, size, 0.4]
        assert abs(ratio_of_errors(A, shape) - 0.8) < 0.04
        assert len(choose_columns(A, shape, near)) == n_chosen
    for distance, n_chosen in (
        (3e-3, 2),
        (1.4e-3, 1),
    ):  # the ratio of singular values is half of it
        close = np.column_stack([A[:, 0], A[:, 0] + distance * A[:, 1]])
        assert len(choose_columns(close, A @ [1.0, 1.0, 0.0], near)) == n_chosen
    for n_sensors, n_chosen in ((5, 2), (4, 1)):
        few = np.linalg.qr(A[:n_sensors])[0]
        assert len(choose_columns(few, few @ [1.0, 1.0, 0.0], near)) == n_chosen


def test_modes_up_to_half_above_the_highest_measured_one_are_combined(result) -> None:
    """The next mode is at 1.49 times the frequency of mode 4, and at 1.64 times that of mode 3."""
    own = updyn.predict_modes(result, 6, dofs=SENSORS)
    for mode, highest in ((3, 4), (2, 2)):
        shape = own.shapes[:, [mode]] + 0.5 * own.shapes[:, [mode + 1]]
        mixed = updyn.ModeSet(own.frequency[[mode]], shape, SENSORS)
        assert own.frequency[mode + 1] / own.frequency[mode] == pytest.approx(1.55, abs=0.1)
        assert max(updyn.expand_modes(result, mixed).combined[0]) == highest


def test_noise_and_excess_of_a_combination() -> None:
    """Variances of amplitudes and residual as in many fits of generated shapes."""
    rng = np.random.default_rng(0)
    A, columns = rng.standard_normal((12, 3)), np.arange(3)
    noise, exact = np.linspace(0.01, 0.04, 12) ** 2, A @ [1.0, 0.2, -0.1]
    fits = [
        combine(A, exact + np.sqrt(noise + 0.03**2) * rng.standard_normal(12), noise, columns)
        for _ in range(400)
    ]
    assert np.mean([one.excess for one in fits]) == pytest.approx(0.03**2, rel=0.1)
    spread = np.cov(np.array([one.amplitudes for one in fits]).T)
    stated = np.mean([one.root @ one.root.T for one in fits], axis=0)
    np.testing.assert_allclose(np.diag(stated), np.diag(spread), rtol=0.2)
    assert combine(A, exact, noise, columns).excess == 0.0
    root = combine(A, exact, 0.0 * noise, columns).root  # of 1e-12 of the shape at each sensor
    one = root.T @ A.T @ A @ root / (1e-24 * exact @ exact)
    np.testing.assert_allclose(one, np.eye(3), atol=1e-10)
    left_out = []
    for i in range(12):
        kept = np.delete(np.arange(12), i)
        shape = fits[0].gain.T @ np.zeros(3) + exact + 0.1 * np.cos(np.arange(12))
        one = Combination.of(A[kept], shape[kept], np.ones(11), columns, 0.0)
        left_out.append(shape[i] - A[i] @ one.amplitudes)
    whole = Combination.of(A, shape, np.ones(12), columns, 0.0)
    assert whole.error == pytest.approx(np.linalg.norm(left_out), rel=1e-9)


def test_invalid_input_is_named(result, truth) -> None:
    with pytest.raises(OptionError, match="method 'sereb'"):
        updyn.expand_modes(result, method="sereb")
    with pytest.raises(DataError, match="expected measured modes with shapes"):
        updyn.expand_modes(result, updyn.ModeSet([50.0]))
    many = measure(truth, 0)
    few = updyn.ModeSet(many.frequency, many.shapes[:6], SENSORS[:6])
    with pytest.raises(DataError, match="6 sensors for a combination of 6 modes"):
        updyn.expand_modes(result, few, method="serep")
    alien = updyn.ModeSet([400.0], np.eye(10)[:, :1], SENSORS)
    with pytest.raises(DataError, match="no mode like the measured ones at 400 Hz"):
        updyn.expand_modes(result, alien)


def test_modes_without_a_pair_are_listed(result, truth) -> None:
    known = measure(truth, 0).select([0, 1])
    three = updyn.ModeSet(
        [*known.frequency, 400.0], np.column_stack([known.shapes, np.eye(10)[:, 0]]), SENSORS
    )
    found = updyn.expand_modes(result, three)
    assert found.unpaired == (400.0,)
    assert len(found.modes) == len(found.combined) == 2
    assert "Not expanded, without a pair in the updated model: 400 Hz." in found.summary()


def test_modes_are_identified_from_frfs(truth) -> None:
    freq, model = np.linspace(30.0, 170.0, 300), free_beam()
    groups = {
        name: replace(group, loss_factor=0.01) if group.stiffness is not None else group
        for name, group in truth.groups.items()
    }
    damped = updyn.Model.from_groups(groups, truth.dofs)
    frf = updyn.response(damped, freq, SENSORS, ["1:Z"], "accelerance")
    result = updyn.update(damped, frf, updyn.parameters(model, stiffness=["a"]), starts=0)
    found = updyn.expand_modes(result)
    assert len(found.modes) == 2
    assert (found.error < 1e-3).all()
