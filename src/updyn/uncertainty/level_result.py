"""`LevelAssessment`: standard deviations with fewer and with further force levels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from updyn.notebook import card, table
from updyn.text_table import format_count, text_table
from updyn.updating.problem.parameters import ParameterSet

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CandidateLevel", "FittedLevel", "LevelAssessment"]

#: Standard deviation by unknown, in its unit; inf for undetermined unknowns.
Deviations = Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class FittedLevel:
    """A test of the update, and its information.

    Attributes
    ----------
    name : str
        Name of the test.
    level : float
        Force amplitude in N (N m), the median over its lines; nan if it is not stated.
    without : dict of str to float
        Standard deviation of each unknown without this test; inf for undetermined unknowns.
    alone : dict of str to float
        Standard deviation of each unknown with this test alone.

    Examples
    --------
    >>> import math
    >>> one = updyn.FittedLevel("2 N", 2.0, {"joint.stiffness": math.inf}, {"joint.stiffness": 3e2})
    >>> one, one.alone["joint.stiffness"]
    (FittedLevel(2 N), 300.0)
    """

    name: str
    level: float
    without: Deviations
    alone: Deviations

    def __repr__(self) -> str:
        return f"FittedLevel({self.name})"


@dataclass(frozen=True, slots=True, eq=False)
class CandidateLevel:
    """A further test at another force level, and its expected information.

    Attributes
    ----------
    level : float
        Force amplitude in N (N m).
    like : str
        Name of the test whose channels, lines and noise it has.
    is_repeat : bool
        Whether a test at this level was fitted.
    std : dict of str to float
        Standard deviation of each unknown with this test in addition; inf for undetermined
        unknowns, nan if the response could not be computed.
    gain : float
        Relative decrease of the standard deviations of the unknowns that the tests determine, in
        the geometric mean; nan if the response could not be computed.
    determines : tuple of str
        Unknowns that are determined with this test only.
    note : str
        A remark on the response at this level; may be empty.

    Examples
    --------
    >>> updyn.CandidateLevel(5.0, "2 N", False, {"joint.stiffness": 2e2}, gain=0.25)
    CandidateLevel(5, gain 25 %)
    """

    level: float
    like: str
    is_repeat: bool
    std: Deviations
    gain: float
    determines: tuple[str, ...] = ()
    note: str = ""

    def __repr__(self) -> str:
        return f"CandidateLevel({self.level:g}, gain {100.0 * self.gain:.3g} %)"


@dataclass(frozen=True, slots=True, eq=False)
class LevelAssessment:
    """Information of the force levels of an update, and of further levels.

    Attributes
    ----------
    parameters : ParameterSet
        The unknowns.
    values : dict of str to float
        Their estimates, in the unit of each.
    std : dict of str to float
        Standard deviations with all tests; inf for undetermined unknowns.
    fitted : tuple of FittedLevel
        The tests of the update.
    candidates : tuple of CandidateLevel
        Further tests, each in addition to all tests of the update.
    unit : str
        Unit of the levels: ``"N"`` or ``"N m"``.

    Examples
    --------
    >>> groups = {"spring": updyn.Group([[1e4]])}
    >>> unknowns = updyn.parameters(updyn.Model.from_groups(groups, ["1:X"]), stiffness="spring")
    >>> name, further = "spring.stiffness", []
    >>> for level, std, gain in ((4.0, 0.008, 0.2), (8.0, 0.005, 0.5)):
    ...     further.append(updyn.CandidateLevel(level, "2 N", False, {name: std}, gain))
    >>> found = updyn.LevelAssessment(unknowns, {name: 1.1}, {name: 0.01}, (), tuple(further))
    >>> found.best
    CandidateLevel(8, gain 50 %)
    """

    parameters: ParameterSet
    values: Mapping[str, float]
    std: Deviations
    fitted: tuple[FittedLevel, ...]
    candidates: tuple[CandidateLevel, ...]
    unit: str = "N"

    @property
    def best(self) -> CandidateLevel | None:
        """Candidate that determines most unknowns, of these that with the largest gain."""
        usable = [one for one in self.candidates if math.isfinite(one.gain)]
        return max(usable, key=lambda one: (len(one.determines), one.gain), default=None)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table of standard deviations with a row for each unknown.

        Returns
        -------
        pandas.DataFrame
            Index: ``unknown``. Columns: ``value``, ``std``, ``without NAME`` and ``only NAME`` for
            each test, ``with LEVEL`` for each candidate, and ``unit``.
        """
        import pandas as pd

        columns: dict[str, list[float] | list[str]] = {"value": list(self.values.values())}
        columns["std"] = list(self.std.values())
        for one in self.fitted:
            columns[f"without {one.name}"] = list(one.without.values())
        for one in self.fitted:
            columns[f"only {one.name}"] = list(one.alone.values())
        for candidate in self.candidates:
            name = f"with {candidate.level:g} {self.unit}"
            columns[name] = list(candidate.std.values())
        columns["unit"] = [p.value_unit for p in self.parameters]
        return pd.DataFrame(columns, index=pd.Index(list(self.values), name="unknown"))

    def to_dict(self) -> dict[str, object]:
        """Return the assessment as plain values, for JSON; None in place of inf and nan.

        Returns
        -------
        dict
            ``unit``; ``unknowns``: by name, ``value``, ``std`` and ``unit``; ``tests``: a dict for
            each, with ``name``, ``level``, ``without`` and ``alone``; ``candidates``: a dict for
            each, with ``level``, ``like``, ``is_repeat``, ``gain``, ``determines``, ``std`` and
            ``note``; ``best``: the recommended level.
        """
        tests = []
        for one in self.fitted:
            own = {"without": _to_plain(one.without), "alone": _to_plain(one.alone)}
            tests.append({"name": one.name, "level": _to_finite(one.level), **own})
        candidates = []
        for candidate in self.candidates:
            candidates.append(
                {
                    "level": candidate.level,
                    "like": candidate.like,
                    "is_repeat": candidate.is_repeat,
                    "gain": _to_finite(candidate.gain),
                    "determines": list(candidate.determines),
                    "std": _to_plain(candidate.std),
                    "note": candidate.note,
                }
            )
        unknowns = {
            p.name: {
                "value": self.values[p.name],
                "std": _to_finite(self.std[p.name]),
                "unit": p.value_unit,
            }
            for p in self.parameters
        }
        best = self.best
        return {
            "unit": self.unit,
            "unknowns": unknowns,
            "tests": tests,
            "candidates": candidates,
            "best": None if best is None else best.level,
        }

    @property
    def statement(self) -> str:
        """The recommended level in a sentence; empty without candidates."""
        best = self.best
        if best is None:
            return ""
        if best.determines:
            effect = f"determines {', '.join(best.determines)}"
        else:
            effect = f"reduces the standard deviations by {_format_percent(best.gain)}"
        verb = "Repeat the" if best.is_repeat else "Add a"
        return f"{verb} test at {best.level:.4g} {self.unit}: it {effect}."

    def summary(self) -> str:
        """Return standard deviations by level, and the gain of further levels, as text.

        Returns
        -------
        str
        """
        head = f"Levels: {format_count(len(self.fitted), 'test')}. {self.statement}".rstrip()
        blocks = [
            head,
            "Standard deviations",
            text_table(*self.deviation_table()),
            "One test in addition",
            text_table(*self.candidate_table(), left=(0, 3, 4)),
        ]
        return "\n\n".join(blocks if self.candidates else blocks[:3])

    def deviation_table(self) -> tuple[list[str], list[list[str]]]:
        """Return heading and rows of the standard deviations with all tests, and without each.

        Returns
        -------
        (list of str, list of list of str)
        """
        heading = ["unknown", "value", "all tests"]
        heading += [f"without {one.name}" for one in self.fitted]
        rows = []
        for p in self.parameters:
            stds = [self.std[p.name], *(one.without[p.name] for one in self.fitted)]
            rows.append([p.name, f"{self.values[p.name]:.5g}", *map(_format_std, stds)])
        return heading, rows

    def candidate_table(self) -> tuple[list[str], list[list[str]]]:
        """Return heading and rows of the candidates.

        Returns
        -------
        (list of str, list of list of str)
        """
        heading = [f"level ({self.unit})", "smaller by", "at most", "of", "note"]
        return heading, [self._describe(one) for one in self.candidates]

    def _describe(self, one: CandidateLevel) -> list[str]:
        """Return the cells of a candidate."""
        notes = ["repeated"] if one.is_repeat else []
        if one.determines:
            notes.append(f"determines {', '.join(one.determines)}")
        if one.note:
            notes.append(one.note)
        largest, name = self._find_largest_decrease(one)
        gains = [_format_percent(one.gain), _format_percent(largest)]
        return [f"{one.level:.4g}", *gains, name, "; ".join(notes)]

    def _find_largest_decrease(self, one: CandidateLevel) -> tuple[float, str]:
        """Return the largest decrease of a standard deviation by a candidate, and its unknown."""
        decreases = {
            name: 1.0 - one.std[name] / std
            for name, std in self.std.items()
            if math.isfinite(std) and math.isfinite(one.std[name])
        }
        name = max(decreases, key=lambda name: decreases[name], default="")
        return decreases.get(name, math.nan), name

    def _repr_html_(self) -> str:
        facts = {"tests": len(self.fitted), "unknowns": len(self.std)}
        tables: Sequence[str] = [table(*self.deviation_table())]
        if self.candidates:
            tables = [*tables, table(*self.candidate_table(), left=(0, 3, 4))]
        return card(self.statement or "Levels", facts, *tables)

    def __repr__(self) -> str:
        counts = [
            format_count(len(self.fitted), "test"),
            format_count(len(self.candidates), "candidate"),
            format_count(len(self.std), "unknown"),
        ]
        return f"LevelAssessment({', '.join(counts)})"


def _to_finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _to_plain(std: Deviations) -> dict[str, float | None]:
    return {name: _to_finite(value) for name, value in std.items()}


def _format_std(std: float) -> str:
    return f"{std:.3g}" if math.isfinite(std) else "-"


def _format_percent(share: float) -> str:
    return f"{100.0 * share:.3g} %" if math.isfinite(share) else "-"
