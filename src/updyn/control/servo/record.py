"""`Servo`: the results of a controller on a plant, ready to be plotted. Pure data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import indent
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.servo.controller import Controller
from updyn.control.servo.margins import FIGURES, Margins, Range, RobustMargin
from updyn.control.servo.settings import STEP_RESPONSE

__all__ = [
    "Loop",
    "SampledLoops",
    "Servo",
    "StepResponse",
    "WindResponse",
    "servo_text",
]

_NAMES = {
    "gain_margin": "gain margin",
    "gain_reduction": "gain reduction",
    "phase_margin": "phase margin",
    "delay_margin": "delay margin",
    "modulus_margin": "modulus margin",
    "crossover": "crossover",
}


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A loop function broken at one place, with its margins.

    Attributes
    ----------
    name : {"velocity", "position", "torque"}
        The velocity loop with the position loop open, the position loop with the velocity loop
        closed, or both loops closed and broken at the torque.
    freq : ndarray of float, shape (n_f,)
        Frequency lines in Hz, dense around resonances and antiresonances.
    L : ndarray of complex, shape (n_f,)
        The loop function; with negative feedback the closed loop is L / (1 + L).
    phase : ndarray of float, shape (n_f,)
        Continuous phase of L in degrees; it starts at -90 times the number of integrations.
    margins : Margins
        Margins of the nominal plant.
    bandwidth : float or None
        First frequency in Hz at which |T| falls 3 dB below its value at rest; None if the closed
        loop is unstable or |T| does not fall.
    family, family_phase : ndarray, shape (n_members, n_f)
        Loop function and phase in degrees of each member; no rows without a family.
    members : tuple of Margins
        Margins of each member.
    worst : mapping of str to Range
        Range of each figure over the members, by the name in `Margins`; empty without a family.
    modulus_range : (float, float) or None
        Bounds of the modulus margin of the structure by the relative error of the plant; None if
        one of them is unknown, or the margin lies outside the band.
    """

    name: str
    freq: RealArray
    L: ComplexArray
    phase: RealArray
    margins: Margins
    bandwidth: float | None = None
    family: ComplexArray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.complex128))
    family_phase: RealArray = field(default_factory=lambda: np.zeros((0, 0)))
    members: tuple[Margins, ...] = ()
    worst: Mapping[str, Range] = field(default_factory=dict)
    modulus_range: tuple[float, float] | None = None

    @property
    def magnitude_db(self) -> RealArray:
        """|L| in dB, shape (n_f,); with `phase` it makes the Bode and the Nichols plot."""
        return np.asarray(20.0 * np.log10(np.abs(self.L)))

    @property
    def S(self) -> ComplexArray:  # noqa: N802
        """Sensitivity 1 / (1 + L), shape (n_f,)."""
        return np.asarray(1.0 / (1.0 + self.L))

    @property
    def T(self) -> ComplexArray:  # noqa: N802
        """Closed loop L / (1 + L), shape (n_f,)."""
        return np.asarray(self.L / (1.0 + self.L))

    @property
    def unstable_members(self) -> tuple[int, ...]:
        """Members of the family, counted from 0, whose closed loop is unstable."""
        return tuple(i for i, m in enumerate(self.members) if not m.stable)


@dataclass(frozen=True, slots=True, eq=False)
class StepResponse:
    """Response of the closed loop to a step at time 0, starting at rest.

    Attributes
    ----------
    of : {"reference", "disturbance"}
        The input that steps.
    size : float
        Height of the step in `input_unit`.
    input, input_unit, output, output_unit : str
        Names and units of the input and of the output.
    time, value, torque : ndarray of float, shape (n,)
        Time in s, output in `output_unit`, and torque command after the dead time in N m (N).
    final : float
        Final value in `output_unit`; nan if unbounded.
    rise_time : float or None
        Time from 10 to 90 % of `final`, in s, for a reference step. None if it `returns`.
    overshoot : float or None
        Largest excess over `final`, as a share of it, for a reference step. None if it `returns`.
    settling_time : float or None
        Time in s after which `value` stays within 2 % of `final`; for a disturbance, or if it
        `returns`, within 2 % of `peak` around `final`. None if the record ends before.
    peak, peak_time : float
        Value of largest size in `output_unit`, and its time in s.
    """

    of: str
    size: float
    input: str
    input_unit: str
    output: str
    output_unit: str
    time: RealArray
    value: RealArray
    torque: RealArray
    final: float
    rise_time: float | None
    overshoot: float | None
    settling_time: float | None
    peak: float
    peak_time: float

    @property
    def returns(self) -> bool:
        """Whether the response returns to zero: |final| is at most a hundredth of the peak."""
        return abs(self.final) <= STEP_RESPONSE.returning_share * abs(self.peak)


@dataclass(frozen=True, slots=True, eq=False)
class WindResponse:
    """Response to a disturbance over time, such as wind.

    `time` is in s, `disturbance` in `input_unit`, `error`, the deviation of the output from 0, in
    `output_unit`. `rms`, `peak` and `mean` are its root mean square about 0, largest absolute value
    and mean. `rms_expected` is without the mean, by the spectrum of the wind, free of sampling
    error; None for a given series. `facts` are the parameters of the disturbance.
    """

    input: str
    input_unit: str
    output: str
    output_unit: str
    time: RealArray
    disturbance: RealArray
    error: RealArray
    rms: float
    peak: float
    mean: float
    rms_expected: float | None = None
    facts: Mapping[str, object] = field(default_factory=dict)

    @property
    def std(self) -> float:
        """Root mean square of `error` about its mean, in `output_unit`."""
        return float(np.std(self.error))


@dataclass(frozen=True, slots=True, eq=False)
class SampledLoops:
    """Loops of the same controller as a digital one, on the sampled plant with its delay.

    `dt` is in s; `delay` is that of the torque in intervals, rounded up, to which the hold adds.
    The loops are as in `Servo`, up to half the sampling rate; `poles` are closed-loop poles in z.
    `notes` name the parts of the controller that are not included.
    """

    dt: float
    delay: int
    velocity_loop: Loop
    position_loop: Loop | None
    torque_loop: Loop | None
    poles: ComplexArray
    notes: tuple[str, ...] = ()

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The loops that exist."""
        every = self.velocity_loop, self.position_loop, self.torque_loop
        return tuple(loop for loop in every if loop is not None)

    @property
    def stable(self) -> bool:
        """Whether every loop is stable."""
        return all(loop.margins.stable for loop in self.loops)


@dataclass(frozen=True, slots=True, eq=False)
class Servo:
    """Loops, margins and time responses of a plant with a controller.

    Attributes
    ----------
    controller : Controller
        Its settings.
    torque, velocity, position, disturbance, pointing : str or None
        Names of the plant's input and outputs. Without a position loop `position` is None; it
        equals `velocity` if one of them is derived from the other.
    plant : dict
        Facts of the nominal plant: ``states``, ``modes`` (Hz), ``rigid``, ``band`` (Hz), ``error``,
        ``relative_error``, ``route``, ``inertia`` (rigid-body inertia from torque to velocity, kg
        m2 or kg; None without rigid-body motion), ``members`` (number of a family's members).
    velocity_loop : Loop
        Broken at the velocity, the position loop open.
    position_loop : Loop or None
        Broken at the position, the velocity loop closed; None without a position loop.
    freq : ndarray of float, shape (n_f,)
        Frequency lines of `reference` in Hz, those of the outermost loop.
    reference : ndarray of complex, shape (n_f,)
        Closed loop from reference to position (velocity, without a position loop), feed-forward
        included.
    bandwidth : float or None
        First frequency in Hz at which |reference| falls 3 dB below its value at rest; None if
        unstable or it does not fall.
    compliance : ndarray of complex, shape (n_f,) or None
        Closed loop from `disturbance` to position (velocity); None without a disturbance.
    poles : ndarray of complex, shape (n,)
        Closed-loop poles in rad/s; with dead time those of its Pade approximation.
    step, disturbance_step : StepResponse or None
        Response to a step of reference or disturbance; None if unstable or not requested.
    wind : WindResponse or None
        Response to wind or a given disturbance.
    notes : tuple of str
        Remarks on the results.
    doubts : tuple of str
        Questions about the gains: a crossover far below the modes, with the likely cause.
    torque_loop : Loop or None
        Both loops closed, broken at the torque: margins for gain and delay of the drive. None
        without a position loop, as it then equals `velocity_loop`.
    family_steps : tuple of StepResponse or None
        Reference step of each member, None for an unstable one; empty if not requested.
    sampled : SampledLoops or None
        The same loops on the sampled plant, if given.
    robust : tuple of RobustMargin
        For the deviations of the family and for the relative error of the plant; empty if the
        nominal loop is unstable.
    """

    controller: Controller
    torque: str
    velocity: str
    position: str | None
    disturbance: str | None
    pointing: str | None
    plant: Mapping[str, Any]
    velocity_loop: Loop
    position_loop: Loop | None
    freq: RealArray
    reference: ComplexArray
    bandwidth: float | None
    compliance: ComplexArray | None
    poles: ComplexArray
    step: StepResponse | None = None
    disturbance_step: StepResponse | None = None
    wind: WindResponse | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    torque_loop: Loop | None = None
    family_steps: tuple[StepResponse | None, ...] = ()
    sampled: SampledLoops | None = None
    robust: tuple[RobustMargin, ...] = ()

    @property
    def stable(self) -> bool:
        """Whether every loop is stable, including all members of a family and the sampled loops."""
        loops_stable = all(m.stable for loop in self.loops for m in (loop.margins, *loop.members))
        return loops_stable and (self.sampled is None or self.sampled.stable)

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The loops of the cascade, inner one first, without `torque_loop`."""
        if self.position_loop is None:
            return (self.velocity_loop,)
        return self.velocity_loop, self.position_loop

    @property
    def all_loops(self) -> tuple[Loop, ...]:
        """`loops`, and `torque_loop` if it exists."""
        return self.loops if self.torque_loop is None else (*self.loops, self.torque_loop)

    def summary(self) -> str:
        """Return margins, time responses and notes as text."""
        return servo_text(self)


def servo_text(servo: Servo) -> str:
    """Return the figures of a servo as text."""
    plant = servo.plant
    reads = f"{servo.torque} -> {servo.velocity}"
    if servo.position:
        reads += f", {servo.position}"
    parts = [f"Servo on {reads} ({plant['states']} states, {plant['rigid']} rigid-body modes)"]
    if plant.get("inertia"):
        parts.append(f"rigid-body inertia {plant['inertia']:.6g} (from torque to acceleration)")
    parts.append(indent(servo.controller.summary(), "  "))
    for loop in servo.all_loops:
        parts += [_name(loop), indent(loop.margins.summary(), "  ")]
        if loop.modulus_range is not None:
            low, high = loop.modulus_range
            error = 100.0 * plant["relative_error"]
            parts.append(
                f"  of the structure: modulus margin {low:.4g} to {high:.4g}, for a relative error"
                f" of the plant of {error:.2g} %"
            )
        if loop.bandwidth is not None:
            parts.append(f"  bandwidth       {loop.bandwidth:.6g} Hz (-3 dB, closed)")
        if loop.members:
            parts.append(indent(_family(loop), "  "))
    for robust in servo.robust:
        parts.append(f"robust margin, {robust.of}: {robust.summary()}")
    if servo.sampled is not None:
        parts += _sampled_text(servo.sampled)
    if servo.bandwidth is not None and servo.controller.feed_forward:
        parts.append(
            f"bandwidth from the reference, with feed-forward (-3 dB)  {servo.bandwidth:.6g} Hz"
        )
    for step in (servo.step, servo.disturbance_step):
        if step is not None:
            parts.append(_step(step))
    if any(servo.family_steps):
        parts.append(_steps(servo.family_steps))
    if servo.wind is not None:
        parts.append(_wind(servo.wind))
    parts += [f"note: {note}" for note in (*servo.doubts, *servo.notes)]
    return "\n".join(parts)


def _name(loop: Loop) -> str:
    return "both loops, broken at the torque" if loop.name == "torque" else f"{loop.name} loop"


def _sampled_text(sampled: SampledLoops) -> list[str]:
    late = "no delay"
    if sampled.delay:
        late = f"a delay of {sampled.delay} interval{'s' if sampled.delay > 1 else ''}"
    parts = [f"sampled every {1e3 * sampled.dt:g} ms, with the hold and {late}"]
    for loop in sampled.loops:
        parts += [f"  {_name(loop)}", indent(loop.margins.summary(), "    ")]
    return [*parts, *(f"  note: {note}" for note in sampled.notes)]


def _family(loop: Loop) -> str:
    bad = loop.unstable_members
    lines = [f"over {len(loop.members)} members of the family:"]
    if bad:
        shown = ", ".join(map(str, bad[:8]))
        if len(bad) > 8:
            shown += ", ..."
        rest = ""
        if len(bad) < len(loop.members):
            rest = "; the ranges below are those of the others"
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
            text = f"{low:.4g} to {high:.4g} {unit}"
            if np.isinf(high):
                text = f"{low:.4g} {unit} to unlimited"
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
    parts = []
    if step.returns:
        parts.append(
            f"returns to zero (final value {step.final:.2g} {step.output_unit}, peak"
            f" {step.peak:.4g} {step.output_unit} after {step.peak_time:.4g} s)"
        )
    if step.rise_time is not None:
        parts.append(f"rises in {step.rise_time:.4g} s")
    if step.overshoot is not None:
        parts.append(f"overshoots by {100 * step.overshoot:.3g} %")
    if step.settling_time is None:
        parts.append("is not settled when the record ends")
    else:
        of = " of the peak" if step.returns else ""
        parts.append(f"settles to 2 %{of} in {step.settling_time:.4g} s")
    return f"step of {step.input}: {', '.join(parts)}"


def _steps(steps: Sequence[StepResponse | None]) -> str:
    """Return the ranges of the step figures over a family as text."""
    stable = [step for step in steps if step is not None]
    parts = []
    back = sum(step.returns for step in stable)
    if back:
        parts.append(f"{back} return to zero")
    for name, what, factor, unit in (
        ("rise_time", "rise in", 1.0, "s"),
        ("overshoot", "overshoot by", 100.0, "%"),
        ("settling_time", "settle in", 1.0, "s"),
    ):
        found = [getattr(step, name) for step in stable]
        known = [factor * value for value in found if value is not None]
        if known:
            parts.append(f"{what} {min(known):.4g} to {max(known):.4g} {unit}")
    return f"step over {len(stable)} stable members of the family: {', '.join(parts)}"


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
