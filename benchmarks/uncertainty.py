"""What follows an update of a large model, beside the update: time, and how much makes bases.

Solids of `solids.py` (18 unknowns, 60 lines, two forces, 1 % noise), fitted from a start that is
far off. Each analysis begins with what it needs of the basis of the update; with `--alone` with its
own, as if that were read from a file. Processor time, one thread.

    OMP_NUM_THREADS=1 python benchmarks/uncertainty.py [--size 2025] [--sensors 8] [--draws 20]
        [--seed 1] [--alone]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import solids

import updyn
from updyn.dynamics.reduction import Reduction

#: What makes a basis, or says how good it is.
MAKING = (
    "build",
    "compress",
    "enrich_until_accurate",
    "enrich",
    "enrich_around",
    "enrich_with_nearby_factor",
    "certify",
    "errors",
    "extend",
)


class Watch:
    """Time of what is run, and of the basis-making in it."""

    def __init__(self) -> None:
        self.bases, self._depth = 0.0, 0
        for name in MAKING:
            setattr(Reduction, name, self._timed(getattr(Reduction, name)))

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **options: Any) -> Any:
            begun, self._depth = time.process_time(), self._depth + 1
            try:
                return method(*args, **options)
            finally:
                self._depth -= 1
                if self._depth == 0:  # one calls another
                    self.bases += time.process_time() - begun

        return timed

    def run(self, name: str, work: Callable[[], Any]) -> Any:
        """Print a row, and return what the work returns."""
        begun, before = time.process_time(), self.bases
        found = work()
        whole, bases = time.process_time() - begun, self.bases - before
        print(f"| {name} | {whole:.1f} | {bases:.1f} |", flush=True)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="2025", choices=solids.CELLS)
    parser.add_argument("--sensors", type=int, default=8)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help="without the basis of the update")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    true, clean, _ = solids.measured(args.size, args.sensors)
    start, _ = solids.started(true, args.seed)
    frf, unknowns = solids.noisy(clean, args.seed), solids.everything(start)
    band, at = (float(frf.freq[0]), float(frf.freq[-1])), list(frf.responses.labels)[:2]
    watch = Watch()
    print(f"{args.size} DOFs, {args.sensors} sensors\n\n| | s | of it bases |\n|---|---|---|")
    result = watch.run("update", lambda: updyn.update(start, frf, unknowns))
    if args.alone:
        result = replace(result, kept_basis=None)
    draws = watch.run(
        f"bootstrap, {args.draws} refits", lambda: updyn.bootstrap(result, n=args.draws)
    )
    one = unknowns.names[0]
    watch.run("profile of one unknown", lambda: updyn.profile(result, [one]))
    watch.run("band, Laplace", lambda: updyn.predict(result, frf.freq, at, at[:1]))
    watch.run(f"band of {args.draws} draws", lambda: updyn.predict(draws, frf.freq, at, at[:1]))
    watch.run("plant", lambda: updyn.plant(result, at[:1], at, band))
    watch.run("family of 10 plants", lambda: updyn.plant_family(result, at[:1], at, band, n=10))


if __name__ == "__main__":
    main()
