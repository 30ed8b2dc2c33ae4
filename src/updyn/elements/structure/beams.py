"""Beams with their sections, and trusses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from updyn.arrays import IntArray, RealArray
from updyn.elements.checks import (
    check_connectivity,
    check_keys,
    check_material,
    check_number,
    check_poisson_ratio,
    check_positive,
    check_vector,
    field_names,
    set_fields,
)
from updyn.elements.settings import ELEMENT
from updyn.elements.structure import pyfe
from updyn.elements.structure.element import TRANSLATIONS, Element, ElementMatrices
from updyn.errors import ModelError, suggest

__all__ = ["Beam", "Section", "Truss", "rectangle", "section_from_table", "tube"]


# -- sections
@dataclass(frozen=True, slots=True)
class Section:
    """Cross-section of a beam about its centroid, which is also its shear centre.

    Parameters
    ----------
    A : float
        Area in m2.
    Iyy, Izz : float
        Second moments of area about the local y and z axes, in m4: the integrals of z^2 and of
        y^2. Izz bends the beam in its local xy plane (the plane of the orientation vector), Iyy in
        its xz plane. The rotary inertia about x is rho (Iyy + Izz) per length.
    J : float
        Torsion constant in m4: the torsional stiffness is G J. J = Iyy + Izz only for round
        sections.
    shear_y, shear_z : float, optional
        Effective over true shear area along local y and z; by default no shear deformation
        (Euler-Bernoulli).

    Raises
    ------
    ModelError
        If a number is not above 0.
    """

    A: float
    Iyy: float
    Izz: float
    J: float
    shear_y: float | None = None
    shear_z: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            set_fields(self, **{field.name: check_positive("section", field.name, value)})

    @property
    def is_round(self) -> bool:
        """Whether both bending planes are equal, so no orientation is needed."""
        equal = math.isclose(self.Iyy, self.Izz, rel_tol=ELEMENT.rounding)
        return equal and self.shear_y == self.shear_z

    @property
    def exchanged(self) -> Section:
        """The section rotated by 90 degrees about its centroid."""
        return Section(self.A, self.Izz, self.Iyy, self.J, self.shear_z, self.shear_y)


def rectangle(height: float, width: float, nu: float = 0.3) -> Section:
    """Return a solid rectangular section.

    Parameters
    ----------
    height : float
        Along local y, in m.
    width : float
        Along local z, in m.
    nu : float
        Poisson's ratio, for the shear coefficient.

    Returns
    -------
    Section
        J by the series of Timoshenko & Goodier (Theory of Elasticity, 3rd ed. 1970, section 109),
        shear coefficient 10 (1 + nu) / (12 + 11 nu) (Cowper, J. Applied Mechanics 33 (1966) 335).

    Raises
    ------
    ModelError
        If a length is not above 0, or nu is not above -1 and at most 0.5.
    """
    h = check_positive("rectangle", "height", height)
    w = check_positive("rectangle", "width", width)
    check_poisson_ratio("rectangle", nu)
    a = max(h, w)
    b = min(h, w)
    series = sum(math.tanh(n * math.pi * a / (2 * b)) / n**5 for n in range(1, 40, 2))
    J = a * b * b * b / 3 * (1 - 192 / math.pi**5 * b / a * series)
    kappa = 10 * (1 + nu) / (12 + 11 * nu)
    return Section(h * w, h * w * w * w / 12, w * h * h * h / 12, J, kappa, kappa)


def tube(outer: float, inner: float = 0.0, nu: float = 0.3) -> Section:
    """Return the section of a round tube or a round bar.

    Parameters
    ----------
    outer, inner : float
        Diameters in m; inner 0 for a solid bar.
    nu : float
        Poisson's ratio, for the shear coefficient.

    Returns
    -------
    Section
        Shear coefficient of Cowper, J. Applied Mechanics 33 (1966) 335, table 1, hollow circle.

    Raises
    ------
    ModelError
        If the outer diameter is not above the inner one, or nu is not above -1 and at most 0.5.
    """
    D = check_positive("tube", "outer", outer)
    d = check_number("tube", "inner", inner)
    if not 0 <= d < D:
        raise ModelError(
            f"tube: inner diameter {inner!r}; expected at least 0 and below the outer one,"
            f" {outer!r} m"
        )
    v = check_poisson_ratio("tube", nu)
    m = (d / D) ** 2
    kappa = 6 * (1 + v) * (1 + m) ** 2 / ((7 + 6 * v) * (1 + m) ** 2 + (20 + 12 * v) * m)
    second = math.pi * (D * D + d * d) * (D * D - d * d) / 64
    return Section(math.pi * (D * D - d * d) / 4, second, second, 2 * second, kappa, kappa)


#: Functions of the shapes, with their required and optional arguments.
_SHAPES: dict[str, tuple[Callable[..., Section], list[str], list[str]]] = {
    "rectangle": (rectangle, ["height", "width"], ["nu"]),
    "tube": (tube, ["outer"], ["inner", "nu"]),
}


def section_from_table(where: str, given: object) -> Section:
    """Return the section of a beam from a table: its fields, or ``shape`` and dimensions."""
    if not isinstance(given, Mapping):
        raise ModelError(f"{where}: section {given!r}; expected a table")
    if "shape" not in given:
        names, required = field_names(Section)
        check_keys(f"{where}: section", given, required, names)
        return Section(**given)
    sizes = dict(given)
    shape = sizes.pop("shape")
    if not isinstance(shape, str) or shape not in _SHAPES:
        raise ModelError(f"{where}: section.shape {shape!r}: {suggest(str(shape), _SHAPES)}")
    make, required, optional = _SHAPES[shape]
    check_keys(f"{where}: section, a {shape}", sizes, required, optional)
    return make(**sizes)


# -- elements
@dataclass(frozen=True, slots=True, eq=False)
class Beam(Element):
    """Straight two-node beams of one section and material, with bending, axial force and torsion.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 2)
        Node numbers of each element; local x runs from the first to the second.
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    section : Section
        Area, second moments, torsion constant, shear coefficients.
    nu : float
        Poisson's ratio, for G = E / (2 (1 + nu)).
    G : float, optional
        Shear modulus in Pa, in place of the value from `nu`.
    orientation : array_like of float, shape (3,), optional
        A vector in the local xy plane, in global components; not parallel to an element. Optional
        if both bending planes are equal.
    loss_factor : float
        Structural loss factor.

    Raises
    ------
    ModelError
        If a number is out of range, or the orientation is missing although the bending planes
        differ.
    """

    name: str
    connectivity: Any
    E: float
    rho: float
    section: Section
    nu: float = 0.3
    G: float | None = None
    orientation: Any = None
    loss_factor: float = 0.0

    def __post_init__(self) -> None:
        what = self.label
        nodes = check_connectivity(what, self.connectivity, (2,))
        set_fields(self, connectivity=nodes, **check_material(what, self))
        if not isinstance(self.section, Section):
            raise ModelError(
                f"{what}: section {self.section!r}; expected a Section, rectangle(...) or tube(...)"
            )
        if self.orientation is not None:
            set_fields(self, orientation=check_vector(what, "orientation", self.orientation))
        elif not self.section.is_round:
            raise ModelError(
                f"{what}: an orientation (a vector in its local xy plane) is needed,"
                " as its bending planes differ"
            )

    @property
    def shear_modulus(self) -> float:
        """G in Pa."""
        return self.E / (2 * (1 + self.nu)) if self.G is None else self.G

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute stiffness and consistent mass of given beams."""
        _check_length(self.label, numbers, xyz)
        vectors = self._vectors_in_plane(numbers, xyz)
        K, M = pyfe.beam_matrices(self.section, self.E, self.shear_modulus, self.rho, vectors, xyz)
        return ElementMatrices(K, M if self.rho else None)

    def _vectors_in_plane(self, numbers: IntArray, ends: RealArray) -> RealArray:
        """Return a vector in the local xy plane of each beam, shape (m, 3).

        Without an orientation, both bending planes are equal, and any vector across the beam can be
        used.
        """
        along = ends[:, 1] - ends[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        if self.orientation is None:
            return np.asarray(np.eye(3)[np.argmin(np.abs(along), axis=1)])
        v = self.orientation / np.linalg.norm(self.orientation)
        parallel = np.linalg.norm(np.cross(along, v), axis=1) < ELEMENT.parallel_sine
        if parallel.any():
            nodes = numbers[int(np.argmax(parallel))].tolist()
            raise ModelError(
                f"{self.label}: the orientation {self.orientation.tolist()} is parallel to the"
                f" element of nodes {nodes}; expected a vector across it"
            )
        return np.tile(v, (len(ends), 1))

    def edges(self) -> IntArray:
        """Return the axes of the beams."""
        return np.asarray(self.connectivity)

    def with_exchanged_axes(self) -> Self | None:
        """Return the beams with exchanged section axes; None if both bending planes are equal.

        An orientation rotated by 90 degrees about the beams gives the same matrices.
        """
        return None if self.section.is_round else replace(self, section=self.section.exchanged)

    def orientation_turned(self, xyz: RealArray) -> str:
        """Return the orientation rotated by 90 degrees about the beams, as text."""
        turned = self._orientation_across(xyz)
        if turned is None:
            return "its orientation by 90 degrees about the beams"
        now, then = ([float(f"{x:.6g}") for x in v] for v in (self.orientation, turned))
        return f"its orientation by 90 degrees: {then} in place of {now}"

    def _orientation_across(self, xyz: RealArray) -> RealArray | None:
        """Return the orientation rotated by 90 degrees about parallel beams, else None."""
        along = xyz[:, 1] - xyz[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        least_cosine = 1.0 - ELEMENT.parallel_sine
        if self.orientation is None or (np.abs(along @ along[0]) < least_cosine).any():
            return None
        across = np.cross(along[0], self.orientation)
        across = across / np.linalg.norm(across)
        return np.asarray(np.where(np.abs(across) < ELEMENT.parallel_sine, 0.0, across))

    @classmethod
    def fields_of_row(cls, where: str, row: Mapping[str, object]) -> Mapping[str, object]:
        """Convert the table ``section`` to a `Section`."""
        if "section" not in row:
            return row
        return {**row, "section": section_from_table(where, row["section"])}


@dataclass(frozen=True, slots=True, eq=False)
class Truss(Element):
    """Straight two-node bars with axial stiffness only, hinged at their nodes.

    Parameters
    ----------
    name : str
        Group name; parts of the same name form one group.
    connectivity : array_like of int, shape (m, 2)
        Node numbers of each bar.
    E, rho : float
        Young's modulus in Pa and density in kg/m3 (0: without mass).
    A : float
        Area in m2.
    loss_factor : float
        Structural loss factor.

    Raises
    ------
    ModelError
        If a number is out of range.
    """

    name: str
    connectivity: Any
    E: float
    rho: float
    A: float
    loss_factor: float = 0.0

    directions: ClassVar[tuple[int, ...]] = TRANSLATIONS

    def __post_init__(self) -> None:
        what = self.label
        nodes = check_connectivity(what, self.connectivity, (2,))
        set_fields(self, connectivity=nodes, **check_material(what, self))
        set_fields(self, A=check_positive(what, "A", self.A))

    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute stiffness and consistent mass of given bars."""
        _check_length(self.label, numbers, xyz)
        K, M = pyfe.truss_matrices(self.A, self.E, self.rho, xyz)
        return ElementMatrices(K, M if self.rho else None)

    def edges(self) -> IntArray:
        """Return the axes of the bars."""
        return np.asarray(self.connectivity)


def _check_length(what: str, numbers: IntArray, ends: RealArray) -> None:
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if not length.all():
        nodes = numbers[int(np.argmin(length))].tolist()
        raise ModelError(f"{what}: the element of nodes {nodes} has no length: its nodes coincide")
