"""Shells against plates and roofs of the literature, and against a Ritz solution of our own."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
import scipy.linalg
from numpy.polynomial import legendre
from scipy.sparse.linalg import spsolve

import updyn
from bodies import deflection, rigid_inertia, rotation, strain_of_rigid_motions
from updyn.elements.structure import Beam, PointMass, Shell, Spring, rectangle, structure
from updyn.errors import ModelError, UpdynWarning

E, RHO, NU = 7.0e10, 2700.0, 0.3
SIDE, THIN = 1.2, 0.003
D = E * THIN**3 / (12 * (1 - NU**2))


def grid(
    n: int, kind: str = "quads", skew: float = 0.0, warp: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of a square plate of n x n cells, their numbers as a grid, and the elements."""
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, SIDE, n + 1)
    X, Y = np.meshgrid(x, x, indexing="ij")
    inner = np.zeros_like(X)
    inner[1:-1, 1:-1] = skew * SIDE / n
    xyz = np.stack(
        [X + inner * rng.uniform(-1, 1, X.shape), Y + inner * rng.uniform(-1, 1, X.shape), 0 * X],
        axis=-1,
    )
    xyz[..., 2] = warp * SIDE / n * rng.uniform(-1, 1, X.shape)
    I = np.arange(1, X.size + 1).reshape(X.shape)
    quads = np.stack([I[:-1, :-1], I[1:, :-1], I[1:, 1:], I[:-1, 1:]], axis=-1).reshape(-1, 4)
    elements = (
        quads if kind == "quads" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    )
    return xyz.reshape(-1, 3), I, elements


def held(I: np.ndarray, edges: str) -> list[str | int]:
    """What holds a plate: S, C or F at x = 0, x = a, y = 0, y = a; and its motion in the plane."""
    out: dict[str | int, None] = {
        f"{k}:{d}": None for k in I.ravel().tolist() for d in ("X", "Y", "RZ")
    }
    for how, nodes, turn in zip(
        edges, (I[0], I[-1], I[:, 0], I[:, -1]), ("RX", "RX", "RY", "RY"), strict=True
    ):
        for k in nodes.tolist():
            out |= dict.fromkeys(
                [f"{k}:{d}" for d in {"F": (), "S": ("Z", turn), "C": ("Z", "RX", "RY")}[how]]
            )
    return list(out)


def values(n: int, edges: str, count: int, **mesh) -> np.ndarray:
    """Frequency parameters omega a^2 sqrt(rho h / D)."""
    xyz, I, elements = grid(n, **mesh)
    plate = structure(xyz, [Shell("plate", elements, E, RHO, THIN, NU)], grounded=held(I, edges))
    return 2 * pi * updyn.modes(plate, count).frequency * SIDE**2 * np.sqrt(RHO * THIN / D)


def ritz(edges: str, count: int, terms: int = 14) -> np.ndarray:
    """The same by Ritz with Legendre polynomials on Kirchhoff's plate; x = 0 is clamped where `edges` starts with C."""
    points, weights = legendre.leggauss(2 * terms)
    factor = {"C": np.polynomial.Polynomial([1.0, 2.0, 1.0]), "F": np.polynomial.Polynomial([1.0])}

    def functions(how: str) -> list[np.ndarray]:
        out = []
        for k in range(terms):
            p = factor[how] * legendre.Legendre.basis(k).convert(kind=np.polynomial.Polynomial)
            out.append([p.deriv(d)(points) * 2.0**d if d else p(points) for d in range(3)])
        return list(np.moveaxis(np.array(out), 1, 0))

    X, Y = functions(edges[0]), functions("F")

    def product(a: int, b: int, c: int, d: int) -> np.ndarray:
        return np.kron((X[a] * weights) @ X[b].T, (Y[c] * weights) @ Y[d].T)

    K = product(2, 2, 0, 0) + product(0, 0, 2, 2) + 2 * (1 - NU) * product(1, 1, 1, 1)
    cross = NU * product(2, 0, 0, 2)
    M = product(0, 0, 0, 0)
    found = scipy.linalg.eigh(K + cross + cross.T, M, eigvals_only=True)
    return np.sqrt(np.clip(found[:count], 0, None))


#: Square plates, nu = 0.3: Leissa, J. Sound and Vibration 31 (1973) 257-293 (with free edges, upper
#: bounds by Ritz).
LEISSA = {
    "SSSS": [19.7392, 49.3480, 49.3480, 78.9568],
    "CCCC": [35.992, 73.413, 73.413, 108.27],
    "CFFF": [3.4917, 8.5246, 21.429, 27.331, 31.111],
}


@pytest.mark.parametrize(("kind", "error"), [("quads", 0.008), ("triangles", 0.023)])
@pytest.mark.parametrize("edges", ["SSSS", "CCCC", "CFFF"])
def test_plates_vibrate_as_in_leissa(edges, kind, error):
    exact = np.array(LEISSA[edges])
    np.testing.assert_allclose(values(32, edges, len(exact), kind=kind), exact, rtol=error)


@pytest.mark.parametrize(("kind", "order"), [("quads", 1.8), ("triangles", 1.8)])
def test_the_error_falls_with_the_square_of_the_mesh(kind, order):
    exact = np.array(LEISSA["SSSS"][:3])
    error = [np.abs(values(n, "SSSS", 3, kind=kind) / exact - 1).max() for n in (16, 32)]
    assert np.log2(error[0] / error[1]) > order


def test_free_edges_agree_with_ritz():
    """Leissa's values of plates with free edges are up to 1 % high; more terms bring Ritz to these."""
    for edges, rigid in (("FFFF", 3), ("CFFF", 0)):
        exact = ritz(edges, rigid + 5)[rigid:]
        np.testing.assert_allclose(values(32, edges, rigid + 5)[rigid:], exact, rtol=6e-3)
    np.testing.assert_allclose(ritz("CFFF", 5), LEISSA["CFFF"], rtol=0.01)


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_a_thick_plate_vibrates_as_in_mindlin(kind):
    """Simply supported, side 5 h: flexural branch of Mindlin, J. Applied Mechanics 18 (1951) 31, kappa = 5/6."""
    h, k2 = SIDE / 5, 2 * (pi / SIDE) ** 2
    rigidity, shear = E * h**3 / (12 * (1 - NU**2)), 5 / 6 * E / (2 * (1 + NU)) * h
    # (S k2 - rho h x) (D k2 + S - rho h^3 / 12 x) = S^2 k2, x = omega^2
    m, r = RHO * h, RHO * h**3 / 12
    roots = np.roots(
        [m * r, -(m * (rigidity * k2 + shear) + r * shear * k2), shear * k2 * rigidity * k2]
    )
    exact = np.sqrt(roots.min()) / (2 * pi)
    xyz, I, elements = grid(24, kind)
    plate = structure(xyz, [Shell("plate", elements, E, RHO, h, NU)], grounded=held(I, "SSSS"))
    assert updyn.modes(plate, 1).frequency[0] == pytest.approx(exact, rel=4e-3)


def test_a_distorted_mesh_costs_little():
    for kind, error in (("quads", 0.006), ("triangles", 0.012)):
        exact = np.array(LEISSA["SSSS"][:3])
        np.testing.assert_allclose(values(32, "SSSS", 3, kind=kind, skew=0.3), exact, rtol=error)


def test_a_thin_plate_does_not_lock():
    xyz, I, elements = grid(8)
    answer = []
    for h in (1e-2, 1e-4):
        plate = structure(xyz, [Shell("plate", elements, E, RHO, h, NU)], grounded=held(I, "CCCC"))
        centre = int(I[4, 4])
        # w = 0.00560 P a^2 / D of a clamped plate: Timoshenko & Woinowsky-Krieger 1959, table 37.
        w = (
            deflection(plate, {f"{centre}:Z": 1.0})[f"{centre}:Z"]
            * E
            * h**3
            / (12 * (1 - NU**2))
            / SIDE**2
        )
        answer.append(w)
    np.testing.assert_allclose(answer, 0.00560, rtol=0.05)
    assert answer[0] == pytest.approx(answer[1], rel=0.02)


@pytest.mark.parametrize("kind", ["quads", "triangles"])
@pytest.mark.parametrize("warp", [0.0, 0.08])
def test_a_free_shell_has_exactly_six_motions_without_energy(kind, warp):
    xyz, _, elements = grid(4, kind, skew=0.2, warp=warp)
    plate = structure(xyz @ rotation(1).T, [Shell("plate", elements, E, RHO, 0.02, NU)])
    assert strain_of_rigid_motions(plate) < 1e-12
    K = plate.stiffness.toarray()
    scale = np.sqrt(np.diag(K))
    found = np.linalg.eigvalsh(K / np.outer(scale, scale))
    assert (found < 1e-9).sum() == 6
    assert found[6] > 1e-6


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_mass_and_inertia_of_a_plate(kind):
    xyz, _, elements = grid(4, kind, skew=0.2)
    h = 0.05
    mass = RHO * h * SIDE**2
    found = rigid_inertia(
        structure(xyz - [SIDE / 2, SIDE / 2, 0], [Shell("plate", elements, E, RHO, h, NU)])
    )
    np.testing.assert_allclose(found[:3, :3], mass * np.eye(3), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(found[:3, 3:], 0.0, atol=1e-9)
    # The drilling rotation has no inertia of its own: about z, that of the mean plane.
    about = mass * np.array([(SIDE**2 + h**2) / 12, (SIDE**2 + h**2) / 12, SIDE**2 / 6])
    np.testing.assert_allclose(found[3:, 3:], np.diag(about), rtol=1e-10, atol=1e-9)


def test_a_turned_shell_has_the_same_frequencies():
    xyz, I, elements = grid(5, skew=0.2, warp=0.05)
    Q = rotation(5)
    extra = [
        PointMass("mass", 1, 0.4, (0.01, 0.02, 0.03)),
        Spring("spring", 6, stiffness=(1e4,) * 3 + (1e3,) * 3),
    ]
    parts = [Shell("plate", elements, E, RHO, THIN, NU), *extra]
    same = [parts[0], PointMass("mass", 1, 0.4, Q @ extra[0].inertia @ Q.T), extra[1]]
    before = updyn.modes(structure(xyz, parts, grounded=I[-1].tolist()), 8).frequency
    after = updyn.modes(structure(xyz @ Q.T, same, grounded=I[-1].tolist()), 8).frequency
    np.testing.assert_allclose(after, before, rtol=1e-8)


@pytest.mark.parametrize(("n", "error"), [(1, 0.11), (4, 0.015)])
def test_a_shell_bends_in_its_plane_as_a_beam(n, error):
    """Tip deflection of a deep cantilever, P L^3 / 3 E I + P L / (kappa G A), by 6 n x n quadrilaterals."""
    length, deep, h = 3.0, 0.4, 0.01
    x, y = np.meshgrid(
        np.linspace(0, length, 6 * n + 1), np.linspace(0, deep, n + 1), indexing="ij"
    )
    I = np.arange(1, x.size + 1).reshape(x.shape)
    quads = np.stack([I[:-1, :-1], I[1:, :-1], I[1:, 1:], I[:-1, 1:]], axis=-1).reshape(-1, 4)
    xyz = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    wall = structure(xyz, [Shell("wall", quads, E, RHO, h, NU)], grounded=I[0].tolist())
    found = deflection(wall, {f"{k}:Y": 1 / (n + 1) for k in I[-1].tolist()})
    exact = length**3 / (3 * E * h * deep**3 / 12) + length / (
        5 / 6 * E / (2 * (1 + NU)) * h * deep
    )
    assert found[f"{I[-1, 0]}:Y"] == pytest.approx(exact, rel=error)


@pytest.mark.parametrize(("kind", "error"), [("quads", 0.015), ("triangles", 0.06)])
def test_the_roof_of_scordelis_and_lo(kind, error):
    """Middle of the free edge under its weight: 0.3024 (MacNeal & Harder, Finite Elem. Anal. Des. 1 (1985) 3-20)."""
    n, radius, length, half = 16, 25.0, 50.0, 40.0
    arc, line = np.radians(np.linspace(0, half, n + 1)), np.linspace(0, length / 2, n + 1)
    angle, along = np.meshgrid(arc, line, indexing="ij")
    xyz = np.stack([radius * np.sin(angle), along, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    I = np.arange(1, angle.size + 1).reshape(angle.shape)
    quads = np.stack([I[:-1, :-1], I[1:, :-1], I[1:, 1:], I[:-1, 1:]], axis=-1).reshape(-1, 4)
    elements = (
        quads if kind == "quads" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    )
    crown, middle, end = I[0].tolist(), I[:, 0].tolist(), I[:, -1].tolist()
    ground = {f"{k}:{d}": None for k in crown for d in ("X", "RY", "RZ")}  # symmetry
    ground |= {f"{k}:{d}": None for k in middle for d in ("Y", "RX", "RZ")}
    ground |= {f"{k}:{d}": None for k in end for d in ("X", "Z")}  # diaphragm
    weight = 90.0
    roof = structure(
        xyz, [Shell("roof", elements, 4.32e8, weight / 0.25, 0.25, 0.0)], grounded=list(ground)
    )
    down = -(roof.dofs.axes == 2).astype(float)
    answer = spsolve(roof.stiffness.tocsc(), roof.mass @ down)
    found = answer[roof.dofs.match([f"{I[-1, 0]}:Z"]).index[0]]
    assert found == pytest.approx(-0.3024, rel=error)


def test_a_stiffened_plate_joins_beams_and_shells():
    xyz, I, elements = grid(6)
    plate = Shell("plate", elements, E, RHO, THIN, NU)
    rim = [np.column_stack([line[:-1], line[1:]]) for line in (I[0], I[-1], I[:, 0], I[:, -1])]
    frame = Beam("rim", np.concatenate(rim), E, RHO, rectangle(0.02, 0.01), orientation=[0, 0, 1.0])
    both = structure(xyz, [plate, frame])
    assert list(both.groups) == ["plate", "rim"]
    mass = RHO * (THIN * SIDE**2 + 4 * SIDE * 2e-4)
    assert rigid_inertia(both)[0, 0] == pytest.approx(mass)
    assert strain_of_rigid_motions(both) < 1e-12


def test_a_warped_element_is_warned_of():
    nodes = [[0, 0, 0], [1, 0, 0], [1, 1, 0.6], [0, 1, 0]]
    with pytest.warns(
        UpdynWarning, match=r"nodes \[1, 2, 3, 4\] is warped: a node is 1\d% of its size off"
    ):
        structure(nodes, [Shell("s", [[1, 2, 3, 4]], E, RHO, 0.01)])


@pytest.mark.parametrize(
    ("nodes", "element", "said"),
    [
        (
            [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
            [1, 2, 3],
            "the element of nodes \\[1, 2, 3\\] has no area",
        ),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [1, 3, 2, 4], "is not convex|has no area"),
        ([[0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0]], [1, 2, 3, 4], "is not convex"),
    ],
)
def test_elements_without_a_sense_are_named(nodes, element, said):
    with pytest.raises(ModelError, match=said):
        structure(nodes, [Shell("s", [element], E, RHO, 0.01)])
