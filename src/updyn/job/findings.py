"""What seems to be wrong with the data of a job, before any fit."""

from __future__ import annotations

from updyn.job.prepared import PreparedTest
from updyn.modal import ModeSet
from updyn.updating.diagnose import diagnose
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["job_findings"]


def job_findings(test: PreparedTest, unknowns: ParameterSet) -> tuple[Finding, ...]:
    """Return what `updyn.diagnose` finds in the data of a test.

    Parameters
    ----------
    test : PreparedTest
        The test.
    unknowns : ParameterSet
        Those of the job; calibration factors that it seeks are held at their start.

    Returns
    -------
    tuple of Finding
        The likeliest first.
    """
    own = [p for p in unknowns if not p.is_channel]
    if not own or isinstance(test.data, ModeSet):
        return ()
    job = test.job
    return diagnose(
        test.model,
        test.frf,
        ParameterSet(tuple(own)),
        noise=job.noise,
        tier=job.method.tier,
        backend=job.method.backend,
    )
