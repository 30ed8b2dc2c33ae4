"""Predicted effects of modifications against those on the true structure.

Five structures are updated to FRFs with 2 % noise and a floor of 0.1 %, from a start that is off by
up to a fifth of the usual spread. Each update gets a random modification: a mass, a spring to the
ground, a dashpot, or a stiffer group. The table has the share of true changes in 95 % intervals, of
frequencies (lowest modes) and of FRF levels (5 lines of all channels), by update, as the values of
one update are correlated: the standard error of a share is that of a mean over updates. The last
column is the median of the standard deviation of a change of frequency over that of the frequency.
Updates with several answers have rows by themselves: by the first answer, and by any of them.

With `--margins`: changes of the margins of a servo on a drive of two inertias, 40 draws each, for a
modification of the drive. Plants of viscous damping are exact, those of loss factors within 1 %.

    python benchmarks/modification.py [N] [--structures NAME ...] [--margins viscous]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment
from structures import Noise, bench

import updyn
from updyn.model import Model
from updyn.uncertainty.restored import AT_MINIMUM

NAMES = ("chain", "building", "gear train", "portal", "appendages")
NOISE = Noise(0.02, 1e-3)
N_MODES = 4


def draw_change(model: Model, rng: np.random.Generator) -> Callable[[Model], Model]:
    """Return a random modification of a size that matters."""
    kind = rng.choice(["mass", "spring", "dashpot", "group"])
    if kind == "group":
        names = [name for name, group in model.groups.items() if group.stiffness is not None]
        name, factor = str(rng.choice(names)), float(np.exp(rng.uniform(-0.4, 0.4)))
        return lambda m: m.scaled({name: {"stiffness": factor}})
    at = int(rng.integers(model.n_dofs))
    label = str(model.dofs[at])
    stiffness, mass = model.stiffness.diagonal()[at], model.mass.diagonal()[at]
    share = float(rng.uniform(0.05, 0.4))
    if kind == "mass":
        return lambda m: m.with_element("added", [label], mass=share * mass + 1e-9 * stiffness)
    if kind == "spring":
        return lambda m: m.with_element("added", [label], stiffness=share * stiffness)
    rate = share * float(np.sqrt(stiffness * mass)) + 1e-9 * stiffness
    return lambda m: m.with_element("added", [label], viscous=rate)


@dataclass
class Coverage:
    """Whether true changes lie in their intervals, by update; and ratios of deviations."""

    modes: list[np.ndarray] = field(default_factory=list)
    levels: list[np.ndarray] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)

    def add(self, answers: Sequence[Answer]) -> None:
        """Add an update: a change counts if the interval by one of the answers has it."""
        modes, levels = ([getattr(a, name) for a in answers] for name in ("modes", "levels"))
        self.modes.append(np.fmax.reduce(modes))
        self.levels.append(np.fmax.reduce(levels))
        self.ratios += answers[0].ratios

    def row(self, name: str) -> str:
        cells = " ".join(f"{describe_share(hits):>16}" for hits in (self.modes, self.levels))
        known = [ratio for ratio in self.ratios if np.isfinite(ratio)]
        ratio = f"{np.median(known):.2f}" if known else "-"
        return f"{name:<24}{len(self.modes):>8} {cells}{ratio:>8}"


@dataclass(frozen=True)
class Answer:
    """Hits by one answer, 1 or 0; nan if a change is not determined or without effect."""

    modes: np.ndarray
    levels: np.ndarray
    ratios: list[float]


def describe_share(hits: Sequence[np.ndarray]) -> str:
    """Return a share with its standard error over updates, in %."""
    known = [h[np.isfinite(h)] for h in hits]
    known = [h for h in known if h.size]
    if not known:
        return "-"
    share = np.concatenate(known).mean()
    apart = np.array([np.sum(h - share) for h in known])
    error = np.sqrt(np.sum(apart**2)) / sum(h.size for h in known)
    return f"{100.0 * share:.1f} +- {100.0 * error:.1f} %"


def study(name: str, n: int) -> tuple[Coverage, Coverage, Coverage]:
    """Return coverage by updates with one answer; with several by the first, and by any."""
    case = bench(name)
    true, clean = case.case.true, case.case.clean
    single, first, several = Coverage(), Coverage(), Coverage()
    lines = np.linspace(clean.freq[0], clean.freq[-1], 5)
    ends = list(clean.responses), list(clean.references)
    for seed in range(n):
        rng = np.random.default_rng([seed, len(name)])
        start = case.start(rng, 0.2)
        frf = NOISE.added(clean, rng)
        noise = {"relative": NOISE.relative, "floor": NOISE.floor}
        result = updyn.update(start, frf, case.sought(start), noise=noise)
        if result.status not in AT_MINIMUM:
            print(f"{name}, {seed}: {result.status}; not used", flush=True)
            continue
        change = draw_change(true, rng)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", updyn.UpdynWarning)  # that there are several answers
            found = updyn.modify(result, change, N_MODES)
        moved = _true_changes(true, change(true))
        with np.errstate(divide="ignore", invalid="ignore"):
            change_db = _level(change(true), lines, ends) - _level(true, lines, ends)
        answers = [
            _compare(one, moved, one.frf(lines, *ends), change_db) for one in (found, *found.others)
        ]
        if result.alternatives:
            first.add(answers[:1])
            several.add(answers)
        else:
            single.add(answers)
    return single, first, several


def _compare(
    found: updyn.Modification, moved: np.ndarray, frf: updyn.FRFChange, change_db: np.ndarray
) -> Answer:
    """Return which true changes lie in the intervals of one answer."""
    modes, ratios = np.full(len(found.modes), np.nan), []
    for k, (one, other) in enumerate(zip(found.modes, moved, strict=True)):
        low, high = one.interval()
        if np.isfinite(low) and one.std_change > 1e-9 * one.before:
            modes[k] = low < other < high
            ratios.append(one.std_change / one.std_before)
    low, high = frf.interval()
    with np.errstate(invalid="ignore"):
        is_known = np.isfinite(high - low) & (high - low > 1e-6)
        inside = np.where(is_known, (low < change_db) & (change_db < high), np.nan)
    return Answer(modes, inside.ravel(), ratios)


def study_margins(n: int, damped: str) -> dict[str, list[np.ndarray]]:
    """Return whether true changes of margins lie in their intervals, by figure and update."""
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = {"viscous": 4.0 * spring} if damped == "viscous" else {"loss_factor": 0.03}
    true = Model.from_groups(
        {
            "motor": updyn.Group(mass=np.diag([0.5, 0.0])),
            "load": updyn.Group(mass=np.diag([0.0, 2.0])),
            "shaft": updyn.Group(1e4 * spring, **damping),
        },
        ["1:RZ", "2:RZ"],
    )
    controller = updyn.Controller(kp=25.0, ti=0.2, kv=5.0, low_pass=60.0, dead_time=2e-3)
    ports = (["1:RZ"], ["1:RZ"], (1.0, 60.0), 0.01)
    ends = {"torque": "1:RZ", "velocity": "1:RZ", "position": "1:RZ"}
    clean = updyn.response(true, np.linspace(5.0, 50.0, 60), ["1:RZ", "2:RZ"], ["1:RZ"])
    hits: dict[str, list[np.ndarray]] = {}
    for seed in range(n):
        rng = np.random.default_rng([seed, 99])
        shaft, motor, load = rng.uniform(0.8, 1.2, 3)
        start = true.scaled(
            {"shaft": {"stiffness": shaft}, "motor": {"mass": motor}, "load": {"mass": load}}
        )
        sought = updyn.parameters(start, stiffness="all", mass="all", **{damped: "all"})
        noise = {"relative": NOISE.relative, "floor": NOISE.floor}
        result = updyn.update(start, NOISE.added(clean, rng), sought, noise=noise)
        change = draw_change(true, rng)
        modified = updyn.modify(result, change, 1)
        found = updyn.modify_servo(modified, controller, *ports, **ends, n=40, seed=seed)
        both = [
            updyn.servo(updyn.plant(model, *ports), controller, **ends, step=None)
            for model in (true, change(true))
        ]
        for figure in ("crossover", "phase_margin", "gain_margin", "modulus_margin"):
            inside = []
            for loop in ("velocity", "position", "torque"):
                low, high = found.margin(figure, loop).interval()
                name = "gain_margin_db" if figure == "gain_margin" else figure
                ended = [getattr(getattr(one, f"{loop}_loop").margins, name) for one in both]
                known = np.isfinite(low) and None not in ended
                inside.append(low < ended[1] - ended[0] < high if known else np.nan)
            hits.setdefault(figure, []).append(np.array(inside, dtype=float))
    return hits


def _true_changes(true: Model, changed: Model) -> np.ndarray:
    """Return the change of the lowest elastic modes in Hz, paired by their shapes."""
    before, after = (_elastic(model, N_MODES + 2) for model in (true, changed))
    similarity = (before.shapes[:, :N_MODES].real.T @ (true.mass @ after.shapes.real)) ** 2
    rows, columns = linear_sum_assignment(similarity, maximize=True)
    return after.frequency[columns] - before.frequency[rows]


def _elastic(model: Model, n: int) -> updyn.ModeSet:
    """Return the lowest modes without rigid-body modes."""
    found = updyn.modes(model, min(n + 6, model.n_dofs))
    elastic = np.flatnonzero(found.frequency > 1e-4 * found.frequency.max())
    return found.select(elastic[:n])


def _level(model: Model, lines: np.ndarray, ends: tuple[list, list]) -> np.ndarray:
    return 20.0 * np.log10(np.abs(updyn.response(model, lines, *ends).values))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("n", nargs="?", type=int, default=10, help="modifications a structure")
    parser.add_argument("--structures", nargs="+", default=NAMES, choices=NAMES)
    parser.add_argument("--margins", choices=["viscous", "loss_factor"], help="damping")
    arguments = parser.parse_args()
    if arguments.margins:
        for figure, hits in study_margins(arguments.n, arguments.margins).items():
            print(f"{figure:<24}{len(hits):>8} {describe_share(hits):>16}")
        return
    total = Coverage()
    print(f"{'structure':<24}{'updates':>8} {'frequencies':>16} {'levels':>16}{'ratio':>8}")
    for name in arguments.structures:
        single, first, several = study(name, arguments.n)
        rows = {name: single, f"{name}, first answer": first, f"{name}, any answer": several}
        for title, found in rows.items():
            if found.modes:
                print(found.row(title), flush=True)
        for found in (single, several):
            for kind in ("modes", "levels", "ratios"):
                getattr(total, kind).extend(getattr(found, kind))
    print(total.row("all, any answer"))


if __name__ == "__main__":
    main()
