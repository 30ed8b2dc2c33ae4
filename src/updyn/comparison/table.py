"""What a comparison gives back: `Comparison` and its rows. Pure data; computes no physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from updyn.comparison.fewest import Fewest
from updyn.errors import OptionError, suggest
from updyn.updating.fit.methods import METHODS, method_class
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import CHANNELS, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "COLUMNS",
    "NOT_APPLICABLE",
    "Comparison",
    "Row",
    "about",
    "cells",
    "columns",
    "figures_of",
    "limits",
    "listing",
    "summary",
]

#: Status of a method that cannot be used on the data or the unknowns.
NOT_APPLICABLE = "does not apply"

_Figures = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One method on the bench.

    Attributes
    ----------
    method : str
        Its name.
    reference : str
        Where it comes from, in short.
    status : str
        As of `updyn.UpdateResult`, or ``"does not apply"``.
    message : str
        The cause, in a sentence; why it does not apply.
    cannot : tuple of str
        Quantities that it cannot update, whatever the data.
    needs : str
        What it asks of the data beyond what the default does; empty where nothing.
    updated : tuple of str
        Unknowns that it was run with.
    left : tuple of str
        Unknowns left at their start, as they are of those quantities.
    values, std : mapping of str to float
        By unknown; those left stand at their start, with no (nan) standard deviation. Empty where
        it does not apply.
    errors : mapping of str to float
        Estimate against the truth where that is known, as `errors_against` has it. Unknowns left at
        their start count with it.
    off : mapping of str to float
        Estimate minus truth, in the unit of the unknown, where the truth is known.
    fitted, held_out : mapping of str to mapping of str to float
        ``before`` and ``after``: figures of agreement with the data of the fit and with what was
        held out (``db_error_median``, ``frac_median``, ...). Of several tests the worst.
    rank : int
        Independent combinations of the unknowns that it was run with which it finds the data to
        determine.
    iterations : int
        Accepted steps, those of its search included.
    lines_solved : int
        Lines at which the model was solved up to the last step.
    n_lines : int
        Lines of the data that were fitted.
    seconds : float
        From start to judgement, in s.
    fewest : Fewest or None
        The fewest lines with which it still recovers; None where that was not sought.
    result : UpdateResult, JointResult or None
        All of it; None where it does not apply.
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
        """Largest size of `errors`; nan where the truth is not known."""
        return max((abs(e) for e in self.errors.values()), default=math.nan)

    @property
    def error_rms(self) -> float:
        """Root of the mean square of `errors`; nan where the truth is not known."""
        sizes = list(self.errors.values())
        return math.sqrt(sum(e * e for e in sizes) / len(sizes)) if sizes else math.nan

    @property
    def error_max_updated(self) -> float:
        """Largest size of `errors` of the unknowns that it was run with; nan where the truth is not known."""
        return max(
            (abs(e) for name, e in self.errors.items() if name in self.updated), default=math.nan
        )

    @property
    def off_in_std(self) -> float:
        """Largest distance from the truth in the method's own standard deviations, of unknowns that have one.

        Below 3 or so where these can be believed; nan where the truth is not known or nothing is
        determined.
        """
        known = [name for name in self.off if 0.0 < self.std.get(name, math.nan) < math.inf]
        return max((abs(self.off[name]) / self.std[name] for name in known), default=math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Sequence[Row]):
    """Methods side by side; a sequence of `Row`, in the order in which they were run.

    Attributes
    ----------
    rows : tuple of Row
        One for each method.
    tests : tuple of Test
        The tests, with the lines that every method was given.
    parameters : ParameterSet
        The unknowns.
    truth : mapping of str to float
        True values, as far as they are known.
    tolerance : float
        How close to the truth, or to a method's own answer with all lines, counts as recovered.
    rule : str
        How the fewest lines were sought, in words; empty where they were not.
    stopped : bool
        Whether the user stopped it.
    not_run : tuple of str
        Methods that were not begun then.
    title : str
        For the record.
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
        if isinstance(item, str):
            found = next((row for row in self.rows if row.method == item), None)
            if found is None:
                raise OptionError(
                    f"no method {item!r} in this comparison;"
                    f" {suggest(item, [r.method for r in self.rows])}"
                )
            return found
        return self.rows[item]

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
        """Figures of agreement of the start with the data of the fit; empty where no method could be run."""
        return next((row.fitted["before"] for row in self.rows if row.fitted.get("before")), {})

    def summary(self) -> str:
        """Return the comparison as text: one table, then why methods do not apply and what was left out."""
        return summary(self)


def about(name: str) -> dict[str, Any]:
    """Return what is known of a method without running it: ``method``, ``reference``, ``cannot``, ``needs``."""
    made = method_class(name)
    cannot = dict.fromkeys(getattr(made, "cannot", ()))
    if not getattr(made, "calibrates", False):
        cannot |= dict.fromkeys(CHANNELS)
    return {
        "method": name,
        "reference": str(getattr(made, "reference", "")),
        "cannot": tuple(cannot),
        "needs": str(getattr(made, "needs", "")),
    }


def figures_of(result: UpdateResult | JointResult) -> tuple[_Figures, _Figures]:
    """Return the figures of agreement of what was fitted and of what was held out; of several tests the worst."""
    results = list(result.results.values())
    fitted = {
        when: _worst([r.correlation.get(when) or {} for r in results])
        for when in ("before", "after")
    }
    held = [r.correlation.get("validation") or {} for r in results]
    return fitted, (
        {when: _worst([h.get(when) or {} for h in held]) for when in ("before", "after")}
        if any(held)
        else {}
    )


def _worst(tables: Sequence[Mapping[str, float]]) -> dict[str, float]:
    there = [t for t in tables if t]
    names = list(dict.fromkeys(name for t in there for name in t))
    out: dict[str, float] = {}
    for name in names:
        values: NDArray[np.float64] = np.array(
            [t[name] for t in there if name in t], dtype=np.float64
        )
        out[name] = float(values.max() if name.startswith("db_") else values.min())
    return out


#: Quantities of damping, the structural one first.
_DAMPING = ("loss_factor", "viscous", "mass_damping", "stiffness_damping")

#: What is an unknown of a sensor, not of the structure.
_CHANNELS = ("calibration", "force_calibration")

Column = tuple[str, str, "Callable[[Row], str]"]


def _figure(row: Row, held: bool, name: str) -> str:
    table = (row.held_out if held else row.fitted).get("after") or {}
    value = (
        math.nan if row.status == "failed" else table.get(name, math.nan)
    )  # what failed is where it started
    if math.isnan(value):
        return "-"
    if name.startswith("db_"):
        return f"{value:.2g} dB" if value >= 1e-9 else "0 dB"
    return f"{value:.4f}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else "0" if value == 0.0 else f"{value:.2g}"


def _error(row: Row, value: float) -> str:
    return "-" if row.status == "failed" else _number(value)


def _fewest(row: Row) -> str:
    if row.fewest is None:
        return "-"
    if row.fewest.count is not None:
        return str(row.fewest.count)
    return "-" if row.fewest.note else "none"


def limits(row: Row) -> str:
    """Return what a method cannot update and what it needs, in words."""
    said = [_quantities(row.cannot), f"needs {row.needs}" if row.needs else ""]
    return "; ".join(text for text in said if text) or "-"


def _quantities(names: Sequence[str]) -> str:
    """Return quantities in words, those of damping together."""
    others = [name for name in names if name not in _DAMPING]
    if set(_CHANNELS) <= set(others):
        others = [*(name for name in others if name not in _CHANNELS), _CHANNELS[0]]
    out = [name.replace("_", " ") for name in others]
    viscous = set(_DAMPING[1:]) <= set(names)
    if viscous and _DAMPING[0] in names:
        out.append("damping")
    elif viscous:
        out.append("viscous damping")
    else:
        out += [name.replace("_", " ") for name in names if name in _DAMPING]
    return ", ".join(out)


#: Key, heading and content of every column.
COLUMNS: tuple[Column, ...] = (
    ("method", "method", lambda r: r.method),
    ("status", "status", lambda r: r.status),
    ("unknowns", "unknowns", lambda r: f"{len(r.updated)} of {len(r.updated) + len(r.left)}"),
    ("rank", "rank", lambda r: "-" if r.status == "failed" else str(r.rank)),
    ("fewest", "min lines", _fewest),
    ("db", "misfit", lambda r: _figure(r, False, "db_error_median")),
    ("frac", "FRAC", lambda r: _figure(r, False, "frac_median")),
    ("held_db", "held out", lambda r: _figure(r, True, "db_error_median")),
    ("held_frac", "FRAC", lambda r: _figure(r, True, "frac_median")),
    ("error_max", "error", lambda r: _error(r, r.error_max)),
    ("error_rms", "rms", lambda r: _error(r, r.error_rms)),
    ("iterations", "steps", lambda r: str(r.iterations)),
    ("lines_solved", "solved", lambda r: str(r.lines_solved)),
    ("seconds", "seconds", lambda r: _number(r.seconds)),
    ("limits", "cannot update", limits),
)


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
    """Return the cells of a row; of a method that does not apply only what is known without running it."""
    known = ("method", "status", "limits")
    return [content(row) if row.applies or key in known else "" for key, _, content in shown]


def summary(comparison: Comparison) -> str:
    """Return the table, then why methods do not apply, what was left at its start, and how lines were chosen."""
    shown = columns(comparison)
    start = comparison.before
    before = (
        f"; before: {start['db_error_median']:.3g} dB, FRAC {start['frac_median']:.4f}"
        if start
        else ""
    )
    n_lines = max((row.n_lines for row in comparison), default=0)
    lines = [
        (
            f"{comparison.title or 'Comparison'}: {len(comparison.parameters)} unknowns, {n_lines}"
            f" lines{before}"
        ),
        "",
        _table([heading for _, heading, _ in shown], [cells(row, shown) for row in comparison]),
        "",
        (
            "misfit: median level difference to the data of the fit; rank: combinations of its"
            " unknowns that the data determine; steps, solved: steps of the fit and lines at which"
            " the model was solved."
        ),
    ]
    if comparison.truth:
        lines.append(
            "error: estimate / truth - 1, of loss factors estimate - truth; unknowns left at their"
            " start count with it."
        )
    if comparison.rule:
        lines.append(comparison.rule)
    lines += [
        f"{row.method} does not apply: {row.message}" for row in comparison if not row.applies
    ]
    lines += [
        f"{row.method} leaves at the start: {', '.join(row.left)}"
        for row in comparison
        if row.applies and row.left
    ]
    lines += [
        f"{row.method}: fewest lines not sought to the end: {row.fewest.note}"
        for row in comparison
        if row.fewest is not None and row.fewest.note
    ]
    if comparison.stopped:
        left = f"; not run: {', '.join(comparison.not_run)}" if comparison.not_run else ""
        lines.append(f"Stopped{left}.")
    return "\n".join(lines)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 2) -> str:
    """Return rows in columns: the first ones and the last, words, to the left; numbers to the right."""
    texts = (*range(left), len(header) - 1)
    width = [max(len(r[i]) for r in [header, *rows]) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            c.ljust(w) if i in texts else c.rjust(w)
            for i, (c, w) in enumerate(zip(r, width, strict=True))
        ).rstrip()
        for r in [header, *rows]
    )


def listing() -> str:
    """Return every method with what it cannot update, what it needs and where it comes from, as a table."""
    rows = [Row(**about(name), status="", message="") for name in METHODS]
    return _table(
        ["method", "cannot update", "reference"],
        [[row.method, limits(row), row.reference or "-"] for row in rows],
        3,
    )
