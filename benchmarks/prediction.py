"""Share of held-out measurements within the 95 % bands of `updyn.predict`.

Sensors that were left out of the fit: two of seven of the measured beam of `updyn demo`; four of 12
of the space frame, of which a stiffness is 10 % wrong and no unknown; and two of random frames and
grids of `discrepancy.py` with one of its errors, or none. The bands are those of a measurement,
with the noise of the fit. Values of a curve are correlated: the standard error of a share is that
of a mean over structures and draws. Updates that did not end at a minimum are counted and left out.

    python benchmarks/prediction.py [beam frame grid space-frame] [--draws 40]
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import discrepancy
import numpy as np
from structures import Noise, bench

import updyn
from updyn.demos import beam
from updyn.errors import UpdynError
from updyn.frf import FRF
from updyn.job import load_job, run_job
from updyn.model import Group, Model
from updyn.uncertainty.restored import AT_MINIMUM
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult

CASES = ("beam", "frame", "grid", "space-frame")
#: Case of a table, held-out measurement, and the update without it.
Held = tuple[str, UpdateResult, FRF]


def beam_cases() -> Iterator[Held]:
    """Yield the measured beam as one part, and in four segments."""
    with tempfile.TemporaryDirectory() as name:
        folder, values = Path(name), {}
        for title in ("one part", "four segments"):
            job = beam.segments_job(values, folder) if values else beam.write_inputs(folder)
            text = job.read_text(encoding="utf-8") + "\n[output]\nreport = false\n"
            job.write_text(text, encoding="utf-8")
            result = run_job(load_job(job), folder / title.replace(" ", "")).result
            values = result.values
            held = result.frf.select(lines=result.lines, responses=list(beam.HELD_OUT))
            yield f"measured beam, {title}", result, held


def random_cases(family: str, draws: int) -> Iterator[Held]:
    """Yield random structures of a family, with each error in turn."""
    errors = discrepancy.ERRORS
    for seed in range(draws):
        error = errors[seed % len(errors)]
        rng = np.random.default_rng([2027, seed])
        case = discrepancy.measured(family, rng)
        moving = [i for i in discrepancy.translations(case.truth) if i not in case.rows]
        held = sorted(int(i) for i in rng.choice(moving, 2, False))
        every = replace(case, rows=case.rows + held)
        H = discrepancy.answer(every, error, rng)
        std = np.hypot(
            discrepancy.RELATIVE * np.abs(H),
            discrepancy.FLOOR * np.sqrt(np.mean(np.abs(H[:, : len(case.rows)]) ** 2)),
        )
        draw = rng.standard_normal((2, *H.shape))
        H = H + std * np.sqrt(0.5) * (draw[0] + 1j * draw[1])
        labels = case.truth.labels
        ends = [labels[i] for i in every.rows], [labels[case.column]]
        frf = FRF(case.freq, H[:, :, None], *ends, "accelerance")
        model, unknowns = _model(case, error, rng)
        noise = {"relative": discrepancy.RELATIVE, "floor": discrepancy.FLOOR}
        fitted = frf.select(responses=[labels[i] for i in case.rows])
        result = updyn.update(model, fitted, unknowns, noise=noise, starts=0)
        kind = "clean" if error == "clean" else "with an error"
        yield f"{family}, {kind}", result, frf.select(responses=[labels[i] for i in held])


def _model(
    case: discrepancy.Measured, error: str, rng: np.random.Generator
) -> tuple[Model, ParameterSet]:
    """Return a start model without the error, and its unknowns."""
    groups, as_viscous = {}, error == "structural as viscous"
    for name, part in case.truth.parts.items():
        given = {"mass": part.M if part.M.any() else None}
        if part.K.any():
            given["stiffness"] = float(np.exp(rng.uniform(-0.2, 0.2))) * part.K
            given["loss_factor"] = 0.02
        if part.K.any() and as_viscous:
            given["viscous"] = part.K * part.loss / (2.0 * np.pi * case.middle)
            given["loss_factor"] = 0.0
        groups[name] = Group(**given)
    model = Model.from_groups(groups, case.truth.labels)
    sprung = [name for name, part in case.truth.parts.items() if part.K.any()]
    damped = {"viscous": sprung} if as_viscous else {"loss_factor": sprung}
    return model, updyn.parameters(model, stiffness=sprung, **damped)


def space_frame_cases(draws: int) -> Iterator[Held]:
    """Yield the space frame with one stiffness 10 % too low or too high and no unknown."""
    case, noise = bench("space frame"), Noise(0.02, 1e-3)
    true, clean = case.case.true, case.case.clean
    labels = list(clean.responses.labels)
    held = labels[1::3]
    names = [name for name, group in true.groups.items() if group.stiffness is not None]
    for seed in range(draws):
        rng = np.random.default_rng([seed, 11])
        wrong, factor = str(rng.choice(names)), float(rng.choice([0.9, 1.1]))
        changed = true.scaled({wrong: {"stiffness": factor}}).group(wrong)
        start = Model({**case.start(rng, 0.2).groups, wrong: changed}, true.dofs)
        others = [name for name in names if name != wrong]
        unknowns = updyn.parameters(start, stiffness=others, mass="all", loss_factor="all")
        frf = noise.added(clean, rng)
        fitted = frf.select(responses=[label for label in labels if label not in held])
        stated = {"relative": noise.relative, "floor": noise.floor}
        result = updyn.update(start, fitted, unknowns, noise=stated, starts=0)
        yield "space frame, with an error", result, frf.select(responses=held)


def find_cases(name: str, draws: int) -> Iterator[Held]:
    if name == "beam":
        return beam_cases()
    if name == "space-frame":
        return space_frame_cases(draws)
    return random_cases(name, draws)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", choices=[*CASES, []])
    parser.add_argument("--draws", type=int, default=44)
    given = parser.parse_args()
    print(f"{'held-out data':<32}{'updates':>8}{'within':>16}{'median width, dB':>18}")
    for name in given.cases or CASES:
        shares: dict[str, list[tuple[float, float]]] = {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", updyn.UpdynWarning)
            for title, result, held in find_cases(name, given.draws):
                if result.status not in AT_MINIMUM:
                    print(f"{title}: {result.status}; not used", flush=True)
                    continue
                ends = held.freq, list(held.responses), list(held.references)
                try:
                    band = updyn.predict(result, *ends, noise=True)
                except UpdynError as error:
                    print(f"{title}: {error}")
                    continue
                with np.errstate(divide="ignore", over="ignore"):
                    width = np.median(20.0 * np.log10(band.upper / band.lower))
                shares.setdefault(title, []).append((float(band.covers(held).mean()), width))
        for title, found in shares.items():
            share, width = np.mean(found, axis=0)[0], np.median(found, axis=0)[1]
            error = np.std([one for one, _ in found]) / np.sqrt(len(found))
            within = f"{100.0 * share:.1f} +- {100.0 * error:.1f} %"
            print(f"{title:<32}{len(found):>8}{within:>16}{width:>18.2f}", flush=True)


if __name__ == "__main__":
    main()
