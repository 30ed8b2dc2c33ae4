"""Modes in universal files: datasets 55 and 2414, "data at nodes", of normal and of complex modes.

Layout: SDRC, universal file format, datasets 55 and 2414; conventions are in docs/formats.md. For
an eigenvalue s with modal A the shape is scaled by sqrt(2 i omega_d / A), because phi^T (2 s M + C)
phi = A (Ewins, Modal Testing, 2nd ed. 2000, section 2.7). Modal B is -s A. A direction that is zero
in every mode was not measured (note 15 of the format). Dataset 2414 has frequency, modal mass and
damping ratios in fields 2, 4, 5 and 6 of its real parameters, eigenvalue and modal A in fields 7 to
10.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.io.items import format_counts, locate_errors
from updyn.io.settings import MEASURED_FILE
from updyn.io.uff.datasets import (
    Dataset,
    datasets,
    decode_line,
    parse_real_field,
    read_integer_field,
    read_integer_fields,
)
from updyn.io.uff.geometry import NUMBERS, GeometryCollector, Units
from updyn.modal import ModeSet

__all__ = ["FIRST_ORDER", "NORMAL", "UNCERTAIN", "read_modes"]


#: Analysis types of normal modes, and of complex modes of first and of second order.
NORMAL, FIRST_ORDER, _SECOND_ORDER = 2, 3, 7
_ANALYSES = {0: "unknown", 1: "static", 4: "transient", 5: "frequency response", 6: "buckling"}
_WIDTHS = {2: 3, 3: 6}  # data characteristic: values per node
_REAL, _COMPLEX = (2, 4), (5, 6)
_DISPLACEMENT = (0, 1, 8)
_UNKNOWN = (93, 95, 96)  # of dataset 2414: read as displacements
_MOTION = (11, 12)
_LOCATIONS = {1: "at nodes", 2: "on elements", 3: "at nodes on elements", 5: "at points"}
_NUMBER = r"([0-9]++(?:\.[0-9]*+)?(?:[eE][+-]?[0-9]++)?)"
#: "Frequency 19.62", "Mode 3: 19.62 Hz"
_FREQUENCY = re.compile(
    rf"\bfreq(?:uency|\.)?\s*[:=]?\s*{_NUMBER}|\bmode\s*[0-9]++\s*[:,;=]?\s*{_NUMBER}\s*Hz", re.I
)
_QUALITY = re.compile(rf"^quality {_NUMBER}\b")
_STD = re.compile(rf"standard deviations {_NUMBER} Hz, {_NUMBER}$")
#: First line of a dataset 55 with standard deviations of the shape before.
UNCERTAIN = "Standard deviations of the mode shape before, at fixed length"
_NODE_WIDTH = 10  # columns
_TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class _Layout:
    """Lines of the items of a dataset, counted from 0: record n is line n - 1."""

    number: int
    quality: int  # identification line that `write_modes` uses for the quality
    title: int  # and for the title
    about: int  # analysis, data characteristic, result, data type and width
    head: int  # lines before the nodes


_55 = _Layout(55, 3, 4, 5, 8)
_2414 = _Layout(2414, 6, 7, 8, 13)
_LAYOUTS = {layout.number: layout for layout in (_55, _2414)}


@dataclass(frozen=True, slots=True, eq=False)
class _UFFMode:
    """One dataset, in the units of the file."""

    number: int
    line: int
    frequency: float
    loss: float
    conjugate: bool
    factor: complex  # scales the shape to unit modal mass in SI units; 0 if unknown
    title: str  # number and frequency, as written by `write_modes`
    nodes: list[int]
    shape: ComplexArray  # shape (n_nodes, 6)
    quality: float
    std: tuple[float, float]  # of the frequency in Hz, and of the loss factor
    is_scale_unused: bool
    std_shape: RealArray | None = None  # shape (n_nodes, 6)


def read_modes(path: str | Path) -> ModeSet:
    """Read modes in datasets 55 or 2414; raise an `AbsentError` if the file has none."""
    collector = GeometryCollector(path)
    found: list[_UFFMode] = []
    others = Counter[int]()
    ignored = Counter[str]()
    for dataset in datasets(path):
        if found and dataset.number == _55.number and _is_uncertainty(dataset):
            found[-1] = _with_deviations(found[-1], dataset, path)
        elif dataset.number in _LAYOUTS:
            mode = _parse_mode(dataset, path)
            if isinstance(mode, _UFFMode):
                found.append(mode)
            else:
                ignored[mode] += 1
        elif dataset.number in NUMBERS:
            collector.take(dataset)
        else:
            others[dataset.number] += 1
    if not found:
        held = [f"{n} of analysis data, {name}" for name, n in ignored.items()]
        held += [f"dataset {n}" for n in sorted(others)]
        raise AbsentError(
            "holds no modes (dataset 55 or 2414 of analysis type 2, 3 or 7); it holds"
            f" {', '.join(held) or '-'}",
            path,
        )
    unused = [mode for mode in found if mode.is_scale_unused]
    if unused:
        some = "1 mode" if len(unused) == 1 else f"{len(unused)} modes"
        warnings.warn(
            f"{path}: modal mass or modal A of {some} is not used: shapes of velocities or"
            " accelerations, or modal A and B that contradict each other; the shapes are unscaled"
            f" (first: line {unused[0].line})",
            UpdynWarning,
            stacklevel=2,
        )
    if ignored:
        warnings.warn(
            f"{path}: analysis data other than modes are ignored: {format_counts(ignored)}",
            UpdynWarning,
            stacklevel=2,
        )
    first = found[0]
    for mode in found:
        if mode.number != first.number:
            raise FormatError(
                f"modes in dataset {mode.number}, and in dataset {first.number} on line"
                f" {first.line}: they may be duplicates; expected only one kind of dataset",
                path,
                mode.line,
            )
    return _build_modes(_drop_conjugates(found), collector.units, path)


# -- reading ------------------------------------------------------------------------------------
def _parse_mode(dataset: Dataset, path: str | Path) -> _UFFMode | str:
    """Return the mode in a dataset, or the description of other data."""
    layout = _LAYOUTS[dataset.number]
    texts = [decode_line(line).rstrip() for line in dataset.body.rstrip().split(b"\n")]
    if len(texts) < layout.head:
        raise FormatError(
            f"dataset {dataset.number}: {len(texts)} lines; expected at least {layout.head}",
            path,
            dataset.line,
        )
    at = dataset.line + 1
    where = f"record {layout.about + 1}"
    record = read_integer_fields(texts[layout.about], 6, where, path, at + layout.about)
    _, analysis, characteristic, specific, kind, width = record
    if analysis not in (NORMAL, FIRST_ORDER, _SECOND_ORDER):
        return _ANALYSES.get(analysis, f"analysis type {analysis}")
    if layout is _2414:
        location = read_integer_field(texts[2], 0, 10, "record 3, location", path, at + 2)
        if location != 1:
            return f"modes {_LOCATIONS.get(location, f'at location {location}')}"
        if specific not in (*_DISPLACEMENT, *_MOTION, *_UNKNOWN):
            return f"result type {specific} of modes"
    elif specific not in (*_DISPLACEMENT, *_MOTION):
        return f"data type {specific} of modes"
    if _WIDTHS.get(characteristic) != width:
        raise FormatError(
            f"{where}: data characteristic {characteristic} with {width} values per node; expected"
            " 2 with 3 (translations) or 3 with 6 (translations and rotations)",
            path,
            at + layout.about,
        )
    if kind not in (*_REAL, *_COMPLEX):
        raise FormatError(
            f"{where}: data type {kind}; expected 2 (real) or 5 (complex)", path, at + layout.about
        )
    head = (_head_of_2414 if layout is _2414 else _head_of_55)(texts, analysis, path, at)
    nodes, shape = _nodes(texts, layout, width, kind in _COMPLEX, path, at)
    is_scaled = specific not in _MOTION
    match = _QUALITY.search(texts[layout.quality])
    quality = float(match[1]) if match else np.nan
    match = _STD.search(texts[layout.quality - 1])
    std = (float(match[1]), float(match[2])) if match else (np.nan, np.nan)
    return _UFFMode(
        dataset.number,
        dataset.line,
        head.frequency,
        head.loss,
        head.conjugate,
        head.factor if is_scaled else 0.0,
        texts[layout.title],
        nodes,
        shape,
        quality,
        std,
        head.is_contradictory or (head.factor != 0 and not is_scaled),
    )


def _is_uncertainty(dataset: Dataset) -> bool:
    return decode_line(dataset.body.lstrip(b"\n").split(b"\n", 1)[0]).rstrip() == UNCERTAIN


def _with_deviations(mode: _UFFMode, dataset: Dataset, path: str | Path) -> _UFFMode:
    """Return a mode with the standard deviations of its shape from the next dataset."""
    texts = [decode_line(line).rstrip() for line in dataset.body.rstrip().split(b"\n")]
    at = dataset.line + 1
    if len(texts) < _55.head:
        raise FormatError(
            f"dataset 55: {len(texts)} lines; expected at least {_55.head}", path, dataset.line
        )
    _, _, _, _, kind, width = read_integer_fields(
        texts[_55.about], 6, "record 6", path, at + _55.about
    )
    if kind != 2 or width not in _WIDTHS.values():
        raise FormatError(
            f"record 6: data type {kind} with {width} values per node; expected 2 with 3 or 6 for"
            " standard deviations of a mode shape",
            path,
            at + _55.about,
        )
    nodes, std = _nodes(texts, _55, width, False, path, at)
    if mode.std_shape is not None or nodes != mode.nodes or texts[_55.title] != mode.title:
        raise FormatError(
            f"dataset 55: standard deviations of {texts[_55.title]!r} at {len(nodes)} nodes; the"
            f" preceding mode is {mode.title!r} at {len(mode.nodes)} nodes"
            f"{'' if mode.std_shape is None else ', which already has standard deviations'}",
            path,
            dataset.line,
        )
    return replace(mode, std_shape=std.real)


@dataclass(frozen=True, slots=True)
class _ModeProperties:
    """Properties of a mode other than its shape."""

    frequency: float
    loss: float
    conjugate: bool  # whether it is the lower mode of a pair
    factor: complex  # scales the shape to unit modal mass; 0 if unknown
    is_contradictory: bool = False  # whether modal A and B contradict each other


@dataclass(frozen=True, slots=True)
class _ModePlace:
    """Place of numbers in the file, and the frequencies in Hz in the identification lines."""

    what: str
    path: str | Path
    line: int
    stated: list[tuple[int, float]]

    def error(self, message: str) -> FormatError:
        return FormatError(f"{self.what}: {message}", self.path, self.line)


def _place(
    texts: Sequence[str], layout: _Layout, record: int, path: str | Path, at: int
) -> _ModePlace:
    stated = []
    for line, text in enumerate(texts[: layout.about], at):
        for found in _FREQUENCY.finditer(text):
            stated.append((line, float(found[1] or found[2])))
    return _ModePlace(f"record {record}", path, at + record - 1, stated)


def _head_of_55(texts: Sequence[str], analysis: int, path: str | Path, at: int) -> _ModeProperties:
    n_whole, n_real = read_integer_fields(texts[6], 2, "record 7", path, at + 6)
    least = 4 if analysis == NORMAL else 2
    if n_whole < 1 or n_real < least:
        raise FormatError(
            f"record 7: {n_real} real parameters; expected at least {least}", path, at + 6
        )
    numbers = _numbers([(at + 7, texts[7])], min(n_real, 6), "record 8", path)
    numbers = np.append(numbers, np.zeros(6 - len(numbers)))
    place = _place(texts, _55, 8, path, at)
    return (
        _normal_mode_properties(numbers[:4], place)
        if analysis == NORMAL
        else _complex_mode_properties(numbers, place)
    )


def _head_of_2414(
    texts: Sequence[str], analysis: int, path: str | Path, at: int
) -> _ModeProperties:
    # Both lines have six fields, even if unused.
    fields = _numbers([(at + 11, texts[11])], 6, "record 12", path)
    place = _place(texts, _2414, 12, path, at)
    if analysis == NORMAL:
        _check_eigenvalue(fields[1], fields[2], place)
        return _normal_mode_properties(fields[[1, 3, 4, 5]], place)
    numbers = _numbers([(at + 12, texts[12])], 6, "record 13", path)
    if analysis == _SECOND_ORDER:
        numbers[2:] = 0.0  # modal A, or a modal mass
    head = _complex_mode_properties(numbers, _place(texts, _2414, 13, path, at))
    _check_fields(fields, complex(numbers[0], numbers[1]), place)
    return head


def _check_eigenvalue(frequency: float, eigenvalue: float, place: _ModePlace) -> None:
    """Refuse a frequency of a normal mode that does not match its eigenvalue."""
    if frequency == 0.0 and eigenvalue > 0.0:
        raise place.error(
            f"frequency 0 Hz with eigenvalue {eigenvalue:g}, which has no stated unit; expected"
            " the frequency in Hz in columns 14 to 26"
        )
    omega = _TURN * frequency
    is_known = frequency > 0.0 and eigenvalue > 0.0
    share = 2.0 * MEASURED_FILE.frequency_tolerance
    if is_known and not _is_near(eigenvalue, np.array([omega, omega**2]), share):
        raise place.error(
            f"frequency {frequency:g} Hz contradicts eigenvalue {eigenvalue:g}; expected the square"
            f" of the angular frequency, {omega**2:g}"
        )


def _check_fields(fields: RealArray, s: complex, place: _ModePlace) -> None:
    """Refuse fields of frequency and damping that do not match an eigenvalue in rad/s."""
    _, f, _, _, viscous, hysteretic = fields
    sizes = np.array([abs(s), abs(s.imag)])
    if f > 0.0 and not _is_near(f, sizes / _TURN, MEASURED_FILE.frequency_tolerance):
        raise place.error(
            f"frequency {f:g} Hz contradicts the eigenvalue {s:g} 1/s of record 13"
            f" ({abs(s) / _TURN:g} Hz); expected Hz here and rad/s in record 13"
        )
    ratio = -s.real / abs(s)
    given = np.array([viscous, 0.5 * hysteretic, viscous + 0.5 * hysteretic])
    share = 2.0 * MEASURED_FILE.frequency_tolerance
    allowed = MEASURED_FILE.damping_tolerance + share * abs(ratio)
    if given.any() and not (np.abs(given - ratio) <= allowed).any():
        raise place.error(
            f"damping ratios {viscous:g} and {hysteretic:g} contradict the eigenvalue {s:g} 1/s of"
            f" record 13 (viscous ratio {ratio:g})"
        )


def _normal_mode_properties(numbers: RealArray, place: _ModePlace) -> _ModeProperties:
    """Return the properties of a normal mode from frequency, modal mass and damping ratios."""
    f, mass, viscous, hysteretic = numbers.tolist()
    if f < 0 or mass < 0:
        raise place.error(f"frequency {f:g} Hz and modal mass {mass:g}; expected at least 0")
    if viscous < 0 or hysteretic < 0:
        raise place.error(
            f"damping ratios {viscous:g} (viscous) and {hysteretic:g} (hysteretic): unstable;"
            " expected at least 0"
        )
    loss = 2.0 * viscous + hysteretic
    if loss >= 2.0:
        raise place.error(
            f"damping ratios {viscous:g} (viscous) and {hysteretic:g} (hysteretic) are at or above"
            " critical damping; expected fractions of 1, not per cent"
        )
    for line, stated in _find_contradictory_frequency(f, place):
        is_angular = _is_near(f, _TURN * stated, MEASURED_FILE.stated_tolerance)
        relation = "it is in rad/s" if is_angular else "it was divided by 2 pi"
        raise place.error(
            f"frequency {f:g} Hz contradicts {stated:g} Hz on line {line}: {relation}"
        )
    factor = 1.0 / np.sqrt(mass) if mass else 0.0
    return _ModeProperties(f, loss or np.nan, False, factor)


def _complex_mode_properties(numbers: RealArray, place: _ModePlace) -> _ModeProperties:
    """Return the properties of a complex mode from eigenvalue, modal A and modal B."""
    s, a, b = (complex(*pair) for pair in numbers.reshape(3, 2).tolist())
    if s.imag == 0.0:
        raise place.error(
            f"eigenvalue {s.real:g} 1/s does not oscillate; expected an imaginary part"
        )
    # Modal B is -s A, and modal A of a shape of unit modal mass is 2 i omega.
    if a and _is_near(abs(b), _TURN * abs(s * a), MEASURED_FILE.mode_tolerance):
        raise _to_hertz(place, s, f"modal B {b:g} and modal A {a:g}")
    if _is_near(abs(a), 2.0 * _TURN * abs(s.imag), MEASURED_FILE.mode_tolerance):
        raise _to_hertz(place, s, f"modal A {a:g} belongs to a frequency of {abs(s.imag):g} Hz")
    f = abs(s) / _TURN
    for line, stated in _find_contradictory_frequency(f, place):
        if stated > f:
            raise _to_hertz(place, s, f"line {line} states {stated:g} Hz")
    if s.real > MEASURED_FILE.undamped_share * abs(s):
        raise place.error(
            f"eigenvalue {s:g} 1/s: unstable; expected a negative real part (some programs"
            " write the decay rate, or a spurious mode)"
        )
    share = MEASURED_FILE.stated_tolerance
    is_contradictory = bool(a and b) and not _is_near(abs(b), abs(s * a), share)
    factor = 0.0 if is_contradictory or not a else complex(np.sqrt(2j * s.imag / a))
    return _ModeProperties(f, -2.0 * s.real / abs(s), s.imag < 0, factor, is_contradictory)


def _to_hertz(place: _ModePlace, s: complex, why: str) -> FormatError:
    return place.error(f"eigenvalue {s:g} is in Hz; expected rad/s ({why})")


def _find_contradictory_frequency(frequency: float, place: _ModePlace) -> list[tuple[int, float]]:
    """Return line and value of stated frequencies that differ by a factor of 2 pi."""
    share = MEASURED_FILE.stated_tolerance
    if any(_is_near(frequency, stated, share) for _, stated in place.stated):
        return []
    wrong = np.array([frequency * _TURN, frequency / _TURN])
    return [each for each in place.stated if _is_near(each[1], wrong, share)]


def _is_near(value: float, expected: float | RealArray, share: float) -> bool:
    """Return whether `value` equals an expected number to the relative tolerance `share`."""
    return bool((np.abs(value - np.asarray(expected)) <= share * np.abs(value)).any()) and value > 0


def _nodes(
    lines: Sequence[str], layout: _Layout, width: int, is_complex: bool, path: str | Path, at: int
) -> tuple[list[int], ComplexArray]:
    """Return the nodes and their values, shape (n_nodes, 6); `at` is the first line in the file."""
    texts, at = lines[layout.head :], at + layout.head
    on_node, on_values = f"record {layout.head + 1}", f"record {layout.head + 2}"
    count = width * (2 if is_complex else 1)
    size = 1 + -(-count // 6)
    if len(texts) % size:
        raise FormatError(
            f"dataset {layout.number}: {count} numbers per node need {size} lines, the last node"
            f" has {len(texts) % size}",
            path,
            at + len(texts) - 1,
        )
    nodes: list[int] = []
    shape = np.zeros((len(texts) // size, 6), dtype=np.complex128)
    for i in range(0, len(texts), size):
        node = read_integer_field(texts[i], 0, 10, f"{on_node}, node", path, at + i)
        if len(texts[i]) > _NODE_WIDTH:
            raise FormatError(
                f"{on_node}: expected only the node in columns 1 to {_NODE_WIDTH},"
                f" found {texts[i][:60]!r}",
                path,
                at + i,
            )
        if node in nodes:
            raise FormatError(f"dataset {layout.number}: node {node} occurs twice", path, at + i)
        rows = list(enumerate(texts[i + 1 : i + size], at + i + 1))
        row = _numbers(rows, count, on_values, path)
        if is_complex:
            row = row[0::2] + 1j * row[1::2]
        shape[len(nodes), :width] = row
        nodes.append(node)
    return nodes, shape


def _numbers(
    lines: Sequence[tuple[int, str]], count: int, what: str, path: str | Path
) -> RealArray:
    """Return the numbers of some lines, separated by blanks or in fields of 13 columns."""
    words = []
    for at, text in lines:
        words += [(at, word) for word in text.split()]
    if len(words) != count:
        words = []
        for at, text in lines:
            fields = [text[i : i + 13] for i in range(0, len(text), 13)]
            words += [(at, field) for field in fields if field.strip()]
    if len(words) != count:
        raise FormatError(
            f"{what}: expected {count} numbers, found {len(words)}", path, lines[0][0]
        )
    return np.array(
        [parse_real_field(word, what, path, at) for at, word in words], dtype=np.float64
    )


def _drop_conjugates(found: Sequence[_UFFMode]) -> list[_UFFMode]:
    """Return the modes without conjugates of modes with positive imaginary part."""
    upper = np.array([mode.frequency for mode in found if not mode.conjugate])
    kept = []
    for mode in found:
        has_partner = (np.abs(mode.frequency - upper) <= 1e-4 * upper).any()
        if not (mode.conjugate and has_partner):
            kept.append(mode)
    return kept


def _build_modes(found: Sequence[_UFFMode], units: Units, path: str | Path) -> ModeSet:
    nodes = list(dict.fromkeys(chain.from_iterable(mode.nodes for mode in found)))
    row = {node: i for i, node in enumerate(nodes)}
    shapes = np.zeros((len(found), len(nodes), 6), dtype=np.complex128)
    std = np.zeros(shapes.shape)
    for k, mode in enumerate(found):
        if mode.std_shape is None:
            std[k] = np.nan
        if mode.nodes:
            rows_of_mode = [row[n] for n in mode.nodes]
            shapes[k, rows_of_mode] = mode.shape
            if mode.std_shape is not None:
                std[k, rows_of_mode] = mode.std_shape
    shapes[:, :, :3] /= units.length
    std[:, :, :3] /= units.length
    # A modal mass has the unit of energy over the squared unit of the shape: force times length.
    unit = np.sqrt(units.force * units.length)
    for k, mode in enumerate(found):
        if mode.factor:
            shapes[k] *= mode.factor * unit
            std[k] *= abs(mode.factor) * unit
        if mode.conjugate:
            shapes[k] = shapes[k].conj()
    used = np.argwhere(shapes.any(axis=0))
    for mode, shape in zip(found, shapes, strict=True):
        if not shape.any():
            raise FormatError(
                f"dataset {mode.number}: the shape is zero at all nodes", path, mode.line
            )
    with locate_errors(path):
        return ModeSet(
            [m.frequency for m in found],
            shapes[:, used[:, 0], used[:, 1]].T,
            DofSet.from_arrays(np.array(nodes)[used[:, 0]], used[:, 1]),
            [m.loss for m in found],
            [m.factor != 0 for m in found],
            [m.quality for m in found],
            Path(path).name,
            std_frequency=[m.std[0] for m in found],
            std_loss_factor=[m.std[1] for m in found],
            std_shapes=std[:, used[:, 0], used[:, 1]].T,
        )
