"""The verdict at the top of a page: badge, marks, reservations and further remarks."""

from __future__ import annotations

from dataclasses import dataclass, replace

from updyn.correlation.modes import ModeCorrelation
from updyn.report.formats import format_count
from updyn.report.section import PageContent
from updyn.updating.judge.badge import find_decisive
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.counterparts import Counterparts
from updyn.updating.judge.sentences import split_ending
from updyn.updating.judge.trust import Trust
from updyn.updating.result import UpdateResult

__all__ = ["Verdict", "VerdictPart", "count_all_modes", "verdict"]

_SIGNS = {"good": "✓", "bad": "✗", "warn": "?", "unasked": "–"}


@dataclass(frozen=True, slots=True)
class VerdictPart:
    """One question of a verdict with its answer: `truth`, None if unknown, and the reason."""

    name: str
    truth: bool | None
    why: str
    asked: bool = True

    @property
    def answer(self) -> str:
        """The answer in one word."""
        return Claim(self.truth, self.why, self.asked).answer

    @property
    def kind(self) -> str:
        """The CSS class of the mark."""
        if not self.asked:
            return "unasked"
        return {True: "good", False: "bad", None: "warn"}[self.truth]

    @property
    def sign(self) -> str:
        """The sign of the mark."""
        return _SIGNS[self.kind]

    @property
    def fails(self) -> bool:
        """Whether the question was asked and the answer is not yes."""
        return self.asked and self.truth is not True


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the result can be trusted.

    `reservation` limits a verdict that holds; `remarks` are further sentences of the message.
    `decisive` is the name of the part that alone rules the result out; empty if none does.
    """

    badge: str
    kind: str
    parts: tuple[VerdictPart, ...]
    reservation: str = ""
    remarks: str = ""
    decisive: str = ""

    def shows(self, part: VerdictPart) -> bool:
        """Whether the reason of a part is unfolded: it fails, and none is more important."""
        return part.fails and self.decisive in ("", part.name)


def verdict(content: PageContent) -> Verdict:
    """Return the verdict on the result of a page; no sentence of its message is repeated."""
    result = content.result
    badge, kind = result.badge.phrase, result.badge.colour
    if result.trust is not None:
        return _judge_by_trust(content, result.trust, Verdict(badge, kind, ()))
    text, rest = split_ending(result.message)
    steps = f"After {format_count(result.iterations, 'iteration')}."
    converged, determined = VerdictPart("Converged", True, steps), _judge_identifiability(result)
    if result.status == "not-identifiable":
        if not result.is_ambiguous:
            determined = replace(determined, why=text or determined.why)
    elif not result.ok:
        converged = VerdictPart("Converged", False, f"{text} {steps}".strip())
        if result.status == "failed":
            determined = replace(determined, truth=None)
    return Verdict(badge, kind, (converged, determined), remarks=rest)


def _judge_by_trust(content: PageContent, trust: Trust, plain: Verdict) -> Verdict:
    result = content.result
    steps = f" After {format_count(result.iterations, 'iteration')}."
    found = content.modes.correlations.get("updated") if content.has_one_test else None
    all_modes = count_all_modes(result.counterparts, found, "updated model")
    further = {"converged": steps, "resembles": all_modes if trust.resembles.holds else ""}
    parts, reservation = [], ""
    for name, claim in trust.items():
        why = claim.why + further.get(name, "")
        if name == "plausible" and claim.holds:
            why, reservation = claim.statement, claim.further
        parts.append(VerdictPart(name.capitalize(), claim.holds, why, claim.asked))
    remarks = trust.beyond(result.status, result.message)
    decisive = find_decisive(trust).capitalize() if result.status != "failed" else ""
    return replace(
        plain,
        parts=tuple(parts),
        reservation=reservation,
        remarks=remarks,
        decisive=decisive,
    )


def count_all_modes(peaks: Counterparts | None, found: ModeCorrelation | None, model: str) -> str:
    """Return a sentence on all modes of the test if some are no peaks and have no counterpart."""
    if peaks is None or peaks.source != "peaks" or found is None:
        return ""
    n_paired, n_measured = len(found.pairs.mac), len(found.measured)
    if n_paired == n_measured:
        return ""
    return (
        f" Of all {n_measured} modes identified from the test, {n_paired} have one in the {model}."
    )


def _judge_identifiability(result: UpdateResult) -> VerdictPart:
    """Return the part that states whether the data determine all unknowns."""
    n, rank = result.identifiability.n_parameters, result.identifiability.rank
    if result.is_ambiguous:
        text = (
            f"At least {1 + len(result.alternatives)} answers fit the data equally well: the values"
            " below are those of one of them."
        )
        return VerdictPart("Determined", False, text)
    if rank >= n == 1:
        text = "The data determine the one unknown."
    elif rank >= n:
        text = f"The data determine all {n} unknowns."
    elif rank == 0:
        text = f"The data determine none of the {n} unknowns."
    else:
        text = (
            f"The data determine {format_count(rank, 'independent combination')} of {n} unknowns."
        )
    return VerdictPart("Determined", rank >= n, text)
