"""Numbers that decide which DOF of the model a sensor measures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SensorDirectionSettings:
    """Numbers of the directions of sensors."""

    #: [degrees] Angle within which a direction is along a DOF, or two directions are equal. Why:
    #: the error 1 - cos(angle) is 1.5e-6; directions in files have this accuracy.
    exact_angle: float = 0.1
    #: [degrees] As `exact_angle`, if the rotation was fitted to positions. Why: accuracy of such a
    #: rotation; a rule of thumb.
    fitted_angle: float = 1.0
    #: [degrees] Angle from a DOF up to which a message suggests the option `angle`. Why: an error
    #: of 1.5 % of the response; a rule of thumb.
    suggested_angle: float = 10.0
    #: [degrees] Least angle between the directions of two DOFs of a node. Why: the difference of
    #: two such sensors is 60 times smaller than either; a rule of thumb.
    smallest_angle: float = 1.0
    #: [1] Least singular value of the directions at a node. Why: rotated DOFs would amplify errors
    #: a hundred times.
    least_singular_value: float = 0.01
    #: [1] Largest deviation of orthonormal directions. Why: the tolerance of `Geometry` on its
    #: axes.
    orthonormal_error: float = 5e-5
    #: [1] Weight of the direction in the label of a sensor if axes are equally near. Why: above the
    #: rounding of closeness to nine digits, and below any relevant difference.
    label_weight: float = 1e-6
    #: [1] Largest difference of equal axes of a node. Why: rounding.
    axes_difference: float = 1e-9


@dataclass(frozen=True)
class SensorPlacementSettings:
    """Numbers of the positions of sensors."""

    #: [1] Two nodes are equally near if their distances differ by less than this share of the size
    #: of the model. Why: digits of positions in files.
    equal_distance: float = 1e-6
    #: [1] Ratio of the distance of the second node to that of the nearest, below which a note names
    #: it. Why: a rule of thumb.
    noted_distance_ratio: float = 2.0
    #: [1] Relative difference of scale between pairs of nodes that a message mentions. Why: larger
    #: than errors of hand measurement; a rule of thumb.
    noted_scale: float = 0.02
    #: [1] Largest deviation of a rotation matrix from orthogonality, and of its scale from 1. Why:
    #: digits of matrices in files.
    rotation_error: float = 1e-6
    #: [steps] Largest number of steps of the fit to nearest nodes. Effort: the fit ends when the
    #: nearest nodes no longer change.
    most_steps: int = 200
    #: [items] Number of items that a message lists. Why: chosen for a readable message.
    listed_items: int = 8


SENSOR_DIRECTION = SensorDirectionSettings()
SENSOR_PLACEMENT = SensorPlacementSettings()
