"""`Controller`: a P position loop over a PI velocity loop, with filters and dead time.

Negative feedback throughout; a positive torque turns the motor the positive way:

    v_ref  = ratio (kv (x_ref - x) + feed_forward x_ref')
    torque = exp(-s dead_time) F(s) kp (1 + 1 / (s ti)) (v_ref - v)

F(s) is the product of the notches and the low-pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.control.family import PlantFamily
from updyn.control.plant import Plant
from updyn.control.servo.settings import RIGID_MOTION
from updyn.control.servo.state_space import StateSpace, Transfer, delay_approximation, root_pair
from updyn.errors import ModelError, OptionError
from updyn.group import is_number

__all__ = [
    "Controller",
    "Notch",
    "require_continuous",
    "rigid_inertia",
    "rigid_ratio",
    "to_velocity",
]

_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class Notch:
    """A second-order notch filter with gain 1 far from its frequency.

        N(s) = (s^2 + 2 zero_damping w s + w^2) / (s^2 + 2 pole_damping w s + w^2)

    with w = 2 pi frequency.

    Parameters
    ----------
    frequency : float
        In Hz.
    zero_damping : float
        Damping ratio of the zeros, 0 or above; the gain at `frequency` is zero_damping /
        pole_damping.
    pole_damping : float
        Damping ratio of the poles, above 0; it sets the width.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Examples
    --------
    >>> notch = updyn.Notch(80.0, zero_damping=0.05, pole_damping=0.5)
    >>> notch.depth, notch.width  # gain at 80 Hz, width in Hz
    (0.1, 80.0)
    """

    frequency: float
    zero_damping: float = 0.05
    pole_damping: float = 0.5

    def __post_init__(self) -> None:
        _positive("notch: frequency", self.frequency, "Hz")
        _positive(
            f"notch at {self.frequency:g} Hz: pole_damping", self.pole_damping, "a damping ratio"
        )
        if (
            not is_number(self.zero_damping)
            or not math.isfinite(self.zero_damping)
            or self.zero_damping < 0
        ):
            raise OptionError(
                f"notch at {self.frequency:g} Hz: zero_damping is {self.zero_damping!r}; expected 0"
                " or above",
                key=("zero_damping",),
            )

    @classmethod
    def of_width(cls, frequency: float, width: float, depth: float = 0.0) -> Notch:
        """Return a notch from its width and depth, as drives specify it.

        Parameters
        ----------
        frequency : float
            In Hz.
        width : float
            In Hz, between the points where a notch of depth 0 has gain 1 / sqrt(2): 2 pole_damping
            frequency.
        depth : float
            Gain at `frequency`; 0 blocks it completely.

        Returns
        -------
        Notch

        Raises
        ------
        OptionError
            If a number is out of its range.
        """
        _positive("notch: frequency", frequency, "Hz")
        _positive("notch: width", width, "Hz")
        if not is_number(depth) or not math.isfinite(depth) or depth < 0:
            raise OptionError(
                f"notch at {frequency:g} Hz: depth is {depth!r}; expected a gain, 0 or above",
                key=("depth",),
            )
        pole = 0.5 * width / frequency
        return cls(frequency, depth * pole, pole)

    @property
    def width(self) -> float:
        """In Hz: 2 pole_damping frequency."""
        return 2.0 * self.pole_damping * self.frequency

    @property
    def depth(self) -> float:
        """Gain at `frequency`."""
        return self.zero_damping / self.pole_damping

    def at(self, s: ArrayLike) -> ComplexArray:
        """Return N(s).

        Parameters
        ----------
        s : array_like of complex
            In rad/s.

        Returns
        -------
        ndarray of complex
            Of the shape of `s`.
        """
        s = np.asarray(s, dtype=np.complex128)
        w = _TWO_PI * self.frequency
        both = s**2 + w**2
        return np.asarray(
            (both + 2.0 * self.zero_damping * w * s) / (both + 2.0 * self.pole_damping * w * s)
        )

    def state_space(self) -> StateSpace:
        """Return N as a state-space system of two states."""
        w = _TWO_PI * self.frequency
        return StateSpace(
            np.array([[0.0, w], [-w, -2.0 * self.pole_damping * w]]),
            np.array([[0.0], [1.0]]),
            np.array([[0.0, 2.0 * (self.zero_damping - self.pole_damping) * w]]),
            np.ones((1, 1)),
        )

    @property
    def zeros(self) -> ComplexArray:
        """Both zeros in rad/s."""
        return _pole_pair(self.frequency, self.zero_damping)


@dataclass(frozen=True, slots=True)
class Controller:
    """P-PI cascade controller of a drive.

    Parameters
    ----------
    kp : float
        Gain of the velocity loop, above 0, in N m per rad/s (N per m/s).
    ti : float or None
        Integral time of the velocity loop in s. None: P control only.
    kv : float or None
        Gain of the position loop in 1/s. None: no position loop.
    notches : tuple of Notch
        Notch filters in the torque command.
    low_pass : float or None
        Corner of a low-pass in the torque command in Hz.
    low_pass_damping : float or None
        Damping ratio of a second-order low-pass. None: first order.
    feed_forward : float
        Share of the reference's velocity that is added to the velocity command, 0 to 1.
    dead_time : float
        Delay of the torque in s: computation, sampling (half an interval for the hold), current
        loop.
    ratio : float
        Gear ratio with sign, other than 0: rigid-body velocity of the output of the velocity loop
        over that of the output of the position loop. It converts the command of the position loop.

    Raises
    ------
    OptionError
        If a number is out of its range.

    Examples
    --------
    >>> cascade = updyn.Controller(kp=40.0, ti=0.05, kv=10.0, notches=(updyn.Notch(80.0),))
    >>> cascade.kv, len(cascade.notches), cascade.dead_time
    (10.0, 1, 0.0)
    """

    kp: float
    ti: float | None = None
    kv: float | None = None
    notches: tuple[Notch, ...] = ()
    low_pass: float | None = None
    low_pass_damping: float | None = None
    feed_forward: float = 0.0
    dead_time: float = 0.0
    ratio: float = 1.0

    def __post_init__(self) -> None:
        _positive(
            "controller: kp",
            self.kp,
            "N m per rad/s",
            "turn the port round where torque and velocity oppose",
        )
        for name, unit in (
            ("ti", "s"),
            ("kv", "1/s"),
            ("low_pass", "Hz"),
            ("low_pass_damping", "a damping ratio"),
        ):
            if getattr(self, name) is not None:
                _positive(f"controller: {name}", getattr(self, name), unit, "None for none")
        if self.low_pass_damping is not None and self.low_pass is None:
            raise OptionError(
                "controller: low_pass_damping without low_pass; give its corner in Hz",
                key=("low_pass_damping",),
            )
        for name, top in (("feed_forward", 1.0), ("dead_time", np.inf)):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= value <= top or not math.isfinite(value):
                expected = {
                    "feed_forward": "a share from 0 to 1",
                    "dead_time": "0 or above, in s",
                }
                text = f"controller: {name} is {value!r}; expected {expected[name]}"
                raise OptionError(text, key=(name,))
        if self.feed_forward and self.kv is None:
            raise OptionError(
                "controller: feed_forward without kv; it belongs to the position loop",
                key=("feed_forward",),
            )
        if not is_number(self.ratio) or not math.isfinite(self.ratio) or self.ratio == 0.0:
            raise OptionError(
                f"controller: ratio is {self.ratio!r}; expected a number other than 0, the velocity"
                " of the velocity loop's output over that of the position loop's",
                key=("ratio",),
            )
        if self.ratio != 1.0 and self.kv is None:
            raise OptionError(
                "controller: ratio without kv; it belongs to the position loop", key=("ratio",)
            )
        notches = (self.notches,) if isinstance(self.notches, Notch) else self.notches
        wrong = OptionError(
            f"controller: notches are {self.notches!r}; expected Notch(frequency, ...) of each",
            key=("notches",),
        )
        if not isinstance(notches, Iterable):
            raise wrong
        object.__setattr__(self, "notches", tuple(notches))
        if not all(isinstance(n, Notch) for n in self.notches):
            raise wrong

    @classmethod
    def tuned(
        cls,
        plant: Plant | PlantFamily,
        crossover: float,
        *,
        torque: str,
        velocity: str,
        position: str | None = None,
        ti_ratio: float | None = 2.0,
        kv_ratio: float | None = 4.0,
        **others: Any,
    ) -> Controller:
        """Return a controller sized by rule from the rigid-body motion of a plant.

            w = 2 pi crossover,   kp = J w,   ti = ti_ratio / w,   kv = w / kv_ratio

        with the rigid-body inertia J; `ratio` is that of the rigid-body motion.

        Parameters
        ----------
        plant : Plant or PlantFamily
            With rigid-body motion from `torque` to `velocity`; of a family the nominal plant.
        crossover : float
            Frequency in Hz at which the gain of the velocity loop falls through 1, for the rigid
            body and kp alone.
        torque, velocity : str
            Names of the plant's input and output.
        position : str, optional
            Name of the output that the position loop reads; by default `velocity`.
        ti_ratio : float or None
            Ratio a of the symmetrical optimum: the phase margin of the rigid body is arctan(a)
            without small time constants, and arctan(a) - arctan(1 / a) with those for which it is
            optimal, whose sum is 1 / (a w). None: no integral part.
        kv_ratio : float or None
            4: critical damping of s^2 + w s + w kv, the rigid body without the integral part. None:
            no position loop.
        **others
            Further settings: `notches`, `low_pass`, `dead_time`, ...; `ti` and `kv` replace the
            values of the rule. With `kv`, `ratio` defaults to 1.

        Returns
        -------
        Controller

        Raises
        ------
        ModelError
            If the plant has no free rotation between the ports, or torque and velocity oppose.
        OptionError
            If a name or a number is invalid.

        Notes
        -----
        Symmetrical optimum: Kessler (1958), "Das symmetrische Optimum", Regelungstechnik 6, 395-400
        and 432-436.
        """
        _positive("crossover", crossover, "Hz")
        for name, ratio in (("ti_ratio", ti_ratio), ("kv_ratio", kv_ratio)):
            if ratio is not None:
                _positive(name, ratio)
        nominal = plant if isinstance(plant, Plant) else plant.nominal
        inertia = rigid_inertia(nominal, torque, velocity)
        if inertia is None:
            raise ModelError(
                f"the plant has no rigid-body motion from {torque!r} to {velocity!r}, so the rule"
                " has no inertia to size the gain; give kp, ti and kv by hand"
            )
        if inertia < 0:
            raise ModelError(
                f"a positive torque at {torque!r} turns {velocity!r} the negative way (inertia"
                f" {inertia:.4g}); turn one of the two ports round (a minus sign in its label or"
                " weights)"
            )
        w = 2.0 * np.pi * crossover
        if ti_ratio is not None:
            others.setdefault("ti", ti_ratio / w)
        if kv_ratio is not None and "kv" not in others:
            others["kv"] = w / kv_ratio
            if position is not None and "ratio" not in others:
                others["ratio"] = _round_ratio(nominal, torque, velocity, position)
        return cls(kp=inertia * w, **others)

    @property
    def position_gain(self) -> float:
        """Velocity command over position error, in 1/s times `ratio`; 0 without a position loop."""
        return self.ratio * (self.kv or 0.0)

    @property
    def forward_gain(self) -> float:
        """Velocity command over the velocity of the reference."""
        return self.ratio * self.feed_forward

    def torque(self, s: ArrayLike) -> ComplexArray:
        """Return torque over velocity error, with the exact dead time.

        Parameters
        ----------
        s : array_like of complex
            In rad/s, not 0 with an integral part.

        Returns
        -------
        ndarray of complex
            Of the shape of `s`, in N m per rad/s.
        """
        s = np.asarray(s, dtype=np.complex128)
        out: ComplexArray = np.asarray(self.kp * np.exp(-self.dead_time * s), dtype=np.complex128)
        if self.ti is not None:
            out = out * (1.0 + 1.0 / (self.ti * s))
        for notch in self.notches:
            out = out * notch.at(s)
        if self.low_pass is not None:
            w = _TWO_PI * self.low_pass
            if self.low_pass_damping is None:
                out = out * w / (s + w)
            else:
                out = out * w**2 / (s**2 + 2.0 * self.low_pass_damping * w * s + w**2)
        return out

    def state_space(self, pade: int = 0) -> StateSpace:
        """Return torque over velocity error as a state-space system.

        Parameters
        ----------
        pade : int
            Order of the Pade approximation of the dead time; 0 omits it.

        Returns
        -------
        StateSpace
        """
        out = StateSpace.gain(self.kp)
        if self.ti is not None:
            integral = StateSpace(
                np.zeros((1, 1)), np.ones((1, 1)), np.array([[1.0 / self.ti]]), np.ones((1, 1))
            )
            out = integral * out
        for notch in self.notches:
            out = notch.state_space() * out
        if self.low_pass is not None:
            out = _low_pass(self.low_pass, self.low_pass_damping) * out
        if pade and self.dead_time:
            out = delay_approximation(self.dead_time, pade) * out
        return out

    @property
    def poles(self) -> ComplexArray:
        """Poles of torque over velocity error, in rad/s, without the dead time."""
        out = [np.zeros(int(self.ti is not None), dtype=np.complex128)]
        out += [_pole_pair(n.frequency, n.pole_damping) for n in self.notches]
        if self.low_pass is not None:
            if self.low_pass_damping is None:
                out.append(np.array([-_TWO_PI * self.low_pass + 0j]))
            else:
                out.append(_pole_pair(self.low_pass, self.low_pass_damping))
        return np.concatenate(out)

    @property
    def zeros(self) -> ComplexArray:
        """Zeros of torque over velocity error, in rad/s."""
        integrator_zero = np.array([] if self.ti is None else [-1.0 / self.ti], dtype=np.complex128)
        return np.concatenate([integrator_zero, *(n.zeros for n in self.notches)])

    @property
    def rolls_off(self) -> bool:
        """Whether the torque command has a low-pass."""
        return self.low_pass is not None

    def summary(self) -> str:
        """Return the settings as text, one per line."""
        integral = "no integral part" if self.ti is None else f"ti {self.ti:.6g} s"
        unit = "torque or force per unit of velocity"
        lines = [f"velocity loop  kp {self.kp:.6g} ({unit}), {integral}"]
        if self.kv is not None:
            lines.append(f"position loop  kv {self.kv:.6g} 1/s")
            if self.ratio != 1.0:
                lines[-1] += f", times the gear ratio {self.ratio:.6g}"
            if self.feed_forward:
                lines[-1] += f", {100 * self.feed_forward:g} % velocity feed-forward"
        lines += [
            f"notch          {n.frequency:g} Hz, width {n.width:.4g} Hz, depth {n.depth:.3g}"
            for n in self.notches
        ]
        if self.low_pass is not None:
            order = "first order"
            if self.low_pass_damping is not None:
                order = f"damping {self.low_pass_damping:g}"
            lines.append(f"low-pass       {self.low_pass:g} Hz, {order}")
        if self.dead_time:
            lines.append(f"dead time      {1e3 * self.dead_time:g} ms")
        return "\n".join(lines)


def require_continuous(plant: Plant) -> None:
    """Raise OptionError if the plant of a servo is sampled."""
    if plant.dt is not None:
        raise OptionError(
            f"the plant is sampled every {plant.dt:g} s; a servo needs the continuous plant, with"
            f" the sampling as dead_time of the controller ({1.5 * plant.dt:g} s for one"
            " interval of computation and the hold), or the sampled plant in addition as sampled="
        )


def to_velocity(plant: Plant, output: str, what: str = "velocity") -> int:
    """Return the power of s that converts an output to a velocity: 1 for a displacement, else 0."""
    quantity = plant.quantities[plant.outputs.index(output)]
    if quantity == "accelerance":
        raise OptionError(
            f"output {output!r} is an acceleration; a {what} must come from a displacement or a"
            " velocity: make the plant with quantity='receptance' or 'mobility' for it"
        )
    return int(quantity == "receptance")


def rigid_inertia(plant: Plant, torque: str, velocity: str) -> float | None:
    """Return the rigid-body inertia between a torque and a velocity, in kg m2 (kg).

    Negative if a positive torque turns the output in the negative direction, None without free
    rotation. Its reciprocal is the sum of the residues of the mobility at the slow poles, computed
    by an integral on a circle around them: at 0, or with bearing friction c at -c / J.
    """
    require_continuous(plant)
    channel = plant.channel(velocity, torque)
    power = to_velocity(channel, velocity)
    transfer = Transfer.of(StateSpace(channel.A, channel.B, channel.C, channel.D))
    n_points = RIGID_MOTION.circle_points
    circle = np.exp(2j * np.pi * (np.arange(n_points) + 0.5) / n_points)
    best, share = None, RIGID_MOTION.dominant_share
    for radius in _radii(plant.poles):
        points = radius * circle
        mobility = points * (transfer.at(points)[:, 0, 0] * points**power)
        residue = float(mobility.mean().real)
        inertia = abs(residue) / float(np.abs(mobility).mean())
        if inertia > share:
            best, share = 1.0 / residue, inertia
    return best


def rigid_ratio(plant: Plant, torque: str, velocity: str, position: str) -> float | None:
    """Return the signed ratio of two outputs' speeds in rigid-body motion; None if one has none."""
    inner, outer = (rigid_inertia(plant, torque, name) for name in (velocity, position))
    return None if inner is None or outer is None else outer / inner


def _round_ratio(plant: Plant, torque: str, velocity: str, position: str) -> float:
    """Return the gear ratio, exactly 1 if it is 1 up to the error of the plant."""
    ratio = rigid_ratio(plant, torque, velocity, position)
    if ratio is None:
        raise ModelError(
            f"the plant has no rigid-body motion from {torque!r} to {position!r}, so the gear ratio"
            " of the position loop is unknown; give kv and ratio by hand"
        )
    return 1.0 if abs(ratio - 1.0) < RIGID_MOTION.unit_ratio_distance else ratio


def _radii(poles: ComplexArray) -> RealArray:
    """Return radii of circles between the poles below the first oscillation, in rad/s."""
    size = np.abs(poles)
    moving = size > 1e-6 * size.max(initial=0.0)
    oscillating = size[moving & (np.abs(poles.imag) > 0.1 * size)]
    if len(oscillating):
        first = float(oscillating.min())
    else:
        first = 10.0 * float(size[moving].max(initial=1.0))
    low = RIGID_MOTION.least_radius_ratio * first
    steps = np.unique(np.concatenate([[low], np.clip(size[size <= first], low, None), [first]]))
    wide = steps[1:] > RIGID_MOTION.least_gap * steps[:-1]
    return np.asarray(np.sqrt(steps[1:] * steps[:-1])[wide])


def _low_pass(corner: float, damping: float | None) -> StateSpace:
    w = _TWO_PI * corner
    if damping is None:
        return StateSpace(np.array([[-w]]), np.ones((1, 1)), np.array([[w]]), np.zeros((1, 1)))
    return StateSpace(
        np.array([[0.0, w], [-w, -2.0 * damping * w]]),
        np.array([[0.0], [1.0]]),
        np.array([[w, 0.0]]),
        np.zeros((1, 1)),
    )


def _pole_pair(frequency: float, damping: float) -> ComplexArray:
    return np.array(root_pair(_TWO_PI * frequency, damping), dtype=np.complex128)


def _positive(what: str, value: object, unit: str = "", remedy: str = "") -> None:
    if not is_number(value) or not math.isfinite(value) or value <= 0:
        name = what.rpartition(": ")[2]
        text = f"{what} is {value!r}; expected a number above 0"
        if unit:
            text += f", in {unit}"
        if remedy:
            text += f" ({remedy})"
        raise OptionError(text, key=(name,))
