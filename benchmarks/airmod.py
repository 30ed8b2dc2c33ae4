"""Update of the AIRMOD aircraft model of DLR to natural frequencies of its repeated tests.

    OMP_NUM_THREADS=1 python benchmarks/airmod.py FOLDER

The folder has the Nastran deck ``AIRMOD_MODAL.DAT`` with ``PARAM.DAT``, ``msc_frequencies.csv``,
its natural frequencies by MSC Nastran in Hz (one a line), and ``test_frequencies.csv``, those of
the tests (one test a line, one mode a column, nan for modes not identified). Deck and tests:
github.com/cossan-working-group/BayesianModelUpdating. Unknowns and modes: E. Patelli, Y. Govers, M.
Broggi, H. M. Gomes, M. Link & J. E. Mottershead, Arch. Appl. Mech. 87 (2017) 905-925.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np

import updyn
from updyn.errors import UpdynWarning
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.update import identifiability

#: Columns of the table of tests, from 1: the 14 modes of the publications.
MODES = [1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 14, 19, 20]
#: Groups of the 18 unknowns: joints, cables and springs; masses of sensors, cables and bolts.
STIFFNESS = ["PROD 16", "PROD 17"] + [
    f"PELAS {number}" for number in (160, 171, 172, 1, 3, 4, 5, 6, 10, 11)
]
MASS = [f"PMASS {number}" for number in (103, 1041, 1042, 105, 106, 107)]


def read(folder: Path) -> Model:
    """Return the model of the deck; its rods, the bungee cords, have no mass."""
    deck = folder / "AIRMOD_MODAL.DAT"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        return updyn.read_model(deck, spc=2, massless=["PROD 16", "PROD 17"])


def tested(folder: Path) -> ModeSet:
    """Return the means of 14 frequencies over the tests, with their standard deviations."""
    return updyn.read_modes(folder / "test_frequencies.csv", modes=MODES)


def unknowns(model: Model) -> ParameterSet:
    """Return the 18 unknowns of the publications."""
    return updyn.parameters(model, stiffness=STIFFNESS, mass=MASS)


def errors(model: Model, data: ModeSet) -> np.ndarray:
    """Return the errors of the frequencies of a full model in percent.

    The modes of the model are those of the tests in their order, from its second one on.
    """
    found = updyn.modes(model, 40).frequency
    found = found[found > 0][1:]
    return 100.0 * (found[np.array(MODES) - 1] / data.frequency - 1.0)


def main(folder: Path) -> None:
    """Print the figures."""
    clock = time.process_time()
    model = read(folder)
    print(f"{model.n_dofs} DOFs, read in {time.process_time() - clock:.1f} s")
    msc = np.loadtxt(folder / "msc_frequencies.csv")
    own = updyn.modes(model, len(msc)).frequency
    far = np.abs(own[1:] / msc[1:] - 1.0).max()  # the first is a rigid-body mode
    print(f"{len(msc) - 1} frequencies as by MSC Nastran within {100 * far:.3f} %")
    data, sought = tested(folder), unknowns(model)
    for error in (1e-2, 1e-3, 1e-4):
        before = identifiability(model, data, sought, noise={"frequency": error})
        print(
            f"before the run: rank {before.rank} of {before.n_parameters} unknowns, if frequencies"
            f" are known to {100 * error:g} %"
        )
    for direction in before.null_directions:
        terms = sorted(direction.items(), key=lambda term: -abs(term[1]))
        print("  undetermined:", ", ".join(f"{share:+.2f} {name}" for name, share in terms[:5]))
    clock, watch = time.process_time(), time.perf_counter()
    result = updyn.update(model, data, sought)
    took = time.process_time() - clock, time.perf_counter() - watch
    print(f"update: {took[0]:.0f} s of processor time, {took[1]:.0f} s elapsed; {result.status}")
    used = ("tier", "basis", "factorisations", "frequency error")
    print("  " + ", ".join(f"{key} {result.options[key]}" for key in used))
    print("mode   test, Hz   start, %   updated, %")
    rows = zip(MODES, data.frequency, errors(model, data), errors(result.model, data), strict=True)
    for mode, frequency, start, updated in rows:
        print(f"{mode:4d} {frequency:10.3f} {start:+10.2f} {updated:+12.5f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    main(parser.parse_args().folder)
