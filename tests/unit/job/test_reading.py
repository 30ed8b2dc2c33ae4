"""What [test] selects is selected while the file is read, under the names that the reader knows too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.errors import JobError
from updyn.job import load_job, prepare

JOB = """\
[model]
file = "chain.h5"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
name = "output-error"
[test]
file = "{file}"
{test}
"""
FIRST = 10  # line of the first key of {test}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    updyn.write_model(chain.build(), tmp_path / "chain.h5")
    return tmp_path


def job_at(folder: Path, file: str, test: str) -> Any:
    (folder / "job.toml").write_text(JOB.format(file=file, test=test), encoding="utf-8")
    return load_job(folder / "job.toml")


def test_of_an_incomplete_universal_file_the_part_asked_for_is_read(folder: Path) -> None:
    data = chain.measure()
    first, last = (
        data.select(references=["2:X"]),
        data.select(responses=["5:X"], references=["12:X"]),
    )
    for name, part in (("a.uff", first), ("b.uff", last)):
        updyn.write_frf(part, folder / name)
    (folder / "test.uff").write_bytes(
        (folder / "a.uff").read_bytes() + (folder / "b.uff").read_bytes()
    )
    with pytest.raises(JobError, match="pairs of response / reference are missing"):
        prepare(job_at(folder, "test.uff", ""))
    frf = prepare(job_at(folder, "test.uff", 'responses = ["5:-X"]')).frf
    np.testing.assert_array_equal(
        frf.values, data.select(responses=["5:-X"], references=["2:X", "12:X"]).values
    )
    frf = prepare(job_at(folder, "test.uff", 'references = ["2:X"]')).frf
    np.testing.assert_array_equal(frf.values, first.values)


def test_labels_and_selection_of_a_bare_array(folder: Path) -> None:
    data = chain.measure()
    np.savez(folder / "test.npz", freq=data.freq, H=data.values, quantity=data.quantity)
    rows, columns = data.responses.labels, data.references.labels
    labels = f"response_labels = {rows}\nreference_labels = {columns}\n"
    frf = prepare(job_at(folder, "test.npz", labels + f'responses = ["{rows[1]}"]')).frf
    np.testing.assert_array_equal(frf.values, data.values[:, 1:2])


@pytest.mark.parametrize("file", ["test.npz", "test.uff", "references scale.npz"])
@pytest.mark.parametrize(
    ("test", "message"),
    [
        (
            'references = ["2:X"]\nresponses = ["5:X", "6:X"]',
            "responses: response 6:X is not among",
        ),
        ('responses = ["5:X"]\nreferences = ["3:X"]', "references: reference 3:X is not among"),
    ],
)
def test_what_is_not_there_is_named_with_its_line(
    folder: Path, file: str, test: str, message: str
) -> None:
    updyn.write_frf(chain.measure(), folder / file)
    with pytest.raises(JobError, match=rf"job\.toml:{FIRST + 1}: .*{message}"):
        prepare(job_at(folder, file, test))


def test_excluded_bands_are_not_used(folder: Path) -> None:
    data = chain.measure()
    updyn.write_frf(data, folder / "test.npz")
    low, high = data.freq[10] - 1e-6, data.freq[12] + 1e-6
    frf = prepare(job_at(folder, "test.npz", f"exclude = [[{low}, {high}]]")).frf
    rest = np.delete(np.arange(len(data.freq)), [10, 11, 12])
    np.testing.assert_array_equal(frf.freq, data.freq[rest])
    np.testing.assert_array_equal(frf.values, data.values[rest])


def test_an_excluded_band_without_a_line_is_named_with_its_line(folder: Path) -> None:
    updyn.write_frf(chain.measure(), folder / "test.npz")
    test = "band = [0.5, 20.0]\nexclude = [[1e4, 2e4]]"
    with pytest.raises(JobError, match=rf"job\.toml:{FIRST + 1}: .*holds no line that is used"):
        prepare(job_at(folder, "test.npz", test))


@pytest.mark.parametrize("key", ["duplicates", "scalar_direction", "quantity"])
def test_a_misspelt_option_of_the_reader_is_placed_at_its_key(folder: Path, key: str) -> None:
    updyn.write_frf(chain.measure(), folder / "test.uff")
    with pytest.raises(JobError, match=rf"job\.toml:{FIRST}: .*{key}"):
        prepare(job_at(folder, "test.uff", f'{key} = "misspelt"'))
