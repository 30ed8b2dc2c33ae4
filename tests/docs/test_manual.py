"""The manual: its pages are all in it, its tutorials run, its lists are those of the package."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import updyn
from pages import ROOT, blocks, run_python
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import Job
from updyn.registry import Registry, load_object

DOCS = ROOT / "docs"
SITE = DOCS / "site"


def script(path: Path) -> ModuleType:
    """Return a script of the repository as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["tutorial-records", "tutorial-servo"])
def test_tutorial_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "page"}
    ran = 0
    for block in blocks(DOCS / f"{name}.md"):
        run_python(block, name, namespace)
        ran += 1
    assert ran >= 5


def test_every_page_is_in_the_manual() -> None:
    """Each once, in one of the sections."""
    named: list[str] = []
    for page in SITE.glob("*.md"):
        for block in re.findall(r"^```{toctree}\n(.*?)^```$", page.read_text(), re.M | re.S):
            named += re.findall(r"^/(\S+)$", block, re.MULTILINE)
    pages = {p.relative_to(DOCS).with_suffix("").as_posix() for p in DOCS.glob("*.md")}
    globs = [name for name in named if "*" in name]
    single = [name for name in named if "*" not in name]
    matched = {p for p in pages if any(fnmatch(p, glob) for glob in globs)}
    assert sorted(single) == sorted(pages - matched | {"benchmarks/README"}), "see docs/site/use.md"


@pytest.mark.parametrize("page", sorted((DOCS / "notebooks").glob("*.md")), ids=lambda p: p.stem)
def test_notebooks_are_executed_and_check_their_numbers(page: Path) -> None:
    """By `make docs`: in Jupyter's own process, with their pictures, a cell that raises an error of the build."""
    head, cells = page.read_text(encoding="utf-8").split("---\n", 2)[1:]
    assert "file_format: mystnb" in head
    assert len(re.findall(r"^```{code-cell} ipython3$", cells, re.MULTILINE)) >= 5
    assert len(re.findall(r"^ *assert ", cells, re.MULTILINE)) >= 2
    assert re.search(r"^plots\.", cells, re.MULTILINE)
    assert "raises-exception" not in cells


def test_settings_of_the_manual_make_a_failing_cell_an_error() -> None:
    settings = (SITE / "conf.py").read_text(encoding="utf-8")
    assert 'nb_execution_mode = "force"' in settings
    assert "nb_execution_raise_on_error = True" in settings


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_public_names_are_those_of_the_package() -> None:
    listed = (DOCS / "public-names.txt").read_text(encoding="utf-8").split()
    now = script(ROOT / "tools" / "public_names.py").public_names()
    assert listed == now, "docs/deprecation.md, then python tools/public_names.py"


def test_licences_list_every_dependency() -> None:
    text = (DOCS / "licences.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| ([\w-]+) \| (?!with)", text, re.MULTILINE)
    assert listed == list(script(ROOT / "tools" / "licences.py").named())
    assert "not installed" not in text


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None
    assert updyn.__version__ == project["version"] == cited[1]


def test_what_contributing_says_exists() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| \w+ [^|]*\| `[^`]*NAME[^`]*` \| `(\w+)` in `src/([^`]+)` \|", text, re.M
    )
    assert len(rows) == 9
    for name, path in rows:
        module = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert isinstance(load_object(f"{module}:{name}"), Registry), name
    for path in re.findall(r"`((?:src|tests|docs|benchmarks|tools)/[^`]*)`", text):
        assert "NAME" in path or (ROOT / path).exists(), path


def test_every_key_of_a_job_is_in_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    text = script(SITE / "reference.py").job_keys()
    for schema in (Job, *(JOB_TABLES[name].schema for name in JOB_TABLES)):
        for key in schema.model_fields:
            assert f"| `{key}` |" in text, key
    assert '| `quantity` | `"stiffness"`, `"mass"`' in text
    assert "| `prior_std` | number, above 0 |  |" in text


def test_pages_for_a_code_host_become_pages_of_the_site() -> None:
    pages = script(SITE / "pages.py")
    page = DOCS / "noise.md"
    text = "```python\n[a](b.md#c)\n```\n[x](damping.md#calibration) [y](../src/updyn/frf.py)\n"
    assert pages.to_site(text, page) == (
        "```python\n[a](b.md#c)\n```\n[x](#damping--calibration) y\n"
    )
    linked = pages.to_site("[t](../benchmarks/README.md#noise)", page)
    assert linked == "[t](site/api/measured.md#noise)"
    assert pages.to_site('<a id="digest"></a>', DOCS / "formats.md") == "(formats--digest)="


def test_a_problem_of_the_field_is_written_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    kept = set(sys.modules)
    field = script(ROOT / "benchmarks" / "field.py")
    there = field.write(tmp_path, "chain")
    exact = field.score(there, there / "truth.csv")
    assert exact["unknowns"] == 12
    assert exact["within 1 %"] == 1.0
    assert exact["largest error"] == 0.0
    rows = (there / "truth.csv").read_text().splitlines()
    name, value = rows[0].split(",")
    off = tmp_path / "off.csv"
    off.write_text("\n".join([f"{name},{float(value) * 1.2},0.1", *rows[1:-1]]))
    found = field.score(there, off)
    assert found["within 1 %"] == pytest.approx(10 / 12)
    assert found["largest error"] == float("inf")
    assert found["covered"] in (0.0, 1.0)
    for module in set(sys.modules) - kept:
        sys.modules.pop(module, None)


def test_of_the_measured_beam_predicted_frfs_are_scored(tmp_path: Path) -> None:
    field = script(ROOT / "benchmarks" / "field.py")
    there = field.write(tmp_path, "beam")
    held_out = updyn.read_frf(there / "held-out.npz")
    assert held_out.responses.labels == ["103:Z", "107:Z"]
    assert 100.0 <= held_out.freq[0] < held_out.freq[-1] <= 4500.0
    predicted = tmp_path / "predicted.npz"
    factor = np.array([1.1, 0.7])[:, None]
    updyn.write_frf(replace(held_out, values=held_out.values * factor), predicted)
    found = field.score(there, predicted)
    assert found["median residual"] == pytest.approx(0.2)
    assert found["largest residual"] == pytest.approx(0.3)
    updyn.write_frf(held_out.select(responses=["107:Z", "103:Z"]), predicted)
    with pytest.raises(SystemExit, match=r"responses are not those of held-out\.npz"):
        field.score(there, predicted)
