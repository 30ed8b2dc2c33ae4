"""`compare`: the paper's gear train by every method, what does not apply, fewest lines, stopping, refusals."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import updyn
from updyn.comparison import Fewest
from updyn.comparison.fewest import distance_from_estimate, errors_against, list_counts
from updyn.comparison.table import NOT_APPLICABLE
from updyn.demos.gear_train import measure, starting_model, true_model, true_values
from updyn.errors import DataError, DofError, OptionError, ParameterError
from updyn.store.comparison import comparison_to_json
from updyn.updating.fit.methods import METHODS
from updyn.updating.fit.methods.least_squares import LogMethod
from updyn.updating.judge.causes.of_run import Causes, CauseSearch
from updyn.updating.problem.selection import Selection

OURS = ["maximum-likelihood", "log", "output-error", "equation-error"]


@pytest.fixture(scope="module")
def start():
    return starting_model()


@pytest.fixture(scope="module")
def data():
    return measure(np.linspace(5.0, 900.0, 40))


@pytest.fixture(scope="module")
def unknowns(start):
    return updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture(scope="module")
def bench(start, data, unknowns):
    return updyn.compare(start, data, unknowns, OURS, truth=true_values(), title="Gear train")


@pytest.fixture(scope="module")
def fewest(start, data, unknowns):
    """Without the default method: its searches with too few lines take long. tests/docs has them."""
    return updyn.compare(start, data, unknowns, OURS[1:], truth=true_values(), fewest=True)


# -- rows --------------------------------------------------------------------------------------------------
def test_truth_of_the_gear_train_turns_the_start_into_the_truth(start, unknowns):
    there = unknowns.apply(start, [true_values()[name] for name in unknowns.names])
    for name, group in true_model().groups.items():
        np.testing.assert_allclose(
            there.groups[name].stiffness.toarray(), group.stiffness.toarray(), rtol=1e-14
        )
        np.testing.assert_allclose(
            there.groups[name].mass.toarray(), group.mass.toarray(), rtol=1e-14
        )
        assert there.groups[name].loss_factor == group.loss_factor


def test_the_papers_method_and_the_default_recover_all(bench):
    assert [row.method for row in bench] == OURS
    for name in ("maximum-likelihood", "equation-error"):
        row = bench[name]
        assert row.status == "converged"
        assert row.error_rms <= row.error_max < 1e-6
        assert max(abs(row.values[n] - v) for n, v in true_values().items()) < 1e-5
        assert (row.fixed, len(row.updated)) == ((), 18)
        assert (
            row.fitted["after"]["db_error_median"]
            < 1e-6
            < 3.0
            < row.fitted["before"]["db_error_median"]
        )


def test_rows_say_what_a_single_update_says(bench, start, data, unknowns):
    seen = []
    alone = updyn.update(
        start, data, unknowns, "equation-error", callback=lambda p: seen.append(p.lines_done)
    )
    row = bench["equation-error"]
    assert dict(row.values) == alone.values
    assert (row.status, row.iterations, row.message) == (
        alone.status,
        alone.iterations,
        alone.message,
    )
    assert row.lines_solved == seen[-1] > 40 * row.iterations
    assert row.fitted["after"] == alone.correlation["after"]
    assert row.reference == "Bao, Wang & Cheng 2010"
    assert row.seconds > 0


def test_the_papers_method_needs_five_lines(fewest):
    """Never four, whichever they are: unit 1, 5 and 6 are undamped, and the real part of the equation of the driven
    DOF, one equation a line, holds five unknowns (the scale of unit 1, mass and stiffness of units
    5 and 6)."""
    found = fewest["equation-error"].fewest
    assert found.count == 5
    assert [count for count, _ in found.tried] == [3, 4, 5]
    assert all(off > 1 for _, off in found.tried[:-1])
    assert found.tried[-1][1] < 1e-6
    assert len(found.lines) == 5
    assert set(found.lines) <= set(measure(np.linspace(5.0, 900.0, 40)).freq)
    assert all(row.fewest.count is None or row.fewest.count >= 5 for row in fewest)


@pytest.mark.parametrize("omega", [(7.0, 30.0, 111.0, 640.0), (55.0, 160.0, 300.0, 333.0)])
def test_no_four_lines_determine_the_gear_train(omega):
    """Rank of the paper's S at the truth, from the tables, without any method of the package."""
    model, true = true_model(), []
    groups = list(model.groups.values())
    K = [g.stiffness.toarray() for g in groups]
    M = [g.mass.toarray() for g in groups]
    loss = [g.loss_factor for g in groups]
    for w in omega:
        Z = sum(k * (1 + 1j * c) - w**2 * m for k, m, c in zip(K, M, loss, strict=True))
        T = np.vstack([np.eye(4), -np.linalg.solve(Z[4:, 4:], Z[4:, :4])])
        h = np.linalg.solve(Z, np.eye(7)[:, 1])[:4]
        columns = [-(w**2) * m for m in M] + [
            k * (1 + 1j * c) for k, c in zip(K, loss, strict=True)
        ]
        columns += [1j * k for k in K]
        true.append(np.stack([T.T @ c @ T @ h for c in columns], axis=1))
    S = np.vstack(true)
    S = np.vstack([S.real, S.imag])
    s = np.linalg.svd(S / np.linalg.norm(S, axis=0), compute_uv=False)
    assert s[16] > 1e-7
    assert s[17] < 1e-13


def test_without_truth_the_answer_with_all_lines_counts(start, data, unknowns):
    found = updyn.compare(start, data, unknowns, ["equation-error"], fewest=True)
    (row,) = found
    assert row.fewest.count == 5
    assert np.isnan(row.error_max)
    assert np.isnan(row.off_in_std)
    assert "own estimate" in found.rule
    assert "  rms" not in found.summary()


def test_even_lines(start, data, unknowns):
    (row,) = updyn.compare(
        start, data, unknowns, ["log"], truth=true_values(), fewest=True, chosen="even"
    )
    assert row.fewest.count == 5
    at = np.searchsorted(data.freq, row.fewest.lines)
    assert list(at) == [0, 10, 20, 29, 39]


def test_causes_are_sought_with_all_lines_only(start, data, unknowns, monkeypatch):
    sought = []

    def after(looked, found, monitor):
        sought.append(found)
        return Causes()

    monkeypatch.setattr(CauseSearch, "search_after_fit", after)
    (row,) = updyn.compare(
        start, data, unknowns, ["equation-error"], truth=true_values(), fewest=True
    )
    assert len(row.fewest.tried) > 1
    assert len(sought) == 1


def test_never_enough(start, data, unknowns):
    few = data.select(lines=data.freq[::13])
    found = updyn.compare(
        start, few, unknowns, ["equation-error"], truth=true_values(), fewest=True
    )
    assert found["equation-error"].fewest.count is None
    assert found["equation-error"].fewest.tried[-1][0] == 4
    assert " none" in found.summary()


def test_what_does_not_arrive_with_all_lines_is_not_tried_with_few(start, data, unknowns):
    few = {"log": {"starts": 0, "max_iterations": 3}}
    found = updyn.compare(
        start, data, unknowns, ["log"], truth=true_values(), fewest=True, options=few
    )
    assert found["log"].status == "max-iterations"
    assert found["log"].fewest.count is None
    assert found["log"].fewest.tried == ((40, found["log"].error_max / 0.01),)


# -- what does not apply -------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Blind(LogMethod):
    """Cannot see damping."""

    cannot: ClassVar[tuple[str, ...]] = ("loss_factor", "viscous")
    reference: ClassVar[str] = "Test 2026"


@dataclass(frozen=True, slots=True)
class Picky(LogMethod):
    """Refuses its data."""

    needs: ClassVar[str] = "every DOF measured"

    def fit(self, problem, noises, monitor, x):
        raise DataError("picky: 3 of 7 DOFs have no sensor")


@pytest.fixture
def more(monkeypatch):
    monkeypatch.setitem(METHODS._entries, "blind", Blind)
    monkeypatch.setitem(METHODS._entries, "picky", Picky)


def test_what_a_method_cannot_update_stays_at_its_start(start, data, more):
    unknowns = updyn.parameters(start, stiffness="all", loss_factor=["unit 2", "unit 4"])
    moved = unknowns.with_start({"unit 4.loss_factor": 0.05})
    (row,) = updyn.compare(
        start,
        data,
        moved,
        ["blind"],
        truth={"unit 2.loss_factor": 0.4, "unit 1.stiffness": 1.0},
        options={"blind": {"starts": 0}},
    )
    assert row.fixed == ("unit 2.loss_factor", "unit 4.loss_factor")
    assert len(row.updated) == 6
    assert row.values["unit 4.loss_factor"] == 0.05
    assert (
        row.result.model.groups["unit 4"].loss_factor == 0.05
    )  # not that of the model that was handed in
    assert np.isnan(row.std["unit 4.loss_factor"])
    assert row.errors["unit 2.loss_factor"] == pytest.approx(-0.4)
    assert row.error_max >= 0.4 > row.error_max_updated == abs(row.errors["unit 1.stiffness"])
    assert row.reference == "Test 2026"


def test_a_selection_of_unknowns(start, data):
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    held = next(p for p in unknowns if p.name == "unit 2.stiffness")
    rest = updyn.updating.problem.parameters.ParameterSet(tuple(p for p in unknowns if p != held))
    held = dataclasses.replace(held, start=2.0)
    found = updyn.compare(start, data, Selection(rest, held=(held,)), ["log"])
    assert found.parameters == rest
    before, after = (
        model.groups["unit 2"].stiffness.toarray() for model in (start, found[0].result.model)
    )
    np.testing.assert_allclose(after, 2.0 * before)
    assert "unit 2.stiffness" not in found[0].values


def test_a_method_that_does_not_apply_is_a_row_that_says_why(start, data, more):
    damping = updyn.parameters(start, loss_factor="all")
    found = updyn.compare(
        start, data, damping, ["log", "blind", "picky"], options={"log": {"starts": 0}}
    )
    assert found["log"].applies
    for name, why in (
        ("blind", "it cannot update loss factor"),
        ("picky", "picky: 3 of 7 DOFs have no sensor"),
    ):
        assert found[name].status == NOT_APPLICABLE
        assert why in found[name].message
        assert found[name].values == {}
        assert f"{name} does not apply: " in found.summary()
        assert why in found.summary()
    assert "needs every DOF measured" in found.summary()


def test_all_refusing_alike_is_the_fault_of_the_input(start, data, unknowns, more, monkeypatch):
    monkeypatch.setitem(METHODS._entries, "picky too", Picky)
    with pytest.raises(DataError, match="3 of 7"):
        updyn.compare(start, data, unknowns, ["picky", "picky too"])


def test_every_method_of_the_registry_is_run_and_none_raises(start, data, unknowns):
    found = updyn.compare(start, data.select(lines=data.freq[::4]), unknowns, truth=true_values())
    assert [row.method for row in found] == list(METHODS)
    for row in found:
        assert row.message
        assert row.reference, f"{row.method}: its class needs a reference: ClassVar[str]"
        if row.applies:
            assert row.lines_solved > 0
            assert set(row.errors) == set(true_values())
            assert set(row.updated) | set(row.fixed) == set(unknowns.names)


# -- lines, held-out data, options, several tests -------------------------------------------------------------
def test_lines_are_chosen_once_for_all_and_held_out_data_are_scored(start, data, unknowns):
    found = updyn.compare(
        start,
        data,
        unknowns,
        ["log", "equation-error"],
        lines="d-optimal:12",
        validation=["3:RZ"],
        options={"equation-error": {"solver": "gauss-newton", "max_iterations": 3}},
    )
    a, b = found
    assert a.n_lines == b.n_lines == 12
    np.testing.assert_array_equal(a.result.lines, b.result.lines)
    assert b.iterations <= 3
    assert set(a.held_out) == {"before", "after"}
    assert "held out" in found.summary()


def test_regularisation_goes_to_the_methods_that_know_it(start, data, unknowns):
    found = updyn.compare(start, data, unknowns, ["log", "modal"], regularise=0.5)
    assert found["log"].result.options["regularise"] == 0.5
    assert "regularise" not in found["modal"].result.options
    assert found["modal"].message.endswith("It was run without regularisation.")
    assert "without regularisation" not in found["log"].message


def test_distance_in_own_standard_deviations(
    chain12, chain12_true, chain12_frf, add_noise, chain12_case
):
    """At 1 % noise the default's deviations hold; those of the equation error know nothing of its bias."""
    data = add_noise(chain12_frf, np.random.default_rng(5), 0.01)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    true = chain12_case["true_factors"]
    truth = {p.name: true[p.quantity][int(p.group[-1]) - 1] for p in unknowns}
    found = updyn.compare(
        chain12, data, unknowns, ["maximum-likelihood", "equation-error"], truth=truth
    )
    for row, record in zip(found, comparison_to_json(found)["rows"], strict=True):
        own = [abs(row.result.values[n] - truth[n]) / row.result.std[n] for n in truth]
        assert row.off_in_std == pytest.approx(max(own))
        assert record["off_in_std"] == row.off_in_std
    assert found["maximum-likelihood"].off_in_std < 4
    assert found["maximum-likelihood"].error_max < 0.2 * found["equation-error"].error_max


def test_several_tests_at_once(start, data, unknowns):
    halves = [
        updyn.Test(start, data.select(responses=["1:RZ", "2:RZ"]), "one"),
        updyn.Test(start, data.select(responses=["3:RZ", "4:RZ"]), "two"),
    ]
    found = updyn.compare_jointly(halves, unknowns, ["log"], truth=true_values(), fewest=True)
    (row,) = found
    assert isinstance(row.result, updyn.JointResult)
    assert row.error_max < 1e-6
    assert row.n_lines == 80
    assert row.fewest.count == 5
    for name, worst in (
        ("db_error_median", max),
        ("residual_median", max),
        ("residual_max", max),
        ("frac_median", min),
        ("correlation_min", min),
        ("csac_mean", min),
    ):
        of_tests = [r.correlation["before"][name] for r in row.result.results.values()]
        assert len(set(of_tests)) == 2
        assert row.fitted["before"][name] == worst(of_tests)


# -- stopping --------------------------------------------------------------------------------------------------
def test_stopping_keeps_the_rows_so_far(start, data, unknowns):
    stages = []

    def callback(progress):
        stages.append(progress.stage)
        return progress.stage.startswith("log")

    found = updyn.compare(
        start, data, unknowns, ["equation-error", "log", "output-error"], callback=callback
    )
    assert found.stopped
    assert [row.method for row in found] == ["equation-error", "log"]
    assert found["equation-error"].status == "converged"
    assert found["log"].status == "stopped"
    assert found.not_run == ("output-error",)
    assert "Stopped; not run: output-error" in found.summary()
    assert stages[0].startswith("equation-error (1 of 3): ")


def test_stopping_while_the_fewest_lines_are_sought(start, data, unknowns):
    found = updyn.compare(
        start, data, unknowns, ["log"], fewest=True, callback=lambda p: ", 4 of 40 lines" in p.stage
    )
    (row,) = found
    assert found.stopped
    assert row.status == "converged"
    assert row.fewest.count is None
    assert row.fewest.note == "stopped"
    assert [count for count, _ in row.fewest.tried] == [3]


# -- refusals --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"methods": ["equation-eror"]}, OptionError, "did you mean 'equation-error'"),
        ({"methods": "log"}, OptionError, r"expected a list of names, such as \['log'\]"),
        ({"methods": []}, OptionError, "at least one"),
        ({"methods": ["log", "log"]}, OptionError, "'log' occurs twice"),
        ({"options": {"log": {"start": 3}}}, OptionError, "no option 'start'"),
        ({"truth": {"unit 1.stifness": 1.0}}, ParameterError, "did you mean 'unit 1.stiffness'"),
        ({"truth": {"unit 1.stiffness": -1.0}}, ParameterError, "expected a factor above 0"),
        (
            {"truth": {"unit 1.loss_factor": "x"}},
            ParameterError,
            "expected a finite number, found 'x'",
        ),
        ({"truth": {}}, ParameterError, "contains no value"),
        ({"regularise": "gvc"}, OptionError, "gcv"),
        ({"chosen": "evenly"}, OptionError, "did you mean 'even'"),
        ({"tolerance": 0}, OptionError, "expected a number above 0"),
        ({"lines": "d-optimal:99"}, OptionError, "40 lines to choose from"),
        ({"lines": [3.0]}, DataError, "3"),
        ({"validation": ["9:RZ"]}, DofError, "9:RZ"),
    ],
)
def test_wrong_arguments(start, data, unknowns, changes, error, message):
    with pytest.raises(error, match=message):
        updyn.compare(start, data, unknowns, **changes)


def test_no_such_row(bench):
    with pytest.raises(OptionError, match="did you mean 'log'"):
        bench["lob"]


# -- small parts -----------------------------------------------------------------------------------------------
def test_numbers_of_lines_to_try():
    assert list_counts(40, 4, 18) == [3, 4, 5, 6, 8, 10, 15, 20, 30, 40]
    assert list_counts(4, 1, 2) == [1, 2, 3, 4]
    assert list_counts(2, 1, 18) == [2]


@pytest.mark.parametrize(("off", "distance"), [(0.03, 1.0), (0.06, 2.0)])
def test_unknowns_are_recovered_within_three_standard_deviations(unknowns, off, distance):
    (name,) = unknowns.names[:1]
    result = SimpleNamespace(parameters=unknowns[:1], values={name: 1.0}, std={name: 0.01})
    assert distance_from_estimate(result, 1e-3)({name: 1.0 + off}) == pytest.approx(distance)


def test_errors(unknowns):
    values = {"unit 1.stiffness": 1.1, "unit 1.loss_factor": 0.02}
    found = errors_against(values, {"unit 1.stiffness": 1.0, "unit 1.loss_factor": 0.05}, unknowns)
    assert found == pytest.approx({"unit 1.stiffness": 0.1, "unit 1.loss_factor": -0.03})


def test_it_is_immutable(bench, fewest):
    with pytest.raises(AttributeError):
        bench.rows = ()
    with pytest.raises(AttributeError):
        bench[0].status = "converged"
    assert fewest[0].fewest == Fewest(5, fewest[0].fewest.lines, fewest[0].fewest.tried)
    assert repr(bench) == "Comparison(4 methods, 4 of them run, 18 unknowns)"


def test_calibration_is_left_out_of_methods_that_know_none(start, data):
    unknowns = updyn.parameters(start, stiffness=["unit 2"]) + updyn.calibration(
        data, responses=["3:RZ"]
    )
    found = updyn.compare(
        start, data, unknowns, ["log", "equation-error"], options={"log": {"starts": 0}}
    )
    assert found["log"].fixed == ()
    assert found["equation-error"].fixed == ("3:RZ.calibration",)
    assert found["equation-error"].values["3:RZ.calibration"] == 1.0
    assert "equation-error keeps at the start: 3:RZ.calibration" in found.summary()


def test_what_stays_open_is_counted(start, unknowns):
    (row,) = updyn.compare(start, measure(), unknowns, ["equation-error"], truth=true_values())
    assert (row.status, row.rank) == ("not-identifiable", 17)


def test_errors_of_undetermined_unknowns_are_no_numbers() -> None:
    """A shaft in two halves without a sensor between them: only the sum of their flexibilities is known."""
    ends, half = np.diag([0.5, 0.0, 2.0]), np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0, 0, 0]])
    groups = {
        "left": updyn.Group(3e4 * half, loss_factor=0.02),
        "right": updyn.Group(3e4 * half[::-1, ::-1], loss_factor=0.02),
        "inertias": updyn.Group(mass=ends),
    }
    model = updyn.Model.from_groups(groups, ["1:RZ", "2:RZ", "3:RZ"])
    truth = {"left.stiffness": 0.8, "right.stiffness": 1.2}
    true = model.scaled({name.split(".")[0]: {"stiffness": v} for name, v in truth.items()})
    frf = updyn.response(true, np.linspace(10.0, 60.0, 40), ["1:RZ", "3:RZ"], ["1:RZ"])
    unknowns = updyn.parameters(model, stiffness=["left", "right"])
    found = updyn.compare(model, frf, unknowns, ["output-error"], truth=truth)
    (row,) = found
    assert row.status == "not-identifiable"
    assert row.error_max == row.error_rms == row.error_max_updated == np.inf
    assert np.isnan(row.off_in_std)
    line = next(line for line in found.summary().splitlines() if line.startswith("output-error"))
    assert line.split().count("undetermined") == 2
    (stored,) = comparison_to_json(found)["rows"]
    assert stored["error_max"] is None
    half_known = {"left.stiffness": 0.8}
    (row,) = updyn.compare(model, frf, unknowns, ["output-error"], truth=half_known)
    assert row.error_max == np.inf
