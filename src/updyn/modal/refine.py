"""Poles refined to maximum likelihood, with standard deviations, window by window.

A window holds a few neighbouring modes. There every FRF is a sum of fractions with common poles and
a polynomial for all modes outside; residues and polynomial follow from the poles by linear least
squares, the poles by Gauss-Newton steps on what that leaves (variable projection: G. H. Golub &
V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432; the approximation of L. Kaufman, BIT 15 (1975)
49-57). Values are weighted by their noise, in each channel a share of the response and a floor,
estimated from the residual of the fit. Standard deviations are those of the normal equations
(R. Pintelon & J. Schoukens, System Identification, 2nd ed. 2012, section 9.10).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.modal.channels import Columns
from updyn.modal.envelope import Envelope
from updyn.modal.vector_fitting import Basis

__all__ = [
    "ROUGH",
    "Errors",
    "Noise",
    "Solved",
    "Weights",
    "Window",
    "deviance",
    "errors_of",
    "moved",
    "pole_deviation",
    "reweighted",
    "solved",
]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Most steps; they end where one is a smaller share of the width, or would lower the cost by less
#: than `GAIN`: half of it is a standard deviation of one pole, squared.
_STEPS, _SETTLED = 30, 1e-10
GAIN, ROUGH = 1e-3, 0.3
#: Rounds of weights from residuals and poles from weights.
_ALIKE = 2
#: Least share of its noise that a fit is taken to leave of a value.
_LEFT = 0.05
#: Rounds in which a share and a floor of noise are found.
_LIKELIER = 20
#: Noise below this share of the largest value of a channel is rounding.
_ROUNDING = 1e-12
_TINY = 1e-300
#: Least width of a pole, as a share of its size: without damping it has none.
_UNDAMPED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Lines of some modes, and the poles beside them that stay.

    Attributes
    ----------
    basis : Basis
        Of the fractions; its degree is that of the polynomial.
    x : ndarray of complex, shape (n_f,)
        The variable.
    Y : ndarray of complex, shape (p, n_f)
        The channels.
    beside : ndarray of complex, shape (m,)
        Poles that are fitted with free residues, but not moved.
    apart : ndarray of complex, shape (p, n_f) or (1, 1)
        What was taken out of the channels; their noise is a share of all that they were.
    envelope : Envelope
        Of the noise, by which lines are independent or not.
    """

    basis: Basis
    x: _Complex
    Y: _Complex
    beside: _Complex
    apart: _Complex = field(default_factory=lambda: np.zeros((1, 1), dtype=np.complex128))
    envelope: Envelope = field(default_factory=Envelope.white)

    @property
    def measured(self) -> _Complex:
        """The measured channels, shape (p, n_f), before `apart` was taken out.

        Fractions of far modes are large at low frequencies, where a polynomial cancels them, so
        that `Y` can be much larger than the measurement.
        """
        return np.asarray(self.Y + self.apart)

    def of_lines(self, chosen: NDArray[np.bool_]) -> Window:
        """Return the window of some of its lines."""
        apart = self.apart if self.apart.shape[1] == 1 else self.apart[:, chosen]
        return replace(self, x=self.x[chosen], Y=self.Y[:, chosen], apart=apart)

    def width(self, poles: _Complex) -> _Real:
        """Return the distance of the half-power points from poles, in the unit of x, shape (k,)."""
        width = np.abs(poles.real if self.basis.mirrored else poles.imag)
        return np.maximum(width, _UNDAMPED * np.abs(poles))

    def near(self, pole: complex) -> NDArray[np.bool_]:
        """Return the lines within the half-power band of a pole, or the three that are nearest."""
        distance = np.abs(self.x - (1j * pole.imag if self.basis.mirrored else pole.real))
        third = float(np.sort(distance)[min(2, len(distance) - 1)])
        return np.asarray(distance <= max(float(self.width(np.array([pole]))[0]), third))

    @property
    def powers(self) -> _Complex:
        """The polynomial for all modes outside, shape (n_f, degree + 1)."""
        middle = 0.5 * (self.x[0] + self.x[-1])
        reach = max(float(np.abs(self.x[-1] - middle)), _TINY)
        return np.asarray(((self.x[:, None] - middle) / reach) ** np.arange(self.basis.degree + 1))

    def columns(self, poles: _Complex) -> NDArray[Any]:
        """Return the functions of which the channels are sums, shape (rows, m); poles first."""
        powers = self.powers
        if self.basis.mirrored:  # far modes have complex tails
            powers = np.hstack([powers, 1j * powers])
        beside = self.basis.fractions(self.x, self.beside)
        return self.basis.parts(np.hstack([self.fractions(poles), beside, powers]))

    def fractions(self, poles: _Complex) -> _Complex:
        """Return the functions of the poles that may move, shape (n_f, m)."""
        return self.basis.fractions(self.x, poles)

    def inflation(self, poles: _Complex, weights: Weights, *, moving: bool = False) -> _Real:
        """Return the variance of residues in the noise over that in white noise, shape (k,).

        Parameters
        ----------
        poles : ndarray of complex, shape (k,)
            The poles.
        weights : Weights
            Of the values.
        moving : bool
            Return that of the poles, and not of their residues.
        """
        if self.envelope.is_white:
            return np.ones(len(poles))
        # The mirror image of a pole is far from the lines and is left out.
        fractions = 1.0 / (self.x[:, None] - np.concatenate([poles, self.beside]))
        A = np.hstack([fractions, self.powers]) * weights.common[:, None]
        if moving:
            T = weights.common[:, None] / (self.x[:, None] - poles) ** 2
            Q = np.linalg.qr(A)[0]
            beyond = np.asarray(T - Q @ (Q.conj().T @ T), dtype=np.complex128)
            return self.envelope.inflation(beyond)
        out = np.ones(len(poles))
        for r in range(len(poles)):
            Q = np.linalg.qr(np.delete(A, r, axis=1))[0]
            own = A[:, r : r + 1]
            out[r] = self.envelope.inflation(own - Q @ (Q.conj().T @ own))[0]
        return out

    def derivatives(self, poles: _Complex) -> NDArray[Any]:
        """Return functions of which derivatives by the poles are sums, shape (rows, k or 2 k)."""
        own = 1.0 / (self.x[:, None] - poles) ** 2
        if not self.basis.mirrored:
            return np.asarray(own)
        image = 1.0 / (self.x[:, None] - poles.conj()) ** 2
        return self.basis.parts(np.hstack([own + image, 1j * (own - image)]))

    def mixed(self, residues: _Complex) -> NDArray[Any]:
        """Return the derivatives of the channels by the poles, in these functions, shape (p, k, k).

        Of a function of complex poles those by the poles; where poles have mirror images, by their
        real parts and then by their imaginary parts, shape (p, 2 k, 2 k).
        """
        k, p = residues.shape
        at = np.arange(k)
        if not self.basis.mirrored:
            out: NDArray[Any] = np.zeros((p, k, k), dtype=np.complex128)
            out[:, at, at] = residues.T
            return out
        out = np.zeros((p, 2 * k, 2 * k))
        out[:, at, at] = out[:, at + k, at + k] = residues.real.T
        out[:, at + k, at], out[:, at, at + k] = residues.imag.T, -residues.imag.T
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Noise of each channel: a share of its values, and a floor.

    Attributes
    ----------
    share, floor : ndarray of float, shape (p,)
        Variances: of the share, and of the floor in units of the channel.
    """

    share: _Real
    floor: _Real

    @classmethod
    def of(cls, squares: _Real, size: _Real) -> Noise:
        """Return the likeliest share and floor of exponentially distributed squares.

        Parameters
        ----------
        squares : ndarray of float, shape (p, n_f)
            Squared errors.
        size : ndarray of float, shape (p, n_f)
            Squared values without noise.

        Notes
        -----
        By multiplicative updates, which never become negative (C. Fevotte, N. Bertin &
        J.-L. Durrieu, Neural Comput. 21 (2009) 793-830, equation 4.2).
        """
        least = _ROUNDING**2 * size.max(axis=1) + _TINY
        floor = 0.5 * np.mean(squares, axis=1) + least
        share = floor / (np.mean(size, axis=1) + _TINY)
        for _ in range(_LIKELIER):
            u = 1.0 / (share[:, None] * size + floor[:, None])
            told = squares * u * u
            share = share * np.sum(size * told, axis=1) / (np.sum(size * u, axis=1) + _TINY)
            floor = np.maximum(floor * np.sum(told, axis=1) / np.sum(u, axis=1), least)
        return cls(share, floor)

    def deviation(self, size: _Real) -> _Real:
        """Return standard deviations, shape (p, n_f), of values with these squares."""
        return np.asarray(np.sqrt(self.share[:, None] * size + self.floor[:, None]))


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Standard deviations of values, as a product; one factor for all channels makes fits cheap.

    Attributes
    ----------
    channel : ndarray of float, shape (p, 1) or (1, 1)
        Of each channel.
    line : ndarray of float, shape (p, n_f) or (1, n_f)
        Of each line, in all channels alike or in each of them.
    """

    channel: _Real
    line: _Real

    @classmethod
    def of(cls, size: _Real) -> Weights:
        """Return weights by which all channels count alike, from squared values."""
        level = np.sqrt(np.mean(size, axis=1, keepdims=True)) + _TINY
        return cls(level, np.ones((1, size.shape[1])))

    @property
    def common(self) -> _Real:
        """Inverse deviations of the lines, the same for all channels, shape (n_f,)."""
        return np.asarray(np.exp(-np.mean(np.log(self.line), axis=0)))

    def of_channels(self, chosen: NDArray[np.bool_]) -> Weights:
        """Return the weights of some channels."""
        return Weights(*(a[chosen] if len(a) > 1 else a for a in (self.channel, self.line)))

    @classmethod
    def left_by(cls, fitted: Solved) -> Weights:
        """Return weights from the residual of a fit: the nearest product to share and floor."""
        return cls.near(Noise.of(fitted.squares, fitted.size).deviation(fitted.size))

    @classmethod
    def near(cls, deviation: _Real) -> Weights:
        """Return the product that is nearest to standard deviations, shape (p, n_f)."""
        level = np.exp(np.mean(np.log(deviation), axis=1, keepdims=True))
        return cls(level, np.exp(np.mean(np.log(deviation / level), axis=0, keepdims=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The fit of a window for given poles.

    Attributes
    ----------
    poles : ndarray of complex, shape (k,)
        Those that may move.
    residues : ndarray of complex, shape (k, p)
        Of each channel.
    error : ndarray of complex, shape (p, n_f)
        Residual of the fit.
    size : ndarray of float, shape (p, n_f)
        Squared values of the fit and of what was taken out before.
    weights : ndarray, shape (p, m)
        Of the columns of the window, of channels divided by their level.
    level : ndarray of float, shape (p, 1) or (1, 1)
        Of each channel.
    columns : Columns
        Of the window, decomposed.
    squared : ndarray of float, shape (p, n_f)
        Squared errors in units of their standard deviations.
    normals, gradients : ndarray, shapes (p, n, n) and (p, n)
        Of the cost of each channel by the poles, as `Window.mixed` has them.
    envelope : Envelope
        Of the noise.
    """

    poles: _Complex
    residues: _Complex
    error: _Complex
    size: _Real
    weights: NDArray[Any]
    level: _Real
    columns: Columns
    squared: _Real
    normals: NDArray[Any]
    gradients: NDArray[Any]
    envelope: Envelope
    cost: float = field(init=False)
    normal: NDArray[Any] = field(init=False)
    gradient: NDArray[Any] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", float(np.sum(self.squared)))
        for name in ("normal", "gradient"):
            object.__setattr__(self, name, np.sum(getattr(self, name + "s"), axis=0))

    @property
    def left(self) -> _Real:
        """Squared errors, shape (p, n_f)."""
        return np.asarray(np.abs(self.error) ** 2)

    @property
    def squares(self) -> _Real:
        """Squared errors, each divided by the share of noise that the fit leaves of it."""
        n_f, Q = self.error.shape[1], self.columns.Q
        if len(Q) > n_f:  # real and imaginary parts
            Q = Q[:n_f] + 1j * Q[n_f:]
        # Columns follow more of the noise if it is correlated over lines.
        left = 1.0 - np.mean(self.envelope.inflation(Q)) * self.columns.leverage()
        if left.shape[1] > n_f:  # real and imaginary parts
            left = 0.5 * (left[:, :n_f] + left[:, n_f:])
        return np.asarray(self.left / np.maximum(left, _LEFT))

    @property
    def own(self) -> list[list[int]]:
        """The columns of each pole: one, or two of a pole with a mirror image."""
        k = len(self.poles)
        if not np.isrealobj(self.weights):
            return [[r] for r in range(k)]
        images = np.cumsum(self.poles.imag != 0) - 1 + k
        return [[r, int(images[r])] if self.poles[r].imag != 0 else [r] for r in range(k)]

    @property
    def worths(self) -> _Real:
        """By how much the cost of each channel would grow without each pole, shape (k, p)."""
        out = np.zeros((len(self.poles), len(self.error)))
        for r, own in enumerate(self.own):
            found, spread = self.weights[:, own, None], self.columns.covariance(own)
            spread = spread + _TINY * np.eye(len(own))  # of a pole that others span
            out[r] = np.sum((found.conj() * np.linalg.solve(spread, found)).real, axis=(1, 2))
        return out

    @property
    def worth(self) -> _Real:
        """By how much the cost would grow without each pole, shape (k,)."""
        return np.asarray(np.sum(self.worths, axis=1))

    def damped(self, damping: float) -> tuple[_Complex, float]:
        """Return a step, the diagonal made larger by a share, and the decrease that it promises."""
        loaded = self.normal + damping * np.diag(np.diag(self.normal))
        step = np.linalg.lstsq(loaded, self.gradient, rcond=None)[0]
        promised = float(np.vdot(self.gradient, step).real)
        k = len(self.poles)
        return np.asarray(step if len(step) == k else step[:k] + 1j * step[k:]), promised

    @property
    def deviation(self) -> _Real:
        """Standard deviations of the poles' real and imaginary parts, shape (2, k).

        They hold where the errors were weighted with their own standard deviations.
        """
        k = len(self.poles)
        spread = np.linalg.lstsq(self.normal, np.eye(len(self.normal)), rcond=None)[0]
        both = np.sqrt(np.maximum(np.diag(spread).real, 0.0) / 2.0)
        return np.array([both[:k], both[-k:]])


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Random errors of the residues of a pole.

    Attributes
    ----------
    noise : ndarray of float, shape (p,)
        Variances of those that come from the noise at given poles, independent from channel to
        channel and of all phases alike.
    common : ndarray of complex, shape (q, p)
        What comes from the errors of the poles: these rows times independent errors of unit
        variance.
    """

    noise: _Real
    common: _Complex

    @classmethod
    def none(cls, p: int) -> Errors:
        """Return those of data without noise."""
        return cls(np.zeros(p), np.zeros((0, p), dtype=np.complex128))


def deviance(fitted: Solved) -> float:
    """Return -2 log of the likelihood of a fit with its likeliest noise, up to a constant."""
    variance = Noise.of(fitted.squares, fitted.size).deviation(fitted.size) ** 2
    return 2.0 * float(np.sum(np.log(variance) + fitted.left / variance))


def pole_deviation(window: Window, fitted: Solved, weights: Weights) -> _Real:
    """Return standard deviations of the poles' real and imaginary parts, shape (2, k).

    In noise with the deviations of the weights, correlated over lines as the envelope says.
    """
    own = np.sqrt(window.inflation(fitted.poles, weights, moving=True))
    return np.asarray(fitted.deviation * own)


def errors_of(window: Window, fitted: Solved, weights: Weights) -> list[Errors]:
    """Return the errors of the residues of each pole, in noise as for `pole_deviation`.

    Of the normal equations of poles and residues together: residues follow the poles by
    -A^+ dA/dpoles, and at the poles fitted have the noise of a linear fit.
    """
    basis, k, p = window.basis, len(fitted.poles), len(window.Y)
    follow = fitted.columns.beyond(window.derivatives(fitted.poles))[1]
    follow = -np.matmul(follow, window.mixed(fitted.residues / fitted.level.T))
    values, vectors = np.linalg.eigh(fitted.normal)
    kept = values > len(values) * np.finfo(float).eps * values.max(initial=0.0)
    spread = np.matmul(follow, vectors[:, kept] / np.sqrt(2.0 * values[kept]))  # (p, m, q)
    common = np.array([basis.residues(one, fitted.poles) for one in spread.T]).reshape(-1, k, p)
    common = common * fitted.level.T
    if not basis.mirrored:
        common = np.concatenate([common, 1j * common])  # of both parts of the poles
    errors = []
    residue = window.inflation(fitted.poles, weights)
    pole = np.sqrt(window.inflation(fitted.poles, weights, moving=True))
    for r, own in enumerate(fitted.own):
        noise = np.trace(fitted.columns.covariance(own), axis1=1, axis2=2).real
        noise = np.broadcast_to(noise * (0.5 if basis.mirrored else 1.0), p)
        noise = noise * residue[r] * fitted.level[:, 0] ** 2
        errors.append(Errors(noise, common[:, r] * pole[r]))
    return errors


def reweighted(
    window: Window, poles: _Complex, weights: Weights, gain: float = GAIN
) -> tuple[Solved, Weights]:
    """Return the fit with the likeliest poles where the noise is not known, and its weights.

    Parameters
    ----------
    window : Window
        Lines and what else there is.
    poles : ndarray of complex, shape (k,)
        To begin with.
    weights : Weights
        To begin with; then those of the residual.
    gain : float
        Steps that would lower the cost by less are left out.
    """
    fitted = moved(window, poles, weights, gain)
    for _ in range(_ALIKE):
        weights = Weights.left_by(fitted)
        fitted = moved(window, fitted.poles, weights, gain)
    return fitted, weights


def moved(window: Window, poles: _Complex, weights: Weights, gain: float = GAIN) -> Solved:
    """Return the fit with the poles moved to where the cost is smallest, as `reweighted`."""
    here, damping = solved(window, poles, weights), 0.0
    widths = window.width(poles)  # no step is longer
    for _ in range(_STEPS if len(poles) else 0):
        step, promised = here.damped(damping)
        longest = float(np.max(np.abs(step) / widths, initial=0.0))
        if longest < _SETTLED or promised < gain * min(1.0, here.cost):
            break
        there = solved(window, here.poles + step / max(1.0, longest), weights)
        if there.cost <= here.cost:
            here, damping = there, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-3)
    return here


def solved(window: Window, poles: _Complex, weights: Weights) -> Solved:
    """Return the fit with given poles, by linear least squares.

    Parameters
    ----------
    window : Window
        Lines and what else there is.
    poles : ndarray of complex, shape (k,)
        Where they are.
    weights : Weights
        Of the values.
    """
    basis, n_f = window.basis, len(window.x)
    # Channels without signal have next to no noise.
    own = np.exp(np.mean(np.log(weights.line), axis=1, keepdims=True))
    level, line = weights.channel * own, weights.line / own
    Y = window.Y / level
    if basis.mirrored:
        line, Y = np.hstack([line, line]), np.hstack([Y.real, Y.imag])
    columns = Columns.of(window.columns(poles), line)
    found, error = columns.fitted(Y)
    squared, weighted = columns.squared(error), columns.weighted(error)
    if basis.mirrored:
        squared = squared[:, :n_f] + squared[:, n_f:]
        error = error[:, :n_f] + 1j * error[:, n_f:]
    error = error * level
    residues = basis.residues(found.T * level.T, poles)
    functions = window.derivatives(poles)
    mixed = window.mixed(residues / level.T)
    back = mixed.conj().swapaxes(1, 2)
    normals = np.matmul(back, np.matmul(columns.beyond(functions)[0], mixed))
    gradients = np.matmul(back, (weighted @ functions.conj())[:, :, None])[:, :, 0]
    size = np.abs(window.Y + window.apart - error) ** 2
    return Solved(
        poles,
        residues,
        error,
        size,
        found,
        level,
        columns,
        squared,
        normals,
        gradients,
        window.envelope,
    )
