"""A line at 0 Hz: left out with one warning if the model is free, fitted if it is held."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.dynamics import zero_line
from updyn.dynamics.zero_line import leave_out_zero_line
from updyn.errors import JobError, SolverError, UpdynWarning
from updyn.job import load_job, prepare, run_job
from updyn.updating.update import identifiability

FREQ = np.r_[0.0, np.linspace(2.0, 30.0, 30)]
TEXT = "the line at 0 Hz is left out: the model is free, and its response there is not defined"


def chain(ground: float = 0.0, factor: float = 1.0) -> updyn.Model:
    """Four masses of 1 kg and three springs in two groups; `ground` (N/m) holds the first."""
    K, rest = np.zeros((4, 4)), np.zeros((4, 4))
    for i, (matrix, k) in enumerate([(K, 1e4 * factor), (rest, 1e4), (rest, 1e4)]):
        matrix[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    rest[0, 0] += ground
    groups = {
        "a": updyn.Group(K, 0.5 * np.eye(4), loss_factor=0.03),
        "b": updyn.Group(rest, 0.5 * np.eye(4), loss_factor=0.03),
    }
    return updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 5)])


def measure(ground: float = 0.0, quantity: str = "accelerance") -> updyn.FRF:
    """FRFs of the chain with a stiffer group, from 0 Hz; rigid-body accelerance if it is free."""
    start = 0 if ground else 1
    frf = updyn.response(
        chain(ground, 1.2), FREQ[start:], ["1:X", "3:X"], ["1:X"], quantity=quantity
    )
    values = frf.values if ground else np.concatenate([np.full((1, 2, 1), 0.25), frf.values])
    noise = np.random.default_rng(4).standard_normal((2, *values.shape))
    return replace(frf, freq=FREQ, values=values * (1.0 + 0.01 * (noise[0] + 1j * noise[1])))


def unknowns() -> updyn.ParameterSet:
    return updyn.parameters(chain(), stiffness="all")


CALLS: dict[str, Callable[[updyn.FRF], object]] = {
    "update": lambda frf: updyn.update(chain(), frf, unknowns()),
    "diagnose": lambda frf: updyn.diagnose(chain(), frf, unknowns()),
    "identifiability": lambda frf: identifiability(chain(), frf, unknowns()),
    "select": lambda frf: updyn.select(chain(), frf, unknowns(), 1),
    "compare": lambda frf: updyn.compare(chain(), frf, unknowns(), ["log", "output-error"]),
    "correlate": lambda frf: updyn.correlate(chain(), frf),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_free_model_warns_once(name: str) -> None:
    with pytest.warns(UpdynWarning) as caught:
        CALLS[name](measure())
    assert [str(one.message) for one in caught] == [TEXT]


@pytest.mark.parametrize("lines", [None, FREQ[::2], "d-optimal:10"])
@pytest.mark.parametrize("tier", [None, "reduced"])
def test_the_fit_is_that_without_the_line(lines, tier) -> None:
    frf = measure()
    with pytest.warns(UpdynWarning, match="at 0 Hz is left out"):
        found = updyn.update(chain(), frf, unknowns(), lines=lines, tier=tier)
    others = lines[1:] if isinstance(lines, np.ndarray) else lines
    expected = updyn.update(
        chain(), frf.select(lines=FREQ[1:]), unknowns(), lines=others, tier=tier
    )
    assert found.values == expected.values
    assert found.frf.freq[0] == FREQ[1]
    np.testing.assert_array_equal(found.lines, expected.lines)


def test_the_warning_names_the_free_test_of_two() -> None:
    tests = [
        updyn.Test(chain(), measure(), name="free"),
        updyn.Test(chain(5e3), measure(5e3), name="held"),
    ]
    with pytest.warns(UpdynWarning) as caught:
        found = updyn.update_jointly(tests, unknowns())
    assert [str(one.message) for one in caught] == [f"test 'free': {TEXT}"]
    assert [one.lines[0] for one in found.results.values()] == [FREQ[1], 0.0]


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_a_held_model_keeps_the_line(quantity: str) -> None:
    frf = measure(5e3, quantity)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UpdynWarning)
        assert leave_out_zero_line(chain(5e3), frf) is frf
        assert updyn.correlate(chain(5e3), frf).measured.freq[0] == 0.0


def test_an_exponential_window_defines_the_response_at_rest() -> None:
    """With a decay, the line at 0 Hz is the response at s = decay, which a free model has."""
    frf = replace(measure(), decay=2.0)
    assert leave_out_zero_line(chain(), frf) is frf


def test_short_memory_is_not_a_free_model(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise SolverError("not enough memory") from MemoryError()

    monkeypatch.setattr(zero_line, "response_like", fail)
    frf = measure()
    assert leave_out_zero_line(chain(), frf) is frf


# -- a job -----------------------------------------------------------------------------------------
JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "*"
quantity = "stiffness"
[output]
report = false
"""


def write_job(folder: Path, more: str = "") -> Path:
    updyn.write_model(chain(), folder / "chain.h5")
    updyn.write_frf(measure(), folder / "chain.npz")
    path = folder / "job.toml"
    path.write_text(JOB + more, encoding="utf-8")
    return path


def test_a_job_leaves_the_line_out_with_one_note(tmp_path: Path) -> None:
    job = load_job(write_job(tmp_path))
    with pytest.warns(UpdynWarning) as caught:
        ready = prepare(job)
    assert [str(one.message) for one in caught] == [TEXT]
    assert ready.frf.freq[0] == FREQ[1]
    with pytest.warns(UpdynWarning) as caught:
        found = run_job(job)
    assert [str(one.message) for one in caught] == [TEXT]
    assert found.result.status == "converged"


def test_a_job_whose_lines_name_it_is_refused(tmp_path: Path) -> None:
    job = load_job(write_job(tmp_path, "[method]\nlines = [0.0, 2.0]\n"))
    with (
        pytest.warns(UpdynWarning, match="at 0 Hz is left out"),
        pytest.raises(JobError, match="line 0 Hz is not in the data"),
    ):
        prepare(job)
