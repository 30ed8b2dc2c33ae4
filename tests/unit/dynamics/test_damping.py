"""All damping that a group may have: matrices, Rayleigh coefficients, loss factors with a table."""

import copy

import numpy as np
import pytest

import updyn
from updyn.dynamics.affine import AffineSystem
from updyn.elements.constraints import constrain, join
from updyn.errors import ModelError, OptionError, ParameterError
from updyn.group import GROUP_QUANTITIES
from updyn.updating.problem.problem import FRFPart, Problem

FREQ = np.linspace(2.0, 60.0, 30)
TABLE = ([1.0, 10.0, 100.0], [0.5, 1.0, 4.0])


def chain(n=4, **damping):
    """A chain of `n` masses, each with its spring to the one before, a group each; the first group has `damping`."""
    groups = {}
    for e in range(n):
        K, M, C = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        at = [e] if e == 0 else [e - 1, e]
        K[np.ix_(at, at)] = (
            4e4 * (1 + 0.2 * e) * (np.ones((1, 1)) if e == 0 else np.array([[1, -1], [-1, 1]]))
        )
        M[e, e] = 1.0 + 0.3 * e
        C[np.ix_(at, at)] = K[np.ix_(at, at)] * 2e-4
        groups[f"part{e + 1}"] = updyn.Group(K, M, 0.02, C, **(damping if e == 0 else {}))
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


@pytest.fixture
def damped():
    return chain(mass_damping=3.0, stiffness_damping=2e-4, loss_table=TABLE)


def stiffness_by_hand(model, f):
    """Z at a line, dense, from the definition."""
    w, Z = 2 * np.pi * f, 0.0
    for g in model.groups.values():
        K, M, C = (getattr(g, name).toarray() for name in ("stiffness", "mass", "viscous"))
        relative = (
            1.0 if g.loss_table is None else np.interp(f, g.loss_table.freq, g.loss_table.relative)
        )
        C1 = C + g.mass_damping * M + g.stiffness_damping * K
        Z = Z + K * (1 + 1j * g.loss_factor * relative) + 1j * w * C1 - w**2 * M
    return Z


def test_the_response_is_that_of_the_definition(damped):
    H = updyn.response(damped, FREQ, damped.dofs, damped.dofs).values
    for f, h in zip(FREQ, H, strict=True):
        assert h @ stiffness_by_hand(damped, f) == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("tier", ["dense", "sparse", "reduced"])
def test_every_tier_knows_all_damping(damped, tier):
    got = updyn.response(damped, FREQ, damped.dofs, ["1:X"], tier=tier).values
    assert got == pytest.approx(updyn.response(damped, FREQ, damped.dofs, ["1:X"]).values, rel=1e-5)


def test_one_degree_of_freedom_by_the_textbook():
    """Half the half-power width over the frequency is zeta = alpha / (2 omega) + beta omega / 2."""
    w, alpha, beta = 2 * np.pi * 10.0, 0.8, 3e-4
    model = updyn.Model.from_groups(
        {"one": updyn.Group([[w**2]], [[1.0]], mass_damping=alpha, stiffness_damping=beta)}, ["1:X"]
    )
    zeta = alpha / (2 * w) + beta * w / 2
    assert updyn.modes(model, 1).loss_factor[0] == pytest.approx(2 * zeta, rel=1e-12)
    found = updyn.modes(model, 1, complex=True)
    assert (found.frequency[0] * 2 * np.pi) ** 2 * (1 + 1j * found.loss_factor[0]) == pytest.approx(
        -((-zeta * w + 1j * w * np.sqrt(1 - zeta**2)) ** 2), rel=1e-9
    )


def test_the_sums_hold_all_viscous_damping(damped):
    C = sum(g.viscous.toarray() for g in damped.groups.values())
    first = damped.groups["part1"]
    C = C + 3.0 * first.mass.toarray() + 2e-4 * first.stiffness.toarray()
    assert damped.viscous.toarray() == pytest.approx(C, rel=1e-14)
    D = damped.structural_at(55.0).toarray() - chain().structural.toarray()
    assert (
        pytest.approx(D, rel=1e-12)
        == 0.02 * (1.0 + 3.0 * 45.0 / 90.0) * first.stiffness.toarray()
        - 0.02 * first.stiffness.toarray()
    )


def test_a_course_over_frequency_is_refused_where_one_number_is_needed(damped):
    with pytest.raises(
        ModelError, match=r"group 'part1': its loss factor depends on frequency.*structural_at"
    ):
        _ = damped.structural
    with pytest.raises(ModelError, match=r"group 'part1'.*complex=False"):
        updyn.modes(damped, 2, complex=True)


def test_modes_take_the_loss_factor_at_their_own_frequency():
    """One group, so that the loss factor of a mode is the group's."""
    K, M = 4e4 * np.array([[2.0, -1.0], [-1.0, 1.0]]), np.eye(2)
    model = updyn.Model.from_groups(
        {"one": updyn.Group(K, M, 0.03, loss_table=TABLE)}, ["1:X", "2:X"]
    )
    found = updyn.modes(model, 2)
    assert found.loss_factor == pytest.approx(0.03 * np.interp(found.frequency, *TABLE), rel=1e-10)


def test_nothing_is_extrapolated(damped):
    with pytest.raises(
        ModelError,
        match=r"group 'part1': 120 Hz is outside its loss table, which goes from 1 to 100",
    ):
        updyn.response(damped, [50.0, 120.0], ["1:X"], ["1:X"])
    stiff = chain(loss_table=([1.0, 2.0], [1.0, 1.0]))
    with pytest.raises(ModelError, match=r"group 'part1': .* Hz is outside its loss table"):
        updyn.modes(stiff, 2)
    ends = updyn.response(damped, [1.0, 100.0], ["1:X"], ["1:X"])  # both ends are inside
    assert np.isfinite(ends.values).all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: m.scaled({}), lambda m: join([m])])
def test_copies_keep_all_damping(damped, copied):
    other = copied(damped)
    H = [updyn.response(m, FREQ, m.dofs, ["1:X"]).values for m in (damped, other)]
    assert H[1] == pytest.approx(H[0], rel=1e-13)
    assert other.groups["part1"].damping_words == damped.groups["part1"].damping_words


def test_constraints_keep_all_damping(damped):
    held = constrain(damped, grounded=["4:X"])
    for f in (5.0, 50.0):
        H = updyn.response(held, [f], ["1:X", "2:X", "3:X"], ["1:X", "2:X", "3:X"]).values[0]
        assert H @ stiffness_by_hand(damped, f)[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)


def test_turned_degrees_of_freedom_keep_all_damping():
    K = np.diag([3e4, 5e4])
    group = updyn.Group(
        K, np.eye(2), 0.02, mass_damping=2.0, stiffness_damping=1e-4, loss_table=TABLE
    )
    model = updyn.Model.from_groups(
        {"one": group}, ["1:X", "1:Y"], geometry=updyn.Geometry([1], [[0.0, 0.0, 0.0]])
    )
    s = np.sqrt(0.5)
    frf = updyn.FRF([10.0, 20.0], np.ones((2, 1, 1)), ["1:X"], ["1:X"], "receptance")
    turned = updyn.match(model, frf, directions={"1:X": [s, s, 0.0]}).model
    H = updyn.response(model, FREQ, ["1:X", "1:Y"], ["1:X", "1:Y"]).values
    along = 0.5 * H.sum(axis=(1, 2))
    assert updyn.response(turned, FREQ, ["1:X"], ["1:X"]).values[:, 0, 0] == pytest.approx(
        along, rel=1e-12
    )


# -- unknowns ----------------------------------------------------------------------------------------------
def everything(model):
    return updyn.parameters(model, **dict.fromkeys(GROUP_QUANTITIES, "all"))


def test_derivatives_are_those_of_differences(damped):
    unknowns = everything(damped)
    rng = np.random.default_rng(1)
    values = unknowns.start * np.exp(0.2 * rng.standard_normal(len(unknowns)))
    values = np.where(unknowns.start == 0.0, 1e-4, values)
    frf = updyn.response(damped, FREQ, damped.dofs, ["1:X", "3:X"], "accelerance")
    problem = FRFPart.build(damped, frf, unknowns)
    x = problem.coordinates.to_x(values)
    assert problem.values(x) == pytest.approx(values, rel=1e-14)
    block = problem.block(x, slice(0, len(FREQ)))
    for p in range(len(unknowns)):
        h = np.zeros(len(x))
        h[p] = 1e-5
        high, low = (
            problem.block(x + s * h, slice(0, len(FREQ)), derivatives=False).H for s in (1, -1)
        )
        difference = (high - low) / 2e-5
        scale = np.abs(difference).max()
        assert block.dH[p] == pytest.approx(difference, abs=2e-6 * scale), unknowns.names[p]


def test_the_updated_model_answers_as_the_compiled_one(damped):
    unknowns = everything(damped)
    values = np.where(unknowns.start == 0.0, 1e-4, unknowns.start * 1.3)
    frf = updyn.response(damped, FREQ, damped.dofs, ["1:X"])
    problem = FRFPart.build(damped, frf, unknowns)
    changed = unknowns.apply(damped, values)
    got = updyn.response(changed, FREQ, damped.dofs, ["1:X"]).values
    assert got == pytest.approx(problem.responses(problem.coordinates.to_x(values)), rel=1e-11)
    assert changed.groups["part1"].mass_damping == pytest.approx(3.9)
    assert changed.groups["part1"].loss_table is damped.groups["part1"].loss_table


def test_one_line_cannot_tell_the_two_dampings_of_a_stiffness_apart():
    true = chain().scaled({"part2": {"loss_factor": 0.05, "stiffness_damping": 4e-4}})
    model = chain()
    unknowns = updyn.parameters(model, loss_factor="part2", stiffness_damping="part2")
    one = updyn.response(true, [30.0], true.dofs, ["1:X"], "accelerance")
    found = updyn.update(model, one, unknowns, noise={"relative": 1e-6})
    assert found.status == "not-identifiable"
    (null,) = found.identifiability.null_directions
    assert set(null) == {"part2.loss_factor", "part2.stiffness_damping"}
    # At one line, what one gains the other loses: in the loss factor that they amount to.
    assert null["part2.loss_factor"] == pytest.approx(-null["part2.stiffness_damping"], rel=1e-6)


@pytest.mark.parametrize("method", ["maximum-likelihood", "equation-error"])
def test_many_lines_tell_all_damping(method):
    change = {
        "part1": {"mass_damping": 3.0, "loss_factor": 0.03},
        "part2": {"loss_factor": 0.05, "stiffness_damping": 4e-4, "stiffness": 1.1},
        "part3": {"viscous": 1.5},
    }
    model = chain()
    true = model.scaled(change)
    unknowns = updyn.parameters(
        model,
        stiffness="part2",
        loss_factor=["part1", "part2"],
        stiffness_damping="part2",
        mass_damping="part1",
        viscous="part3",
    )
    frf = updyn.response(true, FREQ, true.dofs, ["1:X"], "accelerance")
    found = updyn.update(model, frf, unknowns, method=method)
    for group, quantities in change.items():
        for quantity, value in quantities.items():
            assert found.values[f"{group}.{quantity}"] == pytest.approx(value, rel=1e-8), (
                group,
                quantity,
            )
    assert found.model.groups["part1"].mass_damping == pytest.approx(3.0, rel=1e-8)


def test_a_loss_factor_with_a_table_is_recovered():
    model = chain(loss_table=TABLE)
    frf = updyn.response(model.scaled({"part1": {"loss_factor": 0.07}}), FREQ, model.dofs, ["1:X"])
    found = updyn.update(model, frf, updyn.parameters(model, loss_factor="part1"))
    assert found.values["part1.loss_factor"] == pytest.approx(0.07, rel=1e-8)


def test_lines_outside_a_table_are_told_before_the_fit():
    model = chain(loss_table=([1.0, 40.0], [1.0, 2.0]))
    frf = updyn.response(chain(), FREQ, model.dofs, ["1:X"])
    with pytest.raises(ModelError, match=r"group 'part1': .* nothing is extrapolated"):
        updyn.update(model, frf, updyn.parameters(model, loss_factor="part1"))


def test_tests_of_different_bands_share_their_coordinates():
    model = chain()
    true = model.scaled({"part2": {"loss_factor": 0.05, "stiffness_damping": 4e-4}})
    unknowns = updyn.parameters(model, loss_factor="part2", stiffness_damping="part2")
    tests = [
        updyn.Test(model, updyn.response(true, band, true.dofs, ["1:X"]), name)
        for name, band in (
            ("low", np.linspace(2.0, 20.0, 12)),
            ("high", np.linspace(30.0, 60.0, 12)),
        )
    ]
    found = updyn.update_jointly(tests, unknowns)
    assert found.values["part2.stiffness_damping"] == pytest.approx(4e-4, rel=1e-8)
    assert found.values["part2.loss_factor"] == pytest.approx(0.05, rel=1e-8)


def test_a_prior_is_in_the_unit_of_the_unknown():
    """Where the data say nothing, the posterior is the prior."""
    model = chain()
    unknowns = updyn.parameters(
        model, stiffness_damping="part2", prior_std={"stiffness_damping": 3e-5}
    )
    frf = updyn.response(model, FREQ, model.dofs, ["1:X"])
    found = updyn.update(model, frf, unknowns, noise={"relative": 1e6})
    assert found.std["part2.stiffness_damping"] == pytest.approx(3e-5, rel=1e-3)


def test_a_linked_unknown_may_be_a_rayleigh_coefficient():
    model = chain()
    linked = updyn.link(model, "all.beta", "*.stiffness_damping", bounds=(0.0, 1.0))
    frf = updyn.response(linked.apply(model, [2e-4]), FREQ, model.dofs, ["1:X"])
    found = updyn.update(model, frf, linked)
    assert found.values["all.beta"] == pytest.approx(2e-4, rel=1e-8)
    assert not linked[0].is_factor
    assert linked[0].value_unit == "s"
    with pytest.raises(
        ParameterError, match="acts on stiffness dampings and on other quantities; use two unknowns"
    ):
        updyn.link(model, "mixed.beta", ["part1.stiffness_damping", "part2.loss_factor"])


# -- errors ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("damping", "text"),
    [
        ({"mass_damping": -1.0}, "mass_damping -1.0: expected a finite number of at least 0"),
        ({"stiffness_damping": "x"}, "stiffness_damping 'x': expected a number"),
        ({"stiffness_damping": np.nan}, "stiffness_damping nan: expected a finite number"),
        ({"loss_table": [1.0, 2.0, 3.0]}, "loss_table: expected two rows"),
        ({"loss_table": ([1.0, 2.0], [1.0])}, "loss_table: relative: expected two or more"),
        ({"loss_table": ([1.0, 2.0], [1.0, 2.0, 3.0])}, "loss_table: 2 lines, but 3 factors"),
        ({"loss_table": ([2.0, 1.0], [1.0, 1.0])}, "loss_table: line 1 Hz follows 2 Hz"),
        (
            {"loss_table": ([1.0, 2.0], [1.0, -1.0])},
            "loss_table: relative: expected two or more finite numbers",
        ),
        ({"loss_table": (["a", "b"], [1.0, 1.0])}, "loss_table: freq is not a row of numbers"),
    ],
)
def test_bad_damping_is_refused(damping, text):
    with pytest.raises(ModelError, match=text):
        updyn.Group([[1.0]], [[1.0]], **damping)


def test_damping_of_nothing_is_refused():
    with pytest.raises(
        ModelError, match=r"mass_damping 1: the group has no mass that it could act on"
    ):
        updyn.Group([[1.0]], mass_damping=1.0)
    with pytest.raises(ModelError, match=r"stiffness_damping 1: the group has no stiffness"):
        updyn.Group(mass=[[1.0]], stiffness_damping=1.0)
    with pytest.raises(ModelError, match=r"loss_table: the group has no stiffness"):
        updyn.Group(mass=[[1.0]], loss_table=TABLE)
    heavy = updyn.Model.from_groups(
        {"one": updyn.Group([[1.0]], [[1.0]]), "m": updyn.Group(mass=[[1.0]])}, ["1:X"]
    )
    with pytest.raises(ModelError, match=r"group 'm' has no stiffness to change"):
        heavy.scaled({"m": {"stiffness_damping": 1.0}})
    with pytest.raises(ParameterError, match=r"stiffness_damping: group 'm' has no stiffness"):
        updyn.parameters(heavy, stiffness_damping="m")
    assert updyn.parameters(heavy, stiffness_damping="all").names == ["one.stiffness_damping"]


def test_a_group_says_what_can_change_in_it():
    only = updyn.Group(mass=[[1.0]])
    assert [q for q in GROUP_QUANTITIES if only.has(q)] == ["mass", "mass_damping"]
    with pytest.raises(ModelError, match="no quantity 'mas'; did you mean 'mass'"):
        only.has("mas")


def test_what_is_compiled_tells_models_apart(damped):
    """What a checkpoint compares: rates and tables, as well as loss factors and matrices."""
    from updyn.updating.fit.checkpoint import fingerprint

    def told(model):
        frf = updyn.response(chain(), FREQ, model.dofs, ["1:X"])
        return fingerprint(
            Problem.of([FRFPart.build(model, frf, updyn.parameters(model, mass="all"))]), [frf], {}
        )["model"]

    others = [
        chain(),
        chain(mass_damping=3.0),
        chain(loss_table=TABLE),
        chain(loss_table=([1, 100], [0.5, 4.0])),
    ]
    assert len({told(m) for m in [*others, damped]}) == 5
    assert AffineSystem.compile(damped).start.rate[1] == 3.0
    assert told(damped) == told(chain(mass_damping=3.0, stiffness_damping=2e-4, loss_table=TABLE))


def test_gauss_newton_refuses_nothing_new():
    """The published iteration works in values: it takes Rayleigh coefficients as it takes loss factors."""
    model = chain()
    true = model.scaled({"part2": {"stiffness_damping": 4e-4}})
    frf = updyn.response(true, FREQ, true.dofs, true.dofs)
    unknowns = updyn.parameters(model, stiffness_damping="part2")
    found = updyn.update(model, frf, unknowns, method="equation-error", solver="gauss-newton")
    assert found.values["part2.stiffness_damping"] == pytest.approx(4e-4, rel=1e-8)
    with pytest.raises(OptionError):
        updyn.update(model, frf, unknowns, method="equation-error", solver="newton")


def test_uncertainty_is_in_the_unit_of_the_unknown():
    """Where the data say much, the profile is the estimate and 1.96 standard deviations to either side."""
    model = chain()
    true = model.scaled({"part1": {"mass_damping": 3.0}, "part2": {"stiffness_damping": 4e-4}})
    frf = updyn.response(true, FREQ, true.dofs, ["1:X"], "accelerance")
    unknowns = updyn.parameters(model, mass_damping="part1", stiffness_damping="part2")
    found = updyn.update(model, frf, unknowns, noise={"relative": 0.01})
    for name, interval in updyn.profile(found).intervals().items():
        value, std = found.values[name], found.std[name]
        assert interval == pytest.approx((value - 1.96 * std, value + 1.96 * std), abs=0.05 * std)


def test_a_model_that_was_read_gets_other_damping(damped):
    changed = damped.with_damping(
        {"part1": {"loss_table": None, "mass_damping": 0.0}, "part2": {"loss_table": TABLE}}
    )
    assert changed.groups["part1"].damping == {"loss_factor": 0.02, "stiffness_damping": 2e-4}
    assert changed.groups["part2"].loss_table.freq.tolist() == TABLE[0]
    assert changed.groups["part2"].stiffness is damped.groups["part2"].stiffness
    for damping, text in [
        ({"part9": {}}, "no group 'part9'"),
        ({"part1": {"loss": 1.0}}, "group 'part1': no damping 'loss'; .*'loss_factor'"),
        (
            {"part1": {"mass_damping": -1.0}},
            "group 'part1': mass_damping -1.0: expected a finite number of at least 0",
        ),
        ({"part1": 0.1}, "group 'part1': expected a mapping of damping by name, found 0.1"),
        (0.1, "damping: expected a mapping of group to damping, found float"),
    ]:
        with pytest.raises(ModelError, match=text):
            damped.with_damping(damping)


@pytest.mark.parametrize("tier", ["sparse", "reduced"])
def test_large_models_are_fitted_with_all_damping(tier):
    """The tiers of large models on a small one: the same answer as the dense one."""
    model = chain(12, loss_table=TABLE)
    change = {
        "part1": {"loss_factor": 0.06, "mass_damping": 3.0},
        "part2": {"stiffness_damping": 4e-4},
    }
    frf = updyn.response(model.scaled(change), FREQ, ["3:X", "12:X"], ["12:X"], "accelerance")
    unknowns = updyn.parameters(
        model, loss_factor="part1", mass_damping="part1", stiffness_damping="part2"
    )
    found = updyn.update(model, frf, unknowns, tier=tier, accuracy=1e-8)
    for group, quantities in change.items():
        for quantity, value in quantities.items():
            assert found.values[f"{group}.{quantity}"] == pytest.approx(value, rel=1e-5), quantity
