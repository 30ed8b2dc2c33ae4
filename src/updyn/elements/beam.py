"""`beam`: a planar Timoshenko beam in bending, with supports and point masses, as groups.

The beam lies along X, deflects along Z and its sections turn about Y. A positive RY (right-hand
rule) turns X towards -Z, so that without shear RY = -dw/dx.

Its two-node elements are exact for static loads at the nodes and free of shear locking: stiffness
of Przemieniecki, Theory of Matrix Structural Analysis, 1968, section 5.6 (bending in one plane),
consistent mass with rotary inertia of Friedman & Kosmatka, Computers & Structures 47 (1993)
473-481, from the same displacement functions. The shear strain is constant over an element, so
that natural frequencies converge from above, with an error proportional to the square of the
element length (4e-6 for the second bending mode of a beam 30 times longer than high, with 100
elements).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import DIRECTIONS, DofSet
from updyn.elements.checks import (
    check_keys,
    from_row,
    make_parts,
    not_negative,
    number,
    positive,
    rows_of,
)
from updyn.errors import ModelError
from updyn.geometry import Geometry
from updyn.model import Group, Model

__all__ = [
    "PointMass",
    "Segment",
    "Support",
    "beam",
    "beam_from_table",
    "check_cover",
    "element_matrices",
    "mesh",
    "number_nodes",
    "read_stations",
]

_SLOPE = np.array([1.0, -1.0, 1.0, -1.0])  # from (w, dw/dx - shear) to (Z, RY)


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of the beam, a group of its own. Segments of the same name form one group.

    Parameters
    ----------
    name : str
        Group name.
    start, end : float
        From and to, in m.
    E, rho, width, height : float, optional
        Young's modulus (Pa), density (kg/m3) and section (m) of this stretch; None: those of the
        beam.
    loss_factor : float, optional
        Structural loss factor; None: that of the beam.
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
class Support:
    """A spring and a damper to ground. Supports of the same name form one group.

    Parameters
    ----------
    name : str
        Group name.
    x : float
        Position in m.
    stiffness : float
        Along Z, in N/m.
    rotational_stiffness : float
        About Y, in N m/rad.
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
class PointMass:
    """A rigid mass on the beam, such as an accelerometer. Masses of the same name form one group.

    Parameters
    ----------
    name : str
        Group name.
    x : float
        Position in m.
    mass : float
        In kg.
    rotary_inertia : float
        About Y, in kg m2.
    """

    name: str
    x: float
    mass: float
    rotary_inertia: float = 0.0


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
    segments: Iterable[Segment | Sequence[Any]] = (),
    supports: Iterable[Support | Sequence[Any]] = (),
    masses: Iterable[PointMass | Sequence[Any]] = (),
    title: str = "",
) -> Model:
    """Build a Timoshenko beam of rectangular section in bending; free-free without supports.

    Parameters
    ----------
    length : float
        In m.
    E, rho : float
        Young's modulus in Pa and density in kg/m3.
    width, height : float
        Section in m; the height is along Z, the direction of deflection.
    nu : float
        Poisson's ratio, for G = E / (2 (1 + nu)).
    shear_coefficient : float, optional
        Effective over true shear area. None: 10 (1 + nu) / (12 + 11 nu), a rectangle (Cowper, J.
        Applied Mechanics 33 (1966) 335).
    loss_factor : float
        Structural loss factor.
    n_elements : int, optional
        No element is longer than `length` over this number (100 if neither this nor `nodes` is
        given). There are more elements than that where stations, segment ends, supports and masses
        cut them.
    nodes : array_like of float, shape (n,), optional
        All node positions in m, instead of `n_elements`; each station, segment end, support and
        mass must be among them.
    stations : iterable of float, or mapping of int to float
        Positions in m that must be nodes (sensors, hammer points). As a mapping from node number to
        position those nodes get the numbers given. All other nodes are numbered 1, 2, ... in order
        of x, leaving those out.
    segments : iterable of Segment
        Stretches that form groups of their own; together they must cover the beam once. None: one
        group ``"beam"``. A tuple ``(name, start, end)`` will do.
    supports : iterable of Support
        Springs and dampers to ground.
    masses : iterable of PointMass
        Rigid masses.
    title : str
        For the record.

    Returns
    -------
    Model
        DOFs ``node:Z`` and ``node:RY`` of each node in order of x; groups: the segments, the
        supports, the masses; geometry with the beam drawn along X.

    Raises
    ------
    ModelError
        If a number is not usable, a position lies off the beam, segments overlap or leave a gap, or
        names collide.
    """
    common = {"E": E, "rho": rho, "width": width, "height": height}
    for name, value in {"length": length, **common}.items():
        positive("beam", name, value)
    if not -1.0 < number("beam", "nu", nu) <= 0.5:
        raise ModelError(f"beam: nu {nu!r}; expected above -1 and at most 0.5", key=("nu",))
    kappa = 10 * (1 + nu) / (12 + 11 * nu) if shear_coefficient is None else shear_coefficient
    positive("beam", "shear_coefficient", kappa)
    stretches = make_parts(Segment, segments) or [Segment("beam", 0.0, length)]
    springs, lumps = make_parts(Support, supports), make_parts(PointMass, masses)
    _check_names(stretches, springs, lumps)
    given = read_stations(stations)
    wanted = [("station", p) for p, _ in given]
    wanted += [(f"segment {s.name!r}", p) for s in stretches for p in (s.start, s.end)]
    wanted += [(f"support {s.name!r}", s.x) for s in springs] + [
        (f"mass {m.name!r}", m.x) for m in lumps
    ]
    x = mesh(length, wanted, n_elements, nodes)
    check_cover([(s.name, s.start, s.end) for s in stretches], length)
    groups = _segment_groups(x, stretches, common, 2 * (1 + nu) / kappa, loss_factor)
    groups |= _support_groups(x, springs) | _mass_groups(x, lumps)
    labels = number_nodes(x, given)
    n = len(x)
    dofs = DofSet.from_arrays(
        np.repeat(labels, 2), np.tile([DIRECTIONS.index("Z"), DIRECTIONS.index("RY")], n)
    )
    drawn = Geometry(
        labels, np.column_stack([x, np.zeros((n, 2))]), np.column_stack([labels[:-1], labels[1:]])
    )
    return Model.from_groups(groups, dofs, geometry=drawn, title=title)


def beam_from_table(table: Mapping[str, Any]) -> Model:
    """Build a beam from a table of a job file, ``[model] kind = "beam"``.

    Parameters
    ----------
    table : mapping
        ``kind`` (``"beam"``, may be left out) and the keyword arguments of `beam` by name.
        ``segments``, ``supports`` and ``masses`` are arrays of tables with the fields of `Segment`,
        `Support` and `PointMass`; ``stations`` is an array of positions in m, or a table from node
        number to position.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If a key is missing or unknown (the nearest is named), or as `beam`.
    """
    data = dict(table)
    kind = data.pop("kind", "beam")
    if kind != "beam":
        raise ModelError(f"model: kind {kind!r}; expected 'beam'")
    required = ("length", "E", "rho", "width", "height")
    optional = (
        "nu",
        "shear_coefficient",
        "loss_factor",
        "n_elements",
        "nodes",
        "stations",
        "title",
    )
    kinds: dict[str, type[Any]] = {"segments": Segment, "supports": Support, "masses": PointMass}
    check_keys("model", data, required, (*optional, *kinds))
    for key, part in kinds.items():
        rows = enumerate(rows_of(data, key), 1)
        data[key] = [from_row(part, key, number, row) for number, row in rows]
    if isinstance(stations := data.get("stations"), Mapping):
        data["stations"] = {_node_number(k): v for k, v in stations.items()}
    return beam(**data)


def _check_names(segments: list[Segment], supports: list[Support], masses: list[PointMass]) -> None:
    seen: dict[str, str] = {}
    for kind, items in (("segment", segments), ("support", supports), ("mass", masses)):
        for item in items:
            if not isinstance(item.name, str):
                raise ModelError(f"{kind} {item.name!r}: expected a text as its name")
            if seen.setdefault(item.name, kind) != kind:
                raise ModelError(
                    f"{item.name!r} names a {seen[item.name]} and a {kind}; a group is of one kind"
                )


def _node_number(key: Any) -> int:
    if isinstance(key, str) and key.isdecimal():
        return int(key)
    raise ModelError(f"model.stations: {key!r}; expected a node number", key=("stations",))


def _segment_groups(
    x: NDArray[np.float64],
    segments: list[Segment],
    common: Mapping[str, float],
    shear_ratio: float,
    loss_factor: float,
) -> dict[str, Group]:
    n = 2 * len(x)
    middle = (x[:-1] + x[1:]) / 2
    parts: dict[str, list[Any]] = {}
    for s in segments:
        what = f"segment {s.name!r}"
        own = {
            k: v if getattr(s, k) is None else positive(what, k, getattr(s, k))
            for k, v in common.items()
        }
        gamma = loss_factor if s.loss_factor is None else s.loss_factor
        viscous = not_negative(what, "viscous", s.viscous)
        A, inertia = own["width"] * own["height"], own["width"] * own["height"] ** 3 / 12
        first = np.flatnonzero((middle > s.start) & (middle < s.end))
        # E I / (kappa G A) = (E / G) (I / A) / kappa
        K, M_w, M_t = element_matrices(
            np.diff(x)[first],
            own["E"] * inertia,
            own["rho"] * A,
            own["rho"] * inertia,
            shear_ratio * inertia / A,
        )
        C = M_w * (viscous / (own["rho"] * A)) if viscous else None
        built = [_assemble(block, first, n) for block in (K, M_w + M_t)] + [_assemble(C, first, n)]
        old = parts.setdefault(s.name, [None, None, None, gamma])
        if old[3] != gamma:
            raise ModelError(
                f"{what}: loss factors {old[3]} and {gamma} in one group; use two names"
            )
        parts[s.name] = [_plus(a, b) for a, b in zip(old[:3], built, strict=True)] + [gamma]
    return {
        name: Group(K, M, loss_factor=gamma, viscous=C) for name, (K, M, C, gamma) in parts.items()
    }


def _assemble(blocks: NDArray[np.float64] | None, first: NDArray[np.intp], n: int) -> Any:
    if blocks is None:
        return None
    at = 2 * first[:, None] + np.arange(4)
    rows, columns = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    signed = blocks * _SLOPE[:, None] * _SLOPE
    return sp.csr_array(
        sp.coo_array((signed.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n))
    )


def _plus(a: Any, b: Any) -> Any:
    return a if b is None else b if a is None else a + b


def _support_groups(x: NDArray[np.float64], supports: list[Support]) -> dict[str, Group]:
    out: dict[str, Group] = {}
    for name in dict.fromkeys(s.name for s in supports):
        same = [s for s in supports if s.name == name]
        what = f"support {name!r}"
        for s in same:
            for key in ("stiffness", "rotational_stiffness", "viscous"):
                not_negative(what, key, getattr(s, key))
        if len({s.loss_factor for s in same}) > 1:
            raise ModelError(
                f"{what}: loss factors {sorted({s.loss_factor for s in same})} in one group; use"
                " two names"
            )
        at = 2 * np.array([_node_at(x, s.x) for s in same])
        K = _diagonal(
            len(x), at, [s.stiffness for s in same], [s.rotational_stiffness for s in same]
        )
        C = _diagonal(len(x), at, [s.viscous for s in same], [0.0] * len(same))
        if K is None and C is None:
            raise ModelError(
                f"{what} has neither stiffness nor viscous damping; give a start above 0 or leave"
                " it out"
            )
        if K is None and same[0].loss_factor:
            raise ModelError(f"{what}: a loss factor without stiffness has no effect")
        out[name] = Group(K, loss_factor=same[0].loss_factor, viscous=C)
    return out


def _mass_groups(x: NDArray[np.float64], masses: list[PointMass]) -> dict[str, Group]:
    out: dict[str, Group] = {}
    for name in dict.fromkeys(m.name for m in masses):
        same = [m for m in masses if m.name == name]
        for m in same:
            positive(f"mass {name!r}", "mass", m.mass)
            not_negative(f"mass {name!r}", "rotary_inertia", m.rotary_inertia)
        at = 2 * np.array([_node_at(x, m.x) for m in same])
        out[name] = Group(
            mass=_diagonal(len(x), at, [m.mass for m in same], [m.rotary_inertia for m in same])
        )
    return out


def _diagonal(n_nodes: int, at: NDArray[np.intp], along: list[float], about: list[float]) -> Any:
    values = np.zeros(2 * n_nodes)
    np.add.at(values, at, along)
    np.add.at(values, at + 1, about)
    used = np.flatnonzero(values)
    return (
        sp.csr_array((values[used], (used, used)), shape=(2 * n_nodes,) * 2) if used.size else None
    )


def _node_at(x: NDArray[np.float64], position: float) -> int:
    return int(np.argmin(np.abs(x - position)))


_SAME = 1e-9  # of the length: positions closer than this are one node
_DEFAULT_ELEMENTS = 100


def mesh(
    length: float,
    wanted: Iterable[tuple[str, float]],
    n_elements: int | None,
    nodes: ArrayLike | None,
) -> NDArray[np.float64]:
    """Return node positions that hold every wanted one and leave no element too long.

    Parameters
    ----------
    length : float
        In m; the line runs from 0 to `length`.
    wanted : iterable of (str, float)
        What needs a node, and where in m.
    n_elements : int or None
        No element is longer than `length` over this (None: 100).
    nodes : array_like of float or None
        All positions in m, instead.

    Returns
    -------
    ndarray of float, shape (n,)
        Ascending, in m.

    Raises
    ------
    ModelError
        If a position is not on the line, or not among the nodes given.
    """
    places = [(what, number(what, "position", x)) for what, x in wanted]
    for what, x in places:
        if not -_SAME * length <= x <= (1 + _SAME) * length:
            raise ModelError(
                f"{what} at {x:g} m lies off the beam, which runs from 0 to {length:g} m"
            )
    if nodes is not None:
        if n_elements is not None:
            raise ModelError("beam: give either n_elements or nodes, not both", key=("n_elements",))
        return _given_nodes(length, places, nodes)
    count = _DEFAULT_ELEMENTS if n_elements is None else n_elements
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise ModelError(
            f"beam: n_elements {count!r}; expected a whole number of at least 1",
            key=("n_elements",),
        )
    cuts = np.unique(np.clip([0.0, length, *(x for _, x in places)], 0.0, length))
    # Positions that differ by rounding only are one; the ends stay exactly where they are.
    cuts = cuts[np.r_[True, np.diff(cuts) > _SAME * length]]
    cuts[-1] = length
    pieces = np.maximum(np.ceil(np.diff(cuts) / length * count - 1e-6), 1).astype(int)
    inner = [
        np.linspace(a, b, k, endpoint=False)
        for a, b, k in zip(cuts[:-1], cuts[1:], pieces, strict=True)
    ]
    return np.concatenate([*inner, [length]])


def _given_nodes(
    length: float, places: list[tuple[str, float]], nodes: ArrayLike
) -> NDArray[np.float64]:
    try:
        x = np.array(nodes, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"beam: nodes are not numbers ({error})", key=("nodes",)) from error
    if (
        x.ndim != 1
        or len(x) < 2
        or not np.isfinite(x).all()
        or (np.diff(x) <= _SAME * length).any()
    ):
        raise ModelError(
            "beam: nodes must be at least two finite positions that increase", key=("nodes",)
        )
    if abs(x[0]) > _SAME * length or abs(x[-1] - length) > _SAME * length:
        raise ModelError(
            f"beam: nodes run from {x[0]:g} to {x[-1]:g} m; expected 0 to {length:g} m",
            key=("nodes",),
        )
    for what, place in places:
        nearest = x[int(np.argmin(np.abs(x - place)))]
        if abs(nearest - place) > _SAME * length:
            raise ModelError(
                f"{what} at {place:.9g} m is not a node; nearest: {nearest:.9g} m", key=("nodes",)
            )
    return x


def read_stations(
    stations: Iterable[float] | Mapping[int, float],
) -> list[tuple[float, int | None]]:
    """Return positions in m, each with the node number that it was given, if any.

    Raises
    ------
    ModelError
        If a node number is not a positive whole number, or a position is not a number.
    """
    if isinstance(stations, Mapping):
        for node in stations:
            if isinstance(node, bool) or not isinstance(node, int | np.integer) or node < 1:
                raise ModelError(
                    f"station {node!r}: expected a node number of at least 1", key=("stations",)
                )
        return [(number(f"station {k}", "position", x), int(k)) for k, x in stations.items()]
    if isinstance(stations, str) or not isinstance(stations, Iterable):
        raise ModelError(
            f"stations {stations!r}: expected positions in m, or node numbers with positions",
            key=("stations",),
        )
    return [(number("station", "position", x), None) for x in stations]


def number_nodes(
    x: NDArray[np.float64], stations: list[tuple[float, int | None]]
) -> NDArray[np.int64]:
    """Return the node numbers, shape (n,): those given to stations, else 1, 2, ... in order of x.

    Raises
    ------
    ModelError
        If two stations with different numbers share a position.
    """
    labels = np.zeros(len(x), dtype=np.int64)
    for position, node in stations:
        if node is not None:
            at = int(np.argmin(np.abs(x - position)))
            if labels[at]:
                raise ModelError(
                    f"stations {labels[at]} and {node} share the position {position:g} m",
                    key=("stations",),
                )
            labels[at] = node
    taken = set(labels[labels > 0].tolist())
    free = (k for k in range(1, len(x) + len(taken) + 1) if k not in taken)
    for i in np.flatnonzero(labels == 0):
        labels[i] = next(free)
    return labels


def check_cover(segments: Iterable[tuple[str, float, float]], length: float) -> None:
    """Check that segments (name, start, end in m) cover the line from 0 to `length` once.

    Raises
    ------
    ModelError
        If one is empty, two overlap, or a stretch belongs to none.
    """
    reached, before = 0.0, "the start"
    tolerance = _SAME * length
    for name, start, end in sorted(segments, key=lambda s: (s[1], s[2])):
        if end - start <= tolerance:
            raise ModelError(
                f"segment {name!r} runs from {start:g} to {end:g} m; expected its end beyond its"
                " start",
                key=("segments",),
            )
        if start > reached + tolerance:
            raise ModelError(
                f"no segment covers {reached:g} to {start:g} m, between {before} and segment"
                f" {name!r}",
                key=("segments",),
            )
        if start < reached - tolerance:
            raise ModelError(
                f"segment {name!r} starts at {start:g} m, within {before}, which ends at"
                f" {reached:g} m",
                key=("segments",),
            )
        reached, before = end, f"segment {name!r}"
    if reached < length - tolerance:
        raise ModelError(
            f"no segment covers {reached:g} to {length:g} m, after {before}", key=("segments",)
        )


def element_matrices(
    length: ArrayLike, EI: float, mass_per_length: float, inertia_per_length: float, shear: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness, translational and rotary mass of two-node Timoshenko elements, in (w1, t1, w2, t2).

    Parameters
    ----------
    length : array_like of float, shape (n,)
        Element lengths in m.
    EI : float
        Bending stiffness in N m2.
    mass_per_length : float
        rho A in kg/m.
    inertia_per_length : float
        rho I in kg m.
    shear : float
        E I / (kappa G A) in m2, so that phi = 12 shear / length^2; 0: Euler-Bernoulli.

    Returns
    -------
    K, M_w, M_t : ndarray of float, shape (n, 4, 4)
        For deflections w (m) and section rotations t = dw/dx - shear strain (rad).

    Notes
    -----
    Przemieniecki 1968, section 5.6; Friedman & Kosmatka 1993, stiffness, translational and rotary
    inertia matrices of the locking-free element.
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
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    d: NDArray[np.float64],
    e: NDArray[np.float64],
    f: NDArray[np.float64],
    g: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Fill the pattern of a uniform element: its second half mirrors the first, with rotations reversed."""
    rows = [[a, b, c, d], [b, e, f, g], [c, f, a, -b], [d, g, -b, e]]
    return np.moveaxis(np.array(rows), -1, 0)
