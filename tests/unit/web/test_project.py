"""The folder that is worked in: what lies in it, by value, and that nothing leads out of it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from updyn.errors import InputError
from updyn.outputs.manifest import Entry, Manifest, file_digest
from updyn.web.project import Project


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project with a secret beside it."""
    (tmp_path / "secret.txt").write_text("of another")
    (tmp_path / "project-2").mkdir()
    found = tmp_path / "project"
    found.mkdir()
    return found


def put(path: Path, content: str | dict[str, Any] = "", at: float | None = None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    text = content if isinstance(content, str) else json.dumps(content)
    path.write_text(text, encoding="utf-8")
    if at is not None:
        os.utime(path, (at, at))
    return path


def names(folder: Path, paths: list[Path]) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in paths]


# -- paths
@pytest.mark.parametrize(
    "name", ["a.toml", "sub/a.toml", "./sub/../a.toml", "none/of/these", ".", ""]
)
def test_a_path_of_the_project(folder: Path, name: str) -> None:
    assert Project(folder).inside(name) == (folder / name).resolve()
    assert Project(folder).inside(folder / name) == (folder / name).resolve()


@pytest.mark.parametrize(
    "name",
    [
        "..", "../secret.txt", "sub/../../secret.txt", "/etc/passwd", "../project-2/x",
        "../project/../secret.txt",
    ],
)  # fmt: skip
def test_a_path_that_leads_out(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"leads out of the folder of the project"):
        Project(folder).inside(name)


def test_links_count_by_where_they_lead(folder: Path) -> None:
    (folder / "out.txt").symlink_to(folder.parent / "secret.txt")
    (folder / "outer").symlink_to(folder.parent)
    (folder / "in.txt").symlink_to(put(folder / "sub" / "real.txt"))
    project = Project(folder)
    for name in ("out.txt", "outer/secret.txt", "outer"):
        with pytest.raises(InputError, match="leads out"):
            project.inside(name)
    assert project.inside("in.txt") == folder / "sub" / "real.txt"
    assert project.inside("outer/project/sub/real.txt") == folder / "sub" / "real.txt"


def test_the_folder_itself_may_be_a_link(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to(folder)
    assert Project(link).inside("a.toml") == folder / "a.toml"
    assert Project(link).inside(link / "a.toml") == folder / "a.toml"


@pytest.mark.parametrize("name", ["a\0b", "../\0", "\ud800", "loop", "loop/x", "loop/../out"])
def test_a_name_that_no_file_can_have_is_one_message(folder: Path, name: str) -> None:
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "out").symlink_to(folder.parent / "secret.txt")
    with pytest.raises(InputError):
        Project(folder).inside(name)


def test_names_as_pages_show_them(folder: Path) -> None:
    project = Project(folder)
    assert project.name_of(folder / "sub" / "a.toml") == "sub/a.toml"
    assert project.name_of(project.inside("a.toml")) == "a.toml"


# -- lists
@pytest.fixture
def worked(folder: Path) -> Path:
    """A project after some work."""
    put(folder / "old.toml", at=1000)
    put(folder / "new.toml", at=2000)
    put(folder / "sub" / "mid.toml", at=1500)
    for name in ("model.h5", "test.uff", "sub/deck.inp", "notes.txt"):
        put(folder / name, name)
    for name, at in (("first-run", 3000), ("second-run", 4000)):
        put(folder / name / "result.json", {"status": "converged", "name": name}, at)
        put(folder / name / "job.toml", "# Written by updyn 0.1.0 from old.toml")
        for file in ("manifest.json", "report.html", "model.h5"):
            put(folder / name / file)
    put(folder / ".git" / "config.toml")
    put(folder / ".hidden.toml")
    put(folder / "under-way" / "run.journal")
    return folder


def test_jobs_are_those_that_no_run_wrote_the_latest_first(worked: Path) -> None:
    assert names(worked, Project(worked).jobs()) == ["new.toml", "sub/mid.toml", "old.toml"]


def test_inputs_are_what_a_job_could_name(worked: Path) -> None:
    assert names(worked, Project(worked).inputs()) == [
        "model.h5", "notes.txt", "sub/deck.inp", "test.uff",
    ]  # fmt: skip


def listed(folder: Path, files: dict[str, str], command: str) -> None:
    """Write files, and a manifest that says which command wrote them."""
    for name, text in files.items():
        put(folder / name, text)
    entries = {name: Entry(file_digest(folder / name), "0" * 16, command) for name in files}
    Manifest(entries).write(folder)


def test_a_copied_manifest_hides_no_input(worked: Path) -> None:
    """Neither that of a demo nor one that lists files which no command writes."""
    listed(worked, {"model.uff": "a", "job.toml": "# mine"}, "demo")
    assert {"model.uff", "test.uff"} <= {*names(worked, Project(worked).inputs())}
    listed(worked, {"test.uff": "a", "job.toml": "# mine"}, "run")
    put(worked / "result.json", {"status": "converged"})
    project = Project(worked)
    assert "test.uff" in names(worked, project.inputs())
    assert {"job.toml", "new.toml"} <= {*names(worked, project.jobs())}
    put(worked / "manifest.json", "[")
    (worked / "result.json").unlink()
    assert "test.uff" in names(worked, project.inputs())


def test_results_are_no_inputs_wherever_they_lie(folder: Path) -> None:
    """Of several tests each has its own folder; plans and modes have no ``result.json``."""
    put(folder / "a.uff")
    own = "# Written by updyn 0.1.0 from a.toml"
    results = {"job.toml": own, "result.json": '{"status": "converged"}', "model.h5": ""}
    listed(folder, {**results, "first/model.h5": "", "first/run.nc": ""}, "run")
    listed(folder / "plan", {"plan.json": "", "plan.html": ""}, "plan")
    assert names(folder, Project(folder).inputs()) == ["a.uff"]
    assert Project(folder).jobs() == []


def test_runs_are_the_folders_with_a_result_the_latest_first(worked: Path) -> None:
    runs = Project(worked).runs()
    assert names(worked, [run.path for run in runs]) == ["second-run", "first-run"]
    assert [run.record["name"] for run in runs] == ["second-run", "first-run"]
    assert [run.modified for run in runs] == [4000.0, 3000.0]


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", "null", '"status"', "{}", '{"status": 3}', '{"status": null}', "[" * 100_000, "\x00"],
    ids=lambda text: text[:10],
)  # fmt: skip
def test_a_damaged_result_is_left_out_and_harms_no_other(worked: Path, text: str) -> None:
    put(worked / "first-run" / "result.json", text)
    project = Project(worked)
    assert names(worked, [run.path for run in project.runs()]) == ["second-run"]
    assert names(worked, project.jobs()) == ["new.toml", "sub/mid.toml", "old.toml"]


def test_a_result_that_is_not_utf8_is_left_out(worked: Path) -> None:
    (worked / "first-run" / "result.json").write_bytes(b'{"status": "\xff"}')
    assert len(Project(worked).runs()) == 1


def test_it_is_not_looked_for_deep_or_behind_links(folder: Path) -> None:
    put(folder / "1/2/3/4/in.toml")
    put(folder / "1/2/3/4/5/out.toml")
    put(folder.parent / "project-2" / "other.toml")
    (folder / "link").symlink_to(folder.parent / "project-2")
    assert names(folder, Project(folder).jobs()) == ["1/2/3/4/in.toml"]


@pytest.mark.skipif(os.name != "posix", reason="names of files are text elsewhere")
def test_names_that_no_page_can_show_are_left_out(folder: Path) -> None:
    """A name in another encoding than UTF-8 is no text that can be sent to a browser."""
    put(folder / "a.toml")
    put(folder / "b.h5")
    put(folder / "c\udcff.h5")
    put(folder / "d\udcff.toml")
    put(folder / "e\udcff" / "f.toml")
    project = Project(folder)
    assert names(folder, project.jobs()) == ["a.toml"]
    assert names(folder, project.inputs()) == ["b.h5"]
    assert len(project.stamp()) == 1
    with pytest.raises(InputError, match="the name is not UTF-8"):
        Project(folder / "e\udcff")


def test_an_empty_project_and_one_that_is_gone(folder: Path) -> None:
    for _ in range(2):
        project = Project(folder)
        assert (project.jobs(), project.inputs(), project.runs(), project.stamp()) == (
            [],
            [],
            [],
            (),
        )
        if folder.exists():
            folder.rmdir()


# -- the stamp
def test_the_stamp_changes_with_every_input(worked: Path) -> None:
    project = Project(worked)
    stamps = [project.stamp()]
    assert project.stamp() == stamps[0]
    put(worked / "model.h5", "of another size")
    stamps.append(project.stamp())
    os.utime(worked / "model.h5", (9, 9))
    stamps.append(project.stamp())
    put(worked / "further.h5")
    stamps.append(project.stamp())
    (worked / "test.uff").unlink()
    stamps.append(project.stamp())
    put(worked / "first-run" / "model.h5", "a job may start from the model of a run")
    stamps.append(project.stamp())
    assert len(set(stamps)) == len(stamps)


def test_the_stamp_stays_while_a_run_writes_its_journal(worked: Path) -> None:
    """All that was read is forgotten where the stamp changes, so it must not with each step."""
    project = Project(worked)
    before = project.stamp()
    put(worked / "under-way" / "run.journal", "a step")
    put(worked / "under-way" / ".updyn.lock")
    put(worked / "new.toml", "# saved")
    assert project.stamp() == before


# -- names
def test_a_free_name_is_one_that_nothing_has(folder: Path) -> None:
    project = Project(folder)
    assert project.free_name(folder / "job", "-run") == folder / "job-run"
    (folder / "job-run").mkdir()
    (folder / "job-run-2").symlink_to(folder / "nowhere")
    assert project.free_name(folder / "job", "-run") == folder / "job-run-3"


@pytest.mark.parametrize(
    "name", ["a.uff", "Messung 3.uff", "_x", "größe.h5", "a-b+c.tar.gz", "x" * 200]
)
def test_an_upload_is_kept_under_its_name(folder: Path, name: str) -> None:
    path = Project(folder).keep_upload(name, b"content")
    assert (path, path.read_bytes()) == (folder / name, b"content")
    assert [found.name for found in folder.iterdir()] == [name]


@pytest.mark.parametrize(
    "name",
    [
        "", ".", "..", ".hidden", "sub/a.uff", "/etc/x", "../a.uff", "a\\b.uff", "C:a.uff", "a\nb",
        "a.uff\n", "a\0b", "a\x7f", "-rf", " a", "a\u202eb", "*", "x" * 201, "ü" * 130, "\ud800",
    ],
)  # fmt: skip
def test_an_upload_with_another_name_is_refused(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be the name of a file here"):
        Project(folder).keep_upload(name, b"content")
    assert list(folder.iterdir()) == []


def test_the_same_upload_is_kept_once(folder: Path) -> None:
    project = Project(folder)
    path = project.keep_upload("a.uff", b"content")
    assert project.keep_upload("a.uff", b"content") == path
    with pytest.raises(InputError, match="there is such a file already"):
        project.keep_upload("a.uff", b"another")
    assert path.read_bytes() == b"content"


def test_an_upload_writes_over_nothing(folder: Path) -> None:
    put(folder / "a.uff", "mine")
    (folder / "b.uff").mkdir()
    (folder / "c.uff").symlink_to(folder / "nowhere")
    (folder / "d.uff").symlink_to(folder.parent / "secret.txt")
    for name in ("a.uff", "b.uff", "c.uff", "d.uff"):
        with pytest.raises(InputError, match="there is such a file already"):
            Project(folder).keep_upload(name, b"content")
    assert (folder / "a.uff").read_text() == "mine"
    assert not (folder / "nowhere").exists()
    assert (folder.parent / "secret.txt").read_text() == "of another"


@pytest.mark.parametrize(
    "name", ["result.json", "Result.json", "manifest.json", "run.journal", "plan.journal"]
)
def test_an_upload_cannot_hide_the_project(folder: Path, name: str) -> None:
    """A folder that holds ``result.json`` is taken for results, a manifest lists their files."""
    with pytest.raises(InputError, match="results"):
        Project(folder).keep_upload(name, b"{}")
    assert list(folder.iterdir()) == []


# -- the name of a new job
def test_a_free_name_of_a_job_is_proposed(folder: Path) -> None:
    project = Project(folder)
    assert project.free_job_name() == "job.toml"
    for name in ("job.toml", "job-2.toml"):
        put(folder / name)
    assert project.free_job_name() == "job-3.toml"


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("portal", "portal.toml"),
        (" portal ", "portal.toml"),
        ("portal.toml", "portal.toml"),
        ("portal.TOML", "portal.TOML"),
        ("portal.v2", "portal.v2.toml"),
        ("sub/portal", "sub/portal.toml"),
    ],
)
def test_a_new_job_has_a_name_under_which_it_is_listed(folder: Path, name: str, file: str) -> None:
    (folder / "sub").mkdir(exist_ok=True)
    project = Project(folder)
    assert project.new_job(name) == folder / file
    put(folder / file)
    assert names(folder, project.jobs()) == [file]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", "cannot be the name of a file here"),
        (".portal", "cannot be the name of a file here"),
        (".hidden/portal", "is not shown"),
        ("no/portal", "no such folder"),
        ("1/2/3/4/5/portal", "is not shown"),
        ("../portal", "leads out"),
        ("taken", "exists already"),
    ],
)
def test_a_new_job_that_would_not_be_listed_is_refused(
    folder: Path, name: str, reason: str
) -> None:
    (folder / "1/2/3/4/5").mkdir(parents=True)
    (folder / ".hidden").mkdir()
    put(folder / "taken.toml")
    with pytest.raises(InputError, match=reason):
        Project(folder).new_job(name)


# -- results of earlier sessions
def test_pages_that_a_command_wrote_the_latest_first(folder: Path) -> None:
    for name, at in (("a-plan", 2000), ("b-plan", 3000)):
        listed(folder / name, {"plan.html": "page", "plan.json": "{}"}, "plan")
        os.utime(folder / name / "plan.html", (at, at))
    put(folder / "plan.html", "of a user")
    listed(folder / "damaged", {"plan.html": ""}, "plan")
    put(folder / "damaged" / "manifest.json", "[")
    listed(folder / "other", {"plan.html": ""}, "modes")
    found = Project(folder).pages("plan.html", "plan")
    assert names(folder, found) == ["b-plan/plan.html", "a-plan/plan.html"]


def test_runs_of_a_job_are_known_by_their_own_job_file(folder: Path) -> None:
    put(folder / "a.toml")
    for out, job, at in (
        ("first", "../a.toml", 1000),
        ("sub/second", "../../a.toml", 2000),
        ("third", "../b.toml", 3000),
        ("fourth", "", 4000),
    ):
        put(folder / out / "result.json", {"status": "converged"}, at)
        put(folder / out / "job.toml", f"# Written by updyn 0.1.0 from {job}\n[model]\n")
    put(folder / "fifth" / "result.json", {"status": "converged"}, 5000)
    found = Project(folder).runs_of(folder / "a.toml")
    assert names(folder, [run.path for run in found]) == ["sub/second", "first"]


def test_a_folder_of_results_is_a_project(folder: Path) -> None:
    """Its job file is that of its run, and the run has the name of the folder."""
    put(folder / "result.json", {"status": "converged"})
    put(folder / "job.toml", "# Written by updyn 0.1.0 from inputs/job.toml\n[model]\n")
    project = Project(folder)
    (run,) = project.runs_of(folder / "job.toml")
    assert (run.path, project.title_of(run.path)) == (folder, folder.name)
