"""`level` and `sweep` of ``[test]``."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

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


def test_the_job_states_a_random_force(tmp_path: Path) -> None:
    frf = read(tmp_path, 'level = 5.0\nexcitation = "random"')
    assert frf.is_random
    assert frf.spectrum[:, 0].tolist() == frf.freq[[0, -1]].tolist()
    shaped = 'excitation = "random"\nspectrum = [[0.1, 2.0], [30.0, 2.0]]'
    assert read(tmp_path, shaped).level[0] == pytest.approx(59.8**0.5)
    narrow = read(tmp_path, 'level = 5.0\nexcitation = "random"\nband = [2.0, 10.0]')
    assert narrow.spectrum.tolist() == frf.spectrum.tolist()


@pytest.mark.parametrize(
    ("test", "text"),
    [
        ('excitation = "random"', "job.toml:5: excitation: given without a level"),
        ('excitation = "noise"', "job.toml:5: test.excitation"),
        ("spectrum = [[1.0, 2.0]]", "job.toml:5: test.spectrum"),
        ("spectrum = [[1.0, 2.0], [0.0, 2.0]]", "job.toml:5: spectrum: expected finite"),
        ("spectrum = [[1.0, 2.0], [3.0, 2.0]]", "job.toml:5: spectrum: only of a random force"),
    ],
)
def test_forces_are_checked(tmp_path: Path, test: str, text: str) -> None:
    with pytest.raises(JobError, match=text):
        read(tmp_path, test)


def test_records_state_the_force(tmp_path: Path) -> None:
    """The spectrum of the force channel, also outside of the band of the lines."""
    force = np.random.default_rng(0).standard_normal(1024)
    columns = np.stack([force, 0.1 * force, 0.2 * force], axis=1)
    savemat(tmp_path / "noise.mat", {"data": columns})
    records = """
[records]
file = "noise.mat"
reader = { values = "data", channels = ["hammer", "1:Z", "2:Z"], order = ["time", "channel"], rate = 512 }
units = { hammer = "N", "1:Z" = "m", "2:Z" = "m" }
excitation = { hammer = "1:Z" }
segment = 0.25
band = [20, 80]
"""
    path = tmp_path / "job.toml"
    text = JOB.replace('file = "run.npz"', "").format(test='excitation = "random"') + records
    path.write_text(text, encoding="utf-8")
    frf = read_measurement(load_job(path))
    assert frf.freq[-1] == 80.0
    assert frf.spectrum[-1, 0] == 256.0
    assert frf.level[0] == pytest.approx(1.0, rel=0.1)


def test_another_force_than_that_of_the_file_is_refused(tmp_path: Path) -> None:
    known = chain.measure().with_level(5.0, excitation="random")
    with pytest.raises(JobError, match=r"test.excitation = 'sine', but run.npz states the level 5"):
        read(tmp_path, 'excitation = "sine"', known)
    with pytest.raises(JobError, match=r"test.spectrum = .*, but run.npz states the level 5"):
        read(tmp_path, "spectrum = [[1.0, 2.0], [3.0, 2.0]]", known)
