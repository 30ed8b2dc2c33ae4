"""Abaqus: the matrices that it writes (``.mtx``) as a model, by the deck, by file names or by a small TOML file.

Abaqus itself is not run. A deck (``.inp``) says which files there are:

- steps with ``*MATRIX GENERATE``: step n of ``job.inp`` wrote ``job_STIFn.mtx``, ``job_MASSn.mtx``,
  ``job_DMPVn.mtx`` and ``job_DMPSn.mtx``. With ``ELSET=`` the set is a group; with ``ELEMENT BY
  ELEMENT`` each material is one; a step of the whole besides is what the groups have to add up to.
- ``*MATRIX INPUT`` and ``*MATRIX ASSEMBLE``: each assembly is a group, called as its stiffness.

``job_STIF1.mtx`` alone stands for what step 1 wrote. A TOML file is as in `updyn.io.matrix_market`,
without ``dofs``, with ``structural`` besides, and ``unit``, ``deck`` and ``internal`` at its top.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from updyn.errors import FormatError
from updyn.geometry import Geometry
from updyn.io.abaqus_deck import DeckFacts, read_facts
from updyn.io.abaqus_matrix import NAME, read_entries
from updyn.io.abaqus_parts import MATRICES, Part, assemble
from updyn.io.abaqus_steps import assembled_parts, generated_parts
from updyn.io.abaqus_write import write_model
from updyn.io.consistent_units import System, system
from updyn.io.keyword_cards import read_cards
from updyn.io.keyword_changes import write_changes
from updyn.model import Model

__all__ = ["read_model", "write_model", "write_properties"]


def read_model(
    path: str | Path, *, unit: str = "m", internal: str = "keep", job: str | None = None
) -> Model:
    """Read the matrices that Abaqus wrote.

    Parameters
    ----------
    path : path
        A deck, or one of the matrix files ``job_STIF1.mtx``.
    unit : {"m", "mm", "in"}
        The consistent units of deck and files by their length: m, N, kg; mm, N, t; in, lbf, lbf
        s2/in. The model is in SI.
    internal : {"keep", "condense"}
        What becomes of internal nodes of Abaqus, which have numbers below 0: "keep" makes node -n
        the node (largest of the others) + n, exact in all cases, as what is not measured is
        condensed line by line. "condense" takes them out (K_rr - K_ri K_ii^-1 K_ir), which is exact
        where they have neither mass nor damping and belong to one group; else it is an error.
    job : str, optional
        Name of the job, of which the matrix files of a deck are called. None: as the deck.

    Returns
    -------
    Model
        Without degrees of freedom that are held (1e36 on the diagonal). Geometry: the nodes of the
        deck, where it has no parts; of matrix files that of the deck of their name, if it is there.

    Raises
    ------
    FormatError
        If a file is missing or not valid, or groups do not add up; the message says file and line.
    OptionError
        If there is no such unit, or `internal` is neither.
    """
    path = Path(path)
    units = system(unit)
    if path.suffix.lower() != ".mtx":
        facts = read_facts(path, read_cards(path))
        # The matrices that a step wrote have its supports in them.
        used = bool(facts.assemblies)
        parts = assembled_parts(facts) if used else generated_parts(facts, job or path.stem)
        held = facts.held() if used else []
        drawn = facts.drawn(units)
        return assemble(
            parts, units, path, geometry=drawn, title=facts.title, internal=internal, held=held
        )
    found = NAME.fullmatch(path.stem)
    if found is None:
        raise FormatError(
            "its name is not as Abaqus gives it (job_STIF1.mtx); name the files in a small TOML"
            " file: [[group]] with "
            f'name = "...", stiffness = "{path.name}", mass = "..."',
            path,
        )
    name, step = found[1], found[3]
    files = {
        what: path.parent / f"{name}_{letters}{step}.mtx" for what, letters in MATRICES.items()
    }
    entries = {what: read_entries(file) for what, file in files.items() if file.is_file()}
    if "stiffness" not in entries or "mass" not in entries:
        lacks = files["mass" if "stiffness" in entries else "stiffness"].name
        raise FormatError(
            f"no {lacks} beside it; *MATRIX GENERATE, STIFFNESS, MASS writes both", path
        )
    geometry = _beside(path.parent / f"{name}.inp", units)
    return assemble([Part(name, entries)], units, path, geometry=geometry, internal=internal)


def _beside(deck: Path, units: System) -> Geometry | None:
    return read_facts(deck, read_cards(deck)).drawn(units) if deck.is_file() else None


def write_properties(
    changes: Mapping[str, Mapping[str, float]], deck: str | Path, path: str | Path
) -> None:
    """Write the materials that changed as a file for ``*INCLUDE``, in the place of their old cards.

    Parameters
    ----------
    changes : mapping of str to mapping of str to float
        By group, called as a material, as the element set of a section, or as springs or masses:
        "stiffness" and "mass" are factors on the deck's moduli and densities, "loss_factor" is the
        new ``*DAMPING, STRUCTURAL=``, "viscous" a factor on the damping that ALPHA and BETA give.
    deck : path
        The deck; Abaqus's parts and instances may stand in it.
    path : path
        The file to write.

    Raises
    ------
    FormatError
        If the deck cannot be read, has no such group (the nearest is named), or a set shares its
        material with others.
    """
    deck = Path(deck)
    facts: DeckFacts = read_facts(deck, read_cards(deck))
    write_changes(facts.by_material(changes), facts.properties, deck, Path(path), own_rayleigh=True)
