"""Selection before a fit: against QR by LAPACK, all subsets, and springs whose sum alone can be seen."""

import itertools
import json

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.errors import OptionError, ParameterError
from updyn.store.result import result_to_json
from updyn.updating.judge.selection import collinear_clusters, select_columns


def index(A):
    """Collinearity index by its definition: eigenvalues of the Gram matrix of the unit columns (Brun et al. 2001)."""
    unit = A / np.linalg.norm(A, axis=0)
    return 1.0 / np.sqrt(np.linalg.eigvalsh(unit.T @ unit)[0])


def names(n):
    return [f"p{i}" for i in range(n)]


def spring(at, k, n=3):
    """A spring of stiffness k along a chain whose DOF 0 is the ground, on DOFs 1 to n."""
    K = np.zeros((n + 1, n + 1))
    K[np.ix_(at, at)] = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return K[1:, 1:]


@pytest.fixture(scope="module")
def series():
    """Ground - a - (1) - b - (2) - c - (3): node 2 has no mass, so that b and c are seen only as 1 / (1/b + 1/c)."""
    groups = {
        "a": updyn.Group(spring([0, 1], 4e4), None, 0.02),
        "b": updyn.Group(spring([1, 2], 3e4), None, 0.02),
        "c": updyn.Group(spring([2, 3], 6e4), None, 0.02),
        "inertia": updyn.Group(None, np.diag([2.0, 0.0, 1.0])),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


@pytest.fixture(scope="module")
def measured(series):
    true = series.scaled(
        {"a": {"stiffness": 1.2}, "b": {"stiffness": 0.8}, "c": {"stiffness": 1.1}}
    )
    return updyn.response(true, np.linspace(5.0, 60.0, 40), ["1:X", "3:X"], ["1:X"])


# -- subset ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(5))
def test_the_order_is_that_of_qr_with_pivoting(seed):
    A = np.random.default_rng(seed).standard_normal((30, 12)) * np.geomspace(1e3, 1e1, 12)
    order, left_out = select_columns(A, names(12), 12)
    assert order == scipy.linalg.qr(A, mode="r", pivoting=True)[1].tolist()
    assert left_out == {}


@pytest.mark.parametrize("limit", [2.0, 4.0, 15.0])
def test_the_index_stays_below_its_limit_and_whoever_is_left_out_would_break_it(limit):
    rng = np.random.default_rng(3)
    A = 1e3 * rng.standard_normal((40, 6)) @ rng.standard_normal(
        (6, 14)
    ) + 40.0 * rng.standard_normal((40, 14))
    order, left_out = select_columns(A, names(14), None, limit)
    assert index(A[:, order]) <= limit
    assert sorted([*order, *left_out]) == list(range(14))
    for i in left_out:
        assert index(A[:, [*order, i]]) > limit


def test_the_index_of_the_subset_is_close_to_the_best_of_all_of_its_size():
    rng = np.random.default_rng(8)
    A = 1e3 * rng.standard_normal((30, 5)) @ rng.standard_normal(
        (5, 10)
    ) + 30.0 * rng.standard_normal((30, 10))
    order, _ = select_columns(A, names(10), 5)
    best = min(index(A[:, list(c)]) for c in itertools.combinations(range(10), 5))
    assert index(A[:, order]) < 3.0 * best


def test_what_the_noise_hides_is_left_out_with_its_reason():
    A = np.diag([100.0, 20.0, 0.5, 0.0])
    order, left_out = select_columns(A, names(4))
    assert order == [0, 1]
    assert left_out[2] == "it hardly affects the data: even alone it would be known only to ±2"
    assert left_out[3] == "it hardly affects the data: even alone it would be known not at all"
    A = np.array([[100.0, 99.5], [0.0, 0.9]])
    order, left_out = select_columns(A, names(2), None, 1e6)
    assert order == [0]
    assert left_out == {1: "together with p0 it would be known only to ±1.1"}
    assert select_columns(A, names(2), 2)[0] == [0, 1]


# -- springs in series -------------------------------------------------------------------------------------
def test_of_springs_in_series_one_is_fitted(series, measured):
    unknowns = updyn.parameters(series, stiffness="all")
    chosen = updyn.select(series, measured, unknowns)
    assert chosen.parameters.names == ["a.stiffness", "b.stiffness"]
    assert chosen.left_out == {
        "c.stiffness": "its effect is explained by b.stiffness (collinearity index inf)"
    }
    assert chosen.collinearity == pytest.approx(1.0 / chosen.singular_values[-1])
    result = updyn.update(series, measured, chosen)
    assert result.status == "converged"
    together = 1.0 / (1.0 / (0.8 * 3e4) + 1.0 / (1.1 * 6e4))
    assert result.values["a.stiffness"] == pytest.approx(1.2, rel=1e-6)
    assert result.values["b.stiffness"] == pytest.approx(
        1.0 / (1.0 / together - 1.0 / 6e4) / 3e4, rel=1e-6
    )
    assert result.message.endswith(
        "c.stiffness was left out before the fit: it stays at its start."
    )
    assert result.options["selection"]["left out"] == dict(chosen.left_out)
    told = json.loads(json.dumps(result_to_json(result), allow_nan=False))
    assert told["options"]["selection"]["fitted"] == ["a.stiffness", "b.stiffness"]
    assert told["message"] == result.message


def test_the_number_may_be_the_rank_or_stated(series, measured):
    unknowns = updyn.parameters(series, stiffness="all", mass="inertia")
    assert len(updyn.select(series, measured, unknowns, "rank").parameters) == 3
    one = updyn.select(series, measured, unknowns, 1)
    assert len(one.parameters) == len(one.order) == 1
    assert set(one.left_out.values()) == {
        "requested: 1 unknown; the selected ones are determined better"
    }


def test_of_springs_in_series_both_are_joined(series, measured):
    unknowns = updyn.parameters(
        series, stiffness="all", bounds={"b.stiffness": (0.2, 4.0), "c.stiffness": (0.1, 3.0)}
    )
    found = updyn.cluster(series, measured, unknowns)
    assert found.parameters.names == ["a.stiffness", "b+c.stiffness"]
    assert found.merged == {"b+c.stiffness": ("b.stiffness", "c.stiffness")}
    assert found.cosines["b+c.stiffness"] == pytest.approx(1.0, abs=1e-9)
    joined = found.parameters[1]
    assert (joined.lower, joined.upper, joined.law) == (0.2, 3.0, "b.stiffness, c.stiffness")
    result = updyn.update(series, measured, found)
    assert result.status == "converged"
    factor = (1.0 / 3e4 + 1.0 / 6e4) / (1.0 / (0.8 * 3e4) + 1.0 / (1.1 * 6e4))
    assert result.values["b+c.stiffness"] == pytest.approx(factor, rel=1e-6)
    for group, k in (("b", 3e4), ("c", 6e4)):
        assert result.model.group(group).stiffness.max() == pytest.approx(factor * k, rel=1e-6)
    assert (
        "b.stiffness, c.stiffness were joined into the one unknown b+c.stiffness" in result.message
    )
    assert result.options["selection"]["merged"] == {
        "b+c.stiffness": ["b.stiffness", "c.stiffness"]
    }


def test_the_record_of_a_selection_is_kept_exactly(series, measured, tmp_path):
    result = updyn.update(
        series, measured, updyn.cluster(series, measured, updyn.parameters(series, stiffness="all"))
    )
    updyn.write_result(result, tmp_path / "run.nc")
    again = updyn.read_result(tmp_path / "run.nc")
    assert again.options["selection"] == result.options["selection"]
    assert again.parameters == result.parameters


def test_what_is_left_out_stays_at_its_own_start(series):
    """An unknown's start may differ from the model: c at 1.1, and its loss factor at 0.05."""
    true = series.scaled({"a": {"stiffness": 1.2}, "c": {"stiffness": 1.1, "loss_factor": 0.05}})
    data = updyn.response(true, np.linspace(5.0, 60.0, 40), ["1:X", "3:X"], ["1:X"])
    unknowns = updyn.parameters(series, stiffness=["a", "c"], loss_factor=["c"])
    unknowns = unknowns.with_start({"c.stiffness": 1.1, "c.loss_factor": 0.05})
    chosen = updyn.select(series, data, unknowns, 1)
    assert chosen.parameters.names == ["a.stiffness"]
    result = updyn.update(series, data, chosen)
    assert result.values["a.stiffness"] == pytest.approx(1.2, rel=1e-6)
    assert result.model.group("c").loss_factor == 0.05
    assert result.model.group("c").stiffness.max() == pytest.approx(1.1 * 6e4)
    assert chosen.start_of(true.scaled({"c": {"stiffness": 1.0}})) is not true
    plain = updyn.select(series, data, updyn.parameters(series, stiffness="all"), 1)
    assert plain.start_of(series) is series


def test_joined_and_then_chosen(series, measured):
    """One line cannot tell stiffness from mass, whatever is joined."""
    unknowns = updyn.parameters(series, stiffness="all", mass="inertia")
    line = measured.select(lines=measured.freq[:1], responses=["1:X"])
    joined = updyn.cluster(series, line, unknowns)
    chosen = updyn.select(series, line, joined)
    assert chosen.merged == joined.merged
    assert set(chosen.parameters.names) < set(joined.parameters.names)
    assert chosen.note.startswith(
        "a.stiffness, b.stiffness, c.stiffness were joined into the one unknown a+b+c.stiffness"
    )
    assert chosen.note.endswith("inertia.mass was left out before the fit: it stays at its start.")


# -- clusters ----------------------------------------------------------------------------------------------
def test_every_two_of_a_cluster_are_alike():
    """Directions 6 degrees apart: the outer two are not alike at cos 8 degrees, whatever lies between them."""
    angle = np.radians([0.0, 6.0, 12.0, 60.0])
    cosine = np.cos(angle[:, None] - angle)
    found = collinear_clusters(cosine, ["k"] * 4, np.cos(np.radians(8.0)))
    assert found in ([[0, 1]], [[1, 2]])
    assert collinear_clusters(cosine, ["k"] * 4, np.cos(np.radians(13.0))) == [[0, 1, 2]]
    assert collinear_clusters(cosine, ["k", "m", "k", "k"], np.cos(np.radians(13.0))) == [[0, 2]]
    assert collinear_clusters(cosine, [None] * 4, 0.5) == []


def test_opposite_effects_are_reported_and_not_joined():
    """One DOF at one line: 1 / (k - w^2 m) sees stiffness and mass with opposite signs."""
    model = updyn.Model.from_groups({"o": updyn.Group([[1e4]], [[1.0]])}, ["1:X"])
    data = updyn.response(model, [10.0], ["1:X"], ["1:X"])
    found = updyn.cluster(model, data, updyn.parameters(model, stiffness="all", mass="all"))
    assert found.merged == {}
    (remark,) = found.remarks
    assert "o.mass and o.stiffness are not joined (cosine -1.0000)" in remark
    assert "opposite" in remark
    assert found.option == {}


def test_unlike_quantities_and_starts_are_told_and_not_joined(series, measured):
    law = updyn.link(series, "b.gauge", {"b.stiffness": 3})
    found = updyn.cluster(series, measured, updyn.parameters(series, stiffness="c") + law)
    assert found.merged == {}
    assert found.remarks == (
        "c.stiffness and b.gauge are not joined (cosine +1.0000): not of one quantity",
    )
    apart = updyn.parameters(series, stiffness=["b", "c"]).with_start({"c.stiffness": 1.1})
    (said,) = updyn.cluster(series, measured, apart).remarks
    assert said.endswith("their starts differ; give them one start to join them")


def test_joined_loss_factors_share_one_value(series, measured):
    found = updyn.cluster(
        series, measured, updyn.parameters(series, loss_factor=["b", "c"], prior_std={"b.*": 0.1})
    )
    (joined,) = found.parameters
    assert (joined.name, joined.start, joined.prior_std) == ("b+c.loss_factor", 0.02, 0.1)
    assert not joined.is_factor


def test_what_the_data_do_not_see_is_told():
    K = np.diag([1e4, 1e4])
    groups = {
        "here": updyn.Group(K * [1, 0], np.diag([1.0, 0])),
        "there": updyn.Group(K * [0, 1], np.diag([0, 1.0])),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    data = updyn.response(model, [3.0, 5.0, 9.0], ["1:X"], ["1:X"])
    unknowns = updyn.parameters(model, stiffness="all")
    assert updyn.cluster(model, data, unknowns).remarks == (
        "the data do not depend on there.stiffness",
    )
    assert updyn.select(model, data, unknowns).parameters.names == ["here.stiffness"]
    with pytest.raises(ParameterError, match="of 1 unknown none affects the data"):
        updyn.select(model, data, updyn.parameters(model, stiffness="there"))


def test_many_names_are_not_all_in_the_name():
    groups = {f"spring number {i}": updyn.Group([[1e3 * (i + 1)]], None) for i in range(6)}
    model = updyn.Model.from_groups({**groups, "m": updyn.Group(None, [[1.0]])}, ["1:X"])
    data = updyn.response(model, [5.0, 9.0], ["1:X"], ["1:X"])
    found = updyn.cluster(model, data, updyn.parameters(model, stiffness="all"))
    assert found.parameters.names == ["spring number 0+5 more.stiffness"]
    assert len(found.merged["spring number 0+5 more.stiffness"]) == 6


# -- several tests -----------------------------------------------------------------------------------------
@pytest.mark.usefixtures("no_causes")
def test_two_tests_tell_apart_what_one_cannot(series, measured):
    """With a mass on node 2 the two springs are no longer in series for the data."""
    loaded = updyn.Model.from_groups(
        {name: g for name, g in series.groups.items() if name != "inertia"}
        | {"inertia": updyn.Group(None, np.diag([2.0, 1.5, 1.0]))},
        series.dofs.labels,
    )
    unknowns = updyn.parameters(series, stiffness="all")
    data = updyn.response(loaded, measured.freq, ["1:X", "3:X"], ["1:X"])
    tests = [updyn.Test(series, measured, "bare"), updyn.Test(loaded, data, "loaded")]
    assert len(updyn.select_jointly(tests[:1], unknowns).parameters) == 2
    both = updyn.select_jointly(tests, unknowns)
    assert len(both.parameters) == 3
    assert updyn.cluster_jointly(tests, unknowns).merged == {}
    result = updyn.update_jointly(tests, updyn.select_jointly(tests, unknowns, 2))
    assert "left out before the fit" in result.first.message


# -- refusals ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [0, 4, 1.5, True, "all"])
def test_a_number_that_cannot_be(series, measured, n):
    with pytest.raises(OptionError, match="expected a whole number from 1 to 3, 'rank' or None"):
        updyn.select(series, measured, updyn.parameters(series, stiffness="all"), n)


def test_limits_that_cannot_be(series, measured):
    unknowns = updyn.parameters(series, stiffness="all")
    with pytest.raises(
        OptionError, match=r"max_collinearity = 0.5: expected a number of at least 1"
    ):
        updyn.select(series, measured, unknowns, max_collinearity=0.5)
    with pytest.raises(OptionError, match=r"threshold = 1.0: expected a cosine between 0 and 1"):
        updyn.cluster(series, measured, unknowns, 1.0)


# -- thresholds ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("index", "is_kept"), [(14.0, True), (16.0, False)])
def test_by_default_unknowns_are_separable_up_to_an_index_of_15(index, is_kept):
    cosine = 1.0 - 1.0 / index**2  # two unit columns have the index 1 / sqrt(1 - cosine)
    A = 1e4 * np.array([[1.0, cosine], [0.0, np.sqrt(1.0 - cosine**2)]])
    assert (len(select_columns(A, names(2))[0]) == 2) is is_kept


@pytest.mark.parametrize(("weight", "named"), [(0.18, "p0"), (0.22, "p0, p1")])
def test_an_explanation_is_named_from_a_fifth_of_the_largest(weight, named):
    A = np.array([[1e4, 0.0, 5e3], [0.0, 1e4, 5e3 * weight], [0.0, 0.0, 10.0]])
    _, left_out = select_columns(A, names(3))
    assert left_out[2].startswith(f"its effect is explained by {named} (")


def test_no_more_unknowns_are_separable_than_there_are_values():
    _, left_out = select_columns(1e4 * np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]), names(3))
    assert left_out == {2: "its effect is explained by p0, p1 (collinearity index inf)"}
