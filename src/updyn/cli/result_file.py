"""`RESULT`: files of `updyn.write_result`, for ``updyn info``."""

from __future__ import annotations

from updyn.cli.reading import FileKind
from updyn.store.result import read_result

__all__ = ["RESULT"]

#: The record of a run; a separate module, because it imports the whole update.
RESULT = FileKind("the record of a run", read_result, lambda result: result.summary())
