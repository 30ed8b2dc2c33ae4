"""Maximum-likelihood estimates of poles with standard deviations, window by window.

In a window of a few modes, every FRF is a sum of fractions with common poles and a polynomial for
all other modes. Poles are found by Gauss-Newton iteration on the residual of linear least squares
(variable projection: G. H. Golub & V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432; the
approximation of L. Kaufman, BIT 15 (1975) 49-57). Noise is proportional and a floor in each
channel. Standard deviations are those of the normal equations (R. Pintelon & J. Schoukens, System
Identification, 2nd ed. 2012, section 9.10).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, NumberArray, RealArray
from updyn.modal.channels import Columns
from updyn.modal.envelope import Envelope
from updyn.modal.settings import CHANNEL_FIT, POLE_REFINEMENT
from updyn.modal.vector_fitting import RationalBasis

__all__ = [
    "ChannelNoise",
    "Errors",
    "LineWindow",
    "Weights",
    "WindowFit",
    "deviance",
    "estimate_errors",
    "fit_poles",
    "fit_residues",
    "fit_reweighted",
    "fit_with_unknown_noise",
]


@dataclass(frozen=True, slots=True, eq=False)
class LineWindow:
    """Lines around some modes, and fixed poles next to them."""

    #: Basis of the fractions; its degree is that of the polynomial.
    basis: RationalBasis
    #: The variable, shape (n_f,).
    x: ComplexArray
    #: The channels, shape (p, n_f).
    Y: ComplexArray
    #: Fixed poles with free residues, shape (m,).
    fixed_poles: ComplexArray
    #: Contributions that were subtracted from the channels, shape (p, n_f) or (1, 1). Proportional
    #: noise is relative to the sum of both.
    subtracted: ComplexArray = field(default_factory=lambda: np.zeros((1, 1), dtype=np.complex128))
    #: Envelope of the noise, for its correlation over lines.
    envelope: Envelope = field(default_factory=Envelope.white)

    @property
    def measured_channels(self) -> ComplexArray:
        """The channels with the subtracted contributions, shape (p, n_f)."""
        # Fractions of distant modes are large at low frequencies, where a polynomial cancels them,
        # so `Y` can be much larger than the measurement.
        return np.asarray(self.Y + self.subtracted)

    def of_lines(self, chosen: BoolArray) -> LineWindow:
        """Return the window restricted to some of its lines."""
        subtracted = (
            self.subtracted if self.subtracted.shape[1] == 1 else self.subtracted[:, chosen]
        )
        return replace(self, x=self.x[chosen], Y=self.Y[:, chosen], subtracted=subtracted)

    def of_channels(self, chosen: BoolArray) -> LineWindow:
        """Return the window restricted to some of its channels."""
        subtracted = self.subtracted if len(self.subtracted) == 1 else self.subtracted[chosen]
        return replace(self, Y=self.Y[chosen], subtracted=subtracted)

    def width(self, poles: ComplexArray) -> RealArray:
        """Return the distance of the half-power points from the poles in the unit of x, (k,)."""
        width = np.abs(poles.real if self.basis.mirrored else poles.imag)
        return np.maximum(width, POLE_REFINEMENT.least_width_share * np.abs(poles))

    def near(self, pole: complex) -> BoolArray:
        """Return the lines in the half-power band of a pole, but at least the three nearest."""
        distance = np.abs(self.x - (1j * pole.imag if self.basis.mirrored else pole.real))
        third = float(np.sort(distance)[min(2, len(distance) - 1)])
        return np.asarray(distance <= max(float(self.width(np.array([pole]))[0]), third))

    @property
    def powers(self) -> ComplexArray:
        """The polynomial for all modes outside the window, shape (n_f, degree + 1)."""
        middle = 0.5 * (self.x[0] + self.x[-1])
        reach = max(float(np.abs(self.x[-1] - middle)), CHANNEL_FIT.smallest_divisor)
        return np.asarray(((self.x[:, None] - middle) / reach) ** np.arange(self.basis.degree + 1))

    def columns(self, poles: ComplexArray) -> NumberArray:
        """Return the functions of the linear fit of the channels, shape (rows, m); poles first."""
        powers = self.powers
        if self.basis.mirrored:  # distant modes have complex contributions
            powers = np.hstack([powers, 1j * powers])
        fixed_poles = self.basis.fractions(self.x, self.fixed_poles)
        return self.basis.parts(np.hstack([self.fractions(poles), fixed_poles, powers]))

    def fractions(self, poles: ComplexArray) -> ComplexArray:
        """Return the functions of the free poles, shape (n_f, m)."""
        return self.basis.fractions(self.x, poles)

    def inflation(self, poles: ComplexArray, weights: Weights) -> RealArray:
        """Return the variance of residues relative to white noise, (k,)."""
        if self.envelope.is_white:
            return np.ones(len(poles))
        return self._inflation_of_residues(*self._decompose(poles, weights), len(poles))

    def inflation_with_poles(
        self, poles: ComplexArray, weights: Weights
    ) -> tuple[RealArray, RealArray]:
        """Return the variances of residues and of poles relative to white noise, (k,) each."""
        if self.envelope.is_white:
            return np.ones(len(poles)), np.ones(len(poles))
        Q, R = self._decompose(poles, weights)
        T = weights.common[:, None] / (self.x[:, None] - poles) ** 2
        of_poles = self.envelope.inflation(T - Q @ (Q.conj().T @ T))
        return self._inflation_of_residues(Q, R, len(poles)), of_poles

    def _decompose(self, poles: ComplexArray, weights: Weights) -> tuple[NumberArray, NumberArray]:
        """Return the QR factors of the weighted columns, poles first."""
        # The mirror image of a pole is far from the lines and is neglected.
        fractions = 1.0 / (self.x[:, None] - np.concatenate([poles, self.fixed_poles]))
        A = np.hstack([fractions, self.powers]) * weights.common[:, None]
        Q, R = np.linalg.qr(A / np.linalg.norm(A, axis=0))
        return Q, R

    def _inflation_of_residues(self, Q: NumberArray, R: NumberArray, count: int) -> RealArray:
        # The part of a column orthogonal to all others is along that column of the dual basis.
        chosen = np.eye(len(R), count)
        return self.envelope.inflation(Q @ np.linalg.lstsq(R.conj().T, chosen, rcond=None)[0])

    def derivatives(self, poles: ComplexArray) -> NumberArray:
        """Return functions that span the derivatives by the poles, shape (rows, k or 2 k)."""
        pole_terms = 1.0 / (self.x[:, None] - poles) ** 2
        if not self.basis.mirrored:
            return np.asarray(pole_terms)
        image = 1.0 / (self.x[:, None] - poles.conj()) ** 2
        return self.basis.parts(np.hstack([pole_terms + image, 1j * (pole_terms - image)]))

    def derivative_coefficients(self, residues: ComplexArray) -> NumberArray:
        """Return the derivatives of the channels by the poles in these functions, (p, k, k).

        For poles with mirror images, they are the derivatives by the real parts, followed by those
        by the imaginary parts, shape (p, 2 k, 2 k).
        """
        k, p = residues.shape
        at = np.arange(k)
        if not self.basis.mirrored:
            out: NumberArray = np.zeros((p, k, k), dtype=np.complex128)
            out[:, at, at] = residues.T
            return out
        out = np.zeros((p, 2 * k, 2 * k))
        out[:, at, at] = out[:, at + k, at + k] = residues.real.T
        out[:, at + k, at], out[:, at, at + k] = residues.imag.T, -residues.imag.T
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ChannelNoise:
    """Noise of each channel: variances, shape (p,), of proportional noise and of a floor.

    `share` is relative to the squared values, `floor` in squared units of the channel.
    """

    share: RealArray
    floor: RealArray

    @classmethod
    def of(cls, squares: RealArray, size: RealArray) -> ChannelNoise:
        """Return the noise of maximum likelihood for exponentially distributed squares.

        `squares` are squared errors, `size` squared values without noise, shape (p, n_f).
        """
        # The multiplicative updates never become negative (C. Fevotte, N. Bertin & J.-L. Durrieu,
        # Neural Comput. 21 (2009) 793-830, equation 4.2).
        # Channels are independent: groups of them stay in the processor's cache over all updates.
        # Noise needs few digits: single precision, in units of the largest value of each channel.
        unit = np.maximum(size.max(axis=1), squares.max(axis=1)) + CHANNEL_FIT.smallest_divisor
        together = max(1, POLE_REFINEMENT.cached_values // size.shape[1])
        parts = []
        for start in range(0, len(size), together):
            some = slice(start, start + together)
            of_one = unit[some, None]
            parts.append(_estimate_noise(squares[some] / of_one, size[some] / of_one))
        share, floor = (np.concatenate(a).astype(np.float64) for a in zip(*parts, strict=True))
        return cls(share, np.maximum(floor * unit, CHANNEL_FIT.smallest_divisor))

    def deviation(self, size: RealArray) -> RealArray:
        """Return the standard deviations for squared values `size`, shape (p, n_f)."""
        return np.asarray(np.sqrt(self.share[:, None] * size + self.floor[:, None]))


def _estimate_noise(squares: RealArray, size: RealArray) -> tuple[RealArray, RealArray]:
    """Return the most likely share and floor of the noise of each channel (`ChannelNoise.of`)."""
    squares, size = np.asarray(squares, np.float32), np.asarray(size, np.float32)
    # Far below the least noise of values near 1; its inverse does not overflow.
    smallest = np.finfo(size.dtype).eps ** 4
    least = POLE_REFINEMENT.noise_rounding**2 * size.max(axis=1) + smallest
    floor = 0.5 * np.mean(squares, axis=1) + least
    share = floor / (np.mean(size, axis=1) + smallest)
    inverse, ratio = np.empty_like(size), np.empty_like(size)
    for _ in range(POLE_REFINEMENT.noise_iterations):
        np.multiply(size, share[:, None], out=inverse)
        inverse += floor[:, None]
        np.reciprocal(inverse, out=inverse)
        np.multiply(squares, inverse, out=ratio)
        ratio *= inverse
        share = share * _dot_rows(size, ratio) / (_dot_rows(size, inverse) + smallest)
        floor = np.maximum(floor * np.sum(ratio, axis=1) / np.sum(inverse, axis=1), least)
    return share, floor


def _dot_rows(a: RealArray, b: RealArray) -> RealArray:
    """Return the inner products of the rows of two matrices, shape (p,)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Standard deviations of values as a product; a common factor of all channels makes fits cheap.

    `channel` has the shape (p, 1) or (1, 1), `line` (p, n_f) or, common to all channels, (1, n_f).
    """

    channel: RealArray
    line: RealArray

    @classmethod
    def of(cls, size: RealArray) -> Weights:
        """Return weights that normalise each channel by its rms, from squared values."""
        level = np.sqrt(np.mean(size, axis=1, keepdims=True)) + CHANNEL_FIT.smallest_divisor
        return cls(level, np.ones((1, size.shape[1])))

    @property
    def common(self) -> RealArray:
        """Inverse standard deviations of the lines, common to all channels, shape (n_f,)."""
        return np.asarray(np.exp(-np.mean(np.log(self.line), axis=0)))

    def of_channels(self, chosen: BoolArray) -> Weights:
        """Return the weights of some channels."""
        return Weights(*(a[chosen] if len(a) > 1 else a for a in (self.channel, self.line)))

    @classmethod
    def from_residual(cls, fitted: WindowFit) -> Weights:
        """Return weights from the residual of a fit: product closest to its estimated noise."""
        return cls.near(fitted.noise.deviation(fitted.size))

    @classmethod
    def near(cls, deviation: RealArray) -> Weights:
        """Return the product closest to given standard deviations, shape (p, n_f)."""
        level = np.exp(np.mean(np.log(deviation), axis=1, keepdims=True))
        return cls(level, np.exp(np.mean(np.log(deviation / level), axis=0, keepdims=True)))


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """The fit of a window for given poles."""

    #: The free poles, shape (k,).
    poles: ComplexArray
    #: Residues of each channel, shape (k, p).
    residues: ComplexArray
    #: Residual of the fit, shape (p, n_f).
    error: ComplexArray
    #: Coefficients of the columns of the window, shape (p, m), for channels divided by their level.
    weights: NumberArray
    #: Level of each channel, shape (p, 1) or (1, 1).
    level: RealArray
    #: Decomposed columns of the window.
    columns: Columns
    #: Squared errors in units of their variances, shape (p, n_f).
    normalised_squares: RealArray
    #: Gauss-Newton matrix and gradient of the cost of each channel by the poles, shapes (p, n, n)
    #: and (p, n), in the parameters of `LineWindow.derivative_coefficients`.
    normals: NumberArray
    gradients: NumberArray
    #: The fitted window.
    window: LineWindow
    _size: RealArray | None = field(default=None, init=False)
    _noise: ChannelNoise | None = field(default=None, init=False)
    cost: float = field(init=False)
    normal: NumberArray = field(init=False)
    gradient: NumberArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", float(np.sum(self.normalised_squares)))
        for name in ("normal", "gradient"):
            object.__setattr__(self, name, np.sum(getattr(self, name + "s"), axis=0))

    @property
    def size(self) -> RealArray:
        """Squared values of the fit, shape (p, n_f), including subtracted contributions."""
        if self._size is None:
            found = np.abs(self.window.measured_channels - self.error) ** 2
            object.__setattr__(self, "_size", found)
            return found
        return self._size

    @property
    def envelope(self) -> Envelope:
        """Envelope of the noise."""
        return self.window.envelope

    @property
    def squared_error(self) -> RealArray:
        """Squared errors, shape (p, n_f)."""
        return np.asarray(np.abs(self.error) ** 2)

    @property
    def unbiased_squared_error(self) -> RealArray:
        """Squared errors, divided by the share of noise that remains in the residual."""
        n_f, Q = self.error.shape[1], self.columns.Q
        if len(Q) > n_f:  # real and imaginary parts
            Q = Q[:n_f] + 1j * Q[n_f:]
        # A fit follows more of the noise if the noise is correlated over lines.
        remaining = 1.0 - np.mean(self.envelope.inflation(Q)) * self.columns.leverage()
        if remaining.shape[1] > n_f:  # real and imaginary parts
            remaining = 0.5 * (remaining[:, :n_f] + remaining[:, n_f:])
        remaining = np.maximum(remaining, POLE_REFINEMENT.least_noise_share)
        return np.asarray(self.squared_error / remaining)

    @property
    def noise(self) -> ChannelNoise:
        """Most likely noise of the channels for the residual, computed once."""
        if self._noise is None:
            found = ChannelNoise.of(self.unbiased_squared_error, self.size)
            object.__setattr__(self, "_noise", found)
            return found
        return self._noise

    @property
    def pole_columns(self) -> list[list[int]]:
        """The columns of each pole: one, or two for a pole with a mirror image."""
        k = len(self.poles)
        if not np.isrealobj(self.weights):
            return [[r] for r in range(k)]
        images = np.cumsum(self.poles.imag != 0) - 1 + k
        return [[r, int(images[r])] if self.poles[r].imag != 0 else [r] for r in range(k)]

    @property
    def cost_increase_by_channel(self) -> RealArray:
        """Increase of the cost of each channel without each pole, shape (k, p)."""
        out = np.zeros((len(self.poles), len(self.error)))
        for r, columns_of_pole in enumerate(self.pole_columns):
            found, spread = (
                self.weights[:, columns_of_pole, None],
                self.columns.covariance(columns_of_pole),
            )
            # Keep it regular.
            spread = spread + CHANNEL_FIT.smallest_divisor * np.eye(len(columns_of_pole))
            out[r] = np.sum((found.conj() * np.linalg.solve(spread, found)).real, axis=(1, 2))
        return out

    @property
    def cost_increase(self) -> RealArray:
        """Increase of the cost without each pole, shape (k,)."""
        return np.asarray(np.sum(self.cost_increase_by_channel, axis=1))

    def compute_damped_step(self, damping: float) -> tuple[ComplexArray, float]:
        """Return a step with a relatively increased diagonal, and its expected decrease."""
        loaded = self.normal + damping * np.diag(np.diag(self.normal))
        step = np.linalg.lstsq(loaded, self.gradient, rcond=None)[0]
        expected_decrease = float(np.vdot(self.gradient, step).real)
        k = len(self.poles)
        return np.asarray(step if len(step) == k else step[:k] + 1j * step[k:]), expected_decrease

    @property
    def deviation(self) -> RealArray:
        """Standard deviations of the poles' real and imaginary parts, (2, k).

        They are valid if the errors were weighted by their standard deviations.
        """
        k = len(self.poles)
        spread = np.linalg.lstsq(self.normal, np.eye(len(self.normal)), rcond=None)[0]
        both = np.sqrt(np.maximum(np.diag(spread).real, 0.0) / 2.0)
        return np.array([both[:k], both[-k:]])


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Random errors of the residues of a pole.

    `noise`, shape (p,), are variances from noise at fixed poles, independent between channels and
    with random phase. `common`, shape (q, p), times independent random numbers of unit variance are
    the errors caused by the errors of the poles. `pole`, shape (2,), are standard deviations of the
    real and the imaginary part of the pole.
    """

    noise: RealArray
    common: ComplexArray
    pole: RealArray

    @classmethod
    def none(cls, p: int) -> Errors:
        """Return the errors of data without noise."""
        return cls(np.zeros(p), np.zeros((0, p), dtype=np.complex128), np.zeros(2))


def deviance(fitted: WindowFit) -> float:
    """Return -2 log of the maximum likelihood over the noise, up to a constant."""
    variance = fitted.noise.deviation(fitted.size) ** 2
    return 2.0 * float(np.sum(np.log(variance) + fitted.squared_error / variance))


def estimate_errors(window: LineWindow, fitted: WindowFit, weights: Weights) -> list[Errors]:
    """Return the errors of each pole and its residues, for noise of weights and envelope."""
    # Residues change by -A^+ dA/dpoles with the poles, and have the noise of a linear fit.
    basis, k, p = window.basis, len(fitted.poles), len(window.Y)
    follow = fitted.columns.project_out(window.derivatives(fitted.poles))[1]
    follow = -np.matmul(follow, window.derivative_coefficients(fitted.residues / fitted.level.T))
    values, vectors = np.linalg.eigh(fitted.normal)
    kept = values > len(values) * np.finfo(float).eps * values.max(initial=0.0)
    spread = np.matmul(follow, vectors[:, kept] / np.sqrt(2.0 * values[kept]))  # (p, m, q)
    common = np.array([basis.residues(one, fitted.poles) for one in spread.T]).reshape(-1, k, p)
    common = common * fitted.level.T
    if not basis.mirrored:
        common = np.concatenate([common, 1j * common])  # for real and imaginary parts of the poles
    errors = []
    residue, pole = window.inflation_with_poles(fitted.poles, weights)
    pole = np.sqrt(pole)
    deviation = fitted.deviation * pole
    for r, columns in enumerate(fitted.pole_columns):
        noise = np.trace(fitted.columns.covariance(columns), axis1=1, axis2=2).real
        noise = np.broadcast_to(noise * (0.5 if basis.mirrored else 1.0), p)
        noise = noise * residue[r] * fitted.level[:, 0] ** 2
        errors.append(Errors(noise, common[:, r] * pole[r], deviation[:, r]))
    return errors


def fit_with_unknown_noise(
    window: LineWindow,
    poles: ComplexArray,
    weights: Weights,
    gain: float | None = None,
) -> tuple[WindowFit, Weights]:
    """Return the fit of maximum likelihood for unknown noise, and its weights."""
    return fit_reweighted(window, fit_poles(window, poles, weights, gain), gain)


def fit_reweighted(
    window: LineWindow, fitted: WindowFit, gain: float | None = None
) -> tuple[WindowFit, Weights]:
    """Return the fit of maximum likelihood for unknown noise, and its weights, from another fit."""
    for _ in range(POLE_REFINEMENT.reweightings):
        weights = Weights.from_residual(fitted)
        fitted = fit_poles(window, fitted.poles, weights, gain)
    return fitted, weights


def fit_poles(
    window: LineWindow,
    poles: ComplexArray,
    weights: Weights,
    gain: float | None = None,
) -> WindowFit:
    """Return the fit with poles of smallest cost for given weights.

    Steps with an expected decrease of the cost below `gain` are omitted.
    """
    if gain is None:
        gain = POLE_REFINEMENT.settled_decrease
    current, damping = fit_residues(window, poles, weights), 0.0
    widths = window.width(poles)  # upper limit of a step
    for _ in range(POLE_REFINEMENT.most_steps if len(poles) else 0):
        step, expected_decrease = current.compute_damped_step(damping)
        longest = float(np.max(np.abs(step) / widths, initial=0.0))
        least = gain * min(1.0, current.cost)
        if longest < POLE_REFINEMENT.settled_step or expected_decrease < least:
            break
        proposed = fit_residues(window, current.poles + step / max(1.0, longest), weights)
        if proposed.cost <= current.cost:
            current, damping = proposed, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-3)
    return current


def fit_residues(window: LineWindow, poles: ComplexArray, weights: Weights) -> WindowFit:
    """Return the fit with given poles by linear least squares."""
    basis, n_f = window.basis, len(window.x)
    # The noise of channels without signal is nearly zero: divide by the mean weight of each
    # channel.
    channel_level = np.exp(np.mean(np.log(weights.line), axis=1, keepdims=True))
    level, line = weights.channel * channel_level, weights.line / channel_level
    Y = window.Y
    if basis.mirrored:
        line, Y = np.hstack([line, line]), np.hstack([Y.real, Y.imag])
    columns = Columns.of(window.columns(poles), line)
    found, error = columns.fit(Y)
    normalised_squares = columns.normalise_squares(error, level)
    functions = window.derivatives(poles)
    slopes = columns.project_errors(error, functions) / level
    if basis.mirrored:
        normalised_squares = normalised_squares[:, :n_f] + normalised_squares[:, n_f:]
        error = error[:, :n_f] + 1j * error[:, n_f:]
    residues = basis.residues(found.T, poles)
    derivative_coefficients = window.derivative_coefficients(residues / level.T)
    back = derivative_coefficients.conj().swapaxes(1, 2)
    normals = np.matmul(back, np.matmul(columns.project_out(functions)[0], derivative_coefficients))
    gradients = np.matmul(back, slopes[:, :, None])[:, :, 0]
    return WindowFit(
        poles,
        residues,
        error,
        found / level,
        level,
        columns,
        normalised_squares,
        normals,
        gradients,
        window,
    )
