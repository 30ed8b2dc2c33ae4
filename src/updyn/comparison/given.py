"""What a comparison is given, checked before anything is run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from updyn.errors import OptionError, ParameterError, suggest
from updyn.updating.fit.methods import METHODS, make_method
from updyn.updating.problem.parameters import ParameterSet, finite

__all__ = ["CHOSEN", "Given"]

#: How the fewest lines are chosen.
CHOSEN = ("d-optimal", "even")


@dataclass(frozen=True, slots=True)
class Given:
    """What the caller asks for, valid in itself.

    Attributes
    ----------
    methods : tuple of str
        Names, each once.
    options : mapping of str to mapping
        Options by method.
    truth : mapping of str to float
        By unknown; empty where it is not known.
    fewest : bool
        Whether the fewest lines are sought.
    tolerance : float
        What counts as recovered.
    chosen : str
        How the fewest lines are chosen.
    title : str
        For the record.
    """

    methods: tuple[str, ...]
    options: Mapping[str, Mapping[str, Any]]
    truth: Mapping[str, float]
    fewest: bool
    tolerance: float
    chosen: str
    title: str

    @classmethod
    def checked(
        cls,
        parameters: ParameterSet,
        methods: Iterable[str] | None,
        options: Mapping[str, Mapping[str, Any]] | None,
        truth: Mapping[str, float] | None,
        *,
        fewest: bool = False,
        tolerance: float = 0.01,
        chosen: str = "d-optimal",
        title: str = "",
    ) -> Given:
        """Check the arguments of `updyn.compare`.

        Raises
        ------
        InputError
            If one is not known or not valid.
        """
        options = options or {}
        names = _methods(methods, options)
        if chosen not in CHOSEN:
            raise OptionError(f"chosen {chosen!r}: {suggest(str(chosen), CHOSEN)}")
        return cls(
            names, options, _truth(truth, parameters), fewest, _tolerance(tolerance), chosen, title
        )


def _methods(
    given: Iterable[str] | None, options: Mapping[str, Mapping[str, Any]]
) -> tuple[str, ...]:
    if isinstance(given, str):
        raise OptionError(f"methods {given!r}: expected a list of names, such as [{given!r}]")
    names = tuple(METHODS if given is None else given)
    if not names:
        raise OptionError(f"methods: expected at least one; {suggest('', METHODS)}")
    for name in [*names, *options]:
        make_method(
            name, options.get(name, {})
        )  # what is wrong with its name or options is wrong with the input
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise OptionError(f"methods: {twice[0]!r} stands twice")
    return names


def _truth(given: Mapping[str, float] | None, parameters: ParameterSet) -> dict[str, float]:
    if given is None:
        return {}
    known = {p.name: p for p in parameters}
    out = {}
    for name, value in given.items():
        if name not in known:
            raise ParameterError(f"truth: no unknown {name!r}; {suggest(str(name), known)}")
        out[name] = finite(value, f"truth of {name!r}")
        if out[name] <= 0.0 if known[name].is_factor else out[name] < 0.0:
            expected = "a factor above 0" if known[name].is_factor else "a value of at least 0"
            raise ParameterError(f"truth of {name!r}: {out[name]:g}; expected {expected}")
    if not out:
        raise ParameterError("truth: holds no value; leave it out where the truth is not known")
    return out


def _tolerance(given: float) -> float:
    tolerance = finite(given, "tolerance")
    if tolerance <= 0.0:
        raise OptionError(f"tolerance {tolerance:g}: expected a number above 0")
    return tolerance
