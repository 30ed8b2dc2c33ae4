"""Run the tortures of `tests/support/torture.py` and print the table of docs/reliability.md.

python tools/torture.py                        1,000 trials and at most 2,000 cuts of each
python tools/torture.py --trials 20000 --cuts 20000            the long run
python tools/torture.py --only CSV DMIG        those whose names hold one of these words
python tools/torture.py --keep counts.json    the table has the rows of earlier runs, too
python tools/torture.py --keep counts.json --first 1000        more mutants, added to the 1,000 kept
python tools/torture.py --seed 417 --only "CSV: mutants"    one trial, told in full
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "support"))

from torture import Torture, run, table, tortures

_SHOWN = 5  # failures of one torture that are told


def _kept(path: Path | None) -> dict[tuple[str, str], Counter[str]]:
    """Return the counts of earlier runs."""
    if path is None or not path.exists():
        return {}
    rows = json.loads(path.read_text(encoding="utf-8"))
    return {(name, kind): Counter(counts) for name, kind, counts in rows}


def _begun(
    results: dict[tuple[str, str], Counter[str]], torture: Torture, first: int
) -> Counter[str]:
    """Return the counts that a run from a seed on adds to: those of the seeds before it."""
    if torture.size is not None or not first:
        return Counter()
    kept = results.get((torture.name, torture.kind), Counter())
    number = sum(kept.values())
    if kept and number != first:
        sys.exit(f"{torture.key}: {number} trials are kept; go on with --first {number}")
    return kept


def main() -> int:
    """Run them; 1 where one failed."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=1000)
    arguments.add_argument("--cuts", type=int, default=2000, help="most of one file")
    arguments.add_argument("--first", type=int, default=0, help="first seed")
    arguments.add_argument("--only", nargs="*", default=[""], help="words of names")
    arguments.add_argument("--keep", type=Path, help="JSON file of counts; those of earlier runs")
    arguments.add_argument("--seed", type=int, help="a single trial")
    given = arguments.parse_args()
    results = _kept(given.keep)
    failed = 0
    for torture in tortures().values():
        if not any(word in torture.key for word in given.only):
            continue
        if given.seed is not None:
            for _, outcome in run(torture, [given.seed]):
                print(f"{torture.key}: {outcome}")
            continue
        seeds = torture.seeds(given.cuts)
        if torture.size is None:
            seeds = range(given.first, given.first + given.trials)
        begun = time.monotonic()
        counts = results[torture.name, torture.kind] = _begun(results, torture, given.first)
        told: Counter[str] = Counter()
        for seed, outcome in run(torture, seeds):
            counts[outcome.word] += 1
            failed += outcome.failed
            said = outcome.detail.rsplit("(", 1)[-1]
            if (outcome.failed or outcome.detail.find("(reader") > 0) and told[said] < 1:
                told[said] += 1
                if len(told) <= _SHOWN:
                    print(f"  {torture.key}, seed {seed}: {outcome.word} {outcome.detail}")
        passed = time.monotonic() - begun
        print(f"{torture.key}: {dict(counts)} in {passed:.0f} s", file=sys.stderr, flush=True)
        if given.keep is not None:
            rows = [[*key, dict(counts)] for key, counts in results.items()]
            given.keep.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if results:
        print(table(results))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
