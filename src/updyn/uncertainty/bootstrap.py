"""Bootstrap: the unknowns refitted to many sets of generated data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import OptionError, SolverError, suggest
from updyn.uncertainty.counts import check_count
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.likelihood import Gaussian, Point
from updyn.uncertainty.model_error import model_error_of, model_error_remark
from updyn.uncertainty.progress import WorkCounter, WorkProgress
from updyn.uncertainty.restored import STATES_NOISE, RestoredFit, restore, std_of
from updyn.uncertainty.settings import BOOTSTRAP, COUNT_LIMITS
from updyn.uncertainty.surrogate import describe_excess, run_about
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["RESAMPLING", "bootstrap", "merge_draws"]


RESAMPLING = ("parametric", "residual")


@dataclass(frozen=True, slots=True, eq=False)
class _Refits:
    """The shared data of all refits.

    `method` has no search; `x` is the estimate, in the optimiser's coordinates. By part, shape
    (n_f, n_i, n_j): `H` of the model at the estimate, `std` of the complex noise that is added, and
    `whitened`, residuals over `std` to be resampled in blocks of `block` lines; empty for normal
    noise.
    """

    problem: Problem
    method: Any
    noises: tuple[NoiseModel, ...]
    x: RealArray
    H: tuple[ComplexArray, ...]
    std: tuple[RealArray, ...]
    whitened: tuple[ComplexArray, ...]
    block: int


def bootstrap(
    result: UpdateResult | JointResult,
    n: int = 200,
    seed: int = 0,
    kind: str = "parametric",
    *,
    first: int = 0,
    accuracy: float = REDUCTION.accuracy,
    engine: int | Client | Engine | None = None,
    callback: Callable[[WorkProgress], bool | None] | None = None,
) -> Draws:
    """Refit the unknowns to many sets of generated data.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``, ``"log"`` or ``"output-error"``.
    n : int
        Number of refits, up to a million.
    seed : int
        Seed of the noise.
    kind : {"parametric", "residual"}
        ``"parametric"``: the FRF of the updated model plus normal noise with the variance of
        the fit, inflation included (Efron & Tibshirani, An Introduction to the Bootstrap,
        1993, section 6.5). ``"residual"``: plus residuals of the fit, over their standard
        deviation, drawn with replacement in blocks of lines as long as its correlation length
        (Kuensch, Ann. Stat. 17 (1989) 1217); for noise that is not normal.
    first : int
        Number of the first refit. Refit number i depends on `seed` only, so that separate runs of
        different numbers, joined by `merge_draws`, give the draws of one run; with a reduced
        model, to its accuracy.
    accuracy : float
        Large models are refitted in a reduced model about the estimate, of this error
        (`updyn.update`).
    engine : None, int, dask.distributed Client or Engine
        Workers for the refits, as in `updyn.update`; the draws do not depend on it.
    callback : callable, optional
        Called with a `WorkProgress` after every refit; returning True stops with the draws so far.

    Returns
    -------
    Draws
        One chain. Refits that fail are counted in ``failed`` and named in ``message``.

    Raises
    ------
    OptionError
        If an option is invalid, or the method of the result has no likelihood.
    SolverError
        If the model cannot be solved at the estimate.

    Notes
    -----
    Refits start at the estimate and use the method of the result without its search. They estimate
    the noise again if the fit did. A prior counts as data: its centre is drawn about the estimate.
    For a linear model the draws then have the spread of the posterior (Bardsley et al., SIAM J.
    Sci. Comput. 36 (2014) A1895). The bootstrap is not consistent for an unknown on its bound
    (Andrews, Econometrica 68 (2000) 399); use `updyn.profile` there.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> draws = updyn.bootstrap(result, n=20)
    >>> draws.values.shape  # draws, unknowns
    (20, 12)
    """
    n = check_count("n", n, "refits", 2, COUNT_LIMITS.most_draws)
    first = check_count("first", first, "refits", 0, COUNT_LIMITS.most_draws)
    if kind not in RESAMPLING:
        raise OptionError(f"kind {kind!r}: {suggest(str(kind), RESAMPLING)}")
    with opened_engine(engine) as engine_of_run:
        session = Session(engine_of_run)
        restored = restore(result, session, STATES_NOISE)
        counter = WorkCounter("bootstrap", n, callback)
        counter.attach(session)
        found: list[tuple[str, RealArray]] = []
        acceleration = np.zeros(len(restored.names))
        reduction: Mapping[str, Any] = {}
        items = [(seed, number) for number in range(first, first + n)]

        def refit_all(problem: Problem) -> RealArray:
            found.clear()
            counter.done = 0
            solved = restored.with_problem(problem)
            acceleration[:] = _acceleration(solved)
            refits = _prepare_refits(solved, kind)
            for refit in session.map(_refit, refits, items, spread=not problem.is_distributed):
                found.append(refit)
                if counter.step():
                    break
            return np.array([x for reason, x in found if not reason])

        with suppress(Stopped):
            reduction = run_about(restored, accuracy, seed, refit_all)
    options = {"n": n, "seed": seed, "first": first, "resampling": kind, **reduction}
    coordinates = restored.problem.coordinates
    return _make_draws(
        result,
        coordinates.to_values(restored.x) + 0.0,
        [coordinates.to_values(x) + 0.0 for reason, x in found if not reason],
        Counter(reason for reason, _ in found if reason),
        acceleration,
        options,
    )


def merge_draws(parts: Sequence[Draws]) -> Draws:
    """Join draws of several bootstraps of one update.

    Parameters
    ----------
    parts : sequence of Draws
        From `updyn.bootstrap` with different `first` or `seed`, with their update (`Draws.of`, or
        the second argument of `updyn.read_uncertainty`).

    Returns
    -------
    Draws
        All refits, the parts in the order of seed and first number. Consecutive parts of one seed
        give the draws of a single bootstrap.

    Raises
    ------
    OptionError
        If the draws are not from bootstraps of one update by the same resampling, or a refit occurs
        twice.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> result = updyn.update(model, frf, updyn.parameters(model, stiffness="all"), starts=0)
    >>> parts = [updyn.bootstrap(result, n=5, first=first) for first in (0, 5)]
    >>> len(updyn.merge_draws(parts))
    10
    """
    if not parts:
        raise OptionError("merge_draws: expected draws of at least one bootstrap, found none")
    ranges = []
    for number, one in enumerate(parts, 1):
        _check_joinable(parts[0], one, number)
        ranges += [(*piece, number) for piece in _list_ranges(one)]
    ranges.sort()
    for (seed, first, n, part), (other_seed, other_first, _, other) in pairwise(ranges):
        if seed == other_seed and other_first < first + n:
            raise OptionError(
                f"merge_draws: refit {other_first} of seed {seed} is in parts {part} and {other};"
                " expected bootstraps with different first or seed"
            )
    ordered = sorted(parts, key=lambda one: min(_list_ranges(one)))
    worst = max(parts, key=lambda one: one.options.get("error", 0.0))
    merged = {"ranges": [[seed, first, n] for seed, first, n, _ in ranges]}
    options = {**worst.options, "n": sum(one.options["n"] for one in parts), **merged}
    for name in ("seed", "first"):
        options.pop(name, None)
    assert ordered[0].result is not None
    return _make_draws(
        ordered[0].result,
        ordered[0].estimate,
        [values for one in ordered for values in one.values],
        sum((Counter(one.failed) for one in parts), Counter()),
        ordered[0].diagnostics["acceleration"],
        options,
    )


def _check_joinable(first: Draws, other: Draws, number: int) -> None:
    """Refuse draws that cannot be joined with the first ones."""
    if (
        not isinstance(other, Draws)
        or other.kind != "bootstrap"
        or "resampling" not in other.options
    ):
        raise OptionError(f"merge_draws: part {number}, {other!r}, is no bootstrap")
    if other.result is None:
        raise OptionError(
            f"merge_draws: part {number} was read without its update; read it by"
            " updyn.read_uncertainty(path, result)"
        )
    same = first.names == other.names and np.array_equal(first.estimate, other.estimate)
    if not same or first.options["resampling"] != other.options["resampling"]:
        what = "resampling" if same else "update"
        raise OptionError(f"merge_draws: parts 1 and {number} are of a different {what}")


def _list_ranges(draws: Draws) -> list[tuple[int, int, int]]:
    """Return seed, first number and count of the refits of each bootstrap in some draws."""
    options = draws.options
    single = [options.get("seed", 0), options.get("first", 0), options["n"]]
    return [(int(s), int(first), int(n)) for s, first, n in options.get("ranges", [single])]


def _prepare_refits(restored: RestoredFit, kind: str) -> _Refits:
    # The fitted unknowns make the residual smaller than the noise.
    count = 2 * restored.problem.n_values
    scale = np.sqrt(count / max(count - restored.problem.n, 1))
    H, std, whitened = [], [], []
    for part, variance in zip(restored.problem.parts, restored.variances(), strict=True):
        H.append(part.responses(restored.x))
        std.append(np.sqrt(variance))
        if kind == "residual":
            std[-1] = std[-1] / restored.inflation
            whitened.append(scale * (part.frf.values - H[-1]) / std[-1])
    length = float(restored.first.noise.get("correlation_length", 1.0))
    return _Refits(
        restored.problem,
        restored.method(),
        restored.initial_noises(),
        restored.x,
        tuple(H),
        tuple(std),
        tuple(whitened),
        int(np.ceil(length)),
    )


def _refit(refits: _Refits, item: tuple[int, int]) -> tuple[str, RealArray]:
    """Return the reason of failure of a refit (empty if none) and its x, shape (n,)."""
    rng = np.random.default_rng(item)
    problem = _draw_priors(refits, rng)
    parts = []
    for i, part in enumerate(problem.parts):
        shape = refits.H[i].shape
        if refits.whitened:
            noise = refits.whitened[i][_resampled_lines(rng, shape[0], refits.block)]
        else:
            draw = rng.standard_normal((2, *shape)) / np.sqrt(2.0)
            noise = draw[0] + 1j * draw[1]
        frf = replace(part.frf, values=refits.H[i] + refits.std[i] * noise)
        parts.append(replace(part, frf=frf))
    generated = Problem.of(parts)
    try:
        fit = refits.method.fit(generated, refits.noises, Monitor(generated), refits.x)
    except SolverError as error:
        return f"not solved: {error}", refits.x
    if fit.reason == "converged":
        return "", fit.x
    return fit.reason, fit.x


def _draw_priors(refits: _Refits, rng: np.random.Generator) -> Problem:
    """Return the problem with the centres of its priors drawn about the estimate."""
    coordinates = refits.problem.coordinates
    weight = coordinates.prior[1]
    if not weight.any():
        return refits.problem
    std = np.divide(1.0, weight, out=np.zeros(len(weight)), where=weight > 0)
    centre = np.clip(refits.x + std * rng.standard_normal(len(std)), *coordinates.bounds)
    parameters = coordinates.parameters
    start = np.clip(coordinates.to_values(centre), parameters.lower, parameters.upper)
    drawn = parameters.with_start(np.where(weight > 0, start, parameters.start))
    shifted = replace(coordinates, parameters=drawn)
    return Problem.of([replace(part, coordinates=shifted) for part in refits.problem.parts])


def _resampled_lines(rng: np.random.Generator, n_lines: int, block: int) -> IndexArray:
    """Return positions of lines drawn with replacement in blocks, shape (n_lines,)."""
    block = min(block, n_lines)
    first = rng.integers(0, n_lines - block + 1, -(-n_lines // block))
    return np.asarray((first[:, None] + np.arange(block)).ravel()[:n_lines], dtype=np.intp)


def _acceleration(restored: RestoredFit) -> RealArray:
    """Return the acceleration of BCa intervals, shape (n,)."""
    # A sixth of the skewness of the influence of each line on the estimate, by the infinitesimal
    # jackknife over lines: U_l = C J_l^T r_l, a = sum U^3 / (6 (sum U^2)^1.5) (Efron 1987, eq.
    # 7.3).
    likelihood = restored.likelihood()
    local = likelihood.local(restored.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    root = Gaussian(likelihood, Point(restored.x, local)).root
    scores = []
    for i, part in enumerate(likelihood.problem.parts):
        one = likelihood.residual.of(i)
        for lines in one.partition(part):
            r, J = one.on(part, lines).block(part, restored.x, lines)
            scores.append(np.einsum("kfij,fij->fk", J, r.conj()).real)
    U = -np.concatenate(scores) @ root @ root.T
    power = np.sum(U**2, axis=0)
    return np.asarray(np.sum(U**3, axis=0) / (6.0 * np.where(power > 0, power, 1.0) ** 1.5))


def _make_draws(
    result: UpdateResult | JointResult,
    estimate: RealArray,
    succeeded: Sequence[RealArray],
    failed: Counter[str],
    acceleration: RealArray,
    options: dict[str, Any],
) -> Draws:
    """Return the refits that succeeded as draws, with messages on their limitations."""
    update = result.first
    parameters = update.parameters
    values = np.array(succeeded).reshape(len(succeeded), len(parameters))
    n_failed = failed.total()
    n_found = n_failed + len(succeeded)
    reliable = n_failed <= BOOTSTRAP.most_failed_share * n_found and len(succeeded) > 1
    messages = []
    if n_found < options["n"]:
        messages.append(f"Stopped after {n_found} of {options['n']} refits.")
    if failed:
        reasons = ", ".join(f"{reason} ({count})" for reason, count in failed.most_common())
        messages.append(
            f"{n_failed} of {n_found} refits failed: {reasons}; they are not among the draws."
        )
    if not reliable:
        messages.append("The draws are not reliable.")
    bounded = [name for name in parameters.names if name in update.at_bound]
    if bounded:
        messages.append(
            f"The bootstrap is not consistent on a bound: use a profile for {', '.join(bounded)}."
        )
    if errs := describe_excess(options, "the furthest draws"):
        messages.append(errs)
        reliable = False
    if noise_only := model_error_remark(model_error_of(update)):
        messages.append(noise_only)
    spread = np.full(len(parameters), np.nan)
    if len(succeeded) > 1:
        spread = values.std(axis=0, ddof=1)
    count = max(len(succeeded), 1)
    diagnostics = {
        "acceleration": acceleration,
        "mcse_mean": spread / np.sqrt(count),
        "mcse_std": spread / np.sqrt(2.0 * count),
    }
    return Draws(
        kind="bootstrap",
        names=tuple(parameters.names),
        chains=values[None],
        estimate=estimate,
        std=std_of(update),
        lower=parameters.lower,
        upper=parameters.upper,
        is_factor=parameters.is_log & (parameters.lower > 0.0),
        diagnostics=diagnostics,
        failed=dict(failed),
        converged=reliable,
        message=" ".join(messages),
        options=options,
        result=result,
    )
