"""Matplotlib figures of updyn objects: each function takes an object and returns a figure.

No physics is computed. Figures are made without pyplot, and matplotlib is imported with the first
one; ``pip install "updyn[plots]"`` installs it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from numpy.typing import ArrayLike

from updyn.plots.functions import frf, overlay
from updyn.plots.maps import frac, mac
from updyn.plots.modes import stabilisation, synthesis
from updyn.plots.unknowns import identifiability, parameters
from updyn.registry import load_object

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "frac",
    "frf",
    "identifiability",
    "mac",
    "overlay",
    "parameters",
    "plant",
    "stabilisation",
    "synthesis",
]

#: Location of the function that draws plants and loops.
_BODE = "updyn.control.bode:bode"


def plant(
    found: Any,
    freq: ArrayLike | None = None,
    *,
    level: str | None = None,
    ax: Any | None = None,
) -> Figure:
    """Draw the Bode diagram of a plant with its largest error, or of a loop with its margins.

    A single channel is drawn with magnitude and phase, several channels with their magnitude in one
    panel each. For a family, the range of its magnitudes is shaded.

    Parameters
    ----------
    found : Plant, PlantFamily, Servo or Loop
        Result of `updyn.plant`, `updyn.plant_family` or `updyn.servo`; for the latter, the
        outermost loop is drawn.
    freq : array_like of float, shape (n_f,), optional
        Lines in Hz; by default dense lines over the band of the plant. Must be None for a
        loop, which has its own lines.
    level : {"log", "dB", "linear"}, optional
        Scale of the magnitude; by default dB for a loop, else logarithmic.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes for magnitude and phase, or one for each channel. None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or an argument cannot be used.
    DataError
        If lines cannot be used, or there are more than 16 channels.
    """
    return cast("Figure", load_object(_BODE)(found, freq, level=level, ax=ax))
