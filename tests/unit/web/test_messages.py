"""Messages of the window name files of the project, not the place of the project."""

from __future__ import annotations

from pathlib import Path

import pytest

from updyn.errors import FormatError, InputError, UpdynError
from updyn.web.project import describe_error, hide_folder
from updyn.web.worker import Worker
from updyn.web.workspace import Workspace


@pytest.mark.parametrize(
    "change",
    [("chain.uff", "none.uff"), ("[test]", "[test"), ("[test]", "[test]\nbnad = 3")],
    ids=["no file", "no TOML", "a key"],
)
def test_errors_of_a_job_name_its_file_in_the_project(
    chain_project: Path, change: tuple[str, str]
) -> None:
    job = chain_project / "job.toml"
    job.write_text(job.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    workspace = Workspace(chain_project)
    workspace.open_job("job.toml")
    errors = workspace.view().errors
    workspace.close()
    assert errors
    for text in errors.values():
        assert text.startswith("job.toml:")
        assert str(chain_project) not in text


def test_errors_of_actions_name_files_in_the_project(chain_project: Path) -> None:
    workspace = Workspace(chain_project)
    workspace.open_job("job.toml")
    workspace.new_job.model = workspace.new_job.measurement = "chain.h5"
    workspace.new_job.name = "new"
    (chain_project / "job.toml").write_text("title = 'of another program'\n", encoding="utf-8")
    workspace.open_document.replace("typing", "title = 'mine'\n")
    actions = (workspace.save, lambda: Workspace(chain_project).open_job("none.toml"))
    for action in actions:
        with pytest.raises(UpdynError, match=r"^(job|none)\.toml:"):
            action()
    workspace.open_document.undo()
    with pytest.raises(UpdynError, match=r"^chain\.h5 is a model"):
        workspace.create()
    workspace.close()


def test_messages_of_files_name_no_folder(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    full = OSError(28, "No space left on device", str(path))
    assert describe_error(full) == "job.toml: No space left on device"
    assert describe_error(FormatError("cannot be read", path)) == "job.toml: cannot be read"
    assert describe_error(InputError("no job is open")) == "no job is open"


def test_the_folder_itself_is_named_without_those_around_it(tmp_path: Path) -> None:
    text = hide_folder(f"{tmp_path}/out/run.nc is not in {tmp_path}", tmp_path)
    assert text == f"out/run.nc is not in {tmp_path.name}"


def test_messages_of_a_task_name_files_in_the_project(tmp_path: Path) -> None:
    worker = Worker("run", tmp_path / "job.toml", tmp_path / "out", tmp_path)
    for kind in ("note", "stage", "error"):
        worker._handle_event({"kind": kind, "text": f"{tmp_path}/out/run.nc: {kind}"})
    texts = [*worker.notes, *worker.stages, worker.message]
    assert texts == [f"out/run.nc: {kind}" for kind in ("note", "stage", "error")]
