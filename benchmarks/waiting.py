"""Processor time of each command, and its share outside linear algebra.

Jobs of 7 to 10,000 DOFs, 3 to 1,000 channels and 10 to 15,000 lines, with 1 % noise and a floor.
For each: `info` of both files, `new`, `check`, `correlate`, `modes`, `run` with its report, `plan`
and `plant`, with the defaults of `new`. Printed: seconds of processor time, with child processes;
with `--shares`, which needs py-spy (``pip install py-spy``), the share of the time outside BLAS,
LAPACK and sparse solvers. An asterisk marks times above the target.

    OMP_NUM_THREADS=1 python benchmarks/waiting.py [JOB ...] [--commands check,run] [--shares]
"""

from __future__ import annotations

import argparse
import compileall
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import models
import numpy as np
import structures

import updyn
from updyn.demos.gear_train import true_model
from updyn.elements.structure.build import structure
from updyn.elements.structure.shells import Shell

#: Longest acceptable processor time in s: targets of this project.
TARGETS = {
    "info model": 2.0,
    "info test": 2.0,
    "new": 2.0,
    "check": 5.0,
    "modes": 5.0,
    "correlate": 5.0,
    "run": 30.0,
}
#: Commands after `new`, in the order in which they run.
COMMANDS = ["info model", "info test", "new", "check", "correlate", "modes", "run", "plan", "plant"]
#: Names in native frames of linear algebra: OpenBLAS, MKL, LAPACK, SuperLU.
LIBRARIES = ("openblas", "mkl", "lapack", "blas", "superlu", "pardiso", "umfpack", "lapack_lite")


@dataclass(frozen=True)
class Job:
    """A model, its true variant and a test."""

    name: str
    true: updyn.Model
    sensors: list[str]
    references: list[str]
    freq: np.ndarray
    quantity: str = "accelerance"

    def measure(self, seed: int = 0) -> updyn.FRF:
        """Return the noisy FRFs of the true model."""
        rng = np.random.default_rng(seed)
        tier = "reduced" if self.true.n_dofs > 500 else None
        clean = updyn.response(
            self.true, self.freq, self.sensors, self.references, self.quantity, tier=tier
        )
        H = clean.values
        floor = 1e-3 * np.sqrt(np.mean(np.abs(H) ** 2))
        noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2.0)
        values = H + noise * np.hypot(0.01 * np.abs(H), floor)
        return updyn.FRF(self.freq, values, clean.responses, clean.references, self.quantity)

    def start(self, seed: int = 1) -> updyn.Model:
        """Return the model before the update: stiffnesses off by 10 %, loss factors by 30 %."""
        rng = np.random.default_rng(seed)
        changes: dict[str, dict[str, float]] = {}
        for name, group in self.true.groups.items():
            changes[name] = {}
            if group.stiffness is not None:
                changes[name]["stiffness"] = float(np.exp(0.1 * rng.standard_normal()))
                changes[name]["loss_factor"] = group.loss_factor * float(
                    np.exp(0.3 * rng.standard_normal())
                )
        return self.true.scaled(changes)


def wing() -> updyn.Model:
    """Return a cantilever box of shells: two skins, two spars and three ribs, 2,856 DOFs."""
    spans, chords = 34, 6
    xyz = np.array(
        [
            [0.1 * i, 0.1 * j, 0.1 * k]
            for k in range(2)
            for i in range(spans + 1)
            for j in range(chords + 1)
        ]
    )
    number = 1 + np.arange(len(xyz)).reshape(2, spans + 1, chords + 1)

    def quads(nodes: np.ndarray) -> np.ndarray:
        ends = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
        return np.stack([end.ravel() for end in ends], axis=1)

    parts = {
        "skin lower inner": quads(number[0, :18]),
        "skin lower outer": quads(number[0, 17:]),
        "skin upper inner": quads(number[1, :18]),
        "skin upper outer": quads(number[1, 17:]),
        "front spar": quads(number[:, :, 0]),
        "rear spar": quads(number[:, :, -1]),
        "ribs": np.concatenate([quads(number[:, i]) for i in range(0, spans + 1, 17)]),
    }
    shells = [
        Shell(name, at, 7e10, 2700.0, 0.002, loss_factor=0.01 + 0.002 * i)
        for i, (name, at) in enumerate(parts.items())
    ]
    return structure(xyz, shells, grounded=[int(n) for n in number[:, 0].ravel()], title="wing")


def _lines(model: updyn.Model, n: int, modes: int) -> np.ndarray:
    found = updyn.modes(model, modes).frequency
    elastic = found[found > 1e-3 * found[-1]]
    return np.linspace(0.3 * elastic[0], 1.05 * elastic[-1], n)


def _job(name: str, true: updyn.Model, n: int, references: int, lines: int, modes: int) -> Job:
    """Return a job with sensors spread over the DOFs of a model."""
    sensors = models.sensors(true, n)
    return Job(name, true, sensors, sensors[:references], _lines(true, lines, modes))


def _of_bench(name: str, bench: structures.Bench) -> Job:
    clean = bench.case.clean
    return Job(
        name,
        bench.case.true,
        [str(dof) for dof in clean.responses],
        [str(dof) for dof in clean.references],
        clean.freq,
        clean.quantity,
    )


def _wing() -> Job:
    model = wing()
    translations = [str(d) for d in model.dofs if str(d).endswith(":Z")]
    spread = np.linspace(len(translations) - 1, 10, 18).astype(int)
    sensors = [translations[i] for i in spread]
    return Job("wing", model, sensors, sensors[:1], _lines(model, 4095, 12))


#: Typical jobs, by name.
JOBS: dict[str, Callable[[], Job]] = {
    "gear train": lambda: _of_bench("gear train", _gear_train()),
    "few lines": lambda: _job("few lines", models.chain(30, 5), 3, 1, 10, 8),
    "building": lambda: _of_bench("building", structures.building()),
    "long record": lambda: _job("long record", models.chain(40, 8), 12, 1, 15000, 12),
    "hammer": lambda: _job("hammer", models.chain(60, 6), 37, 6, 1601, 15),
    "1,000 channels": lambda: _job("1,000 channels", models.chain(100, 10), 100, 10, 2000, 20),
    "200 unknowns": lambda: _job("200 unknowns", models.chain(100, 100), 100, 5, 100, 100),
    "space frame": lambda: _job("space frame", models.footbridge(2, 10), 12, 2, 400, 8),
    "wing": _wing,
    "footbridge": lambda: _job("footbridge", models.footbridge(4, 19), 24, 2, 800, 10),
    "solid": lambda: _job("solid", models.solid((12, 12, 20), parts=10), 12, 1, 200, 10),
}


def _gear_train() -> structures.Bench:
    return structures.train(true_model(), [1, 2, 5, 7], [1])


def write_job(job: Job, folder: Path) -> None:
    """Write the model and the measurement of a job."""
    updyn.write_model(job.start(), folder / "model.h5")
    updyn.write_frf(job.measure(), folder / "test.npz")


def add_tables(job: Job, path: Path) -> None:
    """Add the tables of `plan` and `plant` to a job file."""
    first, last = float(job.freq[0]), float(job.freq[-1])
    path.write_text(
        path.read_text(encoding="utf-8")
        + f"\n[plan]\nn_sensors = {min(6, len(job.sensors))}\nband = [{first:g}, {last:g}]\n"
        + f'\n[plant]\ninputs = ["{job.references[0]}"]\noutputs = ["{job.references[0]}"]\n',
        encoding="utf-8",
    )


def arguments(command: str) -> list[str]:
    """Return the arguments of a command, in the folder of the job."""
    return {
        "info model": ["info", "model.h5"],
        "info test": ["info", "test.npz"],
        "new": ["new", "model.h5", "test.npz"],
        "run": ["run", "job.toml", "--out", "run"],
        "plant": ["plant", "job.toml", "--out", "run"],
    }.get(command, [command, "job.toml"])


@dataclass(frozen=True)
class Wait:
    """Processor time of a command in s, its exit code, and the share outside linear algebra."""

    seconds: float
    code: int
    share: float


def run(folder: Path, command: str, shares: bool) -> Wait:
    """Run a command and return its processor time."""
    words = [sys.executable, "-m", "updyn", *arguments(command)]
    samples = folder / "samples.txt"
    if shares:
        recorded = ["--native", "--format", "raw", "--rate", "50", "--output", str(samples)]
        words = ["py-spy", "record", "--silent", *recorded, "--", *words]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3):
        print(done.stdout[-500:], done.stderr[-1500:], file=sys.stderr)
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Wait(seconds, done.returncode, read_share(samples) if shares else np.nan)


def read_share(samples: Path) -> float:
    """Return the share of samples whose innermost frames are not of a library."""
    outside = total = 0
    for line in samples.read_text(encoding="utf-8").splitlines():
        stack, _, count = line.rpartition(" ")
        total += int(count)
        innermost = ";".join(stack.lower().split(";")[-3:])
        outside += int(count) * (not any(name in innermost for name in LIBRARIES))
    return outside / total if total else np.nan


def waits(job: Job, commands: list[str], shares: bool) -> Iterator[tuple[str, Wait]]:
    """Yield each command of a job with its processor time; `new` always runs."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write_job(job, folder)
        for command in COMMANDS:
            if command in commands or command == "new":
                yield command, run(folder, command, shares)
            if command == "new":
                add_tables(job, folder / "job.toml")


def main() -> None:
    """Print one row for each job."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(JOBS))
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--shares", action="store_true")
    options = parser.parse_args()
    if options.shares and shutil.which("py-spy") is None:
        parser.error("--shares needs py-spy: pip install py-spy")
    # As in an installed package; PYTHONDONTWRITEBYTECODE would add seconds to every command.
    compileall.compile_dir(str(Path(updyn.__file__).parent), quiet=1)
    commands = options.commands.split(",")
    print("| job | DOFs | channels x lines | " + " | ".join(commands) + " |")
    print("|---|---|---|" + "---|" * len(commands))
    for name in options.jobs or JOBS:
        job = JOBS[name]()
        size = f"{len(job.sensors) * len(job.references)} x {len(job.freq)}"
        print(f"| {name} | {job.true.n_dofs} | {size} |", end="", flush=True)
        for command, wait in waits(job, commands, options.shares):
            if command not in commands:
                continue
            text = f"{wait.seconds:.1f}" if wait.code in (0, 3) else f"exit {wait.code}"
            text += " *" if wait.seconds > TARGETS.get(command, np.inf) else ""
            text += f" ({100 * wait.share:.0f} %)" if options.shares else ""
            print(f" {text} |", end="", flush=True)
        print()


if __name__ == "__main__":
    main()
