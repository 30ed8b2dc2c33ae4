"""FRFs in one file per measurement point: equal to those of one file."""

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.errors import FormatError, OptionError
from updyn.io.point_files import propose_pattern
from updyn.job.folder import _list_inputs
from updyn.job.load import load_job
from updyn.job.prepare import read_measurement

SENSORS = ["2:X", "5:X", "12:X"]
COLUMNS = {
    "frequency": 1,
    "channels": [{"response": "{node}:{axis}", "reference": "5:X", "real": 2, "imaginary": 3}],
}


@pytest.fixture(scope="module")
def frf(chain12_true):
    return updyn.response(chain12_true, np.linspace(1.0, 20.0, 7), SENSORS, ["5:X"], "accelerance")


@pytest.fixture
def folder(tmp_path, frf):
    """A table of three columns for each sensor, and a file of notes."""
    for i, dof in enumerate(frf.responses):
        H = frf.values[:, i, 0]
        table = np.column_stack([frf.freq, H.real, H.imag])
        np.savetxt(tmp_path / f"point_{dof.node}{dof.direction}.txt", table, fmt="%.17g")
    (tmp_path / "point_notes.txt").write_text("two accelerometers were exchanged\n")
    return tmp_path


def read(folder, name="point_{node}{axis}.txt", **options):
    given = {"quantity": "accelerance", "columns": COLUMNS} | options
    return updyn.read_frf(folder / name, **given)


def test_files_are_joined_by_the_labels_in_their_names(folder, frf):
    found = read(folder)
    assert found.responses.labels == SENSORS  # by number: 12 after 5
    assert found.references.labels == ["5:X"]
    assert found.quantity == "accelerance"
    np.testing.assert_array_equal(found.values, frf.values)


def test_a_selection_of_responses(folder, frf):
    found = read(folder, responses=["12:-X", "2:X"])
    np.testing.assert_array_equal(found.values, frf.values[:, [2, 0]] * [[[-1.0], [1.0]]])


def test_files_with_labels_need_no_field_in_the_options(tmp_path, frf):
    for i, label in enumerate(SENSORS):
        updyn.write_frf(frf.select(responses=[label]), tmp_path / f"run_{i + 9}.csv")
    found = updyn.read_frf(tmp_path / "run_{number}.csv")
    assert found.responses.labels == SENSORS
    np.testing.assert_array_equal(found.values, frf.values)


def test_arrays_of_other_names(tmp_path, frf):
    for i, dof in enumerate(frf.responses):
        np.savez(tmp_path / f"run{dof.node}.npz", f=frf.freq, frf=frf.values[:, i, 0])
    channel = {"response": "{node}:X", "reference": "5:X", "complex": "frf"}
    variables = {"freq": "f", "channels": [channel]}
    path = tmp_path / "run{node}.npz"
    found = updyn.read_frf(path, quantity="accelerance", variables=variables)
    assert found.responses.labels == SENSORS
    np.testing.assert_array_equal(found.values, frf.values)


def test_the_command_line_reads_them(folder, capsys):
    columns = COLUMNS["channels"][0]
    channel = ", ".join(f"{k} = {v!r}" for k, v in columns.items())
    option = f"columns = {{frequency = 1, channels = [{{{channel}}}]}}"
    name = str(folder / "point_{node}{axis}.txt")
    assert (
        main(["info", name, "--test-option", option, "--test-option", "quantity='mobility'"]) == 0
    )
    assert "3 responses: 2:X, 5:X, 12:X" in capsys.readouterr().out


def test_a_file_whose_name_has_braces_is_read_itself(tmp_path, frf):
    updyn.write_frf(frf, tmp_path / "run_{number}.csv")
    np.testing.assert_array_equal(updyn.read_frf(tmp_path / "run_{number}.csv").values, frf.values)


def test_sign_and_case_in_names(tmp_path, frf):
    H = frf.values[:, 0, 0]
    np.savetxt(tmp_path / "p2-x.txt", np.column_stack([frf.freq, H.real, H.imag]), fmt="%.17g")
    found = read(tmp_path, "p{node}{axis}.txt")
    assert found.responses.labels == ["2:-X"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hit_{node}.txt", r"no file has such a name; .* did you mean 'point_"),
        ("point_{node}{node}.txt", r"field \{node\} occurs twice"),
    ],
)
def test_names_that_fit_nothing(folder, name, message):
    with pytest.raises(FormatError, match=message):
        read(folder, name)


def test_an_unknown_field_of_an_option(folder):
    with pytest.raises(OptionError, match=r"response: DOF '\{node\}:X'"):
        read(folder, "point_{number}{axis}.txt")


def test_an_invalid_file_is_named(folder):
    (folder / "point_7X.txt").write_text("1 2 3\n2 x 3\n")
    with pytest.raises(FormatError, match=r"point_7X\.txt"):
        read(folder)


def test_files_with_other_lines_are_named(folder):
    np.savetxt(folder / "point_7X.txt", np.ones((3, 3)).cumsum(axis=0))
    with pytest.raises(FormatError, match=r"point_7X\.txt has 3 lines .* point_2X\.txt 7 lines"):
        read(folder)


def test_a_job_reads_them_and_lists_each_as_input(folder, chain12, frf):
    updyn.write_model(chain12, folder / "model.h5")
    (folder / "job.toml").write_text(
        """
[model]
file = "model.h5"

[test]
file = "point_{node}{axis}.txt"
quantity = "accelerance"
columns = { frequency = 1, channels = [
  { response = "{node}:{axis}", reference = "5:X", real = 2, imaginary = 3 },
] }

[[parameter]]
quantity = "stiffness"
groups = ["all"]
"""
    )
    job = load_job(folder / "job.toml")
    np.testing.assert_array_equal(read_measurement(job).values, frf.values)
    names = {path.name for path, kind in _list_inputs(job).items() if kind == "measurement"}
    assert names == {"point_2X.txt", "point_5X.txt", "point_12X.txt"}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["hit_2X.txt", "hit_10-RZ.txt", "hit.txt"], "hit_{node}{axis}.txt"),
        (["run3_point 1.csv", "run3_point 2.csv", "run4_point 1.csv"], "run3_point {node}.csv"),
        (["test_1.csv", "other_2.csv"], None),
        (["a.csv", "b.csv"], None),
    ],
)
def test_a_name_with_fields_is_proposed_for_files_that_differ_by_a_point(tmp_path, names, expected):
    for name in names:
        (tmp_path / name).write_text("")
    found = propose_pattern(tmp_path / names[0])
    assert found == (None if expected is None else tmp_path / expected)
