"""Where the grids of a deck stand, in which directions they move, and lines along the edges of the elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import suggest
from updyn.geometry import Geometry
from updyn.io.consistent_units import system
from updyn.io.guard import placed
from updyn.io.nastran.cards import Card
from updyn.io.nastran.deck import SYSTEMS, Deck
from updyn.io.nastran.kinds import ELEMENTS

__all__ = ["geometry_of"]


@dataclass(frozen=True, slots=True)
class _System:
    """A coordinate system: its origin and its axes (rows) in the basic system; kind is R, C or S."""

    kind: str
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]

    def basic(self, given: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the position in the basic system of coordinates in this one; angles in degrees."""
        a, b, c = given
        if self.kind == "C":
            given = np.array([a * np.cos(np.radians(b)), a * np.sin(np.radians(b)), c])
        elif self.kind == "S":
            polar, turn = np.radians(b), np.radians(c)
            given = a * np.array(
                [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)]
            )
        return self.origin + given @ self.axes

    def directions(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the unit vectors (rows) along the coordinates at a position in the basic system."""
        if self.kind == "R":
            return self.axes
        x, y, z = self.axes @ (position - self.origin)
        reach = float(np.hypot(x, y))
        # On its axis the angle has no meaning; Nastran takes that of the x axis.
        cos, sin = (x / reach, y / reach) if reach > 1e-9 * max(abs(z), 1e-30) else (1.0, 0.0)
        outward, around = np.array([cos, sin, 0.0]), np.array([-sin, cos, 0.0])
        if self.kind == "C":
            own = np.array([outward, around, [0.0, 0.0, 1.0]])
        else:
            size = float(np.hypot(reach, z)) or 1.0
            up, flat = z / size, reach / size
            own = np.array([flat * outward + [0, 0, up], up * outward - [0, 0, flat], around])
        return np.asarray(own @ self.axes)


_BASIC = _System("R", np.zeros(3), np.eye(3))


class _Systems:
    """The systems and grids of a deck, each worked out when it is first asked for."""

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._cards: dict[int, Card] = {}
        for card in deck.named(*SYSTEMS):
            number = card.integer(0)
            if number in self._cards:
                raise card.error(f"coordinate system {number} stands twice")
            self._cards[number] = card
        self._systems: dict[int, _System] = {0: _BASIC}
        self._positions: dict[int, NDArray[np.float64]] = {}
        self._open: set[int] = set()
        sets = deck.named("GRDSET")
        self._default_position = sets[0].integer(1, 0) if sets else 0
        self._default_motion = sets[0].integer(5, 0) if sets else 0

    def position(self, node: int, asker: Card) -> NDArray[np.float64]:
        if node not in self._positions:
            card = self._deck.grids.get(node)
            if card is None:
                raise asker.error(f"{asker.name} {asker.text(0)}: no grid {node}")
            system = self.system(card.integer(1, self._default_position), card)
            self._positions[node] = system.basic(np.array([card.real(i, 0.0) for i in (2, 3, 4)]))
        return self._positions[node]

    def motion(self, card: Card) -> _System | None:
        """Return the system in which a grid moves; None: the basic one."""
        number = card.integer(5, self._default_motion)
        if number == -1:
            raise card.error(
                f"GRID {card.text(0)}: a fluid point (field 7 is -1) has no displacements"
            )
        return self.system(number, card) if number else None

    def system(self, number: int, asker: Card) -> _System:
        if number not in self._systems:
            if number not in self._cards:
                known = [str(n) for n in self._cards]
                raise asker.error(
                    f"{asker.name} {asker.text(0)}: no coordinate system {number};"
                    f" {suggest(str(number), known)}"
                )
            if number in self._open:
                raise asker.error(f"coordinate system {number} is defined by itself")
            self._open.add(number)
            self._systems[number] = self._built(self._cards[number])
            self._open.discard(number)
        return self._systems[number]

    def _built(self, card: Card) -> _System:
        if card.name.startswith("CORD1"):
            A, B, C = (self.position(card.integer(i), card) for i in (1, 2, 3))
        else:
            within = self.system(card.integer(1, 0), card)
            A, B, C = (
                within.basic(np.array([card.real(i + k, 0.0) for k in range(3)])) for i in (2, 5, 8)
            )
        up, side = B - A, C - A
        across = np.cross(up, side)
        if np.linalg.norm(across) <= 1e-9 * np.linalg.norm(up) * np.linalg.norm(side):
            raise card.error(f"{card.name} {card.text(0)}: its three points stand on one line")
        z, y = up / np.linalg.norm(up), across / np.linalg.norm(across)
        return _System(card.name[-1], A, np.array([np.cross(y, z), y, z]))


def geometry_of(deck: Deck, unit: str = "m") -> Geometry:
    """Return positions (m, basic system), directions of displacement, and edges of the elements.

    Raises
    ------
    FormatError
        If a coordinate system or a grid is not there, or a system is not one.
    OptionError
        If the unit is not known.
    """
    scale = system(unit).length
    systems = _Systems(deck)
    nodes = sorted(deck.grids)
    with np.errstate(all="ignore"):  # numbers that are out of all bounds are told by the geometry
        positions = [systems.position(node, deck.grids[node]) for node in nodes]
        motions = [systems.motion(deck.grids[node]) for node in nodes]
        axes = None
        if any(m is not None for m in motions):
            axes = np.array(
                [
                    np.eye(3) if m is None else m.directions(p)
                    for m, p in zip(motions, positions, strict=True)
                ]
            )
    with placed(deck.path):
        return Geometry(nodes, np.array(positions).reshape(-1, 3) * scale, _edges(deck), axes)


def _edges(deck: Deck) -> list[tuple[int, int]]:
    found: dict[tuple[int, int], None] = {}
    for card in deck.elements:
        nodes = deck.nodes_of(card)
        for a, b in ELEMENTS[card.name].edges:
            if (
                max(a, b) < len(nodes)
                and nodes[a] != nodes[b]
                and {nodes[a], nodes[b]} <= deck.grids.keys()
            ):
                found[min(nodes[a], nodes[b]), max(nodes[a], nodes[b])] = None
    return list(found)
