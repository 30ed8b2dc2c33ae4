"""Simple faults that explain a sensor that does not follow rigid-body motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import DIRECTIONS, Dof
from updyn.updating.judge.causes.rigid_motion import RigidMotion, RowMask, pseudo_inverse
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, CAUSE_ODDS, CHANNEL_FAULT, RIGID_BODY

__all__ = ["Explanation", "explain_sensors"]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A fault that may explain the values of a sensor; `deviation` is the largest after correction.

    `repair_text` is its text for a job; empty if no change of the data corrects it.
    """

    words: str
    repair_text: str
    deviation: float

    @property
    def place(self) -> str:
        """Kind and channels of the repair."""
        return self.repair_text.partition("=")[0]

    def __str__(self) -> str:
        return f"{self.words} ({self.repair_text})" if self.repair_text else self.words


def explain_sensors(
    motion: RigidMotion, wrong: Sequence[int]
) -> dict[tuple[int, ...], list[Explanation]]:
    """Return the faults that explain the values of some sensors, the simplest first."""
    # One list for all sensors if the same fault explains them, else one for each.
    found: dict[tuple[int, ...], list[Explanation]] = {
        (i,): _explain_one(motion, i, wrong) for i in wrong
    }
    common = set.intersection(*({one.place for one in each} for each in found.values())) - {""}
    joint = [one for one in found[wrong[0],] if one.place in common]
    return {tuple(wrong): joint} if joint else found


def _explain_one(motion: RigidMotion, i: int, wrong: Sequence[int]) -> list[Explanation]:
    tried = _try_faults(motion, i, wrong)
    found = [one for one in tried if one.deviation <= RIGID_BODY.explained_stds]
    best = min((one.deviation for one in found), default=0.0)
    return [one for one in found if one.deviation**2 <= best**2 + CAUSE_ODDS.indistinct_log_odds]


def _try_faults(motion: RigidMotion, i: int, wrong: Sequence[int]) -> Iterator[Explanation]:
    """Yield each kind of fault of a sensor with its best size or place."""
    sensor = _Sensor.of(motion, motion.leave_out(wrong), i)
    dof = motion.sensors[i]
    own = sensor.predict([dof])[0]
    yield Explanation("the opposite sign", f"sign:{dof}", float(sensor.compare(-own)))
    for k in wrong:
        if k != i:
            there = motion.sensors[k]
            other = _Sensor.of(motion, sensor.rows, k)
            both = sensor.compare(sensor.predict([there])[0]), other.compare(own)
            deviation = float(max(both))
            pair = ",".join(str(motion.sensors[one]) for one in sorted((i, k)))
            words = "an exchange of " + pair.replace(",", " and ")
            yield Explanation(words, f"swapped:{pair}", deviation)
    yield from _try_turns(sensor, dof, own)
    yield from _try_places(sensor, dof)
    gain = sensor.fit_gain(own)
    if gain > 0.0:
        text = f"calibration:{dof}={np.log(gain):.4g}"
        yield Explanation(f"a factor of {gain:.3g}", text, float(sensor.compare(gain * own)))


def _try_places(sensor: _Sensor, dof: Dof) -> Iterator[Explanation]:
    """Yield the best of the places near a sensor, and of those of the other sensors."""
    motion = sensor.motion
    turning = dof.direction.startswith("R")
    near = motion.rigid.list_near(motion.data, dof)
    others = [k for k in motion.sensors if k != dof and k.direction.startswith("R") == turning]
    for places, text in ((near, f"moved:{dof},"), (others, "")):
        known = sensor.select_determined(places)
        if known:
            deviations = sensor.compare(sensor.predict(known))
            best = int(np.argmin(deviations))
            there = str(known[best])
            words = f"the motion of {there}"
            yield Explanation(words, text and text + there, float(deviations[best]))


def _try_turns(sensor: _Sensor, dof: Dof, own: ComplexArray) -> Iterator[Explanation]:
    """Yield the best turn towards each other direction of the node."""
    # If that is measured, too, both turn together if this explains both.
    motion = sensor.motion
    prefix, k = dof.direction[:-1], DIRECTIONS.index(dof.direction[-1])
    step = RIGID_BODY.turn_step
    positive = np.arange(CHANNEL_FAULT.least_turn, RIGID_BODY.most_turn + step, step)
    degrees = np.concatenate([positive, -positive])
    angles = np.radians(degrees)[:, None]
    for shift, sense in ((1, 1.0), (2, -1.0)):
        across = Dof(dof.node, prefix + DIRECTIONS[(k + shift) % 3])
        if not sensor.select_determined([across]):
            continue
        other = sensor.predict([across])[0]
        deviations = sensor.compare(np.cos(angles) * own + np.sin(angles) * other)
        text = ""
        if across in motion.sensors:
            second = _Sensor.of(motion, sensor.rows, motion.sensors.index(across))
            turned = second.compare(np.cos(angles) * other - np.sin(angles) * own)
            if np.maximum(deviations, turned).min() <= RIGID_BODY.explained_stds:
                deviations = np.maximum(deviations, turned)
                text = f"turned:{dof.node}:{DIRECTIONS[(k - shift) % 3]}="
        best = int(np.argmin(deviations))
        angle = float(degrees[best])
        sign = "-" if angle < 0.0 else ""
        words = f"a turn by {abs(angle):.3g} degrees towards {sign}{across.direction}"
        yield Explanation(words, text and f"{text}{sense * angle:.3g}", float(deviations[best]))


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
    """The values of a sensor by reference, shape (m,), and the motion of the others.

    `rows` marks the other sensors; `std` is that of the difference from their motion; `amplitudes`,
    shape (r, m), is this motion, and `determined`, shape (r, r), the projection onto the part that
    they determine.
    """

    motion: RigidMotion
    rows: RowMask
    values: ComplexArray
    std: RealArray
    amplitudes: ComplexArray
    determined: RealArray

    @classmethod
    def of(cls, motion: RigidMotion, rows: RowMask, i: int) -> _Sensor:
        R, std = motion.shapes[rows], motion.standard_deviation(rows)
        inverses = [pseudo_inverse(R / s[:, None]) / s for s in std[rows].T]
        values = motion.values[rows].T
        amplitudes = np.stack([one @ v for one, v in zip(inverses, values, strict=True)], axis=1)
        spread = [
            np.linalg.norm(motion.shapes[i] @ one * s)
            for one, s in zip(inverses, std[rows].T, strict=True)
        ]
        determined = pseudo_inverse(R) @ R
        own = np.hypot(std[i], spread)
        return cls(motion, rows, motion.values[i], own, amplitudes, determined)

    def select_determined(self, dofs: Sequence[Dof]) -> list[Dof]:
        """Return those DOFs of the model whose motion the other sensors determine."""
        dofs = [dof for dof in dofs if self.motion.rigid.has(dof)]
        R = self.motion.rigid.at(dofs)
        lacking = np.linalg.norm(R - R @ self.determined, axis=1)
        known = lacking <= CAUSE_MISFIT.dependent_share * np.linalg.norm(R, axis=1)
        return [dof for dof, one in zip(dofs, known, strict=True) if one]

    def predict(self, dofs: Sequence[Dof]) -> ComplexArray:
        """Return the motion of DOFs by that of the other sensors, shape (k, m)."""
        return np.asarray(self.motion.rigid.at(dofs) @ self.amplitudes)

    def compare(self, values: ComplexArray) -> RealArray:
        """Return the largest deviation from values of shape (..., m), shape (...)."""
        return np.asarray(np.max(np.abs(self.values - values) / self.std, axis=-1))

    def fit_gain(self, own: ComplexArray) -> float:
        """Return the real factor of its motion that best explains the values."""
        weight = 1.0 / self.std**2
        power = max(float(np.sum(weight * np.abs(own) ** 2)), np.finfo(float).tiny)
        return float(np.sum(weight * (self.values * own.conj()).real)) / power
