"""Handling of Ctrl-C (SIGINT) and SIGTERM: an immediate answer, and an end within a time limit."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from updyn.cli.settings import WAITING
from updyn.cli.terminal import STOPPED, TERMINATED, print_note

__all__ = ["STOP_SIGNALS", "LastResort", "end_on_signal", "stop_code", "watch_signals"]

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LEAVING = "Leaving at once."
#: The latest signal received, for the exit code of an orderly stop.
_latest = [int(signal.SIGINT)]


def stop_code(number: int | None = None) -> int:
    """Return the exit code of a process stopped by a signal, by default the latest."""
    return TERMINATED if (number or _latest[0]) == signal.SIGTERM else STOPPED


@contextmanager
def watch_signals(
    interrupt: Callable[[int, FrameType | None], None], answer: Callable[[int], None]
) -> Iterator[None]:
    """Call a handler on each SIGINT and SIGTERM, and `answer` with its number in a thread."""
    # Python calls a handler only between two of its instructions, which a long factorisation
    # delays; the thread is not delayed.
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
        with _resend_lost_signals():
            yield
    finally:
        signal.set_wakeup_fd(woken)
        for number, handler in before:
            signal.signal(number, handler)
        theirs.close()
        watching.join()
        ours.close()


def _send(number: int) -> None:
    """Send a signal to the main thread, interrupting its system call if possible."""
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        signal.raise_signal(number)
    else:
        signal.pthread_kill(main, number)


@contextmanager
def _resend_lost_signals() -> Iterator[None]:
    """Send a signal again if its `KeyboardInterrupt` was lost."""
    # A handler can be called in a destructor or in a callback of a C library, where Python prints
    # exceptions and continues.
    before, timers = sys.unraisablehook, list[threading.Timer]()

    def hook(lost: sys.UnraisableHookArgs) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            before(lost)
            return
        timers.append(threading.Timer(WAITING.resend_time, _send, (_latest[0],)))
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
    """Ends the process if it does not end by itself within a grace period."""

    def __init__(self) -> None:
        self._timer: threading.Timer | None = None

    def begin(self, number: int) -> None:
        """End the process after the grace period, with the exit code of a signal."""
        if self._timer is None:
            self._timer = threading.Timer(WAITING.grace_time, _end, (stop_code(number),))
            self._timer.daemon = True
            self._timer.start()

    def cancel(self) -> None:
        """Cancel the forced end."""
        if self._timer is not None:
            self._timer.cancel()


def _end(code: int) -> None:
    """End the process without unwinding, after releasing its locks."""
    from updyn.outputs.lock import release_all

    release_all()
    os._exit(code)


@contextmanager
def end_on_signal() -> Iterator[None]:
    """Let a signal end the running command, if it cannot stop in an orderly way."""
    # A `KeyboardInterrupt` is raised even if libraries turn the interrupt into other errors.
    last, handled = LastResort(), threading.Event()

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        handled.set()
        raise KeyboardInterrupt

    def answer(number: int) -> None:
        last.begin(number)
        if not handled.wait(WAITING.answer_time):
            print_note(_LEAVING, "yellow")

    try:
        with watch_signals(interrupt, answer):
            yield
    except Exception:
        if handled.is_set():
            raise KeyboardInterrupt from None
        raise
    finally:
        last.cancel()
