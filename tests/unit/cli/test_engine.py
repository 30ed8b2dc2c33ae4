"""Where the work is done, as the command line is told."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import updyn
from overriding import override
from updyn.cli import main
from updyn.cli.commands import open_engine
from updyn.cli.settings import WAITING
from updyn.engines import KINDS, Engine, Serial
from updyn.errors import OptionError

JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[output]
report = false
"""

#: Exit code of a run whose model has wrong masses, which are held: its answer is not believed.
WRONG_MASSES = 3


@pytest.fixture
def job(chain_folder: Path) -> Path:
    path = chain_folder / "job.toml"
    path.write_text(JOB, encoding="utf-8")
    return path


def test_workers_change_nothing_but_where(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(job)]) == WRONG_MASSES
    two = str(job.parent / "two")
    assert main(["run", str(job), "--workers", "2", "--out", two]) == WRONG_MASSES
    one, two = (updyn.read_result(job.parent / name / "run.nc") for name in ("job", "two"))
    assert (one.options["engine"], two.options["engine"]) == ("serial", "2 processes")
    assert two.values == pytest.approx(one.values, rel=1e-12)
    assert [h.stage for h in two.history] == [h.stage for h in one.history]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--workers", "0"], "--workers 0: expected a number of processes from 1 up"),
        (["--workers", "100000"], "100000 processes; expected at most"),
        (["--workers", "two"], 'unable to convert "two" into int'),
        (
            ["--workers", "2", "--cluster", "tcp://127.0.0.1:1"],
            "--workers and --cluster exclude each other",
        ),
        (["--cluster", "nonsense://x"], "--cluster 'nonsense://x': no scheduler answers"),
        (["--cluster", "somewhere"], "--cluster 'somewhere': expected host and port, such as tcp:"),
        (["--cluster", "tcp://somewhere"], "--cluster 'tcp://somewhere': expected host and port"),
        (["--cluster", "tcp://1.2.3.4:x"], "--cluster 'tcp://1.2.3.4:x': expected host and port"),
        (["--cluster", ""], "--cluster '': expected host and port"),
    ],
)
def test_refusals(
    job: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(job), *options]) == 2
    shown = capsys.readouterr()
    assert message in shown.err.replace("\n", " ")
    assert shown.out == ""
    assert not (job.parent / "job").exists()


class Named(Serial):
    """An engine as another package may add one."""

    expects = "'named'"
    name = "named"

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        return cls() if isinstance(option, str) and option == "named" else None


def test_an_engine_of_another_package(
    job: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(KINDS, "_entries", dict(KINDS._entries))
    KINDS.register("named", Named)
    assert main(["run", str(job), "--engine", "named"]) == WRONG_MASSES
    assert updyn.read_result(job.parent / "job" / "run.nc").options["engine"] == "named"
    assert main(["run", str(job), "--engine", "nmaed", "--out", str(job.parent / "two")]) == 2
    shown = capsys.readouterr().err
    assert "--engine 'nmaed': no package that is installed registers an engine for this" in shown
    assert "--workers" in shown
    with (
        pytest.raises(OptionError, match="--engine excludes --workers"),
        open_engine(2, None, "named"),
    ):
        pass


def test_no_scheduler_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    override(monkeypatch, WAITING, scheduler_time=0.2)
    message = r"no scheduler answers .*`dask scheduler` starts"
    with pytest.raises(OptionError, match=message), open_engine(None, "tcp://127.0.0.1:1"):
        pass


def test_a_scheduler_that_is_not_there_leaves_nothing_behind(job: Path) -> None:
    distributed = pytest.importorskip("distributed")
    assert main(["run", str(job), "--cluster", "nonsense://x"]) == 2
    with pytest.raises(ValueError, match="No clients found"):
        distributed.default_client()
    assert (
        main(["run", str(job)]) == WRONG_MASSES
    )  # its files are written without asking the scheduler


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    message = r"pip install 'updyn\[cluster\]'"
    with pytest.raises(OptionError, match=message), open_engine(None, "tcp://127.0.0.1:1"):
        pass


def test_serial_by_default() -> None:
    with open_engine(None, None) as made:
        assert made.workers == 1
