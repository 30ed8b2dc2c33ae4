"""`Cascade`: loop functions of a controller on one plant, and the closed loop in states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.control.plant import Plant
from updyn.control.ports import find_index
from updyn.control.servo.controller import Controller, require_continuous, to_velocity
from updyn.control.servo.state_space import StateSpace, Transfer, channel_zeros, connect
from updyn.errors import OptionError

__all__ = ["Cascade", "Wiring"]


#: The response is not finite at a pole of the plant; callers discard such lines.
_quiet = np.errstate(divide="ignore", invalid="ignore", over="ignore")


@dataclass(frozen=True, slots=True)
class Wiring:
    """Names of the plant's ports that a servo uses; the error of `pointing` is evaluated."""

    torque: str
    velocity: str
    position: str | None
    pointing: str
    disturbance: str | None

    @classmethod
    def of(
        cls,
        plant: Plant,
        controller: Controller,
        torque: str,
        velocity: str,
        position: str | None,
        pointing: str | None,
        disturbance: str | None,
    ) -> Wiring:
        """Return the wiring after a check of the names against a plant."""
        require_continuous(plant)
        for name, names, what in (
            (torque, plant.inputs, "input"),
            (disturbance, plant.inputs, "input"),
            (velocity, plant.outputs, "output"),
            (position, plant.outputs, "output"),
            (pointing, plant.outputs, "output"),
        ):
            if name is not None:
                find_index(name, names, what)
        if position is not None and controller.kv is None:
            raise OptionError(
                f"position {position!r} without a position loop; give kv to the controller"
            )
        place = None
        if controller.kv is not None:
            place = position or velocity
        out = cls(torque, velocity, place, pointing or place or velocity, disturbance)
        for name, what in ((velocity, "velocity"), (place, "position"), (out.pointing, "pointing")):
            if name is not None:
                to_velocity(plant, name, what)
        return out


class Cascade:
    """A controller on one continuous plant."""

    def __init__(self, plant: Plant, controller: Controller, wiring: Wiring) -> None:
        self.plant, self.controller, self.wiring = plant, controller, wiring
        inputs = [plant.inputs.index(wiring.torque)]
        if wiring.disturbance is not None:
            inputs.append(plant.inputs.index(wiring.disturbance))
        outputs = (wiring.velocity, wiring.position or wiring.velocity, wiring.pointing)
        rows = [plant.outputs.index(name) for name in outputs]
        self._system = StateSpace(
            plant.A, plant.B[:, inputs], plant.C[rows], plant.D[np.ix_(rows, inputs)]
        )
        self._transfer = Transfer.of(self._system)
        powers = np.array([to_velocity(plant, name) for name in outputs])
        points_at_velocity = wiring.position is None and wiring.pointing == wiring.velocity
        #: Powers of s that make velocity, position and pointing of the outputs (the pointing is a
        #: velocity without a position loop).
        self._powers = powers - np.array([0, 1, 0 if points_at_velocity else 1])
        self._derived = self._powers[0] == 1
        self._steep = bool(self._derived and self._system.D[0].any())
        if self._steep and not controller.rolls_off:
            raise OptionError(
                f"velocity {wiring.velocity!r} is derived from a displacement with direct"
                f" feed-through (residual flexibility {np.abs(self._system.D[0]).max():.3g}), so"
                " the loop gain is unbounded; make the plant with quantity='mobility' for that"
                " output, or give the controller a low_pass"
            )

    @property
    def has_position(self) -> bool:
        """Whether there is a position loop."""
        return self.controller.kv is not None

    # -- frequency domain -------------------------------------------------------------------------
    @_quiet
    def motion(self, s: ArrayLike) -> ComplexArray:
        """Return velocity, position and pointing over torque and disturbance, (n, 3, 1 or 2)."""
        s = np.asarray(s, dtype=np.complex128)
        return np.asarray(self._transfer.at(s) * s[:, None, None] ** self._powers[:, None])

    @_quiet
    def velocity(self, s: ArrayLike) -> ComplexArray:
        """Return L of the velocity loop, the position loop open, shape (n,)."""
        return np.asarray(self.controller.torque(s) * self.motion(s)[:, 0, 0])

    @_quiet
    def position(self, s: ArrayLike) -> ComplexArray:
        """Return L of the position loop, the velocity loop closed, shape (n,)."""
        G, K = self.motion(s), self.controller.torque(s)
        return np.asarray(self._kv * K * G[:, 1, 0] / (1.0 + K * G[:, 0, 0]))

    @_quiet
    def torque(self, s: ArrayLike) -> ComplexArray:
        """Return L broken at the torque, both loops closed, shape (n,)."""
        G = self.motion(s)
        return np.asarray(self.controller.torque(s) * (G[:, 0, 0] + self._kv * G[:, 1, 0]))

    @_quiet
    def feedback_channels(self, s: ArrayLike) -> ComplexArray:
        """Return the part of each output in L broken at the torque, shape (n, 1 or 2)."""
        G, K = self.motion(s), self.controller.torque(s)
        velocity, position = K * G[:, 0, 0], self._kv * K * G[:, 1, 0]
        if self.wiring.position in (None, self.wiring.velocity):
            return np.asarray((velocity + position)[:, None])
        return np.stack([velocity, position], axis=1)

    @_quiet
    def reference(self, s: ArrayLike) -> ComplexArray:
        """Return the closed loop from reference to position (or velocity), shape (n,)."""
        s = np.asarray(s, dtype=np.complex128)
        G, K = self.motion(s), self.controller.torque(s)
        if not self.has_position:
            return np.asarray(K * G[:, 0, 0] / (1.0 + K * G[:, 0, 0]))
        ahead = self._kv + self.controller.forward_gain * s
        return np.asarray(ahead * K * G[:, 1, 0] / (1.0 + K * (G[:, 0, 0] + self._kv * G[:, 1, 0])))

    @_quiet
    def compliance(self, s: ArrayLike) -> ComplexArray:
        """Return the closed loop from the disturbance to the pointing, shape (n,)."""
        G, K = self.motion(s), self.controller.torque(s)
        back = K * (G[:, 0] + self._kv * G[:, 1]).T  # from torque, from disturbance
        return np.asarray(G[:, 2, 1] - G[:, 2, 0] * back[1] / (1.0 + back[0]))

    @property
    def _kv(self) -> float:
        return self.controller.position_gain

    @property
    def poles(self) -> ComplexArray:
        """Poles of the open loops in rad/s without the dead time, including the integration."""
        added = [0.0] if self.has_position and self._powers[1] == -1 else []
        return np.concatenate(
            [self._transfer.poles, self.controller.poles, np.array(added, dtype=np.complex128)]
        )

    @property
    def velocity_poles(self) -> ComplexArray:
        """Poles of the open velocity loop in rad/s, without the dead time."""
        return np.concatenate([self._transfer.poles, self.controller.poles])

    @property
    def zeros(self) -> ComplexArray:
        """Nonzero zeros of velocity and position over torque and of the controller, in rad/s."""
        system = self._system
        found = [self.controller.zeros]
        for i in range(1 + self.has_position):
            channel = StateSpace(system.A, system.B[:, :1], system.C[[i]], system.D[[i]][:, :1])
            found.append(channel_zeros(channel))
        return np.concatenate(found)

    # -- state space ------------------------------------------------------------------------------
    def closed_loop(
        self, pade: int = 0, *, position: bool | None = None, pointing: bool = False
    ) -> StateSpace:
        """Return the closed loop as a state-space system; the dead time has order `pade`.

        Inputs: reference, its rate, velocity reference, disturbance. Outputs: position, torque, and
        the pointing on request; that of a velocity is integrated, which adds a pole at 0. Without a
        position loop the velocity replaces the position, and only the velocity reference acts.
        """
        outer = self.has_position
        if position is not None:
            outer = position
        plant, n_u = self._motion_states(outer, pointing), self._system.B.shape[1]
        controller = self._controller_states(pade)
        wires, entries, taps = self._connections(n_u, controller.B.shape[1], outer)
        if not pointing:
            taps = taps[:2]
        out = connect([plant, controller], wires, entries, taps)
        if self._steep:
            return self._differentiate_outputs(out, outer)
        return out

    def open_at_delay(self) -> StateSpace | None:
        """Return the loop broken at its dead time.

        Inputs: delayed torque, then those of `closed_loop`. Outputs: torque command, position,
        pointing. None if the velocity is derived from a displacement with direct feed-through: it
        would contain the derivative of the delayed torque.
        """
        outer = self.has_position
        if self._steep and not outer:
            return None
        plant, n_u = self._motion_states(outer, True), self._system.B.shape[1]
        controller = self._controller_states(0)
        wires, entries, taps = self._connections(n_u, controller.B.shape[1], outer)
        wires[0, 3] = 0.0
        late = np.zeros((len(entries), 1))
        late[0] = 1.0
        return connect([plant, controller], wires, np.hstack([late, entries]), taps[[1, 0, 2]])

    def _controller_states(self, pade: int) -> StateSpace:
        controller = self.controller.state_space(pade)
        if not self._steep:
            return controller
        # torque = K v_ref - (s K) y with the displacement y: s K is proper as K rolls off.
        A, B, C = controller.A, controller.B, controller.C
        return StateSpace(A, np.hstack([B, -A @ B]), C, np.hstack([np.zeros((1, 1)), -C @ B]))

    def _connections(
        self, n_u: int, n_c: int, outer: bool
    ) -> tuple[RealArray, RealArray, RealArray]:
        """Return wires, entries and taps of plant (n_u inputs) and controller (n_c inputs)."""
        kv, forward = 0.0, 0.0
        if outer:
            kv, forward = self._kv, self.controller.forward_gain
        # inputs: torque, (disturbance), controller (1 or 2); outputs: velocity or y, position,
        # pointing, torque
        wires = np.zeros((n_u + n_c, 4))
        wires[0, 3] = 1.0
        wires[n_u, 1] = -kv
        wires[n_u + n_c - 1, 0] = 1.0 if self._steep else -1.0
        entries = np.zeros((n_u + n_c, 4))
        entries[n_u, :3] = kv, forward, 1.0
        if n_u == 2:
            entries[1, 3] = 1.0
        taps = np.zeros((3, 4))
        taps[0, int(outer)] = taps[1, 3] = taps[2, 2] = 1.0
        return wires, entries, taps

    def _differentiate_outputs(self, closed: StateSpace, outer: bool) -> StateSpace:
        """Return a closed loop whose velocity outputs are differentiated displacements."""
        # The torque rolls off and causes no jump in them; an input that causes one gives nan in D.
        C, D = closed.C.copy(), closed.D.copy()
        for row, power in ((0, int(not outer)), (2, self._powers[2])):
            if power == 1 and row < len(C):
                C[row] = closed.C[row] @ closed.A
                D[row] = np.where(closed.D[row], np.nan, closed.C[row] @ closed.B)
        return StateSpace(closed.A, closed.B, C, D)

    def _motion_states(self, outer: bool, pointing: bool) -> StateSpace:
        """Return the plant from torque and disturbance to velocity, position and pointing."""
        # A velocity of a displacement with direct feed-through remains the displacement.
        A, B, C, D = (getattr(self._system, n) for n in "ABCD")
        powers = self._powers
        C, D = C.copy(), D.copy()
        integrated = [i for i in np.flatnonzero(powers == -1) if (outer, pointing)[i - 1]]
        for i in np.flatnonzero(powers == 1):
            if not D[i].any():
                C[i], D[i] = C[i] @ A, C[i] @ B
        n, extra = len(A), len(integrated)
        if extra:
            A = np.block([[A, np.zeros((n, extra))], [C[integrated], np.zeros((extra, extra))]])
            B = np.vstack([B, D[integrated]])
            C = np.hstack([C, np.zeros((3, extra))])
            for k, i in enumerate(integrated):
                C[i], D[i] = 0.0, 0.0
                C[i, n + k] = 1.0
        return StateSpace(A, B, C, D)
