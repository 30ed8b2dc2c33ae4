"""The variance that coherence and the number of averages tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.base import level_by_unit
from updyn.updating.problem.noise.smooth import Steady, steady

__all__ = ["Coherence"]

#: Averages that are taken for the smoothing, where their number is not known.
_USUAL = 10


@dataclass(frozen=True, slots=True, eq=False)
class Coherence:
    """E|dH|^2 = |H_X|^2 (1 - gamma^2) / (gamma^2 (n - 1)), made steady along the lines (`smooth.steady`).

    H_X and gamma^2 belong together: they come from the same n spectra, and S_nn = (1 - gamma^2)
    S_yy is the output that the input does not explain (Bendat & Piersol, Random Data, 4th ed. 2010,
    sections 6.1.4 and 9.2.3, there with n for n - 1). Given the inputs, H1 is a regression with one
    complex unknown: its variance S_nn / (n S_xx) is estimated by this without bias, whatever that
    of gamma^2 itself (Carter, Knapp & Nuttall, IEEE Trans. Audio Electroacoust. 21 (1973) 337), and
    independently of the error of H_X. The model's |H| in place of |H_X| would give nearly no
    variance in an antiresonance, where gamma^2 was formed by |H_X|, mostly noise. It scatters with
    n - 1 degrees of freedom, too few for a weight.

    Parameters
    ----------
    scale_known : bool
        Whether the number of averages is known.
    freq : ndarray of float, shape (n_f,), optional
        Lines of which it has learnt, in Hz.
    learnt : Steady, optional
        What these lines say. Else it learns from the data that it is asked about.
    """

    scale_known: bool
    freq: NDArray[np.float64] | None = None
    learnt: Steady | None = None
    kind: ClassVar[str] = "coherence"

    @classmethod
    def of(cls, frf: FRF) -> Coherence:
        """Return the model that has learnt from all lines of `frf`, for these or fewer of them."""
        return cls(frf.averages is not None, frf.freq, _learn(frf))

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if (
            self.freq is not None
            and self.learnt is not None
            and self.learnt.floor.shape[1:] == H.shape[1:]
        ):
            at = np.searchsorted(self.freq, frf.freq)
            if at[-1] < len(self.freq) and (self.freq[at] == frf.freq).all():
                return self.learnt.at(np.abs(H), at)
        return _learn(frf).at(np.abs(H))

    def refit(self, H: NDArray[np.complex128], frf: FRF, n_parameters: int) -> Coherence:
        """Return itself."""
        return self

    def figures(self) -> dict[str, Any]:
        """Return nothing: the numbers are in the data."""
        return {}


def _learn(frf: FRF) -> Steady:
    assert frf.coherence is not None
    gamma2 = np.clip(frf.coherence, 1e-6, 1.0)
    size = np.abs(frf.values)
    share = (1.0 - gamma2) / (gamma2 * max((frf.averages or 2) - 1, 1))
    least = (1e-4 * size) ** 2 + (1e-6 * level_by_unit(frf)) ** 2
    return steady(size**2 * share + least, size, max((frf.averages or _USUAL) - 1, 1))
