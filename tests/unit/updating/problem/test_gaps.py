"""Data with gaps: every value that is there comes back once, and a fit of the parts is as good as its data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import updyn
from updyn.errors import DataError, DofError


def pieces(parts, shape, freq, rows, columns):
    """Put the parts together again, counting how often each value was there."""
    values, seen = np.full(shape, np.nan + 0j), np.zeros(shape, dtype=int)
    for part in parts:
        at = np.ix_(
            np.searchsorted(freq, part.freq),
            [rows.index(r) for r in part.responses.labels],
            [columns.index(c) for c in part.references.labels],
        )
        values[at] = part.values
        seen[at] += 1
    return values, seen


@given(st.integers(0, 10_000), st.floats(0.0, 0.9))
def test_every_value_comes_back_once(seed, share):
    rng = np.random.default_rng(seed)
    shape = (5, 3, 2)
    whole = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    values = np.where(rng.uniform(size=shape) < share, np.nan, whole)
    values[0, 0, 0] = whole[0, 0, 0]
    freq, rows, columns = 1.0 + np.arange(5), ["1:X", "2:X", "3:X"], ["1:X", "3:X"]
    parts = updyn.complete_parts(
        freq, values, rows, columns, "receptance", coherence=np.abs(whole) / 10
    )
    labels = [updyn.DofSet(d).labels for d in (rows, columns)]
    back, seen = pieces(parts, shape, freq, *labels)
    assert np.array_equal(seen, ~np.isnan(values))
    assert np.array_equal(back, values, equal_nan=True)
    assert [p.values.size for p in parts] == sorted((p.values.size for p in parts), reverse=True)


def test_without_a_gap_it_is_the_frf(chain12_frf):
    f = chain12_frf
    (one,) = updyn.complete_parts(
        f.freq, f.values, f.responses, f.references, f.quantity, source="run 3"
    )
    assert np.array_equal(one.values, f.values)
    assert one.source == "run 3"


def test_a_sensor_that_dropped_out(chain12_frf):
    f = chain12_frf
    values = f.values.copy()
    values[40:57, 3, :] = np.nan
    rest, broken = updyn.complete_parts(
        f.freq, values, f.responses, f.references, f.quantity, averages=4, source="a"
    )
    assert rest.values.shape == (60, 4, 5)
    assert broken.values.shape == (43, 1, 5)
    assert broken.responses == updyn.DofSet([f.responses[3]])
    assert broken.averages == 4
    assert rest.source == "a; 5 of 25 channels miss 17 of 60 lines"
    masked = np.ma.array(f.values, mask=np.isnan(values))
    again = updyn.complete_parts(f.freq, masked, f.responses, f.references, f.quantity)
    assert [p.values.shape for p in again] == [(60, 4, 5), (43, 1, 5)]
    values[:, 2, 0] = np.nan  # never mounted for the first force
    shapes = [
        p.values.shape
        for p in updyn.complete_parts(f.freq, values, f.responses, f.references, f.quantity)
    ]
    assert shapes == [(60, 3, 5), (60, 1, 4), (43, 1, 5)]


def test_the_fit_of_the_parts_is_as_good_as_the_data(chain12, chain12_true, chain12_frf, add_noise):
    """A tenth of the values is missing: errors and their bars are those of the rest."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    clean = chain12_frf.select(references=["2:X", "12:X"])
    truth = np.array([
        chain12_true.group(p.group).loss_factor
        if p.quantity == "loss_factor"
        else abs(getattr(chain12_true.group(p.group), p.quantity)).sum()
        / abs(getattr(chain12.group(p.group), p.quantity)).sum()
        for p in unknowns
    ])  # fmt: skip
    off = []
    for seed in (0,):
        data = add_noise(clean, np.random.default_rng(seed), 0.01)
        values = data.values.copy()
        values[30:, 1, 0] = np.nan
        values[:30, 4, 1] = np.nan
        parts = updyn.complete_parts(
            data.freq, values, data.responses, data.references, data.quantity
        )
        assert len(parts) == 5
        found = updyn.update_jointly([updyn.Test(chain12, p) for p in parts], unknowns, starts=0)
        whole = updyn.update(chain12, data, unknowns, starts=0)
        assert found.status == "converged"
        std = np.array(list(found.std.values()))
        ratio = std / np.array(list(whole.std.values()))
        assert 0.95 < np.median(ratio) < 1.25
        off.append((np.array(list(found.values.values())) - truth) / std)
    assert np.abs(off).max() < 4.0
    assert np.mean(np.abs(off) < 1.96) > 0.8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.full((2, 1, 1), np.nan)}, r"values: all are missing"),
        (
            {"values": np.array([1.0, np.inf]).reshape(2, 1, 1)},
            r"values at 2 Hz, response 1:X, reference 2:X is infinite",
        ),
        ({"values": [[["a"]], [["b"]]]}, r"values: expected complex or real numbers, found <U1"),
        ({"values": np.ones((2, 1))}, r"values: expected shape .* = \(2, 1, 1\), found \(2, 1\)"),
        (
            {"coherence": np.ones((2, 1))},
            r"coherence: expected shape .* = \(2, 1, 1\), found \(2, 1\)",
        ),
        ({"coherence": np.full((2, 1, 1), np.nan)}, r"coherence at 1 Hz, .* is not finite"),
        ({"freq": [2.0, 1.0]}, r"lines must increase"),
        ({"quantity": "impedance"}, r"quantity 'impedance'"),
    ],
)
def test_refusals(change, message):
    given = {"freq": [1.0, 2.0], "values": np.ones((2, 1, 1)), "quantity": "receptance"} | change
    with pytest.raises(
        DataError, match=message.replace("1:X", r"1:\+?X").replace("2:X", r"2:\+?X")
    ):
        updyn.complete_parts(responses=["1:X"], references=["2:X"], **given)


def test_a_quality_that_is_masked_where_there_is_a_value_is_refused():
    values = np.array([1.0, np.nan, 2.0]).reshape(3, 1, 1)
    for at, fits in ((0, False), (1, True)):
        coherence = np.ma.array(np.full((3, 1, 1), 0.9), mask=np.zeros((3, 1, 1), dtype=bool))
        coherence[at] = np.ma.masked
        given = ([1.0, 2.0, 3.0], values, ["1:X"], ["2:X"], "receptance", coherence)
        if fits:
            (part,) = updyn.complete_parts(*given)
            assert part.coherence.ravel().tolist() == [0.9, 0.9]
        else:
            with pytest.raises(DataError, match="coherence: holds masked values"):
                updyn.complete_parts(*given)


def test_labels_are_read_as_ever():
    with pytest.raises(DofError):
        updyn.complete_parts([1.0], np.ones((1, 2, 1)), ["1:X", "1:X"], ["2:X"], "receptance")


def test_an_frf_with_a_gap_says_where_to_go():
    with pytest.raises(DataError, match="complete_parts"):
        updyn.FRF(
            [1.0, 2.0], np.array([1.0, np.nan]).reshape(2, 1, 1), ["1:X"], ["2:X"], "receptance"
        )
    with pytest.raises(DataError, match="complete_parts"):
        updyn.FRF([1.0], np.ma.masked_all((1, 1, 1)), ["1:X"], ["2:X"], "receptance")
