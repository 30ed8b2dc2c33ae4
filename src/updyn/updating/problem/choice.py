"""Choosing the unknowns of a model: one for each group and quantity, or one that acts on several."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from updyn.errors import ParameterError, suggest
from updyn.group import GROUP_QUANTITIES, VALUES
from updyn.model import Model
from updyn.updating.problem.parameters import Drive, Parameter, ParameterSet, finite

__all__ = ["DEFAULT_BOUNDS", "link", "parameters"]

#: Bounds where the user gives none. Factors may change a hundredfold; a loss factor of 10 is beyond
#: any material, and so are Rayleigh coefficients that amount to it at 10 kHz (mass) or at 0.1 Hz
#: (stiffness).
DEFAULT_BOUNDS = {
    "stiffness": (0.01, 100.0),
    "mass": (0.01, 100.0),
    "viscous": (0.001, 1000.0),
    "loss_factor": (0.0, 10.0),
    "mass_damping": (0.0, 6e5),
    "stiffness_damping": (0.0, 16.0),
}
_LINKED = (
    0.1,
    10.0,
)  # a factor that drives others by powers: ten times a thickness is a thousand times its bending


def parameters(
    model: Model,
    *,
    stiffness: str | Iterable[str] = (),
    mass: str | Iterable[str] = (),
    loss_factor: str | Iterable[str] = (),
    viscous: str | Iterable[str] = (),
    mass_damping: str | Iterable[str] = (),
    stiffness_damping: str | Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior_std: Mapping[str, float] | None = None,
) -> ParameterSet:
    """Choose the unknowns: one for each group and quantity.

    Parameters
    ----------
    model : Model
        The model to update.
    stiffness, mass, loss_factor, viscous, mass_damping, stiffness_damping : str or iterable of str
        Group names or globs (``"gear*"``), or ``"all"``. A glob stands for those of its groups that
        have the quantity, ``"all"`` for every group that has it. Stiffness, mass and viscous
        unknowns are factors on the group's start (1 = unchanged). The others are values, and start
        from the group's own: loss factors and stiffness damping (s) relative to the updated
        stiffness, mass damping (1/s) to the updated mass.
    bounds : mapping of str to (float, float), optional
        By quantity (``"stiffness"``), by unknown (``"shaft.stiffness"``) or by glob over unknowns;
        the most special wins (unknown, then the first glob that fits, then quantity). Damping whose
        own value lies outside starts on the nearer bound.
    prior_std : mapping of str to float, optional
        Standard deviation of a prior about the start, by the same keys.

    Returns
    -------
    ParameterSet
        Ordered by group, then mass, stiffness, loss factor, viscous, mass damping, stiffness
        damping as far as chosen.

    Raises
    ------
    ParameterError
        If a glob fits no group, a group lacks the quantity, a key of `bounds` or `prior_std` fits
        no unknown, or nothing is chosen.
    """
    wanted = {"mass": mass, "stiffness": stiffness, "loss_factor": loss_factor, "viscous": viscous}
    wanted |= {"mass_damping": mass_damping, "stiffness_damping": stiffness_damping}
    chosen = {quantity: _groups(model, quantity, patterns) for quantity, patterns in wanted.items()}
    items = []
    for name, group in model.groups.items():
        for quantity in wanted:
            if name in chosen[quantity]:
                low, high = DEFAULT_BOUNDS[quantity]
                start = group.value(quantity)
                items.append(Parameter(name, quantity, start, low, max(high, 2 * start)))
    bounds = _table("bounds", bounds, items)
    prior_std = _table("prior_std", prior_std, items)
    out = []
    for p in items:
        if (pair := _most_special(bounds, p)) is not None:
            low, high = _pair(pair, f"bounds of {p.name!r}")
            start = p.start
            if (
                p.quantity in VALUES and low < high
            ):  # the group's own value yields to the user's bounds
                start = min(max(start, low), high)
            p = Parameter(p.group, p.quantity, start, low, high)
        out.append(replace(p, prior_std=_most_special(prior_std, p)))
    return ParameterSet(tuple(out))


def link(
    model: Model,
    name: str,
    drives: Mapping[str, float] | Iterable[str],
    *,
    start: float | None = None,
    bounds: tuple[float, float] | None = None,
    prior_std: float | None = None,
    nominal: float | None = None,
    unit: str = "",
) -> ParameterSet:
    """Choose one unknown that acts on several groups by stated laws.

    A thickness drives membrane stiffness and mass in proportion, bending stiffness with its cube; a
    modulus drives every property of its material; a symmetric pair shares one stiffness. As the
    model stays affine in the coefficients of its groups, the derivatives stay exact.

    Parameters
    ----------
    model : Model
        The model to update.
    name : str
        What the unknown is called, with one dot, such as ``"dish.thickness"``.
    drives : mapping of str to float, or iterable of str
        ``group.quantity``, or a glob over these, and the power with which the unknown enters:
        ``{"skin.stiffness": 1, "bend.stiffness": 3, "skin.mass": 1}``. Without powers, 1 each. A
        quantity that several unknowns drive is multiplied by all.
    start : float, optional
        1 where nothing is said; for loss factors and Rayleigh coefficients, that of the groups,
        which has to be the same.
    bounds : (float, float), optional
        On the unknown itself; 0.1 to 10 for factors, 0 to 10 for loss factors, as in
        `updyn.parameters` for others.
    prior_std : float, optional
        Standard deviation of a prior about the start; of the logarithm for a factor.
    nominal : float, optional
        What a factor of 1 stands for (2e-3 for a thickness of 2 mm in m); reports show the product.
    unit : str
        Unit of `nominal`.

    Returns
    -------
    ParameterSet
        One unknown; sets are added with ``+``.

    Raises
    ------
    ParameterError
        If a name fits nothing in the model, the drives do not fit together, or a number is not
        usable.
    """
    stem, dot, quantity = name.rpartition(".") if isinstance(name, str) else ("", "", "")
    if not dot or not stem.strip() or not quantity.strip() or set(name) & set("*?[]\n\t"):
        raise ParameterError(
            f"unknown {name!r}: expected a name of two parts, such as 'dish.thickness'"
        )
    named = [drives] if isinstance(drives, str) else drives
    powers = named if isinstance(named, Mapping) else dict.fromkeys(named, 1.0)
    acts = tuple(
        drive for key, power in powers.items() for drive in _drives(model, name, key, power)
    )
    if not acts:
        raise ParameterError(f"unknown {name!r} acts on nothing: drives is empty")
    if kinds := sorted({d.quantity for d in acts} & set(VALUES)):
        values = sorted(
            {model.group(d.group).value(d.quantity) for d in acts if d.quantity == kinds[0]}
        )
        if start is None and len(values) > 1:
            raise ParameterError(
                f"unknown {name!r}: its {kinds[0].replace('_', ' ')}s start at {values}; give start"
            )
        first, limits = values[0], DEFAULT_BOUNDS[kinds[0]]
    else:
        first, limits = 1.0, _LINKED
    low, high = limits if bounds is None else _pair(bounds, f"bounds of {name!r}")
    begin = first if start is None else finite(start, f"unknown {name!r}: start")
    return ParameterSet(
        (Parameter(stem, quantity, begin, low, high, prior_std, acts, nominal, unit),)
    )


def _drives(model: Model, name: str, key: str, power: float) -> list[Drive]:
    """Return the drives that a key of `link` stands for."""
    able = [
        f"{g}.{q}" for g, group in model.groups.items() for q in GROUP_QUANTITIES if group.has(q)
    ]
    found = [a for a in able if isinstance(key, str) and fnmatch.fnmatchcase(a, key)]
    if not found:
        raise ParameterError(
            f"unknown {name!r}: {key!r} is nothing that the model has; {suggest(str(key), able)}"
        )
    return [Drive(a.rpartition(".")[0], a.rpartition(".")[2], power) for a in found]


def _groups(model: Model, quantity: str, patterns: str | Iterable[str]) -> set[str]:
    able = [name for name, group in model.groups.items() if group.has(quantity)]
    if isinstance(patterns, str) and patterns == "all":
        if not able:
            raise ParameterError(f"no group of the model has {quantity}")
        return set(able)
    if not isinstance(patterns, Iterable):
        raise ParameterError(
            f"{quantity}: expected group names, globs or 'all', found {patterns!r}"
        )
    found: set[str] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        if not isinstance(pattern, str):
            raise ParameterError(f"{quantity}: expected a group name or a glob, found {pattern!r}")
        fits = [name for name in model.groups if fnmatch.fnmatchcase(name, pattern)]
        if not fits:
            raise ParameterError(
                f"{quantity}: no group {pattern!r}; {suggest(pattern, model.groups)}"
            )
        lacking = [f for f in fits if f not in able]
        if lacking and (pattern in model.groups or len(lacking) == len(fits)):
            raise ParameterError(
                f"{quantity}: group {lacking[0]!r} has no {GROUP_QUANTITIES[quantity]};"
                f" {suggest(pattern, able)}"
            )
        found.update(f for f in fits if f in able)
    return found


def _most_special(table: Mapping[str, Any], parameter: Parameter) -> Any:
    if parameter.name in table:
        return table[parameter.name]
    for key, value in table.items():
        if key not in GROUP_QUANTITIES and fnmatch.fnmatchcase(parameter.name, key):
            return value
    return table.get(parameter.quantity)


def _table(
    what: str, given: Mapping[str, Any] | None, items: Sequence[Parameter]
) -> Mapping[str, Any]:
    """Return `given` after checking that each of its keys fits an unknown."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ParameterError(
            f"{what}: expected a mapping by quantity, unknown or glob, found {given!r}"
        )
    known = dict.fromkeys([*(p.quantity for p in items), *(p.name for p in items)])
    for key in given:
        if key in known or (
            isinstance(key, str) and any(fnmatch.fnmatchcase(p.name, key) for p in items)
        ):
            continue
        raise ParameterError(
            f"{what}: {key!r} is neither a quantity nor an unknown that is chosen;"
            f" {suggest(str(key), known)}"
        )
    return given


def _pair(given: Any, what: str) -> tuple[float, float]:
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or len(given) != 2:
        raise ParameterError(f"{what}: expected (lower, upper), found {given!r}")
    return finite(given[0], what), finite(given[1], what)
