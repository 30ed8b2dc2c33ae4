"""Calibration factors of sensors, and masses of sensors, as unknowns."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError, ParameterError
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import RecentCache, Session
from updyn.updating.result import estimated_gains

FREQ = np.linspace(1.0, 40.0, 60)


def scaled(frf, rows=(), columns=()):
    values = frf.values.copy()
    for i, factor in rows:
        values[:, i] *= factor
    for j, factor in columns:
        values[:, :, j] *= factor
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)


def noisy(frf, level, seed=0):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape)
    values = frf.values + level * np.abs(frf.values) * noise / np.sqrt(2)
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)


@pytest.fixture(scope="module")
def case(make_chain):
    """A gain error of 8 % on the third of five sensors, 1 % noise."""
    model = make_chain(5)
    true = {f"part{i + 1}": {"stiffness": 1.0 + 0.1 * (-1) ** i} for i in range(5)}
    frf = updyn.response(model.scaled(true), FREQ, model.dofs, ["1:X"], "accelerance")
    return model, true, noisy(scaled(frf, rows=[(2, 1.08)]), 0.01)


def deviations(found, true):
    return np.array(
        [
            (found.values[f"{g}.stiffness"] - c["stiffness"]) / found.std[f"{g}.stiffness"]
            for g, c in true.items()
        ]
    )


NOISE = {"relative": 0.01}


def test_a_gain_error_biases_the_unknowns_and_the_factor_cures_it(case):
    model, true, frf = case
    unknowns = updyn.parameters(model, stiffness="all")
    without = updyn.update(model, frf, unknowns, noise=NOISE)
    # What the wrong sensor does to the stiffnesses, in standard deviations without the inflation.
    # These hold the error that the residual shows as well, and are so much larger than those of the
    # stated noise: the largest deviation is 6.2 of them.
    stated = without.noise["inflation"]
    assert np.abs(deviations(without, true) * stated).max() > 5
    calibrated = unknowns + updyn.calibration(frf)
    found = updyn.update(model, frf, calibrated, noise=NOISE)
    assert np.abs(deviations(found, true)).max() < 4
    gains = {i: found.values[f"{i}:X.calibration"] for i in range(1, 6)}
    for i, gain in gains.items():
        assert abs(gain - (1.08 if i == 3 else 1.0)) < 4 * found.std[f"{i}:X.calibration"]
    assert found.std["3:X.calibration"] < 0.005
    assert found.noise["chi_square"] == pytest.approx(1.0, abs=0.2)
    assert without.noise["chi_square"] > 5
    # The model is that of the stiffnesses alone; the agreement is that of what the sensors read.
    alone = model.scaled({g: {"stiffness": found.values[f"{g}.stiffness"]} for g in true})
    assert updyn.response(found.model, [7.0], ["1:X"], ["1:X"]).values == pytest.approx(
        updyn.response(alone, [7.0], ["1:X"], ["1:X"]).values, rel=1e-12
    )
    assert estimated_gains(found)[:, 0] == pytest.approx(list(gains.values()), rel=1e-12)
    assert found.correlation["after"]["csf_mean"] > 0.98
    assert estimated_gains(without) is None


@pytest.mark.parametrize("method", ["log", "output-error"])
def test_other_methods_of_the_output_know_the_factors(case, method):
    model, true, _ = case
    exact = updyn.response(model.scaled(true), FREQ, model.dofs, ["1:X"], "accelerance")
    frf = scaled(exact, rows=[(2, 1.08)])
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(
        frf, responses=["2:X", "3:X", "5:-X"]
    )
    # The output error has to begin close by.
    unknowns = unknowns.with_start(
        {f"{g}.stiffness": 1.01 * c["stiffness"] for g, c in true.items()}
    )
    found = updyn.update(model, frf, unknowns, method=method)
    expected = {"2:X": 1.0, "3:X": 1.08, "5:X": 1.0}
    for label, factor in expected.items():
        assert found.values[f"{label}.calibration"] == pytest.approx(factor, rel=1e-3)


def test_factors_of_forces(case):
    model, true, _ = case
    exact = updyn.response(model.scaled(true), FREQ, model.dofs, ["1:X", "4:-X"], "mobility")
    frf = noisy(scaled(exact, columns=[(1, 0.9)]), 0.01, 3)
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(
        frf, responses=(), references="all"
    )
    assert unknowns.names[-2:] == ["1:X.force_calibration", "4:X.force_calibration"]
    found = updyn.update(model, frf, unknowns, noise=NOISE)
    assert abs(found.values["4:X.force_calibration"] - 0.9) < 4 * found.std["4:X.force_calibration"]
    assert abs(found.values["1:X.force_calibration"] - 1.0) < 4 * found.std["1:X.force_calibration"]
    assert np.abs(deviations(found, true)).max() < 4


def test_derivatives_are_those_of_differences(case):
    model, _, frf = case
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    unknowns = unknowns + updyn.calibration(frf, references="all")
    problem = FRFPart.build(model, frf, unknowns)
    x = problem.coordinates.to_x(unknowns.start) + 0.05 * np.random.default_rng(2).standard_normal(
        problem.n
    )
    lines = slice(0, 20)
    block = problem.block(x, lines)
    for p in range(problem.n):
        h = np.zeros(problem.n)
        h[p] = 1e-5
        high, low = (problem.block(x + s * h, lines, derivatives=False).H for s in (1, -1))
        difference = (high - low) / 2e-5
        assert block.dH[p] == pytest.approx(difference, abs=1e-6 * np.abs(difference).max()), (
            unknowns.names[p]
        )
    without = FRFPart.build(model, frf, updyn.parameters(model, stiffness="all", loss_factor="all"))
    factor = np.exp(x[10:15])[:, None] * np.exp(x[15])
    plain = without.block(x[:10], lines, derivatives=False).H
    assert pytest.approx(plain * factor, rel=1e-13) == block.H


def test_lines_are_chosen_and_data_held_out_with_factors(case):
    model, true, frf = case
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(frf)
    found = updyn.update(
        model, frf, unknowns, noise=NOISE, lines="d-optimal:25", validation=["4:X"]
    )
    assert len(found.lines) == 25
    assert np.abs(deviations(found, true)).max() < 4
    # What was held out says nothing about its own sensor: that stays at its prior.
    assert found.values["4:X.calibration"] == pytest.approx(1.0, abs=1e-6)
    assert found.std["4:X.calibration"] == pytest.approx(0.05, rel=0.05)
    assert found.correlation["validation"]["after"]["frac_median"] > 0.99


def test_a_common_level_is_seen_only_against_mass(case):
    """Free masses and stiffnesses take up the level of all sensors: an open direction, and the prior decides."""
    model, _, frf = case
    shared = updyn.link(model, "all.size", {"*.stiffness": 1, "*.mass": 1})
    unknowns = (
        updyn.parameters(model, stiffness=["part2", "part3"]) + shared + updyn.calibration(frf)
    )
    found = updyn.update(model, frf, unknowns, noise=NOISE)
    assert found.status == "not-identifiable"
    (null,) = found.identifiability.null_directions
    assert set(null) == {"all.size", *(f"{i}:X.calibration" for i in range(1, 6))}
    known = updyn.parameters(model, stiffness="all") + updyn.calibration(frf)
    assert updyn.update(model, frf, known, noise=NOISE).status == "converged"


def test_tests_share_the_factor_of_a_sensor(case):
    model, true, _ = case
    tests = []
    for seed, (name, band) in enumerate({"low": FREQ[:30], "high": FREQ[30:]}.items()):
        exact = updyn.response(model.scaled(true), band, ["1:X", "3:X"], ["1:X"], "accelerance")
        tests.append(
            updyn.Test(model, noisy(scaled(exact, rows=[(1, 1.08)]), 0.01, seed), name, noise=NOISE)
        )
    unknowns = updyn.parameters(model, stiffness=["part1", "part2"]) + updyn.calibration(
        tests[0].frf, responses=["3:X"]
    )
    model = model.scaled({g: c for g, c in true.items() if g not in ("part1", "part2")})
    tests = [updyn.Test(model, t.frf, t.name, noise=NOISE) for t in tests]
    found = updyn.update_jointly(tests, unknowns)
    assert abs(found.values["3:X.calibration"] - 1.08) < 4 * found.std["3:X.calibration"]
    assert found.std["3:X.calibration"] < 0.01


def test_one_factor_for_all_sensors_of_an_amplifier(case):
    model, true, _ = case
    exact = updyn.response(model.scaled(true), FREQ, model.dofs, ["1:X"], "accelerance")
    frf = scaled(exact, rows=[(1, 1.1), (2, 1.1)])
    amplifier = updyn.calibration(frf, responses=["2:X", "3:X"], name="amplifier")
    assert amplifier.names == ["amplifier.calibration"]
    found = updyn.update(model, frf, updyn.parameters(model, stiffness="all") + amplifier)
    assert found.values["amplifier.calibration"] == pytest.approx(1.1, rel=1e-3)
    assert "2:X.calibration, 3:X.calibration" in amplifier[0].law
    for name in ("a.b", "", 3):
        with pytest.raises(ParameterError, match=r"calibration: name .*; expected a plain text"):
            updyn.calibration(frf, name=name)


# -- errors ------------------------------------------------------------------------------------------------
def test_methods_of_the_plain_measurement_refuse_factors(case):
    model, _, frf = case
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(frf)
    for method in ("equation-error", "rfm"):
        with pytest.raises(
            OptionError,
            match=f"method '{method}' uses the measurement without calibration and supports no calib",
        ):
            updyn.update(model, frf, unknowns, method=method)


def test_bad_choices_are_refused(case):
    model, _, frf = case
    for given, text in [
        ({"responses": ["7:X"]}, "calibration: 7:X is no response of the measurement"),
        (
            {"responses": "1:X"},
            "calibration: responses = '1:X'; expected 'all' or labels in a list",
        ),
        ({"responses": ()}, "calibration: no sensor is chosen"),
        ({"references": ["2:X"]}, "calibration: 2:X is no reference of the measurement; .*'1:X'"),
        ({"prior_std": 0.0}, r"unknown '1:X.calibration': prior_std 0; expected a number above 0"),
        ({"prior_std": None}, r"unknown '1:X.calibration': a calibration factor needs a prior_std"),
        ({"bounds": (0.1, 10.0, 2.0)}, r"calibration: bounds: expected \(lower, upper\), found"),
        ({"bounds": (0.1,)}, r"calibration: bounds: expected \(lower, upper\), found \(0.1,\)"),
        (
            {"bounds": (0.0, 1.0)},
            r"unknown '1:X.calibration' is a factor: its lower bound 0 must be above 0",
        ),
    ]:
        with pytest.raises(ParameterError, match=text):
            updyn.calibration(frf, **given)
    with pytest.raises(ParameterError, match="calibration: expected an FRF, found Model"):
        updyn.calibration(model)
    other = updyn.response(model, FREQ, ["1:X", "2:X"], ["1:X"])
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(frf, responses=["3:X"])
    with pytest.raises(
        ParameterError, match=r"unknown '3:X.calibration': '3:X' is no response of the measurement"
    ):
        updyn.update(model, other, unknowns)


def test_sensors_and_the_model_do_not_share_an_unknown():
    from updyn.updating.problem.parameters import Drive, Parameter

    with pytest.raises(
        ParameterError, match=r"unknown 'a.b' acts on sensors and on the model; use two unknowns"
    ):
        Parameter(
            "a", "b", 1.0, 0.5, 2.0, 0.1, (Drive("2:X", "calibration"), Drive("part1", "stiffness"))
        )


def test_a_prediction_is_that_of_the_structure_unless_a_measurement_is_meant(case):
    model, _, frf = case
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(frf, responses=["3:X"])
    found = updyn.update(model, frf, unknowns, noise=NOISE)
    of_structure = updyn.predict(found, FREQ, ["3:X"], ["1:X"])
    as_read = updyn.predict(found, FREQ, ["3:X"], ["1:X"], noise=True)
    plain = updyn.response(found.model, FREQ, ["3:X"], ["1:X"], "accelerance").values
    assert of_structure.frf.values == pytest.approx(plain, rel=1e-9)
    assert as_read.frf.values == pytest.approx(plain * found.values["3:X.calibration"], rel=1e-9)


def test_cached_responses_are_those_with_or_without_calibration_factors(case):
    model, _, frf = case
    unknowns = updyn.parameters(model, stiffness="all") + updyn.calibration(frf, references="all")
    session = Session(cache=RecentCache())
    part = FRFPart.build(model, frf, unknowns, session=session)
    x = part.coordinates.to_x(unknowns.start) + 0.1
    measured, plain = part.responses(x), replace(part, as_read=False).responses(x)
    assert measured == pytest.approx(plain * np.exp(0.1) * np.exp(0.1), rel=1e-13)
