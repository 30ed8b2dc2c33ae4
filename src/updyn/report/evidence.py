"""Figures next to the verdict: worst and median channel or modes, and the largest changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import quote

from updyn.report.changes import find_outcomes, largest_changes
from updyn.report.channels import (
    format_channel,
    is_mostly_noise,
    small_curves,
    worst_and_median,
)
from updyn.report.data import ReportData
from updyn.report.formats import capitalize_first, format_count, percentage
from updyn.report.mode_axes import mode_axes
from updyn.report.mode_sensitivities import sensitivity_map
from updyn.report.plots import Figure
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST

__all__ = ["Evidence", "EvidencePanel", "show_evidence", "show_start"]


@dataclass(frozen=True, slots=True)
class EvidencePanel:
    """A figure with its heading, a caption, and a link to the address that shows all of it.

    `half`: the figure takes half of the width.
    """

    name: str
    heading: str
    caption: str
    target: str
    link: str
    half: bool = False


@dataclass(frozen=True, slots=True)
class Evidence:
    """Panels in page order and their figures by name."""

    panels: tuple[EvidencePanel, ...]
    figures: dict[str, Figure]


def show_evidence(content: PageContent) -> Evidence:
    """Return the evidence for the verdict on an update."""
    found: list[tuple[EvidencePanel, Figure]] = []
    if content.has_frfs:
        found += _show_channels(content.data)
    elif content.has_one_test:
        found += _show_modes(content)
    else:
        found += _show_tests(content)
    found += _show_changes(content)
    return _collect(found)


def show_start(content: PageContent) -> Evidence:
    """Return the modes of test and model before any fit, and the sensitivities of its modes."""
    found = list(_show_modes(content))
    if not found and content.has_frfs:
        found += _show_channels(content.data)
    return _collect([*found, *_show_sensitivities(content)])


def _collect(found: list[tuple[EvidencePanel, Figure]]) -> Evidence:
    return Evidence(
        tuple(panel for panel, _ in found), {panel.name: figure for panel, figure in found}
    )


def _show_channels(data: ReportData) -> Iterator[tuple[EvidencePanel, Figure]]:
    """Yield the worst and the median channel."""
    for name, at in worst_and_median(data).items():
        figure = small_curves(data, *at)
        if figure is not None:
            heading = f"{name.capitalize()} channel"
            caption = _describe_channel(data, at)
            panel = EvidencePanel(
                f"overview-{name}", heading, caption, "#channels", "with phase", half=True
            )
            yield panel, figure


def _describe_channel(data: ReportData, at: tuple[int, int]) -> str:
    """Return a channel with its residual before and after the update."""
    residuals = (data.residual_before, data.residual_after)
    shown = [percentage(float(v[at])) for v in residuals if v is not None]
    unit = shown[-1].partition(" ")[2] if shown else ""
    before = [text.removesuffix(f" {unit}") for text in shown[:-1]]
    noise = ", mostly noise" if is_mostly_noise(data, *at) else ""
    return f"{format_channel(data, *at)}: residual {' → '.join([*before, *shown[-1:]])}{noise}"


def _show_tests(content: PageContent) -> Iterator[tuple[EvidencePanel, Figure]]:
    """Yield the worst channel of each of several tests; of many tests, of the first ones."""
    tests = [(name, one) for name, one in content.single_tests.items() if one.has_frfs]
    for number, (name, one) in enumerate(tests[: REPORT_LIST.shown_tests]):
        for at in list(worst_and_median(one.data).values())[:1]:
            figure = small_curves(one.data, *at)
            if figure is not None:
                heading = f"{capitalize_first(name)}, worst channel"
                target = f"{quote(name)}/report.html#channels"
                caption = _describe_channel(one.data, at)
                panel = EvidencePanel(
                    f"overview-test-{number}", heading, caption, target, "report", half=True
                )
                yield panel, figure


def _show_modes(content: PageContent) -> Iterator[tuple[EvidencePanel, Figure]]:
    """Yield the modes of the test over those of each model."""
    for name, found in content.modes.correlations.items():
        if len(found.measured) and len(found.computed):
            paired = f"{len(found.pairs.mac)} of {format_count(len(found.measured), 'mode')}"
            caption = f"{paired} of the test are paired."
            heading = f"Modes of test and {name} model"
            panel = EvidencePanel(f"overview-modes-{name}", heading, caption, "#modes", "table")
            yield panel, mode_axes(found, name)


def _show_changes(content: PageContent) -> Iterator[tuple[EvidencePanel, Figure]]:
    """Yield the largest changes of the unknowns."""
    result = content.result
    figure = largest_changes(result)
    if figure is not None:
        n = len(result.parameters)
        note = "; grey: not significant" if "insignificant" in find_outcomes(result) else ""
        panel = EvidencePanel(
            "overview-changes",
            "Largest changes",
            f"From the start, with 95 % intervals{note}.",
            "#changes",
            f"all {format_count(n, 'unknown')}" if n > 1 else "unknown",
        )
        yield panel, figure


def _show_sensitivities(content: PageContent) -> Iterator[tuple[EvidencePanel, Figure]]:
    """Yield the sensitivities of the modes of the start model to the unknowns."""
    figure = sensitivity_map(content)
    if figure is not None:
        caption = "Change of a natural frequency in % if an unknown rises by 1 %."
        heading = "Sensitivity of modes to unknowns"
        panel = EvidencePanel("overview-sensitivities", heading, caption, "#unknowns", "unknowns")
        yield panel, figure
