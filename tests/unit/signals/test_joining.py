"""FRFs of several setups as one matrix: by labels alone, each pair once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, UpdynWarning

FREQ = np.array([1.0, 2.0, 4.0])


def measured(responses, references, start=0.0, averages=4):
    shape = (len(FREQ), len(responses), len(references))
    values = start + np.arange(np.prod(shape)).reshape(shape) * (1.0 + 2.0j)
    known = {"coherence": np.full(shape, 0.9), "variance": np.abs(values) ** 2 + 1.0}
    return updyn.FRF(
        FREQ, values, responses, references, "mobility", **known, averages=averages, source="s"
    )


def test_a_roving_hammer():
    parts = [measured(["1:Z", "2:Z"], [f"{k}:X"], start=100.0 * k) for k in (5, 6, 7)]
    found = updyn.joined_frfs(parts, ["a", "b", "c"])
    assert found.responses.labels == ["1:Z", "2:Z"]
    assert found.references.labels == ["5:X", "6:X", "7:X"]
    for column, part in enumerate(parts):
        for name in ("values", "coherence", "variance"):
            whole, own = getattr(found, name), getattr(part, name)
            np.testing.assert_array_equal(whole[:, :, column], own[:, :, 0])
    assert found.averages == 4


def test_roving_sensors_in_any_order_and_sense():
    one, two = measured(["3:Z"], ["1:X", "2:X"]), measured(["4:-Y"], ["2:-X", "1:X"], 50.0)
    found = updyn.joined_frfs([one, two], ["a", "b"])
    assert (found.responses.labels, found.references.labels) == (["3:Z", "4:-Y"], ["1:X", "2:X"])
    np.testing.assert_array_equal(found.values[:, 0], one.values[:, 0])
    np.testing.assert_array_equal(found.values[:, 1, 0], two.values[:, 0, 1])
    np.testing.assert_array_equal(found.values[:, 1, 1], -two.values[:, 0, 0])


def test_one_setup_is_as_it_is():
    one = measured(["3:Z"], ["1:X"])
    assert updyn.joined_frfs([one], ["a"]) is one


def test_averages_that_differ_are_not_one_number():
    found = updyn.joined_frfs(
        [measured(["3:Z"], ["1:X"]), measured(["4:Z"], ["1:X"], averages=7)], ["a", "b"]
    )
    assert found.averages is None
    assert found.variance is not None


def test_a_setup_without_variance_is_told():
    single = replace(measured(["4:Z"], ["1:X"]), variance=None, coherence=None)
    with (
        pytest.warns(UpdynWarning, match="b: a single record, which has no coherence"),
        pytest.warns(UpdynWarning, match="b: a single record, which has no variance"),
    ):
        found = updyn.joined_frfs([measured(["3:Z"], ["1:X"]), single], ["a", "b"])
    assert found.variance is None


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (
            measured(["3:-Z"], ["1:X"]),
            "response 3:-Z to reference 1:X was measured twice: in a.lvm and in b.lvm",
        ),
        (
            measured(["4:Z"], ["2:X"]),
            "response 3:Z to reference 2:X was not measured: 3:Z is in a.lvm, 2:X in b.lvm",
        ),
        (
            replace(measured(["4:Z"], ["1:X"]), quantity="accelerance"),
            "b.lvm contains accelerance, a.lvm mobility",
        ),
        (
            replace(measured(["4:Z"], ["1:X"]), freq=FREQ * 1.001),
            "b.lvm has 3 lines from 1.001 to 4.004 Hz, a.lvm 3 lines from 1 to 4 Hz",
        ),
    ],
)
def test_what_does_not_fit_names_both_files(other, message):
    with pytest.raises(DataError, match=message):
        updyn.joined_frfs([measured(["3:Z"], ["1:X"]), other], ["a.lvm", "b.lvm"])


def placed(frf, nodes, xyz, **more):
    return replace(frf, geometry=updyn.Geometry(nodes, xyz, **more))


def test_the_geometry_of_all_setups_is_kept():
    """Nodes once each, lines and faces of all setups; a setup without geometry adds none."""
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    one = placed(measured(["3:Z"], ["1:X"]), [1, 3], [[0, 0, 0], [1, 0, 0]], lines=[[1, 3]])
    two = placed(
        measured(["4:Z"], ["1:X"]),
        [4, 1],
        [[0, 2, 0], [0, 0, 0]],
        lines=[[1, 4]],
        axes=[turned, np.eye(3)],
        faces=[[1, 4, 4, 1]],
    )
    bare = measured(["5:Z"], ["1:X"])
    found = updyn.joined_frfs([one, bare, two], ["a", "b", "c"]).geometry
    assert found.nodes.tolist() == [1, 3, 4]
    assert found.xyz.tolist() == [[0, 0, 0], [1, 0, 0], [0, 2, 0]]
    assert found.lines.tolist() == [[1, 3], [1, 4]]
    assert found.faces.tolist() == [[1, 4, 4, 1]]
    np.testing.assert_array_equal(found.axes, [np.eye(3), np.eye(3), turned])
    assert updyn.joined_frfs([one, bare], ["a", "b"]).geometry.axes is None
    assert updyn.joined_frfs([measured(["3:Z"], ["1:X"]), bare], ["a", "b"]).geometry is None


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"xyz": [[0.1, 0, 0]]}, r"b gives node 1 the position \[0.1, 0.0, 0.0\], a \[0.0, 0.0,"),
        ({"xyz": [[0, 0, 0]], "axes": [-np.eye(3)]}, "b gives node 1 the directions"),
    ],
)
def test_a_node_in_two_places_is_refused(other, message):
    one = placed(measured(["3:Z"], ["1:X"]), [1], [[0, 0, 0]])
    two = placed(measured(["4:Z"], ["1:X"]), [1], **other)
    with pytest.raises(DataError, match=message):
        updyn.joined_frfs([one, two], ["a", "b"])
