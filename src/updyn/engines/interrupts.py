"""`block_interrupts`: only the parent process handles Ctrl-C while a process starts."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["block_interrupts"]


@contextmanager
def block_interrupts() -> Iterator[None]:
    """Block SIGINT in this thread, and in processes started meanwhile until they unblock it."""
    # A SIGINT while a process imports its modules would end it with a traceback.
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
