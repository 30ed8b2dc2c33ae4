"""SVG picture of a structure from its geometry, coloured by part, with sensors and forces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import DIRECTIONS, DofSet
from updyn.model import Model
from updyn.report.settings import REPORT_SIZE
from updyn.report.templates import render_template
from updyn.settings import FIGURES
from updyn.viewer.groups import groups_of_lines, nodes_of_groups

__all__ = [
    "VIEWS",
    "Callout",
    "PictureScene",
    "camera",
    "picture",
    "spread_heights",
]

#: Width and height of the picture, margin above and below, width of each label column, in pixels.
_WIDTH = 1130
_HEIGHT = 660
_MARGIN = 14.0
_SIDE = 150.0
_DENSE = 3_000
#: Length of an arrow in pixels; an arrow foreshortened below the fraction `_FLAT` becomes a dot.
_ARROW = 0.055 * _HEIGHT
_FLAT = 0.15
#: Distance of the heads of a double arrow, length of a head, and label spacing, in pixels.
_HEAD_GAP = 7.0
_HEAD = 9.0
_LABEL_GAP = 16.0
#: Azimuth and elevation of the viewpoint, in degrees.
VIEWS = {"front": (38.0, 24.0), "back": (218.0, 24.0)}


def picture(
    model: Model,
    responses: Sequence[str],
    references: Sequence[str],
    parts: Mapping[str, tuple[str, str]],
    *,
    about: str,
    scale: Sequence[tuple[str, str]] = (),
    legend: Sequence[tuple[str, str]] = (),
    note: str = "",
) -> str:
    """Return the picture of a structure from two sides as HTML; empty without a geometry.

    `parts` has a colour (a class of ``structure.css``) and a title by group; `scale` and `legend`
    have classes and texts. `note` replaces an empty legend.
    """
    if model.geometry is None or not len(model.geometry.nodes):
        return ""
    scene = PictureScene.of(model, parts)
    callouts, missing = _collect_callouts(model, responses, references)
    if not len(scene.lines) and not callouts:
        return ""
    notes = list(scene.notes)
    if missing:
        names = ", ".join(missing)
        notes.append(f"Without a position in the geometry, and not drawn: {names}.")
    front, back = VIEWS
    return render_template(
        "updyn.report/structure.html",
        width=_WIDTH,
        height=_HEIGHT,
        dense=len(scene.lines) > _DENSE,
        views=[
            _draw_view(scene, callouts, front, labelled=True),
            _draw_view(scene, callouts, back, labelled=False),
        ],
        about=about,
        scale=scale,
        legend=legend,
        note=note,
        notes=notes,
    )


# -- scene ---------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class PictureScene:
    """The lines of a geometry with their groups, colours and titles.

    `xyz`, shape (n, 3), is in m; `lines`, shape (m, 2), and `lumps` (nodes of groups without lines)
    hold node positions; `group`, shape (m,), is -1 if unknown. `parts` has colour and title by
    group; groups missing there have no unknown.
    """

    xyz: RealArray
    lines: IndexArray
    group: IndexArray
    lumps: Mapping[int, IndexArray]
    names: Sequence[str]
    parts: Mapping[str, tuple[str, str]]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, parts: Mapping[str, tuple[str, str]]) -> PictureScene:
        """Return the scene of a model with a geometry."""
        assert model.geometry is not None
        notes: tuple[str, ...] = ()
        lines = model.geometry.line_ends
        group = groups_of_lines(model)
        most = REPORT_SIZE.structure_lines
        if len(lines) > most:
            kept = np.linspace(0, len(lines) - 1, most).round().astype(np.intp)
            notes = (f"{most} of the {len(lines)} lines of the geometry are drawn.",)
            lines, group = lines[kept], group[kept]
        names, drawn = list(model.groups), set(group.tolist())
        bare = [i for i, name in enumerate(names) if name in parts and i not in drawn]
        lumps = nodes_of_groups(model, np.array(bare, dtype=np.intp), FIGURES.lumped_nodes)
        return cls(model.geometry.xyz, lines, group, lumps, names, parts, notes)

    def colour(self, group: int) -> str:
        """Return the CSS class of a group."""
        if group < 0 or self.names[group] not in self.parts:
            return "s-none"
        return self.parts[self.names[group]][0]

    def title(self, group: int) -> str:
        """Return the title of a group."""
        if group < 0:
            return "fixed, or moved rigidly by other parts"
        name = self.names[group]
        return self.parts[name][1] if name in self.parts else f"{name}: no unknown"


# -- sensors and forces --------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class Callout:
    """The sensors and forces at one node, as directions, with ``-`` for a negative sensor.

    `xyz` is in m; `axes`, shape (3, 3), has the axes X, Y and Z of the node as rows, in global
    components.
    """

    node: int
    xyz: RealArray
    axes: RealArray
    sensors: tuple[str, ...]
    forces: tuple[str, ...]

    @property
    def text(self) -> str:
        """The label: node, sensors, forces."""
        parts = []
        if self.sensors:
            parts.append(", ".join(self.sensors))
        if self.forces:
            parts.append(f"force {', '.join(self.forces)}")
        return f"{self.node}: {' · '.join(parts)}"


def _collect_callouts(
    model: Model, responses: Sequence[str], references: Sequence[str]
) -> tuple[list[Callout], list[str]]:
    """Return a callout for each node with a sensor or a force, and DOFs without a position."""
    geometry = model.geometry
    assert geometry is not None
    place = {int(node): i for i, node in enumerate(geometry.nodes)}
    sensors: dict[int, list[str]] = {}
    forces: dict[int, list[str]] = {}
    missing: dict[str, None] = {}
    for found, labels in ((sensors, responses), (forces, references)):
        for dof in DofSet(labels):
            if dof.node in place:
                sign = "-" if dof.sign < 0 else ""
                found.setdefault(dof.node, []).append(f"{sign}{dof.direction}")
            else:
                missing[str(dof)] = None
    out = []
    for node in {**sensors, **forces}:
        at = place[node]
        axes = np.eye(3) if geometry.axes is None else geometry.axes[at]
        xyz = geometry.xyz[at]
        directions = tuple(sensors.get(node, ())), tuple(forces.get(node, ()))
        out.append(Callout(node, xyz, axes, *directions))
    return out, list(missing)


def _draw_arrow(
    place: RealArray, direction: str, axes: RealArray, length: float, kind: str
) -> dict[str, object]:
    """Return an arrow as SVG paths; without a shaft if it points along the line of sight.

    `axes`, shape (3, 3), has the axes of the node as rows in picture axes (right, down, depth). A
    ``"force"`` ends at `place` and has filled heads; the other `kind` is ``"sensor"``.
    """
    number = DIRECTIONS.index(direction.lstrip("-"))
    vector = axes[number % 3][:2]
    if direction.startswith("-"):
        vector = -vector
    projectedble = float(np.hypot(*vector))
    if projectedble < _FLAT:
        return {"kind": kind, "shaft": "", "heads": []}
    along = vector / projectedble
    across = np.array([-along[1], along[0]])
    tail, tip = place, place + length * vector
    wide, closed = 3.0, ""
    if kind == "force":
        tail, tip = place - (tip - place), place
        wide, closed = 4.0, "Z"
    is_rotation = number >= 3
    heads = []
    for back in (0.0, _HEAD_GAP) if is_rotation else (0.0,):
        point = tip - back * along
        left = point - _HEAD * along + wide * across
        right = point - _HEAD * along - wide * across
        heads.append(_svg_path(left, point, right) + closed)
    return {"kind": kind, "shaft": _svg_path(tail, tip), "heads": heads}


def _svg_path(*points: RealArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _place_labels(items: Sequence[Callout], at: RealArray) -> list[dict[str, object]]:
    """Return labels in two columns, each in the nearer one; empty if they do not fit."""
    by_x = np.argsort(at[:, 0], kind="stable")
    half = (len(items) + 1) // 2
    if half * _LABEL_GAP > _HEIGHT - 2 * _LABEL_GAP:
        return []
    # Keep the lower left free for the axes.
    left = _place_column(items, at, by_x[:half], "end", _SIDE, _HEIGHT - 5 * _LABEL_GAP)
    right = _place_column(items, at, by_x[half:], "start", _WIDTH - _SIDE, _HEIGHT - _LABEL_GAP)
    return left + right


def _place_column(
    items: Sequence[Callout],
    at: RealArray,
    chosen: IndexArray,
    anchor: str,
    x: float,
    lowest: float,
) -> list[dict[str, object]]:
    """Return the labels of one column, from top to bottom."""
    ordered = chosen[np.argsort(at[chosen, 1], kind="stable")]
    heights = spread_heights(at[ordered, 1], _LABEL_GAP, _LABEL_GAP, lowest)
    gap = -4.0 if anchor == "end" else 4.0
    out = []
    for i, y in zip(ordered.tolist(), heights.tolist(), strict=True):
        out.append(
            {
                "kind": "label force" if items[i].forces else "label",
                "leader": _svg_path(np.array([x, y]), at[i]),
                "x": x + gap,
                "y": y + 4.0,
                "anchor": anchor,
                "text": items[i].text,
            }
        )
    return out


def spread_heights(wanted: RealArray, gap: float, low: float, high: float) -> RealArray:
    """Return ascending heights near `wanted` (ascending), at least `gap` apart, within limits."""
    # Heights are moved up to keep the gap, then down from the upper limit.
    out = np.clip(np.asarray(wanted, dtype=np.float64), low, high)
    for i in range(1, len(out)):
        out[i] = max(out[i], out[i - 1] + gap)
    for i in range(len(out) - 1, -1, -1):
        out[i] = min(out[i], high if i == len(out) - 1 else out[i + 1] - gap)
    return out


# -- picture -------------------------------------------------------------------------------------
def _draw_view(
    scene: PictureScene, callouts: Sequence[Callout], name: str, *, labelled: bool
) -> dict[str, object]:
    view = camera(*VIEWS[name])
    projected = scene.xyz @ view.T  # columns: right, up, towards the viewer
    to_picture = _Projection(scene, projected)
    xy = to_picture(projected)
    at = to_picture(np.array([c.xyz for c in callouts]).reshape(-1, 3) @ view.T)
    return {
        "name": name,
        "layers": _draw_layers(scene, xy, projected[:, 2]),
        "squares": _draw_squares(scene, xy),
        "callouts": [_draw_callout(c, place, view) for c, place in zip(callouts, at, strict=True)],
        "labels": _place_labels(callouts, at) if labelled and callouts else [],
        "axes": _draw_axes(view),
    }


class _Projection:
    """The map from view axes, shape (n, 3), to picture coordinates, shape (n, 2)."""

    def __init__(self, scene: PictureScene, projected: RealArray) -> None:
        used = np.arange(len(projected))
        if len(scene.lines):
            lumps = [np.empty(0, dtype=np.intp), *scene.lumps.values()]
            used = np.union1d(scene.lines, np.concatenate(lumps).astype(np.intp))
        low, high = projected[used, :2].min(axis=0), projected[used, :2].max(axis=0)
        free = np.array([_WIDTH - 2 * (_SIDE + _ARROW), _HEIGHT - 2 * (_MARGIN + _ARROW)])
        least = 1e-9 * max(float(np.ptp(projected)), 1e-300)
        self.scale = float(np.min(free / np.maximum(high - low, least)))
        self.middle = (low + high) / 2

    def __call__(self, points: RealArray) -> RealArray:
        flat = (points[:, :2] - self.middle) * self.scale * [1.0, -1.0]
        return np.asarray(np.array([_WIDTH, _HEIGHT]) / 2 + flat)


def camera(azimuth: float, elevation: float) -> RealArray:
    """Return the right, up and towards-viewer axes as rows, for angles in degrees, shape (3, 3)."""
    a, e = math.radians(azimuth), math.radians(elevation)
    eye = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.array([right, np.cross(eye, right), eye])


def _draw_layers(
    scene: PictureScene, xy: RealArray, depth: RealArray
) -> list[list[dict[str, str]]]:
    """Return one path per group in each third of the depth, from back to front."""
    if not len(scene.lines):
        return []
    far = depth[scene.lines].mean(axis=1)
    third = np.searchsorted(np.quantile(far, [1 / 3, 2 / 3]), far)
    layers = []
    for number in range(3):
        paths = []
        for group in np.unique(scene.group[third == number]).tolist():
            chosen = scene.lines[(third == number) & (scene.group == group)]
            d = "".join(_svg_path(*ends) for ends in xy[chosen])
            paths.append({"colour": scene.colour(group), "d": d, "title": scene.title(group)})
        layers.append(paths)
    return layers


def _draw_squares(scene: PictureScene, xy: RealArray) -> list[dict[str, object]]:
    """Return squares at the nodes of groups without lines; several at a node are in a row."""
    out = []
    taken: dict[int, int] = {}
    for group, nodes in scene.lumps.items():
        for node in nodes.tolist():
            shift = taken.get(node, 0)
            taken[node] = shift + 1
            x, y = xy[node] + [12.0 * shift - 5.0, -5.0]
            out.append({"colour": scene.colour(group), "x": x, "y": y, "title": scene.title(group)})
    return out


def _draw_callout(callout: Callout, place: RealArray, camera: RealArray) -> dict[str, object]:
    axes = callout.axes @ camera.T * [1.0, -1.0, 1.0]
    arrows = [_draw_arrow(place, d, axes, _ARROW, "sensor") for d in callout.sensors]
    arrows += [_draw_arrow(place, d, axes, 1.25 * _ARROW, "force") for d in callout.forces]
    return {"text": callout.text, "x": place[0], "y": place[1], "arrows": arrows}


def _draw_axes(camera: RealArray) -> list[dict[str, object]]:
    """Return the directions of X, Y and Z, drawn at the lower left."""
    origin, length = np.array([46.0, _HEIGHT - 46.0]), 30.0
    out = []
    for name, direction in zip("XYZ", camera.T, strict=True):
        flat = direction[:2] * [1.0, -1.0]
        x, y = origin + (length + 10.0) * flat
        out.append(
            {"name": name, "d": _svg_path(origin, origin + length * flat), "x": x, "y": y + 4.0}
        )
    return out
