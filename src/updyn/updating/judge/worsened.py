"""Natural frequencies and shapes that an update moved away from the test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from updyn.updating.judge.claim import Claim
from updyn.updating.judge.modal_table import ModalRow, ModalTable
from updyn.updating.judge.modal_trust import BAD, HARM, SMALL
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.modal import LIKE

__all__ = ["Worsened", "judge_modes", "worsened_modes"]

#: Loss of MAC that is worse, and the MAC below which shapes are said not to agree.
_LOSS, _ALIKE = 0.05, 0.9


@dataclass(frozen=True, slots=True)
class Worsened:
    """A measured mode from which the updated model is farther than the start.

    Attributes
    ----------
    frequency : float
        Of the measured mode in Hz.
    statement : str
        What became worse, in words.
    error : float
        Of the updated frequency, in %, where it is that; else 0.
    """

    frequency: float
    statement: str
    error: float = 0.0


def worsened_modes(table: ModalTable) -> tuple[Worsened, ...]:
    """Return the modes that an update made worse, the largest error of frequency first.

    Parameters
    ----------
    table : ModalTable
        Modes of the test, at the start and updated.
    """
    found: list[Worsened] = []
    for row in table.rows:
        found += _worsened(row)
    return tuple(sorted(found, key=lambda one: (-one.error, one.frequency)))


def _worsened(row: ModalRow) -> list[Worsened]:
    """Return what is worse of a mode that the start and the updated model have."""
    if row.test is None or row.start is None or row.updated is None:
        return []
    # A shape of close modes is arbitrary, and a poor pair may be one by chance.
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

    Parameters
    ----------
    trust : Trust
        The verdict without modes.
    tables : sequence of ModalTable
        Of all tests.

    Returns
    -------
    Trust
        Not plausible where the frequency of a mode is worse than at the start and more than 3 %
        off, unless held-out data speak against the answer already; else the largest change is
        named.
    """
    worse = [one for table in tables for one in worsened_modes(table)]
    if not worse or trust.plausible.holds is False:
        return trust
    worst = max(worse, key=lambda one: one.error)
    if worst.error > BAD and trust.validated.holds is not False:
        return replace(trust, plausible=Claim(False, f"By the update, {worst.statement}."))
    said = f"{trust.plausible.why} By the update, {worst.statement}."
    return replace(trust, plausible=Claim(trust.plausible.holds, said))
