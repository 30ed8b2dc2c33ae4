"""Element matrices of beams, trusses and shells from pyfe3d, which only this module imports.

Relevant properties of pyfe3d 0.11 (each has a test):

- Every property is 0 until it is set: A, Iyy, Izz, the shear modulus, and the densities ``intrho``,
  ``intrhoy2``, ``intrhoz2``.
- The orientation vector of a beam lies in its local xy plane; Izz is for bending in that plane.
- No shear coefficient is applied: it is part of G12 and G13, and then G J is set separately.
- Values are added to what the arrays hold, so that they start at 0.
- Four-node shells have a shear strain at the centre only, and with it two spurious modes without
  energy: their shear stiffness is left out here and computed in `updyn.elements.structure.shells`.
- A rigid rotation strains warped quadrilaterals: only flat ones are computed here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.elements.settings import ELEMENT
from updyn.errors import ModelError

__all__ = ["beam_matrices", "plate_matrices", "truss_matrices"]

_INDEX = np.dtype("l")  # C long, the type of indices in pyfe3d


def _library() -> Any:
    try:
        import pyfe3d
        import pyfe3d.beamprop
        import pyfe3d.shellprop_utils
    except ImportError as error:
        raise ModelError(
            'beams, trusses and shells need pyfe3d: pip install "updyn[structures]"'
        ) from error
    return pyfe3d


def beam_matrices(
    section: Any,
    E: float,
    G: float,
    rho: float,
    vectors: RealArray,
    ends: RealArray,
) -> tuple[RealArray, RealArray]:
    """Return stiffness and consistent mass of beams in global axes, each shape (m, 12, 12), in SI.

    `vectors` (m, 3) lie in the local xy planes.
    """
    # Timoshenko beams with the displacement functions of static equilibrium (Luo, Adv. Theor.
    # Appl. Mech. 1 (2008) 95; Petyt, Introduction to Finite Element Vibration Analysis, 2nd ed.
    # 2010, section 3.9).
    fe = _library()
    prop = fe.beamprop.BeamProp()
    prop.A = section.A
    prop.E = E
    prop.Iyy = section.Iyy
    prop.Izz = section.Izz
    prop.J = section.J
    prop.GJ = G * section.J
    prop.G12 = _shear_modulus(section.shear_y, E, G)
    prop.G13 = _shear_modulus(section.shear_z, E, G)
    prop.intrho = rho * section.A
    prop.intrhoy2 = rho * section.Izz
    prop.intrhoz2 = rho * section.Iyy
    element = fe.BeamC(fe.BeamCProbe())
    _place_dofs(element, 2)

    def place(i: int) -> None:
        x = np.ascontiguousarray(ends[i]).ravel()
        element.update_rotation_matrix(*vectors[i], x)
        element.update_probe_xe(x)

    return _collect(element, prop, fe.BeamCData(), place, len(ends), 12)


def _shear_modulus(coefficient: float | None, E: float, G: float) -> float:
    return ELEMENT.rigid_shear_ratio * E if coefficient is None else coefficient * G


def truss_matrices(A: float, E: float, rho: float, ends: RealArray) -> tuple[RealArray, RealArray]:
    """Return stiffness and consistent mass of bars, each shape (m, 6, 6), in SI."""
    fe = _library()
    prop = fe.beamprop.BeamProp()
    prop.A = A
    prop.E = E
    prop.intrho = rho * A
    element = fe.Truss(fe.TrussProbe())
    _place_dofs(element, 2)

    def place(i: int) -> None:
        x = np.ascontiguousarray(ends[i]).ravel()
        element.update_rotation_matrix(x)
        element.update_probe_xe(x)

    K, M = _collect(element, prop, fe.TrussData(), place, len(ends), 12)
    translations = np.array([0, 1, 2, 6, 7, 8])
    return K[:, translations[:, None], translations], M[:, translations[:, None], translations]


def plate_matrices(
    what: str, thickness: float, E: float, nu: float, rho: float, local: RealArray
) -> tuple[RealArray, RealArray]:
    """Return stiffness and mass of flat shells in local axes, shape (m, 6 k, 6 k), in SI."""
    # First-order shear deformation theory, drilling after Allman (1984) and Hughes & Brezzi
    # (1989). Triangles have the transverse shear of the discrete shear gap; quadrilaterals have
    # none here. The third coordinate of `local` is 0.
    fe = _library()
    try:
        prop = fe.shellprop_utils.isotropic_plate(thickness, E, nu, rho=rho)
    except ValueError as error:
        raise ModelError(f"{what}: thickness, E and nu give no plate ({error})") from error
    count, k = local.shape[:2]
    if k == 4:
        prop.A44 = 0.0
        prop.A45 = 0.0
        prop.A55 = 0.0
        element, data = fe.Quad4(fe.Quad4Probe()), fe.Quad4Data()
    else:
        element, data = fe.Tria3DSG(fe.Tria3DSGProbe()), fe.Tria3DSGData()
    _place_dofs(element, k)

    def place(i: int) -> None:
        x = np.ascontiguousarray(local[i]).ravel()
        element.update_rotation_matrix(x)
        element.update_probe_xe(x)

    return _collect(element, prop, data, place, count, 6 * k)


def _place_dofs(element: Any, n_nodes: int) -> None:
    """Set the first row of each node in the matrices of the element."""
    for i in range(n_nodes):
        setattr(element, f"c{i + 1}", 6 * i)


def _collect(
    element: Any, prop: Any, data: Any, place: Callable[[int], None], count: int, size: int
) -> tuple[RealArray, RealArray]:
    """Return K and M, shape (count, size, size), of one element object moved to each place."""
    K = _full(element.update_KC0, data.KC0_SPARSE_SIZE, prop, place, count, size)
    M = _full(element.update_M, data.M_SPARSE_SIZE, prop, place, count, size)
    return K, M


def _full(
    update: Any, length: int, prop: Any, place: Callable[[int], None], count: int, size: int
) -> RealArray:
    rows = np.zeros(length, dtype=_INDEX)
    columns = np.zeros(length, dtype=_INDEX)
    values = np.zeros((count, length))
    for i in range(count):
        place(i)
        update(rows, columns, values[i], prop)
    position = rows * size + columns
    used = values.any(axis=0)
    if len(np.unique(position[used])) < int(used.sum()):
        raise AssertionError("an entry of the element occurs twice")
    flat = np.zeros((count, size * size))
    flat[:, position[used]] = values[:, used]
    A = flat.reshape(count, size, size)
    return np.asarray(0.5 * (A + A.transpose(0, 2, 1)))  # differs from A by rounding only
