"""Settings of samplers by value: proposals, warm-up, the end of chains, and failed refits."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_t

from updyn.uncertainty import bootstrap, sampling, surrogate
from updyn.uncertainty.sampling import Mixture, _SamplingRun, _with_floor
from updyn.updating.problem.parameters import Parameter, ParameterSet

emcee = pytest.importorskip("emcee")


def one_component(n: int = 1) -> Mixture:
    """A mixture of one component at 0, of unit scale."""
    return Mixture(np.zeros((1, n)), np.eye(n)[None], np.zeros(1), np.ones(1))


def test_a_component_is_a_student_distribution_of_six_degrees_of_freedom():
    points = np.array([[0.0, 0.0], [1.0, -2.0], [5.0, 4.0]])
    expected = multivariate_t(np.zeros(2), np.eye(2), df=6).logpdf(points)
    assert np.diff(one_component(2).log_density(points)) == pytest.approx(np.diff(expected))


def test_a_component_keeps_a_twentieth_of_the_proposals_of_two():
    assert _with_floor(np.array([0.99, 0.01])) == pytest.approx(np.array([0.99, 0.05]) / 1.04)


@pytest.mark.parametrize(("number", "is_adapted"), [(10, False), (11, True)])
def test_more_than_ten_draws_give_a_covariance(number, is_adapted):
    draws = 5.0 + np.arange(float(number))[:, None]
    assert bool(one_component().adapt(draws).means[0, 0]) == is_adapted


def test_proposals_are_of_the_mixture_of_differences_and_of_snooker_updates(monkeypatch):
    class Made(Exception):  # noqa: N818
        pass

    def make(*about, moves, **options):
        raise Made([weight for _, weight in moves])

    monkeypatch.setattr(emcee, "EnsembleSampler", make)
    state = SimpleNamespace(coords=np.zeros((4, 1)), log_prob=None, random=None)
    with pytest.raises(Made) as made:
        sampling._run_steps(None, (one_component(), state, 1))
    assert made.value.args == ([0.7, 0.2, 0.1],)


class Chains:
    """A sampler whose chains have a given effective size; its calls are recorded."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, effective: float) -> None:
        self.steps: list[int] = []
        self.warm = 0
        figures = {name: np.array([effective]) for name in ("ess_bulk", "ess_tail")}
        figures["r_hat"] = np.ones(1)
        mixture = SimpleNamespace(adapt=self.adapt)
        for name, value in {"find_minima": ["minimum"], "compute_diagnostics": figures}.items():
            monkeypatch.setattr(sampling, name, lambda *about, v=value: v)
        monkeypatch.setattr(Mixture, "of", lambda *about: mixture)
        monkeypatch.setattr(_SamplingRun, "_begin", lambda self, *about: [])
        monkeypatch.setattr(_SamplingRun, "_advance", self.advance)

    def adapt(self, draws: np.ndarray) -> None:
        self.warm = len(draws)

    def advance(self, likelihood, mixture, states, steps):
        self.steps.append(steps)
        return states, np.zeros((4, steps, 1)), 0.5

    def run(self) -> None:
        """Run until the chains are long enough; the callback stops after the third round."""
        likelihood = SimpleNamespace(descend=lambda x: "minimum")
        restored = SimpleNamespace(
            x=np.zeros(1), is_reduced=False, whole=None, likelihood=lambda: likelihood
        )
        restored.with_problem = lambda problem: restored
        counter = SimpleNamespace(report=lambda: len(self.steps) > 3)
        _SamplingRun(restored, 1, 0, 0, 10**9, counter).compute(None)


@pytest.mark.parametrize(("times", "n_rounds"), [(20.1, 1), (19.9, 3)])
def test_chains_are_as_long_as_twenty_autocorrelation_times(monkeypatch, times, n_rounds):
    """Of four chains, the effective size is four times as many."""
    chains = Chains(monkeypatch, 4.0 * times)
    chains.run()
    assert len(chains.steps) - 1 == n_rounds


def test_forty_steps_of_warm_up_are_discarded(monkeypatch):
    """The second half of them adapts the mixture."""
    chains = Chains(monkeypatch, 1e9)
    chains.run()
    assert chains.steps[0] == 40
    assert chains.warm == 4 * 20


def test_there_are_four_ensembles(monkeypatch):
    monkeypatch.setattr(sampling, "_log_prob", lambda likelihood, coords: np.zeros(len(coords)))
    monkeypatch.setattr(_SamplingRun, "walkers", 6)
    likelihood = SimpleNamespace(bounds=(np.full(1, -9.0), np.full(1, 9.0)))
    run = _SamplingRun(None, 1, 0, 0, 0, None)
    minimum = SimpleNamespace(x=np.zeros(1), cost=0.0)
    assert len(run._begin(likelihood, one_component(), [minimum])) == 4


def test_a_model_is_reduced_at_two_standard_deviations(monkeypatch):
    """Of each of nine unknowns: six in all."""
    enriched = []
    made = SimpleNamespace(
        begin=lambda x: None, problem=lambda: None, enrich=lambda points: enriched.extend(points)
    )
    monkeypatch.setattr(surrogate, "Surrogate", lambda *about: made)
    monkeypatch.setattr(surrogate, "Gaussian", lambda *about: SimpleNamespace(at=lambda z: z))
    far = np.full(9, 99.0)
    likelihood = SimpleNamespace(local=lambda x: "local", bounds=(-far, far))
    part = SimpleNamespace(solver=SimpleNamespace(tier="sparse"))
    restored = SimpleNamespace(
        x=np.zeros(9),
        whole=None,
        results=None,
        problem=SimpleNamespace(parts=[part]),
        likelihood=lambda: likelihood,
    )
    restored.with_problem = lambda problem: restored
    surrogate.reduce_about(restored, 1e-5, 0)
    assert np.linalg.norm(enriched, axis=1) == pytest.approx(np.full(len(enriched), 6.0))


@pytest.mark.parametrize(("failed", "is_reliable"), [(1, True), (2, False)])
def test_draws_are_reliable_with_up_to_a_twentieth_of_failed_refits(
    monkeypatch, failed, is_reliable
):
    """Of 25 refits."""
    parameters = ParameterSet([Parameter("part", "stiffness", 1.0, 0.1, 10.0)])
    result = SimpleNamespace(first=SimpleNamespace(parameters=parameters, at_bound=()))
    for name, value in {
        "describe_excess": "",
        "model_error_of": None,
        "model_error_remark": "",
        "std_of": np.ones(1),
    }.items():
        monkeypatch.setattr(bootstrap, name, lambda *about, v=value: v)
    draws = bootstrap._make_draws(
        result, np.ones(1), [np.ones(1)] * (25 - failed), Counter(a=failed), np.zeros(1), {"n": 25}
    )
    assert draws.converged == is_reliable
