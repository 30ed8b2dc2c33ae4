"""Close modes in the judgement of an update: subspaces of a mast whose bending modes come in pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.correlation.model_modes import ModelModes
from updyn.store.result import result_to_json
from updyn.updating.judge.modal_figures import correlate_measured_modes
from updyn.updating.judge.modal_table import compare_modes
from updyn.updating.judge.modal_trust import claim_modes_plausible
from updyn.updating.problem.data import ModalSplit
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise.modes import ModalNoise

N = 3
LABELS = [f"{i + 1}:X" for i in range(N)] + [f"{i + 1}:Y" for i in range(N)]


def mast(split=0.0):
    """Three storeys that bend equally in X and Y, but for a relative difference of stiffness."""
    groups = {}
    for i in range(N):
        K = np.zeros((N, N))
        K[i, i] = 2e4
        if i:
            K[i - 1 : i + 1, i - 1 : i + 1] += 2e4 * np.array([[1, -1], [-1, 0]])
        groups[f"storey{i + 1}"] = updyn.Group(scipy.linalg.block_diag(K, (1 + split) * K))
    return updyn.Model.from_groups(groups | {"mass": updyn.Group(mass=np.eye(2 * N))}, LABELS)


def measured(turn, factor=1.0):
    """The modes of the mast in a basis that is turned in each plane, with frequencies of a factor."""
    modes = updyn.modes(mast(1e-6), 2 * N)  # in X and Y
    angle = np.deg2rad(turn)
    basis = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return updyn.ModeSet(factor * modes.frequency, modes.shapes @ np.kron(np.eye(N), basis), LABELS)


@pytest.mark.parametrize("split", [0.0, 2e-4])
@pytest.mark.parametrize("turn", [0, 10, 30, 45, 90])
def test_figures_and_verdict_do_not_depend_on_the_basis(split, turn):
    model, modes = mast(split), measured(turn, 1.02)
    unknowns = updyn.parameters(model, stiffness="storey*")
    part = ModalPart.build(model, modes, unknowns, ModalNoise())
    found = correlate_measured_modes(part, part.coordinates.start, ModalSplit(modes, modes))
    after = found["after"]
    assert after["mac_min"] == pytest.approx(1.0, abs=1e-9)
    assert after["modes_paired"] == after["modes_close"] == after["modes_measured"] == 2 * N
    assert after["frequency_error_rms"] == pytest.approx(100 * np.log(1.02), rel=0.01)
    claim = claim_modes_plausible(found["before"], after)
    assert claim.holds
    assert "that of 6 close modes by subspaces" in claim.why


def test_separate_modes_have_the_figures_of_their_residuals():
    model, modes = mast(0.1), updyn.modes(mast(0.12), 2 * N)
    shapes = modes.shapes + 0.05 * np.sin(np.arange(36)).reshape(6, 6)
    given = updyn.ModeSet(modes.frequency, shapes, LABELS)
    part = ModalPart.build(model, given, updyn.parameters(model, stiffness="storey*"), ModalNoise())
    x = part.coordinates.start
    after = correlate_measured_modes(part, x, ModalSplit(given, given))["after"]
    assert "modes_close" not in after
    assert after["mac_min"] == part.rows(x, derivatives=False).mac.min() < 1.0


def test_the_modal_table_marks_the_mac_of_subspaces():
    table = compare_modes(ModelModes(mast(0.1)), ModelModes(mast()), measured(45.0))
    for row in table.rows:
        assert row.updated.mac == pytest.approx(1.0)
        assert row.updated.in_subspace
        assert not row.test.in_subspace
    assert table.figures()["updated"]["mac_min"] == pytest.approx(1.0)
    start, updated = table.correlations["start"], table.correlations["updated"]
    assert [one.close for one in start.subspaces] == ["measured"] * N
    assert [one.close for one in updated.subspaces] == ["both"] * N
    lines = table.text().splitlines()
    assert sum(line.count("1.000*") for line in lines) == 4 * N
    assert lines[2 + 2 * N].startswith("* Subspace MAC of modes within 0.6 % of frequency")
    assert "MAC of single shapes at best" in lines[3 + 2 * N]


def test_a_table_of_separate_modes_has_no_marks():
    model = ModelModes(mast(0.1))
    table = compare_modes(model, model, updyn.modes(mast(0.12), 2 * N))
    assert not any(row.updated.in_subspace for row in table.rows)
    assert "*" not in table.text()
    assert table.subspace_notes == ()


def test_the_record_of_a_result_has_the_subspaces(tmp_path):
    model, modes = mast(), measured(30.0)
    result = updyn.update(model, modes, updyn.parameters(model, stiffness="storey*"))
    updyn.write_result(replace(result, modes=updyn.modal_table(result)), tmp_path / "run.nc")
    record = result_to_json(updyn.read_result(tmp_path / "run.nc"))["modes"]
    first, *others = record["subspaces"]["updated"]
    assert len(others) == N - 1
    assert first["computed"] == first["measured"] == [0, 1]
    assert first["cosines"] == pytest.approx([1.0, 1.0])
    assert record["rows"][0]["updated"]["in_subspace"]
