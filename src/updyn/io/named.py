"""Models and FRFs as named items, the common content of ``.npz`` and ``.mat`` files.

An item is a number array, a sparse matrix, a list of texts, or a mapping of items (a MATLAB
struct). A model is::

    dofs                    N labels "node:direction", or an (N, 2) table of node and direction
                            1..6 for X Y Z RX RY RZ; or dof_ref, the same with 0..5
    K, M, C, loss_factor    one group, named "model", with at least K, M or C; or each a mapping of
                            group name to the value of the group
    groups                  instead: mapping of group name to K, M, C, loss_factor, name; or a list
                            of such mappings
    mass_damping            1/s, in addition to loss_factor; optional, as are
    stiffness_damping       s
    loss_table              (2, n): lines in Hz, factors on loss_factor
    nodes, xyz, lines, axes, faces
                            geometry, optional
    title                   optional

and an FRF is::

    freq                    n_f lines in Hz
    H (or values)           complex, (n_f, n_responses, n_references)
    responses, references   signed labels, or tables of node and direction, negative for the
                            opposite sense
    quantity                "receptance", "mobility", "accelerance" or "transmissibility"
    coherence, variance     of the shape of H, optional
    averages, source        optional
    decay                   of an exponential window whose damping is in H, in 1/s, optional
    base, force             of a transmissibility: labels of the moving base, or label of the only
                            force, optional
    level, sweep            amplitude of the force in N (N m), one number or n_f; "up" or "down";
                            optional
    excitation              of a level: "sine" or "random" (the level is its RMS), optional
    spectrum                of a random force: (n_s, 2), Hz and N^2/Hz, optional
    nodes, xyz, lines, axes, faces
                            geometry, optional
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import NumberArray
from updyn.dofs import Dof, DofSet
from updyn.errors import FormatError, OptionError, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.group import VALUES
from updyn.io.damping import DAMPING, plain_damping
from updyn.io.items import (
    Items,
    as_dofs,
    as_integers,
    as_matrix,
    as_number,
    as_numbers,
    as_reals,
    as_text,
    as_vector,
    check_names,
    check_phase,
    describe_kind,
    format_names,
    locate_errors,
)
from updyn.model import Group, Model

__all__ = [
    "FRF_ITEMS",
    "MODEL_ITEMS",
    "build_frf",
    "build_model",
    "frf_items",
    "model_items",
    "refuse_triangle",
    "with_groups",
]

_GEOMETRY = ("nodes", "xyz", "lines", "axes", "faces")
_MATRICES = {"K": "stiffness", "M": "mass", "C": "viscous"}
_MARKS = ("updyn_kind", "updyn_version")
#: Names of the items of a model; labels may also be named ``dof_ref``.
MODEL_ITEMS = ("dofs", "groups", *_MATRICES, *DAMPING, "title", *_GEOMETRY, *_MARKS)
_FRF = (
    "freq",
    "H",
    "values",
    "responses",
    "references",
    "quantity",
    "coherence",
    "variance",
    "averages",
    "source",
    "decay",
    "base",
    "force",
    "level",
    "sweep",
    "excitation",
    "spectrum",
)
#: Names of the items of FRFs.
FRF_ITEMS = (*_FRF, *_GEOMETRY, *_MARKS)
_AXES = ("freq", "response", "reference")
_READERS = {"model": "read_model", "frf": "read_frf"}


# -- model --------------------------------------------------------------------------------------
def build_model(items: Items, path: str | Path) -> Model:
    """Build a model from named items."""
    items = with_groups(items, path)
    _check_kind(items, "model", path)
    check_names(items, MODEL_ITEMS, path)
    plain = [name for name in (*_MATRICES, *DAMPING) if name in items]
    if "groups" in items and plain:
        raise FormatError(f"holds both 'groups' and {plain[0]!r}; expected one or the other", path)
    if "groups" in items:
        groups = _groups(items["groups"], path)
    elif plain:
        groups = {"model": _group({name: items[name] for name in plain}, "model", path)}
    else:
        raise FormatError(
            f"no matrix: expected K, M or C, or groups of them; found: {format_names(items)}", path
        )
    if "dofs" not in items:
        size = next(iter(groups.values())).n_dofs
        raise FormatError(
            f"no 'dofs': the {size} DOFs need labels such as '12:Z' (or a table of node and"
            f" direction 1..6); found: {format_names(items)}",
            path,
        )
    with locate_errors(path):
        return Model.from_groups(
            groups,
            as_dofs(items["dofs"], "dofs", path),
            geometry=_geometry(items, path),
            title=_title(items, path),
        )


def _title(items: Items, path: str | Path) -> str:
    return _text(items, "title", path)


def _text(items: Items, name: str, path: str | Path) -> str:
    return as_text(items[name], name, path) if name in items else ""


def _groups(given: object, path: str | Path) -> dict[str, Group]:
    if not isinstance(given, Mapping) or not given:
        raise FormatError(
            f"groups: expected one item per group, found {describe_kind(given)}", path
        )
    out: dict[str, Group] = {}
    for key, parts in given.items():
        if not isinstance(parts, Mapping):
            raise FormatError(
                f"groups: {key!r} is {describe_kind(parts)}; expected K, M, C and loss_factor in"
                " it",
                path,
            )
        rest = dict(parts)
        name = as_text(rest.pop("name", key), f"name of group {key!r}", path)
        if name in out:
            raise FormatError(f"group {name!r} occurs twice", path)
        out[name] = _group(rest, name, path)
    return out


def _group(parts: Items, name: str, path: str | Path) -> Group:
    where = f"group {name!r}"
    check_names(parts, (*_MATRICES, *DAMPING), path, where)
    matrices = {}
    for key, what in _MATRICES.items():
        if key in parts:
            matrices[what] = as_matrix(parts[key], f"{where}: {key}", path)
            refuse_triangle(matrices[what], f"{where}: {what}", path)
    damping: dict[str, Any] = {}
    for quantity in VALUES:
        if quantity in parts:
            damping[quantity] = as_number(parts[quantity], f"{where}: {quantity}", path)
    if "loss_table" in parts:
        damping["loss_table"] = as_reals(parts["loss_table"], f"{where}: loss_table", path)
    with locate_errors(path, where):
        return Group(**matrices, **damping)


def model_items(model: Model) -> dict[str, Any]:
    """Return a model as named items, with its matrices in CSR form."""
    groups: dict[str, dict[str, object]] = {}
    for name, group in model.groups.items():
        parts: dict[str, Any] = {}
        for key, what in _MATRICES.items():
            if getattr(group, what) is not None:
                parts[key] = getattr(group, what)
        parts |= plain_damping(group)
        table = group.loss_table
        if table is not None:
            parts["loss_table"] = np.array([table.freq, table.relative])
        groups[name] = parts
    items: dict[str, object] = _marks("model")
    if model.title:
        items["title"] = model.title
    return {
        **items,
        "dofs": model.dofs.labels,
        "groups": groups,
        **_geometry_items(model.geometry),
    }


# -- FRF ----------------------------------------------------------------------------------------
def build_frf(
    items: Items,
    path: str | Path,
    *,
    quantity: str | None = None,
    duplicates: str = "raise",
    response_labels: Iterable[str | Dof] | None = None,
    reference_labels: Iterable[str | Dof] | None = None,
    order: Sequence[str] | None = None,
    real_valued: bool = False,
) -> FRF:
    """Build an FRF from named items; the other arguments declare items that are missing."""
    if duplicates != "raise":
        raise OptionError(
            f"duplicates={duplicates!r}: this format holds every response and reference once;"
            " expected 'raise'"
        )
    _check_kind(items, "frf", path)
    check_names(items, FRF_ITEMS, path)
    key = _values_key(items, path)
    lacking = []
    offered = []
    for name, option, given in (
        ("freq", "", None),
        ("responses", "response_labels", response_labels),
        ("references", "reference_labels", reference_labels),
        ("quantity", "quantity", quantity),
    ):
        if name not in items and given is None:
            lacking.append(repr(name))
            offered += [option] if option else []
    if lacking:
        hint = ", ".join(f"{option}=..." for option in offered)
        if hint:
            hint = f"; can also be given when reading: {hint}"
        raise FormatError(
            f"no {' and no '.join(lacking)}: found {format_names(items)} ({key} of shape"
            f" {as_numbers(items[key], key, path).shape}); expected freq, H (lines, responses,"
            f" references), responses, references, quantity{hint}",
            path,
            key=offered[:1],
        )
    freq = as_vector(items["freq"], "freq", path)
    rows = _labels(items, "responses", response_labels, path)
    columns = _labels(items, "references", reference_labels, path)
    shape = (len(freq), len(rows), len(columns))
    arrays = {}
    for name in (key, "coherence", "variance"):
        if name in items:
            arrays[name] = _order_axes(items[name], name, shape, order, path)
    check_phase(arrays[key], real_valued, key, path)
    with locate_errors(path):
        return FRF(
            freq,
            arrays[key],
            rows,
            columns,
            _quantity(items, quantity, path),
            coherence=arrays.get("coherence"),
            variance=arrays.get("variance"),
            averages=_averages(items, path),
            geometry=_geometry(items, path),
            source=_text(items, "source", path),
            decay=as_number(items["decay"], "decay", path) if "decay" in items else 0.0,
            base=as_dofs(items["base"], "base", path) if "base" in items else None,
            force=_text(items, "force", path) or None,
            level=_level(items, path),
            sweep=_text(items, "sweep", path) or None,
            excitation=_text(items, "excitation", path) or None,
            spectrum=as_reals(items["spectrum"], "spectrum", path) if "spectrum" in items else None,
        )


def _level(items: Items, path: str | Path) -> NumberArray | None:
    """Return the force amplitude: one number, or one for each line."""
    if "level" not in items:
        return None
    level = as_vector(items["level"], "level", path)
    return level.reshape(()) if len(level) == 1 else level


def _values_key(items: Items, path: str | Path) -> str:
    found = [name for name in ("H", "values") if name in items]
    if len(found) == 2:
        raise FormatError("holds both 'H' and 'values'; expected one of them", path)
    if not found:
        raise FormatError(f"no 'H' (or 'values') with the FRFs; found: {format_names(items)}", path)
    return found[0]


def _quantity(items: Items, given: str | None, path: str | Path) -> str:
    if "quantity" not in items:
        return str(given)
    stated = as_text(items["quantity"], "quantity", path)
    if given is not None and stated != given:
        raise FormatError(
            f"quantity {given!r} contradicts the file, which states {stated!r}",
            path,
            key=("quantity",),
        )
    return stated


def _averages(items: Items, path: str | Path) -> int | None:
    if "averages" not in items:
        return None
    value = as_number(items["averages"], "averages", path)
    if not value.is_integer():
        raise FormatError(f"averages: {value:g}; expected a whole number of at least 1", path)
    return int(value)


def _labels(items: Items, name: str, given: Iterable[str | Dof] | None, path: str | Path) -> DofSet:
    with locate_errors(path, name):
        option = DofSet(() if given is None else given)
    if name not in items:
        return option
    stored = as_dofs(items[name], name, path)
    if given is not None and option != stored:
        raise FormatError(
            f"{name}: the argument {option!r} contradicts the file, which states {stored!r}",
            path,
        )
    return stored


def _order_axes(
    given: object,
    name: str,
    shape: tuple[int, int, int],
    order: Sequence[str] | None,
    path: str | Path,
) -> NumberArray:
    """Return an array as (lines, responses, references); lengths never decide the order."""
    array = as_numbers(given, name, path)
    found = array.shape
    axes = [*(order or ()), *(axis for axis in _AXES if axis not in (order or ()))]
    if len(axes) != len(_AXES) or set(axes) != set(_AXES):
        raise OptionError(
            f"order={tuple(order or ())!r}: expected {', '.join(map(repr, _AXES))} in the order of"
            " the file, without axes of length 1 that it lacks",
            key=("order",),
        )
    # MATLAB has no trailing axis of length 1: with one reference (and one response) the stored
    # array has fewer axes.
    if array.ndim <= len(axes):
        array = array.reshape(found + (1,) * (len(axes) - array.ndim))
        array = array.transpose([axes.index(axis) for axis in _AXES])
    if array.shape != shape:
        advice = f" in the order {tuple(order)!r}" if order else _format_advice(found, shape)
        raise FormatError(
            f"{name}: found shape {found}, expected (lines, responses, references) ="
            f" {shape}{advice}",
            path,
            key=("order",) if advice else (),
        )
    return array


def _format_advice(found: tuple[int, ...], expected: tuple[int, int, int]) -> str:
    if len(found) != 3:
        return ""
    fits = []
    for order in permutations(range(3)):
        if itemgetter(*order)(expected) == found:
            fits.append(itemgetter(*order)(_AXES))
    if not fits:
        return ""
    if len(fits) > 1:
        return "; more than one order of its axes would fit: select it with order=(...)"
    return f"; by the lengths of its axes, read it with order={fits[0]!r}"


def frf_items(frf: FRF) -> dict[str, Any]:
    """Return an FRF as named items."""
    items: dict[str, object] = {
        **_marks("frf"),
        "freq": frf.freq,
        "H": frf.values,
        "responses": frf.responses.labels,
        "references": frf.references.labels,
        "quantity": frf.quantity,
    }
    for name in ("coherence", "variance", "averages"):
        if getattr(frf, name) is not None:
            items[name] = getattr(frf, name)
    if frf.source:
        items["source"] = frf.source
    if frf.decay:
        items["decay"] = frf.decay
    if frf.base is not None:
        items["base"] = frf.base.labels
    if frf.force is not None:
        items["force"] = str(frf.force)
    if frf.level is not None:
        items["level"] = frf.level
    if frf.sweep is not None:
        items["sweep"] = frf.sweep
    if frf.excitation is not None:
        items["excitation"] = frf.excitation
    if frf.spectrum is not None:
        items["spectrum"] = frf.spectrum
    return {**items, **_geometry_items(frf.geometry)}


# -- shared -------------------------------------------------------------------------------------
def _marks(kind: str) -> dict[str, object]:
    from updyn import __version__

    return {"updyn_kind": kind, "updyn_version": __version__}


def _check_kind(items: Items, expected: str, path: str | Path) -> None:
    """Refuse a file of the other kind, by the mark of updyn or by its items."""
    if "updyn_kind" in items:
        kind = as_text(items["updyn_kind"], "updyn_kind", path)
    elif "freq" in items and "dofs" not in items:
        kind = "frf"
    elif "dofs" in items and "freq" not in items:
        kind = "model"
    else:
        return
    if kind == expected:
        return
    right = suggest(kind, _READERS)
    if kind in _READERS:
        right = f"read it with updyn.{_READERS[kind]}"
    raise FormatError(f"the file is of kind {kind!r}, expected {expected!r}; {right}", path)


def _geometry(items: Items, path: str | Path) -> Geometry | None:
    given = [name for name in _GEOMETRY if name in items]
    if not given:
        return None
    for name in ("nodes", "xyz"):
        if name not in given:
            raise FormatError(
                f"holds {given[0]!r} but no {name!r}; a geometry needs nodes and xyz", path
            )
    lines = as_integers(items.get("lines", np.empty((0, 2))), "lines", path)
    if lines.ndim != 2 or lines.shape[1] != 2:
        raise FormatError(f"lines: found shape {lines.shape}; expected (m, 2) node numbers", path)
    nodes = as_integers(as_vector(items["nodes"], "nodes", path), "nodes", path)
    axes = as_numbers(items["axes"], "axes", path) if "axes" in items else None
    faces = as_integers(items["faces"], "faces", path) if "faces" in items else None
    with locate_errors(path):
        return Geometry(nodes, as_reals(items["xyz"], "xyz", path), lines, axes, faces)


def _geometry_items(geometry: Geometry | None) -> dict[str, object]:
    if geometry is None:
        return {}
    items: dict[str, object] = {"nodes": geometry.nodes, "xyz": geometry.xyz}
    if len(geometry.lines):
        items["lines"] = geometry.lines
    if geometry.axes is not None:
        items["axes"] = geometry.axes
    if len(geometry.faces):
        items["faces"] = geometry.faces
    return items


def with_groups(items: Items, path: str | Path) -> Items:
    """Return the items with parts as ``groups`` and labels as ``as_dofs``."""
    out: dict[str, Any] = dict(items)
    if "dof_ref" in out:
        if "dofs" in out:
            raise FormatError("holds both 'dofs' and 'dof_ref'; expected one of them", path)
        table = as_integers(out.pop("dof_ref"), "dof_ref", path)
        if table.ndim != 2 or table.shape[1] != 2 or not np.isin(table[:, 1], range(6)).all():
            raise FormatError(
                f"dof_ref: found numbers of shape {table.shape}; expected (N, 2): node, and"
                " direction 0..5 for X, Y, Z, RX, RY, RZ; a table with directions 1..6 is named"
                " dofs",
                path,
            )
        out["dofs"] = table + np.array([0, 1])
    if isinstance(out.get("groups"), list):
        out["groups"] = _from_array(out["groups"], path)
    split = [key for key in _MATRICES if isinstance(out.get(key), Mapping)]
    if not split:
        return out
    for other in ("groups", *_MATRICES):
        if other in out and other not in split:
            raise FormatError(
                f"{split[0]} is a struct with a matrix for each part, but {other} is not", path
            )
    groups: dict[str, dict[str, Any]] = {}
    for key in split:
        for name, part in out.pop(key).items():
            groups.setdefault(name, {})[key] = part
    for key in DAMPING:
        for name, value in _items_by_part(out, key, path).items():
            if name not in groups:
                raise FormatError(f"{key}: no part {name!r} in {', '.join(split)}", path)
            groups[name][key] = value
    return {**out, "groups": groups}


def _items_by_part(out: dict[str, Any], key: str, path: str | Path) -> dict[str, Any]:
    given = out.pop(key, {})
    if not isinstance(given, Mapping):
        found = "one table" if key == "loss_table" else f"{as_number(given, key, path):g}"
        raise FormatError(
            f"{key} is {found} for several parts; expected a struct with one for each", path
        )
    return dict(given)


def _from_array(parts: list[Any], path: str | Path) -> dict[str, Any]:
    groups: dict[str, Any] = {}
    for i, part in enumerate(parts, 1):
        if not isinstance(part, Mapping):
            raise FormatError(
                f"groups: expected one struct per group, found {describe_kind(parts)}", path
            )
        if "name" not in part:
            raise FormatError(
                f"groups({i}) has no field 'name'; it has {', '.join(map(str, part))}", path
            )
        name = as_text(part["name"], f"groups({i}).name", path)
        if name in groups:
            raise FormatError(f"group {name!r} occurs twice", path)
        # All elements of a struct array have the same fields; unused ones are empty.
        groups[name] = {key: value for key, value in part.items() if not _empty(value)}
    return groups


def _empty(value: Any) -> bool:
    if sp.issparse(value) or isinstance(value, np.ndarray):
        return 0 in value.shape
    return bool(value == [])


def refuse_triangle(matrix: object, name: str, path: str | Path) -> None:
    """Refuse one triangle of a matrix, the usual storage of symmetric matrices in programs."""
    entry = sp.coo_array(matrix)
    if entry.ndim != 2 or entry.shape[0] != entry.shape[1]:
        return
    upper = bool((entry.data[entry.row < entry.col] != 0).any())
    lower = bool((entry.data[entry.row > entry.col] != 0).any())
    if upper != lower:
        side = "upper" if upper else "lower"
        other = "triu(K, 1)" if upper else "tril(K, -1)"
        raise FormatError(
            f"{name}: holds only the {side} triangle of a symmetric matrix; expected the whole"
            f" matrix: K + {other}' completes it",
            path,
        )
