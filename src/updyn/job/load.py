"""`load_job`: read a TOML file into a `Job` and check its text."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError

from updyn.elements import MODEL_KINDS
from updyn.errors import JobError, OptionError, key_path, suggest
from updyn.io.items import format_key, is_file, is_folder
from updyn.job.base import Document
from updyn.job.files import check_encodable
from updyn.job.job_table import JOB_TABLES
from updyn.job.records_table import RecordsJob, RecordsTable
from updyn.job.schema import NO_TEST, NO_UPDATE, Job, MethodTable, ModelTable, Table
from updyn.job.settings import JOB_MESSAGE
from updyn.job.toml_lines import Place, line_of, read_toml
from updyn.updating.fit.methods import METHODS, make_method, options_of
from updyn.updating.fit.regularisation import check_regularise

__all__ = ["check_model", "load_job", "load_records_job"]

#: Tables that a job with an update must have.
_UPDATE_TABLES = ("model", "test", "parameter")

_NAME = re.compile(r"[\w-][\w -]*(?<! )")
#: Message of `tomllib` for a table that is declared twice.
_DUPLICATE = re.compile(r"Cannot declare (\(.+\)) twice")
_PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
#: Expected value, by error type of pydantic.
_EXPECTED = {
    "bool_type": "expected true or false",
    "dict_type": "expected a table",
    "finite_number": "expected a finite number",
    "float_type": "expected a number",
    "greater_than": "expected a number above {gt:g}",
    "greater_than_equal": "expected a number of at least {ge:g}",
    "int_type": "expected a whole number",
    "less_than": "expected a number below {lt:g}",
    "less_than_equal": "expected a number of at most {le:g}",
    "list_type": "expected an array",
    "model_type": "expected a table",
    "string_type": "expected a text",
    "too_long": "too many entries; expected {max_length}",
    "too_short": "too few entries; expected {min_length} or more",
    "tuple_type": "expected an array",
}


def load_job(
    path: str | Path, *, before_test: bool = False, of_test: bool = False, text: str | None = None
) -> Job:
    """Read a job file.

    Parameters
    ----------
    path : path
        The TOML file.
    before_test : bool
        Whether ``[test]`` may be missing, before the measurement.
    of_test : bool
        Whether ``[model]`` and ``[[parameter]]`` may be missing, and ``[test]`` if there are
        ``[records]``; only the measurement is used.
    text : str, optional
        Text to check in place of the file's content, for editors.

    Returns
    -------
    Job
        The job. Only its text is checked; the files that it names are not opened.

    Raises
    ------
    JobError
        If the file does not exist, is not TOML, or has an unknown key, a wrong value or a missing
        key. The message has one line per error, each with its line in the file.
    """
    path = Path(path)
    check_encodable(path.name)
    document, lines = _read_document(path, text)
    if before_test:
        document.setdefault("test", {} if "records" in document else NO_TEST)
    if of_test:
        document = NO_UPDATE | ({"test": {}} if "records" in document else {}) | document
    tables, complaints = _take_further_tables(document, lines)
    jobs = []
    for one, own_lines in _split_tests(document, lines):
        try:
            jobs.append(Job.model_validate(one).with_source(path, own_lines, tables))
        except ValidationError as error:
            complaints += _collect_complaints(error, own_lines, Job)
    if complaints:
        raise _merge_complaints(sorted(set(complaints)), path)
    job = jobs[0].with_others(tuple(jobs[1:]))
    with job.located():
        check_model(job.model)
        _check_method(job.method)
    _check_test_names(job)
    _check_tests(job)
    with job.located():
        for name in job.tables:
            JOB_TABLES[name].check_text(job)
    return job


def load_records_job(path: str | Path) -> tuple[Document, RecordsTable]:
    """Read a job file with ``[records]``, with or without the tables of an update."""
    path = Path(path)
    document, lines = _read_document(path)
    job: Job | RecordsJob
    if any(name in document for name in _UPDATE_TABLES):
        job = load_job(path)
    else:
        try:
            job = RecordsJob.model_validate(document).at(path, lines)
        except ValidationError as error:
            raise _merge_complaints(
                sorted(_collect_complaints(error, lines, RecordsJob)), path
            ) from error
    if job.records is None:
        raise JobError("missing table [records], which lists the files of time records", path)
    return job, job.records


def _read_document(
    path: Path, text: str | None = None
) -> tuple[dict[str, object], dict[Place, int]]:
    """Return the content of a job file and the line of each key."""
    text = _read_text(path) if text is None else text
    try:
        return read_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise _locate_toml_error(error, text, path) from error


def _read_text(path: Path) -> str:
    if is_folder(path):
        raise JobError("is a folder; expected a job file (TOML)", path)
    if not is_file(path):
        siblings = []
        if is_folder(path.parent):
            siblings = [file.name for file in path.parent.glob("*.toml")]
        hint = f"; {suggest(path.name, siblings)}" if siblings else ""
        raise JobError(f"no such file{hint}", path)
    raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        text = f"byte {raw[error.start]:#04x} is not UTF-8; TOML is{_suffix_hint(path)}"
        raise JobError(text, path, line) from error


def _suffix_hint(path: Path) -> str:
    """Return the hint for a file without the suffix of a job; empty if it has the suffix."""
    if path.suffix.lower() == ".toml":
        return ""
    return f"; expected a job file (TOML), and updyn info {path.name} prints what this file holds"


def _locate_toml_error(error: tomllib.TOMLDecodeError, text: str, path: Path) -> JobError:
    message = str(error)
    found = _PLACE.search(message)
    hint = _suffix_hint(path)
    if found is None:
        return JobError(f"not TOML: {message}{hint}", path)
    message = _DUPLICATE.sub(_format_duplicate, message[: found.start()])
    if found[1] is None:
        line = text.rstrip("\n").count("\n") + 1
        return JobError(f"not TOML: {message} at the end of the file{hint}", path, line)
    return JobError(f"not TOML: {message} at column {found[2]}{hint}", path, int(found[1]))


def _format_duplicate(found: re.Match[str]) -> str:
    """Return the message about a table declared twice, with its name as in the file."""
    keys: tuple[str, ...] = ast.literal_eval(found[1])
    name = ".".join(keys)
    return f"[{name}] is declared twice; write [[{name}]] where there may be several"


def _take_further_tables(
    document: dict[str, object], lines: Mapping[Place, int]
) -> tuple[dict[str, Table], list[_Complaint]]:
    """Remove the tables of `JOB_TABLES` from a document; return them validated, and errors."""
    names = [name for name in document if name not in Job.model_fields and name in JOB_TABLES]
    if names:
        names = [name for name in JOB_TABLES if name in names]
    tables: dict[str, Table] = {}
    complaints: list[_Complaint] = []
    for name in names:
        schema = JOB_TABLES[name].schema
        try:
            tables[name] = schema.model_validate(document.pop(name))
        except ValidationError as error:
            complaints += _collect_complaints(error, lines, schema, (name,))
    return tables, complaints


def _split_tests(
    document: dict[str, object], lines: dict[Place, int]
) -> Iterator[tuple[dict[str, object], dict[Place, int]]]:
    tests = document.get("test")
    if not (isinstance(tests, list) and tests and all(isinstance(test, dict) for test in tests)):
        yield document, lines
        return
    common = {place: line for place, line in lines.items() if place[:1] != ("test",)}
    for number, test in enumerate(tests):
        own_lines = dict(common)
        for place, line in lines.items():
            if place[:2] == ("test", number):
                own_lines[("test", *place[2:])] = line
        yield document | {"test": test}, own_lines


# -- checks beyond those of a single value ---------------------------------------------------------
def _check_test_names(job: Job) -> None:
    """Check that several tests have distinct names that are valid folder names."""
    if len(job.parts) == 1:
        return
    names: set[str] = set()
    for part in job.parts:
        name = part.test.name
        with part.located(), key_path("test"):
            if not name:
                raise JobError("one of several tests without a name; give each [[test]] its own")
            if not _NAME.fullmatch(name):
                raise JobError(
                    f"test.name = {name!r}: expected letters, digits, blanks, - and _, as it is the"
                    " name of a folder",
                    key=("name",),
                )
            if name.casefold() in names:
                raise JobError(f"test.name = {name!r}: another test has that name", key=("name",))
        names.add(name.casefold())


def _check_tests(job: Job) -> None:
    """Check that each test has a file, or the FRFs of ``[records]`` and no option of a file."""
    for part in job.parts:
        test = part.test
        with part.located(), key_path("test"):
            if test.modes_reader is not None and test.modes is None:
                raise JobError(
                    "test.modes_reader belongs to a file of modes, and the test has no key 'modes'",
                    key=("modes_reader",),
                )
            if part.has_modes:
                for key in test.of_frfs:
                    raise JobError(
                        f"test.{key} belongs to FRFs, and this test measured modes; leave it out",
                        key=(key,),
                    )
                continue
            if test.file is None and job.records is None:
                raise JobError(
                    "missing key 'file' in [test], and no [records] or modes in its place"
                )
            if test.file is not None:
                continue
            for key in test.reader_options:
                if key not in ("responses", "references"):
                    raise JobError(
                        f"test.{key} belongs to a file of FRFs; those of this test come from"
                        " [records]",
                        key=(key,),
                    )
    used = {None, None if job.records is None else job.records.output}
    if job.records is not None and not used & {part.test.file for part in job.parts}:
        with job.located():
            raise JobError(
                "[records] are used by no test: leave test.file out, or give it the file that"
                " records.output names",
                key=("records",),
            )


def check_model(table: ModelTable) -> None:
    """Check that ``[model]`` has a file or a kind."""
    with key_path("model"):
        if table.file is not None and table.kind is not None:
            raise JobError("[model] has a file and a kind; expected one of the two", key=("kind",))
        if table.file is None and table.kind is None:
            for key in table.keys:  # probably a misspelt file or kind
                near = suggest(key, ("file", "format", "kind"))
                raise JobError(f"unknown key {key!r} in [model]; {near}", key=(key,))
            raise JobError("[model] needs a file, or a kind with the keys of its builder")
        if table.kind is None:
            return
        if table.kind not in MODEL_KINDS:
            near = suggest(table.kind, MODEL_KINDS)
            raise JobError(f"model.kind = {table.kind!r}: {near}", key=("kind",))
        if table.format is not None:
            raise JobError("model.format belongs to a file, not to a kind", key=("format",))


def _check_method(table: MethodTable) -> None:
    with key_path("method"):
        if table.name not in METHODS:
            near = suggest(table.name, METHODS)
            raise JobError(f"method.name = {table.name!r}: {near}", key=("name",))
        check_regularise(table.regularise, table.name)
        known = options_of(table.name)
        for key in table.options:
            if key not in known:
                near = suggest(key, [*MethodTable.model_fields, *known])
                text = f"unknown key {key!r} in [method] with name {table.name!r}; {near}"
                raise JobError(text, key=(key,))
        for key, value in table.options.items():
            try:
                make_method(table.name, {key: value})
            except OptionError as error:
                raise JobError(str(error), key=(key,)) from error


# -- errors of pydantic ----------------------------------------------------------------------------
class _Complaint(NamedTuple):
    """An error in the text of a job file; sorts unknown keys first, then by line."""

    of_known_key: bool
    line: int
    text: str


def _merge_complaints(found: Sequence[_Complaint], path: Path) -> JobError:
    first, *others = found
    texts = [first.text]
    texts += [str(JobError(other.text, path, other.line or None)) for other in others]
    return JobError("\n".join(texts), path, first.line or None)


def _collect_complaints(
    error: ValidationError,
    lines: Mapping[Place, int],
    schema: type[BaseModel],
    at: Place = (),
) -> list[_Complaint]:
    """Return the errors that pydantic found in the table at `at`, validated by `schema`."""
    found = []
    items = [(tuple(item["loc"]), item) for item in error.errors()]
    places = [place for place, _ in items]
    for place, item in items:
        if any(len(other) > len(place) and other[: len(place)] == place for other in places):
            continue  # an array is "too short" because of a wrong item, which has its own complaint
        *array, last = place or ("",)
        if item["type"] == "missing" and isinstance(last, int) and (*array, last + 1) in places:
            continue  # the last missing entry gives the expected number
        text = _format_error(item, (*at, *place), _find_keys(place[:-1], schema))
        line = line_of((*at, *place), lines)
        found.append(_Complaint(item["type"] != "extra_forbidden", line or 0, text))
    return found


def _format_error(item: Any, place: Place, keys: Iterable[str]) -> str:
    kind, given = item["type"], item["input"]
    context = item.get("ctx", {})
    table = place[:-1]
    if kind == "extra_forbidden":
        return (
            f"unknown key {place[-1]!r}{_format_location(table)}; {suggest(str(place[-1]), keys)}"
        )
    if kind == "missing":
        if isinstance(place[-1], int):
            return f"{format_key(table)}: expected at least {place[-1] + 1} entries"
        return f"missing key {place[-1]!r}{_format_location(table)}"
    of_a_row = bool(place) and isinstance(place[-1], int) and isinstance(given, Mapping)
    if kind == "value_error" and of_a_row:
        return f"{context['error']}{_format_location(place)}"
    shown = format_key(place)
    value = str(given).lower() if isinstance(given, bool) else repr(given)  # as in the file
    if len(value) <= JOB_MESSAGE.longest_value:
        shown += f" = {value}"
    if kind == "literal_error":
        choices = [c.strip("' ") for c in context["expected"].replace(" or ", ",").split(",")]
        return f"{shown}: {suggest(str(given), choices)}"
    if kind == "value_error":
        return f"{shown}: {context['error']}"
    expected = _EXPECTED[kind].format(**context) if kind in _EXPECTED else item["msg"]
    return f"{shown}: {expected}"


def _format_location(table: Place) -> str:
    """Return the table that holds a key, such as `` in [[parameter]] 2``; empty at top level."""
    if not table:
        return ""
    if len(table) == 2 and isinstance(table[1], int):
        return f" in [[{table[0]}]] {table[1] + 1}"
    return f" in [{format_key(table)}]"


def _find_keys(place: Place, schema: type[BaseModel]) -> list[str]:
    table = schema
    for part in place:
        field = table.model_fields.get(str(part))
        inner = getattr(table, "of_any_name", None)
        if field is not None:
            inner = _find_table_class(field.annotation)
        if inner is not None:
            table = inner
    keys = list(table.model_fields)
    return [*keys, *JOB_TABLES] if table is Job else keys


def _find_table_class(annotation: object) -> type[BaseModel] | None:
    """Return the table class of a field, also inside an array; None if it has none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in get_args(annotation):
        found = _find_table_class(inner)
        if found is not None:
            return found
    return None
