"""`write_modes_page`: modes of a measurement as one HTML page with an interactive mode picker."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from updyn import __version__
from updyn.arrays import RealArray
from updyn.correlation import auto_mac
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.modal.alike import AlikePair, find_alike_pairs
from updyn.modal.level import describe_leaning
from updyn.modal.unexplained import describe_unexplained
from updyn.report.formats import extent, format_count, number, percentage
from updyn.report.modes import mode_map
from updyn.report.page import assemble
from updyn.report.picker import IdentifiedModes, picker_data, picker_figure
from updyn.report.plots import Figure
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_LIST
from updyn.report.templates import asset, render_template, write_page

__all__ = ["write_modes_page"]


def write_modes_page(
    modes: ModeSet,
    frf: FRF,
    path: str | PathLike[str],
    title: str = "",
    *,
    poles: Sequence[float | None] | None = None,
    left_out: ModeSet | None = None,
) -> Path:
    """Write modes, their stabilisation diagram and the synthesised FRFs as one HTML page.

    `poles` holds the frequency (Hz) of the pole picked for each mode, None for modes found without
    a pole. `left_out` are modes found but not picked, which can be picked in the page. An existing
    file is replaced only after the new page is complete.
    """
    return write_page(render(modes, frf, title, poles=poles, left_out=left_out), path)


def render(
    modes: ModeSet,
    frf: FRF,
    title: str = "",
    *,
    poles: Sequence[float | None] | None = None,
    left_out: ModeSet | None = None,
) -> str:
    """Return the page as HTML."""
    title = title or "Modes"
    found = IdentifiedModes(
        modes, frf, [None] * len(modes) if poles is None else list(poles), left_out
    )
    head = render_template(
        "updyn.report/identified_head.html",
        title=title,
        about=extent(frf),
        verdict=_format_verdict(modes),
    )
    return assemble(PageContent(further={"identified": found}), head, title, __version__)


def _format_verdict(modes: ModeSet) -> str:
    """Return a sentence with the number of modes, the least certain mode, and unexplained peaks."""
    count = format_count(len(modes), "mode")
    if not np.isfinite(modes.quality).any():
        return f"{count}."
    least = int(np.nanargmin(modes.quality))
    missing = ""
    if len(modes.unexplained):
        missing = f" {describe_unexplained(modes.unexplained)}."
    missing = f"{missing} {describe_leaning(modes)}".rstrip()
    return (
        f"{count}; the least sure is the one at {number(float(modes.frequency[least]))} Hz, which"
        f" explains {100.0 * float(modes.quality[least]):.2f} % of the residual of the other modes"
        f" there.{missing}"
    )


class DiagramSection(ReportSection):
    """The figure for picking modes: stabilisation diagram and synthesised FRFs."""

    anchor = "diagram"
    name = "Stabilisation diagram and FRFs"
    heading = "Stabilisation diagram and synthesised FRFs"
    place = 100
    template = "updyn.report/identified_diagram.html"

    def applies(self, content: PageContent) -> bool:
        """Return True: a page of modes always has this section."""
        return True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the figure, to which the script adds curves and modes."""
        return {"picker": picker_figure(content.further["identified"])}

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the note on channels that are not drawn."""
        return {"channels_note": content.further["identified"].note}

    def embedded_data(self, content: PageContent) -> dict[str, object]:
        """Return the data for the script."""
        return {"updyn-picks": picker_data(content.further["identified"])}

    def script(self) -> str:
        """Return the scripts that synthesise FRFs and pick modes."""
        return "\n".join(map(asset, ("curves.js", "lsfd.js", "picks.js")))


class ShapesSection(ReportSection):
    """AutoMAC of the modes, with the pairs of nearly identical shapes."""

    anchor = "auto-mac"
    name = "AutoMAC"
    heading = "AutoMAC: modes found twice?"
    place = 150
    template = "updyn.report/identified_shapes.html"

    def applies(self, content: PageContent) -> bool:
        """Whether there are at least two modes."""
        return len(content.further["identified"].modes) > 1

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the AutoMAC map."""
        modes: ModeSet = content.further["identified"].modes
        values = auto_mac(modes.shapes)
        return {"identified-auto-mac": mode_map(values, modes, modes, ("mode", "mode"), "AutoMAC")}

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the pairs of similar modes in words."""
        modes: ModeSet = content.further["identified"].modes
        pairs = find_alike_pairs(modes)
        others = auto_mac(modes.shapes)[np.triu_indices(len(modes), 1)]
        return {
            "pairs": [(pair, pair_in_words(pair)) for pair in pairs[: REPORT_LIST.listed_pairs]],
            "n_more": max(len(pairs) - REPORT_LIST.listed_pairs, 0),
            "largest": f" The largest is {others.max():.2f}.",
        }


def pair_in_words(pair: AlikePair) -> str:
    """Return a sentence on a pair of modes with nearly identical shapes."""
    which = f"{number(pair.first, 5)} and {number(pair.second, 5)} Hz: MAC {pair.mac:.2f}"
    if pair.overlap:
        return (
            f"{which}, and their resonances overlap. They may be one mode found twice: leave one"
            " out and compare FRAC."
        )
    return f"{which}. Their resonances do not overlap: the sensors do not distinguish their shapes."


class IdentifiedModesSection(ReportSection):
    """The table of the modes."""

    anchor = "modes"
    name = "Modes"
    heading = "Modes"
    place = 200
    template = "updyn.report/identified_modes.html"

    def applies(self, content: PageContent) -> bool:
        """Return True: a page of modes always has this section."""
        return True

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        modes: ModeSet = content.further["identified"].modes
        shape = _shape_errors(modes)
        rows = []
        for k in range(len(modes)):
            rows.append(
                [
                    str(k + 1),
                    f"{modes.frequency[k]:.6g}",
                    number(float(modes.std_frequency[k]), 2),
                    percentage(float(modes.damping[k])),
                    percentage(float(modes.std_damping[k])),
                    _format_share(float(shape[k])),
                    f"{modes.phase_collinearity[k]:.3f}",
                    f"{modes.quality[k]:.4f}",
                ]
            )
        return {"rows": rows}


def _shape_errors(modes: ModeSet) -> RealArray:
    """Return the rms standard deviation of each shape relative to the rms of the shape."""
    if modes.std_shapes is None:
        return np.full(len(modes), np.nan)
    return np.asarray(
        np.linalg.norm(modes.std_shapes, axis=0) / np.linalg.norm(modes.real_shapes, axis=0)
    )


def _format_share(share: float) -> str:
    return "not known" if np.isnan(share) else percentage(share)


DIAGRAM = DiagramSection()
SHAPES = ShapesSection()
MODES = IdentifiedModesSection()
