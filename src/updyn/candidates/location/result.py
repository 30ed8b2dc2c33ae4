"""`NonlinearityLocation`, candidates of an element, and `LocatedNonlinearities`, those found."""

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

__all__ = ["LocatedElement", "LocatedNonlinearities", "LocationRow", "NonlinearityLocation"]


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
        # The candidate is the last element of its model.
        turns = [local.rotates for local in self.model.nonlinear.values()]
        return _format_parameters(self.element, self.std, turns[-1] if turns else False)


def _format_parameters(
    element: NonlinearElement, deviations: Mapping[str, float], rotates: bool | None
) -> str:
    """Return parameters with their standard deviations and units."""
    parts, values = [], list_parameters(element)
    for name, std in deviations.items():
        unit = parameter_unit(element, name, rotates=rotates)
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
    depends_on_level : bool
        Whether the FRFs depend on the level (`updyn.detect_nonlinearity`). If not, an element can
        only make up for errors of the linear model.

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
    depends_on_level: bool = True

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
        """Whether the best candidate is likelier than the linear model, at odds of 100 to 1.

        False if the FRFs do not depend on the level.
        """
        return self.depends_on_level and self.linear < -CAUSE_ODDS.likely_log_odds

    @property
    def close_rows(self) -> tuple[LocationRow, ...]:
        """The first candidate and those at odds of at most 20 to 1 against them."""
        return (self.best, *self.indistinguishable)

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
        if not self.depends_on_level:
            return "No nonlinear element is needed: the FRFs do not depend on the level."
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


@dataclass(frozen=True, slots=True, eq=False)
class LocatedElement:
    """One of the nonlinear elements that were found in a structure.

    Attributes
    ----------
    name : str
        Name of the element in the model.
    place, kind : str
        Names of its place and its kind.
    element : NonlinearElement
        The element with the estimated parameters.
    std : mapping of str to float
        Standard deviations of these by name; infinite if the data do not determine one.
    log_odds : float
        Natural logarithm of the odds of the model over the model without this element, whose other
        unknowns are fitted again.
    search : NonlinearityLocation
        The search in which it was found, with the elements that were known then.
    model : Model
        The model with all elements.

    Examples
    --------
    >>> import numpy as np
    >>> spring = updyn.CubicSpring(1e8)
    >>> group = updyn.Group(np.diag([1e4]), mass=np.eye(1))
    >>> model = updyn.Model.from_groups({"k": group}, ["1:X"]).with_elements({"a": (spring, "1:X")})
    >>> about = "a", "ground", "cubic-spring", spring, {"coefficient": 2e5}
    >>> row = updyn.LocationRow("ground", "cubic-spring", spring, {}, {}, 1, 0.0, 1.0, model)
    >>> search = updyn.NonlinearityLocation((row,), {"ground": 1.0}, -300.0, 7.0, True)
    >>> one = updyn.LocatedElement(*about, 300.0, search, model)
    >>> one.parameters, one.alternatives
    ('coefficient 1e+08 +- 2e+05 N/m^3', ())
    """

    name: str
    place: str
    kind: str
    element: NonlinearElement
    std: Mapping[str, float]
    log_odds: float
    search: NonlinearityLocation
    model: Model

    @property
    def parameters(self) -> str:
        """Estimated parameters with their standard deviations and units."""
        return _format_parameters(self.element, self.std, self.model.nonlinear[self.name].rotates)

    @property
    def alternatives(self) -> tuple[LocationRow, ...]:
        """Candidates that the data do not distinguish from the element."""
        here = self.place, self.kind
        return tuple(row for row in self.search.close_rows if (row.place, row.kind) != here)


@dataclass(frozen=True, slots=True, eq=False)
class LocatedNonlinearities(Sequence[LocatedElement]):
    """Nonlinear elements of a structure, in the order in which they were found.

    Attributes
    ----------
    elements : tuple of LocatedElement
        The elements, none for a linear structure.
    values : mapping of str to float
        Estimated other unknowns by name.
    residual : float
        Rms residual of the model with all elements, in standard deviations of the noise.
    linear_residual : float
        That of the model without them.
    is_adequate : bool
        Whether the residual is consistent with noise.
    model : Model
        The model with all elements and the estimated values.
    further : NonlinearityLocation or None
        The search for one more element, which was not supported; None if `most` were found, or no
        candidate can be solved.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> found = updyn.LocatedNonlinearities((), {}, 1.0, 1.0, True, chain.build(), None)
    >>> found, len(found), found.distinguishable
    (LocatedNonlinearities(none), 0, True)
    """

    elements: tuple[LocatedElement, ...]
    values: Mapping[str, float]
    residual: float
    linear_residual: float
    is_adequate: bool
    model: Model
    further: NonlinearityLocation | None

    def __len__(self) -> int:
        return len(self.elements)

    def __getitem__(self, item: Any) -> Any:
        """Return an element by position."""
        return self.elements[item]

    def __iter__(self) -> Iterator[LocatedElement]:
        return iter(self.elements)

    def __repr__(self) -> str:
        named = ", ".join(f"{one.kind} at {one.place}" for one in self.elements)
        return f"LocatedNonlinearities({named or 'none'})"

    def __str__(self) -> str:
        return self.summary()

    @property
    def distinguishable(self) -> bool:
        """Whether each element is distinguishable from other candidates."""
        return not any(one.alternatives for one in self.elements)

    @property
    def statement(self) -> str:
        """The outcome: the elements, and whether the residual is noise."""
        text = "No nonlinear element is needed: the model fits all levels about as well"
        parts = []
        for one in self.elements:
            others = [f"{row.kind} at {row.place}" for row in one.alternatives]
            end = f" (not distinguishable from {', '.join(others)})" if others else ""
            parts.append(f"{one.kind} at {one.place}: {one.parameters}{end}")
        text = "; ".join(parts) or text
        if not self.is_adequate:
            text += (
                f". The residual is {self.residual:.3g} times the noise: the model, or an element,"
                " is not exact"
            )
        return f"{text}."

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each element.

        Returns
        -------
        pandas.DataFrame
            Columns: ``name``, ``place``, ``kind``, ``log_odds`` and ``parameters``.
        """
        import pandas as pd

        names = ("name", "place", "kind", "log_odds", "parameters")
        return pd.DataFrame([{key: getattr(one, key) for key in names} for one in self.elements])

    def to_dict(self) -> dict[str, object]:
        """Return the elements as plain values, for JSON.

        Returns
        -------
        dict
            ``statement``, ``adequate``, ``residual``, ``linear_residual``, ``values`` of other
            unknowns by name, ``found``: a dict for each element, with ``name``, ``place``,
            ``kind``, ``parameters`` and ``std`` by name in SI units, ``log_odds`` and ``search``
            (`NonlinearityLocation.to_dict`), and ``further``, the last search, or None.
        """
        found = []
        for one in self.elements:
            found.append(
                {
                    "name": one.name,
                    "place": one.place,
                    "kind": one.kind,
                    "parameters": dict(list_parameters(one.element)),
                    "std": dict(one.std),
                    "log_odds": one.log_odds,
                    "search": one.search.to_dict(),
                }
            )
        return {
            "statement": self.statement,
            "adequate": self.is_adequate,
            "residual": self.residual,
            "linear_residual": self.linear_residual,
            "values": dict(self.values),
            "found": found,
            "further": None if self.further is None else self.further.to_dict(),
        }

    def summary(self) -> str:
        """Return the elements as text: the outcome, a table, and the search for one more.

        Returns
        -------
        str
        """
        lines = [self.statement, "", text_table(FOUND_HEADINGS, self.cells(), left=(0, 1, 3))]
        lines.append(f"\nResidual {self.residual:.3g}, linear model {self.linear_residual:.3g}.")
        if self.further is not None and self.elements:
            lines += ["", "One more element:", "", self.further.summary()]
        return "\n".join(lines)

    def cells(self) -> list[list[str]]:
        """Return the rows of the table as text, with the columns of the summary.

        Returns
        -------
        list of list of str
        """
        return [
            [one.place, one.kind, f"{one.log_odds:.1f}", one.parameters] for one in self.elements
        ]

    def _repr_html_(self) -> str:
        facts = {"elements": len(self)}
        return card(self.statement, facts, table(FOUND_HEADINGS, self.cells(), left=(0, 1, 3)))


FOUND_HEADINGS = ("place", "kind", "log odds", "parameters")
