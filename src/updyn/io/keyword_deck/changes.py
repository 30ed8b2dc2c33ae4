"""Changes of groups as cards of an input deck, for CalculiX and Abaqus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.io.atomic import atomic_path
from updyn.io.changes import check_changes
from updyn.io.keyword_deck.cards import Card, short_number
from updyn.io.keyword_deck.structure import Property

__all__ = ["write_changes"]


def write_changes(
    changes: Mapping[str, Mapping[str, float]],
    parts: Mapping[str, Property],
    deck: Path,
    path: Path,
    *,
    own_rayleigh: bool,
    remarks: Sequence[str] = (),
) -> None:
    """Write the cards of the parts that change, with their old values as comments.

    Parameters
    ----------
    changes : mapping of str to mapping of str to float
        By group: factors "stiffness", "mass", "viscous", and the value "loss_factor".
    parts : mapping of str to Property
        What the deck has, by name in capitals.
    deck : Path
        The deck, for messages and for the heading.
    path : Path
        The file to write.
    own_rayleigh : bool
        Whether a material has its own ALPHA and BETA; else a factor on viscous damping is refused.
    remarks : sequence of str
        What the heading says besides.

    Raises
    ------
    FormatError
        If a group or a quantity is not there, or a number is not usable.
    """
    check_changes(changes, deck)
    lines: list[str] = []
    changed = []
    for name, change in changes.items():
        part = parts.get(name.upper())
        if part is None:
            near = suggest(name, [p.name for p in parts.values()])
            raise FormatError(f"the deck has no material, spring or mass {name!r}; {near}", deck)
        _check(part, change, own_rayleigh)
        changed.append(part.name)
        lines += _block(part, change, _changed(part, change, own_rayleigh))
    heading = [
        f"** New properties for {deck.name}: {', '.join(changed)}.",
        (
            "** They take the place of the cards of the same names there: delete those, and where"
            " the first stood write"
        ),
        f"** *INCLUDE, INPUT={path.name}",
    ]
    heading += [f"** {remark}" for remark in remarks]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*heading, *lines, ""]), encoding="utf-8")


def _check(part: Property, change: Mapping[str, float], own_rayleigh: bool) -> None:
    """Refuse changes of what a part does not have."""
    where = f"group {part.name!r}"
    for quantity, value in change.items():
        if quantity in ("stiffness", "mass") and value != 1.0 and not part.values(quantity):
            lacks = quantity
            if part.kind == "material":
                lacks = "*ELASTIC" if quantity == "stiffness" else "*DENSITY"
            raise part.cards[0].error(f"{where} has no {lacks} to change")
    if change.get("loss_factor") and part.kind != "material":
        raise part.cards[0].error(f"{where}: *{part.cards[0].name} has no place for a loss factor")
    if change.get("viscous", 1.0) != 1.0:
        if part.kind != "material" or not own_rayleigh:
            raise part.cards[0].error(
                f"{where}: ALPHA and BETA hold for the whole deck, so that the viscous damping of"
                " one group cannot be changed in it"
            )
        if not (part.damping("ALPHA") or part.damping("BETA")):
            raise part.cards[0].error(f"{where} has no *DAMPING with ALPHA or BETA to change")


def _changed(part: Property, change: Mapping[str, float], own_rayleigh: bool) -> tuple[Card, ...]:
    stiffness = change.get("stiffness", 1.0)
    mass = change.get("mass", 1.0)
    viscous = change.get("viscous", 1.0)
    cards = part.scaled(stiffness, mass)
    if part.kind != "material":
        return cards
    values = {}
    # A material without damping needs no card that says so.
    gamma = change.get("loss_factor")
    if gamma is not None and (gamma or part.damping("STRUCTURAL")):
        values["STRUCTURAL"] = float(gamma)
    # C = ALPHA M + BETA K of the new M and K, and is to be the factor times the old C.
    for name, factor in (("ALPHA", viscous / mass), ("BETA", viscous / stiffness)):
        if own_rayleigh and part.damping(name) and factor != 1.0:
            values[name] = part.damping(name) * factor
    return part.damped(cards, values)


def _block(part: Property, change: Mapping[str, float], cards: tuple[Card, ...]) -> list[str]:
    """Return the lines of a part: its change and its old values as comments, its new cards."""
    said = []
    for quantity, value in change.items():
        sign = "=" if quantity == "loss_factor" else "x"
        said.append(f"{quantity} {sign} {short_number(value)}")
    out = ["**", f"** {part.kind} {part.name}: {', '.join(said) or 'unchanged'}"]
    for what, label in (("stiffness", "modulus"), ("mass", "density")):
        old = part.values(what)
        if old:
            word = label if part.kind == "material" else what
            out.append(f"** old {word}: {', '.join(map(short_number, old[:9]))}")
    damping = part.card("DAMPING")
    if damping is not None:
        shown = ", ".join(f"{name}={value}" for name, value in damping.parameters.items())
        out.append(f"** old damping: {shown}")
    for card in cards:
        out += card.text()
    return out
