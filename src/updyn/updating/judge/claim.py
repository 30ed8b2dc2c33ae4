"""Claim: one part of the verdict, which holds, does not hold or is unknown, with its reason."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PARTS", "Claim"]

#: Names of the claims of a verdict, in order.
PARTS = ("resembles", "converged", "determined", "validated", "plausible")


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One part of the verdict, which compares equal to True, False or None (unknown).

    `why` is a sentence with the decisive figure. A claim that was not `asked`, because the data
    were not intended to answer it, does not affect the verdict.
    """

    holds: bool | None
    why: str
    asked: bool = True

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
