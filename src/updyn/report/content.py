"""What every section of the report is made from, and the figures of agreement that it quotes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import numpy as np

from updyn.report.agreement import level_difference
from updyn.report.data import ReportData
from updyn.report.plots import Figure
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import UpdateResult

__all__ = ["Content", "agreement_figures", "asset"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What a section is made from.

    Attributes
    ----------
    result : UpdateResult
        The result.
    data : ReportData
        Measured and computed FRFs.
    figures : mapping of str to dict
        The figures that there are, by name.
    note : str
        What was thinned to keep the page small; empty where nothing was.
    uncertainty : Draws or Profiles, optional
        What was found beyond the standard deviations.
    """

    result: UpdateResult
    data: ReportData
    figures: Mapping[str, Figure]
    note: str
    uncertainty: Draws | Profiles | None = None


def asset(name: str) -> str:
    """Return the text of a file of the package, safe inside the element that it goes into."""
    text = (resources.files("updyn.report") / "assets" / name).read_text(encoding="utf-8")
    return (
        text.replace("</script", "<\\/script")
        .replace("</style", "<\\/style")
        .replace("<!--", "<\\!--")
    )


def agreement_figures(result: UpdateResult, data: ReportData) -> dict[str, dict[str, float]]:
    """Return the figures of agreement of the result; where it has none, those of this page's own comparison."""
    held = result.correlation.get("validation") or {}
    out = {when: dict(result.correlation.get(when) or {}) for when in ("before", "after")}
    out["validation"] = dict(held.get("after") or {})
    fitted = ~np.array(data.held_out, dtype=np.bool_)
    for when, frac, values in (
        ("before", data.frac_before, data.before),
        ("after", data.frac_after, data.after),
    ):
        if not out[when] and frac is not None and values is not None and fitted.any():
            level = level_difference(
                data.measured[data.compared][:, fitted], values[data.compared][:, fitted]
            )
            out[when] = {"frac_median": float(np.median(frac[fitted]))}
            if level.size:
                out[when]["db_error_median"] = float(np.median(np.abs(level)))
    return out
