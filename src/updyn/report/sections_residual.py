"""The section of the report on model error: is what is left noise, where not, and what would explain it."""

from __future__ import annotations

import math
from collections.abc import Mapping

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.plots import Figure, existing
from updyn.report.residual import MOST_ROWS, misfit_map, shown_channels
from updyn.report.section import Content, Section
from updyn.updating.judge.adequacy import Adequacy, Misfit, Suspect

__all__ = ["MODEL_ERROR", "tile"]

_TILES = {
    "noise": ("noise", "nothing speaks against the model"),
    "structure": ("model error", "the model cannot follow the data everywhere"),
    "excess": ("more than noise", "but not alike from line to line"),
    "exact": ("nothing", "the model answers the data exactly"),
    "untested": ("not tested", "too few measured numbers"),
}
_UNEXPLAINED = (
    "No change of one quantity that is not an unknown would explain a tenth of it: look at the"
    " sensors, at joints and parts that the model lacks, and at what is not linear."
)
_EXPLAINED = (
    "Of the quantities that are not unknowns, a change of these would take away most of what is"
    " left, the unknowns adapting to it; to first order, so that the sign can be trusted more than"
    " the size. What the sensors cannot tell apart has nearly the same share. Free what can be"
    " wrong, and run again."
)


def tile(found: Adequacy) -> tuple[str, str, str]:
    """Return name, value and hint of the tile in the head."""
    return ("What is left", *_TILES[found.outcome])


class ModelError(Section):
    """Tests of the residual, and what would explain it."""

    anchor = "model-error"
    name = "Model error"
    heading = "Model error"
    place = 1000

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the map of the misfit."""
        return existing({"misfit-map": misfit_map(content.result.adequacy)})

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return verdict, map, worst places and suspects; nothing where the residual was not tested."""
        found = content.result.adequacy
        if found is None:
            return ""
        parts = [m.paragraph(found.verdict)]
        if "misfit-map" in figures:
            parts.append(_map(figures, found))
        if found.worst:
            parts.append(_places(found))
        if found.explained_by:
            parts.append(_suspects(found))
        elif found.outcome == "structure":
            parts.append(m.paragraph(_UNEXPLAINED))
        parts.append(m.details("How it was tested", m.paragraph(_how(found))))
        return "".join(parts)


MODEL_ERROR = ModelError()


def _map(figures: Mapping[str, Figure], found: Adequacy) -> str:
    channels = found.misfit.shape[0] * found.misfit.shape[1]
    some = (
        f" The {MOST_ROWS} worst of {channels} channels are shown."
        if len(shown_channels(found)) < channels
        else ""
    )
    taken = "; 1 is noise" if found.absolute else ", as the size of the noise was taken from it"
    caption = (
        f"Root mean square misfit over {_unit(found)}{taken}, by channel and band about each"
        " resonance. Marked: alike from line to line (an error of the model), and only too"
        f" large.{some}"
    )
    height = figures["misfit-map"]["height"]
    return m.figure("misfit-map", "Misfit of every channel in every band", caption, height=height)


def _places(found: Adequacy) -> str:
    head = [
        "response / reference",
        "band (Hz)",
        "most near (Hz)",
        "misfit",
        "alike over",
        "p of size",
        "p of likeness",
    ]
    caption = (
        f"Places that stand out, the worst first. Misfit as a multiple of {_unit(found)}; p-values"
        f" adjusted for the number of tests, suspect below {w.number(found.level)}"
    )
    return m.table(head, [m.row(_place(p)) for p in found.worst], caption=caption)


def _unit(found: Adequacy) -> str:
    return "the noise" if found.absolute else "the typical misfit"


def _place(p: Misfit) -> list[str]:
    return [
        f"{p.response} / {p.reference}",
        f"{w.number(p.low)} to {w.number(p.high)}",
        w.number(p.near),
        w.number(p.misfit, 3),
        w.counted(round(p.alike), "line") if p.kind == "structure" else "–",
        _p(p.chi_square_p),
        _p(p.whiteness_p),
    ]


def _p(value: float) -> str:
    return "< 10⁻⁹" if value < 1e-9 else w.number(value, 2)


def _suspects(found: Adequacy) -> str:
    head = ["quantity", "would explain", "change", "share of the energy of the error"]
    rows = [m.row(_suspect(s)) for s in found.explained_by]
    return f"<h3>What would explain it</h3>{m.paragraph(_EXPLAINED)}{m.table(head, rows)}"


def _suspect(s: Suspect) -> list[str]:
    if s.quantity == "loss_factor":
        change = f"{s.change:+.2g}".replace("-", "−")
    else:
        change = (
            ("up by " if s.change > 0 else "down by ")
            + w.number(100.0 * abs(math.expm1(s.change)), 2)
            + " %"
        )
    return [w.unknown(s.name), f"{100.0 * s.explains:.0f} %", change, f"{100.0 * s.energy:.0f} %"]


def _how(found: Adequacy) -> str:
    if found.absolute:
        size = (
            "The sum of squares of each channel in each band is compared with what the noise gives"
            " (chi-square or F)."
        )
    else:
        size = (
            "The size of the noise was taken from this residual, so the sum of squares of each"
            " channel in each band is compared with that of all the rest (F): a misfit that is the"
            " same everywhere does not show by its size."
        )
    return (
        f"{size} Likeness from line to line is tested by the autocorrelation at lags 1 to 3, which"
        " needs no size of the noise. All p-values are adjusted for their number such that at most"
        f" {w.number(100.0 * found.level)} % of fits to pure noise are suspected."
    )
