"""Windows for records of hits: a short box for the force, a decay for all channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.signals.settings import FRF_ESTIMATE

__all__ = ["ImpactWindow"]


@dataclass(frozen=True, slots=True)
class ImpactWindow:
    """Windows for hits: Halvorsen and Brown (1977).

    Parameters
    ----------
    force : float, optional
        Time in s after the largest force at which the force is set to zero, as the remainder is
        noise. The same time before it is kept, too.
    exponential : float, optional
        Value between 0 and 1 of exp(-a t) at the end of the record. All channels are multiplied by
        it, which prevents truncation of the responses.
    remove_damping : bool
        Whether the damping that the decay adds is removed from the FRF.

    Raises
    ------
    OptionError
        If a time is not positive, or a share not between 0 and 1.

    Examples
    --------
    >>> window = updyn.ImpactWindow(force=0.05, exponential=0.2)
    >>> window.force
    0.05
    """

    force: float | None = None
    exponential: float | None = None
    remove_damping: bool = True

    def __post_init__(self) -> None:
        if self.force is not None and not self.force > 0.0:
            raise OptionError(f"force window of {self.force} s; expected a positive time")
        if self.exponential is not None and not 0.0 < self.exponential < 1.0:
            raise OptionError(
                f"exponential window that decays to {self.exponential}; expected a share between 0"
                " and 1"
            )

    def decay(self, duration: float) -> float:
        """Return a of exp(-a t), in 1/s.

        Parameters
        ----------
        duration : float
            Length of the record, in s.

        Returns
        -------
        float
        """
        return 0.0 if self.exponential is None else -float(np.log(self.exponential)) / duration

    def on_force(self, force: RealArray, step: float) -> RealArray:
        """Return the window of the force.

        Parameters
        ----------
        force : ndarray of float, shape (n_samples,)
            Without its offset.
        step : float
            Sampling interval in s.

        Returns
        -------
        ndarray of float, shape (n_samples,)
        """
        if self.force is None:
            return np.ones(len(force))
        away = np.abs(np.arange(len(force)) - int(np.argmax(np.abs(force)))) * step
        share = FRF_ESTIMATE.taper_share
        past = (away - (1.0 - share) * self.force) / (share * self.force)
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(past, 0.0, 1.0)))
