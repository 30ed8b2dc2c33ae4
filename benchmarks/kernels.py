"""Do the demos' results agree between the kernels of OpenBLAS, within what their standard deviations allow?

Each job of each demo is fitted under each kernel in processes of their own: the fit alone, without
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
from pathlib import Path

import numpy as np
import tomlkit

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
from kernels import environment, kernels_used

DEMOS = ("beam", "gear-train", "antenna", "chain")
#: Tables of a job that change nothing of its fit, and the file that it writes in place of them.
BESIDE = ("plant", "servo", "uncertainty", "output")
#: Standard deviations below this share of a value are those of exact data: rounding, not noise.
EXACT = 1e-6


def write_inputs(demo: str, folder: Path) -> list[Path]:
    """Write a demo's inputs and return its jobs, without what comes after the fit."""
    from updyn.demos import antenna, beam, chain, gear_train

    modules = {"beam": beam, "gear-train": gear_train, "antenna": antenna, "chain": chain}
    modules[demo].write_inputs(folder)
    jobs = []
    for path in sorted(folder.glob("*.toml")):
        job = tomlkit.parse(path.read_text(encoding="utf-8"))
        if "model" not in job or path.stem.startswith("compare"):
            continue
        for table in BESIDE:
            job.pop(table, None)
        job["output"] = {"report": False}
        path.write_text(tomlkit.dumps(job), encoding="utf-8")
        jobs.append(path)
    return jobs


def fit(job: Path) -> None:
    """Fit a job and print what it found; what the data do not determine without digits."""
    import warnings

    from updyn.job import load_job, run_job

    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        result = run_job(load_job(job), Path(folder) / "out")
        result = result if hasattr(result, "values") else result.tests[0]
    found = {n: [result.values[n], result.std[n]] for n in result.values}
    print(json.dumps({"status": result.status, "found": found}))


def fitted(job: Path, kernel: str) -> dict[str, object]:
    """Return what a process of a kernel found."""
    run = [sys.executable, str(Path(__file__)), "--fit", str(job)]
    done = subprocess.run(run, env=environment(kernel), capture_output=True, text=True, check=False)
    if done.returncode:
        return {"status": f"error: {done.stderr.strip().splitlines()[-1]}", "found": {}}
    return json.loads(done.stdout.splitlines()[-1])


def compare(demo: str, job: Path, kernels: list[str]) -> None:
    """Print the statuses of a job and its largest difference between kernels."""
    results = [fitted(job, kernel) for kernel in kernels]
    statuses = list(dict.fromkeys(str(r["status"]) for r in results))
    worst, name, exact, unsettled = 0.0, "", 0.0, []
    for unknown in results[0]["found"]:
        values, std = np.array([r["found"].get(unknown, [np.nan, np.inf]) for r in results]).T
        if not np.isfinite(std).all():
            unsettled.append(unknown)
            continue
        difference, size = float(np.ptp(values)), max(1e-3, float(np.abs(values).max()))
        if std.min() < EXACT * size:
            exact = max(exact, difference / size)
        elif difference / std.min() >= worst:
            worst, name = difference / float(std.min()), unknown
    share = f"{worst:.1e} ({name})" if name else "-"
    rounding = f"{exact:.1e}" if exact else "-"
    print(
        f"| {demo}, {job.stem} | {', '.join(statuses)} | {share} | {rounding} | {len(unsettled)} |",
        flush=True,
    )


def main() -> None:
    """Print one line a job."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kernels", nargs="+", default=["Haswell", "Prescott", "SkylakeX"])
    parser.add_argument("--demos", nargs="+", default=list(DEMOS))
    parser.add_argument("--fit", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.fit:
        fit(given.fit)
        return
    kernels = [kernel for kernel in given.kernels if kernels_used(kernel) == [kernel]]
    print(f"kernels: {', '.join(kernels)}")
    print("| job | status | difference, std | exact data: relative | not determined |")
    print("|---|---|---|---|---|")
    for demo in given.demos:
        with tempfile.TemporaryDirectory() as folder:
            for job in write_inputs(demo, Path(folder)):
                compare(demo, job, kernels)


if __name__ == "__main__":
    main()
