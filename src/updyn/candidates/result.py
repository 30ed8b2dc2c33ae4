"""`ModelComparison`: candidate models by evidence and predictive score."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import logsumexp, stdtrit

from updyn.candidates.settings import CANDIDATES
from updyn.errors import OptionError, suggest
from updyn.notebook import card, table
from updyn.text_table import format_count, text_table
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CandidateRow", "ModelComparison", "rank_candidates"]

EVIDENCE, SCORE = "evidence", "predictive score"


@dataclass(frozen=True, slots=True, eq=False)
class CandidateRow:
    """One candidate model of a comparison.

    Attributes
    ----------
    name : str
        Its name.
    status, message : str
        Status of its fit and the explanation, as of `UpdateResult`.
    n_unknowns : int
        Number of its unknowns.
    undetermined : int
        Number of combinations of these that the data do not determine.
    log_evidence : float
        Natural logarithm of the evidence; -inf if the fit failed.
    band_scores : tuple of float
        Natural logarithm of the predictive density of each band that was held out, in the order of
        frequency; nan without a fit.
    residual : float
        Rms residual of the fit in standard deviations of the common noise; nan without a fit.
    adequate : bool
        Whether the residual is consistent with noise.
    result : UpdateResult or JointResult
        Its update.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> every = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> pairs = {"all": (model, every), "stiffness": (model, every[:4])}
    >>> row = updyn.compare_models(pairs, frf, starts=0)["all"]
    >>> row, row.undetermined, row.adequate
    (CandidateRow(all, converged), 0, True)
    """

    name: str
    status: str
    message: str
    n_unknowns: int
    undetermined: int
    log_evidence: float
    band_scores: tuple[float, ...]
    residual: float
    adequate: bool
    result: UpdateResult | JointResult = field(repr=False)

    @property
    def score(self) -> float:
        """Predictive score: the sum over the bands."""
        return float(sum(self.band_scores))

    @property
    def is_fitted(self) -> bool:
        """Whether the fit succeeded."""
        return math.isfinite(self.log_evidence)

    def __repr__(self) -> str:
        return f"CandidateRow({self.name}, {self.status})"


def rank_candidates(rows: Sequence[CandidateRow]) -> tuple[tuple[CandidateRow, ...], str]:
    """Return the rows, the best first, and the criterion that decides.

    If the residual of the candidate with the largest evidence is noise, the evidence decides;
    otherwise all models have errors and the predictive score decides. Of equal candidates the one
    with the fewest unknowns is first.
    """
    largest = max(rows, key=lambda row: row.log_evidence)
    if largest.adequate:
        least = largest.log_evidence - CANDIDATES.equal_log_odds
        tied = [row for row in rows if row.log_evidence >= least]
        order = sorted(rows, key=lambda row: -row.log_evidence)
    else:
        order = sorted(rows, key=lambda row: -row.score if row.is_fitted else math.inf)
        top = order[0]
        tied = [row for row in rows if row is top or _is_tied(row, top)]
    first = min(tied, key=lambda row: (row.n_unknowns, order.index(row)))
    others = [row for row in order if row is not first]
    return (first, *others), EVIDENCE if largest.adequate else SCORE


def _is_tied(row: CandidateRow, top: CandidateRow) -> bool:
    difference, error = _paired_difference(row, top)
    return difference >= -CANDIDATES.tied_errors * error


def _paired_difference(row: CandidateRow, other: CandidateRow) -> tuple[float, float]:
    """Return the difference of two scores and its standard error over the bands."""
    each = np.subtract(row.band_scores, other.band_scores)
    return float(each.sum()), float(np.sqrt(len(each)) * each.std(ddof=1))


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison(Sequence[CandidateRow]):
    """Candidate models of one structure, the best first: a sequence of `CandidateRow`.

    Attributes
    ----------
    rows : tuple of CandidateRow
        One row per candidate, the best first.
    criterion : {"evidence", "predictive score"}
        What decides the order: the evidence if the residual of the best candidate is noise,
        otherwise the predictive score, because every candidate has errors.
    bands : tuple of (float, float)
        First and last line of each band that was held out, in Hz, in the first test.
    title : str
        Title.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> every = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> pairs = {"all": (model, every), "stiffness": (model, every[:4])}
    >>> found = updyn.compare_models(pairs, frf, starts=0)
    >>> found, found.best
    (ModelComparison(2 candidates, best all), 'all')
    """

    rows: tuple[CandidateRow, ...]
    criterion: str
    bands: tuple[tuple[float, float], ...]
    title: str = ""

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: Any) -> Any:
        """Return a row by position or by the name of its candidate."""
        if not isinstance(item, str):
            return self.rows[item]
        names = [row.name for row in self.rows]
        if item not in names:
            raise OptionError(f"no candidate {item!r}; {suggest(item, names)}")
        return self.rows[names.index(item)]

    def __iter__(self) -> Iterator[CandidateRow]:
        return iter(self.rows)

    def __repr__(self) -> str:
        return f"ModelComparison({format_count(len(self), 'candidate')}, best {self.best})"

    def __str__(self) -> str:
        return self.summary()

    @property
    def best(self) -> str:
        """Name of the first candidate."""
        return self.rows[0].name

    @property
    def probabilities(self) -> dict[str, float]:
        """Posterior probability of each candidate by its evidence, if equal before the test."""
        logs = np.array([row.log_evidence for row in self.rows])
        if not np.isfinite(logs).any():
            return {row.name: math.nan for row in self.rows}
        shares = np.exp(logs - logsumexp(logs)).tolist()
        return dict(zip([row.name for row in self.rows], shares, strict=True))

    def log_odds(self, name: str) -> float:
        """Return the log evidence of a candidate less that of the first.

        Parameters
        ----------
        name : str
            The candidate.

        Returns
        -------
        float
        """
        if not self.rows[0].is_fitted:
            return math.nan
        return float(self[name].log_evidence - self.rows[0].log_evidence)

    def score_difference(self, name: str) -> tuple[float, float]:
        """Return the predictive score of a candidate less that of the first, and its error.

        Parameters
        ----------
        name : str
            The candidate.

        Returns
        -------
        difference, error : float
            The difference, and the standard error of the paired difference over the bands.
        """
        return _paired_difference(self[name], self.rows[0])

    def is_distinguishable(self, name: str) -> bool:
        """Return whether a candidate is worse than the first by more than chance explains.

        False if one of the fits failed.

        Parameters
        ----------
        name : str
            The candidate.

        Returns
        -------
        bool
        """
        if not (self.rows[0].is_fitted and self[name].is_fitted):
            return False
        if self.criterion == EVIDENCE:
            return self.log_odds(name) <= -CANDIDATES.strong_log_odds
        difference, error = self.score_difference(name)
        quantile = float(stdtrit(len(self.bands) - 1, 1.0 - 0.5 * CANDIDATES.significance))
        return difference < -quantile * error

    @property
    def distinguishable(self) -> bool:
        """Whether the first candidate is distinguishable from every other one."""
        return all(self.is_distinguishable(row.name) for row in self.rows[1:])

    @property
    def statement(self) -> str:
        """The outcome in a sentence or two."""
        first = self.rows[0]
        if not first.is_fitted:
            return "No candidate was fitted."
        text = f"{first.name} is first by {self.criterion}"
        fitted = [row.name for row in self.rows[1:] if row.is_fitted]
        others = [name for name in fitted if not self.is_distinguishable(name)]
        failed = [row.name for row in self.rows if not row.is_fitted]
        if others:
            text += f", not distinguishable from {', '.join(others)}"
        if failed:
            text += f"; the fit of {', '.join(failed)} failed"
        if self.criterion == SCORE:
            text += ". No candidate reproduces the data to the noise, which overstates the evidence"
        return f"{text}."

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each candidate.

        Returns
        -------
        pandas.DataFrame
            Index: ``candidate``. Columns: ``status``, ``unknowns``, ``undetermined``, ``residual``,
            ``log_evidence``, ``probability``, ``score``, ``score_difference`` and ``score_error``.
        """
        import pandas as pd

        rows = [self._figures(row) for row in self.rows]
        names = [row.name for row in self.rows]
        return pd.DataFrame(rows, index=pd.Index(names, name="candidate"))

    def _figures(self, row: CandidateRow) -> dict[str, Any]:
        difference, error = self.score_difference(row.name)
        return {
            "status": row.status,
            "unknowns": row.n_unknowns,
            "undetermined": row.undetermined,
            "residual": row.residual,
            "log_evidence": row.log_evidence,
            "probability": self.probabilities[row.name],
            "score": row.score,
            "score_difference": difference,
            "score_error": error,
        }

    def to_dict(self) -> dict[str, object]:
        """Return the comparison as plain values, for JSON.

        Returns
        -------
        dict
            ``title``, ``best``, ``criterion``, ``distinguishable``, ``statement``, ``bands`` (Hz)
            and ``candidates``: a dict for each, with the columns of `to_pandas`, ``message``,
            ``adequate``, ``band_scores`` and ``values`` of the unknowns.
        """
        candidates = []
        for row in self.rows:
            more = {
                "message": row.message,
                "adequate": row.adequate,
                "band_scores": list(row.band_scores),
                "values": dict(row.result.first.values),
            }
            candidates.append({"name": row.name, **self._figures(row), **more})
        return {
            "title": self.title,
            "best": self.best,
            "criterion": self.criterion,
            "distinguishable": self.distinguishable,
            "statement": self.statement,
            "bands": [list(band) for band in self.bands],
            "candidates": candidates,
        }

    def summary(self) -> str:
        """Return the comparison as text: the outcome and a table of the candidates.

        Returns
        -------
        str
        """
        head = f"{self.title}: {self.statement}" if self.title else self.statement
        lines = [head, "", text_table(HEADINGS, self.cells(), left=(0, 1)), "", ABOUT]
        for row in self.rows:
            if not row.is_fitted:
                lines.append(f"{row.name} {row.status}: {row.message}")
        return "\n".join(lines)

    def cells(self) -> list[list[str]]:
        """Return the rows of the table as text, with the columns of the summary.

        Returns
        -------
        list of list of str
        """
        return [self._cells_of(row) for row in self.rows]

    def _cells_of(self, row: CandidateRow) -> list[str]:
        cells = [row.name, row.status, str(row.n_unknowns)]
        if not row.is_fitted:
            return cells + ["-"] * 4
        difference, error = self.score_difference(row.name)
        score = "0" if row is self.rows[0] else f"{difference:.1f} +- {error:.1f}"
        odds = f"{self.log_odds(row.name):.1f}"
        return [*cells, str(row.undetermined), f"{row.residual:.3g}", odds, score]

    def _repr_html_(self) -> str:
        facts = {"candidates": len(self), "criterion": self.criterion}
        return card(self.statement, facts, table(HEADINGS, self.cells(), left=(0, 1)))


HEADINGS = (
    "candidate",
    "status",
    "unknowns",
    "undetermined",
    "residual",
    "log evidence",
    "predictive score",
)
ABOUT = (
    "undetermined: combinations of the unknowns that the data do not determine; residual: rms in"
    " standard deviations of the noise; log evidence and predictive score: less those of the first"
    " candidate, the score with its standard error."
)
