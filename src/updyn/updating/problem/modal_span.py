"""`SpanProjection` of a measured shape onto the span of one or several modes of the model.

Close measured modes are an arbitrary basis of their span (see `updyn.correlation.clusters`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.problem.settings import MODE_PAIRS

__all__ = ["SpanProjection"]


@dataclass(frozen=True, slots=True, eq=False)
class SpanProjection:
    """Projection of a measured shape psi of unit length onto a span, with its derivatives by x.

    `within`, shape (k,), is P psi with the orthogonal projection P; for one mode with the shape
    phi, phi (phi^T psi) / |phi|^2, the modal scale factor of Allemang & Brown (1982). `size` is
    phi^T psi of the nearest combination phi of unit modal mass.
    """

    measured: RealArray
    within: RealArray
    within_by_x: RealArray
    size: float
    size_by_x: RealArray

    @classmethod
    def of(cls, measured: RealArray, shapes: RealArray, derivatives: RealArray) -> SpanProjection:
        """Return the projection onto the span of shapes (k, s) with derivatives (s, k, n) by x."""
        # With the pseudo-inverse G of Phi, a = G psi and P = Phi G, P' psi = (1 - P) Phi' a + G^T
        # Phi'^T (1 - P) psi (Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432, eq. 4.12).
        # Derivatives of the shapes within their own span, large for close frequencies, have no
        # effect.
        U, sizes, Vt = _decompose(shapes)
        share = Vt.T @ (U.T @ measured / sizes)
        within = shapes @ share
        along = np.einsum("skn,s->kn", derivatives, share)
        across = np.einsum("skn,k->sn", derivatives, measured - within)
        rotation = U @ ((Vt @ across) / sizes[:, None])  # G^T Phi'^T (1 - P) psi
        by_x = along - U @ (U.T @ along) + rotation
        share_by_x = Vt.T @ ((U.T @ (rotation - along)) / sizes[:, None])
        length, square = float(np.linalg.norm(share)), float(within @ within)
        if length == 0.0:
            return cls(measured, within, by_x, 0.0, np.zeros(derivatives.shape[-1]))
        size_by_x = 2.0 * (within @ by_x) / length - square * (share @ share_by_x) / length**3
        return cls(measured, within, by_x, square / length, size_by_x)

    @property
    def difference(self) -> RealArray:
        """P psi - psi, shape (k,); its squared length is 1 - MAC."""
        return self.within - self.measured

    @property
    def mac_residual(self) -> tuple[float, RealArray]:
        """(1 - sqrt(MAC)) / sqrt(MAC) and its derivatives, shape (n,)."""
        root = float(np.linalg.norm(self.within))
        return (1.0 - root) / root, np.asarray(-(self.within @ self.within_by_x) / root**3)


def _decompose(shapes: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return the singular value decomposition without directions that are rounding error."""
    U, sizes, Vt = np.linalg.svd(shapes, full_matrices=False)
    is_kept = sizes > MODE_PAIRS.span_rounding * sizes.max(initial=0.0)
    return U[:, is_kept], sizes[is_kept], Vt[is_kept]
