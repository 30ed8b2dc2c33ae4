"""Peaks of measured FRFs as modes: `find_resonance_peaks`."""

import numpy as np
import pytest

import updyn
from updyn.correlation import mac
from updyn.modal.peaks import find_prominences, find_resonance_peaks
from updyn.modal.settings import RESONANCE_PEAK

#: Natural frequencies in Hz, and shapes at five sensors.
FREQUENCY = np.array([12.0, 31.0, 58.0])
SHAPES = np.array(
    [[1.0, 1.0, 0.6], [0.8, -0.2, -1.0], [0.5, -1.0, 0.2], [0.3, -0.9, 1.0], [0.1, -0.4, 0.7]]
)
LINES = np.arange(2.0, 80.0, 0.25)


def frf(noise=0.0, loss=0.02):
    """Return the accelerances of three modes, driven at the first two sensors."""
    w2, wr2 = (2 * np.pi * LINES) ** 2, (2 * np.pi * FREQUENCY) ** 2
    modal = -w2[:, None] / (wr2 * (1 + 1j * loss) - w2[:, None])
    H = np.einsum("ir,kr,jr->kij", SHAPES, modal, SHAPES[:2])
    rng = np.random.default_rng(0)
    z = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    H = H + noise * np.sqrt(np.mean(np.abs(H) ** 2)) * z
    sensors = [f"{i}:Z" for i in range(1, 6)]
    return updyn.FRF(LINES, H, sensors, sensors[:2], "accelerance")


def test_peaks_are_the_modes():
    for noise in (0.0, 0.03):
        peaks = find_resonance_peaks(frf(noise))
        assert np.allclose(peaks.frequency, FREQUENCY, atol=0.3)
        assert (np.diag(mac(peaks.shapes, SHAPES)) > 0.98).all()


def test_a_reference_that_is_no_response_is_among_the_dofs():
    whole = frf()
    part = whole.select(responses=["1:Z", "3:Z", "4:Z", "5:Z"])
    peaks = find_resonance_peaks(part)
    assert peaks.dofs.labels == ["1:Z", "3:Z", "4:Z", "5:Z", "2:Z"]
    assert (np.diag(mac(peaks.shapes, SHAPES[[0, 2, 3, 4, 1]])) > 0.98).all()


def test_noise_has_no_peaks():
    rng = np.random.default_rng(1)
    z = rng.standard_normal((400, 6, 2)) + 1j * rng.standard_normal((400, 6, 2))
    sensors = [f"{i}:Z" for i in range(1, 7)]
    noise = updyn.FRF(np.arange(1.0, 401.0), z, sensors, sensors[:2], "accelerance")
    assert find_resonance_peaks(noise) is None


def test_few_lines_or_channels_have_no_peaks():
    assert find_resonance_peaks(frf().select(lines=LINES[:7])) is None
    assert find_resonance_peaks(frf()[["1:Z", "2:Z", "3:Z"], "1:Z"]) is None


def test_the_height_of_a_peak_is_that_over_the_higher_valley():
    level = np.array([0.0, 5.0, 3.0, 9.0, 1.0, 4.0, 4.0, 2.0, 8.0, 0.0])
    peaks, height = find_prominences(level)
    assert peaks.tolist() == [1, 3, 5, 8]
    assert height.tolist() == [2.0, 9.0, 2.0, 7.0]


def test_a_peak_is_a_factor_of_two_high():
    assert RESONANCE_PEAK.least_height == 6.0
    # One mode over a constant: 1 + a at the resonance, 1 beside it.
    for size, seen in ((1.2, 1), (0.8, 0)):
        w2, wr2 = (2 * np.pi * LINES) ** 2, (2 * np.pi * 30.0) ** 2
        modal = 0.02j * wr2 / (wr2 * (1 + 0.02j) - w2)
        H = (1.0 + size * modal)[:, None, None] * np.ones((1, 2, 2))
        labels = ["1:Z", "2:Z"]
        found = find_resonance_peaks(updyn.FRF(LINES, H, labels, labels, "accelerance"))
        assert (0 if found is None else len(found)) == seen


def test_thirty_peaks_are_found():
    """Of 33, all but the lowest ones."""
    level = np.ones(340)
    level[10::10] = 10.0 + np.arange(33)
    values = level[:, None, None] * np.ones((2, 2))
    sensors = ["1:Z", "2:Z"]
    peaks = find_resonance_peaks(
        updyn.FRF(np.arange(1.0, 341.0), values, sensors, sensors, "accelerance")
    )
    assert peaks.frequency == pytest.approx(np.arange(41.0, 341.0, 10.0))


@pytest.mark.parametrize(("number", "is_found"), [(7, False), (8, True)])
def test_peaks_are_searched_for_on_eight_lines(number, is_found):
    level = np.ones(number)
    level[3] = 10.0
    values = level[:, None, None] * np.ones((2, 2))
    sensors = ["1:Z", "2:Z"]
    frf = updyn.FRF(np.arange(1.0, number + 1.0), values, sensors, sensors, "accelerance")
    assert (find_resonance_peaks(frf) is not None) == is_found
