"""Updated properties for an Ansys deck, as commands that it can include (APDL).

Groups are those of `updyn.io.ansys_emat`, by material: "material 3" has its moduli (EX, EY, EZ,
GXY, GYZ, GXZ), its density (DENS) and its damping (ALPD, BETD, and DMPS or DMPR); "real 4" has the
constants of springs, dampers and point masses (COMBIN14, MASS21, COMBIN40, COMBI214).

The loss factor gamma of a material, K (1 + i gamma), is MP,DMPS = gamma. Releases that have no DMPS
add 2 i DMPR K (Ansys 18.2, command DMPSTR: "MP,DMPR adds the contribution on a per-material basis
as 2gK"): DMPR = gamma / 2 there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.io.ansys_attributes import beside
from updyn.io.ansys_deck import Deck, Property, RealSet, read_deck
from updyn.io.atomic import atomic_path

__all__ = ["write_properties"]

_QUANTITIES = ("stiffness", "mass", "viscous", "loss_factor")
_MODULI = ("EX", "EY", "EZ", "GXY", "GYZ", "GXZ")
#: Places of real constants, counted from 1, by element routine (Ansys Element Reference).
_REALS: Mapping[int, Mapping[str, tuple[int, ...]]] = {
    14: {"stiffness": (1,), "viscous": (2, 3)},
    21: {"mass": (1, 2, 3, 4, 5, 6)},
    40: {"stiffness": (1, 6), "viscous": (2,), "mass": (3,)},
    214: {"stiffness": (1, 2, 3, 4), "viscous": (5, 6, 7, 8)},
}
_NAMES = {14: "COMBIN14", 21: "MASS21", 40: "COMBIN40", 214: "COMBI214"}
_NO_DMPS = (
    2020  # releases before 2020 R1, counted by years or as 15.0 to 19.5, are known to have none
)


def write_properties(changes: Mapping[str, Mapping[str, float]], deck: Path, path: Path) -> None:
    """Write the commands for the groups that change.

    Parameters
    ----------
    changes : mapping of str to mapping of str to float
        By group: factors "stiffness", "mass", "viscous", and the value "loss_factor".
    deck : Path
        The deck, with its properties in numbers (``.cdb`` of CDWRITE, or commands); for an
        ``.emat`` or ``.full`` file, the ``.cdb`` of the same name beside it.
    path : Path
        The file to write.

    Raises
    ------
    FormatError
        If the deck has no such material or real constant set, or has no number there to change.
    """
    deck = _commands(deck)
    found = read_deck(deck)
    names = [f"material {n}" for n in sorted(found.materials)] + [
        f"real {n}" for n in sorted(found.reals)
    ]
    blocks: list[str] = []
    for name, change in changes.items():
        kind = re.fullmatch(r"(material|real) (\d+)", name)
        if kind is None or name not in names:
            hint = (
                ""
                if kind
                else " (by component, type or section there is no one property: group by material)"
            )
            raise FormatError(f"the deck has no {name!r}{hint}; {suggest(name, names)}", deck)
        _check(name, change, deck)
        number = int(kind[2])
        said = ", ".join(
            f"{q} {'=' if q == 'loss_factor' else 'x'} {v!r}" for q, v in change.items()
        )
        blocks += ["!", f"! {name}: {said or 'unchanged'}"]
        blocks += (
            _material(found, number, change)
            if kind[1] == "material"
            else _real(found, number, change)
        )
    heading = [
        f"! New properties for {deck.name}: {', '.join(changes)}.",
        f"! Read them in /PREP7 after the deck: /INPUT,{path.stem},{path.suffix.lstrip('.')}",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*heading, *blocks]) + "\n", encoding="utf-8")


def _commands(deck: Path) -> Path:
    if deck.suffix.lower() not in (".emat", ".full"):
        return deck
    found = beside(deck, ".cdb")
    if found is None:
        raise FormatError(
            f"properties are changed in the deck: no {deck.with_suffix('.cdb').name} beside it"
            " (CDWRITE)",
            deck,
        )
    return found


def _check(name: str, change: Mapping[str, float], deck: Path) -> None:
    for quantity, value in change.items():
        if quantity not in _QUANTITIES:
            raise FormatError(
                f"group {name!r}: no quantity {quantity!r}; {suggest(quantity, _QUANTITIES)}", deck
            )
        least = quantity in ("viscous", "loss_factor")
        if not (0 < value < float("inf") or (least and value == 0)):
            wanted = "at least 0" if least else "above 0"
            raise FormatError(
                f"group {name!r}: {quantity} {value!r}; expected a finite number {wanted}", deck
            )


# -- materials ---------------------------------------------------------------------------------------------
def _material(deck: Deck, number: int, change: Mapping[str, float]) -> list[str]:
    has = deck.materials[number]
    stiffness, mass, viscous = (change.get(q, 1.0) for q in ("stiffness", "mass", "viscous"))
    if number in deck.tables and (stiffness != 1.0 or viscous != 1.0 or "loss_factor" in change):
        raise FormatError(
            f"material {number} has a table (TB) of elasticity or damping, which is not changed;"
            " expected MP or MPDATA",
            deck.path,
            deck.tables[number],
        )
    moduli = [label for label in _MODULI if label in has]
    _needed(deck, number, has, stiffness != 1.0, moduli, "EX")
    _needed(deck, number, has, mass != 1.0, "DENS" in has, "DENS")
    _needed(deck, number, has, viscous != 1.0, "ALPD" in has or "BETD" in has, "ALPD or BETD")
    factors = dict.fromkeys(moduli, stiffness)
    # C = ALPD M + BETD K of the new M and K, and is to be `viscous` times the old C.
    factors |= {"DENS": mass, "ALPD": viscous / mass, "BETD": viscous / stiffness}
    out = []
    for label, factor in factors.items():
        if label in has and factor != 1.0:
            out += _written(deck, number, label, has[label], factor)
    if "loss_factor" in change:
        out += _loss_factor(deck, number, has, change["loss_factor"])
    return out


def _needed(
    deck: Deck, number: int, has: Mapping[str, Property], asked: bool, there: object, label: str
) -> None:
    if asked and not there:
        line = next(iter(has.values())).line
        raise FormatError(
            f"material {number} has no {label} to change; it has {', '.join(sorted(has))}",
            deck.path,
            line,
        )


def _written(deck: Deck, number: int, label: str, old: Property, factor: float) -> list[str]:
    what = f"{label} of material {number}"
    before = [deck.number(v, old.line, what) for v in old.values]
    values = [repr(v * factor) for v in before]
    out = [f"! old {label} (line {old.line}): {', '.join(repr(v) for v in before)}"]
    if len(set(old.temperatures)) < 2:
        return [*out, f"MP,{label},{number},{','.join(values)}"]
    temperatures = [repr(deck.number(t, old.line, "MPTEMP")) for t in old.temperatures]
    out.append("MPTEMP")
    for i in range(0, len(values), 6):
        out.append(f"MPTEMP,{i + 1},{','.join(temperatures[i : i + 6])}")
    for i in range(0, len(values), 6):
        out.append(f"MPDATA,{label},{number},{i + 1},{','.join(values[i : i + 6])}")
    return out


def _loss_factor(deck: Deck, number: int, has: Mapping[str, Property], gamma: float) -> list[str]:
    label, factor = _damping_label(deck)
    other = "DMPR" if label == "DMPS" else "DMPS"
    out = [
        f"! old {name} (line {has[name].line}): {', '.join(has[name].values)}"
        for name in ("DMPR", "DMPS")
        if name in has
    ]
    if label == "DMPS":
        out.append(f"! in a release without DMPS: MP,DMPR,{number},{gamma / 2!r}")
        if other in has:  # a damping ratio, which would come on top of it
            out.append(f"MP,DMPR,{number},0.0")
    return [*out, f"MP,{label},{number},{gamma * factor!r}"]


def _damping_label(deck: Deck) -> tuple[str, float]:
    """Return the label of structural damping in the release of the deck, and its share of the loss factor."""
    if any("DMPS" in has for has in deck.materials.values()):
        return "DMPS", 1.0
    year = deck.release if deck.release is not None and deck.release > 1000 else None
    number = deck.release if deck.release is not None and deck.release < 1000 else None
    old = (year is not None and year < _NO_DMPS) or (number is not None and number < 20)
    return ("DMPR", 0.5) if old else ("DMPS", 1.0)


# -- real constants ----------------------------------------------------------------------------------------
def _real(deck: Deck, number: int, change: Mapping[str, float]) -> list[str]:
    old = deck.reals[number]
    routine = _routine(deck, number, old)
    places = _REALS[routine]
    values = list(old.values)
    for quantity, factor in change.items():
        if quantity == "loss_factor":
            if factor:
                raise FormatError(
                    f"real {number}: {_NAMES[routine]} has no place for a loss factor",
                    deck.path,
                    old.line,
                )
            continue
        if quantity not in places:
            if factor != 1.0:
                raise FormatError(
                    f"real {number}: {_NAMES[routine]} has no {quantity}", deck.path, old.line
                )
            continue
        for place in places[quantity]:
            if place <= len(values) and values[place - 1]:
                before = deck.number(
                    values[place - 1], old.line, f"constant {place} of real {number}"
                )
                values[place - 1] = repr(before * factor)
        if factor != 1.0 and not any(
            place <= len(values)
            and values[place - 1]
            and deck.number(values[place - 1], old.line, "constant")
            for place in places[quantity]
        ):
            raise FormatError(
                f"real {number}: {_NAMES[routine]} has no {quantity} to change", deck.path, old.line
            )
    out = [
        f"! {_NAMES[routine]}, old constants (line {old.line}):"
        f" {', '.join(v or '-' for v in old.values)}"
    ]
    out.append(f"R,{number},{','.join(values[:6])}")
    out += [f"RMORE,{','.join(values[i : i + 6])}" for i in range(6, len(values), 6)]
    return out


def _routine(deck: Deck, number: int, old: RealSet) -> int:
    """Return the element routine whose constants a set holds: that of its elements, or the only one of the deck."""
    types = deck.users.get(number) or set(deck.types)
    routines = {deck.types.get(t, 0) for t in types}
    if not deck.users.get(number):
        routines &= set(_REALS)
    if len(routines) == 1 and routines <= set(_REALS):
        return routines.pop()
    found = ", ".join(_NAMES.get(r, str(r)) for r in sorted(routines)) or "none"
    raise FormatError(
        f"real {number}: its constants belong to elements {found}; expected one of"
        f" {', '.join(_NAMES.values())}, whose constants are known",
        deck.path,
        old.line,
    )
