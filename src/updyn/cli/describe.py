"""What models, measurements and results hold, as plain text. Reads numbers out; computes no more than a sum."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from updyn.dofs import DofSet
from updyn.errors import ModelError, SolverError
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.modal import ModeSet
from updyn.model import Group, Matrix, Model
from updyn.text_table import text_table
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import ParameterSet

__all__ = [
    "describe_frf",
    "describe_geometry",
    "describe_identifiability",
    "describe_model",
    "describe_modes",
    "describe_parameters",
]

_MODES_UP_TO = 20_000  # DOFs: natural frequencies of larger models are not asked for in passing
_MODES = 8
_LABELS = 12


def describe_model(model: Model) -> str:
    """Return DOFs, groups and the first natural frequencies of a model, as text."""
    directions = [
        d
        for d in ("X", "Y", "Z", "RX", "RY", "RZ")
        if d in {x.direction for x in _sample(model.dofs)}
    ]
    rows = [
        [
            name,
            str(_used(group)),
            _rigid_mass(group.mass, model.dofs),
            _largest(group.stiffness),
            f"{group.loss_factor:g}" if group.stiffness is not None else "-",
            _largest(group.viscous),
        ]
        for name, group in model.groups.items()
    ]
    header = ("group", "DOFs", "mass", "max stiffness", "loss factor", "max viscous")
    return "\n".join(
        [
            (
                f"Model{f' {model.title!r}' if model.title else ''}: {model.n_dofs} DOFs,"
                f" {len(model.groups)} groups, directions {' '.join(directions)}"
            ),
            f"DOFs: {_labels(model.dofs)}",
            describe_geometry(model.geometry) if model.geometry is not None else "No geometry.",
            "",
            text_table(header, rows),
            *(
                f"{name}: {group.damping_words}"
                for name, group in model.groups.items()
                if len(group.damping) > 1
            ),
            (
                "mass: in rigid translation (kg), else about the axis (kg m2); stiffness, viscous:"
                " largest diagonal entry"
            ),
            "",
            _natural_frequencies(model),
        ]
    )


def describe_frf(frf: FRF) -> str:
    """Return lines, DOFs, quantity and confidence of a measurement, as text."""
    steps = np.diff(frf.freq)
    even = len(steps) > 0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0)
    spacing = (
        f", every {steps[0]:g} Hz"
        if even
        else f", {steps.min():g} to {steps.max():g} Hz apart"
        if len(steps)
        else ""
    )
    size = np.abs(frf.values)
    lines = [
        (
            f"FRF: {frf.quantity}, {len(frf.freq)} lines from {frf.freq[0]:g} to {frf.freq[-1]:g}"
            f" Hz{spacing}"
        ),
        f"{len(frf.responses)} responses: {_labels(frf.responses)}",
        f"{len(frf.references)} references: {_labels(frf.references)}",
        f"|H| from {size.min():.3g} to {size.max():.3g}",
    ]
    if frf.coherence is not None:
        lines.append(
            f"coherence: median {np.median(frf.coherence):.3f}, lowest {frf.coherence.min():.3f}"
        )
    else:
        lines.append("no coherence")
    if frf.variance is not None:
        lines.append("with the variance of each value")
    if frf.averages is not None:
        lines.append(f"{frf.averages} averages")
    if frf.geometry is not None:
        lines.append(describe_geometry(frf.geometry))
    return "\n".join(lines)


def describe_modes(modes: ModeSet) -> str:
    """Return frequencies, damping and quality of measured modes, as text."""
    rows = [
        [
            str(number),
            f"{modes.frequency[k]:.6g}",
            "-" if np.isnan(modes.loss_factor[k]) else f"{modes.loss_factor[k]:.4g}",
            "unit mass" if modes.scaled[k] else "any",
            f"{modes.phase_collinearity[k]:.3f}",
            "-" if np.isnan(modes.quality[k]) else f"{modes.quality[k]:.4f}",
        ]
        for number, k in enumerate(range(len(modes)), 1)
    ]
    return "\n".join(
        [
            f"Modes: {len(modes)} from {modes.frequency[0]:g} to {modes.frequency[-1]:g} Hz",
            f"{len(modes.dofs)} DOFs: {_labels(modes.dofs)}",
            text_table(
                ("mode", "frequency (Hz)", "loss factor", "scale", "phase collinearity", "quality"),
                rows,
            ),
        ]
    )


def describe_geometry(geometry: Geometry) -> str:
    """Return the number of nodes and the box around them, as text."""
    low, high = geometry.xyz.min(axis=0), geometry.xyz.max(axis=0)
    box = ", ".join(f"{a} {p:g} to {q:g}" for a, p, q in zip("XYZ", low, high, strict=True))
    return (
        f"Geometry: {len(geometry.nodes)} nodes, {len(geometry.lines)} lines to draw, in m: {box}"
    )


def describe_parameters(parameters: ParameterSet) -> str:
    """Return the unknowns with start, bounds and prior, as text."""
    rows = [
        [
            p.name,
            f"{p.start:g}",
            f"{p.lower:g}",
            f"{p.upper:g}",
            "-" if p.prior_std is None else f"{p.prior_std:g}",
        ]
        for p in parameters
    ]
    return text_table(("unknown", "start", "lower", "upper", "prior std"), rows)


def describe_identifiability(found: Identifiability) -> str:
    """Return rank, condition, the combinations that stay open and the advice, as text."""
    lines = [
        f"The data determine {found.rank} of {found.n_parameters} unknowns (condition"
        f" {found.condition:.3g}, collinearity index {found.collinearity:.3g})."
    ]
    for what, directions in (
        ("undetermined combination", found.null_directions),
        ("of these, determined", found.determined_directions),
    ):
        lines += [f"  {what} {number}: {_weights(d)}" for number, d in enumerate(directions, 1)]
    return "\n".join([*lines, found.advice] if found.advice else lines)


def _weights(direction: Mapping[str, float]) -> str:
    return ", ".join(
        f"{w:+.3g} {n}" for n, w in sorted(direction.items(), key=lambda t: -abs(t[1]))
    )


def _labels(dofs: DofSet) -> str:
    return ", ".join(dofs[:_LABELS].labels) + (f", ... {dofs[-1]}" if len(dofs) > _LABELS else "")


def _sample(dofs: DofSet) -> DofSet:
    """Return one DOF of each direction."""
    return dofs[np.unique(dofs.axes, return_index=True)[1]]


def _used(group: Group) -> int:
    """Return on how many DOFs a group acts."""
    used = [
        m.indices[m.data != 0.0]
        for m in (group.stiffness, group.mass, group.viscous)
        if m is not None
    ]
    return len(np.unique(np.concatenate(used)))


def _rigid_mass(mass: Matrix | None, dofs: DofSet) -> str:
    if mass is None:
        return "-"
    energies = []
    for axis in range(6):
        rigid = (dofs.axes == axis).astype(np.float64)
        energies.append(float(rigid @ (mass @ rigid)))
    along, about = max(energies[:3]), max(energies[3:])
    return f"{along:.4g} kg" if along > 0 else f"{about:.4g} kg m2"


def _largest(matrix: Matrix | None) -> str:
    return "-" if matrix is None else f"{matrix.diagonal().max():.4g}"


def _natural_frequencies(model: Model) -> str:
    if model.n_dofs > _MODES_UP_TO:
        return (
            f"Natural frequencies: not computed for more than {_MODES_UP_TO} DOFs; see updyn.modes"
        )
    from updyn.dynamics.modes import modes

    try:
        found = modes(model, min(_MODES, model.n_dofs))
    except (ModelError, SolverError) as error:
        return f"Natural frequencies: {error}"
    return "Natural frequencies (Hz): " + ", ".join(f"{f:.5g}" for f in found.frequency)
