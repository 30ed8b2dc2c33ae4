"""Noise or structure: p-values against simulation and exact tails, false alarms, what is said of a planted misfit."""

import re

import numpy as np
import pytest
from scipy.stats import chi2, combine_pvalues, f, false_discovery_control

from updyn.updating.judge import adequacy
from updyn.updating.judge.adequacy import (
    Suspect,
    _combine_p_values,
    _find_isolated_lines,
    _find_noisy_sensors,
    add_suspects,
    adjust_p_values,
    assess_residual,
    can_be_sensor_noise,
    clip_outliers,
    divide_into_bands,
    serial_correlation_p_values,
)
from updyn.updating.judge.settings import RESIDUAL_TEST

RNG = np.random.default_rng
N_F, N_I, N_J = 60, 4, 2
FREQ = np.linspace(1.0, 100.0, N_F)
H = sum(1.0 / (f0**2 - FREQ**2 + 0.02j * f0**2) for f0 in (15.0, 40.0, 75.0))[
    :, None, None
] * np.ones((N_I, N_J))
RESPONSES, REFERENCES = [f"{i}:Z" for i in range(1, N_I + 1)], ["2:Z", "4:-Z"]


def noise(seed, shape=(N_F, N_I, N_J)):
    """Unit variance of the real and of the imaginary part."""
    rng = RNG(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def look(whitened, **options):
    n_i, n_j = whitened.shape[1:]
    settings = {"n_unknowns": 0, "absolute": True} | options
    settings.setdefault("whitened_H", 100.0 * H[:, :n_i, :n_j] / np.abs(H[:, :n_i, :n_j]))
    return assess_residual(
        whitened, H[:, :n_i, :n_j], FREQ, RESPONSES[:n_i], REFERENCES[:n_j], **settings
    )


# -- likeness along lines ------------------------------------------------------------------------------------
def test_of_two_neighbours_the_tail_is_known_in_closed_form():
    """Five values of which only two are neighbours: 2 Re(e1* e2) / |e|^2 has eigenvalues 3/4, 0, 0, 0, -3/4 of T.

    P(sum a_j E_j > 0) with a = (3/4 - r, -r, -r, -r, -3/4 - r) by partial fractions; a repeated
    pole is split slightly."""
    at = [0, 1, 10, 20, 30]
    rng = RNG(1)
    e = np.full((31, 400), np.nan, dtype=complex)
    e[at] = rng.standard_normal((5, 400)) + 1j * rng.standard_normal((5, 400))
    r = 2.0 * 0.75 * (e[0].conj() * e[1]).real / np.sum(np.abs(e[at]) ** 2, axis=0)
    positive = np.flatnonzero((r > 0.1) & (r < 0.6))
    a = np.array([0.75 - r, -r, -1.0001 * r, -0.9999 * r, -0.75 - r])
    exact = np.prod([a[0] / (a[0] - a[k]) for k in range(1, 5)], axis=0)
    assert len(positive) > 50
    assert serial_correlation_p_values(e)[positive] == pytest.approx(exact[positive], rel=0.06)


@pytest.mark.parametrize("m", [5, 12, 60])
def test_p_values_of_noise_are_uniform_far_into_the_tail(m):
    p = serial_correlation_p_values(noise(m, (m, 40_000)))
    for q in (0.5, 0.1, 0.01, 0.001):
        assert np.mean(p < q) == pytest.approx(q, rel=0.15 if q > 0.001 else 0.35)


def test_cutting_outliers_back_leaves_the_p_values_of_noise_and_silences_an_outlier():
    p = serial_correlation_p_values(clip_outliers(noise(3, (20, 20_000))))
    assert np.mean(p < 0.01) == pytest.approx(0.01, rel=0.2)
    hit = noise(4, (60, 1000))
    hit[30:35] *= 30.0  # a glitch of five lines, each of its own phase
    assert np.mean(serial_correlation_p_values(hit) < 0.001) > 0.05
    assert np.mean(serial_correlation_p_values(clip_outliers(hit)) < 0.001) < 0.02


def test_likeness_does_not_depend_on_the_scale_and_is_one_sided():
    e = noise(5, (30, 50))
    assert serial_correlation_p_values(1e-9 * e) == pytest.approx(serial_correlation_p_values(e))
    smooth = np.exp(0.05j * np.arange(30))[:, None]
    assert serial_correlation_p_values(smooth + 0.3 * e).max() < 1e-6
    alternating = smooth * (-1.0) ** np.arange(30)[:, None]
    assert serial_correlation_p_values(alternating + 0.3 * e).min() > 0.5


def test_too_few_values_or_none_are_not_tested():
    e = noise(6, (10, 3))
    e[4:, 0] = np.nan
    e[:, 1] = 0.0
    assert serial_correlation_p_values(e)[:2].tolist() == [1.0, 1.0]
    assert serial_correlation_p_values(e)[2] == serial_correlation_p_values(e[:, 2:])[0] < 1.0


# -- many tests ------------------------------------------------------------------------------------------------
def test_adjusted_p_values_by_hand():
    """Benjamini & Hochberg: p_(k) n / k, made monotone from above; Table of four by hand."""
    assert adjust_p_values(np.array([0.04, 0.01, 0.03, 0.5])) == pytest.approx(
        [4 * 0.04 / 3, 0.04, 4 * 0.04 / 3, 0.5]
    )


def test_adjusted_and_combined_p_values_as_scipy_has_them():
    p = RNG(5).random((7, 6)) ** 4
    assert adjust_p_values(p).ravel() == pytest.approx(
        false_discovery_control(p.ravel()), rel=1e-12
    )
    for axis in (0, 1, None):
        expected = combine_pvalues(p, "stouffer", axis=axis).pvalue
        assert _combine_p_values(p, axis) == pytest.approx(expected, rel=1e-9)
    untested = np.where(np.arange(6) % 2 == 0, p, 1.0)
    expected = combine_pvalues(untested[:, ::2], "stouffer", axis=1).pvalue
    assert _combine_p_values(untested, 1) == pytest.approx(expected, rel=1e-9)
    assert _combine_p_values(np.ones((2, 3)), 1) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("absolute", [True, False])
def test_pure_noise_seldom_raises_an_alarm(absolute):
    found = [look(noise(seed), absolute=absolute) for seed in range(200)]
    assert sum(not a.adequate for a in found) <= 10  # 5 % of runs; the level is 2 %
    assert {a.verdict for a in found if a.adequate} == {
        "The residual cannot be distinguished from noise"
        + ("." if absolute else ", whose size was estimated from it.")
    }
    assert all(a.worst == () and a.p_value > RESIDUAL_TEST.alarm_level for a in found if a.adequate)


def test_noise_whose_size_was_told_from_averages_seldom_raises_an_alarm():
    """Variances from 5 averages scatter with 4 degrees of freedom; taken band by band here."""
    alarms = blind = 0
    for seed in range(100):
        e = noise(seed).copy()
        rng = RNG(1000 + seed)
        for k in divide_into_bands(np.log(np.abs(H[:, 0, 0]))):
            n = k.stop - k.start
            e[k] /= np.sqrt(rng.gamma(4.0 * n, 1.0 / (4.0 * n), (N_I, N_J)))
        alarms += not look(e, averages=5).adequate
        blind += not look(e).adequate
    assert alarms <= 5
    assert blind > alarms


# -- what is said ------------------------------------------------------------------------------------------------
def planted(size):
    """Noise, and in channel 3:Z / 4:-Z from line 40 to 51 a misfit of one phase."""
    e = noise(11)
    e[40:52, 2, 1] += size * np.sqrt(2.0) * np.exp(0.3j + 0.05j * np.arange(12))
    return e


def test_a_planted_misfit_is_named_with_place_size_and_length():
    found = look(planted(4.0))
    assert found.outcome == "structure"
    assert not found.adequate
    worst = found.worst[0]
    assert (worst.response, worst.reference, worst.kind) == ("3:Z", "4:-Z", "structure")
    assert FREQ[40] <= worst.near <= FREQ[51]
    assert worst.low <= worst.near <= worst.high
    assert worst.chi_square_p < 1e-6
    assert worst.whiteness_p < 1e-4
    assert found.verdict.startswith(
        f"The model cannot explain channel 3:Z / 4:-Z near {worst.near:.4g} Hz: misfit "
    )
    assert (
        f"misfit {worst.misfit:.2g} times the noise, serially correlated over {worst.correlation_length:.0f} lines"
        in found.verdict
    )
    at = np.argwhere(found.bands[:, 0] == worst.low)[0, 0]
    assert found.misfit[2, 1, at] == worst.misfit
    band = (found.bands[at, 0] <= FREQ) & (found.bands[at, 1] >= FREQ)
    e = planted(4.0)[band, 2, 1]
    assert worst.misfit == pytest.approx(np.sqrt(np.mean(np.abs(e) ** 2) / 2.0))


def test_p_values_of_size_are_those_of_chi_square_and_of_f():
    e = planted(2.0)
    for absolute in (True, False):
        found = look(e, absolute=absolute, n_unknowns=3)
        square = np.stack(
            [
                np.sum(np.abs(e[k]) ** 2, axis=0)
                for k in divide_into_bands(np.log(np.abs(H[:, 0, 0])))
            ],
            axis=-1,
        )
        count = np.stack(
            [
                np.full((N_I, N_J), 2.0 * (k.stop - k.start))
                for k in divide_into_bands(np.log(np.abs(H[:, 0, 0])))
            ],
            -1,
        )
        if absolute:
            p = chi2.sf(square, count)
        else:
            rest = 2.0 * e.size - count - 3
            p = f.sf((square / count) / ((square.sum() - square) / rest), count, rest)
        least = float(p.min())
        # Four families; among the places there are as many tests of size as of likeness.
        assert found.chi_square_p.min() <= 4.0 * 2 * p.size * least * (1 + 1e-9)
        assert found.chi_square_p.min() >= 4.0 * least


def test_structure_is_found_though_the_noise_was_taken_from_it():
    found = look(planted(4.0), absolute=False)
    assert found.outcome == "structure"
    assert "times the typical misfit" in found.verdict


def test_a_noisy_sensor_is_not_called_an_error_of_the_model():
    e = noise(12)
    e[:, 1] *= 3.0
    found = look(e)
    assert found.outcome == "excess"
    assert {m.response for m in found.worst} == {"2:Z"}
    assert [one.response for one in found.noisy] == ["2:Z"]
    assert found.noisy[0].times == pytest.approx(3.0, rel=0.15)  # of 360 numbers and more
    assert found.verdict.startswith("The residual is noise of different size at the sensors: ")
    assert found.verdict.endswith(" times that of most sensors at 2:Z.")


@pytest.mark.parametrize("absolute", [True, False])
def test_sensors_of_unlike_noise_are_named_the_worst_first(absolute):
    e = noise(22) * np.array([1.0, 6.0, 0.9, 3.0])[:, None]
    found = look(e, absolute=absolute)
    assert [one.response for one in found.noisy] == ["2:Z", "4:Z"]


def test_a_glitch_beside_a_noisy_sensor_is_not_passed_over():
    e = noise(12)
    e[:, 1] *= 3.0
    e[30:33, 0, 0] *= 12.0
    found = look(e)
    assert found.outcome == "excess"
    assert found.noisy == ()
    assert "More noise than expected, or outliers, in channel" in found.verdict
    assert "not serially correlated" in found.verdict


def test_noise_of_one_size_names_no_sensor():
    alike = [look(noise(seed), absolute=False) for seed in range(100)]
    assert not any(found.noisy for found in alike)


def test_a_weak_misfit_of_all_channels_is_found_in_their_sum():
    e = noise(13) + 0.45 * np.exp(0.05j * np.arange(N_F))[:, None, None]
    found = look(e)
    assert found.outcome == "structure"
    assert min(found.whiteness_p.min(), found.chi_square_p.min()) > found.p_value


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("where", ["channel", "band"])
def test_where_no_place_stands_out_the_most_telling_of_many_is_named(where, seed):
    """A quarter too loud all along a channel, or a fifth in one band of all channels."""
    e, cut = noise(seed), divide_into_bands(np.log(np.abs(H[:, 0, 0])))
    e *= np.sqrt(2.0) / np.abs(e)
    if where == "channel":
        e[:, 2, 1] *= 1.25
    else:
        e[cut[1]] *= 1.18
    found = look(e)
    assert found.outcome == "excess"
    assert found.chi_square_p.min() > found.level >= found.p_value
    (named,) = found.worst
    if where == "channel":
        assert (named.response, named.reference) == ("3:Z", "4:-Z")
    else:
        assert named.low == FREQ[cut[1].start]
    assert found.verdict == (
        "The residual is larger than the noise over many channels or bands, although none is significant by itself;"
        f" it is largest in channel {named.response} / {named.reference} near {named.near:.4g} Hz."
    )
    assert (
        named.misfit
        == found.misfit[
            RESPONSES.index(named.response),
            REFERENCES.index(named.reference),
            found.bands[:, 0] == named.low,
        ]
    )


@pytest.mark.parametrize("at", [[17], [17, 40]])
@pytest.mark.parametrize("absolute", [True, False])
def test_lines_that_stand_out_alone_are_named(at, absolute):
    e = noise(21)
    e[at] *= 12.0
    found = look(e, absolute=absolute)
    assert not found.adequate
    assert found.lone == tuple(FREQ[at])
    assert found.worst[0].near in FREQ[at]  # and not next to it
    named = ", ".join(f"{f:.5g}" for f in FREQ[at])
    which = "the isolated line" if len(at) == 1 else "the isolated lines"
    assert found.verdict.endswith(f" Most of it is in {which} at {named} Hz.")


@pytest.mark.parametrize("wide", [1.0, 2.0, 5.0])
def test_a_resonance_that_is_missing_does_not_stand_out_at_one_line(wide):
    """Half-power bandwidths from one spacing of the lines on: the skirts are seen."""
    spacing = FREQ[1] - FREQ[0]
    mode = 1.0 / (30.3**2 - FREQ**2 + 1j * wide * spacing * 30.3)
    e = noise(22) + 15.0 * (mode / np.abs(mode).max())[:, None, None]
    found = look(e)
    assert not found.adequate
    assert found.lone == ()


def test_many_lines_or_a_little_of_the_misfit_do_not_stand_out_alone():
    e = noise(23)
    e[::6] *= 12.0
    assert look(e).lone == ()
    e = planted(8.0)
    e[5] *= 4.0
    assert look(e).lone == ()
    assert look(noise(24)).lone == ()


def test_noise_that_was_stated_far_too_large_is_said_with_its_factor():
    said = look(noise(3) / 20.0).verdict
    assert re.search(
        r"stated or measured noise is (19|20)(\.\d)? times larger than the residual", said
    )
    for known in (look(noise(3) / 1.6), look(noise(3) / 20.0, absolute=False)):
        assert "larger" not in known.verdict
    few = noise(5)[:1] / 2.5
    alone = assess_residual(
        few[:, :1, :1], H[:1, :1, :1], FREQ[:1], ["1:Z"], ["2:Z"], n_unknowns=0, absolute=True
    )
    assert "larger" not in alone.verdict


def test_what_cannot_be_tested_is_said():
    assert look(noise(1), relative=1e-12).outcome == "exact"
    assert look(noise(1), relative=1e-12).adequate
    assert look(noise(1), n_unknowns=2 * N_F * N_I * N_J).outcome == "untested"
    part = noise(2)
    part[:, 0] = np.nan
    found = look(part)
    assert np.isnan(found.misfit[0]).all()
    assert (found.chi_square_p[0] == 1.0).all()
    assert found.adequate


def test_one_channel_in_one_band():
    flat = np.ones((6, 1, 1))
    found = assess_residual(
        noise(0, (6, 1, 1)), flat, FREQ[:6], ["1:Z"], ["1:Z"], n_unknowns=1, absolute=True
    )
    assert found.bands.tolist() == [[FREQ[0], FREQ[5]]]
    assert found.adequate
    loud = assess_residual(
        9.0 * noise(0, (6, 1, 1)), flat, FREQ[:6], ["1:Z"], ["1:Z"], n_unknowns=1, absolute=True
    )
    assert loud.outcome == "excess"
    relative = assess_residual(
        9.0 * noise(0, (6, 1, 1)), flat, FREQ[:6], ["1:Z"], ["1:Z"], n_unknowns=1, absolute=False
    )
    assert relative.adequate  # nothing to compare with


def test_what_would_explain_it_is_said():
    suspects = [
        Suspect("gear 2", "stiffness", 0.9, 0.1, 0.5, confirmed=True),
        Suspect("gear 2", "mass", 0.8, -0.1, 0.2, confirmed=True),
        Suspect("shaft", "mass", 0.3, 0.1, 0.1, confirmed=True),
    ]
    found = add_suspects(look(planted(4.0)), suspects)
    assert found.verdict.endswith(
        " An error in the stiffness of gear 2 (9.5 % too low) or the mass of gear 2 (11 % too high)"
        " would explain 90 % of it."
    )
    assert found.explained_by == tuple(suspects)
    e = noise(12)
    e[:, 1] *= 3.0
    loud = look(e)
    assert loud.noisy
    # As a wrong calibration leaves it, where lines are too far apart for serial correlation.
    assert add_suspects(loud, suspects).outcome == "structure"
    assert add_suspects(loud, suspects).noisy == ()
    assert "of different size" not in add_suspects(loud, suspects).verdict
    assert add_suspects(look(noise(0)), suspects).explained_by == ()


@pytest.mark.parametrize(
    ("suspect", "said"),
    [
        (
            Suspect("a", "mass", 0.3, 0.1, 0.1, confirmed=True),
            "No single quantity explains it: an error in the mass of a (9.5 % too low) would"
            " explain most, 30 %.",
        ),
        (
            Suspect("a", "mass", 0.9, 1.1, 0.1, confirmed=True),
            "An error in the mass of a (3 times too low) would explain 90 % of it.",
        ),
        (
            Suspect("a", "loss_factor", 0.9, -0.02, 0.1, confirmed=True),
            "An error in the loss factor of a (0.02 too high) would explain 90 % of it.",
        ),
        (
            Suspect("1:RX", "calibration", 0.9, np.log(1.1), 0.0, confirmed=True),
            "An error in the sensor 1:RX (reads 10 % too much) would explain 90 % of it.",
        ),
        (
            Suspect("1:RX", "calibration", 0.9, 0.1, 0.0),
            "To first order, not confirmed by a fit, an error in the sensor"
            " 1:RX (reads too much) would explain 90 % of it.",
        ),
    ],
)
def test_how_far_off_and_how_sure_is_said(suspect, said):
    assert add_suspects(look(planted(4.0)), [suspect]).verdict.endswith(said)


# -- bands -------------------------------------------------------------------------------------------------------
def test_bands_lie_about_the_resonances():
    cut = divide_into_bands(np.log(np.abs(H[:, 0, 0])))
    assert [k.start for k in cut[1:]] == [k.stop for k in cut[:-1]]
    assert (cut[0].start, cut[-1].stop) == (0, N_F)
    assert all(k.stop - k.start >= 7 for k in cut)
    for f0 in (15.0, 40.0, 75.0):  # no cut at a peak
        assert min(abs(FREQ[k.start] - f0) for k in cut[1:]) > 3.0


def test_many_resonances_and_few_lines():
    many = divide_into_bands(np.sin(np.arange(2000) / 2.0))
    assert len(many) <= 24
    assert sum(k.stop - k.start for k in many) == 2000
    assert divide_into_bands(np.zeros(3)) == [slice(0, 3)]
    assert divide_into_bands(np.zeros(1)) == [slice(0, 1)]


# -- thresholds ----------------------------------------------------------------------------------
@pytest.mark.parametrize(("factor", "is_overstated"), [(1.9, False), (2.1, True)])
def test_noise_is_overstated_from_twice_its_size(factor, is_overstated):
    e = noise(3) / factor
    e *= np.sqrt(
        2.0 * e.size / np.sum(np.abs(noise(3)) ** 2)
    )  # a reduced chi-square of 1 / factor^2
    assert ("larger than the residual" in look(e).verdict) is is_overstated


@pytest.mark.parametrize(("std", "noisy"), [(1.45, []), (1.55, ["4:Z"])])
def test_a_sensor_is_noisy_from_one_and_a_half_times_the_median(std, noisy):
    found = _find_noisy_sensors(np.array([1.0, 0.9, 1.1, std]), RESPONSES)
    assert [one.response for one in found] == noisy


@pytest.mark.parametrize(("misfit", "is_noise"), [(0.28, True), (0.32, False)])
def test_a_misfit_above_three_tenths_of_the_response_is_no_noise(misfit, is_noise):
    e, whitened_H = noise(4)[:, :1, :1], H[:, :1, :1] / np.abs(H[:, :1, :1])
    whitened_H = whitened_H * np.abs(e).sum() / (misfit * N_F)
    assert can_be_sensor_noise(H[:, :1, :1], whitened_H, e, FREQ) is is_noise


@pytest.mark.parametrize(("times", "is_isolated"), [(2.8, False), (3.2, True)])
def test_a_line_is_isolated_from_three_times_the_misfit_of_its_neighbours(times, is_isolated):
    e = np.ones((N_F, 1, 1), dtype=complex)
    e[30] = times
    assert (_find_isolated_lines(e, FREQ) == (FREQ[30],)) is is_isolated


@pytest.mark.parametrize(("number", "is_isolated"), [(3, True), (4, False)])
def test_at_most_a_twentieth_of_the_lines_is_isolated(number, is_isolated):
    e = np.ones((N_F, 1, 1), dtype=complex)
    e[10 : 10 + 10 * number : 10] = 20.0
    assert (len(_find_isolated_lines(e, FREQ)) == number) is is_isolated


@pytest.mark.parametrize(("relative", "outcome"), [(0.9e-7, "exact"), (1.1e-7, "noise")])
def test_a_fit_is_exact_below_a_ten_millionth(relative, outcome):
    assert look(noise(1), relative=relative).outcome == outcome


@pytest.mark.parametrize(("number", "is_tested"), [(4, False), (5, True)])
def test_serial_correlation_is_tested_from_five_values(number, is_tested):
    values = np.full((N_F, 1), np.nan, dtype=complex)
    values[10 : 10 + number] = 1.0
    assert bool(serial_correlation_p_values(values)[0] < 1.0) is is_tested


def test_bands_have_at_least_eight_lines_and_number_at_most_twenty_four():
    lines = np.arange(2400.0)
    of_seven, of_nine = (-np.abs(np.sin(np.pi * lines[: 20 * n] / n)) for n in (7, 9))
    assert min(k.stop - k.start for k in divide_into_bands(-of_seven)) >= 8
    assert len(divide_into_bands(-of_nine)) == 20
    assert len(divide_into_bands(np.abs(np.sin(np.pi * lines / 20)))) == 24


@pytest.mark.parametrize(("p_value", "is_noise"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_response_is_smooth_up_to_a_p_value_of_a_thousandth(monkeypatch, p_value, is_noise):
    monkeypatch.setattr(
        "updyn.updating.judge.adequacy.serial_correlation_p_values",
        lambda values: np.array([p_value]),
    )
    e = noise(4)[:, :1, :1]
    assert can_be_sensor_noise(H[:, :1, :1], np.full_like(e, 100.0), e, FREQ) is is_noise


def test_twelve_misfits_are_listed():
    found = look(np.full((N_F, N_I, N_J), 10.0 + 0.0j))
    assert found.whiteness_p.size > 12
    assert len(found.worst) == 12


def test_values_are_clipped_to_three_standard_deviations():
    values = np.ones((9, 1), dtype=complex)
    values[4] = 100.0j
    std = 1.0 / np.sqrt(2.0 * np.log(2.0))  # of each part of values whose median magnitude is 1
    assert clip_outliers(values)[4, 0] == pytest.approx(3.0j * std)


@pytest.mark.parametrize(("p_value", "outcome"), [(0.019, "excess"), (0.021, "noise")])
def test_one_fit_to_noise_in_fifty_raises_an_alarm(monkeypatch, p_value, outcome):
    ones = np.ones((1, 1, 1))
    families = (ones, ones), (p_value, 1.0), (ones, ones)
    monkeypatch.setattr(adequacy, "_test_families", lambda *about: families)
    monkeypatch.setattr(adequacy, "_find_worst_misfits", lambda *about: ())
    monkeypatch.setattr(adequacy, "_describe_outcome", lambda found: "")
    assert look(noise(1)[:, :1, :1], whitened_H=None).outcome == outcome
