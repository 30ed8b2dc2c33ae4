"""Tables of a job file that choose unknowns and damping: the base of all tables, and what several of them check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, model_validator

__all__ = [
    "CalibrationTable",
    "DampingTable",
    "Pair",
    "ParameterTable",
    "Table",
    "Texts",
    "is_number",
    "tables_of",
]

Pair = Annotated[tuple[float, float], Strict(False)]
Texts = Annotated[tuple[str, ...], Strict(False)]


def _groups(given: Any) -> Any:
    globs = [given] if isinstance(given, str) else given
    if (
        not isinstance(globs, list | tuple)
        or not globs
        or not all(isinstance(g, str) for g in globs)
    ):
        raise ValueError("expected group names or globs, such as ['shaft', 'gear*']")
    return tuple(globs)


def _driven(given: Any) -> Any:
    if isinstance(given, Mapping) and given and all(is_number(p) for p in given.values()):
        return {name: float(power) for name, power in given.items()}
    if isinstance(given, list | tuple) and given and all(isinstance(g, str) for g in given):
        return tuple(given)
    raise ValueError(
        'expected names with powers, such as { "skin.stiffness" = 1 }, or an array of names'
    )


def tables_of(name: str) -> Callable[[Any], Any]:
    """Return a check that an array of tables of this name is one, not a single table."""

    def several(given: Any) -> Any:
        if isinstance(given, dict):
            raise ValueError(f"one table, [{name}]; write [[{name}]], as there may be several")  # noqa: TRY004
        return given

    return several


def _sensors(given: Any) -> Any:
    if given == "all":
        return given
    if isinstance(given, list | tuple) and all(isinstance(x, str) for x in given):
        return tuple(given)
    raise ValueError("expected 'all' or labels, such as ['5:Z', '7:Z']")


def is_number(given: Any) -> bool:
    """Whether something is a number, truth values left out."""
    return isinstance(given, int | float) and not isinstance(given, bool)


class Table(BaseModel):
    """What all tables have in common: unknown keys and loose types are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class ParameterTable(Table):
    """``[[parameter]]``: one quantity of some groups, an unknown each; or one unknown that drives several."""

    groups: Annotated[tuple[str, ...] | None, BeforeValidator(_groups)] = None
    quantity: (
        Literal["stiffness", "mass", "loss_factor", "viscous", "mass_damping", "stiffness_damping"]
        | None
    ) = None
    name: str | None = None
    drives: Annotated[tuple[str, ...] | dict[str, float] | None, BeforeValidator(_driven)] = None
    nominal: float | None = Field(default=None, gt=0)
    unit: str = ""
    bounds: Pair | None = None
    prior_std: float | None = Field(default=None, gt=0)
    start: float | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> ParameterTable:
        plain, linked = (self.groups, self.quantity), (self.name, self.drives)
        if any(x is not None for x in plain) and any(x is not None for x in linked):
            raise ValueError(
                "groups and quantity are one way to choose, name and drives the other; give one"
                " pair"
            )
        for pair, keys in ((plain, ("groups", "quantity")), (linked, ("name", "drives"))):
            for one, other, missing in ((pair[0], pair[1], keys[1]), (pair[1], pair[0], keys[0])):
                if one is not None and other is None:
                    raise ValueError(f"missing key {missing!r}")
        if self.groups is None and self.name is None:
            raise ValueError("expected groups and quantity, or name and drives")
        return self


class DampingTable(Table):
    """``[[damping]]``: damping that groups begin with, instead of what the model has."""

    groups: Annotated[tuple[str, ...], BeforeValidator(_groups)]
    loss_factor: float | None = Field(default=None, ge=0)
    mass_damping: float | None = Field(default=None, ge=0)
    stiffness_damping: float | None = Field(default=None, ge=0)
    loss_table: Annotated[
        tuple[Annotated[tuple[float, ...], Strict(False)], ...] | None, Strict(False)
    ] = None

    @property
    def stated(self) -> dict[str, Any]:
        """What the table says, by name."""
        return self.model_dump(exclude={"groups"}, exclude_none=True)

    @model_validator(mode="after")
    def _something(self) -> DampingTable:
        if not self.stated:
            raise ValueError("expected loss_factor, mass_damping, stiffness_damping or loss_table")
        return self


class CalibrationTable(Table):
    """``[[calibration]]``: factors of sensors, an unknown each."""

    responses: Annotated[Literal["all"] | Texts, BeforeValidator(_sensors)] = ()
    references: Annotated[Literal["all"] | Texts, BeforeValidator(_sensors)] = ()
    prior_std: float = Field(default=0.05, gt=0)
    bounds: Pair = (0.1, 10.0)
    name: str | None = None

    @model_validator(mode="after")
    def _something(self) -> CalibrationTable:
        if not self.responses and not self.references:
            raise ValueError("expected responses or references: labels, or 'all'")
        return self
