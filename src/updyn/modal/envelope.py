"""Correlation of noise over neighbouring lines, as its power over the time of the record.

The noise of FRFs from records of finite length is smooth over several lines: its correlation over
lines is the transform of its power over time (Wiener and Khinchin). A test that assumes independent
lines would identify ripples of the noise as modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, NumberArray, RealArray
from updyn.modal.settings import CHANNEL_FIT, NOISE_ENVELOPE

__all__ = ["Envelope"]


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """Power of the noise, shape (m,), mean 1, at even times over the period 1 / (line distance).

    A single value is white noise, with independent lines.
    """

    power: RealArray

    @classmethod
    def white(cls) -> Envelope:
        """Return the envelope of noise that is independent from line to line."""
        return cls(np.ones(1))

    @property
    def is_white(self) -> bool:
        """Whether all lines are independent."""
        return len(self.power) == 1

    @classmethod
    def of(cls, freq: RealArray, values: ComplexArray) -> Envelope:
        """Estimate the envelope from measured functions, (n_f, ...), before any mode is known.

        It is white if lines are uneven or too few.
        """
        steps, lines = np.diff(freq), NOISE_ENVELOPE.part_lines
        if len(freq) < lines * NOISE_ENVELOPE.least_parts // 2:
            return cls.white()
        if np.ptp(steps) > NOISE_ENVELOPE.spacing_tolerance * np.mean(steps):
            return cls.white()
        y = values.reshape(len(freq), -1)
        exponents = np.arange(NOISE_ENVELOPE.polynomial_degree + 1)
        Q = np.linalg.qr(np.linspace(-1.0, 1.0, lines)[:, None] ** exponents)[0]
        taper = np.hanning(lines + 2)[1:-1, None]
        parts = []
        for first in range(0, len(freq) - lines + 1, lines // 2):
            part = y[first : first + lines]
            over_time = _power_over_time(taper * (part - Q @ (Q.T @ part)))
            level = np.mean(over_time, axis=0)
            if (level > 0.0).any():
                parts.append(over_time[:, level > 0.0] / level[level > 0.0])
        if not parts:
            return cls.white()
        smallest = CHANNEL_FIT.smallest_divisor
        flatness = [float(np.mean(np.log(np.mean(part, axis=1) + smallest))) for part in parts]
        count = max(1, round(NOISE_ENVELOPE.flattest_share * len(parts)))
        chosen = np.argsort(flatness)[::-1][:count]
        response = _power_response(taper * (np.eye(lines) - Q @ Q.T))
        return cls(_estimate_power([np.hstack([parts[k] for k in chosen])], [response]))

    @classmethod
    def of_residuals(cls, residuals: Sequence[tuple[ComplexArray, ComplexArray]]) -> Envelope:
        """Estimate the envelope from the residuals of fits; white if values are too few.

        For each window of n lines, `residuals` has columns Q, shape (n, m), with Q Q^H the
        projection on the fit, and residuals in units of their standard deviations, shape (p, n).
        """
        powers, responses = [], []
        for Q, residual in residuals:
            for part in _split_lines(len(Q)):
                taper = np.hanning(part.stop - part.start + 2)[1:-1, None]
                over_time = _power_over_time(taper * residual.T[part], NOISE_ENVELOPE.part_lines)
                level = np.mean(over_time, axis=0)
                if not (level > 0.0).any():
                    continue
                # The fit transfers little noise from outside the part into it.
                left = np.eye(len(taper)) - Q[part] @ Q[part].conj().T
                powers.append(over_time[:, level > 0.0])
                responses.append(_power_response(taper * left))
        if sum(power.shape[1] for power in powers) < NOISE_ENVELOPE.least_parts:
            return cls.white()
        return cls(_estimate_power(powers, responses))

    def inflation(self, columns: NumberArray) -> RealArray:
        """Return the variance of noise projections relative to white noise, (k,), at least 1.

        Noise of unit variance is projected on `columns`, functions of n neighbouring lines, shape
        (n, k).
        """
        if self.is_white:
            return np.ones(columns.shape[1])
        n = max(len(columns), len(self.power))
        smallest = CHANNEL_FIT.smallest_divisor
        columns = columns / np.maximum(np.max(np.abs(columns), axis=0), smallest)
        over_time = _power_over_time(columns, n)
        at = np.arange(n) * (len(self.power) / n)
        power = np.interp(at, np.arange(len(self.power) + 1), np.append(self.power, self.power[0]))
        share = power @ over_time / np.maximum(np.sum(over_time, axis=0), smallest)
        return np.asarray(np.maximum(share, 1.0))


def _power_over_time(columns: ComplexArray | RealArray, n: int | None = None) -> RealArray:
    return np.asarray(np.abs(np.fft.ifft(columns, n, axis=0)) ** 2)


def _split_lines(n: int) -> Iterator[slice]:
    """Yield the parts of n lines for one estimate each; none for too few lines."""
    if n < NOISE_ENVELOPE.part_lines // 4:
        return
    edges = np.linspace(0, n, -(-n // NOISE_ENVELOPE.part_lines) + 1).astype(int).tolist()
    for first, last in pairwise(edges):
        yield slice(first, last)


def _power_response(response: ComplexArray | RealArray) -> RealArray:
    """Return the mean power of functions at each time by the power of the noise at each time.

    `response`, shape (n, m), is the linear map from m lines of noise to n lines of the functions.
    """
    m, times = response.shape[1], NOISE_ENVELOPE.part_lines
    turns = np.exp(2j * np.pi * np.outer(np.arange(m), np.arange(times)) / -times)
    return np.asarray(_power_over_time(response @ turns, times) / m)


def _estimate_power(powers: Sequence[RealArray], responses: Sequence[RealArray]) -> RealArray:
    """Return the estimated power over time, with mean 1, by a fixed-point iteration.

    `powers` have the shape (m, p), `responses`, (m, m), are from `_power_response`.
    """
    # Medians of measured over expected powers are used, because a mode in one part would raise the
    # mean; for exponentially distributed powers the median is log 2 times the mean.
    whole = np.ones(NOISE_ENVELOPE.part_lines)
    response_at_time = np.mean([np.sum(r, axis=1) for r in responses], axis=0)
    known = response_at_time > NOISE_ENVELOPE.least_remaining_share * np.max(response_at_time)
    for _ in range(NOISE_ENVELOPE.iterations):
        ratios = []
        for power, response in zip(powers, responses, strict=True):
            ratio = power / (response @ whole + CHANNEL_FIT.smallest_divisor)[:, None]
            ratios.append(ratio / np.mean(ratio, axis=0))
        whole = whole * np.median(np.hstack(ratios), axis=1) / np.log(2.0)
        whole = _extrapolate_power(whole, known)
    return whole


def _extrapolate_power(power: RealArray, known: BoolArray) -> RealArray:
    """Return the power over time, with mean 1, extrapolated to times around 0."""
    # The extrapolation, from the powers just after and (time is periodic) just before, is
    # exponential, like the decay of records with an exponential window.
    at = np.flatnonzero(known)
    first, last = int(at[0]), int(at[-1])
    logs = np.log(power + CHANNEL_FIT.smallest_divisor)
    whole = power.copy()
    near = at[: NOISE_ENVELOPE.extrapolation_times]
    slope, level = np.polyfit(near, logs[near], 1)
    whole[:first] = np.exp(level + min(slope, 0.0) * np.arange(first))
    whole[last + 1 :] = np.mean(power[at[-2:]])
    return np.asarray(whole / np.mean(whole))
