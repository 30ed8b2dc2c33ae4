"""The verdict part by part: each rule by an example."""

from dataclasses import replace

import pytest

from updyn.remedy import Remedy
from updyn.updating.judge.badge import choose_badge
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.distant import DistantUnknown
from updyn.updating.judge.modal_trust import claim_modes_plausible, claim_modes_predicted
from updyn.updating.judge.trust import PARTS, judge_result

GOOD = {
    "before": {"residual_median": 0.9},
    "after": {"residual_median": 0.02, "correlation_min": 0.99},
}


def judged(status="converged", **changes):
    given = {
        "remaining_gain": 1e-4,
        "rank": (8, 8),
        "n_solutions": 1,
        "correlation": [GOOD],
        "misfit": 0.02,
        "at_bound": ((), 4),
        "findings": (),
    }
    return judge_result(status, **given | changes)


def held(after, before=None):
    validation = {"before": before or {}, "after": after}
    return [GOOD | {"validation": validation}]


def figures(residual, lowest=0.9):
    return {"residual_median": residual, "correlation_min": lowest, "correlation_median": 0.95}


def predicted(residual, expected, deviations, fitted=0.02):
    """The figures of a test whose held-out data are compared with what is predicted of them."""
    after = figures(residual) | {"residual_expected": expected, "residual_deviations": deviations}
    return [{"after": figures(fitted), "validation": {"before": figures(0.8), "after": after}}]


def finding(kind="sign", value=0.0, explains=0.9):
    return Finding(kind, ("2:X",), value, 1e6, explains, "What is wrong.", Remedy("What to do."))


def test_data_lost_in_the_noise_say_nothing_of_the_model():
    found = judged(misfit=float("nan"), remaining_gain=0.01)
    assert found.plausible.holds is None
    assert found.plausible.why.startswith("No value is clear of the stated or measured noise")
    assert "could gain 0.01 standard deviations" in found.converged.why
    assert judged(misfit=0.0).plausible.why == "The model reproduces the data except for rounding."


def test_a_good_fit_holds_in_all_that_is_known():
    found = judged()
    assert list(found) == list(PARTS)
    assert [found[part].holds for part in PARTS] == [None, True, True, None, True]
    assert found.credible
    assert found["converged"] == True  # noqa: E712 - compares by what holds
    assert found["validated"] == None  # noqa: E711
    assert all(belief.why.endswith(".") for belief in found.values())


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"rank": (7, 8)}, "determined"),
        ({"n_solutions": 2}, "determined"),
        ({"misfit": 0.6}, "plausible"),
        ({"at_bound": (("a", "b", "c"), 4)}, "plausible"),
        ({"findings": (finding(),)}, "plausible"),
        ({"findings": (finding("calibration", 1.0),)}, "plausible"),
        (
            {"correlation": [{"before": figures(0.2), "after": figures(0.3)}]},
            "plausible",
        ),
        # No nearer to the data than a model that answers nothing.
        (
            {"correlation": [{"before": figures(2.1), "after": figures(1.1)}]},
            "plausible",
        ),
        ({"correlation": held(figures(0.02, lowest=-0.9))}, "validated"),
        ({"correlation": held(figures(0.7))}, "validated"),
        ({"correlation": held(figures(0.26))}, "validated"),
        ({"structural": True, "distant": (DistantUnknown("a.stiffness", 15.0, 6.7),)}, "plausible"),
    ],
)
def test_what_speaks_against_an_answer(changes, part):
    found = judged(**changes)
    assert found[part].holds is False
    assert all(found[other].holds is not False for other in PARTS if other != part)
    assert found.credible == (part == "determined")


@pytest.mark.parametrize(
    "changes",
    [
        {"at_bound": (("a",), 1)},
        {"at_bound": (("a", "b"), 4)},
        {"misfit": 0.4},
        {"findings": (finding("calibration", 0.1),)},
        {"findings": (finding(explains=0.2),)},
        {"correlation": held(figures(0.09))},
        {"correlation": held(figures(0.04))},
        {"distant": (DistantUnknown("a.stiffness", 15.0, 6.7),)},
        {"structural": True},
    ],
)
def test_what_does_not(changes):
    assert judged(**changes).credible


def test_held_out_data_that_are_predicted_count_for_it():
    found = judged(correlation=held(figures(0.03), figures(0.8)))
    assert found["validated"].holds is True
    assert "3 % of their level" in found["validated"].why


@pytest.mark.parametrize("fitted", [0.02, 0.4, 0.9])
def test_held_out_data_that_no_noise_explains_are_not_predicted_from_2_db(fitted):
    """Nor where the fitted ones are as far off: the tutorial's chain with masses that are wrong."""
    correlation = [
        {
            "after": figures(fitted),
            "validation": {"before": figures(0.8), "after": figures(0.43)},
        }
    ]
    claim = judged(correlation=correlation)["validated"]
    assert claim.holds is False
    assert "43 % of their level, that of the fitted data" in claim.why


@pytest.mark.parametrize(
    ("given", "holds"),
    [
        # The noise explains it.
        ((0.012, 0.01, 1.2), True),
        ((0.4, 0.35, 1.2), True),
        # So large a noise that any model would do.
        ((0.4, 0.6, 0.7), None),
        ((1.1, 1.0, 1.1), None),
        # It does not.
        ((0.43, 0.01, 43.0), False),
        ((0.43, 0.15, 2.9), False),
        # Worse than noise, and no more than 1 dB off; or as far off as the fitted ones.
        ((0.09, 0.01, 9.0), True),
        ((0.15, 0.01, 15.0), False),
        ((0.15, 0.01, 15.0, 0.1), True),
    ],
)
def test_held_out_data_are_compared_with_what_noise_and_posterior_predict(given, holds):
    claim = judged(correlation=predicted(*given))["validated"]
    assert claim.holds is holds
    assert "noise and the deviations of the unknowns predict" in claim.why
    assert ("cannot tell" in claim.why) == (holds is None)


def test_a_rough_fit_of_a_model_that_lacks_something_is_believed_by_what_it_predicts():
    rough = {"structural": True, "misfit": 0.17}
    assert judged(**rough).plausible.holds is None
    assert judged(**rough, correlation=held(figures(0.09)))["plausible"].holds is True
    assert judged(misfit=0.17).plausible.holds is True


def test_values_that_the_error_of_the_model_hides_are_not_known():
    found = judged(without_interval=("a.stiffness", "b.mass"))
    assert found.plausible.holds is None
    assert "a.stiffness, b.mass are not known" in found.plausible.why
    many = judged(without_interval=[f"a{i}.mass" for i in range(9)])
    assert "a2.mass (9 such) are not known" in many.plausible.why


def test_what_was_not_asked_for_counts_neither_way():
    assert judged().validated == Claim(None, "No data were held out.", asked=False)
    assert judged().validated.answer == "not asked"
    assert judged().holds
    assert not judged(correlation=predicted(1.1, 1.0, 1.1)).holds
    assert not judged(rank=(7, 8)).holds


@pytest.mark.parametrize(
    ("status", "changes", "phrase", "colour"),
    [
        ("converged", {"correlation": held(figures(0.03))}, "Usable", "good"),
        ("converged", {}, "Fits, not validated", "warn"),
        (
            "converged",
            {"correlation": predicted(1.1, 1.0, 1.1)},
            "Fits, prediction not known",
            "warn",
        ),
        (
            "converged",
            {"structural": True, "misfit": 0.17},
            "Not known whether credible",
            "warn",
        ),
        ("converged", {"correlation": held(figures(0.43))}, "Does not predict", "bad"),
        ("max-iterations", {"misfit": 0.6}, "Not credible", "bad"),
        ("stalled", {}, "Stalled", "warn"),
        ("not-identifiable", {"rank": (7, 8)}, "Not all unknowns determined", "warn"),
        ("failed", {}, "Failed", "bad"),
    ],
)
def test_the_badge_never_contradicts_the_parts(status, changes, phrase, colour):
    found = choose_badge(status, judged(status, **changes))
    assert (found.phrase, found.colour) == (phrase, colour)


@pytest.mark.parametrize(
    ("status", "holds"),
    [("stalled", False), ("max-iterations", False), ("stopped", None), ("failed", False)],
)
def test_how_the_optimiser_ended(status, holds):
    assert judged(status)["converged"].holds is holds


def test_other_names_are_refused():
    with pytest.raises(KeyError):
        judged()["believed"]


@pytest.mark.parametrize(
    ("status", "said"),
    [
        ("max-iterations", "The largest number of steps was reached before convergence."),
        ("stalled", "The fit stalled before a minimum of the misfit."),
        ("failed", "The fit failed."),
    ],
)
def test_how_a_fit_ended_that_did_not_converge_is_said_in_words(status, said):
    found = judged(status, remaining_gain=None)
    assert found.converged == False  # noqa: E712 - compares by what holds
    assert found.converged.why == said


def test_of_data_that_are_answered_but_for_rounding_no_deviations_are_given():
    exact = judged(misfit=1e-13, remaining_gain=4.0)
    assert exact.converged.why == "The fit ended at a minimum of the misfit."
    assert exact.plausible.why == "The model reproduces the data except for rounding."
    assert "0.5 standard deviations" in judged(remaining_gain=0.5).converged.why


def test_what_a_message_says_beyond_the_parts():
    found = judged()
    message = f"The fit converged and the data determine all unknowns. {found.plausible.why} More."
    assert found.beyond("converged", message) == "More."
    mode = "A measured mode at 1377 Hz is not in the model."
    missing = replace(found, plausible=Claim(True, "Off by 5.3 %.", further=mode))
    message = f"The fit converged and the data determine all unknowns. More. {mode}"
    assert missing.beyond("converged", message) == "More."
    open_ = judged("not-identifiable", rank=(2, 4))
    message = "The fit ended, but the data determine only 2 of 4 unknowns: a, b can change."
    assert open_.beyond("not-identifiable", message) == "Not determined: a, b can change."
    assert [claim.answer for claim in open_.values()] == [
        "not asked",
        "yes",
        "no",
        "not asked",
        "yes",
    ]


def test_a_single_unknown_is_written_as_one():
    assert judged(rank=(1, 1))["determined"].why == "The data determine the one unknown."
    assert judged(rank=(0, 1))["determined"].why == "The data determine 0 of 1 unknown."
    assert judged()["determined"].why == "The data determine all 8 unknowns."


# -- thresholds ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "holds"),
    [
        # Half of the values are off by half of their level.
        ({"misfit": 0.45}, True),
        ({"misfit": 0.55}, False),
        # The residual is not noise, and half of the values are off by 5 %.
        ({"misfit": 0.045, "structural": True}, True),
        ({"misfit": 0.055, "structural": True}, None),
        # At least two, and more than half, of the stiffnesses and masses at a bound.
        ({"at_bound": (("a",), 1)}, True),
        ({"at_bound": (("a", "b"), 4)}, True),
        ({"at_bound": (("a", "b"), 3)}, False),
        # The residual rose by more than a tenth, to above a tenth of the level.
        ({"correlation": [{"before": figures(0.5), "after": figures(0.54)}]}, True),
        ({"correlation": [{"before": figures(0.5), "after": figures(0.56)}]}, False),
        ({"correlation": [{"before": figures(0.05), "after": figures(0.095)}]}, True),
        ({"correlation": [{"before": figures(0.05), "after": figures(0.105)}]}, False),
        # The residual of a model with zero response.
        ({"correlation": [{"before": figures(2.0), "after": figures(0.95)}]}, True),
        ({"correlation": [{"before": figures(2.0), "after": figures(1.05)}]}, False),
    ],
)
def test_thresholds_of_a_plausible_result(changes, holds):
    assert judged(**changes)["plausible"].holds is holds


@pytest.mark.parametrize(("misfit", "is_rounding"), [(0.9e-8, True), (1.1e-8, False)])
def test_only_rounding_remains_below_a_hundred_millionth(misfit, is_rounding):
    found = judged(misfit=misfit)
    assert found.plausible.why.startswith("The model reproduces the data") == is_rounding
    assert ("could gain" in found.converged.why) != is_rounding


@pytest.mark.parametrize(
    ("given", "holds"),
    [
        # Without a prediction: a quarter of the level; or a tenth and three times the fitted data.
        ((0.24, None, None, 0.2), True),
        ((0.26, None, None, 0.2), False),
        ((0.14, None, None, 0.05), True),
        ((0.16, None, None, 0.05), False),
        ((0.095, None, None, 0.01), True),
        ((0.105, None, None, 0.01), False),
        # Twice the predicted standard deviation.
        ((0.3, 0.2, 1.9), True),
        ((0.3, 0.2, 2.1), False),
        # A prediction of half of the level.
        ((0.4, 0.45, 1.0), True),
        ((0.4, 0.55, 1.0), None),
    ],
)
def test_thresholds_of_predicted_data(given, holds):
    (found,) = predicted(*given)
    if given[1] is None:
        found["validation"]["after"] = figures(given[0])
    assert judged(correlation=[found])["validated"].holds is holds


@pytest.mark.parametrize(
    ("before", "after", "holds"),
    [
        # Half of the measured modes have a counterpart.
        ((5, 2.0), (5, 2.0), True),
        ((4, 2.0), (4, 2.0), False),
        # An rms error of 10 % is that of the next mode.
        ((9, 9.5), (9, 9.5), True),
        ((9, 10.5), (9, 10.5), False),
        # A rise by a tenth, to above 1 %.
        ((9, 0.5), (9, 0.95), True),
        ((9, 0.5), (9, 1.05), False),
        ((9, 2.0), (9, 2.15), True),
        ((9, 2.0), (9, 2.25), False),
    ],
)
def test_thresholds_of_plausible_modes(before, after, holds):
    assert claim_modes_plausible(modal_figures(*before), modal_figures(*after)).holds is holds


@pytest.mark.parametrize(
    ("held_error", "fitted_error", "holds"),
    [(2.9, 0.1, True), (3.1, 0.1, False), (6.0, 2.1, True), (6.0, 1.9, False)],
)
def test_thresholds_of_predicted_modes(held_error, fitted_error, holds):
    """Held-out frequencies off by 3 %, and by three times the error of the fitted ones."""
    validation = {"after": modal_figures(10, held_error)}
    found = {"after": modal_figures(10, fitted_error), "validation": validation}
    assert claim_modes_predicted(found).holds is holds


def modal_figures(paired, error):
    """Return the figures of ten measured modes."""
    return {
        "modes_paired": float(paired),
        "modes_measured": 10.0,
        "mac_min": 0.9,
        "frequency_error_rms": error,
    }


def test_the_first_test_has_the_sentence_of_a_joined_claim():
    claim = Claim.join(True, ["A is predicted.", "B is predicted.", "A is predicted."])
    assert (claim.statement, claim.further) == ("A is predicted.", "B is predicted.")
    assert claim.add("More.").why == "A is predicted. B is predicted. More."
