"""`Group`: one named part of a model, its matrices and its damping.

Contribution of a group to the dynamic stiffness (Bao, Wang & Cheng 2010, eqs. 3 and 13-15, with C1
and C2 of eq. 1; the Rayleigh terms after Rayleigh, The Theory of Sound, vol. 1, 2nd ed. 1894,
section 97)::

    Z_e(omega) = (1 + i gamma r(f) + i omega beta) K + i omega C - (omega^2 - i omega alpha) M

with the loss factor gamma, its relative variation r over frequency (1 without a table), and the
Rayleigh coefficients alpha (1/s, `mass_damping`) and beta (s, `stiffness_damping`). All are
relative to the current matrices: a factor on a group's stiffness or mass also multiplies the
damping proportional to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, TypeGuard

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.errors import ModelError, suggest
from updyn.exchanged import AxisExchange
from updyn.grouping import GroupOrigin
from updyn.settings import ROUNDING

__all__ = [
    "DAMPING",
    "GROUP_QUANTITIES",
    "MATRICES",
    "ROUNDING",
    "VALUES",
    "Group",
    "LossTable",
    "Matrix",
    "as_table",
    "is_number",
    "read_only",
]

#: A real symmetric `scipy.sparse.csr_array`.
Matrix: TypeAlias = sp.csr_array

MATRICES = ("stiffness", "mass", "viscous")

#: Quantities of a group that can change, and the matrix on which each acts. Matrices change by a
#: factor; all others are values.
GROUP_QUANTITIES = {
    "stiffness": "stiffness",
    "mass": "mass",
    "viscous": "viscous",
    "loss_factor": "stiffness",
    "mass_damping": "mass",
    "stiffness_damping": "stiffness",
}

#: Quantities that are values, with their units; all are damping, not negative, and 0 by default.
VALUES = {"loss_factor": "", "mass_damping": "1/s", "stiffness_damping": "s"}

#: All damping of a group except its viscous matrix, by argument name of `Group`.
DAMPING = (*VALUES, "loss_table")


#: Integers from here on do not fit a double.
_LARGEST = 2**1023
_NO_ORIGIN = GroupOrigin()


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Group:
    """One part of a model: an element, a property, a material or a joint.

    Parameters
    ----------
    stiffness, mass : array_like or sparse, shape (N, N), optional
        Real symmetric contribution of the part to K (N/m) and M (kg), in the DOFs of the model.
        None if the part has no such contribution.
    loss_factor : float
        Structural (hysteretic) loss factor gamma, relative to `stiffness`; not negative.
    viscous : array_like or sparse, shape (N, N), optional
        Contribution of the part to C1 (N s/m).
    mass_damping : float
        Rayleigh coefficient alpha in 1/s: alpha times `mass` is added to the viscous damping. Not
        negative.
    stiffness_damping : float
        Rayleigh coefficient beta in s: beta times `stiffness` is added to the viscous damping. Not
        negative.
    loss_table : LossTable or (array_like, array_like), optional
        Frequencies in Hz and factors: the loss factor is `loss_factor` times the factor at each
        frequency, with linear interpolation. Evaluation outside the table is an error.

    Attributes
    ----------
    exchanged : AxisExchange or None
        The same part with exchanged section axes of its beams, if it was made of elements with
        known sections (`with_exchanged`); used by the search for causes. None for other matrices;
        not stored with a model.
    origin : GroupOrigin
        Materials and sets of the group, and the original groups of a merged one
        (`Model.merge_groups`), of which only the latter are stored with a model.

    Raises
    ------
    ModelError
        If a matrix is not square, real, finite and symmetric (to 1e-10 of its largest entry),
        sizes differ, a damping coefficient is not a finite number of at least 0, or the matrix on
        which a damping coefficient above 0 or a loss table acts is missing.

    Examples
    --------
    >>> import numpy as np
    >>> spring = updyn.Group(np.array([[1e4, -1e4], [-1e4, 1e4]]), loss_factor=0.02)
    >>> spring.loss_factor
    0.02
    """

    stiffness: Matrix | None
    mass: Matrix | None
    loss_factor: float
    viscous: Matrix | None
    mass_damping: float
    stiffness_damping: float
    loss_table: LossTable | None
    exchanged: AxisExchange | None = field(init=False)
    origin: GroupOrigin = field(init=False)

    def __init__(
        self,
        stiffness: ArrayLike | Matrix | None = None,
        mass: ArrayLike | Matrix | None = None,
        loss_factor: float = 0.0,
        viscous: ArrayLike | Matrix | None = None,
        *,
        mass_damping: float = 0.0,
        stiffness_damping: float = 0.0,
        loss_table: LossTable | tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        object.__setattr__(self, "exchanged", None)
        object.__setattr__(self, "origin", _NO_ORIGIN)
        sizes = {}
        for name, given in (("stiffness", stiffness), ("mass", mass), ("viscous", viscous)):
            matrix = None
            if given is not None:
                matrix = _symmetric(given, name)
                sizes[name] = matrix.shape[0]
            object.__setattr__(self, name, matrix)
        if not sizes:
            raise ModelError("a group needs at least one of stiffness, mass and viscous")
        if len(set(sizes.values())) > 1:
            raise ModelError(f"the matrices of a group differ in size: {sizes}")
        self._set_damping(loss_factor, mass_damping, stiffness_damping, loss_table)

    def _set_damping(
        self,
        loss_factor: object,
        mass_damping: object,
        stiffness_damping: object,
        loss_table: object,
    ) -> None:
        object.__setattr__(self, "loss_factor", _check_damping("loss factor", loss_factor))
        object.__setattr__(self, "mass_damping", _check_damping("mass_damping", mass_damping))
        stiffness_rate = _check_damping("stiffness_damping", stiffness_damping)
        object.__setattr__(self, "stiffness_damping", stiffness_rate)
        for name in VALUES:
            value = getattr(self, name)
            if value and not self.has(name):
                raise ModelError(
                    f"{name} {value:g}: the group has no {GROUP_QUANTITIES[name]} that it could"
                    " act on"
                )
        object.__setattr__(self, "loss_table", as_table(loss_table))
        if self.loss_table is not None and self.stiffness is None:
            raise ModelError("loss_table: the group has no stiffness that it could act on")

    @classmethod
    def _build_unchecked(
        cls,
        stiffness: Matrix,
        mass: Matrix,
        viscous: Matrix,
        damping: Mapping[str, object],
        exchanged: AxisExchange | None,
        origin: GroupOrigin,
    ) -> Group:
        """Build from matrices of an existing `Group`, without a second check."""
        out = cls.__new__(cls)
        object.__setattr__(out, "exchanged", exchanged)
        object.__setattr__(out, "origin", origin)
        for name, matrix in (("stiffness", stiffness), ("mass", mass), ("viscous", viscous)):
            if matrix is not None:
                matrix = read_only(matrix)
            object.__setattr__(out, name, matrix)
        rest = {"mass_damping": 0.0, "stiffness_damping": 0.0, "loss_table": None, **damping}
        out._set_damping(**rest)
        return out

    def __reduce__(self) -> tuple[object, ...]:
        rest = (self.damping, self.exchanged, self.origin)
        return Group._build_unchecked, (*self._matrices, *rest)

    def __repr__(self) -> str:
        has = [name for name in MATRICES if getattr(self, name) is not None]
        return f"Group({', '.join(has)}; {self.n_dofs} DOFs, {self.damping_words})"

    @property
    def _matrices(self) -> tuple[Matrix | None, Matrix | None, Matrix | None]:
        """Stiffness, mass and viscous damping."""
        return self.stiffness, self.mass, self.viscous

    @property
    def n_dofs(self) -> int:
        """Number of DOFs N of the matrices."""
        given = next(m for m in self._matrices if m is not None)
        return int(given.shape[0])

    @property
    def damping(self) -> dict[str, Any]:
        """The damping except the viscous matrix, by argument name of `Group`."""
        out: dict[str, object] = {"loss_factor": self.loss_factor}
        for name in VALUES:
            value = getattr(self, name)
            if value:
                out[name] = value
        if self.loss_table is not None:
            out["loss_table"] = self.loss_table
        return out

    @property
    def damping_words(self) -> str:
        """The damping except the viscous matrix, as text."""
        units = {name: f" {unit}".rstrip() for name, unit in VALUES.items()}
        parts = [
            f"{name.replace('_', ' ')} {value:g}{units[name]}"
            for name, value in self.damping.items()
            if name in VALUES
        ]
        if self.loss_table is not None:
            parts[0] += (
                f" by a table from {self.loss_table.freq[0]:g} to {self.loss_table.freq[-1]:g} Hz"
            )
        return ", ".join(parts)

    def has(self, quantity: str) -> bool:
        """Return whether the group has the matrix that a quantity acts on.

        Parameters
        ----------
        quantity : str
            One of `GROUP_QUANTITIES`.

        Returns
        -------
        bool

        Raises
        ------
        ModelError
            If the quantity is unknown.
        """
        if quantity not in GROUP_QUANTITIES:
            raise ModelError(
                f"no quantity {quantity!r}; {suggest(str(quantity), GROUP_QUANTITIES)}"
            )
        return getattr(self, GROUP_QUANTITIES[quantity]) is not None

    def value(self, quantity: str) -> float:
        """Return the value of a quantity in this group.

        Parameters
        ----------
        quantity : str
            One of `GROUP_QUANTITIES`.

        Returns
        -------
        float
            1 for a factor, otherwise the value in the group.
        """
        if quantity not in VALUES:
            return 1.0
        return float(getattr(self, quantity))

    def loss_at(self, freq: float, name: str) -> float:
        """Return the loss factor at a frequency.

        Parameters
        ----------
        freq : float
            Frequency in Hz.
        name : str
            Name of the group, for messages.

        Returns
        -------
        float

        Raises
        ------
        ModelError
            If the frequency lies outside the group's table.
        """
        if self.loss_table is None or not self.loss_factor:
            return self.loss_factor
        return self.loss_factor * float(self.loss_table.at(np.array([freq]), name)[0])

    def viscous_part(self) -> Matrix | None:
        """Return the viscous matrix plus alpha M plus beta K; None if all are zero."""
        shares = (
            (self.viscous, 1.0),
            (self.mass, self.mass_damping),
            (self.stiffness, self.stiffness_damping),
        )
        total = None
        for matrix, share in shares:
            if matrix is None or not share:
                continue
            part = matrix
            if share != 1.0:
                part = matrix * share
            total = part if total is None else total + part
        return total

    def with_matrices(
        self, stiffness: Matrix | None, mass: Matrix | None, viscous: Matrix | None
    ) -> Group:
        """Return a group of other matrices with the same damping coefficients.

        Parameters
        ----------
        stiffness, mass, viscous : array_like or sparse, shape (N, N), optional
            As for `Group`.

        Returns
        -------
        Group

        Raises
        ------
        ModelError
            As `Group` does.
        """
        return Group(stiffness, mass, viscous=viscous, **self.damping).with_origin(self.origin)

    def transformed(self, change: Callable[[Matrix], Matrix], T: Matrix) -> Group:
        """Return the group in other DOFs, including its variant with exchanged section axes.

        Parameters
        ----------
        change : callable
            Function that returns T^T A T, a matrix in the new DOFs.
        T : sparse, shape (N, n)
            DOFs of this group as combinations of the new DOFs.

        Returns
        -------
        Group
        """
        K, M, C = (None if A is None else change(A) for A in self._matrices)
        exchanged = None if self.exchanged is None else self.exchanged.transform(T)
        return self.with_matrices(K, M, C).with_exchanged(exchanged)

    def with_exchanged(self, exchanged: AxisExchange | None) -> Group:
        """Return the group with a description of its variant with exchanged section axes.

        Parameters
        ----------
        exchanged : AxisExchange or None
            The variant; None if unknown.

        Returns
        -------
        Group
        """
        return Group._build_unchecked(*self._matrices, self.damping, exchanged, self.origin)

    def with_origin(self, origin: GroupOrigin) -> Group:
        """Return the group with a description of its source.

        Parameters
        ----------
        origin : GroupOrigin
            Materials, sets and original groups.

        Returns
        -------
        Group
        """
        return Group._build_unchecked(*self._matrices, self.damping, self.exchanged, origin)

    def with_exchanged_axes(self) -> Group:
        """Return the group with the section axes of its beams exchanged.

        Returns
        -------
        Group
            The group, without a description of the variant.

        Raises
        ------
        ModelError
            If the sections are unknown, or the elements cannot be computed.
        """
        if self.exchanged is None:
            raise ModelError("the group has no beams whose section axes are known")
        found = self.exchanged.matrices()
        return self.with_matrices(found.stiffness, found.mass, self.viscous)

    def with_damping(self, damping: Mapping[str, object]) -> Group:
        """Return a group with the same matrices and other damping.

        Parameters
        ----------
        damping : mapping of str to float, LossTable or None
            ``loss_factor``, ``mass_damping``, ``stiffness_damping`` and ``loss_table`` as for
            `Group`; other damping is unchanged.

        Returns
        -------
        Group

        Raises
        ------
        ModelError
            If a name is not one of these, or a value is invalid.
        """
        for name in damping:
            if name not in DAMPING:
                raise ModelError(f"no damping {name!r}; {suggest(str(name), DAMPING)}", key=(name,))
        changed = self.damping | dict(damping)
        return Group._build_unchecked(*self._matrices, changed, self.exchanged, self.origin)

    def changed(self, change: Mapping[str, float]) -> Group:
        """Return a changed copy, without checks.

        Parameters
        ----------
        change : mapping of str to float
            As for `Model.scaled`.

        Returns
        -------
        Group
            The copy; unchanged matrices are shared with this group.
        """
        new = {name: change[name] for name in VALUES if name in change}
        stiffness, mass, viscous = (
            _scale_matrix(getattr(self, name), change.get(name, 1.0)) for name in MATRICES
        )
        exchanged = self.exchanged
        if exchanged is not None:
            factors = (change.get(name, 1.0) for name in ("stiffness", "mass"))
            exchanged = exchanged.scale(*factors)
        damping = self.damping | new
        return Group._build_unchecked(stiffness, mass, viscous, damping, exchanged, self.origin)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number; False for booleans and too large integers."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < _LARGEST
    return isinstance(value, float | np.floating | np.integer)


def _check_damping(name: str, value: object) -> float:
    if not is_number(value):
        raise ModelError(f"{name} {value!r}: expected a number")
    if not (math.isfinite(value) and value >= 0):
        raise ModelError(f"{name} {value!r}: expected a finite number of at least 0")
    return float(value)


def _scale_matrix(matrix: Matrix | None, factor: float) -> Matrix | None:
    if matrix is None or factor == 1.0:
        return matrix
    return sp.csr_array(
        (matrix.data * float(factor), matrix.indices, matrix.indptr), shape=matrix.shape
    )


def read_only(matrix: Matrix) -> Matrix:
    """Make the arrays of a compressed sparse matrix read-only, and return the same object."""
    for array in (matrix.data, matrix.indices, matrix.indptr):
        array.flags.writeable = False
    return matrix


def _symmetric(given: ArrayLike | Matrix, name: str) -> Matrix:
    """Return a read-only canonical CSR array, checked to be real, finite and symmetric."""
    array: Any = given
    if not sp.issparse(given):
        if np.ma.is_masked(given):
            raise ModelError(f"{name}: holds masked values")
        try:
            array = np.asarray(given)
        except ValueError as error:
            raise ModelError(f"{name}: not a matrix of numbers ({error})") from error
    if array.dtype.kind == "c":
        raise ModelError(
            f"{name}: found complex numbers; damping goes into loss_factor and viscous"
        )
    if array.dtype.kind not in "iuf":
        raise ModelError(f"{name}: expected a matrix of numbers, found {array.dtype}")
    if array.ndim != 2 or array.shape[0] != array.shape[1] or array.shape[0] == 0:
        raise ModelError(f"{name}: expected a square matrix, found shape {array.shape}")
    matrix = sp.csr_array(array).astype(np.float64)
    matrix.sum_duplicates()
    if not np.isfinite(matrix.data).all():
        row = int(
            np.searchsorted(
                matrix.indptr, np.flatnonzero(~np.isfinite(matrix.data))[0], side="right"
            )
        )
        raise ModelError(f"{name}: row {row} holds a number that is not finite")
    skew = abs(matrix - matrix.T)
    largest = float(np.abs(matrix.data).max(initial=0.0))
    if skew.nnz and skew.data.max() > ROUNDING.relative * largest:
        worst = skew.tocoo()
        at = int(np.argmax(worst.data))
        i, j = int(worst.row[at]), int(worst.col[at])
        raise ModelError(
            f"{name} is not symmetric: entry ({i + 1}, {j + 1}) is {matrix[i, j]:g}, "
            f"({j + 1}, {i + 1}) is {matrix[j, i]:g}"
        )
    if skew.nnz and skew.data.max() > 0.0:
        matrix = sp.csr_array((matrix + matrix.T) * 0.5)
    matrix.sort_indices()
    return read_only(matrix)


@dataclass(frozen=True, slots=True, eq=False, init=False)
class LossTable:
    """Relative loss factor over frequency, linear between lines and undefined outside.

    Parameters
    ----------
    freq : array_like of float, shape (n,)
        Frequencies in Hz, ascending; at least two.
    relative : array_like of float, shape (n,)
        Factor on the loss factor at each frequency; not negative.

    Raises
    ------
    ModelError
        If the two lengths differ, or a number is invalid.

    Examples
    --------
    >>> updyn.LossTable([10.0, 100.0], [0.02, 0.05])
    LossTable(2 lines, 10 to 100 Hz)
    """

    freq: RealArray
    relative: RealArray

    def __init__(self, freq: ArrayLike, relative: ArrayLike) -> None:
        for name, given in (("freq", freq), ("relative", relative)):
            try:
                array = np.array(given, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise ModelError(
                    f"loss_table: {name} is not a row of numbers ({error})", key=("loss_table",)
                ) from error
            if (
                array.ndim != 1
                or array.size < 2
                or not np.isfinite(array).all()
                or (array < 0).any()
            ):
                raise ModelError(
                    f"loss_table: {name}: expected two or more finite numbers of at least 0",
                    key=("loss_table",),
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.freq) != len(self.relative):
            raise ModelError(
                f"loss_table: {len(self.freq)} lines, but {len(self.relative)} factors",
                key=("loss_table",),
            )
        back = np.flatnonzero(np.diff(self.freq) <= 0)
        if back.size:
            raise ModelError(
                f"loss_table: line {self.freq[back[0] + 1]:g} Hz follows {self.freq[back[0]]:g} Hz",
                key=("loss_table",),
            )

    def __reduce__(self) -> tuple[object, ...]:
        return LossTable, (self.freq, self.relative)

    def __repr__(self) -> str:
        return f"LossTable({len(self.freq)} lines, {self.freq[0]:g} to {self.freq[-1]:g} Hz)"

    def at(self, freq: RealArray, group: str) -> RealArray:
        """Return the factor at given frequencies.

        Parameters
        ----------
        freq : ndarray of float, shape (n,)
            Frequencies in Hz.
        group : str
            Name of the group, for messages.

        Returns
        -------
        ndarray of float, shape (n,)

        Raises
        ------
        ModelError
            If a frequency lies outside the table.
        """
        low, high = self.freq[0], self.freq[-1]
        below = freq < low * (1.0 - ROUNDING.relative)
        outside = below | (freq > high * (1.0 + ROUNDING.relative))
        if outside.any():
            raise ModelError(
                f"group {group!r}: {freq[outside][0]:.10g} Hz is outside its loss table, which goes"
                f" from {low:.10g} to {high:.10g} Hz; nothing is extrapolated: extend the table, or"
                " stay inside"
            )
        return np.interp(freq, self.freq, self.relative)

    def slope_at(self, freq: RealArray) -> RealArray:
        """Return the derivative of the factor by frequency, that to the right at a line.

        Parameters
        ----------
        freq : ndarray of float, shape (n,)
            Frequencies in Hz within the table.

        Returns
        -------
        ndarray of float, shape (n,)
            In 1/Hz.
        """
        at = np.clip(np.searchsorted(self.freq, freq, side="right") - 1, 0, len(self.freq) - 2)
        return np.asarray((np.diff(self.relative) / np.diff(self.freq))[at])


def as_table(given: Any) -> LossTable | None:
    """Return a `LossTable` from a value that `Group` accepts; ModelError for other values."""
    if given is None or isinstance(given, LossTable):
        return given
    if isinstance(given, str) or not hasattr(given, "__len__") or len(given) != 2:
        raise ModelError(
            "loss_table: expected two rows, lines in Hz and factors on the loss factor"
        )
    return LossTable(given[0], given[1])
