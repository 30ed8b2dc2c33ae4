"""Time of a family of plants beside that of one, and each member beside the plant made alone.

The azimuth axis of `updyn demo antenna` (`updyn.control.demo`), its unknowns drawn from the
covariance of the update. Processor time, one thread.

    OMP_NUM_THREADS=1 python benchmarks/family.py [--run FOLDER of a finished updyn demo antenna]
    [--members 100] [--errors peak,relative] [--alone 5]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from servo import updated

import updyn
from updyn.control.antiresonances import fill_antiresonances
from updyn.control.demo import BAND, INPUTS, OUTPUTS, QUANTITIES
from updyn.updating.result import UpdateResult


def row(result: UpdateResult, error: str, members: int, alone: int) -> str:
    """Times, and the worst errors of some members and of the plants of the same models alone."""
    about = {"quantity": QUANTITIES, "error": error}
    begin = time.process_time()
    one = updyn.plant(result, INPUTS, OUTPUTS, BAND, **about)
    single = time.process_time() - begin
    begin = time.process_time()
    family = updyn.plant_family(result, INPUTS, OUTPUTS, BAND, n=members, **about)
    whole = time.process_time() - begin
    stated = [p.relative_error if error == "relative" else p.error for p in family.members]
    shared = sum("one basis for all" in p.facts["basis"] for p in family.members)
    apart = 0.0
    freq = np.geomspace(*BAND, 4000)
    for member, values in list(zip(family.members, family.values, strict=True))[:alone]:
        model = result.parameters.apply(result.start, values)
        other = updyn.plant(
            model, INPUTS, OUTPUTS, BAND, route=family.facts["route"], **about
        ).response(freq)
        off = np.abs(member.response(freq).values - other.values)
        level = fill_antiresonances(freq, other.values)  # at an antiresonance the level around it
        if error == "peak":
            level = level.max(axis=0)
        apart = max(apart, float((off / level).max()))
    states = sorted({p.n_states for p in family.members})
    return (
        f"| {error} | {one.n_states} {one.route} | {single:.1f} | {members} |"
        f" {', '.join(map(str, states))} | {whole:.1f} | {whole / single:.1f} | {shared} |"
        f" {100 * max(stated):.2g} | {100 * apart:.2g} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", type=Path)
    parser.add_argument("--members", type=int, default=100)
    parser.add_argument("--errors", default="peak,relative")
    parser.add_argument("--alone", type=int, default=5)
    args = parser.parse_args()
    result = updated(args.run)
    print(
        "| error | one plant | s | members | states | s | times one | in the shared basis | largest"
        f" error, % | first {args.alone} against plants made alone, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for error in args.errors.split(","):
        print(row(result, error, args.members, args.alone), flush=True)


if __name__ == "__main__":
    main()
