"""Blocks of solid elements."""

from __future__ import annotations

import numpy as np

CUBE = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)
HEX_EDGES = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
]
TET_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
#: Around the diagonal from the first corner to the seventh (Kuhn), so that neighbours fit.
TETS = np.array(
    [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
)


def block(
    cells: tuple[int, int, int], size: tuple[float, float, float], nodes: int, skew: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Positions, shape (n, 3), and elements of 4, 8, 10 or 20 nodes, numbered from 1, of a block of bricks.

    `skew` moves the inner corners by that part of a brick; middles of edges stay in the middle.
    """
    count = 2 * np.array(cells) + 1
    first = 2 * np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(
        -1, 1, 3
    )
    corners = first + 2 * CUBE
    if nodes in (4, 10):
        corners = corners[:, TETS].reshape(-1, 4, 3)
    edges = {20: HEX_EDGES, 10: TET_EDGES}.get(nodes, [])
    middles = [(corners[:, a] + corners[:, b]) // 2 for a, b in edges]
    places = np.stack([*corners.transpose(1, 0, 2), *middles], axis=1)
    used, at = np.unique(np.ravel_multi_index(places.reshape(-1, 3).T, count), return_inverse=True)
    elements = at.reshape(len(places), nodes) + 1
    grid = np.stack(np.unravel_index(used, count), axis=1)
    step = np.array(size) / (count - 1)
    xyz = grid * step
    inner = ((grid > 0) & (grid < count - 1)).all(axis=1) & (grid % 2 == 0).all(axis=1)
    xyz[inner] += skew * 2 * step * np.random.default_rng(2).uniform(-1, 1, (int(inner.sum()), 3))
    for k, (a, b) in enumerate(edges, len(corners[0])):
        xyz[elements[:, k] - 1] = (xyz[elements[:, a] - 1] + xyz[elements[:, b] - 1]) / 2
    return xyz, elements


#: A plate of two quads and two triangles on two legs, in mm, written by hand; node 9 belongs to
#: nothing.
MSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
4
0 4 "tip"
1 3 "legs"
1 5 "foot"
2 7 "top"
$EndPhysicalNames
$Entities
1 2 1 0
1 0 0 500 1 4
1 0 0 0 0 0 500 1 3 0
2 0 0 0 1000 0 0 1 5 0
1 0 0 500 1000 1000 500 1 7 0
$EndEntities
$Nodes
2 9 11 40
2 1 0 6
11
12
13
14
15
16
0 0 500
500 0 500
1000 0 500
0 1000 500
500 1000 500
1000 1000 500
1 1 0 3
40
20
21
7 7 7
0 0 0
1000 0 0
$EndNodes
$Elements
5 8 1 8
0 1 15 1
1 13
1 1 1 2
2 20 11
3 21 13
1 2 1 1
4 20 21
2 1 3 1
5 11 12 15 14
2 1 2 2
6 12 13 16
7 12 16 15
$EndElements
"""
