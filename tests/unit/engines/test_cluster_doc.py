"""docs/cluster.md: its blocks run, its options exist, its numbers are those of the code."""

from __future__ import annotations

import re

import numpy as np
import pytest
from distributed.cli import dask_scheduler, dask_worker

import updyn
from places import ROOT
from updyn.demos import find_demo
from updyn.engines.settings import WORKERS

TEXT = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
ADDRESS = "tcp://10.0.0.1:8786"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_commands_and_their_options_exist():
    commands = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}
    shown = [line.split() for block in blocks("console") for line in block.splitlines()]
    assert [words[:2] for words in shown] == [["dask", "scheduler"], ["dask", "worker"]]
    for words in shown:
        known = {option for p in commands[words[1]].params for option in p.opts}
        assert {w for w in words if w.startswith("--")} <= known
    assert shown[1][2] == ADDRESS


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    find_demo("chain").write_inputs(folder)
    return folder


def test_the_python_blocks_run_and_give_the_same(inputs, client, dask_processes):
    model = updyn.read_model(inputs / "chain.h5")
    frf = updyn.read_frf(inputs / "chain.uff")
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    alone = updyn.update(model, frf, unknowns)
    names = {"updyn": updyn, "model": model, "frf": frf, "unknowns": unknowns}
    for block, engine in zip(blocks("python"), ("2 processes", "dask, 2 workers"), strict=True):
        assert f'`"{re.sub(r"[0-9]+", "4" if "dask" in engine else "2", engine)}"`' in TEXT
        exec(block.replace(ADDRESS, dask_processes.address), names)
        result = names["result"]
        assert result.options["engine"] == engine
        assert result.status == alone.status
        np.testing.assert_allclose(
            list(result.values.values()), list(alone.values.values()), rtol=1e-12
        )


def test_numbers_are_those_of_the_code():
    assert WORKERS.cluster_patience == 60
    assert "waits up to a minute" in TEXT
    assert WORKERS.most_losses == 3
    assert "three times more without a result" in TEXT
