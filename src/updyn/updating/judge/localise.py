"""Localisation of the model error that explains a residual, by energy and by score tests.

Energy: the least error in the constitutive relations that explains the residual, by group (Ladeveze
& Leguillon, SIAM J. Numer. Anal. 20 (1983) 485; Ladeveze, Nedjar & Reynier, AIAA J. 32 (1994) 1485;
with a term for the measurement Deraemaeker, Ladeveze & Leconte, Comput. Methods Appl. Mech. Eng.
191 (2002) 2427). Score: decrease of the misfit by a quantity to first order, with all unknowns
adapted (Rao, Proc. Camb. Phil. Soc. 44 (1948) 50). An error outside the model, such as a missing
spring, gives high scores to quantities that cannot remove the misfit, so short fits confirm the
best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import SolverError
from updyn.sensitivity import Unknowns
from updyn.updating.fit.method import descend
from updyn.updating.fit.methods.constitutive import constitutive_weights
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.judge.adequacy import Suspect
from updyn.updating.judge.nearby import ReducedPart
from updyn.updating.judge.settings import ERROR_SEARCH, SHORT_FITS, SIGNIFICANCE
from updyn.updating.problem.channels import calibration
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputErrorSet

__all__ = [
    "constitutive_error",
    "localise_error",
]


def constitutive_error(
    part: FRFPart, x: RealArray, misfit: ComplexArray, variance: RealArray, lines: slice
) -> RealArray:
    """Return the energy of the least error in each stored matrix, (n_terms, n_f, n_j) in J for 1 N.

    `misfit` is computed minus measured FRF and `variance` its E|dH|^2, in the unit of the data; 0
    Hz only for receptances.
    """
    # The sum of lambda^H W lambda and of the misfit in units of the noise is minimised: with P =
    # Z^-1 on the responses and S = P^T W conj(P), lambda = -theta conj(P) (Sigma + theta S)^-1 (h
    # - h_X); theta makes both together as large as the misfit at every line.
    freq = part.frf.freq[lines]
    omega = 2.0 * np.pi * freq
    system = part.solver.system
    c, w = constitutive_weights(system, part.state(x), omega)
    power = (part.frf.s[lines] ** part.frf.power)[:, None, None]
    rows, place = np.unique(part.rows, return_inverse=True)
    P = part.solver.solve(c, rows, freq)[:, :, place.ravel()]
    S = np.zeros((len(freq), P.shape[2], P.shape[2]), dtype=np.complex128)
    for t, term in enumerate(system.terms):
        part_of_field = P[term.row_index]
        S += w[t][:, None, None] * np.einsum(
            "nfi,nfk->fik", part_of_field, term.times(part_of_field.conj())
        )
    d, noise = part.sign * misfit / power, variance / np.abs(power) ** 2
    size, floor = np.sum(np.abs(d) ** 2, axis=1), np.sum(noise, axis=1)
    trace = np.maximum(np.einsum("fii->f", S).real, np.finfo(float).tiny)
    theta = np.maximum(size - floor, 1e-3 * size) / trace[:, None]
    energy = np.zeros((len(system.terms), *size.shape))
    for j in range(d.shape[2]):
        C = theta[:, j, None, None] * S
        diagonal = np.arange(C.shape[1])
        C[:, diagonal, diagonal] += noise[:, :, j] + 1e-12 * (trace * theta[:, j])[:, None]
        force = np.linalg.solve(C, d[:, :, j, None])[..., 0]
        field = theta[:, j, None] * np.einsum("nfi,fi->nf", P.conj(), force).T
        for t, term in enumerate(system.terms):
            part_of_field = np.ascontiguousarray(field.T[term.row_index])
            energy[t, :, j] = (
                w[t] * np.sum(part_of_field.conj() * term.times(part_of_field), axis=0).real
            )
    return np.maximum(energy, 0.0)


def localise_error(
    problem: Problem,
    x: RealArray,
    residual: OutputErrorSet,
    whitened: Sequence[ComplexArray],
    excess: float | None,
) -> tuple[Suspect, ...]:
    """Return the quantities that explain at least a tenth of the residual of a fit, the best first.

    `whitened` marks missing values by NaN. `excess` is the part of the sum of squares that noise
    does not explain; None estimates it from the serial correlation.
    """
    exact = problem
    problem, nearby = _replace_by_reduced(problem, x, residual, whitened)
    energy = _compute_energies(problem, x, residual, whitened)
    candidates = _choose_quantities(problem, x, energy)
    scores = _compute_scores(problem, x, residual, candidates)
    structure = _correlated_square(whitened) if excess is None else excess
    total_gain = max(structure, max((score.gain for score in scores), default=0.0))
    least = max(ERROR_SEARCH.least_gain, ERROR_SEARCH.least_share * total_gain)
    promising = sorted((s for s in scores if s.gain >= least), key=lambda s: -s.gain)
    promising = promising[: ERROR_SEARCH.most_suspects]
    if not promising:
        return ()
    total = sum(energy.values()) or 1.0
    if nearby:  # enrich the basis at the expected ends of the short fits
        ends = [_expected_end(problem, x, score) for score in promising]
        parts = []
        for i, one in enumerate(nearby):
            states = [end.parts[i].state(at) for end, at in ends]
            parts.append(one.extend_basis([problem.parts[i].state(x), *states]))
        problem = problem.with_parts(parts)
    suspects = []
    for p, explains, change, confirmed in _explain_residual(
        problem, x, residual, whitened, excess, promising, total_gain, _work_limit(exact)
    ):
        if explains >= ERROR_SEARCH.least_share:
            share = energy.get((p.group, _matrix_of(p.quantity)), 0.0) / total
            suspects.append(Suspect(p.group, p.quantity, explains, change, share, confirmed))
    return tuple(sorted(suspects, key=lambda s: -s.explains))


@dataclass(frozen=True, slots=True)
class _Score:
    """First-order decrease of the sum of squares by a change of one quantity."""

    parameter: Parameter
    gain: float
    step: float


def _explain_residual(
    problem: Problem,
    x: RealArray,
    residual: OutputErrorSet,
    whitened: Sequence[ComplexArray],
    excess: float | None,
    promising: Sequence[_Score],
    total_gain: float,
    allowed: float,
) -> list[tuple[Parameter, float, float, bool]]:
    """Return (quantity, explained share, change, whether confirmed by a fit) of each candidate."""
    affordable, lines, steps = _plan_short_fits(problem, allowed, len(promising))
    if affordable == 0:
        return [(s.parameter, s.gain / total_gain, s.step, False) for s in promising]
    short_fits = _ShortFits.of(problem, x, residual, whitened, excess, lines, steps)
    found = []
    for score in promising[:affordable]:
        explains, change = short_fits.explained_share(score.parameter)
        found.append((score.parameter, explains, change, True))
    return found


def _compute_scores(
    problem: Problem, x: RealArray, residual: OutputErrorSet, candidates: Sequence[Parameter]
) -> list[_Score]:
    """Return the score of each quantity; empty if the model cannot be solved."""
    if not candidates:
        return []
    n = problem.n
    wide, start = _add_unknowns(problem, x, candidates)
    local = residual.local(wide, start)
    if local is None:
        return []
    # The unknowns come first, so the lower rows of the triangle hold the residual after they have
    # adapted.
    R, q = local.R[n:, n:], local.q[n:]
    power = np.sum(R**2, axis=0)
    is_effective = power > 1e-12 * np.maximum(
        np.sum(local.R[:, n:] ** 2, axis=0), np.finfo(float).tiny
    )
    step = np.where(is_effective, -(R.T @ q) / np.where(is_effective, power, 1.0), 0.0)
    return list(map(_Score, candidates, (step**2 * power).tolist(), step.tolist()))


def _add_unknowns(
    problem: Problem, x: RealArray, more: Sequence[Parameter]
) -> tuple[Problem, RealArray]:
    """Return the problem with additional unknowns, and x extended by their start values."""
    wide = ParameterSet((*problem.coordinates.parameters.items, *more))
    coordinates = replace(problem.coordinates, parameters=wide, box=None, within=None)
    parts = []
    for part in problem.parts:
        unknowns = Unknowns.find(part.solver.system, wide)
        parts.append(replace(part, unknowns=unknowns, coordinates=coordinates))
    return Problem.of(parts), np.concatenate([x, coordinates.start[problem.n :]])


def _evaluation_work(problem: Problem) -> float:
    return sum(part.work for part in problem.parts)


def _work_limit(problem: Problem) -> float:
    """Return the approximate number of operations allowed for all short fits."""
    allowed = SHORT_FITS.operations_share * _evaluation_work(problem)
    return min(SHORT_FITS.most_operations, max(allowed, SHORT_FITS.free_operations))


def _plan_short_fits(problem: Problem, allowed: float, wanted: int) -> tuple[int, int, int]:
    """Return the affordable number of quantities (0 if none), lines of each test, and steps."""
    best = (0, 0, 0)
    plans = zip(SHORT_FITS.lines, SHORT_FITS.steps, SHORT_FITS.evaluations, strict=True)
    for lines, steps, evaluations in plans:
        few = problem.thin(lines)
        if best[0] and few.n_numbers < SHORT_FITS.values_per_unknown * problem.n:
            break
        number = int(allowed / (evaluations * _evaluation_work(few)))
        if number >= min(wanted, SHORT_FITS.enough_fits):
            return number, lines, steps
        if number > best[0]:
            best = (number, lines, steps)
    return best


def _replace_by_reduced(
    problem: Problem, x: RealArray, residual: OutputErrorSet, whitened: Sequence[ComplexArray]
) -> tuple[Problem, list[ReducedPart]]:
    """Return the problem with reduced models about x in place of large models, and these models."""
    # The problem is unchanged and the list empty if the error of a reduced model is not small
    # compared with the residual.
    nearby = []
    for i, part in enumerate(problem.parts):
        one = ReducedPart.of(part, x)
        if one is None:
            return problem, []
        try:
            error = residual.of(i).weight * (one.part.responses(x) - part.responses(x))
        except SolverError:
            return problem, []
        negligible = SIGNIFICANCE.negligible_error**2 * _sum_of_squares([whitened[i]])
        if _sum_of_squares([error]) > negligible:
            return problem, []
        nearby.append(one)
    return problem.with_parts([one.part for one in nearby]), nearby


def _expected_end(problem: Problem, x: RealArray, score: _Score) -> tuple[Problem, RealArray]:
    """Return the problem with one additional unknown, and the expected end of its short fit."""
    wide, at = _add_unknowns(problem, x, [score.parameter])
    at = at.copy()
    most = SHORT_FITS.most_enriched_step
    at[-1] += np.clip(score.step, -most, most)
    return wide, np.clip(at, *wide.coordinates.bounds)


@dataclass(frozen=True, slots=True, eq=False)
class _ShortFits:
    """Short fits on few lines, each with one additional unknown.

    `x`, `cost` (with priors) and `whitened` are those of a short fit without an additional unknown;
    `excess` is the part of the sum of squares that noise does not explain, None if unknown.
    """

    problem: Problem
    x: RealArray
    residual: OutputErrorSet
    cost: float
    whitened: tuple[ComplexArray, ...]
    excess: float | None
    steps: int

    @classmethod
    def of(
        cls,
        problem: Problem,
        x: RealArray,
        residual: OutputErrorSet,
        whitened: Sequence[ComplexArray],
        excess: float | None,
        lines: int,
        steps: int,
    ) -> _ShortFits:
        few = problem.thin(lines)
        errors, n_kept = [], 0
        for i, (whole, part) in enumerate(zip(problem.parts, few.parts, strict=True)):
            at = np.flatnonzero(np.isin(whole.frf.freq, part.frf.freq))
            error = residual.of(i)
            errors.append(replace(error, weight=error.weight[at]))
            n_kept += part.n_values
        thinned = OutputErrorSet(tuple(errors))
        x, cost = _descend_shortly(few, thinned, x, steps)
        e = _whiten_residual(few, thinned, x)
        if excess is not None:
            # The noise contributes equally to all lines.
            noise = sum(float(np.nansum(np.abs(w) ** 2)) for w in whitened) - excess
            excess = 2.0 * cost - noise * n_kept / problem.n_values
        return cls(few, x, thinned, cost, e, excess, steps)

    def explained_share(self, parameter: Parameter) -> tuple[float, float]:
        """Return the share of the excess residual that a quantity explains, and its change."""
        # For noise of unknown size, the share is estimated from the serial correlation of the
        # removed and of the remaining part. A fit that ends at a bound explains nothing.
        wide, start = _add_unknowns(self.problem, self.x, [parameter])
        try:
            x, cost = _descend_shortly(wide, self.residual, start, self.steps)
            residual = _whiten_residual(wide, self.residual, x)
        except SolverError:
            return 0.0, 0.0
        gain, change = 2.0 * (self.cost - cost), float(x[-1] - start[-1])
        lower, upper = wide.coordinates.bounds
        at_bound = parameter.is_factor and not lower[-1] < x[-1] < upper[-1]
        if at_bound or gain < ERROR_SEARCH.least_gain:
            return 0.0, change
        if self.excess is not None:
            return float(gain / max(self.excess, gain)), change
        removed = [a - b for a, b in zip(self.whitened, residual, strict=True)]
        # If the removed model error is hardly correlated, all of the residual may be model error.
        model_share = min(
            _share_of_correlated(residual) / max(_share_of_correlated(removed), 1e-3), 1.0
        )
        rest = model_share * _sum_of_squares(residual)
        return float(gain / (gain + rest)), change


def _descend_shortly(
    problem: Problem, residual: OutputErrorSet, x: RealArray, steps: int
) -> tuple[RealArray, float]:
    """Return the end of a short fit, and half its sum of squares, priors included."""
    settings = TrustRegion(
        steps,
        1e-6,
        min_decrease=SHORT_FITS.settled_gain,
        min_relative_decrease=SHORT_FITS.settled_share,
    )
    end = descend(problem, residual, x, Monitor(problem), settings, relax=False)
    return end.x, end.local.cost


def _whiten_residual(
    problem: Problem, residual: OutputErrorSet, x: RealArray
) -> tuple[ComplexArray, ...]:
    """Return the residual over its standard deviation; NaN marks values of weight 0."""
    out = []
    for i, part in enumerate(problem.parts):
        weight = residual.of(i).weight
        out.append(np.where(weight > 0.0, weight * (part.frf.values - part.responses(x)), np.nan))
    return tuple(out)


def _sum_of_squares(whitened: Sequence[ComplexArray]) -> float:
    return sum(float(np.nansum(np.abs(e) ** 2)) for e in whitened)


def _matrix_of(quantity: str) -> str:
    return "stiffness" if quantity == "loss_factor" else quantity


def _correlated_square(whitened: Sequence[ComplexArray]) -> float:
    """Return the part of the sum of squares that is correlated between neighbouring lines."""
    total = 0.0
    for e in whitened:
        total += float(np.nansum((e[1:] * e[:-1].conj()).real))
    return max(total, 0.0)


def _share_of_correlated(whitened: Sequence[ComplexArray]) -> float:
    return _correlated_square(whitened) / max(_sum_of_squares(whitened), np.finfo(float).tiny)


def _compute_energies(
    problem: Problem, x: RealArray, residual: OutputErrorSet, whitened: Sequence[ComplexArray]
) -> dict[tuple[str, str], float]:
    """Return the energy of the error by group and matrix; lines are weighted by their misfit."""
    out: dict[tuple[str, str], float] = {}
    for i, part in enumerate(problem.parts):
        square = np.nan_to_num(np.abs(whitened[i]) ** 2)
        square[part.frf.freq == 0.0] = 0.0
        worst = np.sort(np.argsort(square.sum(axis=(1, 2)))[::-1][: _n_energy_lines(part)])
        worst = worst[part.frf.freq[worst] > 0.0]
        if not worst.size:
            continue
        weight = residual.of(i).weight[worst]
        known = weight > 0.0
        variance = 2.0 / np.where(known, weight, 1.0) ** 2
        variance = np.where(known, variance, 1e6 * variance.max(initial=1.0))
        misfit = np.where(known, part.responses(x)[worst] - part.frf.values[worst], 0.0)
        few = replace(part, frf=part.frf.select(lines=part.frf.freq[worst]))
        items = [(x, misfit[at], variance[at], at) for at in few.partition(2 * len(part.rows))]
        found = np.concatenate(list(few.map_lines(_block_error, items)), axis=1)
        share = found / np.maximum(found.sum(axis=0), np.finfo(float).tiny)
        counted = np.sum(share * square[worst].sum(axis=1), axis=(1, 2))
        for term, value in zip(part.solver.system.terms, counted.tolist(), strict=True):
            if term.group:
                key = (term.group, term.quantity)
                out[key] = out.get(key, 0.0) + value
    return out


def _n_energy_lines(part: FRFPart) -> int:
    most, one_in = ERROR_SEARCH.most_energy_lines, ERROR_SEARCH.lines_per_energy_line
    if part.work <= SHORT_FITS.free_operations / one_in:
        return most
    return min(most, max(1, part.n_lines // one_in))


def _block_error(
    part: FRFPart, item: tuple[RealArray, ComplexArray, RealArray, slice]
) -> RealArray:
    return constitutive_error(part, *item)


def _choose_quantities(
    problem: Problem, x: RealArray, energy: dict[tuple[str, str], float]
) -> list[Parameter]:
    """Return the quantities to try: those that are not unknowns, in order of decreasing energy."""
    free: set[tuple[str, str]] = set()
    driven: set[str] = set()
    for p in problem.coordinates.parameters:
        for drive in p.acts_on:
            if len(p.acts_on) == 1:
                free.add((drive.group, drive.quantity))
            if drive.quantity == "loss_factor":
                driven.add(drive.group)
    losses: dict[str, float] = {}
    for part in problem.parts:
        state = part.state(x)
        for t, term in enumerate(part.solver.system.terms):
            if term.quantity == "stiffness":
                losses.setdefault(term.group, float(state.loss[t]))
    ordered = sorted(energy, key=lambda key: -energy[key])
    least, most = 1.0 / ERROR_SEARCH.most_factor, ERROR_SEARCH.most_factor
    items: list[Parameter] = []
    for group, quantity in ordered:
        if (group, quantity) not in free:
            items.append(Parameter(group, quantity, 1.0, least, most))
        if quantity == "stiffness" and group not in driven and group in losses:
            loss = max(losses[group], 0.0)
            items.append(Parameter(group, "loss_factor", loss, 0.0, max(1.0, 2.0 * loss)))
    return (_choose_sensors(problem, free) + items)[: ERROR_SEARCH.most_quantities]


def _choose_sensors(problem: Problem, free: set[tuple[str, str]]) -> list[Parameter]:
    """Return the calibration factors that are not unknowns; empty for very many sensors."""
    candidates = calibration([part.frf for part in problem.parts], references="all")
    if len(candidates) > ERROR_SEARCH.most_sensors:
        return []
    return [
        replace(p, lower=1.0 / ERROR_SEARCH.most_factor, upper=ERROR_SEARCH.most_factor)
        for p in candidates
        if (p.group, p.quantity) not in free
    ]
