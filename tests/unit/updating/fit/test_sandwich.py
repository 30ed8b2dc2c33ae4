"""Standard deviations of fits whose weights are not those of the noise: by a second way, and by coverage."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.methods.least_squares import sandwich
from updyn.updating.problem.noise import Robust, Stated, level_by_unit
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError, OutputError, OutputErrorSet


def output_error(problem):
    frf = problem.frf
    return OutputErrorSet(
        (OutputError(np.broadcast_to(1.0 / level_by_unit(frf), frf.values.shape)),)
    )


@pytest.mark.parametrize("name", ["log", "output-error"])
def test_it_is_the_formula(chain12_task, add_noise, name):
    """A^-1 (J^T S J) A^-1 with J written out."""
    start, clean, unknowns, truth = chain12_task
    data = add_noise(clean, np.random.default_rng(0), 0.02, 0.01)
    problem = FRFPart.build(start, data, unknowns)
    x = problem.coordinates.to_x(truth)
    residual = LogError() if name == "log" else output_error(problem)
    noise = Stated(0.02, 0.01)
    found = sandwich(
        Problem.of([problem]), residual, residual.local(Problem.of([problem]), x), x, [noise]
    )
    blocks = list(problem.blocks(x))
    H, dH = np.concatenate([b.H for b in blocks]), np.concatenate([b.dH for b in blocks], axis=1)
    weight = 1.0 / H if name == "log" else 1.0 / level_by_unit(data)
    J, S = weight * dH, np.abs(weight) ** 2 * noise.variance(H, data) / 2.0
    A, B = (np.einsum("kabc,labc,abc->kl", J.conj(), J, s).real for s in (np.ones(H.shape), S))
    half = np.linalg.solve(A, np.linalg.cholesky(B))
    W = np.linalg.solve(found.R.T @ found.R, np.eye(12))
    assert found.noise[0]["inflation"] ** 2 * (half @ half.T) == pytest.approx(
        W, rel=1e-6, abs=1e-9 * abs(W).max()
    )
    assert found.noise[0]["relative"] == 0.02


def test_weights_that_match_give_what_they_gave(chain12_task, add_noise):
    """Output error under noise of one level: the sandwich is the plain inverse."""
    start, clean, unknowns, truth = chain12_task
    data = add_noise(clean, np.random.default_rng(0), 0.0, 0.01)
    problem = FRFPart.build(start, data, unknowns)
    x = problem.coordinates.to_x(truth)
    residual = output_error(problem)
    local = residual.local(Problem.of([problem]), x)
    found = sandwich(Problem.of([problem]), residual, local, x, [Stated(0.0, 0.01)])
    scale = found.noise[0]["inflation"] * 0.01 / np.sqrt(2.0)
    assert scale**2 * found.R.T @ found.R == pytest.approx(local.R.T @ local.R, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("method", "relative", "floor"),
    [
        ("output-error", 0.05, 0.0),
        ("output-error", 0.02, 0.002),
        ("log", 0.05, 0.0),
        ("log", 0.02, 0.001),
    ],
)
def test_intervals_cover(chain12_task, add_noise, method, relative, floor):
    """Intervals of 95 % from the spread of the residual alone hold 37 % of output errors under relative noise."""
    start, clean, unknowns, truth = chain12_task
    options = {"starts": 0} if method == "log" else {}
    off = []
    for seed in range(12):
        data = add_noise(clean, np.random.default_rng(seed), relative, floor)
        result = updyn.update(start, data, unknowns.with_start(truth), method=method, **options)
        off.append(
            (np.array(list(result.values.values())) - truth) / np.array(list(result.std.values()))
        )
    assert np.abs(off).max() < 4.0
    assert 0.9 <= np.mean(np.abs(off) < 1.96) <= 1.0
    assert np.sqrt(np.mean(np.square(off))) > 0.6  # and are not wide for nothing


def test_more_misfit_than_the_noise_widens(chain12_task, add_noise):
    start, clean, unknowns, truth = chain12_task
    data = add_noise(clean, np.random.default_rng(0), 0.04)
    right, wrong = (
        updyn.update(
            start, data, unknowns.with_start(truth), method="log", starts=0, noise={"relative": r}
        )
        for r in (0.04, 0.01)
    )
    assert wrong.noise["chi_square"] == pytest.approx(16.0, rel=0.15)
    assert list(wrong.std.values()) == pytest.approx(list(right.std.values()), rel=0.1)
    robust = updyn.update(
        start,
        data,
        unknowns.with_start(truth),
        method="log",
        starts=0,
        noise={"relative": 0.04, "robust": "student-t"},
    )
    assert robust.std == right.std  # this method takes no weights
    assert Robust.name not in robust.noise.values()


def test_log_says_where_the_noise_is_too_large_for_it(chain12_task, add_noise):
    start, clean, unknowns, truth = chain12_task
    data = add_noise(clean, np.random.default_rng(0), 0.01, 0.01)
    result = updyn.update(start, data, unknowns.with_start(truth), method="log", starts=0)
    assert "noise is above half of |H|" in result.remedy
    quiet = updyn.update(
        start,
        add_noise(clean, np.random.default_rng(0), 0.01),
        unknowns.with_start(truth),
        method="log",
    )
    assert quiet.remedy == ""


def test_open_combinations_stay_open(chain12, chain12_frf, add_noise):
    """Six numbers cannot determine twelve unknowns."""
    few = add_noise(chain12_frf, np.random.default_rng(0), 0.01).select(
        lines=chain12_frf.freq[[3]], responses=["2:X"], references=chain12_frf.references[:3]
    )
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    for method in ("log", "output-error"):
        result = updyn.update(chain12, few, unknowns, method=method)
        assert result.identifiability.rank <= 6
        assert np.isinf(list(result.std.values())).any()


@pytest.mark.parametrize(("relative", "has_note"), [(0.49, False), (0.51, True)])
def test_noise_of_half_the_values_has_a_note(chain12_task, relative, has_note):
    start, data, unknowns, truth = chain12_task
    problem = Problem.of([FRFPart.build(start, data, unknowns)])
    x = problem.parts[0].coordinates.to_x(truth)
    local = LogError().local(problem, x)
    found = sandwich(problem, LogError(), local, x, [Stated(relative, 0.0)])
    assert bool(found.note) == has_note
