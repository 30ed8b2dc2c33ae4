"""Every malformed job: exit code 2, one message that names file and line, no traceback, nothing written."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from places import DATA
from updyn.cli import main

BAD = sorted((DATA / "bad" / "job").glob("*.toml"))
#: First line of each file: the line that the message has to name (none: the file as a whole), and a
#: part of it.
EXPECT = re.compile(rb"# expect(?: (\d+))?: (.+)")


def listing(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_there_are_bad_jobs() -> None:
    assert len(BAD) >= 20


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("bad", BAD, ids=lambda p: p.stem)
def test_bad_job(
    bad: Path, command: str, chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = chain_folder / "job.toml"
    shutil.copy(bad, job)
    found = EXPECT.match(bad.read_bytes())
    assert found is not None
    line, fragment = found[1], found[2].decode()
    before = listing(chain_folder)

    assert main([command, str(job)]) == 2

    out, err = capsys.readouterr()
    assert err.startswith(f"error: {job}:{line.decode() + ':' if line else ''} ")
    assert fragment in err
    assert err.count("error:") == 1
    assert "Traceback" not in err
    assert out == ""
    assert listing(chain_folder) == before
    assert not (chain_folder / "job").exists()
