"""`Shapes`: mode shapes, or operating deflection shapes of FRFs, on a structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, IntArray
from updyn.dofs import DofSet, positions
from updyn.dynamics.modes import Modes
from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.modal.mode_set import ModeSet
from updyn.model import Model

__all__ = ["Shapes", "Updated", "make_shapes"]


class Updated(Protocol):
    """An object with an updated model, such as an `UpdateResult`."""

    @property
    def model(self) -> Model:
        """The updated model."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Mode shapes or operating deflection shapes with a structure, to draw and to export.

    Attributes
    ----------
    modes : ModeSet
        The shapes as columns. Operating shapes are FRFs, with the lines as frequencies.
    geometry : Geometry
        Positions of all measured nodes, and of those of a model with DOFs in the shapes.
    model : Model or None
        The model with this geometry.
    numbers : ndarray of int, shape (n,)
        Numbers of the shapes among all modes or lines that were given, from 1.
    quantity, reference : str
        Quantity and reference of operating shapes; empty for modes.
    result : UpdateResult or None
        The update whose model it is.
    """

    modes: ModeSet
    geometry: Geometry
    model: Model | None
    numbers: IntArray
    quantity: str = ""
    reference: str = ""
    result: Updated | None = None

    def __len__(self) -> int:
        return len(self.modes)

    def titles(self) -> list[str]:
        """Return a title for each shape: number, frequency, loss factor or quantity."""
        out = []
        for number, f, loss in zip(
            self.numbers.tolist(),
            self.modes.frequency.tolist(),
            self.modes.loss_factor.tolist(),
            strict=True,
        ):
            if self.quantity:
                out.append(f"Operating shape at {f:.6g} Hz, {self.quantity} to {self.reference}")
            else:
                damping = "" if np.isnan(loss) else f", loss factor {loss:.3g}"
                out.append(f"Mode {number}, {f:.6g} Hz{damping}")
        return out

    def in_global_axes(self) -> tuple[DofSet, ComplexArray]:
        """Return the shapes with global directions: DOFs and values, shape (N, n).

        Nodes with local directions get all three global translations, or rotations.
        """
        dofs = self.modes.dofs
        values = self.modes.shapes * dofs.signs[:, None]
        if self.geometry.axes is None:
            return DofSet.from_arrays(dofs.nodes, dofs.axes), values
        place = {int(node): at for at, node in enumerate(self.geometry.nodes)}
        keys: dict[tuple[int, int], ComplexArray] = {}
        for node, axis, row in zip(dofs.nodes.tolist(), dofs.axes.tolist(), values, strict=True):
            direction = np.eye(3)[axis % 3]
            if node in place:
                direction = self.geometry.axes[place[node]][axis % 3]
            is_global = (direction == np.eye(3)[axis % 3]).all()
            for k in (axis % 3,) if is_global else range(3):
                key = (node, 3 * (axis // 3) + k)
                keys[key] = keys.get(key, np.zeros(len(self), np.complex128)) + direction[k] * row
        nodes, axes = np.array(list(keys)).T
        return DofSet.from_arrays(nodes, axes), np.array(list(keys.values()))


def make_shapes(
    given: ModeSet | Modes | FRF,
    structure: Geometry | Model | Updated | None = None,
    *,
    freq: ArrayLike | None = None,
    reference: str | None = None,
    select: ArrayLike | None = None,
) -> Shapes:
    """Return the shapes of modes, or of an FRF at some lines.

    Parameters
    ----------
    given : ModeSet, Modes or FRF
        Measured or computed modes, or FRFs.
    structure : Geometry, Model or UpdateResult, optional
        Positions of the nodes; None: the geometry of the FRF.
    freq : array_like of float, optional
        Frequencies in Hz of operating shapes; the nearest line of the FRF is used.
    reference : str, optional
        Reference of operating shapes, if the FRF has several.
    select : array_like of int or bool, optional
        Modes to keep, as in `ModeSet.select`.

    Returns
    -------
    Shapes

    Raises
    ------
    OptionError
        If an argument has another type, is missing, or does not apply.
    DataError
        If the modes have no shapes, or a frequency is outside the lines.
    InputError
        If a measured node has no position.
    """
    if not isinstance(given, ModeSet | Modes | FRF):
        raise OptionError(
            f"shapes: expected a ModeSet, Modes or an FRF, found {type(given).__name__}"
        )
    result = None
    if structure is None and isinstance(given, FRF):
        structure = given.geometry
    if not isinstance(structure, Geometry | Model | None):
        if not isinstance(getattr(structure, "model", None), Model):
            raise OptionError(
                "structure: expected a Model, a Geometry or an UpdateResult, found"
                f" {type(structure).__name__}",
                key=("structure",),
            )
        result, structure = structure, structure.model
    geometry = structure.geometry if isinstance(structure, Model) else structure
    if geometry is None or not len(geometry.nodes):
        raise OptionError(
            "structure: shapes need the positions of their nodes; give a model with a geometry, or"
            " a Geometry such as updyn.read_geometry('nodes.csv')",
            key=("structure",),
        )
    model = structure if isinstance(structure, Model) else None
    if isinstance(given, FRF):
        if select is not None:
            raise OptionError("select: chooses modes; lines of an FRF are chosen by freq")
        modes, lines, column = _operating_shapes(given, freq, reference)
        geometry.position(modes.dofs.nodes)
        return Shapes(modes, geometry, model, lines + 1, given.quantity, column, result)
    for name, value in (("freq", freq), ("reference", reference)):
        if value is not None:
            raise OptionError(f"{name}: applies to FRFs only, not to modes")
    if isinstance(given, Modes):
        modes = ModeSet(given.frequency, given.shapes, given.dofs, given.loss_factor, scaled=True)
        placed = np.isin(modes.dofs.nodes, geometry.nodes)
        if not placed.any():
            geometry.position(modes.dofs.nodes[:1])  # raises an error with the nearest node
    else:
        if not given.has_shapes:
            raise DataError("shapes: these modes are natural frequencies only; they have no shapes")
        geometry.position(given.dofs.nodes)
        modes = given
    kept = np.arange(len(modes))
    if select is not None:
        kept = np.sort(positions(select, len(modes), "select", DataError))
        modes = modes.select(kept)
    return Shapes(modes, geometry, model, kept + 1, result=result)


def _operating_shapes(
    frf: FRF, freq: ArrayLike | None, reference: str | None
) -> tuple[ModeSet, IntArray, str]:
    """Return FRFs to one reference as columns, their lines from 0, and the reference."""
    labels = frf.references.labels
    if freq is None:
        raise OptionError(
            f"freq: expected the frequency of an operating shape, {frf.freq[0]:g} to"
            f" {frf.freq[-1]:g} Hz",
            key=("freq",),
        )
    if reference is None and len(labels) > 1:
        raise OptionError(
            f"reference: the FRF has {len(labels)}; expected one of {', '.join(labels[:6])}",
            key=("reference",),
        )
    chosen = labels[0] if reference is None else reference
    if chosen not in labels:
        raise OptionError(
            f"reference {chosen!r}: not in the FRF; {suggest(chosen, labels)}", key=("reference",)
        )
    wanted = np.atleast_1d(np.asarray(freq, dtype=np.float64))
    lines = np.unique([int(np.argmin(np.abs(frf.freq - f))) for f in wanted.tolist()])
    for f in wanted.tolist():
        if not frf.freq[0] <= f <= frf.freq[-1]:
            raise DataError(
                f"freq: {f:g} Hz is outside the lines, {frf.freq[0]:g} to {frf.freq[-1]:g} Hz"
            )
    values = frf.values[lines, :, labels.index(chosen)].T
    dead = ~values.any(axis=0)
    if dead.any():
        raise DataError(f"freq: the FRFs to {chosen} are zero at {frf.freq[lines][dead][0]:g} Hz")
    return ModeSet(frf.freq[lines], values, frf.responses), lines, chosen
