"""Causes that lie in the structure: another state, other supports, a mode that the model lacks."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.demos import beam
from updyn.errors import DataError, OptionError
from updyn.job.load import load_job
from updyn.job.prepare import prepare
from updyn.model import Group, Model
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.data_alone import with_variance
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.holding import is_free, list_ground_springs
from updyn.updating.judge.causes.missing_mode import MissingMode
from updyn.updating.judge.causes.other_test import OtherTest
from updyn.updating.judge.causes.trial import free_held_quantities, raise_loss_factors, run_trial
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]
FREQ = np.linspace(0.6, 22.0, 100)


def all_unknowns(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture(scope="module")
def clean(chain12_true):
    return updyn.response(chain12_true, FREQ, SENSORS, ["5:X", "12:X"])


@pytest.fixture
def data(clean, add_noise):
    return add_noise(clean, np.random.default_rng(3), 0.01)


def on_springs(model, name, at, stiffness):
    labels = [str(dof) for dof in model.dofs]
    K = np.zeros((len(labels), len(labels)))
    for label in at:
        K[labels.index(label), labels.index(label)] = stiffness
    return Model.from_groups({**model.groups, name: Group(K, loss_factor=0.02)}, model.dofs)


def without_ground(model):
    groups = {}
    for name, group in model.groups.items():
        K = group.stiffness.toarray()
        groups[name] = replace(group, stiffness=K - np.diag(K.sum(axis=1)))
    return Model.from_groups(groups, model.dofs)


# -- another test
def test_a_sensor_of_another_state_is_found_and_left_out(
    chain12, chain12_true, clean, data, add_noise
):
    """All stiffnesses were 15 % higher when it was measured: resonances at sqrt(1.15)."""
    stiffer = {name: {"stiffness": 1.15} for name in chain12_true.groups}
    other = updyn.response(chain12_true.scaled(stiffer), FREQ, SENSORS, ["5:X", "12:X"])
    values = data.values.copy()
    values[:, 2] = add_noise(other, np.random.default_rng(4), 0.01).values[:, 2]
    bad = replace(data, values=values)
    (found,) = updyn.diagnose(chain12, bad, all_unknowns(chain12))
    assert (found.kind, found.channels) == ("other-test", ("7:X",))
    assert np.exp(-2.0 * found.value) == pytest.approx(1.15, rel=0.01)
    assert f"{np.exp(-found.value):.4g} times" in found.statement
    left = found.repair(bad)
    assert left.responses.labels == ["2:X", "5:X", "10:X", "12:X"]
    assert left.values == pytest.approx(data.values[:, [0, 1, 3, 4]])


def test_a_sensor_of_another_state_is_found_where_a_resonance_is_sharp(gear_train, add_noise):
    """Only shifts within a few per cent of the true one fit better than none."""
    freq = np.geomspace(2.0, 1000.0, 60) / (2.0 * np.pi)
    labels = [f"{i}:RZ" for i in range(1, 5)]
    rng = np.random.default_rng(2)
    softer = gear_train.scaled({name: {"stiffness": 0.94} for name in gear_train.groups})
    own, other = (
        add_noise(updyn.response(model, freq, labels, ["2:RZ"]), rng, 0.01, 1e-3)
        for model in (gear_train, softer)
    )
    values = own.values.copy()
    values[:, 2] = other.values[:, 2]
    off = {
        name: {"stiffness": 1.0 + rng.uniform(-0.3, 0.3), "loss_factor": 0.0}
        for name in gear_train.groups
    }
    found = updyn.diagnose(gear_train.scaled(off), replace(own, values=values))
    assert [(one.kind, one.channels) for one in found] == [("other-test", ("3:RZ",))]
    assert np.exp(-2.0 * found[0].value) == pytest.approx(0.94, rel=0.01)


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_sensors_either_may_be_of_another_state(chain12, chain12_true, add_noise, wrong):
    """The whole structure with one factor on its stiffness explains the other one alike."""
    labels, rng = ["5:X", "12:X"], np.random.default_rng(4)
    stiffer = chain12_true.scaled({name: {"stiffness": 1.15} for name in chain12_true.groups})
    own, other = (
        add_noise(updyn.response(model, FREQ, labels, ["12:X"], "accelerance"), rng, 0.01)
        for model in (chain12_true, stiffer)
    )
    values = own.values.copy()
    values[:, wrong] = other.values[:, wrong]
    (found,) = updyn.diagnose(chain12, replace(own, values=values), all_unknowns(chain12))
    (also,) = found.also
    named = {found.channels: found.value, read_fault(also).channels: read_fault(also).value}
    assert named.keys() == {("5:X",), ("12:X",)}
    assert np.exp(-2.0 * named[labels[wrong],]) == pytest.approx(1.15, rel=0.02)
    assert np.exp(2.0 * named[labels[1 - wrong],]) == pytest.approx(1.15, rel=0.02)
    assert "do not distinguish this from another cause" in found.statement


def test_the_stiffness_of_another_state_is_undone_exactly(chain12_true, clean):
    """K and s K have the accelerances A(f) and A(f / sqrt(s)), in any quantity."""
    stiffer = {name: {"stiffness": 1.2} for name in chain12_true.groups}
    for quantity in ("receptance", "mobility", "accelerance"):
        sound = clean.converted(quantity)
        other = updyn.response(
            chain12_true.scaled(stiffer), FREQ, SENSORS, ["5:X", "12:X"], quantity
        )
        bad = replace(sound, values=np.concatenate([other.values[:, :1], sound.values[:, 1:]], 1))
        part = FRFPart.build(chain12_true, bad, all_unknowns(chain12_true))
        fault = read_fault(f"other-test:2:X={-0.5 * float(np.log(1.2))!r}")
        good = fault.repair_with_model(Evidence(part, part.coordinates.start))
        assert good.values == pytest.approx(sound.values, rel=1e-8)


def test_a_force_is_left_out_and_the_last_one_is_not(data):
    assert read_fault("other-test:force 5:X=0.1").repair(data).references.labels == ["12:X"]
    one = data.select(references=["5:X"])
    with pytest.raises(DataError, match="no data remain"):
        read_fault("other-test:force 5:X=0.1").repair(one)


def test_the_last_sensor_is_not_another_test(chain12, data):
    """One that was left out is none to compare the others with."""
    two = data.select(responses=["5:X", "12:X"], references=["12:X"])
    part = FRFPart.build(
        chain12, with_variance(two, choose_noise(None, two)), all_unknowns(chain12)
    )
    sensors = {("5:X",), ("12:X",)}
    seen = Evidence(part, part.coordinates.start)
    assert {one.channels for one in OtherTest.propose_faults(seen)} == sensors
    without = OtherTest(("5:X",), 0.02).mask_channels(part.frf)
    left = Evidence(part.with_data(without), part.coordinates.start)
    assert not list(OtherTest.propose_faults(left))


# -- a missing mode
def with_mode(frf, frequency, loss, shape, height):
    pole = 1.0 / (1.0 + 1j * loss - (frf.freq / frequency) ** 2)
    own = np.array([shape[frf.responses.labels.index(label)] for label in frf.references.labels])
    term = height * loss * pole[:, None, None] * np.outer(shape, own)
    return replace(frf, values=frf.values + term)


def test_a_mode_that_the_model_lacks_is_found_with_its_pole(chain12, data):
    shape = np.array([1.0, -0.7, 0.8, 0.5, -0.9])
    height = 2.0 * float(np.median(np.abs(data.values)))
    bad = with_mode(data, 9.3, 0.02, shape, height)
    (found,) = updyn.diagnose(chain12, bad, all_unknowns(chain12))
    assert (found.kind, found.channels) == ("missing-mode", ())
    assert found.value == pytest.approx(9.3, rel=5e-3)
    assert "loss factor 0.02" in found.statement
    assert not found.grave
    left = found.repair(bad)
    sound = data.select(lines=left.freq)
    assert len(left.freq) > 0.9 * len(FREQ)
    beyond = np.abs(left.values - sound.values) / np.sqrt(np.mean(np.abs(sound.values) ** 2))
    assert np.sqrt(np.mean(beyond**2)) < 2e-3
    assert "missing-mode=9.3" in found.remedy
    short = read_fault(f"missing-mode={found.value}").repair(bad)
    assert np.abs(short.freq / found.value - 1.0).min() > 0.05


@pytest.mark.parametrize("loss", [0.004, 0.03])
def test_an_update_of_data_less_the_mode_finds_the_truth(chain12, chain12_true, clean, loss):
    """Lines 0.2 Hz apart, a mode of a half-power bandwidth of 0.03 and of 0.2 Hz."""
    rng = np.random.default_rng(4)
    shape = np.array([1.0, -0.7, 0.8, 0.5, -0.9])
    height = 2.0 * float(np.median(np.abs(clean.values)))
    noise = 0.005 * (
        rng.standard_normal(clean.values.shape) + 1j * rng.standard_normal(clean.values.shape)
    )
    whole = with_mode(clean, 7.1, loss, shape, height)
    bad = replace(whole, values=whole.values * (1.0 + noise))
    unknowns = all_unknowns(chain12)
    (found,) = updyn.diagnose(chain12, bad, unknowns)
    result = updyn.update(chain12, found.repair(bad), unknowns)
    for p in unknowns:
        start, true = (model.group(p.group) for model in (chain12, chain12_true))
        value = true.loss_factor
        if p.quantity != "loss_factor":
            sizes = (np.abs(getattr(one, p.quantity).data).sum() for one in (true, start))
            value = next(sizes) / next(sizes)
        assert abs(result.values[p.name] - value) < 4.0 * result.std[p.name]


def test_a_mode_with_its_shape_is_written_and_read(clean):
    text = "missing-mode=9.3, 0.02, 2:X 1e-05+2e-07j, 5:X -3e-05-1e-08j, force 5:X 1+0j"
    fault = read_fault(text)
    assert fault.repair_text == text
    assert (fault.value, fault.loss, fault.channels) == (9.3, 0.02, ())
    assert dict(fault.shape)["5:X"] == -3e-05 - 1e-08j
    turned = updyn.FRF(FREQ, np.ones((len(FREQ), 2, 1)), ["5:-X", "2:X"], ["5:X"], "mobility")
    s = 2j * np.pi * FREQ
    pole = s / (1.0 + 0.02j + (s / (2.0 * np.pi * 9.3)) ** 2)
    left = fault.repair(turned)
    expected = 1.0 - pole[:, None, None] * np.array([[[3e-05 + 1e-08j], [1e-05 + 2e-07j]]])
    assert left.values == pytest.approx(expected, rel=1e-12)
    with pytest.raises(DataError, match=r"shape of the mode at 9\.3 Hz is not known at '7:X'"):
        fault.repair(replace(turned, responses=["7:X", "2:X"]))


@pytest.mark.parametrize(
    "written",
    ["missing-mode=9.3, a", "missing-mode=9.3, 0.02, 2:X", "missing-mode=9.3, 0.02, 2:X q"],
)
def test_a_shape_is_labels_and_numbers(written):
    with pytest.raises(OptionError, match="by label, as in"):
        read_fault(written)


def test_the_missing_mode_is_taken_away_exactly(chain12_true, clean):
    """Of data without noise, at the truth."""
    shape = np.array([1.0, -0.7, 0.8, 0.5, -0.9])
    bad = with_mode(clean, 9.3, 0.02, shape, float(np.abs(clean.values).mean()))
    part = FRFPart.build(
        chain12_true,
        replace(bad, variance=np.full(bad.values.shape, 1e-30)),
        all_unknowns(chain12_true),
    )
    evidence = Evidence(part, part.coordinates.start)
    fault = read_fault("missing-mode=9.3").adapt_to(evidence)
    assert fault.value == pytest.approx(9.3, rel=2e-3)
    assert fault.loss == pytest.approx(0.02, rel=0.1)
    exact = replace(fault, value=9.3, loss=0.02)
    assert exact.repair_with_model(evidence).values == pytest.approx(clean.values, rel=1e-6)


@pytest.mark.parametrize("written", ["missing-mode=0", "missing-mode:2:X=9"])
def test_a_mode_is_read_by_its_frequency(written):
    with pytest.raises(OptionError, match="frequency"):
        read_fault(written)


# -- supports
def test_a_suspended_structure_is_told_from_a_free_model(chain12, chain12_true, add_noise):
    """Two springs at two masses, and not springs everywhere in proportion to the mass."""
    true, start = without_ground(chain12_true), without_ground(chain12)
    mass = float(sum(group.mass.sum() for group in true.groups.values()))
    stiffness = 0.5 * mass * (2.0 * np.pi * 1.5) ** 2
    held = on_springs(true, "cords", ["3:X", "9:X"], stiffness)
    free = updyn.response(true, FREQ, SENSORS, ["5:X", "12:X"])
    hung = updyn.response(held, FREQ, SENSORS, ["5:X", "12:X"])
    rng = np.random.default_rng(3)
    assert updyn.diagnose(start, add_noise(free, rng, 0.01), all_unknowns(start)) == ()
    found = updyn.diagnose(start, add_noise(hung, rng, 0.01), all_unknowns(start))
    assert found[0].kind == "support"
    assert found[0].value == pytest.approx(1.5, rel=0.3)
    assert "model" in found[0].remedy
    with pytest.raises(DataError, match="springs to the ground"):
        found[0].repair(hung)


def test_a_spring_that_holds_a_free_model_is_a_support(chain12, chain12_true, add_noise):
    """One spring to the ground: named with its place, and no further cause is sought."""
    true, start = without_ground(chain12_true), without_ground(chain12)
    stiffness = 0.3 * float(true.stiffness.diagonal()[6])
    held = on_springs(true, "cord", ["7:X"], stiffness)
    hung = updyn.response(held, FREQ, SENSORS, ["5:X", "12:X"])
    data = add_noise(hung, np.random.default_rng(3), 0.01)
    (found,) = updyn.diagnose(start, data, all_unknowns(start))
    assert (found.kind, found.channels) == ("missing-spring", ("7:X",))
    assert found.value == pytest.approx(stiffness, rel=0.1)
    assert found.statement.startswith(
        "The structure seems to be supported, while the model is free: a spring of"
    )
    assert "to the ground at 7:X, or several that act like it" in found.statement
    assert found.remedy.startswith("Check how the structure was supported in the test. Add each")


def test_the_suspension_is_that_of_springs_in_proportion_to_the_mass(chain12_true, clean):
    """K + a^2 (1 + i eta) M, against a model with these springs."""
    mass = sum(group.mass.toarray() for group in chain12_true.groups.values())
    springs = Group((2.0 * np.pi * 1.5) ** 2 * mass, loss_factor=0.05)
    held = Model.from_groups({**chain12_true.groups, "springs": springs}, chain12_true.dofs)
    hung = updyn.response(held, FREQ, SENSORS, ["5:X", "12:X"])
    part = FRFPart.build(chain12_true, clean, all_unknowns(chain12_true))
    ratio = Evidence(part, part.coordinates.start).log_ratio_on_suspension(1.5)
    assert np.exp(ratio) == pytest.approx(hung.values / clean.values, rel=1e-8)


def test_a_support_of_the_model_that_does_not_hold_is_named(chain12, data):
    start = on_springs(chain12, "stand", ["7:X"], 0.5 * float(chain12.stiffness.diagonal()[6]))
    unknowns = all_unknowns(chain12)
    (found,) = updyn.diagnose(start, data, unknowns)
    assert (found.kind, found.channels) == ("no-support", ("stand",))
    assert np.exp(found.value) < 0.05
    assert "'stand' holds the model" in found.statement
    assert "leave that group out" in found.remedy


def test_what_holds_a_model_is_told_by_a_rigid_translation(chain12, clean):
    held = FRFPart.build(chain12, clean, all_unknowns(chain12))
    free = FRFPart.build(without_ground(chain12), clean, all_unknowns(chain12))
    assert not is_free(held)
    assert is_free(free)
    stood = on_springs(without_ground(chain12), "stand", ["7:X"], 1.0)
    part, _ = free_held_quantities(FRFPart.build(stood, clean, all_unknowns(chain12)))
    assert not is_free(part)
    assert list_ground_springs(part) == ["stand"]
    known, _ = free_held_quantities(FRFPart.build(stood, clean, all_unknowns(stood)))
    assert list_ground_springs(known) == []


def test_the_torsion_mode_of_the_measured_beam_is_seen_beside_its_bending_model(tmp_path):
    """The demo finds it, too, by the shape of the residual: cos(pi x / length)."""
    job = load_job(beam.write_inputs(tmp_path))
    ready = prepare(job)
    (test,) = ready.tests
    noise = choose_noise(None, test.frf)
    part = FRFPart.build(test.model, with_variance(test.frf, noise), ready.parameters).thin(60)
    part, _ = free_held_quantities(part)
    fit = run_trial(part, None, [raise_loss_factors(part, part.coordinates.start)])
    found = [
        mode for mode in MissingMode.propose_faults(Evidence(part, fit.x)) if mode.is_plausible()
    ]
    assert found[0].value == pytest.approx(1377.0, rel=5e-3)
