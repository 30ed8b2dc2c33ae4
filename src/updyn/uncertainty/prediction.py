"""Predicted FRFs with uncertainty bands, also for lines and DOFs that were not measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.settings import REDUCTION
from updyn.errors import DataError, OptionError, SolverError
from updyn.frf import FRF, TRANSMISSIBILITY, check_lines
from updyn.uncertainty.counts import check_level
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.likelihood import select_furthest
from updyn.uncertainty.magnitude import magnitude_limits
from updyn.uncertainty.model_error import model_error_of
from updyn.uncertainty.posterior import Posterior, find_update, has_likelihood
from updyn.uncertainty.restored import estimate_of, restore, solver_options
from updyn.uncertainty.settings import PREDICTED_BAND, SURROGATE
from updyn.uncertainty.surrogate import Surrogate, describe_excess
from updyn.updating.judge.discrepancy import LocalErrors, estimate_local_errors
from updyn.updating.judge.whitening import whiten_residual
from updyn.updating.problem.noise import Stated, level_by_unit
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.result import JointResult, UpdateResult, find_result, interval_quantile

__all__ = [
    "Band",
    "differentiate_frf",
    "predict",
]


def predict(
    source: UpdateResult | JointResult | Draws,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    *,
    level: float = 0.95,
    noise: bool = False,
    quantity: str | None = None,
    test: str | None = None,
    seed: int = 0,
    accuracy: float = REDUCTION.accuracy,
) -> Band:
    """Predict an FRF with an uncertainty band.

    Parameters
    ----------
    source : UpdateResult, JointResult or Draws
        An update: its Laplace covariance is propagated by exact derivatives (delta method). Draws
        of a bootstrap or a sampling: the model is solved at up to 1000 of them, evenly chosen.
    freq : array_like of float, shape (n_f,)
        Lines in Hz, measured or not.
    responses, references : iterable of str or Dof
        Any DOFs of the model, measured or not.
    level : float
        Share of the probability within, between 0 and 1, at every value by itself.
    noise : bool
        True: the band of a future measurement, with the noise of the fit. False: the band of the
        structure.
    quantity : str, optional
        Quantity of the FRF; by default that of the measurement.
    test : str, optional
        Of several tests, the one whose model is used.
    seed : int
        Seed of the noise that is added to draws.
    accuracy : float
        Where that takes less time, large models are solved in a reduced model about the estimate,
        of this error (`updyn.update`); it is checked at the furthest draws.

    Returns
    -------
    Band

    Raises
    ------
    OptionError
        If an option is not understood, draws read from a file were not given their update
        (`Draws.of`), or the noise of the fit is known at measured values only.
    DofError
        If a response or a reference is no DOF of the model.
    SolverError
        If the model cannot be solved at a line, or the reduced model is not accurate enough.

    Notes
    -----
    The band covers the uncertainty of the unknowns and, with `noise`, of a measurement. If the
    residual shows an error of the model (``noise["model_error"]``), the band covers it as well: the
    error is located as local changes of the dynamic stiffness together with the shift of the
    unknowns that compensates it, and both are propagated [1]; the predicted FRF remains that of the
    updated model. With draws such an error counts as noise at all lines.

    The unknowns change magnitude and phase by d ln H = dH / H; noise and errors of the model are
    added to H, so that the magnitude has a Rice distribution [2]. The quantile is Gaussian, or
    Student's if the noise is estimated from few numbers (`UpdateResult.intervals`). An undetermined
    combination of unknowns makes the band infinite at values that it changes, and does not affect
    the others.

    References
    ----------
    .. [1] Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425, section 4.
    .. [2] Rice, Bell Syst. Tech. J. 24 (1945) 46, section 3.10.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> band = updyn.predict(result, [5.0], ["12:X"], ["1:X"])
    >>> band.level, band.frf.values.shape
    (0.95, (1, 1, 1))
    """
    check_level(level)
    about = find_update(source)
    result = find_result(about, test)
    problem = build_predicted(result, freq, responses, references, quantity, as_read=noise)
    x = problem.coordinates.to_x(estimate_of(result))
    if isinstance(source, Draws):
        X = _select_draws(source, problem)
        problem = _reduce_if_faster(result, problem, x, X, accuracy)
        variance = _noise_variance(result, problem, x) if noise else None
        return _propagate_draws(problem, x, X, source.kind, level, variance, seed)
    posterior, mean_square = Posterior.of(about), None
    errors = find_model_errors(about, posterior)
    if errors is None:
        problem = _reduce_if_faster(result, problem, x, x[None], accuracy)
    else:
        mean_square = errors.mean_square(problem, x, find_test(about, result))
    variance = _noise_variance(result, problem, x, errors) if noise else None
    H, dH = solve_with_slopes(problem, x)
    freedom = result.noise.get("degrees_of_freedom")
    found = find_limits(H, dH, posterior, level, freedom, noise=variance, mean_square=mean_square)
    angle = np.angle(H)
    return Band(
        _frf(problem, H), level, "Laplace", noise,
        found.lower, found.upper, angle - found.turn, angle + found.turn,
        found.std_real, found.std_imag,
    )  # fmt: skip


def find_test(source: UpdateResult | JointResult, result: UpdateResult) -> int:
    """Return the position of the result of a test."""
    return [one is result for one in source.results.values()].index(True)


def find_model_errors(
    source: UpdateResult | JointResult, posterior: Posterior
) -> LocalErrors | None:
    """Return the model errors in the residual; None if it shows none, or has no likelihood."""
    first = source.first
    is_regularised = "regularise" in first.options
    if model_error_of(first) == 0.0 or is_regularised or not has_likelihood(source):
        return None
    restored = restore(source, statuses=[first.status])
    problem, x = restored.whole, restored.x
    residual = whiten_residual(problem, restored.noises(), x)
    undetermined = posterior.null_space / problem.coordinates.slope(x)[:, None]
    sizes = [noise.bulk.size_known for noise in restored.initial_noises()]
    return estimate_local_errors(problem, x, residual, undetermined, size_known=all(sizes))


def differentiate_frf(
    result: UpdateResult,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str | None = None,
) -> tuple[FRF, ComplexArray]:
    """Return the FRF of the updated model and its derivatives by the values of the unknowns.

    The derivatives have the shape (n_f, n_responses, n_references, n).
    """
    if quantity is None and not isinstance(result.data, FRF):
        quantity = "receptance"
    part = build_predicted(result, freq, responses, references, quantity, as_read=False)
    x = part.coordinates.to_x(estimate_of(result))
    part = _reduce_if_faster(result, part, x, x[None], REDUCTION.accuracy)
    H, dH = solve_with_slopes(part, x)
    return _frf(part, H), np.moveaxis(dH, 0, -1)


def build_predicted(
    result: UpdateResult,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str | None,
    *,
    as_read: bool,
) -> FRFPart:
    """Return the model of an update with an FRF to predict, its values zero."""
    lines, rows, columns = check_lines(freq), DofSet(responses), DofSet(references)
    blank = np.zeros((len(lines), len(rows), len(columns)), dtype=np.complex128)
    frf = FRF(lines, blank, rows, columns, quantity or result.frf.quantity)
    if frf.quantity == TRANSMISSIBILITY:
        frf = frf.with_excitation(result.frf.base, result.frf.force)
    # Calibration factors belong to a measurement by the same sensors, not to the structure.
    tier, backend = solver_options(result)
    part = FRFPart.build(result.start, frf, result.parameters, tier=tier, backend=backend)
    return replace(part, as_read=as_read)


def _noise_variance(
    result: UpdateResult, part: FRFPart, x: RealArray, errors: LocalErrors | None = None
) -> RealArray:
    """Return E|dH|^2 of a measurement, shape (n_f, n_i, n_j), in the unit of H squared."""
    kind = result.noise.get("kind")
    if kind in ("variance", "coherence") or not {"relative", "floor"} & set(result.noise):
        raise OptionError(
            f"noise: that of the fit ({kind or 'not known'}) is known at the measured values only;"
            " leave it out of the band, or update with noise that is stated or estimated"
        )
    if result.noise.get("floor") and part.frf.quantity != result.frf.quantity:
        raise OptionError(
            f"noise: its floor is known for {result.frf.quantity}; predict that quantity"
        )
    stated = Stated(float(result.noise.get("relative", 0.0)), float(result.noise.get("floor", 0.0)))
    H = part.responses(x)
    # The floor is relative to the level of the measured FRFs of the same unit.
    measured = result.frf.select(lines=result.lines, responses=result.fitted_responses)
    levels = level_by_unit(measured)[0]
    measured_units, units = _unit_numbers(measured), _unit_numbers(part.frf)
    level = np.zeros(H.shape[1:])
    for at in np.ndindex(*level.shape):
        same_unit = levels[measured_units == units[at]]
        if same_unit.size:
            level[at] = same_unit[0]
        elif stated.floor > 0.0:
            raise OptionError(
                f"noise: nothing was measured in the unit of {part.frf.responses[at[0]]}"
            )
    relative, floor = stated.relative * np.abs(H), stated.floor * level
    return np.asarray((relative**2 + floor**2) * _noise_scale(result, errors))


def _noise_scale(result: UpdateResult, errors: LocalErrors | None) -> float:
    """Return the variance of a measured value over that of the noise model."""
    if errors is not None:
        return errors.noise
    # Serial correlation reduces the information of the data, not the scatter of a single value.
    length = float(result.noise.get("correlation_length", 1.0))
    return float(result.noise.get("inflation", 1.0)) ** 2 / length


def _unit_numbers(frf: FRF) -> NDArray[np.int_]:
    rotates = 2 * (frf.responses.axes >= 3)[:, None] + (frf.references.axes >= 3)[None, :]
    return np.asarray(rotates, dtype=np.int_)


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of magnitudes, half-widths of phases in rad, and standard deviations; equal shapes."""

    lower: RealArray
    upper: RealArray
    turn: RealArray
    std_real: RealArray
    std_imag: RealArray


def find_limits(
    H: ComplexArray,
    dH: ComplexArray,
    posterior: Posterior,
    level: float,
    freedom: int | None,
    *,
    noise: RealArray | None = None,
    mean_square: RealArray | None = None,
) -> Limits:
    """Return the limits of complex values, shape (...), by the delta method.

    `dH`, shape (n, ...), are derivatives by the values of the unknowns; `noise` is E|dH|^2;
    `mean_square`, shape (3, ...), that of errors of the model, unknowns included.
    """
    of_unknowns = np.zeros((3, *H.shape))
    if mean_square is None:
        parts = (dH.real, dH.real), (dH.imag, dH.imag), (dH.real, dH.imag)
        for k, (one, other) in enumerate(parts):
            of_unknowns[k] = np.sum(one * np.tensordot(posterior.covariance, other, axes=1), axis=0)
    added = np.zeros_like(of_unknowns) if mean_square is None else mean_square.copy()
    if noise is not None:
        added[:2] += 0.5 * noise
    size = np.abs(H)
    change = np.abs(np.einsum("k...,kl->l...", dH, posterior.null_space))
    is_open = (change > PREDICTED_BAND.open_change * size).any(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_std = np.where(size > 0.0, np.sqrt(_radial(of_unknowns, H)) / size, 0.0)
        std = np.sqrt(np.where(size > 0.0, _radial(added, H), 0.5 * (added[0] + added[1])))
        turned = np.sqrt(_radial(of_unknowns + added, 1j * H)) / size
    low, high = magnitude_limits(size, std, log_std, level, freedom)
    turn = np.fmin(interval_quantile(level, freedom) * turned, np.pi)
    deviations = np.sqrt(np.where(is_open, np.inf, (of_unknowns + added)[:2]))
    return Limits(
        np.where(is_open, 0.0, low),
        np.where(is_open, np.inf, high),
        np.where(is_open, np.pi, turn),
        deviations[0],
        deviations[1],
    )


def _radial(squares: RealArray, direction: ComplexArray) -> RealArray:
    """Return the mean square along a direction in the complex plane, from those of its parts."""
    unit = direction / np.abs(direction)
    real, imag, product = squares
    found = unit.real**2 * real + unit.imag**2 * imag + 2.0 * unit.real * unit.imag * product
    return np.asarray(np.maximum(found, 0.0))


def solve_with_slopes(part: FRFPart, x: RealArray) -> tuple[ComplexArray, ComplexArray]:
    """Return H and its derivatives by the values of the unknowns, shape (n, n_f, n_i, n_j)."""
    H, dH = [], []
    for block in part.blocks(x):
        H.append(block.H)
        if block.dH is not None:
            dH.append(block.dH)
    slope = part.coordinates.slope(x)[:, None, None, None]
    return np.concatenate(H), np.concatenate(dH, axis=1) / slope


def _select_draws(draws: Draws, part: FRFPart) -> RealArray:
    """Return evenly chosen draws in the optimiser's coordinates, shape (m, n)."""
    values = draws.values
    if len(values) < 2:
        raise OptionError(f"{len(values)} draws are too few for a band")
    even = np.linspace(0, len(values) - 1, min(PREDICTED_BAND.most_draws, len(values)))
    chosen = np.unique(even.round().astype(np.intp))
    return np.array([part.coordinates.to_x(values[i]) for i in chosen])


def _propagate_draws(
    part: FRFPart,
    x: RealArray,
    X: RealArray,
    kind: str,
    level: float,
    noise: RealArray | None,
    seed: int,
) -> Band:
    H, drawn = part.responses(x), np.array([part.responses(one) for one in X])
    if noise is not None:
        normal = np.random.default_rng(seed).standard_normal((2, *drawn.shape)) / np.sqrt(2.0)
        drawn = drawn + np.sqrt(noise) * (normal[0] + 1j * normal[1])
    tails = [0.5 - 0.5 * level, 0.5 + 0.5 * level]
    low, high = np.quantile(np.abs(drawn), tails, axis=0)
    angle = np.angle(H)
    # The branch of each phase that is nearest to the prediction.
    phases = angle + np.angle(drawn * np.exp(-1j * angle))
    phase_low, phase_high = np.quantile(phases, tails, axis=0)
    return Band(
        _frf(part, H), level, kind, noise is not None,
        low, high, phase_low, phase_high,
        drawn.real.std(axis=0, ddof=1), drawn.imag.std(axis=0, ddof=1),
    )  # fmt: skip


def _reduce_if_faster(
    result: UpdateResult, part: FRFPart, x: RealArray, X: RealArray, accuracy: float
) -> FRFPart:
    """Return a part with a reduced model about x, if it takes less time at points, shape (m, n)."""
    few = len(X) * part.n_lines < PREDICTED_BAND.least_solves
    if part.solver.tier == "dense" or few or part.frf.freq[-1] == 0.0:
        return part
    surrogate = Surrogate(Problem.of([part]), [result], accuracy)
    surrogate.begin(x)
    if len(X) > 1:
        surrogate.enrich(list(select_furthest(X, min(SURROGATE.points, len(X)))))
    reduction = surrogate.settle_run(lambda problem: X)
    if errs := describe_excess(reduction, "the furthest points"):
        raise SolverError(f"{errs} Allow it by accuracy=, or predict a narrower band")
    return surrogate.problem().parts[0]


def _frf(part: FRFPart, H: ComplexArray) -> FRF:
    return replace(part.frf, values=H)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """A predicted FRF with its band; all arrays of shape (n_f, n_responses, n_references).

    Attributes
    ----------
    frf : FRF
        The FRF of the updated model.
    level : float
        Share of the probability within the band, at every value by itself.
    source : {"Laplace", "bootstrap", "sampling"}
        Origin of the spread of the unknowns.
    with_noise : bool
        Whether the band is that of a measurement (True) or of the structure (False).
    lower, upper : ndarray of float
        Limits of the magnitude, in the unit of the FRF; 0 and inf if it is undetermined.
    phase_lower, phase_upper : ndarray of float
        Limits of the phase, in rad, about the angle of `frf`; they may exceed pi.
    std_real, std_imag : ndarray of float
        Standard deviations of real and imaginary part, in the unit of the FRF.
    """

    frf: FRF
    level: float
    source: str
    with_noise: bool
    lower: RealArray
    upper: RealArray
    phase_lower: RealArray
    phase_upper: RealArray
    std_real: RealArray
    std_imag: RealArray

    def __repr__(self) -> str:
        about = "a measurement" if self.with_noise else "the structure"
        return f"Band({100 * self.level:g} % of {about}, {self.source}, {self.frf!r})"

    def covers(self, other: FRF) -> BoolArray:
        """Return which magnitudes of an FRF lie within the band, in the shape of its arrays.

        The DOFs may be in any order. Raises DataError if lines or quantity differ, and DofError if
        a response or a reference is missing.
        """
        if other.quantity != self.frf.quantity:
            raise DataError(
                f"the band is about {self.frf.quantity}, the FRF about {other.quantity}"
            )
        same = other.select(
            lines=self.frf.freq, responses=self.frf.responses, references=self.frf.references
        )
        size = np.abs(same.values)
        return np.asarray((size >= self.lower) & (size <= self.upper))
