"""Thresholds of reduced fits by value: a case just within each, and one just beyond."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.updating.fit import reducing
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.method import Fit
from updyn.updating.fit.reducing import (
    Reducing,
    _faintest_level,
    _Part,
    _ReducedModels,
    are_modes_reduced,
    is_reduced,
)
from updyn.updating.fit.search import Search
from updyn.updating.fitted import _perturb_start
from updyn.updating.problem.local import Local
from updyn.updating.problem.residuals import OutputErrorSet


@pytest.mark.parametrize(
    ("n", "n_lines", "expected"), [(600, 40, False), (601, 40, True), (601, 39, False)]
)
def test_large_models_with_many_lines_are_reduced(n, n_lines, expected):
    assert is_reduced(None, n, n_lines) == expected


@pytest.mark.parametrize(("n", "expected"), [(3000, False), (3001, True)])
def test_large_models_are_reduced_for_their_modes(n, expected):
    assert are_modes_reduced(None, n) == expected


def reducing_at(x: np.ndarray, n_dofs: int = 1000) -> Reducing:
    """Reduced models of a factor and loss factors whose basis is at x."""
    made = Reducing.__new__(Reducing)
    is_damping = np.arange(len(x)) > 0
    made.exact = SimpleNamespace(
        coordinates=SimpleNamespace(parameters=SimpleNamespace(is_damping=is_damping))
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
    part = SimpleNamespace(state=lambda x: x, solved_lines=np.ones(1))
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


@pytest.mark.parametrize(("faintest", "accuracy"), [(1.0, 1e-5), (1e-3, 1e-6), (1e-7, 1e-9)])
def test_the_error_is_a_thousandth_of_the_faintest_channel(monkeypatch, faintest, accuracy):
    made = SimpleNamespace(accuracy=None, shifted=SimpleNamespace(keeps=None))
    monkeypatch.setattr(reducing, "make_reduction", lambda *about: made)
    monkeypatch.setattr(reducing, "_faintest_level", lambda frf: faintest)
    part = SimpleNamespace(
        receptance_dofs=([0], [0]),
        solver=SimpleNamespace(other_dofs=lambda known: np.arange(5)),
        frf=SimpleNamespace(quantity="receptance"),
    )
    _Part.of(part, 1e-5, keeps=True)
    assert made.accuracy == pytest.approx(accuracy)


def test_the_error_at_the_start_is_ten_times_that_of_the_end(monkeypatch):
    ratios = []
    monkeypatch.setattr(Reducing, "_build", lambda self, x: None)
    monkeypatch.setattr(Reducing, "_enrich", lambda self, x, ratio: ratios.append(ratio))
    made = reducing_at(np.zeros(1))
    made.exact.coordinates.start = np.zeros(1)
    for part in made._parts:
        part.solver = None
    made.begin()
    assert ratios == [10.0]


def make_monitor() -> SimpleNamespace:
    return SimpleNamespace(history=[], stage=lambda *about: nullcontext())


@pytest.mark.parametrize(("ratio", "number"), [(0.79, 12), (0.81, 1)])
def test_descents_from_the_start_go_on_while_the_misfit_falls(monkeypatch, ratio, number):
    """Within four times the trust radius of a fit."""
    boxes, costs = [], [1.0]

    def descend(problem, residual, x, *about):
        costs.append(ratio * costs[-1])
        return SimpleNamespace(x=x, local=SimpleNamespace(cost=costs[-1]), reason="max-iterations")

    few = SimpleNamespace(with_box=boxes.append)
    for name, value in {"with_reduced_models": None, "_is_near": False, "_build": None}.items():
        monkeypatch.setattr(Reducing, name, lambda self, *about, v=value: v)
    monkeypatch.setattr(reducing, "thin_problem", lambda *about: few)
    monkeypatch.setattr(reducing, "make_log_error", lambda problem: None)
    monkeypatch.setattr(reducing, "_log_error_cost", lambda problem, x: 1.0)
    monkeypatch.setattr(reducing, "_is_answer", lambda *about: False)
    monkeypatch.setattr(reducing, "descend", descend)
    made = reducing_at(np.zeros(1))
    made.exact.coordinates.start = np.zeros(1)
    made._descend_from_start(None, (), make_monitor())
    assert len(boxes) == number
    assert boxes[0][1] == pytest.approx([0.8])


@dataclass(frozen=True)
class MovingFit:
    """A method whose fits all end outside the trust region."""

    max_iterations: int = 1000
    boxes: list = field(default_factory=list)

    def fit(self, problem, noises, monitor, x):
        self.boxes.append(problem)
        return Fit(x + 99.0, "converged", np.eye(1), ())


def test_two_bases_are_built_and_the_trust_radius_grows_with_enriched_ones(monkeypatch):
    made, calls, strategy = reducing_at(np.zeros(1)), [], MovingFit()
    made.certified = False
    problem = SimpleNamespace(with_box=lambda box: float(box[1][0] - box[0][0]) / 2.0)
    monkeypatch.setattr(Reducing, "with_reduced_models", lambda self, about: problem)
    monkeypatch.setattr(Reducing, "_add_note", lambda self, fit: fit)
    monkeypatch.setattr(Reducing, "_is_near", lambda self, x: False)
    for name in ("_build", "_enrich", "_certify"):
        monkeypatch.setattr(Reducing, name, lambda self, x, n=name: calls.append(n))
    made._fit_in_rounds(problem, strategy, (), make_monitor(), np.zeros(1))
    assert calls[:4] == ["_build", "_enrich", "_enrich", "_enrich"]
    assert strategy.boxes[:5] == pytest.approx([0.2, 0.2, 0.4, 0.8, 1.6])


@pytest.mark.parametrize(("n_factors", "n_points"), [(1, 8), (4, 8), (5, 10)])
def test_points_around_the_start_span_a_basis(monkeypatch, n_factors, n_points):
    """Two for each factor, at least eight; 40 further ones select among the vectors."""
    seen = []
    problem = SimpleNamespace(thin=lambda number: None)
    monkeypatch.setattr(Reducing, "with_reduced_models", lambda self, about: problem)
    made = reducing_at(np.zeros(n_factors))
    made.exact.coordinates = SimpleNamespace(
        start=np.zeros(n_factors),
        bounds=(np.full(n_factors, -9.0), np.full(n_factors, 9.0)),
        parameters=SimpleNamespace(is_damping=np.zeros(n_factors, dtype=bool)),
    )
    made._parts = [SimpleNamespace(build_around=lambda *points: seen.extend(points))]
    made._build_around_start(problem)
    assert [len(points) for points in seen] == [1 + n_points, 41]


def test_a_basis_around_the_start_drops_a_share_of_the_energy():
    """The square root of the share is 1e-4: 0.01 % of the size of the response fields."""
    dropped = []
    reduction = SimpleNamespace(
        build=lambda state: None,
        extend=lambda states: None,
        compress_around=lambda states, freq, share: dropped.append(share),
        solver=lambda text: None,
    )
    part = SimpleNamespace(state=lambda x: x, solved_lines=np.ones(1))
    _Part(part, reduction).build_around([np.zeros(1)], [np.zeros(1)])
    assert dropped == [1e-4]


def test_the_noise_of_a_search_includes_ten_times_the_error_of_the_basis():
    reduced = SimpleNamespace(
        lost=np.array([1e-3, 2e-3]),
        exact=SimpleNamespace(rows=np.array([4, 7]), channel_errors=lambda lost: lost),
    )
    made = reducing_at(np.zeros(1))
    made._parts = [reduced]
    problem = SimpleNamespace(parts=[SimpleNamespace(rows=np.array([7]))])
    (noise,) = made._add_basis_error(problem, [None])
    assert noise.share == pytest.approx([0.02])
