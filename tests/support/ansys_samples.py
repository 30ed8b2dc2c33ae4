"""Files of Ansys for the tests: those that ansys-mapdl-reader ships, and an ``.emat`` made here of the same beam.

The package (MIT licence, copyright Ansys, Inc. and contributors) ships ``file.full`` and
``file.rst`` of one beam of 40 SOLID186 elements, solved by release 15.0: the ``.full`` with one end
held, the ``.rst`` free. It ships no ``.emat``. The one here is laid out as fdemat.inc describes it,
with element matrices computed by textbook formulas that are known to be those of SOLID186 (uniform
reduced integration for K, the 14-point rule for M): added up they are the matrices of
``file.full``, and their frequencies are those of ``file.rst``; tests hold them to that."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

CORNERS = [
    (-1, -1, -1),
    (1, -1, -1),
    (1, 1, -1),
    (-1, 1, -1),
    (-1, -1, 1),
    (1, -1, 1),
    (1, 1, 1),
    (-1, 1, 1),
]
MIDDLES = [
    (0, -1, -1),
    (1, 0, -1),
    (0, 1, -1),
    (-1, 0, -1),
    (0, -1, 1),
    (1, 0, 1),
    (0, 1, 1),
    (-1, 0, 1),
]
UPRIGHT = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
POINTS = np.array(CORNERS + MIDDLES + UPRIGHT, dtype=float)
#: Monomials of the serendipity brick: no more than one square in each.
POWERS = np.array([p for p in product(range(3), repeat=3) if sum(e == 2 for e in p) <= 1])


def monomials(at):
    return np.prod(np.asarray(at, dtype=float) ** POWERS, axis=1)


def slopes(at):
    out = np.zeros((3, 20))
    for axis in range(3):
        lower = POWERS.copy()
        lower[:, axis] = np.maximum(lower[:, axis] - 1, 0)
        out[axis] = POWERS[:, axis] * np.prod(np.asarray(at, dtype=float) ** lower, axis=1)
    return out


SHAPES = np.linalg.solve(np.array([monomials(p) for p in POINTS]), np.eye(20))
#: Gauss, 2 x 2 x 2; and Irons' 14 points (Irons 1971, "Quadrature rules for brick based finite
#: elements").
GAUSS = [(np.array(p) / np.sqrt(3.0), 1.0) for p in product((-1, 1), repeat=3)]
IRONS = [
    (s * np.sqrt(19.0 / 30.0) * np.eye(3)[axis], 320.0 / 361.0)
    for axis in range(3)
    for s in (-1, 1)
]
IRONS += [(np.array(p) * np.sqrt(19.0 / 33.0), 121.0 / 361.0) for p in product((-1, 1), repeat=3)]


def brick(xyz, E, nu, rho):
    """Return K and M, (60, 60), of a 20-node brick in Ansys's order of nodes."""
    shear = E / (2.0 * (1.0 + nu))
    D = np.diag([2.0 * shear] * 3 + [shear] * 3)
    D[:3, :3] += E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    K, M = np.zeros((60, 60)), np.zeros((20, 20))
    for at, weight in GAUSS:
        slope = slopes(at) @ SHAPES
        jacobian = slope @ xyz
        d = np.linalg.solve(jacobian, slope)
        B = np.zeros((6, 60))
        for row, (axis, along) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]):
            B[row, axis::3] += d[along]
            if axis != along:
                B[row, along::3] += d[axis]
        K += weight * np.linalg.det(jacobian) * B.T @ D @ B
    for at, weight in IRONS:
        N = monomials(at) @ SHAPES
        M += weight * np.linalg.det(slopes(at) @ SHAPES @ xyz) * rho * np.outer(N, N)
    return K, np.kron(M, np.eye(3))


def beam_elements(mesh, E, nu, rho):
    """Yield number, nodes, K and M of the elements of the beam that the package ships."""
    xyz = dict(zip(mesh.nnum.tolist(), np.asarray(mesh.nodes), strict=True))
    for number, row in zip(mesh.enum.tolist(), mesh.elem, strict=True):
        nodes = [int(n) for n in row[10:30]]
        yield number, nodes, *brick(np.array([xyz[n] for n in nodes]), E, nu, rho)


# -- writing -----------------------------------------------------------------------------------------------
def record(values, kind="i"):
    """Return one record: its length in words, flags, the words, the length again."""
    body = np.asarray(values, dtype={"i": "<i4", "d": "<f8"}[kind]).tobytes()
    length = struct.pack("<i", len(body) // 4)
    return length + struct.pack("<I", 0x80000000 if kind == "i" else 0) + body + length


def packed(matrix, how):
    """Return the numbers of a matrix as a record holds them."""
    matrix = np.asarray(matrix)
    if how == "rows":
        return matrix[np.tril_indices(len(matrix))]
    if how == "columns":
        return matrix[np.triu_indices(len(matrix))]
    return matrix.ravel() if how == "full" else matrix.diagonal()


def standard_header(kind, unit=0):
    head = np.zeros(100, dtype=int)
    head[0], head[1], head[4] = kind, -1, unit
    head[9] = int.from_bytes(b"15.0", "big")
    return record(head)


def write_emat(
    path: Path,
    elements: Sequence[tuple[int, Sequence[int], Mapping[str, np.ndarray]]],
    *,
    dofs: Sequence[int] = (1, 2, 3),
    how: str | Mapping[str, str] = "rows",
    unit: int = 0,
    internal_equations: int = 0,
) -> None:
    """Write an ``.emat`` of elements (number, nodes, matrices by "stiffness", "mass", "damping", "stress stiffness").

    Rows of a matrix are the degrees of freedom `dofs` of each node in turn.
    """
    kinds = ("stiffness", "mass", "damping", "stress stiffness")
    # Storage order is not the order of the numbers, as in files of the program.
    nodes = sorted({n for _, part, _ in elements for n in part}, key=lambda n: (n % 7, n))
    place = {n: i for i, n in enumerate(nodes)}
    header = np.zeros(40, dtype=int)
    header[:6] = 2, len(elements), len(dofs), len(nodes) * len(dofs), len(nodes), max(nodes)
    header[10], header[11], header[26] = 1, 1, internal_equations
    out = bytearray(standard_header(2, unit) + record(header) + record(np.zeros(20), "d"))
    for at, table in ((30, dofs), (31, nodes), (32, [number for number, _, _ in elements])):
        header[at] = len(out) // 4
        out += record(table)
    header[37], index_at = len(out) // 4, len(out)
    out += record(np.zeros(2 * len(elements)))
    index = np.zeros(2 * len(elements), dtype=int)
    for i, (_, part, matrices) in enumerate(elements):
        index[i] = len(out) // 4
        rows = [place[n] * len(dofs) + k + 1 for n in part for k in range(len(dofs))]
        triangular = how in ("rows", "columns")
        out += record(
            [
                *(int(k in matrices) for k in kinds),
                0,
                0,
                0,
                0,
                0,
                -len(rows) if triangular else len(rows),
            ]
        )
        out += record(rows)
        for kind in kinds:
            if kind in matrices:
                chosen = how if isinstance(how, str) else how.get(kind, "rows")
                out += record(packed(matrices[kind], chosen), "d")
        out += record(np.zeros(2 * len(rows)), "d")  # load vectors: not read
    header[38:] = 0, len(out) // 4
    first = len(standard_header(2))
    out[first : first + len(record(header))] = record(header)
    out[index_at : index_at + len(record(index))] = record(index)
    path.write_bytes(bytes(out))


def write_full(
    path: Path,
    rows: Sequence[tuple[int, Sequence[int]]],
    stiffness: np.ndarray,
    mass: np.ndarray,
    viscous: np.ndarray,
    unit: int = 0,
) -> None:
    """Write a ``.full`` of nodes with their DOF numbers, negative where one is held, and upper triangles."""
    header = np.zeros(80, dtype=int)
    numbers = [number for _, part in rows for number in part]
    header[0], header[1] = -1, len(numbers)
    out = bytearray(standard_header(4, unit) + record(header))
    out += record(sorted({abs(number) for number in numbers}))
    out += record([node for node, _ in rows])
    header[35] = len(out) // 4
    out += record([len(part) for _, part in rows]) + record(numbers)
    for matrix, at, terms in ((stiffness, 18, 8), (mass, 26, 33), (viscous, 28, 34)):
        header[at], header[terms] = len(out) // 4, np.count_nonzero(np.triu(matrix))
        for row in np.triu(matrix):
            columns = np.flatnonzero(row)
            out += record(columns + 1) + record(row[columns], "d")
    header[22] = len(out) // 4
    first = len(standard_header(4))
    out[first : first + len(record(header))] = record(header)
    path.write_bytes(bytes(out))
