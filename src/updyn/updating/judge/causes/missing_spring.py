"""A spring that the model lacks."""

from __future__ import annotations

from typing import ClassVar

from updyn.updating.judge.causes.missing_element import MissingElement

__all__ = ["MissingSpring"]


class MissingSpring(MissingElement):
    """A spring of `value` N/m at a DOF, or between two, that the model lacks."""

    __slots__ = ()

    kind: ClassVar[str] = "missing-spring"
    unit: ClassVar[str] = "N/m"
    quantity: ClassVar[str] = "stiffness"
    noun: ClassVar[str] = "spring"
    units: ClassVar[tuple[str, str]] = ("N/m", "N m/rad")
    #: Loss factor between that of steel springs (up to 0.01) and of bolted joints and rubber
    #: (0.05).
    loss: ClassVar[float] = 0.02
