"""Correlation of noise over neighbouring lines, as its power over the time of the record.

The noise of FRFs from records of finite length is smooth over several lines: its correlation over
lines is the transform of its power over time (Wiener and Khinchin). A test that assumes independent
lines would identify ripples of the noise as modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Envelope"]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

#: Lines of a part of the band for one estimate. It gives as many values of the power over time,
#: enough to resolve an exponential window that ends at 1 %.
_LINES = 64
#: Smallest number of parts of measured functions, since each may contain modes, and of residual
#: functions, whose median is taken.
_PARTS = 8
#: Degree of the polynomial that is removed from a part, for the modes outside it.
_DEGREE = 3
#: Share of the parts that is used. Modes concentrate power at short times, so the parts with the
#: flattest power are those of noise.
_SHARE = 0.25
#: Times at which the polynomial removes more than this share of white noise are not estimated: the
#: estimate would be the ratio of two small numbers.
_REMOVED = 0.5
#: Number of subsequent times from which the power is extrapolated to these: white noise is then
#: raised by less than 5 % at time 0 on average.
_NEAREST = 12
#: Relative tolerance of even line spacing, for the rounding in files.
_EVEN = 1e-3
#: Rounds of the fixed-point iteration. After the first, the last 2 % of an exponential window have
#: several times their power, because the taper mixes neighbouring times; more rounds amplify random
#: errors.
_ROUNDS = 2
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """Power of the noise, shape (m,), mean 1, at even times over the period 1 / (line distance).

    A single value is white noise, with independent lines.
    """

    power: _Real

    @classmethod
    def white(cls) -> Envelope:
        """Return the envelope of noise that is independent from line to line."""
        return cls(np.ones(1))

    @property
    def is_white(self) -> bool:
        """Whether all lines are independent."""
        return len(self.power) == 1

    @classmethod
    def of(cls, freq: _Real, values: _Complex) -> Envelope:
        """Estimate the envelope from measured functions, (n_f, ...), before any mode is known.

        It is white if lines are uneven or too few.
        """
        steps = np.diff(freq)
        if len(freq) < _LINES * _PARTS // 2 or np.ptp(steps) > _EVEN * np.mean(steps):
            return cls.white()
        y = values.reshape(len(freq), -1)
        powers = np.linspace(-1.0, 1.0, _LINES)[:, None] ** np.arange(_DEGREE + 1)
        Q = np.linalg.qr(powers)[0]
        taper = np.hanning(_LINES + 2)[1:-1, None]
        parts = []
        for first in range(0, len(freq) - _LINES + 1, _LINES // 2):
            part = y[first : first + _LINES]
            over_time = _power_over_time(taper * (part - Q @ (Q.T @ part)))
            level = np.mean(over_time, axis=0)
            if (level > 0.0).any():
                parts.append(over_time[:, level > 0.0] / level[level > 0.0])
        if not parts:
            return cls.white()
        flatness = [float(np.mean(np.log(np.mean(part, axis=1) + _TINY))) for part in parts]
        chosen = np.argsort(flatness)[::-1][: max(1, round(_SHARE * len(parts)))]
        response = _power_response(taper * (np.eye(_LINES) - Q @ Q.T))
        return cls(_estimate_power([np.hstack([parts[k] for k in chosen])], [response]))

    @classmethod
    def of_residuals(cls, residuals: Sequence[tuple[_Complex, NDArray[np.complex128]]]) -> Envelope:
        """Estimate the envelope from the residuals of fits; white if values are too few.

        For each window of n lines, `residuals` has columns Q, shape (n, m), with Q Q^H the
        projection on the fit, and residuals in units of their standard deviations, shape (p, n).
        """
        powers, responses = [], []
        for Q, residual in residuals:
            for part in _split_lines(len(Q)):
                taper = np.hanning(part.stop - part.start + 2)[1:-1, None]
                over_time = _power_over_time(taper * residual.T[part], _LINES)
                level = np.mean(over_time, axis=0)
                if not (level > 0.0).any():
                    continue
                # The fit transfers little noise from outside the part into it.
                left = np.eye(len(taper)) - Q[part] @ Q[part].conj().T
                powers.append(over_time[:, level > 0.0])
                responses.append(_power_response(taper * left))
        if sum(power.shape[1] for power in powers) < _PARTS:
            return cls.white()
        return cls(_estimate_power(powers, responses))

    def inflation(self, columns: NDArray[Any]) -> _Real:
        """Return the variance of noise projections relative to white noise, (k,), at least 1.

        Noise of unit variance is projected on `columns`, functions of n neighbouring lines, shape
        (n, k).
        """
        if self.is_white:
            return np.ones(columns.shape[1])
        n = max(len(columns), len(self.power))
        columns = columns / np.maximum(np.max(np.abs(columns), axis=0), _TINY)
        over_time = _power_over_time(columns, n)
        at = np.arange(n) * (len(self.power) / n)
        power = np.interp(at, np.arange(len(self.power) + 1), np.append(self.power, self.power[0]))
        share = power @ over_time / np.maximum(np.sum(over_time, axis=0), _TINY)
        return np.asarray(np.maximum(share, 1.0))


def _power_over_time(columns: NDArray[np.complex128] | _Real, n: int | None = None) -> _Real:
    """Return the power over time of functions of lines."""
    return np.asarray(np.abs(np.fft.ifft(columns, n, axis=0)) ** 2)


def _split_lines(n: int) -> Iterator[slice]:
    """Yield the parts of n lines for one estimate each; none for too few lines."""
    if n < _LINES // 4:
        return
    edges = np.linspace(0, n, -(-n // _LINES) + 1).astype(int).tolist()
    for first, last in pairwise(edges):
        yield slice(first, last)


def _power_response(response: NDArray[np.complex128] | _Real) -> _Real:
    """Return the mean power of functions at each time by the power of the noise at each time.

    `response`, shape (n, m), is the linear map from m lines of noise to n lines of the functions.
    """
    turns = np.exp(2j * np.pi * np.outer(np.arange(response.shape[1]), np.arange(_LINES)) / -_LINES)
    return np.asarray(_power_over_time(response @ turns, _LINES) / response.shape[1])


def _estimate_power(powers: Sequence[_Real], responses: Sequence[_Real]) -> _Real:
    """Return the estimated power over time, with mean 1, by a fixed-point iteration.

    `powers` have the shape (m, p), `responses`, (m, m), are from `_power_response`. Medians of
    measured over expected powers are used, because a mode in one part would raise the mean; for
    exponentially distributed powers the median is log 2 times the mean.
    """
    whole = np.ones(_LINES)
    response_at_time = np.mean([np.sum(r, axis=1) for r in responses], axis=0)
    known = response_at_time > _REMOVED * np.max(response_at_time)
    for _ in range(_ROUNDS):
        ratios = []
        for power, response in zip(powers, responses, strict=True):
            ratio = power / (response @ whole + _TINY)[:, None]
            ratios.append(ratio / np.mean(ratio, axis=0))
        whole = whole * np.median(np.hstack(ratios), axis=1) / np.log(2.0)
        whole = _extrapolate_power(whole, known)
    return whole


def _extrapolate_power(power: _Real, known: NDArray[np.bool_]) -> _Real:
    """Return the power over time, with mean 1, extrapolated to times around 0.

    The extrapolation, from the powers just after and (time is periodic) just before, is
    exponential, like the decay of records with an exponential window.
    """
    at = np.flatnonzero(known)
    first, last = int(at[0]), int(at[-1])
    logs = np.log(power + _TINY)
    whole = power.copy()
    near = at[:_NEAREST]
    slope, level = np.polyfit(near, logs[near], 1)
    whole[:first] = np.exp(level + min(slope, 0.0) * np.arange(first))
    whole[last + 1 :] = np.mean(power[at[-2:]])
    return np.asarray(whole / np.mean(whole))
