"""The structure as a picture: its geometry coloured by what changed, with sensors and forces. Static SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, DofSet
from updyn.model import Model
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure
from updyn.report.section import Content, Section
from updyn.updating.result import UpdateResult

__all__ = [
    "STEPS",
    "STRUCTURE",
    "Callout",
    "callouts",
    "group_changes",
    "groups_of_lines",
    "nodes_of_groups",
    "spread",
    "structure_of",
]

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


_LINE = 16.0  # between labels
_FLAT = 0.15  # an arrow shorter than this points at the eye: it is drawn as a dot


@dataclass(frozen=True, slots=True, eq=False)
class Callout:
    """What is measured and driven at one node.

    Parameters
    ----------
    node : int
        Its number.
    xyz : ndarray of float, shape (3,)
        Its position, in m.
    axes : ndarray of float, shape (3, 3)
        Its X, Y and Z as rows, in global components.
    sensors, forces : tuple of str
        Directions, with ``-`` where a sensor points the other way.
    """

    node: int
    xyz: NDArray[np.float64]
    axes: NDArray[np.float64]
    sensors: tuple[str, ...]
    forces: tuple[str, ...]

    @property
    def text(self) -> str:
        """The label: node, sensors, forces."""
        said = ", ".join(self.sensors)
        driven = f"force {', '.join(self.forces)}" if self.forces else ""
        return f"{self.node}: " + " · ".join(part for part in (said, driven) if part)


def callouts(
    items: Sequence[Callout],
    at: NDArray[np.float64],
    axes: Sequence[NDArray[np.float64]],
    length: float,
    size: tuple[float, float],
    side: float | None,
) -> str:
    """Return arrows and labels as SVG.

    Parameters
    ----------
    items : sequence of Callout
        What to draw.
    at : ndarray of float, shape (n, 2)
        Where in the picture.
    axes : sequence of ndarray of float, shape (3, 3)
        For each, X, Y and Z as rows in the axes of the picture (right, down, depth).
    length : float
        Of an arrow that lies in the plane of the picture.
    size : (float, float)
        Width and height of the picture.
    side : float or None
        Width of the columns of labels, left and right; None: no labels.

    Returns
    -------
    str
        SVG elements. Where there are more labels than fit, none is drawn: the arrows have titles.
    """
    out = []
    for item, place, directions in zip(items, at, axes, strict=True):
        arrows = [_arrow(place, d, directions, length, "sensor") for d in item.sensors]
        arrows += [_arrow(place, d, directions, 1.25 * length, "force") for d in item.forces]
        dot = f'<circle class="sensor" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="2.4"/>'
        out.append(f"<g><title>{m.esc(item.text)}</title>{dot}{''.join(arrows)}</g>")
    if side is not None and items:
        out.append(_labels(items, at, size, side))
    return "".join(out)


def _arrow(
    place: NDArray[np.float64], direction: str, axes: NDArray[np.float64], length: float, kind: str
) -> str:
    number = DIRECTIONS.index(direction.lstrip("-"))
    vector = axes[number % 3][:2] * (-1.0 if direction.startswith("-") else 1.0)
    seen = float(np.hypot(*vector))
    if seen < _FLAT:
        return f'<circle class="{kind} head" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="4"/>'
    along = vector / seen
    across = np.array([-along[1], along[0]])
    tip = place + length * vector
    # A force ends where it acts.
    tail, tip = (place, tip) if kind == "sensor" else (place - (tip - place), place)
    wide = 4.0 if kind == "force" else 3.0
    heads = []
    for back in (0.0, 7.0)[: 2 if number >= 3 else 1]:
        point = tip - back * along
        left, right = point - 9.0 * along + wide * across, point - 9.0 * along - wide * across
        line = (
            f"M{left[0]:.1f} {left[1]:.1f}L{point[0]:.1f} {point[1]:.1f}L{right[0]:.1f}"
            f" {right[1]:.1f}"
        )
        heads.append(f'<path class="{kind} head" d="{line}{"Z" if kind == "force" else ""}"/>')
    shaft = f'<path class="{kind}" d="M{tail[0]:.1f} {tail[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"/>'
    return shaft + "".join(heads)


def _labels(
    items: Sequence[Callout], at: NDArray[np.float64], size: tuple[float, float], side: float
) -> str:
    """Return labels in two columns, each beside the half of the picture that it belongs to."""
    by_x = np.argsort(at[:, 0], kind="stable")
    half = (len(items) + 1) // 2
    if half * _LINE > size[1] - 2 * _LINE:
        return ""
    out = []
    for column, chosen in (("end", by_x[:half]), ("start", by_x[half:])):
        ordered = chosen[np.argsort(at[chosen, 1], kind="stable")]
        heights = spread(
            at[ordered, 1], _LINE, _LINE, size[1] - (5 * _LINE if column == "end" else _LINE)
        )
        x = side if column == "end" else size[0] - side
        away = -4.0 if column == "end" else 4.0
        for i, y in zip(ordered.tolist(), heights.tolist(), strict=True):
            kind = "label force" if items[i].forces else "label"
            out.append(
                f'<path class="leader" d="M{x:.1f} {y:.1f}L{at[i, 0]:.1f} {at[i, 1]:.1f}"/>'
                f'<text class="{kind}" x="{x + away:.1f}" y="{y + 4.0:.1f}" text-anchor="{column}">'
                f"{m.esc(items[i].text)}</text>"
            )
    return "".join(out)


def spread(wanted: NDArray[np.float64], gap: float, low: float, high: float) -> NDArray[np.float64]:
    """Return heights at least `gap` apart, between `low` and `high`, near those wanted.

    Parameters
    ----------
    wanted : ndarray of float, shape (n,)
        Ascending.
    gap, low, high : float
        Smallest distance, and the limits; ``(n - 1) gap`` fits between them.

    Returns
    -------
    ndarray of float, shape (n,)
        Ascending: pushed down where crowded, then up from the lower limit.
    """
    out = np.clip(np.asarray(wanted, dtype=np.float64), low, high)
    for i in range(1, len(out)):
        out[i] = max(out[i], out[i - 1] + gap)
    for i in range(len(out) - 1, -1, -1):
        out[i] = min(out[i], high if i == len(out) - 1 else out[i + 1] - gap)
    return out


def groups_of_lines(model: Model) -> NDArray[np.intp]:
    """Return the group of each line of the model's geometry.

    A line has no group of its own in the model. Its group is the one whose stiffness matrix has the
    largest entries (their norm) between the degrees of freedom of its two nodes. Where one of the
    nodes has none, because it is held or follows others, it is the group with the largest entries
    at the other; where both have none, there is no telling.

    Parameters
    ----------
    model : Model
        With a geometry of m lines.

    Returns
    -------
    ndarray of int, shape (m,)
        Positions among the model's groups; -1: not known.
    """
    assert model.geometry is not None
    lines = model.geometry.lines
    at = _places(model)
    n = len(model.geometry.nodes)
    order = np.argsort(model.geometry.nodes)
    ends = np.sort(order[np.searchsorted(model.geometry.nodes[order], lines)], axis=1).reshape(
        -1, 2
    )
    wanted, place = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    has = np.zeros(n, dtype=np.bool_)
    has[at[at >= 0]] = True
    best, alone = np.zeros(len(wanted)), np.zeros(n)
    chosen, chosen_alone = np.full(len(wanted), -1, dtype=np.intp), np.full(n, -1, dtype=np.intp)
    for number, group in enumerate(model.groups.values()):
        if group.stiffness is None or not len(wanted):
            continue
        K = group.stiffness.tocoo()
        a, b = at[K.row], at[K.col]
        on = (a >= 0) & (b >= a)
        a, b, weight = a[on], b[on], K.data[on] ** 2
        same = a == b
        sums = np.bincount(a[same], weight[same], minlength=n)
        chosen_alone[sums > alone] = number
        alone = np.maximum(alone, sums)
        key = a[~same] * n + b[~same]
        found = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
        hit = wanted[found] == key
        sums = np.bincount(found[hit], weight[~same][hit], minlength=len(wanted))
        chosen[sums > best] = number
        best = np.maximum(best, sums)
    out = chosen[place]
    one = (out < 0) & (has[ends].sum(axis=1) == 1)
    out[one] = chosen_alone[np.where(has[ends[one, 0]], ends[one, 0], ends[one, 1])]
    return out


def nodes_of_groups(
    model: Model, groups: NDArray[np.intp], most: int
) -> dict[int, NDArray[np.intp]]:
    """Return the nodes of groups that are not drawn as lines: lumped masses, springs to the ground.

    Parameters
    ----------
    model : Model
        With a geometry.
    groups : ndarray of int
        Positions among the model's groups.
    most : int
        Groups with more nodes than this are left out.

    Returns
    -------
    dict of int to ndarray of int
        By group, positions among the nodes of the geometry.
    """
    at = _places(model)
    out = {}
    every = list(model.groups.values())
    for number in groups.tolist():
        used = [
            A.indices[A.data != 0.0]
            for A in (every[number].stiffness, every[number].mass)
            if A is not None
        ]
        if not used:
            used = [every[number].viscous.indices] if every[number].viscous is not None else []
        nodes = np.unique(at[np.concatenate([np.empty(0, dtype=np.intp), *used])])
        nodes = nodes[nodes >= 0]
        if 0 < len(nodes) <= most:
            out[number] = nodes
    return out


def _places(model: Model) -> NDArray[np.intp]:
    """Return, for each DOF, the position of its node in the geometry; -1 where it has none."""
    assert model.geometry is not None
    nodes = model.geometry.nodes
    if not len(nodes):
        return np.full(model.n_dofs, -1, dtype=np.intp)
    order = np.argsort(nodes)
    found = order[np.minimum(np.searchsorted(nodes[order], model.dofs.nodes), len(nodes) - 1)]
    return np.asarray(np.where(nodes[found] == model.dofs.nodes, found, -1), dtype=np.intp)
