"""Tables of a job file about the fit: what is selected, how the unknowns are found, how sure they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from updyn.job.tables import Table, Texts, is_number

__all__ = ["HeldOut", "MethodTable", "Noise", "SelectionTable", "UncertaintyTable"]


def _lines(given: Any) -> Any:
    if isinstance(given, str):
        return given
    if isinstance(given, list | tuple) and given and all(is_number(x) for x in given):
        return tuple(float(x) for x in given)
    raise ValueError(
        "expected 'd-optimal:N' or an array of frequencies in Hz; leave it out to fit all lines"
    )


def _validation(given: Any) -> Any:
    if isinstance(given, list | tuple) and given:
        if all(isinstance(x, str) for x in given):
            return tuple(given)
        if len(given) == 2 and all(is_number(x) for x in given):
            return float(given[0]), float(given[1])
    raise ValueError(
        "expected response labels, such as ['5:+Z'], or a band of two frequencies in Hz"
    )


def _noise(given: Any) -> Any:
    if not isinstance(given, str | Mapping):
        raise ValueError(  # noqa: TRY004
            "expected a table with relative and/or floor, such as { relative = 0.02, floor ="
            " 0.001 }"
        )
    return given


def _regularise(given: Any) -> Any:
    if isinstance(given, str):
        return given
    if not is_number(given) or given <= 0:
        raise ValueError(
            "expected 'gcv', 'l-curve', 'discrepancy', 'tsvd', 'tsvd:N', or a strength above 0"
        )
    return float(given)


def _count(given: Any) -> Any:
    if given != "rank" and (not isinstance(given, int) or isinstance(given, bool) or given < 1):
        raise ValueError("expected a whole number of at least 1, or 'rank'")
    return given


def _cosine(given: Any) -> Any:
    if not is_number(given) or not 0 < given < 1:
        raise ValueError("expected a cosine between 0 and 1, such as 0.99")
    return given


#: The noise of a test, and what of it is held out; both stand in ``[method]``, or in ``[test]``
#: instead.
Noise = Annotated[str | dict[str, float | str] | None, BeforeValidator(_noise)]
HeldOut = Annotated[tuple[str, ...] | tuple[float, float] | None, BeforeValidator(_validation)]


class SelectionTable(Table):
    """``[selection]``: which of the unknowns are fitted; the others are joined, or stay at their start."""

    cluster: Annotated[float | None, BeforeValidator(_cosine)] = None
    n: Annotated[int | Literal["rank"] | None, BeforeValidator(_count)] = None
    max_collinearity: float | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _something(self) -> SelectionTable:
        if self.cluster is None and self.n is None and self.max_collinearity is None:
            raise ValueError(
                "expected cluster, n or max_collinearity; leave [selection] out to fit all unknowns"
            )
        if self.n is not None and self.max_collinearity is not None:
            raise ValueError(
                "n says how many to fit, max_collinearity how separable they have to be; give one"
            )
        return self


class MethodTable(Table):
    """``[method]``: how the unknowns are found; further keys are options of the method."""

    model_config = ConfigDict(extra="allow")

    name: str = "maximum-likelihood"
    lines: Annotated[str | tuple[float, ...] | None, BeforeValidator(_lines)] = None
    noise: Noise = None
    validation: HeldOut = None
    tier: str | None = None
    backend: str | None = None
    accuracy: float | None = Field(default=None, ge=1e-10, le=0.1)
    regularise: Annotated[str | float | None, BeforeValidator(_regularise)] = None

    @property
    def options(self) -> dict[str, Any]:
        """The method's own options."""
        return dict(self.__pydantic_extra__ or {})


class UncertaintyTable(Table):
    """``[uncertainty]``: how sure the estimate is, beyond its standard deviations."""

    kind: Literal["profile", "bootstrap", "sampling"]
    names: Texts | None = Field(
        default=None, min_length=1
    )  # of a profile; all unknowns where left out
    n: int | None = Field(default=None, ge=2)
    seed: int = Field(default=0, ge=0)
    level: float = Field(default=0.95, gt=0, lt=1)

    @model_validator(mode="after")
    def _fitting(self) -> UncertaintyTable:
        if self.kind == "profile" and self.n is not None:
            raise ValueError("n is the number of draws; a profile makes none")
        if self.kind != "profile" and self.names is not None:
            raise ValueError(f"names choose unknowns to profile; kind {self.kind!r} draws all")
        return self
