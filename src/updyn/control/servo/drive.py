"""`DriveFigures`: the figures of a drive that a servo design needs, as data with a summary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.control.servo.settings import DRIVE
from updyn.dofs import Dof, DofSet
from updyn.dynamics.condensation import condense
from updyn.dynamics.eigen import mass_rank
from updyn.dynamics.modes import Modes, modes
from updyn.dynamics.response import response
from updyn.errors import DofError, ModelError, OptionError
from updyn.group import Group, is_number
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = [
    "Bandwidth",
    "DriveFigures",
    "ResonancePair",
    "drive_figures",
]


@dataclass(frozen=True, slots=True)
class ResonancePair:
    """An antiresonance of torque to motor speed and the next resonance above it.

    Undamped frequencies in Hz (locked rotor, free rotor), and damping ratios: half the modal loss
    factors, nan above the tables of loss factors.
    """

    antiresonance: float
    resonance: float
    antiresonance_damping: float
    resonance_damping: float


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """Attainable bandwidth of the loops around the motor, in Hz.

    `velocity`, the first antiresonance, limits the crossover of the velocity loop; `position` is a
    third to a half of it. `damping` is sqrt(R) / 2 with the inertia ratio R: that of the four poles
    of a PI velocity loop on two inertias, placed at the antiresonance. All can be real if it is 1
    or more. None if R is unknown.
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
            " it motor and load no longer turn together, and the loop stiffens only the motor."
            " With two inertias and PI control, poles of equal radius all lie at this"
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
            " locked-rotor frequency; a rule of thumb for antenna servos, not a bound: check the"
            " margins over the family of plants."
        )


@dataclass(frozen=True, slots=True, eq=False)
class DriveFigures:
    """Figures of a drive of motor, train and load; for linear DOFs in kg and N/m.

    Frequencies are undamped. Figures are None if the model lacks the data for them (a rigid-body
    motion, a stated ratio); `notes` give the reason.

    Attributes
    ----------
    motor, load : str
        Signed DOFs.
    locked, locked_damping : ndarray of float, shape (n,)
        Locked-rotor frequencies in Hz (motor held) and their damping ratios.
    free, free_damping : ndarray of float, shape (m,)
        Free-rotor frequencies in Hz without rigid-body modes, and their damping ratios.
    pairs : tuple of ResonancePair
        Antiresonances and resonances of torque to motor speed, ascending.
    first_resonance : float or None
        Resonance below the first antiresonance in Hz, without rigid-body motion of the motor.
    hidden : tuple of float
        Locked-rotor frequencies in Hz that cancel with a resonance at the motor.
    separation : float
        Relative difference of frequency below which a pair cancels.
    antiresonance_error : float
        Largest relative distance between a zero of torque to motor speed and its locked-rotor
        frequency.
    rigid : int
        Number of rigid-body modes of the free model.
    ratio : float or None
        Signed speed of the motor over that of the load in rigid-body motion, else as stated.
    ratio_from : str
        ``"rigid-body mode"``, ``"stated"`` or ``""``.
    inertia : float or None
        Total rigid-body inertia at the motor, in kg m2.
    motor_inertia : float
        Inertia on the motor's DOF itself, in kg m2.
    rest_inertia : float or None
        `inertia` less `motor_inertia`, at the motor, in kg m2.
    load_inertia : float or None
        `rest_inertia` times ratio squared: the same inertia at the load, in kg m2.
    inertia_ratio : float or None
        `rest_inertia` over `motor_inertia`: J_L / (n^2 J_M).
    stiffness_at_motor, stiffness_at_load : float
        Static stiffness in N m/rad, the other end held; for a train that can turn, that at the
        load is that at the motor times ratio squared.
    bandwidth : Bandwidth or None
        None if no antiresonance in the band is observable at the motor.
    band : (float, float) or None
        Frequency range of the modes, in Hz. None: the lowest modes.
    notes : tuple of str
        Figures that could not be determined, with the reasons.
    """

    motor: str
    load: str
    locked: RealArray
    locked_damping: RealArray
    free: RealArray
    free_damping: RealArray
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
            f" {_format_number(self.ratio)})"
        )

    def summary(self) -> str:
        """Return all figures as text."""
        mass_m, stiff_m = _units(self.motor)
        mass_l, stiff_l = _units(self.load)
        ratio_from = f"from {self.ratio_from}" if self.ratio_from else ""
        rows = [
            ("gear ratio", _format_number(self.ratio), ratio_from),
            (
                "inertia at the motor",
                _format_number(self.inertia),
                f"{mass_m}, all in rigid-body motion",
            ),
            ("  motor's own", _format_number(self.motor_inertia), mass_m),
            ("  the rest", _format_number(self.rest_inertia), mass_m),
            ("  the rest at the load", _format_number(self.load_inertia), mass_l),
            ("inertia ratio", _format_number(self.inertia_ratio), "rest over motor, at the motor"),
            (
                "stiffness at the motor",
                _format_number(self.stiffness_at_motor),
                f"{stiff_m}, load held",
            ),
            (
                "stiffness at the load",
                _format_number(self.stiffness_at_load),
                f"{stiff_l}, motor held",
            ),
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
            for p in self.pairs:
                zero = f"{p.antiresonance:>18.6g}{p.antiresonance_damping:>10.3g}"
                lines.append(f"{zero}{p.resonance:>14.6g}{p.resonance_damping:>10.3g}")
        if self.hidden:
            shown = ", ".join(f"{f:.5g}" for f in self.hidden[:8])
            if len(self.hidden) > 8:
                shown += ", ..."
            lines.append(f"Locked-rotor frequencies not observable at the motor: {shown} Hz")
        if self.bandwidth is not None:
            lines.append(self.bandwidth.rule)
        return "\n".join([*lines, *self.notes])


def _units(dof: str) -> tuple[str, str]:
    return ("kg m2", "N m/rad") if "R" in dof else ("kg", "N/m")


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


@dataclass(frozen=True, slots=True)
class _RigidMotion:
    """Inertia at the motor and gear ratio, with a note if one of them is unknown."""

    inertia: float | None
    ratio: float | None
    note: str


def drive_figures(
    model: Model | UpdateResult,
    motor: str | Dof,
    load: str | Dof,
    *,
    ratio: float | None = None,
    band: Sequence[float] | None = None,
    separation: float = 1e-3,
) -> DriveFigures:
    """Return frequencies, inertias, gear ratio, stiffness and attainable bandwidth of a drive.

    Parameters
    ----------
    model : Model or UpdateResult
        The structure with the motor free, or an update result of it.
    motor : str or Dof
        Signed DOF on which the torque acts and which the motor's encoder reads.
    load : str or Dof
        Signed DOF of the ring, the tool or the dish.
    ratio : float, optional
        Speed of the motor over that of the load by the drawings, with sign. Checked against the
        rigid-body motion; used as stated if the model has none.
    band : (float, float), optional
        Frequency range of the modes in Hz. None: the lowest ten modes, or all of a small model.
    separation : float
        A resonance and an antiresonance cancel if they differ by less than this share of their
        frequency: the mode is not observable at the motor.

    Returns
    -------
    DriveFigures

    Raises
    ------
    DofError
        If a DOF is not in the model, or both are the same.
    OptionError
        If the ratio, the band or the separation is invalid.
    ModelError
        If the stated ratio contradicts the rigid-body motion, or no stiffness joins motor and load.
    SolverError
        If modes cannot be computed.

    Notes
    -----
    With the rigid-body modes phi_r, scaled to unit modal mass, the inertia at the motor is 1 / sum
    phi_r(motor)^2. The stiffness between motor and load follows from the static condensation K_c
    onto both: K_c[0, 0] at the motor with the load held, K_c[1, 1] at the load with the motor held.
    For a train that can turn, K_c [n, 1] = 0, so the two differ by n^2, and 1 / k = sum 1 / (k_i
    n_i^2) for parts in series.

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
    >>> found = updyn.drive_figures(drive, "1:RZ", "2:RZ")
    >>> [round(float(f), 2) for f in (*found.locked, *found.free)]  # sqrt(k / J) / (2 pi), in Hz
    [5.03, 11.25]
    >>> round(found.inertia_ratio, 6)
    4.0
    """
    given = model.model if isinstance(model, UpdateResult) else model
    if not isinstance(given, Model):
        raise OptionError(
            f"drive figures: expected a Model or an UpdateResult, found {type(model).__name__}"
        )
    ends = _find_ends(given, motor, load)
    limits = _check_options(ratio, band, separation)
    held = _hold_dofs(given, [int(ends.index[0])])
    top = np.inf
    if limits is not None:
        top = limits[1]
    locked = _find_modes_up_to(held, top)
    free = _find_modes_up_to(given, top, at_least=len(locked) + 1)
    rigid = int((free.frequency == 0.0).sum())
    turning = _rigid_motion(free, rigid, ends.index, ends.sign)
    notes = list(filter(None, [turning.note]))
    n = _choose_ratio(turning.ratio, ratio, notes, str(motor), str(load))
    stiffness = _stiffness(given, free.shapes[:, :rigid], ends.index, turning.note)
    pairs, hidden = _pairs(locked, free, separation, limits)
    motor_mass = float(given.mass.diagonal()[ends.index[0]])
    first = rest = inertia_ratio = load_inertia = None
    if turning.inertia is None:
        first = _find_first_resonance(free, locked, separation, limits)
    else:
        rest = turning.inertia - motor_mass
        if motor_mass <= 0:
            notes.append(
                f"The motor's DOF {motor} carries no inertia: the inertia ratio is undefined."
            )
        elif rest < 0:
            notes.append("The motor turns against a body that is itself free: no inertia ratio.")
            rest = None
        else:
            inertia_ratio = rest / motor_mass
    ratio_from = ""
    if n is not None:
        ratio_from = "stated" if turning.ratio is None else "rigid-body mode"
        if rest is not None:
            load_inertia = rest * n**2
    if not pairs:
        notes.append("No antiresonance in the band is observable at the motor: no bandwidth.")
    return DriveFigures(
        motor=str(motor),
        load=str(load),
        locked=_select_in_band(locked.frequency, limits),
        locked_damping=_damping_ratios(locked, limits),
        free=_select_in_band(free.frequency, limits),
        free_damping=_damping_ratios(free, limits),
        pairs=pairs,
        first_resonance=first,
        hidden=hidden,
        separation=float(separation),
        antiresonance_error=_zero_error(given, str(motor), pairs),
        rigid=rigid,
        ratio=n,
        ratio_from=ratio_from,
        inertia=turning.inertia,
        motor_inertia=motor_mass,
        rest_inertia=rest,
        load_inertia=load_inertia,
        inertia_ratio=inertia_ratio,
        stiffness_at_motor=float(stiffness[0, 0]),
        stiffness_at_load=float(stiffness[1, 1]),
        bandwidth=_bandwidth(pairs, inertia_ratio),
        band=limits,
        notes=tuple(notes),
    )


# -- options --------------------------------------------------------------------------------------
def _find_ends(model: Model, motor: str | Dof, load: str | Dof) -> Any:
    one, two = Dof.parse(motor), Dof.parse(load)
    if (one.node, one.direction) == (two.node, two.direction):
        raise DofError(
            f"drive figures: motor and load are both {one}; expected two DOFs with the train"
            " between them"
        )
    for dof, what in ((one, "motor"), (two, "load")):
        model.dofs.match([dof], what)
    return model.dofs.match([one, two])


def _check_options(ratio: Any, band: Any, separation: Any) -> tuple[float, float] | None:
    if ratio is not None and not (is_number(ratio) and math.isfinite(ratio) and ratio != 0):
        raise OptionError(f"drive figures: ratio {ratio!r}; expected a finite number other than 0")
    if not (is_number(separation) and 0 <= separation < 1):
        raise OptionError(
            f"drive figures: separation {separation!r}; expected a share from 0 to below 1"
        )
    if band is None:
        return None
    try:
        low, high = (float(f) for f in band)
    except (TypeError, ValueError) as error:
        raise OptionError(f"drive figures: band {band!r}; expected two lines in Hz") from error
    if not 0 <= low < high < np.inf:
        raise OptionError(f"drive figures: band {low:g} to {high:g} Hz; expected 0 <= low < high")
    return low, high


def _hold_dofs(model: Model, at: Sequence[int]) -> Model:
    """Return the model with some DOFs held: their rows and columns are removed."""
    model.refuse_nonlinear("drive figures")
    keep = np.ones(model.n_dofs, dtype=np.bool_)
    keep[list(at)] = False
    free_dofs = np.flatnonzero(keep)

    def submatrix(matrix: Any) -> object:
        if matrix is None:
            return None
        return matrix[free_dofs][:, free_dofs]

    groups = {}
    for name, g in model.groups.items():
        groups[name] = g.with_matrices(
            submatrix(g.stiffness), submatrix(g.mass), submatrix(g.viscous)
        )
    return Model(groups, model.dofs[free_dofs], model.geometry, model.title)


# -- frequencies ----------------------------------------------------------------------------------
def _find_modes_up_to(model: Model, top: float, at_least: int = 0) -> Modes:
    """Return the modes up to a frequency and the next one, at least `at_least` of them."""
    rank = mass_rank(model.mass)
    if rank == 0:
        return Modes(np.zeros(0), np.zeros(0), np.zeros((model.n_dofs, 0)), model.dofs)
    n = min(rank, max(at_least, DRIVE.least_modes))
    tabled = [name for name, group in model.groups.items() if group.loss_table is not None]
    plain = model
    if tabled:
        plain = model.with_damping({name: {"loss_table": None} for name in tabled})
    found = modes(plain, n)
    while np.isfinite(top) and n < rank and found.frequency[-1] <= top:
        n = min(rank, 2 * n)
        found = modes(plain, n)
    if tabled:
        return _apply_loss_tables(model, found, top)
    return found


def _apply_loss_tables(model: Model, found: Modes, top: float) -> Modes:
    """Return modes with their loss factors; nan above the range of the tables."""
    inside = int((found.frequency <= top).sum())
    loss = np.full(len(found), np.nan)
    if inside:
        loss[:inside] = modes(model, inside).loss_factor
    return Modes(found.frequency, loss, found.shapes, found.dofs)


def _select_in_band(freq: RealArray, limits: tuple[float, float] | None) -> RealArray:
    out = freq[_band_mask(freq, limits)]
    out.flags.writeable = False
    return out


def _damping_ratios(found: Modes, limits: tuple[float, float] | None) -> RealArray:
    out = 0.5 * found.loss_factor[_band_mask(found.frequency, limits)]
    out.flags.writeable = False
    return out


def _band_mask(freq: RealArray, limits: tuple[float, float] | None) -> BoolArray:
    low, high = limits or (0.0, np.inf)
    return (freq > 0) & (freq >= low) & (freq <= high)


def _pairs(
    locked: Modes, free: Modes, separation: float, limits: tuple[float, float] | None
) -> tuple[tuple[ResonancePair, ...], tuple[float, ...]]:
    """Return the observable pairs and the hidden locked-rotor frequencies."""
    # Poles and zeros of a driving-point response alternate (Ewins, Modal Testing, 2nd ed. 2000,
    # chapter 2). Removing a neighbouring pole and zero keeps this order, so each remaining zero
    # pairs with the next pole.
    zeros, poles, hidden = _cancel_pairs(locked, free, separation)
    out = []
    for i in zeros:
        above = [j for j in poles if free.frequency[j] > locked.frequency[i]]
        if above and _band_mask(locked.frequency[[i]], limits)[0]:
            j = above[0]
            a, r = locked.loss_factor[i] / 2, free.loss_factor[j] / 2
            out.append(
                ResonancePair(
                    float(locked.frequency[i]), float(free.frequency[j]), float(a), float(r)
                )
            )
    unseen = locked.frequency[hidden]
    return tuple(out), tuple(unseen[_band_mask(unseen, limits)].tolist())


def _cancel_pairs(
    locked: Modes, free: Modes, separation: float
) -> tuple[list[int], list[int], list[int]]:
    """Return the indices of the remaining zeros, remaining poles and cancelled zeros."""
    zeros, poles = list(range(len(locked))), list(range(len(free)))
    hidden = []
    couples = []
    for i, zero in enumerate(locked.frequency):
        for j, pole in enumerate(free.frequency):
            apart = abs(pole - zero)
            if apart <= separation * zero:
                couples.append((apart / max(zero, np.finfo(np.float64).tiny), i, j))
    for _, i, j in sorted(couples):
        if i in zeros and j in poles:
            zeros.remove(i)
            poles.remove(j)
            hidden.append(i)
    return zeros, poles, sorted(hidden)


def _find_first_resonance(
    free: Modes, locked: Modes, separation: float, limits: tuple[float, float] | None
) -> float | None:
    """Return the resonance below the first antiresonance."""
    zeros, poles, _ = _cancel_pairs(locked, free, separation)
    below = free.frequency[poles]
    if zeros:
        below = below[below < locked.frequency[zeros[0]]]
    below = below[_band_mask(below, limits)]
    return float(below[0]) if len(below) else None


def _zero_error(model: Model, motor: str, pairs: Sequence[ResonancePair]) -> float:
    """Return the largest relative distance of a response zero from its locked-rotor frequency."""
    if not pairs:
        return 0.0
    groups = {}
    for name, g in model.groups.items():
        if g.stiffness is not None or g.mass is not None:
            groups[name] = Group(g.stiffness, g.mass)
    bare = Model(groups, model.dofs)
    zero = np.array([p.antiresonance for p in pairs])
    offset = DRIVE.zero_offset
    lines = np.unique(np.concatenate([zero * (1 - offset), zero * (1 + offset)]))
    H = response(bare, lines, [motor], [motor]).values[:, 0, 0].real
    below = H[np.searchsorted(lines, zero * (1 - offset))]
    above = H[np.searchsorted(lines, zero * (1 + offset))]
    # The straight line through both values gives the zero.
    return float(np.abs(offset * (below + above) / (below - above)).max())


# -- rigid-body motion and stiffness --------------------------------------------------------------
def _rigid_motion(free: Modes, rigid: int, at: IndexArray, sign: RealArray) -> _RigidMotion:
    shapes = free.shapes[:, :rigid]
    ends_motion = shapes[at] * sign[:, None]
    size = np.abs(shapes).max(initial=0.0)
    if rigid == 0 or np.abs(ends_motion[0]).max() <= DRIVE.rest_motion * size:
        which = "No rigid-body motion of the model turns the motor"
        if rigid == 0:
            which = "The model has no rigid-body motion"
        return _RigidMotion(
            None, None, f"{which}: inertias at the motor and gear ratio are undetermined."
        )
    inertia = 1.0 / float(ends_motion[0] @ ends_motion[0])
    if np.abs(ends_motion[1]).max() <= DRIVE.rest_motion * size:
        return _RigidMotion(
            inertia,
            None,
            "Rigid-body motion of the motor leaves the load at rest: the gear ratio is undefined.",
        )
    n = float(ends_motion[0] @ ends_motion[1]) / float(ends_motion[1] @ ends_motion[1])
    if np.abs(ends_motion[0] - n * ends_motion[1]).max() > 1e-6 * np.abs(ends_motion[0]).max():
        return _RigidMotion(
            inertia,
            None,
            f"The model has {rigid} rigid-body motions in which motor and load turn in different"
            " ratios: the gear ratio is not determined; read the motor against its housing.",
        )
    return _RigidMotion(inertia, n, "")


def _choose_ratio(
    found: float | None, stated: float | None, notes: list[str], motor: str, load: str
) -> float | None:
    """Return the gear ratio; checks a stated one against the rigid-body motion."""
    if found is None or stated is None:
        if stated is None:
            return found
        notes.append(f"The ratio {stated:g} is as stated; the model cannot check it.")
        return float(stated)
    if abs(found - stated) <= DRIVE.ratio_error * abs(found):
        return found
    if abs(found + stated) <= DRIVE.ratio_error * abs(found):
        raise ModelError(
            f"ratio {stated:g}: in the model {motor} and {load} turn in the other sense, ratio"
            f" {found:.6g}; state {-stated:g}, or turn one of the DOFs ({-Dof.parse(load)})"
        )
    raise ModelError(
        f"ratio {stated:g}: in the model {motor} turns {found:.6g} times as fast as {load}"
    )


def _stiffness(model: Model, rigid: RealArray, at: IndexArray, note: str) -> RealArray:
    """Return the stiffness condensed onto motor and load, shape (2, 2)."""
    # Rigid-body motions in which both DOFs are at rest carry no load, so supporting them
    # statically determinately does not change the result.
    resting = rigid
    if rigid.shape[1]:
        resting = rigid @ scipy.linalg.null_space(rigid[at], rcond=DRIVE.rest_motion)
    supports: list[int] = []
    if resting.shape[1]:
        _, _, order = scipy.linalg.qr(resting.T, mode="economic", pivoting=True)
        supports = order[: resting.shape[1]].tolist()
    bare = {}
    for name, g in _hold_dofs(model, supports).groups.items():
        if g.stiffness is not None:
            bare[name] = Group(g.stiffness)
    if not bare:
        raise ModelError("drive figures: the model has no stiffness")
    kept = model.dofs[np.setdiff1d(np.arange(model.n_dofs), supports)]
    Z = condense(Model(bare, kept), [0.0], DofSet(model.dofs[at])).Z[0].real
    if abs(Z[0, 1]) <= 1e-12 * np.sqrt(abs(Z[0, 0] * Z[1, 1])):
        motor, load = model.dofs[int(at[0])], model.dofs[int(at[1])]
        raise ModelError(
            f"drive figures: no stiffness joins {motor} and {load}. {note}".rstrip(". ") + "."
        )
    return np.asarray(Z)


def _bandwidth(pairs: Sequence[ResonancePair], inertia_ratio: float | None) -> Bandwidth | None:
    if not pairs:
        return None
    first = pairs[0].antiresonance
    damping = None if inertia_ratio is None else float(np.sqrt(inertia_ratio) / 2)
    return Bandwidth(first, (first / 3, first / 2), damping)
