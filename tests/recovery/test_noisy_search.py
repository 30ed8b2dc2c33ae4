"""The default method where the noise is not stated, and where a channel is nothing but rounding.

The bound is that of Cramer and Rao for the true noise, from central differences of responses alone.
"""

import numpy as np
import pytest

import updyn

FLOOR, RELATIVE = 0.01, 0.01


def bound(unknowns, start, data, exact, variance):
    """Standard deviations for complex Gaussian noise: information 2 Re(J^H J / E|dH|^2)."""
    J = []
    for i in range(len(exact)):
        step = 1e-5 * np.eye(len(exact))[i]
        up, down = (
            updyn.response(
                unknowns.apply(start, exact + s * step), data.freq, data.responses, data.references
            ).values
            for s in (1, -1)
        )
        J.append(((up - down) / 2e-5 / np.sqrt(variance)).ravel())
    J = np.array(J)
    return np.sqrt(np.diag(np.linalg.solve(2.0 * (J @ J.conj().T).real, np.eye(len(exact)))))


@pytest.mark.parametrize("seed", range(4))
def test_chain_below_a_floor_that_nobody_stated(chain12_task, add_noise, seed):
    """1 % noise and a floor of 1 % of the rms: all twelve unknowns, from 10 to 25 % off, without a
    word on the noise."""
    start, clean, unknowns, exact = chain12_task
    size = np.abs(clean.values)
    level = np.sqrt(np.mean(size**2))
    assert np.mean(size < 0.1 * level) > 0.2  # there the floor alone is noise of 10 % or more
    data = add_noise(clean, np.random.default_rng(seed), RELATIVE, FLOOR)
    found = updyn.update(start, data, unknowns)
    variance = (RELATIVE * size) ** 2 + (FLOOR * level) ** 2
    std = bound(unknowns, start, clean, exact, variance)
    off = np.array(list(found.values.values())) - exact
    assert found.status == "converged"
    assert (np.abs(off) < 4.0 * std).all()
    assert found.noise["floor"] == pytest.approx(FLOOR, rel=0.3)


def frame(seed, factors):
    """A mast that bends alike in two directions, whose coupling is rounding of the assembly."""
    rng, n, groups = np.random.default_rng(seed), 4, {}
    for part, factor in enumerate(factors):
        at = [part] if part == 0 else [part - 1, part]
        spring = np.ones((1, 1)) if part == 0 else np.array([[1.0, -1.0], [-1.0, 1.0]])
        K, M = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
        for first in (0, n):
            here = np.array(at) + first
            K[np.ix_(here, here)] = 4e4 * (1 + 0.3 * part) * factor * spring
            M[part + first, part + first] = 2.0 - 0.2 * part
        coupling = 2e-20 * 4e4 * rng.standard_normal((n, n))
        K[:n, n:] += coupling
        K[n:, :n] += coupling.T
        groups[f"bay {part + 1}"] = updyn.Group(K, M, loss_factor=0.02)
    names = [f"{i + 1}:{axis}" for axis in "XY" for i in range(n)]
    return updyn.Model.from_groups(groups, names)


def test_a_channel_of_rounding_does_not_disturb_exact_recovery():
    """Forces along X and sensors across: what they read is rounding, other in model and data."""
    truth = [1.0, 1.6, 0.6, 1.3]
    true, start = frame(1, truth), frame(2, [1.0] * 4)
    sensors = ["2:X", "4:X", "2:Y", "4:Y"]
    data = updyn.response(true, np.linspace(2.0, 50.0, 80), sensors, ["4:X"])
    share = np.abs(data.values).max(axis=(0, 2))
    assert 0.0 < share[2:].max() < 1e-16 * share[:2].min()
    across = updyn.response(start, data.freq, sensors[2:], ["4:X"]).values
    # The logarithms of the two are as far apart as any random ones.
    assert np.abs(np.log(across / data.values[:, 2:])).mean() > 0.5
    unknowns = updyn.parameters(start, stiffness="all", mass=["bay 2", "bay 3", "bay 4"])
    found = updyn.update(start, data, unknowns)
    assert found.status == "converged"
    values = list(found.values.values())
    expected = {f"bay {i + 1}.stiffness": k for i, k in enumerate(truth)}
    expected = [expected.get(name, 1.0) for name in found.values]
    assert values == pytest.approx(expected, abs=1e-9)
    along = updyn.update(start, data.select(responses=sensors[:2]), unknowns)
    assert values == pytest.approx(list(along.values.values()), abs=1e-9)
