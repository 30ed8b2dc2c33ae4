"""Sensors among the suspects: a gain error is told from an error of the model."""

import numpy as np

import updyn

FREQ = np.linspace(1.0, 40.0, 80)


def fitted(model, true, gains):
    exact = updyn.response(model.scaled(true), FREQ, model.dofs, ["1:X"], "accelerance").values
    rng = np.random.default_rng(4)
    noise = rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)
    values = exact * np.asarray(gains)[:, None] * (1.0 + 0.01 * noise / np.sqrt(2.0))
    frf = updyn.FRF(FREQ, values, model.dofs, ["1:X"], "accelerance")
    unknowns = updyn.parameters(model, stiffness=["part1", "part2"])
    return updyn.update(model, frf, unknowns, noise={"relative": 0.01})


def test_a_sensor_of_wrong_gain_is_named(make_chain):
    found = fitted(make_chain(6), {"part1": {"stiffness": 1.1}}, [1, 1, 1, 1.08, 1, 1])
    best = found.adequacy.explained_by[0]
    assert best.name == "4:X.calibration"
    assert best.explains > 0.9
    assert "4:X.calibration" in found.remedy


def test_an_error_of_the_model_is_not_blamed_on_a_sensor(make_chain):
    found = fitted(
        make_chain(6), {"part1": {"stiffness": 1.1}, "part4": {"stiffness": 0.93}}, np.ones(6)
    )
    best = found.adequacy.explained_by[0]
    assert best.name == "part4.stiffness"
    assert all(
        s.explains < 0.5 * best.explains
        for s in found.adequacy.explained_by
        if "calibration" in s.quantity
    )


def test_a_sensor_whose_factor_is_an_unknown_is_no_suspect(make_chain):
    model = make_chain(6)
    true = model.scaled({"part4": {"stiffness": 0.93}})
    frf = updyn.response(true, FREQ, model.dofs, ["1:X"], "accelerance")
    unknowns = updyn.parameters(model, stiffness=["part1", "part2"]) + updyn.calibration(frf)
    found = updyn.update(model, frf, unknowns, noise={"relative": 0.001})
    assert found.adequacy.explained_by[0].group == "part4"
    assert not any(s.quantity == "calibration" for s in found.adequacy.explained_by)
