"""Lines to draw: the edges of the elements."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from updyn.elements.structure.parts import Beam, Part, Shell, Spring, Truss

__all__ = ["lines_of"]


def lines_of(parts: Iterable[Part]) -> NDArray[np.int64]:
    """Return the edges of all elements once, shape (n, 2), as node numbers."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for part in parts:
        if isinstance(part, Beam | Truss):
            pairs.append(part.connectivity)
        elif isinstance(part, Shell):
            pairs.append(np.stack([part.connectivity, np.roll(part.connectivity, -1, axis=1)], axis=2).reshape(-1, 2))
        elif isinstance(part, Spring) and part.second is not None:
            pairs.append(np.array([[part.first, part.second]]))
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
