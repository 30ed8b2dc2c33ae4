"""Elements of universal files (dataset 2412): faces written and read, shapes of elements, bad files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyuff

import uff_samples as uff
import updyn
from updyn.errors import FormatError

BOX = np.array([[x, y, z] for z in (0.0, 1.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])


def nodes(xyz) -> bytes:
    """A dataset 2411 with nodes from 1."""
    lines = []
    for number, row in enumerate(xyz, 1):
        lines += [f"{number:10d}{0:10d}{0:10d}{0:10d}", "".join(f"{v:25.16E}" for v in row)]
    return uff.text(2411, *lines)


def element(number: int, kind: int, *corners: int) -> list[str]:
    head = "".join(f"{v:10d}" for v in (number, kind, 1, 1, 7, len(corners)))
    beam = ["".join(f"{v:10d}" for v in (0, 1, 1))] if kind in (11, 21, 22, 24) else []
    rows = [corners[i : i + 8] for i in range(0, len(corners), 8)]
    return [head, *beam, *("".join(f"{v:10d}" for v in row) for row in rows)]


def put(tmp_path: Path, *parts: bytes) -> Path:
    path = tmp_path / "mesh.unv"
    path.write_bytes(b"".join(parts))
    return path


def mesh(tmp_path: Path, *elements: list[str], xyz=None, more: bytes = b"") -> updyn.Geometry:
    lines = [line for one in elements for line in one]
    path = put(tmp_path, nodes(BOX if xyz is None else xyz), uff.text(2412, *lines), more)
    return updyn.read_geometry(path)


def as_sets(rows) -> set[frozenset[int]]:
    return {frozenset(row) for row in rows.tolist()}


SIDES = ((1, 2, 3, 4), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8))


def test_a_brick_has_its_outer_faces_and_edges(tmp_path: Path) -> None:
    found = mesh(tmp_path, element(1, 115, *range(1, 9)))
    assert as_sets(found.faces) == set(map(frozenset, SIDES))
    assert len(found.lines) == 12


def test_shells_beams_and_masses(tmp_path: Path) -> None:
    found = mesh(
        tmp_path,
        element(1, 94, 1, 2, 3, 4),
        element(2, 91, 5, 6, 7),
        element(3, 21, 1, 5),
        element(4, 161, 8),  # a lumped mass
        element(5, 136, 2, 6),  # a spring
    )
    assert found.faces.tolist() == [[1, 2, 3, 4], [5, 6, 7, 7]]
    assert as_sets(found.lines) == set(
        map(frozenset, [(1, 2), (2, 3), (3, 4), (1, 4), (5, 6), (6, 7), (5, 7), (1, 5)])
    )


def test_nodes_on_edges_are_between_their_corners(tmp_path: Path) -> None:
    """A brick of 20 nodes, whose corners are found by their positions; a tetrahedron of 10."""
    bottom = [0, 1, 2, 3]
    order: list[np.ndarray] = []
    for level in (0, 4):
        for a, b in zip(bottom, [1, 2, 3, 0], strict=True):
            order += [BOX[a + level], 0.5 * (BOX[a + level] + BOX[b + level])]
        if level == 0:
            order += [0.5 * (BOX[a] + BOX[a + 4]) for a in bottom]
    found = mesh(tmp_path, element(1, 116, *range(1, 21)), xyz=order)
    corners = found.position(np.unique(found.faces))
    assert {tuple(row) for row in corners.tolist()} == {tuple(row) for row in BOX.tolist()}
    assert np.ptp(found.position(found.faces.ravel()).reshape(-1, 4, 3), axis=1).max() == 1.0

    a, b, c, d = np.vstack([np.zeros(3), np.eye(3)])
    order = [
        a,
        (a + b) / 2,
        b,
        (b + c) / 2,
        c,
        (c + a) / 2,
        (a + d) / 2,
        (b + d) / 2,
        (c + d) / 2,
        d,
    ]
    found = mesh(tmp_path, element(1, 118, *range(1, 11)), xyz=order)
    assert as_sets(found.faces) == {
        frozenset(face) for face in ((1, 3, 5), (1, 3, 10), (3, 5, 10), (1, 5, 10))
    }


def test_trace_lines_replace_edges(tmp_path: Path) -> None:
    trace = uff.text(82, f"{1:10d}{2:10d}{8:10d}", "NONE", f"{1:10d}{7:10d}")
    found = mesh(tmp_path, element(1, 94, 1, 2, 3, 4), more=trace)
    assert found.lines.tolist() == [[1, 7]]
    assert found.faces.tolist() == [[1, 2, 3, 4]]


def test_faces_are_written_and_read_by_pyuff(tmp_path: Path) -> None:
    geometry = updyn.Geometry(
        np.arange(1, 9), BOX, [[1, 2]], faces=[[1, 2, 3, 4], [5, 6, 7, 7], [1, 2, 6, 5]]
    )
    modes = updyn.ModeSet([3.0], [[1.0]], ["1:Z"])
    path = tmp_path / "modes.unv"
    updyn.write_shapes(modes, path, geometry)
    found = updyn.read_geometry(path)
    assert as_sets(found.faces) == as_sets(geometry.faces)
    assert found.lines.tolist() == [[1, 2]]
    (read,) = [s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 2412]
    assert [list(one["nodes_nums"]) for one in read[94]] == [[1, 2, 3, 4], [1, 2, 6, 5]]
    assert [list(one["nodes_nums"]) for one in read[91]] == [[5, 6, 7]]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (element(1, 94, 1, 2, 3, 9), r"mesh\.unv:22: .*node 9 of the element has no position"),
        (element(1, 94, 1, 2, 3), "3 nodes of an element 94; expected at least 4"),
        (element(1, 94, 1, 2, 3, 4)[:1], "4 nodes in too few lines"),
        (["         1        94         1         1         7         0"], "0 nodes in too few"),
        (["         1        94"], "dataset 2412, element"),
        ([element(1, 94, 1, 2, 3, 4)[0], "         1         2         x"], "dataset 2412, node"),
    ],
)
def test_bad_elements(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        mesh(tmp_path, lines)
