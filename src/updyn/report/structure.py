"""The structure as a picture: its geometry coloured by what changed, with sensors and forces. Static SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.model import Model
from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.callouts import Callout, callouts
from updyn.report.line_groups import groups_of_lines, nodes_of_groups
from updyn.report.plots import Figure
from updyn.report.section import Content, Section
from updyn.updating.result import UpdateResult

__all__ = ["STEPS", "STRUCTURE", "group_changes", "structure_of"]

#: Steps of the colour scale to each side of no change.
STEPS = 4
_WIDTH, _HEIGHT, _MARGIN, _SIDE = 1130.0, 660.0, 14.0, 150.0
_MOST_LINES, _DENSE = 8_000, 3_000
_LUMPED = 4  # nodes that a group without lines may have to be marked
_LEAST = 0.02  # the colour scale reaches at least this far
_SAME = 0.005  # a change up to this is none
_ARROW = 0.055  # of the height
_VIEWS = {"front": (38.0, 24.0), "back": (218.0, 24.0)}


class Structure(Section):
    """The structure as a picture, for one test or for all."""

    anchor = "structure"
    name = "Structure"
    heading = "Structure"
    place = 300

    def applies(self, content: Content) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return picture and legend; empty where no model has a geometry to draw."""
        return structure_of(list(content.tests.values()))


STRUCTURE = Structure()


def structure_of(results: Sequence[UpdateResult]) -> str:
    """Return the body of the section for tests of one structure, the sensors and forces of all of them drawn.

    Parameters
    ----------
    results : sequence of UpdateResult
        Of one structure; that with the most degrees of freedom gives the model.

    Returns
    -------
    str
        HTML; empty where no model has a geometry to draw.
    """
    drawn = [r for r in results if r.start.geometry is not None and len(r.start.geometry.nodes)]
    if not drawn:
        return ""
    result = max(drawn, key=lambda r: r.start.n_dofs)
    scene = _scene(result)
    responses = list(dict.fromkeys(label for r in results for label in r.frf.responses.labels))
    references = list(dict.fromkeys(label for r in results for label in r.frf.references.labels))
    marked = _marked(result.start, responses, references)
    if not len(scene.lines) and not marked.callouts:
        return ""
    caption = (
        "Arrows: sensors; arrows with a full head: forces; a double head is a rotation or a torque"
        " about the arrow. Squares: parts without lines, such as lumped masses."
    )
    parts = [
        m.paragraph(
            "Where the sensors and forces are, and how much each part changed: its stiffness, or"
            " where that is no unknown its mass, then its viscous damping."
        ),
        _scale(scene),
    ]
    for number, (view, angles) in enumerate(_VIEWS.items()):
        alternative = (
            f"The structure seen from the {view}, coloured by the change of its parts, with sensors"
            " and forces"
        )
        picture = _svg(scene, marked, angles, alternative, labelled=number == 0)
        if number == 0:
            parts.append(
                "<figure"
                f' class="structure">{picture}<figcaption>{m.esc(caption)}</figcaption></figure>'
            )
        else:
            parts.append(m.details("From behind", f'<figure class="structure">{picture}</figure>'))
    parts.append(_legend(scene))
    notes = [*scene.notes, *marked.notes]
    return "".join(parts) + "".join(m.paragraph(note, "muted") for note in notes)


# -- what is drawn -----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    xyz: NDArray[np.float64]  # (n, 3)
    lines: NDArray[np.intp]  # (m, 2), positions among the nodes
    group: NDArray[np.intp]  # (m,), -1: not known
    lumps: Mapping[int, NDArray[np.intp]]
    names: Sequence[str]
    changes: Mapping[str, tuple[str, float]]
    reach: float
    notes: tuple[str, ...]

    def colour(self, group: int) -> str:
        """Return the class of a group: s-4 to s4, or none for what was no unknown."""
        change = self.changes.get(self.names[group]) if group >= 0 else None
        return "s-none" if change is None else f"s{_step(math.log(change[1]), self.reach)}"


@dataclass(frozen=True, slots=True, eq=False)
class _Marked:
    callouts: tuple[Callout, ...]
    notes: tuple[str, ...]


def group_changes(result: UpdateResult) -> dict[str, tuple[str, float]]:
    """Return what the update did to each group that an unknown acts on: quantity and factor.

    Parameters
    ----------
    result : UpdateResult
        The result.

    Returns
    -------
    dict of str to (str, float)
        By group, the factor on its stiffness; where that is no unknown, on its mass, then its
        viscous damping. Loss factors have no factor and are left out.
    """
    parameters = result.parameters
    changes = parameters.changes([result.values[name] for name in parameters.names])
    out = {}
    for group, change in changes.items():
        for quantity in ("stiffness", "mass", "viscous"):
            if change.get(quantity, 0.0) > 0.0 and group in result.start.groups:
                out[group] = (quantity, change[quantity])
                break
    return out


def _step(log: float, reach: float) -> int:
    step = int(np.clip(round(log / reach * STEPS), -STEPS, STEPS))
    return (
        int(np.sign(log)) if step == 0 and abs(log) > _SAME else step
    )  # what changed is never shown as unchanged


def _scene(result: UpdateResult) -> _Scene:
    model, geometry, notes = result.start, result.start.geometry, []
    assert geometry is not None
    order = np.argsort(geometry.nodes)
    lines = order[np.searchsorted(geometry.nodes[order], geometry.lines)].reshape(-1, 2)
    group = groups_of_lines(model)
    if len(lines) > _MOST_LINES:
        kept = np.linspace(0, len(lines) - 1, _MOST_LINES).round().astype(np.intp)
        notes.append(f"{_MOST_LINES} of the {len(lines)} lines of the geometry are drawn.")
        lines, group = lines[kept], group[kept]
    changes = group_changes(result)
    names = list(model.groups)
    bare = [i for i, name in enumerate(names) if name in changes and not (group == i).any()]
    logs = [abs(math.log(factor)) for _, factor in changes.values()]
    return _Scene(
        geometry.xyz,
        lines,
        group,
        nodes_of_groups(model, np.array(bare, dtype=np.intp), _LUMPED),
        names,
        changes,
        max([_LEAST, *logs]),
        tuple(notes),
    )


def _marked(model: Model, responses: Sequence[str], references: Sequence[str]) -> _Marked:
    """Return one callout a node that is measured or driven; those without a position are named in a note."""
    assert model.geometry is not None
    geometry = model.geometry
    place = {int(node): i for i, node in enumerate(geometry.nodes)}
    nodes: dict[int, tuple[list[str], list[str]]] = {}
    lost = []
    for kind, labels in enumerate((responses, references)):
        for dof in DofSet(labels):
            if dof.node in place:
                nodes.setdefault(dof.node, ([], []))[kind].append(
                    f"{'-' if dof.sign < 0 else ''}{dof.direction}"
                )
            else:
                lost.append(str(dof))
    out = [
        Callout(
            node,
            geometry.xyz[place[node]],
            np.eye(3) if geometry.axes is None else geometry.axes[place[node]],
            tuple(sensors),
            tuple(forces),
        )
        for node, (sensors, forces) in nodes.items()
    ]
    missing = list(dict.fromkeys(lost))
    said = (
        f"Without a position in the geometry, and not drawn: {', '.join(missing)}."
        if missing
        else ""
    )
    return _Marked(tuple(out), (said,) if said else ())


# -- drawing -----------------------------------------------------------------------------------------------
def _svg(
    scene: _Scene, marked: _Marked, angles: tuple[float, float], alternative: str, *, labelled: bool
) -> str:
    camera = _camera(*angles)
    seen = scene.xyz @ camera.T  # right, up, towards the eye
    used = np.unique(scene.lines) if len(scene.lines) else np.arange(len(seen))
    used = np.union1d(
        used, np.concatenate([np.empty(0, dtype=np.intp), *scene.lumps.values()]).astype(np.intp)
    )
    low, high = seen[used, :2].min(axis=0), seen[used, :2].max(axis=0)
    room = np.array(
        [_WIDTH - 2 * (_SIDE + _ARROW * _HEIGHT), _HEIGHT - 2 * (_MARGIN + _ARROW * _HEIGHT)]
    )
    scale = float(np.min(room / np.maximum(high - low, 1e-9 * max(float(np.ptp(seen)), 1e-300))))
    centre = np.array([_WIDTH, _HEIGHT]) / 2

    def flat(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points in the picture's axes, shape (n, 3), are drawn, shape (n, 2)."""
        return np.asarray(centre + (points[:, :2] - (low + high) / 2) * scale * [1.0, -1.0])

    xy = flat(seen)
    body = [_paths(scene, xy, seen[:, 2]), _lumps(scene, xy)]
    arrows = _HEIGHT * _ARROW
    at = flat(np.array([c.xyz for c in marked.callouts]).reshape(-1, 3) @ camera.T)
    directions = [c.axes @ camera.T * [1.0, -1.0, 1.0] for c in marked.callouts]
    body.append(
        callouts(
            marked.callouts, at, directions, arrows, (_WIDTH, _HEIGHT), _SIDE if labelled else None
        )
    )
    body.append(_axes(camera))
    dense = ' class="dense"' if len(scene.lines) > _DENSE else ""
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}"{dense} role="img"'
        f' aria-label="{m.esc(alternative)}">'
        f"{''.join(body)}</svg>"
    )


def _camera(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Return right, up and towards the eye as rows, for an eye at azimuth (X towards Y) and elevation, in degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    eye = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.array([right, np.cross(eye, right), eye])


def _paths(scene: _Scene, xy: NDArray[np.float64], depth: NDArray[np.float64]) -> str:
    """Return the lines, far ones first and fainter, one path for each group in each third of the depth."""
    if not len(scene.lines):
        return ""
    far = depth[scene.lines].mean(axis=1)
    edges = np.quantile(far, [1 / 3, 2 / 3])
    layer = np.searchsorted(edges, far)
    out = []
    for number in range(3):
        out.append(f'<g class="layer{number}">')
        for group in np.unique(scene.group[layer == number]).tolist():
            chosen = scene.lines[(layer == number) & (scene.group == group)]
            ends = xy[chosen].reshape(-1, 4)
            d = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {e:.1f}" for a, b, c, e in ends.tolist())
            out.append(
                f'<path class="{scene.colour(group)}"'
                f' d="{d}"><title>{m.esc(_said(scene, group))}</title></path>'
            )
        out.append("</g>")
    return "".join(out)


def _lumps(scene: _Scene, xy: NDArray[np.float64]) -> str:
    out = []
    taken: dict[int, int] = {}
    for group, nodes in scene.lumps.items():
        for node in nodes.tolist():
            shift = taken[node] = taken.get(node, -1) + 1  # several at one node stand side by side
            x, y = xy[node] + [12.0 * shift - 5.0, -5.0]
            title = f"<title>{m.esc(_said(scene, group))}</title>"
            out.append(
                f'<rect class="{scene.colour(group)}" x="{x:.1f}" y="{y:.1f}" width="10"'
                f' height="10">{title}</rect>'
            )
    return "".join(out)


def _axes(camera: NDArray[np.float64]) -> str:
    """Return the directions of X, Y and Z, at the lower left."""
    origin, length = np.array([46.0, _HEIGHT - 46.0]), 30.0
    out = []
    for name, direction in zip("XYZ", camera.T, strict=True):
        x, y = origin + length * direction[:2] * [1.0, -1.0]
        tx, ty = origin + (length + 10.0) * direction[:2] * [1.0, -1.0]
        out.append(
            f'<path class="axis" d="M{origin[0]:g} {origin[1]:g}L{x:.1f} {y:.1f}"/>'
            f'<text class="axis" x="{tx:.1f}" y="{ty + 4.0:.1f}" text-anchor="middle">{name}</text>'
        )
    return "".join(out)


# -- words -------------------------------------------------------------------------------------------------
def _said(scene: _Scene, group: int) -> str:
    if group < 0:
        return "held, or carried rigidly by others"
    name = scene.names[group]
    if name not in scene.changes:
        return f"{name}: no unknown"
    quantity, factor = scene.changes[name]
    return f"{name}: {w.quantity_words(quantity)} {_percent(factor)}"


def _percent(factor: float, digits: int = 3) -> str:
    return f"{100.0 * (factor - 1.0):+.{digits}g} %".replace("-", "\u2212")


def _scale(scene: _Scene) -> str:
    """Return the colour scale."""
    cells = []
    for step in range(-STEPS, STEPS + 1):
        factor = math.exp(scene.reach * step / STEPS)
        said = _percent(factor, 2) if step else "unchanged"
        cells.append(f'<span><i class="s{step}"></i>{m.esc(said)}</span>')
    cells.append('<span><i class="s-none"></i>no unknown</span>')
    return (
        f'<p class="scale" aria-label="Colour scale">{"".join(cells)}</p>' if scene.changes else ""
    )


def _legend(scene: _Scene) -> str:
    """Return the parts that changed, the largest change first."""
    ordered = sorted(scene.changes, key=lambda name: -abs(math.log(scene.changes[name][1])))
    if not ordered:
        return m.paragraph("No unknown scales a part, so that none is coloured.", "muted")
    numbers = [scene.names.index(name) for name in ordered]
    items = "".join(
        f'<li><i class="{scene.colour(i)}"></i>{m.esc(_said(scene, i))}</li>' for i in numbers
    )
    return f'<ul class="parts">{items}</ul>'
