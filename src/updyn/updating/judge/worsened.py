"""Natural frequencies and shapes whose agreement with the test an update reduced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from updyn.updating.judge.claim import Claim
from updyn.updating.judge.modal_table import ModalRow, ModalTable
from updyn.updating.judge.modal_trust import BAD, HARM, SMALL
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.modal import LIKE

__all__ = ["Worsened", "judge_modes", "worsened_modes"]

#: Decrease of the MAC that is reported, and MAC below which shapes do not agree.
_LOSS, _ALIKE = 0.05, 0.9


@dataclass(frozen=True, slots=True)
class Worsened:
    """A measured mode that agrees less with the updated model than with the start model.

    Attributes
    ----------
    frequency : float
        Measured natural frequency in Hz.
    statement : str
        Description of the change.
    error : float
        Error of the updated frequency in %, if the frequency is worse; otherwise 0.
    """

    frequency: float
    statement: str
    error: float = 0.0


def worsened_modes(table: ModalTable) -> tuple[Worsened, ...]:
    """Return the modes that an update made worse, in order of decreasing frequency error."""
    found: list[Worsened] = []
    for row in table.rows:
        found += _worsened(row)
    return tuple(sorted(found, key=lambda one: (-one.error, one.frequency)))


def _worsened(row: ModalRow) -> list[Worsened]:
    """Return the changes for the worse of a mode that is in the start and the updated model."""
    if row.test is None or row.start is None or row.updated is None:
        return []
    # The shapes of close modes are arbitrary, and a poor pair may be due to chance.
    if row.start.in_subspace or row.updated.in_subspace:
        return []
    hertz, found = row.test.frequency, []
    before, after = row.start.change, row.updated.change
    likes = [mac for mac in (row.start.mac, row.updated.mac) if mac is not None]
    if before is not None and after is not None and min(likes, default=1.0) >= LIKE:
        was, now = abs(before), abs(after)
        if now > SMALL and now > HARM * was:
            said = f"the natural frequency {hertz:.4g} Hz was {was:.2g} % off and is {now:.2g} %"
            found.append(Worsened(hertz, said, now))
    first, last = row.start.mac, row.updated.mac
    if first is not None and last is not None and last < min(first - _LOSS, _ALIKE):
        said = f"the MAC of the mode at {hertz:.4g} Hz fell from {first:.2f} to {last:.2f}"
        found.append(Worsened(hertz, said))
    return found


def judge_modes(trust: Trust, tables: Sequence[ModalTable]) -> Trust:
    """Return a verdict that takes account of the modes which the update made worse.

    The result is not plausible if a natural frequency is worse than at the start and in error by
    more than 3 %, unless the held-out data already contradict it. Otherwise, the largest change is
    added to the sentence.
    """
    worse = [one for table in tables for one in worsened_modes(table)]
    if not worse or trust.plausible.holds is False:
        return trust
    worst = max(worse, key=lambda one: one.error)
    if worst.error > BAD and trust.validated.holds is not False:
        return replace(trust, plausible=Claim(False, f"By the update, {worst.statement}."))
    said = f"{trust.plausible.why} By the update, {worst.statement}."
    return replace(trust, plausible=Claim(trust.plausible.holds, said))
