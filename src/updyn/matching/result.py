"""Results of a matching: the model, the renamed measurement, and the table of sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import DofError, OptionError
from updyn.frf import FRF
from updyn.matching.settings import SENSOR_PLACEMENT
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.text_table import text_table

__all__ = [
    "Alignment",
    "MatchError",
    "Matching",
    "SensorMatch",
    "format_list",
    "vector_text",
]


class MatchError(DofError):
    """Sensors that cannot be matched to the model.

    Parameters
    ----------
    message : str
        The content found, the expectation, and the nearest candidates.
    key : tuple of str
        Argument of `match` and key in it that the error concerns; empty for the measurement.
    lost : sequence of str
        Test labels of the sensors that are not DOFs of the model.
    proposal : mapping of str to object
        Options of `match` that find nodes by position; empty if unknown.
    """

    def __init__(
        self,
        message: str,
        key: tuple[str, ...] = (),
        lost: Sequence[str] = (),
        proposal: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(message, key=key)
        self.lost = tuple(lost)
        self.proposal = dict(proposal or {})


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Motion of the positions of the test to those of the model.

    x_model = rotation @ (factor x_test) + shift.

    Attributes
    ----------
    how : str
        Description of its origin.
    rotation : ndarray of float, shape (3, 3)
        Rotation matrix, without reflection.
    shift : ndarray of float, shape (3,)
        Shift in m.
    factor : float
        Length unit of the test's positions in metres.
    unit : str or None
        Given name of the unit; None if m was assumed.
    residual : float or None
        Root mean square distance in m of fitted points; None without a fit.
    """

    how: str
    rotation: RealArray
    shift: RealArray
    factor: float = 1.0
    unit: str | None = None
    residual: float | None = None

    @property
    def turn(self) -> float:
        """Angle of the rotation in degrees."""
        skew = self.rotation - self.rotation.T
        sine = np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2.0
        return float(np.degrees(np.arctan2(sine, (np.trace(self.rotation) - 1.0) / 2.0)))

    def apply(self, xyz: RealArray) -> RealArray:
        """Move positions of the test onto the model.

        Parameters
        ----------
        xyz : ndarray of float, shape (n, 3)
            Positions in the unit and the system of the test.

        Returns
        -------
        ndarray of float, shape (n, 3)
            Positions in m, in the system of the model.
        """
        return np.asarray(self.factor * xyz @ self.rotation.T + self.shift)

    def __str__(self) -> str:
        parts = [f"positions in {self.unit or 'm'}", self.how]
        if self.turn > 1e-9 or self.shift.any():
            parts.append(f"turned by {self.turn:.3g} degrees, moved by {vector_text(self.shift)} m")
        if self.residual is not None:
            parts.append(f"rms distance of the fitted points {_metres(self.residual)} m")
        return "; ".join(parts)


@dataclass(frozen=True, slots=True)
class SensorMatch:
    """A sensor, a force, or both at one DOF.

    Attributes
    ----------
    sensor : str
        Label in the measurement, without sign.
    role : {"response", "reference", "response and reference"}
        Its role in the measurement.
    dof : str
        Label in the model, with the sign of the sensor's direction.
    distance : float
        Distance of the two nodes in m; nan if positions are unknown.
    angle : float
        Angle in degrees between the sensor and the DOF of that name before the matching.
    turned : bool
        Whether that DOF was rotated to be along the sensor.
    direction : tuple of three float or None
        Unit direction of the sensor in the axes of the model; None for that of its label.
    note : str
        Remark, such as another node at a similar distance.
    """

    sensor: str
    role: str
    dof: str
    distance: float
    angle: float
    turned: bool = False
    direction: tuple[float, float, float] | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Matching:
    """Sensors matched to a model.

    Attributes
    ----------
    model : Model
        The model; at nodes with oblique sensors, DOFs are rotated along these.
    data : FRF or ModeSet
        The measurement with the DOF labels of the model.
    table : tuple of SensorMatch
        One entry per sensor or force, in the order of the measurement.
    by : {"label", "coordinates"}
        Way of finding the nodes.
    alignment : Alignment or None
        Motion of the positions onto the model; None by label, unless the positions of equal labels
        agree only in another unit or after a motion.
    notes : tuple of str
        Remarks on the matching as a whole.
    """

    model: Model
    data: FRF | ModeSet
    table: tuple[SensorMatch, ...]
    by: str
    alignment: Alignment | None = None
    notes: tuple[str, ...] = ()

    @property
    def frf(self) -> FRF:
        """The measured FRFs.

        Raises
        ------
        OptionError
            If modes were measured.
        """
        if isinstance(self.data, FRF):
            return self.data
        raise OptionError("modes were measured; this takes FRFs")

    @property
    def plain(self) -> bool:
        """Whether all labels are those of the model, no DOF was rotated, and there is no note."""
        same = all(m.sensor == m.dof and not m.turned and not m.note for m in self.table)
        return same and self.by == "label" and not self.notes

    def __str__(self) -> str:
        if not self.table:
            return "Without shapes there are no sensors to match."
        lines = [
            f"Matched by {self.by}: {len(self.table)} sensors and forces are DOFs of the model"
        ]
        if self.alignment is not None:
            lines.append(str(self.alignment))
        distances = np.array([m.distance for m in self.table])
        known = distances[np.isfinite(distances)]
        if known.size:
            rms = _metres(float(np.sqrt(np.mean(known**2))))
            text = f"Distances: rms {rms} m, largest {_metres(float(known.max()))} m"
            if self.alignment is None:
                text += ", between the positions of the two geometries as they are"
            lines.append(text)
        lines += self.notes
        header = ["sensor", "is", "DOF", "distance (m)", "angle (deg)", "note"]
        rows = [_cells(m) for m in self.table]
        lines.append(text_table(header, rows, left=(0, 1, 2, 5)))
        return "\n".join(lines)


def _cells(row: SensorMatch) -> list[str]:
    distance = "-"
    if np.isfinite(row.distance):
        distance = _metres(row.distance)
    notes = []
    if row.turned and row.direction:
        notes.append(f"turned along {vector_text(row.direction)}")
    if row.note:
        notes.append(row.note)
    return [row.sensor, row.role, row.dof, distance, f"{row.angle:.3g}", "; ".join(notes)]


def _metres(distance: float) -> str:
    return "0" if distance < 1e-12 else f"{distance:.3g}"


def format_list(items: Sequence[str]) -> str:
    """Return the first items, each on a line, and the number of others."""
    most = SENSOR_PLACEMENT.listed_items
    lines = list(items[:most])
    if len(items) > most:
        lines.append(f"... and {len(items) - most} more")
    return "".join(f"\n  {line}" for line in lines)


def vector_text(vector: Sequence[float] | RealArray) -> str:
    """Return three numbers as text; rounding errors of 0 become 0."""
    v = np.asarray(vector, dtype=np.float64)
    v = np.where(np.abs(v) < 5e-13, 0.0, v)
    return "(" + ", ".join(f"{x:.4g}" for x in v) + ")"
