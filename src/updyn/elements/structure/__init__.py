"""Structures in space: beams, trusses, springs, shells, solids, masses and rigid links."""

from updyn.elements.constraints import Equation, RigidLink
from updyn.elements.structure.beams import Beam, Section, Truss, rectangle, tube
from updyn.elements.structure.build import structure, structure_from_table
from updyn.elements.structure.element import ELEMENTS, Element, ElementMatrices
from updyn.elements.structure.shells import Shell
from updyn.elements.structure.solids import Solid
from updyn.elements.structure.springs import PointMass, Spring

__all__ = [
    "ELEMENTS",
    "Beam",
    "Element",
    "ElementMatrices",
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
