"""Expected results of a test with a selected layout, from the exact Jacobian of its data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import ParameterError
from updyn.frf import FRF
from updyn.planning.choice import Choice
from updyn.planning.information import Candidates
from updyn.planning.result import BandWorth
from updyn.planning.settings import PLANNING
from updyn.updating.judge.assessment import linearise_at_start
from updyn.updating.judge.identifiability import Analysis, analyse_identifiability
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["Expected"]


#: Variance of a channel that is rounding: it has no influence.
_BOUNDLESS = np.finfo(np.float64).max ** 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The expected data of a layout, and the parameters they determine.

    `map_lines`, shape (n_f, n, n), is the scaled information of each line at the start of the
    parameters.
    """

    choice: Choice
    layout: Candidates
    part: FRFPart
    map_lines: RealArray

    @classmethod
    def of(cls, choice: Choice) -> Expected:
        """Return the expected data of a layout."""
        layout = choice.planning.candidates.select(choice.rows, choice.columns)
        part = _expected_part(layout)
        return cls(
            choice, layout, part, _compute_line_information(part, choice.planning.information.scale)
        )

    @property
    def variance(self) -> RealArray:
        """E|dH|^2 of the data, shape (n_f, n_responses, n_references)."""
        assert self.part.frf.variance is not None
        return self.part.frf.variance

    def std(self) -> dict[str, float]:
        """Return the standard deviation of each parameter by the Cramer-Rao bound, with the priors.

        Raises `ParameterError` with the names of undetermined parameters.
        """
        coordinates = self.part.coordinates
        noise = choose_noise("variance", self.part.frf)
        local, _ = linearise_at_start(Problem.of([self.part]), [noise])
        names = coordinates.parameters.names
        analysis = analyse_identifiability(
            np.vstack([local.R, np.diag(coordinates.prior[1])]), names
        )
        if not np.isfinite(analysis.report.condition):
            raise self._undetermined_error(analysis)
        std = np.sqrt(np.diag(analysis.covariance)) * coordinates.slope(coordinates.start)
        return dict(zip(names, std.tolist(), strict=True))

    def _undetermined_error(self, analysis: Analysis) -> ParameterError:
        names = self.part.coordinates.parameters.names
        undetermined = [names[i] for i in np.flatnonzero(analysis.involved)]
        shown = ", ".join(undetermined[: PLANNING.named_items])
        n_more = len(undetermined) - PLANNING.named_items
        if n_more > 0:
            shown += f" and {n_more} more"
        frf = self.part.frf
        return ParameterError(
            f"plan: sensors {', '.join(frf.responses.labels)} with forces"
            f" {', '.join(frf.references.labels)} leave undetermined, for any noise: {shown}."
            " Remove one of them, state a prior_std for it, or plan for more sensors, forces or"
            " a wider band",
            key=("parameters",),
        )

    def std_range(self) -> dict[str, tuple[float, float]]:
        """Return the range of the standard deviation of each parameter over the drawn starts."""
        total, coordinates = self.choice.total, self.part.coordinates
        if len(total) == 1:
            return {}
        unit = np.broadcast_to(np.eye(self.part.n), total.shape)
        variances = np.einsum("dpp->dp", np.linalg.solve(total, unit))
        by_value = coordinates.slope(coordinates.start) / self.choice.planning.information.scale
        std = np.sqrt(variances) * by_value
        ends = zip(std.min(axis=0).tolist(), std.max(axis=0).tolist(), strict=True)
        return dict(zip(coordinates.parameters.names, ends, strict=True))

    def parts_of_band(self) -> tuple[BandWorth, ...]:
        """Return the gain of each part of the band over the others, at the start."""
        total = self.map_lines.sum(axis=0) + self.choice.planning.information.before
        n_parts = PLANNING.band_parts
        edges = np.linspace(*self.choice.band, n_parts + 1)
        which = np.searchsorted(edges, self.layout.freq, side="right") - 1
        which = np.clip(which, 0, n_parts - 1)
        out = []
        for i in range(n_parts):
            others = total - self.map_lines[which == i].sum(axis=0)
            gain = self.choice.gain(total[None], others[None])
            out.append(BandWorth(float(edges[i]), float(edges[i + 1]), gain))
        return tuple(out)

    def doubling_gains(self) -> dict[str, float]:
        """Return the gains of doubling the lines and of doubling the averages."""
        information = self.choice.planning.information
        layout_information = self.map_lines.sum(axis=0)
        now = (layout_information + information.before)[None]
        out = {}
        freq = self.layout.freq
        if len(freq) > 1:
            between = self.layout.at_lines(0.5 * (freq[1:] + freq[:-1]))
            also = _compute_line_information(_expected_part(between), information.scale)
            out["lines"] = self.choice.gain(now + also.sum(axis=0), now)
        out["averages"] = self.choice.gain(now + layout_information, now)
        return out


def _compute_line_information(part: FRFPart, scale: RealArray) -> RealArray:
    """Return the scaled information of each line at the start, shape (n_f, n, n)."""
    assert part.frf.variance is not None
    out = []
    for block in part.blocks(part.coordinates.start):
        part.session.check()
        assert block.dH is not None
        weight = np.sqrt(2.0 / part.frf.variance[block.lines])
        J = (block.dH * weight).reshape(part.n, len(block.H), -1)
        J /= scale[:, None, None]
        out.append(np.einsum("pfm,qfm->fpq", J, J.conj(), optimize=True).real)
    return np.concatenate(out)


def _expected_part(layout: Candidates) -> FRFPart:
    """Return the part of an update with the expected data of a layout, without noise."""
    coordinates = layout.part.coordinates
    zeros = np.zeros((len(layout.freq), len(layout.responses), len(layout.references)))
    data = FRF(layout.freq, zeros, layout.responses, layout.references, layout.quantity)
    H = layout.part.with_data(data).responses(coordinates.start)
    variance = layout.variance(H)
    variance = np.where(np.isfinite(variance), variance, _BOUNDLESS)
    return layout.part.with_data(replace(data, values=H, variance=variance))
