"""``python -m updyn``: the command line."""

import signal
import sys

# Ctrl-C before the command line installs its handlers, and afterwards, ends the process silently.
signal.signal(signal.SIGINT, signal.SIG_DFL)

from updyn.cli import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
