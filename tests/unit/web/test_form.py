"""Forms of tasks: what is typed goes into the job once the table is complete, and nothing before."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from updyn.errors import InputError
from updyn.job import load_job
from updyn.web.document import JobDocument
from updyn.web.form import Form
from updyn.web.tasks import PLAN
from updyn.web.workspace import Workspace

PLANT = {"inputs": "2:X", "outputs": "12:X", "tolerance": "0.05", "error": "peak"}


@pytest.fixture
def workspace(chain_project: Path) -> Workspace:
    """The chain is open; nothing has been typed."""
    found = Workspace(chain_project)
    found.open_job("job.toml")
    return found


def table(workspace: Workspace, name: str) -> dict[str, object] | None:
    """A table of the open job as it is written."""
    return tomllib.loads(workspace.open_document.text).get(name)


def test_nothing_is_written_before_the_table_is_complete(workspace: Workspace) -> None:
    before = workspace.open_document.text
    workspace.enter("plan", "n_sensors", "3")
    assert workspace.open_document.text == before
    assert "missing key 'band' in [plan]" in workspace.form("plan").reason
    assert workspace.entries("plan")["n_sensors"] == "3"
    workspace.enter("plan", "criterion", "a-optimal")
    assert workspace.open_document.text == before
    load_job(workspace.open_document.path, text=workspace.open_document.text)
    workspace.enter("plan", "band", "5, 40")
    assert table(workspace, "plan") == {
        "n_sensors": 3, "criterion": "a-optimal", "band": [5.0, 40.0],
    }  # fmt: skip
    assert (workspace.form("plan").reason, workspace.form("plan").pending) == ("", {})
    workspace.open_document.undo()  # one edit
    assert workspace.open_document.text == before


def test_faults_are_named_by_entry(workspace: Workspace) -> None:
    assert workspace.faults("plan") == {"n_sensors": "required", "band": "required"}
    assert workspace.faults("run") == workspace.faults("modes") == {}
    workspace.enter("plan", "n_sensors", "three")
    assert workspace.faults("plan")["n_sensors"].endswith("'three'; expected a whole number")
    workspace.note("plan", "band", "5, 40")
    workspace.enter("plan", "n_sensors", "0")  # the fault is found in the job
    assert workspace.faults("plan") == {
        "n_sensors": "plan.n_sensors = 0: expected a number of at least 1"
    }
    workspace.note("plan", "n_sensors", "3")  # not tried yet
    assert workspace.faults("plan") == {}


def test_a_complete_table_stays_complete(workspace: Workspace) -> None:
    for key, text in (("n_sensors", "3"), ("band", "5, 40")):
        workspace.enter("plan", key, text)
    before = workspace.open_document.text
    workspace.enter("plan", "band", "")
    assert workspace.open_document.text == before
    assert "missing key 'band'" in workspace.form("plan").reason
    workspace.enter("plan", "n_sensors", "")  # nothing is left of the table
    assert table(workspace, "plan") is None
    assert workspace.form("plan").pending == {}


@pytest.mark.parametrize(
    ("key", "text", "expected"),
    [
        ("n_sensors", "three", "'three'; expected a whole number"),
        ("n_sensors", "0", "expected a number of at least 1"),
        ("n_sensors", "1e3", "'1e3'; expected a whole number"),
        ("n_sensors", "9" * 5000, "expected a whole number"),
        ("n_sensors", "9" * 30, "does not fit 64 bits"),
        ("band", "low, high", "expected two frequencies"),
        ("band", "5", "expected two frequencies"),
        ("band", "40, 5", "expected two frequencies"),
        ("band", "5, 1e999", "expected two frequencies"),
        ("band", "5, 10, 20", "expected two frequencies"),
    ],
)
def test_an_invalid_entry_starts_nothing(
    workspace: Workspace, key: str, text: str, expected: str
) -> None:
    for each, given in (("n_sensors", "3"), ("band", "5, 40")):
        workspace.enter("plan", each, given)
    before = workspace.open_document.text
    workspace.enter("plan", key, text)
    with pytest.raises(InputError) as caught:
        workspace.begin("plan", "planned")
    assert expected in str(caught.value)
    assert len(str(caught.value)) < 300
    assert workspace.workers == {}
    assert workspace.open_document.text == before
    assert workspace.entries("plan")[key] == text  # to be mended


def test_an_entry_is_taken_when_the_task_begins_though_it_was_not_left(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("updyn.web.worker.Worker.start", lambda _worker: None)
    workspace.note("plan", "n_sensors", "3")
    workspace.note("plan", "band", "5, 40")
    workspace.begin("plan", "planned")
    written = tomllib.loads(workspace.open_document.path.read_text(encoding="utf-8"))
    assert written["plan"] == {"n_sensors": 3, "band": [5.0, 40.0]}


def test_saving_takes_entries_and_names_those_that_it_cannot(workspace: Workspace) -> None:
    workspace.note("modes", "damping", "viscous")
    workspace.note("plan", "n_sensors", "3")
    with pytest.raises(InputError, match=r"saved without .*missing key 'band' in \[plan\]"):
        workspace.save()
    written = tomllib.loads(workspace.open_document.path.read_text(encoding="utf-8"))
    assert written["modes"] == {"damping": "viscous"}
    assert "plan" not in written
    with pytest.raises(InputError, match="plan"):  # an entry that would be lost
        workspace.open_demo("chain")
    workspace.form("plan").discard()
    workspace.open_demo("chain")


def test_entries_of_one_job_are_not_those_of_another(workspace: Workspace) -> None:
    workspace.enter("plan", "n_sensors", "3")
    workspace.form("plan").discard()
    other = workspace.open_document.path.with_name("other.toml")
    other.write_text(workspace.open_document.text, encoding="utf-8")
    workspace.open_job("other.toml")
    assert workspace.entries("plan")["n_sensors"] == ""


def test_an_entry_that_is_what_the_job_says_is_no_edit(workspace: Workspace) -> None:
    for key, text in PLANT.items():
        workspace.enter("plant", key, text)
    before, version = workspace.open_document.text, workspace.open_document.version
    for key, text in workspace.entries("plant").items():
        workspace.enter("plant", key, text)
    assert (workspace.open_document.text, workspace.open_document.version) == (before, version)


def test_what_a_label_has_besides_is_kept(chain_project: Path) -> None:
    """The gear ratio of an input is not shown in the form, and must not be lost there."""
    path = chain_project / "job.toml"
    ports = 'inputs = [{ dof = "2:X", ratio = 97.0 }]\noutputs = ["12:X"]\n'
    path.write_text(path.read_text(encoding="utf-8") + f"\n[plant]\n{ports}", encoding="utf-8")
    workspace = Workspace(chain_project)
    workspace.open_job("job.toml")
    workspace.enter("plant", "inputs", "2:X, 4:X")
    assert tomllib.loads(workspace.open_document.text)["plant"]["inputs"] == [
        {"dof": "2:X", "ratio": 97.0},
        "4:X",
    ]


def test_a_choice_that_the_form_does_not_offer_is_shown(chain_project: Path) -> None:
    document = JobDocument(chain_project / "job.toml")
    document.replace("typing", document.text + '\n[plan]\ncriterion = "e-optimal"\n')
    shown = Form(PLAN.table, PLAN.fields).entries(document.text)
    assert shown["criterion"] == "e-optimal"
    assert shown["quantity"] == "accelerance"  # not written: the default


@pytest.mark.parametrize("text", ["plan = 3\n", "[[plan]]\n", "[plan", "plan = " + "[" * 5000])
def test_a_text_that_is_no_job_has_an_empty_form(text: str) -> None:
    assert Form(PLAN.table, PLAN.fields).entries(text)["n_sensors"] == ""


# -- other edits of pages
def test_an_edit_that_breaks_the_job_is_refused(workspace: Workspace) -> None:
    from updyn.web import edits

    before = workspace.open_document.text
    with pytest.raises(InputError, match="missing key 'parameter'"):
        workspace.edit("none", edits.set_unknowns({"mass": [], "stiffness": [], "loss_factor": []}, {
            kind: ["part1", "part2", "part3", "part4"] for kind in ("mass", "stiffness", "loss_factor")
        }, {}))  # fmt: skip
    with pytest.raises(InputError, match="unknown key"):
        workspace.edit("key", edits.set_key("test", "bnad", 3))
    assert workspace.open_document.text == before
    workspace.edit("band", edits.set_band(1.0, 10.0))
    assert workspace.open_document.is_changed


def test_an_edit_that_mends_a_job_in_part_is_made(workspace: Workspace) -> None:
    """A job with another fault can be edited: only what is new is refused."""
    from updyn.web import edits

    workspace.open_document.replace(
        "typing", workspace.open_document.text + "\n[plan]\nn_sensors = 3\n"
    )
    workspace.edit("band", edits.set_band(1.0, 10.0))
    workspace.enter("plan", "criterion", "a-optimal")
    assert table(workspace, "plan") == {"n_sensors": 3, "criterion": "a-optimal"}


@pytest.mark.parametrize(
    ("low", "high"), [(2.0, 1.0), (1.0, 1.0), (float("nan"), 1.0), (0.0, float("inf"))]
)
def test_bounds_that_are_none_are_refused(workspace: Workspace, low: float, high: float) -> None:
    from updyn.web import edits

    before = workspace.open_document.text
    with pytest.raises(InputError, match="expected a lower bound below the upper one"):
        workspace.edit("bounds", edits.set_bounds("part1.mass", low, high, ["part1"]))
    assert workspace.open_document.text == before


# -- entries that the data propose
def test_required_entries_are_proposed_by_the_data(workspace: Workspace) -> None:
    before = workspace.open_document.text
    workspace.view()
    entries = workspace.entries("plan")
    assert (entries["n_sensors"], entries["band"]) == ("5", "0.634882, 22.6954")
    assert (workspace.faults("plan"), workspace.has_unsaved) == ({}, False)
    workspace.save()
    assert workspace.open_document.text == before
    workspace.close()


def test_proposed_entries_are_written_with_what_is_typed(workspace: Workspace) -> None:
    workspace.view()
    workspace.enter("plan", "n_sensors", "3")
    assert table(workspace, "plan") == {"n_sensors": 3, "band": [0.634882, 22.6954]}
    workspace.close()


def test_an_emptied_proposal_is_missing(workspace: Workspace) -> None:
    before = workspace.open_document.text
    workspace.view()
    workspace.enter("plan", "band", "")
    assert workspace.faults("plan")["band"] == "required"
    assert workspace.entries("plan")["band"] == ""
    assert workspace.open_document.text == before
    workspace.close()


def test_proposed_entries_are_written_if_they_are_needed(workspace: Workspace) -> None:
    workspace.view()
    form = workspace.form("plan")
    form.commit(workspace.open_document, is_needed=True)
    assert table(workspace, "plan") == {"n_sensors": 5, "band": [0.634882, 22.6954]}
    workspace.close()
