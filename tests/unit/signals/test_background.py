"""Faults that last all along a record, or that several records show together; sound ones are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hits
import updyn
from updyn.signals.records import Records

SOUND = hits.records(5, seconds=10.0, noise=1e-3, seed=2)
TIMES = SOUND.step * np.arange(SOUND.values.shape[2])
SIZE = np.abs(SOUND.values).max(axis=(0, 2))


def found(records, **options):
    return updyn.check_records(records, "hammer", **options)


def noisy(exact, rng, share=5e-4):
    """Records with white noise, a share of each channel's largest value."""
    size = np.abs(exact).max(axis=(0, 2))[:, None]
    values = exact + share * size * rng.standard_normal(exact.shape)
    return Records.of(values, hits.STEP, SOUND.channels, SOUND.units)


def added(record, channel, what):
    """Sound records with something added to a channel of one of them, or of all (None)."""
    values = SOUND.values.copy()
    values[slice(None) if record is None else record, channel] += what
    return replace(SOUND, values=values)


def test_sound_records():
    assert found(SOUND) == ()
    assert found(SOUND, band=(3.0, 60.0)) == ()


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("way", [TIMES / 10.0, 1.0 - np.exp(-TIMES / 6.0)])
def test_an_offset_that_drifts(channel, way):
    (one,) = found(added(2, channel, 0.05 * SIZE[channel] * way))
    assert (one.kind, one.channel, one.record) == ("drift", SOUND.channels[channel], 3)
    # The slope of the second half, drawn out to the whole record, of a drift that slows down.
    if way[-1] == TIMES[-1] / 10.0:
        assert one.value == pytest.approx(0.05 * SIZE[channel], rel=0.1)


@pytest.mark.parametrize("f", [50.0, 59.93, 120.0])
@pytest.mark.parametrize("channel", [0, 1])
def test_lines_of_the_mains(f, channel):
    wave = 0.01 * SIZE[channel] * np.sin(2.0 * np.pi * f * TIMES + np.arange(5.0)[:, None])
    (one,) = found(added(None, channel, wave))
    assert (one.kind, one.channel, one.record) == ("mains", SOUND.channels[channel], None)
    assert one.value == pytest.approx(0.01 * SIZE[channel], rel=0.05)
    assert one.band[0] < f < one.band[1]
    for band, seen in (((40.0, 130.0), [one.band]), ((65.0, 100.0), [])):
        others = found(added(None, channel, wave), band=band)
        assert [other.band for other in others if other.kind == "mains"] == seen


def test_a_mode_at_the_frequency_of_the_mains_is_none():
    """It decays: the same line, half as large from one quarter of the record to the next."""
    decaying = np.exp(-TIMES / 3.6) * np.sin(2.0 * np.pi * 50.0 * TIMES)
    kinds = {one.kind for one in found(added(None, 1, 0.05 * SIZE[1] * decaying))}
    assert "mains" not in kinds


def test_a_response_in_its_noise():
    rng = np.random.default_rng(0)
    noisy = added(3, 2, 0.1 * SIZE[2] * rng.standard_normal(len(TIMES)))
    (one,) = found(noisy, band=(1.0, 80.0))
    assert (one.kind, one.channel, one.record) == ("noise-floor", "2:Z", 4)
    assert 0.45 < one.value < 1.0
    assert 1.0 <= one.band[0] < one.band[1] <= 80.0


def late(record, row, wait):
    """Records that begin so many s later, with the response to an earlier hit in one of them."""
    ahead = round(0.5 / SOUND.step)
    pad = np.random.default_rng(1).standard_normal((5, 3, ahead)) * 1e-3 * SIZE[:, None]
    values = np.concatenate([pad, SOUND.values], axis=2)
    before = hits.displacement(hits.pulse(round(30.0 / SOUND.step), size=150.0))
    values[record, 1 + row] += before[row, round(wait / SOUND.step) :][: values.shape[2]]
    return replace(SOUND, values=values)


def test_a_structure_that_still_rings():
    (one,) = found(late(1, 0, wait=0.5))
    assert (one.kind, one.channel, one.record) == ("leakage", "1:Z", 2)
    assert found(late(1, 0, wait=15.0)) == ()


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_a_stiffness_that_grows_with_the_level(share):
    """Natural frequencies that rise in proportion to the hit: the FRFs of other structures."""
    values, levels = [], (60.0, 90.0, 120.0, 180.0, 240.0)
    rng = np.random.default_rng(4)
    for level in levels:
        force = hits.pulse(round(10.0 / hits.STEP), size=level)
        stretched = 1.0 + share * (level - 60.0) / 180.0
        # Of a structure that is faster by a factor: the same displacements in less time.
        motion = hits.displacement(force, hits.STEP * stretched)
        values.append(np.vstack([force, motion]))
    given = noisy(np.array(values), rng)
    kinds = {(one.kind, one.channel, one.record) for one in found(given, band=(3.0, 80.0))}
    assert kinds == {("level-dependence", name, None) for name in ("1:Z", "2:Z")}


def test_hits_of_a_linear_structure_beside_the_point():
    """Each hit excites the modes by other shares, at another level."""
    rng, values = np.random.default_rng(7), []
    constants = hits.CONSTANTS.copy()
    try:
        for level in (60.0, 90.0, 120.0, 180.0, 240.0):
            hits.CONSTANTS[:] = constants * (1.0 + 0.05 * rng.standard_normal(3))
            force = hits.pulse(round(10.0 / hits.STEP), size=level)
            values.append(np.vstack([force, hits.displacement(force)]))
    finally:
        hits.CONSTANTS[:] = constants
    given = noisy(np.array(values), rng)
    assert found(given, band=(3.0, 80.0)) == ()


@pytest.mark.parametrize("n", [2, 3, 8, 40, 100, 300])
@pytest.mark.parametrize("hits_", [1, 5])
def test_records_of_hardly_anything(n, hits_):
    """Nothing is divided by zero, whatever is short, dead, constant, or at the edge."""
    rng = np.random.default_rng(n)
    noise = rng.standard_normal((hits_, 3, n))
    dead = np.zeros((hits_, 3, n))
    dead[:, 0, n // 3] = np.arange(1.0, hits_ + 1.0)
    ramp = dead.copy()
    ramp[:, 1], ramp[:, 2] = 3.0, np.arange(n)
    edge = np.zeros((hits_, 3, n))
    edge[:, 0, 0] = edge[:, 1, -1] = 1.0
    for values in (noise, dead, ramp, edge):
        for step in (1e-5, 1e-3, 0.1):
            given = Records.of(values, step, SOUND.channels, SOUND.units)
            for options in ({}, {"band": (1.0, 100.0)}, {"segment": step * max(2, n // 4)}):
                for one in found(given, **options):
                    assert np.isfinite(one.value)


# -- lasting forces ----------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def lasting():
    """A minute of a random force, with 1 % of noise."""
    rng = np.random.default_rng(3)
    force = rng.standard_normal(30 * 1024)
    clean = np.vstack([force, hits.displacement(force)])
    noisy = clean + 0.01 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return Records.of(noisy[None], hits.STEP, SOUND.channels, SOUND.units)


def test_a_lasting_force_is_no_row_of_hits(lasting):
    assert found(lasting, segment=8.0) == ()


def test_segments_that_are_too_short(lasting):
    """The narrowest peak, 12 Hz with 2 % of damping, is 0.48 Hz wide; segments of 1 s are too short."""
    rows = [one for one in found(lasting, segment=1.0) if one.kind == "leakage"]
    assert {one.channel for one in rows} == {"1:Z", "2:Z"}
    for one in rows:
        assert one.record is None
        assert one.remedy == "Use segments of 2 s or more."
        assert one.value > 0.1
    frf, longer = (
        updyn.estimate_frf(lasting, {"hammer": "1:Z"}, segment=size) for size in (1.0, 2.0)
    )
    at = int(np.argmin(np.abs(frf.freq - 0.5 * sum(rows[0].band))))
    about = np.abs(longer.freq - frf.freq[at]) < 0.6
    ratio = np.abs(frf.values[at, 0, 0]) / np.abs(longer.values[about, 0, 0]).max()
    assert 1.0 - ratio == pytest.approx(rows[0].value, abs=0.1)


def test_drift_and_mains_of_a_lasting_signal(lasting):
    values = lasting.values.copy()
    times = lasting.step * np.arange(values.shape[2])
    rms = values.std(axis=2)[0]
    values[0, 1] += 2.0 * rms[1] * times / times[-1]
    values[0, 2] += 0.3 * rms[2] * np.sin(2.0 * np.pi * 50.0 * times)
    rows = found(replace(lasting, values=values), segment=8.0)
    assert [(one.kind, one.channel, one.record) for one in rows] == [
        ("drift", "1:Z", 1),
        ("mains", "2:Z", None),
    ]
    assert rows[0].value == pytest.approx(2.0 * rms[1], rel=0.1)
