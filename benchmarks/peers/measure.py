"""A case, timing, the comparison of two answers, and the table: for all peers."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from models import full, sensors, solid

import updyn
from updyn import sensitivity
from updyn.errors import OptionError
from updyn.linalg.solver import BACKENDS, check_backend
from updyn.updating.problem.problem import FRFPart, Problem

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Row:
    """One timing.

    Attributes
    ----------
    who : str
        Who computed what.
    seconds : float
        Wall clock.
    against : float
        Seconds that it is compared with; ratio = seconds / against.
    differs : float
        Largest difference from updyn's answer, relative to the largest value; NaN: this is updyn's.
    note : str
        What else there is to say.
    """

    who: str
    seconds: float
    against: float
    differs: float = np.nan
    note: str = ""


def show(title: str, rows: Sequence[Row]) -> None:
    print(f"\n{title}")
    print(f"{'':<46}{'seconds':>10}{'ratio':>9}{'differs':>10}")
    for row in rows:
        differs = "" if np.isnan(row.differs) else f"{row.differs:.0e}"
        print(
            f"  {row.who:<44}{row.seconds:>10.4f}{row.seconds / row.against:>9.2f}{differs:>10} "
            f" {row.note}"
        )


def machine() -> str:
    """Processor, cores, threads and versions in one line each."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    processor = named[0] if named else platform.processor()
    threads = ", ".join(f"{name}={os.environ[name]}" for name in THREADS if name in os.environ)
    names = ("updyn", "numpy", "scipy", "mkl", "sdynpy", "opentorsion")
    packages = ", ".join(f"{name} {v}" for name in names if (v := _version(name)))
    return (
        f"{processor}, {os.cpu_count()} cores; {threads or 'as many threads as cores'}\n"
        f"Python {platform.python_version()}, {packages}"
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def best(run: Callable[[], object], times: int = 3, enough: float = 5.0) -> float:
    """Shortest of several runs; runs that take long are not repeated beyond `enough` seconds."""
    taken: list[float] = []
    while len(taken) < times and sum(taken) < enough:
        begun = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def once(run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of one run, and what it returned."""
    begun = time.perf_counter()
    answer = run()
    return time.perf_counter() - begun, answer


class AnotherAnswer(Exception):  # noqa: N818
    """A peer gave another answer: its time is not compared."""


def same(theirs: Any, ours: Any, tolerance: float, what: str) -> float:
    """Return the largest difference over the largest value; beyond a tolerance it is an error."""
    differs = float(np.abs(theirs - ours).max() / np.abs(ours).max())
    if not differs <= tolerance:
        raise AnotherAnswer(
            f"{what}: differs from updyn by {differs:.1e}, more than {tolerance:.0e}: not compared"
        )
    return differs


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A model, measured at some DOFs and lines, with unknowns.

    Attributes
    ----------
    model : Model
        Start of the update.
    data : FRF
        "Measured": the model's receptance with 5 % of noise, so that residuals are not zero.
    unknowns : ParameterSet
        What to find.
    """

    model: updyn.Model
    data: updyn.FRF
    unknowns: Any

    @classmethod
    def build(
        cls,
        model: updyn.Model,
        lines: np.ndarray,
        n_unknowns: int | None = None,
        *,
        only_time: bool = False,
    ) -> Case:
        """30 sensors, three forces; mass, stiffness and damping of the first groups are unknown.

        For timing only, the data are noise.
        """
        at = sensors(model)
        noise = np.random.default_rng(0).normal(size=(2, len(lines), len(at), 3))
        noise = noise[0] + 1j * noise[1]
        if only_time:
            data = updyn.FRF(lines, 1e-9 * noise, at, at[:3], "receptance")
        else:
            clean = updyn.response(model, lines, at, at[:3])
            data = replace(clean, values=clean.values * (1.0 + 0.05 * noise))
        has_viscous = any(g.viscous is not None for g in model.groups.values())
        damping = "viscous" if has_viscous else "loss_factor"
        # 10 are mass, stiffness and damping of three groups, and the mass of a fourth.
        whole, rest = divmod(n_unknowns or 3 * len(model.groups), 3)
        names = list(model.groups)
        kinds = {}
        for i, quantity in enumerate(("mass", "stiffness", damping)):
            kinds[quantity] = names[: whole + (i < rest)]
        return cls(model, data, updyn.parameters(model, **kinds))

    def problem(self, tier: str | None = None, backend: str | None = None) -> FRFPart:
        return FRFPart.build(self.model, self.data, self.unknowns, tier=tier, backend=backend)

    def receptance(self, problem: FRFPart) -> tuple[np.ndarray, np.ndarray]:
        """H (n_f, n_i, n_j) and its derivatives (n, n_f, n_i, n_j) at the start."""
        return sensitivity.receptance(*self._at(problem), problem.rows, problem.columns)

    def condensed(self, problem: FRFPart) -> tuple[np.ndarray, np.ndarray]:
        """Z_red H_X (n_f, n_i, n_j) and its derivatives (n, n_f, n_i, n_j) at the start."""
        return sensitivity.condensed_product(
            *self._at(problem), retained=problem.rows, motion=self.data.values
        )

    def _at(self, problem: FRFPart) -> tuple[Any, ...]:
        return problem.solver, problem.unknowns, self.unknowns.start, self.data.freq


def steps(residual: Any, problem: FRFPart) -> Callable[[], Any]:
    """Return a function that computes a residual and its Jacobian, each time at other values."""
    start, n = problem.coordinates.to_x(problem.coordinates.parameters.start), count()
    return lambda: residual.local(Problem.of([problem]), start + 1e-3 * next(n))


def backends() -> list[str]:
    """Sparse backends that are installed, best first."""
    out = []
    for name in BACKENDS:
        try:
            out.append(check_backend(name))
        except OptionError:
            continue
    return out


def dense_models(n_dofs: int) -> Iterator[tuple[str, updyn.Model]]:
    """Models for peers with dense matrices: one with zeros that they do not use, one without."""
    layers = n_dofs // 48
    yield "solid, matrices of finite elements", solid((3, 3, layers), min(layers, 20))
    yield "full matrices, as of superelements", full(n_dofs)
