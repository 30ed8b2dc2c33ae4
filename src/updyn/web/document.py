"""`JobDocument`: a job file during editing, with comments, undo, and the last saved text."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.exceptions import TOMLKitError

from updyn.errors import InputError, JobError
from updyn.io.atomic import write_bytes
from updyn.web.settings import WEB_PAGE

__all__ = ["JobDocument"]

_TYPING = "typing"


class JobDocument:
    """The text of a job file between two savings; `version` counts the changes of the text.

    A `JobError` is raised if the file does not exist or is not text.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = self._saved = _read_text(path)
        self.version = 0
        self._typed = -math.inf  # when something was typed last
        self._done: list[tuple[str, str]] = []
        self._undone: list[tuple[str, str]] = []

    @property
    def is_changed(self) -> bool:
        """Whether the text differs from the file."""
        return self.text != self._saved

    @property
    def modified_time(self) -> float:
        """Time of the last change of the file in s since 1970; 0 if it does not exist."""
        return self.path.stat().st_mtime if self.path.exists() else 0.0

    @property
    def last_edit(self) -> str:
        """Name of the edit that `undo` reverts, or an empty text."""
        return self._done[-1][0] if self._done else ""

    @property
    def next_edit(self) -> str:
        """Name of the edit that `redo` repeats, or an empty text."""
        return self._undone[-1][0] if self._undone else ""

    def edit(self, what: str, change: Callable[[TOMLDocument], None]) -> None:
        """Change the content as the named edit `what`; comments and order are kept."""
        self.replace(what, self.with_change(change))

    def with_change(self, change: Callable[[TOMLDocument], None]) -> str:
        """Return the text after a change, which is not made; `JobError` if the text is not TOML."""
        try:
            document = tomlkit.parse(self.text)
        except (TOMLKitError, RecursionError) as error:
            raise JobError(f"not TOML: {error}; correct the text first", self.path.name) from error
        change(document)
        return tomlkit.dumps(document)

    def replace(self, what: str, text: str) -> None:
        """Replace the whole text as the named edit `what`."""
        if text == self.text:
            return
        self._done = [*self._done, (what, self.text)][-WEB_PAGE.undo_steps :]
        self._undone = []
        self._set(text)

    def type(self, text: str) -> None:
        """Replace the whole text by typed text; typing without a longer pause is one edit."""
        if text == self.text:  # the page repeats the text of an undo
            return
        now, done = time.monotonic(), self._done
        is_soon = now - self._typed < WEB_PAGE.typing_pause
        goes_on = self.last_edit == _TYPING and is_soon and self.is_changed
        self.replace(_TYPING, text)
        self._typed = now
        if goes_on:
            self._done = done

    def undo(self) -> None:
        """Undo the last edit, if any."""
        if self._done:
            what, text = self._done.pop()
            self._undone.append((what, self.text))
            self._set(text)

    def redo(self) -> None:
        """Redo the last undone edit, if nothing was edited since."""
        if self._undone:
            what, text = self._undone.pop()
            self._done.append((what, self.text))
            self._set(text)

    def save(self) -> None:
        """Write the text to its file, which is unchanged if that fails (`FormatError`).

        An `InputError` is raised if another program has changed the file since it was read or
        saved, or UTF-8 cannot encode the text.
        """
        if self.path.exists() and _read_text(self.path) != self._saved:
            raise InputError(
                f"{self.path.name}: another program has changed this file since it was opened; open"
                " it again, or save under another name"
            )
        self._write(self.path)

    def save_as(self, path: Path) -> None:
        """Write the text to another file of the same folder; `InputError` if that exists."""
        if os.path.lexists(path):
            raise InputError(f"{path.name}: exists already; choose another name")
        self._write(path)
        self.path = path
        self.version += 1

    def _write(self, path: Path) -> None:
        try:
            content = self.text.encode()
        except UnicodeEncodeError as error:
            raise InputError(f"{path.name}: cannot be written as UTF-8: {error.reason}") from error
        write_bytes(path, content)
        self._saved = self.text

    def _set(self, text: str) -> None:
        self._typed = -math.inf
        self.text = text
        self.version += 1


def _read_text(path: Path) -> str:
    """Return the text of a file, line ends as they are."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise JobError(f"cannot be read: {error.strerror or error}", path.name) from error
    except UnicodeDecodeError as error:
        raise JobError("is not UTF-8; TOML is", path.name) from error
