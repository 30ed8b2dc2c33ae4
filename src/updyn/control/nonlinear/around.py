"""`Around`: the closed loop of plant and controller without its nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.nonlinear.elements import Backlash, CoulombFriction, Nonlinearity
from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.state_space import StateSpace, connect
from updyn.errors import ModelError, OptionError, suggest
from updyn.group import is_number

__all__ = ["Around", "around"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

_NOTHING = 1e-9  # flexibility beside that of the mesh


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """The closed loop without its nonlinearity.

        x' = A x + B w + E e,   z = C x + D w + G e

    with the torque w of the nonlinearity, the motion z that it reads, and the entries e. `series`
    are the rows of the plant's outputs and the controller's torque.

    Attributes
    ----------
    A : ndarray of float, shape (n, n)
    B, C : ndarray of float, shape (n,)
        Column of w, row of z.
    D : float
        Direct feed-through from w to z: residual flexibility.
    E : ndarray of float, shape (n, n_e)
        From the entries: every input of the plant, and the reference.
    G : ndarray of float, shape (n_e,)
    entries : tuple of str
        Their names.
    series : ndarray of float, shape (n_s, n)
    series_w, series_e : ndarray of float, shapes (n_s,), (n_s, n_e)
    names : tuple of str
        Of the series.
    output, input : str
        Between which the nonlinearity acts.
    unit : str
        Of what it reads.
    """

    A: _Real
    B: _Real
    C: _Real
    D: float
    E: _Real
    G: _Real
    entries: tuple[str, ...]
    series: _Real
    series_w: _Real
    series_e: _Real
    names: tuple[str, ...]
    output: str
    input: str
    unit: str

    def at(self, omega: _Real) -> _Complex:
        """Return z over w at some frequencies in rad/s, shape (n_f,)."""
        out = np.empty(len(omega), dtype=np.complex128)
        eye = np.eye(len(self.A))
        for start in range(0, len(omega), 256):
            part = omega[start : start + 256]
            columns = np.broadcast_to(self.B[None, :, None], (len(part), len(self.B), 1))
            X = np.linalg.solve(1j * part[:, None, None] * eye - self.A, columns)
            out[start : start + 256] = X[:, :, 0] @ self.C + self.D
        return out

    def under(self, stiffness: float, damping: float) -> _Complex:
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


def around(
    plant: Plant,
    controller: Controller | StateSpace | tuple[Any, ...] | None,
    nonlinearity: Nonlinearity,
    at: str | tuple[str, str],
    names: Mapping[str, Any],
    pade: int,
) -> Around:
    """Return what the nonlinearity sees.

    Parameters
    ----------
    plant : Plant
        Continuous, with an input and an output where the nonlinearity acts.
    controller : Controller, StateSpace, tuple of array_like or None
        What closes the loop.
    nonlinearity : Backlash or CoulombFriction
        What is pulled out.
    at : str or (str, str)
        Output and input of the plant between which it acts.
    names : mapping
        ``torque``, ``velocity``, ``position`` of a `Controller`, ``torque`` and ``measured`` of
        others; None: to find.
    pade : int
        Order for the dead time.

    Returns
    -------
    Around

    Raises
    ------
    OptionError
        If a name is missing or unknown, or the output is not of the kind that the nonlinearity
        reads.
    ModelError
        If the plant is a sampled one, or does not take the nonlinearity as its own torque.
    """
    if not isinstance(plant, Plant):
        raise OptionError(
            f"expected a Plant, found {type(plant).__name__}; make one with updyn.plant"
        )
    if not isinstance(nonlinearity, Backlash | CoulombFriction):
        raise OptionError(
            f"expected a Backlash or a CoulombFriction, found {type(nonlinearity).__name__}"
        )
    if plant.dt is not None:
        raise ModelError(
            f"the plant is sampled every {plant.dt:g} s; a nonlinearity acts in between: give the"
            " continuous one"
        )
    ends = (at, at) if isinstance(at, str) else tuple(at)
    if len(ends) != 2:
        raise OptionError(
            f"at={at!r}: expected the name of an output and an input, or (output, input)"
        )
    output, entry = ends
    i, j = _named(output, plant.outputs, "output"), _named(entry, plant.inputs, "input")
    if plant.quantities[i] != nonlinearity.quantity:
        kind = "twists" if isinstance(nonlinearity, Backlash) else "velocities"
        raise OptionError(
            f"{type(nonlinearity).__name__} reads {kind}, and output {output!r} of the plant is of"
            f" quantity {plant.quantities[i]!r}; make the plant with {nonlinearity.quantity!r}"
            " for it"
        )
    closed = _closed(plant, controller, (output, entry), names, pade)
    system, series = closed
    n_u = len(plant.inputs)
    C, D = system.C[i], system.D[i]
    out = Around(
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
    """Return the residual flexibility across a mesh; what rounding leaves of none is none."""
    if isinstance(nonlinearity, Backlash) and abs(D) * nonlinearity.stiffness < _NOTHING:
        return 0.0
    return D


def _check(system: Around, nonlinearity: Nonlinearity, push: float, n_u: int) -> None:
    if isinstance(nonlinearity, Backlash):
        if system.D < 0.0:
            raise ModelError(
                f"output {system.output!r} gives way against input {system.input!r}: they are not"
                " the two ends of one port; use the same Port for both"
            )
        return
    if np.any(system.G[: n_u + 1]):
        raise ModelError(
            f"output {system.output!r} follows a torque at once; friction needs the velocity of an"
            " inertia"
        )
    if not push > 0.0:
        raise ModelError(
            f"a torque at {system.input!r} does not accelerate {system.output!r}: friction needs"
            " input and output of one Port, with inertia there"
        )


# -- the loop -------------------------------------------------------------------------------------
def _closed(
    plant: Plant, controller: Any, ends: tuple[str, str], names: Mapping[str, Any], pade: int
) -> tuple[StateSpace, tuple[str, ...]]:
    """Return plant and controller as one system, the reference among its inputs."""
    own = StateSpace(plant.A, plant.B, plant.C, plant.D)
    n_u, n_y = len(plant.inputs), len(plant.outputs)
    if controller is None:
        _unused(names, ("torque", "velocity", "position", "measured"), "without a controller")
        blank = StateSpace(
            own.A,
            np.hstack([own.B, np.zeros((len(own.A), 1))]),
            own.C,
            np.hstack([own.D, np.zeros((n_y, 1))]),
        )
        return blank, plant.outputs
    torque = _torque(plant, ends[1], names.get("torque"))
    t = plant.inputs.index(torque)
    if isinstance(controller, Controller):
        _unused(names, ("measured",), "of a Controller; it has velocity= and position=")
        if controller.dead_time and not (is_number(pade) and 1 <= pade <= 12):
            raise OptionError(
                f"pade={pade!r}: expected an order from 1 to 12 for the dead time of the controller"
            )
        block = controller.state_space(pade)
        own, rows, weights = _cascade(plant, own, controller, ends[0], names)
        led = np.array([[1.0 if controller.kv is None else controller.position_gain]])
    else:
        _unused(names, ("velocity", "position"), "of a linear controller; it has measured=")
        block, rows = _linear(plant, controller, names.get("measured"))
        weights, led = np.eye(len(rows)), np.zeros((len(rows), 1))
    wires = np.zeros((n_u + block.B.shape[1], len(own.C) + 1))
    wires[t, -1] = 1.0
    wires[n_u:, rows] = weights
    entries = np.zeros((len(wires), n_u + 1))
    entries[:n_u, :n_u] = np.eye(n_u)
    entries[n_u:, n_u:] = led
    taps = np.zeros((n_y + 1, len(own.C) + 1))
    taps[:n_y, :n_y] = np.eye(n_y)
    taps[n_y, -1] = 1.0
    return connect([own, block], wires, entries, taps), (*plant.outputs, f"{torque} (controller)")


def _cascade(
    plant: Plant, own: StateSpace, controller: Controller, skip: str, names: Mapping[str, Any]
) -> tuple[StateSpace, list[int], _Real]:
    """Return the plant with velocity and position as last outputs, their rows and weights."""
    velocity = _measured(plant, names.get("velocity"), "velocity", "mobility", skip)
    C, D = _velocity(plant, velocity)
    own = StateSpace(own.A, own.B, np.vstack([own.C, C]), np.vstack([own.D, D]))
    at = len(own.C) - 1
    if controller.kv is None:
        _unused(names, ("position",), "of a velocity loop alone (kv=None)")
        return own, [at], np.array([[-1.0]])
    position = _measured(plant, names.get("position"), "position", "receptance", skip)
    p = plant.outputs.index(position)
    if plant.quantities[p] == "receptance":
        return own, [at, p], np.array([[-1.0, -controller.position_gain]])
    if plant.quantities[p] != "mobility":
        raise OptionError(
            f"position {position!r} is an acceleration; expected a displacement or a velocity"
        )
    # The integral of a velocity, as one more state.
    n = len(own.A)
    A = np.block([[own.A, np.zeros((n, 1))], [plant.C[[p]], np.zeros((1, 1))]])
    B = np.vstack([own.B, plant.D[[p]]])
    C = np.block([[own.C, np.zeros((len(own.C), 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    own = StateSpace(A, B, C, np.vstack([own.D, np.zeros((1, own.D.shape[1]))]))
    return own, [at, at + 1], np.array([[-1.0, -controller.position_gain]])


def _velocity(plant: Plant, name: str) -> tuple[_Real, _Real]:
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
            "controller (A, B, C, D): say measured=, the outputs that it reads;"
            f" {suggest('', plant.outputs)}"
        )
    wanted: Sequence[str] = [measured] if isinstance(measured, str) else list(measured)
    rows = [_named(name, plant.outputs, "output") for name in wanted]
    if block.B.shape[1] != len(rows) or block.C.shape[0] != 1:
        raise OptionError(
            f"controller (A, B, C, D): {block.B.shape[1]} inputs and {block.C.shape[0]} outputs;"
            f" expected {len(rows)} (measured) and 1 (torque)"
        )
    return block, rows


def _torque(plant: Plant, skip: str, name: Any) -> str:
    if name is not None:
        return plant.inputs[_named(name, plant.inputs, "input")]
    left = [n for n in plant.inputs if n != skip]
    if len(left) != 1:
        raise OptionError(
            f"say torque=, the input that the controller drives; {suggest('', plant.inputs)}"
        )
    return left[0]


def _measured(plant: Plant, name: Any, what: str, quantity: str, skip: str) -> str:
    if name is not None:
        return plant.outputs[_named(name, plant.outputs, "output")]
    of_kind: list[str] = []
    for name, kind in zip(plant.outputs, plant.quantities, strict=True):
        if kind == quantity and name != skip:
            of_kind.append(name)
    if len(of_kind) != 1:
        raise OptionError(
            f"say {what}=, the output that the controller takes as {what};"
            f" {suggest('', plant.outputs)}"
        )
    return of_kind[0]


def _named(name: Any, names: tuple[str, ...], what: str) -> int:
    if name not in names:
        raise OptionError(f"the plant has no {what} {name!r}; {suggest(str(name), names)}")
    return names.index(name)


def _unused(names: Mapping[str, Any], which: tuple[str, ...], why: str) -> None:
    for name in which:
        if names.get(name) is not None:
            raise OptionError(f"{name}={names[name]!r} has no meaning {why}")
