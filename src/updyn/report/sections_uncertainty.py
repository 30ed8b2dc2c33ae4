"""The section of the report on uncertainty: intervals by profile, bootstrap or sampling beside those of Laplace."""

from __future__ import annotations

from collections.abc import Mapping

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.plots import Figure
from updyn.report.section import Content, Section
from updyn.report.uncertain import band_figure, ends_of, intervals_figure, level_of
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import UpdateResult

__all__ = ["UNCERTAINTY"]

_ABOUT = {
    "profile": (
        "Profile likelihood: each unknown is held at one value after the other and all others are"
        " fitted again; the interval holds the values at which the fit is not clearly worse. It"
        " follows curvature, and keeps within the bounds."
    ),
    "bootstrap": (
        "Bootstrap: data are made anew from the updated model and the noise, and the unknowns are"
        " fitted to each; the interval holds the middle of what comes out."
    ),
    "sampling": (
        "Sampling of the posterior: the interval holds the middle of all values that data and"
        " priors leave, by their probability."
    ),
}


class Uncertainty(Section):
    """Intervals by profile, bootstrap or sampling."""

    anchor = "uncertainty"
    name = "Uncertainty"
    heading = "Uncertainty"
    place = 500

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the intervals and, of one test, the band of an FRF."""
        update, found = content.update, content.further["uncertainty"]
        assert update is not None
        out: dict[str, Figure] = {}
        intervals = intervals_figure(update, found)
        if intervals is not None:
            out["uncertainty-intervals"] = intervals
        band = band_figure(update, found) if isinstance(update, UpdateResult) else None
        if band is not None:
            out["uncertainty-band"] = band[0] | {"channel": band[1]}
        return out

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, intervals and the band."""
        found: Draws | Profiles = content.further["uncertainty"]
        kind = "profile" if isinstance(found, Profiles) else found.kind
        parts = [
            m.paragraph(_ABOUT[kind]),
            m.note(found.message),
        ]
        if "uncertainty-intervals" in figures:
            caption = (
                f"{100 * level_of(found):g} % intervals about the estimate, in units of its standard"
                " deviation (in the logarithm of a factor): where both bars are alike, the standard"
                " deviation says it all."
            )
            height = figures["uncertainty-intervals"]["height"]
            parts.append(
                m.figure(
                    "uncertainty-intervals",
                    "Intervals beside those of Laplace",
                    caption,
                    height=height,
                )
            )
        parts.append(_table(content, found))
        if "uncertainty-band" in figures:
            figure = figures["uncertainty-band"]
            caption = (
                f"{figure['channel']}: of what was measured, the FRF that the updated model knows"
                " least. The band is about the structure, without the noise of a measurement."
            )
            parts.append(
                m.figure("uncertainty-band", "FRF with its band", caption, height=figure["height"])
            )
        return "".join(parts)


UNCERTAINTY = Uncertainty()


def _table(c: Content, found: Draws | Profiles) -> str:
    ends = ends_of(found)
    percent = f"{100 * level_of(found):g} %"
    head = ["unknown", "value", "std. dev.", f"{percent}, lower", "upper"]
    head += ["R-hat", "effective draws"] if _diagnosed(found) else []
    head.append("note")
    kinds = ("", *[""] * (len(head) - 2), "note-cell")
    rows = [m.row(_row(c, found, name, span, len(head)), kinds) for name, span in ends.items()]
    return m.table(head, rows, caption=f"{percent} intervals", kinds=kinds) if rows else ""


def _diagnosed(found: Draws | Profiles) -> bool:
    return isinstance(found, Draws) and "r_hat" in found.diagnostics


def _row(
    c: Content, found: Draws | Profiles, name: str, span: tuple[float, float], columns: int
) -> list[str]:
    cells = [
        name,
        w.number(c.result.values[name]),
        w.number(c.result.std[name]),
        *(w.number(e) for e in span),
    ]
    note = found[name].note if isinstance(found, Profiles) else ""
    if isinstance(found, Draws) and _diagnosed(found):
        k = found.names.index(name)
        cells += [w.number(float(found.diagnostics[key][k])) for key in ("r_hat", "ess_bulk")]
    return [*cells, *[""] * (columns - 1 - len(cells)), note]
