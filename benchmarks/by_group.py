"""Bases made group by group beside those of the reduced tier: error wherever the unknowns go.

The unknowns scale whole groups. What a group does inside, between DOFs that it shares with others,
is therefore the same at every state but for a shift of its frequency: its constraint modes and its
modes with a fixed interface (Craig & Bampton, AIAA J. 6 (1968) 1313; for updating Papadimitriou &
Papadioti, Comput. Struct. 126 (2013) 15) do not change. Compared, for stiffness and mass of all
groups off by factors of up to exp(`--away`), loss factors of 0 to 0.3:

- start: that of a fit, rational Krylov vectors of the start;
- start and n points: with vectors of one factorisation at each of n states;
- search: that of a search, of up to 24 points, compressed by fields of 40 states;
- Craig-Bampton r: all constraint modes, and the fixed-interface modes up to r times the band;
- the same with characteristic constraint modes (Castanier, Tan & Pierre, AIAA J. 39 (2001) 1182) of
  eight states, up to four times the band, in place of all;
- split t: the vectors of the start cut at the interfaces. Fields of 16 states in the basis of the
  start, their part on each interface and what is left inside each group are reduced on their own
  (proper orthogonal decomposition, what is below a share t of all dropped), and the interfaces'
  vectors extended into the groups statically.

Processor time in real factorisations of the model, that of the start included where it is used; of
an evaluation, all lines at one state; the error of a receptance over the largest of its line.

    OMP_NUM_THREADS=1 python benchmarks/by_group.py [--models solid:3x3x18:6,frame:4x19:12]
        [--sensors 12] [--away 1.0] [--states 6]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import models
import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as sla

import updyn
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import LineSolver, split_into_blocks
from updyn.dynamics.reduction import Reduction
from updyn.linalg.solver import Factorised, SparseSolver, check_backend

MODELS = (
    "solid:3x3x18:6,solid:4x4x27:6,solid:12x12x20:6,solid:12x12x20:20,frame:4x19:4,frame:4x19:12"
)
LINES, REFERENCES, LOSSY = 60, 2, 0.3
#: Lines of a state at which errors are computed.
CHECKED = 8
#: Largest number of vectors of a basis that is compared, and of DOFs between groups whose
#: characteristic constraint modes are sought.
MOST, MOST_BETWEEN = 800, 3200


def structure(name: str) -> updyn.Model:
    kind, size, parts = name.split(":")
    if kind == "solid":
        x, y, z = map(int, size.split("x"))
        return models.solid((x, y, z), parts=int(parts))
    spans, bays = map(int, size.split("x"))
    return models.footbridge(spans, bays, pieces=int(parts))


def drawn(system: AffineSystem, number: int, away: float, seed: int) -> list[State]:
    """States with every factor and loss factor drawn."""
    rng = np.random.default_rng(seed)
    names = [t.group for t in system.terms]
    stiff = np.array([t.quantity == "stiffness" for t in system.terms])
    states = []
    for _ in range(number):
        loss = {group: rng.uniform(0.0, LOSSY) for group in dict.fromkeys(names)}
        states.append(
            replace(
                system.start,
                factor=np.exp(rng.uniform(-away, away, len(names))),
                loss=np.where(stiff, [loss[group] for group in names], 0.0),
            )
        )
    return states


@dataclass(frozen=True)
class Group:
    """One group: its DOFs inside, those it shares, and its matrices there."""

    inside: np.ndarray
    shared: np.ndarray
    K: sp.csc_array
    M: sp.csc_array
    coupling: sp.csr_array
    factorised: Factorised

    def extended(self, X: np.ndarray) -> None:
        """Write into the rows inside what the shared ones of X, shape (N, k), do statically."""
        X[self.inside] = -self.factorised.solve(
            np.asfortranarray(self.coupling @ X[self.shared], dtype=float)
        )

    def modes(self, square: float) -> np.ndarray:
        """Modes with a fixed interface, up to a squared circular frequency."""
        n = len(self.inside)
        if n <= 300:
            K, M = self.K.toarray(), self.M.toarray()
            return scipy.linalg.eigh(K, M, subset_by_value=(-np.inf, square))[1]
        solver = SparseSolver(check_backend(None), real=True)
        count = solver.factorise((self.K - square * self.M).tocsc(), 0.0).negative
        solver.release()
        if not count:
            return np.zeros((n, 0))
        inverse = sla.LinearOperator(
            (n, n), lambda b: self.factorised.solve(b.reshape(-1, 1)).ravel(), dtype=float
        )
        return sla.eigsh(self.K, count, self.M, sigma=0.0, OPinv=inverse, tol=1e-6)[1]


class Groups:
    """All groups of a model, and the DOFs between them by the groups that share them."""

    def __init__(self, system: AffineSystem, held: np.ndarray) -> None:
        """Those that are held count as shared."""
        names = list(dict.fromkeys(t.group for t in system.terms))
        member = np.zeros((len(names), system.n), dtype=bool)
        for t in system.terms:
            member[names.index(t.group), t.rows] = True
        shared = member.sum(axis=0) > 1
        places = defaultdict(list)
        for dof in np.flatnonzero(shared):
            places[tuple(np.flatnonzero(member[:, dof]))].append(dof)
        shared[held] = True
        self.system = system
        self.shared = np.flatnonzero(shared)
        self.interfaces = [np.array(dofs) for dofs in places.values()]
        self.groups = []
        for name, own in zip(names, member, strict=True):
            inside, between = np.flatnonzero(own & ~shared), np.flatnonzero(own & shared)
            if not len(inside):
                continue
            K, M = (self._matrix(name, quantity) for quantity in ("stiffness", "mass"))
            alone = SparseSolver(check_backend(None), real=True)
            factorised = alone.factorise(K[inside][:, inside].tocsc(), 0.0)
            inner = K[inside][:, inside].tocsc(), M[inside][:, inside].tocsc()
            self.groups.append(Group(inside, between, *inner, K[inside][:, between], factorised))

    def _matrix(self, group: str, quantity: str) -> sp.csr_array:
        n, parts = self.system.n, []
        for t in self.system.terms:
            if (t.group, t.quantity) == (group, quantity):
                local = sp.coo_array(t.local)
                at = t.rows[local.row], t.rows[local.col]
                parts.append(sp.csr_array((local.data, at), shape=(n, n)))
        return sum(parts, sp.csr_array((n, n)))

    def extended(self, dofs: np.ndarray, W: np.ndarray) -> np.ndarray:
        """Vectors W, shape (k, m), of some shared DOFs, extended into all groups."""
        X = np.zeros((self.system.n, W.shape[1]))
        X[dofs] = W
        for group in self.groups:
            if np.intersect1d(group.shared, dofs).size:
                group.extended(X)
        return X

    def inner(self, group: Group, W: np.ndarray) -> np.ndarray:
        """Vectors inside one group, as vectors of the whole model."""
        X = np.zeros((self.system.n, W.shape[1]))
        X[group.inside] = W
        return X


def craig_bampton(groups: Groups, weight: np.ndarray, square: float, W: np.ndarray) -> Basis:
    """Fixed-interface modes up to a square, and vectors W of the shared DOFs, extended."""
    basis = Basis(groups.system, weight)
    for group in groups.groups:
        modes = group.modes(square)
        if modes.shape[1]:
            basis.append(groups.inner(group, modes))
    basis.append(groups.extended(groups.shared, W))
    return basis


def characteristic(groups: Groups, states: list[State], square: float) -> np.ndarray:
    """Modes of the statically condensed model at some states, without near copies."""
    system = groups.system
    constraint = Basis(system, np.ones(system.n))
    constraint.extend(groups.extended(groups.shared, np.eye(len(groups.shared))))
    quantity = np.array([t.quantity for t in system.terms])
    found = []
    for state in states:
        K, M = (
            constraint.weighted_sum((quantity == q) * state.factor) for q in ("stiffness", "mass")
        )
        found.append(scipy.linalg.eigh(K, M, subset_by_value=(-np.inf, square))[1])
    modes = np.hstack(found)
    return modes / np.linalg.norm(modes, axis=0)


def split(groups: Groups, basis: Basis, fields: np.ndarray, share: float) -> Basis:
    """The vectors of a basis cut at the interfaces, as far as fields of it, (r, k), need them."""
    root = np.linalg.qr(fields.T, mode="r").T
    F, weight = basis.expand(root), basis.weight
    least = share * np.linalg.norm(F * weight[:, None])

    def kept(part: np.ndarray, scale: np.ndarray) -> np.ndarray:
        U, size, _ = np.linalg.svd(part * scale[:, None], full_matrices=False)
        return U[:, size > least] / scale[:, None]

    out = Basis(groups.system, weight)
    for dofs in groups.interfaces:
        out.append(groups.extended(dofs, kept(F[dofs], weight[dofs])))
    static = np.zeros_like(F)
    static[groups.shared] = F[groups.shared]
    for group in groups.groups:
        group.extended(static)
        left = kept((F - static)[group.inside], weight[group.inside])
        if left.shape[1]:
            out.append(groups.inner(group, left))
    return out


def fields_of(reduction: Reduction, states: list[State], freq: np.ndarray) -> np.ndarray:
    """Coordinates of fields of a few lines of each state, of unit length, real parts and others."""
    solver, parts = reduction.solver(), []
    loaded = np.union1d(reduction.rows, reduction.columns)
    stride = max(1, len(freq) // 12)
    for number, state in enumerate(states):
        lines = freq[number % stride :: stride]
        q = solver.solve(solver.system.coefficients(state, 2 * np.pi * lines), loaded, lines)
        q = q.reshape(len(q), -1)
        q = q / np.linalg.norm(q, axis=0)
        parts += [q.real, q.imag]
    return np.hstack(parts)


@dataclass(frozen=True)
class Case:
    """A model, its channels, and receptances by direct solves at states far off."""

    reduction: Reduction
    freq: np.ndarray
    tests: list[State]
    lines: np.ndarray
    exact: list[np.ndarray]
    unit: float

    @classmethod
    def of(cls, name: str, sensors: int, away: float, states: int) -> Case:
        model = structure(name)
        system = AffineSystem.compile(model)
        rows = model.dofs.match(models.sensors(model, sensors)).index
        found = updyn.modes(model, 8).frequency
        freq = np.linspace(0.4 * found[0], 1.05 * found[5], LINES)
        lines = freq[LINES // CHECKED // 2 :: LINES // CHECKED]
        columns, direct = rows[:REFERENCES], LineSolver.choose(system, "sparse")
        tests, exact = drawn(system, states, away, 5), []
        for state in tests:
            c = system.coefficients(state, 2 * np.pi * lines)
            solved = [
                direct.at(direct.solve(c[:, [i]], columns, lines[[i]]), rows)[:, 0]
                for i in range(len(lines))
            ]
            exact.append(np.array(solved))
        band = float(freq[0]), float(freq[-1])
        reduction = Reduction(system, rows, columns, band, check_backend(None))
        P, times = reduction.shifted.matrix(system.start, -reduction.shifted.top), []
        for _ in range(4):  # the first analyses the pattern
            begun = time.process_time()
            reduction.shifted._solver.factorise(P, 0.0)
            times.append(time.process_time() - begun)
        return cls(reduction, freq, tests, lines, exact, float(np.median(times[1:])))

    def errors(self) -> list[float]:
        """The largest error of each state in the basis that the reduction has."""
        solver, found = self.reduction.solver(), []
        for state, H in zip(self.tests, self.exact, strict=True):
            c = solver.system.coefficients(state, 2 * np.pi * self.lines)
            q = solver.solve(c, self.reduction.columns, self.lines)
            change = np.abs(solver.at(q, self.reduction.rows).transpose(1, 0, 2) - H)
            found.append((change.max(axis=(1, 2)) / np.abs(H).max(axis=(1, 2))).max())
        return found

    def evaluation(self) -> float:
        """Processor time of all lines and loads at one state, in s."""
        solver, loaded = self.reduction.solver(), self.reduction._loaded_dofs
        begun = time.process_time()
        for state in self.tests[:2]:
            pencil = solver.pencil(state, self.freq)
            for block in split_into_blocks(len(self.freq), solver.block_size(len(loaded))):
                c = solver.system.coefficients(state, 2 * np.pi * self.freq[block])
                solver.solve(c, loaded, self.freq[block], pencil)
        return (time.process_time() - begun) / 2

    def bases(self, away: float) -> Iterator[tuple[str, Callable[[], Basis | None]]]:
        """Yield every kind of basis: its name, and what makes it."""
        red, freq = self.reduction, self.freq
        system, start = red.system, red.system.start
        points, samples = drawn(system, 24, away, 6), drawn(system, 40, away, 7)
        diagonal = red.shifted.matrix(start, -red.shifted.top).diagonal()
        weight = np.sqrt(np.maximum(diagonal, 1e-16 * diagonal.max()))

        def near(number: int) -> Basis:
            red.build(start)
            red.extend(points[:number])
            return red.basis

        def search() -> Basis:
            near(min(24, max(8, 2 * len(system.terms))))
            red.compress_around([start, *samples], freq, 1e-4)
            return red.basis

        def fixed(reach: float, states: int = 0) -> Basis | None:
            groups = Groups(system, red._loaded_dofs)
            if len(groups.shared) > (MOST_BETWEEN if states else MOST):
                return None
            W = np.eye(len(groups.shared))
            if states:
                W = characteristic(groups, [start, *points[: states - 1]], 16.0 * red.shifted.top)
                U, size, _ = np.linalg.svd(weight[groups.shared, None] * W, full_matrices=False)
                W = U[:, size > 1e-3 * size[0]] / weight[groups.shared, None]
            return craig_bampton(groups, weight, reach**2 * red.shifted.top, W)

        def cut(share: float) -> Basis:
            before = near(0)
            fields = fields_of(red, [start, *samples[:16]], freq)
            return split(Groups(system, np.zeros(0, dtype=int)), before, fields, share)

        yield "start", lambda: near(0)
        yield "start and 4 points", lambda: near(4)
        yield "start and 8 points", lambda: near(8)
        yield "search", search
        yield "Craig-Bampton 2", lambda: fixed(2.0)
        yield "Craig-Bampton 4", lambda: fixed(4.0)
        yield "Craig-Bampton 4, characteristic", lambda: fixed(4.0, 8)
        yield "split 1e-3", lambda: cut(1e-3)
        yield "split 1e-4", lambda: cut(1e-4)
        yield "split 1e-5", lambda: cut(1e-5)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", default=MODELS)
    parser.add_argument("--sensors", type=int, default=12)
    parser.add_argument("--away", type=float, default=1.0)
    parser.add_argument("--states", type=int, default=6)
    given = parser.parse_args()
    for name in given.models.split(","):
        case = Case.of(name, given.sensors, given.away, given.states)
        system = case.reduction.system
        between = len(Groups(system, np.zeros(0, dtype=int)).shared)
        print(
            f"\n{name}: {system.n} DOFs, {between} of them between groups,"
            f" a real factorisation {1e3 * case.unit:.1f} ms\n\n"
            "| basis | vectors | made | evaluation | error, median state | worst state |\n"
            "|---|---|---|---|---|---|"
        )
        for kind, make in case.bases(given.away):
            begun = time.process_time()
            basis = make()
            seconds = time.process_time() - begun
            if basis is None or basis.size > MOST:
                print(f"| {kind} | left out | | | | |", flush=True)
                continue
            case.reduction.basis = basis
            errors = case.errors()
            print(
                f"| {kind} | {basis.size} | {seconds / case.unit:.0f}"
                f" | {case.evaluation() / case.unit:.1f} | {np.median(errors):.0e}"
                f" | {max(errors):.0e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
