"""Models, measurements and results as plain text; slow imports are in function bodies."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.cli.settings import DESCRIPTION
from updyn.dofs import DIRECTIONS, DofSet
from updyn.dynamics.modes import modes
from updyn.errors import ModelError, SolverError
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.grouping import list_labels
from updyn.io.toml_text import format_toml
from updyn.model import Group, Matrix, Model
from updyn.text_table import fit_columns, text_table

if TYPE_CHECKING:
    import xarray

    from updyn.io.nastran.op2 import Contents
    from updyn.modal import ModeSet
    from updyn.updating.judge.identifiability import Identifiability
    from updyn.updating.problem.parameters import ParameterSet

__all__ = [
    "describe_contents",
    "describe_frf",
    "describe_geometry",
    "describe_identifiability",
    "describe_model",
    "describe_modes",
    "describe_parameters",
    "describe_records",
]

#: Name of a group that ends with its number.
_NUMBERED = re.compile(r"(.*?\D)(\d+)")


def describe_model(model: Model) -> str:
    """Return DOFs, groups and the first natural frequencies of a model, as text."""
    axes = np.unique(model.dofs.axes)
    directions = " ".join(DIRECTIONS[axis] for axis in axes)
    name = f"Model {model.title!r}" if model.title else "Model"
    texts = [
        f"{name}: {model.n_dofs} DOFs, {len(model.groups)} groups, directions {directions}",
        f"DOFs: {_format_dofs(model.dofs)}",
    ]
    if model.geometry is None:
        texts.append("No geometry.")
    else:
        texts.append(describe_geometry(model.geometry))
    texts += ["", _group_table(model)]
    for name, group in model.groups.items():
        if len(group.damping) > 1:
            texts.append(f"{name}: {group.damping_words}")
        if group.origin.members:
            texts.append(f"{name} consists of {', '.join(group.origin.members)}")
    texts += [
        "mass: in rigid translation (kg), else about the axis (kg m2); stiffness, viscous:"
        " largest diagonal entry",
        *_describe_unplaced(model),
        *_describe_merging(model),
        "",
        _natural_frequencies(model),
    ]
    return "\n".join(texts)


def _describe_unplaced(model: Model) -> list[str]:
    """Return a remark on nodes without position, if there are any."""
    nodes = np.unique(model.dofs.nodes[~_find_placed(model) & (model.dofs.axes < 3)])
    if not len(nodes):
        return []
    which = f"node {nodes[0]} has" if len(nodes) == 1 else f"{len(nodes)} nodes have"
    return [
        f"{which} no position (generalised displacements, scalar points) and no part in the masses"
    ]


def _describe_merging(model: Model) -> list[str]:
    """Return how to merge groups, if there are many: their families, materials and sets."""
    if len(model.groups) <= DESCRIPTION.many_groups:
        return []
    examples = []
    for family, numbers in _largest_families(model):
        key = re.sub(r"\W+", "_", family.strip().lower(), flags=re.ASCII)
        examples.append(f"{key} = {format_toml(f'{family}{min(numbers)}-{max(numbers)}')}")
    if not examples:
        examples.append(f"name = {format_toml(list(model.groups)[:2])}")
    lines = [
        "",
        f"{len(model.groups)} groups: to have one unknown for several, merge them by name, glob,"
        " range, material or set, such as",
        f"[model] groups = {{ {', '.join(examples)} }}",
    ]
    labels = list_labels(model.groups.values())
    if labels:
        lines.append(f"materials and sets: {', '.join(labels)}")
    return lines


def _largest_families(model: Model) -> list[tuple[str, list[int]]]:
    """Return the largest families of groups, whose names differ by their last integer only."""
    families: dict[str, list[int]] = {}
    for name in model.groups:
        found = _NUMBERED.fullmatch(name)
        if found:
            families.setdefault(found[1], []).append(int(found[2]))
    large = [(family, numbers) for family, numbers in families.items() if len(numbers) > 1]
    return sorted(large, key=lambda item: -len(item[1]))[: DESCRIPTION.merging_examples]


def _group_table(model: Model) -> str:
    rows = []
    translations = _rigid_translations(model)
    for name, group in model.groups.items():
        loss_factor = "-"
        if group.stiffness is not None:
            loss_factor = f"{group.loss_factor:g}"
        rows.append(
            [
                name,
                str(_count_dofs(group)),
                _rigid_mass(group.mass, model.dofs, translations),
                _format_largest(group.stiffness),
                loss_factor,
                _format_largest(group.viscous),
            ]
        )
    header = ("group", "DOFs", "mass", "max stiffness", "loss factor", "max viscous")
    return text_table(header, rows)


def describe_frf(frf: FRF) -> str:
    """Return lines, DOFs, quantity and confidence of a measurement, as text."""
    size = np.abs(frf.values)
    first, last = frf.freq[0], frf.freq[-1]
    texts = [
        f"FRF: {frf.quantity}, {len(frf.freq)} lines from {first:g} to {last:g} Hz"
        + _spacing_text(frf),
        f"{len(frf.responses)} responses: {_format_dofs(frf.responses)}",
        f"{len(frf.references)} references: {_format_dofs(frf.references)}",
        f"|H| from {size.min():.3g} to {size.max():.3g}",
    ]
    if frf.coherence is None:
        texts.append("no coherence")
    else:
        median, lowest = np.median(frf.coherence), frf.coherence.min()
        texts.append(f"coherence: median {median:.3f}, lowest {lowest:.3f}")
    if frf.variance is not None:
        texts.append("with the variance of each value")
    if frf.averages is not None:
        texts.append(f"{frf.averages} averages")
    texts += _describe_excitation(frf)
    if frf.geometry is not None:
        texts.append(describe_geometry(frf.geometry))
    return "\n".join(texts)


def _describe_excitation(frf: FRF) -> list[str]:
    """Return what the data state about window, base, force and level."""
    texts = []
    if frf.decay:
        texts.append(f"window exp(-{frf.decay:g} t)")
    if frf.base is not None:
        texts.append(f"base: {_format_dofs(frf.base)}")
    if frf.force is not None:
        texts.append(f"force: {frf.force}")
    if frf.level is not None:
        band = ""
        if frf.spectrum is not None:
            band = f", with a spectrum from {frf.spectrum[0, 0]:g} to {frf.spectrum[-1, 0]:g} Hz"
        texts.append(f"{frf.level_text}{band}")
    return texts


def _spacing_text(frf: FRF) -> str:
    """Return the spacing of the lines as text, empty for a single line."""
    steps = np.diff(frf.freq)
    if not len(steps):
        return ""
    if np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        return f", every {steps[0]:g} Hz"
    return f", {steps.min():g} to {steps.max():g} Hz apart"


#: Columns of a table of modes, in the order in which they are left out of a narrow terminal.
_OF_MODES = ("scale", "quality", "phase collinearity", "std")


def describe_modes(found: ModeSet, most: int | None = None, width: int | None = None) -> str:
    """Return frequencies, damping and quality of the first `most` measured modes, as text."""
    from updyn.modal.level import describe_leaning
    from updyn.modal.unexplained import describe_unexplained

    rows = []
    for k in range(len(found)):
        row = [
            str(k + 1),
            f"{found.frequency[k]:.6g}",
            _format_known(found.std_frequency[k], ".2g"),
            _format_known(found.loss_factor[k], ".4g"),
            _format_known(found.std_loss_factor[k], ".2g"),
            "unit mass" if found.scaled[k] else "any",
            _format_known(found.phase_collinearity[k], ".3f"),
            _format_known(found.quality[k], ".4f"),
        ]
        rows.append(row)
    quality_columns = ("phase collinearity", "quality")
    header = ("mode", "frequency (Hz)", "std", "loss factor", "std", "scale", *quality_columns)
    texts = [
        f"Modes: {len(found)} from {found.frequency[0]:g} to {found.frequency[-1]:g} Hz",
        f"{len(found.dofs)} DOFs: {_format_dofs(found.dofs)}"
        if found.has_shapes
        else "without shapes",
        fit_columns(header, rows[:most], width, _OF_MODES),
    ]
    if most is not None and len(rows) > most:
        texts.append(f"... and {len(rows) - most} more (--verbose)")
    if len(found.unexplained):
        peaks = describe_unexplained(found.unexplained)
        texts.append(f"{peaks}; [modes] poles makes modes of them.")
    texts += filter(None, [describe_leaning(found)])
    return "\n".join(texts)


def _format_known(value: float, form: str) -> str:
    """Return a number as text; ``-`` for nan."""
    return "-" if np.isnan(value) else format(value, form)


def describe_geometry(geometry: Geometry) -> str:
    """Return the number of nodes and their bounding box, as text."""
    low, high = geometry.xyz.min(axis=0), geometry.xyz.max(axis=0)
    box = ", ".join(f"{a} {p:g} to {q:g}" for a, p, q in zip("XYZ", low, high, strict=True))
    return (
        f"Geometry: {len(geometry.nodes)} nodes, {len(geometry.lines)} lines to draw, in m: {box}"
    )


def describe_contents(found: Contents) -> str:
    """Return tables, matrices, geometry and modes of a file with several contents, as text."""
    program = f" of {found.program}" if found.program.strip("X") else ""
    texts = [f"OUTPUT2 file{program}: tables {', '.join(dict.fromkeys(found.tables)) or '-'}"]
    for name, (rows, columns) in found.matrices.items():
        texts.append(f"Matrix {name}: {rows} x {columns}")
    if found.element_blocks:
        texts.append(f"Matrices of elements, which are not read: {', '.join(found.element_blocks)}")
    if isinstance(found.geometry, Geometry):
        texts.append(describe_geometry(found.geometry))
    else:
        texts.append(f"No geometry: {found.geometry}")
    if isinstance(found.modes, str):
        texts.append(f"No modes: {found.modes}")
    else:
        texts.append(describe_modes(found.modes))
    return "\n".join(texts)


def describe_records(given: xarray.DataArray) -> str:
    """Return number, length and channels of time records, as text."""
    from updyn.signals.records import as_records

    records = as_records(given)
    n, _, samples = records.values.shape
    rows = []
    for at, (name, unit) in enumerate(zip(records.channels, records.units, strict=True)):
        values = records.values[:, at]
        rows.append([name, unit or "-", f"{values.min():.4g}", f"{values.max():.4g}"])
    texts = [
        f"Time records: {n}, of {samples} samples in {samples * records.step:g} s"
        f" ({1.0 / records.step:g} a second)",
        text_table(("channel", "unit", "lowest", "highest"), rows, left=(0, 1)),
    ]
    if records.source:
        texts.append(f"Source: {records.source}")
    return "\n".join(texts)


def describe_parameters(parameters: ParameterSet) -> str:
    """Return the unknowns with start, bounds and prior, as text."""
    rows = []
    for p in parameters:
        prior = "-" if p.prior_std is None else f"{p.prior_std:g}"
        rows.append([p.name, f"{p.start:g}", f"{p.lower:g}", f"{p.upper:g}", prior])
    return text_table(("unknown", "start", "lower", "upper", "prior std"), rows)


def describe_identifiability(found: Identifiability) -> str:
    """Return rank, condition, undetermined combinations and advice, as text."""
    texts = [
        f"The data determine {found.rank} of {found.n_parameters} unknowns (condition"
        f" {found.condition:.3g}, collinearity index {found.collinearity:.3g})."
    ]
    texts += found.describe_combinations()
    if found.advice:
        texts.append(found.advice)
    return "\n".join(texts)


def _format_dofs(dofs: DofSet) -> str:
    """Return the first DOFs, and the last of more, as text."""
    text = ", ".join(dofs[: DESCRIPTION.listed_items].labels)
    if len(dofs) > DESCRIPTION.listed_items:
        text += f", ... {dofs[-1]}"
    return text


def _count_dofs(group: Group) -> int:
    used = []
    for matrix in (group.stiffness, group.mass, group.viscous):
        if matrix is not None:
            used.append(matrix.indices[matrix.data != 0.0])
    return len(np.unique(np.concatenate(used)))


def _rigid_mass(mass: Matrix | None, dofs: DofSet, translations: RealArray) -> str:
    """Return the largest mass in rigid translation, or inertia about an axis, as text."""
    if mass is None:
        return "-"
    translation = float(np.diag(translations.T @ (mass @ translations)).max())
    if translation > 0:
        return f"{translation:.4g} kg"
    turned = np.stack([dofs.axes == axis for axis in range(3, 6)], axis=1).astype(np.float64)
    return f"{float(np.diag(turned.T @ (mass @ turned)).max()):.4g} kg m2"


def _rigid_translations(model: Model) -> RealArray:
    """Return the unit translations of the whole structure along X, Y, Z, shape (N, 3)."""
    # A DOF of a node without position is a generalised displacement and does not move;
    # displacements are along the directions of their node, if the geometry states them.
    dofs, geometry = model.dofs, model.geometry
    axes = dofs.axes.astype(np.intp)
    translations = np.vstack([np.eye(3), np.zeros((3, 3))])[axes]
    placed = _find_placed(model)
    translations[~placed] = 0.0
    if geometry is not None and geometry.axes is not None:
        turned = np.flatnonzero(placed & (axes < 3))
        order = np.argsort(geometry.nodes)
        at = order[np.searchsorted(geometry.nodes, dofs.nodes[turned], sorter=order)]
        translations[turned] = geometry.axes[at, axes[turned]]
    return translations


def _find_placed(model: Model) -> BoolArray:
    """Return which DOFs are at nodes with a position, shape (N,); all if no node has one."""
    nodes = model.dofs.nodes
    if model.geometry is None:
        return np.ones(len(nodes), dtype=bool)
    found = np.isin(nodes, model.geometry.nodes)
    return found if found.any() else ~found


def _format_largest(matrix: Matrix | None) -> str:
    """Return the largest diagonal entry as text."""
    return "-" if matrix is None else f"{matrix.diagonal().max():.4g}"


def _natural_frequencies(model: Model) -> str:
    """Return the first natural frequencies as text, or the reason why they are not available."""
    if model.n_dofs > DESCRIPTION.most_mode_dofs:
        most = DESCRIPTION.most_mode_dofs
        return f"Natural frequencies: not computed for more than {most} DOFs; see updyn.modes"
    try:
        found = modes(model, min(DESCRIPTION.natural_frequencies, model.n_dofs))
    except (ModelError, SolverError) as error:
        return f"Natural frequencies: {error}"
    return "Natural frequencies (Hz): " + ", ".join(f"{f:.5g}" for f in found.frequency)
