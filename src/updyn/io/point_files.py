"""FRFs in one file per measurement point, by a file name with fields: ``"point_{node}{axis}.csv"``.

A field matches an integer or a direction, such as X or -RZ. Its text replaces the field in the
options of the reader, such as the label ``"{node}:{axis}"`` of a channel.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from updyn.errors import DataError, FormatError
from updyn.frf import FRF
from updyn.io.items import is_file, is_folder, suggest_file
from updyn.signals.joining import joined_frfs

__all__ = [
    "PointFile",
    "find_point_files",
    "has_fields",
    "propose_pattern",
    "read_point_files",
]

_FIELD = re.compile(r"\{([A-Za-z_]\w*)\}")
_TEXT = r"\d+|[+-]?[Rr]?[XYZxyz]"
_POINT = re.compile(r"(\d+)([+-]?R?[XYZ](?![A-Za-z]))?", re.IGNORECASE)
_EXAMPLE = '"point_{node}.csv" for point_1.csv, point_2.csv'


@dataclass(frozen=True, slots=True)
class PointFile:
    """A file of a measurement point, and the text of each field in its name."""

    path: Path
    fields: Mapping[str, str]


def has_fields(path: str | Path) -> bool:
    """Return whether a file name has fields, and no file has this name."""
    if not isinstance(path, str | os.PathLike):  # reported by the search for a format
        return False
    return _FIELD.search(Path(path).name) is not None and not is_file(path)


def read_point_files(path: str | Path, read: Callable[..., FRF], options: Mapping[str, Any]) -> FRF:
    """Return the joined FRFs of all files that match a file name with fields.

    `read` reads one of them, with `options`. Raises FormatError if no file matches, one of them
    cannot be read, or their FRFs are not a complete matrix.
    """
    files = find_point_files(path)
    if not files:
        raise FormatError(
            "no file has such a name; a field in braces is an integer or a direction (X, -RZ), such"
            f" as {_EXAMPLE}; {suggest_file(Path(path))}",
            path,
        )
    frfs = [read(file.path, **_fill_fields(options, file.fields)) for file in files]
    try:
        return joined_frfs(frfs, [file.path.name for file in files])
    except DataError as error:
        raise FormatError(str(error), path) from error


def find_point_files(path: str | Path) -> list[PointFile]:
    """Return the files that match a file name with fields, sorted by their fields."""
    path = Path(path)
    pattern = _compile(path)
    names = [one.name for one in path.parent.iterdir()] if is_folder(path.parent) else []
    found = [
        PointFile(path.parent / name, {k: text.upper() for k, text in match.groupdict().items()})
        for name in names
        if (match := pattern.fullmatch(name)) and is_file(path.parent / name)
    ]
    return sorted(found, key=_order)


def propose_pattern(path: str | Path) -> Path | None:
    """Return a file name with fields that matches a file and most others of its folder.

    If several numbers match as many files, the last number is used. None if no other file differs
    from it by a number, or by a number and a direction.
    """
    path = Path(path)
    found: dict[Path, int] = {}
    for match in _POINT.finditer(path.stem):
        fields = "{node}{axis}" if match[2] else "{node}"
        name = f"{path.stem[: match.start()]}{fields}{path.stem[match.end() :]}{path.suffix}"
        pattern = path.with_name(name)
        found[pattern] = len(find_point_files(pattern))
    best = max(reversed(found), key=lambda pattern: found[pattern], default=None)
    return best if best is not None and found[best] > 1 else None


def _fill_fields(option: object, fields: Mapping[str, str]) -> Any:
    if isinstance(option, str):
        return _FIELD.sub(lambda match: fields.get(match[1], match[0]), option)
    if isinstance(option, Mapping):
        return {key: _fill_fields(value, fields) for key, value in option.items()}
    if isinstance(option, Sequence):
        return [_fill_fields(value, fields) for value in option]
    return option


def _compile(path: Path) -> re.Pattern[str]:
    """Return the regular expression of a file name with fields."""
    parts = _FIELD.split(path.name)
    names = parts[1::2]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise FormatError(f"the field {{{repeated}}} occurs twice; expected different names", path)
    texts = [re.escape(part) for part in parts]
    texts[1::2] = [f"(?P<{name}>{_TEXT})" for name in names]
    return re.compile("".join(texts))


def _order(file: PointFile) -> list[tuple[int, int, str]]:
    """Return the key by which files are sorted: integers by value, before directions."""
    return [(0, int(text), "") if text.isdigit() else (1, 0, text) for text in file.fields.values()]
