"""Numbers that decide when work is distributed, repeated or given up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WorkerSettings:
    """Workers of an engine, in processes or on a cluster."""

    #: [s] Time without a worker or an answer after which a cluster counts as lost. Effort: a
    #: scheduler needs some seconds to replace a worker; a user waits about a minute.
    cluster_patience: float = 60.0
    #: [items] Items that are submitted for each process. Effort: one runs, and some wait while
    #: results are used; more would delay the end after a stop.
    items_per_process: int = 3
    #: [processes] Largest number of processes for each core. Effort: more would only share it, and
    #: each takes 100 MB or more.
    processes_per_core: int = 8
    #: [s] Interval of the checks whether the parent process of a worker is alive. Effort: a
    #: fraction of a second costs no time and leaves no process behind for long.
    parent_check_interval: float = 0.5
    #: [losses] Losses without a result in between after which the work counts as the cause. Effort:
    #: a worker may be lost by chance, but hardly four times in a row.
    most_losses: int = 3
    #: [objects] Latest shared objects that workers keep. Effort: a problem and its reduced model
    #: alternate; more would take memory in every worker.
    kept_objects: int = 2


WORKERS = WorkerSettings()
