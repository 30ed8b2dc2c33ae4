"""`Acceptance`: the requirements on a model, with their outcomes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from updyn.acceptance.limits import AcceptanceLimits
from updyn.acceptance.requirement import FAIL, OPEN, PASS, REQUIREMENT_KINDS, Requirement
from updyn.notebook import card, table
from updyn.text_table import format_count, text_table

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Acceptance"]

_HEADER = ("measured (Hz)", "computed (Hz)", "requirement", "value", "limit", "outcome")


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """Acceptance of a model by the limits of a standard.

    Attributes
    ----------
    limits : AcceptanceLimits
        The limits.
    requirements : tuple of Requirement
        The requirements, by measured mode.
    title : str
        Title of the model.
    notes : tuple of str
        Remarks on the comparison.
    least_probability : float, optional
        Probability by which the outcomes are decided; None: by the values as measured.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> modes, sensors = updyn.modes(model, 3), ["2:X", "5:X", "7:X", "10:X", "12:X"]
    >>> measured = updyn.ModeSet(modes.frequency, modes.at(sensors), sensors)
    >>> found = updyn.accept(model, measured, updyn.AcceptanceLimits(frequency=0.05, mac=0.9))
    >>> found.outcome, found.accepted
    ('pass', True)
    """

    limits: AcceptanceLimits
    requirements: tuple[Requirement, ...]
    title: str = ""
    notes: tuple[str, ...] = ()
    least_probability: float | None = None

    def __repr__(self) -> str:
        return (
            f"Acceptance({self.limits.name}: {self.outcome}, {len(self.requirements)} requirements)"
        )

    @property
    def outcome(self) -> str:
        """Fail if one requirement fails, else not decidable if one is, else pass."""
        outcomes = {one.outcome for one in self.requirements}
        if FAIL in outcomes:
            return FAIL
        return OPEN if OPEN in outcomes or not outcomes else PASS

    @property
    def accepted(self) -> bool:
        """Whether all requirements pass."""
        return self.outcome == PASS

    @property
    def probability(self) -> tuple[float, float]:
        """Lower and upper bound of the probability that all limits are met; nan if not known.

        The bounds hold for any dependence of the requirements (Boole, Frechet).
        """
        found = [one.probability for one in self.requirements if not np.isnan(one.limit)]
        if not found or np.isnan(found).any():
            return np.nan, np.nan
        return max(0.0, 1.0 - sum(1.0 - p for p in found)), min(found)

    @property
    def statement(self) -> str:
        """The outcome with its counts, in one sentence."""
        counts = {
            name: sum(one.outcome == name for one in self.requirements) for name in (FAIL, OPEN)
        }
        of = format_count(len(self.requirements), "requirement")
        parts = [f"{counts[name]} {words}" for name, words in _COUNTED.items() if counts[name]]
        told = f"{' and '.join(parts)} of {of}" if parts else f"all of {of} pass"
        return f"Acceptance by {self.limits.name}: {self.outcome}; {told}."

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """Return header and rows of the table of requirements as text.

        Returns
        -------
        header : list of str
        rows : list of list of str
        """
        header = [*_HEADER, "probability", "as delivered", "note"]
        rows = []
        for one in self.requirements:
            frequencies = [_format(f, "#.5g") for f in (one.measured, one.computed)]
            bound = ("at most " if one.is_upper else "at least ") * (not np.isnan(one.limit))
            numbers = [one.format_number(one.value), bound + one.format_number(one.limit)]
            odds = [_format(p, ".3f") for p in (one.probability, one.probability_as_delivered)]
            name = REQUIREMENT_KINDS[one.kind]
            rows.append([*frequencies, name, *numbers, one.outcome, *odds, one.note])
        return header, rows

    def summary(self) -> str:
        """Return the statement, the requirements and the notes as text."""
        header, rows = self.rows()
        texts = [self.statement, text_table(header, rows, left=(2, 5, 8))]
        return "\n".join([*texts, *self.notes])

    def _repr_html_(self) -> str:
        facts = {"standard": self.limits.name, "outcome": self.outcome}
        return card("Acceptance", facts, table(*self.rows()), "<br>".join(self.notes))

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each requirement.

        Returns
        -------
        pandas.DataFrame
            Columns as the attributes of `Requirement`.
        """
        import pandas as pd

        names = list(Requirement.__dataclass_fields__)
        rows = [[getattr(one, name) for name in names] for one in self.requirements]
        return pd.DataFrame(rows, columns=names)


_COUNTED = {FAIL: "fail", OPEN: "not decidable"}


def _format(value: float, form: str) -> str:
    return "-" if np.isnan(value) else format(value, form).rstrip(".")
