"""Differences of the demos' results between the kernels of OpenBLAS, in standard deviations.

Each job of each demo is fitted under each kernel in a separate process: the fit alone, without
report, plant and uncertainty beyond the standard deviations. For every unknown that the data
determine, the difference between kernels in standard deviations of the estimate.

    python benchmarks/kernels.py [--kernels Haswell Prescott SkylakeX] [--demos beam gear-train ...]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
from kernels import environment, kernels_used

DEMOS = ("beam", "gear-train", "antenna", "chain")
#: Tables of a job that change nothing of its fit, and the file that it writes in place of them.
BESIDE = ("plant", "servo", "uncertainty", "output")
#: Standard deviations below this share of a value are those of exact data: rounding, not noise.
EXACT = 1e-6


def fit_only(path: Path) -> Path:
    """Take from a job what comes after its fit."""
    job = tomlkit.parse(path.read_text(encoding="utf-8"))
    for table in BESIDE:
        job.pop(table, None)
    job["output"] = {"report": False}
    path.write_text(tomlkit.dumps(job), encoding="utf-8")
    return path


def run_demo(name: str) -> None:
    """Fit the jobs of a demo, one after the other, and print what each found."""
    from updyn.demos import find_demo
    from updyn.job import load_job, run_job

    warnings.simplefilter("ignore")
    demo, results = find_demo(name), []
    with tempfile.TemporaryDirectory() as folder:
        inputs, found = Path(folder), []
        job: Path | None = demo.write_inputs(inputs)
        while job is not None:
            result = run_job(load_job(fit_only(job)), inputs / "out" / job.stem).result
            results.append(result)
            values = {n: [v, result.std[n]] for n, v in result.values.items()}
            found.append({"job": job.stem, "status": result.status, "found": values})
            job = demo.next_job(results, inputs)
    print(json.dumps(found))


def fitted(demo: str, kernel: str) -> list[dict[str, Any]]:
    """Return what a process of a kernel found, job by job."""
    run = [sys.executable, str(Path(__file__)), "--run", demo]
    done = subprocess.run(run, env=environment(kernel), capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{demo} under {kernel}: {done.stderr.strip()[-2000:]}")
    return list(json.loads(done.stdout.splitlines()[-1]))


def compare(demo: str, kernels: list[str]) -> None:
    """Print for each job of a demo its statuses and the largest difference between kernels."""
    for results in zip(*(fitted(demo, kernel) for kernel in kernels), strict=True):
        statuses = dict.fromkeys(r["status"] for r in results)
        worst, exact, undetermined = 0.0, 0.0, 0
        for unknown in results[0]["found"]:
            values, std = np.array([r["found"][unknown] for r in results]).T
            difference, size = float(np.ptp(values)), max(1e-3, float(np.abs(values).max()))
            if not np.isfinite(std).all():
                undetermined += 1
            elif std.min() < EXACT * size:
                exact = max(exact, difference / size)
            else:
                worst = max(worst, difference / float(std.min()))
        cells = [f"{demo}, {results[0]['job']}", ", ".join(statuses)]
        cells += [f"{worst:.1e}" if worst else "", f"{exact:.1e}" if exact else ""]
        print(f"| {' | '.join([*cells, str(undetermined)])} |", flush=True)


def main() -> None:
    """Print one line a job."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kernels", nargs="+", default=["Haswell", "Prescott", "SkylakeX"])
    parser.add_argument("--demos", nargs="+", default=list(DEMOS))
    parser.add_argument("--run", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        run_demo(given.run)
        return
    kernels = [kernel for kernel in given.kernels if kernels_used(kernel) == [kernel]]
    print(f"kernels: {', '.join(kernels)}")
    print("| job | status | difference in std | of exact data, relative | not determined |")
    print("|---|---|---|---|---|")
    for demo in given.demos:
        compare(demo, kernels)


if __name__ == "__main__":
    main()
