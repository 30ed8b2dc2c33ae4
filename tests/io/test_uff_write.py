"""Universal files written, read back, and read by another program (pyuff); and pyuff's own files read."""

from dataclasses import replace

import numpy as np
import pytest
import pyuff

import updyn
from io_samples import assert_same_frf, frf
from updyn.errors import FormatError, UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.uff"


def plain(**changes) -> FRF:
    """What a universal file can hold."""
    return replace(
        frf(with_geometry=False), **({"variance": None, "averages": None, "source": ""} | changes)
    )


def round_trip(data, path):
    updyn.write_frf(data, path)
    return replace(updyn.read_frf(path), source="")


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("with_coherence", [True, False])
def test_round_trip_is_exact(path, quantity, with_coherence):
    data = plain(quantity=quantity)
    data = data if with_coherence else replace(data, coherence=None)
    assert_same_frf(round_trip(data, path), data)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("freq", "even"),
    [
        (np.arange(5) * 0.125, True),
        (np.linspace(1, 400, 5), True),
        (20 + np.arange(5) * 0.1, True),
        (10 + np.arange(5) / 3, False),  # a third has no text of 12 columns
        (np.array([1.0, 2.0, 3.0, 4.0, 5.5]), False),
        (np.geomspace(1e-3, 1e6, 5), False),
    ],
)
def test_lines_are_exact_to_rounding(path, freq, even):
    found = round_trip(plain(freq=freq), path)
    np.testing.assert_allclose(found.freq, freq, rtol=1e-15, atol=0)
    assert all(
        s["abscissa_spacing"] == even for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 58
    )


def test_one_line(path):
    data = FRF([7.5], [[[1 + 2j]]], ["1:X"], ["1:X"], "receptance")
    assert_same_frf(round_trip(data, path), data)


def test_geometry_goes_along(path):
    rng = np.random.default_rng(1)
    nodes = np.arange(1, 200)
    lines = np.column_stack([nodes[:-1], nodes[1:]])  # more than one dataset 82 may hold
    place = Geometry(nodes, rng.normal(size=(199, 3)) / 3, lines)
    found = round_trip(plain(geometry=place), path)
    for name in ("nodes", "xyz", "lines"):
        np.testing.assert_array_equal(getattr(found.geometry, name), getattr(place, name))


def test_directions_of_nodes_are_written_as_systems(path):
    axes = np.array(
        [np.eye(3), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]]
    )
    place = Geometry([1, 2, 7], np.eye(3), axes=axes)
    data = plain(geometry=place, responses=["1:X", "2:-Y", "7:Z"], references=["1:X", "2:X"])
    found = round_trip(data, path)
    assert found.responses.labels == ["1:X", "2:X", "7:Z"]  # -Y of node 2 is global X
    assert found.references.labels == ["1:X", "2:Y"]
    np.testing.assert_array_equal(found.values, data.values)
    np.testing.assert_array_equal(updyn.io.read_geometry(path).axes, axes)


def test_what_has_no_place_is_said(path):
    with pytest.warns(UpdynWarning, match="cannot hold variance and averages; written"):
        updyn.write_frf(frf(with_geometry=False), path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"responses": ["1:X", "2:X", "123456789012:X"]}, "node 123456789012 does not fit"),
        (
            {"geometry": Geometry([1, 7], np.eye(3)[:2])},
            r"DOF 2:-Y is at a node missing in the geometry",
        ),
        (
            {"geometry": Geometry([1, 2, 3, 7, 0], np.ones((5, 3)), [[0, 1]])},
            "node 0, which means 'lift the pen'",
        ),
    ],
)
def test_what_cannot_be_written_leaves_the_old_file(path, changes, message):
    path.write_text("old")
    with pytest.raises(FormatError, match=message):
        updyn.write_frf(plain(**changes), path)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


# -- the other program -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("freq", [np.arange(5) * 0.5, np.array([1.0, 2.0, 3.0, 4.0, 5.5])])
def test_pyuff_reads_what_is_written(path, freq):
    data = plain(freq=freq)
    updyn.write_frf(data, path)
    sets = [s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 58]
    codes = {"X": 1, "Y": 2, "Z": 3, "RZ": 6}
    for s in sets:
        i = [d.node for d in data.responses].index(s["rsp_node"])
        j = [d.node for d in data.references].index(s["ref_node"])
        assert s["rsp_dir"] == data.responses[i].sign * codes[data.responses[i].direction]
        assert s["ref_dir"] == data.references[j].sign * codes[data.references[j].direction]
        expected = data.values if s["func_type"] == 4 else data.coherence
        np.testing.assert_array_equal(s["data"], expected[:, i, j])
        np.testing.assert_array_equal(s["x"], freq)
        assert (s["ordinate_spec_data_type"], s["orddenom_spec_data_type"]) == (
            (11, 13) if s["func_type"] == 4 else (0, 0)
        )
    assert sorted(s["func_type"] for s in sets) == [4] * 6 + [6] * 6


@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # pyuff leaves files open
@pytest.mark.parametrize("even", [0, 1])
@pytest.mark.parametrize(("binary", "double"), [(0, True), (0, False), (1, True)])
def test_files_that_pyuff_writes(path, binary, even, double):
    x = np.arange(7) * 0.5 + 1
    rng = np.random.default_rng(2)
    values = rng.normal(size=(7, 3)) + 1j * rng.normal(size=(7, 3))
    file = pyuff.UFF(str(path))
    for k in range(3):
        made = {
            "type": 58, "binary": binary, "func_type": 4, "rsp_node": k + 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": -1,
            "data": values[:, k], "x": x, "abscissa_spacing": even, "abscissa_spec_data_type": 18, "id1": "Prüfung",
            "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13, "rsp_ent_name": "Part",
        }  # fmt: skip
        if not double:
            made["ord_data_type"] = 5
        file.write_sets(made, "add", force_double=double)
    found = updyn.read_frf(path)
    assert (found.responses.labels, found.references.labels) == (["1:Z", "2:Z", "3:Z"], ["1:-X"])
    np.testing.assert_allclose(
        found.values[:, :, 0], values, rtol=0 if binary else 1e-11 if double else 1e-5
    )
    np.testing.assert_array_equal(found.freq, x)
