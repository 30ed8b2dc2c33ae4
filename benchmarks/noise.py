"""Error of maximum likelihood over the Cramer-Rao bound, and coverage of its intervals.

Gear train (60 lines, 4 sensors, 1 reference) and 12-DOF chain (60 lines, 5 x 5), proportional noise
of 1 % and 5 %, each draw fitted from the perturbed start. For every unknown: RMS error over the
Cramer-Rao bound, and share of draws whose 95 % interval covers the truth. The bound is that of
complex Gaussian noise of known variance at the truth.

    python benchmarks/noise.py [--draws 200] [--seed 0] [--stated] [--oracle]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from cases import Case, chain12, gear_train

import updyn
from updyn.demos.gear_train import starting_model
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError


def cramer_rao(case: Case, relative: float) -> np.ndarray:
    """Standard deviations of the unknowns' values at the truth."""
    problem = FRFPart.build(case.start, case.clean, case.unknowns)
    x = problem.coordinates.to_x(np.array([case.truth[p.name] for p in case.unknowns]))
    weight = np.sqrt(2.0) / (relative * np.abs(case.clean.values))
    R = OutputError(weight).local(Problem.of([problem]), x).R
    half = np.linalg.solve(R.T, np.eye(len(x)))
    return np.linalg.norm(half, axis=0) * problem.coordinates.slope(x)


def study(
    case: Case, relative: float, draws: int, seed: int, stated: bool, oracle: bool = False
) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    names = case.unknowns.names
    truth = np.array([case.truth[n] for n in names])
    errors, inside, failed, used = [], [], 0, 0
    for _ in range(draws):
        noise = {"relative": relative} if stated else None
        unknowns = case.unknowns.with_start(truth) if oracle else case.unknowns
        options = {"starts": 0} if oracle else {}
        result = updyn.update(
            case.start, case.noisy(relative, rng), unknowns, noise=noise, **options
        )
        error = np.array([result.values[n] for n in names]) - truth
        std = np.array([result.std[n] for n in names])
        errors.append(error)
        inside.append(np.abs(error) <= 1.96 * std)
        failed += result.status != "converged"
        used += len(result.history)
    bound = cramer_rao(case, relative)
    return {
        "bound": bound / np.where(case.unknowns.is_factor, truth, 1.0),
        "ratio": np.sqrt(np.mean(np.square(errors), axis=0)) / bound,
        "bias": np.mean(errors, axis=0) / bound,
        "coverage": np.mean(inside, axis=0),
        "not converged": np.array([failed]),
        "steps": np.array([used / draws]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--stated", action="store_true", help="state the noise instead of estimating it"
    )
    parser.add_argument(
        "--oracle", action="store_true", help="start at the truth, without a search"
    )
    args = parser.parse_args()
    for case in (gear_train(start=starting_model()), chain12()):
        for relative in (0.01, 0.05):
            begun = time.perf_counter()
            out = study(case, relative, args.draws, args.seed, args.stated, args.oracle)
            print(
                f"\n{case.name}, {100 * relative:g} % noise, {args.draws} draws:"
                f" {out['not converged'][0]} not converged, {out['steps'][0]:.0f} steps and"
                f" {(time.perf_counter() - begun) / args.draws:.2f} s a draw"
            )
            print(f"{'unknown':<24}{'bound':>10}{'RMS/bound':>11}{'bias/bound':>12}{'covered':>10}")
            for i, name in enumerate(case.unknowns.names):
                print(
                    f"{name:<24}{100 * out['bound'][i]:>9.3g}%{out['ratio'][i]:>11.2f}"
                    f"{out['bias'][i]:>12.2f}{100 * out['coverage'][i]:>9.1f}%"
                )
            print(
                f"all: coverage {100 * out['coverage'].mean():.1f} %, largest RMS/bound"
                f" {out['ratio'].max():.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
