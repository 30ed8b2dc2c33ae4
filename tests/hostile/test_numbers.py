"""Numbers at their limits, each with the outcome that docs/reliability.md writes down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import updyn
from bodies import turned
from updyn.elements.structure import Beam, PointMass, rectangle, structure
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.model import Group, Model

pytestmark = pytest.mark.kernels


def chain(stiffness: Sequence[float], mass: Sequence[float], loss_factor: float = 0.02) -> Model:
    """Masses in a row, the first on a spring to the ground; each with its spring a group."""
    n, groups = len(stiffness), {}
    for i, (k, m) in enumerate(zip(stiffness, mass, strict=True)):
        at = [0] if i == 0 else [i - 1, i]
        K, M = np.zeros((n, n)), np.zeros((n, n))
        K[np.ix_(at, at)] = k * (np.ones((1, 1)) if i == 0 else np.array([[1, -1], [-1, 1]]))
        M[i, i] = m
        groups[f"p{i + 1}"] = Group(K, M, loss_factor)
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def noisy(frf: FRF, seed: int, relative: float = 0.01) -> FRF:
    rng = np.random.default_rng(seed)
    draw = rng.standard_normal((2, *frf.values.shape)) / np.sqrt(2.0)
    return replace(frf, values=frf.values * (1.0 + relative * (draw[0] + 1j * draw[1])))


def values(result: updyn.UpdateResult) -> np.ndarray:
    return np.array(list(result.values.values()))


# Stiffnesses that differ much.

SOFT = {"p1": {"stiffness": 1.3}, "p3": {"stiffness": 0.8}, "p4": {"stiffness": 1.1}}


def far_apart(ratio: float) -> Model:
    """The second of four springs is stiffer than the first by a ratio."""
    return chain([1e4, 1e4 * ratio, 2e4, 1.5e4], np.ones(4))


@pytest.mark.parametrize("ratio", [1e3, 1e6, 1e9, 1e10])
def test_a_stiff_part_does_not_disturb_what_soft_ones_are_found_to_be(ratio):
    start = far_apart(ratio)
    lines, sensors = np.linspace(2.0, 40.0, 80), ["1:X", "2:X", "4:X"]
    data = noisy(updyn.response(start.scaled(SOFT), lines, sensors, ["4:X"]), 0)
    found = updyn.update(start, data, updyn.parameters(start, stiffness=list(SOFT)))
    assert found.ok
    assert np.abs(values(found) - [1.3, 0.8, 1.1]).max() < 4.0 * max(found.std.values())


def test_a_stiff_part_is_told_to_be_open():
    """Its own stiffness moves nothing that is measured; the others are found beside it."""
    start = far_apart(1e9)
    lines, sensors = np.linspace(2.0, 40.0, 80), ["1:X", "2:X", "4:X"]
    data = noisy(updyn.response(start.scaled(SOFT), lines, sensors, ["4:X"]), 0)
    found = updyn.update(start, data, updyn.parameters(start, stiffness="all"))
    assert found.status == "not-identifiable"
    assert "p2.stiffness" in found.message
    soft = [found.values[f"{name}.stiffness"] for name in SOFT]
    assert soft == pytest.approx([1.3, 0.8, 1.1], abs=2e-3)


def test_an_exact_answer_to_rounding_has_converged():
    """Of data without noise nothing but rounding is left, which no step lowers."""
    start = far_apart(1e6)
    lines, sensors = np.linspace(2.0, 40.0, 80), ["1:X", "2:X", "4:X"]
    data = updyn.response(start.scaled(SOFT), lines, sensors, ["4:X"])
    found = updyn.update(start, data, updyn.parameters(start, stiffness="all"))
    assert found.status in ("converged", "not-identifiable")
    soft = [found.values[f"{name}.stiffness"] for name in SOFT]
    assert soft == pytest.approx([1.3, 0.8, 1.1], abs=1e-8)


def test_stiffnesses_too_far_apart_are_refused_with_the_reason():
    with pytest.raises(SolverError, match=r"too far apart for double precision.* to 1e\+16"):
        updyn.response(far_apart(1e12), np.linspace(2.0, 40.0, 80), ["1:X"], ["4:X"])


def test_a_search_stopped_by_what_cannot_be_solved_has_not_converged():
    """At 1e11 the resonances cannot be solved, for some values of the unknowns."""
    start = far_apart(1e11)
    lines, sensors = np.linspace(2.0, 40.0, 80), ["1:X", "2:X", "4:X"]
    data = noisy(updyn.response(start.scaled(SOFT), lines, sensors, ["4:X"]), 0)
    found = updyn.update(start, data, updyn.parameters(start, stiffness=list(SOFT)))
    right = np.abs(values(found) - [1.3, 0.8, 1.1]).max() < 4.0 * max(found.std.values())
    assert right or not found.ok


def test_rotations_beside_translations_are_not_too_far_apart():
    """Ratios of units, not of parts: 1 N m/rad beside 1e12 N/m."""
    k, m = np.diag([1e12, 1.0]), np.diag([1e8, 1e-4])
    model = Model.from_groups({"g": Group(k, m, 0.02)}, ["1:X", "1:RX"])
    H = updyn.response(model, [10.0], ["1:X", "1:RX"], ["1:X", "1:RX"]).values[0]
    omega2 = (2.0 * np.pi * 10.0) ** 2
    expected = 1.0 / (np.diag(k) * (1.0 + 0.02j) - omega2 * np.diag(m))
    assert np.diag(H) == pytest.approx(expected, rel=1e-12)


# Few numbers, and many.


def test_one_line_determines_one_unknown():
    start = chain([1e4, 2e4, 1.5e4], np.ones(3))
    true = start.scaled({"p2": {"stiffness": 1.3}})
    data = updyn.response(true, [7.0], ["1:X"], ["3:X"])
    found = updyn.update(start, data, updyn.parameters(start, stiffness=["p2"]))
    assert found.ok
    assert found.values["p2.stiffness"] == pytest.approx(1.3, rel=1e-8)


def test_as_many_unknowns_as_numbers_have_deviations_of_an_assumed_noise():
    start = chain([1e4, 2e4, 1.5e4], np.ones(3))
    true = start.scaled({"p2": {"stiffness": 1.3}})
    data = updyn.response(true, [7.0], ["1:X"], ["3:X"])
    unknowns = updyn.parameters(start, stiffness=["p2"], loss_factor=["p2"])
    found = updyn.update(start, data, unknowns)
    assert found.status == "converged"
    assert "5 % was assumed for the standard deviations" in found.message
    assert found.values["p2.stiffness"] == pytest.approx(1.3, abs=found.std["p2.stiffness"])


@pytest.mark.parametrize("n_lines", [1, 3])
def test_more_unknowns_than_numbers_are_not_identifiable(n_lines):
    start = chain([1e4, 2e4, 1.5e4], np.ones(3))
    true = start.scaled({"p2": {"stiffness": 1.3}})
    data = updyn.response(true, np.linspace(3.0, 7.0, n_lines), ["1:X"], ["3:X"])
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    assert len(unknowns) > 2 * n_lines
    found = updyn.update(start, data, unknowns)
    assert found.status == "not-identifiable"
    assert found.identifiability.rank <= 2 * n_lines
    assert found.correlation["after"]["residual_median"] < 1e-3


def test_a_hundred_unknowns_are_found_within_their_covariance():
    n, rng = 50, np.random.default_rng(1)
    start = chain(3e4 * (1.0 + 0.2 * np.arange(n)), 1.0 + 0.3 * np.arange(n))
    unknowns = updyn.parameters(start, stiffness="all", mass="all")
    exact = rng.uniform(0.9, 1.1, 100)
    true = unknowns.apply(start, exact)
    f = updyn.modes(start, n).frequency
    lines = np.linspace(0.5 * f[0], 1.02 * f[-1], 100)
    data = updyn.response(true, lines, [f"{i + 1}:X" for i in range(n)], [f"{n}:X"])
    found = updyn.update(start, noisy(data, 2), unknowns, noise={"relative": 0.01})
    assert found.ok
    off = values(found) - exact
    # Chi-squared of 100 degrees of freedom: 100 with a deviation of 14.
    assert off @ np.linalg.solve(found.covariance, off) == pytest.approx(100.0, abs=56.0)


# Structures that are hard on rounding.


def test_parts_without_mass_are_condensed_and_updated():
    """A spring of two in series, no mass between: the compliances add, at every line."""
    start = chain([1e4, 2e4, 1.5e4], [0.0, 1.0, 2.0])
    true = start.scaled({"p1": {"stiffness": 1.3}, "p3": {"stiffness": 0.7}})
    lines = np.linspace(1.0, 40.0, 60)
    series = chain([1.0 / (1.0 / 1.3e4 + 1.0 / 2e4), 0.7 * 1.5e4], [1.0, 2.0])
    data = updyn.response(true, lines, ["1:X", "2:X", "3:X"], ["3:X"])
    assert data.values[:, 1:] == pytest.approx(
        updyn.response(series, lines, ["1:X", "2:X"], ["2:X"]).values, rel=1e-9
    )
    found = updyn.update(start, data, updyn.parameters(start, stiffness="all"))
    assert found.ok
    assert values(found) == pytest.approx([1.3, 1.0, 0.7], rel=1e-7)


def test_the_mass_of_a_part_without_mass_is_open():
    start = chain([1e4, 2e4, 1.5e4], [0.0, 1.0, 2.0])
    true = start.scaled({"p1": {"stiffness": 1.3}})
    data = updyn.response(true, np.linspace(1.0, 40.0, 60), ["1:X", "2:X", "3:X"], ["3:X"])
    with pytest.warns(updyn.UpdynWarning, match=r"unknown 'p1\.mass' changes nothing: the mass"):
        found = updyn.update(start, data, updyn.parameters(start, stiffness="all", mass="all"))
    assert found.status == "not-identifiable"
    assert "p1.mass" in found.message
    assert values(found)[[1, 3, 5]] == pytest.approx([1.3, 1.0, 1.0], rel=1e-6)


def mast(Q: np.ndarray, factors: dict[str, dict[str, float]]) -> Model:
    """Three bays of a square section with an offset mass at the top, turned in space by Q."""
    section, E, rho, nu = rectangle(0.05, 0.05), 2.1e11, 7850.0, 0.3
    nodes = np.column_stack([np.zeros((7, 2)), 0.5 * np.arange(7)]) @ Q.T
    parts: list[object] = [
        Beam(
            f"bay {bay + 1}",
            np.array([[first, first + 1], [first + 1, first + 2]]),
            E,
            rho,
            section,
            nu,
            orientation=np.array([1.0, 0.0, 0.0]),
            loss_factor=0.01,
        )
        for bay, first in enumerate((1, 3, 5))
    ]
    parts.append(PointMass("head", 7, 5.0))
    return structure(nodes, [turned(part, Q) for part in parts], grounded=[1]).scaled(factors)


TRUE = {"bay 1": {"stiffness": 0.8}, "bay 2": {"stiffness": 1.2}, "head": {"mass": 1.3}}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_quarter_turn_by_rounding_changes_no_estimate(axis):
    """cos 90 degrees is 6e-17: what is zero in the one position is rounding in the other, and the
    two bending modes of each pair, equal in frequency, mix at will."""
    c, s = np.cos(np.pi / 2.0), np.sin(np.pi / 2.0)
    assert c != 0.0
    Q = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    Q[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    lines, found = np.linspace(2.0, 120.0, 60), []
    for turn in (np.eye(3), Q):
        start, true = mast(turn, {}), mast(turn, TRUE)
        # The force is along the section's first axis; so is half of the sensors.
        along = "XYZ"[int(np.argmax(np.abs(turn[:, 0])))]
        across = "XYZ"[int(np.argmax(np.abs(turn[:, 1])))]
        sensors = [f"{node}:{axis}" for node in (3, 5, 7) for axis in (along, across)]
        data = updyn.response(true, lines, sensors, [f"7:{along}"])
        data = replace(data, values=data.values * (1.0 + 0.01 * noise(data.values.shape)))
        unknowns = updyn.parameters(start, stiffness="bay*", mass=["head"])
        found.append(updyn.update(start, data, unknowns))
    still, moved = found
    assert still.ok
    assert moved.ok
    assert values(moved) == pytest.approx(values(still), rel=1e-6)
    for name, exact in {"bay 1.stiffness": 0.8, "bay 2.stiffness": 1.2, "head.mass": 1.3}.items():
        assert still.values[name] == pytest.approx(exact, abs=4.0 * still.std[name])


def noise(shape: tuple[int, ...]) -> np.ndarray:
    draw = np.random.default_rng(4).standard_normal((2, *shape)) / np.sqrt(2.0)
    return draw[0] + 1j * draw[1]


@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-6, 1e-3])
def test_modes_as_good_as_equal_in_frequency(apart):
    """Two like masses on like springs, coupled by next to nothing: any pair of shapes is right, the
    response is one; the unknowns of both are found where a sensor is on each."""

    def pair(first: float, second: float) -> Model:
        groups = {}
        for i, k in enumerate((first, second)):
            at = np.zeros((2, 2))
            at[i, i] = 1.0
            groups[f"p{i + 1}"] = Group(1e4 * k * at, at, 0.01)
        link = 1e4 * apart * np.array([[1.0, -1.0], [-1.0, 1.0]])
        groups["link"] = Group(link, np.zeros((2, 2)), 0.01)
        return Model.from_groups(groups, ["1:X", "2:X"])

    lines, names = np.linspace(8.0, 24.0, 60), ["1:X", "2:X"]
    like = pair(1.0, 1.0)
    assert updyn.modes(like, 2).frequency == pytest.approx(
        np.sqrt([1e4, 1e4 * (1.0 + 2.0 * apart)]) / (2.0 * np.pi), rel=1e-9
    )
    data = noisy(updyn.response(pair(1.1, 1.1), lines, names, names), 3)
    found = updyn.update(like, data, updyn.parameters(like, stiffness=["p1", "p2"]))
    assert found.ok
    assert values(found) == pytest.approx([1.1, 1.1], abs=4.0 * max(found.std.values()))


# Units.


@pytest.mark.parametrize(("k", "m"), [(1e-3, 1e-3), (1e-9, 1e-9), (1e9, 1e9)])
def test_units_change_no_estimate(k, m):
    """N/mm and tonnes beside N/m and kg, and far beyond: the same factors, to rounding."""
    found = []
    for size, weight in ((1.0, 1.0), (k, m)):
        start = chain(np.array([1e4, 2e4, 1.5e4, 1e4]) * size, weight * np.ones(4))
        true = start.scaled({"p2": {"stiffness": 1.3}, "p3": {"mass": 0.8}})
        data = updyn.response(true, np.linspace(2.0, 40.0, 80), ["1:X", "4:X"], ["3:X"])
        unknowns = updyn.parameters(start, stiffness="all", mass=["p3"])
        found.append(updyn.update(start, noisy(data, 5), unknowns))
    assert all(one.ok for one in found)
    # The floor that is beneath any noise is taken from the data, and so has their unit.
    assert values(found[1]) == pytest.approx(values(found[0]), rel=1e-6)
    assert list(found[1].std.values()) == pytest.approx(list(found[0].std.values()), rel=1e-4)
