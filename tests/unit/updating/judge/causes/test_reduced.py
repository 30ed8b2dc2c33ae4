"""Causes in larger models: a reduced model says the same as the whole one."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from cantilever import cantilever
from overriding import override
from updyn.model import Group, Model
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.holding import is_free, list_ground_springs
from updyn.updating.judge.causes.places import iter_sensor_places
from updyn.updating.judge.causes.reduced import ReducedModels
from updyn.updating.judge.causes.settings import CAUSE_MODEL
from updyn.updating.judge.causes.trial import free_held_quantities
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.problem import FRFPart

SENSORS = ["20:Z", "35:Z", "50:Y", "60:Z", "79:Y", "79:Z"]


def beam(grounded):
    """80 beams in four segments."""
    return cantilever(4, 20, 0.02, grounded)


@pytest.fixture(scope="module")
def true():
    """A cantilever of 80 beams in four segments, clamped at node 0: 480 DOFs."""
    return beam([0])


@pytest.fixture(scope="module")
def model(true):
    factors = (0.85, 1.2, 0.9, 1.1)
    return true.scaled(
        {name: {"stiffness": f} for name, f in zip(true.groups, factors, strict=True)}
    )


@pytest.fixture(scope="module")
def data(true, add_noise):
    freq = np.linspace(4.0, 400.0, 24)
    frf = updyn.response(true, freq, SENSORS, ["60:Z", "79:Y"], "accelerance")
    return add_noise(frf, np.random.default_rng(1), 0.01)


@pytest.fixture(scope="module")
def unknowns(model):
    return updyn.parameters(model, stiffness="all", loss_factor="all")


@pytest.fixture(scope="module")
def part(model, data, unknowns):
    variance = Stated(0.01, 1e-3).variance(data.values, data)
    return free_held_quantities(FRFPart.build(model, replace(data, variance=variance), unknowns))[0]


@pytest.fixture(scope="module")
def stage(part):
    return ReducedModels(part)


def test_the_model_is_reduced(part, stage, true):
    assert true.n_dofs == 480 > CAUSE_MODEL.largest_whole
    here = stage.prepare_part(part, [part.coordinates.start])
    assert here.solver.tier == "reduced"
    assert here.solver.system.n < 0.3 * part.solver.system.n


def test_it_knows_the_same_places(part, stage):
    here = stage.prepare_part(part, [])
    assert list(iter_sensor_places(here)) == list(iter_sensor_places(part))


def test_it_gives_the_same_evidence(part, stage):
    """Answers at and beside the sensors, slopes by unknowns and frequency, damping, drive points."""
    rng = np.random.default_rng(0)
    x = part.coordinates.start + 0.1 * rng.uniform(-1.0, 1.0, part.n)
    x = np.clip(x, *part.coordinates.bounds)
    here = replace(stage.prepare_part(part, [x]), frf=part.frf)
    found, wanted = Evidence(here, x), Evidence(part, x)
    for own, whole in (
        (found._responses_elsewhere, wanted._responses_elsewhere),
        (found._responses_to_moved_forces, wanted._responses_to_moved_forces),
    ):
        assert (own.labels, own.references) == (whole.labels, whole.references)
        level = np.abs(whole.H).max(axis=(1, 2), keepdims=True)
        assert np.abs(own.H - whole.H).max() < 2e-3 * level.max()
    level = np.abs(wanted._responses_elsewhere.H).max(axis=(1, 2), keepdims=True)
    clear = np.abs(wanted.model_response(part.frf)) > 0.01 * level
    for own, whole in (
        (found.model_response(part.frf), wanted.model_response(part.frf)),
        (found.slope_by_frequency, wanted.slope_by_frequency),
        (found.log_ratio_with_decay(3.0), wanted.log_ratio_with_decay(3.0)),
    ):
        assert own[clear] == pytest.approx(whole[clear], rel=0.02, abs=0.02 * np.abs(whole).max())
    assert found.drive_point_response == pytest.approx(
        wanted.drive_point_response, rel=0.02, abs=5e-3 * np.abs(wanted.drive_point_response).max()
    )


def test_the_stated_error_holds(part, stage):
    x = part.coordinates.start + 0.15
    here = stage.prepare_part(part, [x])
    off = np.abs(here.responses(x) - part.responses(x))
    added = np.sqrt(here.frf.variance - part.frf.variance)
    assert (off <= added + 1e-9 * np.abs(part.frf.values)).all()


@pytest.mark.parametrize("whole", [False, True])
def test_the_same_is_found(model, data, unknowns, monkeypatch, whole):
    """By the reduced model, and by the whole one."""
    if whole:
        override(monkeypatch, CAUSE_MODEL, largest_whole=10000)
    values = data.values.copy()
    values[:, 3] *= np.exp(0.2)
    few = replace(data, values=values).select(lines=data.freq[::2])
    (found,) = updyn.diagnose(model, few, unknowns)
    assert (found.kind, found.channels) == ("calibration", ("60:Z",))
    assert found.value == pytest.approx(0.2, abs=5e-3)


def test_in_sound_data_of_a_larger_model_nothing_is_found(model, data, unknowns):
    assert updyn.diagnose(model, data, unknowns) == ()


def on_springs(model, name, at, stiffness):
    places = model.dofs.match(at).index
    K = sp.csr_array(
        (np.full(len(at), stiffness), (places, places)), shape=(model.n_dofs, model.n_dofs)
    )
    return Model.from_groups({**model.groups, name: Group(K, loss_factor=0.02)}, model.dofs)


def test_a_support_that_does_not_hold_is_named_in_a_reduced_model(model, data, unknowns):
    """A spring some times as stiff as the beam is there."""
    start = on_springs(model, "stand", ["40:Z"], 2e5)
    (found,) = updyn.diagnose(start, data, unknowns)
    assert (found.kind, found.channels) == ("no-support", ("stand",))
    assert np.exp(found.value) < 0.05


@pytest.fixture(scope="module")
def free():
    """The same beam in planar bending, with both ends free: 162 DOFs."""
    return beam([f"{i}:{d}" for i in range(81) for d in ("X", "Y", "RX", "RZ")])


def test_a_suspended_structure_is_told_in_a_reduced_model(free, add_noise):
    """Springs at both ends, on which it oscillates as a rigid body at 8 Hz; bending from 40 Hz."""
    assert free.n_dofs > CAUSE_MODEL.largest_whole
    mass = 7850.0 * 0.03 * 0.02 * 1.6
    hung = on_springs(free, "cords", ["8:Z", "72:Z"], 0.5 * mass * (2.0 * np.pi * 8.0) ** 2)
    start = free.scaled({"segment 1": {"stiffness": 0.85}, "segment 3": {"stiffness": 1.2}})
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    freq = np.linspace(4.0, 300.0, 60)
    at = ["5:Z", "20:Z", "45:Z", "60:Z", "79:Z"]
    rng = np.random.default_rng(4)
    for true, kinds in ((hung, ["support"]), (free, [])):
        frf = add_noise(updyn.response(true, freq, at, ["5:Z", "60:Z"], "accelerance"), rng, 0.01)
        assert [one.kind for one in updyn.diagnose(start, frf, unknowns)][:1] == kinds


def test_a_reduced_model_is_held_as_the_whole_one(model, data, unknowns, free):
    held, _ = free_held_quantities(
        FRFPart.build(
            on_springs(model, "stand", ["40:Z"], 1e4),
            replace(data, variance=Stated(0.01, 1e-3).variance(data.values, data)),
            unknowns,
        )
    )
    for whole, springs in ((held, ["stand"]), (free_part(free), [])):
        here = ReducedModels(whole).prepare_part(whole, [])
        assert here.solver.tier == "reduced"
        assert list_ground_springs(here) == list_ground_springs(whole) == springs
        assert is_free(here) == is_free(whole) == (not springs)
        sent = replace(here, solver=pickle.loads(pickle.dumps(here.solver)))  # noqa: S301
        assert list_ground_springs(sent) == springs
        assert is_free(sent) == is_free(whole)


def free_part(model):
    freq = np.linspace(10.0, 300.0, 24)
    frf = updyn.response(model, freq, ["20:Z", "79:Z"], ["79:Z"])
    return FRFPart.build(
        model,
        replace(frf, variance=Stated(0.01, 1e-3).variance(frf.values, frf)),
        updyn.parameters(model, stiffness="all"),
    )
