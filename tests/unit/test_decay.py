"""Data with the damping of an exponential window still in them: H at s = i omega + decay."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, FormatError
from updyn.updating.problem.parameters import parameters
from updyn.updating.problem.problem import FRFPart

FREQ, DECAY = np.linspace(0.6, 22.0, 40), 0.7
SENSORS = ["2:X", "5:-X", "12:X"]


@pytest.fixture
def damped(chain12):
    """Return the chain with damping of all kinds."""
    groups = dict(chain12.groups)
    first, second, *_ = groups
    groups[first] = replace(groups[first], mass_damping=0.3, stiffness_damping=1e-4)
    groups["dampers"] = updyn.Group(viscous=np.diag(np.linspace(0.1, 1.0, 12)))
    return updyn.Model.from_groups(groups, chain12.dofs).scaled({second: {"stiffness": 1.2}})


def dense(model, s, power):
    """Return s^k Z(s)^-1 term by term, as the definition of the Laplace transform says."""
    out = []
    for one in s:
        Z = np.zeros((model.n_dofs, model.n_dofs), dtype=complex)
        for group in model.groups.values():
            if group.stiffness is not None:
                K = group.stiffness.toarray()
                Z += (1.0 + 1j * group.loss_factor + one * group.stiffness_damping) * K
            if group.mass is not None:
                Z += (one**2 + one * group.mass_damping) * group.mass.toarray()
            if group.viscous is not None:
                Z += one * group.viscous.toarray()
        out.append(one**power * np.linalg.solve(Z, np.eye(model.n_dofs)))
    return np.array(out)


@pytest.mark.parametrize(("quantity", "power"), [("receptance", 0), ("accelerance", 2)])
@pytest.mark.parametrize("tier", ["dense", "sparse", "reduced"])
def test_a_response_through_a_window_is_that_at_s(damped, quantity, power, tier):
    found = updyn.response(damped, FREQ, SENSORS, ["5:X"], quantity, tier=tier, decay=DECAY)
    s = 2j * np.pi * FREQ + DECAY
    true = dense(damped, s, power)[:, [1, 4, 11]][:, :, [4]] * [[[1.0], [-1.0], [1.0]]]
    size = np.abs(true).max(axis=(1, 2), keepdims=True)
    assert found.decay == DECAY
    assert np.abs((found.values - true) / size).max() < (1e-5 if tier == "reduced" else 1e-10)


def test_it_is_what_a_window_on_the_response_to_a_hit_makes():
    """The transform of exp(-a t) h(t), h that of one viscous mode, on the axis."""
    m, c, k = 2.0, 3.0, 2.0 * (2 * np.pi * 5.0) ** 2
    model = updyn.Model.from_groups(
        {"one": updyn.Group(np.array([[k]]), np.array([[m]]), viscous=np.array([[c]]))}, ["1:X"]
    )
    t = np.arange(0.0, 20.0, 2e-4)
    rate = c / (2 * m)
    w = np.sqrt(k / m - rate**2)
    h = np.exp(-(rate + DECAY) * t) * np.sin(w * t) / (m * w)
    freq = np.array([3.0, 5.0, 5.2])
    wave = np.exp(-2j * np.pi * freq[:, None] * t)
    transformed = np.trapezoid(wave * h, t, axis=1)
    found = updyn.response(model, freq, ["1:X"], ["1:X"], decay=DECAY).values[:, 0, 0]
    assert found == pytest.approx(transformed, rel=1e-4)


def test_conversion_is_by_powers_of_s(damped):
    slow = updyn.response(damped, FREQ, SENSORS, ["5:X"], decay=DECAY)
    fast = updyn.response(damped, FREQ, SENSORS, ["5:X"], "accelerance", decay=DECAY)
    assert slow.converted("accelerance").values == pytest.approx(fast.values, rel=1e-12)


def test_derivatives_are_those_at_s(damped, assert_derivatives):
    data = updyn.response(damped, FREQ, SENSORS, ["5:X"], "mobility", decay=DECAY)
    first = next(iter(damped.groups))
    rest = [name for name in damped.groups if name != "dampers"]
    sought = parameters(damped, stiffness=rest, mass=rest, loss_factor=rest, viscous=["dampers"])
    sought += parameters(damped, mass_damping=[first], stiffness_damping=[first])
    part = FRFPart.build(damped, data, sought)
    x = part.coordinates.start
    assert part.responses(x) == pytest.approx(data.values, rel=1e-9)
    whole = part.block(x, slice(None))
    for i in range(part.n):
        step = 1e-6 * np.eye(part.n)[i]
        high, low = part.responses(x + step), part.responses(x - step)
        assert_derivatives(whole.dH[i], (high - low) / 2e-6)


@pytest.fixture
def assert_derivatives():
    def compare(exact, differenced):
        assert np.abs(exact - differenced).max() < 1e-6 * np.abs(exact).max()

    return compare


def test_an_update_finds_the_truth_from_data_through_a_window(chain12, add_noise):
    rng = np.random.default_rng(0)
    freq = np.linspace(0.6, 22.0, 100)
    clean = updyn.response(chain12, freq, ["2:X", "5:X", "7:X", "12:X"], ["5:X"], decay=1.5)
    noisy = add_noise(clean, rng, 0.01, decay=1.5)
    start = chain12.scaled({name: {"stiffness": 1.2} for name in chain12.groups})
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    found = updyn.update(start, noisy, unknowns)
    assert found.status == "converged"
    for p in unknowns:
        true = chain12.group(p.group).loss_factor if p.quantity == "loss_factor" else 1.0 / 1.2
        assert abs(found.values[p.name] - true) < 4.0 * found.std[p.name]


def test_correlation_is_made_where_the_data_are(damped):
    data = updyn.response(damped, FREQ, SENSORS, ["5:X"], decay=DECAY)
    assert updyn.correlate(damped, data).relative_residual.max() < 1e-10
    on_axis = updyn.response(damped, FREQ, SENSORS, ["5:X"])
    with pytest.raises(DataError, match=r"decay of their exponential windows: 0 and 0\.7 1/s"):
        updyn.correlate(on_axis, data)


def test_modes_are_those_without_the_window(damped):
    freq = np.linspace(0.6, 22.0, 400)
    where = (freq, ["2:X", "5:X", "9:X", "12:X"], ["5:X"], "accelerance")
    plain, windowed = (
        updyn.identify_modes(updyn.response(damped, *where, decay=a)) for a in (0.0, 0.2)
    )
    near = [int(np.argmin(np.abs(windowed.frequency - f))) for f in plain.frequency[:3]]
    assert windowed.frequency[near] == pytest.approx(plain.frequency[:3], rel=1e-4)
    assert windowed.damping[near] == pytest.approx(plain.damping[:3], rel=0.02)


@pytest.mark.parametrize("suffix", ["nc", "npz", "mat", "csv"])
def test_files_keep_it(damped, tmp_path, suffix):
    data = updyn.response(damped, FREQ, SENSORS, ["5:X"], decay=DECAY)
    path = tmp_path / f"test.{suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        updyn.write_frf(data, path)
    assert updyn.read_frf(path).decay == DECAY


def test_universal_files_refuse_it(damped, tmp_path):
    data = updyn.response(damped, FREQ, SENSORS, ["5:X"], decay=DECAY)
    with pytest.raises(FormatError, match=r"window exp\(-0\.7 t\), which universal files"):
        updyn.write_frf(data, tmp_path / "test.unv")


@pytest.mark.parametrize("bad", [-1.0, np.inf, np.nan, True, "fast", None])
def test_a_decay_is_a_number_above_zero(bad):
    with pytest.raises(DataError, match="decay"):
        updyn.FRF([1.0], np.ones((1, 1, 1)), ["1:X"], ["1:X"], "receptance", decay=bad)


@pytest.fixture
def windowed(chain12, add_noise):
    """Return start, data of the chain through a window with noise, and unknowns."""
    freq = np.linspace(0.6, 22.0, 60)
    clean = updyn.response(chain12, freq, ["2:X", "5:X", "7:X", "12:X"], ["5:X"], decay=1.0)
    noisy = add_noise(clean, np.random.default_rng(0), 0.01, decay=1.0)
    start = chain12.scaled({name: {"stiffness": 1.2} for name in chain12.groups})
    return start, noisy, updyn.parameters(start, stiffness="all", loss_factor="all")


@pytest.mark.parametrize(
    ("method", "near"),
    [
        ("maximum-likelihood", 2e-3),
        ("log", 2e-3),
        ("output-error", 5e-3),
        ("equation-error", 2e-2),
        ("constitutive", 5e-3),
        ("force-residual", 2e-2),
    ],
)
def test_every_method_compares_at_s(chain12, windowed, method, near):
    start, noisy, unknowns = windowed
    found = updyn.update(start, noisy, unknowns, method=method)
    for p in unknowns:
        true = chain12.group(p.group).loss_factor if p.quantity == "loss_factor" else 1.0 / 1.2
        assert found.values[p.name] == pytest.approx(true, abs=near)


def test_a_result_keeps_it_and_validates_with_it(windowed, tmp_path):
    start, noisy, unknowns = windowed
    found = updyn.update(start, noisy, unknowns, tier="reduced", validation=["7:X"])
    assert found.trust["validated"].holds
    assert found.correlation["validation"]["after"]["residual_median"] < 0.02
    updyn.write_result(found, tmp_path / "run.nc")
    assert updyn.read_result(tmp_path / "run.nc").frf.decay == 1.0
