"""`RecordFinding`: something that is wrong with time records."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RecordFinding"]


@dataclass(frozen=True, slots=True)
class RecordFinding:
    """Something that is wrong with a record, or with several as a whole.

    Attributes
    ----------
    kind : str
        ``"clipped"``, ``"double-hit"``, ``"short-force"``, ``"cut-off"``, ``"leakage"``,
        ``"drift"``, ``"mains"``, ``"noise-floor"`` or ``"level-dependence"``.
    channel : str
        Which channel.
    record : int or None
        Which record, from 1; None: all of them together.
    value : float
        By how much, in the unit that the statement names.
    statement : str
        What is wrong, in a sentence.
    remedy : str
        What to do.
    band : (float, float) or None
        The lines in Hz that it concerns; None: all.
    """

    kind: str
    channel: str
    record: int | None
    value: float
    statement: str
    remedy: str
    band: tuple[float, float] | None = None
