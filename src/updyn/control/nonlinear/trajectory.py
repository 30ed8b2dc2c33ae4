"""`integrate`: the way of a loop through its linear pieces, exact in each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.control.nonlinear.pieces import Piece, Rules
from updyn.errors import SolverError

__all__ = ["Trajectory", "integrate"]

_Real = NDArray[np.float64]
_HALVINGS = 44  # of a step, to find a switch to rounding
_BLOCK = 64  # steps whose powers are kept
_AT_ONCE = 200  # switches within one step: chatter


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A way through pieces.

    Attributes
    ----------
    time : ndarray of float, shape (n_t,)
        In s: every step, and every switch.
    states : ndarray of float, shape (n_t, m)
    piece : ndarray of int, shape (n_t,)
        Position in `names` of the piece that holds from that time on.
    names : tuple of str
    switches : ndarray of float, shape (n_s,)
        Times in s.
    """

    time: _Real
    states: _Real
    piece: NDArray[np.intp]
    names: tuple[str, ...]
    switches: _Real


class _Exact:
    """The exponentials of one piece."""

    def __init__(self, piece: Piece, step: float) -> None:
        self.piece = piece
        once = scipy.linalg.expm(piece.F * step)
        powers = [once]
        for _ in range(_BLOCK - 1):
            powers.append(powers[-1] @ once)
        self.powers = np.array(powers)
        self.halves = np.array(
            [scipy.linalg.expm(piece.F * step * 0.5**i) for i in range(1, _HALVINGS + 1)]
        )

    def crossing(self, X: _Real) -> tuple[float, _Real, int]:
        """Return share of the step before the first border, state just after it, and border."""
        share = 0.0
        for i, half in enumerate(self.halves, 1):
            tried = half @ X
            if (self.piece.borders @ tried >= 0.0).all():
                X, share = tried, share + 0.5**i
        after = self.halves[-1] @ X
        return share + 0.5**_HALVINGS, after, int(np.argmin(self.piece.borders @ after))


def integrate(rules: Rules, start: _Real, duration: float, step: float) -> Trajectory:
    """Follow a loop through its pieces.

    Parameters
    ----------
    rules : Rules
        Pieces and what follows what.
    start : ndarray of float, shape (m,)
        State at time 0.
    duration, step : float
        In s; the last whole step ends it.

    Returns
    -------
    Trajectory

    Raises
    ------
    SolverError
        If pieces change without end within one step, or the state grows beyond all numbers.
    """
    exact = {name: _Exact(piece, step) for name, piece in rules.pieces.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        return _followed(rules, exact, start, duration, step)


def _followed(
    rules: Rules, exact: Mapping[str, _Exact], start: _Real, duration: float, step: float
) -> Trajectory:
    names = tuple(rules.pieces)
    now, X, t = rules.first(start), start, 0.0
    times, states, pieces = [np.array([0.0])], [X[None]], [np.array([names.index(now)])]
    switches: list[float] = []
    while (left := min(int((duration - t) / step + 1e-9), _BLOCK)) > 0:
        at = exact[now]
        ahead = at.powers[:left] @ X
        crossed = (ahead @ at.piece.borders.T < 0.0).any(axis=1)
        n = int(np.argmax(crossed)) if crossed.any() else left
        if n:
            times.append(t + step * np.arange(1, n + 1))
            states.append(ahead[:n])
            pieces.append(np.full(n, names.index(now)))
            t, X = t + n * step, ahead[n - 1]
        if n < left:
            share, X, border = at.crossing(X)
            t += share * step
            now, X = rules.after(now, border, X)
            switches.append(t)
            times.append(np.array([t]))
            states.append(X[None])
            pieces.append(np.array([names.index(now)]))
            if len(switches) > _AT_ONCE and t - switches[-_AT_ONCE] < step:
                raise SolverError(
                    f"simulation: {_AT_ONCE} changes between {names[0]!r} and others within"
                    f" {step:.3g} s at {t:.6g} s: the loop chatters there"
                )
        if not np.isfinite(X).all():
            raise SolverError(
                f"simulation: the loop grows beyond all numbers at {t:.6g} s: it is unstable"
            )
    return Trajectory(
        np.concatenate(times),
        np.concatenate(states),
        np.concatenate(pieces).astype(np.intp),
        names,
        np.array(switches),
    )
