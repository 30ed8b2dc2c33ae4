"""What the data of a test show to be wrong with them, whatever the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.frf import FRF
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.shown import Shown, ShownFault
from updyn.updating.problem.noise import NoiseModel

__all__ = ["finding_of", "findings_in", "set_aside", "shown_by", "still_shown", "with_variance"]


def with_variance(frf: FRF, noise: NoiseModel) -> FRF:
    """Return data that carry their variance, as far as it is known before a fit."""
    return replace(frf, variance=noise.beforehand(frf))


def findings_in(frf: FRF, noise: NoiseModel, test: str) -> list[Finding]:
    """Return the faults that the data of a test show by themselves, the likeliest first."""
    return [finding_of(one, test) for one in shown_by(with_variance(frf, noise))]


def shown_by(frf: FRF) -> list[Shown]:
    """Return the faults that data with their variance show by themselves, the likeliest first."""
    found: list[Shown] = []
    for kind in CAUSES:
        cause = CAUSES[kind]
        if issubclass(cause, ShownFault):
            found += cause.shown(frf)
    return sorted(found, key=lambda one: -one.log_odds)


def still_shown(seen: Sequence[Shown], freed: FRF) -> list[Shown]:
    """Return what is still to be told of data when they are freed of other faults.

    A symptom that is gone without them needs no further word.
    """
    kinds = {one.fault.kind for one in shown_by(freed)}
    return [one for one in seen if not one.fault.symptom or one.fault.kind in kinds]


def set_aside(seen: Sequence[Shown], frf: FRF) -> FRF:
    """Return the data in which the values of symptoms do not count; themselves where all do."""
    for one in seen:
        frf = one.fault.set_aside(frf)
    return frf


def finding_of(one: Shown, test: str) -> Finding:
    """Return the finding that tells of a fault."""
    fault = one.fault
    return Finding(
        fault.kind,
        fault.channels,
        fault.value,
        float(np.exp(min(one.log_odds, 700.0))),
        one.share,
        fault.statement(),
        fault.remedy,
        fault.written,
        test=test,
    )
