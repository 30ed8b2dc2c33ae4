"""The mass of each sensor as an unknown."""

import numpy as np
import pytest

import updyn
from updyn.errors import DofError, ModelError, ParameterError

FREQ = np.linspace(1.0, 40.0, 60)


def test_the_mass_of_a_sensor_is_found(make_chain):
    """A sensor 60 % heavier than written down, in 1 % noise."""
    loaded, masses = updyn.sensor_masses(make_chain(5), {"3:X": 0.2, 5: 0.1})
    true = loaded.scaled({"sensor 3": {"mass": 1.6}, "part2": {"stiffness": 1.1}})
    frf = updyn.response(true, FREQ, ["3:X", "5:X"], ["1:X"], "accelerance")
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape)
    values = frf.values + 0.01 * np.abs(frf.values) * noise / np.sqrt(2)
    frf = updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)
    unknowns = updyn.parameters(loaded, stiffness="part*") + masses
    found = updyn.update(loaded, frf, unknowns, noise={"relative": 0.01})
    for name, value in {"sensor 3.mass": 1.6, "sensor 5.mass": 1.0, "part2.stiffness": 1.1}.items():
        assert abs(found.values[name] - value) < 4 * found.std[name], name
    assert found.std["sensor 3.mass"] < 0.1
    assert masses[0].physical(1.6) == "0.32 kg"
    assert "0.32" in found.summary() or "0.31" in found.summary() or "0.33" in found.summary()


def test_a_mass_acts_in_all_translations_of_its_node():
    dofs = ["1:X", "1:Y", "1:Z", "1:RX", "2:Z"]
    model = updyn.Model.from_groups({"all": updyn.Group(np.eye(5), np.eye(5))}, dofs)
    loaded, masses = updyn.sensor_masses(model, {"1:-Z": 0.01, "2": 0.02})
    assert list(loaded.groups) == ["all", "sensor 1", "sensor 2"]
    assert loaded.groups["sensor 1"].mass.diagonal().tolist() == [0.01, 0.01, 0.01, 0.0, 0.0]
    assert loaded.groups["sensor 2"].mass.diagonal().tolist() == [0.0, 0.0, 0.0, 0.0, 0.02]
    assert [(p.name, p.prior_std, p.nominal, p.unit) for p in masses] == [
        ("sensor 1.mass", 0.3, 0.01, "kg"),
        ("sensor 2.mass", 0.3, 0.02, "kg"),
    ]
    assert (masses[0].lower, masses[0].upper) == (0.1, 10.0)


@pytest.mark.parametrize(
    ("masses", "kind", "text"),
    [
        ({}, ModelError, "sensor masses: expected a mapping"),
        ({"1:X": 0.0}, ModelError, "sensor 1:X: mass 0.0; expected a number above 0"),
        ({"1:X": "heavy"}, ModelError, "sensor 1:X: mass 'heavy'; expected a finite number"),
        (
            {"1:X": 0.1, 1: 0.1},
            ModelError,
            r"sensor 1: there is a group 'sensor 1' already \(two sensors on one node",
        ),
        ({"7:X": 0.1}, DofError, "sensor at node 7: the model has no such node; .*5"),
        ({1.5: 0.1}, DofError, "sensor 1.5: expected a label such as '12:Z', or a node"),
        ({"1X": 0.1}, DofError, "1X"),
    ],
)
def test_bad_masses_are_refused(masses, kind, text, make_chain):
    with pytest.raises(kind, match=text):
        updyn.sensor_masses(make_chain(5), masses)


def test_what_cannot_be_loaded_or_named_is_refused(make_chain):
    turning = updyn.Model.from_groups({"all": updyn.Group([[1.0]], [[1.0]])}, ["1:RZ"])
    with pytest.raises(ModelError, match="sensor at node 1: the model has no translation there"):
        updyn.sensor_masses(turning, {1: 0.1})
    loaded, _ = updyn.sensor_masses(make_chain(5), {1: 0.1})
    with pytest.raises(
        ModelError, match=r"sensor 1: there is a group 'sensor 1' already \(rename it\)"
    ):
        updyn.sensor_masses(loaded, {1: 0.1})
    with pytest.raises(ParameterError, match="prior_std"):
        updyn.sensor_masses(make_chain(5), {1: 0.1}, prior_std=-1.0)
