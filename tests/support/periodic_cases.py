"""Small models with nonlinear elements, their balances, and time integration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

import updyn
from updyn.dynamics.periodic.balance import Balance, make_fourier
from updyn.dynamics.periodic.transfer import Transfer

K2 = np.array([[300.0, -200.0], [-200.0, 200.0]])
M2 = np.diag([1.0, 1.5])


def oscillator(*, loss: float = 0.0, viscous: float = 0.0, mass: float = 1.0) -> updyn.Model:
    """One DOF of stiffness 1."""
    return updyn.Model.from_groups(
        {
            "spring": updyn.Group([[1.0]], loss_factor=loss),
            "mass": updyn.Group(mass=[[mass]], viscous=[[viscous]] if viscous else None),
        },
        ["1:X"],
    )


def two_masses(**damping: float) -> updyn.Model:
    """Two DOFs, held at one end."""
    groups = {"springs": updyn.Group(K2, **damping), "masses": updyn.Group(mass=M2)}
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def balance_of(
    model: updyn.Model, harmonics: int, samples: int = 256, level: float = 1.0
) -> Balance:
    """The balance of a small model, force and response at its last DOF."""
    at = np.array([model.n_dofs - 1])
    transfer = Transfer.build(
        model,
        at,
        at,
        (0.1, 1.0),
        np.array([0.1, 1.0]),
        tier="dense",
        backend=None,
        accuracy=1e-6,
    )
    elements = [local.element for local in model.nonlinear.values()]
    is_free = transfer.static is None
    fourier = make_fourier(is_free=is_free, harmonics=harmonics, samples=samples)
    return Balance(elements, transfer, fourier, level)


def sample(harmonics: np.ndarray, n: int = 256, rate: float = 0.0) -> np.ndarray:
    """Samples of a period, (n_dofs, n), of harmonics (n_h, n_dofs), or of the derivative."""
    k = np.arange(len(harmonics))[:, None]
    amplitudes = harmonics * (1j * k * rate if rate else 1.0)
    return np.real(amplitudes.T @ np.exp(2j * np.pi * k * np.arange(n) / n))


def integrate(
    state: np.ndarray, M: np.ndarray, rest: Callable[..., np.ndarray], omega: float, n: int = 256
) -> np.ndarray:
    """One period of M q'' = rest(t, q, q') from a state (q, q'): displacements (n_dofs, n)."""
    n_dofs = len(M)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        return np.append(y[n_dofs:], np.linalg.solve(M, rest(t, y[:n_dofs], y[n_dofs:])))

    times = 2 * np.pi / omega * np.arange(n) / n
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}
    found = solve_ivp(slope, (0.0, times[-1]), state, t_eval=times, **options)
    return found.y[:n_dofs]


def simulate_random(
    model: updyn.Model,
    K: np.ndarray,
    C: np.ndarray,
    freq: np.ndarray,
    level: float,
    *,
    realisations: int,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """H1 of unit masses under multisines of random phase at the first, with standard errors.

    Lines are multiples of their distance, whose inverse is the period; the fourth-order Runge-Kutta
    method passes two periods before the one that is evaluated. The results are (n_f, n).
    """
    rng, n, spacing = np.random.default_rng(1), len(K), freq[1] - freq[0]
    h, at = 1.0 / spacing / steps, np.rint(freq / spacing).astype(int)
    share = np.ones(len(freq))  # the ends belong to half of their interval
    share[[0, -1]] = 0.5
    amplitude = level * np.sqrt(2.0 * share / (len(freq) - 1))
    F = np.zeros((realisations, steps + 1), dtype=complex)
    F[:, at] = amplitude * np.exp(2j * np.pi * rng.random((realisations, len(at))))
    force = np.fft.irfft(F, 2 * steps) * steps
    elements = [(one.element, one.column(model.dofs)) for one in model.nonlinear.values()]

    def slope(y: np.ndarray, f: np.ndarray) -> np.ndarray:
        q, v = y[:, :n], y[:, n:]
        a = -q @ K - v @ C
        a[:, 0] += f
        for element, w in elements:
            a -= element.over_period(q @ w, v @ w).force[:, None] * w
        return np.hstack([v, a])

    y, motion = np.zeros((realisations, 2 * n)), np.empty((steps, realisations, n))
    for i in range(3 * steps):
        now = 2 * (i % steps)
        a, b, c = force[:, now], force[:, now + 1], force[:, (now + 2) % (2 * steps)]
        motion[i % steps] = y[:, :n]
        k1 = slope(y, a)
        k2 = slope(y + 0.5 * h * k1, b)
        k3 = slope(y + 0.5 * h * k2, b)
        k4 = slope(y + h * k3, c)
        y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    H = 2.0 / steps * np.fft.fft(motion, axis=0)[at] / F[:, at].T[:, :, None]
    return H.mean(axis=1), H.std(axis=1) / np.sqrt(realisations - 1)
