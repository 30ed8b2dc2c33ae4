"""Registry of the methods: one module each, imported when first used.

A method is a frozen dataclass derived from `updyn.updating.fit.method.Method`: its fields are its
options, and its class attributes state its requirements and abilities. Another package adds one by
``METHODS.register("my-method", MyMethod)``, or by an entry point of the group ``updyn.methods``.

A residual is sufficient: ``RESIDUALS.register("my-residual", MyResidual)``, with a class derived
from `updyn.updating.problem.residuals.LineResidual`, or an entry point of the group
``updyn.residuals``, makes ``method="my-residual"`` minimise it by least squares, within bounds and
with priors (`updyn.updating.fit.methods.least_squares.LeastSquares`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from updyn.errors import OptionError, suggest
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.modal import ModeSet
from updyn.registry import Registry, load_object
from updyn.updating.fit.method import Method
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.residuals import RESIDUALS

__all__ = [
    "METHODS",
    "check_channels",
    "check_linear",
    "check_modes",
    "check_quantity",
    "make_method",
    "methods_with",
    "options_of",
]

_HERE = "updyn.updating.fit.methods."


class _Methods(Registry[type[Method]]):
    """Registry of the methods, and of the residuals without a method of the same name."""

    def __getitem__(self, name: str) -> type[Method]:
        if not super().__contains__(name) and name in RESIDUALS:
            general = load_object(_HERE + "least_squares:LeastSquares")
            self.register(name, general.of(name, RESIDUALS[name]))
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in RESIDUALS

    def __iter__(self) -> Iterator[str]:
        names = list(super().__iter__())
        yield from names
        yield from (name for name in RESIDUALS if name not in names)

    def __len__(self) -> int:
        return len(list(iter(self)))


METHODS = _Methods(
    "method",
    "updyn.methods",
    {
        "maximum-likelihood": _HERE + "maximum_likelihood:MaximumLikelihood",
        "log": _HERE + "least_squares:LogMethod",
        "output-error": _HERE + "least_squares:OutputMethod",
        "equation-error": _HERE + "equation_error:EquationErrorMethod",
        "force-residual": _HERE + "force_residual:ForceResidualMethod",
        "constitutive": _HERE + "constitutive:ConstitutiveMethod",
        "modal": _HERE + "modal:ModalMethod",
        "rfm": _HERE + "rfm:ResponseFunctionMethod",
        "complex-rfm": _HERE + "rfm:ComplexResponseFunctionMethod",
        "frf-sensitivity": _HERE + "frf_sensitivity:FrfSensitivityMethod",
        "reduced-frf": _HERE + "reduced_frf:ReducedFrfMethod",
    },
)


def methods_with(attribute: str) -> tuple[str, ...]:
    """Return the names of the methods for which an attribute of `Method` is true."""
    return tuple(name for name in METHODS if getattr(METHODS[name], attribute))


def options_of(name: str) -> dict[str, Any]:
    """Return the options of a method with their defaults; OptionError for an unknown name."""
    fields = dataclasses.fields(cast(Any, METHODS.find(name)))
    return {f.name: f.default for f in fields}


def make_method(name: str, options: Mapping[str, object]) -> Method:
    """Return a method from its name and options; OptionError if one is not valid."""
    made, defaults = METHODS.find(name), options_of(name)
    plain = {}
    for key, value in options.items():
        if key not in defaults:
            raise OptionError(
                f"method {name!r} has no option {key!r}; {suggest(key, defaults)}", key=(key,)
            )
        if isinstance(value, np.generic):
            value = value.item()
        plain[key] = value
        _check(key, value, defaults[key])
    return made(**plain)


def check_channels(parameters: ParameterSet, method: Method | type[Method]) -> None:
    """Raise OptionError if there are calibration factors that a method does not support."""
    sensors = [p.name for p in parameters if p.is_channel]
    if sensors and not method.calibrates:
        *others, last = [repr(name) for name in methods_with("calibrates")]
        raise OptionError(
            f"method {method.name!r} uses the measurement without calibration and supports no"
            f" calibration factors ({sensors[0]!r}); use {', '.join(others)} or {last}"
        )


def check_linear(tests: Sequence[Test], method: Method) -> None:
    """Raise OptionError if a model has nonlinear elements and the method cannot fit it."""
    # Methods that support calibration compare the data with the forward response; others use the
    # matrices of a linear model.
    nonlinear = [test for test in tests if test.model.nonlinear]
    if nonlinear and not method.calibrates:
        *others, last = map(repr, methods_with("calibrates"))
        names = ", ".join(nonlinear[0].model.nonlinear)
        raise OptionError(
            f"method {method.name!r} fits linear models only, and the model has nonlinear elements"
            f" ({names}); use {', '.join(others)} or {last}"
        )


def check_modes(tests: Sequence[Test], method: Method) -> None:
    """Raise OptionError if the data of a test are modes and the method fits FRFs only."""
    if method.fits_modes or not any(isinstance(test.data, ModeSet) for test in tests):
        return
    names = " or ".join(repr(name) for name in methods_with("fits_modes"))
    raise OptionError(f"method {method.name!r} fits FRFs, not modes; use {names}", key=("name",))


def check_quantity(data: FRF | ModeSet, method: Method | type[Method]) -> None:
    """Raise OptionError if the data are a transmissibility and the method needs forces."""
    is_ratio = isinstance(data, FRF) and data.quantity == TRANSMISSIBILITY
    if method.calibrates or not is_ratio:
        return
    *others, last = map(repr, methods_with("calibrates"))
    raise OptionError(
        f"method {method.name!r} needs measured forces, and a transmissibility has none; use"
        f" {', '.join(others)} or {last}",
        key=("name",),
    )


def _check(key: str, value: Any, default: Any) -> None:
    if default is None:  # an object, which the method itself checks
        return
    kind: Any = (int, float) if isinstance(default, float) else type(default)
    if isinstance(value, bool) != isinstance(default, bool) or not isinstance(value, kind):
        raise OptionError(
            f"option {key} = {value!r}: expected {type(default).__name__}, such as {default!r}",
            key=(key,),
        )
    if not isinstance(value, str) and not 0 <= value < float("inf"):
        raise OptionError(f"option {key} = {value!r}: expected a number of at least 0", key=(key,))
