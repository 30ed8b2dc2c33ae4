"""Tests of an update: model and measurement of each, validation data, measurements with gaps."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, IndexArray, NumberArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.dynamics.excitation import find_excitation
from updyn.dynamics.zero_line import leave_out_zero_line
from updyn.errors import DataError, OptionError, ParameterError, UpdynWarning
from updyn.frf import FRF, check_lines
from updyn.geometry import Geometry
from updyn.group import GROUP_QUANTITIES, Matrix, is_number
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.nonlinear.parameters import list_parameters
from updyn.updating.problem.channels import check_channel
from updyn.updating.problem.lines import Lines
from updyn.updating.problem.parameters import Drive, ParameterSet

__all__ = [
    "ModalSplit",
    "Split",
    "Test",
    "check_measured",
    "check_tests",
    "complete_parts",
    "leave_out_undefined_line",
    "list_validation",
    "name_tests",
    "split_data",
    "split_modes",
]


#: Cosine of the smallest angle between sensor and DOF for a warning, 1 degree.
_ALONG = float(np.cos(np.radians(1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Test:
    """One test: the structure in one configuration, and its measurement.

    Parameters
    ----------
    model : Model
        The model of that configuration. Groups are identified by their names.
    data : FRF or ModeSet
        The measurement. FRFs and modes of one configuration are two tests of the same model.
    name : str
        Name of the test.
    lines, noise, validation
        As for `updyn.update`; modes have no lines.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> test = updyn.Test(chain.build(), chain.measure(), name="free")
    >>> test.name
    'free'
    """

    __test__ = False  # keeps pytest from collecting the class

    model: Model
    data: FRF | ModeSet
    name: str = ""
    lines: Lines = None
    noise: Mapping[str, float | str] | str | None = None
    validation: Iterable[str | Dof] | tuple[float, float] | None = None

    @property
    def frf(self) -> FRF:
        """The measured FRFs.

        Raises
        ------
        OptionError
            If the test measured modes.
        """
        if isinstance(self.data, FRF):
            return self.data
        named = f"test {self.name!r}" if self.name else "the test"
        raise OptionError(f"{named} measured modes; this takes FRFs")


def name_tests(tests: Iterable[Test], caller: str, noun: str, *, least: int = 1) -> dict[str, Test]:
    """Return at least `least` tests by name; those without a name are `noun` and their number.

    Raises OptionError, with the name of the `caller`, for fewer tests or equal names.
    """
    listed = list(tests) if isinstance(tests, Iterable) else []
    if len(listed) < least or not all(isinstance(test, Test) for test in listed):
        count = {1: "one", 2: "two"}.get(least, str(least))
        raise OptionError(f"{caller}: expected a sequence of at least {count} Test")
    named: dict[str, Test] = {}
    for number, test in enumerate(listed, 1):
        name = test.name or f"{noun} {number}"
        if name in named:
            raise OptionError(f"{caller}: two tests are called {name!r}")
        named[name] = replace(test, name=name)
    return named


def check_tests(tests: Sequence[Test], parameters: ParameterSet) -> None:
    """Raise if tests and unknowns do not fit together; warn of unknowns without effect."""
    for test in tests:
        _check_type(test.model, Model)
        _check_type(test.data, FRF, ModeSet)
    _check_type(parameters, ParameterSet)
    data = [test.data for test in tests if isinstance(test.data, FRF)]
    for p in parameters:
        for d in p.acts_on:
            if p.is_channel:
                check_channel(d.group, d.quantity, data, p.name)
            elif not any(has_quantity(test.model, d.group, d.quantity) for test in tests):
                if d.of_element:
                    raise ParameterError(
                        f"unknown {p.name!r}: this model has no nonlinear element {d.group!r} with"
                        f" the parameter {d.quantity!r}"
                    )
                tests[0].model.group(d.group)  # names the nearest group if it is missing
                raise ParameterError(
                    f"unknown {p.name!r}: group {d.group!r} has no {d.quantity} in this model"
                )
    for test in tests:
        if isinstance(test.data, ModeSet):
            test.model.dofs.match(test.data.dofs, "DOF of the modes")
            _check_without_lines(test)
        else:
            test.model.dofs.match(test.data.responses, "response")
            test.model.dofs.match(test.data.references, "reference")
            find_excitation(test.model.dofs, test.data)
            check_measured(test.data, test.name)
            _warn_of_no_mass(test.model, test.data, test.name)
            _warn_of_axes(test.model, test.data)
    _warn_of_ineffective(tests, parameters)


def leave_out_undefined_line(test: Test) -> Test:
    """Return a checked test without the line at 0 Hz, with a warning, if its model is free."""
    if isinstance(test.data, ModeSet):
        return test
    frf, lines = leave_out_zero_line(test.model, test.data, test.name), test.lines
    if frf is test.data:
        return test
    if isinstance(lines, Iterable) and not isinstance(lines, str) and np.ndim(lines) == 1:
        lines = np.array([line for line in lines if line != 0.0])
    return replace(test, data=frf, lines=lines)


def check_measured(frf: FRF, name: str = "") -> None:
    """Raise if all values to be fitted are zero."""
    if not frf.values.any():
        raise DataError(
            f"{_test_prefix(name)}all values to be fitted are zero: nothing was measured"
        )


def _warn_of_no_mass(model: Model, frf: FRF, name: str) -> None:
    """Warn of a model without mass if the data extend above 0 Hz."""
    if frf.freq[-1] > 0.0 and not any(_is_nonzero(group.mass) for group in model.groups.values()):
        text = (
            f"{_test_prefix(name)}the model has no mass: all mass matrices are zero, so that its"
            f" response up to the {frf.freq[-1]:g} Hz of the data is that of springs and dampers"
        )
        warnings.warn(text, UpdynWarning, stacklevel=4)


def _test_prefix(name: str) -> str:
    return f"test {name!r}: " if name else ""


def _is_nonzero(matrix: Matrix | None) -> bool:
    return matrix is not None and bool(matrix.data.any())


def _warn_of_ineffective(tests: Sequence[Test], parameters: ParameterSet) -> None:
    """Warn of unknowns of the model without effect, because all their matrices are zero."""
    for p in parameters:
        if (
            p.is_channel
            or p.of_element
            or any(_has_effect(test.model, d) for test in tests for d in p.acts_on)
        ):
            continue
        what = GROUP_QUANTITIES[p.acts_on[0].quantity]
        groups = ", ".join(dict.fromkeys(repr(d.group) for d in p.acts_on))
        text = (
            f"unknown {p.name!r} changes nothing: the {what} of group {groups} is zero; give the"
            " group its matrix, or leave the unknown out"
        )
        warnings.warn(text, UpdynWarning, stacklevel=4)


def _has_effect(model: Model, drive: Drive) -> bool:
    """Return whether the model has a matrix other than zero that a drive acts on."""
    group = model.groups.get(drive.group)
    return group is not None and _is_nonzero(getattr(group, GROUP_QUANTITIES[drive.quantity]))


def _check_type(given: object, *kinds: type) -> None:
    if not isinstance(given, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise OptionError(f"expected a {names}, found {type(given).__name__}")


def _check_without_lines(test: Test) -> None:
    if test.lines is not None:
        raise OptionError("lines: modes have none; leave it out", key=("lines",))


def _warn_of_axes(model: Model, frf: FRF) -> None:
    """Warn of a sensor or force that does not point along its DOF in the model."""
    placed = frf.geometry
    if placed is None or placed.axes is None:
        return
    modelled = model.geometry
    for dof in dict.fromkeys([*frf.responses, *frf.references]):
        measured_axes = _axes_at(placed, dof.node)
        if measured_axes is None:
            continue
        model_axes = _axes_at(modelled, dof.node)
        if model_axes is None:
            model_axes = np.eye(3)
        axis = DIRECTIONS.index(dof.direction) % 3
        cosine = float(measured_axes[axis] @ model_axes[axis])
        if cosine < _ALONG:
            angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            text = (
                f"{dof} points {angle:.3g} degrees away from the model's direction;"
                " `updyn.match` uses the measured direction"
            )
            warnings.warn(text, UpdynWarning, stacklevel=4)
            return


def _axes_at(geometry: Geometry | None, node: int) -> RealArray | None:
    """Return the axes of a node, shape (3, 3), or None if the geometry does not state them."""
    if geometry is None or geometry.axes is None:
        return None
    at = np.flatnonzero(geometry.nodes == node)
    if not at.size:
        return None
    return np.asarray(geometry.axes[at[0]])


def has_quantity(model: Model, group: str, quantity: str) -> bool:
    """Return whether a model has a group with a quantity, or an element with a parameter."""
    if group in model.nonlinear:
        return quantity in list_parameters(model.nonlinear[group].element)
    return group in model.groups and model.groups[group].has(quantity)


@dataclass(frozen=True, slots=True)
class Split:
    """Fitted data and validation data of one test: whole `responses` and a `band` in Hz."""

    whole: FRF
    fitted: FRF
    responses: tuple[str, ...] = ()
    band: tuple[float, float] | None = None
    held: FRF | None = None


def split_data(frf: FRF, validation: Iterable[str | Dof] | tuple[float, float] | None) -> Split:
    """Split data into fitted data and validation data (responses, or a band in Hz)."""
    given = list_validation(validation)
    if not given:
        return Split(frf, frf)
    if all(map(is_number, given)):
        if len(given) != 2:
            raise DataError(
                f"validation {given!r}: expected two frequencies in Hz, or response labels"
            )
        low, high = float(given[0]), float(given[1])
        held = frf.select(band=(low, high))
        fitted_lines = frf.freq[(frf.freq < low) | (frf.freq > high)]
        if fitted_lines.size == 0:
            raise DataError(
                f"validation band {low:g} to {high:g} Hz holds all lines: nothing is left to fit"
            )
        return Split(frf, frf.select(lines=fitted_lines), band=(low, high), held=held)
    chosen = DofSet(given)
    at = np.sort(frf.responses.match(chosen, "validation response").index)
    rest = np.setdiff1d(np.arange(len(frf.responses)), at)
    if rest.size == 0:
        raise DataError("validation holds out all responses: nothing is left to fit")
    held_set, fitted_set = frf.responses[at], frf.responses[rest]
    return Split(
        frf,
        frf.select(responses=fitted_set),
        tuple(held_set.labels),
        held=frf.select(responses=held_set),
    )


def list_validation(validation: object) -> list[Any]:
    """Return the validation labels, or the two limits of the band, as a list."""
    if validation is None:
        return []
    if isinstance(validation, str) or not isinstance(validation, Iterable):
        raise DataError(
            f"validation {validation!r}: expected two frequencies in Hz, or response labels, in a"
            " list"
        )
    return list(validation)


@dataclass(frozen=True, slots=True)
class ModalSplit:
    """Fitted modes and validation modes of one test; the validation `band` is in Hz."""

    whole: ModeSet
    fitted: ModeSet
    band: tuple[float, float] | None = None
    held: ModeSet | None = None


def split_modes(
    modes: ModeSet, validation: Iterable[str | Dof] | tuple[float, float] | None
) -> ModalSplit:
    """Split modes into fitted modes and those of a validation band in Hz."""
    given = list_validation(validation)
    if not given:
        return ModalSplit(modes, modes)
    if len(given) != 2 or not all(map(is_number, given)):
        raise DataError(f"validation {given!r}: of modes, a band of two frequencies in Hz")
    low, high = float(given[0]), float(given[1])
    inside = (modes.frequency >= low) & (modes.frequency <= high)
    if inside.all() or not inside.any():
        where = "outside" if inside.all() else "in"
        raise DataError(f"validation band {low:g} to {high:g} Hz: no measured mode lies {where} it")
    rest = modes.select(np.flatnonzero(~inside).tolist())
    held = modes.select(np.flatnonzero(inside).tolist())
    return ModalSplit(modes, rest, (low, high), held)


def complete_parts(
    freq: ArrayLike,
    values: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str,
    coherence: ArrayLike | None = None,
    variance: ArrayLike | None = None,
    averages: int | None = None,
    geometry: Geometry | None = None,
    source: str = "",
) -> tuple[FRF, ...]:
    """Cut data with missing values into complete FRFs.

    A sensor that dropped out over some lines, or was not mounted for one of the forces, leaves
    gaps, which an `FRF` cannot have. The measured values are cut into rectangles of lines,
    responses and references; pairs of response and reference with the same lines are joined. Every
    measured value is in exactly one rectangle. Fit the result as tests of one structure
    (`updyn.update_jointly`).

    Parameters
    ----------
    freq : array_like of float, shape (n_f,)
        Lines in Hz.
    values : array_like of complex, shape (n_f, n_responses, n_references)
        As for `updyn.FRF`, but not-a-number, or masked, for values that are missing or not to be
        used.
    responses, references, quantity
        As for `updyn.FRF`.
    coherence, variance : array_like of float, shape of `values`, optional
        As for `updyn.FRF`. They are required for all measured values, and ignored elsewhere.
    averages, geometry, source
        As for `updyn.FRF`.

    Returns
    -------
    tuple of FRF
        The FRFs, the largest first; a single one if there is no gap. Their source states the number
        of missing values.

    Raises
    ------
    DataError
        If all values are missing, a value is infinite, or other data than values are missing.
    DofError
        If a label cannot be read or occurs twice.

    Examples
    --------
    >>> import numpy as np
    >>> values = np.ones((3, 2, 1), dtype=complex)
    >>> values[:, 1, 0] = np.nan  # the second sensor had failed
    >>> freq, sensors = [1.0, 2.0, 3.0], ["1:Z", "2:Z"]
    >>> (frf,) = updyn.complete_parts(freq, values, sensors, ["1:Z"], "accelerance")
    >>> frf.responses.labels
    ['1:Z']
    """
    lines, rows, columns = check_lines(freq), DofSet(responses), DofSet(references)
    masked: Any = np.ma.asarray(values)
    if masked.dtype.kind not in "iufc":
        raise DataError(f"values: expected complex or real numbers, found {masked.dtype}")
    array = np.ma.filled(masked.astype(np.complex128), np.nan)
    shape = (len(lines), len(rows), len(columns))
    if array.shape != shape:
        raise DataError(
            f"values: expected shape (lines, responses, references) = {shape}, found {array.shape}"
        )
    infinite = np.argwhere(np.isinf(array))
    if len(infinite):
        i, j, k = infinite[0]
        raise DataError(
            f"values at {lines[i]:g} Hz, response {rows[j]}, reference {columns[k]} is infinite;"
            " what is missing is not-a-number"
        )
    is_measured = ~np.isnan(array)
    if not is_measured.any():
        raise DataError("values: all are missing")
    if not is_measured.all():
        source = f"{source}; {_describe_missing(is_measured)}".removeprefix("; ")
    quality: dict[str, NumberArray] = {}
    for name, given in (("coherence", coherence), ("variance", variance)):
        if given is None:
            continue
        quality[name] = np.ma.asanyarray(given)  # masks are kept, and refused at existing values
        if quality[name].shape != shape:
            raise DataError(
                f"{name}: expected shape (lines, responses, references) = {shape}, found"
                f" {quality[name].shape}"
            )
    parts = []
    for at in _find_rectangles(is_measured):
        block = np.ix_(*at)
        quality_of_part: dict[str, Any] = {name: table[block] for name, table in quality.items()}
        frf = FRF(
            lines[at[0]],
            array[block],
            rows[at[1]],
            columns[at[2]],
            quantity,
            averages=averages,
            geometry=geometry,
            source=source,
            **quality_of_part,
        )
        parts.append(frf)
    parts.sort(key=lambda frf: -frf.values.size)  # stable sort
    return tuple(parts)


def _find_rectangles(is_measured: BoolArray) -> list[tuple[IndexArray, ...]]:
    """Return lines, responses and references of rectangles that cover each True once."""
    by_lines: dict[bytes, dict[int, list[int]]] = {}
    for j, k in np.ndindex(is_measured.shape[1:]):
        if is_measured[:, j, k].any():
            by_lines.setdefault(is_measured[:, j, k].tobytes(), {}).setdefault(j, []).append(k)
    out: list[tuple[IndexArray, ...]] = []
    for lines, pairs in by_lines.items():
        by_references: dict[tuple[int, ...], list[int]] = {}
        for j, ks in pairs.items():
            by_references.setdefault(tuple(ks), []).append(j)
        at = np.flatnonzero(np.frombuffer(lines, dtype=bool))
        for references, responses in by_references.items():
            out.append((at, np.array(responses), np.array(references)))
    return out


def _describe_missing(is_measured: BoolArray) -> str:
    """Return the missing values as text: ``1 of 42 channels misses 17 of 400 lines``."""
    missing = (~is_measured).sum(axis=0).ravel()
    n_channels = int((missing > 0).sum())
    counts = np.unique(missing[missing > 0])
    n_lines = f"{counts[0]}"
    if len(counts) > 1:
        n_lines += f" to {counts[-1]}"
    verb = "misses" if n_channels == 1 else "miss"
    return f"{n_channels} of {missing.size} channels {verb} {n_lines} of {len(is_measured)} lines"
