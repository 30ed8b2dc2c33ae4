"""Estimators of FRFs from averaged spectra, by name: H1, H2 and Hv, of one force or several."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DataError
from updyn.signals.spectra import Spectra

__all__ = ["ESTIMATORS"]

_Complex = NDArray[np.complex128]


def _h1(spectra: Spectra) -> _Complex:
    """Noise on the responses: least squares of each response on the forces."""
    return spectra.least_squares


def _h2(spectra: Spectra) -> _Complex:
    """Noise on the forces: least squares of the forces on the responses.

    Of one force, each response by itself (Mitchell, 1982). Of several it is S_xx S_fx^-1, which
    takes all responses together and at least as many as there are forces; of more, the
    pseudo-inverse (Allemang and Brown, A unified matrix polynomial approach to modal
    identification, J. Sound Vib. 211, 1998, for the estimator; Moore and Penrose for more).
    """
    n_i, n_r = spectra.xf.shape[1:]
    if n_r == 1:
        across = spectra.xf.conj()
        xx = spectra.xx[:, :, None]
        return np.asarray(xx / np.where(across != 0.0, across, np.inf))
    if n_i < n_r:
        raise DataError(
            f"H2 of {n_r} forces takes at least {n_r} responses, found {n_i}; use H1",
            key=("estimator",),
        )
    # S_xf = Q R: the pseudo-inverse of S_fx = R^H Q^H is Q R^-H.
    Q, R = np.linalg.qr(spectra.xf)
    seen = np.einsum("nfi,fir->nfr", spectra.motion.conj(), Q)
    xx_Q = np.einsum("nfi,nfr->fir", spectra.motion, seen) / len(spectra.motion)
    back = np.linalg.solve(R, xx_Q.conj().transpose(0, 2, 1))
    return np.asarray(back.conj().transpose(0, 2, 1))


def _hv(spectra: Spectra) -> _Complex:
    """Noise on all channels, in proportion to their levels: total least squares.

    Each channel is divided by its level; the smallest eigenvector of the spectral matrix of the
    forces and one response is the plane in which they lie: Rocklin, Crowley and Vold (1985). Of one
    force that is the geometric mean of H1 and H2.
    """
    n_i, n_r = spectra.xf.shape[1:]
    if n_r == 1:
        size = np.sqrt(spectra.xx[:, :, None] / spectra.ff.real)
        return np.asarray(size * np.exp(1j * np.angle(spectra.xf)))
    level = np.sqrt(spectra.power)
    out = np.empty_like(spectra.xf)
    for i in range(n_i):
        motion = np.sqrt(spectra.xx[:, i])
        motion = np.where(motion > 0.0, motion, 1.0)
        whole = np.empty((len(level), n_r + 1, n_r + 1), dtype=np.complex128)
        whole[:, :n_r, :n_r] = spectra.ff / (level[:, :, None] * level[:, None, :])
        whole[:, n_r, :n_r] = spectra.xf[:, i] / (motion[:, None] * level)
        whole[:, :n_r, n_r] = whole[:, n_r, :n_r].conj()
        whole[:, n_r, n_r] = spectra.xx[:, i] / motion**2
        # v^H z = 0 for z = (F, X): X = -(v_F^H F) / conj(v_X).
        across = np.linalg.eigh(whole)[1][:, :, 0].conj()
        out[:, i] = -across[:, :n_r] / across[:, n_r:] * motion[:, None] / level
    return out


ESTIMATORS = {"H1": _h1, "H2": _h2, "Hv": _hv}
