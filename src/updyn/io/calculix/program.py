"""Runs of ``ccx``: from a deck to K and M, with its complaints as errors."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError, UpdynWarning, suggest
from updyn.foreign.exits import describe_exit
from updyn.io.keyword_deck.cards import KeywordCard, parse_number_field
from updyn.io.keyword_deck.structure import LINEAR, NONLINEAR, split_steps
from updyn.io.settings import FILE_TEXT
from updyn.io.text_numbers import parse_rows
from updyn.model import Matrix

__all__ = [
    "ABAQUS",
    "CalculixMatrices",
    "CalculixProgram",
    "check_model",
    "find_program",
    "storage_deck",
]

_JOB = "job"
_NODE = re.compile(r"[0-9]{1,15}")
#: The step that writes ``job.sti``, ``job.mas`` and ``job.dof`` instead of solving.
STORAGE = ("*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE")
#: Warnings of ccx about point masses, and about materials without density, which updyn reports.
_HARMLESS = ("no elastic constants", "no density was assigned", "cannot be inter")


@dataclass(frozen=True, slots=True, eq=False)
class CalculixMatrices:
    """The matrices written by ``ccx`` in the units of the deck, without fixed and tied DOFs."""

    dofs: DofSet
    stiffness: Matrix
    mass: Matrix


@dataclass(frozen=True, slots=True)
class CalculixProgram:
    """An installed ``ccx``; `path` is the deck, for messages."""

    executable: str
    timeout: float
    path: Path

    def run_deck(self, lines: Sequence[str], *, remarks: bool = True) -> CalculixMatrices:
        """Run a deck whose last step stores the matrices, in a temporary folder.

        `remarks` passes the remarks of the program on as a warning.
        """
        with tempfile.TemporaryDirectory(prefix="updyn-ccx-") as name:
            folder = Path(name)
            (folder / f"{_JOB}.inp").write_text(
                "\n".join(lines) + "\n", encoding="latin-1", errors="replace"
            )
            output, code = self._run(folder)
            complaints = self._check_output(output, code, folder)
            if complaints and remarks:
                warnings.warn(
                    f"{self.path}: ccx reports: {'; '.join(complaints)}", UpdynWarning, stacklevel=2
                )
            return self._read_matrices(folder)

    def _run(self, folder: Path) -> tuple[str, int]:
        try:
            done = subprocess.run(
                [self.executable, _JOB],
                cwd=folder,
                capture_output=True,
                timeout=self.timeout,
                check=False,
                stdin=subprocess.DEVNULL,
            )
        except subprocess.TimeoutExpired as error:
            raise FormatError(
                f"ccx exceeded its time limit of {self.timeout:g} s; increase timeout=", self.path
            ) from error
        except OSError as error:
            raise OptionError(
                f"ccx: {self.executable!r} cannot be run: {error.strerror}"
            ) from error
        return (done.stdout + b"\n" + done.stderr).decode("utf-8", "replace"), done.returncode

    def _check_output(self, output: str, code: int, folder: Path) -> list[str]:
        """Refuse a failed run; return the remarks of the program."""
        errors = _messages(output, "ERROR")
        remarks = []
        for message in _messages(output, "WARNING"):
            if "Card image" in message:  # a card that ccx would ignore
                errors.append(message)
            elif not any(known in message for known in _HARMLESS):
                remarks.append(message)
        if errors:
            shown = "; ".join(errors[: FILE_TEXT.reported_messages])
            if len(errors) > FILE_TEXT.reported_messages:
                shown += f" ({len(errors)} in all)"
            raise FormatError(f"ccx reports: {shown}", self.path)
        written = {file.name for file in folder.iterdir()}
        if code or not {f"{_JOB}.sti", f"{_JOB}.mas", f"{_JOB}.dof"} <= written:
            last = " / ".join(line.strip() for line in output.splitlines() if line.strip())
            raise FormatError(
                f"ccx ended by {describe_exit(code)} and wrote no matrices; its last output:"
                f" {last[-300:] or 'none'}",
                self.path,
            )
        return list(dict.fromkeys(remarks))

    def _read_matrices(self, folder: Path) -> CalculixMatrices:
        labels = (folder / f"{_JOB}.dof").read_bytes().decode("ascii", "backslashreplace")
        dofs = _dofs(labels, self.path)
        try:
            K = _matrix(folder / f"{_JOB}.sti", len(dofs))
            M = _matrix(folder / f"{_JOB}.mas", len(dofs))
        except FormatError as error:
            raise FormatError(f"the output of ccx cannot be read: {error}", self.path) from error
        return CalculixMatrices(dofs, K, M)


def find_program(name: str, timeout: float, path: Path) -> CalculixProgram:
    """Return the program ``ccx``, by its name or path."""
    if not timeout > 0:
        raise OptionError(f"timeout {timeout!r}; expected seconds above 0")
    found = shutil.which(name)
    if found is None:
        raise OptionError(
            f"{path}: CalculiX is needed to read this deck, but the program {name!r} was not found."
            ' Install it ("apt install calculix-ccx" on Debian and Ubuntu, or from calculix.de),'
            ' or give its path: ccx="path"'
        )
    return CalculixProgram(found, timeout, path)


def _messages(output: str, kind: str) -> list[str]:
    """Return the messages of a kind, each from ``*ERROR`` or the like to the next empty line."""
    found = re.findall(
        rf"^ *\*{kind}\b(.*(?:\n(?! *\*(?:ERROR|WARNING))(?! *$).*)*)", output, re.MULTILINE
    )
    return [" ".join(text.lstrip(":").split()) for text in found]


def _dofs(text: str, path: Path) -> DofSet:
    """Read ``node.direction``, one per line."""
    nodes = []
    axes = []
    for label in text.split():
        node, _, direction = label.partition(".")
        if direction not in ("1", "2", "3") or not _NODE.fullmatch(node):
            raise FormatError(
                f"ccx writes the degree of freedom {label!r}; expected directions 1, 2 and 3", path
            )
        nodes.append(int(node))
        axes.append(int(direction) - 1)
    if not nodes:
        raise FormatError("no degree of freedom is free: all are fixed", path)
    return DofSet.from_arrays(nodes, axes)


def _matrix(path: Path, n: int) -> Matrix:
    """Read ``row column value`` of one triangle."""
    raw = path.read_bytes()
    if re.search(rb"nan|inf", raw, re.IGNORECASE):
        raise FormatError(
            "ccx writes numbers that are not finite; look at the constraints (*MPC, *EQUATION)",
            path,
        )
    table = parse_rows(raw, "iir", "row, column, entry", path)
    row, column = table[:, :2].astype(np.int64).T - 1
    if table.size and not (0 <= min(row.min(), column.min()) <= max(row.max(), column.max()) < n):
        raise FormatError(f"an entry is outside of {n} x {n}", path)
    # ccx writes the upper triangle by columns, down to the diagonal.
    if not table.size or (row[-1], column[-1]) != (n - 1, n - 1):
        raise FormatError(f"does not end with the entry {n}, {n}: truncated (a full disk?)", path)
    off = row != column
    values = np.concatenate([table[:, 2], table[off, 2]])
    at = (np.concatenate([row, column[off]]), np.concatenate([column, row[off]]))
    out = sp.csr_array(sp.coo_array((values, at), shape=(n, n)))
    out.eliminate_zeros()
    return out


#: Cards that CalculiX does not have, which identify a deck of Abaqus.
ABAQUS = ("MATRIX INPUT", "MATRIX ASSEMBLE", "MATRIX GENERATE", "PART", "ASSEMBLY", "INSTANCE")
_STRUCTURE = (
    "HEADING",
    "NODE",
    "ELEMENT",
    "NSET",
    "ELSET",
    "SURFACE",
    "MATERIAL",
    "SOLID SECTION",
    "SPRING",
    "MASS",
    "BOUNDARY",
    "EQUATION",
    "MPC",
    "TIE",
    "RIGID BODY",
    "COUPLING",
    "KINEMATIC",
    "TRANSFORM",
    "ORIENTATION",
)
#: Cards without effect on stiffness and mass.
_IDLE = ("AMPLITUDE", "TIME POINTS", "PHYSICAL CONSTANTS", "INITIAL CONDITIONS", "PREPRINT")
_EXPANDED = (
    "beams and shells are expanded into solids with hidden nodes, whose DOFs are not those of the"
    " deck"
)
_REFUSED = {
    "DISTRIBUTING": "the matrices do not contain its reference node; use *KINEMATIC or *EQUATION",
    "DISTRIBUTING COUPLING": (
        "the matrices do not contain its reference node; use *COUPLING or *EQUATION"
    ),
    "CONTACT PAIR": "contact is not linear; use *TIE if the faces stick together",
    "SURFACE INTERACTION": "contact is not linear; use *TIE if the faces stick together",
    "GAP": "contact is not linear",
    "DASHPOT": (
        "matrices written by ccx do not contain dashpots; remove them and add their damping to the"
        " model later"
    ),
    "CYCLIC SYMMETRY MODEL": "the matrices of a sector are not those of the whole; model the whole",
    "SUBMODEL": "the boundary of a submodel belongs to another model",
    "RESTART": "a deck that continues another one is not complete",
    "BEAM SECTION": _EXPANDED,
    "BEAM GENERAL SECTION": _EXPANDED,
    "SHELL SECTION": _EXPANDED,
    "MEMBRANE SECTION": _EXPANDED,
}


def check_model(model: Sequence[KeywordCard]) -> None:
    """Refuse cards that ``ccx`` would ignore or that its matrices would not contain."""
    known = (*_STRUCTURE, *LINEAR, *_IDLE)
    below = False  # whether the card follows a *MATERIAL
    for card in model:
        below = card.name == "MATERIAL" or (below and card.name in (*LINEAR, *NONLINEAR))
        if card.name in NONLINEAR:
            raise card.error(
                f"*{card.name}: expected only linear elastic materials (*ELASTIC); remove it"
            )
        if card.name in _REFUSED:
            raise card.error(f"*{card.name} is not supported: {_REFUSED[card.name]}")
        if card.name not in known:
            raise card.error(f"unknown keyword *{card.name}; {suggest(card.name, known)}")
        if card.name in LINEAR and card.name != "DAMPING" and not below:
            raise card.error(f"*{card.name} does not follow a *MATERIAL")
        if card.name == "SPRING":
            card.check_parameters("ELSET", "ORIENTATION")
        elif card.name == "MASS":
            card.check_parameters("ELSET")
        elif card.name == "MATERIAL":
            card.check_parameters("NAME")
        elif card.name == "SOLID SECTION":
            card.check_parameters("ELSET", "MATERIAL", "ORIENTATION")
        elif card.name == "BOUNDARY":
            _check_boundary(card)


def _check_boundary(card: KeywordCard) -> None:
    for row in card.rows:
        fields = row.fields
        if len(fields) > 3 and fields[3] and parse_number_field(fields[3], card, row) != 0.0:
            raise card.error(f"*BOUNDARY: found {row.text!r}; expected a support at 0", row)


def storage_deck(cards: Sequence[KeywordCard]) -> tuple[list[KeywordCard], list[str]]:
    """Return the cards of the model, and the lines of the step in which ``ccx`` writes matrices.

    The step includes the supports of the deck's first ``*FREQUENCY`` step, or of its first step,
    which must not depend on another (preload). Loads and output are ignored.
    """
    model, steps = split_steps(cards)
    chosen = steps[0] if steps else []
    for step in steps:
        if any(card.name == "FREQUENCY" for card in step):
            chosen = step
            break
    if chosen and chosen is not steps[0] and "PERTURBATION" in chosen[0].parameters:
        raise chosen[0].error(
            "*STEP, PERTURBATION after another step: preload stiffness belongs to no material;"
            " remove PERTURBATION or move the step to the front"
        )
    lines = list(STORAGE[:1])
    for card in chosen:
        if card.name == "BOUNDARY":
            _check_boundary(card)
            lines += card.text()
    return model, [*lines, *STORAGE[1:], "*END STEP"]
