"""Coverage of the intervals of fits with fixed weights, where the noise has other weights.

12-DOF chain (60 lines, 5 sensors, 2 references), `output-error` and `log` started at the truth,
under noise that is proportional, constant, or both. Share of unknowns and draws that the 95 %
interval holds, by the covariance of

- plain: the residual's own spread, equal for all values;
- sandwich: the noise model's variances about the Jacobian, as the result states it;
- lines: squares of the residual summed by lines (clusters), with the usual correction for their
  number;
- jackknife: leaving out one line at a time, from the linearised fit.

    python benchmarks/sandwich.py [--draws 60] [--seed 0]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from cases import chain12

import updyn
from updyn.frf import FRF
from updyn.updating.fit.method import residual_std
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError, OutputError, OutputErrorSet

#: Method, relative noise, and floor as a share of the rms.
NOISE = (
    ("output-error", 0.05, 0.0),
    ("output-error", 0.02, 0.002),
    ("output-error", 0.0, 0.01),
    ("log", 0.05, 0.0),
    ("log", 0.02, 0.001),
    ("log", 0.01, 0.01),
)


def others(problem: FRFPart, x: np.ndarray, log: bool) -> dict[str, np.ndarray]:
    """Standard deviations by the other covariances, in the optimiser's coordinates."""
    blocks = list(problem.blocks(x))
    H, dH = np.concatenate([b.H for b in blocks]), np.concatenate([b.dH for b in blocks], axis=1)
    data, n = problem.frf.values, problem.n
    level = np.broadcast_to(level_by_unit(problem.frf), H.shape)
    if log:
        r, J, residual = np.log(H / data), dH / H, LogError()
    else:
        r, J, residual = (H - data) / level, dH / level, OutputErrorSet((OutputError(1.0 / level),))
    local = residual.local(Problem.of([problem]), x)
    A = local.R.T @ local.R
    g = np.einsum("klab,lab->lk", J.conj(), r).real
    lines = len(g)
    own = [np.einsum("kab,mab->km", J[:, i].conj(), J[:, i]).real for i in range(lines)]
    left = np.array([np.linalg.solve(A - own[i], g[i]) for i in range(lines)])
    few = lines / (lines - 1) * (2 * H.size - 1) / (2 * H.size - n)
    half = np.linalg.solve(A, g.T)
    return {
        "plain": residual_std(local, H.size, n) * np.sqrt(np.diag(np.linalg.solve(A, np.eye(n)))),
        "lines": np.sqrt(few * np.sum(half**2, axis=1)),
        "jackknife": np.sqrt((lines - 1) / lines * np.sum(left**2, axis=0)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    case = chain12()
    clean: FRF = case.clean.select(references=[case.clean.references[0], case.clean.references[-1]])
    names = case.unknowns.names
    truth = np.array([case.truth[name] for name in names])
    unknowns = case.unknowns.with_start(truth)
    rms = np.sqrt(np.mean(np.abs(clean.values) ** 2))
    print(
        f"{'method':<14}{'relative':>9}{'floor':>7}"
        f"{'plain':>8}{'sandwich':>10}{'lines':>7}{'jackknife':>11}"
    )
    for method, relative, floor in NOISE:
        rng, log = np.random.default_rng(args.seed), method == "log"
        std = np.hypot(relative * np.abs(clean.values), floor * rms) / np.sqrt(2.0)
        inside: dict[str, list[np.ndarray]] = {}
        for _ in range(args.draws):
            draw = rng.standard_normal((2, *std.shape))
            data = replace(clean, values=clean.values + std * (draw[0] + 1j * draw[1]))
            options = {"starts": 0} if log else {}
            result = updyn.update(case.start, data, unknowns, method=method, **options)
            problem = FRFPart.build(case.start, data, unknowns)
            found = np.array([result.values[name] for name in names])
            x = problem.coordinates.to_x(np.maximum(found, 1e-12))
            bars = {k: v * problem.coordinates.slope(x) for k, v in others(problem, x, log).items()}
            bars["sandwich"] = np.array([result.std[name] for name in names])
            for kind, bar in bars.items():
                inside.setdefault(kind, []).append(np.abs(found - truth) <= 1.96 * bar)
        shares = {kind: 100.0 * np.mean(hits) for kind, hits in inside.items()}
        print(
            f"{method:<14}{relative:>9g}{floor:>7g}{shares['plain']:>8.1f}{shares['sandwich']:>10.1f}"
            f"{shares['lines']:>7.1f}{shares['jackknife']:>11.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
