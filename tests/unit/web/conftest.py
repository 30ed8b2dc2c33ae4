"""The window is an extra: without it these tests are skipped. A folder of the chain demo to work in."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

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
