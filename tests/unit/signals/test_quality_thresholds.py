"""Thresholds of the faults of records: a case on either side of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.signals.quality import background, pulse, together
from updyn.signals.quality import hits as single

STEP = 1e-3


def test_an_overload_has_three_samples():
    for count, expected in ((2, 0), (3, 1)):
        channel = np.array([0.0, 1.0] * 40 + [94.0] + [100.0] * count + [94.0] + [0.0, 1.0] * 40)
        assert len(list(single.find_clipped_run(channel, "a", 1))) == expected


@pytest.mark.parametrize(("jump", "expected"), [(5.0, 0), (6.0, 1)])
def test_an_overload_follows_a_jump(jump, expected):
    around = [100.0 - jump]
    channel = np.array([0.0, 1.0] * 40 + around + [100.0] * 3 + around + [0.0, 1.0] * 40)
    assert len(list(single.find_clipped_run(channel, "a", 1))) == expected


@pytest.mark.parametrize(("value", "expected"), [(2.0**14, 0), (2.0**14 + 1.0, 1)])
def test_equal_large_values_need_not_be_consecutive(value, expected):
    channel = np.array(([0.0, 0.0, 1.0] * 20 + [value]) * 3 + [0.0, 1.0])
    assert len(list(single.find_clipped_run(channel, "a", 1))) == expected


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        (9_999.0, 20_000.0, 0),
        (10_001.0, 20_000.0, 1),
        (20_000.0, 20_010.0, 0),
        (20_000.0, 20_011.0, 1),
        (1e8, 1e8 + 99.0, 0),
        (1e8, 1e8 + 102.0, 1),
    ],
)
def test_an_overload_of_a_pair(before, after, expected):
    channel = np.array([0.0, 1.0] * 10 + [2e8 - before, 2e8, 2e8, 2e8 - after] + [0.0, 1.0] * 10)
    assert len(list(single.find_clipped_pair(channel, "a", 1))) == expected


@pytest.mark.parametrize(("value", "expected"), [(99_999.0, 0), (100_001.0, 2)])
def test_equal_peaks_of_two_hits(value, expected):
    first = np.array([0.0, 1.0] * 10 + [50.0, value, 60.0] + [0.0, 1.0] * 10)
    second = np.array([0.0, 1.0] * 10 + [40.0, value, 70.0] + [0.0, 1.0] * 10)
    assert len(list(single.find_equal_peaks(np.array([first, second]), "a"))) == expected


def second_hit(share, noise=0.0, tail=1.0, apart=200):
    """A hit with an exponential tail, a second hit, and noise of constant size."""
    channel = noise * np.resize([1.0, -1.0, 0.0], 1000)
    channel[300:500] += np.exp(-np.arange(200) / tail)
    channel[300 + apart] = share
    return list(single.find_second_hits(channel, STEP, "a", 1))


def test_a_second_hit_is_large():
    assert not second_hit(0.049)
    assert second_hit(0.051)


def test_a_second_hit_is_above_the_noise():
    assert not second_hit(0.075, noise=0.004)
    assert second_hit(0.085, noise=0.004)


def test_a_hit_ends_at_two_percent():
    # A tail with a time constant of 25 samples falls to 2 % in 98 samples.
    assert not second_hit(0.1, tail=25.0, apart=180)
    assert second_hit(0.1, tail=25.0, apart=214)


@pytest.mark.parametrize(("second", "expected"), [(0.80, 0), (0.84, 1)])
def test_a_force_reaches_a_tenth_of_its_largest_line(second, expected):
    channel = np.zeros(1000)
    channel[300:302] = 1.0, second  # its spectrum falls to (1 - second) / (1 + second)
    found = list(single.find_short_force(channel, STEP, (0.0, 500.0), "a", 1))
    assert len(found) == expected


def impulse(at, n=2000):
    force = np.zeros(n)
    force[at + 1] = 1.0
    return force


def sine(n, at=0):
    return np.sqrt(2.0) * np.sin(0.5 * np.pi * (np.arange(at, at + n) + 0.5))


@pytest.mark.parametrize(("late", "quiet", "expected"), [
    (0.021, 0, 1),
    (0.019, 0, 0),
    (0.025, 0, 1),
    (0.025, 50, 0),
])  # fmt: skip
def test_a_truncated_response(late, quiet, expected):
    channel = np.zeros(2000)
    channel[300:500] = sine(200)
    channel[-100:] = late * sine(100)
    channel[-100 : 2000 - 100 + quiet] = 0.0
    assert len(list(single.find_cut_off(channel, impulse(300), "a", 1))) == expected


def test_the_end_of_a_response_is_a_twentieth():
    channel = np.zeros(2000)
    channel[300:500] = sine(200)
    channel[-100:] = 0.025 * sine(100)  # of a tenth of the record, the rms is 0.018
    assert list(single.find_cut_off(channel, impulse(300), "a", 1))


@pytest.mark.parametrize(
    ("begin", "before", "late", "expected"),
    [
        (79, 0.05, 1e-3, 0),
        (80, 0.05, 1e-3, 1),
        (1000, 0.019, 1e-3, 0),
        (1000, 0.021, 1e-3, 1),
        (1000, 0.05, 0.05 / 2.9, 0),
        (1000, 0.05, 0.05 / 3.1, 1),
    ],
)
def test_a_response_before_the_hit(begin, before, late, expected):
    channel = np.zeros(2000)
    channel[:begin] = before * sine(begin)
    channel[begin : begin + 200] = sine(200)
    channel[-100:] = late * sine(100)
    found = list(single.find_ringing_before(channel, impulse(begin), "a", 1))
    assert len(found) == expected


def mixed(share, n=2000):
    """A steady sine with a share of white noise."""
    rng = np.random.default_rng(3)
    noise = np.sqrt(share) * rng.standard_normal(n)
    return np.sqrt(1.0 - share) * np.sqrt(2.0) * np.sin(0.3 * np.arange(n)) + noise


@pytest.mark.parametrize(("share", "expected"), [(0.2, False), (0.4, True)])
def test_noise_is_not_predicted(share, expected):
    assert single._is_noise(mixed(share), 0, 200) is expected


@pytest.mark.parametrize(("ratio", "expected"), [(1.08, True), (1.12, False)])
def test_a_steady_end_is_no_decay(ratio, expected):
    levels = np.repeat([1.0, 0.5, 0.4 * ratio, 0.4], 500)
    assert single._is_noise(levels * sine(2000), 0, 100) is expected


@pytest.mark.parametrize(("n", "expected"), [(63, False), (64, True)])
def test_noise_has_eight_times_as_many_samples_as_the_order(n, expected):
    white = np.random.default_rng(0).standard_normal(n)
    assert single._is_noise(white, 0, 3) is expected


def test_the_duration_is_that_of_nine_tenths_of_the_energy():
    record = np.zeros(400)
    record[100:140] = 1.0
    assert pulse._pulse_shape(record)[0] == pytest.approx(36.0, abs=1.0)


@pytest.mark.parametrize(("faint", "expected"), [(0.045, True), (0.06, False)])
def test_faint_samples_are_no_energy(faint, expected):
    record = np.zeros(1000)
    record[100], record[500:600] = 1.0, faint
    assert (pulse._pulse_shape(record)[0] == 1.0) is expected


@pytest.mark.parametrize(
    ("ratio", "sign", "one", "expected"),
    [
        (4.1, 0.0, 0.81, True),
        (3.9, 0.0, 0.81, False),
        (5.0, 0.49, 0.81, True),
        (5.0, 0.51, 0.81, False),
        (5.0, 0.0, 0.79, False),
    ],
)
def test_a_pulse_is_shorter_than_an_oscillation(monkeypatch, ratio, sign, one, expected):
    monkeypatch.setattr(pulse, "_shape", lambda channel: (channel[:, 0], channel[:, 1]))
    values = np.array([[[10.0 * ratio, sign], [10.0, one]]])
    found = pulse.check_pulse(values, STEP, ("a", "b"), 0, [1])
    assert (found is not None) is expected


@pytest.mark.parametrize(("n", "expected"), [(39, 0), (40, 1)])
def test_drift_needs_twenty_pieces_of_two_samples(n, expected):
    assert len(list(background.find_drift(np.arange(float(n)), None, "a", 1))) == expected


@pytest.mark.parametrize(("drift", "expected"), [(0.0095, 0), (0.0105, 1)])
def test_drift_is_a_hundredth_of_the_largest_value(drift, expected):
    channel = np.linspace(0.0, drift, 2000)
    channel[1000:1002] += 1.0, -1.0
    assert len(list(background.find_drift(channel, None, "a", 1))) == expected


@pytest.mark.parametrize(("slope", "expected"), [(0.46, False), (0.5, True)])
def test_a_trend_is_significant(slope, expected):
    offsets = slope * np.arange(20.0) + np.where(np.arange(20) % 2, 1.0, -1.0)
    assert (background._trend(offsets) > 0.0) is expected


@pytest.mark.parametrize(
    ("apart", "spread", "noise", "expected"),
    [(4.0, 1.0, 0.0, 0.0), (4.4, 1.0, 0.0, 4.4), (0.95, 0.0, 1.0, 0.0), (1.05, 0.0, 1.0, 1.05)],
)
def test_an_offset_after_the_hit(apart, spread, noise, expected):
    alternating = np.where(np.arange(64) % 2, 1.0, -1.0)
    offsets = apart + spread * alternating[:10]
    assert background._offset_after(offsets, noise * alternating) == pytest.approx(expected)


@pytest.mark.parametrize(("begin", "expected"), [(63, 0), (64, 1)])
def test_an_offset_before_the_hit_needs_samples(begin, expected):
    channel = np.zeros(1000)
    channel[begin : begin + 2] = 1.0, -1.0
    channel[500:] = 0.05
    assert len(list(background.find_drift(channel, begin, "a", 1))) == expected


@pytest.mark.parametrize(("f", "expected"), [(150.0, 1), (200.0, 0)])
def test_harmonics_of_the_mains(f, expected):
    wave = np.sin(2.0 * np.pi * f * STEP * np.arange(4000))[None]
    wave += 1e-2 * np.random.default_rng(0).standard_normal(4000)
    assert len(list(background.find_mains(wave, STEP, True, None, "a"))) == expected


@pytest.mark.parametrize(("off", "expected"), [(0.14, True), (0.25, False)])
def test_the_frequency_of_the_mains_varies(off, expected):
    wave = np.sin(2.0 * np.pi * (50.0 + off) * STEP * np.arange(40_000))
    found = background._find_sine(wave, STEP, 50.0)
    assert (found is not None and found[0] > 0.95) is expected


@pytest.mark.parametrize(
    ("power", "lines", "expected"),
    [(29.0, range(3, 9), False), (31.5, range(3, 9), True), (10.0, range(3, 6), False)],
)
def test_a_line_of_the_mains_is_above_its_surroundings(power, lines, expected):
    n, at = 4000, 200
    turn = 2.0 * np.pi * np.arange(n) / n
    # Neighbours with phases of a quarter turn do not add up in the window of Hann.
    wave = np.sqrt(power) * np.sin(at * turn)
    for k in lines:
        wave = wave + sum(np.sin((at + s * k) * turn + 0.5 * np.pi * k) for s in (-1, 1))
    assert (background._find_sine(wave, STEP, at / (n * STEP)) is not None) is expected


@pytest.mark.parametrize(("f", "expected"), [(8.9, False), (9.1, True)])
def test_a_line_of_the_mains_has_eight_neighbours(f, expected):
    wave = np.sin(2.0 * np.pi * f * STEP * np.arange(1000))
    assert (background._find_sine(wave, STEP, f) is not None) is expected


@pytest.mark.parametrize(("n", "expected"), [(190, False), (210, True)])
def test_a_line_of_the_mains_is_long(n, expected):
    wave = np.sin(2.0 * np.pi * 50.0 * STEP * np.arange(n))
    assert (background._find_sine(wave, STEP, 50.0) is not None) is expected


def test_a_line_between_lines_is_interpolated():
    found = background._find_sine(np.sin(2.0 * np.pi * 50.0 * STEP * np.arange(265)), STEP, 50.0)
    assert found is not None
    assert found[0] == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(("more", "expected"), [(0.27, True), (0.31, False)])
def test_a_line_of_the_mains_is_steady(more, expected):
    wave = np.sin(2.0 * np.pi * 50.0 * STEP * np.arange(4000))
    found = background._steady_line([wave, (1.0 + more) * wave], STEP, 50.0)
    assert (found > 0.0) is expected


@pytest.mark.parametrize(("before", "expected"), [(38.0, 1), (41.0, 0)])
def test_a_line_of_the_mains_is_a_share_of_the_spectrum(before, expected):
    wave = np.sin(2.0 * np.pi * 50.0 * STEP * np.arange(4000))
    wave[:2000] *= before
    assert len(list(background.find_mains(wave[None], STEP, False, None, "a"))) == expected


def in_noise(power, n=4096, upper=1.0):
    """White noise, and an impulse below a share of the band with this power relative to it."""
    spectrum = np.where(np.arange(n // 2 + 1) <= upper * (n // 2), 1.0, 0.0)
    noise = np.random.default_rng(5).standard_normal(n)
    return np.sqrt(power * n) * np.fft.irfft(spectrum, n) + noise


@pytest.mark.parametrize(
    ("power", "upper", "n", "expected"),
    [
        (0.9, 1.0, 4096, 1),
        (2.4, 1.0, 4096, 0),
        (1e4, 0.5, 4096, 1),
        (1e4, 0.65, 4096, 0),
        (0.0, 1.0, 255, 0),
        (0.0, 1.0, 256, 1),
    ],
)
def test_a_response_in_the_noise(power, upper, n, expected):
    lines = np.ones(n // 2 + 1, dtype=bool)
    found = list(background.find_noise_floor(in_noise(power, n, upper), STEP, lines, "a", 1))
    assert len(found) == expected


def level_dependence(levels, growth=0.02):
    """Findings for hits of a mode whose frequency rises with the level."""
    n, levels = 1000, np.asarray(levels)
    force, t = np.zeros((len(levels), n)), np.arange(n)
    force[:, 0] = levels
    rate = 0.3 * (1.0 + growth * levels[:, None])
    motion = levels[:, None] * np.exp(-0.02 * t) * np.sin(rate * t)
    lines = np.ones(n // 2 + 1, dtype=bool)
    return list(together.find_level_dependence(force, motion, STEP, lines, "a", range(len(levels))))


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ([1.0, 1.3, 1.6], 0),
        ([1.0, 1.2, 1.4, 1.6], 1),
        ([1.0, 1.1, 1.2, 1.24], 0),
        ([1.0, 1.1, 1.2, 1.26], 1),
    ],
)
def test_hits_of_different_levels(levels, expected):
    assert len(level_dependence(levels)) == expected


@pytest.mark.parametrize(
    ("change", "F_ratio", "expected"),
    [(0.029, 1e3, 0), (0.031, 1e3, 1), (1.0, 14.0, 0), (1.0, 15.0, 1)],
)
def test_a_change_of_a_peak_is_significant(monkeypatch, change, F_ratio, expected):
    # F of 2 and 6 degrees of freedom exceeds 14.5 with a probability of 0.5 %.
    monkeypatch.setattr(together, "_shape_change", lambda H, levels: (change, F_ratio))
    assert len(level_dependence([1.0, 1.2, 1.4, 1.6, 1.8])) == expected


@pytest.mark.parametrize(("level", "end"), [(1.9, 2000), (2.1, 520)])
def test_a_response_ends_in_its_noise(level, end):
    motion = np.where(np.arange(2000) % 2, 1.0, -1.0)[None].copy()
    motion[:, 500:510] *= level
    gate = together._gate(motion)
    assert np.flatnonzero(gate > 0.0)[-1] >= end - 5
    assert not gate[end:].any()


def test_the_largest_peaks_are_compared():
    size = np.ones(600)
    size[50:600:60] = 10.0 + np.arange(10.0)
    size[51:600:60] = size[49:600:60] = 8.0
    assert len(list(together._peaks(size, np.ones(600, dtype=bool)))) == 5


def test_the_lines_of_a_peak():
    size = np.zeros(100)
    size[47:54] = 0.2, 0.34, 0.36, 1.0, 0.36, 0.34, 0.2
    ((_, lines),) = together._peaks(size, np.ones(100, dtype=bool))
    assert (lines.start, lines.stop) == (49, 52)
    wide = np.maximum(1.0 - np.abs(np.arange(2001) - 1000) / 901.0, 0.0)
    ((_, lines),) = together._peaks(wide, np.ones(2001, dtype=bool))
    assert (lines.start, lines.stop) == (415, 1586)


@pytest.mark.parametrize(
    ("loss", "error", "segments", "expected"),
    [
        (0.11, 0.0, 15, 1),
        (0.09, 0.0, 15, 0),
        (0.11, 0.0, 14, 0),
        (0.2, 0.045, 15, 1),
        (0.2, 0.055, 15, 0),
    ],
)
def test_leakage_is_significant(monkeypatch, loss, error, segments, expected):
    size = 100
    # Parts of the records whose standard deviation over the root of five is the error.
    apart = np.sqrt(5.0) * error * np.array([-1.0, 1.0, -1.0, 1.0, 0.0])

    def averages(_force, _motion, n):
        def h1(chosen):
            H = np.zeros(n // 2 + 1)
            at = 20 * n // size
            H[at] = 1.0 if n > size else 1.0 - loss
            if n == size and chosen.step is not None and chosen.start < 5:
                H[at] += apart[chosen.start]
            return H

        return SimpleNamespace(xf=np.zeros(segments), h1=h1)

    monkeypatch.setattr(together, "_Averages", SimpleNamespace(of=averages))
    force = np.zeros((1, 1000))
    found = list(together.find_leakage(force, force, STEP, size * STEP, ("a", "b")))
    assert len(found) == expected


def test_the_surroundings_of_a_line_are_the_third_to_the_eighth_on_either_side():
    """Outside the main lobe of the window."""
    n = 1000
    f = 50.0 / (n * STEP)
    noise = np.random.default_rng(0).standard_normal(n)
    wave = 9.0 * np.sin(2.0 * np.pi * 50.0 * np.arange(n) / n) + noise
    window = np.hanning(n)
    amplitude = 2.0 * np.abs(np.fft.rfft(wave * window)) / window.sum()
    around = np.concatenate([amplitude[42:48], amplitude[53:59]])
    found = background._find_sine(wave, STEP, f)
    assert found is not None
    assert found[1] == pytest.approx(np.sqrt(np.median(around**2)))
