"""Selection of unknowns before a fit: which are fitted, linked or left out, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from updyn.model import Model
from updyn.updating.problem.parameters import Parameter, ParameterSet

__all__ = ["Selection"]

#: So many names are written out in a sentence; the record has all.
_NAMED = 6


@dataclass(frozen=True, slots=True)
class Selection:
    """Unknowns chosen before a fit; `updyn.update` takes it in place of its `parameters`.

    Attributes
    ----------
    parameters : ParameterSet
        The unknowns to fit, in the order in which they were given.
    order : tuple of str
        The same, the most telling first: each the one that the data see best beside those before
        it.
    left_out : dict of str to str
        Why each of the others is left out.
    held : tuple of Parameter
        These others. They stay at their start.
    merged : dict of str to tuple of str
        Linked unknowns that were made here, and the unknowns that each stands for.
    cosines : dict of str to float
        For each of these the least cosine between the effects of two of its members.
    remarks : tuple of str
        What was seen, but not acted upon.
    singular_values : tuple of float
        Of the Jacobian of the chosen unknowns with unit columns, falling.
    collinearity : float
        Collinearity index of the chosen unknowns (Brun, Reichert & Kuensch 2001): 1 / the last of
        these.
    """

    parameters: ParameterSet
    order: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    held: tuple[Parameter, ...] = ()
    merged: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    cosines: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    singular_values: tuple[float, ...] = ()
    collinearity: float = float("nan")

    @classmethod
    def of(cls, parameters: ParameterSet | Selection) -> Selection:
        """Return a selection as it is; of plain unknowns, one that fits them all.

        Parameters
        ----------
        parameters : ParameterSet or Selection
            Either.

        Returns
        -------
        Selection
        """
        return parameters if isinstance(parameters, Selection) else cls(parameters)

    @property
    def note(self) -> str:
        """What was joined and left out, in sentences; empty where nothing was."""
        parts = [
            f"{_listed(members)} were joined into the one unknown {name}, as the data see them"
            f" alike (cosine {self.cosines[name]:.4f} or more)."
            for name, members in self.merged.items()
        ]
        if self.left_out:
            were, they = "were", "they stay at their"
            if len(self.left_out) == 1:
                were, they = "was", "it stays at its"
            parts.append(
                f"{_listed(list(self.left_out))} {were} left out before the fit: {they} start."
            )
        return " ".join(parts)

    @property
    def record(self) -> dict[str, Any]:
        """All of it as plain data, for the record of a run."""
        return {
            "fitted": list(self.parameters.names),
            "left out": dict(self.left_out),
            "merged": {name: list(members) for name, members in self.merged.items()},
            "cosines": dict(self.cosines),
            "remarks": list(self.remarks),
            "collinearity": self.collinearity,
        }

    @property
    def option(self) -> dict[str, Any]:
        """The record as an option of a run; empty where nothing was joined or left out."""
        return {"selection": self.record} if self.merged or self.left_out else {}

    def summary(self) -> str:
        """Return the selection as text: fitted, joined and left out unknowns, with reasons."""
        lines = [
            f"{len(self.parameters)} unknowns are fitted (collinearity index"
            f" {self.collinearity:.3g}): " + ", ".join(self.order or self.parameters.names)
        ]
        lines += [
            f"  joined: {name} = {', '.join(members)} (cosine {self.cosines[name]:.4f} or more)"
            for name, members in self.merged.items()
        ]
        lines += [f"  left out: {name}: {reason}" for name, reason in self.left_out.items()]
        return "\n".join([*lines, *(f"  {remark}" for remark in self.remarks)])

    def start_of(self, model: Model) -> Model:
        """Return a model with what was left out at its start.

        Parameters
        ----------
        model : Model
            As given: the start of an unknown that is fitted is looked after by the fit.

        Returns
        -------
        Model
            Itself where all that was left out starts as the model stands.
        """
        changes: dict[str, dict[str, float]] = {}
        for p in self.held:
            for d in p.acts_on:
                group = model.groups.get(d.group)
                if (
                    group is None or p.is_channel or not group.has(d.quantity)
                ):  # a configuration may lack it
                    continue
                if p.start != (1.0 if p.is_factor else getattr(group, d.quantity)):
                    own = changes.setdefault(d.group, {})
                    own[d.quantity] = (
                        own.get(d.quantity, 1.0) * p.start**d.power if p.is_factor else p.start
                    )
        return model.scaled(changes) if changes else model


def _listed(names: list[str] | tuple[str, ...]) -> str:
    return ", ".join(names[:_NAMED]) + (
        f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    )
