"""Coverage of 95 % intervals where the model is wrong, and where the data are few.

Study `errors`: random structures of four families (a chain of springs, a network, a plane frame, a
grid of springs), measured at three to five sensors from one force, with 1 % noise and a small
floor. The model lacks one thing, or has it wrong, out of eleven kinds. Stiffnesses, and dampings
where they have a true value, count; of data whose damping has another law they have none.

Study `few`: a chain of three springs, six unknowns, 4 to 40 lines of one to six channels, relative
noise and a floor, estimated from the residual. Standard error of a coverage of 95 % over 200 draws
of six unknowns: about 1 %.

    python benchmarks/discrepancy.py errors [--structures 66] [--first 0] [--starts 0]
    python benchmarks/discrepancy.py few [--draws 200] [--lines 4,6,8,12,20,40]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

import updyn
from updyn.errors import UpdynError
from updyn.frf import FRF
from updyn.model import Group, Model

FAMILIES = ("chain", "net", "frame", "grid")
ERRORS = (
    "clean",
    "boundary",
    "missing spring",
    "missing mass",
    "dashpot",
    "viscous as structural",
    "structural as viscous",
    "mass loading",
    "nonlinear",
    "wrong mass",
    "frequency-dependent damping",
)
#: Relative noise, and floor as a share of the rms.
RELATIVE, FLOOR = 0.01, 1e-4


@dataclass(frozen=True, eq=False)
class Part:
    """Matrices of a group of the true structure."""

    K: np.ndarray
    M: np.ndarray
    C: np.ndarray
    loss: float = 0.0


@dataclass(frozen=True, eq=False)
class Structure:
    """A true structure: groups by name, and a label for each degree of freedom."""

    family: str
    parts: dict[str, Part]
    labels: list[str]

    @property
    def n(self) -> int:
        return len(self.labels)

    def total(self, name: str) -> np.ndarray:
        return sum(getattr(part, name) for part in self.parts.values())

    def frequencies(self) -> np.ndarray:
        from scipy.linalg import eigh

        square = eigh(self.total("K"), self.total("M"), eigvals_only=True)
        return np.sqrt(np.maximum(square, 0.0)) / (2.0 * np.pi)

    def having(self, **parts: Part) -> Structure:
        return replace(self, parts={**self.parts, **parts})

    def dynamic(self, freq: np.ndarray, law: float = 0.0, middle: float = 1.0) -> np.ndarray:
        """Dynamic stiffness; loss factors go with (f / middle) to the power `law`."""
        w = 2.0 * np.pi * freq[:, None, None]
        Z = np.zeros((len(freq), self.n, self.n), dtype=complex)
        for p in self.parts.values():
            loss = p.loss * (freq[:, None, None] / middle) ** law
            Z += (1.0 + 1j * loss) * p.K + 1j * w * p.C - w**2 * p.M
        return Z


def solid(n: int, K=None, M=None, C=None, loss: float = 0.0) -> Part:
    zero = np.zeros((n, n))
    K, M, C = (zero if A is None else A for A in (K, M, C))
    return Part(K, M, C, loss)


def spring(n: int, i: int, j: int | None, k: float) -> np.ndarray:
    v = np.zeros(n)
    v[i] = 1.0
    if j is not None:
        v[j] = -1.0
    return k * np.outer(v, v)


def loss_factor(rng: np.random.Generator) -> float:
    return float(10 ** rng.uniform(-2.5, -1.3))


def chain(rng: np.random.Generator) -> Structure:
    n, groups = int(rng.integers(6, 18)), int(rng.integers(3, 6))
    owner = np.sort(np.r_[np.arange(groups), rng.integers(0, groups, n - groups)])
    parts = {}
    for g in range(groups):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for i in np.flatnonzero(owner == g):
            K += spring(n, i, i - 1 if i else None, 10 ** rng.uniform(4.0, 5.3))
            M[i, i] = 10 ** rng.uniform(-0.4, 0.4)
        parts[f"section{g}"] = solid(n, K, M, None, loss_factor(rng))
    return Structure("chain", parts, [f"{i + 1}:X" for i in range(n)])


def net(rng: np.random.Generator) -> Structure:
    n = int(rng.integers(6, 14))
    masses = np.diag(10 ** rng.uniform(-0.4, 0.4, n))
    parts = {"mass": solid(n, None, masses)}
    ground = np.diag(rng.uniform(1e4, 3e4, n))
    parts["ground"] = solid(n, ground, None, None, loss_factor(rng))
    edges = [(i, i + 1) for i in range(n - 1)]
    edges += [tuple(rng.choice(n, 2, replace=False)) for _ in range(int(rng.integers(0, 4)))]
    groups = int(rng.integers(2, 5))
    owner = np.r_[np.arange(groups), rng.integers(0, groups, len(edges) - groups)]
    for g in range(groups):
        K = sum(
            spring(n, int(i), int(j), 10 ** rng.uniform(4.3, 5.6))
            for (i, j), own in zip(edges, owner, strict=True)
            if own == g
        )
        parts[f"links{g}"] = solid(n, K, None, None, loss_factor(rng))
    return Structure("net", parts, [f"{i + 1}:Y" for i in range(n)])


def beam(E: float, inertia: float, A: float, rho: float, a, b) -> tuple[np.ndarray, np.ndarray]:
    """Plane beam element (u, v, theta at both ends) with the consistent mass matrix."""
    along = np.subtract(b, a)
    L = float(np.hypot(*along))
    c, s = along / L
    s1, s2 = E * A / L, E * inertia / L**3
    K = np.zeros((6, 6))
    K[np.ix_([0, 3], [0, 3])] = s1 * np.array([[1, -1], [-1, 1]])
    bending = np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, 4 * L**2, -6 * L, 2 * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L**2, -6 * L, 4 * L**2],
        ]
    )
    K[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = s2 * bending
    m = rho * A * L
    M = np.zeros((6, 6))
    M[np.ix_([0, 3], [0, 3])] = m / 6 * np.array([[2, 1], [1, 2]])
    M[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = (m / 420) * np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )
    R = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return R.T @ K @ R, R.T @ M @ R


def frame(rng: np.random.Generator) -> Structure:
    """Two legs and a girder that overhangs, clamped at the feet."""
    e, height, width = int(rng.integers(2, 4)), rng.uniform(0.5, 2.0), rng.uniform(0.5, 3.0)
    over = 0.4 * width
    corners = {"legA": ((0, 0), (0, height)), "girder": ((0, height), (width, height))}
    corners |= {
        "legB": ((width, height), (width, 0)),
        "arm": ((width, height), (width + over, height)),
    }
    nodes: list[tuple[float, float]] = []

    def node(at: np.ndarray) -> int:
        key = (round(float(at[0]), 9), round(float(at[1]), 9))
        if key not in nodes:
            nodes.append(key)
        return nodes.index(key)

    elements = []
    for name, (a, b) in corners.items():
        points = [np.array(a) + (np.array(b) - np.array(a)) * t for t in np.linspace(0, 1, e + 1)]
        ids = [node(point) for point in points]
        elements += [(name, *pair) for pair in pairwise(ids)]
    n = 3 * len(nodes)
    feet = [nodes.index((0.0, 0.0)), nodes.index((round(float(width), 9), 0.0))]
    keep = np.setdiff1d(np.arange(n), [3 * foot + d for foot in feet for d in range(3)])
    parts = {}
    for name in corners:
        inertia, A = 10 ** rng.uniform(-7.0, -6.3), 10 ** rng.uniform(-3.2, -2.8)
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for own, i, j in elements:
            if own == name:
                at = np.ix_([3 * i, 3 * i + 1, 3 * i + 2, 3 * j, 3 * j + 1, 3 * j + 2], range(6))[0]
                k, m = beam(2.1e11, inertia, A, 7850.0, nodes[i], nodes[j])
                K[at, at.T] += k
                M[at, at.T] += m
        at = np.ix_(keep, keep)
        parts[name] = solid(len(keep), K[at], M[at], None, loss_factor(rng))
    labels = [f"{d // 3 + 1}:{('X', 'Y', 'RZ')[d % 3]}" for d in keep]
    return Structure("frame", parts, labels)


def grid(rng: np.random.Generator) -> Structure:
    a, b = (int(rng.integers(3, 5)) for _ in range(2))
    n = a * b
    parts = {"mass": solid(n, None, np.diag(rng.uniform(0.8, 1.2, n)))}
    stiff: dict[str, np.ndarray] = {}
    for i in range(a):
        for j in range(b):
            K = stiff.setdefault(f"patch{2 * i // a}{2 * j // b}", np.zeros((n, n)))
            K += spring(n, i * b + j, None, rng.uniform(3e3, 6e3))
            if i + 1 < a:
                K += spring(n, i * b + j, (i + 1) * b + j, rng.uniform(3e4, 6e4))
            if j + 1 < b:
                K += spring(n, i * b + j, i * b + j + 1, rng.uniform(3e4, 6e4))
    for name, K in stiff.items():
        parts[name] = solid(n, K, None, None, loss_factor(rng))
    return Structure("grid", parts, [f"{i + 1}:Z" for i in range(n)])


MAKERS: dict[str, Callable[[np.random.Generator], Structure]] = {
    "chain": chain,
    "net": net,
    "frame": frame,
    "grid": grid,
}


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured, and the model's idea of the structure at its true values."""

    truth: Structure
    freq: np.ndarray
    rows: list[int]
    column: int
    middle: float

    def accelerance(self, Z: np.ndarray, rows: list[int]) -> np.ndarray:
        force = np.zeros((len(self.freq), Z.shape[1], 1))
        force[:, self.column] = 1.0
        w = 2.0 * np.pi * self.freq[:, None]
        return -(w**2) * np.linalg.solve(Z, force)[:, rows, 0]


def measured(family: str, rng: np.random.Generator) -> Measured:
    truth = MAKERS[family](rng)
    f = truth.frequencies()
    rows = sorted(int(i) for i in rng.choice(truth.n, min(int(rng.integers(3, 6)), truth.n), False))
    top = f[min(len(f) - 1, int(rng.integers(3, 9)))] * rng.uniform(1.02, 1.1)
    lines = int(rng.integers(40, 120))
    spaced = np.linspace if rng.random() < 0.5 else np.geomspace
    middle = float(np.sqrt(f[0] * f[min(3, len(f) - 1)]))
    return Measured(truth, spaced(0.4 * f[0], top, lines), rows, int(rng.choice(rows)), middle)


def translations(truth: Structure) -> list[int]:
    return [i for i, label in enumerate(truth.labels) if "R" not in label.split(":")[1]]


def softened(case: Measured, share: float = 0.15) -> np.ndarray:
    """Steady answers of a structure whose first stiffness falls with its strain energy.

    It is `share` lower at the largest energy of the linear structure, and half at most.
    """
    part = next(p for p in case.truth.parts.values() if p.K.any())
    Z = case.truth.dynamic(case.freq)
    force = np.zeros(case.truth.n)
    force[case.column] = 1.0

    def energy(u: np.ndarray) -> float:
        return float((u.conj() @ part.K @ u).real)

    slope = share / max(energy(np.linalg.solve(line, force)) for line in Z)
    H, change = np.empty((len(Z), len(case.rows)), dtype=complex), 0.0
    for k, line in enumerate(Z):
        for _ in range(200):
            u = np.linalg.solve(line + change * part.K * (1.0 + 1j * part.loss), force)
            change += 0.3 * (max(-slope * energy(u), -0.5) - change)
        H[k] = u[case.rows]
    return -((2.0 * np.pi * case.freq[:, None]) ** 2) * H


def answer(case: Measured, error: str, rng: np.random.Generator) -> np.ndarray:
    """Accelerances of the true structure, to which the model lacks what `error` names."""
    truth, n = case.truth, case.truth.n
    moving = translations(truth)
    i = int(rng.choice(moving))
    axis = truth.labels[i].split(":")[1]
    others = [k for k in moving if k != i and truth.labels[k].endswith(f":{axis}")]
    j = int(rng.choice(others)) if others else None
    K, M = truth.total("K"), truth.total("M")
    stiff = np.diag(K)[moving]
    stiff, heavy = float(np.median(stiff[stiff > 0])), float(np.trace(M[np.ix_(moving, moving)]))
    if truth.family == "frame":  # each mass counts in both directions
        heavy /= 2.0
    at = np.zeros((n, n))
    at[i, i] = 1.0
    law = 0.0
    if error == "boundary":
        truth = truth.having(error=solid(n, spring(n, i, None, 0.1 * stiff)))
    elif error == "missing spring":
        truth = truth.having(error=solid(n, spring(n, i, j, 0.1 * stiff)))
    elif error == "missing mass":
        truth = truth.having(error=solid(n, None, 0.05 * heavy * at))
    elif error == "dashpot":
        truth = truth.having(error=solid(n, None, None, 0.05 * np.sqrt(stiff * heavy / n) * at))
    elif error == "wrong mass":
        share = np.zeros(n)
        share[moving] = rng.random(len(moving)) < 0.3
        share[i] = 1.0
        off = 0.2 * share[:, None] * M * share
        truth = truth.having(error=solid(n, None, off))
    elif error == "viscous as structural":
        law = 1.0
    elif error == "frequency-dependent damping":
        law = 0.5
    elif error == "nonlinear":
        return softened(case)
    elif error == "mass loading":
        columns = []
        for row in case.rows:
            load = np.zeros((n, n))
            load[row, row] = 0.03 * heavy
            loaded = truth.having(error=solid(n, None, load))
            columns.append(case.accelerance(loaded.dynamic(case.freq), [row])[:, 0])
        return np.stack(columns, axis=1)
    return case.accelerance(truth.dynamic(case.freq, law, case.middle), case.rows)


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit, and the true value of each unknown that has one, relative to the start."""

    seed: int
    family: str
    error: str
    stated: bool
    result: updyn.UpdateResult
    truth: dict[str, float]
    seconds: float

    def inside(self) -> dict[str, bool]:
        """Whether the interval covers the truth, for unknowns with an interval."""
        spans = self.result.intervals()
        return {k: spans[k][0] <= v <= spans[k][1] for k, v in self.truth.items() if k in spans}

    def deviations(self) -> dict[str, float]:
        """How far each value is from the truth, in standard deviations (of logarithms)."""
        out = {}
        for name, true in self.truth.items():
            value, std = self.result.values[name], self.result.std[name]
            if np.isfinite(std) and std > 0.0:
                stiff = name.endswith("stiffness")
                out[name] = (
                    abs(np.log(value / true)) * value / std if stiff else abs(value - true) / std
                )
        return out


def fit(seed: int, starts: int | None) -> Trial:
    """Fit the structure of a seed; family and kind of error go round, known noise alternates."""
    family, error = FAMILIES[seed % 4], ERRORS[(seed // 4) % len(ERRORS)]
    stated = bool((seed // (4 * len(ERRORS))) % 2)
    rng = np.random.default_rng([2026, seed])
    case = measured(family, rng)
    H = answer(case, error, rng)
    std = np.hypot(RELATIVE * np.abs(H), FLOOR * np.sqrt(np.mean(np.abs(H) ** 2)))
    draw = rng.standard_normal((2, *H.shape))
    H = H + std * np.sqrt(0.5) * (draw[0] + 1j * draw[1])
    labels = case.truth.labels
    frf = FRF(
        case.freq,
        H[:, :, None],
        [labels[i] for i in case.rows],
        [labels[case.column]],
        "accelerance",
    )
    as_viscous = error == "structural as viscous"
    off = {name: float(np.exp(rng.uniform(-0.2, 0.2))) for name in case.truth.parts}
    groups, truth = {}, {}
    for name, part in case.truth.parts.items():
        given = {"stiffness": off[name] * part.K if part.K.any() else None}
        given["mass"] = part.M if part.M.any() else None
        if part.K.any():
            truth[f"{name}.stiffness"] = 1.0 / off[name]
            if as_viscous:
                given["viscous"] = part.K * part.loss / (2.0 * np.pi * case.middle)
            else:
                given["loss_factor"] = 0.02
                if error not in ("viscous as structural", "frequency-dependent damping"):
                    truth[f"{name}.loss_factor"] = part.loss
        groups[name] = Group(**given)
    model = Model.from_groups(groups, labels)
    sprung = [name for name, part in case.truth.parts.items() if part.K.any()]
    damped = {"viscous": sprung} if as_viscous else {"loss_factor": sprung}
    unknowns = updyn.parameters(model, stiffness=sprung, **damped)
    options = {} if starts is None else {"starts": starts}
    if stated:
        options["noise"] = {"relative": RELATIVE, "floor": FLOOR}
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = updyn.update(model, frf, unknowns, **options)
    return Trial(seed, family, error, stated, result, truth, time.perf_counter() - begun)


#: Channels of the study `few`: responses and references of a chain of three masses.
CHANNELS = (((0,), (0,)), ((0, 2), (0,)), ((0, 2, 1), (0, 2)))
#: Its noises: relative, and floor as a share of the rms.
NOISES = ((0.02, 0.0), (0.02, 0.02), (0.01, 0.002), (0.01, 0.01), (0.01, 0.05), (0.0, 0.02))


def three_masses() -> Structure:
    parts = {"mass": solid(3, None, np.diag([1.0, 1.4, 0.9]))}
    for g, (k, loss) in enumerate(((2e4, 0.03), (1.6e4, 0.02), (1.1e4, 0.04))):
        parts[f"spring{g}"] = solid(3, spring(3, g, g - 1 if g else None, k), None, None, loss)
    return Structure("chain", parts, ["1:X", "2:X", "3:X"])


def few(lines: int, channels: int, relative: float, floor: float, draw: int) -> Trial:
    """Fit the six unknowns of a chain of three springs to few data, from near the truth."""
    truth = three_masses()
    f = truth.frequencies()
    freq = np.geomspace(0.6 * f[0], 1.1 * f[2], lines)
    rows, columns = (list(which) for which in CHANNELS[channels])
    forces = np.broadcast_to(np.eye(3)[:, columns], (lines, 3, len(columns)))
    H = np.linalg.solve(truth.dynamic(freq), forces)[:, rows]
    rng = np.random.default_rng([lines, channels, round(1e4 * relative), round(1e4 * floor), draw])
    std = np.hypot(relative * np.abs(H), floor * np.sqrt(np.mean(np.abs(H) ** 2)))
    noise = rng.standard_normal((2, *H.shape))
    H = H + std * np.sqrt(0.5) * (noise[0] + 1j * noise[1])
    off = {name: float(np.exp(rng.uniform(-0.1, 0.1))) for name in truth.parts}
    groups, values = {}, {}
    for name, part in truth.parts.items():
        if name == "mass":
            groups[name] = Group(None, part.M)
            continue
        groups[name] = Group(off[name] * part.K, None, loss_factor=0.02)
        values[f"{name}.stiffness"] = 1.0 / off[name]
        values[f"{name}.loss_factor"] = part.loss
    model = Model.from_groups(groups, truth.labels)
    sprung = [name for name in truth.parts if name != "mass"]
    responses, references = ([truth.labels[i] for i in which] for which in (rows, columns))
    frf = FRF(freq, H, responses, references, "receptance")
    unknowns = updyn.parameters(model, stiffness=sprung, loss_factor=sprung)
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = updyn.update(model, frf, unknowns, starts=0)
    return Trial(draw, "chain", "few", False, result, values, time.perf_counter() - begun)


@dataclass
class Tally:
    """Fits and intervals of a kind."""

    fits: int = 0
    converged: int = 0
    open: int = 0
    inside: list[bool] | None = None
    worst: float = 0.0

    def add(self, trial: Trial) -> None:
        self.fits += 1
        self.open += len(trial.result.noise.get("not_known", ()))
        if not trial.result.ok:
            return
        self.converged += 1
        self.inside = [*(self.inside or []), *trial.inside().values()]
        self.worst = max(self.worst, *trial.deviations().values(), 0.0)

    def __str__(self) -> str:
        covered = 100.0 * np.mean(self.inside) if self.inside else np.nan
        return (
            f"{self.fits:>6}{self.converged:>11}{len(self.inside or []):>11}{covered:>9.1f} %"
            f"{self.worst:>9.1f}{self.open:>7}"
        )


HEADING = f"{'fits':>6}{'converged':>11}{'intervals':>11}{'covered':>11}{'worst z':>9}{'open':>7}"


def study_errors(structures: int, first: int, starts: int | None) -> None:
    """Print coverage by kind of error, of fits that converged."""
    tallies = {error: Tally() for error in (*ERRORS, "all but clean")}
    for seed in range(first, first + structures):
        try:
            trial = fit(seed, starts)
        except UpdynError as error:
            print(f"{seed}: {error}")
            continue
        tallies[trial.error].add(trial)
        if trial.error != "clean":
            tallies["all but clean"].add(trial)
    print(f"{'':<28}{HEADING}")
    for error, tally in tallies.items():
        print(f"{error:<28}{tally}")


def study_few(draws: int, lines: list[int]) -> None:
    """Print coverage by lines, channels and noise, of fits that converged."""
    print(f"{'lines':>6}{'channels':>9}{'relative':>9}{'floor':>7}{HEADING}")
    for n in lines:
        for channels, (rows, columns) in enumerate(CHANNELS):
            number = len(rows) * len(columns)
            if 2 * n * number < 8:  # two more than unknowns
                continue
            for relative, floor in NOISES:
                tally = Tally()
                for draw in range(draws):
                    tally.add(few(n, channels, relative, floor, draw))
                print(f"{n:>6}{number:>9}{relative:>9g}{floor:>7g}{tally}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("study", choices=("errors", "few"))
    parser.add_argument("--structures", type=int, default=66)
    parser.add_argument("--first", type=int, default=0, help="seed of the first structure")
    parser.add_argument("--starts", type=int, help="tries of the search; the default ones without")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--lines", default="4,6,8,12,20,40")
    args = parser.parse_args()
    if args.study == "errors":
        study_errors(args.structures, args.first, args.starts)
    else:
        study_few(args.draws, [int(n) for n in args.lines.split(",")])


if __name__ == "__main__":
    main()
