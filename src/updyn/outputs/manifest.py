"""``manifest.json``: the files that updyn wrote into a folder, and may therefore replace."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import MappingProxyType
from typing import Any

from updyn import __version__
from updyn.errors import FormatError
from updyn.io.atomic import write_json

__all__ = [
    "MANIFEST",
    "OUTPUT_NAMES",
    "Entry",
    "Manifest",
    "file_digest",
    "find_obstacle",
    "find_obstacles",
    "is_inside",
    "is_output",
]

#: Name of the manifest.
MANIFEST = "manifest.json"
#: Fixed names of the files that commands write into a results folder or a test's folder in it. A
#: manifest can be copied or forged, so files with other names are never removed because of it.
OUTPUT_NAMES = frozenset(
    {
        "model.h5",
        "run.nc",
        "report.html",
        "job.toml",
        "result.json",
        "uncertainty.nc",
        "check.html",
        "correlate.html",
        "compare.html",
        "compare.json",
        "modes.html",
        "modes.unv",
        "acceptance.html",
        "population.json",
        "levels.json",
        "modes-updated.nc",
        "modes-updated.unv",
        "modes-expanded.nc",
        "modes-expanded.unv",
        "plan.html",
        "plan.json",
        "plant.html",
        "control.json",
        *(
            f"plant{at}{kind}"
            for at in ("", "-sampled")
            for kind in (".mat", ".json", ".h", ".npz")
        ),
    }
)
#: Largest number of folders above an output: the folder of a test.
_DEEPEST = 1
FORMAT, SCHEMA = "updyn manifest", 1
_ABOUT = (
    "Files that updyn wrote into this folder, and may replace while their SHA-256 digest is the"
    " same. Keep this file in the same folder."
)


@dataclass(frozen=True, slots=True)
class Entry:
    """A file that updyn wrote: digest of its content, id of the run, and command."""

    sha256: str
    run: str
    command: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """The files that updyn wrote into a folder, by path relative to the folder, with slashes."""

    entries: Mapping[str, Entry] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """Return the manifest of a folder, empty without a file; `FormatError` if it is invalid."""
        path = folder / MANIFEST
        if not path.exists() and not path.is_symlink():
            return cls()
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            entries = {name: Entry(**entry) for name, entry in _read_files(content).items()}
        except (OSError, ValueError, RecursionError, TypeError) as error:
            raise FormatError(
                f"is not a manifest of the files that updyn wrote ({_describe_error(error)});"
                " move it, or choose another folder",
                path,
            ) from error
        return cls(MappingProxyType(entries))

    def write(self, folder: Path) -> None:
        """Write the manifest into a folder."""
        files = {}
        for name in sorted(self.entries):
            entry = self.entries[name]
            files[name] = {"run": entry.run, "command": entry.command, "sha256": entry.sha256}
        content = {
            "format": FORMAT,
            "schema": SCHEMA,
            "about": _ABOUT,
            "updyn": __version__,
            "files": files,
        }
        write_json(content, folder / MANIFEST)

    def find_obstacle(self, folder: Path, name: str) -> str:
        """Return the reason why a file must not be replaced or removed; empty if it may."""
        entry = self.entries.get(name)
        return find_obstacle(folder, name, () if entry is None else (entry.sha256,))


def _read_files(content: object) -> Mapping[str, Any]:
    """Return the table of files of a manifest; `ValueError` if it is not one."""
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"expected 'format': {FORMAT!r}")
    if content.get("schema") != SCHEMA:
        raise ValueError(f"schema {content.get('schema')!r}; this version of updyn writes {SCHEMA}")
    files = content.get("files")
    if not isinstance(files, dict) or not all(map(is_inside, files)):
        raise ValueError("expected 'files' of this folder, by name")
    for name, entry in files.items():
        if not isinstance(entry, dict) or not all(isinstance(v, str) for v in entry.values()):
            raise ValueError(f"expected run, command and sha256 of {name!r}")
    return files


def _describe_error(error: Exception) -> str:
    """Return a short description of a read error."""
    if isinstance(error, OSError):
        return str(error.strerror)
    return str(error) or type(error).__name__


def is_inside(name: str) -> bool:
    """Return whether a name (with slashes) is a plain path inside a folder."""
    parts = PurePosixPath(name).parts
    plain = bool(parts) and ".." not in parts and not PurePosixPath(name).is_absolute()
    return plain and not PureWindowsPath(name).anchor and "\\" not in name and "\0" not in name


def is_output(name: str) -> bool:
    """Return whether a path in a results folder has a fixed output name of the commands."""
    *folders, last = name.split("/")
    plain = is_inside(name) and len(folders) <= _DEEPEST and not name.startswith(".")
    return plain and last in OUTPUT_NAMES


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def find_obstacle(folder: Path, name: str, digests: Iterable[str]) -> str:
    """Return why a file, unless its digest is in `digests`, must not be replaced; else empty."""
    path = folder / name
    for parent in reversed(PurePosixPath(name).parents[:-1]):
        above = folder / parent
        if above.is_symlink() or (above.exists() and not above.is_dir()):
            return f"{parent.as_posix()!r} is not a folder"
    if path.is_symlink():
        return "is a link"
    if not path.exists():
        return ""
    if not path.is_file():
        return "is a folder"
    known = tuple(digests)
    if not known:
        return "was not written by updyn"
    try:
        same = file_digest(path) in known
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return "" if same else "has been changed since updyn wrote it"


def find_obstacles(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the reasons by name for the files of a folder that must not be replaced."""
    manifest = Manifest.read(folder)
    reasons = {name: manifest.find_obstacle(folder, name) for name in names}
    return {name: why for name, why in reasons.items() if why}
