"""A model with one group wrong and held at that: the group is named, with how much of the misfit it would explain."""

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.demos.gear_train import true_model
from updyn.dynamics.affine import AffineSystem
from updyn.updating.fit.methods.constitutive import constitutive_weights
from updyn.updating.judge.localise import (
    _n_energy_lines,
    _plan_short_fits,
    _work_limit,
    constitutive_error,
    localise_error,
)
from updyn.updating.judge.settings import SHORT_FITS
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

GEARS = np.geomspace(2.0, 1000.0, 60) / (2.0 * np.pi)


def chain(true):
    freq = np.linspace(2.0, 22.0, 60)
    sensors = [f"{i}:X" for i in (2, 5, 7, 10, 12)]
    return updyn.response(true, freq, sensors, sensors[:2])


def gears(true):
    return updyn.response(true, GEARS, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])


def fitted(true, exact, wrong, quantity, factor, relative, rng, stated=None):
    """Fit all but one group, which is held wrong; return suspects as judged from the residual there."""
    draw = rng.standard_normal((2, *exact.values.shape))
    values = exact.values * (1.0 + relative * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(exact.freq, values, exact.responses, exact.references, exact.quantity)
    held = getattr(true.group(wrong), quantity) if quantity == "loss_factor" else 1.0
    start = true.scaled({wrong: {quantity: held / factor}})
    others = [name for name in true.groups if name != wrong]
    unknowns = updyn.parameters(start, stiffness=others, mass=others, loss_factor=others)
    noise = {"relative": relative or 1e-3}
    result = updyn.update(start, frf, unknowns, starts=0, noise=noise)
    problem = FRFPart.build(start, frf, unknowns)
    x = problem.coordinates.to_x(np.array([result.values[n] for n in unknowns.names]))
    H = problem.responses(x)
    weight = np.sqrt(2.0) / (noise["relative"] * np.abs(H))
    whitened = weight * (frf.values - H)
    beyond = float(np.sum(np.abs(whitened) ** 2)) - 2 * problem.n_values + problem.n
    found = localise_error(
        Problem.of([problem]),
        x,
        OutputErrorSet((OutputError(weight),)),
        [whitened],
        beyond if stated is None else None,
    )
    return result, found


@pytest.mark.usefixtures("no_causes")
@pytest.mark.parametrize("relative", [0.0, 0.01, 0.05])
@pytest.mark.parametrize(
    ("wrong", "quantity", "factor"),
    [
        ("part2", "stiffness", 1.2),
        ("part4", "stiffness", 0.8),
        ("part3", "mass", 1.3),
        ("part1", "loss_factor", 3.0),
    ],
)
def test_the_wrong_group_of_a_chain_is_named(chain12_true, wrong, quantity, factor, relative):
    _, found = fitted(
        chain12_true,
        chain(chain12_true),
        wrong,
        quantity,
        factor,
        relative,
        np.random.default_rng(1),
    )
    first = found[0]
    assert first.group == wrong
    assert first.name == f"{wrong}.{quantity}"
    assert 0.5 < first.explains <= 1.0
    assert np.sign(first.change) == np.sign(factor - 1.0)
    if quantity != "loss_factor":
        assert first.change == pytest.approx(np.log(factor), rel=0.5)


@pytest.mark.usefixtures("no_causes")
@pytest.mark.parametrize("relative", [0.0, 0.01])
@pytest.mark.parametrize("wrong", ["unit 2", "unit 3", "unit 5"])
def test_the_wrong_unit_of_the_gear_train_is_named(wrong, relative):
    true = true_model()
    _, found = fitted(
        true, gears(true), wrong, "stiffness", 1.2, relative, np.random.default_rng(2)
    )
    assert found[0].name == f"{wrong}.stiffness"
    assert found[0].change == pytest.approx(np.log(1.2), rel=0.5)


@pytest.mark.usefixtures("no_causes")
def test_where_the_size_of_the_noise_is_not_known_the_share_is_told_from_likeness(chain12_true):
    exact = chain(chain12_true)
    _, known = fitted(
        chain12_true, exact, "part2", "stiffness", 1.2, 0.01, np.random.default_rng(1)
    )
    _, found = fitted(
        chain12_true, exact, "part2", "stiffness", 1.2, 0.01, np.random.default_rng(1), "not"
    )
    assert [s.name for s in found] == [s.name for s in known]
    assert found[0].change == known[0].change
    assert known[0].explains <= found[0].explains <= 1.0


def test_a_good_fit_has_no_suspects(chain12_true):
    """All groups but one are fitted, and that one is right."""
    _, found = fitted(
        chain12_true, chain(chain12_true), "part2", "stiffness", 1.0, 0.02, np.random.default_rng(3)
    )
    assert found == ()


@pytest.mark.usefixtures("no_causes")
def test_the_gain_is_that_of_freeing_the_quantity(chain12_true):
    """For a small error the step of first order takes away what a fit with that unknown takes away."""
    exact = chain(chain12_true)
    wrong = chain12_true.scaled({"part2": {"stiffness": 1.0 / 1.002}})
    others = ["part1", "part3", "part4"]
    cost, noise = [], {"relative": 0.001}
    for free in (others, [*others, "part2"]):
        result = updyn.update(
            wrong, exact, updyn.parameters(wrong, stiffness=free), starts=0, noise=noise
        )
        cost.append(2.0 * result.history[-1].cost)
    unknowns = updyn.parameters(wrong, stiffness=others)
    result = updyn.update(wrong, exact, unknowns, starts=0, noise=noise)
    problem = FRFPart.build(wrong, exact, unknowns)
    x = problem.coordinates.to_x(np.array(list(result.values.values())))
    H = problem.responses(x)
    weight = np.sqrt(2.0) / (0.001 * np.abs(H))
    whole = float(np.sum(np.abs(weight * (exact.values - H)) ** 2))
    found = localise_error(
        Problem.of([problem]),
        x,
        OutputErrorSet((OutputError(weight),)),
        [weight * (exact.values - H)],
        whole,
    )
    assert found[0].name == "part2.stiffness"
    assert found[0].change == pytest.approx(np.log(1.002), rel=0.01)
    assert found[0].explains * whole == pytest.approx(cost[0] - cost[1], rel=0.01)


# -- what the model has no quantity for ------------------------------------------------------------------------
def storeys(n, extra=0.0):
    """Floors on columns, each a spring with some of the mass; between ground floor and roof a further spring."""
    groups = {}
    for i in range(n):
        K, M, floor = np.zeros((3, n, n))
        ends = [j for j in (i - 1, i) if j >= 0]
        K[ends, ends], M[ends, ends] = 1e6, 30.0
        if i:
            K[i, i - 1] = K[i - 1, i] = -1e6
        floor[i, i] = 400.0
        groups[f"column {i + 1}"] = updyn.Group(K, M, loss_factor=0.02)
        groups[f"floor {i + 1}"] = updyn.Group(mass=floor)
    tie = np.zeros((n, n))
    tie[0, 0] = tie[-1, -1] = extra
    tie[0, -1] = tie[-1, 0] = -extra
    if extra:
        groups["tie"] = updyn.Group(tie, loss_factor=0.02)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def test_a_further_spring_is_not_blamed_on_a_mass_beyond_what_freeing_it_explains(add_noise):
    """To first order the mass of the roof explains all of what its spring to the ground floor does."""
    model, noise = storeys(5), {"relative": 0.01}
    exact = updyn.response(
        storeys(5, extra=2e4), np.linspace(0.5, 20.0, 150), model.dofs, ["1:X"], "accelerance"
    )
    data = add_noise(exact, np.random.default_rng(1), 0.01)
    columns = [name for name in model.groups if name.startswith("column")]
    unknowns = updyn.parameters(model, stiffness=columns)
    without = updyn.update(model, data, unknowns, noise=noise)
    estimated = updyn.update(model, data, unknowns)
    for found in (without, estimated):
        assert found.adequacy.outcome == "structure"
        assert all(s.confirmed for s in found.adequacy.explained_by)
        assert all(s.explains < 0.7 for s in found.adequacy.explained_by)
        (lacks,) = found.findings
        assert (lacks.kind, lacks.channels) == ("missing-spring", ("1:X", "5:X"))
        assert lacks.value == pytest.approx(2e4, rel=5e-3)
        assert lacks.statement in found.message
        assert "floor" not in found.message
        assert found.remedy == lacks.remedy
    best = without.adequacy.explained_by[0]
    assert best.name == "floor 5.mass"
    freed = updyn.update(
        model, data, unknowns + updyn.parameters(model, mass="floor 5"), noise=noise
    )
    square = [2.0 * one.history[-1].cost for one in (without, freed)]
    beyond = square[0] - 2 * data.values.size + len(unknowns)
    assert best.explains == pytest.approx((square[0] - square[1]) / beyond, abs=0.03)
    assert best.change == pytest.approx(np.log(freed.values["floor 5.mass"]), rel=0.5)


def test_what_a_short_fit_finds_at_a_bound_explains_nothing(make_chain):
    """A sensor the wrong way round: no positive factor makes up for it, the smallest hides it best."""
    model = make_chain(6)
    freq = np.linspace(1.0, 40.0, 80)
    frf = updyn.response(model, freq, model.dofs, ["1:X"], "accelerance")
    values = frf.values.copy()
    values[:, 3] *= -1.0
    problem = FRFPart.build(
        model,
        updyn.FRF(freq, values, model.dofs, ["1:X"], "accelerance"),
        updyn.parameters(model, stiffness=["part1"]),
    )
    H = problem.responses(np.zeros(1))
    weight = np.sqrt(2.0) / (0.01 * np.abs(H))
    whitened = weight * (values - H)
    found = localise_error(
        Problem.of([problem]), np.zeros(1), OutputErrorSet((OutputError(weight),)), [whitened], None
    )
    assert "4:X.calibration" not in [s.name for s in found]


def test_in_a_model_that_is_too_large_for_short_fits_nothing_is_confirmed(
    chain12_true, monkeypatch
):
    override(monkeypatch, SHORT_FITS, most_operations=0.0)
    _, found = fitted(
        chain12_true,
        chain(chain12_true),
        "part2",
        "stiffness",
        1.2,
        0.01,
        np.random.default_rng(1),
    )
    assert found[0].name == "part2.stiffness"
    assert not any(s.confirmed for s in found)


# -- energy of the error in the constitutive relations ---------------------------------------------------------
def test_energy_by_a_full_solution_of_the_constrained_problem():
    """Minimise lambda^H W lambda + theta |d|^2 / sigma^2 over all fields at once, with matrices written out."""
    rng = np.random.default_rng(4)
    n, rows, f = 6, np.array([0, 2, 5]), 1.7
    K, M, D = (a @ a.T + np.eye(n) for a in rng.standard_normal((3, n, n)))
    model = updyn.Model.from_groups(
        {"a": updyn.Group(K, M, loss_factor=0.1), "b": updyn.Group(2.0 * D, viscous=0.01 * M)},
        [f"{i}:Z" for i in range(1, n + 1)],
    )
    omega = 2.0 * np.pi * f
    Z = (1.0 + 0.1j) * K + 2.0 * D - omega**2 * M + 0.01j * omega * M
    W = (1.0 + 0.1**2) * K + 2.0 * D + omega**2 * M + 0.01 * omega * M
    system = AffineSystem.compile(model)
    c, w = constitutive_weights(system, system.start, np.array([omega]))
    matrices = [term.local for term in system.terms]
    assert sum(a * m for a, m in zip(c[:, 0], matrices, strict=True)) == pytest.approx(Z)
    assert sum(a * m for a, m in zip(w[:, 0], matrices, strict=True)) == pytest.approx(W)
    measured = rng.standard_normal((1, 3, 1)) + 1j * rng.standard_normal((1, 3, 1))
    frf = updyn.FRF([f], measured, ["1:Z", "3:Z", "6:Z"], ["1:Z"], "receptance")
    problem = FRFPart.build(model, frf, updyn.parameters(model, stiffness="a"))
    x, sigma2 = np.zeros(1), 0.3
    misfit = problem.responses(x) - measured
    found = constitutive_error(problem, x, misfit, np.full((1, 3, 1), sigma2), slice(0, 1))[:, 0, 0]
    P = np.linalg.solve(Z, np.eye(n)[:, rows])
    S = P.T @ W @ P.conj()
    theta = (np.sum(np.abs(misfit) ** 2) - 3 * sigma2) / np.trace(S).real
    # Unknown fields u and lambda: Z u - theta W lambda = force, Z^H lambda + (Pi u - h) / sigma^2
    # on the responses = 0.
    Pi = np.eye(n)[rows]
    force = np.eye(n)[:, 0]
    both = np.block([[Z, -theta * W], [Pi.T @ Pi / sigma2, Z.conj().T]])
    field = np.linalg.solve(both, np.concatenate([force, Pi.T @ measured[0, :, 0] / sigma2]))[n:]
    expected = [
        a * ((theta * field).conj() @ m @ (theta * field)).real
        for a, m in zip(w[:, 0], matrices, strict=True)
    ]
    assert found == pytest.approx(expected)


@pytest.mark.usefixtures("no_causes")
def test_most_of_the_energy_lies_in_the_wrong_group(chain12_true):
    exact = chain(chain12_true)
    for wrong in ("part1", "part4"):
        _, found = fitted(
            chain12_true, exact, wrong, "stiffness", 1.2, 0.01, np.random.default_rng(5)
        )
        assert found[0].group == wrong
        assert found[0].energy > 0.25


# -- several tests, linked unknowns ----------------------------------------------------------------------------
def test_two_tests_point_at_one_group(chain12_true):
    wrong = chain12_true.scaled({"part3": {"stiffness": 0.98}})
    heavy = {"part4": {"mass": 1.5}}
    names = ["part1", "part2", "part4"]
    unknowns = updyn.parameters(wrong, stiffness=names)
    problems, weights, whitened = [], [], []
    for name, own, true in (
        ("bare", wrong, chain12_true),
        ("loaded", wrong.scaled(heavy), chain12_true.scaled(heavy)),
    ):
        frf = chain(true)
        problems.append(FRFPart.build(own, frf, unknowns, name=name))
        H = problems[-1].responses(np.zeros(3))
        weights.append(np.sqrt(2.0) / (0.01 * np.abs(H)))
        whitened.append(weights[-1] * (frf.values - H))
    task = Problem.of(problems)
    residual = OutputErrorSet(tuple(OutputError(w) for w in weights))
    found = localise_error(
        task, np.zeros(3), residual, whitened, float(sum(np.sum(np.abs(e) ** 2) for e in whitened))
    )
    assert found[0].name == "part3.stiffness"


@pytest.mark.usefixtures("no_causes")
def test_a_quantity_that_shares_an_unknown_is_tried_by_itself(chain12_true):
    """One unknown drives two groups that are not equally wrong."""
    wrong = chain12_true.scaled({"part2": {"stiffness": 0.8}})
    exact = chain(chain12_true)
    unknowns = updyn.link(wrong, "both.modulus", {"part1.stiffness": 1.0, "part2.stiffness": 1.0})
    result = updyn.update(wrong, exact, unknowns, starts=0, noise={"relative": 0.01})
    problem = FRFPart.build(wrong, exact, unknowns)
    x = problem.coordinates.to_x(np.array(list(result.values.values())))
    H = problem.responses(x)
    weight = np.sqrt(2.0) / (0.01 * np.abs(H))
    whitened = weight * (exact.values - H)
    found = localise_error(
        Problem.of([problem]),
        x,
        OutputErrorSet((OutputError(weight),)),
        [whitened],
        float(np.sum(np.abs(whitened) ** 2)),
    )
    assert {s.name for s in found[:2]} == {"part1.stiffness", "part2.stiffness"}


# -- effort ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("work", "allowed"), [(1e9, 5e9), (1e10, 8e9), (1e12, 1e11)])
def test_short_fits_take_less_than_an_evaluation_or_a_second(work, allowed):
    problem = SimpleNamespace(parts=[SimpleNamespace(work=work)])
    assert _work_limit(problem) == pytest.approx(allowed)


@pytest.mark.parametrize(
    ("work", "n_lines", "number"),
    [(1.24e9, 100, 60), (1.26e9, 100, 25), (1.26e9, 400, 60), (1.26e9, 3, 1)],
)
def test_the_energy_is_computed_at_fewer_lines_of_expensive_models(work, n_lines, number):
    assert _n_energy_lines(SimpleNamespace(work=work, n_lines=n_lines)) == number


@pytest.mark.parametrize(
    ("allowed", "n_unknowns", "plan"),
    [
        (3 * 12 * 120, 7, (3, 120, 20)),
        (3 * 12 * 120 - 1, 7, (5, 60, 12)),
        (3 * 12 * 60 - 1, 7, (5, 30, 12)),
        # 30 lines have fewer than four values per unknown.
        (3 * 12 * 60 - 1, 8, (2, 60, 12)),
        (3 * 12 * 30 - 1, 1, (5, 30, 6)),
        (3 * 6 * 30 - 1, 1, (5, 15, 6)),
        (3 * 6 * 15 - 1, 1, (4, 15, 4)),
        (4 * 15 - 1, 1, (0, 0, 0)),
    ],
)
def test_the_first_affordable_plan_of_short_fits_is_used(allowed, n_unknowns, plan):
    def thin(lines):
        return SimpleNamespace(parts=[SimpleNamespace(work=float(lines))], n_numbers=lines)

    problem = SimpleNamespace(thin=thin, n=n_unknowns)
    assert _plan_short_fits(problem, float(allowed), wanted=8) == plan
