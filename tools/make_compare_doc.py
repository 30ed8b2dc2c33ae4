"""Write the tables of docs/compare.md: all methods, and the gear train updated by each.

python tools/make_compare_doc.py
"""

from __future__ import annotations

import re
import tempfile
import warnings
from collections.abc import Iterable
from pathlib import Path

from updyn.comparison import Comparison, Row
from updyn.comparison.table import limits
from updyn.demos import gear_train
from updyn.errors import UpdynWarning
from updyn.job import load_job
from updyn.job.comparison import compare_job

PAGE = Path(__file__).parents[1] / "docs" / "compare.md"
JOBS = ("compare", "compare_stiffness", "compare_full")


def compared(folder: Path, name: str, methods: Iterable[str] | None = None) -> Comparison:
    """Run one of the gear train's jobs for comparisons, as its command on the page does."""
    gear_train.write_inputs(folder)
    truth = folder / f"{name}_truth.toml"
    with warnings.catch_warnings():
        # K of unit 2 is indefinite by the rounding of Table 2.
        warnings.simplefilter("ignore", UpdynWarning)
        return compare_job(
            load_job(folder / f"{name}.toml"),
            folder / "out",
            truth=truth,
            fewest=True,
            methods=methods,
        )


def methods_table(found: Comparison) -> str:
    """Return what every method cannot update, needs, and where it comes from."""
    rows = []
    for row in found:
        text = limits(row).removeprefix("-")
        rows.append(f"| `{row.method}` | {text} | {row.reference} |")
    return _table("| method | cannot update; needs | reference |", rows)


def results_table(found: Comparison) -> str:
    """Return how each method did, without what depends on the machine."""
    head = "| method | status | unknowns | misfit (dB) | largest error | fewest lines |"
    return _table(head, [_result(row) for row in found])


def _result(row: Row) -> str:
    cells = [f"`{row.method}`", row.status]
    if row.applies:
        misfit, error = _figures(row)
        cells += [
            f"{len(row.updated)} of {len(row.updated) + len(row.fixed)}",
            misfit,
            error,
            _fewest(row),
        ]
    return "| " + " | ".join([*cells, *[""] * (6 - len(cells))]) + " |"


def _figures(row: Row) -> tuple[str, str]:
    """Return misfit and largest error in digits that every processor finds, or in words."""
    if row.status == "failed":
        return "", ""
    if row.status == "max-iterations":  # where it is by then depends on the rounding of each step
        return "not settled", "not settled"
    misfit = row.fitted["after"]["db_error_median"]
    if row.status == "not-identifiable":  # rounding decides at which point of a flat valley it ends
        return "< 0.01" if misfit < 0.01 else "> 0.01", "undetermined"
    return _number(misfit), _number(row.error_max)


def _fewest(row: Row) -> str:
    return "none" if row.fewest is None or row.fewest.count is None else str(row.fewest.count)


def _number(value: float) -> str:
    return "< 1e-6" if value < 1e-6 else f"{value:.2g}"


def _table(head: str, rows: list[str]) -> str:
    text = "\n".join([head, re.sub(r"[^|]+", "---", head), *rows])
    return re.sub(r"\|  (?=\|)", "| ", text) + "\n"


def replaced(text: str, name: str, table: str) -> str:
    """Return the page with the table between two marks in place of what stands there."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
    before, rest = text.split(begin)
    return before + begin + table + end + rest.split(end)[1]


def main() -> None:
    """Write the page."""
    text = PAGE.read_text(encoding="utf-8")
    for name in JOBS:
        with tempfile.TemporaryDirectory() as folder:
            found = compared(Path(folder), name)
        text = replaced(text, name, results_table(found))
        text = replaced(text, "methods", methods_table(found))
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
