"""A loop with backlash or friction as linear pieces, and the `PieceRules` of their transitions.

The state is (x, extra, 1): x of the loop, the twist of the shaft for backlash with damping, and a 1
for constant inputs. A piece dX/dt = F X holds while all its borders, rows times X, are nonnegative.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.control.nonlinear.around import LinearLoop
from updyn.control.nonlinear.nonlinearity import Nonlinearity
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction

__all__ = ["BacklashRules", "FrictionRules", "LinearPiece", "PieceRules", "rules"]

#: The sign of a contact or a motion in the name of its piece.
_SIGN = {1.0: "+", -1.0: "-"}


@dataclass(frozen=True, slots=True, eq=False)
class LinearPiece:
    """One linear piece, with rows of the torque w on the plant and of the motion z, shape (m,)."""

    name: str
    F: RealArray
    borders: RealArray
    w: RealArray
    z: RealArray


class PieceRules(ABC):
    """The pieces of a loop, the first one for a state, and the next one at a border.

    `constant` are the values of the inputs of the loop; `extra` is the number of additional states.
    """

    pieces: Mapping[str, LinearPiece]

    def __init__(self, system: LinearLoop, constant: RealArray, extra: int) -> None:
        n = len(system.A)
        self.n, self.size = n, n + extra + 1
        self.base = np.zeros((self.size, self.size))
        self.base[:n, :n] = system.A
        self.base[:n, -1] = system.E @ constant
        self.push = np.zeros(self.size)
        self.push[:n] = system.B
        self.read = np.zeros(self.size)
        self.read[:n] = system.C
        self.read[-1] = float(system.G @ constant)
        self.one = np.zeros(self.size)
        self.one[-1] = 1.0

    def state(self, x: RealArray) -> RealArray:
        """Return (x, 0, 1)."""
        return np.concatenate([x, np.zeros(self.size - self.n - 1), [1.0]])

    @abstractmethod
    def first(self, X: RealArray) -> str:
        """Return the name of the piece that contains a state."""

    @abstractmethod
    def after(self, piece: str, border: int, X: RealArray) -> tuple[str, RealArray]:
        """Return the next piece after a border is crossed, and the state."""


class BacklashRules(PieceRules):
    """Backlash: gap and two flanks."""

    def __init__(self, system: LinearLoop, law: Backlash, constant: RealArray) -> None:
        damped = law.damping > 0.0
        super().__init__(system, constant, int(damped))
        self.law, self.damped = law, damped
        D, speed = system.D, float(system.C @ system.B)
        pieces = (self._gap(), self._contact(1.0, D, speed), self._contact(-1.0, D, speed))
        self.pieces = {piece.name: piece for piece in pieces}

    def _gap(self) -> LinearPiece:
        F, way = self.base.copy(), self.read.copy()
        if self.damped:
            F[self.n, self.n] = -self.law.stiffness / self.law.damping
            way[self.n] -= 1.0  # motion of the flanks: the twist less that of the shaft
        borders = np.array([self.law.half * self.one - way, self.law.half * self.one + way])
        return LinearPiece("gap", F, borders, np.zeros(self.size), self.read)

    def _contact(self, s: float, D: float, push: float) -> LinearPiece:
        k, c = self.law.stiffness, self.law.damping
        shaft = self.read - s * self.law.half * self.one
        if c == 0.0:
            T = k * shaft / (1.0 + k * D)
        elif D == 0.0:
            T = (k * shaft + c * (self.read @ self.base)) / (1.0 + c * push)
        else:
            # z = read - D T = z_s + s half, T = k z_s + c z_s': the twist of the shaft is an
            # additional state.
            T = shaft / D
            T[self.n] -= 1.0 / D
        F = self.base - np.outer(self.push, T)
        if c > 0.0 and D != 0.0:
            F[self.n] = T / c
            F[self.n, self.n] -= k / c
        return LinearPiece(f"contact {_SIGN[s]}", F, s * T[None], -T, self.read - D * T)

    def first(self, X: RealArray) -> str:
        """Return the gap, or the flank in contact."""
        way = float(self.read @ X)
        if abs(way) <= self.law.half:
            return "gap"
        return "contact +" if way > 0 else "contact -"

    def after(self, piece: str, border: int, X: RealArray) -> tuple[str, RealArray]:
        """Return the flank in contact, or the gap with the last twist of the shaft."""
        if piece == "gap":
            return ("contact +", "contact -")[border], X
        if self.damped:
            s = 1.0 if piece == "contact +" else -1.0
            X = X.copy()
            X[self.n] = float(self.pieces[piece].z @ X) - s * self.law.half
        return "gap", X


class FrictionRules(PieceRules):
    """Friction: rest and two directions of motion."""

    def __init__(self, system: LinearLoop, law: CoulombFriction, constant: RealArray) -> None:
        super().__init__(system, constant, 0)
        self.law = law
        self.gain = float(self.read @ self.push)
        hold = -(self.read @ self.base) / self.gain  # the torque that keeps the velocity at 0
        self.hold = hold
        limits = np.array([law.sticks * self.one - hold, law.sticks * self.one + hold])
        stick = LinearPiece("stick", self.base + np.outer(self.push, hold), limits, hold, self.read)
        pieces = (stick, self._slip(1.0, law.level), self._slip(-1.0, law.level))
        self.pieces = {piece.name: piece for piece in pieces}

    def _slip(self, s: float, level: float) -> LinearPiece:
        w = -s * level * self.one
        return LinearPiece(
            f"slip {_SIGN[s]}",
            self.base + np.outer(self.push, w),
            s * self.read[None],
            w,
            self.read,
        )

    def first(self, X: RealArray) -> str:
        """Return the direction of motion, or the piece that follows rest."""
        v = float(self.read @ X)
        if v == 0:
            return self._at_rest(X)
        return "slip +" if v > 0 else "slip -"

    def _at_rest(self, X: RealArray) -> str:
        held = float(self.hold @ X)
        if abs(held) <= self.law.sticks:
            return "stick"
        return "slip -" if held > 0 else "slip +"

    def after(self, piece: str, border: int, X: RealArray) -> tuple[str, RealArray]:
        """Return the direction of breakaway, or the piece that follows rest."""
        if piece == "stick":
            return ("slip -", "slip +")[border], X
        # Remove the velocity that remains after bisection, along the torque.
        X = X - self.push * float(self.read @ X) / self.gain
        return self._at_rest(X), X


def rules(system: LinearLoop, nonlinearity: Nonlinearity, constant: RealArray) -> PieceRules:
    """Return the pieces of a loop; `constant` are the values of its inputs."""
    if isinstance(nonlinearity, Backlash):
        return BacklashRules(system, nonlinearity, constant)
    return FrictionRules(system, nonlinearity, constant)
