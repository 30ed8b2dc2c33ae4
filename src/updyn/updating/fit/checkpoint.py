"""Checkpoint of a run: a file of its evaluations, from which an interrupted run is resumed.

Records have a length and a checksum, so one truncated by a crash is ignored; arrays are in the npy
format, never pickled. A resumed run begins anew and reads its evaluations from the file.
"""

from __future__ import annotations

import errno
import io
import json
import os
import secrets
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from hashlib import blake2b
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from updyn import __version__
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.modal import ModeSet
from updyn.settings import MESSAGES
from updyn.updating.fit.settings import CHECKPOINT
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Record, Session, digest

__all__ = ["Checkpoint", "checkpoint_session", "fingerprint"]

_MAGIC = b"updyn journal 1\n"
_KEY = _SUM = 16
_LENGTH = 8


class Checkpoint:
    """Evaluations of a run in a file; a `Cache`. `head` is the header from `fingerprint`.

    The file is created with the first evaluation. With `resume` but no file, the run begins anew
    with a warning. Raises OptionError if the folder does not exist or the file belongs to another
    problem, and FormatError if it is not a checkpoint.
    """

    def __init__(self, path: Path, head: Mapping[str, object], *, resume: bool = False) -> None:
        self.path = path
        self._head = json.dumps(head, sort_keys=True)
        self._places: dict[bytes, tuple[int, int]] = {}
        self._file: FileIO | None = None
        self._broken = False
        self._synced = 0.0
        if "\0" in str(path):
            raise OptionError(f"checkpoint {str(path)!r}: no file can have that name")
        if not path.parent.is_dir():
            raise OptionError(f"checkpoint {str(path)!r}: the folder does not exist")
        if resume:
            self._read_file()

    def get(self, key: bytes) -> Record | None:
        """Return the evaluation of a key, or None."""
        if self._file is None or key not in self._places:
            return None
        start, length = self._places[key]
        self._file.seek(start)
        return _unpack(self._file.read(length))

    def store(self, key: bytes, record: Record) -> None:
        """Write an evaluation; if the disk is full or lost, warn and continue without the file."""
        if key in self._places or self._broken:
            return
        try:
            if self._file is None:
                self._file = self._create_file()
            start = self._file.seek(0, os.SEEK_END)
            _write(self._file, _frame(key + _pack(record)))
            if time.monotonic() - self._synced > CHECKPOINT.sync_interval_s:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            self._give_up(error)
            return
        self._places[key] = (
            start + _LENGTH + _KEY,
            self._file.tell() - _SUM - start - _LENGTH - _KEY,
        )

    def keep(self) -> None:
        """Create the file, if none exists, to resume from even before the first evaluation."""
        if self._file is None and not self._broken:
            try:
                self._file = self._create_file()
            except OSError as error:
                self._give_up(error)

    def close(self) -> None:
        """Write the file to disk and close it."""
        if self._file is not None:
            try:
                if not self._broken:
                    os.fsync(self._file.fileno())
                self._file.close()
            except OSError as error:
                self._give_up(error)
            self._file = None

    def _give_up(self, error: OSError) -> None:
        """Warn, once, that the file cannot be written."""
        if not self._broken:
            self._broken = True
            warnings.warn(
                f"{self.path}: cannot be written ({error.strerror}); the run continues, but cannot"
                " be resumed from here",
                UpdynWarning,
                stacklevel=3,
            )

    def __len__(self) -> int:
        return len(self._places)

    def _create_file(self) -> FileIO:
        # Written under another name first: a file of the final name always has a complete header.
        temporary = self.path.with_name(f".{self.path.name}-{secrets.token_hex(6)}")
        try:
            temporary.write_bytes(_MAGIC + _frame(self._head.encode()))
            temporary.replace(self.path)
        finally:
            temporary.unlink(missing_ok=True)
        # Unbuffered: bytes that a full disk rejected are not written again by later calls.
        return self.path.open("r+b", buffering=0)

    def _read_file(self) -> None:
        if not self.path.exists():
            # Not an error: the same command or script serves the first start and every later one.
            warnings.warn(
                f"nothing to resume: {str(self.path)!r} does not exist; the run begins anew",
                UpdynWarning,
                stacklevel=2,
            )
            return
        with ExitStack() as refused:
            file = refused.enter_context(self.path.open("r+b", buffering=0))
            self._check_head(file)
            end = file.tell()
            for start, content in _records(file):
                self._places[content[:_KEY]] = start + _KEY, len(content) - _KEY
                end = file.tell()
            file.truncate(end)
            refused.pop_all()
        self._file = file

    def _check_head(self, file: FileIO) -> None:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise FormatError(
                "is not a checkpoint, or was written by another version of updyn", self.path
            )
        _, head = next(_records(file), (0, b""))
        if not head:
            raise FormatError("is a checkpoint, but its header is damaged", self.path)
        differing = _describe_differences(json.loads(head), json.loads(self._head))
        if differing:
            raise OptionError(
                f"checkpoint {str(self.path)!r} is of another run: {differing}; without resume the"
                " run begins anew and replaces it"
            )


@contextmanager
def checkpoint_session(
    session: Session,
    path: str | Path | None,
    head: Callable[[], Mapping[str, object]],
    *,
    resume: bool,
) -> Iterator[None]:
    """Store the evaluations of a session in a checkpoint, if any, under its `head`."""
    if path is None:
        if resume:
            raise OptionError("resume: expected the path of a checkpoint", key=("resume",))
        yield
        return
    checkpoint = Checkpoint(Path(path), head(), resume=resume)
    session.cache = checkpoint
    try:
        yield
    finally:
        checkpoint.close()


def fingerprint(
    problem: Problem, data: Sequence[FRF | ModeSet], options: Mapping[str, object]
) -> dict[str, object]:
    """Return the identification of a run as plain data.

    `options` are other options that change the evaluations, without the number of steps: a run that
    reached it can be resumed with more.
    """
    model: list[object] = []
    measured: list[object] = []
    frfs = [one for one in data if isinstance(one, FRF)]
    measured += [one.digest for one in data if isinstance(one, ModeSet)]
    systems = [part.solver.system for part in problem.parts]
    systems += [part.system for part in problem.modal]
    for part, system in zip(problem.all_parts, systems, strict=True):
        start = system.start
        model += [
            part.name,
            system.indptr,
            system.indices,
            start.loss,
            start.rate,
            *system.dofs.labels,
        ]
        for term in system.terms:
            model += [term.group, term.quantity, term.slots, term.data]
        for term in system.terms:
            if term.table is not None:
                model += [term.group, term.table.freq, term.table.relative]
    for frf in frfs:
        measured += [frf.freq, frf.values, frf.quantity, str(frf.averages)]
        measured += [*frf.responses.labels, "/", *frf.references.labels]
        if frf.quantity == TRANSMISSIBILITY:
            measured += [*(() if frf.base is None else frf.base.labels), "/", str(frf.force)]
        if frf.level is not None:
            measured += [frf.level, str(frf.sweep)]
            measured += [frf.excitation, frf.spectrum] if frf.is_random else []
        for array in (frf.variance, frf.coherence):
            measured.append("None" if array is None else array)
    unknowns: dict[str, list[object]] = {}
    for p in problem.coordinates.parameters:
        unknowns[p.name] = [p.start, p.lower, p.upper, p.prior_std]
        unknowns[p.name] += [[d.name, d.power] for d in p.drives]
    return {
        "updyn": __version__,
        "model": digest(model).hex(),
        "data": digest(measured).hex(),
        "unknowns": unknowns,
        "options": {k: str(v) for k, v in options.items()},
    }


def _describe_differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the differences of two fingerprints as text; empty if they agree."""
    if then["updyn"] != now["updyn"]:
        return f"updyn {then['updyn']} wrote the file, this is {now['updyn']}"
    parts = []
    if then["model"] != now["model"]:
        parts.append("the model differs")
    if then["data"] != now["data"]:
        parts.append("the data differ")
    for part in ("unknowns", "options"):
        names = sorted(then[part].keys() | now[part].keys())
        changed = [n for n in names if then[part].get(n) != now[part].get(n)]
        if changed:
            most = MESSAGES.listed_items
            shown = ", ".join(changed[:most])
            if len(changed) > most:
                shown += f" and {len(changed) - most} more"
            parts.append(f"the {part} differ ({shown})")
    return ", ".join(parts)


def _frame(content: bytes) -> bytes:
    return len(content).to_bytes(_LENGTH, "little") + content + _checksum(content)


def _checksum(content: bytes) -> bytes:
    return blake2b(content, digest_size=_SUM).digest()


def _write(file: FileIO, content: bytes) -> None:
    """Write all of a content; raise OSError if the disk takes only a part of it."""
    if file.write(content) < len(content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _records(file: FileIO) -> Iterator[tuple[int, bytes]]:
    """Yield position and content of each record up to the first incomplete one."""
    size = os.fstat(file.fileno()).st_size
    while True:
        length = int.from_bytes(file.read(_LENGTH), "little")
        start = file.tell()
        if length == 0 or start + length + _SUM > size:
            return
        content = file.read(length)
        if file.read(_SUM) != _checksum(content):
            return
        yield start, content


def _pack(record: Record) -> bytes:
    buffer = io.BytesIO()
    for array in record:
        np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _unpack(content: bytes) -> Record:
    buffer, arrays = io.BytesIO(content), []
    while buffer.tell() < len(content):
        arrays.append(np.load(buffer, allow_pickle=False))
    return tuple(arrays)
