"""`frf`: the command that estimates FRFs from time records."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from updyn.arrays import RealArray
from updyn.cli.describe import describe_frf
from updyn.cli.new_file import check_free, write_new
from updyn.cli.settings import DESCRIPTION
from updyn.cli.terminal import DONE, print_text
from updyn.errors import JobError, key_path
from updyn.frf import FRF
from updyn.io import write_frf
from updyn.io.formats import find_format
from updyn.job.base import Document
from updyn.job.load import load_records_job
from updyn.job.recorded import RecordedFRFs, RecordedSetup, estimate_from_records
from updyn.job.records_table import RecordsTable
from updyn.text_table import text_table

__all__ = ["describe_recorded", "frf"]


def frf(
    job: Path,
    /,
    *,
    out: Path | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Estimate FRFs from the time records in [records] of a job, and write them.

    Prints faults of the records and the coherence of each pair. Only records that the job rejects
    are ignored.

    Parameters
    ----------
    job
        The job file (TOML), with a table [records]; it may have those of an update, too.
    out
        File to write; by default that of the key output. Its suffix selects the format.
    force
        Replace the file if it exists.
    """
    loaded, table = load_records_job(job)
    target = _find_target(loaded, table, out)
    with loaded.located():
        with key_path("records", "output"):
            check_free([target], force=force)
            find_format(target, "write_frf")
        found = estimate_from_records(loaded, table)
    write_new(target, lambda path: write_frf(found.frf, path), force=force)
    print_text(f"{describe_recorded(found)}\n\n{target}: {found.frf!r}")
    return DONE


def _find_target(job: Document, table: RecordsTable, out: Path | None) -> Path:
    """Return the file to write, which must differ from all files to read."""
    if out is None and table.output is None:
        with job.located():
            raise JobError("[records] names no output; add one, or --out FILE", key=("records",))
    target = out if out is not None else job.beside(str(table.output))
    inputs = [job.path]
    for setup in table.setups:
        inputs += [job.beside(file) for file in setup.file or ()]
    for path in inputs:
        if os.path.realpath(path) == os.path.realpath(target):
            with job.located():
                raise JobError(f"{target}: is a file to read", key=("records", "output"))
    return target


def describe_recorded(found: RecordedFRFs) -> str:
    """Return the findings about records, and coherence or noise of their FRFs, as text."""
    texts = [_setup_text(setup) for setup in found.setups]
    texts.append(describe_frf(found.frf))
    if found.frf.coherence is not None:
        texts.append(_coherence_table(found.frf))
    elif found.frf.variance is not None:
        texts.append(_deviation_table(found.frf))
    return "\n\n".join(texts)


def _setup_text(setup: RecordedSetup) -> str:
    records = setup.records
    n, channels, samples = records.values.shape
    texts = [
        f"{setup.name}: {n} records of {channels} channels, {samples} samples in"
        f" {samples * records.step:g} s"
    ]
    for number, why in sorted(setup.rejected.items()):
        texts.append(f"  record {number} is left out: {why}")
    for one in setup.findings:
        texts.append(f"  {one.statement}")
        if one.record not in setup.rejected:
            texts.append(f"    {one.remedy}")
    if not setup.findings:
        texts.append("  nothing found that is wrong with them")
    return "\n".join(texts)


def _deviation_table(frf: FRF) -> str:
    """Return a table of the standard deviation of each pair relative to |H|, highest first."""
    assert frf.variance is not None
    size = np.maximum(np.abs(frf.values), np.finfo(float).tiny)
    share = np.sqrt(frf.variance) / size

    def cells(column: RealArray) -> list[str]:
        values = np.median(column), np.quantile(column, 0.95)
        return [f"{100.0 * value:.2g} %" for value in values]

    header = ("median standard deviation", "of 95 % of lines, below")
    return _pair_table(frf, share, -1.0, header, cells, "of lower median standard deviation")


def _coherence_table(frf: FRF) -> str:
    """Return a table of the coherence of each pair, lowest first."""
    assert frf.coherence is not None

    def cells(column: RealArray) -> list[str]:
        lowest = int(np.argmin(column))
        return [
            f"{np.median(column):.3f}",
            f"{column[lowest]:.3f} at {frf.freq[lowest]:g} Hz",
            f"{100.0 * np.mean(column < DESCRIPTION.low_coherence):.1f} %",
        ]

    header = ("median coherence", "lowest", f"lines below {DESCRIPTION.low_coherence:g}")
    return _pair_table(frf, frf.coherence, 1.0, header, cells, "of higher median coherence")


def _pair_table(
    frf: FRF,
    values: RealArray,
    sign: float,
    header: tuple[str, ...],
    cells: Callable[[RealArray], list[str]],
    rest: str,
) -> str:
    """Return a table of the pairs with the smallest (`sign` 1) or largest (-1) medians.

    `values` has shape (n_f, n_i, n_j). `cells` returns the further columns from the values of a
    pair, `header` names them, `rest` describes the omitted pairs.
    """
    flat = values.reshape(len(frf.freq), -1)
    order = np.argsort(sign * np.median(flat, axis=0), kind="stable")
    rows = []
    for at in order[: DESCRIPTION.table_rows].tolist():
        response, reference = divmod(at, len(frf.references))
        pair = [str(frf.responses[response]), str(frf.references[reference])]
        rows.append([*pair, *cells(flat[:, at])])
    table = text_table(("response", "reference", *header), rows, left=(0, 1))
    if len(order) > DESCRIPTION.table_rows:
        table += f"\n... {len(order) - DESCRIPTION.table_rows} more pairs, {rest}"
    return table
