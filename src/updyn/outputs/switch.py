"""Atomic replacement of a set of files in a folder.

A complete set on disk with a plan of the switch, in ``.unfinished-ID``, is renamed to
``.finished-ID``. From then on it is valid, and its files are moved to their places. After a kill or
a power failure, the next process completes ``.finished-ID`` (`recover`) and removes
``.unfinished-ID``. Digests in the plan protect files that a user has put there in the meantime.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from updyn.errors import FormatError, InputError
from updyn.io.atomic import sync_folder, write_json
from updyn.outputs.lock import LOCK, InUseError, lock_folder
from updyn.outputs.manifest import (
    MANIFEST,
    Entry,
    Manifest,
    file_digest,
    find_obstacle,
    is_inside,
    is_output,
)

__all__ = ["PLAN", "create_folder", "open_folder", "recover", "replace_files"]

#: Name of the plan in the folder of a set, which distinguishes such a folder from a user's.
PLAN = ".updyn.switch"
#: Suffix of the files that save the work in progress.
_JOURNAL = ".journal"
_NAME = re.compile(r"\.(unfinished|finished)-[0-9a-f]{16}")


# -- the folder ------------------------------------------------------------------------------------
@contextmanager
def open_folder(folder: Path) -> Iterator[None]:
    """Create a folder if missing, lock it, and complete an interrupted switch in it.

    If the block raises, the folder and its parents are removed again, if they were created here and
    are empty.
    """
    with create_folder(folder), lock_folder(folder):
        _recover(folder)
        yield


@contextmanager
def create_folder(folder: Path) -> Iterator[None]:
    """Create a folder and its parents; if the block raises, remove those of them that are empty."""
    created = [path for path in (folder, *folder.absolute().parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as undo:
        undo.callback(_remove_empty, created)
        yield
        undo.pop_all()


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, innermost first, up to the first that is not empty."""
    with suppress(OSError):  # not empty: it holds the journal of an interrupted run
        for folder in folders:
            folder.rmdir()


# -- a new set -------------------------------------------------------------------------------------
@contextmanager
def replace_files(folder: Path, command: str, names: Collection[str] = ()) -> Iterator[Path]:
    """Yield a folder to write a set of files to; at the end, they replace the old set together.

    `names` are in the order in which the files appear; one that is not written is removed from
    `folder`, and other files that are written belong to the set, too.
    """
    run = secrets.token_hex(8)
    staging = folder / f".unfinished-{run}"
    staging.mkdir()
    try:
        (staging / PLAN).touch()
        yield staging
        _commit(staging, folder, run, command, names)
    finally:
        if staging.is_dir():
            _discard(staging)


@dataclass(frozen=True, slots=True)
class _Plan:
    """The plan of a switch to a new set of files.

    `moved` has the digests of the old file (None if missing) and the new file, `removed` of the
    old.
    """

    moved: dict[str, list[str | None]]
    removed: dict[str, str]


def _commit(staging: Path, folder: Path, run: str, command: str, names: Collection[str]) -> None:
    """Move the files of a complete set to their places."""
    found = [p.relative_to(staging).as_posix() for p in staging.rglob("*") if p.is_file()]
    written = [name for name in names if name in found]
    written += sorted(set(found) - {*names, PLAN})
    digests = {name: file_digest(staging / name) for name in written}
    old = Manifest.read(folder)
    absent = [name for name in dict.fromkeys(names) if name not in digests]
    kept = {name: entry for name, entry in old.entries.items() if name not in absent}
    new = {name: Entry(digest, run, command) for name, digest in digests.items()}
    Manifest(MappingProxyType({**kept, **new})).write(staging)

    obstacles = {name: why for name in written if (why := old.find_obstacle(folder, name))}
    if obstacles:
        _set_aside(staging, folder, run, new, obstacles)
    digests = {MANIFEST: file_digest(staging / MANIFEST), **digests}
    before = {name: _compute_digest(folder / name) for name in (*digests, *absent)}
    plan = _Plan(
        {name: [before[name], digest] for name, digest in digests.items()},
        {
            name: digest
            for name in absent
            if (digest := before[name]) and not old.find_obstacle(folder, name)
        },
    )
    write_json(asdict(plan), staging / PLAN)
    _sync_files(staging)
    finished = staging.rename(folder / f".finished-{run}")
    sync_folder(folder)
    _complete_switch(finished, folder, plan)


def _set_aside(
    staging: Path, folder: Path, run: str, new: dict[str, Entry], obstacles: dict[str, str]
) -> None:
    """Move a set that cannot replace the old one to a separate folder, and raise an error."""
    aside = folder / f"results-{run}"
    Manifest(MappingProxyType(new)).write(staging)
    staging.rename(aside)
    (aside / PLAN).unlink()
    reasons = ", ".join(f"{name!r} {why}" for name, why in obstacles.items())
    raise InputError(f"in {str(folder)!r} {reasons}; the results are in {str(aside)!r} instead")


def _compute_digest(path: Path) -> str | None:
    """Return the digest of a file; None if there is no file."""
    return file_digest(path) if path.is_file() else None


def _sync_files(folder: Path) -> None:
    """Flush the files of a folder and its subfolders to disk."""
    for path in folder.rglob("*"):
        if path.is_dir():
            sync_folder(path)
        else:
            with path.open("rb+") as file:
                os.fsync(file.fileno())
    sync_folder(folder)


# -- the switch ------------------------------------------------------------------------------------
def _complete_switch(finished: Path, folder: Path, plan: _Plan) -> None:
    """Move and remove the files of a plan, as far as not yet done."""
    touched = {folder}
    for name in plan.moved:
        source, target = finished / name, folder / name
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            source.replace(target)
            touched.add(target.parent)
    for name, digest in plan.removed.items():
        if not find_obstacle(folder, name, [digest]):
            (folder / name).unlink(missing_ok=True)
            touched.add((folder / name).parent)
    for each in touched - {folder}:
        _remove_empty([each])
    for each in touched:
        if each.is_dir():
            sync_folder(each)
    for path in filter(Path.is_dir, finished.iterdir()):
        _remove_empty([path])
    (finished / PLAN).unlink()
    _remove_empty([finished])
    sync_folder(folder)


def recover(folder: Path) -> None:
    """Complete or remove the switches that killed processes did not finish in a folder."""
    found = list(_find_interrupted(folder)) if folder.is_dir() else []
    if not found:
        return
    try:
        with lock_folder(folder):
            _recover(folder)
    except InUseError:
        if any(path.name.startswith(".finished-") for path in found):
            raise


def _find_interrupted(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if _NAME.fullmatch(path.name) and path.is_dir() and not path.is_symlink():
            yield path


def _recover(folder: Path) -> None:
    """Complete or remove interrupted switches in a locked folder."""
    for path in sorted(_find_interrupted(folder)):
        if not (path / PLAN).is_file():
            _remove_empty([path])  # an empty folder may be ours; keep any other
        elif path.name.startswith(".unfinished-"):
            _discard(path)
        else:
            plan = _read_plan(path)
            _check_user_files(path, folder, plan)
            removed = {name: digest for name, digest in plan.removed.items() if is_output(name)}
            _complete_switch(path, folder, _Plan(plan.moved, removed))


def _discard(staging: Path) -> None:
    """Remove the folder of a set; its plan, which identifies it, is removed last."""
    for path in staging.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != PLAN:
            path.unlink()
    (staging / PLAN).unlink(missing_ok=True)
    staging.rmdir()


def _read_plan(finished: Path) -> _Plan:
    path = finished / PLAN
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        plan = _Plan(**content)
        usable = all(map(_is_free, (*plan.moved, *plan.removed)))
        usable = usable and all(map(_is_pair, plan.moved.values()))
    except (OSError, ValueError, RecursionError, TypeError, AttributeError) as error:
        raise FormatError(
            f"is not a plan of a switch; move {str(finished)!r} away", path
        ) from error
    if not usable or any(each.is_symlink() for each in finished.rglob("*")):
        raise FormatError(f"is not a plan of a switch; move {str(finished)!r} away", path)
    return plan


def _is_pair(digests: object) -> bool:
    """Return whether a value is a list of an old digest (or None) and a new one."""
    return isinstance(digests, list) and list(map(type, digests)) in ([type(None), str], [str, str])


def _is_free(name: str) -> bool:
    """Return whether a name is inside a folder and not reserved for lock, plan, set or journal."""
    parts = name.split("/")
    reserved = any(part in (LOCK, PLAN) or _NAME.fullmatch(part) for part in parts)
    return is_inside(name) and not reserved and not name.endswith(_JOURNAL)


def _check_user_files(finished: Path, folder: Path, plan: _Plan) -> None:
    """Check that no user's file has appeared under a name of an interrupted switch."""
    # The plan may be forged: its digests of old files are accepted only for the fixed names of
    # outputs (`is_output`) and for the manifest.
    obstacles: dict[str, str] = {}
    for name, (before, after) in plan.moved.items():
        if (finished / name).is_file():
            known = (before, after) if is_output(name) or name == MANIFEST else (after,)
            obstacles[name] = find_obstacle(folder, name, [d for d in known if d])
    reasons = ", ".join(f"{name!r} {why}" for name, why in obstacles.items() if why)
    if reasons:
        raise InputError(
            f"in {str(folder)!r} {reasons}, and new results are in {str(finished)!r}; move the file"
            " or that folder away"
        )
