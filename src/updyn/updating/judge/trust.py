"""Trust: whether to believe a result, in five claims with a sentence each (docs/verdict.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from updyn.errors import in_all
from updyn.text_table import format_count, format_multiple, percent, percent_of
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.claim import PARTS, Claim
from updyn.updating.judge.distant import DistantUnknown
from updyn.updating.judge.modal_trust import (
    claim_modes_plausible,
    claim_modes_predicted,
    describe_modes,
)
from updyn.updating.judge.sentences import split_ending
from updyn.updating.judge.settings import HELD_OUT, LIST_LENGTHS, PLAUSIBILITY

__all__ = ["PARTS", "Claim", "Trust", "claim_validated", "judge_result"]

#: Beginning of a message on undetermined unknowns.
_OPEN = re.compile(r"^The fit ended, but the data determine only \d+ of \d+ unknowns: ")
#: Claim on resemblance if the modes of model and test were not compared.
NOT_COMPARED = Claim(None, "The modes of model and test were not compared.", asked=False)

#: Sentences for fits that did not converge.
_ENDED = {
    "max-iterations": "The largest number of steps was reached before convergence.",
    "stalled": "The fit stalled before a minimum of the misfit.",
    "failed": "The fit failed.",
}
#: Sentence for data without a value clear of the noise.
_HIDDEN = (
    "No value is clear of the stated or measured noise, so that the misfit contains no"
    " information on the model."
)


@dataclass(frozen=True, slots=True)
class Trust(Mapping[str, Claim]):
    """The verdict in five claims, by their names.

    `converged`: no step would change the values significantly. `determined`: uniquely, for all
    unknowns. `validated`: the held-out data are predicted. `plausible`: residual, values and causes
    permit the result. `resembles`: the model, at its start and updated, has modes of the test.
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
        """Whether all claims that were asked hold."""
        return all(claim.holds is True or not claim.asked for claim in self.values())

    @property
    def credible(self) -> bool:
        """Whether none of `resembles`, `validated` and `plausible` is False."""
        against = (self.resembles, self.validated, self.plausible)
        return all(claim.holds is not False for claim in against)

    def beyond(self, status: str, message: str) -> str:
        """Return the part of the message of a result that the claims do not contain."""
        rest = message
        for claim in self.values():
            for text in filter(None, [claim.statement, claim.further]):
                rest = rest.replace(text, "")
        if status in ("converged", "not-credible"):  # the first sentence is the verdict
            _, rest = split_ending(rest)
        # The claim `determined` holds the number; the names of the unknowns are kept here.
        return " ".join(_OPEN.sub("Not determined: ", rest).split())


def judge_result(
    status: str,
    *,
    remaining_gain: float | None,
    rank: tuple[int, int],
    n_solutions: int,
    correlation: Sequence[Mapping[str, object]],
    misfit: float,
    at_bound: tuple[Sequence[str], int],
    findings: Sequence[Finding],
    not_searched: str = "",
    level_dependence: str = "",
    structural: bool = False,
    distant: Sequence[DistantUnknown] = (),
    without_interval: Sequence[str] = (),
) -> Trust:
    """Return the verdict, without the claim on resemblance.

    `remaining_gain` is in standard deviations; `rank` is the number of determined combinations and
    of unknowns; `correlation` has the figures of each test; `at_bound` has the stiffnesses and
    masses at a bound and their number among the unknowns; `not_searched` is the reason why causes
    were not searched; `level_dependence` is how the modes of the data change with the force level.
    """
    validated = claim_validated(correlation)
    plausible = _claim_plausible(
        status, correlation, misfit, at_bound, findings, not_searched, distant if structural else ()
    )
    if level_dependence and plausible.holds is not None:
        plausible = Claim(False, level_dependence)
    if plausible:
        is_rough = structural and misfit > PLAUSIBILITY.rough_misfit and not validated
        plausible = _qualify_plausible(
            plausible, misfit if is_rough else None, without_interval, distant
        )
    return Trust(
        _claim_converged(status, remaining_gain, misfit),
        _claim_determined(status, rank, n_solutions),
        validated,
        plausible,
    )


def _qualify_plausible(
    plausible: Claim,
    rough: float | None,
    without_interval: Sequence[str],
    distant: Sequence[DistantUnknown],
) -> Claim:
    """Return a claim that holds, changed to unknown if the model error makes it uncertain."""
    # `rough` is the typical misfit of a residual that is not noise, if no data were predicted.
    if rough is not None:
        return Claim(
            None,
            "The residual is not noise, and half of the values are off by"
            f" {percent_of(rough, 'their level')} or more: the model is incomplete.",
        )
    if without_interval:
        n, named = len(without_interval), LIST_LENGTHS.named_items
        verb = "is" if n == 1 else "are"
        more = in_all(n) if n > named else ""
        return Claim(
            None,
            "With the error that the residual shows of the model,"
            f" {', '.join(without_interval[:named])}{more} {verb} not known.",
        )
    return plausible.add(f"{distant[0].statement}.") if distant else plausible


def _claim_converged(status: str, remaining_gain: float | None, misfit: float) -> Claim:
    if status == "stopped":
        return Claim(None, "The fit was stopped by the user.")
    gain = ""
    if (
        remaining_gain is not None and not misfit < PLAUSIBILITY.rounding_misfit
    ):  # deviations of rounding are meaningless
        gain = f"Further steps could gain {remaining_gain:.1g} standard deviations."
    if status in ("converged", "not-identifiable"):
        return Claim(True, "The fit ended at a minimum of the misfit.", further=gain)
    return Claim(False, _ENDED[status], further=gain)


def _claim_determined(status: str, rank: tuple[int, int], n_solutions: int) -> Claim:
    if status in ("stopped", "failed"):
        return Claim(None, f"The fit {status}; what the data determine there is not known.")
    found, all_ = rank
    if n_solutions > 1:
        return Claim(False, f"At least {n_solutions} answers fit the data equally well.")
    if found < all_:
        return Claim(False, f"The data determine {found} of {format_count(all_, 'unknown')}.")
    which = "the one unknown" if all_ == 1 else f"all {all_} unknowns"
    return Claim(True, f"The data determine {which}.")


def claim_validated(correlation: Sequence[Mapping[str, Any]]) -> Claim:
    """Return whether the updated model predicts the data that were held out of the fit."""
    tests = [one for one in correlation if one.get("validation", {}).get("after")]
    if not tests:
        return Claim(None, "No data were held out.", asked=False)
    claims = [_claim_predicted(one) for one in tests]
    against = [claim for claim in claims if claim.holds is False]
    unclear = [claim for claim in claims if claim.holds is None]
    if against or unclear:
        return (against or unclear)[0]
    return Claim.join(True, [claim.why for claim in claims])


def _claim_predicted(figures: Mapping[str, Any]) -> Claim:
    """Return whether the updated model predicts the held-out data of one test."""
    held = figures["validation"]["after"]
    if "modes_measured" in held:
        return claim_modes_predicted(figures)
    if "correlation_min" not in held:
        return Claim(None, "The agreement with the held-out data is not known.")
    if held["correlation_min"] < 0.0:
        return Claim(
            False,
            f"A held-out channel has a correlation of {held['correlation_min']:.2f} with the"
            " model's, sign and phase included.",
        )
    residual = held["residual_median"]
    fitted = figures.get("after", {}).get("residual_median", residual)
    expected, deviations = held.get("residual_expected"), held.get("residual_deviations")
    text = f"The residual of the held-out data is {percent_of(residual, 'their level')}"
    # No residual is predicted if the fitted residual is not noise; noise then cannot explain the
    # held-out residual.
    is_beyond_noise = expected is None or (deviations > HELD_OUT.most_stds and residual > expected)
    if expected is not None:
        text += f"; noise and the deviations of the unknowns predict {percent(expected)}"
        if is_beyond_noise:
            text += f" ({format_multiple(deviations)} deviations)"
    if residual > HELD_OUT.most_residual and not is_beyond_noise:
        if expected < HELD_OUT.unclear_residual:
            return Claim(True, f"{text}.")
        return Claim(None, f"{text}: these data cannot tell.")
    reference = max(fitted, expected or 0.0)
    worse = residual > HELD_OUT.close_residual and residual > HELD_OUT.most_ratio * reference
    if residual > HELD_OUT.most_residual or (is_beyond_noise and worse):
        return Claim(False, f"{text}, that of the fitted data {percent(fitted)}.")
    return Claim(True, f"{text}.")


def _claim_plausible(
    status: str,
    correlation: Sequence[Mapping[str, Any]],
    misfit: float,
    at_bound: tuple[Sequence[str], int],
    findings: Sequence[Finding],
    not_searched: str,
    distant: Sequence[DistantUnknown],
) -> Claim:
    if status in ("stopped", "failed"):
        return Claim(None, f"The fit {status}.")
    against = [finding for finding in findings if finding.grave]
    if against:
        return Claim(False, against[0].statement)
    if misfit > PLAUSIBILITY.gross_misfit:
        return Claim(
            False,
            f"Half of the values are still off by more than {percent_of(misfit, 'their level')}.",
        )
    if distant:
        return Claim(
            False,
            f"{distant[0].statement}, and the residual is not noise: it compensates for an error"
            " elsewhere.",
        )
    names, number = at_bound
    if (
        len(names) >= PLAUSIBILITY.least_at_bound
        and len(names) > PLAUSIBILITY.most_at_bound_share * number
    ):
        return Claim(
            False, f"{len(names)} of {number} stiffnesses and masses ended at their bounds."
        )
    for one in correlation:
        before, after = one.get("before", {}), one.get("after", {})
        if not (before and after):
            continue
        if "modes_measured" in after:
            claim = claim_modes_plausible(before, after)
            if claim.holds is False:
                return claim
            continue
        residual = after["residual_median"]
        if residual >= 1.0:  # that of a model with zero response
            return Claim(
                False,
                f"The median residual is {residual:.2g} of the level of the data: a model with zero"
                " response would fit as well.",
            )
        first = before["residual_median"]
        if residual > PLAUSIBILITY.harm_ratio * first and residual > HELD_OUT.close_residual:
            return Claim(
                False,
                f"The residual rose from {first:.2g} to {residual:.2g} of the level.",
            )
    remark = findings[0].statement if findings else ""
    if not_searched:
        remark = f"The residual is not noise; {not_searched}."
    if math.isnan(misfit):
        return Claim(None, _HIDDEN, further=remark)
    text = f"Half of the values are off by less than {100.0 * misfit:.2g} %."
    modal = [one["after"] for one in correlation if "modes_measured" in one.get("after", {})]
    if modal and len(modal) == len(correlation):
        text = " ".join(describe_modes(after) for after in modal)
    complete = all(after["modes_paired"] == after["modes_measured"] for after in modal)
    if misfit < PLAUSIBILITY.rounding_misfit and complete:
        text = "The model reproduces the data except for rounding."
    return Claim(True, text, further=remark)
