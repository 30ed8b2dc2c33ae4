"""Trust: whether to believe an answer, in five parts, each with a sentence.

The rules, and why they are as they are, stand in docs/verdict.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from updyn.errors import in_all
from updyn.text_table import counted, percent
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.claim import PARTS, Claim
from updyn.updating.judge.modal_trust import modes_plausible, modes_predicted, modes_said
from updyn.updating.judge.strayed import Strayed

__all__ = ["PARTS", "Claim", "Trust", "trust", "validated"]

#: Where a sentence ends and the next begins.
_SENTENCE = re.compile(r"(?<=\.) (?=[A-Z])")
#: How a message begins where not all unknowns are determined.
_OPEN = re.compile(r"^The fit ended, but the data determine only \d+ of \d+ unknowns: ")
#: Unknowns that a sentence names.
_NAMED = 4
#: What is said where the modes of model and test were not compared.
NOT_COMPARED = Claim(None, "The modes of model and test were not compared.", asked=False)

#: Typical misfit from which no noise model makes an answer plausible: half of the values are off by
#: more than this share.
GROSS = 0.5
#: How a fit ended that did not converge.
_ENDED = {
    "max-iterations": "The largest number of steps was reached before convergence.",
    "stalled": "The fit stalled before a minimum of the misfit.",
    "failed": "The fit failed.",
}
#: Typical misfit below which there is nothing left but rounding.
ROUNDED = 1e-8
#: What is said where all values are lost in the noise.
_HIDDEN = (
    "No value stands clear of the noise that was stated or measured, so that the misfit says"
    " nothing of the model."
)
#: Typical misfit from which a residual that is not noise leaves open whether to believe an answer,
#: unless held-out data are predicted: what the search for causes calls noise at most.
ROUGH = 0.05
#: Relative residual from which a model that answers nothing would be as near to the data.
NOTHING = 1.0
#: Share of the stiffnesses and masses at a bound from which the bounds make the answer, and least
#: number of them.
MANY, SOME = 0.5, 2
#: Correlation with its sign of a held-out channel: one below this does not follow the model.
LOST = 0.0
#: Relative residual of held-out data, about 2 dB, up to which a model predicts their level.
PREDICTED = 0.25
#: Relative residual, about 1 dB, up to which a prediction is good, however small the noise.
CLOSE = 0.1
#: Held-out residual over the fitted one, or the one that is predicted, that is far worse. The noise
#: of sensors of one kind differs by less.
FAR_WORSE = 3.0
#: Rms residual, in predicted standard deviations, from which the prediction fails: noise of one
#: sensor twice that of the others passes.
BEYOND = 2.0
#: Predicted residual from which held-out data cannot tell: half of their level is uncertain.
UNCLEAR = 0.5
#: Residual after over residual before, from which an update did harm, if it is not small anyway.
HARM, SMALL = 1.1, 0.1


@dataclass(frozen=True, slots=True)
class Trust(Mapping[str, Claim]):
    """The verdict in five parts, by their names.

    Attributes
    ----------
    converged : Claim
        Of the optimiser: whether no step would gain what could be told from the noise.
    determined : Claim
        Of the data: whether they determine all unknowns, in one way.
    validated : Claim
        Of data that were held out: whether the updated model predicts them.
    plausible : Claim
        Of model and data: whether the residual, the values and the causes found allow the answer.
    resembles : Claim
        Of the model at its start, and updated: whether it has modes of the test.
    """

    converged: Claim
    determined: Claim
    validated: Claim
    plausible: Claim
    resembles: Claim = NOT_COMPARED

    def __getitem__(self, part: str) -> Claim:
        if part not in PARTS:
            raise KeyError(part)
        found = getattr(self, part)
        assert isinstance(found, Claim)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(PARTS)

    def __len__(self) -> int:
        return len(PARTS)

    @property
    def holds(self) -> bool:
        """Whether all parts hold that were asked for."""
        return all(claim.holds is True or not claim.asked for claim in self.values())

    @property
    def credible(self) -> bool:
        """Whether nothing speaks against the answer but undetermined unknowns."""
        against = (self.resembles, self.validated, self.plausible)
        return all(claim.holds is not False for claim in against)

    def beyond(self, status: str, message: str) -> str:
        """Return what the message of a result says beyond the parts.

        Parameters
        ----------
        status, message : str
            Of the result.
        """
        rest = message
        for claim in self.values():
            for sentence in _SENTENCE.split(claim.why):
                rest = rest.replace(sentence, "")
        if status in ("converged", "not-credible"):  # the first sentence is the verdict
            rest = rest.partition(". ")[2]
        # The part `determined` has the figure; which unknowns they are is said here.
        return " ".join(_OPEN.sub("Not determined: ", rest).split())


def trust(
    status: str,
    *,
    left: float | None,
    rank: tuple[int, int],
    answers: int,
    correlation: Sequence[Mapping[str, Any]],
    misfit: float,
    pressed: tuple[Sequence[str], int],
    findings: Sequence[Finding],
    unseen: str = "",
    structural: bool = False,
    strays: Sequence[Strayed] = (),
    unsure: Sequence[str] = (),
) -> Trust:
    """Return the verdict, without that on resemblance.

    Parameters
    ----------
    status : str
        How the fit ended.
    left : float or None
        What is left to gain, in standard deviations; None where it is not known.
    rank : (int, int)
        Combinations of unknowns that the data determine, and number of unknowns.
    answers : int
        Answers that fit equally well.
    correlation : sequence of mapping
        For each test the figures ``before``, ``after``, ``validation``.
    misfit : float
        Typical misfit, as a share of the level; nan where no value is clear of the noise.
    pressed : (sequence of str, int)
        Stiffnesses and masses at a bound, and the number of those that are unknown.
    findings : sequence of Finding
        Causes that were found.
    unseen : str
        Why causes were not looked for, though the residual is not noise.
    structural : bool
        Whether the residual of FRFs is not noise.
    strays : sequence of Strayed
        Stiffnesses and masses that ended far from their start.
    unsure : sequence of str
        Unknowns without an interval, as the error of the model may have moved them far.
    """
    predicts = validated(correlation)
    plausible = _plausible(
        status, correlation, misfit, pressed, findings, unseen, strays if structural else ()
    )
    if plausible:
        rough = structural and misfit > ROUGH and not predicts
        plausible = _doubted(plausible, misfit if rough else None, unsure, strays)
    return Trust(
        _converged(status, left, misfit), _determined(status, rank, answers), predicts, plausible
    )


def _doubted(
    plausible: Claim, rough: float | None, unsure: Sequence[str], strays: Sequence[Strayed]
) -> Claim:
    """Return a claim that holds, as not known where the error of the model leaves it open.

    `rough` is the typical misfit of a residual that is not noise, where no data were predicted.
    """
    if rough is not None:
        return Claim(
            None,
            f"The residual is not noise, and half of the values are off by {percent(rough)} or"
            " more: the model lacks something.",
        )
    if unsure:
        verb = "is" if len(unsure) == 1 else "are"
        more = in_all(len(unsure)) if len(unsure) > _NAMED else ""
        return Claim(
            None,
            f"With the error that the residual shows of the model, {', '.join(unsure[:_NAMED])}"
            f"{more} {verb} not known.",
        )
    return Claim(True, f"{plausible.why} {strays[0].statement}.") if strays else plausible


def _converged(status: str, left: float | None, misfit: float) -> Claim:
    if status == "stopped":
        return Claim(None, "The fit was stopped by the user.")
    gain = ""
    if left is not None and not misfit < ROUNDED:  # the deviations of rounding say nothing
        gain = f" Further steps could gain {left:.1g} standard deviations."
    if status in ("converged", "not-identifiable"):
        return Claim(True, "The fit ended at a minimum of the misfit." + gain)
    return Claim(False, _ENDED[status] + gain)


def _determined(status: str, rank: tuple[int, int], answers: int) -> Claim:
    if status in ("stopped", "failed"):
        return Claim(None, f"The fit {status}; what the data determine there is not known.")
    found, all_ = rank
    if answers > 1:
        return Claim(False, f"At least {answers} answers fit the data equally well.")
    if found < all_:
        return Claim(False, f"The data determine {found} of {counted(all_, 'unknown')}.")
    which = "the one unknown" if all_ == 1 else f"all {all_} unknowns"
    return Claim(True, f"The data determine {which}.")


def validated(correlation: Sequence[Mapping[str, Any]]) -> Claim:
    """Return whether the updated model predicts the data that were held out of the fit.

    Parameters
    ----------
    correlation : sequence of mapping
        For each test the figures ``before``, ``after``, ``validation``.
    """
    tests = [one for one in correlation if one.get("validation", {}).get("after")]
    if not tests:
        return Claim(None, "No data were held out.", asked=False)
    claims = [_predicts(one) for one in tests]
    against = [claim for claim in claims if claim.holds is False]
    unclear = [claim for claim in claims if claim.holds is None]
    if against or unclear:
        return (against or unclear)[0]
    return Claim(True, " ".join(dict.fromkeys(claim.why for claim in claims)))


def _predicts(one: Mapping[str, Any]) -> Claim:
    """Return whether the updated model predicts the held-out data of one test."""
    held = one["validation"]["after"]
    if "modes_measured" in held:
        return modes_predicted(one)
    if "correlation_min" not in held:
        return Claim(None, "The agreement with the held-out data is not known.")
    if held["correlation_min"] < LOST:
        return Claim(
            False,
            f"A held-out channel has a correlation of {held['correlation_min']:.2f} with the"
            " model's, sign and phase included.",
        )
    residual = held["residual_median"]
    fitted = one.get("after", {}).get("residual_median", residual)
    expected, deviations = held.get("residual_expected"), held.get("residual_deviations")
    said = f"The residual of the held-out data is {percent(residual)} of their level"
    # A residual that is not noise has been seen, so that noise is no excuse.
    beyond = expected is None or (deviations > BEYOND and residual > expected)
    if expected is not None:
        said += f"; noise and the deviations of the unknowns predict {percent(expected)}"
        if beyond:
            said += f" ({deviations:.2g} deviations)"
    if residual > PREDICTED and not beyond:
        if expected < UNCLEAR:
            return Claim(True, f"{said}.")
        return Claim(None, f"{said}: these data cannot tell.")
    worse = residual > CLOSE and residual > FAR_WORSE * max(fitted, expected or 0.0)
    if residual > PREDICTED or (beyond and worse):
        return Claim(False, f"{said}, that of the fitted data {percent(fitted)}.")
    return Claim(True, f"{said}.")


def _plausible(
    status: str,
    correlation: Sequence[Mapping[str, Any]],
    misfit: float,
    pressed: tuple[Sequence[str], int],
    findings: Sequence[Finding],
    unseen: str,
    strays: Sequence[Strayed],
) -> Claim:
    if status in ("stopped", "failed"):
        return Claim(None, f"The fit {status}.")
    against = [finding for finding in findings if finding.grave]
    if against:
        return Claim(False, against[0].statement)
    if misfit > GROSS:
        return Claim(
            False, f"Half of the values are still off by more than {100.0 * misfit:.0f} %."
        )
    if strays:
        return Claim(
            False,
            f"{strays[0].statement}, and the residual is not noise: it makes up for an error"
            " elsewhere.",
        )
    names, number = pressed
    if len(names) >= SOME and len(names) > MANY * number:
        return Claim(
            False, f"{len(names)} of {number} stiffnesses and masses ended at their bounds."
        )
    for one in correlation:
        before, after = one.get("before", {}), one.get("after", {})
        if not (before and after):
            continue
        if "modes_measured" in after:
            claim = modes_plausible(before, after)
            if claim.holds is False:
                return claim
            continue
        residual = after["residual_median"]
        if residual >= NOTHING:
            return Claim(
                False,
                f"The median residual is {residual:.2g} of the level of the data: a model without"
                " any answer would be as near.",
            )
        if residual > HARM * before["residual_median"] and residual > SMALL:
            return Claim(
                False,
                f"The residual rose from {before['residual_median']:.2g} to"
                f" {residual:.2g} of the level.",
            )
    mild = f" {findings[0].statement}" if findings else ""
    if unseen:
        mild = f" What is left is not noise; {unseen}."
    if math.isnan(misfit):
        return Claim(None, _HIDDEN + mild)
    said = f"Half of the values are off by less than {100.0 * misfit:.2g} %."
    modal = [one["after"] for one in correlation if "modes_measured" in one.get("after", {})]
    if modal and len(modal) == len(correlation):
        said = " ".join(modes_said(after) for after in modal)
    complete = all(after["modes_paired"] == after["modes_measured"] for after in modal)
    if misfit < ROUNDED and complete:
        said = "The model answers the data but for rounding."
    return Claim(True, said + mild)
