"""The ``[uncertainty]`` table of a job: what is asked of the update once it has ended."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from updyn.errors import OptionError, UpdynError, UpdynWarning
from updyn.job.schema import Job

if TYPE_CHECKING:
    from updyn.uncertainty.draws import Draws
    from updyn.uncertainty.profile import Profiles
    from updyn.updating.fit.monitor import Progress
    from updyn.updating.problem.parameters import ParameterSet
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["UNCERTAINTY", "check_uncertainty", "uncertainty_of"]

#: The file that it is written to, beside the results.
UNCERTAINTY = "uncertainty.nc"


def check_uncertainty(job: Job, parameters: ParameterSet) -> None:
    """Check what can be known before the run.

    Raises
    ------
    JobError
        If an unknown is not among those of the job, or the method has no likelihood.
    """
    wish = job.uncertainty
    if wish is None:
        return
    from updyn.uncertainty.setting import LIKELIHOOD, WITH_NOISE, chosen

    try:
        if wish.names is not None and job.selection is None:  # which joins unknowns under new names
            chosen(wish.names, parameters.names)
    except OptionError as error:
        raise job.error(f"uncertainty: {error}", "uncertainty", "names") from error
    methods = WITH_NOISE if wish.kind == "bootstrap" else LIKELIHOOD
    if job.method.name not in methods:
        said = " or ".join(repr(m) for m in methods)
        raise job.error(
            f"uncertainty: kind {wish.kind!r} is of a fit by {said}; [method] name is"
            f" {job.method.name!r}",
            "uncertainty",
            "kind",
        )


def uncertainty_of(
    result: UpdateResult | JointResult,
    job: Job,
    callback: Callable[[Progress], bool | None] | None,
    engine: Any,
) -> Draws | Profiles | None:
    """Return what the job asks for; None where it asks for nothing, or it cannot be had.

    Parameters
    ----------
    result : UpdateResult or JointResult
        The update.
    job : Job
        Its job.
    callback : callable or None
        As for `run_job`.
    engine : object
        As for `run_job`.

    Warns
    -----
    UpdynWarning
        If it cannot be had, with the reason; the update is not lost for that.
    """
    wish = job.uncertainty
    if wish is None or result.status == "stopped":
        return None
    import updyn.uncertainty.bootstrap as by_refits
    import updyn.uncertainty.profile as by_profile
    import updyn.uncertainty.sampling as by_sampling

    how: dict[str, Any] = {"seed": wish.seed, "engine": engine, "callback": _shown(callback)}
    if wish.n is not None and wish.kind != "profile":
        how["n"] = wish.n
    try:
        if wish.kind == "profile":
            return by_profile.profile(result, wish.names, level=wish.level, **how)
        draw = by_refits.bootstrap if wish.kind == "bootstrap" else by_sampling.sample
        found = draw(result, **how)
        return replace(found, options={**found.options, "level": wish.level})
    except UpdynError as error:
        warnings.warn(f"{job.path}: [uncertainty] is left out: {error}", UpdynWarning, stacklevel=3)
        return None


def _shown(callback: Callable[[Progress], bool | None] | None) -> Any:
    """Return a callback that shows progress of this work as that of the update is shown."""
    if callback is None:
        return None
    from updyn.updating.fit.monitor import Progress as Step

    def show(progress: Any) -> bool | None:
        said = f"{progress.stage} {progress.done} of {progress.total}"
        stage = f"{said}, {progress.note}" if progress.note else said
        return callback(Step(stage, progress.done, float("nan"), progress.done, progress.total))

    return show
