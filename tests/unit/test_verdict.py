"""Verdicts: what is said of a fit, from numbers made for the purpose and from a fit that must miss."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit import Fit
from updyn.updating.identifiability import analyse
from updyn.updating.verdict import verdict

NAMES = ["a.stiffness", "b.stiffness"]
SURE, UNSURE = np.diag([1000.0, 1000.0]), np.diag([1000.0, 2.0])
BLIND = np.array([[1000.0, 1000.0]])


def say(R, reason="converged", misfit=0.0, **noise):
    return verdict(Fit(np.zeros(2), reason, R, (noise,)), analyse(R, NAMES), NAMES, "advice", misfit)


def test_all_is_well():
    assert say(SURE) == ("converged", "The fit converged and the data determine all unknowns.", "")


def test_a_weak_unknown_is_named_with_its_standard_deviation():
    assert "large for b.stiffness (50 %)" in say(UNSURE)[1]


def test_open_unknowns_are_named():
    status, message, remedy = say(BLIND)
    assert (status, remedy) == ("not-identifiable", "advice")
    assert "only 1 of 2 unknowns: a.stiffness, b.stiffness can change together without changing anything" in message


def test_open_unknowns_are_the_cause_where_steps_ran_out():
    status, message, remedy = say(BLIND, "max-iterations")
    assert (status, remedy) == ("max-iterations", "advice")
    assert "Besides, the data determine only 1 of 2" in message
    assert say(SURE, "max-iterations")[2] == "Raise max_iterations."


@pytest.mark.parametrize(("reason", "status"), [("failed", "failed"), ("stopped", "stopped"), ("stalled", "stalled")])
def test_other_ends(reason, status):
    assert say(SURE, reason)[0] == status
    assert say(SURE, reason)[2]


def test_model_error_shows_in_chi_square_and_along_lines():
    message = say(SURE, chi_square=9.0, correlation_length=4.0)[1]
    assert "3 times what the noise explains" in message
    assert "about 4 neighbouring lines" in message
    assert "widened 2 times" in message


def test_a_miss_is_said_only_where_the_noise_is_not_known():
    assert "off by more than 40 %" in say(SURE, misfit=0.4, kind="estimated from the residual")[1]
    assert "off by more than" not in say(SURE, misfit=0.4, kind="stated")[1]


def test_a_force_calibrated_wrongly_by_five_is_no_good_fit(chain12):
    """Loss factors alone cannot make up for a factor of five on all data."""
    frf = updyn.response(chain12, np.linspace(2, 30, 40), ["2:X", "12:X"], ["12:X"])
    wrong = updyn.FRF(frf.freq, 5.0 * frf.values, frf.responses, frf.references, frf.quantity)
    result = updyn.update(chain12, wrong, updyn.parameters(chain12, loss_factor="all"), method="log")
    assert "still misses the data" in result.message
    assert "calibration" in result.remedy
