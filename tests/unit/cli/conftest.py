"""A folder with the chain demo's model and measurement, made once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from updyn.demos import chain
from updyn.io import write_frf, write_model


@pytest.fixture(scope="session")
def chain_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chain")
    write_model(chain.build(), folder / "chain.h5")
    write_frf(chain.measure(), folder / "chain.npz")
    return folder


@pytest.fixture
def chain_folder(chain_files: Path, tmp_path: Path) -> Path:
    """A fresh copy to work in."""
    for file in chain_files.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path
