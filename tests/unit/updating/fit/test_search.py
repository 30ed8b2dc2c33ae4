"""Seeking the basin: tries within bounds, reproducible, and worth their cost."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.fit.acceptance import Acceptance
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.search import (
    Search,
    _select_distinct,
    _select_some_lines,
    draw_latin_hypercube,
    thin_problem,
)
from updyn.updating.fit.trust_region import Outcome
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import Estimated, Stated, Variance
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import make_log_error
from updyn.updating.problem.settings import SEARCH_DATA


def far_start(chain12):
    """A start from which a single descent ends in another basin: stiffness of one part eight times too low."""
    return chain12.scaled({"part2": {"stiffness": 0.15, "mass": 1.5}, "part3": {"stiffness": 4.0}})


@pytest.fixture
def problem(chain12, chain12_frf):
    start = far_start(chain12)
    unknowns = updyn.parameters(
        start, stiffness="all", mass="all", loss_factor="all", bounds={"loss_factor": (0.0, 0.5)}
    )
    return FRFPart.build(start, chain12_frf.select(references=["12:X"]), unknowns)


def test_points_stay_within_bounds_and_are_reproducible(problem):
    lower, upper = problem.coordinates.bounds
    points = list(Search(starts=9, seed=3)._draw_starts(Problem.of([problem])))
    assert len(points) == 9
    for x in points:
        assert (x >= lower).all()
        assert (x <= upper).all()
    assert np.array_equal(
        points, list(Search(starts=9, seed=3)._draw_starts(Problem.of([problem])))
    )
    assert not np.array_equal(
        points[-1], list(Search(starts=9, seed=4)._draw_starts(Problem.of([problem])))[-1]
    )
    first = problem.coordinates.to_values(points[0])
    factor = problem.coordinates.parameters.is_factor
    assert first[factor] == pytest.approx(
        np.ones(factor.sum())
    )  # the first tries move loss factors only
    assert (first[~factor] > 0.05).all()


def test_fewer_tries_than_inflations(problem):
    assert len(list(Search(starts=1)._draw_starts(Problem.of([problem])))) == 1
    assert len(list(Search(starts=2)._draw_starts(Problem.of([problem])))) == 2


def test_search_that_is_stopped_returns_the_best_so_far(problem):
    monitor = Monitor(Problem.of([problem]), lambda progress: progress.iteration >= 3)
    noises = [Estimated.of_data(problem.frf)]
    searched = thin_problem(Problem.of([problem]), noises)
    (x, *_) = Search().run(searched, noises, monitor).points
    assert monitor.stopped
    assert len(monitor.history) <= 6
    lower, upper = problem.coordinates.bounds
    assert ((x >= lower) & (x <= upper)).all()


def random_gear_train(gear_train, seed):
    """Stiffness off by up to 70 %, mass by up to 30 %, no damping: 60 lines over 2-1000 rad/s, as in the benchmark."""
    rng = np.random.default_rng(seed)
    start = gear_train.scaled({
        name: {"stiffness": 1 + rng.uniform(-0.7, 0.7), "mass": 1 + rng.uniform(-0.3, 0.3), "loss_factor": 0.0}
        for name in gear_train.groups
    })  # fmt: skip
    freq = np.geomspace(2.0, 1000.0, 60) / (2 * np.pi)
    data = updyn.response(gear_train, freq, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    return start, data, updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")


def worst_stiffness(found, gear_train):
    return max(
        np.abs(found.model.group(name).stiffness.data / group.stiffness.data - 1.0).max()
        for name, group in gear_train.groups.items()
    )


@pytest.mark.parametrize("seed", [100, 101, 107, 112])
def test_default_method_recovers_the_gear_train_from_random_starts(gear_train, seed):
    start, data, unknowns = random_gear_train(gear_train, seed)
    found = updyn.update(start, data, unknowns)
    assert found.status == "converged"
    assert worst_stiffness(found, gear_train) < 1e-6
    for name, group in gear_train.groups.items():
        ratio = found.model.group(name).mass.data / group.mass.data
        assert ratio == pytest.approx(np.ones(len(ratio)), abs=1e-6)
        assert found.model.group(name).loss_factor == pytest.approx(group.loss_factor, abs=1e-6)


@pytest.mark.parametrize("seed", [107, 112])
def test_search_finds_what_a_single_descent_misses(gear_train, seed):
    """Both starts lead a single descent into a minimum with a misfit of 0.3 % and stiffness off by 20 to 35 %."""
    start, data, unknowns = random_gear_train(gear_train, seed)
    single = updyn.update(start, data, unknowns, method="log", starts=0)
    assert worst_stiffness(single, gear_train) > 0.1
    assert worst_stiffness(updyn.update(start, data, unknowns, method="log"), gear_train) < 1e-6
    again = updyn.update(start, data, unknowns, method="log")
    assert again.values == updyn.update(start, data, unknowns, method="log").values


# -- the problem that is searched, and the ends of its tries ---------------------------------------
def long_test(chain12, lines, **kwargs):
    unknowns = updyn.parameters(chain12, stiffness="all", loss_factor="all")
    true = chain12.scaled({"part1": {"stiffness": 1.2}})
    data = updyn.response(true, np.linspace(0.5, 20.0, lines), ["2:X", "12:X"], ["12:X"])
    data = updyn.FRF(
        data.freq, data.values, data.responses, data.references, data.quantity, **kwargs
    )
    return FRFPart.build(chain12, data, unknowns)


def test_coarse_problem_carries_the_noise_of_the_lines_that_it_keeps(chain12):
    variance = np.random.default_rng(0).uniform(1.0, 2.0, (900, 2, 1)) * 1e-12
    parts = (long_test(chain12, 900, variance=variance), long_test(chain12, 300))
    rough = thin_problem(Problem(parts), [Variance(), Stated(0.0, 0.01)])
    first, second = rough.parts
    assert len(first.frf.freq) == 300  # every third
    assert (first.frf.freq == parts[0].frf.freq[::3]).all()
    assert first.frf.variance == pytest.approx(variance[::3])
    rms = np.sqrt(np.mean(np.abs(parts[1].frf.values) ** 2))
    assert second.frf.variance == pytest.approx(np.full((300, 2, 1), (0.01 * rms) ** 2))
    assert (second.frf.values == parts[1].frf.values).all()
    weights = [error.weight for error in make_log_error(rough).errors]
    size = np.abs(second.frf.values)
    own = np.maximum(size**2 - SEARCH_DATA.subtracted_variances * (0.01 * rms) ** 2, 0.0)
    assert weights[1] == pytest.approx(np.sqrt(own / (own + (0.1 * rms) ** 2)), rel=1e-9)


def test_log_error_that_noise_leaves_is_that_of_simulated_noise(chain12, add_noise):
    """At the truth, where most values are above the noise.

    Of a value far below it the measured level is that of the noise; how far below, data cannot say.
    """
    clean = long_test(chain12, 400)
    truth = clean.coordinates.to_x(clean.coordinates.parameters.start)
    truth[clean.coordinates.parameters.names.index("part1.stiffness")] = np.log(1.2)
    for relative, floor in ((0.02, 0.0), (0.0, 0.002), (0.0, 0.02)):
        data = add_noise(clean.frf, np.random.default_rng(0), relative, floor)
        part = FRFPart.build(chain12, data, clean.coordinates.parameters)
        rough = thin_problem(Problem.of([part]), [Stated(relative, floor)])
        cost = make_log_error(rough).local(rough, truth).cost
        assert cost == pytest.approx(Acceptance(rough).expected_cost(), rel=0.3)


def test_log_error_that_noise_leaves_of_no_motion_is_none(chain12):
    """Accelerance in mm/s^2: zero at 0 Hz, with a variance far above 1 there."""
    unknowns = updyn.parameters(chain12, stiffness="all")
    freq = np.linspace(0.0, 20.0, 50)
    data = updyn.response(chain12, freq, ["2:X"], ["12:X"], "accelerance")
    data = replace(data, values=1e6 * data.values)
    part = FRFPart.build(chain12, data, unknowns)
    rough = thin_problem(Problem.of([part]), [Stated(0.0, 0.1)])
    assert rough.parts[0].frf.variance[0, 0, 0] > 1e4
    without = thin_problem(
        Problem.of([FRFPart.build(chain12, data.select(lines=freq[1:]), unknowns)]),
        [Stated(0.0, 0.1)],
    )
    assert Acceptance(rough).expected_cost() == pytest.approx(
        Acceptance(without).expected_cost(), rel=0.1
    )


def test_noise_of_the_search_is_that_of_all_lines(chain12, add_noise):
    """A floor of 1 % is seen where lines are dense, before three of four are left out."""
    part = long_test(chain12, 1600)
    data = add_noise(part.frf, np.random.default_rng(0), 0.0, 0.01)
    part = FRFPart.build(chain12, data, part.coordinates.parameters)
    rough = thin_problem(Problem.of([part]), [Estimated.of_data(data)])
    level = np.sqrt(np.mean(np.abs(data.values) ** 2))
    assert np.sqrt(rough.parts[0].frf.variance) == pytest.approx(
        np.full((400, 2, 1), 0.01 * level), rel=0.2
    )


def end(cost, x):
    """An end in whose basin the cost grows by half the square of the distance."""
    x = np.asarray(x, dtype=float)
    return Outcome(x, Local(cost, np.eye(len(x)), np.zeros(len(x))), "converged")


def test_ends_are_told_apart_and_the_hopeless_left_out():
    ends = [
        end(9.0, [5.0, 0.0]),  # more than 1.5 times the best
        end(1.2, [3.0, 0.0]),
        end(1.0, [0.0, 0.0]),
        end(1.0 + 1e-6, [1e-4, 0.0]),  # the best once more
        end(1.4, [0.0, 2.0]),
    ]
    found = [tuple(one.x) for one in _select_distinct(ends)]
    assert found == [(0.0, 0.0), (3.0, 0.0), (0.0, 2.0)]
    assert _select_distinct([]) == []


def test_no_more_than_four_ends_are_kept():
    ends = [end(1.0 + 0.01 * i, [float(i), 0.0]) for i in (5, 3, 0, 4, 1, 2)]
    assert [one.x[0] for one in _select_distinct(ends)] == [0.0, 1.0, 2.0, 3.0]


def test_ends_of_exact_data_are_one():
    """Costs of rounding: a point that fits 1e6 times worse is another basin's, however small."""
    ends = [end(1e-26, [0.0, 0.0]), end(1e-20, [1.0, 0.0])]
    assert [tuple(one.x) for one in _select_distinct(ends)] == [(0.0, 0.0)]


def test_what_few_lines_agree_on_is_tried_on_all_where_it_leaves_more_than_noise(
    chain12, monkeypatch
):
    """A beam with light boxes: three tries agreed on few lines, with 29 times the noise left."""
    data = updyn.response(chain12, np.linspace(0.5, 20.0, 200), ["2:X", "12:X"], ["12:X"])
    part = FRFPart.build(chain12, data, updyn.parameters(chain12, stiffness="all"))
    rough = thin_problem(Problem.of([part]), [Stated(0.01, 0.0)])
    elsewhere, answer = rough.coordinates.start, rough.coordinates.start + 0.1
    seen = []

    def made(self, problem, thinned, starts, acceptance, monitor, ends):
        seen.append(thinned is problem)
        ends.append(end(2.0, elsewhere) if thinned is not problem else end(1.0, answer))
        return True

    monkeypatch.setattr(Search, "_run_tries", made)
    monkeypatch.setattr(Acceptance, "is_exact", lambda self, end: False)
    for enough, tries, expected in ((1.5, [False, True], answer), (3.0, [False], elsewhere)):
        seen.clear()
        monkeypatch.setattr(
            Acceptance, "is_plausible", lambda self, end, e=enough: end.local.cost < e
        )
        found = Search().run(rough, [Stated(0.01, 0.0)], Monitor(rough))
        assert seen == tries
        assert np.array_equal(found.points[0], np.clip(expected, *rough.coordinates.bounds))


def test_each_round_goes_on_from_its_own_best_end(chain12, monkeypatch):
    """Planetary gear: all tries beside the best end came back to it, from the best of a later round
    the fifth one reached the answer."""
    data = updyn.response(chain12, np.linspace(0.5, 20.0, 60), ["2:X", "12:X"], ["12:X"])
    part = FRFPart.build(chain12, data, updyn.parameters(chain12, stiffness="all"))
    rough = thin_problem(Problem.of([part]), [Stated(0.01, 0.0)])
    home = rough.coordinates.start
    best, other, answer = home, home + 0.1, home + 0.2
    rounds, begun = [], []

    def made(self, problem, thinned, starts, acceptance, monitor, ends):
        ends.append(rounds.pop(0))
        return False

    def try_nearby(self, problem, thinned, x, number, monitor):
        begun.append(x)
        return end(1.0, answer) if x is other else end(3.0, best)

    monkeypatch.setattr(Search, "_run_tries", made)
    monkeypatch.setattr(Search, "_try_nearby", try_nearby)
    monkeypatch.setattr(Acceptance, "is_plausible", lambda self, end: end.local.cost < 2.0)
    monkeypatch.setattr(Acceptance, "is_exact", lambda self, end: False)
    rounds += [end(3.0, best), end(3.0, best), end(4.0, other)]
    found = Search(starts=2).run(rough, [Stated(0.01, 0.0)], Monitor(rough))
    assert np.array_equal(found.points[0], answer)
    assert sum(x is best for x in begun) == 4  # beside what is known no further tries are made
    assert sum(x is other for x in begun) == 1


def test_end_points_are_distinct_and_within_bounds(problem):
    whole = Problem.of([problem])
    noises = [Stated(0.01, 0.0)]
    rough = thin_problem(whole, noises)
    found = Search(starts=4).run(rough, noises, Monitor(rough)).points
    lower, upper = whole.coordinates.bounds
    for x in found:
        assert ((x >= lower) & (x <= upper)).all()
    assert 1 <= len(found) <= 4
    for i in range(len(found)):
        for j in range(i):
            assert np.abs(found[i] - found[j]).max() > 1e-6


@pytest.mark.parametrize("number", range(4))
def test_tries_beside_a_point_stay_within_bounds(problem, number):
    """The point stands on the bound of two unknowns; steps are recorded, and tries differ."""
    rough = thin_problem(Problem.of([problem]), [Stated(0.01, 0.0)])
    lower, upper = rough.coordinates.bounds
    x = rough.coordinates.to_x(rough.coordinates.parameters.start)
    loss = np.flatnonzero(~rough.coordinates.parameters.is_factor)
    x[loss[0]], x[loss[1]] = lower[loss[0]], upper[loss[1]]
    monitor = Monitor(rough)
    found = Search(max_iterations=3).try_nearby(rough, x, number, monitor)
    assert ((found >= lower) & (found <= upper)).all()
    assert len(monitor.history) > 0
    again = Search(max_iterations=3).try_nearby(rough, x, number, Monitor(rough))
    other = Search(max_iterations=3).try_nearby(rough, x, number + 1, Monitor(rough))
    assert np.array_equal(found, again)
    assert not np.array_equal(found, other)


def test_half_bands_that_tries_begin_on_lie_apart(problem):
    """Draws at random had the upper half twice before any lower one; the middle comes first."""
    rough = thin_problem(Problem.of([problem]), [Stated(0.01, 0.0)])
    freq = rough.parts[0].frf.freq
    assert len(freq) == 60
    for turn, begin in enumerate((15, 8, 22)):
        half = _select_some_lines(rough, 2 * turn, 0).parts[0].frf.freq
        assert np.array_equal(half, freq[begin : begin + 30])


def test_tries_beside_the_truth_come_back_to_it(chain12_task):
    start, data, unknowns, truth = chain12_task
    rough = thin_problem(Problem.of([FRFPart.build(start, data, unknowns)]), [Stated(0.01, 0.0)])
    x = rough.coordinates.to_x(truth)
    for number in range(2):
        found = Search().try_nearby(rough, x, number, Monitor(rough))
        assert found == pytest.approx(x, abs=1e-6)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_all_resonances_off_by_many_times_their_width(chain12, factor):
    """All springs off by a factor of two: a descent from the start ends elsewhere, the search does not."""
    start = chain12.scaled({f"part{i}": {"stiffness": factor} for i in range(1, 5)})
    unknowns = updyn.parameters(start, stiffness="all")
    data = updyn.response(chain12, np.linspace(0.5, 20.0, 200), ["2:X", "12:X"], ["12:X"])
    noises = [Stated(0.001, 0.0)]
    rough = thin_problem(Problem.of([FRFPart.build(start, data, unknowns)]), noises)
    alone = Search()._try_from(rough, rough, np.zeros(4), Monitor(rough))
    assert alone.local.cost > 10.0
    found = Search().run(rough, noises, Monitor(rough)).points[0]
    assert found == pytest.approx(np.full(4, -np.log(factor)), abs=1e-6)


@pytest.mark.parametrize("method", ["maximum-likelihood", "log"])
def test_without_a_step_the_start_is_returned(chain12_task, method):
    """Tries of a search would end where they begin: points that were scattered, loss factors that were inflated."""
    start, frf, unknowns, _ = chain12_task
    found = updyn.update(start, frf, unknowns, method, max_iterations=0)
    assert found.status == "max-iterations"
    assert list(found.values.values()) == pytest.approx(list(unknowns.start), rel=1e-12)
    assert found.options["starts"] == 0


@pytest.mark.parametrize(("number", "n", "seed"), [(1, 1, 0), (7, 3, 5), (40, 12, 11)])
def test_a_latin_hypercube_is_that_of_scipy(number, n, seed):
    from scipy.stats import qmc

    expected = qmc.LatinHypercube(d=n, rng=seed).random(number)
    assert np.array_equal(draw_latin_hypercube(number, n, seed), expected)
