"""Figures of matplotlib from the objects of updyn: each function takes an object, returns a figure.

They draw what an object holds and compute no physics. ``ax=`` takes axes of the caller; without it
a new figure is made, without pyplot, in the colours and sizes of `updyn.style`. matplotlib is
loaded with the first figure; ``pip install "updyn[plots]"`` installs it.
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

#: What draws plants and loops.
_BODE = "updyn.control.bode:bode"


def plant(
    found: Any,
    freq: ArrayLike | None = None,
    *,
    level: str | None = None,
    ax: Any | None = None,
) -> Figure:
    """Draw the Bode diagram of a plant with its largest error, or of a loop with its margins.

    Of one channel magnitude and phase are drawn, of several the magnitude of each in a panel. Of a
    family the range of its magnitudes is shaded.

    Parameters
    ----------
    found : Plant, PlantFamily, Servo or Loop
        From `updyn.plant`, `updyn.plant_family` or `updyn.servo`; of the latter the outermost loop
        is drawn.
    freq : array_like of float, shape (n_f,), optional
        Lines in Hz; by default dense ones over the band of the plant. A loop has its own.
    level : {"log", "dB", "linear"}, optional
        Scale of the magnitude; by default logarithmic, of a loop dB.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Where to draw: for magnitude and phase, or one for each channel. None: a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not there, or an argument cannot be used.
    DataError
        If lines cannot be used, or there are more than 16 channels.
    """
    return cast("Figure", load_object(_BODE)(found, freq, level=level, ax=ax))
