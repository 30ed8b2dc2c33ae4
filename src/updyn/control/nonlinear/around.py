"""`LinearLoop`: the closed loop of plant and controller without its nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.nonlinear.nonlinearity import Nonlinearity
from updyn.control.nonlinear.settings import MESH
from updyn.control.plant import Plant
from updyn.control.ports import find_index
from updyn.control.servo.controller import Controller
from updyn.control.servo.state_space import StateSpace, connect
from updyn.errors import ModelError, OptionError, suggest
from updyn.group import is_number
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction

__all__ = ["LinearLoop", "linear_loop"]


@dataclass(frozen=True, slots=True, eq=False)
class LinearLoop:
    """The closed loop without its nonlinearity.

        x' = A x + B w + E e,   z = C x + D w + G e

    with the torque w of the nonlinearity, the motion z that it acts on, in `unit`, and the inputs
    e: every input of the plant, and the reference. `series`, `series_w` and `series_e` give the
    outputs of the plant and the torque of the controller from x, w and e. D is residual
    flexibility.
    """

    A: RealArray
    B: RealArray
    C: RealArray
    D: float
    E: RealArray
    G: RealArray
    entries: tuple[str, ...]
    series: RealArray
    series_w: RealArray
    series_e: RealArray
    names: tuple[str, ...]
    output: str
    input: str
    unit: str

    def at(self, omega: RealArray) -> ComplexArray:
        """Return z over w at frequencies in rad/s, shape (n_f,)."""
        out = np.empty(len(omega), dtype=np.complex128)
        eye = np.eye(len(self.A))
        for start in range(0, len(omega), 256):
            part = omega[start : start + 256]
            columns = np.broadcast_to(self.B[None, :, None], (len(part), len(self.B), 1))
            X = np.linalg.solve(1j * part[:, None, None] * eye - self.A, columns)
            out[start : start + 256] = X[:, :, 0] @ self.C + self.D
        return out

    def poles_with(self, stiffness: float, damping: float) -> ComplexArray:
        """Return the poles in rad/s for w = -(stiffness z + damping z'), shape (n,) or (n + 1,)."""
        if damping == 0.0:
            A = self.A - np.outer(self.B, stiffness * self.C) / (1.0 + stiffness * self.D)
        elif self.D == 0.0:
            row = stiffness * self.C + damping * (self.C @ self.A)
            A = self.A - np.outer(self.B, row) / (1.0 + damping * float(self.C @ self.B))
        else:
            # z is a state: w = (z - C x) / D, and damping z' = -w - stiffness z.
            w = np.append(-self.C, 1.0) / self.D
            z = -w / damping
            z[-1] -= stiffness / damping
            A = np.vstack(
                [np.hstack([self.A, np.zeros((len(self.A), 1))]) + np.outer(self.B, w), z]
            )
        return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)


def linear_loop(
    plant: Plant,
    controller: Controller | StateSpace | tuple[object, ...] | None,
    nonlinearity: Nonlinearity,
    at: str | tuple[str, str],
    names: Mapping[str, object],
    pade: int,
) -> LinearLoop:
    """Return the closed loop without its nonlinearity, which acts between output and input `at`.

    `names` are ``torque``, ``velocity``, ``position`` of a `Controller`, ``torque`` and
    ``measured`` of others; None: the only candidate. `pade` is the order for the dead time.
    """
    if not isinstance(plant, Plant):
        raise OptionError(
            f"expected a Plant, found {type(plant).__name__}; make one with updyn.plant"
        )
    if not isinstance(nonlinearity, Backlash | CoulombFriction):
        raise OptionError(
            f"expected a Backlash or a CoulombFriction, found {type(nonlinearity).__name__}"
        )
    if isinstance(nonlinearity, Backlash) and nonlinearity.offset:
        raise OptionError(
            f"backlash: offset {nonlinearity.offset:g} rad; expected 0 in a loop, where a constant"
            " torque or the reference gives the preload"
        )
    if isinstance(nonlinearity, CoulombFriction) and nonlinearity.transition:
        raise OptionError(
            f"friction: transition {nonlinearity.transition:g} rad/s; expected 0 in a loop, which"
            " uses the exact law"
        )
    if plant.dt is not None:
        raise ModelError(
            f"the plant is sampled every {plant.dt:g} s; a nonlinearity also acts between samples:"
            " give the continuous plant"
        )
    ends = (at, at) if isinstance(at, str) else tuple(at)
    if len(ends) != 2:
        raise OptionError(
            f"at={at!r}: expected the name of an output and an input, or (output, input)"
        )
    output, entry = ends
    i, j = find_index(output, plant.outputs, "output"), find_index(entry, plant.inputs, "input")
    if plant.quantities[i] != nonlinearity.quantity:
        kind = "twists" if isinstance(nonlinearity, Backlash) else "velocities"
        raise OptionError(
            f"{type(nonlinearity).__name__} acts on {kind}, but output {output!r} of the plant has"
            f" quantity {plant.quantities[i]!r}; make the plant with {nonlinearity.quantity!r}"
            " for it"
        )
    closed = _close_loop(plant, controller, (output, entry), names, pade)
    system, series = closed
    n_u = len(plant.inputs)
    C, D = system.C[i], system.D[i]
    out = LinearLoop(
        system.A,
        system.B[:, j],
        C,
        _flexibility(float(D[j]), nonlinearity),
        system.B,
        D,
        (*plant.inputs, "reference"),
        system.C,
        system.D[:, j],
        system.D,
        series,
        output,
        entry,
        plant.output_units[i],
    )
    _check(out, nonlinearity, float(plant.C[i] @ plant.B[:, j]), n_u)
    return out


def _flexibility(D: float, nonlinearity: Nonlinearity) -> float:
    """Return the residual flexibility across a mesh, 0 if it is rounding."""
    if (
        isinstance(nonlinearity, Backlash)
        and abs(D) * nonlinearity.stiffness < MESH.least_flexibility
    ):
        return 0.0
    return D


def _check(system: LinearLoop, nonlinearity: Nonlinearity, push: float, n_u: int) -> None:
    if isinstance(nonlinearity, Backlash):
        if system.D < 0.0:
            raise ModelError(
                f"output {system.output!r} yields against input {system.input!r}: they are not"
                " the two ends of one port; use the same Port for both"
            )
        return
    if np.any(system.G[: n_u + 1]):
        raise ModelError(
            f"output {system.output!r} responds to a torque without delay; friction needs the"
            " velocity of an inertia"
        )
    if not push > 0.0:
        raise ModelError(
            f"a torque at {system.input!r} does not accelerate {system.output!r}: friction needs"
            " input and output of one Port, with an inertia"
        )


# -- the loop -------------------------------------------------------------------------------------
def _close_loop(
    plant: Plant, controller: object, ends: tuple[str, str], names: Mapping[str, object], pade: int
) -> tuple[StateSpace, tuple[str, ...]]:
    """Return plant and controller as one system with the reference as an input, and its outputs."""
    system = StateSpace(plant.A, plant.B, plant.C, plant.D)
    n_u, n_y = len(plant.inputs), len(plant.outputs)
    if controller is None:
        _refuse_options(
            names, ("torque", "velocity", "position", "measured"), "without a controller"
        )
        blank = StateSpace(
            system.A,
            np.hstack([system.B, np.zeros((len(system.A), 1))]),
            system.C,
            np.hstack([system.D, np.zeros((n_y, 1))]),
        )
        return blank, plant.outputs
    torque = _torque(plant, ends[1], names.get("torque"))
    t = plant.inputs.index(torque)
    if isinstance(controller, Controller):
        _refuse_options(names, ("measured",), "of a Controller; it has velocity= and position=")
        if controller.dead_time and not (is_number(pade) and 1 <= pade <= 12):
            raise OptionError(
                f"pade={pade!r}: expected an order from 1 to 12 for the dead time of the controller"
            )
        block = controller.state_space(pade)
        system, rows, weights = _cascade(plant, system, controller, ends[0], names)
        led = np.array([[1.0 if controller.kv is None else controller.position_gain]])
    else:
        _refuse_options(names, ("velocity", "position"), "of a linear controller; it has measured=")
        block, rows = _linear(plant, controller, names.get("measured"))
        weights, led = np.eye(len(rows)), np.zeros((len(rows), 1))
    wires = np.zeros((n_u + block.B.shape[1], len(system.C) + 1))
    wires[t, -1] = 1.0
    wires[n_u:, rows] = weights
    entries = np.zeros((len(wires), n_u + 1))
    entries[:n_u, :n_u] = np.eye(n_u)
    entries[n_u:, n_u:] = led
    taps = np.zeros((n_y + 1, len(system.C) + 1))
    taps[:n_y, :n_y] = np.eye(n_y)
    taps[n_y, -1] = 1.0
    return connect([system, block], wires, entries, taps), (
        *plant.outputs,
        f"{torque} (controller)",
    )


def _cascade(
    plant: Plant, system: StateSpace, controller: Controller, skip: str, names: Mapping[str, object]
) -> tuple[StateSpace, list[int], RealArray]:
    """Return the plant with velocity and position as last outputs, their rows and weights."""
    velocity = _select_output(plant, names.get("velocity"), "velocity", "mobility", skip)
    C, D = _velocity(plant, velocity)
    system = StateSpace(system.A, system.B, np.vstack([system.C, C]), np.vstack([system.D, D]))
    at = len(system.C) - 1
    if controller.kv is None:
        _refuse_options(names, ("position",), "of a velocity loop alone (kv=None)")
        return system, [at], np.array([[-1.0]])
    position = _select_output(plant, names.get("position"), "position", "receptance", skip)
    p = plant.outputs.index(position)
    if plant.quantities[p] == "receptance":
        return system, [at, p], np.array([[-1.0, -controller.position_gain]])
    if plant.quantities[p] != "mobility":
        raise OptionError(
            f"position {position!r} is an acceleration; expected a displacement or a velocity"
        )
    # The integral of a velocity is an additional state.
    n = len(system.A)
    A = np.block([[system.A, np.zeros((n, 1))], [plant.C[[p]], np.zeros((1, 1))]])
    B = np.vstack([system.B, plant.D[[p]]])
    C = np.block([[system.C, np.zeros((len(system.C), 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    system = StateSpace(A, B, C, np.vstack([system.D, np.zeros((1, system.D.shape[1]))]))
    return system, [at, at + 1], np.array([[-1.0, -controller.position_gain]])


def _velocity(plant: Plant, name: str) -> tuple[RealArray, RealArray]:
    i = plant.outputs.index(name)
    if plant.quantities[i] == "mobility":
        return plant.C[[i]], plant.D[[i]]
    if plant.quantities[i] != "receptance":
        raise OptionError(
            f"velocity {name!r} is an acceleration; expected a velocity or a displacement"
        )
    if np.any(plant.D[i]):
        raise OptionError(
            f"velocity {name!r} is a displacement with residual flexibility, whose derivative is"
            " not proper; make the plant with quantity 'mobility' for it"
        )
    return plant.C[[i]] @ plant.A, plant.C[[i]] @ plant.B


def _linear(plant: Plant, given: Any, measured: Any) -> tuple[StateSpace, list[int]]:
    if isinstance(given, StateSpace):
        block = given
    else:
        try:
            A, B, C, D = (np.atleast_2d(np.asarray(m, dtype=np.float64)) for m in given)
        except (TypeError, ValueError) as error:
            raise OptionError(
                f"controller: expected a Controller, (A, B, C, D) or None, found {given!r}"
            ) from error
        n = 0 if A.size == 0 else len(A)
        block = StateSpace(A.reshape(n, n), B.reshape(n, D.shape[1]), C.reshape(D.shape[0], n), D)
    if measured is None:
        raise OptionError(
            "controller (A, B, C, D): expected measured=, the outputs that it reads;"
            f" {suggest('', plant.outputs)}"
        )
    wanted: Sequence[str] = [measured] if isinstance(measured, str) else list(measured)
    rows = [find_index(name, plant.outputs, "output") for name in wanted]
    if block.B.shape[1] != len(rows) or block.C.shape[0] != 1:
        raise OptionError(
            f"controller (A, B, C, D): {block.B.shape[1]} inputs and {block.C.shape[0]} outputs;"
            f" expected {len(rows)} (measured) and 1 (torque)"
        )
    return block, rows


def _torque(plant: Plant, skip: str, name: object) -> str:
    if name is not None:
        return plant.inputs[find_index(name, plant.inputs, "input")]
    inputs = [n for n in plant.inputs if n != skip]
    if len(inputs) != 1:
        raise OptionError(
            f"expected torque=, the input of the controller; {suggest('', plant.inputs)}"
        )
    return inputs[0]


def _select_output(plant: Plant, name: object, what: str, quantity: str, skip: str) -> str:
    if name is not None:
        return plant.outputs[find_index(name, plant.outputs, "output")]
    of_kind: list[str] = []
    for name, kind in zip(plant.outputs, plant.quantities, strict=True):
        if kind == quantity and name != skip:
            of_kind.append(name)
    if len(of_kind) != 1:
        raise OptionError(
            f"expected {what}=, the output that the controller uses as {what};"
            f" {suggest('', plant.outputs)}"
        )
    return of_kind[0]


def _refuse_options(names: Mapping[str, object], which: tuple[str, ...], why: str) -> None:
    for name in which:
        if names.get(name) is not None:
            raise OptionError(f"{name}={names[name]!r} has no meaning {why}")
