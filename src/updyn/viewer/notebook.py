"""Models in the viewer as notebooks show them: what `updyn.notebook.VIEWERS` loads."""

from __future__ import annotations

from updyn.errors import InputError
from updyn.model import Model
from updyn.viewer.models import model_scene
from updyn.viewer.page import html

__all__ = ["model_frame"]

#: Larger models stay a still picture: a notebook keeps the data of every output.
_MOST_NODES = 20_000
#: Height of the frame in px.
_HEIGHT = 440


def model_frame(model: Model) -> str | None:
    """Return a model in a frame for a notebook.

    Parameters
    ----------
    model : Model
        What is shown.

    Returns
    -------
    str or None
        HTML; None where it has no geometry that can be drawn, or a very large one.
    """
    if model.geometry is None or len(model.geometry.nodes) > _MOST_NODES:
        return None
    try:
        return html(model_scene(model), height=_HEIGHT)
    except InputError:
        return None
