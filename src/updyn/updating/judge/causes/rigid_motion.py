"""Comparison of measured motions with rigid-body motion, at lines below the elastic modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dofs import Dof
from updyn.frf import FRF
from updyn.updating.judge.causes.labels import list_unsigned_labels
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, CAUSE_ODDS, CAUSE_SEARCH, RIGID_BODY
from updyn.updating.problem.noise.neighbours import estimate_scatter

__all__ = ["RigidMotion", "RowMask", "pseudo_inverse"]

RowMask: TypeAlias = BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """Accelerances of the sensors without elastic deformation, and the rigid-body shapes there.

    Of a free structure, also on soft springs, the accelerance is R q(omega) + omega^2 e(omega),
    with e nearly constant below the elastic modes. The intercept of a straight line over omega^2 is
    therefore in the span of R, for any mass, stiffness and damping.
    """

    #: Accelerances at the lines in use.
    data: FRF
    #: Rigid-body shapes of the model.
    rigid: RigidShapes
    #: DOFs of the sensors without signs.
    sensors: tuple[Dof, ...]
    #: R at the sensors, shape (n, r).
    shapes: RealArray
    #: R in the three directions of their nodes, shape (n, 3, r); 0 where the model has none.
    around: RealArray
    #: Intercepts, shape (n, m), by sensor and reference.
    values: ComplexArray
    #: Their variance by the noise of the lines, shape (n, m).
    noise: RealArray
    #: Residual of the straight lines, shape (n_f, n, m).
    remainder: ComplexArray
    #: Mean square of the remainder due to noise, shape (n, m).
    white: RealArray

    @classmethod
    def of(cls, frf: FRF, rigid: RigidShapes) -> RigidMotion | None:
        """Return the motion; None with too few lines or too few sensors."""
        bands = [[share * rigid.elastic for share in band] for band in RIGID_BODY.bands]
        found = [cls._within(low, high, frf, rigid) for low, high in bands]
        usable = [one for one in found if one is not None]
        smooth = [one for one in usable if one.uncertainty <= RIGID_BODY.position_std]
        return smooth[0] if smooth else min(usable, key=lambda one: one.uncertainty, default=None)

    @classmethod
    def _within(cls, low: float, high: float, frf: FRF, rigid: RigidShapes) -> RigidMotion | None:
        freq = frf.freq[(frf.freq > low) & (frf.freq <= high)]
        if len(freq) < RIGID_BODY.least_lines:
            return None
        data = frf.select(lines=freq).converted("accelerance")
        at = tuple(Dof.parse(label) for label in list_unsigned_labels(data.responses))
        sign = data.responses.signs[:, None]
        variance = estimate_scatter(data)
        if data.variance is not None:
            variance = np.maximum(variance, data.variance)
        X = np.stack([np.ones(len(freq)), (freq / freq[-1]) ** 2], axis=1)
        lines = np.linalg.lstsq(X, np.eye(len(freq)), rcond=None)[0]
        fitted = np.tensordot(lines, data.values, axes=1)
        curved = (data.values - np.tensordot(X, fitted, axes=1)) * sign
        noise = np.tensordot(lines[0] ** 2, variance, axes=1)
        R = rigid.at(at)
        if len(at) <= np.linalg.matrix_rank(R):
            return None
        values, white = fitted[0] * sign, variance.mean(axis=0)
        return cls(data, rigid, at, R, rigid.around(at), values, noise, curved, white)

    def deviations(self, rows: RowMask) -> RealArray:
        """Return the largest deviation of each sensor in standard deviations, shape (n,).

        Only the part that the other `rows` do not share; 0 for a sensor without comparison.
        """
        return self._compare(rows)[0]

    def _compare(self, rows: RowMask) -> tuple[RealArray, float]:
        """Return the deviations, and the sum of squares for the worst reference."""
        out, found = np.zeros(len(self.sensors)), np.zeros(int(rows.sum()))
        power = 0.0
        for j, std in enumerate(self.standard_deviation(rows).T):
            P = _outside(self.shapes[rows] / std[rows, None])
            own = np.sqrt(np.maximum(np.diag(P), 0.0))
            size = np.abs(P @ (self.values[rows, j] / std[rows]))
            judged = own**2 > RIGID_BODY.least_judged
            found[judged] = np.maximum(found[judged], size[judged] / own[judged])
            power = max(power, float(size @ size))
        out[rows] = found
        return out, power

    def find_wrong(self) -> list[tuple[int, ...]]:
        """Return the likeliest sets of wrong sensors: the others follow rigid-body motion."""
        # There are several if the data do not distinguish them. Empty if no sensor is wrong, or
        # more than three or than half of the redundant ones are.
        deviations = self.deviations(self.leave_out([]))
        if deviations.max() <= RIGID_BODY.wrong_stds:
            return []
        order = np.argsort(-deviations)[: RIGID_BODY.most_examined].tolist()
        spare = len(self.sensors) - int(np.linalg.matrix_rank(self.shapes))
        costs: dict[tuple[int, ...], float] = {}
        for size in range(1, min(CAUSE_SEARCH.most_faults, max(spare // 2, 1)) + 1):
            if size == CAUSE_SEARCH.most_faults and costs:
                break
            for one in combinations(order, size):
                misfit = self._misfit(one)
                if misfit is not None:
                    costs[one] = misfit + size * RIGID_BODY.sensor_cost
        least = min(costs.values(), default=0.0)
        return [
            one for one, cost in costs.items() if cost <= least + CAUSE_ODDS.indistinct_log_odds
        ]

    def _misfit(self, left_out: Sequence[int]) -> float | None:
        """Return the sum of squares of the other sensors; None if one does not follow the rest."""
        deviations, power = self._compare(self.leave_out(left_out))
        return power if deviations.max() <= RIGID_BODY.wrong_stds else None

    def leave_out(self, left_out: Sequence[int]) -> RowMask:
        """Return which sensors are left, shape (n,)."""
        rows = np.ones(len(self.sensors), dtype=np.bool_)
        rows[list(left_out)] = False
        return rows

    def list_unchecked(self) -> list[str]:
        """Return the sensors that cannot be compared with the others."""
        own = np.diag(_outside(self.shapes / self._level(self.leave_out([]))[:, :1]))
        unchecked = own <= RIGID_BODY.least_judged
        return [str(dof) for dof, one in zip(self.sensors, unchecked, strict=True) if one]

    def measure_difference(self, i: int, wrong: Sequence[int]) -> float:
        """Return the largest difference of a sensor from the motion of the others over the rms."""
        rows = self.leave_out(wrong)
        level = self._level(rows)[i]
        R = self.shapes[rows]
        motion = self.shapes[i] @ pseudo_inverse(R) @ self.values[rows]
        return float(np.max(np.abs(self.values[i] - motion) / level))

    def _level(self, rows: RowMask) -> RealArray:
        """Return the rms over those of some sensors with the same unit, shape (n, m)."""
        turning = np.array([dof.direction.startswith("R") for dof in self.sensors])
        level = np.zeros(self.values.shape)
        for unit in (turning, ~turning):
            if (unit & rows).any():
                level[unit] = np.sqrt(np.mean(np.abs(self.values[unit & rows]) ** 2, axis=0))
        return level + 1e-9 * level.max() + np.finfo(float).tiny ** 0.5

    @property
    def uncertainty(self) -> float:
        """Standard deviation by noise and elastic motion, relative to the rms of the values."""
        every = self.leave_out([])
        power = np.mean(
            (self.noise + self._measure_elastic(every)) / self._level(every) ** 2, axis=0
        )
        return float(np.sqrt(np.max(power)))

    def standard_deviation(self, rows: RowMask) -> RealArray:
        """Return the standard deviation of the values if the sensors are sound, shape (n, m)."""
        level = self._level(rows)
        local = np.zeros(level.shape)
        for j, scale in enumerate(level.T):
            fit = pseudo_inverse(self.shapes[rows] / scale[rows, None])
            moved = self.around @ (fit @ (self.values[rows, j] / scale[rows]))
            local[:, j] = np.linalg.norm(moved, axis=1)
        usual = (RIGID_BODY.sensor_std * local) ** 2 + (RIGID_BODY.position_std * level) ** 2
        return np.sqrt(usual + self.noise + self._measure_elastic(rows))

    def _measure_elastic(self, rows: RowMask) -> RealArray:
        """Return the mean square of the remainder that is neither rigid nor noise, shape (n, m)."""
        level, n = self._level(rows), len(self.remainder)
        out = np.zeros(level.shape)
        for j, scale in enumerate(level[rows].T):
            P = _outside(self.shapes[rows] / scale[:, None])
            left = (P @ (self.remainder[:, rows, j] / scale).T) * scale[:, None]
            share = np.maximum(np.diag(P), RIGID_BODY.least_judged) * (n - 2) / n
            out[rows, j] = np.mean(np.abs(left) ** 2, axis=1) / share
        return np.maximum(out - self.white, 0.0)


def pseudo_inverse(R: RealArray) -> RealArray:
    """Return the pseudo-inverse of rigid-body shapes at sensors, shape (r, n)."""
    U, s, Vt = _decompose(R)
    return np.asarray((Vt.T / s) @ U.T)


def _outside(R: RealArray) -> RealArray:
    """Return the projection onto the complement of the columns of R, shape (n, n)."""
    U = _decompose(R)[0]
    return np.asarray(np.eye(len(R)) - U @ U.T)


def _decompose(R: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return the singular value decomposition without zero singular values."""
    U, s, Vt = np.linalg.svd(R, full_matrices=False)
    kept = s > CAUSE_MISFIT.dependent_share * s.max(initial=0.0)
    return U[:, kept], s[kept], Vt[kept]
