"""Base class `Fault` of the faults of measured data, and helpers for their channels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DataError, OptionError, SolverError, in_all, suggest
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.remedy import Remedy
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.labels import list_response_labels, list_unsigned_labels
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, CAUSE_ODDS
from updyn.updating.problem.problem import FRFPart

__all__ = [
    "FORCE",
    "ChannelIndices",
    "Fault",
    "IrreparableFault",
    "divide_data",
    "divide_odds",
    "find_channels",
    "list_channels",
    "list_sides",
    "multiply_channels",
    "remove_channels",
]

_Complex = NDArray[np.complexfloating]

#: Prefix of the label of a reference in the text of a fault.
FORCE = "force "


@dataclass(frozen=True, slots=True)
class ChannelIndices:
    """Channels whose response is in `rows` or whose reference is in `columns`."""

    rows: IndexArray
    columns: IndexArray

    def channel_mask(self, frf: FRF) -> BoolArray:
        """Return which channels of the data belong to the place, shape (n_i, n_j)."""
        found = np.zeros(frf.values.shape[1:], dtype=np.bool_)
        found[self.rows] = True
        found[:, self.columns] = True
        return found

    def broadcast(self, over_lines: _Complex | RealArray, shape: tuple[int, ...]) -> ComplexArray:
        """Return values over the lines at the channels, else 0, shape (n_f, n_i, n_j)."""
        out = np.zeros(shape, dtype=np.complex128)
        out[:, self.rows] += over_lines[:, None, None]
        out[:, :, self.columns] += over_lines[:, None, None]
        return out


def find_channels(channels: Sequence[str], frf: FRF) -> ChannelIndices:
    """Return the place of sensors and forces in the data; all responses if `channels` is empty."""
    rows: list[int] = []
    columns: list[int] = []
    for channel in channels:
        dofs, found = (
            (frf.references, columns) if channel.startswith(FORCE) else (frf.responses, rows)
        )
        label = channel.removeprefix(FORCE)
        names = list_unsigned_labels(dofs)
        plain = str(abs(Dof.parse(label)))
        if plain not in names:
            what = "reference" if channel.startswith(FORCE) else "response"
            raise OptionError(f"{label!r} is no {what} of the data; {suggest(plain, names)}")
        found.append(names.index(plain))
    if not channels:
        rows = list(range(len(frf.responses)))
    return ChannelIndices(np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp))


def list_channels(frf: FRF) -> list[tuple[str, ...]]:
    """Return each response and, if there are several, each reference as a tuple of one channel."""
    (_, sensors), (_, forces) = list_sides(frf)
    return [(name,) for name in [*sensors, *(forces if len(forces) > 1 else [])]]


def list_sides(frf: FRF) -> list[tuple[DofSet, list[str]]]:
    """Return responses and references, each with the names of its channels."""
    forces = [f"{FORCE}{label}" for label in list_unsigned_labels(frf.references)]
    return [(frf.responses, list_response_labels(frf)), (frf.references, forces)]


def multiply_channels(frf: FRF, channels: Sequence[str], log_factor: _Complex | RealArray) -> FRF:
    """Return the data with channels multiplied by exp(log_factor), given over the lines.

    Raises SolverError if a factor is beyond the range of numbers, as `divide_data`.
    """
    spread = find_channels(channels, frf).broadcast(log_factor, frf.values.shape)
    return divide_data(frf, -spread)


def divide_data(frf: FRF, log_factor: _Complex | RealArray) -> FRF:
    """Return the data divided by exp(log_factor), shape (n_f, n_i, n_j)."""
    largest = float(np.abs(log_factor.real).max(initial=0.0))
    if not largest <= CAUSE_MISFIT.largest_log_factor:
        raise SolverError(f"data cannot be corrected by a factor of exp({largest:.3g})")
    variance = frf.variance
    if variance is not None:
        variance = variance * np.exp(-2.0 * log_factor.real)
    return replace(frf, values=frf.values * np.exp(-log_factor), variance=variance)


@dataclass(frozen=True, slots=True)
class Fault(ABC):
    """A fault of measured data: the affected channels and its size.

    A kind of fault is a subclass, registered in `CAUSES`. The text of a fault
    is ``kind:channels=value``; a job with this text under ``repair`` corrects it.

    Parameters
    ----------
    channels : tuple of str
        Labels of the affected sensors; ``"force 2:Z"`` for a reference. Empty: all data.
    value : float
        Size of the fault; 0 for kinds without a size.

    Attributes
    ----------
    kind : str
        Name of the kind.
    odds : float
        Prior odds that a test has a fault of this kind at one place.
    unit : str
        Unit of `value`; empty if it has no unit.
    pair_noun : str
        Noun for the two items that its channels have to name; empty if any number is valid.
    has_free_size : bool
        Whether the data determine the size: `slope` is defined.
    is_positive : bool
        Whether only sizes above 0 are possible.
    is_additive : bool
        Whether two such faults equal one with the sum of their values.
    imitated_kinds : tuple of str
        Kinds that the residual may imitate after the correction, because the correction is of first
        order only.
    omits_channels : bool
        Whether the repair omits its channels, so that no further faults of these are reported.
    is_adaptive : bool
        Whether the correction is computed anew from model and data during the fit, by `adapt_to`.
    has_constant_size : bool
        Whether its value has to be the same in both halves of the band; otherwise it is not
        reported.
    alters_model : bool
        Whether it is an error of the model, with correct data, and a trial alters the model.
    needs_forces : bool
        Whether it concerns measured forces, which a transmissibility does not have.
    concerns_model : bool
        Whether it is an error of the model although a trial alters the data.
    exchanges_data : bool
        Whether it only exchanges the data of its two channels; all such faults are compared at
        once.
    moves_channel : bool
        Whether only its first channel is at the place of its second one; all such faults are
        compared at once.
    is_local : bool
        Whether its correction changes no other data than those of its channels.
    distinguishing_test : str
        How to distinguish it from other faults that explain the same data: a sentence, or empty.
    advice, remark : str
        Advice to the user, before and after the setting of the job that corrects it, if any.
    """

    channels: tuple[str, ...] = ()
    value: float = 0.0

    kind: ClassVar[str]
    odds: ClassVar[float] = 1e-3
    unit: ClassVar[str] = ""
    pair_noun: ClassVar[str] = ""
    has_free_size: ClassVar[bool] = False
    is_positive: ClassVar[bool] = False
    is_additive: ClassVar[bool] = False
    imitated_kinds: ClassVar[tuple[str, ...]] = ()
    omits_channels: ClassVar[bool] = False
    is_adaptive: ClassVar[bool] = False
    has_constant_size: ClassVar[bool] = False
    alters_model: ClassVar[bool] = False
    needs_forces: ClassVar[bool] = False
    concerns_model: ClassVar[bool] = False
    exchanges_data: ClassVar[bool] = False
    moves_channel: ClassVar[bool] = False
    is_local: ClassVar[bool] = False
    distinguishing_test: ClassVar[str] = ""
    advice: ClassVar[str] = "Check this. If it is confirmed, write:"
    remark: ClassVar[str] = ""

    @property
    def prior(self) -> float:
        """Prior odds of the fault at its place."""
        return self.odds

    @property
    def affects_all_data(self) -> bool:
        """Whether it changes all data so much that it is visible only after a fit."""
        return False

    @classmethod
    def applies_to(cls, frf: FRF) -> bool:
        """Return whether data of this kind can have the fault, by default as `needs_forces`.

        Parameters
        ----------
        frf : FRF
            Measured data.

        Returns
        -------
        bool
        """
        return not cls.needs_forces or frf.quantity != TRANSMISSIBILITY

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Fault]:
        """Return the faults of this kind that are worth testing at a point.

        By default none: for kinds that are found in another way than at a point.

        Parameters
        ----------
        evidence : Evidence
            Model and data at the point.

        Returns
        -------
        iterable of Fault
            Faults with a first size; several sizes of one fault are allowed.
        """
        return ()

    @abstractmethod
    def repair(self, frf: FRF) -> FRF:
        """Return the data without the fault.

        Parameters
        ----------
        frf : FRF
            Measured data.

        Returns
        -------
        FRF
            Data with the fault corrected.
        """

    def log_change(self, evidence: Evidence) -> _Complex | None:
        """Return the change of ln H by the fault, from the model; None if the data correct it."""
        return None

    def repair_with_model(self, evidence: Evidence) -> FRF:
        """Return the data of the evidence without the fault.

        If the correction cannot be computed from the data alone, it uses the model at this point.

        Parameters
        ----------
        evidence : Evidence
            Model and data at the point.

        Returns
        -------
        FRF
            Data with the fault corrected.
        """
        change = self.log_change(evidence)
        return self.repair(evidence.frf) if change is None else divide_data(evidence.frf, change)

    def slope(self, evidence: Evidence) -> _Complex:
        """Return the derivative of the log data by the size of the fault; 0 without a size.

        Parameters
        ----------
        evidence : Evidence
            Model and data at the point.

        Returns
        -------
        ndarray of complex, shape (n_f, n_i, n_j)
            d ln(measured) / d value.
        """
        return np.zeros(evidence.frf.values.shape, dtype=np.complex128)

    @property
    def ends_search(self) -> bool:
        """Whether further causes are sought only after this one has been corrected."""
        return False

    @property
    def changed_channels(self) -> tuple[str, ...]:
        """Channels to which its correction is limited; empty if it may change all data."""
        return self.channels if self.is_local else ()

    @property
    def special_cases(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Kind and channels of the faults that are special cases of this one."""
        return ()

    def count_parameters(self, frf: FRF) -> int:
        """Return how many numbers of the fault the data determine."""
        return int(self.has_free_size)

    def adapt_to(self, evidence: Evidence) -> Self:
        """Return the fault estimated at a point; itself if only `slope` gives its size."""
        return self

    def mask_channels(self, frf: FRF) -> FRF:
        """Return the data in which its channels have no weight, if its repair omits them."""
        return frf

    def fit_all_data(self, part: FRFPart, x: RealArray) -> Self:
        """Return the fault estimated from all data of a part."""
        return self.adapt_to(Evidence(part, x))

    def add_model_figures(self, part: FRFPart, x: RealArray) -> Self:
        """Return the fault with figures of the model at x for its statement; x ends a trial."""
        return self

    def correct_part(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part corrected for the fault; by default with the data corrected at x."""
        return part.with_data(self.repair_with_model(Evidence(part, x)))

    def prepare_next_search(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part for the search of further faults, with the model of the given part."""
        if self.alters_model:
            return part.with_data(self.repair_with_model(Evidence(part, x)))
        return self.correct_part(part, x)

    def choose_start(self, part: FRFPart, x: RealArray) -> RealArray:
        """Return the starting point of a fit that takes account of the fault."""
        return x

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return other faults with nearly the same effect on the data; they are tried as well."""
        return ()

    def list_other_places(self, evidence: Evidence) -> Iterable[Fault]:
        """Return the same fault at other places, the most likely at a point first."""
        return ()

    def is_plausible(self) -> bool:
        """Return whether a fault of this size is possible and large enough to report."""
        return self.value > 0.0 or not self.is_positive

    @abstractmethod
    def statement(self) -> str:
        """Return a sentence that describes the fault."""

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        text = self.repair_text
        return Remedy.repair(self.advice, text, self.remark) if text else Remedy(self.advice)

    @property
    def channel_text(self) -> str:
        """The channels as text."""
        if not self.channels:
            return "all channels"
        shown = ", ".join(self.channels[:4])
        return shown + in_all(len(self.channels)) if len(self.channels) > 4 else shown

    def begin_sentence(self, singular: str, plural: str) -> str:
        """Return the channels as the subject of a sentence, with a verb for one or for several."""
        text = f"{self.channel_text} {singular if len(self.channels) == 1 else plural}"
        return text[0].upper() + text[1:]

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Kind and channels, without the size."""
        return self.kind, self.channels

    @property
    def name(self) -> str:
        """Kind and channels without the size: ``kind:channels``."""
        return f"{self.kind}:{','.join(self.channels)}" if self.channels else self.kind

    @property
    def repair_text(self) -> str:
        """Text of the fault: ``kind:channels=value``."""
        return f"{self.name}={self.value:.9g}" if self.value else self.name

    @classmethod
    def parse(cls, channels: str, value: str) -> Self:
        """Return the fault from the channels and the value of its text.

        Raises
        ------
        OptionError
            If the value is not a number, a label cannot be read, or the kind needs two channels and
            the text does not name two.
        """
        names = tuple(name.strip() for name in channels.split(",") if name.strip())
        for name in names:
            Dof.parse(name.removeprefix(FORCE))
        if cls.pair_noun and (len(names) != 2 or value):
            raise OptionError(
                f"repair {cls.kind!r}: expected two {cls.pair_noun}, found {channels!r}"
            )
        try:
            number = float(value) if value else 0.0
        except ValueError:
            raise OptionError(f"repair {cls.kind!r}: {value!r} is no number") from None
        return cls(names, number)


class IrreparableFault(Fault):
    """A fault that no change of the data corrects."""

    __slots__ = ()

    @property
    def repair_text(self) -> str:
        """Empty by default: a job cannot correct the fault."""
        return ""

    def repair(self, frf: FRF) -> FRF:
        """Raise a `DataError` with the remedy; kinds that can correct data override this."""
        raise DataError(f"{self.kind}: no change of the data corrects it. {self.remedy}")


def divide_odds(odds: float, n_places: int) -> float:
    """Return the prior odds of one place: those of the kind divided by the number of places."""
    return odds / max(n_places, CAUSE_ODDS.least_places)


def remove_channels(fault: Fault, frf: FRF) -> FRF:
    """Return the data without the channels of a fault; a `DataError` if no other data remain."""
    indices = find_channels(fault.channels, frf)
    rows = np.setdiff1d(np.arange(len(frf.responses)), indices.rows)
    columns = np.setdiff1d(np.arange(len(frf.references)), indices.columns)
    if not (fault.channels and len(rows) and len(columns)):
        raise DataError(
            f"repair {fault.repair_text!r}: without {fault.channel_text} no data remain"
        )
    return frf.select(
        responses=[frf.responses[int(i)] for i in rows],
        references=[frf.references[int(j)] for j in columns],
    )
