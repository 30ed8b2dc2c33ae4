"""Plans: the layout against all layouts, what is expected of it against an update and plain formulas."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.correlation import auto_mac
from updyn.demos import chain
from updyn.errors import DataError, DofError, OptionError, ParameterError
from updyn.model import Group, Model
from updyn.planning.classical import effective_independence, least_mac
from updyn.planning.criteria import CRITERIA, Planning
from updyn.planning.information import Candidates, PairInformation
from updyn.planning.layout import best_layout
from updyn.planning.options import find_noise
from updyn.planning.settings import CANDIDATE_REDUCTION, INFORMATION, SCREENING
from updyn.updating.problem.optimal_design import DOptimal

BAND = (1.0, 40.0)


@pytest.fixture(scope="module")
def model():
    factors = (0.7, 1.6, 1.1, 0.8)
    changes = {f"part{i}": {"stiffness": f, "mass": 1 / f} for i, f in enumerate(factors, 1)}
    return chain.build().scaled(changes)


@pytest.fixture(scope="module")
def unknowns(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


def planning_of(model, unknowns, wanted=None, freq=None, noise=None, points=1):
    freq = np.linspace(*BAND, 60) if freq is None else freq
    found = Candidates.compile(
        model, unknowns, model.dofs, model.dofs, freq, "accelerance", find_noise(noise)
    ).with_level()
    home = found.part.coordinates.start
    rng = np.random.default_rng(5)
    at = [home, *(home + 0.1 * rng.standard_normal(len(home)) for _ in range(points - 1))]
    everything = tuple(range(len(unknowns)))
    return Planning(found, PairInformation.compute(found, at), wanted or everything)


def all_scores(planning, n_rows, n_columns, score):
    """Scores of every layout there is."""
    n_i, n_j = planning.information.shape
    rows = list(itertools.combinations(range(n_i), n_rows))
    out = []
    for columns in itertools.combinations(range(n_j), n_columns):
        items = planning.information.of_responses(columns)
        totals = np.stack([items[list(each)].sum(axis=0) for each in rows])
        out.append(score.score(totals + planning.information.before))
    return np.concatenate(out)


# -- the layout ------------------------------------------------------------------------------------
@pytest.mark.parametrize("criterion", ["d-optimal", "a-optimal"])
@pytest.mark.parametrize(("n_rows", "n_columns", "points"), [(3, 1, 1), (2, 2, 1), (4, 1, 3)])
def test_layout_is_among_the_best_of_all(model, unknowns, criterion, n_rows, n_columns, points):
    planning = planning_of(model, unknowns, points=points)
    score = CRITERIA[criterion]().score(planning)
    found = best_layout(planning.information, n_rows, n_columns, score)
    reached = score.score(planning.information.of_layout(found.rows, found.columns))
    every = all_scores(planning, n_rows, n_columns, score)
    assert np.exp(0.5 * (every.max() - reached)) < 1.01
    assert (every > reached + 1e-9).mean() < 1e-3


@pytest.fixture
def rods():
    """Six rods of 10 masses each in a row, fixed at both ends, and their stiffnesses and a mass."""
    n, groups = 60, {}
    for g in range(6):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for i in range(10 * g, 10 * g + 10):
            M[i, i] = 1.0 + 0.1 * g
            K[i, i] += 1e4
            if i:
                K[i - 1, i - 1] += 1e4
                K[[i, i - 1], [i - 1, i]] -= 1e4
        if g == 5:
            K[-1, -1] += 1e4
        groups[f"rod{g}"] = Group(K, M, loss_factor=0.02)
    model = Model.from_groups(groups, [f"{i}:X" for i in range(1, n + 1)])
    return model, updyn.parameters(model, stiffness="all", mass="rod2", loss_factor="rod0")


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("criterion", ["d-optimal", "a-optimal"])
def test_a_layout_among_screened_candidates_is_as_good(rods, monkeypatch, criterion, reduced):
    """The figures of both are those of the model itself."""
    how = {"criterion": criterion, "lines": 80, "robust": 1}
    whole = updyn.plan(*rods, None, 4, 1, (0.5, 8.0), **how)
    override(monkeypatch, SCREENING, most_pairs=1000)
    override(monkeypatch, SCREENING, least_responses=24, least_references=12)
    override(monkeypatch, SCREENING, kept_per_selected=3)
    override(monkeypatch, SCREENING, sampled_dofs=20)
    if reduced:
        override(monkeypatch, CANDIDATE_REDUCTION, most_exact_dofs=10)
    found = updyn.plan(*rods, None, 4, 1, (0.5, 8.0), **how)
    assert whole.screened == ""
    assert found.screened.startswith(
        "chosen among 24 of 60 candidate sensors and 12 of 60 candidate"
    )
    assert found.screened in found.summary()
    assert found.radius < 1.05 * whole.radius
    again = updyn.plan(*rods, found.responses, 4, 1, (0.5, 8.0), **how, reference_candidates=found.references)  # fmt: skip
    # The floor of the noise is a share of the rms of all candidates, which are others here.
    for name in found.std:
        assert found.std[name] == pytest.approx(again.std[name], rel=0.02)


def test_classical_criteria_look_at_all_candidates(rods, monkeypatch):
    whole = updyn.plan(*rods, None, 4, 1, (0.5, 8.0), "mac", lines=40, robust=0)
    override(monkeypatch, SCREENING, most_pairs=1000)
    found = updyn.plan(*rods, None, 4, 1, (0.5, 8.0), "mac", lines=40, robust=0)
    assert found.screened == ""
    assert found.responses == whole.responses


def test_d_optimal_for_some_unknowns_is_that_of_their_covariance(model, unknowns):
    planning = planning_of(model, unknowns, wanted=(0, 4))
    total = planning.information.of_layout([1, 5, 8], [3])[0]
    covariance = np.linalg.pinv(total, hermitian=True)[np.ix_([0, 4], [0, 4])]
    others = tuple(i for i in range(len(unknowns)) if i not in (0, 4))
    score = DOptimal(others).score(total)
    assert score == pytest.approx(-np.linalg.slogdet(covariance)[1], rel=1e-6)


@pytest.mark.parametrize("name", ["part2.stiffness", "part3.loss_factor"])
def test_an_unknown_of_interest_is_known_better(model, unknowns, name):
    alone = updyn.plan(model, unknowns, None, 3, 1, BAND, interest=name, robust=0)
    every = updyn.plan(model, unknowns, None, 3, 1, BAND, robust=0)
    assert alone.wanted == (name,)
    assert alone.radius == pytest.approx(alone.std[name], rel=1e-4)
    assert alone.std[name] < every.std[name]


def test_several_draws_lower_the_mean_over_them(model, unknowns):
    planning = planning_of(model, unknowns, points=4)
    score = CRITERIA["d-optimal"]().score(planning)
    over_all = best_layout(planning.information, 3, 1, score)
    first = PairInformation(
        planning.information.packed[:, :, :1],
        planning.information.before,
        planning.information.scale,
    )
    at_start = best_layout(first, 3, 1, score)
    mean = [
        float(score.score(planning.information.of_layout(found.rows, found.columns)))
        for found in (over_all, at_start)
    ]
    assert mean[0] >= mean[1]


def test_draws_are_seeded_and_widen_what_is_expected(model, unknowns):
    first, again, other = (
        updyn.plan(model, unknowns, None, 3, 1, BAND, robust=4, seed=seed) for seed in (1, 1, 2)
    )
    assert first.responses == again.responses
    assert first.std_range == again.std_range
    assert first.std_range != other.std_range
    for name, (low, high) in first.std_range.items():
        assert low <= first.std[name] * (1 + 1e-4)
        assert high >= first.std[name] * (1 - 1e-4)


# -- what is expected ------------------------------------------------------------------------------
def test_information_is_that_of_plain_formulas(model, unknowns):
    """J by central differences of H = Z^-1, dense, without any code of the plan."""
    freq, noise = np.array([3.0, 11.0, 27.0]), {"relative": 0.02, "floor": 0.01}
    planning = planning_of(model, unknowns, freq=freq, noise=noise)

    def accelerance(x):
        changes = {}
        for p, value in zip(unknowns, x, strict=True):
            changes.setdefault(p.group, {})[p.quantity] = np.exp(value) if p.is_factor else value
        other = model.scaled(changes)
        K = (other.stiffness + 1j * other.structural).toarray()
        M = other.mass.toarray()
        w = 2 * np.pi * freq
        return np.stack([-(v**2) * np.linalg.solve(K - v**2 * M, np.eye(12)) for v in w])

    home = np.array([0.0 if p.is_factor else p.start for p in unknowns])
    step = 1e-6 * np.eye(len(home))
    J = np.stack([(accelerance(home + s) - accelerance(home - s)) / 2e-6 for s in step])
    H = accelerance(home)
    rms = np.sqrt(np.mean(np.abs(H) ** 2))
    variance = (0.02 * np.abs(H)) ** 2 + (0.01 * rms) ** 2
    for i, j in ((0, 0), (4, 9), (11, 2)):
        G = J[:, :, i, j] * np.sqrt(2 / variance[:, i, j])
        expected = (G @ G.conj().T).real
        scale = planning.information.scale
        found = planning.information.of_layout([i], [j])[0] - planning.information.before
        found = found * scale[:, None] * scale
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())


def by_noise(found):
    """Standard deviations of a fit without what it adds for residuals that are not white.

    Data without noise leave rounding, which is serially correlated.
    """
    return {name: std / found.noise["inflation"] for name, std in found.std.items()}


@pytest.mark.parametrize("chunk", [1, 5_000, 2**25])
def test_pairs_are_the_same_whatever_is_worked_on_at_a_time(model, unknowns, monkeypatch, chunk):
    """All pairs at once, by reciprocity and in chunks, against rows of candidates by themselves."""
    whole = planning_of(model, unknowns)
    override(monkeypatch, INFORMATION, chunk_bytes=chunk)
    again = planning_of(model, unknowns)
    assert again.information.packed == pytest.approx(whole.information.packed, rel=1e-9)
    some = whole.candidates.select([2, 7], range(12))
    rows = PairInformation.compute(some, [some.part.coordinates.start])
    scale = np.outer(rows.scale, rows.scale)[np.tril_indices(len(unknowns))]
    by = np.outer(whole.information.scale, whole.information.scale)
    by = by[np.tril_indices(len(unknowns))]
    expected = whole.information.packed[[2, 7]] * by
    assert rows.packed * scale == pytest.approx(expected, rel=1e-9)


def test_standard_deviations_are_those_of_an_update(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 4, 1, BAND, noise={"relative": 0.03, "floor": 0.01})
    clean = updyn.response(model, plan.freq, plan.responses, plan.references, plan.quantity)
    data = updyn.FRF(
        clean.freq,
        clean.values,
        clean.responses,
        clean.references,
        clean.quantity,
        variance=plan.variance,
    )
    found = updyn.update(model, data, unknowns, noise="variance")
    assert plan.std == pytest.approx(by_noise(found), rel=1e-6)


def test_relative_noise_needs_no_level(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 4, 1, BAND, noise={"relative": 0.03})
    clean = updyn.response(model, plan.freq, plan.responses, plan.references, plan.quantity)
    found = updyn.update(model, clean, unknowns, noise={"relative": 0.03})
    assert plan.std == pytest.approx(by_noise(found), rel=1e-6)


def test_priors_count(model):
    unknowns = updyn.parameters(model, stiffness="all", prior_std={"stiffness": 1e-5})
    plan = updyn.plan(model, unknowns, None, 2, 1, BAND)
    assert list(plan.std.values()) == pytest.approx([1e-5] * 4, rel=0.01)


def test_gains_fall_and_add_up_to_the_radius(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 5, 2, BAND, robust=0)
    whole, fewer = (
        updyn.plan(
            model, unknowns, plan.responses[:n], n, 2, BAND,
            reference_candidates=plan.references, noise={"relative": 0.05}, robust=0,
        )
        for n in (5, 2)
    )  # fmt: skip
    assert list(plan.gain) == sorted(plan.gain, reverse=True)
    assert len(plan.gain) == 5
    assert len(plan.reference_gain) == 2
    assert set(whole.responses[:2]) == set(fewer.responses)
    left = np.prod([1 - gain for gain in whole.gain[2:]])
    assert whole.radius / fewer.radius == pytest.approx(left, rel=1e-6)
    mean = np.exp(np.mean(np.log(list(plan.std.values()))))
    assert plan.radius < mean  # correlated unknowns: the ellipsoid is slimmer than its box


def test_worth_of_more(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 3, 1, BAND, robust=0)
    assert plan.doubled["averages"] == pytest.approx(1 - np.sqrt(0.5), rel=1e-3)
    assert plan.doubled["lines"] == pytest.approx(1 - np.sqrt(0.5), rel=0.1)
    more = updyn.plan(
        model, unknowns, [*plan.responses, plan.further[0].label], 4, 1, BAND,
        reference_candidates=plan.references, noise={"relative": 0.05}, robust=0,
    )  # fmt: skip
    same = updyn.plan(
        model, unknowns, list(plan.responses), 3, 1, BAND,
        reference_candidates=plan.references, noise={"relative": 0.05}, robust=0,
    )  # fmt: skip
    assert 1 - more.radius / same.radius == pytest.approx(plan.further[0].gain, rel=0.05)
    assert plan.parts[0].low == BAND[0]
    assert all(0 < part.gain < 1 for part in plan.parts)


def test_of_several_bands_the_best_is_chosen(model, unknowns):
    bands = [(1.0, 5.0), (1.0, 40.0), (200.0, 400.0)]
    plan = updyn.plan(model, unknowns, None, 3, 1, bands, lines=80)
    assert plan.band == (1.0, 40.0)
    assert [(band.low, band.high) for band in plan.bands] == bands
    assert plan.bands[1].gain == 0.0
    assert plan.bands[0].gain > 0.0
    assert plan.freq[[0, -1]] == pytest.approx([1.0, 40.0])


def test_channels_that_are_rounding_say_nothing():
    """Two beams side by side that nothing couples: a force on one moves the other by rounding only."""
    K = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, 1e-14], [0.0, 1e-14, 1.0]]) * 1e4
    groups = {
        "beam": Group(K * np.array([[1, 1, 0], [1, 1, 1], [0, 1, 0]]), np.diag([1.0, 1.0, 0.0]), 0.02),
        "other": Group(np.diag([0, 0, 1e4]), np.diag([0, 0, 1.0]), loss_factor=0.02),
    }  # fmt: skip
    model = Model.from_groups(groups, ["1:X", "2:X", "3:X"])
    unknowns = updyn.parameters(model, stiffness="all")
    plan = updyn.plan(model, unknowns, None, 2, 2, (5.0, 40.0), noise={"relative": 0.01})
    assert "3:X" in plan.responses
    assert "3:X" in plan.references


# -- classical criteria ----------------------------------------------------------------------------
def test_effective_independence_is_that_of_its_formula(model):
    shapes = updyn.modes(model, 4).shapes
    left = list(range(12))
    while len(left) > 5:
        phi = shapes[left]
        contribution = np.diag(phi @ np.linalg.pinv(phi.T @ phi) @ phi.T)
        left.pop(int(np.argmin(contribution)))
    assert effective_independence(shapes, 5) == left


def two_planes(turn=0.0, n=8):
    """The same chain in Y and Z, 1.37 times as stiff in Z, its DOFs turned about X."""
    K, M, cross = np.zeros((n, n)), np.diag(1.0 + 0.1 * np.arange(n)), np.diag([1.0, 1.37])
    for i in range(n):
        K[i, i] += 1e4
        if i:
            K[i - 1, i - 1] += 1e4
            K[i, i - 1] = K[i - 1, i] = -1e4
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    chain_of_both = Group(np.kron(K, R.T @ cross @ R), np.kron(M, np.eye(2)), loss_factor=0.02)
    labels = [f"{i + 1}:{axis}" for i in range(n) for axis in "YZ"]
    return Model.from_groups({"chain": chain_of_both}, labels)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2])  # cos(90 degrees) is 6e-17
@pytest.mark.parametrize("criterion", ["effective-independence", "mac"])
def test_modes_in_another_plane_than_the_candidates_do_not_count(turn, criterion):
    structure, n = two_planes(turn), 8
    unknowns = updyn.parameters(structure, stiffness="all")
    band = (1.0, 0.5 * sum(updyn.modes(structure, 7).frequency[-2:]))  # three modes in each plane
    planned = updyn.plan(
        structure, unknowns, "*:Z", 3, 1, band, criterion, lines=20, robust=0, noise=None
    )
    shapes = updyn.modes(structure, 6).at([f"{i + 1}:Z" for i in range(n)])
    own = shapes[:, np.abs(shapes).max(axis=0) > 1e-9]
    choose = {"effective-independence": effective_independence, "mac": least_mac}[criterion]
    assert own.shape[1] == 3
    assert sorted(planned.responses) == [f"{i + 1}:Z" for i in choose(own, 3)]


def test_a_criterion_of_shapes_says_where_no_mode_is_seen():
    structure = two_planes()
    lowest = updyn.modes(structure, 1).frequency[0]
    found = planning_of(
        structure,
        updyn.parameters(structure, stiffness="all"),
        freq=np.linspace(0.9 * lowest, 1.1 * lowest, 5),  # the mode in Y
    )
    of_z = replace(found, candidates=found.candidates.select(range(1, 16, 2), range(1, 16, 2)))
    for name in ("effective-independence", "mac"):
        with pytest.raises(DataError, match="no mode in the band moves at the candidate responses"):
            CRITERIA[name]().choose(of_z, 2, 1)


def test_least_mac_is_near_the_least_of_all(model):
    shapes = updyn.modes(model, 4).shapes

    def largest(rows):
        return (auto_mac(shapes[list(rows)]) - np.eye(4)).max()

    every = [largest(rows) for rows in itertools.combinations(range(12), 5)]
    assert (np.array(every) < largest(least_mac(shapes, 5)) - 1e-12).mean() < 0.02


def test_driving_point_residue_takes_the_largest(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 3, 2, BAND, "driving-point-residue")
    found = updyn.modes(model, 12)
    inside = (found.frequency >= BAND[0]) & (found.frequency <= BAND[1])
    residue = (found.shapes[:, inside] ** 2 / found.frequency[inside]).sum(axis=1)
    best = np.array(model.dofs.labels)[np.argsort(-residue)]
    assert set(plan.responses) == set(best[:3])
    assert set(plan.references) == set(best[:2])


def test_other_criteria_are_compared(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 4, 1, BAND, compare=True, robust=0)
    assert [rival.criterion for rival in plan.rivals] == [n for n in CRITERIA if n != "d-optimal"]
    assert all(rival.ratio >= 1 - 1e-9 for rival in plan.rivals)
    alone = updyn.plan(model, unknowns, None, 4, 1, BAND, "effective-independence", robust=0)
    (rival,) = (r for r in plan.rivals if r.criterion == "effective-independence")
    assert set(rival.responses) == set(alone.responses)
    assert rival.ratio == pytest.approx(alone.radius / plan.radius, rel=1e-9)


def test_a_criterion_that_cannot_choose_says_why(model):
    unknowns = updyn.parameters(model, stiffness="all")
    first = updyn.modes(model, 1).frequency[0]
    plan = updyn.plan(model, unknowns, None, 4, 1, (0.5, 1.2 * first), compare=True)
    (rival,) = (r for r in plan.rivals if r.criterion == "mac")
    assert rival.note == "MAC requires at least two modes in the band, found one"
    assert rival.note in plan.summary()


# -- candidates and errors -------------------------------------------------------------------------
def test_candidates_by_label_and_glob(model, unknowns):
    plan = updyn.plan(model, unknowns, ["3:-X", "1?:X", "10:X"], 4, 1, BAND)
    assert set(plan.responses) == {"3:-X", "10:X", "11:X", "12:X"}


def test_rotations_are_candidates_where_there_is_nothing_else():
    K, M = np.array([[2.0, -1.0], [-1.0, 1.0]]) * 1e4, np.eye(2)
    train = Model.from_groups({"shaft": Group(K, M, loss_factor=0.02)}, ["1:RZ", "2:RZ"])
    plan = updyn.plan(train, updyn.parameters(train, stiffness="all"), None, 2, 1, (1.0, 40.0))
    assert set(plan.responses) == {"1:RZ", "2:RZ"}


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"candidates": ["1:X", "99:X"]}, DofError, "candidate 99:X is not among the 12 DOFs; ne"),
        ({"candidates": ["9?:X"]}, DofError, "no DOF of the model matches '9?:X'"),
        ({"candidates": []}, DofError, "no candidate"),
        ({"candidates": 3}, DofError, "expected labels or globs, found 3"),
        ({"candidates": ["1:X"], "n_sensors": 2}, OptionError, "found 1 candidate; name more"),
        ({"n_references": 13}, OptionError, "n_references = 13: found 12 candidates"),
        ({"n_sensors": 0}, OptionError, "n_sensors = 0: expected a whole number of at least 1"),
        ({"n_sensors": True}, OptionError, "expected a whole number"),
        ({"band": (40.0, 1.0)}, OptionError, "band 40 to 1 Hz"),
        ({"band": (1.0, 2.0, 3.0)}, OptionError, "expected (low, high) in Hz"),
        ({"band": "low"}, OptionError, "expected (low, high) in Hz"),
        ({"criterion": "d-optimum"}, OptionError, "'d-optimum': did you mean 'd-optimal'"),
        ({"quantity": "acceleration"}, OptionError, "accelerance"),
        ({"lines": 1}, OptionError, "lines = 1: expected 2 to 100,000 lines"),
        ({"lines": [50.0]}, OptionError, "none of them lies in the band 1 to 40 Hz"),
        ({"lines": "many"}, OptionError, "expected a number of lines, or lines in Hz"),
        ({"noise": {"relativ": 0.1}}, OptionError, "relative and/or floor"),
        ({"noise": {"relative": -1.0}}, OptionError, "expected a number of at least 0"),
        ({"interest": "part9.*"}, OptionError, "no unknown 'part9.*'"),
        ({"interest": []}, OptionError, "no unknown is named"),
        ({"robust": -1}, OptionError, "robust = -1"),
        ({"off": 0.0}, OptionError, "off = 0.0"),
        ({"seed": 0.5}, OptionError, "seed = 0.5"),
    ],
)
def test_wrong_arguments_are_named(model, unknowns, changed, error, message):
    given = {"candidates": None, "n_sensors": 3, "n_references": 1, "band": BAND} | changed
    with pytest.raises(error) as caught:
        updyn.plan(model, unknowns, **given)
    assert message in str(caught.value)
    assert caught.value.key


def test_undetermined_unknowns_are_named(model):
    twice = Model.from_groups(dict(model.groups) | {"copy": model.group("part2")}, model.dofs)
    unknowns = updyn.parameters(twice, stiffness="all")
    with pytest.raises(ParameterError, match=r"undetermined.*: part2.stiffness, copy.stiffness\."):
        updyn.plan(twice, unknowns, None, 4, 1, BAND)


def test_calibration_factors_are_refused(model, unknowns):
    data = updyn.response(model, [3.0, 4.0], ["1:X"], ["1:X"])
    with pytest.raises(ParameterError, match="calibration factor of a sensor"):
        updyn.plan(model, unknowns + updyn.calibration(data), None, 3, 1, BAND)


def test_too_many_pairs_are_refused_before_the_work(model, unknowns, monkeypatch):
    override(monkeypatch, INFORMATION, most_bytes=50_000)
    with pytest.raises(OptionError, match="at most 6 candidate references"):
        updyn.plan(model, unknowns, None, 3, 1, BAND, robust=0)
    with pytest.raises(OptionError, match="fewer draws"):
        updyn.plan(model, unknowns, None, 3, 1, BAND, robust=4)


def test_each_start_is_shown(model, unknowns):
    shown = []
    updyn.plan(
        model, unknowns, None, 2, 1, BAND, robust=1, lines=10,
        callback=lambda progress: shown.append((progress.stage, progress.n_lines)),
    )  # fmt: skip
    stages = list(dict.fromkeys(stage for stage, _ in shown))
    about = "information of 12 x 12 pairs, 1 to 40 Hz"
    starts = [f"{about}: start {i} of 2" for i in (1, 2)]
    assert stages == ["level of 12 x 12 pairs", *starts, "layout", "expectation of the layout"]
    assert {n_lines for _, n_lines in shown} == {10}


def test_summary_shows_all_of_it(model, unknowns):
    plan = updyn.plan(model, unknowns, None, 3, 1, [BAND, (1.0, 20.0)], robust=2, compare=True)
    text = plan.summary()
    for said in (
        "d-optimal: 3 sensors, 1 force; accelerance, 200 lines from 1 to 40 Hz",
        "Chosen for the mean over the start and 2 draws, 20 % off (seed 0)",
        "Band 1 to 40 Hz: chosen",
        "Twice the lines",
        "part4.loss_factor",
        "effective-independence",
        *plan.responses,
    ):
        assert said in text
    assert repr(plan).startswith("Plan(d-optimal: sensors ")
