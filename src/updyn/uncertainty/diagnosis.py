"""Whether draws of a sampler can be relied on, by ArviZ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["CHAINS_AGREE", "diagnose"]

_Vector = NDArray[np.float64]

#: R-hat up to which ensembles count as drawing from one density (Vehtari et al. 2021).
CHAINS_AGREE = 1.01


def diagnose(chains: NDArray[np.float64], ensembles: int) -> dict[str, _Vector]:
    """Return R-hat, effective sizes and errors by unknown.

    Parameters
    ----------
    chains : ndarray of float, shape (n_chains, n_draws, n)
        Walkers of all ensembles, those of an ensemble together.
    ensembles : int
        How many; the walkers of one know of each other, those of two do not.

    Returns
    -------
    dict of str to ndarray of float, shape (n,)
        ``r_hat`` between the ensembles, all draws of one counted as one chain; ``ess_bulk``,
        ``ess_tail``, ``mcse_mean``, ``mcse_std`` with the walkers as chains.

    Notes
    -----
    Rank-normalised split R-hat, and effective sizes: Vehtari et al., Bayesian Anal. 16 (2021) 667.
    """
    from arviz_stats.base import array_stats

    n_chains, n_draws, n = chains.shape
    by_unknown = np.moveaxis(chains, -1, 0)
    # An ensemble step by step: its halves are the early and the late draws.
    walkers = by_unknown.reshape(n, ensembles, n_chains // ensembles, n_draws)
    whole = walkers.swapaxes(2, 3).reshape(n, ensembles, -1)
    axes = {"chain_axis": -2, "draw_axis": -1}
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "r_hat": np.asarray(array_stats.rhat(whole, **axes)),
            "ess_bulk": np.asarray(array_stats.ess(by_unknown, **axes, method="bulk")),
            "ess_tail": np.asarray(
                array_stats.ess(by_unknown, **axes, method="tail", prob=(0.05, 0.95))
            ),
            "mcse_mean": np.asarray(array_stats.mcse(by_unknown, **axes, method="mean")),
            "mcse_std": np.asarray(array_stats.mcse(by_unknown, **axes, method="sd")),
        }
