"""`PopulationResult`: mean and scatter of the unknowns of nominally equal structures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from updyn.arrays import RealArray
from updyn.notebook import card, table
from updyn.population.settings import SCATTER
from updyn.text_table import format_count, text_table
from updyn.uncertainty.counts import check_level
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["HEADINGS", "PopulationResult", "Specimen"]


@dataclass(frozen=True, slots=True, eq=False)
class Specimen:
    """One specimen of a population.

    Attributes
    ----------
    result : UpdateResult
        Its update by its data alone.
    values, std : dict of str to float
        Values of the unknowns by its data and by the population, with standard deviations. A
        combination that its data do not determine follows the population.
    deviation : dict of str to float
        Deviation of `values` from the mean of the population.
    covariance : ndarray of float, shape (n, n)
        Covariance of `values`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, tests = chain.build(), []
    >>> for name, factor in {"a": 0.9, "b": 1.0, "c": 1.1}.items():
    ...     found = updyn.modes(model.scaled({"part1": {"stiffness": factor}}), 3)
    ...     data = updyn.ModeSet(found.frequency, std_frequency=1e-4 * found.frequency)
    ...     tests.append(updyn.Test(model, data, name))
    >>> unknowns = updyn.parameters(model, stiffness="part1")
    >>> population = updyn.update_population(tests, unknowns, starts=0)
    >>> population.specimens["a"], round(population.specimens["a"].values["part1.stiffness"], 3)
    (Specimen(1 unknown), 0.9)
    """

    result: UpdateResult
    values: Mapping[str, float]
    std: Mapping[str, float]
    deviation: Mapping[str, float]
    covariance: RealArray

    def __repr__(self) -> str:
        return f"Specimen({format_count(len(self.values), 'unknown')})"


@dataclass(frozen=True, slots=True, eq=False)
class PopulationResult:
    """Mean and scatter of the unknowns over specimens.

    Attributes
    ----------
    parameters : ParameterSet
        The unknowns.
    mean : dict of str to float
        Mean over all structures of the design, in the unit of each unknown.
    mean_covariance : ndarray of float, shape (n, n)
        Covariance of the error of the mean.
    covariance : ndarray of float, shape (n, n)
        Covariance of the unknowns over structures, without the noise of the tests.
    correlated : bool
        Whether correlations of the unknowns were estimated; otherwise `covariance` is diagonal.
    specimens : dict of str to Specimen
        The specimens by name.
    excluded : dict of str to str
        Specimens that are not used, with the reason.
    p_value : float
        Probability of differences at least as large if the specimens were equal.
    title : str
        Title of the update.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, tests = chain.build(), []
    >>> for name, factor in {"a": 0.9, "b": 1.0, "c": 1.1}.items():
    ...     found = updyn.modes(model.scaled({"part1": {"stiffness": factor}}), 3)
    ...     data = updyn.ModeSet(found.frequency, std_frequency=1e-4 * found.frequency)
    ...     tests.append(updyn.Test(model, data, name))
    >>> unknowns = updyn.parameters(model, stiffness="part1")
    >>> population = updyn.update_population(tests, unknowns, starts=0)
    >>> population, round(population.std["part1.stiffness"], 3)
    (PopulationResult(3 specimens, 1 unknown), 0.1)
    """

    parameters: ParameterSet
    mean: Mapping[str, float]
    mean_covariance: RealArray
    covariance: RealArray
    correlated: bool
    specimens: Mapping[str, Specimen]
    excluded: Mapping[str, str]
    p_value: float
    title: str = ""

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each unknown over structures, in its unit."""
        return self._by_name(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> RealArray:
        """Correlation of the unknowns over structures; nan for an unknown without scatter."""
        std = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.covariance / std / std[:, None])

    @property
    def differs(self) -> bool:
        """Whether the specimens differ by more than the noise of their tests."""
        return self.p_value < SCATTER.significance

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of the mean of each unknown, by Student's distribution.

        Parameters
        ----------
        level : float
            Probability that the interval covers the true mean.

        Returns
        -------
        dict of str to (float, float)
        """
        quantile = stdtrit(len(self.specimens) - 1, 0.5 + 0.5 * check_level(level))
        mean = np.array(list(self.mean.values()))
        half = quantile * np.sqrt(np.diag(self.mean_covariance))
        return self._spans(mean - half, mean + half)

    def std_intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of the standard deviation of each unknown.

        The scatter and the errors of the tests together follow a chi-square distribution as those
        of equal tests; the part of the errors is subtracted (Williams, Biometrika 49 (1962) 278).

        Parameters
        ----------
        level : float
            Probability that the interval covers the true standard deviation.

        Returns
        -------
        dict of str to (float, float)
        """
        tail, count = 0.5 - 0.5 * check_level(level), len(self.specimens)
        variance = np.diag(self.covariance)
        both = count * np.diag(self.mean_covariance)
        error = both - variance
        low, high = ((count - 1) * both / chdtri(count - 1, q) for q in (tail, 1.0 - tail))
        return self._spans(*(np.sqrt(np.maximum(ends - error, 0.0)) for ends in (low, high)))

    def prediction_intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the interval that holds the unknown of a further structure of the design.

        Parameters
        ----------
        level : float
            Probability that the interval holds it.

        Returns
        -------
        dict of str to (float, float)
        """
        quantile = stdtrit(len(self.specimens) - 1, 0.5 + 0.5 * check_level(level))
        mean = np.array(list(self.mean.values()))
        half = quantile * np.sqrt(np.diag(self.covariance + self.mean_covariance))
        return self._spans(mean - half, mean + half)

    def outliers(self, level: float = 0.99) -> dict[str, float]:
        """Return the specimens that lie outside the population, with their probability.

        A specimen is listed if one of its unknowns deviates by more than chance explains among all
        specimens and unknowns (Bonferroni).

        Parameters
        ----------
        level : float
            Probability that no specimen of a normal population is listed.

        Returns
        -------
        dict of str to float
        """
        check_level(level, example=0.99)
        std = np.sqrt(np.diag(self.covariance))
        found = {}
        for name, one in self.specimens.items():
            size = np.abs(list(one.deviation.values()))
            ratio = np.divide(size, std, out=np.zeros_like(size), where=std > 0.0)
            share = 2.0 * ndtr(-ratio.max(initial=0.0)) * size.size * len(self.specimens)
            if share < 1.0 - level:
                found[name] = float(share)
        return found

    def to_pandas(self, level: float = 0.95) -> pd.DataFrame:
        """Return a table with a row for each unknown.

        Parameters
        ----------
        level : float
            Probability of the intervals.

        Returns
        -------
        pandas.DataFrame
            Index: ``unknown``. Columns: ``mean``, ``low``, ``high``, ``std``, ``std_low``,
            ``std_high`` and ``unit``.
        """
        import pandas as pd

        rows = [
            {
                "mean": self.mean[p.name],
                "low": low,
                "high": high,
                "std": self.std[p.name],
                "std_low": std_low,
                "std_high": std_high,
                "unit": p.value_unit,
            }
            for p, (low, high), (std_low, std_high) in zip(
                self.parameters,
                self.intervals(level).values(),
                self.std_intervals(level).values(),
                strict=True,
            )
        ]
        return pd.DataFrame(rows, index=pd.Index(self.parameters.names, name="unknown"))

    def to_dict(self, level: float = 0.95) -> dict[str, object]:
        """Return the population as plain values, for JSON.

        Parameters
        ----------
        level : float
            Probability of the intervals.

        Returns
        -------
        dict
            ``title``, ``level``, ``differs``, ``p_value``, ``correlated``, ``covariance``,
            ``excluded``, ``outliers``; ``unknowns``: a dict for each, with ``name``, ``unit``,
            ``mean``, ``interval``, ``std``, ``std_interval`` and ``prediction_interval``;
            ``specimens``: by name, with ``status``, ``values`` and ``std``.
        """
        spans, scatter = self.intervals(level), self.std_intervals(level)
        further = self.prediction_intervals(level)
        unknowns = [
            {
                "name": p.name,
                "unit": p.value_unit,
                "mean": self.mean[p.name],
                "interval": spans[p.name],
                "std": self.std[p.name],
                "std_interval": scatter[p.name],
                "prediction_interval": further[p.name],
            }
            for p in self.parameters
        ]
        specimens = {
            name: {"status": one.result.status, "values": one.values, "std": one.std}
            for name, one in self.specimens.items()
        }
        return {
            "title": self.title,
            "level": level,
            "differs": self.differs,
            "p_value": self.p_value,
            "correlated": self.correlated,
            "covariance": self.covariance.tolist(),
            "unknowns": unknowns,
            "specimens": specimens,
            "excluded": dict(self.excluded),
            "outliers": self.outliers(),
        }

    def summary(self) -> str:
        """Return mean and scatter of the unknowns as text, with 95 % intervals.

        Returns
        -------
        str
        """
        return f"{self.statement}\n\n{text_table(HEADINGS, self.rows())}"

    @property
    def statement(self) -> str:
        """Number of specimens, and whether they differ by more than the noise."""
        what = self.title or "Population"
        count = format_count(len(self.specimens), "specimen")
        if self.differs:
            return f"{what}: {count}; they differ by more than the noise of their tests."
        return f"{what}: {count}; the noise of the tests explains their differences."

    def rows(self) -> list[list[str]]:
        """Return the cells of a table with a row for each unknown.

        Returns
        -------
        list of list of str
        """
        spans, scatter = self.intervals(), self.std_intervals()
        return [
            [
                name,
                f"{self.mean[name]:.5g}",
                "{:.5g} to {:.5g}".format(*spans[name]),
                f"{self.std[name]:.3g}",
                "{:.3g} to {:.3g}".format(*scatter[name]),
            ]
            for name in self.mean
        ]

    def _repr_html_(self) -> str:
        facts = {"specimens": len(self.specimens), "unknowns": len(self.mean)}
        return card(self.statement, facts, table(HEADINGS, self.rows()))

    def __repr__(self) -> str:
        specimens = format_count(len(self.specimens), "specimen")
        return f"PopulationResult({specimens}, {format_count(len(self.mean), 'unknown')})"

    def _by_name(self, values: RealArray) -> dict[str, float]:
        return dict(zip(self.mean, values.tolist(), strict=True))

    def _spans(self, low: RealArray, high: RealArray) -> dict[str, tuple[float, float]]:
        return dict(zip(self.mean, zip(low.tolist(), high.tolist(), strict=True), strict=True))


HEADINGS = ("unknown", "mean", "95 % interval", "std", "95 % interval")
