"""Datasets of universal files made field by field from the format's description, for tests and for the bad files."""

from collections.abc import Sequence
from typing import Any

import numpy as np

END = b"    -1\n"


def text(number: int, *lines: str) -> bytes:
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""]).encode()


def records(
    response: tuple[int, int] = (1, 3),
    reference: tuple[int, int] = (1, 3),
    *,
    kind: int = 4,
    ordinate: int = 5,
    points: int = 4,
    even: int = 1,
    start: float = 1.0,
    step: float = 0.5,
    types: Sequence[int] = (18, 12, 13),
    units: Sequence[str] = ("Hz", "NONE", "NONE"),
    names: Sequence[str] = ("NONE", "NONE"),
    title: str = "case",
) -> list[str]:
    """The eleven lines of text of a dataset 58."""
    axes = [
        f"{t:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {u:<20}" for t, u in zip(types, units, strict=True)
    ]
    return [
        *(title, "NONE", "NONE", "NONE", "NONE"),
        (
            f"{kind:5d}{0:10d}{0:5d}{0:10d} {names[0]:<10}{response[0]:10d}{response[1]:4d}"
            f" {names[1]:<10}{reference[0]:10d}{reference[1]:4d}"
        ),
        f"{ordinate:10d}{points:10d}{even:10d}{start * even:13.5E}{step * even:13.5E}{0.0:13.5E}",
        *axes,
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}",
    ]


def flat(y: Any, x: Any = None) -> np.ndarray:
    """Numbers of record 12, in their order."""
    y = np.asarray(y)
    columns = ([] if x is None else [np.asarray(x)]) + (
        [y.real, y.imag] if np.iscomplexobj(y) else [y]
    )
    return np.column_stack(columns).ravel()


def numbers(values: np.ndarray, ordinate: int, even: int) -> list[str]:
    """Record 12 in text."""
    if ordinate in (2, 5):
        widths = [13] * 6
    elif even:
        widths = [20] * 4
    else:
        widths = [13, 20, 13, 20] if ordinate == 4 else [13, 20, 20]
    out = []
    for i in range(0, len(values), len(widths)):
        row = zip(values[i : i + len(widths)], widths, strict=False)
        out.append("".join(f"{v:13.5E}" if w == 13 else f"{v:20.12E}" for v, w in row))
    return out


def ascii58(
    y: Any, response=(1, 3), reference=(1, 3), *, x=None, ordinate=None, **options
) -> bytes:
    ordinate = ordinate or (5 if np.iscomplexobj(y) else 2)
    even = int(x is None)
    options = {"points": len(y)} | options
    head = records(response, reference, ordinate=ordinate, even=even, **options)
    return text(58, *head, *numbers(flat(y, x), ordinate, even))


def binary58(
    y: Any,
    response=(1, 3),
    reference=(1, 3),
    *,
    x=None,
    ordinate=None,
    big=False,
    n_bytes=None,
    end=END,
    head="b{order:6d}{floating:6d}{lines:12d}{n_bytes:12d}{zero:6d}{zero:6d}{zero:12d}{zero:12d}",
    **options,
) -> bytes:
    ordinate = ordinate or (6 if np.iscomplexobj(y) else 4)
    options = {"points": len(y)} | options
    lines = records(response, reference, ordinate=ordinate, even=int(x is None), **options)
    kind = (">" if big else "<") + ("f8" if ordinate in (4, 6) else "f4")
    data = flat(y, x).astype(kind).tobytes()
    first = head.format(
        order=2 if big else 1,
        floating=2,
        lines=11,
        n_bytes=len(data) if n_bytes is None else n_bytes,
        zero=0,
    )
    opening = "\n".join(["    -1", f"{58:6d}{first}", *(line.ljust(80) for line in lines), ""])
    return opening.encode() + data + end


def units(code: int, length: float, force: float) -> bytes:
    one = f"{length:25.17E}{force:25.17E}{1.0:25.17E}".replace("E", "D")
    return text(164, f"{code:10d}{'units':<20}{2:10d}", one, f"{0.0:25.17E}".replace("E", "D"))


def nodes15(*rows: tuple[int, int, int, float, float, float]) -> bytes:
    return text(
        15,
        *(f"{n:10d}{d:10d}{s:10d}{8:10d}{x:13.5E}{y:13.5E}{z:13.5E}" for n, d, s, x, y, z in rows),
    )


def nodes2411(*rows: tuple[int, int, int, float, float, float]) -> bytes:
    lines = []
    for n, d, s, *xyz in rows:
        lines += [
            f"{n:10d}{d:10d}{s:10d}{8:10d}",
            "".join(f"{v:25.16E}".replace("E", "D") for v in xyz),
        ]
    return text(2411, *lines)


def systems2420(*rows: tuple[int, int, Any, Any]) -> bytes:
    """Systems from number, type, axes (rows) and origin."""
    lines = [f"{1:10d}", "part"]
    for number, kind, axes, origin in rows:
        matrix = [*np.asarray(axes, dtype=float).tolist(), list(origin)]
        lines += [f"{number:10d}{kind:10d}{8:10d}", f"CS{number}"]
        lines += ["".join(f"{v:25.16E}".replace("E", "D") for v in row) for row in matrix]
    return text(2420, *lines)


def trace82(*nodes: int) -> bytes:
    rows = ["".join(f"{n:10d}" for n in nodes[i : i + 8]) for i in range(0, len(nodes), 8)]
    return text(82, f"{1:10d}{len(nodes):10d}{8:10d}", "NONE", *rows)
