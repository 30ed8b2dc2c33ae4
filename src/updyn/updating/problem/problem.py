"""The problem of an update: models, data of the fit and unknowns with common indices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.excitation import DrivenSolver, find_channels, find_excitation
from updyn.dynamics.fields import FieldSolver, LineSolver, split_into_blocks
from updyn.dynamics.pencil import saves_time
from updyn.dynamics.settings import PENCIL
from updyn.frf import FRF
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.problem.channels import Gains
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.forward import LINEAR, Forward, choose_forward
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise.known import level_by_unit
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.session import Record, Session, digest
from updyn.updating.problem.settings import EVALUATION
from updyn.variants import Variant, build_variants

__all__ = [
    "FRFPart",
    "LineBlock",
    "Problem",
    "relative_levels",
]


T = TypeVar("T", bound="tuple[Any, ...]")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, eq=False)
class LineBlock:
    """Model and measurement at a block of lines, in the measured quantity and signs.

    `dH`, shape (n, n_f, n_i, n_j), has the derivatives by the optimiser's coordinates.
    """

    lines: slice
    H: ComplexArray
    dH: ComplexArray | None  # noqa: N815
    measured: ComplexArray

    def copy(self) -> LineBlock:
        """Return the block with arrays of its own for the model."""
        dH = None if self.dH is None else self.dH.copy()
        return replace(self, H=self.H.copy(), dH=dH)


@dataclass(slots=True, eq=False)
class LatestBlocks:
    """Blocks of lines with derivatives at the latest point: the last one, and others if small.

    A residual with other weights at the same point then needs no further solutions.
    """

    _x: RealArray | None = None
    _blocks: dict[tuple[int, int], LineBlock] = field(default_factory=dict)
    _bytes: int = 0

    def find(self, x: RealArray, lines: slice) -> LineBlock | None:
        """Return the block of some lines at a point, or None."""
        if self._x is None or not np.array_equal(self._x, x):
            return None
        return self._blocks.get((lines.start, lines.stop))

    def store(self, x: RealArray, block: LineBlock) -> None:
        """Store a block at a point; those of other points are dropped."""
        size = block.H.nbytes + (0 if block.dH is None else block.dH.nbytes)
        at_other_point = self._x is None or not np.array_equal(self._x, x)
        if at_other_point or self._bytes + size > EVALUATION.cache_bytes:
            self._x, self._blocks, self._bytes = x.copy(), {}, 0
        self._blocks[block.lines.start, block.lines.stop] = block
        self._bytes += size


@dataclass(frozen=True, slots=True, eq=False)
class FRFPart:
    """Model, data and unknowns of one test.

    `rows` and `columns` are the model DOFs of responses and references; with a `DrivenSolver`,
    `columns` is that of its prescribed motion. `sign`, shape (n_i, n_j), is the product of their
    signs, 0 if symmetry forbids the response. Unless `as_read`, FRFs of the model exclude the
    calibration factors. `variants` are the model without frequent mistakes. Copies in other
    processes have a default `session` and no variants.
    """

    solver: FieldSolver
    unknowns: Unknowns
    coordinates: Coordinates
    frf: FRF
    rows: IndexArray
    columns: IndexArray
    sign: RealArray
    session: Session = field(default_factory=Session, repr=False)
    name: str = ""
    as_read: bool = True
    variants: tuple[Variant, ...] = field(default=(), repr=False)
    forward: Forward = field(default=LINEAR, repr=False)
    _digest: list[bytes] = field(default_factory=list, init=False, repr=False)
    _effort: dict[str, float] = field(default_factory=dict, init=False, repr=False)
    _latest: LatestBlocks = field(default_factory=LatestBlocks, init=False, repr=False)
    _gains: Gains | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # The model is evaluated with the same decay as the data.
        object.__setattr__(self, "solver", self.solver.with_decay(self.frf.decay))
        gains = Gains.find(self.coordinates.parameters, self.frf) if self.as_read else None
        object.__setattr__(self, "_gains", gains)

    def __reduce__(self) -> tuple[object, ...]:
        about = (self.unknowns, self.coordinates, self.frf, self.rows, self.columns, self.sign)
        after = Session(), self.name, self.as_read, (), self.forward
        return FRFPart, (self.solver, *about, *after)

    @classmethod
    def build(
        cls,
        model: Model,
        frf: FRF,
        parameters: ParameterSet,
        *,
        tier: str | None = None,
        backend: str | None = None,
        session: Session | None = None,
        name: str = "",
    ) -> FRFPart:
        """Return the part for a model, data and unknowns."""
        forward = choose_forward(model, frf, parameters)
        system = AffineSystem.compile(replace(model, nonlinear={}))
        excitation = find_excitation(model.dofs, frf)
        if excitation is not None:
            system = excitation.hold(system, float(frf.freq[-1]))
        solver: FieldSolver = LineSolver.choose(system, tier, backend)
        if excitation is not None:
            solver = DrivenSolver(solver, excitation)
        channels = find_channels(solver, frf)
        return cls(
            solver,
            Unknowns.find(system, parameters),
            Coordinates(parameters, omega=_middle_frequency(frf.freq)),
            frf,
            channels.rows,
            channels.columns,
            channels.sign,
            session or Session(),
            name,
            variants=build_variants(model) if forward.is_linear else (),
            forward=forward,
        )

    def with_data(self, frf: FRF) -> FRFPart:
        """Return the part with other data of the same model."""
        found = find_channels(self.solver, frf)
        return replace(self, frf=frf, rows=found.rows, columns=found.columns, sign=found.sign)

    def with_solver(self, solver: FieldSolver) -> FRFPart:
        """Return the part with another solver of the same model, under the same excitation."""
        if isinstance(self.solver, DrivenSolver) and not isinstance(solver, DrivenSolver):
            solver = replace(self.solver, inner=solver)
        return replace(self, solver=solver)

    @property
    def receptance_dofs(self) -> tuple[IndexArray, IndexArray]:
        """DOFs of responses and forces of the receptances that give the responses of the part."""
        # Those of the part come first; under a prescribed motion, its DOFs and forces are added.
        if not isinstance(self.solver, DrivenSolver):
            local = self.forward.dofs
            added = (np.setdiff1d(local, dofs) for dofs in (self.rows, self.columns))
            rows, columns = added
            return np.append(self.rows, rows), np.append(self.columns, columns)
        driven = self.solver.excitation
        return np.append(self.rows, np.setdiff1d(driven.moved, self.rows)), driven.forced

    def channel_errors(self, errors: RealArray) -> RealArray:
        """Return the errors of the channels from those of `receptance_dofs`, (..., n_i, n_j)."""
        own = errors[..., : len(self.rows), : len(self.columns)]
        return own.max(axis=-1, keepdims=True) if isinstance(self.solver, DrivenSolver) else own

    def thin(self, largest: int) -> FRFPart:
        """Return the part on every k-th line, with at most `largest` lines."""
        stride = -(-len(self.frf.freq) // largest)
        if stride <= 1:
            return self
        return replace(self, frf=self.frf.select(lines=self.frf.freq[::stride]))

    def without_rounding(self, x: RealArray, share: float) -> FRFPart:
        """Return the part with exact zeros in channels that are rounding error."""
        # Symmetry forbids these responses, below `share` (`relative_levels`) in data and model.
        # Derivatives of the model's numerical error would count as information on the unknowns.
        is_rounding = relative_levels(self.frf.values, self.frf) <= share
        if is_rounding.any():
            is_rounding &= relative_levels(self.responses(x), self.frf) <= share
        if not is_rounding.any():
            return self
        frf = replace(self.frf, values=np.where(is_rounding, 0.0, self.frf.values))
        return replace(self, frf=frf, sign=np.where(is_rounding, 0.0, self.sign))

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.coordinates.parameters)

    @property
    def n_values(self) -> int:
        """Number of measured values."""
        return int(self.frf.values.size)

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.frf.freq)

    @property
    def solved_lines(self) -> RealArray:
        """Frequencies in Hz at which the linear model is solved."""
        return self.forward.solved_lines(self.frf)

    def values(self, x: RealArray) -> RealArray:
        """Return the unknowns' values at x, shape (n,)."""
        return self.coordinates.to_values(x)

    def gains(self, x: RealArray) -> RealArray:
        """Return the calibration factor of each channel at x, shape (n_i, n_j)."""
        return np.ones(self.sign.shape) if self._gains is None else self._gains.factors(x)

    def state(self, x: RealArray) -> State:
        """Return the state of the compiled model at x."""
        return self.unknowns.state(self.solver.system, self.values(x))

    @property
    def work(self) -> float:
        """Rough number of floating-point operations of an evaluation with derivatives."""
        if "work" not in self._effort:
            self._effort["work"] = self._estimate_work()
        return self._effort["work"]

    def _estimate_work(self) -> float:
        # If one eigendecomposition serves all lines, it is not included: every process repeats it.
        n, n_values = self.solver.system.n, self.sign.size
        columns = len(self.rows) + len(self.columns)
        solve = 8.0 * n**2 * columns
        if self.solver.tier == "sparse":
            # Measured on three-dimensional solids of 10k to 300k DOFs.
            solve = 50.0 * n**1.75
        elif not self._shares_decomposition:
            solve += 8.0 / 3.0 * n**3
        return len(self.frf.freq) * (solve + 4.0 * n_values * self.n**2)

    @property
    def _shares_decomposition(self) -> bool:
        """Whether one eigendecomposition of a dense model serves all lines."""
        if "shared" not in self._effort:
            system, least = self.solver.system, PENCIL.least_lines
            if self.solver.tier == "reduced":
                least = PENCIL.least_reduced_lines
            shared = saves_time(system, system.start, len(self.frf.freq), least)
            self._effort["shared"] = float(shared)
        return bool(self._effort["shared"])

    @property
    def is_distributed(self) -> bool:
        """Whether lines are distributed over workers; if not, whole descents are."""
        return self.work > EVALUATION.distributed_work

    @property
    def is_long(self) -> bool:
        """Whether an evaluation is too long to be started after a stop request."""
        return self.work > EVALUATION.long_work

    def partition(self, n_columns: int | None = None) -> list[slice]:
        """Return the blocks of lines for fields of `n_columns`, by default all channels."""
        if self.forward.is_whole:
            return [slice(0, len(self.frf.freq))]
        n, n_values = self.solver.system.n, self.sign.size
        if n_columns is None:
            n_columns = len(self.rows) + len(self.columns)
        system, tier = self.solver.system, self.solver.tier
        stored = n * n
        if tier == "sparse":
            stored = len(system.indices)
        elif self._shares_decomposition:
            stored = n * n_columns
        size = EVALUATION.block_bytes // (16 * (stored + n * n_columns + self.n * n_values))
        largest = self.solver.block_size(n_columns + self.n * n_values // n)
        return list(split_into_blocks(len(self.frf.freq), max(1, min(int(size), largest))))

    def map_lines(self, function: Callable[[FRFPart, T], R], items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(part, item)`` in order; each item ends with its slice of lines.

        The function must be importable from a module, because it may run in another process.
        """
        results = self.session.map(
            function, self, items, spread=self.is_distributed, long=self.is_long
        )
        for item, result in zip(items, results, strict=True):
            self.session.lines_solved += item[-1].stop - item[-1].start
            yield result

    def key(self, kind: str, x: RealArray, *about: object) -> list[object]:
        """Return the cache key of an evaluation at x."""
        if not self._digest:
            frf = self.frf
            data = (frf.s, frf.values, self.rows, self.columns, self.sign, frf.quantity)
            forward = self.forward.key(frf)
            unknowns = "\n".join(self.coordinates.parameters.names)
            self._digest.append(
                digest((self.name, self.solver.label, self.as_read, unknowns, *data, *forward))
            )
        return [kind, self._digest[0], x, *about]

    def recall(
        self, kind: str, x: RealArray, compute: Callable[[], Record], *about: object
    ) -> Record:
        """Return the cached result of an evaluation at x with further inputs, or compute it."""
        if self.session.cache is None:
            return compute()
        return self.session.recall(self.key(kind, x, *about), compute)

    def block(self, x: RealArray, lines: slice, *, derivatives: bool = True) -> LineBlock:
        """Return the model, times the calibration factors, and the data at a block of lines."""
        if not (derivatives and self.solver.tier == "sparse"):
            return self._compute_block(x, lines, derivatives=derivatives)
        known = self._latest.find(x, lines)
        if known is None:
            known = self._compute_block(x, lines, derivatives=True)
            self._latest.store(x, known)
        return known.copy()

    def known_responses(self, x: RealArray, lines: slice) -> ComplexArray | None:
        """Return the model at the latest block of lines if its derivatives were computed at x."""
        known = self._latest.find(x, lines)
        return None if known is None else known.H

    def remember_responses(self, x: RealArray, blocks: Sequence[ComplexArray | None]) -> None:
        """Store the model's responses at x, by block of all lines, if all are known."""
        known = [H for H in blocks if H is not None]
        if len(known) == len(blocks):
            found = np.concatenate(known)
            found.flags.writeable = False
            self.session.remember([(digest(self.key("responses", x)), (found,))])

    def _compute_block(self, x: RealArray, lines: slice, *, derivatives: bool) -> LineBlock:
        rate = self.frf.s[lines] ** self.frf.power
        H, dH = self.forward.receptances(self, x, lines, rate, derivatives=derivatives)
        if dH is not None and (self.sign != 1.0).any():
            dH *= self.sign
        H = H * (self.sign * rate[:, None, None])
        if self._gains is not None:
            self._gains.apply(x, H, dH)
        return LineBlock(lines, H, dH, self.frf.values[lines])

    def blocks(self, x: RealArray, *, derivatives: bool = True) -> Iterator[LineBlock]:
        """Yield model and data by block of lines, in order and in this process."""
        for lines in self.partition():
            yield self.block(x, lines, derivatives=derivatives)

    def responses(self, x: RealArray) -> ComplexArray:
        """Return the model's FRF in the measured quantity, with calibration, (n_f, n_i, n_j)."""

        def compute() -> Record:
            items = [(x, lines) for lines in self.partition()]
            return (np.concatenate(list(self.map_lines(_block_responses, items))),)

        return self.recall("responses", x, compute)[0]


def relative_levels(H: ComplexArray, frf: FRF) -> RealArray:
    """Return the rms of each channel of H relative to the loudest one, shape (n_i, n_j)."""
    # Each channel is relative to the rms of its unit. The loudest channel is taken over the data
    # and `H`, because numerical errors of a model are a share of its level.
    level, measured = (
        np.sqrt(np.mean(np.abs(values) ** 2, axis=0)) / level_by_unit(frf)[0]
        for values in (H, frf.values)
    )
    loudest = max(float(level.max()), float(measured.max()), np.finfo(float).tiny)
    return np.asarray(level / loudest)


def _middle_frequency(freq: RealArray) -> float:
    """Return the geometric mean of the limits of a band in rad/s."""
    positive = freq[freq > 0]
    if not positive.size:
        return 1.0
    return float(2.0 * np.pi * np.sqrt(positive.min() * positive.max()))


def _block_responses(part: FRFPart, item: tuple[RealArray, slice]) -> ComplexArray:
    x, lines = item
    return part.block(x, lines, derivatives=False).H


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All parts of an update, with the same unknowns; one test may have FRFs and modes."""

    parts: tuple[FRFPart, ...]
    modal: tuple[ModalPart, ...] = ()

    @classmethod
    def of(cls, parts: Sequence[FRFPart], modal: Sequence[ModalPart] = ()) -> Problem:
        """Return parts as one problem, in the coordinates of the first."""
        first: FRFPart | ModalPart = parts[0] if parts else modal[0]
        return cls(tuple(parts), tuple(modal)).with_coordinates(first.coordinates)

    @property
    def all_parts(self) -> tuple[FRFPart | ModalPart, ...]:
        """The parts of FRFs, followed by those of modes."""
        return (*self.parts, *self.modal)

    @property
    def _first(self) -> FRFPart | ModalPart:
        return self.all_parts[0]

    @property
    def coordinates(self) -> Coordinates:
        """The optimiser's coordinates, the same for all parts."""
        return self._first.coordinates

    @property
    def system(self) -> AffineSystem:
        """The compiled model of the first part."""
        return self.parts[0].solver.system if self.parts else self.modal[0].system

    @property
    def session(self) -> Session:
        """Session of all parts."""
        return self._first.session

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self._first.n

    @property
    def n_values(self) -> int:
        """Number of measured values of all FRFs."""
        return sum(part.n_values for part in self.parts)

    def share(self, part: FRFPart) -> int:
        """Return the number of unknowns attributed to a part, by its share of the data."""
        return -(-self.n * part.n_values // self.n_values)

    @property
    def n_numbers(self) -> int:
        """Number of measured real numbers: two for each value of an FRF, and those of modes."""
        return 2 * self.n_values + sum(part.n_numbers for part in self.modal)

    @property
    def n_lines(self) -> int:
        """Number of lines of all parts."""
        return sum(part.n_lines for part in self.parts)

    @property
    def is_distributed(self) -> bool:
        """Whether lines are distributed over workers; if not, whole descents are."""
        return any(part.is_distributed for part in self.parts)

    @property
    def is_linear(self) -> bool:
        """Whether no model has nonlinear elements."""
        return all(part.forward.is_linear for part in self.parts)

    @property
    def without_modes(self) -> Problem:
        """The problem without modes."""
        return replace(self, modal=())

    def thin(self, largest: int) -> Problem:
        """Return the problem with at most `largest` lines in each part."""
        return replace(self, parts=tuple(part.thin(largest) for part in self.parts))

    def with_parts(self, parts: Sequence[FRFPart]) -> Problem:
        """Return the problem with other parts of FRFs, in the coordinates of the first."""
        return Problem.of(parts, self.modal)

    def with_session(self, session: Session) -> Problem:
        """Return the problem with another session."""
        return Problem(
            tuple(replace(part, session=session) for part in self.parts),
            tuple(replace(part, session=session) for part in self.modal),
        )

    def with_coordinates(self, coordinates: Coordinates) -> Problem:
        """Return the problem in other coordinates."""
        parts, modal = [], []
        for part in self.parts:
            is_current = part.coordinates is coordinates
            parts.append(part if is_current else replace(part, coordinates=coordinates))
        for one in self.modal:
            is_current = one.coordinates is coordinates
            modal.append(one if is_current else replace(one, coordinates=coordinates))
        return Problem(tuple(parts), tuple(modal))

    def with_box(self, box: tuple[RealArray, RealArray]) -> Problem:
        """Return the problem with narrower bounds in x."""
        return self.with_coordinates(replace(self.coordinates, box=box))

    def recall(
        self, kind: str, x: RealArray, compute: Callable[[], Record], *about: object
    ) -> Record:
        """Return the cached result of an evaluation of all parts at x, or compute it."""
        if self.session.cache is None:
            return compute()
        keys = []
        for part in self.all_parts:
            keys += part.key(kind, x, *about)
        return self.session.recall(keys, compute)
