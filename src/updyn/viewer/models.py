"""`model_scene`: a model with its modes as a scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from updyn.dofs import Dof
from updyn.dynamics.modes import Modes
from updyn.errors import InputError
from updyn.model import Model
from updyn.viewer.bodies import arrows_at, entries_of, model_body, motions
from updyn.viewer.scene import Colouring, Layer, ModeRow, ModeShapes, Scene

__all__ = ["model_scene"]


def model_scene(
    model: Model,
    modes: Modes | None = None,
    *,
    responses: Iterable[str | Dof] = (),
    references: Iterable[str | Dof] = (),
    colourings: Sequence[Colouring] = (),
    title: str | None = None,
) -> Scene:
    """Return the scene of a model.

    Parameters
    ----------
    model : Model
        A model with a geometry.
    modes : Modes, optional
        Result of `updyn.modes`, to animate.
    responses, references : iterable of str or Dof
        Sensors and forces, drawn as arrows.
    colourings : sequence of Colouring
        Colourings of the groups.
    title : str, optional
        Title; None for that of the model.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the model has no geometry, or a sensor or force has no position in it.
    """
    sensors, forces = list(responses), list(references)
    body = model_body(model, [*sensors, *forces])
    geometry = model.geometry
    assert geometry is not None
    arrows, missing = arrows_at(body, geometry, sensors, forces)
    if missing:
        raise InputError(
            f"viewer: {', '.join(missing)}: the geometry has no such node; it has"
            f" {geometry.nodes.min()} to {geometry.nodes.max()}"
        )
    shown = None
    if modes is not None:
        shapes = motions(body, entries_of(body, geometry, modes.dofs), modes.shapes)
        layer = Layer("model", "plain", "surface", 0, shapes)
        rows = []
        for number, (frequency, loss) in enumerate(
            zip(modes.frequency.tolist(), modes.loss_factor.tolist(), strict=True)
        ):
            label = f"{number + 1}: {frequency:.5g} Hz"
            if np.isfinite(loss) and loss > 0.0:
                label += f", loss factor {loss:.2g}"
            rows.append(ModeRow(label, (number,)))
        shown = ModeShapes([layer], rows)
    return Scene([body], model.title if title is None else title, list(colourings), arrows, shown)
