"""The mean of repeated measurements and its variance: by simulation, in fits, and what does not belong together."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError

RNG = np.random.default_rng


@pytest.fixture(scope="module")
def clean(chain12_frf):
    return chain12_frf.select(references=["2:X", "12:X"])


def repeated(clean, rng, m, relative, floor):
    """Repeats with proportional and constant noise, E|e|^2 of each value as stated."""
    size = np.abs(clean.values)
    std = np.hypot(relative * size, floor * np.sqrt(np.mean(size**2))) / np.sqrt(2.0)
    draw = rng.standard_normal((m, 2, *size.shape))
    return [
        replace(clean, values=clean.values + std * (d[0] + 1j * d[1]), source=f"run {i}")
        for i, d in enumerate(draw)
    ]


@pytest.mark.parametrize("m", [2, 3, 5, 20])
@pytest.mark.parametrize(("relative", "floor"), [(0.05, 0.0), (0.0, 0.02), (0.03, 0.003)])
def test_mean_and_variance_of_the_mean(clean, m, relative, floor):
    expected = (
        (relative * np.abs(clean.values)) ** 2 + floor**2 * np.mean(np.abs(clean.values) ** 2)
    ) / m
    squared, inverse = [], []
    for seed in range(12):
        runs = repeated(clean, RNG(seed), m, relative, floor)
        mean = updyn.average(runs)
        assert mean.values == pytest.approx(np.mean([r.values for r in runs], axis=0), rel=1e-12)
        squared.append(np.abs(mean.values - clean.values) ** 2 / mean.variance)
        inverse.append(expected / mean.variance)
    assert np.mean(squared) == pytest.approx(1.0, abs=0.1 if m == 2 else 0.05)
    for channel in np.moveaxis(np.mean(inverse, axis=0), 0, -1).reshape(10, -1):
        assert channel.mean() == pytest.approx(1.0, abs=0.25)


def test_what_the_mean_is(clean):
    coherent = replace(clean, coherence=np.full(clean.values.shape, 0.9), averages=4)
    runs = [
        replace(r, coherence=coherent.coherence, averages=4)
        for r in repeated(clean, RNG(0), 3, 0.01, 0.0)
    ]
    mean = updyn.average(iter(runs))
    assert (mean.coherence, mean.averages) == (None, None)
    assert mean.source == "mean of 3: run 0, run 1, run 2"
    assert mean.responses == clean.responses


def test_intervals_of_fits_cover(chain12, chain12_true, clean):
    """Three repeats: 4 real degrees of freedom a value. Intervals hold the truth as often as they say."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    truth = np.array([
        chain12_true.group(p.group).loss_factor
        if p.quantity == "loss_factor"
        else abs(getattr(chain12_true.group(p.group), p.quantity)).sum()
        / abs(getattr(chain12.group(p.group), p.quantity)).sum()
        for p in unknowns
    ])  # fmt: skip
    known = (0.02 * np.abs(clean.values)) ** 2 / 3 + 0.005**2 * np.mean(
        np.abs(clean.values) ** 2
    ) / 3
    bound = np.array(
        list(
            updyn.update(
                chain12, replace(clean, variance=known), unknowns.with_start(truth), starts=0
            ).std.values()
        )
    )
    off, over, chi = [], [], []
    for seed in range(10):
        data = updyn.average(repeated(clean, RNG(seed), 3, 0.02, 0.005))
        result = updyn.update(chain12, data, unknowns, starts=0)
        error = np.array(list(result.values.values())) - truth
        off.append(error / np.array(list(result.std.values())))
        over.append(error / bound)
        chi.append(result.noise["chi_square"])
    assert result.noise["kind"] == "variance"
    assert np.mean(chi) == pytest.approx(1.0, abs=0.06)
    assert 0.9 < np.mean(np.abs(off) < 1.96) < 0.99
    assert np.sqrt(np.mean(np.square(over))) < 1.25


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: f.select(lines=f.freq[1:]),
            r"repeat 2 has 59 lines, the first 60; lines are not interpolated",
        ),
        (
            lambda f: replace(f, freq=f.freq * (1 + 1e-6)),
            r"repeat 2 has line 1 at .* Hz, the first at",
        ),
        (lambda f: f.select(responses=f.responses[1:]), r"responses of repeat 2: lacks 2:\+?X"),
        (
            lambda f: f.select(responses=f.responses[::-1]),
            r"responses of repeat 2 are in another order",
        ),
        (
            lambda f: f.select(references=["2:-X", "12:X"]),
            r"references of repeat 2: lacks 2:\+?X and has 2:-X besides",
        ),
        (
            lambda f: f.converted("mobility"),
            r"repeat 2 holds mobility, the first receptance; convert one",
        ),
        (
            lambda f: replace(f, decay=0.5),
            r"repeat 2 has the decay of a window of 0.5 1/s left, the first of 0 1/s",
        ),
        (lambda f: f.values, r"expected FRFs, found ndarray as number 2"),
    ],
)
def test_repeats_that_do_not_agree(clean, change, message):
    one, two = repeated(clean, RNG(0), 2, 0.01, 0.0)
    with pytest.raises(DataError, match=message):
        updyn.average([one, change(two)])


def test_one_measurement_is_no_repeat(clean):
    with pytest.raises(DataError, match="at least two repeats, found 1"):
        updyn.average([clean])
    with pytest.raises(DataError, match="repeats 1 and 3 hold the same values"):
        updyn.average([clean, *repeated(clean, RNG(0), 1, 0.01, 0.0), clean])
