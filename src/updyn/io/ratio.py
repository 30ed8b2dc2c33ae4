"""Units of FRFs as stated in files and by users: a motion per force, or per motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from updyn.dofs import Dof
from updyn.errors import FormatError
from updyn.units import Unit, split_ratio

__all__ = ["Ratio"]

#: Motions of the dimensionless unit "1"; their kind does not change the values.
_ACCELERATION = Unit("accelerance", 1.0)


@dataclass(frozen=True, slots=True)
class Ratio:
    """A stated unit of values: its label, and the units of the motion and the force.

    Instead of a force, a transmissibility has another motion of the same kind.
    """

    label: str
    motion: Unit
    force: Unit

    @classmethod
    def of(cls, label: str, where: str, path: str | Path, line: int | None = None) -> Ratio:
        """Return the unit of a label."""
        found = split_ratio(label)
        if label.strip() == "1":
            found = _ACCELERATION, _ACCELERATION
        if found is None:
            hint = ""
            if "db" in label.casefold():
                hint = "; decibels are a magnitude without phase"
            raise FormatError(
                f"{where}unit {label!r}; expected a motion per force, such as 'g/N' or"
                f" 'm/s^2/N'{hint}",
                path,
                line,
            )
        return cls(label, *found)

    @property
    def quantity(self) -> str:
        """Quantity of the values."""
        return self.motion.kind if self.force.kind == "force" else "transmissibility"

    @property
    def factor(self) -> float:
        """Factor to SI."""
        return self.motion.factor / self.force.factor

    def agrees(self, other: Ratio) -> bool:
        """Return whether another unit has the same quantity and size."""
        return (self.quantity, self.factor) == (other.quantity, other.factor)

    def check(
        self,
        pair: tuple[Dof, Dof],
        path: str | Path,
        line: int | None = None,
        remedy: str = "state units in the names of the columns",
    ) -> None:
        """Refuse a unit of a translation or a force for a rotation or a moment, or the reverse."""
        for dof, unit, what in (
            (pair[0], self.motion, "motion"),
            (pair[1], self.force, "force" if self.force.kind == "force" else "motion"),
        ):
            if unit.angular != dof.direction.startswith("R"):
                raise FormatError(
                    f"H({pair[0]}/{pair[1]}): the {what} at {dof} cannot be in {self.label!r};"
                    f" {remedy}",
                    path,
                    line,
                )
