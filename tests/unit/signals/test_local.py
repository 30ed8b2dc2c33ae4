"""FRFs by local rational models: exact cases, other solvers, the stated variance, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

import hits
import shaken
import updyn
from updyn.errors import DataError, OptionError
from updyn.signals.local import local_rational
from updyn.signals.local_model import LocalModel, Windows
from updyn.signals.records import Records
from updyn.signals.spectra import Spectra
from updyn.updating.fit.method import serial_correlation

FORCES = {"a": "1:X", "b": "2:X"}
RESPONSES = {"p": "3:X", "q": "4:X"}
BAND = (12.0, 80.0)


def estimated(records, estimator="LRM", forces=1, **options):
    chosen = dict(list(FORCES.items())[:forces])
    options = {"band": BAND} | options
    return updyn.estimate_frf(records, chosen, responses=RESPONSES, estimator=estimator, **options)


def complex_normal(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


# -- one window, against other solvers ------------------------------------------------------------
def window(model, records=2, forces=1, noise=0.05, seed=0):
    """Spectra of one window: a mode among its lines, and a transient of it."""
    rng = np.random.default_rng(seed)
    r = np.arange(-model.half, model.half + 1) / model.half
    pole = 0.1 + 0.3j
    F = complex_normal(rng, records, model.width, forces)
    shapes = complex_normal(rng, 2, forces)
    begin = complex_normal(rng, records, 1, 2)
    X = (np.einsum("ij,mwj->mwi", shapes, F) + begin) / (r - pole)[:, None]
    X = X + noise * np.array([1.0, 2.0]) * complex_normal(rng, *X.shape)
    return F, X, shapes / -pole, r


def values_at(model, F, X, offset=0):
    windows = Windows.of(F, X, np.array([model.half]), model)
    return windows.values_at(np.array([offset]))


@pytest.mark.parametrize("forces", [1, 2])
def test_a_mode_among_the_lines_is_exact(forces):
    model = LocalModel(2, 16, 3)
    F, X, wanted, _ = window(model, forces=forces, noise=0.0)
    found = values_at(model, F, X)
    assert found.values[0, 0] == pytest.approx(wanted, rel=1e-8)


def columns(F, r, degree):
    """The linear problem of one response, a column for each coefficient of B and C."""
    records, _, forces = F.shape
    blocks = [F[:, :, j].reshape(-1, 1) * np.tile(r, records)[:, None] ** q
              for j in range(forces) for q in range(degree + 1)]  # fmt: skip
    blocks += [np.kron(np.eye(records)[:, [m]], r[:, None] ** q)
               for m in range(records) for q in range(degree + 1)]  # fmt: skip
    return np.hstack(blocks)


@pytest.mark.parametrize("forces", [1, 2])
def test_polynomials_are_least_squares(forces):
    """Value, variance and left-out error, against one dense problem of each response."""
    model = LocalModel(0, 12, 3)
    F, X, _, r = window(model, forces=forces)
    found = values_at(model, F, X)
    A = columns(F, r, model.degree)
    hat = A @ np.linalg.pinv(A)
    for i in range(2):
        x = X[:, :, i].reshape(-1)
        b, *_ = np.linalg.lstsq(A, x)
        rest = x - A @ b
        noise = np.sum(np.abs(rest) ** 2) / (len(x) - A.shape[1])
        covariance = noise * np.linalg.pinv(A.conj().T @ A)
        at = np.arange(forces) * (model.degree + 1)
        assert found.values[0, 0, i] == pytest.approx(b[at], rel=1e-9)
        assert found.variance[0, 0, i] == pytest.approx(covariance[at, at].real, rel=1e-9)
        # Fitted once more without the centre of both records, one record at a time.
        errors = (rest / (1.0 - np.diag(hat))).reshape(2, -1)[:, model.half]
        assert found.omission_error[0, 0, i] == pytest.approx(
            np.mean(np.abs(errors) ** 2), rel=1e-9
        )


@pytest.mark.parametrize("offset", [0, 2])
def test_a_pole_is_that_of_a_general_solver(offset):
    """All coefficients by scipy; the variance from its Jacobian, each response by its noise."""
    model = LocalModel(1, 16, 2)
    F, X, _, r = window(model, noise=0.02)
    found = values_at(model, F, X, offset)
    A = columns(F, r, model.degree)
    n, rows = A.shape[1], np.tile(r, 2)
    data = np.moveaxis(X, 2, 0).reshape(2, -1)

    def parts(z):
        z = z[: len(z) // 2] + 1j * z[len(z) // 2 :]
        return z[0], z[1:].reshape(2, n)

    def rest(z):
        a, b = parts(z)
        return b @ A.T / (1.0 + a * rows) - data

    def H(z):
        a, b = parts(z)
        at = offset / model.half
        return b[:, :3] @ at ** np.arange(3) / (1.0 + a * at)

    z, weight = np.zeros(2 * (1 + 2 * n)), np.ones(2)
    z[0], z[1 + 2 * n] = -1.0, 3.0  # near 1 / (0.1 + 0.3i), with the sign of A
    for _ in range(8):

        def error(z, weight=weight):
            e = (rest(z) * weight[:, None]).ravel()
            return np.concatenate([e.real, e.imag])

        solved = scipy.optimize.least_squares(error, z, method="lm", xtol=1e-15, ftol=1e-15)
        z = solved.x
        power = np.sum(np.abs(rest(z)) ** 2, axis=1)
        weight = 1.0 / np.sqrt(power)
    assert found.values[0, 0, :, 0] == pytest.approx(H(z), rel=1e-4)
    # The responses share the pole: their degrees of freedom are those without it less 0 to 1.
    freedom = len(rows) - n - 0.5
    R = np.linalg.qr(solved.jac / np.sqrt(0.5 / freedom), mode="r")
    slopes = np.array([(H(z + h) - H(z - h)) / 2e-6 for h in 1e-6 * np.eye(len(z))])
    for i in range(2):
        both = np.array([slopes[:, i].real, slopes[:, i].imag])
        wanted = np.sum(np.linalg.solve(R.T, both.T) ** 2)
        assert found.variance[0, 0, i, 0] == pytest.approx(wanted, rel=0.02)


# -- records --------------------------------------------------------------------------------------
def error_of(frf, forces=1):
    return np.abs(frf.values - shaken.accelerance(frf.freq, forces))


def near(frf):
    """Lines within 1.5 half-power bandwidths of a natural frequency."""
    away = np.abs(frf.freq[:, None] - shaken.FREQUENCY) / (shaken.FREQUENCY * shaken.LOSS)
    return away.min(axis=1) < 1.5


def test_leakage_is_estimated():
    """Three to eight lines in a peak, no noise: windows of every length lose the peaks."""
    records = shaken.records(16.0)
    exact = estimated(records)
    share = error_of(exact) / np.abs(shaken.accelerance(exact.freq))
    assert np.median(share[near(exact)]) < 2e-4
    for parts in (1, 2, 4, 8):
        usual = estimated(records, "H1", segment=16.0 / parts)
        peaks = near(usual)
        lost = error_of(usual)[peaks] / np.abs(shaken.accelerance(usual.freq))[peaks]
        assert np.median(lost) > 100.0 * np.median(share[near(exact)])


def test_half_the_record_does():
    noise = (0.01, 0.03)
    half = estimated(shaken.records(16.0, noise=noise, seed=1))
    whole = shaken.records(32.0, noise=noise, seed=1)
    for parts in (2, 4, 8):
        usual = estimated(whole, "H1", segment=32.0 / parts)
        for chosen in (near, lambda frf: ~near(frf)):
            errors = [np.median(error_of(frf)[chosen(frf)]) for frf in (half, usual)]
            assert errors[0] < errors[1]


@pytest.mark.parametrize("estimator", ["LRM", "H1-LRM"])
@pytest.mark.parametrize(("forces", "n"), [(1, 1), (1, 3), (2, 3)])
def test_the_stated_variance_is_that_of_the_errors(estimator, forces, n):
    squares = []
    for seed in range(4):
        records = shaken.records(8.0, noise=(0.01, 0.03), forces=forces, n=n, seed=seed)
        frf = estimated(records, estimator, forces)
        squares.append(error_of(frf, forces) ** 2 / frf.variance)
    whole = np.concatenate(squares)
    # |z|^2 of circular noise is exponential: 95 % are below 3.0, half below log 2.
    assert 0.8 < np.median(whole) / np.log(2.0) < 1.25
    assert 0.90 < np.mean(whole < -np.log(0.05)) < 0.98


def test_errors_without_transients_are_independent():
    """Those of the local models are not: each serves many lines."""
    records = shaken.records(24.0, noise=(0.01, 0.03), seed=4)
    found = {}
    for name in ("LRM", "H1-LRM"):
        frf = estimated(records, name)
        whitened = (frf.values - shaken.accelerance(frf.freq)) / np.sqrt(frf.variance)
        found[name] = serial_correlation(whitened)
    assert found["LRM"] > 0.7
    # Two standard deviations of that of independent noise, and a few per cent by the transients.
    assert abs(found["H1-LRM"]) < 2.0 / np.sqrt(2.0 * whitened.size) + 0.05


def chain(factor, loss):
    """Two masses, one of them held by a spring whose stiffness is scaled."""
    K = np.array([[1.0, 0.0], [0.0, 0.0]])
    groups = {
        "root": updyn.Group(4.0e4 * factor * K, loss_factor=loss),
        "tip": updyn.Group(2.0e4 * np.array([[1.0, -1.0], [-1.0, 1.0]]), loss_factor=loss),
        "masses": updyn.Group(mass=np.diag([1.0, 0.5])),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def test_an_update_finds_noise_in_the_residual():
    """Of H1-LRM, whose errors are independent; one record of random force, a part of its period."""
    rng, n, step = np.random.default_rng(2), 2048, 1.0 / 256.0
    freq = np.fft.rfftfreq(5 * n, step)
    exact = updyn.response(
        chain(1.0, 0.01), freq[1:], ["1:X", "2:X"], ["1:X"], quantity="accelerance"
    )
    force = rng.standard_normal(5 * n)
    spectrum = np.zeros((2, len(freq)), dtype=complex)
    spectrum[:, 1:] = exact.values[:, :, 0].T * np.fft.rfft(force)[1:]
    motion = np.fft.irfft(spectrum, 5 * n, axis=1)[:, :n]
    motion = motion + 0.01 * motion.std(axis=1, keepdims=True) * rng.standard_normal((2, n))
    values = np.vstack([force[:n], motion])[None]
    records = Records.of(values, step, ["force", "1:X", "2:X"], ["N", "m/s^2", "m/s^2"])
    frf = updyn.estimate_frf(records, {"force": "1:X"}, estimator="H1-LRM", band=(10.0, 60.0))
    start = chain(0.8, 0.02)
    unknowns = updyn.parameters(start, stiffness=["root"], loss_factor=["root"])
    result = updyn.update(start, frf, unknowns)
    # The tip keeps twice its loss factor: of a model that is wrong, the residual is no noise.
    assert result.adequacy.outcome == "structure"
    unknowns = updyn.parameters(start, stiffness=["root"], loss_factor=["root", "tip"])
    result = updyn.update(start, frf, unknowns)
    assert result.adequacy.outcome == "noise"
    for name, true in {"root.stiffness": 1.25, "root.loss_factor": 0.01}.items():
        assert result.std[name] < 1e-3 * true * (1.0 if "stiff" in name else 20.0)
        assert abs(result.values[name] - true) < 4.0 * result.std[name]


def test_several_forces_take_one_record_or_several():
    exact = estimated(shaken.records(24.0, forces=2), forces=2)
    share = error_of(exact, 2) / np.abs(shaken.accelerance(exact.freq, 2))
    assert np.median(share[near(exact)]) < 1e-3
    with pytest.raises(DataError, match="2 forces and 1 records or segments"):
        estimated(shaken.records(24.0, forces=2), "H1-LRM", 2)
    cut = estimated(shaken.records(48.0, forces=2), "H1-LRM", 2, segment=12.0)
    assert cut.averages == 4
    share = error_of(cut, 2) / np.abs(shaken.accelerance(cut.freq, 2))
    assert np.median(share[near(cut)]) < 5e-3


def test_noise_on_the_force_biases_it_like_h1():
    """By S_ff / (S_ff + S_nn), where the FRF is flat over a window."""
    found = []
    for seed in range(4):
        frf = estimated(shaken.records(48.0, force_noise=0.5, seed=seed), band=(70.0, 90.0))
        found.append(np.mean(frf.values[:, 0, 0] / shaken.accelerance(frf.freq)[:, 0, 0]).real)
    assert np.mean(found) == pytest.approx(1.0 / 1.25, abs=0.03)


def test_one_record_of_several():
    records = shaken.records(16.0, noise=(0.01, 0.01), n=3)
    found = updyn.frf_estimate(
        records, {"a": "1:X"}, responses=RESPONSES, estimator="LRM", band=BAND
    )
    assert (found.ordinary, found.multiple, found.partial) == (None, None, None)
    assert (found.frf.coherence, found.frf.averages) == (None, 3)
    alone = estimated(replace(records, values=records.values[1:2]))
    assert found.of_record(2).values == pytest.approx(alone.values, rel=1e-12)
    assert found.of_record(2).variance == pytest.approx(alone.variance, rel=1e-12)


def test_units_and_offsets_do_not_matter():
    records = shaken.records(16.0, noise=(0.01, 0.01))
    frf = estimated(records)
    factors = np.array([1e-3, 1e6, 1e-4])[:, None]
    other = replace(
        records, values=factors * (records.values + 5.0), units=("kN", "um/s^2", "km/s^2")
    )
    changed = estimated(other)
    wanted = frf.values * np.array([1.0, 0.1])[:, None]
    assert changed.values == pytest.approx(wanted, rel=1e-9)
    assert changed.variance == pytest.approx(frf.variance * np.array([[1.0], [0.01]]), rel=1e-8)


@pytest.mark.parametrize("channel", ["zero", "flat"])
def test_a_response_without_noise_leaves_the_others_as_they_are(channel):
    """A cable that is broken, and one that was connected to the force."""
    records = shaken.records(16.0, noise=(0.01, 0.01))
    values = records.values.copy()
    values[:, 1] = 0.0 if channel == "zero" else 2.0 * values[:, 0]
    found = estimated(replace(records, values=values))
    alone = updyn.estimate_frf(
        records, {"a": "1:X"}, responses={"q": "4:X"}, estimator="LRM", band=BAND
    )
    assert np.abs(found.values[:, 0] - (0.0 if channel == "zero" else 2.0)).max() < 1e-9
    exact = shaken.accelerance(found.freq)[:, 1]
    errors = [np.median(np.abs(H - exact)) for H in (found.values[:, 1], alone.values[:, 0])]
    assert errors[0] < 1.2 * errors[1]


@pytest.mark.parametrize("estimator", ["LRM", "H1-LRM"])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": "hann"}, "window 'hann': estimator H1?-?LRM uses records without windows"),
        ({"window": updyn.ImpactWindow(force=0.1)}, "uses records without windows"),
        ({"overlap": 0.5}, "overlap 0.5: estimator .*LRM .*omit overlap"),
        (
            {"band": (20.0, 20.5)},
            r"9 lines of 1 records or segments; LRM of 1 forces requires at least 17",
        ),
    ],
)
def test_what_does_not_apply_is_refused(estimator, options, message):
    with pytest.raises((DataError, OptionError), match=message.replace("H1?-?LRM", f"{estimator}")):
        estimated(shaken.records(16.0), estimator, **options)


def test_hits_are_refused():
    """Their spectra are as smooth as those of transients."""
    given = hits.records(noise=1e-3)
    with pytest.raises(
        DataError, match=r"channel 'hammer': the force is a pulse of .* s in"
    ) as error:
        updyn.estimate_frf(given, {"hammer": "1:Z"}, estimator="LRM")
    assert "ImpactWindow" in str(error.value)


@pytest.mark.parametrize(("share", "is_pulse"), [(0.015, True), (0.04, False)])
def test_a_burst_is_no_pulse_from_some_length_on(share, is_pulse):
    """90 % of the energy of random force take nine tenths of its length."""
    records = shaken.records(16.0)
    values = records.values.copy()
    size = round(share * values.shape[2])
    values[:, 0, :500] = values[:, 0, 500 + size :] = 0.0
    burst = replace(records, values=values)
    if is_pulse:
        with pytest.raises(DataError, match="the force is a pulse of"):
            estimated(burst, band=(20.0, 60.0))
    else:
        estimated(burst, band=(20.0, 60.0))


def test_more_forces_take_more_lines():
    rng = np.random.default_rng(0)
    spectra = Spectra.of(complex_normal(rng, 1, 20, 3), complex_normal(rng, 1, 20, 2), 1.0)
    with pytest.raises(DataError, match="LRM of 3 forces requires at least 33 lines"):
        local_rational(spectra, np.arange(20.0), ["a", "b", "c"])


def test_forces_that_are_partly_coherent_are_told_apart():
    """A fifth of the power of the second is its own."""
    records = shaken.records(24.0, forces=2, noise=(0.01, 0.01), n=2)
    mixed, H = records.values.copy(), shaken.accelerance
    mixed[:, 1] = mixed[:, 0] + 0.5 * mixed[:, 1]
    frf = estimated(replace(records, values=mixed), forces=2)
    # X = H1 a + H2 b with b = 2 (b' - a).
    exact = H(frf.freq, 2) @ np.array([[1.0, 0.0], [-2.0, 2.0]])
    squares = np.abs(frf.values - exact) ** 2 / frf.variance
    assert 0.88 < np.mean(squares < -np.log(0.05)) < 0.98


@pytest.mark.parametrize("rest", [0.0, 1e-3])
def test_forces_that_cannot_be_told_apart_are_refused(rest):
    records = shaken.records(24.0, forces=2, n=2)
    values = records.values.copy()
    values[:, 1] = 2.0 * values[:, 0] + rest * values[:, 1]
    with pytest.raises(
        DataError, match="cannot be distinguished from a transient or the other forces"
    ):
        estimated(replace(records, values=values), forces=2)


def test_a_force_as_smooth_as_a_transient_is_refused():
    """A sine that lasts: lines far from it have nothing but its ends."""
    n = 4096
    t = np.arange(n) * shaken.STEP
    force = np.sin(2.0 * np.pi * 30.02 * t)
    rng = np.random.default_rng(0)
    motion = 1e-3 * rng.standard_normal((2, n)) + force
    records = Records.of(
        np.vstack([force, motion])[None], shaken.STEP, ["a", "p", "q"], ["N", "g", "g"]
    )
    with pytest.raises(
        DataError, match="cannot be distinguished from a transient; expected a force that"
    ):
        estimated(records)


def test_a_sweep_and_a_burst_are_estimated():
    """Each begins and ends at rest within a record, so that the truth is exact on its lines."""
    n = 16384
    t = np.arange(n) * shaken.STEP
    freq = np.fft.rfftfreq(n, shaken.STEP)
    rng = np.random.default_rng(3)
    sweep = np.sin(2.0 * np.pi * (5.0 * t + 0.5 * 100.0 / t[-1] * t**2))
    burst = rng.standard_normal(n) * ((t > 5.0) & (t < 30.0))
    for force in (sweep, burst):
        spectrum = shaken.accelerance(freq)[:, :, 0].T * np.fft.rfft(force)
        motion = np.fft.irfft(spectrum, n, axis=1)
        motion = motion + 0.01 * motion.std(axis=1, keepdims=True) * rng.standard_normal((2, n))
        values = np.vstack([force, motion])[None]
        frf = estimated(Records.of(values, shaken.STEP, ["a", "p", "q"], ["N"] + ["m/s^2"] * 2))
        share = error_of(frf)[near(frf)] / np.abs(shaken.accelerance(frf.freq))[near(frf)]
        assert np.median(share) < 2e-3
        squares = error_of(frf) ** 2 / frf.variance
        assert 0.88 < np.mean(squares < -np.log(0.05)) < 0.98
