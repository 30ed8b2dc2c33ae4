"""Problems of FRF updating for any program: write their files, fit them here, score an estimate.

    python benchmarks/field.py write FOLDER [--problems chain,building]
    python benchmarks/field.py fit FOLDER/chain [--method maximum-likelihood]
    python benchmarks/field.py score FOLDER/chain ESTIMATE.csv
    python benchmarks/field.py score FOLDER/beam PREDICTION.npz
    python benchmarks/field.py table FOLDER

``write`` makes a folder for each problem, from seeds: the same files everywhere but for rounding.
``fit`` writes ``estimate-METHOD.csv`` beside them, and of the beam ``prediction-METHOD.npz``.
``score`` needs numpy alone. ``table`` scores all that was fitted here. docs/benchmarks/README.md
says what is in the files and what is scored.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from updyn.model import Model

#: By problem: the structure of `structures.py`, or None.
PROBLEMS = {
    "chain": "chain",
    "gear-train": "gear train",
    "building": "building",
    "space-frame": "space frame",
    "solid-864": None,
    "solid-2025": "solid",
    "solid-10140": None,
    "beam": None,
    "antenna": None,
}
RELATIVE, FLOOR, SEED = 0.01, 1e-3, 20
TRUTH, UNKNOWNS, HELD_OUT = "truth.csv", "unknowns.csv", "held-out.npz"
#: Of the beam: sensors that no fit sees, and the band.
SENSORS, BAND = ("103:Z", "107:Z"), (100.0, 4500.0)


def write(folder: Path, name: str) -> Path:
    """Write a problem; return its folder."""
    there = folder / name
    there.mkdir(parents=True, exist_ok=True)
    if name == "beam":
        _measured_beam(there)
    elif name == "antenna":
        _antenna(there)
    else:
        _made(there, name)
    return there


def _made(there: Path, name: str) -> None:
    from solids import CELLS, everything, measured
    from structures import Bench, Case, Noise, bench

    import updyn

    if PROBLEMS[name] is not None:
        one = bench(PROBLEMS[name])
    else:
        size = name.removeprefix("solid-")
        assert size in CELLS
        true, clean, _ = measured(size, 20)
        one = Bench(Case(name, true, true, clean), everything)
    rng = np.random.default_rng(SEED)
    start = one.start(rng)
    updyn.write_model(start, there / "model.h5")
    _write_matrices(start, there)
    data = Noise(RELATIVE, FLOOR).added(one.case.clean, rng)
    updyn.write_frf(data, there / "test.uff")
    updyn.write_frf(data, there / "test.npz")
    unknowns = one.sought(start)
    _write_rows(there / UNKNOWNS, [(p.name, p.group, p.quantity) for p in unknowns])
    _write_rows(there / TRUTH, [(p.name, one.truth(p, start)) for p in unknowns])


def _write_matrices(model: Model, there: Path) -> None:
    """Stiffness and mass of each group as Matrix Market files, for programs that read no HDF5."""
    from scipy.io import mmwrite

    groups = there / "groups"
    groups.mkdir(exist_ok=True)
    (there / "dofs.txt").write_text("".join(f"{d}\n" for d in model.dofs.labels), encoding="utf-8")
    for number, (name, group) in enumerate(model.groups.items(), 1):
        head = f"{name}; loss factor {group.loss_factor!r}"
        for symbol, matrix in (("K", group.stiffness), ("M", group.mass)):
            if matrix is not None and matrix.nnz:
                mmwrite(groups / f"{number:02}-{symbol}.mtx", matrix.tocoo(), comment=head)


def _measured_beam(there: Path) -> None:
    import updyn
    from updyn.demos import find_demo
    from updyn.job import load_job, prepare

    job = load_job(find_demo("beam").write_inputs(there))
    (test,) = prepare(job).tests
    held_out = test.frf.select(responses=SENSORS, band=BAND)
    updyn.write_frf(held_out, there / HELD_OUT)


def _antenna(there: Path) -> None:
    from updyn.demos import antenna, find_demo
    from updyn.job import load_job, prepare

    job = load_job(find_demo("antenna").write_inputs(there))
    _write_rows(there / TRUTH, list(antenna.true_values(prepare(job).parameters).items()))


def fit(there: Path, method: str) -> Path:
    """Fit a problem from its files; return the file of the estimate."""
    import updyn

    begun = time.process_time()
    if (there / UNKNOWNS).exists():
        model, test = updyn.read_model(there / "model.h5"), updyn.read_frf(there / "test.npz")
        chosen: dict[str, list[str]] = {}
        for _, group, quantity in _rows(there / UNKNOWNS):
            chosen.setdefault(quantity, []).append(group)
        unknowns = updyn.parameters(model, **chosen)
        result = updyn.update(model, test, unknowns, method)
    else:
        from updyn.job import load_job, run_job

        out = there / "run"
        shutil.rmtree(out, ignore_errors=True)
        result = run_job(load_job(there / "job.toml"), out).result
    seconds = time.process_time() - begun
    path = there / f"estimate-{method}.csv"
    _write_rows(path, [(name, result.values[name], result.std[name]) for name in result.values])
    if (there / HELD_OUT).exists():
        path = there / f"prediction-{method}.npz"
        asked = updyn.read_frf(there / HELD_OUT)
        answer = (asked.freq, asked.responses, asked.references, asked.quantity)
        updyn.write_frf(updyn.response(result.model, *answer), path)
    said = {"status": result.status, "seconds": seconds}
    (there / f"run-{method}.json").write_text(json.dumps(said), encoding="utf-8")
    print(f"{there.name}: {method}, {result.status}, {seconds:.1f} s")
    return path


def score(there: Path, estimate: Path) -> dict[str, float]:
    """Return the figures of an estimate, or of predicted FRFs where there is no truth."""
    if (there / HELD_OUT).exists():
        return _of_prediction(there / HELD_OUT, estimate)
    return _of_estimate(there / TRUTH, estimate)


def _of_prediction(held_out: Path, prediction: Path) -> dict[str, float]:
    """Return relative residuals: by channel the norm of the differences over that of the data."""
    with np.load(held_out) as test, np.load(prediction) as model:
        for key in ("freq", "responses", "references"):
            if not np.array_equal(test[key], model[key]):
                raise SystemExit(f"{prediction}: {key} are not those of {held_out.name}")
        off = np.linalg.norm(model["H"] - test["H"], axis=0) / np.linalg.norm(test["H"], axis=0)
    return {"median residual": float(np.median(off)), "largest residual": float(np.max(off))}


def _of_estimate(truth_file: Path, estimate: Path) -> dict[str, float]:
    """Return the figures of an estimate against the truth.

    Of a loss factor the error is estimate - truth, of all else estimate / truth - 1. An unknown
    that the estimate does not name counts as not recovered.
    """
    found = {row[0]: [float(x) for x in row[1:]] for row in _rows(estimate)}
    truth = {name: float(value) for name, value in _rows(truth_file)}
    unknown = set(found) - set(truth)
    if unknown:
        where = truth_file.parent.name
        raise SystemExit(f"{estimate}: no unknowns of {where}: {', '.join(sorted(unknown))}")
    errors, covered = [], []
    for name, true in truth.items():
        if name not in found:
            errors.append(np.inf)
            continue
        value, *std = found[name]
        off = value - true
        errors.append(abs(off if _is_loss(name) else off / true))
        if std and np.isfinite(std[0]):
            covered.append(abs(off) <= 1.96 * std[0])
    return {
        "unknowns": len(truth),
        "within 1 %": float(np.mean(np.array(errors) <= 0.01)),
        "largest error": float(np.max(errors)),
        "median error": float(np.median(errors)),
        "covered": float(np.mean(covered)) if covered else np.nan,
    }


def table(folder: Path) -> None:
    """Print the figures of all that was fitted here."""
    shown = ("within 1 %", "largest error", "covered")
    print(f"| problem | method | status | {' | '.join(shown)} | seconds |")
    print(f"|---|---|---|{'---|' * (len(shown) + 1)}")
    predictions = []
    for name in PROBLEMS:
        there = folder / name
        for run in sorted(there.glob("run-*.json")):
            said = json.loads(run.read_text(encoding="utf-8"))
            method = run.stem.removeprefix("run-")
            ends = f"| {said['seconds']:.1f} |"
            if (there / HELD_OUT).exists():
                found = score(there, there / f"prediction-{method}.npz")
                residuals = " | ".join(f"{value:.3f}" for value in found.values())
                predictions.append(f"| `{method}` | {said['status']} | {residuals} {ends}")
                continue
            found = score(there, there / f"estimate-{method}.csv")
            figures = " | ".join(
                "-" if np.isnan(found[key]) else f"{found[key]:.2g}" for key in shown
            )
            print(f"| `{name}` | `{method}` | {said['status']} | {figures} {ends}")
    if predictions:
        print("\n| `beam`: method | status | median residual | largest residual | seconds |")
        print("|---|---|---|---|---|")
        print("\n".join(predictions))


def _is_loss(name: str) -> bool:
    return name.rpartition(".")[2] in ("loss_factor", "loss")


def _write_rows(path: Path, rows: list[tuple]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _rows(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.reader(file) if row]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("write")
    one.add_argument("folder", type=Path)
    one.add_argument("--problems", default=",".join(PROBLEMS))
    one = verbs.add_parser("fit")
    one.add_argument("folder", type=Path)
    one.add_argument("--method", default="maximum-likelihood")
    one = verbs.add_parser("score")
    one.add_argument("folder", type=Path)
    one.add_argument("estimate", type=Path)
    one = verbs.add_parser("table")
    one.add_argument("folder", type=Path)
    given = parser.parse_args()
    if given.verb == "write":
        for name in given.problems.split(","):
            if name not in PROBLEMS:
                parser.error(f"no problem {name!r}; expected some of {', '.join(PROBLEMS)}")
            print(write(given.folder, name))
    elif given.verb == "fit":
        fit(given.folder, given.method)
    elif given.verb == "table":
        table(given.folder)
    else:
        for key, value in score(given.folder, given.estimate).items():
            print(f"{key:14} {value:.4g}")


if __name__ == "__main__":
    main()
