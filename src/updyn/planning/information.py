"""Fisher information of every pair of a response and a reference, for all candidates at once.

Each line is factorised once. The fields for unit forces on all candidates give H and, by
reciprocity, the derivatives of every pair (`updyn.sensitivity`). Noise is independent between
channels, so the information of a layout is the sum over its pairs of

    I_ij = sum over lines of  2 / E|dH_ij|^2  Re(dH_ij/dx^H dH_ij/dx),

with respect to the optimiser's coordinates x (logarithm of a factor, loss factor): Pintelon &
Schoukens, System Identification, 2nd ed. 2012, section 9.11, for circular complex noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dofs import DofSet
from updyn.dynamics.fields import FieldSolver, split_into_blocks
from updyn.errors import OptionError
from updyn.frf import FRF, QUANTITIES
from updyn.linalg.threads import use_one_thread
from updyn.model import Model
from updyn.planning.settings import INFORMATION
from updyn.sensitivity import contract
from updyn.updating.problem.noise.known import Stated, two_part_variance, unit_kinds
from updyn.updating.problem.optimal_design import initial_information
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import Record, Session
from updyn.updating.problem.settings import EVALUATION

__all__ = ["Candidates", "PairInformation", "Stage", "check_size"]

#: A point of the parameters and a range of lines: a unit of work, local or remote.
_Item: TypeAlias = "tuple[RealArray, slice]"
#: Context that names a stage of the work.
Stage: TypeAlias = Callable[[str], AbstractContextManager[object]]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The model at candidate responses and references, at the lines of a band.

    `part` holds placeholders for the data. `level`, shape (n_i, n_j), is the rms of all channels of
    the same unit at the start, which scales the noise floor; infinite for channels that are too
    weak: below the share `error` of the largest channel (rounding, or the error of `reduced`).
    `reduced` is a reduced model for the fields of unit forces; None for the full one.
    """

    model: Model
    part: FRFPart
    responses: DofSet
    references: DofSet
    noise: Stated
    level: RealArray
    reduced: FieldSolver | None = None
    error: float = field(default_factory=lambda: INFORMATION.rounding)

    @classmethod
    def compile(
        cls,
        model: Model,
        parameters: ParameterSet,
        responses: DofSet,
        references: DofSet,
        freq: RealArray,
        quantity: str,
        noise: Stated,
        session: Session | None = None,
    ) -> Candidates:
        """Compile a model for its candidates, without the level of the noise."""
        nothing = np.zeros((len(freq), 1, 1), dtype=np.complex128)
        data = FRF(freq, nothing, responses[:1], references[:1], quantity)
        part = FRFPart.build(model, data, parameters, session=session)
        level = np.zeros((len(responses), len(references)))
        return cls(model, part, responses, references, noise, level)

    def with_level(self, among: Candidates | None = None) -> Candidates:
        """Return the candidates with the level of the noise, from their rms or that of a sample.

        A sample `among` has channels of every unit; then no channel is removed as too weak.
        """
        reference_sample = self if among is None else among
        squared, of_kind = (
            _compute_mean_square(reference_sample),
            unit_kinds(reference_sample.responses, reference_sample.references),
        )
        kinds = unit_kinds(self.responses, self.references)
        level = np.zeros(kinds.shape)
        for kind in np.unique(kinds):
            level[kinds == kind] = np.sqrt(squared[of_kind == kind].mean())
        level = np.maximum(level, np.finfo(float).tiny ** 0.25)
        found = replace(self, level=level)
        return found._mask_weak(squared) if among is None else found

    def without_weak(self) -> Candidates:
        """Return the candidates with an infinite level of the noise in weak channels."""
        return self._mask_weak(_compute_mean_square(self))

    def _mask_weak(self, squared: RealArray) -> Candidates:
        kinds = unit_kinds(self.responses, self.references)
        loudest = np.zeros(kinds.shape)
        for kind in np.unique(kinds):
            loudest[kinds == kind] = squared[kinds == kind].max()
        weak = squared <= self.error**2 * loudest
        return replace(self, level=np.where(weak, np.inf, self.level))

    @property
    def solver(self) -> FieldSolver:
        """Solver for the fields of unit forces on the candidates."""
        return self.reduced or self.part.solver

    @property
    def freq(self) -> RealArray:
        """The lines in Hz, shape (n_f,)."""
        return self.part.frf.freq

    @property
    def quantity(self) -> str:
        """The measured quantity."""
        return self.part.frf.quantity

    def at_lines(self, freq: RealArray) -> Candidates:
        """Return the candidates at other lines, with the same level of the noise."""
        nothing = np.zeros((len(freq), 1, 1), dtype=np.complex128)
        data = FRF(freq, nothing, self.responses[:1], self.references[:1], self.quantity)
        return replace(self, part=self.part.with_data(data))

    def select(
        self, rows: Sequence[int] | IndexArray, columns: Sequence[int] | IndexArray
    ) -> Candidates:
        """Return some of the candidates, by index, with the same level of the noise."""
        at = np.ix_(list(rows), list(columns))
        responses, references = self.responses[list(rows)], self.references[list(columns)]
        return replace(self, responses=responses, references=references, level=self.level[at])

    @property
    def is_distributed(self) -> bool:
        """Whether lines are distributed over workers."""
        n_values = len(self.freq) * len(self.responses) * len(self.references)
        return self.part.work + 4.0 * n_values * self.part.n**2 > EVALUATION.distributed_work

    def over_lines(
        self, function: Callable[[Candidates, _Item], RealArray], x: RealArray
    ) -> RealArray:
        """Return the sum of a function over all lines at a point, computed in pieces.

        The module-level function takes the candidates, and the point with a piece of the lines.
        """
        session, n_lines = self.part.session, len(self.freq)
        session.check()
        blocks = split_into_blocks(n_lines, -(-n_lines // INFORMATION.pieces))
        items = [(x, lines) for lines in blocks]
        pieces = session.map(function, self, items, spread=self.is_distributed, long=True)
        total = np.zeros(())
        for (_, lines), piece in zip(items, pieces, strict=True):
            total = total + piece
            session.lines_solved += lines.stop - lines.start
        return total

    def key(self, kind: str, x: RealArray) -> list[object]:
        """Return the key of a sum over lines at a point, within a run."""
        labels = [*self.responses.labels, "/", *self.references.labels]
        return [kind, *labels, self.freq, self.level, self.solver.label, x]

    def variance(self, H: ComplexArray) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j), of a model's H of that shape."""
        return two_part_variance(self.noise.relative, self.noise.floor, H, self.level)


def _compute_mean_square(candidates: Candidates) -> RealArray:
    """Return the mean of |H|^2 over the lines at the start of the parameters, shape (n_i, n_j)."""
    return candidates.over_lines(_compute_line_mean_square, candidates.part.coordinates.start)


def _compute_line_mean_square(candidates: Candidates, item: _Item) -> RealArray:
    """Return the share of some lines in the mean of |H|^2, shape (n_i, n_j)."""
    x, piece = item
    solver, dofs = candidates.solver, candidates.model.dofs
    read = dofs.match(candidates.responses).index
    loaded = dofs.match(candidates.references).index
    turned = len(read) < len(loaded)  # H is symmetric: apply forces at the fewer DOFs
    if turned:
        read, loaded = loaded, read
    state, freq = candidates.part.state(x), candidates.freq[piece]
    squared = np.zeros((len(read), len(loaded)))
    for lines in split_into_blocks(len(freq), solver.block_size(len(loaded))):
        candidates.part.session.check()
        omega = 2.0 * np.pi * freq[lines]
        X = solver.solve(solver.system.coefficients(state, omega), loaded, freq[lines])
        power = omega ** (2 * QUANTITIES[candidates.quantity]) / len(candidates.freq)
        squared += np.einsum("ifj,f->ij", np.abs(solver.at(X, read)) ** 2, power)
    return squared.T if turned else squared


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Fields for unit forces on all candidates at a block of lines.

    `freq` is in Hz; `V`, shape (N, n_f, n_i), and `U`, (N, n_f, n_j), are in m/N, or coordinates of
    a reduced model; `H`, (n_f, n_i, n_j), is in the measured quantity, except for the phase of its
    factor.
    """

    freq: RealArray
    V: ComplexArray
    U: ComplexArray
    H: ComplexArray


def _iterate_blocks(candidates: Candidates, item: _Item) -> Iterator[_Block]:
    """Yield the fields by block of lines; each line is factorised once."""
    x, piece = item
    solver = candidates.solver
    dofs = candidates.model.dofs
    rows = dofs.match(candidates.responses).index
    columns = dofs.match(candidates.references).index
    loads, place = np.unique(np.concatenate([rows, columns]), return_inverse=True)
    state = candidates.part.state(x)
    some = candidates.freq[piece]
    for lines in split_into_blocks(len(some), solver.block_size(len(loads))):
        freq = some[lines]
        omega = 2.0 * np.pi * freq
        X = solver.solve(solver.system.coefficients(state, omega), loads, freq)
        U = X[:, :, place[len(rows) :]]
        factor = omega ** QUANTITIES[candidates.quantity]
        H = solver.at(U, rows).transpose(1, 0, 2) * factor[:, None, None]
        yield _Block(freq, X[:, :, place[: len(rows)]], U, H)


@dataclass(frozen=True, slots=True, eq=False)
class PairInformation:
    """Fisher information of every pair of candidates, at one or more points of the parameters.

    `packed`, shape (n_i, n_j, n_points, n (n + 1) / 2), holds lower triangles. It and `before`, the
    information of the priors with a small addition (without it the determinant may be zero), are
    scaled by `scale`: the square root of the information of all pairs and the priors at the first
    point.
    """

    packed: RealArray
    before: RealArray
    scale: RealArray

    @classmethod
    def compute(
        cls,
        candidates: Candidates,
        points: Sequence[RealArray],
        stage: Stage = nullcontext,
    ) -> PairInformation:
        """Return the information of every pair at points in the optimiser's coordinates."""
        n = candidates.part.n
        shape = (len(candidates.responses), len(candidates.references), len(points))
        check_size(candidates, len(points))
        packed = np.zeros((*shape, n * (n + 1) // 2))
        low, high = candidates.freq[[0, -1]]
        about = f"{shape[0]} x {shape[1]} pairs, {low:g} to {high:g} Hz"
        for at, x in enumerate(points):
            with stage(f"information of {about}: start {at + 1} of {len(points)}"):
                packed[:, :, at] = _compute_information(candidates, x)
        weight = candidates.part.coordinates.prior[1]
        lower = np.tril_indices(n)
        diagonal = packed[:, :, 0, lower[0] == lower[1]].sum(axis=(0, 1)) + weight**2
        scale = np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
        packed /= scale[lower[0]] * scale[lower[1]]
        return cls(packed, initial_information(n) + np.diag((weight / scale) ** 2), scale)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of candidate responses and references."""
        return self.packed.shape[0], self.packed.shape[1]

    @property
    def points_shape(self) -> tuple[int, int, int]:
        """Number of points, and twice the number of parameters."""
        return self.packed.shape[2], len(self.scale), len(self.scale)

    def of_responses(self, columns: Sequence[int]) -> RealArray:
        """Return the information of each response without prior, (n_i, n_points, n, n)."""
        return self._unpack(self.packed[:, list(columns)].sum(axis=1))

    def of_references(self, rows: Sequence[int]) -> RealArray:
        """Return the information of each reference without prior, (n_j, n_points, n, n)."""
        return self._unpack(self.packed[list(rows)].sum(axis=0))

    def of_layout(self, rows: Sequence[int], columns: Sequence[int]) -> RealArray:
        """Return the information of a layout with the prior, shape (n_points, n, n)."""
        total = self.packed[np.ix_(list(rows), list(columns))].sum(axis=(0, 1))
        return self._unpack(total) + self.before

    def _unpack(self, packed: RealArray) -> RealArray:
        n = len(self.scale)
        place = np.zeros((n, n), dtype=np.intp)
        lower = np.tril_indices(n)
        place[lower] = np.arange(len(lower[0]))
        return np.asarray(packed[..., np.maximum(place, place.T)])


def check_size(candidates: Candidates, n_points: int) -> None:
    """Raise OptionError if the information of all pairs needs too much memory."""
    n, rows, columns = candidates.part.n, len(candidates.responses), len(candidates.references)
    one = 8 * n_points * (n * (n + 1) // 2)
    if rows * columns * one <= INFORMATION.most_bytes:
        return
    text = (
        f"{rows} candidate responses with {columns} candidate references and {n} unknowns, at"
        f" {n_points} starts, need {rows * columns * one / 2**30:.3g} GiB; expected at most"
        f" {INFORMATION.most_bytes / 2**30:g}; name fewer candidates"
    )
    fits = INFORMATION.most_bytes // (rows * one)
    if fits:
        text += f": with all of the responses, at most {fits} candidate references"
    if n_points > 1:
        text += "; or fewer draws (robust)"
    raise OptionError(text, key=("reference_candidates",))


def _compute_information(candidates: Candidates, x: RealArray) -> RealArray:
    """Return the information of each pair at a point, shape (n_i, n_j, n (n + 1) / 2)."""

    def compute() -> Record:
        packed = candidates.over_lines(_compute_line_information, x)
        if candidates.responses == candidates.references:
            upper = np.triu_indices(len(packed), 1)
            packed[upper] = packed[upper[::-1]]
        return (packed,)

    return candidates.part.session.recall(candidates.key("information", x), compute)[0]


@use_one_thread
def _compute_line_information(candidates: Candidates, item: _Item) -> RealArray:
    """Return the information of each pair at some lines, shape (n_i, n_j, n (n + 1) / 2)."""
    # By reciprocity, pairs of the same candidates are computed once, below the diagonal.
    x, _ = item
    part = candidates.part
    system, unknowns, values = candidates.solver.system, part.unknowns, part.values(x)
    state, lower = part.state(x), np.tril_indices(part.n)
    by_coordinate = part.coordinates.slope(x)[unknowns.owner]
    n_i, n_j = len(candidates.responses), len(candidates.references)
    is_square = candidates.responses == candidates.references
    packed = np.zeros((n_i, n_j, len(lower[0])))
    n_forces = sum(len(system.terms[t].rows) for t in np.unique(unknowns.at))
    for block in _iterate_blocks(candidates, item):
        omega = 2.0 * np.pi * block.freq
        factor = omega ** QUANTITIES[candidates.quantity]
        slopes = unknowns.slopes(system, state, values, omega) * by_coordinate[:, None] * factor
        weight = np.sqrt(2.0 / candidates.variance(block.H))
        step = max(1, INFORMATION.chunk_bytes // (16 * len(omega) * (part.n * n_i + n_forces)))
        for first in range(0, n_j, step):
            part.session.check()
            some = slice(first, first + step)
            partners = slice(first, None) if is_square else slice(None)
            # The sign of the derivatives has no influence.
            J = contract(system, unknowns, slopes, block.V[:, :, partners], block.U[:, :, some])
            J *= weight[:, partners, some]
            rows = np.ascontiguousarray(J.transpose(2, 3, 0, 1)).view(np.float64)
            gram = rows @ rows.transpose(0, 1, 3, 2)
            packed[partners, some] += gram[..., lower[0], lower[1]]
    return packed
