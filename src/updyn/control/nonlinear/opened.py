"""`opened`: a model without one mesh, and the port across it, at which backlash acts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from updyn.control.nonlinear.settings import MESH
from updyn.control.ports import Port
from updyn.dofs import Dof
from updyn.errors import ModelError, OptionError
from updyn.group import Group, Matrix, is_number
from updyn.model import Model
from updyn.nonlinear.backlash import Backlash
from updyn.updating.result import UpdateResult

__all__ = ["OpenMesh", "opened"]


@dataclass(frozen=True, slots=True, eq=False)
class OpenMesh:
    """A model with an open mesh, and the port across it.

    `model` keeps the inertias of the mesh. `port` is the pair of torques that drives it apart, and
    its twist: both an input and an output of the plant. `stiffness` in N m/rad and `damping` in N m
    s/rad are those of the removed `group` at the reference DOF.
    """

    model: Model
    port: Port
    stiffness: float
    damping: float
    group: Group
    name: str

    def backlash(self, gap: float, *, frequency: float | None = None) -> Backlash:
        """Return the mesh with a gap from flank to flank, in rad of twist at the reference DOF.

        At `frequency` in Hz the damper dissipates as much as the loss factor of the mesh, which has
        no counterpart in the time domain.
        """
        damping = self.damping
        if self.group.loss_factor:
            if frequency is None or not is_number(frequency) or not 0 < frequency < np.inf:
                raise OptionError(
                    f"mesh {self.name!r} has the loss factor {self.group.loss_factor:g}; expected"
                    " frequency= in Hz, that of the limit cycle, for an equivalent damper; found"
                    f" {frequency!r}"
                )
            damping += (
                self.group.loss_at(float(frequency), self.name)
                * self.stiffness
                / (2.0 * np.pi * frequency)
            )
        return Backlash(self.stiffness, gap, damping)


def opened(model: Model | UpdateResult, mesh: str, at: str | Dof, *, name: str = "gap") -> OpenMesh:
    """Return a model without one mesh, and the port across it.

    The plant of the backlash has this port as an input and an output::

        gap = updyn.opened(model, "pinion", "7:RZ")
        plant = updyn.plant(
            gap.model,
            ["1:RZ", gap.port],
            [Port.at("1:RZ", "speed"), "7:RZ", gap.port],
            band,
            quantity=["mobility", "receptance", "receptance"],
        )
        cycles = updyn.limit_cycles(plant, controller, gap.backlash(2e-4, frequency=5.0), "gap")

    Parameters
    ----------
    model : Model or UpdateResult
        The structure, or an update result of it.
    mesh : str
        Group of the mesh: one spring between any number of DOFs (a gear pair, a shaft, a coupling).
    at : str or Dof
        Signed reference DOF of the twist, the other DOFs held: the ring for a clearance in angles
        of the ring.
    name : str
        Name of the port.

    Returns
    -------
    OpenMesh

    Raises
    ------
    ModelError
        If the group does not exist, is not one spring, or its viscous damping does not act along
        that spring.
    DofError
        If the DOF is not in the model.
    OptionError
        If `model` is of another type.

    Examples
    --------
    >>> import numpy as np
    >>> shaft = np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> drive = updyn.Model.from_groups(
    ...     {
    ...         "motor": updyn.Group(mass=np.diag([0.5, 0.0])),
    ...         "shaft": updyn.Group(2000.0 * shaft, loss_factor=0.02),
    ...         "load": updyn.Group(mass=np.diag([0.0, 2.0])),
    ...     },
    ...     ["1:RZ", "2:RZ"],
    ... )
    >>> gap = updyn.opened(drive, "shaft", "2:RZ")
    >>> round(gap.stiffness, 6), gap.port.name
    (2000.0, 'gap')
    """
    given = model.model if isinstance(model, UpdateResult) else model
    if not isinstance(given, Model):
        raise OptionError(
            f"opened: expected a Model or an UpdateResult, found {type(model).__name__}"
        )
    group = given.group(mesh)
    match = given.dofs.match([Dof.parse(at)], "DOF of the twist")
    position, sign = int(match.index[0]), float(match.sign[0])
    K = group.stiffness
    if K is None or K.nnz == 0:
        raise ModelError(f"group {mesh!r} has no stiffness to open")
    k = float(K[position, position])
    if not k > 0:
        raise ModelError(
            f"group {mesh!r} does not act on {Dof.parse(at)}; expected one of"
            f" {_format_dofs(given, K)}"
        )
    row = sp.csr_array(K[[position]]) * (sign / k)
    _check_rank_one(K, row, k, f"group {mesh!r} is not one spring: its stiffness")
    c = 0.0
    parts = [
        m * s
        for m, s in ((group.viscous, 1.0), (K, group.stiffness_damping))
        if m is not None and s
    ]
    if parts:
        C = sum(parts[1:], parts[0])
        c = float(C[position, position])
        _check_rank_one(C, row, c, f"group {mesh!r}: its viscous damping")
    entries = row.tocoo()
    weights = {
        str(given.dofs[int(i)]): float(v)
        for i, v in zip(entries.coords[1], entries.data, strict=True)
        if abs(v) > 1e-12 * float(np.abs(entries.data).max())
    }
    left = Group(stiffness=K * 0.0)
    if group.mass is not None:
        left = Group(mass=group.mass, mass_damping=group.mass_damping)
    rest = replace(given, groups={**given.groups, mesh: left})
    port = Port(name, weights, rotation=Dof.parse(at).direction.startswith("R"))
    return OpenMesh(rest, port, k, c, group, mesh)


def _check_rank_one(matrix: Matrix, row: sp.csr_array, size: float, what: str) -> None:
    """Raise ModelError if a matrix is not `size` times the outer product of a row."""
    difference = matrix - size * (row.T @ row)
    if abs(difference).max() > MESH.rank_one_deviation * abs(matrix).max():
        raise ModelError(
            f"{what} does more than twist one spring (its matrix does not have rank 1); put only"
            " the mesh into a group"
        )


def _format_dofs(model: Model, K: Matrix) -> str:
    positions = np.flatnonzero(K.diagonal() > 0)
    return ", ".join(str(model.dofs[int(i)]) for i in positions[:6]) + (
        ", ..." if len(positions) > 6 else ""
    )
