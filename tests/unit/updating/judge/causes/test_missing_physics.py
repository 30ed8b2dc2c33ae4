"""Springs, masses and viscous damping that a model lacks are named, and not blamed on the data."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse

import updyn
from updyn.updating.judge.causes import diagnosis
from updyn.updating.judge.causes.altered import AlteredPart
from updyn.updating.judge.causes.element import AddedElement
from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.fault import divide_odds
from updyn.updating.judge.causes.halves import compare_band_halves
from updyn.updating.judge.causes.misfit import WeightedData
from updyn.updating.judge.causes.missing_mass import MissingMass
from updyn.updating.judge.causes.missing_spring import MissingSpring
from updyn.updating.judge.causes.missing_viscous import MissingViscous
from updyn.updating.judge.causes.proportional import ProportionalDamping
from updyn.updating.judge.causes.screening import _Screening, select_elements
from updyn.updating.judge.causes.trial import run_trial
from updyn.updating.judge.causes.window import WindowDamping
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]
FORCES = ["5:X", "12:X"]
LINES = np.linspace(0.6, 22.0, 100)
ELEMENTS = [
    AddedElement("stiffness", ("2:X", "7:X"), True, 900.0, 0.02),
    AddedElement("viscous", ("10:X",), False, 6.0),
    AddedElement("mass", ("5:X", "12:X"), False, 0.2),
]


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


def with_element(model, element):
    u = np.zeros((model.n_dofs, len(element.labels)))
    for i, label in enumerate(element.labels):
        u[model.dofs.labels.index(label), i] = 1.0
    u = u @ element.incidence
    group = updyn.Group(**{element.quantity: element.value * u @ u.T}, loss_factor=element.loss)
    return updyn.Model.from_groups({**model.groups, "more": group}, model.dofs)


def measured(model, add_noise, seed=3, **options):
    frf = updyn.response(model, LINES, SENSORS, FORCES, **options)
    return add_noise(frf, np.random.default_rng(seed), 0.01)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize(("quantity", "decay"), [("receptance", 0.0), ("accelerance", 0.4)])
def test_a_part_with_an_element_is_that_of_a_model_with_it(
    chain12, unknowns, element, quantity, decay
):
    where = (LINES[::9], ["2:X", "5:-X", "7:X"], ["5:X", "9:X"], quantity)
    frf = updyn.response(chain12, *where, decay=decay)
    part = FRFPart.build(chain12, frf, unknowns)
    true = FRFPart.build(with_element(chain12, element), frf, unknowns)
    x = part.coordinates.start + 0.05
    altered = AlteredPart.of(part, element)
    wanted = true.block(x, slice(None))
    for one in (altered, pickle.loads(pickle.dumps(altered))):  # noqa: S301
        found = one.block(x, slice(None))
        np.testing.assert_allclose(found.H, wanted.H, rtol=1e-10)
        np.testing.assert_allclose(found.dH, wanted.dH, atol=1e-10 * np.abs(wanted.dH).max())
    there = Evidence(replace(part, frf=frf), x).receptances
    if set(element.labels) <= set(there.dofs.labels):
        ratio = np.exp(there.log_change(element))
        np.testing.assert_allclose(ratio * part.responses(x), wanted.H, rtol=1e-10)
        step = 1e-4 * element.value
        low, high = (
            there.log_change(replace(element, value=element.value + h)) for h in (-step, step)
        )
        slope = there.slope(element)
        level = np.abs(slope).max()
        np.testing.assert_allclose(slope, (high - low) / (2.0 * step), atol=1e-6 * level)
        # On the part that has it, the same change counts from 0.
        beyond = Evidence(altered, x).receptances.slope(replace(element, value=0.0))
        np.testing.assert_allclose(slope, beyond, atol=1e-10 * level)


@pytest.mark.parametrize(
    ("name", "value"),
    [("part2.stiffness_damping", 1e-3), ("all.mass_damping", 0.4), ("part1.mass_damping", 0.4)],
)
def test_slopes_by_rayleigh_coefficients(chain12, unknowns, name, value):
    frf = updyn.response(chain12, LINES[::9], ["2:X", "5:-X"], ["5:X"], "mobility")
    part = FRFPart.build(chain12, frf, unknowns)
    x = part.coordinates.start + 0.05
    fault = ProportionalDamping((name,), value)
    group, quantity = name.split(".")
    groups = list(chain12.groups) if group == "all" else [group]

    def log_response(amount):
        damped = chain12.with_damping({one: {quantity: amount} for one in groups})
        return np.log(FRFPart.build(damped, frf, unknowns).responses(x))

    altered = fault.correct_part(part, x)
    np.testing.assert_allclose(np.log(altered.responses(x)), log_response(value), rtol=1e-10)
    step = 1e-4 * value
    slope = (log_response(value + step) - log_response(value - step)) / (2.0 * step)
    level = np.abs(slope).max()
    np.testing.assert_allclose(fault.slope(Evidence(part, x)), slope, atol=1e-6 * level)
    beyond = replace(fault, value=0.0).slope(Evidence(altered, x))
    np.testing.assert_allclose(beyond, slope, atol=1e-6 * level)


@pytest.mark.parametrize(
    ("cause", "element"),
    [
        (MissingSpring, AddedElement("stiffness", ("2:X", "7:X"), True, 900.0, 0.02)),
        (MissingSpring, AddedElement("stiffness", ("10:X",), False, 1500.0, 0.02)),
        (MissingMass, AddedElement("mass", ("7:X",), False, 0.4)),
        (MissingViscous, AddedElement("viscous", ("12:X",), False, 3.0)),
    ],
)
def test_what_the_model_lacks_is_named_and_added(
    chain12, chain12_true, unknowns, add_noise, cause, element
):
    frf = measured(with_element(chain12_true, element), add_noise)
    (found,) = updyn.diagnose(chain12, frf, unknowns)
    assert (found.kind, found.channels) == (cause.kind, element.labels)
    assert found.value == pytest.approx(element.value, rel=0.05)
    assert found.odds > 100.0
    assert found.written == ""
    with pytest.raises(updyn.UpdynError, match="Look for it there"):
        found.repair(frf)
    # The lines of the remedy give the model what it lacks.
    assert found.step.place == "in Python"
    assert len("; ".join(found.step.lines)) < 180
    known = {"model": chain12_true, "unknowns": unknowns, "updyn": updyn}
    exec("\n".join(found.step.lines), known)
    there = updyn.response(known["model"], LINES, SENSORS, FORCES).values
    wanted = updyn.response(with_element(chain12_true, element), LINES, SENSORS, FORCES).values
    assert np.median(np.abs(there / wanted - 1.0)) < 0.01
    assert known["unknowns"].names[-1].endswith(f".{element.quantity}")


@pytest.mark.parametrize("name", ["all.mass_damping", "part3.stiffness_damping"])
def test_viscous_damping_of_groups_is_no_window(chain12, chain12_true, unknowns, add_noise, name):
    group, quantity = name.split(".")
    groups = list(chain12_true.groups) if group == "all" else [group]
    value = {"mass_damping": 0.8, "stiffness_damping": 1e-3}[quantity]
    true = chain12_true.with_damping({one: {quantity: value} for one in groups})
    (found,) = updyn.diagnose(chain12, measured(true, add_noise), unknowns)
    assert found.kind == "missing-viscous"
    assert found.channels == (name,) or f"missing-viscous:{name}" in found.also
    assert found.value == pytest.approx(value, rel=0.05)


def test_a_window_that_is_not_told_from_missing_damping_is_named_with_it(
    chain12, chain12_true, unknowns, add_noise
):
    """Of receptances at some distance from 0 Hz both are the same but for a^2 M."""
    frf = measured(chain12_true, add_noise, decay=0.15)
    (found,) = updyn.diagnose(chain12, replace(frf, decay=0.0), unknowns)
    named = {found.kind, *(other.partition(":")[0].partition("=")[0] for other in found.also)}
    assert named == {"window-damping", "missing-viscous"}
    assert "The settings of the analyser, or a record" in found.statement


def test_a_window_in_one_half_of_the_band_is_no_fact(chain12, chain12_true, unknowns, add_noise):
    plain = updyn.response(chain12_true, LINES, SENSORS, FORCES)
    damped = updyn.response(chain12_true, LINES, SENSORS, FORCES, decay=0.8)
    values = np.where((LINES > 11.0)[:, None, None], damped.values, plain.values)
    frf = add_noise(replace(plain, values=values), np.random.default_rng(3), 0.01)
    found = updyn.diagnose(chain12, frf, unknowns)
    assert "window-damping" not in [one.kind for one in found]


@pytest.mark.parametrize(("apart", "kinds"), [(2.9, ["window-damping"]), (3.1, [])])
def test_how_far_the_halves_of_the_band_may_be_apart(
    chain12, chain12_true, unknowns, add_noise, monkeypatch, apart, kinds
):
    monkeypatch.setattr(diagnosis, "compare_band_halves", lambda *_: apart)
    frf = measured(chain12_true, add_noise, quantity="accelerance", decay=0.5)
    found = updyn.diagnose(chain12, replace(frf, decay=0.0), unknowns)
    assert [one.kind for one in found if one.kind == "window-damping"] == kinds


def test_the_difference_of_the_halves_is_counted_in_its_deviations(chain12, unknowns, add_noise):
    """With one size everywhere it is a standard normal number; with two it is far beyond."""
    frf = updyn.response(chain12, LINES, SENSORS, FORCES)
    part = FRFPart.build(chain12, frf, unknowns)
    x = part.coordinates.start
    lower = (np.arange(len(LINES)) < len(LINES) // 2)[:, None, None]
    spread = []
    for seed in range(60):
        data = add_noise(frf, np.random.default_rng(seed), 0.01)
        data = replace(data, variance=(0.01 * np.abs(frf.values)) ** 2)
        spread.append(compare_band_halves(Evidence(part.with_data(data), x), WindowDamping(), 0.0))
    assert np.sqrt(np.mean(np.square(spread))) == pytest.approx(1.0, abs=0.3)
    slope = WindowDamping().slope(Evidence(part.with_data(data), x))
    bent = replace(data, values=data.values * np.exp(np.where(lower, -0.05, 0.05) * slope))
    assert compare_band_halves(Evidence(part.with_data(bent), x), WindowDamping(), 0.0) > 10.0


@pytest.fixture(scope="module")
def silent(chain12, unknowns, add_noise):
    """Model and data of the chain, without and with five sensors that measure only noise."""
    n, extra = chain12.n_dofs, [f"{i}:X" for i in range(21, 26)]
    groups = {
        name: updyn.Group(
            scipy.sparse.block_diag([g.stiffness, np.zeros((5, 5))]),
            scipy.sparse.block_diag([g.mass, np.zeros((5, 5))]),
            loss_factor=g.loss_factor,
        )
        for name, g in chain12.groups.items()
    }
    apart = np.diag([0.0] * n + [1.0] * 5)
    groups["apart"] = updyn.Group(1e3 * apart, apart)
    model = updyn.Model.from_groups(groups, [*chain12.dofs.labels, *extra])
    clean = updyn.response(chain12, LINES, SENSORS, FORCES)
    floor = 1e-4 * np.sqrt(np.mean(np.abs(clean.values) ** 2))
    variance = (0.01 * np.abs(clean.values)) ** 2 + floor**2
    rng = np.random.default_rng(5)
    noise = floor * np.sqrt(0.5) * (rng.standard_normal((2, 100, 5, 2)))
    few = replace(add_noise(clean, rng, 0.01, 1e-4), variance=variance)
    more = updyn.FRF(
        LINES,
        np.concatenate([few.values, noise[0] + 1j * noise[1]], axis=1),
        [*SENSORS, *extra],
        FORCES,
        "receptance",
        variance=np.concatenate([variance, np.full(noise[0].shape, floor**2)], axis=1),
    )
    return [FRFPart.build(model, frf, unknowns) for frf in (few, more)]


def weighed(part):
    H = part.responses(part.coordinates.start)
    return part.with_data(WeightedData.near_response(H, part.frf, part.frf.variance))


@pytest.mark.parametrize("taken", [lambda part: part, weighed])
def test_sensors_that_measure_only_noise_do_not_change_the_odds(silent, taken):
    fault = ProportionalDamping(("part3.stiffness_damping",), 1e-4)
    gains = []
    for part in map(taken, silent):
        home = [part.coordinates.start]
        trials = [run_trial(part, one, home) for one in (None, fault)]
        gains.append(trials[1].gain(trials[0], 0.0))
    # Of all values that count, twice as many, one number costs ln(2) / 2 more.
    assert gains[1] == pytest.approx(gains[0], abs=0.4)


def test_sensors_that_measure_only_noise_do_not_change_the_halves(silent):
    fault = WindowDamping((), 0.05)
    apart = [
        compare_band_halves(Evidence(fault.correct_part(part, x), x), fault, 0.0)
        for part in silent
        for x in [part.coordinates.start]
    ]
    assert apart[1] == pytest.approx(apart[0], rel=0.05)


def test_a_spring_is_named_in_data_without_noise(chain12, chain12_true, unknowns):
    """The halves of the band contradict each other there by the last steps of the fit alone."""
    element = AddedElement("stiffness", ("7:X",), False, 200.0, 0.02)
    frf = updyn.response(with_element(chain12_true, element), LINES, SENSORS, FORCES)
    (found,) = updyn.diagnose(chain12, frf, unknowns)
    assert (found.kind, found.channels) == ("missing-spring", ("7:X",))
    assert found.value == pytest.approx(200.0, rel=1e-3)


def test_places_share_the_odds_of_a_kind():
    """Ten places at least: one is no likelier than a fault of one sensor, 1e-3."""
    assert divide_odds(1e-2, 4) == pytest.approx(1e-3)
    assert divide_odds(1e-2, 50) == pytest.approx(2e-4)
    assert MissingSpring(("2:X",), 1.0, n_places=50).prior == pytest.approx(2e-4)
    assert ProportionalDamping(("a.mass_damping",), 1.0, n_places=50).prior == pytest.approx(2e-4)


def test_damping_in_place_of_a_window_shares_the_odds_of_its_kind(chain12, unknowns):
    part = FRFPart.build(chain12, updyn.response(chain12, LINES, SENSORS, FORCES), unknowns)
    (found,) = WindowDamping((), 0.5).list_similar_faults(part)
    rates = 2 * (len(chain12.groups) + 1)
    assert found.prior == pytest.approx(1e-2 / (5 + 10 + rates))


def test_the_likeliest_of_many_places_is_seen_to_first_order(chain12_true, unknowns, add_noise):
    element = AddedElement("stiffness", ("2:X", "10:X"), True, 900.0, 0.02)
    frf = measured(with_element(chain12_true, element), add_noise)
    frf = replace(frf, variance=choose_noise(None, frf).initial_variance(frf))
    part = FRFPart.build(chain12_true, frf, unknowns)
    every = [AddedElement("stiffness", *at, 0.0, 0.02) for at in MissingSpring.list_places(part)]
    assert len(every) == 5 + 10
    best = select_elements(Evidence(part, part.coordinates.start), every, 3)
    assert best[0].labels == element.labels


@pytest.fixture(scope="module")
def solid():
    """Two coupled nodes with three translations each, and a rotation."""
    rng = np.random.default_rng(1)
    A = rng.standard_normal((7, 7))
    group = updyn.Group(1e4 * (A @ A.T + np.eye(7)), np.eye(7), loss_factor=0.03)
    labels = ["1:X", "1:Y", "1:Z", "2:X", "2:Y", "2:Z", "2:RZ"]
    return updyn.Model.from_groups({"solid": group}, labels)


def solid_part(solid, model):
    sensors = ["1:X", "2:Y", "2:RZ"]
    frf = updyn.response(model, np.linspace(2.0, 40.0, 50), sensors, ["1:X"], "accelerance")
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    return FRFPart.build(solid, frf, updyn.parameters(solid, stiffness="all"))


@pytest.mark.parametrize("kind", [MissingSpring, MissingMass])
def test_the_gain_of_an_element_is_that_of_one_more_column(solid, kind):
    """A mass acts in three directions, a spring in one or between two."""
    true = with_element(solid, AddedElement("mass", ("1:X", "1:Y", "1:Z"), False, 0.1))
    part = solid_part(solid, true)
    evidence = Evidence(part, part.coordinates.start)
    elements = [AddedElement(kind.quantity, *at, 0.0, kind.loss) for at in kind.list_places(part)]
    gains = _Screening(evidence).compute_gains(elements)
    A, b = evidence.jacobian_with_prior, evidence.misfit_with_prior
    without = np.linalg.lstsq(A, b)[1][0]
    for element, gain in zip(elements, gains, strict=True):
        change = evidence.weight * evidence.receptances.slope(element) / evidence.rms_misfit
        column = np.concatenate([stack_real_imag(change), np.zeros(part.n)])
        column /= np.linalg.norm(column)
        x, remaining, *_ = np.linalg.lstsq(np.column_stack([A, column]), b)
        expected = without - remaining[0] if x[-1] > 0.0 else 0.0
        assert gain == pytest.approx(expected, rel=1e-6, abs=1e-9 * without)
    assert gains.max() > 0.01 * without


def test_a_mass_acts_in_all_translations_of_a_measured_node(solid):
    found = [labels for labels, _ in MissingMass.list_places(solid_part(solid, solid))]
    assert found == [("1:X", "1:Y", "1:Z"), ("2:Y", "2:X", "2:Z"), ("2:RZ",)]
    assert MissingMass(("2:RZ",), 0.1).statement() == "The model lacks a mass of 0.1 kg m2 at 2:RZ."
    assert MissingMass(found[1], 0.1).statement() == "The model lacks a mass of 0.1 kg at node 2."


def test_a_mass_changes_unmeasured_translations_exactly(solid):
    heavier = solid.with_element("mass", ["2:X", "2:Y", "2:Z"], mass=0.3)
    part, true = solid_part(solid, solid), solid_part(solid, heavier)
    evidence = Evidence(part, part.coordinates.start)
    change = evidence.receptances.log_change(
        AddedElement("mass", ("2:Y", "2:X", "2:Z"), False, 0.3)
    )
    np.testing.assert_allclose(np.exp(change), true.frf.values / part.frf.values, rtol=1e-10)


@pytest.mark.parametrize("seed", [0, 6])
def test_a_wrong_held_loss_factor_is_no_missing_dashpot(gear_train, add_noise, seed):
    """Unit 3 of the paper's gear train has a loss factor of 0.6, and the model none."""
    rng = np.random.default_rng(seed)
    off = {
        name: {"stiffness": 1.0 + rng.uniform(-0.3, 0.3), "mass": 1.0 + rng.uniform(-0.13, 0.13)}
        for name in gear_train.groups
    }
    off["unit 3"]["loss_factor"] = 0.0
    lines = np.geomspace(2.0, 1000.0, 60) / (2.0 * np.pi)
    frf = updyn.response(gear_train, lines, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    sought = updyn.parameters(gear_train, stiffness="all", mass="all")
    assert not updyn.diagnose(gear_train.scaled(off), add_noise(frf, rng, 0.01, 1e-3), sought)
