"""Types of arrays, by the kind of number."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BoolArray",
    "ComplexArray",
    "IndexArray",
    "IntArray",
    "IntegerArray",
    "NumberArray",
    "RealArray",
]

RealArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
#: Positions in another array.
IndexArray: TypeAlias = NDArray[np.intp]
IntArray: TypeAlias = NDArray[np.int64]
#: Integers of any size.
IntegerArray: TypeAlias = NDArray[np.integer]
BoolArray: TypeAlias = NDArray[np.bool_]
#: Numbers of any type: real, complex, of single or of double precision.
NumberArray: TypeAlias = NDArray[Any]
