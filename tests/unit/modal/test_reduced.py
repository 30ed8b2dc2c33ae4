"""Reduced models for modes: their bounds, and the numbers that decide when they grow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import updyn
from reduced_cases import plate
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.shifted import Shifted
from updyn.linalg.solver import Factorised
from updyn.modal.reduced import ReducedModes, _clusters, _principal, _smallest_ratio
from updyn.modal.sensitivity import RealModes
from updyn.sensitivity import Unknowns
from updyn.updating.problem.modal import Pairs
from updyn.updating.problem.modal_reduction import ModalReduction

N = 6
NAMES = ["quarter 1", "quarter 2", "seams"]


def reduced(m: int = 12, *, held: bool = True, for_shapes: bool = False) -> ReducedModes:
    model = plate(m, held=held)
    system = AffineSystem.compile(model)
    unknowns = Unknowns.find(system, updyn.parameters(model, stiffness=NAMES))
    return ReducedModes(system, unknowns, 1e-3, "superlu", for_shapes=for_shapes)


def moved(system: AffineSystem, factor: float, groups: list[str] | None = None) -> State:
    """The start with the stiffness of some groups, or all matrices, times a factor."""
    chosen = [
        groups is None or (term.group in groups and term.quantity == "stiffness")
        for term in system.terms
    ]
    start = system.start
    return replace(start, factor=start.factor * np.where(chosen, factor, 1.0))


def solve(modes: ReducedModes, state: State, n: int = N) -> RealModes:
    """The lowest modes, certified."""
    for _ in range(20):
        found = modes.lowest(state, n, 0.0)
        if modes.certify_or_enrich(state, np.ones(len(NAMES)), found, n):
            return found
    raise AssertionError


def exact(system: AffineSystem, state: State, n: int = N) -> RealModes:
    return RealModes.lowest(system, state, n, 0.0)


@pytest.mark.parametrize("held", [True, False])
def test_modes_are_those_of_the_full_model(held: bool) -> None:
    """Also of a free one, whose rigid-body motion is exact, and far from the start."""
    modes = reduced(held=held)
    for factor in (1.0, 0.3, 5.0):
        state = moved(modes.system, factor, NAMES)
        found, expected = solve(modes, state), exact(modes.system, state)
        assert found.value[:N] == pytest.approx(expected.value[:N], rel=1e-6)
        assert found.rigid.shape[1] == expected.rigid.shape[1] == (0 if held else 1)
        M = found.M
        assert found.shapes[:, :N].T @ (M @ found.shapes[:, :N]) == pytest.approx(
            np.eye(N), abs=1e-9
        )
        overlap = np.abs(np.diag(found.shapes[:, :N].T @ (M @ expected.shapes[:, :N])))
        assert overlap == pytest.approx(np.ones(N), abs=1e-6)


def test_bounds_cover_the_errors_of_a_poor_basis() -> None:
    modes = reduced()
    modes.lowest(modes.system.start, N, 0.0)
    for factor in (1.2, 2.0, 10.0):
        state = moved(modes.system, factor, NAMES)
        found, expected = modes.lowest(state, N, 0.0), exact(modes.system, state)
        bounds = modes.bound_errors(found, state, N)
        true = found.frequency[:N] / expected.frequency[:N] - 1.0
        assert (true >= -1e-12).all()
        assert true.max() > 1e-9
        assert (true <= bounds.frequency).all()


def test_accuracy_depends_on_the_data() -> None:
    modes = reduced()
    for shapes, accuracy in ((False, 1e-3), (True, 1e-5)):
        made = ModalReduction.of(modes.system, modes.unknowns, "superlu", shapes=shapes).modes
        assert (made.accuracy, made.for_shapes) == (accuracy, shapes)


def test_clusters_end_at_gaps_of_two_percent() -> None:
    value = np.array([1.0, 1.0 / 0.985, 1.0 / 0.985 / 0.975, 3.0, 4.0])
    found = list(_clusters(value, 4, 0.0))
    assert [(c.start, c.stop) for c, _ in found] == [(0, 2), (2, 3), (3, 4)]
    assert [gap for _, gap in found] == pytest.approx([0.025, 0.025, 0.25])


def test_factors_are_shared_by_states_down_to_a_tenth() -> None:
    modes = reduced()
    start = modes.system.start
    found = modes.lowest(start, N, 0.0)
    modes.bound_errors(found, start, N)
    assert _smallest_ratio(moved(modes.system, 0.5), start) == pytest.approx(0.5)
    for ratio, is_finite in ((0.11, True), (0.09, False)):
        bound = modes.bound_errors(found, moved(modes.system, ratio), N).shape
        assert np.isfinite(bound).all() == is_finite


def test_modes_of_the_full_model_follow_eight_enrichments() -> None:
    modes = reduced()
    modes.accuracy = -1.0  # never reached
    state, answers = moved(modes.system, 2.0, NAMES), []
    while not answers or not answers[-1]:
        found = modes.lowest(state, N, 0.0)
        answers.append(modes.certify_or_enrich(state, np.ones(len(NAMES)), found, N))
    assert answers == [False] * 9 + [True]


@pytest.mark.parametrize(("size", "is_begun_anew"), [(560, False), (600, True)])
def test_a_basis_is_begun_anew_above_600_vectors(size: int, is_begun_anew: bool) -> None:
    modes = reduced(30)
    modes.lowest(modes.system.start, N, 0.0)
    rng = np.random.default_rng(0)
    modes._append(rng.standard_normal((modes.system.n, size - modes.size)))
    modes.accuracy = -1.0
    state = moved(modes.system, 3.0, NAMES)
    found = modes.lowest(state, N, 0.0)
    assert not modes.certify_or_enrich(state, np.ones(len(NAMES)), found, N)
    assert (modes.size < 100) == is_begun_anew


def test_derivatives_that_matter_are_in_the_basis(monkeypatch: pytest.MonkeyPatch) -> None:
    energy = np.diag([1.5e-3**2, 0.7e-3**2])
    assert _principal(np.eye(2), energy).shape == (2, 1)
    modes, calls = reduced(for_shapes=True), []
    original = Factorised.solve
    monkeypatch.setattr(Factorised, "solve", lambda *a: calls.append(1) or original(*a))
    found = modes.lowest(modes.system.start, N, 0.0)
    before = modes.size
    assert not modes.certify_or_enrich(modes.system.start, np.ones(len(NAMES)), found, N)
    assert len(calls) == 2 * len(NAMES)
    assert modes.size > before


def test_factorisations_serve_as_measures_of_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    modes, permitted = reduced(), []
    original = Shifted.factorise

    def factorise(*args: Any, **options: Any) -> Factorised:
        permitted.append(options["error"])
        return original(*args, **options)

    monkeypatch.setattr(Shifted, "factorise", factorise)
    solve(modes, modes.system.start)
    assert permitted == [1e-5]


@pytest.mark.parametrize(("error", "is_confirmed"), [(0.7e-6, True), (1.4e-6, False)])
def test_frequencies_are_confirmed_to_one_in_a_million(error: float, is_confirmed: bool) -> None:
    modes = reduced()
    found = solve(modes, modes.system.start)
    reduction = ModalReduction(modes)
    spans = tuple(np.arange(N)[:, None])
    pairs = Pairs(found, np.arange(N), np.ones(N), spans)
    full = replace(found, value=found.value * (1.0 + error) ** 2)
    size = modes.size
    assert reduction.confirm(pairs, full) == is_confirmed
    assert reduction.error == pytest.approx(error, rel=1e-6)
    assert modes.size == size  # the shapes are known
