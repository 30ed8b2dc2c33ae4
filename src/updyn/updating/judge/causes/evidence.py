"""Model and data at one point of the unknowns, with derivatives of the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import State
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.altered import divide_logs, replace_channels
from updyn.updating.judge.causes.element import Receptances
from updyn.updating.judge.causes.labels import list_response_labels, list_unsigned_labels
from updyn.updating.judge.causes.misfit import compute_log_misfit, count_values
from updyn.updating.judge.causes.places import iter_force_places, iter_sensor_places, list_labels
from updyn.updating.judge.causes.rates import compute_rayleigh_slopes, list_fixed_coefficients
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, CAUSE_SEARCH, SUPPORT_FAULT
from updyn.updating.problem.parameters import Parameter
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import Record

__all__ = [
    "Evidence",
    "HeldQuantity",
    "compute_spread",
    "find_held",
    "scale_stiffness",
    "stack_real_imag",
]


def compute_spread(part: FRFPart) -> RealArray:
    """Return the standard deviations of the unknowns about their start, as x, shape (n,)."""
    parameters = part.coordinates.parameters
    usual = np.where(parameters.is_factor, CAUSE_MISFIT.factor_std, CAUSE_MISFIT.loss_std)
    given = [p.prior_std for p in parameters]
    return np.array([u if g is None else g for u, g in zip(usual, given, strict=True)])


@dataclass(frozen=True, slots=True)
class HeldQuantity(Parameter):
    """A quantity of the model that is not an unknown of the update but may be slightly wrong."""


def find_held(part: FRFPart) -> BoolArray:
    """Return which of the unknowns are held stiffnesses and masses, shape (n,)."""
    parameters = part.coordinates.parameters
    return np.array(
        [isinstance(p, HeldQuantity) and p.quantity in ("stiffness", "mass") for p in parameters]
    )


def scale_stiffness(part: FRFPart, x: RealArray, group: str, log_factor: float) -> State:
    """Return the model at x with exp(log_factor) times the stiffness of a group."""
    state, terms = part.state(x), part.solver.system.terms
    is_scaled = [term.group == group and term.quantity == "stiffness" for term in terms]
    return replace(state, factor=np.where(is_scaled, np.exp(log_factor), 1.0) * state.factor)


@dataclass(frozen=True, slots=True, eq=False)
class _ModelResponses:
    """Responses of the model: channels; H, (n_f, n_i, n_j); d ln H / d x, (n, n_f, n_i, n_j)."""

    labels: list[str]
    references: list[str]
    H: ComplexArray
    slopes: ComplexArray

    def add_responses(self, more: _ModelResponses) -> _ModelResponses:
        """Return these and further responses to the same references."""
        labels = self.labels + more.labels
        return self._join(more, 1, labels, self.references)

    def add_references(self, more: _ModelResponses) -> _ModelResponses:
        """Return these and the same responses to further references."""
        references = self.references + more.references
        return self._join(more, 2, self.labels, references)

    def _join(
        self, more: _ModelResponses, axis: int, labels: list[str], references: list[str]
    ) -> _ModelResponses:
        H = np.concatenate([self.H, more.H], axis=axis)
        slopes = np.concatenate([self.slopes, more.slopes], axis=axis + 1)
        return _ModelResponses(labels, references, H, slopes)

    def find_indices(self, frf: FRF) -> tuple[IndexArray, IndexArray]:
        rows = [self.labels.index(label) for label in list_response_labels(frf)]
        columns = [self.references.index(label) for label in list_unsigned_labels(frf.references)]
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Model and data of one test at a point, on few lines; the data need a known variance."""

    part: FRFPart
    x: RealArray
    _ratio_cache: dict[tuple[str, float], ComplexArray] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def frf(self) -> FRF:
        """The data."""
        return self.part.frf

    def _compute_responses(self, labels: list[str], references: list[str]) -> _ModelResponses:
        """Return the model's H and its slopes at responses and references."""
        blank_part = replace_channels(self.part, labels, references, self.frf.quantity)

        def compute() -> Record:
            found = list(
                blank_part.map_lines(
                    _solve_block, [(self.x, lines) for lines in blank_part.partition()]
                )
            )
            return tuple(
                np.concatenate(one, axis=i) for i, one in enumerate(zip(*found, strict=True))
            )

        H, dH = blank_part.recall("derivatives", self.x, compute)
        return _ModelResponses(labels, references, H, np.asarray(dH / np.where(H == 0, 1.0, H)))

    @cached_property
    def _measured_responses(self) -> _ModelResponses:
        return self._compute_responses(
            list_response_labels(self.frf), list_unsigned_labels(self.frf.references)
        )

    @cached_property
    def _responses_elsewhere(self) -> _ModelResponses:
        """The model's H at the measured responses and at places where these may be instead."""
        measured, labels = self._measured_responses, list_labels(iter_sensor_places(self.part))
        return measured.add_responses(self._compute_responses(labels, measured.references))

    @cached_property
    def _responses_to_moved_forces(self) -> _ModelResponses:
        """The model's H for the references and for places at which these may act instead."""
        measured, labels = self._measured_responses, list_labels(iter_force_places(self.part))
        return measured.add_references(self._compute_responses(measured.labels, labels))

    def model_response(self, frf: FRF) -> ComplexArray:
        """Return the model's H at the channels of data, shape (n_f, n_i, n_j)."""
        return self._own_response if self._has_channels_of(frf) else self._select_response(frf)

    @cached_property
    def _own_response(self) -> ComplexArray:
        """The model's H at the channels of its data."""
        return self._select_response(self.frf)

    def _select_response(self, frf: FRF) -> ComplexArray:
        known = self._find_responses(frf)
        rows, columns = known.find_indices(frf)
        sign = frf.responses.signs[:, None].astype(float) * frf.references.signs
        return np.asarray(known.H[:, rows[:, None], columns] * sign)

    def model_slopes(self, frf: FRF) -> ComplexArray:
        """Return d H / d x at the channels of data, shape (n, n_f, n_i, n_j)."""
        known = self._find_responses(frf)
        rows, columns = known.find_indices(frf)
        return np.asarray(known.slopes[:, :, rows[:, None], columns] * self.model_response(frf))

    def _has_channels_of(self, frf: FRF) -> bool:
        return frf.responses == self.frf.responses and frf.references == self.frf.references

    def _find_responses(self, frf: FRF) -> _ModelResponses:
        """Return the responses of the model that contain the channels of data."""
        known = self._measured_responses
        if not set(list_response_labels(frf)) <= set(known.labels):
            known = self._responses_elsewhere
        elif not set(list_unsigned_labels(frf.references)) <= set(known.references):
            known = self._responses_to_moved_forces
        return known

    @cached_property
    def slope_by_frequency(self) -> ComplexArray:
        """Slope d ln H / d f of the model, in 1/Hz, shape (n_f, n_i, n_j)."""
        moving = self.frf.freq[self.frf.freq > 0.0]
        # A line of 0 Hz is moved slightly, because a mobility is zero there and has no logarithm.
        freq = np.maximum(self.frf.freq, CAUSE_MISFIT.zero_replacement * moving.min(initial=1.0))
        low, high = (
            self.part.with_data(replace(self.frf, freq=freq * factor)).responses(self.x)
            for factor in (1.0 - CAUSE_MISFIT.frequency_step, 1.0 + CAUSE_MISFIT.frequency_step)
        )
        width = 2.0 * CAUSE_MISFIT.frequency_step * freq
        return np.asarray(divide_logs(high, low) / width[:, None, None])

    def log_ratio_with_decay(self, rate: float) -> ComplexArray:
        """Return the model's ln H(i omega + rate) / H(i omega), shape (n_f, n_i, n_j)."""
        windowed = replace(self.frf, decay=self.frf.decay + rate)
        return self._log_ratio_on_lines("damped", rate, windowed)

    def log_ratio_with_scaled_axis(self, log_factor: float) -> ComplexArray:
        """Return the model's ln A(exp(log_factor) f) / A(f), shape (n_f, n_i, n_j)."""
        # A is the accelerance. The ratio is also that of a model with exp(-2 log_factor) times all
        # stiffnesses to the model itself.
        scaled = replace(self.frf, freq=self.frf.freq * np.exp(log_factor))
        power = QUANTITIES["accelerance"] - self.frf.modal_power
        return self._log_ratio_on_lines("stretched", log_factor, scaled) + power * log_factor

    def _log_ratio_on_lines(self, kind: str, value: float, other_lines: FRF) -> ComplexArray:
        """Return the model's ln H on other lines over H, from the cache if known."""
        known = self._ratio_cache.get((kind, value))
        if known is None:
            H = self.part.with_data(other_lines).responses(self.x)
            known = self._ratio_cache[kind, value] = divide_logs(H, self.model_response(self.frf))
        return known

    def log_ratio_on_suspension(self, frequency: float) -> ComplexArray:
        """Return ln of H on a suspension over H, shape (n_f, n_i, n_j); `frequency` in Hz."""
        # K + (2 pi frequency)^2 (1 + i eta) M replaces K, with eta the loss factor of soft
        # supports.
        part, state = self.part, self.part.state(self.x)
        mass = np.array([term.quantity == "mass" for term in part.solver.system.terms])
        square = (2.0 * np.pi * frequency) ** 2 * (1.0 + 1j * SUPPORT_FAULT.soft_loss)
        lift = np.where(mass, state.factor * square, 0.0)
        return self._recall_log_ratio(
            "lifted", frequency, lambda: _compute_receptance(part, state, lift)
        )

    def log_ratio_with_stiffness(self, group: str, log_factor: float) -> ComplexArray:
        """Return the model's ln H with exp(log_factor) times a group's stiffness over H."""
        state = scale_stiffness(self.part, self.x, group, log_factor)
        return self._recall_log_ratio(
            "loosened " + group, log_factor, lambda: _compute_receptance(self.part, state)
        )

    def _recall_log_ratio(
        self, kind: str, value: float, compute_altered: Callable[[], ComplexArray]
    ) -> ComplexArray:
        """Return ln H of an altered model over H, from the records of the session if known."""
        part = self.part

        def compute() -> Record:
            return (divide_logs(compute_altered(), _compute_receptance(part, part.state(self.x))),)

        (ratio,) = part.recall(kind, self.x, compute, np.array(value))
        return ratio

    @cached_property
    def drive_point_response(self) -> ComplexArray:
        """Drive-point receptance of the model at each response times omega^2, shape (n_f, n_i)."""
        labels = list_response_labels(self.frf)
        H = replace_channels(self.part, labels, labels, "accelerance").responses(self.x)
        return np.asarray(-np.diagonal(H, axis1=1, axis2=2))

    @cached_property
    def receptances(self) -> Receptances:
        """Receptances of the model between all measured DOFs."""
        return Receptances.of(self.part, self.x)

    @property
    def slopes_by_unknown(self) -> ComplexArray:
        """Slopes d ln H / d x of the model, shape (n, n_f, n_i, n_j)."""
        return self._measured_responses.slopes

    @cached_property
    def slopes_by_rate(self) -> dict[str, ComplexArray]:
        """Slopes d ln H / d c for the Rayleigh coefficients c that are not unknowns, by name."""
        return compute_rayleigh_slopes(self.part, self.x, list_fixed_coefficients(self.part))

    @cached_property
    def spread(self) -> RealArray:
        """Standard deviations of the unknowns about their start, as x, shape (n,)."""
        return compute_spread(self.part)

    @cached_property
    def offset_to_start(self) -> RealArray:
        """Difference of the start of the unknowns from x, in units of their spread, shape (n,)."""
        return np.asarray((self.part.coordinates.start - self.x) / self.spread)

    @cached_property
    def weight(self) -> RealArray:
        """Weight of each value, from 0 to 1, shape (n_f, n_i, n_j)."""
        return compute_log_misfit(self.model_response(self.frf), self.frf)[1]

    @cached_property
    def noise_channels(self) -> frozenset[str]:
        """Labels of the responses that are noise, in data and model, at nearly all lines."""
        # A fault of these changes only the level to which other channels are compared.
        clear = (self.weight > 0.0).any(axis=2).sum(axis=0)
        labels = list_response_labels(self.frf)
        too_few = clear < CAUSE_SEARCH.least_lines
        return frozenset(one for one, few in zip(labels, too_few, strict=True) if few)

    @cached_property
    def n_values(self) -> int:
        """Number of real values of the data with weight."""
        return count_values(self.frf)

    def misfit(self, frf: FRF) -> RealArray:
        """Return the misfit of data on the same lines, real parts above imaginary parts."""
        return stack_real_imag(compute_log_misfit(self.model_response(frf), frf)[0])

    @cached_property
    def rms_misfit(self) -> float:
        """Root mean square of the misfit of the data."""
        e = self.misfit(self.frf)
        return float(np.sqrt(2.0 * e @ e / e.size)) + CAUSE_MISFIT.perfect_rms

    @cached_property
    def misfit_with_prior(self) -> RealArray:
        """Misfit in units of `rms_misfit`, above the offsets of the unknowns, shape (2 m + n,)."""
        return np.concatenate([self.misfit(self.frf) / self.rms_misfit, self.offset_to_start])

    @cached_property
    def adapted_misfit(self) -> RealArray:
        """`misfit_with_prior` after all unknowns have adapted, to first order."""
        return self.project_out_unknowns(self.misfit_with_prior)

    def project_out_unknowns(self, b: RealArray) -> RealArray:
        """Return the residual after all unknowns have adapted, to first order.

        `b`, shape (2 m + n,) or (2 m + n, k), is a change of the misfit in units of `rms_misfit`,
        above one of the unknowns in units of their spread.
        """
        Q = self.orthonormal_basis[0]
        return np.asarray(b - Q @ (Q.T @ b))

    @cached_property
    def jacobian(self) -> RealArray:
        """Changes of the misfit by the unknowns, to first order, shape (2 m, n)."""
        return self.derive_misfit(self.frf, self.weight)

    @cached_property
    def normal_matrix(self) -> RealArray:
        """Inner products of `jacobian`, shape (n, n)."""
        return np.asarray(self.jacobian.T @ self.jacobian)

    @cached_property
    def jacobian_with_prior(self) -> RealArray:
        """Changes of `misfit_with_prior` by the unknowns, shape (2 m + n, n)."""
        return np.vstack([self.jacobian / self.rms_misfit, np.diag(1.0 / self.spread)])

    @cached_property
    def orthonormal_basis(self) -> tuple[RealArray, RealArray]:
        """QR factors of `jacobian_with_prior`; the prior makes its columns independent."""
        Q, R = np.linalg.qr(self.jacobian_with_prior)
        return Q, R

    def derive_misfit(self, frf: FRF, weight: RealArray) -> RealArray:
        """Return changes of the misfit at the channels of data by the unknowns, shape (2 m, n)."""
        return np.stack([stack_real_imag(weight * one) for one in self.log_slopes(frf)], axis=1)

    def log_slopes(self, frf: FRF) -> ComplexArray:
        """Return d ln H / d x at the channels of data, shape (n, n_f, n_i, n_j)."""
        known = self._find_responses(frf)
        rows, columns = known.find_indices(frf)
        return np.asarray(known.slopes[:, :, rows[:, None], columns])

    def select_channels(self, rows: IndexArray, columns: IndexArray) -> Evidence:
        """Return the evidence of the given responses and references alone."""
        return _ChannelEvidence(self.part, self.x, self, rows, columns)


@dataclass(frozen=True, eq=False)
class _ChannelEvidence(Evidence):
    """Some channels of the evidence of a part, whose model is not evaluated again."""

    whole: Evidence
    response_indices: IndexArray
    reference_indices: IndexArray

    @cached_property
    def frf(self) -> FRF:
        """The data."""
        every, i, j = self.whole.frf, self.response_indices, self.reference_indices
        parts: dict[str, Any] = {
            name: getattr(every, name)[:, i[:, None], j]
            for name in ("values", "variance", "coherence")
            if getattr(every, name) is not None
        }
        parts |= {"responses": every.responses[i], "references": every.references[j]}
        return replace(every, **parts)

    def _find_responses(self, frf: FRF) -> _ModelResponses:
        return self.whole._find_responses(frf)

    @cached_property
    def slope_by_frequency(self) -> ComplexArray:
        """Slope d ln H / d f of the model, in 1/Hz, shape (n_f, n_i, n_j)."""
        return self._select(self.whole.slope_by_frequency)

    def log_ratio_with_scaled_axis(self, log_factor: float) -> ComplexArray:
        """Return the model's ln A(exp(log_factor) f) / A(f), shape (n_f, n_i, n_j)."""
        return self._select(self.whole.log_ratio_with_scaled_axis(log_factor))

    def _select(self, values: ComplexArray) -> ComplexArray:
        return values[:, self.response_indices[:, None], self.reference_indices]


def _solve_block(part: FRFPart, item: tuple[RealArray, slice]) -> tuple[ComplexArray, ComplexArray]:
    """Return H and its derivatives at a block of lines."""
    block = part.block(*item)
    assert block.dH is not None
    return block.H, block.dH


def _compute_receptance(
    part: FRFPart, state: State, lift: ComplexArray | None = None
) -> ComplexArray:
    """Return the receptance of the channels; `lift` is added to the coefficients of the terms."""
    freq = part.frf.freq
    columns, place = np.unique(part.columns, return_inverse=True)
    c = part.solver.system.coefficients(state, 2.0 * np.pi * freq)
    if lift is not None:
        c = c + lift[:, None]
    U = part.solver.solve(c, columns, freq)[:, :, place.ravel()]
    return np.asarray(part.solver.at(U, part.rows).transpose(1, 0, 2))


def stack_real_imag(values: ComplexArray) -> RealArray:
    """Return real parts above imaginary parts, shape (2 m,)."""
    return np.concatenate([values.real.ravel(), values.imag.ravel()])
