"""Classical FRF methods: what they refuse, how they iterate and end, and what must not matter to them."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, OptionError, ParameterError, SolverError
from updyn.group import LossTable
from updyn.updating.fit.methods import METHODS, make_method
from updyn.updating.fit.methods.linear import Amounts, PlainIteration, basic_solution
from updyn.updating.fit.methods.reduced_frf import _step_in_turn
from updyn.updating.fit.methods.rfm import ResponseEquation
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.local import Local
from updyn.updating.problem.problem import FRFPart, Problem

EVERY = {"stiffness": "all", "mass": "all", "loss_factor": "all"}
ALL = [f"{i}:X" for i in range(1, 13)]
NAMES = ["rfm", "complex-rfm", "frf-sensitivity", "reduced-frf"]


@pytest.fixture(scope="module")
def full(chain12_true, chain12_frf):
    return updyn.response(chain12_true, chain12_frf.freq[::3], ALL, ["2:X", "12:X"])


@pytest.fixture(scope="module")
def close(chain12_true):
    """So close to the truth that every one of them arrives."""
    return chain12_true.scaled(
        {g: {"stiffness": 1.003, "mass": 0.998} for g in chain12_true.groups}
    )


def chosen(model, name):
    """The unknowns that a method can update."""
    return updyn.parameters(
        model, **{q: v for q, v in EVERY.items() if q not in METHODS.find(name).cannot}
    )


def run(model, data, name, **options):
    if name == "reduced-frf":
        options.setdefault("separate", False)
    return updyn.update(model, data, chosen(model, name), method=name, **options)


def vector(result):
    return np.array([result.values[n] for n in result.parameters.names])


def outcome(result):
    return result.status, result.values, result.std, [h.values for h in result.history]


# -- amounts ---------------------------------------------------------------------------------------------------------
def test_stiffness_and_its_loss_factor_are_a_pair(chain12):
    both = updyn.parameters(
        chain12, stiffness=["part1", "part3"], mass="all", loss_factor=["part3", "part4"]
    )
    pair = both.names.index("part3.stiffness"), both.names.index("part3.loss_factor")
    assert Amounts.find(both).pairs == (pair,)


def test_a_loss_factor_of_a_linked_stiffness_is_a_pair_only_where_the_law_is_linear(chain12):
    loss = updyn.parameters(chain12, loss_factor=["part1"])
    for power, pairs in ((1.0, ((1, 0),)), (3.0, ())):
        linked = updyn.link(
            chain12, "plate.thickness", {"part1.stiffness": power, "part2.stiffness": 1.0}
        )
        assert Amounts.find(loss + linked).pairs == pairs


def test_columns_are_derivatives_by_the_amounts_and_moves_go_along_them():
    """f(kappa, gamma) = (kappa, kappa gamma) is linear in the amounts: derivatives constant, a move exact."""
    amounts, values = Amounts(((0, 1),)), np.array([2.0, 0.3])
    J = np.array([[1.0, 0.0], [values[1], values[0]]])
    assert amounts.transform_jacobian(J, values) == pytest.approx(np.eye(2), abs=1e-15)
    moved = amounts.apply_change(values, np.array([1.0, 0.6]))
    assert moved == pytest.approx([3.0, 0.4])


def test_basic_solution_leaves_what_is_not_determined():
    A = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    found = basic_solution(A, np.array([3.0, 4.0]))
    assert A @ found == pytest.approx([3.0, 4.0])
    assert (found[:2] == 0.0).sum() == 1
    assert not basic_solution(np.zeros((2, 2)), np.ones(2)).any()


@pytest.mark.parametrize("seed", range(8))
def test_which_of_two_parallel_columns_is_used_does_not_depend_on_rounding(seed):
    rng = np.random.default_rng(seed)
    A = np.random.default_rng(99).standard_normal((20, 5))
    A[:, 3] = A[:, 1]
    A = A / np.linalg.norm(A, axis=0) * (1.0 + 1e-14 * rng.standard_normal(A.shape))
    found = basic_solution(A, np.arange(20.0))
    assert found[3] == 0.0
    assert found[1] != 0.0


def test_separate_steps_are_taken_in_turn(chain12, full):
    """Stiffness first, mass with the stiffness found, damping with both (Gauss-Seidel, not Jacobi)."""
    problem = FRFPart.build(
        chain12,
        full,
        updyn.parameters(chain12, mass=["part1"], stiffness=["part1"], loss_factor=["part2"]),
    )
    A = np.array([[3.0, 1.0, 0.5], [1.0, 4.0, 1.0], [0.5, 2.0, 2.0]])
    b = np.array([0.1, 0.2, 0.3])
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    start = problem.coordinates.parameters.start
    names = problem.coordinates.parameters.names
    kappa, mu, gamma = (
        names.index(name) for name in ("part1.stiffness", "part1.mass", "part2.loss_factor")
    )
    wanted, left = np.zeros(3), b.copy()
    for i in (kappa, mu, gamma):
        wanted[i] = A[:, i] @ left / (A[:, i] @ A[:, i])
        left -= A[:, i] * wanted[i]
    found = _step_in_turn(
        problem, Amounts(()), Local(0.0, A, -b), x
    )  # at factors of 1, derivatives by x and by values agree
    assert found - start == pytest.approx(wanted, rel=1e-12)


# -- the equation ----------------------------------------------------------------------------------------------------
def test_the_identity_holds_for_a_change_of_any_size(chain12, chain12_true, full):
    """H_A - H_X = H_A (Z_X - Z_A) H_X, line by line, with Z from the matrices."""
    problem = FRFPart.build(chain12, full, chosen(chain12, "complex-rfm"))
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    r, J = ResponseEquation("rfm").block(problem, x, slice(0, 3))
    for i, omega in enumerate(2 * np.pi * full.freq[:3]):
        Z = []
        for model in (chain12, chain12_true):
            D = sum(g.loss_factor * g.stiffness.toarray() for g in model.groups.values())
            Z.append(model.stiffness.toarray() + 1j * D - omega**2 * model.mass.toarray())
        H = np.linalg.solve(Z[0], np.eye(12))
        level = np.sqrt(np.mean(np.abs(full.values) ** 2))
        assert r[i] == pytest.approx(H @ (Z[1] - Z[0]) @ full.values[i] / level, rel=1e-9)
        name = "part2.stiffness"
        at, K = (
            problem.coordinates.parameters.names.index(name),
            chain12.group("part2").stiffness.toarray(),
        )
        assert J[at, i] == pytest.approx(-(1 + 0.03j) * H @ K @ full.values[i] / level, rel=1e-9)


def test_where_the_model_is_true_its_slope_is_that_of_the_output_error(chain12_true, chain12_frf):
    """H_A Z' h_X and H_A Z' h_A agree once h_X = h_A, also with the missing motion taken from the model."""
    unknowns = updyn.parameters(chain12_true, **EVERY)
    problem = FRFPart.build(chain12_true, chain12_frf, unknowns)
    x = problem.coordinates.to_x(unknowns.start)
    r, J = ResponseEquation("rfm", expand=True).block(problem, x, slice(5, 9))
    level = np.sqrt(np.mean(np.abs(chain12_frf.values) ** 2))
    assert np.abs(r).max() < 1e-10
    assert J * level == pytest.approx(problem.block(x, slice(5, 9)).dH, rel=1e-9)


# -- what is refused -------------------------------------------------------------------------------------------------
def test_quantities_that_a_method_cannot_update(chain12, full):
    with pytest.raises(
        ParameterError, match=r"'rfm' cannot update loss_factor \(unknown 'part1.loss_factor'\)"
    ):
        updyn.update(chain12, full, updyn.parameters(chain12, loss_factor="all"), method="rfm")
    assert {"loss_factor", "viscous"} <= set(METHODS.find("rfm").cannot)
    damper = updyn.Model.from_groups({"a": updyn.Group([[1e4]], [[1.0]], viscous=[[3.0]])}, ["1:X"])
    data = updyn.response(damper, [5.0, 12.0], ["1:X"], ["1:X"])
    unknowns = updyn.parameters(damper, viscous="all")
    with pytest.raises(
        ParameterError, match=r"'complex-rfm' cannot update viscous \(unknown 'a.viscous'\)"
    ):
        updyn.update(damper, data, unknowns, method="complex-rfm")
    assert "viscous" in METHODS.find("complex-rfm").cannot
    assert "loss_factor" not in METHODS.find("complex-rfm").cannot


@pytest.mark.parametrize("name", ["frf-sensitivity", "reduced-frf"])
def test_a_viscous_damper_is_found_where_the_method_can(name):
    groups = {"a": updyn.Group([[1e4]], [[1.0]], viscous=[[3.0]])}
    start = updyn.Model.from_groups(groups, ["1:X"])
    data = updyn.response(
        start.scaled({"a": {"viscous": 1.02}}), [5.0, 12.0, 15.0], ["1:X"], ["1:X"]
    )
    result = updyn.update(start, data, updyn.parameters(start, viscous="all"), method=name)
    assert result.values == pytest.approx({"a.viscous": 1.02}, rel=1e-9)


def test_all_damping_of_a_group_is_found_in_one_solve_where_the_equation_is_linear():
    """Loss factor and Rayleigh damping are relative to stiffness and mass: linear as products with them."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    group = updyn.Group(
        K, np.diag([1.0, 2.0]), loss_factor=0.01, mass_damping=0.1, stiffness_damping=1e-4
    )
    start = updyn.Model.from_groups({"a": group}, ["1:X", "2:X"])
    truth = {
        "stiffness": 1.8,
        "mass": 0.6,
        "loss_factor": 0.05,
        "mass_damping": 0.4,
        "stiffness_damping": 3e-4,
    }
    data = updyn.response(
        start.scaled({"a": truth}), [2.0, 7.0, 11.0, 20.0, 31.0], ["1:X", "2:X"], ["1:X"]
    )
    chosen = updyn.parameters(start, **dict.fromkeys(truth, "all"))
    assert len(Amounts.find(chosen).pairs) == 3
    result = updyn.update(start, data, chosen, method="reduced-frf", separate=False)
    assert result.iterations == 2
    assert result.values == pytest.approx({f"a.{q}": v for q, v in truth.items()}, rel=1e-9)


@pytest.mark.parametrize("name", ["complex-rfm", "reduced-frf"])
def test_a_loss_factor_that_depends_on_frequency(name):
    """Its table says nothing at 0 Hz, where the static transformation is made: that knows no damping."""
    table = LossTable([1.0, 40.0], [1.0, 3.0])
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    group = updyn.Group(K, np.diag([1.0, 2.0]), loss_factor=0.02, loss_table=table)
    start = updyn.Model.from_groups({"a": group}, ["1:X", "2:X"])
    data = updyn.response(
        start.scaled({"a": {"loss_factor": 0.05}}), [2.0, 7.0, 20.0], ["1:X", "2:X"], ["1:X"]
    )
    result = run(start, data, name)
    assert result.values == pytest.approx(
        {"a.stiffness": 1.0, "a.mass": 1.0, "a.loss_factor": 0.05}, rel=1e-9
    )


@pytest.mark.parametrize("name", ["rfm", "complex-rfm"])
def test_full_coordinates_are_asked_for(chain12, chain12_frf, name):
    with pytest.raises(
        DataError,
        match=rf"{name} needs .* all 12 DOFs .*; 7 were not measured \(1:X, 3:.*, \.\.\.\)",
    ):
        run(chain12, chain12_frf, name)


@pytest.mark.parametrize("name", NAMES)
def test_priors_are_refused_by_plain_iterations(chain12, full, name):
    unknowns = updyn.parameters(chain12, stiffness="all", prior_std={"stiffness": 0.3})
    message = f"method '{name}', the plain iteration, does not support priors"
    if hasattr(METHODS[name], "SOLVERS"):
        message = "solver .* is the plain iteration and does not support priors; use 'trust-region'"
    with pytest.raises(OptionError, match=message):
        updyn.update(chain12, full, unknowns, method=name)


def test_the_trust_region_takes_priors_and_bounds(chain12, full):
    unknowns = updyn.parameters(
        chain12,
        stiffness="all",
        mass="all",
        bounds={"stiffness": (0.9, 1.1)},
        prior_std={"mass": 0.3},
    )
    held = updyn.update(chain12, full, unknowns, method="rfm", solver="trust-region")
    assert "part1.stiffness" in held.at_bound
    assert all(0.9 <= v <= 1.1 for n, v in held.values.items() if n.endswith("stiffness"))


def test_the_plain_iteration_knows_no_bounds_and_says_so(chain12, chain12_true, full):
    unknowns = updyn.parameters(chain12, **EVERY, bounds={"stiffness": (0.9, 1.1)})
    result = updyn.update(chain12, full, unknowns, method="complex-rfm")
    assert result.values["part1.stiffness"] == pytest.approx(0.8, rel=1e-9)
    assert "has no bounds" in result.remedy
    assert "noise biases the estimate" in result.remedy


def test_options_are_checked():
    with pytest.raises(OptionError, match=r"solver 'gauss': .*gauss-newton"):
        make_method("complex-rfm", {"solver": "gauss"})
    with pytest.raises(OptionError, match="option expand = 1: expected bool"):
        make_method("rfm", {"expand": 1})
    with pytest.raises(
        OptionError, match=r"option frequency = -1.0: expected a number of at least 0"
    ):
        make_method("reduced-frf", {"frequency": -1.0})


@pytest.mark.parametrize("name", NAMES)
def test_the_reduced_tier_is_refused_with_the_reason(chain12, full, name):
    with pytest.raises(OptionError, match=r"tier 'reduced'.*use tier 'sparse'"):
        run(chain12, full, name, tier="reduced")


@pytest.mark.parametrize("name", ["complex-rfm", "reduced-frf"])
def test_a_line_at_0_hz_is_refused_where_it_holds_no_receptance(chain12, full, name):
    still = updyn.FRF(
        [0.0, *full.freq[:3]], full.values[:4], full.responses, full.references, "accelerance"
    )
    with pytest.raises(DataError, match="the 0 Hz line of accelerance holds no receptance"):
        run(chain12, still, name)


def test_a_force_without_a_sensor_is_refused_by_the_reduced_method(chain12, chain12_frf):
    data = chain12_frf.select(responses=["2:X", "5:X"], references=["12:X"])
    with pytest.raises(DataError, match="reference 12:X is not among the responses"):
        run(chain12, data, "reduced-frf")


def test_no_transformation_at_a_frequency_of_the_held_structure():
    """DOFs 2 and 3 hang between held sensors: they resonate at sqrt(k / m)."""
    K = 1e4 * np.array([[1.0, -1.0, 0], [-1.0, 2.0, -1.0], [0, -1.0, 1.0]])
    free = updyn.Model.from_groups(
        {"c": updyn.Group(K, np.eye(3), loss_factor=0.05)}, ["1:X", "2:X", "3:X"]
    )
    data = updyn.response(free, [3.0, 9.0], ["1:X", "3:X"], ["1:X"])
    unknowns = updyn.parameters(free, stiffness="all")
    at = float(np.sqrt(2e4) / (2 * np.pi))
    result = updyn.update(free, data, unknowns, method="reduced-frf", frequency=at)
    assert result.status == "failed"
    assert f"no transformation at {at:g} Hz" in result.message
    assert "choose another with frequency=" in result.message


# -- how it goes and how it ends -------------------------------------------------------------------------------------
def bowl(x):
    """A local problem in one unknown whose linear solution is where it should be."""
    return Local(0.5 * float(x[0] ** 2), np.array([[1.0]]), np.array([x[0]]))


@pytest.fixture
def one_unknown(chain12, full):
    problem = FRFPart.build(chain12, full, updyn.parameters(chain12, loss_factor=["part1"]))
    return problem, Monitor(Problem.of([problem]))


def test_the_plain_iteration_ends_where_a_step_is_short(one_unknown):
    problem, monitor = one_unknown
    x, reason = PlainIteration(50, 1e-6).run(
        problem, bowl, lambda _, x: 0.5 * x, np.array([0.03]), monitor
    )
    assert reason == "converged"
    steps = [h.step for h in monitor.history]
    assert steps[-1] <= 1e-6 < steps[-2]
    assert x[0] == pytest.approx(steps[-1])


def test_a_short_step_that_gets_no_shorter_is_rounding(one_unknown):
    problem, monitor = one_unknown
    sign = iter((-1.0) ** np.arange(50))
    x, reason = PlainIteration(50, 0.0).run(
        problem, bowl, lambda _, x: x + 1e-8 * next(sign), np.array([0.03]), monitor
    )
    assert (reason, len(monitor.history)) == ("converged", 3)
    assert x[0] == pytest.approx(0.03)


def test_the_largest_number_of_steps_is_kept(one_unknown):
    problem, monitor = one_unknown
    _, reason = PlainIteration(4, 0.0).run(
        problem, bowl, lambda _, x: 0.5 * x, np.array([0.03]), monitor
    )
    assert (reason, len(monitor.history)) == ("max-iterations", 5)


def test_unknowns_without_bounds_are_a_divergence(one_unknown):
    problem, monitor = one_unknown
    with pytest.raises(
        SolverError, match=r"grow without limit in step 11, .*condition number 1: .* diverged"
    ):
        PlainIteration(50, 0.0).run(problem, bowl, lambda _, x: 10.0 * x, np.array([0.03]), monitor)


def test_a_step_that_helps_nowhere_has_stalled(one_unknown):
    problem, monitor = one_unknown
    start = np.array([0.03])
    x, reason = PlainIteration(50, 0.0, halving=True).run(
        problem, bowl, lambda _, x: 100.0 + 0 * x, start, monitor
    )
    assert (x, reason) == (start, "stalled")


def test_halving_takes_the_first_part_of_a_step_that_lowers_the_cost(one_unknown):
    """From 1 to -7: all and half of it raise x^2, a quarter ends at -1, which does not lower it, an eighth at 0."""
    problem, monitor = one_unknown
    settings = PlainIteration(1, 0.0, halving=True)
    x, _ = settings.run(problem, bowl, lambda _, x: x - 8.0, np.array([1.0]), monitor)
    assert x == pytest.approx([0.0], abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_every_step_is_in_the_history_and_the_cost_falls_to_rounding(close, full, name):
    result = run(close, full, name)
    assert result.status == "converged"
    assert {h.stage for h in result.history} == {name}
    assert [h.number for h in result.history] == list(range(len(result.history)))
    assert result.history[0].step == 0.0
    assert all(np.isfinite([h.cost, h.condition]).all() for h in result.history)
    assert result.history[-1].cost < 1e-16 * result.history[0].cost
    assert result.values["part1.stiffness"] == pytest.approx(1 / 1.003, rel=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_few_steps_and_a_wish_to_stop(close, full, name):
    short = run(close, full, name, max_iterations=0)
    assert short.status == "max-iterations"
    assert vector(short) == pytest.approx(short.parameters.start)
    seen = []
    stopped = run(close, full, name, callback=lambda p: seen.append(p) or len(seen) > 1)
    assert stopped.status == "stopped"
    assert len(stopped.history) <= 2


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_resumed_to_the_same_answer(close, full, add_noise, tmp_path, name):
    data, path = add_noise(full, np.random.default_rng(3), 0.001), tmp_path / "run.journal"
    plain = run(close, data, name)
    kept = run(close, data, name, checkpoint=path)
    whole = path.read_bytes()
    assert outcome(kept) == outcome(plain)
    path.write_bytes(whole[: len(whole) // 2])
    assert outcome(run(close, data, name, checkpoint=path, resume=True)) == outcome(plain)
    assert path.read_bytes() == whole


# -- what must not matter --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", NAMES)
def test_tier_quantity_and_signs_do_not_matter(close, full, add_noise, name):
    data = add_noise(full, np.random.default_rng(3), 0.002)
    one = run(close, data, name)
    turned = data.select(responses=["3:-X", *ALL[:2], *ALL[3:]], references=["2:-X", "12:X"])
    others = [run(close, data, name, tier="sparse"), run(close, turned, name)]
    if name != "frf-sensitivity":  # its residual is in the unit of the data
        others.append(run(close, data.converted("accelerance"), name))
    for other in others:
        assert vector(other) == pytest.approx(vector(one), rel=1e-7)
        assert list(other.std.values()) == pytest.approx(list(one.std.values()), rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_unit_of_length_does_not_matter(mixed_model, add_noise, name):
    fits = []
    for length in (1.0, 1e-3):
        start = mixed_model(length)
        true = start.scaled({"a": {"stiffness": 1.01}, "b": {"stiffness": 0.995, "mass": 1.002}})
        sensors = [str(d) for d in start.dofs]
        clean = updyn.response(true, np.linspace(2, 60, 40), sensors, ["1:Y", "2:RZ"])
        data = add_noise(clean, np.random.default_rng(3), relative=0.002)
        fits.append(run(start, data, name))
    assert fits[0].status == "converged"
    assert vector(fits[1]) == pytest.approx(vector(fits[0]), rel=1e-6)
    assert list(fits[1].std.values()) == pytest.approx(list(fits[0].std.values()), rel=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_two_tests_are_fitted_together(close, chain12_true, full, name):
    """The chain as it is, and with its last mass held, a configuration that lacks one DOF."""
    from updyn.elements.constraints import constrain

    held = [constrain(m, grounded=["12:X"]) for m in (close, chain12_true)]
    data = updyn.response(held[1], full.freq, ALL[:-1], ["2:X"])
    tests = [updyn.Test(close, full, "free"), updyn.Test(held[0], data, "held")]
    options = {"separate": False} if name == "reduced-frf" else {}
    result = updyn.update_jointly(tests, chosen(close, name), name, **options)
    assert result.status == "converged"
    assert result.values["part1.stiffness"] == pytest.approx(1 / 1.003, rel=1e-8)
    assert result.values["part4.mass"] == pytest.approx(1 / 0.998, rel=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_a_linked_unknown_of_a_power_is_linearised(close, full, chain12_true, name):
    linked = updyn.link(
        chain12_true, "plate.thickness", {"part1.stiffness": 3.0, "part1.mass": 1.0}
    )
    true = linked.apply(chain12_true, [1.01])
    data = updyn.response(true, full.freq, ALL, ["2:X", "12:X"])
    options = {"separate": False} if name == "reduced-frf" else {}
    result = updyn.update(chain12_true, data, linked, method=name, **options)
    assert result.status == "converged"
    assert vector(result) == pytest.approx([1.01], rel=1e-9)


def test_what_is_sent_to_workers_can_be_sent(chain12, full):
    problem = FRFPart.build(chain12, full, chosen(chain12, "rfm"))
    x = problem.coordinates.to_x(problem.coordinates.parameters.start)
    residual, there = pickle.loads(pickle.dumps((ResponseEquation("rfm", expand=True), problem)))  # noqa: S301
    for a, b in zip(
        residual.block(there, x, slice(0, 4)), residual.block(problem, x, slice(0, 4)), strict=True
    ):
        assert np.array_equal(a, b)


# -- why it failed -----------------------------------------------------------------------------------------
@pytest.fixture
def two_masses(chain12):
    unknowns = updyn.parameters(chain12, mass=["part1", "part2"])
    part = FRFPart.build(chain12, updyn.response(chain12, [3.0, 5.0], ALL, ["2:X"]), unknowns)
    return part, Monitor(Problem.of([part]))


def test_a_factor_that_turns_negative_is_named_with_its_values(two_masses):
    problem, monitor = two_masses
    local = Local(1.0, np.diag([1.0, 2.0]), np.ones(2))
    with pytest.raises(SolverError) as error:
        PlainIteration(5, 0.0).run(
            problem, lambda _: local, lambda *_: np.array([-0.25, -0.5]), np.zeros(2), monitor
        )
    assert str(error.value) == (
        "part2.mass would become negative (from 1 to -0.5), with 1 more, in step 1, whose linear"
        " problem has condition number 1: the plain iteration has diverged."
    )


def test_a_singular_step_is_called_so(two_masses):
    problem, monitor = two_masses
    local = Local(1.0, np.ones((2, 2)), np.ones(2))
    with pytest.raises(SolverError, match="step 1, whose linear problem is singular: "):
        PlainIteration(5, 0.0).run(
            problem, lambda _: local, lambda *_: np.array([1.0, -1.0]), np.zeros(2), monitor
        )


def guyan_errors(model, data):
    """Relative errors of FRFs after static condensation, median of each line."""
    n, at = model.n_dofs, model.dofs.match(data.responses, "response").index
    rest = np.setdiff1d(np.arange(n), at)
    K, M = model.stiffness.toarray(), model.mass.toarray()
    T = np.zeros((n, len(at)))
    T[at] = np.eye(len(at))
    T[rest] = -np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, at)])
    D = sum(g.loss_factor * g.stiffness.toarray() for g in model.groups.values())
    out, force = [], model.dofs.match(data.references, "reference").index[0]
    for f in data.freq:
        Z = K + 1j * D - (2 * np.pi * f) ** 2 * M
        exact = np.linalg.solve(Z, np.eye(n)[:, force])[at]
        reduced = np.linalg.solve(T.T @ Z @ T, np.eye(n)[at][:, force])
        out.append(np.median(np.abs(reduced - exact) / np.abs(exact)))
    return np.array(out)


@pytest.mark.parametrize("sensors", [["2:X", "7:X", "12:X"], ["1:X", "2:X", "3:X"]])
def test_the_reduced_method_says_how_far_its_reduced_model_is_off(chain12, chain12_true, sensors):
    """Also where the measured DOFs have the same numbers in the whole model as in the reduced one."""
    data = updyn.response(chain12_true, np.linspace(0.5, 20.0, 40), sensors, sensors[-1:])
    unknowns = updyn.parameters(chain12, **EVERY)
    result = updyn.update(chain12, data, unknowns, method="reduced-frf", max_iterations=3)
    errors = guyan_errors(chain12, data)
    first = int(np.flatnonzero(errors > 0.1)[0])
    assert 0 < first < 39
    assert result.status in ("failed", "max-iterations")
    said = (
        "9 of 12 DOFs were not measured, and the transformation that replaces them is not exact:"
        f" at the start of the fit, the FRFs differ by {100 * np.median(errors):.2g} % (median of"
        f" all lines), and by less than 10 % only up to {data.freq[first - 1]:.4g} Hz."
    )
    assert said in result.message


def test_the_sensitivity_method_says_how_far_its_first_step_holds():
    """One factor on a mass on a spring: the FRF, and so the sum of squares, in closed form."""
    spring = updyn.Model.from_groups(
        {"m": updyn.Group(np.array([[1e4]]), np.array([[1.0]]), loss_factor=0.02)}, ["1:X"]
    )
    freq = np.array([10.0, 12.0, 14.0, 18.0, 20.0])
    data = updyn.response(spring.scaled({"m": {"mass": 1.6}}), freq, ["1:X"], ["1:X"])
    unknowns = updyn.parameters(spring, mass="all")
    w = 2 * np.pi * freq

    def H(mass):
        return 1.0 / (1e4 * (1 + 0.02j) - w**2 * mass)

    def cost(mass):
        return np.sum(np.abs(data.values[:, 0, 0] - H(mass)) ** 2)

    J, r = H(1.0) ** 2 * w**2, data.values[:, 0, 0] - H(1.0)
    step = np.sum((J.conj() * r).real) / np.sum(np.abs(J) ** 2)
    share = 1.0
    while 1.0 + share * step <= 0.0 or cost(1.0 + share * step) >= cost(1.0):
        share *= 0.5
    assert share < 1.0
    problem = Problem.of([FRFPart.build(spring, data, unknowns)])
    said = make_method("frf-sensitivity", {}).describe_obstacle(problem)
    assert f"decreases only along the first 1/{1 / share:.0f} of the first step" in said


def test_motion_that_was_not_measured_and_too_few_numbers_are_said(chain12, chain12_true):
    data = updyn.response(chain12_true, [3.0, 9.0], ["2:X", "12:X"], ["12:X"])
    unknowns = updyn.parameters(chain12, **EVERY)
    result = updyn.update(chain12, data, unknowns, method="force-residual", max_iterations=2)
    assert "10 of 12 DOFs were not measured: their motion is expanded with" in result.message
    assert f"The data hold 8 real numbers for {len(unknowns)} unknowns." in result.message
