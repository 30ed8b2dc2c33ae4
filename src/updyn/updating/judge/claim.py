"""`Claim`: one part of the verdict, yes, no or not known, with its sentence."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PARTS", "Claim"]

#: The parts of a verdict, in their order.
PARTS = ("resembles", "converged", "determined", "validated", "plausible")


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One part of the verdict. It compares equal to True, False or None.

    Attributes
    ----------
    holds : bool or None
        Yes, no, or not known.
    why : str
        A sentence with the figure that it hangs on.
    asked : bool
        Whether the data were to answer it: what was not asked for counts neither way.
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
