"""Periodic responses of models with nonlinear elements: errors, stability and cost.

Errors against closed results (one harmonic), against time integration (DOP853), and against the
equations of pyHarm (`pip install pyHarm-os`; skipped if it is not installed), which solves all
degrees of freedom instead of the deformations of elements. The first structure is the second
example of NLvib (Krack & Gross, Harmonic Balance for Nonlinear Vibration Problems, 2019), with a
quasi-periodic range: unstable exponents are counted there by Floquet multipliers, too. Cost of a
level of 200 lines of a solid over that of its linear FRFs. Linear structures that are reported
nonlinear from noisy FRFs at several levels. FRFs under a random force against simulated tests.

    OMP_NUM_THREADS=1 python benchmarks/nonlinear.py [PART ...]

with the parts closed, time, stability, pyharm, cost, linear and random.
"""

from __future__ import annotations

import importlib.util
import logging
import sys
import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import models
import numpy as np
from scipy.integrate import solve_ivp

import updyn
from updyn.dynamics.periodic.response import Branch
from updyn.nonlinear.element import NonlinearElement

Element = tuple[NonlinearElement, list[int]]


@dataclass(frozen=True)
class Structure:
    """Masses in a chain with viscous or structural damping, elements, and a force at one mass."""

    name: str
    M: np.ndarray
    K: np.ndarray
    C: np.ndarray
    loss: float
    elements: list[Element]
    forced: int
    level: float
    freq: np.ndarray
    harmonics: int

    @property
    def labels(self) -> list[str]:
        return [f"{i + 1}:X" for i in range(len(self.M))]

    def model(self) -> updyn.Model:
        viscous = self.C if self.C.any() else None
        groups = {
            "springs": updyn.Group(self.K, loss_factor=self.loss),
            "masses": updyn.Group(mass=self.M, viscous=viscous),
        }
        model = updyn.Model.from_groups(groups, self.labels)
        elements = {
            f"element {number}": (element, [self.labels[i] for i in ends])
            for number, (element, ends) in enumerate(self.elements)
        }
        return model.with_elements(elements)

    def respond(self, **options) -> updyn.PeriodicResponse:
        options = {"harmonics": self.harmonics, **options}
        return updyn.response(
            self.model(),
            self.freq,
            self.labels,
            [self.labels[self.forced]],
            level=self.level,
            **options,
        )

    def column(self, ends: list[int]) -> np.ndarray:
        w = np.zeros(len(self.M))
        w[ends] = [1.0, -1.0][: len(ends)]
        return w


def chain(springs: list[float]) -> np.ndarray:
    """Stiffness of masses between springs, the first and the last of them held."""
    k = np.array(springs)
    return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)


def structures() -> list[Structure]:
    two = Structure(
        "NLvib 2: two masses, two cubic springs",
        np.diag([1.0, 0.05]),
        chain([1.0, 0.0453, 0.0]),
        chain([0.002, 0.013, 0.0]),
        0.0,
        [(updyn.CubicSpring(1.0), [0]), (updyn.CubicSpring(0.0042), [0, 1])],
        0,
        0.11,
        np.linspace(0.8, 1.4, 40) / (2 * np.pi),
        7,
    )
    three = Structure(
        "three masses, two Jenkins elements, two cubic springs",
        np.eye(3),
        chain([1.0] * 4),
        chain([0.02] * 4),
        0.0,
        [
            (updyn.JenkinsElement(20.0, 1.0), [0]),
            (updyn.JenkinsElement(20.0, 1.0), [1, 0]),
            (updyn.CubicSpring(1.0), [1]),
            (updyn.CubicSpring(1.0), [2, 1]),
        ],
        1,
        1.0,
        np.linspace(0.5, 2.0, 40) / (2 * np.pi),
        7,
    )
    ten = Structure(
        "ten masses, loss factor 0.05, a gap",
        np.eye(10),
        chain([100.0] * 10 + [0.0]),
        np.zeros((10, 10)),
        0.05,
        [(updyn.Backlash(60.0, gap=0.02), [9])],
        5,
        1.0,
        np.linspace(0.15, 0.7, 40),
        9,
    )
    shafts = np.zeros((4, 4))
    shafts[:2, :2], shafts[2:, 2:] = 400.0 * chain([0.0, 1.0, 0.0]), 900.0 * chain([0.0, 1.0, 0.0])
    free = Structure(
        "four inertias free to turn, a gap between two of them",
        np.diag([2.0, 1.0, 1.5, 4.0]),
        shafts,
        0.004 * shafts + np.diag([0.8, 0.0, 0.0, 1.5]),
        0.0,
        [(updyn.Backlash(700.0, gap=0.02), [1, 2])],
        0,
        6.0,
        np.linspace(1.4, 6.0, 40),
        9,
    )
    return [two, three, ten, free]


# -- closed results ---------------------------------------------------------------------------
def closed() -> None:
    """One harmonic of one mass against the describing function of each element."""
    print("\nOne harmonic against describing functions: largest error of the force balance")
    elements: dict[str, NonlinearElement] = {
        "cubic spring": updyn.CubicSpring(0.5),
        "polynomial": updyn.PolynomialSpring({3: 0.5, 5: -0.02}),
        "dead zone": updyn.Backlash(3.0, gap=0.8),
        "Jenkins": updyn.JenkinsElement(0.5, slip_force=0.2),
        "Iwan": updyn.IwanJoint(5.0, 0.5, -0.5, 0.1),
        "quadratic damper": updyn.QuadraticDamper(0.2),
    }
    for samples in (512, 4096):
        errors = []
        for element in elements.values():
            one = Structure(
                "",
                np.eye(1),
                np.eye(1),
                np.zeros((1, 1)),
                0.1,
                [(element, [0])],
                0,
                0.5,
                np.linspace(0.6, 1.8, 30) / (2 * np.pi),
                1,
            )
            found = one.respond(samples=samples)
            worst = 0.0
            for f, H in zip(found.freq, found.values[:, 0, 0], strict=True):
                omega, A = 2 * np.pi * f, 0.5 * abs(H)
                N = complex(element.describing(A, omega))
                if element.quantity == "mobility":
                    N = 1j * omega * complex(element.describing(A * omega, omega))
                worst = max(worst, abs((1.0 + 0.1j - omega**2 + N) * H - 1.0))
            errors.append(worst)
        text = ", ".join(f"{n} {e:.1g}" for n, e in zip(elements, errors, strict=True))
        print(f"  {samples:5d} samples: {text}")


# -- time integration ---------------------------------------------------------------------------
def force_of(structure: Structure, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Force of the elements without memory on the masses, against the motion."""
    out = np.zeros(len(q))
    for element, ends in structure.elements:
        w = structure.column(ends)
        out += w * element.over_period(np.array([w @ q]), np.array([w @ v])).force[0]
    return out


def over_time() -> None:
    """A period of the two cubic springs by DOP853, by number of harmonics."""
    structure = structures()[0]
    print(f"\n{structure.name}: largest error of a period, over its largest displacement")
    n, M, C, K = len(structure.M), structure.M, structure.C, structure.K
    for harmonics in (3, 5, 7, 11, 15):
        found = structure.respond(harmonics=harmonics)
        errors, k = [], np.arange(harmonics + 1)[:, None]
        for line in range(0, 40, 6):
            omega, A = 2 * np.pi * found.freq[line], found.harmonics[line, :, :, 0]

            def slope(t: float, y: np.ndarray, omega: float = omega) -> np.ndarray:
                F = -K @ y[:n] - C @ y[n:] - force_of(structure, y[:n], y[n:])
                F[structure.forced] += structure.level * np.cos(omega * t)
                return np.append(y[n:], np.linalg.solve(M, F))

            start = np.append(A.sum(0).real, (1j * k * omega * A).sum(0).real)
            times = 2 * np.pi / omega * np.arange(64) / 64
            flow = solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-14)
            series = np.real(A.T @ np.exp(1j * k * omega * times))
            errors.append(np.abs(flow.y[:n] - series).max() / np.abs(series).max())
        truncation = found.truncation[::6].max()
        print(f"  {harmonics:2d} harmonics: {max(errors):.1e}, estimated {truncation:.1e}")


# -- stability ----------------------------------------------------------------------------------
def multipliers(structure: Structure, branch: Branch, point: int) -> np.ndarray:
    """Floquet multipliers at a point of a branch, for elements without memory."""
    n, M, C, K = len(structure.M), structure.M, structure.C, structure.K
    omega, A = 2 * np.pi * branch.freq[point], branch.harmonics[point]
    k = np.arange(len(A))

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        q, (p, v) = np.real(np.exp(1j * k * omega * t) @ A), y.reshape(2, n, -1)
        pull = K @ p + C @ v
        for element, ends in structure.elements:
            w = structure.column(ends)
            force = element.over_period(np.array([w @ q]), np.zeros(1))
            pull += force.stiffness.data[0] * np.outer(w, w @ p)
        return np.append(v, -np.linalg.solve(M, pull))

    flow = solve_ivp(slope, (0, 2 * np.pi / omega), np.eye(2 * n).ravel(), rtol=1e-8, atol=1e-10)
    return np.linalg.eigvals(flow.y[:, -1].reshape(2 * n, 2 * n))


def stability() -> None:
    """Stability on the branch of the two cubic springs, against Floquet multipliers."""
    structure = structures()[0]
    (branch,) = structure.respond(harmonics=11).branches
    points, same, pairs = range(0, len(branch.freq), 5), 0, 0
    for point in points:
        found = multipliers(structure, branch, point)
        outside = found[np.abs(found) > 1.0]
        same += bool(len(outside) == 0) == bool(branch.stable[point])
        pairs += bool(np.any(np.abs(outside.imag) > 1e-6))
    print(f"\n{structure.name}: stability of {len(points)} points of the branch")
    print(f"  {same} as by Floquet multipliers; {pairs} with a complex pair beyond 1")


# -- pyHarm -------------------------------------------------------------------------------------
def connector(element: NonlinearElement, ends: list[int]) -> dict[str, object]:
    """An element in the input of pyHarm."""
    nodes = [("s", [i]) for i in ends] + [("GROUND", [0])] * (2 - len(ends))
    at = {"connect": nodes, "dirs": [0]}
    if isinstance(element, updyn.CubicSpring):
        return {**at, "type": "CubicSpring", "k": element.coefficient}
    if isinstance(element, updyn.JenkinsElement):
        slip = element.slip_force
        return {**at, "type": "Jenkins", "k": element.stiffness, "mu": 1.0, "N0": slip}
    assert isinstance(element, updyn.Backlash)
    return {**at, "type": "PenaltyBilateralGap", "k": element.stiffness, "g": element.half}


def pyharm() -> None:
    """The balance of all degrees of freedom by pyHarm, solved near updyn's result."""
    if importlib.util.find_spec("pyHarm") is None:
        print("\npyHarm is not installed: pip install pyHarm-os")
        return
    from pyHarm.Maestro import Maestro

    logging.disable(logging.CRITICAL)
    print("\nAgainst pyHarm with 512 samples: largest difference of a line, over its largest one")
    for structure in structures():
        n, h = len(structure.M), structure.harmonics
        connectors = {
            "force": {
                "type": "CosinusForcing",
                "connect": {"s": [structure.forced]},
                "dirs": [0],
                "amp": structure.level,
            },
            **{f"e{i}": connector(*given) for i, given in enumerate(structure.elements)},
        }
        if structure.loss:
            connectors["loss"] = {
                "type": "linear_hysteretic",
                "connect": "s",
                "matrix": structure.loss * structure.K,
            }
        matrices = {"M": structure.M, "K": structure.K, "C": structure.C}
        system = Maestro(
            {
                "analysis": {},
                "system": {"type": "Base", "nh": h, "nti": 512, "adim": {"status": False}},
                "substructures": {"s": {"matrix": matrices, "ndofs": 1}},
                "connectors": connectors,
            }
        ).system
        found = structure.respond(samples=512)
        errors = []
        for line in range(0, 40, 4):
            omega, A = 2 * np.pi * found.freq[line], found.harmonics[line, :, :, 0]
            x = np.concatenate([A[0].real, *(np.append(a.real, -a.imag) for a in A[1:])])

            def residual(q: np.ndarray, system=system, omega: float = omega) -> np.ndarray:
                return system.Residual(np.append(q, omega))

            def jacobian(q: np.ndarray, system=system, omega: float = omega) -> np.ndarray:
                return system.Jacobian(np.append(q, omega))[0]

            solved = 1.001 * x
            for _ in range(30):  # the mean of a free structure is undetermined: the shortest step
                step = np.linalg.lstsq(jacobian(solved), -residual(solved), rcond=1e-12)[0]
                solved = solved + step
            errors.append(np.abs(solved - x).max() / np.abs(x).max())
        unknowns = len(structure.elements) * (2 * h + 1)
        print(
            f"  {structure.name}: {max(errors):.1e}; unknowns {unknowns}, pyHarm {n * (2 * h + 1)}"
        )


# -- cost ---------------------------------------------------------------------------------------
def processor(work) -> tuple[Any, float]:
    begun = time.process_time()
    return work(), time.process_time() - begun


def cost() -> None:
    """A level of 200 lines of a solid of 9,900 DOFs, over linear FRFs of the same lines."""
    true = models.solid((9, 9, 33), parts=6)
    at = models.sensors(true, 4)
    natural = updyn.modes(true, 5).frequency
    freq = np.linspace(0.5 * natural[0], 1.05 * natural[4], 200)
    linear, exact = processor(lambda: updyn.response(true, freq, at, at[:1]))
    _, reduced = processor(lambda: updyn.response(true, freq, at, at[:1], tier="reduced"))
    print(f"\n{true.n_dofs} DOFs, 200 lines over five modes: linear FRFs {exact:.1f} s exact,")
    print(f"  {reduced:.1f} s by a reduced model")
    size = np.abs(linear.values[:, 0, 0])
    end = str(abs(updyn.DofSet(at)[0]))
    k = 0.3 / np.median(size)
    elements = {
        "cubic spring": updyn.CubicSpring(k / size.max() ** 2),
        "gap": updyn.Backlash(k, gap=0.2 * size.max()),
        "Iwan joint": updyn.IwanJoint(0.1 * k * size.max(), k, -0.5, 0.1),
    }
    for name, element in elements.items():
        model = true.with_elements({"element": (element, end)})
        found, seconds = processor(
            lambda model=model: updyn.response(model, freq, at, at[:1], level=1.0)
        )
        change = np.abs(found.values - linear.values).max() / np.abs(linear.values).max()
        print(
            f"  {name}: {seconds:.1f} s, {seconds / exact:.2f} of the exact and"
            f" {seconds / reduced:.1f} of the reduced FRFs; {len(found.branches[0].freq)} points,"
            f" truncation {found.truncation.max():.0e}, change of the FRF {100 * change:.0f} %"
        )
        print(f"    {found.source}")


# -- detection ----------------------------------------------------------------------------------
def with_noise(
    frf: updyn.FRF, rng: np.random.Generator, relative: float, floor: float, common: float = 0.0
) -> updyn.FRF:
    """FRFs with noise relative to |H|, a floor, and noise of the force, common to responses."""

    def draw(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    H = frf.values
    channel = np.exp(rng.normal(0.0, 0.7, (1, *H.shape[1:])))
    floors = floor * np.sqrt(np.mean(np.abs(H) ** 2)) * channel
    values = H * (1.0 + relative * draw(*H.shape)) + floors * draw(*H.shape)
    return replace(frf, values=values * (1.0 + common * draw(len(H), 1, H.shape[2])))


def count_alarms(seeds: range) -> tuple[int, int]:
    """Linear structures reported nonlinear from two or three levels, and from one level."""
    several, single = [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 9))
        springs = [*(1e4 * np.exp(rng.normal(0.0, 0.5, n))), float(rng.choice([0.0, 1e4]))]
        labels = [f"{i + 1}:X" for i in range(n)]
        groups = {
            "springs": updyn.Group(chain(springs), loss_factor=float(rng.uniform(0.005, 0.06))),
            "masses": updyn.Group(mass=np.diag(np.exp(rng.normal(0.0, 0.4, n)))),
        }
        model = updyn.Model.from_groups(groups, labels)
        natural = updyn.modes(model, n).frequency
        freq = np.linspace(0.5 * natural[0], 1.2 * natural[min(n - 1, 5)], rng.integers(150, 500))
        at = rng.choice(labels, size=int(rng.integers(1, min(n, 6) + 1)), replace=False)
        quantity = str(rng.choice(["receptance", "accelerance"]))
        clean = updyn.response(model, freq, list(at), [str(rng.choice(labels))], quantity)
        relative, floor = 10 ** rng.uniform(-3, -1.5), 10 ** rng.uniform(-4.5, -2)
        common = float(rng.choice([0.0, relative]))
        tests = [
            with_noise(clean, rng, relative, floor, common).with_level(3.0**level)
            for level in range(int(rng.integers(2, 4)))
        ]
        several.append(updyn.detect_nonlinearity(tests).is_nonlinear)
        single.append(updyn.detect_nonlinearity(tests[0]).is_nonlinear)
    return sum(several), sum(single)


def linear() -> None:
    """200 chains of 2 to 8 masses with noise of different kinds, at two or three levels."""
    several, single = count_alarms(range(200))
    print(f"\n200 linear structures: {several} reported nonlinear from two or three levels,")
    print(f"  {single} from one level")


# -- random force -------------------------------------------------------------------------------
def simulate_random(
    structure: Structure, realisations: int, steps: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """FRFs of random-phase multisines, (n_f, n), their standard errors, and the rms of motions.

    The lines are those of the structure, multiples of their distance, whose inverse is the period.
    The third period is evaluated.
    """
    rng, freq = np.random.default_rng(seed), structure.freq
    spacing = freq[1] - freq[0]
    n, half = len(structure.M), 1.0 / spacing / steps / 2.0
    # Lines at the ends of the band belong to half of their interval.
    share = np.full(len(freq), 1.0)
    share[[0, -1]] = 0.5
    amplitude = structure.level * np.sqrt(2.0 * share / (len(freq) - 1))
    spectrum = np.zeros((realisations, steps + 1), dtype=np.complex128)
    at = np.rint(freq / spacing).astype(int)
    spectrum[:, at] = amplitude * np.exp(2j * np.pi * rng.random((realisations, len(at))))
    force = np.fft.irfft(spectrum, 2 * steps) * steps
    inverse, pull = np.diag(1.0 / np.diag(structure.M)), np.zeros(n)
    pull[structure.forced] = 1.0
    columns = [(element, structure.column(ends)) for element, ends in structure.elements]

    def slope(y: np.ndarray, F: np.ndarray) -> np.ndarray:
        q, v = y[:, :n], y[:, n:]
        f = F[:, None] * pull - q @ structure.K - v @ structure.C
        for element, w in columns:
            f -= element.over_period(q @ w, v @ w).force[:, None] * w
        return np.hstack([v, f @ inverse])

    y = np.zeros((realisations, 2 * n))
    motion = np.empty((steps, realisations, n))
    for i in range(3 * steps):
        at_i = 2 * (i % steps)
        a, b, c = force[:, at_i], force[:, at_i + 1], force[:, (at_i + 2) % (2 * steps)]
        motion[i % steps] = y[:, :n]
        k1 = slope(y, a)
        k2 = slope(y + half * k1, b)
        k3 = slope(y + half * k2, b)
        k4 = slope(y + 2.0 * half * k3, c)
        y = y + half / 3.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    H = 2.0 / steps * np.fft.fft(motion, axis=0)[at] / spectrum[:, at].T[:, :, None]
    error = H.std(axis=1) / np.sqrt(realisations - 1)
    return H.mean(axis=1), error, motion.std(axis=(0, 1))


def random_structures() -> list[Structure]:
    """One mass, and a chain of three, with elements under a random force."""
    freq = np.arange(4, 160) / 314.0
    viscous, springs = 0.1 * np.eye(1), chain([1.0] * 4)

    def one(name: str, element: NonlinearElement) -> Structure:
        return Structure(
            name, np.eye(1), np.eye(1), viscous, 0.0, [(element, [0])], 0, 0.4, freq, 7
        )

    def three(name: str, c: float, k: float) -> Structure:
        elements: list[Element] = [
            (updyn.CubicSpring(c), [0]),
            (updyn.Backlash(k, gap=0.5), [1, 2]),
        ]
        C = 0.05 * np.eye(3) + 0.02 * springs
        return Structure(name, np.eye(3), springs, C, 0.0, elements, 0, 0.4, freq, 7)

    return [
        one("cubic spring 0.02", updyn.CubicSpring(0.02)),
        one("cubic spring 0.3", updyn.CubicSpring(0.3)),
        one("dead zone 0.3", updyn.Backlash(0.3, gap=1.0)),
        one("dead zone 3", updyn.Backlash(3.0, gap=1.0)),
        one("friction 0.05", updyn.CoulombFriction(0.05, transition=0.05)),
        one("friction 0.2", updyn.CoulombFriction(0.2, transition=0.05)),
        one("quadratic damper 0.1", updyn.QuadraticDamper(0.1)),
        three("chain, cubic spring 0.1 and gap 0.1", 0.1, 0.1),
        three("chain, cubic spring 1 and gap 1", 1.0, 1.0),
    ]


def over_random() -> None:
    """H1 of simulated random tests against statistical linearisation."""
    print("\nRandom force: simulated tests against statistical linearisation")
    for case in random_structures():
        freq = case.freq
        H, error, rms = simulate_random(case, realisations=100, steps=4000, seed=1)
        labels, forced = case.labels, [case.labels[case.forced]]
        options = {"level": case.level, "excitation": "random"}
        found = updyn.response(case.model(), freq, labels, forced, **options).values[..., 0]
        bare = replace(case, elements=[]).model()
        alone = updyn.response(bare, freq, labels, forced).values[..., 0]
        size = np.linalg.norm(H)
        share = np.ones(len(freq))
        share[[0, -1]] = 0.5
        density = case.level**2 / (len(freq) - 1) * share
        ratio = np.sqrt(density @ np.abs(found) ** 2) / rms
        peak = np.abs(found).max() / np.abs(H).max()
        print(
            f"  {case.name}: change {np.linalg.norm(alone - H) / size:.0%}, difference"
            f" {np.linalg.norm(found - H) / size:.1%}, statistical error"
            f" {np.linalg.norm(error) / size:.1%}, peak {peak:.2f}, rms {ratio.round(3)}"
        )


def over_fits() -> None:
    """Updates of springs, damping and elements to simulated random tests at two levels."""
    print("\nRandom force: updates to simulated tests, starts off by a factor of 1.2 and of 3")
    for case in random_structures():
        tests = []
        for share in (0.5, 1.0):
            level = share * case.level
            H, error, _ = simulate_random(replace(case, level=level), 100, 4000, seed=2)
            tests.append(
                updyn.FRF(
                    case.freq,
                    H[:, :, None],
                    case.labels,
                    [case.labels[case.forced]],
                    "receptance",
                    variance=error[:, :, None] ** 2,
                    averages=100,
                    level=level,
                    excitation="random",
                )
            )
        true = case.model()
        names = {
            name: ("coefficient" if hasattr(local.element, "coefficient") else "stiffness")
            if hasattr(local.element, "stiffness") or hasattr(local.element, "coefficient")
            else "level"
            for name, local in true.nonlinear.items()
        }
        off = {
            name: {key: 3.0 * getattr(true.nonlinear[name].element, key)}
            for name, key in names.items()
        }
        start = true.scaled({"springs": {"stiffness": 1.2}, **off})
        unknowns = updyn.parameters(
            start,
            stiffness=["springs"],
            viscous=["masses"],
            nonlinear=[f"{name}.{key}" for name, key in names.items()],
        )
        found = updyn.update(start, tests, unknowns, starts=0)
        wanted = {p.name: p.start for p in unknowns} | {"springs.stiffness": 1.0 / 1.2}
        for name, key in names.items():
            wanted[f"{name}.{key}"] = float(getattr(true.nonlinear[name].element, key))
        ratios = ", ".join(
            f"{name} {value / wanted[name]:.3f} +- {found.std[name] / wanted[name]:.3f}"
            for name, value in found.values.items()
        )
        print(f"  {case.name}: {found.status}; {ratios}", flush=True)


def main() -> None:
    warnings.simplefilter("ignore")
    parts = {
        "closed": closed,
        "time": over_time,
        "stability": stability,
        "pyharm": pyharm,
        "cost": cost,
        "linear": linear,
        "random": over_random,
        "fitted": over_fits,
    }
    for name in sys.argv[1:] or parts:
        parts[name]()


if __name__ == "__main__":
    main()
