"""`Posterior`: covariance and null space of the unknowns of an update or of draws."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from updyn.arrays import RealArray
from updyn.errors import OptionError, SolverError
from updyn.frf import FRF
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.restored import LIKELIHOOD, at_alternative, restore
from updyn.uncertainty.settings import PREDICTED_BAND
from updyn.updating.fit.methods import METHODS
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["Posterior", "find_update", "has_likelihood"]


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Covariance of the unknowns.

    Attributes
    ----------
    covariance : ndarray of float, shape (n, n)
        Covariance of the determined combinations, in the units of the unknowns.
    null_space : ndarray of float, shape (n, k)
        Undetermined combinations, as changes of the values of the unknowns.
    """

    covariance: RealArray
    null_space: RealArray

    @classmethod
    def of(cls, source: UpdateResult | JointResult | Draws) -> Posterior:
        """Return the posterior of an update (Laplace) or of draws (their sample covariance)."""
        covariance = source.covariance if isinstance(source, Draws) else source.first.covariance
        known = np.isfinite(covariance)
        if known.all():
            return cls(covariance, np.zeros((len(covariance), 0)))
        if isinstance(source, Draws):
            raise OptionError(f"{len(source)} draws are too few for a covariance")
        if has_likelihood(source):
            return cls._of_likelihood(source)
        # The null space is recorded as text only: each unknown in it counts as undetermined.
        involved = np.flatnonzero(~np.diag(known))
        return cls(np.where(known, covariance, 0.0), np.eye(len(covariance))[:, involved])

    @classmethod
    def of_alternative(
        cls, source: UpdateResult | JointResult, other: Alternative
    ) -> Posterior | None:
        """Return the posterior at another answer; None without a likelihood.

        It is widened by the factor by which errors of the model widen that of the update.
        """
        if not has_likelihood(source):
            return None
        found = cls._of_likelihood(at_alternative(source, other))
        stated = source.first.covariance
        if not np.isfinite(stated).all():
            return found
        alone = cls._of_likelihood(source)
        if alone.null_space.size:
            return found
        ratios = scipy.linalg.eigh(stated, alone.covariance, eigvals_only=True)
        return replace(found, covariance=found.covariance * max(float(ratios[-1]), 1.0))

    @classmethod
    def _of_likelihood(cls, source: UpdateResult | JointResult) -> Posterior:
        restored = restore(source)
        local = restored.likelihood().local(restored.x)
        if local is None:
            raise SolverError("the model cannot be solved at the estimate")
        found = analyse_identifiability(local.R, restored.names)
        slope = restored.problem.coordinates.slope(restored.x)
        return cls(found.covariance * slope * slope[:, None], found.null_space * slope[:, None])

    @property
    def of_values(self) -> RealArray:
        """Covariance as recorded in a result: inf in the rows of undetermined unknowns."""
        is_open = np.abs(self.null_space).max(axis=1, initial=0.0) > 0.0
        either = is_open[:, None] | is_open
        return np.where(either, np.inf, self.covariance)

    @property
    def root(self) -> RealArray:
        """A factor R of the covariance R R^T, shape (n, r): independent combinations."""
        value, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(value, 0.0)))

    def propagate(self, derivatives: RealArray, size: float) -> RealArray:
        """Return standard deviations of numbers, shape (...), from derivatives, shape (..., n).

        They are nan if an undetermined combination changes a number relative to `size`.
        """
        variance = np.einsum("...k,kl,...l->...", derivatives, self.covariance, derivatives)
        change = np.abs(derivatives @ self.null_space).max(initial=0.0)
        if change > PREDICTED_BAND.open_change * size:
            return np.full_like(variance, np.nan)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def has_likelihood(source: UpdateResult | JointResult) -> bool:
    """Return whether the likelihood of an update can be evaluated again."""
    method = METHODS.find(source.first.method)
    are_frfs = all(isinstance(one.data, FRF) for one in source.results.values())
    return bool(getattr(method, LIKELIHOOD)) and are_frfs


def find_update(source: UpdateResult | JointResult | Draws) -> UpdateResult | JointResult:
    """Return the update of a source; OptionError if it is neither an update nor draws of one."""
    if isinstance(source, Draws):
        if source.result is None:
            raise OptionError(
                "these draws were read from a file; give them their update first: draws.of(result)"
            )
        return source.result
    if not isinstance(source, UpdateResult | JointResult):
        found = type(source).__name__
        raise OptionError(f"expected the result of an update or draws, found {found}")
    return source
