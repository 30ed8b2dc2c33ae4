"""Errors and bands of measured shapes expanded to points without a sensor.

    OMP_NUM_THREADS=1 python benchmarks/expansion.py

Beams without supports are measured at ten of 21 nodes with noise of 2 %: an exact model, a mass of
5 % that the model lacks at a random node, and a crack (an element of 30 % stiffness). Three
stiffnesses are updated to six modes. The table has the rms error at the other nodes relative to the
rms of the shape, and the share of true values in bands of 95 %. Then the measured beam of
``updyn demo beam``: the leave-one-out errors of its modes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import updyn
from updyn.demos.beam import write_inputs
from updyn.elements.beam import Segment, beam
from updyn.job import load_job, run_job
from updyn.model import Model

NODES = [f"{node}:Z" for node in range(1, 22)]
SENSORS = [f"{node}:Z" for node in (1, 3, 5, 8, 10, 13, 15, 17, 19, 21)]
ELSEWHERE = [k for k, label in enumerate(NODES) if label not in SENSORS]
N_BEAMS, N_MODES, NOISE = 24, 6, 0.02


def make_beam(*ends: float) -> Model:
    """Return a beam without supports, its segments of lengths up to `ends` named a, b, c."""
    starts = (0.0, *ends[:-1])
    segments = [Segment(name, *both) for name, *both in zip("abc", starts, ends, strict=True)]
    return beam(
        length=1.0, E=7e10, rho=2700.0, width=0.03, height=0.01, n_elements=20, segments=segments
    )


def make_true(kind: str, rng: np.random.Generator) -> Model:
    """Return the true structure."""
    if kind == "crack":
        start = 0.05 * int(rng.integers(1, 19))
        return make_beam(start, start + 0.05, 1.0).scaled({"b": {"stiffness": 0.3}})
    factors = {name: {"stiffness": float(np.exp(0.15 * rng.normal()))} for name in "abc"}
    true = make_beam(0.3, 0.6, 1.0).scaled(factors)
    if kind == "exact":
        return true
    mass = np.zeros((true.n_dofs, true.n_dofs))
    node = 2 * int(rng.integers(0, 21))
    mass[node, node] = 0.04
    return Model.from_groups(dict(true.groups) | {"mass": updyn.Group(mass=mass)}, true.dofs)


def study_beam(kind: str, seed: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return relative squared errors and whether bands cover the truth, by method."""
    rng = np.random.default_rng(seed)
    exact = updyn.modes(make_true(kind, rng), N_MODES + 2).select(np.arange(2, N_MODES + 2))
    shapes = exact.at(SENSORS)
    std = NOISE * np.sqrt(np.mean(shapes**2, axis=0)) * np.ones(shapes.shape)
    measured = updyn.ModeSet(
        exact.frequency * (1.0 + 1e-3 * rng.normal(size=N_MODES)),
        shapes + std * rng.normal(size=shapes.shape),
        SENSORS,
        std_frequency=1e-3 * exact.frequency,
        std_shapes=std,
    )
    model, true = make_beam(0.3, 0.6, 1.0), exact.at(NODES)
    unknowns = updyn.parameters(model, stiffness="all")
    result = updyn.update(model, measured, unknowns, method="modal")
    figures = {}
    for method in ("local", "serep"):
        modes = updyn.expand_modes(result, method=method, dofs=NODES).modes
        found = modes.shapes.real
        scale = np.sum(true * found, axis=0) / np.sum(found**2, axis=0)
        error = (scale * found - true)[ELSEWHERE]
        inside = np.abs(error) < 1.96 * np.abs(scale) * modes.std_shapes[ELSEWHERE]
        figures[method] = np.mean(error**2, axis=0) / np.mean(true**2, axis=0), inside
    return figures


def print_measured_beam() -> None:
    """Print the leave-one-out errors of the measured beam."""
    with tempfile.TemporaryDirectory() as name:
        job = write_inputs(Path(name))
        with job.open("a", encoding="utf-8") as file:
            file.write("\n[output]\nreport = false\n")
        result = run_job(load_job(job), Path(name) / "out").result
    for method in ("local", "serep"):
        errors = 100.0 * updyn.expand_modes(result, method=method).error
        print(f"{method:<6} {', '.join(f'{error:.1f}' for error in errors)} %")


def main() -> None:
    """Print the table and the errors of the measured beam."""
    print("| structure | method | rms error | within 95 % bands |\n|---|---|---|---|")
    for kind in ("exact", "mass", "crack"):
        found = [study_beam(kind, seed) for seed in range(N_BEAMS)]
        for method in ("local", "serep"):
            square = np.mean([one[method][0] for one in found])
            inside = np.mean([one[method][1] for one in found])
            print(f"| {kind} | {method} | {100 * square**0.5:.1f} % | {100 * inside:.0f} % |")
    print("\nMeasured beam, leave-one-out error of each mode:", flush=True)
    print_measured_beam()


if __name__ == "__main__":
    main()
