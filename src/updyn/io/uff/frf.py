"""FRFs of universal files: functions of dataset 58, text or binary, as a complete matrix.

Function type 4 is an FRF, type 5 a transmissibility, type 6 the coherence (gamma^2) of the same
pair of DOFs. If a file has types 4 and 5, type 4 is read unless the user states the quantity
"transmissibility". The reader never interpolates or fills gaps. Directions in a displacement system
of a node become global if they coincide with global axes to 1e-6, unless ``local_axes=True`` keeps
them for `updyn.match`. pyuff 2.5.8 is only a reference in the tests, because it misreads some real
files without a warning.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import AbsentError, FormatError, InputError, OptionError, UpdynWarning, key_path
from updyn.frf import FRF, TRANSMISSIBILITY, check_quantity
from updyn.geometry import Geometry
from updyn.io.items import format_counts, locate_errors, parse_selection
from updyn.io.lengths import length
from updyn.io.settings import MEASURED_FILE
from updyn.io.uff.datasets import datasets
from updyn.io.uff.functions import Function, read_function
from updyn.io.uff.geometry import NUMBERS, GeometryCollector, Units
from updyn.io.uff.labels import FORCE, MOTION, UNKNOWN, abscissa_factor, frf_factor, type_name

__all__ = [
    "Directions",
    "FRFArrays",
    "assemble",
    "read_frf",
    "read_geometry",
]

_INVERSE = {
    "receptance": "dynamic stiffness",
    "mobility": "impedance",
    "accelerance": "apparent mass",
}
#: Function types.
_FRF = 4
_TRANSMISSIBILITY = 5
_COHERENCE = 6


def read_frf(
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    responses: Iterable[str | Dof] | None = None,
    references: Iterable[str | Dof] | None = None,
    scalar_direction: str | None = None,
    scale: float | None = None,
    real_valued: bool = False,
    local_axes: bool = False,
) -> FRF:
    """Read the FRFs of a universal file in SI, with its geometry.

    Averages of duplicates are weighted with the coherence if every function has one. `scale`
    replaces dataset 164 and the unit labels. Measurements with `local_axes` have to be matched with
    `updyn.match` before any other use.
    """
    scalar = _options(duplicates, scalar_direction, scale)
    for name, given in (("local_axes", local_axes), ("real_valued", real_valued)):
        if not isinstance(given, bool):
            raise OptionError(f"{name} {given!r}: expected True or False", key=(name,))
    collector = GeometryCollector(path)
    functions: list[Function] = []
    others = Counter[int]()
    for dataset in datasets(path):
        if dataset.number == 58:
            functions.append(read_function(dataset, path))
        elif dataset.number in NUMBERS:
            collector.take(dataset)
        else:
            others[dataset.number] += 1
    measured = _select_measured(functions, quantity)
    coherences = [f for f in functions if f.kind == _COHERENCE]
    if not measured:
        raise AbsentError(_describe_absence(functions, collector, others), path)
    _warn_of_others(functions, measured[0].kind, path)
    found = _quantity(measured, quantity, path)
    measured = [_to_hertz(f, path) for f in measured]
    coherences = [_to_hertz(f, path) for f in coherences]
    for function in measured:
        _check_values(function, real_valued, path)
    geometry = collector.geometry()

    def factor(function: Function, response: Dof, reference: Dof) -> float:
        if scale is not None:
            return scale
        turns = _is_rotation(response), _is_rotation(reference)
        return frf_factor(function, found, turns, collector.units, path)

    parts = assemble(
        measured,
        coherences,
        Directions(path, scalar, geometry, local_axes),
        factor,
        average=duplicates == "average",
        responses=responses,
        references=references,
    )
    if geometry is not None and not local_axes:
        geometry = Geometry(geometry.nodes, geometry.xyz, geometry.lines, faces=geometry.faces)
    with locate_errors(path):
        return FRF(
            parts.freq,
            parts.values,
            parts.responses,
            parts.references,
            found,
            coherence=parts.coherence,
            geometry=geometry,
            source=_source(path, measured[0], others),
        )


def read_geometry(path: str | Path, *, unit: str | None = None) -> Geometry:
    """Read nodes, their directions and trace lines of a universal file, in m.

    `unit` is the unit of length of a file without dataset 164, by default m.
    """
    stated = None if unit is None else length(unit)
    collector = GeometryCollector(path)
    others = Counter[int]()
    for dataset in datasets(path):
        if dataset.number in NUMBERS:
            collector.take(dataset)
        else:
            others[dataset.number] += 1
    if stated is not None:
        collector.units = _with_length(collector.units, stated, str(unit), path)
    geometry = collector.geometry()
    if geometry is None:
        raise AbsentError(
            f"holds no nodes (dataset 15 or 2411); it holds {_datasets(others)}", path
        )
    return geometry


def _with_length(units: Units, stated: float, unit: str, path: str | Path) -> Units:
    """Return the units with the stated unit of length (m); refuse a contradiction to the file."""
    if not units.line:
        return Units(1.0 / stated, units.force)
    if not np.isclose(units.length * stated, 1.0, rtol=1e-3, atol=0.0):
        raise FormatError(
            f"unit {unit!r} contradicts dataset 164, which defines a metre as {units.length:g}"
            " units of length of the file",
            path,
            units.line,
            key=("unit",),
        )
    return units


def _options(duplicates: str, scalar_direction: str | None, scale: float | None) -> Dof | None:
    if duplicates not in ("raise", "average"):
        raise OptionError(
            f"duplicates={duplicates!r}: expected 'raise' or 'average'", key=("duplicates",)
        )
    is_number = isinstance(scale, int | float) and not isinstance(scale, bool)
    if scale is not None and not (is_number and np.isfinite(scale) and scale > 0):
        raise OptionError(f"scale={scale!r}: expected a positive number", key=("scale",))
    if scalar_direction is None:
        return None
    found = re.fullmatch(r"([+-]?)(R?[XYZ])", str(scalar_direction))
    if found is None:
        raise OptionError(
            f"scalar_direction={scalar_direction!r}: expected one of X Y Z RX RY RZ, optionally"
            " with a sign",
            key=("scalar_direction",),
        )
    return Dof(0, found[2], -1 if found[1] == "-" else 1)


def _select_measured(functions: Sequence[Function], quantity: str | None) -> list[Function]:
    """Return the FRFs, or the transmissibilities if these are asked for or alone."""
    frfs, ratios = ([f for f in functions if f.kind == kind] for kind in (_FRF, _TRANSMISSIBILITY))
    return ratios if ratios and (quantity == TRANSMISSIBILITY or not frfs) else frfs


# -- quantity and values ------------------------------------------------------------------------
def _quantity(measured: Sequence[Function], given: str | None, path: str | Path) -> str:
    if given is not None:
        with locate_errors(path), key_path("quantity"):
            check_quantity(given)
    stated: dict[str, int] = {}
    for function in measured:
        name = _find_quantity(function, given, path)
        if name is not None:
            stated.setdefault(name, function.line)
    if len(stated) > 1:
        (a, first), (b, second) = list(stated.items())[:2]
        raise FormatError(
            f"holds {a} (dataset 58 on line {first}) and {b} (line {second}); expected one"
            " quantity",
            path,
        )
    if given is not None and stated and given not in stated:
        raise FormatError(
            f"quantity {given!r} contradicts the file, which states {next(iter(stated))!r}",
            path,
            key=("quantity",),
        )
    if given is not None:
        return given
    for function in measured:
        if _find_quantity(function, given, path) is None:
            above, below = function.numerator, function.denominator
            raise FormatError(
                f"records 9 and 10 do not define the measured quantity (data types {above.kind}"
                f" over {below.kind}; expected 8, 11 or 12 over 13): give quantity='receptance',"
                " 'mobility' or 'accelerance'",
                path,
                above.line,
            )
    return next(iter(stated))


def _find_quantity(function: Function, given: str | None, path: str | Path) -> str | None:
    """Return the quantity stated in records 6, 9 and 10; None if 9 or 10 is unknown."""
    above, below = function.numerator.kind, function.denominator.kind
    line = function.numerator.line
    if function.kind == _TRANSMISSIBILITY or (given == TRANSMISSIBILITY and above == below):
        kinds = {above, below}
        if len(kinds.intersection(MOTION)) > 1 or not kinds <= {*UNKNOWN, *MOTION}:
            raise FormatError(
                f"records 9 and 10 state {type_name(above)} over {type_name(below)}; expected two"
                " displacements, velocities or accelerations of a transmissibility",
                path,
                line,
            )
        return TRANSMISSIBILITY
    if above in FORCE and below in MOTION:
        try:
            check_quantity(_INVERSE[MOTION[below]])
        except ValueError as error:
            raise FormatError(str(error), path, line) from error
    if above not in (*MOTION, *UNKNOWN) or below not in (*FORCE, *UNKNOWN):
        raise FormatError(
            f"records 9 and 10 state {type_name(above)} over {type_name(below)}; expected a"
            " displacement, velocity or acceleration over a force (two equal ones are read with"
            " quantity='transmissibility')",
            path,
            line,
        )
    if above in MOTION and below in FORCE:
        return MOTION[above]
    return None


def _to_hertz(function: Function, path: str | Path) -> Function:
    return replace(function, unit_of_x=abscissa_factor(function.abscissa, "frequency", path))


def _check_values(function: Function, real_valued: bool, path: str | Path) -> None:
    """Refuse real ordinates without `real_valued`, and complex ones with it."""
    if not function.is_complex and not real_valued:
        raise FormatError(
            "holds real ordinates, which may be magnitudes or decibels; expected complex ones."
            " If the values are real because their phase is 0 or pi, set real_valued=True",
            path,
            function.line,
        )
    if function.is_complex and real_valued and function.y.imag.any():
        raise FormatError(
            "holds values with an imaginary part, which contradicts real_valued=True",
            path,
            function.line,
            key=("real_valued",),
        )


def _is_rotation(dof: Dof) -> bool:
    return dof.direction.startswith("R")


# -- other content ------------------------------------------------------------------------------
def _describe_absence(
    functions: Sequence[Function], collector: GeometryCollector, others: Counter[int]
) -> str:
    held = []
    if functions:
        held.append(format_counts(Counter(f.name for f in functions)))
    if collector.nodes:
        held.append(f"a geometry of {len(collector.nodes)} nodes (see updyn.io.read_geometry)")
    if others:
        held.append(_datasets(others))
    return (
        "holds no frequency response function (dataset 58, function type 4); it holds"
        f" {', '.join(held) or 'nothing'}"
    )


def _datasets(others: Counter[int]) -> str:
    """Format the other datasets with their numbers of occurrences, for messages."""
    shown = []
    for number, times in sorted(others.items()):
        often = f" ({times} times)" if times > 1 else ""
        shown.append(f"dataset {number}{often}")
    return ", ".join(shown) or "nothing"


def _warn_of_others(functions: Sequence[Function], used: int, path: str | Path) -> None:
    left_out = [f for f in functions if f.kind not in (used, _COHERENCE)]
    if left_out:
        kinds = format_counts(Counter(f.name for f in left_out))
        warnings.warn(
            f"{path}: functions that are neither FRF nor coherence are ignored: {kinds} (first:"
            f" line {left_out[0].line})",
            UpdynWarning,
            stacklevel=3,
        )


def _source(path: str | Path, first: Function, others: Counter[int]) -> str:
    source = Path(path).name
    if first.title and first.title.upper() != "NONE":
        source += f", {first.title}"
    if others:
        source += f"; ignored: {_datasets(others)}"
    return source


_Pair = tuple[tuple[int, str], tuple[int, str]]


class Directions:
    """Converts nodes and direction codes of a file to DOFs in global or nodal directions.

    `scalar` is the direction for code 0; `local` keeps the directions of the nodes.
    """

    def __init__(
        self, path: str | Path, scalar: Dof | None, geometry: Geometry | None, local: bool = False
    ) -> None:
        self.path = path
        self.scalar = scalar
        self.geometry = geometry
        self.local = local
        self._row: dict[int, int] = {}
        if geometry is not None:
            self._row = {node: row for row, node in enumerate(geometry.nodes.tolist())}

    def dof(self, what: str, node: int, code: int, line: int) -> Dof:
        """Return the DOF of a node and direction code, at record 6 of a dataset."""
        # A code 0 without `scalar`, and oblique directions unless `local`, are refused.
        at = line + 6
        if not -6 <= code <= 6:
            raise FormatError(f"record 6: {what} direction {code}; expected -6 to 6", self.path, at)
        if code == 0 and self.scalar is None:
            raise FormatError(
                f"record 6: {what} direction 0 (scalar) at node {node} defines no direction: give"
                " scalar_direction, for instance 'Z'",
                self.path,
                at,
            )
        dof = Dof(node, DIRECTIONS[abs(code) - 1], 1 if code > 0 else -1)
        if code == 0 and self.scalar is not None:
            dof = Dof(node, self.scalar.direction, self.scalar.sign)
        if self.geometry is None:
            return dof
        return self._in_global(dof, self.geometry, what, at)

    def _in_global(self, dof: Dof, geometry: Geometry, what: str, at: int) -> Dof:
        if dof.node not in self._row:
            try:
                geometry.position([dof.node])
            except InputError as error:
                raise FormatError(f"record 6: {what} {dof}: {error}", self.path, at) from error
        if geometry.axes is None or self.local:
            return dof
        axis = DIRECTIONS.index(dof.direction)
        vector = geometry.axes[self._row[dof.node], axis % 3] * dof.sign
        k = int(np.argmax(np.abs(vector)))
        along = np.zeros(3)
        along[k] = np.sign(vector[k])
        if np.abs(vector - along).max() > MEASURED_FILE.parallel_tolerance:
            shown = ", ".join(f"{v:.6g}" for v in vector)
            raise FormatError(
                f"record 6: {what} {dof} is oblique: its displacement system turns it to ({shown})"
                " in the global system, parallel to no axis; keep the directions of nodes with"
                " local_axes=True and match them with updyn.match ([match] of a job), or transform"
                " the measurement to global directions first",
                self.path,
                at,
            )
        is_rotation = axis >= 3
        return Dof(dof.node, DIRECTIONS[k + 3 * is_rotation], int(along[k]))


@dataclass(frozen=True, slots=True, eq=False)
class FRFArrays:
    """A complete matrix in SI: lines in Hz and FRFs, shape (n_f, n_responses, n_references).

    DOFs are in the order of the file, or in the requested order.
    """

    freq: RealArray
    values: ComplexArray
    coherence: RealArray | None
    responses: DofSet
    references: DofSet


@dataclass(frozen=True, slots=True, eq=False)
class _MeasuredFunction:
    function: Function
    response: Dof
    reference: Dof
    factor: float

    @property
    def key(self) -> _Pair:
        return _name(self.response), _name(self.reference)

    @property
    def pair(self) -> str:
        return f"response {self.response}, reference {self.reference}"

    @property
    def in_positive_sense(self) -> NumberArray:
        """The ordinate in SI, for the positive senses of both DOFs."""
        return self.function.y * (self.factor * self.response.sign * self.reference.sign)


def assemble(
    measured: Sequence[Function],
    coherences: Sequence[Function],
    directions: Directions,
    factor: Callable[[Function, Dof, Dof], float],
    *,
    average: bool,
    responses: Iterable[str | Dof] | None,
    references: Iterable[str | Dof] | None,
) -> FRFArrays:
    """Assemble functions into a matrix of `responses` and `references`; None keeps all.

    `factor` returns the factor to SI of an FRF with its response and its reference. Coherence that
    is not available for every FRF is ignored with a warning.
    """
    path = directions.path
    rows = _ChannelSide("response", path)
    columns = _ChannelSide("reference", path)
    found = [_place(f, directions, factor) for f in measured]
    for item in found:
        rows.add(item.response)
        columns.add(item.reference)
    rows.select(responses)
    columns.select(references)
    frfs = _group_by_pair(found, rows, columns)
    cohs = _group_by_pair([_place(f, directions) for f in coherences], rows, columns)
    _check_complete(frfs, rows, columns, path)
    if not average:
        _check_unique([*frfs.values(), *cohs.values()], path)
    freq = next(iter(frfs.values()))[0].function.x
    for items in (*frfs.values(), *cohs.values()):
        for item in items:
            _check_lines(item, freq, path)
    shape = (len(freq), len(rows.selected), len(columns.selected))
    values = np.empty(shape, dtype=np.complex128)
    coherence = np.empty(shape) if _coherence_is_complete(frfs, cohs, path) else None
    for i, r in enumerate(rows.selected):
        for j, c in enumerate(columns.selected):
            key = (_name(r), _name(c))
            sense = r.sign * c.sign
            gamma = [_coherence(item, path) for item in cohs.get(key, ())]
            values[:, i, j] = _mean([item.in_positive_sense * sense for item in frfs[key]], gamma)
            if coherence is not None:
                coherence[:, i, j] = np.mean(gamma, axis=0)
    for array in (values, coherence):
        if array is not None:
            array.flags.writeable = False  # FRF does not copy read-only arrays
    return FRFArrays(freq, values, coherence, rows.selected, columns.selected)


def _place(
    function: Function,
    directions: Directions,
    factor: Callable[[Function, Dof, Dof], float] | None = None,
) -> _MeasuredFunction:
    response = directions.dof("response", *function.response, function.line)
    reference = directions.dof("reference", *function.reference, function.line)
    return _MeasuredFunction(
        function, response, reference, factor(function, response, reference) if factor else 1.0
    )


def _name(dof: Dof) -> tuple[int, str]:
    return dof.node, dof.direction


class _ChannelSide:
    """The DOFs of one side in order of occurrence, each in its first sense, and those to keep."""

    def __init__(self, what: str, path: str | Path) -> None:
        self.what = what
        self.path = path
        self.dofs_by_name: dict[tuple[int, str], Dof] = {}
        self.selected = DofSet([])

    def add(self, dof: Dof) -> None:
        self.dofs_by_name.setdefault(_name(dof), dof)

    def select(self, wanted: Iterable[str | Dof] | None) -> None:
        held = DofSet(self.dofs_by_name.values())
        if wanted is None:
            self.selected = held
            return
        self.selected = parse_selection(wanted, f"{self.what}s", self.path)
        with locate_errors(self.path, f"{self.what}s"), key_path(f"{self.what}s"):
            held.match(self.selected, self.what)

    def __contains__(self, dof: Dof) -> bool:
        return dof in self.selected


def _group_by_pair(
    items: Sequence[_MeasuredFunction], rows: _ChannelSide, columns: _ChannelSide
) -> dict[_Pair, list[_MeasuredFunction]]:
    out: dict[_Pair, list[_MeasuredFunction]] = {}
    keep_rows = set(map(_name, rows.selected))
    keep_columns = set(map(_name, columns.selected))
    for item in items:
        response, reference = item.key
        if response in keep_rows and reference in keep_columns:
            out.setdefault(item.key, []).append(item)
    return out


def _check_complete(
    frfs: Mapping[_Pair, list[_MeasuredFunction]],
    rows: _ChannelSide,
    columns: _ChannelSide,
    path: str | Path,
) -> None:
    missing = []
    for c in columns.selected:
        for r in rows.selected:
            if (_name(r), _name(c)) not in frfs:
                missing.append(f"{r} / {c}")
    if missing:
        shown = ", ".join(missing[:6])
        if len(missing) > 6:
            shown += ", ..."
        raise FormatError(
            f"{len(missing)} of {len(rows.selected) * len(columns.selected)} pairs of response /"
            f" reference are missing: {shown}. Select a complete part with responses=[...] and"
            " references=[...]",
            path,
        )


def _check_unique(groups: Sequence[list[_MeasuredFunction]], path: str | Path) -> None:
    for first, *more in groups:
        for second in more:
            raise FormatError(
                f"{second.function.name} at {second.pair} occurs twice: also on line"
                f" {first.function.line}; use duplicates='average' to average them",
                path,
                second.function.line,
            )


def _check_lines(item: _MeasuredFunction, freq: RealArray, path: str | Path) -> None:
    x = item.function.x
    if len(x) == len(freq) and np.allclose(x, freq, rtol=1e-9, atol=0):
        return
    raise FormatError(
        f"{item.function.name} at {item.pair} has {len(x)} lines from {x[0]:g} to {x[-1]:g} Hz, the"
        f" first FRF has {len(freq)} from {freq[0]:g} to {freq[-1]:g} Hz (or differs in between):"
        " expected the same frequency lines",
        path,
        item.function.line,
    )


def _coherence_is_complete(
    frfs: Mapping[_Pair, list[_MeasuredFunction]],
    cohs: Mapping[_Pair, list[_MeasuredFunction]],
    path: str | Path,
) -> bool:
    """Return whether every FRF has its coherence; warn if only some have."""
    with_it = [key for key, items in frfs.items() if len(cohs.get(key, ())) == len(items)]
    if cohs and len(with_it) < len(frfs):
        warnings.warn(
            f"{path}: only {len(with_it)} of {len(frfs)} pairs of DOFs have a coherence; the"
            " coherence is ignored, because FRFs need it for all pairs or for none",
            UpdynWarning,
            stacklevel=4,
        )
    return bool(cohs) and len(with_it) == len(frfs)


def _coherence(item: _MeasuredFunction, path: str | Path) -> RealArray:
    y = item.function.y
    if np.iscomplexobj(y) and (y.imag != 0).any():
        raise FormatError(
            f"coherence at {item.pair} has an imaginary part", path, item.function.line
        )
    if (y.real < 0).any() or (y.real > 1).any():
        worst = y.real[np.argmax(np.abs(y.real - 0.5))]
        raise FormatError(
            f"coherence at {item.pair} is {worst:g}; expected 0 to 1", path, item.function.line
        )
    return np.asarray(y.real, dtype=np.float64)


def _mean(values: Sequence[NumberArray], gamma: Sequence[RealArray]) -> ComplexArray:
    """Return the mean, weighted at each line with the coherence if every function has one."""
    if len(values) == 1:
        return np.asarray(values[0], dtype=np.complex128)
    weights = np.ones((len(values), len(values[0])))
    if len(gamma) == len(values):
        weights = np.array(gamma)
    weights[:, weights.sum(axis=0) == 0] = 1.0  # the plain mean if all coherences are zero
    return np.asarray((weights * np.array(values)).sum(axis=0) / weights.sum(axis=0))
