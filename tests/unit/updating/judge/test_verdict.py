"""Verdicts: what is said of a fit, from numbers made for the purpose and from a fit that must miss."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.method import Fit
from updyn.updating.judge.adequacy import Suspect, add_suspects, assess_residual
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.ending import Ending
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.judge.verdict import compose_verdict, explain_ambiguity

NAMES = ["a.stiffness", "b.stiffness"]
SURE, UNSURE = np.diag([1000.0, 1000.0]), np.diag([1000.0, 2.0])
BLIND = np.array([[1000.0, 1000.0]])


def as_texts(verdict):
    """Status, message, and the steps as one text."""
    return verdict.status, verdict.message, "\n".join(map(str, verdict.steps))


def compose(*args, **options):
    return as_texts(compose_verdict(*args, **options))


def say(R, reason="converged", misfit=0.0, **noise):
    return compose(
        Fit(np.zeros(2), reason, R, (noise,)),
        analyse_identifiability(R, NAMES),
        NAMES,
        "advice",
        misfit,
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
    assert say(SURE, "max-iterations")[2] == "Raise max_iterations, or start closer."


@pytest.mark.parametrize(
    ("reason", "status"),
    [
        ("failed", "failed"),
        ("stopped", "stopped"),
        ("stalled", "stalled"),
        ("unsolvable", "stalled"),
    ],
)
def test_other_ends(reason, status):
    assert say(SURE, reason, misfit=0.01)[0] == status
    assert say(SURE, reason, misfit=0.01)[2]


def test_a_fit_that_stalled_in_rounding_has_converged():
    assert say(SURE, "stalled", misfit=1e-10)[0] == "converged"


def test_model_error_shows_in_chi_square_and_along_lines():
    message = say(SURE, chi_square=9.0, correlation_length=4.0)[1]
    assert "3 times what the noise explains" in message
    assert "serially correlated over about 4 lines" in message
    assert "widened 2 times" in message


def test_a_miss_is_said_only_where_the_noise_is_not_known():
    assert "off by more than 40 %" in say(SURE, misfit=0.4, kind="estimated from the residual")[1]
    assert "off by more than" not in say(SURE, misfit=0.4, kind="stated")[1]


FREE_IT = (
    "Free c.mass if it can be wrong, and run again: [[parameter]] with"
    ' groups = ["c"] and quantity = "mass" at the end of the job.'
)


def test_what_the_model_cannot_explain_is_said_with_what_to_free():
    rng = np.random.default_rng(0)
    e = rng.standard_normal((40, 2, 1)) + 1j * rng.standard_normal((40, 2, 1)) + 5.0
    freq = np.linspace(1.0, 40.0, 40)
    found = assess_residual(
        e, np.ones(e.shape), freq, ["1:X", "2:X"], ["1:X"], n_unknowns=2, absolute=True
    )
    fit, analysis = Fit(np.zeros(2), "converged", SURE, ({},)), analyse_identifiability(SURE, NAMES)
    status, message, remedy = compose(fit, analysis, NAMES, "", adequacy={"": found})
    assert status == "converged"
    assert message.endswith(found.verdict)
    assert remedy.startswith("Check units")
    told = add_suspects(found, [Suspect("c", "mass", 0.9, 0.1, 0.4, confirmed=True)])
    _, message, remedy = compose(fit, analysis, NAMES, "", adequacy={"locked": told, "free": None})
    assert "Test 'locked': The model cannot explain" in message
    # Where an unknown explains it, that is the one next step.
    assert remedy == FREE_IT
    partly = add_suspects(found, [Suspect("c", "mass", 0.4, 0.1, 0.4, confirmed=True)])
    _, _, remedy = compose(fit, analysis, NAMES, "", adequacy={"": partly})
    assert remedy.startswith("Look for a part that the model lacks")
    # A search whose tries do not agree may lack just that unknown; a mere hint is no reason.
    fit = Fit(np.zeros(2), "unsettled", SURE, ({},))
    status, _, remedy = compose(fit, analysis, NAMES, "", adequacy={"": told})
    assert status == "stalled"
    assert remedy.startswith(f"{FREE_IT}\nRaise starts")
    assert compose(fit, analysis, NAMES, "", adequacy={"": partly})[2].startswith("Raise starts")
    fit = Fit(np.zeros(2), "converged", SURE, ({},))
    calm = assess_residual(
        e - 5.0, np.ones(e.shape), freq, ["1:X", "2:X"], ["1:X"], n_unknowns=2, absolute=True
    )
    assert compose(fit, analysis, NAMES, "", adequacy={"": calm}) == say(SURE)


def test_sensors_of_unlike_noise_are_to_count_by_their_own():
    rng = np.random.default_rng(0)
    e = rng.standard_normal((80, 3, 2)) + 1j * rng.standard_normal((80, 3, 2))
    e[:, 2] *= 8.0
    freq, ones = np.linspace(1.0, 40.0, 80), np.ones(e.shape)
    found = assess_residual(
        e,
        ones,
        freq,
        ["1:X", "2:X", "3:X"],
        ["1:X", "2:X"],
        n_unknowns=2,
        absolute=False,
        whitened_H=100.0 * ones,
    )
    fit, analysis = Fit(np.zeros(2), "converged", SURE, ({},)), analyse_identifiability(SURE, NAMES)
    status, message, remedy = compose(fit, analysis, NAMES, "", adequacy={"": found})
    assert status == "converged"
    assert message.endswith(" times that of most sensors at 3:X.")
    assert remedy.startswith('Estimate the noise of each sensor: noise = "estimated-by-channel"')


def test_answers_that_fit_equally_well_are_named_with_the_sensor_that_tells_them_apart():
    others = [Alternative({}, 1.8, "3:X", 0.314), Alternative({}, 0.4, "1:X", 0.52)]
    different = [("a.stiffness", [1.5, 0.7, 1.5]), ("b.stiffness", [0.7, 1.5, 1.0])]
    message, remedy = explain_ambiguity(different, others)
    assert not remedy.lines
    assert message == (
        "But at least 3 answers fit the data equally well (odds within 1.8 to 1); they differ in"
        " a.stiffness (1.5, 0.7 or 1.5), b.stiffness (0.7, 1.5 or 1)."
    )
    assert str(remedy) == (
        "A sensor at 3:X or 1:X would distinguish them: there they differ by 31 % typically. Fix"
        " one of these unknowns where it is known."
    )


def test_of_many_unknowns_in_which_answers_differ_three_are_named():
    different = [(f"{name}.mass", [1.0, 2.0]) for name in "abcde"]
    message, remedy = explain_ambiguity(different, [Alternative({}, 1.0)])
    assert message.endswith("a.mass (1 or 2), b.mass (1 or 2), c.mass (1 or 2) and 2 more.")
    assert str(remedy) == (
        "Fix one of these unknowns where it is known, or measure more: a wider band, further modes,"
        " their shapes, less noise."
    )


def test_a_force_calibrated_wrongly_by_five_is_no_good_fit(chain12):
    """Loss factors alone cannot make up for a factor of five on all data."""
    frf = updyn.response(chain12, np.linspace(2, 30, 40), ["2:X", "12:X"], ["12:X"])
    wrong = updyn.FRF(frf.freq, 5.0 * frf.values, frf.responses, frf.references, frf.quantity)
    result = updyn.update(
        chain12, wrong, updyn.parameters(chain12, loss_factor="all"), method="log"
    )
    assert result.status == "not-credible"
    assert not result.trust["plausible"]
    (found,) = result.findings
    assert (found.kind, found.channels) == ("calibration", ())
    assert np.exp(found.value) == pytest.approx(5.0, rel=0.01)
    assert found.written in result.remedy


def cut(deviations, share, gained, R=SURE, misfit=0.0, **noise):
    """Verdict on a fit that ran out of steps, by what was left to gain."""
    end = Ending(deviations, share, gained, ("b.stiffness",))
    fit = Fit(np.zeros(2), "max-iterations", R, (noise,))
    return compose(fit, analyse_identifiability(R, NAMES), NAMES, "advice", misfit, end=end)


def test_more_steps_are_advised_only_where_they_help():
    assert cut(40.0, 0.5, 0.01)[2] == "Raise max_iterations."
    assert cut(2.0, 0.001, 0.8)[2] == "Raise max_iterations."
    for end in ((0.05, 0.5, 0.5), (0.8, 0.001, 0.01)):
        for noise in ({}, {"chi_square": 9.0}):
            assert "max_iterations" not in cut(*end, **noise)[2]
    assert "max_iterations" not in say(BLIND, "max-iterations")[2]


def test_steps_along_a_valley_name_the_unknowns_that_lead_it():
    status, message, remedy = cut(0.8, 0.001, 0.01)
    assert status == "max-iterations"
    assert "valley" in message
    assert "0.8 standard deviations remain" in message
    assert "tell b.stiffness apart" in remedy


def test_a_fit_that_has_all_but_arrived_is_said_to_be_usable():
    _, message, remedy = cut(0.03, 1e-6, 0.01)
    assert "0.03 standard deviations" in message
    assert remedy.startswith("Use the values")


def test_model_error_is_the_cause_where_steps_ran_out_far_above_the_noise():
    _, message, remedy = cut(0.03, 1e-6, 0.01, chi_square=25.0)
    assert "5 times what the noise explains" in message
    assert remedy.startswith("Check units")


def test_a_bound_that_excludes_the_truth_is_in_the_message(chain12):
    """The truth of the last spring is 1.5 times the start, its upper bound 1.2."""
    true = chain12.scaled({"part3": {"stiffness": 1.5}})
    frf = updyn.response(true, np.linspace(2, 30, 60), ["2:X", "8:X", "12:X"], ["12:X"])
    unknowns = updyn.parameters(
        chain12, stiffness=["part3", "part4"], bounds={"part3.stiffness": (0.5, 1.2)}
    )
    result = updyn.update(chain12, frf, unknowns, noise={"relative": 0.01}, starts=0)
    assert result.at_bound == {"part3.stiffness": "upper"}
    assert "part3.stiffness stopped at its upper bound, 1.2; the data require" in result.message
    assert "widen its bound (part3.stiffness)" in result.remedy


def test_a_bound_that_noise_alone_presses_against_is_not_news(chain12):
    """The loss factor is truly 0, on its bound."""
    true = chain12.scaled({"part3": {"loss_factor": 0.0}})
    clean = updyn.response(true, np.linspace(2, 30, 60), ["2:X", "12:X"], ["12:X"])
    rng = np.random.default_rng(0)
    draw = rng.standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + 0.01 * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)
    unknowns = updyn.parameters(true, stiffness="all", loss_factor="part3")
    result = updyn.update(true, frf, unknowns, starts=0)
    assert "bound" not in result.message


# -- thresholds ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("std", "is_named"), [(0.28, False), (0.32, True)])
def test_a_standard_deviation_of_three_tenths_is_weak(std, is_named):
    assert ("Weakly determined" in say(np.diag([1000.0, 1.0 / std]))[1]) is is_named


@pytest.mark.parametrize(
    ("misfit", "noise", "text"),
    [
        (0.0, {"correlation_length": 2.8}, ""),
        (0.0, {"correlation_length": 3.2}, "serially correlated"),
        (0.0, {"chi_square": 1.9}, ""),
        (0.0, {"chi_square": 2.1}, "what the noise explains"),
        (0.28, {"kind": "estimated"}, ""),
        (0.32, {"kind": "estimated"}, "half of the values are off"),
    ],
)
def test_thresholds_of_a_misfit_that_is_mentioned(misfit, noise, text):
    message = say(SURE, misfit=misfit, **noise)[1]
    assert text in message
    assert (message == say(SURE)[1]) == (not text)


@pytest.mark.parametrize(
    ("end", "is_decreasing"),
    [
        # A tenth of a standard deviation remains.
        ((0.09, 0.5, 0.5), False),
        ((0.11, 0.5, 0.5), True),
        # A step removes 5 % of the misfit.
        ((9.0, 0.045, 0.0), False),
        ((9.0, 0.055, 0.0), True),
        # The last steps gained a tenth of what remains.
        ((9.0, 0.0, 0.09), False),
        ((9.0, 0.0, 0.11), True),
    ],
)
def test_thresholds_of_a_misfit_that_still_decreases(end, is_decreasing):
    assert ("still falling" in cut(*end)[1]) is is_decreasing


@pytest.mark.parametrize(("share", "is_explained"), [(0.45, False), (0.55, True)])
def test_one_quantity_explains_a_residual_from_half_of_it(share, is_explained):
    rng = np.random.default_rng(0)
    e = np.cumsum(rng.standard_normal((60, 1, 1)), axis=0) + 0j
    found = assess_residual(
        e, np.ones_like(e), np.arange(1.0, 61.0), ["1:X"], ["1:X"], n_unknowns=0, absolute=True
    )
    found = add_suspects(found, [Suspect("c", "mass", share, 0.2, 0.5, True)])
    assert ("No single quantity explains it" in found.verdict) is not is_explained
    fit = Fit(np.zeros(2), "converged", SURE)
    remedy = compose(
        fit, analyse_identifiability(SURE, NAMES), NAMES, "advice", adequacy={"": found}
    )[2]
    assert ("Free c.mass" in remedy) is is_explained
