"""A drive that is free to turn, with a gap in one mesh, against time integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import updyn
from periodic_cases import balance_of, sample
from updyn.dynamics.periodic.at_lines import LineBalance
from updyn.dynamics.periodic.first import solve_first

M = np.diag([2.0, 1.0, 1.5, 4.0])
MESH = np.array([0.0, 1.0, -1.0, 0.0])
SHAFTS = 400.0 * np.outer([1.0, -1.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0])
SHAFTS += 900.0 * np.outer([0.0, 0.0, 1.0, -1.0], [0.0, 0.0, 1.0, -1.0])
DRAG, RATE = np.diag([0.8, 0.0, 0.0, 1.5]), 0.008
LABELS = [f"{n}:RZ" for n in (1, 2, 3, 4)]
GAP = updyn.Backlash(700.0, gap=0.02)


def drive(*, damping: float = 1.0, friction: float = 0.0) -> updyn.Model:
    """Two inertias on a shaft, and two more beyond a mesh with a gap; nothing is held."""
    groups = {
        "shafts": updyn.Group(SHAFTS, stiffness_damping=damping * RATE),
        "inertias": updyn.Group(mass=M, viscous=damping * DRAG if damping else None),
    }
    model = updyn.Model.from_groups(groups, LABELS)
    elements = {"mesh": (GAP, ["2:RZ", "3:RZ"])}
    if friction:
        elements["motor"] = (updyn.CoulombFriction(friction, transition=0.05), ["1:RZ"])
    return model.with_elements(elements)


def integrate(model: updyn.Model, omega: float, F: float, start: np.ndarray, periods: int):
    """Velocities and twist of the mesh over the last of some periods."""
    friction = model.nonlinear["motor"].element if "motor" in model.nonlinear else None

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:4], y[4:]
        u = MESH @ q
        T = GAP.stiffness * (u - np.clip(u, -GAP.half, GAP.half))
        f = -SHAFTS @ q - (DRAG + RATE * SHAFTS) @ v - MESH * T
        f[0] += F * np.cos(omega * t)
        if friction is not None:
            f[0] -= friction.level * np.tanh(v[0] / friction.transition)
        return np.append(v, f / np.diag(M))

    period = 2 * np.pi / omega
    times = period * (periods - 1 + np.arange(256) / 256)
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "max_step": period / 100}
    found = solve_ivp(slope, (0.0, times[-1]), start, t_eval=times, **options)
    return found.y[4:], MESH @ found.y[:4]


@pytest.mark.parametrize(("friction", "freq"), [(0.0, 1.75), (0.6, 2.0)])
def test_a_loose_free_drive_is_the_time_response(friction: float, freq: float) -> None:
    """Torque at the motor beyond that at which the motion leaves the gap."""
    model, F, omega = drive(friction=friction), 6.0, 2 * np.pi * freq
    found = updyn.response(model, [freq], LABELS, LABELS[:1], level=F, harmonics=41, samples=8192)
    assert found.stable.all()
    A = found.harmonics[0, :, :, 0]
    twist, expected = sample(A @ MESH[:, None])[0], sample(A, rate=omega)
    assert np.abs(twist).max() > 3.0 * GAP.half
    start = np.append(sample(A, 1)[:, 0], sample(A, 1, rate=omega)[:, 0])
    speeds, over_time = integrate(model, omega, F, start, 30)
    error = np.fft.rfft(speeds - expected)[:, :8] / np.abs(np.fft.rfft(expected)).max()
    assert np.abs(error).max() < 1e-6
    assert np.abs(over_time - twist).max() < 3e-5 * np.abs(twist).max()


def test_a_force_beyond_its_turning_point_is_reached() -> None:
    """Below the resonance of the mesh, the motion in the gap ends at some force, and jumps.

    One harmonic: with J the inertia over the mesh at this frequency, F = |J w^2 - N(A)| A.
    """
    model = updyn.Model.from_groups(
        {"inertias": updyn.Group(mass=np.diag([1.0, 1.0]), viscous=np.diag([0.01, 0.01]))},
        ["1:RZ", "2:RZ"],
    ).with_elements({"mesh": (updyn.Backlash(100.0, gap=2.0), ["1:RZ", "2:RZ"])})
    freq = [0.8, 0.9]
    ends = ["1:RZ", "2:RZ"]
    with pytest.warns(updyn.UpdynWarning):
        found = updyn.response(model, freq, ends, ends[:1], level=50.0, harmonics=1, samples=4096)
    for f, value in zip(freq, found.values[:, :, 0], strict=True):
        omega, A = 2 * np.pi * f, 50.0 * (value[0] - value[1])
        N = complex(updyn.Backlash(100.0, gap=2.0).describing(abs(A), omega))
        twist = (0.5 * (0.01j * omega - omega**2) + N) * A
        assert twist == pytest.approx(0.5 * 50.0, rel=1e-5)
        assert N.real > 0.5 * omega**2


def test_lines_beyond_an_undamped_resonance_are_found() -> None:
    """The branch ends at a resonance without damping, at which the motion is infinite."""
    model = drive(damping=0.0)
    freq = np.linspace(3.9, 4.7, 7)
    found = updyn.response(model, freq, LABELS, LABELS[:1], level=6.0, harmonics=5)
    for i, f in enumerate(freq):
        # The balance of all degrees of freedom at each harmonic.
        Q, omega = found.harmonics[i, :, :, 0], 2 * np.pi * f
        T = np.fft.rfft(GAP.over_period(sample(Q @ MESH[:, None], 512)[0], np.zeros(512)).force)
        for k in (1, 3, 5):
            F = 6.0 * (k == 1) * np.eye(4)[0] - MESH * T[k] / 256.0
            error = (SHAFTS - (k * omega) ** 2 * M) @ Q[k] - F
            assert np.abs(error).max() < 1e-8 * 6.0


def test_a_line_of_an_update_is_reached_through_turning_points() -> None:
    model = updyn.Model.from_groups(
        {"inertias": updyn.Group(mass=np.diag([1.0, 1.0]), viscous=np.diag([0.01, 0.01]))},
        ["1:RZ", "2:RZ"],
    ).with_elements({"mesh": (updyn.Backlash(100.0, gap=2.0), ["1:RZ", "2:RZ"])})
    balance, omega = balance_of(model, 3, level=50.0), 5.0
    expected = solve_first(balance, omega)
    assert expected is not None
    H = balance.receptances(omega)[0][None]
    level = np.array([50.0])
    lines = LineBalance(
        balance.elements, balance.fourier, np.array([omega]), level, H[:, :, :2, :2]
    )
    found, is_found = lines.grow(lines.linear(), np.array([0]))
    assert not is_found[0]
    found = lines.turn(0)
    assert found == pytest.approx(expected.x, rel=1e-6)
