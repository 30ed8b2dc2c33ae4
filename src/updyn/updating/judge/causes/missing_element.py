"""`MissingElement`: a spring, dashpot or mass at measured DOFs that the model lacks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar, Self

from updyn.arrays import ComplexArray
from updyn.frf import FRF
from updyn.remedy import IN_PYTHON, Remedy
from updyn.updating.judge.causes.altering import AlteringFault
from updyn.updating.judge.causes.element import AddedElement, MeasuredDofs
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.screening import select_elements
from updyn.updating.judge.causes.settings import MISSING_ELEMENT
from updyn.updating.problem.problem import FRFPart

__all__ = ["MissingElement", "list_directed_places"]


@dataclass(frozen=True, slots=True)
class MissingElement(AlteringFault):
    """An element of size `value` at `channels` that the model lacks.

    It acts between two DOFs, or, unless `between`, between each DOF and the ground.
    """

    between: bool = False

    is_positive: ClassVar[bool] = True
    #: Matrix of a group to which it contributes.
    quantity: ClassVar[str]
    #: Noun in a sentence.
    noun: ClassVar[str]
    #: Units of its size: for a translation, for a rotation.
    units: ClassVar[tuple[str, str]]
    #: Loss factor of the element.
    loss: ClassVar[float] = 0.0

    @classmethod
    def applies_to(cls, frf: FRF) -> bool:
        """Return whether the receptances of the excited structure are symmetric."""
        return frf.force is None

    @classmethod
    def list_places(cls, part: FRFPart) -> Iterator[tuple[tuple[str, ...], bool]]:
        """Yield the DOFs of each tested place, and whether the element acts between them."""
        yield from list_directed_places(part.frf)

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Fault]:
        """Yield the elements that explain most, to first order."""
        return cls.find_best(evidence, MISSING_ELEMENT.most)

    @classmethod
    def find_best(cls, evidence: Evidence, most: int) -> list[Self]:
        """Return the elements that explain most, to first order."""
        every = [
            AddedElement(cls.quantity, *at, 0.0, cls.loss) for at in cls.list_places(evidence.part)
        ]
        best = select_elements(evidence, every, most)
        return [cls(one.labels, one.value, one.between, n_places=len(every)) for one in best]

    def list_other_places(self, evidence: Evidence) -> Iterable[Fault]:
        """Return the elements at other places that explain most, to first order."""
        best = self.find_best(evidence, MISSING_ELEMENT.next_places)
        others = [one for one in best if one.channels != self.channels]
        return [replace(one, n_places=self.n_places) for one in others]

    @property
    def alteration(self) -> AddedElement:
        """The element that the model lacks."""
        return AddedElement(self.quantity, self.channels, self.between, self.value, self.loss)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return the derivative of the model's ln H by the size of the element."""
        return evidence.receptances.slope(self.alteration)

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return the model's ln H with the element over H."""
        return evidence.receptances.log_change(self.alteration)

    @property
    def size_text(self) -> str:
        """Size with its unit."""
        return f"{self.value:.4g} {self.units[':R' in self.channels[0]]}"

    @property
    def place_text(self) -> str:
        """Place as text."""
        if self.between:
            return f"between {self.channels[0]} and {self.channels[1]}"
        return f"at {' and '.join(self.channels)}"

    def statement(self) -> str:
        """Return a sentence with the place and the size."""
        return f"The model lacks a {self.noun} of {self.size_text} {self.place_text}."

    @property
    def search_advice(self) -> str:
        """First advice to the user."""
        return "Look for it there. If it exists, add it to the model"

    @property
    def remedy(self) -> Remedy:
        """Advice to the user, with the Python that adds the element to the model as an unknown."""
        name = f"{self.noun} {' '.join(self.channels)}"
        between = "between=True, " if self.between else ""
        loss = f", loss_factor={self.loss:g}" if self.loss else ""
        dofs = ", ".join(f'"{label}"' for label in self.channels)
        lines = (
            f'model = model.with_element("{name}", [{dofs}], {between}'
            f"{self.quantity}={self.value:.6g}{loss})",
            f'unknowns += updyn.parameters(model, {self.quantity}="{name}")',
        )
        return Remedy(f"{self.search_advice}:", lines, IN_PYTHON)


def list_directed_places(frf: FRF) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Yield each measured DOF, and each pair of the same direction; pairs with True."""
    labels = MeasuredDofs.of(frf).labels
    for label in labels:
        yield (label,), False
    for a, b in combinations(labels, 2):
        if a.partition(":")[2] == b.partition(":")[2]:
            yield (a, b), True
