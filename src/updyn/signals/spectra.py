"""`Spectra`: averaged spectra of forces and responses, and the coherences between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.errors import DataError
from updyn.signals.settings import FRF_ESTIMATE

__all__ = ["Spectra"]


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Spectra of segments and their averages."""

    #: Forces of each segment, shape (n, n_f, n_r).
    force: ComplexArray
    #: Responses of each segment, shape (n, n_f, n_i).
    motion: ComplexArray
    #: Number of independent segments.
    averages: float
    #: E F F^H, shape (n_f, n_r, n_r).
    ff: ComplexArray
    #: E |X|^2, shape (n_f, n_i).
    xx: RealArray
    #: E X F^H, shape (n_f, n_i, n_r).
    xf: ComplexArray

    @classmethod
    def of(cls, force: ComplexArray, motion: ComplexArray, averages: float) -> Spectra:
        """Return the averages of the spectra of segments."""
        n = len(force)
        ff = np.einsum("nfr,nfs->frs", force, force.conj()) / n
        xf = np.einsum("nfi,nfr->fir", motion, force.conj()) / n
        return cls(force, motion, averages, ff, np.mean(np.abs(motion) ** 2, axis=0), xf)

    @property
    def power(self) -> RealArray:
        """Spectra of the forces, E |F|^2, shape (n_f, n_r)."""
        return np.asarray(np.einsum("frr->fr", self.ff).real)

    @property
    def ordinary(self) -> RealArray:
        """Ordinary coherence |S_xf|^2 / (S_xx S_ff) (Bendat and Piersol 2010, section 6.1)."""
        return _share(np.abs(self.xf) ** 2, self.xx[:, :, None] * self.power[:, None, :])

    @property
    def multiple(self) -> RealArray:
        """Multiple coherence S_xf S_ff^-1 S_fx / S_xx (Bendat and Piersol 2010, section 7.2)."""
        if self.ff.shape[1] == 1:
            return self.ordinary[:, :, 0]
        return _share(self._explained_power, self.xx)

    @property
    def partial(self) -> RealArray:
        """Partial coherence of response and force, without the other forces, (n_f, n_i, n_r)."""
        # |H|^2 / (|H|^2 + N S_ff^-1) with H1 and the spectrum N of the response that no force
        # explains: the squared partial correlation by the coefficients of a regression, and the
        # conditioned spectra of Bendat and Piersol (2010), section 7.3, in one step. Equal to the
        # ordinary one for one force.
        if self.ff.shape[1] == 1:
            return self.ordinary
        size = np.abs(self.least_squares) ** 2
        return _share(size, size + self.spread)

    @property
    def least_squares(self) -> ComplexArray:
        """H1 = S_xf S_ff^-1, shape (n_f, n_i, n_r)."""
        if self.ff.shape[1] == 1:
            return np.asarray(self.xf / self.ff)
        # H S_ff = S_xf with S_ff Hermitian: the transpose has S_ff^T = conj(S_ff).
        right = self.xf.transpose(0, 2, 1)
        return np.asarray(np.linalg.solve(self.ff.conj(), right).transpose(0, 2, 1))

    @property
    def spread(self) -> RealArray:
        """Unexplained spectrum of the responses times diag(S_ff^-1), shape (n_f, n_i, n_r)."""
        # Divided by the number of averages less that of the forces, it is the variance of H1.
        residual_power = np.maximum(self.xx * (1.0 - self.multiple), 0.0)
        if self.ff.shape[1] == 1:
            return np.asarray(residual_power[:, :, None] / self.power[:, None, :])
        identity = np.broadcast_to(np.eye(self.ff.shape[1]), self.ff.shape)
        inverse = np.einsum("frr->fr", np.linalg.solve(self.ff, identity)).real
        return np.asarray(residual_power[:, :, None] * inverse[:, None, :])

    @property
    def _explained_power(self) -> RealArray:
        """Spectra of the responses that the forces explain, shape (n_f, n_i)."""
        return np.asarray(np.einsum("fir,fir->fi", self.least_squares, self.xf.conj()).real)

    def check_power(self, freq: RealArray, names: Sequence[str]) -> None:
        """Raise DataError for a line at which a force is zero."""
        for name, column in zip(names, self.power.T, strict=True):
            silent = column <= FRF_ESTIMATE.zero_force_share**2 * column.max()
            if silent.any():
                raise DataError(
                    f"channel {name!r}: no force at {freq[silent][0]:g} Hz; narrow the band",
                    key=("band",),
                )

    def check_forces(self, freq: RealArray, names: Sequence[str]) -> None:
        """Raise DataError for a line at which a force is zero, or forces are linearly dependent."""
        self.check_power(freq, names)
        if len(names) == 1:
            return
        if len(self.force) < len(names):
            raise DataError(
                f"{len(names)} forces and {len(self.force)} records or segments; expected at least"
                " as many as forces, better several times that",
                key=("excitation",),
            )
        size = np.sqrt(self.power)
        coherent = self.ff / (size[:, :, None] * size[:, None, :])
        least = np.linalg.eigvalsh(coherent)[:, 0]
        if (least < FRF_ESTIMATE.independent_eigenvalue).any():
            at = freq[least < FRF_ESTIMATE.independent_eigenvalue][0]
            raise DataError(
                f"the forces {' and '.join(map(repr, names))} are linearly dependent at {at:g} Hz:"
                " one is a fixed combination of the others in all records; expected independent"
                " forces",
                key=("excitation",),
            )

    def part(self, chosen: slice | BoolArray, averages: float) -> Spectra:
        """Return the averages over some of the segments; `averages` of them are independent."""
        return Spectra.of(self.force[chosen], self.motion[chosen], averages)


def _share(part: RealArray, whole: RealArray) -> RealArray:
    """Return a ratio limited to 0 to 1; zero if nothing was measured."""
    found = part / np.where(whole > 0.0, whole, np.inf)
    return np.asarray(np.clip(found, 0.0, 1.0))
