"""`simulate`: time response of a loop with backlash or friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import RealArray
from updyn.control.nonlinear.around import LinearLoop, linear_loop
from updyn.control.nonlinear.balance import LimitCycle
from updyn.control.nonlinear.nonlinearity import Nonlinearity
from updyn.control.nonlinear.pieces import PieceRules, rules
from updyn.control.nonlinear.settings import LOOP_SIMULATION
from updyn.control.nonlinear.settled import judge_end
from updyn.control.nonlinear.trajectory import integrate
from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.state_space import StateSpace
from updyn.errors import OptionError, suggest
from updyn.group import is_number
from updyn.nonlinear.backlash import Backlash

__all__ = ["Simulation", "simulate"]


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Time response of a loop with a nonlinearity.

    `time` in s has every step and every change of contact or sticking (`switches`). `reading` is
    the motion at the nonlinearity in `unit`, `torque` acts against it, in N m. `series`, shape
    (n_t, n_s), are the outputs of the plant and the torque of the controller, by `names`. `phase`
    is ``"gap"``, ``"contact +"``, ``"contact -"``, or ``"stick"``, ``"slip +"``, ``"slip -"``.
    `verdict` is ``"limit cycle"``, ``"decays"``, ``"at rest"``, ``"grows"`` or ``"not settled"``.
    Over the last `periods` of a limit cycle, `amplitude` is the first harmonic of `reading`, `peak`
    half of peak to peak, and `frequency` in Hz.
    """

    time: RealArray
    reading: RealArray
    torque: RealArray
    series: RealArray
    names: tuple[str, ...]
    phase: NDArray[np.str_]
    switches: RealArray
    verdict: str
    amplitude: float | None
    peak: float | None
    frequency: float | None
    periods: int
    unit: str
    facts: Mapping[str, object] = field(default_factory=dict)

    def __getitem__(self, name: str) -> RealArray:
        """Return a series by name, shape (n_t,)."""
        if name not in self.names:
            raise OptionError(
                f"the simulation has no series {name!r}; {suggest(str(name), self.names)}"
            )
        return self.series[:, self.names.index(name)]

    def summary(self) -> str:
        """Return the result as text."""
        head = f"{self.time[-1]:.5g} s, {len(self.switches)} changes of contact or sticking: "
        if self.verdict == "limit cycle":
            return (
                f"{head}limit cycle, amplitude {self.amplitude:.5g} {self.unit} (first harmonic;"
                f" half of peak to peak {self.peak:.5g}), {self.frequency:.5g} Hz"
            )
        return (
            head
            + {
                "decays": "the oscillation decays: no limit cycle.",
                "at rest": "it comes to rest: no limit cycle.",
                "grows": "the oscillation still grows at the end.",
                "not settled": "it has not settled by the end; simulate longer.",
            }[self.verdict]
        )


def simulate(
    plant: Plant,
    controller: Controller | StateSpace | tuple[object, ...] | None,
    nonlinearity: Nonlinearity,
    duration: float,
    at: str | tuple[str, str],
    *,
    start: LimitCycle | ArrayLike | None = None,
    scale: float = 1.0,
    constant: Mapping[str, float] | None = None,
    torque: str | None = None,
    velocity: str | None = None,
    position: str | None = None,
    measured: str | Sequence[str] | None = None,
    step: float | None = None,
    pade: int = 6,
) -> Simulation:
    """Simulate a loop with backlash or friction.

    The loop is piecewise linear (gap and two flanks; rest and two directions of motion): the matrix
    exponential gives each piece exactly, and the switches between pieces are located to rounding.

    Parameters
    ----------
    plant, controller, nonlinearity
        As for `limit_cycles`.
    duration : float
        In s; it ends with the last whole step.
    at : str or (str, str)
        As for `limit_cycles`.
    start : LimitCycle or array_like of float, shape (n,), optional
        Initial state: on a predicted limit cycle, or states of the plant, or of plant and
        controller. None: at rest in the middle.
    scale : float
        Factor on the start: 1.2 times a limit cycle is outside of it.
    constant : mapping of str to float, optional
        Constant inputs of the plant in their units (gravity, wind), and ``"reference"``, a step of
        the reference at time 0.
    torque, velocity, position, measured
        As for `limit_cycles`.
    step : float, optional
        In s. None: a fortieth of the shortest period of the loop's pieces. A contact or slip that
        begins and ends within one step is missed.
    pade : int
        As for `limit_cycles`.

    Returns
    -------
    Simulation

    Raises
    ------
    OptionError
        As `limit_cycles`; or if duration, step, start or a constant input is invalid.
    ModelError
        As `limit_cycles`.
    SolverError
        If the loop chatters, or its state overflows.

    Examples
    --------
    >>> import numpy as np
    >>> shaft = np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> drive = updyn.Model.from_groups(
    ...     {
    ...         "motor": updyn.Group(mass=np.diag([0.5, 0.0])),
    ...         "shaft": updyn.Group(2000.0 * shaft, loss_factor=0.02),
    ...         "load": updyn.Group(mass=np.diag([0.0, 2.0])),
    ...     },
    ...     ["1:RZ", "2:RZ"],
    ... )
    >>> made = updyn.plant(drive, ["1:RZ"], ["1:RZ"], (1.0, 50.0), quantity="mobility")
    >>> loop, friction = updyn.Controller(kp=20.0), updyn.CoulombFriction(1.0)
    >>> at = {"torque": "1:RZ", "velocity": "1:RZ"}
    >>> run = updyn.simulate(made, loop, friction, 0.5, "1:RZ", **at)
    >>> run.verdict
    'at rest'
    """
    names = {"torque": torque, "velocity": velocity, "position": position, "measured": measured}
    system = linear_loop(plant, controller, nonlinearity, at, names, pade)
    held = _constant_inputs(system, constant)
    pieces = rules(system, nonlinearity, held)
    length = _length(system, nonlinearity, pieces, duration, step)
    X = _start(system, plant, pieces, nonlinearity, start, scale)
    way = integrate(pieces, X, float(duration), length)
    along = [pieces.pieces[name] for name in way.names]
    w_rows = np.array([piece.w for piece in along])
    z_rows = np.array([piece.z for piece in along])
    w = np.einsum("tm,tm->t", way.states, w_rows[way.piece])
    z = np.einsum("tm,tm->t", way.states, z_rows[way.piece])
    series = (
        way.states[:, : pieces.n] @ system.series.T
        + np.outer(w, system.series_w)
        + system.series_e @ held
    )
    half = nonlinearity.half if isinstance(nonlinearity, Backlash) else 0.0
    end = judge_end(way.time, z, way.switches, half)
    facts = {"step": length, "switches": len(way.switches), "constant": dict(constant or {})}
    for array in (way.time, z, w, series, way.switches):
        array.flags.writeable = False
    return Simulation(
        way.time,
        z,
        -w,
        series,
        system.names,
        np.array(way.names)[way.piece],
        way.switches,
        end.verdict,
        end.amplitude,
        end.peak,
        end.frequency,
        end.periods,
        system.unit,
        facts,
    )


def _constant_inputs(system: LinearLoop, constant: Mapping[str, float] | None) -> RealArray:
    out = np.zeros(len(system.entries))
    for name, value in (constant or {}).items():
        if name not in system.entries:
            raise OptionError(
                f"simulation: no constant input {name!r}; {suggest(str(name), system.entries)}"
            )
        if not is_number(value) or not math.isfinite(value):
            raise OptionError(f"simulation: constant {name} is {value!r}; expected a finite number")
        out[system.entries.index(name)] = value
    return out


def _length(
    system: LinearLoop, nonlinearity: Nonlinearity, pieces: PieceRules, duration: Any, step: Any
) -> float:
    for what, value in (("duration", duration), ("step", 1.0 if step is None else step)):
        if not is_number(value) or not 0 < value < np.inf:
            raise OptionError(f"simulation: {what} {value!r}; expected a number above 0, in s")
    if step is None:
        rates = [np.linalg.eigvals(p.F) for p in pieces.pieces.values()]
        if isinstance(
            nonlinearity, Backlash
        ):  # without its damping, a flank bounces as fast or faster
            rates.append(system.poles_with(nonlinearity.stiffness, 0.0))
        fastest = max(float(np.abs(r.imag).max(initial=0.0)) for r in rates)
        step = duration / LOOP_SIMULATION.least_steps
        if fastest > 0:
            step = min(step, 2.0 * np.pi / fastest / LOOP_SIMULATION.steps_per_period)
    if duration / step > LOOP_SIMULATION.most_steps:
        raise OptionError(
            f"simulation: {duration:g} s take {duration / step:.3g} steps of {step:.3g} s; expected"
            f" at most {LOOP_SIMULATION.most_steps:g}: give a shorter duration, or a longer step="
        )
    return float(step)


def _start(
    system: LinearLoop,
    plant: Plant,
    pieces: PieceRules,
    nonlinearity: Nonlinearity,
    start: object,
    scale: float,
) -> RealArray:
    if not is_number(scale) or not math.isfinite(scale):
        raise OptionError(f"simulation: scale {scale!r}; expected a finite number")
    n = len(system.A)
    x: RealArray = np.zeros(n)
    if isinstance(start, LimitCycle):
        omega = 2.0 * np.pi * start.frequency
        w = -start.gain * start.amplitude  # of z = A exp(i psi)
        shape = np.linalg.solve(1j * omega * np.eye(n) - system.A, system.B * w)
        # Backlash starts in the gap with z = 0 and rising; friction at the largest velocity.
        x = np.asarray(shape.imag if isinstance(nonlinearity, Backlash) else shape.real)
    elif start is not None:
        try:
            given = np.asarray(start, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise OptionError(
                f"simulation: start {start!r}; expected a LimitCycle or numbers"
            ) from error
        if given.shape not in ((n,), (plant.n_states,)) or not np.isfinite(given).all():
            raise OptionError(
                f"simulation: start of shape {given.shape}; expected {plant.n_states} finite states"
                f" of the plant, or {n} of plant and controller"
            )
        x[: len(given)] = given
    return pieces.state(float(scale) * x)
