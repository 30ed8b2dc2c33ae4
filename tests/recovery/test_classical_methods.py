"""Classical FRF methods: exact where their assumptions hold, wrong where theory says so."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.demos.gear_train import starting_model, true_model
from updyn.updating.fit.methods.reduced_frf import reduce_independently
from updyn.updating.problem.problem import FRFPart

#: Biased methods leave a residual on purpose, whose causes other tests seek.
pytestmark = pytest.mark.usefixtures("no_causes")

EVERY = {"stiffness": "all", "mass": "all", "loss_factor": "all"}
SEVEN = [f"{i}:RZ" for i in range(1, 8)]
PAPER = np.array([10.0, 20.0, 50.0, 100.0]) / (2 * np.pi)
EIGHT = np.array([5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0]) / (2 * np.pi)


def truth_of(true, start, unknowns):
    return np.array([
        true.group(p.group).loss_factor
        if p.quantity == "loss_factor"
        else abs(getattr(true.group(p.group), p.quantity)).sum() / abs(getattr(start.group(p.group), p.quantity)).sum()
        for p in unknowns
    ])  # fmt: skip


def vector(result):
    return np.array([result.values[n] for n in result.parameters.names])


def gear_train(freq, reading, sensors=SEVEN):
    true, start = true_model(), starting_model(reading)
    unknowns = updyn.parameters(start, **EVERY)
    return (
        start,
        updyn.response(true, freq, sensors, ["2:RZ"]),
        unknowns,
        truth_of(true, start, unknowns),
    )


@pytest.fixture(scope="module")
def full(chain12_true, chain12_frf):
    """The chain measured on all of its DOFs, at every second line."""
    return updyn.response(
        chain12_true,
        chain12_frf.freq[::2],
        [f"{i}:X" for i in range(1, 13)],
        ["2:X", "5:X", "12:X"],
    )


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, **EVERY)


@pytest.fixture(scope="module")
def truth(chain12, chain12_true, unknowns):
    return truth_of(chain12_true, chain12, unknowns)


@pytest.fixture(scope="module")
def rightly_damped(chain12, chain12_true):
    """The start of the chain with the true loss factors."""
    return chain12.scaled(
        {g: {"loss_factor": chain12_true.group(g).loss_factor} for g in chain12.groups}
    )


# -- the response function method, full coordinates ------------------------------------------------------------------
def test_one_solve_finds_mass_spring_and_loss_of_an_oscillator():
    """H = 1 / (k (1 + i eta) - omega^2 m), from its formula; two lines, three unknowns."""
    k, m, eta, freq = 3.0e4, 1.7, 0.08, np.array([9.0, 26.0])
    H = 1.0 / (k * (1 + 1j * eta) - (2 * np.pi * freq) ** 2 * m)
    start = updyn.Model.from_groups(
        {"spring": updyn.Group([[1.0e4]], loss_factor=0.01), "mass": updyn.Group(mass=[[1.0]])},
        ["1:X"],
    )
    chosen = updyn.parameters(start, stiffness="spring", mass="mass", loss_factor="spring")
    data = updyn.FRF(freq, H[:, None, None], ["1:X"], ["1:X"], "receptance")
    result = updyn.update(start, data, chosen, method="complex-rfm")
    assert result.status == "converged"
    assert result.iterations == 2  # the second only sees that there is nothing left
    assert result.values == pytest.approx(
        {"spring.stiffness": 3.0, "mass.mass": 1.7, "spring.loss_factor": eta}, rel=1e-12
    )
    first = result.history[1].values
    assert first == pytest.approx(result.values, rel=1e-12)


@pytest.mark.parametrize("reading", [0, 1])
def test_all_seven_degrees_of_freedom_give_the_gear_train_in_one_solve(reading):
    """The paper's four lines determine all 18 unknowns once nothing is condensed out."""
    start, data, chosen, exact = gear_train(PAPER, reading)
    result = updyn.update(start, data, chosen, method="complex-rfm")
    assert result.status == "converged"
    assert result.identifiability.rank == 18
    assert result.iterations == 2
    assert vector(result) == pytest.approx(exact, rel=1e-9, abs=1e-9)


def test_real_form_is_exact_with_the_right_damping_and_wrong_with_another(
    chain12, full, rightly_damped, chain12_true
):
    """Lin & Ewins' equation has no unknown for damping: what is wrong with it goes into mass and stiffness."""
    off = []
    for start in (rightly_damped, chain12):
        chosen = updyn.parameters(start, stiffness="all", mass="all")
        result = updyn.update(start, full, chosen, method="rfm")
        assert result.status == "converged"
        off.append(np.abs(vector(result) - truth_of(chain12_true, start, chosen)).max())
    assert off[0] < 1e-12
    assert off[1] > 1e-3


def test_complex_form_finds_the_damping_too(chain12, full, unknowns, truth):
    result = updyn.update(chain12, full, unknowns, method="complex-rfm")
    assert result.status == "converged"
    assert vector(result) == pytest.approx(truth, rel=1e-11)
    guarded = updyn.update(chain12, full, unknowns, method="complex-rfm", solver="trust-region")
    assert guarded.status == "converged"
    assert vector(guarded) == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_throws_off_all_that_multiply_with_the_measured_motion(
    chain12, full, unknowns, truth, rightly_damped, chain12_true, add_noise, seed
):
    """1 % noise: the classical equations miss by many of their own standard deviations, maximum likelihood does not."""
    data = add_noise(full, np.random.default_rng(seed), 0.01)
    real = updyn.parameters(rightly_damped, stiffness="all", mass="all")
    missed = {}
    for name, start, chosen in (
        ("rfm", rightly_damped, real),
        ("complex-rfm", chain12, unknowns),
        ("reduced-frf", chain12, unknowns),
        ("maximum-likelihood", chain12, unknowns),
    ):
        options = {"separate": False} if name == "reduced-frf" else {}
        result = updyn.update(start, data, chosen, method=name, **options)
        std = np.array(list(result.std.values()))
        error = np.abs(vector(result) - truth_of(chain12_true, start, chosen))
        missed[name] = (error / std).max(), error[chosen.is_factor].max()
    assert missed["rfm"][0] > 8
    assert missed["complex-rfm"][0] > 8
    assert missed["reduced-frf"][0] > 8
    assert missed["maximum-likelihood"][0] < 4
    assert (
        min(missed[n][1] for n in missed if n != "maximum-likelihood")
        > 5 * missed["maximum-likelihood"][1]
    )


@pytest.mark.parametrize("n_lines", [500, 2_000])
def test_bias_is_as_derived_and_more_data_do_not_help(n_lines):
    """An oscillator, h_X = H (1 + s n), only its stiffness unknown.

    The plain iteration ends where the sum of Re conj(J) r is 0, with J = -H_A a h_X, r = H_A - h_X
    and a = k (1 + i eta). In the mean and to second order in s that is at a change of the factor of
    -s^2 sum |H|^2 Re conj(a H) / sum |a|^2 |H|^4.
    """
    k, eta, s, freq = 1.0e4, 0.1, 0.2, np.linspace(2.0, 12.0, n_lines)
    a = k * (1 + 1j * eta)
    H = 1.0 / (a - (2 * np.pi * freq) ** 2)
    bias = -(s**2) * np.sum(abs(H) ** 2 * (a * H).real) / np.sum(abs(a) ** 2 * abs(H) ** 4)
    noise = np.random.default_rng(4).standard_normal((2, n_lines))
    h = H * (1 + s * np.sqrt(0.5) * (noise[0] + 1j * noise[1]))
    start = updyn.Model.from_groups({"a": updyn.Group([[k]], [[1.0]], loss_factor=eta)}, ["1:X"])
    data = updyn.FRF(freq, h[:, None, None], ["1:X"], ["1:X"], "receptance")
    chosen = updyn.parameters(start, stiffness="a")
    error, std = {}, {}
    for name in ("rfm", "maximum-likelihood"):
        result = updyn.update(start, data, chosen, method=name)
        error[name], std[name] = result.values["a.stiffness"] - 1.0, result.std["a.stiffness"]
    assert error["rfm"] == pytest.approx(bias, rel=0.25)
    assert abs(error["rfm"]) > 4 * std["rfm"]
    assert abs(error["maximum-likelihood"]) < 3 * std["maximum-likelihood"]


# -- unmeasured coordinates from the model ---------------------------------------------------------------------------
@pytest.mark.parametrize("reading", [0, 1])
def test_missing_motion_from_the_model_finds_the_gear_train_from_the_papers_sensors(reading):
    start, data, chosen, exact = gear_train(EIGHT, reading, SEVEN[:4])
    result = updyn.update(start, data, chosen, method="complex-rfm", expand=True)
    assert result.status == "converged"
    assert vector(result) == pytest.approx(exact, rel=1e-8, abs=1e-8)
    assert result.iterations > 3  # no longer one solve


def test_missing_motion_from_the_model_is_what_may_diverge(chain12, chain12_frf, unknowns, truth):
    """Two of twelve DOFs measured: the plain iteration breaks down, steps held in a trust region arrive."""
    data = chain12_frf.select(responses=["2:X", "12:X"], references=["2:X"])
    plain = updyn.update(chain12, data, unknowns, method="complex-rfm", expand=True)
    assert plain.status == "failed"
    assert "Use solver='trust-region'" in plain.remedy
    guarded = updyn.update(
        chain12, data, unknowns, method="complex-rfm", expand=True, solver="trust-region"
    )
    assert guarded.status == "converged"
    assert vector(guarded) == pytest.approx(truth, rel=1e-9)


# -- the FRF sensitivity method --------------------------------------------------------------------------------------
def test_plain_sensitivity_needs_a_close_start(chain12, chain12_true, chain12_frf, truth, unknowns):
    close = chain12_true.scaled(
        {g: {"stiffness": 1.004, "mass": 0.997} for g in chain12_true.groups}
    )
    chosen = updyn.parameters(close, **EVERY)
    near = updyn.update(close, chain12_frf, chosen, method="frf-sensitivity")
    assert near.status == "converged"
    assert vector(near) == pytest.approx(truth_of(chain12_true, close, chosen), rel=1e-9)
    far = updyn.update(chain12, chain12_frf, unknowns, method="frf-sensitivity")
    assert far.status == "failed"
    assert "would become negative" in far.message
    assert "halving=True" in far.remedy
    assert np.isfinite(vector(far)).all()
    halved = updyn.update(chain12, chain12_frf, unknowns, method="frf-sensitivity", halving=True)
    assert halved.status == "converged"
    assert vector(halved) == pytest.approx(truth, rel=1e-9)


def test_sensitivity_ends_where_output_error_does(chain12_true, chain12_frf, add_noise):
    """The same residual: the same minimum and standard deviations. Only the way there differs."""
    close = chain12_true.scaled(
        {g: {"stiffness": 1.004, "mass": 0.997} for g in chain12_true.groups}
    )
    chosen = updyn.parameters(close, **EVERY)
    data = add_noise(chain12_frf, np.random.default_rng(5), floor=0.01)
    one, two = (
        updyn.update(close, data, chosen, method=m) for m in ("frf-sensitivity", "output-error")
    )
    assert one.status == two.status == "converged"
    assert vector(one) == pytest.approx(vector(two), rel=1e-7)
    assert list(one.std.values()) == pytest.approx(list(two.std.values()), rel=1e-5)


# -- the independently reduced method --------------------------------------------------------------------------------
def spring(i, j, k, n=5):
    K = np.zeros((n, n))
    K[j, j] = k
    if i >= 0:
        K[i, i], K[i, j], K[j, i] = k, -k, -k
    return K


def small_chain(*, between: bool = False, inertia: float = 0.0):
    """Wall-1-2 (a), 2-3-4 (b), 4-5 (c), with masses at 2, 4 and 5, which are measured.

    `between` puts the border of a and b at DOF 1, which is eliminated; `inertia` gives DOFs 1 and 3
    a mass."""
    held, second = spring(-1, 0, 1e4), spring(0, 1, 2e4)
    stiffness = {
        "a": held if between else held + second,
        "b": spring(1, 2, 1.5e4) + spring(2, 3, 1e4) + (second if between else 0.0),
        "c": spring(3, 4, 1.2e4),
    }
    mass = {
        "a": np.diag([inertia, 1, 0, 0, 0]),
        "b": np.diag([0, 0, inertia, 2, 0]),
        "c": np.diag([0.0, 0, 0, 0, 1.5]),
    }
    groups = {g: updyn.Group(stiffness[g], mass[g], loss_factor=0.02) for g in stiffness}
    start = updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 6)])
    true = start.scaled({
        "a": {"stiffness": 1.3, "mass": 0.8, "loss_factor": 0.05},
        "b": {"stiffness": 0.7, "mass": 1.2, "loss_factor": 0.01},
        "c": {"stiffness": 1.1, "mass": 1.1, "loss_factor": 0.03},
    })  # fmt: skip
    return start, true


def reduced_error(start, true, freq, method="reduced-frf", **options):
    chosen = updyn.parameters(start, **EVERY)
    data = updyn.response(true, freq, ["2:X", "4:X", "5:X"], ["5:X"])
    result = updyn.update(start, data, chosen, method=method, **options)
    assert result.status == "converged"
    return float(np.abs(vector(result) - truth_of(true, start, chosen)).max())


LINES = np.linspace(1, 35, 40)


def test_fixed_transformation_is_exact_where_nothing_that_it_misses_is_eliminated():
    """DOFs 1 and 3 have no inertia and belong to one group each: static condensation is exact, whatever changes."""
    start, true = small_chain()
    assert reduced_error(start, true, LINES, separate=False) < 1e-12
    assert reduced_error(start, true, LINES) < 1e-7  # the separate steps end up there, slowly


def test_fixed_transformation_misses_inertia_and_changed_stiffness_without_any_noise():
    """What the paper criticises, in numbers. The condensed equation error has no such bias."""
    for case in ({"between": True}, {"inertia": 0.2}):
        start, true = small_chain(**case)
        assert reduced_error(start, true, LINES, separate=False) > 0.01
        assert reduced_error(start, true, LINES, "equation-error") < 1e-12


def test_bias_falls_towards_the_frequency_of_the_transformation():
    start, true = small_chain(inertia=0.2)
    wide = reduced_error(start, true, LINES, separate=False)
    low = np.linspace(1, 10, 40)
    static = reduced_error(start, true, low, separate=False)
    inside = reduced_error(start, true, low, separate=False, frequency=6.0)
    assert wide > 1.5 * static > 1.5 * 1.5 * inside > 1e-3


def test_fixed_transformation_is_far_off_on_the_chain(chain12, chain12_frf, unknowns, truth):
    """Five of twelve DOFs, lines up to the sixth mode, no noise."""
    result = updyn.update(chain12, chain12_frf, unknowns, method="reduced-frf", separate=False)
    error = np.abs(vector(result) - truth)
    assert error[unknowns.is_factor].max() > 0.5
    assert error[~unknowns.is_factor].max() > 0.05
    exact = updyn.update(chain12, chain12_frf, unknowns, method="equation-error")
    assert vector(exact) == pytest.approx(truth, rel=1e-9)


def test_nothing_is_missed_where_all_is_measured(chain12, full, unknowns, truth):
    joint = updyn.update(chain12, full, unknowns, method="reduced-frf", separate=False)
    assert (
        joint.iterations == 2
    )  # the reduced equation is linear: the second step sees that nothing is left
    assert vector(joint) == pytest.approx(truth, rel=1e-11)
    separate = updyn.update(chain12, full, unknowns, method="reduced-frf")
    assert separate.status == "converged"
    assert separate.iterations > 50  # mass and stiffness in turn
    assert vector(separate) == pytest.approx(truth, rel=1e-6)


@pytest.mark.parametrize("frequency", [0.0, 7.5])
@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_reduced_model_is_the_exact_condensation_at_its_own_frequency(chain12, frequency, tier):
    sensors = ["2:X", "5:-X", "12:X"]
    undamped = chain12.scaled({g: {"loss_factor": 0.0} for g in chain12.groups})
    chosen = updyn.parameters(undamped, stiffness="all", mass="all")
    lines = [frequency, frequency + 4.0]
    data = updyn.response(undamped, lines, sensors, ["5:X"])
    problem = FRFPart.build(undamped, data, chosen, tier=tier)
    x = problem.coordinates.to_x(chosen.start)
    small = reduce_independently(problem, x, frequency)
    H = small.block(x, slice(0, 2), derivatives=False).H
    assert H[0] == pytest.approx(data.values[0], rel=1e-10)
    assert np.abs(H[1] / data.values[1] - 1.0).max() > 1e-3
