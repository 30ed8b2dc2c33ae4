"""`Table` and `Document`: the bases of the tables of a job file, and of a whole one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, PrivateAttr, Strict

from updyn.errors import InputError, JobError
from updyn.job.toml_lines import Place, line_of

__all__ = ["Document", "Pair", "Table", "Texts", "is_number", "tables_of"]

Pair = Annotated[tuple[float, float], Strict(False)]
Texts = Annotated[tuple[str, ...], Strict(False)]


def tables_of(name: str) -> Callable[[Any], Any]:
    """Return a check that an array of tables of this name is one, not a single table."""

    def several(given: Any) -> Any:
        if isinstance(given, dict):
            raise ValueError(f"one table, [{name}]; write [[{name}]], as there may be several")  # noqa: TRY004
        return given

    return several


def is_number(given: Any) -> bool:
    """Whether something is a number, truth values left out."""
    return isinstance(given, int | float) and not isinstance(given, bool)


class Table(BaseModel):
    """Base of all tables: unknown keys and values of another type are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


AnyDocument = TypeVar("AnyDocument", bound="Document")


class Document(Table):
    """A whole job file, with the line of each key."""

    _path: Path = PrivateAttr(default=Path("job.toml"))
    _lines: dict[Place, int] = PrivateAttr(default_factory=dict)

    @property
    def path(self) -> Path:
        """Where the job was read."""
        return self._path

    def place(self, *place: str | int) -> int | None:
        """Return where something stands in the file.

        Parameters
        ----------
        *place : str or int
            Keys and positions in arrays, from the root.

        Returns
        -------
        int or None
            The line of it, or of the nearest thing around it that is there.
        """
        return line_of(place, self._lines)

    def beside(self, file: str) -> Path:
        """Return the path of a file that the job names.

        Parameters
        ----------
        file : str
            As the job says it, relative to the job file.

        Returns
        -------
        Path
        """
        return self.path.parent / file

    @contextmanager
    def located(self) -> Iterator[None]:
        """Give an `InputError` that is raised inside the file, and the line of its key.

        Raises
        ------
        JobError
            In its place; one that has a file already stays as it is.
        """
        try:
            yield
        except InputError as error:
            if isinstance(error, JobError) and error.path is not None:
                raise
            raise JobError(str(error), self.path, self.place(*error.key)) from error

    def at(self: AnyDocument, path: Path, lines: dict[Place, int]) -> AnyDocument:
        """Return this document with its place.

        Parameters
        ----------
        path : Path
            The file.
        lines : dict of Place to int
            Its lines.

        Returns
        -------
        Document
            A copy.
        """
        out = self.model_copy()
        out._path, out._lines = path, lines
        return out
