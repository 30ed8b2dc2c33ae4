"""Thresholds of reduced fits by value: a case just within each, and one just beyond."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.updating.fit.answer import Answer
from updyn.updating.fit.reducing import Reducing, _faintest_level, _Part, _ReducedModels, is_reduced
from updyn.updating.fit.search import Search
from updyn.updating.fitted import _perturb_start
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import OutputErrorSet


@pytest.mark.parametrize(
    ("n", "n_lines", "expected"), [(600, 40, False), (601, 40, True), (601, 39, False)]
)
def test_large_models_with_many_lines_are_reduced(n, n_lines, expected):
    assert is_reduced(None, n, n_lines) == expected


def reducing_at(x: np.ndarray, n_dofs: int = 1000) -> Reducing:
    """Reduced models of a factor and loss factors whose basis is at x."""
    made = Reducing.__new__(Reducing)
    is_factor = np.arange(len(x)) == 0
    made.exact = SimpleNamespace(
        coordinates=SimpleNamespace(parameters=SimpleNamespace(is_factor=is_factor))
    )
    made._parts = [
        SimpleNamespace(exact=SimpleNamespace(solver=SimpleNamespace(system=SimpleNamespace(n=n))))
        for n in (10, n_dofs)
    ]
    made._x = x
    return made


def test_the_trust_radius_of_a_basis():
    x = np.array([1.0, 0.02, 0.3])
    lower, upper = reducing_at(x)._box()
    assert upper - x == pytest.approx([0.2, 0.05, 0.15])
    assert x - lower == pytest.approx([0.2, 0.05, 0.15])


@pytest.mark.parametrize(
    ("n_dofs", "distance", "is_near"),
    [
        (20_000, 0.019, True),
        (20_000, 0.021, False),
        (20_001, 0.021, True),
        (20_001, 0.19, True),
        (20_001, 0.21, False),
    ],
)
def test_bases_are_enriched_nearby_and_those_of_heavy_models_farther(n_dofs, distance, is_near):
    assert reducing_at(np.zeros(1), n_dofs)._is_near(np.array([distance])) == is_near


@pytest.mark.parametrize(("size", "is_compressed"), [(400, False), (401, True)])
def test_large_bases_are_compressed(size, is_compressed):
    calls = []
    reduction = SimpleNamespace(
        build=lambda state: None,
        basis=SimpleNamespace(size=size),
        compress=lambda *about: calls.append(about),
    )
    part = SimpleNamespace(state=lambda x: x, frf=SimpleNamespace(freq=np.ones(1)))
    _Part(part, reduction).build(np.zeros(1))
    assert bool(calls) == is_compressed


def models_at(x: np.ndarray) -> _ReducedModels:
    return _ReducedModels(None, SimpleNamespace(parts=[]), reducing_at(x), (), ())


@pytest.mark.parametrize(("distance", "number"), [(0.049, 0), (0.051, 6)])
def test_bases_are_enriched_away_from_an_answer_up_to_six_times(monkeypatch, distance, number):
    passes = []

    def enrich(self, x, number):
        passes.append(number)
        return True

    monkeypatch.setattr(_ReducedModels, "_is_enriched", enrich)
    models = models_at(np.zeros(1))
    for _ in range(10):
        models.near(np.array([distance]))
    assert len(passes) == number


@pytest.mark.parametrize(("share", "leads_back"), [(0.49, False), (0.51, True)])
def test_a_misfit_near_the_quadratic_model_leads_back(share, leads_back):
    local = Local(0.0, np.eye(1), np.zeros(1))
    answer = Answer(np.zeros(1), "converged", 7.0, (), OutputErrorSet(()), local)
    misfit = 7.0 + share * 0.5 * 3.0**2
    assert models_at(np.zeros(1)).leads_back(np.array([3.0]), answer, misfit) == leads_back


@pytest.mark.parametrize(("size", "is_reset"), [(300, False), (301, True)])
def test_a_basis_that_has_grown_by_two_hundred_vectors_is_reset(size, is_reset):
    taken = []
    basis = SimpleNamespace(size=size, take_leading=lambda n: taken.append(n) or basis)
    reduction = SimpleNamespace(
        basis=basis, accuracy=1e-5, enrich_with_nearby_factor=lambda *about: False
    )
    models = models_at(np.zeros(1))
    exact = SimpleNamespace(state=lambda x: x)
    models._reducing._parts = [SimpleNamespace(reduction=reduction, exact=exact)]
    models._definite, models._sizes = [None], [100]
    part = SimpleNamespace(
        responses=lambda x: np.ones((2, 1, 1)), frf=SimpleNamespace(freq=np.ones(2))
    )
    models.latest = SimpleNamespace(parts=[part])
    assert not models._is_enriched(np.zeros(1), 0)
    assert taken == ([100] if is_reset else [])


def test_the_accepted_error_in_a_search_for_answers_is_ten_times_that_of_the_fit():
    seen = []
    reduction = SimpleNamespace(
        basis=SimpleNamespace(size=10),
        accuracy=1e-5,
        enrich_with_nearby_factor=lambda *about: seen.append(about[-1]) or False,
    )
    models = models_at(np.zeros(1))
    exact = SimpleNamespace(state=lambda x: x)
    models._reducing._parts = [SimpleNamespace(reduction=reduction, exact=exact)]
    models._definite, models._sizes = [None], [10]
    part = SimpleNamespace(
        responses=lambda x: np.ones((2, 1, 1)), frf=SimpleNamespace(freq=np.ones(2))
    )
    models.latest = SimpleNamespace(parts=[part])
    models._is_enriched(np.zeros(1), 0)
    assert seen == [pytest.approx(1e-4)]


@pytest.mark.parametrize(("level", "faintest"), [(1.1e-9, 1.1e-9), (0.9e-9, 1e-3)])
def test_channels_below_a_billionth_are_rounding(monkeypatch, level, faintest):
    shares = np.array([1.0, 1e-3, level])
    monkeypatch.setattr("updyn.updating.fit.reducing.relative_levels", lambda values, frf: shares)
    assert _faintest_level(SimpleNamespace(values=None)) == faintest


def test_the_best_try_goes_on_for_five_times_as_many_steps(monkeypatch):
    seen = []
    monkeypatch.setattr("updyn.updating.fit.search.make_log_error", lambda problem: None)
    monkeypatch.setattr(
        Search, "_relaxed_descent", staticmethod(lambda *about: seen.append(about[-1]))
    )
    best = SimpleNamespace(reason="max-iterations", x=np.zeros(1))
    Search(max_iterations=20)._continue_best(None, None, best, [])
    assert [settings.max_iterations for settings in seen] == [100]


def test_a_start_at_a_natural_frequency_is_changed_by_a_thousandth():
    seen = []
    n = 50
    coordinates = SimpleNamespace(
        start=np.zeros(n),
        bounds=(np.full(n, -1.0), np.full(n, 1.0)),
        parameters=[SimpleNamespace(quantity="stiffness")] * n,
        with_start=seen.append,
    )
    _perturb_start(SimpleNamespace(coordinates=coordinates, with_coordinates=lambda c: None))
    (x,) = seen
    assert 0.5e-3 <= x.min() < 0.55e-3
    assert 0.95e-3 < x.max() <= 1e-3
