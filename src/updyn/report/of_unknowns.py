"""Common parts of the report sections on unknowns."""

from __future__ import annotations

from collections.abc import Sequence

from updyn.group import VALUES
from updyn.report.formats import figure_name, quantity_words
from updyn.report.plots import escape_labels
from updyn.report.section import PageContent, ReportSection
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = ["ParameterSection", "group_by_figure", "list_kinds", "name_unknowns"]


class ParameterSection(ReportSection):
    """A section on unknowns, shown for one or several tests."""

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update, or the state before one if the section supports it."""
        return content.update is not None or (self.of_start and content.start is not None)


def group_by_figure(
    result: UpdateResult, factors: str, end: str, calibrations: str
) -> dict[str, list[Parameter]]:
    """Return the unknowns by figure name: factors, each kind of value, sensor calibrations.

    Parameters of elements whose magnitude is optimised are relative to their start, as factors.
    """
    out: dict[str, list[Parameter]] = {factors: []}
    for kind in list_kinds(result):
        out[figure_name(kind) + end] = []
    out[calibrations] = []
    for p in result.parameters:
        if p.is_channel:
            out[calibrations].append(p)
        elif p.value_of is None or p.is_log:
            out[factors].append(p)
        else:
            out[figure_name(p.value_of) + end].append(p)
    return out


def list_kinds(result: UpdateResult) -> list[str]:
    """Return the kinds of values: of damping, and parameters of elements that may be 0."""
    own = [p.quantity for p in result.parameters if p.of_element and not p.is_log]
    return list(dict.fromkeys([*VALUES, *own]))


def name_unknowns(chosen: Sequence[Parameter]) -> list[str]:
    """Return the names of unknowns for a figure axis."""
    return escape_labels(f"{p.group}: {quantity_words(p.quantity)}" for p in chosen)
