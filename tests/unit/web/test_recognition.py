"""Files are recognised by their content, and what is recognised fills in the form of a new job."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from updyn.demos import DEMOS, chain
from updyn.errors import InputError
from updyn.io import write_frf
from updyn.job.proposal import propose_unknown
from updyn.web.pages import start
from updyn.web.recognition import recognise
from updyn.web.workspace import Workspace


@pytest.fixture
def files(chain_project: Path) -> Path:
    """The chain without its job, and files that are neither of both."""
    (chain_project / "job.toml").unlink()
    (chain_project / "notes.md").write_text("Measured on Monday.\n")
    (chain_project / "table.csv").write_text("f,real,imag\n1,2,3\n2,3,4\n3,4,5\n", encoding="utf-8")
    return chain_project


@pytest.fixture
def workspace(files: Path) -> Iterator[Workspace]:
    found = Workspace(files)
    yield found
    found.close()


@pytest.mark.parametrize(
    ("name", "kind", "text"),
    [
        ("chain.h5", "model", "12 DOFs in 4 groups"),
        ("chain.uff", "measurement", "5 responses, 2 references, 60 lines"),
        ("job.toml", "job", "a job"),
        ("table.csv", "table", "select its FRFs"),
        ("notes.md", "", "neither a model nor a measurement nor a job"),
    ],
)
def test_a_file_is_recognised_under_any_name(
    chain_made: Path, files: Path, name: str, kind: str, text: str
) -> None:
    path = files / name
    if name == "job.toml":
        path.write_bytes((chain_made / name).read_bytes())
    found = recognise(path)
    assert found.kind == kind
    assert text in found.text
    assert str(files) not in found.text


def test_a_damaged_file_states_its_fault(files: Path) -> None:
    path = files / "chain.uff"
    path.write_bytes(path.read_bytes()[:400])
    found = recognise(path)
    assert found.kind == ""
    assert "chain.uff" in found.text or "record" in found.text


def test_files_of_the_folder_fill_in_the_form(workspace: Workspace, files: Path) -> None:
    workspace.take_inputs()
    job = workspace.new_job
    assert (job.model, job.measurement, job.name) == ("chain.h5", "chain.uff", "job.toml")
    assert workspace.find_new_job_faults() == {}
    workspace.create()
    assert workspace.open_document.path == files / "job.toml"
    assert workspace.view().errors == {}
    assert workspace.new_job.name == "job-2.toml"


def test_faults_are_named_by_entry(workspace: Workspace) -> None:
    assert workspace.find_new_job_faults() == {"model": "required", "measurement": "required"}
    job = workspace.new_job
    job.model, job.name = "chain.uff", "a/b/c"
    workspace.recognise_new_model()
    workspace.take_file("table.csv")
    found = workspace.find_new_job_faults()
    assert found["model"] == "is a measurement; expected a model"
    assert "no such folder" in found["name"]
    assert found["measurement"]
    job.name = " "
    assert workspace.find_new_job_faults()["name"] == "required"


def test_a_job_without_the_measured_quantity_is_not_written(
    workspace: Workspace, files: Path
) -> None:
    (files / "plain.csv").write_text(
        "frequency (Hz),5:X/2:X real,5:X/2:X imag\n"
        + "".join(f"{f},{1 + f},{2 * f}\n" for f in range(1, 40)),
        encoding="utf-8",
    )
    job = workspace.new_job
    workspace.take_file("chain.h5")
    assert workspace.take_file("plain.csv").kind == "measurement"
    assert workspace.find_new_job_faults() == {"quantity": "the file does not state it; choose one"}
    with pytest.raises(InputError, match="quantity"):
        workspace.create()
    assert not (files / "job.toml").exists()
    job.quantity = "accelerance"
    workspace.view_new_measurement()
    assert workspace.find_new_job_faults() == {}
    workspace.create()
    written = tomllib.loads((files / "job.toml").read_text(encoding="utf-8"))
    assert written["test"]["quantity"] == "accelerance"


def test_unmatched_sensors_leave_the_model_to_be_seen(workspace: Workspace, files: Path) -> None:
    data = chain.measure()
    labels = [f"{900 + n}:X" for n in range(len(data.responses))]
    (files / "chain.uff").unlink()
    write_frf(dataclasses.replace(data, responses=labels), files / "chain.uff")
    workspace.take_inputs()
    workspace.create()
    view = workspace.view()
    assert "match" in view.errors
    assert view.groups == ["part1", "part2", "part3", "part4"]
    assert view.tests[0].matches == []


def test_new_unknowns_have_the_bounds_of_a_new_job() -> None:
    model = chain.build()
    assert propose_unknown(model, "stiffness") == {"bounds": (0.2, 5.0)}
    assert propose_unknown(model, "mass") == {"bounds": (0.5, 2.0)}
    assert propose_unknown(model, "loss_factor") == {"bounds": (0.0, 0.3)}


def test_every_shipped_demo_has_a_picture() -> None:
    for name in DEMOS:
        assert "<path d=" in start._read_picture(name)
    assert start._read_picture("none") == ""
