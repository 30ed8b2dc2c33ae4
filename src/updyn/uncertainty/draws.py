"""Values of the unknowns drawn by a bootstrap or a sampler, with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from updyn.arrays import BoolArray, RealArray
from updyn.errors import OptionError, suggest
from updyn.uncertainty.counts import check_level
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["INTERVALS", "KINDS", "Draws"]


KINDS = ("bootstrap", "sampling")
#: Kinds of intervals, the default first.
INTERVALS = {"bootstrap": ("percentile", "basic", "bca"), "sampling": ("percentile", "highest")}


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Draws of the unknowns.

    Attributes
    ----------
    kind : {"bootstrap", "sampling"}
        Their method.
    names : tuple of str
        The unknowns.
    chains : ndarray of float, shape (n_chains, n_draws, n)
        Values in the unit of each unknown. A bootstrap is one chain.
    estimate, std : ndarray of float, shape (n,)
        Values of the update and their Laplace standard deviations (inf if undetermined).
    lower, upper : ndarray of float, shape (n,)
        Bounds of the unknowns.
    is_factor : ndarray of bool, shape (n,)
        Which unknowns are positive factors, drawn in their logarithm, not loss factors.
    diagnostics : dict of str to ndarray of float, shape (n,)
        Of a sampling, by ArviZ: ``r_hat``, ``ess_bulk``, ``ess_tail``, ``mcse_mean``, ``mcse_std``
        (in the unit of the unknown). Of a bootstrap: ``acceleration`` (of BCa intervals) and
        ``mcse_mean``, ``mcse_std``.
    failed : dict of str to int
        Number of draws that failed, by reason.
    converged : bool
        Whether the draws are reliable: the sampling has converged, or nearly all refits of the
        bootstrap have succeeded.
    message : str
        Text on limits of their use.
    options : dict
        Seed, numbers, evaluations, errors of a reduced model.
    result : UpdateResult or JointResult or None
        Their update; not stored in files.
    """

    kind: str
    names: tuple[str, ...]
    chains: RealArray
    estimate: RealArray
    std: RealArray
    lower: RealArray
    upper: RealArray
    is_factor: BoolArray
    diagnostics: Mapping[str, RealArray] = field(default_factory=dict)
    failed: Mapping[str, int] = field(default_factory=dict)
    converged: bool = True
    message: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    result: UpdateResult | JointResult | None = None

    def __len__(self) -> int:
        return int(self.chains.shape[0] * self.chains.shape[1])

    def __repr__(self) -> str:
        state = "" if self.converged else ", not converged"
        return f"Draws({self.kind}, {len(self)} of {len(self.names)} unknowns{state})"

    def __getitem__(self, name: str) -> RealArray:
        """Return the draws of an unknown, shape (n_chains * n_draws,), in its unit."""
        if name not in self.names:
            raise OptionError(f"no draws of {name!r}; {suggest(str(name), self.names)}")
        return self.values[:, self.names.index(name)]

    @property
    def values(self) -> RealArray:
        """All draws, shape (n_chains * n_draws, n)."""
        return self.chains.reshape(-1, len(self.names))

    @property
    def mean(self) -> dict[str, float]:
        """Mean by unknown."""
        return dict(zip(self.names, self.values.mean(axis=0).tolist(), strict=True))

    @property
    def deviation(self) -> dict[str, float]:
        """Standard deviation by unknown."""
        return dict(zip(self.names, self.values.std(axis=0, ddof=1).tolist(), strict=True))

    @property
    def covariance(self) -> RealArray:
        """Covariance of the unknowns, shape (n, n)."""
        return np.atleast_2d(np.cov(self.values, rowvar=False))

    @property
    def correlation(self) -> RealArray:
        """Correlation of the unknowns, shape (n, n); nan for a constant unknown."""
        C = self.covariance
        std = np.sqrt(np.diag(C))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(C / std[:, None] / std)

    def of(self, result: UpdateResult | JointResult) -> Draws:
        """Return the draws with their update, which files do not contain.

        Raises OptionError if the update has other unknowns or another estimate.
        """
        same = tuple(result.parameters.names) == self.names
        estimate = [result.values.get(name, np.nan) for name in self.names]
        if not same or not np.allclose(estimate, self.estimate, rtol=1e-9, atol=1e-12):
            raise OptionError(
                "these draws are about another update: its unknowns or its estimate differ"
            )
        return replace(self, result=result)

    # -- intervals -----------------------------------------------------------------------------
    def intervals(
        self, level: float = 0.95, kind: str | None = None
    ) -> dict[str, tuple[float, float]]:
        """Return an interval by unknown, in its unit, with a share `level` of the probability.

        `kind` of a bootstrap: ``"percentile"`` (default), ``"basic"`` (reflected at the estimate,
        in the logarithm of a factor), or ``"bca"`` (corrected for bias and acceleration; Efron, J.
        Am. Stat. Assoc. 82 (1987) 171). Of a sampling: ``"percentile"`` (default, equal tails) or
        ``"highest"`` (the shortest). Raises OptionError if there are too few draws.
        """
        check_level(level)
        known = INTERVALS[self.kind]
        if kind is None:
            kind = known[0]
        if kind not in known:
            raise OptionError(
                f"intervals of a {self.kind} of kind {kind!r}: {suggest(str(kind), known)}"
            )
        if len(self) < 2:
            raise OptionError(f"{len(self)} draws are too few for an interval")
        ends = {
            "percentile": self._percentile,
            "basic": self._basic,
            "bca": self._bca,
            "highest": self._highest,
        }
        low, high = np.clip(ends[kind](0.5 * (1.0 - level)), self.lower, self.upper)
        return dict(zip(self.names, zip(low.tolist(), high.tolist(), strict=True), strict=True))

    def _percentile(self, tail: float) -> RealArray:
        return np.asarray(np.quantile(self.values, [tail, 1.0 - tail], axis=0))

    def _basic(self, tail: float) -> RealArray:
        low, high = self._percentile(tail)
        with np.errstate(divide="ignore", invalid="ignore"):
            in_logarithm = np.array([self.estimate**2 / high, self.estimate**2 / low])
        plain = np.array([2 * self.estimate - high, 2 * self.estimate - low])
        return np.where(self.is_factor, in_logarithm, plain)

    def _bca(self, tail: float) -> RealArray:
        values, count = self.values, len(self)
        below = (values < self.estimate).mean(axis=0) + 0.5 * (values == self.estimate).mean(axis=0)
        bias = ndtri(np.clip(below, 0.5 / count, 1.0 - 0.5 / count))
        a = self.diagnostics.get("acceleration", np.zeros(len(self.names)))
        out = np.empty((2, len(self.names)))
        for end, share in enumerate((tail, 1.0 - tail)):
            z = bias + ndtri(share)
            at = ndtr(bias + z / (1.0 - a * z))
            out[end] = [np.quantile(values[:, k], at[k]) for k in range(len(self.names))]
        return out

    def _highest(self, tail: float) -> RealArray:
        ordered = np.sort(self.values, axis=0)
        inside = max(1, round((1.0 - 2.0 * tail) * (len(ordered) - 1)))
        first = np.argmin(ordered[inside:] - ordered[:-inside], axis=0)
        unknown = np.arange(len(self.names))
        return np.array([ordered[first, unknown], ordered[first + inside, unknown]])

    def summary(self, level: float = 0.95) -> str:
        """Return the draws as text: means, deviations, intervals and diagnostics by unknown."""
        head = f"{self.kind.capitalize()}: {len(self)} draws"
        if self.failed:
            head += f", {sum(self.failed.values())} more failed"
        lines = [head]
        if self.message:
            lines.append(self.message)
        if len(self) < 2:
            return "\n".join(lines)
        diagnostics = [k for k in ("r_hat", "ess_bulk", "ess_tail") if k in self.diagnostics]
        width = max([26, *map(len, self.names)]) + 2
        header = f"{'unknown':<{width}}"
        for column in ["value", "mean", "std", "Laplace std", "lower", "upper", *diagnostics]:
            header += f"{column:>13}"
        lines += ["", f"{header}   ({100 * level:g} % intervals)"]
        ends, mean, std = self.intervals(level), self.mean, self.deviation
        for k, name in enumerate(self.names):
            laplace = f"{self.std[k]:.3g}" if np.isfinite(self.std[k]) else "-"
            lower, upper = ends[name]
            row = f"{name:<{width}}{self.estimate[k]:>13.6g}{mean[name]:>13.6g}{std[name]:>13.3g}"
            row += f"{laplace:>13}{lower:>13.6g}{upper:>13.6g}"
            for column in diagnostics:
                row += f"{self.diagnostics[column][k]:>13.4g}"
            lines.append(row)
        return "\n".join(lines)
