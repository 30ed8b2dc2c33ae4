"""What is left once the unknowns have adapted, against a factorisation of all columns."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.channel_costs import (
    compute_exchange_costs,
    compute_place_costs,
)
from updyn.updating.judge.causes.evidence import Evidence, compute_spread, stack_real_imag
from updyn.updating.judge.causes.misfit import WeightedData, compute_log_misfit, count_values
from updyn.updating.judge.causes.moved import MisplacedSensor
from updyn.updating.judge.causes.quadratic import QuadraticMisfit
from updyn.updating.judge.causes.score import FirstOrderModel
from updyn.updating.judge.causes.swapped import SwappedChannels
from updyn.updating.judge.causes.trial import free_held_quantities
from updyn.updating.problem.problem import FRFPart


def columns_of(evidence, moved):
    """Return what the unknowns change in moved data, and their prior, as orthonormal columns."""
    there = evidence.part.with_data(moved)
    blocks = [there.block(evidence.x, lines) for lines in there.partition()]
    H, dH = np.concatenate([b.H for b in blocks]), np.concatenate([b.dH for b in blocks], axis=1)
    changes = (
        np.stack([stack_real_imag(evidence.weight * d / H) for d in dH], axis=1)
        / evidence.rms_misfit
    )
    return np.linalg.qr(np.vstack([changes, np.diag(1.0 / compute_spread(evidence.part))]))[0]


def cost_of(evidence, fault):
    """Return the cost with a fault after all unknowns, and its size, have adapted, by all rows."""
    frf, unit, n = fault.repair_with_model(evidence), evidence.rms_misfit, len(evidence.x)
    Q = columns_of(evidence, frf)
    b = np.concatenate([evidence.misfit(frf) / unit, evidence.offset_to_start])
    if fault.has_free_size:
        slope = stack_real_imag(evidence.weight * fault.slope(evidence)) / unit
        Q = np.linalg.qr(np.column_stack([Q, np.concatenate([slope, np.zeros(n)])]))[0]
    b = b - Q @ (Q.T @ b)
    power = 2.0 * np.sum(b[:-n] ** 2) * unit**2 / (len(b) - n)
    return evidence.n_values * np.log(power + 1e-6) + np.sum(b[-n:] ** 2)


@pytest.mark.parametrize(
    "text",
    [
        "sign:7:X",
        "sign:force 12:X",
        "sign",
        "swapped:2:X,7:X",
        "calibration:7:X=0.1",
        "calibration:2:X=0",
        "delay:2:X=0.002",
        "low-pass:7:X=0.001",
        "quantity:7:X=mobility",
        "other-test:7:X=0.02",
        "mass-loading=1e-5",
        "moved:force 12:X,force 11:X",
    ],
)
def test_the_cost_with_a_fault_is_that_of_all_rows(chain12, chain12_true, text):
    references = ["12:X", "4:X"] if "force" in text else ["12:X"]
    frf = updyn.response(chain12_true, np.linspace(0.6, 22.0, 20), ["2:X", "7:-X"], references)
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    part = FRFPart.build(chain12, frf, updyn.parameters(chain12, stiffness="all", mass="all"))
    evidence, fault = Evidence(part, part.coordinates.start), read_fault(text)
    assert FirstOrderModel(evidence).fit(fault).cost == pytest.approx(
        cost_of(evidence, fault), rel=1e-9
    )


def test_the_evidence_of_sized_faults_is_that_at_their_sizes(chain12, chain12_true):
    """With the misfit and its derivatives evaluated for each fault by itself."""
    frf = updyn.response(chain12_true, np.linspace(0.6, 22.0, 20), ["2:X", "7:-X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    unknowns = updyn.parameters(chain12, stiffness="all", loss_factor="all")
    part = free_held_quantities(FRFPart.build(chain12, frf, unknowns))[0]
    evidence = Evidence(part, part.coordinates.start)
    model = FirstOrderModel(evidence)
    fits = [model.fit(read_fault(text)) for text in ("calibration:7:X=0", "delay:2:X=0.002")]
    together, level = model.approximate(fits), evidence.rms_misfit**2
    J = evidence.jacobian
    for i, fit in enumerate(fits):
        e = evidence.misfit(fit.fault.repair_with_model(evidence))
        d = stack_real_imag(evidence.weight * fit.fault.slope(evidence))
        alone = QuadraticMisfit.at_point(evidence, e @ J, e @ e, (d @ J, d @ d, d @ e))
        for share in together.std_shares:
            found, expected = (
                one.evaluate_share(share, 100.0, level).log_evidence for one in (together, alone)
            )
            assert found[i] == pytest.approx(float(expected), rel=1e-3)


def test_a_sensor_elsewhere_exchanges_its_rows(chain12, chain12_true):
    frf = updyn.response(chain12_true, np.linspace(0.6, 22.0, 20), ["2:X", "7:X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    part = FRFPart.build(chain12, frf, unknowns)
    evidence = Evidence(part, part.coordinates.start)
    fault = MisplacedSensor(("7:X", "8:X"))
    assert FirstOrderModel(evidence).fit(fault).cost == pytest.approx(
        cost_of(evidence, fault), rel=1e-9
    )


@pytest.mark.parametrize("weighted", [False, True], ids=["log", "likelihood"])
def test_costs_of_all_exchanges_and_places_are_those_of_all_rows(chain12, chain12_true, weighted):
    """In any order, with two alternatives of one channel at a time, and with signs."""
    frf = updyn.response(
        chain12_true, np.linspace(0.6, 22.0, 20), ["2:X", "7:-X", "10:X"], ["12:X", "4:-X"]
    )
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    if weighted:
        frf = WeightedData.near_response(frf.values, frf, np.asarray(frf.variance))
    part = FRFPart.build(chain12, frf, updyn.parameters(chain12, stiffness="all", mass="all"))
    evidence = Evidence(part, part.coordinates.start)
    model = FirstOrderModel(evidence)
    for kind, compute in (
        (SwappedChannels, compute_exchange_costs),
        (MisplacedSensor, compute_place_costs),
    ):
        faults = list(kind.propose_faults(evidence))[::-1]
        assert len(faults) > 3
        expected = [cost_of(evidence, one) for one in faults]
        assert compute(model, faults) == pytest.approx(expected, rel=1e-9)


def test_a_sensor_elsewhere_beside_an_undamped_resonance(chain12, chain12_true):
    """The normal equations lose the prior there: an unknown moves a value by 1e9 times itself."""
    damping = {name: {"loss_factor": 0.0} for name in chain12.groups}
    model, true = chain12.with_damping(damping), chain12_true.with_damping(damping)
    resonance = updyn.modes(model, 3).frequency[2]
    freq = np.sort(np.append(np.linspace(0.6, 22.0, 20), resonance * (1.0 + 1e-9)))
    frf = updyn.response(true, freq, ["2:X", "7:X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    part = FRFPart.build(model, frf, updyn.parameters(model, stiffness="all", mass="all"))
    evidence = Evidence(part, part.coordinates.start)
    fault = MisplacedSensor(("7:X", "8:X"))
    model = FirstOrderModel(evidence)
    for cost in (model.fit(fault).cost, compute_place_costs(model, [fault])[0]):
        assert cost == pytest.approx(cost_of(evidence, fault), rel=1e-6)


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_slopes_by_frequency_at_a_line_of_0_hz(chain12, quantity):
    """A receptance has none there; a mobility or an accelerance has no logarithm."""
    freq = np.linspace(0.0, 22.0, 40)
    frf = updyn.response(chain12, freq, ["2:X", "7:X"], ["12:X"], quantity)
    frf = replace(frf, variance=np.full(frf.values.shape, 1e-12))
    part = FRFPart.build(chain12, frf, updyn.parameters(chain12, mass="all"))
    slope = Evidence(part, part.coordinates.start).slope_by_frequency
    assert np.isfinite(slope).all()
    if quantity == "receptance":
        assert np.abs(slope[0]).max() < 1e-3 * np.abs(slope[1]).max()
    moving = part.with_data(frf.select(lines=freq[1:]))
    rest = Evidence(moving, part.coordinates.start).slope_by_frequency
    np.testing.assert_allclose(slope[1:], rest, rtol=1e-6, atol=1e-8 * np.abs(rest).max())


def test_a_model_that_answers_nothing_somewhere_overflows_no_number():
    H = np.full((40, 2, 1), 1e9 + 0j)
    H[:, 1] = 0.0
    frf = updyn.FRF(np.arange(1.0, 41.0), H + 1e8, ["1:X", "2:X"], ["1:X"], "receptance")
    e, weight = compute_log_misfit(H, WeightedData.near_response(H, frf, np.full(H.shape, 1e14)))
    assert np.abs(e) == pytest.approx(np.full(H.shape, 0.1), rel=1e-3)
    assert (weight[:, 1] == 0.0).all()


def test_values_that_are_noise_weigh_nothing_on_either_side():
    """A measured value far below the response of the model, both below the noise."""
    H, values = np.ones((2, 40, 1, 1), dtype=complex)
    H[-3:, 0, 0], values[-3:, 0, 0] = [2e-3, 2e-3, 1e-5], [2e-3, 1e-5, 2e-3]
    frf = updyn.FRF(np.arange(1.0, 41.0), values, ["1:X"], ["1:X"], "receptance")
    data = WeightedData.near_response(H, frf, np.hypot(0.01 * np.abs(H), 1e-3) ** 2)
    e, weight = compute_log_misfit(H, data)
    assert (weight[:-3] > 0.9).all()
    assert (weight[-3:] < 0.05).all()
    assert (np.abs(e) < 0.1).all()


def test_other_lines_are_solved_once_for_all_sensors(chain12, chain12_true):
    """The model at exp(v) f, against one at these lines; asked for again, nothing is solved."""
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 20), ["2:X", "7:-X"], ["12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    part = FRFPart.build(chain12, frf, updyn.parameters(chain12, stiffness="all"))
    evidence = Evidence(part, part.coordinates.start)
    found = evidence.log_ratio_with_scaled_axis(0.03)
    at = (["2:X", "7:-X"], ["12:X"], "accelerance")
    here, there = (updyn.response(chain12, frf.freq * f, *at).values for f in (1.0, np.exp(0.03)))
    assert np.exp(found) == pytest.approx(there / here, rel=1e-9)
    solved = part.session.lines_solved
    assert evidence.log_ratio_with_scaled_axis(0.03) is not evidence.log_ratio_with_scaled_axis(
        0.05
    )
    assert part.session.lines_solved == solved + len(frf.freq)
    assert np.array_equal(evidence.log_ratio_with_scaled_axis(0.03), found)
    assert part.session.lines_solved == solved + len(frf.freq)


def test_values_that_are_noise_are_not_counted():
    values = np.full((10, 2, 1), 1.0 + 0j)
    values[:, 1] = 2e-3
    values[:3, 1] = 5e-3
    frf = updyn.FRF(np.arange(1.0, 11.0), values, ["1:X", "2:X"], ["1:X"], "receptance")
    assert count_values(replace(frf, variance=np.full(values.shape, 1e-6))) == 2 * (10 + 3)


def test_the_misfit_of_weighed_data_is_the_error_in_standard_deviations():
    """Whatever the level of a value, above the noise or below it."""
    rng = np.random.default_rng(2)
    shape = (400, 2, 1)
    turn = np.exp(1j * rng.uniform(0.0, 6.0, shape))
    H = 10.0 ** rng.uniform(-2.0, 3.0, shape) * turn
    sigma = np.hypot(0.01 * np.abs(H), 0.05)
    noise = rng.standard_normal((2, *shape)) * np.sqrt(0.5)
    values = H + sigma * (noise[0] + 1j * noise[1])
    frf = updyn.FRF(np.arange(1.0, 401.0), values, ["1:X", "2:X"], ["1:X"], "receptance")
    weighed = WeightedData.near_response(H, frf, sigma**2)
    assert weighed.relative_noise == pytest.approx(0.01, rel=0.05)
    for data in (weighed, replace(weighed, source="copy"), pickle.loads(pickle.dumps(weighed))):  # noqa: S301
        e, weight = compute_log_misfit(H, data)
        assert np.abs(e) == pytest.approx(
            weighed.relative_noise * np.abs(values - H) / sigma, rel=0.01
        )
        assert weight == pytest.approx(weighed.relative_noise * np.abs(H) / sigma, rel=0.01)
        assert count_values(data) == 2 * H.size
    # Of small errors it is the logarithm of the ratio.
    clear = np.abs(H) > 100.0
    ratio = weight * np.log(values / H)
    assert np.abs(e - ratio)[clear].max() < 0.03 * np.abs(ratio)[clear].max()
