"""The sections of the report about the unknowns: their values, what the data determine, the way of the fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from updyn.group import VALUES
from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.plots import Figure, existing
from updyn.report.section import Content, Section
from updyn.report.unknowns import (
    correlation_map,
    cost_path,
    estimates,
    singular_values,
    value_paths,
)
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = ["CONVERGENCE", "IDENTIFIABILITY", "UNKNOWNS"]


_STAGE_WORDS = {
    "search": "trials from several starts, each jump up is the next",
    "log": "fit of logarithmic level and phase",
    "maximum-likelihood": "fit weighted with the noise",
    "output-error": "fit of the unweighted FRFs",
    "equation-error": "fit of the condensed force equation",
    "rfm": "response function equation",
    "complex-rfm": "response function equation, complex stiffnesses",
    "frf-sensitivity": "linearised FRFs",
    "reduced-frf": "force equation of the reduced model",
}


class Unknowns(Section):
    """The values of the unknowns."""

    anchor = "unknowns"
    name = "Unknowns"
    heading = "Unknowns"
    place = 400

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the estimates of each kind of unknown."""
        result = content.result
        return existing(
            {
                name: estimates(result, chosen)
                for name, chosen in _by_figure(result, "factors", "s", "calibrations").items()
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return table and figures of the unknowns."""
        kinds = ("", "text", "", "", "", "", "", "", "note-cell")
        sensors = [
            _parameter_row(content.result, p, kinds)
            for p in content.result.parameters
            if p.is_channel
        ]
        rows = [
            _parameter_row(content.result, p, kinds)
            for p in content.result.parameters
            if not p.is_channel
        ]
        caption = (
            "Stiffness, mass and viscous damping are factors on the start model (1 = unchanged); loss"
            " factors, mass damping (1/s) and stiffness damping (s) are values, relative to the updated"
            " stiffness or mass. The 95 % interval is symmetric in the logarithm for factors and cut at"
            " 0 for values; it covers the noise in the data, not errors of the model's form."
        )
        head = [
            "group",
            "quantity",
            "start",
            "value",
            "change",
            "std. dev.",
            "95 % interval",
            "bounds",
            "note",
        ]
        parts = []
        if rows:
            parts.append(m.table(head, rows, caption=caption, kinds=kinds))
        legend = (
            "Points: estimates with 95 % interval; short ticks: start; long grey ticks: bounds, where"
            " they lie in the range drawn; crosses: not determined by the data."
        )
        for name, title in (("factors", "Factors, relative to their start"), *_kinds("s")):
            parts += _estimates(figures, name, title, legend)
        if sensors:
            caption = (
                "Factors on what a sensor reads: above 1 it reads too much. They belong to the"
                " measurement: the updated model is without them, and its FRFs are shown and scored as"
                " the sensors would read them."
            )
            parts.append("<h3>Calibration of the sensors</h3>")
            parts.append(m.table(["sensor", *head[1:]], sensors, caption=caption, kinds=kinds))
            parts += _estimates(figures, "calibrations", "", legend)
        return "".join(parts)


UNKNOWNS = Unknowns()


def _by_figure(
    result: UpdateResult, factors: str, end: str, calibrations: str
) -> dict[str, list[Parameter]]:
    """Return the unknowns of each figure, by its name: factors, each kind of value, sensors."""
    out = {factors: [p for p in result.parameters if p.is_factor and not p.is_channel]}
    for kind in VALUES:
        out[w.figure_name(kind) + end] = [p for p in result.parameters if p.value_of == kind]
    out[calibrations] = [p for p in result.parameters if p.is_channel]
    return out


def _kinds(end: str) -> list[tuple[str, str]]:
    """Return name and title of the figures of each kind of value."""
    return [(w.figure_name(kind) + end, w.quantity_words(kind).capitalize()) for kind in VALUES]


def _estimates(figures: Mapping[str, Figure], name: str, title: str, legend: str) -> list[str]:
    if name not in figures:
        return []
    what = f"{title or 'Calibration factors'}: estimates, intervals and bounds"
    plot = m.figure(name, what, legend, height=figures[name]["height"])
    return [f"<h3>{title}</h3>", plot] if title else [plot]


def _parameter_row(result: UpdateResult, p: Parameter, kinds: tuple[str, ...]) -> str:
    value, std = result.values[p.name], result.std[p.name]
    span = w.interval(p, value, std)
    notes = []
    if p.name in result.at_bound:
        notes.append(f"at its {result.at_bound[p.name]} bound")
    if not math.isfinite(std):
        notes.append("not determined by the data")
    if p.nominal is not None:
        notes.insert(0, f"{p.physical(value, std)}, from {p.physical(p.start)}")
    if p.drives:
        notes.append(f"acts on {p.law}")
    if p.prior_std is not None:
        notes.append(f"prior standard deviation {w.number(p.prior_std, 3)}")
    cells = [
        p.group,
        w.quantity_words(p.quantity) + (f" ({p.value_unit})" if p.value_unit else ""),
        w.number(p.start),
        w.estimate(value, std),
        w.change(p, value),
        w.number(std, 2) if math.isfinite(std) else "–",
        f"{w.estimate(span[0], std)} to {w.estimate(span[1], std)}" if span else "open",
        f"{w.number(p.lower, 3)} to {w.number(p.upper, 3)}",
        "; ".join(notes),
    ]
    return m.row(
        cells,
        kinds,
        "open" if notes and (p.name in result.at_bound or not math.isfinite(std)) else "",
    )


class DeterminedUnknowns(Section):
    """The combinations of unknowns that the data determine."""

    anchor = "identifiability"
    name = "What is determined"
    heading = "What the data determine"
    place = 600

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return singular values and correlations."""
        return existing(
            {
                "singular-values": singular_values(content.result),
                "correlation": correlation_map(content.result),
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return what the data determine, in words and figures."""
        ident = content.result.identifiability
        parts = [
            m.paragraph(
                f"The data determine all of the {w.counted(ident.n_parameters, 'unknown')}."
                if ident.complete
                else (
                    f"The data determine {ident.rank} independent combinations of the"
                    f" {ident.n_parameters} unknowns. The rest is open: the fit left it where it"
                    " happened to be."
                )
            ),
        ]
        if ident.advice:
            parts.append(m.note(ident.advice))
        if ident.null_directions:
            parts.append(
                "<h3>Open combinations</h3><p>These move together without changing anything measured."
                " In brackets: how far, against the first (relative to itself for a factor; for damping"
                " in the loss factor that it amounts to in the middle of the band).</p>"
            )
            parts.append(_directions(ident.null_directions, w.combination))
        if ident.determined_directions:
            parts.append(
                "<h3>What is still known about them</h3><p>Of these unknowns the data determine, by"
                " weights too:</p>"
            )
            parts.append(_directions(ident.determined_directions, w.weighted_sum))
        if "singular-values" in figures:
            caption = (
                "Singular values of the Jacobian with columns scaled to unit length: how strongly the"
                " data react to each independent combination of unknowns. Condition number"
                f" {w.number(ident.condition, 3)}, collinearity index {w.number(ident.collinearity, 3)}"
                " (above 10 to 15 the unknowns are hard to tell apart)."
            )
            parts.append("<h3>How strongly</h3>")
            parts.append(
                m.figure(
                    "singular-values",
                    "Singular values, falling",
                    caption,
                    height=figures["singular-values"]["height"],
                )
            )
        if "correlation" in figures:
            caption = (
                "Correlation of the estimates: near +1 or −1 the data see two unknowns together and"
                " hardly tell them apart. Blank: not determined, so there is no correlation to give."
            )
            plot = m.figure(
                "correlation",
                "Correlation matrix of the unknowns",
                caption,
                height=figures["correlation"]["height"],
            )
            title = "Which unknowns the data confuse"
            parts.append(
                f"<h3>{title}</h3>{plot}"
                if len(content.result.parameters) <= 24
                else m.details(title, plot)
            )
        return "".join(parts)


IDENTIFIABILITY = DeterminedUnknowns()


def _directions(directions: list[dict[str, float]], say: Callable[[dict[str, float]], str]) -> str:
    items = "".join(f"<li>{m.esc(say(d))}</li>" for d in directions)
    return f'<ol class="directions">{items}</ol>'


class Convergence(Section):
    """Cost and unknowns over the iterations."""

    anchor = "convergence"
    name = "Convergence"
    heading = "Convergence"
    place = 800

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the cost and the path of each kind of unknown."""
        result = content.result
        paths = {
            name: value_paths(result, chosen)
            for name, chosen in _by_figure(
                result, "factor-paths", "-paths", "calibration-paths"
            ).items()
        }
        return existing({"cost": cost_path(result), **paths})

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return cost and unknowns over the iterations."""
        parts: list[str] = []
        if "cost" not in figures:
            return "".join(parts) + m.paragraph("No iterations were recorded.", "muted")
        stages = list(dict.fromkeys(h.stage for h in content.result.history))
        last = [h for h in content.result.history if h.accepted and h.stage == stages[-1]]
        refused = sum(not h.accepted for h in content.result.history)
        said = f"{w.counted(content.result.iterations, 'step')} taken, {refused} refused."
        if last:
            where = f"In the last stage, {stages[-1]}, the" if len(stages) > 1 else "The"
            said += f" {where} cost went from {w.number(last[0].cost, 3)} to {w.number(last[-1].cost, 3)}."
        parts.append(m.paragraph(said))
        caption = "Cost: half the sum of squared weighted residuals."
        if len(stages) > 1:
            explained = "; ".join(f"{s}: {_STAGE_WORDS[s]}" for s in stages if s in _STAGE_WORDS)
            caption += (
                " Each stage weighs the residuals in its own way: compare costs within a stage only. "
                + explained
            )
            caption = caption.strip().removesuffix(".") + "."
        parts.append(
            m.figure("cost", "Cost by iteration", caption, height=figures["cost"]["height"])
        )
        paths = [
            ("factor-paths", "Paths of the factors"),
            ("calibration-paths", "Paths of the calibration factors"),
        ]
        for name, title in (
            *paths,
            *((name, f"Paths: {title.lower()}") for name, title in _kinds("-paths")),
        ):
            if name in figures:
                parts.append(f"<h3>{title}</h3>")
                parts.append(
                    m.figure(
                        name, f"{title} over the iterations", "", height=figures[name]["height"]
                    )
                )
        return "".join(parts)


CONVERGENCE = Convergence()
