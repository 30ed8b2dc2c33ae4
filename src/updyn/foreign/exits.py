"""Descriptions of how a program ended, for messages."""

from __future__ import annotations

import signal

__all__ = ["describe_exit", "signal_name"]

#: A shell returns this plus the number of the signal that ended its program.
_BY_SHELL = 128


def signal_name(status: int) -> str | None:
    """Return the name of the signal that ended a program (SIGSEGV), or None."""
    # A status is minus the signal, or 128 plus the signal if a shell ran the program.
    number = -status if status < 0 else status - _BY_SHELL
    return signal.Signals(number).name if number in set(signal.Signals) else None


def describe_exit(status: int) -> str:
    """Describe how a program ended: ``signal SIGSEGV``, or ``exit code 3``."""
    name = signal_name(status)
    if name is None:
        return f"exit code {status}"
    reason = " (out of memory?)" if name == "SIGKILL" else ""
    return f"signal {name}{reason}"
