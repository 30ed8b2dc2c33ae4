"""`limit_cycles`: limit cycles of a loop with one nonlinearity, by harmonic balance.

With the linear part z = S(s) w and the describing function w = -N(A, omega) z, an oscillation
z = A sin(omega t) exists where

    N(A, omega) = -1 / S(i omega).

|N| is monotonic in A, so each frequency has at most one amplitude at which the moduli agree. The
remaining equation, of the phases, is solved along the frequency axis: a scan finds all roots,
which are then refined (Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear
System Design, 1968, chapter 3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from updyn.arrays import ComplexArray, RealArray
from updyn.control.nonlinear.around import LinearLoop, linear_loop
from updyn.control.nonlinear.nonlinearity import Nonlinearity, find_doubt
from updyn.control.nonlinear.settings import HARMONIC_BALANCE
from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.state_space import StateSpace
from updyn.errors import OptionError
from updyn.group import is_number
from updyn.nonlinear.backlash import Backlash
from updyn.updating.result import interval_quantile

__all__ = ["LimitCycle", "LimitCycles", "limit_cycles"]

_TWO_PI = 2.0 * np.pi


#: Words for the stability of a cycle or a loop.
_STABLE = {True: "stable", False: "unstable"}


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """A limit cycle predicted by harmonic balance.

    `amplitude` is that of the first harmonic at the nonlinearity, in `unit`; `frequency` is in Hz;
    `gain` is the describing function. `stable`: the loop returns to the cycle, as Loeb's criterion
    (`loeb`) holds and no other pole of the loop under the oscillation is unstable; an unstable
    cycle is a boundary between decay and growth. `third` is the neglected third harmonic |S(3 i
    omega) T_3| / A. `doubt`, if not empty, is the reason for a simulation: the prediction may be
    off by more than a tenth, or the cycle may not exist. Of a loop with members,
    `amplitude_interval` and `frequency_interval` are 95 % intervals, and `share` is the share of
    the members that have the cycle.
    """

    amplitude: float
    frequency: float
    stable: bool
    loeb: bool
    gain: complex
    third: float
    unit: str
    doubt: str = ""
    amplitude_interval: tuple[float, float] | None = None
    frequency_interval: tuple[float, float] | None = None
    share: float = 1.0

    def __str__(self) -> str:
        kind = _STABLE[self.stable]
        doubt = f" (doubtful: {self.doubt})" if self.doubt else ""
        text = f"{kind}, amplitude {self.amplitude:.5g} {self.unit}, {self.frequency:.5g} Hz"
        if self.amplitude_interval is not None and self.frequency_interval is not None:
            (small, large), (low, high) = self.amplitude_interval, self.frequency_interval
            text += f" (95 %: {small:.5g} to {large:.5g}, {low:.5g} to {high:.5g} Hz)"
        if self.share < 1.0:
            text += f" ({100.0 * self.share:.0f} % of the members have it)"
        return text + doubt


class LimitCycles(tuple[LimitCycle, ...]):
    """All predicted limit cycles by frequency, searched in a `band` in Hz.

    `linear_stable`: the loop is stable with permanent contact of the mesh, or without friction.
    """

    band: tuple[float, float]
    linear_stable: bool

    def __new__(
        cls, cycles: Iterable[LimitCycle], band: tuple[float, float], linear_stable: bool
    ) -> LimitCycles:
        """Create the tuple from cycles, band in Hz and stability without the nonlinearity."""
        out = super().__new__(cls, cycles)
        out.band, out.linear_stable = band, linear_stable
        return out

    def __getnewargs__(self) -> tuple[tuple[LimitCycle, ...], tuple[float, float], bool]:
        return tuple(self), self.band, self.linear_stable

    def summary(self) -> str:
        """Return the predictions as text."""
        where = f"from {self.band[0]:.4g} to {self.band[1]:.4g} Hz"
        loop = f"The loop without the nonlinearity is {_STABLE[bool(self.linear_stable)]}."
        if not self:
            return f"Harmonic balance predicts no limit cycle {where}. {loop}"
        lines = [f"Harmonic balance predicts {len(self)} limit cycle(s) {where}:"]
        lines += [f"  {cycle}" for cycle in self]
        return "\n".join([*lines, loop])


def limit_cycles(
    plant: Plant,
    controller: Controller | StateSpace | tuple[object, ...] | None,
    nonlinearity: Nonlinearity,
    at: str | tuple[str, str],
    *,
    torque: str | None = None,
    velocity: str | None = None,
    position: str | None = None,
    measured: str | Sequence[str] | None = None,
    band: Sequence[float] | None = None,
    pade: int = 6,
    members: Sequence[tuple[Plant, Nonlinearity]] = (),
) -> LimitCycles:
    """Predict the limit cycles of a loop with backlash or friction.

    Parameters
    ----------
    plant : Plant
        Continuous. For backlash the mesh is open in it (`opened`), its twist is an output
        (displacement) and the torque across it an input; for friction the velocity is an output and
        the torque at the same place an input.
    controller : Controller, StateSpace, tuple or None
        Controller of the loop: a cascade with negative feedback; or x' = A x + B y, torque = C x +
        D y, which includes the sign of the feedback, from the `measured` outputs; or None if the
        plant contains the closed loop.
    nonlinearity : Backlash or CoulombFriction
        The nonlinearity.
    at : str or (str, str)
        Output and input of the plant between which it acts; one name if both have the same.
    torque, velocity, position : str, optional
        Input driven by the controller, and outputs that a `Controller` uses as velocity and
        position (a displacement is differentiated, a velocity integrated). None: the only
        candidate.
    measured : str or sequence of str, optional
        Outputs that an (A, B, C, D) controller reads, in order.
    band : (float, float), optional
        Frequency range of the search in Hz. None: from a hundredth of the lowest to ten times the
        highest frequency of the loop.
    pade : int
        Order of the Pade approximation of the controller's dead time.
    members : sequence of (Plant, Backlash or CoulombFriction)
        Plants and nonlinearities at draws of the unknowns, such as those of `open_element`, from
        which the intervals of the cycles follow.

    Returns
    -------
    LimitCycles
        A tuple, empty without a prediction.

    Raises
    ------
    OptionError
        If a name is missing or unknown, or the band is invalid.
    ModelError
        If the plant is sampled, or its output does not respond to the input as the nonlinearity
        requires.

    Notes
    -----
    Stability by Loeb's criterion: with F = 1 + N S = U + i V, dU/dA dV/domega - dV/dA dU/domega > 0
    (Gelb & Vander Velde 1968, chapter 3). Describing functions assume an unbiased sinusoidal
    oscillation and neglect the breakaway torque.

    The intervals are those of Student's distribution for the logarithms of amplitude and frequency,
    with their root mean square deviation over the members. They contain the uncertainty of the
    unknowns, not the error of the method.

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
    >>> len(updyn.limit_cycles(made, loop, friction, "1:RZ", **at))  # friction alone makes none
    0
    """
    names = {"torque": torque, "velocity": velocity, "position": position, "measured": measured}
    found = _find_cycles(plant, controller, nonlinearity, at, names, band, pade)
    if not members:
        return found
    drawn = [
        _find_cycles(member, controller, law, at, names, band, pade) for member, law in members
    ]
    return LimitCycles(
        [_add_intervals(cycle, drawn) for cycle in found], found.band, found.linear_stable
    )


def _add_intervals(cycle: LimitCycle, members: Sequence[LimitCycles]) -> LimitCycle:
    """Return a cycle with the intervals of those of the members nearest to it."""
    own = np.log([cycle.amplitude, cycle.frequency])
    off = []
    for cycles in members:
        same = [one for one in cycles if one.stable == cycle.stable]
        if same:
            each = np.log([[one.amplitude, one.frequency] for one in same]) - own
            off.append(each[np.linalg.norm(each, axis=1).argmin()])
    if not off:
        return replace(cycle, share=0.0)
    width = interval_quantile(0.95, len(off)) * np.sqrt(np.mean(np.square(off), axis=0))
    low, high = np.exp(own - width).tolist(), np.exp(own + width).tolist()
    return replace(
        cycle,
        amplitude_interval=(low[0], high[0]),
        frequency_interval=(low[1], high[1]),
        share=len(off) / len(members),
    )


def _find_cycles(
    plant: Plant,
    controller: Controller | StateSpace | tuple[object, ...] | None,
    nonlinearity: Nonlinearity,
    at: str | tuple[str, str],
    names: Mapping[str, str | Sequence[str] | None],
    band: Sequence[float] | None,
    pade: int,
) -> LimitCycles:
    """Return the limit cycles of one plant."""
    system = linear_loop(plant, controller, nonlinearity, at, names, pade)
    whole = _closed_mesh_values(nonlinearity)
    poles = np.concatenate([np.linalg.eigvals(system.A), system.poles_with(*whole)])
    limits = _frequency_limits(band, poles)
    scan = _scan_frequencies(limits, poles)
    roots = _roots(system, nonlinearity, scan, poles)
    found = [_build_cycle(system, nonlinearity, omega) for omega in roots]
    return LimitCycles(
        found, (limits[0] / _TWO_PI, limits[1] / _TWO_PI), _stable(system.poles_with(*whole))
    )


def _closed_mesh_values(nonlinearity: Nonlinearity) -> tuple[float, float]:
    """Return stiffness and damping across the mesh without the nonlinearity."""
    if isinstance(nonlinearity, Backlash):
        return nonlinearity.stiffness, nonlinearity.damping
    return 0.0, 0.0


def _stable(poles: ComplexArray) -> bool:
    """Return whether no pole lies in the right half plane; poles at 0 are allowed."""
    return bool((poles.real <= 1e-7 * max(float(np.abs(poles).max(initial=0.0)), 1e-300)).all())


# -- the scan -------------------------------------------------------------------------------------
def _frequency_limits(band: Any, poles: ComplexArray) -> tuple[float, float]:
    if band is not None:
        try:
            low, high = (float(f) for f in band)
        except (TypeError, ValueError) as error:
            raise OptionError(f"limit cycles: band {band!r}; expected two lines in Hz") from error
        if not (is_number(low) and 0 < low < high < np.inf):
            raise OptionError(f"limit cycles: band {low:g} to {high:g} Hz; expected 0 < low < high")
        return _TWO_PI * low, _TWO_PI * high
    size = np.abs(poles)
    size = size[size > 1e-6 * size.max(initial=0.0)]
    if not len(size):
        raise OptionError("limit cycles: the loop has no nonzero frequency; give band=")
    return 0.01 * float(size.min()), 10.0 * float(size.max())


def _scan_frequencies(limits: tuple[float, float], poles: ComplexArray) -> RealArray:
    """Return frequencies in rad/s, dense around lightly damped poles."""
    parts = [np.geomspace(*limits, HARMONIC_BALANCE.scan_lines)]
    offsets = np.concatenate([-np.geomspace(30, 0.1, 15), [0.0], np.geomspace(0.1, 30, 15)])
    for pole in poles[poles.imag > 0]:
        parts.append(pole.imag + offsets * max(abs(pole.real), 1e-6 * pole.imag))
    out = np.unique(np.concatenate(parts))
    return np.asarray(out[(out >= limits[0]) & (out <= limits[1])])


def _mismatch(
    system: LinearLoop, nonlinearity: Nonlinearity, omega: RealArray
) -> tuple[RealArray, RealArray]:
    """Return the phase difference of -1 / S and N at equal moduli, and the amplitude; else nan."""
    S = system.at(omega)
    needed = -1.0 / np.where(S == 0.0, np.finfo(np.float64).tiny, S)
    A = nonlinearity.amplitude(np.abs(needed), omega)
    is_defined = np.isfinite(A)
    phase = np.full(len(omega), np.nan)
    phase[is_defined] = np.angle(
        needed[is_defined] / nonlinearity.describing(A[is_defined], omega[is_defined])
    )
    return phase, A


def _roots(
    system: LinearLoop, nonlinearity: Nonlinearity, omega: RealArray, poles: ComplexArray
) -> list[float]:
    """Return all frequencies in rad/s at which the phases agree."""

    def at(w: float) -> float:
        value = float(_mismatch(system, nonlinearity, np.array([w]))[0][0])
        return value if np.isfinite(value) else np.pi

    phase, _ = _mismatch(system, nonlinearity, omega)
    roots = [float(w) for w, p in zip(omega, phase, strict=True) if p == 0.0]
    for i in range(len(omega) - 1):
        a, b = phase[i], phase[i + 1]
        if np.isfinite(a) and np.isfinite(b) and a * b < 0 and abs(a - b) < np.pi:
            roots.append(
                float(brentq(at, omega[i], omega[i + 1], xtol=1e-14 * omega[i], rtol=1e-13))
            )
    for i in range(1, len(omega) - 1):
        a, b, c = phase[i - 1 : i + 2]
        if (
            np.isfinite([a, b, c]).all()
            and a * b > 0
            and b * c > 0
            and abs(b) < min(abs(a), abs(c))
        ):
            roots += _tangent_roots(at, omega[i - 1], omega[i + 1], float(np.sign(b)))
    return sorted(set(roots))


def _tangent_roots(
    at: Callable[[float], float], low: float, high: float, side: float
) -> list[float]:
    """Return two roots between points of equal sign if the phase reaches 0 between them."""
    best = minimize_scalar(
        lambda w: side * at(w), bounds=(low, high), method="bounded", options={"xatol": 1e-12 * low}
    )
    if side * at(float(best.x)) >= 0:
        return []
    return [float(brentq(at, low, best.x, rtol=1e-13)), float(brentq(at, best.x, high, rtol=1e-13))]


# -- one cycle ------------------------------------------------------------------------------------
def _build_cycle(system: LinearLoop, nonlinearity: Nonlinearity, omega: float) -> LimitCycle:
    w = np.array([omega])
    S, S3 = system.at(np.array([omega, 3.0 * omega]))
    A = float(nonlinearity.amplitude(np.abs(-1.0 / S)[None], w)[0])
    N = complex(nonlinearity.describing(A, omega))
    third = float(abs(S3)) * nonlinearity.third(A, omega) / A
    loeb = _loeb(system, nonlinearity, A, omega)
    damping = N.imag / omega
    if abs(N.imag) <= 1e-12 * abs(N):
        damping = 0.0
    rest = system.poles_with(N.real, damping)
    # The pair of the cycle lies on the imaginary axis; the other poles decide whether anything else
    # grows.
    for target in (1j * omega, -1j * omega):
        rest = np.delete(rest, np.argmin(np.abs(rest - target)))
    return LimitCycle(
        A,
        omega / _TWO_PI,
        loeb and _stable(rest),
        loeb,
        N,
        third,
        system.unit,
        find_doubt(nonlinearity, A, third),
    )


def _loeb(system: LinearLoop, nonlinearity: Nonlinearity, A: float, omega: float) -> bool:
    def balance(a: float, w: float) -> complex:
        return complex(1.0 + nonlinearity.describing(a, w) * system.at(np.array([w]))[0])

    step = 1e-5
    by_A = (balance(A * (1 + step), omega) - balance(A * (1 - step), omega)) / (2 * step * A)
    by_w = (balance(A, omega * (1 + step)) - balance(A, omega * (1 - step))) / (2 * step * omega)
    return bool(by_A.real * by_w.imag - by_A.imag * by_w.real > 0)
