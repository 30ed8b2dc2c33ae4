"""`build_variants`: variants of a model without a frequent mistake in its definition.

The mistake is exchanged section axes of beams (`updyn.exchanged`), in one group or in all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from updyn.model import Model

__all__ = ["Variant", "build_variants", "exchanged_axes"]


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """A model with the section axes of some groups exchanged."""

    base: Model
    groups: tuple[str, ...]

    def model(self) -> Model:
        """Return the variant, with the same DOFs; ModelError if the elements cannot be computed."""
        changed = {name: self.base.group(name).with_exchanged_axes() for name in self.groups}
        return replace(self.base, groups={**self.base.groups, **changed})

    @property
    def mistake(self) -> str:
        """The mistake in the model if this variant is right, without a full stop."""
        return exchanged_axes(self.groups)

    @property
    def remedy(self) -> str:
        """The change to the definition of the model, in one or two sentences."""
        found = (self.base.group(name).exchanged for name in self.groups)
        every = [one for one in found if one is not None]
        text = f"Exchange {'; '.join(dict.fromkeys(one.what for one in every))}"
        turns = [one.turn for one in every if one.turn]
        if len(every) == 1:
            return ", or turn ".join([text, *turns]) + "."
        return f"{text}. Or turn the orientation of each by 90 degrees." if turns else f"{text}."


def exchanged_axes(groups: Sequence[str]) -> str:
    """Return a statement on exchanged section axes of groups, without a full stop."""
    *others, last = map(repr, groups)
    names = f"group {last}"
    if others:
        names = f"groups {', '.join(others)} and {last}"
    return f"the section axes of the {names} are exchanged (Iy and Iz)"


def build_variants(model: Model) -> tuple[Variant, ...]:
    """Return the variants of a model with exchanged section axes of one group, and of all."""
    names = [name for name, group in model.groups.items() if group.exchanged is not None]
    each = [Variant(model, (name,)) for name in names]
    return (*each, Variant(model, tuple(names))) if len(names) > 1 else tuple(each)
