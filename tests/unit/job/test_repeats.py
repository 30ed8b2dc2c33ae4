"""A job whose test was measured several times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.errors import JobError
from updyn.job import load_job, prepare, run_job

JOB = """\
[model]
file = "in/chain.h5"
[test]
file = "in/run1.npz"
repeats = {repeats}
{test}
[[parameter]]
groups = "part*"
quantity = "stiffness"
[output]
report = false
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    updyn.write_model(chain.build(), tmp_path / "in" / "chain.h5")
    clean, rng = chain.measure(), np.random.default_rng(0)
    for number in (1, 2, 3):
        e = 0.01 * (
            rng.standard_normal(clean.values.shape) + 1j * rng.standard_normal(clean.values.shape)
        )
        updyn.write_frf(
            replace(clean, values=clean.values * (1 + e)), tmp_path / "in" / f"run{number}.npz"
        )
    return tmp_path


def job_at(folder: Path, repeats: str = '["in/run2.npz", "in/run3.npz"]', test: str = "") -> Path:
    path = folder / "job.toml"
    path.write_text(JOB.format(repeats=repeats, test=test), encoding="utf-8")
    return path


def test_the_mean_is_fitted_with_its_variance(folder: Path) -> None:
    ready = prepare(load_job(job_at(folder, test="band = [2.0, 10.0]")))
    mean = updyn.average([updyn.read_frf(folder / f"in/run{n}.npz") for n in (1, 2, 3)]).select(
        band=(2.0, 10.0)
    )
    np.testing.assert_array_equal(ready.frf.values, mean.values)
    np.testing.assert_array_equal(ready.frf.variance, mean.variance)


def test_the_job_that_a_run_leaves_runs_again(folder: Path) -> None:
    out = folder / "deep" / "out"
    first = run_job(load_job(job_at(folder)), out).result
    assert first.noise["kind"] == "variance"
    again = run_job(load_job(out / "job.toml"), folder / "again").result
    assert again.values == first.values


def test_a_run_never_writes_over_a_repeat(folder: Path) -> None:
    (folder / "in" / "run2.npz").rename(folder / "in" / "run.nc")
    with pytest.raises(JobError, match=r"overwrite its measurement '.*run\.nc'"):
        run_job(load_job(job_at(folder, '["in/run.nc"]')), folder / "in")


@pytest.mark.parametrize(
    ("repeats", "test", "message"),
    [
        (
            '["in/run4.npz"]',
            "",
            r"job\.toml:5: test\.repeats = 'in/run4\.npz': no such file; .*run3\.npz",
        ),
        ('["in/run1.npz"]', "", r"job\.toml:5: average: repeats 1 and 2 hold the same values"),
        ('"in/run2.npz"', "", r"job\.toml:5: test\.repeats = 'in/run2\.npz'"),
        ("[]", "", r"job\.toml:5: test\.repeats"),
        (
            '["in/run2.npz"]',
            "averages = 4",
            r"job\.toml:6: test\.averages: with repeats the variance comes from them",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_line(
    folder: Path, repeats: str, test: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        prepare(load_job(job_at(folder, repeats, test)))


def test_repeats_have_to_agree(folder: Path) -> None:
    frf = updyn.read_frf(folder / "in/run2.npz")
    updyn.write_frf(frf.select(lines=frf.freq[1:]), folder / "in/run2.npz")
    with pytest.raises(
        JobError, match=r"job\.toml:5: average: repeat 2 has \d+ lines, the first \d+"
    ):
        prepare(load_job(job_at(folder)))
