"""Natural frequencies and shapes whose agreement with the test an update reduced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from updyn.updating.judge.claim import Claim
from updyn.updating.judge.modal_table import ModalRow, ModalTable
from updyn.updating.judge.settings import MODAL_TRUST, PLAUSIBILITY
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.settings import MODE_PAIRS

__all__ = ["WorsenedMode", "find_worsened_modes", "judge_modes"]


@dataclass(frozen=True, slots=True)
class WorsenedMode:
    """A measured mode, in Hz, that agrees less with the updated model than with the start model.

    `error` is that of the updated frequency in %, if the frequency is worse; otherwise 0.
    """

    frequency: float
    statement: str
    error: float = 0.0


def find_worsened_modes(table: ModalTable) -> tuple[WorsenedMode, ...]:
    """Return the modes that an update made worse, in order of decreasing frequency error."""
    found: list[WorsenedMode] = []
    for row in table.rows:
        found += _compare_row(row)
    return tuple(sorted(found, key=lambda one: (-one.error, one.frequency)))


def _compare_row(row: ModalRow) -> list[WorsenedMode]:
    """Return the changes for the worse of a mode that is in the start and the updated model."""
    if row.test is None or row.start is None or row.updated is None:
        return []
    # The shapes of close modes are arbitrary, and a poor pair may be due to chance.
    if row.start.in_subspace or row.updated.in_subspace:
        return []
    hertz, found = row.test.frequency, []
    before, after = row.start.change, row.updated.change
    macs = [mac for mac in (row.start.mac, row.updated.mac) if mac is not None]
    if (
        before is not None
        and after is not None
        and min(macs, default=1.0) >= MODE_PAIRS.similar_mac
    ):
        error_before, error_after = abs(before), abs(after)
        least = max(MODAL_TRUST.small_error, PLAUSIBILITY.harm_ratio * error_before)
        if error_after > least:
            statement = (
                f"the error of the natural frequency {hertz:.4g} Hz rose from"
                f" {error_before:.2g} % to {error_after:.2g} %"
            )
            found.append(WorsenedMode(hertz, statement, error_after))
    first, last = row.start.mac, row.updated.mac
    if first is None or last is None:
        return found
    if last < min(first - MODAL_TRUST.mac_loss, MODAL_TRUST.agreeing_mac):
        statement = f"the MAC of the mode at {hertz:.4g} Hz fell from {first:.2f} to {last:.2f}"
        found.append(WorsenedMode(hertz, statement))
    return found


def judge_modes(trust: Trust, tables: Sequence[ModalTable]) -> Trust:
    """Return a verdict that takes account of the modes which the update made worse."""
    # The result is not plausible if a natural frequency is worse than at the start and in error by
    # more than 3 %, unless the held-out data already contradict it.
    worse = [one for table in tables for one in find_worsened_modes(table)]
    if not worse or trust.plausible.holds is False:
        return trust
    worst = max(worse, key=lambda one: one.error)
    if worst.error > MODAL_TRUST.most_error and trust.validated.holds is not False:
        return replace(trust, plausible=Claim(False, f"By the update, {worst.statement}."))
    return replace(trust, plausible=trust.plausible.add(f"By the update, {worst.statement}."))
