"""What each card of a deck is: elements, their properties and materials, and which fields hold stiffness and mass.

Field numbers here count from 0 behind the name of the card: field 2 of the manuals is 0 (MSC
Nastran Quick Reference Guide, bulk data entries).
"""

from __future__ import annotations

from dataclasses import dataclass

from updyn.io.nastran.cards import Card

__all__ = [
    "ELEMENTS",
    "LOADS",
    "MATERIALS",
    "OWN",
    "PROPERTIES",
    "TIES",
    "Element",
    "Values",
    "materials_of",
    "values",
]


@dataclass(frozen=True, slots=True)
class Element:
    """An element card.

    Parameters
    ----------
    nodes : tuple of int
        Fields of its grids, in order.
    properties : tuple of str
        Property cards it may point to with its second field; empty: it is its own property.
    edges : tuple of (int, int)
        Which of its grids to join by a line in a drawing.
    """

    nodes: tuple[int, ...]
    properties: tuple[str, ...] = ()
    edges: tuple[tuple[int, int], ...] = ()


def _ring(n: int, start: int = 0) -> tuple[tuple[int, int], ...]:
    return tuple((start + i, start + (i + 1) % n) for i in range(n))


def _fields(n: int, start: int = 2) -> tuple[int, ...]:
    return tuple(range(start, start + n))


_LINE = ((0, 1),)
_PRISM = tuple((i, i + 3) for i in range(3))
_BOX = tuple((i, i + 4) for i in range(4))
_SHELL = ("PSHELL", "PCOMP")
_SOLID = ("PSOLID",)

ELEMENTS = {
    "CBAR": Element((2, 3), ("PBAR", "PBARL"), _LINE),
    "CBEAM": Element((2, 3), ("PBEAM", "PBEAML"), _LINE),
    "CROD": Element((2, 3), ("PROD",), _LINE),
    "CTUBE": Element((2, 3), ("PTUBE",), _LINE),
    "CONROD": Element((1, 2), (), _LINE),
    "CBUSH": Element((2, 3), ("PBUSH",), _LINE),
    "CELAS1": Element((2, 4), ("PELAS",), _LINE),
    "CELAS2": Element((2, 4), (), _LINE),
    "CQUAD4": Element(_fields(4), _SHELL, _ring(4)),
    "CQUADR": Element(_fields(4), _SHELL, _ring(4)),
    "CQUAD8": Element(_fields(8), _SHELL, _ring(4)),
    "CTRIA3": Element(_fields(3), _SHELL, _ring(3)),
    "CTRIAR": Element(_fields(3), _SHELL, _ring(3)),
    "CTRIA6": Element(_fields(6), _SHELL, _ring(3)),
    "CSHEAR": Element(_fields(4), ("PSHEAR",), _ring(4)),
    "CTETRA": Element(_fields(10), _SOLID, (*_ring(3), (0, 3), (1, 3), (2, 3))),
    "CPENTA": Element(_fields(15), _SOLID, (*_ring(3), *_ring(3, 3), *_PRISM)),
    "CHEXA": Element(_fields(20), _SOLID, (*_ring(4), *_ring(4, 4), *_BOX)),
    "CONM2": Element((1,)),
    "CMASS2": Element((2, 4)),
    "CDAMP1": Element((2, 4), ("PDAMP",), _LINE),
    "CDAMP2": Element((2, 4), (), _LINE),
}
#: Elements that are their own property: a group each.
OWN = tuple(name for name, e in ELEMENTS.items() if not e.properties)
PROPERTIES = tuple(dict.fromkeys(p for e in ELEMENTS.values() for p in e.properties))
MATERIALS = ("MAT1", "MAT2", "MAT8", "MAT9")
#: Ties between grids, and what holds them; they are of no group.
TIES = ("RBAR", "RBE1", "RBE2", "RBE3", "MPC", "MPCADD", "SPC", "SPC1", "SPCADD")
#: Cards that change neither stiffness nor mass.
LOADS = (
    "ASET", "ASET1", "BNDGRID", "BSET", "BSET1", "CSET", "CSET1", "DAREA", "DCONADD", "DCONSTR", "DELAY", "DESVAR",
    "DLINK", "DLOAD", "DOPTPRM", "DPHASE", "DRESP1", "DRESP2", "DVCREL1", "DVMREL1", "DVPREL1", "ECHOOFF", "ECHOON",
    "EIGC", "EIGP", "EIGR", "EIGRL", "FORCE", "FORCE1", "FORCE2", "FREQ", "FREQ1", "FREQ2", "FREQ3", "FREQ4", "FREQ5",
    "GRAV", "LOAD", "LSEQ", "MODTRAK", "MOMENT", "MOMENT1", "MOMENT2", "OMIT", "OMIT1", "PLOAD", "PLOAD1", "PLOAD2",
    "PLOAD4", "PLOTEL", "QSET", "QSET1", "RANDPS", "RFORCE", "RLOAD1", "RLOAD2", "SEQGP", "SET", "SET1", "SLOAD",
    "SPCD", "SUPORT", "SUPORT1", "TABDMP1", "TABLED1", "TABLED2", "TABLED3", "TABLED4", "TABRND1", "TEMP", "TEMPD",
    "TEMPP1", "TEMPRB", "TIC", "TLOAD1", "TLOAD2", "TSTEP", "USET", "USET1",
)  # fmt: skip

#: Dimensions of the sections of PBARL and PBEAML (Quick Reference Guide, PBARL, figure of
#: sections).
_SECTIONS = {
    "ROD": 1, "TUBE": 2, "TUBE2": 2, "I": 6, "CHAN": 4, "T": 4, "BOX": 4, "BAR": 2, "CROSS": 4, "H": 4, "T1": 4,
    "I1": 4, "CHAN1": 4, "Z": 4, "CHAN2": 4, "T2": 4, "BOX1": 6, "HEXA": 3, "HAT": 4, "HAT1": 5, "DBOX": 10, "L": 4,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Values:
    """Which fields of a card hold what.

    Parameters
    ----------
    stiffness, mass : tuple of int
        Fields to multiply.
    loss : tuple of int
        Fields of the loss factor GE.
    viscous : tuple of int
        Fields to multiply with the viscous damping.
    """

    stiffness: tuple[int, ...] = ()
    mass: tuple[int, ...] = ()
    loss: tuple[int, ...] = ()
    viscous: tuple[int, ...] = ()


_VALUES = {
    "MAT1": Values((1, 2), (4,), (7,)),
    "MAT2": Values(tuple(range(1, 7)), (7,), (12,)),
    "MAT8": Values((1, 2, 4, 5, 6), (7,), (16,)),
    "MAT9": Values(tuple(range(1, 22)), (22,), (30,)),
    "PBAR": Values((), (6,)),
    "PROD": Values((), (5,)),
    "PTUBE": Values((), (4,)),
    "CONROD": Values((), (7,)),
    "PSHEAR": Values((), (3,)),
    "PSHELL": Values((), (7,)),
    "PCOMP": Values((), (2,), (6,)),
    "PSOLID": Values(),
    "PELAS": Values((1,), (), (2,)),
    "CELAS2": Values((1,), (), (6,)),
    "CONM2": Values((), (3, 8, 9, 10, 11, 12, 13)),
    "CMASS2": Values((), (1,)),
    "PDAMP": Values(viscous=(1,)),
    "CDAMP2": Values(viscous=(1,)),
}


def values(card: Card) -> Values:
    """Return which fields of a property or material card hold stiffness, mass and loss factor.

    Raises
    ------
    FormatError
        If the section of a PBARL or PBEAML is not known, or a PBUSH holds what is not read.
    """
    if card.name == "PBARL":
        return Values((), (8 + _section(card),))
    if card.name == "PBEAML":
        n = (
            _section(card) + 1
        )  # the dimensions of a station and its mass; from the second on SO and X/XB before them
        return Values((), (8 + n - 1, *range(8 + 2 * n + 1, len(card.fields), n + 2)))
    if card.name == "PBEAM":
        return Values((), _masses_of_pbeam(card))
    if card.name == "PBUSH":
        return _values_of_pbush(card)
    return _VALUES[card.name]


def _section(card: Card) -> int:
    kind = card.text(3)
    if kind not in _SECTIONS:
        raise card.error(
            f"{card.name} {card.text(0)}: section {kind!r}; known: {', '.join(_SECTIONS)}"
        )
    return _SECTIONS[kind]


def _masses_of_pbeam(card: Card) -> tuple[int, ...]:
    stations = ("YES", "YESA", "NO")
    at = 8 if card.text(8) in stations else 16  # the line of stress points may be left out
    found = [7]
    while card.text(at) in stations:
        found.append(at + 7)
        # The line of stress points of a station follows only SO = YES.
        at += 16 if card.text(at) == "YES" else 8
    return (*found, at + 4, at + 5)


def _values_of_pbush(card: Card) -> Values:
    stiffness: tuple[int, ...] = ()
    loss: tuple[int, ...] = ()
    viscous: tuple[int, ...] = ()
    for at in range(1, len(card.fields), 8):
        kind = card.text(at)
        six = tuple(i for i in range(at + 1, at + 7) if card.text(i))
        if kind == "K":
            stiffness = six
        elif kind == "GE":
            loss = six
        elif kind == "B":
            viscous = six
        elif kind == "M" and any(card.real(i) for i in six):
            raise card.error(
                f"PBUSH {card.text(0)}: M (field {at + 2}) is not read; expected K, B and GE only"
            )
        elif kind not in ("M", "RCV", "T", ""):
            raise card.error(
                f"PBUSH {card.text(0)}: field {at + 2} is {kind!r}; expected K, B or GE"
            )
    return Values(stiffness, (), loss, viscous)


def materials_of(card: Card) -> tuple[int, ...]:
    """Return the fields of a property card (or a CONROD) that name materials."""
    if card.name == "PSHELL":
        fields: tuple[int, ...] = (1, 3, 5, 10)
    elif card.name == "PCOMP":
        fields = tuple(range(8, len(card.fields), 4))
    elif card.name == "CONROD":
        fields = (3,)
    elif card.name in ("PBUSH", "PDAMP", "PELAS", *(n for n in OWN if n != "CONROD")):
        fields = ()
    else:
        fields = (1,)
    return tuple(i for i in fields if card.text(i))
