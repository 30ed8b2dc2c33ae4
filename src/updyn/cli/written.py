"""Files that the commands write besides data: results as JSON, pages, headers, journals."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from updyn.cli.reading import FileKind
from updyn.cli.settings import DESCRIPTION
from updyn.errors import FormatError
from updyn.outputs.manifest import FORMAT, Manifest, file_digest
from updyn.text_table import text_table

__all__ = ["WRITTEN"]

_TITLE = re.compile(r"<title>([^<]*)</title>")
_JOURNAL = "updyn journal "

Content = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _JsonKind:
    """A kind of JSON file: the keys by which it is recognised, and its description."""

    keys: tuple[str, ...]
    describe: Callable[[Content, Path], str]


# -- JSON ------------------------------------------------------------------------------------------
def _describe_result(content: Content, path: Path) -> str:
    rows = []
    for one in content["parameters"]:
        note = f"on the {one['bound']} bound" if one["bound"] else ""
        if not one["identifiable"]:
            note = "not determined"
        rows.append(
            [one["name"], *(_format_number(one[k]) for k in ("start", "value", "std")), note]
        )
    return "\n".join(
        [
            f"Result of an update, {content['title']!r}: {content['status']} ({content['method']})",
            *filter(None, [content["message"], content["remedy"]]),
            "",
            text_table(("unknown", "start", "value", "std", "note"), rows),
            "",
            _refer_to(path, "run.nc", "updyn info prints its summary"),
        ]
    )


def _describe_manifest(content: Content, path: Path) -> str:
    entries = Manifest.read(path.parent).entries
    rows = []
    for name, entry in entries.items():
        file = path.parent / name
        state = "missing"
        if file.is_file():
            state = "unchanged" if file_digest(file) == entry.sha256 else "changed since"
        rows.append([name, entry.command, state])
    head = f"Files that updyn wrote into {str(path.parent)!r}:"
    return "\n".join([head, text_table(("file", "command", "state"), rows, left=(0, 1, 2))])


def _describe_control(content: Content, path: Path) -> str:
    plant, (low, high) = content["plant"], content["band"]
    texts = [
        f"Plant for control design, {content['title']!r}, {low:g} to {high:g} Hz",
        content["source"],
    ]
    if plant is None:
        texts.append(content["message"])
    else:
        texts.append(
            f"order {plant['order']}, largest relative error {plant['relative_error']:.3g}"
            f" (requested: {content['tolerance']:g})"
        )
    return "\n".join([*texts, _refer_to(path, "plant.html", "the same as a page")])


def _describe_comparison(content: Content, path: Path) -> str:
    rows = [[row["method"], row["status"], row["message"]] for row in content["rows"]]
    return "\n".join(
        [
            f"Comparison of methods, {content['title']!r}, {len(content['unknowns'])} unknowns",
            text_table(("method", "status", "message"), rows, left=(0, 1, 2)),
            _refer_to(path, "compare.html", "the same as a page"),
        ]
    )


def _describe_candidates(content: Content, path: Path) -> str:
    rows = [
        [one["name"], one["status"], _format_number(one["log_evidence"])]
        for one in content["candidates"]
    ]
    return "\n".join(
        [
            f"Comparison of models, {content['title']!r}: {content['statement']}",
            text_table(("candidate", "status", "log evidence"), rows, left=(0, 1)),
            _refer_to(path, "compare.html", "the same as a page"),
        ]
    )


def _describe_location(content: Content, path: Path) -> str:
    rows = [
        [one["place"], one["kind"], _format_number(one["log_evidence"])]
        for one in content["elements"]
    ]
    return "\n".join(
        [
            f"Location of a nonlinear element: {content['statement']}",
            text_table(("place", "kind", "log evidence"), rows, left=(0, 1)),
            _refer_to(path, "compare.html", "the same as a page"),
        ]
    )


def _describe_elements(content: Content, path: Path) -> str:
    rows = [
        [one["place"], one["kind"], _format_number(one["log_odds"])] for one in content["found"]
    ]
    return "\n".join(
        [
            f"Location of nonlinear elements: {content['statement']}",
            text_table(("place", "kind", "log odds"), rows, left=(0, 1)),
            _refer_to(path, "compare.html", "the same as a page"),
        ]
    )


def _describe_plan(content: Content, path: Path) -> str:
    rows = [[one["name"], _format_number(one["std"])] for one in content["parameters"]]
    return "\n".join(
        [
            f"Test plan, {content['title']!r}",
            f"responses: {', '.join(content['responses'])}",
            f"references: {', '.join(content['references'])}",
            text_table(("unknown", "expected std"), rows),
            _refer_to(path, "plan.html", "the same as a page"),
        ]
    )


_JSON = (
    _JsonKind(("status", "method", "parameters"), _describe_result),
    _JsonKind(("plant", "conversions", "band"), _describe_control),
    _JsonKind(("rows", "unknowns", "stopped"), _describe_comparison),
    _JsonKind(("criterion", "candidates", "bands"), _describe_candidates),
    _JsonKind(("statement", "elements", "places"), _describe_location),
    _JsonKind(("statement", "found", "further"), _describe_elements),
    _JsonKind(("criterion", "responses", "references"), _describe_plan),
)


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def _refer_to(path: Path, name: str, what: str) -> str:
    """Return a reference to a file in the same folder; empty if there is no such file."""
    return f"{path.with_name(name)}: {what}" if path.with_name(name).is_file() else ""


def _describe_json(content: Content, path: Path) -> str:
    if content.get("format") == FORMAT:
        return _describe_manifest(content, path)
    for kind in _JSON:
        if all(key in content for key in kind.keys):
            try:
                return kind.describe(content, path).rstrip()
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                raise FormatError(
                    f"has the keys {_format_keys(kind.keys)} of a file of updyn, but not its"
                    f" content ({type(error).__name__}: {error})",
                    path,
                ) from error
    raise FormatError(
        "is JSON, but none of the files that updyn writes; its keys:"
        f" {_format_keys(list(content)) or 'none'}",
        path,
    )


def _format_keys(keys: Sequence[str]) -> str:
    most = DESCRIPTION.listed_items
    return ", ".join(map(repr, keys[:most])) + (", ..." if len(keys) > most else "")


def _read_json(path: Path) -> Any:
    """Return the content of a JSON file; None if it is not JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


# -- pages, headers, journals ----------------------------------------------------------------------
def _describe_page(path: Path) -> str:
    start = _read_start(path)
    title = _TITLE.search(start)
    if 'name="generator" content="updyn' not in start:
        raise FormatError("is a page of another program; updyn reads no HTML", path)
    name = "" if title is None else f" {html.unescape(title[1])!r}"
    return f"Page of updyn{name}: open it in a browser; it needs no network"


def _describe_header(path: Path) -> str:
    comment = _read_start(path).partition("*/")[0]
    lines = [line.strip(" /*") for line in comment.splitlines()]
    texts = ["C99 header of a plant", *filter(None, lines)]
    return "\n".join([*texts, _refer_to(path, "plant.json", "the same, exactly")]).rstrip()


def _describe_journal(path: Path) -> str:
    command = "plan" if path.name.startswith("plan") else "run"
    return (
        f"Journal of an unfinished {command}: updyn {command} JOB.toml --resume (with the same"
        " --out) goes on from it"
    )


def _read_start(path: Path) -> str:
    """Return the first characters of a file."""
    with path.open("rb") as file:
        return file.read(DESCRIPTION.start_bytes).decode("utf-8", errors="replace")


def _find_describer(path: Path) -> Callable[[Path], str] | None:
    """Return the function that describes a file; None if commands write no such file."""
    start, suffix = _read_start(path), path.suffix.lower()
    if start.startswith(_JOURNAL):
        return _describe_journal
    if suffix in (".html", ".htm") or start.lstrip().lower().startswith("<!doctype html"):
        return _describe_page
    if suffix == ".h" and "written by updyn" in start.partition("*/")[0]:
        return _describe_header
    if suffix == ".json" and isinstance(content := _read_json(path), Mapping):
        is_plant = content.get("format") == "updyn plant"
        return None if is_plant else partial(_describe_json, content)
    return None


def _is_written(path: Path) -> bool:
    try:
        return _find_describer(path) is not None
    except OSError:
        return False


def _describe_file(path: Path) -> str:
    describe = _find_describer(path)
    assert describe is not None
    return describe(path)


#: The content of such a file is its description.
WRITTEN = FileKind("a file that updyn writes", _describe_file, str, _is_written, is_tried=False)
