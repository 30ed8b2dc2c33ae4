"""`Job` and the tables of a job file: one pydantic class per table, each derived from `Table`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, PrivateAttr, Strict, model_validator

from updyn.errors import suggest
from updyn.group import GROUP_QUANTITIES
from updyn.job.base import Document, Pair, Table, Texts, is_number, tables_of
from updyn.job.records_table import RecordsTable
from updyn.job.toml_lines import Place

__all__ = [
    "CalibrationTable",
    "DampingTable",
    "ElementTable",
    "HeldOut",
    "Job",
    "MatchTable",
    "MethodTable",
    "ModelTable",
    "Noise",
    "OutputTable",
    "Pair",
    "ParameterTable",
    "SelectionTable",
    "Table",
    "TestTable",
    "Texts",
    "is_number",
    "tables_of",
]


def _parse_groups(given: object) -> object:
    globs = [given] if isinstance(given, str) else given
    if (
        not isinstance(globs, list | tuple)
        or not globs
        or not all(isinstance(g, str) for g in globs)
    ):
        raise ValueError("expected group names or globs, such as ['shaft', 'gear*']")
    return tuple(globs)


def _parse_drives(given: object) -> object:
    if isinstance(given, Mapping) and given and all(is_number(p) for p in given.values()):
        return {name: float(power) for name, power in given.items()}
    if isinstance(given, list | tuple) and given and all(isinstance(g, str) for g in given):
        return tuple(given)
    raise ValueError(
        'expected names with powers, such as { "skin.stiffness" = 1 }, or an array of names'
    )


def _parse_sensors(given: object) -> object:
    if given == "all":
        return given
    if isinstance(given, list | tuple) and all(isinstance(x, str) for x in given):
        return tuple(given)
    raise ValueError("expected 'all' or labels, such as ['5:Z', '7:Z']")


def parse_dofs(given: object) -> object:
    """Return the DOFs of an element; ValueError if it is none of their forms."""
    if isinstance(given, str):
        return given
    if isinstance(given, Mapping) and given and all(is_number(w) for w in given.values()):
        return {label: float(weight) for label, weight in given.items()}
    if isinstance(given, list | tuple) and given and all(isinstance(x, str) for x in given):
        return tuple(given)
    raise ValueError('expected one label, two labels such as ["1:X", "2:X"], or weights by label')


class ParameterTable(Table):
    """``[[parameter]]``: unknowns of groups, of nonlinear elements, or one that drives several."""

    groups: Annotated[tuple[str, ...] | None, BeforeValidator(_parse_groups)] = None
    element: Annotated[tuple[str, ...] | None, BeforeValidator(_parse_groups)] = None
    quantity: (
        Literal["stiffness", "mass", "loss_factor", "viscous", "mass_damping", "stiffness_damping"]
        | str
        | None
    ) = None
    name: str | None = None
    drives: Annotated[tuple[str, ...] | dict[str, float] | None, BeforeValidator(_parse_drives)] = (
        None
    )
    nominal: float | None = Field(default=None, gt=0)
    unit: str = ""
    bounds: Pair | None = Field(
        default=None, description="of a factor above 0, of a value at least 0"
    )
    prior_std: float | None = Field(
        default=None,
        gt=0,
        description="standard deviation of a Gaussian prior about the start",
    )
    start: float | None = None

    @model_validator(mode="after")
    def _check_kind(self) -> ParameterTable:
        if self.element is not None:
            return self._check_element()
        if self.groups is not None and self.quantity not in (None, *GROUP_QUANTITIES):
            raise ValueError(
                f"quantity {self.quantity!r}: {suggest(str(self.quantity), GROUP_QUANTITIES)}"
            )
        plain, linked = (self.groups, self.quantity), (self.name, self.drives)
        if any(x is not None for x in plain) and any(x is not None for x in linked):
            raise ValueError(
                "groups and quantity are one way to choose, name and drives the other; give one"
                " pair"
            )
        for pair, keys in ((plain, ("groups", "quantity")), (linked, ("name", "drives"))):
            for one, other, missing in ((pair[0], pair[1], keys[1]), (pair[1], pair[0], keys[0])):
                if one is not None and other is None:
                    raise ValueError(f"missing key {missing!r}")
        if self.groups is None and self.name is None:
            raise ValueError(
                "expected groups and quantity, element and quantity, or name and drives"
            )
        return self

    def _check_element(self) -> ParameterTable:
        other = [key for key in ("groups", "name", "drives", "nominal") if getattr(self, key)]
        if other or self.unit:
            raise ValueError(
                f"element: a parameter of a nonlinear element has no {(other or ['unit'])[0]}"
            )
        if self.quantity is None:
            raise ValueError("missing key 'quantity'")
        return self


class ElementTable(Table):
    """``[[element]]``: a nonlinear element; further keys are the values of its kind."""

    model_config = ConfigDict(extra="allow")

    name: str
    kind: str
    dofs: Annotated[str | tuple[str, ...] | dict[str, float], BeforeValidator(parse_dofs)]

    @property
    def values(self) -> dict[str, object]:
        """Values of the element."""
        return dict(self.__pydantic_extra__ or {})


class DampingTable(Table):
    """``[[damping]]``: initial damping of groups, which replaces the damping in the model."""

    groups: Annotated[tuple[str, ...], BeforeValidator(_parse_groups)]
    loss_factor: float | None = Field(default=None, ge=0)
    mass_damping: float | None = Field(default=None, ge=0)
    stiffness_damping: float | None = Field(default=None, ge=0)
    loss_table: Annotated[
        tuple[Annotated[tuple[float, ...], Strict(False)], ...] | None, Strict(False)
    ] = None

    @property
    def damping_values(self) -> dict[str, Any]:
        """Damping values that the table gives, by name."""
        return self.model_dump(exclude={"groups"}, exclude_none=True)

    @model_validator(mode="after")
    def _require_damping(self) -> DampingTable:
        if not self.damping_values:
            raise ValueError("expected loss_factor, mass_damping, stiffness_damping or loss_table")
        return self


class CalibrationTable(Table):
    """``[[calibration]]``: calibration factors of sensors, one unknown per factor."""

    responses: Annotated[Literal["all"] | Texts, BeforeValidator(_parse_sensors)] = ()
    references: Annotated[Literal["all"] | Texts, BeforeValidator(_parse_sensors)] = ()
    prior_std: float = Field(default=0.05, gt=0)
    bounds: Pair = (0.1, 10.0)
    name: str | None = None

    @model_validator(mode="after")
    def _require_sensors(self) -> CalibrationTable:
        if not self.responses and not self.references:
            raise ValueError("expected responses or references: labels, or 'all'")
        return self


def _parse_lines(given: object) -> object:
    if isinstance(given, str):
        return given
    if isinstance(given, list | tuple) and given and all(is_number(x) for x in given):
        return tuple(float(x) for x in given)
    raise ValueError(
        "expected 'd-optimal:N' or an array of frequencies in Hz; leave it out to fit all lines"
    )


def _parse_validation(given: object) -> object:
    if isinstance(given, list | tuple) and given:
        if all(isinstance(x, str) for x in given):
            return tuple(given)
        if len(given) == 2 and all(is_number(x) for x in given):
            return float(given[0]), float(given[1])
    raise ValueError(
        "expected response labels, such as ['5:+Z'], or a band of two frequencies in Hz"
    )


def _parse_noise(given: object) -> object:
    if not isinstance(given, str | Mapping):
        raise ValueError(  # noqa: TRY004
            "expected a table with relative and/or floor, such as { relative = 0.02, floor ="
            " 0.001 }"
        )
    return given


def _parse_regularise(given: object) -> object:
    if isinstance(given, str):
        return given
    if not is_number(given) or given <= 0:
        raise ValueError(
            "expected 'gcv', 'l-curve', 'discrepancy', 'tsvd', 'tsvd:N', or a strength above 0"
        )
    return float(given)


def _parse_count(given: object) -> object:
    if given != "rank" and (not isinstance(given, int) or isinstance(given, bool) or given < 1):
        raise ValueError("expected a whole number of at least 1, or 'rank'")
    return given


def _parse_cosine(given: object) -> object:
    if not is_number(given) or not 0 < given < 1:
        raise ValueError("expected a cosine between 0 and 1, such as 0.99")
    return given


#: Noise and validation set of a test, given in ``[method]`` or, for one test, in ``[test]``.
Noise = Annotated[str | dict[str, float | str] | None, BeforeValidator(_parse_noise)]
HeldOut = Annotated[
    tuple[str, ...] | tuple[float, float] | None, BeforeValidator(_parse_validation)
]


class SelectionTable(Table):
    """``[selection]``: which unknowns are fitted; others are clustered or keep their start."""

    cluster: Annotated[float | None, BeforeValidator(_parse_cosine)] = None
    n: Annotated[int | Literal["rank"] | None, BeforeValidator(_parse_count)] = None
    max_collinearity: float | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _check_rules(self) -> SelectionTable:
        if self.cluster is None and self.n is None and self.max_collinearity is None:
            raise ValueError(
                "expected cluster, n or max_collinearity; leave [selection] out to fit all unknowns"
            )
        if self.n is not None and self.max_collinearity is not None:
            raise ValueError("n and max_collinearity are alternatives; give one")
        return self


class MethodTable(Table):
    """``[method]``: the update method and its settings; further keys are options of the method."""

    model_config = ConfigDict(extra="allow")

    name: str = "maximum-likelihood"
    lines: Annotated[str | tuple[float, ...] | None, BeforeValidator(_parse_lines)] = Field(
        default=None,
        description=(
            '"d-optimal:N": the N frequency lines with the most information about the unknowns'
        ),
    )
    noise: Noise = Field(
        default=None,
        description=(
            "{ relative = a, floor = b }: standard deviation a of the magnitude, b of the rms"
        ),
    )
    validation: HeldOut = Field(
        default=None, description="held out of the fit and scored afterwards"
    )
    tier: str | None = None
    backend: str | None = None
    accuracy: float | None = Field(default=None, ge=1e-10, le=0.1)
    regularise: Annotated[str | float | None, BeforeValidator(_parse_regularise)] = None

    @property
    def options(self) -> dict[str, Any]:
        """The options of the method."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def settings(self) -> dict[str, Any]:
        """The other given settings, as arguments of `updyn.update` and `updyn.compare`."""
        return self.model_dump(
            include={"tier", "backend", "accuracy", "regularise"}, exclude_none=True
        )


#: Files that every run writes, in the order of their creation.
OUTPUTS = (
    "model.h5",
    "run.nc",
    "report.html",
    "job.toml",
    "result.json",
)


def _parse_tolerance(given: object) -> object:
    share = isinstance(given, str) and given.strip().endswith("%")
    if given != "any" and not share and (not is_number(given) or given <= 0):
        raise ValueError(
            "expected a distance in m above 0, or a share of the model's size, such as '0.5 %'; by"
            " label also 'any'"
        )
    return given


def _parse_alignment(given: Any) -> object:
    pairs = isinstance(given, Mapping) and all(re.fullmatch(r"-?[0-9]+", key) for key in given)
    if (
        pairs
        and given
        and all(isinstance(v, int) and not isinstance(v, bool) for v in given.values())
    ):
        return dict(given)
    matrix = isinstance(given, list | tuple) and all(
        isinstance(row, list | tuple) and len(row) == 4 for row in given
    )
    if matrix and len(given) == 4 and all(is_number(x) for row in given for x in row):
        return [[float(x) for x in row] for row in given]
    if given != "fit":
        raise ValueError(
            "expected 'fit', a table of nodes of the test = nodes of the model, or a 4 x 4 array"
        )
    return given


AnyTable = TypeVar("AnyTable", bound=Table)


class ModelTable(Table):
    """``[model]``: a file with options of its reader, or a kind with keys of its builder."""

    model_config = ConfigDict(extra="allow")

    file: str | None = None
    format: str | None = None
    kind: str | None = None
    groups: dict[str, Any] | None = None  # to merge, by patterns

    @property
    def keys(self) -> dict[str, Any]:
        """The keys of the builder, or the options of the reader."""
        return dict(self.__pydantic_extra__ or {})


class TestTable(Table):
    """``[test]``: the measurement and the part of it that is used."""

    __test__ = False  # not a test, although pytest would collect the name

    file: str | None = None  # default: the FRFs of [records]
    repeats: Texts | None = Field(
        default=None, min_length=1
    )  # further files of the same test, averaged
    modes: str | None = None  # measured modes, alone or in addition to FRFs (method "modal")
    modes_reader: dict[str, Any] | None = None  # options of the reader of the modes file
    format: str | None = None
    quantity: str | None = Field(
        default=None,
        description='"receptance", "mobility", "accelerance" or "transmissibility", where the file'
        " does not say",
    )
    duplicates: str | None = None
    scalar_direction: str | None = None
    scale: float | None = Field(
        default=None, gt=0, description="universal files: factor that turns values into SI"
    )
    local_axes: bool | None = None
    real_valued: bool | None = None
    response_labels: Texts | None = None  # for files of bare arrays
    reference_labels: Texts | None = None
    order: Texts | None = None
    columns: dict[str, Any] | None = None  # for tables of any layout
    variables: dict[str, Any] | None = None  # for arrays of any name
    averages: int | None = Field(default=None, ge=1)
    band: Pair | None = Field(default=None, description="Hz; lines to use, both ends included")
    exclude: Annotated[tuple[Pair, ...] | None, Strict(False)] = Field(
        default=None,
        min_length=1,
        description="Hz; bands whose lines are not used, such as [[49.5, 50.5]] for the mains",
    )
    responses: Texts | None = Field(
        default=None,
        min_length=1,
        description="responses to use, in this order, as the file labels them",
    )
    references: Texts | None = Field(default=None, min_length=1)
    base: Texts | None = Field(
        default=None,
        min_length=1,
        description="transmissibility: DOFs of the model that move together as the base",
    )
    force: str | None = Field(
        default=None,
        description="transmissibility between two sensors: DOF of the force of unknown size",
    )
    level: float | None = Field(
        default=None, gt=0, description="amplitude of the force in N (N m); RMS of a random force"
    )
    sweep: Literal["up", "down"] | None = Field(
        default=None, description="direction in which the frequency of that test changed"
    )
    excitation: Literal["sine", "random"] | None = Field(
        default=None, description="force of the level: a sine, or a random force"
    )
    spectrum: Annotated[tuple[Pair, ...] | None, Strict(False)] = Field(
        default=None,
        min_length=2,
        description="frequencies in Hz and densities in N^2/Hz",
    )
    repair: Texts | None = Field(default=None, min_length=1)  # data faults to repair
    name: str = ""
    grounded: Texts | None = None  # the configuration: fixed DOFs and added masses
    masses: dict[str, float] | None = None
    sensor_masses: dict[str, float] | None = Field(default=None, min_length=1)
    # These two override the keys of [method].
    noise: Noise = None
    validation: HeldOut = None

    @property
    def source(self) -> str:
        """Source of the FRFs, for messages."""
        return "[records]" if self.file is None else self.file

    @property
    def of_frfs(self) -> list[str]:
        """Keys that the table gives and that apply only to FRFs."""
        keys = [*self.reader_options, "repeats", "averages", "exclude", "base", "force"]
        keys += ["level", "sweep", "excitation", "spectrum", "repair"]
        return [key for key in keys if getattr(self, key) is not None]

    @property
    def reader_options(self) -> dict[str, Any]:
        """Keyword arguments for the reader; only those that the job gives."""
        options = {
            "format": self.format,
            "quantity": self.quantity,
            "duplicates": self.duplicates,
            "scalar_direction": self.scalar_direction,
            "scale": self.scale,
            "local_axes": self.local_axes,
            "real_valued": self.real_valued,
            "response_labels": self.response_labels,
            "reference_labels": self.reference_labels,
            "order": self.order,
            "columns": self.columns,
            "variables": self.variables,
            "responses": self.responses,
            "references": self.references,
        }
        return {k: v for k, v in options.items() if v is not None}


#: ``[test]`` of a job that has no measurement yet, and the tables that replace model and unknowns
#: in a job with only a measurement.
NO_TEST = {"file": ""}
NO_UPDATE = {
    "model": {"file": ""},
    "parameter": ({"groups": "*", "quantity": "stiffness"},),
}


class MatchTable(Table):
    """``[match]``: how sensors are matched to DOFs of the model."""

    by: Literal["label", "coordinates"] = Field(
        default="label",
        description='"label": test and model call the same thing the same; or "coordinates"',
    )
    geometry: str | None = None
    lines: (
        Annotated[
            tuple[Annotated[tuple[int, ...], Strict(False), Field(min_length=2)], ...],
            Strict(False),
        ]
        | None
    ) = None
    tolerance: Annotated[float | str | None, BeforeValidator(_parse_tolerance)] = Field(
        default=None, description="largest distance between a sensor and its node"
    )
    unit: Literal["m", "cm", "mm", "in", "ft"] | None = Field(
        default=None, description="unit of length of the positions of the test"
    )
    alignment: Annotated[Any, BeforeValidator(_parse_alignment)] = None
    angle: float | None = Field(default=None, ge=0, le=45)
    table: dict[str, str] = Field(
        default_factory=dict,
        description="label in the test = label in the model, whatever by says",
    )
    directions: dict[str, Annotated[tuple[float, float, float], Strict(False)]] = Field(
        default_factory=dict
    )


class OutputTable(Table):
    """``[output]``: optional files of a run."""

    report: bool = Field(default=True, description="whether report.html is written")
    properties: str | None = None


class Job(Document):
    """A job file, read by `load_job`: its title and tables, with the line of each key."""

    title: str = ""
    model: ModelTable
    records: RecordsTable | None = None
    test: TestTable
    match: MatchTable = MatchTable()
    parameter: Annotated[
        tuple[ParameterTable, ...], BeforeValidator(tables_of("parameter")), Strict(False)
    ] = Field(min_length=1)
    element: Annotated[
        tuple[ElementTable, ...], BeforeValidator(tables_of("element")), Strict(False)
    ] = ()
    damping: Annotated[
        tuple[DampingTable, ...], BeforeValidator(tables_of("damping")), Strict(False)
    ] = ()
    calibration: Annotated[
        tuple[CalibrationTable, ...], BeforeValidator(tables_of("calibration")), Strict(False)
    ] = ()
    selection: SelectionTable | None = None
    method: MethodTable = MethodTable()
    output: OutputTable = OutputTable()

    _tables: dict[str, Table] = PrivateAttr(default_factory=dict)
    _others: tuple[Job, ...] = PrivateAttr(default=())

    @property
    def parts(self) -> tuple[Job, ...]:
        """One job per test, this one first; they differ in ``test`` and its line numbers."""
        return (self, *self._others)

    @property
    def tables(self) -> Mapping[str, Table]:
        """Validated tables of `updyn.job.job_table.JOB_TABLES` in the job, by name."""
        return self._tables

    def table(self, kind: type[AnyTable]) -> AnyTable | None:
        """Return one of the job's `tables`.

        Parameters
        ----------
        kind : type
            Its class.

        Returns
        -------
        Table or None
            None if the job has no such table.
        """
        return next((table for table in self._tables.values() if isinstance(table, kind)), None)

    def find_title(self, model_title: str = "") -> str:
        """Return the title of the job, otherwise that of its model, otherwise the file's name.

        Parameters
        ----------
        model_title : str, optional
            Title of the model, if it is known.

        Returns
        -------
        str
            The title, which is not empty.
        """
        return self.title or model_title or self.path.stem

    @property
    def has_modes(self) -> bool:
        """Whether the data of the test are modes."""
        test = self.test
        return test.file is None and test.modes is not None and self.records is None

    @property
    def lines_to_fit(self) -> str | list[float] | None:
        """The lines of ``[method]``, as an argument of `updyn.update`."""
        return (
            list(self.method.lines) if isinstance(self.method.lines, tuple) else self.method.lines
        )

    @property
    def noise(self) -> str | dict[str, float | str] | None:
        """The noise of this test."""
        return self.method.noise if self.test.noise is None else self.test.noise

    @property
    def validation(self) -> tuple[str, ...] | tuple[float, float] | None:
        """The validation set of this test (held out of the fit)."""
        return self.method.validation if self.test.validation is None else self.test.validation

    def table_of(self, key: Literal["noise", "validation"]) -> Literal["test", "method"]:
        """Return the table that gives a key which both ``[test]`` and ``[method]`` may have.

        Parameters
        ----------
        key : {"noise", "validation"}
            The key.

        Returns
        -------
        {"test", "method"}
            ``"test"`` if ``[test]`` gives the key.
        """
        return "method" if getattr(self.test, key) is None else "test"

    def with_source(self, path: Path, lines: dict[Place, int], tables: dict[str, Table]) -> Job:
        """Return this job with its file, line numbers and additional tables.

        Parameters
        ----------
        path : Path
            The file.
        lines : dict of Place to int
            Line of each key.
        tables : dict of str to Table
            Tables of `updyn.job.job_table.JOB_TABLES`, by name.

        Returns
        -------
        Job
            A copy.
        """
        out = self.at(path, lines)
        out._tables = tables
        return out

    def with_tables(self, given: Mapping[str, object], at: Place) -> Job:
        """Return this job with other tables, and without the tables of `JOB_TABLES`.

        Parameters
        ----------
        given : mapping of str to object
            Validated tables by name; all others are those of this job.
        at : Place
            Place of these tables in the file.

        Returns
        -------
        Job
            A copy.
        """
        parts = []
        for part in self.parts:
            lines = {place: line for place, line in part._lines.items() if place[:1] != at[:1]}
            for place, line in part._lines.items():
                if place[: len(at)] == at:
                    lines[place[len(at) :]] = line
            parts.append(part.model_copy(update=dict(given)).with_source(part.path, lines, {}))
        return parts[0].with_others(tuple(parts[1:]))

    def with_others(self, others: tuple[Job, ...]) -> Job:
        """Return this job as the first of several tests.

        Parameters
        ----------
        others : tuple of Job
            The same job with the other tests.

        Returns
        -------
        Job
            A copy.
        """
        out = self.with_source(self._path, self._lines, self._tables)
        out._others = others
        return out
