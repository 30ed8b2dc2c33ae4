"""`update` and `update_jointly`: from models, measurements and unknowns to results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

from updyn.dofs import Dof
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.progress import RunStage, display_progress
from updyn.updating.fit.methods import make_method
from updyn.updating.fit.monitor import CAUSES, JUDGE, Progress
from updyn.updating.fit.start_problem import ReducedStart, build_start_problem
from updyn.updating.judge.assessment import analyse_start
from updyn.updating.judge.identifiability import Analysis, Identifiability
from updyn.updating.problem.data import Test, check_tests, name_tests
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.run import run
from updyn.updating.setup import RunOptions

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "identifiability",
    "joint_identifiability",
    "start_analysis",
    "update",
    "update_jointly",
]


@overload
def update(
    model: Model,
    frf: FRF | ModeSet,
    parameters: ParameterSet | Selection,
    method: str = "maximum-likelihood",
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float | str] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    **options: Any,
) -> UpdateResult: ...
@overload
def update(
    model: Model,
    frf: Sequence[FRF],
    parameters: ParameterSet | Selection,
    method: str = "maximum-likelihood",
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float | str] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    **options: Any,
) -> JointResult: ...
def update(
    model: Model,
    frf: FRF | ModeSet | Sequence[FRF],
    parameters: ParameterSet | Selection,
    method: str = "maximum-likelihood",
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float | str] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    **options: Any,
) -> UpdateResult | JointResult:
    """Fit the unknowns of a model to measured FRFs, or to measured modes.

    Parameters
    ----------
    model : Model
        The model before the update.
    frf : FRF, ModeSet or sequence of FRF
        The measurement, FRFs or modes, or the FRFs of several force levels (`FRF.level`), which are
        fitted together as by `update_jointly`. Every response and reference, or every DOF of the
        modes, has to be a DOF of the model. With modes, the frequencies and shapes are fitted, and
        the loss factors if the damping of a group is unknown, by the methods maximum-likelihood and
        modal.
    parameters : ParameterSet or Selection
        The unknowns, from `updyn.parameters`, `updyn.select` or `updyn.cluster`.
    method : str
        ``"maximum-likelihood"`` (default), ``"log"``, ``"output-error"`` or ``"equation-error"``
        (the paper's); or a published method, for comparison (docs/methods.md).
    lines : None, str or array_like of float
        Lines to fit: all, ``"d-optimal:40"``, ``"a-optimal:40"`` or, for some unknowns,
        ``"a-optimal:40:shaft.*"``, or a list in Hz. A line at 0 Hz is left out, with a warning, if
        the model is free, as its response there is not defined.
    noise : None, str or mapping
        For FRFs, None takes the variance of the data, otherwise the coherence, otherwise an
        estimate from the residual, for each sensor if sensors differ. A mapping with ``relative``
        and/or ``floor`` states E|dH|^2 = (relative |H|)^2 + (floor rms)^2. ``"variance"``,
        ``"coherence"``, ``"estimated"``, ``"estimated-by-channel"`` force one source, as does
        ``source`` in a mapping. ``robust="student-t"`` in a mapping gives outliers less weight,
        for any source. For modes, None takes their standard deviations and estimates the noise in
        excess of them. A mapping with ``frequency``, ``shape``, ``loss_factor`` states relative
        standard deviations; ``scale`` states that of the size of shapes scaled to unit modal mass,
        which is otherwise not fitted.
    engine : None, int, dask.distributed Client or Engine
        Where lines and tries of the search are evaluated: None for this process, a number of
        processes on this machine, or a cluster. The result does not depend on it.
    callback : callable, optional
        Called with a `Progress` after every step and between blocks of lines; a return value of
        True stops the run, with status ``"stopped"`` and the best values so far.
    validation : iterable of str or Dof, or (float, float), optional
        Responses, or a band in Hz, held out of the fit and scored afterwards; for modes, a band.
    title : str
        Title of the update.
    tier : {"dense", "sparse", "reduced"}, optional
        How the model is solved; by default chosen by size. ``"reduced"`` (above 600 DOFs; for
        modes above 3,000) fits in a reduced model whose error is bounded at the estimate. Modes
        have no ``"dense"``.
    backend : str, optional
        Sparse factorisation.
    accuracy : float
        Largest error of a receptance in the reduced tier, relative to the largest of its line.
    checkpoint : path, optional
        File that receives every evaluation (see `resume`). It is not deleted after the run.
    resume : bool
        Whether to continue the run in `checkpoint`, however it ended. The answer is the same, to
        the last bit, as without the interruption. Only `engine` and ``max_iterations`` may differ
        from the first run. If the file does not exist, the run begins anew, with a warning.
    regularise : None, str or float, optional
        Pull the unknowns without a prior to their start, with a common strength: ``"gcv"``,
        ``"l-curve"`` or ``"discrepancy"`` choose it, a number states it (1 / standard deviation of
        a prior). ``"tsvd"`` fits only along the directions that the data determine, ``"tsvd:12"``
        along 12. Methods maximum-likelihood, log, output-error and equation-error.
    progress : bool
        Whether to show a progress bar on a terminal or in a notebook, and plain lines elsewhere (on
        stderr).
    base : iterable of str or Dof, optional
        For transmissibilities: DOFs of the model that move together as the rigid base, the
        reference among them (`FRF`).
    force : str or Dof, optional
        For transmissibilities between two sensors: DOF of the only force (`FRF`).
    **options
        Options of the method: ``max_iterations``, ``tolerance``; ``starts``, ``seed``
        (maximum-likelihood, log); ``solver`` (equation-error).

    Returns
    -------
    UpdateResult, or JointResult for a sequence
        Its status states whether the fit failed; a failed fit raises no error.

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together, or the checkpoint to resume belongs
        to another run.
    SolverError
        If the model cannot be solved at its start, at one of the lines.

    Warns
    -----
    UpdynWarning
        If model and FRF have positions, and nodes with equal numbers are far from each other;
        `updyn.match` matches them by position.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> result.status, round(result.values["part3.stiffness"], 2)
    ('converged', 0.9)
    """
    if base is not None or force is not None:
        if not isinstance(frf, FRF):
            raise OptionError("base and force: modes have none; leave them out")
        frf = frf.with_excitation(base, force)
    if isinstance(frf, list | tuple):
        tests = [
            Test(model, one, name, lines, noise, validation)
            for one, name in zip(frf, _name_levels(frf), strict=True)
        ]
    else:
        tests = [Test(model, frf, "", lines, noise, validation)]  # type: ignore[arg-type]
    run_options = RunOptions(
        method,
        options,
        engine=engine,
        title=title,
        tier=tier,
        backend=backend,
        accuracy=accuracy,
        checkpoint=checkpoint,
        resume=resume,
        regularise=regularise,
    )
    with _combine_callbacks(callback, progress, method, options) as combined:
        results = run(tests, parameters, replace(run_options, callback=combined))
    if isinstance(frf, list | tuple):
        return JointResult({t.name: r for t, r in zip(tests, results, strict=True)}, title)
    return results[0]


def _name_levels(frfs: Sequence[FRF]) -> list[str]:
    """Return names for the tests of several levels: ``"level 5 N"``, numbered if they are equal."""
    if not frfs:
        raise OptionError("update: expected at least one FRF, found an empty sequence")
    for number, frf in enumerate(frfs, 1):
        if not isinstance(frf, FRF):
            raise OptionError(f"update: item {number} is a {type(frf).__name__}; expected an FRF")
    names = [frf.level_text or "level not stated" for frf in frfs]
    return [
        f"{name}, test {i}" if names.count(name) > 1 else name for i, name in enumerate(names, 1)
    ]


def update_jointly(
    tests: Sequence[Test],
    parameters: ParameterSet | Selection,
    method: str = "maximum-likelihood",
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    **options: Any,
) -> JointResult:
    """Fit the unknowns of several models to the FRFs and modes of several tests of one structure.

    The same structure is tested in several configurations: rotor locked and free, dish up and down,
    with and without an added mass. Each configuration has its model, with the same group names, its
    data and its noise; all share one set of unknowns. FRFs of one test and modes of another are
    combined by their likelihoods. Do not fit FRFs together with modes identified from them, because
    the same data would count twice.

    Parameters
    ----------
    tests : sequence of Test
        At least one, with different names. The group of an unknown has to be in the model of at
        least one test.
    parameters : ParameterSet or Selection
        The unknowns.
    method, engine, callback, title
        As for `update`.
    tier, backend, accuracy, checkpoint, resume, regularise, progress, **options
        As for `update`. The reduced tier is chosen by the largest of the models.

    Returns
    -------
    JointResult
        One `UpdateResult` for each test, with the same values.

    Raises
    ------
    InputError
        If models, data, unknowns or options do not fit together, or the checkpoint to resume
        belongs to another run.
    SolverError
        If a model cannot be solved at its start, at one of the lines.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> halves = [frf.select(references=[r]) for r in frf.references.labels]
    >>> tests = [updyn.Test(model, h, name=n) for h, n in zip(halves, ["a", "b"], strict=True)]
    >>> joint = updyn.update_jointly(tests, unknowns, starts=0)
    >>> joint.status, round(joint.values["part3.stiffness"], 2)
    ('converged', 0.9)
    """
    named = name_tests(tests, "update_jointly", "test")
    run_options = RunOptions(
        method,
        options,
        engine=engine,
        title=title,
        tier=tier,
        backend=backend,
        accuracy=accuracy,
        checkpoint=checkpoint,
        resume=resume,
        regularise=regularise,
    )
    with _combine_callbacks(callback, progress, method, options) as combined:
        results = run(list(named.values()), parameters, replace(run_options, callback=combined))
    return JointResult(dict(zip(named, results, strict=True)), title)


@contextmanager
def _combine_callbacks(
    callback: Callable[[Progress], bool | None] | None,
    progress: bool,
    method: str,
    options: Mapping[str, object],
) -> Iterator[Callable[[Progress], bool | None] | None]:
    """Yield the callback of a run, which combines that of the caller with the progress display."""
    if not progress:
        yield callback
        return
    stages = [
        RunStage(name, most_steps) for name, most_steps in make_method(method, options).stages
    ]
    with display_progress([RunStage("start"), *stages, RunStage(JUDGE), RunStage(CAUSES)]) as show:

        def both(step: Progress) -> bool | None:
            show(step)
            return None if callback is None else callback(step)

        yield both


def identifiability(
    model: Model,
    frf: FRF | ModeSet,
    parameters: ParameterSet | Selection,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float | str] | str | None = None,
) -> Identifiability:
    """Return the identifiability of the unknowns from a measurement, at their start.

    Parameters are those of `update`. If neither `noise` nor the data state the noise, 5 % of |H|
    and a floor of 0.1 % of the rms are assumed; for modes 1 % of a frequency, 10 % of a shape, 20 %
    of a loss factor.

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together.
    SolverError
        If the model cannot be solved at a line.
    """
    return joint_identifiability([Test(model, frf, "", lines, noise)], parameters)


def joint_identifiability(
    tests: Sequence[Test], parameters: ParameterSet | Selection
) -> Identifiability:
    """Return the identifiability of the unknowns from several tests together, at their start."""
    # Held-out data count as data here.
    return start_analysis(tests, parameters).report


def start_analysis(
    tests: Sequence[Test],
    parameters: ParameterSet | Selection,
    noises: Mapping[str, NoiseModel] = MappingProxyType({}),
    starts: Mapping[str, ReducedStart] = MappingProxyType({}),
) -> Analysis:
    """Return the analysis on which `joint_identifiability` is based; it raises the same errors.

    `noises` and `starts` are noise models and reduced models by test name; those of other tests
    are chosen and built.
    """
    chosen = Selection.of(parameters)
    tests = [replace(test, model=chosen.start_of(test.model)) for test in tests]
    check_tests(tests, chosen.parameters)
    problem, found = build_start_problem(tests, chosen.parameters, noises, starts)
    analysis, advice = analyse_start(problem, found)
    return replace(analysis, report=replace(analysis.report, advice=advice))
