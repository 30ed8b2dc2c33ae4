"""docs/cluster.md: its blocks and scripts run, its options exist, its numbers are those of the code."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

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
    for block, engine in zip(blocks("python"), ("2 processes", "dask, 2 workers"), strict=False):
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


# -- SLURM and PBS ---------------------------------------------------------------------------------
def script(marker: str) -> str:
    """The only Python or bash block with a text in it."""
    (found,) = (block for block in (*blocks("python"), *blocks("bash")) if marker in block)
    return found


#: The port of the dashboard may be in use.
ANY_PORT = {"scheduler_options": {"dashboard_address": ":0"}}


def jobs_on_this_machine(options: dict[str, object]) -> type:
    """A class in place of `SLURMCluster`: one job, by dask-jobqueue if it is installed."""
    try:
        from dask_jobqueue.local import LocalCluster
    except ImportError:
        from distributed import LocalCluster

        class Cluster(LocalCluster):
            def __init__(self, **given):
                options.update(given)
                super().__init__(2, threads_per_worker=1, dashboard_address=":0")

            def scale(self, n=None, jobs=None):
                if jobs is None:
                    return super().scale(n)
                return None

    else:

        class Cluster(LocalCluster):  # type: ignore[no-redef]
            def __init__(self, **given):
                options.update(given)
                for name in ("queue", "account", "walltime", "job_cpu", "job_script_prologue"):
                    del given[name]
                super().__init__(**given | {"cores": 2, "processes": 2}, **ANY_PORT)

            def scale(self, n=None, jobs=0):
                return super().scale(n, jobs=jobs // 8)

    return Cluster


# dask-jobqueue kills the processes of its local jobs without waiting for them.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_workers_are_started_as_jobs(inputs, monkeypatch):
    options: dict[str, object] = {}
    cluster = jobs_on_this_machine(options)
    module = sys.modules.get("dask_jobqueue") or ModuleType("dask_jobqueue")
    monkeypatch.setitem(sys.modules, "dask_jobqueue", module)
    monkeypatch.setattr(module, "SLURMCluster", cluster, raising=False)
    model = updyn.read_model(inputs / "chain.h5")
    frf = updyn.read_frf(inputs / "chain.uff")
    unknowns = updyn.parameters(model, stiffness=["part1"])
    names = {"updyn": updyn, "model": model, "frf": frf, "unknowns": unknowns}
    exec(script("SLURMCluster(").replace("for_workers(4)", "for_workers(2, timeout=60)"), names)
    assert names["result"].options["engine"] == "dask, 2 workers"
    assert options["cores"] == options["processes"] == 4


@pytest.mark.parametrize("kind", ["SLURM", "PBS"])
def test_the_jobs_of_both_have_four_workers(kind):
    jobqueue = pytest.importorskip("dask_jobqueue")
    (options,) = re.findall(r"SLURMCluster\((.*?)\n\)", TEXT, re.DOTALL)
    if kind == "PBS":
        (instead,) = re.findall(r"`(resource_spec=.*?)` instead of\s`job_cpu`", TEXT)
        options = options.replace("job_cpu=16", instead)
    names = {f"{kind}Cluster": getattr(jobqueue, f"{kind}Cluster"), "ANY_PORT": ANY_PORT}
    with eval(f"{kind}Cluster({options} **ANY_PORT)", names) as cluster:
        job = cluster.job_script()
    assert "--nthreads 1" in job
    assert "--nworkers 4" in job
    assert job.rstrip().endswith("--memory-limit 0")
    assert ("--cpus-per-task=16" if kind == "SLURM" else "select=1:ncpus=16:mem=64GB") in job


@pytest.fixture
def submitted(tmp_path, monkeypatch):
    """A folder with the files of the page, and commands that stand for those of a cluster."""
    commands = tmp_path / "bin"
    commands.mkdir()
    for name in ("scontrol", "qsub", "sbatch", "srun"):
        write_command(commands / name, f'echo "{name} $*" >> log\necho 17')
    write_command(commands / "python", f'exec "{sys.executable}" "$@"')
    write_command(commands / "updyn", f'exec "{sys.executable}" -m updyn "$@"')
    for name, marker in (
        ("run.sh", "scontrol requeue"),
        ("bootstrap.sh", "python bootstrap.py"),
        ("bootstrap.py", "first=50 * task"),
        ("merge.py", "merge_draws(parts)"),
        ("plan.sh", "updyn plan"),
    ):
        (tmp_path / name).write_text(script(marker), encoding="utf-8")
    monkeypatch.setenv("PATH", str(commands), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_command(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)


def run_job(path: str, **variables: str) -> int:
    """Run a script as a job, which starts elsewhere."""
    folder = Path.cwd()
    where = {"SLURM_SUBMIT_DIR": str(folder)} if "SLURM_JOB_ID" in variables else {}
    done = subprocess.run(
        ["bash", folder / path],
        cwd="/",
        env={**os.environ, "PBS_O_WORKDIR": str(folder), **where, **variables},
        check=False,
    )
    return done.returncode


needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="scripts are for bash")


@needs_bash
def test_scripts_are_valid():
    for block in blocks("bash"):
        subprocess.run(["bash", "-n"], input=block, text=True, check=True)


@needs_bash
def test_a_bootstrap_in_parts_is_that_of_one_run(submitted, inputs):
    model, frf = updyn.read_model(inputs / "chain.h5"), updyn.read_frf(inputs / "chain.uff")
    result = updyn.update(model, frf, updyn.parameters(model, stiffness="all"), starts=0)
    (submitted / "job").mkdir()
    updyn.write_result(result, submitted / "job/run.nc")
    part = submitted / "bootstrap.py"
    part.write_text(part.read_text().replace("50", "2"))
    assert run_job("bootstrap.sh", SLURM_JOB_ID="1", SLURM_ARRAY_TASK_ID="0") == 0
    assert run_job("bootstrap.sh", PBS_ARRAY_INDEX="1") == 0
    kept = (submitted / "draws-1.nc").stat().st_mtime_ns
    assert run_job("bootstrap.sh", PBS_ARRAY_INDEX="1") == 0
    assert (submitted / "draws-1.nc").stat().st_mtime_ns == kept
    exec(script("merge_draws(parts)"), {})
    draws = updyn.read_uncertainty("uncertainty.nc", result)
    np.testing.assert_array_equal(draws.values, updyn.bootstrap(result, 4).values)
    assert (submitted / "report.html").is_file()


@needs_bash
@pytest.mark.parametrize(
    ("variables", "next_job"),
    [({"SLURM_JOB_ID": "23"}, "scontrol requeue 23"), ({}, "qsub run.sh")],
)
def test_a_run_out_of_time_is_continued(submitted, variables, next_job):
    write_command(submitted / "bin/updyn", 'echo "updyn $*" > call; sleep 9 & wait')
    run = submitted / "run.sh"
    run.write_text(run.read_text().replace("230m", "0.5"))
    assert run_job("run.sh", **variables) == 124
    assert (submitted / "call").read_text() == "updyn run job.toml --workers 4 --resume\n"
    assert (submitted / "log").read_text() == f"{next_job}\n"
    write_command(submitted / "bin/updyn", "exit 3")
    assert run_job("run.sh", **variables) == 3
    assert (submitted / "log").read_text() == f"{next_job}\n"


@needs_bash
@pytest.mark.parametrize(("command", "option"), [("sbatch", "--dep"), ("qsub", "-W dep")])
def test_steps_wait_for_each_other(submitted, command, option):
    block = script(f"array=$({command}")
    subprocess.run(["bash", "-e"], input=block, text=True, check=True)
    lines = (submitted / "log").read_text().splitlines()
    assert [line.split()[-1] for line in lines] == ["run.sh", "bootstrap.sh", "merge.sh"]
    assert [option in line and "afterok:17" in line for line in lines] == [False, True, True]


@needs_bash
def test_plans_are_made_one_for_each_number(submitted, capsys):
    find_demo("chain").write_inputs(submitted)
    (submitted / "plan.toml").write_text(
        '[model]\nfile = "chain.h5"\n[[parameter]]\ngroups = ["part1"]\nquantity = "stiffness"\n'
        "[plan]\nn_sensors = 3\nn_references = 1\nband = [1.0, 20.0]\n"
    )
    plan = submitted / "plan.sh"
    plan.write_text(
        plan.read_text().replace("(4 6 8 12)", "(2 4)").replace("workers 4", "workers 1")
    )
    assert run_job("plan.sh", SLURM_JOB_ID="1", SLURM_ARRAY_TASK_ID="0") == 0
    assert run_job("plan.sh", PBS_ARRAY_INDEX="1") == 0
    exec(script('plan["radius"]'), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["plan-2-plan", "plan-4-plan"]
    assert float(lines[1].split()[1]) < float(lines[0].split()[1])
