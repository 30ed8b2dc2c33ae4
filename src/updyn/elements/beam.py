"""`beam`: a planar Timoshenko beam in bending, with supports and point masses, as groups.

X along the beam, Z its deflection; a positive RY (right-hand rule) rotates X towards -Z: without
shear, RY = -dw/dx. Elements are exact for static loads at the nodes: Przemieniecki, Theory of
Matrix Structural Analysis, 1968, section 5.6; consistent mass with rotary inertia of Friedman &
Kosmatka, Computers & Structures 47 (1993) 473-481. Natural frequencies converge from above, with an
error proportional to the square of the element length.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.arrays import IndexArray, IntArray, RealArray
from updyn.dofs import DIRECTIONS, DofSet
from updyn.elements.checks import (
    check_keys,
    check_not_negative,
    check_number,
    check_poisson_ratio,
    check_positive,
    is_whole,
    make_parts,
    read_parts,
    to_reals,
)
from updyn.elements.settings import ELEMENT
from updyn.errors import ModelError
from updyn.exchanged import AxisExchange, StiffnessAndMass
from updyn.geometry import Geometry
from updyn.model import Group, Matrix, Model

__all__ = ["BeamMass", "BeamSupport", "Segment", "beam", "beam_from_table", "element_matrices"]

_SLOPE = np.array([1.0, -1.0, 1.0, -1.0])  # from (w, dw/dx - shear) to (Z, RY)


@dataclass(frozen=True, slots=True)
class Segment:
    """A section of the beam that is a separate group. Segments with the same name form one group.

    Parameters
    ----------
    name : str
        Group name.
    start, end : float
        Ends in m.
    E, rho, width, height : float, optional
        Young's modulus (Pa), density (kg/m3) and cross-section (m) of this segment; by default
        those of the beam.
    loss_factor : float, optional
        Structural loss factor; by default that of the beam.
    viscous : float
        External viscous damping per length, in N s/m2 (air, rubber lining).
    """

    name: str
    start: float
    end: float
    E: float | None = None
    rho: float | None = None
    width: float | None = None
    height: float | None = None
    loss_factor: float | None = None
    viscous: float = 0.0


@dataclass(frozen=True, slots=True)
class BeamSupport:
    """A spring and a damper to ground. Supports with the same name form one group.

    Parameters
    ----------
    name : str
        Group name.
    x : float
        Position in m.
    stiffness : float
        Stiffness along Z in N/m.
    rotational_stiffness : float
        Stiffness about Y in N m/rad.
    loss_factor : float
        Structural loss factor of both springs.
    viscous : float
        Damper along Z, in N s/m.
    """

    name: str
    x: float
    stiffness: float = 0.0
    rotational_stiffness: float = 0.0
    loss_factor: float = 0.0
    viscous: float = 0.0


@dataclass(frozen=True, slots=True)
class BeamMass:
    """A rigid mass on the beam, such as an accelerometer. Masses of one name form one group.

    Parameters
    ----------
    name : str
        Group name.
    x : float
        Position in m.
    mass : float
        Mass in kg.
    rotary_inertia : float
        Inertia about Y in kg m2.
    """

    name: str
    x: float
    mass: float
    rotary_inertia: float = 0.0


_REQUIRED_KEYS = ("length", "E", "rho", "width", "height")
_OPTIONAL_KEYS = (
    "nu",
    "shear_coefficient",
    "loss_factor",
    "n_elements",
    "nodes",
    "stations",
    "title",
)
#: Arrays of tables of a job file, and the class of their rows.
_TABLES: Mapping[str, type] = {
    "segments": Segment,
    "supports": BeamSupport,
    "masses": BeamMass,
}


def beam(
    length: float,
    *,
    E: float,
    rho: float,
    width: float,
    height: float,
    nu: float = 0.3,
    shear_coefficient: float | None = None,
    loss_factor: float = 0.0,
    n_elements: int | None = None,
    nodes: ArrayLike | None = None,
    stations: Iterable[float] | Mapping[int, float] = (),
    segments: Iterable[Segment | Sequence[object]] = (),
    supports: Iterable[BeamSupport | Sequence[object]] = (),
    masses: Iterable[BeamMass | Sequence[object]] = (),
    title: str = "",
) -> Model:
    """Build a Timoshenko beam of rectangular cross-section in bending; free-free without supports.

    All arguments are in SI units. `shear_coefficient` is effective over true shear area, by default
    10 (1 + nu) / (12 + 11 nu) of a rectangle (Cowper, J. Applied Mechanics 33 (1966) 335). `nodes`
    gives all node positions; otherwise `stations`, segment ends, supports and masses are nodes, and
    no element is longer than `length` / `n_elements` (100). Nodes are numbered in order of x,
    except `stations` with given numbers.
    """
    common = {"E": E, "rho": rho, "width": width, "height": height}
    for name, value in {"length": length, **common}.items():
        check_positive("beam", name, value)
    check_poisson_ratio("beam", nu)
    if shear_coefficient is None:
        shear_coefficient = 10 * (1 + nu) / (12 + 11 * nu)
    kappa = check_positive("beam", "shear_coefficient", shear_coefficient)
    all_segments = make_parts(Segment, segments) or [Segment("beam", 0.0, length)]
    all_supports = make_parts(BeamSupport, supports)
    all_masses = make_parts(BeamMass, masses)
    _check_names(all_segments, all_supports, all_masses)
    all_stations = _read_stations(stations)
    places = [("station", x) for x, _ in all_stations]
    for segment in all_segments:
        places.append((f"segment {segment.name!r}", segment.start))
        places.append((f"segment {segment.name!r}", segment.end))
    places += [(f"support {support.name!r}", support.x) for support in all_supports]
    places += [(f"mass {mass.name!r}", mass.x) for mass in all_masses]
    x = _node_positions(length, places, n_elements, nodes)
    _check_cover(all_segments, length)
    groups = _segment_groups(x, all_segments, common, 2 * (1 + nu) / kappa, loss_factor)
    groups |= _support_groups(x, all_supports)
    groups |= _mass_groups(x, all_masses)
    labels = _node_numbers(x, all_stations)
    n = len(x)
    directions = np.tile([DIRECTIONS.index("Z"), DIRECTIONS.index("RY")], n)
    dofs = DofSet.from_arrays(np.repeat(labels, 2), directions)
    xyz = np.column_stack([x, np.zeros((n, 2))])
    geometry = Geometry(labels, xyz, np.column_stack([labels[:-1], labels[1:]]))
    return Model.from_groups(groups, dofs, geometry=geometry, title=title)


def beam_from_table(table: Mapping[str, Any]) -> Model:
    """Build a beam from a table ``[model] kind = "beam"`` with the arguments of `beam` as keys."""
    data = dict(table)
    kind = data.pop("kind", "beam")
    if kind != "beam":
        raise ModelError(f"model: kind {kind!r}; expected 'beam'")
    check_keys("model", data, _REQUIRED_KEYS, (*_OPTIONAL_KEYS, *_TABLES))
    for key, part in _TABLES.items():
        data[key] = read_parts(data, key, part)
    stations = data.get("stations")
    if isinstance(stations, Mapping):
        data["stations"] = {_node_number(key): x for key, x in stations.items()}
    return beam(**data)


def _check_names(
    segments: list[Segment], supports: list[BeamSupport], masses: list[BeamMass]
) -> None:
    seen: dict[str, str] = {}
    for kind, items in (("segment", segments), ("support", supports), ("mass", masses)):
        for item in items:
            if not isinstance(item.name, str):
                raise ModelError(f"{kind} {item.name!r}: expected a text as its name")
            if seen.setdefault(item.name, kind) != kind:
                raise ModelError(
                    f"{item.name!r} names a {seen[item.name]} and a {kind}; a group is of one kind"
                )


def _node_number(key: object) -> int:
    if isinstance(key, str) and key.isdecimal():
        return int(key)
    raise ModelError(f"model.stations: {key!r}; expected a node number", key=("stations",))


# -- groups
def _segment_groups(
    x: RealArray,
    segments: Iterable[Segment],
    common: Mapping[str, float],
    shear_ratio: float,
    loss_factor: float,
) -> dict[str, Group]:
    """Return the groups of the segments; `shear_ratio` is E / (kappa G)."""
    every = list(segments)
    groups: dict[str, Group] = {}
    for name in dict.fromkeys(segment.name for segment in every):
        recipe = _SegmentRecipe(
            x, tuple(s for s in every if s.name == name), common, shear_ratio, loss_factor
        )
        groups[name] = recipe.group().with_exchanged(_exchange_axes(recipe))
    return groups


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentRecipe:
    """Recipe of a group: its segments and their common properties."""

    x: RealArray
    segments: tuple[Segment, ...]
    common: Mapping[str, float]
    shear_ratio: float
    loss_factor: float

    def group(self) -> Group:
        shared = (self.common, self.shear_ratio, self.loss_factor)
        first, *others = (_segment_group(self.x, one, *shared) for one in self.segments)
        for other in others:
            first = _add_groups(self.segments[0].name, first, other)
        return first

    def section(self, segment: Segment) -> tuple[float, float]:
        width, height = (
            size if (size := getattr(segment, key)) is not None else self.common[key]
            for key in ("width", "height")
        )
        return width, height

    def matrices(self) -> StiffnessAndMass:
        group = self.group()
        return StiffnessAndMass(group.stiffness, group.mass)


def _exchange_axes(recipe: _SegmentRecipe) -> AxisExchange | None:
    """Return the group with width and height exchanged; None if they are equal."""
    turned = []
    for segment in recipe.segments:
        width, height = recipe.section(segment)
        turned.append(replace(segment, width=height, height=width))
    sections = [recipe.section(segment) for segment in recipe.segments]
    if all(width == height for width, height in sections):
        return None
    name = recipe.segments[0].name
    where = "the beam"
    if name != "beam" or any(s.width is not None for s in recipe.segments):
        where = f"segment {name!r}"
    shown = "; ".join(
        f"width = {height:g}, height = {width:g}" for width, height in dict.fromkeys(sections)
    )
    what = f"width and height of {where}: {shown}"
    return AxisExchange(replace(recipe, segments=tuple(turned)), what)


def _segment_group(
    x: RealArray,
    segment: Segment,
    common: Mapping[str, float],
    shear_ratio: float,
    loss_factor: float,
) -> Group:
    what = f"segment {segment.name!r}"
    properties = dict(common)
    for name in common:
        value = getattr(segment, name)
        if value is not None:
            properties[name] = check_positive(what, name, value)
    if segment.loss_factor is not None:
        loss_factor = segment.loss_factor
    viscous = check_not_negative(what, "viscous", segment.viscous)
    A = properties["width"] * properties["height"]
    second_moment = properties["width"] * properties["height"] ** 3 / 12
    mass_per_length = properties["rho"] * A
    middle = (x[:-1] + x[1:]) / 2
    first = np.flatnonzero((middle > segment.start) & (middle < segment.end))
    # E I / (kappa G A) = (E / G) (I / A) / kappa
    K, M_w, M_t = element_matrices(
        np.diff(x)[first],
        properties["E"] * second_moment,
        mass_per_length,
        properties["rho"] * second_moment,
        shear_ratio * second_moment / A,
    )
    n = 2 * len(x)
    C = None
    if viscous:
        C = _assemble(M_w * (viscous / mass_per_length), first, n)
    return Group(_assemble(K, first, n), _assemble(M_w + M_t, first, n), loss_factor, C)


def _add_groups(name: str, a: Group, b: Group) -> Group:
    """Return the sum of two segments with the same name."""
    if a.loss_factor != b.loss_factor:
        raise ModelError(
            f"segment {name!r}: loss factors {a.loss_factor} and {b.loss_factor} in one group; use"
            " two names"
        )
    K = _add_matrices(a.stiffness, b.stiffness)
    return Group(
        K, _add_matrices(a.mass, b.mass), a.loss_factor, _add_matrices(a.viscous, b.viscous)
    )


def _add_matrices(A: Matrix | None, B: Matrix | None) -> Matrix | None:
    if A is None:
        return B
    if B is None:
        return A
    return A + B


def _assemble(blocks: RealArray, first: IndexArray, n: int) -> sp.csr_array:
    """Return the sum of element matrices in the DOFs (Z, RY), shape (n, n)."""
    at = 2 * first[:, None] + np.arange(4)
    rows, columns = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    signed = blocks * _SLOPE[:, None] * _SLOPE
    entries = (signed.ravel(), (rows.ravel(), columns.ravel()))
    return sp.csr_array(sp.coo_array(entries, shape=(n, n)))


def _support_groups(x: RealArray, supports: Sequence[BeamSupport]) -> dict[str, Group]:
    groups: dict[str, Group] = {}
    for name in dict.fromkeys(support.name for support in supports):
        same = [support for support in supports if support.name == name]
        what = f"support {name!r}"
        stiffness = np.zeros((len(x), 2))  # along Z, about Y
        viscous = np.zeros((len(x), 2))
        for support in same:
            for key in ("stiffness", "rotational_stiffness", "viscous"):
                check_not_negative(what, key, getattr(support, key))
            at = _find_nearest(x, support.x)
            stiffness[at] += support.stiffness, support.rotational_stiffness
            viscous[at, 0] += support.viscous
        losses = {support.loss_factor for support in same}
        if len(losses) > 1:
            raise ModelError(f"{what}: loss factors {sorted(losses)} in one group; use two names")
        if not stiffness.any() and not viscous.any():
            raise ModelError(
                f"{what} has neither stiffness nor viscous damping; give a start above 0 or leave"
                " it out"
            )
        (loss_factor,) = losses
        if loss_factor and not stiffness.any():
            raise ModelError(f"{what}: a loss factor without stiffness has no effect")
        K = _diagonal_matrix(stiffness)
        groups[name] = Group(K, loss_factor=loss_factor, viscous=_diagonal_matrix(viscous))
    return groups


def _mass_groups(x: RealArray, masses: Sequence[BeamMass]) -> dict[str, Group]:
    diagonals: dict[str, RealArray] = {}
    for mass in masses:
        what = f"mass {mass.name!r}"
        check_positive(what, "mass", mass.mass)
        check_not_negative(what, "rotary_inertia", mass.rotary_inertia)
        diagonal = diagonals.setdefault(mass.name, np.zeros((len(x), 2)))
        diagonal[_find_nearest(x, mass.x)] += mass.mass, mass.rotary_inertia
    return {name: Group(mass=_diagonal_matrix(values)) for name, values in diagonals.items()}


def _diagonal_matrix(values: RealArray) -> sp.csr_array | None:
    """Return a diagonal matrix of values by node and DOF, shape (n, 2); None if all are 0."""
    flat = values.ravel()
    used = np.flatnonzero(flat)
    if not used.size:
        return None
    return sp.csr_array((flat[used], (used, used)), shape=(flat.size, flat.size))


def _find_nearest(x: RealArray, position: float) -> int:
    return int(np.argmin(np.abs(x - position)))


# -- nodes
def _node_positions(
    length: float,
    places: Iterable[tuple[str, float]],
    n_elements: int | None,
    nodes: ArrayLike | None,
) -> RealArray:
    """Return ascending node positions in m that include `places`, pairs of name and position."""
    checked = [(what, check_number(what, "position", x)) for what, x in places]
    for what, x in checked:
        if not -ELEMENT.rounding * length <= x <= (1 + ELEMENT.rounding) * length:
            raise ModelError(
                f"{what} at {x:g} m lies off the beam, which runs from 0 to {length:g} m"
            )
    if nodes is not None:
        if n_elements is not None:
            raise ModelError("beam: give either n_elements or nodes, not both", key=("n_elements",))
        return _read_nodes(length, checked, nodes)
    if n_elements is None:
        n_elements = ELEMENT.beam_elements
    if not is_whole(n_elements) or n_elements < 1:
        raise ModelError(
            f"beam: n_elements {n_elements!r}; expected a whole number of at least 1",
            key=("n_elements",),
        )
    cuts = np.unique(np.clip([0.0, length, *(x for _, x in checked)], 0.0, length))
    # Positions that differ only by rounding are one; the ends are exact.
    cuts = cuts[np.r_[True, np.diff(cuts) > ELEMENT.rounding * length]]
    cuts[-1] = length
    counts = np.maximum(np.ceil(np.diff(cuts) / length * n_elements - 1e-6), 1).astype(int)
    pieces = []
    for start, end, count in zip(cuts[:-1], cuts[1:], counts, strict=True):
        pieces.append(np.linspace(start, end, count, endpoint=False))
    return np.concatenate([*pieces, [length]])


def _read_nodes(length: float, places: Iterable[tuple[str, float]], nodes: ArrayLike) -> RealArray:
    try:
        x = to_reals(nodes)
    except ValueError as error:
        raise ModelError(f"beam: nodes are not numbers ({error})", key=("nodes",)) from error
    tolerance = ELEMENT.rounding * length
    if x.ndim != 1 or len(x) < 2 or not np.isfinite(x).all() or (np.diff(x) <= tolerance).any():
        raise ModelError(
            "beam: nodes must be at least two finite positions that increase", key=("nodes",)
        )
    if abs(x[0]) > tolerance or abs(x[-1] - length) > tolerance:
        raise ModelError(
            f"beam: nodes run from {x[0]:g} to {x[-1]:g} m; expected 0 to {length:g} m",
            key=("nodes",),
        )
    for what, place in places:
        nearest = x[_find_nearest(x, place)]
        if abs(nearest - place) > tolerance:
            raise ModelError(
                f"{what} at {place:.9g} m is not a node; nearest: {nearest:.9g} m", key=("nodes",)
            )
    return x


def _read_stations(
    stations: Iterable[float] | Mapping[int, float],
) -> list[tuple[float, int | None]]:
    """Return positions in m with their node numbers, if given."""
    if isinstance(stations, Mapping):
        for node in stations:
            if not is_whole(node) or node < 1:
                raise ModelError(
                    f"station {node!r}: expected a node number of at least 1", key=("stations",)
                )
        return [(check_number(f"station {k}", "position", x), int(k)) for k, x in stations.items()]
    if isinstance(stations, str) or not isinstance(stations, Iterable):
        raise ModelError(
            f"stations {stations!r}: expected positions in m, or node numbers with positions",
            key=("stations",),
        )
    return [(check_number("station", "position", x), None) for x in stations]


def _node_numbers(x: RealArray, stations: Iterable[tuple[float, int | None]]) -> IntArray:
    """Return the node numbers, shape (n,): those of stations, else 1, 2, ... in order of x."""
    numbers = np.zeros(len(x), dtype=np.int64)
    for position, node in stations:
        if node is None:
            continue
        at = _find_nearest(x, position)
        if numbers[at]:
            raise ModelError(
                f"stations {numbers[at]} and {node} share the position {position:g} m",
                key=("stations",),
            )
        numbers[at] = node
    unnumbered = numbers == 0
    free = np.setdiff1d(np.arange(1, 2 * len(x) + 1), numbers)
    numbers[unnumbered] = free[: unnumbered.sum()]
    return numbers


def _check_cover(segments: Iterable[Segment], length: float) -> None:
    """Check that the segments cover the beam once, without empty segments, overlaps or gaps."""
    reached = 0.0
    before = "the start"
    tolerance = ELEMENT.rounding * length
    for segment in sorted(segments, key=lambda s: (s.start, s.end)):
        name = f"segment {segment.name!r}"
        start = segment.start
        end = segment.end
        if end - start <= tolerance:
            raise ModelError(
                f"{name} runs from {start:g} to {end:g} m; expected its end beyond its start",
                key=("segments",),
            )
        if start > reached + tolerance:
            raise ModelError(
                f"no segment covers {reached:g} to {start:g} m, between {before} and {name}",
                key=("segments",),
            )
        if start < reached - tolerance:
            raise ModelError(
                f"{name} starts at {start:g} m, within {before}, which ends at {reached:g} m",
                key=("segments",),
            )
        reached = end
        before = name
    if reached < length - tolerance:
        raise ModelError(
            f"no segment covers {reached:g} to {length:g} m, after {before}", key=("segments",)
        )


# -- elements
def element_matrices(
    length: ArrayLike, EI: float, mass_per_length: float, inertia_per_length: float, shear: float
) -> tuple[RealArray, RealArray, RealArray]:
    """Return stiffness, translational and rotary mass of two-node Timoshenko elements.

    Each has shape (n, 4, 4) in (w1, t1, w2, t2): deflections w (m), section rotations t = dw/dx -
    shear strain (rad). `shear` is E I / (kappa G A) in m2, with phi = 12 shear / length^2 (0 for
    Euler-Bernoulli). Przemieniecki 1968, section 5.6; Friedman & Kosmatka 1993.
    """
    l = np.asarray(length, dtype=np.float64)  # noqa: E741 - the field's letter
    p = 12.0 * shear / l**2
    one = np.ones_like(l)
    K = _symmetric4(12 * one, 6 * l, -12 * one, 6 * l, (4 + p) * l**2, -6 * l, (2 - p) * l**2)
    M_w = _symmetric4(
        70 * p**2 + 147 * p + 78,
        (35 * p**2 + 77 * p + 44) * l / 4,
        35 * p**2 + 63 * p + 27,
        -(35 * p**2 + 63 * p + 26) * l / 4,
        (7 * p**2 + 14 * p + 8) * l**2 / 4,
        (35 * p**2 + 63 * p + 26) * l / 4,
        -(7 * p**2 + 14 * p + 6) * l**2 / 4,
    )
    M_t = _symmetric4(
        36 * one,
        (3 - 15 * p) * l,
        -36 * one,
        (3 - 15 * p) * l,
        (10 * p**2 + 5 * p + 4) * l**2,
        (15 * p - 3) * l,
        (5 * p**2 - 5 * p - 1) * l**2,
    )
    return (
        K * (EI / ((1 + p) * l**3))[:, None, None],
        M_w * (mass_per_length * l / (210 * (1 + p) ** 2))[:, None, None],
        M_t * (inertia_per_length / (30 * (1 + p) ** 2 * l))[:, None, None],
    )


def _symmetric4(
    a: RealArray,
    b: RealArray,
    c: RealArray,
    d: RealArray,
    e: RealArray,
    f: RealArray,
    g: RealArray,
) -> RealArray:
    """Return matrices, shape (n, 4, 4), of uniform elements, whose halves are mirror images."""
    rows = [[a, b, c, d], [b, e, f, g], [c, f, a, -b], [d, g, -b, e]]
    return np.moveaxis(np.array(rows), -1, 0)
