"""A sensor with several directions that was turned about an axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import FORCE, Fault
from updyn.updating.judge.causes.settings import CHANNEL_FAULT
from updyn.updating.judge.settings import SIGNIFICANCE

__all__ = ["TurnedSensor", "list_rotation_axes"]


class TurnedSensor(Fault):
    """The sensor or the force at a node is turned about an axis by `value` degrees.

    ``"3:Z"`` turns the responses of node 3 about Z, ``"force 3:Z"`` its references. A positive
    angle follows the right-hand rule: after a rotation by 90 degrees about Z, the label X is along
    Y.
    """

    __slots__ = ()

    kind: ClassVar[str] = "turned"
    unit: ClassVar[str] = "degrees"
    has_free_size: ClassVar[bool] = True
    is_adaptive: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each axis with both perpendicular directions at a node, with its best angle."""
        frf = evidence.frf
        sides = [(frf.responses, ""), (frf.references, FORCE)]
        rows, columns = (
            [f"{prefix}{dof}" for dof in list_rotation_axes(dofs)] for dofs, prefix in sides
        )
        both = [(one, f"{FORCE}{one}") for one in rows if f"{FORCE}{one}" in columns]
        for channels in [*((one,) for one in (*rows, *columns)), *both]:
            fault = cls(channels).adapt_to(evidence)
            if fault.is_plausible():
                yield fault

    def adapt_to(self, evidence: Evidence) -> Self:
        """Return the fault with the best-fitting angle at a point."""
        # If the directions are not coupled, the transverse response is zero, and the derivative of
        # its logarithm does not lead to the angle.
        return replace(
            self, value=_find_best_angle(_ChannelRotation.of(self.channels, evidence.frf), evidence)
        )

    def repair(self, frf: FRF) -> FRF:
        """Return the data in the directions that the labels state."""
        turn = _ChannelRotation.of(self.channels, frf)
        left, right = (
            side.rotation(-np.radians(self.value)) for side in (turn.responses, turn.references)
        )
        variance, coherence = frf.variance, frf.coherence
        if variance is not None:
            variance = left**2 @ variance @ (right**2).T
        if coherence is not None:
            # The coherence of a mixture is at most the smallest of its parts.
            worst = np.where(left[:, :, None] != 0.0, coherence[:, None], 1.0).min(axis=2)
            mixed = right.T[None, None] != 0.0
            coherence = np.where(mixed, worst[:, :, :, None], 1.0).min(axis=2)
        values = left @ frf.values @ right.T
        return replace(frf, values=values, variance=variance, coherence=coherence)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return d ln(measured) / d angle, from the model, shape (n_f, n_i, n_j)."""
        frf, H = evidence.frf, evidence.model_response(evidence.frf)
        assert frf.variance is not None
        turn = _ChannelRotation.of(self.channels, frf)
        change = turn.responses.generator @ H + H @ turn.references.generator.T
        # A response below the noise has no logarithm.
        size = np.maximum(np.abs(H) ** 2, SIGNIFICANCE.stds**2 * frf.variance)
        size = np.maximum(size, np.finfo(np.float64).tiny)
        return np.asarray(np.radians(1.0) * change * H.conj() / size)

    def is_plausible(self) -> bool:
        """Return whether the angle exceeds the transverse sensitivity, and is not a full turn."""
        return CHANNEL_FAULT.least_turn <= abs(self.value) <= 180.0 + CHANNEL_FAULT.least_turn

    def statement(self) -> str:
        """Return a sentence with sensor, axis and angle, and equivalent faults."""
        dofs = [Dof.parse(label.removeprefix(FORCE)) for label in self.channels]
        things = ["force" if label.startswith(FORCE) else "sensor" for label in self.channels]
        node, axis = dofs[0].node, dofs[0].direction
        verb = "is" if len(things) == 1 else "are"
        text = (
            f"The {' and the '.join(things)} at node {node} {verb} turned about {axis} by"
            f" {self.value:.3g} degrees."
        )
        first, second = (f"{node}:{direction}" for direction in _list_perpendicular(axis))
        if abs(abs(self.value) - 90.0) < CHANNEL_FAULT.least_turn:
            opposite = second if self.value > 0.0 else first
            text += (
                f" By 90 degrees that is the same as {first} and {second} exchanged, with the sign"
                f" of {opposite} changed."
            )
        if abs(abs(self.value) - 180.0) < CHANNEL_FAULT.least_turn:
            text += f" By 180 degrees that is the same as opposite signs of {first} and {second}."
        return text

    @classmethod
    def parse(cls, channels: str, value: str) -> Self:
        """Return the fault from its text."""
        found = super().parse(channels, value)
        axes = [Dof.parse(name.removeprefix(FORCE)).direction for name in found.channels]
        if not axes or any(axis.startswith("R") for axis in axes):
            raise OptionError(
                f"repair {cls.kind!r}: expected a node and the axis X, Y or Z of the turn, as in"
                f" 'turned:3:Z=30', found {channels!r}"
            )
        return found


def _list_perpendicular(axis: str) -> tuple[str, str]:
    """Return the two directions perpendicular to an axis, in the order of the right-hand rule."""
    k = DIRECTIONS.index(axis)
    return DIRECTIONS[(k + 1) % 3], DIRECTIONS[(k + 2) % 3]


def list_rotation_axes(dofs: DofSet) -> list[Dof]:
    """Return the nodes and axes for which both perpendicular directions are among some DOFs."""
    known = {(dof.node, dof.direction) for dof in dofs}
    return [
        Dof(node, axis)
        for node in dict.fromkeys(dofs.nodes.tolist())
        for axis in DIRECTIONS[:3]
        if any(
            all((node, turning + direction) in known for direction in _list_perpendicular(axis))
            for turning in ("", "R")
        )
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _DofRotation:
    """Rotations of responses or references; `generator` is d (measured) / d angle."""

    generator: RealArray

    @property
    def basis(self) -> RealArray:
        """Parts of a rotation for the factors 1, sin and cos of the angle, shape (3, n, n)."""
        square = self.generator @ self.generator
        return np.stack([np.eye(len(square)) + square, self.generator, -square])

    def rotation(self, angle: float) -> RealArray:
        """Return the matrix from true to measured values, by Rodrigues' formula."""
        return np.tensordot(np.array([1.0, np.sin(angle), np.cos(angle)]), self.basis, axes=1)


@dataclass(frozen=True, slots=True, eq=False)
class _ChannelRotation:
    """Rotations of responses and of references by one angle."""

    responses: _DofRotation
    references: _DofRotation

    @classmethod
    def of(cls, channels: Sequence[str], frf: FRF) -> _ChannelRotation:
        forces = [c.removeprefix(FORCE) for c in channels if c.startswith(FORCE)]
        sensors = [c for c in channels if not c.startswith(FORCE)]
        return cls(
            _DofRotation(_make_generator(sensors, frf.responses, "response")),
            _DofRotation(_make_generator(forces, frf.references, "reference")),
        )


def _make_generator(axes: Iterable[str], dofs: DofSet, role: str) -> RealArray:
    """Return the derivative of measured values by the angle, shape (n, n)."""
    G = np.zeros((len(dofs), len(dofs)))
    place = {(dof.node, dof.direction): i for i, dof in enumerate(dofs)}
    for name in axes:
        axis = Dof.parse(name)
        found = False
        for turning in ("", "R"):
            along = [
                place.get((axis.node, turning + d)) for d in _list_perpendicular(axis.direction)
            ]
            if along[0] is None or along[1] is None:
                continue
            a, b = along[0], along[1]
            sign = float(axis.sign * dofs.signs[a] * dofs.signs[b])
            G[a, b], G[b, a] = sign, -sign
            found = True
        if not found:
            first, second = (f"{axis.node}:{d}" for d in _list_perpendicular(axis.direction))
            raise OptionError(
                f"{name!r}: a turn about {axis.direction} needs both {first} and {second} as a"
                f" {role} of the data"
            )
    return G


def _find_best_angle(turn: _ChannelRotation, evidence: Evidence) -> float:
    """Return the angle in degrees that best fits the model to the data, by least squares."""
    # All lines have equal weight: each is divided by its energy.
    from scipy.optimize import minimize_scalar

    frf, H = evidence.frf, evidence.model_response(evidence.frf)
    assert frf.variance is not None
    rows = turn.responses.generator.any(axis=1)
    columns = turn.references.generator.any(axis=1)
    affected = rows[:, None] | columns
    energy = np.abs(frf.values) ** 2 + np.abs(H) ** 2 + frf.variance
    weight = 1.0 / np.maximum(energy[:, affected].sum(axis=1), np.finfo(np.float64).tiny)
    data = np.where(affected, weight[:, None, None] * frf.values.conj(), 0.0)
    # A rotation preserves the norm: the largest correlation is the smallest difference.
    correlation = np.empty((3, 3))
    for p, left in enumerate(turn.responses.basis):
        for q, right in enumerate(turn.references.basis):
            correlation[p, q] = float(np.sum((data * (left @ H @ right.T)).real))
    step = np.radians(CHANNEL_FAULT.turn_step)
    angles = np.arange(-np.pi, np.pi, step)
    t = np.stack([np.ones(len(angles)), np.sin(angles), np.cos(angles)])
    at = np.argmax(np.einsum("pa,pq,qa->a", t, correlation, t))
    between = angles[at] - step, angles[at] + step

    def negative_correlation(angle: float) -> float:
        parts = np.array([1.0, np.sin(angle), np.cos(angle)])
        return -float(parts @ correlation @ parts)

    best = minimize_scalar(
        negative_correlation, bounds=between, method="bounded", options={"xatol": 1e-7}
    )
    return float(np.degrees(best.x))
