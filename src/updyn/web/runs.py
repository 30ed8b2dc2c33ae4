"""Records of runs as plain data: changes of the unknowns, and rows of a comparison."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from updyn.errors import ParameterError
from updyn.group import is_number
from updyn.job.folder import JOB_FILE
from updyn.report.changes import Change, judge_change
from updyn.report.formats import change, paragraphs
from updyn.updating.judge.badge import Badge, choose_badge
from updyn.updating.judge.claim import PARTS, Claim
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.parameters import Drive, Parameter
from updyn.web.project import RunFolder

__all__ = [
    "AGREEMENT",
    "RunOutcome",
    "RunRow",
    "compare_runs",
    "describe_outcome",
    "find_level_error",
    "read_badge",
    "read_changes",
]

#: Figures of agreement to compare, by their key in the record.
AGREEMENT = {
    "db_error_median": "level error, median (dB)",
    "frac_median": "FRAC, median",
    "correlation_median": "FRF correlation, median",
    "residual_median": "relative residual, median",
}
_ANSWERS = {True: "yes", False: "no", None: "not known"}
#: The record of a run (`result.json`), or a part of it.
RunRecord = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RunRow:
    """A row of a comparison: a cell for each run, empty if the run has none.

    `differs` states whether the runs differ: for an unknown, whether two of its 95 % intervals have
    no common value.
    """

    section: str
    name: str
    cells: list[str]
    differs: bool


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The outcome of a run in brief, the next step, and further remarks."""

    statement: str
    next_step: str
    remarks: list[str]


def read_badge(record: RunRecord) -> Badge:
    """Return the verdict on a run in a phrase, from its record."""
    status, claims = str(record["status"]), _as_mapping(record.get("trust"))
    known = {part: _as_mapping(claims[part]) for part in PARTS if part in claims}
    trust = None
    if len(known) >= len(PARTS) - 1:  # records of old versions do not have "resembles"
        trust = Trust(
            **{
                part: Claim(one.get("holds"), "", one.get("asked") is not False)
                for part, one in known.items()
            }
        )
    is_ambiguous = status == "not-identifiable" and bool(record.get("alternatives"))
    return choose_badge(status, trust, ambiguous=is_ambiguous)


def describe_outcome(record: RunRecord) -> RunOutcome:
    """Return the outcome of a run: its verdict and at most two sentences of its message."""
    first, *rest = paragraphs(str(record.get("message") or "")) or [""]
    step, *further = str(record.get("remedy") or "").splitlines() or [""]
    statement = f"{read_badge(record).phrase}. {first}".rstrip()
    return RunOutcome(statement, step, [*rest, *further])


def compare_runs(runs: Sequence[RunFolder]) -> list[RunRow]:
    """Return the rows of a comparison: verdict, agreement, unknowns and different keys of jobs."""
    records = [run.record for run in runs]
    return [
        *_compare_verdicts(records),
        *_compare_agreement(records),
        *_compare_unknowns(records),
        *_compare_jobs(runs),
    ]


def find_level_error(record: RunRecord, when: str = "after") -> float:
    """Return the median level error ``before`` or ``after`` a run in dB; nan if it is unknown."""
    found = _as_mapping(_as_mapping(record.get("correlation")).get(when)).get("db_error_median")
    return float(found) if is_number(found) else math.nan


def read_changes(record: RunRecord) -> list[Change]:
    """Return the changes of the unknowns of a run; unknowns without a value are left out."""
    freedom = _as_mapping(record.get("noise")).get("degrees_of_freedom")
    found = []
    for unknown in _as_records(record.get("parameters")):
        value, std = unknown.get("value"), unknown.get("std")
        parameter = _read_parameter(unknown)
        if parameter is not None and is_number(value):
            std = std if is_number(std) else math.inf
            at_bound = unknown.get("at_bound") is True
            found.append(judge_change(parameter, value, std, freedom, at_bound=at_bound))
    return found


def _read_parameter(unknown: RunRecord) -> Parameter | None:
    """Return an unknown of a record; None if the record is damaged."""
    try:
        drives = tuple(Drive(**drive) for drive in _as_records(unknown.get("drives")))
        names = (unknown["group"], unknown["quantity"])
        return Parameter(
            *names,
            unknown["start"],
            unknown["lower"],
            unknown["upper"],
            drives=drives,
            of_element=unknown.get("of_element") is True,
        )
    except (KeyError, TypeError, ValueError, ParameterError):
        return None


# -- rows ------------------------------------------------------------------------------------------
def _make_row(section: str, name: str, cells: list[str]) -> RunRow:
    return RunRow(section, name, cells, len(set(cells)) > 1)


def _compare_verdicts(records: Sequence[RunRecord]) -> list[RunRow]:
    rows = [
        _make_row("verdict", name, [str(record.get(key) or "") for record in records])
        for key, name in (("status", "status"), ("method", "method"), ("iterations", "steps"))
    ]
    parts = dict.fromkeys(part for one in records for part in _as_mapping(one.get("trust")))
    for part in parts:
        verdicts = [_as_mapping(_as_mapping(one.get("trust")).get(part)) for one in records]
        cells = [_ANSWERS.get(one.get("holds"), "") if one else "" for one in verdicts]
        rows.append(_make_row("verdict", part, cells))
    return rows


def _compare_agreement(records: Sequence[RunRecord]) -> list[RunRow]:
    rows = []
    for key, name in AGREEMENT.items():
        cells = []
        for record in records:
            found = _as_mapping(record.get("correlation"))
            before, after = (_as_mapping(found.get(when)).get(key) for when in ("before", "after"))
            cells.append(" → ".join(f"{v:.4g}" for v in (before, after) if is_number(v)))
        if any(cells):
            rows.append(_make_row("agreement, before → after", name, cells))
    return rows


def _compare_unknowns(records: Sequence[RunRecord]) -> list[RunRow]:
    names = dict.fromkeys(
        str(unknown.get("name", ""))
        for record in records
        for unknown in _as_records(record.get("parameters"))
    )
    spans: list[dict[str, tuple[float, float]]] = [
        {one.parameter.name: one.span for one in read_changes(record) if one.span is not None}
        for record in records
    ]
    rows = []
    for name in names:
        cells = [_format_unknown(record, name) for record in records]
        known = [found[name] for found in spans if name in found]
        differs = len(set(cells)) > 1
        if len(known) == len(records) > 1:
            differs = max(low for low, _ in known) > min(high for _, high in known)
        rows.append(RunRow("unknowns", name, cells, differs))
    return rows


def _format_unknown(record: RunRecord, name: str) -> str:
    """Return the value of an unknown with its standard deviation and its change, as known."""
    for unknown in _as_records(record.get("parameters")):
        if unknown.get("name") != name:
            continue
        value, std = unknown.get("value"), unknown.get("std")
        if not is_number(value):
            return "not known"
        text = f"{value:.5g} ± {std:.2g}" if is_number(std) else f"{value:.5g} (not determined)"
        parameter = _read_parameter(unknown)
        return text if parameter is None else f"{text}, {change(parameter, value)}"
    return ""


def _compare_jobs(runs: Sequence[RunFolder]) -> list[RunRow]:
    """Return a row for each key in which the job files of several runs differ."""
    jobs = [_read_job(run) for run in runs]
    keys = dict.fromkeys(key for job in jobs for key in job)
    rows = [_make_row("job", key, [job.get(key, "") for job in jobs]) for key in keys]
    return [row for row in rows if row.differs]


def _read_job(run: RunFolder) -> dict[str, str]:
    """Return the values in the job file of a run as text, by key; empty if it cannot be read."""
    try:
        content = tomllib.loads((run.path / JOB_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return dict(_flatten(content))


def _flatten(content: object, key: str = "") -> list[tuple[str, str]]:
    """Return the entries of nested tables with their dotted keys."""
    if isinstance(content, dict):
        inner = [(f"{key}.{name}" if key else name, value) for name, value in content.items()]
    elif isinstance(content, list) and content and all(isinstance(one, dict) for one in content):
        inner = [(f"{key}[{number}]", value) for number, value in enumerate(content, 1)]
    else:
        return [(key, str(content))]
    return [entry for name, value in inner for entry in _flatten(value, name)]


def _as_records(given: object) -> list[RunRecord]:
    return [_as_mapping(item) for item in given] if isinstance(given, list) else []


def _as_mapping(given: object) -> RunRecord:
    return given if isinstance(given, Mapping) else {}
