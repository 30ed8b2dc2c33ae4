"""Interactive 3-D view of structures: a scene of plain arrays, and its viewer for HTML pages."""

from updyn.viewer.bodies import arrows_at, entries_of, model_body, motions, sensor_body
from updyn.viewer.colourings import by_size
from updyn.viewer.models import model_scene
from updyn.viewer.page import fragment, html, page, script
from updyn.viewer.scene import (
    Arrow,
    Body,
    Colouring,
    Entries,
    Layer,
    ModeRow,
    ModeShapes,
    OperatingLayer,
    OperatingShapes,
    Reference,
    Scale,
    Scene,
)

__all__ = [
    "Arrow",
    "Body",
    "Colouring",
    "Entries",
    "Layer",
    "ModeRow",
    "ModeShapes",
    "OperatingLayer",
    "OperatingShapes",
    "Reference",
    "Scale",
    "Scene",
    "arrows_at",
    "by_size",
    "entries_of",
    "fragment",
    "html",
    "model_body",
    "model_scene",
    "motions",
    "page",
    "script",
    "sensor_body",
]
