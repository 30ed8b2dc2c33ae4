"""`opened`: a model with one mesh taken out, and the port across it, for backlash to act there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.control.nonlinear.elements import Backlash
from updyn.control.ports import Port
from updyn.dofs import Dof
from updyn.errors import ModelError, OptionError
from updyn.group import Group, is_number
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = ["Opened", "opened"]

_ONE = 1e-9  # what a mesh may have besides its one spring, as a share of it


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A model with an open mesh.

    Attributes
    ----------
    model : Model
        Without the stiffness and the damping of the mesh; its inertias stay.
    port : Port
        Across the mesh: the pair of torques that drives it apart, and its twist. Both an input and
        an output of the plant.
    stiffness : float
        Of the mesh, in N m per rad of twist at the DOF where the twist is counted.
    damping : float
        Its viscous damping there, in N m s/rad.
    group : Group
        The mesh as it was.
    name : str
        Of the group.
    """

    model: Model
    port: Port
    stiffness: float
    damping: float
    group: Group
    name: str

    def backlash(self, gap: float, *, frequency: float | None = None) -> Backlash:
        """Return the mesh with a gap.

        Parameters
        ----------
        gap : float
            From flank to flank, in rad of twist at the DOF where it is counted.
        frequency : float, optional
            In Hz: where the damper loses what the loss factor of the mesh does, which has no
            counterpart in time. Needed where the mesh has one.

        Returns
        -------
        Backlash

        Raises
        ------
        OptionError
            If a number is out of its range, or the frequency is missing.
        """
        damping = self.damping
        if self.group.loss_factor:
            if frequency is None or not is_number(frequency) or not 0 < frequency < np.inf:
                raise OptionError(
                    f"mesh {self.name!r} has the loss factor {self.group.loss_factor:g}; say"
                    " frequency=, in Hz, at which a damper stands for it (that of the limit"
                    f" cycle), found {frequency!r}"
                )
            damping += (
                self.group.loss_at(float(frequency), self.name)
                * self.stiffness
                / (2.0 * np.pi * frequency)
            )
        return Backlash(self.stiffness, gap, damping)


def opened(model: Model | UpdateResult, mesh: str, at: str | Dof, *, name: str = "gap") -> Opened:
    """Take a mesh out of a model.

    The plant that backlash acts on is then made with the port as an input and an output::

        gap = updyn.opened(model, "pinion", "7:RZ") plant = updyn.plant(gap.model, ["1:RZ",
        gap.port], [Port.at("1:RZ", "speed"), "7:RZ", gap.port], band,
                            quantity=["mobility", "receptance", "receptance"])
        cycles = updyn.limit_cycles(plant, controller, gap.backlash(2e-4, frequency=5.0), "gap")

    Parameters
    ----------
    model : Model or UpdateResult
        The structure, or the update that found it.
    mesh : str
        Group of the mesh: one spring between any number of DOFs (a gear pair, a shaft, a coupling).
    at : str or Dof
        Signed DOF at which the twist is counted, the others being held: the ring for a clearance in
        angles of the ring.
    name : str
        Of the port.

    Returns
    -------
    Opened

    Raises
    ------
    ModelError
        If there is no such group, it is not one spring, or its viscous damping does not act along
        that spring.
    DofError
        If the DOF is not in the model.
    OptionError
        If the model is none.

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
    here, sign = int(match.index[0]), float(match.sign[0])
    K = group.stiffness
    if K is None or K.nnz == 0:
        raise ModelError(f"group {mesh!r} has no stiffness to open")
    k = float(K[here, here])
    if not k > 0:
        raise ModelError(
            f"group {mesh!r} does not act on {Dof.parse(at)}; name one of {_own(given, K)}"
        )
    row = sp.csr_array(K[[here]]) * (sign / k)
    _along(K, row, k, f"group {mesh!r} is not one spring: its stiffness")
    c = 0.0
    parts = [
        m * s
        for m, s in ((group.viscous, 1.0), (K, group.stiffness_damping))
        if m is not None and s
    ]
    if parts:
        C = sum(parts[1:], parts[0])
        c = float(C[here, here])
        _along(C, row, c, f"group {mesh!r}: its viscous damping")
    entries = row.tocoo()
    weights = {
        str(given.dofs[int(i)]): float(v)
        for i, v in zip(entries.coords[1], entries.data, strict=True)
        if abs(v) > 1e-12 * float(np.abs(entries.data).max())
    }
    left = Group(stiffness=K * 0.0)
    if group.mass is not None:
        left = Group(mass=group.mass, mass_damping=group.mass_damping)
    rest = Model({**given.groups, mesh: left}, given.dofs, given.geometry, given.title)
    port = Port(name, weights, rotation=Dof.parse(at).direction.startswith("R"))
    return Opened(rest, port, k, c, group, mesh)


def _along(matrix: Any, row: Any, size: float, what: str) -> None:
    """Refuse a matrix that is not size times the outer product of a row."""
    left = matrix - size * (row.T @ row)
    if abs(left).max() > _ONE * abs(matrix).max():
        raise ModelError(
            f"{what} does more than twist one spring (its matrix is not of rank 1); put the mesh"
            " alone into a group"
        )


def _own(model: Model, K: Any) -> str:
    own = np.flatnonzero(K.diagonal() > 0)
    return ", ".join(str(model.dofs[int(i)]) for i in own[:6]) + (", ..." if len(own) > 6 else "")
