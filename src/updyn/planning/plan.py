"""`plan`: choose sensors, forces and band before a test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from updyn.dofs import Dof
from updyn.engines import Engine, opened_engine
from updyn.errors import StoppedError, key_path
from updyn.model import Model
from updyn.planning.candidates import check_count, find_candidates
from updyn.planning.choice import Choice
from updyn.planning.criteria import CRITERIA, Criterion, Planning
from updyn.planning.expected import Expected
from updyn.planning.information import Candidates, PairInformation, Stage, check_size
from updyn.planning.options import (
    Band,
    StartDraws,
    check_quantity,
    check_unknowns,
    find_bands,
    find_lines,
    find_noise,
    find_wanted,
)
from updyn.planning.result import BandWorth, Plan, RivalLayout
from updyn.planning.screening import is_many, reduce_candidates, screen_candidates
from updyn.planning.settings import PLANNING
from updyn.updating.fit.checkpoint import Checkpoint, checkpoint_session, fingerprint
from updyn.updating.fit.monitor import Monitor, Progress
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.session import Session, Stopped, digest

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["plan"]


def plan(
    model: Model,
    parameters: ParameterSet | Selection,
    candidates: str | Iterable[str | Dof] | None,
    n_sensors: int,
    n_references: int,
    band: Band | Sequence[Band],
    criterion: str = "d-optimal",
    *,
    reference_candidates: str | Iterable[str | Dof] | None = None,
    quantity: str = "accelerance",
    lines: int | ArrayLike = PLANNING.lines,
    noise: Mapping[str, float] | None = None,
    interest: str | Iterable[str] | None = None,
    robust: int = PLANNING.starts,
    off: float = 0.2,
    seed: int = 0,
    compare: bool = False,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
) -> Plan:
    """Select sensors and forces from candidates before a test, for the parameters of a model.

    Parameters
    ----------
    model : Model
        The model before the test.
    parameters : ParameterSet or Selection
        The parameters that the test is to determine, from `updyn.parameters`.
    candidates : None, str or iterable of str or Dof
        Possible sensors: labels and globs such as ``"*:Z"``, or ``"all"`` DOFs. None: all
        translational DOFs, or all DOFs without any.
    n_sensors, n_references : int
        Number of sensors and of forces.
    band : (float, float), or sequence of (float, float)
        In Hz. Of several bands, that with the smallest uncertainty of the parameters is selected,
        each with the same number of lines.
    criterion : str
        ``"d-optimal"``: smallest volume of the confidence ellipsoid; ``"a-optimal"``: smallest mean
        variance, each relative to its minimum. For comparison, from mode shapes only:
        ``"effective-independence"``, ``"mac"``, ``"driving-point-residue"``.
    reference_candidates : None, str or iterable of str or Dof
        Possible forces. None: as for `candidates`.
    quantity : {"receptance", "mobility", "accelerance"}
        Measured quantity.
    lines : int or array_like of float
        Number of lines, evenly spaced over the band, or lines in Hz, of which those in the band are
        used.
    noise : mapping, optional
        ``relative`` and ``floor`` of the measured FRFs: E|dH|^2 = (relative |H|)^2 + (floor rms)^2,
        with the rms over all candidate channels of one unit. By default 5 % and 0.1 %, as for
        `updyn.identifiability`.
    interest : str or iterable of str, optional
        Names or globs of the parameters of interest; the others are fitted nevertheless. By default
        all.
    robust : int
        Number of additional starts to draw; the layout has the largest mean score over all starts.
        0: for the given start only, in a fifth of the time; if the start is wrong, it may be no
        better than a classical layout.
    off : float
        Distance of these starts: standard deviation of the logarithm of each parameter.
    seed : int
        Seed of the draws.
    compare : bool
        Whether to select by the other criteria as well, and to state the ratio of their results.
    engine : None, int, dask.distributed Client or Engine
        Engine for the lines, as for `updyn.update`; the plan does not depend on it.
    callback : callable, optional
        Called with a `Progress` before each long step and between blocks of lines; returning True
        stops the work, which then raises `updyn.errors.StoppedError`.
    checkpoint : path, optional
        File that receives the results of each start as soon as they are available (see `resume`).
        It is kept; remove it once the plan is saved.
    resume : bool
        Continue the work stored in `checkpoint`, however it ended, to the identical plan. All
        arguments except `engine` and `compare` must be unchanged. If the file is missing, the work
        starts from the beginning, with a warning.

    Returns
    -------
    Plan
        Layout, expected standard deviations, worth of each sensor, force and part of the band.

    Raises
    ------
    InputError
        If a candidate is not in the model, there are fewer candidates than to be selected, an
        option is invalid, the layout leaves parameters undetermined, or the checkpoint to resume
        belongs to other work; the message names them.
    SolverError
        If the model cannot be solved at a line.
    StoppedError
        If the callback stops the work.

    Notes
    -----
    Models above 600 DOFs are reduced for the selection, with a certified error. Of more than 40,000
    pairs of a sensor and a force (200 of each), the most informative candidates at a few lines of a
    reduced model are kept, and the layout is selected from these; the result states this.

    Each line is factorised once for all candidates. Noise that is independent between channels
    Noise that is independent between channels makes the Fisher information of a layout a sum over
    its pairs; log det of it is maximised by greedy selection and exchange (Fedorov, Theory of
    Optimal Experiments, 1972, chapter 3; for sensors Udwadia, J. Eng. Mech. 120 (1994) 368;
    Papadimitriou, J. Sound Vib. 278 (2004) 923). Standard deviations are then those of the exact
    Jacobian of the selected layout.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> unknowns = updyn.parameters(model, stiffness="all")
    >>> layout = updyn.plan(model, unknowns, "all", 2, 1, (0.5, 12.0), robust=0)
    >>> len(layout.responses), len(layout.references)
    (2, 1)
    """
    chosen = Selection.of(parameters)
    unknowns = chosen.parameters
    check_unknowns(unknowns, model)
    responses = find_candidates(model, candidates)
    references = responses
    if reference_candidates is not None:
        references = find_candidates(model, reference_candidates, "reference_candidates")
    check_count(n_sensors, responses, "n_sensors")
    check_count(n_references, references, "n_references")
    with key_path("criterion"):
        rule = CRITERIA.find(criterion)()
    check_quantity(quantity)
    expected, draws = find_noise(noise), StartDraws(robust, off, seed)
    wanted = find_wanted(interest, unknowns)
    start = chosen.start_of(model)

    bands = find_bands(band)
    freqs = [find_lines(lines, one) for one in bands]
    task = _PlanTask(criterion, rule, wanted, (n_sensors, n_references), draws)

    with ExitStack() as stack:
        session = Session(stack.enter_context(opened_engine(engine)))
        all_candidates: list[Candidates] = []
        for freq in freqs:
            about = (responses, references, freq, quantity, expected, session)
            all_candidates.append(Candidates.compile(start, unknowns, *about))
        stack.enter_context(
            checkpoint_session(
                session, checkpoint, lambda: _identify_task(all_candidates, task), resume=resume
            )
        )
        try:
            found = [
                task.choose(*each, callback) for each in zip(bands, all_candidates, strict=True)
            ]
            return task.plan(found, all_candidates[0], callback, compare=compare)
        except Stopped:
            if isinstance(session.cache, Checkpoint):
                session.cache.keep()
            text = "stopped before the end; no layout is selected"
            raise StoppedError(text) from None


_Callback = Callable[[Progress], "bool | None"]


def _identify_task(all_candidates: Sequence[Candidates], task: _PlanTask) -> dict[str, object]:
    """Return the identification of the work, for its checkpoint."""
    first = all_candidates[0]
    description = {
        "candidates": first.responses.labels,
        "reference_candidates": first.references.labels,
        "lines": [digest([one.freq]).hex() for one in all_candidates],
        "quantity": first.quantity,
        "noise": (first.noise.relative, first.noise.floor),
        "criterion": task.criterion,
        "interest": task.wanted,
        "n_sensors": task.counts[0],
        "n_references": task.counts[1],
        "draws": task.draws,
    }
    return fingerprint(Problem.of([first.part]), [], description)


def _make_stage(candidates: Candidates, callback: _Callback | None) -> Stage:
    """Return a context that names the stages of the work in a band and reports them."""
    monitor = Monitor(Problem.of([candidates.part]), callback)

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        with monitor.stage(name):
            candidates.part.session.check()
            yield

    return stage


@dataclass(frozen=True, slots=True)
class _PlanTask:
    """The selection to make: `counts` are the numbers of responses and references."""

    criterion: str
    rule: Criterion
    wanted: tuple[int, ...]
    counts: tuple[int, int]
    draws: StartDraws

    def choose(self, band: Band, candidates: Candidates, callback: _Callback | None) -> Choice:
        stage = _make_stage(candidates, callback)
        points = self.draws.points(candidates.part.coordinates)
        pairs = f"{len(candidates.responses)} x {len(candidates.references)} pairs"
        if self.rule.by_information and is_many(candidates):
            with stage(f"screening of {pairs}"):
                candidates = screen_candidates(
                    candidates, points, self.rule, self.wanted, self.counts
                )
        else:
            check_size(candidates, len(points))
            with stage(f"level of {pairs}"):
                candidates = reduce_candidates(candidates, points).with_level()
        information = PairInformation.compute(candidates, points, stage)
        planning = Planning(candidates, information, self.wanted)
        with stage("layout"), key_path("criterion"):
            layout = self.rule.choose(planning, *self.counts)
            return Choice.sort_by_gain(band, planning, layout, self.rule)

    def plan(
        self,
        found: Sequence[Choice],
        all_candidates: Candidates,
        callback: _Callback | None,
        *,
        compare: bool,
    ) -> Plan:
        """Return the plan for the best of several bands; `all_candidates` are all candidates."""
        best = min(found, key=lambda choice: choice.radius)
        stage = _make_stage(best.planning.candidates, callback)
        bands = [BandWorth(*one.band, one.radius / best.radius - 1.0) for one in found]
        rivals: list[RivalLayout] = []
        if compare:
            with stage("comparison with other criteria"):
                rivals = list(best.rivals(self.criterion))
        with stage("expectation of the layout"):
            return replace(
                _expected_plan(best, self.criterion),
                bands=tuple(bands) if len(bands) > 1 else (),
                rivals=tuple(rivals),
                draws=self.draws.robust,
                off=self.draws.off,
                seed=self.draws.seed,
                screened=_describe_screening(best.planning.candidates, all_candidates),
            )


def _describe_screening(kept: Candidates, all_candidates: Candidates) -> str:
    """Return a text on the number of candidates removed before the selection; empty if none."""
    of = len(all_candidates.responses), len(all_candidates.references)
    if (len(kept.responses), len(kept.references)) == of:
        return ""
    return (
        f"chosen among {len(kept.responses)} of {of[0]} candidate sensors and"
        f" {len(kept.references)} of {of[1]} candidate forces, the most informative ones of a"
        " reduced model"
    )


def _expected_plan(choice: Choice, criterion: str) -> Plan:
    """Return the plan of a selected layout, with its expected results."""
    expected = Expected.of(choice)
    layout, names = expected.layout, expected.part.coordinates.parameters.names
    return Plan(
        criterion=criterion,
        responses=tuple(layout.responses.labels),
        references=tuple(layout.references.labels),
        band=choice.band,
        freq=layout.freq,
        quantity=layout.quantity,
        noise={"relative": layout.noise.relative, "floor": layout.noise.floor},
        variance=expected.variance,
        std=expected.std(),
        radius=choice.radius,
        gain=choice.row_gain,
        reference_gain=choice.column_gain,
        further=choice.further_responses(),
        further_references=choice.further_references(),
        parts=expected.parts_of_band(),
        doubled=expected.doubling_gains(),
        wanted=tuple(names[i] for i in choice.planning.wanted),
        parameters=expected.part.coordinates.parameters,
        model=layout.model,
        std_range=expected.std_range(),
    )
