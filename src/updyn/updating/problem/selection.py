"""Selection of unknowns before a fit: fitted, linked and left out, with reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from updyn.model import Model
from updyn.settings import MESSAGES
from updyn.updating.problem.parameters import Parameter, ParameterSet

__all__ = ["Selection"]


@dataclass(frozen=True, slots=True)
class Selection:
    """Unknowns selected before a fit; an argument of `updyn.update` in place of `parameters`.

    Attributes
    ----------
    parameters : ParameterSet
        The unknowns to fit, in the original order.
    order : tuple of str
        Their names by identifiability: each is the one that the data determine best in addition to
        those before it.
    left_out : dict of str to str
        Unknowns that are left out, with the reason.
    held : tuple of Parameter
        The left-out unknowns. They stay at their start values.
    merged : dict of str to tuple of str
        New linked unknowns, and the unknowns that each replaces.
    cosines : dict of str to float
        For each linked unknown, the smallest cosine between the effects of two of its members.
    remarks : tuple of str
        Observations that had no consequence.
    singular_values : tuple of float
        Singular values of the Jacobian of the selected unknowns with unit columns, descending.
    collinearity : float
        Collinearity index of the selected unknowns (Brun, Reichert & Kuensch 2001): the inverse of
        the last of these.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> chosen = updyn.select(model, chain.measure(), updyn.parameters(model, stiffness="all"), n=2)
    >>> len(chosen.parameters), len(chosen.left_out)
    (2, 2)
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
        """Return a selection unchanged, or a selection of all given unknowns.

        Parameters
        ----------
        parameters : ParameterSet or Selection
            Unknowns or a selection.

        Returns
        -------
        Selection
        """
        if isinstance(parameters, Selection):
            return parameters
        return cls(parameters)

    @property
    def note(self) -> str:
        """Sentences on joined and left-out unknowns; empty if all are fitted."""
        parts = []
        for name, members in self.merged.items():
            parts.append(
                f"{_join_names(members)} were joined into the one unknown {name}, as their effects"
                f" on the data are nearly parallel (cosine {self.cosines[name]:.4f} or more)."
            )
        if self.left_out:
            were, they = "were", "they stay at their"
            if len(self.left_out) == 1:
                were, they = "was", "it stays at its"
            parts.append(
                f"{_join_names(list(self.left_out))} {were} left out before the fit: {they} start."
            )
        return " ".join(parts)

    @property
    def record(self) -> dict[str, Any]:
        """The selection as plain data for the record of a run."""
        return {
            "fitted": list(self.parameters.names),
            "left out": dict(self.left_out),
            "merged": dict(zip(self.merged, map(list, self.merged.values()), strict=True)),
            "cosines": dict(self.cosines),
            "remarks": list(self.remarks),
            "collinearity": self.collinearity,
        }

    @property
    def option(self) -> dict[str, object]:
        """The record as an option of a run; empty if no unknown was joined or left out."""
        if not self.merged and not self.left_out:
            return {}
        return {"selection": self.record}

    def summary(self) -> str:
        """Return the selection as text: fitted, joined and left-out unknowns, with reasons."""
        fitted = ", ".join(self.order or self.parameters.names)
        index = f"collinearity index {self.collinearity:.3g}"
        lines = [f"{len(self.parameters)} unknowns are fitted ({index}): {fitted}"]
        for name, members in self.merged.items():
            least = f"cosine {self.cosines[name]:.4f} or more"
            lines.append(f"  joined: {name} = {', '.join(members)} ({least})")
        for name, reason in self.left_out.items():
            lines.append(f"  left out: {name}: {reason}")
        for remark in self.remarks:
            lines.append(f"  {remark}")
        return "\n".join(lines)

    def start_of(self, model: Model) -> Model:
        """Return a model with the left-out unknowns at their start values.

        Parameters
        ----------
        model : Model
            The model of a test. The fit sets the fitted unknowns.

        Returns
        -------
        Model
            `model` itself if every left-out unknown starts at its value in the model.
        """
        changes: dict[str, dict[str, float]] = {}
        for p in self.held:
            for d in p.acts_on:
                group = model.groups.get(d.group)
                # A configuration may lack a group or a quantity.
                if group is None or p.is_channel or not group.has(d.quantity):
                    continue
                start = 1.0
                if not p.is_factor:
                    start = getattr(group, d.quantity)
                if p.start == start:
                    continue
                change = changes.setdefault(d.group, {})
                if p.is_factor:
                    change[d.quantity] = change.get(d.quantity, 1.0) * p.start**d.power
                else:
                    change[d.quantity] = p.start
        if not changes:
            return model
        return model.scaled(changes)


def _join_names(names: list[str] | tuple[str, ...]) -> str:
    text = ", ".join(names[: MESSAGES.listed_items])
    if len(names) > MESSAGES.listed_items:
        text += f" and {len(names) - MESSAGES.listed_items} more"
    return text
