"""A scene as JSON: arrays as base64 of little-endian numbers, shapes as 16-bit integers."""

from __future__ import annotations

import base64
import json

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.viewer.scene import (
    Body,
    Colouring,
    Entries,
    Layer,
    ModeShapes,
    OperatingShapes,
    Reference,
    Scale,
    Scene,
)

__all__ = ["FORMAT", "as_json", "embedded_json", "encode_scene"]

#: Version of the JSON; the script rejects other versions.
FORMAT = 1
#: Integer that represents the largest displacement; a resolution of 1/32767 is finer than a pixel.
_FINEST = 32767


def as_json(scene: Scene) -> str:
    """Return a scene as JSON that is safe inside a script element."""
    return embedded_json(encode_scene(scene))


def embedded_json(value: object) -> str:
    """Return data as JSON that can neither end the enclosing script element nor start a comment."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def encode_scene(scene: Scene) -> dict[str, object]:
    """Return a scene as objects that JSON can represent.

    Float arrays are base64 of float32, integer arrays base64 of int32. Shapes are ``data``, base64
    of int16, and ``scale``, the value of the integer 32767.
    """
    return {
        "format": FORMAT,
        "title": scene.title,
        "bodies": [_encode_body(body) for body in scene.bodies],
        "colourings": [_encode_colouring(colouring) for colouring in scene.colourings],
        "arrows": [
            {
                "kind": a.kind,
                "node": a.node,
                "vector": [round(float(part), 6) for part in a.vector],
                "rotation": a.rotation,
                "label": a.label,
            }
            for a in scene.arrows
        ],
        "modes": None if scene.modes is None else _encode_modes(scene.modes),
        "operating": None if scene.operating is None else _encode_operating(scene.operating),
    }


def _encode_colouring(colouring: Colouring) -> dict[str, object]:
    return {
        "name": colouring.name,
        "unit": colouring.unit,
        "steps": [{"colour": colour, "text": text} for colour, text in colouring.steps],
        "step_of_group": list(colouring.step_of_group),
        "texts": list(colouring.texts),
        "by_row": [[list(steps), list(texts)] for steps, texts in colouring.by_row],
        "scale": None if colouring.scale is None else _encode_scale(colouring.scale),
        "labels": list(colouring.labels),
    }


def _encode_scale(scale: Scale) -> dict[str, object]:
    return {
        "colours": list(scale.colours),
        "ticks": [[_encode_place(place), text] for place, text in scale.ticks],
        "of_group": [_encode_place(place) for place in scale.of_group],
        "by_row": [[_encode_place(place) for place in places] for places in scale.by_row],
    }


def _encode_place(place: float) -> float | None:
    """Return a place on a scale to four digits, finer than a step of colour; None for nan."""
    return None if np.isnan(place) else round(float(place), 4)


def _encode_floats(values: ArrayLike) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _encode_integers(values: ArrayLike) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<i4").tobytes()).decode()


def _encode_scaled(values: RealArray) -> dict[str, object]:
    """Return values as 16-bit integers, with the value of the largest one."""
    scale = float(np.abs(values).max(initial=0.0))
    finest = np.zeros(values.shape, dtype="<i2")
    if scale > 0.0:
        finest = np.rint(values / scale * _FINEST).astype("<i2")
    return {"data": base64.b64encode(finest.tobytes()).decode(), "scale": scale}


def _encode_body(body: Body) -> dict[str, object]:
    return {
        "name": body.name,
        "labels": _encode_integers(body.nodes),
        "xyz": _encode_floats(body.xyz),
        "real": body.real,
        "disc": body.disc,
        "lines": _encode_integers(body.lines),
        "line_group": _encode_integers(body.line_group),
        "faces": _encode_integers(body.faces),
        "face_group": _encode_integers(body.face_group),
        "points": _encode_integers(body.points),
        "point_group": _encode_integers(body.point_group),
        "groups": list(body.groups),
    }


def _encode_modes(modes: ModeShapes) -> dict[str, object]:
    return {
        "layers": [_encode_layer(layer) for layer in modes.layers],
        "rows": [{"label": row.label, "members": list(row.members)} for row in modes.rows],
    }


def _encode_layer(layer: Layer) -> dict[str, object]:
    shapes = []
    for shape in layer.shapes:
        imaginary = np.imag(shape)
        shapes.append(
            {
                "re": _encode_scaled(np.real(shape)),
                "im": _encode_scaled(imaginary) if imaginary.any() else None,
            }
        )
    look = {"name": layer.name, "role": layer.role, "style": layer.style, "body": layer.body}
    return {**look, "shapes": shapes}


def _encode_operating(operating: OperatingShapes) -> dict[str, object]:
    first = operating.references[0].layers[0].values
    return {
        "freq": _encode_floats(operating.freq),
        "quantity": operating.quantity,
        "unit": operating.unit,
        "body": operating.body,
        "channels": first.shape[1],
        "entries": _encode_entries(operating.entries),
        "references": [_encode_reference(reference) for reference in operating.references],
    }


def _encode_entries(entries: Entries) -> dict[str, object]:
    return {
        "dof": _encode_integers(entries.dof),
        "node": _encode_integers(entries.node),
        "vector": _encode_floats(entries.vector),
    }


def _encode_reference(reference: Reference) -> dict[str, object]:
    """Return the layers of a reference, each line scaled by its largest value in any layer."""
    # Shapes are drawn at the same size at every line. The level is in the curve: the root mean
    # square over the channels.
    values = [layer.values for layer in reference.layers]
    largest = np.max([np.abs(v).max(axis=1, initial=0.0) for v in values], axis=0)
    level = np.where(largest > 0.0, largest, 1.0)[:, None]
    layers = []
    for layer in reference.layers:
        curve = np.sqrt(np.mean(np.abs(layer.values) ** 2, axis=1))
        parts = {
            "re": _encode_scaled((layer.values / level).real),
            "im": _encode_scaled((layer.values / level).imag),
        }
        look = {"name": layer.name, "role": layer.role, "style": layer.style}
        layers.append({**look, "curve": _encode_floats(curve), **parts})
    return {"name": reference.name, "layers": layers}
