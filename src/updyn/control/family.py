"""`PlantFamily`: a plant and what else it may be, by what the update leaves unsure. Pure data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.control.plant import Plant
from updyn.errors import ModelError

__all__ = ["PlantFamily"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class PlantFamily:
    """A nominal plant, and plants at draws of the unknowns.

    The inputs, outputs and quantities of all are the same; the number of modes need not be.

    Attributes
    ----------
    nominal : Plant
        At the estimate.
    members : tuple of Plant
        One a draw.
    names : tuple of str
        The unknowns.
    values : ndarray of float, shape (n, n_unknowns)
        The draws, in the unit of each unknown, by member.
    facts : dict
        How it was made, for the record.

    Raises
    ------
    ModelError
        If there is no member, one is not like the nominal plant, or `values` does not fit.
    """

    nominal: Plant
    members: tuple[Plant, ...]
    names: tuple[str, ...] = ()
    values: _Real = field(default_factory=lambda: np.zeros((0, 0)))
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        object.__setattr__(self, "names", tuple(self.names))
        if not self.members:
            raise ModelError("a family needs at least one member beside the nominal plant")
        for number, member in enumerate(self.members):
            for what in ("inputs", "outputs", "quantities", "dt", "delay"):
                own, nominal = getattr(member, what), getattr(self.nominal, what)
                if own != nominal:
                    raise ModelError(f"member {number}: {what} {own!r}; the nominal plant has {nominal!r}")
        values = np.array(self.values, dtype=np.float64)
        values = values.reshape(len(self.members), 0) if values.size == 0 else values
        if values.shape != (len(self.members), len(self.names)):
            raise ModelError(
                f"values has shape {values.shape}; expected {(len(self.members), len(self.names))}, a row a member and "
                "a column an unknown"
            )
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        return len(self.members)

    def __repr__(self) -> str:
        return f"PlantFamily({len(self)} members of {len(self.names)} unknowns about {self.nominal!r})"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.nominal.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.nominal.outputs

    @property
    def error(self) -> float:
        """Largest error of a plant of the family, against its own model, as `Plant.error`."""
        return max(p.error for p in (self.nominal, *self.members))

    def response(self, freq: ArrayLike) -> _Complex:
        """Compute the frequency responses of the members.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Lines in Hz, increasing.

        Returns
        -------
        ndarray of complex, shape (n, n_f, n_outputs, n_inputs)
            Output over input, in their units.

        Raises
        ------
        DataError
            As `Plant.response`.
        """
        return np.array([member.response(freq).values for member in self.members])

    def spread(self, freq: ArrayLike) -> tuple[_Real, _Real]:
        """Return between which magnitudes the family lies, the nominal plant included.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Lines in Hz, increasing.

        Returns
        -------
        lowest, highest : ndarray of float, shape (n_f, n_outputs, n_inputs)
            |output over input|, in their units.

        Raises
        ------
        DataError
            As `Plant.response`.
        """
        size = np.abs(np.concatenate([self.nominal.response(freq).values[None], self.response(freq)]))
        return size.min(axis=0), size.max(axis=0)

    def channel(self, output: str, input: str) -> PlantFamily:
        """Return the family between one input and one output.

        Parameters
        ----------
        output, input : str
            Names.

        Raises
        ------
        OptionError
            If there is none of that name; the nearest is named.
        """
        return self.each(lambda plant: plant.channel(output, input))

    def each(self, change: Callable[[Plant], Plant]) -> PlantFamily:
        """Return the family with something done to every plant, as ``family.each(lambda p: sampled(p, 1e-3))``.

        Parameters
        ----------
        change : callable
            Takes a plant and returns one.

        Raises
        ------
        ModelError
            If the plants are no longer alike.
        """
        return replace(self, nominal=change(self.nominal), members=tuple(change(m) for m in self.members))
