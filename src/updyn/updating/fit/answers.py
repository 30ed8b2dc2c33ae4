"""Comparison of answers, and starting points from which to find others that fit equally well.

Other answers are searched for at the other ends of the search, along unknowns that the data hardly
determine, with unknowns reset to their start, and with parts of the structure exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, combinations

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.group import MATRICES
from updyn.updating.fit.answer import Answer
from updyn.updating.fit.method import serial_correlation
from updyn.updating.fit.models import Models
from updyn.updating.fit.null_space import resolve
from updyn.updating.fit.screen import Screen
from updyn.updating.fit.settings import ANSWER_RESIDUAL, ANSWERS, FURTHER_ANSWERS, TRUST_REGION
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.noise.size import size_p_value
from updyn.updating.problem.problem import Problem

__all__ = [
    "are_distinct",
    "choose_answer",
    "contradicts",
    "distance",
    "exchange_groups",
    "find_promising_points",
    "find_rivals",
    "has_noise_residual",
    "is_better",
    "is_same",
    "is_within_uncertainty",
    "move_uncertain_unknowns",
    "reset_far_unknowns",
    "restart_uncertain_unknowns",
    "select_as_likely",
]


def has_noise_residual(problem: Problem, answer: Answer) -> bool:
    """Return whether the residual of an answer is not larger than noise, nor correlated."""
    for i, part in enumerate(problem.parts):
        H, weight = part.responses(answer.x), answer.residual.of(i).weight
        e = weight * (H - part.frf.values)
        if answer.noises[i].size_known and _exceeds(problem, i, e, H, answer.noises[i]):
            return False
        if (
            len(e) >= ANSWER_RESIDUAL.least_lines
            and serial_correlation(e) > ANSWER_RESIDUAL.largest_correlation
        ):
            return False
    for modal, error in zip(problem.modal, answer.residual.modal, strict=True):
        squares, number = error.power(modal, answer.x)
        if error.noise.size_known and squares > ANSWER_RESIDUAL.largest_chi_square * number:
            return False
    return True


def _exceeds(
    problem: Problem,
    i: int,
    e: ComplexArray,
    H: ComplexArray,
    noise: NoiseModel,
) -> bool:
    """Return whether a whitened residual, shape (n_f, ...), exceeds noise of known size."""
    part = problem.parts[i]
    square = float(np.sum(np.abs(e) ** 2))
    if noise.heavy_tails:
        return square > 2.0 * ANSWER_RESIDUAL.largest_chi_square * e.size
    count = 2.0 * np.count_nonzero((H != 0.0) | (part.frf.values != 0.0))
    freedom = max(count - problem.n * part.n_values / problem.n_values, 1.0)
    averages = None if noise.source == "stated" else part.frf.averages
    p = float(size_p_value(square, count, freedom, averages))
    return p < ANSWER_RESIDUAL.least_probability / len(problem.parts)


def choose_answer(problem: Problem, answers: Sequence[Answer]) -> Answer:
    """Return the best answer; of those that fit equally well, the one nearest to the start."""
    best = min(answer.negative_log_likelihood for answer in answers)
    equal = [
        answer
        for answer in answers
        if answer.negative_log_likelihood <= best + ANSWERS.equal_log_odds
    ]

    def negative_log_posterior(answer: Answer) -> float:
        far = (answer.x - problem.coordinates.start) / _usual_spread(problem)
        return answer.negative_log_likelihood + 0.5 * float(far @ far)

    return min(equal, key=negative_log_posterior)


def find_rivals(
    chosen: Answer, others: Sequence[Answer], tolerance: float | None = None
) -> list[Answer]:
    """Return the other answers that fit equally well and contradict the chosen one.

    An answer that ran out of steps counts, and so does one with larger standard deviations that
    include the chosen answer. `tolerance` is the accepted decrease of the log-likelihood,
    by default that of answers that fit equally well.
    """
    found: list[Answer] = []
    for other in sorted(
        select_as_likely(chosen, others, tolerance),
        key=lambda answer: answer.negative_log_likelihood,
    ):
        if contradicts(other, chosen) and all(are_distinct(known, other) for known in found):
            found.append(other)
    return found


def contradicts(other: Answer, chosen: Answer) -> bool:
    """Return whether some unknown differs by more than the better of two answers allows."""
    if chosen.local is None or other.local is None:
        return False
    return not (
        is_within_uncertainty(chosen.x, other)
        if is_better(other, chosen)
        else is_within_uncertainty(other.x, chosen)
    )


def distance(answer: Answer, x: RealArray) -> float:
    """Return the distance of a point, shape (n,), from an answer, in standard deviations."""
    if answer.local is None:
        return np.inf
    return float(np.linalg.norm(answer.local.R @ (x - answer.x)))


def is_within_uncertainty(x: RealArray, answer: Answer) -> bool:
    """Return whether a point, shape (n,), is within the uncertainty of an answer."""
    if answer.local is None:
        return False
    return not _are_apart(x, answer.x, _standard_deviations(answer.local))


def is_same(found: Answer, answer: Answer) -> bool:
    """Return whether two answers are the same, by the standard deviations of the better one."""
    return (
        is_within_uncertainty(answer.x, found)
        if is_better(found, answer)
        else is_within_uncertainty(found.x, answer)
    )


def select_as_likely(
    chosen: Answer, others: Sequence[Answer], tolerance: float | None = None
) -> list[Answer]:
    """Return the other answers whose log-likelihoods are lower by no more than `tolerance`."""
    if tolerance is None:
        tolerance = ANSWERS.equal_log_odds
    return [
        other
        for other in others
        if other.negative_log_likelihood <= chosen.negative_log_likelihood + tolerance
    ]


def is_better(answer: Answer, other: Answer) -> bool:
    """Return whether an answer fits significantly better than another."""
    # The other one is then not an answer, and its standard deviations are meaningless: its
    # Jacobian can be singular, as at a point between two answers.
    return answer.negative_log_likelihood < other.negative_log_likelihood - ANSWERS.equal_log_odds


def are_distinct(a: Answer, b: Answer) -> bool:
    """Return whether some unknown differs by more than both answers, or a better one, allow."""
    if a.local is None or b.local is None:
        return False
    for one, other in ((a, b), (b, a)):
        if is_better(one, other):
            return not is_within_uncertainty(other.x, one)
    return _are_apart(
        a.x, b.x, np.maximum(_standard_deviations(a.local), _standard_deviations(b.local))
    )


def _are_apart(a: RealArray, b: RealArray, std: RealArray) -> bool:
    return bool((np.abs(a - b) > ANSWERS.distinct_stds * std + TRUST_REGION.step_rounding).any())


def _usual_spread(problem: Problem) -> RealArray:
    """Return the usual spread of the unknowns about their start, shape (n,)."""
    return np.where(
        ~problem.coordinates.parameters.is_damping, ANSWERS.log_spread, ANSWERS.loss_spread
    )


def _standard_deviations(local: Local) -> RealArray:
    """Return the standard deviations of the unknowns; inf for undetermined ones."""
    found = resolve(local.R)
    return np.where(found.involved, np.inf, np.sqrt(np.diag(found.covariance)))


def move_uncertain_unknowns(problem: Problem, answer: Answer) -> Iterator[RealArray]:
    """Yield points, shape (n,), each with one poorly determined unknown moved."""
    # Moving one unknown leaves the valley of the misfit; steps along it were measured to fall
    # back.
    if answer.local is None:
        return
    home = problem.coordinates.start
    std = _standard_deviations(answer.local)
    for i in np.argsort(-std)[: FURTHER_ANSWERS.most_moved]:
        if std[i] <= FURTHER_ANSWERS.movable_std:
            return
        step = min(FURTHER_ANSWERS.reach_stds * std[i], 1.0)
        for value in (home[i], answer.x[i] - step, answer.x[i] + step):
            moved = problem.coordinates.with_coordinate(answer.x, i, value)
            if abs(moved[i] - answer.x[i]) > 1e-3 * step:
                yield moved


def restart_uncertain_unknowns(problem: Problem, answer: Answer, seed: int) -> Iterator[RealArray]:
    """Yield points, shape (n,), with the most uncertain unknowns drawn about the start."""
    # They are moved together: light parts whose resonances have been exchanged cannot be corrected
    # one by one.
    if answer.local is None:
        return
    coordinates, std = problem.coordinates, _standard_deviations(answer.local)
    least = np.argsort(-std)[: FURTHER_ANSWERS.most_moved]
    loose = least[std[least] > FURTHER_ANSWERS.uncertain_std]
    if len(loose) < 2:
        return
    drawn = np.random.default_rng(seed).normal(size=(FURTHER_ANSWERS.restarts, len(loose)))
    for row in drawn:
        x = answer.x.copy()
        x[loose] = coordinates.start[loose] + _usual_spread(problem)[loose] * row
        yield np.clip(x, *coordinates.bounds)


def reset_far_unknowns(problem: Problem, answer: Answer) -> Iterator[RealArray]:
    """Yield points, shape (n,), with one, two, four, eight unknowns reset, farthest first."""
    # Unknowns that the data hardly determine may have moved far together, each compensating for
    # the others. If the data determine all unknowns, no point is yielded.
    if (
        answer.local is None
        or _standard_deviations(answer.local).max() <= FURTHER_ANSWERS.movable_std
    ):
        return
    coordinates = problem.coordinates
    far = np.abs(answer.x - coordinates.start) / _usual_spread(problem)
    order, number = np.argsort(-far), 1
    while number <= np.count_nonzero(far > FURTHER_ANSWERS.movable_std):
        yield np.where(np.isin(range(len(far)), order[:number]), coordinates.start, answer.x)
        number *= 2


def find_promising_points(
    models: Models, answer: Answer, negative_log_likelihood: Callable[[RealArray], float], most: int
) -> list[RealArray]:
    """Return points, shape (n,), away from an answer that fit fairly well without a descent."""
    # Each unknown is moved alone, to its start and to either side, and parts of the structure are
    # exchanged. At most `most` points are evaluated, most of them on few lines.
    problem, number = models.exact, FURTHER_ANSWERS.most_promising
    points = chain(exchange_groups(problem, answer.x), _move_each_unknown(problem, answer.x))
    tries = list({x.tobytes(): x for x in points}.values())[:most]
    screen = Screen.of(models.rough, answer.x, answer.noises, answer.residual)
    if models.only_ranks:
        near, far = (
            [x for x in tries if models.is_rough(x) == is_rough] for is_rough in (False, True)
        )
        tries = [
            x
            for lot in (near, far)
            for x in screen.rank(lot, [distance(answer, x) for x in lot], number)
        ]
    else:
        tries = screen.select_best(tries, number)
    worse = np.array([negative_log_likelihood(x) for x in tries]) - answer.negative_log_likelihood
    # Points are kept if they double the misfit at most.
    largest_rise = max(problem.n_numbers / 2, FURTHER_ANSWERS.fair_rise)
    promising = [i for i in np.argsort(worse) if worse[i] <= largest_rise]  # all with heavy tails
    return [tries[i] for i in promising[:number]]


def _move_each_unknown(problem: Problem, x: RealArray) -> Iterator[RealArray]:
    home = problem.coordinates.start
    far = _usual_spread(problem)
    for i in range(len(x)):
        for value in (home[i], x[i] - far[i], x[i] + far[i]):
            moved = problem.coordinates.with_coordinate(x, i, value)
            if abs(moved[i] - x[i]) > FURTHER_ANSWERS.movable_std * far[i]:
                yield moved


def exchange_groups(problem: Problem, x: RealArray) -> Iterator[RealArray]:
    """Yield points with stiffnesses and masses of groups exchanged: mirrored, and in pairs."""
    indices: dict[str, dict[str, int]] = {}
    for i, p in enumerate(problem.coordinates.parameters):
        if not p.drives and not p.is_channel:
            indices.setdefault(p.group, {})[p.quantity] = i
    size = _log_sizes(problem)
    mirrors = [_pair_mirrored(similar) for similar in _find_similar_groups(problem, list(indices))]
    together = [[pair for mirror in mirrors for pair in mirror]] if len(mirrors) > 1 else []
    singles = [[pair] for pair in combinations(indices, 2)]
    for swaps in [*together, *mirrors, *singles[: FURTHER_ANSWERS.most_exchanges]]:
        moved = x.copy()
        for a, b in swaps:
            for quantity in indices[a].keys() & indices[b].keys():
                i_a, i_b = indices[a][quantity], indices[b][quantity]
                moved[i_a] = x[i_b] + size[i_b] - size[i_a]
                moved[i_b] = x[i_a] + size[i_a] - size[i_b]
        if (moved != x).any():
            yield np.clip(moved, *problem.coordinates.bounds)


def _pair_mirrored(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pairs of names that change places when their order is reversed."""
    return [(names[i], names[-1 - i]) for i in range(len(names) // 2)]


def _find_similar_groups(problem: Problem, names: Sequence[str]) -> list[list[str]]:
    """Return lists of two or more groups whose matrices have the same entries up to a factor."""
    system = problem.system
    classes: dict[tuple[object, ...], list[str]] = {}
    for name in names:
        kind: list[object] = []
        for quantity in MATRICES:
            if system.has(name, quantity):
                entries = np.abs(system.terms[system.find(name, quantity)].data)
                share = np.sort(entries[entries > 0.0]) / max(entries.sum(), np.finfo(float).tiny)
                kind += [quantity, len(share), round(float(share @ share), 9)]
        classes.setdefault(tuple(kind), []).append(name)
    return [similar for similar in classes.values() if len(similar) > 1]


def _log_sizes(problem: Problem) -> RealArray:
    """Return the logarithm of the size of a factor of 1, shape (n,); 0 for other unknowns."""
    system, parameters = problem.system, problem.coordinates.parameters
    sizes = np.zeros(problem.n)
    for i, p in enumerate(parameters):
        if p.is_factor and not p.drives and system.has(p.group, p.quantity):
            total = np.abs(system.terms[system.find(p.group, p.quantity)].data).sum()
            sizes[i] = np.log(total) if total > 0.0 else 0.0  # a matrix of zeros has no size
    return sizes
