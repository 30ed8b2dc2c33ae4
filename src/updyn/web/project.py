"""`Project`: the folder that is worked in; no path outside it is read or written."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from updyn.errors import FormatError, InputError, UpdynError
from updyn.foreign.confinement import resolve_path
from updyn.io.atomic import write_bytes
from updyn.job.files import check_encodable, is_encodable
from updyn.job.folder import HEADER, JOB_FILE, is_run_job
from updyn.outputs.manifest import MANIFEST, Manifest, is_output
from updyn.web.settings import WEB_LIMIT

__all__ = ["Project", "RunFolder", "describe_error", "hide_folder"]

_NAME = re.compile(r"[^\W.][\w.+ -]*")
_RESULT = "result.json"
_JOB, _JOURNAL = ".toml", ".journal"
_NEW_JOB = "job.toml"
#: What no job names, and what changes while a run is under way.
_NO_INPUT = (_JOB, _JOURNAL, MANIFEST)
#: First line of the job file of a run, and the number of its characters that are read.
_ORIGIN = re.compile(rf"# {HEADER} \S+ from (.+)")
#: The command that writes inputs; the others write results.
_OF_INPUTS = "demo"


@dataclass(frozen=True, slots=True)
class RunFolder:
    """A folder of results, with the content of its ``result.json`` and its time (s since 1970)."""

    path: Path
    record: dict[str, Any]
    modified: float


class Project:
    """A folder, which exists, with jobs, inputs and results.

    An `InputError` is raised if UTF-8 cannot encode its name, which pages show.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        check_encodable(str(self.folder))

    def inside(self, name: str | Path) -> Path:
        """Return a path of the project without links; `InputError` if it leads outside."""
        if "\0" in str(name):
            raise InputError("a name of a file holds a zero byte")
        path = resolve_path(self.folder / name)
        if not path.is_relative_to(self.folder):
            raise InputError(f"{str(name)!r} leads out of the folder of the project")
        return path

    def name_of(self, path: Path) -> str:
        """Return a path relative to the folder of the project, with forward slashes."""
        return path.relative_to(self.folder).as_posix()

    def title_of(self, folder: Path) -> str:
        """Return the name of a folder as pages show it."""
        return self.folder.name if folder == self.folder else self.name_of(folder)

    def jobs(self) -> list[Path]:
        """Return the job files: TOML files that no run wrote, the latest first."""
        found = []
        for folder, names in self._walk_folders():
            jobs = [folder / name for name in names if name.lower().endswith(_JOB)]
            if _RESULT in names:
                jobs = [path for path in jobs if not _is_run_job_file(path)]
            found += jobs
        return sorted(found, key=_modified_time, reverse=True)

    def inputs(self) -> list[Path]:
        """Return the files that a job could name: all but results and job files."""
        found, results = [], set[Path]()
        for folder, names in self._walk_folders():
            results |= _find_results(folder, names)
            found += [folder / n for n in names if not n.lower().endswith(_NO_INPUT)]
        return sorted(path for path in found if path not in results)

    def stamp(self) -> tuple[tuple[str, int, int], ...]:
        """Return names, times and sizes of inputs, and of results (a job may start from one)."""
        found = []
        for folder, names in self._walk_folders():
            for name in names:
                if name.endswith(_NO_INPUT):
                    continue
                try:
                    state = (folder / name).stat()
                except OSError:
                    continue
                found.append((str(folder / name), state.st_mtime_ns, state.st_size))
        return tuple(sorted(found))

    def runs(self) -> list[RunFolder]:
        """Return the folders of results, the latest first; damaged records are left out."""
        folders = [folder for folder, names in self._walk_folders() if _RESULT in names]
        found = [run for run in map(_read_run, folders) if run is not None]
        return sorted(found, key=lambda run: run.modified, reverse=True)

    def run(self, folder: Path) -> RunFolder | None:
        """Return the results in a folder; None if there are none."""
        return _read_run(self.inside(folder))

    def runs_of(self, job: Path) -> list[RunFolder]:
        """Return the runs whose job file is `job` or names it, the latest first."""
        return [run for run in self.runs() if job in (run.path / JOB_FILE, _find_job(run.path))]

    def pages(self, page: str, command: str) -> list[Path]:
        """Return the files `page` that a command has written, the latest first."""
        found = []
        for folder, names in self._walk_folders():
            if page in names and MANIFEST in names:
                with suppress(FormatError):
                    entry = Manifest.read(folder).entries.get(page)
                    found += [folder / page] if entry and entry.command == command else []
        return sorted(found, key=_modified_time, reverse=True)

    def free_name(self, stem: Path, suffix: str = "") -> Path:
        """Return a path for results that does not exist, from its stem and suffix."""
        number, path = 1, stem.with_name(stem.name + suffix)
        while os.path.lexists(path):
            number += 1
            path = stem.with_name(f"{stem.name}{suffix}-{number}")
        return path

    def free_job_name(self) -> str:
        """Return the name of a job that does not exist in the folder of the project."""
        number, name = 1, _NEW_JOB
        while os.path.lexists(self.folder / name):
            number += 1
            name = Path(_NEW_JOB).stem + f"-{number}{_JOB}"
        return name

    def new_job(self, name: str) -> Path:
        """Return the path of a new job, with or without ``.toml`` in `name`.

        An `InputError` is raised if the name is not plain, its folder does not exist or is not
        shown, or the file exists.
        """
        folder, _, stem = name.strip().rpartition("/")
        file = self.plain_name(stem)
        file = self.plain_name(file if file.lower().endswith(_JOB) else file + _JOB)
        path = self.inside(Path(folder, file))
        parts = path.parent.relative_to(self.folder).parts
        if len(parts) > WEB_LIMIT.folder_depth or not all(map(_is_listed, parts)):
            raise InputError(f"{name!r}: a job in this folder is not shown; choose another folder")
        if not path.parent.is_dir():
            raise InputError(f"{name!r}: no such folder {folder!r}; make it first")
        if os.path.lexists(path):
            raise InputError(f"{self.name_of(path)}: exists already; choose another name")
        return path

    def plain_name(self, name: str) -> str:
        """Return a file name; `InputError` if it is not plain, such as one with a folder."""
        most = WEB_LIMIT.name_bytes
        if not _NAME.fullmatch(name) or len(name.encode()) > most:
            raise InputError(
                f"{name!r} cannot be the name of a file here: expected at most {most}"
                " letters, digits, blanks, dots and - _ +, a letter or digit first"
            )
        return name

    def keep_upload(self, name: str, content: bytes) -> Path:
        """Write an uploaded file, unless it is there; InputError if its name cannot be used."""
        path = self.folder / self.plain_name(name)
        is_known = path.is_file() and not path.is_symlink()
        if is_known and path.stat().st_size == len(content) and path.read_bytes() == content:
            return path
        if name.lower() in (_RESULT, MANIFEST) or name.lower().endswith(_JOURNAL):
            raise InputError(f"{name}: commands write results under this name; rename the file")
        if os.path.lexists(path):
            raise InputError(f"{name}: there is such a file already; rename one of the two")
        write_bytes(path, content)
        return path

    def _walk_folders(self) -> Iterator[tuple[Path, list[str]]]:
        """Yield folders with the names of their files, to a limited depth and number.

        Hidden files are omitted, and names that UTF-8 cannot encode, which no page can show.
        """
        for number, (folder, folders, names) in enumerate(os.walk(self.folder)):
            if number >= WEB_LIMIT.most_folders:
                return
            path = Path(folder)
            deep = len(path.relative_to(self.folder).parts) >= WEB_LIMIT.folder_depth
            folders[:] = [] if deep else sorted(filter(_is_listed, folders))
            yield path, sorted(filter(_is_listed, names))


def hide_folder(text: str, folder: Path) -> str:
    """Return a message with paths in a folder relative to it, and the folder as its name."""
    return text.replace(f"{folder}{os.sep}", "").replace(str(folder), folder.name)


def describe_error(error: UpdynError | OSError) -> str:
    """Return the message of an error, with the names of files in place of their paths."""
    if isinstance(error, OSError):
        named, text = error.filename, f"{error.filename}: {error.strerror or error}"
    else:
        named, text = getattr(error, "path", None), str(error)
    return text if named is None else text.replace(str(named), Path(str(named)).name)


def _find_results(folder: Path, names: list[str]) -> set[Path]:
    """Return the files of a folder, and of the folders in it, that hold results."""
    if MANIFEST in names:
        with suppress(FormatError):
            entries = Manifest.read(folder).entries
            return {
                folder / name
                for name, entry in entries.items()
                if entry.command != _OF_INPUTS and is_output(name)
            }
    return {folder / name for name in names} if _RESULT in names else set()


def _read_run(folder: Path) -> RunFolder | None:
    path = folder / _RESULT
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or not isinstance(record.get("status"), str):
        return None
    return RunFolder(folder, record, _modified_time(path))


def _find_job(folder: Path) -> Path | None:
    """Return the job file of a run; None if that is not known."""
    try:
        with (folder / JOB_FILE).open(encoding="utf-8") as lines:
            found = _ORIGIN.fullmatch(lines.readline(WEB_LIMIT.line_characters).rstrip("\n"))
        return None if found is None else resolve_path(folder / found[1])
    except (OSError, UnicodeDecodeError, InputError):
        return None


def _is_run_job_file(path: Path) -> bool:
    """Return whether a run wrote a job file; one that cannot be read is a user's."""
    try:
        return is_run_job(path)
    except OSError:
        return False


def _is_listed(name: str) -> bool:
    return not name.startswith(".") and is_encodable(name)


def _modified_time(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
