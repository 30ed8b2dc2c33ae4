"""Faults of records that have what real ones have: noise of 1/f, offsets, windows, overloads."""

from __future__ import annotations

import lzma

import numpy as np
import pytest
from scipy.signal import lfilter

import hits
import updyn
from places import DATA
from updyn.signals.records import Records

NAMES, UNITS = ("hammer", "1:Z", "2:Z"), ("N", "m", "m")
#: Samples before the hit; a record of 10 s, in which all modes come to rest.
BEFORE, N = 300, 5120
#: What is in the records, and the kinds of findings that it may bring.
CASES = {
    "sound": set(),
    "offset": set(),
    "window": set(),
    "window and offset": {"drift"},  # a window makes a decay of an offset
    "overload": {"clipped"},
    "second hit": {"double-hit"},
    "overload, offset and second hit": {"clipped", "double-hit"},
}


def realistic(case, seed, before=BEFORE, share=1e-3):
    """Three hits with noise of a share of each channel's largest value, by 24 bits."""
    rng, parts = np.random.default_rng(seed), []
    for _ in range(3):
        force = hits.pulse(N, at=before, width=6, size=float(rng.uniform(60.0, 180.0)))
        if "second hit" in case:
            force = force + 0.4 * np.roll(force, 60)
        record = np.vstack([force, hits.displacement(force)])
        size = np.abs(record).max(axis=1, keepdims=True)
        white = rng.standard_normal((2, *record.shape))
        slow = lfilter([1.0], [1.0, -0.995], white[0], axis=1)
        noise = white[1] + slow / slow.std(axis=1, keepdims=True)
        record = record + share * size * noise / np.sqrt(2.0)
        if "overload" in case:
            record[2] = np.clip(record[2], -0.6 * size[2], 0.6 * size[2])
        if "offset" in case:
            record = record + 0.02 * size * rng.uniform(-1.0, 1.0, (3, 1))
        if "window" in case:
            record = record * np.exp(-4.0 * np.maximum(np.arange(N) - before, 0) / N)
        step = 4.0 * size / 2.0**24
        parts.append(np.round(record / step) * step)
    return Records.of(parts, hits.STEP, NAMES, UNITS)


def kinds(records, excitation="hammer"):
    return {one.kind for one in updyn.check_records(records, excitation)}


@pytest.mark.parametrize("before", [BEFORE, 4])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("case", CASES)
def test_nothing_else_is_found(case, seed, before):
    assert kinds(realistic(case, seed, before)) <= CASES[case]


@pytest.mark.parametrize("seed", range(4))
def test_noise_at_the_end_is_no_response(seed):
    """Nothing was recorded before the hit, and noise is above 2 % of the response."""
    noisy = realistic("sound", seed, before=4, share=0.02)
    late = noisy.values[:, 1:, -256:].std(axis=2)
    early = noisy.values[:, 1:, :256].std(axis=2)
    assert (late > 0.02 * early).all()
    assert "cut-off" not in kinds(noisy)


@pytest.mark.parametrize("seed", range(4))
def test_noise_under_a_window_is_neither_leakage_nor_a_second_hit(seed):
    """It is larger before the hit than at the end, on the force, too."""
    noisy = realistic("window", seed, share=0.02)
    assert kinds(noisy).isdisjoint({"leakage", "double-hit"})


@pytest.mark.parametrize("before", [BEFORE, 4])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("case", CASES)
def test_a_record_that_ends_before_rest(case, seed, before):
    """Half a second after the hit the lowest mode still has a third of its motion."""
    whole = realistic(case, seed, before)
    short = Records.of(whole.values[:, :, : before + 256], hits.STEP, NAMES, UNITS)
    found = updyn.check_records(short, "hammer")
    cut = {(one.channel, one.record) for one in found if one.kind == "cut-off"}
    assert cut == {(name, record) for name in NAMES[1:] for record in (1, 2, 3)}
    assert all("Use longer records" in one.remedy for one in found if one.kind == "cut-off")


@pytest.mark.parametrize("before", [BEFORE, 4])
@pytest.mark.parametrize("wrong", NAMES[1:])
@pytest.mark.parametrize("case", CASES)
def test_a_ringing_sensor_as_the_force(case, wrong, before):
    (one,) = updyn.check_records(realistic(case, 1, before), wrong)
    assert (one.kind, one.channel) == ("no-pulse", wrong)
    assert one.remedy.startswith("Name hammer as the excitation")


def test_of_real_hits_only_the_true_faults_are_found(tmp_path):
    path = tmp_path / "impact.lvm"
    path.write_bytes(lzma.decompress((DATA / "cases" / "impact.lvm.xz").read_bytes()))
    found = updyn.check_records(updyn.read_records(path), "Force (Trigger)")
    assert [(one.kind, one.record) for one in found] == [("clipped", 1), ("double-hit", 3)]
