"""A measured mode that the model lacks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof
from updyn.errors import DataError, OptionError, in_all
from updyn.frf import FRF
from updyn.remedy import Remedy
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import FORCE, Fault, list_sides
from updyn.updating.judge.causes.misfit import compute_log_misfit
from updyn.updating.judge.causes.pole_fit import Pole, fit_pole
from updyn.updating.judge.causes.settings import MISSING_MODE
from updyn.updating.problem.problem import FRFPart

__all__ = ["MissingMode"]


@dataclass(frozen=True, slots=True)
class MissingMode(Fault):
    """A mode at `value` Hz is in the data and not in the model: one more pole of rank one.

    It adds (i omega)^k a b^T / (omega_0^2 (1 + i loss) - omega^2) to the FRFs (Ewins, Modal
    Testing, 2nd ed. 2000, section 2.7). `shape` gives a of the responses in m/N and b of the
    references by label; empty: unknown. `bandwidth` is in lines; `channel_share` is (sum a)^2 / (n
    sum a^2) with a the root of the explained misfit of each sensor or force.
    """

    loss: float = MISSING_MODE.first_loss
    bandwidth: float = 1.0
    channel_share: float = 1.0
    shape: tuple[tuple[str, complex], ...] = ()

    kind: ClassVar[str] = "missing-mode"
    concerns_model: ClassVar[bool] = True
    unit: ClassVar[str] = "Hz"
    odds: ClassVar[float] = 5e-3
    is_adaptive: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the lines near which the misfit has a peak."""
        frf = evidence.frf
        if len(frf.freq) <= MISSING_MODE.least_lines:
            return
        e = compute_log_misfit(evidence.model_response(frf), frf)[0]
        power = np.sqrt(np.mean(np.abs(e) ** 2, axis=(1, 2)))
        padded = np.pad(power, 1, constant_values=-1.0)
        peaks = (power >= padded[:-2]) & (power > padded[2:])
        usual = float(np.median(power))
        large = power > max(MISSING_MODE.peak_ratio * usual, MISSING_MODE.least_peak)
        out = np.flatnonzero(peaks & large & (frf.freq > 0.0))
        for line in out[np.argsort(-power[out])][: MISSING_MODE.most_peaks]:
            yield cls((), float(frf.freq[line])).adapt_to(evidence)

    def count_parameters(self, frf: FRF) -> int:
        """Return 2 for the pole and 2 for each entry of a and b, less 2 for their common scale."""
        return 2 * (len(frf.responses) + len(frf.references))

    def adapt_to(self, evidence: Evidence) -> Self:
        """Return the fault with the pole that explains most, near its own."""
        at = _LocalResidual.near(evidence, self.value)
        best, least = self, at.squared_error(self)
        spacing = float(np.median(np.diff(at.freq)))
        step, factor = spacing, MISSING_MODE.loss_factor_step
        for _ in range(MISSING_MODE.refinements):
            near = [
                replace(best, value=f, loss=max(loss, MISSING_MODE.least_loss))
                for f in (best.value - step, best.value, best.value + step)
                for loss in (best.loss / factor, best.loss, best.loss * factor)
                if f > 0.0
            ]
            for one in near:
                error = at.squared_error(one)
                if error < least:
                    best, least = one, error
            step, factor = 0.5 * step, np.sqrt(factor)
        bandwidth = best.loss * best.value / spacing
        return replace(best, bandwidth=bandwidth, channel_share=at.channel_share(best))

    def repair_with_model(self, evidence: Evidence) -> FRF:
        """Return the data minus the mode; its shape, if unknown, is fitted to the residual."""
        frf = evidence.frf
        if self.shape:
            return replace(frf, values=frf.values - self._shape_pole(frf).contribution(frf))
        residues = _LocalResidual.near(evidence, self.value).residues(self)
        u, s, vh = np.linalg.svd(residues)
        shape = s[0] * np.outer(u[:, 0], vh[0])
        return replace(frf, values=frf.values - self.pole_factor(frf)[:, None, None] * shape)

    def pole_factor(self, frf: FRF) -> ComplexArray:
        """Return s^k / (1 + i eta + s^2), s = i omega / omega_0, shape (n_f,)."""
        s = frf.s / (2.0 * np.pi * self.value)
        return np.asarray(s**frf.modal_power / (1.0 + 1j * self.loss + s**2))

    def fit_all_data(self, part: FRFPart, x: RealArray) -> Self:
        """Return the mode with its shape, fitted to all data together with the unknowns."""
        frf = part.frf
        evidence = Evidence(part, x)
        residues = _LocalResidual.near(evidence, self.value).residues(self)
        u, s, vh = np.linalg.svd(residues)
        size = s[0] / (2.0 * np.pi * self.value) ** frf.modal_power
        pole = fit_pole(part, x, Pole(self.value, self.loss, size * u[:, 0], vh[0]))
        labels = [name for _, names in list_sides(frf) for name in names]
        signed = np.concatenate([pole.a * frf.responses.signs, pole.b * frf.references.signs])
        shape = tuple(zip(labels, signed.tolist(), strict=True))
        return replace(self, value=pole.frequency, loss=pole.loss, shape=shape)

    def _shape_pole(self, frf: FRF) -> Pole:
        known = dict(self.shape)
        parts: list[ComplexArray] = []
        for dofs, labels in list_sides(frf):
            missing = [label for label in labels if label not in known]
            if missing:
                raise DataError(
                    f"repair {self.kind!r}: the shape of the mode at {self.value:.6g} Hz is not"
                    f" known at {missing[0]!r}{in_all(len(missing))}"
                )
            factors = np.array([known[label] for label in labels], dtype=np.complex128)
            parts.append(np.asarray(factors * dofs.signs))
        a, b = parts
        return Pole(self.value, self.loss, a, b)

    def repair(self, frf: FRF) -> FRF:
        """Return the data minus the mode; without the lines near it if its shape is unknown."""
        # Lines at which the mode dominates the data contain its noise and are omitted.
        remaining = frf
        if self.shape:
            term = self._shape_pole(frf).contribution(frf)
            remaining = replace(frf, values=frf.values - term)
            sizes = [
                np.sqrt(np.mean(np.abs(one) ** 2, axis=(1, 2))) for one in (term, remaining.values)
            ]
            is_kept = sizes[0] <= MISSING_MODE.dominant_ratio * sizes[1]
        else:
            is_kept = np.abs(frf.freq / self.value - 1.0) > MISSING_MODE.omitted_share
        if not is_kept.any():
            raise DataError(f"repair {self.kind!r}: all lines are about {self.value:.6g} Hz")
        return remaining.select(lines=frf.freq[is_kept])

    @classmethod
    def parse(cls, channels: str, value: str) -> MissingMode:
        """Return the fault from its text."""
        frequency, *more = value.split(",")
        found = super(MissingMode, cls).parse(channels, frequency)
        if not found.value > 0.0 or found.channels:
            raise OptionError(f"repair {cls.kind!r}: expected its frequency in Hz")
        if not more:
            return found
        loss, *shape = more
        try:
            return replace(found, loss=float(loss), shape=tuple(map(_parse_entry, shape)))
        except ValueError as error:
            raise OptionError(
                f"repair {cls.kind!r}: expected its frequency, its loss factor and what it adds by"
                f" label, as in '9.3, 0.02, 2:Z 0.5-0.1j, force 2:Z 1+0j'; {error}"
            ) from None

    @property
    def repair_text(self) -> str:
        """Text of the fault: ``missing-mode=9.3``, with loss factor and shape if known."""
        text = f"{self.kind}={self.value:.9g}"
        if not self.shape:
            return text
        entries = [f"{label} {a.real:.6g}{a.imag:+.6g}j" for label, a in self.shape]
        return ", ".join([text, f"{self.loss:.6g}", *entries])

    def is_plausible(self) -> bool:
        """Return whether the damping is that of a mode, and enough channels measure it."""
        return (
            self.loss < MISSING_MODE.most_loss
            and self.bandwidth > MISSING_MODE.narrow_lines
            and self.channel_share > MISSING_MODE.least_sensors
        )

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        action, text = "subtract it", self.repair_text
        if not self.shape or len(self.shape) > MISSING_MODE.named_entries:
            action = f"omit {100.0 * MISSING_MODE.omitted_share:.0f} % on either side of it"
            text = replace(self, shape=()).repair_text
        advice = (
            f"Check the measured shape of the mode at {self.value:.4g} Hz: the model may lack"
            " this motion (torsion, another plane, an attached part). Until the model has it,"
            f" {action}:"
        )
        return Remedy.repair(advice, text)

    def statement(self) -> str:
        """Return a sentence with the frequency and the loss factor."""
        return (
            f"A measured mode at {self.value:.4g} Hz (loss factor {self.loss:.2g}) is not in the"
            " model."
        )


def _parse_entry(text: str) -> tuple[str, complex]:
    """Return the label and the number of ``force 2:Z 0.5-0.1j``."""
    label, _, number = text.strip().rpartition(" ")
    plain = str(abs(Dof.parse(label.removeprefix(FORCE))))
    return (FORCE if label.startswith(FORCE) else "") + plain, complex(number)


@dataclass(frozen=True, slots=True, eq=False)
class _LocalResidual:
    """Data minus model near a frequency; `weight` is 1 over the level of both, 0 for noise."""

    freq: RealArray
    values: ComplexArray
    weight: RealArray
    frf: FRF

    @classmethod
    def near(cls, evidence: Evidence, frequency: float) -> _LocalResidual:
        frf = evidence.frf
        away = np.abs(frf.freq / frequency - 1.0)
        least = float(np.sort(away)[MISSING_MODE.least_lines - 1])
        at = np.flatnonzero(away <= max(MISSING_MODE.near_share, least))
        H = evidence.model_response(frf)[at]
        near_lines = frf.select(lines=frf.freq[at])
        level = np.sqrt(np.abs(H) ** 2 + np.abs(near_lines.values) ** 2)
        clear = compute_log_misfit(H, near_lines)[1] / np.maximum(level, np.finfo(float).tiny)
        return cls(near_lines.freq, near_lines.values - H, clear, near_lines)

    def _basis(self, mode: MissingMode) -> ComplexArray:
        """Return the mode and a constant receptance by channel, weighted, (n_i, n_j, n, 2)."""
        flat = (self.frf.s / (2.0 * np.pi * mode.value)) ** self.frf.modal_power
        both = np.stack([mode.pole_factor(self.frf), flat], axis=-1)
        return np.asarray(self.weight.transpose(1, 2, 0)[..., None] * both)

    def _fit_mode(self, mode: MissingMode) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        A = self._basis(mode)
        b = (self.weight * self.values).transpose(1, 2, 0)
        Q, R = np.linalg.qr(A)
        return R, np.einsum("ijnk,ijn->ijk", Q.conj(), b), b

    def squared_error(self, mode: MissingMode) -> float:
        """Return the sum of squares of the residual after a fit of the mode."""
        _, q, b = self._fit_mode(mode)
        return float(np.sum(np.abs(b) ** 2) - np.sum(np.abs(q) ** 2))

    def channel_share(self, mode: MissingMode) -> float:
        """Return the share of the sensors, or of the forces if less, that measure the mode."""
        R = self._fit_mode(mode)[0]
        beyond = np.abs(self.residues(mode) * np.abs(R[..., 0, 0])) ** 2
        shares = []
        for axis in (0, 1):
            a = np.sqrt(beyond.sum(axis=1 - axis))
            shares.append(float(a.sum() ** 2 / (len(a) * max(float(a @ a), 1e-300))))
        return min(shares)

    def residues(self, mode: MissingMode) -> ComplexArray:
        """Return the residue of each channel, shape (n_i, n_j)."""
        R, q, _ = self._fit_mode(mode)
        last = q[..., 1] / np.where(R[..., 1, 1] == 0, 1.0, R[..., 1, 1])
        first = np.where(R[..., 0, 0] == 0, 1.0, R[..., 0, 0])
        return np.asarray((q[..., 0] - R[..., 0, 1] * last) / first)
