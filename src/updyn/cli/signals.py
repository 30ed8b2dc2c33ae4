"""What Ctrl-C (SIGINT) and SIGTERM do: they are answered at once, and end the process in time."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from updyn.cli.terminal import STOPPED, TERMINATED, print_note

__all__ = ["STOP_SIGNALS", "LastResort", "ending_at_once", "stop_code", "watched"]

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: How long the process has to end by itself, in s: a factorisation under way cannot be interrupted.
_GRACE = 3.0
#: How long a signal waits for its handler before it is answered, in s.
_ANSWER = 0.2
#: Delay before a lost signal is sent again, in s: the destructor or callback has ended by then.
_AGAIN = 0.02
_LEAVING = "Leaving at once."
#: The latest of them that has come; what was stopped in order asks for it.
_latest = [int(signal.SIGINT)]


def stop_code(number: int | None = None) -> int:
    """Return the exit code of a process that a signal has stopped; by default the latest."""
    return TERMINATED if (number or _latest[0]) == signal.SIGTERM else STOPPED


@contextmanager
def watched(
    interrupt: Callable[[int, FrameType | None], None], answer: Callable[[int], None]
) -> Iterator[None]:
    """Send each SIGINT and SIGTERM to a handler, and its number to a thread, at once.

    Python calls a handler only between two of its own instructions, which a long factorisation
    holds up; the thread is not held up.

    Parameters
    ----------
    interrupt : callable
        The handler.
    answer : callable
        Takes the number of the signal; called in the thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may handle signals
        return
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)

    def watch() -> None:
        while received := ours.recv(64):
            for number in received:
                if number in STOP_SIGNALS:
                    answer(number)

    def handle(number: int, frame: FrameType | None) -> None:
        _latest[0] = number
        interrupt(number, frame)

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    before = [(number, signal.signal(number, handle)) for number in STOP_SIGNALS]
    woken = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    try:
        with _raised_again():
            yield
    finally:
        signal.set_wakeup_fd(woken)
        for number, handler in before:
            signal.signal(number, handler)
        theirs.close()
        watching.join()
        ours.close()


def _send(number: int) -> None:
    """Send a signal to the main thread, whose system call it interrupts where the system can."""
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        signal.raise_signal(number)
    else:
        signal.pthread_kill(main, number)


@contextmanager
def _raised_again() -> Iterator[None]:
    """Send a signal again whose `KeyboardInterrupt` was lost.

    A handler can be called in a destructor or in a callback of a C library. Python prints what is
    raised there and goes on.
    """
    before, timers = sys.unraisablehook, list[threading.Timer]()

    def hook(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            before(lost)
            return
        timers.append(threading.Timer(_AGAIN, _send, (_latest[0],)))
        timers[-1].daemon = True
        timers[-1].start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
        for timer in timers:
            timer.cancel()


class LastResort:
    """Ends the process where it does not end by itself within `_GRACE`."""

    def __init__(self) -> None:
        self._timer: threading.Timer | None = None

    def begin(self, number: int) -> None:
        """End the process in a while, as one that a signal has stopped."""
        if self._timer is None:
            self._timer = threading.Timer(_GRACE, _end, (stop_code(number),))
            self._timer.daemon = True
            self._timer.start()

    def cancel(self) -> None:
        """Take that back."""
        if self._timer is not None:
            self._timer.cancel()


def _end(code: int) -> None:
    """End the process without unwinding; its locks are given back."""
    from updyn.outputs.lock import release_all

    release_all()
    os._exit(code)


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let a signal end the command that is under way, where it has nothing to stop in order.

    Raises
    ------
    KeyboardInterrupt
        After a signal, whatever was raised: libraries turn an interrupt into other errors.
    """
    last, handled = LastResort(), threading.Event()

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        handled.set()
        raise KeyboardInterrupt

    def answer(number: int) -> None:
        last.begin(number)
        if not handled.wait(_ANSWER):
            print_note(_LEAVING, "yellow")

    try:
        with watched(interrupt, answer):
            yield
    except Exception:
        if handled.is_set():
            raise KeyboardInterrupt from None
        raise
    finally:
        last.cancel()
