"""`compare_job`: run every method on the inputs of a job and write the comparison."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from updyn.comparison import compare, compare_jointly
from updyn.comparison.bench import Options
from updyn.errors import FormatError, suggest
from updyn.group import is_number
from updyn.io.items import refuse_repeated_names
from updyn.io.toml_text import parse_toml
from updyn.job.folder import check_out, default_out
from updyn.job.prepare import prepare
from updyn.job.prepared import Prepared
from updyn.job.run import job_selection, locate_update_errors, make_tests
from updyn.job.schema import Job
from updyn.outputs.switch import open_folder, replace_files
from updyn.store.comparison import write_comparison_json
from updyn.updating.fit.methods import METHODS, options_of
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection

if TYPE_CHECKING:
    from distributed import Client

    from updyn.comparison import Comparison
    from updyn.engines import Engine
    from updyn.updating.fit.monitor import Progress

__all__ = [
    "COMPARISON_FILES",
    "compare_job",
    "read_truth",
]

#: Files that a comparison writes.
COMPARISON_FILES = ("compare.html", "compare.json")


def compare_job(
    job: Job,
    out: str | Path | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    methods: Iterable[str] | None = None,
    truth: str | Path | None = None,
    prepared: Prepared | None = None,
    engine: int | Client | Engine | None = None,
    **options: Any,
) -> Comparison:
    """Run every method on the inputs of a job and write ``compare.json`` and ``compare.html``.

    The options in ``[method]`` apply to that method only; measured modes are passed to every method
    that fits modes. `out` is by default the job's stem with ``-compare``, `options` are ``fewest``,
    ``tolerance`` and ``chosen`` of `updyn.compare`. A stopped comparison has the rows computed so
    far. Nothing is written after an `InputError` or `SolverError`.
    """
    from updyn.report import write_comparison

    out = check_out(job, out or default_out(job, "compare"), COMPARISON_FILES)
    ready = prepare(job) if prepared is None else prepared
    true_values = None
    if truth is not None:
        true_values = read_truth(truth, ready.parameters)
    if methods is not None:
        methods = list(methods)
    by_method = _method_options(ready)
    # Errors of the arguments have no line in the job.
    Options.check(ready.parameters, methods, by_method, true_values, **options)
    options |= {"methods": methods, "truth": true_values, "options": by_method}
    with open_folder(out):
        check_out(job, out, COMPARISON_FILES)  # again, now that no other run can change the folder
        with locate_update_errors(job):
            found = _run_comparison(ready, {"callback": callback, "engine": engine, **options})
        with replace_files(out, "compare", COMPARISON_FILES) as new:
            write_comparison(found, new / "compare.html")
            write_comparison_json(found, new / "compare.json")
    return found


def _run_comparison(ready: Prepared, options: dict[str, Any]) -> Comparison:
    job = ready.job
    options |= {"title": ready.title} | job.method.settings
    tests, unknowns = make_tests(ready), job_selection(ready) or ready.parameters
    if isinstance(unknowns, Selection) and options["truth"] is not None:
        selected = unknowns.parameters.names
        options["truth"] = {k: v for k, v in options["truth"].items() if k in selected}
    if len(tests) > 1:
        return compare_jointly(tests, unknowns, **options)
    (test,) = tests
    options |= {"lines": test.lines, "noise": test.noise, "validation": test.validation}
    return compare(test.model, test.frf, unknowns, **options)


def _method_options(ready: Prepared) -> dict[str, dict[str, object]]:
    """Return options by method: those of the job's method, and modes for methods that fit modes."""
    out = {ready.job.method.name: dict(ready.job.method.options)}
    if not ready.modes:
        return out
    for name in METHODS:
        if "modes" in options_of(name):
            out.setdefault(name, {})["modes"] = ready.modes_option
    return out


def read_truth(path: str | Path, parameters: ParameterSet) -> dict[str, float]:
    """Return true values of unknowns from a TOML or JSON file, in its order; some may be missing.

    The file has names with values, such as ``"part 1.stiffness" = 0.8``, or a table per group,
    ``["part 1"]`` with ``stiffness = 0.8``.
    """
    path = Path(path)
    found: dict[str, float] = {}
    for name, value in _flatten_table(_read_content(path)):
        if name not in parameters.names:
            raise FormatError(
                f"{name!r} is not an unknown of the job; {suggest(name, parameters.names)}", path
            )
        if not is_number(value) or not math.isfinite(value):
            raise FormatError(f"{name!r}: expected a finite number, found {value!r}", path)
        if name in found:
            raise FormatError(f"{name!r} occurs twice", path)
        found[name] = float(value)
    if not found:
        raise FormatError(
            'contains no true value; expected lines such as "part 1.stiffness" = 0.8', path
        )
    return found


def _read_content(path: Path) -> Mapping[str, Any]:
    """Return the content of a TOML or JSON file."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FormatError("the true values cannot be read: not UTF-8 text", path) from error
    except OSError as error:
        raise FormatError(f"the true values cannot be read: {error.strerror}", path) from error
    is_json = path.suffix.lower() == ".json"
    kind = "JSON" if is_json else "TOML"
    try:
        content = (
            json.loads(text, object_pairs_hook=refuse_repeated_names)
            if is_json
            else parse_toml(text)
        )
    except (ValueError, RecursionError) as error:
        raise FormatError(f"not {kind}: {error}", path) from error
    if not isinstance(content, dict):
        raise FormatError(f"expected names with values, found a {type(content).__name__}", path)
    return content


def _flatten_table(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of a table and its nested tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flatten_table(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
