"""Small structures of which it is known how sure an estimate can be."""

from __future__ import annotations

import numpy as np

import updyn

MIDDLE, LEFT, RIGHT = 2, 1, 3


def springs(*pairs: tuple[int, int, float], n: int) -> np.ndarray:
    """Stiffness of springs between DOFs counted from 1; 0 is the ground."""
    K = np.zeros((n, n))
    for a, b, k in pairs:
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            if i and j:
                K[i - 1, j - 1] += sign * k
    return K


def noisy(frf: updyn.FRF, seed: int, relative: float = 0.0, floor: float = 0.0) -> updyn.FRF:
    """Add circular noise, E|dH|^2 = (relative |H|)^2 + (floor rms)^2."""
    rng = np.random.default_rng(seed)
    std = np.sqrt(
        (relative * np.abs(frf.values)) ** 2 + floor**2 * np.mean(np.abs(frf.values) ** 2)
    )
    draw = rng.standard_normal((2, *frf.values.shape))
    values = frf.values + std * (draw[0] + 1j * draw[1]) / np.sqrt(2)
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)


def mirrored() -> updyn.Model:
    """Three masses in a row between two walls, like from both sides but for the springs to the walls."""
    groups = {
        "inner": updyn.Group(
            springs((1, 2, 800.0), (2, 3, 800.0), n=3), np.eye(3), loss_factor=0.02
        ),
        "left wall": updyn.Group(springs((0, 1, 1000.0), n=3), loss_factor=0.02),
        "right wall": updyn.Group(springs((0, 3, 1000.0), n=3), loss_factor=0.02),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


def seen_from_the_middle(relative: float = 0.05, seed: int = 3) -> updyn.UpdateResult:
    """The walls are 0.7 and 1.5; a sensor in the middle cannot tell which is which."""
    model = mirrored()
    true = model.scaled({"left wall": {"stiffness": 0.7}, "right wall": {"stiffness": 1.5}})
    frf = noisy(updyn.response(true, np.linspace(2.0, 12.0, 60), ["2:X"], ["2:X"]), seed, relative)
    unknowns = updyn.parameters(
        model, stiffness=["left wall", "right wall"], bounds={"stiffness": (0.2, 5.0)}
    )
    return updyn.update(model, frf, unknowns, noise={"relative": relative})


def one_spring(seed: int = 0, floor: float = 0.5, lines: int = 6) -> updyn.UpdateResult:
    """H = 1 / (kappa k) at every line, with additive noise: its likelihood is known in closed form."""
    model = updyn.Model.from_groups({"spring": updyn.Group([[50.0]])}, ["1:X"])
    frf = noisy(
        updyn.response(model, np.linspace(1.0, 2.0, lines), ["1:X"], ["1:X"]), seed, 0.0, floor
    )
    unknowns = updyn.parameters(model, stiffness="all", bounds={"stiffness": (0.05, 20.0)})
    return updyn.update(model, frf, unknowns, noise={"floor": floor}, starts=0)


def in_series(prior: float | None = None) -> updyn.UpdateResult:
    """Two springs in a row, the DOF between them not measured: only their sum of compliances is known."""
    groups = {
        "a": updyn.Group(springs((0, 1, 3000.0), n=2), loss_factor=0.02),
        "b": updyn.Group(springs((1, 2, 1500.0), n=2), np.diag([0.0, 2.0]), loss_factor=0.02),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    true = model.scaled({"b": {"stiffness": 1.4}})
    frf = noisy(updyn.response(true, np.linspace(1.0, 6.0, 30), ["2:X"], ["2:X"]), 0, 0.01)
    stds = None if prior is None else {"a.stiffness": prior}
    unknowns = updyn.parameters(
        model, stiffness="all", bounds={"stiffness": (0.2, 5.0)}, prior_std=stds
    )
    return updyn.update(model, frf, unknowns, noise={"relative": 0.01})


def without_loss(seed: int = 0, relative: float = 0.02) -> updyn.UpdateResult:
    """Two masses; the loss factor of the second spring is truly zero."""
    groups = {
        "base": updyn.Group(springs((0, 1, 1000.0), n=2), np.diag([1.0, 0.0]), loss_factor=0.03),
        "top": updyn.Group(springs((1, 2, 600.0), n=2), np.diag([0.0, 1.0])),
    }
    true = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    frf = noisy(
        updyn.response(true, np.linspace(1.0, 9.0, 40), ["1:X", "2:X"], ["1:X"]), seed, relative
    )
    unknowns = updyn.parameters(true, stiffness="all", loss_factor="all")
    return updyn.update(true, frf, unknowns, noise={"relative": relative}, starts=0)


#: Lines of `two_masses` in Hz.
LINES = np.linspace(1.0, 9.0, 30)


def two_masses() -> updyn.Model:
    groups = {
        "base": updyn.Group(springs((0, 1, 1000.0), n=2), np.diag([1.0, 0.0]), loss_factor=0.03),
        "top": updyn.Group(springs((1, 2, 600.0), n=2), np.diag([0.0, 1.0]), loss_factor=0.05),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def fit_lower(seed: int, noise: dict[str, float] | None = None) -> updyn.UpdateResult:
    """Only the lower mass is measured; its noise is relative 3 %."""
    true = two_masses()
    frf = noisy(updyn.response(true, LINES, ["1:X"], ["1:X"]), seed, 0.03)
    unknowns = updyn.parameters(true, stiffness="all", loss_factor="all")
    return updyn.update(true, frf, unknowns, noise=noise or {"relative": 0.03}, starts=0)


def ungrounded_chain() -> tuple[updyn.Model, updyn.FRF, updyn.ParameterSet]:
    """A model of six masses, the FRF of a chain with one more spring to ground, and unknowns."""
    spring, masses = np.zeros((6, 6)), np.diag([1.0, 1.1, 0.9, 1.0, 0.8, 0.7])
    spring[3, 3] = 150.0
    stiffness = (3e4, 2.5e4, 2e4, 2.2e4, 1.5e4, 1.2e4)
    groups = {"masses": updyn.Group(mass=masses)}
    for g in range(3):
        parts = [(i - 1, i, stiffness[i]) for i in (2 * g, 2 * g + 1)]
        groups[f"part{g}"] = updyn.Group(chained(parts), loss_factor=0.015)
    labels = [f"{i + 1}:X" for i in range(6)]
    model = updyn.Model.from_groups(groups, labels)
    true = updyn.Model.from_groups({**groups, "ground": updyn.Group(spring)}, labels)
    freq = np.linspace(6.0, 60.0, 80)
    sprung = [f"part{g}" for g in range(3)]
    unknowns = updyn.parameters(model, stiffness=sprung, loss_factor=sprung)
    return model, updyn.response(true, freq, labels, ["6:X"]), unknowns


def chained(springs: list[tuple[int, int, float]]) -> np.ndarray:
    """Stiffness of six masses with springs between two, or from -1, the ground."""
    K = np.zeros((6, 6))
    for i, j, k in springs:
        v = np.zeros(6)
        v[j] = 1.0
        if i >= 0:
            v[i] = -1.0
        K += k * np.outer(v, v)
    return K
