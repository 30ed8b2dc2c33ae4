"""What a result says of its residual: noise, structure with what would explain it, outliers, several tests."""

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.problem import FRFPart, Problem

SENSORS = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
FREQ = np.linspace(2.0, 22.0, 60)


@pytest.fixture(scope="module")
def data(chain12_true, add_noise):
    return add_noise(
        updyn.response(chain12_true, FREQ, SENSORS, SENSORS[:2]), np.random.default_rng(7), 0.01
    )


@pytest.fixture(scope="module")
def wrong(chain12_true):
    """The chain with part 3 too soft, and the unknowns of a fit that holds it so."""
    start = chain12_true.scaled({"part3": {"stiffness": 0.9}})
    others = ["part1", "part2", "part4"]
    return start, updyn.parameters(start, stiffness=others, loss_factor=others)


@pytest.fixture(scope="module", params=[None, {"relative": 0.01}], ids=["estimated", "stated"])
def missed(request, wrong, data):
    return updyn.update(*_swapped(wrong, data), starts=0, noise=request.param)


def _swapped(wrong, data):
    return wrong[0], data, wrong[1]


def test_a_good_fit_leaves_noise(chain12_true, data):
    unknowns = updyn.parameters(chain12_true, stiffness="all", loss_factor="all")
    for noise in (None, {"relative": 0.01}):
        result = updyn.update(chain12_true, data, unknowns, starts=0, noise=noise)
        assert result.adequacy.outcome == "noise"
        assert result.adequacy.absolute == (noise is not None)
        assert result.remedy == ""
        assert f"Residual: {result.adequacy.verdict}" in result.summary()
        assert result.adequacy.chi_square == pytest.approx(1.0, abs=0.1)


def test_a_group_held_wrong_is_named_by_the_result(missed):
    found = missed.adequacy
    assert missed.status == "converged"
    assert found.outcome == "structure"
    assert found.explained_by[0].name == "part3.stiffness"
    assert found.explained_by[0].change == pytest.approx(-np.log(0.9), rel=0.05)
    assert "The model cannot explain channel " in missed.message
    assert "An error in the stiffness of part3 (10 % too low)" in missed.message
    assert missed.remedy.startswith("Free part3.stiffness if it can be wrong, and run again: ")
    text = missed.summary()
    first = found.worst[0]
    assert (
        f"  {first.response} / {first.reference}, {first.low:.4g} to {first.high:.4g} Hz: " in text
    )
    assert "  an error in part3.stiffness would explain " in text
    assert text.count(found.verdict) == 1


def test_to_free_what_is_named_makes_the_residual_noise(missed, wrong, data):
    freed = wrong[1] + updyn.parameters(wrong[0], stiffness=missed.adequacy.explained_by[0].group)
    result = updyn.update(wrong[0], data, freed, starts=0)
    assert result.adequacy.adequate
    assert result.values["part3.stiffness"] == pytest.approx(1.0 / 0.9, rel=0.01)


@pytest.mark.usefixtures("no_causes")
@pytest.mark.parametrize("method", ["log", "output-error", "equation-error"])
def test_other_methods_are_looked_at_the_same_way(method, wrong, data):
    result = updyn.update(wrong[0], data, wrong[1], method=method)
    assert result.adequacy.outcome == "structure"
    assert result.adequacy.explained_by[0].group == "part3"


def test_data_without_noise_leave_nothing_to_test(chain12_true):
    exact = updyn.response(chain12_true, FREQ, SENSORS, SENSORS[:2])
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    result = updyn.update(
        chain12_true.scaled({"part1": {"stiffness": 1.1}}), exact, unknowns, starts=0
    )
    assert result.adequacy.outcome == "exact"
    assert "no test is possible" in result.summary()


@pytest.mark.usefixtures("no_causes")
def test_outliers_count_in_full_though_the_fit_was_robust(chain12_true, data):
    values = data.values.copy()
    values[20:24, 1, 0] *= np.array([5.0, -4.0, 6.0j, -5.0])
    hit = updyn.FRF(data.freq, values, data.responses, data.references, data.quantity)
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    noise = {"relative": 0.01, "robust": "student-t"}
    result = updyn.update(chain12_true, hit, unknowns, starts=0, noise=noise)
    assert result.adequacy.outcome == "excess"
    worst = result.adequacy.worst[0]
    assert (worst.response, worst.reference) == ("5:X", "2:X")
    assert FREQ[20] <= worst.near <= FREQ[23]


@pytest.mark.usefixtures("no_causes")
@pytest.mark.parametrize("seed", range(4))
def test_lines_of_outliers_are_no_error_of_the_model(chain12_true, seed, add_noise):
    """Three of sixty lines with thirty times the noise, at all channels."""
    rng = np.random.default_rng(seed)
    clean = updyn.response(chain12_true, FREQ, SENSORS, SENSORS[:2])
    values = add_noise(clean, rng, 0.02).values.copy()
    lost = rng.choice(len(FREQ), 3, replace=False)
    values[lost] = add_noise(clean, rng, 0.6).values[lost]
    data = dataclasses.replace(clean, values=values)
    unknowns = updyn.parameters(chain12_true, stiffness="all", loss_factor="all")
    result = updyn.update(chain12_true, data, unknowns, starts=0, noise={"robust": "student-t"})
    assert result.adequacy.outcome == "excess"
    assert result.adequacy.explained_by == ()
    spacing = FREQ[1] - FREQ[0]
    for one in result.adequacy.worst[:3]:  # the largest of three lines together
        assert abs(FREQ[lost] - one.near).min() < 1.5 * spacing


def test_each_of_several_tests_is_judged_by_itself(chain12_true, wrong, data, add_noise):
    """The second test's structure has part 3 as stiff as the model says."""
    other = add_noise(
        updyn.response(wrong[0], FREQ, SENSORS[:3], SENSORS[:1]), np.random.default_rng(9), 0.01
    )
    noise = {"relative": 0.01}
    tests = [
        updyn.Test(wrong[0], data, "as built", noise=noise),
        updyn.Test(wrong[0], other, "as drawn", noise=noise),
    ]
    held = updyn.parameters(wrong[0], loss_factor="part1", prior_std={"loss_factor": 1e-9})
    result = updyn.update_jointly(tests, held, starts=0)
    assert result["as built"].adequacy.outcome == "structure"
    assert result["as built"].adequacy.explained_by[0].name == "part3.stiffness"
    assert result["as drawn"].adequacy.explained_by == ()
    assert "Test 'as built': The model cannot explain" in result.first.message
    text = result.summary().splitlines()
    assert f"as drawn: Residual: {result['as drawn'].adequacy.verdict}" in text
    assert "as built: an error in part3.stiffness would explain " in result.summary()
    assert not any(line.startswith(("Residual:", "  an error in")) for line in text)
    assert result["as drawn"].adequacy.level == result["as built"].adequacy.level == 0.01


def test_a_fit_that_failed_or_was_stopped_at_once_is_not_looked_at(wrong, data):
    result = updyn.update(wrong[0], data, wrong[1], callback=lambda progress: True)
    assert result.status == "stopped"
    assert result.adequacy is None
    assert "Residual" not in result.summary()


def test_a_fit_that_was_stopped_gets_no_experiment_advice(chain12_true):
    """Advice is computed for what the data leave undetermined, which the user would wait for."""
    few = updyn.response(chain12_true, FREQ[:3], SENSORS[:1], SENSORS[:1])
    unknowns = updyn.parameters(chain12_true, stiffness="all", mass="all")
    whole = updyn.update(chain12_true, few, unknowns, starts=0, max_iterations=3)
    assert whole.identifiability.advice
    stopped = updyn.update(chain12_true, few, unknowns, starts=0, callback=lambda progress: True)
    assert stopped.status == "stopped"
    assert not stopped.identifiability.advice


@pytest.mark.usefixtures("no_causes")
def test_a_fit_that_ran_out_of_steps_is_looked_at_where_it_had_nearly_arrived(wrong, data):
    noise = {"relative": 0.01}
    whole = updyn.update(wrong[0], data, wrong[1], starts=0, noise=noise)
    cut = {
        n: updyn.update(wrong[0], data, wrong[1], starts=0, noise=noise, max_iterations=n)
        for n in (1, 12)
    }
    assert {result.status for result in cut.values()} == {"max-iterations"}
    assert cut[1].adequacy is None
    assert cut[12].adequacy.outcome == "structure"
    assert cut[12].adequacy.explained_by[0].name == "part3.stiffness"
    assert "The model cannot explain" in cut[12].message
    assert cut[12].remedy.startswith("Free part3.stiffness if it can be wrong")
    assert whole.iterations > 12


def test_values_of_infinite_variance_are_left_out(chain12_true, data):
    from updyn.updating.judge.assessment import assess_adequacy

    variance = (0.01 * np.abs(data.values)) ** 2
    frf = updyn.FRF(
        data.freq, data.values, data.responses, data.references, data.quantity, variance=variance
    )
    unknowns = updyn.parameters(chain12_true, loss_factor="part1")
    problem = FRFPart.build(chain12_true, frf, unknowns)

    class Blind(NoiseModel):
        kind = "variance"

        def variance(self, H, frf):
            out = frf.variance.copy()
            out[:, 2] = np.inf
            return out

    x = problem.coordinates.to_x(unknowns.start)
    (plain,) = assess_adequacy(Problem.of([problem]), x, [choose_noise(None, frf)])
    (found,) = assess_adequacy(Problem.of([problem]), x, [Blind()])
    assert np.isnan(found.misfit[2]).all()
    assert found.misfit[[0, 1, 3, 4]] == pytest.approx(plain.misfit[[0, 1, 3, 4]])
    assert dataclasses.is_dataclass(found)
