"""A process that is killed at a chosen call of the system, and what its folder holds afterwards."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from updyn.outputs.lock import LOCK
from updyn.outputs.manifest import MANIFEST, Manifest
from updyn.outputs.switch import open_folder, recover, replace_files

#: Calls that change what a folder holds, or say that it is on disk.
CALLS = ("fsync", "rename", "replace", "unlink", "rmdir", "mkdir")
KILLED = 9


def killed_at(number: int, work: Callable[[], object]) -> bool:
    """Whether work in a process of its own was killed right before a call; False: it ended before.

    Parameters
    ----------
    number : int
        Which of the calls of `CALLS`, counted from 0.
    work : callable
        What the process does.
    """
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        assert code in (0, KILLED), f"the process ended with {code}"
        return code == KILLED
    code = 1
    try:
        left = [number]

        def counted(call: Callable[..., Any]) -> Callable[..., Any]:
            def do(*arguments: Any, **more: Any) -> Any:
                if not left[0]:
                    os._exit(KILLED)
                left[0] -= 1
                return call(*arguments, **more)

            return do

        for name in CALLS:
            setattr(os, name, counted(getattr(os, name)))
        work()
        code = 0
    finally:
        os._exit(code)


def contents(folder: Path) -> dict[str, str]:
    """Files of a folder and their text, but for the manifest and a lock that a kill has left."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in (MANIFEST, LOCK):
            found[name] = path.read_text(encoding="utf-8")
    return found


def write_set(folder: Path, files: dict[str, str], command: str = "run") -> None:
    """Write a set of files, as a run does; those of an earlier run go."""
    with open_folder(folder):
        _write(folder, files, command)


def _write(folder: Path, files: dict[str, str], command: str) -> None:
    earlier = Manifest.read(folder).entries
    with replace_files(folder, command, (*files, *earlier)) as new:
        for name, text in files.items():
            (new / name).parent.mkdir(exist_ok=True)
            (new / name).write_text(text, encoding="utf-8")


def outcome(seed: int, folder: Path) -> str:
    """Kill a switch between two sets of files at random; say which set the folder holds afterwards.

    Parameters
    ----------
    seed : int
        Of sets, foreign files and the call at which the process is killed.
    folder : Path
        An empty folder.

    Returns
    -------
    str
        ``"old"``, ``"new"``, or what is wrong.
    """
    import random

    chance = random.Random(seed)
    names = [
        "model.h5",
        "run.nc",
        "result.json",
        "one test/model.h5",
        "two test/run.nc",
        "plant.mat",
    ]
    old = {n: f"old {seed} {n}" for n in chance.sample(names, chance.randint(0, 5))}
    new = {n: f"new {seed} {n}" for n in chance.sample(names, chance.randint(1, 5))}
    foreign = {"notes.txt": "mine", "one test/notes.txt": "mine", ".unfinished-x/y": "mine"}
    for name, text in foreign.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    if old:
        write_set(folder, old)
    number = chance.randint(0, 90)
    while not killed_at(number, lambda: write_set(folder, new)):
        number = chance.randint(0, number)
        if old:
            write_set(folder, old)
        else:
            return "new" if contents(folder) == {**foreign, **new} else "wrong after a whole switch"
    # The process that puts this right may be killed, too.
    killed_at(chance.randint(0, 30), lambda: recover(folder))
    recover(folder)
    found = contents(folder)
    leftovers = [p.name for p in folder.glob(".*ished-*") if p.name != ".unfinished-x"]
    if leftovers:
        return f"left behind: {leftovers}"
    for which, files in (("old", old), ("new", new)):
        if found == {**foreign, **files}:
            return which
    return f"neither old nor new: {found}"
