"""Continuation from i omega + a to i omega, against the closed form of a modal sum."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError
from updyn.modal.continuation import remove_decay

FREQ = np.linspace(2.0, 30.0, 281)


def modal_sum(s):
    """Two receptances of three modes, 5, 11 and 22 Hz, 1 % damping, at complex s."""
    out = np.zeros((len(s), 2, 1), dtype=complex)
    for f, residues in ((5.0, (1.0, 0.4)), (11.0, (0.7, -0.5)), (22.0, (0.3, 0.8))):
        w = 2.0 * np.pi * f
        out[:, :, 0] += np.outer(1.0 / (s**2 + 2.0 * 0.01 * w * s + w**2), residues)
    return out


@pytest.mark.parametrize(("noise", "near"), [(0.0, 1e-7), (0.002, 2e-3), (0.01, 1e-2)])
def test_the_damping_of_a_window_is_taken_out(noise, near):
    shift = 0.6
    rng = np.random.default_rng(0)
    s = 2j * np.pi * FREQ
    slow = modal_sum(s + shift)
    slow = slow * (
        1.0 + noise * (rng.standard_normal(slow.shape) + 1j * rng.standard_normal(slow.shape))
    )
    frf = updyn.FRF(FREQ, slow, ["1:X", "2:X"], ["1:X"], "receptance", decay=shift)
    true = modal_sum(s)
    found = remove_decay(frf)
    assert found.decay == 0.0
    error = np.abs(found.values - true) / np.abs(true).max(axis=0)
    before = np.abs(slow - true) / np.abs(true).max(axis=0)
    assert before.max() > 0.2
    assert np.sqrt(np.mean(error**2)) < near


def test_a_line_at_0_hz_and_silent_data_stay():
    s = 2j * np.pi * np.concatenate([[0.0], FREQ])
    slow = modal_sum(s + 0.6)
    where = (["1:X", "2:X"], ["1:X"], "receptance")
    frf = updyn.FRF(s.imag / (2 * np.pi), slow, *where, decay=0.6)
    found = remove_decay(frf)
    assert (found.values[0] == frf.values[0]).all()
    true = modal_sum(s)[1:]
    assert np.abs(found.values[1:] - true).max() < 1e-6 * np.abs(true).max()
    silent = replace(frf, values=np.zeros_like(slow))
    assert (remove_decay(silent).values == 0.0).all()


@pytest.mark.parametrize(("n", "fits"), [(1, False), (7, False), (8, True)])
def test_a_window_is_taken_out_of_eight_lines_at_least(n, fits):
    s = 2j * np.pi * FREQ[:n] + 0.5
    frf = updyn.FRF(FREQ[:n], modal_sum(s), ["1:X", "2:X"], ["1:X"], "receptance", decay=0.5)
    if fits:
        assert remove_decay(frf).decay == 0.0
        return
    with pytest.raises(DataError, match=rf"at least 8 lines above 0 Hz, found {n}"):
        remove_decay(frf)


def test_data_without_a_decay_stay():
    s = 2j * np.pi * FREQ
    frf = updyn.FRF(FREQ, modal_sum(s), ["1:X", "2:X"], ["1:X"], "receptance")
    assert remove_decay(frf) is frf


def test_an_update_of_repaired_data_is_that_of_data_without_the_window(chain12, add_noise):
    """s^2 M at s = i omega + a is that of masses with damping 2 a M on springs a^2 M."""
    rate, freq = 0.3, np.linspace(0.6, 22.0, 100)
    groups = {}
    for name, group in chain12.groups.items():
        groups[name] = replace(group, mass_damping=group.mass_damping + 2.0 * rate)
        groups[f"{name}, window"] = updyn.Group(rate**2 * group.mass)
    slow = updyn.Model.from_groups(groups, chain12.dofs)
    sensors = ["2:X", "5:X", "7:X", "12:X"]
    clean, rng = updyn.response(slow, freq, sensors, ["5:X"]), np.random.default_rng(0)
    noisy = add_noise(clean, rng, 0.01, decay=rate)
    start = chain12.scaled({name: {"stiffness": 1.2} for name in chain12.groups})
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    found = updyn.update(start, remove_decay(noisy), unknowns)
    for p in unknowns:
        true = chain12.group(p.group).loss_factor if p.quantity == "loss_factor" else 1.0 / 1.2
        assert abs(found.values[p.name] - true) < 4.0 * found.std[p.name]
