"""Coordinates, and the data brought to the model's indices, signs and quantity."""

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.dynamics.settings import LINE_SOLVER
from updyn.errors import DofError, OptionError
from updyn.frf import FRF
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.problem import FRFPart, relative_levels


@pytest.fixture
def unknowns(chain12):
    bounds = {"part1.stiffness": (0.5, 4.0), "part1.loss_factor": (0.01, 0.2)}
    stds = {"part2.mass": 0.25, "part1.loss_factor": 0.02}
    return updyn.parameters(
        chain12,
        mass=["part2"],
        stiffness=["part1"],
        loss_factor=["part1", "part2"],
        bounds=bounds,
        prior_std=stds,
    )


def test_coordinates_are_logarithms_of_factors(unknowns):
    assert unknowns.names == [
        "part1.stiffness",
        "part1.loss_factor",
        "part2.mass",
        "part2.loss_factor",
    ]
    c = Coordinates(unknowns)
    values = np.array([2.0, 0.05, 0.5, 0.0])
    x = c.to_x(values)
    assert x == pytest.approx([np.log(2.0), 0.05, np.log(0.5), 0.0])
    assert c.to_values(x) == pytest.approx(values)
    assert c.slope(x) == pytest.approx([2.0, 1.0, 0.5, 1.0])
    lower, upper = c.bounds
    assert lower == pytest.approx([np.log(0.5), 0.01, np.log(0.01), 0.0])
    assert upper == pytest.approx([np.log(4.0), 0.2, np.log(100.0), 10.0])
    assert c.relaxed_lower == pytest.approx([np.log(0.5), -0.5, np.log(0.01), -0.5])
    centre, weight = c.prior
    assert centre == pytest.approx([0.0, 0.03, 0.0, 0.03])
    assert weight == pytest.approx([0.0, 50.0, 4.0, 0.0])


def test_slope_is_the_derivative(unknowns):
    c, step = Coordinates(unknowns), 1e-6
    x = np.array([0.3, 0.1, -0.7, 0.02])
    for i in range(4):
        e = step * np.eye(4)[i]
        difference = (c.to_values(x + e) - c.to_values(x - e)) / (2 * step)
        assert difference == pytest.approx(np.eye(4)[i] * c.slope(x), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_blocks_follow_signs_and_quantity(chain12, unknowns, quantity):
    """Model and derivatives come in the data's quantity and signs, at any x."""
    freq, x = np.array([3.0, 5.5, 9.0]), np.array([0.2, 0.05, -0.1, 0.02])
    changed = unknowns.apply(chain12, Coordinates(unknowns).to_values(x))
    data = updyn.response(chain12, freq, ["2:X", "5:-X"], ["5:X", "9:-X", "2:X"], quantity)
    problem = FRFPart.build(chain12, data, unknowns)
    expected = updyn.response(changed, freq, data.responses, data.references, quantity).values
    assert problem.responses(x) == pytest.approx(expected, rel=1e-11)
    (block,) = problem.blocks(x)
    assert (block.measured == data.values).all()
    step = 1e-6
    for i in range(4):
        e = step * np.eye(4)[i]
        difference = (problem.responses(x + e) - problem.responses(x - e)) / (2 * step)
        assert block.dH[i] == pytest.approx(
            difference, rel=1e-6, abs=1e-8 * np.abs(difference).max()
        )


def test_blocks_of_lines_change_nothing(chain12, unknowns, monkeypatch):
    data = updyn.response(chain12, np.linspace(1, 20, 11), ["2:X", "5:X"], ["5:X"])
    problem, x = FRFPart.build(chain12, data, unknowns), np.array([0.2, 0.05, -0.1, 0.02])
    whole = list(problem.blocks(x))
    assert len(whole) == 1
    override(monkeypatch, LINE_SOLVER, block_bytes=16 * 12 * 12 * 4)
    parts = list(problem.blocks(x))
    assert len(parts) > 2
    assert np.concatenate([p.H for p in parts]) == pytest.approx(whole[0].H, rel=1e-13)
    assert np.concatenate([p.dH for p in parts], axis=1) == pytest.approx(whole[0].dH, rel=1e-12)
    assert [i for p in parts for i in range(11)[p.lines]] == list(range(11))


def test_refusals(chain12, unknowns):
    data = updyn.response(chain12, [1.0], ["2:X"], ["5:X"])
    with pytest.raises(OptionError, match="tier 'dens'"):
        FRFPart.build(chain12, data, unknowns, tier="dens")
    other = updyn.FRF([1.0], [[[1.0]]], ["2:Y"], ["5:X"], "receptance")
    with pytest.raises(DofError, match="response 2:Y is not among the 12 DOFs"):
        FRFPart.build(chain12, other, unknowns)


def test_thinned_keeps_the_first_line_and_an_even_spread(chain12, unknowns):
    data = updyn.response(chain12, np.linspace(1, 20, 20), ["2:X"], ["5:X"])
    problem = FRFPart.build(chain12, data, unknowns)
    assert problem.thin(20) is problem
    assert problem.thin(7).frf.freq == pytest.approx(data.freq[::3])
    assert len(problem.thin(7).frf.freq) <= 7


def test_rounding_is_a_share_of_the_louder_of_model_and_data():
    """A model that resonates where the data do not has errors of its own level."""
    freq = np.array([10.0, 20.0])
    values = np.array([[[1.0], [1e-26]]] * 2)
    measured = FRF(freq, values, ["1:X", "1:Y"], ["1:X"], "receptance")
    H = np.array([[[30.0], [3e-11]], [[10.0], [1e-11]]], dtype=complex)
    loudest = np.sqrt((30.0**2 + 10.0**2) / 2.0)
    found = relative_levels(H, measured)
    assert found.ravel() == pytest.approx([1.0, np.sqrt(5.0) * 1e-11 / loudest], rel=1e-12)
    assert relative_levels(measured.values, measured).ravel() == pytest.approx(
        [1.0, 1e-26], rel=1e-12
    )
    quiet = relative_levels(1e-3 * H, measured)
    assert quiet.ravel() == pytest.approx([1e-3 * loudest, np.sqrt(5.0) * 1e-14], rel=1e-12)
