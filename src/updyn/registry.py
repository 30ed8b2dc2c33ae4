"""Registries of extensions by name: built-in entries, registered ones and entry points.

Each kind of extension (reader, element, residual, method, backend, engine, report section, job
table, command) has one `Registry`. An entry is an object, or a text ``"module:attribute"`` that is
imported when the entry is first used; listing the names imports nothing.

Another package adds an entry by `Registry.register`, or by an entry point in its metadata::

    [project.entry-points."updyn.methods"]
    my-method = "my_package.my_module:MyMethod"
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any, Generic, TypeVar, cast

from updyn.errors import OptionError, suggest

__all__ = ["Registry", "load_object"]

Entry = TypeVar("Entry")


def load_object(path: str) -> Any:
    """Import the object that a text ``"module:attribute"`` names.

    Parameters
    ----------
    path : str
        Such as ``"updyn.linalg.pardiso:Pardiso"``.

    Returns
    -------
    object
        The attribute of the module.
    """
    module, _, attribute = path.partition(":")
    return getattr(importlib.import_module(module), attribute)


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Ordered entries of one kind of extension by name, each imported when it is first used.

    Parameters
    ----------
    kind : str
        Kind of the entries, in the singular, for messages: ``"method"``.
    group : str
        Entry point group of further entries: ``"updyn.methods"``.
    entries : mapping of str to object or str
        The built-in entries: objects, or texts ``"module:attribute"``.
    """

    def __init__(self, kind: str, group: str, entries: Mapping[str, Entry | str]) -> None:
        self.kind = kind
        self.group = group
        self._entries: dict[str, Entry | str] = dict(entries)
        self._searched = False

    def register(self, name: str, entry: Entry | str) -> None:
        """Add an entry.

        Parameters
        ----------
        name : str
            Name of the entry.
        entry : object or str
            The entry, or ``"module:attribute"``, imported when it is first used.

        Raises
        ------
        OptionError
            If another entry has that name.
        """
        known = self._entries.get(name)
        if known is not None and known != entry:
            raise OptionError(f"{self.kind} {name!r} is registered already")
        self._entries[name] = entry

    def entry(self, name: str) -> Entry | str:
        """Return an entry as registered: the object or ``"module:attribute"``, not imported.

        Parameters
        ----------
        name : str
            Name of the entry.

        Returns
        -------
        object or str
            The object if it was imported before.

        Raises
        ------
        KeyError
            If no entry has that name.
        """
        if name not in self._entries:
            self._add_entry_points()
        return self._entries[name]

    def __getitem__(self, name: str) -> Entry:
        if name not in self._entries:
            self._add_entry_points()
        entry = self._entries[name]
        if isinstance(entry, str):
            entry = cast(Entry, load_object(entry))
            self._entries[name] = entry
        return entry

    def __iter__(self) -> Iterator[str]:
        self._add_entry_points()
        return iter(tuple(self._entries))

    def __len__(self) -> int:
        self._add_entry_points()
        return len(self._entries)

    def __contains__(self, name: object) -> bool:
        if not isinstance(name, str):
            return False
        if name not in self._entries:
            self._add_entry_points()
        return name in self._entries

    def find(self, name: str) -> Entry:
        """Return an entry requested by a user.

        Parameters
        ----------
        name : str
            Name of the entry.

        Returns
        -------
        object
            The entry, imported.

        Raises
        ------
        OptionError
            If no entry has that name; the message gives the nearest.
        """
        if name not in self:
            raise OptionError(f"{self.kind} {name!r}: {suggest(str(name), self)}")
        return self[name]

    def _add_entry_points(self) -> None:
        """Add the entries of installed packages, once; a built-in entry keeps its name."""
        if self._searched:
            return
        self._searched = True
        for point in metadata.entry_points(group=self.group):
            self._entries.setdefault(point.name, point.value)
