"""Write tests/data/seconds.txt from the durations that pytest prints.

    make test PYTEST_ARGS="--durations=0 --durations-min=0.5" | tee LOG
    python tools/slow_tests.py LOG

A setup counts for the whole file, because the first test that runs pays for the fixture.
"""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from pathlib import Path

PAGE = Path(__file__).parents[1] / "tests" / "data" / "seconds.txt"
#: Seconds below which a test is not recorded: it changes neither the mark nor the order.
LEAST = 0.5
_ROW = re.compile(r"^([\d.]+)s (setup|call) +(tests/\S+?\.py)::(\w+(?:::\w+)*)")
HEAD = """\
# Seconds of tests, and of files for fixtures that their tests share: see tests/support/slow.py.
# Written by tools/slow_tests.py.
"""


def seconds(log: str) -> dict[str, float]:
    """Return the longest run of each test, whatever its parameters, and of each file's fixtures."""
    longest: dict[str, float] = defaultdict(float)
    for line in log.splitlines():
        if row := _ROW.match(line):
            time, phase, file, test = row.groups()
            name = file if phase == "setup" else f"{file}::{test}"
            longest[name] = max(longest[name], float(time))
    return {name: time for name, time in longest.items() if time >= LEAST}


def main() -> None:
    """Read logs, write the file."""
    found = seconds("\n".join(Path(name).read_text(encoding="utf-8") for name in sys.argv[1:]))
    rows = sorted(found.items(), key=lambda row: (-row[1], row[0]))
    text = "".join(f"{time:6.1f} {name}\n" for name, time in rows)
    PAGE.write_text(HEAD + text, encoding="utf-8")


if __name__ == "__main__":
    main()
