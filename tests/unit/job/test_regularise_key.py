"""`[method] regularise` of a job: what it does, and what it refuses, with lines."""

import json

import pytest

from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import load_job, run_job

JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = "all"
quantity = "stiffness"
[method]
name = "{}"
starts = 0
regularise = {}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("regularise")
    find_demo("chain").write_inputs(folder)
    return folder


@pytest.fixture
def job(folder):
    def make(value, method="maximum-likelihood"):
        path = folder / "job.toml"
        path.write_text(JOB.format(method, value))
        return path

    return make


@pytest.mark.parametrize("value", ['"gcv"', '"tsvd:3"', "2.0", "2"])
def test_a_job_is_regularised_and_its_folder_says_so(job, tmp_path, value):
    result = run_job(load_job(job(value)), tmp_path / "out").result
    told = json.loads((tmp_path / "out" / "result.json").read_text())
    record = result.options["regularisation"]
    assert (
        told["options"]["regularisation"]["how"]
        == record["how"]
        == {"2.0": "stated", "2": "stated"}.get(value, value.strip('"').partition(":")[0])
    )
    assert "Regularis" in told["message"]
    again = load_job(tmp_path / "out" / "job.toml")
    assert again.method.regularise == load_job(job(value)).method.regularise


@pytest.mark.parametrize(
    ("value", "method", "said"),
    [
        ('"gvc"', "maximum-likelihood", "regularise 'gvc': did you mean 'gcv'?"),
        ('"tsvd:0"', "maximum-likelihood", "'tsvd:N' with a whole number N"),
        ("0.0", "maximum-likelihood", "method.regularise = 0.0: expected 'gcv', 'l-curve'"),
        (
            "true",
            "log",
            "expected 'gcv', 'l-curve', 'discrepancy', 'tsvd', 'tsvd:N', or a strength above 0",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(job, value, method, said):
    with pytest.raises(JobError) as caught:
        load_job(job(value, method))
    assert said in str(caught.value)
    assert "job.toml:11: " in str(caught.value)


def test_a_method_that_cannot_be_regularised_is_refused_with_its_line(job):
    text = job('"gcv"', "response-function").read_text().replace("starts = 0\n", "")
    from updyn.updating.fit.methods import METHODS

    other = next(name for name in METHODS if not METHODS[name].can_regularise)
    path = job('"gcv"')
    path.write_text(text.replace("response-function", other))
    with pytest.raises(
        JobError, match=rf"job.toml:10: regularise: method '{other}' cannot be regularised"
    ):
        load_job(path)
