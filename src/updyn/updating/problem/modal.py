"""Measured modes as data: `ModalPart` of a test, its pairs with modes of the model, its residuals.

Undamped modes are paired at every point, by shape and frequency; close ones are compared by the
span of their shapes. A measured mode that resembles no mode of the model has no residuals; the
misfit counts it as if its shape did not agree at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import scipy  # loads scipy.optimize on use; its import is slow

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.correlation.clusters import cluster_modes
from updyn.correlation.shapes import find_moving, mac, orthonormalise
from updyn.dynamics.affine import AffineSystem, State
from updyn.errors import DataError, SolverError
from updyn.linalg.solver import check_backend
from updyn.modal import ModeSet
from updyn.modal.loss_factor import LossFactor
from updyn.modal.sensitivity import RealModes, differentiate_modes, separate_repeated_modes
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.local import Local, reduce_blocks
from updyn.updating.problem.modal_reduction import ModalReduction
from updyn.updating.problem.modal_rows import KINDS, ModalRows
from updyn.updating.problem.modal_span import SpanProjection
from updyn.updating.problem.noise.modes import ModalNoise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.session import Record, Session, digest
from updyn.updating.problem.settings import MODE_PAIRS

__all__ = ["ModalError", "ModalPart", "ModalTarget", "Pairs", "check_any_pair"]


@dataclass(frozen=True, slots=True, eq=False)
class ModalTarget:
    """The measured modes of one test at the DOFs of the model."""

    #: Measured eigenvalues omega^2 in 1/s2, shape (m,).
    value: RealArray
    #: Measured shapes times `weight`, shape (k, m), scaled to unit length.
    shapes: RealArray
    #: Their lengths before scaling, shape (m,), for shapes of unit modal mass; else nan.
    length: RealArray
    #: Measured modal loss factors, shape (m,); nan if not measured.
    loss_factor: RealArray
    #: DOFs of the model, shape (k,).
    rows: IndexArray
    #: Sign of each sensor, shape (k,), divided by the rms of all modes at sensors of its unit.
    weight: RealArray
    #: Standard deviations as shares, shape (m,); 0 if not known.
    std_frequency: RealArray
    std_loss_factor: RealArray
    #: Standard deviations of the shapes, shape (k, m), as shares of their rms.
    std_shapes: RealArray
    #: Covariance of the frequencies as shares, shape (m, m); 0 where not known. None: they are
    #: independent.
    cov_frequency: RealArray | None
    #: Part of the cache key.
    digest: str

    @classmethod
    def of(cls, system: AffineSystem, modes: ModeSet) -> ModalTarget:
        """Return measured modes at the DOFs of a compiled model."""
        match = system.dofs.match(modes.dofs, "DOF of the modes")
        if (modes.frequency == 0).any():
            raise DataError(
                "modal: a measured mode at 0 Hz is a rigid-body motion and carries no information;"
                " leave it out"
            )
        shapes = modes.real_shapes
        rotates = modes.dofs.axes >= 3
        level = np.ones(len(rotates))
        for kind in (rotates, ~rotates):
            if kind.any():
                rms = float(np.sqrt(np.mean(shapes[kind] ** 2)))
                level[kind] = rms if rms > 0 else 1.0
        weighted = shapes / level[:, None]
        length = np.linalg.norm(weighted, axis=0) if len(level) else np.ones(len(modes))
        known = modes.loss_factor > 0
        loss = np.where(known, modes.loss_factor, np.nan)
        return cls(
            (2.0 * np.pi * modes.frequency) ** 2,
            weighted / length,
            np.where(modes.scaled, length, np.nan),
            loss,
            match.index,
            match.sign / level,
            np.nan_to_num(modes.std_frequency / modes.frequency),
            np.nan_to_num(modes.std_loss_factor / loss),
            _share_of_rms(modes, level, length),
            _covariance_of_shares(modes),
            modes.digest,
        )

    def select(self, which: Sequence[int]) -> ModalTarget:
        """Return the modes with the given numbers."""
        at = np.asarray(which, dtype=np.intp)
        covariance = self.cov_frequency
        return replace(
            self,
            value=self.value[at],
            shapes=self.shapes[:, at],
            length=self.length[at],
            loss_factor=self.loss_factor[at],
            std_frequency=self.std_frequency[at],
            std_loss_factor=self.std_loss_factor[at],
            std_shapes=self.std_shapes[:, at],
            cov_frequency=None if covariance is None else covariance[np.ix_(at, at)],
            digest=f"{self.digest}/{at.tolist()}",
        )

    def at_sensors(self, shapes: RealArray) -> RealArray:
        """Return shapes of the model at the sensors, with their weights, shape (k, n)."""
        return np.asarray(shapes[self.rows] * self.weight[:, None])

    @property
    def has_shapes(self) -> bool:
        """Whether shapes were measured."""
        return len(self.rows) > 0

    @property
    def can_distinguish_shapes(self) -> bool:
        """Whether shapes can be distinguished: a single sensor cannot."""
        return len(self.rows) > 1

    @property
    def frequency(self) -> RealArray:
        """Measured frequencies in Hz, shape (m,)."""
        return np.asarray(np.sqrt(self.value) / (2.0 * np.pi))

    @property
    def highest(self) -> float:
        """Frequency in Hz up to which modes of the model are considered."""
        return MODE_PAIRS.frequency_reach * float(self.frequency.max())

    @property
    def clusters(self) -> list[IndexArray]:
        """Groups of two or more measured modes with close frequencies, ascending."""
        # A mode that was identified twice is not a cluster: its shapes have one direction.
        if not self.can_distinguish_shapes:
            return []
        found = [members for members in cluster_modes(self.frequency) if len(members) > 1]
        return [
            members
            for members in found
            if orthonormalise(self.shapes[:, members]).shape[1] == len(members)
        ]


def drop_excluded_shapes(modes: ModeSet, noise: ModalNoise) -> ModeSet:
    """Return the modes without their shapes if the noise excludes these, also from the pairing."""
    if not (noise.excludes_shapes and modes.has_shapes):
        return modes
    return ModeSet(
        modes.frequency,
        loss_factor=modes.loss_factor,
        quality=modes.quality,
        source=modes.source,
        std_frequency=modes.std_frequency,
        std_loss_factor=modes.std_loss_factor,
        cov_frequency=modes.cov_frequency,
    )


def _covariance_of_shares(modes: ModeSet) -> RealArray | None:
    """Return the covariance of the frequencies over their product; 0 where not known."""
    if modes.cov_frequency is None:
        return None
    return np.nan_to_num(modes.cov_frequency / (modes.frequency[:, None] * modes.frequency))


def _share_of_rms(modes: ModeSet, level: RealArray, length: RealArray) -> RealArray:
    """Return the standard deviations of weighted shapes as shares of their rms; 0 if unknown."""
    if modes.std_shapes is None:
        return np.zeros(modes.shapes.shape)
    std = np.nan_to_num(modes.std_shapes) / level[:, None]
    return np.asarray(std / (length / np.sqrt(len(level))))


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Modes of the model that are paired with the measured ones.

    `which`, shape (m,), is the number of the paired mode; `spans` has, for each measured mode, the
    modes with whose span its shape is compared: the paired mode, or those of the whole cluster;
    `mac` is that with the best combination of their shapes.
    """

    modes: RealModes
    which: IndexArray
    mac: RealArray
    spans: tuple[IndexArray, ...]

    @classmethod
    def of(
        cls,
        modes: RealModes,
        system: AffineSystem,
        unknowns: Unknowns,
        values: RealArray,
        target: ModalTarget,
        like: float | None = None,
    ) -> Pairs:
        """Pair modes of the model with the measured ones, one to one."""
        # The pairs maximise the sum of MAC less half the logarithm of the frequency ratio
        # (Hungarian assignment; Kuhn 1955). Close measured modes are paired in ascending order if
        # the span of as many modes of the model contains their shapes; else one by one. If shapes
        # cannot be distinguished, the sum of squares of these logarithms is minimised, which keeps
        # the order of the frequencies.
        like = MODE_PAIRS.similar_mac if like is None else like
        if len(modes.value) < len(target.value):
            raise DataError(
                f"modal: {len(target.value)} modes were measured; besides rigid-body motions the"
                f" model has {len(modes.value)}. Give n_modes, or fewer modes"
            )
        modes = separate_repeated_modes(
            modes, system, unknowns, values, target.at_sensors, target.shapes
        )
        clusters = target.clusters
        move = np.zeros(len(modes.value), dtype=np.bool_)
        if target.has_shapes:
            move = find_moving(modes.shapes[target.rows], modes.shapes)
        while True:
            pairs = cls._assign(modes, move, target, clusters)
            confirmed = [members for members in clusters if pairs.mac[members].min() >= like]
            if len(confirmed) == len(clusters):
                return pairs
            clusters = confirmed

    @property
    def n_used(self) -> int:
        """Number of the lowest modes that include all paired ones."""
        return 1 + max(int(span.max()) for span in self.spans)

    @classmethod
    def _assign(
        cls,
        modes: RealModes,
        move: BoolArray,
        target: ModalTarget,
        clusters: Sequence[IndexArray],
    ) -> Pairs:
        """Return the best pairs, with the measured modes of `clusters` compared by their spans."""
        # `move` states which modes of the model move at the sensors.
        # The MAC of a mode that does not move at the sensors is rounding error. With a single
        # sensor all MACs are 1.
        macs = np.ones((len(modes.value), len(target.value)))
        if target.has_shapes:
            macs[~move] = 0.0
            if move.any():
                shapes = target.at_sensors(modes.shapes[:, move])
                macs[move] = mac(shapes, target.shapes)
                for members in clusters:
                    macs[np.ix_(move, members)] = _subspace_mac(shapes, target.shapes[:, members])[
                        :, None
                    ]
        log_ratio = np.abs(np.log(modes.value[:, None] / target.value)) / 2.0
        cost = (
            MODE_PAIRS.frequency_cost * log_ratio if target.can_distinguish_shapes else log_ratio**2
        )
        first, second = scipy.optimize.linear_sum_assignment(macs - cost, maximize=True)
        which = first[np.argsort(second)]
        mac_of_pairs = macs[which, np.arange(len(which))]
        spans = [which[k : k + 1] for k in range(len(which))]
        for members in clusters:
            which[members] = span = np.sort(which[members])
            shapes = target.at_sensors(modes.shapes[:, span])
            mac_of_pairs[members] = (
                _subspace_mac(target.shapes[:, members], shapes) if move[span].all() else 0.0
            )
            for k in members:
                spans[k] = span
        return cls(modes, which, mac_of_pairs, tuple(spans))


def _subspace_mac(shapes: RealArray, span: RealArray) -> RealArray:
    """Return the MAC of each shape with the best combination of the shapes of a span, (m,)."""
    basis, size, _ = np.linalg.svd(span / np.linalg.norm(span, axis=0), full_matrices=False)
    basis = basis[:, size > MODE_PAIRS.shape_rounding * size[0]]
    share = np.linalg.norm(basis.T @ shapes, axis=0) / np.linalg.norm(shapes, axis=0)
    return np.asarray(np.minimum(share**2, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class ModalPart:
    """Model, measured modes and unknowns of one test.

    `noise` is as far as known before a fit; `least_mac` is the smallest MAC of similar modes;
    `name` is that of the test if there are several. `reduction` is None if the full model is
    solved, as in other processes.
    """

    system: AffineSystem
    unknowns: Unknowns
    coordinates: Coordinates
    target: ModalTarget
    noise: ModalNoise = field(default_factory=ModalNoise)
    session: Session = field(default_factory=Session, repr=False)
    name: str = ""
    least_mac: float = MODE_PAIRS.similar_mac
    reduction: ModalReduction | None = None

    def __reduce__(self) -> tuple[object, ...]:
        about = (self.unknowns, self.coordinates, self.target, self.noise)
        return ModalPart, (self.system, *about, Session(), self.name, self.least_mac)

    @classmethod
    def build(
        cls,
        model: Model,
        modes: ModeSet,
        parameters: ParameterSet,
        noise: ModalNoise,
        *,
        session: Session | None = None,
        name: str = "",
        backend: str | None = None,
        reduced: bool = False,
    ) -> ModalPart:
        """Return the part for a model, measured modes and unknowns."""
        system = AffineSystem.compile(model)
        target = ModalTarget.of(system, drop_excluded_shapes(modes, noise))
        middle = 2.0 * np.pi * float(np.exp(np.mean(np.log(target.frequency))))
        unknowns, reduction = Unknowns.find(system, parameters), None
        if reduced:
            shapes = target.can_distinguish_shapes
            reduction = ModalReduction.of(system, unknowns, check_backend(backend), shapes=shapes)
        return cls(
            system,
            unknowns,
            Coordinates(parameters, omega=middle),
            target,
            noise,
            session or Session(),
            name,
            reduction=reduction,
        )

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.coordinates.parameters)

    @property
    def n_numbers(self) -> int:
        """Number of measured numbers: frequencies, normalised shapes, and loss factors if used."""
        k, m = self.target.shapes.shape
        damped = int(np.isfinite(self.target.loss_factor).sum()) if self.has_damping_unknowns else 0
        return int(m * max(k, 1) + damped)

    @property
    def has_damping_unknowns(self) -> bool:
        """Whether an unknown changes the damping of a group independently of its stiffness."""
        viscous = [self.system.terms[at].quantity == "viscous" for at in self.unknowns.at]
        return bool(any(viscous) or not self.unknowns.scales.all())

    def values(self, x: RealArray) -> RealArray:
        """Return the unknowns' values at x, shape (n,)."""
        return self.coordinates.to_values(x)

    def state(self, x: RealArray) -> State:
        """Return the state of the compiled model at x."""
        return self.unknowns.state(self.system, self.values(x))

    def key(self, kind: str, x: RealArray, *about: object) -> list[object]:
        """Return the cache key of an evaluation at x."""
        unknowns = "\n".join(self.coordinates.parameters.names)
        content = digest(("modes", self.name, self.target.digest, str(self.least_mac), unknowns))
        return [kind, content, x, *about]

    def recall(self, kind: str, x: RealArray, compute: Callable[[], Record]) -> Record:
        """Return the cached result of an evaluation at x, or compute it."""
        if self.reduction is not None:
            return self.reduction.recall(self.session, self.key(kind, x), compute)
        if self.session.cache is None:
            return compute()
        return self.session.recall(self.key(kind, x), compute)

    def is_cached(self, kind: str, x: RealArray) -> bool:
        """Return whether the result of an evaluation at x is cached."""
        if self.reduction is not None:
            return self.reduction.has(self.session, self.key(kind, x))
        return self.session.has(self.key(kind, x))

    def pairs(self, x: RealArray) -> Pairs:
        """Return the pairs of modes at x."""
        state, about = self.state(x), (len(self.target.value), self.target.highest)
        if self.reduction is None:
            return self._pair(RealModes.lowest(self.system, state, *about), x)
        reduced = self.reduction.modes
        while True:
            pairs = self._pair(reduced.lowest(state, *about), x)
            if reduced.certify_or_enrich(state, self.values(x), pairs.modes, pairs.n_used):
                return pairs
            self.session.check(often=True)

    def _pair(self, modes: RealModes, x: RealArray) -> Pairs:
        about = self.system, self.unknowns, self.values(x)
        return Pairs.of(modes, *about, self.target, self.least_mac)

    def confirm(self, x: RealArray) -> bool:
        """Return whether the paired modes at x are those of the full model; if not, add these."""
        if self.reduction is None:
            return True
        pairs = self.pairs(x)
        full = RealModes.lowest(self.system, self.state(x), pairs.n_used, highest=0.0)
        return self.reduction.confirm(pairs, full)

    def rows(self, x: RealArray, *, shapes: bool = True, derivatives: bool = True) -> ModalRows:
        """Return the residuals at x and their derivatives, which may be zero if not needed."""

        def compute(*, derivatives: bool = True) -> Record:
            found = self._compute_rows(x, shapes=shapes, derivatives=derivatives)
            return found.r, found.J, found.kind, found.mode, found.std, found.mac

        if not derivatives and not self.is_cached(_cache_kind(shapes=shapes), x):
            few = partial(compute, derivatives=False)
            return ModalRows(*self.recall(f"{_cache_kind(shapes=shapes)} alone", x, few))
        return ModalRows(*self.recall(_cache_kind(shapes=shapes), x, compute))

    def record_unpaired(self, rows: ModalRows) -> dict[str, str]:
        """Return the record of the frequencies of modes that resemble no mode of the model."""
        frequencies = self.target.frequency[rows.unpaired_modes(self.least_mac)]
        if not len(frequencies):
            return {}
        return {"left_out": ", ".join(f"{f:.4g}" for f in frequencies) + " Hz"}

    def _compute_rows(self, x: RealArray, *, shapes: bool, derivatives: bool) -> ModalRows:
        pairs = self.pairs(x)
        paired = np.flatnonzero(pairs.mac >= self.least_mac)
        found: list[_ModalResidual] = []
        owners: list[int] = []
        derivatives_of_modes = self._derivatives_of_modes(
            pairs, paired, x, shapes=shapes, derivatives=derivatives
        )
        for k, mode in zip(paired.tolist(), derivatives_of_modes, strict=True):
            self.session.check()
            residuals = list(self._residuals_of_mode(pairs, k, mode))
            found += residuals
            owners += [k] * len(residuals)
        sizes = [len(one.r) for one in found]
        return ModalRows(
            np.concatenate([np.zeros(0), *(one.r for one in found)]),
            np.vstack([np.zeros((0, self.n)), *(one.J for one in found)]),
            np.repeat(np.array([KINDS.index(one.kind) for one in found], dtype=np.intp), sizes),
            np.repeat(np.array(owners, dtype=np.intp), sizes),
            np.concatenate([np.zeros(0), *(one.std for one in found)]),
            pairs.mac,
        )

    def _derivatives_of_modes(
        self,
        pairs: Pairs,
        paired: IndexArray,
        x: RealArray,
        *,
        shapes: bool,
        derivatives: bool,
    ) -> Iterator[_ModeDerivatives]:
        """Yield the derivatives of each paired mode by x; zeros without `derivatives`."""
        target, values, slope = self.target, self.values(x), self.coordinates.slope(x)
        which, losses = pairs.which[paired], list[LossFactor | None]()
        state = self.state(x) if self.has_damping_unknowns else None
        for k, mode in zip(paired, which, strict=True):
            loss = None
            if state is not None and np.isfinite(target.loss_factor[k]):
                phi, value = pairs.modes.shapes[:, mode], float(pairs.modes.value[mode])
                loss = LossFactor.of(self.system, self.unknowns, state, values, phi, value)
            losses.append(loss)
        rows = target.rows if shapes and target.can_distinguish_shapes else target.rows[:0]
        number = len(rows)
        damped = any(loss is not None for loss in losses)
        needed = np.unique(np.concatenate([which, *(pairs.spans[k] for k in paired)]))
        at = np.searchsorted(needed, which)
        by_value = np.zeros((len(needed), self.n))
        by_shape = np.zeros((len(needed), self.n, number + damped))
        if derivatives and len(needed):
            forces = np.zeros((self.system.n, len(needed)))
            for place, loss in zip(at, losses, strict=True):
                if loss is not None:
                    forces[:, place] = loss.force
            by_value, by_shape = differentiate_modes(
                pairs.modes,
                needed,
                self.system,
                self.unknowns,
                values,
                rows,
                forces if damped else None,
            )
        by_value, by_shape = by_value * slope, by_shape.transpose(0, 2, 1) * slope
        for k, place, loss in zip(paired, at, losses, strict=True):
            value, shape = by_value[place], by_shape[place]
            by_loss = np.zeros(self.n)
            if loss is not None:
                by_loss = loss.derivatives(value, shape[-1], slope)
            span = by_shape[np.searchsorted(needed, pairs.spans[k]), :number]
            yield _ModeDerivatives(value, span, loss, by_loss)

    def _residuals_of_mode(
        self, pairs: Pairs, k: int, derivatives: _ModeDerivatives
    ) -> Iterator[_ModalResidual]:
        target, eigenvalue = self.target, float(pairs.modes.value[pairs.which[k]])
        error = 0.5 * np.log(eigenvalue / target.value[k])
        yield _ModalResidual.of(
            "frequency", error, 0.5 * derivatives.value / eigenvalue, target.std_frequency[k]
        )
        if derivatives.loss is not None:
            measured = float(target.loss_factor[k])
            error = derivatives.loss.factor / measured - 1.0
            by_loss = derivatives.by_loss / measured
            yield _ModalResidual.of("loss_factor", error, by_loss, target.std_loss_factor[k])
        if derivatives.span.shape[1] and pairs.mac[k] > 0.0:
            yield from self._residuals_of_shape(
                k, pairs.modes.shapes[:, pairs.spans[k]], derivatives.span
            )

    def _residuals_of_shape(
        self, k: int, span: RealArray, by_x: RealArray
    ) -> Iterator[_ModalResidual]:
        """Yield the residuals of a shape; `by_x` are the derivatives of a span at the sensors."""
        target = self.target
        weighted_derivatives, unit = by_x * target.weight[:, None], np.sqrt(len(target.rows))
        projection = SpanProjection.of(
            target.shapes[:, k], target.at_sensors(span), weighted_derivatives
        )
        by_shape = unit * projection.within_by_x
        yield _ModalResidual.of(
            "shape", unit * projection.difference, by_shape, target.std_shapes[:, k]
        )
        yield _ModalResidual.of("mac", *projection.mac_residual)
        if np.isfinite(target.length[k]):
            size = np.log(projection.size / target.length[k])
            yield _ModalResidual.of("scale", size, projection.size_by_x / projection.size)


@dataclass(frozen=True, slots=True, eq=False)
class _ModeDerivatives:
    """Derivatives by x of the eigenvalue (n,) and loss factor of one mode, and of shapes (s, k, n).

    `span` has the shape (s, 0, n) if shapes are not compared.
    """

    value: RealArray
    span: RealArray
    loss: LossFactor | None
    by_loss: RealArray


@dataclass(frozen=True, slots=True, eq=False)
class _ModalResidual:
    """Residuals of one kind (of `KINDS`) of a mode, as shares; `std` is that of the data or 0."""

    kind: str
    r: RealArray
    J: RealArray
    std: RealArray

    @classmethod
    def of(cls, kind: str, r: Any, J: RealArray, std: Any = 0.0) -> _ModalResidual:
        """Return residuals; `r` may be a single number."""
        rows = np.atleast_1d(r)
        return cls(kind, rows, np.atleast_2d(J), np.broadcast_to(std, rows.shape))


def check_any_pair(parts: Sequence[ModalPart], x: RealArray, *, shapes: bool = True) -> None:
    """Raise DataError if no measured mode resembles a mode of its model at x."""
    rows = [part.rows(x, shapes=shapes) for part in parts]
    if any(
        len(one.unpaired_modes(part.least_mac)) < len(one.mac)
        for part, one in zip(parts, rows, strict=True)
    ):
        return
    part, best = max(zip(parts, rows, strict=True), key=lambda both: float(both[1].mac.max()))
    frequency = part.target.frequency[np.argmax(best.mac)]
    raise DataError(
        "modal: no measured mode resembles a mode of the model at its start: the largest MAC is"
        f" {best.mac.max():.2f}, at {frequency:.4g} Hz (expected {part.least_mac:g})"
    )


def _cache_kind(*, shapes: bool) -> str:
    return "modes and shapes" if shapes else "frequencies"


@dataclass(frozen=True, slots=True, eq=False)
class ModalError:
    """Residuals of modes, each divided by its standard deviation; of shapes only if `shapes`."""

    noise: ModalNoise
    shapes: bool = True

    name: ClassVar[str] = "modal"

    @property
    def kind(self) -> str:
        """Kind of its evaluations in the cache key."""
        return _cache_kind(shapes=self.shapes)

    def rows(self, part: ModalPart, x: RealArray, *, derivatives: bool = True) -> ModalRows:
        """Return the unweighted residuals at x, uncorrelated."""
        rows = part.rows(x, shapes=self.shapes, derivatives=derivatives)
        return rows.decorrelate_frequencies(part.target.cov_frequency)

    def local(self, part: ModalPart, x: RealArray) -> Local:
        """Return the reduced least-squares problem at x."""
        rows = self.rows(part, x)
        weight = 1.0 / self.noise.std(rows)
        block = np.hstack([rows.J, rows.r[:, None]]) * weight[:, None]
        if not np.isfinite(block).all():
            raise SolverError("the derivatives of the model's modes are not finite")
        local = reduce_blocks([np.asfortranarray(block)], part.n)
        square_of_unpaired = 0.5 * self._square_of_unpaired(part, rows)
        return replace(local, cost=local.cost + square_of_unpaired)

    def power(self, part: ModalPart, x: RealArray) -> tuple[float, int]:
        """Return the weighted sum of squares of the paired modes, and its number of residuals."""
        rows = self.rows(part, x)
        number = sum(rows.freedom(kind) for kind in self.noise.added)
        return float(np.sum((rows.r / self.noise.std(rows)) ** 2)), number

    def negative_log_likelihood(self, part: ModalPart, x: RealArray) -> float:
        """Return the negative log-likelihood at x, up to a constant."""
        rows = self.rows(part, x, derivatives=False)
        std = self.noise.std(rows)
        used = np.isfinite(std)
        # The length of a shape is free: one number less.
        k = max(len(part.target.rows), 1)
        share = np.where(rows.kind == KINDS.index("shape"), (k - 1.0) / k, 1.0)[used]
        paired = np.sum(0.5 * (rows.r[used] / std[used]) ** 2 + share * np.log(std[used]))
        size = sum(number * float(np.log(std)) for number, std in self._residuals_of_unpaired(part))
        return (
            float(paired)
            + len(rows.unpaired_modes(part.least_mac)) * size
            + 0.5 * self._square_of_unpaired(part, rows)
        )

    def _square_of_unpaired(self, part: ModalPart, rows: ModalRows) -> float:
        """Return the weighted sum of squares of the measured modes without a counterpart."""
        one = sum(
            number * (MODE_PAIRS.unpaired_residual / std) ** 2
            for number, std in self._residuals_of_unpaired(part)
        )
        return len(rows.unpaired_modes(part.least_mac)) * float(one)

    def _residuals_of_unpaired(self, part: ModalPart) -> list[tuple[int, float]]:
        """Return number and standard deviation of the residuals of a mode, by kind."""
        counts = {"frequency": 1, "loss_factor": int(part.has_damping_unknowns)}
        if self.shapes and part.target.can_distinguish_shapes:
            counts |= {"shape": len(part.target.rows) - 1, "mac": 1}
        added = self.noise.added
        return [(n, added[kind]) for kind, n in counts.items() if n and kind in added]
