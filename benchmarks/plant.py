"""Error of plants over a band, by conversion of the damping, and their number of states.

Gear train of Bao, Wang & Cheng (2010), 12-DOF chain, antenna of `updyn demo antenna` with its
hidden values; one force, displacements and velocities. Every error is measured again, against
`updyn.response` on lines of the script's own (evenly and geometrically spaced, then closer around
every maximum), beside what the plant states. Side by side: the conversions of structural damping,
computed here once more from dense matrices; and the order against the tolerance, with the order
that balanced truncation of the whole plant needs for the same.

    OMP_NUM_THREADS=1 python benchmarks/plant.py [--cases chain,antenna] [--only-relative]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from cases import chain12, gear_train

import updyn
from updyn.control.complex_modes import FittedModes
from updyn.control.plant import Plant
from updyn.control.ports import as_ports
from updyn.control.space import Conversion, Matrices
from updyn.control.task import build_task
from updyn.demos.antenna import TRUTH
from updyn.demos.antenna_model import AZIMUTH, ELEVATION, antenna
from updyn.model import Model

TOLERANCES = (0.1, 0.05, 0.02, 0.01, 0.005)
QUANTITIES = {"receptance": "displacement", "mobility": "velocity"}
REFUSED = ("diagonal", "single-frequency")


@dataclass
class Bench:
    """A structure between a force and some motions, in a band."""

    name: str
    model: Model
    force: str
    motions: list[str]
    band: tuple[float, float]
    turning: tuple[str, ...] = ()  # held, they leave no rigid-body motion

    def exact(self, freq: np.ndarray) -> np.ndarray:
        """Displacements, by a factorisation a line; shape (n_f, n_y)."""
        return updyn.response(self.model, freq, self.motions, [self.force]).values[:, :, 0]

    @cached_property
    def lines(self) -> tuple[np.ndarray, np.ndarray]:
        """Lines and displacements, refined until neighbours of maxima agree with them to 0.5 %."""
        freq = np.unique(
            np.concatenate([np.linspace(*self.band, 377), np.geomspace(*self.band, 377)])
        )
        H = self.exact(freq)
        while True:
            size = np.abs(H) * freq[:, None] ** 2
            at = maxima(size)
            beside = np.minimum(size[at - 1], size[at + 1])
            steep = size[at] > 1.005 * beside
            high = size[at] > 0.01 * size.max(axis=0)
            rough = at[(steep & high & summits(size, at)).any(axis=1)]
            if not len(rough):
                break
            more = np.concatenate([np.linspace(freq[i - 1], freq[i + 1], 9)[1:-1] for i in rough])
            more = np.setdiff1d(more, freq)
            if not len(more):  # as close as numbers go
                break
            both = np.concatenate([freq, more])
            order = np.argsort(both)
            freq = both[order]
            H = np.concatenate([H, self.exact(more)])[order]
        return freq, H

    def values(self, quantity: str) -> np.ndarray:
        freq, H = self.lines
        return H if quantity == "receptance" else 2j * np.pi * freq[:, None] * H

    def error(self, G: np.ndarray, quantity: str) -> float:
        """Largest error of a channel as a share of its peak."""
        H = self.values(quantity)
        return float((np.abs(G - H) / np.abs(H).max(axis=0)).max())

    def peak_error(self, G: np.ndarray, quantity: str) -> float:
        """Largest error of a peak, of those of at least a tenth of the highest of its channel."""
        H, worst = np.abs(self.values(quantity)), 0.0
        weight = np.ones((len(self.lines[0]), 1))
        if self.turning:
            weight = self.lines[0][:, None] ** (2.0 if quantity == "receptance" else 1.0)
        for j in range(H.shape[1]):
            seen = (weight * H)[:, j]
            minima = np.flatnonzero((seen[1:-1] < seen[:-2]) & (seen[1:-1] < seen[2:])) + 1
            lows = np.concatenate([[0], minima, [len(seen) - 1]])
            for top in maxima(seen[:, None]):
                if seen[top] >= 0.1 * seen.max():
                    part = slice(lows[lows < top][-1], lows[lows > top][0] + 1)
                    worst = max(worst, abs(np.abs(G[part, j]).max() / H[part, j].max() - 1.0))
        return worst


def summits(size: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Which columns have a maximum at some positions."""
    return (size[at] > size[at - 1]) & (size[at] >= size[at + 1])


def maxima(size: np.ndarray) -> np.ndarray:
    """Positions of the inner maxima of any column."""
    return np.flatnonzero(summits(size, np.arange(1, len(size) - 1)).any(axis=1)) + 1


def benches() -> Iterator[Bench]:
    yield Bench(
        "gear train",
        gear_train().true,
        "2:RZ",
        ["1:RZ", "2:RZ", "3:RZ", "4:RZ"],
        (1 / np.pi, 500 / np.pi),
    )  # 2 to 1000 rad/s, as in the paper
    chain = chain12()
    low, high = float(chain.clean.freq[0]), float(chain.clean.freq[-1])
    yield Bench("chain", chain.true, "2:X", ["2:X", "7:X", "11:X"], (low, high))
    motors = tuple(f"{train['motor']}:RZ" for train in (AZIMUTH, ELEVATION))
    yield Bench(
        "antenna",
        antenna().scaled(TRUTH),
        motors[0],
        [motors[0], "3:RZ", "4:RZ"],
        (0.5, 60.0),
        motors,
    )


def of(bench: Bench, tolerance: float, quantity: str, **options: str) -> Plant:
    ports = [bench.force], bench.motions
    return updyn.plant(bench.model, *ports, bench.band, tolerance, quantity=quantity, **options)


RELATIVE = (0.1, 0.05, 0.03, 0.02, 0.01)


def relative(bench: Bench) -> None:
    """States by tolerance on the relative error, by route; "-" where none holds it.

    Beside them those of a balanced truncation of the complex modes.
    """
    for quantity, word in QUANTITIES.items():
        for route in ("modal", "complex", "rational", "auto"):
            cells = []
            for tolerance in RELATIVE:
                try:
                    cells.append(str(of(bench, tolerance, quantity, route=route).n_states))
                except updyn.UpdynError:
                    cells.append("-")
            print(f"| {bench.name}, {word}, {route} | {' | '.join(cells)} |", flush=True)
        needed, whole, n = relative_needed(bench, quantity)
        cells = ["-" if r is None else str(r) for r in needed]
        print(
            f"| {bench.name}, {word}, balanced truncation of {n} states ({100 * whole:.2g} %) |"
            f" {' | '.join(cells)} |",
            flush=True,
        )


def causal(bench: Bench) -> None:
    """Lower bounds on the relative error of any stable plant, its gain outside the band limited."""
    for quantity, word in QUANTITIES.items():
        least = of(bench, 0.3, quantity).facts["causal error"]
        print(f"{bench.name}, {word}: {100 * least:.2g} % or more by any stable plant", flush=True)


def relative_needed(bench: Bench, quantity: str) -> tuple[list[int | None], float, int]:
    """States that balanced truncations of all complex modes need; their error and number."""
    ports = as_ports([bench.force], "input"), as_ports(bench.motions, "output")
    task, _ = build_task(bench.model, *ports, bench.band, quantity, None, None)
    target, best, least = task.target, None, np.inf
    for conversion in task.fitted_conversions("complex"):
        mask = np.ones(len(conversion.frequency), dtype=np.bool_)
        error = target.relative_error(conversion.response(mask, target.freq))
        if error < least:
            best, least = conversion.matrices(mask), error
    assert best is not None
    still, rest = split(best)
    rigid, cut = respond(still, target.freq), balanced(rest)
    needed: list[int | None] = [None] * len(RELATIVE)
    for r in range(min(len(rest[0]), 80) + 1):
        for static in (False, True):
            error = target.relative_error(rigid + respond(cut(r, static), target.freq))
            for k, tolerance in enumerate(RELATIVE):
                if needed[k] is None and error <= tolerance:
                    needed[k] = r + len(still[0])
        if None not in needed:
            break
    return needed, least, len(best[0])


def route_of(plant: Plant) -> str:
    return f"{plant.route}, fitted" if "fitted" in plant.facts else plant.route


# -- error of the plants ---------------------------------------------------------------------------
def plants(bench: Bench) -> None:
    for quantity, word in QUANTITIES.items():
        made = of(bench, 0.02, quantity, error="peak")
        G = made.response(bench.lines[0]).values[:, :, 0]
        moving = made.poles[np.abs(made.poles) > 1e-6 * np.abs(made.poles).max()]
        print(
            f"| {bench.name}, {word} | {route_of(made)} | {made.n_states} | {100 * made.error:.2g}"
            f" | {100 * bench.error(G, quantity):.2g} | {100 * made.peak_error:.2g} |"
            f" {100 * bench.peak_error(G, quantity):.2g} | {len(made.poles) - len(moving)} |"
            f" {moving.real.max():.2g} |",
            flush=True,
        )


def rigid_body(bench: Bench) -> None:
    """Print inertia and drag at the force, exactly and from 1 / (s G) = J s + c below all modes."""
    model, held = bench.model, model_rows(bench.model, bench.turning)
    free = np.setdiff1d(np.arange(model.n_dofs), held)
    K, M, C = (sp.csc_array(x) for x in (model.stiffness, model.mass, model.viscous))
    R = np.zeros((model.n_dofs, len(held)))
    R[held] = np.eye(len(held))
    R[free] = -spla.spsolve(K[free][:, free], K[free][:, held].toarray())
    at = R[model_rows(model, [bench.force])[0]]
    exact = [float(1.0 / (at @ np.linalg.solve(R.T @ (X @ R), at))) for X in (M, C)]
    made = updyn.plant(bench.model, [bench.force], [bench.force], bench.band, error="peak")
    s = 2j * np.pi * np.array([1e-4, 1e-3])
    G = made.at(s)[:, 0, 0]
    answer = 1.0 / (s * G)
    found = [float(answer[1].imag / s[1].imag), float(answer[0].real)]
    slope = np.log10(np.abs(G[1] / G[0]))
    print(
        f"\n{bench.name}: slope of the displacement between 1e-4 and 1e-3 Hz {slope:.4f}; at the"
        " force"
    )
    for what, a, b, unit in zip(
        ("inertia", "drag"), found, exact, ("kg m2", "N m s/rad"), strict=True
    ):
        print(f"  {what} {a:.6g} {unit}, exactly {b:.6g}: off by {abs(a / b - 1.0):.1g}")


def model_rows(model: Model, labels: list[str] | tuple[str, ...]) -> np.ndarray:
    return model.dofs.match(list(labels)).index


# -- conversions -----------------------------------------------------------------------------------
def by_hand(bench: Bench, quantity: str) -> dict[str, np.ndarray]:
    """The conversions once more, of dense matrices with all modes."""
    model = bench.model
    K, M = model.stiffness.toarray(), model.mass.toarray()
    D, C = model.structural.toarray(), model.viscous.toarray()
    square, phi = scipy.linalg.eigh(K, M)
    omega = np.sqrt(np.maximum(square, 0.0))
    freq = bench.lines[0]
    s = 2j * np.pi * freq
    out, into = (phi[model_rows(model, labels)] for labels in (bench.motions, [bench.force]))
    damping = phi.T @ D @ phi
    middle = 2 * np.pi * np.sqrt(max(bench.band[0], 1e-3 * bench.band[1]) * bench.band[1])
    own = damping / np.sqrt(np.outer(omega, omega))
    found = {}
    for name, X in (
        ("modal", own),
        ("diagonal", np.diag(np.diag(own))),
        ("single-frequency", damping / middle),
    ):
        Z = (
            s[:, None, None] * (X + phi.T @ C @ phi)
            + np.diag(square)
            + (s**2)[:, None, None] * np.eye(len(omega))
        )
        loads = np.broadcast_to(into.T, (len(s), *into.T.shape))
        found[name] = (out @ np.linalg.solve(Z, loads))[:, :, 0]
    if not C.any():
        squares, shapes = scipy.linalg.eig(K + 1j * D, M)  # of the poles squared, the sign changed
        shapes = shapes / np.sqrt(np.einsum("im,ij,jm->m", shapes, M, shapes))
        poles = 1j * np.sqrt(squares)
        a, b = (shapes[model_rows(model, labels)] for labels in (bench.motions, [bench.force]))
        R = a * b / (2.0 * poles)
        upper, lower = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - poles.conj())
        found["complex"] = upper @ R.T + lower @ R.conj().T
    if quantity == "receptance":
        return found
    return {name: s[:, None] * G for name, G in found.items()}


def side_by_side(bench: Bench) -> None:
    for quantity, word in QUANTITIES.items():
        stated = updyn.conversions(
            bench.model, [bench.force], bench.motions, bench.band, quantity=quantity
        )
        own = by_hand(bench, quantity) if bench.model.n_dofs < 100 else {}
        cells = []
        for one in stated:
            cell = "refused"
            if np.isfinite(one.error):
                cell = f"{100 * one.error:.2g} / {100 * one.peak_error:.2g}"
            if one.name in own:
                G = own[one.name]
                cell += (
                    f" ({100 * bench.error(G, quantity):.2g} /"
                    f" {100 * bench.peak_error(G, quantity):.2g})"
                )
            cells.append(cell)
        print(f"| {bench.name}, {word} | " + " | ".join(cells) + " |", flush=True)


# -- order -----------------------------------------------------------------------------------------
def respond(matrices: Matrices, freq: np.ndarray) -> np.ndarray:
    """The response, by eigenvalues where the vectors are independent enough."""
    A, B, C, D = matrices
    s = 2j * np.pi * freq
    if not len(A):
        return np.broadcast_to(D.astype(complex), (len(s), *D.shape))
    values, V = np.linalg.eig(A)
    if np.linalg.cond(V) < 1e8:
        return ((C @ V) / (s[:, None, None] - values)) @ np.linalg.solve(V, B) + D
    solved = np.linalg.solve(
        s[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(s), *B.shape))
    )
    return C @ solved + D


def split(matrices: Matrices) -> tuple[Matrices, Matrices]:
    """Split off the poles at 0 by an ordered Schur form and a Sylvester equation."""
    A, B, C, D = matrices
    least = 1e-6 * np.abs(np.linalg.eigvals(A)).max()
    T, Q, n = scipy.linalg.schur(A, sort=lambda re, im: np.hypot(re, im) < least)
    X = scipy.linalg.solve_sylvester(T[:n, :n], -T[n:, n:], -T[:n, n:])
    B, C = Q.T @ B, C @ Q
    rest = T[n:, n:], B[n:], C[:, n:] + C[:, :n] @ X, D
    return (T[:n, :n], B[:n] - X @ B[n:], C[:, :n], np.zeros_like(D)), rest


def balanced(matrices: Matrices) -> Callable[[int, bool], Matrices]:
    """Balanced truncation by square roots (Moore 1981).

    With the static response kept it is that of Fernando & Nicholson (1982).
    """
    A, B, C, D = matrices
    roots = []
    for a, b in ((A, B), (A.T, C.T)):
        values, vectors = np.linalg.eigh(scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T))
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    U, sigma, Vt = np.linalg.svd(roots[1].T @ roots[0])
    use = sigma > 1e-13 * sigma[0]
    right = roots[0] @ Vt[use].T / np.sqrt(sigma[use])
    left = roots[1] @ U[:, use] / np.sqrt(sigma[use])
    a, b, c = left.T @ A @ right, left.T @ B, C @ right

    def cut(r: int, static: bool) -> Matrices:
        if not static or r >= len(a):
            return a[:r, :r], b[:r], c[:, :r], D
        rest = np.linalg.solve(a[r:, r:], np.hstack([a[r:, :r], b[r:]]))
        x, y = rest[:, :r], rest[:, r:]
        return (
            a[:r, :r] - a[:r, r:] @ x,
            b[:r] - a[:r, r:] @ y,
            c[:, :r] - c[:, r:] @ x,
            D - c[:, r:] @ y,
        )

    return cut


def order_needed(
    bench: Bench, quantity: str, fit: str | None, made: list[Plant]
) -> list[int | None]:
    """States that balanced truncations of one conversion need to be as good as some plants."""
    ports = as_ports([bench.force], "input"), as_ports(bench.motions, "output")
    task, _ = build_task(bench.model, *ports, bench.band, quantity, None, None)
    target = task.target
    conversion = next(c for c in task.fitted_conversions(made[0].route) if fit_of(c) == fit)
    freq = target.freq
    all_modes = np.ones(len(conversion.frequency), dtype=np.bool_)
    still, rest = split(conversion.matrices(all_modes))
    rigid, cut = respond(still, freq), balanced(rest)
    # Within the tolerance; where that cannot be held, beside very sharp peaks, as good as the plant
    # or all modes.
    whole = target.all_errors(conversion.response(all_modes, freq))[1:]
    limits = []
    for p in made:
        own = target.all_errors(p.response(freq).values)[1:]
        limits.append(np.maximum(np.maximum(p.tolerance, whole), own))
    needed: list[int | None] = [None] * len(made)
    for r in range(min(len(rest[0]), 60) + 1):
        for static in (False, True):
            reduced = cut(r, static)
            if len(reduced[0]) < r:
                continue
            G = rigid + respond(reduced, freq)
            errors = target.all_errors(G)[1:]
            for k, limit in enumerate(limits):
                if needed[k] is None and (errors <= 1.01 * limit).all():
                    needed[k] = r + len(still[0])
        if None not in needed:
            break
    return needed


def fit_of(conversion: Conversion) -> str | None:
    """The fact of a plant about a conversion whose outputs were fitted."""
    if not isinstance(conversion, FittedModes):
        return None
    return f"outputs, with {len(conversion.extra)} real poles"


def orders(bench: Bench) -> None:
    for quantity, word in QUANTITIES.items():
        made = [of(bench, t, quantity, error="peak") for t in TOLERANCES]
        needed: dict[int, int | None] = {}
        for kind in {(p.route, p.facts.get("fitted")) for p in made}:
            alike = [k for k, p in enumerate(made) if (p.route, p.facts.get("fitted")) == kind]
            found = order_needed(bench, quantity, kind[1], [made[k] for k in alike])
            needed.update(zip(alike, found, strict=True))
        cells = [f"{p.n_states} {route_of(p)} ({needed[k] or '-'})" for k, p in enumerate(made)]
        print(f"| {bench.name}, {word} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", default="gear train,chain,antenna")
    parser.add_argument(
        "--only-relative", action="store_true", help="only states by tolerance, relative error"
    )
    args = parser.parse_args()
    some = [b for b in benches() if b.name in args.cases.split(",")]
    if args.only_relative:
        relative_table(some)
        return
    print(
        "tolerance 2 %; errors in % of a channel's peak and of a resonance's height, stated and"
        " measured here"
    )
    print(
        "| | route | states | error | own | peak error | own | poles at 0 | largest other Re,"
        " rad/s |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for bench in some:
        plants(bench)
    for bench in some:
        if bench.turning:
            rigid_body(bench)
    print(
        "\nconversions with all modes, error / peak error in %, in brackets by hand on the script's"
        " own lines"
    )
    print("| | modal | complex | biot | diagonal | single frequency |")
    print("|---|---|---|---|---|---|")
    for bench in some:
        side_by_side(bench)
    print("\nstates by tolerance, in brackets those of a balanced truncation")
    print("| | " + " | ".join(f"{100 * t:g} %" for t in TOLERANCES) + " |")
    print("|---|" + "---|" * len(TOLERANCES))
    for bench in some:
        orders(bench)
    relative_table(some)


def relative_table(some: list[Bench]) -> None:
    print("\nstates by tolerance on the relative error, by route")
    print("| | " + " | ".join(f"{100 * t:g} %" for t in RELATIVE) + " |")
    print("|---|" + "---|" * len(RELATIVE))
    for bench in some:
        relative(bench)
    for bench in some:
        causal(bench)


if __name__ == "__main__":
    main()
