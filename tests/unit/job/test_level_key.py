"""`level` and `sweep` of ``[test]``."""

from pathlib import Path

import pytest

import updyn
from updyn.demos import chain
from updyn.errors import JobError
from updyn.job import load_job
from updyn.job.prepare import read_measurement

JOB = """\
[model]
file = "chain.h5"
[test]
file = "run.npz"
{test}
[[parameter]]
groups = "part*"
quantity = "stiffness"
"""


def read(folder: Path, test: str, frf: updyn.FRF | None = None) -> updyn.FRF:
    updyn.write_frf(frf or chain.measure(), folder / "run.npz")
    path = folder / "job.toml"
    path.write_text(JOB.format(test=test), encoding="utf-8")
    job = load_job(path)
    with job.located():
        return read_measurement(job)


def test_the_job_states_level_and_sweep(tmp_path: Path) -> None:
    frf = read(tmp_path, 'level = 5.0\nsweep = "down"')
    assert set(frf.level) == {5.0}
    assert frf.sweep == "down"


def test_the_file_states_the_level(tmp_path: Path) -> None:
    known = chain.measure().with_level(5.0)
    assert set(read(tmp_path, "", known).level) == {5.0}
    assert read(tmp_path, 'sweep = "up"', known).sweep == "up"
    assert read(tmp_path, "level = 5.0", known.with_level(5.0, "up")).sweep == "up"


@pytest.mark.parametrize(
    ("test", "text"),
    [
        ("level = 4.0", r"job.toml:5: test.level = 4.0, but run.npz states the level 5 N up"),
        ('level = 5.0\nsweep = "down"', r"job.toml:6: test.sweep = 'down', but run.npz states"),
        ("level = 0.0", r"job.toml:5: test.level"),
        ('sweep = "upward"', r"job.toml:5: test.sweep"),
    ],
)
def test_contradictions_are_refused(tmp_path: Path, test: str, text: str) -> None:
    with pytest.raises(JobError, match=text):
        read(tmp_path, test, chain.measure().with_level(5.0, "up"))


def test_a_sweep_without_a_level_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"job.toml:5: sweep: given without a level"):
        read(tmp_path, 'sweep = "up"')
