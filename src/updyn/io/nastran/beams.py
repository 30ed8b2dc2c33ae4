"""Beams of constant section as bars: CBEAM with PBEAM or PBEAML as CBAR with PBAR.

Both have the same stiffness if shear centre, neutral axis and grids are on one line and the section
does not warp (MSC Nastran Quick Reference Guide, CBEAM and PBEAM, remarks). The lumped mass of a
CBEAM has in addition the inertia of the section about the axis, rho (I1 + I2) L / 2 at each end.
A PBARL of section ROD or TUBE becomes a PBAR too, because MYSTRAN has other factors of shear
stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.io.nastran.cards import NastranCard
from updyn.io.nastran.deck import (
    PUNCHED_MATRICES,
    NastranDeck,
    build_geometry,
    section_fields,
)
from updyn.io.nastran.fields import format_field
from updyn.io.settings import DECK

__all__ = ["convert_beams"]

#: Fields of a PBEAM at one end, from A on, and those of a PBAR.
_SECTION = ("A", "I1", "I2", "I12", "J", "NSM")
#: Fields of a PBEAM after its stations.
_REST = (
    *("K1", "K2", "S1", "S2", "NSI(A)", "NSI(B)", "CW(A)", "CW(B)"),
    *("M1(A)", "M2(A)", "M1(B)", "M2(B)", "N1(A)", "N2(A)", "N1(B)", "N2(B)"),
)
#: Sections of PBEAML that are converted, with their factors of shear stiffness. They follow from
#: the energy of the shear stresses of bending, I^2 / (A int (Q / b)^2 dA): 9/10 of a solid circle,
#: 1/2 of a tube with a thin wall, 5/6 of a rectangle. Only ROD is compared with Nastran, in a test.
_SHEAR_FACTORS = {"ROD": 0.9, "TUBE": 0.5, "BAR": 5.0 / 6.0}
_STATIONS = ("YES", "YESA", "NO")
_WIDTH = 16


@dataclass(frozen=True, slots=True)
class _Section:
    """A constant section of a beam: its card for a bar, and I1 + I2."""

    card: NastranCard
    polar: float


def convert_beams(deck: NastranDeck, cards: Iterable[NastranCard]) -> list[NastranCard]:
    """Return cards with bars and inertias in place of beams, and round sections as PBAR."""
    given = [_convert_round_bar(card) for card in cards]
    beams = [card for card in given if card.name == "CBEAM"]
    if not beams:
        return [card for card in given if card.name not in ("PBEAM", "PBEAML")]
    properties = {c.integer(0): c for c in given if c.name in ("PBEAM", "PBEAML")}
    used = sorted({_property_of(card) for card in beams})
    sections = {number: _convert_section(properties[number]) for number in used}
    densities = {c.integer(0): c.real(4, 0.0) for c in given if c.name == "MAT1"}
    ends = _Ends.of(deck)
    number = max(card.integer(0) for card in deck.elements)
    out = [card for card in given if card.name not in ("CBEAM", "PBEAM", "PBEAML")]
    out += [section.card for section in sections.values()]
    for card in beams:
        _check_element(card)
        section = sections[_property_of(card)]
        out.append(NastranCard("CBAR", card.fields[:7], card.lines))
        rho = densities.get(section.card.integer(1), 0.0)
        for inertia in ends.list_inertias(card, rho * section.polar, number + 1):
            out.append(inertia)
            number += 1
    return out


def _convert_round_bar(card: NastranCard) -> NastranCard:
    """Return the PBAR of a PBARL with a round section; other cards unchanged."""
    if card.name == "PBARL" and card.text(3) in ("ROD", "TUBE"):
        return _convert_pbeaml(card).card  # a PBARL is laid out as a PBEAML without stations
    return card


def _property_of(beam: NastranCard) -> int:
    return beam.integer(1, beam.integer(0))


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Basic positions of the grids in the unit of the deck."""

    position: dict[int, RealArray]

    @classmethod
    def of(cls, deck: NastranDeck) -> _Ends:
        geometry = build_geometry(deck)
        return cls(dict(zip(geometry.nodes.tolist(), geometry.xyz, strict=True)))

    def list_inertias(self, beam: NastranCard, density: float, number: int) -> list[NastranCard]:
        """Return the inertias about the axis at both ends; `density` is rho (I1 + I2)."""
        if not density:
            return []
        nodes = beam.integers((2, 3))
        span = self.position[nodes[1]] - self.position[nodes[0]]
        length = float(np.linalg.norm(span))
        if not length:
            raise beam.error(f"CBEAM {beam.text(0)}: its grids coincide; expected a length")
        x, y, z = span / length
        half = density * length / 2
        # The products of inertia of a CONM2 have the opposite sign in its mass matrix.
        tensor = half * np.array([x * x, -x * y, y * y, -x * z, -y * z, z * z])
        values = [format_field(float(value), _WIDTH) for value in tensor]
        cards = []
        for k, node in enumerate(nodes):
            fields = (str(number + k), str(node), "", "0.", "", "", "", "", *values)
            cards.append(NastranCard("CONM2", fields, beam.lines))
        return cards


def _refuse(card: NastranCard, why: str) -> None:
    raise card.error(
        f"{card.name} {card.text(0)}: {why}, so that it is not equal to a CBAR, and MYSTRAN has no"
        f" CBEAM; {PUNCHED_MATRICES}"
    )


def _check_element(card: NastranCard) -> None:
    """Refuse a beam with offsets, releases, warping or a general orientation."""
    if card.text(7) not in ("", "GGG"):
        _refuse(card, f"field 9 (OFFT or BIT) is {card.text(7)!r}")
    if card.text(8) or card.text(9):
        _refuse(card, "it has pin flags (PA, PB)")
    if any(card.reals(range(10, 16), 0.0)):
        _refuse(card, "its ends have offsets (W1A to W3B)")
    if card.text(16) or card.text(17):
        _refuse(card, "it has warping degrees of freedom (SA, SB)")


def _convert_section(card: NastranCard) -> _Section:
    return _convert_pbeam(card) if card.name == "PBEAM" else _convert_pbeaml(card)


def _convert_pbeam(card: NastranCard) -> _Section:
    """Return the PBAR of a PBEAM with a constant, symmetric section."""
    at_a = dict(zip(_SECTION, card.reals(range(2, 8), 0.0), strict=True))
    at = 8 if card.text(8) in _STATIONS else 16  # the line of stress points is optional
    while card.text(at) in _STATIONS:
        for k, name in enumerate(_SECTION):
            if card.text(at + 2 + k) and not _is_equal(card.real(at + 2 + k), at_a[name]):
                _refuse(card, f"its section is not constant ({name})")
        # A station has a line of stress points only if SO = YES.
        at += 16 if card.text(at) == "YES" else 8
    rest = dict(zip(_REST, range(at, at + len(_REST)), strict=True))
    for name in _REST[2:]:
        if card.real(rest[name], 0.0):
            _refuse(card, f"{name} is {card.real(rest[name]):g}")
    A, I1, I2, I12, J, NSM = (card.text(k) for k in range(2, 8))
    factors = [card.text(rest[name], "1.") for name in ("K1", "K2")]
    fields = (card.text(0), card.text(1), A, I1, I2, J, NSM, *[""] * 9, *factors, I12)
    return _Section(NastranCard("PBAR", fields, card.lines), at_a["I1"] + at_a["I2"])


def _is_equal(value: float, at_a: float) -> bool:
    return abs(value - at_a) <= DECK.section_tolerance * abs(at_a)


def _convert_pbeaml(card: NastranCard) -> _Section:
    """Return the PBAR of a PBEAML with a constant, round, tubular or rectangular section."""
    kind = card.text(3)
    n = section_fields(card)
    if kind not in _SHEAR_FACTORS:
        _refuse(card, f"section {kind!r} is not one of {', '.join(_SHEAR_FACTORS)}")
    dimensions = card.reals(range(8, 8 + n + 1), 0.0)
    for start in range(8 + n + 1, len(card.fields), n + 3):
        for k, value in enumerate(dimensions):
            at = start + 2 + k
            if card.text(at) and not _is_equal(card.real(at), value):
                _refuse(card, "its section is not constant")
    *sizes, nsm = dimensions
    A, I1, I2, J = _SHAPES[kind](*sizes)
    factor = _SHEAR_FACTORS[kind]
    values = [format_field(value, _WIDTH) for value in (A, I1, I2, J, nsm)]
    shear = [format_field(factor, _WIDTH)] * 2
    fields = (card.text(0), card.text(1), *values, *[""] * 9, *shear)
    return _Section(NastranCard("PBAR", fields, card.lines), I1 + I2)


def _measure_tube(outer: float, inner: float = 0.0) -> tuple[float, float, float, float]:
    """Return A, I1, I2 and J of a round section of given radii."""
    second = math.pi * (outer**4 - inner**4) / 4
    return math.pi * (outer**2 - inner**2), second, second, 2 * second


def _measure_bar(width: float, height: float) -> tuple[float, float, float, float]:
    """Return A, I1, I2 and J of a solid rectangle (Roark's Formulas for Stress and Strain)."""
    b, d = sorted((width, height))
    J = d * b**3 * (1 / 3 - 0.21 * b / d * (1 - b**4 / (12 * d**4)))
    return width * height, width * height**3 / 12, height * width**3 / 12, J


_SHAPES: dict[str, Callable[..., tuple[float, float, float, float]]] = {
    "ROD": _measure_tube,
    "TUBE": _measure_tube,
    "BAR": _measure_bar,
}
