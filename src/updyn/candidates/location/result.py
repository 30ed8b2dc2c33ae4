"""`NonlinearityLocation`: candidates of place and kind of a nonlinear element, the best first."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import logsumexp

from updyn.candidates.location.settings import LOCATION
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.parameters import list_parameters, parameter_unit
from updyn.notebook import card, table
from updyn.text_table import format_count, text_table
from updyn.updating.judge.causes.settings import CAUSE_ODDS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LocationRow", "NonlinearityLocation"]


@dataclass(frozen=True, slots=True, eq=False)
class LocationRow:
    """One candidate: an element of a kind at a place, fitted to all levels.

    Attributes
    ----------
    place, kind : str
        Names of its place and its kind.
    element : NonlinearElement
        The element with the estimated parameters.
    std : mapping of str to float
        Standard deviations of these by name; infinite if the data do not determine one.
    values : mapping of str to float
        Estimated linear unknowns by name.
    n_unknowns : int
        Number of unknowns, those of the element included.
    log_evidence : float
        Natural logarithm of the evidence, less that of the best candidate.
    residual : float
        Rms residual in standard deviations of the noise.
    model : Model
        The model with the element and the estimated values.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> about = "joint", "cubic-spring", updyn.CubicSpring(1e8), {"coefficient": 2e5}
    >>> row = updyn.LocationRow(*about, {}, 1, 0.0, 1.0, chain.build())
    >>> row.parameters
    'coefficient 1e+08 +- 2e+05 N/m^3'
    """

    place: str
    kind: str
    element: NonlinearElement
    std: Mapping[str, float]
    values: Mapping[str, float]
    n_unknowns: int
    log_evidence: float
    residual: float
    model: Model

    @property
    def parameters(self) -> str:
        """Estimated parameters of the element with their standard deviations and units."""
        parts, values = [], list_parameters(self.element)
        rotates = next((local.rotates for local in self.model.nonlinear.values()), False)
        for name, std in self.std.items():
            unit = parameter_unit(self.element, name, rotates=rotates)
            parts.append(f"{name} {values[name]:.4g} +- {std:.1g} {unit}".rstrip())
        return ", ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class NonlinearityLocation(Sequence[LocationRow]):
    """Candidates of place and kind of a local nonlinearity, the best first.

    Attributes
    ----------
    rows : tuple of LocationRow
        The candidates that were fitted exactly.
    places : mapping of str to float
        Rms residual in standard deviations of the noise of an element of any kind, by place, in
        ascending order.
    linear : float
        Logarithm of the evidence of the linear model, less that of the best candidate.
    linear_residual : float
        Rms residual of the linear model, in standard deviations of the noise.
    is_adequate : bool
        Whether the residual of the best candidate is consistent with noise. If not, the noise is
        increased for the odds until it is.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> about = {}, {}, 1, 0.0, 1.0, chain.build()
    >>> row = updyn.LocationRow("joint", "cubic-spring", updyn.CubicSpring(1e8), *about)
    >>> found = updyn.NonlinearityLocation((row,), {"joint": 1.0}, -300.0, 7.0, True)
    >>> found, found.distinguishable, found.is_likely
    (NonlinearityLocation(1 candidate, best cubic-spring at joint), True, True)
    """

    rows: tuple[LocationRow, ...]
    places: Mapping[str, float]
    linear: float
    linear_residual: float
    is_adequate: bool

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: Any) -> Any:
        """Return a row by position."""
        return self.rows[item]

    def __iter__(self) -> Iterator[LocationRow]:
        return iter(self.rows)

    def __repr__(self) -> str:
        best = f"{self.best.kind} at {self.best.place}"
        return f"NonlinearityLocation({format_count(len(self), 'candidate')}, best {best})"

    def __str__(self) -> str:
        return self.summary()

    @property
    def best(self) -> LocationRow:
        """The first candidate."""
        return self.rows[0]

    @property
    def is_likely(self) -> bool:
        """Whether the best candidate is likelier than the linear model, at odds of 100 to 1."""
        return self.linear < -CAUSE_ODDS.likely_log_odds

    @property
    def indistinguishable(self) -> tuple[LocationRow, ...]:
        """Candidates other than the first, at odds of at most 20 to 1 against them."""
        limit = -CAUSE_ODDS.indistinct_log_odds
        return tuple(row for row in self.rows[1:] if row.log_evidence >= limit)

    @property
    def distinguishable(self) -> bool:
        """Whether the first candidate is distinguishable from every other one."""
        return not self.indistinguishable

    @property
    def place_is_distinguishable(self) -> bool:
        """Whether the place of the first candidate is that of all that are not distinguishable."""
        return all(row.place == self.best.place for row in self.indistinguishable)

    @property
    def probabilities(self) -> tuple[float, ...]:
        """Posterior probability of each candidate by its evidence, if equal before the test."""
        logs = np.array([row.log_evidence for row in self.rows])
        return tuple(np.exp(logs - logsumexp(logs)).tolist())

    @property
    def statement(self) -> str:
        """The outcome in a sentence or two."""
        if not self.is_likely:
            return (
                "No nonlinear element is needed: the linear model fits all levels about as well"
                f" (log odds {-self.linear:.1f} for {self.best.kind} at {self.best.place})."
            )
        text = f"{self.best.kind} at {self.best.place}: {self.best.parameters}"
        others = [f"{row.kind} at {row.place}" for row in self.indistinguishable]
        if others:
            text += f"; not distinguishable from {', '.join(others)}"
        if not self.is_adequate:
            text += (
                f". Its residual is {self.best.residual:.3g} times the noise: the linear model, or"
                " the element, is not exact"
            )
        return f"{text}."

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each candidate.

        Returns
        -------
        pandas.DataFrame
            Columns: ``place``, ``kind``, ``unknowns``, ``residual``, ``log_evidence``,
            ``probability`` and ``parameters``.
        """
        import pandas as pd

        rows = [
            {
                "place": row.place,
                "kind": row.kind,
                "unknowns": row.n_unknowns,
                "residual": row.residual,
                "log_evidence": row.log_evidence,
                "probability": probability,
                "parameters": row.parameters,
            }
            for row, probability in zip(self.rows, self.probabilities, strict=True)
        ]
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, object]:
        """Return the candidates as plain values, for JSON.

        Returns
        -------
        dict
            ``statement``, ``likely`` (whether an element is likelier than the linear model),
            ``place_distinguishable``, ``distinguishable``, ``adequate``, ``linear`` (``residual``
            and ``log_evidence``), ``places`` (residual by place) and ``elements``: a dict for each
            candidate, with ``place``, ``kind``, ``parameters`` and ``std`` by name in SI units,
            ``values`` of the linear unknowns, ``unknowns`` (their number), ``residual``,
            ``log_evidence`` and ``probability``.
        """
        elements = []
        for row, probability in zip(self.rows, self.probabilities, strict=True):
            elements.append(
                {
                    "place": row.place,
                    "kind": row.kind,
                    "parameters": dict(list_parameters(row.element)),
                    "std": dict(row.std),
                    "values": dict(row.values),
                    "unknowns": row.n_unknowns,
                    "residual": row.residual,
                    "log_evidence": row.log_evidence,
                    "probability": probability,
                }
            )
        return {
            "statement": self.statement,
            "likely": self.is_likely,
            "place_distinguishable": self.place_is_distinguishable,
            "distinguishable": self.distinguishable,
            "adequate": self.is_adequate,
            "linear": {"residual": self.linear_residual, "log_evidence": self.linear},
            "places": dict(self.places),
            "elements": elements,
        }

    def summary(self) -> str:
        """Return the candidates as text: the outcome, a table of them, and one of the places.

        Returns
        -------
        str
        """
        shown = list(self.places.items())[: LOCATION.shown_places]
        places = text_table(("place", "residual"), [(name, f"{x:.3g}") for name, x in shown])
        lines = [self.statement, "", text_table(HEADINGS, self.cells(), left=(0, 1, 5))]
        return "\n".join([*lines, "", ABOUT, "", places])

    def cells(self) -> list[list[str]]:
        """Return the rows of the table as text, with the columns of the summary.

        Returns
        -------
        list of list of str
        """
        out = []
        for row in self.rows:
            figures = [str(row.n_unknowns), f"{row.residual:.3g}", f"{row.log_evidence:.1f}"]
            out.append([row.place, row.kind, *figures, row.parameters])
        if math.isfinite(self.linear):
            figures = ["", f"{self.linear_residual:.3g}", f"{self.linear:.1f}"]
            out.append(["-", "linear", *figures, ""])
        return out

    def _repr_html_(self) -> str:
        facts = {"candidates": len(self), "places": len(self.places)}
        return card(self.statement, facts, table(HEADINGS, self.cells(), left=(0, 1, 5)))


HEADINGS = ("place", "kind", "unknowns", "residual", "log evidence", "parameters")
ABOUT = (
    "residual: rms in standard deviations of the noise; log evidence: less that of the first"
    " candidate. Places: residual of an element of any kind."
)
