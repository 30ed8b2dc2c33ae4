"""Choice of lines: lists, D-optimal against random choices, refusals."""

import itertools

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, OptionError
from updyn.updating.problem import lines, optimal_design
from updyn.updating.problem.lines import choose_lines, select_a_optimal, select_d_optimal
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.optimal_design import DOptimal, exchange_items
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError
from updyn.updating.problem.settings import LINE_DESIGN


@pytest.fixture
def problem(chain12, chain12_frf):
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    return FRFPart.build(chain12, chain12_frf.select(references=["12:X"]), unknowns)


def log_determinant(model, problem, at):
    """Of the Fisher information at the start, for 1 % relative noise with a floor of 1e-4 of the rms."""
    data = problem.frf.select(lines=problem.frf.freq[at])
    chosen = FRFPart.build(model, data, problem.coordinates.parameters)
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    H = chosen.responses(x)
    floor = 1e-4 * np.sqrt(np.mean(np.abs(problem.frf.values) ** 2))
    R = (
        OutputError(np.sqrt(2.0) / np.hypot(0.01 * np.abs(H), floor))
        .local(Problem.of([chosen]), x)
        .R
    )
    return np.linalg.slogdet(R.T @ R)[1]


def test_all_lines_or_a_list(problem):
    freq = problem.frf.freq
    assert list(choose_lines(None, problem)) == list(range(60))
    assert list(choose_lines(freq[[3, 40, 8]], problem)) == [3, 8, 40]
    with pytest.raises(DataError, match="5 Hz"):
        choose_lines([freq[0], 5.0], problem)


@pytest.mark.parametrize(
    "text",
    [
        "d-optimal",
        "d-optimal:",
        "d-optimal:4.5",
        "d-optimal:-3",
        "doptimal:5",
        "all",
        "",
        "d-optimal:4:part1.*",
        "b-optimal:4",
    ],
)
def test_text_that_is_not_understood(problem, text):
    with pytest.raises(
        OptionError, match="expected 'd-optimal:N' or 'a-optimal:N' with a whole number N"
    ):
        choose_lines(text, problem)


@pytest.mark.parametrize("text", ["d-optimal:0", "d-optimal:61", "a-optimal:61"])
def test_more_lines_than_there_are(problem, text):
    with pytest.raises(OptionError, match="the data have 60 lines to choose from"):
        choose_lines(text, problem)


@pytest.mark.parametrize("count", [4, 10, 25])
def test_d_optimal_beats_random_and_even_choices(chain12, problem, count):
    chosen = select_d_optimal(problem, count)
    assert len(set(chosen)) == count
    assert (np.diff(chosen) > 0).all()
    best, rng = log_determinant(chain12, problem, chosen), np.random.default_rng(0)
    others = [
        log_determinant(chain12, problem, np.sort(rng.choice(60, count, replace=False)))
        for _ in range(60)
    ]
    assert best > max(others)
    assert best > log_determinant(chain12, problem, np.round(np.linspace(0, 59, count)).astype(int))


def test_d_optimal_of_all_lines_is_all_lines(problem):
    assert list(select_d_optimal(problem, 60)) == list(range(60))


def test_d_optimal_of_a_single_oscillator_takes_the_half_power_flanks():
    """Loss factor and stiffness of one resonance: steepest at the peak and its flanks, not out in the band."""
    model = updyn.Model.from_groups(
        {"o": updyn.Group([[(2 * np.pi * 10) ** 2]], [[1.0]], 0.04)}, ["1:X"]
    )
    data = updyn.response(model, np.linspace(5, 15, 201), ["1:X"], ["1:X"])
    problem = FRFPart.build(
        model, data, updyn.parameters(model, stiffness="all", loss_factor="all")
    )
    freq = data.freq[select_d_optimal(problem, 6)]
    assert (np.abs(freq - 10.0) < 10 * 0.04).all()


def test_d_optimal_does_not_depend_on_units(mixed_model):
    """In metres, and in a unit a thousand times smaller or larger."""
    chosen = []
    for scale in (1.0, 1e-3, 1e3):
        model = mixed_model(scale)
        data = updyn.response(model, np.linspace(2, 60, 80), ["1:Y", "2:RZ", "3:Y"], ["1:Y"])
        problem = FRFPart.build(
            model, data, updyn.parameters(model, stiffness="all", loss_factor="all")
        )
        chosen.append(list(select_d_optimal(problem, 10)))
    assert chosen[0] == chosen[1] == chosen[2]


def covariance(problem, at):
    """Of the unknowns at their start, by the very information that the choice is made from."""
    x, floor = lines._design_point(problem), LINE_DESIGN.noise_floor * level_by_unit(problem.frf)
    information = lines._information(problem, (x, floor, slice(0, len(problem.frf.freq))))
    return np.linalg.pinv(information[at].sum(axis=0), hermitian=True, rcond=1e-14)


def test_the_exchange_reaches_the_best_of_all_sets():
    """Two unknowns, five lines: greedy takes the line along the diagonal first; the best pair is the two axes."""
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [0.8, 0.8], [0.5, 0.1], [0.2, 0.6]])
    information = np.einsum("fp,fq->fpq", directions, directions)
    scaled = optimal_design.scale_information(information)[0]
    best = max(
        itertools.combinations(range(5), 2),
        key=lambda c: np.linalg.slogdet(1e-9 * np.eye(2) + scaled[list(c)].sum(0))[1],
    )
    assert best == (0, 1)
    assert list(lines._maximise_determinant(information, 2)) == [0, 1]
    total = 1e-9 * np.eye(2) + scaled[[2, 1]].sum(axis=0)
    assert sorted(exchange_items(scaled, total, [2, 1], DOptimal())) == [0, 1]


@pytest.mark.parametrize("criterion", [DOptimal(), DOptimal((0, 3))])
def test_greedy_selection_takes_the_item_of_largest_score_in_each_round(criterion):
    rng = np.random.default_rng(5)
    size = np.exp(2.0 * rng.standard_normal((400, 1, 1)))
    items = size * rng.standard_normal((400, 6, 2))
    scaled = optimal_design.scale_information(items @ items.transpose(0, 2, 1))[0]
    chosen, total = optimal_design.select_greedily(
        scaled, optimal_design.initial_information(6), 30, criterion
    )
    before = optimal_design.initial_information(6)
    for k, item in enumerate(chosen):
        score = criterion.score(before + scaled)
        score[chosen[:k]] = -np.inf
        assert score[item] == pytest.approx(score.max(), abs=1e-9)
        before = before + scaled[item]
    assert np.allclose(before, total)


def test_few_items_are_scored_again_if_gains_diminish(monkeypatch):
    rng = np.random.default_rng(5)
    items = rng.standard_normal((2000, 6, 2))
    scaled = optimal_design.scale_information(items @ items.transpose(0, 2, 1))[0]
    scored = []
    plain = DOptimal.score
    monkeypatch.setattr(
        DOptimal, "score", lambda self, a: (scored.append(a[..., 0, 0].size), plain(self, a))[1]
    )
    optimal_design.select_greedily(scaled, optimal_design.initial_information(6), 50, DOptimal())
    assert sum(scored) < 0.2 * 50 * 2000
    assert max(scored[60:]) <= 64


def test_a_optimal_lines_leave_less_variance_than_d_optimal_ones(problem):
    for count in (8, 15, 25):
        of_all = np.diag(covariance(problem, np.arange(60)))
        a, d = (
            np.mean(np.diag(covariance(problem, f(problem, count))) / of_all)
            for f in (select_a_optimal, select_d_optimal)
        )
        assert a < d


def test_lines_for_some_unknowns(problem):
    names = problem.coordinates.parameters.names
    for name in ("part1.stiffness", "part4.mass"):
        i = names.index(name)
        own = choose_lines(f"a-optimal:10:{name}", problem)
        assert len(own) == 10
        for others in (select_a_optimal(problem, 10), select_d_optimal(problem, 10)):
            assert covariance(problem, own)[i, i] < covariance(problem, others)[i, i]
    assert list(choose_lines("a-optimal:9:part1.*, part4.mass", problem)) == list(
        select_a_optimal(
            problem,
            9,
            [i for i, n in enumerate(names) if n.startswith("part1.") or n == "part4.mass"],
        )
    )
    assert list(choose_lines("a-optimal:9", problem)) == list(select_a_optimal(problem, 9))
    with pytest.raises(
        OptionError, match=r"no unknown 'part1.stifness'; did you mean 'part1.stiffness'"
    ):
        choose_lines("a-optimal:9:part1.stifness", problem)
