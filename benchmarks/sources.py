"""Error over the Cramer-Rao bound, and coverage of the intervals, by source of the noise.

12-DOF chain, 60 lines, 5 sensors, 2 references, 12 unknowns, started without a search. The bound is
that of the noise as it was drawn (outlier lines: of the other lines). Blamed are fits whose
residual is called an error of the model, which is true.

- coherence: n periodic records with noise at the output, 2 % of the rms after averaging; H1 and
  coherence from them; "at the true |H|": with |H|^2 (1 - gamma^2) / (gamma^2 n) as the variance,
  which is not what updyn does;
- repeats: three measurements with 2 % of |H| and 0.5 % of the rms, averaged;
- outliers: 2 % of |H|, thirty times as much on 3 of the 60 lines or on none, with and without
  ``robust``;
- sensor: 1 % of |H|, ten times as much at one of the five sensors or at none, by default, estimated
  together and by channel.

    python benchmarks/sources.py [--draws 40] [--seed 0] [--cases outlier]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from cases import Case, chain12

import updyn
from updyn.frf import FRF
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError

Draw = Callable[[np.random.Generator], FRF]
ROBUST = {"robust": "student-t"}
TOGETHER, BY_CHANNEL = "estimated", "estimated-by-channel"


def circular(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)


def bound_of(case: Case, clean: FRF, truth: np.ndarray, variance: np.ndarray) -> np.ndarray:
    problem = FRFPart.build(case.start, clean, case.unknowns)
    x = problem.coordinates.to_x(truth)
    R = OutputError(np.sqrt(2.0 / variance)).local(Problem.of([problem]), x).R
    std = np.linalg.norm(np.linalg.solve(R.T, np.eye(len(x))), axis=0)
    return std * problem.coordinates.slope(x)


def averaged(clean: FRF, n: int, variance: np.ndarray) -> Draw:
    def draw(rng: np.random.Generator) -> FRF:
        H = clean.values
        F = np.exp(2j * np.pi * rng.uniform(size=(n, len(H), 1, H.shape[2])))
        Y = H * F + np.sqrt(n * variance) * circular(rng, (n, *H.shape))
        xx, xy, yy = (abs(F) ** 2).sum(0), (Y * F.conj()).sum(0), (abs(Y) ** 2).sum(0)
        return replace(
            clean, values=xy / xx, coherence=np.minimum(abs(xy) ** 2 / (xx * yy), 1.0), averages=n
        )

    return draw


def at_true_size(clean: FRF, n: int, variance: np.ndarray) -> Draw:
    measured = averaged(clean, n, variance)

    def draw(rng: np.random.Generator) -> FRF:
        data = measured(rng)
        power = np.abs(clean.values) ** 2
        stated = power * (1.0 / data.coherence - 1.0) / n
        return replace(data, variance=np.maximum(stated, 1e-8 * power))

    return draw


def plain(clean: FRF, variance: np.ndarray) -> Draw:
    std = np.sqrt(variance)
    return lambda rng: replace(clean, values=clean.values + std * circular(rng, std.shape))


def with_outliers(clean: FRF, variance: np.ndarray, lines: int) -> Draw:
    def draw(rng: np.random.Generator) -> FRF:
        noise = np.sqrt(variance) * circular(rng, variance.shape)
        noise[rng.choice(len(noise), lines, replace=False)] *= 30.0
        return replace(clean, values=clean.values + noise)

    return draw


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", default="", help="those whose name has this text")
    args = parser.parse_args()
    case = chain12()
    clean = case.clean.select(references=[case.clean.references[0], case.clean.references[-1]])
    names = case.unknowns.names
    truth = np.array([case.truth[name] for name in names])
    size = np.abs(clean.values)
    rms = np.sqrt(np.mean(size**2))

    floor, relative = np.full(size.shape, (0.02 * rms) ** 2), (0.02 * size) ** 2
    two = (0.02 * size) ** 2 + (0.005 * rms) ** 2
    bad = np.array([1.0, 10.0, 1.0, 1.0, 1.0])[:, None]
    one = (0.01 * size * bad) ** 2
    equal = (0.01 * size) ** 2

    studies: list[tuple[str, Any, np.ndarray, Draw]] = [
        (f"coherence, {n} averages", None, floor, averaged(clean, n, floor))
        for n in (3, 10, 30, 100)
    ]
    studies += [
        (f"{n} averages, at the true |H|", None, floor, at_true_size(clean, n, floor))
        for n in (3, 10, 30, 100)
    ]
    of_three = plain(clean, two)

    def repeats(rng: np.random.Generator) -> FRF:
        return updyn.average([of_three(rng) for _ in range(3)])

    studies.append(("three repeats", None, two / 3, repeats))
    for lines in (0, 3):
        for noise, how in ((None, "estimated"), (ROBUST, "robust")):
            name = f"{lines} outlier lines, {how}"
            variance = relative * 60 / (60 - lines)
            studies.append((name, noise, variance, with_outliers(clean, relative, lines)))
    for variance, which in ((equal, "sensors alike"), (one, "one bad sensor")):
        for noise, how in ((None, "default"), (TOGETHER, "estimated"), (BY_CHANNEL, "by channel")):
            studies.append((f"{which}, {how}", noise, variance, plain(clean, variance)))

    print(
        f"{'case':<32}{'RMS/bound':>10}{'largest':>9}{'covered':>9}"
        f"{'std/bound':>11}{'chi-square':>12}{'blamed':>8}"
    )
    for name, noise, variance, draw in studies:
        if args.cases not in name:
            continue
        rng, bound = np.random.default_rng(args.seed), bound_of(case, clean, truth, variance)
        off, bars, chi, blamed = [], [], [], 0
        for _ in range(args.draws):
            result = updyn.update(case.start, draw(rng), case.unknowns, noise=noise, starts=0)
            off.append((np.array([result.values[n] for n in names]) - truth) / bound)
            bars.append(np.array([result.std[n] for n in names]) / bound)
            chi.append(result.noise["chi_square"])
            blamed += result.adequacy.outcome == "structure"
        each = np.sqrt(np.mean(np.square(off), axis=0))
        covered = 100.0 * np.mean(np.abs(off) <= 1.96 * np.array(bars))
        print(
            f"{name:<32}{each.mean():>10.2f}{each.max():>9.2f}{covered:>8.1f}%"
            f"{np.median(bars):>11.2f}{np.mean(chi):>12.3f}{blamed:>8}",
            flush=True,
        )


if __name__ == "__main__":
    main()
