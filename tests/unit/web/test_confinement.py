"""A process that is confined to a folder reads nothing outside it, whichever file names it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from updyn.errors import InputError
from updyn.foreign.confinement import check_inside
from updyn.io import read_geometry
from updyn.io.keyword_deck.cards import read_cards
from updyn.job import load_job
from updyn.job.prepare import prepare

#: In a process of its own: the confinement holds until it ends. What each file leads to, in order.
CHILD = """
import json, sys
from pathlib import Path
from updyn.errors import UpdynError
from updyn.foreign.confinement import confine
from test_confinement import size

confine(Path(sys.argv[1]))
found = []
for name in sys.argv[2:]:
    path = Path(name)
    try:
        found.append(size(path))
    except UpdynError as error:
        found.append([type(error).__name__, str(error)])
print(json.dumps(found))
"""
GRIDS = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\n"
NODES = "*NODE\n1, 0., 0., 0.\n2, 1., 0., 0.\n"
JOB = '{first}\n[model]\nfile = "{model}"\n[test]\nfile = "{test}"\n{more}\n[[parameter]]\ngroups = "all"\nquantity = "mass"\n'


def size(path: Path) -> int:
    """DOFs of the model of a job, or points of a deck."""
    if path.suffix == ".toml":
        return prepare(load_job(path)).model.n_dofs
    if path.suffix == ".inp":
        return sum(len(card.rows) for card in read_cards(path) if card.name == "NODE")
    return len(read_geometry(path).nodes)


def read_confined(folder: Path, names: list[Path]) -> list[int | list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(folder), *map(str, names)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )
    return list(json.loads(done.stdout))


def job(
    path: Path, model: str = "chain.h5", test: str = "chain.uff", more: str = "", first: str = ""
) -> Path:
    path.write_text(JOB.format(model=model, test=test, more=more, first=first))
    return path


@pytest.fixture
def outside(chain_project: Path) -> Path:
    """Beside the project, files like those in it, and a link in it to each."""
    folder = chain_project.parent / "outside"
    folder.mkdir()
    for name in ("chain.h5", "chain.uff"):
        (folder / name).write_bytes((chain_project / name).read_bytes())
    (folder / "part.bdf").write_text(GRIDS)
    (folder / "part.inp").write_text(NODES)
    for path in folder.iterdir():
        (chain_project / f"link-{path.name}").symlink_to(path)
    (chain_project / "folder").symlink_to(folder)
    return folder


def test_jobs(chain_project: Path, outside: Path) -> None:
    inside = [
        job(chain_project / "0.toml"),
        job(chain_project / "1.toml", model="../project/chain.h5", test=str(chain_project / "chain.uff")),
    ]  # fmt: skip
    named = [
        {"model": "../outside/chain.h5"},
        {"model": str(outside / "chain.h5")},
        {"model": "link-chain.h5"},
        {"model": "folder/chain.h5"},
        {"test": "../outside/chain.uff"},
        {"test": "link-chain.uff"},
        {"more": 'repeats = ["link-chain.uff"]'},
        {"more": '[match]\nby = "coordinates"\ngeometry = "link-chain.uff"'},
        {"model": "../outside/no-such.h5"},
        {"model": "/etc/passwd"},
        {"model": "loop"},
    ]
    (chain_project / "loop").symlink_to(chain_project / "loop")
    refused = [job(chain_project / f"x{n}.toml", **keys) for n, keys in enumerate(named)]
    found = read_confined(chain_project, [*inside, *refused])
    assert found[:2] == [12, 12]
    for path, keys, answer in zip(refused, named, found[2:], strict=True):
        assert isinstance(answer, list), keys
        expected = (
            "cannot be a file"
            if keys == {"model": "loop"}
            else "is outside the folder of the project"
        )
        assert expected in answer[1], keys
        assert answer[1].startswith(f"{path}:"), keys  # the line that names it
        assert "no such file" not in answer[1], keys
    # But for the confinement they could be read.
    assert [size(path) for path in refused[:6]] == [12] * 6


def test_decks(chain_project: Path, outside: Path) -> None:
    (chain_project / "part.bdf").write_text(GRIDS)
    (chain_project / "part.inp").write_text(NODES)
    (chain_project / "nested.bdf").write_text("INCLUDE '../outside/part.bdf'\n")
    (chain_project / "nested.inp").write_text("*INCLUDE, INPUT=../outside/part.inp\n")
    includes = [
        "part{}", "../project/part{}", "../outside/part{}", str(outside / "part{}"), "link-part{}",
        "folder/part{}", "nested{}", "../outside/no-such{}",
    ]  # fmt: skip
    decks = []
    for number, include in enumerate(includes):
        nastran = chain_project / f"{number}.bdf"
        nastran.write_text(f"BEGIN BULK\nINCLUDE '{include.format('.bdf')}'\nENDDATA\n")
        abaqus = chain_project / f"{number}.inp"
        abaqus.write_text(f"*HEADING\n*INCLUDE, INPUT={include.format('.inp')}\n")
        decks += [nastran, abaqus]
    data = chain_project / "data.inp"
    data.write_text("*HEADING\n*NODE, INPUT=../outside/nodes.txt\n")
    (outside / "nodes.txt").write_text("1, 0., 0., 0.\n2, 1., 0., 0.\n")
    found = read_confined(chain_project, [*decks, data])
    assert found[:4] == [2, 2, 2, 2]
    for deck, answer in zip([*decks, data][4:], found[4:], strict=True):
        assert isinstance(answer, list), deck
        assert "is outside the folder of the project" in answer[1], deck
        assert "no such file" not in answer[1], deck
    # What is refused could be read but for the confinement.
    readable = [*decks[4:14], data]
    assert [size(deck) for deck in readable] == [2] * 11


def test_a_process_that_is_not_confined_reads_anything(tmp_path: Path) -> None:
    check_inside(tmp_path / ".." / "anything")
    check_inside(Path("/etc/passwd"))


def test_the_message_says_what_to_do(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from updyn.foreign.confinement import *\n"
        "confine(Path('/no/such/folder')); confine(Path(sys.argv[1]))\n"
        "check_inside(Path(sys.argv[1]) / 'a')\n"
        "try: check_inside(Path('/a file'))\n"
        "except ValueError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True
    )
    assert done.stdout == (
        f"'/a file' is outside the folder of the project ({tmp_path}), and is not read; copy"
        " it into the project, or serve a folder that contains both\n"
    )
    assert issubclass(InputError, ValueError)
