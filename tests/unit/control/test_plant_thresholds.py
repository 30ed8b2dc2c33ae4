"""Thresholds of plants: a case just inside and just outside of each."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import updyn
from nonlinear_plants import one_inertia
from updyn.control import antiresonances
from updyn.control.antiresonances import antiresonance_shifts, find_antiresonances, find_dips
from updyn.control.causal import Circle
from updyn.control.files.description import describe_plant
from updyn.control.job.plant_result import resolving_lines
from updyn.control.lines import dense_lines
from updyn.control.ports import as_ports
from updyn.control.report.plant import channels
from updyn.control.sampled import sampled
from updyn.control.space import modal_space
from updyn.control.target import ResponseTarget, target_lines
from updyn.control.weight import find_closest_lines, refuse_undamped
from updyn.control.weight_fit import Bound
from updyn.errors import ModelError, OptionError, UpdynWarning
from updyn.group import Group
from updyn.model import Model

TWO_PI = 2 * np.pi
FREQ = np.linspace(8.0, 12.0, 4001)


def zero_at(frequency, width, freq=FREQ):
    """Return a response with one zero of a half-power width, in Hz."""
    return freq - frequency - 0.5j * width


# -- antiresonances -------------------------------------------------------------------------------
def test_a_dip_wider_than_three_tenths_of_its_frequency_is_ignored():
    assert len(find_dips(FREQ, zero_at(10.0, 2.9))) == 1
    assert not find_dips(FREQ, zero_at(10.0, 3.1))


def test_a_narrow_dip_counts_as_a_hundredth_wide():
    (narrow,), (wide,) = (find_dips(FREQ, zero_at(10.0, width)) for width in (0.01, 0.11))
    assert narrow.width == pytest.approx(0.1, rel=1e-9)
    assert wide.width == pytest.approx(0.11, rel=1e-6)


@pytest.mark.parametrize(("delay", "number"), [(0.24, 1), (0.27, 0)])
def test_an_antiresonance_turns_the_phase(delay, number):
    """2.214 rad of a zero from one width below to one above, less 4 times the delay."""
    x = (FREQ - 10.0) / 0.1
    values = (x - 1j) * np.exp(-1j * delay * x)
    assert len(find_antiresonances(FREQ, values)) == number


@pytest.mark.parametrize(("offset", "matches"), [(0.09, True), (0.11, False)])
def test_zeros_within_a_tenth_match(offset, matches):
    values = zero_at(10.0, 0.2)
    zeros = np.array([1j, -1j]) * TWO_PI * 10.0 * (1.0 + offset)
    ((_, shift, _, _),) = antiresonance_shifts(FREQ, values, values, zeros)
    assert np.isfinite(shift) == matches
    if matches:
        assert shift == pytest.approx(100.0 * offset, rel=1e-3)


# -- lines ----------------------------------------------------------------------------------------
def test_lines_without_poles_are_sixty_per_decade():
    assert len(dense_lines([], [], 1.0, 100.0)) == 121


@pytest.mark.parametrize(("damping", "more"), [(0.29, True), (0.31, False)])
def test_a_pole_with_a_damping_ratio_below_three_tenths_has_lines_around_it(damping, more):
    pole = TWO_PI * 10.0 * (-damping + 1j * np.sqrt(1.0 - damping**2))
    assert (len(dense_lines([np.array([pole])], [], 1.0, 100.0)) > 121) == more


def test_an_undamped_zero_has_lines_at_a_billionth():
    lines = dense_lines([np.array([1j * TWO_PI * 10.0])], [], 1.0, 100.0)
    near = lines[np.abs(lines - 10.0) < 1e-6]
    np.testing.assert_allclose(near.max() / 10.0 - 1.0, 20e-9, rtol=1e-5)


def test_lines_of_a_target_reach_four_half_widths_from_a_pole():
    pole = TWO_PI * (-0.01 + 10.0j)
    lines = target_lines(np.array([pole]), (9.99, 10.02))
    plain = target_lines(np.zeros(0, complex), (9.99, 10.02))
    assert np.isin(
        np.round(10.0 + 0.01 * np.array([-0.6, 0.1, 1.0]), 12), np.round(lines, 12)
    ).all()
    assert len(plain) <= 400 < len(lines)
    undamped = target_lines(np.array([1j * TWO_PI * 10.0]), (9.0, 11.0))
    assert len(undamped) <= 400


def test_the_circle_resolves_the_margin():
    """24 points in 3 % of log frequency at both ends, from 2^13 to 2^16 in total."""
    assert Circle.of((1.0, 2.0)).n == 2**13
    assert Circle.of((1.0, 100.0)).n == 2**15
    narrow, wide = Circle.of((1.0, 2.0)), Circle.of((1.0, 1e4))
    assert narrow.margin == pytest.approx(0.03)
    assert wide.n == 2**16
    assert wide.margin == pytest.approx(TWO_PI * 24 * 1001.0 / (2.0 * np.sqrt(1e3)) / 2**16)
    assert Circle.of((0.0, 1e3)).scale == pytest.approx(np.sqrt(1e3))


def oscillators(frequencies, damping):
    """Return a plant with modes in parallel."""
    plant, omega = one_inertia(), TWO_PI * np.asarray(frequencies)
    A = scipy.linalg.block_diag(*([[0.0, 1.0], [-(w**2), -2.0 * damping * w]] for w in omega))
    n = len(A)
    B, C = np.zeros((n, 2)), np.zeros((2, n))
    return replace(plant, A=A, B=B, C=C, band=(1.0, 100.0))


def test_lines_of_a_comparison_reach_six_half_widths_from_a_mode():
    lines = resolving_lines(oscillators([10.0], 1e-4))
    near = lines[np.abs(lines - 10.0) < 0.0065]
    np.testing.assert_allclose(near[[0, -1]], [9.994, 10.006], rtol=1e-9)
    assert len(near) == 13
    assert 550 < len(lines) <= 2 * 300 + 13


def test_eighty_modes_have_lines_around_them():
    frequencies = np.linspace(2.0, 99.0, 81) + 0.0123
    lines = resolving_lines(oscillators(frequencies, 1e-5))
    has_lines = [bool((np.abs(lines - f) < 3e-4 * f).sum() >= 10) for f in frequencies]
    assert sum(has_lines) == 80


# -- target and poles -----------------------------------------------------------------------------
@pytest.mark.parametrize(("height", "number"), [(0.11, 2), (0.09, 1)])
def test_a_resonance_above_a_tenth_of_the_highest_is_evaluated(height, number):
    freq = np.linspace(0.0, 30.0, 3001)[1:]
    bumps = [h / (1.0 + ((freq - f) / 0.1) ** 2) for f, h in ((10.0, 1.0), (20.0, height))]
    values = np.sum(bumps, axis=0)[:, None, None].astype(complex)
    target = ResponseTarget.at(freq, values, ("receptance",), np.zeros(values.shape), slow=False)
    assert len(target.resonances(0, 0)) == number


def test_undamped_and_unstable_poles_are_refused():
    refuse_undamped([np.array([-1.1e-9 + 1j, -1.1e-9 - 1j])])
    with pytest.raises(ModelError, match="undamped resonance"):
        refuse_undamped([np.array([-0.9e-9 + 1j, -0.9e-9 - 1j])])
    with pytest.raises(ModelError, match="undamped resonance"):
        refuse_undamped([np.array([0.9e-9 + 1j, 0.9e-9 - 1j])])
    with pytest.raises(ModelError, match="right half plane"):
        refuse_undamped([np.array([1.1e-9 + 1j, 1.1e-9 - 1j])])


def test_a_pole_below_a_millionth_of_the_fastest_is_at_rest():
    refuse_undamped([np.array([-1.0, 0.9e-6j, -0.9e-6j])])
    with pytest.raises(ModelError, match="undamped resonance"):
        refuse_undamped([np.array([-1.0, 1.1e-6j, -1.1e-6j])])


# -- model ----------------------------------------------------------------------------------------
def two_dofs(stiffness, mass):
    return Model({"all": Group(np.diag(stiffness), np.diag(mass))}, ["1:X", "2:X"])


def modes_of(model, top):
    ports = as_ports(["1:X", "2:X"], "input")
    return modal_space(model, ports, ports, (0.0, top))


def test_a_negative_stiffness_is_rounding_up_to_a_millionth():
    """Of omega^2 of the upper end of the band."""
    unit = TWO_PI**2
    with pytest.warns(UpdynWarning, match="indefinite"):
        modes_of(two_dofs([-0.9e-6 * unit, unit], [1.0, 1.0]), 1.0)
    with (
        pytest.warns(UpdynWarning, match="indefinite"),
        pytest.raises(ModelError, match="no stable plant"),
    ):
        modes_of(two_dofs([-1.1e-6 * unit, unit], [1.0, 1.0]), 1.0)


def test_a_motion_without_mass_oscillates_at_thirty_times_the_band():
    space = modes_of(two_dofs([1.0, 1.0], [1.0, 0.0]), 2.0)
    assert space.omega.max() / (TWO_PI * 2.0) == pytest.approx(30.0)


# -- sampling, files, weights ---------------------------------------------------------------------
def test_a_delay_near_a_whole_number_of_intervals_is_rounded():
    plant = replace(one_inertia(), band=(0.1, 10.0))
    assert sampled(plant, 0.01, delay=0.01 * (3.0 + 0.9e-9)).delay == 3
    assert sampled(plant, 0.01, delay=0.01 * (3.0 + 1.2e-9)).delay == 4


def test_a_delay_of_too_many_states_is_refused():
    """Two states, and two for each started interval."""
    plant = replace(one_inertia(), band=(0.1, 10.0))
    with pytest.raises(OptionError, match="more than 2000 states"):
        sampled(plant, 0.01, delay=9.99)


@pytest.mark.parametrize(("distance", "refused"), [(0.8e-9, True), (1.2e-9, False)])
def test_a_pole_within_a_billionth_of_the_singularity_is_refused(distance, refused):
    A = np.array([[200.0 * (1.0 + distance), 1.0], [0.0, -1.0]])
    plant = replace(one_inertia(), A=A, band=(0.1, 10.0))
    if refused:
        with pytest.raises(OptionError, match="singular"):
            sampled(plant, 0.01, "tustin")
    else:
        assert sampled(plant, 0.01, "tustin").dt == 0.01


def test_twelve_natural_frequencies_are_listed():
    plant = one_inertia()
    for number, ends in ((12, "12"), (13, "...")):
        text = describe_plant(replace(plant, modes=np.arange(1.0, number + 1.0)))
        (line,) = (row for row in text.splitlines() if "natural frequencies" in row)
        assert line.endswith(ends)


def test_forty_places_are_refined_in_eighths():
    """A constant weight above 50 equal peaks."""
    lines = np.arange(1.0, 102.0)
    radius = np.where(np.arange(101) % 2, 1.0, 0.5)[:, None, None]
    bounds = {(0, 0): Bound(0, np.zeros(1), 1.0, 1.0)}
    more = find_closest_lines(lines, radius, np.zeros((1, 1)), bounds, 0.1)
    assert len(more) == 40 * 2 * 7


def test_a_family_has_at_most_ten_thousand_members():
    with pytest.raises(OptionError, match="at most 10,000 members"):
        updyn.plant_family(object(), ["1:X"], ["1:X"], (1.0, 2.0), n=10_001)


@pytest.mark.parametrize(("number", "plotted"), [(6, [0, 1, 2, 3, 4, 5]), (7, [1, 2, 3, 4, 5, 6])])
def test_the_six_channels_with_the_largest_errors_are_plotted(number, plotted):
    result = SimpleNamespace(
        plant=SimpleNamespace(outputs=range(number), inputs=range(1)),
        measure="relative",
        channel_errors=lambda measure: np.arange(number)[:, None],
    )
    assert channels(result) == [(i, 0) for i in plotted]


@pytest.mark.parametrize(("distance", "is_neighbour"), [(2.4e-4, True), (2.6e-4, False)])
def test_lines_within_a_four_thousandth_are_neighbours(distance, is_neighbour):
    freq = 100.0 * np.array([1.0, 1.0 + distance])
    highest = antiresonances._highest(freq, np.array([[1.0], [5.0]]))
    assert highest[0, 0] == (5.0 if is_neighbour else 1.0)
