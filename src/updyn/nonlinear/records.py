"""Nonlinear elements as plain data: a kind and the values of its fields, as in files and jobs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from updyn.errors import ModelError, suggest
from updyn.nonlinear import ELEMENTS
from updyn.nonlinear.element import NonlinearElement

__all__ = ["build_element", "describe_element"]


def describe_element(element: NonlinearElement) -> dict[str, object]:
    """Return the kind of an element and the fields that differ from their defaults.

    Raises ModelError if its class is not registered.
    """
    kind = next((name for name in ELEMENTS if ELEMENTS[name] is type(element)), None)
    if kind is None:
        raise ModelError(
            f"nonlinear element {type(element).__name__} is not registered, so that no file can"
            " name it"
        )
    out: dict[str, object] = {"kind": kind}
    for one in fields(element):  # type: ignore[arg-type]
        value = getattr(element, one.name)
        if isinstance(value, Mapping):
            out[one.name] = {str(key): float(number) for key, number in value.items()}
        elif value != one.default:
            out[one.name] = float(value)
    return out


def build_element(kind: str, values: Mapping[str, object]) -> NonlinearElement:
    """Return an element from its kind and fields; ModelError for an unknown or missing field."""
    found: type[NonlinearElement] = ELEMENTS.find(kind)
    known = {one.name: one for one in fields(found)}  # type: ignore[arg-type]
    for name in values:
        if name not in known:
            raise ModelError(f"{kind} has no value {name!r}; {suggest(name, known)}")
    given: dict[str, object] = {}
    for name, value in values.items():
        given[name] = value
        if isinstance(value, Mapping):
            given[name] = {_to_power(key): number for key, number in value.items()}
    try:
        element: NonlinearElement = found(**given)
    except TypeError as error:
        missing = [name for name in known if name not in given]
        raise ModelError(f"{kind} needs {' and '.join(missing)} ({error})") from error
    return element


def _to_power(key: object) -> object:
    """Return the power of a polynomial, which files write as text."""
    return int(key) if isinstance(key, str) and key.isdigit() else key
