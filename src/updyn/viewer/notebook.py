"""The viewer as the notebook representation of models, loaded by `updyn.notebook.VIEWERS`."""

from __future__ import annotations

from updyn.errors import InputError
from updyn.model import Model
from updyn.viewer.models import model_scene
from updyn.viewer.page import html

__all__ = ["model_frame"]

#: Largest number of nodes of an interactive model, because a notebook stores the data of each
#: output.
_MOST_NODES = 20_000
#: Height of the frame in px.
_HEIGHT = 440


def model_frame(model: Model) -> str | None:
    """Return a model as an HTML frame; None without a geometry to draw, or with too many nodes."""
    if model.geometry is None or len(model.geometry.nodes) > _MOST_NODES:
        return None
    try:
        return html(model_scene(model), height=_HEIGHT)
    except InputError:
        return None
