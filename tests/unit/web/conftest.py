"""The window is an extra: without it these tests are skipped. A folder of the chain demo to work in."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from forked_server import forked_context
from updyn.demos import chain

pytest.importorskip("nicegui")


@pytest.fixture(scope="session")
def chain_made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    chain.write_inputs(folder)
    return folder


@pytest.fixture
def chain_project(chain_made: Path, tmp_path: Path) -> Path:
    """A fresh copy of the demo: ``chain.h5``, ``chain.uff``, ``job.toml``."""
    folder = tmp_path / "project"
    shutil.copytree(chain_made, folder)
    return folder


@pytest.fixture(autouse=True)
def fork_processes_of_desks(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new interpreter imports for a second; tests of the process itself start one."""
    if request.path.name not in ("test_confinement.py", "test_desk.py"):
        forked = SimpleNamespace(get_context=lambda _: forked_context())
        monkeypatch.setattr("updyn.web.desk.multiprocessing", forked)
