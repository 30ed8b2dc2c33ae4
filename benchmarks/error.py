"""True error of reduced models, by direct solves, over the error that they state.

Solids with 30 sensors and a footbridge with 55 modes in the band; 3 references, 80 lines, all
channels. The basis is that of the start as it is, or enriched until the accuracy is stated. Ratios
are those of every value: line, response and reference.

    python benchmarks/error.py [--size 2025] [--lines 80]
"""

from __future__ import annotations

import argparse
import time

import models
import numpy as np

import updyn
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.reduction import Reduction
from updyn.linalg.solver import check_backend

SIZES = {"864": (3, 3, 18), "2025": (4, 4, 27), **models.SOLIDS}
#: Modes in the band of the solids, of the footbridge.
MODES, MANY = 8, 55
#: Shares of their stiffness that two parts have left.
SOFT = (0.1, 0.01, 0.001)


def scaled(start: State, factor: np.ndarray) -> State:
    return State(start.factor * factor, start.loss, start.rate)


def states(system: AffineSystem, softened: tuple[float, ...]) -> dict[str, State]:
    """The start, and states that differ from it."""
    start, rng = system.start, np.random.default_rng(0)
    stiff = np.array([t.quantity == "stiffness" for t in system.terms])
    spread = np.where(stiff, 0.7, 0.3)
    moved = np.exp(rng.standard_normal(len(start.factor)))
    out = {"as it starts": start}
    out |= {f"moved by {p} %": scaled(start, moved ** (0.01 * p)) for p in (3, 10)}
    for number in (1, 2):
        off = 1.0 + rng.uniform(-spread, spread)
        out[f"off by up to 70 %, {number}"] = scaled(start, off)
    lossy = start.loss.copy()
    lossy[np.flatnonzero(lossy)[len(np.flatnonzero(lossy)) // 2]] = 0.8
    out["a loss factor of 0.8"] = State(start.factor, lossy, start.rate)
    parts = np.flatnonzero(stiff)
    for size in softened:
        soft = np.ones(len(start.factor))
        soft[parts[[len(parts) // 3, 2 * len(parts) // 3]]] = size
        out[f"two parts at {size:g} of their stiffness"] = scaled(start, soft)
    return out


def study(
    model: updyn.Model, at: list[str], number: int, n_lines: int, softened: tuple[float, ...]
) -> None:
    system = AffineSystem.compile(model)
    rows = model.dofs.match(at).index
    band = updyn.modes(model, number).frequency
    freq = np.linspace(0.3 * band[0], 1.02 * band[-1], n_lines)
    exact = LineSolver.choose(system, "sparse")
    print(
        f"{'state':<36}{'basis':>16}{'stated':>9}{'true':>9}{'channel':>9}{'true':>9}"
        f"{'true/stated, median':>21}{'largest':>9}{'s':>7}"
    )
    for name, state in states(system, softened).items():
        c = system.coefficients(state, 2 * np.pi * freq)
        H = exact.at(exact.solve(c, rows[:3], freq), rows).transpose(1, 0, 2)
        level, rms = np.abs(H).max(axis=(1, 2)), np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
        ends = float(freq[0]), float(freq[-1])
        for enrich, accuracy in ((False, 1e-5), (True, 1e-5), (True, 1e-10)):
            reduction = Reduction(system, rows, rows[:3], ends, check_backend(None), accuracy)
            reduction.build(state if enrich else system.start)
            begun = time.process_time()
            found = reduction.certify(state, freq, enrich=enrich, count=12)
            seconds = time.process_time() - begun
            off = np.abs(reduction._receptance(state, freq) - H)
            ratio = off / found.errors
            label = f"{found.size}, {accuracy:g}" if enrich else f"{found.size}, of start"
            print(
                f"{name:<36}{label:>16}{found.error:>9.1e}"
                f"{(off / level[:, None, None]).max():>9.1e}{found.channel:>9.1e}"
                f"{min((off / rms).max(), 1.0):>9.1e}{np.median(ratio):>21.1e}{ratio.max():>9.2f}"
                f"{seconds:>7.1f}",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="2025", choices=SIZES)
    parser.add_argument("--lines", type=int, default=80)
    args = parser.parse_args()
    solid = models.solid(SIZES[args.size], parts=6 if args.size in ("864", "2025") else 20)
    print(f"solid of {solid.n_dofs} DOFs")
    study(solid, models.sensors(solid), MODES, args.lines, SOFT)
    bridge = models.footbridge(4, 19)
    print(f"footbridge of {bridge.n_dofs} DOFs")
    study(bridge, models.sensors(bridge), MANY, args.lines, SOFT[:1])


if __name__ == "__main__":
    main()
