"""`ModalRows`: the residuals of modes and their derivatives, each of its kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "ModalRows"]

_Real = NDArray[np.float64]

#: Kinds of residuals, in the order of their numbers.
KINDS = ("frequency", "shape", "loss_factor", "scale", "mac")


@dataclass(frozen=True, slots=True, eq=False)
class ModalRows:
    """Residuals of the modes that are paired, as shares, not weighted.

    Attributes
    ----------
    r : ndarray of float, shape (r,)
        ``frequency``: ln(f_A / f_X). ``shape``: the difference of the shapes, brought to the same
        length, as a share of the rms of the measured one. ``loss_factor``: eta_A / eta_X - 1.
        ``scale``: ln of the length of the model's shape of unit modal mass over that of the
        measured one. ``mac``: (1 - sqrt(MAC)) / sqrt(MAC), one number for the whole shape (P. W.
        Moller & O. Friberg, AIAA J. 36 (1998) 1861).
    J : ndarray of float, shape (r, n)
        Derivatives by x.
    kind : ndarray of int, shape (r,)
        Number of its kind in `KINDS`.
    mode : ndarray of int, shape (r,)
        Measured mode that it is about.
    std : ndarray of float, shape (r,)
        Standard deviation that the data state; 0 where they state none.
    mac : ndarray of float, shape (m,)
        MAC of each measured mode and the mode of the model that it is paired with.
    """

    r: _Real
    J: _Real
    kind: NDArray[np.intp]
    mode: NDArray[np.intp]
    std: _Real
    mac: _Real

    def lost(self, like: float) -> NDArray[np.intp]:
        """Return the measured modes whose MAC is below `like`, which give no residuals."""
        return np.flatnonzero(self.mac < like)

    def of(self, kind: str) -> NDArray[np.bool_]:
        """Return which residuals are of a kind, shape (r,)."""
        return np.asarray(self.kind == KINDS.index(kind))

    def freedom(self, kind: str) -> int:
        """Return how many residuals of a kind are independent: of a shape, one is its length."""
        mine = self.of(kind)
        if kind != "shape":
            return int(mine.sum())
        return int(mine.sum()) - len(np.unique(self.mode[mine]))
