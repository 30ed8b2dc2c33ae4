"""The section of the report on nonlinear elements: FRFs by level, stiffness, hysteresis loops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from updyn import style
from updyn.arrays import RealArray
from updyn.frf import FRF
from updyn.nonlinear.local import LocalElement
from updyn.report.channels import format_channel, is_mostly_noise
from updyn.report.data import ReportData
from updyn.report.element_motion import (
    Described,
    ElementUnits,
    Motion,
    describe_element,
    find_units,
    follow_loop,
)
from updyn.report.formats import number, unit
from updyn.report.plots import (
    Figure,
    Panel,
    Trace,
    band_traces,
    curve,
    encode_numbers,
    escape_label,
    linear_frequency,
    log_frequency,
    log_range,
    stack_panels,
    thin_indices,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_COMPUTATION, REPORT_LIST, REPORT_SIZE
from updyn.updating.result import UpdateResult

__all__ = ["ELEMENTS", "frfs_by_level", "loop_figure", "stiffness_figure"]

#: Dashes of plotly, in the order of `updyn.style.DASHES`.
_DASHES = ("solid", "dash", "dashdot", "dot")


class ElementsSection(ReportSection):
    """Nonlinear elements: FRFs at each force level, equivalent stiffness, hysteresis loops."""

    anchor = "elements"
    name = "Nonlinear elements"
    heading = "Nonlinear elements"
    place = 57
    template = "updyn.report/elements.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update with nonlinear elements."""
        return any(test.model.nonlinear for test in content.tests.values())

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the FRFs by level, and the stiffness and the loops of each element."""
        made = {}
        by_level = frfs_by_level(_list_data(content))
        if by_level is not None:
            made["levels-frfs"] = by_level
        for k, (result, name, motions) in enumerate(_list_elements(content)):
            described, amplitudes = _describe(result, name, motions)
            local, looks = result.model.nonlinear[name], _looks(content)
            units = find_units(local)
            made[f"element-{k}-stiffness"] = stiffness_figure(
                described, amplitudes, motions, units, looks
            )
            made[f"element-{k}-loop"] = loop_figure(local, motions, units, looks)
        return made

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the channel of the FRFs, the table of motions, and titles and captions."""
        data = _list_data(content)
        worst = find_worst_channel(data)
        channel = ""
        if worst is not None:
            test, at = worst
            channel = format_channel(data[test], *at)
        elements, rows = [], []
        is_random = any(
            isinstance(one.data, FRF) and one.data.is_random for one in content.tests.values()
        )
        for k, (result, name, motions) in enumerate(_list_elements(content)):
            described, _ = _describe(result, name, motions)
            caption = _describe_band(result, name, described, is_random=is_random)
            elements.append((f"element-{k}", name, caption))
            rows += _list_rows(result, name, motions)
        shown = len(elements)
        notes = list(content.motions[1])
        n_more = _count_elements(content) - shown
        if n_more > 0:
            notes.append(f"{n_more} more elements are not drawn.")
        return {"channel": channel, "elements": elements, "rows": rows, "notes": notes}


ELEMENTS = ElementsSection()


# -- FRFs by level ---------------------------------------------------------------------------------
def _list_data(content: PageContent) -> dict[str, ReportData]:
    """Return the FRFs of each test with a level by its name."""
    if content.has_frfs:
        return {content.result.frf.level_text or "test": content.data}
    return {name: one.data for name, one in content.single_tests.items() if one.has_frfs}


def find_worst_channel(data: Mapping[str, ReportData]) -> tuple[str, tuple[int, int]] | None:
    """Return the test and position of the channel with the largest residual; None without any."""
    worst, found = -np.inf, None
    for name, one in data.items():
        if one.residual_after is None:
            continue
        residual = np.where(np.isfinite(one.residual_after), one.residual_after, -np.inf)
        for at in np.ndindex(*residual.shape):
            if is_mostly_noise(one, *at):
                residual[at] = -1.0
        if residual.max() > worst:
            worst = float(residual.max())
            i, j = np.unravel_index(int(residual.argmax()), residual.shape)
            found = name, (int(i), int(j))
    return found


def frfs_by_level(data: Mapping[str, ReportData]) -> Figure | None:
    """Return measured and updated FRFs of the worst channel at all levels; None without any."""
    worst = find_worst_channel(data)
    if worst is None:
        return None
    first = data[worst[0]]
    response, reference = first.responses[worst[1][0]], first.references[worst[1][1]]
    traces: list[Trace] = []
    drawn, lines = [], []
    unit_of = unit(first.quantity, response, reference)
    for number_of, (name, one) in enumerate(data.items()):
        has_channel = response in one.responses and reference in one.references
        if one.after_curve is None or not has_channel or one.quantity != first.quantity:
            continue
        at = one.responses.index(response), one.references.index(reference)
        colour, dash = _look(number_of)
        measured = np.abs(one.measured[:, at[0], at[1]])
        few = thin_indices(np.log(np.maximum(measured, _TINY)), REPORT_SIZE.level_points)
        traces.append(_measured_points(one.freq[few], measured[few], name, colour, unit_of))
        fitted = np.abs(one.after_curve[:, at[0], at[1]])
        traces.append(curve(one.grid, fitted, name, colour, unit=unit_of, dash=dash))
        drawn += [measured, fitted]
        lines += [one.freq[0], one.freq[-1]]
    if not traces:
        return None
    panel = Panel(f"{first.quantity} ({unit_of})", traces, log_range(np.concatenate(drawn)))
    return stack_panels([panel], linear_frequency([min(lines), max(lines)]), height=380)


_TINY = np.finfo(np.float64).tiny


def _look(number_of: int) -> tuple[str, str]:
    """Return colour and dash of a level, counted from 0."""
    round_, place = divmod(number_of, len(style.CATEGORIES))
    return f"@{style.CATEGORIES[place]}", _DASHES[round_ % len(_DASHES)]


def _measured_points(
    x: RealArray, y: RealArray, name: str, colour: str, unit_of: str
) -> dict[str, object]:
    shown = escape_label(name)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": shown,
        "legendgroup": shown,
        "showlegend": False,
        "x": encode_numbers(x),
        "y": encode_numbers(y),
        "marker": {"color": colour, "size": 5, "opacity": 0.6},
        "hovertemplate": f"%{{x:.5g}} Hz: {shown} measured %{{y:.4g}} {unit_of}<extra></extra>",
    }


# -- elements --------------------------------------------------------------------------------------
def _count_elements(content: PageContent) -> int:
    return len({name for test in content.tests.values() for name in test.model.nonlinear})


def _list_elements(content: PageContent) -> Iterator[tuple[UpdateResult, str, Sequence[Motion]]]:
    """Yield a result with each element, the name of the element, and its motion in each test."""
    names: list[str] = []
    for test in content.tests.values():
        for name in test.model.nonlinear:
            motions = [one for one in content.motions[0] if one.element == name]
            moving = [one for one in motions if one.amplitude > 0.0]
            if name in names or not moving or len(names) == REPORT_LIST.shown_elements:
                continue
            names.append(name)
            yield test, name, moving


def _looks(content: PageContent) -> dict[str, str]:
    """Return the colour of each test by its name."""
    names = list(_list_data(content)) or [one.test for one in content.motions[0]]
    return {name: _look(number_of)[0] for number_of, name in enumerate(dict.fromkeys(names))}


def _describe(
    result: UpdateResult, name: str, motions: Sequence[Motion]
) -> tuple[Described, RealArray]:
    """Return the describing function of an element over the amplitudes of the tests."""
    low, high = (pick(one.amplitude for one in motions) for pick in (min, max))
    margin = REPORT_SIZE.amplitude_margin
    amplitudes = np.geomspace(low / margin, high * margin, REPORT_SIZE.amplitude_points)
    fastest = max(motions, key=lambda one: one.amplitude)
    return describe_element(result, name, amplitudes, fastest.freq), amplitudes


def stiffness_figure(
    described: Described,
    amplitudes: RealArray,
    motions: Sequence[Motion],
    units: ElementUnits,
    looks: Mapping[str, str],
) -> Figure:
    """Return equivalent stiffness and loss over amplitude, with bands and the levels of tests."""
    panels: list[Panel] = []
    N = described.stiffness
    parts = [("stiffness", N.real, described.real_half)]
    if np.abs(N.imag).max() > REPORT_COMPUTATION.elastic_share * np.abs(N).max():
        parts.append(("loss", N.imag, described.imaginary_half))
    for name, values, half in parts:
        traces: list[Trace] = []
        is_first = not panels
        if half is not None:
            traces += band_traces(
                amplitudes, values - half, values + half, "95 % band", legend=is_first
            )
        hover = f"%{{x:.4g}} {units.deformation}: %{{y:.5g}} {units.stiffness}<extra></extra>"
        line = curve(amplitudes, values, "updated element", "@after", legend=is_first)
        traces.append(line | {"hovertemplate": hover})
        for one in motions:
            level = float(np.interp(np.log(one.amplitude), np.log(amplitudes), values))
            traces.append(_mark_level(one, level, looks, hover, legend=is_first))
        panels.append(Panel(f"{name} ({units.stiffness})", traces, {"rangemode": "tozero"}))
    x = log_frequency(amplitudes, f"amplitude ({units.deformation})")
    return stack_panels(panels, x, height=160 + 150 * len(panels))


def _mark_level(
    one: Motion, value: float, looks: Mapping[str, str], hover: str, *, legend: bool
) -> dict[str, object]:
    """Return the marker of the largest amplitude in a test."""
    shown = escape_label(one.test)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": shown,
        "legendgroup": shown,
        "showlegend": legend,
        "x": [one.amplitude],
        "y": [value],
        "marker": {"color": looks.get(one.test, "@after"), "size": 10},
        "cliponaxis": False,
        "hovertemplate": f"{shown}: {hover}",
    }


def loop_figure(
    local: LocalElement, motions: Sequence[Motion], units: ElementUnits, looks: Mapping[str, str]
) -> Figure:
    """Return force over deformation at the largest amplitude of each test, the largest first."""
    traces = []
    for one in sorted(motions, key=lambda one: -one.amplitude):
        u, force = follow_loop(local, one.amplitude, one.freq)
        shown = escape_label(one.test)
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": shown,
                "legendgroup": shown,
                "x": encode_numbers(u),
                "y": encode_numbers(force),
                "line": {"color": looks.get(one.test, "@after"), "width": 1.8},
                "hovertemplate": f"{shown}: %{{x:.4g}} {units.deformation},"
                f" %{{y:.4g}} {units.force}<extra></extra>",
            }
        )
    panel = Panel(f"force ({units.force})", traces, {"zeroline": True})
    reach = 1.06 * max(one.amplitude for one in motions)
    x = {
        "range": [-reach, reach],
        "title": {"text": f"deformation ({units.deformation})"},
        "zeroline": True,
        "exponentformat": "power",
        "nticks": 6,
    }
    return stack_panels([panel], x, height=380)


def _describe_band(
    result: UpdateResult, name: str, described: Described, *, is_random: bool
) -> str:
    """Return the caption of the equivalent stiffness of an element."""
    element = result.model.nonlinear[name].element
    text = "Describing function of harmonic motion: real part and imaginary part over amplitude."
    if element.quantity != "receptance":
        text += " It depends on the frequency, and is that of the largest motion."
    text += " Points: largest amplitude in each test"
    text += (
        ", under a random force that of the sine of the same standard deviation."
        if is_random
        else "."
    )
    if described.undetermined:
        return f"{text} Without a band: {', '.join(described.undetermined)} is not determined."
    if described.real_half is None:
        return f"{text} Without a band: no parameter of the element is unknown."
    return f"{text} The band is that of its parameters."


def _list_rows(result: UpdateResult, name: str, motions: Sequence[Motion]) -> list[list[str]]:
    """Return the table cells of the motions of an element."""
    local = result.model.nonlinear[name]
    units, rows = find_units(local), []
    for one in motions:
        described = describe_element(result, name, np.array([one.amplitude]), one.freq)
        N = complex(described.stiffness[0])
        half = described.real_half
        error = "" if half is None else f" ± {number(float(half[0]), 2)}"
        is_elastic = abs(N.imag) <= REPORT_COMPUTATION.elastic_share * abs(N)
        loss = "0" if is_elastic else number(N.imag / N.real, 2) if N.real > 0.0 else "–"
        rows.append(
            [
                name,
                type(local.element).__name__,
                one.test,
                f"{number(one.amplitude, 3)} {units.deformation}",
                f"{number(one.freq, 4)} Hz",
                f"{number(N.real, 4)}{error} {units.stiffness}",
                loss,
            ]
        )
    return rows
