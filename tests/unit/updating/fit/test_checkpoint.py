"""The journal: what was evaluated is not evaluated again, whatever befalls the file; only the same run goes on."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.updating.fit.checkpoint import Checkpoint, _frame
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.settings import EVALUATION

HEAD = {"updyn": "1", "model": "a", "data": "b", "unknowns": {"p": [1.0]}, "options": {"seed": "0"}}
RECORDS = {
    b"0" * 16: (np.array(1.5), np.arange(6.0).reshape(2, 3), np.zeros(0)),
    b"1" * 16: (np.array([1 + 2j, np.nan]),),
    b"2" * 16: (np.arange(3),),
}


@pytest.fixture
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture
def data(chain12_frf, add_noise):
    return add_noise(chain12_frf, np.random.default_rng(11), 0.01)


@pytest.fixture
def file(tmp_path):
    """A checkpoint of three records."""
    journal = Checkpoint(tmp_path / "run.journal", HEAD)
    for key, record in RECORDS.items():
        journal.store(key, record)
    journal.close()
    return journal.path


@pytest.fixture
def evaluated(monkeypatch):
    """Count the blocks of lines that are really solved."""
    solved, block = [], FRFPart.block

    def counting(self, x, lines, **more):
        solved.append(lines)
        return block(self, x, lines, **more)

    monkeypatch.setattr(FRFPart, "block", counting)
    return solved


def same(a, b):
    return len(a) == len(b) and all(
        x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()
        for x, y in zip(a, b, strict=True)
    )


def outcome(result):
    return (
        result.status,
        result.values,
        result.std,
        result.history,
        result.correlation,
        result.noise,
    )


def known(file):
    with closing(Checkpoint(file, HEAD, resume=True)) as journal:
        return len(journal)


# -- the file --------------------------------------------------------------------------------------------------------
def test_records_come_back_to_the_bit(file):
    journal = Checkpoint(file, HEAD, resume=True)
    assert known(file) == 3
    assert all(same(journal.get(key), record) for key, record in RECORDS.items())
    assert journal.get(b"3" * 16) is None
    journal.store(b"3" * 16, (np.ones(2),))
    assert same(journal.get(b"0" * 16), RECORDS[b"0" * 16])
    journal.close()
    assert known(file) == 4


def test_a_record_that_was_cut_short_is_left_out_and_written_anew(file):
    whole = file.read_bytes()
    two = len(whole) - (8 + 16 + len(np_bytes(RECORDS[b"2" * 16])) + 16)
    for end in (*range(two, len(whole), 7), len(whole) - 1):
        file.write_bytes(whole[:end])
        journal = Checkpoint(file, HEAD, resume=True)
        assert len(journal) == 2
        journal.store(b"2" * 16, RECORDS[b"2" * 16])
        journal.close()
        assert file.read_bytes() == whole


def np_bytes(record):
    buffer = io.BytesIO()
    for array in record:
        np.save(buffer, array)
    return buffer.getvalue()


def test_a_damaged_record_and_what_follows_are_left_out(file):
    whole = bytearray(file.read_bytes())
    at = whole.index(b"1" * 16) + 40
    whole[at] ^= 1
    file.write_bytes(whole)
    with closing(Checkpoint(file, HEAD, resume=True)) as journal:
        assert len(journal) == 1
        assert same(journal.get(b"0" * 16), RECORDS[b"0" * 16])


def test_objects_are_not_unpickled(file):
    """An array of objects in a record with a good checksum is refused."""
    payload = np_bytes((np.array([{}], dtype=object),))
    with file.open("ab") as out:
        out.write(_frame(b"9" * 16 + payload))
    with (
        closing(Checkpoint(file, HEAD, resume=True)) as journal,
        pytest.raises(ValueError, match="allow_pickle"),
    ):
        journal.get(b"9" * 16)


def test_a_new_run_replaces_the_file_with_its_first_record(file):
    before = file.read_bytes()
    journal = Checkpoint(file, HEAD)
    assert journal.get(b"0" * 16) is None
    assert file.read_bytes() == before
    journal.store(b"5" * 16, (np.ones(1),))
    journal.close()
    assert known(file) == 1
    assert [p.name for p in file.parent.iterdir()] == ["run.journal"]


def test_a_run_that_evaluates_nothing_leaves_no_file(tmp_path):
    Checkpoint(tmp_path / "run.journal", HEAD).close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"updyn": "2"}, "updyn 1 wrote the file, this is 2"),
        ({"model": "x"}, "the model differs"),
        ({"data": "x"}, "the data differ"),
        ({"unknowns": {"p": [2.0], "q": [1.0]}}, r"the unknowns differ \(p, q\)"),
        ({"options": {"seed": "1"}, "data": "x"}, r"the data differ, the options differ \(seed\)"),
    ],
)
def test_another_run_is_refused_and_told_apart(file, change, message):
    before = file.read_bytes()
    with pytest.raises(OptionError, match=f"run.journal' is of another run: {message}"):
        Checkpoint(file, {**HEAD, **change}, resume=True)
    assert file.read_bytes() == before


def test_what_is_no_journal_is_refused(tmp_path, file):
    with pytest.raises(OptionError, match="the folder does not exist"):
        Checkpoint(tmp_path / "no" / "run.journal", HEAD)
    whole = file.read_bytes()
    for content, message in (
        (b"", "is not a checkpoint"),
        (b"PK" + whole, "is not a checkpoint"),
        (whole[:60], "its header is damaged"),
    ):
        file.write_bytes(content)
        with pytest.raises(FormatError, match=message):
            Checkpoint(file, HEAD, resume=True)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a disk that is full")  # noqa: PTH110
def test_a_full_disk_does_not_end_the_run(file):
    journal = Checkpoint(file, HEAD, resume=True)
    journal._file.close()
    journal._file = open("/dev/full", "r+b", buffering=0)  # noqa: PTH123, SIM115
    with pytest.warns(
        UpdynWarning, match="cannot be written .*; the run continues, but cannot be resumed"
    ):
        journal.store(b"7" * 16, (np.ones(3),))
    journal.store(b"8" * 16, (np.ones(3),))
    assert len(journal) == 3
    journal.close()


def test_a_disk_that_fills_leaves_what_was_written(tmp_path):
    """What was refused is not written later, where a reader would take it for a record."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with closing(Checkpoint(tmp_path / "run.journal", HEAD)) as journal:
        journal.store(b"1" * 16, (np.arange(100.0),))
        size = (tmp_path / "run.journal").stat().st_size
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, limits[1]))
            with pytest.warns(UpdynWarning, match="cannot be written"):
                journal.store(b"2" * 16, (np.arange(100.0),))
            assert (journal.get(b"1" * 16)[0] == np.arange(100.0)).all()
            assert journal.get(b"2" * 16) is None
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with closing(Checkpoint(tmp_path / "run.journal", HEAD, resume=True)) as journal:
        assert len(journal) == 1


def test_a_disk_that_is_full_from_the_start_does_not_end_the_run_either(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    journal = Checkpoint(tmp_path / "run.journal", HEAD)
    with pytest.warns(UpdynWarning, match="cannot be written .No space left"):
        journal.keep()
    journal.store(b"7" * 16, (np.ones(3),))
    journal.close()
    assert len(journal) == 0


# -- runs ------------------------------------------------------------------------------------------------------------
METHODS = [
    ("maximum-likelihood", {}),
    ("log", {"lines": "d-optimal:30"}),
    ("output-error", {"validation": ["7:X"]}),
    ("equation-error", {}),
    ("equation-error", {"solver": "gauss-newton", "max_iterations": 6}),
]


@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_run_that_is_resumed_after_its_end_solves_nothing_and_answers_the_same(
    chain12, data, unknowns, tmp_path, evaluated, method, options
):
    path = tmp_path / "run.journal"
    plain = updyn.update(chain12, data, unknowns, method=method, **options)
    assert evaluated or method == "equation-error"
    kept = updyn.update(chain12, data, unknowns, method=method, checkpoint=path, **options)
    assert outcome(kept) == outcome(plain)
    size = path.stat().st_size
    evaluated.clear()
    again = updyn.update(
        chain12, data, unknowns, method=method, checkpoint=path, resume=True, **options
    )
    assert outcome(again) == outcome(plain)
    assert evaluated == []
    assert path.stat().st_size == size


@pytest.mark.parametrize(("method", "options"), METHODS)
def test_a_run_that_broke_off_anywhere_goes_on_to_the_same_answer(
    chain12, data, unknowns, tmp_path, method, options
):
    path = tmp_path / "run.journal"
    full = updyn.update(chain12, data, unknowns, method=method, checkpoint=path, **options)
    whole = path.read_bytes()
    start = whole.index(b"\x93NUMPY") - 24
    for end in np.linspace(start, len(whole), 5).astype(int)[:-1]:
        path.write_bytes(whole[:end])
        found = updyn.update(
            chain12, data, unknowns, method=method, checkpoint=path, resume=True, **options
        )
        assert outcome(found) == outcome(full)
        assert path.read_bytes() == whole


def test_a_stopped_run_goes_on_to_the_same_answer(chain12, data, unknowns, tmp_path, monkeypatch):
    override(monkeypatch, EVALUATION, block_bytes=16 * (12 * 12 + 12 * 10 + 12 * 25) * 7)
    override(monkeypatch, EVALUATION, long_work=0.0)
    path, shown = tmp_path / "run.journal", []
    full = updyn.update(chain12, data, unknowns, callback=lambda p: shown.append(p) or False)
    for number in (0, 3, 20, 60):
        seen = []
        stopped = updyn.update(
            chain12,
            data,
            unknowns,
            checkpoint=path,
            callback=lambda p, n=number, s=seen: s.append(p) or len(s) > n,
        )
        assert stopped.status == "stopped"
        found = updyn.update(chain12, data, unknowns, checkpoint=path, resume=True)
        assert outcome(found) == outcome(full)


def test_more_steps_than_were_allowed_at_first(chain12, data, unknowns, tmp_path, evaluated):
    path = tmp_path / "run.journal"
    options = {"method": "output-error", "tolerance": 1e-12}
    full = updyn.update(chain12, data, unknowns, **options)
    whole = len(evaluated)
    evaluated.clear()
    few = updyn.update(chain12, data, unknowns, checkpoint=path, max_iterations=3, **options)
    assert few.status == "max-iterations"
    done = len(evaluated)
    evaluated.clear()
    found = updyn.update(chain12, data, unknowns, checkpoint=path, resume=True, **options)
    assert outcome(found) == outcome(full)
    assert len(evaluated) < whole
    assert done > 3


def test_everything_that_decides_the_answer_is_looked_at(chain12, data, unknowns, tmp_path):
    path = tmp_path / "run.journal"
    updyn.update(chain12, data, unknowns, method="log", checkpoint=path)
    moved = updyn.parameters(
        chain12, stiffness="all", mass="all", loss_factor="all", prior_std={"part1.mass": 0.1}
    )
    coherent = replace(data, coherence=np.full(data.values.shape, 0.9))
    for changes, message in (
        ({"model": chain12.scaled({"part1": {"mass": 1.01}})}, "the model differs"),
        ({"model": chain12.scaled({"part1": {"loss_factor": 0.05}})}, "the model differs"),
        ({"frf": data.select(responses=["2:X", "5:X", "7:X", "10:X"])}, "the data differ"),
        ({"frf": coherent}, "the data differ"),
        ({"parameters": moved}, r"the unknowns differ \(part1.mass\)"),
        ({"seed": 1}, r"the options differ \(seed\)"),
        (
            {"method": "output-error"},
            r"the options differ \(inflate, method, seed, starts\)",
        ),
        ({"lines": data.freq[::2]}, r"the options differ \(lines\)"),
        ({"noise": {"relative": 0.1}}, r"the options differ \(noise\)"),
        ({"validation": ["2:X"]}, r"the options differ \(validation\)"),
        ({"tier": "sparse"}, r"the options differ \(backend, tier\)"),
    ):
        arguments = {
            "model": chain12,
            "frf": data,
            "parameters": unknowns,
            "method": "log",
            **changes,
        }
        with pytest.raises(OptionError, match=message):
            updyn.update(**arguments, checkpoint=path, resume=True)


def test_where_there_is_no_file_the_run_begins_anew_and_says_so(
    chain12, data, unknowns, tmp_path, evaluated
):
    path = tmp_path / "run.journal"
    plain = updyn.update(chain12, data, unknowns, method="output-error")
    with pytest.warns(UpdynWarning, match=r"run\.journal' does not exist; the run begins anew"):
        found = updyn.update(
            chain12, data, unknowns, method="output-error", checkpoint=path, resume=True
        )
    assert outcome(found) == outcome(plain)
    evaluated.clear()
    again = updyn.update(
        chain12, data, unknowns, method="output-error", checkpoint=path, resume=True
    )
    assert outcome(again) == outcome(plain)
    assert evaluated == []


def test_resume_needs_a_checkpoint(chain12, data, unknowns):
    with pytest.raises(OptionError, match="expected the path of a checkpoint"):
        updyn.update(chain12, data, unknowns, resume=True)


# -- killed ----------------------------------------------------------------------------------------------------------
RUN = """
import json, os, signal, sys
import numpy as np
import updyn
from updyn.demos import chain
from updyn.updating.fit.checkpoint import Checkpoint

path, limit, resume = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "resume"
put = Checkpoint.store
def counted(self, key, record):
    put(self, key, record)
    if len(self) == limit:
        os.kill(os.getpid(), signal.SIGKILL)
Checkpoint.store = counted
model = chain.build()
unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
r = updyn.update(model, chain.measure(), unknowns, checkpoint=path, resume=resume)
history = [[h.stage, h.number, repr(h.cost), repr(h.step), h.accepted, {k: v.hex() for k, v in h.values.items()}]
           for h in r.history]
numbers = [{k: v.hex() for k, v in found.items()} for found in (r.values, r.std)]
print(json.dumps([r.status, *numbers, history]))
"""


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL on Windows")
def test_a_killed_process_is_resumed_to_the_same_bits(tmp_path):
    def run(path, limit, *resume):
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-c", RUN, str(path), str(limit), *(resume or ("fresh",))]
        return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)

    full = run(tmp_path / "whole", 0)
    assert full.returncode == 0, full.stderr
    path = tmp_path / "killed"
    assert run(path, 7).returncode == -signal.SIGKILL
    assert run(path, 15, "resume").returncode == -signal.SIGKILL
    found = run(path, 0, "resume")
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout) == json.loads(full.stdout)
    assert json.loads(full.stdout)[0] == "converged"
