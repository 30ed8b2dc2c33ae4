"""`DriveFigures`: what a drive is for its servo, in numbers. Pure data, with a summary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bandwidth", "DriveFigures", "ResonancePair"]


@dataclass(frozen=True, slots=True)
class ResonancePair:
    """An antiresonance of torque to motor speed, and the resonance above it.

    Attributes
    ----------
    antiresonance, resonance : float
        In Hz, without damping: a locked-rotor and a free-rotor frequency.
    antiresonance_damping, resonance_damping : float
        Damping ratios, half the modal loss factors; nan above a band that the tables of loss
        factors end with.
    """

    antiresonance: float
    resonance: float
    antiresonance_damping: float
    resonance_damping: float


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """What loops about the motor may reach.

    Attributes
    ----------
    velocity : float
        Upper bound of the crossover of the velocity loop, in Hz: the first antiresonance.
    position : (float, float)
        Usual bandwidth of the position loop, in Hz: a third and a half of the same frequency.
    damping : float or None
        Damping ratio of all four poles of a PI velocity loop on two inertias that places them at
        the antiresonance, sqrt(R) / 2 with the inertia ratio R; 1 or more: all can be real. None:
        no inertia ratio is known.
    """

    velocity: float
    position: tuple[float, float]
    damping: float | None

    @property
    def rule(self) -> str:
        """The rules as text, with their sources and numbers."""
        low, high = self.position
        text = (
            f"Velocity loop: crossover below the first antiresonance, {self.velocity:.5g} Hz; above"
            " it motor and load no longer turn together, and what the loop stiffens is the motor"
            " alone. With two inertias and PI control, poles of equal radius all lie at this"
            " frequency"
        )
        if self.damping is not None:
            text += (
                f", with a damping ratio of sqrt(R) / 2 = {self.damping:.3g}, R the inertia ratio"
                " of load to motor"
            )
        return (
            f"{text} (Zhang & Furusho, IEEE Trans. Industrial Electronics 47 (2000) 603-609)."
            f" Position loop: {low:.5g} to {high:.5g} Hz, a third to a half of the first"
            " locked-rotor frequency; a rule of thumb of antenna servos, not a bound: margins over"
            " the family of plants decide."
        )


@dataclass(frozen=True, slots=True, eq=False)
class DriveFigures:
    """The figures of a drive: motor, train, load; of a linear DOF read kg for kg m2 and N/m for N m/rad.

    Frequencies are those without damping; damping ratios stand beside them. What a figure needs and
    the model does not have (a rigid-body motion, a stated ratio) leaves it None, and `notes` say
    why.

    Attributes
    ----------
    motor, load : str
        Signed DOFs.
    locked, locked_damping : ndarray of float, shape (n,)
        Locked-rotor frequencies in Hz, motor held, and their damping ratios.
    free, free_damping : ndarray of float, shape (m,)
        Free-rotor frequencies in Hz, rigid-body motion left out, and their damping ratios.
    pairs : tuple of ResonancePair
        What torque to motor speed shows, ascending.
    first_resonance : float or None
        Resonance below the first antiresonance in Hz, of a model without rigid-body motion of the
        motor.
    hidden : tuple of float
        Locked-rotor frequencies in Hz that the motor does not see: resonance and antiresonance
        differ by less than `separation`.
    separation : float
        As a share of the frequency.
    antiresonance_error : float
        Largest distance of a zero of the computed response torque to motor speed from the
        locked-rotor frequency that belongs to it, as a share of it: the check that both are the
        same.
    rigid : int
        Number of rigid-body modes of the free model.
    ratio : float or None
        Speed of the motor over that of the load in rigid-body motion, with sign; as stated where
        the model has none.
    ratio_from : str
        ``"rigid-body mode"``, ``"stated"`` or ``""``.
    inertia : float or None
        Rigid-body inertia at the motor, everything counted, in kg m2.
    motor_inertia : float
        On the motor's DOF itself, in kg m2.
    rest_inertia : float or None
        The rest, seen at the motor, in kg m2.
    load_inertia : float or None
        The rest, seen at the load, in kg m2: `rest_inertia` times ratio squared.
    inertia_ratio : float or None
        `rest_inertia` over `motor_inertia`: J_L / (n^2 J_M).
    stiffness_at_motor : float
        Static stiffness at the motor, load held, in N m/rad.
    stiffness_at_load : float
        Static stiffness at the load, motor held, in N m/rad; of a train that can turn, that at the
        motor times ratio squared.
    bandwidth : Bandwidth or None
        What loops may reach. None: the motor sees no antiresonance in the band.
    band : (float, float) or None
        Where modes were looked for, in Hz. None: the lowest ones.
    notes : tuple of str
        What could not be found, and why.
    """

    motor: str
    load: str
    locked: NDArray[np.float64]
    locked_damping: NDArray[np.float64]
    free: NDArray[np.float64]
    free_damping: NDArray[np.float64]
    pairs: tuple[ResonancePair, ...]
    first_resonance: float | None
    hidden: tuple[float, ...]
    separation: float
    antiresonance_error: float
    rigid: int
    ratio: float | None
    ratio_from: str
    inertia: float | None
    motor_inertia: float
    rest_inertia: float | None
    load_inertia: float | None
    inertia_ratio: float | None
    stiffness_at_motor: float
    stiffness_at_load: float
    bandwidth: Bandwidth | None
    band: tuple[float, float] | None
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        first = f"{self.pairs[0].antiresonance:.5g} Hz" if self.pairs else "none seen"
        return (
            f"DriveFigures({self.motor} to {self.load}: first antiresonance {first}, ratio"
            f" {_g(self.ratio)})"
        )

    def summary(self) -> str:
        """Return all figures as text.

        Returns
        -------
        str
        """
        (mass_m, stiff_m), (mass_l, stiff_l) = _units(self.motor), _units(self.load)
        rows = [
            ("gear ratio", _g(self.ratio), f"from {self.ratio_from}" if self.ratio_from else ""),
            ("inertia at the motor", _g(self.inertia), f"{mass_m}, all in rigid-body motion"),
            ("  motor's own", _g(self.motor_inertia), mass_m),
            ("  the rest", _g(self.rest_inertia), mass_m),
            ("  the rest at the load", _g(self.load_inertia), mass_l),
            ("inertia ratio", _g(self.inertia_ratio), "rest over motor, at the motor"),
            ("stiffness at the motor", _g(self.stiffness_at_motor), f"{stiff_m}, load held"),
            ("stiffness at the load", _g(self.stiffness_at_load), f"{stiff_l}, motor held"),
        ]
        lines = [f"Drive from {self.motor} (motor) to {self.load} (load)"]
        lines += [f"{name:<24}{value:>12}  {unit}".rstrip() for name, value, unit in rows]
        if self.first_resonance is not None:
            lines.append(f"{'first resonance':<24}{self.first_resonance:>12.6g}  Hz")
        if self.pairs:
            lines += [
                "Torque to motor speed:",
                f"{'antiresonance Hz':>18}{'damping':>10}{'resonance Hz':>14}{'damping':>10}",
            ]
            lines += [
                f"{p.antiresonance:>18.6g}{p.antiresonance_damping:>10.3g}{p.resonance:>14.6g}{p.resonance_damping:>10.3g}"
                for p in self.pairs
            ]
        if self.hidden:
            shown = ", ".join(f"{f:.5g}" for f in self.hidden[:8]) + (
                ", ..." if len(self.hidden) > 8 else ""
            )
            lines.append(f"Locked-rotor frequencies that the motor does not see: {shown} Hz")
        lines += [] if self.bandwidth is None else [self.bandwidth.rule]
        return "\n".join([*lines, *self.notes])


def _units(dof: str) -> tuple[str, str]:
    """Return the units of inertia and stiffness at a DOF."""
    return ("kg m2", "N m/rad") if "R" in dof else ("kg", "N/m")


def _g(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"
