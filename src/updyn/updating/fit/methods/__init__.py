"""The methods: one module each, found through a lazy registry.

Adding a method is one module with a frozen dataclass (its fields are its options) that has
``fit(problem, noise, monitor) -> Fit``, and one line in `METHODS`.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from updyn.errors import OptionError, suggest
from updyn.updating.fit.method import Method

__all__ = ["METHODS", "make_method", "method_class", "options_of"]

_HERE = "updyn.updating.fit.methods."

METHODS = {
    "maximum-likelihood": (_HERE + "maximum_likelihood", "MaximumLikelihood"),
    "log": (_HERE + "least_squares", "LogMethod"),
    "output-error": (_HERE + "least_squares", "OutputMethod"),
    "equation-error": (_HERE + "equation_error", "EquationErrorMethod"),
    "force-residual": (_HERE + "force_residual", "ForceResidualMethod"),
    "constitutive": (_HERE + "constitutive", "ConstitutiveMethod"),
    "modal": (_HERE + "modal", "ModalMethod"),
    "rfm": (_HERE + "rfm", "ResponseFunctionMethod"),
    "complex-rfm": (_HERE + "rfm", "ComplexResponseFunctionMethod"),
    "frf-sensitivity": (_HERE + "frf_sensitivity", "FrfSensitivityMethod"),
    "reduced-frf": (_HERE + "reduced_frf", "ReducedFrfMethod"),
}


def method_class(name: str) -> type:
    """Return the class of a method; its ``cannot``, where it has one, holds the quantities that it cannot update.

    Raises
    ------
    OptionError
        If there is no such method; the nearest is named.
    """
    if name not in METHODS:
        raise OptionError(f"method {name!r}: {suggest(str(name), METHODS)}")
    module, attribute = METHODS[name]
    return cast(type, getattr(importlib.import_module(module), attribute))


def options_of(name: str) -> dict[str, Any]:
    """Return the options of a method with their defaults.

    Raises
    ------
    OptionError
        If there is no such method; the nearest is named.
    """
    return {f.name: f.default for f in dataclasses.fields(method_class(name))}


def make_method(name: str, options: Mapping[str, Any]) -> Method:
    """Make a method from its name and options.

    Raises
    ------
    OptionError
        If the method or an option is not known (the nearest is named), or a value has the wrong
        type or sign.
    """
    made, defaults = method_class(name), options_of(name)
    plain = {
        key: value.item() if isinstance(value, np.generic) else value
        for key, value in options.items()
    }
    for key, value in plain.items():
        if key not in defaults:
            raise OptionError(
                f"method {name!r} has no option {key!r}; {suggest(key, defaults)}", key=(key,)
            )
        _check(key, value, defaults[key])
    return cast(Method, made(**plain))


def _check(key: str, value: Any, default: Any) -> None:
    if default is None:  # an object, which the method itself looks at
        return
    kind: Any = (int, float) if isinstance(default, float) else type(default)
    if isinstance(value, bool) != isinstance(default, bool) or not isinstance(value, kind):
        raise OptionError(
            f"option {key} = {value!r}: expected {type(default).__name__}, such as {default!r}",
            key=(key,),
        )
    if not isinstance(value, str) and not 0 <= value < float("inf"):
        raise OptionError(f"option {key} = {value!r}: expected a number of at least 0", key=(key,))
