"""Probable faults of the data of a job, before any fit."""

from __future__ import annotations

from updyn.job.prepared import PreparedTest
from updyn.modal import ModeSet
from updyn.updating.diagnose import diagnose
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["job_findings"]


def job_findings(test: PreparedTest, unknowns: ParameterSet) -> tuple[Finding, ...]:
    """Return the findings of `updyn.diagnose` in the data of a test.

    Parameters
    ----------
    test : PreparedTest
        The test.
    unknowns : ParameterSet
        The unknowns of the job; calibration factors keep their start values.

    Returns
    -------
    tuple of Finding
        The findings, most likely first.
    """
    model_unknowns = [p for p in unknowns if not p.is_channel]
    if not model_unknowns or isinstance(test.data, ModeSet):
        return ()
    job = test.job
    return diagnose(
        test.model,
        test.frf,
        ParameterSet(tuple(model_unknowns)),
        noise=test.noise or job.noise,
        tier=job.method.tier,
        backend=job.method.backend,
    )
