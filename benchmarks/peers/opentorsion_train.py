"""openTorsion's forced response, `Assembly.ss_response`, of drive trains with viscous damping.

It inverts Z at every frequency and gives displacement and speed of all nodes for one column of
torques. updyn is asked for the same: the receptance of all nodes to one torque.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import models
import numpy as np

import updyn
from peers.measure import Row, best, same

PACKAGE = "opentorsion"


def tables(options: Any) -> Iterator[tuple[str, list[Row]]]:
    import opentorsion

    lines = np.linspace(1.0, 200.0, options.train_lines)
    for n in options.trains:
        title = f"Forced response of a drive train: {n} inertias, {len(lines)} lines"
        yield title, _compare(opentorsion, models.drive_train(n), lines)


def _compare(opentorsion: Any, model: updyn.Model, lines: np.ndarray) -> list[Row]:
    n, dofs = model.n_dofs, [str(d) for d in model.dofs]
    mass, stiffness, viscous = (m.toarray() for m in (model.mass, model.stiffness, model.viscous))
    shafts = [
        opentorsion.Shaft(i, i + 1, k=-stiffness[i, i + 1], c=-viscous[i, i + 1])
        for i in range(n - 1)
    ]
    train = opentorsion.Assembly(
        shafts, disk_elements=[opentorsion.Disk(i, I=mass[i, i]) for i in range(n)]
    )
    torque = np.zeros((n, len(lines)), dtype=complex)
    torque[0] = 1.0
    rows: list[Row] = []
    for tier in (None, "sparse"):
        taken = best(lambda t=tier: updyn.response(model, lines, dofs, dofs[:1], tier=t))
        against = rows[0].against if rows else taken
        rows.append(Row(f"updyn.response, {tier or 'tier by size'}", taken, against))
    theirs = train.ss_response(torque, 2 * np.pi * lines)[0].T
    ours = updyn.response(model, lines, dofs, dofs[:1]).values[:, :, 0]
    differs = same(theirs, ours, 1e-8, "openTorsion ss_response")
    taken = best(lambda: train.ss_response(torque, 2 * np.pi * lines))
    return [*rows, Row("openTorsion Assembly.ss_response", taken, rows[0].against, differs)]
