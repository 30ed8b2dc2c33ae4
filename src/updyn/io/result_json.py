"""``result.json``: the outcome of an update for other programs. Strict JSON; inf and nan are null."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from updyn.io.atomic import write_json
from updyn.io.values_text import plain
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["result_to_json", "write_result_json"]


def result_to_json(result: UpdateResult | JointResult) -> dict[str, Any]:
    """Return the outcome as a dict that `json.dumps` writes without inf or nan.

    Parameters
    ----------
    result : UpdateResult or JointResult
        The outcome. Of several tests, ``correlation`` and ``noise`` are those of the first.

    Returns
    -------
    dict
        ``status``, ``message``, ``remedy``, ``title``, ``method``, ``options``; ``parameters``, one
        dict an unknown in order, with ``std`` None and ``identifiable`` False where the data leave
        it open, ``at_bound`` True or False and ``bound`` ``"lower"``, ``"upper"`` or None,
        ``nominal`` and ``unit`` of what a factor of 1 stands for, ``drives`` of a linked unknown;
        ``identifiability``; ``correlation`` with ``before``, ``after`` and ``validation`` (empty
        where there is none); ``noise``; ``iterations`` (accepted steps) and ``history``;
        ``timing_s`` in s; ``versions``; ``adequacy``, None where it was not tested: ``outcome``,
        ``verdict``, ``absolute``, ``chi_square``, ``p_value``, ``level``, ``bands`` in Hz,
        ``misfit`` over noise by response, reference and band, the ``worst`` places and
        ``explained_by``. Of several tests also ``tests``: ``correlation``, ``noise`` and
        ``adequacy`` by name.
    """
    if isinstance(result, JointResult):
        own = {name: result_to_json(one) for name, one in result.results.items()}
        tests = {
            name: {key: one[key] for key in ("correlation", "noise", "adequacy")}
            for name, one in own.items()
        }
        return {**next(iter(own.values())), "title": result.title, "tests": tests}
    ident = result.identifiability
    return {
        "status": result.status,
        "message": result.message,
        "remedy": result.remedy,
        "title": result.title,
        "method": result.method,
        "options": plain(result.options),
        "parameters": [_parameter(result, name) for name in result.parameters.names],
        "identifiability": plain(
            {
                "rank": ident.rank,
                "n_parameters": ident.n_parameters,
                "condition": ident.condition,
                "null_directions": ident.null_directions,
                "determined_directions": ident.determined_directions,
                "collinearity": ident.collinearity,
                "singular_values": ident.singular_values,
                "advice": ident.advice,
            }
        ),
        "correlation": {
            when: plain(result.correlation.get(when, {}))
            for when in ("before", "after", "validation")
        },
        "noise": plain(result.noise),
        "iterations": result.iterations,
        "history": [
            plain(
                {
                    key: getattr(h, key)
                    for key in ("stage", "number", "cost", "step", "condition", "accepted")
                }
            )
            for h in result.history
        ],
        "timing_s": plain(result.timing_s),
        "versions": plain(result.versions),
        "adequacy": _adequacy(result.adequacy),
    }


def _adequacy(found: Adequacy | None) -> dict[str, Any] | None:
    if found is None:
        return None
    keys = ("outcome", "verdict", "absolute", "chi_square", "p_value", "level", "bands", "misfit")
    places = {
        "worst": [asdict(p) for p in found.worst],
        "explained_by": [asdict(s) for s in found.explained_by],
    }
    out: dict[str, Any] = plain({**{key: getattr(found, key) for key in keys}, **places})
    return out


def _parameter(result: UpdateResult, name: str) -> dict[str, Any]:
    unknown = next(p for p in result.parameters if p.name == name)
    std = result.std.get(name, math.nan)
    numbers = {
        "start": unknown.start,
        "value": result.values.get(name, math.nan),
        "std": std,
        "lower": unknown.lower,
        "upper": unknown.upper,
    }
    return {
        "name": name,
        "group": unknown.group,
        "quantity": unknown.quantity,
        **plain(numbers),
        "nominal": unknown.nominal,
        "unit": unknown.unit,
        "drives": [
            {"group": d.group, "quantity": d.quantity, "power": d.power} for d in unknown.drives
        ],
        "at_bound": name in result.at_bound,
        "bound": result.at_bound.get(name),
        "identifiable": bool(math.isfinite(std)),
    }


def write_result_json(result: UpdateResult | JointResult, path: str | Path) -> None:
    """Write `result_to_json` to a file, replaced as a whole once it is complete.

    Parameters
    ----------
    result : UpdateResult or JointResult
        The outcome.
    path : path
        File to write, usually ``result.json``.
    """
    write_json(result_to_json(result), path)
