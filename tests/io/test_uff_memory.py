"""Memory that reading a universal file takes, by the size of the file and of what it holds."""

import tracemalloc

import numpy as np
import pytest

import uff_samples as uff
import updyn

POINTS, RESPONSES = 2**14, 32
RNG = np.random.default_rng(8)
ALLOWANCE = 2.0**20 * 3  # a few arrays of one function


def peak(read, path):
    """Return what a reader returns, and the peak of its allocations in bytes."""
    read(path)  # imports
    tracemalloc.start()
    try:
        found = read(path)
        return found, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def write(path, values, write=uff.binary58, **options):
    with path.open("wb") as file:
        for number, y in enumerate(values, 1):
            file.write(write(y, (number, 3), **options))
    return path


@pytest.fixture(scope="module")
def values():
    return RNG.standard_normal((RESPONSES, 2 * POINTS)).view(np.complex128)


@pytest.mark.parametrize("x", [None, np.cumsum(RNG.uniform(1, 2, POINTS))])
@pytest.mark.parametrize("ordinate", [5, 6])
def test_binary_frfs_take_the_memory_of_their_values(tmp_path, values, ordinate, x):
    path = write(tmp_path / "case.uff", values, ordinate=ordinate, x=x)
    found, most = peak(updyn.read_frf, path)
    kind = np.complex64 if ordinate == 5 else np.complex128
    np.testing.assert_array_equal(found.values[:, :, 0], values.T.astype(kind))
    assert most < found.values.nbytes * 1.1 + ALLOWANCE
    assert most < 2.0 * path.stat().st_size + ALLOWANCE


def test_frfs_in_text_take_less_than_twice_the_file(tmp_path, values):
    path = write(tmp_path / "case.uff", values[:8], uff.ascii58)
    found, most = peak(updyn.read_frf, path)
    np.testing.assert_allclose(found.values[:, :, 0], values[:8].T, rtol=5e-6)
    assert most < 2.0 * path.stat().st_size + ALLOWANCE


@pytest.mark.parametrize("ordinate", [2, 4])
def test_time_records_take_twice_the_memory_of_their_values(tmp_path, values, ordinate):
    options = {"kind": 1, "types": (17, 12, 0), "units": ("s", "g", "NONE"), "step": 0.25}
    path = write(tmp_path / "case.uff", values.real, ordinate=ordinate, **options)
    found, most = peak(updyn.read_records, path)
    np.testing.assert_allclose(found.values[0], values.real, rtol=1e-7)
    assert most < 2.2 * found.values.nbytes + ALLOWANCE
