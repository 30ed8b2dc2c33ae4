"""sdynpy's System: `frequency_response` and `reduce_dynamic`, on dense matrices.

`frequency_response` inverts Z at every line and yields the FRF of any DOFs; its damping is viscous.
`reduce_dynamic` condenses K, M and C at one frequency with the undamped K - omega^2 M, so that only
of undamped structures it is the exact condensation, and there it is compared. Neither gives
derivatives; updyn is timed without and with them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import models
import numpy as np

import updyn
from peers.measure import Case, Row, best, dense_models, same, steps
from updyn.updating.problem.residuals import EquationError, LogError

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
os.environ.setdefault("MPLBACKEND", "agg")

PACKAGE = "sdynpy"


def _system(sdynpy: Any, model: updyn.Model) -> Any:
    dense = [
        None if m is None or not m.nnz else m.toarray()
        for m in (model.mass, model.stiffness, model.viscous)
    ]
    return sdynpy.System(sdynpy.coordinate_array(np.arange(1, model.n_dofs + 1), "X+"), *dense)


def _at(model: updyn.Model, dofs: Any) -> np.ndarray:
    return model.dofs.match(dofs, "DOF").index


def _frequency_response(sdynpy: Any, model: updyn.Model, lines: np.ndarray) -> list[Row]:
    case = Case.build(model, lines)
    data = case.data
    ours = updyn.response(model, lines, data.responses, data.references).values
    alone = best(lambda: updyn.response(model, lines, data.responses, data.references))
    derivatives = best(steps(LogError(), case.problem()))
    system = _system(sdynpy, model)
    i, j = (system.coordinate[_at(model, dofs)] for dofs in (data.responses, data.references))
    theirs = system.frequency_response(lines, i, j).ordinate
    taken = best(lambda: system.frequency_response(lines, i, j))
    differs = same(np.moveaxis(theirs, -1, 0), ours, 1e-8, "sdynpy frequency_response")
    return [
        Row("updyn.response", alone, alone),
        Row(f"updyn, with {len(case.unknowns)} derivatives", derivatives, alone),
        Row(
            "sdynpy System.frequency_response",
            taken,
            alone,
            differs,
            f"{taken / derivatives:.1f} x with derivatives",
        ),
    ]


def _reduce_dynamic(sdynpy: Any, model: updyn.Model, lines: np.ndarray) -> list[Row]:
    case = Case.build(model, lines)
    kept = case.data.responses
    ours = updyn.condense(model, lines, kept).Z
    alone = best(lambda: updyn.condense(model, lines, kept))
    derivatives = best(steps(EquationError(), case.problem()))
    system, at = _system(sdynpy, model), _at(model, kept)
    systems = [system.reduce_dynamic(at, f) for f in lines]
    theirs = np.array(
        [s.K - (2 * np.pi * f) ** 2 * s.M for s, f in zip(systems, lines, strict=True)]
    )
    taken = best(lambda: [system.reduce_dynamic(at, f) for f in lines])
    differs = same(theirs, ours, 1e-8, "sdynpy reduce_dynamic")
    return [
        Row("updyn.condense", alone, alone),
        Row(f"updyn, with {len(case.unknowns)} derivatives", derivatives, alone),
        Row(
            "sdynpy System.reduce_dynamic",
            taken,
            alone,
            differs,
            f"{taken / derivatives:.1f} x with derivatives",
        ),
    ]


def tables(options: Any) -> Iterator[tuple[str, list[Row]]]:
    import sdynpy

    lines = np.linspace(20.0, 200.0, options.dense_lines)
    for name, model in dense_models(options.dense_dofs):
        head = f"{name}: {model.n_dofs} DOFs, {len(lines)} lines, 30 sensors"
        viscous = models.damped(model, 1e-5)
        yield (
            f"FRF of viscous damping, {head}, 3 references",
            _frequency_response(sdynpy, viscous, lines),
        )
        yield f"Undamped condensation, {head}", _reduce_dynamic(sdynpy, models.damped(model), lines)
