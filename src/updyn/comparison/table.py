"""`Comparison`: the results of several methods, one row each, and the table of them as text."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np

from updyn.comparison.fewest import Fewest
from updyn.correlation.figures import ONE_AT_BEST
from updyn.errors import OptionError, suggest
from updyn.text_table import text_table
from updyn.updating.fit.methods import METHODS
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import CHANNELS, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "COLUMNS",
    "NOT_APPLICABLE",
    "Comparison",
    "Row",
    "cells",
    "columns",
    "figures_of",
    "limits",
    "listing",
    "method_facts",
    "reason",
    "summary",
]

#: Status of a method that cannot be used on the data or the unknowns.
NOT_APPLICABLE = "does not apply"

#: Statuses of a fit that has arrived where its method leads.
_SETTLED = ("converged", "not-identifiable")

#: Quantities of damping, the structural one first.
_DAMPING = ("loss_factor", "viscous", "mass_damping", "stiffness_damping")

#: Figures that are larger where the agreement is better, by the beginning of their names.
_LARGER_IS_BETTER = (*ONE_AT_BEST, "modes_")

_Figures = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """The result of one method.

    Attributes
    ----------
    method : str
        Its name.
    reference : str
        Its publication, in short.
    status : str
        As of `updyn.UpdateResult`, or ``"does not apply"``.
    message : str
        The cause, in a sentence; why it does not apply.
    cannot : tuple of str
        Quantities that it cannot update, whatever the data.
    needs : str
        What it needs of the data beyond what the default method does; may be empty.
    updated : tuple of str
        Unknowns that it was run with.
    left : tuple of str
        Unknowns left at their start, because it cannot update their quantities.
    values, std : mapping of str to float
        By unknown; those left stand at their start, with standard deviation nan. Empty where it
        does not apply.
    errors : mapping of str to float
        Errors of the estimate where the truth is known, as of `errors_against`. Unknowns left at
        their start are included.
    off : mapping of str to float
        Estimate minus truth, in the unit of the unknown, where the truth is known.
    fitted, held_out : mapping of str to mapping of str to float
        ``before`` and ``after``: figures of agreement with the data of the fit and with the
        validation set (``db_error_median``, ``frac_median``, ...). Of several tests the worst.
    rank : int
        Number of independent combinations of its unknowns that the data determine.
    iterations : int
        Accepted steps, those of its search included.
    lines_solved : int
        Lines at which the model was solved up to the last step.
    n_lines : int
        Lines of the data that were fitted.
    seconds : float
        Time of the whole update, in s.
    fewest : Fewest or None
        The fewest lines with which it still recovers; None where that was not sought.
    result : UpdateResult, JointResult or None
        The full result; None where it does not apply.
    """

    method: str
    reference: str
    status: str
    message: str
    cannot: tuple[str, ...] = ()
    needs: str = ""
    updated: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    std: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    off: Mapping[str, float] = field(default_factory=dict)
    fitted: _Figures = field(default_factory=dict)
    held_out: _Figures = field(default_factory=dict)
    rank: int = 0
    iterations: int = 0
    lines_solved: int = 0
    n_lines: int = 0
    seconds: float = math.nan
    fewest: Fewest | None = None
    result: UpdateResult | JointResult | None = field(default=None, repr=False)

    @property
    def applies(self) -> bool:
        """Whether the method could be run."""
        return self.status != NOT_APPLICABLE

    @property
    def error_max(self) -> float:
        """Largest size of `errors`.

        inf where one of these unknowns is not determined: its value depends on the path of the fit.
        nan where the truth is not known.
        """
        return max(self._sizes(self.errors), default=math.nan)

    @property
    def error_rms(self) -> float:
        """Root of the mean square of `errors`; inf and nan as of `error_max`."""
        if not self.errors:
            return math.nan
        squares = sum(size * size for size in self._sizes(self.errors))
        return math.sqrt(squares / len(self.errors))

    @property
    def error_max_updated(self) -> float:
        """Largest size of `errors` of the unknowns that it was run with, as of `error_max`."""
        updated = [name for name in self.errors if name in self.updated]
        return max(self._sizes(updated), default=math.nan)

    def _sizes(self, names: Iterable[str]) -> list[float]:
        """Return the sizes of errors, inf of unknowns that are not determined."""
        return [
            math.inf if self.std.get(name) == math.inf else abs(self.errors[name]) for name in names
        ]

    @property
    def off_in_std(self) -> float:
        """Largest distance from the truth in standard deviations of the method.

        Below about 3 where these are right; nan where the truth is not known or no unknown has a
        finite standard deviation.
        """
        largest = math.nan
        for name, off in self.off.items():
            std = self.std.get(name, math.nan)
            if 0.0 < std < math.inf:
                largest = np.fmax(largest, abs(off) / std)
        return float(largest)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Sequence[Row]):
    """Results of several methods: a sequence of `Row`, in the order in which they were run.

    Attributes
    ----------
    rows : tuple of Row
        One for each method.
    tests : tuple of Test
        The tests, with the lines that all methods fitted.
    parameters : ParameterSet
        The unknowns.
    truth : mapping of str to float
        True values, as far as they are known.
    tolerance : float
        Error below which an unknown counts as recovered, against the truth or against the method's
        own estimate with all lines.
    rule : str
        How the fewest lines were sought; empty where they were not.
    stopped : bool
        Whether the user stopped it.
    not_run : tuple of str
        Methods that were not run because of that.
    title : str
        For the record.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> found = updyn.compare(model, frf, unknowns, ["equation-error", "log"])
    >>> [row.method for row in found]
    ['equation-error', 'log']
    """

    rows: tuple[Row, ...]
    tests: tuple[Test, ...]
    parameters: ParameterSet
    truth: Mapping[str, float] = field(default_factory=dict)
    tolerance: float = math.nan
    rule: str = ""
    stopped: bool = False
    not_run: tuple[str, ...] = ()
    title: str = ""

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, item: int | str) -> Row: ...
    @overload
    def __getitem__(self, item: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, item: int | str | slice) -> Row | tuple[Row, ...]:
        """Return a row by its place or by the name of its method."""
        if not isinstance(item, str):
            return self.rows[item]
        methods = [row.method for row in self.rows]
        if item not in methods:
            raise OptionError(f"no method {item!r} in this comparison; {suggest(item, methods)}")
        return self.rows[methods.index(item)]

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __repr__(self) -> str:
        run = sum(row.applies for row in self.rows)
        return (
            f"Comparison({len(self.rows)} methods, {run} of them run, {len(self.parameters)}"
            " unknowns)"
        )

    @property
    def before(self) -> Mapping[str, float]:
        """Figures of agreement of the start with the fitted data; empty if no method was run."""
        for row in self.rows:
            if row.fitted.get("before"):
                return row.fitted["before"]
        return {}

    def summary(self) -> str:
        """Return the comparison as text: the table, and the reasons for what was not run."""
        return summary(self)


def method_facts(name: str) -> dict[str, Any]:
    """Return what a row states of a method without running it.

    Returns
    -------
    dict
        ``method``, ``reference``, ``cannot``, ``needs``, as of `Row`.
    """
    method = METHODS.find(name)
    cannot = tuple(method.cannot)
    if not method.calibrates:
        cannot = tuple(dict.fromkeys([*cannot, *CHANNELS]))
    return {
        "method": name,
        "reference": method.reference,
        "cannot": cannot,
        "needs": method.needs,
    }


def figures_of(result: UpdateResult | JointResult) -> tuple[_Figures, _Figures]:
    """Return the figures of agreement with the fitted data and with the validation set.

    Of several tests the worst figure is taken.
    """
    fitted, held_out = [], []
    for one in result.results.values():
        fitted.append(one.correlation)
        held_out.append(one.correlation.get("validation") or {})
    if not any(held_out):
        return _worst(fitted), {}
    return _worst(fitted), _worst(held_out)


def _worst(tests: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Return ``before`` and ``after``: each figure of the test that agrees worst."""
    out: dict[str, dict[str, float]] = {}
    for when in ("before", "after"):
        out[when] = {}
        for figures in tests:
            for name, value in (figures.get(when) or {}).items():
                known = out[when].get(name, value)
                worse = np.minimum if name.startswith(_LARGER_IS_BETTER) else np.maximum
                out[when][name] = float(worse(known, value))
    return out


# -- as text -----------------------------------------------------------------------------------
Column = tuple[str, str, "Callable[[Row], str]"]


def _figure(figures: _Figures, row: Row, name: str) -> str:
    """Return a figure of agreement after the fit; none of a failed one, which ends at its start."""
    value = (figures.get("after") or {}).get(name, math.nan)
    if row.status == "failed" or math.isnan(value):
        return "-"
    if not name.startswith("db_"):
        return f"{value:.4f}"
    if value < 1e-9:  # rounding of an exact fit
        return "0 dB"
    return f"{value:.2g} dB"


def _number(value: float) -> str:
    if math.isnan(value):
        return "-"
    if value == 0.0:
        return "0"
    return f"{value:.2g}"


def _error(row: Row, value: float) -> str:
    if row.status == "failed":
        return "-"
    return "undetermined" if math.isinf(value) else _number(value)


def _fewest(row: Row) -> str:
    if row.fewest is None:
        return "-"
    if row.fewest.count is not None:
        return str(row.fewest.count)
    return "-" if row.fewest.note else "none"


def reason(row: Row) -> str:
    """Return why a method does not apply or has not arrived; empty where it has."""
    if row.status in _SETTLED:
        return ""
    return row.message


def limits(row: Row) -> str:
    """Return what a method cannot update and what it needs, in words."""
    texts = []
    if row.cannot:
        texts.append(_quantities(row.cannot))
    if row.needs:
        texts.append(f"needs {row.needs}")
    return "; ".join(texts) or "-"


def _quantities(names: Sequence[str]) -> str:
    """Return quantities in words, calibration factors together and kinds of damping together."""
    given = set(names)
    others, calibration, damping = [], [], []
    for name in names:
        if name in CHANNELS:
            calibration.append(name)
        elif name in _DAMPING:
            damping.append(name)
        else:
            others.append(name)
    if given.issuperset(CHANNELS):
        calibration = ["calibration"]
    if given.issuperset(_DAMPING):
        damping = ["damping"]
    elif given.issuperset(_DAMPING[1:]):
        damping = ["viscous damping"]
    return ", ".join([*others, *calibration, *damping]).replace("_", " ")


#: Key, heading and content of every column.
COLUMNS: tuple[Column, ...] = (
    ("method", "method", lambda r: r.method),
    ("status", "status", lambda r: r.status),
    ("unknowns", "unknowns", lambda r: f"{len(r.updated)} of {len(r.updated) + len(r.left)}"),
    ("rank", "rank", lambda r: "-" if r.status == "failed" else str(r.rank)),
    ("fewest", "min lines", _fewest),
    ("db", "misfit", lambda r: _figure(r.fitted, r, "db_error_median")),
    ("frac", "FRAC", lambda r: _figure(r.fitted, r, "frac_median")),
    ("held_db", "held out", lambda r: _figure(r.held_out, r, "db_error_median")),
    ("held_frac", "FRAC held out", lambda r: _figure(r.held_out, r, "frac_median")),
    ("error_max", "error", lambda r: _error(r, r.error_max)),
    ("error_rms", "rms", lambda r: _error(r, r.error_rms)),
    ("iterations", "steps", lambda r: str(r.iterations)),
    ("lines_solved", "solved", lambda r: str(r.lines_solved)),
    ("seconds", "seconds", lambda r: _number(r.seconds)),
    ("limits", "cannot update", limits),
)
#: Columns of a method that does not apply.
_KNOWN_WITHOUT_RUNNING = ("method", "status", "limits")


def columns(comparison: Comparison) -> list[Column]:
    """Return the columns that have something to show."""
    empty = set()
    if not any(row.held_out for row in comparison):
        empty |= {"held_db", "held_frac"}
    if not comparison.truth:
        empty |= {"error_max", "error_rms"}
    if not comparison.rule:
        empty |= {"fewest"}
    return [column for column in COLUMNS if column[0] not in empty]


def cells(row: Row, shown: Sequence[Column]) -> list[str]:
    """Return the cells of a row; of a method that does not apply only the facts of the method."""
    out = []
    for key, _, content in shown:
        if row.applies or key in _KNOWN_WITHOUT_RUNNING:
            out.append(content(row))
        else:
            out.append("")
    return out


def summary(comparison: Comparison) -> str:
    """Return the table and, below it, notes on methods, unknowns and lines."""
    shown = columns(comparison)
    n_lines = max((row.n_lines for row in comparison), default=0)
    head = f"{comparison.title or 'Comparison'}: {len(comparison.parameters)} unknowns"
    head += f", {n_lines} lines"
    start = comparison.before
    if start:
        head += f"; before: {start['db_error_median']:.3g} dB, FRAC {start['frac_median']:.4f}"
    headings = [heading for _, heading, _ in shown]
    lines = [head, "", _table(headings, [cells(row, shown) for row in comparison], 2), ""]
    lines.append(
        "misfit: median level difference to the data of the fit; rank: combinations of its unknowns"
        " that the data determine; steps, solved: steps of the fit and lines at which the model was"
        " solved."
    )
    if comparison.truth:
        lines.append(
            "error: estimate / truth - 1, of loss factors estimate - truth; unknowns left at their"
            " start count with it."
        )
    if comparison.rule:
        lines.append(comparison.rule)
    for row in comparison:
        if reason(row):
            lines.append(f"{row.method} {row.status}: {reason(row)}")
    for row in comparison:
        if row.applies and row.left:
            lines.append(f"{row.method} leaves at the start: {', '.join(row.left)}")
    for row in comparison:
        if row.fewest is not None and row.fewest.note:
            lines.append(f"{row.method}: fewest lines not sought to the end: {row.fewest.note}")
    if comparison.stopped:
        stopped = "Stopped"
        if comparison.not_run:
            stopped += f"; not run: {', '.join(comparison.not_run)}"
        lines.append(f"{stopped}.")
    return "\n".join(lines)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> str:
    """Return rows in columns, the first `left` and the last of them aligned to the left."""
    return text_table(header, rows, {*range(left), len(header) - 1})


def listing() -> str:
    """Return a table of all methods: what they cannot update or need, and their publications."""
    table = []
    for name in METHODS:
        row = Row(**method_facts(name), status="", message="")
        table.append([name, limits(row), row.reference or "-"])
    return _table(["method", "cannot update", "reference"], table, 3)
