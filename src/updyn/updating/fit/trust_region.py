"""Nonlinear least squares with bounds: a trust region on the reduced Jacobian.

Each point is represented by the triangle R of the QR factors of the stacked, weighted Jacobian, and
the projected residual q; a step minimises |R p + q| in a ball, without the normal equations (More
1978, "The Levenberg-Marquardt algorithm"; Nocedal & Wright 2006, chapters 4 and 10).

If the size of the noise is known, an undetermined combination of unknowns keeps its value while
its best value is less than two standard deviations away: along such a curved valley a hundred short
steps gain nothing significant. The iteration ends when a full Gauss-Newton step would gain no more
than a given decrease (relative offset criterion of Bates & Watts, Technometrics 23 (1981) 179). For
large residuals see `_Curvature`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from updyn.arrays import BoolArray, RealArray
from updyn.updating.fit.settings import CURVATURE, NULL_SPACE, TRUST_REGION
from updyn.updating.problem.local import Local
from updyn.updating.problem.session import Stopped

__all__ = [
    "Outcome",
    "Step",
    "TrustRegion",
]


def _zero_std(local: Local) -> float:
    return 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Trial step, as passed to the observer; `local` is None if not evaluated."""

    x: RealArray
    local: Local | None
    length: float
    accepted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """End of the iteration: its best point and the local problem there.

    `reason` is ``"converged"``, ``"stalled"``, ``"unsolvable"`` (the model cannot be solved next to
    x), ``"max-iterations"`` or ``"stopped"``; `radius` is the next trust radius if steps ran out.
    """

    x: RealArray
    local: Local
    reason: str
    radius: float = np.inf


@dataclass(frozen=True, slots=True)
class TrustRegion:
    """Settings of the iteration.

    Converged if a step and the predicted decrease of the cost are below `tolerance`, relative, or
    the linear model predicts no larger decrease than `min_decrease` or `min_relative_decrease` for
    a step of any length. The first `radius` is in the units of x. `noise` returns the standard
    deviation of the residuals of a local problem; 0 if it is not known.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    radius: float = 0.5
    min_decrease: float = 0.0
    min_relative_decrease: float = 0.0
    noise: Callable[[Local], float] = _zero_std

    @property
    def _share(self) -> float:
        return max(self.tolerance**2, self.min_relative_decrease)

    def minimise(
        self,
        evaluate: Callable[[RealArray], Local | None],
        x: RealArray,
        lower: RealArray,
        upper: RealArray,
        observe: Callable[[Step], bool] | None = None,
        within: RealArray | None = None,
    ) -> Outcome:
        """Minimise from `x`, at which the model must be solvable, within the bounds.

        `evaluate` returns None if the model cannot be solved; if it raises `Stopped` after the
        start, the iteration ends at its best point. `observe` stops it by returning True. `within`,
        shape (n, k), are orthonormal directions in whose span the iteration stays.
        """
        current = evaluate(x)
        if current is None:
            raise ArithmeticError("the start cannot be evaluated")
        radius = self.radius
        curvature = _Curvature.zero(len(x))
        for _ in range(self.max_iterations):
            noise = self.noise(current)
            curved = curvature.is_used
            model = curvature.add_to(current) if curved else current
            p, decrease, limited = _step(model, x, lower, upper, radius, within, noise)
            length = float(np.abs(p).max(initial=0.0))
            # If the radius limits the step, its decrease does not measure the distance to the
            # minimum.
            remaining = decrease
            if limited or curved:
                remaining = _step(current, x, lower, upper, np.inf, within, noise)[1]
            has_no_step = length == 0.0 or decrease <= 0.0
            if remaining <= max(self.min_decrease, self._share * current.cost) or (
                has_no_step and not curved
            ):
                return Outcome(x, current, "converged")
            if has_no_step:
                curvature = _Curvature.zero(len(x))
                continue
            # Steps shortened by the learnt curvature alone must not look like convergence.
            near = (
                not curved
                or remaining <= max(TRUST_REGION.minimum_share, self._share) * current.cost
            )
            trial = np.clip(x + p, lower, upper)
            try:
                proposed = evaluate(trial)
            except Stopped:
                return Outcome(x, current, "stopped")
            gain = -1.0
            if proposed is not None and np.isfinite(proposed.cost):
                gain = (current.cost - proposed.cost) / decrease
            accepted = gain > 1e-4
            if proposed is not None and np.isfinite(proposed.cost):
                curvature = curvature.update(trial - x, current, proposed, accepted=accepted)
            stop = observe is not None and observe(Step(trial, proposed, length, accepted))
            size = float(np.linalg.norm(p))
            if accepted and proposed is not None:
                small = (
                    length <= self.tolerance
                    or current.cost - proposed.cost <= self._share * current.cost
                )
                x, current = trial, proposed
                if gain > 0.75:
                    radius = max(radius, 2.0 * size)
                elif gain <= 0.25:
                    radius = 0.5 * size
                if small and gain > 0.25 and not limited and near:
                    return Outcome(x, current, "converged")
            elif length <= TRUST_REGION.step_rounding and not near:
                curvature = _Curvature.zero(len(x))
            else:
                # A full Gauss-Newton step this small without a gain: the rest is rounding.
                if length <= TRUST_REGION.step_rounding and not limited:
                    # If the costs agree to rounding, the remaining predicted decrease decides
                    # between the two points.
                    if proposed is not None and proposed.cost <= current.cost * (1.0 + 1e-12):
                        remaining = _step(proposed, trial, lower, upper, radius, within, noise)[1]
                        if remaining < decrease:
                            x, current = trial, proposed
                    return Outcome(x, current, "converged")
                radius = 0.25 * size
                if length <= self.tolerance:
                    if proposed is None:
                        return Outcome(x, current, "unsolvable")
                    full_step = _step(current, x, lower, upper, np.inf, within, noise)[0]
                    is_minimum = (
                        decrease <= TRUST_REGION.minimum_share * current.cost
                        or np.abs(full_step).max(initial=0.0) <= 10.0 * TRUST_REGION.step_rounding
                    )
                    return Outcome(x, current, "converged" if is_minimum else "stalled")
            if stop:
                return Outcome(x, current, "stopped")
        return Outcome(x, current, "max-iterations", radius)


@dataclass(frozen=True, slots=True, eq=False)
class _Curvature:
    """Second derivatives S, shape (n, n), of the cost that the Gauss-Newton model J^T J lacks.

    S is learnt from the change of the gradient along each step by updates of rank one (structured
    secant method: Dennis, Gay & Welsch, ACM Trans. Math. Softw. 7 (1981) 348; the update: Conn,
    Gould & Toint, Math. Program. 50 (1991) 177). It is used after a short step whose gain it
    predicts better and which hardly lowers the cost (Fletcher & Xu, IMA J. Numer. Anal. 7 (1987)
    371).
    """

    S: RealArray
    is_used: bool = False

    @classmethod
    def zero(cls, n: int) -> _Curvature:
        """Return the curvature before any update, S = 0."""
        return cls(np.zeros((n, n)))

    def add_to(self, current: Local) -> Local:
        """Return a local problem with the second derivatives |J^T J + S|, and the same gradient."""
        # Negative eigenvalues are replaced by their absolute values.
        norms = np.linalg.norm(current.R, axis=0)
        scale = np.where(norms > 0.0, norms, 1.0)
        size, V = np.linalg.eigh((current.R.T @ current.R + self.S) / np.outer(scale, scale))
        size = np.abs(size)
        positive = size > len(size) * np.finfo(float).eps * size.max(initial=0.0)
        root, V = np.sqrt(size[positive]), V[:, positive]
        return Local(
            current.cost, root[:, None] * V.T * scale, V.T @ (current.gradient / scale) / root
        )

    def update(
        self, step: RealArray, current: Local, reached: Local, *, accepted: bool
    ) -> _Curvature:
        gained = current.cost - reached.cost
        plain = _predict_decrease(current, step, current.q)
        curved = plain - 0.5 * float(step @ self.S @ step)
        is_used = self.is_used
        if plain > CURVATURE.rounding_share * current.cost:
            holds = (
                gained > CURVATURE.large_decrease * current.cost
                or abs(gained - plain) <= CURVATURE.prediction_error * plain
            )
            is_short = bool(np.abs(step).max() <= CURVATURE.longest_step)
            is_used = is_short and not holds and abs(gained - curved) < abs(gained - plain)
        # The next step begins at `reached` if this one was accepted.
        R = reached.R if accepted else current.R
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            missing = reached.gradient - current.gradient - R.T @ (R @ step) - self.S @ step
            along = missing @ step
            S = self.S + np.outer(missing / along, missing)
            clear = abs(along) > CURVATURE.least_cosine * np.linalg.norm(missing) * np.linalg.norm(
                step
            )
        return _Curvature(S if clear and np.isfinite(S).all() else self.S, is_used)


def _predict_decrease(current: Local, p: RealArray, q: RealArray) -> float:
    """Return the predicted decrease of the cost by a step, with the reduced residual q."""
    moved = current.R @ p
    return float(-(moved @ q) - 0.5 * (moved @ moved))


def _step(
    current: Local,
    x: RealArray,
    lower: RealArray,
    upper: RealArray,
    radius: float,
    within: RealArray | None = None,
    noise: float = 0.0,
) -> tuple[RealArray, float, bool]:
    """Return the step, the predicted decrease of the cost, and whether the radius limits it."""
    if within is not None:
        return _step_within(current, x, lower, upper, radius, within)
    g = current.gradient
    free = ~(((x <= lower) & (g > 0)) | ((x >= upper) & (g < 0)))
    p = np.zeros(len(x))
    q = _drop_insignificant_pull(current.R[:, free], current.q, noise)
    p[free], damping = _ball_step(current.R[:, free], q, radius)
    if ((x + p < lower) | (x + p > upper)).any():
        damped = current.R
        if damping:
            damped = np.vstack([current.R, np.sqrt(damping) * np.eye(len(x))])
        p = _box_step(
            damped,
            np.append(q, np.zeros(len(damped) - len(q))),
            lower - x,
            upper - x,
            free,
        )
    # The model is convex: it decreases all the way from 0 to its minimum within the bounds.
    size = float(np.linalg.norm(p))
    if size > radius:
        p = p * (radius / size)
    return p, _predict_decrease(current, p, q), damping > 0 or size > radius


def _drop_insignificant_pull(R: RealArray, q: RealArray, noise: float) -> RealArray:
    """Return q without the pull on undetermined combinations that are within the noise."""
    # The standard deviations of the combinations are the noise over the singular values of R; U^T
    # q over the noise is the distance of each from its best value, in standard deviations.
    if noise == 0.0:
        return q
    U, s, _ = np.linalg.svd(R)
    pull = U.T @ q
    size = np.zeros(len(q))
    size[: len(s)] = s
    rests = (size * NULL_SPACE.undetermined_std < noise) & (
        np.abs(pull) < TRUST_REGION.kept_stds * noise
    )
    return np.asarray(U @ np.where(rests, 0.0, pull)) if rests.any() else q


def _step_within(
    current: Local,
    x: RealArray,
    lower: RealArray,
    upper: RealArray,
    radius: float,
    within: RealArray,
) -> tuple[RealArray, float, bool]:
    """Return the same for steps along given directions, up to the first bound or along it."""
    fixed = np.zeros(len(x), dtype=np.bool_)
    p, damping, share = np.zeros(len(x)), 0.0, 1.0
    for _ in range(len(x) + 1):
        basis = within
        if fixed.any():
            basis = within @ null_space(within[fixed])
        if basis.shape[1] == 0:
            return np.zeros(len(x)), 0.0, False
        along, damping = _ball_step(current.R @ basis, current.q, radius)
        p = basis @ along
        p[fixed] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(p > 0, (upper - x) / p, np.where(p < 0, (lower - x) / p, np.inf))
        share = min(1.0, float(room.min(initial=np.inf)))
        if share > TRUST_REGION.step_rounding:
            break
        fixed |= room <= TRUST_REGION.step_rounding
    p = share * p
    return p, _predict_decrease(current, p, current.q), damping > 0 or share < 1.0


def _box_step(
    R: RealArray, q: RealArray, low: RealArray, high: RealArray, free: BoolArray
) -> RealArray:
    """Minimise |R p + q| subject to low <= p <= high, low <= 0 <= high, by active sets."""
    # Stark & Parker, Comput. Stat. 10 (1995) 129. No iteration increases |R p + q|, so the loop
    # may end at any. If R lacks full rank, `scipy.optimize.lsq_linear` does not return the
    # minimiser of least scaled norm.
    p, free = np.zeros(len(low)), free.copy()
    norms = np.linalg.norm(R, axis=0)
    for _ in range(4 * len(p) + 10):
        r = R @ p + q
        d = np.zeros(len(p))
        d[free] = _least_squares(R[:, free], r)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(d > 0, (high - p) / d, np.where(d < 0, (low - p) / d, np.inf))
        share = min(1.0, float(room.min(initial=np.inf)))
        p = np.clip(p + share * d, low, high)
        if share < 1.0:
            met = room <= share
            p[met] = np.where(d > 0, high, low)[met]
            free &= ~met
            continue
        r = R @ p + q
        pull = R.T @ r
        inward = np.where(p <= low, -pull, np.where(p >= high, pull, 0.0)) / np.where(
            norms > 0, norms, 1.0
        )
        inward[free] = 0.0
        best = int(np.argmax(inward))
        if inward[best] <= 1e-12 * np.linalg.norm(q):
            break
        free[best] = True
    return p


def _least_squares(R: RealArray, q: RealArray) -> RealArray:
    """Minimise |R p + q|; if R is rank-deficient, with the least column-scaled norm."""
    if R.shape[1] == 0:
        return np.zeros(0)
    norms = np.linalg.norm(R, axis=0)
    weight = np.where(norms > 0, norms, 1.0)
    U, s, Vt = np.linalg.svd(R / weight, full_matrices=False)
    keep = s > s[0] * max(R.shape) * np.finfo(float).eps
    return np.asarray(-(Vt[keep].T @ ((U.T @ q)[keep] / s[keep])) / weight)


def _ball_step(R: RealArray, q: RealArray, radius: float) -> tuple[RealArray, float]:
    """Minimise |R p + q| subject to |p| <= radius by the SVD of R; return step and damping."""
    full = _least_squares(R, q)
    if np.linalg.norm(full) <= radius:
        return full, 0.0
    U, s, Vt = np.linalg.svd(R, full_matrices=False)
    b = U.T @ q
    # |p(damping)| decreases monotonically: bisect the logarithm of the damping that puts p on the
    # sphere.
    high = max(float(np.linalg.norm(s * b)) / radius, np.finfo(float).tiny)
    low = high * 1e-40
    while high > 1.05 * low:
        middle = np.sqrt(low) * np.sqrt(high)
        if np.linalg.norm(s * b / (s**2 + middle)) > radius:
            low = middle
        else:
            high = middle
    return np.asarray(-(Vt.T @ (s * b / (s**2 + high)))), high
