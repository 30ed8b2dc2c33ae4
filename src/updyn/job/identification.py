"""``[modes]`` of a job, and `modes_job`: identify modes from the FRFs of its test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Strict

from updyn.arrays import RealArray
from updyn.errors import JobError, key_path
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.io import write_modes
from updyn.job.base import Table, is_number
from updyn.job.folder import check_out, default_out
from updyn.job.job_table import JobTable
from updyn.job.prepare import read_measurement
from updyn.job.schema import Job
from updyn.job.settings import MODE_PICK
from updyn.modal import ModeSet, identify_modes
from updyn.modal.identify import identify_with_picks
from updyn.outputs.switch import open_folder, replace_files

__all__ = ["MODES", "MODES_FILES", "ModesTable", "modes_job"]

#: Files that ``updyn modes`` writes.
MODES_FILES = ("modes.html", "modes.unv")


def _parse_picks(given: object) -> object:
    if isinstance(given, list | tuple) and given and all(is_number(x) and x > 0 for x in given):
        return tuple(float(x) for x in given)
    raise ValueError("expected an array of frequencies in Hz, such as [11.9, 23.6]")


class ModesTable(Table):
    """``[modes]``: how modes are identified, which are picked, and which poles are added."""

    damping: Literal["structural", "viscous"] = "structural"
    pick: Annotated[tuple[float, ...], BeforeValidator(_parse_picks), Strict(False)] | None = None
    poles: Annotated[tuple[float, ...], BeforeValidator(_parse_picks), Strict(False)] | None = None


class _ModesJobTable(JobTable):
    """``[modes]``: the work of ``updyn modes``; an update identifies modes itself."""

    schema = ModesTable

    def outputs(self, table: ModesTable) -> tuple[str, ...]:
        return ()


MODES = _ModesJobTable()


def modes_job(
    job: Job, out: str | Path | None = None, say: Callable[[str], None] | None = None
) -> ModeSet:
    """Identify the modes of a job's test and write ``modes.html`` and ``modes.unv`` to `out`.

    The job has one test and may lack ``[modes]``. `say` is called with a sentence for each picked
    pole that is refined to a mode. Nothing is written if a `JobError` (bad input or folder, no mode
    near a pick, or a pole converges to another mode) or `DataError` (no mode) is raised.
    """
    from updyn.report.identified import write_modes_page

    table = job.table(ModesTable) or ModesTable()
    with job.located():
        if len(job.parts) > 1:
            raise JobError("modes are identified from one test; keep one [[test]]", key=("test", 1))
    out = check_out(job, out or default_out(job, "modes"), MODES_FILES)
    with job.located():
        frf: FRF = read_measurement(job)
        picked = _pick_modes(frf, identify_modes(frf, damping=table.damping), table, say)
    title = job.find_title()
    with open_folder(out):
        check_out(job, out, MODES_FILES)  # again, now that no other run can change the folder
        with replace_files(out, "modes", MODES_FILES) as new:
            write_modes_page(
                picked.modes,
                frf,
                new / "modes.html",
                f"{title}: modes",
                poles=picked.poles,
                left_out=picked.left_out,
            )
            write_modes(picked.modes, new / "modes.unv", geometry=_find_positions(frf))
    return picked.modes


def _find_positions(frf: FRF) -> Geometry | None:
    """Return the geometry of the test, if it has all sensors and no local directions."""
    found = frf.geometry
    if found is None or found.axes is not None:
        return None
    nodes = np.concatenate([frf.responses.nodes, frf.references.nodes])
    return found if np.isin(nodes, found.nodes).all() else None


@dataclass(frozen=True, slots=True, eq=False)
class _PickedModes:
    """The picked modes, refined poles included, and the modes left out.

    `poles` has for each mode the frequency (Hz) of the pole it was refined from, or None.
    """

    modes: ModeSet
    poles: list[float | None]
    left_out: ModeSet | None


def _pick_modes(
    frf: FRF, found: ModeSet, table: ModesTable, say: Callable[[str], None] | None
) -> _PickedModes:
    """Return the picked modes, including modes refined from picked poles."""
    poles: list[float] = list(table.poles or ())
    at: list[float] = []  # frequencies of the modes
    with key_path("modes", "poles"):
        _check_unique(poles, "two are the pole at")
    with key_path("modes", "pick"):
        for frequency in table.pick or ():
            pole = _find_pole(found, frequency)
            if pole is None:
                at.append(_find_mode(found, frequency))
            else:
                poles.append(pole)
        _check_unique(poles, "two picks are the pole at")
        _check_unique(at, "two picks are nearest to the mode at")
    number = [-1] * len(found)
    if poles:
        with key_path("modes", "pick" if table.poles is None else "poles"):
            found, number = identify_with_picks(frf, None, table.damping, poles)
    refined = [k for k, n in enumerate(number) if n >= 0]
    automatic = np.array([k for k, n in enumerate(number) if n < 0], dtype=np.intp)
    if table.pick is not None:
        nearest = {_find_nearest(found.frequency[automatic], f) for f in at}
        automatic = automatic[np.isin(found.frequency[automatic], list(nearest))]
    kept = sorted([*automatic.tolist(), *refined])
    if say is not None:
        for k in refined:
            say(_describe_refinement(found, k, poles[number[k]]))
    given = [poles[number[k]] if k in refined else None for k in kept]
    rest = [k for k in range(len(found)) if k not in kept]
    return _PickedModes(found.select(kept), given, found.select(rest) if rest else None)


def _check_unique(frequencies: list[float], what: str) -> None:
    """Refuse a frequency that is listed twice."""
    for frequency in frequencies:
        if frequencies.count(frequency) > 1:
            raise JobError(f"{what} {frequency:.6g} Hz; leave one")


def _find_pole(found: ModeSet, frequency: float) -> float | None:
    """Return the frequency of the picked pole; None if a mode was picked."""
    # A click gives the frequency to seven digits; a frequency written by hand means the nearest
    # mode, or a peak without a mode if that is nearer.
    diagram = found.diagram
    if diagram is None:
        return None
    peaks = found.unexplained
    if len(peaks):
        peak = _find_nearest(peaks, frequency)
        mode = _find_nearest(found.frequency, frequency)
        if abs(peak - frequency) <= min(MODE_PICK.mode_distance * frequency, abs(mode - frequency)):
            return peak
    stable = diagram.frequency[diagram.stable]
    clicked = stable[np.abs(stable / frequency - 1.0) < MODE_PICK.clicked_distance]
    width = found.frequency * found.loss_factor
    if not len(clicked):
        return None
    if (np.abs(found.frequency - clicked[0]) < MODE_PICK.separate_distance * width).any():
        return None
    return float(clicked[0])


def _find_mode(found: ModeSet, frequency: float) -> float:
    at = _find_nearest(found.frequency, frequency)
    if abs(at - frequency) <= MODE_PICK.mode_distance * frequency:
        return at
    text = (
        f"no mode is found within {100 * MODE_PICK.mode_distance:g} % of {frequency:g} Hz; the"
        f" nearest is at {at:.6g} Hz"
    )
    diagram = found.diagram
    if diagram is not None and diagram.stable.any():
        near = _find_nearest(diagram.frequency[diagram.stable], frequency)
        text += f", the nearest stable pole of the diagram at {near:.7g} Hz"
    if len(found.unexplained):
        peak = _find_nearest(found.unexplained, frequency)
        text += f", the nearest peak without a mode at {peak:.6g} Hz"
    raise JobError(text)


def _find_nearest(values: RealArray, frequency: float) -> float:
    return float(values[int(np.argmin(np.abs(values - frequency)))])


def _describe_refinement(found: ModeSet, k: int, pole: float) -> str:
    return (
        f"The pole at {pole:.6g} Hz is refined to a mode at {found.frequency[k]:.6g} Hz"
        f" (standard deviation {found.std_frequency[k]:.2g} Hz) with"
        f" {100.0 * found.damping[k]:.3g} % ({100.0 * found.std_damping[k]:.2g} %) of critical"
        f" damping; it explains {100.0 * found.quality[k]:.1f} % of the residual of the other modes"
        " there."
    )
