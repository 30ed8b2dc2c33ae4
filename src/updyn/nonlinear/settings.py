"""Numbers of the describing functions of nonlinear elements."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DescribingSettings:
    """Inversion of describing functions."""

    #: [steps] Bisections that invert a describing function. Rounding: 2^-52 is the rounding of a
    #: double.
    bisections: int = 52
    #: [1] Smallest ratio of half gap to amplitude; larger amplitudes are not predicted. Rounding:
    #: the describing function then equals that of the mesh without gap to 1e-9.
    least_gap_ratio: float = 1e-9


DESCRIBING = DescribingSettings()
