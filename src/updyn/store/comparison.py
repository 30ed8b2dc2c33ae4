"""``compare.json``: a comparison of methods as strict JSON; inf and nan are null."""

from __future__ import annotations

from pathlib import Path

from updyn import __version__
from updyn.comparison import Comparison, Fewest, Row
from updyn.io.atomic import write_json
from updyn.store.values import plain, plain_fields

__all__ = ["comparison_to_json", "write_comparison_json"]


def comparison_to_json(comparison: Comparison) -> dict[str, object]:
    """Return a comparison as a dict that `json.dumps` writes without inf or nan.

    ``rows`` has a dict per method with the fields of `updyn.comparison.Row`; an error is None if an
    unknown is not determined or its truth is unknown. ``rule`` and ``tolerance`` are those of the
    fewest lines, ``lines`` are in Hz.
    """
    return {
        "title": comparison.title,
        "unknowns": comparison.parameters.names,
        "truth": plain(dict(comparison.truth)) or None,
        **plain_fields(comparison, "tolerance", "rule", "stopped", "not_run"),
        "rows": list(map(_row_to_json, comparison)),
        "versions": {"updyn": __version__},
    }


def _row_to_json(row: Row) -> dict[str, object]:
    fewest = None
    if row.fewest is not None:
        fewest = _fewest_to_json(row.fewest)
    return {
        **plain_fields(row, *_OUTCOME),
        "left": plain(row.fixed),
        **plain_fields(row, "values", "std", "errors"),
        "n_unknowns": len(row.updated),
        "correlation": {"fitted": plain(row.fitted), "held_out": plain(row.held_out)},
        **plain_fields(row, *_FIGURES),
        "fewest": fewest,
    }


_OUTCOME = (
    "method",
    "reference",
    "status",
    "message",
    "cannot",
    "needs",
    "updated",
)
_FIGURES = (
    "error_max",
    "error_rms",
    "error_max_updated",
    "off_in_std",
    "rank",
    "iterations",
    "lines_solved",
    "n_lines",
    "seconds",
)


def _fewest_to_json(fewest: Fewest) -> dict[str, object]:
    tried = [{"lines": count, "off": plain(off)} for count, off in fewest.tried]
    return {"count": fewest.count, "lines": list(fewest.lines), "tried": tried, "note": fewest.note}


def write_comparison_json(comparison: Comparison, path: str | Path) -> None:
    """Write `comparison_to_json` to a file, which is replaced only once the new one is complete."""
    write_json(comparison_to_json(comparison), path)
