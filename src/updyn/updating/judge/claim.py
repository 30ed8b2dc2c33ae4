"""Claim: one part of the verdict, which holds, does not hold or is unknown, with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

__all__ = ["PARTS", "Claim"]

#: Names of the claims of a verdict, in order.
PARTS = ("resembles", "converged", "determined", "validated", "plausible")


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One part of the verdict, which compares equal to True, False or None (unknown).

    `statement` has the decisive figure, `further` are sentences that qualify it. A claim that was
    not `asked`, because the data were not intended to answer it, does not affect the verdict.
    """

    holds: bool | None
    statement: str
    asked: bool = True
    further: str = ""

    @classmethod
    def join(cls, holds: bool | None, sentences: Sequence[str], *, asked: bool = True) -> Self:
        """Return a claim on several tests from a sentence on each; equal ones appear once."""
        first, *others = dict.fromkeys(sentences)
        return cls(holds, first, asked, " ".join(others))

    @property
    def why(self) -> str:
        """The reason in full."""
        return f"{self.statement} {self.further}".strip()

    def add(self, sentence: str) -> Claim:
        """Return the claim with a further sentence."""
        return replace(self, further=f"{self.further} {sentence}".strip())

    def __bool__(self) -> bool:
        return self.holds is True

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Claim):
            return (self.holds, self.why) == (other.holds, other.why)
        return self.holds is other

    def __hash__(self) -> int:
        return hash((self.holds, self.why))

    def __str__(self) -> str:
        return f"{self.answer}: {self.why}"

    @property
    def answer(self) -> str:
        """``"yes"``, ``"no"``, ``"not known"`` or ``"not asked"``."""
        if not self.asked:
            return "not asked"
        return {True: "yes", False: "no", None: "not known"}[self.holds]
