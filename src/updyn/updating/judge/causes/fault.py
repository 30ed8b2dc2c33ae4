"""`Fault`: something that is wrong with measured data, by how much, and how it is undone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import Dof
from updyn.errors import DataError, OptionError, in_all, suggest
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence, labels_of, plain_labels
from updyn.updating.problem.problem import Part

__all__ = [
    "FORCE",
    "Fault",
    "Irreparable",
    "Place",
    "divided",
    "each_sensor",
    "multiplied",
    "place_of",
    "shared_odds",
    "without",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complexfloating[Any, Any]]

#: Number of places that share the odds of a kind at least: with few sensors one place is no
#: likelier than a fault of one sensor.
_FEWEST = 10
#: What stands before the label of a reference, where a fault is written down.
FORCE = "force "


@dataclass(frozen=True, slots=True)
class Place:
    """The channels of some sensors in an array over lines, responses and references.

    Attributes
    ----------
    rows, columns : ndarray of int
        Responses and references; a channel is meant if either is among them.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    def within(self, frf: FRF) -> NDArray[np.bool_]:
        """Return which channels of data are meant, shape (n_i, n_j)."""
        found = np.zeros(frf.values.shape[1:], dtype=np.bool_)
        found[self.rows] = True
        found[:, self.columns] = True
        return found

    def spread(
        self, over_lines: _Complex | _Real, shape: tuple[int, ...]
    ) -> NDArray[np.complex128]:
        """Return values over the lines at the channels, 0 elsewhere, shape (n_f, n_i, n_j)."""
        out = np.zeros(shape, dtype=np.complex128)
        out[:, self.rows] += over_lines[:, None, None]
        out[:, :, self.columns] += over_lines[:, None, None]
        return out


def place_of(channels: Sequence[str], frf: FRF) -> Place:
    """Return where sensors stand in the data; without any, all responses.

    Raises
    ------
    OptionError
        If one is not in the data; the nearest is named.
    """
    rows: list[int] = []
    columns: list[int] = []
    for channel in channels:
        dofs, found = (
            (frf.references, columns) if channel.startswith(FORCE) else (frf.responses, rows)
        )
        label = channel.removeprefix(FORCE)
        names = plain_labels(dofs)
        plain = str(abs(Dof.parse(label)))
        if plain not in names:
            what = "reference" if channel.startswith(FORCE) else "response"
            raise OptionError(f"{label!r} is no {what} of the data; {suggest(plain, names)}")
        found.append(names.index(plain))
    if not channels:
        rows = list(range(len(frf.responses)))
    return Place(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp))


def each_sensor(frf: FRF) -> list[tuple[str, ...]]:
    """Return every response and every reference by itself; a single reference is all channels."""
    found: list[tuple[str, ...]] = [(label,) for label in labels_of(frf)]
    if len(frf.references) > 1:
        found += [(f"{FORCE}{abs(dof)}",) for dof in frf.references]
    return found


def multiplied(frf: FRF, channels: Sequence[str], log_factor: _Complex | _Real) -> FRF:
    """Return data whose channels are multiplied by exp(log_factor), given over the lines."""
    factor = np.exp(place_of(channels, frf).spread(log_factor, frf.values.shape))
    variance = frf.variance
    if variance is not None:
        variance = variance * np.abs(factor) ** 2
    return replace(frf, values=frf.values * factor, variance=variance)


def divided(frf: FRF, log_factor: _Complex) -> FRF:
    """Return data divided by exp(log_factor), shape (n_f, n_i, n_j)."""
    variance = frf.variance
    if variance is not None:
        variance = variance * np.exp(-2.0 * log_factor.real)
    return replace(frf, values=frf.values * np.exp(-log_factor), variance=variance)


@dataclass(frozen=True, slots=True)
class Fault(ABC):
    """A fault of measured data: which channels have it, and by how much.

    A kind of fault is a subclass in a module of its own, registered in `CAUSES`. It is written down
    as ``kind:channels=value``; that text in the job undoes it.

    Parameters
    ----------
    channels : tuple of str
        Labels of the sensors that have it; ``"force 2:Z"`` for a reference. Empty: all data.
    value : float
        By how much; 0 where the kind says it all.

    Attributes
    ----------
    kind : str
        What is wrong.
    odds : float
        How often a test has it, a fault of this kind on one place, before anything is looked at.
    unit : str
        Of `value`; empty where it has none.
    two : str
        Which two things its channels have to name; empty where any number will do.
    tunes : bool
        Whether the data say by how much: `slope` is defined.
    adds : bool
        Whether two such faults are one with the sum of their values.
    blurs : tuple of str
        Kinds that the residual may imitate when this one is accounted for, as only its first
        approximation is.
    leaves_out : bool
        Whether the repair leaves its channels out, so that nothing else is to be told of them.
    adapts : bool
        Whether what it takes away is found anew from model and data as the fit goes on: `refined`.
    constant : bool
        Whether its value has to be the same in both halves of the band: one that is not describes
        something else.
    is_of_model : bool
        Whether the model lacks it, and the data are right.
    told_by : str
        What distinguishes it from others that these data do not tell from it: a sentence, or empty.
    """

    channels: tuple[str, ...] = ()
    value: float = 0.0

    kind: ClassVar[str]
    odds: ClassVar[float] = 1e-3
    unit: ClassVar[str] = ""
    two: ClassVar[str] = ""
    tunes: ClassVar[bool] = False
    adds: ClassVar[bool] = False
    blurs: ClassVar[tuple[str, ...]] = ()
    leaves_out: ClassVar[bool] = False
    adapts: ClassVar[bool] = False
    constant: ClassVar[bool] = False
    is_of_model: ClassVar[bool] = False
    told_by: ClassVar[str] = ""

    @property
    def prior(self) -> float:
        """How often a test has it on its place, before anything is looked at."""
        return self.odds

    @property
    def changes_all(self) -> bool:
        """Whether it changes all data so much that a fit is needed to see it."""
        return False

    @classmethod
    @abstractmethod
    def suspected(cls, evidence: Evidence) -> Iterable[Self]:
        """Return the faults of this kind that are worth a look, given model and data."""

    @abstractmethod
    def repair(self, frf: FRF) -> FRF:
        """Return the data without the fault."""

    def undo(self, evidence: Evidence) -> FRF:
        """Return the data of the evidence without the fault.

        Where the data alone do not tell what they would be, the model there does.
        """
        return self.repair(evidence.frf)

    def slope(self, evidence: Evidence) -> _Complex:
        """Return d ln(measured) / d value, shape (n_f, n_i, n_j); 0 where it does not tune."""
        return np.zeros(evidence.frf.values.shape, dtype=np.complex128)

    def numbers(self, frf: FRF) -> int:
        """Return how many numbers of it the data determine."""
        return int(self.tunes)

    def refined(self, evidence: Evidence) -> Self:
        """Return the fault as model and data show it at a point; itself where it does not adapt."""
        return self

    def others(self, frf: FRF) -> FRF:
        """Return the data in which its channels do not count, where it leaves them out."""
        return frf

    def searched(self, evidence: Evidence) -> Self:
        """Return the fault by its best size at a point that the other channels told."""
        return self

    def settled(self, part: Part, x: _Real) -> Self:
        """Return the fault as all data of a part tell it, where it adapts; by default itself."""
        return self

    def described(self, part: Part, x: _Real) -> Self:
        """Return the fault with what its statement says of the model where a trial ended."""
        return self

    def accounted(self, part: Part, x: _Real) -> Part:
        """Return the part that takes account of the fault: on data that are freed of it at x."""
        return part.with_data(self.undo(Evidence(part, x)))

    def remaining(self, part: Part, x: _Real) -> Part:
        """Return the part in which further faults are searched, with the model of the given one."""
        if self.is_of_model:
            return part.with_data(self.undo(Evidence(part, x)))
        return self.accounted(part, x)

    def begun(self, part: Part, x: _Real) -> _Real:
        """Return the point from which a fit that takes account of the fault begins."""
        return x

    def relatives(self, part: Part) -> Iterable[Fault]:
        """Return other faults that would do nearly the same to the data, to be tried as well."""
        return ()

    def elsewhere(self, evidence: Evidence) -> Iterable[Fault]:
        """Return the same fault at other places, the likeliest at a point first."""
        return ()

    def plausible(self) -> bool:
        """Return whether a fault of this size is possible and worth a word."""
        return True

    @abstractmethod
    def statement(self) -> str:
        """Return what is wrong, in a sentence."""

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return f'Look at it; if it is so, write repair = ["{self.written}"] under [test].'

    @property
    def where(self) -> str:
        """The channels in words."""
        if not self.channels:
            return "all channels"
        shown = ", ".join(self.channels[:4])
        return shown + in_all(len(self.channels)) if len(self.channels) > 4 else shown

    def does(self, one: str, several: str) -> str:
        """Return the channels with the verb that goes with one, or with several."""
        text = f"{self.where} {one if len(self.channels) == 1 else several}"
        return text[0].upper() + text[1:]

    @property
    def named(self) -> str:
        """What is wrong where, whatever its size: ``kind:channels``."""
        return f"{self.kind}:{','.join(self.channels)}" if self.channels else self.kind

    @property
    def written(self) -> str:
        """How the fault is written down: ``kind:channels=value``."""
        return f"{self.named}={self.value:.9g}" if self.value else self.named

    @classmethod
    def read(cls, channels: str, value: str) -> Self:
        """Return the fault that is written down, from its channels and its value.

        Raises
        ------
        OptionError
            If the value is no number, a label cannot be read, or it does not name two of what it
            needs.
        """
        names = tuple(name.strip() for name in channels.split(",") if name.strip())
        for name in names:
            Dof.parse(name.removeprefix(FORCE))
        if cls.two and (len(names) != 2 or value):
            raise OptionError(f"repair {cls.kind!r}: expected two {cls.two}, found {channels!r}")
        try:
            number = float(value) if value else 0.0
        except ValueError:
            raise OptionError(f"repair {cls.kind!r}: {value!r} is no number") from None
        return cls(names, number)


class Irreparable(Fault):
    """A fault that no change of the data undoes."""

    __slots__ = ()

    @property
    def written(self) -> str:
        """Nothing, unless the kind says otherwise."""
        return ""

    def repair(self, frf: FRF) -> FRF:
        """Refuse, unless the kind can.

        Raises
        ------
        DataError
            Always; the message says what to do.
        """
        raise DataError(f"{self.kind}: no change of the data undoes it. {self.remedy}")


def shared_odds(odds: float, places: int) -> float:
    """Return the odds of one of some places, which share those of the kind."""
    return odds / max(places, _FEWEST)


def without(fault: Fault, frf: FRF) -> FRF:
    """Return data without the sensors and forces that have a fault.

    Raises
    ------
    DataError
        If nothing else is left.
    """
    place = place_of(fault.channels, frf)
    rows = np.setdiff1d(np.arange(len(frf.responses)), place.rows)
    columns = np.setdiff1d(np.arange(len(frf.references)), place.columns)
    if not (fault.channels and len(rows) and len(columns)):
        raise DataError(f"repair {fault.written!r}: without {fault.where} no data are left")
    return frf.select(
        responses=[frf.responses[int(i)] for i in rows],
        references=[frf.references[int(j)] for j in columns],
    )
