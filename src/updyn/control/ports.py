"""`Port`: an input or output of a plant: DOFs, weights, sign, gear ratio, unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, OptionError
from updyn.group import is_number
from updyn.model import Model

__all__ = ["Port", "as_ports", "port_matrix"]


@dataclass(frozen=True, slots=True)
class Port:
    """A force that acts on DOFs, or a motion that is read from them.

    As an input, one unit of it puts `weights` on the DOFs, as forces (N) or moments (N m). As an
    output it is the sum of weight times motion. An input and an output of one port are power
    conjugate.

    Parameters
    ----------
    name : str
        What it is called in the plant.
    weights : mapping of str to float
        Weight by DOF label, ``node:direction``; a sign of the label counts.
    rotation : bool, optional
        Whether it is a moment and an angle. None: as its DOFs are.

    Raises
    ------
    OptionError
        If the name is empty, a weight is not a finite number, all are 0, or translations and
        rotations are mixed and `rotation` does not say what comes of them.
    DofError
        If a label cannot be read, or two are of one DOF.

    Examples
    --------
    >>> twist = updyn.Port("twist", {"1:RZ": 0.01, "2:RZ": -1})
    >>> twist.rotation, twist.motion_unit("receptance")
    (True, 'rad')
    """

    name: str
    weights: Mapping[str, float]
    rotation: bool | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise OptionError(f"port: name {self.name!r}; expected a text")
        if not isinstance(self.weights, Mapping) or not self.weights:
            raise OptionError(
                f"port {self.name!r}: expected weights by DOF, found {self.weights!r}"
            )
        DofSet(self.weights)
        for label, weight in self.weights.items():
            if not is_number(weight) or not math.isfinite(weight):
                raise OptionError(
                    f"port {self.name!r}: weight of {label} is {weight!r}; expected a finite number"
                )
        if not any(self.weights.values()):
            raise OptionError(f"port {self.name!r}: all weights are 0")
        kinds = {label.rpartition(":")[2].lstrip("+-").startswith("R") for label in self.weights}
        if self.rotation is None and len(kinds) > 1:
            raise OptionError(
                f"port {self.name!r} mixes translations and rotations ({', '.join(self.weights)});"
                " say rotation=True or rotation=False for what comes of them"
            )
        object.__setattr__(
            self, "weights", MappingProxyType({k: float(w) for k, w in self.weights.items()})
        )
        rotation = kinds.pop() if self.rotation is None else self.rotation
        object.__setattr__(self, "rotation", bool(rotation))

    def __reduce__(self) -> tuple[object, ...]:
        return Port, (self.name, dict(self.weights), self.rotation)

    @classmethod
    def at(cls, dof: str | Dof, name: str | None = None) -> Port:
        """Return the port of one signed DOF.

        Parameters
        ----------
        dof : str or Dof
            ``node:direction``, with a sign where it counts the other way.
        name : str, optional
            By default the label.

        Returns
        -------
        Port
        """
        label = str(Dof.parse(dof))
        return cls(name or label, {label: 1.0})

    @classmethod
    def geared(cls, dof: str | Dof, ratio: float, name: str | None = None) -> Port:
        """Return the port of a shaft as seen from the other side of a gear train.

        The motor (angle theta, torque T) of a drive that turns `ratio` times as fast as the load
        reads theta / ratio on the load's side and gives T ratio there: both are the motor's DOF
        with the weight 1 / ratio. So is the load seen from the motor with 1 / ratio given as the
        ratio.

        Parameters
        ----------
        dof : str or Dof
            Of the shaft.
        ratio : float
            Turns of the shaft for one turn of the side it is seen from; negative where the sense of
            rotation is reversed.
        name : str, optional
            By default the label with the ratio.

        Returns
        -------
        Port

        Raises
        ------
        OptionError
            If the ratio is 0 or not finite.
        """
        if not is_number(ratio) or not math.isfinite(ratio) or ratio == 0:
            raise OptionError(f"gear ratio {ratio!r}: expected a finite number other than 0")
        label = str(Dof.parse(dof))
        return cls(name or f"{label} / {ratio:g}", {label: 1.0 / ratio})

    @property
    def force_unit(self) -> str:
        """Unit as an input."""
        return "N m" if self.rotation else "N"

    def motion_unit(self, quantity: str) -> str:
        """Return the unit as an output.

        Parameters
        ----------
        quantity : {"receptance", "mobility", "accelerance"}
            Whether it is a displacement, a velocity or an acceleration.

        Returns
        -------
        str
        """
        rate = {"receptance": "", "mobility": "/s", "accelerance": "/s2"}[quantity]
        return ("rad" if self.rotation else "m") + rate


def as_ports(given: Iterable[str | Dof | Port] | str | Dof | Port, what: str) -> tuple[Port, ...]:
    """Return ports from labels and ports.

    Parameters
    ----------
    given : iterable of str, Dof or Port, or one of them
        Signed DOFs, or ports.
    what : str
        ``"input"`` or ``"output"``, for messages.

    Returns
    -------
    tuple of Port

    Raises
    ------
    OptionError
        If there is none, or two have one name.
    """
    items = [given] if isinstance(given, str | Dof | Port) else list(given)
    if not items:
        raise OptionError(f"a plant needs at least one {what}")
    ports = tuple(p if isinstance(p, Port) else Port.at(p) for p in items)
    names = [p.name for p in ports]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise OptionError(f"two {what}s are called {twice!r}; give one of them another name")
    return ports


def port_matrix(
    ports: tuple[Port, ...], model: Model, what: str
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the DOFs of a model that ports touch, and their weights.

    Parameters
    ----------
    ports : tuple of Port
        Inputs or outputs.
    model : Model
        The structure.
    what : str
        ``"input"`` or ``"output"``, for messages.

    Returns
    -------
    index : ndarray of int, shape (k,)
        Positions of the DOFs, ascending.
    weights : ndarray of float, shape (len(ports), k)

    Raises
    ------
    DofError
        If the model has no such DOF; the message names the port.
    """
    matches = []
    for port in ports:
        try:
            matches.append(model.dofs.match(DofSet(port.weights), what))
        except DofError as error:
            said = str(error)
            if port.name not in said:
                said = f"port {port.name!r}: {said}"
            raise DofError(said) from error
    index = np.unique(np.concatenate([m.index for m in matches]))
    weights = np.zeros((len(ports), len(index)))
    for row, (port, match) in enumerate(zip(ports, matches, strict=True)):
        weights[row, np.searchsorted(index, match.index)] = match.sign * np.array(
            list(port.weights.values())
        )
    return index, weights
