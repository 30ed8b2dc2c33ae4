"""`Comparison`: the results of several methods, one row each, and their text table."""

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
    "format_methods",
    "limits",
    "method_facts",
    "reason",
    "summary",
]

#: Status of a method that does not support the data or the unknowns.
NOT_APPLICABLE = "does not apply"

#: Statuses of a fit that ended as intended.
_SETTLED = ("converged", "not-identifiable")

#: Quantities of damping, structural damping first.
_DAMPING = ("loss_factor", "viscous", "mass_damping", "stiffness_damping")

#: Prefixes of figures that are larger for better agreement.
_LARGER_IS_BETTER = (*ONE_AT_BEST, "modes_")

_Figures = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """The result of one method.

    Attributes
    ----------
    method : str
        Name of the method.
    reference : str
        Short reference of its publication.
    status : str
        Status of `updyn.UpdateResult`, or ``"does not apply"``.
    message : str
        The cause of the status, in a sentence.
    cannot : tuple of str
        Quantities that it cannot update for any data.
    needs : str
        Requirements on the data beyond those of the default method; may be empty.
    updated : tuple of str
        Unknowns of the run.
    fixed : tuple of str
        Unknowns kept at their start, because the method cannot update their quantities.
    values, std : mapping of str to float
        By unknown; those in `fixed` have their start value and standard deviation nan. Empty if the
        method does not apply.
    errors : mapping of str to float
        Errors of unknowns with known truth, from `errors_against`, including unknowns in `fixed`.
    off : mapping of str to float
        Estimate minus truth, in the unit of the unknown, for unknowns with known truth.
    fitted, held_out : mapping of str to mapping of str to float
        ``before`` and ``after``: figures of agreement with the data of the fit and with the
        validation set (``db_error_median``, ``frac_median``, ...). The worst of several tests.
    rank : int
        Number of independent combinations of the unknowns that the data determine.
    iterations : int
        Number of accepted steps, including those of the search for a start.
    lines_solved : int
        Number of line solutions of the model up to the last step.
    n_lines : int
        Number of fitted lines.
    seconds : float
        Duration of the whole update in s.
    fewest : Fewest or None
        Fewest lines with which the method still recovers the unknowns; None if not sought.
    result : UpdateResult, JointResult or None
        The full result; None if the method does not apply.
    """

    method: str
    reference: str
    status: str
    message: str
    cannot: tuple[str, ...] = ()
    needs: str = ""
    updated: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
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

        inf if one of these unknowns is undetermined, as its value then depends on the path of the
        fit; nan if the truth is unknown.
        """
        return max(self._sizes(self.errors), default=math.nan)

    @property
    def error_rms(self) -> float:
        """Root mean square of `errors`; inf and nan as in `error_max`."""
        if not self.errors:
            return math.nan
        squares = sum(size * size for size in self._sizes(self.errors))
        return math.sqrt(squares / len(self.errors))

    @property
    def error_max_updated(self) -> float:
        """Largest size of `errors` among the unknowns of the run, as in `error_max`."""
        updated = [name for name in self.errors if name in self.updated]
        return max(self._sizes(updated), default=math.nan)

    def _sizes(self, names: Iterable[str]) -> list[float]:
        """Return the sizes of errors; inf for undetermined unknowns."""
        return [
            math.inf if self.std.get(name) == math.inf else abs(self.errors[name]) for name in names
        ]

    @property
    def off_in_std(self) -> float:
        """Largest distance from the truth in standard deviations of the method.

        Below about 3 if the standard deviations are right; nan if the truth is unknown or no
        unknown has a finite standard deviation.
        """
        largest = math.nan
        for name, off in self.off.items():
            std = self.std.get(name, math.nan)
            if 0.0 < std < math.inf:
                largest = np.fmax(largest, abs(off) / std)
        return float(largest)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Sequence[Row]):
    """Results of several methods: a sequence of `Row`, in the order of the runs.

    Attributes
    ----------
    rows : tuple of Row
        One row per method.
    tests : tuple of Test
        The tests, with the lines that all methods fitted.
    parameters : ParameterSet
        The unknowns.
    truth : mapping of str to float
        Known true values.
    tolerance : float
        Error from the truth, or from the method's estimate with all lines, below which an unknown
        counts as recovered.
    rule : str
        Description of the search for the fewest lines; empty if they were not sought.
    stopped : bool
        Whether the user stopped the comparison.
    not_run : tuple of str
        Methods that were not run because of the stop.
    title : str
        Title, for documentation.

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
        """Return a row by position or by the name of its method."""
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
        """Return the comparison as text: the table, and why methods were not run."""
        return summary(self)


def method_facts(name: str) -> dict[str, Any]:
    """Return ``method``, ``reference``, ``cannot`` and ``needs`` of a `Row` without a run."""
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
    """Return the worst figures of agreement of all tests: fitted data, validation set."""
    fitted, held_out = [], []
    for one in result.results.values():
        fitted.append(one.correlation)
        held_out.append(one.correlation.get("validation") or {})
    if not any(held_out):
        return _find_worst(fitted), {}
    return _find_worst(fitted), _find_worst(held_out)


def _find_worst(tests: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Return ``before`` and ``after``: each figure of the test with the worst agreement."""
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


def _format_figure(figures: _Figures, row: Row, name: str) -> str:
    """Return a figure of agreement after the fit; "-" for a failed fit, which ends at its start."""
    value = (figures.get("after") or {}).get(name, math.nan)
    if row.status == "failed" or math.isnan(value):
        return "-"
    if not name.startswith("db_"):
        return f"{value:.4f}"
    if value < 1e-9:  # rounding of an exact fit
        return "0 dB"
    return f"{value:.2g} dB"


def _format_number(value: float) -> str:
    if math.isnan(value):
        return "-"
    if value == 0.0:
        return "0"
    return f"{value:.2g}"


def _format_error(row: Row, value: float) -> str:
    if row.status == "failed":
        return "-"
    return "undetermined" if math.isinf(value) else _format_number(value)


def _format_fewest(row: Row) -> str:
    if row.fewest is None:
        return "-"
    if row.fewest.count is not None:
        return str(row.fewest.count)
    return "-" if row.fewest.note else "none"


def reason(row: Row) -> str:
    """Return why a method does not apply or failed to converge; empty if it converged."""
    if row.status in _SETTLED:
        return ""
    return row.message


def limits(row: Row) -> str:
    """Return as text the quantities that a method cannot update and its requirements."""
    texts = []
    if row.cannot:
        texts.append(_format_quantities(row.cannot))
    if row.needs:
        texts.append(f"needs {row.needs}")
    return "; ".join(texts) or "-"


def _format_quantities(names: Sequence[str]) -> str:
    """Return quantities as text; complete sets of calibration or damping get a common name."""
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


#: Key, heading and content of each column.
COLUMNS: tuple[Column, ...] = (
    ("method", "method", lambda r: r.method),
    ("status", "status", lambda r: r.status),
    ("unknowns", "unknowns", lambda r: f"{len(r.updated)} of {len(r.updated) + len(r.fixed)}"),
    ("rank", "rank", lambda r: "-" if r.status == "failed" else str(r.rank)),
    ("fewest", "min lines", _format_fewest),
    ("db", "misfit", lambda r: _format_figure(r.fitted, r, "db_error_median")),
    ("frac", "FRAC", lambda r: _format_figure(r.fitted, r, "frac_median")),
    ("held_db", "held out", lambda r: _format_figure(r.held_out, r, "db_error_median")),
    ("held_frac", "FRAC held out", lambda r: _format_figure(r.held_out, r, "frac_median")),
    ("error_max", "error", lambda r: _format_error(r, r.error_max)),
    ("error_rms", "rms", lambda r: _format_error(r, r.error_rms)),
    ("iterations", "steps", lambda r: str(r.iterations)),
    ("lines_solved", "solved", lambda r: str(r.lines_solved)),
    ("seconds", "seconds", lambda r: _format_number(r.seconds)),
    ("limits", "cannot update", limits),
)
#: Columns shown for a method that does not apply.
_KNOWN_WITHOUT_RUNNING = ("method", "status", "limits")


def columns(comparison: Comparison) -> list[Column]:
    """Return the columns with content."""
    empty = set()
    if not any(row.held_out for row in comparison):
        empty |= {"held_db", "held_frac"}
    if not comparison.truth:
        empty |= {"error_max", "error_rms"}
    if not comparison.rule:
        empty |= {"fewest"}
    return [column for column in COLUMNS if column[0] not in empty]


def cells(row: Row, shown: Sequence[Column]) -> list[str]:
    """Return the cells of a row; for a method that does not apply only facts of the method."""
    out = []
    for key, _, content in shown:
        if row.applies or key in _KNOWN_WITHOUT_RUNNING:
            out.append(content(row))
        else:
            out.append("")
    return out


def summary(comparison: Comparison) -> str:
    """Return the table, followed by notes on methods, unknowns and lines."""
    shown = columns(comparison)
    n_lines = max((row.n_lines for row in comparison), default=0)
    head = f"{comparison.title or 'Comparison'}: {len(comparison.parameters)} unknowns"
    head += f", {n_lines} lines"
    start = comparison.before
    if start:
        head += f"; before: {start['db_error_median']:.3g} dB, FRAC {start['frac_median']:.4f}"
    headings = [heading for _, heading, _ in shown]
    lines = [head, "", _format_table(headings, [cells(row, shown) for row in comparison], 2), ""]
    lines.append(
        "misfit: median level difference to the data of the fit; rank: combinations of its unknowns"
        " that the data determine; steps, solved: steps of the fit and lines at which the model was"
        " solved."
    )
    if comparison.truth:
        lines.append(
            "error: estimate / truth - 1, of loss factors estimate - truth; unknowns kept at their"
            " start are included."
        )
    if comparison.rule:
        lines.append(comparison.rule)
    for row in comparison:
        if reason(row):
            lines.append(f"{row.method} {row.status}: {reason(row)}")
    for row in comparison:
        if row.applies and row.fixed:
            lines.append(f"{row.method} keeps at the start: {', '.join(row.fixed)}")
    for row in comparison:
        if row.fewest is not None and row.fewest.note:
            lines.append(f"{row.method}: fewest lines not sought to the end: {row.fewest.note}")
    if comparison.stopped:
        stopped = "Stopped"
        if comparison.not_run:
            stopped += f"; not run: {', '.join(comparison.not_run)}"
        lines.append(f"{stopped}.")
    return "\n".join(lines)


def _format_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> str:
    """Return rows as columns; the first `left` columns and the last are left-aligned."""
    return text_table(header, rows, {*range(left), len(header) - 1})


def format_methods() -> str:
    """Return a table of all methods with their limits, requirements and publications."""
    table = []
    for name in METHODS:
        row = Row(**method_facts(name), status="", message="")
        table.append([name, limits(row), row.reference or "-"])
    return _format_table(["method", "cannot update", "reference"], table, 3)
