"""Noise that is correlated over lines: its power over time, and decisions that take it into account."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.errors import DataError
from updyn.modal import envelope
from updyn.modal.envelope import Envelope
from updyn.modal.refine import LineWindow, Weights
from updyn.modal.vector_fitting import RationalBasis

LINES, DF = 2000, 0.25
FREQ = DF * np.arange(1, LINES + 1)


def noise(decay: float, seed: int, channels: int = 8) -> np.ndarray:
    """Spectra of white noise times exp(-decay t), of unit variance; shape (lines, channels)."""
    rng = np.random.default_rng(seed)
    n = 2 * LINES + 2
    time = np.arange(n) / (n * DF)
    record = rng.standard_normal((n, channels)) * np.exp(-decay * time)[:, None]
    spectra = np.fft.fft(record, axis=0)[1 : LINES + 1]
    return spectra / np.sqrt(np.mean(np.abs(spectra) ** 2))


def expected(decay: float, times: int) -> np.ndarray:
    power = np.exp(-2 * decay * np.arange(times) / (times * DF))
    return power / np.mean(power)


@pytest.mark.parametrize("decay", [0.0, 0.4, 0.8])
def test_the_envelope_of_noise_in_an_exponential_window_is_its_square(decay: float) -> None:
    power = Envelope.of(FREQ, noise(decay, 0)).power
    ratio = power / expected(decay, len(power))
    for times in (slice(0, 4), slice(4, 12), slice(12, 20)):
        assert np.mean(ratio[times]) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("decay", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("lines", [48, 150])
def test_the_envelope_of_one_residual_is_that_of_its_noise(decay: float, lines: int) -> None:
    """Of lines around one mode, the fit of which follows most of the noise at time 0."""
    x = np.arange(lines) - 0.5 * lines
    columns = np.stack([1.0 / (x - 3.0j), x**0, x, x**2, x**3], axis=1)
    Q = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    ratios = []
    for seed in range(5):
        drawn = noise(decay, seed, 24)[100 : 100 + lines]
        power = Envelope.of_residuals([(Q, (drawn - Q @ (Q.conj().T @ drawn)).T)]).power
        ratios.append(power / expected(decay, len(power)))
    for times in (slice(0, 4), slice(4, 12), slice(12, 20)):
        assert np.mean(np.array(ratios)[:, times]) == pytest.approx(1.0, abs=0.25)
    assert Envelope.of_residuals([(Q, drawn.T[:2])]).is_white


def test_uneven_or_few_lines_are_taken_as_independent() -> None:
    values = noise(0.8, 0)
    assert len(Envelope.of(FREQ[:200], values[:200]).power) == 1
    assert len(Envelope.of(np.geomspace(1.0, 500.0, LINES), values).power) == 1
    assert Envelope.white().inflation(np.ones((30, 2))) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("decay", [0.0, 0.8])
def test_inflation_is_the_variance_of_projections_over_that_in_white_noise(decay: float) -> None:
    """Of a wide pole and a narrow one, by 4,000 draws of noise."""
    lines = 60
    envelope = Envelope.of(FREQ, noise(decay, 1))
    x = np.arange(lines) - 30.3
    columns = np.stack([1.0 / (x - 3.0j), 1.0 / (x - 0.2j)], axis=1)
    columns = columns / np.linalg.norm(columns, axis=0)
    draws = noise(decay, 2, 120)[: 33 * lines].reshape(33, lines, -1)
    found = np.mean(np.abs(np.einsum("lk,blc->bkc", columns.conj(), draws)) ** 2, axis=(0, 2))
    white = np.mean(np.abs(draws) ** 2)
    assert envelope.inflation(columns) == pytest.approx(np.maximum(found / white, 1.0), rel=0.25)


@pytest.mark.parametrize("distance", [5.0, 0.3])
def test_residues_have_the_noise_of_a_projection_orthogonal_to_all_other_functions(
    distance: float,
) -> None:
    """Each by its own least-squares problem, for poles apart and nearly coincident."""
    lines = 60
    x = np.arange(lines) - 30.3 + 0.0j
    poles = np.array([1.0j, distance + 1.2j, 14.0 + 3.0j])
    basis = RationalBasis(1, mirrored=False)
    envelope = Envelope.of(FREQ, noise(0.8, 1))
    window = LineWindow(basis, x, np.ones((1, lines)) + 0.0j, poles[2:], envelope=envelope)
    weights = Weights(np.ones((1, 1)), 1.0 + 0.01 * np.abs(x[None]))
    functions = np.hstack([1.0 / (x[:, None] - poles), x[:, None] ** 0, x[:, None]])
    functions = functions / weights.line.T
    expected = []
    for r in range(2):
        others = np.delete(functions, r, axis=1)
        fit = others @ np.linalg.lstsq(others, functions[:, r], rcond=None)[0]
        expected.append(envelope.inflation((functions[:, r] - fit)[:, None])[0])
    assert max(expected) > 1.2
    assert window.inflation(poles[:2], weights) == pytest.approx(expected, rel=1e-9)


def modal(frequency: list[float], loss: float, channels: int, seed: int) -> np.ndarray:
    """Accelerances of modes of random shapes, shape (lines, channels)."""
    shapes = np.random.default_rng(seed).standard_normal((len(frequency), channels))
    x = FREQ[:, None] ** 2
    parts = [
        -x / (f**2 * (1 + 1j * loss) - x) * shape
        for f, shape in zip(frequency, shapes, strict=True)
    ]
    return np.sum(parts, axis=0)


def frf(values: np.ndarray) -> updyn.FRF:
    labels = [f"{k}:Z" for k in range(1, values.shape[1] + 1)]
    return updyn.FRF(FREQ, values[:, :, None], labels, ["99:Z"], "accelerance")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ripples_of_correlated_noise_are_no_modes(seed: int) -> None:
    """Noise that is smooth over several lines, as of an exponential window."""
    true = [30.0, 75.0, 160.0, 310.0]
    values = modal(true, 0.02, 8, seed) + 0.3 * noise(1.0, seed)
    found = updyn.identify_modes(frf(values))
    assert found.frequency == pytest.approx(true, rel=3e-3)


def test_standard_deviations_in_correlated_noise_are_those_of_repeats() -> None:
    """Of few modes, wide and narrow, in noise that is smooth over several lines."""
    true, lines = [20.0, 48.0, 90.0], 480
    clean = modal(true, 0.02, 6, 1)
    sets = []
    for seed in range(40):
        values = (clean + 0.3 * noise(0.8, seed, 6))[:lines, :, None]
        labels = [f"{k}:Z" for k in range(1, 7)]
        measured = updyn.FRF(FREQ[:lines], values, labels, ["99:Z"], "accelerance")
        sets.append(updyn.identify_modes(measured))
    assert all(len(found) == 3 for found in sets)
    for name in ("frequency", "loss_factor"):
        values = np.array([getattr(found, name) for found in sets])
        stated = np.median([getattr(found, f"std_{name}") for found in sets], axis=0)
        assert np.std(values, axis=0, ddof=1) == pytest.approx(stated, rel=0.35)


def test_a_mode_far_below_the_highest_is_found_without_a_stable_pole() -> None:
    """Peaks narrower than a line, the lowest 60 dB below the highest, over flat noise."""
    true = [10.1, 27.0, 53.1, 131.7, 246.0, 394.8]
    x = FREQ[:, None] ** 2
    rng = np.random.default_rng(3)
    values = np.zeros((LINES, 6), dtype=complex)
    for k, f in enumerate(true):
        size = 10.0 ** (3.0 * k / 5.0 - 3.0)
        values += -size * x / (f**2 * (1 + 0.004j) - x) * rng.uniform(0.5, 1.5, 6) / 250
    values += 2e-5 * (rng.standard_normal((*values.shape, 2)) @ (1, 1j))
    found = updyn.identify_modes(frf(values))
    assert found.frequency == pytest.approx(true, rel=2e-3)
    assert not len(found.unexplained)


def test_a_mode_that_one_weak_sensor_shows_is_found() -> None:
    values = modal([40.0, 90.0], 0.02, 5, 0)
    values[:, 4] *= 0.01
    x = FREQ**2
    values[:, 4] += -0.03 * x / (222.0**2 * (1 + 0.02j) - x)
    rng = np.random.default_rng(0)
    values = values * (1 + 0.01 * rng.standard_normal((*values.shape, 2)) @ (1, 1j))
    found = updyn.identify_modes(frf(values))
    assert found.frequency == pytest.approx([40.0, 90.0, 222.0], rel=3e-3)


def with_a_disturbance() -> updyn.FRF:
    """Two modes, and one line of the mains in all channels."""
    values = modal([40.0, 190.0], 0.02, 5, 1)
    rng = np.random.default_rng(1)
    values += 0.05 * (rng.standard_normal((*values.shape, 2)) @ (1, 1j))
    values[np.argmin(np.abs(FREQ - 350.0))] += 40.0 * rng.standard_normal(5)
    return frf(values)


def test_a_disturbance_on_one_line_is_no_mode_but_is_listed() -> None:
    found = updyn.identify_modes(with_a_disturbance())
    assert found.frequency == pytest.approx([40.0, 190.0], rel=3e-3)
    assert found.unexplained == pytest.approx([350.0])
    assert found.select(band=(0.0, 100.0)).unexplained == pytest.approx([350.0])
    assert found.renamed([f"{k}:X" for k in range(11, 16)]).unexplained == pytest.approx([350.0])


def test_data_without_a_mode_name_the_peaks_that_they_have() -> None:
    rng = np.random.default_rng(2)
    values = rng.standard_normal((LINES, 5, 2)) @ (1, 1j)
    values[np.argmin(np.abs(FREQ - 350.0))] += 60.0
    with pytest.raises(DataError, match=r"found none between .*; Peak without a mode: 350 Hz"):
        updyn.identify_modes(frf(values))


def test_a_peak_without_a_stable_pole_can_be_picked() -> None:
    """A mode that chance could explain: it is refined where it is picked."""
    rng = np.random.default_rng(4)
    values = modal([40.0, 190.0], 0.02, 3, 1)
    x = FREQ[:, None] ** 2
    weak = -x / (300.0**2 * (1 + 0.004j) - x) * np.array([0.0016, -0.0008, 0.0013])
    values = values + weak + 0.25 * (rng.standard_normal((*values.shape, 2)) @ (1, 1j))
    found = updyn.identify_modes(frf(values))
    assert found.frequency == pytest.approx([40.0, 190.0], rel=3e-3)
    more = updyn.identify_modes(frf(values), poles=[300.0])
    assert more.frequency == pytest.approx([40.0, 190.0, 300.0], rel=5e-3)


# -- settings by value -----------------------------------------------------------------------------
@pytest.mark.parametrize(("degree", "is_removed"), [(3, True), (4, False)])
def test_a_cubic_polynomial_is_removed_from_each_part(
    monkeypatch: pytest.MonkeyPatch, degree: int, is_removed: bool
) -> None:
    largest = []

    def power_over_time(part: np.ndarray) -> np.ndarray:
        largest.append(np.abs(part).max())
        return np.zeros(part.shape)

    monkeypatch.setattr(envelope, "_power_over_time", power_over_time)
    assert Envelope.of(FREQ, ((FREQ / FREQ[-1]) ** degree)[:, None]).is_white
    assert (max(largest) < 1e-12) == is_removed


def test_a_quarter_of_the_parts_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 61 parts, each of one channel."""
    used = []

    def estimate(powers: list[np.ndarray], responses: list[np.ndarray]) -> np.ndarray:
        used.append(powers[0].shape[1])
        return np.ones(64)

    monkeypatch.setattr(envelope, "_estimate_power", estimate)
    Envelope.of(FREQ, noise(0.0, 0, 1))
    assert used == [15]


def test_the_power_at_time_0_is_extrapolated_from_twelve_times() -> None:
    """They decay by a factor of e each; the later ones do not."""
    times = np.arange(64)
    power = np.exp(-np.minimum(times, 16.0))
    found = envelope._extrapolate_power(power, times >= 5)
    assert found[:5] / found[5] == pytest.approx(np.exp(5.0 - times[:5]))


def test_the_power_is_estimated_in_two_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = []
    monkeypatch.setattr(
        envelope, "_extrapolate_power", lambda power, known: rounds.append(1) or power
    )
    envelope._estimate_power([np.ones((64, 3))], [np.eye(64)])
    assert len(rounds) == 2
