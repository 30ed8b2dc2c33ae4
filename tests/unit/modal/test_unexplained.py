"""Peaks without a mode: their height, and false alarms of noise."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.modal.measured import Measured
from updyn.modal.unexplained import describe_unexplained, find_unexplained

FREQ = np.linspace(1.0, 500.0, 1000)
NONE = np.zeros(0, dtype=complex)


def measured(values: np.ndarray) -> Measured:
    labels = [f"{k}:Z" for k in range(1, values.shape[1] + 1)]
    frf = updyn.FRF(FREQ[: len(values)], values[:, :, None], labels, ["99:Z"], "accelerance")
    return Measured.of(frf, mirrored=False)


@pytest.mark.parametrize(("height", "listed"), [(9.5, 0), (10.5, 1)])
def test_a_peak_is_10_db_over_the_median_around_it(height: float, listed: int) -> None:
    values = np.ones((1000, 20), dtype=complex)
    values[400] = 10.0 ** (height / 20.0)
    assert find_unexplained(measured(values), NONE) == pytest.approx(FREQ[[400]][:listed])


@pytest.mark.parametrize("channels", [1, 4])
def test_noise_has_a_peak_in_one_of_a_hundred_bands(channels: int) -> None:
    """Of 200 bands 2 are expected, and more than 8 have a probability of 2e-4."""
    alarms = 0
    for seed in range(200):
        rng = np.random.default_rng([seed, channels])
        noise = rng.standard_normal((1000, channels, 2)) @ (1, 1j)
        alarms += bool(len(find_unexplained(measured(noise), NONE)))
    assert alarms <= 8


@pytest.mark.parametrize(("apart", "listed"), [(0.9, 0), (1.1, 1)])
def test_a_peak_belongs_to_a_mode_within_its_bandwidth_and_two_lines(
    apart: float, listed: int
) -> None:
    values = np.ones((1000, 20), dtype=complex)
    values[400] = 10.0
    data = measured(values)
    loss = 0.02
    # frequency + apart * (bandwidth + 2 lines) = that of the peak
    at = (FREQ[400] - apart * 2.0 * data.spacing) / (1.0 + apart * loss)
    poles = data.axis.pole(np.array([at]), loss)
    assert len(find_unexplained(data, poles)) == listed


def test_a_message_names_eight_peaks() -> None:
    assert describe_unexplained(np.zeros(0)) == ""
    assert describe_unexplained(np.array([50.0])) == "Peak without a mode: 50 Hz"
    text = describe_unexplained(np.arange(1.0, 10.0))
    assert text == "Peaks without a mode: 1, 2, 3, 4, 5, 6, 7, 8, ... Hz"


@pytest.mark.parametrize(("lines", "side"), [(100, 15), (1000, 60)])
def test_the_median_around_a_peak_is_of_fifteen_and_of_sixty_lines_on_either_side(
    lines: int, side: int
) -> None:
    """A plateau of as many lines is a peak, and one more is half of the lines."""
    for width in (side, side + 1):
        values = np.ones((lines, 20), dtype=complex)
        values[20 : 20 + width] = 10.0
        assert bool(len(find_unexplained(measured(values), NONE))) == (width == side)


@pytest.mark.parametrize(("apart", "number"), [(2, 1), (3, 2)])
def test_a_peak_is_higher_than_two_lines_on_either_side(apart: int, number: int) -> None:
    values = np.ones((1000, 20), dtype=complex)
    values[400], values[400 + apart] = 10.0, 6.0
    assert len(find_unexplained(measured(values), NONE)) == number
