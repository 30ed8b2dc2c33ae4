"""`estimate_from_records`: estimate the FRFs of ``[records]``, and look for faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from updyn.arrays import RealArray
from updyn.errors import InputError, key_path
from updyn.frf import FRF
from updyn.io import read_records
from updyn.job.base import Document
from updyn.job.files import existing_file
from updyn.job.records_table import RecordsTable, SetupTable
from updyn.signals.cutting import cut_records
from updyn.signals.estimate import FRFEstimate, frf_estimate
from updyn.signals.estimators import ESTIMATORS
from updyn.signals.joining import joined_frfs
from updyn.signals.quality import RecordFinding, check_records
from updyn.signals.records import Records, as_records, chain_records
from updyn.signals.windows import ImpactWindow

__all__ = ["RecordedFRFs", "RecordedSetup", "estimate_from_records"]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedSetup:
    """The records of one setup; `rejected` has reasons by number (from 1), `findings` faults."""

    files: tuple[str, ...]
    records: Records
    rejected: Mapping[int, str]
    findings: tuple[RecordFinding, ...]

    @property
    def name(self) -> str:
        """Its files, for messages."""
        return ", ".join(self.files)

    @property
    def open_findings(self) -> tuple[RecordFinding, ...]:
        """Findings about records that are not rejected."""
        return tuple(one for one in self.findings if one.record not in self.rejected)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFRFs:
    """FRFs of time records, of all setups in the order of the job.

    `spectrum`, (n, 2), is that of the force, as `FRFEstimate.spectra`, if there is only one.
    """

    frf: FRF
    setups: tuple[RecordedSetup, ...]
    spectrum: RealArray | None


def estimate_from_records(job: Document, table: RecordsTable) -> RecordedFRFs:
    """Read the records of a job, check them for faults, and estimate FRFs.

    An `InputError` with the key of the job is raised if a file cannot be read, a channel is not in
    it, or a pair of DOFs was measured twice.
    """
    setups: list[RecordedSetup] = []
    found: list[FRFEstimate] = []
    for number, setup in enumerate(table.setups):
        with _locate_error(table, number):
            one = _read_setup(job, table, setup)
            found.append(_estimate_setup(table, setup, one))
            setups.append(one)
    with key_path("records"):
        frf = joined_frfs([one.frf for one in found], [one.name for one in setups])
    spectra = found[0].spectra
    is_one = len(found) == 1 and spectra.shape[1] == 2
    return RecordedFRFs(frf, tuple(setups), spectra if is_one else None)


def _read_setup(job: Document, table: RecordsTable, setup: SetupTable) -> RecordedSetup:
    assert setup.file is not None
    parts = []
    for file in setup.file:
        path = existing_file(job, file, "records", "file")
        with key_path("reader"):
            found = read_records(path, **_reader_options(setup))
        parts.append(as_records(found).calibrate(setup.units, setup.factors))
    records = chain_records(parts)
    if table.cut is not None:
        before = table.cut.length / 20.0 if table.cut.before is None else table.cut.before
        force = _list_channels(setup.excitation)[0]
        with key_path("cut"):
            records = cut_records(records, force, table.cut.length, before, table.cut.level)
    segment = table.segment
    if segment is None and ESTIMATORS[table.estimator].is_local:  # a continuous force
        segment = records.values.shape[2] * records.step
    findings = check_records(
        records, list(_list_channels(setup.excitation)), band=table.band, segment=segment
    )
    return RecordedSetup(setup.file, records, setup.reject or {}, findings)


def _reader_options(setup: SetupTable) -> dict[str, Any]:
    options = dict(setup.reader or {})
    if setup.format is not None:
        options["format"] = setup.format
    return options


def _list_channels(channels: Mapping[str, str] | tuple[str, ...] | None) -> tuple[str, ...]:
    return tuple(channels or ())


def _estimate_setup(table: RecordsTable, setup: SetupTable, one: RecordedSetup) -> FRFEstimate:
    window: str | ImpactWindow | None = table.window
    if table.impact is not None:
        window = ImpactWindow(**table.impact.model_dump())
    assert setup.excitation is not None
    return frf_estimate(
        one.records,
        setup.excitation,
        responses=setup.responses,
        estimator=table.estimator,
        window=window,
        segment=table.segment,
        overlap=table.overlap,
        reject=one.rejected,
        band=table.band,
    )


@contextmanager
def _locate_error(table: RecordsTable, number: int) -> Iterator[None]:
    """Assign the key in the job to an error: in its setup, or common to all setups."""
    try:
        yield
    except InputError as error:
        key = error.key or ("file",)
        if key[0] in ("reader", "records"):
            # The error names no option, or an option that is also a key of the job.
            rest = key[1:] or ("file",)
            key = rest if rest[0] in ("file", "format") else key
        if key[:2] == ("cut", "excitation"):
            key = key[1:]
        error.key = (*table.place(number, str(key[0])), *key[1:])
        raise
