"""Records of hits on a structure with viscous modes, whose answer is known at every instant."""

from __future__ import annotations

import numpy as np

from updyn.signals.records import Records

#: Natural frequencies in Hz, damping ratios, and modal constants (1/kg) of two responses.
FREQUENCY = np.array([12.0, 31.0, 55.0])
DAMPING = np.array([0.02, 0.01, 0.015])
CONSTANTS = np.array([[0.5, 0.3, 0.2], [0.4, -0.35, 0.1]])
STEP = 1.0 / 512.0


def displacement(force: np.ndarray, step: float = STEP) -> np.ndarray:
    """Displacements under forces that are straight lines between samples, shape (2, n).

    Each mode's state is carried on exactly: Craig and Kurdila, Fundamentals of Structural Dynamics
    (2006), section 6.2, in complex form.
    """
    out = np.zeros((2, len(force)))
    for f, zeta, constants in zip(FREQUENCY, DAMPING, CONSTANTS.T, strict=True):
        omega = 2.0 * np.pi * f
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        grown = np.exp(pole * step)
        # Of q' = pole q + p over a step, p going straight from p0 to p1.
        held = (grown - 1.0) / pole
        rising = (grown - 1.0 - pole * step) / (pole**2 * step)
        q, answer = 0j, np.zeros(len(force))
        for k in range(1, len(force)):
            q = grown * q + held * force[k - 1] + rising * (force[k] - force[k - 1])
            answer[k] = q.imag / pole.imag
        out += constants[:, None] * answer
    return out


def receptance(freq: np.ndarray) -> np.ndarray:
    """Receptances of the two responses to the samples of the force, shape (n_f, 2).

    The spectrum of straight lines between samples is that of the samples times sinc^2.
    """
    omega, own = 2.0 * np.pi * freq[:, None], 2.0 * np.pi * FREQUENCY
    exact = (1.0 / (own**2 - omega**2 + 2j * DAMPING * own * omega)) @ CONSTANTS.T
    return exact * np.sinc(freq[:, None] * STEP) ** 2


def pulse(n: int, at: int = 20, width: int = 3, size: float = 100.0) -> np.ndarray:
    """About half a sine of force, N, somewhat steeper in front, so that no line is quite zero."""
    force, share = np.zeros(n), np.arange(width + 1) / width
    force[at : at + width + 1] = size * np.sin(np.pi * share) * (1.0 - 0.3 * share)
    return force


def records(n_hits: int = 4, seconds: float = 8.0, noise: float = 0.0, seed: int = 0) -> Records:
    """Hits of other sizes on the structure; noise as a share of each channel's largest value."""
    rng, values = np.random.default_rng(seed), []
    for _ in range(n_hits):
        force = pulse(round(seconds / STEP), size=float(rng.uniform(80.0, 160.0)))
        values.append(np.vstack([force, displacement(force)]))
    exact = np.array(values)
    size = np.abs(exact).max(axis=2, keepdims=True)
    measured = exact + noise * size * rng.standard_normal(exact.shape)
    return Records.of(measured, STEP, ["hammer", "1:Z", "2:Z"], ["N", "m", "m"])
