"""The viewer as the notebook representation of models, loaded by `updyn.notebook.VIEWERS`."""

from __future__ import annotations

from updyn.errors import InputError
from updyn.model import Model
from updyn.settings import NOTEBOOK
from updyn.viewer.models import model_scene
from updyn.viewer.page import html

__all__ = ["model_frame"]

#: Height of the frame in px.
_HEIGHT = 440


def model_frame(model: Model) -> str | None:
    """Return a model as an HTML frame; None without a geometry to draw, or with too many nodes."""
    if model.geometry is None or len(model.geometry.nodes) > NOTEBOOK.viewer_nodes:
        return None
    try:
        return html(model_scene(model), height=_HEIGHT)
    except InputError:
        return None
