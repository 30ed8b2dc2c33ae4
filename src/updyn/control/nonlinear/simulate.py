"""`simulate`: a loop with backlash or friction, piecewise linear and exact in each piece.

The state is (x, extra, 1): x of the loop, the twist of the shaft where backlash has damping, and a
1 that carries constant inputs. Each piece is dX/dt = F X as long as all its borders, rows times X,
are not negative.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from updyn.control.nonlinear.around import Around, around
from updyn.control.nonlinear.balance import LimitCycle
from updyn.control.nonlinear.elements import Backlash, CoulombFriction, Nonlinearity
from updyn.control.plant import Plant
from updyn.control.servo.controller import Controller
from updyn.control.servo.state_space import StateSpace
from updyn.errors import OptionError, SolverError, suggest
from updyn.group import is_number

__all__ = [
    "BacklashRules",
    "FrictionRules",
    "Piece",
    "Rules",
    "Settled",
    "Simulation",
    "Trajectory",
    "integrate",
    "rules",
    "settled",
    "simulate",
]

_Real = NDArray[np.float64]
#: The sign of a contact or a motion in the name of its piece.
_SIGN = {1.0: "+", -1.0: "-"}
_HALVINGS = 44
_BLOCK = 64
_AT_ONCE = 200  # switches within one step: chatter
_STEADY = 0.01  # spread of the last periods
_SMALL = 0.2  # share of the largest amplitude below which an oscillation has decayed
_PERIODS = 5
_LAST = 0.4  # share of the time that is looked at
_POINTS = 40  # steps in a period of the fastest oscillation
_LEAST = 400  # steps at least
_MOST = 2_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """One linear piece.

    Attributes
    ----------
    name : str
        ``"gap"``, ``"contact +"``, ``"contact -"``; ``"stick"``, ``"slip +"``, ``"slip -"``.
    F : ndarray of float, shape (m, m)
    borders : ndarray of float, shape (n_b, m)
    w : ndarray of float, shape (m,)
        Torque on the plant.
    z : ndarray of float, shape (m,)
        What the nonlinearity reads.
    """

    name: str
    F: _Real
    borders: _Real
    w: _Real
    z: _Real


class Rules(ABC):
    """The pieces of a loop, which comes first, and which comes next.

    Parameters
    ----------
    system : Around
        The loop.
    constant : ndarray of float, shape (n_e,)
        Its entries, held.
    extra : int
        States besides those of the loop.
    """

    pieces: Mapping[str, Piece]

    def __init__(self, system: Around, constant: _Real, extra: int) -> None:
        n = len(system.A)
        self.n, self.size = n, n + extra + 1
        self.base = np.zeros((self.size, self.size))
        self.base[:n, :n] = system.A
        self.base[:n, -1] = system.E @ constant
        self.push = np.zeros(self.size)
        self.push[:n] = system.B
        self.read = np.zeros(self.size)
        self.read[:n] = system.C
        self.read[-1] = float(system.G @ constant)
        self.one = np.zeros(self.size)
        self.one[-1] = 1.0

    def state(self, x: _Real) -> _Real:
        """Return (x, 0, 1)."""
        return np.concatenate([x, np.zeros(self.size - self.n - 1), [1.0]])

    @abstractmethod
    def first(self, X: _Real) -> str:
        """Return the piece in which a state lies."""

    @abstractmethod
    def after(self, piece: str, border: int, X: _Real) -> tuple[str, _Real]:
        """Return what follows when a border is crossed, and the state there."""


class BacklashRules(Rules):
    """Backlash: gap and two flanks."""

    def __init__(self, system: Around, law: Backlash, constant: _Real) -> None:
        damped = law.damping > 0.0
        super().__init__(system, constant, int(damped))
        self.law, self.damped = law, damped
        D, speed = system.D, float(system.C @ system.B)
        pieces = (self._gap(), self._contact(1.0, D, speed), self._contact(-1.0, D, speed))
        self.pieces = {piece.name: piece for piece in pieces}

    def _gap(self) -> Piece:
        F, way = self.base.copy(), self.read.copy()
        if self.damped:
            F[self.n, self.n] = -self.law.stiffness / self.law.damping
            way[self.n] -= 1.0  # the flanks' way is the twist less that of the shaft
        borders = np.array([self.law.half * self.one - way, self.law.half * self.one + way])
        return Piece("gap", F, borders, np.zeros(self.size), self.read)

    def _contact(self, s: float, D: float, push: float) -> Piece:
        k, c = self.law.stiffness, self.law.damping
        shaft = self.read - s * self.law.half * self.one
        if c == 0.0:
            T = k * shaft / (1.0 + k * D)
        elif D == 0.0:
            T = (k * shaft + c * (self.read @ self.base)) / (1.0 + c * push)
        else:
            # z = read - D T = z_s + s half, T = k z_s + c z_s': the twist of the shaft is a state
            # of its own.
            T = shaft / D
            T[self.n] -= 1.0 / D
        F = self.base - np.outer(self.push, T)
        if c > 0.0 and D != 0.0:
            F[self.n] = T / c
            F[self.n, self.n] -= k / c
        return Piece(f"contact {_SIGN[s]}", F, s * T[None], -T, self.read - D * T)

    def first(self, X: _Real) -> str:
        """Return the gap, or the flank that is pressed."""
        way = float(self.read @ X)
        if abs(way) <= self.law.half:
            return "gap"
        return "contact +" if way > 0 else "contact -"

    def after(self, piece: str, border: int, X: _Real) -> tuple[str, _Real]:
        """Return the flank that is met, or the gap with the shaft's last twist."""
        if piece == "gap":
            return ("contact +", "contact -")[border], X
        if self.damped:
            s = 1.0 if piece == "contact +" else -1.0
            X = X.copy()
            X[self.n] = float(self.pieces[piece].z @ X) - s * self.law.half
        return "gap", X


class FrictionRules(Rules):
    """Friction: rest and two senses of motion."""

    def __init__(self, system: Around, law: CoulombFriction, constant: _Real) -> None:
        super().__init__(system, constant, 0)
        self.law = law
        self.gain = float(self.read @ self.push)
        hold = -(self.read @ self.base) / self.gain  # the torque that keeps the velocity at 0
        self.hold = hold
        limits = np.array([law.sticks * self.one - hold, law.sticks * self.one + hold])
        stick = Piece("stick", self.base + np.outer(self.push, hold), limits, hold, self.read)
        pieces = (stick, self._slip(1.0, law.level), self._slip(-1.0, law.level))
        self.pieces = {piece.name: piece for piece in pieces}

    def _slip(self, s: float, level: float) -> Piece:
        w = -s * level * self.one
        return Piece(
            f"slip {_SIGN[s]}",
            self.base + np.outer(self.push, w),
            s * self.read[None],
            w,
            self.read,
        )

    def first(self, X: _Real) -> str:
        """Return the sense of motion, or what comes of rest."""
        v = float(self.read @ X)
        if v == 0:
            return self._at_rest(X)
        return "slip +" if v > 0 else "slip -"

    def _at_rest(self, X: _Real) -> str:
        held = float(self.hold @ X)
        if abs(held) <= self.law.sticks:
            return "stick"
        return "slip -" if held > 0 else "slip +"

    def after(self, piece: str, border: int, X: _Real) -> tuple[str, _Real]:
        """Return the sense in which it breaks away, or what comes of rest."""
        if piece == "stick":
            return ("slip -", "slip +")[border], X
        # What bisection left of the velocity is taken out, along the torque.
        X = X - self.push * float(self.read @ X) / self.gain
        return self._at_rest(X), X


def rules(system: Around, nonlinearity: Nonlinearity, constant: _Real) -> Rules:
    """Return the pieces of a loop.

    Parameters
    ----------
    system : Around
        The loop.
    nonlinearity : Backlash or CoulombFriction
        What acts.
    constant : ndarray of float, shape (n_e,)
        Its entries, held.
    """
    if isinstance(nonlinearity, Backlash):
        return BacklashRules(system, nonlinearity, constant)
    return FrictionRules(system, nonlinearity, constant)


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A way through pieces.

    Attributes
    ----------
    time : ndarray of float, shape (n_t,)
        In s: every step, and every switch.
    states : ndarray of float, shape (n_t, m)
    piece : ndarray of int, shape (n_t,)
        Position in `names` of the piece that holds from that time on.
    names : tuple of str
    switches : ndarray of float, shape (n_s,)
        Times in s.
    """

    time: _Real
    states: _Real
    piece: NDArray[np.intp]
    names: tuple[str, ...]
    switches: _Real


class _Exact:
    """The exponentials of one piece."""

    def __init__(self, piece: Piece, step: float) -> None:
        self.piece = piece
        once = scipy.linalg.expm(piece.F * step)
        powers = [once]
        for _ in range(_BLOCK - 1):
            powers.append(powers[-1] @ once)
        self.powers = np.array(powers)
        self.halves = np.array(
            [scipy.linalg.expm(piece.F * step * 0.5**i) for i in range(1, _HALVINGS + 1)]
        )

    def crossing(self, X: _Real) -> tuple[float, _Real, int]:
        """Return share of the step before the first border, state just after it, and border."""
        share = 0.0
        for i, half in enumerate(self.halves, 1):
            tried = half @ X
            if (self.piece.borders @ tried >= 0.0).all():
                X, share = tried, share + 0.5**i
        after = self.halves[-1] @ X
        return share + 0.5**_HALVINGS, after, int(np.argmin(self.piece.borders @ after))


def integrate(rules: Rules, start: _Real, duration: float, step: float) -> Trajectory:
    """Follow a loop through its pieces.

    Parameters
    ----------
    rules : Rules
        Pieces and what follows what.
    start : ndarray of float, shape (m,)
        State at time 0.
    duration, step : float
        In s; the last whole step ends it.

    Returns
    -------
    Trajectory

    Raises
    ------
    SolverError
        If pieces change without end within one step, or the state grows beyond all numbers.
    """
    exact = {name: _Exact(piece, step) for name, piece in rules.pieces.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        return _followed(rules, exact, start, duration, step)


def _followed(
    rules: Rules, exact: Mapping[str, _Exact], start: _Real, duration: float, step: float
) -> Trajectory:
    names = tuple(rules.pieces)
    now, X, t = rules.first(start), start, 0.0
    times, states, pieces = [np.array([0.0])], [X[None]], [np.array([names.index(now)])]
    switches: list[float] = []
    while (left := min(int((duration - t) / step + 1e-9), _BLOCK)) > 0:
        at = exact[now]
        ahead = at.powers[:left] @ X
        crossed = (ahead @ at.piece.borders.T < 0.0).any(axis=1)
        n = int(np.argmax(crossed)) if crossed.any() else left
        if n:
            times.append(t + step * np.arange(1, n + 1))
            states.append(ahead[:n])
            pieces.append(np.full(n, names.index(now)))
            t, X = t + n * step, ahead[n - 1]
        if n < left:
            share, X, border = at.crossing(X)
            t += share * step
            now, X = rules.after(now, border, X)
            switches.append(t)
            times.append(np.array([t]))
            states.append(X[None])
            pieces.append(np.array([names.index(now)]))
            if len(switches) > _AT_ONCE and t - switches[-_AT_ONCE] < step:
                raise SolverError(
                    f"simulation: {_AT_ONCE} changes between {names[0]!r} and others within"
                    f" {step:.3g} s at {t:.6g} s: the loop chatters there"
                )
        if not np.isfinite(X).all():
            raise SolverError(
                f"simulation: the loop grows beyond all numbers at {t:.6g} s: it is unstable"
            )
    return Trajectory(
        np.concatenate(times),
        np.concatenate(states),
        np.concatenate(pieces).astype(np.intp),
        names,
        np.array(switches),
    )


@dataclass(frozen=True, slots=True)
class Settled:
    """The end of an oscillation.

    Attributes
    ----------
    verdict : str
        As of a `Simulation`.
    amplitude, peak, frequency : float or None
        First harmonic, half of peak to peak, and Hz.
    periods : int
        Over which they were taken.
    """

    verdict: str
    amplitude: float | None = None
    peak: float | None = None
    frequency: float | None = None
    periods: int = 0


def settled(time: _Real, z: _Real, switches: _Real, half: float) -> Settled:
    """Judge the end of a series.

    Parameters
    ----------
    time : ndarray of float, shape (n_t,)
        In s, not falling.
    z : ndarray of float, shape (n_t,)
        What the nonlinearity reads.
    switches : ndarray of float
        Times at which contact or sticking changed.
    half : float
        Half the gap of a backlash; 0 for friction.
    """
    end = float(time[-1])
    first = int(np.searchsorted(time, (1.0 - _LAST) * end))
    t, y = time[first:], z[first:]
    span, whole = float(np.ptp(y)), float(np.ptp(z))
    if span <= 1e-9 * max(float(np.abs(z).max()), half):
        return Settled("at rest")
    if not len(switches) or switches[-1] < t[0]:
        # Nothing touches any more: a swing within the gap, or a drift.
        if np.ptp(y[len(y) // 2 :]) > 1.02 * np.ptp(y[: len(y) // 2]):
            return _trend(t, y, whole)
        return Settled("decays")
    starts = _rises(t, y - 0.5 * (y.max() + y.min()))
    if len(starts) < 3:
        return _trend(t, y, whole)
    lengths = np.diff(starts)
    tops = np.array([np.ptp(y[(t >= a) & (t <= b)]) / 2 for a, b in pairwise(starts)])
    n = min(len(lengths), 4 * _PERIODS)
    lengths, tops = lengths[-n:], tops[-n:]
    if (
        n >= _PERIODS
        and np.ptp(tops) <= _STEADY * tops[-1]
        and np.ptp(lengths) <= _STEADY * lengths[-1]
    ):
        a, b = float(starts[-n - 1]), float(starts[-1])
        frequency = n / (b - a)
        return Settled(
            "limit cycle", _harmonic(t, y, a, b, frequency), float(tops.mean()), frequency, n
        )
    return _trend(t, y, whole)


def _trend(t: _Real, y: _Real, whole: float) -> Settled:
    """Judge by the sizes of quarters of the stretch, beside that of the whole series."""
    edges = np.linspace(t[0], t[-1], 5)
    sizes = np.array([np.ptp(y[(t >= a) & (t <= b)]) for a, b in pairwise(edges)])
    steps = np.diff(sizes)
    small = sizes.max() < _SMALL * whole and sizes[2:].max() <= sizes[:2].max()
    if small or ((steps < 0).all() and sizes[-1] < (1 - _STEADY) * sizes[0]):
        return Settled("decays")
    if (steps > 0).all() and sizes[-1] > (1 + _STEADY) * sizes[0]:
        return Settled("grows")
    return Settled("not settled")


def _rises(t: _Real, y: _Real) -> _Real:
    """Return the upward zero crossings of a series that reach a tenth of its size."""
    size = 0.1 * float(np.abs(y).max())
    out, armed = [], False
    for i in range(1, len(y)):
        if y[i] < -size:
            armed = True
        if armed and y[i - 1] < 0 <= y[i]:
            crossing = t[i - 1] - y[i - 1] * (t[i] - t[i - 1]) / (y[i] - y[i - 1])
        if armed and y[i] > size:
            out.append(float(crossing))
            armed = False
    return np.array(out)


def _harmonic(t: _Real, y: _Real, a: float, b: float, frequency: float) -> float:
    """Return the amplitude of the first harmonic over whole periods, by the trapezoidal rule."""
    inside = (t > a) & (t < b)
    times = np.concatenate([[a], t[inside], [b]])
    values = np.interp(times, t, y)
    wave = np.exp(-2j * np.pi * frequency * times)
    return float(abs(2.0 / (b - a) * np.trapezoid(values * wave, times)))


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A loop with its nonlinearity in time.

    Attributes
    ----------
    time : ndarray of float, shape (n_t,)
        In s: every step, and every instant at which contact or sticking changes.
    reading : ndarray of float, shape (n_t,)
        What the nonlinearity reads: twist in rad, or velocity in rad/s.
    torque : ndarray of float, shape (n_t,)
        What it puts against it, in N m.
    series : ndarray of float, shape (n_t, n_s)
        Outputs of the plant, then the torque of the controller; names in `names`.
    names : tuple of str
        Of the columns.
    phase : ndarray of str, shape (n_t,)
        ``"gap"``, ``"contact +"``, ``"contact -"``; or ``"stick"``, ``"slip +"``, ``"slip -"``.
    switches : ndarray of float
        Times in s at which it changes.
    verdict : {"limit cycle", "decays", "at rest", "grows", "not settled"}
        What the end of it is.
    amplitude : float or None
        First harmonic of `reading` over the last whole periods, of a limit cycle: what harmonic
        balance predicts.
    peak : float or None
        Half of peak to peak over the same.
    frequency : float or None
        Of a limit cycle, in Hz.
    periods : int
        Over which both were taken.
    unit : str
        Of `reading`.
    facts : dict
        Step, number of switches, what was held.
    """

    time: _Real
    reading: _Real
    torque: _Real
    series: _Real
    names: tuple[str, ...]
    phase: NDArray[np.str_]
    switches: _Real
    verdict: str
    amplitude: float | None
    peak: float | None
    frequency: float | None
    periods: int
    unit: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> _Real:
        """Return a series by its name, shape (n_t,)."""
        if name not in self.names:
            raise OptionError(
                f"the simulation has no series {name!r}; {suggest(str(name), self.names)}"
            )
        return self.series[:, self.names.index(name)]

    def summary(self) -> str:
        """Return what came of it as text.

        Returns
        -------
        str
        """
        head = f"{self.time[-1]:.5g} s, {len(self.switches)} changes of contact or sticking: "
        if self.verdict == "limit cycle":
            return (
                f"{head}limit cycle, amplitude {self.amplitude:.5g} {self.unit} (first harmonic;"
                f" half of peak to peak {self.peak:.5g}), {self.frequency:.5g} Hz"
            )
        return (
            head
            + {
                "decays": "the oscillation decays; there is no limit cycle here.",
                "at rest": "it comes to rest; there is no limit cycle here.",
                "grows": "the oscillation still grows at the end.",
                "not settled": "it has not settled by the end; simulate longer.",
            }[self.verdict]
        )


def simulate(
    plant: Plant,
    controller: Controller | StateSpace | tuple[Any, ...] | None,
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

    The loop is linear in pieces (gap and two flanks; rest and two senses of motion): each is
    stepped through by its matrix exponential, and the instants at which one gives way to the next
    are found to rounding.

    Parameters
    ----------
    plant, controller, nonlinearity
        As for `limit_cycles`.
    duration : float
        In s; the last whole step ends it.
    at : str or (str, str)
        As for `limit_cycles`.
    start : LimitCycle or array_like of float, shape (n,), optional
        Where it begins: on a predicted limit cycle; or with the states of the plant, or of plant
        and controller. None: at rest in the middle.
    scale : float
        Factor on the start: 1.2 times a limit cycle begins outside of it.
    constant : mapping of str to float, optional
        Inputs of the plant that are held, in their units (gravity, wind), and ``"reference"``, to
        which the controller moves from time 0.
    torque, velocity, position, measured
        As for `limit_cycles`.
    step : float, optional
        In s. None: a fortieth of the shortest period of the loop's pieces. Only what begins and
        ends within one step is missed by a longer one.
    pade : int
        As for `limit_cycles`.

    Returns
    -------
    Simulation

    Raises
    ------
    OptionError
        As `limit_cycles`; or if duration, step, start or an entry cannot be used.
    ModelError
        As `limit_cycles`.
    SolverError
        If the loop chatters, or grows beyond all numbers.

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
    system = around(plant, controller, nonlinearity, at, names, pade)
    held = _held(system, constant)
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
    end = settled(way.time, z, way.switches, half)
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


def _held(system: Around, constant: Mapping[str, float] | None) -> _Real:
    out = np.zeros(len(system.entries))
    for name, value in (constant or {}).items():
        if name not in system.entries:
            raise OptionError(
                f"simulation: no input {name!r} to hold; {suggest(str(name), system.entries)}"
            )
        if not is_number(value) or not math.isfinite(value):
            raise OptionError(f"simulation: {name} held at {value!r}; expected a finite number")
        out[system.entries.index(name)] = value
    return out


def _length(
    system: Around, nonlinearity: Nonlinearity, pieces: Rules, duration: Any, step: Any
) -> float:
    for what, value in (("duration", duration), ("step", 1.0 if step is None else step)):
        if not is_number(value) or not 0 < value < np.inf:
            raise OptionError(f"simulation: {what} {value!r}; expected a number above 0, in s")
    if step is None:
        rates = [np.linalg.eigvals(p.F) for p in pieces.pieces.values()]
        if isinstance(
            nonlinearity, Backlash
        ):  # a flank bounces as fast without its damping, or faster
            rates.append(system.under(nonlinearity.stiffness, 0.0))
        fastest = max(float(np.abs(r.imag).max(initial=0.0)) for r in rates)
        step = duration / _LEAST
        if fastest > 0:
            step = min(step, 2.0 * np.pi / fastest / _POINTS)
    if duration / step > _MOST:
        raise OptionError(
            f"simulation: {duration:g} s take {duration / step:.3g} steps of {step:.3g} s; at most"
            f" {_MOST:g} are taken: say a shorter duration, or a longer step="
        )
    return float(step)


def _start(
    system: Around,
    plant: Plant,
    pieces: Rules,
    nonlinearity: Nonlinearity,
    start: Any,
    scale: float,
) -> _Real:
    if not is_number(scale) or not math.isfinite(scale):
        raise OptionError(f"simulation: scale {scale!r}; expected a finite number")
    n = len(system.A)
    x: _Real = np.zeros(n)
    if isinstance(start, LimitCycle):
        omega = 2.0 * np.pi * start.frequency
        w = -start.gain * start.amplitude  # of z = A exp(i psi)
        shape = np.linalg.solve(1j * omega * np.eye(n) - system.A, system.B * w)
        # Backlash begins in the gap, z = 0 and rising; friction at the largest velocity.
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
