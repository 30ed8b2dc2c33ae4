"""Numbers that decide how elements, constraints and drive trains are checked and assembled."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ElementSettings:
    """Tolerances and defaults of elements."""

    #: [1] Relative difference up to which positions, directions and coefficients are equal. Why:
    #: 1e7 times the rounding of a number, but less than the resolution of positions.
    rounding: float = 1e-9
    #: [1] Share of the largest entry below which an entry of rotated axes is zero. Rounding:
    #: rounding of sines and cosines; such an entry would couple DOFs.
    rotation_rounding: float = 1e-12
    #: [1] Sine of the angle between a beam and its orientation below which they are parallel. Why:
    #: below it, the axes have less than ten digits.
    parallel_sine: float = 1e-6
    #: [1] Shear modulus over Young's modulus of a beam that is rigid in shear. Rounding: 1e10
    #: leaves six digits of the stiffness in bending.
    rigid_shear_ratio: float = 1e10
    #: [1] Distance of a node from the plane of a shell, relative to its size, from which a warning
    #: is given. Why: a rule of thumb for flat elements.
    warned_warp: float = 0.1
    #: [elements] Elements of a beam without a given number. Why: the error of 10 bending modes is
    #: then far below that of measurements.
    beam_elements: int = 100
    #: [entries] Entries of element matrices that are computed at once. Effort: 8 MB, for calls of
    #: few large arrays.
    entries_at_once: int = 1_000_000
    #: [entries] Entries of element matrices that are collected before summation. Effort: 64 MB with
    #: their indices.
    pending_entries: int = 4_000_000


@dataclass(frozen=True)
class TrainSettings:
    """Checks of drive trains."""

    #: [1] Largest residual of a solvable equation between unit rotations. Rounding: far above
    #: rounding and far below 1, the residual of an unsolvable one.
    solvable_residual: float = 1e-6
    #: [Hz] Lowest plausible natural frequency of a drive train. Why: a telescope of 100 m is
    #: modelled by its modes up to 2 Hz (Ranka et al., J. Astron. Telesc. Instrum. Syst. 2 (2016)
    #: 014001).
    lowest_frequency: float = 0.01
    #: [Hz] Highest plausible natural frequency of a drive train. Why: at 10 kHz a shear wave in
    #: steel, with a speed of sqrt(G / rho) = 3.2 km/s (Timoshenko, Vibration Problems in
    #: Engineering), has a length of 0.32 m, so wheels and shafts are no longer lumped inertias.
    highest_frequency: float = 1e4
    #: [1] Factor on both ends of the band of a test. Why: the stiffness of the start may be wrong
    #: by a factor of four.
    band_factor: float = 2.0
    #: [DOFs] Largest train whose ratios are examined. Effort: a fraction of a second for each
    #: ratio.
    examined_dofs: int = 300


ELEMENT = ElementSettings()
TRAIN = TrainSettings()
