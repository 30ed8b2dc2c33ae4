"""`updyn.accept`: values against those of an analytic chain, outcomes, and what cannot be decided."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

import updyn
from cantilever import cantilever
from updyn.acceptance.computed import ComputedModes
from updyn.acceptance.effective_mass import MassShares
from updyn.errors import DataError, DofError, OptionError
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.posterior import Posterior

DOFS = ["1:X", "2:X", "3:X"]
#: Masses of 1 kg between walls, with springs of 1 N/m: omega^2 = 2 - sqrt(2), 2, 2 + sqrt(2).
OMEGA = np.sqrt([2.0 - np.sqrt(2.0), 2.0, 2.0 + np.sqrt(2.0)])
ROOT = np.sqrt(0.5)
SHAPES = np.array([[0.5, ROOT, 0.5], [ROOT, 0.0, -ROOT], [0.5, -ROOT, 0.5]])
ALL = updyn.AcceptanceLimits(
    frequency=0.05, mac=0.9, mac_off=0.05, cross=0.9, cross_off=0.1, mass_met=0.9
)


def make_model(factor=1.0):
    K = 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    group = updyn.Group(stiffness=factor * K, mass=np.eye(3))
    return updyn.Model.from_groups({"chain": group}, dofs=DOFS)


def measure(shapes=SHAPES, factor=1.0, **further):
    return updyn.ModeSet(factor * OMEGA / (2.0 * np.pi), shapes, DOFS, **further)


def by_kind(found, kind):
    return [one for one in found.requirements if one.kind == kind]


def turn(angle):
    """Shapes of the chain, the first two turned by an angle in their plane."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([SHAPES[:, :2] @ [[c, -s], [s, c]], SHAPES[:, 2]])


# -- values ----------------------------------------------------------------------------------------
def test_values_are_those_of_the_chain() -> None:
    found = updyn.accept(make_model(1.04), measure(turn(0.2)), ALL)
    error = np.sqrt(1.04) - 1.0
    assert [one.value for one in by_kind(found, "frequency")] == pytest.approx([error] * 3)
    cosines = np.array([np.cos(0.2), np.cos(0.2), 1.0])
    off = np.array([np.sin(0.2), np.sin(0.2), 0.0])
    assert [one.value for one in by_kind(found, "mac")] == pytest.approx(cosines**2)
    assert [one.value for one in by_kind(found, "mac_off")] == pytest.approx(off**2, abs=1e-12)
    # The mass at all DOFs is the identity: cross-orthogonality is the cosine.
    assert [one.value for one in by_kind(found, "cross")] == pytest.approx(cosines)
    assert [one.value for one in by_kind(found, "cross_off")] == pytest.approx(off, abs=1e-12)
    assert by_kind(found, "mass_met")[0].value == pytest.approx(1.0)
    outcomes = {one.outcome for one in by_kind(found, "cross_off")[:2]}
    assert outcomes == {"fail"}
    assert found.outcome == "fail"
    assert not found.accepted
    assert "2 fail of 19 requirements" in found.statement


def test_effective_masses_are_those_of_the_chain() -> None:
    model = make_model()
    shares = MassShares.of(SHAPES, model.mass, model.dofs)
    assert shares.directions == "X"
    assert shares.shares[:, 0] == pytest.approx((SHAPES.sum(axis=0)) ** 2 / 3.0)
    assert shares.text(0) == "97.1 % of the mass in X"


def test_effective_masses_of_a_cantilever() -> None:
    # 0.613, 0.188, 0.065 of the mass: Clamped-free beam, (2 sigma / beta)^2.
    model = cantilever(1, 60, 1.0 / 60.0)
    found = updyn.modes(model, 12)
    shares = MassShares.of(found.shapes, model.mass, model.dofs)
    mass = 7850.0 * 0.03 * 0.02 * 1.0
    effective = shares.shares[:, shares.directions.index("Z")] * shares.total[-1] / mass
    largest = np.sort(effective)[::-1][:3]
    assert largest == pytest.approx([0.6131, 0.1883, 0.0647], rel=0.03)


def test_a_mode_without_a_pair_fails() -> None:
    other = np.column_stack([SHAPES[:, 0], [1.0, 1.0, -1.0]])
    modes = updyn.ModeSet([OMEGA[0] / (2.0 * np.pi), 5.0], other, DOFS)
    (_, lost) = by_kind(updyn.accept(make_model(), modes, ALL), "pair")
    assert (lost.outcome, lost.measured) == ("fail", 5.0)


# -- probabilities -----------------------------------------------------------------------------
def test_the_probability_of_a_frequency_is_normal() -> None:
    f = OMEGA / (2.0 * np.pi)
    modes = measure(std_frequency=0.01 * f)
    limits = updyn.AcceptanceLimits(frequency=0.02)
    found = by_kind(updyn.accept(make_model(1.02**2), modes, limits), "frequency")
    # On the limit: one half, less the other tail.
    assert [one.probability for one in found] == pytest.approx([0.5] * 3, abs=1e-3)
    assert [one.probability_as_delivered for one in found] == pytest.approx([0.5] * 3, abs=1e-3)


def test_the_probability_of_mac_is_that_of_simulated_tests() -> None:
    """Of structures with a uniform angle that give the measured one, the share within the limit."""
    std, limits = 0.1, updyn.AcceptanceLimits(mac=0.9)
    rng = np.random.default_rng(0)
    angle = rng.uniform(-1.5, 1.5, 200_000)
    across = np.stack([np.sin(angle), np.zeros_like(angle)]) + std * rng.normal(size=(2, 200_000))
    along = np.cos(angle) + std * rng.normal(size=200_000)
    tangent = np.hypot(*across) / np.abs(along)
    for measured in (0.2, 0.3, 0.45):
        shape = measured * SHAPES[:, 1] + SHAPES[:, 0]
        modes = updyn.ModeSet(
            [OMEGA[0] / (2.0 * np.pi)], shape[:, None], DOFS, std_shapes=np.full((3, 1), std)
        )
        (one,) = by_kind(updyn.accept(make_model(), modes, limits), "mac")
        near = np.abs(tangent - measured) < 0.02
        truly = np.mean(np.cos(angle[near]) ** 2 > 0.9)
        assert one.probability == pytest.approx(truly, abs=0.08), measured


def test_unknowns_widen_the_probability() -> None:
    model = make_model()
    unknowns = updyn.parameters(model, stiffness="all")
    f = OMEGA / (2.0 * np.pi)
    start = measure(factor=np.array([1.02, 0.97, 1.01]))
    result = updyn.update(model, start, unknowns, method="modal", shapes=False)
    std = 0.5 * result.std["chain.stiffness"] / result.values["chain.stiffness"]
    assert 0.005 < std < 0.04
    ratio = np.sqrt(result.values["chain.stiffness"]) / 1.01
    later = measure(factor=ratio, std_frequency=0.01 * f)
    found = updyn.accept(result, later, updyn.AcceptanceLimits(frequency=0.02))
    (one, *_) = by_kind(found, "frequency")
    alone = 1.01 * 0.01 / ratio
    both = np.hypot(alone, 1.01 * std)
    for p, s in ((one.probability, both), (one.probability_as_delivered, alone)):
        assert p == pytest.approx(norm.cdf(0.01 / s) - norm.cdf(-0.03 / s), abs=0.01)
    assert one.probability < one.probability_as_delivered - 0.05


def test_unknown_deviations_give_no_probability_unless_assumed() -> None:
    limits = updyn.AcceptanceLimits(frequency=0.05, mac=0.9)
    found = updyn.accept(make_model(), measure(), limits)
    assert all(np.isnan(one.probability) for one in found.requirements)
    assert np.isnan(found.probability).all()
    assert found.accepted
    assumed = updyn.accept(make_model(), measure(), limits, std_frequency=0.01, std_shapes=0.02)
    odds = [one.probability for one in assumed.requirements if one.kind != "pair"]
    assert all(0.99 < p <= 1.0 for p in odds)
    low, high = assumed.probability
    assert 0.99 < low <= high <= 1.0
    strict = updyn.accept(make_model(), measure(), limits, least_probability=0.9)
    assert strict.outcome == "not decidable"
    assert "not known" in by_kind(strict, "mac")[0].note


def test_outcomes_by_probability() -> None:
    f = OMEGA / (2.0 * np.pi)
    modes, limits = measure(std_frequency=0.01 * f), updyn.AcceptanceLimits(frequency=0.02)
    outcomes = [
        by_kind(updyn.accept(make_model(x**2), modes, limits, least_probability=0.9), "frequency")[
            0
        ].outcome
        for x in (1.0, 1.02, 1.06)
    ]
    assert outcomes == ["pass", "not decidable", "fail"]


# -- classes of modes ----------------------------------------------------------------------------
def test_limits_by_class() -> None:
    found = updyn.accept(make_model(1.08), measure(), "ECSS-E-ST-32-11C")
    frequencies = by_kind(found, "frequency")
    assert [one.limit for one in frequencies] == [0.03, 0.1, 0.1]
    assert [one.outcome for one in frequencies] == ["fail", "pass", "pass"]
    assert [one.limit for one in by_kind(found, "mac")] == [0.9, 0.8, 0.8]
    second = updyn.accept(make_model(1.08), measure(), "ECSS-E-ST-32-11C", fundamental=[2])
    # The first is major: 97 % of the mass.
    assert [one.limit for one in by_kind(second, "frequency")] == [0.05, 0.03, 0.1]
    assert by_kind(second, "frequency")[0].note == "major mode"


def test_without_masses_only_the_outcome_of_both_limits_counts() -> None:
    for factor, outcome in ((1.06, "pass"), (1.15, "not decidable"), (1.3, "fail")):
        found = updyn.accept(make_model(factor), measure(), "ECSS-E-ST-32-11C", directions="")
        assert by_kind(found, "frequency")[1].outcome == outcome
        assert by_kind(found, "mac")[1].outcome == "pass"
    lost = updyn.accept(make_model(1.15), measure(), "ECSS-E-ST-32-11C", directions="")
    assert "effective masses are not known" in by_kind(lost, "frequency")[1].note
    only_major = updyn.AcceptanceLimits(frequency_major=0.05, effective_mass=0.1)
    for factor, outcome in ((1.06, "pass"), (1.15, "not decidable")):
        found = updyn.accept(make_model(factor), measure(), only_major, directions="")
        assert by_kind(found, "frequency")[1].outcome == outcome


def test_major_modes_that_are_not_measured() -> None:
    modes = measure().select([1, 2])
    limits = updyn.AcceptanceLimits(frequency=0.05, effective_mass=0.1, mass_met=0.9)
    found = updyn.accept(make_model(), modes, limits)
    (one,) = by_kind(found, "measured")
    assert one.outcome == "not decidable"
    assert one.computed == pytest.approx(OMEGA[0] / (2.0 * np.pi))
    assert "97.1 % of the mass in X" in one.note
    (met,) = by_kind(found, "mass_met")
    assert (met.outcome, met.value) == ("fail", pytest.approx(0.0286, abs=1e-3))


def test_a_free_structure_has_no_effective_masses() -> None:
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    model = updyn.Model.from_groups(
        {"pair": updyn.Group(stiffness=K, mass=np.eye(2))}, dofs=DOFS[:2]
    )
    modes = updyn.ModeSet([np.sqrt(2.0) / (2.0 * np.pi)], [[1.0], [-1.0]], DOFS[:2])
    found = updyn.accept(model, modes, updyn.AcceptanceLimits(mass_met=0.9))
    assert by_kind(found, "mass_met")[0].outcome == "not decidable"
    assert "The structure is free" in found.notes[-1]


# -- shapes that do not decide ---------------------------------------------------------------------
def test_frequencies_alone_and_one_sensor_leave_shapes_open() -> None:
    limits = updyn.AcceptanceLimits(frequency=0.05, mac=0.9, cross=0.9)
    alone = updyn.ModeSet(OMEGA / (2.0 * np.pi))
    one_sensor = updyn.ModeSet(OMEGA[:1] / (2.0 * np.pi), SHAPES[:1, :1], DOFS[:1])
    for modes, why in ((alone, "no shapes"), (one_sensor, "one sensor")):
        found = updyn.accept(make_model(), modes, limits)
        assert found.outcome == "not decidable"
        assert {one.outcome for one in by_kind(found, "frequency")} == {"pass"}
        assert all(why in one.note for kind in ("mac", "cross") for one in by_kind(found, kind))


def test_the_error_of_the_reduction_leaves_cross_orthogonality_open() -> None:
    sensors = DOFS[:2]
    modes = updyn.ModeSet(OMEGA / (2.0 * np.pi), SHAPES[:2], sensors)
    limits = updyn.AcceptanceLimits(cross=0.9, cross_off=0.1)
    found = updyn.accept(make_model(), modes.select([0, 2]), limits)
    # Guyan: u3 = u2 / 2, M = diag(1, 1.25); modal masses 0.25 + 0.625 and 0.25 + 0.625.
    assert "reduction error 0.125" in by_kind(found, "cross")[0].note
    assert by_kind(found, "cross")[0].outcome == "not decidable"


def test_close_modes_are_compared_by_their_subspace() -> None:
    K = np.diag([1.0, 1.002, 4.0])
    model = updyn.Model.from_groups({"a": updyn.Group(stiffness=K, mass=np.eye(3))}, dofs=DOFS)
    c, s = np.cos(0.7), np.sin(0.7)
    shapes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    modes = updyn.ModeSet(
        np.sqrt(np.diag(K)) / (2.0 * np.pi), shapes, DOFS, std_shapes=np.full((3, 3), 0.01)
    )
    limits = dataclasses.replace(ALL, mass_met=None, frequency=None)
    found = updyn.accept(model, modes, limits)
    assert found.accepted
    assert [one.value for one in by_kind(found, "mac")] == pytest.approx([1.0] * 3)
    assert "subspaces" in by_kind(found, "mac")[0].note
    assert all(one.probability > 0.99 for one in by_kind(found, "mac"))


# -- options ---------------------------------------------------------------------------------------
def test_unknown_standard_names_the_nearest() -> None:
    with pytest.raises(OptionError, match="did you mean 'NASA-STD-5002'"):
        updyn.accept(make_model(), measure(), "NASA-STD-5001")


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"frequency": 0.0}, "frequency = 0: expected a share above 0"),
        ({"mac": 90.0}, "mac = 90: expected a share"),
        ({"mac_major": 0.9}, "mac_major: expected effective_mass too"),
    ],
)
def test_limits_out_of_range(limits, message) -> None:
    with pytest.raises(OptionError, match=message):
        updyn.AcceptanceLimits(**limits)


def test_changed_limits_are_named() -> None:
    from updyn.acceptance.standards import STANDARDS

    changed = STANDARDS["NASA-STD-5002"].with_changes(frequency=0.03)
    assert (changed.frequency, changed.cross, changed.changed) == (0.03, 0.9, ("frequency",))
    with pytest.raises(OptionError, match="did you mean 'frequency'"):
        changed.with_changes(frequencies=0.1)


def test_bad_options() -> None:
    model = make_model()
    with pytest.raises(DataError, match="expected measured modes, found NoneType"):
        updyn.accept(model)
    with pytest.raises(OptionError, match="mode 4; expected numbers from 1 to 3"):
        updyn.accept(model, measure(), fundamental=[4])
    with pytest.raises(OptionError, match="directions 'XW'"):
        updyn.accept(model, measure(), directions="XW")
    with pytest.raises(OptionError, match="std_shapes = 5: expected a share"):
        updyn.accept(model, measure(), std_shapes=5)
    with pytest.raises(OptionError, match=r"least_probability = 95: .* such as 0\.95") as found:
        updyn.accept(model, measure(), least_probability=95)
    assert found.value.key == ("least_probability",)
    with pytest.raises(DataError, match="a measured mode at 0 Hz"):
        updyn.accept(model, updyn.ModeSet([0.0, 0.1]))
    with pytest.raises(DofError):
        updyn.accept(model, updyn.ModeSet([1.0], [[1.0]], ["9:X"]))
    with pytest.raises(DataError, match="no elastic mode up to"):
        updyn.accept(model, updyn.ModeSet([0.01], [[1.0], [1.0]], DOFS[:2]))


def test_a_band_selects_measured_modes() -> None:
    found = updyn.accept(make_model(), measure(), ALL, band=(0.0, 0.15))
    assert len(by_kind(found, "pair")) == 1


def test_modes_left_out_are_named() -> None:
    frequencies = OMEGA / (2.0 * np.pi)
    found = updyn.accept(make_model(), measure(), ALL, leave_out=[1.005 * frequencies[1]])
    assert [one.measured for one in by_kind(found, "pair")] == list(frequencies[[0, 2]])
    assert found.notes[-1] == "Measured modes left out by the user: 0.22508 Hz."
    with pytest.raises(OptionError, match=r"no measured mode at 0\.228 Hz; the nearest is at"):
        updyn.accept(make_model(), measure(), ALL, leave_out=[0.228])


def test_table_and_summary() -> None:
    found = updyn.accept(make_model(), measure(std_frequency=[1e-4] * 3), "NASA-STD-5002")
    table = found.to_pandas()
    assert list(table["kind"][:4]) == ["pair", "frequency", "cross", "cross_off"]
    text = found.summary()
    assert text.startswith("Acceptance by NASA-STD-5002: pass; all of 12 requirements pass.")
    assert "at most 5.00 %" in text
    assert "NASA-STD-5002: pass" in repr(found)
    assert "frequency" in found._repr_html_()


# -- sources -----------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def noisy_update():
    start = measure(factor=np.array([1.02, 0.97, 1.01]))
    unknowns = updyn.parameters(make_model(), stiffness="all")
    return updyn.update(make_model(), start, unknowns, method="modal", shapes=False)


def test_modes_of_the_update_are_the_default(noisy_update) -> None:
    limits = updyn.AcceptanceLimits(frequency=0.05)
    found = updyn.accept(noisy_update, standard=limits)
    expected = updyn.accept(noisy_update.model, noisy_update.data, limits)
    values = [[one.value for one in by_kind(each, "frequency")] for each in (found, expected)]
    assert values[0] == pytest.approx(values[1])


def test_draws_give_the_uncertainty_of_the_unknowns(noisy_update) -> None:
    modes = measure(std_frequency=0.01 * OMEGA / (2.0 * np.pi))
    limits, value = updyn.AcceptanceLimits(frequency=0.02), noisy_update.values["chain.stiffness"]
    odds = []
    for std in (0.01, 0.2):
        chain = value * (1.0 + std * np.array([-1.0, 0.0, 1.0]))
        numbers = [np.array([x]) for x in (value, std, 0.0, 9.0, 1.0)]
        drawn = Draws("sampling", ("chain.stiffness",), chain[None, :, None], *numbers)
        (one, *_) = by_kind(updyn.accept(drawn.of(noisy_update), modes, limits), "frequency")
        odds.append((one.probability, one.probability_as_delivered))
    error = np.sqrt(value) - 1.0
    for (found, delivered), std in zip(odds, (0.01, 0.2), strict=True):
        total = np.sqrt(value) * np.hypot(0.01, 0.5 * std)
        expected = norm.cdf((0.02 - error) / total) - norm.cdf((-0.02 - error) / total)
        assert found == pytest.approx(expected, rel=0.01)
        assert delivered == pytest.approx(odds[0][1])


def test_one_of_several_tests_is_selected() -> None:
    model, unknowns = make_model(), updyn.parameters(make_model(), stiffness="all")
    tests = [
        updyn.Test(model, measure(factor=factor), name)
        for name, factor in (("a", 1.0), ("b", np.array([1.01, 0.99, 1.0])))
    ]
    result = updyn.update_jointly(tests, unknowns, method="modal", shapes=False)
    limits = updyn.AcceptanceLimits(frequency=0.05)
    found = updyn.accept(result, standard=limits, test="b")
    assert by_kind(found, "frequency")[0].measured == pytest.approx(1.01 * OMEGA[0] / (2.0 * np.pi))
    with pytest.raises(OptionError, match="which test's model is meant"):
        updyn.accept(result, standard=limits)


def test_undetermined_unknowns_give_no_probability() -> None:
    """Stiffness and mass of the whole model: only their ratio is known from frequencies."""
    model = make_model()
    split = {
        "springs": updyn.Group(stiffness=model.stiffness.toarray()),
        "masses": updyn.Group(mass=np.eye(3)),
        "tip": updyn.Group(stiffness=np.diag([0.0, 0.0, 0.5])),
    }
    model = updyn.Model.from_groups(split, dofs=DOFS)
    unknowns = updyn.parameters(model, stiffness=["springs", "tip"])
    modes = updyn.ModeSet(updyn.modes(model, 3).frequency[:1] * 1.01)
    result = updyn.update(model, modes, unknowns, method="modal")
    three = measure(std_frequency=0.01 * OMEGA / (2.0 * np.pi))
    found = updyn.accept(result, three, updyn.AcceptanceLimits(frequency=0.2))
    odds = [one.probability for one in by_kind(found, "frequency")]
    assert np.isnan(odds[1:]).all()
    delivered = [one.probability_as_delivered for one in by_kind(found, "frequency")]
    assert np.isfinite(delivered).all()


def test_the_mass_that_is_met_is_uncertain() -> None:
    """The share of a mode that an uncertain mass changes, against differences of models."""
    groups = {
        "springs": updyn.Group(
            stiffness=make_model().stiffness.toarray(), mass=np.diag([1.0, 1.0, 0.0])
        ),
        "tip": updyn.Group(mass=np.diag([0.0, 0.0, 1.0])),
    }
    model = updyn.Model.from_groups(groups, dofs=DOFS)
    unknowns = updyn.parameters(model, mass=["tip"])
    modes = measure(factor=np.array([1.02, 0.97, 1.01]))
    result = updyn.update(model, modes, unknowns, method="modal", shapes=False)
    std, value = result.std["tip.mass"], result.values["tip.mass"]

    def share(mass):
        one = model.scaled({"tip": {"mass": mass}})
        return MassShares.of(updyn.modes(one, 1).shapes, one.mass, one.dofs).shares[0, 0]

    at, slope = share(value), (share(value + 1e-4) - share(value - 1e-4)) / 2e-4
    limit = at + 0.5 * abs(slope) * std
    limits = updyn.AcceptanceLimits(mass_met=limit)
    (one,) = by_kind(updyn.accept(result, modes.select([0]), limits), "mass_met")
    assert one.value == pytest.approx(at)
    assert one.outcome == "fail"
    assert one.probability == pytest.approx(norm.cdf(-0.5), abs=0.02)
    assert one.probability_as_delivered == 0.0


def test_the_spread_of_modes_is_that_of_changed_models() -> None:
    base = make_model()
    groups = {
        "walls": updyn.Group(stiffness=base.stiffness.toarray(), mass=np.diag([1.0, 1.0, 0.0])),
        "tip": updyn.Group(stiffness=np.diag([0.0, 0.0, 0.5]), mass=np.diag([0.0, 0.0, 1.0])),
    }
    model = updyn.Model.from_groups(groups, dofs=DOFS)
    unknowns = updyn.parameters(model, stiffness=["tip"], mass=["tip"])
    found = updyn.modes(model, 3)
    noisy = updyn.ModeSet(found.frequency * [1.001, 0.9995, 1.0], found.shapes, DOFS)
    result = updyn.update(model, noisy, unknowns, method="modal", shapes=False)
    computed = ComputedModes.of_update(result, result, 10.0, None)
    spread, root = computed.spread(0), Posterior.of(result).root
    values = np.array([result.values[p.name] for p in result.parameters])
    for i, step in enumerate(root.T):
        ends = []
        for sign in (1.0, -1.0):
            one = updyn.modes(result.parameters.apply(model, values + sign * step), 1)
            turn = np.sign(one.shapes[:, 0] @ computed.shapes[:, 0])
            ends.append(np.append(turn * one.shapes[:, 0], one.frequency[0]))
        change = 0.5 * (ends[0] - ends[1])
        assert spread.shape[:, i] == pytest.approx(change[:-1], abs=1e-6)
        assert spread.frequency[i] == pytest.approx(change[-1], abs=1e-7)
    assert np.abs(spread.shape).max() > 1e-4
