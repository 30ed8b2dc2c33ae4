"""`Group` and `Model`: a finite-element model as a sum of named parts, immutable and affine in its unknowns.

The dynamic stiffness of a model is (Bao, Wang & Cheng 2010, eqs. 3 and 13-15, with C1 and C2 of eq. 1)::

    Z(omega) = sum over groups of  (1 + i gamma) K + i omega C - omega^2 M

A factor on a group's stiffness multiplies its K, and with it the damping gamma K.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.dofs import Dof, DofSet
from updyn.errors import ModelError, UpdynWarning, suggest
from updyn.geometry import Geometry

__all__ = ["GROUP_QUANTITIES", "Group", "Matrix", "Model"]

#: A real symmetric `scipy.sparse.csr_array`.
Matrix: TypeAlias = Any

#: What can change in a group. The first three are factors on the group's matrix, the last is a value.
GROUP_QUANTITIES = ("stiffness", "mass", "viscous", "loss_factor")

_ROUNDING = 1e-10
_DENSE_CHECK = 600


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Group:
    """One part of a model: an element, a property, a material or a joint.

    Parameters
    ----------
    stiffness, mass : array_like or sparse, shape (N, N), optional
        Real symmetric contribution of the part to K (N/m) and M (kg), in the DOFs of the model. None: the part has no
        such contribution.
    loss_factor : float
        Structural (hysteretic) loss factor gamma, relative to `stiffness`; not negative.
    viscous : array_like or sparse, shape (N, N), optional
        Likewise the contribution to C1 (N s/m).

    Raises
    ------
    ModelError
        If a matrix is not square, real, finite and symmetric (to 1e-10 of its largest entry), sizes differ, or the
        loss factor is not a finite number of at least 0.
    """

    stiffness: Matrix | None
    mass: Matrix | None
    loss_factor: float
    viscous: Matrix | None

    def __init__(
        self,
        stiffness: ArrayLike | Any | None = None,
        mass: ArrayLike | Any | None = None,
        loss_factor: float = 0.0,
        viscous: ArrayLike | Any | None = None,
    ) -> None:
        sizes = {}
        for name, given in (("stiffness", stiffness), ("mass", mass), ("viscous", viscous)):
            matrix = None if given is None else _symmetric(given, name)
            if matrix is not None:
                sizes[name] = matrix.shape[0]
            object.__setattr__(self, name, matrix)
        if not sizes:
            raise ModelError("a group needs at least one of stiffness, mass and viscous")
        if len(set(sizes.values())) > 1:
            raise ModelError(f"the matrices of a group differ in size: {sizes}")
        object.__setattr__(self, "loss_factor", _loss_factor(loss_factor))

    @classmethod
    def _checked(cls, stiffness: Matrix, mass: Matrix, loss_factor: float, viscous: Matrix) -> Group:
        """Build from matrices that came out of a `Group` and need no second check."""
        out = cls.__new__(cls)
        for name, matrix in (("stiffness", stiffness), ("mass", mass), ("viscous", viscous)):
            object.__setattr__(out, name, None if matrix is None else _read_only(matrix))
        object.__setattr__(out, "loss_factor", _loss_factor(loss_factor))
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        return Group._checked, (self.stiffness, self.mass, self.loss_factor, self.viscous)

    def __repr__(self) -> str:
        has = [name for name in ("stiffness", "mass", "viscous") if getattr(self, name) is not None]
        return f"Group({', '.join(has)}; {self.n_dofs} DOFs, loss factor {self.loss_factor:g})"

    @property
    def n_dofs(self) -> int:
        """Number of DOFs N of the matrices."""
        return int(next(m.shape[0] for m in (self.stiffness, self.mass, self.viscous) if m is not None))


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A structure as a sum of named groups on one set of DOFs.

    Massless DOFs (zero rows of M) and free-free structures (singular K) are normal. Build one with `from_groups`,
    which looks at the matrices too.

    Parameters
    ----------
    groups : mapping of str to Group
        The parts, in order.
    dofs : DofSet
        The N degrees of freedom.
    geometry : Geometry, optional
        Where the nodes stand.
    title : str
        For the record.

    Raises
    ------
    ModelError
        If a size does not fit, a name is not usable or a DOF is negative.
    """

    groups: Mapping[str, Group]
    dofs: DofSet
    geometry: Geometry | None = None
    title: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "dofs", DofSet(self.dofs))
        if (self.dofs.signs < 0).any():
            first = self.dofs[int(np.flatnonzero(self.dofs.signs < 0)[0])]
            raise ModelError(f"DOF {first}: the DOFs of a model are positive; the sign belongs to sensors and forces")
        if not isinstance(self.groups, Mapping):
            raise ModelError(f"groups: expected a mapping of name to Group, found {type(self.groups).__name__}")
        if not self.groups:
            raise ModelError("a model needs at least one group")
        for name, group in self.groups.items():
            _check_name(name)
            if not isinstance(group, Group):
                raise ModelError(f"group {name!r}: expected a Group, found {type(group).__name__}")
            if group.n_dofs != self.n_dofs:
                raise ModelError(f"group {name!r} has {group.n_dofs} DOFs, the model has {self.n_dofs} labels")
        object.__setattr__(self, "groups", MappingProxyType(dict(self.groups)))

    @classmethod
    def from_groups(
        cls,
        groups: Mapping[str, Group],
        dofs: Iterable[str | Dof],
        *,
        geometry: Geometry | None = None,
        title: str = "",
    ) -> Model:
        """Build and check a model.

        Parameters
        ----------
        groups : mapping of str to Group
            Parts by name. A name holds no dot and no glob character, as unknowns are called ``name.quantity``.
        dofs : iterable of str or Dof
            N labels, ``node:direction``, all positive.
        geometry : Geometry, optional
            Where the nodes stand.
        title : str
            For the record.

        Returns
        -------
        Model
            The sum of the groups.

        Raises
        ------
        ModelError
            If a size does not fit, a name is not usable, or a DOF has neither stiffness, mass nor damping.
        DofError
            If a label cannot be read or stands twice.

        Warns
        -----
        UpdynWarning
            If a group's K, M or C is indefinite beyond rounding: physically it stores or loses negative energy. Table
            rounding is enough to make one so.
        """
        model = cls(groups, DofSet(dofs), geometry, title)
        model._check_every_dof_is_used()
        for name, group in model.groups.items():
            for what in ("stiffness", "mass", "viscous"):
                matrix = getattr(group, what)
                if matrix is not None and (found := _negative(matrix)) is not None:
                    warnings.warn(
                        f"group {name!r}: {what} is indefinite ({found}); rounded tables and differences of matrices "
                        "do this, a wrong sign or a wrong unit too",
                        UpdynWarning,
                        stacklevel=2,
                    )
        return model

    def _check_every_dof_is_used(self) -> None:
        used = np.zeros(self.n_dofs, dtype=np.bool_)
        for group in self.groups.values():
            for matrix in (group.stiffness, group.mass, group.viscous):
                if matrix is not None:
                    used[matrix.indices[matrix.data != 0.0]] = True
        if not used.all():
            first = self.dofs[int(np.flatnonzero(~used)[0])]
            raise ModelError(
                f"DOF {first} has neither stiffness, mass nor damping ({int((~used).sum())} such): the model is "
                "singular at every frequency; leave such DOFs out"
            )

    def __repr__(self) -> str:
        return f"Model({self.n_dofs} DOFs, {len(self.groups)} groups: {', '.join(list(self.groups)[:6])})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Model, (dict(self.groups), self.dofs, self.geometry, self.title)

    @property
    def n_dofs(self) -> int:
        """Number of DOFs N."""
        return len(self.dofs)

    @property
    def stiffness(self) -> Matrix:
        """K, shape (N, N), real: the sum of the groups' stiffness."""
        return self._sum(lambda g: g.stiffness)

    @property
    def mass(self) -> Matrix:
        """M, shape (N, N), real: the sum of the groups' mass."""
        return self._sum(lambda g: g.mass)

    @property
    def viscous(self) -> Matrix:
        """C1, shape (N, N), real: the sum of the groups' viscous damping."""
        return self._sum(lambda g: g.viscous)

    @property
    def structural(self) -> Matrix:
        """D, shape (N, N), real: the sum of loss factor times stiffness, imaginary part of the stiffness."""
        return self._sum(lambda g: None if g.stiffness is None or not g.loss_factor else g.stiffness * g.loss_factor)

    def _sum(self, part: Callable[[Group], Matrix | None]) -> Matrix:
        total = sp.csr_array((self.n_dofs, self.n_dofs), dtype=np.float64)
        for group in self.groups.values():
            matrix = part(group)
            if matrix is not None:
                total = total + matrix
        return _read_only(total)

    def group(self, name: str) -> Group:
        """Return a group by name.

        Parameters
        ----------
        name : str
            The name.

        Returns
        -------
        Group
            The part of that name.

        Raises
        ------
        ModelError
            If there is none; the nearest names are given.
        """
        if not isinstance(name, str) or name not in self.groups:
            raise ModelError(f"no group {name!r}; {suggest(str(name), self.groups)}")
        return self.groups[name]

    def scaled(self, changes: Mapping[str, Mapping[str, float]]) -> Model:
        """Return a changed copy.

        Parameters
        ----------
        changes : mapping of str to mapping of str to float
            By group: ``stiffness``, ``mass`` and ``viscous`` are factors on what is there (1 = unchanged),
            ``loss_factor`` is the new value, relative to the changed stiffness.

        Returns
        -------
        Model
            The copy; what is unchanged is shared with this model.

        Raises
        ------
        ModelError
            If a group or a quantity is not there, a number is not finite, or a loss factor is negative.
        """
        if not isinstance(changes, Mapping):
            raise ModelError(f"changes: expected a mapping of group to quantities, found {type(changes).__name__}")
        groups = dict(self.groups)
        for name, change in changes.items():
            group = self.group(name)
            if not isinstance(change, Mapping):
                raise ModelError(f"group {name!r}: expected a mapping of quantity to number, found {change!r}")
            for quantity, value in change.items():
                _check_change(name, group, quantity, value)
            groups[name] = Group._checked(
                _times(group.stiffness, change.get("stiffness", 1.0)),
                _times(group.mass, change.get("mass", 1.0)),
                change.get("loss_factor", group.loss_factor),
                _times(group.viscous, change.get("viscous", 1.0)),
            )
        return Model(groups, self.dofs, self.geometry, self.title)


def _check_name(name: object) -> None:
    if not isinstance(name, str) or not name.strip() or name != name.strip():
        raise ModelError(f"group name {name!r}: expected a text without blanks at its ends")
    bad = sorted(set(name) & set(".*?[]\n\t"))
    if bad:
        raise ModelError(f"group name {name!r} holds {bad[0]!r}: unknowns are called name.quantity and chosen by glob")


def _check_change(name: str, group: Group, quantity: str, value: float) -> None:
    if quantity not in GROUP_QUANTITIES:
        raise ModelError(f"group {name!r}: no quantity {quantity!r}; {suggest(quantity, GROUP_QUANTITIES)}")
    if getattr(group, "stiffness" if quantity == "loss_factor" else quantity) is None:
        raise ModelError(f"group {name!r} has no {'stiffness' if quantity == 'loss_factor' else quantity} to change")
    if not _is_number(value):
        raise ModelError(f"group {name!r}: {quantity} {value!r}: expected a number")
    if not np.isfinite(value):
        raise ModelError(f"group {name!r}: {quantity} {value!r} is not finite")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool)


def _loss_factor(value: Any) -> float:
    if not _is_number(value):
        raise ModelError(f"loss factor {value!r}: expected a number")
    if not (np.isfinite(value) and value >= 0):
        raise ModelError(f"loss factor {value!r}: expected a finite number of at least 0")
    return float(value)


def _times(matrix: Matrix | None, factor: float) -> Matrix | None:
    if matrix is None or factor == 1.0:
        return matrix
    return sp.csr_array((matrix.data * float(factor), matrix.indices, matrix.indptr), shape=matrix.shape)


def _read_only(matrix: Matrix) -> Matrix:
    for array in (matrix.data, matrix.indices, matrix.indptr):
        array.flags.writeable = False
    return matrix


def _symmetric(given: ArrayLike | Any, name: str) -> Matrix:
    """Return `given` as a read-only canonical CSR array, after checking that it is real, finite and symmetric."""
    array: Any = given
    if not sp.issparse(given):
        if np.ma.is_masked(given):
            raise ModelError(f"{name}: holds masked values")
        try:
            array = np.asarray(given)
        except ValueError as error:
            raise ModelError(f"{name}: not a matrix of numbers ({error})") from error
    if array.dtype.kind == "c":
        raise ModelError(f"{name}: found complex numbers; damping goes into loss_factor and viscous")
    if array.dtype.kind not in "iuf":
        raise ModelError(f"{name}: expected a matrix of numbers, found {array.dtype}")
    if array.ndim != 2 or array.shape[0] != array.shape[1] or array.shape[0] == 0:
        raise ModelError(f"{name}: expected a square matrix, found shape {array.shape}")
    matrix = sp.csr_array(array).astype(np.float64)
    matrix.sum_duplicates()
    if not np.isfinite(matrix.data).all():
        row = int(np.searchsorted(matrix.indptr, np.flatnonzero(~np.isfinite(matrix.data))[0], side="right"))
        raise ModelError(f"{name}: row {row} holds a number that is not finite")
    skew = abs(matrix - matrix.T)
    largest = float(np.abs(matrix.data).max(initial=0.0))
    if skew.nnz and skew.data.max() > _ROUNDING * largest:
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
    return _read_only(matrix)


def _negative(matrix: Matrix) -> str | None:
    """Say how a matrix is indefinite beyond rounding, or return None.

    On at most 600 own DOFs the eigenvalues decide. On more, the diagonal and the 2 x 2 minors are looked at, which
    finds wrong signs but not every indefinite matrix.
    """
    own = np.unique(matrix.indices)
    if own.size == 0:
        return None
    if own.size <= _DENSE_CHECK:
        values = np.linalg.eigvalsh(matrix[own][:, own].toarray())
        low, high = float(values[0]), float(np.abs(values).max())
        return f"smallest eigenvalue {low:.3g}, largest {high:.3g}" if low < -_ROUNDING * high else None
    diagonal = matrix.diagonal()
    largest = float(np.abs(matrix.data).max())
    if diagonal.min() < -_ROUNDING * largest:
        return f"diagonal entry {int(np.argmin(diagonal)) + 1} is {diagonal.min():.3g}"
    upper = matrix.tocoo()
    off = np.flatnonzero(upper.row < upper.col)
    product = diagonal[upper.row[off]] * diagonal[upper.col[off]]
    # Rounding may lift an entry above the geometric mean of its diagonal entries, or stand beside a diagonal of 0.
    excess = upper.data[off] ** 2 - product - 1e-8 * np.abs(product) - (_ROUNDING * largest) ** 2
    if excess.size and excess.max() > 0.0:
        at = off[int(np.argmax(excess))]
        return f"entry ({upper.row[at] + 1}, {upper.col[at] + 1}) outweighs its diagonal entries"
    return None
