"""Figures for mode identification: stabilisation diagram, and FRFs synthesised from modes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.correlation import frac
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.modal import ModeSet, cmif, synthesise
from updyn.modal.synthesis import band_of_modes
from updyn.plots.canvas import WhichAxes, canvas, legend_above, level_axis, level_values
from updyn.plots.functions import one_channel
from updyn.style import PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["stabilisation", "synthesis"]

#: Colour of modes and synthesised FRFs, as in the page of ``updyn modes``.
_MODES = PAPER["after"]


def stabilisation(
    modes: ModeSet, frf: FRF | None = None, *, level: str = "log", ax: WhichAxes | None = None
) -> Figure:
    """Draw the poles of every order over frequency, with the modes and the peaks without a mode.

    Parameters
    ----------
    modes : ModeSet
        Result of `updyn.identify_modes`.
    frf : FRF, optional
        The measurement. Its complex mode indicator function (CMIF), the singular values of the
        accelerances at each line, is drawn behind the poles with an axis on the right.
    level : {"log", "dB", "linear"}
        Scale of the CMIF.
    ax : matplotlib.axes.Axes, optional
        Axes; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or the modes have no diagram.
    """
    if not isinstance(modes, ModeSet):
        raise OptionError(f"plots.stabilisation: expected a ModeSet, found {type(modes).__name__}")
    diagram = modes.diagram
    if diagram is None:
        raise OptionError(
            "plots.stabilisation: these modes have no diagram; updyn.identify_modes(frf) makes one,"
            " except of few lines without noise, which it fits all at once"
        )
    with canvas(ax, {"diagram": 1.0}, (1100, 520)) as made:
        axes = made.first
        if frf is not None:
            _behind(axes, frf, level)
        looks: tuple[Any, ...] = (
            (~diagram.stable, "pole new in this order", PAPER["muted"], 2.5),
            (diagram.stable, "pole stable", PAPER["third"], 4.5),
        )
        for chosen, name, colour, size in looks:
            _points(axes, diagram.frequency[chosen], diagram.order[chosen], name, colour, "o", size)
        top = float(diagram.order.max(initial=1)) + 2.0
        _points(axes, modes.frequency, np.full(len(modes), top), "mode", _MODES, "v", 7.0)
        peaks = modes.unexplained
        if len(peaks):
            at = np.full(len(peaks), top)
            _points(axes, peaks, at, "peak without a mode", PAPER["bad"], "X", 6.5)
        for frequency in modes.frequency.tolist():
            axes.axvline(frequency, color=_MODES, linewidth=0.6, alpha=0.6, zorder=1)
        axes.set_ylim(0.0, top + 1.5)
        axes.set_ylabel("order (–)")
        axes.set_xlabel("frequency (Hz)")
        if frf is not None:
            axes.set_xlim(float(frf.freq[0]), float(frf.freq[-1]))
        legend_above(axes)
    return made.figure


def _points(axes: Axes, x: Any, y: Any, name: str, colour: str, marker: str, size: float) -> None:
    look: dict[str, Any] = {"linestyle": "none", "marker": marker, "markersize": size}
    axes.plot(x, y, color=colour, label=name, **look)


def _behind(axes: Axes, frf: FRF, level: str) -> None:
    """Draw the mode indicator function behind the poles."""
    found = cmif(frf)
    behind = axes.twinx()
    for k in range(found.values.shape[1]):
        width = 1.2 if k == 0 else 0.6
        size = level_values(found.values[:, k], level)
        behind.plot(found.freq, size, color=PAPER["measured"], linewidth=width)
    level_axis(behind, "CMIF", found.unit, level)
    axes.grid(visible=False)  # it would be drawn over the curves
    behind.grid(visible=False, axis="y")
    behind.spines["right"].set_visible(True)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.plot([], [], color=PAPER["measured"], linewidth=1.2, label="CMIF")


def synthesis(
    modes: ModeSet,
    frf: FRF,
    *,
    level: str = "log",
    log_frequency: bool = False,
    ax: WhichAxes | None = None,
) -> Figure:
    """Draw the FRF synthesised from modes over the measured one, with its FRAC.

    Residues of the modes, and residual terms for modes outside the band, are fitted to the FRFs by
    least squares (LSFD).

    Parameters
    ----------
    modes : ModeSet
        Result of `updyn.identify_modes`.
    frf : FRF
        The measurement. Of several channels, the one with the lowest FRAC is drawn. The FRAC is
        computed from five half-power bandwidths below the lowest mode to five above the highest
        one. ``frf["4:Z", "1:Z"]`` chooses another channel.
    level : {"log", "dB", "linear"}
        Scale of the magnitude.
    log_frequency : bool
        Whether the frequency axis is logarithmic.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes for magnitude and phase; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or an option cannot be used.
    DataError
        If the loss factor of a mode is unknown, or there are too few lines.
    """
    if not isinstance(modes, ModeSet):
        raise OptionError(f"plots.synthesis: expected a ModeSet, found {type(modes).__name__}")
    computed, inside = synthesise(modes, frf), band_of_modes(modes, frf)
    found = frac(frf.values[inside], computed.values[inside])
    i, j = divmod(int(np.argmin(found)), found.shape[1])
    names = [str(frf.responses[i])], [str(frf.references[j])]
    low, high = frf.freq[inside][[0, -1]]
    return one_channel(
        frf[names],
        {"synthesised": computed[names]},
        level,
        log_frequency,
        ax,
        looks={"synthesised": {"color": _MODES, "linestyle": "-"}},
        agreement=f" (FRAC {found[i, j]:.3f} from {low:.4g} to {high:.4g} Hz)",
    )
