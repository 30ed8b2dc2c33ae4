"""`ModalRows`: residuals of modes and their derivatives, with the kind of each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import BoolArray, IndexArray, RealArray

__all__ = ["KINDS", "ModalRows"]


#: Kinds of residuals; `ModalRows.kind` is the index.
KINDS = ("frequency", "shape", "loss_factor", "scale", "mac")


@dataclass(frozen=True, slots=True, eq=False)
class ModalRows:
    """Unweighted residuals of the paired modes, as shares."""

    #: The residuals, shape (r,). ``frequency``: ln(f_A / f_X). ``shape``: difference of the shapes,
    #: scaled to the same length, as a share of the rms of the measured shape. ``loss_factor``:
    #: eta_A / eta_X - 1. ``scale``: ln of the length of the model's shape of unit modal mass over
    #: that of the measured one. ``mac``: (1 - sqrt(MAC)) / sqrt(MAC), one number for the whole
    #: shape (P. W. Moller & O. Friberg, AIAA J. 36 (1998) 1861).
    r: RealArray
    #: Derivatives by x, shape (r, n).
    J: RealArray
    #: Index of the kind in `KINDS`, shape (r,).
    kind: IndexArray
    #: Number of the measured mode, shape (r,).
    mode: IndexArray
    #: Standard deviation of the data, shape (r,); 0 if unknown.
    std: RealArray
    #: MAC of each measured mode with its paired mode of the model, shape (m,).
    mac: RealArray

    def unpaired_modes(self, like: float) -> IndexArray:
        """Return the measured modes with a MAC below `like`, which have no residuals."""
        return np.flatnonzero(self.mac < like)

    def of(self, kind: str) -> BoolArray:
        """Return which residuals are of a kind, shape (r,)."""
        return np.asarray(self.kind == KINDS.index(kind))

    def freedom(self, kind: str) -> int:
        """Return the number of independent residuals of a kind; the length of a shape is free."""
        is_kind = self.of(kind)
        if kind != "shape":
            return int(is_kind.sum())
        return int(is_kind.sum()) - len(np.unique(self.mode[is_kind]))

    def decorrelate_frequencies(self, covariance: RealArray | None) -> ModalRows:
        """Return the rows with the frequency residuals in the principal axes of their covariance.

        `covariance`, shape (m, m), is that of all measured modes, as shares.
        """
        # The rotation is orthogonal: it changes neither the sum of squares nor an added
        # independent noise of equal size, and the rotated residuals are uncorrelated.
        at = np.flatnonzero(self.of("frequency") & (self.std > 0.0))
        if covariance is None or not len(at):
            return self
        modes = self.mode[at]
        variance, axes = np.linalg.eigh(covariance[np.ix_(modes, modes)])
        r, J, std = self.r.copy(), self.J.copy(), self.std.copy()
        r[at], J[at] = axes.T @ r[at], axes.T @ J[at]
        # The rounding of a large variance may make a small one negative; 0 would be unknown.
        std[at] = np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        return replace(self, r=r, J=J, std=std)
