"""Results of a matching: the model, the renamed measurement, and the table of sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DofError, OptionError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.text_table import text_table

__all__ = [
    "EXACT",
    "SHOWN",
    "Alignment",
    "MatchError",
    "Matching",
    "SensorMatch",
    "listed",
    "vector_text",
]

#: Degrees within which a direction counts as along a DOF, and two directions as one.
EXACT = 0.1
#: Items that a message lists.
SHOWN = 8


class MatchError(DofError):
    """Sensors that cannot be matched to the model.

    Parameters
    ----------
    message : str
        What was found, what was expected, and the nearest candidates.
    key : tuple of str
        Argument of `match`, and key in it, that the error is about; empty: the measurement.
    lost : sequence of str
        The sensors, as the test labels them, that are no DOFs of the model.
    proposal : mapping of str to object
        Options of `match` with which nodes are found by their positions; empty if unknown.
    """

    def __init__(
        self,
        message: str,
        key: tuple[str, ...] = (),
        lost: Sequence[str] = (),
        proposal: Mapping[str, Any] | None = None,
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
        How it was found, in words.
    rotation : ndarray of float, shape (3, 3)
        A rotation, no reflection.
    shift : ndarray of float, shape (3,)
        In m.
    factor : float
        Metres of the unit of the test's positions.
    unit : str or None
        Its name, as stated; None: nothing was stated and m is assumed.
    residual : float or None
        Root mean square distance in m of the points that were fitted on each other; None where
        nothing was fitted.
    """

    how: str
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]
    factor: float = 1.0
    unit: str | None = None
    residual: float | None = None

    @property
    def turn(self) -> float:
        """Angle of the rotation in degrees."""
        skew = self.rotation - self.rotation.T
        sine = np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2.0
        return float(np.degrees(np.arctan2(sine, (np.trace(self.rotation) - 1.0) / 2.0)))

    def apply(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
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
    """One sensor, force, or both at one place.

    Attributes
    ----------
    sensor : str
        Label in the measurement, without sign.
    role : {"response", "reference", "response and reference"}
        Its role in the measurement.
    dof : str
        Label in the model, with the sign of the sensor's direction.
    distance : float
        Between the two nodes, in m; nan where positions are not known.
    angle : float
        Degrees between the sensor and the DOF of that name in the model before the matching.
    turned : bool
        Whether that DOF has been turned, so that it now lies along the sensor.
    direction : tuple of three float or None
        The sensor's direction, of length 1, in the axes of the model; None: as its label says.
    note : str
        Remark, such as another node that is nearly as near.
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
        The model; at nodes with oblique sensors its DOFs have been turned along them.
    data : FRF or ModeSet
        The measurement, named as the model names its DOFs.
    table : tuple of SensorMatch
        One entry a sensor or force, in the order of the measurement.
    by : {"label", "coordinates"}
        How nodes were found.
    alignment : Alignment or None
        How positions were moved onto the model; by label None, unless the positions of equal labels
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
        """Whether every label is that of the model, no DOF was turned, and there is no note."""
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


def listed(items: Sequence[str], indent: str = "\n  ") -> str:
    """Return up to `SHOWN` items, each on a line, and how many more there are."""
    lines = list(items[:SHOWN])
    if len(items) > SHOWN:
        lines.append(f"... and {len(items) - SHOWN} more")
    return indent + indent.join(lines)


def vector_text(vector: Sequence[float] | NDArray[np.float64]) -> str:
    """Return three numbers as text; rounding errors of 0 are 0."""
    v = np.asarray(vector, dtype=np.float64)
    v = np.where(np.abs(v) < 5e-13, 0.0, v)
    return "(" + ", ".join(f"{x:.4g}" for x in v) + ")"
