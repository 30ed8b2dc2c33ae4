"""The antenna demo: its model by second ways (two masses, reflected stiffness, closed forms), its data, recovery."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg as spla

import updyn
from places import ROOT
from updyn.control import demo as with_servo
from updyn.demos import antenna as demo
from updyn.demos import find_demo
from updyn.job import load_job, prepare
from updyn.updating.problem.noise import Coherence

pytest.importorskip("pyfe3d")

from updyn.demos import antenna_model
from updyn.demos.antenna_model import AZIMUTH, ELEVATION, NODES, SKIN, antenna, lock_rotors, trains
from updyn.elements.drivetrain import reflected

#: Turned by each axis, carrying its housing; and the axis.
AXES = {
    "azimuth": (AZIMUTH, NODES["turntable"], NODES["pedestal top"], 2),
    "elevation": (ELEVATION, NODES["tube"] + 6, 108, 1),
}


@pytest.fixture(scope="module")
def model() -> updyn.Model:
    return antenna()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("antenna")
    demo.write_inputs(folder, n_lines=59)
    return folder


def turning(model: updyn.Model, axis: str) -> np.ndarray:
    """All that an axis carries turned by 1 rad about it as a rigid body, in the DOFs of the model."""
    assert model.geometry is not None
    _, _, _, about = AXES[axis]
    centre = np.array([0.0, 0.0, 2.9])
    spin = np.eye(3)[about]
    out = np.zeros(model.n_dofs)
    for i, dof in enumerate(model.dofs):
        carried = dof.node >= 200 or dof.node in (NODES["hub"], NODES["feed"])
        if axis == "azimuth":
            carried |= 100 < dof.node < 200 or dof.node == NODES["turntable"]
        if not carried or dof.node > 1000:
            continue
        (place,) = model.geometry.position([dof.node])
        motion = np.concatenate([np.cross(spin, place - centre), spin])
        out[i] = motion[["X", "Y", "Z", "RX", "RY", "RZ"].index(dof.direction)]
    return out


def stiff(model: updyn.Model) -> updyn.Model:
    """The same with all but the drives ten thousand times as stiff."""
    soft = {part.name for which in AXES for part in trains(which)}
    names = [n for n, g in model.groups.items() if g.stiffness is not None and n not in soft]
    return model.scaled({name: {"stiffness": 1e4} for name in names})


def test_it_has_the_size_and_the_frequencies_of_a_small_antenna(model) -> None:
    assert 2000 < model.n_dofs < 6000
    first = updyn.modes(lock_rotors(model), 4).frequency
    assert 5.0 < first[0] < 20.0 * antenna_model.DIAMETER**-0.7 * 1.2
    free = updyn.modes(model, 3).frequency
    assert (free[:2] < 1e-2).all()
    assert free[2] > first[0]


def test_masses_are_those_of_its_parts(model) -> None:
    up = np.array([d.direction == "Z" for d in model.dofs], dtype=float)
    weight = {n: up @ (g.mass @ up) for n, g in model.groups.items() if g.mass is not None}
    ring = 16 * 2 * 0.35 * np.sin(np.pi / 16)
    assert weight["pedestal"] == pytest.approx(ring * 1.8 * 0.008 * 7850.0, rel=1e-9)
    area = (
        np.pi / 6 * 1.5**2 * 4 * ((1 + (np.array([0.45, 2.0]) / 3.0) ** 2) ** 1.5)
    )  # of a paraboloid of focus 1.5
    assert weight["reflector"] == pytest.approx((area[1] - area[0]) * 4 * SKIN * 2700.0, rel=0.02)
    assert weight["counterweight"] == pytest.approx(260.0)
    assert weight["feed"] == pytest.approx(18.0)


@pytest.mark.parametrize("axis", AXES)
def test_the_drive_holds_its_axis_with_the_reflected_stiffness(model, axis: str) -> None:
    train, turned, carrier, about = AXES[axis]
    held = lock_rotors(model)
    rows = held.dofs.match([f"{turned}:R{'XYZ'[about]}", f"{carrier}:R{'XYZ'[about]}"]).index
    torque = np.zeros(held.n_dofs)
    torque[rows] = [1.0, -1.0]
    twist = spla.spsolve(held.stiffness.tocsc(), torque)
    expected = reflected(trains(axis), train["ring"], held=[train["rotor"], train["housing"]])
    assert 1.0 / (twist[rows[0]] - twist[rows[1]]) == pytest.approx(expected.stiffness, rel=1e-6)


@pytest.mark.parametrize("axis", AXES)
def test_on_a_rigid_structure_it_is_two_masses_on_a_spring(model, axis: str) -> None:
    train = AXES[axis][0]
    rigid = stiff(model)
    turn = turning(rigid, axis)
    load = turn @ (rigid.mass @ turn)
    k = reflected(trains(axis), train["ring"], held=[train["rotor"], train["housing"]]).stiffness
    rotor = 2.5e-3 * 800.0**2
    for x, expected in ((lock_rotors(rigid), k / load), (rigid, k / load + k / rotor)):
        found = updyn.modes(x, 5)
        frequency = np.sqrt(expected) / (2 * np.pi)
        # The wheels between, of a hundredth of the inertia, make the difference.
        assert np.abs(found.frequency / frequency - 1.0).min() < 0.02


def test_the_reflector_follows_its_thickness(model) -> None:
    built = antenna_model._structure(1.2 * SKIN).group("reflector")
    start = antenna_model._split(antenna_model._structure(SKIN), antenna_model._structure(2 * SKIN))
    scaled = start.scaled(
        {"reflector": {"stiffness": 1.2, "mass": 1.2}, "reflector bending": {"stiffness": 1.2**3}}
    ).groups
    K = scaled["reflector"].stiffness + scaled["reflector bending"].stiffness
    assert abs(K - built.stiffness).max() < 1e-10 * abs(built.stiffness).max()
    assert (
        abs(scaled["reflector"].mass - built.mass).max() < 1e-4 * abs(built.mass).max()
    )  # rotary inertia goes with t^3


def test_the_job_is_two_tests_of_one_model_and_knows_nothing_of_the_truth(inputs, model) -> None:
    ready = prepare(load_job(inputs / "job.toml"))
    held, free = ready.tests
    assert (held.name, free.name) == ("rotors locked", "rotors free")
    assert free.model.n_dofs - held.model.n_dofs == 2
    assert not set(demo.MOTORS) & set(held.model.dofs.labels)
    assert set(free.frf.references.labels) == {*demo.HAMMER, *demo.MOTORS}
    assert 10 <= len(ready.parameters) <= 20
    changed = {f"{g}.{q}" for g, change in demo.TRUTH.items() for q in change}
    acted_on = {d.name for p in ready.parameters for d in p.acts_on}
    assert changed == acted_on  # the truth differs where there are unknowns, and in all of them
    for name, group in updyn.read_model(inputs / "model.h5").groups.items():
        for what in ("stiffness", "mass", "viscous"):
            there, drawn = getattr(group, what), getattr(model.group(name), what)
            assert (there is None) == (drawn is None)
            assert there is None or abs(there - drawn).max() == 0.0


def test_noise_is_what_the_coherence_says(inputs, model) -> None:
    frf = updyn.read_frf(inputs / "locked.uff")
    exact = updyn.response(
        lock_rotors(model.scaled(demo.TRUTH)),
        frf.freq,
        frf.responses,
        frf.references,
        quantity="accelerance",
    )
    variance = np.abs(frf.values) ** 2 * (1.0 / frf.coherence - 1.0) / 4
    made = (demo._NOISE["relative"] * np.abs(exact.values)) ** 2 + demo._NOISE[
        "floor"
    ] ** 2 * np.mean(np.abs(exact.values) ** 2, axis=0)
    few = 4.0 / np.sqrt(frf.values.size)
    assert np.mean(np.abs(frf.values - exact.values) ** 2 / made) == pytest.approx(1.0, abs=few)
    assert np.mean(variance / made) == pytest.approx(1.0, abs=few)
    weighed = Coherence.of_data(replace(frf, averages=5)).variance(exact.values, frf)
    assert np.mean(np.abs(frf.values - exact.values) ** 2 / weighed) == pytest.approx(
        1.0, abs=2 * few
    )


def test_the_truth_is_found_from_nearby(inputs) -> None:
    ready = prepare(load_job(inputs / "job.toml"))
    true = demo.true_values(ready.parameters)
    sign = np.where(np.arange(len(true)) % 2, 1.03, 0.97)
    near = ready.parameters.with_start(
        {n: v * s for (n, v), s in zip(true.items(), sign, strict=True)}
    )
    tests = [updyn.Test(t.model, t.frf, t.name, lines="d-optimal:10") for t in ready.tests]
    result = updyn.update_jointly(tests, near, starts=0)
    assert result.status == "converged", result.summary()
    off = np.array([(result.values[n] - true[n]) / result.std[n] for n in true])
    assert np.abs(off).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.7
    text = with_servo.epilogue([result], inputs)
    for name in true:
        assert name in text
    (first,) = [line.split() for line in text.splitlines() if line.startswith("rotors free, 1")]
    drawings, updated, truth = (float(x) for x in first[3:])
    assert abs(updated / truth - 1.0) < 1e-3 < abs(drawings / truth - 1.0)
    margins = [
        line.split()[-3:]
        for line in text.splitlines()
        if line.startswith(("velocity loop", "position loop"))
    ]
    assert len(margins) == 8
    off = np.array([[float(x) / float(true) - 1.0 for x in row] for *row, true in margins])
    assert (
        np.abs(off[:, 1]).max() < 0.05
    )  # the updated model says the crossovers and margins of the truth
    assert np.abs(off[:, 0]).max() > 0.8


def test_the_page_shows_this_antenna(inputs, model) -> None:
    text = (ROOT / "docs" / "antenna.md").read_text(encoding="utf-8")
    table = text[text.index("error / std") :]
    rows = {
        line.rsplit(maxsplit=4)[0]: line.split()[-4:]
        for line in table.splitlines()
        if len(line.split()) > 4
    }
    true = demo.true_values(prepare(load_job(inputs / "job.toml")).parameters)
    assert {name: float(rows[name][0]) for name in true} == pytest.approx(true)
    assert all(
        abs(float(rows[name][1]) - value) < 4.0 * float(rows[name][2]) + 1e-5
        for name, value in true.items()
    )
    printed = {
        line.rsplit(maxsplit=3)[0]: line.split()[-3:]
        for line in table.splitlines()
        if line.startswith("rotors")
    }
    for name, x, skip in (("rotors locked", lock_rotors(model), 0), ("rotors free", model, 2)):
        for column, y in ((0, x), (2, x.scaled(demo.TRUTH))):
            found = updyn.modes(y, skip + 4).frequency[skip:]
            assert [float(printed[f"{name}, {i}"][column]) for i in range(1, 5)] == pytest.approx(
                found, abs=6e-4
            )
    assert f"{model.n_dofs:,} degrees of freedom" in text


def test_it_is_listed() -> None:
    assert find_demo("antenna").module == "updyn.control.demo"
