"""Estimators of FRFs by name: H1, H2 and Hv of averaged spectra, LRM of neighbouring lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.signals.local import local_rational, without_transients
from updyn.signals.spectra import Spectra

__all__ = ["ESTIMATORS", "EstimatedFRF", "Estimator"]


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedFRF:
    """FRFs H, their coherence and their variance E|dH|^2, shape (n_f, n_i, n_r).

    The coherence is the ordinary one, for several forces the partial one.
    """

    values: ComplexArray
    coherence: RealArray | None
    variance: RealArray | None


@dataclass(frozen=True, slots=True)
class Estimator:
    """A conversion of spectra, lines in Hz and force channels to FRFs.

    If `is_local`, it combines neighbouring lines. It then needs spectra without a window, of
    records or of segments without overlap, and a single one may suffice for several forces.
    """

    estimate: Callable[[Spectra, RealArray, Sequence[str]], EstimatedFRF]
    is_local: bool = False


def _estimate_from_averages(values_of: Callable[[Spectra], ComplexArray]) -> Estimator:
    """Return an estimator from averaged spectra, with the variance from the coherence."""

    def estimate(spectra: Spectra, freq: RealArray, names: Sequence[str]) -> EstimatedFRF:
        spectra.check_forces(freq, names)
        H = values_of(spectra)
        n = len(names)
        if max(1, int(spectra.averages)) <= n:  # all coherences are 1
            return EstimatedFRF(H, None, None)
        coherence = spectra.partial
        return EstimatedFRF(H, coherence, _variance(H, coherence, max(spectra.averages - n, 1.0)))

    return Estimator(estimate)


def _variance(H: ComplexArray, coherence: RealArray, freedom: float) -> RealArray:
    """Return E|dH|^2 for a number of averages less unknowns."""
    least = np.maximum(coherence, np.finfo(float).eps)
    return np.asarray(np.abs(H) ** 2 * (1.0 - coherence) / (least * freedom))


def _estimate_locally(
    values_of: Callable[[Spectra, RealArray, Sequence[str]], tuple[ComplexArray, RealArray]],
) -> Estimator:
    """Return an estimator from local models, with variance and without coherence."""

    def estimate(spectra: Spectra, freq: RealArray, names: Sequence[str]) -> EstimatedFRF:
        values, variance = values_of(spectra, freq, names)
        return EstimatedFRF(values, None, variance)

    return Estimator(estimate, is_local=True)


def _h1(spectra: Spectra) -> ComplexArray:
    """Return H1: least squares of each response on the forces, for noise on the responses."""
    return spectra.least_squares


def _h2(spectra: Spectra) -> ComplexArray:
    """Return H2: least squares of the forces on the responses, for noise on the forces."""
    # For one force, each response separately (Mitchell, 1982). For several it is S_xx S_fx^-1, of
    # all responses together (Allemang and Brown, J. Sound Vib. 211, 1998); with more responses
    # than forces, the pseudo-inverse.
    n_i, n_r = spectra.xf.shape[1:]
    if n_r == 1:
        across = spectra.xf.conj()
        xx = spectra.xx[:, :, None]
        return np.asarray(xx / np.where(across != 0.0, across, np.inf))
    if n_i < n_r:
        raise DataError(
            f"H2 of {n_r} forces requires at least {n_r} responses, found {n_i}; use H1",
            key=("estimator",),
        )
    # S_xf = Q R: the pseudo-inverse of S_fx = R^H Q^H is Q R^-H.
    Q, R = np.linalg.qr(spectra.xf)
    cross = np.einsum("nfi,fir->nfr", spectra.motion.conj(), Q)
    xx_Q = np.einsum("nfi,nfr->fir", spectra.motion, cross) / len(spectra.motion)
    back = np.linalg.solve(R, xx_Q.conj().transpose(0, 2, 1))
    return np.asarray(back.conj().transpose(0, 2, 1))


def _hv(spectra: Spectra) -> ComplexArray:
    """Return Hv: total least squares, for noise on all channels in proportion to their levels."""
    # Each channel is divided by its level; the smallest eigenvector of the spectral matrix of the
    # forces and one response is normal to their plane: Rocklin, Crowley and Vold (1985). For one
    # force this is the geometric mean of H1 and H2.
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


ESTIMATORS = {
    "H1": _estimate_from_averages(_h1),
    "H2": _estimate_from_averages(_h2),
    "Hv": _estimate_from_averages(_hv),
    "LRM": _estimate_locally(local_rational),
    "H1-LRM": _estimate_locally(without_transients),
}
