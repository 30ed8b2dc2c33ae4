"""`plan`: choose sensors, forces and band before a test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from updyn.dofs import Dof, DofSet
from updyn.errors import key_path
from updyn.model import Model
from updyn.planning.candidates import check_count, find_candidates
from updyn.planning.choice import Choice
from updyn.planning.criteria import CRITERIA, Planning
from updyn.planning.expected import Expected
from updyn.planning.information import Candidates, PairInformation, check_size
from updyn.planning.options import (
    Band,
    Draws,
    check_quantity,
    check_unknowns,
    find_bands,
    find_lines,
    find_noise,
    find_wanted,
)
from updyn.planning.result import BandWorth, Plan
from updyn.planning.screening import is_many, screened
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection

__all__ = ["LINES", "ROBUST", "plan"]

#: Lines where none are stated.
LINES = 200
#: Draws of the start where their number is not stated.
ROBUST = 4


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
    lines: int | ArrayLike = LINES,
    noise: Mapping[str, float] | None = None,
    interest: str | Iterable[str] | None = None,
    robust: int = ROBUST,
    off: float = 0.2,
    seed: int = 0,
    compare: bool = False,
    say: Callable[[str], object] | None = None,
) -> Plan:
    """Choose sensors and forces out of candidates, before a test, for the unknowns of a model.

    Parameters
    ----------
    model : Model
        The model as it is known before the test.
    parameters : ParameterSet or Selection
        The unknowns that the test is to determine, from `updyn.parameters`.
    candidates : None, str or iterable of str or Dof
        Where sensors may be: labels and globs such as ``"*:Z"``, or ``"all"`` DOFs. None: all
        translational DOFs, or all where none is translational.
    n_sensors, n_references : int
        Number of sensors and of forces.
    band : (float, float), or sequence of (float, float)
        In Hz. Of several bands the one is chosen that leaves the unknowns least uncertain, each
        measured with as many lines.
    criterion : str
        ``"d-optimal"``: smallest volume of the confidence ellipsoid; ``"a-optimal"``: smallest mean
        variance, each relative to its least. For comparison, by mode shapes alone:
        ``"effective-independence"``, ``"mac"``, ``"driving-point-residue"``.
    reference_candidates : None, str or iterable of str or Dof
        Where forces may act. None: as for `candidates`.
    quantity : {"receptance", "mobility", "accelerance"}
        What is measured.
    lines : int or array_like of float
        Number of lines, evenly spaced over the band, or lines in Hz, of which those in the band
        count.
    noise : mapping, optional
        ``relative`` and ``floor`` of the FRFs that are to be measured: E|dH|^2 = (relative |H|)^2 +
        (floor rms)^2, the rms over all candidate channels of one unit. By default 5 % and 0.1 %,
        as for `updyn.identifiability`.
    interest : str or iterable of str, optional
        Names or globs of the unknowns that count; the others are fitted all the same. By default
        all.
    robust : int
        Starts to draw besides; the layout is that of the largest mean score over all of them. 0:
        for the start alone, in a fifth of the time; where the truth is off it may be no better than
        a classical layout.
    off : float
        How far these are off: standard deviation of the logarithm of each unknown.
    seed : int
        Of the draws.
    compare : bool
        Whether to choose by the other criteria as well, and to state how much worse they are.
    say : callable, optional
        Called with a text before each long step: one for each start in each band.

    Returns
    -------
    Plan
        Layout, expected standard deviations, worth of each sensor, force and part of the band.

    Raises
    ------
    InputError
        If a candidate is not in the model, there are fewer candidates than are to be chosen, an
        option is not usable, or the layout leaves unknowns undetermined; the message names them.
    SolverError
        If the model cannot be solved at a line.

    Notes
    -----
    Of more than 40,000 pairs of a sensor and a force (200 of each), those candidates are kept that
    a reduced model shows to tell most at a few lines, and the layout is chosen among them; the
    result says so.

    Each line is factorised once for all candidates. Noise that is independent between channels
    makes the Fisher information of a layout a sum over its pairs; log det of it is maximised by
    greedy choice and exchange (Fedorov, Theory of Optimal Experiments, 1972, chapter 3; for sensors
    Udwadia, J. Eng. Mech. 120 (1994) 368; Papadimitriou, J. Sound Vib. 278 (2004) 923). Standard
    deviations are then those of the exact Jacobian of the chosen layout.

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
    expected, draws = find_noise(noise), Draws(robust, off, seed)
    wanted = find_wanted(interest, unknowns)
    start = chosen.start_of(model)

    found: list[Choice] = []
    for one in find_bands(band):
        freq = find_lines(lines, one)
        sought = Candidates.compile(
            start, unknowns, responses, references, freq, quantity, expected
        )
        points = draws.points(sought.part.coordinates)
        if rule.by_information and is_many(sought):
            sought = screened(sought, points, rule, wanted, (n_sensors, n_references), say or str)
        else:
            check_size(sought, len(points))
            sought = sought.levelled()
        information = PairInformation.compute(sought, points, say or str)
        planning = Planning(sought, information, wanted)
        with key_path("criterion"):
            layout = rule.choose(planning, n_sensors, n_references)
        found.append(Choice.ordered(one, planning, layout, rule))
    best = min(found, key=lambda choice: choice.radius)
    bands = [BandWorth(*choice.band, choice.radius / best.radius - 1.0) for choice in found]
    return replace(
        _expected(best, criterion),
        bands=tuple(bands) if len(bands) > 1 else (),
        rivals=tuple(best.rivals(criterion)) if compare else (),
        draws=robust,
        off=off,
        seed=seed,
        screened=_left_out(best, responses, references),
    )


def _left_out(choice: Choice, responses: DofSet, references: DofSet) -> str:
    """Return how many candidates were left out before the choice, in words; empty if none."""
    kept = choice.planning.candidates
    if len(kept.responses) == len(responses) and len(kept.references) == len(references):
        return ""
    return (
        f"chosen among {len(kept.responses)} of {len(responses)} candidate sensors and"
        f" {len(kept.references)} of {len(references)} candidate forces, those that tell most by a"
        " reduced model"
    )


def _expected(choice: Choice, criterion: str) -> Plan:
    """Return a chosen layout with what is expected of it."""
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
        doubled=expected.doubled(),
        wanted=tuple(names[i] for i in choice.planning.wanted),
        parameters=expected.part.coordinates.parameters,
        model=layout.model,
        std_range=expected.std_range(),
    )
