"""`beam`: a planar Timoshenko beam in bending, with supports and point masses, as groups.

The beam lies along X, deflects along Z and its sections turn about Y. A positive RY (right-hand
rule) turns X towards
-Z, so that without shear RY = -dw/dx.

The elements are those of `updyn.elements.timoshenko`: exact for static loads at the nodes,
consistent mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import DIRECTIONS, DofSet
from updyn.elements._mesh import (
    check_cover,
    check_keys,
    from_row,
    make_parts,
    mesh,
    not_negative,
    number,
    number_nodes,
    positive,
    read_stations,
)
from updyn.elements.timoshenko import element_matrices
from updyn.errors import ModelError
from updyn.geometry import Geometry
from updyn.model import Group, Model

__all__ = ["PointMass", "Segment", "Support", "beam", "beam_from_table"]

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
        raise ModelError(f"beam: nu {nu!r}; expected above -1 and at most 0.5")
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
        rows = data.get(key, [])
        if not isinstance(rows, list | tuple):
            raise ModelError(
                f"model: {key} holds {type(rows).__name__}; expected an array of tables,"
                f" [[model.{key}]]"
            )
        data[key] = [from_row(part, key, number, row) for number, row in enumerate(rows, 1)]
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
    raise ModelError(f"model.stations: {key!r}; expected a node number")


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
