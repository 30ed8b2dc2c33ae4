"""Node numbers of mesh files, which meshio drops, and the decks that it would read wrongly."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError

__all__ = ["numbers_in"]

_KEYWORD = re.compile(r"\*\s*(\w[\w ]*)")


def numbers_in(path: Path) -> NDArray[np.int64] | None:
    """Return the node numbers of a mesh file, in its order; None where the format has none.

    Raises
    ------
    FormatError
        If the numbers are not there, or meshio would take the groups of an Abaqus deck for others:
        element blocks without a set beside some with one, one set in two blocks, several blocks of
        nodes, parts and includes.
    """
    suffix = path.suffix.lower()
    if suffix == ".msh":
        with path.open("rb") as file:
            head = file.read(200)
        if not head.startswith(b"$MeshFormat"):
            return None  # the same suffix is used by others
        words = head.split()
        if len(words) < 3 or words[2] != b"0":
            raise FormatError(
                "a binary .msh: its node numbers are not read; save it as text (Mesh.Binary = 0)",
                path,
            )
        return _gmsh(path, _lines(path), words[1].decode(errors="replace"))
    return _abaqus(path, _lines(path)) if suffix == ".inp" else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(
            f"byte {error.start} is not text; expected a mesh in UTF-8", path
        ) from error


def _gmsh(path: Path, lines: list[str], version: str) -> NDArray[np.int64]:
    try:
        at = lines.index("$Nodes") + 1
        out: list[int] = []
        if version.startswith("2"):
            count = int(lines[at])
            out = [int(line.split(maxsplit=1)[0]) for line in lines[at + 1 : at + 1 + count]]
        else:
            blocks, at = int(lines[at].split()[0]), at + 1
            for _ in range(blocks):
                count = int(lines[at].split()[3])
                out += [int(line) for line in lines[at + 1 : at + 1 + count]]
                at += 1 + 2 * count
    except (ValueError, IndexError) as error:
        raise FormatError(f"the nodes cannot be read ({error})", path) from error
    return np.array(out, dtype=np.int64)


def _abaqus(path: Path, lines: list[str]) -> NDArray[np.int64]:
    out: list[int] = []
    sets: dict[str, int] = {}
    without: int | None = None
    blocks, inside = 0, False
    for number, line in enumerate(lines, 1):
        if line.startswith("**"):
            continue
        found = _KEYWORD.match(line)
        if found is None:
            if inside and line.strip():
                out.append(_first(path, number, line))
            continue
        word = found[1].strip().upper()
        inside = word == "NODE"
        if word in ("PART", "INSTANCE", "INCLUDE"):
            raise FormatError(
                f"*{word}: only flat decks are read; expected *NODE, *ELEMENT and sets",
                path,
                number,
            )
        if inside:
            blocks += 1
            if blocks > 1:
                raise FormatError(
                    "a second *NODE block, of which the first would be lost; join them",
                    path,
                    number,
                )
        if word == "ELEMENT":
            own = re.search(r"ELSET\s*=\s*([^,\s]+)", line, re.IGNORECASE)
            if own is None:
                without = without or number
            elif own[1] in sets:
                raise FormatError(
                    f"*ELEMENT with ELSET={own[1]}, as on line {sets[own[1]]}, which would be lost;"
                    " use two names",
                    path,
                    number,
                )
            else:
                sets[own[1]] = number
    if sets and without is not None:
        raise FormatError(
            "*ELEMENT without ELSET beside others with one; give each block its own", path, without
        )
    return np.array(out, dtype=np.int64)


def _first(path: Path, number: int, line: str) -> int:
    try:
        return int(line.split(",", maxsplit=1)[0])
    except ValueError as error:
        raise FormatError(
            f"{line.strip()[:30]!r}: expected a node number first", path, number
        ) from error
