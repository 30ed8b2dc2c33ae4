"""Changes of groups as cards of an input deck, for CalculiX and Abaqus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from updyn.errors import FormatError, suggest
from updyn.io.atomic import atomic_path
from updyn.io.changes import check_changes
from updyn.io.keyword_deck.cards import KeywordCard, format_number
from updyn.io.keyword_deck.structure import KeywordProperty

__all__ = ["write_changes"]


def write_changes(
    changes: Mapping[str, Mapping[str, float]],
    parts: Mapping[str, KeywordProperty],
    deck: Path,
    path: Path,
    *,
    own_rayleigh: bool,
    remarks: Sequence[str] = (),
) -> None:
    """Write the cards of the changed parts, with their old values as comments.

    `own_rayleigh` is whether ALPHA and BETA belong to a material; otherwise a factor on viscous
    damping is refused. `remarks` are further lines of the heading.
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
        lines += _block(part, change, _new_cards(part, change, own_rayleigh))
    heading = [
        f"** New properties for {deck.name}: {', '.join(changed)}.",
        (
            "** They replace the cards of the same names: delete those, and insert at the first"
            " of them"
        ),
        f"** *INCLUDE, INPUT={path.name}",
    ]
    heading += [f"** {remark}" for remark in remarks]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*heading, *lines, ""]), encoding="utf-8")


def _check(part: KeywordProperty, change: Mapping[str, float], own_rayleigh: bool) -> None:
    """Refuse changes of quantities that a part does not have."""
    where = f"group {part.name!r}"
    for quantity, value in change.items():
        if quantity in ("stiffness", "mass") and value != 1.0 and not part.values(quantity):
            lacks = quantity
            if part.kind == "material":
                lacks = "*ELASTIC" if quantity == "stiffness" else "*DENSITY"
            raise part.cards[0].error(f"{where} has no {lacks} to change")
    if change.get("loss_factor") and part.kind != "material":
        raise part.cards[0].error(f"{where}: *{part.cards[0].name} cannot hold a loss factor")
    if change.get("viscous", 1.0) != 1.0:
        if part.kind != "material" or not own_rayleigh:
            raise part.cards[0].error(
                f"{where}: ALPHA and BETA apply to the whole deck; the viscous damping of one group"
                " cannot be changed"
            )
        if not (part.damping_parameter("ALPHA") or part.damping_parameter("BETA")):
            raise part.cards[0].error(f"{where} has no *DAMPING with ALPHA or BETA to change")


def _new_cards(
    part: KeywordProperty, change: Mapping[str, float], own_rayleigh: bool
) -> tuple[KeywordCard, ...]:
    stiffness = change.get("stiffness", 1.0)
    mass = change.get("mass", 1.0)
    viscous = change.get("viscous", 1.0)
    cards = part.scale_cards(stiffness, mass)
    if part.kind != "material":
        return cards
    values = {}
    # A material without damping needs no card.
    gamma = change.get("loss_factor")
    if gamma is not None and (gamma or part.damping_parameter("STRUCTURAL")):
        values["STRUCTURAL"] = float(gamma)
    # C = ALPHA M + BETA K with the new M and K has to be the factor times the old C.
    for name, factor in (("ALPHA", viscous / mass), ("BETA", viscous / stiffness)):
        if own_rayleigh and part.damping_parameter(name) and factor != 1.0:
            values[name] = part.damping_parameter(name) * factor
    return part.set_damping(cards, values)


def _block(
    part: KeywordProperty, change: Mapping[str, float], cards: tuple[KeywordCard, ...]
) -> list[str]:
    """Return the lines of a part: its change and its old values as comments, its new cards."""
    comments = []
    for quantity, value in change.items():
        sign = "=" if quantity == "loss_factor" else "x"
        comments.append(f"{quantity} {sign} {format_number(value)}")
    out = ["**", f"** {part.kind} {part.name}: {', '.join(comments) or 'unchanged'}"]
    for what, label in (("stiffness", "modulus"), ("mass", "density")):
        old = part.values(what)
        if old:
            word = label if part.kind == "material" else what
            out.append(f"** old {word}: {', '.join(map(format_number, old[:9]))}")
    damping = part.card("DAMPING")
    if damping is not None:
        shown = ", ".join(f"{name}={value}" for name, value in damping.parameters.items())
        out.append(f"** old damping: {shown}")
    for card in cards:
        out += card.text()
    return out
