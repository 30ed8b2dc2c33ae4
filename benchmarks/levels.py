"""Updates of linear groups and nonlinear elements to FRFs at three force levels.

Seven structures of 7 to 1,944 degrees of freedom with one to three elements; sine tests at a fifth
of a middle level, at this level and at five times it; 1 % noise and a floor of 0.1 % of the rms.
One is the free gear train of Bao, Wang & Cheng with a gap in a mesh, which no spring bridges, and
Coulomb friction at its motor. The start has stiffnesses and loss factors off by up to 30 % and
parameters of elements off by a factor of three, up or down at random. Each fit is compared with one
from the truth:

- recovered: every determined unknown is that of the fit from the truth, within a tenth of its
  standard deviation;
- RMS over bound: root of the mean square of the error over the standard deviation (the Cramer-Rao
  bound), of all determined unknowns of recovered draws;
- coverage: share of the true values of these unknowns within the 95 % intervals.

An unknown is determined if its standard deviation is below a third of its value.

    OMP_NUM_THREADS=1 python benchmarks/levels.py [STRUCTURE ...] [--draws 20] [--first 0]

With ``--random``, tests are those of a random force, whose spectral density falls by 10 dB at the
first natural frequency, as that of a shaker. The middle RMS moves the first element by the
standard deviation that is its amplitude at the middle level. Measured and fitted FRFs are both by
statistical linearisation; `nonlinear.py fitted` has those of simulated tests.

With ``--added``, standard deviations that `updyn.assess_levels` predicts for a third test, from
fits to the two lower levels, are compared with those of a fit to this test, too: the third level is
twice and five times the highest. Fits begin at the truth.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import models
import numpy as np
import structures
import trains
from cases import chain12

import updyn
from updyn.demos import loose_train
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.updating.problem.parameters import ParameterSet

#: Largest difference of one answer from another, in standard deviations.
SAME = 0.1
#: Largest standard deviation of a determined unknown, over its value.
DETERMINED = 1.0 / 3.0
NOISE = {"relative": 0.01, "floor": 0.001}
LEVELS = (0.2, 1.0, 5.0)

#: Parameters of elements that are unknown.
SOUGHT = {
    updyn.CubicSpring: ("coefficient",),
    updyn.Backlash: ("stiffness", "gap"),
    updyn.JenkinsElement: ("stiffness", "slip_force"),
    updyn.IwanJoint: ("stiffness", "slip_force"),
    updyn.CoulombFriction: ("level",),
}

Maker = Callable[[float, float], NonlinearElement]


def cubic(k: float, A: float) -> NonlinearElement:
    return updyn.CubicSpring(k / A**2)


def gap(k: float, A: float) -> NonlinearElement:
    return updyn.Backlash(2.0 * k, gap=0.4 * A)


def slider(k: float, A: float) -> NonlinearElement:
    return updyn.JenkinsElement(k, slip_force=0.3 * k * A)


def joint(k: float, A: float) -> NonlinearElement:
    return updyn.IwanJoint(0.3 * k * A, k, -0.5, 0.5)


def friction(k: float, A: float) -> NonlinearElement:
    return updyn.JenkinsElement(3.0 * k, slip_force=0.1 * k * A)


@dataclass(frozen=True)
class Structure:
    """A linear model, the channels and lines of its tests, and elements at deformations."""

    model: updyn.Model
    sensors: Sequence[str]
    force: str
    freq: np.ndarray
    elements: Mapping[str, tuple[Maker, list[str] | dict[str, float]]]
    stiffness: str = "all"
    #: Middle level of the force in N (N m).
    middle: float = 1.0

    def truth(self) -> updyn.Model:
        """Return the model with elements; the middle force level is 1 N.

        An element has a third of the stiffness of the structure at its deformation, and changes at
        the amplitude of the middle level.
        """
        ends = [e for _, pair in self.elements.values() for e in pair]
        at = list(dict.fromkeys([*ends, self.force]))
        found = updyn.response(self.model, self.freq, at, at)
        made = {}
        for name, (make, pair) in self.elements.items():
            w = np.zeros(len(at))
            w[[at.index(label) for label in pair]] = [1.0, -1.0][: len(pair)]
            across = np.abs(np.einsum("i,fij,j->f", w, found.values, w))
            moved = np.abs(np.einsum("i,fi->f", w, found.values[:, :, at.index(self.force)]))
            made[name] = (make(0.3 / np.median(across), 0.5 * moved.max()), pair)
        return self.model.with_elements(made)

    def spectrum(self, level: float) -> np.ndarray:
        """Return the spectrum of a random force at a level relative to the middle one."""
        first = float(self.freq[0]) / 0.6  # see `band`
        shape = 1.0 - 0.9 * np.exp(-(((self.freq - first) / (0.05 * first)) ** 2))
        local = next(iter(self.truth().nonlinear.values()))
        weights = dict(zip(self.model.dofs.labels, local.column(self.model.dofs), strict=True))
        at = [label for label, weight in weights.items() if weight]
        w = np.array([weights[label] for label in at])
        moved = np.abs(updyn.response(self.model, self.freq, at, [self.force]).values[:, :, 0] @ w)
        spread = np.sqrt(np.trapezoid(shape * moved**2, self.freq))
        size = level * self.middle * 0.5 * moved.max() / spread
        return np.column_stack([self.freq, size**2 * shape])

    def unknowns(self, start: updyn.Model, names: Sequence[str] = ()) -> ParameterSet:
        return updyn.parameters(
            start, stiffness=self.stiffness, loss_factor=self.stiffness, nonlinear=names
        )


def band(model: updyn.Model, count: int, lines: int) -> np.ndarray:
    elastic = updyn.modes(model, min(count + 6, model.n_dofs)).frequency
    elastic = elastic[elastic > 1e-3 * elastic[-1]]
    return np.linspace(0.6 * elastic[0], 1.15 * elastic[min(count, len(elastic)) - 1], lines)


@dataclass(frozen=True)
class LooseTrain(Structure):
    """The gear train with a gap in one mesh, which nothing bridges, and friction at the motor."""

    def truth(self) -> updyn.Model:
        return loose_train.true_model()


def make_structures() -> dict[str, Callable[[], Structure]]:
    return {
        "shaft": _shaft,
        "chain": _chain,
        "drive": _drive,
        "building": _building,
        "long chain": _long_chain,
        "solid": _solid,
        "gear train": _gear_train,
    }


def _shaft() -> Structure:
    true = models.drive_train(7, parts=3)
    at = [f"{n}:RZ" for n in (1, 3, 4, 7)]
    elements = {"mesh": (cubic, ["3:RZ", "4:RZ"])}
    return Structure(true, at, "1:RZ", band(true, 4, 120), elements)


def _chain() -> Structure:
    true = chain12().true
    elements = {"stop": (cubic, ["12:X"]), "joint": (slider, ["5:X", "6:X"])}
    at = [f"{n}:X" for n in (3, 5, 6, 9, 12)]
    return Structure(true, at, "12:X", band(true, 4, 120), elements)


def _drive() -> Structure:
    true = trains.three_outputs()
    elements = {"mesh": (gap, ["3:RZ", "4:RZ"]), "brake": (friction, ["1:RZ"])}
    at = [f"{n}:RZ" for n in (1, 3, 4, 6, 9, 12)]
    return Structure(true, at, "1:RZ", band(true, 4, 120), elements)


def _building() -> Structure:
    case = structures.building().case
    true = case.true
    elements = {"brace": (joint, ["2:X", "1:X"])}
    at = ["1:X", "2:X", "4:X", "4:Y"]
    return Structure(true, at, "4:X", band(true, 4, 120), elements, "storey ? x")


def _long_chain() -> Structure:
    true = models.chain(100, parts=4)
    elements = {
        "stop": (cubic, ["100:X"]),
        "joint": (slider, ["50:X", "51:X"]),
        "bearing": (gap, ["75:X"]),
    }
    at = [f"{n}:X" for n in (25, 50, 51, 75, 100)]
    return Structure(true, at, "100:X", band(true, 4, 120), elements)


def _solid() -> Structure:
    true = models.solid((5, 5, 18), parts=4)
    at = models.sensors(true, 6)
    end = str(abs(updyn.DofSet(at)[0]))
    return Structure(true, at, at[0], band(true, 4, 100), {"stop": (cubic, [end])})


def _gear_train() -> Structure:
    true = loose_train.true_model()
    elements = {name: (gap, dict(local.weights)) for name, local in true.nonlinear.items()}
    at, motor, freq = loose_train.SENSORS, loose_train.MOTOR, loose_train.lines()
    middle = loose_train.LEVELS[1]
    linear = replace(true, nonlinear={})
    return LooseTrain(linear, at, motor, freq, elements, "unit [13-6]", middle)


@dataclass(frozen=True)
class Start:
    """A start off the truth; the true unknowns in terms of this start, and of the true model."""

    model: updyn.Model
    truth: dict[str, float]
    own: dict[str, float]

    @classmethod
    def draw(cls, true: updyn.Model, s: Structure, rng: np.random.Generator) -> Start:
        """Draw a start off by up to 30 %, and by a factor of three in the elements."""
        truth: dict[str, float] = {}
        own_truth: dict[str, float] = {}
        changes: dict[str, dict[str, float]] = {}
        for p in s.unknowns(true):
            off = 1.0 + rng.uniform(-0.3, 0.3)
            is_loss = p.quantity == "loss_factor"
            changes.setdefault(p.group, {})[p.quantity] = p.start * off if is_loss else off
            truth[p.name] = p.start if is_loss else 1.0 / off
            own_truth[p.name] = p.start
        elements = {}
        for name, local in true.nonlinear.items():
            values = list_parameters(local.element)
            own = {key: values[key] for key in SOUGHT[type(local.element)]}
            named = {f"{name}.{key}": value for key, value in own.items()}
            truth, own_truth = truth | named, own_truth | named
            off = {key: value * 3.0 ** rng.choice([-1.0, 1.0]) for key, value in own.items()}
            elements[name] = change_parameters(local.element, off), s.elements[name][1]
        model = replace(true, nonlinear={}).scaled(changes)
        return cls(model.with_elements(elements), truth, own_truth)


def measure(
    true: updyn.Model, s: Structure, level: float, rng: np.random.Generator, is_random: bool = False
) -> updyn.FRF:
    if is_random:
        spectrum = s.spectrum(level)
        frf = updyn.response(
            true, s.freq, s.sensors, [s.force], spectrum=spectrum, excitation="random"
        ).frf
    else:
        frf = updyn.response(true, s.freq, s.sensors, [s.force], level=level * s.middle).frf
    size = np.sqrt(
        (NOISE["relative"] * np.abs(frf.values)) ** 2
        + NOISE["floor"] ** 2 * np.mean(np.abs(frf.values) ** 2)
    )
    draw = rng.standard_normal((2, *frf.values.shape))
    return replace(frf, values=frf.values + size * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))


@dataclass(frozen=True)
class Outcome:
    """A draw: scaled errors of the determined unknowns, and processor time of the fit in s."""

    status: str
    is_recovered: bool
    from_truth: float
    scaled: np.ndarray
    covered: np.ndarray
    seconds: float


def run_draw(s: Structure, seed: int, is_random: bool) -> Outcome:
    rng = np.random.default_rng(seed)
    true = s.truth()
    tests = [measure(true, s, level, rng, is_random) for level in LEVELS]
    start = Start.draw(true, s, rng)
    names = [f"{n}.{key}" for n, x in true.nonlinear.items() for key in SOUGHT[type(x.element)]]
    begun = time.process_time()
    found = updyn.update(start.model, tests, s.unknowns(start.model, names), noise=NOISE)
    seconds = time.process_time() - begun
    best = updyn.update(true, tests, s.unknowns(true, names), noise=NOISE, starts=0)
    return _compare(found, best, start, seconds)


def _compare(
    found: updyn.JointResult, best: updyn.JointResult, start: Start, seconds: float
) -> Outcome:
    wanted = np.array(list(start.truth.values()))
    own = np.array(list(start.own.values()))
    names, intervals = list(start.truth), found.intervals(0.95)
    value = np.array([found.values[name] for name in names]) / wanted
    low, high = np.array([intervals[name] for name in names]).T / wanted
    reference = np.array([best.values[name] for name in names]) / own
    std = np.array([best.std[name] for name in names]) / own
    determined = std < DETERMINED
    worst = float((np.abs(value - reference) / std)[determined].max(initial=0.0))
    return Outcome(
        found.status,
        worst <= SAME,
        worst,
        ((value - 1.0) / std)[determined],
        ((low <= 1.0) & (high >= 1.0))[determined],
        seconds,
    )


def run(name: str, seeds: range, is_random: bool) -> None:
    s = make_structures()[name]()
    found = []
    for seed in seeds:
        one = run_draw(s, seed, is_random)
        found.append(one)
        print(
            f"  {name} {seed}: {one.status}, {one.from_truth:.3g} deviations from the truth's fit,"
            f" {one.seconds:.0f} s",
            flush=True,
        )
    good = [one for one in found if one.is_recovered]
    scaled = np.concatenate([one.scaled for one in good] or [np.zeros(0)])
    covered = np.concatenate([one.covered for one in good] or [np.zeros(0)])
    rms = np.sqrt(np.mean(scaled**2)) if len(scaled) else np.nan
    print(
        f"| {name} | {s.model.n_dofs} | {len(s.elements)} | {len(good)} of {len(found)} |"
        f" {rms:.2f} | {100 * covered.mean() if len(covered) else np.nan:.1f} % |"
        f" {np.median([one.seconds for one in found]):.1f} |",
        flush=True,
    )


#: Levels of a third test, in N.
ADDED = (2.0, 5.0)


def run_added(name: str, seeds: range) -> None:
    """Compare predicted standard deviations with those of fits to a third test."""
    s = make_structures()[name]()
    true = s.truth()
    names = [f"{n}.{key}" for n, x in true.nonlinear.items() for key in SOUGHT[type(x.element)]]
    unknowns = s.unknowns(true, names)
    ratios: dict[float, list[float]] = {level: [] for level in ADDED}
    gains: dict[float, list[tuple[float, float]]] = {level: [] for level in ADDED}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        tests = [measure(true, s, level, rng) for level in LEVELS[:2]]
        few = updyn.update(true, tests, unknowns, noise=NOISE, starts=0)
        candidates = updyn.assess_levels(few, [s.middle * level for level in ADDED]).candidates
        for level, one in zip(ADDED, candidates, strict=True):
            more = [*tests, measure(true, s, level, rng)]
            found = updyn.update(true, more, unknowns, noise=NOISE, starts=0)
            size = {p.name: p.start for p in unknowns}
            kept = [k for k, std in found.std.items() if std < DETERMINED * abs(size[k])]
            ratios[level] += [one.std[k] / found.std[k] for k in kept]
            both = [k for k in kept if np.isfinite(few.std[k])]
            obtained = np.mean([np.log(found.std[k] / few.std[k]) for k in both])
            predicted = np.mean([np.log(one.std[k] / few.std[k]) for k in both])
            gains[level].append((1.0 - np.exp(predicted), 1.0 - np.exp(obtained)))
    for level in ADDED:
        low, middle, high = np.quantile(ratios[level], (0.05, 0.5, 0.95))
        predicted, obtained = 100.0 * np.mean(gains[level], axis=0)
        print(
            f"| {name} | {level / LEVELS[1]:g} | {len(ratios[level])} | {middle:.2f} |"
            f" {low:.2f} to {high:.2f} | {predicted:.0f} % | {obtained:.0f} % |",
            flush=True,
        )


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("structures", nargs="*", help=", ".join(make_structures()))
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--added", action="store_true", help="predict the gain of a third test")
    parser.add_argument("--random", action="store_true", help="tests of a random force")
    given = parser.parse_args()
    if given.added:
        print("| structure | level | unknowns | ratio | 90 % of them | predicted | obtained |")
        for name in given.structures or make_structures():
            run_added(name, range(given.first, given.first + given.draws))
        return
    print("| structure | DOFs | elements | recovered | RMS / bound | coverage | s per fit |")
    for name in given.structures or make_structures():
        run(name, range(given.first, given.first + given.draws), given.random)


if __name__ == "__main__":
    main()
