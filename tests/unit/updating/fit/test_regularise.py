"""Regularised fits: linear problems against closed forms, chains against their truth, and what is said of them."""

import importlib.util
import sys
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from places import ROOT
from updyn.errors import OptionError
from updyn.store.result import result_to_json
from updyn.updating.fit import regularisation
from updyn.updating.fit.method import Fit, descend
from updyn.updating.fit.methods import methods_with
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.regularisation import (
    CHOICES,
    Regularised,
    SingularSpectrum,
    check_regularise,
    corner,
    discrepancy,
    minimum,
)
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import reduce_blocks
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError

FREE = np.full(6, -np.inf), np.full(6, np.inf)


# -- a linear problem through the whole machinery ----------------------------------------------------------
@dataclass(frozen=True)
class Linear:
    """|A x - b| as a residual and as a method."""

    A: np.ndarray
    b: np.ndarray
    max_iterations: int = 60
    tolerance: float = 1e-12
    name = "linear"

    def local(self, problem, x):
        return reduce_blocks([np.column_stack([self.A, self.A @ x - self.b])], self.A.shape[1])

    def search(self, problem, monitor):
        return problem.coordinates.to_x(problem.coordinates.parameters.start)

    def fit(self, problem, noises, monitor, x):
        with monitor.stage("linear"):
            outcome = descend(
                problem,
                self,
                x,
                monitor,
                TrustRegion(self.max_iterations, self.tolerance),
                relax=False,
            )
        local = self.local(problem, outcome.x)
        return Fit(outcome.x, outcome.reason, local.R, local=local)


@pytest.fixture(scope="module")
def chain6():
    groups = {}
    for i in range(6):
        K, M = np.zeros((6, 6)), np.zeros((6, 6))
        K[i, i], M[i, i] = 1e5, 1.0
        if i:
            K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 1e5, -1e5, -1e5
        groups[f"s{i + 1}"] = updyn.Group(K, M, 0.02)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(6)])


@pytest.fixture
def problem(chain6):
    """Six factors, 20 values: 40 real residuals, of a linear problem that takes the place of its own."""
    data = updyn.response(chain6, np.linspace(5.0, 60.0, 20), ["6:X"], ["6:X"])
    unknowns = updyn.parameters(chain6, stiffness="all", bounds={"stiffness": (1e-9, 1e9)})
    return Problem.of([FRFPart.build(chain6, data, unknowns)])


@pytest.fixture
def linear():
    """40 by 6, its singular values from 300 to 0.3, noise 1, a solution of length about 1."""
    rng = np.random.default_rng(4)
    U, V = (
        np.linalg.qr(rng.standard_normal((40, 6)))[0],
        np.linalg.qr(rng.standard_normal((6, 6)))[0],
    )
    A = (U * np.geomspace(300.0, 0.3, 6)) @ V.T
    return Linear(A, A @ (0.5 * rng.standard_normal(6)) + rng.standard_normal(40))


def fitted(problem, linear, how):
    return Regularised(linear, how, 60, 1e-12).fit(
        problem, [Stated(0.01, 0.0)], Monitor(problem), np.zeros(6)
    )


@pytest.mark.parametrize("strength", [0.5, 3.0, 30.0])
def test_a_stated_strength_is_tikhonov(problem, linear, strength):
    fit = fitted(problem, linear, strength)
    expected = np.linalg.solve(
        linear.A.T @ linear.A + strength**2 * np.eye(6), linear.A.T @ linear.b
    )
    assert fit.x == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert fit.regularisation.record["prior_std"] == pytest.approx(1.0 / strength)


@pytest.mark.parametrize(
    ("how", "choose"), [("gcv", minimum), ("l-curve", corner), ("discrepancy", discrepancy)]
)
def test_the_choice_on_a_linear_problem_is_that_of_its_spectrum(problem, linear, how, choose):
    fit = fitted(problem, linear, how)
    strength = choose(SingularSpectrum.of(linear.A, linear.b), 1.0, 300.0)
    assert fit.regularisation.record["strength"] == pytest.approx(strength, rel=0.05)
    found = fit.regularisation.record["strength"]
    expected = np.linalg.solve(linear.A.T @ linear.A + found**2 * np.eye(6), linear.A.T @ linear.b)
    assert fit.x == pytest.approx(expected, rel=1e-8, abs=1e-11)
    assert fit.regularisation.record["misfit here"] == pytest.approx(
        np.linalg.norm(linear.A @ fit.x - linear.b), rel=1e-9
    )
    assert fit.regularisation.record["distance here"] == pytest.approx(
        np.linalg.norm(fit.x), rel=1e-8
    )
    assert (np.diff(fit.regularisation.record["misfit"]) >= 0).all()
    assert (np.diff(fit.regularisation.record["distance"]) <= 0).all()


@pytest.mark.parametrize("number", [1, 3, 6])
def test_truncated_singular_values_are_the_pseudo_inverse(problem, linear, number):
    fit = fitted(problem, linear, f"tsvd:{number}")
    U, s, Vt = np.linalg.svd(linear.A, full_matrices=False)
    expected = np.linalg.pinv((U[:, :number] * s[:number]) @ Vt[:number], rcond=1e-10) @ linear.b
    assert np.abs(fit.x - expected).max() < 1e-10
    assert fit.regularisation.record["kept"] == number


def test_tsvd_chooses_its_number_by_gcv(problem, linear):
    fit = fitted(problem, linear, "tsvd")
    U, s, Vt = np.linalg.svd(linear.A, full_matrices=False)
    beta = U.T @ linear.b
    misfit = [linear.b @ linear.b - np.sum(beta[:k] ** 2) for k in range(7)]
    gcv = [misfit[k] / (40 - k) ** 2 for k in range(7)]
    number = int(np.argmin(gcv))
    assert fit.regularisation.record["kept"] == number
    assert fit.x == pytest.approx(Vt[:number].T @ (beta[:number] / s[:number]), abs=1e-10)


def test_where_nothing_is_determined_tsvd_stays_at_the_start(problem):
    rng = np.random.default_rng(1)
    fit = fitted(
        problem, Linear(1e-3 * rng.standard_normal((40, 6)), rng.standard_normal(40)), "tsvd"
    )
    assert fit.regularisation.record["kept"] == 0
    assert (fit.x == 0.0).all()
    assert fit.regularisation.within.shape == (6, 0)
    assert "had not converged" not in fit.regularisation.note


def test_unknowns_with_a_prior_keep_theirs_and_adapt(chain6, linear):
    """Against the whole problem solved with both kinds of prior."""
    data = updyn.response(chain6, np.linspace(5.0, 60.0, 20), ["6:X"], ["6:X"])
    unknowns = updyn.parameters(
        chain6,
        stiffness="all",
        bounds={"stiffness": (1e-9, 1e9)},
        prior_std={"s2.*": 0.1, "s5.*": 0.4},
    )
    problem = Problem.of([FRFPart.build(chain6, data, unknowns)])
    own = np.array([0.0, 10.0, 0.0, 0.0, 2.5, 0.0])
    fit = fitted(problem, linear, 3.0)
    weight = np.where(own > 0, own, 3.0)
    expected = np.linalg.solve(linear.A.T @ linear.A + np.diag(weight**2), linear.A.T @ linear.b)
    assert fit.x == pytest.approx(expected, rel=1e-8)
    assert fit.regularisation.weight.tolist() == [3.0, 0.0, 3.0, 3.0, 0.0, 3.0]

    def gcv(strength):
        weight = np.where(own > 0, own, strength)
        z = np.linalg.solve(linear.A.T @ linear.A + np.diag(weight**2), linear.A.T @ linear.b)
        cost = np.sum((linear.A @ z - linear.b) ** 2) + np.sum((own * z) ** 2)
        B = np.vstack([linear.A, np.diag(own)])[:, [0, 2, 3, 5]]
        P = np.vstack([linear.A, np.diag(own)])[:, [1, 4]]
        B = B - P @ np.linalg.lstsq(P, B)[0]
        trace = np.trace(B @ np.linalg.solve(B.T @ B + strength**2 * np.eye(4), B.T))
        return cost / (40 - trace - 2) ** 2

    found = fitted(problem, linear, "gcv").regularisation.record["strength"]
    assert gcv(found) <= 1.001 * min(gcv(s) for s in np.geomspace(1.0, 300.0, 200))
    fit = fitted(problem, linear, "tsvd:2")
    assert fit.regularisation.within.shape == (6, 4)


def test_steps_in_a_subspace_stay_there_and_within_the_bounds():
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((9, 6)), 3.0 * rng.standard_normal(9)
    within = np.linalg.qr(rng.standard_normal((6, 3)))[0]

    def evaluate(x):
        return reduce_blocks([np.column_stack([A, A @ x - b])], 6)

    outcome = TrustRegion(radius=100.0).minimise(evaluate, np.zeros(6), *FREE, within=within)
    a = np.linalg.lstsq(A @ within, b)[0]
    assert outcome.x == pytest.approx(within @ a, abs=1e-10)
    narrow = 0.5 * np.abs(outcome.x).max()
    held = TrustRegion().minimise(
        evaluate, np.zeros(6), np.full(6, -narrow), np.full(6, narrow), within=within
    )
    assert np.abs(held.x).max() <= narrow * (1 + 1e-12)
    assert held.x == pytest.approx(within @ (within.T @ held.x), abs=1e-9)
    # Of the points of the subspace within the bounds none is better: an independent solver agrees.
    from scipy.optimize import minimize

    box = [
        {"type": "ineq", "fun": lambda a, i=i, s=s: narrow - s * (within @ a)[i]}
        for i in range(6)
        for s in (1, -1)
    ]
    best = minimize(
        lambda a: 0.5 * np.sum((A @ within @ a - b) ** 2),
        np.zeros(3),
        constraints=box,
        method="SLSQP",
    )
    assert held.local.cost == pytest.approx(best.fun, rel=1e-6)


# -- chains ------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def study():
    path = ROOT / "benchmarks" / "regularisation.py"
    spec = importlib.util.spec_from_file_location("regularisation_study", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("choose", [minimum, corner, discrepancy])
@pytest.mark.parametrize("setting", ["ILL", "WELL"])
def test_the_choice_gains_where_the_data_say_little_and_loses_nothing_where_they_say_much(
    study, setting, choose
):
    """50 draws of truth and noise on the derivatives of the chains of benchmarks/regularisation.py, at their start."""
    setting = getattr(study, setting)
    model = setting.model()
    frf = updyn.response(
        model, np.linspace(*setting.band), list(setting.sensors), [f"{setting.n}:X"]
    )
    problem = FRFPart.build(model, frf, updyn.parameters(model, stiffness="all"))
    H = np.abs(frf.values)
    R = (
        OutputError(np.sqrt(2.0) / (setting.noise * H))
        .local(Problem.of([problem]), np.zeros(setting.n))
        .R
    )
    rng, m, errors = np.random.default_rng(1), 2 * frf.values.size, []
    for _ in range(50):
        truth = setting.spread * rng.standard_normal(setting.n)
        rest = rng.chisquare(m - setting.n)
        spectrum = SingularSpectrum.of(R, R @ truth + rng.standard_normal(setting.n), rest, m)
        strength = choose(spectrum, 1.0, max(10.0, float(spectrum.s[0])))
        plain, held = (
            spectrum.solution(spectrum.tikhonov_filter(g)) - truth for g in (0.0, strength)
        )
        errors.append((np.mean(plain**2), np.mean(held**2)))
    plain, held = np.sqrt(np.mean(errors, axis=0))
    assert held < (0.5 * plain if setting is study.ILL else 1.05 * plain)


@pytest.mark.parametrize("choice", ["gcv", "l-curve", "discrepancy"])
def test_fits_of_a_badly_determined_chain_gain(study, choice):
    few = study.Setting("", 4, ("4:X",), 0.05, 0.2, (8.0, 40.0, 16))
    plain, held = (np.sqrt(np.mean(study.errors(few, c, 3)[0] ** 2)) for c in (None, choice))
    assert held < plain


@pytest.fixture(scope="module")
def badly(study):
    setting = study.Setting("", 5, ("5:X",), 0.05, 0.1, (6.0, 60.0, 24))
    model = setting.model()
    return model, setting.draw(model, 3)[0], updyn.parameters(model, stiffness="all")


@pytest.fixture(scope="module")
def pulled(badly):
    return updyn.update(*badly, regularise="gcv", starts=0)


def test_the_result_says_how_it_was_regularised(pulled, tmp_path):
    record = pulled.options["regularisation"]
    assert pulled.options["regularise"] == record["how"] == "gcv"
    assert f"priors of standard deviation {record['prior_std']:.3g}. " in pulled.message
    assert "but not the bias" in pulled.message
    assert len(record["strengths"]) == len(record["misfit"]) == len(record["distance"]) == 41
    assert result_to_json(pulled)["options"]["regularisation"]["strength"] == record["strength"]
    updyn.write_result(pulled, tmp_path / "run.nc")
    assert updyn.read_result(tmp_path / "run.nc").options["regularisation"] == record


def test_standard_deviations_count_the_pull_as_a_prior(badly, pulled):
    """As those of a fit whose unknowns have that prior from the beginning."""
    model, frf, unknowns = badly
    record = pulled.options["regularisation"]
    noise = {k: pulled.noise[k] for k in ("relative", "floor")}
    prior = record["prior_std"] / pulled.noise["inflation"]
    with_prior = updyn.parameters(model, stiffness="all", prior_std={"stiffness": prior})
    again = updyn.update(model, frf, with_prior, starts=0, noise=noise)
    assert again.noise["inflation"] == pytest.approx(pulled.noise["inflation"], rel=1e-3)
    for name in unknowns.names:
        assert pulled.values[name] == pytest.approx(again.values[name], rel=2e-3)
        assert pulled.std[name] < record["prior_std"] * pulled.values[name]


def test_the_curve_of_the_record_is_that_of_fits_at_its_strengths(badly, pulled):
    """The linearised curve where the fit ended, against a fit at a neighbouring strength."""
    record = pulled.options["regularisation"]
    at = int(np.argmin(np.abs(np.log(np.array(record["strengths"]) / record["strength"]))))
    near = updyn.update(
        *badly, regularise=record["strengths"][at], starts=0, noise={"relative": 0.05}
    )
    again = near.options["regularisation"]
    assert again["distance here"] == pytest.approx(record["distance"][at], rel=0.1)


def test_tsvd_of_a_chain_keeps_to_its_directions(badly):
    result = updyn.update(*badly, regularise="tsvd:2", starts=0)
    assert result.options["regularisation"]["kept"] == 2
    assert "2 of 5 directions are fitted" in result.message
    assert np.linalg.matrix_rank(result.covariance, rtol=1e-8) == 2


def test_every_method_of_the_list_can_be_regularised(chain6):
    data = updyn.response(
        chain6.scaled({"s3": {"stiffness": 1.01}}),
        np.linspace(5.0, 60.0, 20),
        ["2:X", "6:X"],
        ["6:X"],
    )
    unknowns = updyn.parameters(chain6, stiffness="all")
    for method in methods_with("can_regularise"):
        for how in ("gcv", "tsvd"):
            options = {"starts": 0} if method in ("maximum-likelihood", "log") else {}
            result = updyn.update(chain6, data, unknowns, method=method, regularise=how, **options)
            assert result.options["regularisation"]["how"] == how, method
            assert result.values["s3.stiffness"] == pytest.approx(1.01, rel=1e-4), (method, how)


def test_a_run_that_was_stopped_goes_on_to_the_same_answer(badly, pulled, tmp_path):
    calls = []
    checkpoint = tmp_path / "run.journal"

    def stop(progress):
        calls.append(progress)
        return len(calls) > 3

    first = updyn.update(*badly, regularise="gcv", starts=0, checkpoint=checkpoint, callback=stop)
    assert first.status == "stopped"
    again = updyn.update(*badly, regularise="gcv", starts=0, checkpoint=checkpoint, resume=True)
    assert again.values == pulled.values
    with pytest.raises(OptionError, match="regularise"):
        updyn.update(*badly, regularise="l-curve", starts=0, checkpoint=checkpoint, resume=True)


def test_several_tests_and_the_reduced_tier(chain6):
    true = chain6.scaled({"s2": {"stiffness": 1.15}})
    tests = [
        updyn.Test(chain6, updyn.response(true, np.linspace(5.0, 60.0, 15), [at], ["6:X"]), at[0])
        for at in ("2:X", "6:X")
    ]
    unknowns = updyn.parameters(chain6, stiffness="all")
    joint = updyn.update_jointly(tests, unknowns, regularise="gcv", starts=0)
    assert joint.values["s2.stiffness"] == pytest.approx(1.15, rel=1e-4)
    assert all("regularisation" in r.options for r in joint.results.values())
    with pytest.raises(OptionError, match="use tier 'sparse', or 'gcv'"):
        updyn.update(chain6, tests[0].frf, unknowns, regularise="tsvd", tier="reduced")
    reduced = updyn.update(
        chain6, tests[0].frf, unknowns, regularise="gcv", starts=0, tier="reduced"
    )
    assert reduced.values["s2.stiffness"] == pytest.approx(1.15, rel=1e-2)


# -- refusals ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "given", ["gvc", "tsvd:0", "tsvd:x", "", 0.0, -1.0, True, float("inf"), float("nan")]
)
def test_what_cannot_be_is_refused(given):
    with pytest.raises(OptionError, match="regularise"):
        check_regularise(given, "log")


def test_nearest_choices_are_named():
    with pytest.raises(OptionError, match="did you mean 'gcv'"):
        check_regularise("gvc", "log")
    with pytest.raises(
        OptionError, match="method 'modal' cannot be regularised; use one of maximum-likelihood"
    ):
        check_regularise("gcv", "modal")
    for choice in (None, *CHOICES, "tsvd:7", 3, 0.2):
        check_regularise(choice, "maximum-likelihood")


def test_more_directions_than_unknowns_and_nothing_to_regularise(badly):
    model, frf, unknowns = badly
    with pytest.raises(OptionError, match="expected at most 5 directions"):
        updyn.update(model, frf, unknowns, regularise="tsvd:6", starts=0)
    held = updyn.parameters(model, stiffness="all", prior_std={"stiffness": 0.1})
    with pytest.raises(OptionError, match="every unknown has a prior already"):
        updyn.update(model, frf, held, regularise="gcv", starts=0)


def test_what_cannot_be_regularised_is_refused_before_the_search(chain12, chain12_frf):
    def never(step):
        assert step.stage != "search"

    unknowns = updyn.parameters(chain12, stiffness="all")
    with pytest.raises(OptionError, match="expected at most 4 directions"):
        updyn.update(chain12, chain12_frf, unknowns, regularise="tsvd:9", callback=never)


# -- thresholds ------------------------------------------------------------------------------------
def test_strengths_range_from_one_to_the_largest_singular_value():
    """By a factor of ten at least."""
    for largest, high in ((100.0, 100.0), (5.0, 10.0)):
        assert regularisation._strength_range(SimpleNamespace(s=[largest])) == (1.0, high)


@pytest.mark.parametrize(("cosine", "is_same"), [(0.99991, True), (0.99989, False)])
def test_directions_span_the_same_space_within_an_angle(cosine, is_same):
    before, now = np.array([[1.0], [0.0]]), np.array([[cosine], [np.sqrt(1.0 - cosine**2)]])
    assert regularisation._span_same_space(before, now) == is_same


@pytest.mark.parametrize(("change", "number"), [(0.049, 1), (0.051, 2)])
def test_a_strength_has_settled_within_five_percent(monkeypatch, change, number):
    """The criterion wants the same strength in every round."""
    run = regularisation._RegularisedFits(None, None, None, np.ones(1, dtype=bool))
    fit = Fit(np.zeros(1), "converged", np.eye(1), ())
    for name, value in {
        "_fit_with_prior": fit,
        "_fix_noise": (),
        "_set_unit": run,
        "_spectrum": SimpleNamespace(s=[100.0]),
    }.items():
        monkeypatch.setattr(type(run), name, lambda self, *about, v=value: v)
    monkeypatch.setattr(type(run), "_tikhonov", lambda self, *about: about)
    monkeypatch.setattr(regularisation, "_has_failed", lambda fit: False)
    monkeypatch.setattr(regularisation, "_inflation", lambda fit: 1.0)
    monkeypatch.setitem(regularisation._STRENGTHS, "gcv", lambda *about: float(np.exp(change)))
    *_, tried, settled = run.fit_chosen_strength((), np.zeros(1), "gcv")
    assert settled
    assert len(tried) == number
