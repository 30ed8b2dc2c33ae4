"""README, tutorial and examples run as they stand; names and links in the pages exist."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import updyn
from pages import ROOT, SKIPPED, blocks, run_console, run_python, save_toml
from updyn.job import load_job, prepare
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import Job

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "docs" / "benchmarks" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "notebooks").glob("*.md")),
]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("name", ["README.md", "docs/tutorial.md", "docs/python.md"])
def test_page_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "page"}
    commands = python = 0
    for block in blocks(ROOT / name):
        if block.language == "console":
            commands += run_console(block, name)
        elif block.language == "python":
            run_python(block, name, namespace)
            python += 1
        elif block.language == "toml":
            save_toml(block)
    assert commands >= 4 or name == "docs/python.md"
    assert python >= 1


def test_only_what_installs_is_skipped() -> None:
    shown = [
        line
        for page in PAGES[:1]
        for b in blocks(page)
        if b.language == "console"
        for line in b.text.splitlines()
    ]
    assert [line for line in shown if line in SKIPPED] == list(SKIPPED)


def test_the_job_of_the_readme_can_be_run(chain_inputs: Path) -> None:
    block = next(b for b in blocks(ROOT / "README.md") if b.language == "toml")
    path = chain_inputs / "readme.toml"
    path.write_text(block.text, encoding="utf-8")
    assert len(prepare(load_job(path)).parameters) == 12
    path.unlink()


def test_toml_on_the_pages_is_toml() -> None:
    known = {*Job.model_fields, *JOB_TABLES}
    for page in PAGES:
        for block in blocks(page):
            if block.language == "toml":
                table = tomllib.loads(block.text)
                assert set(table) <= known or "group" in table, f"{page.name}:{block.line}"


def test_every_public_name_is_on_its_page_and_no_other() -> None:
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    table = text.split("| name | does |")[1].split("\n\n")[0]
    named = {
        name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])
    }
    assert named == set(updyn.__all__) - {"__version__"}


def anchors(page: Path) -> set[str]:
    text = re.sub(
        r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    made = {
        re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-")
        for h in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    }
    return made | set(re.findall(r'<a id="([^"]+)">', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_resolve(page: Path) -> None:
    text = re.sub(
        r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("https://", "http://")):
            continue
        file, _, anchor = target.partition("#")
        there = page if not file else page.parent / file
        assert there.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(there), f"{page.name}: {target}"


def test_a_broken_link_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One\n[a](#two) [b](gone.md)", encoding="utf-8")
    with pytest.raises(AssertionError, match="#two"):
        test_links_resolve(page)
    page.write_text("# One\n[a](#one) [b](gone.md)", encoding="utf-8")
    with pytest.raises(AssertionError, match="gone"):
        test_links_resolve(page)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda p: p.stem)
def test_example_runs(script: Path, tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-W", "error", str(script)],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=tmp_path,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert len(ended.stdout.splitlines()) > 3
    assert list(tmp_path.iterdir()) == []
