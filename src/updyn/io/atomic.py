"""Files that are written whole or not at all."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from updyn.errors import FormatError

__all__ = ["atomic_path"]


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the same folder, with the same suffix; it replaces `path` when the block ends well.

    Parameters
    ----------
    path : path
        The file to write.

    Yields
    ------
    Path
        Where to write. It is removed when the block raises; `path` is then as it was.

    Raises
    ------
    FormatError
        If the folder is not there.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FormatError(f"the folder {str(path.parent)!r} does not exist", path)
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(8)}{path.suffix}")
    temporary.touch(exist_ok=False)  # with the permissions of any new file; tempfile would keep it from all others
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
