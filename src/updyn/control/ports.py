"""`Port`: an input or output of a plant: DOFs, weights, sign, gear ratio, unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, OptionError, suggest
from updyn.group import is_number
from updyn.model import Model

__all__ = ["Port", "as_ports", "find_index", "port_matrix"]


@dataclass(frozen=True, slots=True)
class Port:
    """A force acting on DOFs, or a motion read from them.

    As an input, one unit of it applies `weights` to the DOFs, as forces (N) or moments (N m). As an
    output it is the sum of weight times motion. An input and an output with the same port are power
    conjugate.

    Parameters
    ----------
    name : str
        Name in the plant.
    weights : mapping of str to float
        Weight by DOF label, ``node:direction``, including the sign of the label.
    rotation : bool, optional
        Whether it is a moment and an angle. None: determined by its DOFs.

    Raises
    ------
    OptionError
        If the name is empty, a weight is not a finite number, all are 0, or translations and
        rotations are mixed without `rotation`.
    DofError
        If a label is invalid, or two name the same DOF.

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
                " give rotation=True or rotation=False for the result"
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
            ``node:direction``, with a minus sign for the opposite sense.
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
        reads theta / ratio on the load's side and supplies T ratio there: both are the motor's DOF
        with the weight 1 / ratio. The load seen from the motor has the inverse ratio.

        Parameters
        ----------
        dof : str or Dof
            DOF of the shaft.
        ratio : float
            Turns of the shaft per turn of the side it is seen from; negative if the sense of
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
            Displacement, velocity or acceleration.

        Returns
        -------
        str
        """
        rate = {"receptance": "", "mobility": "/s", "accelerance": "/s2"}[quantity]
        return ("rad" if self.rotation else "m") + rate


def as_ports(given: Iterable[str | Dof | Port] | str | Dof | Port, what: str) -> tuple[Port, ...]:
    """Return ports from labels and ports; raises OptionError without any, or for equal names."""
    items = [given] if isinstance(given, str | Dof | Port) else list(given)
    if not items:
        raise OptionError(f"a plant needs at least one {what}")
    ports = tuple(p if isinstance(p, Port) else Port.at(p) for p in items)
    names = [p.name for p in ports]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise OptionError(f"two {what}s are named {twice!r}; give one of them another name")
    return ports


def port_matrix(ports: tuple[Port, ...], model: Model, what: str) -> tuple[IndexArray, RealArray]:
    """Return indices (k,) and weights (len(ports), k) of the DOFs of ports; raises DofError."""
    matches = []
    for port in ports:
        try:
            matches.append(model.dofs.match(DofSet(port.weights), what))
        except DofError as error:
            message = str(error)
            if port.name not in message:
                message = f"port {port.name!r}: {message}"
            raise DofError(message) from error
    index = np.unique(np.concatenate([m.index for m in matches]))
    weights = np.zeros((len(ports), len(index)))
    for row, (port, match) in enumerate(zip(ports, matches, strict=True)):
        weights[row, np.searchsorted(index, match.index)] = match.sign * np.array(
            list(port.weights.values())
        )
    return index, weights


def find_index(name: object, names: Sequence[str], what: str, owner: str = "plant") -> int:
    """Return the position of a port by its name; OptionError with the nearest name if unknown."""
    if name not in names:
        raise OptionError(f"the {owner} has no {what} {name!r}; {suggest(str(name), names)}")
    return names.index(str(name))
