"""Updates to random tests of the Silverbox, an electronic Duffing oscillator, at several levels.

The record has the voltages of force and displacement: Gaussian noise of growing level, then
multisines of random phase (Wigren & Schoukens, Three free data sets for development and
benchmarking in nonlinear system identification, European Control Conference 2013;
https://www.nonlinearbenchmark.org, "Silverbox", file SNLS80mV.csv). H1 of four parts of the growing
noise and of the multisines, each with the spectrum of its force, determine mass, damping, linear
and cubic stiffness.

The second result is independent of FRFs and of statistical linearisation: a least-squares fit of
m y'' + d y' + k y + k_2 y^2 + k_3 y^3 = u to the record in the band of 20 to 180 Hz.

    OMP_NUM_THREADS=1 python benchmarks/silverbox.py SNLS80mV.csv
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence

import numpy as np
import xarray

import updyn

RATE = 1e7 / 2**14
BAND = (20.0, 180.0)
#: First and last sample of parts, and samples of their segments.
GROWING = [(first, first + 8192, 2048) for first in (8192, 16384, 24576, 32768)]
MULTISINES = (40960, 126000, 4096)
#: Stiffness in N/m and natural frequency in Hz of the start, and its damping ratio.
STIFFNESS, FREQUENCY, RATIO = 1.0, 65.0, 0.03


def read(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Return force and displacement, 1 V as 1 N and as 1 m."""
    force, motion = np.genfromtxt(path, delimiter=",", skip_header=1)[:, :2].T
    return force - force.mean(), motion - np.median(motion)


def measure(force: np.ndarray, motion: np.ndarray, part: tuple[int, int, int]) -> updyn.FRF:
    first, last, segment = part
    records = xarray.DataArray(
        np.stack([force[first:last], motion[first:last]])[None],
        dims=("record", "channel", "time"),
        coords={
            "channel": ["force", "1:X"],
            "unit": ("channel", ["N", "m"]),
            "time": np.arange(last - first) / RATE,
        },
    )
    found = updyn.frf_estimate(records, {"force": "1:X"}, segment=segment / RATE, band=BAND)
    return found.frf.with_level(None, excitation="random", spectrum=found.spectra)


def regress(force: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return m, d, k, k_2 and k_3 of the record by least squares."""
    n = len(force)
    freq = np.fft.rfftfreq(n, 1.0 / RATE)
    s = 2j * np.pi * freq
    kept = (freq > BAND[0]) & (freq < BAND[1])

    def filtered(values: np.ndarray, factor: np.ndarray | float = 1.0) -> np.ndarray:
        return np.fft.irfft(np.fft.rfft(values) * factor * kept, n)[1000 : n - 1000]

    columns = [filtered(motion, s**power) for power in (2, 1, 0)]
    columns += [filtered(motion**power) for power in (2, 3)]
    return np.linalg.lstsq(np.stack(columns, axis=1), filtered(force), rcond=None)[0]


def update(tests: Sequence[updyn.FRF], cubic: bool) -> tuple[str, np.ndarray, float]:
    """Return the status, m, d, k and k_3, and the standard deviation of k_3."""
    mass = STIFFNESS / (2.0 * np.pi * FREQUENCY) ** 2
    damping = 2.0 * RATIO * np.sqrt(STIFFNESS * mass)
    groups = {
        "spring": updyn.Group([[STIFFNESS]]),
        "mass": updyn.Group(mass=[[mass]]),
        "damper": updyn.Group(viscous=[[damping]]),
    }
    model = updyn.Model.from_groups(groups, ["1:X"])
    names = []
    if cubic:
        model = model.with_elements({"cube": (updyn.CubicSpring(STIFFNESS), "1:X")})
        names = ["cube.coefficient"]
    unknowns = updyn.parameters(
        model, stiffness=["spring"], mass=["mass"], viscous=["damper"], nonlinear=names
    )
    found = updyn.update(model, tests, unknowns)
    value = found.values
    viscous = value["damper.viscous"] * damping
    k = value["spring.stiffness"] * STIFFNESS
    k_3 = value.get("cube.coefficient", 0.0)
    return (
        found.status,
        np.array([value["mass.mass"] * mass, viscous, k, k_3]),
        found.std.get("cube.coefficient", 0.0),
    )


def describe(name: str, found: np.ndarray, std: float = 0.0) -> str:
    m, d, k, k_3 = found
    frequency, ratio = np.sqrt(k / m) / 2.0 / np.pi, 50.0 * d / np.sqrt(k * m)
    spread = f" +- {std / k:.2f}" if std else ""
    return f"| {name} | {frequency:.2f} | {ratio:.2f} % | {k:.4f} | {k_3 / k:.2f}{spread} |"


def main() -> None:
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("record")
    force, motion = read(parser.parse_args().record)
    growing = [measure(force, motion, part) for part in GROWING]
    steady = measure(force, motion, MULTISINES)
    levels = ", ".join(f"{1e3 * float(test.level[0]):.1f}" for test in (*growing, steady))
    print(f"levels {levels} mN")
    print("| data | natural frequency, Hz | damping ratio | k, N/m | k_3 / k, 1/m2 |")
    print("|---|---|---|---|---|")
    direct = regress(force, motion)
    print(describe("record, in time", direct[[0, 1, 2, 4]]))
    for name, tests in (
        ("FRFs of all levels", [*growing, steady]),
        ("FRFs of the growing noise", growing),
        ("FRFs of the multisines alone", [steady]),
    ):
        status, found, std = update(tests, cubic=True)
        print(f"{describe(name, found, std)} {status}")
    status, found, _ = update([*growing, steady], cubic=False)
    print(f"{describe('all levels, linear model', found)} {status}")


if __name__ == "__main__":
    main()
