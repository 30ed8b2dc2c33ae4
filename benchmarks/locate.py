"""Place and kind of one nonlinear element, from FRFs at three force levels.

The structures and levels of levels.py with one element at a random place: between two degrees of
freedom that a stiffness connects, or between one and ground; all of these are candidates. Kinds:
hardening and softening cubic springs, gap, slider, joint, quadratic damper and dry friction, each
at the same number of places, which the force moves. 1 % noise and a floor of 0.1 % of the rms. The
stiffnesses and loss factors of the model are off by up to 30 %, and are unknowns (--exact and the
solid: known). An element that has no periodic response at a level is drawn again. With
``--random``, tests are those of a random force (levels.py), without softening springs: a Gaussian
motion exceeds any deformation, beyond which their force pulls.

    OMP_NUM_THREADS=1 python benchmarks/locate.py [STRUCTURE ...] [--draws 2] [--first 0] [--exact]
        [--random]

With ``--elements N``, N elements of different kinds at different places are sought by
`updyn.locate_nonlinearities` (0: a linear structure), of the kinds in random order. Elements whose
absence changes the FRFs by less than three standard deviations of the noise (rms) are drawn again.
Draws are appended to ``--record FILE``, and those that it has are not repeated.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import levels
import numpy as np

import updyn
from updyn.nonlinear.element import NonlinearElement
from updyn.updating.problem.parameters import ParameterSet, no_unknowns
from updyn.updating.problem.problem import FRFPart

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


#: Least deformation by the force over that by the same force at the place: far above rounding.
MOVED = 1e-9


def list_moved(s: levels.Structure) -> list[str]:
    """Names of the candidates that the force moves: an element at others changes no FRF."""
    moves = {name: find_moves(s, place) for name, place in list_candidates(s).items()}
    return [name for name, (own, by_force) in moves.items() if (by_force > MOVED * own).any()]


def find_moves(s: levels.Structure, place: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Deformations of a place by a force there, and by that of the test, in m/N at each line."""
    at = list(dict.fromkeys([*place, s.force]))
    found = updyn.response(s.model, s.freq, at, at)
    w = np.zeros(len(at))
    w[[at.index(label) for label in place]] = [1.0, -1.0][: len(place)]
    own = np.abs(np.einsum("i,fij,j->f", w, found.values, w))
    return own, np.abs(np.einsum("i,fi->f", w, found.values[:, :, at.index(s.force)]))


def add_element(s: levels.Structure, place: list[str], make: Maker) -> updyn.Model:
    """Return the model with an element that changes at the amplitude of the middle level."""
    across, moved = find_moves(s, place)
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


def run_draw(s: levels.Structure, name: str, seed: int, *, exact: bool, is_random: bool) -> Outcome:
    kind, make = MAKERS[name]
    rng = np.random.default_rng([seed, list(MAKERS).index(name)])
    candidates, moved = list_candidates(s), list_moved(s)
    while True:
        place = moved[rng.integers(len(moved))]
        true = add_element(s, candidates[place], make)
        try:
            tests = [levels.measure(true, s, level, rng, is_random) for level in levels.LEVELS]
        except updyn.UpdynError:
            continue
        break
    model, unknowns = s.model, None
    if not (exact or s.model.n_dofs > LARGEST):
        model, unknowns = set_off(s, rng)
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


#: Least effect of an element on the FRFs, rms in standard deviations of the noise.
EFFECT = 3.0


def draw_elements(
    s: levels.Structure, count: int, rng: np.random.Generator
) -> tuple[updyn.Model, list[tuple[str, str]], list[updyn.FRF]]:
    """Return a structure with elements, their places and kinds, and its tests."""
    candidates = list_candidates(s)
    if not count:
        clean = updyn.response(s.model, s.freq, s.sensors, [s.force])
        return s.model, [], [add_noise(clean.with_level(f * s.middle), rng) for f in levels.LEVELS]
    moved = list_moved(s)
    while True:
        names, model = [], s.model
        chosen = rng.choice(moved, count, replace=False).tolist()
        kinds = rng.choice(list(MAKERS), count, replace=False).tolist()
        for number, (place, key) in enumerate(zip(chosen, kinds, strict=True)):
            kind, make = MAKERS[key]
            alone = add_element(s, candidates[place], make).nonlinear["truth"]
            model = replace(model, nonlinear={**model.nonlinear, f"truth {number}": alone})
            names.append((place, kind))
        if len({kind for _, kind in names}) < count:
            continue
        try:
            few = replace(s, freq=s.freq[::4])
            if min(effect(few, model, name) for name in model.nonlinear) >= EFFECT:
                return model, names, [add_noise(frf, rng) for frf in respond(model, s)]
        except updyn.UpdynError:
            continue


def respond(model: updyn.Model, s: levels.Structure) -> list[updyn.FRF]:
    return [
        updyn.response(model, s.freq, s.sensors, [s.force], level=f * s.middle).frf
        for f in levels.LEVELS
    ]


def deviation(frf: updyn.FRF) -> np.ndarray:
    """Standard deviation of the noise of each value."""
    size = np.abs(frf.values)
    rms = np.sqrt(np.mean(size**2))
    return np.hypot(levels.NOISE["relative"] * size, levels.NOISE["floor"] * rms)


def add_noise(frf: updyn.FRF, rng: np.random.Generator) -> updyn.FRF:
    draw = rng.standard_normal((2, *frf.values.shape)) / np.sqrt(2.0)
    return replace(frf, values=frf.values + deviation(frf) * (draw[0] + 1j * draw[1]))


def effect(s: levels.Structure, model: updyn.Model, name: str) -> float:
    """Rms change of the FRFs without an element, in standard deviations of the noise."""
    rest = {key: one for key, one in model.nonlinear.items() if key != name}
    changes = []
    plain = updyn.response(s.model, s.freq, s.sensors, [s.force])
    for level in levels.LEVELS:
        frf = plain.with_level(level * s.middle)
        both = [
            FRFPart.build(replace(model, nonlinear=nonlinear), frf, no_unknowns())
            for nonlinear in (model.nonlinear, rest)
        ]
        H, H_rest = (part.responses(np.zeros(0)) for part in both)
        changes.append((H_rest - H) / deviation(replace(frf, values=H)))
    return float(np.sqrt(np.mean(np.abs(changes) ** 2)))


def run_several(name: str, count: int, seed: int, model_is: str) -> dict[str, object]:
    """Return the outcome of a draw as plain values."""
    s = levels.make_structures()[name]()
    s = replace(s, freq=s.freq[::3])
    rng = np.random.default_rng([seed, count, list(levels.make_structures()).index(name)])
    _, truth, tests = draw_elements(s, count, rng)
    print(f"  {name} {count} {seed}: {truth}", flush=True)
    model, unknowns = (s.model, None) if model_is == "exact" else set_off(s, rng)
    begun = time.process_time()
    found = updyn.locate_nonlinearities(
        model,
        tests,
        list_candidates(s),
        unknowns=None if model_is == "wrong" else unknowns,
        noise=levels.NOISE,
    )
    named = [(one.place, one.kind) for one in found]
    out = {
        "structure": name,
        "elements": count,
        "seed": seed,
        "model": model_is,
        "truth": truth,
        "found": named,
        "places": len({place for place, _ in truth} & {place for place, _ in named}),
        "both": len(set(truth) & set(named)),
        "further": max(len(named) - count, 0),
        "residual": found.residual,
        "linear_residual": found.linear_residual,
        "seconds": time.process_time() - begun,
    }
    print(
        f"  {name} {count} {seed}: {truth}; {found.statement} ({out['seconds']:.0f} s)", flush=True
    )
    return out


def set_off(s: levels.Structure, rng: np.random.Generator) -> tuple[updyn.Model, ParameterSet]:
    """Return the model with stiffnesses and loss factors off at random, and its unknowns."""
    changes: dict[str, dict[str, float]] = {}
    for p in s.unknowns(s.model):
        off = 1.0 + rng.uniform(-OFF, OFF)
        value = p.start * off if p.quantity == "loss_factor" else off
        changes.setdefault(p.group, {})[p.quantity] = value
    model = s.model.scaled(changes)
    return model, s.unknowns(model)


def run_record(names: Sequence[str], count: int, seeds: range, model_is: str, record: Path) -> None:
    """Run draws that the record does not have, and print its figures."""
    rows = []
    if record.exists():
        rows = [json.loads(line) for line in record.read_text(encoding="utf-8").splitlines()]
    known = {(row["structure"], row["elements"], row["seed"], row["model"]) for row in rows}
    for seed in seeds:
        for name in names:
            if (name, count, seed, model_is) in known:
                continue
            row = run_several(name, count, seed, model_is)
            rows.append(row)
            with record.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    print("| structure | model | draws | elements | place | place and kind | further | s |")
    for name in names:
        for n in sorted({row["elements"] for row in rows}):
            own = [
                row
                for row in rows
                if (row["structure"], row["elements"], row["model"]) == (name, n, model_is)
            ]
            if own:
                sums = [sum(row[key] for row in own) for key in ("elements", "places", "both")]
                further = sum(row["further"] > 0 for row in own)
                seconds = np.median([row["seconds"] for row in own])
                print(
                    f"| {name} | {model_is} | {len(own)} | {sums[0]} | {sums[1]} | {sums[2]} |"
                    f" {further} | {seconds:.0f} |"
                )


def run(name: str, seeds: range, kinds: list[str], *, exact: bool, is_random: bool) -> None:
    s = levels.make_structures()[name]()
    found = [
        run_draw(s, kind, seed, exact=exact, is_random=is_random)
        for seed in seeds
        for kind in kinds
    ]
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
    parser.add_argument("--random", action="store_true", help="tests of a random force")
    parser.add_argument("--elements", type=int, help="number of elements; several are sought")
    parser.add_argument("--wrong", action="store_true", help="errors of the model are not fitted")
    parser.add_argument("--record", type=Path, default=Path("locate.jsonl"), help="file of draws")
    given = parser.parse_args()
    if given.elements is not None:
        model_is = "exact" if given.exact else "wrong" if given.wrong else "fitted"
        seeds = range(given.first, given.first + given.draws)
        names = given.structures or ["chain", "building", "drive"]
        run_record(names, given.elements, seeds, model_is, given.record)
        return
    kinds = [kind for kind in given.kinds if not (given.random and kind == "softening")]
    print(
        "| structure | DOFs | places | elements | place right | kind right | both right |"
        " not distinguishable | not found | s |"
    )
    for name in given.structures or levels.make_structures():
        seeds = range(given.first, given.first + given.draws)
        run(name, seeds, kinds, exact=given.exact, is_random=given.random)


if __name__ == "__main__":
    main()
