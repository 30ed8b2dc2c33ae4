"""Structures in space: beams, trusses, springs, shells, solids, masses and rigid links over kept libraries."""

from updyn.elements.constraints import Equation
from updyn.elements.structure.build import structure
from updyn.elements.structure.parts import Beam, PointMass, RigidLink, Shell, Solid, Spring, Truss
from updyn.elements.structure.sections import Section, rectangle, tube
from updyn.elements.structure.table import structure_from_table

__all__ = [
    "Beam",
    "Equation",
    "PointMass",
    "RigidLink",
    "Section",
    "Shell",
    "Solid",
    "Spring",
    "Truss",
    "rectangle",
    "structure",
    "structure_from_table",
    "tube",
]
