"""Hexahedra and wedges in the formulation of Nastran: theory, and published answers of its HEXA."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.elements.structure.bricks import brick_matrices, find_inside_out

CUBE = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    dtype=float,
)
WEDGE = CUBE[[0, 1, 3, 4, 5, 7]]
E, NU, RHO = 70e9, 0.33, 2700.0


def distort(corners: np.ndarray, seed: int, size: float = 0.15) -> np.ndarray:
    return corners + size * np.random.default_rng(seed).uniform(-1, 1, corners.shape)


def rigid_motions(xyz: np.ndarray) -> np.ndarray:
    turns = [np.cross(axis, xyz).ravel() for axis in np.eye(3)]
    return np.array([*(np.tile(axis, len(xyz)) for axis in np.eye(3)), *turns]).T


@pytest.mark.parametrize("corners", [CUBE, WEDGE], ids=["hexahedron", "wedge"])
@pytest.mark.parametrize("seed", range(3))
def test_rigid_motions_are_the_null_space(corners: np.ndarray, seed: int) -> None:
    xyz = distort(corners, seed)
    K, M = (A[0] for A in brick_matrices(xyz[None], E, NU, RHO))
    assert abs(K @ rigid_motions(xyz)).max() < 1e-12 * K.max() * 24
    values = np.linalg.eigvalsh(K)
    assert values[6] > 1e-3 * values[-1]
    assert np.linalg.eigvalsh(M)[0] > 0


@pytest.mark.parametrize("corners", [CUBE, WEDGE], ids=["hexahedron", "wedge"])
def test_turned_elements_have_turned_matrices(corners: np.ndarray) -> None:
    xyz = distort(corners, 5)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    K = brick_matrices(np.array([xyz, xyz @ turn.T]), E, NU, RHO)[0]
    all_nodes = np.kron(np.eye(len(xyz)), turn)
    np.testing.assert_allclose(all_nodes.T @ K[1] @ all_nodes, K[0], atol=1e-12 * K.max())


@pytest.mark.parametrize("corners", [CUBE, WEDGE], ids=["hexahedron", "wedge"])
@pytest.mark.parametrize("lumped", [False, True])
def test_mass_is_density_times_volume(corners: np.ndarray, lumped: bool) -> None:
    M = brick_matrices(2.0 * corners[None], E, NU, RHO, lumped)[1][0]
    volume = 8.0 if len(corners) == 8 else 4.0
    assert M[::3, ::3].sum() == pytest.approx(RHO * volume, rel=1e-12)
    assert (np.count_nonzero(M) == len(M)) == lumped


def test_a_constant_strain_is_exact_in_a_patch_of_distorted_hexahedra() -> None:
    # MacNeal & Harder, Finite Elem. Anal. Des. 1 (1985) 3-20: a unit cube of seven hexahedra.
    inner = np.array(
        [
            (0.249, 0.342, 0.192),
            (0.826, 0.288, 0.288),
            (0.850, 0.649, 0.263),
            (0.273, 0.750, 0.230),
            (0.320, 0.186, 0.643),
            (0.677, 0.305, 0.683),
            (0.788, 0.693, 0.644),
            (0.165, 0.745, 0.702),
        ]
    )
    xyz = np.concatenate([inner, CUBE])
    faces = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    # Seen from the inner element, each face is the first one of an outer element.
    elements = [tuple(range(8)), *((*face, *(8 + node for node in face)) for face in faces)]
    K = assemble(xyz, np.array(elements), E, 0.25)
    strain = 1e-3 * np.array([[1.0, 0.5, 0.5], [0.5, 1.0, 0.5], [0.5, 0.5, 1.0]])
    exact = (xyz @ strain).ravel()
    free, outer = np.arange(24), np.arange(24, 48)
    found = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, outer)] @ exact[outer])
    np.testing.assert_allclose(found, exact[:24], rtol=1e-9)


@pytest.mark.parametrize(
    ("shift", "expected"),
    [
        # Bending in the plane and out of the plane, relative to beam theory. MacNeal &
        # Harder, Finite Elem. Anal. Des. 1 (1985) 3-20 (straight beam); answers of HEX8 as in the
        # verification manual of OptiStruct (OS-V: 0720). Tapered elements are too stiff.
        ((0, 0, 0, 0, 0, 0, 0), (0.978, 0.973)),
        ((0, 1, 1, 1, 1, 1, 0), (0.624, 0.529)),
        ((0, 1, -1, 1, -1, 1, 0), (0.047, 0.030)),
    ],
    ids=["rectangles", "parallelograms", "trapezoids"],
)
def test_slender_beam(shift: tuple[int, ...], expected: tuple[float, ...]) -> None:
    n, sides = len(shift) - 1, [(y, z) for y in (0, 1) for z in (0, 1)]
    offset = 0.1 * np.array(shift)
    xyz = np.array(
        [
            (x + (2 * y - 1) * d, 0.2 * y, 0.1 * z)
            for y, z in sides
            for x, d in zip(range(n + 1), offset, strict=True)
        ]
    )

    def node(i: int, y: int, z: int) -> int:
        return (2 * y + z) * (n + 1) + i

    ring = [(0, 0), (1, 0), (1, 1), (0, 1)]
    elements = [[node(i + a, b, z) for z in (0, 1) for a, b in ring] for i in range(n)]
    K = assemble(xyz, np.array(elements), 1e7, 0.3)
    clamped = [3 * node(0, y, z) + c for y, z in sides for c in range(3)]
    free = np.setdiff1d(np.arange(len(K)), clamped)
    exact = (3e-5, 0.1081, 0.4321)
    for axis in range(3):
        force = np.zeros(len(K))
        force[[3 * node(n, y, z) + axis for y, z in sides]] = 0.25
        tip = force[free] @ np.linalg.solve(K[np.ix_(free, free)], force[free])
        allowed = (0.02, 0.002, 0.05)[axis]
        assert tip / exact[axis] == pytest.approx((1.0, *expected)[axis], abs=allowed)


def test_elements_that_are_inside_out_are_found() -> None:
    assert find_inside_out(CUBE[None]) is None
    assert find_inside_out(np.array([CUBE, CUBE[[4, 5, 6, 7, 0, 1, 2, 3]]])) == 1
    assert find_inside_out(WEDGE[None, [0, 2, 1, 3, 5, 4]]) == 0


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def assemble(xyz: np.ndarray, elements: np.ndarray, modulus: float, nu: float) -> np.ndarray:
    K = np.zeros((3 * len(xyz), 3 * len(xyz)))
    assert find_inside_out(xyz[elements]) is None
    for nodes, part in zip(
        elements, brick_matrices(xyz[elements], modulus, nu, 0.0)[0], strict=True
    ):
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        K[np.ix_(dofs, dofs)] += part
    return K


@pytest.mark.parametrize(
    ("distortion", "thickness", "allowed"),
    [(0.0, 0.01, 1e-3), (0.25, 0.05, 0.01), (0.1, 0.01, 0.08)],
    ids=["regular", "distorted", "thin and distorted"],
)
def test_plate(distortion: float, thickness: float, allowed: float) -> None:
    # Simply supported square plate, one hexahedron in the thickness. Timoshenko & Woinowsky-Krieger,
    # Theory of Plates and Shells, 2nd ed. 1959, article 30: w = 0.00406 q a^4 / D at the centre
    # (nu = 0.3), without shear deformation. Thin distorted elements are too stiff.
    n = 12
    shift = distortion / n * np.random.default_rng(3).uniform(-1, 1, (n + 1, n + 1, 2))
    shift[[0, -1]] = shift[:, [0, -1]] = shift[n // 2, n // 2] = 0.0
    plan = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2, indexing="ij"), axis=2) + shift
    flat = plan.reshape(-1, 2)
    layers = [np.column_stack([flat, np.full(len(flat), z * thickness)]) for z in (0, 1)]
    size = len(flat)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    ring = corner[:, None] + [0, n + 1, n + 2, 1]
    K = assemble(np.concatenate(layers), np.concatenate([ring, ring + size], axis=1), E, 0.3)
    edge = np.flatnonzero(((flat == 0) | (flat == 1)).any(axis=1))
    middle = (size - 1) // 2
    # The rigid motion in the plane is fixed at the centre, so the edges can turn.
    fixed = np.concatenate([3 * edge + 2, 3 * (size + edge) + 2, [3 * middle, 3 * middle + 1, 1]])
    free = np.setdiff1d(np.arange(len(K)), fixed)
    force = np.zeros(len(K))
    area = np.abs(_cross(flat[ring[:, 2]] - flat[ring[:, 0]], flat[ring[:, 3]] - flat[ring[:, 1]]))
    for at in range(4):
        np.add.at(force, 3 * ring[:, at] + 2, area / 8)
    w = np.zeros(len(K))
    w[free] = np.linalg.solve(K[np.ix_(free, free)], force[free])
    D = E * thickness**3 / (12 * (1 - 0.3**2))
    assert w[3 * middle + 2] == pytest.approx(0.00406 / D, rel=allowed)
