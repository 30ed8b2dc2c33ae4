"""A model in units that do not go together is told as that; no channel is blamed for it."""

import numpy as np
import pytest

import updyn
from cantilever import cantilever
from updyn.errors import UpdynWarning
from updyn.updating.judge.causes.model_unit import UNITS_OF_MODELS, ModelUnit

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]
FREQ = np.linspace(0.6, 22.0, 60)


@pytest.fixture(scope="module")
def data(chain12_true, add_noise):
    clean = updyn.response(chain12_true, FREQ, SENSORS, ["5:X", "12:X"], "accelerance")
    return add_noise(clean, np.random.default_rng(3), 0.01, 1e-4)


def in_wrong_units(model, of, factor):
    """The model whose stiffnesses or masses want that factor."""
    return model.scaled({name: {of: 1.0 / factor} for name in model.groups})


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize(("of", "factor", "mistake"), UNITS_OF_MODELS)
def test_data_in_the_units_of_a_model_are_those_that_it_computes(
    chain12, quantity, of, factor, mistake
):
    right = updyn.response(chain12, FREQ, SENSORS, ["5:X"], quantity, decay=0.3)
    told = ModelUnit((), factor, of, mistake).convert_data(right)
    wrong = in_wrong_units(chain12, of, factor)
    H = updyn.response(wrong, told.freq, SENSORS, ["5:X"], quantity, decay=told.decay)
    # Of the order of the rounding of K - omega^2 M beside resonances.
    assert np.abs(told.values - H.values).max() < 1e-8 * np.abs(H.values).max()


@pytest.mark.parametrize(("of", "factor", "mistake"), UNITS_OF_MODELS)
def test_a_mistaken_unit_of_the_model_is_named(chain12, data, of, factor, mistake):
    wrong = in_wrong_units(chain12, of, factor)
    unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
    (found,) = updyn.diagnose(wrong, data, unknowns)
    assert (found.kind, found.channels) == ("model-unit", ())
    assert found.value == pytest.approx(factor)
    assert f"times its {of}: {mistake}." in found.statement
    assert found.written == ""


def test_an_update_is_not_to_be_believed_and_says_why(chain12, data):
    wrong = in_wrong_units(chain12, "stiffness", 1e3)
    unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
    with pytest.warns(UpdynWarning, match="0 of 6 measured modes have a counterpart"):
        result = updyn.update(wrong, data, unknowns)
    assert [one.kind for one in result.findings] == ["model-unit"]
    assert result.trust["plausible"].holds is False
    assert "stiffnesses in N/mm instead of N/m" in result.message
    assert "No further start was tried" in result.message


def test_a_stiffness_off_by_a_factor_that_is_no_unit_is_not_blamed_on_the_data(chain12, data):
    """One sensor was said to be of another quantity, and two to come from another test."""
    for factor in (1.0 / 0.3, 1.0 / 37.0):
        wrong = in_wrong_units(chain12, "stiffness", factor)
        unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
        assert not updyn.diagnose(wrong, data, unknowns)


def test_a_larger_model_is_reduced_for_it(add_noise):
    """A cantilever of 120 DOFs: a modulus of 210,000 where metres are the unit."""
    true = cantilever(2, 10, 0.08)
    clean = updyn.response(
        true, np.linspace(4.0, 200.0, 50), ["8:Z", "14:Z", "14:Y", "20:Z"], ["20:Z"], "accelerance"
    )
    noisy = add_noise(clean, np.random.default_rng(1), 0.01, 1e-4)
    wrong = true.scaled({"segment 1": {"stiffness": 0.8e-6}, "segment 2": {"stiffness": 1.2e-6}})
    unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
    (found,) = updyn.diagnose(wrong, noisy, unknowns)
    assert (found.kind, found.value) == ("model-unit", 1e6)
    assert "moduli in MPa instead of Pa" in found.statement
