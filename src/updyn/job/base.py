"""`Table` and `Document`: base classes of the tables of a job file, and of a whole job file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, ClassVar, TypeGuard, TypeVar

from pydantic import BaseModel, ConfigDict, PrivateAttr, Strict

from updyn.errors import InputError, JobError
from updyn.job.toml_lines import Place, line_of

__all__ = ["Document", "Pair", "Table", "Texts", "is_number", "tables_of"]

Pair = Annotated[tuple[float, float], Strict(False)]
Texts = Annotated[tuple[str, ...], Strict(False)]


def tables_of(name: str) -> Callable[[object], object]:
    """Return a validator that rejects a single table in place of an array of tables."""

    def check_array(given: object) -> object:
        if isinstance(given, dict):
            raise ValueError(f"one table, [{name}]; write [[{name}]], as there may be several")  # noqa: TRY004
        return given

    return check_array


def is_number(given: object) -> TypeGuard[float]:
    """Return whether a value is a number and not a boolean."""
    return isinstance(given, int | float) and not isinstance(given, bool)


class Table(BaseModel):
    """Base of all tables: unknown keys and values of another type are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    #: Class of the tables whose names the user chooses, if this table has such tables.
    of_any_name: ClassVar[type[BaseModel] | None] = None


AnyDocument = TypeVar("AnyDocument", bound="Document")


class Document(Table):
    """A whole job file, with the line of each key."""

    _path: Path = PrivateAttr(default=Path("job.toml"))
    _lines: dict[Place, int] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """The job file."""
        return self._path

    def place(self, *place: str | int) -> int | None:
        """Return the line of a place (keys and positions from the root), or of its parent."""
        return line_of(place, self._lines)

    def beside(self, file: str) -> Path:
        """Return the path of a file that the job names relative to the job file."""
        return self.path.parent / file

    @contextmanager
    def located(self) -> Iterator[None]:
        """Add the job file and the line of the key to an `InputError`, as a `JobError`."""
        try:
            yield
        except InputError as error:
            if isinstance(error, JobError) and error.path is not None:
                raise
            raise JobError(str(error), self.path, self.place(*error.key)) from error

    def at(self: AnyDocument, path: Path, lines: dict[Place, int]) -> AnyDocument:
        """Return a copy of this document with its file and the line of each key."""
        out = self.model_copy()
        out._path, out._lines = path, lines
        return out
