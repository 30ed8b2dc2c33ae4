"""`write_start_pages`: the pages of ``check`` and ``correlate``, written before any fit."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation import Correlation, correlate
from updyn.correlation.model_modes import ModelModes
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.job.folder import check_out, default_out
from updyn.job.prepared import Prepared, PreparedTest
from updyn.job.schema import Job
from updyn.model import Model
from updyn.outputs.switch import open_folder, replace_files
from updyn.updating.fit.reducing import is_reduced
from updyn.updating.fit.start_problem import ReducedStart
from updyn.updating.judge.counterparts import Counterparts, find_counterparts
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.level_model import respond_as_measured
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection

if TYPE_CHECKING:
    from updyn.report.start import Start
    from updyn.updating.judge.causes.finding import Finding
    from updyn.updating.judge.identifiability import Analysis

__all__ = [
    "StartAgreement",
    "StartModel",
    "agreements_at_start",
    "choose_noise_once",
    "choose_tier",
    "compute_start_frf",
    "counterparts_at_start",
    "start_correlation",
    "start_folder",
    "start_model",
    "start_models",
    "write_start_pages",
]


def choose_noise_once(ready: Prepared) -> Prepared:
    """Return a job with the noise models of its FRFs, which take a while to estimate."""
    return replace(ready, tests=tuple(map(_choose_noise_of, ready.tests)))


def _choose_noise_of(test: PreparedTest) -> PreparedTest:
    """Return a test with its noise model; without one if it has a validation set, or modes."""
    # With a validation set, the data of the fit and all data have different models.
    if not isinstance(test.data, FRF) or test.fitted is not test.data:
        return test
    with test.job.located():
        return replace(test, noise=choose_noise(test.job.noise, test.data))


def start_model(test: PreparedTest, unknowns: ParameterSet | Selection) -> Model:
    """Return the model of a test with the unknowns at their start values."""
    chosen = Selection.of(unknowns)
    return chosen.parameters.at_start(chosen.start_of(test.model))


@dataclass(frozen=True, slots=True, eq=False)
class StartModel:
    """The model of a test at the start of the unknowns, with what several tables need of it.

    `modes` are its modes, `reduced` the reduced model for its FRFs, both computed at first use;
    None for modes as data and for nonlinear elements.
    """

    modes: ModelModes
    reduced: ReducedStart | None = None

    @classmethod
    def of(cls, test: PreparedTest, unknowns: ParameterSet | Selection) -> StartModel:
        """Return the model of a test."""
        modes = ModelModes(start_model(test, unknowns))
        if not isinstance(test.data, FRF) or modes.model.nonlinear:
            return cls(modes)
        chosen, backend = Selection.of(unknowns), test.job.method.backend
        model = chosen.start_of(test.model)
        return cls(modes, ReducedStart(model, test.data, chosen.parameters, backend))

    @property
    def model(self) -> Model:
        """The model."""
        return self.modes.model


def start_models(ready: Prepared, unknowns: ParameterSet | Selection) -> dict[str, StartModel]:
    """Return the models at the start of the unknowns, by test name."""
    return {test.name: StartModel.of(test, unknowns) for test in ready.tests}


def compute_start_frf(test: PreparedTest, start: StartModel) -> FRF:
    """Return the FRF of a model at the start values of its unknowns, at all lines of a test.

    If the model is reduced, the other lines that the page draws are included, so that one reduced
    model serves all.
    """
    from updyn.report.data import fine_grid

    frf, tier, lines = test.frf, choose_tier(test), test.frf.freq
    if tier == "reduced" and test.job.output.report:
        drawn = frf.freq[frf.freq > 0.0]
        lines = np.union1d(lines, fine_grid([start.model], drawn, reduced=True))
    if tier == "reduced" and start.reduced is not None:
        return start.reduced.respond(lines)
    backend = test.job.method.backend
    return respond_as_measured(start.model, frf, lines, tier=tier, backend=backend)


def start_correlation(test: PreparedTest, computed: FRF) -> Correlation:
    """Correlate the result of `compute_start_frf` with all FRFs of a test."""
    return correlate(computed.select(lines=test.frf.freq), test.frf)


def choose_tier(test: PreparedTest) -> str | None:
    """Return how the model of a test with FRFs is solved: as an update would."""
    method = test.job.method
    if is_reduced(method.tier, test.model.n_dofs, len(test.frf.freq), method.name):
        return "reduced"
    return method.tier


@dataclass(frozen=True, slots=True, eq=False)
class StartAgreement:
    """FRFs of a model at the start of its unknowns, and their agreement with the data of the fit.

    `computed` is the result of `compute_start_frf`, `figures` as `Correlation.figures`; `modes` are
    those of test and model, if they are known.
    """

    computed: FRF
    figures: Mapping[str, float]
    modes: ModalTable | None = None

    @classmethod
    def of(
        cls, test: PreparedTest, computed: FRF, modes: ModalTable | None = None
    ) -> StartAgreement:
        """Return the agreement of the result of `compute_start_frf`."""
        fitted = test.fitted
        assert isinstance(fitted, FRF)
        at_fitted = computed.select(lines=fitted.freq, responses=fitted.responses)
        return cls(computed, correlate(at_fitted, fitted).figures(), modes)


def agreements_at_start(
    ready: Prepared, starts: Mapping[str, StartModel]
) -> dict[str, StartAgreement]:
    """Return the agreement by test name; none for modes or if the model cannot be solved."""
    found: dict[str, StartAgreement] = {}
    for test in ready.tests:
        if isinstance(test.data, FRF):
            with suppress(SolverError):
                found[test.name] = StartAgreement.of(
                    test, compute_start_frf(test, starts[test.name])
                )
    return found


def counterparts_at_start(
    ready: Prepared, starts: Mapping[str, StartModel]
) -> dict[str, Counterparts]:
    """Return the number of modes with a counterpart in the model, by test name."""
    return {
        test.name: find_counterparts(starts[test.name].modes, test.data, test.modes)
        for test in ready.tests
    }


def start_folder(job: Job, work: str, out: Path | None = None) -> Path:
    """Return the folder of the pages, after checking that they may be written there.

    Parameters
    ----------
    job : Job
        The job.
    work : str
        ``"check"`` or ``"correlate"``.
    out : Path, optional
        The folder; by default the job's stem followed by the command, next to the job.

    Returns
    -------
    Path

    Raises
    ------
    JobError
        If the folder cannot be used.
    """
    return check_out(job, out or default_out(job, work), _list_pages(job, work))


def write_start_pages(
    ready: Prepared,
    work: str,
    folder: Path,
    selection: Selection | None,
    analysis: Analysis,
    findings: Mapping[str, Sequence[Finding]],
    agreements: Mapping[str, StartAgreement],
    counterparts: Mapping[str, Counterparts] | None = None,
    starts: Mapping[str, StartModel] | None = None,
) -> list[Path]:
    """Write a page for each test of a job before any fit.

    Parameters
    ----------
    ready : Prepared
        The job.
    work : str
        ``"check"`` or ``"correlate"``.
    folder : Path
        From `start_folder`.
    selection : Selection or None
        Clustered and selected unknowns.
    analysis : Analysis
        Identifiability of the unknowns, from `updyn.job.run.job_analysis`.
    findings : mapping of str to sequence of Finding
        Probable faults of the data, by test name.
    agreements : mapping of str to StartAgreement
        From `agreements_at_start`.
    counterparts : mapping of str to Counterparts, optional
        From `counterparts_at_start`.
    starts : mapping of str to StartModel, optional
        From `start_models`; by default, they are computed anew.

    Returns
    -------
    list of Path
        The pages: ``check.html`` or ``correlate.html`` in the folder; for several tests, in
        folders of their names.
    """
    from updyn.report import write_start

    starts = starts or start_models(ready, selection or ready.parameters)
    names = _list_pages(ready.job, work)
    with open_folder(folder):
        check_out(ready.job, folder, names)  # again, now that no other run can change the folder
        with replace_files(folder, work, names) as new:
            for test, name in zip(ready.tests, names, strict=True):
                (new / name).parent.mkdir(exist_ok=True)
                faults = findings.get(test.name, ())
                agreement = agreements.get(test.name)
                model = starts[test.name].modes
                start = _make_start(ready, test, model, selection, analysis, faults, agreement)
                start = replace(start, counterparts=(counterparts or {}).get(test.name))
                write_start(start, new / name)
    return [folder / name for name in names]


def _list_pages(job: Job, work: str) -> list[str]:
    """Return the names of the pages, relative to their folder."""
    if len(job.parts) == 1:
        return [f"{work}.html"]
    return [f"{part.test.name}/{work}.html" for part in job.parts]


def _make_start(
    ready: Prepared,
    test: PreparedTest,
    model: ModelModes,
    selection: Selection | None,
    analysis: Analysis,
    findings: Sequence[Finding],
    agreement: StartAgreement | None,
) -> Start:
    from updyn.report.start import Start

    job = test.job
    chosen = Selection.of(selection or ready.parameters)
    title = ready.title
    responses, band = _find_validation_set(test)
    return Start(
        model=model.model,
        data=test.data,
        parameters=chosen.parameters,
        identifiability=analysis.report,
        covariance=_mask_undetermined(analysis),
        findings=tuple(findings),
        matching=str(test.matching),
        title=f"{title}: {test.name}" if test.name else title,
        lines=_find_fitted_lines(test),
        validation_responses=responses,
        validation_band=band,
        modes=test.modes,
        options={"tier": choose_tier(test) if isinstance(test.data, FRF) else job.method.tier},
        figures=agreement.figures if agreement else {},
        job=shlex.quote(ready.job.path.name),
        computed=agreement.computed if agreement else None,
        table=agreement.modes if agreement else None,
        model_modes=model,
    )


def _find_validation_set(test: PreparedTest) -> tuple[tuple[str, ...], tuple[float, float] | None]:
    """Return the responses and the band of FRFs in the validation set."""
    held: Any = test.job.validation
    if not held or not isinstance(test.data, FRF) or not isinstance(test.fitted, FRF):
        return (), None
    if isinstance(held[0], str):
        kept = set(test.fitted.responses.labels)
        return tuple(label for label in test.data.responses.labels if label not in kept), None
    return (), (float(held[0]), float(held[1]))


def _find_fitted_lines(test: PreparedTest) -> RealArray:
    """Return the frequency lines of the fit; empty for modes or if the fit selects them."""
    if not isinstance(test.fitted, FRF) or isinstance(test.job.method.lines, str):
        return np.empty(0)
    given = test.job.lines_to_fit
    return np.asarray(test.fitted.freq if given is None else given, dtype=np.float64)


def _mask_undetermined(analysis: Analysis) -> RealArray:
    """Return the covariance with inf in the rows and columns of undetermined unknowns."""
    out = np.array(analysis.covariance)
    out[analysis.involved, :] = np.inf
    out[:, analysis.involved] = np.inf
    return out
