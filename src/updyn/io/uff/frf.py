"""FRFs of universal files: functions of dataset 58, text or binary, as a complete matrix.

What is read, and how:

- Function type 4 is an FRF, type 6 the coherence of the same pair of DOFs (taken as gamma^2). Other
  functions (time responses, spectra, multiple coherence) are left out with a warning that counts
  them. Datasets of other numbers are normal in such files; they are named in ``FRF.source``.
- The quantity follows from the data types of records 9 and 10. Where they say "unknown",
  ``quantity=`` has to.
- Direction codes +-1 to +-6 are X Y Z RX RY RZ with their sign. Code 0, a scalar, says no
  direction: either ``scalar_direction=`` gives one, or the file is refused.
- If a pair of DOFs is there with one sense and another pair with the opposite one (5:Z and 5:-Z),
  the sense met first is taken and the values of the other change sign.
- Every pair of response and reference has to be there, on the same lines. Nothing is interpolated
  or filled in.
- Values are converted to SI by the unit labels of records 9 and 10, by dataset 164 without a label,
  or by ``scale=``: `updyn.io.uff.labels`.
- Real ordinates are refused, as magnitudes and decibels are no FRFs, unless ``real_valued=True``
  states that their phase is 0 or pi.
- With a geometry in the file, its nodes must include those of the FRFs. Directions of a node with a
  displacement system of its own are expressed in the global one, where they coincide with its axes
  to 1e-6; oblique ones are refused. The geometry of the FRF therefore has no ``axes``;
  `read_geometry` gives them. ``local_axes=True`` keeps labels and ``axes`` as the file has them,
  for `updyn.match`.

The files are taken apart here and not by pyuff, which the tests use as a second opinion
(`tests/io/test_pyuff.py` holds what follows). Of deviations that real files have, pyuff 2.5.8

- cuts the exponents off numbers in fields of 14 columns, one a line, so that -2.5E-01 is read as
  -2.5, without a word;
- drops every function after a dataset with a line of text that ends in "-1", without a word;
- ends the data of a 58b at bytes that look like a delimiter, and returns what is before them,
  without a word;
- raises "Error when reading data-set(s)" for fields of 14 columns, six a line, for exponents with
  D, and for numbers separated by blanks.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import AbsentError, FormatError, InputError, OptionError, UpdynWarning, key_path
from updyn.frf import FRF, check_quantity
from updyn.geometry import Geometry
from updyn.io.items import chosen, counted, placed
from updyn.io.lengths import length
from updyn.io.uff.datasets import datasets
from updyn.io.uff.functions import Function, read_function
from updyn.io.uff.geometry import NUMBERS, Collector, Units
from updyn.io.uff.labels import FORCE, MOTION, UNKNOWN, abscissa_factor, frf_factor, type_name

__all__ = [
    "Directions",
    "Parts",
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
    """Read the FRFs of a universal file.

    Parameters
    ----------
    path : path
        The file.
    quantity : {"receptance", "mobility", "accelerance"}, optional
        What was measured, where the file does not say; a contradiction is an error.
    duplicates : {"raise", "average"}
        Several functions at one pair of DOFs: an error, or their mean, weighted with their
        coherence where every one has it; the coherence is then the plain mean.
    responses, references : iterable of str or Dof, optional
        DOFs to read, in the order given and with a sense if wanted ("5:-Z"); all others are left
        out, and need not be complete.
    scalar_direction : str, optional
        What direction code 0 stands for, for instance "Z" or "-RX".
    scale : float, optional
        Factor that converts the values of the file to SI. It replaces dataset 164 and the unit
        labels of records 9 and 10.
    real_valued : bool
        The values are real: their phase is 0 or pi. Without it real ordinates are an error, as they
        may be magnitudes or decibels; with it values that have an imaginary part are one.
    local_axes : bool
        Keep the directions of nodes with a displacement system of their own, as ``axes`` of the
        geometry: then `updyn.match` has to be told of the measurement before anything else uses it.

    Returns
    -------
    FRF
        Values in SI, DOFs in the order of the file, with the geometry where there is one.

    Raises
    ------
    FormatError
        If the file is damaged, does not say what it has to, contradicts itself or an argument, or a
        pair is missing.
    OptionError
        If an option has no valid value.
    """
    scalar = _options(duplicates, scalar_direction, scale)
    for name, given in (("local_axes", local_axes), ("real_valued", real_valued)):
        if not isinstance(given, bool):
            raise OptionError(f"{name} {given!r}: expected True or False", key=(name,))
    collector = Collector(path)
    functions: list[Function] = []
    others = Counter[int]()
    for dataset in datasets(path):
        if dataset.number == 58:
            functions.append(read_function(dataset, path))
        elif dataset.number in NUMBERS:
            collector.take(dataset)
        else:
            others[dataset.number] += 1
    measured = [f for f in functions if f.kind == _FRF]
    coherences = [f for f in functions if f.kind == _COHERENCE]
    if not measured:
        raise AbsentError(_nothing(functions, collector, others), path)
    _warn_of_others(functions, path)
    found = _quantity(measured, quantity, path)
    measured = [_in_hertz(f, path) for f in measured]
    coherences = [_in_hertz(f, path) for f in coherences]
    for function in measured:
        _check_values(function, real_valued, path)
    geometry = collector.geometry()

    def factor(function: Function, response: Dof, reference: Dof) -> float:
        if scale is not None:
            return scale
        turns = _turns(response), _turns(reference)
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
    with placed(path):
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
    """Read nodes, their directions and trace lines of a universal file.

    Parameters
    ----------
    path : path
        The file.
    unit : {"m", "cm", "mm", "in", "ft"}, optional
        Unit of length, where the file has no dataset 164, by default m; a contradiction is an
        error.

    Returns
    -------
    Geometry
        Positions in m in the global system; ``axes`` where a node has a displacement system of its
        own.

    Raises
    ------
    FormatError
        If the file is damaged or holds no nodes, or its dataset 164 says another unit.
    OptionError
        If the unit is not known.
    """
    stated = None if unit is None else length(unit)
    collector = Collector(path)
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
    """Return the units with the stated one of length (m), which is not to contradict the file."""
    if not units.line:
        return Units(1.0 / stated, units.force)
    if not np.isclose(units.length * stated, 1.0, rtol=1e-3, atol=0.0):
        raise FormatError(
            f"unit {unit!r} contradicts dataset 164, by which a metre is {units.length:g} units of"
            " length of the file",
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
            f"scalar_direction={scalar_direction!r}: expected one of X Y Z RX RY RZ, with a sign if"
            " wanted",
            key=("scalar_direction",),
        )
    return Dof(0, found[2], -1 if found[1] == "-" else 1)


# -- what the functions are ---------------------------------------------------------------------
def _quantity(measured: Sequence[Function], given: str | None, path: str | Path) -> str:
    if given is not None:
        with placed(path), key_path("quantity"):
            check_quantity(given)
    said: dict[str, int] = {}
    for function in measured:
        name = _one_quantity(function, path)
        if name is not None:
            said.setdefault(name, function.line)
    if len(said) > 1:
        (a, first), (b, second) = list(said.items())[:2]
        raise FormatError(
            f"holds {a} (dataset 58 on line {first}) and {b} (line {second}); expected one"
            " quantity",
            path,
        )
    if given is not None and said and given not in said:
        raise FormatError(
            f"quantity {given!r} contradicts the file, which says {next(iter(said))!r}",
            path,
            key=("quantity",),
        )
    if given is not None:
        return given
    for function in measured:
        if _one_quantity(function, path) is None:
            above, below = function.numerator, function.denominator
            raise FormatError(
                f"records 9 and 10 do not say what was measured (data types {above.kind} over"
                f" {below.kind}; expected 8, 11 or 12 over 13): give quantity='receptance',"
                " 'mobility' or 'accelerance'",
                path,
                above.line,
            )
    return next(iter(said))


def _one_quantity(function: Function, path: str | Path) -> str | None:
    """Return what records 9 and 10 say; None where one of them leaves it open."""
    above, below = function.numerator.kind, function.denominator.kind
    line = function.numerator.line
    if above in FORCE and below in MOTION:
        try:
            check_quantity(_INVERSE[MOTION[below]])
        except ValueError as error:
            raise FormatError(str(error), path, line) from error
    if above not in (*MOTION, *UNKNOWN) or below not in (*FORCE, *UNKNOWN):
        raise FormatError(
            f"records 9 and 10 say {type_name(above)} over {type_name(below)}; expected a"
            " displacement, velocity or acceleration over a force",
            path,
            line,
        )
    if above in MOTION and below in FORCE:
        return MOTION[above]
    return None


def _in_hertz(function: Function, path: str | Path) -> Function:
    return replace(function, unit_of_x=abscissa_factor(function.abscissa, "frequency", path))


def _check_values(function: Function, real_valued: bool, path: str | Path) -> None:
    """Refuse real ordinates that are not stated to be FRFs, and complex ones that are not real."""
    if not function.is_complex and not real_valued:
        raise FormatError(
            "holds real ordinates, and magnitudes and decibels are no FRFs; expected complex ones."
            " If the values are real because their phase is 0 or pi, state real_valued=True",
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


def _turns(dof: Dof) -> bool:
    return dof.direction.startswith("R")


# -- what else was there ------------------------------------------------------------------------
def _nothing(functions: Sequence[Function], collector: Collector, others: Counter[int]) -> str:
    held = []
    if functions:
        held.append(counted(Counter(f.name for f in functions)))
    if collector.nodes:
        held.append(f"a geometry of {len(collector.nodes)} nodes (see updyn.io.read_geometry)")
    if others:
        held.append(_datasets(others))
    return (
        "holds no frequency response function (dataset 58, function type 4); it holds"
        f" {', '.join(held) or 'nothing'}"
    )


def _datasets(others: Counter[int]) -> str:
    """Return the datasets of other numbers, for a message."""
    shown = []
    for number, times in sorted(others.items()):
        often = f" ({times} times)" if times > 1 else ""
        shown.append(f"dataset {number}{often}")
    return ", ".join(shown) or "nothing"


def _warn_of_others(functions: Sequence[Function], path: str | Path) -> None:
    left_out = [f for f in functions if f.kind not in (_FRF, _COHERENCE)]
    if left_out:
        kinds = counted(Counter(f.name for f in left_out))
        warnings.warn(
            f"{path}: functions that are neither FRF nor coherence are left out: {kinds} (first:"
            f" line {left_out[0].line})",
            UpdynWarning,
            stacklevel=3,
        )


def _source(path: str | Path, first: Function, others: Counter[int]) -> str:
    source = Path(path).name
    if first.title and first.title.upper() != "NONE":
        source += f", {first.title}"
    if others:
        source += f"; not read: {_datasets(others)}"
    return source


_Pair = tuple[tuple[int, str], tuple[int, str]]
_PARALLEL = 1e-6


class Directions:
    """DOFs of the nodes and direction codes of a file, in the global system or that of the node.

    Parameters
    ----------
    path : path
        The file, for messages.
    scalar : Dof or None
        Direction and sign that code 0 stands for.
    geometry : Geometry or None
        The nodes of the file, with their displacement directions.
    local : bool
        Whether directions stay those of the node.
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
        """Return the DOF.

        Parameters
        ----------
        what : str
            "response" or "reference".
        node, code : int
            As record 6 has them.
        line : int
            Line of the dataset; record 6 stands six further on.

        Raises
        ------
        FormatError
            If the code is none, is 0 and nothing says what it stands for, the node is not in the
            geometry, or the direction is oblique to the global axes and is not to stay as it is.
        """
        at = line + 6
        if not -6 <= code <= 6:
            raise FormatError(f"record 6: {what} direction {code}; expected -6 to 6", self.path, at)
        if code == 0 and self.scalar is None:
            raise FormatError(
                f"record 6: {what} direction 0 (scalar) at node {node} says no direction: give"
                " scalar_direction='Z' or what it is",
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
        if np.abs(vector - along).max() > _PARALLEL:
            shown = ", ".join(f"{v:.6g}" for v in vector)
            raise FormatError(
                f"record 6: {what} {dof} is oblique: its displacement system turns it to ({shown})"
                " in the global one, along none of the axes; keep the directions of nodes with"
                " local_axes=True and match them with updyn.match ([match] of a job), or transform"
                " the measurement to global directions first",
                self.path,
                at,
            )
        is_rotation = axis >= 3
        return Dof(dof.node, DIRECTIONS[k + 3 * is_rotation], int(along[k]))


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """A complete matrix, in SI.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        FRFs.
    coherence : ndarray of float, shape of `values`, or None
        Ordinary coherence.
    responses, references : DofSet
        In the order of the file, or as asked for.
    """

    freq: NDArray[np.float64]
    values: NDArray[np.complex128]
    coherence: NDArray[np.float64] | None
    responses: DofSet
    references: DofSet


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
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
    def signed(self) -> NDArray[Any]:
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
) -> Parts:
    """Put functions into a matrix.

    Parameters
    ----------
    measured, coherences : sequence of Function
        FRFs, and coherences.
    directions : Directions
        Turns direction codes into DOFs.
    factor : callable
        Returns the factor to SI of an FRF, given with its response and its reference.
    average : bool
        Whether functions at one pair are averaged; else they are an error.
    responses, references : iterable of str or Dof, or None
        DOFs to keep; None: all.

    Returns
    -------
    Parts
        The matrix.

    Raises
    ------
    FormatError
        If a pair is missing or there twice, a DOF is not in the file, or abscissae differ.

    Warns
    -----
    UpdynWarning
        If coherence is left out because it does not belong to every FRF.
    """
    path = directions.path
    rows = _Chosen("response", path)
    columns = _Chosen("reference", path)
    found = [_place(f, directions, factor) for f in measured]
    for item in found:
        rows.meet(item.response)
        columns.meet(item.reference)
    rows.keep(responses)
    columns.keep(references)
    frfs = _by_pair(found, rows, columns)
    cohs = _by_pair([_place(f, directions) for f in coherences], rows, columns)
    _complete(frfs, rows, columns, path)
    if not average:
        _single([*frfs.values(), *cohs.values()], path)
    freq = next(iter(frfs.values()))[0].function.x
    for items in (*frfs.values(), *cohs.values()):
        for item in items:
            _same_lines(item, freq, path)
    shape = (len(freq), len(rows.kept), len(columns.kept))
    values = np.empty(shape, dtype=np.complex128)
    coherence = np.empty(shape) if _usable(frfs, cohs, path) else None
    for i, r in enumerate(rows.kept):
        for j, c in enumerate(columns.kept):
            key = (_name(r), _name(c))
            sense = r.sign * c.sign
            gamma = [_gamma(item, path) for item in cohs.get(key, ())]
            values[:, i, j] = _mean([item.signed * sense for item in frfs[key]], gamma)
            if coherence is not None:
                coherence[:, i, j] = np.mean(gamma, axis=0)
    for array in (values, coherence):
        if array is not None:
            array.flags.writeable = False  # so that FRF does not copy it
    return Parts(freq, values, coherence, rows.kept, columns.kept)


def _place(
    function: Function,
    directions: Directions,
    factor: Callable[[Function, Dof, Dof], float] | None = None,
) -> _Placed:
    response = directions.dof("response", *function.response, function.line)
    reference = directions.dof("reference", *function.reference, function.line)
    return _Placed(
        function, response, reference, factor(function, response, reference) if factor else 1.0
    )


def _name(dof: Dof) -> tuple[int, str]:
    return dof.node, dof.direction


class _Chosen:
    """The DOFs of one side, in the order met, each with the sense met first; then those to keep."""

    def __init__(self, what: str, path: str | Path) -> None:
        self.what = what
        self.path = path
        self.met: dict[tuple[int, str], Dof] = {}
        self.kept = DofSet([])

    def meet(self, dof: Dof) -> None:
        self.met.setdefault(_name(dof), dof)

    def keep(self, wanted: Iterable[str | Dof] | None) -> None:
        held = DofSet(self.met.values())
        if wanted is None:
            self.kept = held
            return
        self.kept = chosen(wanted, f"{self.what}s", self.path)
        with placed(self.path, f"{self.what}s"), key_path(f"{self.what}s"):
            held.match(self.kept, self.what)

    def __contains__(self, dof: Dof) -> bool:
        return dof in self.kept


def _by_pair(
    items: Sequence[_Placed], rows: _Chosen, columns: _Chosen
) -> dict[_Pair, list[_Placed]]:
    out: dict[_Pair, list[_Placed]] = {}
    keep_rows = set(map(_name, rows.kept))
    keep_columns = set(map(_name, columns.kept))
    for item in items:
        response, reference = item.key
        if response in keep_rows and reference in keep_columns:
            out.setdefault(item.key, []).append(item)
    return out


def _complete(
    frfs: Mapping[_Pair, list[_Placed]], rows: _Chosen, columns: _Chosen, path: str | Path
) -> None:
    missing = []
    for c in columns.kept:
        for r in rows.kept:
            if (_name(r), _name(c)) not in frfs:
                missing.append(f"{r} / {c}")
    if missing:
        shown = ", ".join(missing[:6])
        if len(missing) > 6:
            shown += ", ..."
        raise FormatError(
            f"{len(missing)} of {len(rows.kept) * len(columns.kept)} pairs of response / reference"
            f" are missing: {shown}. Read a complete part with responses=[...] and"
            " references=[...]",
            path,
        )


def _single(groups: Sequence[list[_Placed]], path: str | Path) -> None:
    for first, *more in groups:
        for second in more:
            raise FormatError(
                f"{second.function.name} at {second.pair} stands twice: also on line"
                f" {first.function.line}; choose duplicates='average' to take the mean",
                path,
                second.function.line,
            )


def _same_lines(item: _Placed, freq: NDArray[np.float64], path: str | Path) -> None:
    x = item.function.x
    if len(x) == len(freq) and np.allclose(x, freq, rtol=1e-9, atol=0):
        return
    raise FormatError(
        f"{item.function.name} at {item.pair} has {len(x)} lines from {x[0]:g} to {x[-1]:g} Hz, the"
        f" first FRF has {len(freq)} from {freq[0]:g} to {freq[-1]:g} Hz (or differs in between):"
        " lines are not aligned",
        path,
        item.function.line,
    )


def _usable(
    frfs: Mapping[_Pair, list[_Placed]], cohs: Mapping[_Pair, list[_Placed]], path: str | Path
) -> bool:
    """Return whether every FRF has its coherence; warn where only some have."""
    with_it = [key for key, items in frfs.items() if len(cohs.get(key, ())) == len(items)]
    if cohs and len(with_it) < len(frfs):
        warnings.warn(
            f"{path}: coherence belongs to {len(with_it)} of {len(frfs)} pairs of DOFs; it is left"
            " out, as it has to be there for all or none",
            UpdynWarning,
            stacklevel=4,
        )
    return bool(cohs) and len(with_it) == len(frfs)


def _gamma(item: _Placed, path: str | Path) -> NDArray[np.float64]:
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


def _mean(
    values: Sequence[NDArray[Any]], gamma: Sequence[NDArray[np.float64]]
) -> NDArray[np.complex128]:
    """Return the mean, weighted line by line with the coherence where every function has one."""
    if len(values) == 1:
        return np.asarray(values[0], dtype=np.complex128)
    weights = np.ones((len(values), len(values[0])))
    if len(gamma) == len(values):
        weights = np.array(gamma)
    weights[:, weights.sum(axis=0) == 0] = 1.0  # no coherence at all: the plain mean
    return np.asarray((weights * np.array(values)).sum(axis=0) / weights.sum(axis=0))
