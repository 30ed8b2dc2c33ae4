"""Faults of records: seeded ones are found and named, sound records are left alone."""

from __future__ import annotations

import lzma
from dataclasses import replace

import numpy as np
import pytest

import hits
import updyn
from places import DATA
from updyn.errors import DataError
from updyn.signals.records import Records


@pytest.fixture(scope="module")
def impact(tmp_path_factory):
    """Five hits, sample data of pyFRF 1.1.4."""
    path = tmp_path_factory.mktemp("lvm") / "impact.lvm"
    path.write_bytes(lzma.decompress((DATA / "cases" / "impact.lvm.xz").read_bytes()))
    return updyn.read_records(path)


def found(records, **options):
    return [
        (one.kind, one.channel, one.record)
        for one in updyn.check_records(records, "hammer", **options)
    ]


def changed(records, record, channel, change):
    values = records.values.copy()
    values[record, channel] = change(values[record, channel])
    return replace(records, values=values)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("noise", [0.0, 1e-3, 5e-3])
def test_sound_records(seed, noise):
    assert found(hits.records(noise=noise, seed=seed, seconds=10.0), band=(1.0, 80.0)) == []


def test_rounded_peaks_are_no_overload():
    """A converter of 10 bits: a slow response dwells at its largest value."""
    sound = hits.records(seconds=10.0)
    size = np.abs(sound.values).max(axis=2, keepdims=True)
    rounded = replace(sound, values=np.round(sound.values / size * 512.0) * size / 512.0)
    assert [one for one in found(rounded) if one[0] == "clipped"] == []


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_an_overload_of_a_response(seed, share):
    sound = hits.records(noise=1e-4, seed=seed, seconds=10.0)

    def clipped(channel):
        limit = share * np.abs(channel).max()
        return np.clip(channel, -limit, limit)

    assert ("clipped", "2:Z", 3) in found(changed(sound, 2, 2, clipped))


def cut(channel, samples, share=0.5):
    """A channel whose largest samples, so many of them, are at a limit between them and the next."""
    ordered = np.sort(channel)
    limit = ordered[-samples - 1] + share * (ordered[-samples] - ordered[-samples - 1])
    return np.minimum(channel, limit)


@pytest.mark.parametrize("seed", range(4))
def test_an_overload_of_two_samples(seed):
    sound = hits.records(noise=1e-3, seed=seed, seconds=10.0)
    peak = np.sort(sound.values[2, 0])
    assert peak[-1] > peak[-2] > peak[-3]
    flat = changed(sound, 2, 0, lambda values: cut(values, 2))
    assert ("clipped", "hammer", 3) in found(flat)


def test_a_computed_pulse_that_is_symmetric_is_no_overload():
    """Its two largest samples are equal to the last bit."""
    sound = hits.records(noise=0.0, seconds=10.0)
    for width in (4, 7, 8, 12):
        force = np.roll(hits.pulse(sound.values.shape[2], width=width), 40)
        both = replace(sound, values=sound.values.copy())
        both.values[:, 0] = force  # the same in all hits, too
        assert [one for one in found(both) if one[0] == "clipped"] == []


def test_an_overload_of_one_sample_in_two_hits():
    sound = hits.records(noise=1e-3, seed=1, seconds=10.0)
    values = sound.values.copy()
    for record in (0, 2):  # their second largest samples are 100 N, their largest above 101 N
        values[record, 0] *= 100.0 / np.sort(values[record, 0])[-2]
        assert values[record, 0].max() > 101.0
        values[record, 0] = np.minimum(values[record, 0], 101.0)
    cut_off = replace(sound, values=values)
    told = [one for one in updyn.check_records(cut_off, "hammer") if one.kind == "clipped"]
    assert [one.record for one in told] == [1, 3]
    assert "a sample at" in told[0].statement
    assert "as in record 3" in told[0].statement


def test_an_overload_of_the_force():
    sound = hits.records(seconds=10.0)
    force = hits.pulse(sound.values.shape[2], width=12)
    flat = changed(sound, 1, 0, lambda _: np.minimum(force, 0.6 * force.max()))
    assert found(flat) == [("clipped", "hammer", 2)]


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("after", [12, 80, 700])
def test_a_second_hit(share, after):
    sound = hits.records(noise=1e-4, seconds=10.0)
    twice = changed(sound, 2, 0, lambda force: force + share * np.roll(force, after))
    (one,) = [f for f in updyn.check_records(twice, "hammer") if f.kind == "double-hit"]
    assert one.record == 3
    assert one.value == pytest.approx(share, rel=0.05)
    assert f"{1e3 * after * hits.STEP:.3g} ms after it" in one.statement


def test_a_force_that_does_not_reach_the_band():
    soft = hits.records(1, seconds=10.0)
    force = hits.pulse(soft.values.shape[2], width=40)
    (one,) = updyn.check_records(changed(soft, 0, 0, lambda _: force), "hammer", band=(1.0, 80.0))
    assert one.kind == "short-force"
    # Half a sine of length T has its first zero at 1.5 / T: Harris, Shock and Vibration Handbook
    # (2002), chapter 8. It is down by 20 dB somewhat before.
    zero = 1.5 / (40 * hits.STEP)
    assert one.band[0] < zero < one.band[1]
    assert one.band[0] > 0.7 * zero


def test_a_band_is_two_frequencies():
    with pytest.raises(
        DataError, match="band 80 to 1 Hz: the first must be below the second"
    ) as error:
        updyn.check_records(hits.records(1, seconds=10.0), "hammer", band=(80.0, 1.0))
    assert error.value.key == ("band",)


def test_a_response_that_is_cut_off():
    assert found(hits.records(seconds=1.0)) == [
        ("cut-off", name, record) for record in (1, 2, 3, 4) for name in ("1:Z", "2:Z")
    ]


# -- the wrong channel as the force ---------------------------------------------------------------
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", ["1:Z", "2:Z"])
@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
def test_a_ringing_sensor_named_as_the_force_is_questioned(seed, wrong, quantity):
    sound = hits.records(noise=1e-3, seed=seed, seconds=10.0)
    values = sound.values.copy()
    if quantity == "acceleration":
        values[:, 1:] = np.gradient(np.gradient(values[:, 1:], axis=2), axis=2) / hits.STEP**2
    (one,) = updyn.check_records(replace(sound, values=values), wrong, band=(1.0, 80.0))
    assert (one.kind, one.channel, one.record) == ("no-pulse", wrong, None)
    assert one.value > 20.0
    assert f"{wrong}: the force is not a pulse; it oscillates for" in one.statement
    assert "Channel hammer is a pulse of" in one.statement
    assert one.remedy.startswith("Name hammer as the excitation if it is the hammer")


def test_a_real_sensor_named_as_the_force_is_questioned(impact):
    (one,) = updyn.check_records(impact, "Acceleration (Trigger)")
    assert one.kind == "no-pulse"
    # Its hits last for about 10 samples of 19.5 us, its sensor rings for 26 ms.
    assert (
        "it oscillates for 26.3 ms. Channel Force (Trigger) is a pulse of 0.195 ms" in one.statement
    )


@pytest.mark.parametrize("after", [10, 40, 200])
@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_second_hit_is_a_pulse_all_the_same(share, after):
    force = hits.pulse(4096)
    force += share * np.roll(force, after)
    values = np.vstack([force, hits.displacement(force)])[None]
    records = Records.of(values, hits.STEP, ["hammer", "1:Z", "2:Z"], ["N", "m", "m"])
    assert "no-pulse" not in [one[0] for one in found(records)]


def shaker(kind, seed, n=4096):
    """Forces of a shaker over a record: random, burst random, sine bursts and sweeps."""
    rng, t = np.random.default_rng(seed), np.arange(n) * hits.STEP
    burst = (t > 0.2) & (t < 0.5 * t[-1])
    if kind == "random":
        return rng.standard_normal(n)
    if kind == "burst random":
        return rng.standard_normal(n) * burst
    if kind == "burst sine":
        return np.sin(2.0 * np.pi * hits.FREQUENCY[seed % 3] * t) * burst
    return np.sin(2.0 * np.pi * (2.0 * t + 0.5 * 98.0 / t[-1] * t**2))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["random", "burst random", "burst sine", "sweep"])
def test_a_shaker_is_not_questioned(kind, seed):
    parts = []
    for number in range(3):
        force = shaker(kind, 3 * number + seed)
        parts.append(np.vstack([force, hits.displacement(force)]))
    records = Records.of(parts, hits.STEP, ["hammer", "1:Z", "2:Z"], ["N", "m", "m"])
    assert "no-pulse" not in [one[0] for one in found(records)]


def test_a_channel_that_is_zero_is_no_pulse():
    sound = hits.records(seconds=10.0)
    silent = changed(sound, slice(None), 1, np.zeros_like)
    assert "no-pulse" not in [one[0] for one in found(silent)]
