"""``[locate]``: `updyn compare` of a job with FRFs at several levels, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.job import load_job
from updyn.job.folder import format_resolved_job
from updyn.job.location import LocateTable, locate_job

FREQ = np.linspace(7.0, 30.0, 50)
ENDS = ["1:X", "2:X"]
JOB = """[model]
file = "linear.h5"

[[test]]
name = "low"
file = "low.npz"
level = 0.5

[[test]]
name = "high"
file = "high.npz"
level = 2.0

[[parameter]]
groups = "k"
quantity = "stiffness"

[method]
noise = { relative = 0.01 }

[locate]
kinds = ["cubic-spring", "jenkins"]

[locate.places]
joint = ["1:X", "2:X"]
ground = "1:X"
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of two masses, 5 % too soft, and FRFs with a cubic spring between them."""
    folder = tmp_path_factory.mktemp("levels")
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {"k": updyn.Group(K, loss_factor=0.03), "m": updyn.Group(mass=np.eye(2))}
    linear = updyn.Model.from_groups(groups, ENDS)
    true = linear.with_elements({"joint": (updyn.CubicSpring(1e8), ENDS)})
    updyn.write_model(linear.scaled({"k": {"stiffness": 0.95}}), folder / "linear.h5")
    for name, level in (("low", 0.5), ("high", 2.0)):
        frf = updyn.response(true, FREQ, ENDS, ["2:X"], level=level).frf.with_level(None)
        updyn.write_frf(frf, folder / f"{name}.npz")
    (folder / "job.toml").write_text(JOB, encoding="utf-8")
    return folder


@pytest.fixture
def job(inputs: Path, tmp_path: Path) -> Path:
    for path in inputs.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path / "job.toml"


def edit(job: Path, old: str, new: str) -> Path:
    text = job.read_text(encoding="utf-8")
    assert old in text
    job.write_text(text.replace(old, new), encoding="utf-8")
    return job


def test_compare_names_place_and_kind_and_writes_page_and_record(job, capsys) -> None:
    assert main(["compare", str(job)]) == 0
    said = capsys.readouterr().out
    folder = job.with_name("job-compare")
    assert "cubic-spring at joint: coefficient 1e+08" in said
    assert said.strip().endswith(f"Comparison in {folder}: {folder / 'compare.html'}")
    record = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    assert record["likely"] is True
    assert set(record["places"]) == {"joint", "ground"}
    best = record["elements"][0]
    assert (best["place"], best["kind"]) == ("joint", "cubic-spring")
    assert best["parameters"]["coefficient"] == pytest.approx(1e8, rel=1e-3)
    assert best["values"]["k.stiffness"] == pytest.approx(1.0 / 0.95, rel=1e-4)
    page = (folder / "compare.html").read_text(encoding="utf-8")
    assert "cubic-spring at joint: coefficient 1e+08" in page
    assert main(["info", str(folder / "compare.json")]) == 0
    assert "cubic-spring at joint" in capsys.readouterr().out


def test_places_and_kinds_are_all_by_default(job) -> None:
    text = job.read_text(encoding="utf-8")
    job.write_text(text[: text.index("kinds =")], encoding="utf-8")
    found = locate_job(load_job(job))
    assert set(found.places) == {"1:X - 2:X", "1:X - ground"}
    assert found.best.place == "1:X - 2:X"


ELEMENT = """[[element]]
name = "joint"
kind = "cubic-spring"
dofs = ["1:X", "2:X"]
coefficient = 1e8

[method]"""


def test_several_elements_are_listed_in_page_and_record(job, capsys) -> None:
    edit(job, "[locate.places]", "most = 2\n\n[locate.places]")
    assert main(["compare", str(job)]) == 0
    assert "cubic-spring at joint: coefficient 1e+08" in capsys.readouterr().out
    folder = job.with_name("job-compare")
    record = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    (one,) = record["found"]
    assert (one["place"], one["kind"]) == ("joint", "cubic-spring")
    assert record["further"]["likely"] is False
    page = (folder / "compare.html").read_text(encoding="utf-8")
    assert "cubic-spring at joint: coefficient 1e+08" in page
    assert 'id="searches"' in page
    assert main(["info", str(folder / "compare.json")]) == 0
    assert "cubic-spring at joint" in capsys.readouterr().out


def test_elements_of_the_job_are_kept(job) -> None:
    found = locate_job(load_job(edit(job, "[method]", ELEMENT)))
    assert not found.is_likely
    assert found.linear_residual < 0.1
    assert "joint" in found.best.model.nonlinear


def test_an_update_ignores_the_table_and_keeps_it_for_its_folder(job) -> None:
    loaded, out = load_job(job), job.parent / "out"
    out.mkdir()
    (out / "job.toml").write_text(format_resolved_job(loaded, out), encoding="utf-8")
    assert load_job(out / "job.toml").table(LocateTable) == loaded.table(LocateTable)


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ('"jenkins"', '"jenkin"', "kinds =", "did you mean 'jenkins'"),
        ('kinds = ["cubic-spring", "jenkins"]', "kinds = []", "kinds = []", "expected 1 or more"),
        ('ground = "1:X"', 'ground = "7:X"', 'ground = "7:X"', "7:X"),
        ('ground = "1:X"', "ground = 3", "ground = 3", "expected one label"),
        ("[locate.places]", "place = 1\n\n[locate.places]", "place = 1", "'places'"),
        ("[method]", '[method]\nlines = "d-optimal:9"', "lines =", "as an array"),
        (
            "level = 2.0",
            "level = 2.0\nnoise = { relative = 0.02 }",
            "[locate]",
            "state the same noise",
        ),
        ("[locate.places]", "most = 0\n\n[locate.places]", "most = 0", "a number of at least 1"),
        ("[locate]", "[candidates.a]\n\n[candidates.b]\n\n[locate]", "", "leave out the other"),
    ],
)
def test_errors_name_the_line(job, capsys, old, new, line, message) -> None:
    edit(job, old, new)
    assert main(["compare", str(job)]) == 2
    said = capsys.readouterr().err
    assert message in said
    if line:
        text = job.read_text(encoding="utf-8")
        number = text[: text.index(line)].count("\n") + 1
        assert f"job.toml:{number}:" in said
    assert not job.with_name("job-compare").exists()


def test_workers_are_refused(job, capsys) -> None:
    assert main(["compare", str(job), "--workers", "2"]) == 2
    assert "leave out --workers" in " ".join(capsys.readouterr().err.split())
    assert not job.with_name("job-compare").exists()


def test_one_level_is_not_enough(job, capsys) -> None:
    text = job.read_text(encoding="utf-8")
    start, end = text.index('[[test]]\nname = "high"'), text.index("[[parameter]]")
    job.write_text(text[:start] + text[end:], encoding="utf-8")
    assert main(["compare", str(job)]) == 2
    assert "two levels or more, found one" in capsys.readouterr().err
