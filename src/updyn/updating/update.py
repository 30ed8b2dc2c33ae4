"""`update` and `update_jointly`: from models, measurements and unknowns to results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from updyn.dofs import Dof
from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.progress import Stage, shown_progress
from updyn.updating.fit.methods import make_method
from updyn.updating.fit.monitor import JUDGE, Progress
from updyn.updating.judge.assessment import at_start
from updyn.updating.judge.identifiability import Analysis, Identifiability
from updyn.updating.problem.data import Test, check
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.tests import problem_of
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.run import RunOptions, run

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "identifiability",
    "joint_identifiability",
    "start_analysis",
    "update",
    "update_jointly",
]


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
    accuracy: float = ACCURACY,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    **options: Any,
) -> UpdateResult:
    """Fit the unknowns of a model to measured FRFs, or to measured modes.

    Parameters
    ----------
    model : Model
        The model to start from.
    frf : FRF or ModeSet
        The measurement, FRFs or modes. Every response and reference, or every DOF of the modes, has
        to be one of the model. Of modes, frequencies, shapes and, where the damping of a group is
        unknown, loss factors are fitted, by the methods maximum-likelihood and modal.
    parameters : ParameterSet or Selection
        The unknowns, from `updyn.parameters`; or what `updyn.select` or `updyn.cluster` made of
        them.
    method : str
        ``"maximum-likelihood"`` (default), ``"log"``, ``"output-error"`` or ``"equation-error"``
        (the paper's); or one of the field's, for comparison (docs/methods.md).
    lines : None, str or array_like of float
        Lines to fit: all, ``"d-optimal:40"``, ``"a-optimal:40"`` or, for some unknowns,
        ``"a-optimal:40:shaft.*"``, or a list in Hz.
    noise : None, str or mapping
        None: from the data's variance, else coherence, else estimated from the residual, sensor by
        sensor where they differ. A mapping with ``relative`` and/or ``floor`` states E|dH|^2 =
        (relative |H|)^2 + (floor rms)^2; ``"variance"``, ``"coherence"``, ``"estimated"``,
        ``"estimated-by-channel"`` force one source, as does ``source`` in a mapping.
        ``robust="student-t"`` in a mapping gives outliers less weight, whatever the source. Of
        modes: None takes the standard deviations that come with them, and estimates what there is
        beyond; a mapping with ``frequency``, ``shape``, ``loss_factor`` states them, as shares, and
        with ``scale`` how exact shapes are in size that are scaled to unit modal mass, which else
        does not count.
    engine : None, int, dask.distributed Client or Engine
        Where lines, and the tries of the search, are worked on: here one after the other, in so
        many processes on this machine, or on a cluster. The result does not depend on it.
    callback : callable, optional
        Called with a `Progress` after every step and between blocks of lines; returning True stops
        the run, with status ``"stopped"`` and the best values so far.
    validation : iterable of str or Dof, or (float, float), optional
        Responses, or a band in Hz, held out of the fit and scored afterwards. Of modes, a band.
    title : str
        For the record.
    tier : {"dense", "sparse", "reduced"}, optional
        How the model is solved; by default chosen by size. ``"reduced"`` (above 600 DOFs) fits
        inside a reduced model whose error is bounded where the fit ends.
    backend : str, optional
        Sparse factorisation.
    accuracy : float
        Of the reduced tier: the largest error of a receptance, as a share of the largest of its
        line.
    checkpoint : path, optional
        File that receives every evaluation as it is made (read `resume`). It stays; remove it once
        the result is safe.
    resume : bool
        Go on with the run that `checkpoint` holds, however it ended: with the same answer, to the
        last bit, as if it had not been interrupted. Everything has to be as it was but `engine` and
        ``max_iterations``. Where the file is not there, the run begins anew, with a warning.
    regularise : None, str or float, optional
        Pull the unknowns without a prior to their start, by a common strength: ``"gcv"``,
        ``"l-curve"`` or ``"discrepancy"`` choose it, a number states it (1 / standard deviation of
        a prior). ``"tsvd"`` fits only along the directions that the data determine, ``"tsvd:12"``
        along 12. Methods maximum-likelihood, log, output-error and equation-error.
    progress : bool
        Whether to show a bar on a terminal or in a notebook, and plain lines elsewhere (on
        stderr).
    **options
        Options of the method: ``max_iterations``, ``tolerance``; ``starts``, ``seed``
        (maximum-likelihood, log); ``solver`` (equation-error).

    Returns
    -------
    UpdateResult
        The status states whether the fit failed; no error is raised for that.

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together, or the checkpoint to resume is of
        another run.
    SolverError
        If the model cannot be solved at a line where it starts.

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
    test = Test(model, frf, "", lines, noise, validation)
    how = RunOptions(
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
    with _watched(callback, progress, method, options) as watching:
        (result,) = run([test], parameters, replace(how, callback=watching))
    return result


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
    accuracy: float = ACCURACY,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    regularise: str | float | None = None,
    progress: bool = False,
    **options: Any,
) -> JointResult:
    """Fit the unknowns of several models to the FRFs and modes of several tests of one structure.

    The same structure is tested in several configurations: rotor locked and free, dish up and down,
    with and without an added mass. Each has its model, with the same group names, its data and its
    noise; there is one set of unknowns. FRFs of one test and modes of another count by their
    likelihoods; modes that were identified from FRFs that are fitted, too, would count twice.

    Parameters
    ----------
    tests : sequence of Test
        At least one; names differ. What an unknown acts on has to be in the model of one of them,
        not of all.
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
        If models, data, unknowns or options do not fit together, or the checkpoint to resume is of
        another run.
    SolverError
        If a model cannot be solved at a line where it starts.

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
    listed = list(tests) if isinstance(tests, Iterable) else []
    if not listed or not all(isinstance(test, Test) for test in listed):
        raise OptionError("update_jointly: expected a sequence of at least one Test")
    named: dict[str, Test] = {}
    for number, test in enumerate(listed, 1):
        name = test.name or f"test {number}"
        if name in named:
            raise OptionError(f"update_jointly: two tests are called {name!r}")
        named[name] = replace(test, name=name)
    how = RunOptions(
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
    with _watched(callback, progress, method, options) as watching:
        results = run(list(named.values()), parameters, replace(how, callback=watching))
    return JointResult(dict(zip(named, results, strict=True)), title)


@contextmanager
def _watched(
    callback: Callable[[Progress], bool | None] | None,
    progress: bool,
    method: str,
    options: Mapping[str, Any],
) -> Iterator[Callable[[Progress], bool | None] | None]:
    """Return the callback of a run: that of the caller, and what shows the progress."""
    if not progress:
        yield callback
        return
    stages = [Stage(name, most_steps) for name, most_steps in make_method(method, options).stages]
    with shown_progress([Stage("start"), *stages, Stage(JUDGE)]) as show:

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
    """Return what a measurement could determine, at the start of the unknowns and before any fit.

    Parameters
    ----------
    model, frf, parameters, lines, noise
        As for `update`. Where neither `noise` nor the data state the noise, 5 % of |H| and a floor
        of 0.1 % of the rms are assumed; of modes 1 % of a frequency, 10 % of a shape, 20 % of a
        loss factor.

    Returns
    -------
    Identifiability

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
    """Return what several tests together could determine, at the start of the unknowns.

    Parameters
    ----------
    tests : sequence of Test
        At least one; what they hold out counts as data here.
    parameters : ParameterSet or Selection
        The unknowns.

    Returns
    -------
    Identifiability

    Raises
    ------
    InputError
        If models, data, unknowns or options do not fit together.
    SolverError
        If a model cannot be solved at a line.
    """
    return start_analysis(tests, parameters).report


def start_analysis(tests: Sequence[Test], parameters: ParameterSet | Selection) -> Analysis:
    """Return `joint_identifiability` with the numbers behind it.

    Parameters
    ----------
    tests, parameters
        As for `joint_identifiability`.

    Returns
    -------
    Analysis

    Raises
    ------
    InputError, SolverError
        As `joint_identifiability`.
    """
    chosen = Selection.of(parameters)
    tests = [replace(test, model=chosen.start_of(test.model)) for test in tests]
    check(tests, chosen.parameters)
    analysis, advice = at_start(*problem_of(tests, chosen.parameters))
    return replace(analysis, report=replace(analysis.report, advice=advice))
