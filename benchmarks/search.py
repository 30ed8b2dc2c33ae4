"""What the search costs where a descent from the start would do: an update by default, and without.

A frame of 2,037 DOFs (the footbridge of `models.py` in twelve pieces) with 12 unknown stiffnesses
off by up to a factor of 1.4, FRFs of two forces at twelve sensors on 80 lines over nine modes, 1 %
noise. By default tries are made until two agree, and other answers are looked for; `starts=0`
descends once, and does not always arrive.

    OMP_NUM_THREADS=1 python benchmarks/search.py [--draws 4] [--tier sparse]
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import models
import numpy as np
from modes import scattered

import updyn
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult

NOISE = 0.01


def measured(true: Model, sensors: list[str], seed: int) -> FRF:
    f = updyn.modes(true, 10).frequency
    lines = np.linspace(0.5 * f[0], 1.05 * f[8], 80)
    clean = updyn.response(true, lines, sensors, sensors[:2])
    draw = np.random.default_rng(seed).standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + NOISE / np.sqrt(2.0) * (draw[0] + 1j * draw[1]))
    return FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


def timed(
    start: Model, frf: FRF, unknowns: ParameterSet, **options: Any
) -> tuple[UpdateResult, float]:
    begun = time.process_time()
    return updyn.update(start, frf, unknowns, **options), time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--tier", help="how the model is solved")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    true = models.footbridge(4, 19, pieces=12)
    at = np.random.default_rng(0).choice(true.n_dofs, 12, replace=False)
    sensors = [str(true.dofs[int(i)]) for i in at]
    print(
        "| draw | default, s | starts = 0, s | ratio | largest difference, in standard deviations |"
    )
    print("|---|---|---|---|---|")
    ratios = []
    for draw in range(args.draws):
        start = scattered(true, 0.35, np.random.default_rng([3, draw]))
        frf = measured(true, sensors, draw)
        unknowns = updyn.parameters(start, stiffness="all")
        found, seconds = timed(start, frf, unknowns, tier=args.tier)
        plain, fewest = timed(start, frf, unknowns, tier=args.tier, starts=0)
        off = max(abs(found.values[n] - plain.values[n]) / plain.std[n] for n in unknowns.names)
        ratios.append(seconds / fewest)
        print(
            f"| {draw} | {seconds:.1f} | {fewest:.1f} | {ratios[-1]:.2f} | {off:.1g} |", flush=True
        )
    print(f"\n{true.n_dofs} DOFs, median ratio {np.median(ratios):.2f}")


if __name__ == "__main__":
    main()
