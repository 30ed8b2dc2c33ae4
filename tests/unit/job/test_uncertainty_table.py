"""`[uncertainty]` of a job: what it writes and shows, and what it refuses, with lines."""

import numpy as np
import pytest

import updyn
from updyn.demos import find_demo
from updyn.errors import JobError, UpdynWarning
from updyn.job import load_job, prepare, run_job
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles

JOB = """[model]
file = "chain.h5"
[test]
file = "chain.uff"
[[parameter]]
groups = ["part1"]
quantity = "stiffness"
[[parameter]]
groups = ["part2"]
quantity = "stiffness"
[method]
starts = {starts}
max_iterations = {steps}
{table}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("uncertainty")
    find_demo("chain").write_inputs(folder)
    return folder


@pytest.fixture
def job(folder):
    def make(table, starts=0, steps=100):
        path = folder / "job.toml"
        path.write_text(JOB.format(table=table, starts=starts, steps=steps))
        return path

    return make


def test_a_profile_is_written_and_shown(job, tmp_path):
    names = prepare(load_job(job(""))).parameters.names
    path = job(f'[uncertainty]\nkind = "profile"\nnames = ["{names[0]}"]\nlevel = 0.9\n')
    seen = []
    result = run_job(
        load_job(path),
        tmp_path / "out",
        callback=lambda p: seen.append(p.stage),
    ).result
    found = updyn.read_uncertainty(tmp_path / "out" / "uncertainty.nc")
    assert isinstance(found, Profiles)
    assert (list(found), found.level) == (names[:1], 0.9)
    low, high = found.intervals()[names[0]]
    assert low < result.values[names[0]] < high
    assert any(stage.startswith("profile") for stage in seen)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert '<section id="uncertainty">' in text
    assert 'data-figure="uncertainty-intervals"' in text
    assert 'data-figure="uncertainty-band"' in text
    assert "90 % intervals" in text
    again = load_job(tmp_path / "out" / "job.toml")
    assert again.tables == load_job(path).tables
    # A run without the table takes away what would pass for a part of it.
    run_job(load_job(job("[output]\nreport = false\n")), tmp_path / "out")
    assert not (tmp_path / "out" / "uncertainty.nc").exists()


def test_a_bootstrap_is_that_of_the_library(job, tmp_path):
    path = job('[uncertainty]\nkind = "bootstrap"\nn = 3\nseed = 5\n[output]\nreport = false\n')
    result = run_job(load_job(path), tmp_path / "out").result
    found = updyn.read_uncertainty(tmp_path / "out" / "uncertainty.nc", result)
    assert isinstance(found, Draws)
    np.testing.assert_array_equal(found.values, updyn.bootstrap(result, 3, 5).values)


def test_where_it_cannot_be_had_the_update_is_not_lost(job, tmp_path):
    path = job('[uncertainty]\nkind = "profile"\n[output]\nreport = false\n', steps=1)
    with pytest.warns(
        UpdynWarning, match=r"\[uncertainty\] is left out: the update has ended as 'max-iterations'"
    ):
        run_job(load_job(path), tmp_path / "out")
    assert (tmp_path / "out" / "run.nc").exists()
    assert not (tmp_path / "out" / "uncertainty.nc").exists()


@pytest.mark.parametrize(
    ("table", "line", "said"),
    [
        ('[uncertainty]\nkind = "profil"\n', 15, "'profile'"),
        (
            '[uncertainty]\nkind = "profile"\nnames = ["part1.stifness"]\n',
            16,
            "did you mean 'part1.stiffness'",
        ),
        ('[uncertainty]\nkind = "profile"\nn = 20\n', 14, "a profile makes none"),
        ('[uncertainty]\nkind = "bootstrap"\nnames = ["part1.stiffness"]\n', 14, "draws all"),
        ('[uncertainty]\nkind = "sampling"\nlevel = 95\n', 16, "level"),
        ('[uncertainty]\nkin = "sampling"\n', 15, "kind"),
        ('[uncertainty]\nkind = "bootstrap"\nn = 1000000000000\n', 16, "at most 1e+06"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(job, table, line, said):
    path = job(table)
    with pytest.raises(JobError, match=f"job.toml:{line}: .*") as caught:
        prepare(load_job(path))
    assert said in str(caught.value)


def test_a_method_without_likelihood_is_refused_before_the_run(job):
    path = job('name = "output-error"\n[uncertainty]\nkind = "profile"\n')
    text = path.read_text().replace("starts = 0\n", "")
    path.write_text(text)
    with pytest.raises(JobError, match=r"kind 'profile' requires a fit by 'maximum-likelihood'"):
        prepare(load_job(path))


def test_a_bootstrap_that_is_stopped_stops_the_run_and_is_made_anew(job, tmp_path):
    path = job('[uncertainty]\nkind = "bootstrap"\nn = 6\nseed = 5\n[output]\nreport = false\n')
    whole = run_job(load_job(path), tmp_path / "whole")

    def stop(progress):
        return progress.stage.startswith("bootstrap 2")

    out = tmp_path / "out"
    stopped = run_job(load_job(path), out, stop)
    assert stopped.stopped
    assert not whole.stopped
    assert stopped.result.status == whole.result.status
    assert stopped.result.values == whole.result.values
    assert (out / "run.journal").exists()
    again = run_job(load_job(path), out, resume=True)
    assert not again.stopped
    assert again.result.values == whole.result.values
    assert not (out / "run.journal").exists()
    values = [run.further["uncertainty"].values for run in (whole, stopped, again)]
    assert len(values[1]) < 6
    assert np.array_equal(values[0], values[2])
