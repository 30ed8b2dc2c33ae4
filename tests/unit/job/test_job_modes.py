"""``[test] modes``: measured modes of a file, matched as the sensors are; what is refused, with its line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import updyn
from op2_samples import Writer
from updyn.demos import chain
from updyn.errors import JobError
from updyn.job import load_job, prepare, run_job
from updyn.job.comparison import compare_job
from updyn.modal import ModeSet

JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.uff"
modes = "modes.unv"
{test}
[[parameter]]
groups = ["part*"]
quantity = "stiffness"
[method]
name = "{method}"
{tier}
{match}
[output]
report = false
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    chain.write_inputs(folder)
    return folder


@pytest.fixture
def folder(inputs: Path, tmp_path: Path) -> Path:
    for file in inputs.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path


def put(
    folder: Path, method: str = "modal", test: str = "", match: str = "", tier: str = ""
) -> Path:
    path = folder / "modal.toml"
    text = JOB.format(method=method, test=test, match=match, tier=tier)
    path.write_text(text, encoding="utf-8")
    return path


def modes_of(folder: Path, factor: float, dofs: list[str] | None = None) -> ModeSet:
    """The six lowest modes of the start with all stiffness times a factor, which modes of shape alone do not see."""
    found = updyn.modes(updyn.read_model(folder / "chain.h5"), 6)
    at = dofs or list(updyn.read_frf(folder / "chain.uff").responses.labels)
    return ModeSet(found.frequency * np.sqrt(factor), found.at(at), at)


def test_modes_of_a_file_are_fitted(folder: Path) -> None:
    updyn.write_modes(modes_of(folder, 1.21), folder / "modes.unv")
    result = run_job(load_job(put(folder)), folder / "out").result
    assert isinstance(result, updyn.UpdateResult)
    # All four parts alike; the format keeps six digits.
    assert list(result.values.values()) == pytest.approx([1.21] * 4, rel=1e-3)
    assert result.options["modes"].source == "modes.unv"
    again = load_job(folder / "out" / "job.toml")
    assert again.test.modes == "../modes.unv"
    assert len(prepare(again).modes[""]) == 6


def test_modes_are_fitted_in_a_reduced_model(folder: Path) -> None:
    updyn.write_modes(modes_of(folder, 1.21), folder / "modes.unv")
    job = (
        put(folder, tier='tier = "reduced"', test="").read_text().replace('file = "chain.uff"', "")
    )
    (folder / "modal.toml").write_text(job, encoding="utf-8")
    result = run_job(load_job(folder / "modal.toml"), folder / "out").result
    assert list(result.values.values()) == pytest.approx([1.21] * 4, rel=1e-3)
    assert result.options["tier"] == "reduced"


def test_the_band_and_the_match_are_those_of_the_sensors(folder: Path) -> None:
    """In the file of modes sensor 12 is called 99, and it points the other way."""
    frf = updyn.read_frf(folder / "chain.uff")
    labels = [str(d) for d in frf.responses]
    renamed = ["99:-X" if label == "12:X" else label for label in labels]
    references = ["99:-X" if str(d) == "12:X" else str(d) for d in frf.references]
    sign = np.array([-1.0 if "99" in label else 1.0 for label in renamed])
    turned = np.array([-1.0 if "99" in label else 1.0 for label in references])
    values = frf.values * sign[:, None] * turned
    updyn.write_frf(
        updyn.FRF(frf.freq, values, renamed, references, frf.quantity), folder / "chain.uff"
    )
    modes = modes_of(folder, 1.1, labels)
    updyn.write_modes(
        ModeSet(modes.frequency, modes.shapes * sign[:, None], renamed), folder / "modes.unv"
    )
    match = '[match.table]\n"99:X" = "12:X"'
    prepared = prepare(load_job(put(folder, test="band = [0.5, 12.0]", match=match)))
    got = prepared.modes[""]
    assert got.frequency == pytest.approx(modes.frequency[modes.frequency <= 12.0], rel=1e-5)
    assert sorted(got.dofs.labels) == sorted(labels)
    order = got.dofs.match(labels)
    expected = modes.shapes[:, : len(got)]
    assert got.shapes[order.index] * order.sign[:, None] == pytest.approx(
        expected, rel=1e-4, abs=1e-4
    )


def test_a_comparison_gives_them_to_the_method_that_takes_them(folder: Path) -> None:
    updyn.write_modes(modes_of(folder, 1.21), folder / "modes.unv")
    found = compare_job(
        load_job(put(folder, "output-error")), folder / "out", methods=["modal", "output-error"]
    )
    values = {row.method: row.values for row in found.rows}
    assert list(values["modal"].values()) == pytest.approx([1.21] * 4, rel=1e-3)
    assert list(values["output-error"].values()) != pytest.approx(
        [1.21] * 4, rel=1e-3
    )  # the FRFs are of another chain


@pytest.mark.parametrize(
    ("method", "test", "message"),
    [
        ("log", "", r":5: test.modes: method 'log' fits FRFs and takes no modes; leave them out"),
        (
            "modal",
            "band = [0.5, 0.7]",
            r":6: modes: the selection contains no mode of ModeSet\(6 modes",
        ),
    ],
)
def test_what_is_refused(folder: Path, method: str, test: str, message: str) -> None:
    updyn.write_modes(modes_of(folder, 1.0), folder / "modes.unv")
    with pytest.raises(JobError, match=message):
        run_job(load_job(put(folder, method, test)), folder / "out")
    assert not (folder / "out").exists()


def op2_of(folder: Path) -> None:
    """Write modes of nodes 2 and 3 in a deck of mm, N and t, unit modal mass in t."""
    out = Writer()
    out.head()
    shape = {2: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 3: [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]}
    out.shapes([(1, (2.0 * np.pi * 5.0) ** 2, shape)])
    out.eigenvalues([(1, (2.0 * np.pi * 5.0) ** 2, 1.0)])
    (folder / "modes.unv").write_bytes(out.bytes())


def test_options_of_the_reader_of_modes(folder: Path) -> None:
    op2_of(folder)
    test = "modes_reader = { format = 'op2', unit = 'mm' }"
    modes = prepare(load_job(put(folder, test=test))).modes[""]
    assert modes.frequency == pytest.approx([5.0], rel=1e-6)
    # A modal mass of 1 t for a shape of 1: 1 kg for one of 1 / sqrt(1000).
    assert sorted(modes.shapes[:, 0]) == pytest.approx([0.5 / np.sqrt(1e3), 1 / np.sqrt(1e3)])


@pytest.mark.parametrize(
    ("test", "message"),
    [
        ("modes_reader = { format = 'op2', units = 'mm' }", r":6: .*did you mean 'unit'"),
        ("modes_reader = { format = 'op2', unit = 'cm' }", r":6: .*unit 'cm'"),
        ("modes_reader = { format = 'op2', subcase = 4 }", r":6: .*no modes of subcase 4"),
    ],
)
def test_options_of_the_reader_of_modes_that_are_refused(
    folder: Path, test: str, message: str
) -> None:
    op2_of(folder)
    with pytest.raises(JobError, match=message):
        prepare(load_job(put(folder, test=test)))


def test_options_of_the_reader_of_modes_without_modes(folder: Path) -> None:
    path = put(folder, test="modes_reader = { unit = 'mm' }")
    path.write_text(path.read_text().replace('modes = "modes.unv"\n', ""))
    with pytest.raises(JobError, match=r":5: test.modes_reader belongs to a file of modes"):
        load_job(path)


def test_no_such_file_or_dof(folder: Path) -> None:
    with pytest.raises(JobError, match=r":5: test.modes = 'modes.unv': no such file"):
        prepare(load_job(put(folder)))
    modes = modes_of(folder, 1.0)
    updyn.write_modes(ModeSet(modes.frequency, modes.shapes[:1], ["77:X"]), folder / "modes.unv")
    with pytest.raises(JobError, match=r":5: DOF of the modes 77:X is not among the 12 DOFs"):
        prepare(load_job(put(folder)))
    shutil.copy(folder / "chain.uff", folder / "modes.unv")
    with pytest.raises(JobError, match=r":5: .*modes.unv: holds no modes \(dataset 55"):
        prepare(load_job(put(folder)))
