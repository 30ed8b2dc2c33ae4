"""Running ``ccx``: a deck in, K and M out, what it complains of as an error."""

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
from updyn.io.keyword_deck.cards import Card, number
from updyn.io.keyword_deck.structure import LINEAR, NONLINEAR, split_steps
from updyn.io.text_numbers import number_rows
from updyn.model import Matrix

__all__ = [
    "ABAQUS",
    "Matrices",
    "Program",
    "check_model",
    "find_program",
    "storage_deck",
]

_JOB = "job"
_NODE = re.compile(r"[0-9]{1,15}")
#: The step that writes ``job.sti``, ``job.mas`` and ``job.dof`` instead of solving.
STORAGE = ("*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE")
_SHOWN = 3  # messages of ccx that are told
#: What ccx says of every point mass, and of a material without density, which is told by name
#: elsewhere.
_HARMLESS = ("no elastic constants", "no density was assigned", "cannot be inter")


@dataclass(frozen=True, slots=True, eq=False)
class Matrices:
    """What ``ccx`` wrote, in the units of the deck.

    Parameters
    ----------
    dofs : DofSet
        The N degrees of freedom that are neither held nor tied to others.
    stiffness, mass : sparse, shape (N, N)
        Real and symmetric.
    """

    dofs: DofSet
    stiffness: Matrix
    mass: Matrix


@dataclass(frozen=True, slots=True)
class Program:
    """An installed ``ccx``.

    Parameters
    ----------
    executable : str
        Its path.
    timeout : float
        Longest time of one run, in s.
    path : Path
        The deck, for messages.
    """

    executable: str
    timeout: float
    path: Path

    def matrices(self, lines: Sequence[str], *, remarks: bool = True) -> Matrices:
        """Run a deck, whose last step stores the matrices, in a temporary folder.

        Parameters
        ----------
        lines : sequence of str
            The deck.
        remarks : bool
            Whether what the program remarks is passed on as a warning.

        Returns
        -------
        Matrices

        Raises
        ------
        FormatError
            If the program fails, takes too long or does not understand a card; its own words are in
            the message.
        """
        with tempfile.TemporaryDirectory(prefix="updyn-ccx-") as name:
            folder = Path(name)
            (folder / f"{_JOB}.inp").write_text(
                "\n".join(lines) + "\n", encoding="latin-1", errors="replace"
            )
            said, code = self._run(folder)
            complaints = self._judge(said, code, folder)
            if complaints and remarks:
                warnings.warn(
                    f"{self.path}: ccx says: {'; '.join(complaints)}", UpdynWarning, stacklevel=2
                )
            return self._read(folder)

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
                f"ccx was stopped after {self.timeout:g} s; give it longer: timeout=", self.path
            ) from error
        except OSError as error:
            raise OptionError(
                f"ccx: {self.executable!r} cannot be run: {error.strerror}"
            ) from error
        return (done.stdout + b"\n" + done.stderr).decode("utf-8", "replace"), done.returncode

    def _judge(self, said: str, code: int, folder: Path) -> list[str]:
        """Refuse what went wrong; return what is worth a remark."""
        errors = _messages(said, "ERROR")
        remarks = []
        for message in _messages(said, "WARNING"):
            if "Card image" in message:  # a card that ccx would pass over
                errors.append(message)
            elif not any(known in message for known in _HARMLESS):
                remarks.append(message)
        if errors:
            shown = "; ".join(errors[:_SHOWN])
            if len(errors) > _SHOWN:
                shown += f" ({len(errors)} in all)"
            raise FormatError(f"ccx says: {shown}", self.path)
        written = {file.name for file in folder.iterdir()}
        if code or not {f"{_JOB}.sti", f"{_JOB}.mas", f"{_JOB}.dof"} <= written:
            last = " / ".join(line.strip() for line in said.splitlines() if line.strip())
            raise FormatError(
                f"ccx ended by {describe_exit(code)} and wrote no matrices; its last words:"
                f" {last[-300:] or 'none'}",
                self.path,
            )
        return list(dict.fromkeys(remarks))

    def _read(self, folder: Path) -> Matrices:
        labels = (folder / f"{_JOB}.dof").read_bytes().decode("ascii", "backslashreplace")
        dofs = _dofs(labels, self.path)
        try:
            K = _matrix(folder / f"{_JOB}.sti", len(dofs))
            M = _matrix(folder / f"{_JOB}.mas", len(dofs))
        except FormatError as error:
            raise FormatError(f"what ccx wrote cannot be read: {error}", self.path) from error
        return Matrices(dofs, K, M)


def find_program(name: str, timeout: float, path: Path) -> Program:
    """Find ``ccx``.

    Parameters
    ----------
    name : str
        Name of the executable, or its path.
    timeout : float
        Longest time of one run, in s.
    path : Path
        The deck, for messages.

    Returns
    -------
    Program

    Raises
    ------
    OptionError
        If it is not there, with what to install, or the time is not above 0.
    """
    if not timeout > 0:
        raise OptionError(f"timeout {timeout!r}; expected seconds above 0")
    found = shutil.which(name)
    if found is None:
        raise OptionError(
            f"{path}: CalculiX is needed to read this deck, and there is no program {name!r}."
            ' Install it ("apt install calculix-ccx" on Debian and Ubuntu, or from calculix.de),'
            ' or say where it is: ccx="path"'
        )
    return Program(found, timeout, path)


def _messages(said: str, kind: str) -> list[str]:
    """Return the messages of a kind: from ``*ERROR`` to the next empty line."""
    found = re.findall(
        rf"^ *\*{kind}\b(.*(?:\n(?! *\*(?:ERROR|WARNING))(?! *$).*)*)", said, re.MULTILINE
    )
    return [" ".join(text.lstrip(":").split()) for text in found]


def _dofs(text: str, path: Path) -> DofSet:
    """Read ``node.direction``, one a line."""
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
        raise FormatError("no degree of freedom is free: everything is held", path)
    return DofSet.from_arrays(nodes, axes)


def _matrix(path: Path, n: int) -> Matrix:
    """Read ``row column value``, one triangle."""
    raw = path.read_bytes()
    if re.search(rb"nan|inf", raw, re.IGNORECASE):
        raise FormatError(
            "ccx writes numbers that are not finite; look at the constraints (*MPC, *EQUATION)",
            path,
        )
    table = number_rows(raw, "iir", "row, column, entry", path)
    row, column = table[:, :2].astype(np.int64).T - 1
    if table.size and not (0 <= min(row.min(), column.min()) <= max(row.max(), column.max()) < n):
        raise FormatError(f"an entry lies outside of {n} x {n}", path)
    # Of each column ccx writes the upper triangle, down to the diagonal.
    if not table.size or (row[-1], column[-1]) != (n - 1, n - 1):
        raise FormatError(f"does not end with the entry {n}, {n}: cut short (a full disk?)", path)
    off = row != column
    values = np.concatenate([table[:, 2], table[off, 2]])
    at = (np.concatenate([row, column[off]]), np.concatenate([column, row[off]]))
    out = sp.csr_array(sp.coo_array((values, at), shape=(n, n)))
    out.eliminate_zeros()
    return out


#: Cards that CalculiX does not have and that tell a deck of Abaqus.
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
#: Says nothing of stiffness and mass.
_IDLE = ("AMPLITUDE", "TIME POINTS", "PHYSICAL CONSTANTS", "INITIAL CONDITIONS", "PREPRINT")
_EXPANDED = (
    "beams and shells are expanded into solids with hidden nodes, whose DOFs are not those of the"
    " deck"
)
_REFUSED = {
    "DISTRIBUTING": "its reference node has no place in the matrices; use *KINEMATIC or *EQUATION",
    "DISTRIBUTING COUPLING": (
        "its reference node has no place in the matrices; use *COUPLING or *EQUATION"
    ),
    "CONTACT PAIR": "contact is not linear; use *TIE where the faces stick together",
    "SURFACE INTERACTION": "contact is not linear; use *TIE where the faces stick together",
    "GAP": "contact is not linear",
    "DASHPOT": (
        "dashpots stand in no matrix that ccx writes; leave them out and add their damping to the"
        " model later"
    ),
    "CYCLIC SYMMETRY MODEL": "the matrices of a sector are not those of the whole; model the whole",
    "SUBMODEL": "a submodel has no boundary of its own",
    "RESTART": "a deck that goes on from another is not complete",
    "BEAM SECTION": _EXPANDED,
    "BEAM GENERAL SECTION": _EXPANDED,
    "SHELL SECTION": _EXPANDED,
    "MEMBRANE SECTION": _EXPANDED,
}


def check_model(model: Sequence[Card]) -> None:
    """Refuse what ``ccx`` would pass over with a remark, or what its matrices would not show.

    Parameters
    ----------
    model : sequence of Card
        The cards before the first step.

    Raises
    ------
    FormatError
        For the first such card: file, line, why, and the nearest keyword where it is not known at
        all.
    """
    known = (*_STRUCTURE, *LINEAR, *_IDLE)
    below = False  # a *MATERIAL
    for card in model:
        below = card.name == "MATERIAL" or (below and card.name in (*LINEAR, *NONLINEAR))
        if card.name in NONLINEAR:
            raise card.error(
                f"*{card.name}: only linear elastic materials (*ELASTIC) are read; leave it out"
            )
        if card.name in _REFUSED:
            raise card.error(f"*{card.name} is not read: {_REFUSED[card.name]}")
        if card.name not in known:
            raise card.error(f"unknown keyword *{card.name}; {suggest(card.name, known)}")
        if card.name in LINEAR and card.name != "DAMPING" and not below:
            raise card.error(f"*{card.name} stands below no *MATERIAL")
        if card.name == "SPRING":
            card.only("ELSET", "ORIENTATION")
        elif card.name == "MASS":
            card.only("ELSET")
        elif card.name == "MATERIAL":
            card.only("NAME")
        elif card.name == "SOLID SECTION":
            card.only("ELSET", "MATERIAL", "ORIENTATION")
        elif card.name == "BOUNDARY":
            _check_boundary(card)


def _check_boundary(card: Card) -> None:
    for row in card.rows:
        fields = row.fields
        if len(fields) > 3 and fields[3] and number(fields[3], card, row) != 0.0:
            raise card.error(f"*BOUNDARY: found {row.text!r}; a support holds at 0", row)


def storage_deck(cards: Sequence[Card]) -> tuple[list[Card], list[str]]:
    """Return the cards of the model, and the lines of the step in which ``ccx`` writes matrices.

    Supports that stand in the deck's first ``*FREQUENCY`` step, or in its first step if it has no
    such, are taken along; all else that stands in steps (loads, output) has no part in the
    matrices.

    Parameters
    ----------
    cards : sequence of Card
        The deck.

    Returns
    -------
    (list of Card, list of str)

    Raises
    ------
    FormatError
        If that step builds on another (preload), or a support is not one.
    """
    model, steps = split_steps(cards)
    chosen = steps[0] if steps else []
    for step in steps:
        if any(card.name == "FREQUENCY" for card in step):
            chosen = step
            break
    if chosen and chosen is not steps[0] and "PERTURBATION" in chosen[0].parameters:
        raise chosen[0].error(
            "*STEP, PERTURBATION after another step: stiffness by preload belongs to no material;"
            " leave PERTURBATION out or move the step to the front"
        )
    lines = list(STORAGE[:1])
    for card in chosen:
        if card.name == "BOUNDARY":
            _check_boundary(card)
            lines += card.text()
    return model, [*lines, *STORAGE[1:], "*END STEP"]
