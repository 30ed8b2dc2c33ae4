"""`Profiles`: what a profile likelihood has found, pure data with words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, suggest

__all__ = ["ENDS", "Hump", "Profile", "Profiles"]

_Vector = NDArray[np.float64]

#: Why an interval ends where it does.
ENDS = ("level", "bound", "zero", "unsolved", "stopped")


@dataclass(frozen=True, slots=True)
class Hump:
    """A range of values that the data allow.

    Attributes
    ----------
    lower, best, upper : float
        Its ends and its most likely value, in the unit of the unknown.
    drop : float
        How much less likely that value is than the best of all, in logarithm.
    """

    lower: float
    best: float
    upper: float
    drop: float


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The profile likelihood of one unknown.

    Attributes
    ----------
    name : str
        The unknown.
    estimate : float
        Its most likely value.
    values : ndarray of float, shape (k,)
        Values at which it was held, ascending.
    drop : ndarray of float, shape (k,)
        Fall of the logarithm of the likelihood there, all others fitted again.
    others : ndarray of float, shape (k, n)
        All unknowns there.
    humps : tuple of Hump
        Ranges that the data allow, ascending; more than one where they cannot be told apart.
    lower_end, upper_end : {"level", "bound", "zero", "unsolved"}
        Why the outermost ends are where they are: the data say so; the bound of the unknown was
        reached first, so that the data do not limit it; zero, below which no loss factor is; the
        model could not be solved further.
    """

    name: str
    estimate: float
    values: _Vector
    drop: _Vector
    others: NDArray[np.float64]
    humps: tuple[Hump, ...]
    lower_end: str
    upper_end: str

    @property
    def lower(self) -> float:
        """Lower end of the lowest range."""
        return self.humps[0].lower

    @property
    def upper(self) -> float:
        """Upper end of the highest range."""
        return self.humps[-1].upper

    @property
    def note(self) -> str:
        """What to know about the ends, in words; may be empty."""
        said = []
        sides = [
            side
            for side, end in (("lower", self.lower_end), ("upper", self.upper_end))
            if end == "bound"
        ]
        if sides:
            said.append(
                f"no {' and no '.join(sides)} end within its bounds: the data do not limit it"
            )
        if self.lower_end == "zero":
            said.append("zero is among the values that the data allow")
        if "unsolved" in (self.lower_end, self.upper_end):
            said.append("the model could not be solved further out")
        if len(self.humps) > 1:
            ranges = " and ".join(f"{h.lower:.4g} to {h.upper:.4g}" for h in self.humps)
            said.append(f"{len(self.humps)} separate ranges fit the data: {ranges}")
        return "; ".join(said)


@dataclass(frozen=True, slots=True, eq=False)
class Profiles(Mapping[str, Profile]):
    """Profile likelihoods by unknown.

    Attributes
    ----------
    items_ : tuple of Profile
        One for each unknown that was asked for.
    level : float
        Of the intervals.
    threshold : float
        Fall of the log-likelihood at their ends.
    missing : tuple of str
        Unknowns that were not reached before the caller stopped.
    better : dict of str to float
        Values of all unknowns at a fit that is better than the one that was handed in, where one
        was found on the way; the profiles are about that one then.
    """

    items_: tuple[Profile, ...]
    level: float
    threshold: float
    missing: tuple[str, ...] = ()
    better: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Profile:
        """Return the profile of an unknown.

        Raises
        ------
        OptionError
            If it was not profiled; the nearest is named.
        """
        for one in self.items_:
            if one.name == name:
                return one
        raise OptionError(f"no profile of {name!r}; {suggest(str(name), list(self))}")

    def __iter__(self) -> Iterator[str]:
        return iter(one.name for one in self.items_)

    def __len__(self) -> int:
        return len(self.items_)

    def __contains__(self, name: object) -> bool:
        return any(one.name == name for one in self.items_)

    def __repr__(self) -> str:
        return f"Profiles({len(self)} unknowns, {100 * self.level:g} %)"

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return the outermost ends by unknown, in its unit."""
        return {one.name: (one.lower, one.upper) for one in self.items_}

    @property
    def message(self) -> str:
        """What to know of the whole, in words; may be empty."""
        said = []
        if self.better:
            said.append(
                "A better fit than the estimate was found on the way, and the profiles are about"
                " it: start the update there (`better`)."
            )
        if self.missing:
            said.append(f"Stopped before {', '.join(self.missing)}.")
        return " ".join(said)

    def summary(self) -> str:
        """Return the intervals as text."""
        width = max(28, *(len(name) + 2 for name in self)) if len(self) else 28
        percent = f"{100 * self.level:g} %"
        lines = [f"Profile likelihood, {percent} intervals", *filter(None, [self.message]), ""]
        lines.append(f"{'unknown':<{width}}{'lower':>14}{'value':>14}{'upper':>14}  note")
        for one in self.items_:
            row = (
                f"{one.name:<{width}}{one.lower:>14.6g}{one.estimate:>14.6g}{one.upper:>14.6g} "
                f" {one.note}"
            )
            lines.append(row.rstrip())
        return "\n".join(lines)

    def table(self) -> tuple[NDArray[np.float64], ...]:
        """Return estimate, lower and upper ends as arrays, each shape (n,)."""
        rows = [(one.estimate, one.lower, one.upper) for one in self.items_]
        return tuple(np.array(rows).reshape(-1, 3).T)
