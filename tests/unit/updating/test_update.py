"""`update` as a whole: statuses, validation, lines, stopping, the record, refusals."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, DofError, OptionError, ParameterError, SolverError
from updyn.linalg.solver import check_backend
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.result import STATUSES, UpdateResult
from updyn.updating.update import identifiability


@pytest.fixture(scope="module")
def data(chain12_frf, add_noise):
    return add_noise(chain12_frf, np.random.default_rng(11), 0.01)


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture(scope="module")
def result(chain12, data, unknowns):
    return updyn.update(chain12, data, unknowns, title="chain")


def numbers(thing):
    """All floats in a result's plain parts."""
    if isinstance(thing, float):
        yield thing
    elif isinstance(thing, dict):
        for v in thing.values():
            yield from numbers(v)
    elif isinstance(thing, list | tuple):
        for v in thing:
            yield from numbers(v)


def free_chain():
    K = 1e4 * np.array([[1.0, -1.0, 0], [-1.0, 2.0, -1.0], [0, -1.0, 1.0]])
    return updyn.Model.from_groups(
        {"c": updyn.Group(K, np.eye(3), loss_factor=0.05)}, ["1:X", "2:X", "3:X"]
    )


# -- the result ------------------------------------------------------------------------------------------------------
def test_result_of_a_good_test(result, chain12, chain12_true, data, unknowns):
    assert result.status == "converged"
    assert result.ok
    assert result.remedy == ""
    assert result.identifiability.complete
    assert (result.start, result.frf, result.parameters) == (chain12, data, unknowns)
    assert list(result.lines) == list(data.freq)
    assert result.fitted_responses == (
        "2:+X",
        "5:+X",
        "7:+X",
        "10:+X",
        "12:+X",
    ) or result.fitted_responses == tuple(data.responses.labels)
    assert result.at_bound == {}
    for p in unknowns:
        std = result.std[p.name]
        assert 0 < std < 0.05
        exact = _exact(p, chain12, chain12_true)
        assert abs(result.values[p.name] - exact) < 4.5 * std
    diagonal = np.sqrt(np.diag(result.covariance))
    assert diagonal == pytest.approx(list(result.std.values()), rel=1e-12)
    assert result.covariance == pytest.approx(result.covariance.T, rel=1e-9)


def _exact(p, start, true):
    if p.quantity == "loss_factor":
        return true.group(p.group).loss_factor
    return (
        abs(getattr(true.group(p.group), p.quantity)).sum()
        / abs(getattr(start.group(p.group), p.quantity)).sum()
    )


def test_model_of_the_result_has_the_values(result, chain12):
    for name, value in result.values.items():
        group, quantity = name.split(".")
        if quantity == "loss_factor":
            assert result.model.group(group).loss_factor == pytest.approx(value, rel=1e-15)
        else:
            ratio = (
                getattr(result.model.group(group), quantity).data
                / getattr(chain12.group(group), quantity).data
            )
            assert ratio == pytest.approx(np.full(len(ratio), value), rel=1e-12)


def test_noise_of_the_record(result):
    assert result.noise["relative"] == pytest.approx(0.01, rel=0.05)
    assert result.noise["floor"] < 1e-3
    assert result.noise["chi_square"] == pytest.approx(1.0, abs=0.05)
    assert result.noise["correlation_length"] == pytest.approx(1.0, abs=0.3)


def test_record_is_complete_and_has_no_nan(result):
    assert {f.name for f in fields(UpdateResult)} >= {
        "status",
        "values",
        "std",
        "history",
        "versions",
    }
    plain = {
        "values": dict(result.values), "std": dict(result.std), "noise": dict(result.noise),
        "correlation": dict(result.correlation), "timing": dict(result.timing_s), "options": dict(result.options),
    }  # fmt: skip
    assert not any(np.isnan(v) for v in numbers(plain))
    json.dumps(plain)
    assert not np.isnan(result.covariance).any()
    assert [h.number for h in result.history] == list(range(len(result.history)))
    assert (
        result.history[-1].cost <= result.history[0].cost
        or result.history[-1].stage != result.history[0].stage
    )
    assert result.timing_s["total"] >= result.timing_s["maximum-likelihood"]
    assert (
        result.correlation["after"]["db_error_median"]
        < 0.2
        < result.correlation["before"]["db_error_median"]
    )
    assert result.versions.keys() >= {"updyn", "numpy", "scipy", "python", "platform"}
    assert result.options["tier"] == "dense"
    assert "chain: converged" in result.summary()


def test_tiers_give_the_same_result(chain12, data, unknowns, result):
    sparse = updyn.update(chain12, data, unknowns, tier="sparse", starts=0)
    assert sparse.options["tier"] == "sparse"
    assert sparse.options["backend"] == check_backend(None)
    for name, std in result.std.items():
        assert sparse.values[name] == pytest.approx(result.values[name], abs=0.02 * std)


# -- statuses --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("maximum-likelihood", {"starts": 0}),
        ("log", {"starts": 0}),
        ("output-error", {}),
        ("equation-error", {}),
    ],
)
def test_one_iteration_is_too_few(chain12, data, unknowns, method, options):
    found = updyn.update(chain12, data, unknowns, method=method, max_iterations=1, **options)
    assert found.status == "max-iterations"
    assert "max_iterations" in found.remedy
    assert all(np.isfinite(v) for v in found.values.values())


@pytest.mark.parametrize("method", ["maximum-likelihood", "log", "output-error", "equation-error"])
@pytest.mark.parametrize("after", [1, 4])
def test_callback_stops(chain12, data, unknowns, method, after):
    seen = []

    def callback(progress):
        seen.append(progress)
        return len(seen) >= after

    found = updyn.update(chain12, data, unknowns, method=method, callback=callback)
    assert found.status == "stopped"
    assert after <= len(seen) <= after + 2
    assert all(np.isfinite(v) for v in found.values.values())
    assert not found.ok


def test_callback_that_returns_nothing_does_not_stop(chain12, data, unknowns, result):
    seen = []
    found = updyn.update(chain12, data, unknowns, callback=seen.append)
    assert found.status == "converged"
    assert found.values == pytest.approx(result.values, rel=1e-12)
    assert [p.iteration for p in seen] == list(range(len(seen)))
    assert len(seen) == len(found.history)


def test_unknown_without_effect_is_said_and_the_others_are_found():
    a = updyn.Group(np.diag([900.0, 0.0]), np.diag([1.0, 0.0]), loss_factor=0.05)
    b = updyn.Group(np.diag([0.0, 500.0]), np.diag([0.0, 1.0]), loss_factor=0.05)
    start = updyn.Model.from_groups({"a": a, "b": b}, ["1:X", "2:X"])
    data = updyn.response(
        start.scaled({"a": {"stiffness": 1.3}}), np.linspace(1, 9, 20), ["1:X"], ["1:X"]
    )
    found = updyn.update(start, data, updyn.parameters(start, stiffness="all"))
    assert found.status == "not-identifiable"
    assert found.values["a.stiffness"] == pytest.approx(1.3, rel=1e-8)
    assert found.std["b.stiffness"] == np.inf
    assert np.isfinite(found.std["a.stiffness"])
    assert found.identifiability.null_directions == [{"b.stiffness": 1.0}]
    assert "b.stiffness" in found.message
    assert not any(
        np.isnan(v)
        for v in numbers([dict(found.values), dict(found.std), found.identifiability.condition])
    )
    assert found.values["b.stiffness"] == pytest.approx(
        1.0
    )  # what nothing was seen of stays where it was


def test_bounds_hold_and_are_flagged(chain12, data):
    unknowns = updyn.parameters(
        chain12, stiffness="all", mass="all", loss_factor="all",
        bounds={"part1.stiffness": (0.85, 2.0), "part3.loss_factor": (0.0, 0.025)},
    )  # fmt: skip
    found = updyn.update(chain12, data, unknowns)
    assert found.at_bound == {"part1.stiffness": "lower", "part3.loss_factor": "upper"}
    assert found.values["part1.stiffness"] == pytest.approx(0.85)
    assert found.values["part3.loss_factor"] == pytest.approx(0.025)
    assert "at its lower bound" in found.summary()


def test_status_is_always_one_of_those_listed(result):
    assert set(STATUSES) == {
        "converged",
        "not-credible",
        "stalled",
        "not-identifiable",
        "max-iterations",
        "stopped",
        "failed",
    }
    assert result.status in STATUSES


@pytest.mark.parametrize("solver", ["trust-region", "gauss-newton"])
def test_start_that_cannot_be_condensed_says_so(solver):
    """DOF 2 with DOF 1 held: an undamped natural frequency at sqrt(2) Hz, where the equation error has no value."""
    K = (2 * np.pi) ** 2 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    start = updyn.Model.from_groups({"g": updyn.Group(K, np.eye(2))}, ["1:X", "2:X"])
    true = start.scaled({"g": {"stiffness": 1.1, "loss_factor": 0.05}})
    data = updyn.response(true, [0.5, 0.8, np.sqrt(2), 1.9], ["1:X"], ["1:X"])
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    found = updyn.update(start, data, unknowns, method="equation-error", solver=solver)
    assert found.status == "failed"
    assert "with the retained DOFs held is singular at 1.41421 Hz" in found.message
    assert "give the groups a loss factor" in found.message
    assert updyn.update(start, data, unknowns).values["g.stiffness"] == pytest.approx(1.1, rel=1e-9)


# -- what is fitted --------------------------------------------------------------------------------------------------
def test_validation_by_responses(chain12, data, unknowns):
    found = updyn.update(chain12, data, unknowns, validation=["7:X", "12:-X"])
    assert len(found.fitted_responses) == 3
    assert len(found.validation_responses) == 2
    alone = updyn.update(chain12, data.select(responses=["2:X", "5:X", "10:X"]), unknowns)
    assert found.values == pytest.approx(alone.values, rel=1e-9)
    scores = found.correlation["validation"]
    assert scores["after"]["frac_median"] > 0.999 > scores["before"]["frac_median"]
    assert found.frf is data


def test_a_sensor_held_out_with_the_wrong_sign_shows_in_its_figures(chain12, data, unknowns):
    """FRAC, CSAC and CSF of a sensor alone do not see its sign."""
    flipped = np.where(np.array(data.responses.labels) == "7:X", -1.0, 1.0)[:, None]
    wrong = replace(data, values=data.values * flipped)
    found = updyn.update(chain12, wrong, unknowns, validation=["7:X"])
    scores = found.correlation["validation"]["after"]
    for blind in ("frac_min", "csac_mean", "csf_mean"):
        assert scores[blind] > 0.99
    assert scores["correlation_median"] < -0.99
    assert scores["residual_median"] == pytest.approx(2.0, abs=0.05)
    (row,) = (x for x in found.summary().splitlines() if x.startswith("FRF correlation, worst"))
    assert float(row.split()[-1]) < -0.99


def test_validation_by_band(chain12, data, unknowns):
    low, high = float(data.freq[20]), float(data.freq[35])
    found = updyn.update(chain12, data, unknowns, validation=(low, high))
    assert found.validation_band == (low, high)
    assert list(found.lines) == [*data.freq[:20], *data.freq[36:]]
    alone = updyn.update(chain12, data.select(lines=found.lines), unknowns)
    assert found.values == pytest.approx(alone.values, rel=1e-9)
    assert found.correlation["validation"]["after"]["db_error_median"] < 0.2


@pytest.mark.parametrize(
    ("validation", "error", "message"),
    [
        (["3:X"], DofError, r"validation response 3:\+?X is not among"),
        ((0.0, 1e3), DataError, "holds all lines: nothing is left to fit"),
        ((1e3, 2e3), DataError, "band 1000 to 2000 Hz holds no line"),
        ((1.0, 2.0, 3.0), DataError, "expected two frequencies in Hz, or response labels"),
        (["2:X", "5:X", "7:X", "10:X", "12:X"], DataError, "holds out all responses"),
        (
            "7:X",
            DataError,
            "validation '7:X': expected two frequencies in Hz, or response labels, in",
        ),
        (
            7,
            DataError,
            "validation 7: expected two frequencies in Hz, or response labels, in a list",
        ),
        (np.array([1000, 2000]), DataError, "band 1000 to 2000 Hz holds no line"),
        ((20.0, 1.0), DataError, "band 20 to 1 Hz: the first must be below the second"),
        ((True, False), DofError, "DOF True: expected a text"),
    ],
)
def test_validation_refused(chain12, data, unknowns, validation, error, message):
    with pytest.raises(error, match=message):
        updyn.update(chain12, data, unknowns, validation=validation)


def test_lines_by_list_and_by_design(chain12, data, unknowns):
    listed = updyn.update(chain12, data, unknowns, lines=data.freq[::3])
    assert list(listed.lines) == list(data.freq[::3])
    assert listed.options["lines"] == "list"
    designed = updyn.update(chain12, data, unknowns, lines="d-optimal:20")
    assert len(designed.lines) == 20
    assert designed.options["lines"] == "d-optimal:20"
    assert designed.status == "converged"


# -- refusals --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"method": "loge"}, OptionError, r"method 'loge': .*log"),
        ({"start": 3}, OptionError, r"no option 'start'; .*starts"),
        ({"tier": "tense"}, OptionError, "tier 'tense'"),
        ({"tier": "reduce"}, OptionError, "tier 'reduce'.*'reduced'"),
        ({"backend": "umfpack"}, OptionError, "backend 'umfpack'"),
        ({"noise": {"relatif": 0.1}}, OptionError, "no key 'relatif'"),
        ({"lines": "d-optimal:600"}, OptionError, "60 lines to choose from"),
        ({"lines": "d-optimal:0"}, OptionError, "60 lines to choose from; expected 1 to 60"),
        ({"lines": 40}, OptionError, "lines = 40: expected frequencies in Hz, in a list"),
        ({"lines": [3.0]}, DataError, "3 Hz"),
    ],
)
def test_options_refused(chain12, data, unknowns, changes, error, message):
    with pytest.raises(error, match=message):
        updyn.update(chain12, data, unknowns, **changes)


def test_things_in_the_wrong_place_refused(chain12, data, unknowns):
    with pytest.raises(OptionError, match="expected a Model, found FRF"):
        updyn.update(data, chain12, unknowns)
    with pytest.raises(OptionError, match="expected a ParameterSet, found list"):
        updyn.update(chain12, data, list(unknowns))


def test_data_that_do_not_belong_to_the_model_refused(chain12, unknowns):
    other = updyn.FRF([1.0, 2.0], np.ones((2, 1, 1)), ["99:X"], ["2:X"], "receptance")
    with pytest.raises(DofError, match=r"response 99:\+?X is not among the 12 DOFs"):
        updyn.update(chain12, other, unknowns)
    other = updyn.FRF([1.0, 2.0], np.ones((2, 1, 1)), ["2:X"], ["2:Y"], "receptance")
    with pytest.raises(DofError, match=r"reference 2:\+?Y is not among the 12 DOFs"):
        updyn.update(chain12, other, unknowns)


def test_unknowns_of_another_model_refused(chain12, data):
    other = updyn.Model.from_groups(
        {"part1": updyn.Group([[1.0]], [[1.0]], viscous=[[1.0]])}, ["1:X"]
    )
    with pytest.raises(
        ParameterError, match=r"unknown 'part1.viscous': group 'part1' has no viscous in this model"
    ):
        updyn.update(chain12, data, updyn.parameters(other, viscous="all"))


def test_only_line_at_rest_of_a_free_structure_refused():
    model = free_chain()
    data = updyn.FRF([0.0], np.ones((1, 1, 1)), ["1:X"], ["1:X"], "receptance")
    with pytest.raises(SolverError, match="singular at 0 Hz: the structure is free to move"):
        updyn.update(model, data, updyn.parameters(model, stiffness="all"))


# -- before any fit --------------------------------------------------------------------------------------------------
def test_identifiability_before_any_fit(chain12, chain12_frf, unknowns, result):
    before = identifiability(chain12, chain12_frf, unknowns, noise={"relative": 0.01})
    assert isinstance(before, Identifiability)
    assert before.complete
    assert before.condition == pytest.approx(result.identifiability.condition, rel=1.0)
    assert identifiability(chain12, chain12_frf, unknowns).complete
    few = identifiability(
        chain12, chain12_frf.select(responses=["2:X"], references=["2:X"]), unknowns, lines=None
    )
    assert few.rank <= before.rank


def test_scale_of_all_masses_and_stiffnesses_is_seen_with_calibrated_force(chain12, chain12_frf):
    """Scaling all M and K by c divides H by c: seen here, as force and motion are both calibrated."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    data = updyn.response(
        chain12.scaled({f"part{i}": {"stiffness": 1.2, "mass": 1.2} for i in range(1, 5)}),
        chain12_frf.freq, ["2:X", "12:X"], ["2:X"],
    )  # fmt: skip
    found = updyn.update(chain12, data, unknowns)
    assert found.status == "converged"
    assert list(found.values.values()) == pytest.approx([1.2] * 8, rel=1e-7)


@pytest.mark.parametrize(
    ("method", "options"), [("log", {"starts": 0}), ("output-error", {}), ("equation-error", {})]
)
def test_a_model_that_cannot_follow_the_data_converges_all_the_same(chain12, data, method, options):
    """Without any damping of the model the residual is large, whatever its stiffness."""
    groups = {}
    for name, group in chain12.groups.items():
        groups[name] = updyn.Group(group.stiffness, group.mass)
    model = updyn.Model.from_groups(groups, chain12.dofs.labels)
    unknowns = updyn.parameters(model, stiffness="all")
    found = updyn.update(model, data, unknowns, method, max_iterations=60, **options)
    assert found.trust["converged"].holds


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"callback": 3}, "callback = 3: expected a function"),
        ({"checkpoint": 3}, "checkpoint = 3: expected the path of a file"),
        ({"accuracy": "x"}, "accuracy = 'x': expected a number"),
        ({"title": 3}, "title = 3: expected a text"),
        ({"method": ["log"]}, r"method \['log'\]"),
        ({"noise": [1]}, r"noise \[1\]"),
    ],
)
def test_options_of_another_kind_are_refused(chain12, data, unknowns, options, message):
    with pytest.raises(OptionError, match=message):
        updyn.update(chain12, data, unknowns, **options)


def test_numbers_of_numpy_are_numbers(chain12, data):
    unknowns = updyn.parameters(chain12, stiffness="all")
    given = {"noise": {"relative": np.float32(0.25)}, "regularise": np.int64(2), "starts": 0}
    plain = {"noise": {"relative": 0.25}, "regularise": 2, "starts": 0}
    ours, same = (updyn.update(chain12, data, unknowns, **one) for one in (given, plain))
    assert ours.values == same.values
    assert type(ours.options["regularise"]) is int


def test_data_of_zeros_are_refused(chain12, data, unknowns):
    silent = replace(data, values=0.0 * data.values)
    with pytest.raises(DataError, match="all values to be fitted are zero"):
        updyn.update(chain12, silent, unknowns, "output-error")
    tests = [updyn.Test(chain12, one, name=name) for name, one in (("a", data), ("b", silent))]
    with pytest.raises(DataError, match="test 'b': all values"):
        updyn.update_jointly(tests, unknowns)


def test_noise_stated_as_large_as_the_data_leaves_plausibility_open(chain12, data, unknowns):
    found = updyn.update(chain12, data, unknowns, noise={"relative": 0.5}, starts=0)
    assert found.trust.plausible.holds is None
    assert "is clear of the stated or measured noise" in found.trust.plausible.why
    assert "times larger than the residual" in found.adequacy.verdict


def test_zeros_are_refused_before_any_fit_too(chain12, data, unknowns):
    silent = replace(data, values=0.0 * data.values)
    with pytest.raises(DataError, match="all values to be fitted are zero"):
        identifiability(chain12, silent, unknowns)
    with pytest.raises(DataError, match="all values to be fitted are zero"):
        updyn.diagnose(chain12, silent, unknowns)


def without(model, part, quantity):
    """Return a model in which a group, or each, has a matrix of zeros."""
    groups = {}
    for name, group in model.groups.items():
        chosen = part in (None, name)
        matrix = getattr(group, quantity)
        groups[name] = replace(group, **{quantity: 0.0 * matrix}) if chosen else group
    return updyn.Model.from_groups(groups, model.dofs)


def test_a_model_without_mass_is_told_above_0_hz(chain12, data):
    massless = without(chain12, None, "mass")
    unknowns = updyn.parameters(massless, stiffness="all")
    with pytest.warns(updyn.UpdynWarning, match=r"the model has no mass: .* up to the 2\d"):
        identifiability(massless, data, unknowns)


def test_a_model_without_mass_answers_at_rest(chain12):
    massless = without(chain12, None, "mass")
    still = updyn.response(massless, [0.0], ["2:X", "5:X", "12:X"], ["2:X", "12:X"], "receptance")
    unknowns = updyn.parameters(massless, stiffness="all", bounds={"stiffness": (0.5, 2.0)})
    found = identifiability(massless, still, unknowns)
    assert found.n_parameters == 4


def test_an_unknown_of_a_matrix_of_zeros_is_named(chain12, data):
    loose = without(chain12, "part3", "stiffness")
    unknowns = updyn.parameters(loose, stiffness="all")
    said = "'part3.stiffness' changes nothing: the stiffness of group 'part3' is zero"
    with pytest.warns(updyn.UpdynWarning, match=said):
        found = identifiability(loose, data, unknowns)
    assert not found.complete


def test_causes_are_looked_for_with_a_line_at_zero_hertz(chain12, chain12_true):
    """The model cannot follow the data, so that causes are looked for; no number overflows."""
    sensors = ["2:X", "5:X", "12:X"]
    frf = updyn.response(chain12_true, np.linspace(0.0, 30.0, 31), sensors, ["12:X"])
    unknowns = updyn.parameters(chain12, stiffness="all")
    found = updyn.update(chain12, frf, unknowns, "output-error")
    assert "causes" in found.timing_s
    assert all(np.isfinite(one.value) for one in found.findings)
