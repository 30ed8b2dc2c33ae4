"""`[selection]` of a job: what it does, what check says of it, and what it refuses, with lines."""

import json

import pytest

from updyn.cli import main
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import job_selection, load_job, prepare, run_job

JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = "all"
quantity = "stiffness"
[[parameter]]
groups = "all"
quantity = "mass"
[method]
name = "output-error"
max_iterations = 3
{}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("selection")
    find_demo("chain").write_inputs(folder)
    return folder


@pytest.fixture
def job(folder):
    def make(table):
        path = folder / "job.toml"
        path.write_text(JOB.format(table))
        return path

    return make


def test_without_the_table_all_are_fitted(job):
    assert job_selection(prepare(load_job(job("")))) is None


def test_a_number_of_them(job, tmp_path, capsys):
    path = job("[selection]\nn = 5\n")
    ready = prepare(load_job(path))
    chosen = job_selection(ready)
    assert (len(ready.parameters), len(chosen.parameters), len(chosen.left_out)) == (8, 5, 3)
    result = run_job(load_job(path), tmp_path / "out").result
    assert result.parameters.names == chosen.parameters.names
    told = json.loads((tmp_path / "out" / "result.json").read_text())
    assert told["options"]["selection"]["left out"] == dict(chosen.left_out)
    assert all(name in told["message"] for name in chosen.left_out)
    again = load_job(tmp_path / "out" / "job.toml")
    assert again.selection.n == 5
    assert job_selection(prepare(again)).parameters == chosen.parameters
    assert main(["check", str(path), "--verbose"]) == 0
    said = capsys.readouterr().out
    assert chosen.summary() in said
    assert "The data determine 5 of 5 unknowns" in said


def test_joined_and_chosen(job):
    chosen = job_selection(
        prepare(load_job(job("[selection]\ncluster = 0.5\nmax_collinearity = 2.0\n")))
    )
    assert chosen.merged
    assert chosen.collinearity <= 2.0
    assert len(job_selection(prepare(load_job(job('[selection]\nn = "rank"\n')))).parameters) == 8


@pytest.mark.parametrize(
    ("table", "line", "said"),
    [
        (
            "[selection]",
            14,
            "expected cluster, n or max_collinearity; leave [selection] out to fit all unknowns",
        ),
        (
            "[selection]\nn = 0",
            15,
            "selection.n = 0: expected a whole number of at least 1, or 'rank'",
        ),
        ("[selection]\nn = 'all'", 15, "expected a whole number of at least 1, or 'rank'"),
        ("[selection]\ncluster = 1.0", 15, "expected a cosine between 0 and 1, such as 0.99"),
        ("[selection]\nmax_collinearity = 0.9", 15, "expected a number of at least 1"),
        (
            "[selection]\nn = 3\nmax_collinearity = 9.0",
            14,
            "n and max_collinearity are alternatives",
        ),
        (
            "[selection]\nclusters = 0.9",
            15,
            "unknown key 'clusters' in [selection]; did you mean 'cluster'?",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(job, table, line, said):
    with pytest.raises(JobError) as caught:
        load_job(job(table + "\n"))
    assert said in str(caught.value)
    assert f"job.toml:{line}: " in str(caught.value)


def test_more_than_there_are_is_refused_with_its_line(job):
    with pytest.raises(
        JobError, match=r"job.toml:15: select: n = 9: expected a whole number from 1 to 8"
    ):
        job_selection(prepare(load_job(job("[selection]\nn = 9\n"))))
