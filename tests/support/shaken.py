"""Records of random forces on a structure with structural damping, cut out of a long period."""

from __future__ import annotations

import numpy as np

from updyn.signals.records import Records

#: Natural frequencies in Hz, loss factors, and shapes at two responses and two forces.
FREQUENCY = np.array([21.0, 34.0, 61.0])
LOSS = np.array([0.01, 0.006, 0.015])
RESPONSES = np.array([[1.0, 0.7, 0.5], [0.6, -0.8, 0.4]])
FORCES = np.array([[1.0, 0.7, 0.5], [-0.5, 0.9, 0.6]])
STEP = 1.0 / 256.0
NAMES = (("a", "b"), ("p", "q"))
#: The period is so many times as long as a record.
_PERIODS = 5


def accelerance(freq: np.ndarray, forces: int = 1) -> np.ndarray:
    """Accelerances, shape (n_f, 2, forces): sums over the modes."""
    omega = 2.0 * np.pi * freq[:, None]
    own = 2.0 * np.pi * FREQUENCY
    each = -(omega**2) / (own**2 * (1.0 + 1j * LOSS) - omega**2)
    return np.einsum("fm,im,jm->fij", each, RESPONSES, FORCES[:forces])


def records(
    seconds: float,
    *,
    noise: tuple[float, float] = (0.0, 0.0),
    force_noise: float = 0.0,
    forces: int = 1,
    n: int = 1,
    seed: int = 0,
) -> Records:
    """Records that begin and end amid the vibration; noise as shares of the rms of a channel.

    The response to a force of a long period is exact at the lines of the period; a part of that
    period has transients at both ends.
    """
    rng, size, parts = np.random.default_rng(seed), round(seconds / STEP), []
    freq = np.fft.rfftfreq(_PERIODS * size, STEP)
    H = accelerance(freq, forces)
    for _ in range(n):
        force = rng.standard_normal((forces, _PERIODS * size))
        spectrum = np.einsum("fij,jf->if", H, np.fft.rfft(force, axis=1))
        motion = np.fft.irfft(spectrum, _PERIODS * size, axis=1)[:, :size]
        level = np.array(noise) * motion.std(axis=1)
        motion = motion + level[:, None] * rng.standard_normal(motion.shape)
        measured = force[:, :size] + force_noise * rng.standard_normal((forces, size))
        parts.append(np.vstack([measured, motion]))
    names = (*NAMES[0][:forces], *NAMES[1])
    return Records.of(parts, STEP, names, ["N"] * forces + ["m/s^2"] * 2)
