"""The command line in a process of its own, to be interrupted or killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys


def updyn_process(*arguments: str, **more: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "updyn", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        # A shell's background jobs, and so their children, are born deaf to Ctrl-C.
        preexec_fn=(
            None if os.name == "nt" else lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
        ),
        **more,  # type: ignore[call-overload]
    )
