"""Pages of the reference, written by every build: the public names, and the keys of a job."""

from __future__ import annotations

import importlib
import inspect
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import Job

NAMES = Path(__file__).parents[1] / "public-names.txt"


def write(folder: Path) -> None:
    """Write all pages of the reference.

    Parameters
    ----------
    folder : Path
        Output folder; its content is removed first.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    rooms = sorted({name.rpartition(".")[0] for name in names()})
    for room in rooms:
        own = [name for name in names() if name.rpartition(".")[0] == room]
        (folder / f"{room}.rst").write_text(_room(room, own), encoding="utf-8")
    (folder / "job-keys.md").write_text(job_keys(), encoding="utf-8")


def names() -> list[str]:
    """Return the public names, with their rooms."""
    return NAMES.read_text(encoding="utf-8").split()


def _room(room: str, own: Iterable[str]) -> str:
    title = f"``{room}``"
    lines = [title, "=" * len(title), "", _first_line(room), ""]
    lines += [".. autosummary::", "   :nosignatures:", ""]
    documented = [name for name in own if _directive(name)]
    lines += [f"   ~{name}" for name in documented]
    for name in documented:
        lines += ["", *_entry(name)]
    return "\n".join(lines) + "\n"


def _first_line(room: str) -> str:
    return (importlib.import_module(room).__doc__ or "").strip().splitlines()[0].replace("`", "``")


def _entry(name: str) -> Iterator[str]:
    short = name.rpartition(".")[2]
    yield from (short, "-" * len(short), "", f".. {_directive(name)}:: {name}")
    if _directive(name) == "autoclass":
        yield from ("   :members:", "")


def _directive(name: str) -> str:
    room, _, short = name.rpartition(".")
    thing = getattr(importlib.import_module(room), short)
    if inspect.isclass(thing):
        return "autoclass"
    if inspect.isroutine(thing):
        return "autofunction"
    if inspect.ismodule(thing) or short == "__version__":
        return ""  # a room has a separate page
    return "autodata"


def job_keys() -> str:
    """Return the keys of all tables of a job file, with type and default, from their schemas.

    Returns
    -------
    str
        A page of Markdown.
    """
    lines = [
        "# Keys of the job file",
        "",
        "Types, limits and defaults, from the schema by which a job is validated. What each key"
        " means, with examples: [the job file](../../job.md).",
    ]
    tables: list[tuple[str, type[BaseModel]]] = [("", Job)]
    tables += [(name, JOB_TABLES[name].schema) for name in JOB_TABLES]
    seen: set[str] = set()
    for path, schema in tables:
        lines += _table(path, schema, seen)
    return "\n".join(lines) + "\n"


def _table(path: str, schema: type[BaseModel], seen: set[str]) -> Iterator[str]:
    if path in seen:
        return
    seen.add(path)
    yield from ("", f"## {f'`{path}`' if path else 'Top level'}", "")
    yield from ("| key | type | default |", "|---|---|---|")
    described = schema.model_json_schema()
    below: list[tuple[str, type[BaseModel]]] = []
    for key, field in schema.model_fields.items():
        given = described["properties"].get(field.alias or key, {})
        default = "required" if field.is_required() else _default(field.get_default())
        yield f"| `{key}` | {_kind(given, described)} | {default} |"
        below += [(f"{path}.{key}".lstrip("."), t) for t in _models(field.annotation)]
    for name, table in below:
        yield from _table(name, table, seen)


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from _models(part)


def _default(value: Any) -> str:
    if value is None or (isinstance(value, BaseModel | tuple | dict) and not _shown(value)):
        return ""
    return f"`{_toml(value)}`"


def _shown(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return str(value)


#: JSON Schema's names, in the words of TOML.
KINDS = {
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "object": "table",
    "array": "array",
    "null": "",
}
LIMITS = {
    "minimum": "at least",
    "maximum": "at most",
    "exclusiveMinimum": "above",
    "exclusiveMaximum": "below",
}


def _kind(given: dict[str, Any], whole: dict[str, Any]) -> str:
    if "$ref" in given:
        return "table"
    if "enum" in given:
        return ", ".join(f"`{_toml(x)}`" for x in given["enum"])
    if "const" in given:
        return f"`{_toml(given['const'])}`"
    if "anyOf" in given:
        kinds = [k for k in (_kind(part, whole) for part in given["anyOf"]) if k]
        return " or ".join(dict.fromkeys(kinds))
    kind = KINDS.get(given.get("type", ""), "any")
    if kind == "array" and isinstance(given.get("items"), dict):
        inner = _kind(given["items"], whole)
        kind = "array of tables" if inner == "table" else f"array of {inner or 'any'}"
    limits = [f"{word} {given[key]:g}" for key, word in LIMITS.items() if key in given]
    return ", ".join([kind, *limits])
