"""`SampledCascade`: a controller in a processor on a sampled plant, and its loops in z.

The controller is converted factor by factor with s = c (z - 1) / (z + 1) (Tustin), c = 2 / dt for
the integral part, and c = w / tan(w dt / 2) for a notch or low-pass at w, which has its place
exactly (prewarping; Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed.,
chapter 6). The plant with its hold and delay is that of `updyn.sampled`. A velocity that is read
from a displacement is its backward difference, a position from a velocity its trapezoidal sum.

With z = exp(s dt) the loop functions are functions of s up to half the sampling rate, to which the
margins of continuous loops apply; at half the sampling rate itself L is real, and may be -1.
Stability is by the eigenvalues of the closed loop in z: no approximation of a dead time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.control.plant import Plant
from updyn.control.servo import grid
from updyn.control.servo.controller import Controller, to_velocity
from updyn.control.servo.loops import Wiring
from updyn.control.servo.stability import Judged, count_drifting, count_growing, margins_of
from updyn.control.servo.state_space import StateSpace, Transfer, channel_zeros, connect
from updyn.errors import OptionError

__all__ = ["SampledCascade", "bilinear", "judge_sampled"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]
_TWO_PI = 2.0 * np.pi

#: Poles and zeros nearer to z = 0 than this are those of a delay.
_LATE = 1e-9
#: Gain at half the sampling rate below which it has vanished.
_VANISHED = 1e-9


def bilinear(system: StateSpace, c: float) -> StateSpace:
    """Return a system in z, by s = c (z - 1) / (z + 1).

    Parameters
    ----------
    system : StateSpace
        Continuous.
    c : float
        In 1/s: 2 / dt, or w / tan(w dt / 2) to keep the response at w.
    """
    if not system.n_states:
        return system
    eye = np.eye(system.n_states)
    left = c * eye - system.A
    into = np.asarray(np.linalg.solve(left, system.B), dtype=np.float64)
    out = np.asarray(np.linalg.solve(left.T, system.C.T).T, dtype=np.float64)
    root = float(np.sqrt(2.0 * c))
    return StateSpace(
        np.asarray(np.linalg.solve(left, c * eye + system.A), dtype=np.float64),
        root * into,
        root * out,
        system.D + system.C @ into,
    )


class SampledCascade:
    """A controller in a processor on one sampled plant.

    Parameters
    ----------
    plant : Plant
        Sampled, with the delay of its input.
    controller : Controller
        Its settings; the dead time is not used: hold and delay are those of the plant.
    wiring : Wiring
        Which inputs and outputs.

    Raises
    ------
    OptionError
        If the plant is not sampled, lacks a port, or one is an acceleration.
    """

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
        self.notes = _left_out(controller, plant)
        self._controller = _converted(controller, plant.dt)
        outputs = (wiring.velocity, wiring.position or wiring.velocity)
        rows = [plant.outputs.index(name) for name in outputs]
        column = plant.inputs.index(wiring.torque)
        self._system = StateSpace(
            plant.A, plant.B[:, [column]], plant.C[rows], plant.D[np.ix_(rows, [column])]
        )
        powers = np.array([to_velocity(plant, name) for name in outputs])
        powers[1] = powers[1] - 1 if self.has_position else 0
        self._readers = tuple(_reader(int(power), plant.dt) for power in powers)
        self._transfers = tuple(
            Transfer.of(part) for part in (self._system, *self._readers, self._controller)
        )

    def velocity(self, s: ArrayLike) -> _Complex:
        """Return L of the velocity loop, the position loop open, at s in rad/s, shape (n,)."""
        return self._parts(s)[0]

    def position(self, s: ArrayLike) -> _Complex:
        """Return L of the position loop, the velocity loop closed, at s in rad/s, shape (n,)."""
        inner, outer = self._parts(s)
        return np.asarray(outer / (1.0 + inner))

    def torque(self, s: ArrayLike) -> _Complex:
        """Return L broken at the torque, both loops closed, at s in rad/s, shape (n,)."""
        inner, outer = self._parts(s)
        return np.asarray(inner + outer)

    def _parts(self, s: ArrayLike) -> tuple[_Complex, _Complex]:
        """Return what the torque comes back as, by the velocity and by the position."""
        z = np.exp(np.asarray(s, dtype=np.complex128) * self.dt)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plant, first, second, controller = (t.at(z)[:, :, 0] for t in self._transfers)
            K = controller[:, 0]
            inner = K * first[:, 0] * plant[:, 0]
            outer = self.kv * K * second[:, 0] * plant[:, 1]
        return np.asarray(inner), np.asarray(outer)

    def closed(self, position: bool) -> _Complex:
        """Return the poles of the closed loop, z.

        Parameters
        ----------
        position : bool
            Whether the position loop is closed.
        """
        blocks = [self._system, *self._readers, self._controller]
        # inputs: torque, both readers, controller; outputs: both motions, as read, torque
        wires = np.zeros((4, 5))
        wires[0, 4] = wires[1, 0] = wires[2, 1] = 1.0
        wires[3, 2] = -1.0
        wires[3, 3] = -self.kv if position else 0.0
        return connect(blocks, wires, np.zeros((4, 1))).poles

    @property
    def features(self) -> _Complex:
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
        return self.in_s(np.concatenate(parts))

    def in_s(self, z: _Complex) -> _Complex:
        """Return log(z) / dt in rad/s, without what is at z = 0."""
        z = z[np.abs(z) > _LATE]
        return np.asarray(np.log(z) / self.dt)


def _left_out(controller: Controller, plant: Plant) -> tuple[str, ...]:
    """Return what of a controller is not in a sampled loop."""
    assert plant.dt is not None
    half, notes = 0.5 / plant.dt, []
    if controller.dead_time:
        delay = float(plant.facts.get("sampling", {}).get("delay", plant.delay * plant.dt))
        notes.append(
            f"the controller's dead time of {1e3 * controller.dead_time:g} ms is not in it: the"
            f" hold and the delay of the sampled plant, {1e3 * delay:g} ms, stand for it"
        )
    for notch in controller.notches:
        if notch.frequency >= half:
            notes.append(
                f"the notch at {notch.frequency:g} Hz is left out: half the sampling rate is"
                f" {half:g} Hz"
            )
    if controller.low_pass is not None and controller.low_pass >= half:
        notes.append(
            f"the low-pass at {controller.low_pass:g} Hz is left out: half the sampling rate is"
            f" {half:g} Hz"
        )
    return tuple(notes)


def _converted(controller: Controller, dt: float) -> StateSpace:
    """Return torque over velocity error in z, without what lies above half the sampling rate."""
    plain = Controller(controller.kp, controller.ti)
    out = bilinear(plain.state_space(), 2.0 / dt)
    for notch in controller.notches:
        if notch.frequency < 0.5 / dt:
            out = bilinear(notch.state_space(), _prewarped(notch.frequency, dt)) * out
    corner = controller.low_pass
    if corner is not None and corner < 0.5 / dt:
        low_pass = Controller(1.0, low_pass=corner, low_pass_damping=controller.low_pass_damping)
        out = bilinear(low_pass.state_space(), _prewarped(corner, dt)) * out
    return out


def _prewarped(freq: float, dt: float) -> float:
    w = _TWO_PI * freq
    return float(w / np.tan(0.5 * w * dt))


def _reader(power: int, dt: float) -> StateSpace:
    """Return what makes velocity or position of an output: a difference, nothing, or a sum."""
    one = np.ones((1, 1))
    if power == 1:  # (1 - 1 / z) / dt
        return StateSpace(0.0 * one, one, -one / dt, one / dt)
    if power == -1:
        return bilinear(StateSpace(0.0 * one, one, one, 0.0 * one), 2.0 / dt)
    return StateSpace.gain(1.0)


def judge_sampled(
    cascade: SampledCascade, continuous: Sequence[Judged | None]
) -> list[Judged | None]:
    """Return margins and stability of the loops of a sampled cascade.

    Parameters
    ----------
    cascade : SampledCascade
        Controller and sampled plant.
    continuous : sequence of Judged or None
        Velocity loop, position loop and the loop broken at the torque, on the continuous plant.

    Returns
    -------
    list of Judged or None
        The same loops, sampled; poles as s = log(z) / dt.
    """
    loops = cascade.velocity, cascade.position, cascade.torque
    return [
        None if own is None else _judged(cascade, loop, float(own.w[0]), position)
        for loop, own, position in zip(loops, continuous, (False, True, True), strict=True)
    ]


def _judged(
    cascade: SampledCascade, loop: Callable[[ArrayLike], _Complex], low: float, position: bool
) -> Judged:
    poles = cascade.in_s(cascade.closed(position))
    top = np.pi / cascade.dt
    low = min(low, 1e-3 * top)
    features = np.concatenate([cascade.features, poles])
    w, values = grid.resolved(loop, grid.frequencies(features, low, top))
    w, values = grid.with_extremes(loop, w, values)
    gains = grid.crossings_of_gain(loop, w, values)
    phases = grid.crossings_of_phase(loop, w, values)
    last = loop(np.array([1j * top]))[0]
    if last.real < -_VANISHED and not (len(phases) and phases[-1] > (1.0 - 1e-9) * top):
        phases = np.append(phases, top)
    scale = float(gains[0]) if len(gains) else low
    drifting = count_drifting(poles, scale)
    margins = margins_of(loop, w, values, gains, phases, count_growing(poles, scale), drifting, 0.0)
    return Judged(loop, w, values, margins, poles, 0, True)
