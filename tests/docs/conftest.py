"""The inputs of the chain demo, made once: what the pages speak of."""

from __future__ import annotations

from pathlib import Path

import pytest

from updyn.demos import find_demo


@pytest.fixture(scope="session")
def chain_inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    find_demo("chain").write_inputs(folder)
    return folder
