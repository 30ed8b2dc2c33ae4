"""What a long study has found, a line of JSON each, so that it can be stopped and gone on with."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

#: A dataclass that says what is to be found.
T = TypeVar("T", bound=Any)


class Kept(Generic[T]):
    """Findings by task, in a file where there is one.

    Parameters
    ----------
    path : Path or None
        File to read and to add to.
    find : callable
        Does a task; what it returns can be written as JSON.
    """

    def __init__(self, path: Path | None, find: Callable[[T], Any]) -> None:
        self.path = path
        self.find = find
        self.found: dict[str, Any] = {}
        if path is None or not path.exists():
            return
        text = path.read_text(encoding="utf-8")
        if text and not text.endswith("\n"):
            path.write_text(text + "\n", encoding="utf-8")
        for line in text.splitlines():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue  # of a run that was stopped while it wrote
            self.found[_key(entry["task"])] = entry["found"]

    def __getitem__(self, task: T) -> Any:
        return self.found[_key(asdict(task))]

    def make(self, tasks: Iterable[T], workers: int) -> None:
        """Do the tasks that are not done, and keep each finding as soon as it is made."""
        left = [task for task in tasks if _key(asdict(task)) not in self.found]
        for task, found in _made(left, self.find, workers):
            entry = asdict(task)
            self.found[_key(entry)] = found
            if self.path is not None:
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"task": entry, "found": found}) + "\n")


def _key(entry: dict[str, Any]) -> str:
    return json.dumps(entry, sort_keys=True)


def _made(tasks: list[T], find: Callable[[T], Any], workers: int) -> Iterator[tuple[T, Any]]:
    if workers == 1:
        yield from ((task, find(task)) for task in tasks)
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=workers, return_as="generator_unordered")
    yield from parallel(delayed(_paired)(find, task) for task in tasks)


def _paired(find: Callable[[T], Any], task: T) -> tuple[T, Any]:
    return task, find(task)
