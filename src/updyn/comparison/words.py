"""A comparison as plain text: numbers as they are shown, and one table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from updyn.comparison.rows import Comparison, Row

__all__ = ["COLUMNS", "cells", "columns", "limits", "listing", "summary"]

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
    from updyn.comparison.bench import about
    from updyn.comparison.rows import Row
    from updyn.updating.fit.methods import METHODS

    rows = [Row(**about(name), status="", message="") for name in METHODS]
    return _table(
        ["method", "cannot update", "reference"],
        [[row.method, limits(row), row.reference or "-"] for row in rows],
        3,
    )
