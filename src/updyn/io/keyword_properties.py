"""Properties of an input deck that can be scaled: materials, springs and point masses, each a group of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from updyn.errors import suggest
from updyn.io.keyword_cards import Card, Row, number, short_number

__all__ = ["Property", "read_properties"]

#: What may stand below ``*MATERIAL`` and does not make it nonlinear.
LINEAR = ("ELASTIC", "DENSITY", "DAMPING", "EXPANSION", "CONDUCTIVITY", "SPECIFIC HEAT")
#: What may stand there besides.
NONLINEAR = (
    "PLASTIC",
    "CYCLIC HARDENING",
    "CREEP",
    "DEFORMATION PLASTICITY",
    "HYPERELASTIC",
    "HYPERFOAM",
    "VISCOELASTIC",
    "VISCO",
    "USER MATERIAL",
    "DEPVAR",
    "MOHR COULOMB",
    "MOHR COULOMB HARDENING",
    "MOHR COULOMB TENSION CUTOFF",
    "RATE DEPENDENT",
    "DAMAGE INITIATION",
    "DAMAGE EVOLUTION",
)
_OTHER = (
    "ELECTRICAL CONDUCTIVITY",
    "MAGNETIC PERMEABILITY",
    "FLUID CONSTANTS",
    "SPECIFIC GAS CONSTANT",
)
#: Of each line of ``*ELASTIC`` (and of those that continue it) the fields that are moduli.
_MODULI = {
    "ISO": ((0,),),
    "ISOTROPIC": ((0,),),
    "ENGINEERING CONSTANTS": ((0, 1, 2, 6, 7), (0,)),
    "ORTHO": (tuple(range(8)), (0,)),
    "ORTHOTROPIC": (tuple(range(8)), (0,)),
    "ANISO": (tuple(range(8)), tuple(range(8)), tuple(range(5))),
    "ANISOTROPIC": (tuple(range(8)), tuple(range(8)), tuple(range(5))),
}


@dataclass(frozen=True, slots=True)
class Property:
    """A material, the springs or the masses of an element set.

    Parameters
    ----------
    name : str
        As it is written: of the material, else of the element set.
    kind : {"material", "spring", "mass"}
        What it is.
    at : int
        Position of its first card among those of the model.
    cards : tuple of Card
        Its cards, which follow each other.
    start : int
        Of a spring: the line, counted from 0, from which on spring constants stand; above it are
        its directions.
    """

    name: str
    kind: str
    at: int
    cards: tuple[Card, ...]
    start: int = 0

    def card(self, name: str) -> Card | None:
        """Return the card of a name, or None."""
        return next((card for card in self.cards if card.name == name), None)

    def damping(self, parameter: str) -> float:
        """Return STRUCTURAL, ALPHA or BETA of the material's ``*DAMPING``, 0 where it has none.

        Raises
        ------
        FormatError
            If it is not a number of at least 0.
        """
        card = self.card("DAMPING")
        text = None if card is None else card.get(parameter)
        if card is None or text is None:
            return 0.0
        value = number(text, card, Row(card.line, text))
        if value < 0:
            raise card.error(f"*DAMPING: {parameter}={text}; expected at least 0")
        return value

    def values(self, what: str) -> list[float]:
        """Return the moduli ("stiffness") or densities ("mass") in order; empty where there are none.

        Raises
        ------
        FormatError
            If one is not a number.
        """
        return [
            number(card.rows[i].fields[j], card, card.rows[i]) for card, i, j in self._places(what)
        ]

    def first(self, what: str) -> float | None:
        """Return the first modulus or density, None where there is none."""
        return next(iter(self.values(what)), None)

    def scaled(self, stiffness: float = 1.0, mass: float = 1.0) -> tuple[Card, ...]:
        """Return the cards with all moduli and all densities multiplied; numbers that stay are left as written.

        Parameters
        ----------
        stiffness, mass : float
            Factors.

        Returns
        -------
        tuple of Card
            In the same order.

        Raises
        ------
        FormatError
            If one is not a number.
        """
        out = {id(card): card for card in self.cards}
        for what, factor in (("stiffness", stiffness), ("mass", mass)):
            if factor == 1.0:
                continue
            for card, i, j in self._places(what):
                now = out[id(card)]
                rows = list(now.rows)
                fields = rows[i].fields
                fields[j] = short_number(factor * number(fields[j], card, card.rows[i]))
                rows[i] = replace(rows[i], text=", ".join(fields))
                out[id(card)] = replace(now, rows=tuple(rows))
        return tuple(out[id(card)] for card in self.cards)

    def damped(self, cards: Sequence[Card], values: Mapping[str, float]) -> tuple[Card, ...]:
        """Return cards of this material with parameters of ``*DAMPING`` set, the card added where there is none."""
        if not values:
            return tuple(cards)
        texts = {name: short_number(value) for name, value in values.items()}
        own = self.card("DAMPING")
        if own is None:
            last = cards[-1]
            return (*cards, Card("DAMPING", MappingProxyType(texts), (), last.path, last.line))
        both = MappingProxyType({**own.parameters, **texts})
        return tuple(
            replace(card, parameters=both) if card.name == "DAMPING" else card for card in cards
        )

    def _places(self, what: str) -> list[tuple[Card, int, int]]:
        """Return card, line and field of every number of a quantity."""
        if self.kind == "mass":
            return (
                [(self.cards[0], i, 0) for i in range(len(self.cards[0].rows))]
                if what == "mass"
                else []
            )
        if self.kind == "spring":
            own = self.cards[0]
            return (
                [(own, i, 0) for i in range(self.start, len(own.rows))]
                if what == "stiffness"
                else []
            )
        card = self.card("ELASTIC" if what == "stiffness" else "DENSITY")
        if card is None:
            return []
        pattern = _pattern(card) if what == "stiffness" else ((0,),)
        places = []
        for i, row in enumerate(card.rows):
            wanted = pattern[i % len(pattern)]
            if len(row.fields) <= max(wanted):
                raise card.error(
                    f"*{card.name}: found {row.text!r}; expected {max(wanted) + 1} numbers or more",
                    row,
                )
            places += [(card, i, j) for j in wanted]
        if len(card.rows) % len(pattern):
            raise card.error(
                f"*{card.name}: the last of {len(pattern)} lines is missing", card.rows[-1]
            )
        return places


def _pattern(card: Card) -> tuple[tuple[int, ...], ...]:
    kind = (card.get("TYPE") or "ISO").upper()
    if kind not in _MODULI:
        raise card.error(f"*ELASTIC: TYPE={kind} is not read; {suggest(kind, _MODULI)}")
    return _MODULI[kind]


def read_properties(
    model: Sequence[Card],
    springs_between: Mapping[str, str] | None = None,
    *,
    own_rayleigh: bool = True,
) -> dict[str, Property]:
    """Find the materials, springs and point masses of a deck.

    Parameters
    ----------
    model : sequence of Card
        The cards before the first step.
    springs_between : mapping of str to str, optional
        Element type by element set in capitals. Springs of type SPRINGA have no line of directions;
        where the type is not known a first line of whole numbers is one.
    own_rayleigh : bool
        Whether ALPHA and BETA of ``*DAMPING`` are of the material above (Abaqus), or of the deck
        wherever they stand (CalculiX).

    Returns
    -------
    dict of str to Property
        By name in capitals, in the order of the deck.

    Raises
    ------
    FormatError
        If a name stands twice.
    """
    out: dict[str, Property] = {}
    for at, card in enumerate(model):
        if card.name == "MATERIAL":
            stop = at + 1
            while stop < len(model) and model[stop].name in (*LINEAR, *NONLINEAR, *_OTHER):
                stop += 1
            while (
                not own_rayleigh
                and model[stop - 1].name == "DAMPING"
                and not model[stop - 1].get("STRUCTURAL")
            ):
                stop -= 1
            found = Property(card.need("NAME"), "material", at, tuple(model[at:stop]))
        elif card.name == "SPRING":
            name = card.need("ELSET")
            kind = (springs_between or {}).get(name.upper())
            found = Property(name, "spring", at, (card,), _first_constant(card, kind))
        elif card.name == "MASS":
            found = Property(card.need("ELSET"), "mass", at, (card,))
        else:
            continue
        key = found.name.upper()
        if key in out:
            raise card.error(
                f"*{card.name}: {found.name!r} stands twice, also on line {out[key].cards[0].line}"
            )
        out[key] = found
    return out


def _first_constant(card: Card, kind: str | None) -> int:
    if not card.rows:
        raise card.error("*SPRING has no spring constant")
    has_directions = (
        all(f.isdecimal() for f in card.rows[0].fields if f) if kind is None else kind != "SPRINGA"
    )
    return 1 if has_directions and len(card.rows) > 1 else 0
