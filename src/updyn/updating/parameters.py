"""The unknowns: which quantity of which group may change, from where, how far."""

from __future__ import annotations

import fnmatch
from collections import Counter
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
        If the quantity is not known, a number is not finite, bounds are out of order or do not fit the quantity, or
        the start lies outside.
    """

    group: str
    quantity: str
    start: float
    lower: float
    upper: float
    prior_std: float | None = None

    def __post_init__(self) -> None:
        if self.quantity not in GROUP_QUANTITIES:
            raise ParameterError(f"no quantity {self.quantity!r}; {suggest(str(self.quantity), GROUP_QUANTITIES)}")
        for what in ("start", "lower", "upper"):
            object.__setattr__(self, what, _finite(getattr(self, what), f"unknown {self.name!r}: {what}"))
        if not self.lower < self.upper:
            raise ParameterError(
                f"unknown {self.name!r}: bounds ({self.lower:g}, {self.upper:g}); expected the lower one first"
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
        if self.prior_std is not None:
            object.__setattr__(self, "prior_std", _finite(self.prior_std, f"unknown {self.name!r}: prior_std"))
            if self.prior_std <= 0:
                raise ParameterError(f"unknown {self.name!r}: prior_std {self.prior_std:g}; expected a number above 0")

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
    """An ordered, immutable set of unknowns.

    Parameters
    ----------
    items : tuple of Parameter
        The unknowns, each group and quantity once.

    Raises
    ------
    ParameterError
        If there is none, or one stands twice.
    """

    items: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "items", tuple(self.items))
        names = Counter(p.name for p in self.items)
        twice = [name for name, count in names.items() if count > 1]
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
        """Return a copy that starts elsewhere.

        Parameters
        ----------
        values : array_like of float, shape (n,), or mapping of str to float
            New starts; a mapping may name only some unknowns.

        Returns
        -------
        ParameterSet
            The same unknowns with the same bounds.

        Raises
        ------
        ParameterError
            If a name is not here, the length is wrong, or a value lies outside its bounds.
        """
        if isinstance(values, Mapping):
            names = self.names
            for name in values.keys() - set(names):
                raise ParameterError(f"no unknown {name!r}; {suggest(str(name), names)}")
            new = [values.get(p.name, p.start) for p in self.items]
        else:
            new = self._vector(values, "start values").tolist()
        return ParameterSet(tuple(replace(p, start=v) for p, v in zip(self.items, new, strict=True)))

    def apply(self, model: Model, values: ArrayLike) -> Model:
        """Return `model` with the unknowns at `values`.

        Parameters
        ----------
        model : Model
            The model as it starts: factors count from it.
        values : array_like of float, shape (n,)
            The unknowns, in order. Bounds are not looked at.

        Returns
        -------
        Model
            The changed copy.

        Raises
        ------
        ParameterError
            If the length is wrong.
        ModelError
            If the model lacks a group or a quantity, or a value is not finite.
        """
        return model.scaled(self.changes(values))

    def changes(self, values: ArrayLike) -> dict[str, dict[str, float]]:
        """Return what the unknowns at `values` do to each group, as `Model.scaled` takes it.

        Parameters
        ----------
        values : array_like of float, shape (n,)
            The unknowns, in order.

        Returns
        -------
        dict of str to dict of str to float
            By group and quantity: factors, and values of loss factors.

        Raises
        ------
        ParameterError
            If the length is wrong.
        """
        changes: dict[str, dict[str, float]] = {}
        for parameter, value in zip(self.items, self._vector(values, "values"), strict=True):
            changes.setdefault(parameter.group, {})[parameter.quantity] = float(value)
        return changes

    def _vector(self, values: ArrayLike, what: str) -> NDArray[np.float64]:
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ParameterError(f"{what}: expected {len(self)} numbers ({error})") from error
        if array.shape != (len(self),):
            raise ParameterError(f"{what}: expected {len(self)}, found shape {array.shape}")
        return array


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
        Group names or globs (``"gear*"``), or ``"all"``. A glob stands for those of its groups that have the quantity,
        ``"all"`` for every group that has it. Stiffness, mass and viscous unknowns are factors on the group's start
        (1 = unchanged); loss factors are values relative to the updated stiffness, from the group's own.
    bounds : mapping of str to (float, float), optional
        By quantity (``"stiffness"``), by unknown (``"shaft.stiffness"``) or by glob over unknowns; the most special
        wins (unknown, then the first glob that fits, then quantity). A loss factor whose own value lies outside
        starts on the nearer bound.
    prior_std : mapping of str to float, optional
        Standard deviation of a prior about the start, by the same keys.

    Returns
    -------
    ParameterSet
        Ordered by group, then mass, stiffness, loss factor, viscous as far as chosen.

    Raises
    ------
    ParameterError
        If a glob fits no group, a group lacks the quantity, a key of `bounds` or `prior_std` fits no unknown, or
        nothing is chosen.
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
    bounds = _table("bounds", bounds, items)
    prior_std = _table("prior_std", prior_std, items)
    out = []
    for p in items:
        if (pair := _most_special(bounds, p)) is not None:
            low, high = _pair(pair, f"bounds of {p.name!r}")
            start = p.start
            if p.quantity == "loss_factor" and low < high:  # the group's own value yields to the user's bounds
                start = min(max(start, low), high)
            p = Parameter(p.group, p.quantity, start, low, high)
        out.append(replace(p, prior_std=_most_special(prior_std, p)))
    return ParameterSet(tuple(out))


def _groups(model: Model, quantity: str, patterns: str | Iterable[str]) -> set[str]:
    able = [name for name, group in model.groups.items() if _has(group, quantity)]
    if isinstance(patterns, str) and patterns == "all":
        if not able:
            raise ParameterError(f"no group of the model has {quantity}")
        return set(able)
    if not isinstance(patterns, Iterable):
        raise ParameterError(f"{quantity}: expected group names, globs or 'all', found {patterns!r}")
    found: set[str] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        if not isinstance(pattern, str):
            raise ParameterError(f"{quantity}: expected a group name or a glob, found {pattern!r}")
        fits = [name for name in model.groups if fnmatch.fnmatchcase(name, pattern)]
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


def _table(what: str, given: Mapping[str, Any] | None, items: Sequence[Parameter]) -> Mapping[str, Any]:
    """Return `given` after checking that each of its keys fits an unknown."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ParameterError(f"{what}: expected a mapping by quantity, unknown or glob, found {given!r}")
    known = dict.fromkeys([*(p.quantity for p in items), *(p.name for p in items)])
    for key in given:
        if key in known or (isinstance(key, str) and any(fnmatch.fnmatchcase(p.name, key) for p in items)):
            continue
        raise ParameterError(
            f"{what}: {key!r} is neither a quantity nor an unknown that is chosen; {suggest(str(key), known)}"
        )
    return given


def _pair(given: Any, what: str) -> tuple[float, float]:
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or len(given) != 2:
        raise ParameterError(f"{what}: expected (lower, upper), found {given!r}")
    return _finite(given[0], what), _finite(given[1], what)


def _finite(given: Any, what: str) -> float:
    number = isinstance(given, int | float | np.floating | np.integer) and not isinstance(given, bool)
    if not (number and np.isfinite(given)):
        raise ParameterError(f"{what}: expected a finite number, found {given!r}")
    return float(given)
