"""``[candidates]``: `updyn compare` of a job, the tables of a candidate, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from updyn.cli import main
from updyn.demos import chain
from updyn.errors import JobError, StoppedError
from updyn.job import load_job
from updyn.job.candidates import CandidatesTable, compare_candidates_job, stages
from updyn.job.folder import format_resolved_job

TABLES = """
[candidates]
bands = 3

[candidates.all]

[candidates.stiffness]
model = { file = "other.h5" }

[[candidates.stiffness.parameter]]
groups = "part*"
quantity = "stiffness"
bounds = [0.3, 3.0]
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    chain.write_inputs(folder)
    return folder


@pytest.fixture
def job(inputs: Path, tmp_path: Path) -> Path:
    """The demo's job with two candidates; the second has another file of the same model."""
    for name in ("chain.h5", "chain.uff"):
        shutil.copy(inputs / name, tmp_path)
    shutil.copy(inputs / "chain.h5", tmp_path / "other.h5")
    path = tmp_path / "job.toml"
    text = (inputs / "job.toml").read_text(encoding="utf-8")
    path.write_text(f"{text}starts = 0\n{TABLES}", encoding="utf-8")
    return path


def edit(job: Path, old: str, new: str) -> Path:
    text = job.read_text(encoding="utf-8")
    assert old in text
    job.write_text(text.replace(old, new), encoding="utf-8")
    return job


def test_compare_prints_the_table_and_writes_page_and_record(job, capsys):
    assert main(["compare", str(job)]) == 0
    said = capsys.readouterr().out
    folder = job.with_name("job-compare")
    assert "all is first by evidence" in said
    assert said.strip().endswith(f"Comparison in {folder}: {folder / 'compare.html'}")
    record = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    assert record["best"] == "all"
    assert [one["unknowns"] for one in record["candidates"]] == [12, 4]
    assert len(record["bands"]) == 3
    page = (folder / "compare.html").read_text(encoding="utf-8")
    assert "all is first by evidence" in page
    assert main(["info", str(folder / "compare.json")]) == 0
    assert "all is first by evidence" in capsys.readouterr().out


def test_update_ignores_the_table_and_keeps_it_for_its_folder(job):
    loaded = load_job(job)
    out = job.parent / "deep" / "out"
    out.mkdir(parents=True)
    (out / "job.toml").write_text(format_resolved_job(loaded, out), encoding="utf-8")
    again = load_job(out / "job.toml").table(CandidatesTable)
    assert again is not None
    assert list(again.by_name) == ["all", "stiffness"]
    assert again.bands == 3
    assert again.by_name["all"].model.file == "../../chain.h5"
    assert again.by_name["stiffness"].model.file == "../../other.h5"
    assert (
        again.by_name["stiffness"].parameter
        == load_job(job).table(CandidatesTable).by_name["stiffness"].parameter
    )


def test_stages_are_the_candidates_and_the_bands(job):
    assert [stage.name for stage in stages(load_job(job))] == ["all", "stiffness", "bands"]


def test_validation_set_is_not_used(job):
    """The demo's job holds out 7:X: it is neither fitted nor predicted."""
    found = compare_candidates_job(load_job(job))
    for row in found:
        assert "7:+X" not in row.result.fitted_responses
        assert len(row.result.fitted_responses) == 4
        assert row.result.validation_responses == ()


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("[candidates.all]", "[candidates.all]\nmodle = 1", "[candidates.all]", "'model'"),
        ("bands = 3", "bands = 1", "bands = 1", "at least 2"),
        ("[candidates.all]\n", "", "[candidates]", "at least two candidates"),
        ('"other.h5"', '"othr.h5"', '"othr.h5"', "did you mean 'other.h5'"),
        ('{ file = "other.h5" }', '{ fle = "x" }', '{ fle = "x" }', "did you mean 'file'"),
        ("bands = 3", "bands = 3000", "bands = 3000", "expected at most"),
        ('"maximum-likelihood"', '"log"', '"log"', "fitted by 'maximum-likelihood'"),
    ],
)
def test_errors_name_the_line_of_the_candidate(job, capsys, old, new, line, message):
    edit(job, old, new)
    assert main(["compare", str(job)]) == 2
    said = capsys.readouterr().err
    text = job.read_text(encoding="utf-8")
    number = text[: text.index(line)].count("\n") + 1
    assert re.search(rf"job.toml:({number}|{number + 1}):", said), said
    assert message in " ".join(said.split())
    assert not job.with_name("job-compare").exists()


def test_unknown_group_of_a_candidate_is_named_with_its_line(job):
    head, _, tail = job.read_text(encoding="utf-8").rpartition('groups = "part*"')
    job.write_text(f'{head}groups = "port*"{tail}', encoding="utf-8")
    line = head.count("\n") + 1
    with pytest.raises(JobError, match=rf"job.toml:{line}: .*'port\*'"):
        compare_candidates_job(load_job(job))


def test_options_of_methods_are_refused(job, capsys):
    for words in (["--methods", "log"], ["--fewest"], ["--truth", "x.toml"]):
        assert main(["compare", str(job), *words]) == 2
        assert "[candidates]" in capsys.readouterr().err


def test_regularised_fit_has_no_evidence(job):
    edit(job, "starts = 0", 'starts = 0\nregularise = "gcv"')
    with pytest.raises(JobError, match="regularise"):
        compare_candidates_job(load_job(job))


def test_stopped_comparison_writes_nothing(job):
    with pytest.raises(StoppedError):
        compare_candidates_job(load_job(job), callback=lambda progress: True)
    assert not (job.with_name("job-compare") / "compare.json").exists()
