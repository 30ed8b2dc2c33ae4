"""The sections of the report that back it up: validation, noise and residual, how it was made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.agreement import level_differences, residual_by_channel
from updyn.report.data import data_checksum, model_checksum
from updyn.report.plots import Figure, existing
from updyn.report.section import Content, Section

__all__ = ["NOISE", "PROVENANCE", "VALIDATION"]


class Validation(Section):
    """Agreement with the data held out of the fit."""

    anchor = "validation"
    name = "Validation"
    heading = "Validation on what was held out"
    place = 900

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return what was held out, and how well it is predicted."""
        parts = []
        what = w.held_out(content.result)
        if not what:
            text = (
                "Nothing was held out of the fit, so these data cannot say how well the updated model"
                " predicts what it has not seen. Hold out a response or a band to find out."
            )
            return m.paragraph(text)
        parts.append(m.paragraph(f"Held out of the fit, and used only to judge it: {what}."))
        scores = content.result.correlation.get("validation") or {}
        before, after = (dict(scores.get(k) or {}) for k in ("before", "after"))
        names = list(dict.fromkeys([*before, *after]))
        if names:
            rows = [
                m.row([w.agreement_name(n), w.number(before.get(n)), w.number(after.get(n))])
                for n in names
            ]
            parts.append(
                m.table(
                    ["figure", "before", "after"], rows, caption="Figures over the data held out"
                )
            )
        else:
            parts.append(m.paragraph("There are no figures for it.", "muted"))
        rows = [
            m.row(
                [
                    f"{response} / {reference}",
                    _cell(content.data.frac_before, i, j),
                    _cell(content.data.frac_after, i, j),
                ]
            )
            for i, (response, held) in enumerate(
                zip(content.data.responses, content.data.held_out, strict=True)
            )
            if held
            for j, reference in enumerate(content.data.references)
        ]
        if rows:
            shown = m.table(["response / reference", "FRAC before", "FRAC after"], rows)
            parts.append(
                shown if len(rows) <= 20 else m.details(f"All {len(rows)} channels held out", shown)
            )
        return "".join(parts)


VALIDATION = Validation()


def _cell(frac: NDArray[Any] | None, i: int, j: int) -> str:
    return "–" if frac is None else w.figure_of_agreement(float(frac[i, j]))


_NOISE_WORDS = {
    "kind": "how the noise is known",
    "relative": "part proportional to the level",
    "floor": "floor",
    "relative_by_channel": "part proportional to the level, by response",
    "floor_by_channel": "floor, by response",
    "spread": "residual, as if all values were equally sure",
    "modes": "modes fitted",
    "frequency_rms": "frequencies, rms of model over measured less 1",
    "shape_rms": "shapes, root of the mean of 1 - MAC",
    "lowest_mac": "lowest MAC of a pair",
    "left_out": "measured modes like none of the model",
    "chi_square": "reduced chi-square",
    "correlation_length": "lines over which the residual is correlated",
    "inflation": "factor on the standard deviations",
    "robust": "outliers",
    "down_weighted": "share of values with less than a tenth of their weight",
    "down_weighted_lines": "lines half of whose values do, Hz",
    "down_weighted_channels": "channels half of whose values do",
}


class Noise(Section):
    """Noise model and residual."""

    anchor = "noise"
    name = "Noise and residual"
    heading = "Noise and residual"
    place = 1100

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return level differences and the residual by channel."""
        return existing(
            {
                "level-differences": level_differences(content.data),
                "residual-by-channel": residual_by_channel(content.data),
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return noise model and what is left over."""
        items = [
            (_NOISE_WORDS.get(k, k), w.number(v) if isinstance(v, float) else w.plain(v))
            for k, v in content.result.noise.items()
        ]
        chi = content.result.noise.get("chi_square")
        parts = []
        if isinstance(chi, int | float) and math.isfinite(chi):
            parts.append(m.paragraph(_chi_words(float(chi), content.result.noise)))
        if "down_weighted" in content.result.noise:
            parts.append(m.paragraph(_outlier_words(content.result.noise)))
        parts.append(
            m.definition_table(items)
            if items
            else m.paragraph("The method used no noise model.", "muted")
        )
        if "level-differences" in figures:
            caption = (
                "How often the computed level lies above (positive) or below the measured one, over all"
                " channels and the lines compared; values beyond ±30 dB are counted at the ends."
            )
            parts.append("<h3>Level differences</h3>")
            parts.append(
                m.figure(
                    "level-differences",
                    "Histogram of level differences",
                    caption,
                    height=figures["level-differences"]["height"],
                )
            )
        if "residual-by-channel" in figures:
            caption = (
                "Root mean square of computed minus measured (magnitude and phase) over the lines"
                " compared, in percent of the channel's measured level: a channel that stands out"
                " points to a sensor or a place in the model."
            )
            parts.append("<h3>Residual by channel</h3>")
            parts.append(
                m.figure(
                    "residual-by-channel",
                    "Residual of every channel",
                    caption,
                    height=figures["residual-by-channel"]["height"],
                )
            )
        return "".join(parts)


NOISE = Noise()


def _chi_words(chi: float, noise: Mapping[str, Any]) -> str:
    shown = w.number(chi, 3)
    if w.noise_is_fitted(noise):
        return (
            f"Reduced chi-square {shown}, by construction: the noise is taken from what is left,"
            " model error included."
        )
    if chi > 2.0:
        return (
            f"Reduced chi-square {shown}: the residual is {w.number(math.sqrt(chi), 2)} times what"
            " the noise explains. Part of it is an error of the model's form (or the noise is"
            " larger than stated)."
        )
    if chi < 0.5:
        return (
            f"Reduced chi-square {shown}: the residual is smaller than the noise stated, which is"
            " stated too large."
        )
    return f"Reduced chi-square {shown}: the noise explains what is left."


def _outlier_words(noise: Mapping[str, Any]) -> str:
    """Return what counted next to nothing, as it did not fit the rest."""
    share = float(noise["down_weighted"])
    if share == 0.0:
        return "No value stands out: all keep more than a tenth of their weight."
    lines, channels = noise.get("down_weighted_lines", ()), noise.get("down_weighted_channels", ())
    whole = [f"the lines {w.plain(lines)} Hz"] if lines else []
    whole += [f"the channels {w.plain(channels)}"] if channels else []
    among = f" Among them at least half of {' and '.join(whole)}." if whole else ""
    return (
        f"{w.number(100.0 * share, 2)} % of the values stand out and have less than a tenth of"
        f" their weight.{among} Look at them: a hum, an overload or a loose sensor makes outliers;"
        " a resonance that the model lacks does, too."
    )


class Provenance(Section):
    """Options, lines, versions, checksums and time of the update."""

    anchor = "provenance"
    name = "How it was made"
    heading = "How it was made"
    place = 9000

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """How the result was made: options, lines, versions, checksums, time."""
        lines = ", ".join(f"{f:.6g}" for f in content.result.lines)
        options = [(str(k), w.plain(v)) for k, v in content.result.options.items()]
        about = [
            ("method", content.result.method),
            ("measured data", f"{content.result.frf.quantity}, {w.extent(content.result.frf)}"),
            ("source of the data", content.result.frf.source or "not stated"),
            (
                "model",
                f"{content.result.start.n_dofs} DOFs, groups: {', '.join(content.result.start.groups)}",
            ),
            ("responses fitted", ", ".join(content.result.fitted_responses) or "none"),
            ("held out", w.held_out(content.result) or "nothing"),
        ]
        sums = [
            ("measured data", data_checksum(content.result.frf)),
            ("start model", model_checksum(content.result.start)),
            ("updated model", model_checksum(content.result.model)),
        ]
        explained = (
            "SHA-256 of the numbers themselves, not of a file: of the quantity, labels, lines and"
            " values of the data, and of the labels, loss factors and matrices of each model."
        )
        seconds = [(k, f"{w.number(float(v), 3)} s") for k, v in content.result.timing_s.items()]
        return "".join(
            [
                m.definition_table(about),
                m.details(
                    "Options", m.definition_table(options) if options else m.paragraph("None.")
                ),
                m.details(
                    f"Lines used in the fit ({len(content.result.lines)}), in Hz",
                    m.paragraph(lines or "none"),
                ),
                m.details("Checksums", m.paragraph(explained) + m.definition_table(sums)),
                m.details(
                    "Versions",
                    m.definition_table(
                        [(str(k), str(v)) for k, v in content.result.versions.items()]
                    ),
                ),
                m.details("Time", m.definition_table(seconds)),
            ]
        )


PROVENANCE = Provenance()
