"""Tables of natural frequencies: tests by line, modes by line, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.errors import AbsentError, FormatError, OptionError, UpdynWarning
from updyn.modal import ModeSet

TESTS = """# three assemblies of one structure, Hz
10.0,20.0,nan,40.0
10.2,,30.0,40.6
10.4,20.4,nan,nan
"""


def file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "modes.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_several_tests_are_their_mean_with_its_deviation(tmp_path: Path) -> None:
    found = updyn.read_modes(file(tmp_path, TESTS))
    assert found.frequency == pytest.approx([10.2, 20.2, 30.0, 40.3])
    # Standard deviation of the mean: of n values s / sqrt(n), n - 1 in s.
    expected = [0.2 / np.sqrt(3.0), 0.2, np.nan, 0.3]
    assert found.std_frequency == pytest.approx(expected, nan_ok=True)
    # Few tests have two modes in common: the means are taken as independent.
    assert found.cov_frequency[:2, :2] == pytest.approx(np.diag(found.std_frequency[:2] ** 2))
    assert not found.has_shapes
    assert found.source == "modes.csv, mean of up to 3 of 3 tests"


def test_one_test_and_some_modes_are_chosen_by_their_numbers(tmp_path: Path) -> None:
    path = file(tmp_path, TESTS)
    assert updyn.read_modes(path, test=2).frequency.tolist() == [10.2, 30.0, 40.6]
    assert updyn.read_modes(path, test=1, modes=[1, 4]).frequency.tolist() == [10.0, 40.0]
    with pytest.raises(OptionError, match="test=4: expected a number from 1 to 3"):
        updyn.read_modes(path, test=4)
    with pytest.raises(OptionError, match="no test found mode 3"):
        updyn.read_modes(path, test=1, modes=[1, 3])
    for wrong in ([0], [5], [1, 1], [], "1", [1.0]):
        with pytest.raises(OptionError, match="expected numbers from 1 to 4, each once"):
            updyn.read_modes(path, modes=wrong)


def test_a_single_column_is_one_test(tmp_path: Path) -> None:
    found = updyn.read_modes(file(tmp_path, "15.57\n44.70\n70.72\n"))
    assert found.frequency.tolist() == [15.57, 44.70, 70.72]
    assert np.isnan(found.std_frequency).all()


def test_a_header_makes_lines_modes_with_units(tmp_path: Path) -> None:
    text = "frequency [kHz];std_frequency [Hz];damping [%]\n0,012;0,1;0,5\n0,0305;;\n"
    found = updyn.read_modes(file(tmp_path, text))
    assert found.frequency == pytest.approx([12.0, 30.5])
    assert found.std_frequency == pytest.approx([0.1, np.nan], nan_ok=True)
    assert found.loss_factor == pytest.approx([0.01, np.nan], nan_ok=True)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    modes = ModeSet(
        [3.0, 4.5],
        loss_factor=[0.01, np.nan],
        std_frequency=[0.1, 0.2],
        std_loss_factor=[0.001, np.nan],
    )
    path = tmp_path / "modes.csv"
    updyn.write_modes(modes, path)
    assert updyn.read_modes(path).digest == modes.digest


def test_the_covariance_of_frequencies_is_written_and_read_back(tmp_path: Path) -> None:
    covariance = [[0.04, 0.01, np.nan], [0.01, 0.09, np.nan], [np.nan] * 3]
    modes = ModeSet([3.0, 4.5, 7.0], cov_frequency=covariance)
    path = tmp_path / "modes.csv"
    updyn.write_modes(modes, path)
    assert updyn.read_modes(path).digest == modes.digest
    assert updyn.read_modes(path, modes=[2]).cov_frequency.tolist() == [[0.09]]
    text = "frequency [kHz],cov_frequency_2,cov_frequency_1 [kHz^2]\n0.01,0.2,1e-6\n0.03,4,2e-7\n"
    found = updyn.read_modes(file(tmp_path, text))
    assert found.cov_frequency == pytest.approx(np.array([[1.0, 0.2], [0.2, 4.0]]))
    wrong = file(tmp_path, text.replace("_2,", "_3,"))
    with pytest.raises(FormatError, match=r"modes.csv:1: header: 2 columns of the covaria"):
        updyn.read_modes(wrong)
    wrong = file(tmp_path, text.replace("kHz^2", "kHz"))
    with pytest.raises(FormatError, match="unit 'kHz' of 'cov_frequency_1'; expected the square"):
        updyn.read_modes(wrong)


def test_a_universal_file_leaves_the_covariance_out_with_a_warning(tmp_path: Path) -> None:
    covariance = [[1.0, 0.5], [0.5, 1.0]]
    modes = ModeSet([3.0, 4.0], np.eye(2), ["1:X", "2:X"], cov_frequency=covariance)
    with pytest.warns(UpdynWarning, match="covariance of the frequencies is not written"):
        updyn.write_modes(modes, tmp_path / "modes.uff")


def test_shapes_and_tables_do_not_go_together(tmp_path: Path) -> None:
    shaped = ModeSet([3.0], [[1.0]], ["1:X"])
    with pytest.raises(FormatError, match="a table cannot hold mode shapes"):
        updyn.write_modes(shaped, tmp_path / "modes.csv")
    with pytest.raises(FormatError, match="these modes have none; write a table"):
        updyn.write_modes(ModeSet([3.0]), tmp_path / "modes.uff")
    with pytest.raises(AbsentError, match="a table of natural frequencies"):
        updyn.read_frf(file(tmp_path, TESTS))
    with pytest.raises(AbsentError, match="column 'node'; expected columns of natural frequencies"):
        updyn.read_modes(file(tmp_path, "node,x,y,z\n1,0,0,0\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("10,11,12\n1,2\n", r"modes\.csv:2: 2 cells; expected 3"),
        ("10 11 12\n", "'10 11 12' is not a number; cells are separated by commas"),
        ("freqency,damping\n1,2\n", "column 'freqency'; did you mean 'frequency'"),
        ("frequency [m]\n1\n", r"unit 'm' of 'frequency'; expected a unit of frequency"),
        ("frequency,damping [dB]\n1,2\n", "unit 'dB' of 'damping'; expected '%' or none"),
        ("frequency,damping\n1,0.5\n2,1.5\n", r":3: damping 1.5 is at .* column 'damping \[%\]'"),
        ("frequency,loss_factor\n1,1.9\n2,2\n", ":3: loss_factor 2 is at .* critical"),
        ("damping,std_damping\n1,2\n", "'frequency' is missing"),
        ("frequency,damping,loss_factor\n1,2,3\n", "damping and loss factors; state one of them"),
        ("frequency,frequency\n1,2\n", "'frequency' occurs twice"),
        ("frequency\n", "a header without lines of numbers"),
        ("# unit: kHz\n1,2\n", "'unit' would change the numbers"),
        ("1,2", "does not end: the file may be truncated"),
        ("nan,nan\n", "no test found a mode"),
        ("1,-2\n", "-2"),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        updyn.read_modes(file(tmp_path, text))
