"""A basis that is kept serves other sensors and states as a new one does, and nothing but its own model."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import updyn
from overriding import override
from reduced_cases import moved, plate, true_error
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.kept_basis import KeptBasis, begin_reduction
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import REDUCTION

LINES = np.linspace(5.0, 60.0, 80)
BAND = float(LINES[0]), float(LINES[-1])
SENSORS, FORCES = np.array([31, 130, 250, 470]), np.array([31, 470])


@pytest.fixture(scope="module")
def model() -> updyn.Model:
    return plate()


def reduction_of(
    model: updyn.Model, rows: np.ndarray = SENSORS, band: tuple[float, float] = BAND
) -> Reduction:
    return Reduction(AffineSystem.compile(model), rows, FORCES, band, "superlu", 1e-5)


@pytest.fixture(scope="module")
def kept(model) -> KeptBasis:
    reduction = reduction_of(model)
    reduction.build(reduction.system.start)
    reduction.certify(reduction.system.start, LINES)
    found = KeptBasis.of(model, reduction)
    assert found is not None
    return found


@pytest.mark.parametrize("rows", [SENSORS, SENSORS[:1], np.array([60, 222, 333])])
def test_it_begins_a_reduction_that_is_proved_as_a_new_one(model, kept, rows) -> None:
    reduction = reduction_of(model, rows)
    state = moved(reduction.system, 0.02)
    begin_reduction(reduction, model, kept, state, LINES)
    assert reduction.shifted.count == 0
    found = reduction.certify(state, LINES)
    true = true_error(reduction.system, state, reduction, LINES)
    assert true <= found.error <= 1e-5


def test_what_begins_with_it_leaves_it_as_it_is(model, kept) -> None:
    before, first = kept.basis.size, [A.copy() for A in kept.basis.terms]
    reduction = reduction_of(model)
    begin_reduction(reduction, model, kept, reduction.system.start, LINES)
    reduction.enrich_until_accurate([moved(reduction.system, 0.3)], LINES)
    assert kept.basis.size == before
    for A, B in zip(first, kept.basis.terms, strict=True):
        np.testing.assert_array_equal(A, B)


def test_few_channels_take_few_of_its_vectors(model, kept) -> None:
    reduction = reduction_of(model, SENSORS[:1])
    begin_reduction(reduction, model, kept, reduction.system.start, LINES)
    assert reduction.basis.size < kept.basis.size


def test_it_serves_no_other_model_though_alike_and_no_wider_band(model, kept) -> None:
    assert kept.is_valid_for(model, BAND)
    assert kept.is_valid_for(model, (10.0, 20.0))
    assert not kept.is_valid_for(model.scaled({"quarter 1": {"stiffness": 2.0}}), BAND)
    assert not kept.is_valid_for(plate(), BAND)
    assert not kept.is_valid_for(model, (5.0, 61.0))
    assert not kept.is_valid_for(model, (4.0, 60.0))


def test_another_model_begins_with_a_basis_of_its_own(kept) -> None:
    other = plate(local=0.3)
    reduction = reduction_of(other)
    begin_reduction(reduction, other, kept, reduction.system.start, LINES)
    assert reduction.shifted.count > 0
    found = reduction.certify(reduction.system.start, LINES)
    assert true_error(reduction.system, reduction.system.start, reduction, LINES) <= found.error


def test_copies_and_pickles_have_none(kept) -> None:
    assert pickle.loads(pickle.dumps(kept)) is None  # noqa: S301
    assert copy.deepcopy(kept) is None


def test_a_large_one_is_not_kept(model, monkeypatch) -> None:
    reduction = reduction_of(model)
    reduction.build(reduction.system.start)
    taken = 8 * model.n_dofs * reduction.basis.size
    override(monkeypatch, REDUCTION, kept_bytes=taken)
    assert KeptBasis.of(model, reduction) is not None
    override(monkeypatch, REDUCTION, kept_bytes=taken - 1)
    assert KeptBasis.of(model, reduction) is None
