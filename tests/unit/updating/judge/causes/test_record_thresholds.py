"""Thresholds of faults of records and of rigid motion by value: just inside, and just outside."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.dofs import Dof
from updyn.updating.judge.causes import leakage, mains, rigid_explanation
from updyn.updating.judge.causes.leakage import Leakage


# -- the end of a record ---------------------------------------------------------------------------
def cut_record(monkeypatch, edges, freq=None, samples=1600) -> tuple[list, list[int]]:
    """Return the detections of an impulse response with these edges, and the averaged samples."""
    averaged = []

    def measure_edges(power, n):
        averaged.append(n)
        return np.array(edges), 7

    monkeypatch.setattr(leakage, "_compute_impulse_power", lambda frf: np.ones(samples))
    monkeypatch.setattr(leakage, "_measure_edges", measure_edges)
    monkeypatch.setattr(leakage, "_find_end", lambda power, near, n: min(100 + near, samples))
    frf = SimpleNamespace(freq=np.arange(48.0) if freq is None else freq)
    return list(Leakage.detect_faults(frf)), averaged


@pytest.mark.parametrize(("number", "is_tested"), [(47, False), (48, True)])
def test_the_end_of_a_record_is_found_on_forty_eight_lines(monkeypatch, number, is_tested):
    found, _ = cut_record(monkeypatch, [9.0], np.arange(float(number)))
    assert bool(found) == is_tested


@pytest.mark.parametrize(("variation", "is_tested"), [(0.9e-3, True), (1.1e-3, False)])
def test_lines_are_evenly_spaced_within_a_thousandth(monkeypatch, variation, is_tested):
    freq = np.arange(48.0)
    freq[-1] += variation
    found, _ = cut_record(monkeypatch, [9.0], freq)
    assert bool(found) == is_tested


@pytest.mark.parametrize(("decibels", "is_edge"), [(21.9, False), (22.1, True)])
def test_an_edge_is_a_drop_of_twenty_two_decibels(monkeypatch, decibels, is_edge):
    found, _ = cut_record(monkeypatch, [0.1 * decibels * np.log(10.0)])
    assert bool(found) == is_edge


@pytest.mark.parametrize(("samples", "number"), [(1600, 100), (48, 5)])
def test_a_sixteenth_of_the_samples_is_averaged(monkeypatch, samples, number):
    """Five samples at least."""
    assert cut_record(monkeypatch, [9.0], samples=samples)[1] == [number]


@pytest.mark.parametrize(("share", "place"), [(0.69, 1), (0.71, 0)])
def test_the_edge_is_the_first_drop_of_seven_tenths(monkeypatch, share, place):
    ((found,), _) = cut_record(monkeypatch, [share * 20.0, 20.0])
    assert found.fault.value == pytest.approx((100 + place + 7) / 1600)


def test_three_samples_next_to_an_edge_are_blurred():
    """The first sample of an edge is behind two averages and these."""
    power = np.exp(-0.1 * np.arange(100.0))
    edges, first = leakage._measure_edges(power, 5)
    assert first == 2 * 5 + 3
    assert edges == pytest.approx(np.zeros(len(edges)), abs=1e-6)


# -- mains hum -------------------------------------------------------------------------------------
def hum(monkeypatch, deviation_ratio, bandwidth=0.0) -> list:
    """Return the detections of 50 Hz whose first multiples have these deviations of channels."""
    n_lines, n_channels = deviation_ratio.shape
    freq = np.arange(0.0, 1000.0, 2.0)
    at = 25 * np.arange(1, n_lines + 1)
    deviations = np.zeros((len(freq), n_channels))
    deviations[at] = deviation_ratio
    neighbours = SimpleNamespace(
        deviation_ratio=deviations,
        pole_ratio=np.zeros(deviations.shape),
        bandwidth=np.full(len(freq), bandwidth),
    )
    monkeypatch.setattr(mains._Neighbours, "of", lambda *about: neighbours)
    is_multiple = np.isin(np.arange(len(freq)), at)
    return list(mains.MainsHum._detect_at(SimpleNamespace(freq=freq), 50.0, is_multiple))


def test_a_channel_is_affected_by_hum_at_half_of_the_lines(monkeypatch):
    """Channels at one to four of four lines, and two more at all."""
    lines, channels = np.indices((4, 6))
    (found,) = hum(monkeypatch, np.where(lines <= channels, 1e3, 0.0))
    assert found.fault.channel_count == "5 of 6 channels"


@pytest.mark.parametrize(("bandwidth", "is_found"), [(0.049, True), (0.051, False)])
def test_one_line_of_hum_is_sharper_than_a_resonance(monkeypatch, bandwidth, is_found):
    assert bool(hum(monkeypatch, np.full((1, 1), 1e3), bandwidth)) == is_found


# -- rigid motion ----------------------------------------------------------------------------------
def test_trial_turns_of_a_sensor_are_less_than_ninety_degrees():
    """In steps of half a degree, in both senses."""
    tried = []

    def compare(values):
        tried.append(np.degrees(np.arctan2(values.imag, values.real))[:, 0])
        return np.ones(len(values))

    motion = SimpleNamespace(sensors=[])
    sensor = SimpleNamespace(
        motion=motion,
        select_determined=lambda dofs: dofs,
        predict=lambda dofs: np.full((1, 1), 1j),
        compare=compare,
    )
    list(rigid_explanation._try_turns(sensor, Dof(1, "X"), np.ones(1, dtype=complex)))
    for degrees in tried:
        turns = np.sort(degrees[degrees > 0.0])
        assert turns[-1] == pytest.approx(85.5)
        assert np.diff(turns) == pytest.approx(np.full(len(turns) - 1, 0.5))
        assert np.sort(-degrees[degrees < 0.0]) == pytest.approx(turns)
