"""An update of a large solid by the reduced tier, against direct factorisations line by line.

A solid in 20 layers, 30 sensors, 3 references, 200 lines, 1 % noise; 20 unknowns: stiffness and
loss factor of ten layers, which are off by up to 30 % and by half. The FRFs of the truth come from
a reduced model with a basis of its own (its accuracy: `--truth`); the error of the final one is
measured against direct solves at lines that were not used.

    python benchmarks/large.py 50k [--check 20] [--starts 8] [--lumped] [--backend cudss]
        [--busy 2]

Compared: the processor time of complex factorisations with their solves (the median of those of the
check, after the job). Line by line the job would take one for each line and iteration."""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import models
import numpy as np

import updyn
import updyn.updating.assembly as assembly_module
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver
from updyn.updating.fit import reducing
from updyn.updating.fit.monitor import Progress

BANDS = {
    "10k": (100, 2140),
    "50k": (60, 1200),
    "150k": (40, 830),
    "300k": (30, 660),
    "500k": (25, 540),
    "1M": (20, 440),
}
LINES, NOISE = 200, 0.01


def peak() -> float:
    """Largest memory of this process so far, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def changes(model: updyn.Model) -> dict[str, dict[str, float]]:
    rng = np.random.default_rng(0)
    layers = list(model.groups)[::2]
    return {
        g: {
            "stiffness": float(rng.uniform(0.75, 1.3)),
            "loss_factor": 1.5 * model.group(g).loss_factor,
        }
        for g in layers
    }


def measurement(
    model: updyn.Model,
    size: str,
    sensors: list[str],
    accuracy: float,
    seed: int,
    backend: str | None,
) -> updyn.FRF:
    truth, lines = model.scaled(changes(model)), np.linspace(*BANDS[size], LINES)
    exact = updyn.response(
        truth, lines, sensors, sensors[:3], tier="reduced", accuracy=accuracy, backend=backend
    )
    print(f"truth: {exact.source}", flush=True)
    draw = np.random.default_rng(seed).standard_normal((2, *exact.values.shape))
    noisy = exact.values * (1.0 + NOISE * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    return updyn.FRF(exact.freq, noisy, exact.responses, exact.references, "receptance")


def direct(
    model: updyn.Model, sensors: list[str], lines: np.ndarray, backend: str | None
) -> tuple[float, np.ndarray]:
    """Processor time of a factorisation with its solves in s, and the receptances."""
    system = AffineSystem.compile(model)
    at = model.dofs.match(sensors).index
    solver = LineSolver.choose(system, "sparse", backend)
    H, seconds = [], []
    for f in np.r_[lines[:1], lines]:  # the analysis counts in neither
        begun = time.process_time()
        line = np.array([f])
        X = solver.solve(system.coefficients(system.start, 2 * np.pi * line), at, line)
        seconds.append(time.process_time() - begun)
        H.append(solver.at(X[:, :, :3], at)[:, 0])
    return float(np.median(seconds[1:])), np.array(H[1:])


@contextmanager
def busy(n: int) -> Iterator[None]:
    """Keep n cores busy with something else."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n)]
    try:
        yield
    finally:
        for other in others:
            other.kill()


class Kept(reducing.Reducing):
    """Keeps the reduced model with which the job ended, for the check."""

    latest: Kept

    def begin(self) -> None:
        Kept.latest = self
        super().begin()


def reduced(result: updyn.UpdateResult, sensors: list[str], lines: np.ndarray) -> np.ndarray:
    """Receptances of the job's own reduced model at its estimate."""
    (part,) = Kept.latest._parts
    exact, solver, at = part.exact, part.solver, result.model.dofs.match(sensors).index
    state = exact.state(exact.coordinates.to_x(np.array(list(result.values.values()))))
    c = solver.system.coefficients(state, 2 * np.pi * lines)
    return solver.at(solver.solve(c, at[:3], lines), at).transpose(1, 0, 2)


class Log:
    """Prints a line for each iteration."""

    def __init__(self) -> None:
        self.begun = time.perf_counter()
        self.shown = ("", 0)

    def __call__(self, now: Progress) -> None:
        if (now.stage, now.iteration) == self.shown:
            return
        self.shown = now.stage, now.iteration
        print(
            f"  {time.perf_counter() - self.begun:6.0f} s  {now.stage} {now.iteration}"
            f"  cost {now.cost:.6g}  {peak():.2f} GiB",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("size", choices=BANDS)
    parser.add_argument(
        "--check",
        type=int,
        default=20,
        help="direct solves at lines between those of the job; 0: none",
    )
    parser.add_argument("--starts", type=int, default=8, help="tries of the search for a start")
    parser.add_argument(
        "--lumped", action="store_true", help="a diagonal mass, as the largest models need"
    )
    parser.add_argument("--sensors", type=int, default=30)
    parser.add_argument("--backend", help="of the factorisations; else the preferred one")
    parser.add_argument(
        "--truth", type=float, default=1e-6, help="accuracy of the data, whose noise is 1e-2"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    parser.add_argument("--busy", type=int, default=0, help="cores that do something else")
    given = parser.parse_args()
    model = models.solid(models.SOLIDS[given.size], lumped=given.lumped)
    sensors = models.sensors(model, given.sensors)
    print(f"{model.n_dofs} DOFs, model in memory: {peak():.2f} GiB", flush=True)
    frf = measurement(model, given.size, sensors, given.truth, given.seed, given.backend)
    wanted = changes(model)
    unknowns = updyn.parameters(model, stiffness=list(wanted), loss_factor=list(wanted))
    assembly_module.Reducing = Kept
    log, begun = Log(), time.process_time()
    with busy(given.busy):
        result = updyn.update(
            model,
            frf,
            unknowns,
            tier="reduced",
            starts=given.starts,
            callback=log,
            backend=given.backend,
        )
    job, by_the_clock = time.process_time() - begun, time.perf_counter() - log.begun
    print(result.summary())
    print({k: round(v, 1) for k, v in result.timing_s.items()}, result.options)
    off = []
    for group, quantities in wanted.items():
        for quantity, truth in quantities.items():
            name = f"{group}.{quantity}"
            off.append((result.values[name] - truth) / result.std[name])
    print(
        f"job {job:.0f} s of processor time, {by_the_clock:.0f} s by the clock,"
        f" {result.iterations} iterations,"
        f" peak memory {peak():.2f} GiB"
    )
    print(
        f"estimates off by {np.sqrt(np.mean(np.square(off))):.2f} standard deviations (rms), "
        f"{np.abs(off).max():.2f} at most"
    )
    if given.check:
        spacing = frf.freq[1] - frf.freq[0]
        between = np.linspace(*BANDS[given.size], given.check + 2)[1:-1] + 0.37 * spacing
        seconds, H = direct(result.model, sensors, between, given.backend)
        print(
            f"one factorisation with its solves {seconds:.1f} s: the job took the time of"
            f" {job / seconds:.1f} of them"
        )
        difference = np.abs(reduced(result, sensors, between) - H).max(axis=(1, 2))
        share = difference / np.abs(H).max(axis=(1, 2))
        print(f"error at {given.check} lines between those of the job: {share.max():.1e} at most")
        print(f"peak memory with complex factorisations {peak():.2f} GiB")


if __name__ == "__main__":
    main()
