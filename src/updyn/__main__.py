"""``python -m updyn``: the command line."""

import signal
import sys

# Ctrl-C before the command line has its handlers, and after it, ends the process without a word.
signal.signal(signal.SIGINT, signal.SIG_DFL)

from updyn.cli import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
