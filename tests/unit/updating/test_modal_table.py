"""The modal table of an update: test, start and updated, and what it says where it is not known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.correlation.model_modes import ModelModes
from updyn.errors import OptionError
from updyn.updating.judge import counterparts
from updyn.updating.judge.modal_table import compare_modes
from updyn.updating.modes import compare_start_modes

N = 5
K0 = 2e4 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
LABELS = [f"{i + 1}:Z" for i in range(N)]


def model():
    """Five masses between two walls; the third can be made heavier, the last spring stiffer."""
    local = np.zeros((N, N))
    local[-1, -1] = 2e4
    third = np.zeros((N, N))
    third[2, 2] = 1.0
    groups = {
        "frame": updyn.Group(K0 - local, np.eye(N) - third, loss_factor=0.02),
        "end": updyn.Group(local, loss_factor=0.02),
        "third": updyn.Group(mass=third),
    }
    return updyn.Model.from_groups(groups, LABELS)


TRUE = {"end": {"stiffness": 1.5}, "third": {"mass": 1.2}}


def frequencies(changed):
    K, M = K0.copy(), np.eye(N)
    if changed:
        K[-1, -1] += 0.5 * 2e4
        M[2, 2] = 1.2
    return np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)


def measured(n_lines=400):
    lines = np.linspace(5.0, 50.0, n_lines)
    return updyn.response(
        model().scaled(TRUE), lines, ["1:Z", "2:-Z", "4:Z", "5:Z"], ["1:Z"], "accelerance"
    )


def updated(**options):
    start = model()
    unknowns = updyn.parameters(start, stiffness=["end"], mass=["third"])
    return updyn.update(start, measured(), unknowns, **options)


def test_the_table_of_an_update_of_exact_data():
    result = updated()
    assert result.modes is None  # an update does not look for modes by itself
    table = updyn.modal_table(result)
    assert table.known
    assert not table.notes
    assert len(table.rows) == N
    at_start, in_test = frequencies(False), frequencies(True)
    for i, row in enumerate(table.rows):
        assert row.test.frequency == pytest.approx(in_test[i], rel=1e-5)
        assert row.start.frequency == pytest.approx(at_start[i], rel=1e-6)
        assert row.updated.frequency == pytest.approx(in_test[i], rel=1e-5)
        assert row.test.loss_factor == pytest.approx(0.02, rel=1e-3)
        change = 100 * (at_start[i] / in_test[i] - 1)
        assert row.start.change == pytest.approx(change, abs=1e-2)
        assert row.updated.change == pytest.approx(0.0, abs=1e-2)
        assert row.updated.mac == pytest.approx(1.0, abs=1e-4)
        assert row.start.mac < row.updated.mac
    figures = table.figures()
    assert figures["updated"]["pairs"] == N
    text = table.text()
    assert f"{in_test[0]:#.5g}" in text
    assert f"{at_start[0]:#.5g}" in text
    assert len(text.splitlines()) == 2 + N


def test_modes_that_test_or_model_lack_have_rows_of_their_own():
    result = updated()
    M = np.diag([1, 1, 1.2, 1, 1])
    K = K0.copy()
    K[-1, -1] += 0.5 * 2e4
    value, shapes = scipy.linalg.eigh(K, M)
    f = np.sqrt(value) / (2 * np.pi)
    # the test has not the third mode, and one that no model has
    shape = np.column_stack([shapes[:, [0, 1, 3, 4]], np.eye(N)[0] + np.eye(N)[1]])
    test = updyn.ModeSet([*f[[0, 1, 3, 4]], 0.5 * (f[0] + f[1])], shape, LABELS)
    rows = updyn.modal_table(result, test).rows
    assert len(rows) == N + 1
    (lacking,) = [row for row in rows if row.test is None]
    assert lacking.updated.frequency == pytest.approx(f[2], rel=1e-5)
    assert lacking.start.frequency == pytest.approx(frequencies(False)[2], rel=1e-6)
    assert lacking.updated.mac is None
    (foreign,) = [row for row in rows if row.updated is None]
    assert foreign.start is None
    assert foreign.test.frequency == pytest.approx(0.5 * (f[0] + f[1]))
    assert [row.frequency for row in rows] == sorted(row.frequency for row in rows)


def test_given_modes_are_used():
    value, shapes = scipy.linalg.eigh(K0)
    f = np.sqrt(value) / (2 * np.pi)
    modes = updyn.ModeSet(1.1 * f[:3], shapes[:, :3], LABELS)
    result = dataclasses.replace(updated(), options={"modes": modes})
    table = updyn.modal_table(result)
    assert table.test.frequency == pytest.approx(1.1 * f[:3])
    assert [row.start.change for row in table.rows] == pytest.approx([100 * (1 / 1.1 - 1)] * 3)


def test_too_few_lines_say_so_and_break_nothing():
    result = dataclasses.replace(updated(), data=measured(n_lines=3))
    table = updyn.modal_table(result)
    assert not table.known
    assert table.rows == ()
    assert table.figures() == {}
    assert "No modes could be identified from the FRFs: 3 lines are too few" in table.text()


def test_a_large_model_is_left_until_asked_for():
    result = updated()
    table = updyn.modal_table(result, largest=4)
    assert not table.known
    assert "updyn.modal_table(result, largest=5)" in table.text()


def test_calibration_factors_are_divided_out():
    frf = measured()
    gain = np.array([1.0, 2.0, 1.0, 1.0])[:, None]
    off = dataclasses.replace(frf, values=frf.values * gain)
    start = model()
    unknowns = updyn.parameters(start, stiffness=["end"], mass=["third"])
    unknowns += updyn.calibration(frf, responses=["2:Z"], prior_std=1.0)
    result = updyn.update(start, off, unknowns)
    table = updyn.modal_table(result)
    assert min(row.updated.mac for row in table.rows) == pytest.approx(1.0, abs=1e-3)
    assert "calibration" in table.notes[0]


def test_a_model_without_modes_there_is_said():
    modes = updyn.ModeSet([1.0], np.ones((N, 1)), LABELS)
    table = compare_modes(ModelModes(model()), ModelModes(model()), modes)
    assert not table.known
    assert "The modes of the start model could not be computed" in table.notes[0]


def test_a_joint_result_is_refused():
    result = updyn.JointResult({"a": updated()})
    with pytest.raises(OptionError, match="result of one test, found JointResult"):
        updyn.modal_table(result)


def test_modes_before_a_fit_are_those_of_few_references_with_a_note(monkeypatch):
    settings = dataclasses.replace(counterparts.COUNTERPARTS, most_values=2 * 5 * 300)
    monkeypatch.setattr(counterparts, "COUNTERPARTS", settings)
    freq = np.linspace(3.0, 60.0, 300)
    clean = updyn.response(model().scaled(TRUE), freq, LABELS, LABELS, "accelerance")
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, *clean.values.shape))
    frf = dataclasses.replace(
        clean, values=clean.values * (1.0 + 0.01 * (noise[0] + 1j * noise[1]))
    )
    table = compare_start_modes(ModelModes(model()), frf)
    assert table.notes[0].startswith("The modes of the test are those of 2 of 5 references")
    np.testing.assert_allclose(table.test.frequency, frequencies(changed=True), rtol=1e-3)
    one = compare_start_modes(ModelModes(model()), frf.select(references=LABELS[:1]))
    assert not any("references" in note for note in one.notes)
