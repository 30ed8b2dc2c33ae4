"""``python -m updyn``: the command line."""

import sys

from updyn.cli import main

sys.exit(main())
