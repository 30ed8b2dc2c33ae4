"""Error in the constitutive relations: the functional by its definition, derivatives, limits, recovery, refusals."""

import numpy as np
import pytest

import updyn
from updyn.demos.gear_train import starting_model, true_model
from updyn.errors import DataError, OptionError
from updyn.updating.fit.methods.constitutive import ConstitutiveError, _make_residual
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.residuals import reduce_cached

RNG = np.random.default_rng


@pytest.fixture(scope="module")
def small():
    """Six DOFs, two groups with loss factors and a damper; three responses, two references, three lines."""
    rng = RNG(4)
    K, M, D = (a @ a.T + np.eye(6) for a in rng.standard_normal((3, 6, 6)))
    groups = {
        "a": updyn.Group(K, M, loss_factor=0.1),
        "b": updyn.Group(2.0 * D, 0.5 * np.eye(6), loss_factor=0.03, viscous=0.01 * M),
    }
    model = updyn.Model.from_groups(groups, [f"{i}:Z" for i in range(1, 7)])
    values = 0.3 * (rng.standard_normal((3, 3, 2)) + 1j * rng.standard_normal((3, 3, 2)))
    frf = updyn.FRF([0.1, 0.23, 0.4], values, ["1:Z", "3:-Z", "6:Z"], ["1:Z", "2:Z"], "receptance")
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all", viscous="b")
    return model, FRFPart.build(model, frf, unknowns), K, M, D


def cost(problem, error, x):
    return reduce_cached(error, problem, x).cost


def test_the_functional_is_the_least_of_its_definition(small):
    """Minimise over u and over fields v, w of each relation, written out as one quadratic problem with a constraint."""
    _, problem, K, M, D = small
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    error = _make_residual(problem, 0.3)
    rows, sign = np.array([0, 2, 5]), np.array([1.0, -1.0, 1.0])
    total = 0.0
    for k, f in enumerate(problem.frf.freq):
        omega = 2.0 * np.pi * f
        # Relations: coefficient of the force, matrix, weight of the energy of its breach.
        kept = [
            (1.0 + 0.1j, K, 1.0), (-(omega**2), M, omega**2), (1.0 + 0.03j, 2.0 * D, 1.0),
            (-(omega**2), 0.5 * np.eye(6), omega**2), (1j * omega, 0.01 * M, omega),
        ]  # fmt: skip
        Z = sum(c * A for c, A, _ in kept)
        Pi = np.eye(6)[rows]
        G = np.diag(1.0 / error.slack[k])
        for j, column in enumerate((0, 1)):
            measured = problem.frf.values[k, :, j] * sign
            force = np.eye(6)[column].astype(complex)
            # Unknowns: u, and b_t = u - v_t of each relation; sum c_t A_t (u - b_t) = force.
            m = len(kept)
            H = np.zeros((6 * (m + 1), 6 * (m + 1)), dtype=complex)
            H[:6, :6] = Pi.T @ G @ Pi
            B = np.zeros((6, 6 * (m + 1)), dtype=complex)
            B[:, :6] = Z
            for t, (c, A, a) in enumerate(kept):
                at = slice(6 * (t + 1), 6 * (t + 2))
                H[at, at] = a * A
                B[:, at] = -c * A
            g = np.concatenate([Pi.T @ G @ measured, np.zeros(6 * m)])
            system = np.block([[H, B.conj().T], [B, np.zeros((6, 6))]])
            y = np.linalg.solve(system, np.concatenate([g, force]))[: 6 * (m + 1)]
            d = y[:6][rows] - measured
            total += 0.5 * (d.conj() @ G @ d).real
            total += 0.5 * sum(
                a * (y[6 * (t + 1) : 6 * (t + 2)].conj() @ A @ y[6 * (t + 1) : 6 * (t + 2)]).real
                for t, (_, A, a) in enumerate(kept)
            )
    assert cost(problem, error, x) * error.level**2 == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("weight", [0.1, 0.5, 1.0])
def test_the_gradient_is_that_of_central_differences(small, weight):
    _, problem, *_ = small
    error = _make_residual(problem, weight)
    x = problem.coordinates.to_x(problem.coordinates.parameters.start) + 0.1 * RNG(
        1
    ).standard_normal(problem.n)
    local = reduce_cached(error, problem, x)
    for i in range(problem.n):
        step = 1e-6 * np.eye(problem.n)[i]
        slope = (cost(problem, error, x + step) - cost(problem, error, x - step)) / 2e-6
        assert local.gradient[i] == pytest.approx(
            slope, rel=1e-5, abs=1e-7 * np.abs(local.gradient).max()
        )


def test_with_all_dofs_measured_and_full_weight_it_is_the_equation_error_in_the_norm_of_energy(
    small,
):
    model, _, K, M, D = small
    labels = model.dofs.labels
    rng = RNG(5)
    values = rng.standard_normal((1, 6, 1)) + 1j * rng.standard_normal((1, 6, 1))
    frf = updyn.FRF([0.3], values, labels, ["1:Z"], "receptance")
    problem = FRFPart.build(model, frf, updyn.parameters(model, stiffness="a"))
    omega = 2.0 * np.pi * 0.3
    Z = (1 + 0.1j) * K + (1 + 0.03j) * 2 * D - omega**2 * (M + 0.5 * np.eye(6)) + 0.01j * omega * M
    W = (
        (1 + 0.1**2) * K
        + (1 + 0.03**2) * 2 * D
        + omega**2 * (M + 0.5 * np.eye(6))
        + 0.01 * omega * M
    )
    broken = Z @ values[0, :, 0] - np.eye(6)[0]
    expected = 0.5 * (broken.conj() @ np.linalg.solve(W, broken)).real
    error = ConstitutiveError(np.zeros((1, 6)), 1.0)
    assert cost(problem, error, np.zeros(1)) == pytest.approx(expected)


def test_with_little_weight_it_is_the_output_error(small):
    _, problem, *_ = small
    error = _make_residual(problem, 1e-7)
    x = problem.coordinates.to_x(problem.coordinates.parameters.start) + 0.05
    misfit = problem.responses(x) - problem.frf.values
    expected = 0.5 * np.sum(np.abs(misfit) ** 2 / error.slack[:, :, None]) / error.level**2
    assert cost(problem, error, x) == pytest.approx(expected, rel=1e-4)


def test_tiers_agree(small):
    model, problem, *_ = small
    other = FRFPart.build(
        model, problem.frf, problem.coordinates.parameters, tier="sparse", backend="superlu"
    )
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    error = _make_residual(problem, 0.5)
    assert _make_residual(other, 0.5).slack == pytest.approx(error.slack)
    a, b = reduce_cached(error, problem, x), reduce_cached(error, other, x)
    assert b.cost == pytest.approx(a.cost)
    assert b.gradient == pytest.approx(a.gradient)


# -- the method --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("weight", [0.1, 0.5, 0.9])
def test_exact_data_give_the_chain_exactly(chain12, chain12_true, weight):
    sensors = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
    frf = updyn.response(
        chain12_true, np.linspace(2.0, 22.0, 60), sensors, sensors[:2], "accelerance"
    )
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(chain12, frf, unknowns, method="constitutive", weight=weight)
    assert result.status == "converged", result.message
    for name, value in result.values.items():
        group, quantity = name.split(".")
        true, start = chain12_true.group(group), chain12.group(group)
        exact = true.loss_factor
        if quantity != "loss_factor":
            exact = abs(getattr(true, quantity)).sum() / abs(getattr(start, quantity)).sum()
        assert value == pytest.approx(exact, rel=1e-6), name
    assert {h.stage for h in result.history} == {"constitutive"}


def test_exact_data_give_the_gear_train_from_its_start():
    start, true = starting_model(), true_model()
    omega = np.array([5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0])
    frf = updyn.response(true, omega / (2.0 * np.pi), [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(start, frf, unknowns, method="constitutive", max_iterations=400)
    found = updyn.response(result.model, omega / (2.0 * np.pi), frf.responses, frf.references)
    assert result.status == "converged", result.message
    assert found.values == pytest.approx(frf.values, rel=1e-6)


def test_noise_shows_and_more_weight_on_the_measurement_biases_it(chain12_true, add_noise):
    """As r goes to 1 the measured motion is taken as exact: an equation error, with its bias."""
    sensors = chain12_true.dofs.labels
    exact = updyn.response(chain12_true, np.linspace(2.0, 22.0, 60), sensors, sensors[:1])
    frf = add_noise(exact, RNG(3), 0.02)
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    errors = {}
    for weight in (0.05, 1.0):
        result = updyn.update(chain12_true, frf, unknowns, method="constitutive", weight=weight)
        errors[weight] = max(abs(v - 1.0) for v in result.values.values())
    assert errors[0.05] < 0.01
    assert errors[1.0] > 3.0 * errors[0.05]
    assert "use maximum likelihood for noisy data" in result.remedy


def test_several_tests_at_once(chain12, chain12_true):
    sensors = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
    heavy = {"part4": {"mass": 1.5}}
    freq = np.linspace(2.0, 22.0, 40)
    a = updyn.response(chain12_true, freq, sensors, sensors[:1])
    b = updyn.response(chain12_true.scaled(heavy), freq, sensors[:3], sensors[:2])
    base = chain12_true.scaled({"part1": {"stiffness": 0.9}, "part3": {"stiffness": 1.15}})
    tests = [updyn.Test(base, a, "bare"), updyn.Test(base.scaled(heavy), b, "loaded")]
    result = updyn.update_jointly(
        tests, updyn.parameters(base, stiffness="all"), method="constitutive"
    )
    assert result.status == "converged"
    assert result.values["part1.stiffness"] == pytest.approx(1.0 / 0.9)
    assert result.values["part3.stiffness"] == pytest.approx(1.0 / 1.15)


def test_priors_count(chain12_true):
    sensors = [f"{i}:X" for i in (2, 5, 12)]
    start = chain12_true.scaled({"part1": {"stiffness": 0.9}})
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 40), sensors, sensors[:1])
    held = updyn.parameters(
        start, stiffness=["part1", "part2"], prior_std={"part1.stiffness": 1e-12}
    )
    result = updyn.update(start, frf, held, method="constitutive")
    assert result.values["part1.stiffness"] == pytest.approx(1.0, abs=1e-6)


def test_a_user_may_stop_it(chain12_true):
    sensors = [f"{i}:X" for i in (2, 5, 12)]
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 40), sensors, sensors[:1])
    start = chain12_true.scaled({"part1": {"stiffness": 0.9}})
    unknowns = updyn.parameters(start, stiffness="all")
    seen = []

    def stop(progress):
        seen.append(progress.stage)
        return len(seen) > 3

    result = updyn.update(start, frf, unknowns, method="constitutive", callback=stop)
    assert result.status == "stopped"
    assert set(seen) <= {"constitutive", "start", "judge"}


def test_what_it_cannot_do_is_refused(chain12_true):
    sensors = ["2:X", "12:X"]
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    still = updyn.response(chain12_true, [0.0, 2.0, 5.0], sensors, sensors, "accelerance")
    with pytest.raises(
        DataError, match="constitutive: the 0 Hz line of accelerance holds no receptance"
    ):
        updyn.update(chain12_true, still, unknowns, method="constitutive")
    frf = updyn.response(chain12_true, [2.0, 5.0], sensors, sensors)
    for weight in (0.0, 1.5):
        with pytest.raises(
            OptionError, match="the weight of the measurement is above 0 and at most 1"
        ):
            updyn.update(chain12_true, frf, unknowns, method="constitutive", weight=weight)
    with pytest.raises(OptionError, match="tier 'reduced' does not compute the fields of all DOFs"):
        updyn.update(chain12_true, frf, unknowns, method="constitutive", tier="reduced")
