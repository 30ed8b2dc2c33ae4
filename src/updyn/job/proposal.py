"""`job_text`: propose a commented job file from a model and a measurement.

Comments state the properties of the inputs that determine a key, and its meaning (from the schema).
"""

from __future__ import annotations

import shlex
import textwrap
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from updyn import __version__
from updyn.errors import FormatError, InputError
from updyn.frf import FRF, QUANTITIES, TRANSMISSIBILITY
from updyn.io import read_frf, read_model
from updyn.io.csv_proposal import UNKNOWN
from updyn.io.inventory import list_items
from updyn.io.toml_text import format_mapping, format_toml
from updyn.job.folder import relative_path
from updyn.job.schema import (
    Job,
    MatchTable,
    MethodTable,
    OutputTable,
    ParameterTable,
    Table,
    TestTable,
)
from updyn.job.settings import PROPOSAL
from updyn.matching import Matching, match
from updyn.matching.result import MatchError
from updyn.model import Model
from updyn.text_table import format_count, printable
from updyn.updating.before_search import REMEDY
from updyn.updating.judge.counterparts import Counterparts, find_counterparts

__all__ = [
    "Inputs",
    "ReadFRF",
    "describe_inputs",
    "is_job",
    "job_text",
    "propose_unknown",
    "read_any_quantity",
    "read_guessed",
    "read_inputs",
]

_WIDTH = 100
#: Options of readers for labels that a file does not hold.
_LABELS = ("response_labels", "reference_labels")
#: Options of a reader, as a job states them.
ReaderOptions = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Model and measurement read from the two files, and the result of matching them.

    `model_options` and `frf_options` are the reader options of the user. If the file needs a
    mapping of its columns or variables, `frf_options` has the one guessed from their names, and
    `guessed` is its key. If some labels of the test are not DOFs of the model, `matching` is None,
    `unmatched` has these labels, `match_error` is the error of matching by label, and
    `match_options` are those of `match` without ``by``. `counterparts` is None if the sensor
    positions are unknown.
    """

    model_file: Path
    frf_file: Path
    model: Model
    frf: FRF
    model_options: dict[str, object]
    frf_options: dict[str, object]
    has_quantity: bool
    matching: Matching | None
    unmatched: tuple[str, ...] = ()
    match_error: str = ""
    match_options: dict[str, object] = field(default_factory=dict)
    counterparts: Counterparts | None = None
    guessed: str = ""

    @property
    def sensors(self) -> list[str]:
        """Unique unsigned labels of sensors and forces in the test."""
        dofs = (*self.frf.responses, *self.frf.references)
        return list(dict.fromkeys(f"{dof.node}:{dof.direction}" for dof in dofs))

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns that the job proposes."""
        groups = self.model.groups.values()
        elastic = sum(group.stiffness is not None for group in groups)
        return 2 * elastic or sum(group.mass is not None for group in groups)

    @property
    def missing_keys(self) -> list[str]:
        """Keys that the user has to add before the job can run."""
        texts = []
        if not self.has_quantity:
            texts.append("what was measured: quantity in [test]")
        if self.matching is None and not self.unmatched:
            texts.append("how the sensors lie on the model: [match]")
        elif self.matching is None:
            n, of = len(self.unmatched), len(self.sensors)
            texts.append(f"where {n} of {of} sensors and forces are on the model: [match.table]")
        return texts


# -- reading ---------------------------------------------------------------------------------------
def read_inputs(
    model_file: Path, frf_file: Path, of_model: ReaderOptions, of_frf: dict[str, object]
) -> Inputs:
    """Read model and measurement and match them by label, otherwise by coordinates.

    `of_model` and `of_frf` are options of the readers.
    """
    try:
        model = read_model(model_file, **of_model)
    except InputError as error:
        if not _is_measurement(model_file):
            raise
        raise _swapped_files_error(model_file, frf_file) from error
    try:
        read = read_guessed(frf_file, of_frf)
    except InputError as error:
        for what, is_such in (("model", _is_model), ("job", is_job)):
            if is_such(frf_file):
                text = f"{frf_file} is a {what}; expected a measurement second"
                raise FormatError(f"{text}: updyn new MODEL MEASUREMENT") from error
        raise
    frf = read.frf
    inputs = (model_file, frf_file, model, frf, of_model, read.options, read.has_quantity)
    guessed = next(iter(read.options.keys() - of_frf.keys()), "")
    try:
        return _add_counterparts(Inputs(*inputs, match(model, frf), guessed=guessed))
    except MatchError as error:
        unmatched, match_error, options = tuple(error.lost), str(error), error.proposal
    if model.geometry is not None and frf.geometry is not None:
        try:
            matching, options = _match_by_coordinates(model, frf, options)
            matched = Inputs(*inputs, matching, (), match_error, options, guessed=guessed)
            return _add_counterparts(matched)
        except InputError as error:
            match_error += f"\nBy coordinates: {error}"
    return Inputs(*inputs, None, unmatched, match_error, guessed=guessed)


def _add_counterparts(inputs: Inputs) -> Inputs:
    """Return matched inputs with the counterparts of the measured modes."""
    assert inputs.matching is not None
    frf = inputs.matching.frf
    if frf.quantity == TRANSMISSIBILITY:
        frf = frf.with_excitation(frf.references)
    return replace(inputs, counterparts=find_counterparts(inputs.matching.model, frf))


def _match_by_coordinates(
    model: Model, frf: FRF, options: ReaderOptions
) -> tuple[Matching, dict[str, Any]]:
    """Match by coordinates, in another length unit if only that fits; return the options, too."""
    options = {name: value for name, value in options.items() if name != "by"}
    try:
        return match(model, frf, by="coordinates", **options), options
    except MatchError as error:
        if not error.proposal:
            raise
        options |= error.proposal
    return match(model, frf, by="coordinates", **options), options


def _swapped_files_error(first: Path, second: Path) -> FormatError:
    """Return the error for a measurement given in place of the model."""
    if _is_model(second):
        right = shlex.join(["updyn", "new", str(second), str(first)])
        return FormatError(f"{first} is a measurement and {second} a model: swap the two: {right}")
    return FormatError(
        f"{first} is a measurement; expected a model first: updyn new MODEL MEASUREMENT"
    )


def _is_measurement(path: Path) -> bool:
    try:
        read_guessed(path, {})
    except InputError:
        return False
    return True


def _is_model(path: Path) -> bool:
    try:
        read_model(path)
    except InputError:
        return False
    return True


def is_job(path: Path) -> bool:
    """Return whether a file is a job file: TOML with one of its tables."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return any(name in content for name in Job.model_fields)


@dataclass(frozen=True, slots=True, eq=False)
class ReadFRF:
    """A measurement, the options with which it was read, and whether its quantity is known."""

    frf: FRF
    options: ReaderOptions
    has_quantity: bool


def read_guessed(path: Path, options: ReaderOptions) -> ReadFRF:
    """Read a measurement, with a guessed mapping if the file has no known layout."""
    try:
        return read_any_quantity(path, options)
    except InputError:
        guessed = None if {"columns", "variables"} & set(options) else _guess_options(path, options)
        if guessed is None:
            raise
        return read_any_quantity(path, guessed)


def read_any_quantity(path: Path, options: ReaderOptions) -> ReadFRF:
    """Read a measurement; as accelerance if the file does not state the measured quantity."""
    try:
        return ReadFRF(read_frf(path, **options), options, True)
    except FormatError:
        if "quantity" in options:
            raise
        try:
            frf = read_frf(path, quantity="accelerance", **options)
        except InputError:
            frf = None
        if frf is None:
            raise
        return ReadFRF(frf, options, False)


def _guess_options(path: Path, options: ReaderOptions) -> ReaderOptions | None:
    """Return the options with a guessed mapping of columns or variables; None if incomplete.

    Labels in the options replace unknown ones.
    """
    try:
        found = list_items(path)
    except InputError:
        return None
    mapping = dict(found.proposal)
    if not mapping:
        return None
    labels = [options.get(name) for name in _LABELS]
    if "channels" not in mapping:  # one array of all values
        return {**options, found.option: mapping} if all(labels) else None
    channels = [dict(channel) for channel in mapping["channels"]]
    unknown = [channel for channel in channels if UNKNOWN in channel.values()]
    if unknown:
        responses, references = labels
        if not (isinstance(responses, list) and isinstance(references, list)):
            return None
        if len(responses) != len(unknown) or len(references) != 1:
            return None
        for channel, response in zip(unknown, responses, strict=True):
            channel |= {"response": response, "reference": references[0]}
    others = {name: value for name, value in options.items() if name not in _LABELS}
    return {**others, found.option: {**mapping, "channels": channels}}


def describe_inputs(inputs: Inputs) -> str:
    """Return a summary of the inputs and of the keys that the user has to add, as text."""
    model, of = inputs.model, len(inputs.sensors)
    how = "" if inputs.matching is None else f", by {_describe_matching(inputs)}"
    matched = f"{of - len(inputs.unmatched)} of {of} sensors and forces are DOFs of the model{how}"
    if inputs.match_error and inputs.matching is None and not inputs.unmatched:
        matched = inputs.match_error
    elif inputs.match_error and inputs.matching is not None:
        matched += (
            f"\nNot by label: {inputs.match_error}"
            "\nThe distances in the job show whether that is right"
        )
    elif inputs.matching is not None:
        matched = "\n".join([matched, *inputs.matching.notes])
    texts = [
        f"model: {model.n_dofs} DOFs, {len(model.groups)} groups",
        f"measurement: {len(inputs.frf.freq)} lines, {len(inputs.frf.responses)} responses,"
        f" {len(inputs.frf.references)} references",
        matched,
        *_describe_guess(inputs),
        *_describe_counterparts(inputs),
        f"proposed: {format_count(inputs.n_unknowns, 'unknown')}",
    ]
    texts += [f"Before it can run, state {text}" for text in inputs.missing_keys]
    return "\n".join(texts)


def _describe_guess(inputs: Inputs) -> list[str]:
    """Return a note if the mapping was guessed."""
    return [f"{inputs.guessed}: guessed from their names; check them"] if inputs.guessed else []


def _describe_counterparts(inputs: Inputs) -> list[str]:
    """Return how many measured modes have a counterpart in the model, and a remedy if few."""
    found = inputs.counterparts
    if found is None:
        return []
    return [found.statement, found.remedy or REMEDY] if found.few else [found.statement]


def _describe_matching(inputs: Inputs) -> str:
    """Return how sensors were matched, with the options used."""
    assert inputs.matching is not None
    options = ", ".join(
        f"{name} = {format_toml(value)}" for name, value in inputs.match_options.items()
    )
    return f"{inputs.matching.by} ({options})" if options else inputs.matching.by


# -- writing ---------------------------------------------------------------------------------------
def job_text(inputs: Inputs, out: Path, of_model: str = "", of_frf: str = "") -> str:
    """Return the text of a job file (TOML with comments) to be written to `out`.

    `of_model` and `of_frf` describe the contents of model and measurement, for comments.
    """
    tables = (
        _format_head(inputs, out),
        [*_wrap_comment(inputs.model_file.name, of_model), *_format_model(inputs, out)],
        [*_wrap_comment(inputs.frf_file.name, of_frf), *_format_test(inputs, out)],
        _format_match(inputs, out),
        _format_parameters(inputs),
        _format_method(inputs),
        ["[output]", _format_key(OutputTable, "report", True)],
    )
    return "\n\n".join("\n".join(table) for table in tables) + "\n"


def _format_head(inputs: Inputs, out: Path) -> list[str]:
    name = _escape_line_breaks(shlex.quote(out.name))
    lines = [
        f"# A job for updyn {__version__}, proposed from a model and a measurement. To use a",
        "# key in a comment, remove the #. All keys: docs/job.md.",
        f"# Next: updyn check {name}, then updyn run {name}",
    ]
    if inputs.missing_keys:
        lines += ["#", "# Before that, state:", *(f"# - {text}" for text in inputs.missing_keys)]
    return [*lines, "", f"title = {format_toml(inputs.model.title or inputs.frf_file.stem)}"]


def _format_model(inputs: Inputs, out: Path) -> list[str]:
    lines = ["[model]", f"file = {format_toml(relative_path(inputs.model_file, out.parent))}"]
    options = inputs.model_options.items()
    return lines + [f"{name} = {format_toml(value)}" for name, value in options]


def _format_test(inputs: Inputs, out: Path) -> list[str]:
    frf = inputs.frf
    lines = ["[test]", f"file = {format_toml(relative_path(inputs.frf_file, out.parent))}"]
    for name, value in inputs.frf_options.items():
        if name == inputs.guessed:
            lines += [f"# {text}." for text in _describe_guess(inputs)]
        lines.append(_format_key(TestTable, name, value))
    if not inputs.has_quantity:
        lines.append("# The file does not state the measured quantity. Choose one:")
        names = [*QUANTITIES, TRANSMISSIBILITY]
        lines += [f"# quantity = {format_toml(name)}" for name in names]
    if frf.quantity == TRANSMISSIBILITY:
        matched = frf if inputs.matching is None else inputs.matching.frf
        lines.append(_format_key(TestTable, "base", matched.references.labels))
    band = [float(frf.freq[0]), float(frf.freq[-1])]
    lines.append(_format_key(TestTable, "band", band, off=True))
    labels = [str(dof) for dof in frf.responses]
    if inputs.unmatched:
        labels = [label for label in labels if label.lstrip("+-") not in inputs.unmatched] or labels
    if len(labels) <= PROPOSAL.listed_sensors:
        lines.append(_format_key(TestTable, "responses", labels, off=True))
    in_common = _describe_counterparts(inputs)
    if in_common:
        lines += _wrap_comment("Before the search", "\n".join(in_common))
    return lines


def _format_match(inputs: Inputs, out: Path) -> list[str]:
    matching = inputs.matching
    if matching is not None:
        rows = str(matching).splitlines()
        shown = rows[: PROPOSAL.listed_sensors + 3]
        lines = _wrap_comment("Sensors and forces", "\n".join(shown))
        if inputs.match_error:
            lines += _wrap_comment("Not by label", inputs.match_error)
        if len(rows) > len(shown):
            lines.append(f"#   ... and {len(rows) - len(shown)} more: see updyn check")
        lines += ["[match]", _format_key(MatchTable, "by", matching.by)]
        lines += [
            _format_key(MatchTable, name, value) for name, value in inputs.match_options.items()
        ]
        if matching.by == "coordinates" and "tolerance" not in inputs.match_options:
            lines.append(_format_key(MatchTable, "tolerance", "1 %", off=True))
        return lines
    lines = _wrap_comment("Sensors and forces", inputs.match_error)
    lines += ["[match]", _format_key(MatchTable, "by", "label"), "", "[match.table]"]
    lines.append(f"# {_describe_key(MatchTable, 'table')}")
    lines += [f'# {format_toml(label)} = ""' for label in inputs.unmatched]
    return lines


def _format_parameters(inputs: Inputs) -> list[str]:
    groups = inputs.model.groups.values()
    elastic = [group for group in groups if group.stiffness is not None]
    every = "*" if "all" in inputs.model.groups else "all"  # "all" may be the name of a group
    lines: list[str] = []
    if elastic:
        loss = propose_unknown(inputs.model, "loss_factor")
        lines += [
            f"# The unknowns: {inputs.n_unknowns}, stiffness and loss factor of"
            f" {len(elastic)} groups.",
            "# Fewer are better determined: name the groups that can be wrong, such as",
            f"# groups = [{format_toml(next(iter(inputs.model.groups)))}].",
            *_format_unknown(every, "stiffness", PROPOSAL.stiffness_bounds),
            "",
            *_format_unknown(every, "loss_factor", loss["bounds"]),
        ]
        if "start" in loss:
            start = loss["start"]
            lines.append(f"start = {start}  # the model has no structural damping")
    if any(group.viscous is not None for group in groups):
        lines += ["", *_format_unknown(every, "viscous", PROPOSAL.viscous_bounds, off=True)]
    if any(group.mass is not None for group in groups):
        lines += ["", "# Masses are mostly known better than stiffnesses; free those that are not."]
        lines += _format_unknown(every, "mass", PROPOSAL.mass_bounds, off=bool(elastic))
        lines.append(_format_key(ParameterTable, "prior_std", 0.1, off=True))
    return lines


def propose_unknown(model: Model, quantity: str) -> dict[str, Any]:
    """Return the keys ``bounds``, and ``start`` if it is needed, of an unknown of a new job."""
    match quantity:
        case "stiffness":
            return {"bounds": PROPOSAL.stiffness_bounds}
        case "mass":
            return {"bounds": PROPOSAL.mass_bounds}
    elastic = [group for group in model.groups.values() if group.stiffness is not None]
    largest = max((group.loss_factor for group in elastic), default=0.0)
    found: dict[str, Any] = {"bounds": (0.0, max(PROPOSAL.largest_loss_factor, 2.0 * largest))}
    return found if largest > 0.0 else {**found, "start": PROPOSAL.start_loss_factor}


def _format_method(inputs: Inputs) -> list[str]:
    frf = inputs.frf
    known = "estimated from the residual, as the file holds neither variance nor coherence"
    if frf.coherence is not None:
        known = "taken from the coherence in the file"
    if frf.variance is not None:
        known = "taken from the variance in the file"
    n = len(frf.freq)
    lines = ["[method]", 'name = "maximum-likelihood"']
    chosen = f"d-optimal:{min(PROPOSAL.chosen_lines, n)}"
    lines.append(_format_key(MethodTable, "lines", chosen, off=n < PROPOSAL.many_lines))
    lines.append(f"# The noise is {known}.")
    lines.append(_format_key(MethodTable, "noise", {"relative": 0.02, "floor": 0.001}, off=True))
    held = _choose_validation_set(inputs)
    if held:
        lines.append(_format_key(MethodTable, "validation", held))
    else:
        example = _list_known_responses(inputs)[:1]
        lines += [_format_key(MethodTable, "validation", example, off=True)] if example else []
    return lines


def _list_known_responses(inputs: Inputs) -> list[str]:
    if inputs.matching is not None:
        return inputs.matching.frf.responses.labels
    responses = inputs.frf.responses if inputs.unmatched else []
    return [str(dof) for dof in responses if str(abs(dof)) not in inputs.unmatched]


def _choose_validation_set(inputs: Inputs) -> list[str]:
    """Return the model's label of a response to hold out that is not a drive point."""
    if inputs.matching is None or len(inputs.frf.responses) < PROPOSAL.hold_out_from:
        return []
    frf = inputs.matching.frf
    driven = {str(dof).lstrip("+-") for dof in frf.references}
    free = [str(dof) for dof in frf.responses if str(dof).lstrip("+-") not in driven]
    if not free:
        return []
    return [free[len(free) // 2]]


def _format_unknown(
    groups: str, quantity: str, bounds: tuple[float, float], *, off: bool = False
) -> list[str]:
    """Return a ``[[parameter]]`` table, commented out if `off`."""
    mark = "# " if off else ""
    return [
        f"{mark}[[parameter]]",
        f'{mark}groups = "{groups}"',
        f'{mark}quantity = "{quantity}"',
        _format_key(ParameterTable, "bounds", list(bounds), off=off),
    ]


def _format_key(table: type[Table], key: str, value: object, *, off: bool = False) -> str:
    """Return a key, with its description as a comment if it has one; commented out if `off`."""
    about = _describe_key(table, key)
    comment = f"  # {about}" if about else ""
    text = format_mapping(value) if isinstance(value, dict) else format_toml(value)
    return f"{'# ' if off else ''}{key} = {text}{comment}"


def _describe_key(table: type[Table], key: str) -> str:
    """Return the description of a key; empty if it has none, or is an option of a reader."""
    return (table.model_fields[key].description or "") if key in table.model_fields else ""


def _wrap_comment(title: str, text: str) -> list[str]:
    """Return text as wrapped comment lines below a title."""
    lines = [f"# {_escape_line_breaks(title)}:"]
    for line in map(printable, text.splitlines()):
        if "  " in line.strip():  # a row of a table
            lines.append(f"#   {line}")
        else:
            lines += textwrap.wrap(
                line,
                _WIDTH,
                initial_indent="#   ",
                subsequent_indent="#     ",
                break_long_words=False,
                break_on_hyphens=False,
            )
    return lines


def _escape_line_breaks(name: str) -> str:
    """Return the name of a file without line breaks, for a comment."""
    return printable(name).replace("\n", "\\n")
