"""A servo in words."""

from __future__ import annotations

from textwrap import indent
from typing import TYPE_CHECKING

import numpy as np

from updyn.control.servo.margins import FIGURES

if TYPE_CHECKING:
    from updyn.control.servo.record import Loop, Servo, StepResponse, WindResponse

__all__ = ["servo_text"]

_NAMES = {
    "gain_margin": "gain margin",
    "gain_reduction": "gain reduction",
    "phase_margin": "phase margin",
    "delay_margin": "delay margin",
    "modulus_margin": "modulus margin",
    "crossover": "crossover",
}


def servo_text(servo: Servo) -> str:
    """Return a servo's figures as text.

    Parameters
    ----------
    servo : Servo
        What was found.
    """
    plant = servo.plant
    reads = f"{servo.torque} -> {servo.velocity}" + (
        f", {servo.position}" if servo.position else ""
    )
    parts = [f"Servo on {reads} ({plant['states']} states, {plant['rigid']} rigid-body modes)"]
    if plant.get("inertia"):
        parts.append(f"rigid-body inertia {plant['inertia']:.6g} (from torque to acceleration)")
    parts.append(indent(servo.controller.summary(), "  "))
    for loop in servo.loops:
        parts += [f"{loop.name} loop", indent(loop.margins.summary(), "  ")]
        if loop.bandwidth is not None:
            parts.append(f"  bandwidth       {loop.bandwidth:.6g} Hz (-3 dB, closed)")
        if loop.members:
            parts.append(indent(_family(loop), "  "))
    if servo.bandwidth is not None and servo.controller.feed_forward:
        parts.append(
            f"bandwidth from the reference, with feed-forward (-3 dB)  {servo.bandwidth:.6g} Hz"
        )
    for step in (servo.step, servo.disturbance_step):
        if step is not None:
            parts.append(_step(step))
    if servo.wind is not None:
        parts.append(_wind(servo.wind))
    parts += [f"note: {note}" for note in servo.notes]
    return "\n".join(parts)


def _family(loop: Loop) -> str:
    bad = loop.unstable_members
    lines = [f"over {len(loop.members)} members of the family:"]
    if bad:
        shown = ", ".join(str(i) for i in bad[:8]) + (", ..." if len(bad) > 8 else "")
        rest = "; the ranges below are those of the others" if len(bad) < len(loop.members) else ""
        lines.append(f"  UNSTABLE for {len(bad)} of them ({shown}){rest}")
    for name, unit in FIGURES.items():
        spread = loop.worst[name]
        if spread.smallest_member is None or (name == "gain_reduction" and spread.largest == 0):
            continue
        low, high = spread.smallest, spread.largest
        if name in ("gain_margin", "gain_reduction"):
            low, high, unit = _db(low), _db(high), "dB"
        elif name == "delay_margin":
            low, high, unit = 1e3 * low, 1e3 * high, "ms"
        if np.isinf(low) and np.isinf(high):
            text, who = "unlimited", "all members"
        else:
            text = (
                f"{low:.4g} to {high:.4g} {unit}"
                if np.isfinite(high)
                else f"{low:.4g} {unit} to unlimited"
            )
            who = f"members {spread.smallest_member} and {spread.largest_member}"
        lines.append(f"  {_NAMES[name]:<14}  {text.rstrip()} ({who})")
    return "\n".join(lines)


def _step(step: StepResponse) -> str:
    if step.of == "disturbance":
        text = (
            f"step of {step.size:g} {step.input_unit} at {step.input}: {step.output} deviates by at"
            " most "
        )
        text += f"{step.peak:.4g} {step.output_unit} after {step.peak_time:.4g} s"
        return text + f", comes to {step.final:.4g} {step.output_unit}"
    parts = [] if step.rise_time is None else [f"rises in {step.rise_time:.4g} s"]
    if step.overshoot is not None:
        parts.append(f"overshoots by {100 * step.overshoot:.3g} %")
    settled = "is not settled when the record ends"
    parts.append(
        settled if step.settling_time is None else f"settles to 2 % in {step.settling_time:.4g} s"
    )
    return f"step of {step.input}: {', '.join(parts)}"


def _wind(wind: WindResponse) -> str:
    text = (
        f"disturbance at {wind.input}: error of {wind.output} {wind.rms:.4g} {wind.output_unit} rms"
    )
    text += f", at most {wind.peak:.4g} {wind.output_unit}"
    if wind.rms_expected is not None:
        text += f" ({wind.std:.4g} rms about its mean; {wind.rms_expected:.4g} by the spectrum)"
    return text


def _db(gain: float) -> float:
    return float(20.0 * np.log10(gain)) if gain > 0 else -np.inf
