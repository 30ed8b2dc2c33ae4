"""`SampledCascade`: a digital controller on a sampled plant, and its loops in z.

Each factor of the controller is converted with s = c (z - 1) / (z + 1) (Tustin), c = 2 / dt for the
integral part, and c = w / tan(w dt / 2) for a notch or low-pass at w (prewarping; Franklin, Powell
& Workman, Digital Control of Dynamic Systems, 3rd ed., chapter 6). A velocity of a displacement is
its backward difference, a position of a velocity its trapezoidal sum.

With z = exp(s dt) the margins are those of continuous loops, up to half the sampling rate, where L
is real and may be -1. The eigenvalues of the closed loop in z determine its stability.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray
from updyn.control.plant import Plant
from updyn.control.servo import grid
from updyn.control.servo.controller import Controller, to_velocity
from updyn.control.servo.loops import Wiring
from updyn.control.servo.settings import LOOP_STABILITY
from updyn.control.servo.stability import JudgedLoop, count_drifting, count_growing, find_margins
from updyn.control.servo.state_space import StateSpace, Transfer, bilinear, channel_zeros, connect
from updyn.errors import OptionError

__all__ = ["SampledCascade", "judge_sampled"]

_TWO_PI = 2.0 * np.pi


class SampledCascade:
    """A digital controller on one sampled plant; its delay replaces the controller's dead time."""

    def __init__(self, plant: Plant, controller: Controller, wiring: Wiring) -> None:
        if plant.dt is None:
            raise OptionError("sampled: the plant is continuous; make it with updyn.sampled")
        for name, names, what in (
            (wiring.torque, plant.inputs, "input"),
            (wiring.velocity, plant.outputs, "output"),
            (wiring.position, plant.outputs, "output"),
        ):
            if name is not None and name not in names:
                raise OptionError(
                    f"sampled: the plant has no {what} {name!r}; expected the continuous plant of"
                    " the servo, sampled"
                )
        self.plant, self.wiring, self.dt = plant, wiring, plant.dt
        self.kv = controller.position_gain
        self.has_position = controller.kv is not None
        self.notes = _omission_notes(controller, plant)
        self._controller = _convert_controller(controller, plant.dt)
        outputs = (wiring.velocity, wiring.position or wiring.velocity)
        rows = [plant.outputs.index(name) for name in outputs]
        column = plant.inputs.index(wiring.torque)
        self._system = StateSpace(
            plant.A, plant.B[:, [column]], plant.C[rows], plant.D[np.ix_(rows, [column])]
        )
        powers = np.array([to_velocity(plant, name) for name in outputs])
        powers[1] = powers[1] - 1 if self.has_position else 0
        self._readers = tuple(_output_conversion(int(power), plant.dt) for power in powers)
        self._transfers = tuple(
            Transfer.of(part) for part in (self._system, *self._readers, self._controller)
        )

    def velocity(self, s: ArrayLike) -> ComplexArray:
        """Return L of the velocity loop, the position loop open, at s in rad/s, shape (n,)."""
        return self._parts(s)[0]

    def position(self, s: ArrayLike) -> ComplexArray:
        """Return L of the position loop, the velocity loop closed, at s in rad/s, shape (n,)."""
        inner, outer = self._parts(s)
        return np.asarray(outer / (1.0 + inner))

    def torque(self, s: ArrayLike) -> ComplexArray:
        """Return L broken at the torque, both loops closed, at s in rad/s, shape (n,)."""
        inner, outer = self._parts(s)
        return np.asarray(inner + outer)

    def _parts(self, s: ArrayLike) -> tuple[ComplexArray, ComplexArray]:
        """Return the loop functions at the torque via the velocity and via the position."""
        z = np.exp(np.asarray(s, dtype=np.complex128) * self.dt)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plant, first, second, controller = (t.at(z)[:, :, 0] for t in self._transfers)
            K = controller[:, 0]
            inner = K * first[:, 0] * plant[:, 0]
            outer = self.kv * K * second[:, 0] * plant[:, 1]
        return np.asarray(inner), np.asarray(outer)

    def closed_poles(self, position: bool) -> ComplexArray:
        """Return the closed-loop poles in z, of the position loop or of the velocity loop."""
        blocks = [self._system, *self._readers, self._controller]
        # inputs: torque, both readers, controller; outputs: both motions, their readings, torque
        wires = np.zeros((4, 5))
        wires[0, 4] = wires[1, 0] = wires[2, 1] = 1.0
        wires[3, 2] = -1.0
        wires[3, 3] = -self.kv if position else 0.0
        return connect(blocks, wires, np.zeros((4, 1))).poles

    @property
    def features(self) -> ComplexArray:
        """Poles and zeros of the open loops, as s in rad/s."""
        parts = [t.poles for t in self._transfers]
        for i in range(1 + self.has_position):
            parts.append(
                channel_zeros(
                    StateSpace(
                        self._system.A, self._system.B, self._system.C[[i]], self._system.D[[i]]
                    )
                )
            )
        parts.append(channel_zeros(self._controller))
        return self.to_s(np.concatenate(parts))

    def to_s(self, z: ComplexArray) -> ComplexArray:
        """Return log(z) / dt in rad/s, without the values at z = 0."""
        z = z[np.abs(z) > LOOP_STABILITY.delay_modulus]
        return np.asarray(np.log(z) / self.dt)


def _omission_notes(controller: Controller, plant: Plant) -> tuple[str, ...]:
    """Return notes on the parts of a controller that a sampled loop omits."""
    assert plant.dt is not None
    half, notes = 0.5 / plant.dt, []
    if controller.dead_time:
        delay = float(plant.facts.get("sampling", {}).get("delay", plant.delay * plant.dt))
        notes.append(
            f"the controller's dead time of {1e3 * controller.dead_time:g} ms is omitted: the"
            f" hold and the delay of the sampled plant, {1e3 * delay:g} ms, replace it"
        )
    for notch in controller.notches:
        if notch.frequency >= half:
            notes.append(
                f"the notch at {notch.frequency:g} Hz is omitted: half the sampling rate is"
                f" {half:g} Hz"
            )
    if controller.low_pass is not None and controller.low_pass >= half:
        notes.append(
            f"the low-pass at {controller.low_pass:g} Hz is omitted: half the sampling rate is"
            f" {half:g} Hz"
        )
    return tuple(notes)


def _convert_controller(controller: Controller, dt: float) -> StateSpace:
    """Return torque over velocity error in z, without filters above half the sampling rate."""
    plain = Controller(controller.kp, controller.ti)
    out = bilinear(plain.state_space(), dt)
    for notch in controller.notches:
        if notch.frequency < 0.5 / dt:
            out = bilinear(notch.state_space(), _prewarp(notch.frequency, dt)) * out
    corner = controller.low_pass
    if corner is not None and corner < 0.5 / dt:
        low_pass = Controller(1.0, low_pass=corner, low_pass_damping=controller.low_pass_damping)
        out = bilinear(low_pass.state_space(), _prewarp(corner, dt)) * out
    return out


def _prewarp(freq: float, dt: float) -> float:
    """Return the interval with which the bilinear substitution is exact at a frequency."""
    w = _TWO_PI * freq
    return float(2.0 * np.tan(0.5 * w * dt) / w)


def _output_conversion(power: int, dt: float) -> StateSpace:
    """Return the conversion of an output to velocity or position: difference, gain 1 or sum."""
    one = np.ones((1, 1))
    if power == 1:  # (1 - 1 / z) / dt
        return StateSpace(0.0 * one, one, -one / dt, one / dt)
    if power == -1:
        return bilinear(StateSpace(0.0 * one, one, one, 0.0 * one), dt)
    return StateSpace.gain(1.0)


def judge_sampled(
    cascade: SampledCascade, continuous: Sequence[JudgedLoop | None]
) -> list[JudgedLoop | None]:
    """Return margins and stability of the loops of a sampled cascade; poles as s = log(z) / dt.

    `continuous` are velocity, position and torque loop on the continuous plant; None if missing.
    """
    loops = cascade.velocity, cascade.position, cascade.torque
    return [
        None if judged is None else _judge_loop(cascade, loop, float(judged.w[0]), position)
        for loop, judged, position in zip(loops, continuous, (False, True, True), strict=True)
    ]


def _judge_loop(
    cascade: SampledCascade, loop: Callable[[ArrayLike], ComplexArray], low: float, position: bool
) -> JudgedLoop:
    poles = cascade.to_s(cascade.closed_poles(position))
    top = np.pi / cascade.dt
    low = min(low, 1e-3 * top)
    features = np.concatenate([cascade.features, poles])
    w, values = grid.resolve(loop, grid.frequencies(features, low, top))
    w, values = grid.add_extremes(loop, w, values)
    gains = grid.crossings_of_gain(loop, w, values)
    phases = grid.crossings_of_phase(loop, w, values)
    last = loop(np.array([1j * top]))[0]
    is_crossed = len(phases) > 0 and phases[-1] > (1.0 - 1e-9) * top
    if last.real < -LOOP_STABILITY.nyquist_gain and not is_crossed:
        phases = np.append(phases, top)
    scale = float(gains[0]) if len(gains) else low
    drifting = count_drifting(poles, scale)
    margins = find_margins(
        loop, w, values, gains, phases, count_growing(poles, scale), drifting, 0.0
    )
    return JudgedLoop(loop, w, values, margins, poles, 0, True)
