"""Badge of a result: one phrase and one of three colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from updyn.updating.judge.trust import Trust

__all__ = ["Badge", "choose_badge", "find_decisive"]

Colour = Literal["good", "warn", "bad"]


@dataclass(frozen=True, slots=True)
class Badge:
    """A verdict in a phrase: usable (good), a claim is unknown (warn), must not be used (bad)."""

    phrase: str
    colour: Colour

    @property
    def name(self) -> str:
        """The phrase within a sentence."""
        return self.phrase[0].lower() + self.phrase[1:]


#: Badges by status.
_ENDED = {
    "converged": Badge("Converged", "good"),
    "not-credible": Badge("Not credible", "bad"),
    "not-identifiable": Badge("Not all unknowns determined", "warn"),
    "max-iterations": Badge("Stopped at the iteration limit", "warn"),
    "stalled": Badge("Stalled", "warn"),
    "stopped": Badge("Stopped by the user", "warn"),
    "failed": Badge("Failed", "bad"),
}


#: Badges by the claim that is not true, the most important first.
_AGAINST = {
    "resembles": Badge("Does not resemble the test", "bad"),
    "plausible": Badge("Not credible", "bad"),
    "validated": Badge("Does not predict", "bad"),
}


def find_decisive(trust: Trust) -> str:
    """Return the name of the claim against the result that decides the badge; empty if none."""
    return next((name for name in _AGAINST if trust[name].holds is False), "")


def choose_badge(status: str, trust: Trust | None, *, ambiguous: bool = False) -> Badge:
    """Return the badge of a result; `ambiguous`: several determined solutions fit equally well."""
    badge = _ENDED.get(status, Badge(status, "warn"))
    if ambiguous:
        badge = Badge("Several answers fit", "warn")
    if trust is None or status == "failed":
        return badge
    decisive = find_decisive(trust)
    if decisive:
        return _AGAINST[decisive]
    if status != "converged":
        return badge
    if trust.plausible.holds is None or trust.determined.holds is not True:
        return Badge("Not known whether credible", "warn")
    if not trust.validated.asked:
        return Badge("Fits, not validated", "warn")
    if trust.validated.holds is None:
        return Badge("Fits, prediction not known", "warn")
    return Badge("Usable", "good")
