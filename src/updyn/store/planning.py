"""``plan.json``: a test plan as strict JSON; inf and nan are null."""

from __future__ import annotations

from pathlib import Path

from updyn import __version__
from updyn.io.atomic import write_json
from updyn.planning.result import Plan
from updyn.store.values import plain, plain_fields, plain_records

__all__ = ["plan_to_json", "write_plan_json"]


def plan_to_json(plan: Plan, title: str = "") -> dict[str, object]:
    """Return a plan as a dict that `json.dumps` writes without inf or nan.

    Most entries are fields of `updyn.Plan`; ``lines`` are in Hz. ``parameters`` has a dict per
    unknown, whose ``least`` and ``largest`` standard deviation are over the draws (None without
    draws).
    """
    unknowns = []
    for p in plan.parameters:
        least, largest = plan.std_range.get(p.name, (None, None))
        unknowns.append(
            {
                "name": p.name,
                "start": plain(p.start),
                "std": plain(plan.std[p.name]),
                "least": plain(least),
                "largest": plain(largest),
                "counts": p.name in plan.wanted,
            }
        )
    return {
        "title": title,
        **plain_fields(plan, *_LAYOUT),
        "lines": plain(plan.freq),
        "parameters": unknowns,
        **plain_fields(plan, *_FIGURES),
        **{name: plain_records(getattr(plan, name)) for name in _RECORDS},
        **plain_fields(plan, "draws", "off", "seed", "screened"),
        "versions": {"updyn": __version__},
    }


_LAYOUT = ("criterion", "responses", "references", "band", "quantity", "noise")
_FIGURES = ("radius", "gain", "reference_gain", "doubled")
_RECORDS = ("further", "further_references", "parts", "bands", "rivals")


def write_plan_json(plan: Plan, path: str | Path, title: str = "") -> None:
    """Write `plan_to_json` to a file, which is replaced only once the new one is complete."""
    write_json(plan_to_json(plan, title), path)
