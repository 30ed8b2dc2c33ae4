"""Thresholds of modal identification: a case on either side of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from updyn.errors import DataError, SolverError
from updyn.frf import FRF
from updyn.modal import (
    fits,
    identify,
    leaning,
    lscf,
    peaks,
    picks,
    runs,
    sensitivity,
    settle,
    stabilisation,
    tiles,
)
from updyn.modal.alike import find_alike_pairs
from updyn.modal.axis import Axis
from updyn.modal.envelope import Envelope
from updyn.modal.measured import Measured, group_overlapping
from updyn.modal.refine import ChannelNoise, LineWindow
from updyn.modal.runs import _is_in_several_runs
from updyn.modal.search import Visibility
from updyn.modal.sensitivity import RealModes
from updyn.modal.vector_fitting import RationalBasis, _place_pole, _stable

FREQ = np.linspace(1.0, 100.0, 400)
AXIS = Axis(mirrored=False, unit=2.0 * np.pi * 100.0)


def pole(frequency: float, loss: float) -> complex:
    return complex(AXIS.pole(np.array([frequency]), loss)[0])


def measured(freq: np.ndarray = FREQ) -> Measured:
    """Return functions of two responses and two references without modes."""
    cube = np.ones((len(freq), 2, 2), dtype=np.complex128)
    return Measured(AXIS, freq, AXIS.at(freq), cube, np.ones((2, 2)), Envelope.white())


# -- windows ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("loss", "inside"), [(-1.1e-9, 0), (-0.9e-9, 1), (0.49, 1), (0.51, 0)])
def test_a_mode_is_damped(loss, inside):
    assert measured().is_inside(np.array([pole(50.0, loss)]))[0] == inside


@pytest.mark.parametrize(("gap", "count"), [(0.79, 1), (0.81, 2)])
def test_modes_overlap_within_four_bandwidths(gap, count):
    groups = group_overlapping(np.array([10.0, 10.0 + gap]), np.array([0.1, 0.1]))
    assert len(groups) == count


def test_a_window_has_six_modes():
    assert len(group_overlapping(np.linspace(10.0, 10.1, 6), np.full(6, 0.1))) == 1
    assert len(group_overlapping(np.linspace(10.0, 10.1, 7), np.full(7, 0.1))) == 2


def test_a_window_has_twenty_lines_and_four_for_each_mode():
    lines = measured().lines_of(np.array([pole(50.0, 1e-6)]))
    assert lines.stop - lines.start in (26, 27)
    wide = measured().lines_of(np.array([pole(50.0, 0.1)]))  # 50 +- 4 * 5 Hz
    assert FREQ[wide][[0, -1]] == pytest.approx([30.0, 70.0], abs=0.6)


def test_a_window_has_a_fixed_pole_for_five_lines():
    others = np.array([pole(f, 0.01) for f in np.linspace(20.0, 30.0, 30)])
    assert len(measured().window(slice(80, 130), others).fixed_poles) == 10


def test_modes_need_four_lines():
    lines = np.arange(1.0, 5.0)
    four = FRF(lines, np.ones((4, 1, 1)), ["1:X"], ["1:X"], "mobility")
    assert len(Measured.of(four, mirrored=False).freq) == 4
    with pytest.raises(DataError, match="3 lines are too few"):
        Measured.of(four.select(lines=lines[:3]), mirrored=False)


# -- noise -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("n", "change", "white"), [
    (255, 0.0, True),
    (256, 0.0, False),
    (256, 0.9e-3, False),
    (256, 1.1e-3, True),
])  # fmt: skip
def test_noise_is_white_unless_lines_are_many_and_even(n, change, white):
    freq = np.arange(float(n))
    freq[n // 2 :] += change
    rng = np.random.default_rng(0)
    values = rng.standard_normal((n, 4)) + 1j * rng.standard_normal((n, 4))
    assert Envelope.of(freq, values).is_white is white


@pytest.mark.parametrize(("channels", "white"), [(7, True), (8, False)])
def test_the_envelope_of_residuals_takes_eight_functions(channels, white):
    rng = np.random.default_rng(0)
    residual = rng.standard_normal((channels, 20)) + 0j
    none = np.zeros((20, 0), dtype=np.complex128)
    assert Envelope.of_residuals([(none, residual)]).is_white is white


def test_noise_below_rounding_is_rounding():
    noise = ChannelNoise.of(np.zeros((1, 8)), np.full((1, 8), 4.0))
    assert noise.floor[0] == pytest.approx(4e-24, rel=1e-3, abs=0.0)


def test_an_undamped_pole_has_a_width():
    window = LineWindow(RationalBasis(3, False), AXIS.at(FREQ), np.ones((1, 400)), np.zeros(0))
    assert window.width(np.array([2.0 + 0j])) == pytest.approx(2e-6)


@pytest.mark.parametrize(("lines", "windows"), [(29, 3), (30, 2)])
def test_noise_is_that_of_sixty_lines(monkeypatch, lines, windows):
    monkeypatch.setattr(settle.ChannelNoise, "of", lambda squares, sizes: squares.shape[1])
    squares = [np.ones((1, lines))] * 4
    residuals = settle._Residuals(np.array([10.0, 20.0, 30.0, 40.0]), squares, squares)
    assert residuals.noise(measured(), np.array([pole(10.0, 0.01)])) == windows * lines


# -- vector fitting --------------------------------------------------------------------------------
def test_a_pole_that_is_real_but_for_rounding_is_real():
    mirrored = RationalBasis(3, True)
    found = _stable(mirrored, np.array([-1.0 + 0.9e-9j, -1.0 + 1.1e-9j, 0.0 + 1.0j]))
    assert (found.imag != 0.0).tolist() == [False, True, True]
    assert found[2].real == pytest.approx(-1e-14, rel=1e-6, abs=0.0)


def test_a_new_pole_has_a_loss_factor_of_one_percent():
    x = AXIS.at(FREQ)
    error = np.zeros((400, 1))
    error[200] = 1.0
    new = _place_pole(RationalBasis(3, False), x, error, np.zeros(0, dtype=np.complex128))
    assert AXIS.loss(np.array([new]))[0] == pytest.approx(0.01)


# -- data without noise ----------------------------------------------------------------------------
@pytest.mark.parametrize(("missing", "fitted"), [(0.9e-4, True), (1.1e-4, False)])
def test_modes_that_explain_all_are_fitted_exactly(monkeypatch, missing, fitted):
    called = []
    monkeypatch.setattr(identify, "_fit_exactly", lambda *given: called.append(given))
    mode = SimpleNamespace(quality=1.0 - missing, pole=pole(50.0, 0.01))
    identify._refine_exact_modes(measured(), [mode])
    assert bool(called) is fitted
    if called:
        assert called[0][2] == 1 + 16


@pytest.mark.parametrize(
    ("costs", "poles"),
    [
        ([1e-3, 1.1e-18], None),
        ([1e-3, 0.9e-18], 1),
        ([0.9e-18, 1e-21], 0),
        ([1.1e-18, 1e-21], 1),
    ],
)
def test_an_exact_fit_has_the_fewest_poles(monkeypatch, costs, poles):
    found = [SimpleNamespace(cost=cost, poles=k) for k, cost in enumerate(costs)]
    monkeypatch.setattr(identify, "fit_increasing_orders", lambda *given: found)
    assert identify._find_exact_poles(None, None, np.ones((1, 1)), None, 4) == poles


# -- stabilisation ---------------------------------------------------------------------------------
@pytest.mark.parametrize(("n", "count"), [(299, 1), (301, 2)])
def test_a_part_of_the_diagram_has_two_hundred_lines(n, count):
    assert len(stabilisation._split_band(np.arange(float(n)))) == count


@pytest.mark.parametrize(("n", "largest"), [(54, 10), (400, 32)])
def test_orders_of_the_diagram(monkeypatch, n, largest):
    damping = np.array([0.29, 0.31])
    poles = 2.0 * np.pi * 0.5 * n * (-damping + 1j * np.sqrt(1.0 - damping**2))
    monkeypatch.setattr(stabilisation, "fit_orders", lambda omega, Y, orders: [poles] * len(orders))
    found = stabilisation._fit_part(np.arange(1.0, n + 1.0), np.ones((n, 2, 2)))
    assert [order for order, _ in found] == list(range(2, largest + 1, 2))
    assert all(len(inside) == 1 for _, inside in found)


@pytest.mark.parametrize(("columns", "kept"), [(3, 3), (4, 4), (6, 4)])
def test_columns_of_the_diagram(columns, kept):
    Y = np.random.default_rng(0).standard_normal((5, 8, columns)) + 0j
    assert stabilisation._combine_columns(Y).shape[2] == kept


@pytest.mark.parametrize(("orders", "stable"), [(2, 0), (3, 1)])
def test_a_stable_pole_has_three_orders(orders, stable):
    chains, _ = stabilisation._find_chains([np.array([-1.0 + 50.0j])] * orders, 0.1)
    assert len(chains) == stable


@pytest.mark.parametrize(("off", "pairs"), [(0.29, 1), (0.31, 0)])
def test_a_stable_pole_is_near(off, pairs):
    one, other = np.array([-1.0 + 50.0j]), np.array([-1.0 + (50.0 + off) * 1j])
    assert len(stabilisation._pair_nearest(other, one, 0.1)) == pairs


# -- search ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("n", "count"), [(89, 1), (91, 2)])
def test_a_tile_has_sixty_lines(n, count):
    found = list(tiles._tile_gap(FREQ, 0, 100, 100 + n))
    assert len(found) == count
    assert (found[0].lines.start, found[-1].lines.stop) == (85, 115 + n)


def test_trial_poles_of_a_tile():
    tile = tiles._Tile(slice(0, 0), slice(100, 160), FREQ[100], FREQ[160])
    losses = AXIS.loss(tiles._make_trial_poles(measured(), np.zeros(0), tile))
    width = (FREQ[1] - FREQ[0]) / FREQ[130]
    assert np.unique(np.round(losses / width, 6)).tolist() == [1.0, 4.0]
    # The step is half of the width: 59 lines / 0.5 at the lowest frequency.
    assert np.count_nonzero(losses < 2.0 * width) == int(59 / (0.5 * FREQ[100] / FREQ[130]))
    heavy = tiles._make_trial_poles(measured(), np.array([pole(30.0, 0.4)]), tile)
    assert AXIS.loss(heavy) == pytest.approx(0.3)
    light = tiles._make_trial_poles(measured(), np.array([pole(30.0, 1e-5)]), tile)
    assert len(light) == 200


# -- physical modes --------------------------------------------------------------------------------
@pytest.mark.parametrize(("mac", "count"), [(0.89, 0), (0.91, 1)])
def test_shapes_are_alike(mac, count):
    shapes = np.array([[1.0, np.sqrt(mac)], [0.0, np.sqrt(1.0 - mac)]])
    modes = SimpleNamespace(
        shapes=shapes, frequency=np.array([1.0, 2.0]), loss_factor=np.full(2, 0.01)
    )
    assert len(find_alike_pairs(modes)) == count


SEEN, HIDDEN = Visibility(True, True, False), Visibility(False, True, False)


@pytest.mark.parametrize(
    ("sizes", "quality", "visibility", "physical"),
    [
        ((1.0, 0.9, 0.29), 0.5, SEEN, True),
        ((1.0, 0.9, 0.31), 0.5, SEEN, False),
        ((1.0, 0.09, 0.0), 0.5, HIDDEN, True),
        ((1.0, 0.11, 0.0), 0.5, HIDDEN, False),
        ((1.0, 0.0, 0.0), 0.09, SEEN, False),
        ((1.0, 0.0, 0.0), 0.11, SEEN, True),
    ],
)
def test_a_physical_mode(sizes, quality, visibility, physical):
    mode = SimpleNamespace(
        residues=np.diag(sizes).ravel(), quality=quality, visibility=visibility, everywhere=True
    )
    data = SimpleNamespace(level=np.ones((3, 3)))
    assert identify._is_physical(data, mode) is physical


@pytest.mark.parametrize(
    ("share", "everywhere", "somewhere", "cancelled"),
    [
        (0.09, False, False, False),
        (0.11, True, False, False),
        (0.49, True, False, False),
        (0.51, True, True, False),
        (9.9, True, True, False),
        (10.1, True, True, True),
    ],
)
def test_a_pole_is_visible(share, everywhere, somewhere, cancelled):
    x = AXIS.at(FREQ)
    at = np.zeros(400, dtype=bool)
    at[200] = True
    Y = np.ones((1, 400), dtype=np.complex128)
    window = LineWindow(RationalBasis(3, False), x, Y, np.zeros(0, dtype=np.complex128))
    where = complex(x[200]) + 0.01j
    residue = np.array([share * 0.01 + 0j])  # over the distance of the line, it is the share
    found = Visibility.of(window, where, residue, at, np.array([np.inf]))
    assert found == Visibility(everywhere, somewhere, cancelled)


# -- bundles ---------------------------------------------------------------------------------------
def one_fit(poles: np.ndarray, residues: np.ndarray | None = None) -> SimpleNamespace:
    none = np.full(len(poles), -1)
    window_fit = SimpleNamespace(poles=poles, residues=residues)
    window = SimpleNamespace(
        basis=RationalBasis(3, False), width=lambda poles: np.abs(np.asarray(poles).imag)
    )
    return SimpleNamespace(window_fit=window_fit, added=none, window=window)


@pytest.mark.parametrize(
    ("distance", "ratio", "count"), [(2.9, 1.0, 1), (3.1, 1.0, 2), (0.1, 3.9, 1), (0.1, 4.1, 2)]
)
def test_poles_in_a_bundle(distance, ratio, count):
    poles = np.array([0.5 + 1e-3j, 0.5 + 1e-3 * distance + 1e-3j * ratio])
    assert len(fits.bundle_poles(measured(), [one_fit(poles)])) == count


def shape_of(mac: float, n: int) -> np.ndarray:
    shape = np.zeros(n, dtype=np.complex128)
    shape[:2] = np.sqrt(mac), np.sqrt(1.0 - mac)
    return shape


@pytest.mark.parametrize(
    ("mac", "quality", "split"),
    [(0.98, 0.49, True), (0.96, 0.49, False), (0.98, 0.51, False)],
)
def test_a_mode_is_split_off(mac, quality, split):
    def mode(mac, quality):
        return SimpleNamespace(residues=shape_of(mac, 5), quality=quality, pole=0.5 + 1e-3j)

    one, other = mode(mac, quality), mode(1.0, 0.9)
    assert runs.is_split_off(one, [one, other], (5, 1), False) is split


@pytest.mark.parametrize(("mac", "channels", "parts"), [(0.98, 4, 1), (0.96, 4, 0), (0.98, 3, 0)])
def test_poles_of_one_shape(mac, channels, parts):
    rows, columns = (index.ravel() for index in np.indices((channels, 2)))
    residues = np.array([np.repeat(shape_of(m, channels), 2) for m in (1.0, mac)])
    found = runs._group_by_shape(one_fit(np.zeros(2), residues), [0, 1], (rows, columns))
    assert sum(len(roving) == 1 for _, roving in found) == parts


@pytest.mark.parametrize(("share", "separate"), [(0.009, True), (0.011, False)])
def test_poles_are_in_separate_runs(share, separate):
    increase = np.array([[1.0, share], [share, 1.0]])
    fit = SimpleNamespace(window_fit=SimpleNamespace(cost_increase_by_channel=increase))
    assert runs._are_in_separate_runs(fit, [0, 1], np.array([0, 1])) is separate


@pytest.mark.parametrize(("off", "strayed"), [(2.9, False), (3.1, True)])
def test_a_pole_strays_from_the_common_ones(off, strayed):
    fit = one_fit(np.array([0.5 + 1e-3j]))
    found = runs._have_strayed(fit, [0], np.array([0.5 + 1e-3 * off + 1e-3j]))
    assert bool(found[0]) is strayed


# -- peaks and picks -------------------------------------------------------------------------------
@pytest.mark.parametrize(("mac", "lasting"), [(0.69, False), (0.71, True)])
def test_a_peak_lasts_over_two_lines(mac, lasting):
    scaled = np.array([[[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]], [shape_of(mac, 3)]])
    assert peaks._is_lasting(scaled, 1) is lasting


@pytest.mark.parametrize(("off", "loss"), [(0.9e-5, 0.04), (1.1e-5, 0.01)])
def test_a_pick_is_a_pole_of_the_diagram(off, loss):
    diagram = SimpleNamespace(
        stable=np.array([True]),
        frequency=np.array([50.0 * (1.0 + off)]),
        damping=np.array([0.02]),
        order=np.array([4]),
    )
    begin = picks.start_pole_at(measured(), diagram, np.array([pole(50.0, 0.01)]), 50.0)
    assert AXIS.loss(np.array([begin]))[0] == pytest.approx(loss, rel=1e-2)


@pytest.mark.parametrize(("off", "same"), [(0.49, True), (0.51, False)])
def test_a_pick_is_a_pole_of_the_fits(off, same):
    fitted = np.array([0.5 + 1e-3j])
    assert picks._find_same(measured(), fitted, 0.5 + off * 1e-3 + 1e-3j)[0] == same


@pytest.mark.parametrize(("off", "merged"), [(0.09, True), (0.11, False)])
def test_a_pick_merges_with_a_mode(off, merged):
    at = pole(50.0, 0.01)
    other = at + off * 0.01 * abs(at)  # in bandwidths
    given = measured(), at, at, np.zeros(0), np.array([other])
    if merged:
        with pytest.raises(DataError, match="merges with"):
            picks._check_added(*given)
    else:
        picks._check_added(*given)


# -- derivatives -----------------------------------------------------------------------------------
@pytest.mark.parametrize(("gap", "count"), [(0.9e-7, 2), (1.1e-7, 1)])
def test_eigenvalues_are_equal(gap, count):
    modes = SimpleNamespace(value=np.array([1.0, 1.0 + gap]))
    assert len(RealModes.find_repeated(modes, 0)) == count


def test_unknowns_couple_modes():
    sensitivity._check_uncoupled(np.array([[1.0, 0.9e-6]]), 0, np.ones(1), 1.0)
    with pytest.raises(SolverError, match="couple"):
        sensitivity._check_uncoupled(np.array([[1.0, 1.1e-6]]), 0, np.ones(1), 1.0)


@pytest.mark.parametrize(("share", "turned"), [(0.49, False), (0.51, True)])
def test_a_measured_shape_determines_a_basis(share, turned):
    # The measured shape is at 30 degrees in the plane of the two, with this share of its square.
    part = np.sqrt(share) * np.array([np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)])
    measured_shape = np.array([[part[0]], [part[1]], [np.sqrt(1.0 - share)]])
    rotation = sensitivity._rotate_towards_measured(np.eye(3)[:, :2], measured_shape)
    assert (abs(rotation[1, 0]) > 0.1) == turned


def test_stable_poles_are_near_relative_to_the_spacing_of_lines(monkeypatch):
    """A fifth of it, here 0.5 Hz."""
    seen = []
    freq = np.arange(1.0, 9.0, 0.5)

    def find_chains(fits, least):
        seen.append(least)
        return np.zeros(0, dtype=complex), []

    monkeypatch.setattr(stabilisation, "_split_band", lambda freq: [(0, len(freq), 1.0, 9.0)])
    monkeypatch.setattr(stabilisation, "_fit_part", lambda *about: [])
    monkeypatch.setattr(stabilisation, "_find_chains", find_chains)
    stabilisation.find_stable_poles(freq, np.ones((len(freq), 1, 1)))
    assert seen == pytest.approx([0.2 * 2.0 * np.pi * 0.5])


@pytest.mark.parametrize(("share", "is_kept"), [(0.9e-4, True), (1.1e-4, False)])
def test_a_pole_is_undamped_up_to_a_growth_of_a_ten_thousandth(share, is_kept):
    """The roots of a polynomial of degree 2 in z = exp(-s step)."""
    step = 0.1
    pole = (share + 1.0j * np.sqrt(1.0 - share**2)) * 2.0
    z = np.exp(-pole * step)
    M = np.zeros((3, 3))
    M[:2, :2] = np.eye(2)
    M[:2, 2] = -(abs(z) ** 2), 2.0 * z.real
    found = lscf._find_roots(M, 2, 1, step, np.zeros(1))
    assert len(found) == is_kept
    if is_kept:
        assert found == pytest.approx([complex(-pole.real, pole.imag)])


@pytest.mark.parametrize(("number", "is_in_several"), [(1.19, False), (1.21, True)])
def test_a_mode_is_in_several_runs(number, is_in_several):
    """Two runs with shares 1 and a have the effective number (1 + a)^2 / (1 + a^2)."""
    a = (1.0 - np.sqrt(1.0 - (number - 1.0) ** 2)) / (number - 1.0)
    residues = np.sqrt([0.5, 0.5, a])
    assert _is_in_several_runs(residues, np.array([0, 0, 1])) == is_in_several


@pytest.mark.parametrize(("p", "count"), [(4, 1), (9, 5)])
def test_shifts_agree_by_chance_at_one_of_a_hundred_peaks(p, count):
    """Hotelling's T^2 of two components of p channels."""
    expected = 2.0 * (p - 1) / (p - 2) * scipy.stats.f.isf(0.01 / count, 2, p - 2)
    assert leaning._chance_agreement(p, count) == pytest.approx(expected)


def test_leaning_peaks_are_found_in_two_rounds(monkeypatch):
    rounds = []
    monkeypatch.setattr(leaning, "_estimate_envelope", lambda *about: rounds.append(1))
    monkeypatch.setattr(leaning, "_find_in_bundle", lambda *about: ["peak"])
    assert leaning.find_leaning(None, [], ["bundle"]) == ["peak"]
    assert len(rounds) == 2
