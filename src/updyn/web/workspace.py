"""`Workspace`: the shared state of all tabs: the project, the open job with its data, its run."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar, cast

import tomlkit
from tomlkit.exceptions import TOMLKitError

from updyn.demos import find_demo
from updyn.errors import InputError
from updyn.io.atomic import write_bytes
from updyn.web import edits
from updyn.web.desk import Desk
from updyn.web.document import JobDocument
from updyn.web.faults import new_faults
from updyn.web.form import REQUIRED, Form
from updyn.web.looking import JobView, TestView, propose_job, read_run, read_view
from updyn.web.project import Project, hide_folder
from updyn.web.recognition import Recognised, recognise
from updyn.web.settings import WEB_LIMIT, WEB_PAGE, WEB_TASK
from updyn.web.table_form import TableForm
from updyn.web.table_preview import (
    FRFPreview,
    MeasurementView,
    TableView,
    preview_frf,
    view_measurement,
    view_table,
)
from updyn.web.tasks import TASKS
from updyn.web.worker import Worker

__all__ = ["NewJob", "OpenTable", "Workspace"]

T = TypeVar("T")

#: Keys of ``[test]`` that state how a table is read, in addition to its mapping.
_READING = ("quantity", "response_labels", "reference_labels", "order")
_MAPPINGS = ("columns", "variables")
#: Suffixes of files that may hold FRFs in any layout.
_TABLES = (".csv", ".txt", ".dat", ".asc", ".mat", ".npz", ".h5", ".hdf5")


@dataclass(eq=False)
class NewJob:
    """Entries for a new job; `reading` has options of the reader, `view` describes the file.

    `recognised` is what the file of the model is.
    """

    model: str = ""
    measurement: str = ""
    quantity: str = ""
    name: str = "job.toml"
    reading: dict[str, Any] = field(default_factory=dict)
    view: MeasurementView | None = None
    recognised: Recognised | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Options of the reader of the measurement."""
        return {**({"quantity": self.quantity} if self.quantity else {}), **self.reading}

    def faults(self) -> dict[str, str]:
        """Return a message for each entry that is missing or cannot be used, by its name."""
        found = {what: REQUIRED for what in ("model", "measurement") if not getattr(self, what)}
        if self.recognised is not None and self.recognised.kind != "model":
            known = self.recognised
            found["model"] = f"is a {known.kind}; expected a model" if known.kind else known.text
        if self.view is not None and self.view.error:
            found["measurement"] = self.view.error
        if self.view is not None and not self.view.has_quantity:
            found["quantity"] = "the file does not state it; choose one"
        return found


@dataclass(frozen=True, eq=False)
class OpenTable:
    """The form for a table of FRFs, for a new job or for a `test` of the open job."""

    form: TableForm
    view: TableView
    test: int | None = None

    @property
    def first_file(self) -> str:
        """Name of the listed file in the project."""
        return self._in_folder(self.view.first_file)

    @property
    def pattern(self) -> str:
        """Name in the project of the files of all points; empty if there is one file."""
        return self._in_folder(self.view.pattern) if self.view.pattern else ""

    def _in_folder(self, name: str) -> str:
        return PurePosixPath(self.form.file).with_name(name).as_posix()


class Workspace:
    """The state behind the pages; an uploaded file has at most `most_upload` bytes.

    `workers` has the latest worker of each task; `theme` is "auto", "light" or "dark".
    """

    def __init__(self, folder: Path) -> None:
        self.project = Project(folder)
        self.most_upload = WEB_LIMIT.upload_bytes
        self.document: JobDocument | None = None
        self.workers: dict[str, Worker] = {}
        self.theme = "auto"
        self.new_job = NewJob(name=self.project.free_job_name())
        self.table: OpenTable | None = None
        self._desk = Desk(self.project.folder, WEB_TASK.answer_seconds, _memory_limit())
        self._forms: dict[str, Form] = {}
        self._opened_paths: set[Path] = set()
        self._answers: dict[Callable[..., object], object] = {}
        self._asked: tuple[Path, str] | None = None
        self._asking = threading.RLock()
        self._stamp = self.project.stamp()

    @property
    def version(self) -> tuple[object, ...]:
        """A value that changes whenever the shown state of the job may have changed."""
        document = self.document
        return () if document is None else (document.path, document.version, document.is_changed)

    @property
    def answers_version(self) -> tuple[object, ...]:
        """A value that changes with the kept answers of `ask` and with the latest run."""
        run = self.run
        state = () if run is None else (id(run), run.version)
        return (*self.version, self._asked, tuple(self._answers), *state)

    @property
    def has_unsaved(self) -> bool:
        """Whether the open job or a form of it has edits that are not saved."""
        pending = any(form.pending for form in self._forms.values())
        return self.document is not None and (self.document.is_changed or pending)

    @property
    def run(self) -> Worker | None:
        """The latest run of the open job, or the run of any job that is under way."""
        return self.worker("run")

    def worker(self, task: str) -> Worker | None:
        """Return the latest worker of a task for the open job, or an active one for any job."""
        worker = self.workers.get(task)
        if worker is None or worker.active or self.is_of_open_job(worker):
            return worker
        return None

    def is_of_open_job(self, worker: Worker) -> bool:
        """Return whether a worker works on the open job."""
        return self.document is not None and worker.job == self.document.path

    def pages(self, task: str) -> tuple[list[str], str]:
        """Return the pages that a task has written, the latest first, and the one to show.

        The latter is the page of the latest worker for the open job if it has written one,
        otherwise the latest in a folder that is named after the job, otherwise empty.
        """
        work = TASKS.find(task)
        found = self.project.pages(work.page, task)
        pages = [self.project.name_of(path) for path in found]
        worker = self.workers.get(task)
        if worker is not None and self.is_of_open_job(worker):
            made = worker.out / work.page
            if made.is_file():
                name = self.project.name_of(made)
                return list(dict.fromkeys([name, *pages])), name
        suffixes = "|".join(map(re.escape, (work.suffix, TASKS.find("run").suffix)))
        stem = re.escape(self.open_document.path.stem)
        named = re.compile(rf"{stem}(({suffixes})(-\d+)?)?")
        named_pages = [path for path in found if named.fullmatch(path.parent.name)]
        return pages, self.project.name_of(named_pages[0]) if named_pages else ""

    @property
    def open_document(self) -> JobDocument:
        """The open job; `InputError` without one."""
        if self.document is None:
            raise InputError("no job is open; open one on the page Start")
        return self.document

    def open_job(self, name: str | Path) -> None:
        """Open a job of the project, unless another one has unsaved edits.

        An `InputError` is raised for unsaved edits or a path outside the project, a `JobError` if
        the job cannot be read.
        """
        path = self.project.inside(name)
        document = self.document
        if document is not None and document.is_changed and document.path == path:
            return
        self._check_saved()
        self.document = JobDocument(path)
        self._forms.clear()
        self._opened_paths.add(path)

    def jobs(self) -> list[Path]:
        """Return the jobs of the project, and those that were opened under any other name."""
        listed = self.project.jobs()
        others = {path for path in self._opened_paths if path not in listed and path.is_file()}
        return [*sorted(others), *listed]

    def _check_saved(self) -> None:
        """Check that the open job, where there is one, has no edits that would be lost."""
        if self.document is None:
            return
        if self.document.is_changed:
            raise InputError(
                f"{self.document.path.name} has edits that are not saved; save or undo"
            )
        for task, form in self._forms.items():
            if form.pending:
                raise InputError(
                    f"{self.document.path.name} has entries of the form for {task!r} that are not"
                    f" saved ({form.reason}); complete or discard them"
                )

    # -- edits of pages ----------------------------------------------------------------------------
    def edit(self, what: str, change: edits.Edit) -> None:
        """Change the open job by the edit named `what`; `InputError` if this would add a fault."""
        document = self.open_document
        changed = document.with_change(change)
        found = new_faults(document.path, document.text, changed)
        if found:
            raise InputError(f"{what}: not changed, as the job would be wrong: {'; '.join(found)}")
        document.replace(what, changed)

    def form(self, task: str) -> Form:
        """Return the form of a task for the open job."""
        if task not in self._forms:
            work = TASKS.find(task)
            self._forms[task] = Form(work.table, work.fields)
        form, view = self._forms[task], self.find_answer(read_view)
        if view is not None and view.tests:
            form.propose(_propose_entries(view.tests[0]))
        return form

    def entries(self, task: str) -> dict[str, str]:
        """Return the text of each entry of the form of a task, by key."""
        return self.form(task).entries(self.open_document.text)

    def faults(self, task: str) -> dict[str, str]:
        """Return a message for each missing or invalid entry of the form of a task, by key."""
        return self.form(task).faults(self.open_document.text)

    def note(self, task: str, key: str, entry: str) -> None:
        """Store a typed entry of a form; the next `enter` writes it into the job."""
        self.form(task).note(key, entry, self.open_document.text)

    def enter(self, task: str, key: str, entry: str) -> None:
        """Store an entry of a form, and write the form into the job once it is complete."""
        self.note(task, key, entry)
        self.form(task).commit(self.open_document)

    def save(self) -> None:
        """Write the open job to its file, with the entries of all forms that are complete.

        Raises as `JobDocument.save`; an `InputError` also, after saving, if entries are left out.
        """
        document = self.open_document
        for form in self._forms.values():
            form.commit(document)
        document.save()
        reasons = [form.reason for form in self._forms.values() if form.pending]
        if reasons:
            raise InputError(f"saved without form entries: {'; '.join(reasons)}")

    def open_demo(self, name: str) -> None:
        """Write a demo into a new folder and open its job; InputError if edits are unsaved."""
        self._check_saved()
        demo = find_demo(name)
        folder = self.project.free_name(self.project.folder / demo.name)
        folder.mkdir()
        self.open_job(demo.write_inputs(folder))

    def save_as(self, name: str) -> None:
        """Save the job under another plain name in its folder; InputError if it exists."""
        self.project.plain_name(name)  # no folder: the files that the job names are relative to it
        full_name = self.project.name_of(self.open_document.path.with_name(name))
        self.open_document.save_as(self.project.new_job(full_name))

    def view(self) -> JobView:
        """Return the content of the present job."""
        return self._hide_folder(self.ask(read_view))

    def ask(self, function: Callable[..., T], *arguments: object) -> T:
        """Call a function in the `Desk` with path and text of the open job, and plain data.

        The answer of a function without further arguments is kept until the job or a file of the
        project changes.
        """
        if arguments:
            self._discard_stale_data()
            document = self.open_document
            return self._desk.ask(function, document.path, document.text, *arguments)
        with self._asking:  # another page waits for the same answer
            self._discard_stale_data()
            document = self.open_document
            asked = document.path, document.text
            if self._asked != asked:
                self._answers, self._asked = {}, asked
            if function not in self._answers:
                self._answers[function] = self._desk.ask(function, *asked)
            return cast(T, self._answers[function])

    def find_answer(self, function: Callable[..., T]) -> T | None:
        """Return the kept answer of a function of the present job; None if there is none."""
        document = self.document
        if document is None or self._asked != (document.path, document.text):
            return None
        return cast("T | None", self._answers.get(function))

    def find_view(self) -> JobView | None:
        """Return the content of the present job if it has been read."""
        view = self.find_answer(read_view)
        return None if view is None else self._hide_folder(view)

    def _hide_folder(self, view: JobView) -> JobView:
        """Return the content of a job with files in its errors relative to the project."""
        folder = self.project.folder
        errors = {what: hide_folder(text, folder) for what, text in view.errors.items()}
        return replace(view, errors=errors)

    def create(self) -> None:
        """Write a commented job for the model and the measurement of `new_job`, and open it.

        An `InputError` is raised, and nothing written, if a file cannot be read or is outside the
        project, the job exists, or the open job has unsaved edits.
        """
        self._check_saved()
        entries = self.new_job
        inputs = (
            self.project.inside(entries.model),
            self.project.inside(entries.measurement),
        )
        path = self.project.new_job(entries.name)
        text = self._desk.ask(propose_job, *inputs, path, entries.options)
        write_bytes(path, text.encode())
        self.open_job(path)
        self.new_job = NewJob(name=self.project.free_job_name())

    # -- tables of FRFs ----------------------------------------------------------------------------
    def ask_file(self, function: Callable[..., T], name: str, *arguments: object) -> T:
        """Call a function in the `Desk` with the path of a file of the project, and plain data."""
        self._discard_stale_data()
        return self._desk.ask(function, self.project.inside(name), *arguments)

    def view_run(self, name: str) -> JobView:
        """Return the content of the job of a run, by its file in the project."""
        return self._hide_folder(self.ask_file(read_run, name))

    def view_new_measurement(self) -> None:
        """Read the measurement of the new job."""
        job = self.new_job
        job.view = None
        if job.measurement:
            job.view = self.ask_file(view_measurement, job.measurement, job.options)

    def recognise_new_model(self) -> None:
        """Read the model of the new job."""
        job = self.new_job
        job.recognised = None
        if job.model:
            job.recognised = self.ask_file(recognise, job.model)

    def take_file(self, name: str) -> Recognised:
        """Recognise a file of the project, and use a model or measurement for the new job."""
        found = self.ask_file(recognise, name)
        self._take(name, found)
        return found

    def take_inputs(self) -> None:
        """Use files of the project for the new job, as far as they are recognised."""
        job = self.new_job
        for path in self.project.inputs()[: WEB_PAGE.recognised_files]:
            if job.model and job.measurement:
                return
            name = self.project.name_of(path)
            found = self.ask_file(recognise, name)
            is_taken = job.model if found.kind == "model" else job.measurement
            if found.kind != "table" and not is_taken:
                self._take(name, found)

    def _take(self, name: str, found: Recognised) -> None:
        job = self.new_job
        if found.kind == "model":
            job.model, job.recognised = name, found
        elif found.kind in ("measurement", "table"):
            job.measurement, job.reading, job.quantity = name, {}, ""
            self.view_new_measurement()

    def find_new_job_faults(self) -> dict[str, str]:
        """Return a message for each entry of the new job that cannot be used, by its name."""
        job = self.new_job
        found = job.faults()
        try:
            self.project.new_job(job.name)
        except InputError as error:
            found["name"] = str(error) if job.name.strip() else REQUIRED
        return found

    def tables(self) -> dict[int, str]:
        """Return the files of tests of the open job that may hold a table, by test."""
        found = {}
        for number, test in enumerate(self._tests()):
            file = test.get("file")
            if isinstance(file, str) and (
                file.lower().endswith(_TABLES) or any(name in test for name in _MAPPINGS)
            ):
                found[number] = file
        return found

    def open_new_table(self) -> None:
        """Open the form for the measurement of the new job; `InputError` if it is no table."""
        job = self.new_job
        view = self.ask_file(view_table, job.measurement, job.reading.get("columns", {}))
        self.table = OpenTable(TableForm(job.measurement, view.inventory, job.options), view)

    def open_table(self, number: int) -> None:
        """Open the form for a test of the open job; `InputError` if its file is no table."""
        test = self._tests()[number]
        file = self.project.name_of(self.open_document.path.parent / test["file"])
        view = self.ask_file(view_table, file, test.get("columns", {}))
        given = {key: test[key] for key in (*_READING, *_MAPPINGS) if key in test}
        self.table = OpenTable(TableForm(file, view.inventory, given), view, number)

    def relist_table(self) -> None:
        """List the columns again, by the separator and the first row in the open form.

        If there is no such table, the reader reports it at the entry.
        """
        form = self._open_form
        with suppress(InputError):
            form.inventory = self.ask_file(view_table, form.file, form.options[form.root]).inventory

    def preview_table(self) -> FRFPreview | None:
        """Return the FRFs that the open form selects; None if it lacks the entries for this."""
        form = self._open_form
        options = form.preview_options()
        return None if options is None else self.ask_file(preview_frf, form.file, options)

    def use_table(self) -> None:
        """Set the entries of the open form in the job; InputError, and no change, if not valid."""
        form, table = self._open_form, self.table
        assert table is not None
        faults = form.faults()
        found = FRFPreview(faults) if faults else self.preview_table()
        if found is None or found.errors:
            raise InputError("the columns are not complete; see the entries")
        options = form.build_options()
        if table.test is None:
            job = self.new_job
            job.quantity = str(options.pop("quantity", ""))
            job.measurement, job.reading = form.file, options
            self.view_new_measurement()
        else:
            keys = {key: options.get(key) for key in (*_READING, form.root)}
            written = Path(self._tests()[table.test]["file"])
            file = written.with_name(Path(form.file).name).as_posix()
            edit = edits.set_reading({"file": file, **keys}, table.test)
            self.edit(f"{form.root} of {Path(form.file).name}", edit)
        self.table = None

    @property
    def _open_form(self) -> TableForm:
        if self.table is None:
            raise InputError("no table is open; open one on the page Start or Measurement")
        return self.table.form

    def _tests(self) -> list[Mapping[str, Any]]:
        """Return the tests of the open job as written; empty if they cannot be read."""
        try:
            found = tomlkit.parse(self.open_document.text).unwrap().get("test")
        except (TOMLKitError, RecursionError):
            return []
        tests = found if isinstance(found, list) else [found]
        return [test for test in tests if isinstance(test, dict)]

    def _discard_stale_data(self) -> None:
        """Discard data of files that have changed since they were read."""
        stamp = self.project.stamp()
        if stamp != self._stamp:
            self._stamp, self._asked = stamp, None
            self._desk.close()  # its process caches data

    @property
    def is_busy(self) -> bool:
        """Whether a task is under way; only one can be."""
        return any(worker.active for worker in self.workers.values())

    def begin(self, task: str, folder: str, *, resume: bool = False) -> Worker:
        """Save the job, and begin or resume a task of it with results in `folder`.

        An `InputError` is raised if a task is active, an entry of the form of the task cannot be
        written into the job, or the folder is not in the project.
        """
        if self.is_busy:
            raise InputError("a task is under way; stop it first")
        if not folder.strip():
            raise InputError("the results need a folder; give its name")
        document, out = self.open_document, self.project.inside(folder.strip())
        form = self.form(task)
        form.commit(document, is_needed=True)
        if form.pending or form.reason:
            raise InputError(f"not started: {form.reason}")
        if document.is_changed:
            document.save()
        worker = Worker(task, document.path, out, self.project.folder, resume=resume)
        self.workers[task] = worker
        worker.start()
        return worker

    def proposed_folder(self, task: str) -> str:
        """Return the folder that is proposed for the results of a task.

        The folder of the task's latest results of this job; for a plant without these, that of the
        latest run; otherwise one that does not exist.
        """
        path = self.open_document.path
        for name in (task, "run"):
            worker = self.workers.get(name)
            if worker is not None and worker.job == path and (name == task or task == "plant"):
                return self.project.name_of(worker.out)
        runs = self.project.runs_of(path) if task == "plant" else []
        if runs:
            return self.project.name_of(runs[0].path)
        suffix = TASKS[task].suffix
        return self.project.name_of(self.project.free_name(path.with_suffix(""), suffix))

    def close(self) -> None:
        """Stop the task under way, with its results written, and end all processes."""
        for worker in self.workers.values():
            worker.end()
        self._desk.end()


def _propose_entries(test: TestView) -> dict[str, str]:
    """Return entries of forms by key, as the test is."""
    low, high = test.band or (float(test.freq[0]), float(test.freq[-1]))
    return {"n_sensors": str(len(test.responses)), "band": f"{low:g}, {high:g}"}


def _memory_limit() -> int:
    """Return the memory limit of the `Desk` in bytes: half of the machine's; 0 if unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    except (AttributeError, OSError, ValueError):
        return 0
