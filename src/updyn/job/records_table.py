"""``[records]`` of a job file: time records for FRFs, and a job with that table only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, Strict, model_validator

from updyn.job.base import Document, Pair, Table, Texts, is_number, tables_of

__all__ = ["CutTable", "RecordsJob", "RecordsTable", "SetupTable", "WindowTable"]


def _parse_files(given: object) -> object:
    files = [given] if isinstance(given, str) else given
    if not isinstance(files, list | tuple) or not files:
        raise ValueError("expected a file, or an array of files with hits of the same channels")
    if not all(isinstance(file, str) and file for file in files):
        raise ValueError("expected the names of files")
    return tuple(files)


def _parse_channels(given: object) -> object:
    if isinstance(given, str):
        return (given,)
    if isinstance(given, Mapping) and given and all(isinstance(v, str) for v in given.values()):
        return dict(given)
    if isinstance(given, list | tuple) and given and all(isinstance(v, str) for v in given):
        return tuple(given)
    raise ValueError(
        'expected channels with their DOFs, such as { Force = "3:-Z" }, or channels that are called'
        " by their DOFs"
    )


def _parse_rejections(given: object) -> object:
    if not isinstance(given, Mapping):
        raise ValueError('expected records with reasons, such as { 1 = "clipped" }')  # noqa: TRY004
    found: dict[int, str] = {}
    for number, why in given.items():
        if not (str(number).isdecimal() and int(number) >= 1):
            raise ValueError(f"record {number!r}; expected whole numbers from 1")
        if not isinstance(why, str) or not why.strip():
            raise ValueError(f"record {number}: expected the reason as a text")
        found[int(number)] = why
    return found


def _parse_factors(given: object) -> object:
    if not isinstance(given, Mapping) or not all(is_number(v) for v in given.values()):
        raise ValueError("expected channels with numbers, such as { Force = 22.5 }")
    return {name: float(factor) for name, factor in given.items()}


_Channels = Annotated[dict[str, str] | Texts | None, BeforeValidator(_parse_channels)]


class WindowTable(Table):
    """``[records.impact]``: windows for hits."""

    force: float | None = Field(default=None, gt=0)
    exponential: float | None = Field(default=None, gt=0, lt=1)
    remove_damping: bool = True


class CutTable(Table):
    """``[records.cut]``: cut records that contain several hits into one record per hit."""

    length: float = Field(gt=0)
    before: float | None = Field(default=None, ge=0)
    level: float = Field(default=0.2, gt=0, lt=1)


class SetupTable(Table):
    """``[[records.setup]]``: files with records of the same channels."""

    file: Annotated[tuple[str, ...] | None, BeforeValidator(_parse_files)] = None
    format: str | None = None
    reader: dict[str, object] | None = None
    excitation: _Channels = None
    responses: _Channels = None
    units: dict[str, str] | None = None
    factors: Annotated[dict[str, float] | None, BeforeValidator(_parse_factors)] = None
    reject: Annotated[dict[int, str] | None, BeforeValidator(_parse_rejections)] = None


class RecordsTable(SetupTable):
    """``[records]``: time records, and how FRFs are estimated from them.

    Keys given here apply to every setup that does not give them itself.
    """

    setup: Annotated[
        tuple[SetupTable, ...], BeforeValidator(tables_of("records.setup")), Strict(False)
    ] = ()
    estimator: Literal["H1", "H2", "Hv", "LRM", "H1-LRM"] = "H1"
    window: str | None = None
    impact: WindowTable | None = None
    cut: CutTable | None = None
    segment: float | None = Field(default=None, gt=0)
    overlap: float | None = Field(default=None, ge=0, lt=1)
    band: Pair | None = None
    output: str | None = None

    @model_validator(mode="after")
    def _check_setups(self) -> RecordsTable:
        if self.setup and self.file is not None:
            raise ValueError("file and [[records.setup]]; expected one of the two")
        if self.setup and self.reject is not None:
            raise ValueError("reject: give it in the [[records.setup]] of the record")
        if not self.setup and self.file is None:
            raise ValueError("missing key 'file', or [[records.setup]] with files")
        for number, setup in enumerate(self.setup, 1):
            if setup.file is None:
                raise ValueError(f"missing key 'file' in [[records.setup]] {number}")
        if self.impact is not None and (self.window, self.segment) != (None, None):
            raise ValueError("impact: windows for hits need whole records; omit window and segment")
        if self.cut is not None and self.segment is not None:
            raise ValueError("cut applies to hits, segment to a continuous force; give one")
        for setup in self.setups:
            if setup.excitation is None:
                raise ValueError("missing key 'excitation': the channel of the force, with its DOF")
        return self

    @property
    def setups(self) -> tuple[SetupTable, ...]:
        """The setups, each completed with the common keys."""
        common = {name: getattr(self, name) for name in SetupTable.model_fields}
        if not self.setup:
            return (SetupTable.model_construct(**common),)
        whole = []
        for setup in self.setup:
            values = {name: getattr(setup, name) for name in SetupTable.model_fields}
            values |= {name: common[name] for name in values if values[name] is None}
            whole.append(SetupTable.model_construct(**values))
        return tuple(whole)

    def place(self, number: int, key: str) -> tuple[str | int, ...]:
        """Return the place, from the root of the job, of a key of setup `number` (from 0)."""
        if key not in SetupTable.model_fields:
            return ("records", key)
        if self.setup and getattr(self.setup[number], key) is not None:
            return ("records", "setup", number, key)
        if getattr(self, key) is None and self.setup:
            return ("records", "setup", number)
        return ("records", key)


class RecordsJob(Document):
    """A job file with records only, from which ``updyn frf`` estimates FRFs."""

    title: str = ""
    records: RecordsTable
