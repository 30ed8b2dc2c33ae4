"""Why universal files are not read with pyuff: what the version installed makes of deviations that real files have.

These tests document pyuff, not updyn: one that is skipped says that the pyuff installed reads that
file right, and that the note at the top of `updyn.io.uff.frf` is due for a second look. In every case
updyn reads the numbers as they were."""

import contextlib

import numpy as np
import pytest
import pyuff

import uff_samples as uff
import updyn

Y = np.array([1.5 - 2j, -0.25 + 1e-3j, 3e4 + 7j, -1e-6 - 1j / 3])
GOOD = uff.ascii58(Y)
WIDE = [f"{v:14.5E}" for v in uff.flat(Y)]
BYTES = np.frombuffer(b"    -1\n    58\n    -1\n\n    -1\n    -1\n" * 4, dtype="<c16", count=8)

# pyuff leaves the file open where it raises
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def by_pyuff(path):
    """Return the data of the functions, or None where pyuff refuses the file."""
    found = None
    with contextlib.suppress(Exception):  # pyuff raises plain Exception
        sets = pyuff.UFF(str(path)).read_sets()
        found = [
            s["data"] for s in (sets if isinstance(sets, list) else [sets]) if s.get("type") == 58
        ]
    return found


def put(tmp_path, data, y=Y):
    path = tmp_path / "case.uff"
    path.write_bytes(data)
    np.testing.assert_allclose(updyn.read_frf(path).values[:, 0, 0], y, rtol=5e-6)
    return path


def is_right(found, y=Y):
    return (
        found is not None
        and len(found) == 1
        and found[0].shape == y.shape
        and np.allclose(found[0], y, rtol=5e-6)
    )


def test_a_file_as_the_format_says_is_read_alike(tmp_path):
    assert is_right(by_pyuff(put(tmp_path, GOOD)))


def test_silent_wrong_values_in_fields_of_14_columns(tmp_path):
    found = by_pyuff(put(tmp_path, uff.text(58, *uff.records(), *WIDE)))
    if is_right(found):
        pytest.skip(f"pyuff {pyuff.__version__} reads fields of 14 columns")
    assert found is not None  # no error: the exponents are gone
    np.testing.assert_allclose(found[0], [1.5 - 2j, -2.5 + 1j, 3 + 7j, -1 - 3.33333j])


def test_silently_dropped_functions_after_a_line_that_ends_in_minus_one(tmp_path):
    found = by_pyuff(put(tmp_path, uff.text(9999, f"{1:10d}{-1:10d}", "text") + GOOD))
    if is_right(found):
        pytest.skip(f"pyuff {pyuff.__version__} tells a line that ends in -1 from a delimiter")
    assert found == []


def test_silently_cut_binary_data_that_look_like_a_delimiter(tmp_path):
    found = by_pyuff(put(tmp_path, uff.binary58(BYTES), BYTES))
    if is_right(found, BYTES):
        pytest.skip(f"pyuff {pyuff.__version__} reads the bytes of a 58b by their count")
    assert [f.size for f in found] == [0]


@pytest.mark.parametrize(
    "data",
    [
        uff.text(58, *uff.records(), "".join(WIDE[:6]), "".join(WIDE[6:])),
        GOOD.replace(b"E+", b"D+").replace(b"E-", b"d-"),
        uff.text(58, *uff.records(), " ".join(f"{v:.6e}" for v in uff.flat(Y))),
    ],
    ids=["14 columns, six a line", "exponents with D", "separated by blanks"],
)
def test_refused(tmp_path, data):
    found = by_pyuff(put(tmp_path, data))
    if is_right(found):
        pytest.skip(f"pyuff {pyuff.__version__} reads this")
    assert found is None
