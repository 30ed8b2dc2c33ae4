"""Results of an earlier session are shown again, each with the job that they belong to."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from updyn.outputs.manifest import Entry, Manifest, file_digest
from updyn.web.workspace import Workspace


def write_page(folder: Path, name: str, command: str, at: int) -> None:
    folder.mkdir(parents=True)
    (folder / name).write_text("<html >", encoding="utf-8")
    os.utime(folder / name, (at, at))
    Manifest({name: Entry(file_digest(folder / name), "0" * 16, command)}).write(folder)


@pytest.fixture
def workspace(chain_project: Path) -> Workspace:
    """A fresh server on a folder of which an earlier one wrote plans of two jobs."""
    job = chain_project / "job.toml"
    job.with_name("other.toml").write_bytes(job.read_bytes())
    write_page(chain_project / "job-plan", "plan.html", "plan", 1000)
    write_page(chain_project / "job-plan-2", "plan.html", "plan", 2000)
    write_page(chain_project / "job-3-plan", "plan.html", "plan", 2500)
    write_page(chain_project / "other-plan", "plan.html", "plan", 3000)
    write_page(chain_project / "elsewhere", "plan.html", "plan", 4000)
    found = Workspace(chain_project)
    found.open_job("job.toml")
    return found


def test_the_latest_of_the_open_job_is_shown_and_all_are_offered(workspace: Workspace) -> None:
    pages, shown = workspace.pages("plan")
    assert pages == [
        "elsewhere/plan.html", "other-plan/plan.html", "job-3-plan/plan.html",
        "job-plan-2/plan.html", "job-plan/plan.html",
    ]  # fmt: skip
    assert shown == "job-plan-2/plan.html"
    workspace.open_job("other.toml")
    assert workspace.pages("plan")[1] == "other-plan/plan.html"
    assert workspace.pages("modes") == ([], "")


def test_that_of_this_session_comes_first(workspace: Workspace) -> None:
    folder = workspace.project.folder
    done = SimpleNamespace(job=folder / "job.toml", out=folder / "elsewhere", active=False)
    workspace.workers["plan"] = done  # type: ignore[assignment]
    assert workspace.pages("plan")[1] == "elsewhere/plan.html"
    assert workspace.worker("plan") is done
    workspace.open_job("other.toml")
    assert workspace.worker("plan") is None
    assert workspace.pages("plan")[1] == "other-plan/plan.html"
    done.active = True  # it can be watched and stopped whichever job is open
    assert workspace.worker("plan") is done


def test_a_task_that_wrote_nothing_leaves_the_earlier_page(workspace: Workspace) -> None:
    """A pick that is refused can be taken back in the page in which it was picked."""
    folder = workspace.project.folder
    failed = SimpleNamespace(job=folder / "job.toml", out=folder / "job-plan-3", active=False)
    workspace.workers["plan"] = failed  # type: ignore[assignment]
    assert workspace.pages("plan")[1] == "job-plan-2/plan.html"


def test_a_plant_goes_to_the_run_of_an_earlier_session(workspace: Workspace) -> None:
    out = workspace.project.folder / "first"
    out.mkdir()
    (out / "result.json").write_text('{"status": "converged"}', encoding="utf-8")
    (out / "job.toml").write_text("# Written by updyn 0.1.0 from ../job.toml\n", encoding="utf-8")
    assert workspace.proposed_folder("plant") == "first"
    assert workspace.proposed_folder("run") == "job-run"
    workspace.open_job("other.toml")
    assert workspace.proposed_folder("plant") == "other-plant"


def test_a_job_without_the_suffix_stays_in_the_list(workspace: Workspace) -> None:
    folder = workspace.project.folder
    (folder / "portal").write_bytes((folder / "job.toml").read_bytes())
    workspace.open_job("portal")
    workspace.open_job("job.toml")
    assert folder / "portal" in workspace.jobs()
    assert len(workspace.jobs()) == 3
