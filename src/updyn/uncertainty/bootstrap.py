"""Bootstrap: data are made anew as often as wanted, and the unknowns fitted to each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, choose_engine
from updyn.errors import OptionError, SolverError, suggest
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.likelihood import Gaussian, Point, furthest
from updyn.uncertainty.progress import Progress, WorkCounter
from updyn.uncertainty.restored import WITH_NOISE, RestoredFit, restore
from updyn.uncertainty.surrogate import Surrogate, reduced_about
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Session, Stopped
from updyn.updating.result import JointResult, UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["RESAMPLING", "bootstrap"]

_Vector = NDArray[np.float64]
_Complex = NDArray[np.complex128]

RESAMPLING = ("parametric", "residual")
#: A larger share of failed refits is not borne.
_FAILED = 0.05
#: Draws at which the error of a reduced model is taken.
_CHECKED = 4


@dataclass(frozen=True, slots=True, eq=False)
class _Refits:
    """What every refit needs.

    Attributes
    ----------
    problem : Problem
        With the data of the fit.
    strategy : Method
        Without its search.
    noises : tuple of NoiseModel
        As the fit began with.
    x : ndarray of float, shape (n,)
        The estimate.
    H : tuple of ndarray of complex, shape (n_f, n_i, n_j)
        The model's there, by part.
    std : tuple of ndarray of float, of the same shapes
        Of the complex noise that is added.
    whitened : tuple of ndarray of complex, or empty
        Residuals over `std`, to be drawn from; empty: normal noise is drawn.
    run : int
        Lines that are drawn together.
    """

    problem: Problem
    strategy: Any
    noises: tuple[NoiseModel, ...]
    x: _Vector
    H: tuple[_Complex, ...]
    std: tuple[NDArray[np.float64], ...]
    whitened: tuple[_Complex, ...]
    run: int


def bootstrap(
    result: UpdateResult | JointResult,
    n: int = 200,
    seed: int = 0,
    kind: str = "parametric",
    *,
    accuracy: float = ACCURACY,
    engine: int | Client | Engine | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
) -> Draws:
    """Fit the unknowns to data made anew, many times.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit by ``"maximum-likelihood"``, ``"log"`` or ``"output-error"``.
    n : int
        Number of refits.
    seed : int
        Of the noise; refit number i is the same whatever `n`.
    kind : {"parametric", "residual"}
        ``"parametric"``: the answer of the updated model plus normal noise of the variance that the
        fit has found, inflation included (Efron & Tibshirani, An Introduction to the Bootstrap,
        1993, section 6.5). ``"residual"``: plus residuals of the fit, over their standard
        deviation, drawn with replacement in runs of lines as long as the residual is correlated
        (Kuensch, Ann. Stat. 17 (1989) 1217); for noise that is not normal.
    accuracy : float
        Large models are refitted in a reduced model about the estimate, of this error
        (`updyn.update`).
    engine : None, int, dask.distributed Client or Engine
        Where refits are made, as for `updyn.update`; the draws do not depend on it.
    callback : callable, optional
        Called with a `Progress` after every refit; returning True stops, and what has been drawn is
        returned.

    Returns
    -------
    Draws
        One chain. Refits that fail are counted in ``failed`` and named in ``message``.

    Raises
    ------
    OptionError
        If an option is not understood, or the method of the result has no likelihood.
    SolverError
        If the model cannot be solved at the estimate.

    Notes
    -----
    Refits start at the estimate, by the method of the result without its search, and estimate the
    noise again where the fit did. A prior is data too: its centre is drawn anew about the estimate,
    so that the spread is that of the posterior where the model is linear (Bardsley et al., SIAM J.
    Sci. Comput. 36 (2014) A1895). The bootstrap is not consistent for an unknown on its bound
    (Andrews, Econometrica 68 (2000) 399); use `updyn.profile` there.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 2:
        raise OptionError(f"n = {n!r}: expected a number of refits from 2 up")
    if kind not in RESAMPLING:
        raise OptionError(f"kind {kind!r}: {suggest(str(kind), RESAMPLING)}")
    with ExitStack() as ending:
        made = choose_engine(engine)
        if made is not engine:
            ending.callback(made.close)
        session = Session(made)
        setting = restore(result, session, WITH_NOISE)
        watch = WorkCounter("bootstrap", int(n), callback)
        watch.attach(session)
        found: list[tuple[str, _Vector]] = []
        acceleration = np.zeros(len(setting.names))
        figures: dict[str, Any] = {}
        try:
            surrogate, setting = reduced_about(setting, accuracy, seed)
            acceleration = _acceleration(setting)
            refits = _refits(setting, kind)
            items = [(seed, number) for number in range(n)]
            spread = not setting.problem.spreads
            for one in session.map(_refit, refits, items, spread=spread):
                found.append(one)
                if watch.step():
                    break
            figures = _checked(surrogate, [x for reason, x in found if not reason], accuracy)
        except Stopped:
            pass
    return _draws(
        result,
        setting,
        found,
        int(n),
        acceleration,
        {"n": int(n), "seed": seed, "resampling": kind} | figures,
    )


def _refits(setting: RestoredFit, kind: str) -> _Refits:
    H = tuple(part.responses(setting.x) for part in setting.problem.parts)
    std = tuple(np.sqrt(v) for v in setting.variances())
    whitened: tuple[_Complex, ...] = ()
    if kind == "residual":
        std = tuple(s / setting.inflation for s in std)
        # The residual of a fit is smaller than the noise by what the unknowns have taken from it.
        count = 2 * setting.problem.n_values
        scale = np.sqrt(count / max(count - setting.problem.n, 1))
        whitened = tuple(
            scale * (part.frf.values - h) / s
            for part, h, s in zip(setting.problem.parts, H, std, strict=True)
        )
    length = float(setting.first.noise.get("correlation_length", 1.0))
    return _Refits(
        setting.problem,
        setting.strategy(),
        setting.begun(),
        setting.x,
        H,
        std,
        whitened,
        int(np.ceil(length)),
    )


def _refit(refits: _Refits, item: tuple[int, int]) -> tuple[str, _Vector]:
    """Return why a refit failed (nothing where it did not), and where it ended, in the optimiser's coordinates."""
    rng = np.random.default_rng(item)
    problem = _with_priors(refits, rng)
    parts = []
    for i, part in enumerate(problem.parts):
        shape = refits.H[i].shape
        if refits.whitened:
            noise = refits.whitened[i][_lines(rng, shape[0], refits.run)]
        else:
            draw = rng.standard_normal((2, *shape)) / np.sqrt(2.0)
            noise = draw[0] + 1j * draw[1]
        parts.append(
            replace(part, frf=replace(part.frf, values=refits.H[i] + refits.std[i] * noise))
        )
    task = Problem.of(parts)
    try:
        fit = refits.strategy.fit(task, refits.noises, Monitor(task), refits.x)
    except SolverError as error:
        return f"not solved: {error}", refits.x
    return "" if fit.reason == "converged" else fit.reason, fit.x


def _with_priors(refits: _Refits, rng: np.random.Generator) -> Problem:
    """Return the problem with the centres of its priors drawn anew about the estimate."""
    coordinates = refits.problem.coordinates
    weight = coordinates.prior[1]
    if not weight.any():
        return refits.problem
    std = np.where(weight > 0, 1.0 / np.where(weight > 0, weight, 1.0), 0.0)
    centre = np.clip(refits.x + std * rng.standard_normal(len(std)), *coordinates.bounds)
    parameters = coordinates.parameters
    start = np.clip(coordinates.to_values(centre), parameters.lower, parameters.upper)
    drawn = parameters.with_start(np.where(weight > 0, start, parameters.start))
    return Problem.of(
        [
            replace(p, coordinates=replace(coordinates, parameters=drawn))
            for p in refits.problem.parts
        ]
    )


def _lines(rng: np.random.Generator, n_lines: int, run: int) -> NDArray[np.intp]:
    """Return lines drawn with replacement in runs, shape (n_lines,)."""
    run = min(run, n_lines)
    first = rng.integers(0, n_lines - run + 1, -(-n_lines // run))
    return np.asarray((first[:, None] + np.arange(run)).ravel()[:n_lines], dtype=np.intp)


def _acceleration(setting: RestoredFit) -> _Vector:
    """Return the acceleration of BCa intervals, shape (n,): skewness of what each line does to the estimate, over 6.

    By the infinitesimal jackknife over lines: U_l = C J_l^T r_l, a = sum U^3 / (6 (sum U^2)^1.5)
    (Efron 1987, eq. 7.3).
    """
    likelihood = setting.likelihood()
    local = likelihood.local(setting.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    root = Gaussian(likelihood, Point(setting.x, local)).root
    scores = []
    for i, part in enumerate(likelihood.problem.parts):
        one = likelihood.residual.of(i)
        for lines in one.partition(part):
            r, J = one.on(part, lines).block(part, setting.x, lines)
            scores.append(np.einsum("kfij,fij->fk", J, r.conj()).real)
    U = -np.concatenate(scores) @ root @ root.T
    power = np.sum(U**2, axis=0)
    return np.asarray(np.sum(U**3, axis=0) / (6.0 * np.where(power > 0, power, 1.0) ** 1.5))


def _checked(surrogate: Surrogate | None, ended: list[_Vector], accuracy: float) -> dict[str, Any]:
    if surrogate is None or len(ended) < 2:
        return {}
    error = max(surrogate.error(x) for x in furthest(np.array(ended), _CHECKED))
    return {"basis": surrogate.size, "error": error, "accuracy": accuracy}


def _draws(
    result: UpdateResult | JointResult,
    setting: RestoredFit,
    found: list[tuple[str, _Vector]],
    n: int,
    acceleration: _Vector,
    options: dict[str, Any],
) -> Draws:
    coordinates = setting.problem.coordinates
    parameters = coordinates.parameters
    kept = [coordinates.to_values(x) + 0.0 for reason, x in found if not reason]
    values = np.array(kept).reshape(len(kept), len(parameters))
    failed = Counter(reason for reason, _ in found if reason)
    said = []
    if len(found) < n:
        said.append(f"Stopped after {len(found)} of {n} refits.")
    if failed:
        reasons = ", ".join(f"{reason} ({count})" for reason, count in failed.most_common())
        said.append(
            f"{sum(failed.values())} of {len(found)} refits failed: {reasons}; they are not among"
            " the draws."
        )
    enough = sum(failed.values()) <= _FAILED * len(found) and len(kept) > 1
    if not enough:
        said.append("The draws are not to be relied on.")
    bounded = [name for name in setting.names if name in setting.first.at_bound]
    if bounded:
        said.append(
            f"On a bound the bootstrap says little: use a profile for {', '.join(bounded)}."
        )
    if options.get("error", 0.0) > options.get("accuracy", np.inf):
        said.append(
            f"The reduced model errs by {options['error']:.1g} at the furthest draws, not"
            f" {options['accuracy']:g}."
        )
        enough = False
    spread = values.std(axis=0, ddof=1) if len(kept) > 1 else np.full(len(parameters), np.nan)
    count = max(len(kept), 1)
    return Draws(
        "bootstrap",
        tuple(parameters.names),
        values[None],
        coordinates.to_values(setting.x) + 0.0,
        np.array([setting.first.std[name] for name in parameters.names]),
        parameters.lower,
        parameters.upper,
        parameters.is_factor,
        {
            "acceleration": acceleration,
            "mcse_mean": spread / np.sqrt(count),
            "mcse_std": spread / np.sqrt(2.0 * count),
        },
        dict(failed),
        enough,
        " ".join(said),
        options,
        result,
    )
