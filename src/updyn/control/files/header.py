"""A plant as a C99 header for controller code: matrices, names and functions.

Every name begins with the stem of the file, so a program can include several plants: in ``mount.h``
``MOUNT_N_STATES``, ``mount_A`` and so on, in SI units, and ``mount_output(x, u, y)``, with
``mount_derivative(x, u, dx)`` (continuous) or ``mount_step(x, u, y)`` (sampled: y = C x + D u, then
x = A x + B u). Numbers have all digits needed to read them back exactly. The header allocates no
memory and includes no other file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from updyn import __version__
from updyn.arrays import NumberArray
from updyn.control.plant import Plant
from updyn.errors import FormatError
from updyn.io.atomic import atomic_path

__all__ = ["write_plant"]

_A_LINE = 4  # numbers per line
_OTHER = re.compile(r"[^A-Za-z0-9 _.,:;+()/='-]")  # characters other than plain ones


def write_plant(plant: Plant, path: str | Path) -> None:
    """Write a plant as a header whose names begin with the stem of the file.

    Raises FormatError if the plant has no state, as C has no empty arrays.
    """
    if not plant.n_states:
        raise FormatError("the plant has no state; a header requires at least one", path)
    stem = re.sub(r"[^A-Za-z0-9]", "_", Path(path).stem)
    name = stem.lower() if stem[:1].isalpha() else f"plant_{stem.lower().lstrip('_')}".rstrip("_")
    text = "\n".join(_lines(plant, name)) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="ascii")


def _lines(plant: Plant, name: str) -> list[str]:
    upper, (low, high) = name.upper(), map(float, plant.band)
    if plant.dt is None:
        dt = 0.0
        kind = "x' = A x + B u"
    else:
        dt = float(plant.dt)
        kind = f"x[k+1] = A x[k] + B u[k], a sample every {dt!r} s"
    sizes = {"STATES": plant.n_states, "INPUTS": len(plant.inputs), "OUTPUTS": len(plant.outputs)}
    by_size = {"n": f"{upper}_N_STATES", "u": f"{upper}_N_INPUTS", "y": f"{upper}_N_OUTPUTS"}
    matrices = (
        ("A", "nn", plant.A),
        ("B", "nu", plant.B),
        ("C", "yn", plant.C),
        ("D", "yu", plant.D),
    )
    out = [
        (
            f"/* Plant {name}, written by updyn {__version__}: {kind}, y = C x + D u; SI units,"
            " time in s."
        ),
        f" * Made for {low!r} to {high!r} Hz; largest error there {plant.error:.3g} of the peak.",
    ]
    for what, names, units in (
        ("u", plant.inputs, plant.input_units),
        ("y", plant.outputs, plant.output_units),
    ):
        for i, (text, unit) in enumerate(zip(names, units, strict=True)):
            out.append(f" *   {what}[{i}] {_comment(text)} ({unit})")
    out += [" */", f"#ifndef {upper}_H", f"#define {upper}_H", ""]
    out += [f"#define {upper}_N_{what} {size}" for what, size in sizes.items()]
    out += [f"#define {upper}_DT {dt!r}", f"#define {upper}_DELAY {plant.delay}"]
    out += [f"#define {upper}_BAND_LOW {low!r}", f"#define {upper}_BAND_HIGH {high!r}"]
    if math.isfinite(plant.error):
        out += [f"#define {upper}_ERROR {float(plant.error)!r}"]
    for letter, size, matrix in matrices:
        length = " * ".join(by_size[s] for s in size)
        out += ["", f"static const double {name}_{letter}[{length}] = {{", *_rows(matrix), "};"]
    for what, texts in (
        ("input_names", plant.inputs),
        ("input_units", plant.input_units),
        ("output_names", plant.outputs),
        ("output_units", plant.output_units),
    ):
        length = by_size["u" if what.startswith("input") else "y"]
        out += ["", f"static const char *const {name}_{what}[{length}] = {{"]
        out += [*_format_list(list(map(_c_string, texts)), 1), "};"]
    return [
        *out,
        "",
        *_functions(name, by_size, sampled=plant.dt is not None),
        "",
        f"#endif /* {upper}_H */",
    ]


def _functions(name: str, size: dict[str, str], *, sampled: bool) -> list[str]:
    n, u, y = size["n"], size["u"], size["y"]
    space = f"const double x[{n}], const double u[{u}]"
    output = [
        "/* y = C x + D u */",
        f"static inline void {name}_output({space}, double y[{y}])",
        "{",
        *_product(name, "y", ("C", n, "x"), ("D", u, "u"), y),
        "}",
        "",
    ]
    if not sampled:
        return [
            *output,
            "/* dx = A x + B u */",
            f"static inline void {name}_derivative({space}, double dx[{n}])",
            "{",
            *_product(name, "dx", ("A", n, "x"), ("B", u, "u"), n),
            "}",
        ]
    return [
        *output,
        "/* y = C x + D u, then x = A x + B u: once a sample, from x = 0. */",
        f"static inline void {name}_step(double x[{n}], const double u[{u}], double y[{y}])",
        "{",
        f"    double next[{n}];",
        f"    {name}_output(x, u, y);",
        *_product(name, "next", ("A", n, "x"), ("B", u, "u"), n),
        f"    for (int i = 0; i < {n}; i++) {{",
        "        x[i] = next[i];",
        "    }",
        "}",
    ]


def _product(
    name: str, into: str, first: tuple[str, str, str], second: tuple[str, str, str], rows: str
) -> list[str]:
    out = [f"    for (int i = 0; i < {rows}; i++) {{", "        double sum = 0.0;"]
    for matrix, columns, vector in (first, second):
        out += [
            f"        for (int j = 0; j < {columns}; j++) {{",
            f"            sum += {name}_{matrix}[i * {columns} + j] * {vector}[j];",
            "        }",
        ]
    return [*out, f"        {into}[i] = sum;", "    }"]


def _rows(matrix: NumberArray) -> list[str]:
    """Return the lines of an initialiser; each row starts a new line."""
    out: list[str] = []
    for row in matrix.tolist():
        out += _format_list(list(map(repr, row)), _A_LINE)
    return out


def _format_list(items: Sequence[str], a_line: int) -> list[str]:
    lines = []
    for i in range(0, len(items), a_line):
        lines.append(f"    {', '.join(items[i : i + a_line])},")
    return lines


def _comment(text: str) -> str:
    """Return a text that contains no end or start of a comment."""
    return _OTHER.sub("_", text)  # the asterisk is not a plain character


def _c_string(text: str) -> str:
    """Return a C string, with other than plain characters as octal bytes of UTF-8."""

    def octal(match: re.Match[str]) -> str:
        return "".join(f"\\{byte:03o}" for byte in match[0].encode())

    return f'"{_OTHER.sub(octal, text)}"'
