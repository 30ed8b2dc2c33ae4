"""Place and kind of one nonlinear element, from FRFs at three force levels.

The structures and levels of levels.py with one element at a random place: between two degrees of
freedom that a stiffness connects, or between one and ground; all of these are candidates. Kinds:
hardening and softening cubic springs, gap, slider, joint, quadratic damper and dry friction, each
at the same number of places. 1 % noise and a floor of 0.1 % of the rms. The stiffnesses and loss
factors of the model are off by up to 30 %, and are unknowns (--exact and the solid: known). An
element that has no periodic response at a level is drawn again.

    OMP_NUM_THREADS=1 python benchmarks/locate.py [STRUCTURE ...] [--draws 2] [--first 0] [--exact]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import levels
import numpy as np

import updyn
from updyn.nonlinear.element import NonlinearElement

#: Largest error of stiffnesses and loss factors of the model.
OFF = 0.3

#: Largest model with linear unknowns, and with all connections as candidates.
LARGEST = 200

#: Elements for a stiffness, an amplitude and a circular frequency, by the name of their kind.
Maker = Callable[[float, float, float], NonlinearElement]
MAKERS: dict[str, tuple[str, Maker]] = {
    "hardening": ("cubic-spring", lambda k, A, w: updyn.CubicSpring(k / A**2)),
    "softening": ("cubic-spring", lambda k, A, w: updyn.CubicSpring(-0.1 * k / A**2)),
    "gap": ("backlash", lambda k, A, w: updyn.Backlash(2.0 * k, gap=0.4 * A)),
    "slider": ("jenkins", lambda k, A, w: updyn.JenkinsElement(k, slip_force=0.3 * k * A)),
    "joint": ("iwan", lambda k, A, w: updyn.IwanJoint(0.3 * k * A, k, -0.5, 0.5)),
    "damper": ("quadratic-damper", lambda k, A, w: updyn.QuadraticDamper(0.5 * k / (w**2 * A))),
    "friction": (
        "coulomb-friction",
        lambda k, A, w: updyn.CoulombFriction(0.1 * k * A, transition=0.05 * w * A),
    ),
}


def list_candidates(s: levels.Structure) -> dict[str, list[str]]:
    """All connections of one direction and all degrees of freedom; of a solid, 24 to ground."""
    labels = [str(dof) for dof in s.model.dofs]
    if len(labels) > LARGEST:
        return {label: [label] for label in map(_positive, levels.models.sensors(s.model, 24))}
    K = s.model.stiffness.toarray()
    found = {}
    for i, j in zip(*np.nonzero(np.triu(K, 1)), strict=True):
        if labels[i].partition(":")[2] == labels[j].partition(":")[2]:
            found[f"{labels[i]} - {labels[j]}"] = [labels[i], labels[j]]
    return found | {f"{label} - ground": [label] for label in labels}


def _positive(label: str) -> str:
    return str(abs(updyn.DofSet([label])[0]))


def add_element(s: levels.Structure, place: list[str], make: Maker) -> updyn.Model:
    """Return the model with an element that changes at the amplitude of the middle level."""
    at = list(dict.fromkeys([*place, s.force]))
    found = updyn.response(s.model, s.freq, at, at)
    w = np.zeros(len(at))
    w[[at.index(label) for label in place]] = [1.0, -1.0][: len(place)]
    across = np.abs(np.einsum("i,fij,j->f", w, found.values, w))
    moved = np.abs(np.einsum("i,fi->f", w, found.values[:, :, at.index(s.force)]))
    peak = int(moved.argmax())
    element = make(0.3 / np.median(across), 0.5 * moved[peak], 2.0 * np.pi * s.freq[peak])
    return s.model.with_elements({"truth": (element, place)})


@dataclass(frozen=True)
class Outcome:
    """Whether place and kind are right, and are the only ones that the data allow."""

    place: bool
    kind: bool
    distinguishable: bool
    likely: bool
    seconds: float


def run_draw(s: levels.Structure, name: str, seed: int, *, exact: bool) -> Outcome:
    kind, make = MAKERS[name]
    rng = np.random.default_rng([seed, list(MAKERS).index(name)])
    candidates = list_candidates(s)
    while True:
        place = list(candidates)[rng.integers(len(candidates))]
        true = add_element(s, candidates[place], make)
        try:
            tests = [levels.measure(true, s, level, rng) for level in levels.LEVELS]
        except updyn.UpdynError:
            continue
        break
    model, unknowns = s.model, None
    if not (exact or s.model.n_dofs > LARGEST):
        changes: dict[str, dict[str, float]] = {}
        for p in s.unknowns(s.model):
            off = 1.0 + rng.uniform(-OFF, OFF)
            value = p.start * off if p.quantity == "loss_factor" else off
            changes.setdefault(p.group, {})[p.quantity] = value
        model = s.model.scaled(changes)
        unknowns = s.unknowns(model)
    begun = time.process_time()
    found = updyn.locate_nonlinearity(
        model, tests, candidates, unknowns=unknowns, noise=levels.NOISE
    )
    out = Outcome(
        found.best.place == place,
        found.best.kind == kind,
        found.distinguishable,
        found.is_likely,
        time.process_time() - begun,
    )
    print(
        f"  {name} {seed} at {place}: {found.statement} ({out.place}, {out.kind},"
        f" {out.seconds:.0f} s)",
        flush=True,
    )
    return out


def run(name: str, seeds: range, kinds: list[str], *, exact: bool) -> None:
    s = levels.make_structures()[name]()
    found = [run_draw(s, kind, seed, exact=exact) for seed in seeds for kind in kinds]
    both = sum(one.place and one.kind for one in found)
    print(
        f"| {name} | {s.model.n_dofs} | {len(list_candidates(s))} | {len(found)} |"
        f" {sum(one.place for one in found)} | {sum(one.kind for one in found)} | {both} |"
        f" {sum(not one.distinguishable for one in found)} |"
        f" {sum(not one.likely for one in found)} |"
        f" {np.median([one.seconds for one in found]):.1f} |",
        flush=True,
    )


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", help=", ".join(levels.make_structures()))
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(MAKERS), help=", ".join(MAKERS))
    parser.add_argument("--exact", action="store_true", help="the linear model is known")
    given = parser.parse_args()
    print(
        "| structure | DOFs | places | elements | place right | kind right | both right |"
        " not distinguishable | not found | s |"
    )
    for name in given.structures or levels.make_structures():
        seeds = range(given.first, given.first + given.draws)
        run(name, seeds, given.kinds, exact=given.exact)


if __name__ == "__main__":
    main()
