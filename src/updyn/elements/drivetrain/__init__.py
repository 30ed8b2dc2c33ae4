"""Torsional drive trains: parts, models, reflected quantities, and coupling to a structure."""

from __future__ import annotations

from updyn.elements.drivetrain.build import (
    drivetrain,
    drivetrain_from_table,
    mounted,
    ratio_questions,
)
from updyn.elements.drivetrain.gears import Belt, DualDrive, GearPair, Planetary, Worm
from updyn.elements.drivetrain.pieces import PARTS, Part
from updyn.elements.drivetrain.reflection import Reflected, ReflectedPart, reflected
from updyn.elements.drivetrain.shafts import Brake, Coupling, Ground, Inertia, Motor, Shaft

__all__ = [
    "PARTS",
    "Belt",
    "Brake",
    "Coupling",
    "DualDrive",
    "GearPair",
    "Ground",
    "Inertia",
    "Motor",
    "Part",
    "Planetary",
    "Reflected",
    "ReflectedPart",
    "Shaft",
    "Worm",
    "drivetrain",
    "drivetrain_from_table",
    "mounted",
    "ratio_questions",
    "reflected",
]
