"""`LossTable`: the course of a loss factor over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.errors import ModelError

__all__ = ["LossTable", "as_table"]

#: A line may be so far outside, as a share, by rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False, init=False)
class LossTable:
    """The course of a loss factor over frequency, relative to its value: linear between lines, nothing outside them.

    Parameters
    ----------
    freq : array_like of float, shape (n,)
        Lines in Hz, ascending; two at least.
    relative : array_like of float, shape (n,)
        Factor on the loss factor at each of them; not negative.

    Raises
    ------
    ModelError
        If the two do not fit together, or a number is not usable.
    """

    freq: NDArray[np.float64]
    relative: NDArray[np.float64]

    def __init__(self, freq: ArrayLike, relative: ArrayLike) -> None:
        for name, given in (("freq", freq), ("relative", relative)):
            try:
                array = np.array(given, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise ModelError(f"loss_table: {name} is not a row of numbers ({error})") from error
            if (
                array.ndim != 1
                or array.size < 2
                or not np.isfinite(array).all()
                or (array < 0).any()
            ):
                raise ModelError(
                    f"loss_table: {name}: expected two or more finite numbers of at least 0"
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.freq) != len(self.relative):
            raise ModelError(
                f"loss_table: {len(self.freq)} lines, but {len(self.relative)} factors"
            )
        back = np.flatnonzero(np.diff(self.freq) <= 0)
        if back.size:
            raise ModelError(
                f"loss_table: line {self.freq[back[0] + 1]:g} Hz stands behind"
                f" {self.freq[back[0]]:g} Hz"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return LossTable, (self.freq, self.relative)

    def __repr__(self) -> str:
        return f"LossTable({len(self.freq)} lines, {self.freq[0]:g} to {self.freq[-1]:g} Hz)"

    def at(self, freq: NDArray[np.float64], group: str) -> NDArray[np.float64]:
        """Return the factor at some lines.

        Parameters
        ----------
        freq : ndarray of float, shape (n,)
            Lines in Hz.
        group : str
            Whose table it is, for messages.

        Returns
        -------
        ndarray of float, shape (n,)

        Raises
        ------
        ModelError
            If a line lies outside the table.
        """
        low, high = self.freq[0], self.freq[-1]
        outside = (freq < low * (1.0 - _ROUNDING)) | (freq > high * (1.0 + _ROUNDING))
        if outside.any():
            raise ModelError(
                f"group {group!r}: {freq[outside][0]:.10g} Hz is outside its loss table, which goes"
                f" from {low:.10g} to {high:.10g} Hz; nothing is extrapolated: extend the table, or"
                " stay inside"
            )
        return np.interp(freq, self.freq, self.relative)


def as_table(given: Any) -> LossTable | None:
    """Bring what `Group` takes as a table into one.

    Parameters
    ----------
    given : LossTable, pair of array_like, or None
        Two rows: lines in Hz and factors.

    Returns
    -------
    LossTable or None

    Raises
    ------
    ModelError
        If it is neither, or the numbers are not usable.
    """
    if given is None or isinstance(given, LossTable):
        return given
    if isinstance(given, str) or not hasattr(given, "__len__") or len(given) != 2:
        raise ModelError(
            "loss_table: expected two rows, lines in Hz and factors on the loss factor"
        )
    return LossTable(given[0], given[1])
