"""`variants_of`: the models that a model would be without a frequent mistake in its definition.

The mistake is exchanged section axes of beams (`updyn.exchanged`): of one group, or of all.
"""

from __future__ import annotations

from dataclasses import dataclass

from updyn.model import Model

__all__ = ["Variant", "variants_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """A model with the section axes of some groups exchanged.

    Parameters
    ----------
    base : Model
        The model as it is.
    groups : tuple of str
        The groups whose beams have exchanged section axes.
    """

    base: Model
    groups: tuple[str, ...]

    def model(self) -> Model:
        """Compute the model.

        Returns
        -------
        Model
            On the same DOFs.

        Raises
        ------
        ModelError
            If the elements cannot be computed.
        """
        changed = {name: self.base.group(name).with_exchanged_axes() for name in self.groups}
        base = self.base
        return Model({**base.groups, **changed}, base.dofs, base.geometry, base.title)

    @property
    def mistake(self) -> str:
        """What is wrong with the model if this one is right, without a full stop."""
        if len(self.groups) == 1:
            return f"the section axes of the group {self.groups[0]!r} are exchanged (Iy and Iz)"
        names = ", ".join(map(repr, self.groups[:-1])) + f" and {self.groups[-1]!r}"
        return f"the section axes of the groups {names} are exchanged (Iy and Iz)"

    @property
    def remedy(self) -> str:
        """What to change in the definition of the model, in sentences."""
        found = [self.base.group(name).exchanged for name in self.groups]
        return " ".join(dict.fromkeys(one.remedy for one in found if one is not None))


def variants_of(model: Model) -> tuple[Variant, ...]:
    """Return the variants of a model: exchanged section axes of one group, and of all.

    Parameters
    ----------
    model : Model
        Made of beams whose sections are known; others have none.

    Returns
    -------
    tuple of Variant
        Nothing is computed until `Variant.model`.
    """
    names = [name for name, group in model.groups.items() if group.exchanged is not None]
    each = [Variant(model, (name,)) for name in names]
    return (*each, Variant(model, tuple(names))) if len(names) > 1 else tuple(each)
