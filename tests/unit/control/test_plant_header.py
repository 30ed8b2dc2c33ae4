"""The C header of a plant: compiled without a warning, run, and compared with numpy."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import updyn
from plants_by_hand import plant, simulate, two_masses
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.sampled import sampled
from updyn.errors import FormatError

COMPILER = shutil.which("cc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
needs_compiler = pytest.mark.needs("cc")

SHOW = """
#include <stdio.h>
#include "NAME.h"
#include "NAME.h"
static void show(const double *v, int n) { for (int i = 0; i < n; i++) printf("%.17g ", v[i]); }
int main(void)
{
    double x[UPPER_N_STATES] = {0}, u[UPPER_N_INPUTS], y[UPPER_N_OUTPUTS], more[UPPER_N_STATES];
    show(NAME_A, UPPER_N_STATES * UPPER_N_STATES); show(NAME_B, UPPER_N_STATES * UPPER_N_INPUTS);
    show(NAME_C, UPPER_N_OUTPUTS * UPPER_N_STATES); show(NAME_D, UPPER_N_OUTPUTS * UPPER_N_INPUTS);
    printf("\\n%.17g %d %.17g %.17g %.17g\\n", UPPER_DT, UPPER_DELAY, UPPER_BAND_LOW, UPPER_BAND_HIGH, UPPER_ERROR);
    for (int k = 0; k < 40; k++) {
        for (int j = 0; j < UPPER_N_INPUTS; j++) u[j] = (double)((7 * k + 3 * j) % 5) - 2.0;
        DO
        show(y, UPPER_N_OUTPUTS);
    }
    printf("\\n");
    for (int i = 0; i < UPPER_N_INPUTS; i++) printf("%s\\n%s\\n", NAME_input_names[i], NAME_input_units[i]);
    for (int i = 0; i < UPPER_N_OUTPUTS; i++) printf("%s\\n%s\\n", NAME_output_names[i], NAME_output_units[i]);
    (void)more;
    return 0;
}
"""
STEP = "NAME_step(x, u, y);"
EULER = """NAME_output(x, u, y); NAME_derivative(x, u, more);
        for (int i = 0; i < UPPER_N_STATES; i++) x[i] += 0.01 * more[i];"""


def run(source: str, folder: Path, name: str, strict: list[str] = STRICT) -> list[str]:
    assert COMPILER is not None
    text = source.replace("NAME", name).replace("UPPER", name.upper())
    (folder / "main.c").write_text(text, encoding="utf-8")
    done = subprocess.run(
        [COMPILER, *strict, "main.c", "-o", "main"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    shown = subprocess.run([str(folder / "main")], capture_output=True, check=True).stdout
    return shown.decode("utf-8").split("\n")


@needs_compiler
@pytest.mark.parametrize("kind", ["continuous", "sampled"])
def test_it_compiles_and_runs_as_numpy_does(kind: str, tmp_path: Path) -> None:
    continuous = two_masses()
    one = sampled(continuous, 0.03, delay=0.05) if kind == "sampled" else continuous
    updyn.write_plant(one, tmp_path / "mount.h")
    numbers, figures, moved, *texts = run(
        SHOW.replace("DO", STEP if kind == "sampled" else EULER), tmp_path, "mount"
    )
    expected = np.concatenate([m.ravel() for m in (one.A, one.B, one.C, one.D)])
    np.testing.assert_array_equal(np.array(numbers.split(), dtype=float), expected)
    assert [float(f) for f in figures.split()] == [one.dt or 0.0, one.delay, *one.band, one.error]
    inputs = np.array([[(7 * k + 3 * j) % 5 - 2.0 for j in range(2)] for k in range(40)])
    if kind == "continuous":
        euler = Plant(np.eye(4) + 0.01 * one.A, 0.01 * one.B, *_rest(one))
        outputs = simulate(euler, inputs)
    else:
        outputs = simulate(one, inputs)
    np.testing.assert_allclose(
        np.array(moved.split(), dtype=float).reshape(40, 3), outputs, rtol=1e-11, atol=1e-13
    )
    said = [
        *zip(one.inputs, one.input_units, strict=True),
        *zip(one.outputs, one.output_units, strict=True),
    ]
    assert texts[:-1] == [text for pair in said for text in pair]


def _rest(one: Plant) -> tuple[object, ...]:
    return (
        one.C,
        one.D,
        one.input_ports,
        one.output_ports,
        one.quantities,
        one.band,
        0.1,
        0.1,
        0.1,
        "by hand",
    )


@needs_compiler
def test_names_that_c_would_stumble_over(tmp_path: Path) -> None:
    names = ['a "b" \\n %d', "??/ */ /* ??=", "line\nbreak", "Δφ µrad", "1234\\"]
    ports = tuple(Port.at(f"{i}:RZ", name) for i, name in enumerate(names, 1))
    one = plant([[-1.0]], [[1.0]], [[1.0]] * 5, output_ports=ports)
    updyn.write_plant(one, tmp_path / "odd.h")
    *_, last = run(SHOW.replace("DO", EULER), tmp_path, "odd")
    assert last == ""
    shown = "\n".join(run(SHOW.replace("DO", EULER), tmp_path, "odd"))
    assert all(name in shown for name in names)


@needs_compiler
@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("Mount 2-b", "mount_2_b"),
        ("2nd", "plant_2nd"),
        ("_x", "plant_x"),
        ("int", "int"),
        ("µ", "plant"),
    ],
)
def test_two_plants_in_one_program_whatever_their_files_are_called(
    stem: str, name: str, tmp_path: Path
) -> None:
    updyn.write_plant(two_masses(), tmp_path / f"{stem}.h")
    updyn.write_plant(sampled(two_masses(), 0.01), tmp_path / "other.h")
    source = f"""
#include <stdio.h>
#include "{stem}.h"
#include "other.h"
int main(void) {{ printf("%d %d", {name.upper()}_N_STATES, (int)(sizeof {name}_D / sizeof {name}_D[0])); return 0; }}
"""
    assert run(source, tmp_path, "none") == ["4 6"]


@needs_compiler
def test_the_header_alone_compiles(tmp_path: Path) -> None:
    """Included and not used, and as C++ where there is such a compiler."""
    updyn.write_plant(sampled(two_masses(), 0.01), tmp_path / "p.h")
    assert run('#include "p.h"\nint main(void) { return 0; }\n', tmp_path, "none") == [""]
    other = shutil.which("c++")
    if other is not None:
        command = [other, "-x", "c++", "-std=c++11", *STRICT[1:], "-fsyntax-only", "main.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


def test_numbers_and_what_it_is_for_are_in_the_text(tmp_path: Path) -> None:
    one = sampled(two_masses(band=(np.float64(0.05), np.float64(2.5))), 0.03)
    updyn.write_plant(one, tmp_path / "p.h")
    text = (tmp_path / "p.h").read_text(encoding="ascii")
    assert text.count(repr(float(one.A[0, 1]))) >= 1
    assert "a sample every 0.03 s" in text
    assert "#define P_BAND_HIGH 2.5\n" in text
    assert "Made for 0.05 to 2.5 Hz; largest error there 0.013" in text
    assert " *   u[0] 1:RZ (N m)" in text
    assert "p_derivative" not in text


def test_an_error_that_is_not_known_is_not_stated(tmp_path: Path) -> None:
    updyn.write_plant(two_masses(error=np.nan), tmp_path / "p.h")
    assert "P_ERROR" not in (tmp_path / "p.h").read_text(encoding="ascii")


def test_c_has_no_arrays_without_elements(tmp_path: Path) -> None:
    gain = plant(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]])
    with pytest.raises(FormatError, match="has no state"):
        updyn.write_plant(gain, tmp_path / "p.h")
    assert list(tmp_path.iterdir()) == []
