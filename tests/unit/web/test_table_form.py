"""The form for FRFs in tables of any layout: what it offers, lacks and writes, without a browser."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui")
from nicegui import Client, ui

from updyn.demos import chain
from updyn.errors import InputError
from updyn.io.inventory import list_items
from updyn.job import load_job
from updyn.job.prepare import read_measurement
from updyn.web.pages.table import _TablePage
from updyn.web.table_form import TableForm
from updyn.web.table_preview import preview_frf, view_measurement, view_table
from updyn.web.workspace import Workspace

CHANNEL = ("columns", "channels", 0)


def write_points(folder: Path, labels: list[str] | None = None) -> None:
    """Write one file per response of the chain, with names that state no label."""
    frf = chain.measure()
    for row, label in enumerate(labels or frf.responses.labels):
        rows = [
            f"{f!r};{z.real!r};{z.imag!r}".replace(".", ",")
            for f, z in zip(frf.freq.tolist(), frf.values[:, row, 0].tolist(), strict=True)
        ]
        name = folder / f"hit_{label.replace(':', '')}.csv"
        name.write_text("\n".join(["Export", "f [Hz];a;b", *rows, ""]), encoding="utf-8")


@pytest.fixture
def folder(chain_project: Path) -> Path:
    """The chain with a file per point in place of its measurement."""
    write_points(chain_project)
    (chain_project / "chain.uff").unlink()
    return chain_project


def open_form(path: Path, **given: object) -> TableForm:
    return TableForm(path.name, list_items(path), given)


def fill(form: TableForm, entries: dict[tuple[str | int, ...], object]) -> None:
    for key, value in entries.items():
        form.set(key, value)


# -- the form alone
def test_what_is_missing_is_named_at_its_entry(folder: Path) -> None:
    form = open_form(folder / "hit_2X.csv")
    assert form.parts == ("real", "imaginary")
    assert set(form.faults()) == {
        ("columns", "frequency"), ("quantity",), (*CHANNEL, "response"), (*CHANNEL, "reference"),
        (*CHANNEL, "real"), (*CHANNEL, "imaginary"),
    }  # fmt: skip
    assert form.preview_options() is None
    fill(form, {
        ("columns", "frequency"): "f [Hz]", (*CHANNEL, "real"): "a", (*CHANNEL, "imaginary"): "b",
    })  # fmt: skip
    options = form.preview_options()  # the numbers are shown before the labels are known
    assert options is not None
    found = preview_frf(folder / "hit_2X.csv", options)
    np.testing.assert_allclose(found.values[:, 0], chain.measure().values[:, 0, 0], rtol=1e-12)
    form.set((*CHANNEL, "response"), "2")
    assert "expected a node and a direction" in form.faults()[*CHANNEL, "response"]
    fill(form, {
        (*CHANNEL, "response"): " 2:X ", (*CHANNEL, "reference"): "2:X", ("quantity",): "mobility",
    })  # fmt: skip
    assert form.faults() == {}
    assert form.build_options() == {
        "quantity": "mobility",
        "columns": {
            "frequency": "f [Hz]",
            "channels": [{"response": "2:X", "reference": "2:X", "real": "a", "imaginary": "b"}],
        },
    }
    form.set((*CHANNEL, "imaginary"), None)
    assert form.faults() == {(*CHANNEL, "imaginary"): "required"}


def test_an_error_of_the_reader_has_the_key_of_its_entry(folder: Path) -> None:
    path = folder / "hit_2X.csv"
    channel = {"response": "2:X", "reference": "2:X", "real": "a", "imaginary": "c"}
    given = {"quantity": "mobility", "columns": {"frequency": 2, "channels": [channel]}}
    (key,) = preview_frf(path, given).errors
    assert key == ("columns", "frequency")
    given["columns"]["frequency"] = 1
    ((key, text),) = preview_frf(path, given).errors.items()
    assert key == (*CHANNEL, "imaginary")
    assert "no column 'c'" in text
    assert str(folder) not in text
    assert "\n" not in text


def test_another_form_of_values_keeps_what_is_common(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("f,mag,phase,coh\n1,2,170,1\n2,3,-90,1\n")
    form = open_form(tmp_path / "a.csv")
    assert form.parts == ("magnitude", "phase_deg")
    form.choose_parts(("magnitude", "phase_rad"))
    assert form.channels == [{"magnitude": "mag", "coherence": "coh"}]


def test_a_further_channel_gets_the_next_columns(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("f,a,b,c,d\n1,2,3,4,5\n2,3,4,5,6\n")
    form = open_form(tmp_path / "a.csv")
    fill(form, {
        ("columns", "frequency"): "f", (*CHANNEL, "real"): "a", (*CHANNEL, "imaginary"): "b",
        (*CHANNEL, "reference"): "1:Z",
    })  # fmt: skip
    form.add_channel()
    assert form.channels[1] == {"real": "c", "imaginary": "d", "reference": "1:Z"}
    assert form.uses()["c"] == ["real part of channel 2"]
    form.add_channel()  # no columns are left
    assert form.channels[2] == {"reference": "1:Z"}
    form.set((*CHANNEL, "reference"), "9:X")
    form.repeat_reference()
    assert [channel["reference"] for channel in form.channels] == ["9:X"] * 3
    for _ in range(3):
        form.remove_channel(0)
    assert len(form.channels) == 1


def test_units_of_the_file_are_stated_and_define_the_quantity(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("f [kHz],Re [g/N],Im [g/N]\n1,2,3\n2,3,4\n")
    form = open_form(tmp_path / "a.csv")
    assert form.hints() == {
        ("columns", "frequency_unit"): "kHz, by the file",
        ("columns", "unit"): "g/N, by the file",
        ("columns", "separator"): "detected, if empty",
        ("columns", "first_row"): "detected, if empty",
    }
    assert ("quantity",) not in form.faults()


def test_arrays_of_all_channels(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    values = np.arange(12.0).reshape(2, 3, 2) + 1j
    np.savez(path, f=[1.0, 2.0, 3.0], frf=values)
    form = open_form(path)
    assert (form.is_array, form.parts) == (True, ("complex",))
    form.set(("quantity",), "mobility")
    options = form.preview_options()
    assert options is not None
    assert set(preview_frf(path, options).errors) == {("response_labels",)}
    fill(form, {
        ("response_labels",): "1:Z, 2:Z", ("reference_labels",): "1:Z, 3:Z",
        ("order",): "response, freq, reference",
    })  # fmt: skip
    found = preview_frf(path, form.build_options())
    assert found.errors == {}
    assert found.channels == (("1:Z", "1:Z"), ("1:Z", "3:Z"), ("2:Z", "1:Z"), ("2:Z", "3:Z"))
    np.testing.assert_array_equal(found.values[:, 3], values[1, :, 1])
    form.choose_array(False)
    assert form.build_options() == {
        "quantity": "mobility", "variables": {"freq": "f", "channels": [{}]},
    }  # fmt: skip


def test_files_of_points_take_labels_from_their_names(folder: Path) -> None:
    view = view_table(folder / "hit_5X.csv", {})
    assert (view.first_file, view.pattern, view.n_files) == (
        "hit_5X.csv", "hit_{node}{axis}.csv", 5,
    )  # fmt: skip
    form = open_form(folder / "hit_5X.csv")
    form.choose_file(view.pattern)
    assert form.channels == [{"response": "{node}:{axis}"}]
    form.choose_file("hit_5X.csv")
    assert form.channels == [{}]


@pytest.mark.parametrize(
    ("text", "has_items", "message"),
    [("f,a,b\n1,2,3\n2,3,4\n", True, "freq_Hz"), ("no table\n", False, "freq_Hz")],
)
def test_a_file_that_is_not_understood_may_have_columns(
    tmp_path: Path, text: str, has_items: bool, message: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    view = view_measurement(tmp_path / "a.csv", {})
    assert (view.summary, view.has_items) == ("", has_items)
    assert message in view.error
    assert str(tmp_path) not in view.error


def test_separator_and_first_row_are_stated_if_they_are_not_found(chain_project: Path) -> None:
    """Names that are numbers look like a row; the columns are listed by the stated first row."""
    (chain_project / "a.csv").write_text("0,2,3\n1,4,5\n2,6,7\n")
    workspace = Workspace(chain_project)
    workspace.new_job.measurement = "a.csv"
    workspace.open_new_table()
    assert workspace.table is not None
    form = workspace.table.form
    assert form.inventory.layout.startswith("3 rows from line 1")
    fill(form, {
        ("columns", "frequency"): 1, (*CHANNEL, "real"): 2, (*CHANNEL, "imaginary"): 3,
        ("columns", "first_row"): 2,
    })  # fmt: skip
    workspace.relist_table()
    assert (
        form.inventory.layout == "2 rows from line 2 in 3 columns with names, separated by commas"
    )
    assert [item.select for item in form.inventory.items] == ["0", "2", "3"]
    found = workspace.preview_table()
    assert found is not None
    np.testing.assert_array_equal(found.values[:, 0], [4 + 5j, 6 + 7j])
    form.set(("columns", "separator"), ";")
    workspace.relist_table()
    found = workspace.preview_table()
    assert found is not None
    assert set(found.errors) == {("columns", "separator")}
    form.set(("columns", "first_row"), "two")
    assert "expected a whole number" in form.faults()["columns", "first_row"]
    workspace.close()


# -- within the window
def fill_points(workspace: Workspace) -> None:
    """Fill the open form for the files of all points."""
    assert workspace.table is not None
    form = workspace.table.form
    form.choose_file(workspace.table.pattern)
    fill(form, {
        ("columns", "frequency"): 1, (*CHANNEL, "real"): "a", (*CHANNEL, "imaginary"): "b",
        (*CHANNEL, "reference"): "2:X", ("quantity",): "accelerance",
    })  # fmt: skip


def test_a_new_job_reads_the_selected_columns(folder: Path) -> None:
    workspace = Workspace(folder)
    job = workspace.new_job
    job.model, job.measurement, job.name = "chain.h5", "hit_2X.csv", "new"
    workspace.view_new_measurement()
    assert job.view is not None
    assert set(job.faults()) == {"measurement"}
    workspace.open_new_table()
    with pytest.raises(InputError, match="not complete"):
        workspace.use_table()
    fill_points(workspace)
    workspace.use_table()
    assert job.view is not None
    assert job.view.summary.startswith("5 responses, 1 reference, 60 lines")
    assert job.faults() == {}
    before = set(folder.iterdir())
    workspace.create()
    assert set(folder.iterdir()) - before == {folder / "new.toml"}
    frf = read_measurement(load_job(folder / "new.toml"))
    assert frf.responses.labels == chain.measure().responses.labels
    np.testing.assert_allclose(frf.values, chain.measure().values[:, :, :1], rtol=1e-12)
    assert workspace.new_job.model == ""
    workspace.close()


def test_the_columns_of_an_open_job_are_changed_as_one_edit(folder: Path) -> None:
    text = (folder / "job.toml").read_text(encoding="utf-8")
    assert 'file = "chain.uff"' in text
    (folder / "job.toml").write_text(
        text.replace('file = "chain.uff"', 'file = "hit_2X.csv"  # of May'), encoding="utf-8"
    )
    workspace = Workspace(folder)
    workspace.open_job("job.toml")
    document = workspace.open_document
    assert workspace.tables() == {0: "hit_2X.csv"}
    before = document.text
    workspace.open_table(0)
    fill_points(workspace)
    assert document.text == before
    workspace.use_table()
    test = tomllib.loads(document.text)["test"]
    assert (test["file"], test["quantity"]) == ("hit_{node}{axis}.csv", "accelerance")
    assert test["columns"]["channels"][0]["response"] == "{node}:{axis}"
    assert "# of May" in document.text
    assert len(read_measurement(load_job(document.path, text=document.text)).responses) == 5
    workspace.open_table(0)  # shows what the job has
    assert workspace.table is not None
    assert workspace.table.form.faults() == {}
    after = document.text
    workspace.use_table()
    assert document.text == after
    document.undo()
    assert document.text == before
    workspace.close()


# -- the page
@pytest.mark.parametrize(("page", "shown"), [(1, range(20)), (3, range(40, 45))])
def test_twenty_channels_are_shown_at_once(folder: Path, page: int, shown: range) -> None:
    form = open_form(folder / "hit_2X.csv")
    for _ in range(44):
        form.add_channel()
    with Client(ui.page("/")):
        one = _TablePage(None, SimpleNamespace(form=form, view=SimpleNamespace(pattern="")))
        one._page = page
        one._draw_form()
    assert {key[2] for key in one._shown if key[:2] == CHANNEL[:2]} == set(shown)
