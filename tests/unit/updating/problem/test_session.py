"""Where a run's work is done must not be seen in its answer; stops come between blocks of lines."""

import pickle
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.dynamics.fields import LineSolver
from updyn.engines import Serial
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import EquationError, LogError, OutputError
from updyn.updating.problem.session import RecentCache, Session, Stopped, digest
from updyn.updating.problem.settings import EVALUATION


def sent(thing):
    return pickle.loads(pickle.dumps(thing))  # noqa: S301


class Remote(Serial):
    """Four workers that share nothing with the caller: everything is sent as bytes, there and back."""

    def __init__(self):
        self.functions = []

    @property
    def workers(self):
        return 4

    @property
    def name(self):
        return "4 remote"

    def map(self, function, shared, items):
        there = sent(shared)
        for item in items:
            self.functions.append(function.__name__)
            yield sent(function(there, sent(item)))


@pytest.fixture
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture
def data(chain12_frf, add_noise):
    return add_noise(chain12_frf, np.random.default_rng(11), 0.01)


@pytest.fixture
def in_blocks(monkeypatch):
    """Blocks of a few lines, and lines worth spreading."""
    override(monkeypatch, EVALUATION, block_bytes=16 * (12 * 12 + 12 * 10 + 12 * 25) * 7)
    override(monkeypatch, EVALUATION, distributed_work=0.0)


def built(chain12, data, unknowns, **session):
    return FRFPart.build(chain12, data, unknowns, session=Session(**session))


# -- memory ----------------------------------------------------------------------------------------------------------
def test_digest_tells_type_shape_and_order():
    a = np.arange(6.0)
    different = [
        [a],
        [a.reshape(2, 3)],
        [a.astype(np.int64)],
        ["a", "b"],
        ["ab"],
        ["b", "a"],
        [b"ab", b""],
        [a[:0]],
        [],
    ]
    assert len({digest(parts) for parts in different}) == len(different)
    assert digest([a.reshape(2, 3).T]) == digest([np.ascontiguousarray(a.reshape(2, 3).T)])


def test_recent_forgets_the_oldest_unless_it_was_used():
    memory = RecentCache(limit=2.5 * 80)
    for name in "abc":
        memory.store(name.encode(), (np.full(10, 1.0),))
        memory.get(b"a")
    assert memory.get(b"b") is None
    assert memory.get(b"a") is not None
    memory.store(b"large", (np.zeros(1000),))
    assert [key for key, _ in memory.items] == [b"large"]


def test_an_evaluation_is_made_once_and_told_apart_by_all_it_follows_from(chain12, data, unknowns):
    problem = built(chain12, data, unknowns, cache=RecentCache())
    x = np.full(12, 0.05)
    first = LogError().local(Problem.of([problem]), x)
    assert LogError().local(Problem.of([problem]), x.copy()).R is first.R
    assert problem.session.lines_solved == 60
    fresh = built(chain12, data, unknowns)
    light, heavy = (OutputError(np.full((60, 5, 5), w)) for w in (1.0, 2.0))
    for other, residual, at in (
        (problem, LogError(), x + 1e-12),
        (problem, light, x),
        (problem, heavy, x),
        (problem, EquationError(), x),
        (problem.thin(20), LogError(), x),
        (problem.with_data(data.select(responses=["2:X"])), LogError(), x),
    ):
        alone = replace(other, session=fresh.session)
        before = problem.session.lines_solved
        assert (
            residual.local(Problem.of([other]), at).cost
            == residual.local(Problem.of([alone]), at).cost
        )
        assert problem.session.lines_solved == before + len(other.frf.freq)


def test_what_is_remembered_cannot_be_changed(chain12, data, unknowns):
    problem = built(chain12, data, unknowns, cache=RecentCache())
    H = problem.responses(np.full(12, 0.05))
    with pytest.raises(ValueError, match="read-only"):
        H[0] = 0.0


# -- engines ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "residual", [LogError(), OutputError(np.full((60, 5, 5), 3.0)), EquationError()]
)
@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_lines_spread_over_workers_give_the_same_bits(
    chain12, data, unknowns, in_blocks, residual, tier
):
    x = np.full(12, 0.05)
    here = FRFPart.build(chain12, data, unknowns, tier=tier)
    engine = Remote()
    there = FRFPart.build(chain12, data, unknowns, tier=tier, session=Session(engine))
    assert len(there.partition()) > 4
    assert there.partition() == here.partition()
    one, other = residual.local(Problem.of([here]), x), residual.local(Problem.of([there]), x)
    assert (one.cost, one.R.tobytes(), one.q.tobytes()) == (
        other.cost,
        other.R.tobytes(),
        other.q.tobytes(),
    )
    assert (there.responses(x) == here.responses(x)).all()
    assert len(engine.functions) == len(residual.partition(there)) + len(there.partition())


def test_a_problem_that_is_sent_leaves_its_session_and_its_factorisations_behind(
    chain12, data, unknowns
):
    problem = built(chain12, data, unknowns, cache=RecentCache(), engine=Remote())
    problem.responses(np.full(12, 0.05))
    there = sent(problem)
    assert there.session.cache is None
    assert there.session.engine.workers == 1
    assert (there.responses(np.zeros(12)) == problem.responses(np.zeros(12))).all()


def test_small_evaluations_stay_here(chain12, data, unknowns):
    engine = Remote()
    problem = built(chain12, data, unknowns, engine=engine)
    assert not problem.is_distributed
    LogError().local(Problem.of([problem]), np.full(12, 0.05))
    assert engine.functions == []


@pytest.mark.parametrize("at_once", [False, True])
def test_large_models_are_worth_spreading_and_long(at_once):
    """Not where one eigendecomposition serves all lines: every process would make it anew."""
    n = 60
    groups = {"g": updyn.Group(1e4 * np.eye(n), np.eye(n), loss_factor=0.1)}
    if not at_once:  # viscous damping of full rank is not a correction
        groups["damper"] = updyn.Group(viscous=np.eye(n))
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    lines = np.linspace(1.0, 10.0, 1000)
    data = updyn.FRF(lines, np.ones((1000, 1, 1)), ["1:X"], ["1:X"], "receptance")
    problem = FRFPart.build(model, data, updyn.parameters(model, stiffness="all"))
    assert problem.is_distributed != at_once
    assert not problem.is_long
    assert problem.thin(100).work == pytest.approx(0.1 * problem.work)


# -- stopping --------------------------------------------------------------------------------------------------------
def test_a_stop_comes_between_blocks(chain12, data, unknowns, in_blocks):
    problem = built(chain12, data, unknowns)
    asked = []

    def wants_stop():
        asked.append(problem.session.lines_solved)
        return len(asked) == 3

    problem.session.wants_stop = wants_stop
    with pytest.raises(Stopped):
        LogError().local(Problem.of([problem]), np.full(12, 0.05))
    size = problem.partition()[0].stop
    assert asked == [size, 2 * size, 3 * size]
    assert problem.session.stopped


def test_after_a_stop_short_work_is_done_and_long_work_is_not_begun(
    chain12, data, unknowns, in_blocks, monkeypatch
):
    problem = built(chain12, data, unknowns, cache=RecentCache())
    x = np.full(12, 0.05)
    known = LogError().local(Problem.of([problem]), x)
    problem.session.wants_stop = lambda: True
    problem.session.stopped = True
    assert problem.responses(x).shape == (60, 5, 5)
    override(monkeypatch, EVALUATION, long_work=0.0)
    assert LogError().local(Problem.of([problem]), x).R is known.R  # what is known costs nothing
    with pytest.raises(Stopped):
        LogError().local(Problem.of([problem]), x + 0.1)


def test_the_callback_is_asked_between_blocks_and_sees_the_lines(
    chain12, data, unknowns, in_blocks
):
    problem, seen = built(chain12, data, unknowns), []
    monitor = Monitor(Problem.of([problem]), seen.append)
    with monitor.stage("log"):
        local = LogError().local(Problem.of([problem]), np.zeros(12))
        monitor.start(np.zeros(12), local)
        LogError().local(Problem.of([problem]), np.full(12, 0.1))
    blocks = [part.stop for part in problem.partition()]
    assert [p.lines_done for p in seen] == [*blocks, *(60 + b for b in blocks[:-1])]
    assert {(p.stage, p.iteration, p.n_lines) for p in seen} == {("log", 0, 60)}
    assert [p.cost for p in seen[len(blocks) - 1 :]] == [local.cost] * len(blocks)
    assert np.isnan([p.cost for p in seen[: len(blocks) - 1]]).all()


# -- blocks of the latest point -------------------------------------------------------------------------------------
@pytest.fixture
def solved(monkeypatch):
    """Number of lines of each sparse solution."""
    found = []
    solve = LineSolver.solve

    def counted(solver, coefficients, *about):
        found.append(coefficients.shape[1])
        return solve(solver, coefficients, *about)

    monkeypatch.setattr(LineSolver, "solve", counted)
    return found


def sparse(chain12, data, unknowns, **session):
    session = Session(**session)
    return FRFPart.build(chain12, data, unknowns, tier="sparse", session=session)


def test_other_weights_at_the_same_point_need_no_solution(
    chain12, data, unknowns, in_blocks, solved
):
    part = sparse(chain12, data, unknowns, cache=RecentCache())
    problem, x = Problem.of([part]), np.full(len(unknowns), 0.05)
    weights = [scale * np.ones(data.values.shape) for scale in (1.0, 2.0)]
    first = OutputError(weights[0]).local(problem, x)
    assert sum(solved) == len(data.freq)
    again = OutputError(weights[1]).local(problem, x)
    LogError().local(problem, x)
    H = part.responses(x)
    assert sum(solved) == len(data.freq)
    np.testing.assert_allclose(again.cost, 4.0 * first.cost, rtol=1e-12)
    anew = sparse(chain12, data, unknowns)
    np.testing.assert_array_equal(again.R, OutputError(weights[1]).local(Problem.of([anew]), x).R)
    np.testing.assert_allclose(H, anew.responses(x), rtol=1e-10)
    assert not H.flags.writeable
    part.block(x + 0.01, slice(0, 3))
    part.block(x, slice(0, 3))
    assert sum(solved) == 3 * len(data.freq) + 6


def test_blocks_beyond_the_limit_are_dropped(
    chain12, data, unknowns, in_blocks, solved, monkeypatch
):
    part = sparse(chain12, data, unknowns, cache=RecentCache())
    x, blocks = np.full(len(unknowns), 0.05), part.partition()
    largest = 16 * data.values[blocks[0]].size * (1 + len(unknowns))
    override(monkeypatch, EVALUATION, cache_bytes=2 * largest)
    for lines in blocks:
        part.block(x, lines)
    assert len(solved) == len(blocks)
    part.block(x, blocks[-1])
    assert len(solved) == len(blocks)
    part.block(x, blocks[0])
    assert len(solved) == len(blocks) + 1


# -- whole runs ------------------------------------------------------------------------------------------------------
def outcome(result):
    return (
        result.status,
        result.values,
        result.std,
        result.history,
        result.correlation,
        result.noise,
    )


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize("method", ["maximum-likelihood", "log", "output-error", "equation-error"])
def test_spreading_lines_changes_no_bit_of_a_run(chain12, data, unknowns, in_blocks, method, tier):
    engine = Remote()
    here = updyn.update(chain12, data, unknowns, method=method, tier=tier)
    there = updyn.update(chain12, data, unknowns, method=method, tier=tier, engine=engine)
    assert outcome(here) == outcome(there)
    assert set(engine.functions) >= {"_reduce_block", "_block_responses"}
    assert (here.options["engine"], there.options["engine"]) == ("serial", "4 remote")


@pytest.mark.parametrize(
    ("method", "spread"),
    [("maximum-likelihood", {"_try_on_all"}), ("log", {"_try_on_all", "_descend"})],
)
def test_spreading_tries_changes_no_bit_of_a_run(
    chain12, chain12_frf, add_noise, unknowns, method, spread
):
    engine, seen = Remote(), []
    few = chain12_frf.select(responses=["2:X", "5:X"], references=["5:X"])
    data = add_noise(
        few, np.random.default_rng(11), 0.2
    )  # so little is known that unknowns are looked beside
    far = chain12.scaled({"part2": {"stiffness": 0.15, "mass": 1.5}, "part3": {"stiffness": 4.0}})
    here = updyn.update(far, data, unknowns, method=method)
    there = updyn.update(far, data, unknowns, method=method, engine=engine, callback=seen.append)
    assert outcome(here) == outcome(there)
    assert set(engine.functions) == spread
    assert [p.iteration for p in seen] == sorted(p.iteration for p in seen)
    assert {p.iteration for p in seen} == set(range(len(here.history)))


def test_spreading_tries_on_few_lines_changes_no_bit_of_a_run(chain12, add_noise):
    """Enough lines that tries go down on some of them first."""
    clean = updyn.response(chain12, np.linspace(0.5, 20.0, 160), ["2:X", "12:X"], ["12:X"])
    data = add_noise(clean, np.random.default_rng(3), 0.01)
    far = chain12.scaled({f"part{i}": {"stiffness": 0.5} for i in range(1, 5)})
    unknowns, engine = updyn.parameters(far, stiffness="all"), Remote()
    here = updyn.update(far, data, unknowns)
    there = updyn.update(far, data, unknowns, engine=engine)
    assert outcome(here) == outcome(there)
    assert "_try" in engine.functions


@pytest.mark.parametrize("after", [0, 5, 15])
def test_a_stop_during_tries_of_workers_is_where_it_is_without(chain12, data, unknowns, after):
    runs = [
        updyn.update(
            chain12, data, unknowns, callback=lambda p: p.iteration >= after, engine=engine
        )
        for engine in (None, Remote())
    ]
    assert outcome(runs[0]) == outcome(runs[1])
    assert runs[0].status == "stopped"


def test_tries_of_workers_that_fail_fail_as_they_do_here(chain12, data, unknowns):
    """At zero loss factor a line on a resonance: the tries meet models that cannot be solved."""
    K = (2 * np.pi) ** 2 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    start = updyn.Model.from_groups(
        {"g": updyn.Group(K, np.eye(2), loss_factor=0.01)}, ["1:X", "2:X"]
    )
    frf = updyn.response(
        start.scaled({"g": {"loss_factor": 0.0}}), [0.5, 0.8, 1.2, 1.9], ["1:X"], ["1:X"]
    )
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    here = updyn.update(start, frf, unknowns)
    there = updyn.update(start, frf, unknowns, engine=Remote())
    assert outcome(here) == outcome(there)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("maximum-likelihood", {}),
        ("log", {}),
        ("output-error", {}),
        ("equation-error", {}),
        ("equation-error", {"solver": "gauss-newton"}),
    ],
)
def test_a_stop_within_any_evaluation_of_a_long_run_ends_it_in_order(
    chain12, data, unknowns, in_blocks, monkeypatch, method, options
):
    """Wherever it comes, the answer is the best point so far, and not one line more is solved."""
    override(monkeypatch, EVALUATION, long_work=0.0)
    total = []
    full = updyn.update(
        chain12,
        data,
        unknowns,
        method=method,
        callback=lambda p: total.append(p.lines_done),
        **options,
    )
    assert full.status != "stopped"
    stops = np.unique(np.geomspace(1, len(total) - 1, 6).astype(int))
    for number in stops:
        seen = []

        def callback(progress, seen=seen, number=number):
            seen.append(progress.lines_done)
            return len(seen) > number

        found = updyn.update(chain12, data, unknowns, method=method, callback=callback, **options)
        assert found.status == "stopped"
        assert seen[: number + 1] == total[: number + 1]
        assert seen[-1] == total[number]
        same = max(
            0, len(found.history) - 1
        )  # the last may say where the next stage would have started
        assert found.history[:same] == full.history[:same]
        assert all(np.isfinite(v) for v in found.values.values())
        assert not np.isnan(found.covariance).any()
        best = min((h.cost for h in found.history if h.accepted), default=np.inf)
        assert best <= found.history[0].cost if found.history else True


@pytest.mark.parametrize("method", ["maximum-likelihood", "log"])
def test_a_long_run_stopped_in_its_search_says_what_is_known_by_then(
    chain12, data, unknowns, monkeypatch, method
):
    """Standard deviations come from the log error at the best point so far, without another line solved."""
    full = updyn.update(chain12, data, unknowns, method=method)
    override(monkeypatch, EVALUATION, long_work=0.0)
    steps = list(takewhile(lambda h: h.stage == "search", full.history))
    last = max(h.number for h in steps if h.accepted and min(h.values.values()) >= 0.0)
    found = updyn.update(
        chain12, data, unknowns, method=method, callback=lambda p: p.iteration >= last
    )
    assert found.status == "stopped"
    for name, std in full.std.items():
        assert found.std[name] == pytest.approx(std, rel=0.5)


def test_a_long_run_stopped_before_anything_is_known_says_so(
    chain12, data, unknowns, in_blocks, monkeypatch
):
    override(monkeypatch, EVALUATION, long_work=0.0)
    found = updyn.update(chain12, data, unknowns, callback=lambda p: True)
    assert found.status == "stopped"
    assert "What the data determine is not known" in found.message
    assert list(found.values.values()) == list(unknowns.start)
    assert set(found.std.values()) == {np.inf}
    assert found.history == ()


def test_nothing_is_computed_long_after_the_user_has_asked_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr("updyn.updating.problem.session.time.monotonic", lambda: now[0])
    session = Session(wants_stop=lambda: now[0] > 101.5)
    assert list(session.map(max, 1, [2], spread=False)) == [2]
    now[0] = 102.0  # not asked for more than a second
    with pytest.raises(Stopped):
        list(session.map(max, 1, [2], spread=False))
    assert session.stopped
    assert list(session.map(max, 1, [2, 3], spread=False)) == [2, 3]  # short: still wanted
    now[0] = 103.9
    assert list(session.map(max, 1, [2, 3], spread=False)) == [2, 3]
    now[0] = 104.1
    with pytest.raises(Stopped):
        list(session.map(max, 1, [2, 3], spread=False))


def test_a_loop_of_short_steps_asks_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now, asked = [100.0], []
    monkeypatch.setattr("updyn.updating.problem.session.time.monotonic", lambda: now[0])
    session = Session(wants_stop=lambda: bool(asked.append(now[0])) or now[0] > 102.0)
    for now[0] in (100.5, 101.5, 101.6, 102.4):
        session.check(often=True)
    assert asked == [101.5]
    now[0] = 102.6
    with pytest.raises(Stopped):
        session.check(often=True)
