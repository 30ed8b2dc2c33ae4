"""How many measured modes a model has: `find_counterparts`, against structures in plain NumPy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.errors import InputError
from updyn.updating.judge.counterparts import (
    Counterparts,
    Pair,
    _find_in_frfs,
    _needs_identification,
    _pairs_most,
    _sensor_subsets,
    _try_common_factor,
    _try_without_sensors,
    find_counterparts,
    limit_size,
)
from updyn.updating.judge.settings import COUNTERPARTS

#: DOFs of the structures, and of the sensors.
N, SENSORS = 12, [0, 2, 4, 6, 8, 10]


def parts(rng):
    """Return springs and masses of a random chain with branches: stiffness and mass by group."""
    K = [np.zeros((N, N)) for _ in range(4)]
    for i in range(N):
        j = i - 1 if i < 8 else int(rng.integers(2, i))
        v = np.zeros(N)
        v[i] = 1.0
        if j >= 0:
            v[j] = -1.0
        K[i % 4] += 1e5 * rng.uniform(0.5, 2.0) * np.outer(v, v)
    return K, [np.diag(np.where(np.arange(N) % 4 == g, rng.uniform(0.5, 2.0), 0)) for g in range(4)]


def model(K, M, stiffness=(1, 1, 1, 1), mass=(1, 1, 1, 1), order=range(N)):
    """Return the model with factors on its groups, its DOFs labelled in some order."""
    groups = {
        f"g{i}": updyn.Group(stiffness=K[i] * stiffness[i], mass=M[i] * mass[i], loss_factor=0.01)
        for i in range(4)
    }
    return updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in order])


def modes(K, M):
    value, shapes = scipy.linalg.eigh(sum(K), sum(M))
    return np.sqrt(value) / (2 * np.pi), shapes


def measured(K, M, n_modes=8, noise=0.01, sensors=SENSORS):
    """Return accelerances that hold the lowest modes, with noise."""
    frequency, _ = modes(K, M)
    top = 0.5 * (frequency[n_modes - 1] + frequency[n_modes])
    lines = np.linspace(0.5 * frequency[0], top, 400)
    H = []
    for f in lines:
        w2 = (2 * np.pi * f) ** 2
        X = np.linalg.solve(sum(K) * (1 + 0.01j) - w2 * sum(M), np.eye(N)[:, sensors[:2]])
        H.append(-w2 * X[sensors])
    H = np.array(H)
    rng = np.random.default_rng(3)
    z = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    H = H * (1 + noise * z)
    labels = [f"{i + 1}:Z" for i in sensors]
    return updyn.FRF(lines, H, labels, labels[:2], "accelerance")


def reversed_sign(frf, *rows):
    values = frf.values.copy()
    values[:, list(rows)] *= -1
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)


@pytest.mark.parametrize("seed", range(12))
def test_a_model_that_is_off_as_models_are_has_the_modes(seed):
    rng = np.random.default_rng(seed)
    K, M = parts(rng)
    off = 1 + 0.3 * rng.choice([-1, 1], 4), 1 + 0.15 * rng.choice([-1, 1], 4)
    found = find_counterparts(model(K, M, *off), measured(K, M))
    assert found.known
    assert not found.few
    assert found.n_paired >= 0.7 * found.n_measured
    assert found.n_measured >= 5
    said = f"{found.n_paired} of {found.n_measured} resonance peaks of the test have a counterpart"
    assert found.statement == f"{said} in the model."


def test_pairs_are_those_of_the_exact_modes():
    K, M = parts(np.random.default_rng(0))
    truth = modes(K, M)[0][:8]
    found = find_counterparts(model(K, M), measured(K, M))
    assert found.n_paired == found.n_measured
    for pair in found.pairs:
        assert np.min(np.abs(truth / pair.computed - 1)) < 1e-9
        assert pair.measured == pytest.approx(pair.computed, rel=0.02)
        assert pair.mac > 0.8


def test_another_structure_has_few():
    # Shuffled, the first mode, in which all moves one way, is left.
    K, M = parts(np.random.default_rng(0))
    frf = measured(K, M, sensors=list(range(N)))
    for seed in (0, 2, 3):
        shuffled = np.random.default_rng(seed).permutation(N)
        found = find_counterparts(model(K, M, order=shuffled), frf)
        assert found.source == "identified"
        assert (found.n_measured, found.n_paired) == (8, 1)
        assert found.few
        assert not found.none
        assert "1 of 8 measured modes has a counterpart in the model: as few as" in found.statement


def test_modes_of_the_test_are_compared_as_its_frfs_are():
    K, M = parts(np.random.default_rng(0))
    frequency, shapes = modes(K, M)
    test = updyn.ModeSet(frequency[:8], shapes[SENSORS][:, :8], [f"{i + 1}:Z" for i in SENSORS])
    right = find_counterparts(model(K, M, (0.7, 1.3, 1, 1)), test)
    assert right.statement == "8 of 8 measured modes have a counterpart in the model."
    beside = find_counterparts(model(K, M, (0.7, 1.3, 1, 1)), measured(K, M), test)
    assert beside.pairs == right.pairs


def test_a_sensor_of_the_wrong_sign_is_no_sign_of_another_structure():
    K, M = parts(np.random.default_rng(0))
    frf = measured(K, M)
    for rows in ((3,), (4,), (1,), (2, 5)):
        found = find_counterparts(model(K, M), reversed_sign(frf, *rows))
        assert not found.none
        assert not found.few
    found = find_counterparts(model(K, M), reversed_sign(frf, 3))
    if found.doubtful:
        assert found.doubtful == ("7:Z",)
        assert "without 7:Z" in found.statement


def test_a_wrong_unit_is_said_as_a_factor():
    K, M = parts(np.random.default_rng(0))
    frf = measured(K, M)
    found = find_counterparts(model(K, M, 4 * [1000.0]), frf)
    assert found.n_paired == 0
    assert not found.none
    assert found.factor == pytest.approx(np.sqrt(1000), rel=0.02)
    assert "32 times the measured frequency" in found.statement


def test_where_the_data_cannot_tell_it_is_not_known():
    K, M = parts(np.random.default_rng(0))
    frf = measured(K, M)
    two = find_counterparts(model(K, M), frf.select(responses=["1:Z", "3:Z"]))
    assert not two.known
    assert two.n_sensors == 0
    assert "takes at least 3 sensors" in two.statement
    few = find_counterparts(model(K, M), frf.select(lines=frf.freq[:7]))
    assert not few.known
    assert "7 lines do not show resonances" in few.statement
    large = find_counterparts(model(K, M), frf, largest=N - 1)
    assert not large.known
    assert "12 DOFs, more than 11" in large.statement
    three = find_counterparts(model(K, M), frf.select(responses=["1:Z", "3:Z", "5:Z"]))
    assert three.by_chance > two.by_chance


def test_repeated_modes_are_compared_by_their_plane():
    sensors = [f"{i}:{axis}" for i in (1, 2, 3) for axis in "XY"]
    rng = np.random.default_rng(5)
    plane = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    K = plane @ np.diag([1.0, 1.0, 4.0, 4.0, 9.0, 16.0]) @ plane.T * 1e4
    group = updyn.Group(stiffness=K, mass=np.eye(6))
    computed = updyn.Model.from_groups({"a": group}, sensors)
    turn = np.array([[np.cos(0.8), np.sin(0.8)], [-np.sin(0.8), np.cos(0.8)]])
    shapes = np.hstack([plane[:, :2] @ turn, plane[:, 2:4] @ turn, plane[:, 4:]])
    frequency = np.sqrt(np.array([1.0, 1.001, 4.0, 4.004, 9.0, 16.0]) * 1e4) / (2 * np.pi)
    found = find_counterparts(computed, updyn.ModeSet(frequency, shapes, sensors))
    assert found.n_paired == 6
    assert min(pair.mac for pair in found.pairs) > 0.99


def test_the_range_of_frequencies_is_a_factor_of_one_and_a_half():
    assert COUNTERPARTS.frequency_factor == 1.5
    K, M = parts(np.random.default_rng(0))
    frequency, shapes = modes(K, M)
    labels = [f"{i + 1}:Z" for i in range(N)]
    for factor, n in ((1.45, 1), (1.55, 0)):
        one = updyn.ModeSet(frequency[:1] * factor, shapes[:, :1], labels)
        assert find_counterparts(model(K, M), one).n_paired == n


def test_pairs_by_chance_are_those_of_random_directions():
    # At three sensors the MAC of random directions is above 1/2 with probability 1 - sqrt(1/2).
    once = 1 - np.sqrt(0.5)
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((100_000, 3))
    cosine = draws[:, 0] / np.linalg.norm(draws, axis=1)
    assert np.mean(cosine**2 >= 0.5) == pytest.approx(once, abs=0.005)
    group = updyn.Group(stiffness=np.diag([1.0, 1.1, 1.2]) * 1e4, mass=np.eye(3))
    computed = updyn.Model.from_groups({"a": group}, ["1:Z", "2:Z", "3:Z"])
    test = updyn.ModeSet([16.0], np.ones((3, 1)), ["1:Z", "2:Z", "3:Z"])
    assert find_counterparts(computed, test).by_chance == pytest.approx(1 - (1 - once) ** 3)


def test_no_pair_is_known_from_four_modes_on():
    # With a share of 0.6 in common, four modes of the structure have none with probability 0.026.
    assert (COUNTERPARTS.common_share, COUNTERPARTS.few_level) == (0.6, 0.03)
    K, M = parts(np.random.default_rng(0))
    frequency, shapes = modes(K, M)
    labels = [f"{i + 1}:Z" for i in range(N)]
    for n in (3, 4):
        test = updyn.ModeSet(frequency[:n], shapes[:, N - 1 : N - 1 - n : -1], labels)
        found = find_counterparts(model(K, M), test)
        assert found.n_paired == 0
        assert found.none == (n == 4)
        assert found.statement.startswith(f"0 of {n} measured modes have a counterpart")


def test_modes_that_cannot_be_compared_are_not_known_and_no_error():
    """A sensor that the model lacks, and a mode that moves at a single sensor."""
    start = model(*parts(np.random.default_rng(2)))
    lacking = updyn.ModeSet([10.0], [[1.0]], ["99:Z"])
    single = updyn.ModeSet([30.0], np.eye(6)[:, :1], [f"{i + 1}:Z" for i in SENSORS])
    for modes_of_test, said in ((lacking, "99:Z is not among"), (single, "are too few to decide")):
        found = find_counterparts(start, modes_of_test)
        assert not found.known
        assert said in found.statement


@pytest.fixture
def no_identification(monkeypatch):
    """Modes must not be identified."""

    def refused(*about, **options):
        raise AssertionError("modes are identified")

    monkeypatch.setattr("updyn.updating.judge.counterparts.identify_modes", refused)


@pytest.mark.usefixtures("no_identification")
def test_no_modes_are_identified_at_two_sensors():
    """Their shapes could not be compared: of a million lines that would take minutes."""
    K, M = parts(np.random.default_rng(1))
    frf = measured(K, M, sensors=SENSORS[:2])
    found = find_counterparts(model(K, M), frf.select(references=frf.references.labels[:1]))
    assert not found.known
    assert found.n_paired == 0


@pytest.mark.usefixtures("no_identification")
def test_of_more_than_a_million_values_peaks_alone_are_compared():
    """They do not say that the model has few of the modes, as a second look is not taken."""
    K, M = parts(np.random.default_rng(4))
    few = measured(K, M)
    n_lines = 200_000
    lines = np.linspace(few.freq[0], few.freq[-1], n_lines)
    values = np.stack(
        [
            np.interp(lines, few.freq, few.values[:, i, j])
            for i in range(len(SENSORS))
            for j in range(2)
        ],
        axis=1,
    ).reshape(n_lines, len(SENSORS), 2)
    large = updyn.FRF(lines, values, few.responses, few.references, "accelerance")
    found = find_counterparts(model(*parts(np.random.default_rng(5))), large)
    assert found.n_measured > 0
    assert not found.few


def test_a_result_without_modes_is_not_known():
    nothing = Counterparts(0, 0, (), "why", known=False)
    assert not nothing.none
    assert not nothing.few


# -- thresholds ------------------------------------------------------------------------------------
def counted(n_measured, n_paired, by_chance=0.0):
    """Return a number of pairs at five sensors."""
    return Counterparts(n_measured, n_paired, (), "", known=True, n_sensors=5, by_chance=by_chance)


@pytest.mark.parametrize(("by_chance", "few"), [(0.045, False), (0.055, True)])
def test_one_pair_of_one_mode_is_no_chance_below_5_percent(by_chance, few):
    assert counted(1, 1, by_chance).few is few


@pytest.mark.parametrize(("n_paired", "most"), [(29, False), (31, True)])
def test_three_quarters_of_the_modes_are_most(n_paired, most):
    assert _pairs_most(counted(40, n_paired)) is most


@pytest.mark.parametrize(("n_paired", "is_needed"), [(23, True), (25, False)])
def test_modes_are_identified_if_less_than_three_fifths_of_the_peaks_are_paired(
    n_paired, is_needed
):
    assert _needs_identification(counted(40, n_paired)) is is_needed


@pytest.mark.parametrize(("n_sensors", "n_subsets"), [(12, 66), (13, 12)])
def test_all_pairs_of_up_to_twelve_sensors_are_left_out(n_sensors, n_subsets):
    assert len(_sensor_subsets(n_sensors, 2, ((3,), counted(9, 5)))) == n_subsets


def test_modes_are_identified_from_at_most_sixty_thousand_values():
    labels = [f"{i}:Z" for i in range(1, 21)]
    frf = updyn.FRF(
        np.arange(1.0, 1001.0), np.ones((1000, 20, 5)), labels, labels[:5], "accelerance"
    )
    assert limit_size(frf).values.shape == (1000, 20, 3)


def test_the_references_kept_excite_all_modes():
    # The second reference excites the lower half of the band only, the third the upper half; the
    # first is loudest on average, but weak at most lines.
    lines = np.arange(1.0, 1001.0)
    values = np.full((1000, 30, 4), 1e-3 + 0j)
    values[:500, :, 1] = values[500:, :, 2] = 1.0
    values[::100, :, 0] = 1.2
    dofs = [f"{k}:X" for k in range(1, 31)]
    frf = updyn.FRF(lines, values, dofs, dofs[:4], "receptance")
    assert limit_size(frf).references.labels == ["2:X", "3:X"]
    swapped = updyn.FRF(lines, values.transpose(0, 2, 1), dofs[:4], dofs, "receptance")
    assert limit_size(swapped).responses.labels == ["2:X", "3:X"]


@pytest.mark.parametrize(("n_lines", "is_refused"), [(7, True), (8, False)])
def test_fewer_than_eight_lines_show_no_resonance(n_lines, is_refused):
    K, M = parts(np.random.default_rng(1))
    frf = measured(K, M)
    found = find_counterparts(model(K, M), frf.select(lines=frf.freq[:n_lines]))
    assert ("lines do not show resonances" in found.statement) is is_refused


@pytest.mark.parametrize(("n_sensors", "compared"), [(2, 0), (3, 3)])
def test_shapes_are_compared_at_three_sensors(n_sensors, compared):
    K, M = parts(np.random.default_rng(1))
    frequency, shapes = modes(K, M)
    labels = [f"{i + 1}:Z" for i in SENSORS[:n_sensors]]
    test = updyn.ModeSet(frequency[:4], shapes[SENSORS[:n_sensors], :4], labels)
    assert find_counterparts(model(K, M), test).n_sensors == compared


@pytest.mark.parametrize(
    ("n_sensors", "numbers"), [(4, set()), (5, {1}), (6, {1, 2}), (8, {1, 2}), (12, {1, 2})]
)
def test_up_to_two_sensors_are_left_out_and_four_remain(n_sensors, numbers):
    tried = set()

    def without(choice):
        tried.add(len(choice))
        return SimpleNamespace(count_pairs=lambda n: counted(n, 0))

    test = SimpleNamespace(dofs=[0] * n_sensors)
    sets = SimpleNamespace(measured=test, without=without)
    assert _try_without_sensors(sets, 9) is None
    assert tried == numbers


@pytest.mark.parametrize(("power", "is_accepted"), [(2, True), (-2, True), (3, False), (-3, False)])
def test_a_common_factor_of_up_to_two_steps_needs_no_significance(power, is_accepted):
    tried = []

    def scale_frequencies(factor):
        tried.append(round(np.log(factor) / np.log(1.5)))
        n_paired = 2 if tried[-1] == power else 0
        return SimpleNamespace(
            count_pairs=lambda n: replace(
                counted(n, n_paired, by_chance=1.9), pairs=(Pair(1.0, 1.0, 1.0),) * n_paired
            )
        )

    found = _try_common_factor(SimpleNamespace(scale_frequencies=scale_frequencies), 2)
    assert (found is not None) is is_accepted
    assert (min(tried), max(tried)) == (-17, 17)


@pytest.mark.parametrize(("n_lines", "is_searched"), [(1000, True), (1001, False)])
def test_up_to_a_million_values_of_a_force_are_searched_for_modes(
    monkeypatch, n_lines, is_searched
):
    def refuse(*about):
        raise InputError("no modes")

    place = "updyn.updating.judge.counterparts."
    monkeypatch.setattr(f"{place}find_resonance_peaks", lambda frf: None)
    monkeypatch.setattr(f"{place}limit_size", lambda frf: frf)
    monkeypatch.setattr(f"{place}identify_modes_for", refuse)
    frf = SimpleNamespace(freq=range(n_lines), responses=range(1000), references=range(1))
    statement = _find_in_frfs(SimpleNamespace(model=None), frf).statement
    assert ("no modes could be identified" in statement) is is_searched
    assert ("1,000,000 values of one force are not searched" in statement) is not is_searched
