"""FRFs of several forces at once: against matrices that scipy builds, textbook recursions, and pyFRF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal

import hits
import updyn
from updyn.errors import DataError
from updyn.signals.records import Records

STEP, SIZE = hits.STEP, 256
FORCES = {"a": "1:Z", "b": "2:Z"}
RESPONSES = {"p": "3:Z", "q": "4:Z", "r": "5:Z"}


@pytest.fixture(scope="module")
def shaken():
    """Two records of two random forces, partly coherent, three responses, noise on all."""
    rng = np.random.default_rng(11)
    values = []
    for _ in range(2):
        sources = rng.standard_normal((2, 6000))
        force = np.array([[1.0, 0.4], [0.2, 1.3]]) @ sources
        first, second = hits.displacement(force[0]), hits.displacement(force[1])
        motion = np.array([first[0] + second[1], first[1] - 0.5 * second[0], first[0] + second[0]])
        clean = np.vstack([force, motion])
        noise = rng.standard_normal(clean.shape) * clean.std(axis=1, keepdims=True)
        values.append(clean + 0.1 * noise)
    names = [*FORCES, *RESPONSES]
    return Records.of(values, STEP, names, ["N", "N", "m", "m", "m"])


def matrices(records):
    """Return S_ff, S_xx and S_xf of `scipy.signal.csd`, S_xy = E X conj(Y), 0 Hz left out."""
    options = {"fs": 1.0 / STEP, "window": "hann", "nperseg": SIZE, "noverlap": SIZE // 2}
    mean = []
    for record in records.values:
        spectra = [
            [scipy.signal.csd(y, x, **options)[1][1:] for y in record]  # csd has conj(first)
            for x in record
        ]
        mean.append(np.moveaxis(np.array(spectra), 2, 0))
    S = np.mean(mean, axis=0)
    return S[:, :2, :2], S[:, 2:, 2:], S[:, 2:, :2]


def estimated(records, estimator="H1", **options):
    return updyn.frf_estimate(
        records,
        FORCES,
        responses=options.pop("responses", RESPONSES),
        estimator=estimator,
        segment=SIZE * STEP,
        **options,
    )


def close(found, wanted):
    assert np.abs(found - wanted).max() <= 1e-12 * np.abs(wanted).max()


def test_h1_is_that_of_the_matrices_of_scipy(shaken):
    ff, _, xf = matrices(shaken)
    found = estimated(shaken)
    close(
        found.frf.values, np.array([x @ scipy.linalg.pinv(f) for x, f in zip(xf, ff, strict=True)])
    )
    assert found.frf.references.labels == ["1:Z", "2:Z"]
    assert found.frf.responses.labels == ["3:Z", "4:Z", "5:Z"]


def test_h2_is_that_of_the_matrices_of_scipy(shaken):
    """Allemang: S_xx S_fx^-1, of more responses than forces by the pseudo-inverse."""
    _, xx, xf = matrices(shaken)
    wanted = np.array([x @ scipy.linalg.pinv(c.conj().T) for x, c in zip(xx, xf, strict=True)])
    close(estimated(shaken, "H2").frf.values, wanted)
    square = estimated(shaken, "H2", responses={"p": "3:Z", "q": "4:Z"}).frf.values
    wanted = np.array(
        [scipy.linalg.solve(c[:2].conj(), x[:2, :2].T).T for x, c in zip(xx, xf, strict=True)]
    )
    close(square, wanted)


def test_hv_is_total_least_squares_of_scaled_channels(shaken):
    """By the singular values of the segments themselves: Golub and Van Loan, Matrix Computations."""
    found = estimated(shaken, "Hv").frf.values
    shape = scipy.signal.get_window("hann", SIZE)
    pieces = np.concatenate(
        [
            np.stack([record[:, i : i + SIZE] for i in range(0, 6000 - SIZE + 1, SIZE // 2)])
            for record in shaken.values
        ]
    )
    pieces = (pieces - pieces.mean(axis=2, keepdims=True)) * shape
    F = np.fft.rfft(pieces, axis=2)
    for line in (5, 30, 70):
        for row in range(3):
            data = F[:, [0, 1, 2 + row], line]
            level = np.sqrt(np.mean(np.abs(data) ** 2, axis=0))
            # Rows z^T of data lie closest to the plane whose normal is the last right vector.
            normal = scipy.linalg.svd(data / level)[2][-1].conj()
            wanted = -normal[:2] / normal[2] * level[2] / level[:2]
            assert found[line - 1, row] == pytest.approx(wanted, rel=1e-9)


def test_estimators_agree_without_noise():
    rng = np.random.default_rng(2)
    force = rng.standard_normal((2, 40, 512))
    # A response to each sample and the one before, circularly: exact on every line of a record.
    motion = 2.0 * force[0] - np.roll(force[1], 1, axis=1)
    other = force[0] + 3.0 * np.roll(force[1], 2, axis=1)
    given = Records.of(
        np.stack([force[0], force[1], motion, other], axis=1),
        1.0,
        ["a", "b", "p", "q"],
        ["N", "N", "m", "m"],
    )
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(512)[1:])
    wanted = np.array([[2.0 + 0.0 * turn, -turn], [1.0 + 0.0 * turn, 3.0 * turn**2]])
    for name in ("H1", "H2", "Hv"):
        frf = updyn.estimate_frf(given, FORCES, responses={"p": "3:Z", "q": "4:Z"}, estimator=name)
        assert np.abs(frf.values - np.moveaxis(wanted, 2, 0)).max() < 1e-10


def test_coherences_are_those_of_conditioned_spectra(shaken):
    """Bendat and Piersol (2010), section 7.3: S_ij.k = S_ij - S_ik S_kj / S_kk, one force at a time."""
    ff, xx, xf = matrices(shaken)
    found = estimated(shaken)
    for row in range(3):
        sxx = xx[:, row, row].real
        for j in range(2):
            k = 1 - j
            ordinary = np.abs(xf[:, row, j]) ** 2 / (sxx * ff[:, j, j].real)
            close(found.ordinary[:, row, j], ordinary)
            # Force k taken out of force j and of the response.
            jj = ff[:, j, j].real - np.abs(ff[:, j, k]) ** 2 / ff[:, k, k].real
            x_j = xf[:, row, j] - xf[:, row, k] * ff[:, k, j] / ff[:, k, k]
            left = sxx - np.abs(xf[:, row, k]) ** 2 / ff[:, k, k].real
            partial = np.abs(x_j) ** 2 / (jj * left)
            close(found.partial[:, row, j], partial)
            # 1 - multiple = (1 - ordinary of the first) (1 - partial of the second).
            first = np.abs(xf[:, row, k]) ** 2 / (sxx * ff[:, k, k].real)
            close(found.multiple[:, row], 1.0 - (1.0 - first) * (1.0 - partial))
    close(found.frf.coherence, found.partial)


def test_of_one_force_all_coherences_are_one(shaken):
    found = updyn.frf_estimate(shaken, {"a": "1:Z"}, responses=RESPONSES, segment=0.5)
    assert (found.partial == found.ordinary).all()
    assert (found.multiple == found.ordinary[:, :, 0]).all()


def test_the_variance_is_that_of_repeated_tests():
    """Two coherent forces, noise on the responses: the scatter of 300 estimates of 8 records each."""
    rng, n = np.random.default_rng(4), 8
    H = np.array([[1.0, -2.0]])
    drawn = []
    for _ in range(300):
        force = np.array([[1.0, 0.5], [0.0, 1.0]]) @ rng.standard_normal((n, 2, 64))
        motion = H @ force + 0.3 * rng.standard_normal((n, 1, 64))
        given = Records.of(
            np.concatenate([force, motion], axis=1), 1.0, ["a", "b", "p"], ["N", "N", "m"]
        )
        drawn.append(updyn.estimate_frf(given, FORCES, responses={"p": "3:Z"}))
    error = np.array([frf.values - H for frf in drawn])
    stated = np.mean([frf.variance for frf in drawn], axis=(0, 1))
    assert stated == pytest.approx(np.mean(np.abs(error) ** 2, axis=(0, 1)), rel=0.05)


def test_each_record_is_kept():
    given = hits.records(noise=1e-3)
    found = updyn.frf_estimate(given, {"hammer": "1:Z"}, reject={2: "weak"}, band=(3.0, 80.0))
    assert found.records == (1, 3, 4)
    singles = [found.of_record(number) for number in found.records]
    F = np.fft.rfft(given.values - np.median(given.values, axis=2, keepdims=True), axis=2)
    lines = np.isin(np.fft.rfftfreq(given.values.shape[2], given.step), found.frf.freq)
    for number, frf in zip(found.records, singles, strict=True):
        own = F[number - 1][:, lines]
        close(frf.values[:, :, 0], (own[1:] / own[0]).T)
        assert (frf.averages, frf.coherence, frf.variance) == (1, None, None)
    mean = updyn.average(singles)
    close(mean.values, np.mean([frf.values for frf in singles], axis=0))
    with pytest.raises(DataError, match="record 2 was not used; expected one of 1, 3, 4"):
        found.of_record(2)


def test_a_record_of_segments_is_an_estimate_of_its_own(shaken):
    found = estimated(shaken)
    alone = estimated(replace(shaken, values=shaken.values[1:]))
    close(found.of_record(2).values, alone.frf.values)
    assert found.of_record(2).averages == alone.frf.averages


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (lambda v: v[:1], {}, "2 forces and 1 records or segments"),
        (
            lambda v: np.concatenate([v[:, :1], 2.0 * v[:, :1], v[:, 2:]], axis=1),
            {},
            "'a' and 'b' are linearly dependent at",
        ),
        (lambda v: v, {"estimator": "H2", "responses": {"p": "3:Z"}}, "H2 of 2 forces requires at"),
    ],
)
def test_forces_that_cannot_be_told_apart_are_refused(shaken, change, options, message):
    given = replace(shaken, values=change(shaken.values))
    with pytest.raises(DataError, match=message):
        updyn.estimate_frf(given, FORCES, **{"responses": RESPONSES} | options)
