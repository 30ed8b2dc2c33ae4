"""Objects as files that are mapped into memory."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import scipy.sparse

from updyn.engines.processes import Parcel, open_parcel
from updyn.errors import EngineError


@pytest.fixture
def thing():
    rng = np.random.default_rng(1)
    frozen = rng.standard_normal(7)
    frozen.flags.writeable = False
    return {
        "sparse": scipy.sparse.random_array((40, 40), density=0.1, rng=rng).tocsc(),
        "complex": rng.standard_normal((3, 5, 2)) * 1j,
        "fortran": np.asfortranarray(rng.standard_normal((4, 6))),
        "strided": np.arange(20.0)[::3],
        "odd": np.arange(3, dtype=np.int8),
        "empty": np.empty((0, 3)),
        "frozen": frozen,
        "text": ["a", {"b": 1.5}],
    }


def test_what_is_opened_is_what_was_written(thing, tmp_path):
    parcel = Parcel(thing, tmp_path / "parcel")
    found = open_parcel(parcel.path)
    assert found["text"] == thing["text"]
    np.testing.assert_array_equal(found.pop("sparse").toarray(), thing.pop("sparse").toarray())
    for name in set(thing) - {"text"}:
        np.testing.assert_array_equal(found[name], thing[name])
        assert found[name].dtype == thing[name].dtype


def test_arrays_lie_in_the_file_and_are_aligned(tmp_path):
    arrays = [np.arange(n, dtype=float) for n in (5, 1000, 3)]
    parcel = Parcel(arrays, tmp_path / "parcel")
    found = open_parcel(parcel.path)
    assert [a.ctypes.data % 64 for a in found] == [0, 0, 0]
    assert [a.flags.owndata for a in found] == [False] * 3
    assert found[1].ctypes.data - found[0].ctypes.data == 64


def test_what_one_changes_no_other_sees(tmp_path):
    parcel = Parcel([np.zeros(5)], tmp_path / "parcel")
    (one,), (other,) = open_parcel(parcel.path), open_parcel(parcel.path)
    one[2] = 7.0
    assert one.tolist() == [0, 0, 7, 0, 0]
    assert other.tolist() == [0] * 5
    assert open_parcel(parcel.path)[0].tolist() == [0] * 5


def test_many_arrays_are_one_open_file(tmp_path):
    """As many as no process may have open files."""
    arrays = [np.full(2, i) for i in range(5000)]
    parcel = Parcel(arrays, tmp_path / "parcel")
    found = open_parcel(parcel.path)
    assert [int(a[1]) for a in found] == list(range(5000))


def test_the_file_goes_with_the_parcel_and_what_was_opened_stays(tmp_path):
    parcel = Parcel(np.arange(1000.0), tmp_path / "parcel")
    found = open_parcel(parcel.path)
    del parcel
    gc.collect()
    assert list(tmp_path.iterdir()) == []
    assert found.sum() == 499500


def test_no_room(tmp_path):
    with pytest.raises(
        EngineError, match=r"parcel: 8 MiB .* cannot be written: No such file .*TMPDIR"
    ):
        Parcel(np.ones(2**20), tmp_path / "gone" / "parcel")
