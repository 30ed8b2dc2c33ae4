"""Natural frequencies by the elements of updyn, by MYSTRAN and by CalculiX, against exact values.

    OMP_NUM_THREADS=1 python benchmarks/elements.py [--reasons]

Prints the table of docs/structures.md, which omits rigid-body modes; with ``--reasons``, the runs
behind the reasons of the differences. Needs MYSTRAN and CalculiX (``ccx``).

References, computed without finite elements:

frame
    Bernoulli-Euler members without rotary inertia, with their dynamic stiffness; frequencies by the
    count of W. H. Wittrick & F. W. Williams, Q. J. Mech. Appl. Math. 24 (1971) 263-284.
plates
    Kirchhoff's plate (0.004 m), and Mindlin's (J. Appl. Mech. 18 (1951) 31-38; 0.06 m) with the
    shear coefficient 5/6, both by Ritz's method with Legendre polynomials.
solid
    Linear elasticity by Ritz's method with Legendre polynomials (W. M. Visscher, A. Migliori, T. M.
    Bell & R. A. Reinert, J. Acoust. Soc. Am. 90 (1991) 2154-2162).
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, cosh, floor, pi, sin, sinh, sqrt
from pathlib import Path

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.polynomial import legendre

import updyn
from updyn.elements.structure import Beam, Section, Shell, Solid, structure
from updyn.errors import UpdynWarning
from updyn.io.nastran.mystran import find_executable
from updyn.model import Model

E, RHO, NU = 2.1e11, 7850.0, 0.3
G = E / (2.0 * (1.0 + NU))
#: Frequencies below this value, in Hz, belong to rigid-body modes.
ELASTIC = 0.5


@dataclass(frozen=True)
class Structure:
    """One structure: its nodes and elements, its exact frequencies in Hz, and its decks.

    `calculix` has the nodes and elements for CalculiX, which may have additional nodes.
    """

    name: str
    exact: np.ndarray
    own: Model
    nastran: list[str]
    calculix: list[str]
    elements: tuple[str, str, str]


# -- meshes ----------------------------------------------------------------------------------------
def lattice(cells: Sequence[int], size: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of a regular mesh, and their numbers from 1 by position."""
    axes = [np.linspace(0.0, s, n + 1) for n, s in zip(cells, size, strict=True)]
    xyz = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(1, xyz[..., 0].size + 1).reshape(xyz.shape[:-1])
    return xyz.reshape(-1, len(size)), number


def corners(number: np.ndarray) -> np.ndarray:
    """Elements of a lattice of two or three axes by their corners, in the order of VTK."""
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    if number.ndim == 2:
        return _take(number, np.array(square), 1)
    cube = [(*ij, k) for k in (0, 1) for ij in square]
    return _take(number, np.array(cube), 1)


def with_midsides(number: np.ndarray) -> np.ndarray:
    """Elements of second order of a lattice of half cells, nodes in the order of VTK."""
    square = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)]
    if number.ndim == 2:
        return _take(number, np.array(square), 2)
    corner, middle = square[:4], square[4:]
    at = [(*ij, 0) for ij in corner] + [(*ij, 2) for ij in corner]
    at += [(*ij, 0) for ij in middle] + [(*ij, 2) for ij in middle] + [(*ij, 1) for ij in corner]
    return _take(number, np.array(at), 2)


def _take(number: np.ndarray, offsets: np.ndarray, step: int) -> np.ndarray:
    """Elements with the given offsets of their nodes from the first node."""
    cells = [range(0, n - 1, step) for n in number.shape]
    first = np.stack(np.meshgrid(*cells, indexing="ij"), axis=-1).reshape(-1, number.ndim)
    return number[tuple(np.moveaxis(first[:, None] + offsets, -1, 0))]


def thin_out(xyz: np.ndarray, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes that elements use, renumbered."""
    used, elements = np.unique(elements, return_inverse=True)
    return xyz[used - 1], elements.reshape(-1, elements.shape[-1]) + 1


# -- decks -----------------------------------------------------------------------------------------
def grids(xyz: np.ndarray) -> list[str]:
    return [f"GRID,{i},,{x:.9f},{y:.9f},{z:.9f}" for i, (x, y, z) in enumerate(xyz, 1)]


def cards(name: str, elements: np.ndarray, tail: str = "") -> list[str]:
    """Bulk data of elements with property 1; eight fields a line."""
    lines = []
    for number, nodes in enumerate(elements.tolist(), 1):
        fields = [str(number), "1", *map(str, nodes), *([tail] if tail else [])]
        rows = [fields[k : k + 8] for k in range(0, len(fields), 8)]
        lines += [",".join([name if k == 0 else "", *row]) for k, row in enumerate(rows)]
    return lines


def nodes_of_deck(xyz: np.ndarray) -> list[str]:
    numbered = (f"{i}, {x:.9f}, {y:.9f}, {z:.9f}" for i, (x, y, z) in enumerate(xyz, 1))
    return ["*NODE", *numbered]


def elements_of_deck(kind: str, elements: np.ndarray) -> list[str]:
    """Elements of one kind; a long element continues on a second line."""
    lines = [f"*ELEMENT, TYPE={kind}, ELSET=EALL"]
    for number, nodes in enumerate(elements.tolist(), 1):
        fields = [str(number), *map(str, nodes)]
        lines.append(", ".join(fields[:11]) + ("," if len(fields) > 11 else ""))
        if len(fields) > 11:
            lines.append(", ".join(fields[11:]))
    return lines


MATERIAL = [
    "*MATERIAL, NAME=STEEL",
    "*ELASTIC",
    f"{E}, {NU}",
    "*DENSITY",
    f"{RHO}",
]


# -- frequencies -----------------------------------------------------------------------------------
def own_frequencies(model: Model, n: int) -> np.ndarray:
    found = updyn.modes(model, n + 6).frequency
    return found[found > ELASTIC][:n]


def mystran_frequencies(bulk: list[str], n: int) -> np.ndarray:
    """Frequencies of a deck that MYSTRAN assembles."""
    material = f"MAT1,1,{E:.6e},,{NU},{RHO}"
    with tempfile.TemporaryDirectory() as folder:
        deck = Path(folder) / "deck.bdf"
        is_held = any(line.startswith("SPC1") for line in bulk)
        head = ["SOL 103", "CEND", *(["SPC = 1"] if is_held else []), "BEGIN BULK"]
        deck.write_text("\n".join([*head, *bulk, material, "ENDDATA", ""]), encoding="ascii")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)
            model = updyn.read_model(deck, executable=str(find_executable(deck)))
    return own_frequencies(model, n)


def calculix_frequencies(lines: list[str], n: int) -> np.ndarray:
    """Frequencies that CalculiX prints."""
    step = ["*STEP", "*FREQUENCY", f"{n + 6}", "*END STEP", ""]
    with tempfile.TemporaryDirectory() as folder:
        deck = Path(folder) / "job.inp"
        deck.write_text("\n".join([*lines, *step]), encoding="ascii")
        subprocess.run(["ccx", "job"], cwd=folder, check=True, capture_output=True, timeout=600)
        text = (Path(folder) / "job.dat").read_text(encoding="latin-1")
    table = text.split("P A R T I C I P A T I O N")[0]
    number = r"\s+([-+.\dE]+)"
    rows = re.findall(rf"^\s+\d+{number * 4}\s*$", table, re.MULTILINE)
    found = np.array([float(row[2]) for row in rows])
    return found[found > ELASTIC][:n]


# -- frame -----------------------------------------------------------------------------------------
#: Height (along local y) and width of all members in m; J as for the rectangle.
HEIGHT, WIDTH = 0.01, 0.02
SECTION = Section(
    HEIGHT * WIDTH, HEIGHT * WIDTH**3 / 12.0, WIDTH * HEIGHT**3 / 12.0, 0.2287 * WIDTH * HEIGHT**3
)
#: Joints of the portal in m (the first and the last are fixed), and members between them.
JOINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.3, 0.0, 1.0], [1.3, 0.0, 0.0]])
MEMBERS = [(0, 1), (1, 2), (2, 3)]
#: The smaller side of the sections is in the plane of the portal.
ACROSS = np.array([0.0, 1.0, 0.0])


def member_stiffness(omega: float, length: float) -> np.ndarray:
    """Dynamic stiffness of a Bernoulli-Euler member, local axes; local y is in its plane."""
    K = np.zeros((12, 12))
    for rows, rigidity, mass in (
        ([0, 6], E * SECTION.A, RHO * SECTION.A),
        ([3, 9], G * SECTION.J, RHO * (SECTION.Iyy + SECTION.Izz)),
    ):
        k = omega * sqrt(mass / rigidity)
        a, b = cos(k * length), -1.0
        K[np.ix_(rows, rows)] += rigidity * k / sin(k * length) * np.array([[a, b], [b, a]])
    for rows, inertia, sign in (
        ([1, 5, 7, 11], SECTION.Izz, 1.0),
        ([2, 4, 8, 10], SECTION.Iyy, -1.0),
    ):
        k = (omega**2 * RHO * SECTION.A / (E * inertia)) ** 0.25
        z = k * length
        c, s, C, S = cos(z), sin(z), cosh(z), sinh(z)
        q = E * inertia / (1.0 - c * C)
        f1, f2 = q * k**3 * (s * C + c * S), -q * k**3 * (s + S)
        f3, f4 = q * k**2 * s * S, q * k**2 * (C - c)
        f5, f6 = q * k * (s * C - c * S), q * k * (S - s)
        turn = np.array([1.0, sign, 1.0, sign])
        block = np.array(
            [[f1, f3, f2, f4], [f3, f5, -f4, f6], [f2, -f4, f1, -f3], [f4, f6, -f3, f5]]
        )
        K[np.ix_(rows, rows)] += turn[:, None] * block * turn
    return K


def clamped_modes(omega: float, length: float) -> int:
    """Number of natural frequencies of a member with clamped ends below a frequency."""
    found = floor(omega * length / pi * sqrt(RHO / E))
    polar = RHO * (SECTION.Iyy + SECTION.Izz)
    found += floor(omega * length / pi * sqrt(polar / (G * SECTION.J)))
    for inertia in (SECTION.Iyy, SECTION.Izz):
        z = (omega**2 * RHO * SECTION.A / (E * inertia)) ** 0.25 * length
        i = floor(z / pi)
        found += i - (1 - (-1) ** i * int(np.sign(1.0 - cos(z) * cosh(z)))) // 2
    return found


def frame_modes_below(frequency: float) -> int:
    """Number of natural frequencies of the portal below a frequency in Hz."""
    omega, K, clamped = 2.0 * pi * frequency, np.zeros((24, 24)), 0
    for ends in MEMBERS:
        axis = JOINTS[ends[1]] - JOINTS[ends[0]]
        length = float(np.linalg.norm(axis))
        local = np.stack([axis / length, np.cross(ACROSS, axis / length), ACROSS])
        T = np.kron(np.eye(4), local)
        at = np.concatenate([6 * joint + np.arange(6) for joint in ends])
        K[np.ix_(at, at)] += T.T @ member_stiffness(omega, length) @ T
        clamped += clamped_modes(omega, length)
    free = np.arange(6, 18)
    return clamped + int((np.linalg.eigvalsh(K[np.ix_(free, free)]) < 0.0).sum())


def exact_frame(n: int) -> np.ndarray:
    """Frequencies of the portal by bisection on the count of Wittrick and Williams."""
    found = []
    for k in range(1, n + 1):
        low, high = 0.1, 2000.0
        while high - low > 1e-7 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if frame_modes_below(middle) < k else (low, middle)
        found.append(high)
    return np.array(found)


def beams_of_deck(xyz: np.ndarray, held: Sequence[int]) -> list[str]:
    """Deck of CalculiX of B32R along nodes, of which some are held."""
    odd = np.arange(1, len(xyz) - 1, 2)
    return [
        *nodes_of_deck(xyz),
        *elements_of_deck("B32R", np.stack([odd, odd + 1, odd + 2], axis=1)),
        *MATERIAL,
        "*BEAM SECTION, MATERIAL=STEEL, ELSET=EALL, SECTION=RECT",
        f"{WIDTH}, {HEIGHT}",
        "0., 1., 0.",
        *(["*BOUNDARY", *(f"{node}, 1, 6" for node in held)] if held else []),
    ]


def frame(n: int = 8, per: int = 10) -> Structure:
    """The portal, with some elements for each member."""

    def mesh(parts: int) -> tuple[np.ndarray, np.ndarray]:
        stations = np.concatenate([np.arange(parts * m, parts * (m + 1)) for m in range(3)])
        way = np.append(stations / parts, 3.0)
        xyz = np.stack([np.interp(way, np.arange(4), JOINTS[:, d]) for d in range(3)], axis=1)
        return xyz, np.stack([np.arange(1, len(xyz)), np.arange(2, len(xyz) + 1)], axis=1)

    xyz, elements = mesh(per)
    last = len(xyz)
    local_y = [np.cross(ACROSS, xyz[b - 1] - xyz[a - 1]) for a, b in elements]
    parts = [
        Beam(f"beam {k}", elements[k * per : (k + 1) * per], E, RHO, SECTION, NU,
             orientation=local_y[k * per].tolist())
        for k in range(3)
    ]  # fmt: skip
    own = structure(xyz, parts, grounded=[1, last])
    bars = [
        f"CBAR,{i},1,{a},{b},{v[0]:.6f},{v[1]:.6f},{v[2]:.6f}"
        for i, ((a, b), v) in enumerate(zip(elements.tolist(), local_y, strict=True), 1)
    ]
    bar = f"PBAR,1,1,{SECTION.A:.9e},{SECTION.Izz:.9e},{SECTION.Iyy:.9e},{SECTION.J:.9e}"
    nastran = [*grids(xyz), *bars, bar, f"SPC1,1,123456,1,{last}"]
    fine, _ = mesh(2 * per)
    calculix = beams_of_deck(fine, [1, len(fine)])
    kinds = ("`Beam`", "CBAR", "B32R")
    return Structure("portal frame", exact_frame(n), own, nastran, calculix, kinds)


# -- plates and solids by Ritz ---------------------------------------------------------------------
#: Orders of the derivatives of a function by each axis.
Orders = tuple[int, ...]


def products(terms: Sequence[int], size: Sequence[float]) -> Callable[[Orders, Orders], np.ndarray]:
    """Return a function for the integrals of two derivatives of products of Legendre polynomials.

    The integrals are over a box with sides `size`; each derivative has an order for each axis.
    """
    tables = []
    for n, side in zip(terms, size, strict=True):
        points, weights = legendre.leggauss(n + 1)
        derivatives = []
        for order in range(3):
            polynomials = legendre.legder(np.eye(n), order, scl=2.0 / side, axis=0)
            derivatives.append(legendre.legval(points, polynomials).T)
        tables.append(
            [[(u.T * weights * side / 2.0) @ v for v in derivatives] for u in derivatives]
        )

    def integral(first: Orders, second: Orders) -> np.ndarray:
        out = np.eye(1)
        for table, i, j in zip(tables, first, second, strict=True):
            out = np.kron(out, table[i][j])
        return out

    return integral


def ritz_frequencies(K: np.ndarray, M: np.ndarray, n: int) -> np.ndarray:
    value = scipy.linalg.eigh(K, M, eigvals_only=True, subset_by_index=[0, n + 7])
    found = np.sqrt(np.maximum(value, 0.0)) / (2.0 * pi)
    return found[found > ELASTIC][:n]


def exact_thin_plate(size: tuple[float, float], thickness: float, n: int) -> np.ndarray:
    """Frequencies of a free plate of Kirchhoff."""
    of = products((16, 16), size)
    D = E * thickness**3 / (12.0 * (1.0 - NU**2))
    xx, yy, xy = (2, 0), (0, 2), (1, 1)
    K = of(xx, xx) + of(yy, yy) + NU * (of(xx, yy) + of(yy, xx)) + 2.0 * (1.0 - NU) * of(xy, xy)
    return ritz_frequencies(D * K, RHO * thickness * of((0, 0), (0, 0)), n)


def exact_thick_plate(
    size: tuple[float, float],
    thickness: float,
    n: int,
    *,
    coefficient: float = 5.0 / 6.0,
    has_rotary_inertia: bool = True,
) -> np.ndarray:
    """Frequencies of a free plate of Mindlin."""
    of = products((16, 16), size)
    D = E * thickness**3 / (12.0 * (1.0 - NU**2))
    shear, twist = coefficient * G * thickness, 0.5 * (1.0 - NU) * D
    o, x, y = (0, 0), (1, 0), (0, 1)
    # Deflection w, and a and b with the shear strains w,x + a and w,y + b.
    aa = D * of(x, x) + twist * of(y, y) + shear * of(o, o)
    bb = D * of(y, y) + twist * of(x, x) + shear * of(o, o)
    ab = NU * D * of(x, y) + twist * of(y, x)
    wa, wb = shear * of(x, o), shear * of(y, o)
    K = np.block([[shear * (of(x, x) + of(y, y)), wa, wb], [wa.T, aa, ab], [wb.T, ab.T, bb]])
    if not has_rotary_inertia:
        m = len(wa)
        K = K[:m, :m] - K[:m, m:] @ np.linalg.solve(K[m:, m:], K[m:, :m])
        return ritz_frequencies(0.5 * (K + K.T), RHO * thickness * of(o, o), n)
    inertia = np.diag([thickness, thickness**3 / 12.0, thickness**3 / 12.0])
    return ritz_frequencies(K, RHO * np.kron(inertia, of(o, o)), n)


def exact_block(
    size: tuple[float, float, float], n: int, terms: tuple[int, int, int] = (14, 10, 7)
) -> np.ndarray:
    """Frequencies of a free block of an isotropic material."""
    of = products(terms, size)
    lame, by = E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    of_all = G * sum(of(axis, axis) for axis in by)
    blocks = [
        [lame * of(i, j) + G * of(j, i) + (of_all if i == j else 0.0) for j in by] for i in by
    ]
    mass = RHO * np.kron(np.eye(3), of((0, 0, 0), (0, 0, 0)))
    return ritz_frequencies(np.block(blocks), mass, n)


#: Sides of the plates in m.
PLATE = (0.9, 0.6)


def plate(
    name: str, thickness: float, exact: np.ndarray, cells: tuple[int, int] = (24, 16)
) -> Structure:
    """A free plate of shells."""
    size = PLATE
    flat, number = lattice(cells, size)
    xyz, elements = np.column_stack([flat, np.zeros(len(flat))]), corners(number)
    own = structure(xyz, [Shell("plate", elements, E, RHO, thickness, NU)])
    nastran = [*grids(xyz), *cards("CQUAD4", elements), f"PSHELL,1,1,{thickness},1,,1"]
    fine, half = lattice([2 * c for c in cells], size)
    fine, second = thin_out(np.column_stack([fine, np.zeros(len(fine))]), with_midsides(half))
    calculix = [
        *nodes_of_deck(fine),
        *elements_of_deck("S8R", second),
        *MATERIAL,
        "*SHELL SECTION, MATERIAL=STEEL, ELSET=EALL",
        f"{thickness}",
    ]
    kinds = ("`Shell`", "CQUAD4", "S8R")
    return Structure(name, exact, own, nastran, calculix, kinds)


def block(order: int, n: int = 6, cells: tuple[int, int, int] = (20, 6, 2)) -> Structure:
    """A free block of 1 m x 0.3 m x 0.1 m, of bricks of first or second order.

    MYSTRAN uses reduced integration of the shear for 8 nodes, its default, and full integration for
    20 nodes: with the default, the second frequency would be 17 % too low.
    """
    size = (1.0, 0.3, 0.1)
    if order == 1:
        xyz, number = lattice(cells, size)
        elements = corners(number)
    else:
        cells = tuple(c // 2 for c in cells)
        xyz, number = lattice([2 * c for c in cells], size)
        xyz, elements = thin_out(xyz, with_midsides(number))
    own = structure(xyz, [Solid("block", elements, E, RHO, NU)])
    # Nastran and CalculiX number the middle nodes in another order than VTK.
    nastran = elements if order == 1 else elements[:, [*range(12), *range(16, 20), *range(12, 16)]]
    bulk = [*grids(xyz), *cards("CHEXA", nastran), f"PSOLID,1,1,,{order + 1},,{order - 1}"]
    deck = [
        *nodes_of_deck(xyz),
        *elements_of_deck("C3D8I" if order == 1 else "C3D20", elements),
        *MATERIAL,
        "*SOLID SECTION, MATERIAL=STEEL, ELSET=EALL",
    ]
    kinds = ("`Solid`", "CHEXA", "C3D8I" if order == 1 else "C3D20")
    name = f"block, bricks of {8 if order == 1 else 20} nodes"
    return Structure(name, exact_block(size, n), own, bulk, deck, kinds)


CASES: list[Callable[[], Structure]] = [
    frame,
    lambda: plate("thin plate", 0.004, exact_thin_plate(PLATE, 0.004, 6)),
    lambda: plate("thick plate", 0.06, exact_thick_plate(PLATE, 0.06, 6)),
    lambda: block(1),
    lambda: block(2),
]


def dense(model: Model) -> np.ndarray:
    """Stiffness of a model."""
    return np.asarray(scipy.sparse.coo_array(model.stiffness).todense())


def straight_beam(elements: int, held: Sequence[int]) -> list[str]:
    """Deck of CalculiX of a beam of 1 m."""
    along = np.linspace(0.0, 1.0, 2 * elements + 1)
    return beams_of_deck(np.stack([along, 0.0 * along, 0.0 * along], axis=1), held)


def bending(*roots: float) -> np.ndarray:
    """Frequencies of a Bernoulli-Euler beam of 1 m about both axes."""
    inertia = np.array([SECTION.Iyy, SECTION.Izz])
    speeds = np.sqrt(E * inertia / (RHO * SECTION.A)) / (2.0 * pi)
    return np.sort(np.outer(np.square(roots), speeds).ravel())


def print_reasons() -> None:
    """Print errors in per cent of the runs behind the reasons of the differences."""

    def show(title: str, found: np.ndarray, exact: np.ndarray) -> None:
        errors = 100.0 * (found[: len(exact)] / exact - 1.0)
        print(title, " ".join(f"{error:+.2f}" for error in errors), sep=": ")

    show("frame, CBAR, 20 in each member", mystran_frequencies(frame(per=20).nastran, 8),
         exact_frame(8))  # fmt: skip
    for n in (10, 20, 40):
        found = calculix_frequencies(straight_beam(n, [1]), 1)
        show(f"cantilever, {n} B32R", found, bending(1.8751040687)[:1])
    found = calculix_frequencies(straight_beam(10, []), 11)
    show("free beam, 10 B32R", found, bending(4.7300407449, 7.8532046241)[:3])
    torsion = 0.5 * sqrt(G * SECTION.J / (RHO * (SECTION.Iyy + SECTION.Izz)))
    show("torsion of the same beam", found[10:], np.array([torsion]))
    thick = exact_thick_plate(PLATE, 0.06, 6)
    light = exact_thick_plate(PLATE, 0.06, 6, has_rotary_inertia=False)
    show("thick plate without rotary inertia, exact", light, thick)
    for cells in ((24, 16), (48, 32)):
        one = plate("thick plate", 0.06, thick, cells)
        show(f"thick plate, CQUAD4, {cells}", mystran_frequencies(one.nastran, 6), thick)
        show(f"thick plate, `Shell`, {cells}", own_frequencies(one.own, 6), thick)
    stiff = exact_thick_plate(PLATE, 0.06, 6, coefficient=1.0)
    one = plate("thick plate", 0.06, thick)
    show("thick plate, S8R, coefficient 1", calculix_frequencies(one.calculix, 6), stiff)
    for cubes in ((20, 6, 2), (40, 12, 4)):
        one = block(2, cells=cubes)
        bulk = ["PSOLID,1,1" if line.startswith("PSOLID") else line for line in one.nastran]
        show(f"block, CHEXA20 by default, {cubes}", mystran_frequencies(bulk, 6), one.exact)
    one = block(2)
    deck = [line.replace("C3D20", "C3D20R") for line in one.calculix]
    show("block, C3D20R", calculix_frequencies(deck, 6), one.exact)
    one = block(1, cells=(4, 2, 1))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "job.inp"
        path.write_text("\n".join([*one.calculix, "*STEP", "*FREQUENCY", "1", "*END STEP", ""]))
        model = updyn.read_model(path)
    labels = [model.dofs.labels.index(label) for label in one.own.dofs.labels]
    inner = np.setdiff1d(np.arange(model.n_dofs), labels)
    K = dense(model)
    coupling = K[np.ix_(inner, labels)]
    condensed = K[np.ix_(labels, labels)] - coupling.T @ np.linalg.solve(
        K[np.ix_(inner, inner)], coupling
    )
    own = dense(one.own)
    print(f"stiffness of C3D8I, largest difference: {abs(condensed - own).max() / own.max():.0e}")


def print_table() -> None:
    """Print the table."""
    programs = ("own", "MYSTRAN", "CalculiX")
    titles = ["structure", "mode", *(f"{name}, Hz" for name in ("exact", *programs)), *programs]
    print("|", " | ".join(titles), "|")
    print("|---|---|---|---|---|---|---|---|---|")
    for case in CASES:
        one = case()
        n = len(one.exact)
        found = [
            own_frequencies(one.own, n),
            mystran_frequencies(one.nastran, n),
            calculix_frequencies(one.calculix, n),
        ]
        title = f"{one.name}: {', '.join(one.elements)}"
        for k in range(n):
            cells = [f"{values[k]:.3f}" for values in (one.exact, *found)]
            cells += [f"{100 * (values[k] / one.exact[k] - 1):+.2f} %" for values in found]
            print("|", " | ".join([title if k == 0 else "", str(k + 1), *cells]), "|")


def main() -> None:
    """Print the table, or the reasons."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--reasons", action="store_true", help="runs behind the differences")
    if arguments.parse_args().reasons:
        print_reasons()
    else:
        print_table()


if __name__ == "__main__":
    main()
