"""Engines map a function over items: in this process, in several processes, or on a cluster.

An engine is independent of physics. Another package adds one by registering a class in `KINDS`
(see `EngineKind`). The modules of the built-in engines load joblib and Dask when an engine is
created.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from updyn.engines.engine import Engine, EngineKind, Serial
from updyn.errors import OptionError
from updyn.registry import Registry

if TYPE_CHECKING:
    import distributed

__all__ = ["KINDS", "Engine", "EngineKind", "Serial", "choose_engine", "opened_engine"]

#: Kinds of engines by name, in the order in which they are tried.
KINDS: Registry[EngineKind] = Registry(
    "engine",
    "updyn.engines",
    {
        "serial": Serial,
        "processes": "updyn.engines.processes:Processes",
        "dask": "updyn.engines.cluster:Cluster",
    },
)


def choose_engine(engine: int | str | distributed.Client | Engine | None) -> Engine:
    """Return the engine for an option ``engine=``.

    Parameters
    ----------
    engine : None, int, str, dask.distributed Client or Engine
        None: this process. A number: number of processes on this machine (1: this process). A
        Client: the workers of its cluster. An engine: itself. A text, or another object: the
        engine of a registered kind that accepts it.

    Returns
    -------
    Engine
        The engine; the caller closes it if it was created here.

    Raises
    ------
    OptionError
        If no kind of engine accepts the option.
    """
    if engine is None:
        return Serial()
    for kind in KINDS.values():
        made = kind.from_option(engine)
        if made is not None:
            return made
    if isinstance(engine, Engine) and not isinstance(engine, type):
        return engine
    expected = ", ".join(kind.expects for kind in KINDS.values())
    raise OptionError(
        f"engine is {engine!r} ({type(engine).__name__}); expected {expected} or an engine"
    )


@contextmanager
def opened_engine(engine: int | str | distributed.Client | Engine | None) -> Iterator[Engine]:
    """Yield the engine for an option ``engine=``, and close it afterwards if it was created here.

    Parameters
    ----------
    engine : None, int, str, dask.distributed Client or Engine
        As for `choose_engine`.

    Yields
    ------
    Engine

    Raises
    ------
    OptionError
        If no kind of engine accepts the option.
    """
    chosen = choose_engine(engine)
    try:
        yield chosen
    finally:
        if chosen is not engine:
            chosen.close()
