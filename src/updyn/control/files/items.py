"""The items of a plant in a file: names, checks, and their form in flat formats.

Items (`plant_items`), as in ``.json``::

    format, schema            "updyn plant", 3; earlier schemas are read: 2 without sha256, 1 also
                              without relative_error and zero_shift
    A, B, C, D                (n, n), (n, n_u), (n_y, n), (n_y, n_u), in SI units
    dt, delay                 sampling interval in s, None if continuous; intervals of delay in A
    inputs                    {name, unit, weights, rotation} of each; weights by DOF label
    outputs                   the same with quantity
    band                      Hz
    tolerance, error, peak_error, route, rigid, modes, facts    see `updyn.control.plant.Plant`
    relative_error            None: unknown
    zero_shift                {output, input, frequency, shift, depth, plant_depth} of each zero
    sha256                    digest of all other items; optional, for files edited by hand

In formats of arrays and texts (``.mat``, ``.npz``) `flat_items` replaces ``inputs``, and
``outputs`` likewise, by::

    inputs, input_units       names and units
    input_rotation            1 for a moment and an angle, else 0
    input_weight              all weights, port by port
    input_weight_port         number of the port of each weight, from 1
    input_weight_dof          DOF label of each weight
    quantities                of the outputs
    dt                        0 if continuous, as in MATLAB
    facts, zero_shift         JSON text, see `updyn.store.values`
    relative_error            nan: unknown
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.control.antiresonances import ZeroShift
from updyn.control.plant import Plant
from updyn.control.ports import Port, as_ports
from updyn.errors import FormatError, suggest
from updyn.frf import QUANTITIES
from updyn.group import is_number
from updyn.io.items import check_names, locate_errors
from updyn.store.values import from_text, to_text

__all__ = ["FORMAT", "NO_PLANT", "build_plant", "flat_items", "nested_items", "plant_items"]

FORMAT, SCHEMA = "updyn plant", 3
#: Schemas that can be read.
_READ = (1, 2, 3)
#: End of the message about a file of another kind.
NO_PLANT = "this file holds no plant"

_MATRICES = ("A", "B", "C", "D")
_NUMBERS = ("tolerance", "error", "peak_error")
_COUNTS = ("delay", "rigid")
_KEYS = (
    "format",
    "schema",
    "dt",
    *_COUNTS,
    "inputs",
    "outputs",
    "band",
    *_NUMBERS,
    "route",
    "modes",
    "facts",
)
_LATER = ("relative_error", "zero_shift")
_DIGEST = "sha256"
_ZERO = tuple(f.name for f in fields(ZeroShift))
_PORT = ("name", "unit", "weights", "rotation")
_FLAT_PORTS = ("{}s", "{}_units", "{}_rotation", "{}_weight", "{}_weight_port", "{}_weight_dof")


def plant_items(plant: Plant) -> dict[str, Any]:
    """Return the items of a plant."""
    outputs = []
    for port, quantity in zip(plant.output_ports, plant.quantities, strict=True):
        outputs.append({**_port_items(port, port.motion_unit(quantity)), "quantity": quantity})
    items = {
        "format": FORMAT,
        "schema": SCHEMA,
        "dt": plant.dt,
        "delay": int(plant.delay),
        "inputs": [_port_items(port, port.force_unit) for port in plant.input_ports],
        "outputs": outputs,
        "band": list(map(float, plant.band)),
        **{name: float(getattr(plant, name)) for name in _NUMBERS},
        "route": plant.route,
        "rigid": int(plant.rigid),
        "modes": plant.modes,
        "facts": dict(plant.facts),
        "relative_error": None if math.isnan(plant.relative_error) else plant.relative_error,
        "zero_shift": [_replace_nan(asdict(zero)) for zero in plant.zero_shift],
        **{name: getattr(plant, name) for name in _MATRICES},
    }
    return {**items, _DIGEST: _digest(items)}


def build_plant(items: Mapping[str, Any], path: str | Path) -> Plant:
    """Return the plant from its items; raises FormatError with file and item."""
    if items.get("format") != FORMAT:
        raise FormatError(
            f"format: found {items.get('format')!r}, expected {FORMAT!r}: {NO_PLANT}", path
        )
    if items.get("schema") not in _READ:
        raise FormatError(
            f"schema: found {items.get('schema')!r}; this version of updyn reads"
            f" {' and '.join(map(str, _READ))}",
            path,
        )
    written = items
    items = _EARLIER | dict(items) if items["schema"] == 1 else items
    _check_complete(items, (*_KEYS, *_LATER, *_MATRICES), "", path, optional=(_DIGEST,))
    inputs = _read_ports(items["inputs"], "input", _PORT, path)
    outputs = _read_ports(items["outputs"], "output", (*_PORT, "quantity"), path)
    dt, band = items["dt"], _numbers(items["band"], 1, "band", path)
    if dt is not None and (not is_number(dt) or not math.isfinite(dt) or dt <= 0):
        raise FormatError(
            f"dt: found {dt!r}; expected a sampling interval in s above 0, or none", path
        )
    if band.shape != (2,) or not 0 <= band[0] < band[1] < np.inf:
        raise FormatError(
            f"band: found {band.tolist()}; expected its lowest and highest frequency in Hz", path
        )
    if not isinstance(items["route"], str):
        raise FormatError(f"route: found {items['route']!r}; expected a text", path)
    if not isinstance(items["facts"], Mapping):
        raise FormatError(
            f"facts: found {type(items['facts']).__name__}; expected values by name", path
        )
    columns = {"A": 0, "B": len(inputs), "C": 0, "D": len(inputs)}
    given: dict[str, Any] = {}
    for name, width in columns.items():
        given[name] = _matrix(items[name], width, name, path)
    for name in _NUMBERS:
        given[name] = _number(items[name], name, path)
    for name in _COUNTS:
        given[name] = _count(items[name], name, path)
    with locate_errors(path):
        plant = Plant(
            **given,
            input_ports=tuple(port for port, _ in inputs),
            output_ports=tuple(port for port, _ in outputs),
            quantities=tuple(quantity for _, quantity in outputs),
            band=(float(band[0]), float(band[1])),
            route=items["route"],
            modes=_numbers(items["modes"], 1, "modes", path),
            dt=None if dt is None else float(dt),
            facts=dict(items["facts"]),
            relative_error=_number_or_nan(items["relative_error"], "relative_error", path),
            zero_shift=_read_zeros(items["zero_shift"], path),
        )
    _check_digest(written, path)
    return plant


def _digest(items: Mapping[str, object]) -> str:
    """Return the SHA-256 of all other items, independent of order and form of arrays."""
    content = {}
    for name, value in items.items():
        if name != _DIGEST:
            plain_value = value if name == "facts" else _as_lists(value)
            content[name] = json.loads(to_text(plain_value, "a plant"))
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _as_lists(value: object) -> object:
    """Return a value with arrays and tuples as lists, and all numbers as float."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: _as_lists(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_as_lists(one) for one in value]
    return float(value) if is_number(value) else value


def _check_digest(items: Mapping[str, object], path: str | Path) -> None:
    if _DIGEST in items and items[_DIGEST] != _digest(items):
        raise FormatError(
            f"{_DIGEST}: the content of the file differs from what was written, by its digest."
            " It is damaged or was edited; restore it, or write it again. If the change is"
            f" intended, remove {_DIGEST!r}",
            path,
        )


# -- arrays and texts only ------------------------------------------------------------------------
def flat_items(plant: Plant) -> dict[str, Any]:
    """Return the items of a plant as numbers, arrays, texts and lists of texts."""
    items = plant_items(plant)
    unknown = items["relative_error"] is None
    out = {
        **items,
        "dt": items["dt"] or 0.0,
        "facts": to_text(items["facts"], "facts of a plant"),
        "relative_error": np.nan if unknown else items["relative_error"],
        "zero_shift": to_text(items["zero_shift"], "zeros of a plant"),
    }
    for side in ("input", "output"):
        ports = items[f"{side}s"]
        numbers: list[float] = []
        labels: list[str] = []
        weights: list[float] = []
        for number, port in enumerate(ports, 1):
            numbers += [float(number)] * len(port["weights"])
            labels += port["weights"].keys()
            weights += port["weights"].values()
        out |= {
            f"{side}s": [p["name"] for p in ports],
            f"{side}_units": [p["unit"] for p in ports],
            f"{side}_rotation": np.array([float(p["rotation"]) for p in ports]),
            f"{side}_weight": np.array(weights),
            f"{side}_weight_port": np.array(numbers),
            f"{side}_weight_dof": labels,
        }
    return {
        **out,
        "band": np.array(items["band"]),
        "quantities": [p["quantity"] for p in items["outputs"]],
    }


def nested_items(flat: Mapping[str, object], path: str | Path) -> dict[str, object]:
    """Return plant items from those of a flat file; raises FormatError with file and item."""
    found = None
    if "format" in flat:
        found = _text(flat["format"], "format", path)
    if found != FORMAT:
        raise FormatError(f"format: found {found!r}, expected {FORMAT!r}: {NO_PLANT}", path)
    ports = [name.format(side) for side in ("input", "output") for name in _FLAT_PORTS]
    known = dict.fromkeys([*_KEYS, *_LATER, *_MATRICES, *ports, "quantities"])
    if _single_number(flat.get("schema"), "schema", path) == 1:
        flat = {"relative_error": np.array(np.nan), "zero_shift": "[]"} | dict(flat)
    _check_complete(flat, list(known), "", path, optional=(_DIGEST,))
    single: dict[str, Any] = {}
    for name in ("schema", "dt", *_COUNTS, *_NUMBERS, "relative_error"):
        single[name] = _single_number(flat[name], name, path)
    if math.isnan(single["relative_error"]):
        single["relative_error"] = None
    if single["dt"] == 0:
        single["dt"] = None
    quantities = _texts(flat["quantities"], "quantities", path)
    outputs = _nested_ports(flat, "output", path)
    if len(quantities) != len(outputs):
        raise FormatError(
            f"quantities: found {len(quantities)}, expected {len(outputs)}, one for each output",
            path,
        )
    return {
        **single,
        "format": found,
        "inputs": _nested_ports(flat, "input", path),
        "outputs": [{**port, "quantity": q} for port, q in zip(outputs, quantities, strict=True)],
        "band": _row(flat["band"], "band", path),
        "modes": _row(flat["modes"], "modes", path),
        "route": _text(flat["route"], "route", path),
        "facts": from_text(_text(flat["facts"], "facts", path), "facts", path),
        "zero_shift": from_text(_text(flat["zero_shift"], "zero_shift", path), "zero_shift", path),
        **{name: flat[name] for name in _MATRICES},
        **{name: _text(flat[name], name, path) for name in (_DIGEST,) if name in flat},
    }


def _nested_ports(
    flat: Mapping[str, object], side: str, path: str | Path
) -> list[dict[str, object]]:
    names, units, rotation, weight, port, label = (name.format(side) for name in _FLAT_PORTS)
    texts = {name: _texts(flat[name], name, path) for name in (names, units, label)}
    numbers = {name: _row(flat[name], name, path) for name in (rotation, weight, port)}
    for group in ((names, units, rotation), (weight, port, label)):
        sizes = {name: len(texts.get(name, numbers.get(name, ()))) for name in group}
        if len(set(sizes.values())) > 1:
            counts = ", ".join(f"{name}: {size} items" for name, size in sizes.items())
            raise FormatError(f"{counts}; expected equal numbers", path)
    out: list[dict[str, Any]] = []
    ports = zip(texts[names], texts[units], numbers[rotation].tolist(), strict=True)
    for name, unit, turns in ports:
        turning = {0.0: False, 1.0: True}.get(turns, turns)
        out.append({"name": name, "unit": unit, "weights": {}, "rotation": turning})
    for number, value, dof in zip(numbers[port], numbers[weight], texts[label], strict=True):
        if number not in range(1, len(out) + 1):
            raise FormatError(
                f"{port}: found {number:g}; expected the number of one of {len(out)} {side}s", path
            )
        weights = out[int(number) - 1]["weights"]
        if dof in weights:
            raise FormatError(f"{label}: {side} {int(number)} has {dof!r} twice", path)
        weights[dof] = float(value)
    return out


#: Values of later items for a plant of the first schema.
_EARLIER: dict[str, Any] = {"relative_error": None, "zero_shift": []}


def _replace_nan(found: dict[str, object]) -> dict[str, object]:
    out = {}
    for name, value in found.items():
        out[name] = None if isinstance(value, float) and math.isnan(value) else value
    return out


def _number_or_nan(found: object, name: str, path: str | Path) -> float:
    return math.nan if found is None else _number(found, name, path)


def _read_zeros(found: object, path: str | Path) -> tuple[ZeroShift, ...]:
    if not isinstance(found, list) or not all(isinstance(zero, Mapping) for zero in found):
        raise FormatError("zero_shift: expected a list of zeros", path)
    out = []
    for number, zero in enumerate(found, 1):
        place = f"zero_shift, number {number}"
        _check_complete(zero, _ZERO, place, path)
        for name in ("output", "input"):
            if not isinstance(zero[name], str):
                raise FormatError(f"{place}: {name}: found {zero[name]!r}; expected a text", path)
        numbers = {name: _number_or_nan(zero[name], f"{place}: {name}", path) for name in _ZERO[2:]}
        out.append(ZeroShift(zero["output"], zero["input"], **numbers))
    return tuple(out)


# -- one item -------------------------------------------------------------------------------------
def _port_items(port: Port, unit: str) -> dict[str, object]:
    return {
        "name": port.name,
        "unit": unit,
        "weights": dict(port.weights),
        "rotation": bool(port.rotation),
    }


def _read_ports(
    found: object, what: str, keys: tuple[str, ...], path: str | Path
) -> list[tuple[Port, str]]:
    """Return ports with their quantities, empty for inputs."""
    if not isinstance(found, list) or not all(isinstance(p, Mapping) for p in found):
        raise FormatError(f"{what}s: expected a list of ports", path)
    out = []
    for number, one in enumerate(found, 1):
        place = f"{what}s, number {number}"
        _check_complete(one, keys, place, path)
        if not isinstance(one["rotation"], bool):
            raise FormatError(
                f"{place}: rotation is {one['rotation']!r}; expected true or false", path
            )
        with locate_errors(path, place):
            port = Port(one["name"], one["weights"], one["rotation"])
        quantity = one.get("quantity", "")
        known = isinstance(quantity, str) and quantity in QUANTITIES
        if "quantity" in keys and not known:
            raise FormatError(
                f"{place}: quantity {quantity!r}; {suggest(str(quantity), QUANTITIES)}", path
            )
        unit = port.motion_unit(quantity) if quantity else port.force_unit
        if one["unit"] != unit:
            raise FormatError(
                f"{place}: found unit {one['unit']!r}, expected {unit!r} for this port", path
            )
        out.append((port, quantity))
    with locate_errors(path, f"{what}s"):
        as_ports([port for port, _ in out], what)
    return out


def _check_complete(
    found: Mapping[str, object],
    expected: Sequence[str],
    place: str,
    path: str | Path,
    optional: Sequence[str] = (),
) -> None:
    check_names(list(map(str, found)), [*expected, *optional], path, place)
    for name in expected:
        if name not in found:
            message = f"{place}: {name!r} is missing".removeprefix(": ")
            raise FormatError(message, path)


def _matrix(found: object, columns: int, name: str, path: str | Path) -> RealArray:
    if isinstance(found, list) and not found:
        return np.zeros((0, columns))  # no state: no rows to count the columns from
    return _numbers(found, 2, name, path)


def _numbers(found: object, ndim: int, name: str, path: str | Path) -> RealArray:
    if (
        isinstance(found, list)
        and not all(map(is_number, found))
        and not all(isinstance(r, list) for r in found)
    ):
        raise FormatError(f"{name}: contains a value that is not a number", path)
    rows: list[list[object]] = []
    if isinstance(found, list) and all(isinstance(r, list) for r in found):
        rows = found
    for number, row in enumerate(rows, 1):
        if not all(map(is_number, row)) or len(row) != len(rows[0]):
            wrong = f"has {len(row)} numbers"
            if len(row) == len(rows[0]):
                wrong = "contains a value that is not a number"
            raise FormatError(
                f"{name}: row {number} {wrong}; expected {len(rows[0])} numbers", path
            )
    if not isinstance(found, list | np.ndarray) or (
        isinstance(found, np.ndarray) and found.dtype.kind not in "fiu"
    ):
        raise FormatError(f"{name}: expected real numbers, found {type(found).__name__}", path)
    try:
        array = np.asarray(found, dtype=np.float64)
    except OverflowError as error:
        raise FormatError(f"{name}: contains a number that is too large", path) from error
    if array.ndim != ndim:
        axes = "1 axis" if ndim == 1 else f"{ndim} axes"
        raise FormatError(f"{name}: found shape {array.shape}; expected {axes}", path)
    return array


def _number(found: object, name: str, path: str | Path) -> float:
    if not is_number(found):
        raise FormatError(f"{name}: found {found!r}; expected a number", path)
    return float(found)


def _count(found: object, name: str, path: str | Path) -> int:
    if not is_number(found) or found != found // 1 or found < 0:
        raise FormatError(f"{name}: found {found!r}; expected a whole number, 0 or above", path)
    return int(found)


def _single_number(found: object, name: str, path: str | Path) -> float:
    array = _row(found, name, path)
    if array.shape != (1,):
        raise FormatError(f"{name}: found {array.size} numbers; expected one", path)
    return float(array[0])


def _row(found: object, name: str, path: str | Path) -> RealArray:
    """Return numbers as one axis; MATLAB stores rows and columns as matrices."""
    if isinstance(found, list) and not found:
        return np.zeros(0)
    if (
        not isinstance(found, np.ndarray)
        or found.dtype.kind not in "fiub"
        or found.size != max((*found.shape, 1))
    ):
        if isinstance(found, np.ndarray) and not found.size:
            return np.zeros(0)
        raise FormatError(f"{name}: expected one row of numbers", path)
    return found.ravel().astype(np.float64)


def _texts(found: object, name: str, path: str | Path) -> list[str]:
    if isinstance(found, str):
        return [found]
    if isinstance(found, np.ndarray) and not found.size:
        return []
    if not isinstance(found, list) or not all(isinstance(text, str) for text in found):
        raise FormatError(f"{name}: expected a list of texts", path)
    return found


def _text(found: object, name: str, path: str | Path) -> str:
    texts = _texts(found, name, path)
    if len(texts) > 1:
        raise FormatError(f"{name}: found {len(texts)} texts; expected one", path)
    return texts[0] if texts else ""
