"""The kept scripts are what their sources give, by digests always and by another build where node and its packages are at hand."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SOURCES = ROOT / "viewer"
PACKAGE = ROOT / "src" / "updyn"
#: By name: folder of the kept file in the package, folder of the sources, and whose licences it holds.
BUNDLES = {
    "viewer": ("viewer/assets", "src", ("three.js authors", "Matt DesLauriers")),
    "channels": ("report/assets", "channels", ("Leon Sorokin",)),
}
each = pytest.mark.parametrize("name", BUNDLES)


def record(name: str) -> dict:
    path = PACKAGE / BUNDLES[name][0] / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))


def digest(path: Path) -> str:
    text = path.read_text(encoding="utf-8").replace("\r\n", "\n")
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


@each
def test_the_kept_file_was_made_from_these_sources(name):
    kept, folder, _ = BUNDLES[name]
    files = [SOURCES / file for file in ("build.mjs", "package.json", "package-lock.json")]
    files += sorted((SOURCES / folder).iterdir())
    found = {path.relative_to(SOURCES).as_posix(): digest(path) for path in files}
    assert found == record(name)["sources"], "run make viewer"
    assert digest(PACKAGE / kept / f"{name}.min.js") == record(name)["bundle"], "run make viewer"


def test_another_build_gives_the_kept_files(tmp_path):
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("node and npm are not installed: the digests are all that was compared")
    place = tmp_path / "viewer"
    shutil.copytree(SOURCES, place, ignore=shutil.ignore_patterns("node_modules"))
    for kept, _, _ in BUNDLES.values():
        shutil.copytree(PACKAGE / kept, tmp_path / "src" / "updyn" / kept)
    command = [npm, "ci", "--no-audit", "--no-fund", "--prefer-offline"]
    try:
        done = subprocess.run(
            command, cwd=place, capture_output=True, text=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip("npm ci takes too long here: the digests are all that was compared")
    if done.returncode:
        pytest.skip(
            f"npm ci does not work here, the digests are all that was compared: {done.stderr[-200:]}"
        )
    checked = [node, "build.mjs", "--check"]
    done = subprocess.run(
        checked, cwd=place, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_lock_file_names_the_public_registry_only():
    lock = json.loads((SOURCES / "package-lock.json").read_text(encoding="utf-8"))
    resolved = [package.get("resolved", "") for package in lock["packages"].values()]
    assert all(not at or at.startswith("https://registry.npmjs.org/") for at in resolved)
    own = lock["packages"][""]["devDependencies"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in own.values())
    assert own == record("viewer")["versions"] | record("channels")["versions"]


@each
def test_licences_are_kept_and_nothing_evaluates_text(name):
    kept, _, authors = BUNDLES[name]
    text = (PACKAGE / kept / f"{name}.min.js").read_text(encoding="utf-8")
    assert "Permission is hereby granted" in text
    for author in authors:
        assert author in text
    assert not re.search(r"\beval\(|new Function\(", text)
