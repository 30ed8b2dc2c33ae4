"""Fit of a pole of rank one in addition to the model's FRFs, together with all unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.judge.causes.evidence import Evidence, compute_spread
from updyn.updating.judge.causes.misfit import compute_log_misfit
from updyn.updating.judge.causes.settings import CAUSE_MISFIT, MISSING_MODE
from updyn.updating.problem.local import Local, qr_triangle, reduce_blocks
from updyn.updating.problem.problem import FRFPart

__all__ = ["Pole", "fit_pole"]


@dataclass(frozen=True, slots=True, eq=False)
class Pole:
    """Pole of rank one, (i omega)^k a b^T / (1 + i loss - (omega / omega_0)^2).

    `frequency` is omega_0 / (2 pi) in Hz; `a` (n_i,) is in m/N; the largest of `b` (n_j,) is 1.
    """

    frequency: float
    loss: float
    a: ComplexArray
    b: ComplexArray

    def frequency_factor(self, frf: FRF) -> ComplexArray:
        """Return its factor over the lines of data, shape (n_f,)."""
        share = (frf.s / (2.0 * np.pi * self.frequency)) ** 2
        return np.asarray(frf.s**frf.modal_power / (1.0 + 1j * self.loss + share))

    def contribution(self, frf: FRF) -> ComplexArray:
        """Return its contribution to the FRFs at the lines of data, shape (n_f, n_i, n_j)."""
        return np.asarray(self.frequency_factor(frf)[:, None, None] * np.outer(self.a, self.b))

    def normalise(self) -> Pole:
        """Return the same pole with 1 as the largest b."""
        largest = self.b[int(np.argmax(np.abs(self.b)))]
        return replace(self, a=self.a * largest, b=self.b / largest)


class _PoleProblem:
    """Misfit of model and pole as a function of x, ln omega_0, ln eta, and the parts of a and b.

    The weight of a line is the number of lines that it represents, `count` of shape (n_f,).
    """

    def __init__(self, part: FRFPart, x: RealArray, pole: Pole, count: RealArray) -> None:
        self.part, self.n, self.n_i = part, part.n, len(pole.a)
        self.line_weight = np.sqrt(count)[:, None, None]
        self.start_pole, self.size = pole, float(np.abs(pole.a).max())
        # The weight of the priors follows from the residual at the start.
        e = self._misfit(x, pole)[0]
        unit = float(np.sqrt(np.mean(np.abs(e) ** 2))) + CAUSE_MISFIT.perfect_rms
        self.prior_weight = unit / compute_spread(part)

    def pack_variables(self, x: RealArray, pole: Pole) -> RealArray:
        """Return the variables of a point, with a in units of its largest entry."""
        a = pole.a / self.size
        pole_variables = [0.0, 0.0, *a.real, *a.imag, *pole.b.real, *pole.b.imag]
        return np.concatenate([x, pole_variables])

    def unpack_variables(self, z: RealArray) -> tuple[RealArray, Pole]:
        x, (f, eta), rest = z[: self.n], z[self.n : self.n + 2], z[self.n + 2 :]
        a, b = rest[: 2 * self.n_i], rest[2 * self.n_i :]
        frequency, loss = self.start_pole.frequency * np.exp(f), self.start_pole.loss * np.exp(eta)
        at_responses = self.size * _join_complex(a)
        return x, Pole(float(frequency), float(loss), at_responses, _join_complex(b))

    def bounds(self) -> tuple[RealArray, RealArray]:
        lower, upper = self.part.coordinates.bounds
        free = np.full(2 * (self.n_i + len(self.start_pole.b)), np.inf)
        moves = np.array([MISSING_MODE.frequency_move, MISSING_MODE.loss_move])
        return np.concatenate([lower, -moves, -free]), np.concatenate([upper, moves, free])

    def _misfit(self, x: RealArray, pole: Pole) -> tuple[ComplexArray, RealArray, Evidence]:
        evidence = Evidence(self.part, x)
        frf = self.part.frf
        return *compute_log_misfit(
            evidence.model_response(frf) + pole.contribution(frf), frf
        ), evidence

    def local(self, z: RealArray) -> Local:
        """Return the reduced least-squares problem at a point."""
        x, pole = self.unpack_variables(z)
        e, weight, evidence = self._misfit(x, pole)
        frf = self.part.frf
        T = pole.contribution(frf)
        total = evidence.model_response(frf) + T
        by_total = 1.0 / np.where(total == 0, 1.0, total)
        share: ComplexArray = np.asarray(-self.line_weight * weight * by_total)
        columns = np.zeros((len(z), *share.shape), dtype=np.complex128)
        np.multiply(share, evidence.model_slopes(frf), out=columns[: self.n])
        self._derive_by_pole(pole, frf, T, share, columns[self.n :])
        residual = (self.line_weight * e).ravel().view(np.float64)
        priors = np.zeros((self.n, len(z) + 1))
        priors[:, : self.n] = np.diag(self.prior_weight)
        priors[:, -1] = self.prior_weight * (x - self.part.coordinates.start)
        rows = columns.reshape(len(z), -1).view(np.float64)
        return reduce_blocks([qr_triangle(rows, residual), priors], len(z))

    def _derive_by_pole(
        self, pole: Pole, frf: FRF, T: ComplexArray, share: ComplexArray, out: ComplexArray
    ) -> None:
        """Write derivatives of the misfit by the pole's variables, (n, n_f, n_i, n_j); `out` is 0.

        `share` is the derivative of the misfit by the FRFs.
        """
        square = (frf.s / (2.0 * np.pi * pole.frequency)) ** 2
        below = (1.0 + 1j * pole.loss + square)[:, None, None]
        out[0] = share * T * (2.0 * square[:, None, None] / below)
        out[1] = share * T * (-1j * pole.loss / below)
        by_a, imag_a, by_b, imag_b = np.split(out[2:], np.cumsum([self.n_i, self.n_i, len(pole.b)]))
        each = share * pole.frequency_factor(frf)[:, None, None]
        # An entry of a or b changes the channels of one response or of one reference only.
        i, j = np.arange(len(pole.a)), np.arange(len(pole.b))
        by_a[i, :, i] = self.size * (each * pole.b).swapaxes(0, 1)
        by_b[j, :, :, j] = np.moveaxis(each * pole.a[:, None], 2, 0)
        np.multiply(by_a, 1j, out=imag_a)
        np.multiply(by_b, 1j, out=imag_b)


def _join_complex(parts: RealArray) -> ComplexArray:
    """Return complex numbers from their real parts, then their imaginary parts."""
    real, imaginary = np.split(parts, 2)
    return np.asarray(real + 1j * imaginary, dtype=np.complex128)


def fit_pole(part: FRFPart, x: RealArray, pole: Pole) -> Pole:
    """Return the pole that explains the data best with the model, all unknowns free."""
    # The fit starts at `x` and `pole`; some lines represent the others until the last steps.
    freq = part.frf.freq
    count = _count_represented_lines(freq, pole)
    few = count > 0.0
    if few.all():
        return _fit_from(part, x, pole, MISSING_MODE.most_steps, count)[1].normalise()
    fewer = part.with_data(part.frf.select(lines=freq[few]))
    x, pole = _fit_from(fewer, x, pole, MISSING_MODE.most_steps, count[few])
    last = MISSING_MODE.last_steps
    return _fit_from(part, x, pole, last, np.ones(len(freq)))[1].normalise()


def _count_represented_lines(freq: RealArray, pole: Pole) -> RealArray:
    """Return the number of lines that each line represents, 0 for omitted lines, shape (n_f,)."""
    is_near = np.abs(freq / pole.frequency - 1.0) <= MISSING_MODE.near_bandwidths * pole.loss
    count = np.zeros(len(freq))
    for group in (is_near, ~is_near):
        lines = np.flatnonzero(group)
        chosen = lines[:: max(-(-len(lines) // MISSING_MODE.fitted_lines), 1)]
        count[chosen] = len(lines) / max(len(chosen), 1)
    return count


def _fit_from(
    part: FRFPart, x: RealArray, pole: Pole, most: int, count: RealArray
) -> tuple[RealArray, Pole]:
    """Return the end of a fit of model and pole after at most `most` steps."""
    problem = _PoleProblem(part, x, pole, count)
    lower, upper = problem.bounds()
    start = np.clip(problem.pack_variables(x, pole), lower, upper)
    region = TrustRegion(most, min_relative_decrease=MISSING_MODE.least_decrease)
    return problem.unpack_variables(region.minimise(problem.local, start, lower, upper).x)
