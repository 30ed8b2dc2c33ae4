"""Nodes, coordinate systems and trace lines of universal files, and directions that they turn."""

import numpy as np
import pytest

import uff_samples as uff
import updyn
from updyn.errors import FormatError, OptionError
from updyn.io import read_geometry

Y = np.array([1.5 - 2j, -0.25 + 1e-3j])
QUARTER = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]  # local X is global Y, local Y is global -X
TILTED = [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.unv"


def geometry(path, *parts):
    path.write_bytes(b"".join(parts))
    return read_geometry(path)


@pytest.mark.parametrize("nodes", [uff.nodes15, uff.nodes2411])
def test_nodes_and_lines(path, nodes):
    found = geometry(
        path, nodes((7, 0, 0, 1.5, -2, 3e-3), (3, 1, 1, 0, 0, 1)), uff.trace82(7, 3, 0, 3, 7)
    )
    assert found.nodes.tolist() == [7, 3]
    np.testing.assert_array_equal(found.xyz, [[1.5, -2, 3e-3], [0, 0, 1]])
    assert found.lines.tolist() == [[7, 3], [3, 7]]
    assert found.axes is None


def test_zeros_after_the_last_node_of_a_trace_line(path):
    rows = [f"{1:10d}{3:10d}{8:10d}", "NONE", "".join(f"{n:10d}" for n in (1, 2, 3, 0, 0, 0, 0, 0))]
    nodes = uff.nodes15(*((n, 0, 0, n, 0, 0) for n in (1, 2, 3)))
    assert geometry(path, nodes, uff.text(82, *rows)).lines.tolist() == [[1, 2], [2, 3]]


def test_positions_of_dataset_15_are_in_the_definition_system(path):
    systems = uff.systems2420(
        (5, 0, QUARTER, (10, 20, 30)), (6, 1, QUARTER, (1, 0, 0)), (7, 2, np.eye(3), (0, 0, 1))
    )
    nodes = uff.nodes15(
        (1, 5, 0, 1, 2, 3), (2, 6, 0, 2, 30, 5), (3, 7, 0, 2, 60, 90), (4, 7, 0, 2, 60, 30)
    )
    found = geometry(path, nodes, systems)  # systems may stand later
    s, c = 0.5, np.sqrt(3) / 2
    expected = [
        [10 - 2, 20 + 1, 30 + 3],
        [1 - 2 * s, 2 * c, 5],  # 2 along (cos 30, sin 30) of the turned axes
        [0, 2 * c, 1 + 2 * s],  # 60 degrees from z, azimuth 90
        [2 * c * c, 2 * c * s, 1 + 2 * s],
    ]
    np.testing.assert_allclose(found.xyz, expected, atol=1e-12)


def test_positions_of_dataset_2411_are_global_whatever_their_system(path):
    found = geometry(
        path, uff.systems2420((5, 0, QUARTER, (1, 1, 1))), uff.nodes2411((1, 5, 0, 1, 2, 3))
    )
    np.testing.assert_array_equal(found.xyz, [[1, 2, 3]])


def test_displacement_systems_become_axes(path):
    systems = uff.systems2420(
        (5, 0, TILTED, (9, 9, 9)), (6, 1, np.eye(3), (1, 0, 0)), (7, 2, np.eye(3), (0, 0, 0))
    )
    found = geometry(
        path,
        systems,
        uff.nodes15((1, 0, 5, 1, 2, 3), (2, 0, 6, 1, 5, 0), (3, 0, 7, 0, 3, 0), (4, 0, 0, 1, 1, 1)),
    )
    np.testing.assert_allclose(found.axes[0], TILTED)
    np.testing.assert_allclose(
        found.axes[1], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15
    )  # r, azimuth, z
    np.testing.assert_allclose(
        found.axes[2], [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-15
    )  # r, from z, azimuth
    np.testing.assert_array_equal(found.axes[3], np.eye(3))


def test_systems_of_dataset_18_by_three_points(path):
    points = [
        (1, 0, 0),
        (1, 2, 0),
        (1, 2, 3),
    ]  # origin; +x along global y; xz plane upwards: y is -x x ...
    rows = [f"{4:10d}{0:10d}{0:10d}{8:10d}{1:10d}", "SYS4"]
    rows += [
        "".join(f"{v:13.5E}" for p in points[:2] for v in p),
        "".join(f"{v:13.5E}" for v in points[2]),
    ]
    # a system that refers to the first: its origin 1 along its x, axes as there
    rows += [f"{5:10d}{0:10d}{4:10d}{8:10d}{1:10d}", "SYS5"]
    rows += [
        "".join(f"{v:13.5E}" for v in (1, 0, 0, 2, 0, 0)),
        "".join(f"{v:13.5E}" for v in (2, 0, 1)),
    ]
    found = geometry(path, uff.text(18, *rows), uff.nodes15((1, 4, 4, 1, 0, 0), (2, 5, 0, 1, 2, 3)))
    # x = global Y, z = global Z, so y = z x x = -global X
    np.testing.assert_allclose(found.axes[0], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(found.xyz, [[1, 1, 0], [1 - 2, 1 + 1, 3]], atol=1e-15)


def test_lengths_are_converted_to_metres_wherever_the_units_stand(path):
    parts = [uff.systems2420((5, 1, np.eye(3), (1000, 0, 0))), uff.nodes15((1, 5, 0, 500, 90, 250))]
    for order in ([uff.units(5, 1000, 1000), *parts], [*parts, uff.units(5, 1000, 1000)]):
        np.testing.assert_allclose(geometry(path, *order).xyz, [[1, 0.5, 0.25]], atol=1e-15)


# -- together with FRFs ----------------------------------------------------------------------------------------
def read(path, *parts, **options):
    path.write_bytes(b"".join(parts))
    return updyn.read_frf(path, **options)


def test_the_geometry_comes_with_the_frf(path):
    found = read(
        path, uff.binary58(Y, (2, 3), (1, 3)), uff.nodes15((1, 0, 0, 0, 0, 1), (2, 0, 0, 1, 0, 1))
    )
    np.testing.assert_array_equal(found.geometry.position([2]), [[1, 0, 1]])


@pytest.mark.parametrize(
    ("code", "label"),
    [
        (1, "2:Y"),
        (-1, "2:-Y"),
        (2, "2:-X"),
        (-2, "2:X"),
        (3, "2:Z"),
        (4, "2:RY"),
        (5, "2:-RX"),
        (-6, "2:-RZ"),
    ],
)
def test_directions_of_a_turned_node_are_expressed_globally(path, code, label):
    parts = [
        uff.systems2420((5, 0, QUARTER, (0, 0, 0))),
        uff.nodes15((1, 0, 0, 0, 0, 1), (2, 0, 5, 1, 0, 1)),
    ]
    found = read(path, *parts, uff.binary58(Y, (2, code), (1, 1)))
    assert found.responses.labels == [label]
    assert found.references.labels == ["1:X"]
    assert found.geometry.axes is None
    np.testing.assert_array_equal(found.values[:, 0, 0], Y)


def test_a_direction_within_1e_6_of_an_axis_passes_and_one_beyond_does_not(path):
    for angle, passes in ((5e-7, True), (5e-6, False)):
        c, s = np.cos(angle), np.sin(angle)
        systems = uff.systems2420((5, 0, [[c, s, 0], [-s, c, 0], [0, 0, 1]], (0, 0, 0)))
        parts = [systems, uff.nodes15((1, 0, 5, 0, 0, 1)), uff.binary58(Y, (1, 1), (1, 3))]
        if passes:
            assert read(path, *parts).responses.labels == ["1:X"]
        else:
            with pytest.raises(
                FormatError, match=r"response 1:X is oblique: .*parallel to no axis"
            ):
                read(path, *parts)


def test_local_directions_are_kept_with_their_axes_where_that_is_asked_for(path):
    systems = uff.systems2420((5, 0, QUARTER, (0, 0, 0)), (6, 0, TILTED, (0, 0, 0)))
    nodes = uff.nodes15((1, 0, 0, 0, 0, 1), (2, 0, 5, 1, 0, 1), (3, 0, 6, 2, 0, 1))
    parts = [systems, nodes, uff.binary58(Y, (2, 1), (1, 1)), uff.binary58(Y, (3, -1), (1, 1))]
    found = read(path, *parts, local_axes=True)
    assert found.responses.labels == ["2:X", "3:-X"]
    np.testing.assert_array_equal(found.geometry.axes, [np.eye(3), QUARTER, TILTED])
    with pytest.raises(FormatError, match=r"response 3:-X is oblique: .*local_axes=True"):
        read(path, *parts)
    with pytest.raises(FormatError, match="node 4"):
        read(path, *parts, uff.binary58(Y, (4, 1), (1, 1)), local_axes=True)
    with pytest.raises(OptionError, match="local_axes 'yes': expected True or False"):
        read(path, *parts, local_axes="yes")


def test_oblique_directions_that_no_function_uses_do_not_matter(path):
    parts = [uff.systems2420((5, 0, TILTED, (0, 0, 0))), uff.nodes15((1, 0, 5, 0, 0, 1))]
    assert read(path, *parts, uff.binary58(Y, (1, 3), (1, -3))).responses.labels == ["1:Z"]


def test_a_file_without_nodes_has_no_geometry(path):
    with pytest.raises(FormatError, match=r"holds no nodes .*it holds dataset 58"):
        geometry(path, uff.binary58(Y))


def test_a_file_laid_out_as_measurement_systems_do(path):
    """Padded delimiters, user-defined units that are SI, systems by rounded points, names, zeros to fill lines."""

    def padded(data):
        return b"\n".join(line.ljust(80) for line in data.split(b"\n")[:-1]) + b"\n"

    down = [f"{4:10d}{0:10d}{0:10d}{8:10d}{1:10d}", "SYS4"]
    down += ["".join(f" {v:.5e}".rjust(13) for v in (-2.4, 0, 0, -3.4, 0, -8.74228e-08))]
    down += ["".join(f" {v:.5e}".rjust(13) for v in (-3.4, 0, -1))]
    trace = [
        f"{1:10d}{3:10d}{8:10d}",
        "Frame",
        "".join(f"{n:10d}" for n in (4, 9, 4, 0, 0, 0, 0, 0)),
    ]
    options = {"names": ("Frame", "Frame"), "units": ("Hz", "m/s^2", "N"), "step": 0.5}
    found = read(
        path,
        padded(uff.text(151, "project", "NONE")),
        padded(uff.units(9, 1.0, 1.0)),
        uff.text(18, *down),
        uff.nodes15((4, 0, 4, -2.4, 0, 0), (9, 0, 0, 0, 0, 0)),
        uff.text(82, *trace),
        padded(uff.ascii58(Y, (4, 1), (9, -3), **options)),
        uff.binary58(3 * Y, (4, -3), (9, -3), **options),
    )
    # The system of node 4 has its x along -X and its z along -Z of the global one.
    assert found.responses.labels == ["4:-X", "4:Z"]
    assert found.references.labels == ["9:-Z"]
    np.testing.assert_allclose(found.values[:, :, 0], Y[:, None] * [1, 3], rtol=5e-6)
    assert found.geometry.lines.tolist() == [[4, 9], [9, 4]]
