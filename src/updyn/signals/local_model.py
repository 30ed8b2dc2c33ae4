"""Rational models of neighbouring lines with a transient, fitted to all responses together."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.signals.settings import LOCAL_RATIONAL

__all__ = ["LocalModel", "LocalValues", "Windows"]


_TINY = float(np.finfo(float).tiny) ** 0.25


@dataclass(frozen=True, slots=True)
class LocalModel:
    """Shape of a local model: X = (B(r) F + C(r)) / A(r) at r lines from its centre.

    `poles` is the degree of A, common to all responses (0: local polynomial method); `half` the
    number of lines on either side of the centre; `degree`, at least 1, that of B and C.
    """

    poles: int
    half: int
    degree: int

    @property
    def width(self) -> int:
        """Number of lines of the fit."""
        return 2 * self.half + 1

    def freedom(self, records: int, forces: int) -> int:
        """Return the least number of complex degrees of freedom of the residual of a response."""
        coefficients = self.degree + 1
        return records * (self.width - coefficients) - forces * coefficients - self.poles


@dataclass(frozen=True, slots=True, eq=False)
class LocalValues:
    """Values of local models at lines around their centres."""

    #: FRFs, shape (n, n_lines, n_i, n_r).
    values: ComplexArray
    #: E|dH|^2 of each, shape (n, n_lines, n_i, n_r).
    variance: RealArray
    #: Variance of the responses around the model, shape (n, n_lines, n_i).
    noise: RealArray
    #: Sum over the records of the residual at the line times the conjugate of the forces, shape (n,
    #: n_lines, n_i, n_r).
    unexplained: ComplexArray
    #: Mean square error at a line of the model fitted without this line, shape (n, n_lines, n_i).
    omission_error: RealArray
    #: Share of the power of each force outside polynomial transients and the other forces, shape
    #: (n, n_lines, n_r).
    separable: RealArray

    def better(self, closer: BoolArray, other: LocalValues) -> LocalValues:
        """Return the values of another model where `closer` is true, else these."""

        def of(name: str) -> Any:
            mine, its = getattr(self, name), getattr(other, name)
            return np.where(closer.reshape(-1, *(1,) * (mine.ndim - 1)), its, mine)

        return LocalValues(*(of(one.name) for one in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Spectra of the lines around some centres."""

    #: The model that is fitted to them.
    model: LocalModel
    #: Index of the centre in its window, shape (n,), which is not the middle at the ends of the
    #: band.
    centre: IndexArray
    #: Powers of the distance from the centre over the half width, shape (n, width, powers).
    powers: RealArray
    #: Spectra of the forces times these powers, shape (n, records, width, n_r (degree + 1)).
    force: ComplexArray
    #: Spectra of the responses, shape (n, records, width, n_i), each over its rms over the band.
    motion: ComplexArray

    @classmethod
    def of(
        cls, force: ComplexArray, motion: ComplexArray, centres: IndexArray, model: LocalModel
    ) -> Windows:
        """Return the windows of spectra of rms 1, shape (records, n_f, n_r or n_i)."""
        begin = np.clip(centres - model.half, 0, force.shape[1] - model.width)
        at = begin[:, None] + np.arange(model.width)
        away = (at - centres[:, None]) / model.half
        powers = away[..., None] ** np.arange(max(model.poles, model.degree) + 1)
        F, X = np.moveaxis(force[:, at], 0, 1), np.moveaxis(motion[:, at], 0, 1)
        F = F[..., :, None] * powers[:, None, :, None, : model.degree + 1]
        return cls(model, centres - begin, powers, F.reshape(*F.shape[:3], -1), X)

    def values_at(self, offsets: IndexArray) -> LocalValues:
        """Return the values of the fitted models at some lines from their centres."""
        start = _FittedModels.of(
            self, np.zeros((len(self.powers), self.model.poles), dtype=complex)
        )
        return _Solution.of(self._fit(start), offsets).values(start.separable)

    def _fit(self, fit: _FittedModels) -> _FittedModels:
        """Return the fitted models: for a given A, B and C are linear (variable projection)."""
        # A follows from Gauss-Newton steps from A = 1, with each response relative to its residual
        # (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973).
        for step in range(LOCAL_RATIONAL.steps if self.model.poles else 0):
            refitted = fit.poles + fit.change(is_first=step == 0)
            fit = fit.better(_FittedModels.of(self, refitted))
        return fit


@dataclass(frozen=True, slots=True, eq=False)
class _FittedModels:
    """Local models with given poles; other coefficients by least squares."""

    #: The spectra.
    windows: Windows
    #: Coefficients of A, shape (n, poles), except the constant 1.
    poles: ComplexArray
    #: 1 / A, shape (n, width).
    inverse: ComplexArray
    #: Orthonormal basis of C / A, shape (n, width, degree + 1).
    transient: ComplexArray
    #: QR factors of F / A projected off this basis.
    Q: ComplexArray
    R: ComplexArray
    #: Q^H X, shape (n, n_r (degree + 1), n_i).
    along: ComplexArray
    #: Residual of the responses, shape (n, records width, n_i).
    residual: ComplexArray

    @classmethod
    def of(cls, windows: Windows, poles: ComplexArray) -> _FittedModels:
        model, powers = windows.model, windows.powers
        denominator = np.einsum("fwm,fm->fw", powers[..., 1 : model.poles + 1], poles)
        inverse = 1.0 / (1.0 + denominator)
        transient = np.linalg.qr(powers[..., : model.degree + 1] * inverse[..., None])[0]
        force = _stack_records(_project_off(transient, windows.force * inverse[:, None, :, None]))
        motion = _stack_records(_project_off(transient, windows.motion))
        Q, R = np.linalg.qr(force)
        along = _herm(Q) @ motion
        return cls(windows, poles, inverse, transient, Q, R, along, motion - Q @ along)

    def better(self, other: _FittedModels) -> _FittedModels:
        """Return for each window the fit with the smaller residual."""
        closer = np.log(other.power).sum(axis=1) < np.log(self.power).sum(axis=1)

        def of(name: str) -> Any:
            mine, its = getattr(self, name), getattr(other, name)
            return np.where(closer.reshape(-1, *(1,) * (mine.ndim - 1)), its, mine)

        names = ("poles", "inverse", "transient", "Q", "R", "along", "residual")
        return replace(self, **{name: of(name) for name in names})

    @property
    def power(self) -> RealArray:
        """Sum of squares of the residual, shape (n, n_i), at least that of rounding."""
        squares = np.sum(np.abs(self.residual) ** 2, axis=1)
        return np.asarray(np.maximum(squares, LOCAL_RATIONAL.least_noise * self.residual.shape[1]))

    @property
    def fitted_motion(self) -> ComplexArray:
        """Responses without their residual, shape (n, records, width, n_i)."""
        motion = self.windows.motion
        return motion - self.residual.reshape(motion.shape)

    def change(self, *, is_first: bool) -> ComplexArray:
        """Return the Gauss-Newton step of the poles, shape (n, poles)."""
        # The first step uses the measured response instead of the model's: linear least squares of
        # A X = B F + C (Levy, IRE Trans. Autom. Control AC-4, 1959).
        J, _ = self._slopes(self.windows.motion if is_first else self.fitted_motion)
        error = (self.residual / np.sqrt(self.power)[:, None]).reshape(len(J), -1, 1)
        Q, R = np.linalg.qr(self._weigh_slopes(J))
        return -_solve_triangular(R, _herm(Q) @ error)[..., 0]

    def _slopes(self, motion: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the derivative of the residual by the poles, and Q^H of it before projection.

        Shapes (n, records width, poles, n_i) and (n, n_r (degree + 1), poles, n_i).
        """
        n, records, width, responses = motion.shape
        poles = self.windows.model.poles
        bent = self.windows.powers[..., 1 : poles + 1] * self.inverse[..., None]
        J = (bent[:, None, :, :, None] * motion[:, :, :, None]).reshape(n, records, width, -1)
        J = _stack_records(_project_off(self.transient, J))
        along = _herm(self.Q) @ J
        shape = (n, -1, poles, responses)
        return (J - self.Q @ along).reshape(shape), along.reshape(shape)

    def _weigh_slopes(self, J: ComplexArray) -> ComplexArray:
        """Return the slopes of all responses relative to their residuals, stacked."""
        weighted = J / np.sqrt(self.power)[:, None, None, :]
        return np.moveaxis(weighted, 2, 3).reshape(len(J), -1, J.shape[2])

    @property
    def separable(self) -> RealArray:
        """Share of the power of each force outside C and the other forces, shape (n, n_r)."""
        force = self.windows.force[..., :: self.windows.model.degree + 1]
        power = np.sum(np.abs(force) ** 2, axis=(1, 2))
        row = np.sum(np.abs(self.weights[:, :: self.windows.model.degree + 1]) ** 2, axis=2)
        return np.asarray(1.0 / np.maximum(power * row, 1.0))

    @property
    def weights(self) -> ComplexArray:
        """R^-1: the weights of Q^H X in B, shape (n, n_r (degree + 1), n_r (degree + 1))."""
        return _solve_triangular(self.R, np.broadcast_to(np.eye(self.R.shape[1]), self.R.shape))

    def poles_basis(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return Q and R of the weighted slopes by the poles, and the slopes along `Q`.

        Shapes (n, records width, n_i, poles), (n, poles, poles), (n, n_r (degree + 1), poles, n_i).
        """
        J, along = self._slopes(self.fitted_motion)
        Q, R = np.linalg.qr(self._weigh_slopes(J))
        return Q.reshape(*self.residual.shape, -1), R, along


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Values of fitted models at lines around their centres, and their derivatives."""

    #: The models.
    fit: _FittedModels
    #: Lines from the centre, shape (n_lines,).
    offsets: IndexArray
    #: FRFs, shape (n, n_lines, n_i, n_r).
    H: ComplexArray
    #: Derivative of H by Q^H X, shape (n, n_lines, n_r, n_r (degree + 1)).
    rows: ComplexArray
    #: Derivative of H by the poles, shape (n, n_lines, n_i, n_r, poles), times the inverse of their
    #: R.
    of_poles: ComplexArray
    #: Derivative of each fitted value by its measured value, shape (n, records width, n_i).
    leverage: RealArray
    #: Complex degrees of freedom of the residuals, shape (n, n_i); the poles are divided among the
    #: responses.
    freedom: RealArray

    @classmethod
    def of(cls, fit: _FittedModels, offsets: IndexArray) -> _Solution:
        model = fit.windows.model
        n, records, width, responses = fit.windows.motion.shape
        terms = model.degree + 1
        powers = (offsets / model.half)[:, None] ** np.arange(max(terms, model.poles + 1))
        bent = powers[:, 1 : model.poles + 1]
        A = 1.0 + np.einsum("om,fm->fo", bent, fit.poles)
        numerator = powers[:, :terms] / A[..., None]
        coefficients = (fit.weights @ fit.along).reshape(n, -1, terms, responses)
        H = np.einsum("foq,frqi->foir", numerator, coefficients)
        inverse = fit.weights.reshape(n, -1, terms, fit.R.shape[1])
        rows = np.einsum("foq,frqp->forp", numerator, inverse)
        leverage = np.sum(np.abs(fit.Q) ** 2, axis=2)
        leverage += np.tile(np.sum(np.abs(fit.transient) ** 2, axis=2), (1, records))
        leverage = np.repeat(leverage[..., None], responses, axis=2)
        freedom = np.full((n, responses), float(records * (width - terms) - fit.R.shape[1]))
        of_poles = np.zeros((*H.shape, 0), dtype=np.complex128)
        if model.poles:
            Q, R, along = fit.poles_basis()
            of_one = np.sum(np.abs(Q) ** 2, axis=3)
            leverage += of_one
            freedom -= of_one.sum(axis=1)
            slope = np.einsum("forp,fpmi->foirm", rows, along)
            slope -= H[..., None] * (bent / A[..., None])[:, :, None, None]
            flat = np.moveaxis(slope.reshape(n, -1, model.poles), 2, 1)
            across = _solve_triangular(np.swapaxes(R, 1, 2), flat)
            of_poles = np.moveaxis(across, 1, 2).reshape(slope.shape)
        return cls(fit, offsets, H, rows, of_poles, leverage, np.maximum(freedom, 1.0))

    def values(self, separable: RealArray) -> LocalValues:
        """Return the values, with the separable share of the forces, shape (n, n_r)."""
        n, lines = len(separable), len(self.offsets)
        noise = self._noise[:, None]
        force = self._at_lines(self.fit.windows.force[..., :: self.fit.windows.model.degree + 1])
        residual = self._at_lines(self.fit.residual.reshape(self.fit.windows.motion.shape))
        return LocalValues(
            self.H,
            self._variance,
            np.broadcast_to(noise, (n, lines, noise.shape[2])),
            np.einsum("fnoi,fnor->foir", residual, force.conj()),
            self._omission_error,
            np.broadcast_to(separable[:, None], (n, lines, separable.shape[1])),
        )

    def _at_lines(self, of_windows: ComplexArray) -> ComplexArray:
        """Return values of the windows, shape (n, records, width, ...), at the lines."""
        width = of_windows.shape[2]
        # Lines beyond the last one are outside all windows; their values are not used.
        place = np.clip(self.fit.windows.centre[:, None] + self.offsets, 0, width - 1)
        return np.take_along_axis(of_windows, place[:, None, :, None], axis=2)

    @property
    def _noise(self) -> RealArray:
        """Variance of the responses around the model, shape (n, n_i)."""
        return np.asarray(self.fit.power / self.freedom)

    @property
    def _variance(self) -> RealArray:
        """E|dH|^2 from the noise of the response, and from that of all through the poles."""
        noise_factor = np.sum(np.abs(self.rows) ** 2, axis=3)[:, :, None]
        shared = np.sum(np.abs(self.of_poles) ** 2, axis=4)
        # The poles were weighted by residuals, which are the noise times the freedom.
        shared = shared / self.freedom.mean(axis=1)[:, None, None, None]
        return np.asarray(self._noise[:, None, :, None] * noise_factor + shared)

    @property
    def _omission_error(self) -> RealArray:
        """Mean square error at omitted lines, by the leverage (Allen, 1974)."""
        rest = np.maximum(1.0 - self.leverage, LOCAL_RATIONAL.least_omitted_share)
        error = (self.fit.residual / rest).reshape(self.fit.windows.motion.shape)
        return np.asarray(np.mean(np.abs(self._at_lines(error)) ** 2, axis=1))


def _herm(x: ComplexArray) -> ComplexArray:
    return np.swapaxes(x, -1, -2).conj()


def _stack_records(x: ComplexArray) -> ComplexArray:
    return x.reshape(len(x), -1, x.shape[-1])


def _project_off(Q: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Return x, shape (n, records, width, ...), projected off Q, shape (n, width, ...)."""
    return x - Q[:, None] @ (_herm(Q)[:, None] @ x)


def _solve_triangular(R: ComplexArray, b: ComplexArray) -> ComplexArray:
    """Return R^-1 b for triangular R, with large values for a singular R."""
    diagonal = np.abs(np.einsum("...ii->...i", R))
    least = LOCAL_RATIONAL.dependent_share * diagonal.max(axis=-1, keepdims=True) + _TINY
    short = np.where(diagonal < least, least, 0.0)
    return np.asarray(np.linalg.solve(R + short[..., None] * np.eye(R.shape[-1]), b))
