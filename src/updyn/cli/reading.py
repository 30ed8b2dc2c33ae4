"""`read_anything`: a file of unknown content, such as a measurement, a model or modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from updyn.cli.describe import (
    describe_contents,
    describe_frf,
    describe_geometry,
    describe_model,
    describe_modes,
    describe_records,
)
from updyn.errors import AbsentError, FormatError, InputError
from updyn.io import (
    read_contents,
    read_frf,
    read_geometry,
    read_model,
    read_modes,
    read_records,
)
from updyn.io.formats import FORMATS, find_format
from updyn.io.items import is_file
from updyn.io.point_files import has_fields
from updyn.registry import Registry

__all__ = ["FILE_KINDS", "FileKind", "read_anything"]


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of content of a file.

    Parameters
    ----------
    noun : str
        Name with its article, for messages: ``"a model"``.
    read : callable
        Takes the path and options by keyword, and returns the content.
    describe : callable
        Takes the content and returns it as text, for ``updyn info``.
    recognises : callable
        Takes the path and returns whether the start or suffix of the file fit this kind. For an
        unreadable file only the messages of such kinds are shown.
    other : str
        Text of an `InputError` that identifies other content.
    allows_others : bool
        Whether files may contain other kinds in addition; it is then not the result if one of these
        is present but damaged.
    is_tried : bool
        Whether to try reading a file that is not recognised.
    """

    noun: str
    read: Callable[..., Any]
    describe: Callable[[Any], str]
    recognises: Callable[[Path], bool] = lambda path: False
    other: str = ""
    allows_others: bool = False
    is_tried: bool = True


def _make_format_test(verb: str) -> Callable[[Path], bool]:
    """Return a function that returns whether a format of `updyn.io` fits a file."""

    def fits(path: Path) -> bool:
        try:
            find_format(path, verb)
        except FormatError:
            return False
        return True

    return fits


def _is_of_records(path: Path) -> bool:
    """Return whether the format of a file contains only time records."""
    try:
        return find_format(path, "read_records").can == ("read_records",)
    except FormatError:
        return False


def _is_of_geometry(path: Path) -> bool:
    """Return whether the suffix of a file belongs to a format that contains only a geometry."""
    try:
        found = find_format(path, "read_geometry")
    except FormatError:
        return False
    return found.can == ("read_geometry",) and path.suffix.lower() in found.suffixes


#: Kinds of content by name, in the order of trials. Another package adds one by
#: ``FILE_KINDS.register``, or an entry point of the group ``updyn.file_kinds``.
FILE_KINDS: Registry[FileKind] = Registry(
    "kind of file",
    "updyn.file_kinds",
    {
        "written": "updyn.cli.written:WRITTEN",
        "contents": FileKind(
            "contents of several kinds",
            read_contents,
            describe_contents,
            _make_format_test("read_contents"),
            is_tried=False,
        ),
        "frf": FileKind("a measurement", read_frf, describe_frf, _make_format_test("read_frf")),
        "model": FileKind("a model", read_model, describe_model, _make_format_test("read_model")),
        "result": "updyn.cli.result_file:RESULT",
        "uncertainty": "updyn.cli.uncertainty:UNCERTAINTY",
        "records": FileKind(
            "time records", read_records, describe_records, _is_of_records, allows_others=True
        ),
        "modes": FileKind(
            "modes", read_modes, describe_modes, _make_format_test("read_modes"), allows_others=True
        ),
        "geometry": FileKind(
            "a geometry", read_geometry, describe_geometry, _is_of_geometry, allows_others=True
        ),
        "plant": "updyn.control.files.description:PLANT",
        "coherence": "updyn.cli.coherence:COHERENCE",
    },
)


def read_anything(
    path: str | Path,
    kinds: Sequence[str] | None = None,
    options: Mapping[str, Mapping[str, object]] | None = None,
) -> tuple[str, Any]:
    """Return the name and the content of the first kind that a file contains.

    `kinds` are names in `FILE_KINDS` in the order of trials, `options` arguments of the reader by
    kind. If the file contains none, a `FormatError` gives the reason for each kind.
    """
    path, options = Path(path), options or {}
    if has_fields(path) and (kinds is None or "frf" in kinds):
        return "frf", FILE_KINDS["frf"].read(path, **options.get("frf", {}))
    if not is_file(path) or path.stat().st_size == 0:
        find_format(path, "read_frf")  # raises an error, with the nearest name of a missing file
    if kinds is None:
        kinds = tuple(FILE_KINDS)
    reasons: dict[str, InputError] = {}
    for kind in kinds:
        if FILE_KINDS[kind].allows_others and _find_damaged_kinds(path, reasons):
            continue
        if not (FILE_KINDS[kind].is_tried or FILE_KINDS[kind].recognises(path)):
            continue
        try:
            return kind, FILE_KINDS[kind].read(path, **options.get(kind, {}))
        except InputError as error:
            reasons[kind] = error
    shown = _find_likely_kinds(path, reasons) or list(reasons)
    if len(shown) > 1 and not any(FILE_KINDS[kind].recognises(path) for kind in kinds):
        known = sorted(set(chain.from_iterable(f.suffixes for f in FORMATS.values())))
        nouns = [FILE_KINDS[kind].noun for kind in shown]
        raise FormatError(
            f"neither content nor suffix {path.suffix!r} is of a known format of"
            f" {', '.join(nouns[:-1])} or {nouns[-1]}; known suffixes: {', '.join(known)}",
            path,
        )
    if len(shown) == 1:
        raise reasons[shown[0]]
    why = "".join(f"\n  as {FILE_KINDS[k].noun}: {_without_path(reasons[k])}" for k in shown)
    raise FormatError(f"could not be read{why}", path)


def _find_damaged_kinds(path: Path, reasons: Mapping[str, InputError]) -> list[str]:
    """Return the kinds that a file appears to contain but that cannot be read."""
    return [
        kind
        for kind, error in reasons.items()
        if isinstance(error, FormatError)
        and not isinstance(error, AbsentError)
        and FILE_KINDS[kind].recognises(path)
    ]


def _find_likely_kinds(path: Path, reasons: Mapping[str, InputError]) -> list[str]:
    found = [kind for kind in reasons if FILE_KINDS[kind].recognises(path)]
    found = [k for k in found if not isinstance(reasons[k], AbsentError)] or found
    if len(found) == 1:
        return found
    likely = []
    for kind in found:
        other = FILE_KINDS[kind].other
        if not other or other not in str(reasons[kind]):
            likely.append(kind)
    return likely


def _without_path(error: InputError) -> str:
    """Return the message of an error without the path in front."""
    path = getattr(error, "path", None)
    return str(error).removeprefix(f"{path}:").strip()
