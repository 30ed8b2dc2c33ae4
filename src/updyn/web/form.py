"""`Form`: entries of a table of the job, held back until the job is complete with them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from updyn.errors import InputError, UpdynError
from updyn.web.document import JobDocument
from updyn.web.edits import as_value, set_keys
from updyn.web.faults import new_faults
from updyn.web.tasks import Field

__all__ = ["REQUIRED", "Form", "written_table"]

#: Fault of an entry that is missing.
REQUIRED = "required"


class Form:
    """The keys of one table that a page offers, as texts.

    `pending` holds the entries that are not in the job, by key, and `reason` why they are not;
    `reason` is empty if writing them was not tried. `proposed` holds entries for required keys that
    the job lacks; they are written with the others.
    """

    def __init__(self, table: str, fields: Sequence[Field]) -> None:
        self._table = table
        self._fields = {field.key: field for field in fields}
        self.pending: dict[str, str] = {}
        self.proposed: dict[str, str] = {}
        self.reason = ""

    def propose(self, entries: Mapping[str, str]) -> None:
        """Propose entries for required keys, by key."""
        self.proposed = {
            key: entry
            for key, entry in entries.items()
            if key in self._fields and self._fields[key].required
        }

    def entries(self, text: str) -> dict[str, str]:
        """Return the text of each entry by key: as typed, from the job, or as proposed."""
        return {**self._known_entries(text), **self.pending}

    def note(self, key: str, entry: str, text: str) -> None:
        """Store a typed entry."""
        if entry.strip() == self._known_entries(text)[key]:
            self.pending.pop(key, None)
        else:
            self.pending[key] = entry
        self.reason = ""

    def faults(self, text: str) -> dict[str, str]:
        """Return a message for each entry that is missing or cannot be written, by key."""
        entries = self.entries(text)
        found = {
            key: REQUIRED
            for key, field in self._fields.items()
            if field.required and not entries[key].strip()
        }
        for key, entry in self.pending.items():
            try:
                as_value(self._fields[key].kind, entry, self._fields[key].label)
            except InputError as error:
                found[key] = str(error)
            if re.search(rf"\b{self._table}\.{key}\b", self.reason):
                found[key] = self.reason
        return found

    def commit(self, document: JobDocument, *, is_needed: bool = False) -> None:
        """Write the entries into the job as one edit, unless that adds a fault to it.

        If nothing was typed, what is proposed is written only if it `is_needed`.
        """
        written = self._job_entries(document.text)
        new = {key: entry for key, entry in self.proposed.items() if not written[key]}
        entries = {**new, **self.pending}
        if not entries or not (self.pending or is_needed):
            return
        try:
            values = self._values(document.text, entries)
            changed = document.with_change(set_keys(self._table, values))
        except UpdynError as error:
            self.reason = str(error)
            return
        self.reason = "; ".join(new_faults(document.path, document.text, changed))
        if not self.reason:
            names = ", ".join(f"{self._table}.{key}" for key in entries)
            self.pending.clear()
            document.replace(names, changed)

    def discard(self) -> None:
        """Forget the entries that are not in the job."""
        self.pending.clear()
        self.reason = ""

    def _job_entries(self, text: str) -> dict[str, str]:
        """Return the entries of the job as typed text; the default for a choice without value."""
        table = written_table(text, self._table)
        found = {key: _as_text(table.get(key)) for key in self._fields}
        for key, field in self._fields.items():
            if field.choices and not found[key]:
                found[key] = field.choices[0]
        return found

    def _known_entries(self, text: str) -> dict[str, str]:
        """Return the entries of the job, and the proposed ones where it has none."""
        written = self._job_entries(text)
        return {key: entry or self.proposed.get(key, "") for key, entry in written.items()}

    def _values(self, text: str, entries: Mapping[str, str]) -> dict[str, Any]:
        """Return the values of entries; None for one that is empty."""
        table = written_table(text, self._table)
        found = {}
        for key, entry in entries.items():
            field = self._fields[key]
            value = as_value(field.kind, entry, field.label)
            present = table.get(key)
            if isinstance(value, list) and isinstance(present, list):
                known = {_as_text(item): item for item in present}
                value = [known.get(item, item) for item in value]  # with the rest of its table
            found[key] = value
        return found


def written_table(text: str, table: str) -> Mapping[str, Any]:
    """Return a table of a job as it is written; empty if the job has no such table."""
    try:
        found = tomlkit.parse(text).unwrap().get(table)
    except (TOMLKitError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _as_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(map(_as_text, value))
    if isinstance(value, dict):
        return str(value.get("dof", ""))
    return str(value)
