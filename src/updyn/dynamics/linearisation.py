"""`Linearisation`: motion of nonlinear elements under a random force, by statistical linearisation.

Each element is a spring and a damper, whose coefficients follow from the standard deviations of its
deformation and of the velocity (`updyn.nonlinear.gaussian`). These are integrals of the FRFs of the
linearised model,

    q = (1 + H_qq D)^-1 H_qf,    sigma^2 = int S |q|^2 df,    sigma_v^2 = int S |omega q|^2 df,

with D = k + i omega c of the elements and the one-sided spectral density S of the force. The mean
deformation m has the forces f_0 of the elements in static equilibrium, m + H_qq(0) f_0 = 0.

The unknowns y = (m, log sigma, log sigma_v) satisfy r(y) = 0, with the Jacobian J. Derivatives by
parameters p follow from the implicit function theorem, dy/dp = -J^-1 dr/dp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dynamics.settings import RANDOM
from updyn.errors import SolverError
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.gaussian import LinearForce, derive_linear_force, linearise
from updyn.nonlinear.quadrature import Rule, find_rule
from updyn.nonlinear.settings import QUADRATURE

__all__ = ["Linearisation", "LinearisedMotion", "couple", "deform"]


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedMotion:
    """Motion y and forces of the elements, with the integrals of its variances.

    `y`, (3, n_e), has the means in m (rad), and the logarithms of the standard deviations of
    deformations in m (rad) and velocities in m/s (rad/s). `residual` is r, of the same shape;
    `rule` has the points in Hz. `rests`, (2, n_e), marks standard deviations of elements at rest.
    """

    y: RealArray
    forces: Sequence[LinearForce]
    rule: Rule
    residual: RealArray
    rests: BoolArray

    @property
    def mean(self) -> RealArray:
        """Mean deformations in m (rad), (n_e,)."""
        return np.asarray(self.y[0])

    @property
    def spread(self) -> RealArray:
        """Standard deviations of deformations and velocities, (2, n_e)."""
        return np.asarray(np.exp(self.y[1:]))

    @property
    def size(self) -> float:
        """Largest residual, relative to the standard deviations."""
        r = np.concatenate([self.residual[:1] / self.spread[0], self.residual[1:]])
        return float(np.abs(r).max()) if np.isfinite(r).all() else np.inf

    @property
    def stiffness(self) -> RealArray:
        """Equivalent stiffnesses in N/m (N m/rad), (n_e,)."""
        return np.array([one.stiffness for one in self.forces])

    @property
    def damping(self) -> RealArray:
        """Equivalent dampings in N s/m (N m s/rad), (n_e,)."""
        return np.array([one.damping for one in self.forces])

    def dynamic_stiffness(self, omega: RealArray) -> ComplexArray:
        """Return D at frequencies in rad/s, (n_f, n_e)."""
        return _dynamic_stiffness(self.forces, omega)


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Elements on a linear model under one random force.

    `receptances` returns the deformations for forces of elements and the force, (n_f, n_e, n_e +
    1), at frequencies in rad/s; `static` has those at 0 Hz, (n_e, n_e), or is None if the model is
    free. `freq` (n_s,) in Hz and `density` (n_s,) in N^2/Hz are the spectrum of the force, linear
    in between. `name` is that of the force in messages.
    """

    elements: Sequence[NonlinearElement]
    receptances: Callable[[RealArray], ComplexArray]
    static: RealArray | None
    freq: RealArray
    density: RealArray
    name: str
    error: float = QUADRATURE.error

    @property
    def has_mean(self) -> bool:
        """Whether the mean of the motion can differ from 0."""
        return not all(element.is_odd for element in self.elements)

    def solve(self) -> LinearisedMotion:
        """Return the motion that agrees with its own linearisation.

        It is sought from the motion without the elements, and then from that of elements at rest,
        as stiff joints can hold a resonance outside of the band.
        """
        none = [LinearForce(0.0, 0.0, 0.0)] * len(self.elements)
        # The resonances of a model without damping are finite with the first points.
        spread = np.sqrt(self._integrate(none, most_halvings=0).integral)
        tiny = np.finfo(np.float64).tiny ** 0.25
        # Below it, an element is at rest, as a slider that the force does not move.
        least = np.log(np.maximum(RANDOM.rest * spread, tiny))
        free = np.maximum(np.log(np.maximum(spread, tiny)), least)
        last = np.inf
        for begins_at_rest, log in ((False, free), (True, least)):
            y = np.concatenate([np.zeros((1, log.shape[1])), log])
            if begins_at_rest:
                y = y + self._evaluate(y, least).residual
            motion = self._descend(y, least)
            if motion.size <= RANDOM.change:
                self._check_stable(motion)
                return motion
            last = min(last, motion.size)
        if not np.isfinite(last):
            raise SolverError(
                f"{self.name}: the model has a resonance without damping in the band, whose motion"
                " under a random force is unbounded; add damping"
            )
        raise SolverError(
            f"{self.name}: the equivalent stiffness and damping for a random force did not settle"
            f" (last change {100.0 * last:.2g} %); use a wider band of the force, or a smaller"
            " level"
        )

    def _descend(self, y: RealArray, least: RealArray) -> LinearisedMotion:
        """Return the last motion of an iteration from y.

        Newton's steps are taken while they halve the residual, damped steps of the fixed-point
        iteration otherwise.
        """
        now = self._evaluate(y, least)
        share, last = RANDOM.first_step, np.inf
        for _ in range(RANDOM.most_iterations):
            if now.size <= RANDOM.change or not np.isfinite(now.size):
                break
            step = self._step(now)
            if step is not None:
                trial = self._evaluate(now.y + step, least)
                if trial.size < 0.5 * now.size:
                    now = trial
                    continue
            share = min(1.0, RANDOM.growth * share) if now.size < last else 0.5 * share
            last = now.size
            now = self._evaluate(now.y + share * now.residual, least)
        return now

    def _step(self, now: LinearisedMotion) -> RealArray | None:
        """Return Newton's step, at most `RANDOM.largest_step` in a logarithm; None if singular."""
        try:
            J = self._jacobian(now, self._derive_forces(now), self._derive_residual(now))
            step = np.linalg.solve(J, -now.residual.ravel())
        except np.linalg.LinAlgError:
            return None
        step = step.reshape(now.y.shape)
        largest = float(np.abs(step[1:]).max())
        if not np.isfinite(largest):
            return None
        if largest > RANDOM.largest_step:
            step *= RANDOM.largest_step / largest
        return np.asarray(step)

    def _evaluate(self, y: RealArray, least: RealArray) -> LinearisedMotion:
        """Return the motion with its residual."""
        sigma, sigma_v = np.exp(y[1:])
        each = zip(self.elements, sigma.tolist(), sigma_v.tolist(), y[0].tolist(), strict=True)
        forces = [linearise(*one) for one in each]
        rule = self._integrate(forces)
        tiny = np.finfo(np.float64).tiny
        with np.errstate(invalid="ignore"):
            log = 0.5 * np.log(np.maximum(rule.integral, tiny))
            target = np.maximum(log, least)
        r = np.concatenate([self._balance(y[0], forces)[None], target - y[1:]])
        return LinearisedMotion(y, forces, rule, r, log < least)

    def _balance(self, mean: RealArray, forces: Sequence[LinearForce]) -> RealArray:
        """Return the change of the means to static equilibrium, by a Newton step."""
        if self.static is None or not self.has_mean:
            return np.zeros_like(mean)
        excess = mean + self.static @ np.array([one.mean for one in forces])
        return np.asarray(-np.linalg.solve(self._hold(forces), excess))

    def _hold(self, forces: Sequence[LinearForce]) -> RealArray:
        """Return 1 + H_qq(0) k, (n_e, n_e)."""
        k = np.array([one.stiffness for one in forces])
        return np.asarray(np.eye(len(k)) + (0.0 if self.static is None else self.static * k))

    def _check_stable(self, motion: LinearisedMotion) -> None:
        """Raise SolverError if the linearised model has a negative stiffness."""
        if self.static is None:
            return
        if np.linalg.eigvals(self._hold(motion.forces)).real.min() <= 0.0:
            raise SolverError(
                f"{self.name}: the linearised model for a random force is unstable, as an element"
                " softens; use a smaller level"
            )

    def _integrate(
        self, forces: Sequence[LinearForce], most_halvings: int = QUADRATURE.most_halvings
    ) -> Rule:
        """Return the integrals of sigma^2 and sigma_v^2, (2, n_e); not finite at a resonance."""

        def density(f: RealArray) -> RealArray:
            omega = 2.0 * np.pi * f
            q = deform(self.receptances(omega), _dynamic_stiffness(forces, omega))
            squared = np.interp(f, self.freq, self.density)[:, None] * np.abs(q) ** 2
            return np.stack([squared, omega[:, None] ** 2 * squared], axis=1)

        edges = np.linspace(self.freq[0], self.freq[-1], 1 + RANDOM.intervals)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            try:
                return find_rule(density, edges, most_halvings, self.error)
            except np.linalg.LinAlgError:  # at the resonance
                return Rule(edges, np.zeros_like(edges), np.full((2, len(forces)), np.inf))

    def derive(
        self,
        motion: LinearisedMotion,
        slopes: Callable[[RealArray], ComplexArray],
        static: RealArray | None,
        places: Sequence[tuple[int, int, int]],
        n: int,
    ) -> tuple[RealArray, RealArray]:
        """Return the derivatives of stiffnesses and dampings by n unknowns, (n, n_e) each.

        `slopes` returns those of `receptances`, (n, n_f, n_e, n_e + 1), and `static` has those at 0
        Hz, (n, n_e, n_e). Unknown i of `places` (i, e, j) is parameter j of element e.
        """
        local, by_force = self._derive_forces(motion), self._derive_residual(motion)
        r = self._derive_explicitly(motion, slopes, static, n)
        own = np.zeros((n, 3, len(self.elements)))
        for i, e, j in places:
            own[i, :, e] += local[e][:, 3 + j]
        r += np.einsum("ajfe,pfe->paj", by_force, own)
        J = self._jacobian(motion, local, by_force)
        dy = np.linalg.solve(J, -r.reshape(n, -1).T).T.reshape(r.shape)
        for e, one in enumerate(local):
            own[:, :, e] += dy[:, :, e] @ one[:, :3].T
        return own[:, 1], own[:, 2]

    def _jacobian(
        self, motion: LinearisedMotion, local: Sequence[RealArray], by_force: RealArray
    ) -> RealArray:
        """Return dr/dy, (3 n_e, 3 n_e)."""
        n = len(self.elements)
        slopes = np.stack([one[:, :3] for one in local], axis=1)
        J = np.einsum("ajfe,feb->ajbe", by_force, slopes).reshape(3 * n, 3 * n)
        own = np.eye(3 * n)
        own[:n, :n] = np.linalg.solve(self._hold(motion.forces), np.eye(n))
        return np.asarray(J - own)

    def _derive_forces(self, motion: LinearisedMotion) -> list[RealArray]:
        """Return the derivatives of the forces of each element by y and parameters."""
        out = []
        for e, element in enumerate(self.elements):
            sigma, sigma_v = motion.spread[:, e].tolist()
            slopes = derive_linear_force(element, sigma, sigma_v, float(motion.mean[e]))
            slopes[:, 1:3] *= sigma, sigma_v
            out.append(slopes)
        return out

    def _derive_residual(self, motion: LinearisedMotion) -> RealArray:
        """Return the derivatives of r by means, stiffnesses and dampings, (3, n_e, 3, n_e)."""
        n = len(self.elements)
        out = np.zeros((3, n, 3, n))
        if self.static is not None and self.has_mean:
            out[0, :, 0] = -np.linalg.solve(self._hold(motion.forces), self.static)
        omega, weights = self._weigh(motion)
        H = self.receptances(omega)
        D = motion.dynamic_stiffness(omega)
        q, by = deform(H, D), np.linalg.solve(couple(H, D), H[:, :, :n])
        # dq_j/dk_e = -by_je q_e and dq_j/dc_e = i omega dq_j/dk_e.
        product = -q.conj()[:, :, None] * by * q[:, None, :]
        for f, factor in ((1, np.ones_like(omega)), (2, 1j * omega)):
            out[1:, :, f] = np.einsum(
                "naj,nje->aje", weights, (factor[:, None, None] * product).real
            )
        return out

    def _derive_explicitly(
        self,
        motion: LinearisedMotion,
        slopes: Callable[[RealArray], ComplexArray],
        static: RealArray | None,
        n: int,
    ) -> RealArray:
        """Return the derivatives of r by unknowns of the linear model, (n, 3, n_e)."""
        n_e = len(self.elements)
        out = np.zeros((n, 3, n_e))
        if static is not None and self.has_mean:
            forces = np.array([one.mean for one in motion.forces])
            out[:, 0] = -np.linalg.solve(self._hold(motion.forces), (static @ forces).T).T
        points, all_weights = self._weigh(motion)
        for some in np.array_split(np.arange(len(points)), -(-len(points) // RANDOM.block_points)):
            omega, weights = points[some], all_weights[some]
            H, dH, D = self.receptances(omega), slopes(omega), motion.dynamic_stiffness(omega)
            q = deform(H, D)
            right = dH[..., n_e] - np.einsum("pnje,ne->pnj", dH[..., :n_e], D * q)
            dq = np.linalg.solve(couple(H, D), right.transpose(1, 2, 0))
            out[:, 1:] += np.einsum("naj,njp->paj", weights, (q.conj()[:, :, None] * dq).real)
        return out

    def _weigh(self, motion: LinearisedMotion) -> tuple[RealArray, RealArray]:
        """Return the points in rad/s, and the weights of Re(q^* dq) in dr, (n, 2, n_e)."""
        rule, omega = motion.rule, 2.0 * np.pi * motion.rule.points
        each = rule.weights * np.interp(rule.points, self.freq, self.density)
        # Of a logarithm of a root, d(log sigma) = int S Re(q^* dq) / sigma^2.
        size = np.where(motion.rests, np.inf, rule.integral)
        return omega, np.stack([each, omega**2 * each], axis=1)[:, :, None] / size


def _dynamic_stiffness(forces: Sequence[LinearForce], omega: RealArray) -> ComplexArray:
    """Return the dynamic stiffnesses D of linear forces at frequencies in rad/s, (n_f, n_e)."""
    stiffness = np.array([one.stiffness for one in forces])
    damping = np.array([one.damping for one in forces])
    return np.asarray(stiffness + 1j * omega[:, None] * damping)


def couple(H: ComplexArray, D: ComplexArray) -> ComplexArray:
    """Return 1 + H_qq D, (n_f, n_e, n_e); H has the shape (n_f, n_e, n_e + ...)."""
    n = D.shape[1]
    return np.asarray(np.eye(n) + H[:, :, :n] * D[:, None, :])


def deform(H: ComplexArray, D: ComplexArray) -> ComplexArray:
    """Return the deformations for a unit force, (n_f, n_e); H has the shape (n_f, n_e, n_e + 1)."""
    n = D.shape[1]
    return np.asarray(np.linalg.solve(couple(H, D), H[:, :, n:])[..., 0])
