"""Update of the AIRMOD aircraft model of DLR to natural frequencies of its repeated tests.

    OMP_NUM_THREADS=1 python benchmarks/airmod.py FOLDER
    OMP_NUM_THREADS=1 python benchmarks/airmod.py FOLDER --population
    python benchmarks/airmod.py FOLDER --score ESTIMATE.csv

The folder has the Nastran deck ``AIRMOD_MODAL.DAT`` with ``PARAM.DAT``, ``msc_frequencies.csv``,
its natural frequencies by MSC Nastran in Hz (one a line), and ``test_frequencies.csv``, those of
the tests (one test a line, one mode a column, nan for modes not identified). The figures of
docs/airmod.md are printed as Markdown. Deck and tests:
github.com/cossan-working-group/BayesianModelUpdating. Unknowns and modes: E. Patelli, Y. Govers, M.
Broggi, H. M. Gomes, M. Link & J. E. Mottershead, Arch. Appl. Mech. 87 (2017) 905-925.
"""

from __future__ import annotations

import argparse
import csv
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import updyn
from updyn.errors import UpdynWarning
from updyn.modal import ModeSet, RepeatedTests
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
#: Standard deviation of the prior on each factor, with which all unknowns are determined.
PRIOR_STD = 0.5
#: Standard deviation of the frequency of one assembly over repeats, as a share: below all scatter.
REPEAT_STD = 1e-4
#: Relative step of the differences.
STEP = 1e-3


def read(folder: Path) -> Model:
    """Return the model of the deck; its rods, the bungee cords, have no mass."""
    deck = folder / "AIRMOD_MODAL.DAT"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        return updyn.read_model(deck, spc=2, massless=["PROD 16", "PROD 17"])


def tests(folder: Path) -> RepeatedTests:
    """Return the frequencies of 14 modes in each test; nan for modes that it did not find."""
    table = np.loadtxt(folder / "test_frequencies.csv", delimiter=",")
    return RepeatedTests(table[:, np.array(MODES) - 1])


def tested(folder: Path) -> ModeSet:
    """Return the means of 14 frequencies over the tests, with their covariance."""
    return updyn.read_modes(folder / "test_frequencies.csv", modes=MODES)


def unknowns(model: Model, prior_std: float | None = None) -> ParameterSet:
    """Return the 18 unknowns of the publications, with a prior about the start if it is stated."""
    prior = None if prior_std is None else {"*": prior_std}
    return updyn.parameters(model, stiffness=STIFFNESS, mass=MASS, prior_std=prior)


def errors(model: Model, data: ModeSet) -> np.ndarray:
    """Return the errors of the frequencies of a full model in percent.

    The modes of the model are those of the tests in their order, from its second one on.
    """
    found = updyn.modes(model, 40).frequency
    found = found[found > 0][1:]
    return 100.0 * (found[np.array(MODES) - 1] / data.frequency - 1.0)


def print_model(folder: Path) -> Model:
    """Print the size of the model and its error against MSC Nastran; return it."""
    clock = time.process_time()
    model = read(folder)
    took = time.process_time() - clock
    msc = np.loadtxt(folder / "msc_frequencies.csv")
    own = updyn.modes(model, len(msc)).frequency
    far = np.abs(own[1:] / msc[1:] - 1.0).max()  # the first is a rigid-body mode
    print(f"{model.n_dofs} DOFs, read in {took:.1f} s")
    print(f"{len(msc) - 1} frequencies as by MSC Nastran within {100 * far:.3f} %")
    return model


def print_tests(found: RepeatedTests) -> None:
    """Print means, deviations and missing modes of the tests, and their correlation."""
    is_found = np.isfinite(found.frequency)
    used = int(is_found.any(axis=1).sum())
    complete = int(is_found.all(axis=1).sum())
    print(f"{len(found)} tests, {used} found one of the modes, {complete} all")
    print("| mode | missing in | mean, Hz | deviation, Hz | deviation | of the mean |")
    print("|---|---|---|---|---|---|")
    share = 100.0 * found.std / found.mean
    rows = zip(MODES, found.count, found.mean, found.std, share, strict=True)
    for mode, count, mean, std, percent in rows:
        of_mean = percent / np.sqrt(count)
        missing = used - count
        print(
            f"| {mode} | {missing} | {mean:.3f} | {std:.4f} | {percent:.2f} % | {of_mean:.3f} % |"
        )
    print(f"shrinkage {found.shrinkage:.3f}")
    eigenvalues = np.linalg.eigvalsh(found.correlation)
    print(f"eigenvalues of the correlation {eigenvalues[0]:.2f} to {eigenvalues[-1]:.2f}")
    print("| |", " | ".join(map(str, MODES)), "|")
    print("|---" * (len(MODES) + 1) + "|")
    for i, mode in enumerate(MODES):
        cells = [f"{r:.2f}" for r in found.correlation[i, :i]] + ["1"]
        print(f"| {mode} |", " | ".join(cells + [""] * (len(MODES) - len(cells))), "|")


def print_rank(model: Model, data: ModeSet, sought: ParameterSet) -> None:
    """Print rank and undetermined combinations before the run, by the error of the frequencies."""
    for error in (1e-2, 1e-3, 1e-4):
        found = identifiability(model, data, sought, noise={"frequency": error})
        print(
            f"before the run: rank {found.rank} of {found.n_parameters} unknowns, if frequencies"
            f" are known to {100 * error:g} %"
        )
    before = identifiability(model, data, sought)
    print(f"before the run: rank {before.rank} with the covariance of the means")
    print("undetermined combinations:")
    for direction in before.null_directions:
        print(f"- {combination(direction)}")


def combination(direction: Mapping[str, float], most: int = 5) -> str:
    """Return a combination of unknowns by its largest weights."""
    terms = sorted(direction.items(), key=lambda term: -abs(term[1]))
    more = ", ..." if len(terms) > most else ""
    return ", ".join(f"{share:+.2f} `{name}`" for name, share in terms[:most]) + more


def print_update(model: Model, data: ModeSet, sought: ParameterSet) -> None:
    """Print the update to the means."""
    clock, watch = time.process_time(), time.perf_counter()
    result = updyn.update(model, data, sought)
    took = time.process_time() - clock, time.perf_counter() - watch
    print(f"update: {took[0]:.0f} s of processor time, {took[1]:.0f} s elapsed; {result.status}")
    used = ("tier", "basis", "factorisations", "frequency error")
    print("  " + ", ".join(f"{key} {result.options[key]}" for key in used))
    print(f"rank {result.identifiability.rank} of {len(sought)}; undetermined combinations:")
    for direction in result.identifiability.null_directions:
        print(f"- {combination(direction)}")
    print("| mode | test, Hz | start | updated |")
    print("|---|---|---|---|")
    rows = zip(MODES, data.frequency, errors(model, data), errors(result.model, data), strict=True)
    for mode, frequency, start, updated in rows:
        print(f"| {mode} | {frequency:.3f} | {start:+.2f} % | {updated:+.5f} % |")


def print_prior(model: Model, found: RepeatedTests) -> None:
    """Print the standard deviations with a prior, for three covariances of the data."""
    sought = unknowns(model, PRIOR_STD)
    data = {
        "mean": found.mean_modes(),
        "mean, independent": ModeSet(found.mean, std_frequency=found.std / np.sqrt(found.count)),
        "single test": ModeSet(found.mean, cov_frequency=found.covariance),
    }
    results = {}
    for name, modes in data.items():
        results[name] = updyn.update(model, modes, sought, starts=0)
        print(f"{name}: {results[name].status}")
        print(f"  largest error {np.abs(errors(results[name].model, modes)).max():.3f} %")
    print("| unknown | value |", " | ".join(data), "|")
    print("|---" * (2 + len(data)) + "|")
    for name, value in results["mean"].values.items():
        std = " | ".join(f"{result.std[name]:.4f}" for result in results.values())
        print(f"| `{name}` | {value:.3f} | {std} |")


def specimens(model: Model, found: RepeatedTests) -> list[updyn.Test]:
    """Return a test for each assembly: its frequencies, known to a share of `REPEAT_STD`."""
    out = []
    for number, row in enumerate(found.frequency, 1):
        known = row[np.isfinite(row)]
        if len(known):
            data = ModeSet(known, std_frequency=REPEAT_STD * known)
            out.append(updyn.Test(model, data, f"assembly {number}"))
    return out


def sensitivity(model: Model, sought: ParameterSet, values: Mapping[str, float]) -> np.ndarray:
    """Return the derivatives of the 14 frequencies by the unknowns, in Hz, by differences."""
    columns = []
    for name in sought.names:
        ends = []
        for side in (-1.0, 1.0):
            changed = {**values, name: values[name] * (1.0 + side * STEP)}
            found = updyn.modes(sought.with_start(changed).at_start(model), 40).frequency
            ends.append(found[found > 0][1:][np.array(MODES) - 1])
        columns.append((ends[1] - ends[0]) / (2.0 * STEP * values[name]))
    return np.array(columns).T


def print_population(folder: Path) -> None:
    """Print scatter of the unknowns over the assemblies, and that of the frequencies from it."""
    model, found = read(folder), tests(folder)
    sought = unknowns(model, PRIOR_STD)
    of_means = updyn.update(model, found.mean_modes(), sought, starts=0)
    clock = time.process_time()
    population = updyn.update_population(
        specimens(model, found), sought.with_start(of_means.values), starts=0
    )
    print(f"{population.statement} {time.process_time() - clock:.0f} s of processor time")
    print(f"excluded: {len(population.excluded)}; outliers: {', '.join(population.outliers())}")
    print(population.summary())
    S = sensitivity(model, sought, population.mean)
    noise = np.diag((REPEAT_STD * found.mean) ** 2)
    covariance = S @ population.covariance @ S.T + noise
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / std / std[:, None]
    print("| mode | measured, Hz | of the population, Hz | ratio |")
    print("|---|---|---|---|")
    for mode, one, other in zip(MODES, found.std, std, strict=True):
        print(f"| {mode} | {one:.4f} | {other:.4f} | {other / one:.2f} |")
    measured = sample_correlation(found.frequency)
    lower = np.tril_indices(len(MODES), -1)
    gap = np.abs(correlation - measured)[lower]
    print(f"correlations differ by {np.median(gap):.2f} (median), {gap.max():.2f} (largest)")


def sample_correlation(values: np.ndarray) -> np.ndarray:
    """Return the correlation of columns, over the rows in which both are known."""
    n = values.shape[1]
    out = np.eye(n)
    for i in range(n):
        for j in range(i):
            rows = np.isfinite(values[:, i]) & np.isfinite(values[:, j])
            out[i, j] = out[j, i] = np.corrcoef(values[rows, i], values[rows, j])[0, 1]
    return out


def main(folder: Path) -> None:
    """Print the figures."""
    model, data = print_model(folder), tested(folder)
    print_tests(tests(folder))
    sought = unknowns(model)
    print_rank(model, data, sought)
    print_update(model, data, sought)
    print_prior(model, tests(folder))


def score(folder: Path, estimate: Path) -> float:
    """Return the largest error in percent of an estimate, a file with ``name,value`` in each line.

    Unknowns that the file omits keep their start.
    """
    model = read(folder)
    with estimate.open(encoding="utf-8", newline="") as file:
        values = {row[0]: float(row[1]) for row in csv.reader(file) if row}
    updated = unknowns(model).with_start(values).at_start(model)
    return float(np.abs(errors(updated, tested(folder))).max())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--score", type=Path, help="estimate of any program to score")
    parser.add_argument("--population", action="store_true", help="scatter of the unknowns")
    given = parser.parse_args()
    if given.population:
        print_population(given.folder)
    elif given.score is None:
        main(given.folder)
    else:
        print(f"largest frequency error {score(given.folder, given.score):.4f} %")
