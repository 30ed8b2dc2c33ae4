"""Modal sensitivity: natural frequencies and mode shapes, the method of most updating programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import repeat
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from updyn.correlation import mac
from updyn.errors import DataError, OptionError, ParameterError, SolverError, suggest
from updyn.group import GROUP_QUANTITIES
from updyn.modal import ModeSet, identify_modes
from updyn.modal.sensitivity import RealModes, separated, slopes
from updyn.updating.fit.method import Fit, Method, descend_to_scale
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import Outcome, TrustRegion
from updyn.updating.problem.local import Local, joined, reduce
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.parameters import CHANNELS
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.session import Record, Stopped

__all__ = [
    "ModalError",
    "ModalMethod",
    "Pairs",
    "Target",
    "measured_rms",
]

_Vector = NDArray[np.float64]

#: Standard deviation of a frequency, assumed where there are as many unknowns as residuals.
_ASSUMED = 0.01
_ADVICE = (
    "Modes show stiffness and mass against each other: hold one, or give a prior; use more modes,"
    " or sensors that tell their shapes; or fit the FRFs with the default method, whose level shows"
    " both."
)


@dataclass(frozen=True, slots=True)
class ModalMethod(Method):
    """Frequencies and shapes of paired modes, by exact sensitivities (method ``"modal"``).

    R. L. Fox & M. P. Kapoor, AIAA J. 6 (1968) 2426 (eigenvalues); R. B. Nelson, AIAA J. 14 (1976)
    1201 (eigenvectors); J. E. Mottershead, M. Link & M. I. Friswell, "The sensitivity method in
    finite element model updating: a tutorial", Mech. Syst. Signal Process. 25 (2011) 2275-2296
    (residuals, weights, pairing). Modes of the undamped model are paired with the measured ones by
    MAC anew in every step; the step is safeguarded by a trust region and bounds.

    It uses the modes alone: no damping, no data between resonances, no level of the FRFs.
    Stiffness and mass that grow together change neither frequencies nor shapes.

    Parameters
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which it has converged.
    n_modes : int
        How many of the measured modes to use, lowest first; 0: all.
    shapes : bool
        Whether shapes are fitted beside frequencies. They decide on the pairs in any case.
    shape_weight : float
        What a shape that is off by a share of its rms counts for, against a frequency that is off
        by that share. By default shapes are taken as ten times less accurate (Friswell &
        Mottershead, Finite Element Model Updating in Structural Dynamics, 1995: frequencies to 1 %,
        shapes to 10 %).
    mac : float
        Measured modes that resemble no mode of the model by this MAC are left out. The fit begins
        with those that do at the start; where it ends others may, and it goes on with these too.
    modes : ModeSet, or mapping of str to ModeSet, optional
        Measured modes; of several tests by their names. None: identified from the FRFs
        (`updyn.identify_modes`).
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    n_modes: int = 0
    shapes: bool = True
    shape_weight: float = 0.1
    mac: float = 0.8
    modes: ModeSet | Mapping[str, ModeSet] | None = None

    name: ClassVar[str] = "modal"
    reference: ClassVar[str] = "Fox & Kapoor 1968, Nelson 1976"
    needs: ClassVar[str] = "modes that can be told apart"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' holds near the lines that were measured, and 'modal' computes modes; use"
        " tier 'sparse'"
    )
    cannot: ClassVar[tuple[str, ...]] = (
        *(q for q in GROUP_QUANTITIES if q not in ("stiffness", "mass")),
        *CHANNELS,
    )

    def __post_init__(self) -> None:
        if self.shapes and not self.shape_weight > 0:
            raise OptionError(
                "option shape_weight = 0: expected a number above 0; shapes=False leaves shapes"
                " out",
                key=("shape_weight",),
            )
        if self.mac > 1.0:
            raise OptionError(
                f"option mac = {self.mac:g}: expected a number from 0 to 1", key=("mac",)
            )
        given = self.modes.values() if isinstance(self.modes, Mapping) else [self.modes]
        for one in given:
            if one is not None and not isinstance(one, ModeSet):
                raise OptionError(
                    f"option modes: expected a ModeSet, found {type(one).__name__}; read one with"
                    " updyn.read_modes, or name the file in a job: [test] modes",
                    key=("modes",),
                )

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: _Vector
    ) -> Fit:
        """Fit the unknowns from x; how exact the modes are is taken from the residual.

        Raises
        ------
        ParameterError
            If an unknown is damping, or a calibration factor.
        DataError
            If no mode is measured, or none resembles a mode of the model.
        OptionError
            If modes are given for tests that are not there.
        SolverError
            If modes cannot be computed at x, or two of those that are paired there coincide.
        """
        self._check_unknowns(problem)
        self._check_names([part.name for part in problem.parts])
        with monitor.stage(self.name):
            try:
                measured = [Target.of(part, self._measured(part)) for part in problem.parts]
                outcome, residual, kept = self._in_rounds(problem, measured, x, monitor)
                x = outcome.x
                local = residual.solved(problem, x)
                left = measured_rms(problem.parts, residual.targets, x)
            except Stopped:
                return Fit.blind(x, "stopped")
        sigma = _spread(local, residual.count, problem.n)
        common = {
            "kind": "spread of the modal residuals",
            **left,
            "chi_square": 1.0,
            "inflation": 1.0,
        }
        records, missing = [], []
        for target, like in zip(measured, kept, strict=True):
            text = _shown(target, ~like)
            if text:
                missing.append(text)
                records.append({**common, "left_out": text})
            else:
                records.append(common)
        note = ""
        if missing:
            said = ", ".join(missing)
            note = f"Measured modes that resemble none of the model are left out: {said}."
        if left["lowest_mac"] < self.mac:
            note += (
                f" A mode is paired with MAC {left['lowest_mac']:.2f}: the pairing may be wrong."
            )
        unit = sigma if sigma > 0 else 1.0
        return Fit(
            outcome.x,
            outcome.reason,
            local.R / unit,
            tuple(records),
            note.strip(),
            advice=_ADVICE,
        )

    def _check_unknowns(self, problem: Problem) -> None:
        unseen = []
        for p in problem.coordinates.parameters:
            if any(d.quantity in self.cannot for d in p.acts_on):
                unseen.append(p.name)
        if unseen:
            shown = ", ".join(unseen[:4])
            if len(unseen) > 4:
                shown += f" and {len(unseen) - 4} more"
            raise ParameterError(
                "method 'modal': real modes show neither damping nor the level of a channel"
                f" ({shown}); leave these unknowns out, or use a method that fits the FRFs, such as"
                " the default"
            )

    def _check_names(self, names: Sequence[str]) -> None:
        if isinstance(self.modes, ModeSet) and len(names) > 1:
            raise OptionError(
                "option modes: there are several tests; give modes by the name of the test",
                key=("modes",),
            )
        if not isinstance(self.modes, Mapping):
            return
        for name in self.modes:
            if name not in names:
                raise OptionError(
                    f"option modes: no test {name!r}; {suggest(str(name), names)}", key=("modes",)
                )

    def _measured(self, part: Part) -> ModeSet:
        given = self.modes
        if isinstance(given, Mapping):
            given = given.get(part.name)
        if given is None:
            # A viscous matrix has the rate 1, Rayleigh damping its coefficient.
            viscous = bool(part.solver.system.start.rate.any())
            given = identify_modes(part.frf, damping="viscous" if viscous else "structural")
        return given.select(range(min(self.n_modes or len(given), len(given))))

    def _in_rounds(
        self, problem: Problem, measured: Sequence[Target], x: _Vector, monitor: Monitor
    ) -> tuple[Outcome, ModalError, list[NDArray[np.bool_]]]:
        """Fit the modes that pair, and again with those that pair where the fit ends."""
        left = self.max_iterations
        kept = [np.zeros(len(target.value), dtype=np.bool_) for target in measured]
        found: tuple[Outcome, ModalError] | None = None
        while True:
            pairs = list(map(Pairs.at, problem.parts, measured, repeat(x)))
            like = [k | (own.mac >= self.mac) for k, own in zip(kept, pairs, strict=True)]
            if found is None:
                _check_any(like, pairs, measured, self.mac)
            elif all(map(np.array_equal, like, kept)):
                return *found, kept
            kept = like
            targets = tuple(map(Target.keep, measured, kept))
            residual = ModalError(targets, self.shape_weight if self.shapes else 0.0)
            residual.solved(problem, x)  # a start without derivatives is said with its frequency
            before = len(monitor.history)
            settings = TrustRegion(max(left, 0), self.tolerance)
            spread = partial(_spread, count=residual.count, n=problem.n)
            outcome = descend_to_scale(problem, residual, x, monitor, settings, spread)
            left -= len(monitor.history) - before
            x = outcome.x
            found = outcome, residual
            if outcome.reason in ("stopped", "max-iterations"):
                return *found, kept


def _check_any(
    like: Sequence[NDArray[np.bool_]],
    pairs: Sequence[Pairs],
    measured: Sequence[Target],
    mac: float,
) -> None:
    if any(k.any() for k in like):
        return
    best, target = max(zip(pairs, measured, strict=True), key=lambda both: float(both[0].mac.max()))
    frequency = float(np.sqrt(target.value[np.argmax(best.mac)])) / (2.0 * np.pi)
    raise DataError(
        "modal: no measured mode resembles a mode of the model at its start: the largest MAC is"
        f" {best.mac.max():.2f}, at {frequency:.4g} Hz (expected {mac:g})"
    )


def _shown(target: Target, which: NDArray[np.bool_]) -> str:
    """Return the frequencies of some modes; empty where there are none."""
    found = np.sqrt(target.value[which]) / (2.0 * np.pi)
    if not len(found):
        return ""
    return ", ".join(f"{f:.4g}" for f in found) + " Hz"


def _spread(local: Local, count: int, n: int) -> float:
    """Return the standard deviation of a frequency: sqrt(2 cost / (count - n)), else `_ASSUMED`."""
    if count <= n:
        return _ASSUMED
    return float(np.sqrt(2.0 * local.cost / (count - n)))


_Real = NDArray[np.float64]

#: What a factor e between two frequencies costs in the pairing, in MAC: it breaks ties where
#: sensors are few.
_APART = 0.5
#: Modes are computed up to this multiple of the highest measured frequency.
_BEYOND = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The measured modes of one test, brought to the DOFs of the model.

    Attributes
    ----------
    value : ndarray of float, shape (m,)
        Measured eigenvalues omega^2 in 1/s2.
    shapes : ndarray of float, shape (k, m)
        Measured shapes, times `weight`, of unit length.
    rows : ndarray of int, shape (k,)
        DOFs of the model.
    weight : ndarray of float, shape (k,)
        Sign of each sensor over the level of all modes at sensors of its unit (translation or
        rotation).
    digest : str
        Part of the cache key.
    """

    value: _Real
    shapes: _Real
    rows: NDArray[np.intp]
    weight: _Real
    digest: str

    @classmethod
    def of(cls, part: Part, modes: ModeSet) -> Target:
        """Bring modes to the DOFs of a part's model.

        Raises
        ------
        DofError
            If a DOF of the modes is not in the model.
        DataError
            If a measured mode has the frequency 0.
        """
        match = part.solver.system.dofs.match(modes.dofs, "DOF of the modes")
        if (modes.frequency == 0).any():
            raise DataError(
                "modal: a measured mode at 0 Hz, a rigid-body motion, says nothing; leave it out"
            )
        rotates = modes.dofs.axes >= 3
        level = np.ones(len(rotates))
        for kind in (rotates, ~rotates):
            if kind.any():
                rms = float(np.sqrt(np.mean(modes.real_shapes[kind] ** 2)))
                level[kind] = rms if rms > 0 else 1.0
        weighted = modes.real_shapes / level[:, None]
        unit = weighted / np.linalg.norm(weighted, axis=0)
        value = (2.0 * np.pi * modes.frequency) ** 2
        return cls(value, unit, match.index, match.sign / level, modes.digest)

    def keep(self, which: NDArray[np.bool_]) -> Target:
        """Return it with some of its modes."""
        chosen = "".join(map(str, which.astype(int)))
        return replace(
            self,
            value=self.value[which],
            shapes=self.shapes[:, which],
            digest=f"{self.digest}/{chosen}",
        )

    def seen(self, shapes: _Real) -> _Real:
        """Return shapes of the model as the sensors see them, shape (k, n)."""
        return np.asarray(shapes[self.rows] * self.weight[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Modes of the model that are paired with the measured ones.

    Attributes
    ----------
    modes : RealModes
        Of the model.
    which : ndarray of int, shape (m,)
        Its modes.
    mac : ndarray of float, shape (m,)
        MAC of each pair.
    """

    modes: RealModes
    which: NDArray[np.intp]
    mac: _Real

    @classmethod
    def at(cls, part: Part, target: Target, x: _Real) -> Pairs:
        """Compute the model's modes at x and pair them.

        One to one, with the largest sum of MAC less half the logarithm of the ratio of frequencies
        (Hungarian assignment; Kuhn 1955).

        Raises
        ------
        SolverError
            If the modes cannot be computed.
        DataError
            If the model has fewer.
        """
        highest = _BEYOND * float(np.sqrt(target.value[-1])) / (2.0 * np.pi)
        modes = RealModes.lowest(part.solver.system, part.state(x), len(target.value), highest)
        if len(modes.value) < len(target.value):
            raise DataError(
                f"modal: {len(target.value)} modes were measured; besides rigid-body motions the"
                f" model has {len(modes.value)}. Give n_modes, or fewer modes"
            )
        about = part.solver.system, part.unknowns, part.values(x)
        modes = separated(modes, *about, target.seen, target.shapes)
        seen = target.seen(modes.shapes)
        moving = np.linalg.norm(seen, axis=0) > 0
        macs = np.zeros((seen.shape[1], len(target.value)))
        macs[moving] = mac(seen[:, moving], target.shapes)
        apart = np.abs(np.log(modes.value[:, None] / target.value)) / 2.0
        first, second = linear_sum_assignment(macs - _APART * apart, maximize=True)
        which = first[np.argsort(second)]
        return cls(modes, which, macs[which, np.arange(len(which))])


@dataclass(frozen=True, slots=True, eq=False)
class ModalError:
    """r = ln(f_A / f_X) of each pair of modes, and the difference of their shapes.

    The shape of the model is brought to the length of the measured one by the modal scale factor;
    the difference is a share of the rms of the measured shape, times `shape_weight`.

    Parameters
    ----------
    targets : tuple of Target
        The measured modes of each test.
    shape_weight : float
        What a difference of shapes counts for against one of frequencies; 0: frequencies alone.
    name : str
        How the report calls it.
    """

    targets: tuple[Target, ...]
    shape_weight: float
    name: str = "modal"

    @property
    def count(self) -> int:
        """Number of independent residuals; k - 1 of a shape with k sensors (its length is free)."""
        total = 0
        for target in self.targets:
            by_mode = len(target.rows) if self.shape_weight else 1
            total += len(target.value) * by_mode
        return total

    def local(self, problem: Problem, x: _Real) -> Local | None:
        """Return the reduced problem at x, or None where modes cannot be computed."""
        try:
            return self.solved(problem, x)
        except SolverError:
            return None

    def solved(self, problem: Problem, x: _Real) -> Local:
        """Return the reduced problem at x.

        Raises
        ------
        SolverError
            If the modes of a part, or their derivatives, cannot be computed.
        """
        return joined(list(map(self._part, problem.parts, self.targets, repeat(x))), problem.n)

    def _part(self, part: Part, target: Target, x: _Real) -> Local:
        if not len(target.value):  # all left out
            return Local(0.0, np.zeros((part.n, part.n)), np.zeros(part.n))

        def compute() -> Record:
            local = reduce([np.hstack(self._rows(part, target, x))], part.n)
            return np.array(local.cost), local.R, local.q

        cost, R, q = part.recall("ModalError", x, compute, target.digest, str(self.shape_weight))
        return Local(float(cost), R, q)

    def _rows(self, part: Part, target: Target, x: _Real) -> tuple[_Real, _Real]:
        """Return the Jacobian by x, shape (r, n), and the residuals, shape (r, 1)."""
        pairs = Pairs.at(part, target, x)
        values, slope = part.values(x), part.coordinates.slope(x)
        with_shapes = self.shape_weight > 0 and len(target.rows) > 1
        J, r = [], []
        for k, which in enumerate(pairs.which):
            part.session.check()
            value, shape = slopes(
                pairs.modes,
                int(which),
                part.solver.system,
                part.unknowns,
                values,
                target.rows if with_shapes else None,
            )
            own = float(pairs.modes.value[which])
            J.append(0.5 * (value * slope / own)[None, :])
            r.append(np.array([0.5 * np.log(own / target.value[k])]))
            if with_shapes:
                seen = target.seen(pairs.modes.shapes[:, [which]])[:, 0]
                moved = (shape * target.weight).T * slope
                r_shape, J_shape = _difference(seen, moved, target.shapes[:, k])
                weight = self.shape_weight * np.sqrt(len(seen))
                J.append(weight * J_shape)
                r.append(weight * r_shape)
        return np.vstack(J), np.concatenate(r)[:, None]


def _difference(seen: _Real, moved: _Real, measured: _Real) -> tuple[_Real, _Real]:
    """Return u (u^T psi) - psi and its derivatives, shapes (k,) and (k, n), with u = phi / |phi|.

    The factor is the modal scale factor of unit shapes (Allemang & Brown 1982); the squared length
    is 1 - MAC.
    """
    length = float(np.linalg.norm(seen))
    if length == 0.0:
        return -measured, np.zeros_like(moved)
    u = seen / length
    du = (moved - np.outer(u, u @ moved)) / length
    factor = float(u @ measured)
    return u * factor - measured, du * factor + np.outer(u, measured @ du)


def measured_rms(problems: Sequence[Part], targets: Sequence[Target], x: _Real) -> dict[str, float]:
    """Return the record of the residuals of frequencies and shapes, and of the lowest MAC."""
    off, found = [], []
    for problem, target in zip(problems, targets, strict=True):
        if len(target.value):
            pairs = Pairs.at(problem, target, x)
            off.append(0.5 * np.log(pairs.modes.value[pairs.which] / target.value))
            found.append(pairs.mac)
    macs = np.concatenate(found)
    return {
        "modes": float(len(macs)),
        "frequency_rms": float(np.sqrt(np.mean(np.concatenate(off) ** 2))),
        "shape_rms": float(np.sqrt(np.mean(1.0 - macs))),
        "lowest_mac": float(macs.min()),
    }
