"""`drive_figures`: locked- and free-rotor frequencies, inertias, gear ratio and stiffness of a drive, from its model.

The zeros of torque to motor speed are the natural frequencies with the motor held, its poles those
with the motor free. Of two inertias they are sqrt(k / J_L) and sqrt(k (1 / J_M' + 1 / J_L)), with
the motor's inertia J_M' = n^2 J_M and the drive's stiffness k both seen at the load (Ellis &
Lorenz, Resonant load control methods for industrial servo drives, IEEE Industry Applications
Society Annual Meeting 2000, vol. 3, 1438-1445).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.control.servo.drive_figures import Bandwidth, DriveFigures, ResonancePair
from updyn.dofs import Dof, DofSet
from updyn.dynamics.condensation import condense
from updyn.dynamics.eigen import mass_rank
from updyn.dynamics.modes import Modes, modes
from updyn.dynamics.response import response
from updyn.errors import DofError, ModelError, OptionError
from updyn.group import Group, is_number
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = ["drive_figures"]

_Real = NDArray[np.float64]
_COUNT = 10  # modes where no band is given
_AGREES = 1e-3  # a stated ratio
_STILL = 1e-9  # share of the largest motion below which a DOF is at rest
_ASIDE = 1e-6  # how far beside a zero the response is computed, as a share of it


@dataclass(frozen=True, slots=True)
class _Rigid:
    """Rigid-body motion at the motor: inertia there, speed over the load's, and why one of them is not known."""

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
    """Return what a drive is for its servo: frequencies, inertias, gear ratio, stiffness, bandwidth.

    Parameters
    ----------
    model : Model or UpdateResult
        The structure with the motor free, or the update that found it.
    motor : str or Dof
        Signed DOF on which the torque acts and which the motor's encoder reads.
    load : str or Dof
        Signed DOF of the ring, the tool or the dish.
    ratio : float, optional
        Speed of the motor over that of the load as the drawings state it, with sign. Checked
        against the rigid-body motion, or used as it is where the model has none.
    band : (float, float), optional
        Modes between these lines in Hz. None: the lowest ten, of a small model all.
    separation : float
        A resonance and an antiresonance that differ by less than this share of their frequency
        cancel: the motor does not see that mode.

    Returns
    -------
    DriveFigures

    Raises
    ------
    DofError
        If a DOF is not in the model, or both are one.
    OptionError
        If the ratio, the band or the separation cannot be used.
    ModelError
        If the stated ratio contradicts the rigid-body motion, or nothing in the model joins motor
        and load.
    SolverError
        If modes cannot be computed.

    Notes
    -----
    With the rigid-body modes phi_r, scaled to unit modal mass, the inertia at the motor is 1 / sum
    phi_r(motor)^2. The stiffness between motor and load follows from the static condensation K_c
    onto both: K_c[0, 0] at the motor with the load held, K_c[1, 1] at the load with the motor held.
    Of a train that can turn, K_c [n, 1] = 0, so that they differ by n^2: the sum 1 / k = sum 1 /
    (k_i n_i^2) of a row of parts.
    """
    given = model.model if isinstance(model, UpdateResult) else model
    if not isinstance(given, Model):
        raise OptionError(
            f"drive figures: expected a Model or an UpdateResult, found {type(model).__name__}"
        )
    ends = _ends(given, motor, load)
    limits = _checked(ratio, band, separation)
    held = _held(given, [int(ends.index[0])])
    top = np.inf if limits is None else limits[1]
    locked = _up_to(held, top)
    free = _up_to(given, top, at_least=len(locked) + 1)
    rigid = int((free.frequency == 0.0).sum())
    turning = _rigid_motion(free, rigid, ends.index, ends.sign)
    notes = [turning.note] if turning.note else []
    n = _told(turning.ratio, ratio, notes, str(motor), str(load))
    stiffness = _stiffness(given, free.shapes[:, :rigid], ends.index, turning.note)
    pairs, hidden = _pairs(locked, free, separation, limits)
    moves = turning.inertia is not None
    first = None if moves else _first(free, locked, separation, limits)
    own = float(given.mass.diagonal()[ends.index[0]])
    rest = None if turning.inertia is None else turning.inertia - own
    inertia_ratio = None if rest is None or own <= 0 else rest / own
    if rest is not None and own <= 0:
        notes.append(
            f"The motor's DOF {motor} carries no inertia of its own: there is no inertia ratio."
        )
    elif inertia_ratio is not None and inertia_ratio < 0:
        notes.append(
            "The motor turns against a body that is free itself: there is no inertia ratio."
        )
        rest, inertia_ratio = None, None
    if not pairs:
        notes.append("The motor sees no antiresonance in the band: no bandwidth follows.")
    return DriveFigures(
        motor=str(motor),
        load=str(load),
        locked=_in_band(locked.frequency, limits),
        locked_damping=_damping(locked, limits),
        free=_in_band(free.frequency, limits),
        free_damping=_damping(free, limits),
        pairs=pairs,
        first_resonance=first,
        hidden=hidden,
        separation=float(separation),
        antiresonance_error=_zero_error(given, str(motor), pairs),
        rigid=rigid,
        ratio=n,
        ratio_from="" if n is None else "stated" if turning.ratio is None else "rigid-body mode",
        inertia=turning.inertia,
        motor_inertia=own,
        rest_inertia=rest,
        load_inertia=None if rest is None or n is None else rest * n**2,
        inertia_ratio=inertia_ratio,
        stiffness_at_motor=float(stiffness[0, 0]),
        stiffness_at_load=float(stiffness[1, 1]),
        bandwidth=_bandwidth(pairs, inertia_ratio),
        band=limits,
        notes=tuple(notes),
    )


# -- what was given ----------------------------------------------------------------------------------------
def _ends(model: Model, motor: str | Dof, load: str | Dof) -> Any:
    one, two = Dof.parse(motor), Dof.parse(load)
    if (one.node, one.direction) == (two.node, two.direction):
        raise DofError(
            f"drive figures: motor and load are both {one}; expected two DOFs with the train"
            " between them"
        )
    for dof, what in ((one, "motor"), (two, "load")):
        model.dofs.match([dof], what)
    return model.dofs.match([one, two])


def _checked(ratio: Any, band: Any, separation: Any) -> tuple[float, float] | None:
    if ratio is not None and not (is_number(ratio) and np.isfinite(ratio) and ratio != 0):
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


def _held(model: Model, at: Sequence[int]) -> Model:
    """Return the model with some DOFs held: their rows and columns are left out of every group."""
    keep = np.ones(model.n_dofs, dtype=np.bool_)
    keep[list(at)] = False
    left = np.flatnonzero(keep)

    def cut(matrix: Any) -> Any:
        return None if matrix is None else matrix[left][:, left]

    groups = {
        name: g.with_matrices(cut(g.stiffness), cut(g.mass), cut(g.viscous))
        for name, g in model.groups.items()
    }
    return Model(groups, model.dofs[left], model.geometry, model.title)


# -- frequencies -------------------------------------------------------------------------------------------
def _up_to(model: Model, top: float, at_least: int = 0) -> Modes:
    """Return all modes up to a frequency and the next one, and not fewer than wanted; ten of an open band."""
    there = mass_rank(model.mass)
    if there == 0:
        return Modes(np.zeros(0), np.zeros(0), np.zeros((model.n_dofs, 0)), model.dofs)
    n = min(there, max(at_least, _COUNT))
    tabled = {
        name: {"loss_table": None}
        for name, group in model.groups.items()
        if group.loss_table is not None
    }
    plain = model.with_damping(tabled) if tabled else model
    found = modes(plain, n)
    while np.isfinite(top) and n < there and found.frequency[-1] <= top:
        n = min(there, 2 * n)
        found = modes(plain, n)
    return _by_table(model, found, top) if tabled else found


def _by_table(model: Model, found: Modes, top: float) -> Modes:
    """Return modes with the loss factors of their tables, which need not reach beyond the band; nan above it."""
    inside = int((found.frequency <= top).sum())
    loss = np.full(len(found), np.nan)
    if inside:
        loss[:inside] = modes(model, inside).loss_factor
    return Modes(found.frequency, loss, found.shapes, found.dofs)


def _in_band(freq: _Real, limits: tuple[float, float] | None) -> _Real:
    out = freq[_wanted(freq, limits)]
    out.flags.writeable = False
    return out


def _damping(found: Modes, limits: tuple[float, float] | None) -> _Real:
    out = 0.5 * found.loss_factor[_wanted(found.frequency, limits)]
    out.flags.writeable = False
    return out


def _wanted(freq: _Real, limits: tuple[float, float] | None) -> NDArray[np.bool_]:
    low, high = (0.0, np.inf) if limits is None else limits
    return (freq > 0) & (freq >= low) & (freq <= high)


def _pairs(
    locked: Modes, free: Modes, separation: float, limits: tuple[float, float] | None
) -> tuple[tuple[ResonancePair, ...], tuple[float, ...]]:
    """Return what the motor sees, and the locked-rotor frequencies that it does not.

    Poles and zeros of a response at the place of its force alternate (Ewins, Modal Testing, 2nd ed.
    2000, chapter 2). A neighbouring two that cancel leave the others alternating: each zero that is
    left pairs with the next pole.
    """
    zeros, poles, hidden = _seen(locked, free, separation)
    out = []
    for i in zeros:
        above = [j for j in poles if free.frequency[j] > locked.frequency[i]]
        if above and _wanted(locked.frequency[[i]], limits)[0]:
            j = above[0]
            a, r = locked.loss_factor[i] / 2, free.loss_factor[j] / 2
            out.append(
                ResonancePair(
                    float(locked.frequency[i]), float(free.frequency[j]), float(a), float(r)
                )
            )
    unseen = locked.frequency[hidden]
    return tuple(out), tuple(unseen[_wanted(unseen, limits)].tolist())


def _seen(locked: Modes, free: Modes, separation: float) -> tuple[list[int], list[int], list[int]]:
    """Return the zeros and poles that do not cancel, and the zeros that do, by position."""
    zeros, poles, hidden = list(range(len(locked))), list(range(len(free))), []
    couples = sorted(
        (
            abs(free.frequency[j] - locked.frequency[i])
            / max(locked.frequency[i], np.finfo(np.float64).tiny),
            i,
            j,
        )
        for i in zeros
        for j in poles
        if abs(free.frequency[j] - locked.frequency[i]) <= separation * locked.frequency[i]
    )
    for _, i, j in couples:
        if i in zeros and j in poles:
            zeros.remove(i)
            poles.remove(j)
            hidden.append(i)
    return zeros, poles, sorted(hidden)


def _first(
    free: Modes, locked: Modes, separation: float, limits: tuple[float, float] | None
) -> float | None:
    """Return the resonance below the first antiresonance."""
    zeros, poles, _ = _seen(locked, free, separation)
    below = [
        float(free.frequency[j])
        for j in poles
        if not zeros or free.frequency[j] < locked.frequency[zeros[0]]
    ]
    below = [f for f in below if _wanted(np.array([f]), limits)[0]]
    return below[0] if below else None


def _zero_error(model: Model, motor: str, pairs: Sequence[ResonancePair]) -> float:
    """Return how far the zeros of the computed response lie from the locked-rotor frequencies, at most."""
    if not pairs:
        return 0.0
    still = model.with_damping({name: {"loss_factor": 0.0} for name in model.groups})
    groups = {
        name: Group(g.stiffness, g.mass)
        for name, g in still.groups.items()
        if g.stiffness is not None or g.mass is not None
    }
    bare = Model(groups, model.dofs)
    zero = np.array([p.antiresonance for p in pairs])
    lines = np.unique(np.concatenate([zero * (1 - _ASIDE), zero * (1 + _ASIDE)]))
    H = response(bare, lines, [motor], [motor]).values[:, 0, 0].real
    below, above = (H[np.searchsorted(lines, zero * (1 + s))] for s in (-_ASIDE, _ASIDE))
    # The straight line through both sides gives the zero.
    return float(np.abs(_ASIDE * (below + above) / (below - above)).max())


# -- rigid-body motion and stiffness -----------------------------------------------------------------------
def _rigid_motion(free: Modes, rigid: int, at: NDArray[np.intp], sign: _Real) -> _Rigid:
    shapes = free.shapes[:, :rigid]
    here = shapes[at] * sign[:, None]
    size = np.abs(shapes).max(initial=0.0)
    if rigid == 0 or np.abs(here[0]).max() <= _STILL * size:
        which = (
            "The model has no rigid-body motion"
            if rigid == 0
            else "No rigid-body motion of the model turns the motor"
        )
        return _Rigid(
            None, None, f"{which}: inertias at the motor and gear ratio do not follow from it."
        )
    inertia = 1.0 / float(here[0] @ here[0])
    if np.abs(here[1]).max() <= _STILL * size:
        return _Rigid(
            inertia,
            None,
            "Rigid-body motion that turns the motor leaves the load at rest: no gear ratio.",
        )
    n = float(here[0] @ here[1]) / float(here[1] @ here[1])
    if np.abs(here[0] - n * here[1]).max() > 1e-6 * np.abs(here[0]).max():
        return _Rigid(
            inertia,
            None,
            f"The model has {rigid} rigid-body motions in which motor and load turn in different"
            " ratios: the gear ratio is not determined; read the motor against its housing.",
        )
    return _Rigid(inertia, n, "")


def _told(
    found: float | None, stated: float | None, notes: list[str], motor: str, load: str
) -> float | None:
    """Return the gear ratio, after a check of the stated one."""
    if found is None or stated is None:
        if stated is not None:
            notes.append(f"The ratio {stated:g} is as stated; nothing in the model checks it.")
        return found if stated is None else float(stated)
    if abs(found - stated) <= _AGREES * abs(found):
        return found
    if abs(found + stated) <= _AGREES * abs(found):
        raise ModelError(
            f"ratio {stated:g}: in the model {motor} and {load} turn in the other sense, ratio"
            f" {found:.6g}; state {-stated:g}, or turn one of the DOFs ({-Dof.parse(load)})"
        )
    raise ModelError(
        f"ratio {stated:g}: in the model {motor} turns {found:.6g} times as fast as {load}"
    )


def _stiffness(model: Model, rigid: _Real, at: NDArray[np.intp], note: str) -> _Real:
    """Return the stiffness condensed onto motor and load, shape (2, 2).

    Motions of the whole in which both rest bear no load; a statically determinate support of these
    changes nothing.
    """
    resting = rigid @ scipy.linalg.null_space(rigid[at], rcond=_STILL) if rigid.shape[1] else rigid
    supports: list[int] = []
    if resting.shape[1]:
        _, _, order = scipy.linalg.qr(resting.T, mode="economic", pivoting=True)
        supports = [int(i) for i in order[: resting.shape[1]]]
    bare = {
        name: Group(g.stiffness)
        for name, g in _held(model, supports).groups.items()
        if g.stiffness is not None
    }
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
