"""The default method where the noise is not stated, and where a channel is nothing but rounding.

The bound is that of Cramer and Rao for the true noise, from central differences of responses alone.
"""

import numpy as np
import pytest

import updyn
from bounds import cramer_rao
from updyn.updating.fit.method import Starts
from updyn.updating.fit.search import Search

FLOOR, RELATIVE = 0.01, 0.01


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
    std = cramer_rao(unknowns, start, clean, exact, variance)
    off = np.array(list(found.values.values())) - exact
    assert found.status == "converged"
    assert "misses the data" not in found.message
    assert (np.abs(off) < 4.0 * std).all()
    assert found.noise["floor"] == pytest.approx(FLOOR, rel=0.3)


@pytest.mark.parametrize(("stated", "status"), [(0.01, "stalled"), (0.0115, "converged")])
def test_a_search_without_agreement_is_sure_only_of_what_noise_explains(
    chain12_task, add_noise, monkeypatch, stated, status
):
    """Noise of 1.15 %: 1.3 times the chi-square that 1 % leaves. Another answer may do better."""
    start, clean, unknowns, exact = chain12_task
    data = add_noise(clean, np.random.default_rng(0), 0.0115)
    x = unknowns.with_start(exact)
    monkeypatch.setattr(Search, "run", lambda self, *args: Starts((args[0].coordinates.start,)))
    found = updyn.update(start, data, x, noise={"relative": stated})
    assert found.status == status
    assert ("did not settle" in found.message) == (status == "stalled")
    assert found.noise["chi_square"] == pytest.approx((0.0115 / stated) ** 2, rel=0.1)
    off = np.array(list(found.values.values())) - exact
    assert (np.abs(off) < 4.0 * np.array(list(found.std.values()))).all()


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


def ring(factors):
    """Blades on a disc that couples each to the next: eight frequencies close together."""
    n, groups = len(factors), {}
    for i, factor in enumerate(factors):
        blade = np.zeros((n, n))
        blade[i, i] = 1.0
        groups[f"blade {i + 1}"] = updyn.Group(4e4 * factor * blade, blade, loss_factor=0.003)
    K = 400.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, -1] = K[-1, 0] = -400.0
    groups["disc"] = updyn.Group(K, np.zeros((n, n)), loss_factor=0.003)
    return updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in range(n)])


@pytest.mark.parametrize("seed", [0, 5])
def test_mistuned_blades_below_a_floor(add_noise, seed):
    """Each may take another's resonance: the right order is found step by step, from minima beside
    minima, and not from starts farther away."""
    factors = np.random.default_rng(seed).uniform(0.8, 1.2, 8)
    true, start = ring(factors), ring(np.ones(8))
    freq, sensors = np.linspace(27.0, 37.5, 150), ["1:Z", "3:Z", "5:Z", "7:Z"]
    clean = updyn.response(true, freq, sensors, ["1:Z", "5:Z"])
    data = add_noise(clean, np.random.default_rng(seed), RELATIVE, FLOOR)
    unknowns = updyn.parameters(start, stiffness="all", loss_factor=["disc"])
    found = updyn.update(start, data, unknowns)
    size = np.abs(clean.values)
    variance = (RELATIVE * size) ** 2 + FLOOR**2 * np.mean(size**2)
    exact = np.array([*factors, 1.0, 0.003])
    std = cramer_rao(unknowns, start, clean, exact, variance)
    off = np.array(list(found.values.values())) - exact
    assert found.status == "converged"
    assert np.mean(size < 0.02 * np.sqrt(np.mean(size**2))) > 0.5  # most values are noise
    assert "misses the data" not in found.message
    assert (np.abs(off) < 4.0 * std).all()
