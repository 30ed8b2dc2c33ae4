"""The measured beam in more and fewer segments: agreement on the fitted and the held-out sensors.

The whole beam first, then from there each number of segments, as the demo does it. Medians over all
lines from 100 to 4500 Hz, sensors fitted and held out.

    python benchmarks/beam.py [--segments 2 3 4 5 6]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from updyn.demos import beam
from updyn.job import load_job, run_job
from updyn.updating.result import UpdateResult


def run(job: Path, out: Path) -> UpdateResult:
    job.write_text(
        job.read_text(encoding="utf-8") + "\n[output]\nreport = false\n", encoding="utf-8"
    )
    begun = time.perf_counter()
    result = run_job(load_job(job), out).result
    fitted, held = result.correlation["after"], result.correlation["validation"]["after"]
    print(
        f"{result.title:<26} {len(result.parameters):>8} {fitted['db_error_median']:>8.3f}"
        f" {fitted['frac_median']:>6.3f}   {held['db_error_median']:>8.3f}"
        f" {held['frac_median']:>6.3f}   {result.status:<16} {time.perf_counter() - begun:>4.0f} s",
        flush=True,
    )
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--segments", type=int, nargs="+", default=[2, 3, 4, 5, 6])
    given = parser.parse_args()
    print(
        f"{'':<26} {'unknowns':>8} {'fitted dB':>9} {'FRAC':>5}   {'held dB':>8} {'FRAC':>6}  "
        " status"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = run(beam.write_inputs(folder), folder / "whole")
        for number in given.segments:
            run(beam.segments_job(whole.values, folder, number), folder / f"{number}")


if __name__ == "__main__":
    main()
