"""Parameters of nonlinear elements by name: numbers that an update can change."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from updyn.errors import ModelError, suggest
from updyn.nonlinear.element import NonlinearElement

__all__ = ["change_parameters", "choose_unit", "list_parameters", "parameter_unit"]


def list_parameters(element: NonlinearElement) -> dict[str, float]:
    """Return the parameters by name, in the order of `PeriodForce.parameters`.

    Those of a mapping, as the coefficients of a polynomial, are named ``coefficients_3``.
    """
    out: dict[str, float] = {}
    for name in element.parameters:
        value = getattr(element, name)
        if isinstance(value, Mapping):
            out |= {f"{name}_{key}": float(number) for key, number in value.items()}
        else:
            out[name] = float(value)
    return out


def parameter_unit(element: NonlinearElement, name: str, *, rotates: bool | None = False) -> str:
    """Return the unit of a parameter; `rotates` as for `choose_unit`, empty if it is not stated."""
    units: Mapping[str, str] = getattr(element, "units", {})
    plain, _, key = name.rpartition("_")
    unit = units.get(name, units.get(plain, "").replace("^p", f"^{key}"))
    return choose_unit(unit, rotates)


def choose_unit(unit: str, rotates: bool | None) -> str:
    """Return the unit on a displacement, on a rotation, or both if it is not known which."""
    if rotates is False:
        return unit
    turned = re.sub(r"[Nm]", lambda found: _ABOUT_AN_AXIS[found[0]], unit)
    return turned if rotates or turned == unit else f"{unit} or {turned}"


#: Units of an element on a rotation, in place of those on a displacement.
_ABOUT_AN_AXIS = {"N": "N m", "m": "rad"}


def change_parameters(element: NonlinearElement, values: Mapping[str, float]) -> NonlinearElement:
    """Return a copy with other values of some parameters; ModelError for an unknown name."""
    known = list_parameters(element)
    for name in values:
        if name not in known:
            raise ModelError(
                f"{type(element).__name__} has no parameter {name!r}; {suggest(name, known)}"
            )
    changes: dict[str, object] = {}
    for name in element.parameters:
        value = getattr(element, name)
        if isinstance(value, Mapping):
            own = {key: values.get(f"{name}_{key}", number) for key, number in value.items()}
            if any(f"{name}_{key}" in values for key in value):
                changes[name] = {key: float(number) for key, number in own.items()}
        elif name in values:
            changes[name] = float(values[name])
    if not changes:
        return element
    changed: NonlinearElement = replace(element, **changes)  # type: ignore[type-var]
    return changed
