"""The one module that speaks with pyfe3d: element matrices of beams, trusses and shells in global axes.

What has to be known of it (version 0.11; each point has a test):

- Every property is 0 until it is set: A, Iyy, Izz, the shear modulus; the densities ``intrho...``
  too, apart from A, I.
- The orientation vector of a beam lies in its local xy plane; Izz bends it there.
- No shear coefficient is applied: it goes into G12 and G13, and then G J has to be set by itself.
- Values are added to what the arrays hold, so that they have to start at 0.
- Four-node shells have a shear strain at the centre only, and with it two motions without energy
  too many: here their shear stiffness is left out and comes from `updyn.elements.structure.shells`.
- Warped quadrilaterals are strained by a turn of the whole: here only flat ones are asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.elements.structure.parts import Beam, Shell, Truss
from updyn.errors import ModelError

__all__ = ["beam_matrices", "plate_matrices", "truss_matrices"]

_RIGID_IN_SHEAR = (
    1e10  # shear modulus over E that stands for none: its flexibility is lost in rounding
)
_INDEX = np.dtype("l")  # C long, which pyfe3d takes for indices


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
    part: Beam, ends: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness and consistent mass of beams, each shape (m, 12, 12), in N/m, N, N m and kg, kg m, kg m2.

    Timoshenko beams with the displacement functions of static equilibrium (Luo, Adv. Theor. Appl.
    Mech. 1 (2008) 95; Petyt, Introduction to Finite Element Vibration Analysis, 2nd ed. 2010,
    section 3.9).

    Parameters
    ----------
    part : Beam
        Section and material.
    ends : ndarray of float, shape (m, 2, 3)
        Positions of the nodes in m.
    """
    fe = _library()
    s, prop = part.section, fe.beamprop.BeamProp()
    G = part.shear_modulus
    prop.A, prop.E, prop.Iyy, prop.Izz, prop.J = s.A, part.E, s.Iyy, s.Izz, s.J
    prop.G12 = _RIGID_IN_SHEAR * part.E if s.shear_y is None else s.shear_y * G
    prop.G13 = _RIGID_IN_SHEAR * part.E if s.shear_z is None else s.shear_z * G
    prop.GJ = G * s.J
    prop.intrho, prop.intrhoy2, prop.intrhoz2 = part.rho * s.A, part.rho * s.Izz, part.rho * s.Iyy
    element = fe.BeamC(fe.BeamCProbe())
    element.c1, element.c2 = 0, 6
    vectors = orientations(part, ends)

    def place(i: int) -> None:
        x = np.ascontiguousarray(ends[i]).ravel()
        element.update_rotation_matrix(*vectors[i], x)
        element.update_probe_xe(x)

    return _collect(element, prop, fe.BeamCData(), place, len(ends), 12)


def truss_matrices(
    part: Truss, ends: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness and consistent mass of bars, each shape (m, 6, 6), in N/m and kg; no stiffness against turning.

    Parameters
    ----------
    part : Truss
        Area and material.
    ends : ndarray of float, shape (m, 2, 3)
        Positions of the nodes in m.
    """
    fe = _library()
    prop = fe.beamprop.BeamProp()
    prop.A, prop.E, prop.intrho = part.A, part.E, part.rho * part.A
    element = fe.Truss(fe.TrussProbe())
    element.c1, element.c2 = 0, 6

    def place(i: int) -> None:
        x = np.ascontiguousarray(ends[i]).ravel()
        element.update_rotation_matrix(x)
        element.update_probe_xe(x)

    K, M = _collect(element, prop, fe.TrussData(), place, len(ends), 12)
    moved = np.array([0, 1, 2, 6, 7, 8])
    return K[:, moved[:, None], moved], M[:, moved[:, None], moved]


def plate_matrices(
    part: Shell, local: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return stiffness and consistent mass of flat shells in their own plane, each shape (m, 6 k, 6 k).

    First-order shear deformation theory, drilling after Allman (1984) and Hughes & Brezzi (1989).
    Triangles have the transverse shear of the discrete shear gap; quadrilaterals have none here.

    Parameters
    ----------
    part : Shell
        Thickness and material.
    local : ndarray of float, shape (m, k, 3)
        Positions of the 3 or 4 nodes in m, the third of each 0.
    """
    fe = _library()
    try:
        prop = fe.shellprop_utils.isotropic_plate(part.thickness, part.E, part.nu, rho=part.rho)
    except ValueError as error:
        raise ModelError(
            f"shell {part.name!r}: thickness, E and nu give no plate ({error})"
        ) from error
    count, k = local.shape[:2]
    if k == 4:
        prop.A44 = prop.A45 = prop.A55 = 0.0
        element, data = fe.Quad4(fe.Quad4Probe()), fe.Quad4Data()
    else:
        element, data = fe.Tria3DSG(fe.Tria3DSGProbe()), fe.Tria3DSGData()
    for i in range(k):
        setattr(element, f"c{i + 1}", 6 * i)

    def place(i: int) -> None:
        x = np.ascontiguousarray(local[i]).ravel()
        element.update_rotation_matrix(x)
        element.update_probe_xe(x)

    return _collect(element, prop, data, place, count, 6 * k)


def orientations(part: Beam, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a vector in the local xy plane of each beam, shape (m, 3); any across it where both planes are alike.

    Raises
    ------
    ModelError
        If the orientation is parallel to a beam.
    """
    along = ends[:, 1] - ends[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    if part.orientation is None:
        return np.asarray(np.eye(3)[np.argmin(np.abs(along), axis=1)])
    v = part.orientation / np.linalg.norm(part.orientation)
    parallel = np.linalg.norm(np.cross(along, v), axis=1) < 1e-6
    if parallel.any():
        at = int(np.flatnonzero(parallel)[0])
        raise ModelError(
            f"beam {part.name!r}: the orientation {part.orientation.tolist()} is parallel to the"
            f" element of nodes {part.connectivity[at].tolist()}; expected a vector across it"
        )
    return np.tile(v, (len(ends), 1))


def _collect(
    element: Any, prop: Any, data: Any, place: Any, count: int, size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return K and M, shape (count, size, size), of one element object put in each place."""
    out = []
    for method, length in (("update_KC0", data.KC0_SPARSE_SIZE), ("update_M", data.M_SPARSE_SIZE)):
        rows, columns = np.zeros(length, dtype=_INDEX), np.zeros(length, dtype=_INDEX)
        values = np.zeros((count, length))
        update = getattr(element, method)
        for i in range(count):
            place(i)
            update(rows, columns, values[i], prop)
        A = np.zeros((count, size * size))
        where = rows * size + columns
        if len(np.unique(where[values.any(axis=0)])) < int(values.any(axis=0).sum()):
            raise AssertionError("an entry of the element stands twice")
        A[:, where[values.any(axis=0)]] = values[:, values.any(axis=0)]
        full = A.reshape(count, size, size)
        out.append(0.5 * (full + full.transpose(0, 2, 1)))  # rounding only
    return out[0], out[1]
