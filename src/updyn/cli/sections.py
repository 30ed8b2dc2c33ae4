"""Sections of the printed output of commands: `RUN`, `CHECK` and `CORRELATE` list them in order.

A section is a function that returns text, or an empty string. Colours are added by `highlight`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from updyn.cli.describe import describe_identifiability, describe_parameters
from updyn.cli.settings import DESCRIPTION, LAYOUT
from updyn.correlation.figures import SHORT_NAMES, agreement_table, figure_text
from updyn.text_table import text_table

if TYPE_CHECKING:
    from updyn.correlation import Correlation
    from updyn.correlation.modes import ModeCorrelation
    from updyn.job import Prepared
    from updyn.job.prepared import PreparedTest
    from updyn.job.run import JobRun
    from updyn.job.schema import Job
    from updyn.updating.judge.causes.finding import Finding
    from updyn.updating.judge.counterparts import Counterparts
    from updyn.updating.judge.identifiability import Identifiability
    from updyn.updating.problem.selection import Selection

__all__ = [
    "CHECK",
    "CORRELATE",
    "RUN",
    "CheckResult",
    "FinishedRun",
    "StartComparison",
    "describe_fit",
    "describe_job",
    "describe_results",
    "describe_test",
    "format_counterparts",
    "format_faults",
    "format_next_step",
    "join_sections",
    "list_announcements",
]

T = TypeVar("T")

_RESUME_COMMAND = "updyn run JOB.toml --resume (with the same --out)"


def join_sections(sections: Sequence[Callable[[T], str]], content: T) -> str:
    """Return the nonempty sections of a content as one text, separated by blank lines."""
    texts = [section(content) for section in sections]
    return "\n\n".join(filter(None, texts))


# -- run -------------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A finished run of a job."""

    job: Job
    run: JobRun


def _format_summary(ran: FinishedRun) -> str:
    return ran.run.summary()


def describe_results(ran: FinishedRun) -> list[str]:
    """Return further results, how to continue an unfinished run, and the place of the results.

    Each is a line of text; a further result is that of a table such as ``[plant]``, and its notes.
    """
    from updyn.job.job_table import JOB_TABLES

    further = []
    for name, found in ran.run.further.items():
        first, *rest = JOB_TABLES[name].summary(found).splitlines() or [""]
        notes = [line for line in rest if line.startswith("note: ")]
        further += [first, *notes[: LAYOUT.notes]]
    folder = ran.run.folder
    first = "report.html" if ran.job.output.report else "result.json"
    return [
        *filter(None, further),
        *_format_resume_hint(ran),
        f"Results in {folder}: {folder / first}",
    ]


def _format_resume_hint(ran: FinishedRun) -> list[str]:
    """Return how to continue an unfinished run."""
    status, trust = ran.run.result.status, ran.run.result.trust
    if ran.run.stopped:
        return [f"To continue: {_RESUME_COMMAND}"]
    # More steps are useless if the data are not credible.
    if status == "max-iterations" and (trust is None or trust.credible):
        return [f"To continue with more max_iterations: {_RESUME_COMMAND}"]
    return []


#: Details of ``updyn run``; `updyn.cli.outcome` makes the outcome.
RUN: tuple[Callable[[FinishedRun], str], ...] = (_format_summary,)


# -- check -----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class CheckResult:
    """A job that was checked, with the identifiability of its unknowns at the start.

    `faults` of the data, `agreement` at the start with the data of the fit, and `counterparts`
    (measured modes that the model has) are by test name; `folder` is that of a run.
    """

    ready: Prepared
    selection: Selection | None
    found: Identifiability
    faults: Mapping[str, tuple[Finding, ...]]
    folder: Path
    agreement: Mapping[str, Mapping[str, float]]
    counterparts: Mapping[str, Counterparts]

    @property
    def has_few_common_modes(self) -> bool:
        """Whether every test is known to have few or no modes in common with the model."""
        return all(one.few for one in self.counterparts.values())


def _format_job(checked: CheckResult) -> str:
    return describe_job(checked.ready)


def _format_matches(checked: CheckResult) -> str:
    texts = [f"{test.name}\n{test.matching}".lstrip() for test in checked.ready.tests]
    return "\n\n".join(texts)


def _format_unknowns(checked: CheckResult) -> str:
    return describe_parameters(checked.ready.parameters)


def _format_announcements(checked: CheckResult) -> str:
    """Return the announcements of the further tables of the job."""
    return "\n\n".join(list_announcements(checked.ready))


def list_announcements(ready: Prepared) -> list[str]:
    """Return the texts in which the further tables of a job announce their work."""
    from updyn.job.job_table import JOB_TABLES

    texts = [JOB_TABLES[name].announce(ready) for name in ready.job.tables]
    return [text for text in texts if text]


def _format_selection(checked: CheckResult) -> str:
    if checked.selection is None:
        return ""
    return f"Selected before the fit:\n{checked.selection.summary()}"


def _format_identifiability(checked: CheckResult) -> str:
    return f"At the start of the unknowns:\n{describe_identifiability(checked.found)}"


def _format_agreement(checked: CheckResult) -> str:
    """Return the figures of agreement of the start for each FRF test."""
    return agreement_table(
        {f"{name} start".lstrip(): figures for name, figures in checked.agreement.items()}
    )


def _format_check_faults(checked: CheckResult) -> str:
    return format_faults(checked.ready.tests, checked.faults)


def format_counterparts(checked: CheckResult) -> str:
    """Return the number of measured modes with a counterpart, with a remedy if there are few."""
    from updyn.updating.before_search import REMEDY

    texts = []
    for name, one in checked.counterparts.items():
        texts.append(f"{name}: {one.statement}".removeprefix(": "))
    few = [one for one in checked.counterparts.values() if one.few]
    texts += dict.fromkeys(one.remedy or REMEDY for one in few)
    return "\n".join(texts)


def format_next_step(checked: CheckResult) -> str:
    """Return whether the job can be run, and the place of its results."""
    if checked.has_few_common_modes:
        return (
            "The job can be run, but its search would end after its first tries, as model and test"
            f" have few or no modes in common; results would go to {checked.folder}."
        )
    return f"The job can be run; results would go to {checked.folder}."


#: Sections of ``updyn check``.
CHECK: tuple[Callable[[CheckResult], str], ...] = (
    _format_job,
    _format_matches,
    _format_unknowns,
    _format_announcements,
    _format_selection,
    _format_identifiability,
    _format_agreement,
    format_counterparts,
    _format_check_faults,
    format_next_step,
)


# -- correlate -------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class StartComparison:
    """The model of a job at the start, compared with a test; its name may be empty.

    `figures` are for the data of the fit, `found` for all data of the test; `modes` are the modes
    of both, or the reason why they are missing.
    """

    ready: Prepared
    test: str
    figures: Mapping[str, float]
    found: Correlation
    faults: Mapping[str, tuple[Finding, ...]]
    modes: ModeCorrelation | str


def _format_test_name(compared: StartComparison) -> str:
    return compared.test


def _format_figures(compared: StartComparison) -> str:
    return agreement_table({"start": compared.figures})


def _format_by_response(compared: StartComparison) -> str:
    by_response = compared.found.by_response()
    names = [name for name in SHORT_NAMES if name in next(iter(by_response.values()))]
    rows = []
    for label, values in by_response.items():
        rows.append([label, *(figure_text(name, values[name]) for name in names)])
    return text_table(("response", *(SHORT_NAMES[name] for name in names)), rows)


def _format_test_faults(compared: StartComparison) -> str:
    tests = [test for test in compared.ready.tests if test.name == compared.test]
    return format_faults(tests, compared.faults)


def _format_modes(compared: StartComparison) -> str:
    from updyn.job.modes import start_modes_text

    return start_modes_text(compared.modes)


#: Sections of ``updyn correlate``, for each test.
CORRELATE: tuple[Callable[[StartComparison], str], ...] = (
    _format_test_name,
    _format_figures,
    _format_by_response,
    _format_modes,
    _format_test_faults,
)


# -- several commands ------------------------------------------------------------------------------
def format_faults(tests: Sequence[PreparedTest], faults: Mapping[str, tuple[Finding, ...]]) -> str:
    """Return the suspected faults in the data of tests, each with its remedy."""
    from updyn.modal import ModeSet

    if all(isinstance(test.data, ModeSet) for test in tests):
        return ""  # faults are searched for in FRFs only
    texts = []
    for test in tests:
        for one in faults[test.name]:
            where = f"{test.name}: " if test.name else ""
            texts.append(f"{where}{one.statement}\n{one.remedy}")
    if not texts:
        return "No known fault was found in the data before any fit."
    return "\n".join(["Suspected faults, before any fit:", *texts])


def describe_job(ready: Prepared) -> str:
    """Return model, test and fitted data of a job as text."""
    job = ready.job
    texts = [f"{ready.title}: {job.method.name}"]
    for test in ready.tests:
        if test.name:
            texts.append(f"{test.name}:")
        texts.append(_describe_model(test))
        texts.append(describe_test(test))
        texts.append(describe_fit(test))
    return "\n".join(texts)


def _describe_model(test: PreparedTest) -> str:
    groups = test.model.groups
    return f"model: {test.model.n_dofs} DOFs, {len(groups)} groups: {_join_names(groups)}"


def describe_test(test: PreparedTest) -> str:
    """Return the size of the data of a test."""
    from updyn.modal import ModeSet

    if isinstance(test.data, ModeSet):
        modes = test.data
        band = f"from {modes.frequency[0]:.4g} to {modes.frequency[-1]:.4g} Hz"
        if not modes.has_shapes:
            return f"test: {len(modes)} natural frequencies {band}, without shapes"
        return (
            f"test: {len(modes)} modes {band} at {len(modes.dofs)} DOFs; all are DOFs of the model"
        )
    frf = test.frf
    return (
        f"test: {frf.quantity}, {len(frf.freq)} lines from {frf.freq[0]:.4g} to"
        f" {frf.freq[-1]:.4g} Hz, {len(frf.responses)} responses, {len(frf.references)} references;"
        " all are DOFs of the model"
    )


def describe_fit(test: PreparedTest) -> str:
    """Return the fitted lines and responses, and the held-out data."""
    from updyn.modal import ModeSet

    chosen, held = test.job.method.lines, test.job.validation
    if isinstance(test.fitted, ModeSet):
        return _describe_fitted_modes(len(test.fitted), len(test.freq), held)
    used: str | int = len(test.fitted.freq)
    if isinstance(chosen, str):
        used = chosen
    elif chosen is not None and len(chosen):
        used = len(chosen)
    text = (
        f"fit: {used} of {len(test.frf.freq)} lines, {len(test.fitted.responses)} of"
        f" {len(test.frf.responses)} responses"
    )
    if not held:
        return text
    if isinstance(held[0], float):
        low, high = held
        return f"{text}; held out: {low:.4g} to {high:.4g} Hz"
    return f"{text}; held out: {_join_names(map(str, held))}"


def _describe_fitted_modes(fitted: int, measured: int, held: Any) -> str:
    """Return the numbers of fitted and measured modes, and the held-out band."""
    text = f"fit: {fitted} of {measured} modes"
    return f"{text}; held out: {held[0]:.4g} to {held[1]:.4g} Hz" if held else text


def _join_names(names: Iterable[str]) -> str:
    listed = list(names)
    most = DESCRIPTION.listed_items
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(listed[:most]) + more
