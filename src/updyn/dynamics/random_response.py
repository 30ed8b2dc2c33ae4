"""`respond_at_random`: FRFs of a model with nonlinear elements under a random force.

By statistical linearisation each element is a spring and a damper, whose coefficients follow from
the standard deviations of its deformation and of the velocity (`updyn.nonlinear.gaussian`). These
are integrals of the FRFs of the linearised model,

    q = (1 + H_qq D)^-1 H_qf,    sigma^2 = S int |q|^2 df,    sigma_v^2 = S int |omega q|^2 df,

with D = k + i omega c of the elements and the one-sided spectral density S of the force. The mean
deformation m has the forces f_0 of the elements in static equilibrium, m + H_qq(0) f_0 = 0. Both
are solved by damped iteration of m and of the logarithms of sigma and sigma_v.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.periodic.transfer import Transfer
from updyn.dynamics.settings import RANDOM
from updyn.errors import ModelError, OptionError, SolverError
from updyn.frf import FRF, QUANTITIES, check_force_quantity, check_lines
from updyn.geometry import Geometry
from updyn.group import is_number
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.gaussian import LinearForce, linearise
from updyn.nonlinear.quadrature import integrate
from updyn.nonlinear.settings import QUADRATURE

__all__ = ["RandomResponse", "respond_at_random"]


@dataclass(frozen=True, slots=True, eq=False)
class RandomResponse:
    """Response of a model with nonlinear elements to one random force after another.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        FRFs of the linearised model, in m/N, m/s/N or m/s2/N.
    responses, references : DofSet
        Signed DOFs of sensors and forces.
    quantity : str
        ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
    level : float
        RMS of the force in N (N m).
    elements : tuple of str
        Names of the nonlinear elements.
    deformation, velocity : ndarray of float, shape (n_e, n_references)
        Standard deviations of the deformation of each element in m (rad) and of its velocity in m/s
        (rad/s), for each force.
    mean : ndarray of float, shape (n_e, n_references)
        Mean deformation in m (rad); 0 if all elements are odd.
    stiffness, damping : ndarray of float, shape (n_e, n_references)
        Equivalent stiffness in N/m (N m/rad) and damping in N s/m (N m s/rad) of each element.
    source : str
        Kind of the linear model, and its error if it is reduced.
    geometry : Geometry, optional
        Positions of the nodes.

    Examples
    --------
    >>> import numpy as np
    >>> from updyn.demos import chain
    >>> model = chain.build().with_elements({"stop": (updyn.CubicSpring(1e9), "12:X")})
    >>> options = {"level": 5.0, "excitation": "random"}
    >>> found = updyn.response(model, np.linspace(0.5, 20.0, 40), ["12:X"], ["12:X"], **options)
    >>> bool(np.allclose(found.stiffness, 3e9 * found.deformation**2))
    True
    """

    freq: RealArray
    values: ComplexArray
    responses: DofSet
    references: DofSet
    quantity: str
    level: float
    elements: tuple[str, ...]
    deformation: RealArray
    velocity: RealArray
    mean: RealArray
    stiffness: RealArray
    damping: RealArray
    source: str
    geometry: Geometry | None = None

    @property
    def frf(self) -> FRF:
        """The FRFs of the linearised model, with the level of the force."""
        return FRF(
            self.freq,
            self.values,
            self.responses,
            self.references,
            self.quantity,
            geometry=self.geometry,
            source=f"{self.source}, random force {self.level:g}",
            level=self.level,
            excitation="random",
        )


def respond_at_random(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    level: float,
    quantity: str,
    *,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> RandomResponse:
    """Return the response to a random force; parameters and errors as `updyn.response`."""
    lines = check_lines(np.atleast_1d(freq) if np.isscalar(freq) else freq)
    _check_options(lines, level)
    power = QUANTITIES[check_force_quantity(quantity)]
    if not model.nonlinear:
        raise ModelError(
            "level: the model has no nonlinear elements; leave it out, as the response is"
            " proportional to the force, or add elements by model.with_elements"
        )
    rows, columns = DofSet(responses), DofSet(references)
    read, forced = model.dofs.match(rows, "response"), model.dofs.match(columns, "reference")
    band = float(lines[0]), float(lines[-1])
    transfer = Transfer.build(
        model,
        read.index,
        forced.index,
        band,
        np.union1d(lines, 0.5 * (lines[1:] + lines[:-1])),
        tier=tier,
        backend=backend,
        accuracy=accuracy,
    )
    elements = [local.element for local in model.nonlinear.values()]
    if transfer.static is None and not all(element.is_odd for element in elements):
        raise SolverError(
            "level: the model is free at 0 Hz and an element is not odd, so that the mean of the"
            " motion is not determined; hold the model by a spring"
        )
    n, omega = len(elements), 2.0 * np.pi * lines
    values = np.empty((len(lines), len(rows), len(columns)), dtype=np.complex128)
    found = []
    for j, label in enumerate(columns.labels):
        column = transfer.select(j, n)
        motion = _Linearisation(elements, column.keep_outputs(n), level, band, label).solve()
        H, _ = column.at(omega)
        q = _deform(H[:, :n], omega, motion.forces)
        D = _stiffness(omega, motion.forces)
        values[:, :, j] = H[:, n:, n] - (H[:, n:, :n] @ (D * q)[..., None])[..., 0]
        found.append(motion)
    values *= read.sign[:, None] * forced.sign
    values *= ((1j * omega) ** power)[:, None, None]
    equivalent = [[(e.stiffness, e.damping) for e in motion.forces] for motion in found]
    stiffness, damping = np.array(equivalent).transpose(2, 1, 0)
    return RandomResponse(
        lines,
        values,
        rows,
        columns,
        quantity,
        float(level),
        tuple(model.nonlinear),
        np.stack([motion.sigma for motion in found], axis=1),
        np.stack([motion.sigma_v for motion in found], axis=1),
        np.stack([motion.mean for motion in found], axis=1),
        stiffness,
        damping,
        transfer.source,
        model.geometry,
    )


def _check_options(lines: RealArray, level: object) -> None:
    if not is_number(level) or not 0.0 < level < np.inf:
        raise OptionError(
            f"level {level!r}: expected the RMS of a random force above 0, in N (N m)",
            key=("level",),
        )
    if len(lines) < 2 or lines[0] <= 0.0:
        raise OptionError(
            "freq: a random force has the band from the first line to the last; expected two lines"
            " or more, above 0 Hz",
            key=("freq",),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Mean and standard deviations of the deformations, (n_e,), with the forces of elements."""

    mean: RealArray
    sigma: RealArray
    sigma_v: RealArray
    forces: Sequence[LinearForce]


@dataclass(frozen=True, slots=True, eq=False)
class _Linearisation:
    """The elements of a model under one random force, with the receptances of deformations."""

    elements: Sequence[NonlinearElement]
    transfer: Transfer
    level: float
    band: tuple[float, float]
    label: str

    def solve(self) -> _Motion:
        """Return the motion that agrees with its own linearisation, by damped iteration."""
        n = len(self.elements)
        # The resonances of a model without damping are finite with the first points.
        spread = self._spread([LinearForce(0.0, 0.0, 0.0)] * n, most_halvings=0)
        # Below it, an element is at rest, as a slider that the force does not move.
        least = np.log(np.maximum(RANDOM.rest * spread, np.finfo(np.float64).tiny ** 0.25))
        mean, log = np.zeros(n), np.maximum(np.log(np.maximum(spread, np.exp(least))), least)
        share, last = RANDOM.first_step, np.inf
        for _ in range(RANDOM.most_iterations):
            motion = self._linearise(mean, np.exp(log))
            moved = self._balance(motion)
            target = np.maximum(
                np.log(np.maximum(self._spread(motion.forces), np.finfo(np.float64).tiny)), least
            )
            change = max(
                float(np.abs(target - log).max()),
                float((np.abs(moved - mean) / motion.sigma).max()),
            )
            if change <= RANDOM.change:
                self._check_stable(motion)
                return motion
            share = min(1.0, RANDOM.growth * share) if change < last else 0.5 * share
            mean, log, last = mean + share * (moved - mean), log + share * (target - log), change
        raise SolverError(
            f"level {self.level:g}: the equivalent stiffness and damping for a random force at"
            f" {self.label} did not settle (last change {100.0 * last:.2g} %); use a wider band"
            " freq, or a smaller level="
        )

    def _linearise(self, mean: RealArray, spread: RealArray) -> _Motion:
        sigma, sigma_v = spread
        motion = zip(self.elements, sigma.tolist(), sigma_v.tolist(), mean.tolist(), strict=True)
        return _Motion(mean, sigma, sigma_v, [linearise(*one) for one in motion])

    def _balance(self, motion: _Motion) -> RealArray:
        """Return the means in static equilibrium, by a Newton step; 0 if all forces are odd."""
        H = self.transfer.static
        if H is None or all(element.is_odd for element in self.elements):
            return motion.mean
        n = len(self.elements)
        force = np.array([one.mean for one in motion.forces])
        stiffness = np.array([one.stiffness for one in motion.forces])
        excess = motion.mean + H[:, :n] @ force
        return np.asarray(motion.mean - np.linalg.solve(np.eye(n) + H[:, :n] * stiffness, excess))

    def _check_stable(self, motion: _Motion) -> None:
        """Raise SolverError if the linearised model has a negative stiffness."""
        H, k = self.transfer.static, np.array([one.stiffness for one in motion.forces])
        if H is None:
            return
        n = len(self.elements)
        if np.linalg.eigvals(np.eye(n) + H[:, :n] * k).real.min() <= 0.0:
            raise SolverError(
                f"level {self.level:g}: the linearised model for a random force at {self.label} is"
                " unstable, as an element softens; use a smaller level="
            )

    def _spread(
        self, forces: Sequence[LinearForce], most_halvings: int = QUADRATURE.most_halvings
    ) -> RealArray:
        """Return the standard deviations of deformations and velocities, (2, n_e)."""

        def density(f: RealArray) -> RealArray:
            omega = 2.0 * np.pi * f
            q = np.abs(_deform(self.transfer.at(omega)[0], omega, forces)) ** 2
            return np.stack([q, omega[:, None] ** 2 * q], axis=1)

        width = self.band[1] - self.band[0]
        edges = np.linspace(*self.band, 1 + RANDOM.intervals)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            try:
                integral = integrate(density, edges, most_halvings)
            except np.linalg.LinAlgError:  # at the resonance
                integral = np.full((2, len(forces)), np.inf)
        if not np.isfinite(integral).all():
            raise SolverError(
                f"level {self.level:g}: the model has a resonance without damping in the band,"
                " whose motion under a random force is unbounded; add damping"
            )
        return np.asarray(self.level * np.sqrt(integral / width))


def _stiffness(omega: RealArray, forces: Sequence[LinearForce]) -> ComplexArray:
    """Return the dynamic stiffness of each element, (n_f, n_e)."""
    stiffness = np.array([one.stiffness for one in forces])
    damping = np.array([one.damping for one in forces])
    return np.asarray(stiffness + 1j * omega[:, None] * damping)


def _deform(H: ComplexArray, omega: RealArray, forces: Sequence[LinearForce]) -> ComplexArray:
    """Return the deformations for a unit force, (n_f, n_e); H has the shape (n_f, n_e, n_e + 1)."""
    n = len(forces)
    A = np.eye(n) + H[:, :, :n] * _stiffness(omega, forces)[:, None, :]
    return np.asarray(np.linalg.solve(A, H[:, :, n:])[..., 0])
