"""[match] of a job: positions, units, directions, and errors at their lines."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.errors import JobError
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.io.dof_table import write_geometry
from updyn.job import load_job, prepare, run_job
from updyn.job.trace_lines import with_trace_lines
from updyn.model import Group, Model
from updyn.viewer import sensor_body

BASE = """\
[model]
file = "frame.h5"
[test]
file = "test.npz"
{test}
[[parameter]]
groups = ["left", "right"]
quantity = "stiffness"
[method]
starts = 0
[output]
report = false
[match]
{match}
"""
XYZ = np.array([[0, 0, 0], [1.0, 0, 0], [1.1, 0.8, 0], [0, 0.7, 0.4]])
#: Positions of the test: other axes (its X is the model's Y, its Y is the model's -X), another
#: origin.
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
TEST_XYZ = (XYZ - [0.5, 0, 1.0]) @ QUARTER
OBLIQUE = np.array([0.6, 0.0, 0.8])


def frame() -> Model:
    """Make two groups of springs with all three directions of four nodes coupled."""
    rng, n = np.random.default_rng(7), 12
    groups = {}
    for name, own in (("left", np.arange(8)), ("right", np.arange(4, 12))):
        K, M, at = np.zeros((n, n)), np.zeros((n, n)), np.ix_(own, own)
        A = rng.standard_normal((8, 8))
        K[at], M[at] = 1e5 * (A @ A.T + np.eye(8)), np.eye(8)
        groups[name] = Group(K, M, 0.02)
    dofs = [f"{i}:{d}" for i in (11, 12, 13, 14) for d in "XYZ"]
    return Model.from_groups(groups, dofs, geometry=Geometry([11, 12, 13, 14], XYZ), title="Frame")


TRUE = {"left": {"stiffness": 1.15}, "right": {"stiffness": 0.9}}
LINES = np.linspace(10.0, 120.0, 30)


def measured() -> FRF:
    """Return what sensors 1:X, 2:Y, 3:Z (oblique in the model) and forces 1:X, 4:Z of the test read and do."""
    true = frame().scaled(TRUE)
    H = updyn.response(true, LINES, true.dofs, true.dofs).values
    read = np.zeros((3, 12))
    read[0, 1], read[1, 3], read[2, 6:9] = 1, -1, OBLIQUE  # 11:Y, 12:-X, 13 along OBLIQUE
    load = np.zeros((2, 12))
    load[0, 1], load[1, 11] = 1, 1  # 11:Y, 14:Z
    values = np.einsum("ri,fij,lj->frl", read, H, load)
    return FRF(LINES, values, ["1:X", "2:Y", "3:Z"], ["1:X", "4:Z"], "receptance")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    updyn.write_model(frame(), tmp_path / "frame.h5")
    updyn.write_frf(measured(), tmp_path / "test.npz")
    write_geometry(Geometry([1, 2, 3, 4], 1000 * TEST_XYZ), tmp_path / "points.csv")
    return tmp_path


DIRECTION = (OBLIQUE @ QUARTER).tolist()  # in the axes of the test
GOOD = f"""\
by = "coordinates"
geometry = "points.csv"
unit = "mm"
tolerance = "0.5 %"
alignment = {{ 1 = 11, 2 = 12, 3 = 13, 4 = 14 }}
[match.directions]
"3:Z" = {DIRECTION}
"""


def job_at(folder: Path, match: str, test: str = "") -> Any:
    (folder / "job.toml").write_text(BASE.format(match=match, test=test), encoding="utf-8")
    return load_job(folder / "job.toml")


def test_a_job_by_coordinates_finds_what_the_sensors_read(folder: Path) -> None:
    job = job_at(folder, GOOD)
    ready = prepare(job)
    assert [m.dof for m in ready.matching.table] == ["11:Y", "12:-X", "13:Z", "14:Z"]
    assert [m.turned for m in ready.matching.table] == [False, False, True, False]
    assert ready.model is ready.matching.model
    result = run_job(job, folder / "out", prepared=ready).result
    assert result.status == "converged"
    assert result.values == pytest.approx(
        {"left.stiffness": 1.15, "right.stiffness": 0.9}, rel=1e-7
    )
    kept = updyn.read_model(folder / "out" / "model.h5")
    np.testing.assert_allclose(kept.geometry.axes[2][2], OBLIQUE, atol=1e-12)


def test_the_resolved_job_runs_again_from_its_folder(folder: Path) -> None:
    first = run_job(job_at(folder, GOOD), folder / "out").result
    written = tomllib.loads((folder / "out" / "job.toml").read_text(encoding="utf-8"))["match"]
    assert written == {
        "by": "coordinates",
        "geometry": "../points.csv",
        "tolerance": "0.5 %",
        "unit": "mm",
        "alignment": {"1": 11, "2": 12, "3": 13, "4": 14},
        "directions": {"3:Z": DIRECTION},
    }
    again = run_job(load_job(folder / "out" / "job.toml"), folder / "again").result
    assert again.values == first.values


def test_a_matrix_and_the_geometry_of_the_test_file(folder: Path) -> None:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = QUARTER, [0.5, 0, 1.0]
    data = measured()
    told = FRF(
        data.freq,
        data.values,
        data.responses,
        data.references,
        data.quantity,
        geometry=Geometry([1, 2, 3, 4], TEST_XYZ),
    )
    updyn.write_frf(told, folder / "test.npz")
    text = (
        f'by = "coordinates"\nalignment = {matrix.tolist()}\nangle ='
        ' 0.5\n[match.directions]\n"3:-Z" = [-0.6, 0, 0.8]\n'
    )
    (folder / "out").mkdir()
    job = job_at(folder, text)
    assert [m.dof for m in prepare(job).matching.table][:2] == ["11:Y", "12:-X"]
    run_job(job, folder / "out")
    written = tomllib.loads((folder / "out" / "job.toml").read_text(encoding="utf-8"))["match"]
    assert written["alignment"] == matrix.tolist()
    assert written["angle"] == 0.5


def test_check_prints_the_table(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job_at(folder, GOOD)
    assert main(["check", str(folder / "job.toml"), "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "Matched by coordinates: 4 sensors and forces are DOFs of the model" in out
    assert (
        "positions in mm; aligned on 4 pairs of nodes; turned by 90 degrees, moved by (0.5, 0, 1) m"
        in out
    )
    found = {
        line.split()[0]: line
        for line in out.splitlines()
        if line[:3] in ("1:X", "2:Y", "3:Z", "4:Z")
    }
    assert found["1:X"].split() == [
        "1:X",
        "response",
        "and",
        "reference",
        "11:Y",
        *found["1:X"].split()[5:],
    ]
    assert "13:Z" in found["3:Z"]
    assert found["3:Z"].endswith("turned along (0.6, 0, 0.8)")


BAD = [
    (('unit = "mm"\n', ""), 13, "look like mm: then all 4 nodes lie within 0.0"),
    (('"mm"', '"millimetre"'), 16, "match.unit = 'millimetre': valid: 'm', 'cm', 'mm', 'in', 'ft'"),
    (
        ('"points.csv"', '"point.csv"'),
        15,
        "match.geometry = 'point.csv': no such file; did you mean 'points.csv'",
    ),
    (('"points.csv"', '"frame.h5"'), 15, "frame.h5"),
    (
        ('geometry = "points.csv"\n', ""),
        13,
        "test.npz has no geometry: give that of the test, or match by label",
    ),
    (('"0.5 %"', '"half"'), 17, "expected a distance in m above 0, or a share"),
    (('"0.5 %"', "0"), 17, "match.tolerance = 0: expected a distance in m above 0"),
    (('by = "coordinates"\n', ""), 15, "unit belongs to by = 'coordinates'"),
    (('"0.5 %"', '"any"'), 17, "tolerance 'any' belongs to by = 'label'"),
    (("2 = 12", "2 = 99"), 18, "alignment: geometry: node 99 has no position; nearest: 14, 13, 12"),
    (("2 = 12", "2 = 14"), 18, "the pairs do not lie on each other within 0.0"),
    (("2 = 12", 'two = "12"'), 18, "'4': 14}: expected 'fit', a table of nodes of the test"),
    (
        ("{ 1 = 11, 2 = 12, 3 = 13, 4 = 14 }", '"best"'),
        18,
        "match.alignment = 'best': expected 'fit'",
    ),
    (("{ 1 = 11, 2 = 12, 3 = 13, 4 = 14 }", "[[1, 2], [3, 4]]"), 18, "or a 4 x 4 array"),
    (("{ 1 = 11, 2 = 12, 3 = 13, 4 = 14 }", "[1, 2, 3, 4]"), 18, "or a 4 x 4 array"),
    (("[match.directions]", "angle = 50\n[match.directions]"), 19, "angle"),
    (('"3:Z"', '"5:Z"'), 20, "'5:Z' is no response or reference of test.npz"),
    ((f"= {DIRECTION}", "= [0, 1]"), 20, "match.directions.3:Z: expected at least 3 entries"),
    (
        (f"= {DIRECTION}", "= [0, 0, 0]"),
        20,
        "direction of 3:Z: expected three finite numbers, not all 0",
    ),
    (
        ("tolerance", "tolerence"),
        17,
        "unknown key 'tolerence' in [match]; did you mean 'tolerance'",
    ),
    (
        ("[match.directions]", '[match.table]\n"1:X" = "12:Q"\n[match.directions]'),
        20,
        "DOF '12:Q': expected node:direction",
    ),
]


@pytest.mark.parametrize(("change", "line", "message"), BAD)
def test_a_complaint_names_its_line(
    change: tuple[str, str],
    line: int,
    message: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert change[0] in GOOD
    with pytest.raises(JobError) as caught:
        prepare(job_at(folder, GOOD.replace(*change)))
    text = str(caught.value)
    assert message in text
    assert text.startswith(f"{folder / 'job.toml'}:{line}: "), text
    assert main(["check", str(folder / "job.toml")]) == 2
    assert capsys.readouterr().err == f"error: {text}\n"


def test_what_is_not_near_and_what_is_no_dof_are_listed(folder: Path) -> None:
    far = XYZ + np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0], [0, 0, 0]])
    write_geometry(Geometry([1, 2, 3, 4], far), folder / "points.csv")
    text = 'by = "coordinates"\ngeometry = "points.csv"\ntolerance = 0.01\n'
    with pytest.raises(
        JobError,
        match=r"(?s)job\.toml:16: 1 of 4 nodes .*node 2 at \(1, 0, 0\.1\) m: nearest 12 at 0\.1 m",
    ):
        prepare(job_at(folder, text))
    ready = prepare(job_at(folder, text + '[match.table]\n"2" = "12"\n'))
    assert [m.dof for m in ready.matching.table] == ["11:X", "12:Y", "13:Z", "14:Z"]
    with pytest.raises(JobError) as caught:
        prepare(job_at(folder, 'by = "label"'))
    text = str(caught.value)
    assert text.startswith(
        f"{folder / 'job.toml'}:4: 4 of the sensors and forces of test.npz are not DOFs of the"
        " model:"
    )
    assert "response and reference 1:X is not among the 12 DOFs; nearest: 11:X, 11:Y, 11:Z" in text
    assert text.endswith(
        '[match.table] ("1:X" = "..."), or keep only those that are, with responses and references'
        " in [test]"
    )


def test_local_axes_in_a_separate_universal_file(folder: Path, tmp_path: Path) -> None:
    """A universal file of nodes whose displacement system is turned: its sensors are the model's other directions."""
    shutil.rmtree(tmp_path / "out", ignore_errors=True)
    blocks = [
        "    -1\n  2420\n         1\ntest\n         7         0         0\nturned\n"
        + "".join("".join(f"{v:25.16E}" for v in row) + "\n" for row in [*QUARTER.T, [0, 0, 0]])
        + "    -1\n",
        "    -1\n  2411\n"
        + "".join(
            f"{node:10d}{1:10d}{7:10d}{11:10d}\n" + "".join(f"{v:25.16E}" for v in point) + "\n"
            for node, point in zip((1, 2, 3, 4), XYZ, strict=True)
        )
        + "    -1\n",
    ]
    (folder / "points.unv").write_text("".join(blocks), encoding="ascii")
    ready = prepare(job_at(folder, 'by = "coordinates"\ngeometry = "points.unv"\n'))
    assert [m.dof for m in ready.matching.table] == ["11:Y", "12:-X", "13:Z", "14:Z"]
    assert not any(m.turned for m in ready.matching.table)


def test_local_axes_in_the_universal_file_of_the_test(folder: Path) -> None:
    """As a laboratory delivers it: functions, nodes and their systems in one file; one of them oblique."""
    data = measured()
    tilted = np.array([[0.8, 0, -0.6], [0, 1, 0], OBLIQUE])
    axes = np.array([QUARTER.T, QUARTER.T, tilted, np.eye(3)])
    told = FRF(
        data.freq,
        data.values,
        data.responses,
        data.references,
        data.quantity,
        geometry=Geometry([1, 2, 3, 4], XYZ, axes=axes),
    )
    updyn.write_frf(told, folder / "test.unv")
    path = folder / "job.toml"
    text = BASE.format(match='by = "coordinates"', test="{}").replace("test.npz", "test.unv")
    path.write_text(text.format(""), encoding="utf-8")
    with pytest.raises(JobError, match=r"response 3:Z is oblique: .*local_axes=True"):
        prepare(load_job(path))
    path.write_text(text.format("local_axes = true"), encoding="utf-8")
    ready = prepare(load_job(path))
    assert [m.dof for m in ready.matching.table] == ["11:Y", "12:-X", "13:Z", "14:Z"]
    assert [m.turned for m in ready.matching.table] == [False, False, True, False]
    result = run_job(load_job(path), folder / "out").result
    assert result.values == pytest.approx(
        {"left.stiffness": 1.15, "right.stiffness": 0.9}, rel=1e-7
    )
    assert "local_axes = true" in (folder / "out" / "job.toml").read_text(encoding="utf-8")


# -- labels and positions ---------------------------------------------------------------------------
#: Sensors 11, 12, 13 and forces 11, 14 of the test are at nodes 13, 14, 11 and 13, 12 of the model.
SWAPPED = Geometry([11, 12, 13, 14], XYZ[[2, 3, 0, 1]])


@pytest.fixture
def contradictory(folder: Path) -> Path:
    frf = measured()
    numbered = FRF(
        frf.freq,
        frf.values,
        ["11:X", "12:Y", "13:Z"],
        ["11:X", "14:Z"],
        frf.quantity,
        geometry=SWAPPED,
    )
    updyn.write_frf(numbered, folder / "test.npz")
    return folder


@pytest.mark.parametrize("command", ["check", "run", "correlate", "compare"])
@pytest.mark.parametrize(("match", "line"), [('by = "label"', 14), ("angle = 0.2", 13)])
def test_positions_that_contradict_labels_are_an_error_of_every_command(
    command: str, match: str, line: int, contradictory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = contradictory / "job.toml"
    path.write_text(BASE.format(test="", match=match), encoding="utf-8")
    before = sorted(contradictory.rglob("*"))
    assert main([command, str(path)]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {path}:{line}: labels and positions contradict each other")
    for node, distance in ((11, 1.36), (12, 1.28), (13, 1.36), (14, 1.28)):
        assert f"\n  {node}: {distance} m from node {node} of the model" in err
    assert '[match] by = "coordinates"' in err
    assert '[match] tolerance = "any"' in err
    assert sorted(contradictory.rglob("*")) == before


def test_positions_that_contradict_labels_without_a_table_for_the_match(
    contradictory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = contradictory / "job.toml"
    text = BASE.format(test="", match="").replace("[match]\n", "")
    path.write_text(text, encoding="utf-8")
    assert main(["check", str(path)]) == 2
    line = text.splitlines().index('file = "test.npz"') + 1
    assert capsys.readouterr().err.startswith(f"error: {path}:{line}: labels and positions")


@pytest.mark.parametrize("tolerance", ['"any"', "2.0", '"99 %"'])
def test_a_job_may_insist_on_labels(
    tolerance: str, contradictory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = contradictory / "job.toml"
    path.write_text(BASE.format(test="", match=f"tolerance = {tolerance}"), encoding="utf-8")
    assert main(["check", str(path)]) in (0, 3)
    out, err = capsys.readouterr()
    assert "Distances: rms 1.32 m, largest 1.36 m" in out
    assert "contradict" not in err
    found = prepare(load_job(path))
    assert found.frf.responses.labels == ["11:X", "12:Y", "13:Z"]


def test_lines_of_the_test_are_drawn_and_change_no_result(folder: Path) -> None:
    text = "lines = [[1, 3], [3, 2]]\n" + GOOD
    job = job_at(folder, text)
    ready = prepare(job)
    assert ready.frf.geometry.lines.tolist() == [[11, 13], [13, 12]]
    np.testing.assert_allclose(ready.frf.geometry.position([13]), [XYZ[2]])
    result = run_job(job, folder / "out", prepared=ready).result
    without = run_job(job_at(folder, GOOD), folder / "without").result
    assert result.values == without.values
    body = sensor_body(result.data.geometry, result.data.responses)
    nodes = body.nodes[body.lines]
    assert nodes.tolist() == [[11, 13], [13, 12]]
    again = load_job(folder / "out" / "job.toml")
    assert again.match.lines == ((1, 3), (3, 2))


def test_lines_without_positions_of_the_test_are_at_those_of_the_model(folder: Path) -> None:
    labels = '"1:X" = "11:Y"\n"2:Y" = "12:-X"\n"3:Z" = "13:Z"\n"4:Z" = "14:Z"\n'
    found = prepare(job_at(folder, f"lines = [[1, 2, 4]]\n[match.table]\n{labels}")).frf.geometry
    assert found.lines.tolist() == [[11, 12], [12, 14]]
    np.testing.assert_array_equal(found.position([11, 12, 14]), XYZ[[0, 1, 3]])


def test_a_line_at_a_node_without_a_sensor_is_refused(folder: Path) -> None:
    with pytest.raises(JobError) as caught:
        prepare(job_at(folder, "lines = [[1, 33]]\n" + GOOD))
    assert "lines: the test has no sensor or force at node 33; did you mean '3'?" in str(
        caught.value
    )
    with pytest.raises(JobError, match=r"match\.lines"):
        job_at(folder, "lines = [[1]]\n" + GOOD)


def test_lines_at_nodes_of_another_test_are_left_out() -> None:
    matching = updyn.match(frame(), named := rename())
    drawn = with_trace_lines(matching, [[11, 12, 99, 14]], {99}).frf
    assert drawn.geometry.lines.tolist() == [[11, 12]]
    np.testing.assert_array_equal(drawn.values, named.values)
    modes = updyn.modes(frame(), 2)
    measured_modes = updyn.ModeSet(modes.frequency, modes.shapes, frame().dofs)
    with pytest.raises(JobError, match="lines need measured FRFs"):
        with_trace_lines(updyn.match(frame(), measured_modes), [[11, 12]], ())


def rename() -> FRF:
    """Return FRFs in labels of the model, without a geometry."""
    labels = ["11:Y", "12:X", "14:Z"]
    return updyn.response(frame(), LINES, labels, labels[:1])
