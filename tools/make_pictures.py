"""Draw the pictures of README and manual anew, into docs/pictures.

python tools/make_pictures.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import updyn
from updyn.demos import find_demo
from updyn.style import PAPER, STATES

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"


def chain() -> Figure:
    """Return the channel of the chain that was held out: measured, at the start and updated.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with tempfile.TemporaryDirectory() as folder:
        find_demo("chain").write_inputs(Path(folder))
        model = updyn.read_model(Path(folder) / "chain.h5")
        test = updyn.read_frf(Path(folder) / "chain.uff")
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(model, test, unknowns, validation=["7:X"])
    lines = np.linspace(test.freq[0], test.freq[-1], 1200)
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    axes = figure.add_subplot()
    measured = np.abs(test.values[:, test.responses.labels.index("7:X"), 0])
    look = {"color": PAPER[STATES["measured"]], "label": "measured, held out of the fit"}
    axes.semilogy(test.freq, measured, ".", **look)
    reference = test.references.labels[:1]
    for name, one, dash in (("start", model, ":"), ("updated", result.model, "-")):
        frf = updyn.response(one, lines, ["7:X"], reference, quantity=test.quantity)
        look = {"color": PAPER[STATES[name]], "linestyle": dash, "label": name}
        axes.semilogy(lines, np.abs(frf.values[:, 0, 0]), **look)
    axes.set(xlabel="Frequency (Hz)", ylabel=f"{test.quantity} 7:X / {reference[0]}")
    axes.margins(x=0)
    axes.legend(frameon=False)
    figure.patch.set_facecolor("white")
    return figure


def nonlinear() -> Figure:
    """Return the response of two masses at several levels, with a hardening spring and a slider.

    Returns
    -------
    matplotlib.figure.Figure
    """
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(2))}
    linear = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    elements = {
        "cubic spring, 1e8 N/m³": (updyn.CubicSpring(1e8), (1.0, 2.5, 5.0)),
        "Jenkins element, 3000 N/m, 5 N": (updyn.JenkinsElement(3e3, 5.0), (1.0, 5.0, 20.0)),
    }
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    freq = np.linspace(7.0, 14.0, 141)
    colours = [PAPER[STATES[name]] for name in ("start", "updated", "measured")]
    for axes, (title, (element, levels)) in zip(
        figure.subplots(1, 2), elements.items(), strict=True
    ):
        model = linear.with_elements({"element": (element, ["1:X", "2:X"])})
        for level, colour in zip(levels, colours, strict=True):
            found = updyn.response(model, freq, ["2:X"], ["2:X"], level=level)
            (branch,) = found.branches
            size = np.abs(branch.harmonics[:, 1, 0]) / level * 1e3
            axes.semilogy(branch.freq, size, ":", color=colour)
            stable = np.where(branch.stable, size, np.nan)
            axes.semilogy(branch.freq, stable, color=colour, label=f"{level:g} N")
        axes.set(title=title, xlabel="Frequency (Hz)", ylabel="First harmonic 2:X / 2:X (mm/N)")
        axes.margins(x=0)
        axes.legend(frameon=False)
    figure.patch.set_facecolor("white")
    return figure


def main() -> None:
    """Draw all of them."""
    mpl.rcParams["svg.hashsalt"] = "updyn"  # the same file every time
    PICTURES.mkdir(exist_ok=True)
    chain().savefig(PICTURES / "chain.svg", metadata={"Date": None})
    nonlinear().savefig(PICTURES / "nonlinear.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
