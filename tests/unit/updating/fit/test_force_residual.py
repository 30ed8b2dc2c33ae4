"""Force residual: expansion and sums of squares against dense least squares, recovery, bias, refusals."""

from itertools import pairwise

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, OptionError
from updyn.updating.fit.methods.force_residual import ForceResidual, _compliance
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.residuals import reduce_cached

RNG = np.random.default_rng


@pytest.fixture(scope="module")
def small():
    """Six DOFs, one of them a rotation; three responses, two references, three lines; data that fit no model."""
    rng = RNG(4)
    K, M = (a @ a.T + np.eye(6) for a in rng.standard_normal((2, 6, 6)))
    stiff = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 3.0])
    K *= stiff[:, None] * stiff
    groups = {
        "a": updyn.Group(K, M, loss_factor=0.1),
        "b": updyn.Group(np.eye(6), viscous=0.01 * M),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X", "4:X", "5:X", "5:RZ"])
    values = 0.3 * (rng.standard_normal((3, 3, 2)) + 1j * rng.standard_normal((3, 3, 2)))
    frf = updyn.FRF([0.1, 0.23, 0.4], values, ["1:X", "3:-X", "5:X"], ["1:X", "2:X"], "mobility")
    unknowns = updyn.parameters(model, stiffness="all", mass="a", loss_factor="a", viscous="b")
    return K, M, FRFPart.build(model, frf, unknowns)


def dense(K, M, problem, compliance, values):
    """Return sum of least squares over expanded motions, and its slopes by the unknowns with the motion held."""
    (ka, ma, ga), (kb, cb) = values[:3], values[3:]  # order of the unknowns: see below
    total, slopes = 0.0, np.zeros(5)
    rows, sign = [0, 2, 4], np.array([1.0, -1.0, 1.0])
    hidden = [1, 3, 5]
    weight = 1.0 / np.sqrt(compliance)[:, None]
    for k, f in enumerate(problem.frf.freq):
        w = 2.0 * np.pi * f
        parts = [(1 + 1j * ga) * K, -(w**2) * M, 1j * ka * K, np.eye(6), 0.01j * w * M]
        Z = ka * parts[0] + ma * parts[1] + kb * parts[3] + cb * parts[4]
        for j in range(2):
            h = np.zeros(6, dtype=complex)
            h[rows] = problem.frf.values[k, :, j] * sign / (1j * w)
            force = np.eye(6)[j]
            h[hidden] = np.linalg.lstsq(
                (weight * Z)[:, hidden], weight[:, 0] * (force - Z @ h), rcond=None
            )[0]
            r = weight[:, 0] * (Z @ h - force)
            total += 0.5 * np.sum(np.abs(r) ** 2)
            slopes += [(r.conj() @ (weight[:, 0] * (A @ h))).real for A in parts]
    return total, slopes


def test_the_expanded_motion_leaves_the_least_force(small):
    K, M, problem = small
    assert problem.coordinates.parameters.names == [
        "a.mass", "a.stiffness", "a.loss_factor", "b.stiffness", "b.viscous",
    ]  # fmt: skip
    x = problem.coordinates.to_x(problem.coordinates.parameters.start) + 0.1 * RNG(
        1
    ).standard_normal(5)
    ma, ka, ga, kb, cb = problem.values(x)
    compliance = _compliance(problem)
    assert compliance[:5].tolist() == [1.0] * 5
    assert compliance[5] == pytest.approx((K[5, 5] + 1.0) / np.median(np.diag(K)[:5] + 1.0))
    total, (dk, dm, dg, dkb, dcb) = dense(K, M, problem, compliance, [ka, ma, ga, kb, cb])
    residual = ForceResidual(compliance, 2.0)
    expected = np.array([dm, dk, dg, dkb, dcb]) * problem.coordinates.slope(x) / 4.0
    for form in (
        residual,
        residual.condensed_error,
    ):  # the motion held or eliminated: the slopes are the same
        local = reduce_cached(form, problem, x)
        assert local.cost == pytest.approx(total / 4.0)
        assert local.gradient == pytest.approx(expected)


def test_with_all_measured_it_is_the_equation_error(chain12_true, add_noise):
    sensors = chain12_true.dofs.labels
    frf = add_noise(
        updyn.response(chain12_true, [2.0, 5.0, 9.0], sensors, sensors[:2]), RNG(0), 0.05
    )
    problem = FRFPart.build(chain12_true, frf, updyn.parameters(chain12_true, stiffness="all"))
    local = reduce_cached(ForceResidual(np.ones(12), 1.0), problem, np.zeros(4))
    K, M = chain12_true.stiffness.toarray(), chain12_true.mass.toarray()
    lossy = sum(g.loss_factor * g.stiffness.toarray() for g in chain12_true.groups.values())
    total = 0.0
    for f, h in zip(frf.freq, frf.values, strict=True):
        total += 0.5 * np.sum(
            np.abs((K + 1j * lossy - (2 * np.pi * f) ** 2 * M) @ h - np.eye(12)[:, :2]) ** 2
        )
    assert local.cost == pytest.approx(total)


# -- the method ----------------------------------------------------------------------------------------------------
def off(true):
    """The chain 10 to 25 % off its true values."""
    stiffness, mass = (0.9, 1.2, 0.85, 1.1), (1.1, 0.9, 1.05, 0.95)
    return true.scaled(
        {f"part{i + 1}": {"stiffness": stiffness[i], "mass": mass[i]} for i in range(4)}
    )


def check(result, rel):
    assert result.status == "converged", result.message
    stiffness, mass = (0.9, 1.2, 0.85, 1.1), (1.1, 0.9, 1.05, 0.95)
    for i in range(4):
        assert result.values[f"part{i + 1}.stiffness"] == pytest.approx(1.0 / stiffness[i], rel=rel)
        assert result.values[f"part{i + 1}.mass"] == pytest.approx(1.0 / mass[i], rel=rel)


def test_with_all_measured_one_solve_is_exact(chain12_true):
    sensors = chain12_true.dofs.labels
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 30), sensors, sensors[:2])
    start = off(chain12_true)
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(start, frf, unknowns, method="force-residual")
    check(result, 1e-9)
    assert result.iterations <= 3
    assert {h.stage for h in result.history} == {"force-residual"}


@pytest.mark.parametrize("solver", ["alternating", "trust-region"])
def test_most_of_the_chain_measured(chain12_true, solver):
    sensors = [label for label in chain12_true.dofs.labels if label not in ("4:X", "9:X")]
    frf = updyn.response(
        chain12_true, np.linspace(2.0, 22.0, 30), sensors, sensors[:2], "accelerance"
    )
    start = off(chain12_true)
    result = updyn.update(
        start,
        frf,
        updyn.parameters(start, stiffness="all", mass="all"),
        method="force-residual",
        solver=solver,
    )
    check(result, 1e-6)
    costs = [h.cost for h in result.history if h.accepted]
    assert all(b <= a * (1 + 1e-9) for a, b in pairwise(costs))


def test_the_motion_eliminated_takes_far_fewer_steps(chain12_true):
    sensors = [label for label in chain12_true.dofs.labels if label not in ("4:X", "9:X")]
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 30), sensors, sensors[:2])
    start = off(chain12_true)
    unknowns = updyn.parameters(start, stiffness="all", mass="all")
    slow, fast = (
        updyn.update(start, frf, unknowns, method="force-residual", solver=s)
        for s in ("alternating", "trust-region")
    )
    assert fast.iterations < 0.5 * slow.iterations


def test_noise_biases_it_as_an_equation_error(chain12_true, add_noise):
    """More data do not help: the mean over draws is off by many times its own scatter, and by more than the spread."""
    sensors = chain12_true.dofs.labels
    exact = updyn.response(chain12_true, np.linspace(2.0, 22.0, 60), sensors, sensors[:2])
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    found = np.array(
        [
            list(
                updyn.update(
                    chain12_true,
                    add_noise(exact, RNG(seed), 0.05),
                    unknowns,
                    method="force-residual",
                ).values.values()
            )
            for seed in range(8)
        ]
    )
    bias, scatter = found.mean(axis=0) - 1.0, found.std(axis=0)
    assert np.abs(bias).max() > 0.02
    assert (np.abs(bias) / scatter).max() > 5.0
    assert (bias < 0.0).all()  # motion with noise asks for less stiffness


def test_several_tests_and_priors(chain12_true):
    sensors = chain12_true.dofs.labels
    freq = np.linspace(2.0, 22.0, 20)
    heavy = {"part4": {"mass": 1.5}}
    base = chain12_true.scaled({"part1": {"stiffness": 0.9}})
    tests = [
        updyn.Test(base, updyn.response(chain12_true, freq, sensors, sensors[:1]), "bare"),
        updyn.Test(
            base.scaled(heavy),
            updyn.response(chain12_true.scaled(heavy), freq, sensors[:10], sensors[:1]),
            "loaded",
        ),
    ]
    result = updyn.update_jointly(
        tests, updyn.parameters(base, stiffness="all"), method="force-residual"
    )
    assert result.values["part1.stiffness"] == pytest.approx(1.0 / 0.9, rel=1e-6)
    held = updyn.parameters(base, stiffness="all", prior_std={"stiffness": 0.1})
    with pytest.raises(OptionError, match="does not support priors"):
        updyn.update_jointly(tests, held, method="force-residual")
    result = updyn.update_jointly(tests, held, method="force-residual", solver="trust-region")
    assert result.status == "converged"


def test_a_user_may_stop_it(chain12_true):
    sensors = chain12_true.dofs.labels[:8]
    frf = updyn.response(chain12_true, np.linspace(2.0, 22.0, 20), sensors, sensors[:1])
    start = off(chain12_true)
    unknowns = updyn.parameters(start, stiffness="all")
    seen = []

    def stop(progress):
        seen.append(progress.iteration)
        return len(seen) > 5

    assert (
        updyn.update(start, frf, unknowns, method="force-residual", callback=stop).status
        == "stopped"
    )


def test_what_it_cannot_do_is_refused(chain12_true):
    sensors = ["2:X", "12:X"]
    unknowns = updyn.parameters(chain12_true, stiffness="all")
    still = updyn.response(chain12_true, [0.0, 2.0, 5.0], sensors, sensors, "accelerance")
    with pytest.raises(
        DataError, match="force-residual: the 0 Hz line of accelerance holds no receptance"
    ):
        updyn.update(chain12_true, still, unknowns, method="force-residual")
    frf = updyn.response(chain12_true, [2.0, 5.0], sensors, sensors)
    with pytest.raises(OptionError, match=r"solver 'alternate'.*alternating"):
        updyn.update(chain12_true, frf, unknowns, method="force-residual", solver="alternate")
    with pytest.raises(OptionError, match="tier 'reduced' does not compute the motion of all DOFs"):
        updyn.update(chain12_true, frf, unknowns, method="force-residual", tier="reduced")
