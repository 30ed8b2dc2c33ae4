"""`Plan`: a layout of sensors and forces, and what is expected of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.model import Model
from updyn.text_table import counted, text_table
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["BandWorth", "Plan", "Rival", "Worth"]

#: Further sensors that a summary names.
_NAMED = 3


@dataclass(frozen=True, slots=True)
class Worth:
    """What a sensor or a force beyond the plan would add.

    Attributes
    ----------
    label : str
        The DOF.
    gain : float
        By what share all standard deviations fall, in the geometric mean (or, A-optimal, in the
        root mean square).
    """

    label: str
    gain: float


@dataclass(frozen=True, slots=True)
class BandWorth:
    """A part of the band, or a band that might have been chosen.

    Attributes
    ----------
    low, high : float
        In Hz.
    gain : float
        Of a part: by what share its lines lower all standard deviations. Of a band: how much larger
        they are with it than with the chosen one, as a share; 0 for that.
    """

    low: float
    high: float
    gain: float


@dataclass(frozen=True, slots=True)
class Rival:
    """The layout of another criterion, from the same candidates in the same band.

    Attributes
    ----------
    criterion : str
        Its name.
    responses, references : tuple of str
        What it chooses; empty where it cannot.
    ratio : float
        Geometric mean of the semi-axes of its confidence ellipsoid over that of the plan: above 1
        where it is worse. nan where it cannot choose.
    note : str
        Why it cannot; else empty.
    """

    criterion: str
    responses: tuple[str, ...]
    references: tuple[str, ...]
    ratio: float
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A layout of sensors and forces, and what is expected of it.

    Attributes
    ----------
    criterion : str
        What it was chosen by.
    responses, references : tuple of str
        Sensors and forces, those with the largest gain first.
    band : (float, float)
        In Hz.
    freq : ndarray of float, shape (n_f,)
        The lines for which it was chosen, in Hz.
    quantity : str
        What is measured.
    noise : dict of str to float
        ``relative`` and ``floor`` of the expected noise.
    variance : ndarray of float, shape (n_f, n_responses, n_references)
        E|dH|^2 that follows, in squared units of the quantity, in the order of `responses` and
        `references`.
    std : dict of str to float
        Expected standard deviation of each unknown by the Cramer-Rao bound, as of
        `UpdateResult.std`, where the truth is where the unknowns start.
    std_range : dict of str to (float, float)
        Smallest and largest of it over the drawn starts; empty where none were drawn.
    radius : float
        Geometric mean of the semi-axes of the confidence ellipsoid (at one standard deviation) of
        the unknowns that count: of logarithms of factors, and of loss factors. Over draws, too.
    gain, reference_gain : tuple of float
        By what share all standard deviations fall with each sensor (force) after those before it
        and with all forces (sensors): in the geometric mean, or, A-optimal, in the root mean
        square. The first begins from knowing nothing but the priors.
    further, further_references : tuple of Worth
        The next sensors and forces, each after those before it, as far as there are candidates.
    parts : tuple of BandWorth
        What each tenth of the band adds to the rest.
    doubled : dict of str to float
        Gain of twice the ``lines`` (the distance between them halved) and of twice the
        ``averages`` (half the variance of the noise).
    wanted : tuple of str
        The unknowns that count.
    parameters : ParameterSet
        All unknowns.
    model : Model
        The structure.
    bands : tuple of BandWorth
        The bands to choose from, where there were several.
    rivals : tuple of Rival
        Layouts of the other criteria, where they were asked for.
    draws : int
        Starts that were drawn besides.
    off : float
        How far they are off, as a standard deviation of the logarithm.
    seed : int
        Of the draws.
    screened : str
        Of very many candidates, among how many the layout was chosen; else empty.

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
    freq: NDArray[np.float64]
    quantity: str
    noise: Mapping[str, float]
    variance: NDArray[np.float64]
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
    rivals: tuple[Rival, ...] = ()
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
        """Return layout, expected standard deviations and marginal worths as text."""
        blocks = [self._head(), self._layout(), self._expected(), self._worth()]
        if self.rivals:
            blocks.append(self._compared())
        return "\n\n".join(blocks)

    def _head(self) -> str:
        noise = f"{100 * self.noise['relative']:g} % of |H|, floor {self.noise['floor']:g} rms"
        low, high = self.band
        lines = [
            f"{self.criterion}: {counted(len(self.responses), 'sensor')},"
            f" {counted(len(self.references), 'force')}; {self.quantity},"
            f" {counted(len(self.freq), 'line')} from {low:g} to {high:g} Hz",
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
                text = f"standard deviations {_percent(band.gain)} larger"
            lines.append(f"Band {band.low:g} to {band.high:g} Hz: {text}")
        return "\n".join(lines)

    def _layout(self) -> str:
        rows = []
        for kind, labels, gains in (
            ("sensor", self.responses, self.gain),
            ("force", self.references, self.reference_gain),
        ):
            for number, (label, gain) in enumerate(zip(labels, gains, strict=True)):
                rows.append([kind, label, _percent(gain) if number else "first"])
        rows += [["next sensor", w.label, _percent(w.gain)] for w in self.further[:_NAMED]]
        rows += [["next force", w.label, _percent(w.gain)] for w in self.further_references[:1]]
        return text_table(["", "DOF", "gain"], rows, left=(0, 1))

    def _expected(self) -> str:
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

    def _worth(self) -> str:
        lines = [
            f"Twice the {name}: standard deviations {_percent(gain)} smaller"
            for name, gain in self.doubled.items()
        ]
        rows = [[f"{p.low:.4g} to {p.high:.4g} Hz", _percent(p.gain)] for p in self.parts]
        return "\n".join([*lines, "", text_table(["part of the band", "gain"], rows)])

    def _compared(self) -> str:
        rows = [[self.criterion, "1", ", ".join(self.responses), ", ".join(self.references)]]
        for rival in self.rivals:
            ratio = rival.note or f"{rival.ratio:.3g}"
            layout = ", ".join(rival.responses), ", ".join(rival.references)
            rows.append([rival.criterion, ratio, *layout])
        header = ["criterion", "standard deviations", "sensors", "forces"]
        return text_table(header, rows, left=(0, 2, 3))


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"
