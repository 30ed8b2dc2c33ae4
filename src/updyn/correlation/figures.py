"""Names of figures of agreement, and a text table of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from updyn.text_table import text_table

__all__ = [
    "FIGURE_NAMES",
    "LEADING_FIGURES",
    "ONE_AT_BEST",
    "SHORT_NAMES",
    "agreement_table",
    "capitalized_name",
    "figure_text",
]

#: Names of the figures of `Correlation.figures`, in display order.
FIGURE_NAMES: Mapping[str, str] = {
    "frac_median": "FRAC, median over channels",
    "frac_min": "FRAC, worst channel",
    "correlation_median": "FRF correlation, median over channels",
    "correlation_min": "FRF correlation, worst channel",
    "residual_median": "relative residual, median over channels",
    "residual_max": "relative residual, worst channel",
    "residual_expected": "relative residual that noise and deviations predict, median",
    "residual_deviations": "residual in predicted standard deviations, median",
    "csac_mean": "CSAC, mean over lines",
    "csf_mean": "CSF, mean over lines",
    "db_error_median": "level difference, median (dB)",
    "db_error_p95": "level difference, 95 % of values below (dB)",
    "modes_measured": "modes, measured",
    "modes_paired": "modes, paired",
    "modes_close": "modes, close (MAC of their subspaces)",
    "mac_median": "MAC, median over modes",
    "mac_min": "MAC, worst mode",
    "frequency_error_rms": "frequency, rms error of pairs (%)",
    "frequency_error_max": "frequency, worst error of pairs (%)",
    "loss_factor_error_rms": "loss factor, rms error of pairs (%)",
}
#: Short names for headings of narrow columns.
SHORT_NAMES: Mapping[str, str] = {
    "frac_median": "FRAC",
    "frac_min": "worst",
    "correlation_median": "correlation",
    "correlation_min": "worst",
    "residual_median": "residual",
    "residual_max": "worst",
    "db_error_median": "dB",
    "db_error_p95": "dB, 95 %",
}
#: Leading figures of agreement: a line of text shows the first that is known.
LEADING_FIGURES = ("db_error_median", "frequency_error_rms", "mac_median")
#: Prefixes of figures with a best value of 1.
ONE_AT_BEST = ("frac_", "correlation_", "csac_", "csf_", "mac_")


def capitalized_name(name: str) -> str:
    """Return the name of a figure of agreement at the start of a line."""
    words = FIGURE_NAMES[name]
    return f"{words[0].upper()}{words[1:]}"


def figure_text(name: str, value: float) -> str:
    """Return a figure of agreement, named as in `FIGURE_NAMES`, as text."""
    if not name.startswith(ONE_AT_BEST):
        return f"{value:.3g}"
    if 0.9999 < value < 1.0:
        return ">0.9999"
    return f"{value:.4f}"


def agreement_table(columns: Mapping[str, Mapping[str, Any]]) -> str:
    """Return figures of agreement as a text table with a row per figure, a column per heading."""
    shown = {heading: figures for heading, figures in columns.items() if figures}
    rows = []
    for name, words in FIGURE_NAMES.items():
        cells = []
        for figures in shown.values():
            value = figures.get(name)
            cells.append("-" if value is None else figure_text(name, value))
        if any(cell != "-" for cell in cells):
            rows.append([words, *cells])
    if not rows:
        return ""
    return text_table(("agreement", *shown), rows)
