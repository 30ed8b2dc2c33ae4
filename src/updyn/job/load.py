"""`load_job`: read a TOML file into a `Job` and check its text."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError

from updyn.elements import MODEL_KINDS
from updyn.errors import JobError, OptionError, suggest
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import Job, MethodTable, Table
from updyn.job.toml_lines import Place, line_of, read_toml

__all__ = [
    "Complaint",
    "complaints",
    "load_job",
]

_NAME = re.compile(r"[\w-][\w -]*(?<! )")
_PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


def load_job(path: str | Path) -> Job:
    """Read a job file.

    Parameters
    ----------
    path : path
        The TOML file.

    Returns
    -------
    Job
        Checked as far as its text goes; the files that it names are not opened.

    Raises
    ------
    JobError
        If the file is not there, is not TOML, or holds an unknown key, a wrong value or too little.
        The message has one line for each complaint, each with its line in the file.
    """
    path = Path(path)
    text = _text(path)
    try:
        document, lines = read_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise _not_toml(error, text, path) from error
    tables, wrong = _further_tables(document, lines)
    jobs = []
    for one, own in _each_test(document, lines):
        try:
            jobs.append(Job.model_validate(one).with_source(path, own, tables))
        except ValidationError as error:
            wrong += complaints(error, own, Job)
    if wrong:
        raise _joined(sorted(set(wrong)), path)
    _check_model(jobs[0])
    _check_method(jobs[0])
    _check_tests(jobs)
    job = jobs[0].with_others(tuple(jobs[1:]))
    for name in job.tables:
        JOB_TABLES[name].check_text(job)
    return job


def _text(path: Path) -> str:
    if path.is_dir():
        raise JobError("is a folder; expected a job file (TOML)", path)
    if not path.is_file():
        siblings = [p.name for p in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise JobError(
            f"no such file; {suggest(path.name, siblings)}" if siblings else "no such file", path
        )
    raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise JobError(f"byte {raw[error.start]:#04x} is not UTF-8; TOML is", path, line) from error


def _not_toml(error: tomllib.TOMLDecodeError, text: str, path: Path) -> JobError:
    message = str(error)
    found = _PLACE.search(message)
    if found is None:
        return JobError(f"not TOML: {message}", path)
    column = f" at column {found[2]}" if found[2] else " at the end of the file"
    line = int(found[1]) if found[1] else text.rstrip("\n").count("\n") + 1
    return JobError(f"not TOML: {message[: found.start()]}{column}", path, line)


def _joined(found: Sequence[Complaint], path: Path) -> JobError:
    first, *others = found
    texts = [first.text]
    texts += [str(JobError(other.text, path, other.line or None)) for other in others]
    return JobError("\n".join(texts), path, first.line or None)


def _further_tables(
    document: dict[str, Any], lines: dict[Place, int]
) -> tuple[dict[str, Table], list[Complaint]]:
    """Take the tables of `JOB_TABLES` out of a document; return them, and what is wrong with them."""
    names = [name for name in document if name not in Job.model_fields and name in JOB_TABLES]
    if names:
        names = [name for name in JOB_TABLES if name in names]
    tables: dict[str, Table] = {}
    wrong: list[Complaint] = []
    for name in names:
        schema = JOB_TABLES[name].schema
        try:
            tables[name] = schema.model_validate(document.pop(name))
        except ValidationError as error:
            wrong += complaints(error, lines, schema, (name,))
    return tables, wrong


def _each_test(
    document: dict[str, Any], lines: dict[Place, int]
) -> Iterator[tuple[dict[str, Any], dict[Place, int]]]:
    """Yield the document with each of its tests, and where its parts stand then."""
    tests = document.get("test")
    if not (isinstance(tests, list) and tests and all(isinstance(t, dict) for t in tests)):
        yield document, lines
        return
    for i, test in enumerate(tests):
        elsewhere = {place: at for place, at in lines.items() if place[:1] != ("test",)}
        here = {("test", *place[2:]): at for place, at in lines.items() if place[:2] == ("test", i)}
        yield document | {"test": test}, elsewhere | here


def _check_tests(jobs: Sequence[Job]) -> None:
    """Check that several tests are told apart by names that can name folders."""
    seen: set[str] = set()
    for job in jobs if len(jobs) > 1 else ():
        name = job.test.name
        if not name:
            raise job.error(
                "one of several tests without a name; give each [[test]] its own", "test"
            )
        if not _NAME.fullmatch(name):
            raise job.error(
                f"test.name = {name!r}: expected letters, digits, blanks, - and _, as it names a"
                " folder",
                "test",
                "name",
            )
        if name.casefold() in seen:
            raise job.error(f"test.name = {name!r}: another test has that name", "test", "name")
        seen.add(name.casefold())


def _check_model(job: Job) -> None:
    table = job.model
    if table.file is not None and table.kind is not None:
        raise job.error("[model] has a file and a kind; expected one of the two", "model", "kind")
    if table.file is None and table.kind is None:
        for key in table.keys:  # a misspelt file or kind is the likelier mistake
            raise job.error(
                f"unknown key {key!r} in [model]; {suggest(key, ('file', 'format', 'kind'))}",
                "model",
                key,
            )
        raise job.error("[model] needs a file, or a kind with the keys of its builder", "model")
    if table.kind is not None:
        if table.kind not in MODEL_KINDS:
            raise job.error(
                f"model.kind = {table.kind!r}: {suggest(table.kind, MODEL_KINDS)}", "model", "kind"
            )
        if table.format is not None:
            raise job.error("model.format belongs to a file, not to a kind", "model", "format")


def _check_method(job: Job) -> None:
    from updyn.updating.fit.methods import METHODS, make_method, options_of
    from updyn.updating.fit.regularisation import check_regularise

    table = job.method
    if table.name not in METHODS:
        raise job.error(
            f"method.name = {table.name!r}: {suggest(table.name, METHODS)}", "method", "name"
        )
    try:
        check_regularise(table.regularise, table.name)
    except OptionError as error:
        raise job.error(str(error), "method", "regularise") from error
    known = options_of(table.name)
    for key in table.options:
        if key not in known:
            choices = [*MethodTable.model_fields, *known]
            raise job.error(
                f"unknown key {key!r} in [method] with name {table.name!r};"
                f" {suggest(key, choices)}",
                "method",
                key,
            )
    for key, value in table.options.items():
        try:
            make_method(table.name, {key: value})
        except OptionError as error:
            raise job.error(str(error), "method", key) from error


_LONGEST = 40  # characters of a value that a message repeats
_WORDS = {
    "bool_type": "expected true or false",
    "dict_type": "expected a table",
    "finite_number": "expected a finite number",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "list_type": "expected an array",
    "model_type": "expected a table",
    "string_type": "expected a text",
    "too_long": "too many entries",
    "too_short": "too few entries",
    "tuple_type": "expected an array",
}


class Complaint(NamedTuple):
    """Something wrong with the text of a job file; sorts unknown keys first, then by line."""

    of_known_key: bool
    line: int
    text: str


def complaints(
    error: ValidationError,
    lines: Mapping[Place, int],
    schema: type[BaseModel],
    at: Place = (),
) -> list[Complaint]:
    """Return what pydantic found wrong with a table as lines and sentences.

    Parameters
    ----------
    error : ValidationError
        What pydantic found.
    lines : mapping of Place to int
        Of the job file.
    schema : type
        Class by which the table was validated.
    at : Place
        Where the table is in the job file.

    Returns
    -------
    list of Complaint
        Sorted, they are in the order of the message: unknown keys first, then by line.
    """
    found = []
    items = [(tuple(item["loc"]), item) for item in error.errors()]
    for place, item in items:
        if any(len(other) > len(place) and other[: len(place)] == place for other, _ in items):
            continue  # an array is "too short" because of a bad item, which has its own complaint
        keys = _keys(place[:-1], schema)
        text = _sentence(item, (*at, *place), keys)
        line = line_of((*at, *place), lines)
        found.append(Complaint(item["type"] != "extra_forbidden", line or 0, text))
    return found


def _sentence(item: Any, place: Place, keys: Iterable[str]) -> str:
    kind, name, given = item["type"], _dotted(place), item["input"]
    shown = f"{name} = {given!r}" if len(repr(given)) <= _LONGEST else name
    if kind == "extra_forbidden":
        return f"unknown key {place[-1]!r}{_inside(place[:-1])}; {suggest(str(place[-1]), keys)}"
    if kind == "missing":
        if isinstance(place[-1], int):
            return f"{_dotted(place[:-1])}: expected at least {place[-1] + 1} entries"
        return f"missing key {place[-1]!r}{_inside(place[:-1])}"
    if kind == "literal_error":
        choices = [c.strip("' ") for c in item["ctx"]["expected"].replace(" or ", ",").split(",")]
        return f"{shown}: {suggest(str(given), choices)}"
    if (
        kind == "value_error"
        and isinstance(given, Mapping)
        and place
        and isinstance(place[-1], int)
    ):
        return f"{item['ctx']['error']}{_inside(place)}"
    if kind == "value_error":
        return f"{shown}: {item['ctx']['error']}"
    if kind in ("greater_than", "greater_than_equal"):
        bound = next(iter(item["ctx"].values()))
        return (
            f"{shown}: expected a number {'above' if kind == 'greater_than' else 'of at least'}"
            f" {bound:g}"
        )
    if kind in ("less_than", "less_than_equal"):
        bound = next(iter(item["ctx"].values()))
        return (
            f"{shown}: expected a number {'below' if kind == 'less_than' else 'of at most'}"
            f" {bound:g}"
        )
    return f"{shown}: {_WORDS.get(kind, item['msg'])}"


def _inside(table: Place) -> str:
    if not table:
        return ""
    return (
        f" in [[{table[0]}]] {table[1] + 1}"
        if len(table) == 2 and isinstance(table[1], int)
        else f" in [{_dotted(table)}]"
    )


def _dotted(place: Place) -> str:
    out = ""
    for part in place:
        out += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if out else str(part)
    return out


def _keys(place: Place, schema: type[BaseModel]) -> list[str]:
    """Return the keys that the table at `place` may hold."""
    table = schema
    for part in place:
        field = table.model_fields.get(str(part))
        inner = None if field is None else _table_in(field.annotation)
        table = table if inner is None else inner
    keys = list(table.model_fields)
    return [*keys, *JOB_TABLES] if table is Job else keys


def _table_in(annotation: Any) -> type[BaseModel] | None:
    """Return the table that a field holds, alone or in an array; None where it holds none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_table_in(inner) for inner in get_args(annotation))
    return next((table for table in found if table is not None), None)
