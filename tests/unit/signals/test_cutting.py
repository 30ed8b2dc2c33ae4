"""Hits cut out of a record that runs on: each once, whole, and double hits left in their record."""

from __future__ import annotations

import numpy as np
import pytest

import hits
import updyn
from updyn.errors import DataError, OptionError
from updyn.signals.records import Records

SINGLE = hits.records(3, seconds=4.0, noise=1e-4)
N = SINGLE.values.shape[2]


def running(order=(0, 1, 2)) -> Records:
    """The hits one after the other in a single record, with a second of rest before."""
    rest = np.zeros((3, 512))
    whole = np.concatenate([rest, *[SINGLE.values[i] for i in order]], axis=1)
    return Records.of(whole[None], SINGLE.step, SINGLE.channels, SINGLE.units, "all.wav")


def test_hits_are_cut_out_whole():
    found = updyn.cut_hits(running(), "hammer", length=3.5, before=0.02)
    assert found.shape == (3, 3, round(3.5 / SINGLE.step))
    assert found.attrs["source"] == "all.wav"
    for record, single in zip(found.values, SINGLE.values, strict=True):
        # The force is above a fifth of the largest from the first sample of the hit, the 22nd.
        first = int(np.argmax(single[0] > 0.2 * SINGLE.values[:, 0].max()))
        start = first - round(0.02 / SINGLE.step)
        np.testing.assert_array_equal(record, single[:, start : start + record.shape[1]])


def test_the_frf_is_that_of_the_hits_by_themselves():
    found = updyn.estimate_frf(
        updyn.cut_hits(running(), "hammer", length=3.5, before=0.02), {"hammer": "1:Z"}
    )
    assert found.averages == 3
    assert found.values.shape == (round(3.5 / SINGLE.step) // 2, 2, 1)


def test_a_second_hit_stays_in_its_record():
    given = running()
    values = given.values.copy()
    values[0, 0] += 0.6 * np.roll(values[0, 0], 100)
    twice = Records.of(values, given.step, given.channels, given.units)
    found = updyn.cut_hits(twice, "hammer", length=3.5, before=0.02)
    assert found.shape[0] == 3
    kinds = [one.kind for one in updyn.check_records(found, "hammer")]
    assert kinds.count("double-hit") == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"length": 5.0}, r"record 1: the hit at 9.04\d* s has .* s before it"),
        ({"length": 3.0, "before": 2.0}, r"the hit at 1.04\d* s has 1.04\d* s before it"),
        ({"length": 0.0}, "length 0.0 s; expected"),
        ({"length": 99.0}, "length 99.0 s; expected"),
        ({"length": 1.0, "before": 1.0}, "before 1.0 s; expected 0 to below"),
        ({"length": 1.0, "level": 1.0}, "level 1.0; expected a share"),
        ({"length": 1.0, "excitation": "hamer"}, "no channel 'hamer'; did you mean 'hammer'"),
    ],
)
def test_what_cannot_be_cut_is_refused(options, message):
    channel = options.pop("excitation", "hammer")
    with pytest.raises((DataError, OptionError), match=message):
        updyn.cut_hits(running(), channel, **options)
