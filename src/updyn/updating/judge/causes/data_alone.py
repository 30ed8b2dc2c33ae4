"""Faults of a test that the data show without a model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from updyn.errors import SolverError, UpdynError
from updyn.frf import FRF
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.finding import Finding, make_fault_finding
from updyn.updating.judge.causes.misfit import add_resolution
from updyn.updating.judge.causes.rigid_body import RigidBody
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart

__all__ = [
    "detect_data_faults",
    "drop_expected",
    "drop_explained_symptoms",
    "find_data_faults",
    "make_finding",
    "mask_symptoms",
    "with_variance",
]


def with_variance(frf: FRF, noise: NoiseModel) -> FRF:
    """Return the data with their variance, as far as it is known before a fit."""
    return replace(frf, variance=add_resolution(noise.initial_variance(frf), frf))


def find_data_faults(part: FRFPart, noise: NoiseModel) -> list[Finding]:
    """Return the faults that the data of a test show without a model, the likeliest first."""
    frf = with_variance(part.frf, noise)
    detections = drop_expected(detect_data_faults(frf, RigidShapes.of(part)), part)
    return [make_finding(one, part.name) for one in detections]


def drop_expected(detections: Sequence[Detection], part: FRFPart) -> list[Detection]:
    """Return the faults that correct data would not show, as far as the model can be solved."""
    return [one for one in detections if not _is_expected(one, part)]


def _is_expected(detection: Detection, part: FRFPart) -> bool:
    """Return whether correct data show the fault, too; False if the model cannot be solved."""
    try:
        return detection.fault.is_expected(part)
    except SolverError:
        return False


def detect_data_faults(frf: FRF, rigid: RigidShapes | None = None) -> list[Detection]:
    """Return the faults that data with variance show without a model, the likeliest first."""
    if not frf.values.any():
        return []
    found: list[Detection] = []
    for kind in CAUSES:
        cause = CAUSES[kind]
        if issubclass(cause, DataFault) and cause.applies_to(frf):
            found += cause.detect_faults(frf)
    if rigid is not None and RigidBody.applies_to(frf):
        found += RigidBody.detect_in(frf, rigid)
    imitated = {kind for one in found for kind in one.fault.imitated_kinds}
    clear = [one for one in found if one.fault.kind not in imitated]
    return sorted(clear, key=lambda one: -one.log_odds)


def drop_explained_symptoms(
    detections: Sequence[Detection],
    frf: FRF,
    findings: Sequence[Finding],
    rigid: RigidShapes | None = None,
) -> list[Detection]:
    """Return the faults that data show, except symptoms that repaired data do not show."""
    symptoms = [one for one in detections if one.fault.is_symptom]
    if not symptoms:
        return list(detections)
    repaired = frf
    for finding in findings:
        if finding.written:
            with suppress(UpdynError):  # a repair that leaves too little
                repaired = finding.repair(repaired)
    after = {one.fault.kind for one in detect_data_faults(repaired, rigid)}
    return [one for one in detections if not one.fault.is_symptom or one.fault.kind in after]


def mask_symptoms(detections: Sequence[Detection], frf: FRF) -> FRF:
    """Return the data with no weight on values with symptoms; itself if there are no symptoms."""
    for one in detections:
        frf = one.fault.mask_values(frf)
    return frf


def make_finding(one: Detection, test: str) -> Finding:
    """Return the finding of a fault that the data show."""
    return make_fault_finding(one.fault, one.log_odds, one.share, test)
