"""Verdicts: what is said of a fit, from numbers made for the purpose and from a fit that must miss."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.method import Fit
from updyn.updating.judge.adequacy import Suspect, assess, blamed
from updyn.updating.judge.identifiability import analyse
from updyn.updating.judge.verdict import verdict

NAMES = ["a.stiffness", "b.stiffness"]
SURE, UNSURE = np.diag([1000.0, 1000.0]), np.diag([1000.0, 2.0])
BLIND = np.array([[1000.0, 1000.0]])


def say(R, reason="converged", misfit=0.0, **noise):
    return verdict(
        Fit(np.zeros(2), reason, R, (noise,)), analyse(R, NAMES), NAMES, "advice", misfit
    )


def test_all_is_well():
    assert say(SURE) == ("converged", "The fit converged and the data determine all unknowns.", "")


def test_a_weak_unknown_is_named_with_its_standard_deviation():
    assert "large for b.stiffness (50 %)" in say(UNSURE)[1]


def test_open_unknowns_are_named():
    status, message, remedy = say(BLIND)
    assert (status, remedy) == ("not-identifiable", "advice")
    assert (
        "only 1 of 2 unknowns: a.stiffness, b.stiffness can change together without changing"
        " anything" in message
    )


def test_open_unknowns_are_the_cause_where_steps_ran_out():
    status, message, remedy = say(BLIND, "max-iterations")
    assert (status, remedy) == ("max-iterations", "advice")
    assert "Besides, the data determine only 1 of 2" in message
    assert say(SURE, "max-iterations")[2] == "Raise max_iterations."


@pytest.mark.parametrize(
    ("reason", "status"), [("failed", "failed"), ("stopped", "stopped"), ("stalled", "stalled")]
)
def test_other_ends(reason, status):
    assert say(SURE, reason)[0] == status
    assert say(SURE, reason)[2]


def test_model_error_shows_in_chi_square_and_along_lines():
    message = say(SURE, chi_square=9.0, correlation_length=4.0)[1]
    assert "3 times what the noise explains" in message
    assert "serially correlated over about 4 lines" in message
    assert "widened 2 times" in message


def test_a_miss_is_said_only_where_the_noise_is_not_known():
    assert "off by more than 40 %" in say(SURE, misfit=0.4, kind="estimated from the residual")[1]
    assert "off by more than" not in say(SURE, misfit=0.4, kind="stated")[1]


def test_what_the_model_cannot_explain_is_said_with_what_to_free():
    rng = np.random.default_rng(0)
    e = rng.standard_normal((40, 2, 1)) + 1j * rng.standard_normal((40, 2, 1)) + 5.0
    freq = np.linspace(1.0, 40.0, 40)
    found = assess(e, np.ones(e.shape), freq, ["1:X", "2:X"], ["1:X"], n_unknowns=2, absolute=True)
    fit, analysis = Fit(np.zeros(2), "converged", SURE, ({},)), analyse(SURE, NAMES)
    status, message, remedy = verdict(fit, analysis, NAMES, "", adequacy={"": found})
    assert status == "converged"
    assert message.endswith(found.verdict)
    assert remedy.startswith("Check units")
    told = blamed(found, [Suspect("c", "mass", 0.9, 0.1, 0.4)])
    _, message, remedy = verdict(fit, analysis, NAMES, "", adequacy={"locked": told, "free": None})
    assert "Test 'locked': The model cannot explain" in message
    assert remedy.startswith("Free c.mass if it can be wrong, and run again. Check units")
    calm = assess(
        e - 5.0, np.ones(e.shape), freq, ["1:X", "2:X"], ["1:X"], n_unknowns=2, absolute=True
    )
    assert verdict(fit, analysis, NAMES, "", adequacy={"": calm}) == say(SURE)


def test_a_force_calibrated_wrongly_by_five_is_no_good_fit(chain12):
    """Loss factors alone cannot make up for a factor of five on all data."""
    frf = updyn.response(chain12, np.linspace(2, 30, 40), ["2:X", "12:X"], ["12:X"])
    wrong = updyn.FRF(frf.freq, 5.0 * frf.values, frf.responses, frf.references, frf.quantity)
    result = updyn.update(
        chain12, wrong, updyn.parameters(chain12, loss_factor="all"), method="log"
    )
    assert "still misses the data" in result.message
    assert "calibration" in result.remedy
