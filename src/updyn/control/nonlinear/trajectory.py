"""`integrate`: the exact trajectory of a loop through its linear pieces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import IndexArray, RealArray
from updyn.control.nonlinear.pieces import LinearPiece, PieceRules
from updyn.control.nonlinear.settings import LOOP_SIMULATION
from updyn.errors import SolverError

__all__ = ["Trajectory", "integrate"]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A trajectory: states, shape (n_t, m), the piece from each time on, times of switches."""

    time: RealArray
    states: RealArray
    piece: IndexArray
    names: tuple[str, ...]
    switches: RealArray


class _Exact:
    """Matrix exponentials of one piece."""

    def __init__(self, piece: LinearPiece, step: float) -> None:
        self.piece = piece
        once = scipy.linalg.expm(piece.F * step)
        powers = [once]
        for _ in range(LOOP_SIMULATION.block_steps - 1):
            powers.append(powers[-1] @ once)
        self.powers = np.array(powers)
        self.halves = np.array(
            [
                scipy.linalg.expm(piece.F * step * 0.5 ** (i + 1))
                for i in range(LOOP_SIMULATION.switch_halvings)
            ]
        )

    def find_crossing(self, X: RealArray) -> tuple[float, RealArray, int]:
        """Return share of the step before the first border, state just after it, and border."""
        share = 0.0
        for i, half in enumerate(self.halves, 1):
            tried = half @ X
            if (self.piece.borders @ tried >= 0.0).all():
                X, share = tried, share + 0.5**i
        after = self.halves[-1] @ X
        share += 0.5 ** len(self.halves)
        return share, after, int(np.argmin(self.piece.borders @ after))


def integrate(rules: PieceRules, start: RealArray, duration: float, step: float) -> Trajectory:
    """Return the trajectory of a loop through its pieces; it ends with the last whole step."""
    exact = {name: _Exact(piece, step) for name, piece in rules.pieces.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        return _follow_pieces(rules, exact, start, duration, step)


def _follow_pieces(
    rules: PieceRules, exact: Mapping[str, _Exact], start: RealArray, duration: float, step: float
) -> Trajectory:
    names = tuple(rules.pieces)
    now, X, t = rules.first(start), start, 0.0
    times, states, pieces = [np.array([0.0])], [X[None]], [np.array([names.index(now)])]
    switches: list[float] = []
    while (n_steps := min(int((duration - t) / step + 1e-9), LOOP_SIMULATION.block_steps)) > 0:
        at = exact[now]
        ahead = at.powers[:n_steps] @ X
        crossed = (ahead @ at.piece.borders.T < 0.0).any(axis=1)
        n = int(np.argmax(crossed)) if crossed.any() else n_steps
        if n:
            times.append(t + step * np.arange(1, n + 1))
            states.append(ahead[:n])
            pieces.append(np.full(n, names.index(now)))
            t, X = t + n * step, ahead[n - 1]
        if n < n_steps:
            share, X, border = at.find_crossing(X)
            t += share * step
            now, X = rules.after(now, border, X)
            switches.append(t)
            times.append(np.array([t]))
            states.append(X[None])
            pieces.append(np.array([names.index(now)]))
            chatter = LOOP_SIMULATION.chatter_switches
            if len(switches) > chatter and t - switches[-chatter] < step:
                raise SolverError(
                    f"simulation: {chatter} switches between {names[0]!r} and others within"
                    f" {step:.3g} s at {t:.6g} s: the loop chatters"
                )
        if not np.isfinite(X).all():
            raise SolverError(f"simulation: the state overflows at {t:.6g} s: the loop is unstable")
    return Trajectory(
        np.concatenate(times),
        np.concatenate(states),
        np.concatenate(pieces).astype(np.intp),
        names,
        np.array(switches),
    )
