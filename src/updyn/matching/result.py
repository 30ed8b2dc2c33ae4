"""What a matching gives back: the model, the renamed measurement, and a table of who sits where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DofError
from updyn.frf import FRF
from updyn.model import Model

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
#: Items that a message names one by one.
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
    """

    def __init__(self, message: str, key: tuple[str, ...] = (), lost: Sequence[str] = ()) -> None:
        super().__init__(message, key=key)
        self.lost = tuple(lost)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How the positions of the test were brought to those of the model: x_model = rotation @ (factor x_test) + shift.

    Attributes
    ----------
    how : str
        In words.
    rotation : ndarray of float, shape (3, 3)
        A turn, no reflection.
    shift : ndarray of float, shape (3,)
        In m.
    factor : float
        Metres of the unit of the test's positions.
    unit : str or None
        Its name, as stated; None: nothing was stated and m is taken.
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
        """Bring positions onto the model.

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
            parts.append(f"rms distance of what was fitted {_metres(self.residual)} m")
        return "; ".join(parts)


@dataclass(frozen=True, slots=True)
class SensorMatch:
    """One sensor, force, or both at one place.

    Attributes
    ----------
    sensor : str
        Label in the measurement, without sign.
    role : {"response", "reference", "response and reference"}
        What it is there.
    dof : str
        Label in the model, with the sign of the sensor's direction.
    distance : float
        Between the two nodes, in m; nan where positions are not known.
    angle : float
        Degrees between the sensor and the DOF of that name in the model as it was given.
    turned : bool
        Whether that DOF has been turned, so that it now lies along the sensor.
    direction : tuple of three float or None
        The sensor's direction, of length 1, in the axes of the model; None: taken from the label.
    note : str
        What else there is to know.
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
    frf : FRF
        The measurement, named as the model names its DOFs.
    table : tuple of SensorMatch
        One entry a sensor or force, in the order of the measurement.
    by : {"label", "coordinates"}
        How nodes were found.
    alignment : Alignment or None
        How positions were brought onto the model; None by label.
    notes : tuple of str
        What should be known of the whole.
    """

    model: Model
    frf: FRF
    table: tuple[SensorMatch, ...]
    by: str
    alignment: Alignment | None = None
    notes: tuple[str, ...] = ()

    @property
    def plain(self) -> bool:
        """Whether every label is that of the model, and nothing was turned or is to be noted."""
        same = all(m.sensor == m.dof and not m.turned and not m.note for m in self.table)
        return same and self.by == "label" and not self.notes

    def __str__(self) -> str:
        lines = [
            f"Matched by {self.by}: {len(self.table)} sensors and forces are DOFs of the model"
        ]
        if self.alignment is not None:
            lines.append(f"{self.alignment}")
        far = np.array([m.distance for m in self.table])
        if np.isfinite(far).any():
            known = far[np.isfinite(far)]
            stand = (
                ""
                if self.alignment is not None
                else ", as the positions of the two geometries stand"
            )
            lines.append(
                f"Distances: rms {_metres(np.sqrt(np.mean(known**2)))} m, largest"
                f" {_metres(known.max())} m{stand}"
            )
        lines += self.notes
        rows = [
            [
                m.sensor,
                m.role,
                m.dof,
                _metres(m.distance) if np.isfinite(m.distance) else "-",
                f"{m.angle:.3g}",
                "; ".join(
                    [
                        *(
                            [f"turned along {vector_text(m.direction)}"]
                            if m.turned and m.direction
                            else []
                        ),
                        *([m.note] if m.note else []),
                    ]
                ),
            ]
            for m in self.table
        ]
        header = ["sensor", "is", "DOF", "distance (m)", "angle (deg)", "note"]
        return "\n".join([*lines, *_columns([header, *rows])])


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    width = [max(len(r[i]) for r in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(w) if i in (3, 4) else cell.ljust(w)
            for i, (cell, w) in enumerate(zip(r, width, strict=True))
        ).rstrip()
        for r in rows
    ]


def _metres(distance: float) -> str:
    return "0" if distance < 1e-12 else f"{distance:.3g}"


def listed(items: Sequence[str], indent: str = "\n  ") -> str:
    """Return up to `SHOWN` items, each on a line of its own, and how many more there are."""
    more = [f"... and {len(items) - SHOWN} more"] if len(items) > SHOWN else []
    return indent + indent.join([*items[:SHOWN], *more])


def vector_text(vector: Sequence[float] | NDArray[np.float64]) -> str:
    """Return three numbers as text."""
    return "(" + ", ".join(f"{0.0 if abs(v) < 5e-13 else v:.4g}" for v in vector) + ")"
