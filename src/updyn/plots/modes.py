"""The stabilisation diagram of identified modes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.errors import OptionError
from updyn.frf import FRF, unit
from updyn.modal import ModeSet
from updyn.plots.canvas import (
    WhichAxes,
    canvas,
    legend_above,
    level_axis,
    level_values,
)
from updyn.style import PAPER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["stabilisation"]


def stabilisation(
    modes: ModeSet, frf: FRF | None = None, *, level: str = "log", ax: WhichAxes | None = None
) -> Figure:
    """Draw the poles of every order over frequency, with the modes that were found.

    Parameters
    ----------
    modes : ModeSet
        From `updyn.identify_modes`.
    frf : FRF, optional
        The measurement, whose rms over all channels is drawn above.
    level : {"log", "dB", "linear"}
        Scale of that.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Where to draw: for the diagram, then for the level. None: a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not there, or the modes have no diagram.
    """
    if not isinstance(modes, ModeSet):
        raise OptionError(f"plots.stabilisation: expected a ModeSet, found {type(modes).__name__}")
    diagram = modes.diagram
    if diagram is None:
        raise OptionError(
            "plots.stabilisation: these modes have no diagram; updyn.identify_modes(frf) makes one,"
            " except of few lines without noise, which it fits all at once"
        )
    panels = {"level": 1.0, "diagram": 2.0} if frf is not None else {"diagram": 1.0}
    if ax is not None:
        panels = dict(reversed(panels.items()))
    with canvas(ax, panels, (1100, 420 + 220 * (frf is not None))) as made:
        axes = made.axes["diagram"]
        looks: tuple[Any, ...] = (
            (~diagram.stable, "new in this order", {"color": PAPER["faint"], "markersize": 3}),
            (diagram.stable, "stays from the order before", {"color": PAPER["after"]}),
        )
        for chosen, name, look in looks:
            shown: dict[str, Any] = {
                "linestyle": "none",
                "marker": "o",
                "markersize": 4.5,
                "label": name,
                **look,
            }
            axes.plot(diagram.frequency[chosen], diagram.order[chosen], **shown)
        top = float(diagram.order.max(initial=1)) + 2.0
        axes.plot(
            modes.frequency,
            np.full(len(modes), top),
            linestyle="none",
            marker="v",
            markersize=7,
            color=PAPER["before"],
            label="mode",
        )
        for frequency in modes.frequency.tolist():
            axes.axvline(frequency, color=PAPER["before"], linewidth=0.6, alpha=0.6, zorder=1)
        axes.set_ylim(0.0, top + 1.5)
        axes.set_ylabel("order (–)")
        axes.set_xlabel("frequency (Hz)")
        if frf is not None and "level" in made.axes:
            above = made.axes["level"]
            rms = np.sqrt(np.mean(np.abs(frf.values) ** 2, axis=(1, 2)))
            above.plot(frf.freq, level_values(rms, level), color=PAPER["measured"])
            level_axis(above, f"{frf.quantity}, rms", _unit(frf), level)
            above.set_xlim(float(frf.freq[0]), float(frf.freq[-1]))
        legend_above(axes)
    return made.figure


def _unit(frf: FRF) -> str:
    units = {
        unit(frf.quantity, response, reference)
        for response in frf.responses.labels
        for reference in frf.references.labels
    }
    return ", ".join(sorted(units))
