"""Thresholds of the estimation of FRFs from records: a case on either side of each."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.errors import DataError
from updyn.geometry import Geometry
from updyn.signals import estimate, joining, local, local_model, records
from updyn.signals.local_model import LocalModel
from updyn.signals.records import Records
from updyn.signals.spectra import Spectra
from updyn.signals.windows import ImpactWindow


def raises(wrong: bool):
    """Return the context in which data are wrong, or not."""
    return pytest.raises(DataError) if wrong else nullcontext()


def test_models_have_six_degrees_of_freedom():
    assert LocalModel(2, 8, 2).freedom(1, 2) == 6
    assert LocalModel(2, 8, 2) in local._sufficient_models(1, 2)
    assert LocalModel(0, 8, 2).freedom(1, 3) == 5
    assert LocalModel(0, 8, 2) not in local._sufficient_models(1, 3)


@pytest.mark.parametrize(("share", "wrong"), [(0.009, True), (0.011, False)])
def test_a_force_is_separable(share, wrong):
    with raises(wrong):
        local._check_separable(np.array([[share]]), np.array([1.0]), ("a",))
    found = SimpleNamespace(omission_error=np.ones((1, 1)), separable=np.array([[share]]))
    assert np.isinf(local._omission_errors(found)[0]) == wrong


def test_models_are_compared_over_33_lines():
    error = np.zeros((301, 1))
    error[150] = 33.0
    found = SimpleNamespace(omission_error=error, separable=np.ones((301, 1)))
    smooth = local._omission_errors(found)
    near = np.abs(np.arange(301) - 150) <= 16
    assert smooth[near] == pytest.approx(0.0, abs=1e-12)
    assert smooth[~near] == pytest.approx(np.log(1e-16))


def test_a_line_that_the_model_follows_counts_fifty_times():
    fit = SimpleNamespace(
        residual=np.ones((1, 3, 1)), windows=SimpleNamespace(motion=np.ones((1, 1, 3, 1)))
    )
    solution = SimpleNamespace(
        fit=fit, leverage=np.array([[[1.0], [0.99], [0.9]]]), _at_lines=lambda error: error
    )
    error = local_model._Solution._omission_error.fget(solution)
    assert error.ravel() == pytest.approx([2500.0, 2500.0, 100.0])


def test_dependent_columns_have_large_weights():
    x = local_model._solve_triangular(np.diag([1.0, 1e-15])[None], np.ones((1, 2, 1)))
    assert x.ravel() == pytest.approx([1.0, 1.0 / 1.1e-14])


@pytest.mark.parametrize(("change", "wrong"), [(0.9e-3, False), (1.1e-3, True)])
def test_times_are_even(change, wrong):
    steps = np.resize([1.0 + change, 1.0 - change], 100)
    with raises(wrong):
        records.find_step(np.concatenate([[0.0], np.cumsum(steps)]))


@pytest.mark.parametrize(("digit", "wrong"), [(0.19, False), (0.21, True)])
def test_times_have_fine_digits(digit, wrong):
    times = np.round(np.arange(100.0) / digit) * digit
    with raises(wrong):
        records.find_step(times, np.full(100, digit))


@pytest.mark.parametrize(("change", "wrong"), [(0.9e-6, False), (1.1e-6, True)])
def test_files_of_one_setup_have_one_step(change, wrong):
    first, other = (
        Records.of(np.ones((1, 1, 8)), step, ("a",), ("N",)) for step in (1.0, 1.0 + change)
    )
    with raises(wrong):
        records.chain_records([first, other])


def forces(F):
    """Return spectra of forces, shape (records, lines, forces)."""
    F = np.asarray(F, dtype=np.complex128)
    return Spectra.of(F, np.ones((*F.shape[:2], 1), dtype=np.complex128), float(len(F)))


@pytest.mark.parametrize(("size", "wrong"), [(0.9e-12, True), (1.1e-12, False)])
def test_a_force_is_zero_at_a_line(size, wrong):
    with raises(wrong):
        forces([[[1.0], [size]]]).check_power(np.array([1.0, 2.0]), ("a",))


@pytest.mark.parametrize(("least", "wrong"), [(0.9e-12, True), (1.2e-12, False)])
def test_forces_are_independent(least, wrong):
    # The coherence matrix of unit vectors at an angle has the eigenvalues 1 -+ cos(angle).
    angle = np.sqrt(2.0 * least)
    F = [[[1.0, np.cos(angle)]], [[0.0, np.sin(angle)]]]
    with raises(wrong):
        forces(F).check_forces(np.array([1.0]), ("a", "b"))


@pytest.mark.parametrize(("length", "wrong"), [(21, True), (24, False)])
def test_a_force_is_a_pulse(length, wrong):
    force = np.zeros((1, 1, 1000))
    force[..., 100 : 100 + length] = 1.0  # nine tenths of it last 0.9 of this
    with raises(wrong):
        estimate._check_no_pulses(force, 1.0, ("a",), "LRM")


def test_the_force_window_falls_over_its_last_tenth():
    force = np.zeros(200)
    force[50] = 1.0
    window = ImpactWindow(force=0.1).on_force(force, 1e-3)
    assert window[50 + np.array([89, 90, 95, 100])] == pytest.approx([1.0, 1.0, 0.5, 0.0])
    assert window[50 + 92] < 0.95


@pytest.mark.parametrize(("change", "wrong"), [(0.9e-9, False), (1.1e-9, True)])
def test_setups_have_equal_lines(change, wrong):
    first, other = (
        SimpleNamespace(decay=0.0, level_text="", quantity="mobility", freq=np.array([1.0, f]))
        for f in (2.0, 2.0 * (1.0 + change))
    )
    with raises(wrong):
        joining._check_same_lines(first, other, "a", "b")


@pytest.mark.parametrize(("change", "wrong"), [(0.9e-6, False), (1.1e-6, True)])
def test_setups_have_equal_positions(change, wrong):
    setups = [SimpleNamespace(geometry=Geometry([1], [[x, 0.0, 0.0]])) for x in (0.0, change)]
    with raises(wrong):
        joining._joined_geometry(setups, ("a", "b"))
