"""Thresholds of plants: a case just inside and just outside of each."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import updyn
from nonlinear_plants import one_inertia
from updyn.control import antiresonances, complex_modes, rational_fit, weight, weight_fit
from updyn.control.antiresonances import antiresonance_shifts, find_antiresonances, find_dips
from updyn.control.causal import Circle, channel_differences
from updyn.control.family import PlantFamily
from updyn.control.files.description import describe_plant
from updyn.control.job.plant_result import resolving_lines
from updyn.control.lines import dense_lines
from updyn.control.measured import PortMeasurement, select_measurement
from updyn.control.ports import as_ports
from updyn.control.report.plant import channels
from updyn.control.sampled import sampled
from updyn.control.space import ModalSpace, _Projector, modal_space
from updyn.control.structure import CompiledStructure
from updyn.control.target import (
    CandidateSelection,
    ResponseTarget,
    select_fewest,
    target_lines,
)
from updyn.control.weight import family_lines, find_closest_lines, refuse_undamped
from updyn.control.weight_fit import Bound
from updyn.errors import DataError, ModelError, OptionError, UpdynWarning
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


@pytest.mark.parametrize(("error", "number"), [(0.55, 1), (0.65, 2)])
def test_lenient_errors_are_up_to_a_fifth_above_those_of_all_modes(error, number):
    """The last error is 0.5 with two candidates, above the tolerance of 0.1."""
    one = np.ones((1, 1, 1))
    conversion = SimpleNamespace(
        frequency=np.array([1.0, 2.0]),
        always_kept=np.zeros(2, dtype=bool),
        costs=lambda freq, level: np.array([2.0, 1.0]),
        response=lambda mask, freq: one * mask.sum(),
    )
    target = SimpleNamespace(
        broad=one,
        reference=one,
        measure="relative",
        freq=np.array([0.5]),
        limits=lambda tolerance: np.full(5, tolerance),
        all_errors=lambda G: np.array([0, 0, 0, 0, {0: 2.0, 1: error, 2: 0.5}[int(G[0, 0, 0])]]),
    )
    found = select_fewest(conversion, target, 0.1, lenient=True)
    assert found.holds
    assert found.mask.sum() == number


def test_the_gain_outside_the_band_is_ten_times_that_of_the_structure():
    plant, structure = (
        SimpleNamespace(
            frequency=np.zeros(1), response=lambda mask, lines, h=h: np.full((len(lines), 1, 1), h)
        )
        for h in (3.0, 2.0)
    )
    selection = CandidateSelection(plant, np.ones(1, dtype=bool), np.zeros(5), np.ones(5))
    freq, level = np.array([1.0, 2.0]), np.ones((2, 1, 1))
    power = np.zeros(1, dtype=int)
    (found,) = channel_differences(freq, lambda lines: 0.0, level, selection, structure, power)
    assert (found.below, found.above) == (23.0, 23.0)


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


@pytest.mark.parametrize(("outside", "rigid"), [(0.9e-6, 1), (1.1e-6, 0)])
def test_a_rigid_body_motion_is_in_the_basis_up_to_a_thousandth_of_its_size(outside, rigid):
    free = np.array([[1.0, -1.0], [-1.0, 1.0]])
    structure = CompiledStructure.of(Model({"all": Group(free, np.eye(2))}, ["1:X", "2:X"]))
    searched = []
    reduction = SimpleNamespace(
        shifted=SimpleNamespace(count_modes_below=lambda state, top: searched.append(top) or 1),
        measure_outside=lambda state, shapes: np.full(shapes.shape[1], outside),
    )
    assert _Projector(structure, (), (), (0.0, 40.0))._count_rigid(reduction) == rigid
    np.testing.assert_allclose(searched, [0.04])


# -- complex modes and rational fits --------------------------------------------------------------
def test_the_pole_of_a_velocity_is_at_ten_times_the_band():
    one = np.ones((1, 1))
    space = ModalSpace(np.array([10.0]), 0, one, one, 0.1 * one, (), "")
    found = complex_modes.complex_modes(space, np.array([1]), 40.0)
    assert found.fast == pytest.approx(TWO_PI * 400.0)


def test_real_poles_of_fitted_outputs_extend_to_three_times_the_band():
    target = SimpleNamespace(freq=np.array([3.0, 20.0]))
    found = complex_modes.fit_outputs(None, target, 2)
    np.testing.assert_allclose(found.extra / TWO_PI, [1.0, 60.0])


@pytest.mark.parametrize(("ratio", "solved"), [(1.2e-7, True), (0.8e-7, False)])
def test_nearly_equal_outputs_are_not_distinguished_below_a_ten_millionth(ratio, solved):
    """Columns at an angle of twice the ratio of their singular values."""
    angle = 2.0 * ratio
    A = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)]])
    nothing = np.zeros((0, 2)), np.zeros(0)
    x = complex_modes._constrained_least_squares(A, np.array([0.0, 1.0]), *nothing)
    assert (abs(x[1]) > 1e6) == solved


@pytest.mark.parametrize(("distance", "near"), [(0.019, True), (0.021, False)])
def test_a_pair_represents_a_pole_within_a_fiftieth(distance, near):
    poles = SimpleNamespace(poles=np.array([1j, 5j]))
    (found,) = rational_fit.Approximation._nearest_poles(poles, np.array([1j / (1.0 - distance)]))
    assert found == 1j if near else np.isnan(found)


def test_weights_change_by_the_root_of_the_error_and_a_fiftieth():
    factors = rational_fit._weight_factors(np.array([0.0, 1.0, 4.0]))
    np.testing.assert_allclose(factors**2, [0.02, 0.27, 1.02])


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


def test_lines_of_a_family_extend_to_ten_times_its_poles():
    plant = oscillators([10.0], 1e-3)
    family = PlantFamily(plant, (plant,))
    lines = family_lines(family, [plant.poles])
    np.testing.assert_allclose(lines[[0, -1]], [0.1, 1000.0])


def test_places_within_six_tenths_of_the_closest_are_refined_first(monkeypatch):
    """In log |W|: 0.005 in the last of four rounds, and five times as much in each before."""
    within = []

    def find(lines, radius, floors, bounds, distance):
        within.append(distance)
        return 1.5 * lines[-1:] if len(within) < 4 else np.zeros(0)

    monkeypatch.setattr(weight, "find_closest_lines", find)
    plant = oscillators([10.0], 1e-2)
    weight.uncertainty_weight(PlantFamily(plant, (plant,)), order=0)
    np.testing.assert_allclose(within, [0.625, 0.125, 0.025, 0.005])


@pytest.mark.parametrize(("violation", "again"), [(0.019, False), (0.021, True)])
def test_a_weight_is_fitted_again_if_violated_by_a_fiftieth(violation, again):
    bound = Bound(0, np.zeros(1), 1.0, 1.0)
    assert weight._needs_refit(bound, np.ones(1), np.exp([violation])) == again


def test_a_weight_is_a_thousandth_above_its_lines():
    bound, ones = Bound(0, np.zeros(1), 1.0, 1.0), np.ones(3)
    found = weight._weight(np.array([1.0, 2.0, 3.0]), ones, 0.1, bound, "")
    assert np.log(found.gain) == pytest.approx(1e-3)


# -- fit of a weight ------------------------------------------------------------------------------
def test_the_largest_excess_counts_a_tenth_of_the_mean():
    level, share = np.array([0.0, -1.0]), np.full(2, 0.5)
    *_, cost = weight_fit._lift_above(np.zeros(1), 0, np.array([1.0, 2.0]), level, share)
    assert cost == pytest.approx(0.5 + 0.1)


def test_dampings_of_a_section_are_from_a_hundred_thousandth_to_a_hundred():
    lower, upper = weight_fit._bounds(2, np.array([1.0, 2.0]))
    np.testing.assert_allclose(np.exp([lower[2], upper[2]]), [1e-5, 1e2])


@pytest.mark.parametrize(("excess", "gaps"), [(0.31, 1), (0.29, 2)])
def test_a_gap_ends_where_the_excess_is_three_tenths_of_the_largest(excess, gaps):
    bound, omega = Bound(0, np.zeros(1), 1.0, 1.0), np.arange(1.0, 6.0)
    level = -np.array([0.0, 1.0, excess, 1.0, 0.0])
    assert len(weight_fit._touched_and_free(bound, omega, level, np.ones(5))[1]) == gaps


@pytest.mark.parametrize(
    ("peaks", "lines"),
    [((0.0019, 0.0), []), ((0.0021, -0.06), [2]), ((0.1, 0.04), [2]), ((0.1, 0.06), [3])],
)
def test_a_fit_gets_the_lines_within_a_twentieth_of_a_violation(monkeypatch, peaks, lines):
    """Without new lines, the gain corrects up to 0.2 %. The fit has one line before."""
    used = []

    def descend(p, order, omega, *_):
        used.append(len(omega))
        return p, 0.0

    monkeypatch.setattr(weight_fit, "_descend", descend)
    monkeypatch.setattr(weight_fit, "WEIGHT_FIT", replace(weight_fit.WEIGHT_FIT, exchanges=1))
    level = np.array([-1.0, peaks[0], -1.0, peaks[1], -1.0])
    few = (np.ones(1), -np.ones(1), np.ones(1))
    bound, omega = Bound(0, np.zeros(1), 1.0, 1.0), np.arange(1.0, 6.0)
    weight_fit._polish_bound(bound, few, omega, level, np.full(5, 0.2))
    assert used == lines


# -- measurements ---------------------------------------------------------------------------------
def test_a_plant_of_a_measurement_needs_eight_lines():
    values = np.ones((7, 1, 1), dtype=complex)
    frf = updyn.FRF(np.arange(1.0, 8.0), values, ["1:X"], ["1:X"], "receptance")
    port = as_ports(["1:X"], "input")
    with pytest.raises(DataError, match=r"7 lines .* requires at least 8"):
        select_measurement(frf, port, port, ("receptance",), (1.0, 10.0))


def test_a_plant_may_lie_within_three_standard_deviations():
    target = SimpleNamespace(reference=np.array([1.0, 2.0]))
    data = PortMeasurement(target, np.full(2, 0.01), np.zeros(0), "variance")
    np.testing.assert_allclose(data.reference(0.02), [1.5, 2.0])


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
