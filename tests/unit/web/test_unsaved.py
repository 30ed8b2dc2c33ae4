"""A job with edits that are not saved stays open, and nothing is written beside it."""

from __future__ import annotations

import pytest

pytest.importorskip("nicegui")

from updyn.demos import find_demo
from updyn.errors import InputError
from updyn.web.workspace import Workspace


def _create(workspace):
    workspace.new_job.model, workspace.new_job.measurement = "chain.h5", "chain.uff"
    workspace.create()


@pytest.mark.parametrize(
    "leave",
    [
        lambda w: w.open_demo("beam"),
        _create,
        lambda w: w.open_job("other.toml"),
    ],
    ids=["a demo", "a new job", "another job"],
)
def test_edits_are_not_lost(tmp_path, leave):
    job = find_demo("chain").write_inputs(tmp_path)
    (tmp_path / "other.toml").write_bytes(job.read_bytes())
    workspace = Workspace(tmp_path)
    workspace.open_job("job.toml")
    workspace.open_document.replace("typing", "title = 'mine'\n" + workspace.open_document.text)
    before, text = sorted(tmp_path.rglob("*")), workspace.open_document.text
    with pytest.raises(InputError, match="edits that are not saved"):
        leave(workspace)
    assert sorted(tmp_path.rglob("*")) == before
    assert workspace.open_document.text == text
    workspace.open_job("job.toml")  # the same one, as it is edited
    assert workspace.open_document.text == text
