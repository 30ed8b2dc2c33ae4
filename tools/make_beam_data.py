"""Make src/updyn/demos/data/ladisk_beam.uff from the arrays of the measurement.

    python tools/make_beam_data.py ladisk_beam.npz

The source holds ``freq`` (4999,) in Hz and ``H`` (6 hammer points, 7 accelerometers, 4999),
complex64, without unit or positions. Values are written as they are. The lines are multiples of
1.0001953506544 Hz; they are written as multiples of 1.0001953507 Hz, the most digits that the
format's abscissa increment can hold, which moves the last by 0.0000002 Hz.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

import updyn
from updyn.demos.beam import HAMMER, SENSORS, STATIONS
from updyn.geometry import Geometry

TARGET = Path(__file__).parents[1] / "src" / "updyn" / "demos" / "data" / "ladisk_beam.uff"
STEP = 1.0001953507  # Hz


def measurement(source: Path) -> updyn.FRF:
    """Return the arrays as an FRF with the inferred positions."""
    with np.load(source) as arrays:
        freq, H = arrays["freq"], arrays["H"]
    lines = STEP + np.arange(len(freq)) * STEP
    if not np.allclose(lines, freq, rtol=1e-10, atol=0):
        raise SystemExit(f"{source}: its lines are not multiples of {STEP} Hz")
    nodes = sorted(STATIONS, key=STATIONS.__getitem__)
    xyz = [[STATIONS[n], 0.0, 0.0] for n in nodes]
    geometry = Geometry(nodes, xyz, list(pairwise(nodes)))
    return updyn.FRF(lines, H.transpose(2, 1, 0), SENSORS, HAMMER, "accelerance", geometry=geometry)


def main() -> None:
    """Read the arguments and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path, help="the arrays, .npz")
    parser.add_argument("--out", type=Path, default=TARGET)
    given = parser.parse_args()
    updyn.write_frf(measurement(given.source), given.out)


if __name__ == "__main__":
    main()
