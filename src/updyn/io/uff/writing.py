"""Writing FRFs as a universal file: units, geometry, and one binary dataset 58 a pair of DOFs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import FormatError, UpdynWarning
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.io.atomic import atomic_path

__all__ = ["write_frf"]

_MOTION = {
    "receptance": (8, "m", "rad"),
    "mobility": (11, "m/s", "rad/s"),
    "accelerance": (12, "m/s^2", "rad/s^2"),
}
_PAIRS_A_TRACE = 80  # of at most 250 entries, three a pair
_WIDEST = 10**10  # node numbers have ten columns
_COLUMNS = 13  # of abscissa minimum and increment


def write_frf(frf: FRF, path: str | Path) -> None:
    """Write FRFs as a universal file of binary datasets 58 (58b), SI.

    Values and coherence come back to the last bit: in double precision, or in single where that
    holds them exactly. Lines at even distances are stored as minimum and increment where these fit
    their columns and give every line back to rounding; else every line is stored.

    Parameters
    ----------
    frf : FRF
        The data.
    path : path
        File to write.

    Raises
    ------
    FormatError
        If a node number is too wide for the format, a DOF is not in the geometry, or a trace line
        goes to node 0.

    Warns
    -----
    UpdynWarning
        If there is a variance or a number of averages: the format has no place for them.
    """
    lacking = [name for name in ("variance", "averages") if getattr(frf, name) is not None]
    if lacking:
        warnings.warn(
            f"{path}: universal files have no place for {' and '.join(lacking)}; written without",
            UpdynWarning,
            stacklevel=2,
        )
    _check_nodes(frf, path)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        for chunk in _chunks(frf, path):
            file.write(chunk)


def _check_nodes(frf: FRF, path: str | Path) -> None:
    dofs = (*frf.responses, *frf.references)
    placed = [d.node for d in dofs] if frf.geometry is None else frf.geometry.nodes.tolist()
    for node in (*(d.node for d in dofs), *placed):
        if not -_WIDEST // 10 < node < _WIDEST:
            raise FormatError(f"node {node} does not fit the ten columns of a universal file", path)
    lacking = [d for d in dofs if d.node not in set(placed)]
    if lacking:
        raise FormatError(
            f"DOF {lacking[0]} stands at a node that the geometry does not have ({len(lacking)}"
            " such): such a file contradicts itself; complete the geometry, or write without it",
            path,
        )


def _chunks(frf: FRF, path: str | Path) -> Iterator[bytes]:
    one = f"{1.0:25.17E}".replace("E", "D")
    zero = f"{0.0:25.17E}".replace("E", "D")
    yield _text(164, [f"{1:10d}{'SI units':<20}{2:10d}", one * 3, zero])
    if frf.geometry is not None:
        yield from _geometry(frf.geometry, path)
    for j, reference in enumerate(frf.references):
        for i, response in enumerate(frf.responses):
            yield _function(frf, response, reference, frf.values[:, i, j])
            if frf.coherence is not None:
                yield _function(frf, response, reference, frf.coherence[:, i, j])


def _text(number: int, lines: Sequence[str]) -> bytes:
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""]).encode("ascii")


# -- geometry ----------------------------------------------------------------------------------------------
def _geometry(geometry: Geometry, path: str | Path) -> Iterator[bytes]:
    systems = np.zeros(len(geometry.nodes), dtype=np.int64)
    if geometry.axes is not None:
        distinct, which = np.unique(geometry.axes.reshape(-1, 9), axis=0, return_inverse=True)
        systems = np.where(
            (distinct == np.eye(3).ravel()).all(axis=1), 0, np.arange(len(distinct)) + 2
        )[which.ravel()]
        lines = [f"{1:10d}", "NONE"]
        for number in sorted(set(systems.tolist()) - {0}):
            axes = distinct[number - 2].reshape(3, 3)
            lines += [
                f"{number:10d}{0:10d}{8:10d}",
                f"CS{number}",
                *(_reals(row) for row in (*axes, np.zeros(3))),
            ]
        yield _text(2420, lines)
    lines = []
    for node, system, xyz in zip(
        geometry.nodes.tolist(), systems.tolist(), geometry.xyz, strict=True
    ):
        lines += [f"{node:10d}{0:10d}{system:10d}{8:10d}", _reals(xyz)]
    yield _text(2411, lines)
    if (geometry.lines == 0).any():
        raise FormatError(
            "a trace line goes to node 0, which in a universal file lifts the pen", path
        )
    for start in range(0, len(geometry.lines), _PAIRS_A_TRACE):
        pairs = geometry.lines[start : start + _PAIRS_A_TRACE].tolist()
        entries = [n for a, b in pairs for n in (a, b, 0)][:-1]
        rows = ["".join(f"{n:10d}" for n in entries[i : i + 8]) for i in range(0, len(entries), 8)]
        yield _text(
            82, [f"{start // _PAIRS_A_TRACE + 1:10d}{len(entries):10d}{8:10d}", "NONE", *rows]
        )


def _reals(row: Any) -> str:
    return "".join(f"{float(x):25.16E}".replace("E", "D") for x in row)


# -- functions ---------------------------------------------------------------------------------------------
def _function(frf: FRF, response: Dof, reference: Dof, y: NDArray[Any]) -> bytes:
    is_frf = np.iscomplexobj(y)
    even = _even(frf.freq)
    columns = [y.real, y.imag] if is_frf else [y]
    table = np.column_stack(columns if even else [frf.freq, *columns])
    with np.errstate(over="ignore"):
        single = bool((table == table.astype("<f4")).all())
    data = table.astype("<f4" if single else "<f8").tobytes()
    minimum, increment = even or (f"{0.0:.5E}", f"{0.0:.5E}")
    ordinate = {(False, True): 2, (False, False): 4, (True, True): 5, (True, False): 6}[
        is_frf, single
    ]
    form = (
        f"{ordinate:10d}{len(y):10d}{1 if even else 0:10d}{minimum:>13}{increment:>13}{0.0:13.5E}"
    )
    motion, unit, angle = _MOTION[frf.quantity]
    turning, moment = (d.direction.startswith("R") for d in (response, reference))
    title = f"{'H' if is_frf else 'Coherence'} {response} / {reference}"
    texts = [
        *(title[:80], "NONE", "NONE", "NONE", "NONE"),
        (
            f"{4 if is_frf else 6:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{_code(response)}"
            f" {'NONE':<10}{_code(reference)}"
        ),
        form,
        _axis(18, "Frequency", "Hz"),
        _axis(motion, "NONE", angle if turning else unit) if is_frf else _axis(0, "NONE", "NONE"),
        _axis(13, "NONE", "N m" if moment else "N") if is_frf else _axis(0, "NONE", "NONE"),
        _axis(0, "NONE", "NONE"),
    ]
    head = f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    lines = "\n".join(["    -1", head, *(f"{t:<80}" for t in texts), ""])
    return lines.encode("ascii") + data + b"    -1\n"


def _code(dof: Dof) -> str:
    return f"{dof.node:10d}{dof.sign * (DIRECTIONS.index(dof.direction) + 1):4d}"


def _axis(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}"


def _even(freq: NDArray[np.float64]) -> tuple[str, str] | None:
    """Return minimum and increment as texts that give the lines back to rounding (4 ulp), or None."""
    if len(freq) < 2:
        return None
    start, step = _fitting(freq[0]), _fitting((freq[-1] - freq[0]) / (len(freq) - 1))
    again = float(start) + np.arange(len(freq)) * float(step)
    return (start, step) if (np.abs(again - freq) <= 4 * np.spacing(freq)).all() else None


def _fitting(value: float) -> str:
    """Return the text of most digits with a blank before it in the columns of minimum and increment."""
    for digits in range(17, 0, -1):
        text = f"{value:.{digits}g}"
        if len(text) < _COLUMNS:
            return text if "." in text or "e" in text else f"{text}."
    return f"{value:.5E}"
