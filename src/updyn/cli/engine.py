"""Where a run's work is done: from the options of the command line to an engine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from updyn.errors import OptionError

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine

__all__ = ["engine"]

_PATIENCE_S = 10


@contextmanager
def engine(
    workers: int | None, cluster: str | None, registered: str | None = None
) -> Iterator[Engine]:
    """Give the engine that is asked for, and close it.

    Parameters
    ----------
    workers : int, optional
        Number of processes.
    cluster : str, optional
        Address of a Dask scheduler.
    registered : str, optional
        Engine that another package has registered.

    Raises
    ------
    OptionError
        If more than one is given, the number is not one of processes, no scheduler answers, or no
        engine is registered for the text.
    """
    from updyn.engines import choose_engine

    if workers is not None and cluster is not None:
        raise OptionError(
            "--workers and --cluster exclude each other: the work is done here or there"
        )
    if workers is not None and workers < 1:
        raise OptionError(f"--workers {workers}: expected a number of processes from 1 up")
    if registered is not None and not (workers is None and cluster is None):
        raise OptionError("--engine excludes --workers and --cluster")
    with ExitStack() as ending:
        option: int | str | Client | None = workers
        if registered is not None:
            option = registered
        elif cluster is not None:
            option = ending.enter_context(_client(cluster))
        made = choose_engine(option)
        ending.callback(made.close)
        yield made


def _client(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise OptionError(
            "--cluster needs dask.distributed: pip install 'updyn[cluster]'"
        ) from error
    try:
        # Not as the default: xarray would ask the scheduler, perhaps gone by then, for a lock
        # before it writes a file.
        return Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is one of these
        raise OptionError(
            f"--cluster {address!r}: no scheduler answers ({' '.join(str(error).split())}); `dask"
            " scheduler` starts one and says its address"
        ) from error
