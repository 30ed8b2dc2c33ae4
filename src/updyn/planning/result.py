"""`Plan`: a layout of sensors and forces, and its expected results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from updyn.arrays import RealArray
from updyn.model import Model
from updyn.planning.settings import PLANNING
from updyn.text_table import format_count, text_table
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["BandWorth", "Plan", "RivalLayout", "Worth"]


@dataclass(frozen=True, slots=True)
class Worth:
    """Gain of a sensor or a force in addition to the plan.

    The gain is the relative decrease of all standard deviations, in the geometric mean (for
    A-optimal plans in the root mean square).
    """

    label: str
    gain: float


@dataclass(frozen=True, slots=True)
class BandWorth:
    """A part of the band, or an alternative band, in Hz.

    The gain of a part is the relative decrease of all standard deviations by its lines; that of a
    band their relative increase compared with the selected one.
    """

    low: float
    high: float
    gain: float


@dataclass(frozen=True, slots=True)
class RivalLayout:
    """The layout of another criterion, from the same candidates in the same band.

    `ratio` is the geometric mean of the semi-axes of its confidence ellipsoid over that of the
    plan: above 1 if it is worse, nan without a selection, with the reason in `note`.
    """

    criterion: str
    responses: tuple[str, ...]
    references: tuple[str, ...]
    ratio: float
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A layout of sensors and forces, and its expected results.

    Attributes
    ----------
    criterion : str
        Criterion of the selection.
    responses, references : tuple of str
        Sensors and forces, those with the largest gain first.
    band : (float, float)
        In Hz.
    freq : ndarray of float, shape (n_f,)
        The lines of the selection, in Hz.
    quantity : str
        Measured quantity.
    noise : dict of str to float
        ``relative`` and ``floor`` of the expected noise.
    variance : ndarray of float, shape (n_f, n_responses, n_references)
        E|dH|^2 of the expected noise, in squared units of the quantity, in the order of `responses`
        and `references`.
    std : dict of str to float
        Expected standard deviation of each parameter by the Cramer-Rao bound, as in
        `UpdateResult.std`, if the truth is at the start.
    std_range : dict of str to (float, float)
        Range of `std` over the drawn starts; empty without draws.
    radius : float
        Geometric mean of the semi-axes of the confidence ellipsoid (at one standard deviation) of
        the parameters of interest: of logarithms of factors, and of loss factors. Also averaged
        over draws.
    gain, reference_gain : tuple of float
        Relative decrease of all standard deviations with each sensor (force) after those before it
        and with all forces (sensors): in the geometric mean, or, for A-optimal plans, in the root
        mean square. The first starts from the priors alone.
    further, further_references : tuple of Worth
        The next sensors and forces, each after those before it, if there are candidates.
    parts : tuple of BandWorth
        Gain of each tenth of the band over the rest.
    doubled : dict of str to float
        Gain of twice the ``lines`` (half the distance between them) and of twice the ``averages``
        (half the variance of the noise).
    wanted : tuple of str
        The parameters of interest.
    parameters : ParameterSet
        All parameters.
    model : Model
        The structure.
    bands : tuple of BandWorth
        The bands to select from, if several.
    rivals : tuple of Rival
        Layouts of the other criteria, if requested.
    draws : int
        Number of additional starts.
    off : float
        Their standard deviation in the logarithm.
    seed : int
        Seed of the draws.
    screened : str
        The number of candidates after screening, if screened; else empty.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> unknowns = updyn.parameters(model, stiffness="all")
    >>> layout = updyn.plan(model, unknowns, "all", 2, 1, (0.5, 12.0), robust=0)
    >>> len(layout.std), layout.criterion
    (4, 'd-optimal')
    """

    criterion: str
    responses: tuple[str, ...]
    references: tuple[str, ...]
    band: tuple[float, float]
    freq: RealArray
    quantity: str
    noise: Mapping[str, float]
    variance: RealArray
    std: Mapping[str, float]
    std_range: Mapping[str, tuple[float, float]]
    radius: float
    gain: tuple[float, ...]
    reference_gain: tuple[float, ...]
    further: tuple[Worth, ...]
    further_references: tuple[Worth, ...]
    parts: tuple[BandWorth, ...]
    doubled: Mapping[str, float]
    wanted: tuple[str, ...]
    parameters: ParameterSet
    model: Model
    bands: tuple[BandWorth, ...] = ()
    rivals: tuple[RivalLayout, ...] = ()
    draws: int = 0
    off: float = 0.0
    seed: int = 0
    screened: str = ""

    def __repr__(self) -> str:
        return (
            f"Plan({self.criterion}: sensors {', '.join(self.responses)};"
            f" forces {', '.join(self.references)})"
        )

    def summary(self) -> str:
        """Return layout, expected standard deviations and gains as text."""
        blocks = [
            self._format_head(),
            self._format_layout(),
            self._format_expected(),
            self._format_worth(),
        ]
        if self.rivals:
            blocks.append(self._format_rivals())
        return "\n\n".join(blocks)

    def _format_head(self) -> str:
        noise = f"{100 * self.noise['relative']:g} % of |H|, floor {self.noise['floor']:g} rms"
        low, high = self.band
        lines = [
            f"{self.criterion}: {format_count(len(self.responses), 'sensor')},"
            f" {format_count(len(self.references), 'force')}; {self.quantity},"
            f" {format_count(len(self.freq), 'line')} from {low:g} to {high:g} Hz",
            f"Expected noise: {noise}",
        ]
        if self.draws:
            lines.append(
                f"Chosen for the mean over the start and {self.draws} draws, {100 * self.off:g} %"
                f" off (seed {self.seed})"
            )
        if self.screened:
            lines.append(f"Layout {self.screened}")
        for band in self.bands:
            text = "chosen"
            if band.gain:
                text = f"standard deviations {_format_percent(band.gain)} larger"
            lines.append(f"Band {band.low:g} to {band.high:g} Hz: {text}")
        return "\n".join(lines)

    def _format_layout(self) -> str:
        rows = []
        for kind, labels, gains in (
            ("sensor", self.responses, self.gain),
            ("force", self.references, self.reference_gain),
        ):
            for number, (label, gain) in enumerate(zip(labels, gains, strict=True)):
                rows.append([kind, label, _format_percent(gain) if number else "first"])
        further = self.further[: PLANNING.named_items]
        rows += [["next sensor", w.label, _format_percent(w.gain)] for w in further]
        rows += [
            ["next force", w.label, _format_percent(w.gain)] for w in self.further_references[:1]
        ]
        return text_table(["", "DOF", "gain"], rows, left=(0, 1))

    def _format_expected(self) -> str:
        header = ["unknown", "start", "std"]
        if self.std_range:
            header += ["least", "largest"]
        rows = []
        for p in self.parameters:
            row = [p.name, f"{p.start:.4g}", f"{self.std[p.name]:.3g}"]
            if self.std_range:
                row += [f"{value:.3g}" for value in self.std_range[p.name]]
            rows.append(row)
        return text_table(header, rows)

    def _format_worth(self) -> str:
        lines = [
            f"Twice the {name}: standard deviations {_format_percent(gain)} smaller"
            for name, gain in self.doubled.items()
        ]
        rows = [[f"{p.low:.4g} to {p.high:.4g} Hz", _format_percent(p.gain)] for p in self.parts]
        return "\n".join([*lines, "", text_table(["part of the band", "gain"], rows)])

    def _format_rivals(self) -> str:
        rows = [[self.criterion, "1", ", ".join(self.responses), ", ".join(self.references)]]
        for rival in self.rivals:
            ratio = rival.note or f"{rival.ratio:.3g}"
            layout = ", ".join(rival.responses), ", ".join(rival.references)
            rows.append([rival.criterion, ratio, *layout])
        header = ["criterion", "standard deviations", "sensors", "forces"]
        return text_table(header, rows, left=(0, 2, 3))


def _format_percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"
