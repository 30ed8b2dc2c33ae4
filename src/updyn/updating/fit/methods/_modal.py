"""The residual of the modal sensitivity method: frequencies and shapes of paired modes, and their exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from updyn.correlation import mac
from updyn.errors import DataError, SolverError
from updyn.modal import ModeSet
from updyn.modal.sensitivity import RealModes, separated, slopes
from updyn.updating.fit.trust_region import Local
from updyn.updating.problem.joint import Task
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import joined, reduce
from updyn.updating.problem.session import Record

__all__ = ["ModalError", "Pairs", "Target", "measured_rms"]

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
        What tells it from others.
    """

    value: _Real
    shapes: _Real
    rows: NDArray[np.intp]
    weight: _Real
    digest: str

    @classmethod
    def of(cls, problem: Problem, modes: ModeSet) -> Target:
        """Bring modes to the DOFs of a problem's model.

        Raises
        ------
        DofError
            If a DOF of the modes is not in the model.
        DataError
            If a measured mode has the frequency 0.
        """
        match = problem.solver.system.dofs.match(modes.dofs, "DOF of the modes")
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
        chosen = "".join("1" if k else "0" for k in which)
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
    """Which mode of the model each measured one is taken for.

    Attributes
    ----------
    modes : RealModes
        Of the model.
    which : ndarray of int, shape (m,)
        Its modes.
    mac : ndarray of float, shape (m,)
        How alike each pair is.
    """

    modes: RealModes
    which: NDArray[np.intp]
    mac: _Real

    @classmethod
    def at(cls, problem: Problem, target: Target, x: _Real) -> Pairs:
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
        modes = RealModes.lowest(
            problem.solver.system, problem.state(x), len(target.value), highest
        )
        if len(modes.value) < len(target.value):
            raise DataError(
                f"modal: {len(target.value)} modes were measured; besides rigid-body motions the"
                f" model has {len(modes.value)}. Give n_modes, or fewer modes"
            )
        about = problem.solver.system, problem.unknowns, problem.values(x)
        modes = separated(modes, *about, target.seen, target.shapes)
        seen = target.seen(modes.shapes)
        moving = np.linalg.norm(seen, axis=0) > 0
        alike = np.zeros((seen.shape[1], len(target.value)))
        alike[moving] = mac(seen[:, moving], target.shapes)
        apart = np.abs(np.log(modes.value[:, None] / target.value)) / 2.0
        first, second = linear_sum_assignment(alike - _APART * apart, maximize=True)
        which = first[np.argsort(second)]
        return cls(modes, which, alike[which, np.arange(len(which))])


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
        """Number of independent residuals: of a shape with k sensors k - 1, as its length is free."""
        shapes = [t.shapes.shape[0] - 1 if self.shape_weight else 0 for t in self.targets]
        return sum(len(t.value) * (1 + s) for t, s in zip(self.targets, shapes, strict=True))

    def local(self, problem: Task, x: _Real) -> Local | None:
        """Return the reduced problem at x, or None where modes or their derivatives cannot be computed."""
        try:
            return self.solved(problem, x)
        except SolverError:
            return None

    def solved(self, problem: Task, x: _Real) -> Local:
        """Return the reduced problem at x.

        Raises
        ------
        SolverError
            If the modes of a part, or their derivatives, cannot be computed.
        """
        parts = zip(problem.parts, self.targets, strict=True)
        return joined([self._part(part, target, x) for part, target in parts], problem.n)

    def _part(self, problem: Problem, target: Target, x: _Real) -> Local:
        if not len(target.value):  # all left out
            return Local(0.0, np.zeros((problem.n, problem.n)), np.zeros(problem.n))

        def compute() -> Record:
            local = reduce([np.hstack(self._rows(problem, target, x))], problem.n)
            return np.array(local.cost), local.R, local.q

        cost, R, q = problem.recall("ModalError", x, compute, target.digest, str(self.shape_weight))
        return Local(float(cost), R, q)

    def _rows(self, problem: Problem, target: Target, x: _Real) -> tuple[_Real, _Real]:
        """Return the Jacobian by x, shape (r, n), and the residuals, shape (r, 1)."""
        pairs = Pairs.at(problem, target, x)
        values, slope = problem.values(x), problem.coordinates.slope(x)
        with_shapes = self.shape_weight > 0 and len(target.rows) > 1
        J, r = [], []
        for k, which in enumerate(pairs.which):
            problem.session.check()
            value, shape = slopes(
                pairs.modes,
                int(which),
                problem.solver.system,
                problem.unknowns,
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


def measured_rms(
    problems: Sequence[Problem], targets: Sequence[Target], x: _Real
) -> dict[str, float]:
    """Return, for the record, what is left of frequencies and shapes, and the least alike pair."""
    found = [
        (Pairs.at(p, target, x), target)
        for p, target in zip(problems, targets, strict=True)
        if len(target.value)
    ]
    off = [0.5 * np.log(pairs.modes.value[pairs.which] / target.value) for pairs, target in found]
    alike = np.concatenate([pairs.mac for pairs, _ in found])
    return {
        "modes": float(len(alike)),
        "frequency_rms": float(np.sqrt(np.mean(np.concatenate(off) ** 2))),
        "shape_rms": float(np.sqrt(np.mean(1.0 - alike))),
        "lowest_mac": float(alike.min()),
    }
