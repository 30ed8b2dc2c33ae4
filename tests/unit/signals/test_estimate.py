"""FRFs from records: against scipy.signal, against the exact answer, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

import hits
import updyn
from updyn.errors import DataError, OptionError
from updyn.signals.records import Records

FORCE = {"hammer": "1:Z"}


@pytest.fixture(scope="module")
def lasting():
    """A record of random force with noise on all channels."""
    rng = np.random.default_rng(3)
    force = rng.standard_normal(4096)
    clean = np.vstack([force, hits.displacement(force)])
    noisy = clean + 0.1 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return Records.of(noisy[None], hits.STEP, ["hammer", "1:Z", "2:Z"], ["N", "m", "m"])


@pytest.mark.parametrize("window", ["hann", "boxcar"])
def test_the_spectrum_of_the_force_is_that_of_scipy(lasting, window):
    found = updyn.frf_estimate(lasting, FORCE, window=window, segment=1.0, band=(20.0, 60.0))
    options = {"fs": 1.0 / hits.STEP, "window": window, "nperseg": 512}
    freq, density = scipy.signal.welch(lasting.values[0, 0], **options)
    np.testing.assert_allclose(found.spectra, np.column_stack([freq, density])[1:], rtol=1e-10)


def test_the_spectrum_of_a_whole_record_has_its_mean_square(lasting):
    """Parseval's theorem; the line at 0 Hz is not part of it."""
    found = updyn.frf_estimate(lasting, FORCE, estimator="LRM", band=(20.0, 60.0))
    force = lasting.values[0, 0]
    step = 1.0 / (hits.STEP * len(force))
    assert found.spectra[:, 1].sum() * step == pytest.approx(np.var(force), rel=1e-10)


@pytest.mark.parametrize("overlap", [0.0, 0.5, 0.75])
@pytest.mark.parametrize("window", ["hann", "boxcar", "flattop"])
def test_segments_are_those_of_scipy(lasting, window, overlap):
    size = 512
    found = {
        name: updyn.estimate_frf(
            lasting, FORCE, estimator=name, window=window, segment=1.0, overlap=overlap
        )
        for name in ("H1", "H2", "Hv")
    }
    options = {
        "fs": 1.0 / hits.STEP,
        "window": window,
        "nperseg": size,
        "noverlap": int(overlap * size),
        "scaling": "spectrum",
    }
    f, x, y = lasting.values[0]
    for column, answer in enumerate((x, y)):
        freq, across = scipy.signal.csd(f, answer, **options)
        _, ff = scipy.signal.welch(f, **options)
        _, xx = scipy.signal.welch(answer, **options)
        _, gamma2 = scipy.signal.coherence(
            f, answer, **{k: v for k, v in options.items() if k != "scaling"}
        )
        one = found["H1"]
        # scipy halves neither the line at 0 Hz nor the last one; ratios do not see it.
        assert one.freq == pytest.approx(freq[1:], rel=1e-12)
        assert one.values[:, column, 0] == pytest.approx((across / ff)[1:], rel=1e-12)
        h2 = (xx / across.conj())[1:]
        assert found["H2"].values[:, column, 0] == pytest.approx(h2, rel=1e-12)
        mean = np.sqrt(np.abs(across / ff * xx / across.conj()))[1:]
        assert np.abs(found["Hv"].values[:, column, 0]) == pytest.approx(mean, rel=1e-12)
        assert one.coherence[:, column, 0] == pytest.approx(gamma2[1:], rel=1e-12)


def test_estimators_lie_as_their_noise_says(lasting):
    """|H1| <= |Hv| <= |H2|, by the square root of the coherence each: Bendat and Piersol (2010), 6.1."""
    found = [
        updyn.estimate_frf(lasting, FORCE, estimator=name, segment=1.0)
        for name in ("H1", "Hv", "H2")
    ]
    gamma = np.sqrt(found[0].coherence)
    for lower, upper in ((0, 1), (1, 2)):
        ratio = np.abs(found[lower].values) / np.abs(found[upper].values)
        assert ratio == pytest.approx(gamma, rel=1e-9)


def test_hits_give_the_exact_receptance():
    """Records long enough for the response to die out: nothing leaks."""
    frf = updyn.estimate_frf(hits.records(seconds=10.0), FORCE, band=(3.0, 80.0))
    exact = hits.receptance(frf.freq)
    assert frf.quantity == "receptance"
    assert frf.averages == 4
    assert [str(dof) for dof in frf.responses] == ["1:Z", "2:Z"]
    error = np.abs(frf.values[:, :, 0] - exact) / np.abs(exact).max(axis=0)
    # The pulse is no sum of straight lines above a fraction of the rate; this is what is left.
    assert error.max() < 2e-4
    assert frf.coherence.min() > 1.0 - 1e-9


def test_the_variance_is_that_of_repeated_tests():
    """Noise on the responses alone: the scatter of 300 estimates, each of 6 hits."""
    clean = hits.records(6, seconds=2.0)
    window = updyn.ImpactWindow(exponential=0.02, remove_damping=False)
    rng, drawn = np.random.default_rng(5), []
    size = 0.02 * np.abs(clean.values).max(axis=(0, 2)) * np.array([0.0, 1.0, 1.0])
    for _ in range(300):
        noisy = replace(
            clean, values=clean.values + size[:, None] * rng.standard_normal(clean.values.shape)
        )
        drawn.append(updyn.estimate_frf(noisy, FORCE, window=window, band=(5.0, 60.0)))
    scatter = np.var([one.values for one in drawn], axis=0)
    stated = np.mean([one.variance for one in drawn], axis=0)
    assert np.mean(stated / scatter) == pytest.approx(1.0, abs=0.05)


def test_the_damping_of_an_exponential_window_is_taken_out_again():
    """Records too short for the response, which a decay to 1 % ends."""
    short = hits.records(seconds=2.0)
    band = (4.0, 75.0)
    widened, right = (
        updyn.identify_modes(
            updyn.estimate_frf(
                short,
                FORCE,
                window=updyn.ImpactWindow(exponential=0.01, remove_damping=removed),
                band=band,
            )
        )
        for removed in (False, True)
    )
    # exp(-a t) moves every pole by a: Halvorsen and Brown (1977).
    added = -np.log(0.01) / 2.0 / (2.0 * np.pi * hits.FREQUENCY)
    widened, right = (
        modes.select(modes=[int(np.argmin(np.abs(modes.frequency - f))) for f in hits.FREQUENCY])
        for modes in (widened, right)
    )
    assert widened.loss_factor / 2.0 == pytest.approx(hits.DAMPING + added, rel=0.01)
    assert right.frequency == pytest.approx(hits.FREQUENCY, rel=1e-3)
    assert right.loss_factor / 2.0 == pytest.approx(hits.DAMPING, rel=0.01)


def test_a_force_window_takes_the_noise_after_the_hit_away():
    exact_records, left = hits.records(seconds=10.0), {}
    values = exact_records.values.copy()
    values[:, 0] += 0.2 * np.random.default_rng(8).standard_normal(values[:, 0].shape)
    noisy = replace(exact_records, values=values)
    for name, window in (("none", None), ("force", updyn.ImpactWindow(force=0.05))):
        frf = updyn.estimate_frf(noisy, FORCE, window=window, band=(3.0, 80.0))
        exact = hits.receptance(frf.freq)
        left[name] = np.sqrt(np.mean(np.abs(frf.values[:, :, 0] / exact - 1.0) ** 2))
    assert left["force"] < 0.2 * left["none"]


def test_units_are_those_of_the_records_or_given():
    given = hits.records()
    kn = replace(given, units=("kN", "mm", "mm"))
    frf, same = updyn.estimate_frf(given, FORCE), updyn.estimate_frf(kn, FORCE)
    assert same.values == pytest.approx(frf.values * 1e-6, rel=1e-12)
    bare = replace(given, units=("", "", ""))
    with pytest.raises(DataError, match="channel 'hammer': no unit"):
        updyn.estimate_frf(bare, FORCE)
    told = updyn.estimate_frf(bare, FORCE, units={"hammer": "N", "1:Z": "g", "2:Z": "m/s^2"})
    assert told.quantity == "accelerance"
    assert told.values[:, 0] == pytest.approx(frf.values[:, 0] * 9.80665, rel=1e-12)
    with pytest.raises(DataError, match="unit 'lbf' given, the records say 'N'"):
        updyn.estimate_frf(given, FORCE, units={"hammer": "lbf"})


def test_a_rejected_hit_is_left_out_and_kept_in_mind():
    given = hits.records()
    part = replace(given, values=given.values[[0, 2, 3]])
    frf = updyn.estimate_frf(given, FORCE, reject={2: "double hit"})
    assert frf.values == pytest.approx(updyn.estimate_frf(part, FORCE).values, rel=1e-12)
    assert frf.averages == 3
    assert frf.source == "record 2 omitted: double hit"


def test_labelled_arrays_are_records():
    given = hits.records()
    labelled = given.to_xarray()
    assert labelled.dims == ("record", "channel", "time")
    moved = labelled.transpose("time", "channel", "record")
    want = updyn.estimate_frf(given, FORCE).values
    assert updyn.estimate_frf(moved, FORCE).values == pytest.approx(want, rel=1e-12)
    with pytest.raises(DataError, match="expected the dimension 'channel'"):
        updyn.estimate_frf(labelled.rename(channel="sensor"), FORCE)
    uneven = labelled.assign_coords(time=labelled["time"].values ** 1.01)
    with pytest.raises(DataError, match="in even steps"):
        updyn.estimate_frf(uneven, FORCE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"excitation": "hammer"}, r"channel 'hammer': .*name its DOF: \{'hammer': '1:Z'\}"),
        ({"excitation": {"hamer": "1:Z"}}, "no channel 'hamer'; .*hammer"),
        ({"excitation": {"1:Z": "1:Z"}, "responses": ["2:Z"]}, "has a unit of motion"),
        ({"responses": {"hammer": "1:Z"}}, "of a response has a unit of force"),
        ({"reject": {9: "x"}}, "no record 9; there are 4"),
        ({"reject": dict.fromkeys(range(1, 5), "x")}, "all 4 records"),
        ({"band": (300.0, 400.0)}, "no line in it; lines go to 256 Hz"),
        ({"estimator": "H3"}, "estimator 'H3'"),
        ({"segment": 99.0}, "segment 99.0 s; expected"),
        ({"overlap": 1.0}, "overlap 1.0"),
        ({"segment": 1.0, "window": updyn.ImpactWindow()}, "omit segment"),
    ],
)
def test_what_cannot_be_estimated_is_refused(options, message):
    with pytest.raises((DataError, OptionError), match=message):
        updyn.estimate_frf(hits.records(), **{"excitation": FORCE} | options)


@pytest.mark.parametrize(
    ("force", "response", "units", "message"),
    [
        ("1:Z", "2:RZ", ("N", "g"), "'2:RZ' at 2:RZ: its unit is that of a translation or a force"),
        ("1:RZ", "2:Z", ("N", "m"), "'1:RZ' at 1:RZ: its unit is that of a translation or a force"),
        ("1:Z", "2:Z", ("N", "rad/s"), "'2:Z' at 2:Z: its unit is that of an angle or a moment"),
        ("1:RZ", "2:RZ", ("N m", "rad"), ""),
    ],
)
def test_units_of_rotations(force, response, units, message):
    values = hits.records(n_hits=2).values[:, :2]
    records = Records.of(values, hits.STEP, [force, response], units)
    if not message:
        assert updyn.estimate_frf(records, [force]).quantity == "receptance"
        return
    with pytest.raises(DataError, match=message):
        updyn.estimate_frf(records, [force])
