"""How a program ended, for messages."""

from __future__ import annotations

import signal

__all__ = ["describe_exit", "signal_name"]

#: Exit codes from which a shell reports a signal that ended the program it ran.
_BY_SHELL = 128


def signal_name(status: int) -> str | None:
    """Return the name of the signal that ended a program, such as SIGSEGV; None if none did.

    Parameters
    ----------
    status : int
        The return code of `subprocess`: below 0 for a signal; a shell that ran the program returns
        128 more than the signal.

    Returns
    -------
    str or None
        The name of the signal.
    """
    number = -status if status < 0 else status - _BY_SHELL
    return signal.Signals(number).name if number in set(signal.Signals) else None


def describe_exit(status: int) -> str:
    """Return how a program ended: ``signal SIGSEGV``, or ``exit code 3``."""
    name = signal_name(status)
    if name is None:
        return f"exit code {status}"
    reason = " (out of memory?)" if name == "SIGKILL" else ""
    return f"signal {name}{reason}"
