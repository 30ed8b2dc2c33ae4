"""The unknowns: which quantity of which group may change, from where, how far."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.errors import ParameterError, suggest
from updyn.model import GROUP_QUANTITIES, Group, Model

__all__ = ["DEFAULT_BOUNDS", "Parameter", "ParameterSet", "parameters"]

#: Bounds where the user gives none. Factors may change a hundredfold; a loss factor of 10 is beyond any material.
DEFAULT_BOUNDS = {
    "stiffness": (0.01, 100.0),
    "mass": (0.01, 100.0),
    "viscous": (0.001, 1000.0),
    "loss_factor": (0.0, 10.0),
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown.

    Parameters
    ----------
    group, quantity : str
        What changes. ``stiffness``, ``mass`` and ``viscous`` are factors on the group's start, ``loss_factor`` is a
        value.
    start, lower, upper : float
        Start and bounds, in the unit of the unknown (a pure number).
    prior_std : float, optional
        Standard deviation of a Gaussian prior about `start`; of the logarithm for a factor, so that 0.3 means about
        30 %.

    Raises
    ------
    ParameterError
        If bounds are out of order or the start lies outside.
    """

    group: str
    quantity: str
    start: float
    lower: float
    upper: float
    prior_std: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite([self.start, self.lower, self.upper]).all() and self.lower < self.upper):
            raise ParameterError(
                f"unknown {self.name!r}: bounds ({self.lower:g}, {self.upper:g}); "
                "expected two finite numbers, lower first"
            )
        if not self.lower <= self.start <= self.upper:
            raise ParameterError(
                f"unknown {self.name!r} starts at {self.start:g}, outside its bounds ({self.lower:g}, {self.upper:g})"
            )
        if self.is_factor and self.lower <= 0:
            raise ParameterError(f"unknown {self.name!r} is a factor: its lower bound {self.lower:g} must be above 0")
        if self.quantity == "loss_factor" and self.lower < 0:
            raise ParameterError(
                f"unknown {self.name!r}: a loss factor below 0 feeds energy in; lower bound {self.lower:g}"
            )
        if self.prior_std is not None and not (np.isfinite(self.prior_std) and self.prior_std > 0):
            raise ParameterError(f"unknown {self.name!r}: prior_std {self.prior_std!r}; expected a number above 0")

    @property
    def name(self) -> str:
        """``group.quantity``."""
        return f"{self.group}.{self.quantity}"

    @property
    def is_factor(self) -> bool:
        """Whether the unknown is a positive factor, treated in its logarithm inside the optimiser."""
        return self.quantity != "loss_factor"


@dataclass(frozen=True, slots=True)
class ParameterSet(Sequence[Parameter]):
    """An ordered, immutable set of unknowns."""

    items: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        names = [p.name for p in self.items]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ParameterError(f"unknown {twice[0]!r} stands twice")
        if not names:
            raise ParameterError("there is nothing to update: no unknown is chosen")

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, item: int) -> Parameter: ...
    @overload
    def __getitem__(self, item: slice) -> ParameterSet: ...
    def __getitem__(self, item: int | slice) -> Parameter | ParameterSet:
        return ParameterSet(self.items[item]) if isinstance(item, slice) else self.items[item]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __add__(self, other: ParameterSet) -> ParameterSet:
        return ParameterSet(self.items + other.items)

    @property
    def names(self) -> list[str]:
        """Names, in order."""
        return [p.name for p in self.items]

    @property
    def start(self) -> NDArray[np.float64]:
        """Start values, shape (n,)."""
        return np.array([p.start for p in self.items])

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower bounds, shape (n,)."""
        return np.array([p.lower for p in self.items])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bounds, shape (n,)."""
        return np.array([p.upper for p in self.items])

    @property
    def is_factor(self) -> NDArray[np.bool_]:
        """Which unknowns are positive factors, shape (n,)."""
        return np.array([p.is_factor for p in self.items])

    def with_start(self, values: ArrayLike | Mapping[str, float]) -> ParameterSet:
        """Return a copy that starts elsewhere; a mapping may name only some unknowns.

        Raises
        ------
        ParameterError
            If a name is not here, the length is wrong, or a value lies outside its bounds.
        """
        if isinstance(values, Mapping):
            for name in values:
                if name not in self.names:
                    raise ParameterError(f"no unknown {name!r}; {suggest(name, self.names)}")
            new = [float(values.get(p.name, p.start)) for p in self.items]
        else:
            new = [float(v) for v in np.atleast_1d(np.asarray(values, dtype=np.float64))]
            if len(new) != len(self):
                raise ParameterError(f"start values: expected {len(self)}, found {len(new)}")
        return ParameterSet(tuple(replace(p, start=v) for p, v in zip(self.items, new, strict=True)))

    def apply(self, model: Model, values: ArrayLike) -> Model:
        """Return `model` with the unknowns at `values`, shape (n,)."""
        changes: dict[str, dict[str, float]] = {}
        for parameter, value in zip(self.items, np.asarray(values, dtype=np.float64), strict=True):
            changes.setdefault(parameter.group, {})[parameter.quantity] = float(value)
        return model.scaled(changes)


def parameters(
    model: Model,
    *,
    stiffness: str | Iterable[str] = (),
    mass: str | Iterable[str] = (),
    loss_factor: str | Iterable[str] = (),
    viscous: str | Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior_std: Mapping[str, float] | None = None,
) -> ParameterSet:
    """Choose the unknowns: one for each group and quantity.

    Parameters
    ----------
    model : Model
        The model to update.
    stiffness, mass, loss_factor, viscous : str or iterable of str
        Group names or globs (``"gear*"``), or ``"all"`` for every group that has the quantity. Stiffness, mass and
        viscous unknowns are factors on the group's start (1 = unchanged); loss factors are values relative to the
        updated stiffness, from the group's own.
    bounds : mapping of str to (float, float), optional
        By quantity (``"stiffness"``), by unknown (``"shaft.stiffness"``) or by glob over unknowns; the most special
        wins (unknown, then glob, then quantity).
    prior_std : mapping of str to float, optional
        Standard deviation of a prior about the start, by the same keys.

    Returns
    -------
    ParameterSet
        Ordered by group, then mass, stiffness, loss factor, viscous as far as chosen.

    Raises
    ------
    ParameterError
        If a glob fits no group, a group lacks the quantity, or a key of `bounds` or `prior_std` fits no unknown.
    """
    wanted = {"mass": mass, "stiffness": stiffness, "loss_factor": loss_factor, "viscous": viscous}
    chosen = {quantity: _groups(model, quantity, patterns) for quantity, patterns in wanted.items()}
    items = []
    for name, group in model.groups.items():
        for quantity in wanted:
            if name in chosen[quantity]:
                low, high = DEFAULT_BOUNDS[quantity]
                start = group.loss_factor if quantity == "loss_factor" else 1.0
                items.append(Parameter(name, quantity, start, low, max(high, 2 * start)))
    names = [p.name for p in items]
    for key in (*(bounds or {}), *(prior_std or {})):
        if key not in GROUP_QUANTITIES and not fnmatch.filter(names, key):
            raise ParameterError(f"{key!r} is neither a quantity nor an unknown; {suggest(key, names)}")
    out = []
    for p in items:
        pair = _most_special(bounds or {}, p)
        if pair is not None:
            if len(tuple(pair)) != 2:
                raise ParameterError(f"bounds of {p.name!r}: expected (lower, upper), found {pair!r}")
            start = p.start
            if p.quantity == "loss_factor":  # a start on the wrong side of the user's own bounds moves onto them
                start = float(np.clip(start, *pair)) if pair[0] < pair[1] else start
            p = Parameter(p.group, p.quantity, start, float(pair[0]), float(pair[1]))
        out.append(replace(p, prior_std=_most_special(prior_std or {}, p)))
    return ParameterSet(tuple(out))


def _groups(model: Model, quantity: str, patterns: str | Iterable[str]) -> set[str]:
    able = [name for name, group in model.groups.items() if _has(group, quantity)]
    if isinstance(patterns, str) and patterns == "all":
        if not able:
            raise ParameterError(f"no group of the model has {quantity}")
        return set(able)
    found: set[str] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        fits = fnmatch.filter(model.groups, pattern)
        if not fits:
            raise ParameterError(f"{quantity}: no group {pattern!r}; {suggest(pattern, model.groups)}")
        lacking = [f for f in fits if f not in able]
        if lacking and (pattern in model.groups or len(lacking) == len(fits)):
            raise ParameterError(
                f"{quantity}: group {lacking[0]!r} has no {_needs(quantity)}; {suggest(pattern, able)}"
            )
        found.update(f for f in fits if f in able)
    return found


def _needs(quantity: str) -> str:
    return "stiffness" if quantity == "loss_factor" else quantity


def _has(group: Group, quantity: str) -> bool:
    return getattr(group, _needs(quantity)) is not None


def _most_special(table: Mapping[str, Any], parameter: Parameter) -> Any:
    if parameter.name in table:
        return table[parameter.name]
    for key, value in table.items():
        if key not in GROUP_QUANTITIES and fnmatch.fnmatchcase(parameter.name, key):
            return value
    return table.get(parameter.quantity)
