"""The modal table of a run, computed once after the update, and as text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from updyn.correlation.model_modes import ModelModes
from updyn.correlation.modes import ModeCorrelation
from updyn.job.prepared import PreparedTest
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.judge.settings import EFFORT
from updyn.updating.modes import compare_start_modes, judge_by_modes, modal_table
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "MODES_HEADING",
    "correlation_at_start",
    "modal_texts",
    "start_modes",
    "start_modes_text",
    "with_modes",
]

#: Heading of the table of modes at the start.
MODES_HEADING = "Modes of the test (measured) and of the model (computed)"


def with_modes(result: UpdateResult | JointResult) -> UpdateResult | JointResult:
    """Return a result with a modal table per test (empty if stopped) and the verdict from them."""
    largest = 0 if result.status == "stopped" else EFFORT.most_dofs
    if isinstance(result, UpdateResult):
        table = modal_table(result, largest=largest)
        return replace(
            judge_by_modes(result, _select_informative({"": table}, [result])), modes=table
        )
    given = result.first.options.get("modes")
    by_test = given if isinstance(given, Mapping) else {}
    tables = {
        name: modal_table(one, by_test.get(name), largest=largest)
        for name, one in result.results.items()
    }
    telling = _select_informative(tables, list(result.results.values()))
    judged = {}
    for name, one in result.results.items():
        judged[name] = replace(judge_by_modes(one, telling), modes=tables[name])
    return replace(result, results=judged)


def _select_informative(
    tables: Mapping[str, ModalTable], results: Sequence[UpdateResult]
) -> list[ModalTable]:
    """Return the tables of tests whose residual is not noise."""
    return [
        table
        for table, one in zip(tables.values(), results, strict=True)
        if one.adequacy is None or not one.adequacy.adequate
    ]


def start_modes(test: PreparedTest, model: ModelModes) -> ModalTable:
    """Return the modes of the test and of the model at the start."""
    return compare_start_modes(model, test.data, test.modes)


def correlation_at_start(table: ModalTable) -> ModeCorrelation | str:
    """Return the correlation of `start_modes`, or why it is missing."""
    return table.correlations.get("start") or f"Modes: not known. {' '.join(table.notes)}"


def start_modes_text(found: ModeCorrelation | str) -> str:
    """Return a text table of measured and computed modes at the start, or why it is missing."""
    return found if isinstance(found, str) else f"{MODES_HEADING}\n{found.table()}"


def modal_texts(result: UpdateResult | JointResult) -> list[str]:
    """Return the modal table of each test as text, with the test's name if there are several."""
    texts = []
    for name, one in result.results.items():
        if one.modes is not None:
            head = f"{name}: " if name else ""
            texts.append(head + one.modes.text())
    return texts
