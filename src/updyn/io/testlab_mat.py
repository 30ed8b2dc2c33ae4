"""FRFs and coherence in the MATLAB export of Simcenter Testlab (formerly LMS Test.Lab).

Each variable of such a file is a struct of functions of one type and one unit::

    x_values            start_value, increment, number_of_values, quantity
    y_values            values (lines x functions), quantity
    function_record     type ("FRF", "Coherence", ...), primary_channel.label (responses),
                        reference_channel.label (references), average.nr_of_averages, .type

A quantity has a label, a unit_transformation (factor, offset) and quantity_terms, the exponents of
its dimensions. The layout is not documented; these are the fields of files that users published.
There, values "saved by Test.Lab in MKS" are in SI units, and the factor converts them to the unit
of the label.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.dofs import Dof
from updyn.errors import AbsentError, FormatError, OptionError
from updyn.foreign.plain import Unread
from updyn.frf import FRF, QUANTITIES
from updyn.io.channel_names import label_channels, warn
from updyn.io.items import (
    as_number,
    as_numbers,
    as_reals,
    as_text,
    as_vector,
    check_phase,
    describe_kind,
    format_counts,
    format_names,
)
from updyn.io.named import build_frf
from updyn.io.settings import MEASURED_FILE
from updyn.units import Unit, find_ratio, find_unit

__all__ = ["Functions", "is_export", "read_export", "read_exported_coherence", "refuse_export"]

_PARTS = ("x_values", "y_values", "function_record")
_EXPORT = "MATLAB export of Simcenter Testlab"
_RESPONSES, _REFERENCES = (
    f"function_record.{side}_channel.label" for side in ("primary", "reference")
)
#: Quantity by the exponent of time in the dimension of motion / force.
_BY_TIME = {2.0: "receptance", 1.0: "mobility", 0.0: "accelerance"}

Pair = tuple[str, str]  # names of response and reference


@dataclass(frozen=True, slots=True)
class _Struct:
    """A struct of the file; its fields have dotted names."""

    name: str
    fields: Mapping[str, Any]
    path: str | Path

    def find(self, key: str) -> Any:
        """Return a field; None if it is missing."""
        item: object = self.fields
        for part in key.split("."):
            item = item.get(part) if isinstance(item, Mapping) else None
        if isinstance(item, Unread):
            raise FormatError(item.reason, self.path)
        return item

    def get(self, key: str) -> Any:
        item = self.find(key)
        if item is None:
            raise self.error(f"no {key}, which the {_EXPORT} has")
        return item

    def number(self, key: str) -> float:
        return as_number(self.get(key), f"{self.name}.{key}", self.path)

    def text(self, key: str) -> str:
        return as_text(self.get(key), f"{self.name}.{key}", self.path).strip()

    def texts(self, key: str) -> list[str]:
        found = self.get(key)
        if not isinstance(found, list) or not all(isinstance(item, str) for item in found):
            raise self.error(f"{key}: found {describe_kind(found)}; expected texts")
        return [item.strip() for item in found]

    def error(self, message: str) -> FormatError:
        return FormatError(f"{self.name}: {message}", self.path)

    @property
    def kind(self) -> str:
        """Type of the functions, such as "FRF"."""
        return self.text("function_record.type")


@dataclass(frozen=True, slots=True)
class Functions:
    """Functions of one type, in SI units, on common lines in Hz, by names of channels."""

    freq: RealArray
    values: dict[Pair, NumberArray]


def is_export(variables: Mapping[str, object]) -> bool:
    """Return whether the variables of a MATLAB file include a struct of the export."""
    return bool(_select_structs(variables, ""))


def refuse_export(variables: Mapping[str, object], path: str | Path, wanted: str) -> None:
    """Raise an `AbsentError` if the variables are an export, which has no `wanted`."""
    if is_export(variables):
        raise AbsentError(f"{_EXPORT}: it has no {wanted}", path)


def read_exported_coherence(variables: Mapping[str, object], path: str | Path) -> Functions:
    """Return the coherence in an export; raise an `AbsentError` if it has none."""
    structs = [s for s in _select_structs(variables, path) if s.kind == "Coherence"]
    if not structs:
        raise AbsentError("no coherence in a MATLAB export of Simcenter Testlab", path)
    return _read_functions(structs)


def read_export(
    variables: Mapping[str, object],
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    response_labels: Iterable[str | Dof] | None = None,
    reference_labels: Iterable[str | Dof] | None = None,
    order: Sequence[str] | None = None,
    real_valued: bool = False,
) -> FRF:
    """Return the FRFs of an export; given labels replace the names of channels in order."""
    # If the responses have several quantities, all are converted to the highest derivative.
    if order is not None:
        raise OptionError(f"order={tuple(order)!r}: the {_EXPORT} states the order of its axes")
    structs, coherence = _select_used(variables, path)
    frfs = _read_functions(structs)
    for struct in structs:
        name = f"{struct.name}.y_values.values"
        check_phase(as_numbers(struct.get("y_values.values"), name, path), real_valued, name, path)
    rows, columns = (list(dict.fromkeys(names)) for names in zip(*frfs.values, strict=True))
    for pair in product(rows, columns):
        if pair not in frfs.values:
            raise FormatError(f"no FRF of response {pair[0]!r} and reference {pair[1]!r}", path)
    responses, references = label_channels(rows, columns, response_labels, reference_labels, path)
    quantities: dict[Pair, str] = {}
    for struct in structs:
        quantities |= _read_quantities(
            struct,
            dict(zip(rows, responses, strict=True)),
            dict(zip(columns, references, strict=True)),
        )
    common = max(quantities.values(), key=lambda kind: QUANTITIES[kind])
    frfs = _convert(frfs, quantities, common, path)
    items = {
        "freq": frfs.freq,
        "H": _stack(frfs, rows, columns),
        "responses": responses.labels,
        "references": references.labels,
        "quantity": common,
        "source": f"{_EXPORT}: {', '.join(rows)} / {', '.join(columns)}",
        "coherence": _match_coherence(coherence, frfs, rows, columns, path),
        "averages": _read_averages(structs),
    }
    given = {name: item for name, item in items.items() if item is not None}
    return build_frf(given, path, quantity=quantity, duplicates=duplicates)


def _convert(
    frfs: Functions, quantities: Mapping[Pair, str], common: str, path: str | Path
) -> Functions:
    """Convert FRFs to a common quantity, with a warning that names the converted responses."""
    converted = dict.fromkeys(pair[0] for pair, kind in quantities.items() if kind != common)
    if converted:
        warn(path, f"several quantities; converted to {common}: {', '.join(converted)}", depth=5)
    values = {}
    for pair, kind in quantities.items():
        power = QUANTITIES[common] - QUANTITIES[kind]
        values[pair] = frfs.values[pair] * (2j * np.pi * frfs.freq) ** power
    return Functions(frfs.freq, values)


# -- structs -------------------------------------------------------------------------------------
def _select_structs(variables: Mapping[str, object], path: str | Path) -> list[_Struct]:
    return [
        _Struct(name, value, path)
        for name, value in variables.items()
        if isinstance(value, Mapping) and sum(part in value for part in _PARTS) >= 2
    ]


def _select_used(
    variables: Mapping[str, object], path: str | Path
) -> tuple[list[_Struct], list[_Struct]]:
    """Return the structs of FRFs, at least one, and of coherence; warn about other variables."""
    by_kind: dict[str, list[_Struct]] = {}
    for struct in _select_structs(variables, path):
        by_kind.setdefault(struct.kind, []).append(struct)
    if "FRF" not in by_kind:
        raise AbsentError(_describe_absence(by_kind), path)
    frfs, coherence = by_kind["FRF"], by_kind.get("Coherence", [])
    ignored = sorted(set(variables) - {s.name for s in (*frfs, *coherence)})
    if ignored:
        found = format_names(dict.fromkeys(ignored))
        warn(path, f"ignored: {found}; expected structs of type FRF or Coherence", depth=5)
    return frfs, coherence


def _describe_absence(by_kind: Mapping[str, Sequence[_Struct]]) -> str:
    counts: Counter[str] = Counter()
    for kind, structs in by_kind.items():
        counts[kind] += sum(len(s.texts(_RESPONSES)) for s in structs)
    text = f"{_EXPORT} without FRFs; it has {format_counts(counts)}"
    if "Coherence" in counts:
        text += ". Save its structs and those of the FRFs in one file to use the coherence"
    return text


def _read_functions(structs: Sequence[_Struct]) -> Functions:
    freq: RealArray | None = None
    out: dict[Pair, NumberArray] = {}
    for struct in structs:
        is_frf = struct.kind == "FRF"
        read = as_numbers if is_frf else as_reals
        values = read(struct.get("y_values.values"), f"{struct.name}.y_values.values", struct.path)
        lines = _read_lines(struct, len(np.atleast_1d(values)))
        freq = lines if freq is None else freq
        if not _are_same(lines, freq):
            raise struct.error(f"its frequency lines differ from those of {structs[0].name}")
        pairs = _read_pairs(struct)
        if values.shape != (len(freq), len(pairs)):
            raise struct.error(
                f"y_values.values of shape {values.shape}; expected (lines, functions) ="
                f" {len(freq), len(pairs)}"
            )
        if is_frf:
            unit = find_ratio(struct.text("y_values.quantity.label")) or Unit("unknown", 1.0)
            values = values * (_find_scale(struct, "y_values", unit) + 0j)
        for pair, column in zip(pairs, values.T, strict=True):
            if pair in out:
                raise struct.error(f"response {pair[0]!r} with reference {pair[1]!r} occurs twice")
            out[pair] = column
    assert freq is not None
    return Functions(freq, out)


def _read_lines(struct: _Struct, n_lines: int) -> RealArray:
    """Return the lines in Hz of functions with `n_lines` values."""
    label = struct.text("x_values.quantity.label")
    unit = find_unit(label, "frequency")
    if unit is None:
        raise struct.error(f"x_values in {label!r}; expected frequencies in Hz")
    keys = ("start_value", "increment", "number_of_values")
    start, step, count = (struct.number(f"x_values.{key}") for key in keys)
    if count != n_lines or count < 1:
        raise struct.error(
            f"x_values.number_of_values is {count:g}, but y_values.values has {n_lines} lines"
        )
    lines = start + step * np.arange(n_lines, dtype=np.float64)
    return np.asarray(lines * _find_scale(struct, "x_values", unit), dtype=np.float64)


def _read_pairs(struct: _Struct) -> list[Pair]:
    rows, columns = struct.texts(_RESPONSES), struct.texts(_REFERENCES)
    if len(rows) != len(columns) or not rows:
        raise struct.error(
            f"{len(rows)} responses (primary_channel), {len(columns)} references"
            " (reference_channel); expected one of each for each function"
        )
    return list(zip(rows, columns, strict=True))


def _are_same(a: RealArray, b: RealArray) -> bool:
    return a.shape == b.shape and np.allclose(a, b, rtol=1e-9, atol=0.0)


def _stack(functions: Functions, rows: Sequence[str], columns: Sequence[str]) -> NumberArray:
    """Return functions as one array, shape (lines, rows, columns)."""
    values = [[functions.values[i, j] for j in columns] for i in rows]
    return np.moveaxis(np.array(values), 2, 0)


# -- units and quantities ------------------------------------------------------------------------
def _find_scale(struct: _Struct, axis: str, unit: Unit) -> float:
    """Return the factor that converts stored values of an axis to SI; `unit` is of the label."""
    key = f"{axis}.quantity"
    factor, offset = (struct.number(f"{key}.unit_transformation.{k}") for k in ("factor", "offset"))
    tolerance = MEASURED_FILE.factor_tolerance
    if offset == 0.0 and math.isclose(factor * unit.factor, 1.0, rel_tol=tolerance):
        return 1.0
    info = as_text(struct.find(f"{key}.info") or [], f"{struct.name}.{key}.info", struct.path)
    is_unit = offset == 0.0 and math.isclose(factor, unit.factor, rel_tol=tolerance)
    if is_unit and "MKS" not in info:
        return factor
    raise struct.error(
        f"{key}: unit {struct.text(f'{key}.label')!r} with factor {factor:g} and offset {offset:g}"
        f" ({info or 'no info'}); the unit of the values is ambiguous. Export the"
        " functions in SI units, with factor 1"
    )


def _read_quantities(
    struct: _Struct, responses: Mapping[str, Dof], references: Mapping[str, Dof]
) -> dict[Pair, str]:
    """Return the quantity of each FRF from its dimension."""
    terms = _read_dimension(struct)
    label = struct.text("y_values.quantity.label")
    ratio = find_ratio(label)
    out = {}
    for response, reference in _read_pairs(struct):
        directions = responses[response].direction + references[reference].direction
        time, length = terms.get("TIME", 0.0), -float(directions.count("R"))
        kind = _BY_TIME.get(time)
        expected = {"MASS": -1.0, "LENGTH": length, "TIME": time, "ANGLE": terms.get("ANGLE", 0.0)}
        is_motion_over_force = terms == {k: v for k, v in expected.items() if v}
        if kind is None or not is_motion_over_force or (ratio and ratio.kind != kind):
            found = " ".join(f"{name}^{power:g}" for name, power in terms.items())
            raise struct.error(
                f"unit {label!r} (dimension {found or '1'}) of response {response!r} with reference"
                f" {reference!r}; expected motion over force, such as '(m/s^2)/N' (MASS^-1). The"
                " reference must be a force, not a voltage or a motion"
            )
        out[response, reference] = kind
    return out


def _read_dimension(struct: _Struct) -> dict[str, float]:
    """Return the exponents of the dimensions, without zeros."""
    key = "y_values.quantity.quantity_terms"
    terms = struct.get(key)
    out: dict[str, float] = {}
    for i, term in enumerate(terms if isinstance(terms, list) else [terms], 1):
        if not isinstance(term, Mapping):
            raise struct.error(f"{key}: found {describe_kind(terms)}; expected a struct array")
        entry = _Struct(f"{struct.name}.{key}({i})", term, struct.path)
        denominator = entry.number("den")
        if denominator == 0.0:
            raise entry.error("den is 0")
        out[entry.text("quantity").upper()] = entry.number("num") / denominator
    return {name: power for name, power in out.items() if power}


# -- coherence and averages ----------------------------------------------------------------------
def _match_coherence(
    structs: Sequence[_Struct],
    frfs: Functions,
    rows: Sequence[str],
    columns: Sequence[str],
    path: str | Path,
) -> NumberArray | None:
    """Return the coherence of all FRFs; None without it, with a warning if it is incomplete."""
    if not structs:
        return None
    found = _read_functions(structs)
    missing = [pair for pair in frfs.values if pair not in found.values]
    if missing:
        warn(path, f"coherence ignored, because {'/'.join(missing[0])} has none", depth=5)
        return None
    if not _are_same(found.freq, frfs.freq):
        warn(
            path,
            "coherence ignored, because its frequency lines differ from those of the FRFs",
            depth=5,
        )
        return None
    return _stack(found, rows, columns)


def _read_averages(structs: Sequence[_Struct]) -> float | None:
    """Return the number of linear averages; None if it is missing or differs."""
    numbers: set[float] = set()
    for struct in structs:
        key = "function_record.average"
        count = struct.find(f"{key}.nr_of_averages")
        types = struct.find(f"{key}.type") or []
        if count is None or not all(str(kind).startswith("LIN") for kind in types):
            return None
        numbers |= set(as_vector(count, f"{struct.name}.{key}.nr_of_averages", struct.path))
    return float(numbers.pop()) if len(numbers) == 1 else None
