"""`Model`: a finite-element model as a sum of named groups, immutable and affine in its unknowns.

The dynamic stiffness of a model is (Bao, Wang & Cheng 2010, eqs. 3 and 13-15, with C1 and C2 of
eq. 1)::

    Z(omega) = sum over groups of  (1 + i gamma) K + i omega C - omega^2 M

A factor on a group's stiffness multiplies its K and thereby the damping gamma K. `updyn.group`
describes all kinds of damping of a group.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp

from updyn.dofs import Dof, DofSet
from updyn.errors import ModelError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.group import GROUP_QUANTITIES, MATRICES, VALUES, Group, Matrix, is_number, read_only
from updyn.merging import merge_groups, split_changes
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import LocalElement, Place, place_element
from updyn.notebook import card, render_view, structure, table
from updyn.settings import MODEL_CHECK, ROUNDING

__all__ = ["GROUP_QUANTITIES", "VALUES", "Group", "Matrix", "Model"]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A structure as a sum of named groups on one set of DOFs.

    Massless DOFs (zero rows of M) and free-free structures (singular K) are allowed. Use
    `from_groups` to build a model: it also checks the matrices.

    Parameters
    ----------
    groups : mapping of str to Group
        The parts, in order.
    dofs : DofSet
        The N degrees of freedom.
    geometry : Geometry, optional
        Positions of the nodes.
    title : str
        Title, for documentation.
    nonlinear : mapping of str to LocalElement
        Nonlinear elements by name, added by `with_elements`. Linear methods refuse a model that
        has any.

    Raises
    ------
    ModelError
        If a size does not match, a name is invalid or a DOF is negative.
    DofError
        If a nonlinear element acts on a DOF that the model does not have.

    Examples
    --------
    >>> import numpy as np
    >>> spring = updyn.Group(np.array([[1e4]]), np.array([[0.5]]), loss_factor=0.02)
    >>> model = updyn.Model.from_groups({"spring": spring}, ["1:X"])
    >>> model.scaled({"spring": {"stiffness": 1.2}}).stiffness.toarray()
    array([[12000.]])
    """

    groups: Mapping[str, Group]
    dofs: DofSet
    geometry: Geometry | None = None
    title: str = ""
    nonlinear: Mapping[str, LocalElement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "dofs", DofSet(self.dofs))
        if (self.dofs.signs < 0).any():
            first = self.dofs[int(np.flatnonzero(self.dofs.signs < 0)[0])]
            raise ModelError(
                f"DOF {first}: the DOFs of a model are positive; the sign belongs to sensors and"
                " forces"
            )
        if not isinstance(self.groups, Mapping):
            raise ModelError(
                f"groups: expected a mapping of name to Group, found {type(self.groups).__name__}"
            )
        if not self.groups:
            raise ModelError("a model needs at least one group")
        for name, group in self.groups.items():
            _check_name(name)
            if not isinstance(group, Group):
                raise ModelError(f"group {name!r}: expected a Group, found {type(group).__name__}")
            if group.n_dofs != self.n_dofs:
                raise ModelError(
                    f"group {name!r} has {group.n_dofs} DOFs, the model has {self.n_dofs} labels"
                )
        object.__setattr__(self, "groups", MappingProxyType(dict(self.groups)))
        for name, local in self.nonlinear.items():
            self.dofs.match(local.weights, f"nonlinear element {name!r}: DOF")
        object.__setattr__(self, "nonlinear", MappingProxyType(dict(self.nonlinear)))

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
            Groups by name. A name must not contain a dot or a glob character, as unknowns are
            called ``name.quantity``.
        dofs : iterable of str or Dof
            N labels, ``node:direction``, all positive.
        geometry : Geometry, optional
            Positions of the nodes.
        title : str
            Title, for documentation.

        Returns
        -------
        Model
            The sum of the groups.

        Raises
        ------
        ModelError
            If a size does not match, a name is invalid, or a DOF has neither stiffness, mass nor
            damping.
        DofError
            If a label cannot be read or occurs twice.

        Warns
        -----
        UpdynWarning
            If a group's K, M or C is indefinite beyond rounding, that is, it stores or dissipates
            negative energy. Rounded tables are a common cause.
        """
        model = cls(groups, DofSet(dofs), geometry, title)
        model._check_every_dof_is_used()
        for name, group in model.groups.items():
            for what in MATRICES:
                matrix = getattr(group, what)
                if matrix is not None and (found := _negative(matrix)) is not None:
                    warnings.warn(
                        f"group {name!r}: {what} is indefinite ({found}); rounded tables and"
                        " differences of matrices do this, a wrong sign or a wrong unit too",
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
                f"DOF {first} has neither stiffness, mass nor damping ({int((~used).sum())} such):"
                " the model is singular at every frequency; leave such DOFs out"
            )

    def __repr__(self) -> str:
        elements = ""
        if self.nonlinear:
            elements = f"; nonlinear: {', '.join(list(self.nonlinear)[:6])}"
        return (
            f"Model({self.n_dofs} DOFs, {len(self.groups)} groups:"
            f" {', '.join(list(self.groups)[:6])}{elements})"
        )

    def _repr_html_(self) -> str:
        rows = []
        for name, group in self.groups.items():
            has = [what for what in MATRICES if getattr(group, what) is not None]
            rows.append((name, ", ".join(has), group.damping_words))
        facts: dict[str, object] = {"DOFs": self.n_dofs, "groups": len(self.groups)}
        if self.nonlinear:
            facts["nonlinear elements"] = ", ".join(self.nonlinear)
        picture = render_view(self, self._picture)
        groups = table(("group", "has", "damping"), rows, left=(0, 1, 2))
        return card(f"Model {self.title}".rstrip(), facts, picture, groups)

    def _picture(self) -> str:
        """Return the lines of the geometry as a picture; empty without a geometry."""
        if self.geometry is None:
            return ""
        return structure(self.geometry.xyz, self.geometry.line_ends)

    def __reduce__(self) -> tuple[object, ...]:
        whole = (dict(self.groups), self.dofs, self.geometry, self.title, dict(self.nonlinear))
        return Model, whole

    @property
    def n_dofs(self) -> int:
        """Number of DOFs N."""
        return len(self.dofs)

    @property
    def stiffness(self) -> Matrix:
        """K, shape (N, N), real: the sum of the groups' stiffness."""
        return self._sum(g.stiffness for g in self.groups.values())

    @property
    def mass(self) -> Matrix:
        """M, shape (N, N), real: the sum of the groups' mass."""
        return self._sum(g.mass for g in self.groups.values())

    @property
    def viscous(self) -> Matrix:
        """C1, shape (N, N), real: the viscous damping of all groups, Rayleigh damping included."""
        return self._sum(g.viscous_part() for g in self.groups.values())

    @property
    def structural(self) -> Matrix:
        """D, shape (N, N), real: the sum of loss factor times stiffness over all groups.

        Raises
        ------
        ModelError
            If a loss factor depends on frequency; `structural_at` takes one.
        """
        for name, group in self.groups.items():
            if group.loss_table is not None:
                raise ModelError(
                    f"group {name!r}: its loss factor depends on frequency, and so does the"
                    " structural damping; ask structural_at(freq)"
                )
        return self.structural_at(0.0)

    def structural_at(self, freq: float) -> Matrix:
        """Return D at one frequency, with tabulated loss factors evaluated there.

        Parameters
        ----------
        freq : float
            Frequency in Hz.

        Returns
        -------
        sparse, shape (N, N), real
            In N/m.

        Raises
        ------
        ModelError
            If the frequency lies outside a table; the message names the group.
        """
        return self._sum(
            g.stiffness * g.loss_at(freq, name)
            for name, g in self.groups.items()
            if g.stiffness is not None and g.loss_factor
        )

    def _sum(self, matrices: Iterable[Matrix | None]) -> Matrix:
        total = sp.csr_array((self.n_dofs, self.n_dofs), dtype=np.float64)
        for matrix in matrices:
            if matrix is not None:
                total = total + matrix
        return read_only(total)

    def group(self, name: str) -> Group:
        """Return a group by name.

        Parameters
        ----------
        name : str
            The name.

        Returns
        -------
        Group
            The group.

        Raises
        ------
        ModelError
            If there is no such group; the message gives the nearest names.
        """
        if not isinstance(name, str) or name not in self.groups:
            raise ModelError(f"no group {name!r}; {suggest(str(name), self.groups)}")
        return self.groups[name]

    def scaled(self, changes: Mapping[str, Mapping[str, float]]) -> Model:
        """Return a changed copy.

        Parameters
        ----------
        changes : mapping of str to mapping of str to float
            By group: ``stiffness``, ``mass`` and ``viscous`` are factors on the present values (1
            = unchanged); ``loss_factor`` and ``stiffness_damping`` (s) are new values, relative to
            the changed stiffness, ``mass_damping`` (1/s) to the changed mass. By nonlinear element:
            new values of its parameters.

        Returns
        -------
        Model
            The copy; unchanged groups are shared with this model.

        Raises
        ------
        ModelError
            If a group or a quantity does not exist, a number is not finite, or a damping
            coefficient is negative.
        OptionError
            If a parameter of a nonlinear element is out of its range.
        """
        if not isinstance(changes, Mapping):
            raise ModelError(
                "changes: expected a mapping of group to quantities, found"
                f" {type(changes).__name__}"
            )
        groups, nonlinear = dict(self.groups), dict(self.nonlinear)
        for name, change in changes.items():
            if not isinstance(change, Mapping):
                raise ModelError(
                    f"group {name!r}: expected a mapping of quantity to number, found {change!r}"
                )
            if name in nonlinear:
                nonlinear[name] = nonlinear[name].changed(change)
                continue
            group = self.group(name)
            for quantity, value in change.items():
                _check_change(name, group, quantity, value)
            groups[name] = group.changed(change)
        return replace(self, groups=groups, nonlinear=nonlinear)

    def merge_groups(self, groups: Mapping[str, str | Iterable[str]]) -> Model:
        """Return a copy with groups merged, so that one unknown acts on all of them.

        Parameters
        ----------
        groups : mapping of str to str or iterable of str
            Patterns by name of the new group. A pattern is a name, a glob (``"CONM2 10*"``), a
            range of the integer in the names (``"PSHELL 1-4"``), or a material (``"MAT1 3"``) or
            set (``"SET 5"``) that the reader of the model knows.

        Returns
        -------
        Model
            The copy; groups that no pattern selects are shared with this model. The matrices of a
            merged group are sums, and ``group.origin.members`` are its original groups.

        Raises
        ------
        ModelError
            If a pattern selects no group or only a part of one, a group belongs to two new ones, a
            name is invalid, or the damping of merged groups differs.

        See Also
        --------
        updyn.link : One unknown that drives several groups by powers.

        Examples
        --------
        >>> import numpy as np
        >>> parts = {f"PELAS {n}": updyn.Group([[1e4 * n]]) for n in (1, 2, 3)}
        >>> model = updyn.Model.from_groups(parts, ["1:X"])
        >>> model.merge_groups({"springs": "PELAS 1-2"})
        Model(1 DOFs, 2 groups: springs, PELAS 3)
        """
        return replace(self, groups=merge_groups(self.groups, groups))

    def split_changes(
        self, changes: Mapping[str, Mapping[str, float]]
    ) -> dict[str, dict[str, float]]:
        """Return changes by original group, for a model with merged groups.

        Parameters
        ----------
        changes : mapping of str to mapping of str to float
            Changes by group, as for `scaled`.

        Returns
        -------
        dict of str to dict of str to float
            The same changes; those of a merged group are given for each of its members, as far as
            the member has the matrix.
        """
        return split_changes(self.groups, changes)

    def with_element(
        self,
        name: str,
        dofs: Iterable[str | Dof],
        *,
        between: bool = False,
        stiffness: float = 0.0,
        viscous: float = 0.0,
        mass: float = 0.0,
        loss_factor: float = 0.0,
    ) -> Model:
        """Return a copy with a spring, a dashpot or a mass as one more group.

        Parameters
        ----------
        name : str
            Name of the new group.
        dofs : iterable of str or Dof
            Degrees of freedom of the model.
        between : bool
            False: the element acts between each degree of freedom and the ground, as a mass does.
            True: it acts between two degrees of freedom; a negative sign reverses one direction.
        stiffness, viscous, mass : float
            Size in N/m, N s/m and kg; in N m/rad, N m s/rad and kg m2 for rotations. At least one
            is above 0.
        loss_factor : float
            Loss factor of the stiffness.

        Returns
        -------
        Model
            The copy; the other groups are shared with this model.

        Raises
        ------
        ModelError
            If the name exists or is invalid, a size is not a finite number of at least 0, all are
            0, or `between` is set for a number of degrees of freedom other than two.
        DofError
            If the model does not have one of the degrees of freedom.

        See Also
        --------
        updyn.elements.structure.Spring : Element with a length, for models made of elements.

        Examples
        --------
        >>> import numpy as np
        >>> parts = {"parts": updyn.Group(1e4 * np.eye(2), np.eye(2))}
        >>> model = updyn.Model.from_groups(parts, ["1:X", "2:X"])
        >>> model = model.with_element("dashpot", ["1:X", "2:X"], between=True, viscous=5.0)
        >>> model.viscous.toarray()
        array([[ 5., -5.],
               [-5.,  5.]])
        """
        if name in self.groups:
            raise ModelError(f"group {name!r} exists; expected a new name")
        sizes = {"stiffness": stiffness, "mass": mass, "viscous": viscous}
        for what, size in sizes.items():
            if not is_number(size) or not math.isfinite(size) or size < 0.0:
                raise ModelError(f"{what} {size!r}: expected a finite number of at least 0")
        if not any(sizes.values()):
            raise ModelError("expected a stiffness, viscous or mass above 0; all are 0")
        at = self.dofs.match(dofs)
        n = len(at.index)
        if n != 2 and between:
            raise ModelError(f"between: expected two degrees of freedom, found {n}")
        if not n:
            raise ModelError("expected at least one degree of freedom, found none")
        effect = at.sign * [1.0, -1.0] if between else at.sign
        rows = np.zeros(n, dtype=np.intp) if between else np.arange(n)
        shape = (1 if between else n, self.n_dofs)
        u = sp.csr_array((effect, (rows, at.index)), shape=shape)
        matrices = {what: size * (u.T @ u) for what, size in sizes.items() if size}
        group = Group(**matrices, loss_factor=loss_factor)
        return replace(self, groups={**self.groups, name: group})

    def with_elements(self, elements: Mapping[str, tuple[NonlinearElement, Place]]) -> Model:
        """Return a copy with further nonlinear elements.

        Parameters
        ----------
        elements : mapping of str to (NonlinearElement, DOFs)
            By name: an element, such as `CubicSpring`, `Backlash`, `JenkinsElement`, `IwanJoint` or
            `QuadraticDamper`, and the degrees of freedom that it acts on. One (str or Dof): it acts
            between it and the ground. Two: between them; a sign reverses one direction. A mapping
            of labels to weights: on the sum of weight times displacement.

        Returns
        -------
        Model
            The copy; the groups are shared with this model.

        Raises
        ------
        ModelError
            If a name exists, an item is not a nonlinear element with its degrees of freedom, or
            there is no degree of freedom.
        OptionError
            If a weight is not finite.
        DofError
            If the model does not have one of the degrees of freedom.

        See Also
        --------
        updyn.response : With ``level=``, the response to a force amplitude.
        with_element : Linear springs, dashpots and masses.

        Examples
        --------
        >>> import numpy as np
        >>> parts = {"parts": updyn.Group(1e4 * np.eye(2), np.eye(2))}
        >>> model = updyn.Model.from_groups(parts, ["1:X", "2:X"])
        >>> model.with_elements({"joint": (updyn.CubicSpring(1e9), ["1:X", "2:X"])})
        Model(2 DOFs, 1 groups: parts; nonlinear: joint)
        """
        if not isinstance(elements, Mapping):
            raise ModelError(
                "with_elements: expected a mapping of names to (element, DOFs), found"
                f" {type(elements).__name__}"
            )
        nonlinear = dict(self.nonlinear)
        for name, item in elements.items():
            _check_name(name, "nonlinear element")
            if name in nonlinear or name in self.groups:
                raise ModelError(f"nonlinear element {name!r}: the name exists; expected a new one")
            if not isinstance(item, tuple) or len(item) != 2:
                raise ModelError(
                    f"nonlinear element {name!r}: expected a pair (element, DOFs), found"
                    f" {type(item).__name__}"
                )
            nonlinear[name] = place_element(*item, f"nonlinear element {name!r}")
        return replace(self, nonlinear=nonlinear)

    def linearised(self) -> Model:
        """Return a copy whose nonlinear elements are replaced by groups for vanishing amplitude.

        Returns
        -------
        Model
            Without nonlinear elements. Each that has stiffness or damping at rest is a group of its
            name.

        Raises
        ------
        OptionError
            If an element has no finite stiffness and damping at rest.

        Examples
        --------
        >>> import numpy as np
        >>> parts = {"parts": updyn.Group(1e4 * np.eye(2), np.eye(2))}
        >>> model = updyn.Model.from_groups(parts, ["1:X", "2:X"])
        >>> joint = updyn.JenkinsElement(stiffness=500.0, slip_force=2.0)
        >>> model.with_elements({"joint": (joint, "2:X")}).linearised().stiffness.toarray()
        array([[10000.,     0.],
               [    0., 10500.]])
        """
        groups = dict(self.groups)
        for name, local in self.nonlinear.items():
            stiffness, damping = local.element.at_rest()
            w = sp.csr_array(local.column(self.dofs)[None])
            matrices = {"stiffness": stiffness, "viscous": damping}
            given = {what: size * (w.T @ w) for what, size in matrices.items() if size}
            if given:
                groups[name] = Group(**given)
        return replace(self, groups=groups, nonlinear={})

    def refuse_nonlinear(self, what: str) -> None:
        """Raise ModelError if the model has nonlinear elements.

        Parameters
        ----------
        what : str
            The linear method or the format, for the message.
        """
        if self.nonlinear:
            raise ModelError(
                f"{what}: the model has nonlinear elements ({', '.join(self.nonlinear)}); expected"
                " a linear model, such as model.linearised(), or updyn.response with level="
            )

    def with_damping(self, damping: Mapping[str, Mapping[str, object]]) -> Model:
        """Return a copy with other damping, for example for a deck without damping.

        Parameters
        ----------
        damping : mapping of str to mapping
            By group: ``loss_factor``, ``mass_damping`` (1/s), ``stiffness_damping`` (s) and
            ``loss_table`` (two rows, frequencies in Hz and factors on the loss factor; None for no
            table), as for `Group`. Other damping is unchanged.

        Returns
        -------
        Model

        Raises
        ------
        ModelError
            If a group or a kind of damping does not exist, or a value is invalid.
        """
        if not isinstance(damping, Mapping):
            raise ModelError(
                f"damping: expected a mapping of group to damping, found {type(damping).__name__}"
            )
        groups = dict(self.groups)
        for name, group_damping in damping.items():
            group = self.group(name)
            if not isinstance(group_damping, Mapping):
                raise ModelError(
                    f"group {name!r}: expected a mapping of damping by name, found"
                    f" {group_damping!r}"
                )
            try:
                groups[name] = group.with_damping(group_damping)
            except ModelError as error:
                raise ModelError(f"group {name!r}: {error}", key=error.key) from error
        return replace(self, groups=groups)


def _check_name(name: object, what: str = "group") -> None:
    if not isinstance(name, str) or not name.strip() or name != name.strip():
        raise ModelError(f"{what} name {name!r}: expected a text without blanks at its ends")
    bad = sorted(set(name) & set(".*?[]\n\t"))
    if bad:
        raise ModelError(
            f"{what} name {name!r} holds {bad[0]!r}: unknowns are called name.quantity and chosen"
            " by glob"
        )


def _check_change(name: str, group: Group, quantity: str, value: float) -> None:
    if quantity not in GROUP_QUANTITIES:
        raise ModelError(
            f"group {name!r}: no quantity {quantity!r}; {suggest(quantity, GROUP_QUANTITIES)}"
        )
    if not group.has(quantity):
        raise ModelError(f"group {name!r} has no {GROUP_QUANTITIES[quantity]} to change")
    if not is_number(value):
        raise ModelError(f"group {name!r}: {quantity} {value!r}: expected a number")
    if not math.isfinite(value):
        raise ModelError(f"group {name!r}: {quantity} {value!r} is not finite")


def _negative(matrix: Matrix) -> str | None:
    """Return the evidence that a matrix is indefinite beyond rounding; None without any."""
    # Above 600 DOFs, only the diagonal and the 2 x 2 minors are checked, which finds wrong signs
    # but not every indefinite matrix.
    used = np.unique(matrix.indices)
    if used.size == 0:
        return None
    if used.size <= MODEL_CHECK.dense_dofs:
        values = np.linalg.eigvalsh(matrix[used][:, used].toarray())
        low, high = float(values[0]), float(np.abs(values).max())
        if low < -ROUNDING.relative * high:
            return f"smallest eigenvalue {low:.3g}, largest {high:.3g}"
        return None
    diagonal = matrix.diagonal()
    largest = float(np.abs(matrix.data).max())
    if diagonal.min() < -ROUNDING.relative * largest:
        return f"diagonal entry {int(np.argmin(diagonal)) + 1} is {diagonal.min():.3g}"
    upper = matrix.tocoo()
    off = np.flatnonzero(upper.row < upper.col)
    product = diagonal[upper.row[off]] * diagonal[upper.col[off]]
    # Rounding may raise an entry above the geometric mean of its diagonal entries, or make it
    # nonzero although its diagonal entry is 0.
    rounding = 1e-8 * np.abs(product) + (ROUNDING.relative * largest) ** 2
    excess = upper.data[off] ** 2 - product - rounding
    if excess.size and excess.max() > 0.0:
        at = off[int(np.argmax(excess))]
        return f"entry ({upper.row[at] + 1}, {upper.col[at] + 1}) outweighs its diagonal entries"
    return None
