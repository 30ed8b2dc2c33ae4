"""Whether nodes of a test and of a model with equal numbers are at the same place.

A distance is gross above `POSITIONS.gross_share` of the model's size. In a coarse model, up to
`POSITIONS.coarse_share` is permitted to the nearest node. Numbers are right if one unit, or one
rigid motion, brings all pairs together.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy  # loads scipy.spatial on use

from updyn.arrays import BoolArray, IntArray, RealArray
from updyn.errors import UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.model import Model
from updyn.settings import MESSAGES, POSITIONS

__all__ = [
    "UNITS",
    "CoordinateSystem",
    "LabelCheck",
    "check_labels",
    "is_in_line",
    "model_size",
    "rigid_motion",
    "warn_of_labels",
]

#: Metres of each unit of length.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


Points = RealArray


@dataclass(frozen=True, slots=True, eq=False)
class CoordinateSystem:
    """Unit, axes and origin of the test's positions: x_model = rotation @ (factor x_test) + shift.

    `unit` is None if it is m, or if the model has another unit; `shift` is in m; `residual` is the
    rms distance in m after a rigid motion, None if nothing was moved.
    """

    factor: float = 1.0
    unit: str | None = None
    rotation: Points = field(default_factory=lambda: np.eye(3))
    shift: Points = field(default_factory=lambda: np.zeros(3))
    residual: float | None = None

    def apply(self, xyz: Points) -> Points:
        """Return positions (n, 3) of the test in the system of the model, in m."""
        return np.asarray(self.factor * xyz @ self.rotation.T + self.shift)

    @property
    def turn(self) -> float:
        """Angle of the rotation in degrees."""
        turn = scipy.spatial.transform.Rotation.from_matrix(self.rotation)
        return float(np.degrees(turn.magnitude()))


@dataclass(frozen=True, slots=True, eq=False)
class LabelCheck:
    """Comparison of the positions of nodes with equal numbers; texts are empty if they agree.

    `proposal` has options of `updyn.match` that fit the positions.
    """

    system: CoordinateSystem = field(default_factory=CoordinateSystem)
    contradiction: str = ""
    proposal: Mapping[str, object] = field(default_factory=dict)
    note: str = ""
    warning: str = ""


def rigid_motion(x: Points, y: Points) -> tuple[Points, Points]:
    """Return rotation R and shift of points (n, 3) onto others: y is about x @ R.T + shift."""
    # Least squares (Kabsch 1976, Horn 1987). Points in a line are turned by the smallest angle.
    x0, y0 = x.mean(axis=0), y.mean(axis=0)
    a, b = x - x0, y - y0
    if is_in_line(a) or is_in_line(b):
        a, b = _along_line(a, b)
    if not a.any() or not b.any():
        return np.eye(3), y0 - x0
    R = scipy.spatial.transform.Rotation.align_vectors(b, a)[0].as_matrix()
    return R, y0 - R @ x0


def is_in_line(centred: Points) -> bool:
    """Return whether centred points (n, 3) are in a line or at one place: rotation undetermined."""
    sizes = np.linalg.svd(centred, compute_uv=False)
    return len(centred) < 3 or bool(sizes[1] <= POSITIONS.line_width * sizes[0])


def _along_line(a: Points, b: Points) -> tuple[Points, Points]:
    """Return the directions of two sets of points around 0 in one sense, each of shape (1, 3)."""
    along = np.linalg.svd(a, full_matrices=False)[2][:1]
    other = np.linalg.svd(b, full_matrices=False)[2][:1]
    sense = float(np.sum((a @ along.T) * (b @ other.T)))
    return along * bool(a.any()), (other if sense >= 0 else -other) * bool(b.any())


def model_size(model: Model) -> float:
    """Return the diagonal in m of the box around the nodes of a model that have a DOF."""
    assert model.geometry is not None
    used = _has_dof_mask(model)
    return float(np.linalg.norm(np.ptp(model.geometry.xyz[used], axis=0))) if used.any() else 0.0


def _has_dof_mask(model: Model) -> BoolArray:
    """Return a mask of the nodes of the geometry of a model that have a DOF."""
    assert model.geometry is not None
    return np.isin(model.geometry.nodes, model.dofs.nodes)


def warn_of_labels(model: Model, frf: FRF) -> None:
    """Warn if labels and positions of a measurement contradict each other."""
    if model.geometry is None or frf.geometry is None:
        return
    nodes = [dof.node for dof in (*frf.responses, *frf.references)]
    found = check_labels(model, frf.geometry, nodes)
    if found is not None and found.contradiction:
        warnings.warn(
            f"{found.contradiction}\nupdyn.match matches them by position; without geometry"
            " (geometry=None) the labels count",
            UpdynWarning,
            stacklevel=4,
        )


def check_labels(
    model: Model, test: Geometry, nodes: Sequence[int], limit: float | None = None
) -> LabelCheck | None:
    """Compare the positions of nodes with equal numbers in test and model.

    `limit` is the largest distance in m; by default `POSITIONS.gross_share` of the model's size,
    and more if the node is the nearest one. None if no node has a position in both, or the model is
    at one place.
    """
    assert model.geometry is not None
    asked = np.array(list(dict.fromkeys(nodes)), dtype=np.int64)
    both = asked[np.isin(asked, test.nodes) & np.isin(asked, model.geometry.nodes)]
    size = model_size(model)
    if not len(both) or size == 0.0:
        return None
    return _Comparison(both, test, model, size, limit).compare()


class _Comparison:
    """Positions of nodes in test and model, and the systems in which they are compared."""

    def __init__(
        self,
        nodes: IntArray,
        test: Geometry,
        model: Model,
        size: float,
        limit: float | None,
    ) -> None:
        assert model.geometry is not None
        self.nodes = nodes
        self.x = test.position(nodes)
        self.y = model.geometry.position(nodes)
        self.model = model
        self.size = size
        self.stated = limit is not None
        self.limit = POSITIONS.gross_share * self.size if limit is None else limit
        self.radius = _rms(self.y - self.y.mean(axis=0))
        span = float(np.ptp(self.x, axis=0).max())
        places = np.round(self.x / (span or 1.0), 9)
        self.n_places = len(np.unique(places, axis=0))

    def compare(self) -> LabelCheck:
        """Return the first system in which the pairs agree, or the contradiction."""
        current = CoordinateSystem()
        if not self.far_pairs(current).any():
            return LabelCheck()
        if len(self.nodes) > 1 and self.n_places == 1:
            return LabelCheck(
                warning=f"all {len(self.nodes)} nodes of the test have one position,"
                " so that labels and positions were not compared"
            )
        if self.fits_coordinates(current):
            return self.report_contradiction(current, {"by": "coordinates"})
        agreeing = [unit for unit in _other_units() if self.fits_labels(unit)]
        if agreeing:
            return _in_unit(min(agreeing, key=lambda unit: _rms(self.pair_vectors(unit))))
        elsewhere = [unit for unit in _other_units() if unit.unit and self.fits_coordinates(unit)]
        if elsewhere:
            best = min(elsewhere, key=lambda unit: _rms(self.nearest(unit)[0]))
            return self.report_contradiction(best, {"by": "coordinates", "unit": best.unit})
        moved = [self.align_rigidly(unit) for unit in (current, *_other_units())]
        agreeing = [system for system in moved if self.fits_rigidly(system)]
        if agreeing:
            return self.report_motion(min(agreeing, key=lambda one: one.residual or 0.0))
        # Distances above the size mean nothing, because the test is in another system.
        if _rms(self.pair_vectors(current)) > self.size:
            current = min(moved, key=lambda one: abs(math.log(self.size_ratio(one))))
        return self.report_contradiction(current, {})

    # -- distances
    @cached_property
    def tree(self) -> tuple[scipy.spatial.KDTree, IntArray]:
        """Tree of the positions of the used nodes of the model, and these nodes."""
        geometry = self.model.geometry
        assert geometry is not None
        used = _has_dof_mask(self.model)
        return scipy.spatial.KDTree(geometry.xyz[used]), geometry.nodes[used]

    def pair_vectors(self, system: CoordinateSystem) -> Points:
        """Return the vectors between the nodes of each pair, shape (n, 3)."""
        return system.apply(self.x) - self.y

    def nearest(self, system: CoordinateSystem) -> tuple[Points, IntArray]:
        """Return the distance to the nearest node of the model, and that node."""
        tree, names = self.tree
        distance, at = tree.query(system.apply(self.x))
        return distance, names[at]

    def far_pairs(self, system: CoordinateSystem) -> BoolArray:
        """Return a mask of the pairs that are too far apart."""
        distance = np.linalg.norm(self.pair_vectors(system), axis=1)
        far = distance > self.limit
        if self.stated or not far.any():
            return np.asarray(far)
        is_nearest = distance <= (1.0 + 1e-9) * self.nearest(system)[0]
        return np.asarray(far & ~(is_nearest & (distance <= POSITIONS.coarse_share * self.size)))

    def size_ratio(self, system: CoordinateSystem) -> float:
        """Return the size of the test relative to that of the nodes of the model."""
        points = system.apply(self.x)
        test_radius = _rms(points - points.mean(axis=0))
        return test_radius / self.radius if test_radius > 0 and self.radius > 0 else math.inf

    # -- systems
    def fits_labels(self, unit: CoordinateSystem) -> bool:
        """Return whether the pairs agree in another unit."""
        shape = _rms(self.pair_vectors(unit)) <= POSITIONS.unit_share * self.radius
        return shape and not self.far_pairs(unit).any()

    def fits_coordinates(self, unit: CoordinateSystem) -> bool:
        """Return whether most pairs are wrong, and all nodes of the test lie on other nodes."""
        gross = self.far_pairs(unit)
        if 2 * np.sum(gross) <= len(gross):
            return False
        distance, names = self.nearest(unit)
        if unit.factor != 1.0 and self.n_places < 3:
            return False  # with a free unit, one or two nodes lie on others by chance
        near = bool((distance <= POSITIONS.gross_share * self.size).all())
        distinct = len(np.unique(names)) >= self.n_places
        rms = _rms(self.pair_vectors(unit))
        return near and distinct and _rms(distance) < POSITIONS.better_share * rms

    def align_rigidly(self, unit: CoordinateSystem) -> CoordinateSystem:
        """Return the system with the rigid motion that best aligns the pairs."""
        R, shift = rigid_motion(unit.factor * self.x, self.y)
        system = replace(unit, rotation=R, shift=shift)
        return replace(system, residual=_rms(self.pair_vectors(system)))

    def fits_rigidly(self, system: CoordinateSystem) -> bool:
        """Return whether the pairs agree after a rigid motion."""
        assert system.residual is not None
        most = min(
            POSITIONS.rigid_share * self.radius,
            POSITIONS.better_share * _rms(self.pair_vectors(CoordinateSystem())),
        )
        if system.factor != 1.0 and self.n_places < 3:
            most *= 0.1  # with a free unit, any two distances can be made similar
        shape = system.residual <= max(most, 1e-12 * self.size)
        return shape and not self.far_pairs(system).any()

    # -- results
    def report_motion(self, system: CoordinateSystem) -> LabelCheck:
        """Return the remarks on pairs that agree after a rigid motion."""
        n = len(self.nodes)
        x, y, z = (f"{v:.4g}" for v in np.where(abs(system.shift) < 1e-12, 0.0, system.shift))
        motion = f"moved by ({x}, {y}, {z}) m"
        if system.unit is not None:
            motion = f"read in {system.unit} and {motion}"
        elif system.factor != 1.0:
            motion = f"{motion}, and the model is in {_model_unit(system)}, not in m"
        if n < 3:
            warning = (
                f"{_count(n)} of the test with a position in another system (nearest if"
                f" {motion}): whether labels and positions agree cannot be compared"
            )
            return LabelCheck(system, warning=warning)
        text = f"The positions of the test are those of the same labels in the model if {motion}"
        if system.turn <= POSITIONS.least_rotation and system.factor <= 1.0:
            return LabelCheck(system, note=text)
        if system.turn <= POSITIONS.least_rotation:
            return LabelCheck(system, warning=f"{text}; models are in SI")
        pairs = ", ".join(f"{node} = {node}" for node in self.spread_nodes())
        warning = (
            f"{text.replace('moved', f'turned by {system.turn:.3g} degrees and moved', 1)};"
            " directions are taken as the labels name them. If those of the test are along its own"
            f" axes, match by coordinates with alignment = {{ {pairs} }}"
        )
        return LabelCheck(system, warning=warning)

    def spread_nodes(self) -> list[int]:
        """Return three nodes (of more than three) that determine a motion well."""
        y = self.y
        first = int(np.argmax(np.linalg.norm(y - y.mean(axis=0), axis=1)))
        second = int(np.argmax(np.linalg.norm(y - y[first], axis=1)))
        off = np.linalg.norm(np.cross(y - y[first], y[second] - y[first]), axis=1)
        return [int(self.nodes[i]) for i in sorted({first, second, int(np.argmax(off))})]

    def report_contradiction(
        self, system: CoordinateSystem, proposal: dict[str, object]
    ) -> LabelCheck:
        """Return the contradiction with the worst pairs and the remedy."""
        gross = np.flatnonzero(self.far_pairs(system))
        distance = np.linalg.norm(self.pair_vectors(system), axis=1)
        near, names = self.nearest(system)
        rows = []
        for i in sorted(gross, key=lambda i: -distance[i])[: MESSAGES.listed_items]:
            row = f"  {self.nodes[i]}: {distance[i]:.3g} m from node {self.nodes[i]} of the model"
            if names[i] != self.nodes[i]:
                row += f"; node {names[i]} is nearer: {_metres(near[i])} m"
            rows.append(row)
        limit = f"{self.limit:.3g} m"
        if not self.stated:
            limit += f" ({100 * POSITIONS.gross_share:g} % of the model's size)"
        read = f" read in {system.unit}" if system.unit is not None else ""
        if system.residual is not None:
            read += " turned and moved onto the model as closely as possible"
        head = (
            "labels and positions contradict each other: the node of the model with the same number"
            f" is farther than {limit} from {len(gross)} of {_count(len(self.nodes))} of the"
            f" test{read}. Largest distances:"
        )
        if proposal and (worst := float(near.max())) > POSITIONS.matched_share * self.size:
            proposal["tolerance"] = f"{math.ceil(100 * worst / self.size)} %"
        return LabelCheck(
            system, "\n".join([head, *rows, self.remedy_text(near, len(gross), proposal)]), proposal
        )

    def remedy_text(self, near: Points, n_gross: int, proposal: Mapping[str, object]) -> str:
        if proposal:
            options = ", ".join(f'{key} = "{value}"' for key, value in proposal.items())
            return (
                f"All of them lie within {_metres(float(near.max()))} m of other nodes: match by"
                f" coordinates ({options})"
            )
        if 2 * n_gross <= len(self.nodes):
            return "The others agree: correct the number or the position of these"
        return (
            "They agree in no unit of length and after no rigid motion, and do not lie on other"
            " nodes: correct numbers or positions, or match by coordinates with an alignment"
        )


def _other_units() -> Iterator[CoordinateSystem]:
    """Yield systems with other units of the test, then of the model."""
    for name, factor in UNITS.items():
        if name != "m":
            yield CoordinateSystem(factor, name)
    for name, factor in UNITS.items():
        if name != "m":
            yield CoordinateSystem(1.0 / factor)


def _in_unit(system: CoordinateSystem) -> LabelCheck:
    """Return the remark on pairs that agree in another unit."""
    if system.unit is not None:
        text = f"The positions of the test look like {system.unit}: read so, they are those of"
        return LabelCheck(system, note=f"{text} the same labels in the model")
    return LabelCheck(
        system,
        warning=(
            "labels and positions agree if the positions of the test are in m and those of the"
            f" model look like {_model_unit(system)}; models are in SI: read or scale it in m"
        ),
    )


def _model_unit(system: CoordinateSystem) -> str:
    """Return the unit that the model must have for its nodes to match those of the test."""
    return next(name for name, factor in UNITS.items() if 1.0 / factor == system.factor)


def _rms(vectors: Points) -> float:
    """Return the root mean square length of vectors, or of distances."""
    return float(np.sqrt(np.sum(vectors**2) / len(vectors)))


def _count(n: int) -> str:
    return f"{n} node" if n == 1 else f"{n} nodes"


def _metres(distance: float) -> str:
    return "0" if distance < 1e-9 else f"{distance:.3g}"
