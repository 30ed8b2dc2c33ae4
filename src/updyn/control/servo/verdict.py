"""`ServoVerdict`: whether a servo is stable, on all plants, and with the usual margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from updyn.control.servo.record import Loop, Servo
from updyn.control.servo.settings import SERVO_VERDICT

__all__ = ["ServoVerdict", "judge_servo", "worst_member"]


@dataclass(frozen=True, slots=True)
class ServoVerdict:
    """Verdict on a servo: `kind`, "bad" if unstable, "warn" in doubt; `text`; and `reasons`."""

    kind: Literal["good", "warn", "bad"]
    text: str
    reasons: tuple[str, ...] = ()


def judge_servo(servo: Servo) -> ServoVerdict:
    """Return whether a servo is stable on its plant, on the family and sampled, and the doubts."""
    every = servo.all_loops
    count = len(servo.velocity_loop.members)
    unstable = [loop for loop in every if not loop.margins.stable]
    if unstable:
        names = " and ".join(loop.name for loop in servo.loops if not loop.margins.stable)
        where = f": {names} loop" if names else ""
        return ServoVerdict("bad", f"not stable{where}", servo.doubts)
    members = sorted({i for loop in every for i in loop.unstable_members})
    if members:
        text = f"not stable on {len(members)} of {count} plants of the family"
        return ServoVerdict("bad", text, ("It is stable on the nominal plant.", *servo.doubts))
    if servo.sampled is not None and not servo.sampled.stable:
        reason = "The continuous loops are stable."
        return ServoVerdict("bad", "not stable as a sampled controller", (reason, *servo.doubts))
    text = f"stable, also on all {count} plants of the family" if count else "stable"
    small = _small_margin(every)
    if small:
        return ServoVerdict("warn", f"{text}, with a small margin", (small, *servo.doubts))
    if servo.doubts:
        return ServoVerdict("warn", f"{text}, with a doubtful gain", servo.doubts)
    return ServoVerdict("good", text)


def worst_member(loop: Loop, name: str) -> tuple[float, int] | None:
    """Return the worst value of a margin over a family and its index; None without one."""
    spread = loop.worst.get(name)
    if spread is None:
        return None
    value, member = spread.smallest, spread.smallest_member
    if name == "gain_reduction":
        value, member = spread.largest, spread.largest_member
    return None if member is None else (value, member)


def _small_margin(loops: Sequence[Loop]) -> str:
    """Return the smallest modulus margin as a sentence if it is below the usual one."""
    found = []
    for loop in loops:
        if loop.margins.modulus_margin is not None:
            found.append((loop.margins.modulus_margin, loop, ""))
        worst = worst_member(loop, "modulus_margin")
        if worst is not None:
            found.append((worst[0], loop, f", plant {worst[1]} of the family"))
    value, loop, where = min(found, key=lambda one: one[0])
    if value >= SERVO_VERDICT.usual_modulus_margin:
        return ""
    at = "at the torque" if loop.name == "torque" else f"of the {loop.name} loop"
    return (
        f"The smallest modulus margin is {value:.3g} ({at}{where});"
        f" {SERVO_VERDICT.usual_modulus_margin:g} or more is usual."
    )
