"""Where work runs: in this process, in several on this machine, or on a cluster.

An engine maps a function over items and knows no physics. Adding one is a module with ``EXPECTS``,
a text saying what it is made from, and ``engine_for(given)``, which returns the engine or None
where something else was given; and one line in `KINDS`. These modules load joblib and Dask when an
engine is made, not before.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from updyn.engines.engine import Engine, Serial
from updyn.errors import OptionError

if TYPE_CHECKING:
    import distributed

__all__ = ["KINDS", "Engine", "Serial", "choose_engine"]

#: Modules of the engines that are made from something, in the order in which they are asked.
KINDS = ("updyn.engines.processes", "updyn.engines.cluster")


def choose_engine(engine: int | distributed.Client | Engine | None) -> Engine:
    """Return the engine that is meant.

    Parameters
    ----------
    engine : None, int, dask.distributed Client or Engine
        None: this process. A number: so many processes on this machine (1: this one). A Client: the
        workers of its cluster. An engine: itself.

    Returns
    -------
    Engine
        To be closed by whoever made it here.

    Raises
    ------
    OptionError
        If it is none of these.
    """
    if engine is None:
        return Serial()
    kinds = [importlib.import_module(kind) for kind in KINDS]
    for kind in kinds:
        made: Engine | None = kind.engine_for(engine)
        if made is not None:
            return made
    if isinstance(engine, Engine) and not isinstance(engine, type):
        return engine
    expected = ", ".join(["None", *(kind.EXPECTS for kind in kinds)])
    raise OptionError(
        f"engine is {engine!r} ({type(engine).__name__}); expected {expected} or an engine"
    )
