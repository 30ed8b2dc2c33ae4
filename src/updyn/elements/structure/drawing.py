"""Lines to draw: the edges of the elements."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from updyn.elements.structure.parts import Beam, Part, Shell, Solid, Spring, Truss
from updyn.elements.structure.solids import CORNERS, FACES

__all__ = ["lines_of"]


def lines_of(parts: Iterable[Part]) -> NDArray[np.int64]:
    """Return the edges of all elements once, of solids those on their outside, shape (n, 2), as node numbers."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for part in parts:
        if isinstance(part, Beam | Truss):
            pairs.append(part.connectivity)
        elif isinstance(part, Shell):
            pairs.append(
                np.stack(
                    [part.connectivity, np.roll(part.connectivity, -1, axis=1)], axis=2
                ).reshape(-1, 2)
            )
        elif isinstance(part, Solid):
            pairs.append(_outline(part.connectivity))
        elif isinstance(part, Spring) and part.second is not None:
            pairs.append(np.array([[part.first, part.second]]))
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)


def _outline(solids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges, corner to corner, of the faces that one element only has, shape (n, 2)."""
    faces = solids[:, np.array(FACES[CORNERS[solids.shape[1]]])].reshape(
        -1, len(FACES[CORNERS[solids.shape[1]]][0])
    )
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = faces[first[count == 1]]
    return np.stack([outer, np.roll(outer, -1, axis=1)], axis=2).reshape(-1, 2)
