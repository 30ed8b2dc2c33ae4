"""`servo`: loop functions, margins and time responses of a controller on a plant or a family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.control.family import PlantFamily
from updyn.control.plant import Plant
from updyn.control.servo import grid
from updyn.control.servo.controller import Controller, rigid_inertia, rigid_ratio
from updyn.control.servo.digital import SampledCascade, judge_sampled
from updyn.control.servo.doubts import question_crossovers
from updyn.control.servo.loops import Cascade, Wiring
from updyn.control.servo.margins import Margins, RobustMargin, ranges
from updyn.control.servo.record import Loop, SampledLoops, Servo, StepResponse
from updyn.control.servo.robust import error_margin, family_margin
from updyn.control.servo.settings import RIGID_MOTION
from updyn.control.servo.stability import JudgedLoop, judge_loops, judge_torque
from updyn.control.servo.time_response import TimeResponses, time_responses
from updyn.control.servo.wind import Wind
from updyn.errors import DataError, OptionError, UpdynError
from updyn.frf import check_lines

__all__ = ["LOOPS", "margins_of_loops", "servo"]

_TWO_PI = 2.0 * np.pi
#: Names of the loops of a cascade.
LOOPS = ("velocity", "position", "torque")
_Disturbance = Wind | tuple[ArrayLike, ArrayLike]
#: Velocity loop, position loop, and both loops broken at the torque.
_Loops = tuple[JudgedLoop, JudgedLoop | None, JudgedLoop | None]


def servo(
    plant: Plant | PlantFamily,
    controller: Controller,
    *,
    torque: str,
    velocity: str,
    position: str | None = None,
    disturbance: str | None = None,
    pointing: str | None = None,
    freq: ArrayLike | None = None,
    step: float | None = 1.0,
    disturbance_step: float | None = 1.0,
    wind: _Disturbance | None = None,
    duration: float | None = None,
    family_steps: bool = False,
    sampled: Plant | None = None,
) -> Servo:
    """Return loop functions, margins and time responses of a controller on a plant.

    The feedback is negative; a positive torque must turn the velocity in the positive direction.
    Inputs of the plant other than `torque` and `disturbance` are 0. Frequency responses, margins
    and step responses use the exact dead time; the response to wind uses a Pade approximation of
    high order, whose stability is compared with the exact one.

    Parameters
    ----------
    plant : Plant or PlantFamily
        Continuous. For a family, the margins of every member are computed as well.
    controller : Controller
        Its settings.
    torque : str
        Name of the input that the controller drives.
    velocity : str
        Name of the output of the velocity loop; a displacement is differentiated, exactly.
    position : str, optional
        Name of the output of the position loop; by default `velocity`, integrated if it is a
        velocity.
    disturbance : str, optional
        Name of the input at which a disturbance acts; required with `wind`.
    pointing : str, optional
        Name of the output whose deviation under a disturbance is evaluated; by default the
        position.
    freq : array_like of float, shape (n_f,), optional
        Frequency lines of the results in Hz, above 0; by default dense around every resonance and
        antiresonance. The margins do not depend on them.
    step, disturbance_step : float or None
        Heights of the steps of the reference (in the unit of the position, or of the velocity
        without a position loop) and of the disturbance. None: no step.
    wind : Wind or (time, disturbance), optional
        Wind gusts, or a series of the disturbance: equally spaced times in s and values in the
        unit of the input.
    duration : float, optional
        Duration of the step responses in s; by default until they have settled.
    family_steps : bool
        Whether to compute the reference step response of every member of a family.
    sampled : Plant, optional
        The same plant from `updyn.sampled` with its delay: `Servo.sampled` then has the margins of
        the same controller as a digital one, converted by Tustin's rule with prewarped notches and
        low-pass. Hold and delay replace the dead time of the controller.

    Returns
    -------
    Servo

    Raises
    ------
    OptionError
        If a name, quantity or number is invalid, or the velocity is derived from a displacement
        with direct feed-through and the controller has no low-pass.
    DataError
        If frequency lines or a series are invalid.
    ModelError
        If the torque does not move an output of the controller.
    SolverError
        If stability with dead time cannot be determined.

    Examples
    --------
    >>> ports = {"torque": "M", "velocity": "speed"}
    >>> controller = updyn.Controller.tuned(plant, 5.0, **ports)  # doctest: +SKIP
    >>> found = updyn.servo(plant, controller, position="angle", **ports)  # doctest: +SKIP
    >>> print(found.summary())  # doctest: +SKIP
    """
    nominal, others = _plants(plant)
    if not isinstance(controller, Controller):
        raise OptionError(f"servo: expected a Controller, found {type(controller).__name__}")
    if wind is not None and disturbance is None:
        raise OptionError("servo: wind without disturbance; name the input at which it acts")
    wiring = Wiring.of(nominal, controller, torque, velocity, position, pointing, disturbance)
    cascade = Cascade(nominal, controller, wiring)
    judged = _judge_loops(cascade)
    inertia = rigid_inertia(nominal, torque, velocity)
    family = [_member(k, p, controller, wiring) for k, p in enumerate(others)]
    members = [judgements for _, judgements in family]
    lines = _lines(freq, judged, members)
    loops = []
    for k, name in enumerate(LOOPS):
        loop = judged[k]
        if loop is not None:
            record = _loop(name, loop, lines, [_require_loop(m[k]) for m in members])
            loops.append(replace(record, modulus_range=_modulus_range(cascade, loop, name)))
    outer = judged[1] or judged[0]
    s = 1j * _TWO_PI * lines
    over_time = TimeResponses()
    if outer.margins.stable and outer.agrees:
        over_time = time_responses(cascade, outer, step, disturbance_step, wind, duration)
    steps: tuple[StepResponse | None, ...] = ()
    if family_steps and step is not None:
        steps = tuple(_simulate_step(loop, m[1] or m[0], step, duration) for loop, m in family)
    return Servo(
        controller=controller,
        torque=torque,
        velocity=velocity,
        position=wiring.position,
        disturbance=disturbance,
        pointing=pointing,
        plant=_facts(nominal, len(others), inertia),
        velocity_loop=loops[0],
        position_loop=loops[1] if len(loops) > 1 else None,
        torque_loop=loops[2] if len(loops) > 2 else None,
        freq=lines,
        reference=cascade.reference(s),
        bandwidth=_bandwidth(cascade.reference, outer),
        compliance=None if disturbance is None else cascade.compliance(s),
        poles=outer.poles,
        step=over_time.step,
        disturbance_step=over_time.disturbance_step,
        wind=over_time.wind,
        notes=(
            *_notes(nominal, loops[:2], outer, inertia),
            *_ratio_notes(nominal, controller, wiring),
            *over_time.notes,
        ),
        doubts=question_crossovers(nominal, controller, loops[:2], inertia),
        family_steps=steps,
        sampled=None
        if sampled is None
        else _judge_sampled_loops(sampled, controller, wiring, judged),
        robust=_robust(cascade, judged, [loop for loop, _ in family]),
    )


def _judge_sampled_loops(
    plant: Plant, controller: Controller, wiring: Wiring, judged: Sequence[JudgedLoop | None]
) -> SampledLoops:
    if not isinstance(plant, Plant):
        raise OptionError(f"sampled: expected a Plant, found {type(plant).__name__}")
    cascade = SampledCascade(plant, controller, wiring)
    loops: list[Loop | None] = []
    for name, judged_loop in zip(LOOPS, judge_sampled(cascade, judged), strict=True):
        if judged_loop is None:
            loops.append(None)
            continue
        lines = judged_loop.w / _TWO_PI
        loops.append(_loop(name, judged_loop, lines[_is_drawable(lines, [judged_loop], [])], []))
    velocity = loops[0]
    assert velocity is not None
    return SampledLoops(
        cascade.dt,
        plant.delay,
        velocity,
        loops[1],
        loops[2],
        cascade.closed_poles(cascade.has_position),
        cascade.notes,
    )


def _plants(given: Plant | PlantFamily) -> tuple[Plant, tuple[Plant, ...]]:
    if isinstance(given, Plant):
        return given, ()
    if not isinstance(given, PlantFamily):
        raise OptionError(f"servo: expected a Plant or a PlantFamily, found {type(given).__name__}")
    return given.nominal, given.members


def margins_of_loops(
    plants: Sequence[Plant], controller: Controller, wiring: Wiring
) -> tuple[dict[str, Margins], ...]:
    """Return the margins of each plant by loop: velocity, position, torque."""
    found = []
    for number, one in enumerate(plants):
        _, loops = _member(number, one, controller, wiring)
        named = zip(LOOPS, loops, strict=True)
        found.append({name: loop.margins for name, loop in named if loop is not None})
    return tuple(found)


def _judge_loops(cascade: Cascade) -> _Loops:
    """Return the velocity loop, the position loop, and both broken at the torque."""
    inner, outer = judge_loops(cascade)
    return inner, outer, None if outer is None else judge_torque(cascade, outer)


def _simulate_step(
    cascade: Cascade, outer: JudgedLoop | None, step: float, duration: float | None
) -> StepResponse | None:
    """Return the response to a step of the reference; None if unstable."""
    if outer is None or not (outer.margins.stable and outer.agrees):
        return None
    return time_responses(cascade, outer, step, None, None, duration).step


def _member(
    number: int, plant: Plant, controller: Controller, wiring: Wiring
) -> tuple[Cascade, _Loops]:
    try:
        cascade = Cascade(plant, controller, wiring)
        return cascade, _judge_loops(cascade)
    except UpdynError as error:
        raise type(error)(f"member {number} of the family: {error}") from error


def _require_loop(judged: JudgedLoop | None) -> JudgedLoop:
    assert judged is not None
    return judged


def _lines(
    freq: ArrayLike | None,
    judged: Sequence[JudgedLoop | None],
    members: Sequence[Sequence[JudgedLoop | None]],
) -> RealArray:
    """Return the frequency lines of the results in Hz."""
    if freq is not None:
        given = check_lines(np.atleast_1d(np.asarray(freq)))
        if given[0] == 0:
            raise DataError(
                "freq: the first line is 0 Hz, where a loop with integration is not finite; remove"
                " it"
            )
        lost = given[~_is_drawable(given, judged, members)]
        if len(lost):
            raise DataError(
                f"freq: {lost[0]:g} Hz is a pole or zero of the loop on the imaginary axis; remove"
                " it"
            )
        return given
    loop_lines = np.unique(np.concatenate([j.w for j in judged if j is not None]))
    peaks = [np.abs(j.poles.imag) for m in members for j in m if j is not None]
    more = np.concatenate([np.zeros(0), *peaks])
    more = more[(more > loop_lines[0]) & (more < loop_lines[-1])]
    lines = np.asarray(np.unique(np.concatenate([loop_lines, more])) / _TWO_PI)
    return lines[_is_drawable(lines, judged, members)]


def _is_drawable(
    lines: RealArray,
    judged: Sequence[JudgedLoop | None],
    members: Sequence[Sequence[JudgedLoop | None]],
) -> BoolArray:
    """Return a mask of the lines at which every loop function is finite and nonzero."""
    good = np.ones(len(lines), dtype=bool)
    for one in chain(judged, *members):
        if one is not None:
            L = one.loop(2j * np.pi * lines)
            good &= np.isfinite(L) & (L != 0)
    return good


def _loop(name: str, judged: JudgedLoop, lines: RealArray, members: Sequence[JudgedLoop]) -> Loop:
    L, phase = _sample_loop(judged, lines)
    family = np.zeros((len(members), len(lines)), dtype=np.complex128)
    family_phase = np.zeros(family.shape)
    for i, member in enumerate(members):
        family[i], family_phase[i] = _sample_loop(member, lines)
    margins = tuple(member.margins for member in members)
    return Loop(
        name=name,
        freq=lines,
        L=L,
        phase=phase,
        margins=judged.margins,
        bandwidth=_bandwidth(lambda s: (L := judged.loop(s)) / (1.0 + L), judged),
        family=family,
        family_phase=family_phase,
        members=margins,
        worst=ranges(margins) if margins else {},
    )


def _modulus_range(cascade: Cascade, judged: JudgedLoop, name: str) -> tuple[float, float] | None:
    """Return the bounds of the modulus margin for the relative error d of the plant."""
    # The velocity loop L changes by d |L|; the position loop by the share d (1 + |T|) / (1 - d
    # |T|), T = L / (1 + L) of the velocity loop; the loop at the torque by d times the sum of the
    # moduli of its two parts. |1 + L| changes by no more than L.
    plant, at = cascade.plant, judged.margins.modulus_margin_at
    error, (low, high) = plant.relative_error, plant.band
    if not error < 1.0 or at is None or not low <= at <= high:  # beyond 1 the bound is 0
        return None
    w = judged.w[(judged.w >= _TWO_PI * low) & (judged.w <= _TWO_PI * high)]
    s = 1j * np.append(w, _TWO_PI * at)
    L, inner = judged.loop(s), cascade.velocity(s)
    off = error * np.abs(L)
    if name == "position":
        T = np.abs(inner / (1.0 + inner))
        with np.errstate(divide="ignore"):
            off = off * (1.0 + T) / np.maximum(1.0 - error * T, 0.0)
    elif name == "torque":
        off = error * (np.abs(inner) + np.abs(L - inner))
    size = np.abs(1.0 + L)
    return float(max(np.min(size - off), 0.0)), float(np.min(size + off))


def _robust(
    cascade: Cascade, judged: Sequence[JudgedLoop | None], members: Sequence[Cascade]
) -> tuple[RobustMargin, ...]:
    whole = judged[2] or judged[0]
    if whole is None or not whole.margins.stable:
        return ()
    found = [error_margin(cascade, whole)]
    if members:
        found.insert(0, family_margin(cascade, whole, members))
    return tuple(margin for margin in found if margin is not None)


def _sample_loop(judged: JudgedLoop, lines: RealArray) -> tuple[ComplexArray, RealArray]:
    """Return the loop function and its unwrapped phase in degrees at given lines."""
    w = _TWO_PI * lines
    L = judged.loop(1j * w)
    phase = np.degrees(np.angle(L))
    dense = np.interp(np.log(w), np.log(judged.w), grid.unwrap_phase(judged.w, judged.values))
    return L, np.asarray(phase + 360.0 * np.round((dense - phase) / 360.0))


def _bandwidth(closed: grid.Loop, judged: JudgedLoop) -> float | None:
    """Return the first -3 dB frequency of a stable closed loop in Hz."""
    if not judged.margins.stable:
        return None
    rest = abs(closed(1e-4j * judged.w[:1])[0])

    def above(w: RealArray) -> RealArray:
        return np.asarray(np.abs(closed(1j * w)) / rest - np.sqrt(0.5))

    found = grid.find_level_crossing(above, judged.w, above(judged.w))
    if found is None:
        return None
    return found / _TWO_PI


def _facts(plant: Plant, members: int, inertia: float | None) -> dict[str, object]:
    return {
        "states": plant.n_states,
        "modes": tuple(map(float, plant.modes)),
        "rigid": plant.rigid,
        "band": tuple(plant.band),
        "error": plant.error,
        "relative_error": plant.relative_error,
        "route": plant.route,
        "inertia": inertia,
        "members": members,
    }


def _ratio_notes(plant: Plant, controller: Controller, wiring: Wiring) -> list[str]:
    """Return a note if the controller's gear ratio differs from that of the rigid-body motion."""
    if wiring.position is None or controller.kv is None:
        return []
    found = rigid_ratio(plant, wiring.torque, wiring.velocity, wiring.position)
    if found is None or abs(controller.ratio / found - 1.0) < RIGID_MOTION.noted_ratio_difference:
        return []
    return [
        f"position loop: in rigid-body motion {wiring.velocity!r} moves {found:.4g} times as fast"
        f" as {wiring.position!r}, but the controller's ratio is {controller.ratio:.4g}: the"
        f" effective kv is {controller.position_gain / found:.4g} 1/s; ratio = {found:.4g} gives"
        " the stated kv"
    ]


def _notes(
    plant: Plant, loops: Sequence[Loop], outer: JudgedLoop, inertia: float | None
) -> list[str]:
    notes = []
    if inertia is not None and inertia < 0:
        notes.append(
            "a positive torque turns the velocity in the negative direction: the feedback is"
            " positive; reverse one of the two ports"
        )
    for loop in loops:
        m = loop.margins
        places: list[tuple[str, float | None]] = [("gain 1", f) for f in m.gain_crossings]
        places += [("gain margin", m.gain_margin_at), ("modulus margin", m.modulus_margin_at)]
        outside = []
        for what, at in places:
            if at is not None and at > plant.band[1]:
                outside.append(f"{what} ({at:.4g} Hz)")
        if outside:
            notes.append(
                f"{loop.name} loop: {', '.join(outside)} above {plant.band[1]:g} Hz, the end of the"
                " band of the plant"
            )
    if not outer.margins.stable:
        notes.append("the closed loop is unstable: no bandwidth and no time responses")
    elif not outer.agrees:
        notes.append(
            f"with its dead time approximated (order {outer.pade}) the loop is unstable, with the"
            " exact dead time it is stable: no time responses"
        )
    return notes
