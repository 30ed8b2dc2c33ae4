"""docs/job.md has every key, default and message of the schema, and no other."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from places import ROOT
from updyn.cli import main
from updyn.control.job.tables import (
    ControllerTable,
    NonlinearTable,
    NotchTable,
    PlantTable,
    PortTable,
    SamplingTable,
    ServoTable,
    WindTable,
)
from updyn.elements.beam import BeamMass, BeamSupport, Segment, beam, beam_from_table
from updyn.errors import JobError
from updyn.io.formats import FORMATS, load
from updyn.job import OUTPUTS, load_job, prepare, run_job
from updyn.job.acceptance import AcceptTable
from updyn.job.candidates import CandidatesTable, CandidateTable
from updyn.job.identification import ModesTable
from updyn.job.job_table import JOB_TABLES
from updyn.job.levels import LevelsTable
from updyn.job.planning import PlanTable
from updyn.job.records_table import CutTable, RecordsTable, SetupTable, WindowTable
from updyn.job.schema import (
    CalibrationTable,
    DampingTable,
    Job,
    MatchTable,
    MethodTable,
    ModelTable,
    OutputTable,
    ParameterTable,
    SelectionTable,
    TestTable,
)
from updyn.job.shapes import ShapesTable
from updyn.job.uncertainty import UncertaintyTable
from updyn.store.result import result_to_json
from updyn.updating.fit.methods import METHODS, options_of
from updyn.updating.result import STATUSES

TEXT = (ROOT / "docs" / "job.md").read_text(encoding="utf-8")


def tables() -> dict[str, dict[str, list[str]]]:
    """Return the tables of the page by the last code span before them: first cell to cells."""
    out: dict[str, dict[str, list[str]]] = {}
    title = ""
    for line in TEXT.splitlines():
        if line.startswith("#"):
            title = line.lstrip("# ").replace("`", "")
        elif line.startswith("`["):
            title = line.split("`")[1]
        elif line.startswith("Further keys"):
            title = "options"
        elif line.startswith("| `"):
            cells = [c.strip() for c in line.strip("|").split(" | ")]
            key = cells[0].strip("` |")
            assert key not in out.setdefault(title, {}), f"{title}: {key} occurs twice"
            out[title][key] = cells
    return out


TABLES = tables()


@pytest.mark.parametrize(
    ("title", "table"),
    [
        ("Top level", Job),
        ("[model]", ModelTable),
        ("[test]", TestTable),
        ("[records]", RecordsTable),
        ("[[records.setup]]", SetupTable),
        ("[records.impact]", WindowTable),
        ("[records.cut]", CutTable),
        ("[match]", MatchTable),
        ("[[parameter]]", ParameterTable),
        ("[[damping]]", DampingTable),
        ("[[calibration]]", CalibrationTable),
        ("[method]", MethodTable),
        ("[selection]", SelectionTable),
        ("[plan]", PlanTable),
        ("[candidates]", CandidatesTable),
        ("[candidates.NAME]", CandidateTable),
        ("[modes]", ModesTable),
        ("[uncertainty]", UncertaintyTable),
        ("[levels]", LevelsTable),
        ("[shapes]", ShapesTable),
        ("[accept]", AcceptTable),
        ("[plant]", PlantTable),
        ("[[plant.inputs]]", PortTable),
        ("[plant.sampling]", SamplingTable),
        ("[servo]", ServoTable),
        ("[servo.controller]", ControllerTable),
        ("[[servo.controller.notch]]", NotchTable),
        ("[[servo.nonlinear]]", NonlinearTable),
        ("[servo.wind]", WindTable),
        ("[output]", OutputTable),
    ],
)
def test_every_key_is_documented_and_every_documented_key_exists(title: str, table: Any) -> None:
    further = set(JOB_TABLES) if table is Job else set()
    assert set(TABLES[title]) == {*table.model_fields, *further}
    for key, field in table.model_fields.items():
        default = TABLES[title][key][2]
        assert (default.startswith("required")) == field.is_required(), key
        if isinstance(field.default, bool):
            assert default == f"`{str(field.default).lower()}`"
        elif isinstance(field.default, str) and field.default:
            assert default == f'`"{field.default}"`'


def test_keys_of_the_beam() -> None:
    assert set(TABLES['kind = "beam"']) == set(inspect.signature(beam).parameters)
    for key, parameter in inspect.signature(beam).parameters.items():
        required = parameter.default is inspect.Parameter.empty
        assert (TABLES['kind = "beam"'][key][2] == "required") == required, key
        if isinstance(parameter.default, float):
            assert TABLES['kind = "beam"'][key][2] == f"`{parameter.default}`"


@pytest.mark.parametrize(
    ("name", "part"), [("segments", Segment), ("supports", BeamSupport), ("masses", BeamMass)]
)
def test_keys_of_the_parts_of_a_beam(name: str, part: Any) -> None:
    documented = TABLES[f"[[model.{name}]]"]
    fields = {f.name: f.default for f in dataclasses.fields(part)}
    assert set(documented) == set(fields)
    for key, default in fields.items():
        assert (documented[key][2] == "required") == (default is dataclasses.MISSING), key
        if isinstance(default, float):
            assert documented[key][2] == f"`{default}`"


def test_options_of_the_methods() -> None:
    documented = TABLES["options"]
    assert set(documented) == {key for method in METHODS for key in options_of(method)}
    for key, (_, _, default, of, _) in documented.items():
        having = {m for m in METHODS if key in options_of(m)}
        assert having == (set(METHODS) if of == "all" else set(of.split(", "))), key
        usual, *others = default.split("; ")  # `100`; this, that `300`
        stated = dict.fromkeys(having, usual)
        for other in others:
            names, own = other.rsplit(" ", 1)
            stated |= dict.fromkeys(names.split(", "), own)
        for method in having:
            value = options_of(method)[key]
            shown = str(value).lower() if isinstance(value, bool) else value
            assert stated[method] == (f'`"{shown}"`' if isinstance(value, str) else f"`{shown}`"), (
                key,
                method,
            )
        assert stated.keys() == having, key
    for method in METHODS:
        assert f'`"{method}"`' in TEXT


def test_every_option_of_a_reader_can_be_given_in_a_job() -> None:
    """Under the same name; what to select is the front door's own, for every format."""
    stated = TestTable(
        file="x",
        format="x",
        quantity="x",
        duplicates="x",
        scalar_direction="x",
        scale=1.0,
        local_axes=True,
        real_valued=True,
        response_labels=("x",),
        reference_labels=("x",),
        order=("x",),
        columns={"x": 1},
        variables={"x": "x"},
        responses=("x",),
        references=("x",),
    )
    options = {
        name
        for f in FORMATS.values()
        if "read_frf" in f.can
        for name, p in inspect.signature(load(f).read_frf).parameters.items()
        if p.kind is p.KEYWORD_ONLY
    }
    assert options == set(stated.reader_options) - {"format"}


@pytest.fixture
def folder(chain_inputs: Path, tmp_path: Path) -> Path:
    for file in chain_inputs.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path


def blocks() -> list[str]:
    return re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)


def test_the_example_runs(folder: Path) -> None:
    job = folder / "example.toml"
    job.write_text(blocks()[0], encoding="utf-8")
    loaded = load_job(job)
    stated = {table for table in tomllib.loads(blocks()[0]) if table != "title"}
    # The demo's measurement is one file of FRFs.
    others = {"title", "records", "element", "population", "levels", "locate"}
    assert stated == {*Job.model_fields, *JOB_TABLES} - others
    result = run_job(
        loaded,
        folder / "out",
    ).result
    assert result.status == "converged"
    written = {path.name for path in (folder / "out").iterdir()}
    assert set(OUTPUTS) < set(TABLES["What a run writes"]) == written
    assert (
        prepare(load_job(folder / "out" / "job.toml")).parameters.names == result.parameters.names
    )
    found = result_to_json(result)
    keys = set()
    for key, value in found.items():
        inside = (
            value[0]
            if key == "parameters"
            else value
            if key in ("identifiability", "correlation")
            else {}
        )
        keys |= {f"{key}.{k}" for k in inside} or {key}
    keys.add("parameters")
    assert set(TABLES["result.json"]) == keys
    for key, inside in (
        ("noise", found["noise"]),
        ("history", found["history"][0]),
        ("versions", found["versions"]),
    ):
        assert all(name in TABLES["result.json"][key][1] for name in inside), key
    record = json.loads((folder / "out" / "control.json").read_text(encoding="utf-8"))
    assert set(TABLES["control.json"]) == set(record) | {f"plant.{key}" for key in record["plant"]}
    assert all(
        f"`{name}`" in TABLES["result.json"]["correlation.before"][1]
        for name in found["correlation"]["before"]
    )


def test_the_beam_is_built(tmp_path: Path) -> None:
    job = tmp_path / "beam.toml"
    job.write_text(blocks()[1], encoding="utf-8")
    model = beam_from_table(load_job(job).model.keys)
    assert list(model.groups) == ["left", "right", "foot", "sensor"]
    assert {"1:Z", "2:Z", "3:Z", "4:Z"} <= set(model.dofs.labels)


def test_every_status_is_documented() -> None:
    shown = TABLES["result.json"]["status"][1]
    assert all(f"`{status}`" in shown for status in STATUSES)


CHANGES = [
    ("bounds = [0.3, 3.0]", "bound = [0.3, 3.0]"),
    ('"part*"', '"prat*"'),
    ("chain.uff", "chian.uff"),
    ('"chain.uff"', '"chain.uff"\nquantity = "mobility"'),
    ('"chain.uff"', '"chain.uff"\nband = [300.0, 400.0]'),
    ("validation", "lines = [5, 6]\nvalidation"),
    ("7:X", "77:X"),
    ("validation", 'noise = "coherence"\nvalidation'),
    ("[0.3, 3.0]", "[3.0, 0.3]"),
    ('"stiffness"', '"mass"'),
]


def messages() -> list[str]:
    return re.findall(r"^job\.toml:\d+: .*$", TEXT, re.MULTILINE)


def test_the_messages_are_those_of_the_changes() -> None:
    assert len(messages()) == len(CHANGES)


@pytest.mark.parametrize(("old", "new"), CHANGES)
def test_a_message_is_as_documented(
    old: str,
    new: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    job = Path("job.toml")
    text = job.read_text(encoding="utf-8")
    assert old in text
    job.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(JobError) as caught:
        prepare(load_job(job))
    assert str(caught.value) in messages()
    assert main(["check", "job.toml"]) == 2
    assert capsys.readouterr().err == f"error: {caught.value}\n"


@pytest.mark.parametrize(
    ("table", "schema"),
    [
        ("[test]", TestTable),
        ("[match]", MatchTable),
        ("[[parameter]]", ParameterTable),
        ("[method]", MethodTable),
        ("[output]", OutputTable),
    ],
)
def test_what_a_new_job_says_of_a_key_is_what_the_page_says(table: str, schema: Any) -> None:
    described = 0
    for key, info in schema.model_fields.items():
        if info.description is None:
            continue
        described += 1
        rows = [line for line in TEXT.splitlines() if line.startswith(f"| `{key}` |")]
        plain = [re.sub(r"[`]|\[([^]]*)\]\([^)]*\)", r"\1", row) for row in rows]
        words = info.description.removeprefix('"label": ').removeprefix("Hz; ")
        words = words.removesuffix('; or "coordinates"')
        assert any(words in row for row in plain), (table, key, words)
    assert described
